"""What a take of ten minutes costs: 72,000 frames of 160 markers, registered and made dense.

Each step in a process of its own: frames a second on one thread, and what the peak of memory adds
to what was there before, in MiB and as a ratio to the input. That is 138 MB, the displacements of
its markers are as much again.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from markers import peak_mb

import facelab
from facelab.motion import MarkerSequence
from facelab.registration import rest_markers

N_FRAMES, N_MARKERS = 72_000, 160


def long_take(n_frames):
    """The takes of the first actor again and again, some of it hidden or astray; and its fit."""
    capture = facelab.data.load_capture("M1", size="small", progress=False)
    takes = [capture.markers(name) for name in capture.texts]
    positions, names = rest_markers(takes)
    step = np.linspace(0, len(names) - 1, N_MARKERS).astype(int)
    kept = [names[i] for i in step]
    fit = facelab.fit_markers(facelab.load_template(8820), positions[step], kept)
    once = np.concatenate([t.select(kept).positions for t in takes]).astype(np.float32)
    P = np.empty((n_frames, N_MARKERS, 3), dtype=np.float32)
    for first in range(0, n_frames, len(once)):
        P[first : first + len(once)] = once[: n_frames - first]
    rng = np.random.default_rng(0)
    for frame in rng.integers(0, n_frames, n_frames // 100):  # some of it is wrong
        P[frame, rng.integers(N_MARKERS)] += rng.normal(size=3) * 15
    return fit, MarkerSequence(P, kept, 120)


def measure(step, n_frames):
    """Seconds and megabytes of one step."""
    fit, take = long_take(n_frames)
    fit.layout.carry  # noqa: B018 made once for all takes
    if step == "register":
        work = lambda: facelab.register_sequence(fit, take, progress=False)  # noqa: E731
    else:
        registration = facelab.register_sequence(fit, take, progress=False)
        if step == "dense":

            def work():
                for first in range(0, 8192, 256):
                    registration.positions(slice(first, first + 256))
        else:
            place = Path(tempfile.gettempdir()) / f"facelab-{os.getpid()}.npy"
            work = lambda: registration.positions(slice(0, 8192), out=place)  # noqa: E731
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew here
    before, start = peak_mb(), time.process_time()
    done = work()
    seconds, more = time.process_time() - start, peak_mb() - before
    if step == "file":
        del done
        place.unlink()
    print(json.dumps([seconds, more]))


def main():
    """Print a row for each step."""
    rows = {"register": N_FRAMES, "dense": 8192, "file": 8192}
    print(f"{N_FRAMES} frames of {N_MARKERS} markers, one thread; positions to 8,820 vertices")
    for step, n_frames in rows.items():
        command = [sys.executable, __file__, step, str(N_FRAMES)]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        seconds, more = json.loads(run.stdout.splitlines()[-1])
        print(
            f"{step:>9} {seconds:7.1f} s {n_frames / seconds:8.0f} frames/s {more:+8.0f} MiB, "
            f"{more * 2**20 / (12 * N_FRAMES * N_MARKERS):.2f} of the take"
        )


if __name__ == "__main__":
    if len(sys.argv) > 2:
        measure(sys.argv[1], int(sys.argv[2]))
    else:
        main()
