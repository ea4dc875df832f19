"""Markers as the capture programs write them in text, from planted positions."""

import numpy as np


def _cell(value, digits=6, empty=""):
    return empty if np.isnan(value) else f"{value:.{digits}f}"


def motive(P, names, fps=120.0, unit="Meters", version="1.23", labels=True, extra=True):
    """OptiTrack Motive: P in millimetres, shape (n_frames, n_markers, 3)."""
    P = P * {"Meters": 1e-3, "Centimeters": 0.1, "Millimeters": 1}[unit]
    about = f"Format Version,{version},Take Name,Take 1,Take Notes,,Capture Frame Rate,{fps:.6f}"
    about += f",Export Frame Rate,{fps:.6f},Capture Start Time,2024-05-06 01.02.03 PM"
    about += f",Total Frames in Take,9999,Total Exported Frames,{len(P)},Rotation Type,Quaternion"
    about += f",Length Units,{unit},Coordinate Space,Global"
    bone = 4 * extra
    kinds = ["Rigid Body"] * bone + ["Marker"] * (3 * len(names))
    called = ["Head"] * bone + [n for n in names for _ in range(3)]
    what = ["Rotation"] * bone + ["Position"] * (3 * len(names))
    axes = list("XYZW") * extra + list("XYZ") * len(names)
    rows = [("Type", kinds), ("Name", [f'"{n}"' for n in called])]
    rows += [("ID", [f"{i:X}" for i in range(len(called))]), ("Parent", [""] * len(called))]
    if version < "1.24":
        rows.pop()
    lines = [about, ""] + [",".join(["", n if labels else "", *row]) for n, row in rows]
    lines += [",".join(["", "", *what]), ",".join(["Frame", "Time (Seconds)", *axes])]
    for i, row in enumerate(P.reshape(len(P), -1)):
        cells = ["0.0", "0.1", "0.2", "0.9"] * extra + [_cell(v) for v in row]
        lines.append(",".join([str(i), f"{i / fps:.6f}", *cells]))
    return "\r\n".join(lines) + "\r\n"


def nexus(P, names, fps=100, first=1, before="", after=""):
    """Vicon Nexus: names with their subject."""
    n = len(names)
    lines = ["Trajectories", str(fps), ",," + ",,,".join(names) + ",,"]
    lines += ["Frame,Sub Frame," + ",".join("XYZ" * n), ",," + ",".join(["mm"] * 3 * n)]
    for i, row in enumerate(P.reshape(len(P), -1), first):
        lines.append(",".join([str(i), "0", *(_cell(v, 3) for v in row)]))
    return before + "\n".join(lines) + "\n\n" + after


def qualisys(P, names, fps=120, titled=True, hidden="0.000", types=True):
    """Qualisys Track Manager: hidden markers are zeros, empty or NULL."""
    lines = [f"NO_OF_FRAMES\t{len(P)}", "NO_OF_CAMERAS\t8", f"NO_OF_MARKERS\t{len(names)}"]
    lines += [f"FREQUENCY\t{fps}", "NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--"]
    lines += ["TIME_STAMP\t2022-06-03, 10:47:36.627\t94247.45402301", "DATA_INCLUDED\t3D"]
    lines += ["\t".join(["MARKER_NAMES", *names])]
    lines += ["\t".join(["TRAJECTORY_TYPES", *["Measured"] * len(names)])] * types
    if titled:
        lines.append("\t".join(["Frame", "Time", *(f"{n} {a}" for n in names for a in "XYZ")]))
    for i, row in enumerate(P.reshape(len(P), -1)):
        before = [str(i + 1), f"{i / fps:.5f}"] if titled else []
        lines.append("\t".join([*before, *(_cell(v, 3, hidden) for v in row)]))
    return "\n".join(lines) + "\n"


def trc(P, names, fps=60.0, unit="mm", digits=5):
    """Motion Analysis Cortex and OpenSim."""
    n = len(names)
    lines = ["PathFileType\t4\t(X/Y/Z)\ttake.trc"]
    keys = "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame"
    lines += [(keys + " OrigNumFrames").replace(" ", "\t")]
    lines += [f"{fps:.2f}\t{fps:.2f}\t{len(P)}\t{n}\t{unit}\t{fps:.2f}\t1\t{len(P)}"]
    lines += ["Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t"]
    lines += ["\t\t" + "\t".join(f"{a}{i + 1}" for i in range(n) for a in "XYZ"), ""]
    for i, row in enumerate(P.reshape(len(P), -1)):
        lines.append("\t".join([str(i + 1), f"{i / fps:.3f}", *(_cell(v, digits) for v in row)]))
    return "\n".join(lines) + "\n"


def plain(P, names, mark=",", decimal=".", fps=100.0, timed=True, joint="_"):
    """A table that anyone writes: a header of names and axes."""
    head = ["time"] * timed + [f"{n}{joint}{a}" for n in names for a in "xyz"]
    lines = [mark.join(head)]
    for i, row in enumerate(P.reshape(len(P), -1)):
        cells = [f"{i / fps:.4f}"] * timed + [_cell(v) for v in row]
        lines.append(mark.join(cells).replace(".", decimal))
    return "\n".join(lines) + "\n"
