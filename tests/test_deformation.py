import numpy as np
import pytest
import scipy.sparse as sp
from shapes import disk_mesh, grid_mesh, sphere_mesh

from facelab.deformation import bind
from facelab.mesh import TriangleMesh


def spread(mesh, step=7):
    return np.arange(0, mesh.n_vertices, step)


@pytest.fixture(params=["grid", "ring", "sphere"])
def face(request):
    return {
        "grid": lambda: grid_mesh(13, 10, 3.0),
        "ring": lambda: disk_mesh(8, 24, inner=10.0, outer=40.0),
        "sphere": lambda: sphere_mesh(2, radius=50.0),
    }[request.param]()


def test_control_vertices_are_followed_exactly(face, rng):
    samples = rng.permutation(spread(face))
    moved = rng.normal(size=(len(samples), 3))
    np.testing.assert_array_equal(bind(face, samples).carry(moved)[samples], moved)


def test_a_translation_of_all_control_vertices_is_carried_exactly(face):
    binding = bind(face, spread(face))
    np.testing.assert_allclose(np.asarray(binding.weights.sum(axis=1)).ravel(), 1, atol=1e-12)
    shift = np.array([3.0, -50.0, 7.0])
    moved = binding.carry(np.tile(shift, (len(binding.samples), 1)))
    np.testing.assert_allclose(moved, np.tile(shift, (face.n_vertices, 1)), atol=1e-10)


def test_between_control_vertices_the_face_bends_as_little_as_it_can(face, rng):
    samples = spread(face)
    moved = rng.normal(size=(len(samples), 3))
    ours = bind(face, samples, tolerance=0).carry(moved)
    # a second road: least squares of the Laplacian by area, the control vertices taken over
    L = face.laplacian("cotangent", normalised=False).toarray()
    area = np.zeros(face.n_vertices)
    for corners, size in zip(face.faces, face.face_areas, strict=True):
        area[corners] += size / 3
    R = L / np.sqrt(area)[:, None]
    free = np.setdiff1d(np.arange(face.n_vertices), samples)
    theirs = np.linalg.lstsq(R[:, free], -R[:, samples] @ moved)[0]
    # normal equations square the condition of least squares, here near 1e3
    np.testing.assert_allclose(ours[free], theirs, atol=1e-7)


def test_dropping_small_weights_moves_the_face_by_little(face, rng):
    samples = spread(face)
    moved = rng.normal(size=(len(samples), 3))
    full, thin = (bind(face, samples, tolerance=t) for t in (0, 1e-3))
    # at most one weight of 1e-3 for each control vertex is dropped, and shared out again
    bound = 2e-3 * len(samples) * np.abs(moved).max()
    assert np.abs(full.carry(moved) - thin.carry(moved)).max() < bound
    assert thin.weights.nnz <= full.weights.nnz
    kept = np.abs(thin.weights.data)
    assert kept[kept > 0].min() > 1e-3 / 2  # rows are scaled after the cut


def test_what_is_carried_is_linear(face, rng):
    binding = bind(face, spread(face))
    a, b = rng.normal(size=(2, len(binding.samples), 4))
    np.testing.assert_allclose(
        binding.carry(2 * a - b), 2 * binding.carry(a) - binding.carry(b), atol=1e-12
    )


def test_a_denser_control_follows_a_smooth_field_more_closely():
    mesh = grid_mesh(25, 25, 2.0)
    field = np.sin(mesh.vertices / 10)
    errors = []
    for step in (8, 4, 2):
        row, column = np.divmod(np.arange(mesh.n_vertices), 25)
        samples = np.flatnonzero((row % step == 0) & (column % step == 0))
        carried = bind(mesh, samples).carry(field[samples])
        errors.append(np.abs(carried - field).max())
    assert errors[0] > errors[1] > errors[2]


def test_a_face_bound_to_all_its_vertices_is_its_control(face, rng):
    binding = bind(face, np.arange(face.n_vertices))
    moved = rng.normal(size=(face.n_vertices, 3))
    np.testing.assert_array_equal(binding.carry(moved), moved)
    assert sp.issparse(binding.weights)


def test_the_handle_of_a_vertex_is_the_nearest_along_the_surface(face):
    samples = spread(face)
    binding = bind(face, samples)
    G = face.geodesics(samples)
    at = G[binding.handle_of, np.arange(face.n_vertices)]
    np.testing.assert_allclose(at, G.min(axis=0), atol=1e-9)
    np.testing.assert_array_equal(binding.handle_of[samples], np.arange(len(samples)))


def two_triangles():
    return TriangleMesh(np.arange(18.0).reshape(6, 3) ** 2, np.array([[0, 1, 2], [3, 4, 5]]))


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        ([], "list of vertex indices"),
        ([[0, 1], [2, 3]], "list of vertex indices"),
        ([0.0, 1.0], "list of vertex indices"),
        ([0, 30], "0 to 30, the mesh to 29"),
        ([-1, 3], "-1 to 3"),
        ([4, 7, 4], "twice"),
    ],
)
def test_samples_that_are_no_control_vertices_are_refused(grid, samples, message):
    with pytest.raises(ValueError, match=message):
        bind(grid, samples)


def test_a_face_in_two_pieces_cannot_be_bound():
    with pytest.raises(ValueError, match="2 pieces"):
        bind(two_triangles(), [0, 3])
