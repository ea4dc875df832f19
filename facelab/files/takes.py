"""Weights for other tools: a plain table, and the CSV of Live Link Face under ARKit's names."""

import csv
import re
import warnings

import numpy as np

from facelab.checks import as_finite, check_number, check_type
from facelab.motion import WeightSequence
from facelab.storage import atomic_path, existing_file

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

_ANGLES = tuple(
    f"{p}{a}" for p in ("Head", "LeftEye", "RightEye") for a in ("Yaw", "Pitch", "Roll")
)
_FACS = {  # those with one plain counterpart; left out are AU11, 13, 23, 25, 35 and 38
    **{1: "browInnerUp", 2: "browOuterUp", 4: "browDown", 5: "eyeWide", 6: "cheekSquint"},
    **{7: "eyeSquint", 9: "noseSneer", 10: "mouthUpperUp", 12: "mouthSmile", 14: "mouthDimple"},
    **{15: "mouthFrown", 16: "mouthLowerDown", 17: "mouthShrugLower", 18: "mouthPucker"},
    **{20: "mouthStretch", 22: "mouthFunnel", 24: "mouthPress", 26: "jawOpen", 27: "jawOpen"},
    **{28: "mouthRoll", 29: "jawForward", 30: "jaw", 34: "cheekPuff", 45: "eyeBlink"},
}
_BASES = (24, 25, 30, 50, 60, 120)  # frames a second that a time code may count


def arkit_names(name):
    """ARKit's names for a unit: none, one, or both sides.

    Parameters
    ----------
    name : str
        ARKit's own (`jawOpen`), with a side as in ICT-FaceKit (`mouthSmile_L`), or a FACS unit
        (`AU12L`, `AU1`).

    Returns
    -------
    tuple of str
        `browInnerUp_L` and `_R` share `browInnerUp`, for ARKit has it without sides. Empty where
        ARKit has no counterpart, and for a jaw or mouth that moves to no side named.
    """
    facs = re.fullmatch(r"AU(\d+)([LR]?)", name)
    stem, side = (_FACS.get(int(facs[1]), ""), facs[2]) if facs else (name, "")
    if not facs and name[-2:] in ("_L", "_R"):
        stem, side = name[:-2], name[-1]
    sides = {"L": ("Left",), "R": ("Right",), "": ("Left", "Right", "Lower", "Upper")}[side]
    if stem in ARKIT:
        return (stem,)
    if stem in ("jaw", "mouth") and not side:  # to both sides at once
        return ()
    return tuple(stem + s for s in sides if stem + s in ARKIT and stem)


def to_arkit(take):
    """The same weights under the 52 names of ARKit.

    Where several units share a name (`browInnerUp_L` and `_R`, AU26 and AU27), the strongest
    counts. What was not there rests at 0.

    Parameters
    ----------
    take : WeightSequence

    Returns
    -------
    WeightSequence

    Raises
    ------
    TypeError, ValueError
        If `take` is no WeightSequence or no unit of it has an ARKit name.

    Warns
    -----
    UserWarning
        Naming the units in use that ARKit has no counterpart for.
    """
    check_type(take, "take", WeightSequence, "WeightSequence(weights, names, fps)")
    targets = {name: arkit_names(name) for name in take.names}
    if not any(targets.values()):
        raise ValueError(
            f"take has no unit with an ARKit name; its units are {', '.join(take.names[:6])}, ...; "
            "write it under its own names with write_weights_csv."
        )
    W = np.where(take.valid[:, None], take.weights, 0)
    used = (np.abs(W) > 1e-3).any(axis=0)
    lost = [n for n, u in zip(take.names, used, strict=True) if u and not targets[n]]
    if lost:
        warnings.warn(f"not exported, ARKit has no such shape: {', '.join(lost)}.", stacklevel=2)
    out = np.zeros((take.n_frames, len(ARKIT)))
    for k, name in enumerate(take.names):
        for target in targets[name]:
            column = out[:, ARKIT.index(target)]
            column[:] = np.where(np.abs(W[:, k]) > np.abs(column), W[:, k], column)
    out[~take.valid] = np.nan
    return WeightSequence(out, ARKIT, take.fps, take.valid, take.angles)


def write_live_link_csv(path, take):
    """Write weights as Live Link Face records them; `read_live_link_csv` reads them back.

    Lost frames are left out, and their place in time is kept by the time codes. Readers take a
    frame that repeats the one before exactly for a lost one; so does ours.

    Parameters
    ----------
    path : str or Path
    take : WeightSequence
        Under ARKit's names, those of ICT-FaceKit or FACS, see `to_arkit`. Angles that it has are
        written, the others are 0.

    Raises
    ------
    ValueError
        For a rate that a time code cannot count, no valid frame, or no unit with an ARKit name.
    """
    take = to_arkit(take)
    if not take.valid.any():
        raise ValueError("take has no valid frame: there is nothing to write.")
    step, base = _time_base(take.fps)
    angles = [take.angles.get(name, np.zeros(take.n_frames)) for name in _ANGLES]
    with atomic_path(path) as part, open(part, "w", newline="") as out:
        writer = csv.writer(out)
        names = [n[0].upper() + n[1:] for n in ARKIT]
        writer.writerow(["Timecode", "BlendShapeCount", *names, *_ANGLES])
        for frame in np.flatnonzero(take.valid):
            # from the last beat of a second, so that the file shows how many a second has
            seconds, beat = divmod(base - step + int(frame) * step, base)
            minutes, second = divmod(seconds, 60)
            code = f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}:{beat:02d}.000"
            values = [*take.weights[frame], *(a[frame] for a in angles)]
            writer.writerow([code, len(names) + len(_ANGLES), *(f"{v:.9g}" for v in values)])


def _time_base(fps):
    """Beats between frames, and beats a second, such that the last beat tells them apart."""
    for low, base in zip((0, *_BASES), _BASES, strict=False):
        step = base / fps
        if step == int(step) and base - step >= low:
            return int(step), base
    raise ValueError(
        f"fps={fps:g}, but a time code counts {', '.join(map(str, _BASES))} or an even part of "
        "them; resample the take."
    )


def write_weights_csv(path, take):
    """Write weights as a plain table: frame, fps, and a column for each unit under its own name.

    Parameters
    ----------
    path : str or Path
    take : WeightSequence
        Lost frames become empty cells. Angles are not written.
    """
    with atomic_path(path) as part, open(part, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["frame", "fps", *take.names])
        for frame, (weights, valid) in enumerate(zip(take.weights, take.valid, strict=True)):
            cells = [repr(float(w)) if valid else "" for w in weights]
            writer.writerow([frame, repr(take.fps), *cells])


def read_weights_csv(path):
    """Weights from a table written by `write_weights_csv`, exactly as they were.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    WeightSequence

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file; the message names file and line.
    """
    path = existing_file(path, "weight table")
    with open(path, newline="", encoding="utf-8-sig", errors="replace") as source:
        lines = csv.reader(source)
        rows = [(lines.line_num, row) for row in lines if row]
    header, rows = rows[0][1] if rows else [], rows[1:]
    if header[:2] != ["frame", "fps"] or len(header) < 3 or not rows:
        raise ValueError(
            f"{path}: not a weight table; it starts with the columns frame, fps and the units, and "
            "has a row for each frame."
        )
    W, rate = np.full((len(rows), len(header) - 2), np.nan), "".join(rows[0][1][1:2])
    for i, (line, row) in enumerate(rows):
        place = f"{path}, line {line}"
        if len(row) != len(header) or row[:2] != [str(i), rate]:
            raise ValueError(
                f"{place}: here should be frame {i} at {rate or '?'} frames/s with {W.shape[1]} "
                "weights; the table was cut or edited."
            )
        try:
            fps = float(rate)
        except ValueError:
            raise ValueError(f"{place}: fps={rate!r} is not a number.") from None
        try:
            fps = check_number(fps, "fps", above=0)
            W[i] = [float(cell) for cell in row[2:]] if any(row[2:]) else np.nan
        except (TypeError, ValueError) as error:
            raise ValueError(f"{place}: {str(error).rstrip('.')}.") from None
        if any(row[2:]):
            as_finite(W[i], "weights", (W.shape[1],), place)
    return WeightSequence(W, header[2:], fps, ~np.isnan(W[:, 0]))
