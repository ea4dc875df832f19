"""Markers, whatever the file: the reader is chosen by its ending."""

from pathlib import Path

import numpy as np

from facelab.checks import check_type
from facelab.files.arrays import read_arrays
from facelab.files.c3d import read_c3d
from facelab.files.marker_rules import (
    checked,
    factor_of,
    judged,
    marker_sequence,
    resolve_names,
)
from facelab.files.marker_tables import read_marker_table
from facelab.files.maya import read_maya
from facelab.files.trc import read_trc


def read_markers(path, unit=None, fps=None, subject=None):
    """The markers of a capture file, hidden ones as NaN, and a report of what was found.

    Parameters
    ----------
    path : str or Path
        C3D (`.c3d`); TRC of Motion Analysis and OpenSim (`.trc`); tables of OptiTrack Motive, Vicon
        Nexus, Qualisys, or with columns `chin_x, chin_y, chin_z` (`.csv`, `.tsv`, `.txt`); arrays
        `positions` (n_frames, n_markers, 3), `names` and `fps` (`.npz`); curves of a Maya scene
        (`.ma`).
    unit : {"mm", "cm", "dm", "m", "in", "ft"}, optional
        Length unit, where the file names none or a wrong one.
    fps : float, optional
        Frames a second, where the file says none or a wrong one.
    subject : str, optional
        Only the markers of this subject (what stands before the colon), where there are several.

    Returns
    -------
    MarkerSequence
        Millimetres, axes as in the file: which one is up differs between programs. Its `report`
        says what was left out, renamed and counted.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, of another kind, damaged, or says two things at once; the message
        names the place, and what to do.

    Warns
    -----
    UserWarning
        For doubled names, a last row cut short, and a size that is no face's.

    Examples
    --------
    >>> import facelab
    >>> with open("take.csv", "w") as out:
    ...     print("time,chin_x,chin_y,chin_z", "0,0.5,1,2", "0.01,,,", sep="\\n", file=out)
    >>> take = facelab.read_markers("take.csv")
    >>> take
    MarkerSequence(2 frames of 1 markers, 100 frames/s, 50.0 % occluded)
    >>> print(take.report)
    no unit in the file: taken as millimetres; another with unit=
    """
    check_type(path, "path", (str, Path), "give the path of a file")
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise ValueError(
            f"path={str(path)!r}: unknown kind of file; readable are {', '.join(_READERS)}."
        )
    return reader(path, unit, fps, subject)


def _read_npz(path, unit, fps, subject):
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


_READERS = {
    ".c3d": read_c3d,
    ".trc": read_trc,
    ".csv": read_marker_table,
    ".tsv": read_marker_table,
    ".txt": read_marker_table,
    ".npz": _read_npz,
    ".ma": read_maya,
}
