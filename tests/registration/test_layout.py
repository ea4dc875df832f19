"""The warp and the prior against Gaussian conditioning, written out."""

from dataclasses import replace

import numpy as np
import pytest

import facelab
from facelab.geometry.binding import bind_to_samples
from facelab.geometry.symmetry import mirror_twins
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.registration.layout import MarkerLayout, covariance
from facelab.registration.prior import PriorLayout

N = 400  # vertices


NAMES = (
    "chin nose_tip mouth_corner_left mouth_corner_right brow_left_1 brow_right_1 brow_left_4 "
    "brow_right_4 jaw_left_5 jaw_right_5"
).split()


@pytest.fixture(scope="module")
def small():
    """A face of few vertices, with landmarks."""
    face = facelab.load_template(4375)
    samples, mesh = face.subsample(N, [face.landmarks[name] for name in NAMES])
    marks = {n: int(np.flatnonzero(samples == face.landmarks[n])[0]) for n in NAMES}
    return facelab.TriangleMesh(mesh.vertices, mesh.faces, marks)


@pytest.fixture(scope="module")
def fit(small):
    """It, with markers on 28 vertices."""
    others = np.setdiff1d(np.arange(0, N, 23), list(small.landmarks.values()))
    glued = small.vertices[[*small.landmarks.values(), *others]]
    names = [*small.landmarks, *(f"m{i}" for i in others)]
    return facelab.fit_markers(small, glued, names, offset=0)


@pytest.fixture
def models(small, rng):
    """A holistic and a region model of some motion that is smooth and one-sided."""
    waves = [np.sin(small.vertices @ k / 40 + k.sum()) for k in rng.normal(size=(18, 3))]
    modes = np.stack(waves).reshape(6, 3, N).transpose(0, 2, 1)
    X = np.tensordot(rng.normal(size=(60, 6)) * [5, 4, 3, 2, 2, 1], modes, axes=1) + modes[0]
    X = X.reshape(60, -1)
    labels = (small.vertices[:, 1] > 0).astype(int)
    regions = facelab.segmentation.Regions(labels, small)
    return [HolisticModel(5).fit(X), RegionModel(regions, 3).fit(X)]


def fewer(fit, keep):
    some = {k: getattr(fit, k)[keep] for k in ("rest", "faces", "weights", "residuals")}
    return replace(fit, names=tuple(np.array(fit.names)[keep]), **some)


def literal_field(fit, models=(), share=0.25, mirror=0.5):
    """Covariance of the whole face, (3 N, 3 N), entry by entry."""
    mesh, preset = fit.mesh, fit.preset
    G = mesh.geodesics()
    twin = mirror_twins(mesh)
    share = share if models else 0.0
    K = np.zeros((N, 3, N, 3))
    for model in models:
        mean, deviation = model.training()
        moments = np.hypot(mean, deviation)
        modes = [np.sqrt(a) * B for a, B in zip(moments, model.basis, strict=True)]
        C = sum(np.multiply.outer(mode, mode) for mode in modes)
        usual = np.mean([C[v, x, v, x] for v in range(N) for x in range(3)])
        K += share * C / usual / len(models)
    alike = 16 + np.exp(-G / preset.motion_reach)
    for x, sign in enumerate((-1, 1, 1)):
        K[:, x, :, x] += (1 - share) * alike
        K[:, x, :, x] += (1 - share) * mirror * sign * (alike[:, twin] + alike[twin]) / 2
    return preset.motion_size**2 * K.reshape(3 * N, 3 * N)


def conditioned(K, at, noise, y):
    """Mean and covariance of a Gaussian, some of which was seen."""
    own = covariance(K[np.ix_(at, at)]) + noise**2 * np.eye(len(at))
    W = np.linalg.solve(own, K[:, at].T).T
    return W @ y, K - W @ K[:, at].T


def places(feet):
    return (3 * feet[:, None] + np.arange(3)).ravel()


def test_the_warp_is_the_mean_of_a_gaussian_field_given_the_markers(fit, rng):
    layout = MarkerLayout(fit)
    moved = rng.normal(scale=4, size=(2, len(fit.names), 3))
    K = literal_field(fit, mirror=0.0)
    for frame, made in zip(moved, layout.carrier()(moved), strict=True):
        mean, left = conditioned(K, places(layout.feet), fit.preset.noise, frame.ravel())
        np.testing.assert_allclose(made.ravel(), mean, atol=1e-4)  # float32
    np.testing.assert_allclose(made, layout.carry @ moved[1], atol=1e-4)
    spread = np.sqrt(np.maximum(np.diag(left), 0)).reshape(N, 3)
    np.testing.assert_allclose(layout.spread(), spread[:, 0], atol=1e-4)


def test_the_prior_is_plain_gaussian_conditioning(fit, models, rng):
    layout = fit.with_prior(*models).layout
    assert isinstance(layout, PriorLayout)
    moved = rng.normal(scale=4, size=(2, len(fit.names), 3))
    K = literal_field(fit, models)
    some = np.array([3, 50, 399])
    for frame, made in zip(moved, layout.carrier(some)(moved), strict=True):
        at = places(layout.feet)
        mean, left = conditioned(K, at, fit.preset.noise, frame.ravel())
        np.testing.assert_allclose(made.ravel(), mean[places(some)], atol=1e-3)
    np.testing.assert_allclose(layout.smoothed(moved)[1].ravel(), mean[at], atol=1e-6)
    spread = np.sqrt(np.maximum(np.diag(left), 0).reshape(N, 3).mean(axis=1))
    # the distance of a place from its own twin is that of a straight line in `spread`
    assert np.abs(layout.spread() / spread - 1)[spread > 0.5].max() < 0.1


@pytest.mark.parametrize("prior", [False, True])
def test_a_marker_left_out_by_formula_is_one_left_out_by_a_refit(fit, models, rng, prior):
    fit = fit.with_prior(*models) if prior else fit
    moved = rng.normal(scale=4, size=(3, len(fit.names), 3))
    off = fit.layout.left_out(moved)
    for marker in (0, 5, len(fit.names) - 1):
        keep = np.arange(len(fit.names)) != marker
        foot = fit.layout.feet[marker]
        told = fewer(fit, keep).layout.carrier([foot])(moved[:, keep])[:, 0]
        np.testing.assert_allclose(off[:, marker], moved[:, marker] - told, atol=1e-3)


@pytest.mark.parametrize("prior", [False, True])
def test_hidden_markers_are_filled_as_by_a_refit_with_the_seen_ones(fit, models, rng, prior):
    fit = fit.with_prior(*models) if prior else fit
    moved = rng.normal(scale=4, size=(4, len(fit.names), 3))
    hidden = rng.random(moved.shape[:2]) < 0.4
    moved[hidden] = np.nan
    dense = fit.layout.carrier()(fit.layout.filled(moved))
    for frame, gone in enumerate(hidden):
        refit = fewer(fit, ~gone).layout.carrier()(moved[frame : frame + 1, ~gone])[0]
        np.testing.assert_allclose(dense[frame], refit, atol=2e-3)


def test_the_prior_is_linear_and_a_face_at_rest_stays_at_rest(fit, models, rng):
    carried = fit.with_prior(*models).layout.carrier()
    a, b = rng.normal(scale=4, size=(2, 1, len(fit.names), 3))
    np.testing.assert_allclose(carried(2 * a - b), 2 * carried(a) - carried(b), atol=1e-3)
    assert not carried(0 * a).any()


def test_motion_of_the_models_own_is_filled_nearer_than_by_smoothness(fit, models, rng):
    """Planted: the truth is a face of the model, seen at 12 markers."""
    few = fewer(fit, np.arange(0, len(fit.names), 3))
    model = models[0]
    mean, deviation = model.training()
    truth = model.displacements(mean + deviation * rng.normal(size=(20, len(mean))))
    errors = {}
    for name, some in {"warp": few, "prior": few.with_prior(model, share=0.9)}.items():
        made = some.layout.carrier()(truth[:, some.layout.feet])
        errors[name] = np.sqrt(((made - truth) ** 2).sum(axis=2).mean())
    assert errors["prior"] < 0.3 * errors["warp"], errors


def test_what_one_side_does_the_other_is_taken_to_do(fit):
    left, right = (fit.names.index(f"mouth_corner_{side}") for side in ("left", "right"))
    moved = np.full((1, len(fit.names), 3), np.nan)
    moved[0, left] = [2.0, 5.0, 1.0]
    plain, sides = (f.layout.filled(moved)[0, right] for f in (fit, fit.with_prior()))
    assert sides[1] > plain[1] > 0 and sides[0] < plain[0]  # up like it, and outwards like it


def test_models_on_samples_are_carried_to_the_mesh_by_a_binding(fit, rng):
    samples = np.arange(0, N, 2)
    binding = bind_to_samples(fit.mesh, samples)
    X = rng.normal(size=(30, 3 * len(samples)))
    prior = fit.with_prior(HolisticModel(4).fit(X), binding=binding).prior
    assert prior.shapes.shape == (4, N, 3)
    np.testing.assert_allclose((prior.shapes**2).sum(axis=0).mean(), 1)


def test_models_that_do_not_fit_are_refused(fit, models, rng):
    with pytest.raises(TypeError, match="give face models"):
        fit.with_prior("a model")
    with pytest.raises(ValueError, match=rf"moves 12 vertices, but {N} are needed"):
        fit.with_prior(HolisticModel(2).fit(rng.normal(size=(9, 36))))
    with pytest.raises(ValueError, match="share"):
        fit.with_prior(models[0], share=1.5)
    rig = facelab.BlendshapeRig(fit.mesh, ["a"], rng.normal(size=(1, N, 3)))
    with pytest.raises(ValueError, match="no variances"):
        fit.with_prior(rig)
