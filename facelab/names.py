"""Names of facial shapes, whatever their spelling: ARKit's own, and a key under which all agree."""

import re

ARKIT = (
    *("eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft"),
    *("eyeSquintLeft", "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight"),
    *("eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight", "eyeWideRight", "jawForward"),
    *("jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRight"),
    *("mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight"),
    *("mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight"),
    *("mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper"),
    *("mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight"),
    *("mouthUpperUpLeft", "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp"),
    *("browOuterUpLeft", "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight"),
    *("noseSneerLeft", "noseSneerRight", "tongueOut"),
)
"""The 52 blend shapes of ARKit, in the order of Live Link Face."""

ANGLES = tuple(f"{p}{a}" for p in ("Head", "LeftEye", "RightEye") for a in ("Yaw", "Pitch", "Roll"))
"""The nine angles of Live Link Face, radians."""

_FACS = {  # those with one plain counterpart; left out are AU11, 13, 23, 25, 35 and 38
    **{1: "browInnerUp", 2: "browOuterUp", 4: "browDown", 5: "eyeWide", 6: "cheekSquint"},
    **{7: "eyeSquint", 9: "noseSneer", 10: "mouthUpperUp", 12: "mouthSmile", 14: "mouthDimple"},
    **{15: "mouthFrown", 16: "mouthLowerDown", 17: "mouthShrugLower", 18: "mouthPucker"},
    **{20: "mouthStretch", 22: "mouthFunnel", 24: "mouthPress", 26: "jawOpen", 27: "jawOpen"},
    **{28: "mouthRoll", 29: "jawForward", 30: "jaw", 34: "cheekPuff", 45: "eyeBlink"},
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_SPACE = re.compile(r"[.:|/\\]+")  # what ends a namespace: head_GEO.jawOpen, Body:jawOpen
_WORD = re.compile(r"[^\W\d_]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def normalised(name):
    """The key of a name: equal for names that differ in case, separators, side spelling, namespace.

    A side (`L`, `left`, `.r`, in front or behind) goes to the end. What stands before the last
    `.`, `:`, `|` or `/` is a namespace and goes, unless only a side follows.

    Parameters
    ----------
    name : str

    Returns
    -------
    str
        Lower case, letters and digits only; empty where the name has none.

    Examples
    --------
    >>> {normalised(n) for n in ("mouthSmile_L", "Mouth_Smile_Left", "head_GEO.MouthSmileLeft",
    ...                          "mouthSmile.l", "L_mouthSmile", "MOUTHSMILELEFT")}
    {'mouthsmileleft'}
    """
    parts = [words for words in map(_words, _SPACE.split(name)) if words]
    words = parts[-1] if parts else []
    if len(parts) > 1 and len(words) == 1 and words[0] in _SIDES:
        words = parts[-2] + words
    sides = [w for w in words if w in _SIDES]
    if len(sides) == 1 and len(words) > 1:
        words = [w for w in words if w not in _SIDES] + [_SIDES[sides[0]]]
    return "".join(words)


def _words(text):
    return [w.casefold() for run in _WORD.findall(text) for w in _CAMEL.split(run)]


_ARKIT = {normalised(name): name for name in ARKIT}
_ANGLES = {key: name for name in ANGLES for key in (normalised(name), name.lower())}


def canonical(name):
    """ARKit's own spelling of a name, or of one of the nine angles; None where it is neither.

    Parameters
    ----------
    name : str
        In any spelling that `normalised` sees through.

    Examples
    --------
    >>> canonical("blendShapes.JawOpen"), canonical("headYaw"), canonical("Happy")
    ('jawOpen', 'HeadYaw', None)
    """
    key = normalised(name)
    return _ARKIT.get(key) or _ANGLES.get(key)


def arkit_names(name):
    """ARKit's names for a unit: none, one, or both sides.

    Parameters
    ----------
    name : str
        ARKit's own (`jawOpen`), with a side as in ICT-FaceKit (`mouthSmile_L`), or a FACS unit
        (`AU12L`, `AU1`); in any spelling that `normalised` sees through.

    Returns
    -------
    tuple of str
        `browInnerUp_L` and `_R` share `browInnerUp`, for ARKit has it without sides. Empty where
        ARKit has no counterpart, and for a jaw or mouth that moves to no side named.
    """
    stem, side = normalised(name), ""
    for end in ("left", "right"):
        if stem.endswith(end):
            stem, side = stem.removesuffix(end), end
    if facs := re.fullmatch(r"au(\d{1,3})", stem):
        stem = _FACS.get(int(facs[1]), "").lower()
    for key in (stem + side, stem):  # browInnerUp_L is browInnerUp, which has no sides
        if key in _ARKIT:
            return (_ARKIT[key],)
    if side or stem in ("jaw", "mouth"):  # these two move to no side named
        return ()
    both = (_ARKIT.get(stem + end) for end in ("left", "right", "lower", "upper"))
    return tuple(name for name in both if name)
