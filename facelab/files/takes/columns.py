"""What the columns of a table are, found by their names alone."""

import re
from collections import Counter
from dataclasses import dataclass, field

from facelab.files.text import tells_time, time_columns
from facelab.files.words import listed
from facelab.names import ANGLES, ARKIT, canonical, normalised, spaced

_COUNT = "blendshapecount"
_INTENSITY = re.compile(r"AU\d\d_r")
_ABOUT = re.compile(  # what a tracker says of itself, not of a shape
    r"(?:(?:face|track|tracking|detect|detection|detected|head|pose|landmarks?|overall)_)*"
    r"(?:confidence|conf|success|quality|score|probability|likelihood|accuracy|valid|visible|tracked|"
    r"tracking|detected|state|status|id|person|subject|dt|delta_time|duration)"
)
_BODY = "(?:(?:head|face|neck|eyes?|gaze|camera|root|body|skull|spine|left|right|l|r)_)"
_MOVE = "(?:rot|rotate|rotation|pos|position|trans|translate|translation|loc|location|quat|"
_MOVE += "quaternion|orientation|euler)"
_PLACED = re.compile(  # head_rx, rotX, Head Position Y, neckYaw; but no control: CTRL_C_jaw.ty
    rf"(?!(?:ctrl|ctl|cnt|con|control)_)(?:.+_)?(?:{_MOVE}_?|[rtpq])[xyzw]"
    rf"|{_BODY}*(?:(?:rotation|rot|pose)_)?(?:yaw|pitch|roll)"
    rf"|{_BODY}+(?:{_MOVE}(?:_?\d)?|[xyzw])"
)


@dataclass
class Columns:
    """Columns by their place: what each is; None or empty where there is none.

    Parameters
    ----------
    time, count, frame, fps : int, optional
        Time of each row, number of weights in it, its frame number, frames a second.
    milliseconds : bool
        What `time` counts, if it is a number; else seconds.
    intensities : bool
        Whether all are intensities of action units as OpenFace writes them, from 0 to 5.
    numbers : dict of int to str
        Weights and angles, under the names they will have.
    others : dict of int to str
        What is kept apart.
    """

    time: int = None
    count: int = None
    frame: int = None
    fps: int = None
    milliseconds: bool = False
    intensities: bool = False
    numbers: dict = field(default_factory=dict)
    others: dict = field(default_factory=dict)


def live_link_columns(header, place, timed=True):
    """Columns of a Live Link Face recording: ARKit's weights, nine angles, and what is neither.

    Parameters
    ----------
    header : list of str
    place : str
        For messages.
    timed : bool
        Whether a time code is needed.

    Raises
    ------
    ValueError
        For columns without a name or with the same, no time code, or no weight of ARKit.
    """
    _refuse_nameless(header, place, but=0)
    keys, bare = [normalised(name) for name in header], _without_prefix(header)
    columns = Columns(time=_first("timecode", keys), count=_first(_COUNT, keys))
    for k, name in enumerate(header):
        if name and k not in (columns.time, columns.count):  # nameless: rows numbered by a library
            known = canonical(bare[k])
            (columns.numbers if known else columns.others)[k] = known or name
    if (columns.time is None and timed) or not {*columns.numbers.values()} & {*ARKIT}:
        what = "Timecode" if columns.numbers else "a weight of ARKit (JawOpen, EyeBlinkLeft, ...)"
        raise ValueError(
            f"{place}: no column {what}; a Live Link Face CSV starts with Timecode, "
            "BlendshapeCount and 52 such names. Other tables of weights: read_weights."
        )
    _refuse_doubles([columns.numbers.get(k, name) for k, name in enumerate(header)], header, place)
    return columns


def is_live_link(header):
    """True for the header of such a recording."""
    keys = [normalised(name) for name in header]
    return "timecode" in keys and _COUNT in keys


def weight_columns(header, place, names=None):
    """Columns of any table of weights.

    All that do not tell the time are weights under the names they have, but for what a tracker says
    of itself (`confidence`), where something stands or turns (`head_rx`), and a second column of
    times: these are kept apart, and the nine angles of Live Link Face are angles. Where half of
    them or more are ARKit's, and half of ARKit's are there, they get its spelling and the others
    are kept apart; so are those beside the intensities of OpenFace (`AU12_r`, which becomes
    `AU12`).

    Parameters
    ----------
    header : list of str
    place : str
        For messages.
    names : sequence of str, optional
        The columns that are weights.

    Raises
    ------
    ValueError
        For columns without a name or with the same, or names that are not there.
    """
    header, columns = list(header), _timed(header)
    bare = _without_prefix(header)
    _refuse_nameless(header, place, but=columns.frame)
    told = (columns.time, columns.count, columns.frame, columns.fps)
    rest = [k for k in range(len(header)) if k not in told]
    if names is not None:
        missing = [n for n in names if n not in header]
        if missing:
            raise ValueError(
                f"{place}: no column {listed(missing)}; there are {listed(header, 12)}."
            )
        columns.numbers = {header.index(n): n for n in names}
    elif openface := [k for k in rest if _INTENSITY.fullmatch(header[k])]:
        columns.numbers = {k: header[k] for k in openface}
    elif _is_arkit([bare[k] for k in rest]):
        columns.numbers = {k: canonical(bare[k]) for k in rest if canonical(bare[k])}
    else:
        named = {k: _kept(bare[k]) for k in rest}
        columns.numbers = {k: n if n in ANGLES else header[k] for k, n in named.items() if n}
    columns.others = {k: header[k] for k in rest if k not in columns.numbers}
    columns.intensities = all(map(_INTENSITY.fullmatch, columns.numbers.values()))
    if columns.intensities:  # the r is no side
        columns.numbers = {k: n.removesuffix("_r") for k, n in columns.numbers.items()}
    _refuse_doubles([columns.numbers.get(k, name) for k, name in enumerate(header)], header, place)
    return columns


def _timed(header):
    time, milliseconds, frame = time_columns(header)
    keys = [normalised(name) for name in header]
    return Columns(time, _first(_COUNT, keys), frame, _first("fps", keys), milliseconds)


def _first(key, keys):
    return keys.index(key) if key in keys else None


def _kept(name):
    """The name of a weight or an angle; None for what is neither."""
    known = canonical(name)
    if known in ANGLES:
        return known
    words = spaced(name)
    return None if tells_time(name) or _ABOUT.fullmatch(words) or _PLACED.fullmatch(words) else name


def _is_arkit(names):
    """Spelled as ARKit has them but for case and a namespace in front."""
    ends = [name.split(".")[-1].split(":")[-1].lower() for name in names]
    found = {*ends} & {name.lower() for name in ARKIT}
    return 2 * len(found) >= max(len(ARKIT), len(names))


def _without_prefix(header):
    """Names without what half of them have in front of ARKit's: ARKit_JawOpen, ARKit_HeadYaw."""
    known = "|".join((*ARKIT, *ANGLES))
    found = [re.fullmatch(rf"(.*?[\W_])?(?:{known})", name, re.IGNORECASE) for name in header]
    prefix, count = Counter(f and f[1] for f in found).most_common(1)[0]
    if not prefix or 2 * count < len(header):
        return header
    return [name.removeprefix(prefix) for name in header]


def _refuse_nameless(header, place, but=None):
    for k, name in enumerate(header):
        if not name and k != but:
            raise ValueError(f"{place}: column {k + 1} has no name; name it, or remove it.")


def _refuse_doubles(names, header, place):
    same = {}
    for name, written in zip(names, header, strict=True):
        same.setdefault(name, []).append(written)
    twice = [" and ".join(written) for written in same.values() if len(written) > 1]
    if twice:
        raise ValueError(
            f"{place}: columns that name the same: {'; '.join(twice)}. Remove one of them."
        )
