"""C3D, the file format of motion capture: markers out."""

import os
import struct

import numpy as np

from facelab.checks import check_type
from facelab.files.markers.c3d import parse_c3d
from facelab.motion import MarkerSequence
from facelab.storage import atomic_path

_BLOCK = 512
_MOST_16 = 0xFFFF
_WRITTEN_BYTES = 2**23  # of the data at a time


def write_c3d(path, markers):
    """Write markers as C3D (Intel, floating point), whole or not at all.

    The file is written beside, read back and compared before it takes its place.

    Parameters
    ----------
    path : str or Path
    markers : MarkerSequence
        Positions are stored as float32 millimetres; hidden ones get residual -1. More than 65,535
        frames are counted in TRIAL:ACTUAL_END_FIELD, as Vicon does.

    Raises
    ------
    ValueError
        For an empty sequence, more than 65,535 markers, and whatever would not come back as it is:
        names with blanks around them or a prefix that all share, a visible marker at exactly the
        origin, a position more than a kilometre away.
    OSError
        If the disk is full; what was there before stays.
    """
    check_type(markers, "markers", MarkerSequence, "see facelab.read_markers")
    n_frames, n_markers = markers.n_frames, markers.n_markers
    if not 1 <= n_frames < 2**31 or not 1 <= n_markers <= _MOST_16:
        raise ValueError(
            f"markers has {n_frames} frames of {n_markers} markers, but a C3D file holds 1 to "
            f"{_MOST_16} markers and at least one frame."
        )
    parameters = _parameter_section(markers)
    start = 2 + len(parameters) // _BLOCK
    header = struct.pack(
        "<BBHHHHHfHHf", 2, 0x50, n_markers, 0, 1, min(n_frames, _MOST_16), 0, -1.0, start, 0,
        markers.fps,
    )  # fmt: skip
    with atomic_path(path) as part:
        with open(part, "wb") as out:
            out.write(header.ljust(_BLOCK, b"\0") + parameters)
            rows = max(1, _WRITTEN_BYTES // (16 * n_markers))
            for first in range(0, n_frames, rows):
                some = markers.positions[first : first + rows]
                points = np.zeros((*some.shape[:2], 4), dtype="<f4")
                with np.errstate(over="ignore"):  # infinite when read back
                    points[..., :3] = some
                points[np.isnan(some[..., 0])] = (0, 0, 0, -1)
                out.write(points.tobytes())
            out.write(bytes(-out.tell() % _BLOCK))
            out.flush()
            os.fsync(out.fileno())
        _check_written(path, part, markers)


def _check_written(path, part, markers):
    """Refuse what does not come back as it was."""
    try:
        read = parse_c3d(part, judge=False)
    except ValueError as error:
        why = str(error).replace(str(part), str(path))
        raise ValueError(f"markers cannot be kept in a C3D file: {why}") from None
    changed = [(a, b) for a, b in zip(markers.names, read.names, strict=True) if a != b]
    if changed:
        wrong = ", ".join(f"{a!r} would come back as {b!r}" for a, b in changed[:3])
        raise ValueError(f"names: {wrong}; a C3D file cannot hold that: rename the marker(s).")
    rows = max(1, _WRITTEN_BYTES // (12 * markers.n_markers))
    for first in range(0, markers.n_frames, rows):
        wanted = markers.positions[first : first + rows].astype(np.float32)
        found = read.positions[first : first + rows]
        differs = ~((found == wanted) | (np.isnan(found) & np.isnan(wanted))).all(axis=2)
        if differs.any():
            frame, marker = (int(i) for i in np.argwhere(differs)[0])
            why = "exactly 0, 0, 0 means hidden in a C3D file; move the origin"
            if wanted[frame, marker].all():
                why = "that fills gaps, and means hidden; make it NaN"
            raise ValueError(
                f"{markers.names[marker]} in frame {first + frame} is at {wanted[frame, marker]}, "
                f"but would come back as {found[frame, marker]}: {why}."
            )


def _parameter_section(markers):
    """Group POINT, and TRIAL for a long take, as bytes in whole blocks."""
    labels = [name.encode() for name in markers.names]
    wrong = [
        n
        for n, b in zip(markers.names, labels, strict=True)
        if len(b) > 127 or not n.isprintable() or n != n.strip() or not n
    ]
    if wrong:
        raise ValueError(
            f"names: {', '.join(map(repr, wrong[:3]))} cannot be kept in a C3D file; use 1 to 127 "
            "characters that print, without blanks around them."
        )
    n_frames, width = markers.n_frames, max(map(len, labels))
    point = {
        "USED": _words(markers.n_markers),
        "SCALE": (4, [], struct.pack("<f", -1.0)),
        "RATE": (4, [], struct.pack("<f", markers.fps)),
        "DATA_START": None,
        "FRAMES": _words(min(n_frames, _MOST_16)),
        "UNITS": (-1, [2], b"mm"),
    }
    for number, first in enumerate(range(0, len(labels), 255), 1):
        some = labels[first : first + 255]
        name = f"LABELS{number if number > 1 else ''}"
        point[name] = (-1, [width, len(some)], b"".join(b.ljust(width) for b in some))
    groups = {"POINT": point}
    if n_frames > _MOST_16:
        groups["TRIAL"] = {
            "ACTUAL_START_FIELD": _words(1, 0),
            "ACTUAL_END_FIELD": _words(n_frames & _MOST_16, n_frames >> 16),
        }
    blocks = 1
    while True:  # DATA_START is written into the section whose size it depends on
        point["DATA_START"] = _words(2 + blocks)
        records = b"".join(
            _record(number, name, record)
            for number, (group, parameters) in enumerate(groups.items(), 1)
            for name, record in [(group, None), *parameters.items()]
        )
        needed = -(-(4 + len(records) + 2) // _BLOCK)
        if needed == blocks:
            head = bytes([1, 0x50, min(blocks, 255), 84])
            return (head + records).ljust(blocks * _BLOCK, b"\0")
        blocks = needed


def _words(*values):
    """A parameter of 16-bit words: a scalar, or a list of them."""
    dims = [] if len(values) == 1 else [len(values)]
    return 2, dims, struct.pack(f"<{len(values)}H", *values)


def _record(number, name, record):
    """A group (record None) or a parameter of group `number`, as bytes; no description."""
    if record is None:
        return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<HB", 3, 0)
    kind, dims, data = record
    body = struct.pack("<bB", kind, len(dims)) + bytes(dims) + data + b"\0"
    return (
        struct.pack("<bb", len(name), number)
        + name.encode()
        + struct.pack("<H", len(body) + 2)
        + body
    )
