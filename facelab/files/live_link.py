"""Takes of the app Live Link Face."""

import csv
import re

import numpy as np

from facelab.motion import WeightSequence
from facelab.storage import existing_file

_LIVE_LINK_ANGLES = tuple(
    f"{part}{axis}" for part in ("Head", "LeftEye", "RightEye") for axis in ("Yaw", "Pitch", "Roll")
)


_LONGEST_GAP = 600  # seconds that may be missing within one take


def read_live_link_csv(path):
    """A performance recorded with the Live Link Face app.

    Names become ARKit's own spelling (`eyeBlinkLeft`). Time codes put every frame in its place:
    frames that the recorder dropped are inserted as lost ones, and so are frames that repeat
    the one before exactly (the tracker had lost the face).

    Parameters
    ----------
    path : str or Path
        CSV with the columns Timecode, BlendShapeCount, 52 ARKit weights and nine angles.

    Returns
    -------
    WeightSequence
        `valid` is False in lost frames; weights as recorded, not clipped; `angles` in radians.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing or empty file, other columns, a row of another length, a value that is not
        a number; the message names file and line.
    """
    path = existing_file(path, "Live Link CSV file")
    with open(path, newline="", encoding="utf-8-sig", errors="replace") as source:
        try:
            lines = csv.reader(source, quoting=csv.QUOTE_NONE)
            rows = [(n, row) for n, row in enumerate(lines, 1) if row]
        except csv.Error as error:
            raise ValueError(f"{path}: not a CSV text file ({error}).") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    missing = [c for c in ("Timecode", "BlendShapeCount", "JawOpen") if c not in header]
    if missing or header[:2] != ["Timecode", "BlendShapeCount"] or "" in header:
        wrong = f"the column(s) {', '.join(missing)} are missing" if missing else "other columns"
        raise ValueError(
            f"{path}, line 1: {wrong}; a Live Link Face CSV starts with Timecode, BlendShapeCount "
            "and 52 ARKit names, and names every column."
        )
    twice = sorted({c for c in header if header.count(c) > 1})
    if twice:
        raise ValueError(f"{path}, line 1: column(s) {', '.join(twice)} stand more than once.")
    if len(rows) < 2:
        raise ValueError(f"{path}: no frames below the header.")
    stamps, values = [], []
    for number, row in rows[1:]:
        if len(row) != len(header):
            raise ValueError(
                f"{path}, line {number}: {len(row)} values, but the header names {len(header)}."
            )
        try:
            stamps.append(_time_code(row[0]))
            values.append([float(v) for v in row[2:]])
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}.") from None
        if not np.isfinite(values[-1]).all():
            raise ValueError(f"{path}, line {number}: NaN or infinity; remove that frame.")
    return _place_in_time(path, header[2:], np.array(values), stamps, [n for n, _ in rows[1:]])


def _time_code(text):
    found = re.fullmatch(r"(\d\d):([0-5]\d):([0-5]\d):(\d+(?:\.\d*)?)", text.strip(), re.ASCII)
    if not found:
        raise ValueError(f"time code {text!r} is not HH:MM:SS:FF.fff")
    hours, minutes, seconds = (int(p) for p in found.groups()[:3])
    return hours * 3600 + minutes * 60 + seconds, float(found[4])


def _place_in_time(path, names, values, stamps, lines):
    most = max(frame for _, frame in stamps)
    # only where a second ends the frames within it show their number; else 30 or 60 are assumed
    known = (24, 25, 30, 50, 60, 120) if stamps[0][0] != stamps[-1][0] else (30, 60, 120)
    base = next((rate for rate in known if most < rate), None)
    if base is None:
        raise ValueError(f"{path}: a time code counts {most:g} frames in a second; 120 at most.")
    seconds = np.array([second + frame / base for second, frame in stamps])
    step = np.diff(seconds)
    if (step <= 0).any():
        line = lines[np.flatnonzero(step <= 0)[0] + 1]
        raise ValueError(f"{path}, line {line}: the time code does not run forwards.")
    if (step > _LONGEST_GAP).any():
        line = lines[np.flatnonzero(step > _LONGEST_GAP)[0] + 1]
        raise ValueError(
            f"{path}, line {line}: the time code leaps {step.max():.0f} seconds, and a gap may "
            f"last {_LONGEST_GAP}; split the take there."
        )
    fps = float(round(1 / np.median(step))) if len(step) else float(base)
    if not 1 <= fps <= 120:
        raise ValueError(f"{path}: the time codes amount to {fps:g} frames/s; 1 to 120 make sense.")
    # counted step by step, for the recorder's clock drifts; jitter never puts two in one place
    slot = np.append(0, np.cumsum(np.maximum(1, np.round(step * fps)))).astype(int)
    valid = np.zeros(slot[-1] + 1, dtype=bool)
    valid[slot] = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    placed = np.full((len(valid), values.shape[1]), np.nan)
    placed[slot] = values
    is_angle = np.array([name in _LIVE_LINK_ANGLES for name in names])
    arkit = tuple(n[0].lower() + n[1:] for n in np.array(names)[~is_angle].tolist())
    angles = {n: placed[:, i] for i, n in enumerate(names) if is_angle[i]}
    return WeightSequence(placed[:, ~is_angle], arkit, fps, valid, angles)
