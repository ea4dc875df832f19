"""Coefficients of a model that bring pinned vertices to their targets.

Tena et al. 2011, section 3.2. Coefficients here are counted from the neutral face: zero is exactly
the neutral, in every region, so the part of it that a model cannot express stays.

A solver knows model, weights and binding. Its `problem(vertices, weights)` settles all that the
targets of the pins do not change; `problem.solve(targets, c_0, molded)` then gives coefficients.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dpocon, dpotrf

from facelab.checks import check_choice, check_index, check_number, check_type
from facelab.face_model import FaceModel
from facelab.models.region import BETA
from facelab.motion import MotionSequence, WeightSequence
from facelab.numeric.least_squares import solve_bounded
from facelab.numeric.threads import one_thread
from facelab.posing.bounded import LARGEST_BASIS, FaceBasis
from facelab.posing.ranges import (
    CONDITION,
    GAMMA,
    LARGEST,
    LIMITS,
    check_beta,
    check_gamma,
    check_size,
)

REFERENCE_VERTICES = 397
"""Mesh density at which beta and gamma have the values of the paper."""

STIFFNESS = 25.0
"""Cost of one standard deviation beyond the limit: as much as 5 mm at one pin, square millimetres.
"""


_BYTES_KEPT = 2**26  # of rows: those of thousands of pins


class PoseSolver:
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
    - Bases that were given (`RegionModel.from_bases`), and the units of a rig, have lengths of
      their own: gamma is scaled by their mean square.

    Up to 397 vertices this is Eq. 9 to the letter, with scaled weights. Trained on 397 or on all
    6,706 vertices of the same face, models answer the same pins alike: the pinned vertex follows
    as far and the motion reaches as far, within 10 % for most pins if the motion was free of
    noise. Noise in the motion is learned differently by both, and they part; so does the choice
    of samples, felt most where the face hardly moves (nose tip, outline of the jaw).

    Parameters
    ----------
    model : FaceModel
        Fitted. Any linear basis will do; it need not be orthonormal. Where its coefficients have
        bounds, as the weights of a rig, Eq. 9 is a quadratic programme within them.
    beta : float, default=0.5
        β: weight of the agreement of regions on shared vertices, 0 to 1e6.
    gamma : float, default=0.025
        γ: weight of staying near the state before the pins, 1e-9 to 1e9.
    shared_pins : {"blended", "copies"}
        What a pin on a vertex of m regions holds. "copies" is Eq. 9 to the letter: each region's
        copy of the vertex is drawn to the target, which also draws the copies together, so that
        merely pressing there moves the face, the more the farther they are apart. "blended" holds
        what is seen, the mean of the copies, with m times the weight: pressing changes nothing.
        Both are the same where one region holds the vertex, and where the copies agree. Between
        the control vertices of a bound face there are no copies, and pins are blended.
    mesh : TriangleMesh, optional
        The mesh of the model, for its areas; the model's own if left out. Where there is none,
        every vertex counts the same.
    binding : LinearBinding, optional
        If the model has only the control vertices of a denser face. Pins are then on vertices of
        that face: their rows of Eq. 9 are those of the control vertices, mixed as the binding
        mixes them, so that the very vertex is held.
    limit : float, optional
        Standard deviations, 0.01 to 1,000, as learned in training, beyond which a coefficient is
        drawn back (`STIFFNESS`); without it the model extrapolates. The pose is then not affine in
        the targets any more.

    Raises
    ------
    ValueError, TypeError
        For weights out of range, or a limit with a model that knows no standard deviations or
        has bounds that hold it already.

    References
    ----------
    Tena et al. 2011, Eq. 8 to 10. Their Eq. 7 has a wrong index in its last term; Eq. 10 is
    right. Each pair of regions is summed once. The limit is ours.
    Lewis and Anjyo 2010, Direct manipulation blendshapes, whom they quote for rigs, is not at
    hand: built from section 3.2.
    """

    def __init__(
        self,
        model,
        beta=BETA,
        gamma=GAMMA,
        shared_pins="blended",
        mesh=None,
        binding=None,
        limit=None,
    ):
        check_type(model, "model", FaceModel, "what a model must answer stands in FaceModel")
        model.check_fitted()
        self.model = model
        self.n_vertices = model.n_vertices
        self.n_coefficients = model.n_coefficients
        self.slices = model.slices
        self.binding = binding
        self.shared_pins = check_choice(shared_pins, "shared_pins", ("blended", "copies"))
        self.beta, self.gamma = check_beta(beta), check_gamma(gamma)
        self.limit = check_limit(limit, model)
        regions = model.regions
        samples = None if regions is None else regions.samples
        n_drawn = self.n_vertices if samples is None else len(samples)
        boundary = self.beta * np.sqrt(REFERENCE_VERTICES / n_drawn) * model.boundary(samples)
        weights = vertex_weights(self.n_vertices, model.mesh if mesh is None else mesh)
        # Eq. 10 as far as it does not depend on the pins, and its last term alone
        self.last_term = self.gamma * model.resistance(weights)
        self.at_rest = boundary + self.last_term
        self._kept = {}

    @property
    def affine(self):
        """Whether the pose is affine in the targets of the pins."""
        return self.limit is None and self.bounds is None

    # --- pins -------------------------------------------------------------------------------------

    def _once(self, what, vertex):
        """what(vertex), kept for the next time: pins are solved for again and again."""
        key = what.__name__, vertex
        if key not in self._kept:
            if len(self._kept) * 24 * self.n_coefficients > _BYTES_KEPT:
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

    def rows(self, vertex):
        """What a pin on this vertex holds, shape (3 * n, P): rows of Eq. 9, n times x, y, z.

        n is the number of regions that hold the vertex for pins on copies (each row block is one
        B_k^i), and 1 for blended pins, whose row is sqrt(m) times that of the vertex seen.
        """
        return self.pin(vertex)[0]

    def seen(self, vertex):
        """How the vertex that is seen follows the coefficients, shape (3, P)."""
        return self._once(self._seen, vertex)

    def pin(self, vertex):
        """Rows of a pin, and the right side of Eq. 10 for its unit target: (3 n, P), (P, 3)."""
        return self._once(self._pin, vertex)

    def _seen(self, vertex):
        at, share = self.support(vertex)
        rows = (self._once(self.model.vertex_rows, v) for v in at.tolist())
        return sum(w * row for w, row in zip(share, rows, strict=True))

    def _pin(self, vertex):
        at, share = self.support(vertex)
        if self.shared_pins == "copies" and len(at) == 1:
            copies = self.model.copy_rows(at[0])
            return np.concatenate(copies), sum(copies).T
        m = np.abs(share) @ self.model.holders[at] / np.abs(share).sum()
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
        kind = _Bounded if self.bounds is not None else _Limited if self.limit else _Affine
        return kind(self, vertices, weights)

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

    # --- faces ------------------------------------------------------------------------------------

    def displacements(self, coefficients):
        """Displacements from the neutral, shared vertices blended: shape (n, n_vertices, 3)."""
        return self.model.displacements(coefficients)

    def shown(self, coefficients):
        """Displacements of the shown face for rows of coefficients: (n, n_shown, 3), mm."""
        x = self.displacements(coefficients)
        if self.binding is None:
            return x
        n, n_control, _ = x.shape
        flat = self.binding.carry(x.transpose(1, 0, 2).reshape(n_control, -1))
        return flat.reshape(-1, n, 3).transpose(1, 0, 2)

    @cached_property
    def basis(self):
        """`FaceBasis` of the shown face; None where it is too large to hand around."""
        P, n = self.n_coefficients, self.n_vertices
        if 12 * P * n > LARGEST_BASIS:
            return None
        rows = self.displacements(np.eye(P)).astype(np.float32)
        return FaceBasis(rows, None if self.binding is None else self.binding.weights)

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
        return self.model.encode(X)

    def encode_take(self, take):
        """Coefficients of the valid frames of a recorded take, shape (n_valid, P)."""
        if isinstance(take, WeightSequence):
            return self.model.encode_weights(take)[take.valid]
        remedy = "give a MotionSequence (or recorded weights, if the model is a rig)"
        check_type(take, "take", MotionSequence, remedy)
        n, sizes = take.mesh.n_vertices, {self.n_vertices}
        if self.binding is not None:
            sizes.add(self.binding.mesh.n_vertices)
        if n not in sizes:
            raise ValueError(
                f"take has {n} vertices, but {' or '.join(map(str, sorted(sizes)))} are posed."
            )
        return self.encode(take.displacements().reshape(-1, n, 3))

    # --- what coefficients mean -------------------------------------------------------------------

    @property
    def regions(self):
        """Regions of the model, None if it has none."""
        return self.model.regions

    @property
    def bounds(self):
        """Ends that hold for every coefficient, None if they are free."""
        return self.model.bounds

    @property
    def mold_bounds(self):
        """Ends of what a slider may be set to: a pair."""
        return (-LARGEST, LARGEST) if self.bounds is None else self.bounds

    @property
    def mold_ends(self):
        """Sensible ends of a slider: the bounds, or 3 standard deviations."""
        return (-3.0, 3.0) if self.bounds is None else self.bounds

    def slice_of(self, region):
        """Where the coefficients of a region are."""
        return self.slices[check_index(region, "region", len(self.slices), "regions")]

    def names(self, region):
        """Names of a region's components."""
        self.slice_of(region)
        return self.model.component_names(region)

    def check(self, coefficients):
        """Refuse coefficients outside the bounds, or larger than any face can have."""
        check_size(coefficients)
        low, high = coefficients.min(), coefficients.max()
        if self.bounds is not None and (low < self.bounds[0] or high > self.bounds[1]):
            raise ValueError(
                f"coefficients run from {low:g} to {high:g}, but those of this model lie between "
                "{:g} and {:g}.".format(*self.bounds)
            )

    def clipped(self, coefficients):
        """The coefficients as far as they are allowed."""
        return coefficients if self.bounds is None else coefficients.clip(*self.bounds)

    @cached_property
    def _training(self):
        return self.model.training()

    @property
    def centre(self):
        """Coefficients of the mean of training, counted from the neutral: (P,); 0 if unknown."""
        return np.zeros(self.n_coefficients) if self._training is None else self._training[0]

    @cached_property
    def deviations(self):
        """Standard deviation of each coefficient in training, shape (P,); ones if unknown.

        Never below a thousandth of the largest: nothing is impossible.
        """
        if self._training is None:
            return np.ones(self.n_coefficients)
        sd = self._training[1]
        return np.maximum(sd, max(1e-3 * sd.max(), 1e-12))

    def reach(self, vertex):
        """Where a vertex can sanely be pulled with the limit on: a centre (3,) and a radius, mm.

        The mean of training, and twice the limit in standard deviations of the vertex.
        """
        seen = self.seen(vertex)
        return seen @ self.centre, 2 * self.limit * np.linalg.norm(seen * self.deviations)

    def ball(self, vertex, start):
        """`reach`, or as far as a vertex is already: a centre (3,) and a radius, mm."""
        centre, radius = self.reach(vertex)
        return centre, max(radius, np.linalg.norm(start - centre))

    def capped(self, vertex, target, start):
        """A displacement target brought back to what can be reached, if there is a limit: (3,)."""
        if self.limit is None:
            return target
        centre, radius = self.ball(vertex, start)
        off = np.linalg.norm(target - centre)
        return target if off <= radius else centre + (target - centre) * (radius / off)

    def mahalanobis(self, coefficients):
        """Distance of each region from training, shape (n_regions,); None if variances are unknown.

        The root of the sum of squared standard deviations over the region's modes: its square is
        their number on average in training.
        """
        if self._training is None:
            return None
        z = (coefficients - self.centre) / self.deviations
        return np.array([np.linalg.norm(z[s]) for s in self.slices])

    def gaps(self, coefficients):
        """Largest distance of a region's copy of each model vertex from the vertex seen: (N,), mm.

        This is what blending hides (Fig. 2, upper row).
        """
        return self.model.gaps(coefficients)


class _Problem:
    """Eq. 10 for certain pins, for y: the change from a state whose gaps are forgiven."""

    def __init__(self, solver, vertices, weights=None):
        self.solver = solver
        self.vertices = list(vertices)
        P, pins = solver.n_coefficients, [solver.pin(v) for v in self.vertices]
        weights = np.ones(len(pins)) if weights is None else np.asarray(weights, dtype=float)
        self._pull = np.concatenate(
            [np.zeros((P, 0)), *(w * pull for (_, pull), w in zip(pins, weights, strict=True))],
            axis=1,
        )
        rows = [np.sqrt(w) * J for (J, _), w in zip(pins, weights, strict=True)]
        J = np.concatenate([np.zeros((0, P)), *rows])
        self._seen = np.concatenate([np.zeros((0, P)), *map(solver.seen, self.vertices)])
        self._A = solver.at_rest + J.T @ J  # Eq. 10: sum B_k^T B_k + beta L + gamma W
        with one_thread():
            self._factor = self._factored(weights)
            self._settle()

    def _factored(self, weights):
        """Cholesky factor (upper) of the matrix of Eq. 10, refused where digits would get lost."""
        factor, failed = dpotrf(self._A)
        share = 0 if failed else dpocon(factor, np.abs(self._A).sum(axis=0).max())[0]
        if not share * CONDITION >= 1:
            solver = self.solver
            pins = ""
            if len(weights):
                pins = f" and weights from {weights.min():g} to {weights.max():g}"
            raise ValueError(
                f"beta={solver.beta:g}, gamma={solver.gamma:g}{pins} lie too far apart: the "
                f"condition number of Eq. 10 is {1 / max(share, 1e-16):.0e}, and beyond "
                f"{CONDITION:.0e} rounding takes over; bring them nearer together."
            )
        return factor, False

    def _settle(self):
        """Make ready to solve."""

    def _right(self, targets, c_0, molded):
        # Eq. 10 for y = c - c_0, the gaps of c_0 at the boundaries forgiven
        off = np.ravel(targets) - self._seen @ c_0
        return self.solver.last_term @ molded + self._pull @ off

    def free(self, targets, c_0, molded):
        """As `solve`, but without what holds coefficients back: affine in the targets."""
        with one_thread():
            y = cho_solve(self._factor, self._right(targets, c_0, molded), check_finite=False)
        return c_0 + y

    def slope(self, k):
        """How those follow the target of pin k: dc / dt, shape (P, 3).

        While one pin moves the matrix of Eq. 10 stands still.
        """
        with one_thread():
            return cho_solve(self._factor, self._pull[:, 3 * k : 3 * k + 3], check_finite=False)

    @cached_property
    def inverse(self):
        """Inverse of the matrix of Eq. 10, shape (P, P)."""
        with one_thread():
            return cho_solve(self._factor, np.eye(len(self._A)), check_finite=False)

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
        raise NotImplementedError


class _Affine(_Problem):
    """Solved by one factor, found when the pins are set."""

    solve = _Problem.free


class _Limited(_Problem):
    """With a cost on coefficients beyond the limit, solved by Newton's method.

    The energy is convex, and quadratic for as long as the same coefficients are beyond: each step
    solves for the present ones, and it ends when they stay the same. Their number is small, so the
    inverse of the matrix without them, found once, leaves a small system (Woodbury).
    """

    def _settle(self):
        self._last = None

    def ends(self, c_0):
        """Ends of the coefficients, and how far each gives beyond them: three of shape (P,)."""
        solver, sd = self.solver, self.solver.deviations
        lo, hi = (sign * solver.limit * sd + solver.centre for sign in (-1, 1))
        # a kept pose stays where it is
        return np.minimum(lo, c_0), np.maximum(hi, c_0), sd**2 / STIFFNESS

    def solve(self, targets, c_0, molded):
        """As `_Problem.solve`."""
        lo, hi, give = self.ends(c_0)
        lo, hi = lo - c_0, hi - c_0
        b, stiff = self._right(targets, c_0, molded), 1 / give

        def energy(y):
            beyond = y - y.clip(lo, hi)
            return y @ (self._A @ y) / 2 - b @ y + stiff @ beyond**2 / 2

        with one_thread():
            free = self.inverse @ b
            y = free if self._last is None else self._last
            for _ in range(200):
                low, high = y < lo, y > hi
                # (A + diag(stiff)_at)^-1 from A^-1 (Woodbury): a system of those beyond alone
                at = np.flatnonzero(low | high)
                small = self.inverse[np.ix_(at, at)]
                small[np.diag_indices_from(small)] += 1 / stiff[at]
                over = free[at] - np.where(low, lo, hi)[at]
                new = free - self.inverse[:, at] @ np.linalg.solve(small, over)
                if ((new < lo) == low).all() and ((new > hi) == high).all():
                    self._last = new
                    return c_0 + new
                step = 1.0
                while energy(y + step * (new - y)) > energy(y) and step > 1e-9:
                    step /= 2
                y = y + step * (new - y)
        raise AssertionError("the limited solve did not end")


class _Bounded(_Problem):
    """Within the bounds of the coefficients; each solve starts from the bounds of the last."""

    def _settle(self):
        self._at = None

    def ends(self, c_0):
        """As `_Limited.ends`."""
        return *(np.full(len(c_0), end) for end in self.solver.bounds), np.zeros(len(c_0))

    def solve(self, targets, c_0, molded):
        """As `_Problem.solve`."""
        g = self._right(targets, c_0, molded) + self._A @ c_0
        w, self._at = solve_bounded(self._A, g, *self.ends(c_0)[:2], self._at)
        return w


def check_limit(limit, model):
    """The limit as a number or None, refused where the model has no use for one."""
    if limit is None:
        return None
    limit = check_number(limit, "limit", *LIMITS)
    why = None
    if model.bounds is not None:
        why = "the coefficients of this model stay within {:g} and {:g} anyway".format(
            *model.bounds
        )
    elif model.training() is None:
        why = "this model was made of given bases and knows none"
    if why:
        raise ValueError(
            f"limit={limit:g} counts standard deviations, but {why}; leave the limit out."
        )
    return limit


def vertex_weights(n_vertices, mesh):
    """What each vertex counts, 397 / N on average: shape (n_vertices,)."""
    if mesh is None or n_vertices <= REFERENCE_VERTICES:
        return np.full(n_vertices, REFERENCE_VERTICES / n_vertices)
    areas = np.maximum(
        mesh.vertex_areas, mesh.vertex_areas.mean() / 100
    )  # a vertex of slivers still counts a little
    return REFERENCE_VERTICES * areas / areas.sum()
