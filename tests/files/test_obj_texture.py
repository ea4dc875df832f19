"""The picture of an OBJ mesh: each corner where its line of texture coordinates puts it."""

import warnings

import numpy as np
import pytest
from PIL import Image

from facelab.files import read_mesh, read_obj, read_rig

COLORS = np.array(
    [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]], np.uint8
)  # from the upper left
LIBRARY = "newmtl plain\nKd 1 0 0\nnewmtl skin\nKd 1 1 1\nmap_Kd skin.png\n"
# two squares side by side; the left one has the picture upright, the right one mirrored, so that
# the vertices between them lie on two sides of a seam
FACES = (
    "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\n"
    "vt 0 0\nvt 1 0\nvt 0 1\nvt 1 1 0.5\nusemtl skin\n"
    "f 1/1 2/2 5/4 4/3\nf 2/1 3/2 6/4 5/3\n"
)


@pytest.fixture
def write(tmp_path):
    Image.fromarray(COLORS).save(tmp_path / "skin.png")
    (tmp_path / "head.mtl").write_text(LIBRARY)

    def write(text=FACES, head="mtllib head.mtl\n", library=None, name="head.obj"):
        if library is not None:
            (tmp_path / "head.mtl").write_text(library)
        (tmp_path / name).write_text(head + text)
        return tmp_path / name

    return write


def where(mesh):
    """Place in the picture of every corner of every triangle, by place of the corner: dict."""
    found = {}
    for corners, places, left in zip(
        mesh.vertices[mesh.faces],
        mesh.texture.uv,
        mesh.vertices[mesh.faces][..., 0].mean(axis=1) < 1,
        strict=True,
    ):
        for corner, place in zip(corners, places, strict=True):
            found[bool(left), *corner[:2].tolist()] = place.tolist()
    return found


def test_materials_that_differ_behind_a_number_sign_have_pictures_of_their_own(write):
    library = "newmtl skin#1 # of the face\nmap_Kd skin.png\nnewmtl skin#2\nmap_Kd lost.png\n"
    mesh = read_obj(write(FACES.replace("skin", "skin#1"), library=library))
    np.testing.assert_array_equal(mesh.texture.image, COLORS)


def test_corners_lie_where_their_lines_put_them_on_both_sides_of_a_seam(write):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh = read_obj(write())
    np.testing.assert_array_equal(mesh.texture.image, COLORS)
    expected = {(True, x, y): [x, 1 - y] for x in (0.0, 1.0) for y in (0.0, 1.0)}
    expected |= {(False, 1 + x, y): [x, 1 - y] for x in (0.0, 1.0) for y in (0.0, 1.0)}
    assert where(mesh) == expected


def test_faces_of_any_form_and_polygons_that_bend_inwards_keep_theirs(write):
    bent = (
        "v 0 0 0\nv 2 0 0\nv 0.5 0.5 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 0.25 0.25\nvt 0 1\n"
        "usemtl skin\nf 1/1/1 -3/-3/1 -2/-2/1 4/4/1\nvn 0 0 1\n"
    )
    mesh = read_obj(write(bent))
    x, y = mesh.vertices[mesh.faces][..., :2].transpose(2, 0, 1)
    np.testing.assert_allclose(mesh.texture.uv, np.stack([x / 2, 1 - y / 2], axis=-1))


def test_triangles_of_another_material_or_without_places_have_no_picture(write):
    mesh = read_obj(
        write(FACES + "usemtl plain\nf 1/1 2/2 5/4\nusemtl skin\nf 1 2 5\nf 4/1 5/2 6/3\n")
    )
    np.testing.assert_array_equal(mesh.texture.painted, [True] * 4 + [False, False, True])


def test_a_part_and_a_rig_of_folders_have_it_too(write, tmp_path):
    read = read_mesh(write("o left\n" + FACES), mesh="left", scale=1.0)
    assert read.texture.painted.all()
    write(name="neutral.obj")
    write(FACES.replace("v 0 0 0", "v 0 0 0.5"), name="smile.obj")
    (tmp_path / "head.obj").unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its size
        rig = read_rig(tmp_path)
    assert rig.neutral.texture is not None and rig.names == ("smile",)


@pytest.mark.parametrize(
    "named",
    [r"C:\Users\ann\skin.png", "/home/ann/skin.png", r"textures\skin.png", "my skin.png"],
)
def test_a_picture_is_found_by_the_paths_that_programs_write(write, tmp_path, named):
    (tmp_path / "textures").mkdir()
    for other in ("textures/skin.png", "my skin.png"):
        (tmp_path / other).write_bytes((tmp_path / "skin.png").read_bytes())
    mesh = read_obj(write(library=f"newmtl skin\nmap_Kd {named}\n"))
    np.testing.assert_array_equal(mesh.texture.image, COLORS)


@pytest.mark.parametrize(
    ("library", "words"),
    [
        ("newmtl skin\nmap_Kd lost.png\n", "lost.png"),
        ("newmtl skin\nmap_Kd ../skin.png\n", "folder of the file"),
        ("newmtl skin\nmap_Kd -s 2 2 1 skin.png\n", "options"),
        ("newmtl skin\nmap_Kd head.mtl\n", "no sound PNG or JPEG"),
    ],
)
def test_a_picture_that_cannot_be_read_is_said_and_the_mesh_is_read(write, library, words):
    path = write(library=library)
    with pytest.warns(UserWarning, match="texture is left out") as caught:
        mesh = read_obj(path)
    assert mesh.texture is None and mesh.n_vertices == 6
    assert words in str(caught[0].message) and str(path) in str(caught[0].message)


def test_a_library_that_is_not_there_and_numbers_that_are_none_are_said(write):
    for text, head in (
        (FACES, "mtllib gone.mtl\n"),
        (FACES.replace("vt 1 0\n", "vt nan 0\n"), None),
    ):
        path = write(text) if head is None else write(text, head)
        with pytest.warns(UserWarning, match="texture is left out"):
            assert read_obj(path).texture is None


def test_of_several_pictures_the_one_on_most_triangles_is_kept(write, tmp_path):
    Image.fromarray(COLORS[::-1]).save(tmp_path / "other.png")
    more = "newmtl other\nmap_Kd other.png\n" + LIBRARY
    path = write(FACES + "usemtl other\nf 1/1 2/2 5/4\n", library=more)
    with pytest.warns(UserWarning, match="2 pictures"):
        mesh = read_obj(path)
    np.testing.assert_array_equal(mesh.texture.image, COLORS)
    np.testing.assert_array_equal(mesh.texture.painted, [True] * 4 + [False])
