"""Sketches on another person's face, and how well their units are read (notebook 06)."""

import numpy as np

from facelab.expression.reading import find_units
from facelab.expression.regression import CRITERIA, regress_expression
from facelab.expression.units import UnitBasis, prepare_units
from facelab.studies.expression_trials import draw_mixtures, score, spoil

GRADES = {
    "clean": (0.0, 0.0),
    "noise 0.5 mm": (0.5, 0.0),
    "noise 0.5 mm, twists 4 mm": (0.5, 4.0),
    "noise 1 mm, twists 8 mm": (1.0, 8.0),
}
"""Noise on each axis and twists, millimetres."""

_ALPHAS = np.arange(0, 10, 0.1)
_REPORTED = 9001  # seeds that served to choose nothing


def read_mixtures(rig, makers, n_mixtures=15, active=(1, 6), seed=_REPORTED):
    """Scores of every way to choose units, on random mixtures in all grades of roughness.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
        Whose units are looked for.
    makers : BlendshapeRig or ActionUnitRig
        Whose units make the sketches: the same rig, or another person's with the same names.
    n_mixtures : int
        In each grade.
    active : (int, int)
        Fewest and most units in a mixture.
    seed : int

    Returns
    -------
    dict of (str, str) to Score
        From grade and way: the criteria of `ExpressionFit.choose` at lam = 1 mm, and "few units".
    """
    basis = rig if isinstance(rig, UnitBasis) else prepare_units(rig)
    found = {}
    for grade, (noise, twist) in GRADES.items():
        W = draw_mixtures(len(makers.names), n_mixtures, active, random_state=seed)
        read = {way: [] for way in (*CRITERIA, "few units")}
        for i, w in enumerate(W):
            V = spoil(
                basis.rig.neutral,
                makers.shape(dict(zip(makers.names, w, strict=True))),
                noise,
                twist,
                random_state=1000 * seed + i,
            )
            fit = regress_expression(basis, V, 1.0, _ALPHAS, align=False)
            for way in CRITERIA:
                read[way].append(fit.weights[fit.choose(way)])
            read["few units"].append(find_units(basis, V, align=False).weights)
        for way, weights in read.items():
            found[grade, way] = score(W, np.array(weights))
    return found
