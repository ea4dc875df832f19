"""What reading and writing a take of ten minutes costs: 36,000 frames of 61 columns.

Seconds of the processor, these as a multiple of numpy's plain `loadtxt` and `savetxt` on the same
numbers or of scipy's filter there and back, and the peak of memory beyond what was there before.
"""

import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from facelab.files import read_live_link_csv, read_weights, write_live_link_csv, write_weights_csv
from facelab.motion import WeightSequence
from facelab.names import ANGLES, ARKIT


def a_take(minutes=10, fps=60, random_state=0):
    """Weights of ten digits, as a phone writes them."""
    rng = np.random.default_rng(random_state)
    n = 60 * minutes * fps
    angles = {name: rng.uniform(-1, 1, size=n).round(10) for name in ANGLES}
    return WeightSequence(rng.uniform(size=(n, 52)).round(10), ARKIT, fps, angles=angles)


def measured(work):
    """Seconds of a call, and megabytes at its peak, measured in a second call."""
    start = time.process_time()
    work()
    seconds = time.process_time() - start
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return seconds, peak / 1e6


def seconds_of(work):
    """Seconds of a call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def row(name, file, work, plain):
    """Print one line: ours, and how it stands to the plain way."""
    seconds, peak = measured(work)
    ratio = seconds / seconds_of(plain)
    print(f"{name:28s}{file:>9s}{seconds:7.1f} s{ratio:8.2f}{peak:7.0f} MB", flush=True)


def main():
    """Print the table."""
    take = a_take()
    X = np.column_stack([take.weights, *take.angles.values()])
    print(f"{take}: {X.nbytes / 1e6:.0f} MB as arrays")
    print(f"{'':28s}{'file':>9s}{'time':>9s}{'ratio':>8s}{'memory':>10s}")
    with tempfile.TemporaryDirectory() as folder:
        plain, numbers = Path(folder) / "plain.csv", dict(delimiter=",", fmt="%.10g")
        for name, write, read in (
            ("Live Link", write_live_link_csv, read_live_link_csv),
            ("table", write_weights_csv, read_weights),
        ):
            path = Path(folder) / f"{name}.csv"
            write(path, take)
            file = f"{path.stat().st_size / 1e6:.0f} MB"
            row(
                f"{name}, written",
                file,
                lambda w=write, p=path: w(p, take),
                lambda: np.savetxt(plain, X, **numbers),
            )
            row(
                f"{name}, read",
                file,
                lambda r=read, p=path: r(p),
                lambda: np.loadtxt(plain, delimiter=","),
            )
    sos = butter(2, 6.0, fs=take.fps, output="sos")
    for name, settings in (("zero-phase", {}), ("One-Euro", {"cutoff": 1.0, "beta": 1.0})):
        row(
            f"smoothed, {name}",
            "",
            lambda s=settings: take.smoothed(**s),
            lambda: sosfiltfilt(sos, take.weights, axis=0),
        )


if __name__ == "__main__":
    sys.exit(main())
