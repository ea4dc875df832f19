"""A pull whose answer is not affine, as the few numbers that solve it anywhere, as in a page."""

from dataclasses import dataclass

import numpy as np

LARGEST_BASIS = 40e6
"""Bytes of a basis beyond which a face is too large to be handed to a page."""


@dataclass(frozen=True, eq=False)
class FaceBasis:
    """Displacements of the shown face, linear in coefficients c: weights @ (c @ rows).

    Parameters
    ----------
    rows : ndarray of float32, shape (P, n, 3)
        Of the vertices of the model, millimetres.
    weights : sparse array of shape (n_vertices, n) or None
        How the shown vertices follow those; None if they are the same.
    """

    rows: np.ndarray
    weights: object


@dataclass(frozen=True, eq=False)
class BoundedPull:
    """Coefficients under a pull t (3,), millimetres, where ends hold them back.

    Those that minimise (c - f)' A (c - f) / 2 + sum of beyond^2 / (2 give), where f = free +
    slope t solves Eq. 10 without ends, A is its matrix, and beyond is how far c lies outside lo
    and hi (not at all where give is 0).

    Parameters
    ----------
    start : ndarray of shape (P,)
        Coefficients of the face before the pull.
    free : ndarray of shape (P,)
    slope : ndarray of shape (P, 3)
    inverse : ndarray of shape (P, P)
        Of A.
    lo, hi, give : ndarray of shape (P,)
    basis : FaceBasis
    centre : ndarray of shape (3,) or None
        Of the ball in which the target is kept, millimetres; None if it may be anywhere.
    radius : float

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> session = facelab.PosingSession(rig, rig.neutral)
    >>> pull = session.press(17)  # the weights of a rig stay within 0 and 1
    >>> pull.inverse.shape == (len(rig.names), len(rig.names)), float(pull.hi.max())
    (True, 1.0)
    """

    start: np.ndarray
    free: np.ndarray
    slope: np.ndarray
    inverse: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    give: np.ndarray
    basis: FaceBasis
    centre: np.ndarray | None = None
    radius: float = 0.0
