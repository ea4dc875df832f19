"""Where the markers sit: on the skin of an actor, most of them on no landmark."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from data_synth.template.plane import arc_length, inside
from facelab.numeric.threads import single_threaded

_ALWAYS = (
    "chin", "jaw_right_3", "jaw_left_3", "jaw_right_6", "jaw_left_6", "brow_right_1",
    "brow_right_3", "brow_right_5", "brow_left_5", "brow_left_3", "brow_left_1", "nose_bridge_1",
    "nose_bridge_3", "nose_tip", "nostril_right_outer", "nostril_left_outer", "nose_base",
    "mouth_corner_right", "mouth_corner_left", "lip_upper", "lip_lower",
)  # fmt: skip
_SOMETIMES = (
    "jaw_right_4", "jaw_left_4", "jaw_right_8", "jaw_left_8", "brow_right_2", "brow_left_2",
    "brow_right_4", "brow_left_4", "lip_upper_right_outer", "lip_upper_left_outer",
    "lip_lower_right_outer", "lip_lower_left_outer", "nose_bridge_2",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sites:
    """Feet of the markers on the skin.

    Parameters
    ----------
    names : tuple of str
        A landmark of `facelab.geometry.mesh.MULTI_PIE`, or m001, m002, ... from the top down.
    faces : ndarray of int, shape (n_markers,)
        Triangle that each marker is glued to.
    weights : ndarray of shape (n_markers, 3)
        Barycentric place in that triangle; each row sums to 1.
    """

    names: tuple
    faces: np.ndarray
    weights: np.ndarray

    def feet_and_normals(self, corners):
        """Points on the skin and unit normals of the triangles there.

        Parameters
        ----------
        corners : ndarray of shape (n_frames, n_markers, 3, 3)
            Positions of the three corners of each marker's triangle, millimetres.

        Returns
        -------
        feet, normals : ndarray of shape (n_frames, n_markers, 3)
        """
        feet = np.einsum("fmcx,mc->fmx", corners, self.weights)
        a, b, c = np.moveaxis(corners, 2, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        return feet, normals / np.maximum(length, 1e-12)


def _contour(mesh, names):
    """A closed smooth line through landmarks, shape (200, 3)."""
    points = mesh.vertices[[mesh.landmarks[n] for n in names]]
    points = np.vstack([points, points[:1]])
    along = arc_length(points)
    return CubicSpline(along, points, bc_type="periodic")(np.linspace(0, along[-1], 200))


def contours(mesh):
    """Lid margins and the line where the lips meet, as closed lines: dict of (200, 3) arrays."""
    eye = ("outer", "upper_outer", "upper_inner", "inner", "lower_inner", "lower_outer")
    mouth = ("right", "upper_right", "upper", "upper_left", "left", "lower_left", "lower",
             "lower_right")  # fmt: skip
    return {
        "eye_right": _contour(mesh, [f"eye_right_{e}" for e in eye]),
        "eye_left": _contour(mesh, [f"eye_left_{e}" for e in eye]),
        "mouth": _contour(mesh, [f"mouth_inner_{m}" for m in mouth]),
    }


def _free_skin(mesh, points, normals):
    """Where a marker may be glued: mask (n,) of points (n, 3) with their normals."""
    free = np.ones(len(points), dtype=bool)
    for name, line in contours(mesh).items():
        margin = 4.5 if name != "mouth" else 3.0  # mm; lids and lips must be able to close
        free &= (cKDTree(line).query(points)[0] > margin) & ~inside(points[:, :2], line[:, :2])
    # no camera sees under the jaw, behind the cheek or into the nostrils
    free &= (normals[:, 2] > 0.3) & (normals[:, 1] > -0.75)
    nostrils = [mesh.landmarks[f"nostril_{side}_inner"] for side in ("right", "left")]
    free &= cKDTree(mesh.vertices[nostrils]).query(points)[0] > 6.0
    if mesh.boundary_loops:
        free &= cKDTree(mesh.vertices[mesh.boundary_loops[0]]).query(points)[0] > 5.0
    return free


@single_threaded  # choices between equals hang on the last digit
def place_markers(mesh, spacing=11.5, random_state=0):
    """Markers about `spacing` apart, those on landmarks first.

    Parameters
    ----------
    mesh : TriangleMesh
        A neutral face with the landmarks of `facelab.geometry.mesh.MULTI_PIE`.
    spacing : float, default=11.5
        Millimetres to the nearest neighbour on average; no two of the free markers, nor one of
        them and one on a landmark, are closer than 0.92 of it.
    random_state : int or sequence of int

    Returns
    -------
    Sites
        21 or more on landmarks; none near a lid's edge, inside the lips, in a nostril or where
        no camera looks.
    """
    rng = np.random.default_rng(random_state)
    V, F = mesh.vertices, mesh.faces
    wanted = [*_ALWAYS, *(n for n in _SOMETIMES if rng.random() < 0.55)]
    names, faces, weights, points = [], [], [], np.empty((0, 3))
    for name in wanted:
        vertex = mesh.landmarks[name]
        if len(points) and np.linalg.norm(points - V[vertex], axis=1).min() < 0.6 * spacing:
            continue
        around = np.flatnonzero((F == vertex).any(axis=1))
        face = int(around[rng.integers(len(around))])
        away = rng.uniform(0, 0.15, 2)  # nobody glues a marker exactly
        w = np.where(F[face] == vertex, 1 - away.sum(), 0.0)
        w[F[face] != vertex] = away
        names.append(name)
        faces.append(face)
        weights.append(w)
        points = np.vstack([points, w @ V[F[face]]])
    # free ones: darts thrown evenly at the skin, kept where no other is near
    count = 60 * int(mesh.face_areas.sum() / spacing**2)
    face = rng.choice(len(F), count, p=mesh.face_areas / mesh.face_areas.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    w = np.stack([1 - u, u * (1 - v), u * v], axis=1)
    darts = np.einsum("nc,ncx->nx", w, V[F[face]])
    ok = _free_skin(mesh, darts, np.einsum("nc,ncx->nx", w, mesh.normals[F[face]]))
    ok &= cKDTree(points).query(darts)[0] >= 0.92 * spacing
    kept = []
    near = cKDTree(darts)
    for i in range(count):
        if ok[i]:
            kept.append(i)
            ok[near.query_ball_point(darts[i], 0.92 * spacing)] = False
    kept = np.array(kept)[np.argsort(-darts[kept, 1])]
    return Sites(
        (*names, *(f"m{i + 1:03d}" for i in range(len(kept)))),
        np.append(faces, face[kept]).astype(int),
        np.vstack([weights, w[kept]]),
    )
