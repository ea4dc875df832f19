"""The places of a surface that are closest to points: exact, by libigl's tree of boxes."""

import igl
import numpy as np

from facelab.checks import as_finite

_TINY = 1e-300  # instead of a division by 0


def closest_points(mesh, points, among=None):
    """The triangle of a surface that is closest to each point, and the closest place in it.

    Parameters
    ----------
    mesh : TriangleMesh
    points : array_like of shape (n_points, 3)
        Millimetres.
    among : sequence of ndarray of int, optional
        For each point the triangles that are looked at; all of them if left out.

    Returns
    -------
    faces : ndarray of int, shape (n_points,)
    barycentric : ndarray of shape (n_points, 3)
        The closest place in that triangle; not negative, rows sum to one.

    Raises
    ------
    ValueError
        For points that are not finite.

    Examples
    --------
    >>> import facelab
    >>> flat = facelab.TriangleMesh([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])
    >>> faces, barycentric = closest_points(flat, [[1, 1, 5]])
    >>> barycentric.tolist()
    [[0.5, 0.25, 0.25]]
    """
    P = as_finite(points, "points", ("n_points", 3))
    V, F = mesh.vertices, mesh.faces
    if among is None:
        _, faces, places = igl.point_mesh_squared_distance(P, V, F)
    else:
        faces, places = np.empty(len(P), dtype=int), np.empty(P.shape)
        for i, some in enumerate(among):
            found = igl.point_mesh_squared_distance(P[i : i + 1], V, F[some])
            faces[i], places[i] = some[found[1][0]], found[2][0]
    return faces, _barycentric(places, V[F[faces]])


def _barycentric(P, corners):
    """Barycentric coordinates of points (n, 3) in their triangles (n, 3, 3).

    Along the longest edge and the height over it: so a sliver, or a triangle without area, costs
    no exactness of the place.
    """
    longest = ((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2).argmax(axis=1)
    order = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[..., None], axis=1).transpose(1, 0, 2)
    edge, side, to = b - a, c - a, P - a
    length2 = np.maximum(_dot(edge, edge), _TINY)
    at, top = (np.clip(_dot(x, edge) / length2, 0, 1) for x in (to, side))  # along the edge
    height = side - edge * top[:, None]
    t = _dot(to, height) / np.maximum(_dot(height, height), _TINY)
    # no higher than the triangle is there: of a height that is all rounding t is nonsense
    t = t.clip(0, np.minimum(at / np.maximum(top, _TINY), (1 - at) / np.maximum(1 - top, _TINY)))
    s = at - t * top
    weights = np.empty((len(P), 3))
    np.put_along_axis(weights, order, np.stack([1 - s - t, s, t], axis=1), axis=1)
    return np.maximum(weights, 0)  # some may round to -1e-17


def _dot(a, b):
    return np.einsum("nx,nx->n", a, b)
