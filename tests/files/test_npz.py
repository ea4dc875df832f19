"""Motion and faces as files, and motion as GLB: what is written comes back."""

import json

import numpy as np
import pytest
from planted import bumpy_rig, patch_motion, quarters
from shapes import grid_mesh

import facelab
from facelab import files
from facelab.geometry import bind_to_samples
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence
from facelab.storage import load_npz, save_npz


@pytest.fixture
def motion(rng):
    """A patchwork in motion with two lost frames."""
    mesh, labels = quarters()
    mesh = TriangleMesh(mesh.vertices, mesh.faces, {"chin": 3})
    moved = patch_motion(mesh, labels, rng, n_frames=20)
    positions, valid = moved.positions.astype(np.float32), np.arange(20) % 9 != 4
    positions[~valid] = np.nan
    return MotionSequence(positions, 59.94, mesh, valid)


def test_motion_comes_back_to_the_bit(motion, tmp_path):
    files.write_motion(tmp_path / "m.npz", motion)
    back = files.read_motion(tmp_path / "m.npz")
    np.testing.assert_array_equal(back.positions, motion.positions)
    assert back.positions.dtype == np.float32 and back.fps == motion.fps
    np.testing.assert_array_equal(back.valid, motion.valid)
    np.testing.assert_array_equal(back.mesh.vertices, motion.mesh.vertices)
    np.testing.assert_array_equal(back.mesh.faces, motion.mesh.faces)
    assert back.mesh.landmarks == {"chin": 3}
    assert files.npz_kind(tmp_path / "m.npz") == "motion"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("positions", np.zeros((20, 7, 3))),
        ("positions", np.full((20, 120, 3), np.nan)),
        ("valid", np.ones(3, dtype=bool)),
        ("fps", -1.0),
        ("faces", np.array([[0, 1, 900]])),
        ("landmarks", np.array([900])),
        ("vertices", np.full((120, 3), np.inf)),
    ],
)
def test_motion_whose_parts_do_not_fit_is_refused_by_file(name, value, motion, tmp_path):
    path = tmp_path / "m.npz"
    files.write_motion(path, motion)
    arrays = load_npz(path, "motion", 1) | {name: value}
    save_npz(path, "motion", 1, **arrays)
    with pytest.raises(ValueError, match=r"m\.npz"):
        files.read_motion(path)


def test_a_face_comes_back_with_its_binding(tmp_path):
    mesh = grid_mesh(12, 10, 10.0)
    samples, _ = mesh.subsample(40)
    binding = bind_to_samples(mesh, samples)
    files.write_face(tmp_path / "f.npz", mesh, binding)
    neutral, back = files.read_face(tmp_path / "f.npz")
    np.testing.assert_array_equal(back.samples, samples)
    x = np.random.default_rng(0).normal(size=(40, 2))
    np.testing.assert_array_equal(back.carry(x), binding.carry(x))
    assert back.mesh is neutral
    with pytest.raises(ValueError, match="another face"):
        files.write_face(tmp_path / "g.npz", grid_mesh(12, 10, 11.0), binding)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("samples", lambda a: a + 1000),
        ("columns", lambda a: a + 40),
        ("columns", lambda a: a - 40),
        ("weights", lambda a: a * 1.1),
        ("weights", lambda a: a * np.nan),
        ("rows", lambda a: a[::-1]),
        ("rows", lambda a: a[:-1]),
    ],
)
def test_a_binding_that_is_none_is_refused_by_file(name, change, tmp_path):
    mesh, path = grid_mesh(12, 10, 10.0), tmp_path / "f.npz"
    files.write_face(path, mesh, bind_to_samples(mesh, mesh.subsample(40)[0]))
    arrays = load_npz(path, "face", 1)
    save_npz(path, "face", 1, **arrays | {name: change(arrays[name])})
    with pytest.raises(ValueError, match=r"f\.npz"):
        files.read_face(path)


def test_the_kind_of_somebody_elses_arrays_is_empty(tmp_path):
    np.savez(tmp_path / "own.npz", positions=np.zeros(3))
    assert files.npz_kind(tmp_path / "own.npz") == ""


@pytest.fixture
def face():
    return grid_mesh(12, 10, 15.0)


def test_landmarks_come_back_from_ljson_and_from_plain_json(face, tmp_path):
    marks = {"chin": 3, "nose_tip": 64, "größe": 7}
    files.write_landmarks(tmp_path / "m.ljson", face.vertices, marks)
    assert files.read_landmarks(tmp_path / "m.ljson", face) == marks
    (tmp_path / "m.json").write_text(json.dumps(marks), encoding="utf-8")
    assert files.read_landmarks(tmp_path / "m.json", face) == marks


def test_landmarks_of_another_mesh_are_refused(face, tmp_path):
    files.write_landmarks(tmp_path / "m.ljson", 10 * face.vertices, {"chin": 119})
    with pytest.raises(ValueError, match=r"m\.ljson.* from any vertex, chin .* of another mesh"):
        files.read_landmarks(tmp_path / "m.ljson", face)


@pytest.mark.parametrize(
    "text",
    [
        "{}", "[]", '{"chin": 120}', '{"chin": 1.5}', '{"chin": true}', '{"groups": 3}',
        '{"groups": {"PTS": {}}}',
        '{"groups": {"A": {}, "B": {}}}',
        '{"groups": {"PTS": {"landmarks": {"points": [[0, 0]]}, "labels": []}}}',
        '{"groups": {"PTS": {"landmarks": {"points": [[0, 0, 0]]}, "labels": [7]}}}',
        '{"groups": {"PTS": {"landmarks": {"points": [[0, 0, 0]]}, '
        '"labels": [{"label": "chin", "mask": [false]}]}}}',
    ],
)  # fmt: skip
def test_what_is_no_file_of_landmarks_is_refused_by_file(text, face, tmp_path):
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ValueError, match=r"m\.json"):
        files.read_landmarks(tmp_path / "m.json", face)


# --- motion as GLB, colours in PLY ----------------------------------------------------------------


def test_a_motion_as_glb_is_made_of_weights_within_0_and_1(motion, tmp_path):
    rms = files.write_motion_glb(tmp_path / "m.glb", motion, n_modes=100)
    assert rms < 1e-6
    gltf = read_gltf(tmp_path / "m.glb")
    times, weights = gltf
    assert weights.min() >= 0 and weights.max() <= 1 + 1e-6
    np.testing.assert_allclose(times, np.flatnonzero(motion.valid) / motion.fps, atol=1e-5)
    rig = facelab.read_rig(tmp_path / "m.glb")
    for w, wanted in zip(weights, motion.positions[motion.valid], strict=True):
        np.testing.assert_allclose(rig.shape(w), wanted, atol=1e-3)


def test_fewer_modes_lose_what_is_said(motion, tmp_path):
    few = files.write_motion_glb(tmp_path / "m.glb", motion, n_modes=3)
    _, weights = read_gltf(tmp_path / "m.glb")
    rig = facelab.read_rig(tmp_path / "m.glb")
    wanted = motion.positions[motion.valid].astype(float)
    left = np.array([rig.shape(w) for w in weights]) - wanted
    assert few == pytest.approx(np.sqrt((left**2).sum(axis=2).mean()), rel=1e-4)
    assert few > 0.1


def test_a_face_that_does_not_move_is_a_glb_too(face, tmp_path):
    still = MotionSequence(face.vertices + np.zeros((5, 1, 1)), 30.0, face)
    assert files.write_motion_glb(tmp_path / "m.glb", still) == 0
    lost = MotionSequence(still.positions, 30.0, face, np.zeros(5, dtype=bool))
    with pytest.raises(ValueError, match="no valid frame"):
        files.write_motion_glb(tmp_path / "n.glb", lost)
    assert not (tmp_path / "n.glb").exists()


def read_gltf(path):
    """Times and weights of the animation."""
    import pygltflib

    gltf = pygltflib.GLTF2().load(str(path))
    blob, sampler = gltf.binary_blob(), gltf.animations[0].samplers[0]

    def array(index):
        accessor = gltf.accessors[index]
        view = gltf.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, "<f4", accessor.count, view.byteOffset)

    times = array(sampler.input)
    return times, array(sampler.output).reshape(len(times), -1)


def test_colours_of_a_ply_are_passed_over_by_our_reader(tmp_path, recwarn):
    mesh = bumpy_rig().neutral
    colors = np.random.default_rng(0).uniform(size=(mesh.n_vertices, 3))
    files.write_ply(tmp_path / "c.ply", mesh, colors)
    assert not [w for w in recwarn if "longest side" not in str(w.message)]
    back = facelab.read_mesh(tmp_path / "c.ply")
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-4)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    import trimesh

    seen = trimesh.load(tmp_path / "c.ply", process=False).visual.vertex_colors[:, :3]
    np.testing.assert_array_equal(seen, np.round(255 * colors))


@pytest.mark.parametrize("colors", [np.zeros((3, 3)), np.full((162, 3), 1.1), "red"])
def test_what_is_no_colour_is_refused_and_nothing_written(colors, tmp_path):
    with pytest.raises((ValueError, TypeError), match="colors"):
        files.write_ply(tmp_path / "c.ply", bumpy_rig().neutral, colors)
    assert not list(tmp_path.iterdir())
