"""What a segmentation costs on 397 and on 8,820 vertices, against numpy and scikit-learn.

M1 is SYNTHETIC: its whole set at 15 frames a second with noise of 0.3 mm; on the dense face every
fourth frame of it (the correlation costs in proportion). Each way runs in a process of its own, so
that its peak of memory is its own.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from setup import milliseconds
from sklearn.cluster import SpectralClustering
from sklearn.metrics import adjusted_rand_score

import facelab
from facelab.motion import MotionSequence
from facelab.segmentation.segment import Affinity
from facelab.segmentation.similarity import affinity, motion_correlation

K, MOST, DENSE = 13, 30, 8820
CUT, GROWTH = f"{K} regions", "growth of k"


def motion_of(n_vertices):
    """M1's motion on so many vertices, and where they lie on the dense face."""
    capture = facelab.data.load_capture("M1")
    mesh, samples = capture.neutral, np.arange(DENSE)
    if n_vertices < DENSE:
        samples, mesh = mesh.subsample(n_vertices)
    frames = slice(None, None, 32 if n_vertices == DENSE else 8)  # of 120 a second
    positions = np.concatenate([capture.surface(t, frames, samples) for t in capture.texts])
    rng = np.random.default_rng(0)
    for frame in positions:  # in place: the dense face fills the memory soon enough
        frame += 0.3 * rng.standard_normal(frame.shape, dtype=np.float32)
    return MotionSequence(positions, 15, mesh), samples


def seconds(work, n_vertices):
    """Median of five calls; the dense face is timed once."""
    if n_vertices < DENSE:
        return milliseconds(work, 5) / 1e3
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def ours(n_vertices, folder):
    """Seconds of each step; affinity, labels and samples are left in files."""
    motion, samples = motion_of(n_vertices)
    print(motion)
    warnings.simplefilter("ignore")  # where the growth ends at its most: `why` says it
    found, spent = {}, {}

    def step(name, work):
        spent[name] = seconds(lambda: found.update({name: work()}), n_vertices)

    if n_vertices < DENSE:
        step("correlation", lambda: motion_correlation(motion.positions))
        step("distances", motion.mesh.geodesics)
        step("affinity", lambda: affinity(found["correlation"], found["distances"]))
        both = Affinity(motion.mesh, found["correlation"], found["distances"])
    else:
        both = Affinity.of(motion)
        step("all of the affinity", lambda: both.A)
    sp.save_npz(folder / "A.npz", sp.csr_array(both.A))

    step(CUT, lambda: both.segment(K, random_state=0, progress=False))
    print(found[CUT].why)
    step(GROWTH, lambda: both.segment(max_regions=MOST, random_state=0, progress=False))
    print(found[GROWTH].why)
    np.savez(
        folder / f"cut{n_vertices}.npz",
        labels=found[CUT].labels,
        samples=samples,
        last=found[GROWTH].tried[-1].k,
    )
    return spent


def theirs(n_vertices, folder):
    """The same by numpy and scikit-learn, from the affinity found here."""
    A, spent = sp.load_npz(folder / "A.npz"), {}
    if n_vertices < DENSE:
        A = A.toarray()

    def cut(k):
        model = SpectralClustering(k, affinity="precomputed", n_init=20, random_state=0)
        return model.fit(A).labels_

    mine = np.load(folder / f"cut{n_vertices}.npz")
    print(f"adjusted Rand index between the two: {adjusted_rand_score(mine['labels'], cut(K)):.2f}")
    spent[CUT] = seconds(lambda: cut(K), n_vertices)
    if n_vertices < DENSE:
        spent[GROWTH] = seconds(lambda: [cut(k) for k in range(2, mine["last"] + 1)], n_vertices)
        X = motion_of(n_vertices)[0].positions.astype(float)
        spent["correlation"] = seconds(
            lambda: sum(np.corrcoef(X[:, :, axis], rowvar=False) for axis in range(3)) / 3,
            n_vertices,
        )
    return spent


def measured(way, n_vertices, folder):
    """Seconds of each step of one way and its peak of memory in GB, from a process of its own."""
    subprocess.run([sys.executable, __file__, way, str(n_vertices), folder], check=True)
    return json.loads((Path(folder) / "spent.json").read_text())


def main():
    """A table for each number of vertices, and what it is worth to cut the dense face itself."""
    with tempfile.TemporaryDirectory() as folder:
        for n_vertices in (397, DENSE):
            mine, others = (measured(way, n_vertices, folder) for way in ("ours", "theirs"))
            print(f"{n_vertices} vertices      facelab (s)   numpy, scikit-learn (s)   ratio")
            for name, spent in mine.items():
                row = f"{name:17s} {spent:12.3f}"
                if name in others:
                    row += f" {others[name]:25.3f} {others[name] / spent:7.1f}"
                print(row)
        coarse, direct = (np.load(f"{folder}/cut{n}.npz") for n in (397, DENSE))
    dense = facelab.data.load_capture("M1").neutral
    start = time.perf_counter()
    carried = coarse["labels"][dense.nearest_of(coarse["samples"])]
    print(f"{K} regions of 397 vertices carried over: {time.perf_counter() - start:.3f} s")
    alike = adjusted_rand_score(direct["labels"], carried)
    print(f"adjusted Rand index against cutting {DENSE} itself: {alike:.2f}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        way, n, folder = sys.argv[1:]
        spent = {"ours": ours, "theirs": theirs}[way](int(n), Path(folder))
        spent["peak (GB)"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        (Path(folder) / "spent.json").write_text(json.dumps(spent))
    else:
        main()
