"""Weights of a blendshape rig that bring pinned vertices to their targets, kept in [0, 1].

Lewis and Anjyo 2010, as Tena et al. 2011 quote them.
"""

import numpy as np
from scipy.linalg.blas import daxpy

from facelab.checks import check_number
from facelab.motion import WeightSequence
from facelab.numeric.least_squares import solve_bounded
from facelab.numeric.threads import one_thread
from facelab.posing.solver import Solver, vertex_weights


class RigSolver(Solver):
    """Weights of a blendshape rig that bring pinned vertices to their targets, kept in [0, 1].

    Minimises sum_k ||v_k - D_k w||^2 + gamma s ||w - w_0||^2 with 0 <= w <= 1, as a quadratic
    programme in as many unknowns as there are units. s is the squared motion of an average unit
    on 397 vertices, so that gamma means the same for every rig, at every density, as it does in
    `PoseSolver`.

    There is no `limit`: a rig knows no standard deviations, and its bounds hold it already.

    Parameters
    ----------
    rig : BlendshapeRig
    gamma : float, default=0.025
        γ: weight of staying near the weights before the pins, more than 0.
    binding : LinearBinding, optional
        If the rig has only the control vertices of a denser face, see `PoseSolver`.

    References
    ----------
    Lewis and Anjyo 2010, Direct manipulation blendshapes, is not at hand: built from Tena et al.
    2011, Eq. 8 and section 3.2, who quote it. The scale s is ours.
    """

    affine = False
    limit = None
    mold_ends = bounds = (0.0, 1.0)

    def __init__(self, rig, gamma=0.025, binding=None):
        super().__init__(rig.neutral.n_vertices, binding)
        self.model = rig
        self.gamma = check_number(gamma, "gamma", above=0)
        self._D = np.ascontiguousarray(rig.deltas, dtype=float).reshape(len(rig.names), -1)
        weights = np.repeat(vertex_weights(self.n_vertices, rig.neutral), 3)
        self._stay = self.gamma * float((self._D**2 @ weights).mean())
        self._ends = np.zeros(self.n_coefficients), np.ones(self.n_coefficients)

    @property
    def n_coefficients(self):
        """K: number of units."""
        return len(self.model.names)

    @property
    def deviations(self):
        """What sliders count in: weights."""
        return np.ones(self.n_coefficients)

    def names(self, region):
        """Names of the units."""
        self.slice_of(region)
        return list(self.model.names)

    def check(self, coefficients):
        """Refuse weights outside [0, 1]."""
        low, high = coefficients.min(), coefficients.max()
        if low < 0 or high > 1:
            raise ValueError(
                f"coefficients run from {low:g} to {high:g}, but weights of a rig lie between 0 "
                "and 1."
            )

    def clipped(self, coefficients):
        """The weights kept within [0, 1]."""
        return coefficients.clip(0, 1)

    def encode_take(self, take):
        """Weights of the valid frames of a take: recorded ones, or fitted to motion."""
        if isinstance(take, WeightSequence):
            return self.model.rig_weights(take)[take.valid]
        return super().encode_take(take)

    def seen(self, vertex):
        """How the vertex that is seen follows the weights, shape (3, K)."""
        at, share = self.support(vertex)
        return np.einsum("kva,v->ak", self._D.reshape(len(self._D), -1, 3)[:, at], share)

    def problem(self, vertices, weights=None):
        """The programme for pins on these vertices, all but their targets settled."""
        return _Bounded(self, vertices, weights)

    def displacements(self, coefficients):
        """Displacements from the neutral, shape (n, n_vertices, 3); only active units are added."""
        W = np.atleast_2d(coefficients)
        X = np.zeros((len(W), self._D.shape[1]))
        for x, w in zip(X, W, strict=True):
            for k in np.flatnonzero(w):
                daxpy(self._D[k], x, a=w[k])  # in place
        return X.reshape(len(W), -1, 3)

    def _encode(self, X):
        H, at, found = self._D @ self._D.T, None, []
        H[np.diag_indices_from(H)] += 1e-9 * H.diagonal().max()  # units may depend on each other
        with one_thread():
            for g in X @ self._D.T:
                w, at = solve_bounded(H, g, *self._ends, at)
                found.append(w)
        return np.array(found).reshape(-1, self.n_coefficients)


class _Bounded:
    """The quadratic programme of a `RigSolver`; each solve starts from the bounds of the last."""

    def __init__(self, solver, vertices, weights=None):
        self.solver = solver
        self.vertices = list(vertices)
        weights = np.ones(len(self.vertices)) if weights is None else np.asarray(weights)
        K = solver.n_coefficients
        J = np.array([solver.once(solver.seen, v) for v in self.vertices]).reshape(-1, K)
        self._pull = J.T * np.repeat(weights, 3)
        self._H = self._pull @ J
        self._H[np.diag_indices(K)] += solver._stay
        self._at = None

    def solve(self, targets, c_0, molded):
        """Weights within [0, 1], shape (K,); as `_Affine.solve`."""
        g = self._pull @ np.ravel(targets) + self.solver._stay * (c_0 + molded)
        w, self._at = solve_bounded(self._H, g, *self.solver._ends, self._at)
        return w
