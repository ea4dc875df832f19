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

import numpy as np

from facelab.checks import as_finite, check_choice, check_count, check_number
from facelab.expression.units import (
    UnitBasis,
    among_all,
    as_basis,
    read_bounds,
    sketch_displacement,
    sketch_vertices,
)
from facelab.geometry.alignment import Alignment
from facelab.numeric.least_squares import along_path, kkt_residual, weights_over
from facelab.numeric.threads import single_threaded

CRITERIA = ("e_rms", "held_out", "gcv", "fewest")
"""Ways to choose alpha; see `ExpressionFit.choose`."""

LAMS = 0.0, 1e3
"""Ends of lam, millimetres."""

_OPTIMAL = 1e-5  # how far the optimality conditions may be missed, of the largest unit or sketch


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
        return along_path(self.knots, self.knot_weights, np.array([alpha]))[0]

    def vertices(self, index=None, clamp=False):
        """The optimised face S_0 + sum w_i d_i, Eq. 1: shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        index : int, optional
            Which alpha; the best if left out.
        clamp : bool, default=False
            Let vertices beyond their boundary fall back to it.
        """
        moved = self.basis.moved(self._picked(index))
        if clamp:
            moved = self.basis.clamped(moved)
        return self.basis.rig.neutral.vertices + moved

    def excess(self, index=None):
        """How far each vertex goes beyond its boundary, mm, shape (n_vertices,); mostly 0.

        See `UnitBasis.excess`.
        """
        return self.basis.excess(self.basis.moved(self._picked(index)))

    def _picked(self, index):
        return self.weights[self.best if index is None else index]

    def negative(self, index=None, least=0.01):
        """Names of the units with a weight below -least."""
        w = self._picked(index)
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
        w = self._picked(index)[k]
        reach = np.linalg.norm(self.basis.rig.deltas[k], axis=2).max(axis=1)
        size = np.sqrt(np.diag(self.basis.gram))
        C = self.basis.gram / np.outer(size, size) * np.outer(np.sign(w), np.sign(w))
        used = np.abs(w) * reach >= least
        pairs = np.argwhere(np.triu((C < cosine) & np.outer(used, used), 1))
        return [(self.names[k[i]], self.names[k[j]]) for i, j in pairs]

    def roles(self, share=0.25, least=0.01):
        """Dominant and auxiliary units.

        Dominant: at the smallest alpha, the coarse fit, the face would lose at least `share` of
        what it would lose with the strongest: the part of w_i d_i that the other units in use
        could not make up for. (AU30L and AU30R at once, the jaw to both sides, move nothing and
        are no dominant units.) Auxiliary: the others that exceed `least` at some alpha.

        Returns
        -------
        dominant, auxiliary : tuple of str
        """
        w = self.weights[self.alphas.argmin()]
        used = np.abs(w) > least
        inside = used[self.basis.kept]
        own = np.linalg.inv(self.basis.gram[np.ix_(inside, inside)])
        strength = np.zeros(len(w))
        strength[used] = np.abs(w[used]) / np.sqrt(np.diag(own))
        main = used & (strength >= share * strength.max())
        rest = (np.abs(self.weights) > least).any(axis=0) & ~main
        return tuple(tuple(self.names[i] for i in np.flatnonzero(m)) for m in (main, rest))


@single_threaded
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
        Weight of sum(w) = alpha, millimetres: 0 to 1,000, and less where units are alike.
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
        dropped units, no alphas, a lam at which rounding takes over, and what `prepare_units`
        refuses.

    Warns
    -----
    UserWarning
        If none of the alphas can be reached within the bounds.

    References
    ----------
    Yu and Liu 2014, Eq. 9 and 10, Algorithm 1.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> name = next(n for n in rig.names if n in ("AU12L", "mouthSmile_L"))
    >>> fit = facelab.regress_expression(rig, rig.shape({name: 0.6}), alphas=[0.6])
    >>> dict(zip(fit.names, fit.weights[fit.best].round(3).tolist()))[name]
    0.6
    """
    basis = as_basis(rig)
    lam = check_number(lam, "lam", *LAMS)
    check_choice(criterion, "criterion", CRITERIA)
    alphas = as_finite(list(alphas) if np.iterable(alphas) else [alphas], "alphas", ("A",))
    if not alphas.size:
        raise ValueError("alphas is empty: give one number or more, such as range(101).")
    lo, hi = read_bounds(basis.rig.names, bounds, locked, excluded)
    gone = [n for n in (locked or {}) if n in basis.dropped]
    if gone:
        raise ValueError(f"locked names {', '.join(gone)}, left out of this rig; unlock.")
    d, alignment = sketch_displacement(basis, sketch, align)
    n, k = basis.rig.neutral.n_vertices, basis.kept
    scale = 1 / n if per_vertex else 1.0
    c, outside = basis.project(d)
    # the gradient of Eq. 9 is H w - b - alpha pull, with H = D^T D / n + lam^2 1 1^T
    H = scale * basis.gram + lam**2
    b = scale * (basis.R.T @ c)
    pull = np.full(len(k), lam**2)  # lam^2 1: how the right side grows with alpha
    try:
        knots, W, w = weights_over(H, b, pull, lo[k], hi[k], alphas)
        kkt = kkt_residual(H, b, pull, lo[k], hi[k], alphas, w)
    except np.linalg.LinAlgError:
        kkt = np.array([np.inf])
    if not kkt.max() * np.abs(b).max() <= _OPTIMAL * max(np.abs(b).max(), scale * basis.largest):
        raise ValueError(
            f"lam={lam:g} gives Eq. 9 the condition number {np.linalg.cond(H):.0e} with these "
            "units, and rounding takes over; lower lam, or leave out units that are alike."
        )
    off = w @ basis.R.T - c
    fit = ExpressionFit(
        basis=basis,
        alphas=alphas,
        weights=among_all(w, basis),
        rms=np.sqrt(((off**2).sum(axis=1) + outside) / n),
        kkt=kkt,
        knots=knots,
        knot_weights=among_all(W, basis),
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


@single_threaded
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
    n_patches = check_count(n_patches, "n_patches", 2, n, "patches")
    n_folds = check_count(n_folds, "n_folds", 2, n_patches, "folds")
    k = basis.kept
    scale = 1.0 if fit.per_vertex else n
    b = basis.R.T @ (basis.Q.T @ d.ravel())
    pull = np.full(len(k), fit.lam**2)
    total = np.zeros(len(fit.alphas))
    for out, D, G in basis.folds(n_folds, n_patches):
        g = D @ d[out].ravel()
        H = scale / (n - out.sum()) * (basis.gram - G) + fit.lam**2
        H[np.diag_indices(len(k))] += 1e-7 * np.trace(basis.gram) / n * scale / len(k)
        inside = scale / (n - out.sum()) * (b - g)
        w = weights_over(H, inside, pull, fit.lo[k], fit.hi[k], fit.alphas)[2]
        # |D w - d|^2 over the vertices left out, multiplied out: their Gram matrix is enough
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
    d = (sketch_vertices(basis, sketch) - rig.neutral.vertices).ravel()
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


def two_step(rig, sketch, lam=1.0, bounds=(0, 1), share=0.1, align="check", per_vertex=True):
    """Fit the dominant units alone, then let the others explain what is left.

    The paper prints no rule for what is dominant; here the fit at alpha = 0 tells (its coarse
    regression), see `ExpressionFit.roles`. Both steps are bounded least squares without lam.

    Parameters
    ----------
    rig, sketch, lam, bounds, align, per_vertex
        As for `regress_expression`; lam only serves to find the dominant units.
    share : float, default=0.1
        A unit is dominant from this share of the strongest one on.

    Returns
    -------
    TwoStepFit

    References
    ----------
    Yu and Liu 2014, Eq. 6 and 7 (whose right side is not printed).
    """
    basis = as_basis(rig)
    d, _ = sketch_displacement(basis, sketch, align)
    V = basis.rig.neutral.vertices + d.reshape(-1, 3)
    given = {"bounds": bounds, "align": False, "per_vertex": per_vertex}
    dominant, _ = regress_expression(basis, V, lam, [0], **given).roles(share)
    rest = [n for n in basis.rig.names if n not in dominant]
    coarse = regress_expression(basis, V, 0, [0], excluded=rest, **given)  # W_1 D of Eq. 6
    held = {n: coarse.weights[0, basis.rig.names.index(n)] for n in dominant}
    fine = regress_expression(basis, V, 0, [0], locked=held, **given)  # + W_r D_r
    return TwoStepFit(
        fine.weights[0],
        coarse.weights[0],
        dominant,
        float(fine.rms[0]),
        float(coarse.rms[0]),
        basis.rig.names,
    )
