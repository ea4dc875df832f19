"""The notebook on a face of one's own: open, match, pull, read, write back."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting
from facelab.numeric.least_squares import solve_bounded

HANDLES = ("mouth_corner_left", "mouth_corner_right", "lip_upper", "lip_lower", "chin", "nose_tip")
SETTINGS = {
    "head": Setting("Aura", choices=("Aura", "example", "F1")),
    "handle": Setting("mouth_corner_left", choices=HANDLES),
    "pull": Setting((5, 8, -2), within=(-20.0, 20.0), unit="mm"),
    "frames": Setting(450, within=(30, 3000)),
}
OTHERS = (
    {"head": "example"},
    {"head": "F1", "frames": 60},
    {"handle": "chin", "pull": (0, -10, 0)},
    {"handle": "mouth_corner_right", "pull": (-6, -4, 0)},
)


def renamed(answer, take, rig):
    if not isinstance(answer, dict):
        raise TypeError("a dict is needed, the take's name first: {'jawOpen': ...}")
    strange = [name for name in answer.values() if name not in rig.names]
    if strange:
        return f"your rig has no {', '.join(map(str, strange))}; print(rig.names)"
    unknown = [name for name in answer if name not in take.names]
    if unknown:
        return f"the take has no {', '.join(map(str, unknown))}; print(take.names)"
    n = len(rig.match(take.renamed(answer)).driven)
    return None if n >= 12 else f"{n} shapes are driven now, {12 - n} too few"


def pulled(answer, session, vertex, way):
    factor = number(answer, "a number by which the pull is multiplied")
    session.pull(vertex, session.neutral.vertices[vertex] + factor * np.asarray(way, float))
    moved = np.linalg.norm(session.vertices[vertex] - session.neutral.vertices[vertex])
    session.undo()
    off = moved - 10
    if abs(off) <= 0.3:
        return None
    side = "far" if off > 0 else "short"
    return f"too {side} by {abs(off):.1f} mm; γ holds the face back, so ask for more than you want"


def three(answer, rig, posed):
    names = [answer] if isinstance(answer, str) else list(answer)
    strange = [name for name in names if name not in rig.names]
    if strange:
        return f"your rig has no {', '.join(map(str, strange))}"
    if len(names) > 3:
        return f"{len(names)} units, but at most three are wanted"
    wanted = (posed - rig.neutral.vertices).ravel()
    D = np.stack([rig.deltas[rig.names.index(name)].ravel() for name in names], axis=1)
    w, _ = solve_bounded(D.T @ D, D.T @ wanted, np.zeros(len(names)), np.ones(len(names)))
    left = np.linalg.norm(D @ w - wanted) / np.linalg.norm(wanted)
    if left < 0.6:
        return None
    return f"{left:.0%} of the pose's motion is left, more than 60 %; which units lift that place?"


EXERCISES = (
    Exercise(
        1,
        renamed,
        "names that mean the same are a matter of one dict",
        'A take\'s name comes first: `{"jawOpen": "jawDrop"}`. Look for what closes the eyes, and '
        "for what pulls the corners of the mouth.",
        'answer = {"jawOpen": "jawDrop", "eyeBlinkLeft": "eyesClosed_L",\n'
        '          "eyeBlinkRight": "eyesClosed_R", "mouthSmileLeft": "lipCornerPuller_L",\n'
        '          "mouthSmileRight": "lipCornerPuller_R"}',
        ('answer = {"jawOpen": "jawDrop"}', 'answer = {"jawOpen": "jaw"}', "answer = 3"),
    ),
    Exercise(
        2,
        pulled,
        "the pin is only a wish; the corner goes as far as the model lets it",
        "The pull was 9.6 mm long. How far did the corner go? What it does grows in proportion.",
        "answer = 1.2",
        ("answer = 1", "answer = 2", 'answer = "more"'),
    ),
    Exercise(
        3,
        three,
        "few units, by name, say most of it",
        "FACS calls what lifts the corner of the mouth AU12, the *lip corner puller*. Take it, and "
        "two more that the reading used.",
        'answer = ["lipCornerPuller_L", "chinRaiser_B", "jawSidewaysLeft"]',
        (
            'answer = ["jawDrop", "eyesClosed_L", "mouthRight"]',
            'answer = ["smile"]',
            "answer = rig.names[:5]",
        ),
    ),
)
