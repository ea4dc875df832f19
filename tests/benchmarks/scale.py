"""What many processes gain, what the engine costs, and 100 machines on paper (docs/scale.md).

Takes are those of the SYNTHETIC actor M1 (small set), registered as `facelab register` does, by
worker processes with one thread each. Frames for learning are made on the fly, so that none is ever
stored: 397 vertices, 13 regions. What is compared is measured in turns. Beside the seconds of the
clock stand those of the processors: other work on the machine does not count in them.

    python tests/benchmarks/scale.py                   # prints the rows
    python tests/benchmarks/scale.py page              # keeps them: docs/scale.json and scale.md
    python tests/benchmarks/scale.py page takes dense  # measures only these, and keeps the others
"""

import functools
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

N_TAKES, ROUNDS, N_VERTICES, N_REGIONS, BLOCK, MODES = 8, 3, 397, 13, 2000, 30
SIZES = (10**4, 10**5, 10**6)
MACHINES, PROCESSES, WIRE = 100, 16, 1.25e9  # on paper: 16 processes each, 10 Gbit/s
DOCS = Path(__file__).resolve().parents[2] / "docs"
BEGIN, END = "<!-- measured: written by tests/benchmarks/scale.py -->", "<!-- end of measured -->"


# --- work -----------------------------------------------------------------------------------------


def register(folder, i):
    """One take registered, as a job of `facelab register`: number of frames."""
    import facelab
    from facelab import files

    take = files.read_markers(Path(folder) / f"{i}.c3d")
    motion = facelab.register_sequence(_fit(folder), take, progress=False).motion()
    files.write_motion(Path(folder) / f"{i}.motion.npz", motion)
    return motion.n_frames


@functools.cache
def _fit(folder):
    import facelab
    from facelab import files

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


# --- watches --------------------------------------------------------------------------------------


def peak():
    """Largest memory of this process so far, megabytes; kilobytes are Linux's unit."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (2**20 if sys.platform == "darwin" else 2**10)


def timed(work, client=None):
    """What `work` gives, seconds of the clock, and of the processors (workers' and our own)."""

    def spent():
        others = sum(client.run(time.process_time).values()) if client else 0
        return time.process_time() + others

    cpu, start = spent(), time.perf_counter()
    found = work()
    wall = time.perf_counter() - start
    return found, wall, spent() - cpu


def median(rows):
    """The middle of each column, rounded to what is worth keeping."""
    return [float(f"{x:.3g}") for x in np.median(rows, axis=0)]


# --- measured -------------------------------------------------------------------------------------


def takes():
    """Takes on one and on two workers, and one take with the engine and without it, in turns."""
    import facelab
    from facelab import files, scale

    capture = facelab.data.load_capture("M1", size="small", progress=False)
    names = [name for part in capture.takes.values() for name in part]
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        for i in range(N_TAKES):
            take = capture.markers(names[i % len(names)])
            files.write_c3d(Path(folder) / f"{i}.c3d", take)
        work = functools.partial(register, folder)
        _fit(folder)
        clients, up = {}, []
        for n in (1, 2):
            start = time.perf_counter()
            clients[n] = stack.enter_context(scale.cluster(workers=n, memory=None))
            up.append(time.perf_counter() - start)
            clients[n].run(_fit, folder)  # each worker reads the template and fits it once

        def spread(client, items):
            return [n for _, n, error in scale.each(work, items, client) if not error]

        rows = {"here": [], "there": [], 1: [], 2: []}
        for _ in range(ROUNDS):
            rows["here"].append(timed(lambda: work(1))[1:])
            rows["there"].append(timed(lambda: spread(clients[1], [1]), clients[1])[1:])
            for n, client in clients.items():
                frames, *spent = timed(lambda c=client: spread(c, range(N_TAKES)), client)
                rows[n].append(spent)
        empty = timed(lambda: list(scale.each(abs, range(300), clients[1])))[1:]
    return {
        "n_takes": N_TAKES, "rounds": ROUNDS, "frames": sum(frames), "start": median([up])[0],
        "workers": {str(n): median(rows[n]) for n in (1, 2)},
        "one_here": median(rows["here"]), "one_there": median(rows["there"]),
        "empty": median([[x / 300 for x in empty]]),
    }  # fmt: skip


def learning():
    """Region models of more and more frames on two workers, and of the fewest on one."""
    import facelab
    from facelab import scale

    _, mesh = facelab.load_template().subsample(N_VERTICES)
    near = facelab.segmentation.Affinity(mesh, np.eye(mesh.n_vertices), mesh.geodesics(), lam=0)
    regions = near.segment(N_REGIONS, random_state=0, progress=False)
    n_features, rows = 3 * mesh.n_vertices, []
    sizes = [int(float(s)) for s in os.environ.get("FACELAB_SIZES", "").split()] or SIZES
    for n_frames, workers in [(sizes[0], 1), *((n, 2) for n in sizes)]:
        with scale.cluster(workers=workers, memory=None) as client:
            client.run(imported, "facelab")
            X = in_blocks(n_frames, n_features)
            model = facelab.RegionModel(regions, MODES)
            _, wall, cpu = timed(functools.partial(model.fit, X), client)
            most = max(client.run(peak).values())
        row = dict(frames=n_frames, workers=workers, wall=wall, cpu=cpu, worker=most, asks=peak())
        rows.append({k: v if isinstance(v, int) else float(f"{v:.3g}") for k, v in row.items()})
        print(rows[-1], file=sys.stderr, flush=True)
    sent = 8 * sum((3 * len(m)) ** 2 for m in regions.members) + 8 * n_features
    return {"rows": rows, "sum": sent, "block": BLOCK, "vertices": N_VERTICES}


def imported(name):
    """Import a module, so that its time is not in that of the work."""
    __import__(name)


def dense():
    """The dense face cut into regions: all of `segment`, and the process' peak of memory."""
    from segmentation import DENSE, K, motion_of

    from facelab.segmentation import Affinity

    motion, _ = motion_of(DENSE)
    before = peak()
    regions, wall, cpu = timed(
        lambda: Affinity.of(motion).segment(K, random_state=0, progress=False)
    )
    return {
        "vertices": DENSE, "frames": motion.n_frames, "regions": int(regions.n_regions),
        "wall": float(f"{wall:.3g}"), "cpu": float(f"{cpu:.3g}"),
        "peak": float(f"{peak():.3g}"), "before": float(f"{before:.3g}"),
    }  # fmt: skip


PARTS = {"takes": takes, "learning": learning, "dense": dense}


# --- what follows, and how it is shown ------------------------------------------------------------


def shown(found):
    """The tables of docs/scale.md, from what was measured: text in Markdown."""
    takes, learned, cut = found["takes"], found["learning"], found["dense"]
    (w1, c1), (w2, c2) = takes["workers"]["1"], takes["workers"]["2"]
    n, frames = takes["n_takes"], takes["frames"]
    (here, here_cpu), (there, there_cpu) = takes["one_here"], takes["one_there"]
    loads = ", ".join(f"{part} {found[part]['load']:g}" for part in PARTS)
    lines = [
        f"{found['cores']} cores, other work beside it: on average so many programs wanted to run "
        f"while each part was measured: {loads}. Seconds of the clock hold what the others took; "
        "those of the processors do not. What is compared was measured in turns, "
        f"{takes['rounds']} times; medians.",
        "",
        f"| {n} takes, {frames:,} frames | 1 worker | 2 workers |",
        "|---|---:|---:|",
        f"| seconds | {w1:.1f} | {w2:.1f} |",
        f"| seconds of the processors | {c1:.1f} | {c2:.1f} |",
        f"| takes an hour | {3600 * n / w1:,.0f} | {3600 * n / w2:,.0f} |",
        f"| frames a second | {frames / w1:,.0f} | {frames / w2:,.0f} |",
        f"| efficiency by the clock | 1 | {w1 / w2 / 2:.2f} |",
        f"| work done for the same takes | 1 | {c2 / c1:.2f} |",
        "",
        "Where more programs want to run than there are cores, the efficiency by the clock says "
        "what was left over for two workers, not what they can do; run it on a quiet machine for "
        "that. The last row says what the second adds in work.",
        "",
        "| one take | here | through the engine | ratio |",
        "|---|---:|---:|---:|",
        f"| seconds | {here:.2f} | {there:.2f} | {there / here:.2f} |",
        f"| seconds of the processors | {here_cpu:.2f} | {there_cpu:.2f} "
        f"| {there_cpu / here_cpu:.2f} |",
        "",
        f"A local worker is up in {takes['start']:.1f} s. An empty task takes "
        f"{1e3 * takes['empty'][0]:.1f} ms, {1e3 * takes['empty'][1]:.1f} ms of them of the "
        "processors.",
        "",
        f"| learning, {learned['vertices']} vertices | workers | seconds | of the processors "
        "| frames a second | largest worker | process that asks |",
        "|---|---:|---:|---:|---:|---:|---:|",
        *(
            f"| {r['frames']:,} frames | {r['workers']} | {r['wall']:.1f} | {r['cpu']:.1f} "
            f"| {r['frames'] / r['wall']:,.0f} | {r['worker']:.0f} MB | {r['asks']:.0f} MB |"
            for r in learned["rows"]
        ),
        "",
        "| the dense face cut, on one machine | seconds | of the processors | peak of memory |",
        "|---|---:|---:|---:|",
        f"| {cut['vertices']:,} vertices, {cut['frames']:,} frames, {cut['regions']} regions "
        f"| {cut['wall']:.1f} | {cut['cpu']:.1f} | {cut['peak'] / 1e3:.2f} GB, of which "
        f"{cut['before'] / 1e3:.2f} GB for reading the motion |",
        "",
        *on_paper(c1 / n, takes["empty"][1], learned),
    ]
    return "\n".join(lines)


def on_paper(take, empty, learned):
    """Lines: what 100 machines would do, from seconds of a processor measured here."""
    n, sent = MACHINES * PROCESSES, learned["sum"]
    largest = max(learned["rows"], key=lambda r: r["frames"])
    block = largest["cpu"] / largest["frames"] * learned["block"]
    lines = [
        f"On paper, for {MACHINES} machines of {PROCESSES} processes with {WIRE / 1e9:g} GB/s "
        f"each, from t = {take:.2f} s, b = {block:.2f} s for {learned['block']:,} frames, "
        f"S = {sent / 1e6:.1f} MB and e = {1e3 * empty:.2f} ms, seconds of a processor:",
        "",
        "| takes | |",
        "|---|---:|",
        f"| an hour that the processes can do | {3600 * n / take:,.0f} |",
        f"| an hour that one scheduler can hand out | {3600 / empty:,.0f} |",
        f"| processes that one scheduler keeps at work | {take / empty:,.0f} |",
        f"| processor hours for 1,000 takes | {1000 * take / 3600:.2f} |",
        "",
        "| learning | sums | tree above them | scheduler | over the wire, all together "
        "| processor hours |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for n_frames in (10**7, 10**8):
        blocks = math.ceil(n_frames / learned["block"])
        levels = max(1, math.ceil(math.log(blocks, 4)))
        lines.append(
            f"| {n_frames:,} frames | {math.ceil(blocks / n) * block:.1f} s "
            f"| {levels * 3 * sent / WIRE:.2f} s, {levels} levels | {blocks * 4 / 3 * empty:.1f} s "
            f"| {blocks * sent / 1e9:.1f} GB | {blocks * block / 3600:.2f} |"
        )
    return lines


def page(text, found):
    """The page with its measured part made anew."""
    before, rest = text.split(BEGIN)
    return f"{before}{BEGIN}\n\n{shown(found)}\n\n{END}{rest.split(END)[1]}"


# --- running it -----------------------------------------------------------------------------------


def measured(part):
    """One part, measured in a process of its own, so that its peak of memory is its own: dict."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the workers: one thread for each
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    command = [sys.executable, __file__, "measure", part]
    start = os.getloadavg()[0]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return found | {"load": round((start + os.getloadavg()[0]) / 2, 1)}


def main(parts=(), keep=False):
    """Measure, print the tables, and keep them where asked to."""
    kept = DOCS / "scale.json"
    found = json.loads(kept.read_text()) if parts and kept.exists() else {}
    found["cores"] = os.cpu_count()
    for part in parts or PARTS:
        found[part] = measured(part)
        if keep:
            kept.write_text(json.dumps(found, indent=1) + "\n")
    if set(found) >= set(PARTS):
        print(shown(found))
        if keep:
            text = (DOCS / "scale.md").read_text(encoding="utf-8")
            (DOCS / "scale.md").write_text(page(text, found), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["measure"]:
        print(json.dumps(PARTS[sys.argv[2]]()))
    else:
        main(sys.argv[2:], keep=sys.argv[1:2] == ["page"])
