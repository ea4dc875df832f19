"""The notebook on action units: sketch to units, what alpha can and cannot do."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting

SETTINGS = {
    "target": Setting("F1", choices=("F1", "M2", "F2")),
    "lam": Setting(0.015, within=(0.001, 10), unit="mm"),
    "noise": Setting(0.3, within=(0, 2), unit="mm"),
    "twist": Setting(4.0, within=(0, 10), unit="mm"),
}
OTHERS = (
    {"target": "M2"},
    {"target": "F2", "twist": 8.0},
    {"lam": 1.0},
    {"noise": 0.0, "twist": 0.0},
)


def between_knots(answer, fit, alpha):
    answer = np.asarray(answer, dtype=float)
    if answer.shape != (len(fit.names),):
        return f"{len(fit.names)} weights are needed, one for each unit"
    off = np.abs(answer - fit.at(alpha)).max()
    if off < 1e-9:
        return None
    return f"off by {off:.3f}; go `share` of the way from one breakpoint to the next"


def sum_of_plain(answer, plain):
    off = number(answer) - float(plain.sums[0])
    if abs(off) < 0.05:
        return None
    side = "large" if off > 0 else "small"
    return f"too {side} by {abs(off):.2f}; where are both terms of Eq. 9 at their smallest at once?"


def undoing(answer, fit, index):
    if not isinstance(answer, tuple | list) or len(answer) != 2:
        raise TypeError("two names of units are needed")
    unknown = [n for n in answer if n not in fit.names]
    if unknown:
        return f"there is no unit {', '.join(map(str, unknown))}"
    if any(set(answer) == set(pair) for pair in fit.cancelling(index)):
        return None
    return (
        f"{answer[0]} and {answer[1]} do not undo each other here; look for one left and one right"
    )


EXERCISES = (
    Exercise(
        1,
        between_knots,
        "between breakpoints the weights are linear, so nothing has to be searched",
        "`a` and `b` are the weights at the breakpoints before and after. A `share` of 0 is `a`, "
        "of 1 is `b`.",
        "answer = (1 - share) * a + share * b",
        ("answer = a", "answer = b[:2]"),
    ),
    Exercise(
        2,
        sum_of_plain,
        "there the wanted sum costs nothing, and the fit is the plain one",
        "The second term is zero where the weights sum to α by themselves. `plain.sums` has the "
        "sum of the weights of the plain fit.",
        "answer = plain.sums[0]",
        ("answer = 14", "answer = 0", "answer = 'all'"),
    ),
    Exercise(
        3,
        undoing,
        "together they move next to nothing, and so fill any sum that is asked for",
        "The jaw can go to the left and to the right. `fit.cancelling(35)` knows all pairs.",
        "answer = fit.cancelling(35)[0]",
        ('answer = ("AU4", "AU27")', 'answer = "AU30L"', 'answer = ("AU4", "AU99")'),
    ),
)
