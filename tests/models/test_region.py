import pickle
import tracemalloc

import literal
import numpy as np
import pytest
from planted import bumps, corner_regions, patch_motion, quarters, relabelled, three_strips, waves
from shapes import disk_mesh, grid_mesh
from sklearn.base import clone
from sklearn.decomposition import PCA
from sklearn.exceptions import NotFittedError
from sklearn.utils.estimator_checks import parametrize_with_checks

from facelab.geometry.mesh import TriangleMesh
from facelab.models import components as components_module
from facelab.models import region as region_module
from facelab.models.blending import BLEND_REACH
from facelab.models.components import (
    components_of_blocks,
    components_of_sets,
    principal_components,
    row_blocks,
)
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.models.store import load_model
from facelab.posing.session import PosingSession
from facelab.segmentation.regions import Regions
from facelab.storage import load_npz, save_npz

SHARING = ["one-sided", "both", "none"]


def random_regions(mesh, rng, sharing="one-sided", n=4):
    labels = rng.integers(n, size=mesh.n_vertices)
    labels[:n] = range(n)
    return Regions(labels, mesh, sharing)


def fitted(regions, rng, n_components=4, beta=0.5, n_frames=60):
    X = rng.normal(size=(n_frames, 3 * regions.mesh.n_vertices)) + 2.0
    return RegionModel(regions, n_components, beta).fit(X), X


def literal_bases(model):
    """B^i as the paper has it: one mode per column."""
    return [B.T for B in model.components_]


def skewed(model, rng):
    """The model with other, non-orthonormal bases: rotated, stretched, even with other spans."""
    components = [
        rng.normal(size=(len(B), len(B))) @ B + 0.1 * rng.normal(size=B.shape)
        for B in model.components_
    ]
    return RegionModel.from_bases(model.regions, model.mean_, components, model.beta)


# --- principal components -------------------------------------------------------------------------


@pytest.fixture(params=[(60, 12), (10, 45), (20, 20)], ids=["tall", "wide", "square"])
def data(request, rng):
    """Frames with clear gaps between their variances, so that modes are unique."""
    n_frames, n_features = request.param
    rank = min(n_frames, n_features)
    U = np.linalg.qr(rng.normal(size=(n_frames, rank)))[0]
    V = np.linalg.qr(rng.normal(size=(n_features, rank)))[0]
    return U * np.geomspace(100, 1, rank) @ V.T + rng.normal(size=n_features)


# the smaller of two square matrices is decomposed: of a mode whose variance is v of the largest,
# rounding leaves about 1e-16 / v; v is down to 1e-4 here


def test_modes_and_variances_are_those_of_a_singular_value_decomposition(data):
    mean, components, variances = principal_components(data, 6)
    _, s, Vt = np.linalg.svd(data - data.mean(axis=0), full_matrices=False)
    signs = np.sign((components * Vt[:6]).sum(axis=1))
    np.testing.assert_allclose(mean, data.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(components, signs[:, None] * Vt[:6], atol=1e-9)
    np.testing.assert_allclose(variances, s[:6] ** 2 / (len(data) - 1), rtol=1e-9)


def test_modes_and_variances_are_those_of_scikit_learn(data):
    _, components, variances = principal_components(data, 6)
    reference = PCA(6, svd_solver="full").fit(data)
    signs = np.sign((components * reference.components_).sum(axis=1))
    np.testing.assert_allclose(components, signs[:, None] * reference.components_, atol=1e-9)
    np.testing.assert_allclose(variances, reference.explained_variance_, rtol=1e-9)


def test_modes_are_orthonormal_strongest_first_and_point_the_agreed_way(data):
    _, components, variances = principal_components(data, 6)
    np.testing.assert_allclose(components @ components.T, np.eye(6), atol=1e-12)
    assert (np.diff(variances) <= 0).all()
    assert (components[np.arange(6), np.abs(components).argmax(axis=1)] > 0).all()


def test_frames_upside_down_have_the_same_modes(data):
    np.testing.assert_allclose(
        principal_components(-data, 5)[1], principal_components(data, 5)[1], atol=1e-9
    )


@pytest.mark.parametrize("n_features", [12, 90], ids=["tall", "wide"])
@pytest.mark.parametrize("rank", [0, 2])
def test_modes_beyond_the_rank_of_the_data_are_orthonormal_and_weightless(rng, n_features, rank):
    X = rng.normal(size=(30, rank)) @ rng.normal(size=(rank, n_features)) + 5.0
    _, components, variances = principal_components(X, 6)
    np.testing.assert_allclose(components @ components.T, np.eye(6), atol=1e-12)
    assert (variances[rank:] < 1e-9).all()
    assert (variances >= 0).all()


def test_translation_leaves_modes_alone(rng):
    X = rng.normal(size=(40, 18))
    _, components, variances = principal_components(X, 5)
    mean, moved, moved_variances = principal_components(X + np.tile([50.0, -20, 10], 6), 5)
    np.testing.assert_allclose(moved, components, atol=1e-9)
    np.testing.assert_allclose(moved_variances, variances, rtol=1e-9)
    np.testing.assert_allclose(mean - X.mean(axis=0), np.tile([50.0, -20, 10], 6), atol=1e-12)


def test_a_rigid_turn_only_turns_the_modes(rng):
    X = rng.normal(size=(40, 6, 3))
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    _, components, variances = principal_components(X.reshape(40, 18), 5)
    _, turned, turned_variances = principal_components((X @ Q).reshape(40, 18), 5)
    expected = (components.reshape(5, 6, 3) @ Q).reshape(5, 18)
    signs = np.sign((expected * turned).sum(axis=1))
    np.testing.assert_allclose(turned, signs[:, None] * expected, atol=1e-8)
    np.testing.assert_allclose(turned_variances, variances, rtol=1e-9)


# --- one basis: Eq. 2 to 4 ------------------------------------------------------------------------


@pytest.mark.parametrize("cached", [1, 10**6])
def test_sets_of_columns_found_together_have_the_components_of_each(rng, monkeypatch, cached):
    monkeypatch.setattr("facelab.models.components.CACHED", cached)
    X = rng.normal(size=(150, 200)) * np.linspace(1, 3, 200) + 100
    columns = [np.arange(12), np.arange(180, 6, -1), np.array([3, 1, 150])]  # one is wide
    whole = np.arange(200)
    for sets in (columns, columns[:1], [whole], [whole[::-1]]):
        mean, components, variances = components_of_sets(X, sets, 6)
        np.testing.assert_allclose(mean, X.mean(axis=0), rtol=1e-12)
        for c, B, v in zip(sets, components, variances, strict=True):
            _, wanted, theirs = principal_components(X[:, c], min(6, len(c)))
            np.testing.assert_allclose(v, theirs, rtol=1e-9)
            np.testing.assert_allclose(B, wanted, atol=1e-9)


def test_the_whole_face_learns_from_one_copy_of_the_frames(rng):
    X = rng.normal(size=(4000, 60))
    tracemalloc.start()
    try:
        components_of_sets(X, [np.arange(60)], 5)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1.5 * X.nbytes  # less their mean; picked columns would be a second


def test_coefficients_of_the_whole_face_are_equation_4(rng):
    X = rng.normal(size=(30, 18)) + 1.0
    model = HolisticModel(5).fit(X)
    B = model.components_[0].T
    for x, c in zip(X, model.transform(X), strict=True):
        np.testing.assert_allclose(c, literal.eq_4(x - model.mean_, B), atol=1e-10)
        np.testing.assert_allclose(c, np.linalg.lstsq(B, x - model.mean_)[0], atol=1e-10)


def test_a_skewed_basis_of_the_whole_face_still_solves_equation_4(rng):
    X = rng.normal(size=(30, 18)) + 1.0
    model = skewed(HolisticModel(5).fit(X), rng)
    B = model.components_[0].T
    for x, c in zip(X, model.transform(X), strict=True):
        np.testing.assert_allclose(c, literal.eq_4(x - model.mean_, B), atol=1e-9)


def test_frames_drawn_from_three_components_are_rebuilt_by_three_modes(rng):
    modes = np.linalg.qr(rng.normal(size=(12, 3)))[0].T
    X = rng.normal(size=12) + rng.normal(size=(40, 3)) @ modes
    np.testing.assert_allclose(HolisticModel(3).fit(X).reconstruct(X), X, atol=1e-10)


@pytest.mark.parametrize("regional", [False, True])
def test_more_modes_never_make_a_larger_error_on_the_frames_learned(rng, regional):
    mesh, labels = quarters(6, 5)
    X = rng.normal(size=(40, 90))
    errors = []
    for n in (1, 3, 6, 12, 20):
        # without sharing and without beta the error is the sum of what each PCA leaves
        regions = Regions(labels, mesh, "none")
        model = RegionModel(regions, n, beta=0) if regional else HolisticModel(n)
        errors.append(np.sum((model.fit(X).reconstruct(X) - X) ** 2))
    assert (np.diff(errors) < 0).all()


# --- many bases: Eq. 5 to 7 -----------------------------------------------------------------------


@pytest.mark.parametrize("sharing", SHARING)
def test_without_beta_every_region_is_solved_by_itself(rng, bumpy, sharing):
    model, X = fitted(random_regions(bumpy, rng, sharing), rng, beta=0)
    Z = model.transform(X[:3])
    for members, B, s in zip(model.members_, model.components_, model.slices_, strict=True):
        v = (X[:3] - model.mean_).reshape(3, -1, 3)[:, members].reshape(3, -1)
        np.testing.assert_allclose(Z[:, s], v @ B.T, atol=1e-10)


def test_without_beta_no_region_hears_of_the_others(rng):
    regions = three_strips()
    model, X = fitted(regions, rng, beta=0)
    changed = X[:1].copy().reshape(1, -1, 3)
    changed[:, np.setdiff1d(np.arange(regions.mesh.n_vertices), model.members_[0])] += 5.0
    before, after = model.transform(X[:1]), model.transform(changed.reshape(1, -1))
    np.testing.assert_array_equal(after[:, model.slices_[0]], before[:, model.slices_[0]])


def test_with_beta_every_region_hears_of_its_neighbours(rng):
    model, X = fitted(three_strips(), rng, beta=0.5)
    changed = X[:1].copy().reshape(1, -1, 3)
    changed[:, np.setdiff1d(np.arange(45), model.members_[0])] += 5.0
    moved = model.transform(changed.reshape(1, -1)) - model.transform(X[:1])
    assert np.abs(moved[:, model.slices_[0]]).max() > 1e-3


@pytest.mark.parametrize("beta", [0.0, 0.5, 20.0])
@pytest.mark.parametrize("sharing", SHARING)
@pytest.mark.parametrize("orthonormal", [True, False])
def test_coefficients_are_where_the_gradient_of_equation_6_vanishes(
    rng, bumpy, beta, sharing, orthonormal
):
    model, X = fitted(random_regions(bumpy, rng, sharing), rng, beta=beta)
    model = model if orthonormal else skewed(model, rng)
    bases = literal_bases(model)
    for x, zeta in zip(X[:2], model.transform(X[:2]), strict=True):
        v = (x - model.mean_).reshape(-1, 3)
        c = literal.split(zeta, bases)
        # terms of the gradient are of size 10 to 1000
        np.testing.assert_allclose(literal.eq_7(v, model.members_, bases, c, beta), 0, atol=1e-9)
        A, b = literal.eq_6_stacked(v, model.members_, bases, beta)
        np.testing.assert_allclose(zeta, np.linalg.lstsq(A, b)[0], atol=1e-8)


@pytest.mark.parametrize("beta", [0.0, 0.5, 20.0])
def test_no_other_coefficients_have_a_lower_energy(rng, beta):
    model, X = fitted(corner_regions(), rng, beta=beta)
    bases = literal_bases(model)
    v = (X[0] - model.mean_).reshape(-1, 3)
    zeta = model.transform(X[:1])[0]
    best = literal.eq_6(v, model.members_, bases, literal.split(zeta, bases), beta)
    for size in (1e-3, 0.1, 10):
        for _ in range(10):
            other = literal.split(zeta + size * rng.normal(size=zeta.shape), bases)
            assert literal.eq_6(v, model.members_, bases, other, beta) > best


def test_the_gradient_of_equation_6_is_that_of_its_energy(rng):
    # the index in the last term of Eq. 7 as we read it, against finite differences
    model, X = fitted(corner_regions(), rng, n_components=2)
    bases = literal_bases(model)
    v = (X[0] - model.mean_).reshape(-1, 3)
    zeta = rng.normal(size=model.n_coefficients)

    def energy(zeta):
        return literal.eq_6(v, model.members_, bases, literal.split(zeta, bases), 0.5)

    slope = [(energy(zeta + 1e-4 * e) - energy(zeta - 1e-4 * e)) / 2e-4 for e in np.eye(len(zeta))]
    expected = 2 * literal.eq_7(v, model.members_, bases, literal.split(zeta, bases), 0.5)
    # central differences of a quadratic are exact; energies near 1e3 leave 1e-12 / 1e-4
    np.testing.assert_allclose(slope, expected, atol=1e-6)


@pytest.mark.parametrize("sharing", SHARING)
@pytest.mark.parametrize("orthonormal", [True, False])
def test_the_boundary_matrix_is_the_double_sum(rng, bumpy, sharing, orthonormal):
    model, _ = fitted(random_regions(bumpy, rng, sharing), rng)
    model = model if orthonormal else skewed(model, rng)
    bases = literal_bases(model)
    for _ in range(3):
        zeta = rng.normal(size=model.n_coefficients)
        expected = literal.boundary_term(model.members_, bases, literal.split(zeta, bases))
        assert zeta @ model.boundary_ @ zeta == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_the_boundary_matrix_is_symmetric_and_never_negative(rng):
    model, _ = fitted(corner_regions("both"), rng)
    np.testing.assert_array_equal(model.boundary_, model.boundary_.T)
    assert np.linalg.eigvalsh(model.boundary_).min() > -1e-12


def test_the_gap_shrinks_as_beta_grows(rng):
    model, X = fitted(corner_regions(), rng)
    gaps = [
        model.set_params(beta=b).boundary_gap(model.transform(X[:5])) for b in (0, 0.1, 1, 10, 1e3)
    ]
    assert (np.diff(gaps, axis=0) < 0).all()


def test_the_gap_is_the_root_mean_square_over_pairs_of_copies(rng):
    model, X = fitted(corner_regions("both"), rng)
    bases = literal_bases(model)
    zeta = model.transform(X[:1])[0]
    c = literal.split(zeta, bases)
    squares = literal.boundary_term(model.members_, bases, c)
    pairs = sum(
        len(np.intersect1d(a, b))
        for i, a in enumerate(model.members_)
        for b in model.members_[i + 1 :]
    )
    assert model.boundary_gap(zeta)[0] == pytest.approx(np.sqrt(squares / pairs), rel=1e-9)


def test_regions_that_share_nothing_have_no_gap(rng):
    model, X = fitted(corner_regions("none"), rng)
    assert (model.boundary_gap(model.transform(X[:2])) == 0).all()


# --- from coefficients to a face ------------------------------------------------------------------


@pytest.mark.parametrize("beta", [0.0, 0.5, 50.0])
def test_frames_in_the_span_of_every_region_are_rebuilt_exactly(rng, beta):
    regions = corner_regions()
    X = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3 * regions.mesh.n_vertices)) + 1.5
    model = RegionModel(regions, 3, beta).fit(X)
    # copies of shared vertices agree, so that beta has nothing to say
    np.testing.assert_allclose(model.reconstruct(X), X, atol=1e-9)
    assert model.boundary_gap(model.transform(X)).max() < 1e-6  # root of a square near 1e-13


def test_shared_vertices_are_the_mean_of_their_regions(rng):
    model, _ = fitted(corner_regions("both"), rng)
    assert model.holders_.max() > 2, "the example should have vertices of three regions"
    zeta = rng.normal(size=model.n_coefficients)
    bases = literal_bases(model)
    v = literal.blend(model.members_, bases, literal.split(zeta, bases), 42)
    np.testing.assert_allclose(
        model.inverse_transform(zeta)[0], model.mean_ + v.ravel(), atol=1e-12
    )


def test_one_region_is_the_holistic_model(rng, bumpy):
    X = rng.normal(size=(50, 3 * bumpy.n_vertices))
    whole = HolisticModel(7).fit(X)
    one = RegionModel(Regions(np.zeros(bumpy.n_vertices, dtype=int), bumpy), 7).fit(X)
    alone = RegionModel(n_components=7).fit(X)
    for other in (one, alone):
        np.testing.assert_allclose(other.transform(X), whole.transform(X), atol=1e-10)
        np.testing.assert_allclose(other.reconstruct(X), whole.reconstruct(X), atol=1e-10)


def test_regions_in_another_order_rebuild_the_same_face(rng, bumpy):
    regions = random_regions(bumpy, rng, "both")
    order = np.array([2, 0, 3, 1])
    model, X = fitted(regions, rng)
    other = RegionModel(Regions(order[regions.labels], bumpy, "both"), 4).fit(X)
    np.testing.assert_allclose(other.reconstruct(X), model.reconstruct(X), atol=1e-9)


def test_vertices_in_another_order_rebuild_the_same_face(rng, bumpy):
    regions = random_regions(bumpy, rng)
    order = rng.permutation(bumpy.n_vertices)
    model, X = fitted(regions, rng)
    renamed = Regions(regions.labels[order], relabelled(bumpy, order))
    Y = X.reshape(len(X), -1, 3)[:, order].reshape(len(X), -1)
    rebuilt = RegionModel(renamed, 4).fit(Y).reconstruct(Y).reshape(len(X), -1, 3)
    np.testing.assert_allclose(
        rebuilt, model.reconstruct(X).reshape(len(X), -1, 3)[:, order], atol=1e-9
    )


def test_a_face_that_is_moved_as_a_whole_is_rebuilt_moved(rng):
    regions = corner_regions()
    model, X = fitted(regions, rng)
    shift = np.tile([3.0, -8.0, 5.0], regions.mesh.n_vertices)
    moved = RegionModel(regions, 4).fit(X + shift)
    np.testing.assert_allclose(
        moved.reconstruct(X + shift), model.reconstruct(X) + shift, atol=1e-9
    )


def test_regions_beat_the_holistic_model_on_patches_that_move_by_themselves(rng):
    mesh, labels = quarters(8, 6)
    X = waves(mesh, labels, rng, n_frames=200)
    model = RegionModel(Regions(labels, mesh, "none"), 3).fit(X[:100])
    whole = HolisticModel(3).fit(X[:100])
    ours, theirs = (np.linalg.norm(m.reconstruct(X[100:]) - X[100:]) for m in (model, whole))
    assert ours < 1e-6  # three modes move each patch, exactly
    assert theirs > 1


# --- as an estimator ------------------------------------------------------------------------------


def test_a_region_with_fewer_coordinates_than_modes_gets_as_many_as_it_can_hold(rng, grid):
    labels = np.zeros(30, dtype=int)
    labels[0] = 1
    model, X = fitted(Regions(labels, grid, "none"), rng, n_components=20)
    assert model.n_components_.tolist() == [20, 3]
    assert model.n_coefficients == 23
    assert [B.shape for B in model.components_] == [(20, 87), (3, 3)]
    np.testing.assert_allclose(model.reconstruct(X)[:, :3], X[:, :3], atol=1e-9)


def test_settings_are_kept_as_they_were_given_and_cloned(rng):
    regions = three_strips()
    model = RegionModel(regions, n_components=3, beta=0.1)
    assert model.get_params() == {
        "regions": regions,
        "n_components": 3,
        "beta": 0.1,
        "spread": "each",
        "blending": "mean",
        "random_state": 0,
    }
    model.fit(rng.normal(size=(10, 135)))
    copy = clone(model, safe=False)
    assert copy.n_components == 3
    assert not hasattr(copy, "mean_")
    assert model.regions is regions
    assert HolisticModel(4).get_params() == {"n_components": 4, "random_state": 0}
    assert clone(HolisticModel(4)).n_components == 4


def test_nothing_is_checked_before_there_is_data():
    RegionModel(n_components=-5, beta="much")


def test_fitting_returns_the_model_and_leaves_the_data_alone(rng):
    X = rng.normal(size=(20, 135))
    before = X.copy()
    model = RegionModel(three_strips(), 3)
    assert model.fit(X) is model
    model.reconstruct(X)
    np.testing.assert_array_equal(X, before)


def test_the_same_data_give_the_same_model_to_the_bit(rng):
    X = rng.normal(size=(20, 135))
    one, two = (RegionModel(three_strips(), 3).fit(X) for _ in range(2))
    assert all(map(np.array_equal, one.components_, two.components_))


def test_a_model_fitted_again_knows_only_the_new_data(rng):
    model, X = fitted(three_strips(), rng)
    model.transform(X)
    Y = rng.normal(size=X.shape)
    anew = RegionModel(three_strips(), 4).fit(Y)
    np.testing.assert_array_equal(model.fit(Y).reconstruct(Y), anew.reconstruct(Y))


def test_numbers_of_single_precision_give_the_same_model_to_single_precision(rng):
    mesh, labels = quarters(8, 6)
    X = waves(mesh, labels, rng, n_frames=200)
    double = RegionModel(Regions(labels, mesh), 3).fit(X)
    single = RegionModel(Regions(labels, mesh), 3).fit(X.astype(np.float32))
    # displacements of up to 20 mm in single precision: 2e-6 each, more where squares are summed
    np.testing.assert_allclose(single.reconstruct(X), double.reconstruct(X), atol=1e-3)


@pytest.mark.parametrize(
    "action", ["transform", "inverse_transform", "reconstruct", "boundary_gap"]
)
def test_a_model_that_has_learned_nothing_says_so(action):
    with pytest.raises(NotFittedError):
        getattr(RegionModel(), action)(np.zeros((2, 9)))


@pytest.mark.parametrize(
    ("settings", "frames", "error", "message"),
    [
        ({}, np.full((10, 135), np.nan), ValueError, "NaN"),
        ({"n_components": 10}, np.zeros((10, 135)), ValueError, "10 frames .* allow 1 to 9"),
        ({"n_components": 0}, np.zeros((10, 135)), ValueError, "n_components=0"),
        ({"n_components": 2.0}, np.zeros((10, 135)), TypeError, "n_components=2.0"),
        (
            {"n_components": 2.5},
            np.zeros((10, 135)),
            TypeError,
            "n_components=2.5 is not an integer",
        ),
        ({"n_components": 1.0}, np.zeros((10, 135)), TypeError, "share of the variance"),
        ({"n_components": -0.5}, np.zeros((10, 135)), TypeError, "n_components=-0.5"),
        ({"n_components": "all"}, np.zeros((10, 135)), TypeError, "n_components='all'"),
        ({"n_components": True}, np.zeros((10, 135)), TypeError, "n_components=True"),
        ({"n_components": 28, "spread": "total"}, np.zeros((10, 135)), ValueError, "allow 1 to 27"),
        ({"spread": "wide"}, np.zeros((10, 135)), ValueError, "spread='wide'"),
        ({"blending": "soft"}, np.zeros((10, 135)), ValueError, "blending='soft'"),
        ({"beta": -1}, np.zeros((10, 135)), ValueError, "beta=-1"),
        ({"beta": "much"}, np.zeros((10, 135)), TypeError, "beta='much'"),
        ({}, np.zeros((10, 132)), ValueError, "132 columns.* 45 vertices and ask for 135"),
        ({}, np.zeros((1, 135)), ValueError, "minimum of 2 is required"),
        ({}, np.zeros(135), ValueError, "2D array"),
        ({"regions": np.zeros(45, dtype=int)}, np.zeros((10, 135)), TypeError, "regions"),
    ],
)
def test_fitting_refuses_what_it_cannot_learn_from(settings, frames, error, message):
    model = RegionModel(**{"regions": three_strips(), "n_components": 2, **settings})
    with pytest.raises(error, match=message):
        model.fit(frames)


def test_frames_of_another_face_are_refused(rng):
    model, X = fitted(three_strips(), rng)
    with pytest.raises(ValueError, match="features"):
        model.transform(X[:, :-3])
    with pytest.raises(ValueError, match="Z has 5 columns, but the model has 12"):
        model.inverse_transform(np.zeros((1, 5)))
    with pytest.raises(ValueError, match="NaN"):
        model.transform(np.full_like(X, np.nan))


# regions lie on a mesh and ask for its number of columns; these checks come with numbers of their
# own, so that the whole face as one region stands in
@parametrize_with_checks(
    [
        HolisticModel(),
        HolisticModel(1),
        HolisticModel(0.9),
        RegionModel(),
        RegionModel(n_components=1),
        RegionModel(n_components=1, spread="total", blending="gradient"),
    ]
)
def test_models_keep_the_contract_of_scikit_learn(estimator, check):
    check(estimator)


def test_a_model_survives_a_copy_of_any_kind(rng):
    model, X = fitted(corner_regions(), rng)
    model.set_params(blending="gradient")
    model.reconstruct(X)  # factors are at hand, and are left behind
    twin = pickle.loads(pickle.dumps(model))
    np.testing.assert_allclose(twin.reconstruct(X), model.reconstruct(X), atol=1e-12)


def test_a_still_vertex_makes_no_nan(rng):
    regions = corner_regions()
    X = rng.normal(size=(40, 3 * regions.mesh.n_vertices))
    X[:, :9] = 0.0
    X[:, 9:12] = 7.5  # constant, not zero
    for model in (RegionModel(regions, 4), RegionModel(regions, 0.9), HolisticModel(4)):
        for blending in ("mean", "gradient"):
            model.blending = blending
            rebuilt = model.fit(X).reconstruct(X)
            assert np.isfinite(rebuilt).all()


@pytest.mark.parametrize("blocks", [False, True])
def test_there_are_no_modes_beyond_the_rank_of_the_motion(rng, blocks):
    regions = corner_regions()
    X = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3 * regions.mesh.n_vertices))
    still = regions.labels == 2
    X.reshape(40, -1, 3)[:, still] = 0.0

    def fitted(model, X):
        return model.fit_blocks([X[:10], X[:0], X[10:]], progress=False) if blocks else model.fit(X)

    for n in (10, 0.9999999, None):
        model = fitted(RegionModel(regions, n), X)
        assert model.n_components_.max() == 3  # and not as many as were asked for
        np.testing.assert_allclose(model.reconstruct(X), X, atol=1e-6)
    assert fitted(HolisticModel(10), X).n_coefficients == 3
    # a pin in a region that held still moves nothing: no direction of rounding's choice follows it
    session = PosingSession(model, regions.mesh)
    inside = set(regions.members[2].tolist())
    inner = [v for v in inside if sum(v in m for m in regions.members) == 1]
    for v in inner:
        session.pull(v, regions.mesh.vertices[v] + [0, 0, 5])
    assert np.abs(session.vertices - regions.mesh.vertices).max() < 1e-6
    with pytest.raises(ValueError, match="X holds still"):
        fitted(RegionModel(regions, 2), np.repeat(X[:1], 40, axis=0))


def test_positions_are_not_taken_for_displacements(rng):
    mesh, labels = quarters(6, 5)
    motion = patch_motion(mesh, labels, rng)
    regions = Regions(labels, mesh)
    X = motion.positions.reshape(motion.n_frames, -1)
    for model in (RegionModel(regions, 3), GlobalLocalModel(regions, 3)):
        with pytest.raises(ValueError, match=r"X holds positions.*motion.displacements\(\)"):
            model.fit(X)
        model.fit(motion.displacements())


def test_a_sequence_is_refused_with_what_to_pass(rng):
    mesh, labels = quarters(6, 5)
    motion = patch_motion(mesh, labels, rng)
    with pytest.raises(TypeError, match=r"MotionSequence.*fit\(motion.displacements\(\)\)"):
        HolisticModel(3).fit(motion)


def test_regions_that_share_nothing_are_refused_unless_that_is_said(rng):
    two = grid_mesh(3, 3)
    V = np.vstack([two.vertices, two.vertices + [50, 0, 0]])
    mesh = TriangleMesh(V, np.vstack([two.faces, two.faces + 9]))
    labels = np.repeat([0, 1], 9)
    X = rng.normal(size=(12, 54))
    with pytest.raises(ValueError, match=r"region\(s\) 0, 1 share no vertex.*2 piece\(s\)"):
        RegionModel(Regions(labels, mesh), 2).fit(X)
    RegionModel(Regions(labels, mesh, "none"), 2).fit(X)


# --- how many modes -------------------------------------------------------------------------------


def uneven(rng, n_frames=300):
    """Motion of the three strips: the first moves most and in many ways, the last hardly."""
    regions = three_strips()
    size = np.array([9.0, 3.0, 0.1])[regions.labels].repeat(3)
    return regions, size * rng.normal(size=(n_frames, 135)) + 1.0


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
def test_a_share_of_the_variance_is_held_by_as_few_modes_as_can(rng, share):
    regions, X = uneven(rng)
    model = RegionModel(regions, share, beta=0).fit(X)
    for members, kept in zip(model.members_, model.n_components_, strict=True):
        part = X.reshape(len(X), -1, 3)[:, members].reshape(len(X), -1)
        held = np.cumsum(np.linalg.svd(part - part.mean(axis=0))[1] ** 2)
        assert held[kept - 1] >= share * held[-1]
        assert kept == 1 or held[kept - 2] < share * held[-1]


def test_a_total_goes_to_the_largest_variances_wherever_they_are(rng):
    regions, X = uneven(rng)
    rich = RegionModel(regions, 40).fit(X)
    model = RegionModel(regions, 30, spread="total").fit(X)
    assert model.n_coefficients == 30
    assert model.n_components_[0] > model.n_components_[1] > model.n_components_[2] == 0
    weakest = min(v.min() for v in model.variances_ if len(v))
    left = [v[n:] for v, n in zip(rich.variances_, model.n_components_, strict=True)]
    assert weakest >= max(v.max() for v in left if len(v))


def test_no_other_split_of_a_total_leaves_less(rng):
    regions = Regions(three_strips().labels, three_strips().mesh, "none")
    X = uneven(rng)[1]
    rich = RegionModel(regions, 30, beta=0).fit(X)
    best = rich.truncated(10, "total")

    def left(counts):
        parts = zip(rich.variances_, counts, strict=True)
        return sum(v.sum() - v[:n].sum() for v, n in parts)

    splits = [(a, b, 10 - a - b) for a in range(11) for b in range(11 - a)]
    assert left(best.n_components_) == min(map(left, splits))


def test_a_share_of_all_regions_together_needs_fewer_modes_than_of_each(rng):
    regions, X = uneven(rng)
    each = RegionModel(regions, 0.9).fit(X)
    total = RegionModel(regions, 0.9, spread="total").fit(X)
    held = sum(v.sum() for v in total.variances_)
    everything = sum(v.sum() for v in RegionModel(regions, 130).fit(X).variances_)
    assert held >= 0.9 * everything
    assert total.n_coefficients < each.n_coefficients


def test_a_region_without_modes_stays_at_its_mean_and_breaks_nothing(rng):
    regions, X = uneven(rng)
    model = RegionModel(regions, 3, spread="total").fit(X)
    assert model.n_components_.tolist() == [3, 0, 0]
    rebuilt = model.reconstruct(X)
    alone = np.setdiff1d(model.columns_[2], model.columns_[1])
    np.testing.assert_allclose(rebuilt[:, alone], np.tile(X.mean(axis=0)[alone], (len(X), 1)))


@pytest.mark.parametrize("spread", ["each", "total"])
def test_a_model_cut_short_is_the_model_trained_with_fewer_modes(rng, spread):
    regions, X = uneven(rng)
    rich = RegionModel(regions, 40, blending="gradient").fit(X)
    short = rich.truncated(12, spread)
    trained = RegionModel(regions, 12, spread=spread, blending="gradient").fit(X)
    np.testing.assert_array_equal(short.n_components_, trained.n_components_)
    np.testing.assert_allclose(short.reconstruct(X), trained.reconstruct(X), atol=1e-9)
    assert rich.n_coefficients == 120, "the rich model must stay what it was"


def test_the_holistic_model_is_cut_short_too(rng):
    X = rng.normal(size=(60, 30))
    short = HolisticModel(20).fit(X).truncated(5)
    assert isinstance(short, HolisticModel)
    np.testing.assert_allclose(
        short.reconstruct(X), HolisticModel(5).fit(X).reconstruct(X), atol=1e-10
    )


# --- any basis: Eq. 4 -----------------------------------------------------------------------------


def varimax(B, rounds=200):
    """Rows turned so that each moves few coordinates (Kaiser 1958)."""
    R = np.eye(len(B))
    for _ in range(rounds):
        L = B.T @ R
        U, _, Vt = np.linalg.svd(B @ (L**3 - L * (L**2).mean(axis=0)))
        R = U @ Vt
    return R.T @ B


def test_turned_modes_describe_the_same_faces_and_move_fewer_coordinates(rng):
    model, X = fitted(corner_regions(), rng, n_frames=100)
    turned = [varimax(B) for B in model.components_]
    other = RegionModel.from_bases(model.regions, model.mean_, turned)
    np.testing.assert_allclose(other.reconstruct(X), model.reconstruct(X), atol=1e-9)
    for B, T in zip(model.components_, turned, strict=True):
        assert (T**4).sum() > (B**4).sum()


def test_blendshapes_cut_into_regions_rebuild_what_they_make(rng):
    regions = corner_regions()
    n = regions.mesh.n_vertices
    bump = np.exp(-np.linalg.norm(regions.mesh.vertices[:, None] - regions.mesh.vertices, axis=2))
    shapes = np.array([np.outer(bump[v], rng.normal(size=3)) for v in (3, 10, 30, 38)])
    shapes[np.abs(shapes) < 1e-3] = 0
    model = RegionModel.from_bases(regions, np.zeros(n * 3), shapes)
    for members, units in zip(model.members_, model.units_, strict=True):
        moves = [k for k in range(4) if np.abs(shapes[k][members]).max() > 0]
        assert units.tolist() == moves
    assert model.n_coefficients < 16, "some shapes should leave some regions alone"
    X = rng.uniform(size=(5, 4)) @ shapes.reshape(4, -1)
    np.testing.assert_allclose(model.reconstruct(X), X, atol=1e-9)


def test_rows_that_depend_on_one_another_get_the_smallest_coefficients(rng):
    B = rng.normal(size=(2, 18))
    X = rng.normal(size=(4, 18))
    model = RegionModel.from_bases(None, np.zeros(18), [np.vstack([B, B[0] + B[1], 2 * B[0]])])
    expected = np.linalg.lstsq(model.components_[0].T, X.T)[0].T
    np.testing.assert_allclose(model.transform(X), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("mean", "bases", "message"),
    [
        (np.zeros(135), [np.ones((2, 3))] * 2, "2 entries for 3 regions"),
        (np.zeros(135), [np.ones((2, 7))] * 3, r"bases\[0\] has shape \(2, 7\)"),
        (np.zeros(135), np.ones((2, 134)), "bases has shape"),
        (np.zeros(135), np.zeros((2, 135)), "all zero"),
        (np.zeros(135), np.full((2, 135), np.nan), "bases holds 270"),
        (np.zeros(132), np.ones((2, 132)), "ask for 135"),
        (np.full(135, np.inf), np.ones((2, 135)), "mean holds"),
    ],
)
def test_bases_that_do_not_fit_the_regions_are_refused(mean, bases, message):
    with pytest.raises(ValueError, match=message):
        RegionModel.from_bases(three_strips(), mean, bases)


def test_modes_without_variances_are_not_cut_short(rng):
    model = RegionModel.from_bases(None, np.zeros(9), [rng.normal(size=(2, 9))])
    with pytest.raises(ValueError, match="without variances"):
        model.truncated(1)


# --- one surface: mean and gradient ---------------------------------------------------------------


def two_halves(columns=21, rows=7, spacing=5.0, step=1.0):
    """Two regions on a strip, the right one lifted: the simplest gap there is."""
    mesh = grid_mesh(columns, rows, spacing)
    right = (np.arange(mesh.n_vertices) % columns) > columns // 2
    regions = Regions(right.astype(int), mesh, "both")
    lift = [np.tile([0, 0, z], len(m)) for z, m in zip((0.0, step), regions.members, strict=True)]
    lift[0][2::3] = 1e-9
    model = RegionModel.from_bases(regions, np.zeros(3 * mesh.n_vertices), [r[None] for r in lift])
    return model, mesh


def along(model, mesh):
    """Height of the middle row, copies at their full lift."""
    z = model.blend(np.ones((1, model.n_coefficients))).reshape(-1, 3)[:, 2]
    middle = mesh.vertices[:, 1] == np.median(mesh.vertices[:, 1])
    return z[middle]


def test_the_gradient_blend_spreads_a_step_that_the_mean_leaves():
    model, mesh = two_halves()
    step = np.diff(along(model, mesh))
    spread = np.diff(along(model.set_params(blending="gradient"), mesh))
    assert step.max() == pytest.approx(0.5)  # two steps, beside the band that both hold
    assert (spread > 0).all()  # a ramp, without overshoot
    assert spread.max() < 0.25 * step.max()
    # far away each side is what its region wants: what is left of the half step falls to 1/e
    # with every reach
    far = np.abs(mesh.vertices[:21, 0] - 50) >= 45
    z = along(model, mesh)[far]
    np.testing.assert_allclose(z, np.round(z), atol=0.5 * np.exp(-40 / BLEND_REACH) * 1.5)


def test_the_ramp_is_as_wide_in_millimetres_on_a_finer_mesh():
    coarse, fine = two_halves(21, 7, 5.0), two_halves(41, 13, 2.5)
    for model, _ in (coarse, fine):
        model.set_params(blending="gradient")
    z, z_fine = along(*coarse), along(*fine)[::2]
    # the shared band, one edge to each side, is wider on the coarse mesh by 5 mm of 20
    np.testing.assert_allclose(z_fine, z, atol=0.06)


@pytest.mark.parametrize("sharing", SHARING)
def test_both_blends_are_the_same_where_regions_agree(rng, bumpy, sharing):
    regions = random_regions(bumpy, rng, sharing)
    shapes = rng.normal(size=(5, 3 * bumpy.n_vertices))
    bases = [shapes[:, (3 * m[:, None] + np.arange(3)).ravel()] for m in regions.members]
    model = RegionModel.from_bases(regions, np.zeros(126), bases)
    Z = np.tile(rng.normal(size=(3, 5)), len(bases))  # the same coefficients everywhere: no gap
    mean = model.blend(Z)
    np.testing.assert_allclose(mean, Z[:, :5] @ shapes, atol=1e-12)
    np.testing.assert_allclose(model.set_params(blending="gradient").blend(Z), mean, atol=1e-9)


def test_the_gradient_blend_minimises_its_energy(rng):
    model, _ = fitted(corner_regions(), rng)
    mesh = model.regions.mesh
    zeta = rng.normal(size=model.n_coefficients)
    copies = [
        (B.T @ c).reshape(-1, 3)
        for B, c in zip(model.components_, literal.split(zeta, literal_bases(model)), strict=True)
    ]
    mean = model.blend(zeta[None])[0].reshape(-1, 3)
    L = mesh.laplacian("cotangent", normalised=False)

    def energy(u):
        """The sums of the docstring, edge by edge."""
        E = np.sum(mesh.vertex_areas[:, None] / BLEND_REACH**2 * (u - mean) ** 2)
        for a, b in mesh.edges:
            wants = [
                x[np.searchsorted(m, a)] - x[np.searchsorted(m, b)]
                for x, m in zip(copies, model.members_, strict=True)
                if a in m and b in m
            ]
            g = np.mean(wants, axis=0) if wants else mean[a] - mean[b]
            E += max(-L[a, b], 0) * np.sum((u[a] - u[b] - g) ** 2)
        return E

    u = model.set_params(blending="gradient").blend(zeta[None])[0].reshape(-1, 3)
    assert np.abs(u - mean).max() > 0.01
    for size in (1e-3, 1.0):
        for _ in range(5):
            assert energy(u + size * rng.normal(size=u.shape)) > energy(u)


def test_the_gradient_blend_moves_no_volume(rng):
    model, _ = fitted(corner_regions(), rng)
    area = np.repeat(model.regions.mesh.vertex_areas, 3)
    Z = rng.normal(size=(4, model.n_coefficients))
    before = model.blend(Z) * area
    after = model.set_params(blending="gradient").blend(Z) * area
    np.testing.assert_allclose(
        after.reshape(4, -1, 3).sum(axis=1), before.reshape(4, -1, 3).sum(axis=1), atol=1e-8
    )


@pytest.mark.parametrize("blending", ["mean", "gradient"])
def test_the_blend_is_linear_and_its_rows_are_the_same_map(rng, blending):
    model, _ = fitted(corner_regions("both"), rng)
    model.set_params(blending=blending)
    Z = rng.normal(size=(6, model.n_coefficients))
    X = model.blend(Z)
    np.testing.assert_allclose(model.blend(2 * Z[:1] - Z[1:2]), 2 * X[:1] - X[1:2], atol=1e-10)
    for vertex in (0, 17, 24):
        rows = model.vertex_rows(vertex)
        np.testing.assert_allclose(
            Z @ rows.T, X.reshape(6, -1, 3)[:, vertex], atol=1e-10, err_msg=str(vertex)
        )


def test_a_face_is_posed_with_the_gradient_blend_as_it_is_seen(rng):
    regions = corner_regions()
    model = RegionModel(regions, 4, blending="gradient")
    model.fit(bumps(regions.mesh, regions.labels, rng))
    session = PosingSession(model, regions.mesh)
    start = regions.mesh.vertices
    for vertex in (24, 8):  # beside a boundary, and within a region
        before = session.vertices
        session.press(vertex)
        np.testing.assert_allclose(session.vertices, before, atol=1e-12)
        session.drag(vertex, before[vertex] + [1.0, 2.0, 0.0])
        dragged = session.vertices
        session.release()
        np.testing.assert_allclose(session.vertices, dragged, atol=1e-9)
    session.hold(25)  # a pin where the vertex is seen changes nothing
    np.testing.assert_allclose(session.vertices, dragged, atol=1e-9)
    assert np.abs(dragged - start).max() > 0.5
    session.reset()
    np.testing.assert_allclose(session.vertices, start, atol=1e-12)


def test_a_whole_face_has_nothing_to_blend(rng):
    X = rng.normal(size=(30, 27))
    one = RegionModel(None, 4).fit(X)
    rebuilt = one.reconstruct(X)
    np.testing.assert_array_equal(one.set_params(blending="gradient").reconstruct(X), rebuilt)


def test_the_gradient_blend_bears_obtuse_triangles_and_lone_vertices(rng):
    flat = disk_mesh(3, 8)
    V = np.vstack([flat.vertices * [1, 0.1, 1], [[9, 9, 9]]])  # slivers, and a vertex without faces
    mesh = TriangleMesh(V, flat.faces)
    regions = Regions((V[:, 0] > 0).astype(int), mesh)
    X = rng.normal(size=(30, 3 * len(V)))
    model = RegionModel(regions, 4, blending="gradient").fit(X)
    assert np.isfinite(model.reconstruct(X)).all()


# --- frames in blocks -----------------------------------------------------------------------------


def in_blocks(X, size=17):
    return [X[i : i + size] for i in range(0, len(X), size)]


@pytest.mark.parametrize("kind", [list, "function", "memmap", "float32"])
def test_frames_in_blocks_give_the_model_of_all_at_once(rng, tmp_path, kind, monkeypatch):
    monkeypatch.setattr(components_module, "BLOCK_BYTES", 135 * 8 * 20)
    regions, X = uneven(rng)
    X = X + 300.0  # far from zero, where careless sums lose digits
    settings = dict(n_components=6, spread="total")
    model = RegionModel(regions, **settings)
    if kind is list:
        model.fit_blocks(in_blocks(X), progress=False)
    elif kind == "function":
        model.fit_blocks(lambda: (b for b in in_blocks(X)), progress=False)
    else:
        dtype = np.float32 if kind == "float32" else np.float64
        stored = np.memmap(tmp_path / "frames", dtype, "w+", shape=X.shape)
        stored[:] = X
        model.fit(stored)
    whole = RegionModel(regions, **settings).fit(X.astype(np.float32) if kind == "float32" else X)
    assert model.n_components_.tolist() == whole.n_components_.tolist()
    # one-pass sums against sums about the mean: rounding of a shift of 300 mm, in float32 2e-5
    atol = 1e-3 if kind == "float32" else 1e-9
    np.testing.assert_allclose(model.mean_, whole.mean_, atol=atol)
    np.testing.assert_allclose(model.reconstruct(X), whole.reconstruct(X), atol=10 * atol)


def test_a_share_of_the_variance_is_found_in_blocks_too(rng):
    regions, X = uneven(rng)
    model = RegionModel(regions, 0.9).fit_blocks(in_blocks(X), progress=False)
    assert model.n_components_.tolist() == RegionModel(regions, 0.9).fit(X).n_components_.tolist()


def test_one_pass_is_enough_for_narrow_regions_so_a_generator_will_do(rng):
    X = rng.normal(size=(60, 30))
    model = HolisticModel(4).fit_blocks((b for b in in_blocks(X)), progress=False)
    np.testing.assert_allclose(
        model.components_[0], HolisticModel(4).fit(X).components_[0], atol=1e-9
    )


def wide_frames(rng, n_frames=200, n_features=240, noise=0.01):
    """Ten strong modes and faint noise; wider than what the tests call wide."""
    strong = rng.normal(size=(n_frames, 10)) * np.geomspace(10, 1, 10)
    modes = np.linalg.qr(rng.normal(size=(n_features, 10)))[0].T
    return strong @ modes + noise * rng.normal(size=(n_frames, n_features)) + 5.0


@pytest.mark.parametrize(("passes", "tolerance"), [(2, 1e-3), (3, 1e-7), (4, 1e-11)])
def test_wide_regions_get_their_modes_from_few_passes(rng, monkeypatch, passes, tolerance):
    # each pass multiplies what is missing by the ratio of noise to modes in variance
    monkeypatch.setattr(components_module, "LARGEST_EXACT", 100)
    X = wide_frames(rng)
    n, mean, (B,), (v,) = components_of_blocks(
        lambda: in_blocks(X), lambda n: [np.arange(n)], 10, passes=passes, progress=False
    )
    exact = principal_components(X, 10)
    assert n == 200
    np.testing.assert_allclose(mean, exact[0], atol=1e-12)
    np.testing.assert_allclose(B @ B.T, np.eye(10), atol=1e-12)
    np.testing.assert_allclose(v, exact[2], rtol=tolerance)
    cosines = np.linalg.svd(B @ exact[1].T)[1]
    assert 1 - cosines.min() < tolerance


def test_a_wide_model_is_the_same_at_every_run_and_follows_its_seed(rng, monkeypatch):
    monkeypatch.setattr(components_module, "LARGEST_EXACT", 100)
    X = wide_frames(rng, noise=0.3)
    one, two, other = (
        HolisticModel(12, seed).fit_blocks(in_blocks(X), progress=False) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one.components_[0], two.components_[0])
    assert not np.array_equal(one.components_[0], other.components_[0])


def test_a_wide_array_in_memory_is_found_by_passes_too(rng, monkeypatch):
    exact = HolisticModel(8).fit(X := wide_frames(rng))
    for module in (components_module, region_module):
        monkeypatch.setattr(module, "LARGEST_EXACT", 100)
    passed = HolisticModel(8).fit(X)
    assert not np.array_equal(passed.components_[0], exact.components_[0]), "another road"
    np.testing.assert_allclose(passed.reconstruct(X), exact.reconstruct(X), atol=1e-8)


def test_a_private_copy_of_a_mapped_file_keeps_its_changes(rng, tmp_path):
    np.memmap(tmp_path / "frames", float, "w+", shape=(50, 12))[:] = rng.normal(size=(50, 12))
    private = np.memmap(tmp_path / "frames", float, "c", shape=(50, 12))
    private[:, 0] = 9.0
    HolisticModel(2).fit(private)
    assert (private[:, 0] == 9.0).all()
    assert sum(len(b) for b in row_blocks(private[::2])) == 25


def test_training_that_is_stopped_leaves_the_model_as_it_was(rng):
    X = rng.normal(size=(60, 30))
    model = HolisticModel(4).fit(X)
    before = model.components_[0].copy()

    def stopped():
        yield 5 * X[:20]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        model.fit_blocks(stopped, progress=False)
    np.testing.assert_array_equal(model.components_[0], before)
    assert model.reconstruct(X).shape == X.shape


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([], "0 frames"),
        ([np.zeros((1, 30))], "1 frames"),
        ([np.zeros((5, 30)), np.zeros((5, 33))], r"needs shape \(n_frames, 30\)"),
        ([np.zeros((5, 30)), np.full((5, 30), np.nan)], "NaN"),
        ([np.zeros((3, 30))], "3 frames .* allow 1 to 2"),
        ([np.zeros(30)], "shape"),
    ],
)
def test_blocks_that_teach_nothing_are_refused(blocks, message):
    with pytest.raises(ValueError, match=message):
        HolisticModel(4).fit_blocks(blocks, progress=False)


def test_wide_regions_ask_for_blocks_that_come_again_and_a_number_of_modes(rng, monkeypatch):
    for module in (components_module, region_module):
        monkeypatch.setattr(module, "LARGEST_EXACT", 100)
    X = wide_frames(rng)
    with pytest.raises(ValueError, match="200 and then 0 frames"):
        HolisticModel(4).fit_blocks(iter(in_blocks(X)), progress=False)
    with pytest.raises(ValueError, match=r"n_components=0.9 is a share.*240 coordinates"):
        HolisticModel(0.9).fit_blocks(in_blocks(X), progress=False)


# --- files ----------------------------------------------------------------------------------------


def saved(model, tmp_path):
    model.save(tmp_path / "model.npz")
    return load_model(tmp_path / "model.npz")


@pytest.mark.parametrize("sharing", SHARING)
def test_a_model_comes_back_from_its_file_to_the_bit(rng, bumpy, tmp_path, sharing):
    regions = random_regions(bumpy, rng, sharing)
    X = rng.normal(size=(40, 126))
    model = RegionModel(regions, 0.7, 0.2, "total", "gradient").fit(X)
    back = saved(model, tmp_path)
    assert type(back) is RegionModel
    same = {k: v for k, v in model.get_params().items() if k != "regions"}
    assert {k: v for k, v in back.get_params().items() if k != "regions"} == same
    np.testing.assert_array_equal(back.transform(X), model.transform(X))
    np.testing.assert_array_equal(back.reconstruct(X), model.reconstruct(X))
    assert all(map(np.array_equal, back.variances_, model.variances_))
    np.testing.assert_array_equal(back.regions.labels, regions.labels)
    np.testing.assert_array_equal(back.regions.mesh.vertices, bumpy.vertices)
    np.testing.assert_array_equal(back.regions.mesh.faces, bumpy.faces)
    assert back.regions.mesh.landmarks == bumpy.landmarks
    np.testing.assert_array_equal(back.truncated(5).boundary_, model.truncated(5).boundary_)


def test_regions_carried_to_a_dense_mesh_come_back_too(rng, tmp_path):
    mesh, labels = quarters(9, 8)
    samples, small = mesh.subsample(30)
    control = Regions(labels[samples], small, "both", 2)
    model = RegionModel(control.carried_to(mesh, samples), 2).fit(rng.normal(size=(20, 216)))
    back = saved(model, tmp_path).regions
    assert (back.sharing, back.rings) == ("both", 2)
    np.testing.assert_array_equal(back.held, model.regions.held)
    np.testing.assert_array_equal(back.samples, samples)


def test_models_without_regions_or_variances_come_back(rng, tmp_path):
    X = rng.normal(size=(20, 18))
    whole = saved(HolisticModel(3).fit(X), tmp_path)
    assert type(whole) is HolisticModel
    given = saved(RegionModel.from_bases(None, np.ones(18), [rng.normal(size=(2, 18))]), tmp_path)
    assert given.variances_ is None
    assert given.mean_.tolist() == [1.0] * 18


def test_a_model_that_learned_nothing_is_not_saved(tmp_path):
    with pytest.raises(NotFittedError):
        RegionModel().save(tmp_path / "model.npz")
    assert list(tmp_path.iterdir()) == []


def test_damaged_newer_and_foreign_files_are_refused_by_name(rng, tmp_path):
    path = tmp_path / "model.npz"
    model, _ = fitted(corner_regions(), rng)
    model.save(path)
    kind, version = "linear-face-model", 1
    arrays = load_npz(path, kind, version)
    save_npz(tmp_path / "newer.npz", kind, version + 1, **arrays)
    save_npz(tmp_path / "other.npz", "rig", version, **arrays)
    save_npz(tmp_path / "part.npz", kind, version, mean=arrays["mean"])
    few = {**arrays, "components": arrays["components"][:-5]}
    save_npz(tmp_path / "few.npz", kind, version, **few)
    nan = {**arrays, "components": np.nan * arrays["components"]}
    save_npz(tmp_path / "nan.npz", kind, version, **nan)
    whole = path.read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for name, message in {
        "newer": "version 2",
        "other": "'rig'",
        "part": "do not fit together",
        "few": "do not fit together",
        "nan": "do not fit together",
        "cut": "not a readable",
    }.items():
        with pytest.raises(ValueError, match=rf"{name}\.npz.*{message}"):
            load_model(tmp_path / f"{name}.npz")
    with pytest.raises(FileNotFoundError, match="absent"):
        load_model(tmp_path / "absent.npz")
