import warnings

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from shapes import grid_mesh

from facelab.geometry.binding import bind_to_samples
from facelab.geometry.mesh import TriangleMesh
from facelab.models.holistic import HolisticModel
from facelab.motion import WeightSequence
from facelab.posing.session import PosingSession
from facelab.posing.solver import PoseSolver
from facelab.rig import BlendshapeRig

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


def test_a_partial_match_is_always_said(rig):
    whole = {n: [0.5, 0.5] for n in rig.names}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rig.rig_weights(take({**whole, "tongueOut": [1, 1], "still": [0, 0]}))  # nothing is lost
    with pytest.warns(UserWarning, match=r"drives 1 of 6 shapes; not driven: eyeBlink_L, .*match"):
        rig.rig_weights(take({"jawOpen": [0.1, 0.2]}))
    with pytest.warns(UserWarning, match=r"6 of 6 shapes; recorded, but drives nothing: nod\."):
        rig.rig_weights(take({**whole, "nod": [0, 0.5]}))


def test_of_several_ways_to_a_shape_the_same_name_is_taken(rig):
    columns = {"browInnerUp": [0.9], "browInnerUp_R": [0.1], "BrowInnerUpLeft": [0.2]}
    W = rig.rig_weights(take(columns))
    assert W[0].tolist() == [0, 0, 0.2, 0.1, 0, 0]
    assert rig.match(take(columns)).left_over == ("browInnerUp",)


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


# --- direct manipulation: Lewis and Anjyo, weights within [0, 1] ----------------------------------


def rig_of(rng, n_units=12, columns=7, rows=6):
    mesh = grid_mesh(columns, rows, 10.0)
    deltas = rng.normal(size=(n_units, mesh.n_vertices, 3))
    return BlendshapeRig(mesh, [f"unit {k}" for k in range(n_units)], deltas)


def stacked(solver, pins, weights, w_0):
    """The programme as stacked least squares, written down once more."""
    D, N = solver.model.deltas, solver.model.neutral.n_vertices
    s = 0.025 * (397 / N) * np.mean(np.sum(D**2, axis=(1, 2)))
    A, b = [], []
    for (v, t), weight in zip(pins.items(), weights, strict=True):
        A.append(np.sqrt(weight) * D[:, v].T)
        b.append(np.sqrt(weight) * np.asarray(t))
    A.append(np.sqrt(s) * np.eye(len(D)))
    b.append(np.sqrt(s) * w_0)
    return np.vstack(A), np.concatenate(b)


@pytest.mark.parametrize("n_pins", [1, 3, 20])
@pytest.mark.parametrize("size", [0.3, 3.0, 100.0])
def test_dragged_weights_are_the_bounded_least_squares(rng, n_pins, size):
    solver = PoseSolver(rig_of(rng))
    pins = {int(v): size * rng.normal(size=3) for v in rng.choice(42, n_pins, replace=False)}
    weights, w_0 = rng.uniform(0.5, 4, n_pins), rng.uniform(0, 1, 12)
    problem = solver.problem(list(pins), weights)
    w = problem.solve(np.array(list(pins.values())), w_0, np.zeros(12))
    A, b = stacked(solver, pins, weights, w_0)
    theirs = lsq_linear(A, b, (0, 1), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(w, theirs, atol=1e-8)
    assert w.min() >= 0 and w.max() <= 1
    slope = A.T @ (A @ w - b)  # the optimality conditions, relative to the pull at rest
    wrong = np.where(w == 0, np.minimum(slope, 0), np.where(w == 1, np.maximum(slope, 0), slope))
    assert np.abs(wrong).max() <= 1e-8 * np.abs(A.T @ b).max()


def test_a_drag_along_a_path_solves_as_afresh_at_each_move(rng):
    solver, w_0, none = PoseSolver(rig_of(rng)), rng.uniform(0, 1, 12), np.zeros(12)
    warm = solver.problem([3, 20])
    for t in np.cumsum(rng.normal(size=(30, 2, 3)), axis=0):
        fresh = solver.problem([3, 20]).solve(t, w_0, none)
        np.testing.assert_allclose(warm.solve(t, w_0, none), fresh, atol=1e-10)


@pytest.fixture
def posed(rng):
    rig = rig_of(rng)
    return PosingSession(rig, rig.neutral)


def test_a_rig_is_posed_like_any_model_and_stays_within_its_bounds(posed):
    assert not posed.affine
    assert type(posed.press(8)).__name__ == "BoundedPull"
    V = posed.neutral.vertices
    for mm in (1.0, 10, 1e6):
        posed.drag(8, V[8] + [mm, 0, 0])
        w = posed.coefficients
        assert w.min() >= 0 and w.max() <= 1
        np.testing.assert_allclose(posed.vertices, posed.model.shape(w), atol=1e-10)
    shown = posed.vertices
    posed.release()
    np.testing.assert_allclose(posed.vertices, shown, atol=1e-9)
    assert posed.undo() and not posed.can_undo
    np.testing.assert_array_equal(posed.vertices, V)


def test_pressing_a_rig_anywhere_changes_nothing(posed):
    for v, by in ((8, [2.0, 1, 0]), (30, [0.0, 3, 0])):
        posed.drag(v, posed.vertices[v] + by)
        posed.release()
    before = posed.vertices
    for v in (0, 5, 17, 41):
        posed.drag(v, before[v])
        np.testing.assert_allclose(posed.vertices, before, atol=1e-9)
        posed.cancel()


def test_planted_weights_are_found_from_pins_on_every_vertex(rng, posed):
    w = np.r_[0, 1, rng.uniform(0, 1, 10)]
    posed.set(gamma=1e-9)
    with posed.group():
        for v, x in enumerate(posed.model.shape(w)):
            posed.set_pin(v, x)
    np.testing.assert_allclose(posed.coefficients, w, atol=1e-6)


def test_gamma_means_the_same_whatever_the_length_of_the_units(rng):
    rig, ends = rig_of(rng), []
    for length in (1.0, 5.0):
        longer = BlendshapeRig(rig.neutral, rig.names, length * rig.deltas)
        session = PosingSession(longer, rig.neutral)
        session.apply(np.full(12, 0.5 / length))
        session.drag(8, session.vertices[8] + [0.05, 0.1, 0])
        ends.append(length * (session.coefficients - 0.5 / length))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


def test_sliders_of_a_rig_are_its_weights(posed):
    posed.mold(0, 3, 0.75)
    np.testing.assert_array_equal(posed.coefficients, np.where(np.arange(12) == 3, 0.75, 0))
    np.testing.assert_array_equal(posed.mold_values(0), posed.coefficients)
    assert posed.mold_names(0)[3] == "unit 3"
    np.testing.assert_array_equal(posed.mold_ranges(0)[0], [0, 1])
    with pytest.raises(ValueError, match=r"value=1\.5"):
        posed.mold(0, 3, 1.5)
    with pytest.raises(ValueError, match="region=1"):
        posed.mold(1, 0, 0.5)
    with pytest.raises(ValueError, match=r"coefficients run from -1 to 0\.5"):
        posed.apply(np.r_[-1, np.full(11, 0.5)])
    posed.reset_region(0)
    assert (posed.coefficients == 0).all()


def test_what_a_rig_does_not_know_it_does_not_claim(posed):
    assert posed.plausibility() is None
    assert posed.region_labels is None
    assert (posed.gaps() == 0).all()


def test_recorded_weights_and_their_motion_are_the_same_take(rng):
    rig = rig_of(rng, 3)
    W = rng.uniform(0, 1, size=(6, 3))
    recorded = WeightSequence(W, rig.names, 30.0, np.arange(6) != 2)
    session = PosingSession(rig, rig.neutral)
    track = session.encode(recorded)
    assert np.isnan(track[2]).all()
    np.testing.assert_array_equal(track[0], W[0])
    again = session.encode(rig.animate(recorded, dtype=float))
    np.testing.assert_allclose(again, track, atol=1e-6)
    session.mold(0, 1, 0.5)
    np.testing.assert_allclose(
        session.overlay(track)[0], (W[0] + [0, 0.5, 0]).clip(0, 1), atol=1e-12
    )


def test_models_and_a_rig_take_over_each_others_pose_and_pins(rng):
    rig = rig_of(rng)
    W = rng.uniform(0, 1, size=(40, 12))
    X = np.tensordot(W, rig.deltas, axes=1).reshape(40, -1)
    model = HolisticModel(12).fit(X)
    session = PosingSession(rig, rig.neutral)
    session.apply(rng.uniform(0, 1, 12))
    w, pose = session.coefficients, session.vertices
    session.use(model)
    assert session.affine
    np.testing.assert_allclose(session.vertices, pose, atol=1e-8)  # twelve modes hold all of it
    session.use(rig)
    np.testing.assert_allclose(session.coefficients, w, atol=1e-6)


def test_a_rig_on_control_vertices_is_carried_by_the_binding(rng):
    dense = grid_mesh(19, 16, 3.0)
    row, column = np.divmod(np.arange(dense.n_vertices), 19)
    samples = np.flatnonzero((row % 3 == 0) & (column % 3 == 0))
    rig, binding = rig_of(rng), bind_to_samples(dense, samples)
    session = PosingSession(rig, dense, binding=binding, gamma=1e-9)
    session.drag(100, dense.vertices[100] + [0.4, 0.2, -0.3])
    x = session.model.shape(session.coefficients) - rig.neutral.vertices
    np.testing.assert_allclose(session.vertices, dense.vertices + binding.carry(x), atol=1e-9)
    np.testing.assert_allclose(
        session.vertices[100], dense.vertices[100] + [0.4, 0.2, -0.3], atol=1e-3
    )


def test_shapes_that_move_nothing_cannot_be_mixed():
    mesh = TriangleMesh([[0, 0, 0], [90, 0, 0], [0, 90, 0]], [[0, 1, 2]])
    with pytest.raises(ValueError, match="its 2 shapes move nothing"):
        BlendshapeRig(mesh, ["a", "b"], np.zeros((2, 3, 3))).plausible_mixtures()
