"""Trials of action-unit regression on mixtures that are known: draw, spoil, find, score."""

from typing import NamedTuple

import numpy as np
from sklearn.linear_model import Ridge, lasso_path

from facelab.checks import as_finite, check_index, check_number
from facelab.expression.reading import find_units
from facelab.expression.regression import CRITERIA, regress_expression, two_step
from facelab.expression.transfer import METHODS, UnitCarrier
from facelab.expression.units import UnitBasis, among_all, prepare_units, sketch_displacement
from facelab.numeric.threads import single_threaded

PENALTIES = np.logspace(-4, 1, 16)
"""Tried for ridge and lasso, relative to the mean squared size of a unit."""


def draw_mixtures(n_units, n_mixtures=200, active=(1, 8), low=0.2, random_state=0):
    """Random mixtures of a few units.

    Parameters
    ----------
    n_units : int
        Units to choose from.
    n_mixtures : int, default=200
    active : (int, int)
        Fewest and most units in a mixture, each number as often.
    low : float, default=0.2
        Smallest weight; the largest is 1.
    random_state : int or numpy.random.Generator

    Returns
    -------
    W : ndarray of shape (n_mixtures, n_units)
    """
    n_units = check_index(n_units, "n_units", 100_000, "units")
    low = check_number(low, "low", low=0, high=1)
    fewest, most = active
    if not 1 <= fewest <= most <= n_units:
        raise ValueError(f"active={active!r}, but {n_units} units allow 1 to {n_units}, in order.")
    rng = np.random.default_rng(random_state)
    W = np.zeros((n_mixtures, n_units))
    for w in W:
        chosen = rng.permutation(n_units)[: rng.integers(fewest, most + 1)]
        w[chosen] = rng.uniform(low, 1, len(chosen))
    return W


def spoil(mesh, vertices, noise=0.0, twist=0.0, n_twists=8, radius=10.0, random_state=0):
    """An expression made rough: noise on every vertex, and patches pushed out of place.

    Parameters
    ----------
    mesh : TriangleMesh
    vertices : ndarray of shape (n_vertices, 3)
        Millimetres.
    noise : float
        Standard deviation on each axis, millimetres.
    twist : float
        How far the middle of each patch is pushed, in a direction of its own, millimetres.
    n_twists : int, default=8
    radius : float, default=10.0
        Of a patch, millimetres; towards its rim the push fades.
    random_state : int or numpy.random.Generator

    Returns
    -------
    ndarray of shape (n_vertices, 3)

    References
    ----------
    Yu and Liu 2014, section VI: "we intentionally offset some vertices to create twists".
    """
    V = as_finite(vertices, "vertices", mesh.vertices.shape)
    noise, twist = check_number(noise, "noise", low=0), check_number(twist, "twist", low=0)
    radius = check_number(radius, "radius", above=0)
    rng = np.random.default_rng(random_state)
    V = V + rng.normal(scale=noise, size=V.shape)
    middles = mesh.vertices[rng.permutation(mesh.n_vertices)[:n_twists]]
    for middle in middles:
        way = rng.normal(size=3)
        near = np.linalg.norm(mesh.vertices - middle, axis=1) / radius
        push = np.where(near < 1, (1 - np.minimum(near, 1) ** 2) ** 2, 0)
        V = V + push[:, None] * twist * way / np.linalg.norm(way)
    return V


class Score(NamedTuple):
    """How well units were found."""

    precision: float
    """Share of the units found that are in the mixture."""
    recall: float
    """Share of the units in the mixture that were found."""
    error: float
    """Mean absolute error of a weight, over all units."""


def score(truth, found, least=0.1):
    """Compare weights with those that made the expressions.

    Parameters
    ----------
    truth, found : ndarray of shape (n_mixtures, n_units)
    least : float, default=0.1
        A weight of this size, of either sign, counts as a unit.

    Returns
    -------
    Score
        Counted over all mixtures together; precision is 1 where nothing was found.
    """
    truth = as_finite(truth, "truth", ("n_mixtures", "n_units"))
    found = as_finite(found, "found", truth.shape)
    least = check_number(least, "least", above=0)
    there, said = np.abs(truth) >= least, np.abs(found) >= least
    hits = np.count_nonzero(there & said)
    return Score(
        float(hits / said.sum()) if said.any() else 1.0,
        float(hits / max(there.sum(), 1)),
        float(np.abs(found - truth).mean()),
    )


@single_threaded
def weights_by_peers(rig, sketches, truth, align="check"):
    """The weights of many sketches by the peers of Eq. 9.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
    sketches : iterable of ndarray of shape (n_vertices, 3)
        Millimetres.
    truth : ndarray of shape (n_sketches, n_units)
        Serves only what is marked "best": ridge and lasso get the penalty, one for all sketches,
        with the smallest error of the weights.
    align
        As for `regress_expression`.

    Returns
    -------
    dict of str to ndarray of shape (n_sketches, n_units)
        By name of the method. Least squares (Eq. 5), ridge and lasso have free signs; the last
        three keep weights in [0, 1]. "few units" is `facelab.expression.find_units`.
    """
    basis, d, truth = _ready(rig, sketches, truth, align)
    c = d @ basis.Q
    size = np.trace(basis.gram) / len(basis.kept)
    found = {"least squares": among_all(np.linalg.solve(basis.R, c.T).T, basis)}
    ridges = (Ridge(alpha=p * size, fit_intercept=False) for p in PENALTIES)
    tried = [among_all(ridge.fit(basis.R, c.T).coef_, basis) for ridge in ridges]
    found["ridge, best"] = _best(truth, tried)
    given = dict(alphas=PENALTIES[::-1] * size / len(basis.kept), max_iter=20_000)
    given |= dict(precompute=basis.gram, check_input=False)  # in half the time
    R = np.asfortranarray(basis.R)
    for name, positive in (("lasso, best", False), ("lasso >= 0, best", True)):
        paths = [lasso_path(R, x, Xy=R.T @ x, positive=positive, **given)[1] for x in c]
        found[name] = _best(truth, among_all(np.array(paths).transpose(2, 0, 1), basis))
    V = basis.rig.neutral.vertices + d.reshape(len(d), -1, 3)
    for name, bounds in (("least squares >= 0", (0, None)), ("least squares in [0, 1]", (0, 1))):
        fits = (regress_expression(basis, v, 0, [0], bounds, align=False) for v in V)
        found[name] = np.array([fit.weights[0] for fit in fits])
    steps = [two_step(basis, v, 0, align=False).weights for v in V]
    few = [find_units(basis, v, align=False).weights for v in V]
    return found | {"two steps, Eq. 6": np.array(steps), "few units": np.array(few)}


@single_threaded
def weights_by_alpha(rig, sketches, truth, lam=1.0, alphas=range(101), align="check"):
    """The weights of many sketches by Eq. 9, alpha chosen in several ways.

    Parameters
    ----------
    rig, sketches, align
        As for `weights_by_peers`.
    truth : ndarray of shape (n_sketches, n_units)
        Serves only "best alpha", the one of each sketch with the smallest error of the weights.
    lam : float, default=1.0
        Millimetres.
    alphas : iterable of float

    Returns
    -------
    dict of str to ndarray of shape (n_sketches, n_units)
        By criterion, see `ExpressionFit.choose`, and "best alpha".
    """
    basis, d, truth = _ready(rig, sketches, truth, align)
    rows = {name: [] for name in (*CRITERIA, "best alpha")}
    for one, w in zip(d, truth, strict=True):
        V = basis.rig.neutral.vertices + one.reshape(-1, 3)
        fit = regress_expression(basis, V, lam, alphas, align=False)
        for criterion in CRITERIA:
            rows[criterion].append(fit.weights[fit.choose(criterion)])
        rows["best alpha"].append(min(fit.weights, key=lambda found, w=w: np.abs(found - w).sum()))
    return {name: np.array(found) for name, found in rows.items()}


def score_all(rig, sketches, truth, searches, align="check"):
    """Scores of all the methods on the same sketches.

    Parameters
    ----------
    rig, sketches, truth, align
        As for `weights_by_peers`.
    searches : dict of str to (float, iterable of float)
        What Eq. 9 is tried with: lam (mm) and alphas, by a name of your choice.

    Returns
    -------
    dict of str to Score
        The peers by their names; Eq. 9 as "Eq. 9, <name>, <criterion>", see `weights_by_alpha`.
    """
    basis = rig if isinstance(rig, UnitBasis) else prepare_units(rig)
    sketches = list(sketches)
    found = weights_by_peers(basis, sketches, truth, align)
    for name, (lam, alphas) in searches.items():
        chosen = weights_by_alpha(basis, sketches, truth, lam, alphas, align)
        found |= {f"Eq. 9, {name}, {criterion}": w for criterion, w in chosen.items()}
    return {name: score(truth, w) for name, w in found.items()}


def sort_weights(names, weights, truth, least=0.1):
    """Weights that were found, sorted into right and wrong.

    Parameters
    ----------
    names : sequence of str
        Of the units.
    weights, truth : ndarray of shape (n_units,)
        As found, and as put in.
    least : float, default=0.1
        Units that were not put in are left out unless their weight is larger, of either sign.

    Returns
    -------
    there, beside : dict of str to float
        The units that were put in, in order of `names`; the others, largest first.
    """
    names = list(names)
    truth = as_finite(truth, "truth", (len(names),))
    weights = as_finite(weights, "weights", (len(names),))
    there = {names[k]: float(weights[k]) for k in np.flatnonzero(truth)}
    wrong = [k for k in np.argsort(-np.abs(weights)) if truth[k] == 0 and abs(weights[k]) > least]
    return there, {names[k]: float(weights[k]) for k in wrong}


def vertex_rms(offsets):
    """Root mean squared length over the vertices: (..., n_vertices, 3) to (...), same unit."""
    return np.sqrt((np.asarray(offsets, dtype=float) ** 2).sum(axis=-1).mean(axis=-1))


def carry_errors(source, neutral, wanted, methods=METHODS):
    """How far units carried to another face are from those wanted there.

    Parameters
    ----------
    source : BlendshapeRig
    neutral : TriangleMesh
        The other face, with the triangles of the source.
    wanted : ndarray of shape (n_units, n_vertices, 3)
        Displacements that the units should have there, millimetres.
    methods : iterable of str
        See `facelab.transfer.UnitCarrier`.

    Returns
    -------
    dict of str to ndarray of shape (n_units,)
        By method, RMS over the vertices, millimetres.
    """
    wanted = as_finite(wanted, "wanted", source.deltas.shape)
    carriers = {method: UnitCarrier(source.neutral, neutral, method) for method in methods}
    return {m: vertex_rms(c.carry(source.deltas) - wanted) for m, c in carriers.items()}


def _ready(rig, sketches, truth, align):
    """Basis, displacements (n_sketches, 3 * n_vertices) and truth."""
    basis = rig if isinstance(rig, UnitBasis) else prepare_units(rig)
    sketches = list(sketches)
    truth = as_finite(truth, "truth", (len(sketches), len(basis.rig.names)))
    if not sketches:
        raise ValueError("sketches is empty; give one or more.")
    return basis, np.array([sketch_displacement(basis, s, align)[0] for s in sketches]), truth


def _best(truth, tried):
    return min(tried, key=lambda W: np.abs(W - truth).mean())
