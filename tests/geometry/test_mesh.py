import itertools

import numpy as np
import pytest
from shapes import disk_mesh, finger_mesh, grid_mesh, sphere_mesh, tetrahedron

from facelab.geometry.mesh import MULTI_PIE, TriangleMesh, vertex_normals

V3 = np.eye(3)
F1 = np.array([[0, 1, 2]])


def faces_of_edges(faces):
    """Number of faces at each undirected edge, counted one by one."""
    found = {}
    for a, b, c in np.asarray(faces).tolist():
        for edge in ((a, b), (b, c), (c, a)):
            found.setdefault(tuple(sorted(edge)), []).append(edge)
    return found


def euler_characteristic(mesh):
    return mesh.n_vertices - len(faces_of_edges(mesh.faces)) + len(mesh.faces)


# --- what a mesh is -------------------------------------------------------------------------------


def test_a_tetrahedron_has_every_pair_of_corners_as_an_edge():
    edges = tetrahedron().edges
    assert sorted(map(tuple, edges.tolist())) == list(itertools.combinations(range(4), 2))


def test_edges_of_a_grid_are_its_rows_columns_and_diagonals(grid):
    expected = set()
    for row, column in itertools.product(range(5), range(6)):
        here = row * 6 + column
        expected |= {(here, here + 1)} if column < 5 else set()
        expected |= {(here, here + 6)} if row < 4 else set()
        expected |= {(here, here + 7)} if column < 5 and row < 4 else set()
    assert {tuple(e) for e in grid.edges.tolist()} == expected
    assert len(grid.edges) == len(expected)


def test_adjacency_holds_the_length_of_every_edge_in_both_directions(bumpy):
    A = bumpy.adjacency.toarray()
    expected = np.zeros_like(A)
    for a, b in faces_of_edges(bumpy.faces):
        expected[a, b] = expected[b, a] = np.linalg.norm(bumpy.vertices[a] - bumpy.vertices[b])
    np.testing.assert_allclose(A, expected, atol=1e-12)  # rounding of lengths near 10


def test_two_vertices_in_one_place_are_still_neighbours():
    V = np.array([[0, 0, 0], [0, 0, 0], [1, 0, 0]], dtype=float)
    mesh = TriangleMesh(V, F1)
    assert mesh.adjacency.nnz == 6
    assert np.isfinite(mesh.geodesics()).all()


def test_face_areas_follow_herons_formula(bumpy):
    V = bumpy.vertices
    for area, (i, j, k) in zip(bumpy.face_areas, bumpy.faces, strict=True):
        a, b, c = (np.linalg.norm(V[p] - V[q]) for p, q in ((i, j), (j, k), (k, i)))
        s = (a + b + c) / 2
        heron = np.sqrt(s * (s - a) * (s - b) * (s - c))
        assert area == pytest.approx(heron, rel=1e-9)


def test_a_mesh_does_not_change_when_the_arrays_it_came_from_do():
    V, F = V3.copy(), F1.copy()
    mesh = TriangleMesh(V, F)
    V[0], F[0] = 99.0, 0
    np.testing.assert_array_equal(mesh.vertices, V3)
    np.testing.assert_array_equal(mesh.faces, F1)


@pytest.mark.parametrize("name", ["vertices", "faces"])
def test_arrays_of_a_mesh_refuse_to_be_written(name):
    with pytest.raises(ValueError, match="read-only"):
        getattr(TriangleMesh(V3, F1), name)[0] = 0


def test_a_moved_mesh_keeps_faces_and_landmarks_and_measures_anew(bumpy):
    _ = bumpy.edges, bumpy.adjacency, bumpy.normals
    moved = bumpy.with_vertices(bumpy.vertices * [2, 3, 4])
    fresh = TriangleMesh(bumpy.vertices * [2, 3, 4], bumpy.faces, bumpy.landmarks)
    assert moved.landmarks == bumpy.landmarks
    np.testing.assert_array_equal(moved.edges, fresh.edges)
    np.testing.assert_array_equal(moved.adjacency.toarray(), fresh.adjacency.toarray())
    np.testing.assert_array_equal(moved.normals, fresh.normals)
    np.testing.assert_array_equal(moved.face_areas, fresh.face_areas)


def test_the_68_landmarks_have_68_names_with_left_and_right_in_balance():
    assert len(MULTI_PIE) == len(set(MULTI_PIE)) == 68
    other = {"left": "right", "right": "left"}
    mirrored = {"_".join(other.get(word, word) for word in n.split("_")) for n in MULTI_PIE}
    assert mirrored == set(MULTI_PIE)
    # Multi-PIE: 17 of the jaw, 10 of the brows, 9 of the nose, 12 of the eyes, 20 of the mouth
    parts = [n.split("_")[0] for n in MULTI_PIE]
    assert parts[:17] == ["jaw"] * 8 + ["chin"] + ["jaw"] * 8
    assert parts[17:27] == ["brow"] * 10
    assert all(n.startswith(("nose", "nostril")) for n in MULTI_PIE[27:36])
    assert parts[36:48] == ["eye"] * 12
    assert set(parts[48:]) == {"mouth", "lip"}
    assert (MULTI_PIE[8], MULTI_PIE[30]) == ("chin", "nose_tip")
    assert (MULTI_PIE[48], MULTI_PIE[54]) == ("mouth_corner_right", "mouth_corner_left")


@pytest.mark.parametrize(
    "vertices, faces, landmarks, words",
    [
        (np.zeros((3, 2)), F1, {}, r"vertices has shape \(3, 2\)"),
        (np.zeros(9), F1, {}, r"vertices has shape \(9,\)"),
        (np.empty((0, 3)), F1, {}, "vertices is empty"),
        ([[0, 0, 0], [0, np.nan, 0], [1, 0, 0]], F1, {}, r"NaN or infinite.*\(1, 1\)"),
        ([[0, 0, 0], [0, 1, 0], [np.inf, 0, 0]], F1, {}, r"NaN or infinite.*\(2, 0\)"),
        (V3, np.empty((0, 3), int), {}, "faces is empty"),
        (V3, [[0, 1, 2, 0]], {}, r"faces has shape \(1, 4\)"),
        (V3, [0, 1, 2], {}, r"faces has shape \(3,\)"),
        (V3, [[0.0, 1.0, 2.0]], {}, "type float64"),
        (V3, [[0, 1, 2], [0, 1, 3]], {}, r"faces\[1\] = \[0, 1, 3\].*0 to 2"),
        (V3, [[-1, 1, 2]], {}, r"faces\[0\] = \[-1, 1, 2\].*does not exist"),
        (V3, [[0, 1, 2], [2, 0, 2]], {}, r"faces\[1\] = \[2, 0, 2\] uses a vertex twice"),
        (V3, [[0, 0, 2]], {}, "uses a vertex twice"),
        (V3, [[0, 2, 2]], {}, "uses a vertex twice"),
        (V3, F1, {"chin": 3}, "landmarks.'chin'.=3.*0 to 2"),
        (V3, F1, {"chin": -1}, "landmarks.'chin'.=-1"),
    ],
)
def test_a_mesh_that_is_none_is_refused(vertices, faces, landmarks, words):
    with pytest.raises(ValueError, match=words):
        TriangleMesh(vertices, faces, landmarks)


def test_a_landmark_between_two_vertices_is_refused():
    with pytest.raises(TypeError, match=r"landmarks.'chin'.=1.5 is not an integer"):
        TriangleMesh(V3, F1, {"chin": 1.5})


def test_moving_a_mesh_needs_a_place_for_every_vertex(grid):
    with pytest.raises(ValueError, match=r"shape \(4, 3\), but needs shape \(30, 3\)"):
        grid.with_vertices(grid.vertices[:4])


# --- normals --------------------------------------------------------------------------------------


def test_normals_are_the_area_weighted_mean_of_the_faces_around(bumpy):
    total = np.zeros_like(bumpy.vertices)
    for i, j, k in bumpy.faces:
        a, b, c = bumpy.vertices[[i, j, k]]
        total[[i, j, k]] += np.cross(b - a, c - a)  # twice the area long
    expected = total / np.linalg.norm(total, axis=1, keepdims=True)
    np.testing.assert_allclose(bumpy.normals, expected, atol=1e-12)  # rounding of unit vectors


def test_a_flat_grid_faces_up_everywhere(grid):
    np.testing.assert_allclose(grid.normals, np.tile([0, 0, 1], (30, 1)), atol=1e-15)


def test_normals_of_a_sphere_point_away_from_its_centre():
    mesh = sphere_mesh(3, radius=50.0)
    outwards = mesh.vertices / 50.0
    # neighbouring edges span about 8 degrees; the mean of the faces around is off by far less
    assert np.degrees(np.arccos((mesh.normals * outwards).sum(axis=1).clip(-1, 1))).max() < 1


def test_normals_turn_with_the_mesh(bumpy, rng):
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    turned = bumpy.with_vertices(bumpy.vertices @ Q.T + [5, -3, 100])
    np.testing.assert_allclose(turned.normals, bumpy.normals @ Q.T, atol=1e-12)


def test_a_vertex_without_faces_has_no_normal():
    V = np.vstack([V3, [5, 5, 5]])
    np.testing.assert_array_equal(vertex_normals(V, F1)[3], 0)


# --- boundary -------------------------------------------------------------------------------------


def loop_edges(loop):
    return set(zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True))


@pytest.mark.parametrize(
    "mesh, lengths",
    [
        (disk_mesh(4, 12), [12]),
        (disk_mesh(3, 16, inner=0.5), [16, 16]),
        (grid_mesh(6, 5), [18]),
        (tetrahedron(), []),
        (sphere_mesh(2), []),
    ],
    ids=["disk", "ring", "grid", "tetrahedron", "sphere"],
)
def test_boundary_loops_are_closed_and_run_as_their_faces_do(mesh, lengths):
    assert [len(loop) for loop in mesh.boundary_loops] == lengths
    once = {pairs[0] for pairs in faces_of_edges(mesh.faces).values() if len(pairs) == 1}
    assert set().union(*map(loop_edges, mesh.boundary_loops)) == once
    for loop in mesh.boundary_loops:
        assert len(set(loop.tolist())) == len(loop)


def test_the_outline_of_a_disk_runs_counter_clockwise_and_its_hole_clockwise(holed_disk):
    turns = []
    for loop in holed_disk.boundary_loops:
        x, y = holed_disk.vertices[loop, :2].T
        turns.append((np.hypot(x, y).mean(), 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()))
    (_, hole), (_, outline) = sorted(turns)
    # area of a regular polygon of 48 corners
    expected = 24 * np.sin(2 * np.pi / 48)
    assert outline == pytest.approx(40**2 * expected)
    assert hole == pytest.approx(-(10**2) * expected)


def test_the_longest_boundary_comes_first():
    ring = disk_mesh(6, 16, inner=0.5)
    holed = ring.submesh(np.arange(ring.n_vertices) != 52)  # a vertex amidst six triangles
    assert [len(loop) for loop in holed.boundary_loops] == [16, 16, 6]


# --- parts ----------------------------------------------------------------------------------------


def test_a_part_keeps_the_order_given_its_faces_and_its_landmarks(bumpy):
    keep = np.array([17, 10, 16, 9, 18, 11, 30])
    part = bumpy.submesh(keep)
    np.testing.assert_array_equal(part.vertices, bumpy.vertices[keep])
    whole = [f for f in bumpy.faces.tolist() if set(f) <= set(keep.tolist())]
    assert whole
    np.testing.assert_array_equal(keep[part.faces], whole)
    assert part.landmarks == {"nose_tip": 0}


def test_a_mask_and_its_indices_cut_the_same_part(bumpy):
    mask = bumpy.vertices[:, 0] < 30
    by_mask, by_index = bumpy.submesh(mask), bumpy.submesh(np.flatnonzero(mask))
    np.testing.assert_array_equal(by_mask.vertices, by_index.vertices)
    np.testing.assert_array_equal(by_mask.faces, by_index.faces)


@pytest.mark.parametrize(
    "keep, error, words",
    [
        ([0, 1, 99], ValueError, "keep holds 99, but there are 30 vertices: 0 to 29"),
        ([-1, 0, 1], ValueError, "keep holds -1"),
        ([0, 1, 7, 7], ValueError, "keep holds 7 more than once"),
        (np.ones(12, bool), ValueError, r"mask needs one bool for each of the 30"),
        ([0.0, 1.0, 7.0], TypeError, "type float64; give a list of integers"),
        ([0, 29], ValueError, "faces is empty"),
        ([], ValueError, "vertices is empty"),
    ],
)
def test_a_part_that_cannot_be_is_refused(grid, keep, error, words):
    with pytest.raises(error, match=words):
        grid.submesh(keep)


def two_pieces():
    a, b = grid_mesh(3, 3), grid_mesh(2, 2)
    beside = b.vertices + np.array([9, 0, 0])
    return TriangleMesh(np.vstack([a.vertices, beside]), np.vstack([a.faces, b.faces + 9]))


def test_pieces_name_what_hangs_together():
    pieces = two_pieces().pieces
    assert len(set(pieces[:9])) == len(set(pieces[9:])) == 1
    assert pieces[0] != pieces[9]


@pytest.mark.parametrize(
    "measure",
    [TriangleMesh.geodesics, lambda m: m.nearest_of([0, 9]), lambda m: m.subsample(5)],
    ids=["geodesics", "nearest_of", "subsample"],
)
def test_a_mesh_in_pieces_is_refused_with_their_sizes(measure):
    with pytest.raises(ValueError, match="2 pieces of 9, 4 vertices"):
        measure(two_pieces())


def test_the_remedy_named_for_a_mesh_in_pieces_works():
    mesh = two_pieces()
    assert mesh.submesh(mesh.pieces == mesh.pieces[9]).geodesics().shape == (4, 4)


# --- distances ------------------------------------------------------------------------------------


def test_geodesics_are_shortest_paths_along_edges_as_floyd_and_warshall_find_them(bumpy):
    n = bumpy.n_vertices
    D = np.where(np.eye(n, dtype=bool), 0.0, np.inf)
    for a, b in faces_of_edges(bumpy.faces):
        D[a, b] = D[b, a] = np.linalg.norm(bumpy.vertices[a] - bumpy.vertices[b])
    for k in range(n):
        D = np.minimum(D, D[:, [k]] + D[[k]])
    np.testing.assert_allclose(bumpy.geodesics(), D, atol=1e-10)  # sums of about ten lengths


def test_geodesics_on_a_grid_go_along_diagonals_where_there_are_any():
    G = grid_mesh(5, 5, spacing=2.0).geodesics()
    for (r, c), (s, d) in itertools.product(itertools.product(range(5), repeat=2), repeat=2):
        down, right = s - r, d - c
        if down * right > 0:  # the diagonals run that way
            steps = min(abs(down), abs(right)) * 2**0.5 + abs(abs(down) - abs(right))
        else:
            steps = abs(down) + abs(right)
        assert G[5 * r + c, 5 * s + d] == pytest.approx(2 * steps)


def test_geodesics_from_some_vertices_are_rows_of_the_whole(bumpy):
    np.testing.assert_allclose(bumpy.geodesics([5, 2, 9]), bumpy.geodesics()[[5, 2, 9]])
    np.testing.assert_allclose(bumpy.geodesics(7), bumpy.geodesics()[7])


@pytest.mark.parametrize("sources", [[0, 99], [-1], 99])
def test_geodesics_from_no_vertex_are_refused(grid, sources):
    with pytest.raises(ValueError, match=r"sources.*there are 30 vertices: 0 to 29"):
        grid.geodesics(sources)


def test_nearest_of_names_the_sample_with_the_shortest_way(bumpy):
    samples = [31, 4, 12, 40]
    G = bumpy.geodesics()[samples]
    nearest = bumpy.nearest_of(samples)
    np.testing.assert_allclose(G[nearest, np.arange(bumpy.n_vertices)], G.min(axis=0))
    np.testing.assert_array_equal(nearest[samples], range(4))


# --- Laplacian ------------------------------------------------------------------------------------


def literal_laplacian(mesh, weights, normalised):
    """Yu and Liu's Eq. 11 entry by entry."""
    n, V = mesh.n_vertices, mesh.vertices
    W = np.zeros((n, n))
    for i, j, k in mesh.faces.tolist():
        for a, b, opposite in ((i, j, k), (j, k, i), (k, i, j)):
            if weights == "uniform":
                W[a, b] = W[b, a] = 1
            else:
                u, v = V[a] - V[opposite], V[b] - V[opposite]
                angle = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
                W[a, b] += 0.5 / np.tan(angle)
                W[b, a] += 0.5 / np.tan(angle)
    L = np.zeros((n, n))
    for i in range(n):
        total = W[i].sum()
        for j in range(n):
            entry = total if i == j else -W[i, j]
            L[i, j] = entry / total if normalised else entry
    return L


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
@pytest.mark.parametrize("normalised", [True, False])
def test_the_laplacian_is_equation_11(bumpy, weights, normalised):
    expected = literal_laplacian(bumpy, weights, normalised)
    L = bumpy.laplacian(weights, normalised).toarray()
    np.testing.assert_allclose(L, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
def test_the_normalised_laplacian_has_ones_on_its_diagonal_and_no_row_sum(bumpy, weights):
    L = bumpy.laplacian(weights).toarray()
    np.testing.assert_allclose(np.diag(L), 1, atol=1e-14)
    np.testing.assert_allclose(L.sum(axis=1), 0, atol=1e-13)  # rounding of sums near 1


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
def test_the_plain_laplacian_is_symmetric_and_a_shift_of_the_face_leaves_it_at_zero(bumpy, weights):
    L = bumpy.laplacian(weights, normalised=False).toarray()
    np.testing.assert_allclose(L, L.T, atol=1e-13)
    np.testing.assert_allclose(L @ np.ones(len(L)), 0, atol=1e-12)
    assert np.linalg.eigvalsh(L)[:2] == pytest.approx([0, np.linalg.eigvalsh(L)[1]], abs=1e-12)
    assert np.linalg.eigvalsh(L)[1] > 1e-3  # one piece: constants are all that vanishes


def test_cotangents_reproduce_every_linear_function_inside_a_flat_mesh(rng):
    flat = grid_mesh(7, 6, spacing=10.0)
    jitter = np.column_stack([rng.uniform(-2, 2, size=(flat.n_vertices, 2)), np.zeros(42)])
    mesh = flat.with_vertices(flat.vertices + jitter)
    inside = np.setdiff1d(np.arange(42), np.concatenate(mesh.boundary_loops))
    linear = mesh.vertices @ [0.3, -2.0, 0.0] + 7
    np.testing.assert_allclose((mesh.laplacian("cotangent") @ linear)[inside], 0, atol=1e-11)
    assert np.abs((mesh.laplacian("uniform") @ linear)[inside]).max() > 0.1  # uniform ones do not


def test_the_cotangent_laplacian_does_not_see_size_but_the_shape_of_triangles(bumpy):
    larger = bumpy.with_vertices(bumpy.vertices * 25.4)
    np.testing.assert_allclose(
        larger.laplacian("cotangent").toarray(), bumpy.laplacian("cotangent").toarray(), atol=1e-11
    )


def test_unknown_laplacian_weights_are_refused(grid):
    with pytest.raises(ValueError, match=r"weights='cot' is unknown; .*'uniform', 'cotangent'"):
        grid.laplacian("cot")


# --- subsampling ----------------------------------------------------------------------------------


def check_subsample(mesh, n_vertices, keep=()):
    """All that a subsampled mesh promises, whatever it came from."""
    indices, small = mesh.subsample(n_vertices, keep)
    assert indices.shape == (n_vertices,)
    assert small.n_vertices == n_vertices
    assert (np.diff(indices) > 0).all(), "indices are not ascending and unique"
    assert set(keep) <= set(indices.tolist())
    np.testing.assert_array_equal(small.vertices, mesh.vertices[indices])
    assert np.bincount(small.faces.ravel(), minlength=n_vertices).min() >= 2
    for edge, directions in faces_of_edges(small.faces).items():
        assert len(directions) == len(set(directions)) <= 2, f"edge {edge} is not a surface's"
    small.check_connected()
    assert len(small.boundary_loops) == len(mesh.boundary_loops)
    assert euler_characteristic(small) == euler_characteristic(mesh)
    return indices, small


def spacing_to_nearest(points):
    D = np.linalg.norm(points[:, None] - points, axis=2)
    np.fill_diagonal(D, np.inf)
    return D.min(axis=1)


@pytest.mark.parametrize("n_vertices", [20, 60, 150, 300])
def test_a_disk_with_a_hole_stays_one_at_every_density(holed_disk, n_vertices):
    indices, small = check_subsample(holed_disk, n_vertices, keep=[200, 17])
    np.testing.assert_array_equal(np.sign(small.normals[:, 2]), 1)
    outline = np.concatenate(holed_disk.boundary_loops)
    assert set(indices[np.concatenate(small.boundary_loops)].tolist()) >= (
        set(indices.tolist()) & set(outline.tolist())
    )


@pytest.mark.parametrize("n_vertices", [20, 60, 150])
def test_an_opening_far_smaller_than_the_samples_are_apart_stays_open(n_vertices):
    check_subsample(disk_mesh(12, 24, inner=1.0, outer=40.0), n_vertices)


@pytest.mark.parametrize("n_vertices", [30, 55, 100, 150])
def test_cells_that_meet_on_both_sides_of_a_thin_tube_do_not_tear_the_surface(n_vertices):
    check_subsample(finger_mesh(), n_vertices)


@pytest.mark.parametrize("n_vertices", [4, 12, 60, 200, 642])
def test_a_sphere_stays_a_closed_sphere_facing_outwards(n_vertices):
    mesh = sphere_mesh(3, radius=50.0)
    _, small = check_subsample(mesh, n_vertices)
    assert small.boundary_loops == []
    assert ((small.normals * small.vertices).sum(axis=1) > 0).all()


@pytest.mark.parametrize("n_vertices", [40, 120])
def test_samples_of_a_sphere_are_spread_evenly(n_vertices):
    mesh = sphere_mesh(4, radius=50.0)
    indices, _ = check_subsample(mesh, n_vertices)
    near = spacing_to_nearest(mesh.vertices[indices])
    # Drawn at random the spacing would vary by 0.52 of its mean (a Rayleigh distribution) and its
    # extremes by a factor of more than 10; a hexagonal lattice has the widest spacing there is.
    widest = np.sqrt(4 * np.pi * 50**2 / n_vertices * 2 / np.sqrt(3))
    assert near.std() / near.mean() < 0.2
    assert near.max() / near.min() < 2.5
    assert near.mean() > 0.7 * widest


def test_a_mesh_sampled_at_all_its_vertices_is_itself(sphere):
    indices, small = check_subsample(sphere, sphere.n_vertices)
    np.testing.assert_array_equal(indices, np.arange(sphere.n_vertices))

    def canonical(faces):
        return {tuple(np.roll(f, -np.argmin(f)).tolist()) for f in faces}

    assert canonical(small.faces) == canonical(sphere.faces)


def test_landmarks_that_are_kept_keep_their_names():
    flat = grid_mesh(15, 15, spacing=5.0)
    mesh = TriangleMesh(flat.vertices, flat.faces, {"nose_tip": 112, "chin": 7, "other": 113})
    indices, small = check_subsample(mesh, 30, keep=[112, 7])
    assert {indices[i] for i in (small.landmarks["nose_tip"], small.landmarks["chin"])} == {112, 7}
    assert indices[small.landmarks["nose_tip"]] == 112
    assert ("other" in small.landmarks) == (113 in indices)


def test_the_same_question_has_the_same_answer(holed_disk):
    (first, a), (second, b) = holed_disk.subsample(80), holed_disk.subsample(80)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(a.faces, b.faces)


@pytest.mark.parametrize(
    "n_vertices, keep, error, words",
    [
        (3, (), ValueError, "n_vertices=3, but this mesh allows 4 to 624"),
        (625, (), ValueError, "n_vertices=625, but this mesh allows 4 to 624"),
        (60.0, (), TypeError, "n_vertices=60.0 is not an integer"),
        (6, (), ValueError, "n_vertices=6 is too few"),
        (20, range(21), ValueError, "keep names 21 vertices, but only n_vertices=20"),
        (60, [624], ValueError, "keep holds 624, but there are 624 vertices"),
        (60, [-1], ValueError, "keep holds -1"),
    ],
)
def test_a_number_of_samples_that_cannot_be_is_refused(holed_disk, n_vertices, keep, error, words):
    with pytest.raises(error, match=words):
        holed_disk.subsample(n_vertices, keep)


def test_a_mesh_whose_corners_have_one_triangle_cannot_be_sampled_at_all_its_vertices(grid):
    with pytest.raises(ValueError, match=r"n_vertices=30 is too few .or too many."):
        grid.subsample(30)


def test_a_vertex_kept_twice_is_kept_once(holed_disk):
    check_subsample(holed_disk, 60, keep=[100, 100, 5])


# 150 and 200 once joined cells along two lines, which tore the surface
@pytest.mark.real
@pytest.mark.parametrize("n_vertices", [100, 150, 200, 397, 800])
def test_the_real_face_keeps_its_eyes_mouth_and_outline_open(real_rig, n_vertices):
    mesh = real_rig.neutral
    keep = [mesh.landmarks[n] for n in ("nose_tip", "mouth_corner_left", "mouth_corner_right")]
    indices, small = check_subsample(mesh, n_vertices, keep)
    assert len(small.boundary_loops) == 4
    # in pits and folds a coarse surface may face another way; for most of the face it may not
    agree = (small.normals * mesh.normals[indices]).sum(axis=1)
    assert np.median(agree) > 0.9


@pytest.mark.real
def test_397_samples_of_the_real_face_are_spread_evenly(real_rig):
    mesh = real_rig.neutral
    _, small = mesh.subsample(397)
    near = spacing_to_nearest(small.vertices)
    # at random it would be 0.52; lids and lips are sampled along themselves and lie close together
    assert near.std() / near.mean() < 0.3
