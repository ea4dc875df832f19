"""The notebook on capture: who is there, what cameras see, what is wrong with it."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting

SETTINGS = {
    "actor": Setting("M1", choices=("M1", "F1", "M2", "F2")),
    "take": Setting("rage_5", choices=("rage_5", "pride_5", "contempt_5", "rage_1", "pride_1")),
    "cutoff": Setting(6.0, within=(1.0, 20.0), unit="Hz"),
    "n_shown": Setting(12, within=(4, 24)),
}
OTHERS = (
    {"actor": "F2"},
    {"actor": "F1", "take": "pride_1"},
    {"actor": "M2", "take": "contempt_5", "n_shown": 8},
    {"cutoff": 3.0},
)


def noise_factor(answer):
    factor = number(answer, "a factor")
    if factor == 6:
        return None
    side = "small" if factor < 6 else "large"
    return (
        f"{factor:g} is too {side}; variances of independent terms add, each times the square of "
        "its coefficient"
    )


def gaps_closed(answer, true, lost):
    filled = np.asarray(answer, dtype=float)
    if filled.shape != true.shape:
        return f"this has shape {filled.shape}, but {true.shape} is wanted"
    if not np.isfinite(filled[lost]).all():
        return "some gaps are still open: NaN is left"
    error = float(np.sqrt(((filled - true)[lost] ** 2).sum(axis=1).mean()))
    if error < 0.6:
        return None
    return f"filled places are off by {error:.2f} mm (RMS), more than 0.6; what did neighbours do?"


def swap_found(answer, steps, first, stop):
    limit = number(answer, "a step in mm")
    ends = np.zeros(len(steps), dtype=bool)
    ends[[first - 1, stop - 1]] = True
    most = np.nanmax(steps, axis=1, initial=0, where=np.isfinite(steps))
    missed = int((most[ends] <= limit).sum())
    wolf = int((most[~ends] > limit).sum())
    faults = []
    if missed:
        faults.append(f"{missed} of the two ends of the swap are missed: look at how far it jumps")
    if wolf:
        faults.append(f"{wolf} frames are called swaps that are none: skin moves, too")
    return "; ".join(faults) or None


EXERCISES = (
    Exercise(
        1,
        noise_factor,
        "1² + 2² + 1² = 6",
        "The coefficients of $x_{t-1} - 2 x_t + x_{t+1}$ are 1, −2 and 1.",
        "answer = 6",
        ("answer = 1", "answer = 4", "answer = 10", 'answer = "six"'),
    ),
    Exercise(
        2,
        gaps_closed,
        "where the path of the neighbours departs from its straight line, so does the marker",
        "Bridge the *neighbours'* mean path over the same gap. Where it departs from its own "
        "straight line, shift the marker by as much. `nearest[m]` lists six of marker m.",
        "answer = lines.copy()\n"
        "for m in range(still.n_markers):\n"
        "    around = lines[:, nearest[m]].mean(axis=1)[:, None]\n"
        "    straight = captures.bridged(around, still.visible[:, [m]], seconds)\n"
        "    answer[lost[:, m], m] += (around - straight)[lost[:, m], 0]",
        ("answer = lines", "answer = still.positions", "answer = lines[:5]", "answer = 3"),
    ),
    Exercise(
        3,
        swap_found,
        "a swap is a step that skin cannot make",
        "`np.nanmax(steps)` is the largest step; how large is the largest that is no end of the "
        "swap? `np.sort(np.nanmax(steps, axis=1))[-4:]` shows the last four.",
        "answer = 5",
        ("answer = 0.3", "answer = 50", 'answer = "large"'),
    ),
)
