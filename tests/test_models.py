import literal
import numpy as np
import pytest
from planted import corner_regions, quarters, relabelled, three_strips, waves
from sklearn.base import clone
from sklearn.decomposition import PCA
from sklearn.exceptions import NotFittedError

from facelab.models import HolisticModel, RegionModel, principal_components
from facelab.segmentation import Regions

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
    return model._set_bases(model.columns_, components, model.variances_)


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
    zeta = rng.normal(size=model.n_coefficients_)

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
        zeta = rng.normal(size=model.n_coefficients_)
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
    zeta = rng.normal(size=model.n_coefficients_)
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
    assert model.n_coefficients_ == 23
    assert [B.shape for B in model.components_] == [(20, 87), (3, 3)]
    np.testing.assert_allclose(model.reconstruct(X)[:, :3], X[:, :3], atol=1e-9)


def test_settings_are_kept_as_they_were_given_and_cloned(rng):
    regions = three_strips()
    model = RegionModel(regions, n_components=3, beta=0.1)
    assert model.get_params() == {"regions": regions, "n_components": 3, "beta": 0.1}
    model.fit(rng.normal(size=(10, 135)))
    copy = clone(model, safe=False)
    assert copy.n_components == 3
    assert not hasattr(copy, "mean_")
    assert model.regions is regions
    assert HolisticModel(4).get_params() == {"n_components": 4}
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
        ({"n_components": True}, np.zeros((10, 135)), TypeError, "n_components=True"),
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
