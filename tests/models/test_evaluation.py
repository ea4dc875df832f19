import literal
import numpy as np
import pytest
from planted import bumps, quarters, three_strips
from real_face import NOISE, control_face, models
from scipy.spatial.distance import cdist
from shapes import grid_mesh

from facelab.geometry.symmetry import mirror_weights, mirrored, one_sided, other_side, symmetrised
from facelab.models.evaluation import (
    ErrorCurve,
    error_curves,
    frame_errors,
    rank_of_motion,
    rms_error,
    sparse_model,
    variance_across,
)
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.segmentation.regions import Regions


def test_error_is_equation_13(rng):
    X, X_hat = rng.normal(size=(2, 7, 11, 3))
    assert rms_error(X, X_hat) == pytest.approx(literal.eq_13(X, X_hat), rel=1e-12)


def test_flat_frames_and_frames_of_points_have_the_same_error(rng):
    X, X_hat = rng.normal(size=(2, 7, 11, 3))
    flat = rms_error(X.reshape(7, 33), X_hat.reshape(7, 33))
    assert flat == pytest.approx(rms_error(X, X_hat), rel=1e-14)


def test_every_vertex_off_by_two_millimetres_is_an_error_of_two_millimetres(rng):
    away = rng.normal(size=(5, 9, 3))
    away *= 2 / np.linalg.norm(away, axis=2, keepdims=True)
    assert rms_error(away + 100, np.full_like(away, 100)) == pytest.approx(2, rel=1e-12)


def test_a_perfect_copy_has_no_error(rng):
    X = rng.normal(size=(4, 6))
    assert rms_error(X, X) == 0


def test_error_is_the_same_both_ways_and_grows_with_the_unit(rng):
    X, X_hat = rng.normal(size=(2, 4, 6))
    assert rms_error(X, X_hat) == rms_error(X_hat, X)
    assert rms_error(10 * X, 10 * X_hat) == pytest.approx(10 * rms_error(X, X_hat), rel=1e-12)


def test_noise_of_a_third_of_a_millimetre_on_each_axis_makes_a_floor_of_half_a_millimetre(rng):
    noise = rng.normal(scale=0.3, size=(200, 100, 3))
    # 0.3 sqrt(3); the estimate from 60,000 numbers is off by about 0.3 % (one sigma)
    assert rms_error(noise, np.zeros_like(noise)) == pytest.approx(0.3 * np.sqrt(3), rel=0.015)


def test_numbers_of_low_precision_are_summed_in_high_precision():
    X = np.full((3000, 300), 0.1, dtype=np.float32)
    expected = np.sqrt(3) * float(np.float32(0.1))
    assert rms_error(X, np.zeros_like(X)) == pytest.approx(expected, rel=1e-9)


def test_a_missing_number_is_not_passed_over():
    X = np.zeros((2, 6))
    X[1, 3] = np.nan
    assert np.isnan(rms_error(X, np.zeros((2, 6))))


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match=r"X has shape \(2, 6\), X_hat \(2, 9\)"):
        rms_error(np.zeros((2, 6)), np.zeros((2, 9)))


@pytest.mark.parametrize("shape", [(0, 6), (4, 0), (3, 4), (3, 3, 2), ()])
def test_no_frames_or_no_three_coordinates_are_refused(shape):
    with pytest.raises(ValueError, match="no frames, or not three coordinates"):
        rms_error(np.zeros(shape), np.zeros(shape))


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        (lambda X, mesh: error_curves([], X, takes=[1, 2]), ValueError, r"takes has shape \(2,\)"),
        (lambda X, mesh: rank_of_motion(X, -1), ValueError, "tolerance=-1"),
        (lambda X, mesh: one_sided(X, mesh, "up"), ValueError, "side='up'"),
        (lambda X, mesh: other_side(X[:, :9], mesh), ValueError, "X has shape"),
        (lambda X, mesh: mirrored(X[:, :9], mirror_weights(mesh)), ValueError, "X has shape"),
        (lambda X, mesh: mirror_weights(X), TypeError, "mesh is a ndarray"),
        (lambda X, mesh: sparse_model(np.nan * X, 3), ValueError, "NaN"),
        (lambda X, mesh: curve_of(None).band(0), ValueError, "level=0"),
    ],
)
def test_what_makes_no_sense_is_refused(rng, sphere, wrong, error, message):
    X = rng.normal(size=(6, 3 * sphere.n_vertices))
    with pytest.raises(error, match=message):
        wrong(X, sphere)


# --- curves ---------------------------------------------------------------------------------------


def curve_of(rng, n_models=3, sizes=(10, 20, 5)):
    """A curve on takes whose frames all have the same error."""
    level = np.repeat([1.0, 4.0, 9.0], sizes)
    squares = level / np.arange(1, n_models + 1)[:, None]
    takes = np.repeat(["a", "b", "c"], sizes)
    return ErrorCurve(np.arange(n_models), 10 * np.arange(n_models), squares, takes)


def test_frame_errors_average_to_the_square_of_the_error(rng):
    X, X_hat = rng.normal(size=(2, 7, 33))
    per_frame = frame_errors(X, X_hat)
    assert per_frame[2] == pytest.approx(
        literal.eq_13(*(x[2:3].reshape(1, 11, 3) for x in (X, X_hat))) ** 2
    )
    assert np.sqrt(per_frame.mean()) == pytest.approx(rms_error(X, X_hat), rel=1e-14)


def test_a_curve_of_nested_models_is_that_of_models_trained_one_by_one(rng):
    regions = three_strips()
    X, T, truth = rng.normal(size=(3, 60, 135))
    rich = RegionModel(regions, 20, beta=0.2).fit(X)
    targets = {"frames": T, "truth": truth}
    curves = error_curves((rich.truncated(n) for n in (1, 5, 20)), T, targets)
    for i, n in enumerate((1, 5, 20)):
        X_hat = RegionModel(regions, n, beta=0.2).fit(X).reconstruct(T)
        assert curves["frames"].rms[i] == pytest.approx(rms_error(T, X_hat), rel=1e-9)
        assert curves["truth"].rms[i] == pytest.approx(rms_error(truth, X_hat), rel=1e-9)
    assert curves["truth"].components.tolist() == [1, 5, 20]
    assert curves["truth"].parameters.tolist() == [3, 15, 60]


def test_a_curve_on_some_frames_is_that_of_these_frames(rng):
    curve = curve_of(rng)
    np.testing.assert_allclose(curve.of(curve.takes == "b").rms, 2 / np.sqrt([1, 2, 3]))


def test_the_bootstrap_draws_whole_takes(rng):
    curve = curve_of(rng, 1)
    drawn = np.round(curve.draws(2000)[:, 0] ** 2, 9)
    possible = {
        round((10 * a + 4 * 20 * b + 9 * 5 * c) / (10 * a + 20 * b + 5 * c), 9)
        for a in range(4)
        for b in range(4 - a)
        for c in [3 - a - b]
    }
    assert set(drawn.tolist()) == possible


def test_the_band_holds_the_error_and_closes_where_takes_are_alike(rng):
    curve = curve_of(rng)
    low, high = curve.band()
    assert (low < curve.rms).all()
    assert (curve.rms < high).all()
    np.testing.assert_array_equal(curve.band(random_state=3), curve.band(random_state=3))
    alike = curve.of(curve.takes == "a")
    np.testing.assert_allclose(alike.band(), np.tile(alike.rms, (2, 1)))


def test_the_band_covers_the_error_as_often_as_it_says():
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):  # 40 takes with errors about 1 mm^2, all of one length
        squares = np.repeat(rng.gamma(4.0, 0.25, size=40), 3)
        low, high = ErrorCurve(np.ones(1), np.ones(1), squares[None], np.repeat(range(40), 3)).band(
            0.8, 200, rng
        )
        hits += low[0] < 1 < high[0]
    # 160 expected; a bootstrap of 40 is a little narrow, chance adds 6 (one sigma)
    assert 135 < hits < 180


def test_variance_across_individuals_is_zero_where_all_fare_alike(rng):
    curve = curve_of(rng)
    np.testing.assert_array_equal(variance_across([curve, curve]), 0)
    two = [curve.of(curve.takes == t) for t in "ab"]  # 1 and 2 mm, over root n
    np.testing.assert_allclose(variance_across(two), 0.25 / np.array([1, 2, 3]))


def test_the_rank_of_motion_is_that_of_its_shapes(rng):
    shapes = np.linalg.qr(rng.normal(size=(60, 7)))[0].T
    X = rng.normal(size=(50, 7)) @ shapes
    assert rank_of_motion(X, 1e-6) == 7
    assert rank_of_motion(X + 1e-9 * rng.normal(size=X.shape), 1e-6) == 7
    assert rank_of_motion(0 * X, 0) == 0
    s = np.linalg.svd(X, compute_uv=False)
    left = np.sqrt(3 * (s[4:] ** 2).sum() / X.size)
    assert rank_of_motion(X, left * 1.001) == 4
    assert rank_of_motion(X, left * 0.999) == 5


def test_sparse_modes_move_few_coordinates_and_find_planted_bumps(rng):
    regions = Regions(*quarters(6, 5)[::-1])
    X = bumps(regions.mesh, regions.labels, rng, width=6.0)
    X = X + 0.01 * rng.normal(size=X.shape)
    model = sparse_model(X, 12)
    assert (model.components_[0] == 0).mean() > 0.4
    assert rms_error(X, model.reconstruct(X)) < 0.3 * rms_error(X, 0 * X)
    np.testing.assert_array_equal(model.components_[0], sparse_model(X, 12).components_[0])


# --- left and right -------------------------------------------------------------------------------


def test_a_mesh_whose_vertices_mirror_each_other_gets_the_permutation(sphere):
    mirror = mirror_weights(sphere)
    partner = cdist(sphere.vertices * [-1, 1, 1], sphere.vertices).argmin(axis=1)
    np.testing.assert_allclose(mirror.toarray(), np.eye(len(partner))[partner], atol=1e-9)


def test_motion_mirrored_twice_is_itself_and_symmetric_motion_stays(rng, sphere):
    mirror = mirror_weights(sphere)
    X = rng.normal(size=(4, 3 * sphere.n_vertices))
    np.testing.assert_allclose(mirrored(mirrored(X, mirror), mirror), X, atol=1e-9)
    S = symmetrised(X, mirror)
    np.testing.assert_allclose(mirrored(S, mirror), S, atol=1e-9)
    opening = np.zeros((1, sphere.n_vertices, 3))
    opening[..., 0] = sphere.vertices[:, 0]  # both sides outwards: symmetric
    opening = opening.reshape(1, -1)
    np.testing.assert_allclose(symmetrised(opening, mirror), opening, atol=1e-9)
    sideways = np.tile([1.0, 0, 0], (1, sphere.n_vertices))  # all to the left: the opposite
    np.testing.assert_allclose(symmetrised(sideways, mirror), 0, atol=1e-9)


def test_smooth_motion_of_a_mesh_without_mirror_pairs_is_mirrored_by_interpolation(rng):
    mesh = grid_mesh(12, 9, 10.0)
    V = mesh.vertices - [52.0, 0, 0]  # not centred on a vertex
    V[:, :2] += rng.normal(scale=1, size=(len(V), 2))
    mesh = mesh.with_vertices(V)
    inner = (np.abs(V[:, 0]) < 40) & (np.abs(V[:, 1] - 40) < 32)  # not past the rim

    def motion(V):
        return np.stack([np.sin(V[:, 0] / 40), np.cos(V[:, 1] / 40), V[:, 0] / 50], axis=1)

    seen = mirrored(motion(V).reshape(1, -1), mirror_weights(mesh)).reshape(-1, 3)
    expected = motion(V * [-1, 1, 1]) * [-1, 1, 1]
    # linear in triangles of 10 mm: h^2 / 8 times a curvature of 1 / 40^2 is 0.008
    np.testing.assert_allclose(seen[inner], expected[inner], atol=0.02)


def test_one_side_is_left_and_the_other_is_at_rest(rng, sphere):
    X = rng.normal(size=(3, 3 * sphere.n_vertices))
    left = one_sided(X, sphere).reshape(3, -1, 3)
    x = sphere.vertices[:, 0]
    np.testing.assert_array_equal(left[:, x > 10], X.reshape(3, -1, 3)[:, x > 10])
    assert (left[:, x < -10] == 0).all()
    right = one_sided(X, sphere, "right")
    np.testing.assert_allclose(left.reshape(3, -1) + right, X, atol=1e-12)


def test_the_other_side_has_half_of_symmetric_motion_and_none_of_one_sided(rng, sphere):
    X = rng.normal(size=(3, 3 * sphere.n_vertices))
    S = symmetrised(X, mirror_weights(sphere))
    np.testing.assert_allclose(other_side(S, sphere), 0.5, atol=1e-9)
    np.testing.assert_array_equal(other_side(one_sided(X, sphere), sphere), 0)
    np.testing.assert_array_equal(other_side(one_sided(X, sphere, "right"), sphere), 1)
    np.testing.assert_array_equal(other_side(0 * X, sphere), 0)


@pytest.mark.parametrize("beta", [0.0, 0.5])
def test_regions_make_one_sided_faces_of_symmetric_motion_and_the_whole_face_cannot(rng, beta):
    mesh = grid_mesh(9, 7, 10.0)
    mesh = mesh.with_vertices(mesh.vertices - [40, 30, 0])
    labels = (mesh.vertices[:, 0] > 15).astype(int) + 2 * (mesh.vertices[:, 0] < -15)
    regions = Regions(labels, mesh)
    mirror = mirror_weights(mesh)
    X = symmetrised(bumps(mesh, labels, rng, width=9.0), mirror)
    X -= X.mean(axis=0)
    wink = one_sided(X[:5], mesh)
    whole = HolisticModel(3).fit(X)
    parts = RegionModel(regions, 6, beta).fit(X)
    # the span of symmetric frames holds none but those: of a half it can only make half of both
    np.testing.assert_allclose(
        other_side(whole.reconstruct(wink) - whole.mean_, mesh), 0.5, atol=1e-6
    )
    assert other_side(parts.reconstruct(wink) - parts.mean_, mesh).max() < 0.05
    assert rms_error(wink, parts.reconstruct(wink)) < 0.3 * rms_error(wink, whole.reconstruct(wink))


# --- generalisation: learned from one take, tested on another -------------------------------------


@pytest.fixture(scope="module")
def face(real_rig, real_takes):
    return control_face(real_rig, real_takes["alex_rom_3"])


@pytest.fixture(scope="module")
def unseen(face, real_rig, real_takes):
    """Frames of the other take, with noise and without."""
    take = real_takes["alex_rom_4"].resampled(15)[::2]
    X = real_rig.on(face.samples, face.mesh).animate(take).displacements()
    return X + np.random.default_rng(5).normal(scale=NOISE, size=X.shape), X


@pytest.mark.real
@pytest.mark.parametrize("n_components", range(1, 11))
def test_regions_describe_unseen_motion_better_than_the_whole_face(face, unseen, n_components):
    noisy, truth = unseen
    region, whole = models(face, n_components)
    assert rms_error(noisy, region.reconstruct(noisy)) < rms_error(noisy, whole.reconstruct(noisy))
    assert rms_error(truth, region.reconstruct(noisy)) < rms_error(truth, whole.reconstruct(noisy))


@pytest.mark.real
def test_the_error_against_noisy_frames_comes_down_to_the_noise_and_falls_with_each_mode(
    face, unseen
):
    noisy, _ = unseen
    errors = []
    for n in (1, 2, 4, 6, 8):
        region = models(face, n)[0]
        errors.append(rms_error(noisy, region.reconstruct(noisy)))
    assert (np.diff(errors) < 0).all()
    assert errors[-1] == pytest.approx(NOISE * np.sqrt(3), rel=0.04)  # what is left of the motion


@pytest.mark.real
def test_the_truth_is_met_below_the_noise(face, unseen):
    noisy, truth = unseen
    for model in models(face, 20):
        assert rms_error(truth, model.reconstruct(noisy)) < 0.5 * NOISE * np.sqrt(3)


def test_the_other_side_is_a_share_of_energy_not_of_amplitude(sphere):
    x = sphere.vertices[:, 0]
    left, right = x.argmax(), x.argmin()
    X = np.zeros((1, 3 * sphere.n_vertices))
    X[0, 3 * left], X[0, 3 * right + 1] = 2.0, -1.0
    np.testing.assert_allclose(other_side(X, sphere, width=1.0), 1 / (4 + 1))
    np.testing.assert_allclose(other_side(X, sphere, "right", width=1.0), 4 / (4 + 1))
