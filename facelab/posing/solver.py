"""Coefficients of a region model that bring pinned vertices to their targets.

Tena et al. 2011, section 3.2. Coefficients here are counted from the neutral face: zero is exactly
the neutral, in every region, so the part of it that a model cannot express stays. Blendshape rigs
have `facelab.rig_solver`.

A solver knows model, weights and binding. Its `problem(vertices, weights)` settles all that the
targets of the pins do not change; `problem.solve(targets, c_0, molded)` then gives coefficients.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.utils.validation import check_is_fitted

from facelab.checks import check_choice, check_index, check_number
from facelab.motion import MotionSequence
from facelab.numeric.threads import one_thread
from facelab.rig import BlendshapeRig

REFERENCE_VERTICES = 397
"""Mesh density at which beta and gamma have the values of the paper."""

STIFFNESS = 25.0
"""Cost of one standard deviation beyond the limit: as much as 5 mm at one pin, square millimetres.
"""


_ROWS_KEPT = 1000  # of a few kilobytes each


class Solver:
    """What all solvers share: pins anywhere on the shown face, and what is shown."""

    def __init__(self, n_vertices, binding):
        self.n_vertices = n_vertices
        self.binding = binding
        self._kept = {}

    def once(self, what, vertex):
        """what(vertex), kept for the next time: pins are solved for again and again."""
        key = what.__name__, vertex
        if key not in self._kept:
            if len(self._kept) >= _ROWS_KEPT:
                self._kept.clear()
            self._kept[key] = what(vertex)
        return self._kept[key]

    def support(self, vertex):
        """Model vertices that a vertex of the shown face follows, and how much: (k,), (k,)."""
        if self.binding is None:
            return np.array([vertex]), np.ones(1)
        W = self.binding.weights
        at = slice(W.indptr[vertex], W.indptr[vertex + 1])
        return W.indices[at], W.data[at]

    def shown(self, coefficients):
        """Displacements of the shown face for rows of coefficients: (n, n_shown, 3), mm."""
        x = self.displacements(coefficients)
        if self.binding is None:
            return x
        n, n_control, _ = x.shape
        flat = self.binding.carry(x.transpose(1, 0, 2).reshape(n_control, -1))
        return flat.reshape(-1, n, 3).transpose(1, 0, 2)

    def encode(self, X):
        """Coefficients nearest to displacements of the shown face or of the model's vertices.

        Parameters
        ----------
        X : ndarray of shape (n, n_shown, 3) or (n, n_vertices, 3)
            Millimetres.

        Returns
        -------
        C : ndarray of shape (n, P)
        """
        if self.binding is not None and X.shape[1] == self.binding.mesh.n_vertices:
            X = X[:, self.binding.samples]
        return self._encode(X.reshape(len(X), -1))

    def encode_take(self, take):
        """Coefficients of the valid frames of a recorded take, shape (n_valid, P)."""
        if not isinstance(take, MotionSequence):
            raise TypeError(
                f"take is a {type(take).__name__}; give a MotionSequence (or recorded weights, if "
                "the model is a rig)."
            )
        n, sizes = take.mesh.n_vertices, {self.n_vertices}
        if self.binding is not None:
            sizes.add(self.binding.mesh.n_vertices)
        if n not in sizes:
            raise ValueError(
                f"take has {n} vertices, but {' or '.join(map(str, sorted(sizes)))} are posed."
            )
        return self.encode(take.displacements().reshape(-1, n, 3))

    # --- what a session asks, here as a rig has it: one region, no variances ----------------------

    regions = None

    @property
    def slices(self):
        """Where the coefficients of each region are: list of slice."""
        return [slice(0, self.n_coefficients)]

    def slice_of(self, region):
        """Where the coefficients of a region are."""
        slices = self.slices
        return slices[check_index(region, "region", len(slices), "regions")]

    def mahalanobis(self, coefficients):
        """Distance of each region from training; None, for it is not known."""
        return None

    def gaps(self, coefficients):
        """How far regions disagree at each model vertex, mm: nowhere."""
        return np.zeros(self.n_vertices)

    def capped(self, vertex, target, start):
        """The target as far as it is sane; all of it."""
        return target


class PoseSolver(Solver):
    """Coefficients that bring pinned vertices to their targets (Eq. 9 and 10).

    The paper's beta and gamma belong to an orthonormal basis on 397 vertices, evenly spread; they
    are scaled so that both mean the same at every density N.

    - A row of such a basis shrinks with sqrt(N), for a squared coefficient is a sum over the
      vertices of the motion it makes: gamma is scaled by 397 / N.
    - The boundary term is a sum over shared vertices, whose number grows with sqrt(N) in a band
      one edge wide: beta is scaled by sqrt(397 / N).
    - Regions carried over from a control mesh (`Regions.carried_to`) keep bands as wide as they
      were. The boundary term is then summed over the n control vertices alone, with
      sqrt(397 / n): summed over all, it would see gaps between them that it does not see on the
      control mesh, and hold every pin back.
    - Dense meshes are seldom even: eyelids and lips would resist more than cheeks. So beyond 397
      vertices each counts in the last term by its share of the surface in place of 1 / N.
    - Bases that were given (`RegionModel.from_bases`), such as blendshape units, have lengths of
      their own: gamma is scaled by their mean square.

    Up to 397 vertices this is Eq. 9 to the letter, with scaled weights. Trained on 397 or on all
    6,706 vertices of the same face, models answer the same pins alike: the pinned vertex follows
    as far and the motion reaches as far, within 10 % for about nine pins in ten; the rest is the
    choice of samples, felt most where the face hardly moves (nose tip, outline of the jaw).

    Parameters
    ----------
    model : RegionModel or HolisticModel
        Fitted. Any linear basis will do; it need not be orthonormal.
    beta : float, default=0.5
        β: weight of the agreement of regions on shared vertices, 0 or more.
    gamma : float, default=0.025
        γ: weight of staying near the state before the pins, more than 0.
    shared_pins : {"blended", "copies"}
        What a pin on a vertex of m regions holds. "copies" is Eq. 9 to the letter: each region's
        copy of the vertex is drawn to the target, which also draws the copies together, so that
        merely pressing there moves the face (by up to 0.4 mm in our trials). "blended" holds
        what is seen, the mean of the copies, with m times the weight: pressing changes nothing.
        Both are the same where one region holds the vertex, and where the copies agree. Between
        the control vertices of a bound face there are no copies, and pins are blended.
    mesh : TriangleMesh, optional
        The mesh of the model, for its areas; that of the model's regions if left out. Where there
        is none, every vertex counts the same.
    binding : LinearBinding, optional
        If the model has only the control vertices of a denser face. Pins are then on vertices of
        that face: their rows of Eq. 9 are those of the control vertices, mixed as the binding
        mixes them, so that the very vertex is held.
    limit : float, optional
        Standard deviations, as learned in training, beyond which a coefficient is drawn back
        (`STIFFNESS`); without it the model extrapolates. The pose is then not affine in the
        targets any more.

    Raises
    ------
    ValueError, TypeError
        For weights out of range, or a limit with a model that knows no variances.

    References
    ----------
    Tena et al. 2011, Eq. 8 to 10. Their Eq. 7 has a wrong index in its last term; Eq. 10 is
    right. Each pair of regions is summed once. The limit is ours; their section 7 asks for it.
    """

    def __init__(
        self,
        model,
        beta=0.5,
        gamma=0.025,
        shared_pins="blended",
        mesh=None,
        binding=None,
        limit=None,
    ):
        check_is_fitted(model)
        super().__init__(len(model.mean_) // 3, binding)
        self.model = model
        self.shared_pins = check_choice(shared_pins, "shared_pins", ("blended", "copies"))
        self.beta = check_number(beta, "beta", low=0)
        self.gamma = check_number(gamma, "gamma", above=0)
        self.limit = limit if limit is None else check_number(limit, "limit", above=0)
        if limit is not None and model.variances_ is None:
            raise ValueError(
                f"limit={limit:g} counts standard deviations, but the model was made of given "
                "bases and knows none; leave the limit out."
            )
        regions = model.regions
        if mesh is None and regions is not None:
            mesh = regions.mesh
        samples = None if regions is None else regions.samples
        boundary, n_drawn = model.boundary_, self.n_vertices
        if samples is not None:
            boundary, n_drawn = model._boundary_matrix(samples), len(samples)
        weights = vertex_weights(self.n_vertices, mesh)
        self._gamma = self.gamma * _coefficient_weights(model, weights)
        # the part of the matrix of Eq. 10 that does not depend on the pins
        self._at_rest = self.beta * np.sqrt(REFERENCE_VERTICES / n_drawn) * boundary + self._gamma

    @property
    def n_coefficients(self):
        """P: number of coefficients."""
        return self.model.n_coefficients_

    @property
    def affine(self):
        """Whether the pose is affine in the targets of the pins."""
        return self.limit is None

    # --- pins -------------------------------------------------------------------------------------

    def rows(self, vertex):
        """What a pin on this vertex holds, shape (3 * n, P): rows of Eq. 9, n times x, y, z.

        n is the number of regions that hold the vertex for pins on copies (each row block is one
        B_k^i), and 1 for blended pins, whose row is sqrt(m) times that of the vertex seen.
        """
        return self._pin(vertex)[0]

    def seen(self, vertex):
        """How the vertex that is seen follows the coefficients, shape (3, P)."""
        at, share = self.support(vertex)
        rows = (self.once(self.model.blend_rows, v) for v in at.tolist())
        return sum(w * row for w, row in zip(share, rows, strict=True))

    def _copies(self, v):
        """One row block (3, P) for each region that holds a model vertex."""
        found = []
        for columns, B, s in self.model._parts():
            first = np.searchsorted(columns, 3 * v)
            if first < len(columns) and columns[first] == 3 * v:
                row = np.zeros((3, self.n_coefficients))
                row[:, s] = B[:, first : first + 3].T
                found.append(row)
        return found

    def _pin(self, vertex):
        """Rows of a pin, and the right side of Eq. 10 for its unit target: (3 n, P), (P, 3)."""
        at, share = self.support(vertex)
        if self.shared_pins == "copies" and len(at) == 1:
            copies = self._copies(at[0])
            return np.concatenate(copies), sum(copies).T
        m = np.abs(share) @ self.model.holders_[3 * at] / np.abs(share).sum()
        seen = self.seen(vertex)
        return np.sqrt(m) * seen, m * seen.T

    def problem(self, vertices, weights=None):
        """Eq. 10 for pins on these vertices of the shown face, all but their targets settled.

        Parameters
        ----------
        vertices : sequence of int
        weights : sequence of float, optional
            Of the pins, 1 each if left out.
        """
        return (_Affine if self.affine else _Limited)(self, vertices, weights)

    def solve(self, pins, c_0=None):
        """Coefficients at the minimum of Eq. 9.

        Parameters
        ----------
        pins : dict of int to ndarray of shape (3,)
            Vertex to wanted displacement from the neutral, millimetres.
        c_0 : ndarray of shape (P,), optional
            State before the pins were set; the neutral if left out.

        Returns
        -------
        c : ndarray of shape (P,)
        """
        rest = np.zeros(self.n_coefficients)
        targets = np.array(list(pins.values()), dtype=float).reshape(-1, 3)
        return self.problem(list(pins)).solve(targets, rest, rest if c_0 is None else c_0)

    # --- what coefficients mean -------------------------------------------------------------------

    mold_ends = (-3.0, 3.0)
    bounds = (None, None)

    @property
    def regions(self):
        """Regions of the model, None if it has none."""
        return self.model.regions

    @property
    def slices(self):
        """Where the coefficients of each region are: list of slice."""
        return self.model.slices_

    def names(self, region):
        """Names of a region's components."""
        s = self.slice_of(region)
        return [f"component {k + 1}" for k in range(s.stop - s.start)]

    def check(self, coefficients):
        """Any coefficients are allowed."""

    def clipped(self, coefficients):
        """The coefficients as far as they are allowed; all of them."""
        return coefficients

    def displacements(self, coefficients):
        """Displacements from the neutral, shared vertices blended: shape (n, n_vertices, 3)."""
        return self.model.blend(np.atleast_2d(coefficients)).reshape(-1, self.n_vertices, 3)

    def _encode(self, X):
        return self.model.transform(X) - self.neutral

    @cached_property
    def neutral(self):
        """Coefficients of the neutral counted from the mean face, as training has them: (P,)."""
        return self.model.transform(np.zeros((1, 3 * self.n_vertices)))[0]

    @cached_property
    def deviations(self):
        """Standard deviation of each coefficient in training, shape (P,); ones if unknown.

        Never below a thousandth of the largest: nothing is impossible.
        """
        if self.model.variances_ is None:
            return np.ones(self.n_coefficients)
        sd = np.sqrt(np.concatenate(self.model.variances_))
        return np.maximum(sd, max(1e-3 * sd.max(), 1e-12))

    def reach(self, vertex):
        """Where a vertex can sanely be pulled with the limit on: a centre (3,) and a radius, mm.

        The mean of training, and twice the limit in standard deviations of the vertex.
        """
        seen = self.seen(vertex)
        return -seen @ self.neutral, 2 * self.limit * np.linalg.norm(seen * self.deviations)

    def capped(self, vertex, target, start):
        """A displacement target brought back to what can be reached, if there is a limit: (3,)."""
        if self.limit is None:
            return target
        centre, radius = self.reach(vertex)
        radius = max(radius, np.linalg.norm(start - centre))
        off = np.linalg.norm(target - centre)
        return target if off <= radius else centre + (target - centre) * (radius / off)

    def mahalanobis(self, coefficients):
        """Distance of each region from training, shape (n_regions,); None if variances are unknown.

        The root of the sum of squared standard deviations over the region's modes: its square is
        n_components_ on average in training.
        """
        if self.model.variances_ is None:
            return None
        z = (coefficients + self.neutral) / self.deviations
        return np.array([np.linalg.norm(z[s]) for s in self.model.slices_])

    def gaps(self, coefficients):
        """Largest distance of a region's copy of each model vertex from the vertex seen: (N,), mm.

        This is what blending hides (Fig. 2, upper row).
        """
        seen = self.displacements(coefficients).ravel()
        gap = np.zeros(self.n_vertices)
        for columns, B, s in self.model._parts():
            off = np.linalg.norm((coefficients[s] @ B - seen[columns]).reshape(-1, 3), axis=1)
            at = columns[::3] // 3
            gap[at] = np.maximum(gap[at], off)
        return np.where(self.model.holders_[::3] > 1, gap, 0)


class _Affine:
    """Eq. 10 for certain pins: minimised for y, the change from a state whose gaps are forgiven."""

    def __init__(self, solver, vertices, weights=None):
        self.solver = solver
        self.vertices = list(vertices)
        weights = np.ones(len(self.vertices)) if weights is None else weights
        pins = [solver.once(solver._pin, v) for v in self.vertices]
        self._pull = np.zeros((solver.n_coefficients, 3 * len(pins)))
        A = solver._at_rest.copy()
        for k, ((J, pull), w) in enumerate(zip(pins, weights, strict=True)):
            A += w * J.T @ J
            self._pull[:, 3 * k : 3 * k + 3] = w * pull
        self._seen = [solver.once(solver.seen, v) for v in self.vertices]
        self._settle(A)

    def _settle(self, A):
        with one_thread():
            self.factor = cho_factor(A, overwrite_a=True, check_finite=False)

    def _right(self, targets, c_0, molded):
        before = np.array([S @ c_0 for S in self._seen]).reshape(-1, 3)
        return self.solver._gamma @ molded + self._pull @ (targets - before).ravel()

    def solve(self, targets, c_0, molded):
        """Coefficients, shape (P,).

        Parameters
        ----------
        targets : ndarray of shape (n_pins, 3)
            Wanted displacements of the pinned vertices from the neutral, millimetres.
        c_0 : ndarray of shape (P,)
            State before; the gaps that it has at the boundaries cost nothing.
        molded : ndarray of shape (P,)
            Offset of the state that the last term holds to: that state is c_0 + molded.
        """
        with one_thread():
            y = cho_solve(self.factor, self._right(targets, c_0, molded), check_finite=False)
        return c_0 + y

    def slope(self, k):
        """How the coefficients follow the target of pin k: dc / dt, shape (P, 3).

        While one pin moves the matrix of Eq. 10 stands still, so the pose is affine in its target.
        """
        with one_thread():
            return cho_solve(self.factor, self._pull[:, 3 * k : 3 * k + 3], check_finite=False)


class _Limited(_Affine):
    """Eq. 10 with a cost on coefficients beyond the limit, solved by Newton's method.

    The energy is convex, and quadratic for as long as the same coefficients are beyond: each step
    solves for the present ones, and it ends when they stay the same. Their number is small, so the
    inverse of the matrix without them, found once, leaves a small system (Woodbury).
    """

    def _settle(self, A):
        self._A, self._last = A.copy(), None
        super()._settle(A)
        with one_thread():
            self._inverse = cho_solve(self.factor, np.eye(len(A)), check_finite=False)

    def solve(self, targets, c_0, molded):
        solver, sd = self.solver, self.solver.deviations
        lo, hi = (sign * solver.limit * sd - solver.neutral - c_0 for sign in (-1, 1))
        lo, hi = np.minimum(lo, 0), np.maximum(hi, 0)  # a kept pose stays where it is
        b, stiff = self._right(targets, c_0, molded), STIFFNESS / sd**2

        def energy(y):
            beyond = y - y.clip(lo, hi)
            return y @ (self._A @ y) / 2 - b @ y + stiff @ beyond**2 / 2

        with one_thread():
            free = self._inverse @ b
            y = free if self._last is None else self._last
            for _ in range(200):
                low, high = y < lo, y > hi
                at = np.flatnonzero(low | high)
                small = self._inverse[np.ix_(at, at)]
                small[np.diag_indices_from(small)] += 1 / stiff[at]
                over = free[at] - np.where(low, lo, hi)[at]
                new = free - self._inverse[:, at] @ np.linalg.solve(small, over)
                if ((new < lo) == low).all() and ((new > hi) == high).all():
                    self._last = new
                    return c_0 + new
                step = 1.0
                while energy(y + step * (new - y)) > energy(y) and step > 1e-9:
                    step /= 2
                y = y + step * (new - y)
        raise AssertionError("the limited solve did not end")


def sizes_of(model):
    """Number of vertices and of coefficients of a region model or a rig."""
    if isinstance(model, BlendshapeRig):
        return model.neutral.n_vertices, len(model.names)
    return len(model.mean_) // 3, model.n_coefficients_


def vertex_weights(n_vertices, mesh):
    """What each vertex counts, 397 / N on average: shape (n_vertices,)."""
    if mesh is None or n_vertices <= REFERENCE_VERTICES:
        return np.full(n_vertices, REFERENCE_VERTICES / n_vertices)
    areas = np.maximum(
        mesh.vertex_areas, mesh.vertex_areas.mean() / 100
    )  # a vertex of slivers still counts a little
    return REFERENCE_VERTICES * areas / areas.sum()


def _coefficient_weights(model, weights):
    """W of the last term (c_0 - c)^T W (c_0 - c): 397 / N times one for even weights, (P, P)."""
    scale = 1.0
    if model.variances_ is None:  # bases given in units of their own
        scale = np.mean(np.concatenate([(B**2).sum(axis=1) for B in model.components_]))
    if np.ptp(weights) == 0:
        return scale * weights[0] * np.eye(model.n_coefficients_)
    W = np.zeros((model.n_coefficients_,) * 2)
    for columns, B, s in model._parts():
        U, _, Vt = np.linalg.svd(B, full_matrices=False)
        Q = U @ Vt  # B itself where it is orthonormal, else the orthonormal basis nearest to it
        W[s, s] = scale * (Q * np.repeat(weights, 3)[columns]) @ Q.T
    return W
