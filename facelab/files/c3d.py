"""C3D, the file format of motion capture: markers in and out.

ezc3d does the parsing, in a child process: damaged files make it read nonsense, or crash. What it
returns is held against the header, which is parsed here, and against the size of the file.
"""

import inspect
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from facelab.checks import check_number
from facelab.motion import MarkerSequence
from facelab.storage import atomic_path, existing_file

_BLOCK = 512
_MM = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0}
_FARTHEST = 1e6  # mm; no capture volume is a kilometre wide
_CHILD_SECONDS = 15  # and one for each megabyte; a sound file takes a twentieth of that


def read_c3d(path, units=None):
    """The markers of a C3D file, occluded ones as NaN.

    Parameters
    ----------
    path : str or Path
    units : {"mm", "cm", "dm", "m"}, optional
        Length unit, for files that state none or a wrong one; else POINT:UNITS of the file.

    Returns
    -------
    MarkerSequence
        Millimetres, names as in the file without blanks around them; points without a label are
        called `unlabelled_1` and so on. A marker is occluded where its residual is negative,
        where a coordinate is NaN, or where it lies exactly at the origin: makers differ.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, cut short, without markers, or in an unknown unit. The
        process that calls is safe: a crash or a hang while reading becomes a ValueError.

    References
    ----------
    The C3D file format user guide, www.c3d.org.
    """
    path = existing_file(path, "C3D file")
    if units is not None and units not in _MM:
        raise ValueError(f"units={units!r} is unknown; choose one of {', '.join(_MM)}.")
    header = _Header(path)
    with tempfile.TemporaryDirectory(prefix="facelab_c3d_") as folder:
        out = Path(folder) / "read.npz"
        _run_child(path, out)
        with np.load(out, allow_pickle=False) as stored:
            read = {name: stored[name] for name in stored.files}
    return _markers(path, header, read, units)


def read_own_c3d(path):
    """`read_c3d` without the child process: only for files whose checksum is known to be right."""
    path = existing_file(path, "C3D file")
    return _markers(path, _Header(path), _parse(str(path)), None)


def write_c3d(path, markers):
    """Write markers as C3D (Intel, floating point), whole or not at all.

    Parameters
    ----------
    path : str or Path
    markers : MarkerSequence
        Positions are stored as float32 millimetres; occluded ones get residual -1.

    Raises
    ------
    ValueError
        For an empty sequence, or one with more than 65,535 frames: cut it.
    """
    import ezc3d

    n_frames, n_markers = markers.n_frames, markers.n_markers
    if not 1 <= n_frames <= 65535 or not 1 <= n_markers <= 65535:
        raise ValueError(
            f"markers has {n_frames} frames of {n_markers} markers, but a C3D file holds 1 to "
            "65535 of each; cut the sequence."
        )
    visible = markers.visible.T
    points = np.ones((4, n_markers, n_frames))
    points[:3] = np.where(visible, markers.positions.transpose(2, 1, 0), 0.0)
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [float(markers.fps)]
    point["UNITS"]["value"] = ["mm"]
    point["LABELS"]["value"] = list(markers.names)
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(visible, 0.0, -1.0)[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, n_markers, n_frames), dtype=bool)
    with atomic_path(path) as part:
        file.write(str(part))


class _Header:
    """What the first 512 bytes of a C3D file promise, held against the size of the file."""

    def __init__(self, path):
        size = path.stat().st_size
        with open(path, "rb") as file:
            block = file.read(_BLOCK)
            if len(block) < _BLOCK or block[1] != 0x50:
                raise ValueError(f"{path}: not a C3D file (its first block lacks the mark 0x50).")
            parameters = (max(block[0], 1) - 1) * _BLOCK
            file.seek(parameters)
            start = file.read(4)
        if len(start) < 4 or not 84 <= start[3] <= 86:
            raise ValueError(
                f"{path}: damaged: the parameters should start at byte {parameters}, but do not."
            )
        kind = {84: "Intel", 85: "DEC", 86: "SGI"}[start[3]]
        order = ">" if kind == "SGI" else "<"
        words = struct.unpack(f"{order}12H", block[:24])
        self.n_points, self.analog, self.first, self.last = words[1:5]
        self.data_start = (words[8] - 1) * _BLOCK
        # a negative scale says floats; in DEC floats, too, the sign bit is bit 15 of the first word
        sign = words[6] if kind == "DEC" else struct.unpack(f"{order}I", block[12:16])[0] >> 16
        self.bytes_per_value = 4 if sign & 0x8000 else 2
        self.n_frames = self.last - self.first + 1
        self.many_frames = self.last in (0, 0xFFFF)  # more than 16 bits hold: see the parameters
        if self.n_points == 0:
            raise ValueError(f"{path}: no markers in it; the header counts 0 points.")
        if not self.many_frames and self.n_frames < 1:
            raise ValueError(
                f"{path}: damaged: the header says frames {self.first} to {self.last}."
            )
        if not parameters + _BLOCK <= self.data_start < size:
            raise ValueError(
                f"{path}: damaged or cut short: the data should start at byte {self.data_start} of "
                f"{size}."
            )
        self.size = size
        if not self.many_frames:
            self.check_size(path, self.n_frames)

    def check_size(self, path, n_frames):
        """Refuse a file too short for that many frames, or one that holds more uncounted."""
        per_frame = (4 * self.n_points + self.analog) * self.bytes_per_value
        end = self.data_start + n_frames * per_frame
        if end > self.size:
            raise ValueError(
                f"{path}: damaged or cut short: {n_frames} frames of {self.n_points} points need "
                f"{end} bytes, but the file has {self.size}; copy or export it again."
            )
        if self.many_frames and self.size - end >= max(per_frame, _BLOCK):
            raise ValueError(
                f"{path}: only {n_frames} frames of it can be read, and more follow; export the "
                "take in parts of less than 65535 frames."
            )


def _run_child(path, out):
    """Parse in a process of its own, which may crash or hang without harm."""
    code = f"{inspect.getsource(_parse)}\n{_CHILD_MAIN}"
    size = path.stat().st_size
    limit, seconds = 2**30 + 40 * size, _CHILD_SECONDS + size / 1e6
    command = [sys.executable, "-P", "-c", code, str(path.resolve()), str(out), str(limit)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise ValueError(
            f"{path}: not readable: no result within {seconds:.0f} s; the file is damaged."
        ) from None
    if done.returncode != 0 or not out.is_file():
        said = done.stderr.decode(errors="replace").strip().splitlines()
        why = said[-1] if said and done.returncode > 0 else f"crash, code {done.returncode}"
        raise ValueError(f"{path}: damaged: its parts do not fit together ({why}).")


_CHILD_MAIN = """
import sys
import numpy
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[3]), int(sys.argv[3])))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except (ImportError, ValueError, OSError):
    pass
numpy.savez(sys.argv[2], **_parse(sys.argv[1]))
"""


def _parse(path):
    """All of one C3D file that is used here, as plain arrays. Its source runs in the child."""
    import ezc3d
    import numpy as np

    file = ezc3d.c3d(path)
    point = file["parameters"]["POINT"]
    keys = [key for key in point if key.rstrip("0123456789") == "LABELS"]  # LABELS, LABELS2, ...
    labels = [n for key in sorted(keys, key=lambda k: (len(k), k)) for n in point[key]["value"]]
    trial = file["parameters"].get("TRIAL", {})
    ends = [trial[k]["value"] for k in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD") if k in trial]
    # two 16-bit words each, the low one first
    ends = [int(np.uint16(e[0])) + 65536 * int(np.uint16(e[1])) for e in ends if len(e) == 2]
    long = int(np.uint32(point["LONG_FRAMES"]["value"][0])) if "LONG_FRAMES" in point else 0
    return {
        "points": np.asarray(file["data"]["points"]),
        "residuals": np.asarray(file["data"]["meta_points"]["residuals"])[0],
        "labels": np.array([str(n) for n in labels], dtype=str),
        "units": np.array([str(u) for u in point.get("UNITS", {}).get("value", [])], dtype=str),
        "rate": np.array(float(file["header"]["points"]["frame_rate"])),
        "long_frames": np.array(ends[1] - ends[0] + 1 if len(ends) == 2 else long),
    }


def _markers(path, header, read, units):
    points, residuals = read["points"], read["residuals"]
    n_points, n_frames = points.shape[1:]
    promised = {header.n_frames} if not header.many_frames else set()
    if read["long_frames"] > 0:
        promised.add(int(read["long_frames"]))
    if n_points != header.n_points or (promised and n_frames not in promised):
        said = " or ".join(map(str, sorted(promised))) or "many"
        raise ValueError(
            f"{path}: damaged: the header says {said} frames of {header.n_points} points, but "
            f"{n_frames} of {n_points} were found."
        )
    if n_frames < 1:
        raise ValueError(f"{path}: no frames in it.")
    header.check_size(path, n_frames)
    if units is None:
        units = read["units"][0].strip().lower() if len(read["units"]) else ""
        units = {"millimeters": "mm", "millimetres": "mm", "meters": "m", "metres": "m"}.get(
            units, units
        )
        if units not in _MM:
            raise ValueError(
                f"{path}: POINT:UNITS is {units!r}, readable are {', '.join(_MM)}; say what it is "
                'with read_c3d(path, units="mm").'
            )
    positions = points[:3].transpose(2, 1, 0) * _MM[units]
    hidden = (residuals.T < 0) | np.isnan(positions).any(axis=2) | (positions == 0).all(axis=2)
    positions[hidden] = np.nan
    far = np.abs(positions) > _FARTHEST
    if far.any():
        frame, marker, _ = (int(i) for i in np.argwhere(far)[0])
        raise ValueError(
            f"{path}: damaged: {int(far.any(axis=2).sum())} position(s) lie more than a kilometre "
            f"away, the first in frame {frame}, point {marker}."
        )
    labels = [label.strip() for label in read["labels"].tolist()]
    names = [label or f"unlabelled_{i + 1}" for i, label in enumerate(labels[:n_points])]
    names += [f"unlabelled_{i + 1}" for i in range(len(names), n_points)]
    try:
        fps = check_number(read["rate"], "fps", above=0)
        return MarkerSequence(positions, tuple(names), fps)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
