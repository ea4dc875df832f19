"""Shapes and takes written into a user's own file: what was there keeps its bytes."""

import base64
import copy
import importlib.util
import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from shapes import grid_mesh

from facelab.files import read_rig, write_glb, write_into
from facelab.files.gltf_read import GltfScene
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
HAS_DRACO = importlib.util.find_spec("DracoPy") is not None
DRACO = pytest.param(
    "avatar_draco", marks=pytest.mark.skipif(not HAS_DRACO, reason="DracoPy is not installed")
)
PLAIN = ("avatar", "avatar_quantised", "avatar_sparse")
PACKED = ("avatar_meshopt", DRACO)


def opened(path):
    """JSON and binary chunk of a GLB."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def avatar(name):
    return read_rig(FIXTURES / f"{name}.glb", mesh="Head")


@pytest.fixture
def shapes(rng):
    """Of the avatar's head: one that moves all of it, one that moves a corner."""
    n = avatar("avatar").neutral.vertices.shape
    corner = np.zeros(n)
    corner[:3] = rng.normal(size=(3, 3))
    return {"all of it": rng.normal(size=n), "a corner": corner}


def a_take(names, n_frames=5):
    rng = np.random.default_rng(3)
    return WeightSequence(rng.uniform(0, 1, (n_frames, len(names))), names, 30)


def test_a_glb_that_is_called_gltf_keeps_its_bytes_too(tmp_path, shapes):
    shutil.copy(FIXTURES / "avatar.glb", tmp_path / "mine.gltf")
    write_into(tmp_path / "new.gltf", read_rig(tmp_path / "mine.gltf", mesh="Head"), shapes)
    again = read_rig(tmp_path / "new.gltf", mesh="Head")
    assert again.names[-2:] == tuple(shapes)
    np.testing.assert_allclose(again.deltas[-1], shapes["a corner"], atol=1e-4)


@pytest.mark.filterwarnings("ignore:.*is written uncompressed")
@pytest.mark.parametrize("name", [*PLAIN, *PACKED])
def test_shapes_come_back_as_they_were_given_and_the_old_ones_stay(tmp_path, shapes, name):
    rig = avatar(name)
    write_into(tmp_path / "new.glb", rig, shapes)
    again = read_rig(tmp_path / "new.glb", mesh="Head")
    assert again.names == (*rig.names, *shapes)
    n = len(rig.names)
    np.testing.assert_array_equal(again.neutral.vertices, rig.neutral.vertices)
    np.testing.assert_array_equal(again.neutral.faces, rig.neutral.faces)
    np.testing.assert_array_equal(again.deltas[:n], rig.deltas)
    np.testing.assert_allclose(again.deltas[n:], list(shapes.values()), atol=2e-5)
    assert again.parts.keys() == rig.parts.keys()


@pytest.mark.parametrize("name", PLAIN)
def test_all_else_keeps_its_bytes(tmp_path, shapes, name):
    rig = avatar(name)
    write_into(tmp_path / "new.glb", rig, shapes, a_take(["jawOpen"]))
    (old, before), (new, after) = opened(FIXTURES / f"{name}.glb"), opened(tmp_path / "new.glb")
    assert after.startswith(before)
    for key in ("accessors", "bufferViews"):
        assert new[key][: len(old[key])] == old[key]
    stripped = copy.deepcopy(new)
    head = next(mesh for mesh in stripped["meshes"] if mesh.get("name") == "HeadMesh")
    head["extras"]["targetNames"] = head["extras"]["targetNames"][:4]
    for primitive in head["primitives"]:
        primitive["targets"] = primitive["targets"][:4]
    for key in old.keys() - {"accessors", "bufferViews", "buffers", "animations"}:
        assert stripped[key] == old[key], key
    assert new["animations"][:-1] == old.get("animations", [])


@pytest.mark.parametrize("name", PACKED)
def test_a_compressed_file_is_written_uncompressed_and_that_is_said(tmp_path, shapes, name):
    with pytest.warns(UserWarning, match=r"compressed with (EXT_mesh|KHR_draco).*uncompressed"):
        write_into(tmp_path / "new.glb", avatar(name), shapes)
    told = (tmp_path / "new.glb").read_bytes()
    assert b"EXT_meshopt_compression" not in told and b"KHR_draco" not in told
    plain, new = GltfScene(FIXTURES / f"{name}.glb"), GltfScene(tmp_path / "new.glb")
    assert new.names == plain.names
    for k in range(3):
        np.testing.assert_array_equal(new.part(k).vertices, plain.part(k).vertices)
        np.testing.assert_array_equal(new.part(k).faces, plain.part(k).faces)


def keys_of(path, number=-1):
    """Times and weights of an animation, read in the plainest way."""
    told, body = opened(path)
    animation = told["animations"][number]
    sampler = animation["samplers"][animation["channels"][0]["sampler"]]
    found = []
    for key in ("input", "output"):
        at = told["accessors"][sampler[key]]
        view = told["bufferViews"][at["bufferView"]]
        start = view.get("byteOffset", 0) + at.get("byteOffset", 0)
        found.append(np.frombuffer(body, "<f4", at["count"], start))
    return found


def test_a_take_drives_old_and_new_shapes_and_lost_frames_have_no_key(tmp_path, shapes):
    rig = avatar("avatar")
    take = a_take(["jawOpen", "a corner", "eyeBlinkLeft"])
    valid = np.array([True, True, False, True, True])
    take = WeightSequence(take.weights, take.names, 30, valid)
    write_into(tmp_path / "new.glb", rig, shapes, take)
    times, weights = keys_of(tmp_path / "new.glb")
    np.testing.assert_allclose(times, np.array([0, 1, 3, 4]) / 30, atol=1e-6)
    names = [*rig.names, *shapes]
    wanted = np.zeros((5, len(names)))
    for k, name in enumerate(take.names):
        wanted[:, names.index(name)] = take.weights[:, k]
    np.testing.assert_allclose(weights.reshape(4, -1), wanted[valid], atol=1e-6)


def test_animations_that_were_there_play_as_before(tmp_path, rng):
    mesh = grid_mesh(6, 5, spacing=30.0)
    deltas, weights = rng.normal(size=(2, 30, 3)), rng.uniform(size=(3, 2))
    write_glb(tmp_path / "a.glb", mesh, deltas, ["a", "b"], [0, 0.5, 1], weights, "SMOOTH")
    rig = read_rig(tmp_path / "a.glb")
    write_into(tmp_path / "b.glb", rig, {"c": deltas[0]})
    rows = keys_of(tmp_path / "b.glb")[1].reshape(3, 3, 3)  # key; tangent, value, tangent; target
    np.testing.assert_allclose(rows[:, 1, :2], weights, atol=1e-6)
    assert not rows[:, [0, 2]].any() and not rows[..., 2].any()


def test_the_file_itself_can_be_written_into_again_and_again(tmp_path, shapes):
    path = Path(shutil.copy(FIXTURES / "avatar.glb", tmp_path / "mine.glb"))
    for k in range(3):
        write_into(path, read_rig(path, mesh="Head"), {f"pose {k}": shapes["a corner"]})
    rig = read_rig(path, mesh="Head")
    assert rig.names[-3:] == ("pose 0", "pose 1", "pose 2")
    np.testing.assert_allclose(rig.deltas[-1], shapes["a corner"], atol=2e-5)


def test_a_text_gltf_keeps_what_lies_beside_it(tmp_path, shapes):
    told, body = opened(FIXTURES / "avatar.glb")
    told["buffers"][0]["uri"] = "mine.bin"
    (tmp_path / "mine.bin").write_bytes(body)
    (tmp_path / "mine.gltf").write_text(json.dumps(told))
    rig = read_rig(tmp_path / "mine.gltf", mesh="Head")
    write_into(tmp_path / "new.gltf", rig, shapes)
    assert (tmp_path / "mine.bin").read_bytes() == body
    again = read_rig(tmp_path / "new.gltf", mesh="Head")
    np.testing.assert_allclose(again.deltas[-1], shapes["a corner"], atol=2e-5)
    (tmp_path / "other").mkdir()
    with pytest.raises(ValueError, match=r"keeps 'mine\.bin' beside it; write into the same"):
        write_into(tmp_path / "other" / "new.gltf", rig, shapes)


NODE = shutil.which("node")


@pytest.mark.filterwarnings("ignore:.*is written uncompressed")
@pytest.mark.parametrize("name", [*PLAIN, *PACKED])
def test_khronos_validator_finds_nothing_new(tmp_path, shapes, name):
    def issues(path):
        run = [NODE, FIXTURES / "validate.cjs", path]
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        if "Cannot find module 'gltf-validator'" in done.stderr:
            pytest.skip("Khronos' validator is not there: npm install gltf-validator")
        found = [m for m in json.loads(done.stdout)["messages"] if m["severity"] < 2]
        # in packed data the validator cannot see it
        return {m["code"] for m in found} - {"ACCESSOR_JOINTS_USED_ZERO_WEIGHT"}

    if NODE is None:
        pytest.skip("Khronos' validator needs node")
    write_into(tmp_path / "new.glb", avatar(name), shapes, a_take(["jawOpen", "a corner"]))
    assert issues(tmp_path / "new.glb") <= issues(FIXTURES / f"{name}.glb")


# --- what other programs write --------------------------------------------------------------------


@pytest.fixture
def edited(tmp_path):
    """Write the avatar after a change to its JSON, with another binary chunk or further ones."""

    def edited(change, body=None, further=b"", name="avatar"):
        told, own = opened(FIXTURES / f"{name}.glb")
        change(told)
        text = json.dumps(told).encode()
        text += b" " * (-len(text) % 4)
        body = own if body is None else body
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(body), b"BIN\0") + body + further
        path = tmp_path / "mine.glb"
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    return edited


def mesh_of(told, name="Head"):
    return next(told["meshes"][n["mesh"]] for n in told["nodes"] if n.get("name") == name)


def unindexed(primitive, packed):
    del primitive["indices"]


def as_strip(primitive, packed):
    primitive["mode"] = 5


def one_more(primitive, packed):
    packed["_OTHER"] = 99


@pytest.mark.filterwarnings("ignore:.*is written uncompressed")
@pytest.mark.skipif(not HAS_DRACO, reason="DracoPy is not installed")
@pytest.mark.parametrize("change", [unindexed, as_strip, one_more])
def test_draco_in_all_its_ways_is_written_as_it_was_read(edited, tmp_path, shapes, change):
    def all_of(told):
        for primitive in (p for mesh in told["meshes"] for p in mesh["primitives"]):
            packed = primitive["extensions"]["KHR_draco_mesh_compression"]
            change(primitive, packed["attributes"])

    rig = read_rig(edited(all_of, name="avatar_draco"), mesh="Head")
    write_into(tmp_path / "new.glb", rig, shapes)
    again = read_rig(tmp_path / "new.glb", mesh="Head")
    np.testing.assert_array_equal(again.neutral.faces, rig.neutral.faces)
    np.testing.assert_array_equal(again.neutral.vertices, rig.neutral.vertices)


@pytest.mark.skipif(not HAS_DRACO, reason="DracoPy is not installed")
@pytest.mark.parametrize("semantic", ["NORMAL", "TEXCOORD_0"])
def test_draco_that_lacks_what_it_promises_is_refused_by_its_name(
    edited, tmp_path, shapes, semantic
):
    def change(told):
        (primitive,) = mesh_of(told)["primitives"]
        primitive["extensions"]["KHR_draco_mesh_compression"]["attributes"][semantic] = 99
        primitive["attributes"][semantic] = primitive["attributes"]["POSITION"]

    rig = read_rig(edited(change, name="avatar_draco"), mesh="Head")
    with pytest.raises(ValueError, match=f"Draco data that do not hold the .* {semantic}"):
        write_into(tmp_path / "new.glb", rig, shapes)
    assert not (tmp_path / "new.glb").exists()


def test_primitives_that_share_their_vertices_share_new_shapes(edited, tmp_path, shapes):
    def cut(told):
        first = mesh_of(told)["primitives"][0]
        at = told["accessors"][first["indices"]]
        width = {5123: 2, 5125: 4}[at["componentType"]]
        half = at["count"] // 6 * 3
        rest = {**at, "count": at["count"] - half}
        rest["byteOffset"] = at.get("byteOffset", 0) + half * width
        at["count"] = half
        told["accessors"].append(rest)
        mesh_of(told)["primitives"].append({**first, "indices": len(told["accessors"]) - 1})

    path = edited(cut)
    rig = read_rig(path, mesh="Head")
    for name, moved in shapes.items():  # twice, for it has to stay so
        write_into(path, rig, {name: moved})
        before, rig = rig, read_rig(path, mesh="Head")
        assert len(rig.source.index) == len(before.source.index)
        np.testing.assert_allclose(rig.deltas[-1], moved, atol=2e-5)


def test_chunks_that_mean_nothing_to_gltf_are_kept(edited, tmp_path, shapes):
    chunk = struct.pack("<I4s", 8, b"MINE") + b"12345678"
    rig = read_rig(edited(lambda told: None, further=chunk), mesh="Head")
    write_into(tmp_path / "new.glb", rig, shapes)
    assert (tmp_path / "new.glb").read_bytes().endswith(chunk)


def test_a_first_buffer_that_is_not_the_binary_chunk_keeps_its_bytes(edited, tmp_path, shapes):
    body = opened(FIXTURES / "avatar.glb")[1]
    uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
    rig = read_rig(edited(lambda told: told["buffers"][0].update(uri=uri), b"1234"), mesh="Head")
    write_into(tmp_path / "new.glb", rig, shapes)
    told, binary = opened(tmp_path / "new.glb")
    assert (told["buffers"][0]["uri"], binary) == (uri, b"1234")
    np.testing.assert_allclose(
        read_rig(tmp_path / "new.glb", mesh="Head").deltas[-1], shapes["a corner"], atol=2e-5
    )


@pytest.mark.parametrize("extras", ["text", 5, None, [1], {"mine": 1}], ids=str)
def test_extras_may_be_anything(edited, tmp_path, shapes, extras):
    with pytest.warns(UserWarning, match="have no name"):
        rig = read_rig(edited(lambda told: mesh_of(told).update(extras=extras)), mesh="Head")
    write_into(tmp_path / "new.glb", rig, shapes)
    found = mesh_of(opened(tmp_path / "new.glb")[0])["extras"]
    assert found.pop("targetNames") == [*rig.names, *shapes]
    assert found == (extras if isinstance(extras, dict) else {})


def test_half_a_character_in_a_name_stays_as_it_was(edited, tmp_path, shapes):
    def rename(told):
        mesh_of(told)["extras"]["targetNames"][0] = "\ud83d"

    write_into(tmp_path / "new.glb", read_rig(edited(rename), mesh="Head"), shapes)
    assert read_rig(tmp_path / "new.glb", mesh="Head").names[0] == "\ud83d"


def with_animation(told):
    """Two nodes, with a mesh of four shapes each, moved by one sampler."""
    told["meshes"].append(copy.deepcopy(mesh_of(told)))
    head = next(k for k, node in enumerate(told["nodes"]) if node.get("name") == "Head")
    told["nodes"].append({"mesh": len(told["meshes"]) - 1, "name": "Twin"})
    twin = len(told["nodes"]) - 1
    told["scenes"][0]["nodes"].append(twin)
    keys = {"componentType": 5126, "type": "SCALAR"}  # without a view: zeros
    told["accessors"] += [{**keys, "count": 2, "min": [0], "max": [0]}, {**keys, "count": 8}]
    n = len(told["accessors"])
    channels = [{"sampler": 0, "target": {"node": k, "path": "weights"}} for k in (head, twin)]
    samplers = [{"input": n - 2, "output": n - 1}]
    told["animations"] = [{"samplers": samplers, "channels": channels}]


def test_what_moves_by_the_same_keys_is_not_changed(edited, tmp_path, shapes):
    path = edited(with_animation)
    write_into(tmp_path / "new.glb", read_rig(path, mesh="Head"), shapes)
    told = opened(tmp_path / "new.glb")[0]
    animation = told["animations"][0]
    used = [animation["samplers"][c["sampler"]]["output"] for c in animation["channels"]]
    assert [told["accessors"][k]["count"] for k in used] == [2 * 6, 2 * 4]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda told: told.update(animations={}), "animations is {}, but must be a list"),
        (
            lambda told: told["animations"][0]["channels"][0].update(sampler=7),
            r"animations\[0\]\.channels\[0\]\.sampler is 7, but must be a whole number, 0 to 0",
        ),
        (
            lambda told: told["accessors"][-1].update(count=7),
            r"samplers\[0\]\.output has 7 weights, which are no rows of 4",
        ),
    ],
    ids=["no list", "sampler", "rows"],
)
def test_animations_that_are_damaged_are_refused_with_their_place(
    edited, tmp_path, shapes, change, words
):
    def damaged(told):
        with_animation(told)
        change(told)

    with pytest.raises(ValueError, match=words):
        write_into(tmp_path / "new.glb", read_rig(edited(damaged), mesh="Head"), shapes)
    assert not (tmp_path / "new.glb").exists()


def test_parts_that_a_take_drives_move_along(tmp_path):
    rig, take = avatar("avatar"), a_take(["jawOpen", "eyeBlinkLeft"])
    write_into(tmp_path / "new.glb", rig.renamed({"jawOpen": "mouth"}), take=take)
    assert len(opened(tmp_path / "new.glb")[0]["animations"][0]["channels"]) == 1
    write_into(tmp_path / "new.glb", rig, take=take)
    told, body = opened(tmp_path / "new.glb")
    animation = told["animations"][0]
    channel = animation["channels"][1]
    assert told["nodes"][channel["target"]["node"]]["name"] == "Teeth"
    at = told["accessors"][animation["samplers"][channel["sampler"]]["output"]]
    start = told["bufferViews"][at["bufferView"]]["byteOffset"]
    found = np.frombuffer(body, "<f4", at["count"], start)
    np.testing.assert_allclose(found, take.weights[:, 0], atol=1e-6)  # its one shape


def test_a_pose_of_some_of_the_vertices_goes_back_and_the_others_stay(tmp_path):
    rig = avatar("avatar")
    kept = np.flatnonzero(rig.neutral.vertices[:, 2] > 0)
    face = rig.on(kept)
    moved = np.random.default_rng(0).normal(size=(len(kept), 3))
    write_into(tmp_path / "new.glb", face, {"pose": moved}, a_take(["jawOpen", "pose"]))
    found = read_rig(tmp_path / "new.glb", mesh="Head").deltas[-1]
    np.testing.assert_allclose(found[kept], moved, atol=2e-5)
    assert not np.delete(found, kept, axis=0).any()
    with pytest.raises(ValueError, match=rf"has {len(kept)} vertices, but the rig .* lab\.rig"):
        write_into(tmp_path / "new.glb", rig, {"pose": moved})


def test_time_that_is_missing_in_a_take_passes_in_the_animation(tmp_path):
    take = a_take(["jawOpen"])
    take = WeightSequence(take.weights, take.names, 30, gaps={3: 5.0})
    write_into(tmp_path / "new.glb", avatar("avatar"), take=take)
    times = keys_of(tmp_path / "new.glb")[0]
    np.testing.assert_allclose(times, np.arange(5) / 30 + [0, 0, 0, 5, 5], atol=1e-6)


# --- OBJ ------------------------------------------------------------------------------------------

REST = """# a head
o head
v 0 0 0 1 0.5 0
v 100.25 0 0 1 0 0
v 100 100 0 1 0 0
v\t0 100 0 1 0 0
v 50 200 0.125 1 0 0
vt 0 0
vt 1 0
usemtl skin
g lower
f 1/1 2/2 3/2 4/1
g upper
f 4/1 3/2 5/1
"""


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "rig"
    folder.mkdir()
    (folder / "neutral.obj").write_text(REST)
    (folder / "smile.obj").write_text(REST.replace("50 200", "55 200"))
    return folder


def test_an_obj_keeps_quads_groups_and_texture_coordinates(folder, tmp_path):
    rig = read_rig(folder)
    moved = np.zeros((5, 3))
    moved[4] = [1, 2, 0.5]
    write_into(tmp_path / "out", rig, {"up": moved, "none": 0 * moved})
    assert (tmp_path / "out" / "none.obj").read_text() == REST
    up = REST.replace("v 50 200 0.125 1 0 0", "v 51 202 0.625 1 0 0")
    assert (tmp_path / "out" / "up.obj").read_text() == up
    write_into(tmp_path / "up.obj", rig, {"up": moved})
    assert (tmp_path / "up.obj").read_text() == up


# --- refusals -------------------------------------------------------------------------------------


def test_what_does_not_fit_is_refused_and_nothing_is_written(folder, tmp_path, shapes):
    rig, obj, out = avatar("avatar"), read_rig(folder), tmp_path / "new.glb"
    loose = BlendshapeRig(rig.neutral, rig.names, rig.deltas)
    moved = {"up": np.zeros((5, 3))}
    for words, call in {
        "it was not read from a file": lambda: write_into(out, loose, shapes),
        "has jawOpen already": lambda: write_into(out, rig, {"jawOpen": shapes["a corner"]}),
        r"shapes\['x'\] has 2 vertices": lambda: write_into(out, rig, {"x": np.zeros((2, 3))}),
        "there is nothing to write": lambda: write_into(out, rig),
        r"does not end in \.glb": lambda: write_into(tmp_path / "new.obj", rig, shapes),
        "drives": lambda: write_into(out, rig, take=a_take(["tongueOut"])),
        "OBJ files .* hold no animation": lambda: write_into(folder, obj, moved, a_take(["smile"])),
        "is one OBJ file, but there are 2": lambda: write_into(
            tmp_path / "a.obj", obj, {**moved, "b": moved["up"]}
        ),
        "differ only in capitals": lambda: write_into(
            tmp_path / "o", obj, {**moved, "Up": moved["up"]}
        ),
        "makes no file name": lambda: write_into(tmp_path / "o", obj, {"../x": moved["up"]}),
        "give each shape a name": lambda: write_into(out, rig, {"": shapes["a corner"]}),
    }.items():
        with pytest.raises(ValueError, match=words):
            call()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig"]


def test_a_file_that_has_changed_since_is_refused(tmp_path, shapes):
    path = Path(shutil.copy(FIXTURES / "avatar.glb", tmp_path / "mine.glb"))
    rig = read_rig(path, mesh="Head")
    write_into(path, rig, shapes)
    with pytest.raises(ValueError, match=r"6 shapes, but the rig was read from .* and 4"):
        write_into(path, rig, shapes)


@pytest.mark.parametrize("way", ["another order", "another unit"])
def test_a_file_whose_vertices_have_changed_is_refused(folder, tmp_path, rng, way):
    mesh = grid_mesh(6, 5, spacing=30.0)
    deltas = rng.normal(size=(1, 30, 3))
    glb, new = tmp_path / "face.glb", tmp_path / "new.glb"
    write_glb(glb, mesh, deltas, ["a"])
    rig, of_folder = read_rig(glb), read_rig(folder)
    if way == "another order":
        write_glb(glb, type(mesh)(mesh.vertices[::-1], 29 - mesh.faces), deltas[:, ::-1], ["a"])
        turned = REST.replace("v 50 200", "v 51 200")
    else:
        write_glb(glb, mesh.with_vertices(2 * mesh.vertices), deltas, ["a"])
        turned = REST.replace("v 50 200", "v 100 400")
    with pytest.raises(ValueError, match=r"vertices lie up to .* mm from those of the rig"):
        write_into(new, rig, {"b": deltas[0]})
    (folder / "neutral.obj").write_text(turned)
    with pytest.raises(ValueError, match=r"vertices lie up to .* mm from those of the rig"):
        write_into(tmp_path / "out", of_folder, {"b": np.ones((5, 3))})
    assert not new.exists() and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["neutral", "NEUTRAL", "Smile"])
def test_shapes_beside_the_face_at_rest_do_not_write_over_others(folder, name):
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    rig = read_rig(folder)
    with pytest.raises(ValueError, match=f"has {name.lower()}.obj already; give other names"):
        write_into(folder, rig, {name: np.ones(rig.neutral.vertices.shape)})
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before


def test_an_obj_with_a_byte_order_mark_is_written_into(folder, tmp_path):
    rest = Path(read_rig(folder).source.path)
    for file in folder.iterdir():
        lines = file.read_bytes().split(b"\n")
        first = next(k for k, line in enumerate(lines) if line.startswith(b"v"))
        file.write_bytes(b"\xef\xbb\xbf" + b"\n".join(lines[first:]))
    rig = read_rig(folder)
    write_into(tmp_path / "out", rig, {"up": np.ones(rig.neutral.vertices.shape)})
    assert (tmp_path / "out" / "up.obj").read_bytes()[:4] == rest.read_bytes()[:4]
