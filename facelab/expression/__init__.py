"""A rough sketch becomes action units, and goes to other faces (Yu and Liu 2014)."""

from facelab.expression.contact import Contact
from facelab.expression.landmarks import guess_landmarks
from facelab.expression.reading import UnitReading, find_units
from facelab.expression.regression import (
    CRITERIA,
    ExpressionFit,
    held_out_error,
    least_squares,
    regress_expression,
    two_step,
)
from facelab.expression.sequence import regress_sequence
from facelab.expression.session import ExpressionSession
from facelab.expression.transfer import METHODS, IntermediateSpace, SimplifiedRig, UnitCarrier
from facelab.expression.translate import Translator, translate
from facelab.expression.units import UnitBasis, find_alignment, prepare_units

__all__ = [
    "CRITERIA",
    "METHODS",
    "Contact",
    "ExpressionFit",
    "ExpressionSession",
    "IntermediateSpace",
    "SimplifiedRig",
    "Translator",
    "UnitBasis",
    "UnitCarrier",
    "UnitReading",
    "find_alignment",
    "find_units",
    "guess_landmarks",
    "held_out_error",
    "least_squares",
    "prepare_units",
    "regress_expression",
    "regress_sequence",
    "translate",
    "two_step",
]
