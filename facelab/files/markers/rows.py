"""Rows of numbers out of text: fast and strict; and the beat of their frames."""

import csv
import math
import re
from array import array
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np

from facelab.files.markers.rules import marker_sequence, resolve_names, warn
from facelab.files.takes.timecodes import SLOWEST
from facelab.files.text import as_number, text_lines
from facelab.files.words import damaged, listed

_BLOCK = 2**20  # numbers kept together
_BLANK = " \t,;"  # a line of these alone holds nothing
_NOTHING = ("", "nan", "null")
_FASTEST = 2000  # frames a second of a capture system
_PLAIN = re.compile(r"[-+0-9.eE \t\n]*")  # here float() finds but numbers as all write them


class Lines:
    """Lines of a text file, one after another, with their numbers.

    Attributes
    ----------
    number : int
        Of the line read last, counted from 1.
    whole : bool
        False if that one has no line end.
    """

    def __init__(self, path, what):
        self.path, self.number, self.whole = path, 0, True
        self._lines, self._held = text_lines(path, what), []

    def next(self):
        """The next line without its end, or None."""
        found = self._held.pop() if self._held else next(self._lines, None)
        if found is None:
            return None
        self.number, line, self.whole = found
        if "\r" in line:
            raise damaged(
                f"{self.path}, line {self.number}: a carriage return in the middle of the line"
            )
        return line

    def back(self, line):
        """Give the line read last back."""
        self._held.append((self.number, line, self.whole))
        self.number -= 1

    def rows(self, n=math.inf, blank=_BLANK):
        """Up to n lines that hold more than blanks, as (number, line)."""
        while n > 0 and (line := self.next()) is not None:
            if line.strip(blank):
                yield self.number, line
                n -= 1


def cells(line, delimiter):
    """Cells of a line of a header, without quotes and blanks around them."""
    try:
        line = line if delimiter == "\t" else line.replace("\t", " ")
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # a cell of more than 128 kB
        row = line.split(delimiter)
    return [cell.strip() for cell in row]


def stated(path, text, what, whole=False):
    """A number of a header, or None where it is not stated."""
    text = text.strip()
    if not text:
        return None
    pattern = r"\d+" if whole else r"\d+([.,]\d*)?|[.,]\d+"
    if not re.fullmatch(pattern, text, re.ASCII) or len(text) > 18:
        raise ValueError(f"{path}: {what} is {text[:40]!r}, which is no such number; repair it.")
    number = int(text) if whole else float(text.replace(",", "."))
    if number == 0:
        raise damaged(f"{path}: {what} is 0")
    return number


@dataclass
class Table:
    """What a header says about the rows that follow.

    Parameters
    ----------
    columns : list of str
        Name of each column, for messages.
    markers : list of (str, (int, int, int))
        Name and columns of x, y and z of each marker.
    frame, time : int, optional
        Columns that count frames, and seconds (or, with `per_second`, parts of them).
    rate, n_frames : float and int, optional
        As the header has them.
    factor : float
        Millimetres in one unit.
    until_blank : bool
        The rows end at the first blank line; else blank lines are passed over.
    """

    columns: list
    markers: list
    delimiter: str
    frame: int = None
    time: int = None
    per_second: float = 1.0
    rate: float = None
    n_frames: int = None
    factor: float = 1.0
    until_blank: bool = False
    report: list = field(default_factory=list)

    @property
    def used(self):
        """Columns that are read, in their order."""
        counted = {c for c in (self.frame, self.time) if c is not None}
        return sorted(counted | {c for _, three in self.markers for c in three})


def read_table(path, lines, table, fps, subject):
    """The markers of a table: rows parsed, names resolved, frames put in their places in time.

    Parameters
    ----------
    path : Path
    lines : Lines
        Behind the header.
    table : Table
    fps : float or None
        Given by the caller: rows follow one another, whatever a column of times says.
    subject : str or None

    Returns
    -------
    MarkerSequence
    """
    report = table.report
    names, kept = resolve_names(path, [name for name, _ in table.markers], subject, report)
    place = {column: i for i, column in enumerate(table.used)}
    axes = np.array([[place[column] for column in table.markers[i][1]] for i in kept])
    counted = {key: [] for key in ("frame", "time") if getattr(table, key) is not None}
    numbers, positions = [], []
    for block, values in _blocks(path, lines, table):
        with np.errstate(over="ignore"):  # refused where all is checked
            positions.append((values[:, axes] * table.factor).astype(np.float32))
        for key, parts in counted.items():
            parts.append(values[:, place[getattr(table, key)]])
        numbers += block
    n = len(numbers)
    if n == 0:
        raise ValueError(f"{path}: no frames below the header.")
    if table.n_frames is not None and n != table.n_frames:
        raise damaged(f"{path}: the header counts {table.n_frames} frames, but {n} rows follow")
    positions = np.concatenate(positions)
    counted = {key: np.concatenate(parts) for key, parts in counted.items()}
    rate, slots = _beat(path, table, counted, numbers, fps)
    if slots is not None and slots[-1] >= n:
        spread = np.full((int(slots[-1]) + 1, len(names), 3), np.nan, dtype=np.float32)
        spread[slots] = positions
        positions = spread
    return marker_sequence(path, positions, names, rate, report)


# --- numbers --------------------------------------------------------------------------------------


def _blocks(path, lines, table):
    """Line numbers and values of rows, shape (n_rows, n_used), some at a time; NaN where empty."""
    pick, numbers, values = itemgetter(*table.used), [], array("d")
    for number, cells in _rows(path, lines, table):
        numbers.append(number)
        values.extend(_numbers(path, table, number, pick(cells)))
        if len(values) >= _BLOCK:
            yield numbers, np.array(values).reshape(len(numbers), -1)
            numbers, values = [], array("d")
    if numbers:
        yield numbers, np.array(values).reshape(len(numbers), -1)


def _rows(path, lines, table):
    """Number and cells of each row, as many as the header has; a last one cut short is left out."""
    counted = table.frame is not None or table.time is not None
    blank = _BLANK if counted else " "  # else a row of empty cells is a frame of hidden markers
    n_columns, before = len(table.columns), lines.number
    for number, line in lines.rows(blank=blank):
        if table.until_blank and number > before + 1:
            _check_rest(path, table, number, line)
            return
        before, cells = number, line.split(table.delimiter)
        while len(cells) > n_columns and not cells[-1].strip(" "):
            cells.pop()
        if len(cells) < n_columns and not lines.whole:
            warn(path, table.report, f"line {number}, the last, is cut short: left out", 7)
        elif len(cells) != n_columns:
            raise damaged(
                f"{path}, line {number}: {len(cells)} values, but the header has {n_columns} "
                "columns"
            )
        else:
            yield number, cells


def _check_rest(path, table, number, text):
    """Refuse rows that go on behind a blank line; say what else follows."""
    first = text.split(table.delimiter)[0].strip().strip('"')
    if as_number(first) is not None:
        raise ValueError(
            f"{path}, line {number}: rows go on behind a blank line; take it out, or export again."
        )
    said = f"what follows the rows left out, from line {number} on: {first[:40]}"
    if first.lower() == "trajectories":  # markers as well
        warn(path, table.report, f"{said}; write it to a file of its own", 7)
    else:
        table.report.append(said)


def _numbers(path, table, number, cells):
    """Numbers of the cells of a row, NaN for empty ones."""
    plain = "\n".join(cells).replace(",", ".")  # cells hold no end of a line
    if _PLAIN.fullmatch(plain):  # quick, for rows as programs write them
        try:
            values = [float(cell) if cell else math.nan for cell in plain.split("\n")]
            if not any(map(math.isinf, values)):
                return values
        except ValueError:
            pass  # below it is said where
    values = []
    for column, cell in zip(table.used, cells, strict=True):
        text = cell.strip().strip('"').strip()
        value = math.nan if text.lower() in _NOTHING else as_number(text)
        if value is None or math.isinf(value):
            raise ValueError(
                f"{path}, line {number}, column {table.columns[column]}: {cell.strip()[:40]!r} is "
                "not a number; repair it, or leave the cell empty where the marker is hidden."
            )
        values.append(value)
    return values


# --- time -----------------------------------------------------------------------------------------


def _beat(path, table, counted, numbers, fps):
    """Frames a second, and the place of each row in time (None: one after another)."""
    frames, times = counted.get("frame"), counted.get("time")
    slots = None if frames is None else _frame_slots(path, frames, numbers, times is not None)
    if fps is not None:
        if times is not None or table.rate is not None:
            table.report.append(f"{fps:g} frames/s as said with fps=, not as in the file")
        rate = fps
    elif times is not None and len(times) > 1:
        _check_rising(path, times, numbers, "time")
        rate, slots = _timed(path, times / table.per_second, slots, table)
    else:
        rate = table.rate
    if rate is None:
        raise ValueError(f"{path}: no frame rate in it, and no times; say it with fps=.")
    if slots is not None:
        lost = int(slots[-1]) + 1 - len(slots)
        if lost > len(slots):
            raise ValueError(
                f"{path}: {lost} frames are missing in time between {len(slots)} that are there; "
                "split the take, or leave the columns of frames and times out and give fps=."
            )
        if lost:
            table.report.append(f"{lost} frame(s) missing in time: all markers hidden there")
    return rate, slots


def _timed(path, times, slots, table):
    """Frames a second by the column of times, and places that fit it."""
    step = np.diff(times)
    free = slots is None
    if free:  # counted step by step, for clocks drift; jitter never puts two in one place
        slots = np.append(0, np.cumsum(np.maximum(1, np.round(step / np.median(step)))))
        slots = slots.astype(np.int64)
    length = times[-1] - times[0]
    rounding = next((d for d in 10.0 ** -np.arange(7) if _are_multiples(times, d)), 1e-7)
    rate = slots[-1] / length
    off = np.abs((times - times[0]) * rate - slots).max()
    if off > (2.0 if free else 0.75 + rounding * rate):
        raise ValueError(
            f"{path}: the times do not keep a beat: at {rate:.6g} frames/s a row is {off:.1f} "
            "frames off its place; resample the take, or say with fps= that its rows follow one "
            "another."
        )
    if table.rate is None:
        if not 0.99 * SLOWEST <= rate <= 1.01 * _FASTEST:
            raise ValueError(
                f"{path}: column {table.columns[table.time]} amounts to {rate:.3g} frames/s, and "
                f"markers are recorded with {SLOWEST} to {_FASTEST}; name it time_ms if it counts "
                "milliseconds, and time if it counts seconds, or say the rate with fps=."
            )
        return _nominal(rate, max(2e-4, rounding / length)), slots
    apart = abs(rate / table.rate - 1)
    if apart > max(0.01, 1.5 * rounding / length):
        raise ValueError(
            f"{path}: the header says {table.rate:g} frames/s, the column of times {rate:.6g}; say "
            "which is right with fps=."
        )
    if apart > max(2e-4, 1.5 * rounding / length):
        table.report.append(f"{rate:.6g} frames/s by the times; the header says {table.rate:g}")
        return float(f"{rate:.6g}"), slots
    return table.rate, slots


def _are_multiples(values, step):
    return np.abs(values / step - np.round(values / step)).max() < 1e-6 / min(step, 1)


def _frame_slots(path, frames, numbers, timed):
    _check_rising(path, frames, numbers, "frame")
    if (frames != np.round(frames)).any():
        line = numbers[np.flatnonzero(frames != np.round(frames))[0]]
        raise ValueError(f"{path}, line {line}: the frame is not a whole number.")
    slots = frames - frames[0]
    step = np.diff(frames).min() if timed and len(frames) > 1 else 1
    if (slots % step).any():
        step = 1
    return (slots / step).astype(np.int64)


def _check_rising(path, values, numbers, what):
    bad = np.append(False, ~(np.diff(values) > 0)) | ~np.isfinite(values)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        found = "is missing" if np.isnan(values[i]) else f"is {values[i]:g}"
        after = f", after {values[i - 1]:g}" if i else ""
        raise ValueError(
            f"{path}, line {numbers[i]}: the {what} {found}{after}; it has to run forwards."
        )


def _nominal(rate, tolerance):
    """The rate that is meant: 60 for 59.998, 59.94 for 59.9401."""
    if rate > 0.5:
        for named in (float(round(rate)), round(rate * 1.001) / 1.001):
            if abs(rate / named - 1) <= tolerance:
                return round(named, 3)
    return float(f"{rate:.6g}")


def left_out(report, columns, what):
    """Say which columns of a table were not read."""
    if columns:
        report.append(f"{len(columns)} {what} left out ({listed(dict.fromkeys(columns))})")
