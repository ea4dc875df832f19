"""Heads as they are: seams, eyes, teeth, lashes, necks, other densities."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from shapes import grid_mesh, sphere_mesh

import facelab
from data_synth.action_units import actor_rig
from facelab.expression.riding import Rider, closed, skin_of
from facelab.expression.transfer import IntermediateSpace
from facelab.geometry.alignment import procrustes
from facelab.geometry.mesh import TriangleMesh

UNITS = ("AU27", "AU12L", "AU22", "AU18", "AU45L")


@pytest.fixture(scope="module")
def source():
    return actor_rig("M1", 4375).linear()


@pytest.fixture(scope="module")
def bare():
    return actor_rig("F1", 4375).neutral


@pytest.fixture(scope="module")
def head(bare):
    """A face with a bag behind the lips and a tube for skull and neck: the mesh and its rim."""
    V, F = bare.vertices, bare.faces
    lips = [bare.vertices[bare.landmarks[n]] for n in ("lip_upper", "lip_lower")]
    middle = np.mean(lips, axis=0)
    loops = bare.boundary_loops
    mouth = min(loops, key=lambda loop: np.linalg.norm(V[loop].mean(axis=0) - middle))
    rim = max(loops, key=lambda loop: np.ptp(V[loop], axis=0).sum())
    back = V[mouth].mean(axis=0) - [0, 0, 30]
    ring = mouth
    for k in range(1, 5):
        V, F, ring = ringed(V, F, ring, bare.vertices[mouth] * (1 - k / 5) + k / 5 * back)
    ring = rim
    for k in range(1, 9):
        V, F, ring = ringed(V, F, ring, bare.vertices[rim] + [0, -4 * k, -12 * k])
    return TriangleMesh(V, F, bare.landmarks), ring


def ringed(V, F, ring, places):
    """Vertices and triangles with one more ring of places behind a ring, and the new ring."""
    new = len(V) + np.arange(len(ring))
    a, b = np.roll(ring, -1), np.roll(new, -1)
    return np.vstack([V, places]), np.vstack([F, np.c_[ring, new, b], np.c_[ring, b, a]]), new


def joined(*meshes):
    V, F = [], []
    for mesh in meshes:
        F.append(mesh.faces + sum(map(len, V)))
        V.append(mesh.vertices)
    return TriangleMesh(np.vstack(V), np.vstack(F), meshes[0].landmarks)


def placed(mesh, middle):
    return mesh.with_vertices(mesh.vertices - mesh.vertices.mean(axis=0) + middle)


def middle_of(mesh, *names):
    return np.mean([mesh.vertices[mesh.landmarks[n]] for n in names], axis=0)


@pytest.fixture(scope="module")
def furnished(source, head):
    """A space whose target has eyes, teeth and lashes: the space, and where each stands."""
    mesh, _ = head
    eyes = [
        placed(
            sphere_mesh(3, 12.0), middle_of(mesh, f"eye_{s}_inner", f"eye_{s}_outer") - [0, 0, 11]
        )
        for s in ("left", "right")
    ]
    mouth = middle_of(mesh, "mouth_corner_left", "mouth_corner_right")
    block = sphere_mesh(2, 1.0)
    block = block.with_vertices(block.vertices * [20, 5, 4])
    teeth = [placed(block, mouth + [0, y, -10]) for y in (12, -12)]
    lid = mesh.landmarks["eye_left_upper_inner"]
    near = np.argsort(np.linalg.norm(mesh.vertices - mesh.vertices[lid], axis=1))[:40]
    lash = mesh.submesh(near)
    lash = TriangleMesh(lash.vertices + 1.5 * mesh.normals[near], lash.faces)
    parts = dict(skin=mesh, eye_left=eyes[0], eye_right=eyes[1], upper=teeth[0], lower=teeth[1])
    parts["lash"] = lash
    at, slices = 0, {}
    for name, part in parts.items():
        slices[name] = slice(at, at + part.n_vertices)
        at += part.n_vertices
    return IntermediateSpace(source, joined(*parts.values())), slices


def moved(space, weights):
    return space.to_target(space.rig.shape(weights)) - space.target.vertices


def test_a_seam_stays_closed_and_the_face_moves_as_without_it(source, head):
    mesh, _ = head
    left = mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > 0
    seam = np.intersect1d(mesh.faces[left], mesh.faces[~left])
    new = np.arange(mesh.n_vertices)
    new[seam] = mesh.n_vertices + np.arange(len(seam))
    F = mesh.faces.copy()
    F[left] = new[F[left]]
    cut = TriangleMesh(np.vstack([mesh.vertices, mesh.vertices[seam]]), F, mesh.landmarks)
    whole, split = IntermediateSpace(source, mesh), IntermediateSpace(source, cut)
    for unit in UNITS:
        d = moved(split, {unit: 1})
        assert np.abs(d[seam] - d[mesh.n_vertices :]).max() < 1e-3, unit
        np.testing.assert_allclose(d[: mesh.n_vertices], moved(whole, {unit: 1}), atol=1e-9)


@pytest.mark.parametrize("off", [0.0, 0.02])
def test_skull_and_face_in_two_pieces_stay_together(source, bare, head, off, rng):
    """They meet at an edge, where their normals differ, in coordinates of few digits."""
    mesh, ring = head
    back = (mesh.faces >= bare.n_vertices).any(axis=1)
    seam = np.intersect1d(mesh.faces[back], mesh.faces[~back])
    new = np.arange(mesh.n_vertices)
    new[seam] = mesh.n_vertices + np.arange(len(seam))
    F = np.where(back[:, None], new[mesh.faces], mesh.faces)
    apart = mesh.vertices[seam] + off * rng.uniform(-1, 1, (len(seam), 3))
    space = IntermediateSpace(
        source, TriangleMesh(np.vstack([mesh.vertices, apart]), F, mesh.landmarks)
    )
    d = moved(space, {"AU27": 1})
    np.testing.assert_allclose(d[seam], d[mesh.n_vertices :], atol=1e-9)
    np.testing.assert_allclose(d[ring], 0, atol=1e-9)


def test_a_face_in_metres_is_closed_as_one_in_millimetres(bare):
    small, _ = closed(bare.with_vertices(bare.vertices / 1000))
    assert small.n_vertices == bare.n_vertices


def soup_of(mesh):
    """The same surface in loose triangles, as an STL file has it."""
    first = {n: int(np.argmax(mesh.faces.ravel() == v)) for n, v in mesh.landmarks.items()}
    faces = np.arange(mesh.faces.size).reshape(-1, 3)
    return TriangleMesh(mesh.vertices[mesh.faces].reshape(-1, 3), faces, first)


def test_loose_triangles_move_as_the_surface_that_they_are(source, bare):
    space, first = IntermediateSpace(source, soup_of(bare)), np.unique(bare.faces, True)[1]
    for unit in UNITS:
        d = moved(space, {unit: 1})
        apart = np.linalg.norm(d - d[first][bare.faces.ravel()], axis=1)
        assert apart.max() < 1e-9, unit


@pytest.mark.parametrize("length, joined_there", [(4.0, True), (40.0, False)])
def test_loose_triangles_that_fold_back_are_joined_at_a_corner_and_not_along_lips(
    length, joined_there
):
    sheet = grid_mesh(5, 2, spacing=length / 4)
    other = sheet.vertices + [0, 0, 5.0] * (sheet.vertices[:, 1:2] > sheet.vertices[:, 1].min())
    F = np.vstack([sheet.faces, sheet.faces[:, ::-1] + 10])
    body, _ = closed(soup_of(TriangleMesh(np.vstack([sheet.vertices, other]), F)))
    assert body.pieces.max() == (0 if joined_there else 1)


def test_beyond_the_face_motion_fades_out_smoothly_to_the_rim(source, head):
    mesh, rim = head
    space = IntermediateSpace(source, mesh)
    for unit in UNITS:
        d = moved(space, {unit: 1})
        size = np.linalg.norm(d, axis=1)
        assert size[rim].max() < 1e-6, unit
        a, b = mesh.edges.T
        step = np.linalg.norm(d[a] - d[b], axis=1) / np.linalg.norm(
            mesh.vertices[a] - mesh.vertices[b], axis=1
        )
        beyond = (a >= len(mesh.vertices) - 8 * len(rim)) & (b >= len(mesh.vertices) - 8 * len(rim))
        assert step[beyond].max() < 1.0, unit  # no tear: 30 mm of jaw go in 60 mm of neck
    assert np.linalg.norm(moved(space, {"AU27": 1})[mesh.landmarks["chin"]]) > 20


def test_the_neutral_of_a_furnished_head_is_exact(furnished):
    space, _ = furnished
    np.testing.assert_allclose(moved(space, {}), 0, atol=1e-9)


def test_eyes_stay_whatever_the_lids_do(furnished):
    space, at = furnished
    for unit in UNITS:
        d = moved(space, {unit: 1})
        assert np.abs(d[at["eye_left"]]).max() < 1e-9 > np.abs(d[at["eye_right"]]).max(), unit


def test_lower_teeth_go_with_the_jaw_as_one_and_upper_stay(furnished):
    space, at = furnished
    V, d = space.target.vertices, moved(space, {"AU27": 1})
    assert np.abs(d[at["upper"]]).max() < 1e-9  # rounding of the turn into the head frame
    lower = V[at["lower"]]
    rigid = procrustes(lower, lower + d[at["lower"]])
    assert rigid.rms < 1e-6
    chin = np.linalg.norm(d[space.target.landmarks["chin"]])
    assert 0.6 * chin < np.linalg.norm(d[at["lower"]], axis=1).mean() < 1.2 * chin
    assert 5 < rigid.degrees < 40
    smile = np.linalg.norm(moved(space, {"AU12L": 1})[at["lower"]], axis=1).max()
    assert smile < 1.5


def test_lashes_go_with_the_lid_they_sit_on(furnished):
    space, at = furnished
    d = moved(space, {"AU45L": 1})
    lid = np.linalg.norm(d[space.target.landmarks["eye_left_upper_inner"]])
    lash = np.linalg.norm(d[at["lash"]], axis=1)
    assert lid > 3 and lash.max() > 0.8 * lid


def strip(row, offset):
    """Two rows of vertices: on the skin, and off it."""
    n, k = len(row), np.arange(len(row) - 1)
    faces = np.r_[np.c_[k, k + 1, k + n], np.c_[k + 1, k + n + 1, k + n]]
    return TriangleMesh(np.vstack([row, row + offset]), faces)


def test_lashes_that_stand_off_the_lid_go_with_their_roots(source, bare, head):
    mesh, _ = head
    names = [f"eye_left_{n}" for n in ("outer", "upper_outer", "upper_inner", "inner")]
    P, t = mesh.vertices[[mesh.landmarks[n] for n in names]], np.linspace(0, 3, 13)
    row = np.stack([np.interp(t, range(4), column) for column in P.T], axis=1) + [0, 0, 0.5]
    eye = sphere_mesh(3, 12.0)  # its front half, the rim on the skin
    eye = placed(eye.submesh(np.flatnonzero(eye.vertices[:, 2] > -1)), P.mean(axis=0))
    below = cKDTree(bare.vertices[:, :2]).query(eye.vertices[:, :2])[1]
    depth = eye.vertices[:, 2].min() - bare.vertices[below, 2]
    eye = eye.with_vertices(eye.vertices - depth[:, None] * [0, 0, 1])
    lash = strip(row, [0, 2, 6])
    space = IntermediateSpace(source, joined(mesh, lash, eye))
    d = moved(space, {"AU45L": 1})[mesh.n_vertices :]
    lid = np.linalg.norm(moved(space, {"AU45L": 1})[mesh.landmarks[names[1]]])
    roots, tips = np.linalg.norm(d[:13], axis=1), np.linalg.norm(d[13:26], axis=1)
    assert lid > 3 and min(roots.max(), tips.max()) > 0.8 * lid
    assert np.linalg.norm(d[:13] - d[13:26], axis=1).max() < 0.4 * lid
    assert np.abs(d[26:]).max() < 1e-9
    np.testing.assert_allclose(moved(space, {}), 0, atol=1e-9)


def test_an_eye_turns_with_that_of_the_template():
    face, eye = grid_mesh(13, 13, spacing=12.0), sphere_mesh(2, 12.0)
    face = TriangleMesh(face.vertices, face.faces, {"chin": 0, "nose_tip": 84})
    carrier = joined(face, placed(eye, [70, 70, -15]))
    other = sphere_mesh(3, 13.0)
    mesh = joined(face, placed(other, [71, 70, -15]))
    rider = Rider(carrier, mesh)
    R = Rotation.from_euler("y", 25, degrees=True).as_matrix()
    V = carrier.vertices.copy()
    V[169:] = (V[169:] - [70, 70, -15]) @ R.T + [70, 70, -15]
    d = rider.carry(V)
    np.testing.assert_array_equal(d[:169], face.vertices)
    turned = procrustes(mesh.vertices[169:], d[169:])
    assert turned.rms < 1e-9 and turned.degrees == pytest.approx(25)


def refined(mesh):
    """Every triangle cut into four."""
    edges = mesh.edges
    middle = {tuple(e): mesh.n_vertices + i for i, e in enumerate(edges.tolist())}
    ab, bc, ca = (
        np.array([middle[tuple(sorted(e))] for e in mesh.faces[:, pair].tolist()])
        for pair in ([0, 1], [1, 2], [2, 0])
    )
    a, b, c = mesh.faces.T
    F = np.vstack([np.c_[a, ab, ca], np.c_[b, bc, ab], np.c_[c, ca, bc], np.c_[ab, bc, ca]])
    V = np.vstack([mesh.vertices, mesh.vertices[edges].mean(axis=1)])
    return TriangleMesh(V, F, mesh.landmarks)


def test_a_finer_or_coarser_mesh_of_the_same_head_moves_alike(source, head):
    mesh, _ = head
    samples, coarse = mesh.subsample(2500, keep=list(mesh.landmarks.values()))
    d = moved(IntermediateSpace(source, mesh), {"AU27": 1, "AU12L": 1})
    for other, same in ((refined(mesh), np.arange(mesh.n_vertices)), (coarse, samples)):
        theirs = moved(IntermediateSpace(source, other), {"AU27": 1, "AU12L": 1})[: len(same)]
        off = np.linalg.norm(theirs - d[same], axis=1)
        assert np.sqrt((off**2).mean()) < 0.05 * np.linalg.norm(d, axis=1).max()


def test_a_seam_is_closed_though_one_side_of_it_is_wound_inwards(bare):
    left = bare.vertices[bare.faces].mean(axis=1)[:, :1] > 0
    cut = np.where(left, bare.faces + bare.n_vertices, bare.faces)
    whole = closed(TriangleMesh(np.vstack([bare.vertices] * 2), cut))[0]
    wrong = closed(TriangleMesh(np.vstack([bare.vertices] * 2), np.where(left, cut[:, ::-1], cut)))[
        0
    ]
    assert whole.pieces.max() == wrong.pieces.max() and whole.n_vertices == wrong.n_vertices


def test_two_sides_of_a_sheet_are_no_seam_and_two_of_a_crease_are(grid):
    n = grid.n_vertices
    back = TriangleMesh(
        np.vstack([grid.vertices] * 2), np.vstack([grid.faces, grid.faces[:, ::-1] + n])
    )
    assert closed(back)[0].n_vertices == 2 * n
    seam = joined(grid, grid.with_vertices(grid.vertices * [-1, 1, 1]))
    flipped = TriangleMesh(seam.vertices, np.vstack([grid.faces, grid.faces[:, ::-1] + n]))
    mesh, index = closed(flipped)
    assert mesh.n_vertices == 2 * n - 5 and len(np.unique(mesh.pieces)) == 1
    np.testing.assert_array_equal(mesh.vertices[index], flipped.vertices)


def test_skin_is_where_the_landmarks_are(furnished):
    space, at = furnished
    skin = skin_of(space.target)
    assert skin[at["skin"]].all() and not skin[at["skin"].stop :].any()
    assert skin_of(TriangleMesh(space.target.vertices, space.target.faces)).all()


def test_lashes_whose_roots_are_vertices_of_the_lid_are_not_joined_to_its_skin(bare):
    lid, n = bare.landmarks["eye_left_upper_outer"], bare.n_vertices
    inner = np.setdiff1d(np.arange(n), np.concatenate(bare.boundary_loops))
    edges = bare.edges[np.isin(bare.edges, inner).all(axis=1)]
    away = np.linalg.norm(bare.vertices[edges].mean(axis=1) - bare.vertices[lid], axis=1)
    roots = edges[away.argmin()]
    for ends in (roots, roots[::-1]):  # one of the two faces as the skin does
        row = bare.vertices[ends]
        across = np.cross(bare.normals[ends[0]], row[1] - row[0])
        mesh = joined(bare, strip(row, 3 * across / np.linalg.norm(across)))
        _, index = closed(mesh)
        assert not np.isin(index[n:], index[:n]).any()


def test_teeth_that_touch_the_inside_of_the_lips_go_with_the_jaw_and_not_with_the_lips(ict_root):
    narrow, whole = (facelab.load_ict_facekit(ict_root, area) for area in ("narrow", "all"))
    rider = Rider(narrow.neutral, whole.neutral)
    teeth = slice(14062, 21451)
    for unit, most in (("mouthSmile_L", 1.0), ("mouthFunnel", 3.5), ("jawOpen", 15.0)):
        moved = rider.carry(narrow.neutral.vertices + narrow.deltas[narrow.names.index(unit)])
        off = moved - whole.neutral.vertices - whole.deltas[whole.names.index(unit)]
        assert np.linalg.norm(off[teeth], axis=1).max() < most, unit


def test_vertices_of_no_triangle_stay_where_they_are(source, bare):
    V = np.vstack([bare.vertices, bare.vertices[:1] + [[0, 0, 30.0], [0, 200, 0]]])
    rider = Rider(source.neutral, TriangleMesh(V, bare.faces, bare.landmarks))
    moved = rider.carry(source.shape({"AU27": 1}))
    np.testing.assert_allclose(moved[-2:], V[-2:])
