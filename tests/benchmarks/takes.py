"""What reading and writing a take of ten minutes costs: 36,000 frames of 61 columns.

Seconds of the processor, and the peak of memory beyond what was there before.
"""

import sys
import tempfile
import time
import tracemalloc
from pathlib import Path

import numpy as np

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


def main():
    """Print the table."""
    take = a_take()
    size = 8e-6 * (take.weights.size + 9 * take.n_frames)
    print(f"{take}: {size:.0f} MB as arrays")
    print(f"{'':28s}{'file':>9s}{'time':>9s}{'memory':>10s}")
    with tempfile.TemporaryDirectory() as folder:
        for name, write, read in (
            ("Live Link", write_live_link_csv, read_live_link_csv),
            ("table", write_weights_csv, read_weights),
        ):
            path = Path(folder) / f"{name}.csv"
            seconds, peak = measured(lambda w=write, p=path: w(p, take))
            file = path.stat().st_size / 1e6
            print(f"{name + ', written':28s}{file:6.0f} MB{seconds:7.1f} s{peak:7.0f} MB")
            seconds, peak = measured(lambda r=read, p=path: r(p))
            print(f"{name + ', read':28s}{file:6.0f} MB{seconds:7.1f} s{peak:7.0f} MB")
    for name, settings in (("zero-phase", {}), ("One-Euro", {"cutoff": 1.0, "beta": 1.0})):
        seconds, peak = measured(lambda s=settings: take.smoothed(**s))
        print(f"{'smoothed, ' + name:37s}{seconds:7.1f} s{peak:7.0f} MB")


if __name__ == "__main__":
    sys.exit(main())
