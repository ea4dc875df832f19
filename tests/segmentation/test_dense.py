"""Dense faces are cut as small ones are, without a matrix of all pairs."""

import numpy as np
import pytest
from planted import patch_motion, quarters
from shapes import grid_mesh
from sklearn.metrics import adjusted_rand_score

from facelab.segmentation import dense as dense_module
from facelab.segmentation.clusters import LARGE, spectral_embedding
from facelab.segmentation.dense import FAR, Correlations, Distances, sparse_affinity
from facelab.segmentation.segment import Affinity, stability
from facelab.segmentation.similarity import affinity, motion_correlation

SINGLE = 1e-5  # sums of some hundred products in single precision


def with_a_still_vertex(rng, n_vertices):
    positions = rng.normal(size=(30, n_vertices, 3)) + 100
    positions[:, 4] = 100
    positions[:, :3] = positions[:, :1] + 0.1 * rng.normal(size=(30, 3, 3))
    return positions


def test_rows_of_the_correlation_are_those_of_the_whole_matrix(rng):
    positions = with_a_still_vertex(rng, 9)
    C_bar, wanted = Correlations(positions), motion_correlation(positions)
    np.testing.assert_allclose(np.asarray(C_bar), wanted, atol=SINGLE)
    for rows in (4, slice(2, 6), [7, 0], np.arange(9) > 5):
        np.testing.assert_allclose(C_bar[rows], wanted[rows], atol=SINGLE)
        np.testing.assert_array_equal(C_bar[rows][..., 4], wanted[rows][..., 4])


def test_rows_of_the_distances_are_those_of_the_whole_matrix(bumpy):
    G, wanted = Distances(bumpy), bumpy.geodesics()
    np.testing.assert_array_equal(np.asarray(G), wanted)
    for rows in (3, slice(2, 6), [7, 0]):
        np.testing.assert_array_equal(G[rows], wanted[rows])
    near = G.within([7, 0], 9.0)
    np.testing.assert_array_equal(near, np.where(wanted[[7, 0]] <= 9, wanted[[7, 0]], np.inf))


@pytest.mark.parametrize("block", [7, 300, 10**6])
@pytest.mark.parametrize(
    "lam, r, threshold", [(0.7, 1.5, 0.7), (0, 2, 0.5), (1, 1, 0), (0.4, 9, 0)]
)
def test_the_sparse_affinity_lacks_only_what_lies_far(
    rng, bumpy, monkeypatch, block, lam, r, threshold
):
    monkeypatch.setattr(dense_module, "BLOCK", block)
    positions = with_a_still_vertex(rng, bumpy.n_vertices)
    A = sparse_affinity(Correlations(positions), Distances(bumpy), lam, r, threshold)
    G = bumpy.geodesics()
    wanted = affinity(motion_correlation(positions), G, lam, r, threshold)
    wanted -= np.where(G > FAR * r, (1 - lam) * np.exp(-G / r), 0)
    np.testing.assert_allclose(A.toarray(), wanted, atol=SINGLE)
    assert A.dtype == np.float32
    assert (abs(A - A.T) > 0).nnz == 0


def test_the_embedding_of_a_sparse_affinity_is_that_of_the_full_one(rng, bumpy):
    positions = rng.normal(size=(30, bumpy.n_vertices, 3))
    A = sparse_affinity(Correlations(positions), Distances(bumpy), r=20)
    before = A.copy()
    for rows in ("unit", "degree"):
        np.testing.assert_allclose(
            spectral_embedding(A, 3, rows), spectral_embedding(A.toarray(), 3, rows), atol=1e-4
        )
    assert (A != before).nnz == 0


@pytest.fixture(scope="module")
def dense_motion():
    mesh, truth = quarters(44, 36, 5.0)
    assert mesh.n_vertices > LARGE
    return patch_motion(mesh, truth, np.random.default_rng(0)), truth


def test_a_dense_face_is_cut_as_by_the_matrices_of_all_pairs(dense_motion):
    motion, truth = dense_motion
    measured = Affinity.of(motion)
    assert isinstance(measured.C_bar, Correlations) and isinstance(measured.G, Distances)
    full = Affinity(motion.mesh, motion_correlation(motion.positions), motion.mesh.geodesics())
    for settings in ({}, {"lam": 0.5}, {"threshold": 0.2}):
        cuts = [
            x.with_(**settings).segment(4, random_state=0, progress=False) for x in (measured, full)
        ]
        assert adjusted_rand_score(*(cut.labels for cut in cuts)) > 0.95
        assert adjusted_rand_score(cuts[0].labels, truth) > 0.95
    np.testing.assert_allclose(measured.G_bar, full.G_bar)


def test_the_stability_of_a_dense_cut_is_measured_without_all_pairs(dense_motion):
    scores, labels = stability(dense_motion[0], 4, n_draws=2, block=1, random_state=0)
    assert labels.shape == (2, len(dense_motion[1]))
    assert scores.min() > 0.9


def test_as_many_clusters_as_lanczos_does_not_find_are_found_all_the_same(rng):
    mesh = grid_mesh(6, 5, 4.0)
    A = sparse_affinity(Correlations(rng.normal(size=(9, 30, 3))), Distances(mesh))
    assert spectral_embedding(A, 30).shape == (30, 30)


def test_matrices_that_do_not_agree_and_faces_in_pieces_are_refused(rng, bumpy):
    C_bar = Correlations(rng.normal(size=(9, 5, 3)))
    with pytest.raises(ValueError, match=r"C_bar has shape \(5, 5\)"):
        sparse_affinity(C_bar, Distances(bumpy))
    with pytest.raises(ValueError, match="needs 2 or more"):
        Correlations(rng.normal(size=(1, 5, 3)))
