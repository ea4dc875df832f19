"""The picture on a glTF mesh: places kept by corner over closed seams, and what no picture is."""

import base64
import io
import struct
import sys
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pygltflib import GLTF2

from facelab.files import read_mesh, read_rig
from facelab.geometry import Texture
from facelab.geometry.mesh import TriangleMesh

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
sys.path.insert(0, str(FIXTURES))
from make_texture import picture, png, textured  # noqa: E402

FILE = FIXTURES / "avatar_textured.glb"
RADII = np.array([75.0, 110.0, 90.0])  # mm, of the head in the fixture
pytestmark = pytest.mark.filterwarnings("ignore:.*(longest side is|morph targets are left out)")


@pytest.fixture(scope="module")
def rig():
    return read_rig(FILE, mesh="Head")


def changed(path, image=None, change=None):
    """The avatar with other bytes for its picture, or another glTF."""
    path.write_bytes(textured(FIXTURES / "avatar.glb", png(picture()) if image is None else image))
    if change is not None:
        gltf = GLTF2().load(str(path))
        change(gltf)
        gltf.save(str(path))
    return path


def without_picture(path):
    """Read a file whose picture is not read; what it warns of."""
    with pytest.warns(UserWarning, match="texture is left out") as caught:
        found = read_rig(path, mesh="Head")
    assert found.neutral.texture is None
    assert found.neutral.n_vertices == 178 and len(found.names) == 4, "the mesh is as it is"
    (said,) = [str(w.message) for w in caught if "texture is left out" in str(w.message)]
    assert str(path) in said
    return said


def check_places(mesh):
    """Each corner lies where latitude and longitude put it, on its own side of the seam."""
    uv = mesh.texture.uv
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    x, y, z = ((mesh.vertices[mesh.faces] - middle) / RADII).transpose(2, 0, 1)
    np.testing.assert_allclose(uv[..., 1], np.arccos(np.clip(y, -1, 1)) / np.pi, atol=2e-3)
    off_poles = np.abs(y) < 0.99
    along = uv[..., 0] - np.arctan2(x, z) / (2 * np.pi)
    np.testing.assert_allclose((along - np.round(along))[off_poles], 0, atol=1e-5)
    assert (np.ptp(uv[..., 0], axis=1) < 0.1).all(), "no triangle runs across the whole picture"
    assert uv[..., 0].max() == 1 and uv[..., 0].min() == 0, "the seam has both its sides"


def test_places_are_kept_by_corner_where_a_seam_is_closed(rig):
    assert rig.neutral.n_vertices < len(rig.source.index), "there was a seam"
    check_places(rig.neutral)
    np.testing.assert_array_equal(rig.neutral.texture.image, picture())


def test_a_mesh_file_has_its_texture_with_open_seams_and_with_closed_ones():
    mesh = read_mesh(FILE, mesh="Head")
    check_places(mesh)
    closed, _ = mesh.welded()
    check_places(closed)
    assert closed.n_vertices < mesh.n_vertices
    assert read_mesh(FILE, mesh="Teeth").texture is None


def test_a_moved_mesh_and_a_part_of_one_keep_theirs(rig):
    mesh = rig.neutral
    assert mesh.with_vertices(mesh.vertices + 1).texture is mesh.texture
    kept = np.flatnonzero(mesh.vertices[:, 0] > -1)
    part = mesh.submesh(kept)
    middle = {
        tuple(c): u
        for c, u in zip(mesh.vertices[mesh.faces].mean(1), mesh.texture.uv.mean(1), strict=True)
    }
    for corners, uv in zip(part.vertices[part.faces].mean(1), part.texture.uv.mean(1), strict=True):
        np.testing.assert_array_equal(middle[tuple(corners)], uv)


def test_a_mirrored_part_is_turned_round_with_its_picture(tmp_path):
    def mirror(gltf):
        eye = next(m for m in gltf.meshes if m.name == "EyeMesh")
        eye.primitives[0].material = 0

    mesh = read_mesh(changed(tmp_path / "a.glb", change=mirror), mesh="EyeLeft")
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    height = (mesh.vertices[mesh.faces] - middle)[..., 1] / 12
    down = np.arccos(np.clip(height, -1, 1)) / np.pi
    np.testing.assert_allclose(mesh.texture.uv[..., 1], down, atol=2e-3)


def test_a_picture_may_stand_in_the_text_or_in_a_file_beside(tmp_path, rig):
    data = png(picture())

    def inline(gltf):
        gltf.images[0].bufferView = None
        gltf.images[0].uri = "data:image/png;base64," + base64.b64encode(data).decode()

    def beside(gltf):
        gltf.images[0].bufferView = None
        gltf.images[0].uri = "my%20skin.png"

    (tmp_path / "my skin.png").write_bytes(data)
    for change in (inline, beside):
        found = read_rig(changed(tmp_path / "a.glb", change=change), mesh="Head").neutral.texture
        np.testing.assert_array_equal(found.image, rig.neutral.texture.image)


def test_places_may_be_moved_and_scaled_and_colours_darkened_by_a_factor(tmp_path, rig):
    def change(gltf):
        look = gltf.materials[0].pbrMetallicRoughness
        look.baseColorFactor = [1.0, 0.0, 1.0, 1.0]
        look.baseColorTexture.extensions = {
            "KHR_texture_transform": {"offset": [0.25, 0], "scale": [0.5, 1]}
        }

    found = read_rig(changed(tmp_path / "a.glb", change=change), mesh="Head").neutral.texture
    uv = rig.neutral.texture.uv
    np.testing.assert_allclose(found.uv, uv * [0.5, 1] + [0.25, 0], atol=1e-6)
    np.testing.assert_array_equal(found.image, picture() * np.array([1, 0, 1], np.uint8))


def test_a_large_picture_is_made_smaller(tmp_path):
    file = io.BytesIO()
    Image.new("RGB", (5000, 100), "red").save(file, "JPEG")
    found = read_rig(changed(tmp_path / "a.glb", file.getvalue()), mesh="Head").neutral.texture
    assert found.image.shape[1] <= 2048 and found.image[0, 0, 0] > 250


def bomb(width, height):
    """A small PNG that promises many pixels."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def gif():
    file = io.BytesIO()
    Image.new("RGB", (8, 8)).save(file, "GIF")
    return file.getvalue()


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (bomb(100_000, 100_000), "8192 x 8192"),
        (bomb(8193, 4), "8193 x 4 pixels"),
        (bomb(64, 64), "no sound PNG or JPEG"),
        (png(picture())[:100], "no sound PNG or JPEG"),
        (b"<script>alert(1)</script>", "no sound PNG or JPEG"),
        (gif(), "no sound PNG or JPEG"),
    ],
    ids=["bomb", "too wide", "too few rows", "cut short", "text", "gif"],
)
def test_what_is_no_picture_is_said_and_the_mesh_is_read(tmp_path, image, words):
    said = without_picture(changed(tmp_path / "a.glb", image))
    assert words in said and "images[0]" in said


@pytest.mark.parametrize(
    ("uri", "words"),
    [
        ("../skin.png", "only read from the folder"),
        ("/etc/passwd", "only read from the folder"),
        ("https://example.org/skin.png", "only read from the folder"),
        ("file:///etc/passwd", "only read from the folder"),
        ("missing.png", "missing.png"),
        ("data:image/png;base64,@@@", "no base64"),
    ],
)
def test_a_picture_from_elsewhere_is_not_fetched(tmp_path, uri, words):
    (tmp_path / "skin.png").write_bytes(png(picture()))
    (tmp_path / "sub").mkdir()

    def change(gltf):
        gltf.images[0].bufferView = None
        gltf.images[0].uri = uri

    assert words in without_picture(changed(tmp_path / "sub" / "a.glb", change=change))


def set_look(**more):
    def change(gltf):
        for name, value in more.items():
            setattr(gltf.materials[0].pbrMetallicRoughness.baseColorTexture, name, value)

    return change


def no_source(gltf):
    gltf.textures[0].source = None


def webp_alone(gltf):
    no_source(gltf)
    gltf.textures[0].extensions = {"EXT_texture_webp": {"source": 0}}


def no_places(gltf):
    gltf.meshes[0].primitives[0].attributes.TEXCOORD_0 = None


def turned(gltf):
    place = gltf.materials[0].pbrMetallicRoughness.baseColorTexture
    place.extensions = {"KHR_texture_transform": {"rotation": 1.5}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_look(index=7), "baseColorTexture.index"),
        (set_look(texCoord=3), "TEXCOORD_3"),
        (no_source, "textures[0].source"),
        (webp_alone, "as EXT_texture_webp alone, which is not read; export the file with PNG"),
        (no_places, "TEXCOORD_0"),
        (turned, "turned"),
    ],
)
def test_a_texture_that_does_not_hold_together_is_said(tmp_path, change, words):
    assert words in without_picture(changed(tmp_path / "a.glb", change=change))


def test_a_file_without_pictures_says_nothing():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert read_rig(FIXTURES / "avatar.glb", mesh="Head").neutral.texture is None
    assert not [w for w in caught if "texture" in str(w.message)]


def test_colours_at_vertices_are_the_mean_of_their_corners_in_a_picture_that_repeats():
    image = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    lost = [[np.nan, np.nan]] * 3
    uv = [[[0.2, 0.2], [0.7, 0.2], [1.2, -0.2]], [[0.2, 0.2], [1.7, 0.9], [1.0, 0.9]], lost]
    faces = np.array([[0, 1, 2], [0, 2, 3], [3, 4, 0]])
    colors = Texture(image, uv).at_vertices(faces, 5, fill=(0.1, 0.2, 0.3))
    expected = [[1, 0, 0], [0, 1, 0], [0.5, 0.5, 1], [0, 0, 1], [0.1, 0.2, 0.3]]
    np.testing.assert_allclose(colors, expected)


def test_a_texture_of_other_faces_or_of_another_kind_is_refused():
    corners, uv = np.eye(3), np.zeros((2, 3, 2))
    with pytest.raises(ValueError, match="texture has 2 faces, but the mesh 1"):
        TriangleMesh(corners, [[0, 1, 2]], texture=Texture(picture(), uv))
    with pytest.raises(ValueError, match="image has shape"):
        Texture(picture() / 255, uv)
    with pytest.raises(ValueError, match="uv"):
        Texture(picture(), uv[..., 0])
