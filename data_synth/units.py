"""The forty action units that every actor has, in one fixed order.

Names follow FACS (Ekman and Friesen 1978): a unit that FACS codes by side ends in L or R, the
person's own left and right. A weight of 1 is the unit at its strongest on that actor. Gaze
(AU61 to AU64) moves no skin here, and head turns (AU51 to AU58) are rigid motion, not units.
"""

from typing import NamedTuple


class Unit(NamedTuple):
    """One action unit: what it does, the muscle that does it, its like in ICT-FaceKit."""

    name: str
    description: str
    muscle: str
    ict: tuple = ()
    """Nearest shapes of ICT-FaceKit, together; empty where it has none."""


def _both(name, description, muscle, ict):
    """Left and right unit; `_L` and `_R` are appended to the shapes of ICT-FaceKit."""
    sides = (("L", "left"), ("R", "right"))
    return [
        Unit(name + s, f"{description}, {side}", muscle, tuple(f"{i}_{s}" for i in ict))
        for s, side in sides
    ]


def _sides(name):
    return (f"{name}_L", f"{name}_R")


UPPER_FACE = (
    Unit("AU1", "inner brows raised", "frontalis, medial part", _sides("browInnerUp")),
    *_both("AU2", "outer brow raised", "frontalis, lateral part", ("browOuterUp",)),
    Unit("AU4", "brows lowered and drawn together",
         "corrugator supercilii, depressor supercilii, procerus", _sides("browDown")),
    Unit("AU5", "upper lids raised, eyes wide", "levator palpebrae superioris", _sides("eyeWide")),
    *_both("AU6", "cheek raised, skin gathered round the eye", "orbicularis oculi, orbital part",
           ("cheekSquint",)),
    *_both("AU7", "lids tightened, lower lid raised", "orbicularis oculi, palpebral part",
           ("eyeSquint",)),
    *_both("AU45", "lids closed", "orbicularis oculi; relaxed levator palpebrae superioris",
           ("eyeBlink",)),
)  # fmt: skip

LOWER_FACE = (
    Unit("AU9", "nose wrinkled", "levator labii superioris alaeque nasi", _sides("noseSneer")),
    *_both("AU10", "upper lip raised", "levator labii superioris", ("mouthUpperUp",)),
    *_both("AU11", "fold between nose and cheek deepened", "zygomaticus minor", ("mouthUpperUp",)),
    *_both("AU12", "lip corner pulled up and back", "zygomaticus major", ("mouthSmile",)),
    Unit("AU13", "lip corners pulled sharply up, cheeks puffed", "levator anguli oris",
         _sides("mouthSmile")),
    *_both("AU14", "lip corner tightened into a dimple", "buccinator", ("mouthDimple",)),
    Unit("AU15", "lip corners pulled down", "depressor anguli oris", _sides("mouthFrown")),
    Unit("AU16", "lower lip pulled down", "depressor labii inferioris", _sides("mouthLowerDown")),
    Unit("AU17", "chin boss and lower lip raised", "mentalis", ("mouthShrugLower",)),
    Unit("AU18", "lips puckered", "incisivi labii", ("mouthPucker",)),
    *_both("AU20", "lip corner stretched sideways", "risorius, platysma", ("mouthStretch",)),
    Unit("AU22", "lips funnelled forward", "orbicularis oris", ("mouthFunnel",)),
    Unit("AU23", "lips tightened and narrowed", "orbicularis oris"),
    Unit("AU24", "lips pressed together", "orbicularis oris", _sides("mouthPress")),
    Unit("AU25", "lips parted, jaw shut",
         "depressor labii inferioris; relaxed mentalis and orbicularis oris"),
    Unit("AU26", "jaw dropped by relaxation, lips parted", "relaxed masseter, temporalis",
         ("jawOpen",)),
    Unit("AU27", "mouth stretched wide open", "pterygoids, digastric", ("jawOpen",)),
    Unit("AU28", "lips sucked in over the teeth", "orbicularis oris",
         ("mouthRollLower", "mouthRollUpper")),
    Unit("AU29", "jaw thrust forward", "lateral pterygoids, both", ("jawForward",)),
    Unit("AU30L", "jaw moved to the left", "lateral pterygoid, right", ("jawLeft",)),
    Unit("AU30R", "jaw moved to the right", "lateral pterygoid, left", ("jawRight",)),
    Unit("AU34", "cheeks puffed", "orbicularis oris against the breath", _sides("cheekPuff")),
    Unit("AU35", "cheeks sucked in", "buccinator"),
    Unit("AU38", "nostrils widened", "nasalis, alar part"),
)  # fmt: skip

UNIT_TABLE = {unit.name: unit for unit in (*UPPER_FACE, *LOWER_FACE)}
"""Every unit by name, upper face first."""

UNITS = tuple(UNIT_TABLE)
"""The forty names: the columns of every weight array of `data_synth`."""


def expand(name):
    """Names of the units that a name stands for: itself, or both sides of a name without one.

    Raises
    ------
    ValueError
        If there is no such unit; the message lists those there are.
    """
    found = (
        (name,) if name in UNIT_TABLE else tuple(u for u in UNITS if u in (name + "L", name + "R"))
    )
    if not found:
        raise ValueError(f"unit={name!r} is unknown; the actors have {', '.join(UNITS)}.")
    return found
