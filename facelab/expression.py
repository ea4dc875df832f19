"""Action units of a sketched expression: which of them, and how much of each.

Yu and Liu 2014, section IV. The displacements D, (3 n, K), are reduced once to an orthonormal Q
and a K x K factor R; everything after that costs K x K. The printed objective is

    ||D w - d||^2 + lam^2 (sum(w) - alpha)^2,    lo <= w <= hi                       (Eq. 9)

Here its first term is divided by n, so that `lam` (mm) means the same at every density; with
`per_vertex=False` it is the sum as printed. lam = lambda / sqrt(n): the paper's lambda = 1 on
4,375 vertices is lam = 0.015.
"""

import warnings
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.spatial import cKDTree
from threadpoolctl import ThreadpoolController

from facelab.blendshapes import BlendshapeRig
from facelab.errors import as_finite, check_choice, check_number
from facelab.mesh import TriangleMesh
from facelab.motion import MotionSequence, WeightSequence

_threads = ThreadpoolController()  # solves this small lose time on several threads

CRITERIA = ("e_rms", "held_out", "gcv", "fewest")
"""Ways to choose alpha; see `ExpressionFit.choose`."""

MISALIGNED = 2.0
"""Rigid motion, RMS over the vertices in millimetres, from which a sketch is not aligned."""

DEPENDENT = 1e-5
"""Share of a unit that earlier units may leave unexplained before it counts as their mixture."""


# -- The rig, reduced once --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class UnitBasis:
    """A rig made ready for regression by `prepare_units`; every function here takes it as `rig`.

    Parameters
    ----------
    rig : BlendshapeRig
    kept : ndarray of int, shape (n_kept,)
        Units that take part, as indices into `rig.names`.
    Q, R : ndarray of shape (3 * n_vertices, n_kept), (n_kept, n_kept)
        D = Q R (Eq. 3): orthonormal columns and an upper triangle, millimetres.
    """

    rig: BlendshapeRig
    kept: np.ndarray
    Q: np.ndarray
    R: np.ndarray

    @property
    def dropped(self):
        """Names of the units left out."""
        return tuple(n for i, n in enumerate(self.rig.names) if i not in set(self.kept.tolist()))

    @cached_property
    def gram(self):
        """D^T D, square millimetres, shape (n_kept, n_kept)."""
        return self.R.T @ self.R

    @cached_property
    def limit(self):
        """Vertex boundary: the largest displacement a unit gives it, mm, shape (n_vertices,)."""
        return np.linalg.norm(self.rig.deltas[self.kept], axis=2).max(axis=0).astype(float)

    @cached_property
    def rigid(self):
        """Rotation vector and shift beyond the units, from displacements: (6, 3 * n_vertices)."""
        V = self.rig.neutral.vertices
        V = V - V.mean(axis=0)
        size = np.sqrt((V**2).sum(axis=1).mean())
        C = np.zeros((len(V), 3, 6))
        C[:, :, :3] = np.cross(np.eye(3)[None], V[:, None] / size).transpose(0, 2, 1)
        C[:, :, 3:] = np.eye(3)
        C = C.reshape(-1, 6)
        C = C - self.Q @ (self.Q.T @ C)
        return np.linalg.pinv(C, rcond=1e-3) / np.repeat([size, 1], 3)[:, None]


def prepare_units(rig, still="drop", dependent="refuse", min_motion=0.1):
    """Reduce a rig once, for any number of regressions.

    Parameters
    ----------
    rig : BlendshapeRig
    still : {"drop", "refuse"}
        What to do with units that nowhere move the mesh by `min_motion`, all-zero ones among
        them: warn and leave them out by name (their weights are 0), or refuse.
    dependent : {"refuse", "drop"}
        What to do with a unit that is a mixture (or a copy) of units before it, up to 1e-5 of
        its size: its weight would be arbitrary.
    min_motion : float, default=0.1
        Millimetres.

    Returns
    -------
    UnitBasis

    Raises
    ------
    ValueError
        If units are still or dependent and refused, or if none is left.
    """
    if not isinstance(rig, BlendshapeRig):
        raise TypeError(f"rig must be a BlendshapeRig or a UnitBasis, got {type(rig).__name__}.")
    check_choice(still, "still", ("drop", "refuse"))
    check_choice(dependent, "dependent", ("refuse", "drop"))
    min_motion = check_number(min_motion, "min_motion", low=0)
    reach = np.sqrt((rig.deltas**2).sum(axis=2).max(axis=1))
    quiet = (reach < min_motion) | (reach == 0)
    said = ", ".join(f"{rig.names[i]} ({reach[i]:.3g} mm)" for i in np.flatnonzero(quiet))
    if quiet.all():
        raise ValueError(
            f"rig has no unit that moves the mesh by min_motion={min_motion:g} mm: {said}; "
            "are its deltas in millimetres?"
        )
    if quiet.any() and still == "refuse":
        raise ValueError(
            f"rig holds units that move the mesh by less than min_motion={min_motion:g} mm: "
            f'{said}; remove them, or let still="drop" leave them out.'
        )
    if quiet.any():
        warnings.warn(f"left out, less than {min_motion:g} mm: {said}.", stacklevel=2)
    kept = np.flatnonzero(~quiet)
    D = np.asarray(rig.deltas[kept], dtype=float).reshape(len(kept), -1).T
    if D.shape[0] < D.shape[1]:
        raise ValueError(f"{D.shape[1]} units, but only {D.shape[0]} coordinates; use fewer units.")
    with _threads.limit(limits=1):
        Q, R = np.linalg.qr(D)
        copies = np.abs(np.diag(R)) < DEPENDENT * np.linalg.norm(R, axis=0)
        if copies.any():
            said = _mixtures([rig.names[i] for i in kept], R, copies)
            if dependent == "refuse":
                raise ValueError(
                    f"rig holds units that follow from others: {said}; remove them, or leave them "
                    'out with prepare_units(rig, dependent="drop").'
                )
            warnings.warn(f"left out, they follow from others: {said}.", stacklevel=2)
            kept = kept[~copies]
            Q, R = np.linalg.qr(D[:, ~copies])
    return UnitBasis(rig, kept, Q, R)


def _mixtures(names, R, copies):
    """The dependent units, each with the others that make it."""
    own = np.flatnonzero(~copies)
    said = []
    for i in np.flatnonzero(copies):
        before = own[own < i]
        share = np.linalg.lstsq(R[:, before], R[:, i], rcond=None)[0]
        parts = [f"{s:.2g} {names[b]}" for b, s in zip(before, share, strict=True) if abs(s) > 0.01]
        said.append(f"{names[i]} = {' + '.join(parts)}")
    return "; ".join(said)


def _as_basis(rig):
    return rig if isinstance(rig, UnitBasis) else prepare_units(rig)


# -- The sketch -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Alignment:
    """Rigid motion that carries a sketch to the neutral's place: x -> rotation @ x + shift.

    Parameters
    ----------
    rotation : ndarray of shape (3, 3)
    shift : ndarray of shape (3,)
        Millimetres.
    rms : float
        How far it moves the sketch's vertices, millimetres.
    """

    rotation: np.ndarray
    shift: np.ndarray
    rms: float

    @property
    def degrees(self):
        """Angle of the rotation."""
        return float(np.degrees(np.arccos(np.clip((np.trace(self.rotation) - 1) / 2, -1, 1))))


def find_alignment(rig, sketch):
    """The rigid motion of a sketch that no mixture of the units explains.

    A best rigid fit alone would take an open jaw for a nod. Here units (with free weights) and
    rigid motion are fitted together, so a rig's own expressions are found aligned exactly.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
        Millimetres.

    Returns
    -------
    Alignment
    """
    basis = _as_basis(rig)
    return _alignment(basis, _vertices(basis, sketch))


def _alignment(basis, V, far=True):
    N = basis.rig.neutral.vertices
    centre = N.mean(axis=0)
    X = V - centre
    A, b = np.eye(3), np.zeros(3)
    if far:  # Kabsch: nearly there from anywhere
        U, _, Wt = np.linalg.svd((X - X.mean(axis=0)).T @ (N - centre))
        A = (U @ np.diag([1, 1, np.linalg.det(U @ Wt)]) @ Wt).T
        b = -A @ X.mean(axis=0)
    for _ in range(50):
        x = basis.rigid @ (X @ A.T + b + centre - N).ravel()
        step = _rotation(-x[:3])
        A, b = step @ A, step @ b - x[3:]
        if np.abs(x).max() < 1e-9:
            break
    moved = X @ A.T + b - X
    return Alignment(A, b + centre - A @ centre, float(np.sqrt((moved**2).sum(axis=1).mean())))


def _rotation(x):
    """Rotation by the vector x, radians (Rodrigues)."""
    angle = np.linalg.norm(x)
    if angle == 0:
        return np.eye(3)
    K = np.cross(np.eye(3), x / angle)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def _vertices(basis, sketch):
    n = basis.rig.neutral.n_vertices
    V = sketch.vertices if isinstance(sketch, TriangleMesh) else sketch
    if np.shape(V) != (n, 3):
        raise ValueError(
            f"sketch has shape {np.shape(V)}, but the rig's mesh asks for ({n}, 3): fit the "
            "template to the sketch first, or take the rig on the sketch's vertices (rig.on)."
        )
    return as_finite(V, "sketch", (n, 3))


def _displacement(basis, sketch, align):
    """d of Eq. 3, flat, millimetres, and the alignment applied (None if none)."""
    if align not in ("check", True, False):
        raise ValueError(f'align={align!r} is unknown; choose "check", True or False.')
    V, N = _vertices(basis, sketch), basis.rig.neutral.vertices
    if align is False:
        return (V - N).ravel(), None
    size = np.sqrt(((V - V.mean(axis=0)) ** 2).sum() / ((N - N.mean(axis=0)) ** 2).sum())
    if not 0.8 < size < 1.25:
        raise ValueError(
            f"sketch is {size:.3g} times the size of the neutral face: bring it to millimetres and "
            "to this face's size, or pass align=False to take it as it is."
        )
    x = basis.rigid @ (V - N).ravel()
    if align == "check":
        turn = np.cross(x[:3], N - N.mean(axis=0)) + x[3:]
        if np.sqrt((turn**2).sum(axis=1).mean()) <= MISALIGNED:
            return (V - N).ravel(), None
        found = _alignment(basis, V)
        raise ValueError(
            f"sketch is not aligned with the neutral face: a turn of {found.degrees:.1f} degrees "
            f"and a shift, {found.rms:.1f} mm RMS in all, that no units explain (allowed: "
            f"{MISALIGNED:g} mm); pass align=True to take it out, or align=False to fit it so."
        )
    found = _alignment(basis, V)
    return (V @ found.rotation.T + found.shift - N).ravel(), found


# -- The bounded least squares, exactly -------------------------------------------------------


def _pivot(solve, times, g, lo, hi, at=None):
    """Minimise w' H w / 2 - g' w with lo <= w <= hi by block principal pivoting, exactly.

    All variables on the wrong side change sides at once; if their number has not fallen for ten
    rounds, only the last of them does (Murty's rule, which must end).

    Parameters
    ----------
    solve : callable (free, w) -> w
        Fills in w where free, the rest held: H_ff w_f = g_f - H_fb w_b.
    times : callable w -> H w
        H is symmetric positive definite.
    at : ndarray of int, shape (n,), optional
        Side to start from: -1 at lo, 1 at hi, 0 free.

    Returns
    -------
    w, at : ndarray of shape (n,)
    """
    fixed = lo == hi
    at = np.where(fixed, -1, 0 if at is None else at)
    slack = 1e-12 * np.abs(g).max(initial=0) + 1e-15
    fewest, patience = len(g) + 1, 10
    for _ in range(200 + 50 * len(g)):
        w = solve(at == 0, np.where(at < 0, lo, np.where(at > 0, hi, 0.0)))
        y = times(w) - g
        below = (at == 0) & (w < lo - 1e-12)
        above = (at == 0) & (w > hi + 1e-12)
        wrong = below | above | ((at * y > slack) & ~fixed)
        count = np.count_nonzero(wrong)
        if not count:
            return w.clip(lo, hi), at
        if count < fewest:
            fewest, patience = count, 10
        elif patience:
            patience -= 1
        else:
            wrong &= np.arange(len(g)) == np.flatnonzero(wrong)[-1]
        at[wrong] = np.where(below, -1, np.where(above, 1, 0))[wrong]
    raise AssertionError("pivoting did not end: H is not positive definite")


def _bounded(H, g, lo, hi, at=None):
    """`_pivot` with a dense H of shape (K, K)."""

    def solve(free, w):
        f = np.flatnonzero(free)
        w[f] = np.linalg.solve(H[np.ix_(f, f)], g[f] - H[f] @ w)  # w[f] is 0 on the right
        return w

    return _pivot(solve, lambda w: H @ w, g, lo, hi, at)


def _path(H, g, pull, lo, hi, start, stop):
    """All w(alpha) = argmin w' H w / 2 - (g + alpha pull)' w within bounds: its knots.

    Between knots the same units are free and w is linear in alpha. At a knot one unit reaches a
    bound or leaves it, and the inverse of the free block is updated by one rank.

    Returns
    -------
    knots : ndarray of shape (n_knots,)
        From start to stop, ascending.
    W : ndarray of shape (n_knots, K)
    """
    fixed, alpha = lo == hi, start
    w, at = _bounded(H, g + alpha * pull, lo, hi)
    M = _free_inverse(H, at)
    w = w + M @ (g + alpha * pull - H @ w)
    y = H @ w - g - alpha * pull
    knots, W, stuck = [alpha], [w], 0
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(200 + 50 * len(g)):
            free, w_rate = at == 0, M @ pull
            y_rate = H @ w_rate - pull
            to_bound = (np.where(w_rate > 0, hi, lo) - w) / w_rate
            ahead = np.where(free, to_bound, -y / y_rate)
            moving = np.where(free, np.abs(w_rate), at * y_rate) > 1e-14
            ahead[~moving | fixed] = np.inf
            k = int(ahead.argmin())
            step = max(float(ahead[k]), 0.0)
            if alpha + step >= stop:
                w = w + (stop - alpha) * w_rate
                knots.append(stop)
                W.append(w + M @ (g + stop * pull - H @ w))
                return np.array(knots), np.array(W).clip(lo, hi)
            alpha += step
            w = w + step * w_rate
            stuck = 0 if step > 1e-12 * (1 + abs(alpha)) else stuck + 1
            if free[k]:
                at[k] = 1 if w_rate[k] > 0 else -1
                w[k] = hi[k] if w_rate[k] > 0 else lo[k]
                M -= M[:, k, None] * (M[k] / M[k, k])
                M[k], M[:, k] = 0, 0
            y = H @ w - g - alpha * pull
            w = w - M @ y  # takes out rounding: M is 0 beyond the free
            if not free[k]:
                at[k] = 0
                v = M @ H[k]
                left = H[k, k] - H[k] @ v
                v[k] = -1
                M += v[:, None] * (v / left)
            if stuck > 2 * len(g):  # tied units change sides in circles: start afresh just beyond
                alpha += 1e-9 * (1 + abs(alpha))
                w, at = _bounded(H, g + alpha * pull, lo, hi, at)
                M, y, stuck = _free_inverse(H, at), H @ w - g - alpha * pull, 0
            elif len(knots) % 32 == 0:
                M = _free_inverse(H, at)
            knots.append(alpha)
            W.append(w)
    raise AssertionError("the path over alpha did not end")


def _free_inverse(H, at):
    M, f = np.zeros_like(H), np.flatnonzero(at == 0)
    M[np.ix_(f, f)] = np.linalg.inv(H[np.ix_(f, f)])
    return M


def _along(knots, W, alphas):
    """The path at any alphas: linear between knots."""
    k = np.clip(np.searchsorted(knots, alphas, side="right") - 1, 0, len(knots) - 2)
    length = knots[k + 1] - knots[k]
    share = (alphas - knots[k]) / np.where(length > 0, length, 1)
    return W[k] + share[:, None] * (W[k + 1] - W[k])


def _weights_over(H, g, pull, lo, hi, alphas):
    """Knots, their weights, and the weights at the alphas."""
    with _threads.limit(limits=1):
        knots, W = _path(H, g, pull, lo, hi, alphas.min(), alphas.max())
    return knots, W, _along(knots, W, alphas)


def _bounds(names, bounds, locked=None, excluded=()):
    """lo and hi of every unit, shape (K,) each, locks and exclusions put in."""
    K = len(names)
    lo, hi = np.zeros(K), np.ones(K)
    excluded = [excluded] if isinstance(excluded, str) else list(excluded)
    named = dict(locked or {})
    unknown = sorted({*named, *excluded, *(bounds if isinstance(bounds, dict) else ())} - {*names})
    if unknown:
        raise ValueError(f"unknown unit(s) {', '.join(unknown)}; this rig has {', '.join(names)}.")
    both = sorted({*named} & {*excluded})
    if both:
        raise ValueError(f"{', '.join(both)} is both locked and excluded; choose one.")
    if isinstance(bounds, dict):
        for name, (low, high) in bounds.items():
            lo[names.index(name)] = -np.inf if low is None else low
            hi[names.index(name)] = np.inf if high is None else high
    else:
        if not isinstance(bounds, tuple | list | np.ndarray | None):
            raise TypeError(f"bounds={bounds!r}: give None, a pair, or a dict of pairs by name.")
        if bounds is not None and len(bounds) != 2:
            raise ValueError(f"bounds has {len(bounds)} parts, but needs two: lower and upper.")
        for array, bound, none in zip(
            (lo, hi), bounds or (None, None), (-np.inf, np.inf), strict=True
        ):
            bound = np.asarray(none if bound is None else bound, dtype=float)
            if bound.shape not in ((), (K,)):
                raise ValueError(f"bounds has shape {bound.shape}, but {K} units need ({K},).")
            array[:] = bound
    if np.isnan(lo).any() or np.isnan(hi).any():
        raise ValueError("bounds holds NaN; use None for no bound.")
    for name, value in {**dict.fromkeys(excluded, 0.0), **named}.items():
        lo[names.index(name)] = hi[names.index(name)] = check_number(value, f"locked[{name!r}]")
    crossed = np.flatnonzero(lo > hi)
    if crossed.size:
        said = ", ".join(f"{names[i]} ({lo[i]:g} > {hi[i]:g})" for i in crossed[:6])
        raise ValueError(f"bounds: the lower is above the upper for {said}; swap them.")
    return lo, hi


# -- Regression -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ExpressionFit:
    """What `regress_expression` found: weights of every unit for every alpha.

    Attributes
    ----------
    alphas : ndarray of shape (A,)
    weights : ndarray of shape (A, K)
        In the order of `names`; dropped and excluded units have 0.
    rms : ndarray of shape (A,)
        Root mean squared distance a vertex to the sketch, millimetres.
    e_rms : ndarray of shape (A,)
        Eq. 10 as printed: rms / sqrt(n_vertices).
    kkt : ndarray of shape (A,)
        Residual of the optimality conditions relative to max |D^T d|.
    reachable : ndarray of bool, shape (A,)
        Whether the bounds allow weights that sum to alpha; where not, alpha only pulls.
    sums : ndarray of shape (A,)
        Sums of the weights, to hold against `alphas`.
    knots : ndarray of shape (n_knots,)
        Alphas at which a unit reaches or leaves a bound; in between the weights are linear.
    knot_weights : ndarray of shape (n_knots, K)
    criterion : str
        How `best` is chosen.
    lo, hi : ndarray of shape (K,)
        Bounds, locked units with both the same.
    alignment : Alignment or None
        What was taken out of the sketch.
    displacement : ndarray of shape (n_vertices, 3)
        The (aligned) sketch minus the neutral, millimetres.
    """

    basis: UnitBasis
    alphas: np.ndarray
    weights: np.ndarray
    rms: np.ndarray
    kkt: np.ndarray
    knots: np.ndarray
    knot_weights: np.ndarray
    lo: np.ndarray
    hi: np.ndarray
    displacement: np.ndarray
    lam: float
    per_vertex: bool
    criterion: str
    alignment: Alignment | None = None
    _chosen: dict = field(default_factory=dict, repr=False)

    def __repr__(self):
        i = self.best
        return (
            f"ExpressionFit({len(self.alphas)} alphas, {int((~self.reachable).sum())} of them out "
            f"of reach; best by {self.criterion}: alpha={self.alphas[i]:g}, {self.rms[i]:.3f} mm)"
        )

    @property
    def names(self):
        """Units, in the order of the weights."""
        return self.basis.rig.names

    @property
    def dropped(self):
        """Units left out because they hardly move the mesh or follow from others."""
        return self.basis.dropped

    @property
    def e_rms(self):
        """Eq. 10 as printed, with n outside the root: shape (A,)."""
        return self.rms / np.sqrt(self.basis.rig.neutral.n_vertices)

    @property
    def sums(self):
        """Sums of the weights, shape (A,)."""
        return self.weights.sum(axis=1)

    @property
    def reachable(self):
        """True where the bounds allow sum(w) = alpha: shape (A,)."""
        k = self.basis.kept
        slack = 1e-9 * (1 + np.abs(self.alphas))
        low, high = self.lo[k].sum(), self.hi[k].sum()
        return (self.alphas >= low - slack) & (self.alphas <= high + slack)

    @property
    def best(self):
        """Index of the best alpha by `criterion`."""
        return self.choose(self.criterion)

    def choose(self, criterion):
        """Index of the best alpha, among those in reach if any is.

        Parameters
        ----------
        criterion : {"e_rms", "held_out", "gcv", "fewest"}
            e_rms: the paper's. Within fixed bounds its best alpha is always the sum of the plain
            bounded fit, where both terms of Eq. 9 are smallest, so alpha adds nothing.
            held_out: the smallest error on patches of the face left out in turn.
            gcv: generalised cross-validation, units within their bounds as degrees of freedom.
            fewest: the fewest units above 0.05 within 5 % (and 0.01 mm) of the smallest rms.
        """
        check_choice(criterion, "criterion", CRITERIA)
        if criterion not in self._chosen:
            score = getattr(self, f"_{criterion}")()
            allowed = self.reachable if self.reachable.any() else np.ones(len(score), dtype=bool)
            self._chosen[criterion] = int(np.where(allowed, score, np.inf).argmin())
        return self._chosen[criterion]

    def _e_rms(self):
        return self.rms

    def _gcv(self):
        inside = (self.weights > self.lo + 1e-9) & (self.weights < self.hi - 1e-9)
        dof = inside[:, self.basis.kept].sum(axis=1)
        return self.rms / np.maximum(1 - dof / self.displacement.size, 1e-9)

    def _fewest(self):
        close = self.rms <= 1.05 * self.rms.min() + 0.01
        count = (np.abs(self.weights) > 0.05).sum(axis=1)
        return np.where(close, count + self.rms / (1 + self.rms.max()), np.inf)

    def _held_out(self, n_folds=5, n_patches=50):
        return held_out_error(self, n_folds, n_patches)

    def at(self, alpha):
        """Exact weights at any alpha of the range fitted, shape (K,)."""
        alpha = check_number(alpha, "alpha", low=self.knots[0], high=self.knots[-1])
        return _along(self.knots, self.knot_weights, np.array([alpha]))[0]

    def vertices(self, index=None, clamp=False):
        """The optimised face S_0 + sum w_i d_i, Eq. 1: shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        index : int, optional
            Which alpha; the best if left out.
        clamp : bool, default=False
            Let vertices beyond their boundary fall back to it.
        """
        rig, moved = self.basis.rig, self._moved(index)
        if clamp:
            length = np.linalg.norm(moved, axis=1)
            share = self.basis.limit / np.maximum(length, 1e-300)
            moved = moved * np.minimum(1, share)[:, None]
        return rig.neutral.vertices + moved

    def excess(self, index=None):
        """How far each vertex goes beyond its boundary, mm, shape (n_vertices,); mostly 0.

        The boundary of a vertex is the largest displacement that any one unit gives it. Weights
        within [0, 1] do not keep it: units add up.
        """
        return np.maximum(np.linalg.norm(self._moved(index), axis=1) - self.basis.limit, 0)

    def _moved(self, index):
        w = self.weights[self.best if index is None else index]
        return np.tensordot(w, self.basis.rig.deltas, axes=1)

    def negative(self, index=None, least=0.01):
        """Names of the units with a weight below -least."""
        w = self.weights[self.best if index is None else index]
        return tuple(n for n, x in zip(self.names, w, strict=True) if x < -least)

    def cancelling(self, index=None, cosine=-0.5, least=0.1):
        """Pairs of units that work against each other.

        Two units cancel if the displacement fields they add, w_i d_i and w_j d_j, make a cosine
        below `cosine`, and both somewhere move a vertex by `least` millimetres or more.

        Returns
        -------
        list of (str, str)
        """
        k = self.basis.kept
        w = self.weights[self.best if index is None else index][k]
        reach = np.linalg.norm(self.basis.rig.deltas[k], axis=2).max(axis=1)
        size = np.sqrt(np.diag(self.basis.gram))
        C = self.basis.gram / np.outer(size, size) * np.outer(np.sign(w), np.sign(w))
        used = np.abs(w) * reach >= least
        pairs = np.argwhere(np.triu((C < cosine) & np.outer(used, used), 1))
        return [(self.names[k[i]], self.names[k[j]]) for i, j in pairs]

    def roles(self, share=0.25, least=0.01):
        """Dominant and auxiliary units.

        Dominant: at the smallest alpha, the coarse fit, the unit moves the face (RMS of w_i d_i)
        by at least `share` of what the strongest does. Auxiliary: the others that exceed `least`
        at some alpha.

        Returns
        -------
        dominant, auxiliary : tuple of str
        """
        k, size = self.basis.kept, np.zeros(len(self.names))
        size[k] = np.sqrt(np.diag(self.basis.gram))
        w = self.weights[self.alphas.argmin()]
        strength = np.abs(w) * size
        main = (strength >= share * strength.max()) & (np.abs(w) > least)
        rest = (np.abs(self.weights) > least).any(axis=0) & ~main
        return tuple(tuple(self.names[i] for i in np.flatnonzero(m)) for m in (main, rest))


def regress_expression(
    rig,
    sketch,
    lam=1.0,
    alphas=range(101),
    bounds=(0, 1),
    *,
    locked=None,
    excluded=(),
    align="check",
    criterion="e_rms",
    per_vertex=True,
):
    """Find the action units that make a sketched expression, for every alpha at once.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
        A basis from `prepare_units` saves the set-up.
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
        On the vertices of the rig, millimetres.
    lam : float, default=1.0
        Weight of sum(w) = alpha, millimetres.
    alphas : iterable of float
        Wanted sums of the weights (no unit).
    bounds : None, (lower, upper) or dict of str to (lower, upper)
        None as a bound is no bound; a bound may be an array of shape (K,). Units that a dict does
        not name have (0, 1).
    locked : dict of str to float, optional
        Weights set by hand.
    excluded : iterable of str
        Units held at 0.
    align : {"check", True, False}
        Refuse a sketch with rigid motion beyond 2 mm RMS, take rigid motion out, or fit as it is.
    criterion : str
        How `best` is chosen, see `ExpressionFit.choose`.
    per_vertex : bool, default=True
        Divide the first term by n_vertices; False is Eq. 9 as printed.

    Returns
    -------
    ExpressionFit

    Raises
    ------
    ValueError
        For NaN, another vertex count, a sketch that is not aligned, bounds that cross, unknown or
        dropped units, no alphas, and what `prepare_units` refuses.

    Warns
    -----
    UserWarning
        If none of the alphas can be reached within the bounds.

    References
    ----------
    Yu and Liu 2014, Eq. 9 and 10, Algorithm 1.
    """
    basis = _as_basis(rig)
    lam = check_number(lam, "lam", low=0)
    check_choice(criterion, "criterion", CRITERIA)
    alphas = as_finite(np.atleast_1d(np.asarray(list(np.atleast_1d(alphas)))), "alphas", ("A",))
    if not alphas.size:
        raise ValueError("alphas is empty: give one number or more, such as range(101).")
    lo, hi = _bounds(basis.rig.names, bounds, locked, excluded)
    gone = [n for n in (locked or {}) if n in basis.dropped]
    if gone:
        raise ValueError(f"locked names {', '.join(gone)}, left out of this rig; unlock.")
    d, alignment = _displacement(basis, sketch, align)
    n, k = basis.rig.neutral.n_vertices, basis.kept
    scale = 1 / n if per_vertex else 1.0
    c, outside = _project(basis, d)
    H = scale * basis.gram + lam**2  # 11^T added: Eq. 9
    b = scale * (basis.R.T @ c)
    pull = np.full(len(k), lam**2)
    knots, W, w = _weights_over(H, b, pull, lo[k], hi[k], alphas)
    off = w @ basis.R.T - c
    fit = ExpressionFit(
        basis=basis,
        alphas=alphas,
        weights=_spread(w, basis),
        rms=np.sqrt(((off**2).sum(axis=1) + outside) / n),
        kkt=_kkt(H, b, pull, lo[k], hi[k], alphas, w),
        knots=knots,
        knot_weights=_spread(W, basis),
        lo=lo,
        hi=hi,
        displacement=d.reshape(n, 3),
        lam=lam,
        per_vertex=per_vertex,
        criterion=criterion,
        alignment=alignment,
    )
    if lam > 0 and not fit.reachable.any():
        warnings.warn(
            f"no alpha can be reached: the bounds allow sums from {lo[k].sum():g} to "
            f"{hi[k].sum():g}, alphas run from {alphas.min():g} to {alphas.max():g}; they only "
            "pull the weights towards a bound.",
            stacklevel=2,
        )
    return fit


def _project(basis, d):
    """Q^T d, and the squared length of what lies outside the units, square millimetres."""
    c = basis.Q.T @ d
    return c, float(((d - basis.Q @ c) ** 2).sum())


def _spread(w, basis):
    """Weights of the kept units (..., n_kept) among all units, (..., K)."""
    full = np.zeros((*w.shape[:-1], len(basis.rig.names)))
    full[..., basis.kept] = w
    return full


def _kkt(H, b, pull, lo, hi, alphas, w):
    """Largest violation of the optimality conditions at each alpha, relative to max |b|."""
    y = w @ H - b - alphas[:, None] * pull
    off = np.where(w <= lo, np.minimum(y, 0), np.where(w >= hi, np.maximum(y, 0), y))
    off = np.where(lo == hi, 0, off)
    return np.abs(off).max(axis=1) / (np.abs(b).max() or 1)


def held_out_error(fit, n_folds=5, n_patches=50):
    """Error of a fit's alphas on patches of the face that were left out in turn.

    Parameters
    ----------
    fit : ExpressionFit
    n_folds, n_patches : int
        The face is cut into patches around evenly chosen vertices, dealt out to the folds.

    Returns
    -------
    ndarray of shape (A,)
        RMS distance a vertex, millimetres.
    """
    basis, d, n = fit.basis, fit.displacement, fit.basis.rig.neutral.n_vertices
    k = basis.kept
    V = basis.rig.neutral.vertices
    seeds = np.random.default_rng(0).permutation(n)[: min(n_patches, n)]
    fold = cKDTree(V[seeds]).query(V)[1] % n_folds
    scale = 1.0 if fit.per_vertex else n
    b = basis.R.T @ (basis.Q.T @ d.ravel())
    pull = np.full(len(k), fit.lam**2)
    total = np.zeros(len(fit.alphas))
    for f in range(n_folds):
        out = fold == f
        if out.all() or not out.any():
            continue
        D = np.asarray(basis.rig.deltas[np.ix_(k, np.flatnonzero(out))], dtype=float)
        D = D.reshape(len(k), -1)
        G, g = D @ D.T, D @ d[out].ravel()
        H = scale / (n - out.sum()) * (basis.gram - G) + fit.lam**2
        H[np.diag_indices(len(k))] += 1e-7 * np.trace(basis.gram) / n * scale / len(k)
        inside = scale / (n - out.sum()) * (b - g)
        w = _weights_over(H, inside, pull, fit.lo[k], fit.hi[k], fit.alphas)[2]
        total += ((w @ G) * w).sum(axis=1) - 2 * w @ g + (d[out] ** 2).sum()
    return np.sqrt(np.maximum(total, 0) / n)


# -- Peers ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LeastSquaresFit:
    """Plain least squares, Eq. 4 and 5.

    Attributes
    ----------
    weights : ndarray of shape (K,)
        Those of smallest norm among the best, with no bounds.
    rms : float
        Millimetres.
    rank : int
        Of D. Below K, (D^T D)^-1 of Eq. 5 does not exist.
    condition : float
        Largest over smallest singular value of D; inf if rank < K.
    names : tuple of str
    """

    weights: np.ndarray
    rms: float
    rank: int
    condition: float
    names: tuple


def least_squares(rig, sketch):
    """Plain least squares, any sign and size of weight; dependent and still units are let in.

    Parameters
    ----------
    rig : BlendshapeRig
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
        Millimetres; not checked for rigid motion.

    Returns
    -------
    LeastSquaresFit

    References
    ----------
    Yu and Liu 2014, Eq. 4 and 5.
    """
    rig = rig.rig if isinstance(rig, UnitBasis) else rig
    n, K = rig.neutral.n_vertices, len(rig.names)
    basis = UnitBasis(rig, np.arange(K), None, None)
    d = (_vertices(basis, sketch) - rig.neutral.vertices).ravel()
    D = np.asarray(rig.deltas, dtype=float).reshape(K, -1).T
    w, _, rank, s = np.linalg.lstsq(D, d, rcond=1e-7)
    return LeastSquaresFit(
        weights=w,
        rms=float(np.sqrt(((D @ w - d) ** 2).sum() / n)),
        rank=int(rank),
        condition=float(s[0] / s[-1]) if rank == K else np.inf,
        names=rig.names,
    )


@dataclass(frozen=True, eq=False)
class TwoStepFit:
    """Dominant units first, then the rest, Eq. 6.

    Attributes
    ----------
    weights : ndarray of shape (K,)
        W_1 and W_r together.
    coarse : ndarray of shape (K,)
        W_1: the dominant units alone.
    dominant : tuple of str
    rms, coarse_rms : float
        Millimetres, after both steps and after the first.
    names : tuple of str
    """

    weights: np.ndarray
    coarse: np.ndarray
    dominant: tuple
    rms: float
    coarse_rms: float
    names: tuple


def two_step(rig, sketch, lam=1.0, bounds=(0, 1), share=0.25, align="check", per_vertex=True):
    """Fit the dominant units alone, then let the others explain what is left.

    The paper prints no rule for what is dominant; here the fit at alpha = 0 tells (its coarse
    regression), see `ExpressionFit.roles`. Both steps are bounded least squares without lam.

    Parameters
    ----------
    rig, sketch, lam, bounds, align, per_vertex
        As for `regress_expression`; lam only serves to find the dominant units.
    share : float, default=0.25
        A unit is dominant if it moves the face by this share of the strongest one.

    Returns
    -------
    TwoStepFit

    References
    ----------
    Yu and Liu 2014, Eq. 6 and 7 (whose right side is not printed).
    """
    basis = _as_basis(rig)
    d, _ = _displacement(basis, sketch, align)
    V = basis.rig.neutral.vertices + d.reshape(-1, 3)
    given = {"bounds": bounds, "align": False, "per_vertex": per_vertex}
    dominant, _ = regress_expression(basis, V, lam, [0], **given).roles(share)
    rest = [n for n in basis.rig.names if n not in dominant]
    coarse = regress_expression(basis, V, 0, [0], excluded=rest, **given)
    held = {n: coarse.weights[0, basis.rig.names.index(n)] for n in dominant}
    fine = regress_expression(basis, V, 0, [0], locked=held, **given)
    return TwoStepFit(
        fine.weights[0],
        coarse.weights[0],
        dominant,
        float(fine.rms[0]),
        float(coarse.rms[0]),
        basis.rig.names,
    )


# -- Sequences --------------------------------------------------------------------------------


def regress_sequence(
    rig, motion, lam=0.0, alpha=0.0, bounds=(0, 1), smooth=0.004, *, visible=None, align="check"
):
    """Weights over time: all frames together, the weights bound to change little.

    Minimises the sum over frames of

        ||D w_t - d_t||^2 / n + lam^2 (sum(w_t) - alpha)^2 + (smooth fps)^2 ||w_t - w_(t-1)||^2

    within bounds, exactly. Lost frames and hidden vertices have no first term; the smoothness
    carries the weights across them.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
    motion : MotionSequence
        On the vertices of the rig, head motion removed, millimetres.
    lam, alpha, bounds
        As for `regress_expression`, the same in every frame.
    smooth : float, default=0.004
        Millimetre seconds: a weight that changes by 1 a second costs what an error of `smooth`
        millimetres at every vertex does, whatever the frame rate.
    visible : ndarray of bool, shape (n_frames, n_vertices), optional
        False where a vertex was hidden; its positions are not looked at.
    align : {"check", False}
        Refuse motion whose frames are, in the median, moved rigidly by more than 2 mm RMS.

    Returns
    -------
    WeightSequence
        Every frame valid: lost ones are filled in.

    Raises
    ------
    ValueError
        For another vertex count, no data at all, lost frames without smoothness, or motion that
        is not aligned.
    """
    if not isinstance(motion, MotionSequence):
        raise TypeError(f"motion must be a MotionSequence, got {type(motion).__name__}.")
    basis = _as_basis(rig)
    n, k, F = basis.rig.neutral.n_vertices, basis.kept, motion.n_frames
    if motion.positions.shape[1] != n:
        raise ValueError(
            f"motion has {motion.positions.shape[1]} vertices, the rig {n}; take the rig on the "
            "vertices of the motion (rig.on)."
        )
    if align not in ("check", False):
        raise ValueError(f'align={align!r} is unknown here; choose "check" or False.')
    lam, alpha = check_number(lam, "lam", low=0), check_number(alpha, "alpha")
    mu = (check_number(smooth, "smooth", low=0) * motion.fps) ** 2
    lo, hi = _bounds(basis.rig.names, bounds)
    lo, hi = np.tile(lo[k], F), np.tile(hi[k], F)
    seen = motion.valid[:, None] if visible is None else _visible(visible, motion)
    if not seen.any():
        raise ValueError("motion has no valid frame with a visible vertex; nothing can be fitted.")
    if mu == 0 and not seen.all():
        raise ValueError("smooth=0, but vertices or frames are missing; give smooth above 0.")
    with _threads.limit(limits=1):
        b, turn = _sequence_sides(basis, motion, seen)
        whole = seen.all(axis=1)
        if align == "check" and whole.any() and np.median(turn[whole]) > MISALIGNED:
            raise ValueError(
                f"motion is not aligned with the neutral face: its frames are moved rigidly by "
                f"{np.median(turn[whole]):.1f} mm RMS (median; allowed: {MISALIGNED:g}) beyond "
                "what units explain; take out the head motion, or pass align=False."
            )
        H = _sequence_grams(basis, seen) + lam**2
        g = (b + lam**2 * alpha).ravel()
        w = _banded(H, g, mu, lo, hi, F)
    return WeightSequence(_spread(w.reshape(F, -1), basis), basis.rig.names, motion.fps)


def _visible(visible, motion):
    visible = np.asarray(visible)
    if visible.shape != motion.positions.shape[:2] or visible.dtype != bool:
        raise ValueError(
            f"visible has shape {visible.shape} and type {visible.dtype}, but needs one bool for "
            f"each of {motion.positions.shape[:2]} frames and vertices."
        )
    return visible & motion.valid[:, None]


def _sequence_sides(basis, motion, seen, chunk=64):
    """D^T d_t / n, (F, n_kept), and the rigid motion of every frame, (F,), millimetres RMS."""
    N, n = basis.rig.neutral.vertices, basis.rig.neutral.n_vertices
    V = N - N.mean(axis=0)
    spread = V.T @ V / n
    b, turn = [], []
    for start in range(0, motion.n_frames, chunk):
        part = slice(start, start + chunk)
        d = np.where(seen[part, :, None], motion.positions[part] - N, 0).reshape(-1, 3 * n)
        b.append(d @ basis.Q @ basis.R / n)
        x = d @ basis.rigid.T
        r, t = x[:, :3], x[:, 3:]
        # mean |r x v + t|^2 over centred v
        size = (r**2).sum(axis=1) * np.trace(spread) - ((r @ spread) * r).sum(axis=1)
        turn.append(np.sqrt(np.maximum(size, 0) + (t**2).sum(axis=1)))
    return np.concatenate(b), np.concatenate(turn)


def _sequence_grams(basis, seen):
    """D^T D / n over the visible vertices: (1, k, k) if all are the same, (F, k, k) else."""
    n = basis.rig.neutral.n_vertices
    if seen.all():
        return basis.gram[None] / n
    if seen.shape[1] == 1:
        return seen[:, :, None] * basis.gram / n
    D = np.asarray(basis.rig.deltas[basis.kept], dtype=float).transpose(1, 2, 0)
    known, grams = {}, []
    for mask in seen:
        key = mask.tobytes()
        if key not in known:
            few = mask if mask.sum() < n / 2 else ~mask
            part = D[few].reshape(-1, D.shape[2])
            G = part.T @ part
            known[key] = (G if few is mask else basis.gram - G) / n
        grams.append(known[key])
    return np.stack(grams)


def _banded(H, g, mu, lo, hi, F):
    """`_pivot` for frames in a row: block-tridiagonal, factored as a band of width K."""
    k = H.shape[-1]
    ends = np.full(F, 2.0 * mu)
    ends[[0, -1]] -= mu
    ab = np.zeros((k + 1, F, k))
    for i in range(k):
        ab[i, :, : k - i] = np.diagonal(H, i, axis1=1, axis2=2)
    ab[0] += ends[:, None]
    ab[k, : F - 1] = -mu
    ab = ab.reshape(k + 1, -1)

    def times(w):
        W = w.reshape(F, k)
        y = W @ H[0] if len(H) == 1 else (H @ W[..., None])[..., 0]
        y = y + ends[:, None] * W
        y[1:] -= mu * W[:-1]
        y[:-1] -= mu * W[1:]
        return y.ravel()

    def solve(free, w):
        band = ab * free
        for i in range(1, k + 1):
            band[i, :-i] *= free[i:]
        band[0] += ~free
        factor = (cholesky_banded(band, lower=True, overwrite_ab=True, check_finite=False), True)
        for _ in range(2):
            w = w + cho_solve_banded(factor, np.where(free, g - times(w), 0), check_finite=False)
        return w

    return _pivot(solve, times, g, lo, hi)[0]
