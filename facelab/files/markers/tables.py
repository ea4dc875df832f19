"""Markers in tables of text: the headers of Motive, Nexus, Qualisys and others."""

import re
from dataclasses import dataclass, field

import numpy as np

from facelab.files.markers.rows import (
    Lines,
    Table,
    cells,
    left_out,
    read_table,
    stated,
)
from facelab.files.markers.rules import MM_PER_UNIT, checked, factor_of
from facelab.files.text import delimiter_of, time_columns
from facelab.files.words import damaged, listed

_NEXUS_PARTS = ("trajectories", "devices", "joints", "model outputs", "events")
_AXIS_NAME = re.compile(r"(.*?)[\s_.:|-]*([xyzXYZ])(?:\s*[\[(]([^\])]*)[\])])?")
_TURN = re.compile(  # of turns and speeds: Head Rotation, Head_rot, HeadRot
    r"(?i:.*(?:rotat|orient|quaternion|euler|veloc|speed|accel).*|(.*[\s_.:|-])?(?:rot|quat|vel|acc))"
    r"|.*[a-z0-9](?:Rot|Quat|Vel|Acc)"
)
_BRIEF = re.compile(r"(.*[\s_.:|-])?[rqva]", re.I)  # Head_r of Head_rx; or lip_r, a right lip
_NUMBERED = re.compile(r"(\w*?)_?([XYZ])_(\d{1,3})")  # X_0 of OpenFace, where pose_Rx is no marker


def read_marker_table(path, unit=None, fps=None, subject=None):
    """The markers of a CSV or TSV table, hidden ones as NaN.

    Known by their first line: OptiTrack Motive's CSV (`Format Version`), Vicon Nexus' CSV
    (`Trajectories`), Qualisys' TSV (`NO_OF_FRAMES`); else a plain table whose header names the
    columns `chin_x, chin_y, chin_z` (or `chin` above `x, y, z`), with columns of frames or times
    or without. Parted by commas, semicolons or tabs; decimal commas where commas part nothing.

    Parameters
    ----------
    path : str or Path
    unit : {"mm", "cm", "dm", "m", "in", "ft"}, optional
        Length unit; else the header's, else millimetres.
    fps : float, optional
        Frames a second, if neither a header nor a column of times says it, or says it wrongly.
    subject : str, optional
        Only the markers of this subject, where there are several.

    Returns
    -------
    MarkerSequence
        Millimetres, float32, axes as in the file. Empty cells, positions at exactly 0, 0, 0 and
        values that fill gaps in all three coordinates (-9999, or -1 again and again) are hidden
        markers; frames missing in time are frames without markers. `report` says what was left out,
        renamed and counted.

    Raises
    ------
    FileNotFoundError, ValueError
        Naming file, line and column.
    """
    path, fps = checked(path, "table of markers", unit, fps, subject)
    lines = Lines(path, "table of markers")
    start = next(lines.rows(1), None)
    if start is None:
        raise ValueError(f"{path}: only blank lines in it.")
    first = start[1].strip().lower()
    head = re.split(r"[\t;,]", first)[0].strip('" ')
    if head == "format version":
        table = _motive(path, lines, start[1], unit)
    elif head in _NEXUS_PARTS:
        table = _nexus(path, lines, head, unit)
    elif head.startswith("no_of_"):
        table = _qualisys(path, lines, start[1], unit)
    else:
        table = _plain(path, lines, start[1], unit)
    return read_table(path, lines, table, fps, subject)


def _triples(path, number, columns):
    """(name, (x, y, z)) out of (name, axis, column) side by side; refused if they do not fit."""
    markers = []
    for i in range(0, len(columns), 3):
        three = columns[i : i + 3]
        if "".join(axis for _, axis, _ in three) != "XYZ" or len({n for n, _, _ in three}) > 1:
            name, _, column = three[0]
            raise damaged(
                f"{path}, line {number}: {name} in column {column + 1} is not followed by its X, Y "
                "and Z"
            )
        markers.append((three[0][0], tuple(column for _, _, column in three)))
    if not markers:
        raise ValueError(f"{path}, line {number}: no columns of markers in the header.")
    return markers


def _widened(path, row, width):
    """The row with as many cells as the header has columns."""
    while len(row) > width and not row[-1]:
        row = row[:-1]
    if len(row) > width:
        raise damaged(f"{path}: a row of its header has {len(row)} cells, the row of axes {width}")
    return row + [""] * (width - len(row))


def _header_row(path, lines, what):
    row = next(lines.rows(1), None)
    if row is None:
        raise ValueError(f"{path}: ends in its header; {what} should follow.")
    return row


# --- OptiTrack Motive -----------------------------------------------------------------------------


def _motive(path, lines, first, unit):
    delimiter = max(",;\t", key=first.count)  # a comma, or as a spreadsheet saved it again
    about = cells(first, delimiter)
    about = dict(zip(about[::2], about[1::2], strict=False))
    above = []
    while True:  # rows of types, names, identities, parents, kinds of value; then the axes
        number, line = _header_row(path, lines, "a row that starts with Frame")
        row = cells(line, delimiter)
        if row[0].lower() == "frame":
            break
        above.append(row)
        if row[0] or len(above) > 8:
            raise ValueError(
                f"{path}, line {number}: no part of a header; a row that starts with Frame should "
                "follow. Export the file again."
            )
    if len(above) < 3:
        raise ValueError(
            f"{path}: rows of types, names and kinds of value are missing above line {number}; "
            "export it with its header."
        )
    width = len(row)
    kinds, names, properties = (_widened(path, r, width) for r in (*above[:2], above[-1]))
    columns, others = [], []
    for i in range(2, width):
        if kinds[i].lower() == "marker" and properties[i].lower() == "position":
            columns.append((names[i], row[i].upper(), i))
        elif kinds[i]:
            others.append(kinds[i].lower())
    if not columns:
        raise ValueError(
            f"{path}: no markers in it, only {listed(dict.fromkeys(others)) or 'empty columns'}; "
            "export it with markers."
        )
    report = []
    left_out(report, others, "column(s) that are no markers")
    rate = about.get("Export Frame Rate") or about.get("Capture Frame Rate", "")
    timed = width > 1 and row[1].lower().startswith("time")
    said = about.get("Length Units", "")
    return Table(
        row[:2] + [f"{n} {a}".strip() for n, a in zip(names[2:], row[2:], strict=True)],
        _triples(path, number, columns), delimiter, 0, 1 if timed else None,
        rate=stated(path, rate, "the frame rate"),
        n_frames=stated(path, about.get("Total Exported Frames", ""), "the number of frames", True),
        factor=factor_of(path, said, unit, "Length Units"), report=report,
    )  # fmt: skip


# --- Vicon Nexus ----------------------------------------------------------------------------------


def _nexus(path, lines, head, unit):
    parts = [head]
    while head != "trajectories":
        number, line = _header_row(path, lines, "a part called Trajectories")
        head = re.split(r"[\t;,]", line.strip().lower())[0].strip('" ')
        if head in _NEXUS_PARTS:
            parts.append(head)
    _, line = _header_row(path, lines, "the frame rate")
    rate = stated(path, line.strip("\t;, "), "the frame rate")
    _, line = _header_row(path, lines, "the names")
    delimiter = delimiter_of(line)
    names = cells(line, delimiter)
    number, line = _header_row(path, lines, "a row that starts with Frame")
    axes = cells(line, delimiter)
    _, line = _header_row(path, lines, "the units")
    units = cells(line, delimiter)
    if axes[0].lower() != "frame":
        raise damaged(f"{path}, line {number}: should start with Frame")
    width = len(axes)
    while width > 2 and not axes[width - 1]:
        width -= 1
    names, units = (_widened(path, r, width) for r in (names, units))
    columns, others, name = [], [], ""
    for i in range(2, width):
        names[i] = name = names[i] or (name if axes[i].upper() != "X" else "")
        if axes[i].upper() in ("X", "Y", "Z"):
            columns.append((name, axes[i].upper(), i))
        elif axes[i]:
            others.append(axes[i])
    said = {units[i].lower() for _, _, i in columns}
    if unit is None and len(said) > 1:
        raise ValueError(f"{path}: several units in one table: {listed(sorted(said))}.")
    report = []
    left_out(report, parts[:-1], "other part(s)")
    left_out(report, others, "column(s) that are no positions")
    return Table(
        [f"{n} {a}".strip() for n, a in zip(names[:width], axes[:width], strict=True)],
        _triples(path, number, columns), delimiter, 0, rate=rate,
        factor=factor_of(path, next(iter(said), ""), unit, "the unit"),
        until_blank=True, report=report,
    )  # fmt: skip


# --- Qualisys -------------------------------------------------------------------------------------


def _qualisys(path, lines, first, unit):
    about, line = {}, first
    delimiter = delimiter_of(first)  # a tab, or as a spreadsheet saved it again
    while True:
        key, _, value = line.partition(delimiter)
        if not re.fullmatch(r"[A-Z_]+", key.strip(), re.ASCII):
            break
        about.setdefault(key.strip(), value.strip(f"{delimiter} "))
        _, line = _header_row(path, lines, "rows of numbers")
    titles = cells(line, delimiter)
    if titles[0].lower() in ("frame", "time") or re.search(r"[A-Za-z]\s*[XYZ]$", titles[-1]):
        _, line = _header_row(path, lines, "rows of numbers")
    lines.back(line)
    if about.get("DATA_INCLUDED", "3D") != "3D":
        raise ValueError(
            f"{path}: DATA_INCLUDED is {about['DATA_INCLUDED']!r}, but 3D is wanted: positions of "
            "markers."
        )
    names = [name.strip() for name in about.get("MARKER_NAMES", "").split(delimiter)]
    names = [name for name in names if name]
    n_markers = stated(path, about.get("NO_OF_MARKERS", ""), "NO_OF_MARKERS", True)
    if not names or n_markers not in (None, len(names)):
        raise damaged(f"{path}: NO_OF_MARKERS is {n_markers}, but MARKER_NAMES has {len(names)}")
    width = len(line.rstrip(f"{delimiter} ").split(delimiter))
    before = max(width - 3 * len(names), 0)
    titles = [title.lower() for title in titles]
    if before > 2:
        raise damaged(f"{path}, line {lines.number + 1}: {width} values for {len(names)} markers")
    frame = titles.index("frame") if "frame" in titles[:before] else None
    time = titles.index("time") if "time" in titles[:before] else None
    if before and frame is None and time is None:
        frame, time = (0, 1) if before == 2 else (0, None)
    columns = ["frame", "time"][:before] + [f"{n} {axis}" for n in names for axis in "XYZ"]
    return Table(
        columns,
        [(n, tuple(before + 3 * i + np.arange(3))) for i, n in enumerate(names)],
        delimiter, frame, time,
        rate=stated(path, about.get("FREQUENCY", ""), "FREQUENCY"),
        n_frames=stated(path, about.get("NO_OF_FRAMES", ""), "NO_OF_FRAMES", True),
        factor=MM_PER_UNIT[unit or "mm"],  # Qualisys always exports millimetres
    )  # fmt: skip


# --- plain ----------------------------------------------------------------------------------------


def _plain(path, lines, first, unit):
    delimiter = delimiter_of(first)
    titles, number = _titles(lines, first, delimiter)
    found = _sorted_out(path, number, titles)
    report = []
    left_out(report, [titles[i] for i in found.others], "other column(s)")
    units = sorted(found.units)
    if unit is None and len(units) > 1:
        raise ValueError(f"{path}: several units in one table: {listed(units)}.")
    if unit is None and not units:
        report.append("no unit in the file: taken as millimetres; another with unit=")
    per_second = 1000.0 if found.milliseconds else 1.0
    return Table(
        titles, found.markers, delimiter, found.frame, found.time, per_second,
        factor=factor_of(path, (units or ["mm"])[0], unit, "the unit"), report=report,
    )  # fmt: skip


def _titles(lines, first, delimiter):
    """Name of each column, joined from two lines if x, y, z stand below the names; and the line."""
    titles, number = cells(first, delimiter), lines.number
    second = next(lines.rows(1), None)
    below = cells(second[1], delimiter) if second else []
    if sum(cell.upper() in ("X", "Y", "Z") for cell in below) >= max(3, len(below) - 3):
        name, joined = "", []
        for i, axis in enumerate(below):
            name = titles[i] if i < len(titles) and titles[i] else name
            joined.append(f"{name} {axis}" if axis.upper() in ("X", "Y", "Z") else axis or name)
        titles = joined
    elif second:
        lines.back(second[1])
    while titles and not titles[-1]:
        titles.pop()
    return titles, number


@dataclass
class _Columns:
    """The columns of a plain table by what they are."""

    time: int
    milliseconds: bool
    frame: int
    markers: list = field(default_factory=list)
    units: set = field(default_factory=set)
    others: list = field(default_factory=list)


def _sorted_out(path, number, titles):
    found, axes_of, unit_of, joined = _Columns(*time_columns(titles, coded=False)), {}, {}, set()
    numbered = {i: m for i, m in enumerate(map(_NUMBERED.fullmatch, titles)) if m}
    for i, title in enumerate(titles):
        named = None if numbered else _AXIS_NAME.fullmatch(title)
        if i in (found.frame, found.time):
            continue
        if named and named[1]:
            axes = axes_of.setdefault(named[1], {})
            if named[2].lower() in axes:
                raise ValueError(f"{path}, line {number}: two columns are called {title}.")
            axes[named[2].lower()] = i
            unit_of[i] = named[3]
            if named.end(1) == named.start(2):
                joined.add(named[1])
        elif i in numbered:
            prefix, axis, count = numbered[i].groups()
            axes_of.setdefault(f"{prefix}_{count}".strip("_"), {})[axis.lower()] = i
    full = [name for name, axes in axes_of.items() if len(axes) == 3]
    turns = [name for name in full if _is_turn(name, joined, full)]
    for name in full:
        if name not in turns:
            found.markers.append((name, tuple(axes_of[name][axis] for axis in "xyz")))
    if not found.markers:
        only = f" but of turns or speeds ({listed(turns)})" if turns else ""
        raise ValueError(
            f"{path}, line {number}: no column is called like chin_x, chin_y, chin_z{only}; name "
            "the columns so, or export from the capture program with its header."
        )
    read = {column for _, three in found.markers for column in three}
    found.units = {unit_of.get(i) for i in read} - {None, ""}
    read |= {found.frame, found.time}
    found.others = [i for i in range(len(titles)) if i not in read]
    return found


def _is_turn(name, joined, names):
    """Whether columns are rotations or speeds, no places: `Head_Rx` beside `Head_Tx`.

    `joined` are the names that stand without a mark before their axis: where others have one, a
    single letter there is no part of the name.
    """
    if _TURN.fullmatch(name):
        return True
    brief = _BRIEF.fullmatch(name) if name in joined else None
    if brief is None:
        return False
    stem = (brief[1] or "").lower()
    beside = {stem + word for word in ("t", "p", "pos", "trans", "q")}  # q turns, and is no name
    return any(other not in joined or other.lower() in beside for other in names)
