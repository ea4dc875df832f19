"""The layout of the markers on the template."""

from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.csgraph import dijkstra

SHIFT = 16.0
"""Variance of what all places have in common, against that of each: a shift is carried whole."""


def kernel(mesh, feet, reach):
    """How alike each vertex and each foot move: shape (n_vertices, n_feet).

    `SHIFT`, and exp(-d / reach) with d along the surface: lips and lids are far apart, however
    near they lie. Pieces of a mesh that do not hang together share the shift alone.
    """
    return SHIFT + np.exp(-dijkstra(mesh.adjacency, directed=False, indices=feet).T / reach)


def covariance(K):
    """The covariance nearest to a square matrix: symmetric, without negative variance.

    Kernels of distances along a surface with holes are not quite positive everywhere.
    """
    values, vectors = np.linalg.eigh((K + K.T) / 2)
    return (vectors * np.maximum(values, 0)) @ vectors.T


def filled(smooth, values, seen):
    """Values of a linear smoother with those not seen put where the seen ones lead them.

    Parameters
    ----------
    smooth : ndarray of shape (n, n)
    values : ndarray of shape (n_frames, n, n_columns)
    seen : ndarray of bool, shape (n_frames, n)

    Returns
    -------
    ndarray of shape (n_frames, n, n_columns)
    """
    full = np.where(seen[..., None], values, 0.0)
    packed = np.packbits(seen, axis=1)
    _, first, kind = np.unique(packed, axis=0, return_index=True, return_inverse=True)
    kind = kind.ravel()
    order = np.argsort(kind, kind="stable")
    bounds = np.searchsorted(kind[order], np.arange(len(first) + 1))
    for k, frame in enumerate(first):
        hidden = np.flatnonzero(~seen[frame])
        if hidden.size == 0:
            continue
        frames = order[bounds[k] : bounds[k + 1]]
        led = np.matmul(smooth[hidden], full[frames])  # hidden ones are 0 in it
        G = np.eye(hidden.size) - smooth[np.ix_(hidden, hidden)]
        solved = np.linalg.solve(G, np.moveaxis(led, 1, 0).reshape(hidden.size, -1))
        solved = solved.reshape(hidden.size, len(frames), -1)
        full[np.ix_(frames, hidden)] = np.moveaxis(solved, 1, 0)
    return full


def mapped(weights):
    """The function that weighs points, the same for each axis: float32, (n_frames, n, 3)."""
    weights = weights.T.astype(np.float32)

    def carried(displacements):
        rows = np.ascontiguousarray(np.swapaxes(displacements, 1, 2), dtype=np.float32)
        rows = rows.reshape(-1, rows.shape[2]) @ weights
        return rows.reshape(-1, 3, weights.shape[1]).transpose(0, 2, 1)

    return carried


class MarkerLayout:
    """The dense motion of a face as a linear function of its markers, found once.

    The motion is taken for a Gaussian field on the surface whose places move the more alike the
    nearer they lie: covariance size^2 exp(-d / reach), and a shift of the whole; markers are seen
    with some noise. What is carried is its mean, given the markers. Near a marker it falls off
    like a tent, as the linear radial basis does: a field that is smooth at its markers overshoots
    between and beyond them where they are few.

    Parameters
    ----------
    fit : MarkerFit

    Attributes
    ----------
    feet : ndarray of int, shape (n_markers,)
        The vertex nearest to each marker.
    carry : ndarray of shape (n_vertices, n_markers)
        Dense displacement from the markers', any axis: the best trade of fit and smoothness.
    smooth : ndarray of shape (n_markers, n_markers)
        What becomes of the markers' own displacements.
    own : ndarray of shape (n_markers,)
        Share of a marker's displacement that its own fit does not follow, 1 - S_ii.
    """

    def __init__(self, fit):
        self.fit = fit
        self.feet = fit.mesh.faces[fit.faces, fit.weights.argmax(axis=1)]
        size = fit.preset.motion_size**2
        self._K = size * kernel(fit.mesh, self.feet, fit.preset.motion_reach)
        own = covariance(self._K[self.feet])
        self._factor = cho_factor(own + fit.preset.noise**2 * np.eye(len(own)))
        self.carry = cho_solve(self._factor, self._K.T).T
        self.smooth = cho_solve(self._factor, own).T
        self.own = np.maximum(1 - np.diag(self.smooth), 1e-9)

    @property
    def near(self):
        """How strongly vertices hang on markers, any axis: shape (n_vertices, n_markers)."""
        return np.abs(self.carry)

    def smoothed(self, displacements):
        """What the fitted surface does at the markers: (n_frames, n_markers, 3), mm."""
        return np.matmul(self.smooth, displacements)

    def carrier(self, vertices=slice(None)):
        """A function from displacements of all markers to those of some vertices.

        Parameters
        ----------
        vertices : slice or array_like of int, optional

        Returns
        -------
        callable
            From (n_frames, n_markers, 3), all filled, to float32 of shape (n_frames, n_vertices,
            3), millimetres.
        """
        return mapped(self.carry[vertices])

    def filled(self, displacements):
        """Displacements of all markers, those not seen put where the seen ones lead them.

        The result carries over to the dense face exactly as a fit with the seen markers alone
        would: a smoother that is given what it would say itself says the same again.

        Parameters
        ----------
        displacements : ndarray of shape (n_frames, n_markers, 3)
            From rest, head frame, millimetres; NaN where hidden.

        Returns
        -------
        ndarray of shape (n_frames, n_markers, 3)
        """
        return filled(self.smooth, displacements, np.isfinite(displacements[..., 0]))

    def left_out(self, full):
        """How far each marker is from where the others lead it: (n_frames, n_markers, 3), mm."""
        # of a linear smoother S: without its own marker the residual is r_i / (1 - S_ii)
        return (full - self.smoothed(full)) / self.own[:, None]

    def spread(self):
        """Standard deviation of the field, given the markers, per axis: (n_vertices,), mm."""
        return self._spread

    @cached_property
    def _spread(self):
        told = np.einsum("vm,vm->v", self.carry, self._K)
        before = (1 + SHIFT) * self.fit.preset.motion_size**2
        return np.sqrt(np.maximum(before - told, 0.0))
