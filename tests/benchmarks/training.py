"""What training costs: time beside scikit-learn's PCA, memory as the frames grow ten times.

The frames are the skin of the synthetic actor M1 in the full set at 15 frames a second, with noise
of 0.3 mm: all 8,820 vertices, and 397 of them. Times are of the same process, in turns, and of PCA
the best of its solvers counts. Memory is the peak of a process of its own, less what it
had before training; the frames come from a memory-mapped file.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import facelab
from facelab.models.store import load_model

SOLVERS = ("covariance_eigh", "randomized", "full")
N_REGIONS, N_COMPONENTS = 13, 30


def make(folder):
    """Write the frames, float32, and the cut of the face into 13 regions on 397 vertices."""
    capture = facelab.data.load_capture("M1")
    face, rng = capture.neutral, np.random.default_rng(0)
    samples, mesh = face.subsample(397)
    parts = []
    for take in capture.texts:
        frames = np.arange(0, capture.truth(take).weights.n_frames, 8)
        moved = capture.surface(take, frames) - face.vertices
        moved += rng.normal(scale=0.3, size=moved.shape)
        parts.append(moved.astype(np.float32))
    X = np.concatenate(parts)
    motion = facelab.MotionSequence(X[:, samples] + mesh.vertices, 15, mesh)
    regions = facelab.segment_face(motion, n_regions=N_REGIONS, random_state=0, progress=False)
    dense = regions.carried_to(face, samples)
    for cut in (regions, dense):  # a model of nothing carries its regions in a file
        n = cut.mesh.n_vertices
        empty = facelab.RegionModel.from_bases(cut, np.zeros(3 * n), np.ones((1, 3 * n)))
        empty.save(folder / f"{n}.npz")
    flat = X.reshape(len(X), -1)
    few = X[:, samples].reshape(len(X), -1)
    np.save(folder / "8820 1x.npy", flat)
    np.save(folder / "8820 0.1x.npy", flat[::10])
    np.save(folder / "397 1x.npy", few)
    stored = np.lib.format.open_memmap(
        folder / "397 10x.npy", "w+", np.float32, (10 * len(few), few.shape[1])
    )
    for i in range(10):
        stored[i * len(few) : (i + 1) * len(few)] = few


def in_turns(ways, repeats):
    """Best seconds of each way, of the clock and of the processors: dict of (2,) arrays.

    All are tried in turns: what else the machine does meets all alike.
    """
    times = {name: [] for name in ways}
    for _ in range(repeats):
        for name, work in ways.items():
            start = np.array([time.perf_counter(), time.process_time()])
            work()
            times[name].append([time.perf_counter(), time.process_time()] - start)
    return {name: np.min(spent, axis=0) for name, spent in times.items()}


def time_one(folder, n_vertices):
    """Print one row: holistic and region model, ours and scikit-learn's, in seconds."""
    from sklearn.decomposition import PCA

    X = np.load(folder / f"{n_vertices} 1x.npy")
    regions = load_model(folder / f"{n_vertices}.npz").regions
    columns = [(3 * m[:, None] + np.arange(3)).ravel() for m in regions.members]
    repeats = 9 if n_vertices == 397 else 1
    solvers = SOLVERS if n_vertices == 397 else SOLVERS[1:2]  # the others need minutes, or 6 GB

    def pca(solver, parts):
        for c in parts:
            PCA(N_COMPONENTS, svd_solver=solver, random_state=0).fit(X[:, c])

    model = facelab.RegionModel(regions, N_COMPONENTS)
    rows = {
        "holistic": (lambda: facelab.HolisticModel(N_COMPONENTS).fit(X), [slice(None)]),
        "13 regions": (lambda: model.fit(X), columns),
    }
    for name, (ours, cols) in rows.items():
        ways = {s: lambda s=s, cols=cols: pca(s, cols) for s in solvers} | {"ours": ours}
        times = in_turns(ways, repeats)
        mine = times.pop("ours")
        best = min(times, key=lambda s: times[s][0])
        by_clock, of_processors = mine / np.min(list(times.values()), axis=0)
        print(
            f"{X.shape[0]} frames of {n_vertices:4} vertices, {name:>10}: {mine[0]:6.2f} s, "
            f"scikit-learn ({best}) {times[best][0]:6.2f} s: {by_clock:.2f} of it, in seconds of "
            f"the processors {of_processors:.2f}",
            flush=True,
        )


def peak():
    """Largest memory of this process so far, megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def train_once(folder, n_vertices, growth, kind):
    """Train in this process; print seconds and the peak of memory as JSON."""
    regions = load_model(folder / f"{n_vertices}.npz").regions
    frames = np.load(folder / f"{n_vertices} {growth}.npy", mmap_mode="r")
    before, start = peak(), time.perf_counter()
    if kind == "blocks":
        facelab.RegionModel(regions, N_COMPONENTS).fit(frames)
    else:
        from sklearn.decomposition import PCA

        PCA(N_COMPONENTS, random_state=0).fit(np.array(frames))
    print(json.dumps([len(frames), time.perf_counter() - start, peak() - before]))


def child(*arguments):
    """The same file in a process of its own."""
    command = [sys.executable, __file__, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main():
    """Print a row for each size, then the growth of memory."""
    with tempfile.TemporaryDirectory() as name:
        child("make", name)
        for n_vertices in (397, 8820):
            print(child("time_one", name, n_vertices), end="", flush=True)
        for n_vertices, small, large in ((397, "1x", "10x"), (8820, "0.1x", "1x")):
            for kind in ("blocks", "sklearn"):
                rows = [
                    json.loads(child("train_once", name, n_vertices, g, kind))
                    for g in (small, large)
                ]
                text = "; ".join(f"{n} frames {s:.1f} s {mb:.0f} MB" for n, s, mb in rows)
                what = "13 regions in blocks" if kind == "blocks" else "scikit-learn's PCA"
                growth = rows[1][2] / max(
                    rows[0][2], 1.0
                )  # what fits into the room of imports is 0
                print(f"{n_vertices:4} vertices, {what}: {text}: x {growth:.2f}", flush=True)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main()
    else:
        job, folder, *rest = sys.argv[1:]
        rest = [int(r) if r.isdigit() else r for r in rest]
        {"make": make, "time_one": time_one, "train_once": train_once}[job](Path(folder), *rest)
