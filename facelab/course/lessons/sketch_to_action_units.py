"""The notebook from a sketch to action units: pull, read, carry to another face."""

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting
from facelab.expression import ExpressionSession
from facelab.posing import PosingSession

EXPRESSIONS = {
    "frown": {
        "mouth_corner_left": (0, -6, 0),
        "mouth_corner_right": (0, -6, 0),
        "brow_left_5": (-2, -6, 0),
        "brow_right_5": (2, -6, 0),
    },
    "smile": {
        "mouth_corner_left": (5, 6, -3),
        "mouth_corner_right": (-5, 6, -3),
        "lip_lower": (0, -3, 0),
    },
    "surprise": {
        "brow_left_3": (0, 6, 0),
        "brow_right_3": (0, 6, 0),
        "chin": (0, -14, -4),
    },
}
"""Rough expressions as drags: landmark to offset, mm."""

SETTINGS = {
    "expression": Setting("frown", choices=tuple(EXPRESSIONS)),
    "criterion": Setting("fewest", choices=("fewest", "e_rms", "held_out", "gcv")),
    "actor": Setting("F1", choices=("M1", "F1", "M2", "F2")),
    "n_regions": Setting(9, within=(2, 20)),
}
OTHERS = (
    {"expression": "smile"},
    {"expression": "surprise", "actor": "M2"},
    {"criterion": "e_rms"},
    {"n_regions": 5, "actor": "F2"},
)


def kept(answer, rig, sketch):
    names = list(answer)
    strange = [name for name in names if name not in rig.names]
    if strange:
        return f"the rig has no {', '.join(map(str, strange))}; print(rig.names)"
    if len(names) > 10:
        return f"{len(names)} units are kept, but at most ten are wanted"
    session = ExpressionSession(rig, sketch)
    least = session.rms
    for name in rig.names:
        if name not in names:
            session.exclude(name)
    risen = session.rms - least
    if risen <= 0.1:
        return None
    return f"the error rises by {risen:.2f} mm, more than 0.1; what did the reading use most?"


def smallest_alpha(answer, fit):
    alpha = number(answer, "an α")
    enough = 1.1 * fit.rms.min()
    first = float(fit.alphas[fit.rms <= enough].min())
    if alpha < first:
        return "the error is more than 10 % over the smallest there; the weights need a larger sum"
    if alpha > first + 0.5:
        return f"the error is small enough, but so it is at an α smaller by {alpha - first:.1f}"
    return None


def clear(answer, model, rig, binding):
    if not isinstance(answer, dict) or not 1 <= len(answer) <= 3:
        raise TypeError("a dict of one to three landmarks with their offsets is needed")
    strange = [name for name in answer if name not in rig.neutral.landmarks]
    if strange:
        return f"there is no landmark {', '.join(map(str, strange))}; see rig.neutral.landmarks"
    posing = PosingSession(model, rig.neutral, binding=binding)
    for name, offset in answer.items():
        vertex = rig.neutral.landmarks[name]
        posing.pull(vertex, rig.neutral.vertices[vertex] + offset)
    session = ExpressionSession(rig, posing.vertices)
    session.set(criterion="fewest")
    strongest = [*session.named.items(), ("nothing", 0.0), ("nothing", 0.0)][:2]
    (first, a), (second, b) = strongest
    if a > 0.1 and a >= 2 * b:
        return None
    return f"{first} has {a:.2f}, but {second} {b:.2f}: they share skin; pull where one rules"


EXERCISES = (
    Exercise(
        1,
        kept,
        "a few units carry what the eye sees; the others shave off hundredths of a millimetre",
        "`session.named` lists the units of the reading, the strongest first; how many of them "
        "matter? Set the criterion to `fewest`.",
        'session.set(criterion="fewest")\nanswer = list(session.named)[:10]',
        ("answer = rig.names[:10]", "answer = rig.names", 'answer = ["frown"]'),
    ),
    Exercise(
        2,
        smallest_alpha,
        "from there on a larger sum only pays for units against each other",
        "`fit.alphas` and `fit.rms` are the curve at the left above; follow it from 0 until it "
        "comes within a tenth of its floor.",
        "answer = fit.alphas[fit.rms <= 1.1 * fit.rms.min()].min()",
        ("answer = 0", "answer = 20", 'answer = "large"'),
    ),
    Exercise(
        3,
        clear,
        "a place where one unit alone moves the skin names that unit",
        "A corner of the mouth is moved by many units, the middle of a brow by few.",
        'answer = {"brow_left_3": [0, 4, 0]}',
        (
            'answer = {"mouth_corner_left": [0, -6, 0], "mouth_corner_right": [0, -6, 0]}',
            'answer = {"forehead": [0, 4, 0]}',
            "answer = 4",
        ),
    ),
)
