"""The model between holistic and regions: its equations by loops, its choices, what it promises."""

import numpy as np
import pytest
from planted import bumps, corner_regions
from shapes import grid_mesh
from sklearn.exceptions import NotFittedError

from facelab.models import global_local
from facelab.models.evaluation import rms_error
from facelab.models.global_local import (
    LARGEST,
    SHARES,
    GlobalLocalModel,
    estimated_error,
    expressions,
    noise_variance,
    shrinkage,
)
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.models.store import load_model
from facelab.posing.session import PosingSession
from facelab.segmentation.regions import Regions


def noisy_bumps(rng, n_frames=120, noise=0.1):
    """Frames of 42 vertices, every quarter moving by itself: noisy, and as they are."""
    cut = corner_regions()
    truth = bumps(cut.mesh, cut.labels, rng, n_frames)
    return truth + rng.normal(scale=noise, size=truth.shape), truth


@pytest.fixture
def frames(rng):
    return noisy_bumps(rng)[0]


# --- the equations, one number at a time ----------------------------------------------------------


def literal_covariance(X, cut, share, softness):
    """K of the docstring, entry by entry."""
    G, n, R = cut.mesh.geodesics(), cut.mesh.n_vertices, cut.n_regions
    S = np.zeros((R, n))
    for v in range(n):
        belongs = [
            sum(np.exp(-(G[v, u] ** 2) / (2 * softness**2)) for u in range(n) if cut.labels[u] == r)
            for r in range(R)
        ]
        for r in range(R):
            S[r, v] = np.sqrt(belongs[r] / sum(belongs))
    mean = X.mean(axis=0)
    K = np.zeros((3 * n, 3 * n))
    for i in range(3 * n):
        for j in range(3 * n):
            c = sum((x[i] - mean[i]) * (x[j] - mean[j]) for x in X) / (len(X) - 1)
            apart = sum(S[r, i // 3] * c * S[r, j // 3] for r in range(R))
            K[i, j] = (1 - share) * c + share * apart
    return K


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_modes_are_the_leading_eigenvectors_of_the_covariance_as_written(frames, share):
    cut, X = corner_regions(), frames[:12]
    model = GlobalLocalModel(cut, 6, share=share, softness=15.0).fit(X)
    values, vectors = np.linalg.eigh(literal_covariance(X, cut, share, 15.0))
    np.testing.assert_allclose(model.variances_[0], values[::-1][:6], rtol=1e-9)
    overlap = np.abs(model.components_[0] @ vectors[:, ::-1][:, :6])
    np.testing.assert_allclose(overlap, np.eye(6), atol=1e-6)


def literal_shrinkage(z, variances, noise):
    a, start, width = np.zeros(len(z)), 0, 20
    while start < len(z):
        band = range(start, min(start + width, len(z)))
        best, least = None, np.inf
        for t in 10.0 ** np.arange(-1, 3.01, 0.5):
            cost = 0.0  # -2 log likelihood of a normal with this variance, but for a constant
            for k in band:
                v = t * max(variances[k] - noise, noise / 1000)
                cost += np.log(v + noise) + z[k] ** 2 / (v + noise)
            if cost < least:
                best, least = t, cost
        for k in band:
            v = best * max(variances[k] - noise, noise / 1000)
            a[k] = v / (v + noise)
        start, width = start + width, 2 * width
    return a


def test_coefficients_are_shrunk_as_written(rng):
    variances = np.sort(rng.gamma(0.3, size=75))[::-1] + 0.01
    Z = rng.normal(size=(6, 75)) * np.sqrt(variances) * rng.uniform(0.2, 8, size=(6, 1))
    expected = [literal_shrinkage(z, variances, 0.01) for z in Z]
    np.testing.assert_allclose(shrinkage(Z, variances, 0.01), expected, atol=1e-12)


def test_the_share_is_the_one_that_rebuilds_expressions_left_out(frames):
    cut, P = corner_regions(), 10
    clusters, s2 = expressions(frames), noise_variance(frames)
    risks = np.zeros(len(SHARES))
    for k in range(5):
        for i, share in enumerate(SHARES):
            model = GlobalLocalModel(cut, P, share=share).fit(frames[clusters != k])
            Z = (frames[clusters == k] - model.mean_) @ model.components_[0].T
            for x, z in zip(frames[clusters == k], Z, strict=True):
                a = literal_shrinkage(z, model.variances_[0], s2)
                x_hat = model.mean_ + (a * z) @ model.components_[0]
                risk = ((x - x_hat) ** 2).sum() - 126 * s2 + 2 * s2 * a.sum()
                risks[i] += risk / (clusters == k).sum()
    chosen = SHARES[int(risks.argmin())]
    assert GlobalLocalModel(cut, P).fit(frames).share_ == chosen
    assert GlobalLocalModel(cut).shares_for(frames, [P, 3])[0] == chosen


def test_every_expression_is_left_out_once_for_each_share(frames, monkeypatch):
    asked = []

    def watched(D, *rest):
        asked.append(len(D))
        return estimated_error(D, *rest)

    monkeypatch.setattr(global_local, "estimated_error", watched)
    monkeypatch.setattr(global_local, "_ASKED", len(frames))
    GlobalLocalModel(corner_regions()).shares_for(frames, [10])
    sizes = np.bincount(expressions(frames))
    assert sorted(asked) == sorted(np.repeat(sizes, len(SHARES)))


def test_the_estimate_of_the_error_is_that_of_the_truth_on_average(rng):
    X, truth = noisy_bumps(rng, 3120)
    model = GlobalLocalModel(corner_regions(), 24, share=0.3).fit(X[:120])
    fresh, truth = X[120:], truth[120:]
    D = fresh - model.mean_
    Z = D @ model.components_[0].T
    a = shrinkage(Z, model.variances_[0], 0.01)
    made = model.mean_ + (a * Z) @ model.components_[0]
    estimated = estimated_error(D, Z, model.variances_[0], 0.01)
    literal = ((fresh - made) ** 2).sum(axis=1) - 126 * 0.01 + 2 * 0.01 * a.sum(axis=1)
    assert estimated == pytest.approx(literal.mean(), rel=1e-9)
    true = ((truth - made) ** 2).sum(axis=1).mean()
    assert estimated == pytest.approx(true, rel=0.03)
    plain = ((fresh - made) ** 2).sum(axis=1).mean()
    assert abs(plain - true) > 0.1 * true, "or any estimate would do"


# --- noise ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(400, 120), (100, 300), (130, 126)])
def test_the_noise_is_found_below_a_signal_whatever_the_number_of_frames(rng, shape):
    n, p = shape
    signal = 5 * rng.normal(size=(n, 6)) @ rng.normal(size=(6, p))
    X = signal + rng.normal(scale=0.3, size=shape)
    assert np.sqrt(noise_variance(X)) == pytest.approx(0.3, rel=0.08)


def test_without_noise_nothing_is_shrunk(rng):
    Z = rng.normal(size=(4, 30))
    assert (shrinkage(Z, np.linspace(3, 0, 30), 0.0) == 1).all()
    _, truth = noisy_bumps(rng)
    model = GlobalLocalModel(corner_regions(), 20, share=0.7).fit(truth)
    plain = model.mean_ + (truth - model.mean_) @ model.components_[0].T @ model.components_[0]
    np.testing.assert_allclose(model.reconstruct(truth), plain, atol=1e-6)


# --- what it is between ---------------------------------------------------------------------------


def test_at_share_zero_its_modes_are_the_holistic_ones(frames):
    model = GlobalLocalModel(corner_regions(), 8, share=0).fit(frames)
    whole = HolisticModel(8).fit(frames)
    np.testing.assert_allclose(model.components_[0], whole.components_[0], atol=1e-8)
    np.testing.assert_allclose(model.variances_[0], whole.variances_[0], rtol=1e-8)


def test_a_vertex_keeps_its_variance_whatever_the_share(frames):
    for share in (0.0, 0.5, 1.0):
        K = literal_covariance(frames[:9], corner_regions(), share, 20.0)
        np.testing.assert_allclose(np.diagonal(K), frames[:9].var(axis=0, ddof=1), rtol=1e-9)


def test_quarters_that_never_moved_alone_are_rebuilt_alone_where_shares_are_high(rng):
    cut = corner_regions()
    together = np.zeros((60, 126))
    for members in cut.members:  # all quarters rise and fall as one
        shape = np.zeros((42, 3))
        shape[members] = rng.normal(size=3)
        together += np.outer(np.linspace(-5, 5, 60), shape.ravel())
    together += rng.normal(scale=0.05, size=together.shape)
    alone = np.zeros((42, 3))
    alone[cut.members[0]] = together[0].reshape(42, 3)[cut.members[0]]
    asked = alone.reshape(1, -1)
    errors = [
        rms_error(
            asked, GlobalLocalModel(cut, 12, share=s, softness=5.0).fit(together).reconstruct(asked)
        )
        for s in (0.0, 0.7)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_on_noisy_frames_of_unseen_mixtures_it_beats_holistic_and_regions(rng):
    X, _ = noisy_bumps(rng, 80, 0.3)
    asked, truth = noisy_bumps(np.random.default_rng(77), 60, 0.3)
    cut = corner_regions()
    model = GlobalLocalModel(cut, 24).fit(X)
    peers = HolisticModel(24).fit(X), RegionModel(cut, 24, spread="total").fit(X)
    least = min(rms_error(truth, peer.reconstruct(asked)) for peer in peers)
    assert rms_error(truth, model.reconstruct(asked)) < least


# --- a model like the others ----------------------------------------------------------------------


def test_it_comes_back_from_a_file_to_the_bit(frames, tmp_path):
    for share in (None, 0.5):
        model = GlobalLocalModel(corner_regions(), 9, share=share, softness=18.0).fit(frames)
        model.save(tmp_path / "model.npz")
        again = load_model(tmp_path / "model.npz")
        assert isinstance(again, GlobalLocalModel) and again.share == share
        assert (again.share_, again.noise_) == (model.share_, model.noise_)
        assert again.softness == 18.0 and again.cut.n_regions == 4
        np.testing.assert_array_equal(again.reconstruct(frames), model.reconstruct(frames))


def test_fewer_modes_are_its_strongest_with_the_same_share(frames):
    model = GlobalLocalModel(corner_regions(), 20, share=0.3).fit(frames)
    few = model.truncated(6)
    fitted = GlobalLocalModel(corner_regions(), 6, share=0.3).fit(frames)
    assert (few.share_, few.noise_, few.n_coefficients) == (0.3, model.noise_, 6)
    np.testing.assert_allclose(few.reconstruct(frames), fitted.reconstruct(frames), atol=1e-8)


def test_sessions_pose_it_and_take_faces_as_they_are(frames):
    model = GlobalLocalModel(corner_regions(), 12).fit(frames)
    session = PosingSession(model, model.mesh)
    session.drag(20, model.mesh.vertices[20] + [1.0, 2.0, 0])
    session.release()
    assert np.linalg.norm(session.vertices[20] - model.mesh.vertices[20]) > 0.2
    c = np.random.default_rng(1).normal(size=(2, 12))
    np.testing.assert_allclose(model.encode(model.displacements(c)), c, atol=1e-9)


def test_blocks_are_learned_from_as_one(frames):
    model = GlobalLocalModel(corner_regions(), 9, share=0.3)
    whole = model.fit(frames).reconstruct(frames)
    blocks = model.fit_blocks(np.array_split(frames, 3), progress=False).reconstruct(frames)
    np.testing.assert_array_equal(blocks, whole)


def test_blocks_with_values_hidden_or_lost_are_refused(frames):
    model = GlobalLocalModel(corner_regions(), 9, share=0.3)
    hidden = np.ma.masked_greater(frames, 3)
    lost = np.where(frames > 3, np.nan, frames)
    for bad, message in ((hidden, "masked"), (lost, "one of the blocks"), (frames[:, 3:], "shape")):
        with pytest.raises(ValueError, match=message):
            model.fit_blocks([frames, bad], progress=False)
    assert not hasattr(model, "mean_")


def test_a_dask_array_is_learned_from_as_one_in_memory(frames):
    array = pytest.importorskip("dask.array").from_array(frames, chunks=(50, 126))
    model = GlobalLocalModel(corner_regions(), 9)
    whole = model.fit(frames).reconstruct(frames)
    share, noise = model.share_, model.noise_
    again = GlobalLocalModel(corner_regions(), 9).fit(array)
    assert (again.share_, again.noise_) == (share, noise)
    np.testing.assert_array_equal(again.reconstruct(frames), whole)


def test_few_frames_take_the_middle_share(frames):
    model = GlobalLocalModel(corner_regions(), 4).fit(frames[:10])
    assert expressions(frames[:10]) is None and model.share_ == SHARES[1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"cut": None}, "cut is a NoneType"),
        ({"share": 1.5}, "share=1.5"),
        ({"softness": 0}, "softness=0"),
        ({"n_components": 0.9}, "n_components=0.9 is not an integer"),
        ({"n_components": 500}, "n_components=500"),
    ],
)
def test_settings_that_cannot_be_are_refused(frames, settings, message):
    with pytest.raises((TypeError, ValueError), match=message):
        GlobalLocalModel(**({"cut": corner_regions(), "n_components": 5} | settings)).fit(frames)


def test_another_mesh_and_a_dense_one_are_refused(frames, rng):
    with pytest.raises(ValueError, match="X has 123 columns, but cut lies on 42 vertices"):
        GlobalLocalModel(corner_regions(), 5).fit(frames[:, :-3])
    mesh = grid_mesh(40, 30, 5.0)
    assert 3 * mesh.n_vertices > LARGEST
    dense = Regions(np.arange(1200) % 40 // 20, mesh)
    with pytest.raises(ValueError, match=f"at most {LARGEST} are decomposed"):
        GlobalLocalModel(dense, 2).fit(rng.normal(size=(4, 3600)))
    with pytest.raises(NotFittedError):
        PosingSession(GlobalLocalModel(corner_regions()), corner_regions().mesh)
