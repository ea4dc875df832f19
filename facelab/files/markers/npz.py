"""Markers in npz: arrays that somebody else wrote, sizes held against the file, no pickles."""

import numpy as np

from facelab.files.markers.rules import (
    checked,
    factor_of,
    marker_sequence,
    resolve_names,
)
from facelab.files.npz import stored_rate
from facelab.files.words import listed
from facelab.storage import StoredArrays

_KNOWN = ("positions", "names", "fps", "unit")


def read_marker_arrays(path, unit=None, fps=None, subject=None):
    """The markers of an npz file with arrays `positions`, `names`, `fps`; see `read_markers`."""
    path, fps = checked(path, "npz file", unit, fps, subject)
    report = []
    with open(path, "rb") as file, StoredArrays(path, file) as stored:
        labels = stored.read("names", ("n_markers",), "U").tolist()
        n_frames = stored.shape("positions")[:1]
        if n_frames in ((), (0,)):
            raise stored.refused("positions holds no frames")
        positions = stored.read("positions", ("n_frames", len(labels), 3), "iuf")
        if fps is None:
            fps = stored_rate(stored, "number")
        if fps is None:
            raise ValueError(f"{path}: no frame rate in it; say it with fps=.")
        said = str(stored.read("unit", (), "U")) if "unit" in stored else None
        others = [name for name in stored.names if name not in _KNOWN]
    if others:
        report.append(f"{len(others)} other array(s) left out ({listed(others)})")
    if unit is None and said is None:
        report.append("no unit in the file: taken as millimetres; another with unit=")
    names, kept = resolve_names(path, labels, subject, report)
    factor = factor_of(path, "mm" if said is None else said, unit, "unit")
    if len(kept) < len(labels):
        positions = positions[:, kept]
    keep = np.float32 if positions.dtype == np.float32 else float
    positions = positions.astype(keep, copy=False)
    if factor != 1:
        with np.errstate(over="ignore"):  # refused where all is checked
            positions *= keep(factor)
    return marker_sequence(path, positions, names, fps, report)
