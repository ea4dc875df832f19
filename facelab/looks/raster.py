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
    low = np.maximum(np.ceil(corners.min(axis=1) - 0.5), 0).astype(int)
    high = np.minimum(np.floor(corners.max(axis=1) - 0.5), [width - 1, height - 1]).astype(int)
    shares = _shares(corners)
    # depth too is linear over a triangle
    z_of = np.einsum("fck,fc->fk", shares, depth)
    across = np.maximum(high - low + 1, 0)
    count = across.prod(axis=1)
    count[~np.isfinite(z_of).all(axis=1)] = 0
    best = np.full(width * height, -np.inf)
    face = np.full(width * height, -1)
    ends = np.cumsum(count)
    for some in np.split(np.arange(len(count)), np.flatnonzero(np.diff(ends // _CHUNK)) + 1):
        n = count[some]
        own = np.repeat(some, n)
        y, x = np.divmod(np.arange(len(own)) - np.repeat(np.cumsum(n) - n, n), across[own, 0])
        x, y = x + low[own, 0], y + low[own, 1]
        u, v, w = (k[own, 0] + k[own, 1] * x + k[own, 2] * y for k in np.moveaxis(shares, 1, 0))
        inside = np.flatnonzero((u >= _EDGE) & (v >= _EDGE) & (w >= _EDGE))
        own, x, y = own[inside], x[inside], y[inside]
        z, pixel = (
            (z_of[own] * np.stack([np.ones(len(x)), x, y], axis=1)).sum(axis=1),
            y * width + x,
        )
        np.maximum.at(best, pixel, z)
        won = z == best[pixel]
        face[pixel[won]] = own[won]
    seen = np.flatnonzero(face >= 0)
    weights = np.zeros((width * height, 3))
    at = np.stack([np.ones(len(seen)), seen % width, seen // width], axis=1)
    weights[seen] = np.einsum("nck,nk->nc", shares[face[seen]], at)
    return face.reshape(height, width), weights.reshape(height, width, 3)


def _shares(corners):
    """Barycentric shares as k0 + k1 x + k2 y of a pixel's indices: (n_faces, 3 corners, 3)."""
    a, b, c = np.moveaxis(corners.astype(float), 1, 0)
    area = _cross(b - a, c - a)
    found = []
    for p, q in ((b, c), (c, a), (a, b)):
        d = q - p
        # cross(d, (x + 1/2, y + 1/2) - p)
        start = d[:, 0] * (0.5 - p[:, 1]) - d[:, 1] * (0.5 - p[:, 0])
        found.append(np.stack([start, -d[:, 1], d[:, 0]], axis=1))
    flat = np.abs(area) < 1e-12
    return np.stack(found, axis=1) / np.where(flat, np.nan, area)[:, None, None]


def _cross(p, q):
    return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
