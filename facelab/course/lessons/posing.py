"""The notebook on posing: a strip, a face, pins, and what they do to the rest."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting
from facelab.studies.locality import pulled

HANDLES = ("mouth_corner_left", "mouth_corner_right", "brow_left_3", "brow_right_3", "chin")
SETTINGS = {
    "handle": Setting("mouth_corner_left", choices=HANDLES),
    "pull": Setting((4, 6.4, -2.4), within=(-30.0, 30.0), unit="mm"),
    "n_regions": Setting(9, within=(2, 30)),
    "n_components": Setting(20, within=(2, 40)),
    "beta": Setting(0.5, within=(0, 100)),
    "gamma": Setting(0.025, within=(0.001, 10)),
}
OTHERS = (
    {"handle": "brow_right_3", "pull": (0, 6, 0)},
    {"n_regions": 5, "n_components": 8},
    {"beta": 5},
    {"gamma": 0.2, "handle": "chin", "pull": (0, -10, -3)},
)


def gamma_of_toy(answer, pull_strip):
    gamma = number(answer, "a γ")
    if gamma <= 0:
        return "γ must be above 0"
    off = pull_strip(gamma=gamma).vertices[5, 1] - 5
    if abs(off) < 0.3:
        return None
    return f"too {'high' if off > 0 else 'low'} by {abs(off):.1f} mm; what does γ do?"


def _moved(session, name):
    vertex = session.neutral.landmarks[name]
    return np.linalg.norm(session.vertices[vertex] - session.neutral.vertices[vertex])


def one_brow(answer, model, rig, binding):
    if not isinstance(answer, dict) or "up" not in answer:
        raise TypeError('a dict such as {"up": 6, "hold": (), "beta": 0.5, "gamma": 0.1} is needed')
    wish = {"hold": (), "beta": 0.5, "gamma": 0.025} | answer
    pins = {name: (0, 0, 0) for name in wish.pop("hold")}
    pins["brow_left_3"] = (0, wish.pop("up"), 0)
    session = pulled(model, rig.neutral, pins, binding=binding, **wish)
    left, right = _moved(session, "brow_left_3"), _moved(session, "brow_right_3")
    faults = []
    if left < 5:
        faults.append(f"the left brow rises too little by {5 - left:.1f} mm: pull more, or less γ")
    if right >= 0.5:
        faults.append(f"the right brow moves by {right:.1f} mm: what would hold it still?")
    return "; ".join(faults) or None


def _open(session, side):
    """How far an eye is open, as a share of how it is at rest."""
    at = [session.neutral.landmarks[f"eye_{side}_{lid}_outer"] for lid in ("upper", "lower")]
    now, rest = (np.linalg.norm(np.subtract(*V[at])) for V in _poses(session))
    return now / rest


def _poses(session):
    return session.vertices, session.neutral.vertices


def right_wink(answer, model, rig, binding):
    if not isinstance(answer, dict) or not answer:
        raise TypeError("a dict of landmarks and offsets is needed")
    if len(answer) > 3:
        return f"{len(answer)} pins, but at most three are wanted"
    strange = [name for name in answer if name not in rig.neutral.landmarks]
    if strange:
        return f"there is no landmark {', '.join(map(str, strange))}; see rig.neutral.landmarks"
    session = pulled(model, rig.neutral, answer, binding=binding)
    right, left = _open(session, "right"), _open(session, "left")
    corner, other = (_moved(session, f"mouth_corner_{side}") for side in ("right", "left"))
    faults = []
    if right >= 0.5:
        faults.append(f"the right eye is still open to {right:.0%} (wanted: under 50 %)")
    if left < 0.85:
        faults.append(f"the left eye closes too, to {left:.0%} (wanted: 85 % or more)")
    if corner < 4:
        faults.append(f"the right corner of the mouth moves by {corner:.1f} mm only (wanted: 4)")
    if other >= 2:
        faults.append(f"the left corner comes along by {other:.1f} mm (wanted: under 2)")
    return "; ".join(faults) or None


EXERCISES = (
    Exercise(
        1,
        gamma_of_toy,
        "γ decides how much of the wish is granted",
        "With γ = 0.005 it rises by 4.6 mm. The smaller γ, the nearer to the pin.",
        "answer = 0.0043",
        ("answer = 0.05", "answer = 0.0005", "answer = -1", 'answer = "small"'),
    ),
    Exercise(
        2,
        one_brow,
        "a vertex that is held where it is keeps its surroundings still",
        'A pin that asks for nothing holds the skin: `"hold": ("brow_right_3",)`. The brow stops '
        "short of the pull, so pull by more than 5 mm.",
        'answer = {"up": 10, "hold": ("brow_right_3",)}',
        ('answer = {"up": 6, "gamma": 0.1}', 'answer = {"up": 3}', "answer = 10"),
    ),
    Exercise(
        3,
        right_wink,
        "three pins make an expression that the take never held",
        "The wink of step 1 has the pins of the left side. Left and right are mirror images: x "
        "changes its sign.",
        'answer = {"mouth_corner_right": (-4, 6.4, -2.4), "eye_right_upper_outer": (0, -7, 0),\n'
        '          "eye_right_lower_outer": (0, 3, 0)}',
        (
            'answer = {"mouth_corner_right": (-4, 6.4, -2.4)}',
            'answer = {"mouth_corner_left": (4, 6.4, -2.4), "eye_left_upper_outer": (0, -7, 0)}',
            'answer = {"eye": (0, -7, 0)}',
            "answer = 3",
        ),
    ),
)
