"""What many processes gain, what the engine costs, and 100 machines on paper (docs/scale.md).

Takes are those of the SYNTHETIC actor M1 (small set), registered as `facelab register` does, by
one and by two worker processes with one thread each. Frames for learning are made on the fly, so
that none is ever stored: 397 vertices, 13 regions. The last rows are computed from the first.
"""

import functools
import math
import os
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import facelab
from facelab import files, scale

N_TAKES, N_VERTICES, N_REGIONS, BLOCK = 8, 397, 13, 2000
SIZES = (10**4, 10**5, 10**6)
MACHINES, PROCESSES, WIRE = 100, 16, 1.25e9  # on paper: 16 processes each, 10 Gbit/s


def register(folder, i):
    """One take registered, as a job of `facelab register`: number of frames."""
    take = files.read_markers(Path(folder) / f"{i}.c3d")
    motion = facelab.register_sequence(_fit(folder), take, progress=False).motion()
    files.write_motion(Path(folder) / f"{i}.motion.npz", motion)
    return motion.n_frames


@functools.cache
def _fit(folder):
    take = files.read_markers(Path(folder) / "0.c3d")
    template = facelab.load_template()
    return facelab.fit_markers(template, *facelab.registration.rest_markers([take]))


def frames_made(seed, n_frames, n_features):
    """Frames of 40 modes and noise of 0.3 mm, as no file has them."""
    modes = np.random.default_rng(0).normal(size=(40, n_features)) / 4
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n_frames, 40)) @ modes
    return X + 0.3 * rng.standard_normal(X.shape, dtype=np.float32)


def in_blocks(n_frames, n_features):
    """So many frames as a Dask array of blocks that are made where they are needed."""
    import dask.array as da
    from dask import delayed

    return da.concatenate(
        [
            da.from_delayed(delayed(frames_made)(i, BLOCK, n_features), (BLOCK, n_features), float)
            for i in range(n_frames // BLOCK)
        ]
    )


def peak():
    """Largest memory of this process so far, megabytes; kilobytes are Linux's unit."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if _MAC else 2**10)


_MAC = sys.platform == "darwin"


def takes_row(folder, workers):
    """Seconds of all takes on so many workers, and the frames in them."""
    work = functools.partial(register, folder)
    with scale.cluster(workers=workers, memory=None) as client:
        client.run(_fit, folder)  # each worker reads the template and fits it once
        start = time.perf_counter()
        frames = [n for _, n, error in scale.each(work, range(N_TAKES), client) if not error]
        return time.perf_counter() - start, sum(frames)


def engine(folder):
    """Seconds: to start a cluster, a take here, the same through the engine, an empty task."""
    _fit(folder)
    here = _best(lambda: register(folder, 1))
    start = time.perf_counter()
    with scale.cluster(workers=1, memory=None) as client:
        up = time.perf_counter() - start
        client.run(_fit, folder)
        there = _best(lambda: list(scale.each(functools.partial(register, folder), [1], client)))
        start = time.perf_counter()
        list(scale.each(abs, range(200), client))
        return up, here, there, (time.perf_counter() - start) / 200


def _best(work, repeats=3):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def learning(sizes):
    """A row for each number of frames; gives seconds a block on one worker, and bytes of a sum."""
    _, mesh = facelab.load_template().subsample(N_VERTICES)
    near = facelab.segmentation.Affinity(mesh, np.eye(mesh.n_vertices), mesh.geodesics(), lam=0)
    regions = near.segment(N_REGIONS, random_state=0, progress=False)
    n_features, second = 3 * mesh.n_vertices, 0.0
    sent = 8 * sum((3 * len(m)) ** 2 for m in regions.members) + 8 * n_features
    for workers in (1, 2):
        with scale.cluster(workers=workers, memory=None) as client:
            for n_frames in sizes if workers == 2 else sizes[:1]:
                X = in_blocks(n_frames, n_features)
                start = time.perf_counter()
                facelab.RegionModel(regions, 30).fit(X)
                spent = time.perf_counter() - start
                most = max(client.run(peak).values())
                print(
                    f"learning {n_frames:8d} frames, {workers} workers: {spent:6.1f} s, "
                    f"{n_frames / spent:8.0f} frames/s, largest worker {most:4.0f} MB, "
                    f"this process {peak():4.0f} MB",
                    flush=True,
                )
            second = second or spent * BLOCK / n_frames
    print(f"a block of {BLOCK} frames: {second:.3f} s on one worker, its sum {sent / 1e6:.1f} MB")
    return second, sent


def on_paper(take, empty, block, sent):
    """What 100 machines would do, from the numbers above."""
    n = MACHINES * PROCESSES
    print(f"on paper: {MACHINES} machines of {PROCESSES} processes, {WIRE / 1e9:g} GB/s each")
    print(
        f"  takes: {3600 * n / take:,.0f} an hour if the scheduler keeps up; it hands out "
        f"{1 / empty:,.0f} tasks/s and is asked for {n / take:,.0f}"
    )
    for n_frames in (10**7, 10**8):
        blocks = math.ceil(n_frames / BLOCK)
        rounds = math.ceil(blocks / n)
        levels = max(1, math.ceil(math.log(blocks, 4)))
        tree = levels * 3 * sent / WIRE
        print(
            f"  learning {n_frames:.0e} frames: {rounds * block:.1f} s of sums, {tree:.2f} s in a "
            f"tree of {levels} levels, {blocks * sent / 1e9:.1f} GB over the wire in all, "
            f"{blocks * 4 / 3 * empty:.1f} s of the scheduler"
        )


def main():
    """Print all rows."""
    capture = facelab.data.load_capture("M1", size="small", progress=False)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the workers: one thread for each
    with tempfile.TemporaryDirectory() as folder:
        names = [name for part in capture.takes.values() for name in part]
        for i in range(N_TAKES):
            take = capture.markers(names[i % len(names)])
            files.write_c3d(Path(folder) / f"{i}.c3d", take)
        up, here, there, empty = engine(folder)
        print(
            f"one take: {here:.3f} s here, {there:.3f} s through the engine ({there - here:+.3f}); "
            f"cluster up in {up:.1f} s; an empty task {1e3 * empty:.1f} ms",
            flush=True,
        )
        spent = {}
        for workers in (1, 2):
            spent[workers], frames = takes_row(folder, workers)
            rate = 3600 * N_TAKES / spent[workers]
            print(
                f"{N_TAKES} takes, {workers} worker(s): {spent[workers]:6.2f} s, {rate:7.0f} takes "
                f"an hour, {frames / spent[workers]:7.0f} frames/s, efficiency "
                f"{spent[1] / spent[workers] / workers:.2f}",
                flush=True,
            )
    sizes = [int(float(s)) for s in os.environ.get("FACELAB_SIZES", "").split()] or SIZES
    block, sent = learning(sizes)
    on_paper(spent[1] / N_TAKES, empty, block, sent)


if __name__ == "__main__":
    main()
