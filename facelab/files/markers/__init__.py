"""Markers of capture programs: the reader is chosen by the ending of the file."""

from pathlib import Path

from facelab.checks import check_type
from facelab.files.markers.c3d import read_c3d
from facelab.files.markers.c3d_write import write_c3d
from facelab.files.markers.maya import read_maya
from facelab.files.markers.npz import read_marker_arrays
from facelab.files.markers.rules import MarkerReport
from facelab.files.markers.tables import read_marker_table
from facelab.files.markers.trc import read_trc

__all__ = ["KINDS", "MarkerReport", "read_c3d", "read_markers", "write_c3d"]


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
    take.csv: 2 frames of 1 markers at 100 frames/s, 50.0 % hidden
    no unit in the file: taken as millimetres; another with unit=
    """
    check_type(path, "path", (str, Path), "give the path of a file")
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise ValueError(
            f"path={str(path)!r}: unknown kind of file; readable are {', '.join(_READERS)}."
        )
    return reader(path, unit, fps, subject)


_READERS = {
    ".c3d": read_c3d,
    ".trc": read_trc,
    ".csv": read_marker_table,
    ".tsv": read_marker_table,
    ".txt": read_marker_table,
    ".npz": read_marker_arrays,
    ".ma": read_maya,
}

KINDS = tuple(_READERS)
"""Endings of files that hold markers that can be read."""
