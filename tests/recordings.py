"""Live Link Face recordings as text, of every kind that the world writes."""

import numpy as np

from facelab.names import ANGLES, ARKIT

PASCAL = tuple(n[0].upper() + n[1:] for n in ARKIT)
FULL = (*PASCAL, *ANGLES)


def code(frames, base=30, start=13 * 3600 + 13 * 60 + 4, mark=":"):
    """Time code of a moment counted in frames of 1/base second."""
    second, frame = divmod(round(frames * 1000), base * 1000)
    hours, rest = divmod(int(start + second), 3600)
    return f"{hours % 24:02d}:{rest // 60:02d}:{rest % 60:02d}{mark}{frame / 1000:06.3f}"


def drop_frame(number, base):
    """The SMPTE drop-frame code of a frame counted from midnight, as the standard tells it.

    Written to be seen through: every number is counted up, and those passed over are skipped.
    """
    passed, minute = base // 15, 0
    while number >= (length := 60 * base - (passed if minute % 10 else 0)):
        number, minute = number - length, minute + 1
    number += passed if minute % 10 else 0
    hours, minutes = minute // 60 % 24, minute % 60
    return f"{hours:02d}:{minutes:02d}:{number // base:02d};{number % base:02d}.000"


def values(n_rows, n_columns):
    """Weights of which no two rows are alike: 0.1 to 0.9, four digits."""
    return np.random.default_rng(7).integers(1000, 9000, size=(n_rows, n_columns)) / 10000


def live_link(codes, columns=FULL, rows=None, count="BlendshapeCount", sep=",", end="\n"):
    """Text of a recording; a row may be None, for a frame without a face."""
    rows = values(len(codes), len(columns)).tolist() if rows is None else rows
    lines = [sep.join(["Timecode", count, *columns])]
    for stamp, row in zip(codes, rows, strict=True):
        cells = ["0"] if row is None else [str(len(row)), *map(str, row)]
        lines.append(sep.join([stamp, *cells]))
    return end.join(lines) + end
