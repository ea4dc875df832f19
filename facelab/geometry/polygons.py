"""Polygons cut into triangles that lie inside them."""

import numpy as np

_MOST_WORK = 1_000_000  # corners squared, of polygons that bend inwards: some seconds of cutting


def triangulate(vertices, corners, counts):
    """Triangles of polygons, each polygon's one after the other, facing the same way.

    A polygon becomes a fan about its first corner, unless that would leave the polygon: a quad
    that bends inwards is cut along its other diagonal, a larger polygon ear by ear.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
    corners : ndarray of int, shape (n_corners,)
        Vertices of the first polygon, then those of the second, and so on.
    counts : ndarray of int, shape (n_polygons,)
        Corners of each polygon, 3 or more.

    Returns
    -------
    triangles : ndarray of int, shape (n_corners - 2 * n_polygons, 3)
    polygon : ndarray of int, shape (n_corners - 2 * n_polygons,)
        That each triangle comes from.

    Raises
    ------
    ValueError
        If polygons that bend inwards have so many corners that cutting them would take minutes.

    Examples
    --------
    >>> V = np.array([[2, 0, 0], [0.4, 0.4, 0], [0, 2, 0], [0, 0, 0]])  # bends inwards at V[1]
    >>> triangulate(V, np.arange(4), np.array([4]))[0].tolist()
    [[0, 1, 3], [1, 2, 3]]
    """
    counts = np.asarray(counts)
    start = np.cumsum(counts) - counts
    first = np.cumsum(counts - 2) - (counts - 2)  # of each polygon's triangles
    polygon = np.repeat(np.arange(len(counts)), counts - 2)
    step = np.arange(len(polygon)) - first[polygon]
    at = start[polygon]
    F = np.stack([corners[at], corners[at + step + 1], corners[at + step + 2]], axis=1)
    # twice the area of each triangle, seen along the normal of its polygon
    u, v = vertices[F[:, 1]] - vertices[F[:, 0]], vertices[F[:, 2]] - vertices[F[:, 0]]
    cross = np.cross(u, v)
    normal = np.add.reduceat(cross, first) if len(first) else cross
    seen = (cross * normal[polygon]).sum(axis=1)
    turned = seen < -1e-9 * (normal**2).sum(axis=1)[polygon]
    bent = np.unique(polygon[turned])
    large = counts[bent][counts[bent] > 4].astype(float)
    if (large**2).sum() > _MOST_WORK:
        raise ValueError(
            f"{len(large)} polygon(s) with up to {large.max():.0f} corners bend inwards, too many "
            "to be cut here; cut them into triangles in the program that made the mesh."
        )
    for p in bent.tolist():
        loop = corners[start[p] : start[p] + counts[p]]
        cut = _cut(vertices[loop], normal[p])
        F[first[p] : first[p] + counts[p] - 2] = loop[cut]
    return F, polygon


def _cut(points, normal):
    """Triangles inside one polygon, as places of its corners."""
    n = len(points)
    if n == 4:  # the fan leaves it, so the other diagonal is the better one
        return np.array([(0, 1, 3), (1, 2, 3)])
    axis = np.abs(normal).argmax()
    flat = np.delete(points, axis, axis=1)
    if (normal[axis] < 0) != (axis == 1):  # leaving out y mirrors the plane
        flat = flat[:, ::-1]
    left, found = list(range(n)), []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(flat[left], k)), 0)
        before, ear, after = left[k - 1], left[k], left[(k + 1) % len(left)]
        found.append((before, ear, after))
        del left[k]
    return np.array([*found, left])


def _is_ear(flat, k):
    """Whether corner k can be cut off: it bends outwards and no other corner lies within."""
    a, b, c = flat[k - 1], flat[k], flat[(k + 1) % len(flat)]
    if _side(a, b, c) <= 0:
        return False
    inside = (_side(a, b, flat) >= 0) & (_side(b, c, flat) >= 0) & (_side(c, a, flat) >= 0)
    inside[[k - 1, k, (k + 1) % len(flat)]] = False
    return not inside.any()


def _side(a, b, p):
    """Positive where p lies to the left of the line from a to b."""
    return (b[0] - a[0]) * (p[..., 1] - a[1]) - (b[1] - a[1]) * (p[..., 0] - a[0])
