"""C3D, the file format of motion capture: markers in.

The reader is our own: a header, named parameters and rows of numbers are all there is to it, and
the library that we know (ezc3d) crashes or makes things up where a file is damaged, and stops at
65,535 frames. What a file says twice is held together, and the size of the file is the judge.
"""

import itertools
import math
import os
import re
import struct
from dataclasses import dataclass, replace

import numpy as np

from facelab.files.markers.rules import (
    checked,
    factor_of,
    marker_sequence,
    resolve_names,
    warn,
)
from facelab.files.words import listed

_BLOCK = 512
_KINDS = {84: "Intel", 85: "DEC", 86: "MIPS"}
_MODEL_OUTPUTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
_OUTPUT = re.compile(r"[A-Z]\w*[a-z](Angle(?=s)|Force|Moment|Power)s?|[LR]NormalisedGRF")
_MOST_16 = 0xFFFF
_READ_BYTES = 2**23  # of the data at a time


def read_c3d(path, unit=None, fps=None, subject=None):
    """The markers of a C3D file, hidden ones as NaN.

    Parameters
    ----------
    path : str or Path
    unit : {"mm", "cm", "dm", "m", "in", "ft"}, optional
        Length unit, for files that state none or a wrong one; else POINT:UNITS of the file.
    fps : float, optional
        Frames a second, for files that state none, or two; else POINT:RATE.
    subject : str, optional
        Only the markers of this subject, where there are several.

    Returns
    -------
    MarkerSequence
        Millimetres, float32, axes as in the file: C3D has no rule for which is up. A marker is
        hidden where its residual is negative, where a coordinate is NaN, or where it lies exactly
        at the origin or at a value that fills gaps (-9999, or -1 again and again): makers differ.
        Angles, forces and the like that a model computed are no markers. Names lose blanks and the
        prefix of the subject. `report` says what was left out, renamed and counted.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, cut short, without markers, or in an unknown unit.

    References
    ----------
    The C3D file format user guide, www.c3d.org.
    """
    return parse_c3d(path, unit, fps, subject)


def parse_c3d(path, unit=None, fps=None, subject=None, judge=True):
    """As `read_c3d`, on wish without a word about the size of what was captured."""
    path, fps = checked(path, "C3D file", unit, fps, subject)
    report = []
    with open(path, "rb") as file:
        header = _Header(path, file)
        values = _parameters(path, file, header)
        layout = _layout(path, header, values, report)
        fps = _rate(path, header, values) if fps is None else fps
        said = next(iter(values.text("POINT:UNITS")), "")
        factor = factor_of(path, said, unit, "POINT:UNITS")
        labels = _labels(path, values, layout.n_points, report)
        names, columns = resolve_names(path, labels, subject, report)
        positions = _positions(path, file, layout, columns, factor)
    screen = [values.text(f"POINT:{axis}_SCREEN") for axis in "XY"]
    said = f"; the file calls {screen[0][0]} right, {screen[1][0]} up" if all(screen) else ""
    report.append(f"axes as in the file, which C3D leaves open{said}")
    return marker_sequence(path, positions, names, fps, report, judge)


# --- header and parameters ------------------------------------------------------------------------


class _Header:
    """What the first 512 bytes of a C3D file promise."""

    def __init__(self, path, file):
        self.size = os.fstat(file.fileno()).st_size
        block = file.read(_BLOCK)
        if len(block) < _BLOCK or block[1] != 0x50:
            raise ValueError(f"{path}: not a C3D file (its first block lacks the mark 0x50).")
        self.parameters = (max(block[0], 1) - 1) * _BLOCK
        file.seek(self.parameters)
        start = file.read(4)
        if len(start) < 4 or self.parameters == 0 or start[3] not in _KINDS:
            raise ValueError(
                f"{path}: damaged: the parameters should start at byte {self.parameters}, but no "
                "kind of processor (Intel, DEC, MIPS) stands there."
            )
        self.kind = _KINDS[start[3]]
        self.parameter_blocks = start[2]
        self.order = ">" if self.kind == "MIPS" else "<"
        words = struct.unpack(f"{self.order}12H", block[:24])
        self.n_points, self.analog, self.first, self.last = words[1:5]
        self.start, self.samples = words[8:10]
        self.scale = float(_floats(block[12:16], self)[0])
        self.rate = float(_floats(block[20:24], self)[0])


def _floats(data, header):
    """The four-byte reals of that processor, as float32."""
    if header.kind != "DEC":
        return np.frombuffer(data, f"{header.order}f4")
    # VAX F: the high word comes first, the exponent is worth two more; a quarter of it is ours
    words = np.frombuffer(data, "<u2").astype(np.uint32).reshape(-1, 2)
    bits = (words[:, 0] << 16) | words[:, 1]
    values = bits.view(np.float32) / np.float32(4)
    values[bits & 0x7F800000 == 0] = 0
    return values


class _Parameters(dict):
    """Parameters by "GROUP:NAME": their raw values, decoded when asked for."""

    def __init__(self, path, header):
        super().__init__()
        self.path, self.header = path, header

    def raw(self, name):
        """Type, dimensions and bytes of a parameter, or None; refused if its sizes disagree."""
        record = self.get(name)
        if record is None:
            return None
        kind = struct.unpack("b", record[:1])[0] if record else 0
        n_dims = record[1] if len(record) > 1 else 0
        dims = list(record[2 : 2 + n_dims])
        end = 2 + n_dims + math.prod(dims) * abs(kind)
        # a description follows, its length before it
        whole = len(record) == end or (len(record) > end and len(record) == end + 1 + record[end])
        if kind not in (-1, 1, 2, 4) or n_dims > 7 or len(dims) < n_dims or not whole:
            raise ValueError(
                f"{self.path}: damaged: the parameter {name} does not fill the {len(record)} bytes "
                "that it takes; export the file again."
            )
        return kind, dims, record[2 + n_dims : end]

    def numbers(self, name):
        """Values of a parameter as a list of float; whole numbers count from 0 to 65535."""
        found = self.raw(name)
        if found is None or found[0] == -1:
            return []
        kind, _, data = found
        if kind == 4:
            return _floats(data, self.header).astype(float).tolist()
        return np.frombuffer(data, "u1" if kind == 1 else f"{self.header.order}u2").tolist()

    def number(self, name):
        """First value of a parameter, or None."""
        return next(iter(self.numbers(name)), None)

    def text(self, name):
        """Values of a parameter as a list of str, without blanks around them."""
        found = self.raw(name)
        if found is None or found[0] != -1:
            return []
        _, dims, data = found
        width = dims[0] if dims else 1
        if width == 0:
            return [""] * math.prod(dims[1:])
        return [_decoded(data[i : i + width]) for i in range(0, len(data), width)]

    def continued(self, name):
        """Values of a parameter and of those that continue it: LABELS, LABELS2, LABELS3."""
        more = itertools.takewhile(self.__contains__, (f"{name}{i}" for i in itertools.count(2)))
        return [value for key in [name, *more] for value in self.text(key)]


def _decoded(data):
    data = data.split(b"\0", 1)[0]
    try:
        return data.decode("utf-8").strip()
    except UnicodeDecodeError:
        return data.decode("latin-1").strip()


def _parameters(path, file, header):
    """All parameters of the file; records that do not follow one another are refused."""
    blocks = max(header.parameter_blocks, header.start - 1 - header.parameters // _BLOCK)
    file.seek(header.parameters)
    section = file.read(max(blocks, 1) * _BLOCK)
    damaged = (
        f"{path}: damaged: the parameters, from byte {header.parameters} on, do not follow one "
        "another; export the file again."
    )
    groups, records, at, last = {}, [], 4, False
    while not last and at + 1 < len(section) and section[at] != 0:
        n_name, group = struct.unpack("bb", section[at : at + 2])
        name_end = at + 2 + abs(n_name)
        if name_end + 2 > len(section):
            raise ValueError(damaged)
        name = section[at + 2 : name_end].decode("latin-1").strip().upper()
        step = struct.unpack(f"{header.order}H", section[name_end : name_end + 2])[0]
        last = step == 0
        end = len(section) if last else name_end + step
        if end > len(section) or end < name_end + 2 or group == 0 or not name.isprintable():
            raise ValueError(damaged)
        if group < 0:
            groups.setdefault(-group, name)
        else:
            records.append((group, name, section[name_end + 2 : end]))
        at = end
    values = _Parameters(path, header)
    for group, name, record in records:
        key = f"{groups.get(group, group)}:{name}"
        if key in values and key.startswith("POINT:"):
            raise ValueError(f"{path}: damaged: the parameter {key} stands twice.")
        values.setdefault(key, record)
    if "POINT" not in groups.values():
        raise ValueError(f"{path}: damaged: no group POINT among its parameters.")
    values.end = header.parameters + at
    return values


# --- how the data lie -----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Layout:
    """Where the numbers are: bytes, counts, and how one becomes a length."""

    header: _Header
    start: int
    n_points: int
    analog: int
    n_frames: int
    is_float: bool
    scale: float

    @property
    def frame_bytes(self):
        """Size of one frame."""
        return (4 * self.n_points + self.analog) * (4 if self.is_float else 2)

    @property
    def end(self):
        """Byte after the last frame."""
        return self.start + self.n_frames * self.frame_bytes


def _layout(path, header, values, report):
    """Where the data lie; what header and parameters say differently, the size decides."""
    used = values.number("POINT:USED")
    if used not in (None, header.n_points):
        raise ValueError(
            f"{path}: damaged: the header counts {header.n_points} points in a frame, POINT:USED "
            f"{used:g}; export the file again."
        )
    if header.n_points == 0:
        raise ValueError(f"{path}: no markers in it; the header counts 0 points.")
    scale = values.number("POINT:SCALE")
    scale = header.scale if scale is None else scale
    if not math.isclose(scale, header.scale, rel_tol=1e-5) and (scale > 0 or header.scale > 0):
        raise ValueError(
            f"{path}: damaged: the header's scale is {header.scale:g}, POINT:SCALE is {scale:g}; "
            "export the file again."
        )
    if not np.isfinite(scale) or scale == 0:
        raise ValueError(f"{path}: damaged: POINT:SCALE is {scale:g}; export the file again.")
    starts = {int(n - 1) * _BLOCK for n in (header.start, values.number("POINT:DATA_START")) if n}
    starts = [start for start in starts if values.end <= start < header.size]
    if not starts:
        raise ValueError(
            f"{path}: damaged or cut short: no data follow the parameters, which end at byte "
            f"{values.end} of {header.size}."
        )
    analogs = {header.analog}
    channels = values.number("ANALOG:USED")
    if channels is not None:
        analogs.add(int(channels * header.samples))
    counts = _frame_counts(path, header, values)
    end = header.size
    rotations = values.number("ROTATION:USED"), values.number("ROTATION:DATA_START")
    if all(rotations):  # they follow the points, and are not ours
        end = min(end, int(rotations[1] - 1) * _BLOCK)
    made = [
        _Layout(header, start, header.n_points, analog, n, scale < 0, scale)
        for start, analog, n in itertools.product(starts, analogs, {*counts.values()})
    ]
    fitting = sorted({m for m in made if 0 <= end - m.end < _BLOCK}, key=lambda m: m.n_frames)
    return _chosen(path, made, fitting, counts, end, report)


def _frame_counts(path, header, values):
    """How many frames the file says it has, by where it says so."""
    counts = {"the header": header.last - header.first + 1}
    counts["POINT:FRAMES"] = values.number("POINT:FRAMES")
    counts["POINT:LONG_FRAMES"] = values.number("POINT:LONG_FRAMES")
    ends = [values.numbers(f"TRIAL:ACTUAL_{end}_FIELD") for end in ("START", "END")]
    ends = [e[0] + (e[1] << 16 if len(e) == 2 and isinstance(e[1], int) else 0) for e in ends if e]
    counts["TRIAL:ACTUAL_END_FIELD"] = ends[1] - ends[0] + 1 if len(ends) == 2 else None
    counts = {k: int(n) for k, n in counts.items() if n is not None and 1 <= n < 2**40}
    if not counts:
        raise ValueError(
            f"{path}: damaged: the header says frames {header.first} to {header.last}, and no "
            "parameter says more; export the file again."
        )
    return counts


def _chosen(path, made, fitting, counts, end, report):
    """The one layout that fills the file."""
    said = ", ".join(f"{place} {n}" for place, n in counts.items())
    header = made[0].header
    if not fitting:
        fitting = _uncounted(path, made, counts, end)
    if not fitting:
        short = min(made, key=lambda m: m.end)
        if short.end > end:
            raise ValueError(
                f"{path}: damaged or cut short: {short.n_frames} frames of {header.n_points} "
                f"points need {short.end} bytes, but the file has {end}; copy or export it again."
            )
        if len(made) > 1:
            raise ValueError(
                f"{path}: damaged: its counts of frames ({said}) and of what is in each disagree, "
                f"and none fits the {end} bytes that it has; export it again."
            )
        fitting = made
    if len({(m.start, m.analog) for m in fitting}) > 1:
        raise ValueError(
            f"{path}: damaged: header and parameters disagree about where the data lie, and the "
            "size of the file does not tell which is right; export it again."
        )
    layout = fitting[-1]
    for shorter in fitting[-2::-1]:  # frames of zeros alone are what fills the last block
        if not _all_zero(path, shorter.end, layout.end):
            break
        layout = shorter
    wrong = {k: n for k, n in counts.items() if n not in (layout.n_frames, _MOST_16)}
    if wrong and not all(n % 65536 == layout.n_frames % 65536 for n in wrong.values()):
        report.append(f"{layout.n_frames} frames by the size of the file; it says: {said}")
    left = end - layout.end
    if left >= _BLOCK or (left and header.size % _BLOCK):
        warn(path, report, f"{left} bytes after the last frame were not read", stacklevel=5)
    return layout


def _uncounted(path, made, counts, end):
    """Layouts of more frames than 16 bits count, by the size of the file."""
    full = any(n % 65536 in (0, _MOST_16) for n in counts.values())
    fitting = []
    for base in {replace(m, n_frames=0) for m in made}:
        most = (end - base.start) // base.frame_bytes
        least = max(_MOST_16 + 1, most - (_BLOCK - 1) // base.frame_bytes)
        for n in range(least, most + 1):
            if full or any(n % 65536 == c % 65536 for c in counts.values()):
                fitting.append(replace(base, n_frames=n))
    return fitting


def _all_zero(path, first, last):
    """Whether the bytes from first to last are zero: at most a block of them."""
    with open(path, "rb") as file:
        file.seek(first)
        return not any(file.read(last - first))


def _rate(path, header, values):
    stated = header.rate, values.number("POINT:RATE")
    rates = [v for v in stated if v is not None and np.isfinite(v) and v > 0]
    if not rates:
        raise ValueError(f"{path}: no frame rate in it; say it with fps=.")
    if not math.isclose(rates[0], rates[-1], rel_tol=1e-3):
        raise ValueError(
            f"{path}: the header says {rates[0]:g} frames/s, POINT:RATE {rates[1]:g}; say which is "
            "right with fps=."
        )
    return float(str(np.float32(rates[-1])))  # 59.94, not 59.9399986


def _labels(path, values, n_points, report):
    """Label of each point: "" where there is none, None where it is no marker."""
    labels = values.continued("POINT:LABELS")
    more = [label for label in labels[n_points:] if label]
    if more:
        report.append(f"{len(more)} label(s) without a point left out ({listed(more)})")
    labels = labels[:n_points] + [""] * (n_points - len(labels))
    counted = {}
    for kind in _MODEL_OUTPUTS:
        named = {name for name in values.continued(f"POINT:{kind}") if name}
        bare = {name.rpartition(":")[2] for name in named}
        for i, label in enumerate(labels):
            _, colon, tail = (label or "").rpartition(":")
            if label and (label in named or tail in (named if colon else bare)):
                labels[i] = None
                counted[kind] = counted.get(kind, 0) + 1
    for i, label in enumerate(labels):  # of files that were saved again without these lists
        if found := label and _OUTPUT.fullmatch(label.rpartition(":")[2]):
            labels[i], kind = None, f"{found[1] or 'force'}s"
            counted[kind.upper()] = counted.get(kind.upper(), 0) + 1
    if counted:
        kinds = ", ".join(f"{count} {kind.lower()}" for kind, count in counted.items())
        report.append(f"{sum(counted.values())} output(s) of a model left out: {kinds}")
    if not any(label is not None for label in labels):
        raise ValueError(f"{path}: no markers in it, only outputs of a model ({kinds}).")
    return labels


def _positions(path, file, layout, columns, factor):
    """Positions of the points asked for, millimetres, NaN where hidden; read piece by piece."""
    header, n_points = layout.header, layout.n_points
    positions = np.empty((layout.n_frames, len(columns), 3), dtype=np.float32)
    rows = max(1, _READ_BYTES // layout.frame_bytes)
    file.seek(layout.start)
    for first in range(0, layout.n_frames, rows):
        count = min(rows, layout.n_frames - first)
        data = file.read(count * layout.frame_bytes)
        if len(data) < count * layout.frame_bytes:
            raise ValueError(f"{path}: cut short while it was read; read it again.")
        values = (
            _floats(data, header) if layout.is_float else np.frombuffer(data, f"{header.order}i2")
        )
        points = values.reshape(count, -1)[:, : 4 * n_points].reshape(count, n_points, 4)
        points = points[:, columns].astype(float)
        scale = factor * (1.0 if layout.is_float else layout.scale)
        with np.errstate(over="ignore", invalid="ignore"):  # refused where all is checked
            positions[first : first + count] = points[..., :3] * scale
            # the residual, cut to a whole number as the format wants it, is negative where hidden
            positions[first : first + count][~(points[..., 3] > -1)] = np.nan
    return positions
