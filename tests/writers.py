"""Every writer of a user's file, killed and starved: the file before or the file after, whole.

`versions(folder)` writes each kind of file in two versions and keeps their bytes; `kills` and
`starvation` then write them again in processes that die or have no room.
"""

import multiprocessing
import os
import random
import signal
import time
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from planted import bumps, bumpy_rig, corner_regions

from facelab.files.gltf import write_glb
from facelab.files.markers import write_c3d
from facelab.files.obj import write_obj
from facelab.files.ply import write_ply
from facelab.files.poses import save_clip, save_pose
from facelab.files.rigs import write_rig
from facelab.files.takes import write_live_link_csv, write_weights_csv
from facelab.models.region import RegionModel
from facelab.motion import MarkerSequence, WeightSequence
from facelab.names import ARKIT
from facelab.posing.clips import Clip
from facelab.posing.session import PosingSession

try:
    import resource
except ImportError:  # not on this system: `starvation` cannot be tried
    resource = None


def writers(k):
    """Name of a file: what writes its version `k`."""
    rng = np.random.default_rng(k)
    regions = corner_regions()
    mesh = regions.mesh.with_vertices(regions.mesh.vertices + k)
    X = bumps(regions.mesh, regions.labels, rng) + rng.normal(scale=0.2, size=(80, 126))
    model = RegionModel(regions, 3).fit(X)
    session = PosingSession(model, regions.mesh)
    session.pull(3, session.vertices[3] + 1 + k)
    rig = bumpy_rig()
    markers = MarkerSequence(rng.normal(size=(200, 9, 3)), tuple("abcdefghi"), 60)
    take = WeightSequence(rng.random((400, 52)), ARKIT, 60)
    return {
        "mesh.obj": partial(write_obj, mesh=mesh),
        "mesh.ply": partial(write_ply, mesh=mesh),
        "mesh.glb": lambda p: write_glb(p, rig.neutral, rig.deltas + k, rig.names),
        "rig.npz": partial(write_rig, rig=replace(rig, deltas=rig.deltas + k)),
        "markers.c3d": partial(write_c3d, markers=markers),
        "take.csv": partial(write_live_link_csv, take=take),
        "weights.csv": partial(write_weights_csv, take=take),
        "model.npz": model.save,
        "pose.json": partial(save_pose, session=session),
        "clip.json": lambda p: save_clip(p, Clip([0.0], [session.coefficients]), session),
    }


class Written:
    """Both versions of each file in a folder, and what may stand there."""

    def __init__(self, folder):
        self.folder, self.whole = Path(folder), {}
        self.writers = [writers(0), writers(1)]
        for version in (1, 0):
            for name, write in self.writers[version].items():
                write(self.folder / name)
                self.whole.setdefault(name, []).insert(0, (self.folder / name).read_bytes())
        assert all(old != new for old, new in self.whole.values())

    def check(self, name):
        """Which version stands there; no other file may be seen."""
        found = (self.folder / name).read_bytes()
        assert found in self.whole[name], f"{name} is neither the old file nor the new one"
        seen = {p.name for p in self.folder.iterdir() if not p.name.startswith(".")}
        assert seen == set(self.whole), f"{name}: a killed save left {seen - set(self.whole)}"
        return self.whole[name].index(found)


def _again_and_again(written, name):
    k = 0
    while True:
        k = 1 - k
        written.writers[k][name](written.folder / name)


def kills(written, n, seed=0):
    """Kill `n` writers at random moments. Raises AssertionError at the first broken file."""
    rng, start, found = random.Random(seed), multiprocessing.get_context("fork"), Counter()
    for trial in range(n):
        name = list(written.whole)[trial % len(written.whole)]
        writer = start.Process(target=_again_and_again, args=(written, name), daemon=True)
        writer.start()
        time.sleep(rng.uniform(0.005, 0.05))
        writer.kill()
        writer.join()
        found["the new file" if written.check(name) else "the old file"] += 1
    left = [p for p in written.folder.iterdir() if p.name.startswith(".")]
    for p in left:
        os.utime(p, (time.time() - 7200,) * 2)
    for name in written.whole:
        written.writers[0][name](written.folder / name)
        written.check(name)
    still = [p.name for p in written.folder.iterdir() if p.name.startswith(".")]
    assert not still, f"left-overs of killed saves stay: {still}"
    return {**found, "left-overs swept": len(left)}


def _with_room_for(n_bytes, written, name, told):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))
    try:
        written.writers[1][name](written.folder / name)
        told.send("written")
    except OSError as error:
        told.send(str(error))


def starvation(written, n, seed=0):
    """Write `n` files where the disk is full after some bytes. Raises AssertionError at a fault."""
    rng, start, found = random.Random(seed), multiprocessing.get_context("fork"), Counter()
    for trial in range(n):
        name = list(written.whole)[trial % len(written.whole)]
        written.writers[0][name](written.folder / name)
        room = rng.randrange(len(written.whole[name][1]))
        here, there = multiprocessing.Pipe(duplex=False)
        writer = start.Process(target=_with_room_for, args=(room, written, name, there))
        writer.start()
        writer.join()
        said = here.recv() if here.poll() else "nothing"
        assert "the disk is full" in said and name in said, f"{name}, {room} bytes: {said}"
        assert written.check(name) == 0, f"{name} was replaced though the disk was full"
        assert not [p for p in written.folder.iterdir() if p.name.startswith(".")]
        found[name] += 1
    return dict(found)
