import dataclasses
import math
import warnings

import literal
import numpy as np
import pytest
from planted import patch_motion, quarters, relabelled
from shapes import grid_mesh
from sklearn.cluster import KMeans, SpectralClustering
from sklearn.metrics import adjusted_rand_score

from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence
from facelab.segmentation import clusters as clusters_module
from facelab.segmentation import segment as segment_module
from facelab.segmentation.clusters import compactness, renumbered, spectral_embedding
from facelab.segmentation.dense import Correlations
from facelab.segmentation.regions import Regions
from facelab.segmentation.segment import Affinity, segment_face, stability
from facelab.segmentation.similarity import affinity, motion_correlation, nearness


def quick(motion, **settings):
    return segment_face(motion, progress=False, **{"random_state": 0, **settings})


def as_sets(labels):
    return {frozenset(np.flatnonzero(labels == i).tolist()) for i in range(labels.max() + 1)}


def strips(n_columns=9, n_rows=4):
    """A grid and the third of its width that each vertex lies in."""
    mesh = grid_mesh(n_columns, n_rows, 8.0)
    return mesh, np.arange(mesh.n_vertices) % n_columns * 3 // n_columns


# --- correlation ----------------------------------------------------------------------------------


def test_correlation_is_that_of_each_axis_averaged(rng):
    positions = rng.normal(size=(15, 8, 3)) @ rng.normal(size=(3, 3)) + 100
    # two ways to sum 15 products of numbers near 1, taken off a mean near 100
    np.testing.assert_allclose(
        motion_correlation(positions), literal.correlation(positions), atol=1e-12
    )


def test_correlation_agrees_with_numpy(rng):
    positions = rng.normal(size=(20, 6, 3))
    expected = sum(np.corrcoef(positions[:, :, a], rowvar=False) for a in range(3)) / 3
    np.testing.assert_allclose(motion_correlation(positions), expected, atol=1e-12)


def test_a_still_vertex_is_like_no_other_and_like_itself(rng):
    positions = rng.normal(size=(12, 5, 3))
    positions[:, 2] = [7.0, -3.0, 11.0]
    C_bar = motion_correlation(positions)
    assert (C_bar[2, [0, 1, 3, 4]] == 0).all()
    assert (C_bar[[0, 1, 3, 4], 2] == 0).all()
    assert C_bar[2, 2] == 1


def test_one_still_axis_counts_as_no_correlation_on_that_axis(rng):
    positions = np.repeat(rng.normal(size=(12, 1, 3)), 2, axis=1)
    positions[:, :, 2] = 4.0
    # two vertices moving exactly alike in x and y, not at all in z
    assert motion_correlation(positions)[0, 1] == pytest.approx(2 / 3, abs=1e-12)


def test_a_face_that_never_moves_has_correlation_one_with_itself_alone():
    np.testing.assert_array_equal(motion_correlation(np.full((6, 4, 3), 3.3)), np.eye(4))


def test_rounding_is_not_motion():
    positions = np.full((6, 4, 3), 1000.1) + 1e-10 * np.arange(6)[:, None, None]
    np.testing.assert_array_equal(motion_correlation(positions), np.eye(4))


@pytest.mark.parametrize("n_frames", [12, 400])
@pytest.mark.parametrize("way", ["at once", "in blocks", "dense"])
def test_what_moves_by_less_than_a_nanometre_is_still_however_long_the_take(rng, way, n_frames):
    away = rng.normal(size=n_frames)
    away -= away.mean()
    positions = np.repeat(away[:, None, None] / away.std(), 3, axis=1).repeat(3, axis=2)
    positions[:, 1:] *= np.array([0.9e-6, 1.1e-6])[:, None]  # mm
    if way == "in blocks":
        positions = pytest.importorskip("dask.array").from_array(positions, chunks=(7, -1, -1))
    found = Correlations(positions)[:] if way == "dense" else motion_correlation(positions)
    np.testing.assert_allclose(found[0], [1, 0, 1], atol=1e-3)


def test_correlation_does_not_know_size_or_place_of_a_motion(rng):
    positions = rng.normal(size=(12, 5, 3))
    moved = 3 * positions + rng.normal(size=(5, 3))
    np.testing.assert_allclose(motion_correlation(moved), motion_correlation(positions), atol=1e-12)


def test_correlation_stays_within_one_for_vertices_that_move_alike(rng):
    positions = np.repeat(rng.normal(size=(50, 1, 3)), 30, axis=1)
    C_bar = motion_correlation(positions)
    assert C_bar.max() <= 1
    np.testing.assert_allclose(C_bar, 1, atol=1e-12)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        (np.zeros((1, 4, 3)), "1 frame"),
        (np.zeros((5, 4)), "shape"),
        (np.full((5, 4, 3), np.nan), "NaN"),
    ],
)
def test_correlation_refuses_what_it_cannot_use(positions, message):
    with pytest.raises(ValueError, match=message):
        motion_correlation(positions)


# --- affinity -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lam", "r", "threshold"), [(0.7, 10.0, 0.7), (0.3, 4.0, 0.2), (0.5, 25.0, 0)]
)
def test_affinity_is_equations_11_and_12(rng, bumpy, lam, r, threshold):
    C_bar = motion_correlation(rng.normal(size=(4, bumpy.n_vertices, 3)))
    G = bumpy.geodesics()
    np.testing.assert_allclose(
        affinity(C_bar, G, lam, r, threshold),
        literal.affinity(C_bar, G, lam, r, threshold),
        atol=1e-15,
    )


def test_correlations_below_the_threshold_become_nothing_and_those_on_it_stay():
    C_bar = np.array([[1, 0.7, 0.69], [0.7, 1, -0.9], [0.69, -0.9, 1]])
    A = affinity(C_bar, np.zeros((3, 3)), lam=1, threshold=0.7)
    np.testing.assert_array_equal(A, [[1, 0.7, 0], [0.7, 1, 0], [0, 0, 1]])


def test_lambda_one_is_correlation_alone_and_lambda_zero_is_nearness_alone(rng, bumpy):
    C_bar = motion_correlation(rng.normal(size=(9, bumpy.n_vertices, 3)))
    G = bumpy.geodesics()
    np.testing.assert_array_equal(affinity(C_bar, G, lam=0), np.exp(-G / 10))
    np.testing.assert_array_equal(affinity(C_bar, G, lam=1), np.where(C_bar >= 0.7, C_bar, 0))


def test_nearness_is_almost_nothing_beyond_fifty_millimetres_at_the_papers_r():
    assert affinity(np.zeros((1, 1)), np.array([[50.0]]), lam=0)[0, 0] < 0.01


def test_nearness_is_equation_11(bumpy):
    G = bumpy.geodesics()
    expected = [[math.exp(-g / 4) for g in row] for row in G]
    np.testing.assert_allclose(nearness(G, 4), expected, atol=1e-15)


def test_affinity_does_not_write_on_what_it_is_given(rng, bumpy):
    C_bar, G = motion_correlation(rng.normal(size=(9, bumpy.n_vertices, 3))), bumpy.geodesics()
    before = C_bar.copy(), G.copy()
    affinity(C_bar, G)
    np.testing.assert_array_equal(C_bar, before[0])
    np.testing.assert_array_equal(G, before[1])


def test_affinity_refuses_a_correlation_that_is_no_number():
    C_bar = np.eye(3)
    C_bar[1, 2] = np.nan
    with pytest.raises(ValueError, match=r"C_bar holds 1 value.*index \(1, 2\)"):
        affinity(C_bar, np.zeros((3, 3)))


def test_compactness_needs_a_label_for_each_vertex(grid):
    for labels in (np.zeros(29, dtype=int), np.zeros(31, dtype=int), np.zeros(30)):
        with pytest.raises(ValueError, match="one integer for each of the 30"):
            compactness(labels, grid)


def test_affinity_refuses_matrices_of_two_sizes():
    with pytest.raises(ValueError, match="must agree"):
        affinity(np.eye(3), np.zeros((4, 4)))


@pytest.mark.parametrize(
    "bad", [{"lam": -0.1}, {"lam": 1.1}, {"r": 0}, {"r": -5}, {"threshold": 1.5}, {"lam": np.nan}]
)
def test_affinity_names_the_parameter_out_of_range(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        affinity(np.eye(3), np.zeros((3, 3)), **bad)


# --- spectral clustering --------------------------------------------------------------------------


def random_affinity(rng, n=14):
    A = rng.uniform(size=(n, n))
    return (A + A.T) / 2


@pytest.mark.parametrize("k", [1, 2, 5])
def test_embedding_is_that_of_ng_jordan_and_weiss(rng, k):
    A = random_affinity(rng)
    ours, theirs = spectral_embedding(A, k), literal.ng_jordan_weiss(A, k)
    # eigenvectors are found up to sign; products of rows do not know it
    np.testing.assert_allclose(ours @ ours.T, theirs @ theirs.T, atol=1e-9)
    np.testing.assert_allclose(np.abs(ours), np.abs(theirs), atol=1e-9)


def test_rows_of_the_embedding_have_length_one(rng):
    Y = spectral_embedding(random_affinity(rng), 4)
    np.testing.assert_allclose(np.linalg.norm(Y, axis=1), 1, atol=1e-12)


def test_the_diagonal_of_the_affinity_is_not_used(rng):
    A = random_affinity(rng)
    B = A.copy()
    np.fill_diagonal(B, 100)
    np.testing.assert_array_equal(spectral_embedding(A, 3), spectral_embedding(B, 3))
    assert A[0, 0] < 2, "the affinity given was written on"


def test_a_vertex_without_any_affinity_does_not_spoil_the_others(rng):
    A = random_affinity(rng)
    A[5] = A[:, 5] = 0
    assert np.isfinite(spectral_embedding(A, 3)).all()


def clusters(A, k):
    """What segmentation makes of an affinity: λ = 1 and no threshold let it through as it is."""
    mesh = grid_mesh(5, len(A) // 5, 8.0)
    measured = Affinity(mesh, A, np.zeros(A.shape), lam=1.0, threshold=0.0)
    return measured.segment(k, random_state=0, progress=False).labels


@pytest.mark.parametrize("sizes", [(5, 5), (2, 9, 4), (3, 3, 3, 3, 13)])
def test_planted_blocks_are_found_exactly(rng, sizes):
    truth = np.repeat(np.arange(len(sizes)), sizes)
    truth = truth[rng.permutation(len(truth))]
    A = np.where(truth[:, None] == truth, 0.8, 0.02) + rng.uniform(0, 0.02, size=(len(truth),) * 2)
    labels = clusters((A + A.T) / 2, len(sizes))
    assert as_sets(labels) == as_sets(truth)


def test_clusters_are_numbered_by_their_first_vertex(rng):
    labels = clusters(random_affinity(rng, 30), 6)
    firsts = [np.flatnonzero(labels == i)[0] for i in range(6)]
    assert firsts == sorted(firsts)
    assert labels[0] == 0


def test_clusters_are_the_best_of_many_runs_of_k_means(rng):
    A = random_affinity(rng, 40)
    Y = spectral_embedding(A, 7)
    labels = clusters(A, 7)
    spread = sum(np.sum((Y[labels == i] - Y[labels == i].mean(axis=0)) ** 2) for i in range(7))
    single = [KMeans(7, n_init=1, random_state=s).fit(Y).inertia_ for s in range(20)]
    assert spread <= np.median(single)


@pytest.mark.parametrize("k", [0, -1, 5])
def test_too_few_or_too_many_clusters_are_refused(k):
    with pytest.raises(
        ValueError, match=f"k={k}, but the number of clusters of 4 vertices must be 1 to 4"
    ):
        spectral_embedding(np.ones((4, 4)), k)


@pytest.mark.parametrize("k", [2.5, "3", True, None])
def test_a_number_of_clusters_that_is_no_integer_is_refused(k):
    with pytest.raises(TypeError, match=f"k={k!r} is not an integer"):
        spectral_embedding(np.ones((4, 4)), k)


@pytest.mark.parametrize("k", [2, 3, 6])
def test_rows_divided_by_the_degree_are_scikit_learn_s_clusters(rng, k):
    n = 60
    truth = rng.integers(k, size=n)
    A = np.where(truth[:, None] == truth, 0.5, 0.2) * rng.uniform(0.2, 1, size=(n, n))
    A = (A + A.T) / 2
    theirs = SpectralClustering(k, affinity="precomputed", n_init=50, random_state=0).fit(A).labels_
    Y = spectral_embedding(A, k, rows="degree")
    ours = KMeans(k, n_init=50, random_state=0).fit_predict(Y)
    assert adjusted_rand_score(theirs, ours) == 1


def test_rows_divided_by_the_degree_solve_the_cut_of_shi_and_malik(rng):
    A = random_affinity(rng)
    np.fill_diagonal(A, 0)
    Y = spectral_embedding(A, 3, rows="degree")
    step = A / A.sum(axis=1, keepdims=True)  # of a random walk: A y = mu D y
    mu = (Y * (step @ Y)).sum(axis=0) / (Y**2).sum(axis=0)
    np.testing.assert_allclose(step @ Y, Y * mu, atol=1e-12)
    assert mu[0] == pytest.approx(1) and mu[0] > mu[1] > mu[2]


def test_rows_are_scaled_in_one_of_two_ways():
    with pytest.raises(ValueError, match="rows='none'"):
        spectral_embedding(np.ones((4, 4)), 2, rows="none")


def test_many_vertices_are_embedded_as_few_are(rng, monkeypatch):
    V = rng.uniform(0, 90, size=(120, 3))
    A = np.exp(-np.linalg.norm(V[:, None] - V, axis=2) / 10)
    dense = spectral_embedding(A, 6)
    monkeypatch.setattr(clusters_module, "LARGE", 100)
    np.testing.assert_allclose(spectral_embedding(A, 6), dense, atol=1e-8)


def test_renumbered_clusters_are_the_same_and_take_the_names_of_their_counterparts(rng):
    like = rng.integers(6, size=200)
    order = rng.permutation(6)
    labels = order[like].copy()
    stray = rng.choice(200, size=20, replace=False)
    labels[stray] = rng.integers(6, size=20)
    new = renumbered(labels, like)
    assert adjusted_rand_score(new, labels) == 1
    untouched = np.setdiff1d(np.arange(200), stray)
    np.testing.assert_array_equal(new[untouched], like[untouched])


@pytest.mark.parametrize(("k", "n_new"), [(3, 0), (8, 3)])
def test_clusters_without_a_counterpart_take_numbers_of_their_own(k, n_new):
    like, labels = np.arange(40) % 5, np.arange(40) // 5 % k
    new = renumbered(labels, like)
    assert adjusted_rand_score(new, labels) == 1
    assert sorted(set(new[new >= 5].tolist())) == list(range(5, 5 + n_new))


# --- compactness ----------------------------------------------------------------------------------


def test_a_cluster_in_two_pieces_is_not_compact():
    mesh = grid_mesh(9, 4)
    column = np.arange(mesh.n_vertices) % 9
    seen = compactness(np.isin(column, [5, 6]).astype(int), mesh)
    assert seen.pieces == (2, 1)
    assert seen.k == 2
    assert not seen.compact
    smaller = np.flatnonzero(column > 6).tolist()
    assert seen.cut_off == ((tuple(smaller),), ())
    assert "cluster 0 is in 2 pieces (cut off: vertex 7, 8, 16, 17, 25, 26 and 2 more)" in str(seen)


def test_clusters_in_one_piece_each_are_compact_even_if_some_vertices_are_loose():
    mesh = grid_mesh(4, 3)
    labels = np.zeros(12, dtype=int)
    labels[[2, 3]] = 1  # a row of two at the edge: one piece, but no triangle
    seen = compactness(labels, mesh)
    assert seen.pieces == (1, 1)
    assert seen.loose == ((), (2, 3))
    assert seen.compact and not seen.formed
    assert "2 vertices without a triangle" in str(seen)


def test_pieces_and_loose_vertices_are_those_of_a_search_by_hand(rng):
    mesh = grid_mesh(8, 7)
    labels = rng.integers(4, size=mesh.n_vertices)
    labels[:4] = range(4)
    seen = compactness(labels, mesh)
    for i in range(4):
        rest = set(np.flatnonzero(labels == i).tolist())
        triangles = [f for f in mesh.faces.tolist() if set(f) <= rest]
        assert set(seen.loose[i]) == rest - {v for f in triangles for v in f}
        pieces = []
        while rest:
            piece = reached = {rest.pop()}
            while reached:
                reached = {int(v) for e in mesh.edges if reached & set(e) for v in e} & rest
                rest -= reached
                piece = piece | reached
            pieces.append(piece)
        assert seen.pieces[i] == len(pieces)
        assert sum(map(len, seen.cut_off[i])) == sum(map(len, pieces)) - max(map(len, pieces))
        assert all(set(piece) in pieces for piece in seen.cut_off[i])


def test_two_triangles_that_meet_in_one_vertex_are_one_piece():
    V = np.array([[0, 0, 0], [1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]], dtype=float)
    mesh = TriangleMesh(V, np.array([[0, 2, 1], [0, 3, 4]]))
    assert compactness(np.zeros(5, dtype=int), mesh).pieces == (1,)


# --- regions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sharing", ["one-sided", "both", "none"])
def test_shared_vertices_follow_the_rule_edge_by_edge(rng, bumpy, sharing):
    labels = rng.integers(4, size=bumpy.n_vertices)
    labels[:4] = range(4)
    regions = Regions(labels, bumpy, sharing)
    expected = literal.members(labels, bumpy.faces, sharing)
    assert len(regions.members) == 4
    for ours, theirs in zip(regions.members, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("sharing", ["one-sided", "both", "none"])
@pytest.mark.parametrize("rings", [1, 2])
def test_every_vertex_belongs_to_its_own_region(rng, bumpy, sharing, rings):
    labels = np.arange(bumpy.n_vertices) % 5
    regions = Regions(labels, bumpy, sharing, rings)
    for i, vertices in enumerate(regions.members):
        assert set(np.flatnonzero(labels == i)) <= set(vertices)
    assert regions.holders.min() >= 1
    assert regions.shared_share == np.mean(regions.holders > 1)


def test_the_band_of_two_strips_is_as_wide_as_its_rings():
    mesh = grid_mesh(8, 3)
    column = np.arange(mesh.n_vertices) % 8
    for rings in (1, 2, 3):
        one = Regions((column >= 4).astype(int), mesh, "one-sided", rings)
        both = Regions((column >= 4).astype(int), mesh, "both", rings)
        assert set(column[one.holders > 1]) == set(range(4 - rings, 4))
        assert set(column[both.holders > 1]) == set(range(4 - rings, 4 + rings))


def test_regions_that_share_nothing_are_a_partition(bumpy):
    regions = Regions(np.arange(bumpy.n_vertices) % 3, bumpy, "none")
    assert (regions.holders == 1).all()
    assert regions.shared_share == 0


def test_labels_may_be_a_list(grid):
    regions = Regions([0] * 15 + [1] * 15, grid)
    assert regions.n_regions == 2
    assert len(regions.members) == 2


def test_regions_print_their_number_and_share():
    mesh = grid_mesh(4, 5)
    regions = Regions((np.arange(20) % 4 >= 2).astype(int), mesh)
    assert repr(regions) == "Regions(2 on 20 vertices, 25 % of them shared)"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"labels": np.zeros(29, dtype=int)}, "one integer for each of the 30"),
        ({"labels": np.zeros(30)}, "float64"),
        ({"labels": np.full(30, 2)}, r"unused \[0, 1\]"),
        ({"labels": np.arange(30) - 1}, "smallest -1"),
        ({"sharing": "some"}, "sharing='some'"),
        ({"rings": 0}, "rings=0"),
        ({"held": np.zeros((1, 30), dtype=bool)}, "held"),
        ({"held": np.ones((2, 30), dtype=bool)}, "held has shape"),
    ],
)
def test_regions_refuse_what_is_no_cut_of_the_mesh(grid, change, message):
    settings = {"labels": np.zeros(30, dtype=int), "mesh": grid, **change}
    with pytest.raises(ValueError, match=message):
        Regions(**settings)


def test_a_matrix_in_the_order_of_the_regions_is_in_blocks(rng, bumpy):
    labels = rng.integers(4, size=bumpy.n_vertices)
    labels[:4] = range(4)
    regions = Regions(labels, bumpy)
    assert sorted(regions.order) == list(range(bumpy.n_vertices))
    together = (labels[:, None] == labels)[np.ix_(regions.order, regions.order)]
    ends = np.cumsum(np.bincount(labels))
    for start, end in zip([0, *ends], ends, strict=False):
        assert together[start:end, start:end].all()
        assert not together[start:end, end:].any()


# --- carried to a dense mesh ----------------------------------------------------------------------


def coarse_and_dense():
    """Regions on a grid, and a grid three times as fine with the coarse vertices in it."""
    coarse, labels = quarters(6, 5, 9.0)
    dense = grid_mesh(16, 13, 3.0)
    row, column = np.divmod(np.arange(coarse.n_vertices), 6)
    return Regions(labels, coarse), dense, 3 * row * 16 + 3 * column


def test_carried_regions_are_those_of_the_nearest_sample():
    regions, dense, samples = coarse_and_dense()
    carried = regions.carried_to(dense, samples)
    G = dense.geodesics(samples)
    for v in range(dense.n_vertices):
        near = np.flatnonzero(G[:, v] <= G[:, v].min() + 1e-9)  # several where it is half-way
        assert carried.labels[v] in regions.labels[near]
        held = {i for i, m in enumerate(carried.members) if v in m}
        assert any(held == {i for i, m in enumerate(regions.members) if n in m} for n in near)


def test_carried_regions_hold_the_samples_as_before():
    regions, dense, samples = coarse_and_dense()
    carried = regions.carried_to(dense, samples)
    for before, after in zip(regions.members, carried.members, strict=True):
        np.testing.assert_array_equal(np.flatnonzero(np.isin(samples, after)), before)
    np.testing.assert_array_equal(carried.samples, samples)


def test_shared_bands_keep_their_share_of_the_surface():
    regions, dense, samples = coarse_and_dense()
    carried = regions.carried_to(dense, samples)
    anew = Regions(carried.labels, dense)
    # cells at the edge of the grid are cut off, so the shares are not the same to the vertex
    assert carried.shared_share == pytest.approx(regions.shared_share, rel=0.2)
    assert anew.shared_share < 0.5 * regions.shared_share


def test_regions_can_be_carried_twice():
    regions, dense, samples = coarse_and_dense()
    once = regions.carried_to(dense, samples)
    again = once.carried_to(dense, np.arange(dense.n_vertices))
    np.testing.assert_array_equal(again.labels, once.labels)
    np.testing.assert_array_equal(again.samples, samples)
    assert all(map(np.array_equal, again.members, once.members))


def test_carrying_needs_one_sample_for_each_vertex():
    regions, dense, samples = coarse_and_dense()
    with pytest.raises(ValueError, match="samples names 29 vertices, but these regions lie on 30"):
        regions.carried_to(dense, samples[:-1])


# --- segment_face ---------------------------------------------------------------------------------


def test_patches_that_move_independently_are_the_regions(rng):
    mesh, truth = quarters()
    regions = quick(patch_motion(mesh, truth, rng), n_regions=4)
    np.testing.assert_array_equal(regions.labels, truth)


def test_strips_that_move_independently_are_the_regions_whatever_their_width(rng):
    mesh = grid_mesh(14, 7, 8.0)
    truth = np.searchsorted([3, 8], np.arange(mesh.n_vertices) % 14, side="right")
    regions = quick(patch_motion(mesh, truth, rng), n_regions=3)
    np.testing.assert_array_equal(regions.labels, truth)


def test_the_same_seed_gives_the_same_regions_and_first_vertices_number_them(rng):
    motion = MotionSequence(rng.normal(size=(40, 80, 3)), 30.0, grid_mesh(10, 8, 8.0))
    one, two = (quick(motion, n_regions=6, random_state=5) for _ in range(2))
    np.testing.assert_array_equal(one.labels, two.labels)
    firsts = [np.flatnonzero(one.labels == i)[0] for i in range(6)]
    assert firsts == sorted(firsts)


def test_renamed_vertices_give_the_same_regions_renamed(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    order = rng.permutation(mesh.n_vertices)
    renamed = MotionSequence(motion.positions[:, order], 30.0, relabelled(mesh, order))
    labels = np.empty_like(truth)
    labels[order] = quick(renamed, n_regions=4).labels
    assert as_sets(labels) == as_sets(quick(motion, n_regions=4).labels)


def test_regions_grow_until_a_cluster_falls_apart_and_the_last_whole_ones_are_kept(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng, noise=1.5)  # noise tears the many clusters apart
    settings = {"lam": 0.9, "threshold": 0.4}
    regions = quick(motion, **settings)
    *before, last = regions.tried
    assert [t.k for t in regions.tried] == list(range(2, last.k + 1))
    assert all(t.compact for t in before)
    assert not last.compact
    assert regions.n_regions == last.k - 1 >= 2, "the example should grow at least once"
    for seen in regions.tried:  # a second road: each k by itself
        alone = quick(motion, **settings, n_regions=seen.k)
        assert alone.tried == (seen,)
    alone = quick(motion, **settings, n_regions=last.k - 1)
    np.testing.assert_array_equal(regions.labels, alone.labels)


def test_a_face_that_cannot_be_cut_in_two_whole_parts_is_one_region(rng):
    mesh, strip = strips()
    motion = patch_motion(mesh, np.where(strip == 1, 1, 0), rng)  # the outer strips move alike
    regions = quick(motion, lam=1.0)
    assert regions.n_regions == 1
    assert [t.compact for t in regions.tried] == [False]
    assert regions.why.startswith("Every cluster in one piece up to k = 1, then no more. k =  2")


def test_growth_ends_at_the_most_regions_allowed(rng):
    mesh, truth = quarters()
    with pytest.warns(UserWarning, match="every k up to max_regions=3 is compact"):
        regions = quick(patch_motion(mesh, truth, rng), max_regions=3)
    assert regions.n_regions == 3
    assert len(regions.tried) == 2
    assert "up to k = 3, the most allowed" in regions.why


def test_a_wanted_number_of_regions_is_given_even_if_they_fall_apart(rng):
    mesh, strip = strips()
    motion = patch_motion(mesh, np.where(strip == 1, 1, 0), rng)
    regions = quick(motion, lam=1.0, n_regions=2)
    assert regions.n_regions == 2
    assert not regions.tried[0].compact
    assert regions.why.startswith("n_regions=2 was asked for. k =  2: cluster 0 is in 2 pieces")


def test_a_still_face_is_cut_by_distance_alone():
    mesh = grid_mesh(12, 6, 8.0)
    still = MotionSequence(np.repeat(mesh.vertices[None], 5, axis=0), 30.0, mesh)
    regions = quick(still, n_regions=2)
    assert regions.tried[0].compact
    assert np.bincount(regions.labels).min() >= 18  # neither half is a splinter


def test_lost_frames_do_not_count(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    spoilt = motion.positions.copy()
    spoilt[::7] = 1e3 * rng.normal(size=spoilt[::7].shape)
    valid = np.arange(len(spoilt)) % 7 != 0
    with_lost = dataclasses.replace(motion, positions=spoilt, valid=valid)
    np.testing.assert_array_equal(quick(with_lost, n_regions=4).labels, truth)


def test_sharing_is_passed_on(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    assert quick(motion, n_regions=4, sharing="none").shared_share == 0


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"lam": 2}, "lam=2"),
        ({"r": 0}, "r=0"),
        ({"threshold": -1}, "threshold=-1"),
        (
            {"n_regions": 0},
            "n_regions=0, but the number of clusters of 24 vertices must be 1 to 24",
        ),
        ({"n_regions": 1000}, "n_regions=1000, but the number of clusters of 24 vertices"),
        ({"n_init": 0}, "n_init=0, but the number of runs of k-means must be 1 or more"),
        ({"max_regions": 0}, "max_regions=0"),
        ({"reading": "words"}, "reading='words'"),
        ({"rings": -1, "n_regions": 2}, "rings=-1"),
        ({"sharing": "all", "n_regions": 2}, "sharing='all'"),
    ],
)
def test_segmentation_names_the_parameter_out_of_range(rng, bad, message):
    mesh, truth = quarters(6, 4)
    with pytest.raises(ValueError, match=message):
        quick(patch_motion(mesh, truth, rng, n_frames=10), **bad)


@pytest.mark.parametrize("count", [2.5, "4", True])
@pytest.mark.parametrize("name", ["n_regions", "max_regions", "n_init", "rings"])
def test_a_count_that_is_no_integer_is_refused(rng, name, count):
    mesh, truth = quarters(6, 4)
    settings = {"n_regions": 2, name: count}
    with pytest.raises(TypeError, match=f"{name}={count!r} is not an integer"):
        quick(patch_motion(mesh, truth, rng, n_frames=10), **settings)


def test_at_most_one_region_is_one_without_a_word_on_what_was_not_tried(rng):
    mesh, truth = quarters(6, 4)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*compact.*")
        regions = quick(patch_motion(mesh, truth, rng, n_frames=10), max_regions=1)
    assert regions.n_regions == 1 and regions.why == "max_regions=1 was asked for."


def test_an_array_is_no_motion(rng):
    with pytest.raises(
        TypeError, match=r"motion is a ndarray.*MotionSequence\(positions, fps, mesh"
    ):
        quick(rng.normal(size=(10, 30, 3)))


def test_the_strict_reading_stops_at_the_first_vertex_without_a_triangle_of_its_own(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng, noise=1.5)
    settings = {"lam": 0.9, "threshold": 0.4}
    by_pieces, strict = (quick(motion, **settings, reading=r) for r in ("pieces", "triangles"))
    *before, last = strict.tried
    assert all(t.formed for t in before) and not last.formed
    assert strict.n_regions == last.k - 1 < by_pieces.n_regions
    assert f"would have stopped at k = {strict.n_regions}." in by_pieces.why
    assert strict.why.startswith(
        f"Every vertex in a triangle of its own cluster up to k = {last.k - 1}"
    )
    alike = by_pieces.tried[: len(strict.tried)]
    assert strict.tried == alike


def test_a_wide_band_is_passed_on(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    shares = [quick(motion, n_regions=4, rings=rings).shared_share for rings in (1, 2)]
    assert shares[0] < shares[1]


@pytest.mark.parametrize("lam", [0.7, 1.0])
def test_still_vertices_never_make_a_nan(rng, lam):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    positions = motion.positions.copy()
    positions[:, truth == 3] = mesh.vertices[truth == 3]
    regions = quick(MotionSequence(positions, 30.0, mesh), lam=lam, n_regions=4)
    kept = truth != 3
    assert adjusted_rand_score(regions.labels[kept], truth[kept]) > 0.9


def test_an_affinity_holds_the_matrices_of_the_paper_and_cuts_as_segment_face_does(rng):
    mesh, truth = quarters(8, 6)
    motion = patch_motion(mesh, truth, rng, n_frames=20)
    measured = Affinity.of(motion, lam=0.4, r=20, threshold=0.3)
    np.testing.assert_allclose(measured.C_bar, literal.correlation(motion.positions), atol=1e-12)
    np.testing.assert_array_equal(measured.G, mesh.geodesics())
    np.testing.assert_allclose(measured.G_bar, np.exp(-mesh.geodesics() / 20), atol=1e-15)
    wanted = literal.affinity(measured.C_bar, measured.G, 0.4, 20, 0.3)
    np.testing.assert_allclose(measured.A, wanted, atol=1e-15)
    for other in ({"lam": 0.9}, {"r": 5}, {"threshold": 0.6}):
        settings = {"lam": 0.4, "r": 20, "threshold": 0.3, **other}
        anew = quick(motion, n_regions=4, **settings)
        cut = measured.with_(**other).segment(4, random_state=0, progress=False)
        np.testing.assert_array_equal(cut.labels, anew.labels)


def test_a_mesh_in_two_pieces_is_refused(rng):
    V = rng.normal(size=(6, 3))
    mesh = TriangleMesh(V, np.array([[0, 1, 2], [3, 4, 5]]))
    motion = MotionSequence(V + rng.normal(size=(5, 6, 3)), 30.0, mesh)
    with pytest.raises(ValueError, match="2 pieces"):
        quick(motion)


def test_a_motion_of_one_valid_frame_is_refused(rng):
    mesh, truth = quarters(6, 4)
    motion = patch_motion(mesh, truth, rng, n_frames=4)
    lost = dataclasses.replace(motion, valid=np.array([True, False, False, False]))
    with pytest.raises(ValueError, match="1 frame"):
        quick(lost)


# --- stability ------------------------------------------------------------------------------------


@pytest.mark.parametrize("over", ["frames", "seeds"])
def test_clear_patches_are_cut_the_same_whatever_is_drawn(rng, over):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    scores, labels = stability(motion, 4, over, n_draws=5, block=0.2, random_state=0)
    np.testing.assert_array_equal(scores, np.ones(5))
    np.testing.assert_array_equal(labels, np.tile(truth, (5, 1)))


def test_noise_alone_is_not_stable_over_frames_and_the_seed_settles_the_draws(rng):
    mesh = grid_mesh(12, 10, 8.0)
    motion = MotionSequence(mesh.vertices + rng.normal(size=(60, 120, 3)), 30.0, mesh)
    settings = {"n_draws": 4, "block": 0.1, "lam": 1.0, "threshold": 0.1}
    scores, labels = stability(motion, 5, **settings, random_state=1)
    assert scores.max() < 0.6
    again, _ = stability(motion, 5, **settings, random_state=1)
    np.testing.assert_array_equal(scores, again)
    assert len({x.tobytes() for x in labels}) == 4


def test_lost_frames_are_never_drawn(rng):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng)
    spoilt = motion.positions.copy()
    spoilt[::4] = np.nan
    lost = dataclasses.replace(motion, positions=spoilt, valid=np.arange(len(spoilt)) % 4 != 0)
    scores, _ = stability(lost, 4, n_draws=3, block=0.1, random_state=0)
    np.testing.assert_array_equal(scores, np.ones(3))


def test_stability_refuses_blocks_longer_than_the_motion_and_other_draws(rng):
    mesh, truth = quarters(6, 4)
    motion = patch_motion(mesh, truth, rng, n_frames=30)
    with pytest.raises(ValueError, match="block=2 s is 60 frames, but the motion has 30"):
        stability(motion, 2)
    with pytest.raises(ValueError, match="over='actors'"):
        stability(motion, 2, over="actors", block=0.1)
    with pytest.raises(ValueError, match="n_draws=0, but the number of draws must be 1 or more"):
        stability(motion, 2, block=0.1, n_draws=0)


def test_draws_are_runs_of_frames_that_follow_each_other(rng, monkeypatch):
    mesh, truth = quarters()
    motion = patch_motion(mesh, truth, rng, n_frames=40)
    seen, plain = [], segment_module.motion_correlation

    def watched(positions):
        seen.append(
            [np.flatnonzero((motion.positions == p).all(axis=(1, 2)))[0] for p in positions]
        )
        return plain(positions)

    monkeypatch.setattr(segment_module, "motion_correlation", watched)
    stability(motion, 4, n_draws=3, block=10 / motion.fps, random_state=0)
    drawn = seen[-3:]
    for frames in drawn:
        assert len(frames) == 40
        for run in np.reshape(frames, (4, 10)):
            np.testing.assert_array_equal(np.diff(run), 1)
    assert len({tuple(frames) for frames in drawn}) == 3


def test_a_motion_that_holds_still_is_said_and_one_too_short_refused(rng):
    mesh, labels = quarters()
    motion = patch_motion(mesh, labels, rng)
    same = dataclasses.replace(motion, positions=np.repeat(motion.positions[:1], 120, axis=0))
    with pytest.warns(UserWarning, match="motion holds still: all its 120 frames are alike"):
        quick(same, n_regions=4)
    valid = np.arange(120) == 5
    with pytest.raises(ValueError, match=r"motion has 1 frame\(s\) that are valid"):
        quick(dataclasses.replace(motion, valid=valid), n_regions=4)
