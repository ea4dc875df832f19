import base64
import importlib.util
import json
import os
import resource
import struct
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from mutants import COUNT, tally
from scipy.spatial import cKDTree
from shapes import grid_mesh, sphere_mesh

from facelab.files import meshopt, read_mesh, read_parts, write_glb
from facelab.files.gltf_read import GltfScene

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
HAS_DRACO = importlib.util.find_spec("DracoPy") is not None
DRACO = pytest.param(
    "avatar_draco", marks=pytest.mark.skipif(not HAS_DRACO, reason="DracoPy is not installed")
)

V = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.02]])  # metres
F = np.array([[0, 1, 2], [1, 3, 2]])
MM = 1000 * V


class Gltf:
    """A glTF in the making: a square of four vertices, to be changed at will."""

    def __init__(self, positions=None, indices=F, **node):
        self.binary = b""
        self.json = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "Head", **node}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [],
            "bufferViews": [],
        }
        self.add(V.astype("<f4") if positions is None else positions)
        self.add(np.ravel(indices).astype("<u2"))

    @property
    def primitive(self):
        return self.json["meshes"][0]["primitives"][0]

    def view(self, data, **more):
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **more}
        self.json["bufferViews"].append(view)
        self.binary += data
        return len(self.json["bufferViews"]) - 1

    def add(self, array, stride=None, **more):
        """An accessor of an array, and its number."""
        kinds = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
        width = 1 if array.ndim == 1 else array.shape[1]
        data = array.tobytes()
        view = {}
        if stride:
            rows = array.reshape(len(array), -1).view(np.uint8)
            data = np.pad(rows, ((0, 0), (0, stride - rows.shape[1]))).tobytes()
            view = {"byteStride": stride}
        accessor = {
            "bufferView": self.view(data, **view),
            "componentType": kinds[array.dtype.str[1:]],
            "count": len(array),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[width],
            **more,
        }
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def target(self, delta, **more):
        at = self.add(np.asarray(delta, dtype="<f4"), **more)
        self.primitive.setdefault("targets", []).append({"POSITION": at})

    def glb(self, text=None):
        told = {"buffers": [{"byteLength": len(self.binary)}], **self.json}
        text = json.dumps(told).encode() if text is None else text
        text += b" " * (-len(text) % 4)
        data = self.binary + bytes(-len(self.binary) % 4)
        size = 28 + len(text) + len(data)
        return b"".join(
            [
                struct.pack("<4sII", b"glTF", 2, size),
                struct.pack("<I4s", len(text), b"JSON") + text,
                struct.pack("<I4s", len(data), b"BIN\0") + data,
            ]
        )


@pytest.fixture
def write(tmp_path):
    def write(gltf, name="face.glb"):
        path = tmp_path / name
        path.write_bytes(gltf if isinstance(gltf, bytes) else gltf.glb())
        return path

    return write


def part(path, shapes=True):
    scene = GltfScene(path)
    return scene.part(0, shapes=shapes)


# --- what optimisers leave ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["avatar_quantised", "avatar_sparse", "avatar_meshopt", DRACO])
def test_an_avatar_is_the_same_however_it_is_packed(name):
    plain, packed = GltfScene(FIXTURES / "avatar.glb"), GltfScene(FIXTURES / f"{name}.glb")
    assert packed.names == plain.names == ["Teeth", "Head", "EyeLeft"]
    for k in range(3):
        a, b = plain.part(k, shapes=True), packed.part(k, shapes=True)
        grid = 1.84 / 2**14  # positions are rounded to 14 bits of a cube of 1.84 m
        nearest = cKDTree(a.vertices).query(b.vertices)
        assert nearest[0].max() < grid and cKDTree(b.vertices).query(a.vertices)[0].max() < grid
        assert b.names == a.names and len(b.faces) == len(a.faces)
        middles = [p.vertices[p.faces].mean(axis=1) for p in (a, b)]
        assert cKDTree(middles[0]).query(middles[1])[0].max() < grid
        if a.names:  # vertices in one place move alike here, so any of them will do
            off = np.abs(b.deltas - a.deltas[:, nearest[1]])
            assert off.max() < 4e-4  # shapes are rounded to 8 bits of 25 mm


def test_the_avatar_stands_where_its_skeleton_puts_it():
    """Known by construction: balls, in centimetres under an armature that lies on its back."""
    teeth, head, eye = (GltfScene(FIXTURES / "avatar.glb").part(k, shapes=True) for k in range(3))
    assert np.abs((head.vertices - [0, 1.68, 0]) / [0.075, 0.11, 0.09]).max() <= 1 + 1e-6
    radius = np.linalg.norm((head.vertices - [0, 1.68, 0]) / [0.075, 0.11, 0.09], axis=1)
    np.testing.assert_allclose(radius, 1, atol=1e-5)
    np.testing.assert_allclose(teeth.vertices.mean(axis=0), [0, 1.63, 0.06], atol=2e-3)
    np.testing.assert_allclose(np.ptp(eye.vertices, axis=0), 0.024, atol=1e-6)
    assert eye.vertices[:, 0].mean() == pytest.approx(0.03, abs=1e-3)
    jaw = head.deltas[head.names.index("jawOpen")]
    assert jaw[:, 1].min() < -0.015 and jaw[:, 2].max() <= 1e-9  # down and back, upright
    for p in (teeth, head, eye):  # all face outwards, the mirrored eye too
        mesh = trimesh.Trimesh(p.vertices, p.faces, process=True)
        assert mesh.volume > 0


@pytest.mark.parametrize("stream", json.loads((FIXTURES / "meshopt_streams.json").read_text()),
                         ids=lambda s: s["name"])  # fmt: skip
def test_every_mode_and_filter_of_meshopt_gives_what_its_own_decoder_gives(stream):
    data, decoded = (base64.b64decode(stream[k]) for k in ("data", "decoded"))
    rest = (stream["count"], stream["stride"], stream["mode"], stream["filter"])
    assert meshopt.decode(data, *rest).tobytes() == decoded
    for damaged in (data[:-1], data[:20], data + b"\0", b"\xa1" + data[1:]):
        with pytest.raises(ValueError, match="damaged"):
            meshopt.decode(damaged, *rest)


@pytest.mark.parametrize("mode, count", [("ATTRIBUTES", 10**12), ("TRIANGLES", 3 * 10**9)])
def test_meshopt_takes_no_memory_for_elements_that_the_data_cannot_hold(mode, count):
    with pytest.raises(ValueError, match="damaged"):
        meshopt.decode(b"\xa0" + bytes(200), count, 4, mode)


@pytest.mark.parametrize(
    "dtype, normalized",
    [("<i2", True), ("<u2", True), ("<i1", True), ("<u1", True), ("<i2", False)],
)
@pytest.mark.parametrize("stride", [None, 12])
def test_quantised_positions_are_the_numbers_they_stand_for(write, dtype, normalized, stride):
    most = np.iinfo(dtype).max
    quantised = np.round(V / 0.1 * most).astype(dtype)
    if not stride:  # packed tightly: rows of three need no padding to be read
        gltf = Gltf(quantised)
    else:
        gltf = Gltf(np.zeros((4, 3), "<f4"))
        gltf.primitive["attributes"]["POSITION"] = gltf.add(quantised, stride=stride)
    at = gltf.json["accessors"][gltf.primitive["attributes"]["POSITION"]]
    at["normalized"] = normalized
    gltf.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    gltf.json["nodes"][0]["scale"] = [0.1 if normalized else 0.1 / most] * 3
    np.testing.assert_allclose(read_mesh(write(gltf)).vertices, MM, atol=100 / most)


def test_the_most_negative_number_stands_for_minus_one(write):
    quantised = np.array([[-128, 0, 0], [-127, 127, 0], [0, 127, 127]], "<i1")
    gltf = Gltf(quantised, [[0, 1, 2]])
    gltf.json["accessors"][0]["normalized"] = True
    assert part(write(gltf)).vertices.tolist() == [[-1, 0, 0], [-1, 1, 0], [0, 1, 1]]


@pytest.mark.parametrize("base", [True, False])
def test_sparse_accessors_change_their_base_or_zeros(write, base):
    gltf = Gltf()
    delta = np.full((4, 3), 0.001, "<f4") * base
    gltf.target(delta)
    at = gltf.json["accessors"][-1]
    at["sparse"] = {
        "count": 2,
        "indices": {"bufferView": gltf.view(np.array([1, 3], "<u1").tobytes()),
                    "componentType": 5121},
        "values": {"bufferView": gltf.view(np.array([[0, 0, 1], [0, 2, 0]], "<f4").tobytes())},
    }  # fmt: skip
    if not base:
        del at["bufferView"]
    delta[[1, 3]] = [[0, 0, 1], [0, 2, 0]]
    np.testing.assert_allclose(part(write(gltf)).deltas[0], delta, atol=1e-9)


@pytest.mark.skipif(not HAS_DRACO, reason="DracoPy is not installed")
def test_shares_that_draco_keeps_as_whole_numbers_are_shares_again(write):
    import DracoPy

    shares = np.array([[0, 0, 0], [255, 0, 0], [255, 51, 0], [0, 102, 255]], "u1")
    data = DracoPy.encode(V, F, preserve_order=True, generic_attributes={7: shares})
    gltf = Gltf(positions=shares, scale=[0.1, 0.1, 0.1])
    gltf.json["accessors"][0] |= {"normalized": True}
    gltf.primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": gltf.view(data), "attributes": {"POSITION": 7}}
    }
    np.testing.assert_allclose(read_mesh(write(gltf)).vertices, 100 / 255 * shares, atol=1e-4)


def test_draco_without_its_reader_is_refused_by_name_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(ValueError, match=r"KHR_draco_mesh_compression; .*facelab\[glb\]"):
        part(FIXTURES / "avatar_draco.glb")


def test_a_required_extension_that_is_not_read_is_refused_by_name(write):
    gltf = Gltf()
    gltf.json["extensionsRequired"] = [
        "KHR_texture_transform",
        "FOO_bar",
        "EXT_mesh_gpu_instancing",
    ]
    with pytest.raises(ValueError, match="it requires FOO_bar, EXT_mesh_gpu_instancing, which"):
        read_mesh(write(gltf))


def test_extensions_that_change_looks_are_harmless(write):
    gltf = Gltf()
    gltf.json["extensionsRequired"] = ["KHR_texture_transform", "KHR_materials_unlit",
                                       "KHR_texture_basisu", "EXT_texture_webp"]  # fmt: skip
    np.testing.assert_allclose(read_mesh(write(gltf)).vertices, MM, atol=1e-5)


# --- where the scene puts it ----------------------------------------------------------------------


def test_nodes_turn_scale_and_move_meshes_and_shapes_below_them(write):
    half = 0.5**0.5
    gltf = Gltf(rotation=[0, 0, half, half], translation=[1, 0, 0])  # a quarter turn about z
    gltf.json["nodes"] += [{"children": [0], "scale": [2, 3, 4]}]
    gltf.json["scenes"][0]["nodes"] = [1]
    gltf.target(np.tile([0.01, 0, 0], (4, 1)))
    p = part(write(gltf))
    x, y, z = V.T
    np.testing.assert_allclose(p.vertices, np.stack([2 * (1 - y), 3 * x, 4 * z], axis=1), atol=1e-7)
    np.testing.assert_allclose(p.deltas[0], np.tile([0, 0.03, 0], (4, 1)), atol=1e-8)
    assert p.faces.tolist() == F.tolist()


def test_a_matrix_is_read_column_by_column(write):
    M = np.eye(4)
    M[:3, 3] = [1, 2, 3]
    p = part(write(Gltf(matrix=M.T.ravel().tolist())))
    np.testing.assert_allclose(p.vertices, V + [1, 2, 3], atol=1e-6)


@pytest.mark.parametrize("scale, flips", [([-1, 1, 1], True), ([-1, -1, 1], False)])
def test_a_mirrored_node_turns_the_triangles_round(write, scale, flips):
    p = part(write(Gltf(scale=scale)))
    np.testing.assert_allclose(p.vertices, V * scale, atol=1e-7)
    assert p.faces.tolist() == (F[:, ::-1] if flips else F).tolist()


def test_a_skin_places_its_vertices_by_its_joints_and_not_by_its_node(write):
    gltf = Gltf(translation=[9, 9, 9], skin=0)
    gltf.json["nodes"] += [{"translation": [0, 1, 0], "children": [2]}, {"scale": [2, 2, 2]}]
    gltf.json["scenes"][0]["nodes"] = [0, 1]
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, :3, 3] = [0, 0, -1]  # the second joint's rest is at z = 1
    at = gltf.add(bind.transpose(0, 2, 1).reshape(2, 16).astype("<f4"))
    gltf.json["skins"] = [{"joints": [1, 2], "inverseBindMatrices": at}]
    joints = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]], "<u1")
    weights = np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 0, 0, 0]], "<f4")
    gltf.primitive["attributes"] |= {"JOINTS_0": gltf.add(joints), "WEIGHTS_0": gltf.add(weights)}
    gltf.target(np.tile([0, 0, 0.01], (4, 1)))
    p = part(write(gltf))
    first, second = V + [0, 1, 0], 2 * (V - [0, 0, 1]) + [0, 1, 0]
    expected = [first[0], second[1], (first[2] + second[2]) / 2, first[3] * 0 + first[3]]
    np.testing.assert_allclose(p.vertices[:3], expected[:3], atol=1e-6)
    np.testing.assert_allclose(p.deltas[0][:3, 2], [0.01, 0.02, 0.015], atol=1e-7)


def test_a_vrm_of_the_first_version_is_turned_towards_the_viewer(write):
    gltf = Gltf()
    gltf.json["extensions"] = {"VRM": {"specVersion": "0.0"}}
    np.testing.assert_allclose(part(write(gltf, "a.vrm")).vertices, V * [-1, 1, -1], atol=1e-7)


@pytest.mark.parametrize("children", [[[1], [0], []], [[1, 2], [2], []], [[0], [], []]])
def test_a_hierarchy_that_is_no_tree_is_refused(write, children):
    gltf = Gltf()
    gltf.json["nodes"] = [{"children": c, "mesh": 0} if c else {"mesh": 0} for c in children]
    with pytest.raises(ValueError, match="hangs below two nodes or below itself"):
        read_mesh(write(gltf))


def test_meshes_without_nodes_are_read_and_those_outside_the_scene_are_not(write):
    gltf = Gltf()
    gltf.json["nodes"].append({"mesh": 0, "name": "Hidden"})
    assert GltfScene(write(gltf)).names == ["Head"]
    for key in ("nodes", "scenes", "scene"):
        del gltf.json[key]
    gltf.json["meshes"][0]["name"] = "Alone"
    assert GltfScene(write(gltf)).names == ["Alone"]


def test_what_has_no_triangles_or_no_size_is_passed_over_and_said(write):
    gltf = Gltf()
    gltf.json["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]})
    gltf.json["nodes"] += [{"mesh": 1, "name": "Hair"}, {"mesh": 0, "scale": [0, 0, 0]}]
    gltf.json["scenes"][0]["nodes"] = [0, 1, 2]
    with pytest.warns(UserWarning, match=r"'Hair', 'meshes\[0\]' \(2\) have no triangles, or are"):
        assert GltfScene(write(gltf)).names == ["Head"]


# --- triangles ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "mode, indices, expected",
    [
        (4, [0, 1, 2, 1, 3, 2], [[0, 1, 2], [1, 3, 2]]),
        (5, [0, 1, 2, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 2, 3], [[0, 1, 2]]),
        (6, [0, 1, 3, 2], [[0, 1, 3], [0, 3, 2]]),
    ],
)
def test_lists_strips_and_fans_become_triangles(write, mode, indices, expected):
    gltf = Gltf(indices=indices)
    gltf.primitive["mode"] = mode
    assert part(write(gltf)).faces.tolist() == expected


def test_without_indices_the_vertices_follow_one_another(write):
    gltf = Gltf(V[F.ravel()].astype("<f4"))
    del gltf.primitive["indices"]
    assert part(write(gltf)).faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_triangles_that_use_a_vertex_twice_are_left_out_and_counted(write):
    with pytest.warns(UserWarning, match=r"primitives\[0\]: 1 of 2 triangles use a vertex twice"):
        assert part(write(Gltf(indices=[0, 1, 2, 3, 3, 2]))).faces.tolist() == [[0, 1, 2]]


def test_primitives_that_share_their_vertices_do_not_double_them(write):
    gltf = Gltf(indices=[0, 1, 2])
    other = gltf.add(np.array([1, 3, 2], "<u2"))
    gltf.json["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "indices": other})
    p = part(write(gltf))
    assert (len(p.vertices), p.faces.tolist(), p.start) == (4, F.tolist(), {0: 0, 1: 0})
    copy = gltf.add(V.astype("<f4"))
    gltf.json["meshes"][0]["primitives"][1]["attributes"]["POSITION"] = copy
    p = part(write(gltf))
    assert (len(p.vertices), p.faces.tolist(), p.start) == (8, [[0, 1, 2], [5, 7, 6]], {0: 0, 1: 4})


# --- parts and names ------------------------------------------------------------------------------


def two_heads():
    gltf = Gltf()
    gltf.json["meshes"][0]["name"] = "HeadMesh"
    gltf.json["nodes"].append({"mesh": 0, "name": "Head", "translation": [1, 0, 0]})
    gltf.json["scenes"][0]["nodes"] = [0, 1]
    return gltf


def test_parts_follow_one_another_or_are_chosen_by_name(write):
    path = write(two_heads())
    with pytest.warns(UserWarning, match=r"its parts are 'Head' \(4 vertices\), 'Head \(2\)'"):
        both = read_mesh(path)
    np.testing.assert_allclose(both.vertices, np.vstack([MM, MM + [1000, 0, 0]]), atol=1e-3)
    assert both.faces.tolist() == np.vstack([F, F + 4]).tolist()
    second = read_mesh(path, mesh="Head (2)")
    np.testing.assert_allclose(second.vertices, MM + [1000, 0, 0], atol=1e-3)
    assert [m.n_vertices for m in read_parts(path).values()] == [4, 4]
    with pytest.raises(
        ValueError, match=r"mesh='HeadMesh' is not in it; its parts are 'Head', 'He"
    ):
        read_mesh(path, mesh="HeadMesh")  # two nodes show it


def test_a_mesh_is_found_by_its_own_name_too(write):
    gltf = Gltf()
    gltf.json["meshes"][0]["name"] = "HeadMesh"
    assert read_mesh(write(gltf), mesh="HeadMesh").n_vertices == 4


def test_targets_that_read_mesh_leaves_out_are_said(write):
    gltf = Gltf()
    gltf.target(0.1 * V)
    with pytest.warns(UserWarning, match="left out .1 of 'Head'.; facelab.read_rig reads them"):
        read_mesh(write(gltf))


# --- files beside files ---------------------------------------------------------------------------


def test_a_text_gltf_reads_its_data_from_the_folder_or_from_within(tmp_path):
    gltf = Gltf()
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "the data.bin").write_bytes(gltf.binary)
    inside = "data:application/octet-stream;base64," + base64.b64encode(gltf.binary).decode()
    for uri in ("more/the%20data.bin", inside):
        gltf.json["buffers"] = [{"byteLength": len(gltf.binary), "uri": uri}]
        (tmp_path / "a.gltf").write_text(json.dumps(gltf.json))
        np.testing.assert_allclose(read_mesh(tmp_path / "a.gltf").vertices, MM, atol=1e-5)


@pytest.mark.parametrize(
    "uri, error, words",
    [
        ("../secret.bin", ValueError, "only read from the folder of the file"),
        ("/etc/passwd", ValueError, "only read from the folder of the file"),
        ("http://x.org/a.bin", ValueError, "only read from the folder of the file"),
        ("%2e%2e/secret.bin", ValueError, "only read from the folder of the file"),
        ("nowhere.bin", FileNotFoundError, "there is no such file of data"),
        (".", ValueError, "is not a file"),
        ("pipe", ValueError, "is not a file"),
        ("data:;base64,!!!", ValueError, "is damaged: it is no base64"),
        ("data:text/plain,abc", ValueError, "holds no data in base64"),
        ("short.bin", ValueError, "but its data end after 4 bytes"),
    ],
)
def test_data_from_elsewhere_or_broken_data_are_refused(tmp_path, uri, error, words):
    folder = tmp_path / "in"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    (folder / "short.bin").write_bytes(bytes(4))
    os.mkfifo(folder / "pipe")
    gltf = Gltf()
    gltf.json["buffers"] = [{"byteLength": len(gltf.binary), "uri": uri}]
    (folder / "a.gltf").write_text(json.dumps(gltf.json))
    with pytest.raises(error, match=words):
        read_mesh(folder / "a.gltf")


@pytest.mark.parametrize("name", ["a.glb", "a.obj", "a.ply", "a.stl", "a.vrm"])
def test_a_pipe_in_place_of_a_file_is_refused(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ValueError, match=r"is not a file; give the path of one"):
        read_mesh(tmp_path / name)


# --- hostile and broken ---------------------------------------------------------------------------


def changed(change):
    gltf = Gltf()
    gltf.target(0.1 * V)
    change(gltf.json)
    return gltf


def put(*keys):
    """A change of the JSON: all keys but the last are the way, the last is the value."""

    def change(data):
        *way, last, value = keys
        for key in way:
            data = data[key]
        data[last] = value

    return change


@pytest.mark.parametrize(
    "change, words",
    [
        (
            put("accessors", 0, "count", 5),
            r"accessors\[0\] needs 60 bytes, but its buffer view has",
        ),
        (put("accessors", 0, "count", 10**15), r"accessors\[0\] needs .* bytes"),
        (put("accessors", 0, "count", 4.5), r"accessors\[0\].count is 4.5, but must be a whole"),
        (put("accessors", 0, "count", True), r"accessors\[0\].count is True, but must be a whole"),
        (put("accessors", 0, "count", "4"), r"accessors\[0\].count is '4', but must be a whole"),
        (put("accessors", 0, "count", 10**30), r"accessors\[0\].count is 10+, but must be a whole"),
        (put("accessors", 0, "byteOffset", 2), r"accessors\[0\] lies askew"),
        (put("accessors", 0, "byteOffset", -4), r"byteOffset is -4, but must be a whole number"),
        (put("accessors", 0, "componentType", 7), "componentType is 7, but must be one of 5120"),
        (put("accessors", 0, "type", "VEC2"), r"accessors\[0\].type is 'VEC2', but must be VEC3"),
        (put("accessors", 1, "componentType", 5126), "must be 5121, 5123 or 5125"),
        (put("accessors", 2, "count", 3), "POSITION has 3 elements, but the mesh 4 vertices"),
        (put("accessors", 0, "bufferView", 9), r"bufferView is 9, but must be .* 0 to 2"),
        (put("bufferViews", 0, "byteLength", 9999), r"bufferViews\[0\] ends at byte 9999"),
        (put("bufferViews", 0, "byteStride", 5), "must be a multiple of 4 from 4 to 252"),
        (put("bufferViews", 0, "byteStride", 8), r"accessors\[0\] lies askew"),
        (put("bufferViews", 0, "buffer", 1), r"buffer is 1, but must be a whole number, 0 to 0"),
        (put("buffers", [{"byteLength": 4}]), "the binary chunk has"),
        (put("buffers", [{"byteLength": 9999}]), "its data end after"),
        (put("meshes", 0, "primitives", 0, "indices", 0), "type is 'VEC3', but must be SCALAR"),
        (put("meshes", 0, "primitives", 0, "mode", 7), "mode is 7, but must be .* 0 to 6"),
        (put("meshes", 0, "primitives", 0, "attributes", {}), "POSITION is missing"),
        (put("nodes", 0, "mesh", 1), r"nodes\[0\].mesh is 1, but must be"),
        (put("nodes", 0, "matrix", [1] * 15), "matrix is .* but must be a list of 16 numbers"),
        (put("nodes", 0, "scale", [1, 1, None]), "scale is .* but must be a list of 3 numbers"),
        (put("nodes", 0, "scale", [1, 1, "1"]), "scale is .* but must be a list of 3 numbers"),
        (put("nodes", 0, "rotation", [0, 0, 0, 2]), "must be a quaternion of length 1"),
        (put("nodes", 0, "scale", [1e300, 1e300, 1]), "beyond|squashed"),
        (put("nodes", 0, "children", [4]), r"must be a whole number, 0 to 0"),
        (put("scene", 3), "scene is 3, but must be a whole number, 0 to 0"),
        (put("scenes", 0, "nodes", []), "no mesh in its scene"),
        (put("nodes", {}), "nodes is .* but must be a list of objects"),
        (put("asset", "version", "1.0"), "asset.version is '1.0', but glTF 2.0 is read"),
        (put("asset", {}), "asset.version is 'missing'"),
    ],
)
def test_what_does_not_agree_is_refused_with_its_place(write, change, words):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match=rf"face\.glb: .*({words})"):
            part(write(changed(change)))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
@pytest.mark.parametrize("which", ["vertex", "target"])
def test_numbers_that_are_none_are_refused(write, value, which):
    gltf = Gltf()
    moved = V.astype("<f4")
    moved[2, 1] = value
    if which == "vertex":
        gltf.primitive["attributes"]["POSITION"] = gltf.add(moved)
    else:
        gltf.target(moved)
    with pytest.raises(ValueError, match=r"face.glb: .*(NaN|beyond)"):
        part(write(gltf))


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda d: d[:10], "the file ends after 10 bytes"),
        (lambda d: d[:-4], "the header promises"),
        (lambda d: d[:4] + struct.pack("<I", 1) + d[8:], "GLB version 1, but version 2 is read"),
        (lambda d: d[:12] + struct.pack("<I", 9999) + d[16:], "chunk at byte 12 does not fit"),
        (lambda d: d[:16] + b"BIN\0" + d[20:], "first chunk is not JSON"),
        (lambda d: d.replace(b'"asset"', b'"asset\xff'), "is no UTF-8 text"),
        (lambda d: d.replace(b'"scene":', b'"scene";'), "JSON breaks off or is damaged in line 1"),
        (lambda d: d.replace(b'"scene": 0, ', b'"scene":NaN,'), "NaN is no number"),
        (
            lambda d: d.replace(b'"scene":', b'"asset":', 1),
            "the key 'asset' is in one object twice",
        ),
    ],
)
def test_a_broken_container_is_refused(write, change, words):
    data = bytearray(change(Gltf().glb()))
    if "promises" not in words and len(data) > 20:
        struct.pack_into("<I", data, 8, len(data))
    with pytest.raises(ValueError, match=rf"face\.glb: .*{words}"):
        read_mesh(write(bytes(data)))


@pytest.mark.parametrize("deep", ["[" * 10**5 + "]" * 10**5, '{"a":' * 10**5 + "1" + "}" * 10**5])
def test_json_that_is_nested_without_end_is_refused(write, deep):
    with pytest.raises(ValueError, match=r"face\.glb: .*nested too deep"):
        read_mesh(write(Gltf().glb(('{"asset": {"version": "2.0"}, "x": ' + deep + "}").encode())))


@pytest.fixture
def memory_limit():
    """At most 1 GB more than now."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 10**9, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def from_nothing(data):
    """Positions of zeros that no buffer holds: the file stays as small as it was."""
    del data["accessors"][0]["bufferView"]
    data["accessors"][0]["count"] = 5 * 10**8


def many_targets(data):
    data["accessors"][0]["count"] = 10**5
    del data["accessors"][0]["bufferView"]
    data["accessors"].append({"componentType": 5126, "count": 10**5, "type": "VEC3"})
    data["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 3}] * 10**4


def many_nodes(data):
    data["accessors"][0]["count"] = 10**6
    del data["accessors"][0]["bufferView"], data["meshes"][0]["primitives"][0]["targets"]
    data["nodes"] = [{"mesh": 0}] * 10**3
    data["scenes"][0]["nodes"] = list(range(10**3))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="tells memory by /proc")
@pytest.mark.parametrize("change", [from_nothing, many_targets, many_nodes])
def test_a_small_file_takes_no_gigabytes(write, memory_limit, change):
    with pytest.raises(ValueError, match=r"would unfold to .* MB, far more than a file of this"):
        path = write(changed(change))
        read_mesh(path) if change is many_nodes else part(path)


def test_bounds_that_the_data_do_not_keep_are_said(write):
    gltf = Gltf()
    gltf.json["accessors"][0] |= {"min": [0, 0, 0], "max": [0.1, 0.05, 0.02]}
    with pytest.warns(UserWarning, match=r"accessors\[0\] holds .* but declares"):
        part(write(gltf))


def test_a_key_that_gltf_does_not_know_is_said(write):
    with pytest.warns(UserWarning, match=r"accessors\[0\] has 'byteOfset', which glTF does not"):
        part(write(changed(put("accessors", 0, "byteOfset", 4))))


# --- mutants --------------------------------------------------------------------------------------


def contradicts(found, data, said):
    """What the file itself denies: counts, indices, finiteness, the bounds it declares."""
    if said:
        return ""
    text = data
    if data[:4] == b"glTF":
        text = data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]
    told = json.loads(text.decode("utf-8-sig"))
    return min((denied_by(mesh, told, found) for mesh in told["meshes"]), key=len)


def denied_by(mesh, told, found):
    """What one mesh of the file denies, packed or not."""
    if "attributes" not in mesh["primitives"][0]:
        return "a mesh without attributes"
    at = told["accessors"][mesh["primitives"][0]["attributes"]["POSITION"]]
    if len(found.vertices) != at["count"]:
        return "other number of vertices"
    if not np.isfinite(found.vertices).all() or not np.isfinite(found.deltas).all():
        return "not finite"
    if found.faces.min() < 0 or found.faces.max() >= at["count"]:
        return "indices out of range"
    if len(found.deltas) != len(mesh["primitives"][0].get("targets", [])):
        return "other number of targets"
    names = mesh.get("extras", {}).get("targetNames", [""] * len(found.deltas))
    return "" if found.names == names else "other names"


@pytest.mark.parametrize("kind", ["glb", "gltf", "avatar_meshopt", DRACO])
def test_mutants_of_a_gltf_are_refused_in_our_words_or_read_as_they_stand(tmp_path, rng, kind):
    name = f"a.{kind}"
    if kind in ("glb", "gltf"):
        face = grid_mesh(6, 5, spacing=30.0)
        write_glb(tmp_path / "b.glb", face, rng.normal(size=(2, 30, 3)), ["jawOpen", "blink"])
        data = (tmp_path / "b.glb").read_bytes()
        if kind == "gltf":
            size = struct.unpack_from("<I", data, 12)[0]
            told = json.loads(data[20 : 20 + size])
            inside = base64.b64encode(data[28 + size :]).decode()
            told["buffers"][0]["uri"] = "data:;base64," + inside
            data = json.dumps(told, indent=1).encode()
    else:
        data, name = (FIXTURES / f"{kind}.glb").read_bytes(), "a.glb"
    found = tally(part, data, name, tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found


def test_a_glb_of_ours_and_of_others_keeps_order_and_faces(tmp_path):
    ball = sphere_mesh(1, radius=80.0)
    write_glb(tmp_path / "a.glb", ball)
    again = read_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)
    np.testing.assert_array_equal(again.faces, ball.faces)
    trimesh.Trimesh(ball.vertices / 1000, ball.faces, process=False).export(tmp_path / "b.glb")
    again = read_mesh(tmp_path / "b.glb")
    np.testing.assert_allclose(again.vertices, ball.vertices, atol=1e-5)
    np.testing.assert_array_equal(again.faces, ball.faces)


@pytest.mark.parametrize("cut", [0.02, 0.1, 0.3, 0.5, 0.9, 0.99, 0.999])
def test_a_glb_cut_short_is_refused(write, cut):
    data = Gltf().glb()
    with pytest.raises(ValueError, match=r"face\.glb"):
        read_mesh(write(data[: int(len(data) * cut)]))
