"""The notebook on registration: from markers to one mesh."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting

ACTORS = ("M1", "F1", "M2", "F2")
SETTINGS = {
    "actor": Setting("M1", choices=ACTORS),
    "take": Setting("rage_5", choices=("rage_5", "pride_5", "contempt_5", "rage_1", "contempt_1")),
    "preset": Setting("balanced", choices=("smooth", "balanced", "close")),
    "hidden": Setting((0.0, 0.1, 0.2, 0.4), within=(0.0, 0.8)),
}
OTHERS = (
    {"actor": "F2"},
    {"take": "contempt_5", "actor": "M2"},
    {"preset": "smooth"},
    {"hidden": (0.0, 0.3, 0.6)},
)


def half_believed(answer, strip):
    sigma = number(answer, "a σ")
    if sigma <= 0:
        return "σ must be above 0"
    off = strip(15, sigma=sigma)[0][45] - 2
    if abs(off) < 0.1:
        return None
    return f"the peak is too {'high' if off > 0 else 'low'} by {abs(off):.2f} mm; what does σ say?"


def worst_marker(answer, registration):
    names, mm = registration.fit.names, registration.left_out_per_marker
    if answer not in names:
        raise ValueError(f"there is no marker {answer!r}; print(registration.fit.names)")
    mine, most = mm[names.index(answer)], np.nanmax(mm)
    if mine == most:
        return None
    return f"{answer} is told to {mine:.2f} mm, the worst one only to {most:.2f} mm"


def a_fifth_more(answer, shares, mm):
    share = number(answer, "a share between 0 and 1")
    true = float(np.interp(1.2 * mm[0], mm, shares))
    if not 0 <= share <= 1:
        return "a share lies between 0 and 1"
    if abs(share - true) <= 0.05:
        return None
    side = "many" if share > true else "few"
    grown = np.interp(share, shares, mm) / mm[0] - 1
    return f"too {side}: with that share hidden the error grows by {grown:.0%}"


EXERCISES = (
    Exercise(
        1,
        half_believed,
        "markers that are doubted as much as the skin is free to move are met half way",
        "σ is the noise that you ascribe to the markers, in mm. To doubt a marker by 4 mm, set it "
        "near 4.",
        "answer = 4.5",
        ("answer = 0.3", "answer = 8", "answer = 0", 'answer = "large"'),
    ),
    Exercise(
        2,
        worst_marker,
        "where skin moves on its own, no neighbour can tell",
        "`registration.left_out_per_marker` holds, for each marker, how far it is from where all "
        "others lead it; the names are `registration.fit.names`.",
        "answer = registration.fit.names[int(np.nanargmax(registration.left_out_per_marker))]",
        ('answer = "nose_tip"', 'answer = "elbow"', "answer = 3"),
    ),
    Exercise(
        3,
        a_fifth_more,
        "faces are smooth, so many markers say the same",
        "Read it off the curve above, or let `np.interp(1.2 * mm[0], mm, hidden)` do it.",
        "answer = np.interp(1.2 * mm[0], mm, hidden)",
        ("answer = 0", "answer = 0.9", "answer = 20"),
    ),
)
