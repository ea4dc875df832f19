"""A path may be a text or a Path: what is read, and what the report says, is the same."""

import json

import numpy as np
import pytest
from capture_tables import plain, trc
from recordings import code, live_link
from shapes import sphere_mesh
from writers import writers

import facelab
from facelab import files

P = 50 + np.random.default_rng(0).normal(scale=20, size=(9, 3, 3))
TEXTS = {
    "live.csv": live_link([code(k) for k in range(4)]),
    "table.csv": "time,jawOpen\n0,0.1\n0.033,0.2\n0.067,0.3\n",
    "rows.json": json.dumps([{"time": k / 30, "jawOpen": k / 9} for k in range(4)]),
    "lines.jsonl": "\n".join(json.dumps({"time": k / 30, "jawOpen": k / 9}) for k in range(4)),
    "take.trc": trc(P, "abc"),
    "plain.csv": plain(P, "abc"),
    "marks.txt": "tip 0\nchin 1\n",
}
CASES = [
    *((name, facelab.read_weights) for name in ("live.csv", "table.csv", "take.csv")),
    *((name, facelab.read_weights) for name in ("rows.json", "lines.jsonl", "weights.csv")),
    *((name, facelab.read_markers) for name in ("take.trc", "plain.csv", "markers.c3d")),
    *((name, facelab.read_mesh) for name in ("mesh.obj", "mesh.ply", "mesh.glb")),
    *((name, facelab.read_rig) for name in ("mesh.glb", "rig.npz")),
    ("marks.txt", lambda path: files.read_landmarks(path, sphere_mesh(1))),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    for name, write in writers(0).items():
        write(folder / name)
    for name, text in TEXTS.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(("name", "read"), CASES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_path_may_be_a_text(folder, name, read):
    found = [read(path) for path in (folder / name, str(folder / name))]
    assert str(found[0]) == str(found[1])
    reports = [str(getattr(each, "report", "")) for each in found]
    assert reports[0] == reports[1]
    if read in (facelab.read_weights, facelab.read_markers):
        assert name in reports[0]
