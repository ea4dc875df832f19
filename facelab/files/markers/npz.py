"""Markers in npz: arrays that somebody else wrote, sizes held against the file, no pickles."""

import math
import zipfile

import numpy as np

from facelab.files.markers.rules import (
    checked,
    factor_of,
    judged,
    marker_sequence,
    resolve_names,
)
from facelab.storage import existing_file

_MOST_RATIO = 1100  # deflate cannot press zeros further than to a 1032nd
_ROOM = 2**28  # bytes that an array may have however small its file is
_LIKELY_RATIO = 100


def read_marker_arrays(path, unit=None, fps=None, subject=None):
    """The markers of an npz file with arrays `positions`, `names`, `fps`; see `read_markers`."""
    path, fps = checked(path, "npz file", unit, fps, subject)
    arrays = read_arrays(path, ("positions", "names", "fps", "unit"))
    missing = [name for name in ("positions", "names") if name not in arrays]
    if missing or (fps is None and "fps" not in arrays):
        raise ValueError(
            f"{path}: no array {', '.join(missing) or 'fps'} in it; write positions of shape "
            "(n_frames, n_markers, 3), names and fps with numpy.savez."
        )
    positions, names = arrays["positions"], arrays["names"]
    if names.dtype.kind != "U" or names.ndim != 1:
        raise ValueError(f"{path}: names is no list of strings; give one for each marker.")
    if positions.dtype.kind not in "iuf" or positions.shape[1:] != (len(names), 3):
        raise ValueError(
            f"{path}: positions has shape {positions.shape} and type {positions.dtype}, but "
            f"{len(names)} names ask for numbers of shape (n_frames, {len(names)}, 3)."
        )
    if len(positions) == 0:
        raise ValueError(f"{path}: no frames in it.")
    rate = arrays.get("fps", fps)
    if fps is None:
        if rate.shape not in ((), (1,)) or rate.dtype.kind not in "iuf" or not 0 < rate < np.inf:
            raise ValueError(f"{path}: fps is {rate!r:.60}, but must be one number above 0.")
        fps = float(rate.ravel()[0])
    report, said = [], arrays.get("unit")
    if unit is None and said is None:
        report.append("no unit in the file: taken as millimetres; another with unit=")
    said = "mm" if said is None else str(said)
    kept_names, kept = resolve_names(path, names.tolist(), subject, report)
    factor = factor_of(path, said, unit, "unit")
    keep = np.float32 if positions.dtype == np.float32 else float
    with np.errstate(over="ignore"):  # refused where all is checked
        positions = positions[:, kept].astype(keep) * keep(factor)
    return judged(path, marker_sequence(path, positions, kept_names, fps, report))


def read_arrays(path, names):
    """The arrays of these names in an npz file; those that it does not have are left out.

    Parameters
    ----------
    path : str or Path
    names : sequence of str

    Returns
    -------
    dict of str to ndarray
        Numbers and strings only.

    Raises
    ------
    FileNotFoundError, ValueError
        For a file that is no npz, damaged, with Python objects, or with arrays that are out of all
        proportion to it.
    """
    path = existing_file(path, "npz file")
    try:
        with zipfile.ZipFile(path) as archive:
            stored = set(archive.namelist())
            infos = {n: archive.getinfo(f"{n}.npy") for n in names if f"{n}.npy" in stored}
            arrays = {n: _read(archive, info) for n, info in infos.items()}
    except _Refused as refused:
        raise ValueError(f"{path}: {refused}") from None
    except Exception:  # zip, deflate and header refusals each raise their own
        raise ValueError(
            f"{path}: not a readable npz file, or damaged; write it again with numpy.savez."
        ) from None
    return arrays


class _Refused(Exception):
    pass


def _read(archive, info):
    name = info.filename
    with archive.open(info) as stream:
        version = np.lib.format.read_magic(stream)
        read = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
        shape, fortran, dtype = read[version[0]](stream)
        if dtype.hasobject or dtype.kind not in "biufUS":
            raise _Refused(f"{name} holds {dtype}; numbers or strings are wanted.")
        size = math.prod(shape) * dtype.itemsize
        pressed = max(info.compress_size, 1)
        if size != info.file_size - stream.tell() or size > _MOST_RATIO * pressed + 10**4:
            raise _Refused(f"{name} should be {size} bytes, which the file does not have.")
        if size > _ROOM and size > _LIKELY_RATIO * pressed:
            raise _Refused(
                f"{name} would take {size / 1e9:.1f} GB out of {pressed} bytes; that is no capture."
            )
        data = bytearray(size)
        at = memoryview(data)
        while len(at) and (count := stream.readinto(at)):
            at = at[count:]
        if len(at) or stream.read(1):
            raise _Refused(f"{name} is damaged.")
    array = np.frombuffer(data, dtype)
    return array.reshape(shape, order="F" if fortran else "C")
