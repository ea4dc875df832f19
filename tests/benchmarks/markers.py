"""What reading and writing a capture of ten minutes costs: 72,000 frames of 150 markers.

Seconds of the processor, and what the peak of memory adds to what was there before, each in a
process of its own. The positions that are handed over take 130 MB of it. Tables of text are a tenth
as long. The ratio is to the seconds of reading the bare numbers: by ezc3d, or by numpy's `load` and
`genfromtxt` (cells are empty where a marker is hidden).
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import ezc3d
import numpy as np

from facelab.files import read_markers, write_c3d
from facelab.motion import MarkerSequence

N_MARKERS, N_FRAMES = 150, 72_000


def a_take(n_frames, random_state=0):
    """Markers over a face at 120 frames/s; a hundredth of them hidden."""
    rng = np.random.default_rng(random_state)
    rest = rng.uniform(-1, 1, size=(N_MARKERS, 3)) * [70, 100, 50]
    P = (rest + rng.normal(size=(n_frames, N_MARKERS, 3), scale=2.0)).astype(np.float32)
    P[rng.uniform(size=P.shape[:2]) < 0.01] = np.nan
    return MarkerSequence(P, [f"m{i}" for i in range(N_MARKERS)], 120)


def write_table(path, take, mark, head):
    """Rows of frame, time and coordinates of three decimals; nothing where a marker is hidden."""
    rows = np.arange(take.n_frames)
    values = np.column_stack([rows + 1, rows / take.fps, take.positions.reshape(len(rows), -1)])
    with open(path, "w") as out:
        out.write(head)
        for row in values:
            text = mark.join(f"{v:.3f}" for v in row[2:].tolist()).replace("nan", "")
            out.write(f"{row[0]:.0f}{mark}{row[1]:.6f}{mark}{text}\n")


def write_csv(path, take):
    columns = [f"{name}_{axis}" for name in take.names for axis in "xyz"]
    write_table(path, take, ",", ",".join(["frame", "time", *columns]) + "\n")


def write_trc(path, take):
    n = take.n_markers
    axes = "\t".join(f"{axis}{i + 1}" for i in range(n) for axis in "XYZ")
    head = "PathFileType\t4\t(X/Y/Z)\ttake.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n"
    head += f"{take.fps:g}\t{take.n_frames}\t{n}\tmm\n"
    names = "\t\t\t".join(take.names)
    write_table(path, take, "\t", f"{head}Frame#\tTime\t{names}\t\t\n\t\t{axes}\n\n")


def write_npz(path, take):
    np.savez(path, positions=take.positions, names=take.names, fps=take.fps)


CASES = {  # file: what writes it, how many frames
    "take.c3d": (write_c3d, N_FRAMES),
    "take.npz": (write_npz, N_FRAMES),
    "take.csv": (write_csv, N_FRAMES // 10),
    "take.trc": (write_trc, N_FRAMES // 10),
}


PLAIN = {  # what reads the bare numbers
    ".c3d": lambda path: ezc3d.c3d(str(path))["data"]["points"],
    ".npz": lambda path: np.load(path)["positions"],
    ".csv": lambda path: np.genfromtxt(path, delimiter=",", skip_header=1),
    ".trc": lambda path: np.genfromtxt(path, delimiter="\t", skip_header=6),
}


def peak_mb():
    """The largest memory of this process since the peak was reset (Linux)."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def measure(path):
    """In a process of its own: seconds of the processor and megabytes of one call."""
    take = read_markers(path) if len(sys.argv) > 2 else None
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew here
    before, start = peak_mb(), time.process_time()
    found = read_markers(path) if take is None else write_c3d(path, take)
    seconds = time.process_time() - start
    peak, start = peak_mb() - before, time.process_time()
    PLAIN[path.suffix](path)
    print(json.dumps([repr(found), seconds, peak, seconds / (time.process_time() - start)]))


def main():
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        print(f"{'':18s}{'MB':>7s}{'s':>7s}{'ratio':>7s}{'MB at the peak':>16s}")
        for name, (write, n_frames) in CASES.items():
            path = Path(folder) / name
            write(path, a_take(n_frames))
            size = path.stat().st_size / 1e6
            for what in ([], ["written"]) if name == "take.c3d" else ([],):
                run = [sys.executable, __file__, str(path), *what]
                done = subprocess.run(run, capture_output=True, text=True, check=True)
                found, seconds, peak, ratio = json.loads(done.stdout)
                label = f"{name}, {what[0] if what else 'read'}"
                spent = f"{seconds:7.1f}{ratio:7.2f}{peak:16.0f}"
                print(f"{label:18s}{size:7.0f}{spent}  {found}", flush=True)
            path.unlink()


if __name__ == "__main__":
    measure(Path(sys.argv[1])) if len(sys.argv) > 1 else main()
