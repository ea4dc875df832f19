"""Which units a rough sketch is made of: those that no error of the sketch could stand for.

The smallest error over alpha (Yu and Liu 2014, section IV) reads every roughness as a unit. Here
a unit stays only if the sketch would lose more without it than its own roughness could feign:

1. bounded least squares (Eq. 4), again and again, with less and less trust in vertices that lie
   far off: patches pushed out of place soon count for nothing (Tukey's biweight);
2. what is left over is split into noise, which differs from neighbour to neighbour, and misfit,
   which neighbours share, and which another person's units or missing ones leave;
3. from all units, the one that the face could best do without is taken out, and the others are
   solved for anew, until each one left is worth more than noise and misfit could be.
"""

from dataclasses import dataclass, field

import numpy as np

from facelab.expression.units import UnitBasis, as_basis, read_bounds, sketch_displacement
from facelab.numeric.least_squares import solve_bounded
from facelab.numeric.threads import single_threaded

OUTLIER = 4.0
"""Scales of the residual from which a vertex counts for nothing."""

MANNER = 0.2
"""Share of its motion by which a vertex may be off before it is out of place."""

SMOOTH_PATCHES = 20
"""Independent places on a face of an error that neighbours share."""

FINEST = 0.01
"""Error that every sketch is granted, millimetres."""

_MEDIAN_LENGTH = 1.538  # of a 3-vector with standard deviation 1 on each axis
_ROUNDS = 12


@dataclass(frozen=True, eq=False)
class UnitReading:
    """What `find_units` found.

    Attributes
    ----------
    weights : ndarray of shape (K,)
        In the order of `names`; 0 for units that are not there.
    moves : ndarray of shape (K,)
        How far each unit, at its weight, moves the face: RMS over the vertices, millimetres.
    trust : ndarray of shape (n_vertices,)
        From 0, out of place, to 1.
    rms : float
        Distance of all vertices, trusted or not, from what the units make, RMS, millimetres.
    noise, misfit : float
        Error of the sketch where it is trusted, millimetres on each axis: what differs from
        neighbour to neighbour, and what neighbours share.
    """

    basis: UnitBasis
    weights: np.ndarray
    moves: np.ndarray
    trust: np.ndarray = field(repr=False)
    rms: float
    noise: float
    misfit: float

    def __repr__(self):
        said = ", ".join(f"{name} {w:.2f}" for name, w in self.units.items())
        return f"UnitReading({said or 'no units'})"

    @property
    def names(self):
        """Units, in the order of the weights."""
        return self.basis.rig.names

    @property
    def units(self):
        """The units that are there and their weights, that which moves the face most first."""
        order = np.argsort(-self.moves, kind="stable")
        return {self.names[i]: float(self.weights[i]) for i in order if self.weights[i] != 0}

    @property
    def vertices(self):
        """The face that they make, Eq. 1: shape (n_vertices, 3), millimetres."""
        return self.basis.rig.neutral.vertices + self.basis.moved(self.weights)

    @property
    def report(self):
        """What was found, what was mistrusted, and how exact the sketch is."""
        lost = 100 * float(np.mean(self.trust < 0.1))
        return (
            f"{self!r}; {lost:.0f} % of the vertices out of place and left out; where it is "
            f"trusted the sketch has {self.noise:.2f} mm of noise and {self.misfit:.2f} mm of "
            "misfit an axis."
        )


@single_threaded
def find_units(rig, sketch, bounds=(0, 1), *, locked=None, excluded=(), align="check"):
    """The few units that a rough sketch is made of, and their weights.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
        A basis from `prepare_units` saves the set-up.
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
        On the vertices of the rig, millimetres.
    bounds, locked, excluded, align
        As for `regress_expression`. Units that are locked always stay.

    Returns
    -------
    UnitReading

    Raises
    ------
    ValueError
        As `regress_expression`.

    Notes
    -----
    For sketches of a few units. A recorded face moves many shapes a little: there the plain fit
    (`regress_expression` with lam=0, `regress_sequence`) has the smaller error, notebook 06.

    References
    ----------
    Yu and Liu 2014, section VI asks whether a method "can accurately filter the right AUs"; the
    way taken here is ours. Tried on mixtures that served to choose nothing: notebook 06.

    Examples
    --------
    >>> import facelab
    >>> from facelab.expression import find_units
    >>> rig = facelab.load_example().rig
    >>> name = next(n for n in rig.names if n in ("AU12L", "mouthSmile_L"))
    >>> [round(w, 3) for w in find_units(rig, rig.shape({name: 0.6})).units.values()]
    [0.6]
    """
    basis = as_basis(rig)
    lo, hi = (b[basis.kept] for b in read_bounds(basis.rig.names, bounds, locked, excluded))
    d, _ = sketch_displacement(basis, sketch, align)
    held = (lo == hi) | (lo > 0) | (hi < 0)
    system, trust, w = _trusted(basis, d, lo, hi)
    noise, misfit = _errors(basis, d, trust, w)
    n = 3 * trust.sum()
    # what noise alone, or a misfit of few independent places, could make a unit seem worth
    worth = np.log(n) * (noise**2 + n / SMOOTH_PATCHES * misfit**2 + FINEST**2)
    w = _fewer(*system, lo, hi, held, worth)
    weights = np.zeros(len(basis.rig.names))
    weights[basis.kept] = w
    size = np.sqrt(np.diag(basis.gram) / basis.rig.neutral.n_vertices)
    moves = np.zeros_like(weights)
    moves[basis.kept] = np.abs(w) * size
    left = d - basis.moved(weights).ravel()
    rms = np.sqrt(left @ left / basis.rig.neutral.n_vertices)
    return UnitReading(basis, weights, moves, trust, float(rms), float(noise), float(misfit))


def _trusted(basis, d, lo, hi):
    """Normal equations (H, g) with trust in each vertex, the trust, and the weights."""
    n = basis.rig.neutral.n_vertices
    D = np.asarray(basis.rig.deltas[basis.kept], dtype=float).reshape(len(basis.kept), -1)
    trust, w = np.ones(n), None
    ridge = 1e-9 * np.trace(basis.gram) / len(D) * np.eye(len(D))
    for _ in range(_ROUNDS):
        weighted = D * np.repeat(trust, 3)
        H, g = weighted @ D.T + ridge, weighted @ d
        before, w = w, solve_bounded(H, g, lo, hi)[0]
        if before is not None and np.abs(w - before).max() < 1e-3:
            break
        moved = w @ D
        off = np.linalg.norm((d - moved).reshape(-1, 3), axis=1)
        scale = max(np.median(off) / _MEDIAN_LENGTH, FINEST)
        own = MANNER * np.linalg.norm(moved.reshape(-1, 3), axis=1) / np.sqrt(3)
        reach = OUTLIER * np.hypot(scale, own)
        trust = np.clip(1 - (off / reach) ** 2, 0, None) ** 2
    return (H, g), trust, w


def _errors(basis, d, trust, w):
    """Noise and misfit of the trusted vertices, millimetres an axis."""
    full = np.zeros(len(basis.rig.names))
    full[basis.kept] = w
    r = d.reshape(-1, 3) - basis.moved(full)
    i, j = basis.rig.neutral.edges.T
    both = trust[i] * trust[j]
    # neighbours' noise differs, by twice its variance; their misfit does not
    noise = (both @ ((r[i] - r[j]) ** 2).sum(axis=1)) / max(6 * both.sum(), 1e-300)
    total = (trust @ (r**2).sum(axis=1)) / max(3 * trust.sum(), 1e-300)
    return np.sqrt(noise), np.sqrt(max(total - 1.03 * noise, 0))  # 3 %: the draw of the noise


def _fewer(H, g, lo, hi, held, worth):
    """Weights after units worth too little were taken out one by one."""
    there = np.ones(len(g), dtype=bool)
    while True:
        a = np.flatnonzero(there)
        w = np.zeros(len(g))
        if not len(a):
            return w
        own = H[np.ix_(a, a)]
        w[a] = solve_bounded(own, g[a], lo[a], hi[a])[0]
        loss = w[a] ** 2 / np.diag(np.linalg.inv(own))  # of the first term of Eq. 9 without it
        loss[held[a]] = np.inf
        gone = a[loss <= 1e-12 * np.trace(H)]  # at 0 already
        if not len(gone):
            if loss.min() > worth:
                return w
            gone = a[[loss.argmin()]]
        there[gone] = False
