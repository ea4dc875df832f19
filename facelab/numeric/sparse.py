"""Sparse linear systems: factored once, solved for many right sides."""

import scipy.sparse as sp
from scipy.sparse.linalg import splu

from facelab.numeric.threads import one_thread, single_threaded


class SparseFactor:
    """Solves A x = b for one sparse A and any number of b.

    Parameters
    ----------
    A : sparse array of shape (n, n)
        Symmetric positive definite: it is factored without a search for pivots, in an order that
        keeps the factor thin (minimum degree on A + A^T).
    """

    def __init__(self, A):
        with one_thread():
            self._factor = splu(
                sp.csc_matrix(A), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
            )

    @single_threaded
    def solve(self, b):
        """x, of the shape of b: (n,) or (n, n_columns)."""
        return self._factor.solve(b)
