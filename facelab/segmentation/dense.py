"""How alike the vertices of a dense face are, found some rows at a time, only as far as it counts.

All pairs of 8,820 vertices are 0.6 GB in each matrix of `similarity`; here none is ever whole.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra

from facelab.checks import as_finite, check_number
from facelab.segmentation.similarity import as_positions

FAR = 8
"""Distances beyond so many r do not count: there nearness is below e^-8 = 0.0003."""

BLOCK = 2**23
"""Entries of the rows that are found at a time."""


class Correlations:
    """C-bar of a dense face: rows are found when asked for, single precision.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_vertices, 3)
        Millimetres.
    still : float, default=1e-6
        As for `motion_correlation`.

    Examples
    --------
    >>> import numpy as np
    >>> C_bar = Correlations(np.random.default_rng(0).normal(size=(20, 5, 3)))
    >>> C_bar[2].shape, np.asarray(C_bar).shape
    ((5,), (5, 5))
    """

    def __init__(self, positions, still=1e-6):
        positions = as_positions(positions)
        n_frames, n_vertices, _ = positions.shape
        # unit length over the three axes together: products are the average of three correlations
        self.signals = np.empty((3, n_frames, n_vertices), dtype=np.float32)
        for axis, D in enumerate(self.signals):
            name = f"positions[:, :, {axis}]"
            X = as_finite(positions[:, :, axis], name, ("n_frames", "n_vertices"))
            X = X - X.mean(axis=0)
            size = np.sqrt(np.einsum("fn,fn->n", X, X))
            moves = size > still * np.sqrt(n_frames)
            np.divide(X, np.where(moves, size, np.inf) * np.sqrt(3), out=D, casting="same_kind")
        self.signals = self.signals.reshape(3 * n_frames, n_vertices)

    @property
    def shape(self):
        """(n_vertices, n_vertices)"""
        return (self.signals.shape[1],) * 2

    def __getitem__(self, rows):
        C_bar = self.signals[:, rows].T @ self.signals
        at = np.arange(self.shape[0])[rows]
        C_bar[(*np.indices(np.shape(at)), at)] = 1  # also of a vertex that does not move
        return np.clip(C_bar, -1, 1, out=C_bar)

    def __array__(self, dtype=None, copy=None):
        return self[:].astype(dtype or np.float32, copy=False)


class Distances:
    """G of a dense face: rows are found when asked for.

    Parameters
    ----------
    mesh : TriangleMesh
        In one piece.

    Examples
    --------
    >>> import facelab
    >>> G = Distances(facelab.load_template(4375))
    >>> G[[3, 5]].shape == (2, G.shape[1])
    True
    """

    def __init__(self, mesh):
        mesh.check_connected()
        self.mesh = mesh

    @property
    def shape(self):
        """(n_vertices, n_vertices)"""
        return (self.mesh.n_vertices,) * 2

    def __getitem__(self, rows):
        return self.within(rows, np.inf)

    def within(self, rows, limit):
        """Rows in which what lies farther than `limit` millimetres is infinite: much quicker."""
        sources = np.arange(self.mesh.n_vertices)[rows]
        return dijkstra(self.mesh.adjacency, indices=sources, limit=limit)

    def __array__(self, dtype=None, copy=None):
        return self.mesh.geodesics().astype(dtype or float, copy=False)


def sparse_affinity(C_bar, G, lam=0.7, r=10.0, threshold=0.7):
    """A without what is nearly 0: correlations below the threshold, nearness of what lies far.

    Parameters
    ----------
    C_bar : Correlations
    G : Distances
    lam, r, threshold : float
        As for `affinity`. Distances count up to `FAR` times r.

    Returns
    -------
    A : sparse array of shape (n_vertices, n_vertices)
        Between 0 and 1, symmetric, single precision; entries that are left out are below 0.0003.

    References
    ----------
    Tena et al. 2011, Eq. 11 and 12.
    """
    lam = check_number(lam, "lam", low=0, high=1)
    threshold = check_number(threshold, "threshold", low=0, high=1)
    r = check_number(r, "r", above=0)
    n = C_bar.shape[0]
    if n != G.shape[0]:
        raise ValueError(f"C_bar has shape {C_bar.shape}, G {G.shape}; they must agree.")
    D, step, upper = C_bar.signals, max(1, BLOCK // n), []
    for a in range(0, n, step):
        b = min(a + step, n)
        A = np.zeros((b - a, n - a), dtype=np.float32)
        if lam < 1:
            A[:] = G.within(slice(a, b), FAR * r)[:, a:]
            np.exp(np.divide(A, -r, out=A), out=A)  # Eq. 11; beyond the reach exp(-inf) is 0
            A *= 1 - lam
        C = D[:, a:b].T @ D[:, a:]
        np.add(A, np.minimum(C, 1) * np.float32(lam), out=A, where=C >= threshold)  # Eq. 12
        A[np.tril_indices(b - a)] = 0
        A[np.diag_indices(b - a)] = 0.5  # comes twice, from either side
        part = sp.csr_array(A)
        upper.append(sp.csr_array((part.data, part.indices + a, part.indptr), shape=(b - a, n)))
    upper = sp.vstack(upper, format="csr")
    return upper + upper.T.tocsr()
