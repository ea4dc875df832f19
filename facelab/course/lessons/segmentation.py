"""The notebook on segmentation: motion and distance, clusters, how many, how sure."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting

SETTINGS = {
    "actor": Setting("M1", choices=("M1", "F1", "M2", "F2")),
    "K": Setting((9, 13, 14), within=(2, 40)),
    "lam": Setting(0.7, within=(0, 1)),
    "r": Setting(10.0, within=(1, 100), unit="mm"),
    "threshold": Setting(0.7, within=(0, 1)),
}
OTHERS = (
    {"K": (7, 11, 15)},
    {"lam": 0.5},
    {"actor": "F1"},
    {"r": 25.0, "threshold": 0.3},
    {"lam": 1.0, "K": (5,)},
)


def stops_at(answer, grown):
    off = number(answer, "a number of regions") - grown.n_regions
    if off == 0:
        return None
    if off == grown.tried[-1].k - grown.n_regions:
        return "that is the first k that falls apart; what is kept is the cut before it"
    return f"too {'many' if off > 0 else 'few'}; which is the first k whose clusters are in pieces?"


def nearness_radius(answer):
    answer = number(answer, "a length in millimetres")
    if answer <= 0:
        return "r is a length above 0"
    near = np.exp(-50 / answer)
    if abs(near - 0.05) < 0.003:
        return None
    side = "large" if near > 0.05 else "small"
    return f"too {side}: at 50 mm there is {near:.3f} of nearness left; solve Eq. 11 for r"


def cut_off(answer, grown):
    n = sum(len(piece) for rest in grown.tried[-1].cut_off for piece in rest)
    off = number(answer, "a number of vertices") - n
    if off == 0:
        return None
    return f"too {'many' if off > 0 else 'few'} by {abs(off):g}; count all pieces but the largest"


EXERCISES = (
    Exercise(
        1,
        stops_at,
        "at k = 2 the two ends are one cluster in two pieces, so the strip stays whole",
        "Read `grown.why`. The paper keeps the last k before a cluster falls apart.",
        "answer = 1",
        ("answer = 3", "answer = 2", "answer = 'two'"),
    ),
    Exercise(
        2,
        nearness_radius,
        "so at the paper's r = 10 mm next to nothing is left at 50 mm",
        "$e^{-50/r} = 0.05$: take the logarithm of both sides.",
        "answer = 50 / np.log(20)",
        ("answer = 10", "answer = 40", "answer = 0"),
    ),
    Exercise(
        3,
        cut_off,
        "so few vertices end the growth, and with them the number of regions",
        "`grown.tried[-1].cut_off` has, for each cluster, the vertices of all its pieces but the "
        "largest.",
        "answer = sum(len(p) for rest in grown.tried[-1].cut_off for p in rest)",
        ("answer = 397", "answer = -1"),
    ),
)
