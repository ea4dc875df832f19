"""Live Link Face: takes as the phone app and its kin record them, and weights written their way."""

import csv
import re
import warnings

import numpy as np

from facelab.checks import check_choice, check_type
from facelab.files.takes.columns import live_link_columns
from facelab.files.takes.recording import as_take
from facelab.files.takes.rows import read_rows
from facelab.files.takes.timecodes import CODED, SLOWEST
from facelab.files.text import TextTable
from facelab.files.words import listed
from facelab.motion import WeightSequence
from facelab.names import ANGLES, ARKIT, arkit_names
from facelab.storage import atomic_path

_SPLIT = re.compile(r"\d{1,2}:\d\d:\d\d", re.ASCII)


def read_live_link_csv(path, fps=None, scale=None, repeats="lost"):
    """A performance recorded with the Live Link Face app, or written by its kin.

    Columns may come in any order, in ARKit's spelling or another that is seen through (see
    `facelab.names`), set off by commas, semicolons or tabs, with decimal points or commas, quoted
    or not, in UTF-8 or UTF-16. Columns that are neither one of ARKit's 52 weights nor one of the
    nine angles are kept apart. Time codes put every frame in its place; see `Returns` for what is
    missing.

    Parameters
    ----------
    path : str or Path
        CSV with a column Timecode and at least one of ARKit's weights.
    fps : float, optional
        Frames a second; the rows then follow one another at that rate, and time codes do not
        count. For files whose codes mean something else, such as one second a row.
    scale : float, optional
        Factor that makes weights of 0 to 1 of the file's: 0.01 for percent. Left out, weights
        beyond 2 are refused.
    repeats : {"lost", "kept"}
        What a row is that repeats the one before exactly, angles included: a frame in which the
        tracker had lost the face, or a pose that is held.

    Returns
    -------
    WeightSequence
        Weights as recorded, not clipped; `angles` in radians. `valid` is False in lost frames: rows
        without a face (`timecode,0`), repeated rows, and frames missing between two time codes. Of
        more than two seconds at once it is only marked how long they are, in `gaps`. `others` holds
        further columns of numbers, and all angles if one turns as only degrees do. `report` says
        what was found, counted and left out.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing, empty or damaged file, doubled columns, values that are no weights, time
        codes that do not run forwards or at no rate of a recording; the message names file, line
        and column.

    Warns
    -----
    UserWarning
        For columns that are missing or foreign, a last row that is cut, and gaps.
    """
    check_choice(repeats, "repeats", ("lost", "kept"))
    return read_live_link(TextTable(path, "Live Link CSV file"), fps, scale, repeats, 4)


def read_live_link(table, fps, scale, repeats, stacklevel):
    """As `read_live_link_csv`, of a table of which the header is read."""
    place = table.place(table.header_line)
    columns = live_link_columns(table.header, place, timed=fps is None)
    found = read_rows(table, columns, _rejoined(table, columns.time))
    weights = [n for n in found.names if n not in ANGLES]
    missing = [n for n in ARKIT if n not in weights]
    if missing:
        found.warned.append(
            f"no column for {len(missing)} of ARKit's 52 weights, which will be missing in the "
            f"take: {', '.join(missing)}"
        )
    all_columns = len(found.names) + len(columns.others)
    if found.count not in (None, len(weights), len(found.names), all_columns):
        found.warned.append(
            f"its rows count {found.count} weights, the header names {len(weights)}"
        )
    if found.others:
        found.warned.append(
            f"neither weights nor angles of ARKit, kept apart in others: {', '.join(found.others)}"
        )
    return as_take(found, fps, scale, repeats, stacklevel)


def _rejoined(table, k):
    """Rows of a table, time codes made whole where `;` is both drop-frame mark and separator."""
    cut = None
    for number, cells, plain in table.rows():
        if cut is None:
            # the first row tells: one cell too many, or no face in it and one cell too many
            filled = len(cells) - next((i for i, c in enumerate(cells[::-1]) if c.strip()), 0)
            odd = filled == len(table.header) + 1 or filled == 3 < len(table.header)
            code = k is not None and len(cells) > k and _SPLIT.fullmatch(cells[k].strip())
            cut = bool(table.delimiter == ";" and code and odd)
        if cut and len(cells) > k + 1:
            cells = [*cells[:k], f"{cells[k]};{cells[k + 1]}", *cells[k + 2 :]]
        yield number, cells, plain


# --- writing --------------------------------------------------------------------------------------


def to_arkit(take):
    """The same weights under the 52 names of ARKit.

    Where several units share a name (`browInnerUp_L` and `_R`, AU26 and AU27), the strongest
    counts. What was not there rests at 0.

    Parameters
    ----------
    take : WeightSequence

    Returns
    -------
    WeightSequence

    Raises
    ------
    TypeError, ValueError
        If `take` is no WeightSequence or no unit of it has an ARKit name.

    Warns
    -----
    UserWarning
        Naming the units in use that ARKit has no counterpart for.
    """
    check_type(take, "take", WeightSequence, "WeightSequence(weights, names, fps)")
    targets = {name: arkit_names(name) for name in take.names}
    if not any(targets.values()):
        raise ValueError(
            f"take has no unit with an ARKit name; its units are {listed(take.names)}; write "
            "it under its own names with write_weights_csv."
        )
    W = np.where(take.valid[:, None], take.weights, 0)
    used = (np.abs(W) > 1e-3).any(axis=0)
    lost = [n for n, u in zip(take.names, used, strict=True) if u and not targets[n]]
    if lost:
        warnings.warn(f"not exported, ARKit has no such shape: {', '.join(lost)}.", stacklevel=2)
    out = np.zeros((take.n_frames, len(ARKIT)))
    for k, name in enumerate(take.names):
        for target in targets[name]:
            column = out[:, ARKIT.index(target)]
            column[:] = np.where(np.abs(W[:, k]) > np.abs(column), W[:, k], column)
    out[~take.valid] = np.nan
    return WeightSequence(out, ARKIT, take.fps, take.valid, take.angles, gaps=take.gaps)


def write_live_link_csv(path, take):
    """Write weights as Live Link Face records them; `read_live_link_csv` reads the same again.

    A lost frame becomes a row without a face, as the app writes it; gaps show in the time codes.
    Readers may take a frame that repeats the one before exactly for a lost one: ours does, unless
    told `repeats="kept"`.

    Parameters
    ----------
    path : str or Path
    take : WeightSequence
        Under ARKit's names, those of ICT-FaceKit or FACS, see `to_arkit`. Of the nine angles, those
        that it has are written, the others are 0.

    Raises
    ------
    ValueError
        For a rate that a time code cannot count, no valid frame, no unit with an ARKit name, or
        more than a day.

    Warns
    -----
    UserWarning
        For held frames, angles of other names, and units without a counterpart.
    """
    take = to_arkit(take)
    if not take.valid.any():
        raise ValueError("take has no valid frame: there is nothing to write.")
    far = np.abs(take.weights[take.valid]) > 2
    if far.any():
        raise ValueError(
            f"take holds {int(far.sum())} weights beyond 2, which no reader of Live Link would "
            "take for weights of 0 to 1; scale them."
        )
    step, base, drop = _time_base(take.fps)
    beats = base - step + (np.round(take.times * take.fps).astype(int)) * step
    if beats[-1] >= 86400 * base * 0.99:
        raise ValueError("take lasts longer than a day, which a time code cannot count; split it.")
    _warn_of_writing(take)
    angles = [take.angles.get(name, np.zeros(take.n_frames)) for name in ANGLES]
    values = np.column_stack([take.weights, *angles])
    with atomic_path(path) as part, open(part, "w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        names = [n[0].upper() + n[1:] for n in ARKIT]
        writer.writerow(["Timecode", "BlendshapeCount", *names, *ANGLES])
        for beat, row, valid in zip(beats.tolist(), values.tolist(), take.valid, strict=True):
            code = _code(beat, base, drop)
            if valid:
                writer.writerow([code, len(row), *map(_written, row)])
            else:
                writer.writerow([code, 0])


def _warn_of_writing(take):
    V = np.column_stack([take.weights, *take.angles.values()])
    held = int((V[1:] == V[:-1]).all(axis=1).sum())
    if held:
        warnings.warn(
            f"{held} of {take.n_frames} frames repeat the one before exactly, and a reader may "
            "take them for lost ones; read them back with repeats='kept'.",
            stacklevel=3,
        )
    foreign = sorted(set(take.angles) - set(ANGLES))
    if foreign:
        warnings.warn(f"not written, no angles of Live Link: {', '.join(foreign)}.", stacklevel=3)


def _written(value):
    """All digits that a float needs to come back, without an exponent."""
    text = repr(value)
    return np.format_float_positional(value, trim="0") if "e" in text else text


def _time_base(fps):
    """Beats between frames, beats a second, and drop-frame or not: the last beat tells apart."""
    for rate, drop in ((fps, False), (fps * 1.001, True)):
        for low, base in zip((0, *CODED), CODED, strict=False):
            step = base / rate
            whole = abs(step - round(step)) < (1e-5 if drop else 1e-12)
            if fps >= SLOWEST and whole and base - step >= low and (not drop or base in (30, 60)):
                return round(step), base, drop
    raise ValueError(
        f"fps={fps:g}, but a time code counts {', '.join(map(str, CODED))}, 29.97, 59.94 or an "
        f"even part of them, {SLOWEST} at least; resample the take."
    )


def _code(beat, base, drop):
    if drop:  # the numbers that are passed over count as well
        passed = base // 15
        tens, rest = divmod(beat, 600 * base - 9 * passed)
        beat += passed * (9 * tens + max(0, (rest - passed) // (60 * base - passed)))
    seconds, frame = divmod(beat, base)
    minutes, second = divmod(seconds, 60)
    mark = ";" if drop else ":"
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}{mark}{frame:02d}.000"
