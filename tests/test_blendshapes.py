import numpy as np
import pytest
from shapes import grid_mesh

from facelab.blendshapes import BlendshapeRig, rig_names
from facelab.mesh import TriangleMesh
from facelab.motion import WeightSequence

NAMES = ("eyeBlink_L", "eyeBlink_R", "browInnerUp_L", "browInnerUp_R", "jawOpen", "jawLeft")


@pytest.fixture
def rig(rng):
    mesh = grid_mesh(4, 3, spacing=10.0)
    neutral = TriangleMesh(mesh.vertices, mesh.faces, {"chin": 1, "nose_tip": 6})
    deltas = rng.normal(size=(6, 12, 3)).astype(np.float32)
    return BlendshapeRig(neutral, NAMES, deltas, {"identity000": rng.normal(size=(12, 3))})


def take(columns, valid=None, fps=30.0):
    """A take from a dict of names to weights over time."""
    return WeightSequence(np.column_stack(list(columns.values())), tuple(columns), fps, valid)


# --- shape: Yu and Liu, Eq. 1 ---------------------------------------------------------------------


def test_a_shape_is_the_neutral_plus_the_weighted_displacements(rig, rng):
    w = rng.uniform(size=6)
    expected = rig.neutral.vertices.copy()
    for weight, delta in zip(w, rig.deltas, strict=True):
        expected += weight * delta
    np.testing.assert_allclose(rig.shape(w), expected, atol=1e-12)  # float64 sums near 10


def test_zero_weights_give_the_neutral_exactly(rig):
    np.testing.assert_array_equal(rig.shape(np.zeros(6)), rig.neutral.vertices)
    np.testing.assert_array_equal(rig.shape({}), rig.neutral.vertices)


def test_shapes_add_up(rig, rng):
    a, b = rng.uniform(size=(2, 6))
    together = rig.shape(a + b) + rig.neutral.vertices
    np.testing.assert_allclose(together, rig.shape(a) + rig.shape(b), atol=1e-12)


def test_weights_by_name_are_weights_by_place(rig):
    named = rig.shape({"jawOpen": 0.7, "eyeBlink_R": 0.2})
    np.testing.assert_array_equal(named, rig.shape([0, 0.2, 0, 0, 0.7, 0]))


def test_all_unknown_names_are_listed_at_once_with_those_the_rig_has(rig):
    with pytest.raises(ValueError, match=r"unknown shape.s. nod, wink; this rig has eyeBlink_L"):
        rig.shape({"wink": 1, "jawOpen": 1, "nod": 1})


@pytest.mark.parametrize(
    "w, words",
    [
        (np.zeros(5), r"weights has shape \(5,\), but needs shape \(6,\)"),
        (np.zeros((1, 6)), r"weights has shape \(1, 6\)"),
        ([0, 0, np.nan, 0, 0, 0], r"weights holds 1 value.*\(2,\)"),
        ({"jawOpen": np.inf}, r"weights holds 1 value.*\(4,\)"),
    ],
)
def test_weights_that_cannot_be_are_refused(rig, w, words):
    with pytest.raises(ValueError, match=words):
        rig.shape(w)


# --- the rig itself -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "names, deltas, identities, words",
    [
        ((), np.zeros((0, 12, 3)), {}, "names is empty"),
        (("a", "b", "a"), np.zeros((3, 12, 3)), {}, "names holds a more than once"),
        (("a",), np.zeros((2, 12, 3)), {}, r"deltas has shape \(2, 12, 3\), .* \(1, 12, 3\)"),
        (("a",), np.zeros((1, 11, 3)), {}, r"deltas has shape \(1, 11, 3\)"),
        (("a",), np.full((1, 12, 3), np.nan), {}, "deltas holds 36 value.s. that are NaN"),
        (("a",), np.zeros((1, 12, 3)), {"eva": np.zeros((9, 3))}, "identities.'eva'. has shape"),
        (("a",), np.zeros((1, 12, 3)), {"eva": np.full((12, 3), np.inf)}, "'eva'. holds"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(names, deltas, identities, words):
    with pytest.raises(ValueError, match=words):
        BlendshapeRig(grid_mesh(4, 3), names, deltas, identities)


def test_whole_number_displacements_become_floats():
    rig = BlendshapeRig(grid_mesh(4, 3), ("up",), np.ones((1, 12, 3), dtype=int))
    assert rig.deltas.dtype.kind == "f"


def test_a_rig_on_some_vertices_moves_them_as_the_whole_does(rig, rng):
    kept, w = np.array([5, 0, 1, 4, 9]), rng.uniform(size=6)
    part = rig.on(kept)
    np.testing.assert_allclose(part.shape(w), rig.shape(w)[kept], atol=1e-12)
    (identity,) = part.identities.values()
    np.testing.assert_array_equal(identity, rig.identities["identity000"][kept])
    assert part.names == rig.names
    assert part.neutral.landmarks == {"chin": 2}


def test_a_rig_on_a_subsampled_mesh_has_its_triangles():
    neutral = grid_mesh(12, 12, spacing=5.0)
    deltas = np.zeros((1, 144, 3))
    deltas[0, :, 2] = np.arange(144)
    indices, small = neutral.subsample(30)
    part = BlendshapeRig(neutral, ("lift",), deltas).on(indices, small)
    np.testing.assert_array_equal(part.neutral.faces, small.faces)
    np.testing.assert_array_equal(part.shape({"lift": 1})[:, 2], indices)


def test_a_rig_on_the_triangles_of_other_vertices_is_refused(rig):
    with pytest.raises(ValueError, match="deltas has shape"):
        rig.on(np.arange(5), grid_mesh(3, 3))


# --- recorded weights -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "recorded, driven",
    [
        ("eyeBlinkLeft", ["eyeBlink_L"]),
        ("eyeBlinkRight", ["eyeBlink_R"]),
        ("browInnerUp", ["browInnerUp_L", "browInnerUp_R"]),
        ("jawOpen", ["jawOpen"]),
        ("jawLeft", ["jawLeft"]),
        ("browInnerUp_R", ["browInnerUp_R"]),
    ],
)
def test_an_arkit_name_drives_the_shapes_meant_and_no_other(rig, recorded, driven):
    W = rig.rig_weights(take({recorded: [0.25, 0.75]}))
    for name, column in zip(rig.names, W.T, strict=True):
        np.testing.assert_array_equal(column, [0.25, 0.75] if name in driven else 0)


def test_a_name_with_a_side_never_stands_for_the_other():
    assert "eyeBlink_R" not in rig_names("eyeBlinkLeft")
    assert "eyeBlink_L" not in rig_names("eyeBlinkRight")


def test_weights_are_clipped_and_their_source_is_not(rig):
    recorded = take({"jawOpen": [-0.2, 0.0, 0.4, 1.0, 1.3]})
    np.testing.assert_array_equal(rig.rig_weights(recorded)[:, 4], [0, 0, 0.4, 1, 1])
    np.testing.assert_array_equal(recorded.weights[:, 0], [-0.2, 0.0, 0.4, 1.0, 1.3])


def test_recorded_shapes_that_the_rig_lacks_move_nothing(rig):
    both = rig.animate(take({"tongueOut": [1.0, 1.0], "jawOpen": [0.5, 1.0]}))
    alone = rig.animate(take({"jawOpen": [0.5, 1.0]}))
    np.testing.assert_array_equal(both.positions, alone.positions)


def test_a_take_that_drives_nothing_is_refused(rig):
    with pytest.raises(ValueError, match=r"no recorded name drives this rig: .* Mund, Nase"):
        rig.animate(take({"Mund": [0.0], "Nase": [0.0]}))


@pytest.mark.parametrize(
    "dtype, tolerance",
    [(np.float32, 1e-5), (np.float64, 1e-12)],  # rounding of sums near 30 in that type
    ids=["float32", "float64"],
)
def test_an_animation_is_one_shape_after_another(rig, rng, dtype, tolerance):
    columns = {n: rng.uniform(-0.3, 1.3, 7) for n in ("eyeBlinkLeft", "browInnerUp", "jawOpen")}
    motion = rig.animate(take(columns, fps=25), dtype=dtype)
    assert motion.positions.dtype == dtype
    assert (motion.fps, motion.mesh) == (25, rig.neutral)
    for frame in range(7):
        blink, brow, jaw = (float(np.clip(c[frame], 0, 1)) for c in columns.values())
        both = {"browInnerUp_L": brow, "browInnerUp_R": brow}
        expected = rig.shape({"eyeBlink_L": blink, "jawOpen": jaw, **both})
        np.testing.assert_allclose(motion.positions[frame], expected, atol=tolerance)


def test_lost_frames_rest_at_the_neutral_and_stay_lost(rig):
    valid = np.array([True, False, True])
    motion = rig.animate(take({"jawOpen": [1.0, np.nan, 1.0]}, valid))
    np.testing.assert_array_equal(motion.valid, valid)
    np.testing.assert_allclose(motion.positions[1], rig.neutral.vertices, rtol=1e-6)  # float32
    assert motion.displacements().shape == (2, 36)


@pytest.mark.real
def test_a_real_take_moves_the_real_face_within_reason(real_rig, real_takes):
    indices, small = real_rig.neutral.subsample(100)
    motion = real_rig.on(indices, small).animate(real_takes["alex_rom_3"])
    size = np.linalg.norm(motion.positions - small.vertices, axis=2)
    # a mouth opens by some centimetres; a unit error would be ten times off
    assert 10 < size.max() < 60
    assert size[~motion.valid].max() < 1e-4  # float32 positions of a face 200 mm wide
