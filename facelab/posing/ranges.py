"""What posing allows, and its defaults: ranges in which Eq. 9 is solved soundly.

Within them, and with a condition number up to `CONDITION`, the pose is right to a hundredth of a
millimetre (`tests/posing/test_ranges.py` solves in exact arithmetic beside it); beyond, digits get
lost until there is no answer at all.
"""

import numpy as np

from facelab.checks import as_finite, check_number
from facelab.looks.gaze import WIDEST

GAMMA = 0.025
"""γ of the paper: weight of staying near the state before the pins."""

BETAS = 0.0, 1e6
GAMMAS = 1e-9, 1e9
WEIGHTS = 1e-6, 1e6
"""Ends of beta, gamma and the weight of a pin (no unit)."""

LIMITS = 0.01, 1e3
"""Ends of the limit, standard deviations."""

CONDITION = 1e12
"""Largest condition number of the matrix of Eq. 10 (in the 1-norm)."""

FARTHEST = 1e10
"""How far from its place at rest a vertex may be pulled, mm: rays beside the face end far away."""

LARGEST = 1e15
"""Largest coefficient."""


def check_beta(value):
    """β as float, refused outside its range."""
    return check_number(value, "beta", *BETAS)


def check_gamma(value):
    """γ as float, refused outside its range."""
    return check_number(value, "gamma", *GAMMAS)


def check_weight(value, name="weight"):
    """Weight of a pin as float, refused outside its range."""
    return check_number(value, name, *WEIGHTS)


def check_gaze(value, name="gaze"):
    """A gaze, degrees to the person's left and up, refused beyond `WIDEST`: (float, float)."""
    left, up = as_finite(value, name, (2,), remedy="give degrees to the left and up").tolist()
    ends = -WIDEST, WIDEST
    return check_number(left, f"{name} to the left", *ends), check_number(up, f"{name} up", *ends)


def check_displacement(value, name):
    """Where a vertex is to go from its place at rest, refused beyond `FARTHEST`: (3,)."""
    value = as_finite(value, name, (3,), remedy="give three finite coordinates")
    far = np.abs(value).max()
    if far > FARTHEST:
        raise ValueError(
            f"{name} lies {far:.3g} mm from the vertex at rest, but at most {FARTHEST:g} mm are "
            "allowed; give a place near the face."
        )
    return value


def check_size(coefficients):
    """Refuse coefficients beyond `LARGEST`."""
    largest = np.abs(coefficients).max(initial=0)
    if largest > LARGEST:
        raise ValueError(
            f"coefficients go up to {largest:.3g}, but at most {LARGEST:g} are allowed, far beyond "
            "any face; pose nearer to it."
        )
