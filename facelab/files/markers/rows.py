"""Rows of numbers out of text: fast, strict, in pieces; and the beat of their frames."""

import csv
import re
from dataclasses import dataclass, field

import numpy as np

from facelab.files.markers.rules import marker_sequence, resolve_names, warn
from facelab.files.text import text_lines
from facelab.files.words import damaged, listed

_BLOCK = 2**22  # characters parsed together
_BLANK = " \t,;"  # a line of these alone holds nothing
_NOTHING = ("", "nan", "null")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


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

    def rows(self, n):
        """Up to n lines that are not blank, as (number, line)."""
        while n > 0 and (line := self.next()) is not None:
            if line.strip(_BLANK):
                yield self.number, line
                n -= 1

    def blocks(self):
        """Lists of lines, with the number of the first."""
        while True:
            block, size = [], 0
            while size < _BLOCK and (line := self.next()) is not None:
                block.append(line)
                size += len(line) + 1
            if not block:
                return
            yield self.number - len(block) + 1, block


def cells(line, delimiter):
    """Cells of a line of a header, without quotes and blanks around them."""
    try:
        row = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:  # a cell of more than 128 kB
        row = line.split(delimiter)
    return [cell.strip() for cell in row]


def delimiter_of(line):
    """What parts the cells of a line: tab, semicolon or comma."""
    return max("\t;,", key=line.count)


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
    n_columns = len(table.columns)
    most = min(
        _count_lines(path), path.stat().st_size // max(1, n_columns - 1) + 1
    )  # a cell, a byte
    positions = np.empty((most, len(names), 3), dtype=np.float32)
    counted = {key: [] for key in ("frame", "time") if getattr(table, key) is not None}
    numbers, n = [], 0
    for number, values in _number_blocks(path, lines, table):
        if n + len(values) > most:
            raise ValueError(f"{path}: changed while it was read; read it again.")
        with np.errstate(over="ignore"):  # refused where all is checked
            positions[n : n + len(values)] = values[:, axes] * table.factor
        for key, parts in counted.items():
            parts.append(values[:, place[getattr(table, key)]])
        numbers.append(number)
        n += len(values)
    if n == 0:
        raise ValueError(f"{path}: no frames below the header.")
    if table.n_frames is not None and n != table.n_frames:
        raise damaged(f"{path}: the header counts {table.n_frames} frames, but {n} rows follow")
    numbers = np.concatenate(numbers)
    counted = {key: np.concatenate(parts) for key, parts in counted.items()}
    rate, slots = _beat(path, table, counted, numbers, fps)
    positions = positions[:n]
    if slots is not None and slots[-1] >= n:
        spread = np.full((int(slots[-1]) + 1, len(names), 3), np.nan, dtype=np.float32)
        spread[slots] = positions
        positions = spread
    return marker_sequence(path, positions, names, rate, report)


def _count_lines(path):
    with open(path, "rb") as file:
        ends = sum(
            max(part.count(b"\n"), part.count(b"\r"))
            for part in iter(lambda: file.read(_BLOCK), b"")
        )
    return ends + 1


# --- numbers --------------------------------------------------------------------------------------


def _number_blocks(path, lines, table):
    """Arrays of line numbers and of values, shape (n_rows, n_columns); NaN for an empty cell."""
    counted = table.frame is not None or table.time is not None
    blank = _BLANK if counted else " "  # else a row of empty cells is a frame of hidden markers
    for first, block in lines.blocks():
        full = [(n, row) for n, row in enumerate(block, first) if row.strip(blank)]
        ended = table.until_blank and len(full) < len(block)
        rows = [(n, row) for i, (n, row) in enumerate(full) if n == first + i] if ended else full
        if fitting := _trimmed(path, lines, table, rows):
            yield np.array([n for n, _ in fitting]), _parsed(path, table, fitting)
        if ended:
            _check_rest(path, table, next(iter(full[len(rows) :] or lines.rows(1)), None))
            return


def _check_rest(path, table, line):
    """Refuse rows that go on behind a blank line; say what else follows."""
    if line is None:
        return
    number, text = line
    first = text.split(table.delimiter)[0].strip().strip('"')
    if _NUMBER.fullmatch(first):
        raise ValueError(
            f"{path}, line {number}: rows go on behind a blank line; take it out, or export again."
        )
    table.report.append(f"what follows the rows left out, from line {number} on: {first[:40]}")


def _trimmed(path, lines, table, rows):
    """Rows of the right length, no delimiter at their ends; a last one that is cut short goes."""
    n_columns, mark = len(table.columns), table.delimiter
    fitting = []
    for number, row in rows:
        count = row.count(mark) + 1
        while count > n_columns and row.rstrip(" ").endswith(mark):
            row, count = row.rstrip(" ")[:-1], count - 1
        if count != n_columns:
            if number == lines.number and not lines.whole and count < n_columns:
                warn(path, table.report, f"line {number}, the last, is cut short: left out", 7)
                break
            raise damaged(
                f"{path}, line {number}: {count} values, but the header has {n_columns} columns"
            )
        fitting.append((number, row))
    return fitting


def _parsed(path, table, rows):
    """Values of the columns that count, shape (n_rows, n_used); the others may hold anything."""
    mark, used = table.delimiter, table.used
    text = "\n".join(row for _, row in rows)
    if mark != ",":
        text = text.replace(",", ".")
    for prepare in (_filled, _cleaned):  # the second is slow, for cells with quotes and blanks
        text = prepare(text, mark)
        try:
            lines = text.split("\n")
            values = np.loadtxt(lines, delimiter=mark, ndmin=2, comments=None, usecols=used)
        except ValueError:
            continue
        if values.shape == (len(rows), len(used)) and not np.isinf(values).any():
            return values
    raise _misplaced(path, table, rows)


def _filled(text, mark):
    """The rows with nan in empty cells."""
    nothing = f"{mark}nan{mark}"
    text = text.replace(2 * mark, nothing).replace(2 * mark, nothing)
    text = f"\n{text}\n".replace(f"\n{mark}", f"\nnan{mark}").replace(f"{mark}\n", f"{mark}nan\n")
    return text[1:-1]


def _cleaned(text, mark):
    """The rows without quotes round their cells, with nan for blanks and NULL."""
    text = re.sub(rf'(?m)(^|{mark}) *"([^"{mark}\n]*)" *(?={mark}|$)', r"\1\2", text)
    return re.sub(rf"(?mi)(^|{mark}) *(?:null)? *(?={mark}|$)", r"\1nan", text)


def _misplaced(path, table, rows):
    """What to raise for the first cell that is no number: slow, only to say where."""
    for number, row in rows:
        row = row.split(table.delimiter)
        for column in table.used:
            plain = row[column].strip().strip('"').strip()
            plain = plain if table.delimiter == "," else plain.replace(",", ".")
            is_number = _NUMBER.fullmatch(plain) and np.isfinite(float(plain))
            if plain.lower() not in _NOTHING and not is_number:
                return ValueError(
                    f"{path}, line {number}, column {table.columns[column]}: "
                    f"{row[column].strip()[:40]!r} is not a number; repair it, or leave the cell "
                    "empty where the marker is hidden."
                )
    return ValueError(
        f"{path}, lines {rows[0][0]} to {rows[-1][0]}: the cells are not parted as in the header; "
        "export it again."
    )


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
