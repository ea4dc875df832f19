"""Pictures of triangles by a depth buffer, in numpy: no browser, no graphics card."""

import numpy as np

_CHUNK = 1 << 19  # fragments held at once
_EDGE = -1e-9  # a pixel on an edge belongs to both triangles


def rasterise(corners, depth, width, height):
    """What is seen at each pixel: the nearest triangle, and where on it.

    Parameters
    ----------
    corners : ndarray of shape (n_faces, 3, 2)
        Pixels, x to the right and y down; the middle of the first pixel is (0.5, 0.5).
    depth : ndarray of shape (n_faces, 3)
        Larger is nearer.
    width, height : int
        Pixels.

    Returns
    -------
    face : ndarray of int, shape (height, width)
        -1 where there is none.
    weights : ndarray of shape (height, width, 3)
        Barycentric: the shares of its three corners.

    Examples
    --------
    >>> face, _ = rasterise(np.array([[[0, 0], [4, 0], [0, 4]]]), np.zeros((1, 3)), 4, 2)
    >>> face.tolist()
    [[0, 0, 0, 0], [0, 0, 0, -1]]
    """
    x_of, y_of = (np.ascontiguousarray(corners[..., k].T, dtype=float) for k in (0, 1))
    left, right = _covered(x_of, width)
    top, bottom = _covered(y_of, height)
    shares = _shares(x_of, y_of)
    # depth too is linear over a triangle
    depth = np.asarray(depth).T[:, None]
    z_of = shares[0] * depth[0] + shares[1] * depth[1] + shares[2] * depth[2]
    across = np.maximum(right - left + 1, 0)
    count = across * np.maximum(bottom - top + 1, 0)
    count[~np.isfinite(z_of).all(axis=0)] = 0
    best = np.full(width * height, -np.inf)
    face = np.full(width * height, -1)
    ends = np.cumsum(count)
    for some in np.split(np.arange(len(count)), np.flatnonzero(np.diff(ends // _CHUNK)) + 1):
        n = count[some]
        own = np.repeat(some, n)
        y, x = np.divmod(np.arange(len(own)) - np.repeat(np.cumsum(n) - n, n), across[own])
        x, y = x + left[own], y + top[own]
        for share in shares:
            inside = np.flatnonzero(_at(share, own, x, y) >= _EDGE)
            own, x, y = own[inside], x[inside], y[inside]
        z, pixel = _at(z_of, own, x, y), y * width + x
        np.maximum.at(best, pixel, z)
        won = z == best[pixel]
        face[pixel[won]] = own[won]
    seen = np.flatnonzero(face >= 0)
    weights = np.zeros((width * height, 3))
    y, x = np.divmod(seen, width)
    for corner, share in enumerate(shares):
        weights[seen, corner] = _at(share, face[seen], x, y)
    return face.reshape(height, width), weights.reshape(height, width, 3)


def _covered(at, size):
    """The first and the last pixel of each triangle, from its corners (3, n_faces)."""
    low = np.minimum(np.minimum(at[0], at[1]), at[2])
    high = np.maximum(np.maximum(at[0], at[1]), at[2])
    first, last = np.ceil(low - 0.5), np.floor(high - 0.5)
    return np.maximum(first, 0).astype(int), np.minimum(last, size - 1).astype(int)


def _at(linear, own, x, y):
    """What is linear over each triangle, (3, n_faces), at pixels x and y of the triangles own."""
    return linear[0][own] + linear[1][own] * x + linear[2][own] * y


def _shares(x, y):
    """Barycentric shares as k0 + k1 x + k2 y of a pixel's indices: three of (3, n_faces).

    Takes the corners' places, both (3, n_faces).
    """
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    area = np.where(np.abs(area) < 1e-12, np.nan, area)
    found = []
    for p, q in ((1, 2), (2, 0), (0, 1)):
        dx, dy = x[q] - x[p], y[q] - y[p]
        # cross(d, (x + 1/2, y + 1/2) - p)
        start = dx * (0.5 - y[p]) - dy * (0.5 - x[p])
        found.append(np.stack([start, -dy, dx]) / area)
    return found
