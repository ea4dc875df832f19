"""Names of facial shapes, whatever their spelling: ARKit's own, and a key under which all agree."""

import re
from collections import Counter
from dataclasses import dataclass

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
_FACS_NAMES = {  # by normalised name: as FACS names its units, and as rigs built on it shorten that
    **{"innerbrowraiser": 1, "outerbrowraiser": 2, "browlowerer": 4, "upperlidraiser": 5},
    **{"cheekraiser": 6, "lidtightener": 7, "nosewrinkler": 9, "upperlipraiser": 10},
    **{"nasolabialdeepener": 11, "nasolabialfurrow": 11, "lipcornerpuller": 12, "dimpler": 14},
    **{"lipcornerdepressor": 15, "lowerlipdepressor": 16, "chinraiser": 17, "lippucker": 18},
    **{"lippuckerer": 18, "lipstretcher": 20, "lipfunneler": 22, "liptightener": 23},
    **{"lippressor": 24, "lipspart": 25, "jawdrop": 26, "mouthstretch": 27, "lipsuck": 28},
    **{"jawthrust": 29, "jawsideways": 30, "cheekpuff": 34, "cheekpuffer": 34, "cheeksuck": 35},
    **{"nostrildilator": 38, "nostrilcompressor": 39, "eyesclosed": 45, "eyeclosed": 45},
    **{"eyeclosure": 45, "blink": 45},
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}  # LT may be left and top
_SPACE = re.compile(r"[.:|/\\]+")  # what ends a namespace: head_GEO.jawOpen, Body:jawOpen
_COPY = re.compile(r"(?<=[^\W\d])\.\d{3}$")  # jawOpen.001: a copy, as Blender numbers them
_WORD = re.compile(r"[^\W\d_]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def normalised(name):
    """The key of a name: equal for names that differ in case, separators, side spelling, namespace.

    A side (`L`, `left`, `.r`, in front or behind) goes to the end. What stands before the last
    `.`, `:`, `|` or `/` is a namespace and goes, unless only a side follows; so does the number of
    a copy (`jawOpen.001`).

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
    return _key(_own_words(name))


def spaced(name):
    """The words of a name in lower case, an underscore between them.

    Examples
    --------
    >>> spaced("Head Rot.X"), spaced("trackingQuality")
    ('head_rot_x', 'tracking_quality')
    """
    return "_".join(_words(name))


def _own_words(name):
    """Words of a name without its namespace."""
    name = _COPY.sub("", name)
    parts = [words for words in map(_words, _SPACE.split(name)) if words]
    words = parts[-1] if parts else []
    if len(parts) > 1 and len(words) == 1 and words[0] in _SIDES:
        words = parts[-2] + words
    return words


def _key(words):
    """Words as one, a side at the end; of several sides (L_eyesLookRight) the one in front."""
    sides = [w for w in words if w in _SIDES]
    words = [_SIDES.get(w, w) if len(words) > 1 else w for w in words]
    if words and words[0] in _SIDES and len(words) > 1:
        words = [*words[1:], words[0]]
    elif len(sides) == 1 and len(words) > 1:
        words = [w for w in words if w not in _SIDES] + [_SIDES[sides[0]]]
    return "".join(words)


def _words(text):
    return [w.casefold() for run in _WORD.findall(text) for w in _CAMEL.split(run)]


# --- two lists of names ---------------------------------------------------------------------------


@dataclass(frozen=True)
class NameMatch:
    """What drives what, as `match_names` finds it; printed, a report.

    Parameters
    ----------
    driven : dict of str to str
        The name that drives each shape.
    idle : tuple of str
        Shapes that nothing drives.
    left_over : tuple of str
        Names that drive nothing.
    """

    driven: dict
    idle: tuple
    left_over: tuple

    def __repr__(self):
        return f"NameMatch({self._summary})"

    def __str__(self):
        lines = [f"{self._summary}."]
        other = {}
        for shape, name in self.driven.items():
            if shape != name:
                other.setdefault(name, []).append(shape)
        if other:
            said = (f"{' and '.join(shapes)} by {name}" for name, shapes in other.items())
            lines.append(f"In another spelling: {', '.join(said)}.")
        if self.idle:
            lines.append(f"Not driven: {', '.join(self.idle)}.")
        if self.left_over:
            lines.append(f"Left over: {', '.join(self.left_over)}.")
        return "\n".join(lines)

    @property
    def _summary(self):
        used = len(set(self.driven.values()))
        return (
            f"{len(self.driven)} of {len(self.driven) + len(self.idle)} shapes driven by {used} of "
            f"{used + len(self.left_over)} names"
        )


def match_names(shapes, names, sided=False, what="shape"):
    """Which of some names drives each shape, whatever their spelling.

    The same name is taken first, then one that differs in case, separators, spelling of the side
    or namespace (see `normalised`), then one that differs by a prefix that half of its list has
    (`head_jawOpen`, `A07_jawOpen`), and at last a name without side for a shape that has one
    (`browInnerUp` for `browInnerUp_L` and `browInnerUp_R`; a bare `jaw` or `mouth` says no
    direction).

    Parameters
    ----------
    shapes, names : sequence of str
        Each once.
    sided : bool, default=False
        A name without side drives no shape that has one.
    what : str
        What the shapes are, for messages.

    Returns
    -------
    NameMatch

    Raises
    ------
    ValueError
        Where two names read like one shape, or two shapes like one name, and none is spelled the
        same.

    Examples
    --------
    >>> print(match_names(["JawOpen", "browUp_L", "nod"], ["head.jawOpen", "browUp", "tongueOut"]))
    2 of 3 shapes driven by 2 of 3 names.
    In another spelling: JawOpen by head.jawOpen, browUp_L by browUp.
    Not driven: nod.
    Left over: tongueOut.
    """
    driven = {shape: shape for shape in shapes if shape in set(names)}
    plain = [normalised(n) for n in shapes], [normalised(n) for n in names]
    short = _without_prefix(shapes), _without_prefix(names)
    ways = [plain, (short[0], plain[1]), (plain[0], short[1]), short]
    taken = set(driven.values())
    for keys, theirs in ways:
        _add(driven, taken, shapes, keys, names, theirs, what)
        taken |= set(driven.values())
    for keys, theirs in () if sided else ways:
        stems = [_stem(key) for key in keys]
        _add(driven, taken, shapes, stems, names, theirs, what, shared=True)
    return NameMatch(
        {shape: driven[shape] for shape in shapes if shape in driven},
        tuple(shape for shape in shapes if shape not in driven),
        tuple(name for name in names if name not in set(driven.values())),
    )


def as_landmarks(landmarks, named):
    """Named things, those that read like landmarks under the landmarks' own names.

    Parameters
    ----------
    landmarks : iterable of str
    named : dict of str
        By names in any spelling of case, side and prefix.

    Returns
    -------
    dict of str
        In the same order; what reads like no landmark keeps its name.

    Examples
    --------
    >>> as_landmarks(["chin", "brow_left_1"], {"Head:CHIN": 3, "brow_L_1": 5, "ear": 7})
    {'chin': 3, 'brow_left_1': 5, 'ear': 7}
    """
    match = match_names(list(landmarks), list(named), sided=True, what="landmark")
    meant = {name: landmark for landmark, name in match.driven.items()}
    return {meant.get(name, name): thing for name, thing in named.items()}


def _add(driven, taken, shapes, keys, names, theirs, what, shared=False):
    """Shapes not driven yet, by names not taken yet whose key is theirs; refused where unclear."""
    found, claims, plain = {}, {}, what == "shape"
    for name, key in zip(names, theirs, strict=True):
        if name not in taken and key:
            found.setdefault(key, []).append(name)
    for shape, key in zip(shapes, keys, strict=True):
        if shape in driven or key not in found:
            continue
        if len(found[key]) > 1:
            raise ValueError(
                f"{', '.join(map(repr, found[key]))} all read like the {what} {shape!r}; give the "
                f"one meant that name, and the others another{' (take.renamed)' * plain}."
            )
        claims.setdefault(found[key][0], []).append(shape)
    for name, several in claims.items():
        if len(several) > 1 and not shared:
            raise ValueError(
                f"the {what}s {', '.join(map(repr, several))} all read like {name!r}; give the "
                f"one meant that name, and the others another{' (rig.renamed)' * plain}."
            )
        driven.update(dict.fromkeys(several, name))


def _stem(key):
    """A key without its side; empty where it has none, or says nothing without."""
    for end in ("left", "right"):
        if key.endswith(end) and key.removesuffix(end) not in ("", "jaw", "mouth"):
            return key.removesuffix(end)
    return ""


def _without_prefix(names):
    """Keys without the leading words, or numbers, that half of the names share, two at least."""
    words = _without_numbers([_own_words(n) for n in names])
    prefix = []
    while True:
        ahead = Counter(
            w[len(prefix)] for w in words if len(w) > len(prefix) + 1 and w[: len(prefix)] == prefix
        )
        word, count = ahead.most_common(1)[0] if ahead else ("", 0)
        if count < max(2, len(words) / 2) or word in _SIDES:
            break
        prefix.append(word)
    n = len(prefix)
    if n:  # and the numbers behind it: ARKit_01_jawOpen
        words = _without_numbers([w[n:] if w[:n] == prefix else w for w in words])
    return [_key(w) for w in words]


def _without_numbers(words):
    """Words of names without the numbers in front, where most have one: 01_jawOpen, A25_jawOpen."""
    bare = [_behind_number(w) for w in words]
    found = sum(b is not w for b, w in zip(bare, words, strict=True))
    return bare if 2 * found > len(words) else words


def _behind_number(words):
    """Words of a name behind a number, or a letter and a number; all where a side would be left."""
    n = 0
    if len(words) > 1:
        lettered = len(words[0]) == 1 and words[0] not in _SIDES and words[1].isdigit()
        n = 1 if words[0].isdigit() else 2 if lettered else 0
    return words[n:] if n and words[n:] and words[n] not in _SIDES else words


# --- what a name means ----------------------------------------------------------------------------


_FOR_FACS = {normalised(n).removesuffix("left").removesuffix("right") for n in ARKIT}
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
        ARKit's own (`jawOpen`), with a side as in ICT-FaceKit (`mouthSmile_L`), or a FACS unit by
        number (`AU12L`, `AU1`) or name (`lipCornerPuller_L`); in any spelling that `normalised`
        sees through.

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
    facs = re.fullmatch(r"au(\d{1,3})", stem)
    if facs or (stem not in _FOR_FACS and stem in _FACS_NAMES):
        stem = _FACS.get(int(facs[1]) if facs else _FACS_NAMES[stem], "").lower()
    for key in (stem + side, stem):  # browInnerUp_L is browInnerUp, which has no sides
        if key in _ARKIT:
            return (_ARKIT[key],)
    if side or stem in ("jaw", "mouth"):  # these two move to no side named
        return ()
    both = (_ARKIT.get(stem + end) for end in ("left", "right", "lower", "upper"))
    return tuple(name for name in both if name)
