"""Weights over time in tables of every kind: text, JSON, npz; and a table of our own."""

import warnings
from pathlib import Path

import numpy as np

from facelab.checks import check_type
from facelab.files.takes.arrays import read_json_recording, read_npz_recording
from facelab.files.takes.columns import is_live_link, weight_columns
from facelab.files.takes.live_link import read_live_link
from facelab.files.takes.recording import as_take
from facelab.files.takes.rows import read_rows
from facelab.files.text import TextTable
from facelab.motion import WeightSequence
from facelab.names import ANGLES
from facelab.storage import atomic_path


def read_weights(path, fps=None, scale=None, names=None):
    """Weights over time from a table of any kind, each column under its name.

    Text: a line of names, then a row for each frame, set off by commas, semicolons or tabs. A table
    of `write_weights_csv` comes back exactly as it was; one of Live Link Face is known by its
    header and read by `read_live_link_csv`; of OpenFace's the intensities (`AU12_r`, 0 to 5) become
    weights (`AU12`, 0 to 1), and rows without success are lost. JSON: names beside a matrix of
    weights (`facsNames`, `weightMat` and `exportFps` of Audio2Face, or `names`, `weights`, `fps`),
    a list of frames, or one in each line, with a weight for each name or with the categories of
    MediaPipe, or a list of weights for each name. npz: `names` and `weights`, with or without
    `fps`, `times` and `valid`, or an array for each name.

    Parameters
    ----------
    path : str or Path
        `.json`, `.jsonl`, `.ndjson` and `.npz` by their ending; all else is text.
    fps : float, optional
        Frames a second; goes before what the file says of time. Needed where it says nothing.
    scale : float, optional
        Factor that makes weights of 0 to 1 of the file's: 0.01 for percent. Left out, weights
        beyond 2 are refused; 1 takes them as they are.
    names : sequence of str, optional
        The columns that are weights, for a table with other numbers in it. Left out, all are but
        times, what a tracker says of itself (`confidence`) and where something stands or turns
        (`head_rx`); where half of them or more are ARKit's, all others are kept apart.

    Returns
    -------
    WeightSequence
        A row without numbers is a lost frame; `report` says what was found, counted and left out.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing, empty or damaged file, or one without names or time; the message names file
        and place.

    Warns
    -----
    UserWarning
        For a last row without its line end, which may be cut, for columns kept apart or left out,
        and for gaps in time.

    Examples
    --------
    >>> import facelab
    >>> from pathlib import Path
    >>> _ = Path("smile.csv").write_text("jawOpen;mouthSmileLeft\\n0,1;0,5\\n0,2;0,75\\n")
    >>> take = facelab.read_weights("smile.csv", fps=60)
    >>> take, float(take.weights[1, 1])
    (WeightSequence(2 frames of 2 weights, 60 frames/s, 0 lost), 0.75)
    """
    check_type(path, "path", (str, Path), "give the path of a table of weights")
    if isinstance(names, str):
        raise TypeError(f"names={names!r} is one str; give a list of names.")
    ending = Path(path).suffix.lower()
    if ending in (".json", ".jsonl", ".ndjson", ".npz"):
        found = (read_npz_recording if ending == ".npz" else read_json_recording)(path, names)
    else:
        table = TextTable(path, "table of weights")
        if names is None and is_live_link(table.header):
            return read_live_link(table, fps, scale, "lost", 4)
        place = table.place(table.header_line)
        if table.header[:2] == ["frame", "fps"] and names is None:
            found = _ours(table, place)
        else:
            columns = weight_columns(table.header, place, names)
            found = read_rows(table, columns)
            if columns.intensities:
                scale = _of_openface(found, scale)
    weights = [name for name in found.names if name not in ANGLES]
    if scale is None and not found.weighed and weights and all("%" in n for n in weights):
        scale = 0.01
        found.warned.append(
            "its names say percent: read with scale=0.01; scale=1 takes it as it is"
        )
    if found.others:
        others = list(found.others)
        more = f", ... ({len(others)})" if len(others) > 12 else ""
        found.warned.append(f"no weights, kept apart in others: {', '.join(others[:12])}{more}")
    return as_take(found, fps, scale)


def _of_openface(found, scale):
    """The scale of intensities; rows without success show no face."""
    success = found.others.get("success")
    if success is not None:
        found.values[success == 0] = np.nan
    if scale is not None:
        return scale
    found.warned.append("intensities of OpenFace, from 0 to 5, are read with scale=0.2")
    return 0.2


def _ours(table, place):
    """A table of `write_weights_csv`: all columns are weights, and rows are numbered from 0."""
    columns = weight_columns(table.header, place, names=table.header[2:])
    found = read_rows(table, columns)
    for i, frame in enumerate(found.frames):
        if frame != i:
            raise ValueError(
                f"{found.place(i)}: here should be frame {i}, not {frame}; the table was cut or "
                "edited."
            )
    found.weighed, found.codes = True, None  # a unit may be called time
    return found


def write_weights_csv(path, take):
    """Write weights as a plain table: frame, fps, and a column for each unit under its own name.

    `read_weights` reads exactly the same again.

    Parameters
    ----------
    path : str or Path
    take : WeightSequence
        Lost frames become empty cells. Angles follow the weights.

    Raises
    ------
    TypeError, ValueError
        For what such a table cannot hold: gaps in time, names with a line break or blanks around
        them, weights beyond 1000, no valid frame.

    Warns
    -----
    UserWarning
        For `others`, which are not written.
    """
    check_type(take, "take", WeightSequence, "WeightSequence(weights, names, fps)")
    _refuse_unwritable(take)
    if take.others:
        warnings.warn(f"not written: {', '.join(take.others)}.", stacklevel=2)
    values = np.column_stack([take.weights, *take.angles.values()]).tolist()
    with atomic_path(path) as part, open(part, "w", encoding="utf-8") as out:
        header = ["frame", "fps", *take.names, *take.angles]
        out.write(",".join(map(_quoted, header)) + "\n")
        for frame, (row, valid) in enumerate(zip(values, take.valid, strict=True)):
            cells = map(repr, row) if valid else [""] * len(row)
            out.write(",".join([str(frame), repr(take.fps), *cells]) + "\n")


def _quoted(name):
    return '"' + name.replace('"', '""') + '"' if {*name} & {*',;\t"'} else name


def _refuse_unwritable(take):
    if take.gaps:
        frame, seconds = next(iter(take.gaps.items()))
        raise ValueError(
            f"take lacks {seconds:g} s before frame {frame}, which the table cannot hold; write "
            f"its parts: take[:{frame}], take[{frame}:]."
        )
    if not take.valid.any():
        raise ValueError("take has no valid frame: there is nothing to write.")
    bad = [n for n in take.names if n != n.strip() or not n or {*n} & {*"\r\n\0"} or n in ANGLES]
    bad += [n for n in take.angles if n not in ANGLES]
    if bad:
        raise ValueError(
            f"take has names that the table cannot hold: {', '.join(map(repr, bad))}; rename them "
            "(take.renamed): no line breaks, no blanks around, and names of angles for angles."
        )
    far = int((np.abs(take.weights[take.valid]) > 1000).sum())
    far += sum(int((np.abs(a[take.valid]) > 2 * np.pi).sum()) for a in take.angles.values())
    if far:
        raise ValueError(
            f"take holds {far} values that no weight or angle is (weights beyond 1000, angles "
            "beyond a turn in radians); scale them."
        )
