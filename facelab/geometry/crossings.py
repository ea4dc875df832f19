"""Triangles that cut through each other."""

import numpy as np


def cutting(vertices, faces, others=None):
    """Pairs of triangles that cut through each other: int, (k, 2), as rows of both arrays.

    An edge of one passes through the inside of the other; touching does not count, nor do triangles
    with a common edge.

    Parameters
    ----------
    vertices : ndarray of shape (n, 3)
    faces : ndarray of int, shape (m, 3)
    others : ndarray of int, shape (l, 3), optional
        Triangles that those are held against; left out: each other.

    Examples
    --------
    >>> V = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [5, 5, 0]])
    >>> cutting(V, np.array([[0, 1, 2]]), np.array([[3, 4, 5]])).tolist()
    [[0, 0]]
    """
    V, F = np.asarray(vertices, dtype=float), np.asarray(faces)
    G = F if others is None else np.asarray(others)
    pairs = _overlapping(V[F], V[G])
    if others is None:
        pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    return pairs[cut(V, F[pairs[:, 0]], G[pairs[:, 1]])]


def cut(V, one, two):
    """Whether the triangles of each pair cut through each other, as `cutting` says: bool, (k,).

    Parameters
    ----------
    V : ndarray of shape (n, 3)
    one, two : ndarray of int, shape (k, 3)
    """
    found = np.zeros(len(one), dtype=bool)
    may = np.arange(len(one))
    for _ in range(2):
        may = may[_astride(V, one[may], two[may])]
        one, two = two, one
    may = may[(one[may, :, None] == two[may, None, :]).sum(axis=(1, 2)) < 2]
    one, two = one[may], two[may]
    for a, b in ((one, two), (two, one)):
        for k in range(3):
            start, end = a[:, k], a[:, (k + 1) % 3]
            # an edge that starts at a common corner can only touch
            free = ~((b == start[:, None]) | (b == end[:, None])).any(axis=1)
            found[may[free]] |= _pierced(V[start[free]], V[end[free]], V[b[free]])
    return found


def _overlapping(A, B):
    """Pairs of triangles (m, 3, 3), (l, 3, 3) whose boxes meet: swept along x."""
    low_a, high_a, low_b, high_b = A.min(axis=1), A.max(axis=1), B.min(axis=1), B.max(axis=1)
    i, j = _starting(low_a[:, 0], high_a[:, 0], low_b[:, 0], "left")
    q, p = _starting(low_b[:, 0], high_b[:, 0], low_a[:, 0], "right")
    i, j = np.concatenate([i, p]), np.concatenate([j, q])
    for x in (1, 2):
        meet = (low_a[:, x][i] <= high_b[:, x][j]) & (low_b[:, x][j] <= high_a[:, x][i])
        i, j = i[meet], j[meet]
    return np.stack([i, j], axis=1)


def _starting(low, high, at, side):
    """Which of `at` lie in each span from low to high; `side` tells whether at low counts."""
    order = np.argsort(at, kind="stable")
    first = np.searchsorted(at[order], low, side)
    n = np.maximum(np.searchsorted(at[order], high, "right") - first, 0)
    own = np.repeat(np.arange(len(low)), n)
    return own, order[np.repeat(first - np.cumsum(n) + n, n) + np.arange(n.sum())]


def _astride(V, one, two):
    """Whether the second triangle has corners on both sides of the plane of the first."""
    a = V[one[:, 0]]
    n = _cross(V[one[:, 1]] - a, V[one[:, 2]] - a)
    at = (n * a).sum(axis=1)
    height = [(V[two[:, k]] * n).sum(axis=1) - at for k in range(3)]
    low, high = np.minimum.reduce(height), np.maximum.reduce(height)
    slack = 1e-12 * np.abs(at).max(initial=0)  # rounding must not hide a cut
    return (low < slack) & (high > -slack)


def _cross(a, b):
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _pierced(start, end, triangles):
    """Whether segments pass through the inside of triangles (Moeller and Trumbore 1997)."""
    a = triangles[:, 0]
    u, v, d = triangles[:, 1] - a, triangles[:, 2] - a, end - start
    normal = _cross(u, v)
    slope = (normal * d).sum(axis=1)
    safe = np.where(np.abs(slope) < 1e-12, 1.0, slope)
    t = -(normal * (start - a)).sum(axis=1) / safe
    hit = start + t[:, None] * d - a
    area2 = np.maximum((normal**2).sum(axis=1), 1e-300)
    beta = (_cross(hit, v) * normal).sum(axis=1) / area2
    gamma = (_cross(u, hit) * normal).sum(axis=1) / area2
    inside = (np.minimum(beta, gamma) > 1e-9) & (beta + gamma < 1 - 1e-9)
    return inside & (np.abs(slope) > 1e-12) & (t > 1e-9) & (t < 1 - 1e-9)
