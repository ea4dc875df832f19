"""Toys that the eye can check."""

import numpy as np

from facelab.geometry import TriangleMesh


def two_humps(n_frames=200):
    """A strip whose two humps mostly rise together, and made-up frames of it.

    Returns
    -------
    strip : TriangleMesh
        42 vertices, 100 mm long; vertex 5 is the top of the left hump, 15 of the right one.
    X : ndarray of shape (n_frames, 126)
        Displacements, mm.

    Examples
    --------
    >>> strip, X = two_humps()
    >>> strip.n_vertices, X.shape
    (42, (200, 126))
    """
    x = np.linspace(0, 100, 21)
    V = np.concatenate([np.stack([x, 0 * x + y, 0 * x], axis=1) for y in (0, 4)])
    a = np.arange(20)
    above, below = np.stack([a, a + 1, a + 22], 1), np.stack([a, a + 22, a + 21], 1)
    left, right = (np.exp(-(((V[:, 0] - at) / 22) ** 2)) for at in (25, 75))
    rng = np.random.default_rng(0)
    together, alone = rng.normal(size=(2, n_frames, 1)) * [[[6.0]], [[2.0]]]
    heights = (together + alone) * left + (together - alone) * right
    X = np.stack([0 * heights, heights, 0 * heights], axis=2).reshape(n_frames, -1)
    return TriangleMesh(V, np.vstack([above, below])), X
