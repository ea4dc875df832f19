"""TRC, the marker tables of Motion Analysis and OpenSim: in."""

from facelab.files.markers.rows import Lines, Table, cells, read_table, stated
from facelab.files.markers.rules import checked, factor_of
from facelab.files.words import damaged


def read_trc(path, unit=None, fps=None, subject=None):
    """The markers of a TRC file (Motion Analysis Cortex, OpenSim), hidden ones as NaN.

    Parameters
    ----------
    path : str or Path
    unit : {"mm", "cm", "dm", "m", "in", "ft"}, optional
        Length unit; else `Units` of the file.
    fps : float, optional
        Frames a second; else `DataRate` of the file, which has to agree with its column of times.
    subject : str, optional
        Only the markers of this subject, where there are several.

    Returns
    -------
    MarkerSequence
        Millimetres, float32, axes as in the file: TRC has no rule for which is up. Empty cells,
        positions at exactly 0, 0, 0 and values that fill gaps (-9999, or -1 again and again) are
        hidden markers. `report` says what was left out, renamed and counted.

    Raises
    ------
    FileNotFoundError, ValueError
        Naming file and line, also where the file has other counts of frames or markers than its
        header.
    """
    path, fps = checked(path, "TRC file", unit, fps, subject)
    lines = Lines(path, "TRC file")
    return read_table(path, lines, _header(path, lines, unit), fps, subject)


def _header(path, lines, unit):
    rows = []
    for number, line in lines.rows(5):
        rows.append((number, line))
    if not rows or not rows[0][1].startswith("PathFileType"):
        raise ValueError(f"{path}: not a TRC file; it would start with PathFileType.")
    if len(rows) < 5:
        raise ValueError(f"{path}: ends in its header, after line {rows[-1][0]}.")
    keys, values = cells(rows[1][1], "\t"), cells(rows[2][1], "\t")
    about = dict(zip(keys, values, strict=False))
    for key in ("DataRate", "NumFrames", "NumMarkers", "Units"):
        if key not in about:
            raise damaged(f"{path}, line {rows[1][0]}: no {key} in the header")
    n_markers = stated(path, about["NumMarkers"], "NumMarkers", whole=True)
    number, line = rows[3]
    titles = cells(line, "\t")
    names = titles[2:]
    while names and not names[-1]:
        names.pop()
    names, empty = names[::3], [n for i, n in enumerate(names) if i % 3 and n]
    if titles[0].lower() not in ("frame#", "frame") or titles[1:2] != ["Time"] or empty:
        raise damaged(
            f"{path}, line {number}: should be Frame#, Time and a name above every third column"
        )
    if len(names) != n_markers:
        raise damaged(f"{path}, line {number}: {len(names)} names, but NumMarkers is {n_markers}")
    axes = [c for c in cells(rows[4][1], "\t") if c]
    wanted = [f"{axis}{i + 1}" for i in range(n_markers) for axis in "XYZ"]
    if [a.upper() for a in axes] != wanted:
        raise damaged(
            f"{path}, line {rows[4][0]}: should be X1, Y1, Z1 to X{n_markers}, Y{n_markers}, "
            f"Z{n_markers}"
        )
    columns = ["Frame#", "Time"] + [f"{name} {axis}" for name in names for axis in "XYZ"]
    return Table(
        columns, [(name, tuple(2 + 3 * i + a for a in range(3))) for i, name in enumerate(names)],
        "\t", 0, 1,
        rate=stated(path, about["DataRate"], "DataRate"),
        n_frames=stated(path, about["NumFrames"], "NumFrames", whole=True),
        factor=factor_of(path, about["Units"], unit, "Units"),
        report=["axes as in the file, which TRC leaves open"],
    )  # fmt: skip
