"""Which units one face can show together; the FACS combinations that are captured."""

import numpy as np

from data_synth.performance.tracks import AT, columns
from data_synth.units import UNITS, expand

N_FACS = 86


_PAIRS = [
    ("AU25", "AU24"), ("AU25", "AU28"), ("AU26", "AU24"), ("AU26", "AU28"), ("AU27", "AU24"),
    ("AU27", "AU28"), ("AU27", "AU23"), ("AU26", "AU23"), ("AU26", "AU27"), ("AU25", "AU27"),
    ("AU25", "AU26"), ("AU27", "AU17"), ("AU18", "AU20"), ("AU18", "AU12"), ("AU18", "AU24"),
    ("AU18", "AU28"), ("AU18", "AU14"), ("AU18", "AU13"), ("AU22", "AU20"), ("AU22", "AU24"),
    ("AU22", "AU28"), ("AU22", "AU12"), ("AU22", "AU23"), ("AU22", "AU13"), ("AU22", "AU18"),
    ("AU27", "AU18"), ("AU27", "AU22"), ("AU27", "AU16"), ("AU27", "AU15"), ("AU28", "AU16"),
    ("AU28", "AU10"), ("AU28", "AU24"), ("AU28", "AU23"), ("AU34", "AU35"), ("AU34", "AU25"),
    ("AU34", "AU26"), ("AU34", "AU27"), ("AU34", "AU16"), ("AU34", "AU28"), ("AU34", "AU14"),
    ("AU35", "AU27"), ("AU35", "AU12"), ("AU35", "AU20"), ("AU13", "AU15"), ("AU12", "AU13"),
    ("AU17", "AU16"), ("AU16", "AU24"), ("AU5", "AU45"), ("AU5", "AU6"), ("AU29", "AU27"),
    ("AU30L", "AU30R"), ("AU29", "AU30L"), ("AU29", "AU30R"), ("AU27", "AU30L"),
    ("AU27", "AU30R"), ("AU15", "AU22"), ("AU10", "AU24"), ("AU11", "AU24"), ("AU20", "AU23"),
]  # fmt: skip
OPPOSED = {frozenset((AT[a], AT[b])) for x, y in _PAIRS for a in expand(x) for b in expand(y)}
"""Pairs of columns that one face cannot show together."""
_SIDED = ("AU2", "AU6", "AU7", "AU45", "AU10", "AU11", "AU12", "AU14", "AU20")
_WHOLE = tuple(dict.fromkeys(u[:-1] if u[:-1] in _SIDED else u for u in UNITS))


def draw_units(rng, first, count):
    """Up to `count` names that one face can show together, the first one given."""
    chosen = [first]
    for name in rng.permutation(_WHOLE).tolist():
        if len(chosen) == count:
            break
        if name in _SIDED and rng.random() < 0.3:
            name += "LR"[rng.integers(2)]
        taken = [k for c in chosen for k in columns(c)]
        if not set(taken) & set(columns(name)) and not any(
            frozenset((a, b)) in OPPOSED for a in taken for b in columns(name)
        ):
            chosen.append(name)
    return sorted(chosen, key=lambda c: columns(c)[0])


def facs_combinations(random_state=0):
    """The 86 combinations of units that M1 shows: tuples of 1 to 4 names, each combination once.

    The forty units alone come first; then combinations of units that one face can show
    together, both sides of a unit as one name (`AU12`) or one side alone (`AU12L`).
    """
    rng = np.random.default_rng([random_state, 2])
    found = [(name,) for name in UNITS]
    while len(found) < N_FACS:
        names = tuple(draw_units(rng, str(rng.choice(_WHOLE)), int(rng.integers(2, 5))))
        if names not in found and len(names) > 1:
            found.append(names)
    return tuple(found)
