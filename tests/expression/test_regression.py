import time
import warnings

import literal_yu
import numpy as np
import pytest
from planted import bumpy_rig
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation
from shapes import sphere_mesh

from facelab.expression import (
    CRITERIA,
    find_alignment,
    held_out_error,
    least_squares,
    prepare_units,
    regress_expression,
    regress_sequence,
    two_step,
)
from facelab.geometry.alignment import Alignment
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence
from facelab.rig import BlendshapeRig

BOUNDS = {"free": None, "non-negative": (0, None), "unit": (0, 1)}


@pytest.fixture(scope="module")
def rig():
    return bumpy_rig()


@pytest.fixture(scope="module")
def actor():
    from data_synth.action_units import actor_rig

    return actor_rig("M1", 4375).linear()


@pytest.fixture
def sketch(rig, rng):
    w = np.array([0.8, 0, 0, 0.5, 1.3, 0, 0, -0.2, 0, 0.3, 0, 0])
    return rig.shape(w) + rng.normal(scale=0.8, size=rig.neutral.vertices.shape)


def system(rig, sketch, scale=1.0):
    D = np.asarray(rig.deltas, dtype=float).reshape(len(rig.names), -1).T
    return D * np.sqrt(scale), (sketch - rig.neutral.vertices).ravel() * np.sqrt(scale)


# -- Eq. 9 --


@pytest.mark.parametrize("bounds", BOUNDS.values(), ids=BOUNDS)
@pytest.mark.parametrize("lam", [0.0, 0.05, 1.0, 30.0])
@pytest.mark.parametrize("per_vertex", [True, False])
def test_every_alpha_agrees_with_lsq_linear_on_the_full_matrix(
    rig, sketch, bounds, lam, per_vertex
):
    alphas = [0, 1, 2.5, 7, 12, 40, -3]
    fit = regress_expression(rig, sketch, lam, alphas, bounds, per_vertex=per_vertex)
    D, d = system(rig, sketch, 1 / rig.neutral.n_vertices if per_vertex else 1)
    low, high = bounds or (None, None)
    box = (-np.inf if low is None else low, np.inf if high is None else high)
    for alpha, w in zip(alphas, fit.weights, strict=True):
        exact = literal_yu.regress(D, d, lam, alpha, box, "bvls")
        np.testing.assert_allclose(w, exact, atol=1e-8)
        best = literal_yu.objective(exact, D, d, lam, alpha)
        assert literal_yu.objective(w, D, d, lam, alpha) <= best * (1 + 1e-12)
    assert fit.kkt.max() < 1e-10


def test_the_reflective_newton_method_of_the_paper_finds_the_same_on_an_actor(actor, rng):
    w = np.zeros(40)
    w[rng.permutation(40)[:6]] = rng.uniform(0.2, 1, 6)
    V = actor.shape(w) + rng.normal(scale=0.5, size=actor.neutral.vertices.shape)
    fit = regress_expression(actor, V)
    D, d = system(actor, V, 1 / 4375)
    for alpha in (0, 3, 14, 60):
        trf = literal_yu.regress(D, d, 1, alpha, (0, 1))
        np.testing.assert_allclose(fit.weights[alpha], trf, atol=1e-8)
    assert fit.kkt.max() < 1e-10


@pytest.mark.real
def test_on_the_scanned_face_101_alphas_agree_and_are_optimal(real_rig, rng):
    w = rng.uniform(size=53) * (rng.random(53) < 0.15)
    V = real_rig.shape(w) + rng.normal(scale=0.5, size=real_rig.neutral.vertices.shape)
    basis = prepare_units(real_rig)
    fit = regress_expression(basis, V)
    assert fit.kkt.max() < 1e-10
    s = 1 / real_rig.neutral.n_vertices
    A = np.vstack([basis.R * np.sqrt(s), np.ones(53)])
    c = basis.Q.T @ fit.displacement.ravel() * np.sqrt(s)
    for alpha in range(0, 101, 5):
        w = lsq_linear(A, np.append(c, alpha), (0, 1), "bvls", tol=1e-15).x
        np.testing.assert_allclose(fit.weights[alpha], w, atol=1e-8)


def test_the_weights_are_linear_in_alpha_between_the_knots(rig, sketch):
    fit = regress_expression(rig, sketch, 0.3)
    assert len(fit.knots) > 5
    fine = np.sort(np.random.default_rng(0).uniform(0, 100, 50))
    again = regress_expression(rig, sketch, 0.3, fine)
    for alpha, w in zip(fine, again.weights, strict=True):
        np.testing.assert_allclose(fit.at(alpha), w, atol=1e-9)


def test_symmetric_units_that_change_sides_together_do_not_stop_the_path():
    mesh = sphere_mesh(2, radius=50.0)
    half = np.exp(-(((mesh.vertices - [40, 0, 20]) / 30) ** 2).sum(axis=1))
    other = np.exp(-(((mesh.vertices * [-1, 1, 1] - [40, 0, 20]) / 30) ** 2).sum(axis=1))
    low = np.exp(-(((mesh.vertices - [0, -40, 10]) / 30) ** 2).sum(axis=1))
    deltas = np.stack([half, other, low, half * low, other * low])[..., None] * [0, 5.0, 0]
    rig = BlendshapeRig(mesh, ["L", "R", "low", "lowL", "lowR"], deltas)
    fit = regress_expression(rig, rig.shape([0.5, 0.5, 1, 0, 0]), 1, np.linspace(0, 6, 61))
    np.testing.assert_allclose(fit.weights[:, 0], fit.weights[:, 1], atol=1e-9)
    assert fit.kkt.max() < 1e-10


def test_lam_means_the_same_at_two_densities_and_the_printed_lambda_does_not(rig, sketch):
    twice = np.tile(np.arange(162), 2)
    mesh = TriangleMesh(rig.neutral.vertices[twice], rig.neutral.faces)
    dense = BlendshapeRig(mesh, rig.names, rig.deltas[:, twice])
    for per_vertex, lam in ((True, 0.3), (False, 0.3 * np.sqrt(162))):
        a, b = (
            regress_expression(r, x, lam, per_vertex=per_vertex).weights
            for r, x in ((rig, sketch), (dense, sketch[twice]))
        )
        if per_vertex:
            kept = a
            np.testing.assert_allclose(b, a, atol=1e-10)
        else:
            np.testing.assert_allclose(a, kept, atol=1e-10)
            assert np.abs(b - a).max() > 0.05


def test_with_bounds_fixed_the_smallest_e_rms_is_the_plain_bounded_fit(rig, sketch):
    """At alpha = sum(w*) of the plain fit w*, both terms of Eq. 9 are at their minimum: the first
    because w* minimises it within the bounds, the second because it is 0."""
    for bounds in BOUNDS.values():
        plain = regress_expression(rig, sketch, 0, [0], bounds)
        alpha = plain.sums[0]
        alphas = np.append(np.linspace(-5, 20, 101), alpha)
        for lam in (0.01, 1, 100):
            fit = regress_expression(rig, sketch, lam, alphas, bounds)
            np.testing.assert_allclose(fit.weights[-1], plain.weights[0], atol=1e-8)
            assert fit.rms.min() >= plain.rms[0] - 1e-12
            np.testing.assert_allclose(fit.rms[-1], plain.rms[0], rtol=1e-12)


def test_errors_are_those_of_eq_10_and_of_the_faces_shown(rig, sketch):
    fit = regress_expression(rig, sketch, alphas=[0, 3])
    for i in range(2):
        V = literal_yu.blend(rig.neutral.vertices, fit.weights[i], rig.deltas)
        np.testing.assert_allclose(fit.vertices(i), V, atol=1e-10)
        np.testing.assert_allclose(fit.e_rms[i], literal_yu.e_rms(V, sketch), rtol=1e-10)
        rms = np.sqrt(((V - sketch) ** 2).sum(axis=1).mean())
        np.testing.assert_allclose(fit.rms[i], rms, rtol=1e-10)


def test_a_mixture_of_units_is_found_exactly(rig):
    w = np.linspace(0, 1, 12)
    fit = regress_expression(rig, TriangleMesh(rig.shape(w), rig.neutral.faces), 1, [w.sum()])
    np.testing.assert_allclose(fit.weights[0], w, atol=1e-9)
    assert fit.rms[0] < 1e-9 and "best" in repr(fit)


# -- Bounds, locks --


def test_locked_and_excluded_units_stay_and_the_others_make_the_best_of_it(rig, sketch):
    fit = regress_expression(rig, sketch, 0, [0], locked={"AU4": 0.25}, excluded=["AU0", "AU9"])
    assert fit.weights[0, 4] == 0.25 and not fit.weights[0, [0, 9]].any()
    D, d = system(rig, sketch)
    rest = [i for i in range(12) if i not in (0, 4, 9)]
    w = lsq_linear(D[:, rest], d - 0.25 * D[:, 4], (0, 1), "bvls", tol=1e-15).x
    np.testing.assert_allclose(fit.weights[0, rest], w, atol=1e-8)


def test_bounds_may_differ_from_unit_to_unit(rig, sketch):
    named = regress_expression(rig, sketch, 0, [0], {"AU4": (0, 2), "AU7": (None, None)})
    lower, upper = np.zeros(12), np.ones(12)
    upper[4], lower[7], upper[7] = 2, -np.inf, np.inf
    arrays = regress_expression(rig, sketch, 0, [0], (lower, upper))
    np.testing.assert_array_equal(named.weights, arrays.weights)
    assert named.weights[0, 4] > 1.1 and named.weights[0, 7] < -0.1


def test_all_units_locked_leaves_nothing_to_find(rig, sketch):
    fit = regress_expression(rig, sketch, locked=dict.fromkeys(rig.names, 0.5), alphas=[6, 7])
    assert (fit.weights == 0.5).all() and fit.reachable.tolist() == [True, False]


def test_an_alpha_out_of_reach_is_said_so(rig, sketch):
    fit = regress_expression(rig, sketch, alphas=[0, 12, 13, -1])
    assert fit.reachable.tolist() == [True, True, False, False]
    assert "2 of them out of reach" in repr(fit)
    with pytest.warns(UserWarning, match=r"from 0 to 12, alphas run from 13 to 20"):
        regress_expression(rig, sketch, alphas=[13, 20])
    assert regress_expression(rig, sketch, alphas=[99], bounds=None).reachable.all()


# -- Eq. 4 to 7 --


def test_plain_least_squares_is_eq_5_and_stretches_weights(rig, sketch):
    plain = least_squares(rig, sketch)
    D, d = system(rig, sketch)
    np.testing.assert_allclose(plain.weights, literal_yu.least_squares(D, d), atol=1e-8)
    assert plain.rank == 12 and plain.weights.max() > 1.1 and plain.weights.min() < -0.1
    assert plain.rms <= regress_expression(rig, sketch, 0, [0]).rms[0]


def test_plain_least_squares_reports_the_rank_that_eq_5_lacks(rig, sketch):
    deltas = np.concatenate([rig.deltas, rig.deltas[:1] + rig.deltas[1:2]])
    plain = least_squares(BlendshapeRig(rig.neutral, [*rig.names, "both"], deltas), sketch)
    assert plain.rank == 12 and plain.condition == np.inf
    np.testing.assert_allclose(plain.rms, least_squares(rig, sketch).rms, rtol=1e-10)


def test_two_steps_keep_the_dominant_units_and_refine_with_the_rest(rig, sketch):
    steps = two_step(rig, sketch)
    main = np.isin(rig.names, steps.dominant)
    assert 0 < main.sum() < 12 and not steps.coarse[~main].any()
    np.testing.assert_array_equal(steps.weights[main], steps.coarse[main])
    both = regress_expression(rig, sketch, 0, [0]).rms[0]
    assert both <= steps.rms <= steps.coarse_rms


# -- What the fit tells --


def test_every_criterion_names_an_alpha_in_reach(rig, sketch):
    fit = regress_expression(rig, sketch)
    for criterion in CRITERIA:
        assert fit.reachable[fit.choose(criterion)]
    assert regress_expression(rig, sketch, criterion="fewest").best == fit.choose("fewest")
    assert fit.rms[fit.choose("e_rms")] == fit.rms[fit.reachable].min()


def test_fewest_units_are_not_more_than_those_of_the_smallest_error(rig, sketch):
    fit = regress_expression(rig, sketch, 1, np.linspace(0, 8, 81))
    few, best = (np.abs(fit.weights[fit.choose(c)]) > 0.05 for c in ("fewest", "e_rms"))
    assert few.sum() <= best.sum()
    assert fit.rms[fit.choose("fewest")] <= 1.05 * fit.rms.min() + 0.01


def test_weights_within_bounds_can_leave_the_boundary_and_the_clamp_brings_them_back(rig):
    fit = regress_expression(rig, rig.shape(np.ones(12)), 0, [0])
    boundary = np.linalg.norm(rig.deltas, axis=2).max(axis=0)
    moved = np.linalg.norm(fit.vertices() - rig.neutral.vertices, axis=1)
    np.testing.assert_allclose(fit.excess(), np.maximum(moved - boundary, 0), atol=1e-9)
    assert fit.excess().max() > 0.5
    clamped = np.linalg.norm(fit.vertices(clamp=True) - rig.neutral.vertices, axis=1)
    np.testing.assert_allclose(clamped, np.minimum(moved, boundary), atol=1e-9)
    one = regress_expression(rig, rig.shape(np.eye(12)[3]), 0, [0])
    assert one.excess().max() < 1e-9


def test_negative_and_cancelling_units_are_named():
    mesh = sphere_mesh(1, radius=50.0)
    bump = np.exp(-((mesh.vertices - [0, 0, 50]) ** 2).sum(axis=1) / 900)[:, None]
    aside = np.exp(-((mesh.vertices - [50, 0, 0]) ** 2).sum(axis=1) / 900)[:, None]
    deltas = np.stack([bump * [0, 5, 0], bump * [1, -5, 0], aside * [5, 0, 0]])
    rig = BlendshapeRig(mesh, ["up", "down", "aside"], deltas)
    fit = regress_expression(rig, rig.shape([0.8, 0.5, -0.4]), 0, [0], None)
    assert fit.negative() == ("aside",) and fit.cancelling() == [("up", "down")]
    same = regress_expression(rig, rig.shape([0.8, -0.5, 0.4]), 0, [0], None)
    assert same.cancelling() == [] and same.negative() == ("down",)


def test_dominant_and_auxiliary_units_are_told_apart_and_alpha_loads_the_latter(actor):
    w = actor.weights_of({"AU12L": 0.9, "AU12R": 0.9, "AU4": 0.6, "AU5": 0.5})
    fit = regress_expression(actor, actor.shape(w), 0.1, range(0, 15))
    dominant, auxiliary = fit.roles()
    assert {"AU12L", "AU12R"} <= set(dominant) and not set(dominant) & set(auxiliary)
    change = dict(zip(actor.names, fit.weights[-1] - fit.weights[2], strict=True))
    assert max(change[n] for n in auxiliary) > 2 * max(abs(change[n]) for n in dominant)


def test_two_units_that_undo_each_other_are_not_dominant(actor):
    w = actor.weights_of({"AU12L": 0.5, "AU30L": 0.6, "AU30R": 0.6})  # the jaw to both sides
    fit = regress_expression(actor, actor.shape(w), 0, [0])
    assert fit.roles()[0] == ("AU12L",)
    assert {"AU30L", "AU30R"} <= set(fit.roles()[1])


def test_the_held_out_error_is_that_of_fits_without_the_patch(rig, sketch):
    fit = regress_expression(rig, sketch, 0.7, [0, 2, 5])
    D, d = system(rig, sketch)
    parts = [out for out, _, _ in fit.basis.folds(5, 50)]
    assert (np.sum(parts, axis=0) == 1).all()  # every vertex once
    total = np.zeros(3)
    for out in np.repeat(parts, 3, axis=1):
        root = np.sqrt((~out).sum() / 3)
        for i, alpha in enumerate(fit.alphas):
            w = literal_yu.regress(D[~out] / root, d[~out] / root, 0.7, alpha, (0, 1))
            total[i] += ((D[out] @ w - d[out]) ** 2).sum()
    expected = np.sqrt(total / rig.neutral.n_vertices)
    np.testing.assert_allclose(held_out_error(fit), expected, rtol=1e-4)
    assert fit.choose("held_out") == expected.argmin()


@pytest.mark.parametrize("wrong", [{"n_folds": 1}, {"n_folds": 51}, {"n_patches": 1}])
def test_folds_that_leave_nothing_out_are_refused(rig, sketch, wrong):
    fit = regress_expression(rig, sketch, alphas=[1], align=False)
    with pytest.raises(ValueError, match=next(iter(wrong))):
        held_out_error(fit, **wrong)


# -- Alignment --


@pytest.mark.parametrize("degrees", [3, 40, 150])
def test_rigid_motion_is_noticed_and_taken_out_though_the_jaw_is_open(actor, degrees):
    w = actor.weights_of({"AU26": 0.9, "AU12L": 0.5})
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([1, 0, 0])).as_matrix()
    V = actor.shape(w) @ turn.T + [4, -3, 8]
    with pytest.raises(ValueError, match=r"not aligned.*align=True"):
        regress_expression(actor, V)
    fit = regress_expression(actor, V, align=True, alphas=[w.sum()])
    np.testing.assert_allclose(fit.weights[0], w, atol=1e-6)
    np.testing.assert_allclose(fit.alignment.degrees, degrees, atol=1e-6)


def test_expressions_are_found_aligned_even_overstretched(actor):
    V = actor.shape({"AU27": 1.8, "AU12L": 2})
    assert find_alignment(actor, V).travel(V) < 1e-6
    assert regress_expression(actor, V, alphas=[3]).alignment is None


def test_what_an_alignment_leaves_is_what_no_mixture_of_units_explains(actor, rng):
    n = actor.neutral.n_vertices
    V = actor.shape({"AU26": 0.9}) + rng.normal(scale=0.5, size=(n, 3))
    V = V @ Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix().T + [4, -3, 8]
    found = find_alignment(actor, V)
    D = actor.deltas.reshape(len(actor.names), -1).T
    d = (found.apply(V) - actor.neutral.vertices).ravel()
    left = d - D @ np.linalg.lstsq(D, d, rcond=None)[0]
    assert found.rms == pytest.approx(np.sqrt(left @ left / n), rel=1e-6)
    turned = Alignment(Rotation.from_rotvec([0.01, 0, 0]).as_matrix(), np.zeros(3))
    d = (turned.apply(found.apply(V)) - actor.neutral.vertices).ravel()
    worse = d - D @ np.linalg.lstsq(D, d, rcond=None)[0]
    assert found.rms < 0.99 * np.sqrt(worse @ worse / n)


def test_a_sketch_in_other_units_is_refused(actor):
    with pytest.raises(ValueError, match=r"0\.1 times the size.*millimetres"):
        regress_expression(actor, actor.neutral.vertices / 10)


# -- Units --


def test_units_that_hardly_move_are_dropped_by_name(rig, sketch):
    deltas = np.concatenate([rig.deltas, 0 * rig.deltas[:1], 1e-3 * rig.deltas[1:2]])
    more = BlendshapeRig(rig.neutral, [*rig.names, "none", "faint"], deltas)
    with pytest.warns(UserWarning, match=r"none \(0 mm\), faint"):
        fit = regress_expression(more, sketch)
    assert fit.dropped == ("none", "faint") and fit.weights.shape == (101, 14)
    np.testing.assert_array_equal(fit.weights[:, :12], regress_expression(rig, sketch).weights)
    with pytest.raises(ValueError, match=r"none \(0 mm\).*remove"):
        prepare_units(more, still="refuse")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        basis = prepare_units(more)
    with pytest.raises(ValueError, match="locked names faint"):
        regress_expression(basis, sketch, locked={"faint": 1})


def test_copies_and_mixtures_of_units_are_refused_with_their_parts(rig):
    deltas = np.concatenate([rig.deltas, rig.deltas[2:3], rig.deltas[:1] - 2 * rig.deltas[5:6]])
    more = BlendshapeRig(rig.neutral, [*rig.names, "copy", "mix"], deltas)
    with pytest.raises(ValueError, match=r"copy = 1 AU2; mix = 1 AU0 \+ -2 AU5.*drop"):
        prepare_units(more)
    with pytest.warns(UserWarning, match="copy = 1 AU2"):
        assert prepare_units(more, dependent="drop").dropped == ("copy", "mix")


def test_a_rig_that_never_moves_is_refused(rig):
    with pytest.raises(ValueError, match="no unit that moves"):
        prepare_units(BlendshapeRig(rig.neutral, ["a"], 0 * rig.deltas[:1]))


# -- Sequences --


def motion_of(rig, W, fps=30, valid=None):
    positions = rig.neutral.vertices + np.tensordot(W, rig.deltas, axes=1)
    return MotionSequence(positions, fps, rig.neutral, valid)


def smooth_weights(rng, n_frames=80, n_units=12):
    t = np.linspace(0, 1, n_frames)[:, None]
    wave = np.sin(2 * np.pi * (rng.uniform(0.5, 2, n_units) * t + rng.uniform(size=n_units)))
    return (0.4 + 0.8 * wave).clip(0, 1)


def test_without_smoothness_every_frame_is_its_own_regression(rig, rng):
    W = smooth_weights(rng, 10)
    motion = motion_of(rig, W).with_noise(1.0, 0)
    found = regress_sequence(rig, motion, lam=0.2, alpha=4, smooth=0)
    for t in range(10):
        fit = regress_expression(rig, motion.positions[t], 0.2, [4])
        np.testing.assert_allclose(found.weights[t], fit.weights[0], atol=1e-9)


def test_the_whole_sequence_is_the_bounded_optimum(rig, rng):
    F, fps, smooth = 12, 30, 0.02
    motion = motion_of(rig, smooth_weights(rng, F)).with_noise(2.0, 0)
    found = regress_sequence(rig, motion, smooth=smooth, align=False).weights
    D = system(rig, rig.neutral.vertices, 1 / rig.neutral.n_vertices)[0]
    d = motion.displacements() / np.sqrt(rig.neutral.n_vertices)
    change = np.kron(np.diff(np.eye(F), axis=0), np.eye(12)) * smooth * fps
    A = np.vstack([np.kron(np.eye(F), D), change])
    b = np.append(d.ravel(), np.zeros(len(change)))
    exact = lsq_linear(A, b, (0, 1), "bvls", tol=1e-15).x
    np.testing.assert_allclose(found.ravel(), exact, atol=1e-8)


def test_smoothness_helps_against_noise_and_carries_over_lost_and_hidden_data(rig, rng):
    W = smooth_weights(rng, 300)
    valid = np.ones(300, dtype=bool)
    valid[30:33] = False
    noisy = motion_of(rig, W, valid=valid).with_noise(3.0, 0)
    seen = rng.random(noisy.positions.shape[:2]) > 0.3
    error = [
        np.abs(regress_sequence(rig, noisy, smooth=s, visible=seen, align=False).weights - W).mean()
        for s in (1e-5, 0.05)
    ]
    assert error[1] < 0.8 * error[0]
    clean = regress_sequence(rig, motion_of(rig, W, valid=valid), smooth=1e-4)
    assert clean.valid.all()
    np.testing.assert_allclose(clean.weights[valid], W[valid], atol=0.01)
    assert np.abs(clean.weights - W)[~valid].max() < 0.2


def test_what_is_hidden_is_not_looked_at(rig, rng):
    W = smooth_weights(rng, 6)
    motion = motion_of(rig, W)
    seen = rng.random(motion.positions.shape[:2]) > 0.2
    spoilt = motion_of(rig, W)
    spoilt.positions[~seen] += 500
    a, b = (regress_sequence(rig, m, visible=seen).weights for m in (motion, spoilt))
    np.testing.assert_array_equal(a, b)


@pytest.mark.real
def test_a_recorded_take_is_read_faster_than_it_was_captured(real_rig, real_takes):
    take = next(iter(real_takes.values()))[:300]
    motion = real_rig.animate(take).with_noise(0.3, 0)
    basis = prepare_units(real_rig)
    start = time.perf_counter()
    found = regress_sequence(basis, motion)
    assert motion.n_frames / (time.perf_counter() - start) > 60
    assert np.abs(found.weights - real_rig.rig_weights(take))[take.valid].mean() < 0.01


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: {"smooth": 0.0, "motion": m(np.arange(5) != 2)}, "smooth=0.*missing"),
        (lambda m: {"motion": m(np.zeros(5, dtype=bool))}, "no valid frame"),
        (lambda m: {"visible": np.ones((5, 3), dtype=bool)}, r"visible has shape \(5, 3\)"),
        (lambda m: {"align": True}, "align=True"),
    ],
)
def test_sequences_that_cannot_be_fitted_are_refused(rig, rng, change, message):
    W = smooth_weights(rng, 5)

    def make(valid=None):
        return motion_of(rig, W, valid=valid)

    given = {"motion": make(), **change(make)}
    with pytest.raises(ValueError, match=message):
        regress_sequence(rig, **given)


def test_a_moving_head_is_noticed_in_a_sequence(actor):
    W = np.zeros((4, 40))
    motion = motion_of(actor, W)
    motion.positions[:] += [0, 6, 0]
    with pytest.raises(ValueError, match="head motion"):
        regress_sequence(actor, motion)


# -- Bad input --


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lam": -1}, "lam=-1"),
        ({"alphas": []}, "alphas is empty"),
        ({"alphas": [1, np.nan]}, "alphas holds 1"),
        ({"bounds": (1, 0)}, r"lower is above the upper for AU0 \(1 > 0\)"),
        ({"bounds": {"AU3": (2, 1)}}, r"AU3 \(2 > 1\)"),
        ({"bounds": (0, np.nan)}, "bounds holds NaN"),
        ({"bounds": (0, 1, 2)}, r"bounds=\(0, 1, 2\): give two bounds"),
        ({"bounds": {"AU3": (0, 1, 2)}}, r"bounds\['AU3'\]=\(0, 1, 2\): give two bounds"),
        ({"bounds": {"AU3": (0, np.ones(2))}}, r"bounds\['AU3'\] holds a bound of shape \(2,\)"),
        ({"bounds": {"AU3": (np.nan, 1)}}, r"bounds\['AU3'\] holds NaN"),
        ({"excluded": [5]}, "unknown unit.*5"),
        ({"align": np.array([True, False])}, "align=array"),
        ({"align": None}, "align=None"),
        ({"bounds": (0, np.ones(5))}, r"shape \(5,\)"),
        ({"bounds": {"AU99": (0, 1)}}, "unknown unit.*AU99"),
        ({"locked": {"AU99": 1}}, "unknown unit.*AU99"),
        ({"excluded": "AU99"}, "unknown unit.*AU99"),
        ({"locked": {"AU1": 1}, "excluded": ["AU1"]}, "both locked and excluded"),
        ({"locked": {"AU1": np.inf}}, r"locked\['AU1'\]"),
        ({"criterion": "luck"}, "criterion='luck'"),
        ({"align": "maybe"}, "align='maybe'"),
    ],
)
def test_bad_settings_are_refused_by_name(rig, sketch, given, message):
    with pytest.raises(ValueError, match=message):
        regress_expression(rig, sketch, **given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"bounds": 1}, "bounds=1: give two bounds"),
        ({"bounds": {"AU3": 0.5}}, r"bounds\['AU3'\]=0.5: give two bounds"),
        ({"bounds": (0, "x")}, "bounds holds 'x', which is no number"),
        ({"bounds": {"AU3": (0, "x")}}, r"bounds\['AU3'\] holds 'x', which is no number"),
        ({"alphas": [1, [2, 3]]}, r"alphas is a list.*numbers of shape \(A,\)"),
        ({"excluded": 5}, "excluded is a int, but must be of type Iterable; give names"),
        (
            {"locked": ["AU1"]},
            "locked is a list, but must be of type Mapping; give a weight by name",
        ),
    ],
)
def test_settings_of_another_kind_are_refused_by_name(rig, sketch, given, message):
    with pytest.raises(TypeError, match=message):
        regress_expression(rig, sketch, **given)


@pytest.mark.parametrize("alphas", [2, np.array(2), (a for a in [2]), np.array([2.0])])
def test_alphas_may_be_one_number_or_any_row_of_them(rig, sketch, alphas):
    np.testing.assert_array_equal(regress_expression(rig, sketch, alphas=alphas).alphas, [2.0])


def test_bounds_may_be_an_array_and_infinity_is_no_bound(rig, sketch):
    plain = regress_expression(rig, sketch, bounds=(0, 1))
    pair = regress_expression(rig, sketch, bounds=np.array([0, 1]))
    np.testing.assert_array_equal(pair.weights, plain.weights)
    for none in (None, (None, None), (-np.inf, np.inf), dict.fromkeys(rig.names, (None, np.inf))):
        fit = regress_expression(rig, sketch, alphas=[0], bounds=none)
        assert np.isneginf(fit.lo).all() and np.isposinf(fit.hi).all()


@pytest.mark.parametrize("no", [0, np.False_])
def test_whatever_equals_false_takes_no_motion_out(rig, sketch, no):
    moved = sketch + [0, 0, 5.0]
    fit = regress_expression(rig, moved, align=no)
    assert fit.alignment is None
    np.testing.assert_allclose(fit.displacement, moved - rig.neutral.vertices, atol=1e-12)


def test_bad_sketches_and_kinds_are_refused(rig, sketch):
    spoilt = sketch.copy()
    spoilt[5, 1] = np.nan
    with pytest.raises(ValueError, match=r"sketch holds 1 .* index \(5, 1\)"):
        regress_expression(rig, spoilt)
    with pytest.raises(ValueError, match=r"\(161, 3\).*\(162, 3\)"):
        regress_expression(rig, sketch[1:])
    with pytest.raises(TypeError, match="BlendshapeRig"):
        regress_expression(sketch, sketch)
    with pytest.raises(TypeError, match=r"sketch is a str.*shape \(n_vertices, 3\)"):
        regress_expression(rig, "abc")
    with pytest.raises(TypeError, match="MotionSequence"):
        regress_sequence(rig, sketch)


@pytest.fixture
def patch_fits(rig):
    """Fits on so few vertices that each unit counts."""
    small = rig.on(np.unique(rig.neutral.faces[:16]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a patch is no face, and hardly sees some units
        fits = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            true = rng.uniform(0, 1, 12) * (rng.random(12) < 0.4)
            noise = rng.normal(scale=0.3, size=small.neutral.vertices.shape)
            sketch = small.shape(true) + noise
            fits.append(regress_expression(small, sketch, 1.0, np.linspace(0, 8, 81), align=False))
    return fits


def test_gcv_is_the_error_over_what_the_units_leave_free(patch_fits):
    """GCV = (RSS / n) / (1 - units / n)^2, and alpha is where it is least."""
    n, differ = patch_fits[0].displacement.size, 0
    for fit in patch_fits:
        units = ((fit.weights > 1e-9) & (fit.weights < 1 - 1e-9)).sum(axis=1)
        gcv, other = fit.rms**2 / (1 - units / n) ** 2, fit.rms**2 / (1 - units / n)
        gcv, other = (np.where(fit.reachable, x, np.inf).argmin() for x in (gcv, other))
        assert fit.choose("gcv") == gcv
        differ += other != gcv
    assert differ  # without the root another alpha would be chosen somewhere


def test_fewest_takes_the_fewest_units_within_a_twentieth_of_the_smallest_error(patch_fits):
    between = 0
    for fit in patch_fits:
        count = (np.abs(fit.weights) > 0.05).sum(axis=1)
        close, loose = (fit.rms <= share * fit.rms.min() + 0.01 for share in (1.05, 1.15))
        wanted, chosen = count[close & fit.reachable].min(), fit.choose("fewest")
        assert close[chosen] and count[chosen] == wanted
        between += count[loose & fit.reachable].min() < wanted
    assert between  # within 15 % fewer units would have been taken somewhere
