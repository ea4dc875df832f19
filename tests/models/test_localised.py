import doctest

import numpy as np
import pytest
from planted import bumps, quarters
from shapes import grid_mesh

from facelab.models import global_local, localised
from facelab.models.holistic import HolisticModel
from facelab.models.localised import SUPPORT, localised_model, varimax


@pytest.fixture(scope="module")
def planted():
    """Four bumps far apart on a grid, each rising by itself: mesh, frames, shapes."""
    mesh, rng = grid_mesh(16, 14, 12.0), np.random.default_rng(4)
    middles = [34, 45, 178, 189]
    away = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[middles], axis=2)
    rise = np.exp(-((away / 14) ** 2)).T
    shapes = rise[..., None] * rng.normal(size=(4, 1, 3))
    W = rng.uniform(-1, 1, size=(60, 4)) * 5
    return mesh, np.tensordot(W, shapes, axes=1).reshape(60, -1), middles


def test_planted_bumps_are_found_one_in_each_component(planted):
    mesh, X, middles = planted
    model = localised_model(X, mesh, 4, sparsity=0.5, rounds=10)
    lengths = np.linalg.norm(model.components_[0].reshape(4, -1, 3), axis=2)
    assert sorted(lengths.argmax(axis=1).tolist()) == middles
    left = X - model.reconstruct(X)
    assert np.square(left).sum() < 0.01 * np.square(X - X.mean(axis=0)).sum()


def test_weights_reach_one_and_no_further(planted):
    mesh, X, _ = planted
    model = localised_model(X, mesh, 4, sparsity=10.0, rounds=40)
    np.testing.assert_allclose(np.abs(model.transform(X)).max(axis=0), 1, atol=0.01)


def test_nothing_far_from_its_middle_moves_where_sparsity_is_high(planted):
    mesh, X, _ = planted
    noisy = X + np.random.default_rng(0).normal(scale=0.1, size=X.shape)
    dense = HolisticModel(4).fit(noisy).components_[0].reshape(4, -1, 3)
    sparse = localised_model(noisy, mesh, 4, sparsity=20).components_[0].reshape(4, -1, 3)
    for component in sparse:
        lengths = np.linalg.norm(component, axis=1)
        far = mesh.geodesics([lengths.argmax()])[0] > SUPPORT[1]
        assert lengths[far].max() == 0
    assert (np.linalg.norm(dense, axis=2) > 0).all()


def test_without_a_price_the_components_are_no_worse_than_rank_one_after_another(planted):
    mesh, labels = quarters()
    X = bumps(mesh, labels, np.random.default_rng(1))
    free = localised_model(X, mesh, 8, sparsity=0.0, rounds=30).reconstruct(X)
    best = HolisticModel(8).fit(X).reconstruct(X)
    assert np.linalg.norm(X - best) <= np.linalg.norm(X - free) + 1e-9
    assert np.linalg.norm(X - free) < 0.05 * np.linalg.norm(X - X.mean(axis=0))


def test_sizes_that_are_none_are_refused(planted):
    mesh, X, _ = planted
    with pytest.raises(ValueError, match="n_components=0"):
        localised_model(X, mesh, 0)
    with pytest.raises(ValueError, match="X has shape"):
        localised_model(X[:, :-3], mesh, 2)


def test_more_components_than_frames_and_frames_alike_are_refused(planted):
    mesh, X, _ = planted
    for n in (61, 10**6):  # a million were begun
        with pytest.raises(ValueError, match=f"n_components={n}.* 1 to 60"):
            localised_model(X, mesh, n)
    with pytest.raises(ValueError, match="X holds still"):
        localised_model(np.repeat(X[:1], 20, axis=0), mesh, 2)


def test_turned_rows_stay_orthonormal_and_span_the_same(rng):
    B = np.linalg.qr(rng.normal(size=(30, 5)))[0].T
    T = varimax(B)
    np.testing.assert_allclose(T @ T.T, np.eye(5), atol=1e-10)
    np.testing.assert_allclose(T.T @ T, B.T @ B, atol=1e-10)


def test_rows_that_moved_few_coordinates_before_they_were_mixed_are_found_again(rng):
    sparse = np.zeros((4, 40))
    for k in range(4):
        sparse[k, 10 * k : 10 * k + 10] = rng.uniform(0.5, 1, size=10)
    sparse /= np.linalg.norm(sparse, axis=1)[:, None]
    mixed = np.linalg.qr(rng.normal(size=(4, 4)))[0] @ sparse
    found = np.abs(varimax(mixed) @ sparse.T)
    np.testing.assert_allclose(np.sort(found, axis=None)[-4:], 1, atol=1e-6)


def test_the_examples_run():
    assert doctest.testmod(localised).failed == 0
    assert doctest.testmod(global_local).failed == 0
