"""Closest points on a surface."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree


def closest(mesh, P, chunk=2000):
    """Closest triangle to each point, and the barycentric coordinates of the closest point.

    A triangle can only win if its surrounding ball comes nearer than the nearest vertex in use.
    """
    V, F = mesh.vertices, mesh.faces
    middle = V[F].mean(axis=1)
    radius = np.linalg.norm(V[F] - middle[:, None], axis=2).max(axis=1)
    used = np.unique(F)
    near = cKDTree(V[used]).query(P)[0]
    tree = cKDTree(middle)
    face, barycentric = np.empty(len(P), dtype=int), np.empty((len(P), 3))
    for start in range(0, len(P), chunk):
        Q, reach = P[start : start + chunk], near[start : start + chunk] + 1e-9
        found = tree.query_ball_point(Q, reach + radius.max())
        point = np.repeat(np.arange(len(Q)), [len(f) for f in found])
        tried = np.concatenate([np.asarray(f, dtype=int) for f in found])
        off = np.linalg.norm(Q[point] - middle[tried], axis=1)
        keep = off <= reach[point] + radius[tried]
        point, tried = point[keep], tried[keep]
        b = _closest_in(Q[point], *V[F[tried]].transpose(1, 0, 2))
        off = np.linalg.norm((b[..., None] * V[F[tried]]).sum(axis=1) - Q[point], axis=1)
        order = np.lexsort((off, point))
        best = order[np.searchsorted(point[order], np.arange(len(Q)))]
        face[start : start + chunk], barycentric[start : start + chunk] = tried[best], b[best]
    return face, barycentric


def _closest_in(P, A, B, C):
    """Barycentric coordinates of the point of triangle ABC closest to P, row by row."""
    n = np.cross(B - A, C - A)
    size = np.maximum((n**2).sum(axis=1), 1e-300)
    inside = np.stack(
        [(np.cross(v - u, P - u) * n).sum(axis=1) / size for u, v in ((B, C), (C, A), (A, B))],
        axis=1,
    )
    best = np.where((inside >= 0).all(axis=1), 0.0, np.inf)  # squared distance within the plane
    out = inside.copy()
    for i, (u, v) in enumerate(((A, B), (B, C), (C, A))):
        edge = v - u
        long = np.maximum((edge**2).sum(axis=1), 1e-300)
        t = (((P - u) * edge).sum(axis=1) / long).clip(0, 1)
        off = ((u + t[:, None] * edge - P) ** 2).sum(axis=1)
        closer = off < best
        best = np.where(closer, off, best)
        on_edge = np.zeros_like(out)
        on_edge[:, i], on_edge[:, (i + 1) % 3] = 1 - t, t
        out = np.where(closer[:, None], on_edge, out)
    return out


def closest_points(mesh, points, candidates=16):
    """The points of a surface nearest to some points.

    Parameters
    ----------
    mesh : TriangleMesh
    points : ndarray of shape (n_points, 3)
        Millimetres.
    candidates : int, default=16
        Triangles tried for each point, those with the nearest middle first; exact as long as
        neighbouring triangles are of like size.

    Returns
    -------
    faces : ndarray of int, shape (n_points,)
    weights : ndarray of shape (n_points, 3)
        Barycentric place in that triangle.
    """
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    _, near = cKDTree(middle).query(points, k=min(candidates, len(middle)))
    return closest_among(mesh, points, near.reshape(len(points), -1))


def closest_among(mesh, points, near):
    corners = mesh.vertices[mesh.faces[near.ravel()]]
    asked = np.repeat(points, near.shape[1], axis=0)
    found = trimesh.triangles.closest_point(corners, asked)
    far = ((found - asked) ** 2).sum(axis=1).reshape(near.shape)
    best = far.argmin(axis=1)
    picked = np.arange(len(points)) * near.shape[1] + best
    weights = trimesh.triangles.points_to_barycentric(corners[picked], found[picked])
    weights = np.clip(weights, 0, None)
    return near[np.arange(len(points)), best], weights / weights.sum(axis=1, keepdims=True)
