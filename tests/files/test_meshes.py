import re
import struct
import zipfile

import numpy as np
import pytest
import trimesh
from shapes import sphere_mesh

from facelab import storage
from facelab.files.meshes import read_mesh, read_obj, read_obj_vertices, write_obj, write_ply
from facelab.geometry.mesh import TriangleMesh
from facelab.storage import atomic_path, load_npz, save_npz

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
SQUARE = TRIANGLE + "v 1 1 0\n"


@pytest.fixture
def write(tmp_path):
    """Write text or bytes to a file and give its path."""

    def write(content, name="face.obj"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


# --- OBJ ------------------------------------------------------------------------------------------


def test_an_obj_written_and_read_again_is_the_same_mesh(tmp_path, rng):
    mesh = sphere_mesh(2, radius=80.0)
    mesh = mesh.with_vertices(mesh.vertices * rng.uniform(1e-3, 1e3, size=mesh.vertices.shape))
    write_obj(tmp_path / "a.obj", mesh)
    again = read_obj(tmp_path / "a.obj")
    np.testing.assert_allclose(again.vertices, mesh.vertices, rtol=1e-8)  # nine digits are written
    np.testing.assert_array_equal(again.faces, mesh.faces)


@pytest.mark.parametrize(
    "faces, expected",
    [
        ("f 1 2 4 3", [[0, 1, 3], [0, 3, 2]]),
        ("f 4 3 1\nf 1 2 4", [[3, 2, 0], [0, 1, 3]]),
        ("f 1/1 2/2 4/3", [[0, 1, 3]]),
        ("f 1/1/1 2/2/1 4/3/1", [[0, 1, 3]]),
        ("f 1//1 2//1 4//1", [[0, 1, 3]]),
        ("f -4 -3 -1", [[0, 1, 3]]),
        ("f -4/-1 -3/-1 4", [[0, 1, 3]]),
        ("f 1 2 4 # the lower one", [[0, 1, 3]]),
        ("f 1 2 \\\n4", [[0, 1, 3]]),
        ("f 1 2 \\\r\n4 \\\r\n3", [[0, 1, 3], [0, 3, 2]]),
        ("  f\t1  2 4  ", [[0, 1, 3]]),
        ("f 1 2 4 \\", [[0, 1, 3]]),
        ("g lips\nusemtl skin\ns off\nf 1 2 4\no eye", [[0, 1, 3]]),
    ],
)
def test_faces_of_every_form_are_read(write, faces, expected):
    mesh = read_obj(write(SQUARE + "vt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n" + faces))
    assert mesh.faces.tolist() == expected
    assert mesh.n_vertices == 4


def test_a_polygon_becomes_a_fan_that_covers_it_and_faces_the_same_way(write):
    angle = 2 * np.pi * np.arange(7) / 7
    corners = "".join(
        f"v {x:.9f} {y:.9f} 0\n" for x, y in np.stack([np.cos(angle), np.sin(angle)], axis=1)
    )
    mesh = read_obj(write(corners + "f 1 2 3 4 5 6 7\n"))
    assert mesh.faces.tolist() == [[0, i, i + 1] for i in range(1, 6)]
    assert mesh.face_areas.sum() == pytest.approx(3.5 * np.sin(2 * np.pi / 7))  # a heptagon's
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 7, atol=1e-9)


def test_relative_indices_count_back_from_their_own_line(write):
    text = TRIANGLE + "f -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n"
    assert read_obj(write(text)).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_faces_may_stand_before_their_vertices(write):
    assert read_obj(write("f 1 2 3\n" + TRIANGLE)).faces.tolist() == [[0, 1, 2]]


def test_uv_seams_do_not_split_or_reorder_vertices(write):
    uv = "vt 0 0\nvt 1 0\nvt 0 1\nvt .9 0\nvt 0 .9\nvt 1 1\n"  # the shared edge has two of each
    mesh = read_obj(write(SQUARE + uv + "f 1/1 2/2 3/3\nf 2/4 4/6 3/5\n"))
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"], ids=["unix", "windows", "old mac"])
def test_every_line_ending_is_understood(write, newline):
    text = "# made by hand\n\n" + TRIANGLE + "# faces\nf 1 2 3\n"
    mesh = read_obj(write(text.replace("\n", newline)))
    assert (mesh.n_vertices, mesh.faces.tolist()) == (3, [[0, 1, 2]])


def test_a_byte_order_mark_does_not_hide_the_first_vertex(write):
    mesh = read_obj(write(b"\xef\xbb\xbf" + (SQUARE + "f 1 2 3\n").encode()))
    assert mesh.n_vertices == 4
    np.testing.assert_array_equal(mesh.vertices[1], [1, 0, 0])


def test_colours_and_weights_after_the_coordinates_are_passed_over(write):
    text = "v 1 2 3 .5 .5 .5\nv 4 5 6 1\nv 7 8 10 # last\nf 1 2 3"
    np.testing.assert_array_equal(
        read_obj(write(text)).vertices, [[1, 2, 3], [4, 5, 6], [7, 8, 10]]
    )


def test_vertices_alone_are_those_of_the_mesh(write):
    path = write(SQUARE + "f 1 2 3\n")
    np.testing.assert_array_equal(read_obj_vertices(path), read_obj(path).vertices)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "face.obj' is empty"),
        (b"glTF\x02\0\0\0\x10", "face.obj: this is a binary file"),
        ("hello\n", "face.obj: no vertices"),
        (TRIANGLE, "face.obj: vertices but no faces"),
        (TRIANGLE + "f 1 2", "face.obj, line 4: a face with 2 corner"),
        (TRIANGLE + "f", "face.obj, line 4: a face with 0 corner"),
        (TRIANGLE + "f 1 2 3\nf 1 2 4", "face.obj, line 5: index 4 is out of range.*3 vertices"),
        (TRIANGLE + "f 0 1 2", "face.obj, line 4: index 0 is out of range"),
        (TRIANGLE + "f -4 1 2", "face.obj, line 4: index -4 is out of range"),
        ("v 0 0 0\nf -1 -2 -3\nv 1 0 0\nv 0 1 0", "line 2: index -2 is out of range"),
        (TRIANGLE + "f 1 2 x", "face.obj, line 4: 'f 1 2 x' is not a list of indices"),
        (TRIANGLE + "f 1.5 2 3", "face.obj, line 4: .* is not a list of indices"),
        (TRIANGLE + "f 1 / 3", "face.obj, line 4: .* is not a list of indices"),
        (TRIANGLE + "f 1 2 2", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "f 1 2 3 1", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "f 1 2 -2", "face.obj, line 4: the face uses a vertex twice"),
        (TRIANGLE + "v nan 0 0\nf 1 2 3", "face.obj, line 4: 'v nan 0 0' holds NaN"),
        (TRIANGLE + "v 0 inf 0\nf 1 2 3", "face.obj, line 4: .* holds NaN or infinity"),
        (TRIANGLE + "v 0 1e999 0\nf 1 2 3", "face.obj, line 4: .* holds NaN or infinity"),
        (TRIANGLE + "v 0 0\nf 1 2 3", "face.obj, line 4: 'v 0 0' has not three coordinates"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3", "face.obj, line 1: .* has not three coordinates"),
        ("v\nv\nv\nf 1 2 3", "face.obj, line 1: 'v' has not three coordinates"),
        (TRIANGLE + "v 0 zero 0\nf 1 2 3", "face.obj, line 4: 'v 0 zero 0' holds no numbers"),
        (TRIANGLE + "v 0,5 0 0\nf 1 2 3", "face.obj, line 4: .* holds no numbers"),
        ("v 0 0 \\\n0\n\nv 1 0 0\nv 0 1 x\nf 1 2 3", "face.obj, line 5: 'v 0 1 x'"),
    ],
)
def test_an_obj_that_cannot_be_used_is_refused_with_its_place(write, text, words):
    with pytest.raises(ValueError, match=words):
        read_obj(write(text))


@pytest.mark.parametrize("read", [read_obj, read_obj_vertices, read_mesh])
def test_a_missing_file_is_refused_by_name(tmp_path, read):
    with pytest.raises(FileNotFoundError, match=r"nowhere.obj.*there is no such"):
        read(tmp_path / "nowhere.obj")


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="is not a file; give the path of one OBJ file"):
        read_obj(tmp_path)


def damaged(data, rng):
    """The bytes with one to three of them changed, left out or put in, or the end cut off."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(data)))
        kind = rng.integers(5)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.choice(list(b"0123456789-.,:/ \n\"'#eE")))
        elif kind == 2:
            del data[at : at + int(rng.integers(1, 12))]
        elif kind == 3:
            data[at:at] = bytes(rng.integers(256, size=3).tolist())
        else:
            del data[max(1, at) :]
        if not data:
            break
    return bytes(data)


@pytest.mark.parametrize("seed", range(200))
def test_a_damaged_obj_is_refused_or_read_but_breaks_nothing(write, seed):
    rng = np.random.default_rng(seed)
    whole = "# grid\n" + "".join(f"v {i % 3}.25 {i // 3}.5 0\n" for i in range(9))
    whole += "f 1 2 5 4\nf 2/1 3/2 6/3\nf 2 6 5\nf -6//1 -5//1 -2//1 -3//1\n"
    try:
        mesh = read_obj(write(damaged(whole.encode(), rng)))
    except ValueError as error:
        assert "face.obj" in str(error)
    else:  # the constructor of TriangleMesh checks the rest
        assert np.isfinite(mesh.vertices).all()


# --- PLY, GLB -------------------------------------------------------------------------------------


@pytest.fixture
def ball():
    return sphere_mesh(1, radius=80.0)


def export(mesh, path, **options):
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path, **options)
    return path


def test_a_ply_written_and_read_again_keeps_order_and_faces(tmp_path, ball):
    write_ply(tmp_path / "ball.ply", ball)
    again = read_mesh(tmp_path / "ball.ply")
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)  # float32 near 80
    np.testing.assert_array_equal(again.faces, ball.faces)


@pytest.mark.parametrize("name, options", [("a.glb", {}), ("a.ply", {"encoding": "ascii"})])
def test_files_of_others_keep_order_and_faces(tmp_path, ball, name, options):
    again = read_mesh(export(ball, tmp_path / name, **options))
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)  # float32 near 80
    np.testing.assert_array_equal(again.faces, ball.faces)


def test_vertices_of_a_glb_in_one_place_are_not_merged(tmp_path):
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    seam = TriangleMesh(V, np.array([[0, 1, 2], [3, 4, 5]]))
    again = read_mesh(export(seam, tmp_path / "seam.glb"))
    np.testing.assert_allclose(again.vertices, V)


def test_parts_of_a_scene_follow_one_another_where_they_stand(tmp_path, ball):
    scene = trimesh.Scene()
    part = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    scene.add_geometry(part, geom_name="a")
    away = trimesh.transformations.translation_matrix([500, 0, 0])
    scene.add_geometry(part.copy(), geom_name="b", transform=away)
    scene.export(tmp_path / "two.glb")
    both = read_mesh(tmp_path / "two.glb")
    n = ball.n_vertices
    assert both.n_vertices == 2 * n
    centres = sorted([both.vertices[:n].mean(axis=0)[0], both.vertices[n:].mean(axis=0)[0]])
    assert centres == pytest.approx([0, 500], abs=1e-3)
    np.testing.assert_array_equal(both.faces[len(ball.faces) :], ball.faces + n)


def test_an_obj_is_read_by_our_own_reader_under_any_case(write):
    assert read_mesh(write(SQUARE + "f 1 2 4 3", "FACE.OBJ")).faces.tolist() == [
        [0, 1, 3],
        [0, 3, 2],
    ]


@pytest.mark.parametrize("part", [0.02, 0.1, 0.3, 0.5, 0.9, 0.99, 0.999])
@pytest.mark.parametrize(
    "name, options", [("a.ply", {}), ("a.ply", {"encoding": "ascii"}), ("a.glb", {})]
)
def test_a_file_cut_short_is_refused(tmp_path, ball, name, options, part):
    path = export(ball, tmp_path / name, **options)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(ValueError, match=re.escape(str(path))):
        read_mesh(path)


def test_a_damaged_gltf_is_refused_even_beside_a_whole_one(tmp_path, ball):
    part = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(part)).items():
        (tmp_path / name).write_bytes(data)
    assert read_mesh(tmp_path / "model.gltf").n_vertices == ball.n_vertices
    (tmp_path / "face.gltf").write_bytes((tmp_path / "model.gltf").read_bytes()[:100])
    with pytest.raises(ValueError, match=r"face.gltf: not a readable .gltf"):
        read_mesh(tmp_path / "face.gltf")


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
"""


def test_quads_of_a_ply_become_triangles(write):
    mesh = read_mesh(write(PLY + "4 0 1 2 3\n", "quad.ply"))
    assert mesh.n_vertices == 4
    assert mesh.face_areas.sum() == pytest.approx(1)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 4)


@pytest.mark.parametrize(
    "text",
    [
        PLY,
        PLY + "4 0 1 2\n",
        PLY + "3 0 1 9\n",
        PLY + "3 0 1 1\n",
        PLY.replace("1 1 0", "1 nan 0") + "4 0 1 2 3\n",
        PLY.replace("face 1", "face 2") + "4 0 1 2 3\n",
        PLY.replace("face 1", "face 0"),
        "ply\n",
        "no mesh",
    ],
    ids=["no face", "short face", "far index", "twice", "nan", "missing", "points", "head", "text"],
)
def test_a_ply_that_cannot_be_used_is_refused_by_name(write, text):
    with pytest.raises(ValueError, match=r"bad.ply"):
        read_mesh(write(text, "bad.ply"))


@pytest.mark.parametrize("name", ["bad.ply", "bad.glb"])
@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_ply_or_glb_is_refused_or_read_but_breaks_nothing(tmp_path, ball, name, seed):
    path = export(ball, tmp_path / name)
    path.write_bytes(damaged(path.read_bytes(), np.random.default_rng(seed)))
    try:
        mesh = read_mesh(path)
    except ValueError as error:
        assert name in str(error)
    else:
        assert np.isfinite(mesh.vertices).all()


@pytest.mark.parametrize("name", ["face.fbx", "face", "face.obj.zip"])
def test_an_unknown_kind_of_file_is_refused_with_those_known(tmp_path, name):
    with pytest.raises(ValueError, match=r"unknown kind; readable are .obj, .ply, .glb"):
        read_mesh(tmp_path / name)


# --- whole files or none --------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_beside_it(write, tmp_path):
    path = write("old", "face.obj")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as part:
        part.write_text("half of the n")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["face.obj"]


def test_the_old_file_stands_until_the_new_one_is_whole(write, tmp_path):
    path = write("old", "face.obj")
    with atomic_path(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
        assert part.parent == path.parent  # another disk could not be swapped in at once
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["face.obj"]


@pytest.mark.parametrize(
    "name, save",
    [
        ("a.obj", lambda path: write_obj(path, sphere_mesh(0))),
        ("a.ply", lambda path: write_ply(path, sphere_mesh(0))),
        ("a.npz", lambda path: save_npz(path, "pose", 1, x=[1.0])),
    ],
    ids=["obj", "ply", "npz"],
)
def test_every_writer_keeps_the_old_file_when_the_disk_fails(write, monkeypatch, name, save):
    path = write("old", name)

    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(storage.os, "replace", fail)
    with pytest.raises(OSError, match="no space left"):
        save(path)
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == [name]


def test_writing_into_a_missing_folder_is_refused_by_name(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"folder .*nowhere does not exist"):
        write_obj(tmp_path / "nowhere" / "a.obj", sphere_mesh(0))


def test_written_files_can_be_read_by_others_as_any_file(tmp_path, write):
    write_obj(tmp_path / "a.obj", sphere_mesh(0))
    assert (tmp_path / "a.obj").stat().st_mode == write("x", "b").stat().st_mode


# --- npz ------------------------------------------------------------------------------------------


def test_arrays_come_back_as_they_were_saved(tmp_path, rng):
    arrays = {
        "floats": rng.normal(size=(3, 4)).astype(np.float32),
        "numbers": np.arange(5),
        "names": np.array(["jawOpen", "Ärger"]),
        "mask": np.array([True, False]),
        "empty": np.zeros((0, 3)),
        "single": 2.5,
    }
    save_npz(tmp_path / "a.npz", "pose", 1, **arrays)
    again = load_npz(tmp_path / "a.npz", "pose", 1)
    assert set(again) == set(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(again[name], array)
        assert again[name].dtype == np.asarray(array).dtype


def test_python_objects_are_refused_when_saving_by_name(tmp_path):
    with pytest.raises(TypeError, match="bad, worse: Python objects cannot be stored"):
        save_npz(tmp_path / "a.npz", "pose", 1, ok=[1], bad=[{}], worse=np.array([None]))
    assert list(tmp_path.iterdir()) == []


class Bomb:
    """Leaves a mark when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return (open, (str(self.mark), "w"))


def test_a_pickle_in_a_file_is_never_opened(tmp_path):
    mark = tmp_path / "boom"
    np.savez(
        tmp_path / "a.npz",
        facelab_kind="pose",
        facelab_version=1,
        x=np.array([Bomb(mark)], dtype=object),
    )
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(tmp_path / "a.npz", "pose", 1)
    assert not mark.exists()


@pytest.mark.parametrize("kind, version", [("clip", 1), ("pose", 2), ("pose", 0)])
def test_a_file_of_another_kind_or_version_is_refused_with_both(tmp_path, kind, version):
    save_npz(tmp_path / "a.npz", "pose", 1, x=[1.0])
    words = f"a.npz holds 'pose' of version 1, but '{kind}' of version {version} is wanted"
    with pytest.raises(ValueError, match=words):
        load_npz(tmp_path / "a.npz", kind, version)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_npz_is_refused_by_name(tmp_path, rng, part):
    path = tmp_path / "a.npz"
    save_npz(path, "pose", 1, x=rng.normal(size=(50, 3)))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(path, "pose", 1)


def test_a_flipped_byte_within_an_npz_is_noticed(tmp_path, rng):
    path = tmp_path / "a.npz"
    save_npz(path, "pose", 1, x=rng.normal(size=(50, 3)))
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("x.npy").header_offset
    data = bytearray(path.read_bytes())
    name, extra = struct.unpack_from("<HH", data, start + 26)  # lengths, zip local file header
    data[start + 30 + name + extra + 300] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"a.npz: not a readable facelab npz"):
        load_npz(path, "pose", 1)


def test_files_that_are_not_ours_are_refused_by_name(tmp_path, write):
    np.savez(tmp_path / "other.npz", x=[1.0])
    np.save(tmp_path / "array.npy", [1.0])
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    write("hello", "text.npz")
    for name in ("other.npz", "array.npz", "text.npz"):
        with pytest.raises(ValueError, match=f"{name}: not a readable facelab npz"):
            load_npz(tmp_path / name, "pose", 1)


def test_npz_files_are_called_npz(tmp_path):
    with pytest.raises(ValueError, match=r"must end in .npz"):
        save_npz(tmp_path / "a.pose", "pose", 1, x=[1.0])
