"""From rows to a take: what all readers of weights share, and the report of what they found.

A reader fills a `Recording`: rows of numbers under names, with what tells their time. `as_take`
checks the values, puts every row in its place in time, and counts what was lost.
"""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from facelab.checks import check_number
from facelab.files.takes.timecodes import FASTEST, LONGEST_FILL, SLOWEST, Timing, timing
from facelab.files.words import listed
from facelab.motion import WeightSequence
from facelab.names import ANGLES, ARKIT

_HIGHEST = 2.0  # a weight of 0 to 1, overdriven
_BEYOND = 1000.0  # no weight, whatever it counts
_WIDEST = {"HeadYaw": 1.6, "HeadPitch": 1.2, "HeadRoll": 1.2}  # radians that a head turns,
_EYE = 1.0  # and an eye


@dataclass
class Recording:
    """Rows of a file as they stand there.

    Parameters
    ----------
    path : Path
    names : list of str
        Name of each column of `values`; those of `ANGLES` are angles, the rest are weights.
    values : ndarray of shape (n_rows, n_columns)
        NaN in rows without a face.
    rows : list of int
        Line of each row in the file (or another number that finds it, see `what`).
    what : str
        What `rows` count: "line", "frame".
    codes : list of str, optional
        Time code of each row, without blanks around it.
    frames : list of int, optional
        Frame number of each row.
    fps : float, optional
        Rate that the file states.
    count : int, optional
        Number of weights that each row says it has.
    others : dict of str to ndarray of shape (n_rows,)
        Columns that are neither.
    weighed : bool
        True if the file is known to hold weights as they are, not in percent.
    warned, notes : list of str
        What the user has to be told, and what the report tells.
    """

    path: Path
    names: list
    values: np.ndarray
    rows: list
    what: str = "line"
    codes: list = None
    frames: list = None
    fps: float = None
    count: int = None
    others: dict = field(default_factory=dict)
    weighed: bool = False
    warned: list = field(default_factory=list)
    notes: list = field(default_factory=list)

    def place(self, row, column=None):
        """File, line and column, for messages."""
        where = f"{self.path}, {self.what} {self.rows[row]}"
        return where if column is None else f"{where}, column {self.names[column]}"


@dataclass(frozen=True)
class TakeReport:
    """What a reader of weights found, and what it left out. Print it.

    Attributes
    ----------
    path : Path
    rows, frames : int
        Rows of the file; frames of the take, lost ones included.
    fps : float
    no_face, repeated, filled : int
        Lost frames: rows without a face; rows that repeat the one before exactly, for which a
        tracker has lost the face; frames missing between two time codes.
    gaps : dict of int to float
        Seconds missing before a frame.
    outside : int
        Weights below 0 or above 1, kept as they are.
    missing : tuple of str
        Names of ARKit that the file has no column for, if it has ARKit's names at all.
    others : tuple of str
        Columns kept apart, for they are neither weights nor angles.
    notes : tuple of str
        All else.
    """

    path: Path
    rows: int
    frames: int
    fps: float
    no_face: int
    repeated: int
    filled: int
    gaps: dict
    outside: int
    missing: tuple
    others: tuple
    notes: tuple

    def __str__(self):
        counted = f"{self.rows} rows, {self.frames} frames at {self.fps:.4g} frames/s"
        lines = [f"{self.path.name}: {counted}"]
        if lost := self.no_face + self.repeated + self.filled:
            lines.append(
                f"lost frames: {lost} ({self.no_face} without a face, {self.repeated} that repeat "
                f"the one before, {self.filled} missing in the file)"
            )
        lines += [f"gap: {s:.2f} s missing before frame {i}" for i, s in self.gaps.items()]
        if self.outside:
            lines.append(f"weights below 0 or above 1: {self.outside}, kept as they are")
        return "\n".join([*lines, *self.notes])

    __repr__ = __str__


def as_take(found, fps=None, scale=None, repeats="kept", stacklevel=3):
    """The take that a recording holds, with its report; warns of what was left out.

    Parameters
    ----------
    found : Recording
    fps : float, optional
        Rate of the rows; what the file says of time is then not used.
    scale : float, optional
        Factor from the file's weights to 0 to 1.
    repeats : {"kept", "lost"}
        What a row is that repeats the one before exactly.
    stacklevel : int
        Of the warnings.

    Returns
    -------
    WeightSequence

    Raises
    ------
    ValueError
        Naming file, line and column.
    """
    is_angle = np.array([name in ANGLES for name in found.names], dtype=bool)
    if is_angle.all():
        raise ValueError(
            f"{found.path}: no column of weights; its columns are "
            f"{listed([*found.names, *found.others]) or 'none'}. If some of them are, name them: "
            "names=[...]."
        )
    face = ~np.isnan(found.values).all(axis=1)
    if not face.any():
        raise ValueError(f"{found.path}: no frame in it shows a face; there is nothing to read.")
    values, is_angle = _checked(found, face, is_angle, scale)
    same = np.zeros(len(values), dtype=bool)
    if repeats == "lost":
        same[1:] = (values[1:] == values[:-1]).all(axis=1)
    times = _timed(found, fps)
    n_frames = int(times.slots[-1]) + 1
    valid = np.zeros(n_frames, dtype=bool)
    valid[times.slots] = face & ~same

    def placed(column):
        full = np.full((n_frames, *column.shape[1:]), np.nan)
        full[times.slots] = column
        return full

    names = np.array(found.names, dtype=object)
    W = values[:, ~is_angle]
    _say(found, times, same, face)
    if {*ARKIT} <= {*found.names}:
        _say_far(found, values, is_angle)
    report = TakeReport(
        path=found.path,
        rows=len(values),
        frames=n_frames,
        fps=times.fps,
        no_face=int((~face).sum()),
        repeated=int(same.sum()),
        filled=n_frames - len(values),
        gaps=times.gaps,
        outside=int(((W < 0) | (W > 1)).sum()),
        missing=tuple(n for n in ARKIT if n not in found.names) if {*ARKIT} & {*names} else (),
        others=tuple(found.others),
        notes=(*found.warned, *found.notes, *times.notes),
    )
    take = WeightSequence(
        placed(W),
        tuple(names[~is_angle]),
        times.fps,
        valid,
        {n: placed(values[:, k]) for k, n in enumerate(names) if is_angle[k]},
        {n: placed(column) for n, column in found.others.items()},
        times.gaps,
        report,
    )
    for words in found.warned:
        warnings.warn(f"{found.path}: {words}.", stacklevel=stacklevel)
    return take


def _say(found, times, same, face):
    if times.gaps:
        most = max(times.gaps.values())
        found.warned.append(
            f"time is missing at {len(times.gaps)} place(s), up to {most:.1f} s, and is marked in "
            "the take's gaps"
        )
    if same.sum() > 0.1 * face.sum():
        found.warned.append(
            f"{int(same.sum())} of {len(same)} rows repeat the one before exactly and count as "
            "lost tracking; if they are held on purpose, give repeats='kept'"
        )


def _say_far(found, values, is_angle):
    """ARKit's weights lie between 0 and 1, a recording's a little beside."""
    far = ((values < -0.25) | (values > 1.5)) & ~is_angle
    if far.any():
        row, k = (int(i) for i in np.argwhere(far)[0])
        found.warned.append(
            f"{int(far.sum())} weights lie far outside 0 to 1 and are kept, the first in "
            f"{found.what} {found.rows[row]}: {found.names[k]} {values[row, k]:g}"
        )


# --- values ---------------------------------------------------------------------------------------


def _checked(found, face, is_angle, scale):
    """The values in units of 0 to 1 and radians, and which columns are angles."""
    values = found.values
    bad = ~np.isfinite(values) & face[:, None]
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        raise ValueError(
            f"{found.place(row, column)}: NaN, infinity or nothing at all; repair that value, or "
            "empty the whole row if the face was lost there."
        )
    if _in_degrees(found, values, is_angle):
        found.others |= {found.names[k]: values[:, k] for k in np.flatnonzero(is_angle)}
        found.names = [n for n, angle in zip(found.names, is_angle, strict=True) if not angle]
        found.values = values = values[:, ~is_angle]
        is_angle = is_angle[~is_angle]
    if scale is not None:
        check_number(scale, "scale", above=0)
        values = np.where(is_angle, values, values * scale)
    limit = _HIGHEST if scale is None and not found.weighed else _BEYOND
    far = (np.abs(values) > limit) & ~is_angle
    if far.any():
        row, column = (int(i) for i in np.argwhere(far)[0])
        _refuse_weights(found, values[:, ~is_angle], far, row, column, scale)
    return values, is_angle


def _in_degrees(found, values, is_angle):
    """Whether the angles are none in radians, all of them, for a file has one unit; doubts said."""
    most = {}
    for k in np.flatnonzero(is_angle):
        most[found.names[k]] = turn = float(np.nanmax(np.abs(values[:, k])))
        if turn > 360:
            row = int(np.nanargmax(np.abs(values[:, k])))
            raise ValueError(
                f"{found.place(row, k)}: {values[row, k]:g} is no angle, in radians or degrees; "
                "repair that value."
            )
    if far := [name for name, turn in most.items() if turn > 2 * np.pi]:
        found.warned.append(
            f"{', '.join(far)} turn further than radians do: all {len(most)} angles, perhaps in "
            "degrees, are kept apart, in others"
        )
        return True
    if found.weighed:  # a table of our own, where angles count in radians
        return False
    remedy = "if these are degrees, take them as such (angles counts in radians)"
    if wide := [name for name, turn in most.items() if turn > _WIDEST.get(name, _EYE)]:
        half = [name for name in wide if most[name] > 1.01 * np.pi]
        what = "half a turn" if half else "a head or an eye does"
        turn = max(most[name] for name in wide)
        found.warned.append(
            f"{', '.join(half or wide)} turn further than {what} in radians, up to {turn:.3g}; "
            f"{remedy}"
        )
    elif _are_tenths(values[:, is_angle]):
        found.warned.append(f"all angles are whole tenths; {remedy}")
    return False


def _are_tenths(angles):
    """Whether all are, and too many to be so by chance."""
    tenths = np.unique(10 * angles[np.isfinite(angles)])
    return len(tenths) > 3 and bool(np.abs(tenths - tenths.round()).max() < 1e-6)


def _refuse_weights(found, W, far, row, column, scale):
    value, most = found.values[row, column], np.nanmax(np.abs(W))
    place = f"{found.place(row, column)}: {value:g}"
    if scale is not None or found.weighed:
        scaled = "" if scale is None else f", times scale={scale:g},"
        raise ValueError(f"{place}{scaled} is beyond any weight; repair that value.")
    count = int(far.sum())
    if 20 < most <= 150 and count > 0.01 * W.size:
        raise ValueError(
            f"{place} is no weight of 0 to 1, nor are {count - 1} others, up to {most:g}; if the "
            "file counts to 100, say so: scale=0.01."
        )
    if 150 < most <= 255 and not (W[np.isfinite(W)] % 1).any():
        raise ValueError(
            f"{place} is no weight of 0 to 1, nor are {count - 1} others, up to {most:g}; if the "
            "file counts to 255, say so: scale=1/255."
        )
    raise ValueError(
        f"{place} is no weight of 0 to 1, nor are {count - 1} others; repair what is wrong, or "
        "give the factor that makes weights of 0 to 1 of all of them: scale=1 if they are meant so."
    )


# --- time -----------------------------------------------------------------------------------------


def _timed(found, fps):
    n = len(found.rows)
    if fps is not None:
        fps = check_number(fps, "fps", above=0)
        if found.codes is not None:
            found.notes.append(f"time codes not used: fps={fps:g} was given")
    elif found.codes is not None:
        times = timing(found)
        if found.fps and n > 1 and abs(times.fps / found.fps - 1) > 0.02:
            raise ValueError(
                f"{found.path}: it states {found.fps:g} frames/s, but its times run at "
                f"{times.fps:.4g}; say which is right: fps={found.fps:g}."
            )
        return times
    elif found.fps is not None:
        fps = found.fps
        if not found.weighed and not 0.99 * SLOWEST <= fps <= 1.01 * FASTEST:
            raise ValueError(
                f"{found.path}: it states {fps:g} frames/s, and a face is recorded with {SLOWEST} "
                f"to {FASTEST}; if it is meant so, say so: fps={fps:g}."
            )
    else:
        raise ValueError(
            f"{found.path}: nothing in it tells the time; give the rate of its rows, fps=30."
        )
    if found.frames is None:
        return Timing(np.arange(n), fps)
    return _numbered(found, fps)


def _numbered(found, fps):
    """Rows placed by the frame numbers that they have."""
    step = np.diff(found.frames)
    if (step <= 0).any():
        at = int(np.flatnonzero(step <= 0)[0])
        raise ValueError(
            f"{found.place(at + 1)}: frame {found.frames[at + 1]} follows frame "
            f"{found.frames[at]}; put the rows in order, each frame once."
        )
    step = step // max(1, np.gcd.reduce(step, initial=0))  # every second frame is every frame
    gaps, longest = {}, LONGEST_FILL * fps
    for at in np.flatnonzero(step > longest).tolist():
        missing, step[at] = int(step[at] - 1), 1
        gaps[at + 1] = missing / fps
    slots = np.append(0, np.cumsum(step)).astype(int)
    if slots[-1] + 1 > 2 * max(len(slots), 60):
        raise ValueError(
            f"{found.place(0)}: {len(slots)} rows are numbered as if they were {slots[-1] + 1} "
            "frames; these numbers do not count frames."
        )
    return Timing(slots, fps, {int(slots[i]): seconds for i, seconds in gaps.items()})
