import literal_yu
import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation
from shapes import disk_mesh, grid_mesh, sphere_mesh

from facelab.geometry.binding import bind_to_samples, bind_to_surface
from facelab.geometry.deformation import LaplacianDeformer, laplacian_deform
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence


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
    np.testing.assert_array_equal(bind_to_samples(face, samples).carry(moved)[samples], moved)


def test_a_translation_of_all_control_vertices_is_carried_exactly(face):
    binding = bind_to_samples(face, spread(face))
    np.testing.assert_allclose(np.asarray(binding.weights.sum(axis=1)).ravel(), 1, atol=1e-12)
    shift = np.array([3.0, -50.0, 7.0])
    moved = binding.carry(np.tile(shift, (len(binding.samples), 1)))
    np.testing.assert_allclose(moved, np.tile(shift, (face.n_vertices, 1)), atol=1e-10)


def test_between_control_vertices_the_face_bends_as_little_as_it_can(face, rng):
    samples = spread(face)
    moved = rng.normal(size=(len(samples), 3))
    ours = bind_to_samples(face, samples, tolerance=0).carry(moved)
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
    full, thin = (bind_to_samples(face, samples, tolerance=t) for t in (0, 1e-3))
    # at most one weight of 1e-3 for each control vertex is dropped, and shared out again
    bound = 2e-3 * len(samples) * np.abs(moved).max()
    assert np.abs(full.carry(moved) - thin.carry(moved)).max() < bound
    assert thin.weights.nnz <= full.weights.nnz
    kept = np.abs(thin.weights.data)
    assert kept[kept > 0].min() > 1e-3 / 2  # rows are scaled after the cut


def test_what_is_carried_is_linear(face, rng):
    binding = bind_to_samples(face, spread(face))
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
        carried = bind_to_samples(mesh, samples).carry(field[samples])
        errors.append(np.abs(carried - field).max())
    assert errors[0] > errors[1] > errors[2]


def test_a_face_bound_to_all_its_vertices_is_its_control(face, rng):
    binding = bind_to_samples(face, np.arange(face.n_vertices))
    moved = rng.normal(size=(face.n_vertices, 3))
    np.testing.assert_array_equal(binding.carry(moved), moved)
    assert sp.issparse(binding.weights)


def test_the_handle_of_a_vertex_is_the_nearest_along_the_surface(face):
    samples = spread(face)
    binding = bind_to_samples(face, samples)
    G = face.geodesics(samples)
    at = G[binding.handle_of, np.arange(face.n_vertices)]
    np.testing.assert_allclose(at, G.min(axis=0), atol=1e-9)
    np.testing.assert_array_equal(binding.handle_of[samples], np.arange(len(samples)))


def parted(mesh, rng, n_frames=40):
    """Motion that no surface tells: both halves move apart along a seam."""
    left = mesh.vertices[:, 0] < mesh.vertices[:, 0].mean()
    x = np.where(left, 1.0, -1.0)[None, :, None] * rng.normal(size=(n_frames, 1, 3))
    return MotionSequence(mesh.vertices + x, 30.0, mesh)


def test_a_binding_learned_from_motion_follows_motion_it_has_not_seen(rng):
    mesh = grid_mesh(13, 10, 3.0)
    samples, motion, unseen = spread(mesh), parted(mesh, rng), parted(mesh, rng)
    x = unseen.positions - mesh.vertices
    errors = [
        np.sqrt(np.mean([np.sum((b.carry(d[samples]) - d) ** 2) / len(d) for d in x]))
        for b in (bind_to_samples(mesh, samples), bind_to_samples(mesh, samples, motion=motion))
    ]
    assert errors[1] < 0.3 * errors[0]


def test_a_learned_binding_is_the_least_squares_that_it_says(rng):
    mesh = grid_mesh(13, 10, 3.0)
    samples, motion, trust = spread(mesh), parted(mesh, rng), 4.0
    plain = bind_to_samples(mesh, samples)
    learned = bind_to_samples(mesh, samples, motion=motion, trust=trust)
    x = motion.positions - mesh.vertices
    strain = 0.05 * (mesh.vertices - mesh.vertices.mean(axis=0))
    start, found = plain.weights.toarray(), learned.weights.toarray()
    np.testing.assert_array_equal(found != 0, start != 0)
    for v in np.setdiff1d(np.arange(130), samples)[::17]:

        def cost(w, v=v):
            off = x[:, v] - np.einsum("k,fka->fa", w, x[:, samples])
            bent = strain[v] - w @ strain[samples]
            stray = w - start[v]
            return np.sum(off**2) / len(x) + bent @ bent + stray @ stray / trust

        near = np.flatnonzero(start[v])
        for _ in range(5):
            change = np.zeros(len(samples))
            change[near] = 1e-3 * rng.normal(size=len(near))
            change[near] -= change[near].mean()  # rows sum to one
            assert cost(found[v] + change) > cost(found[v])


def test_a_learned_binding_still_carries_control_vertices_and_shifts_exactly(face, rng):
    samples = spread(face)
    binding = bind_to_samples(face, samples, motion=parted(face, rng))
    moved = rng.normal(size=(len(samples), 3))
    np.testing.assert_allclose(binding.carry(moved)[samples], moved, atol=1e-12)
    shifted = binding.carry(np.tile([3.0, -50, 7], (len(samples), 1)))
    np.testing.assert_allclose(shifted, np.tile([3.0, -50, 7], (face.n_vertices, 1)), atol=1e-9)


@pytest.mark.real
def test_lips_and_lids_of_the_real_face_follow_better_when_learned(real_rig, real_takes):
    face = real_rig.neutral
    samples, _ = face.subsample(397)
    x = real_rig.animate(real_takes["alex_rom_3"][::60]).displacements().reshape(-1, 6706, 3)
    errors = []
    for motion in (None, real_rig.animate(real_takes["alex_rom_4"][::20])):
        binding = bind_to_samples(face, samples, motion=motion)
        off = [np.mean(np.sum((binding.carry(d[samples]) - d) ** 2, axis=1)) for d in x]
        errors.append(np.sqrt(np.mean(off)))
    assert errors[1] < 0.15 < 0.3 < errors[0]


def test_motion_of_another_mesh_teaches_no_binding(grid, rng):
    with pytest.raises(ValueError, match="motion has 130 vertices, but the mesh 30"):
        bind_to_samples(grid, [0, 5, 29], motion=parted(grid_mesh(13, 10), rng))
    with pytest.raises(ValueError, match="trust=0"):
        bind_to_samples(grid, [0, 5, 29], trust=0)


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
        bind_to_samples(grid, samples)


def test_a_face_in_two_pieces_cannot_be_bound():
    with pytest.raises(ValueError, match="2 pieces"):
        bind_to_samples(two_triangles(), [0, 3])


# -- Laplacian deformation --


@pytest.fixture
def anchored(bumpy, rng):
    anchors = rng.permutation(bumpy.n_vertices)[:9]
    positions = bumpy.vertices[anchors] + rng.normal(scale=4, size=(9, 3))
    return bumpy, anchors, positions


def test_laplacian_deformation_is_that_of_the_paper(anchored):
    mesh, anchors, positions = anchored
    L = literal_yu.laplacian(mesh.n_vertices, mesh.faces)
    for weight in (0.5, 3.0):
        V = literal_yu.deform(L, mesh.vertices, anchors, positions, weight)
        ours = laplacian_deform(mesh, anchors, positions, weight)
        np.testing.assert_allclose(ours, V, atol=1e-8)
    assert np.abs(laplacian_deform(mesh, anchors, positions) - mesh.vertices).max() > 1


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
def test_anchors_at_rest_move_nothing_and_a_shift_of_all_is_followed(anchored, weights):
    mesh, anchors, _ = anchored
    deformer = LaplacianDeformer(mesh, anchors, weights=weights)
    rest = mesh.vertices[anchors]
    np.testing.assert_allclose(deformer.deform(rest), mesh.vertices, atol=1e-8)
    moved = deformer.deform(rest + [3, -2, 9])
    np.testing.assert_allclose(moved, mesh.vertices + [3, -2, 9], atol=1e-8)


@pytest.mark.parametrize("weights", ["uniform", "cotangent"])
def test_heavier_anchors_are_followed_closer_and_bend_more(anchored, weights):
    mesh, anchors, positions = anchored
    L = mesh.laplacian(weights)
    miss, bend = [], []
    for weight in (0.1, 0.5, 2, 50):
        V = laplacian_deform(mesh, anchors, positions, weight, weights)
        miss.append(np.linalg.norm(V[anchors] - positions))
        bend.append(np.linalg.norm(L @ (V - mesh.vertices)))
    assert (np.diff(miss) < 0).all() and (np.diff(bend) > 0).all()
    assert miss[-1] < 0.01 * miss[0]


def test_a_factor_serves_any_number_of_pulls(anchored, rng):
    mesh, anchors, positions = anchored
    deformer = LaplacianDeformer(mesh, anchors)
    for _ in range(2):
        positions = positions + rng.normal(size=positions.shape)
        np.testing.assert_allclose(
            deformer.deform(positions), laplacian_deform(mesh, anchors, positions), atol=1e-10
        )


@pytest.mark.real
def test_an_expression_on_few_vertices_drives_the_whole_scanned_face(real_rig):
    face = real_rig.neutral
    samples, _ = face.subsample(397)
    S = real_rig.shape({"jawOpen": 0.6, "mouthSmile_L": 0.8, "browOuterUp_R": 1})
    at_rest = np.sqrt(((S - face.vertices) ** 2).sum(axis=1).mean())
    for weights in ("uniform", "cotangent"):
        V = laplacian_deform(face, samples, S[samples], weights=weights)
        assert np.sqrt(((V - S) ** 2).sum(axis=1).mean()) < 0.1 * at_rest


def test_anchors_that_cannot_hold_the_mesh_are_refused(grid):
    V = grid.vertices
    with pytest.raises(ValueError, match=r"anchors holds 30.*0 to 29"):
        laplacian_deform(grid, [30], V[:1])
    with pytest.raises(ValueError, match="more than once"):
        laplacian_deform(grid, [3, 3], V[:2])
    with pytest.raises(ValueError, match=r"1 piece\(s\).*vertex 3"):
        laplacian_deform(two_triangles(), [0], V[:1])
    with pytest.raises(ValueError, match="anchor_weight=0"):
        laplacian_deform(grid, [0], V[:1], anchor_weight=0)
    with pytest.raises(ValueError, match=r"positions has shape \(2, 3\)"):
        laplacian_deform(grid, [0], V[:2])
    with pytest.raises(ValueError, match="weights='none'"):
        laplacian_deform(grid, [0], V[:1], weights="none")


# -- One surface riding on another --


def test_bound_points_stay_at_rest_and_follow_rigid_motion_exactly(sphere, rng):
    P = rng.normal(size=(300, 3))
    P *= (50 + rng.normal(scale=3, size=(300, 1))) / np.linalg.norm(P, axis=1, keepdims=True)
    binding = bind_to_surface(sphere, P)
    np.testing.assert_allclose(binding.carry(sphere.vertices), P, atol=1e-12)
    R = Rotation.from_rotvec([0.4, -1, 2]).as_matrix()
    moved = binding.carry(sphere.vertices @ R.T + [1, 2, 3])
    np.testing.assert_allclose(moved, P @ R.T + [1, 2, 3], atol=1e-10)


def test_detail_rides_on_the_surface_and_turns_with_it():
    flat = grid_mesh(9, 9, 5.0)
    detail = grid_mesh(15, 15, 2.5).vertices + [2.0, 2.0, 0]
    detail[:, 2] += np.sin(detail[:, 0])
    binding = bind_to_surface(flat, TriangleMesh(detail, grid_mesh(15, 15).faces))
    np.testing.assert_allclose(binding.offsets[:, 2], detail[:, 2], atol=1e-12)
    np.testing.assert_allclose(binding.offsets[:, :2], 0, atol=1e-12)
    x, y, _ = flat.vertices.T
    rolled = np.stack([30 * np.sin(x / 30), y, 30 * np.cos(x / 30)], axis=1)
    moved = binding.carry(rolled)
    height = np.hypot(moved[:, 0], moved[:, 2]) - 30
    assert np.abs(height - detail[:, 2]).max() < 0.15  # chords of 5 mm lie 0.1 mm below the arc


def test_points_that_are_not_points_are_refused(sphere):
    with pytest.raises(ValueError, match=r"points has shape \(4, 2\)"):
        bind_to_surface(sphere, np.zeros((4, 2)))
    with pytest.raises(ValueError, match="points holds 1"):
        bind_to_surface(sphere, [[0, 0, np.nan]])
    with pytest.raises(ValueError, match="vertices has shape"):
        bind_to_surface(sphere, [[0, 0, 50.0]]).carry(np.zeros((3, 3)))
