"""Hundreds of broken pose, clip and log files: what is read is what they say, or it is refused."""

import json
import math

import numpy as np
import pytest
from mutants import COUNT, PYTHON_WORDS, tally
from planted import corner_regions

from facelab.files.poses import load_clip, load_pose, read_log, save_clip, save_pose
from facelab.models.holistic import HolisticModel
from facelab.posing.clips import Clip
from facelab.posing.fingerprint import fingerprint
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.posing.state import state_to_dict


@pytest.fixture(scope="module")
def model():
    X = np.random.default_rng(2).normal(size=(20, 126))
    return HolisticModel(3).fit(X)


@pytest.fixture
def session(model):
    session = fresh(model)
    session.pull(3, session.vertices[3] + [2.0, 1, 1 / 3])
    session.mold(0, 2, 0.7)
    with session.group("two"):
        session.set(beta=0.3, gamma=0.04)
        session.set_pin(20, weight=2.5, locked=True)
    session.undo()
    session.redo()
    session.symmetric = True
    session.set(limit=2.0)
    session.hold(30)
    return session


def fresh(model):
    return PosingSession(model, corner_regions().mesh)


def literally(data):
    """The JSON of a file, and what no honest file has in it."""
    doubts = []

    def once(pairs):
        if len({key for key, _ in pairs}) < len(pairs):
            doubts.append("a key twice")
        return dict(pairs)

    def walk(value):
        if isinstance(value, dict | list):
            for each in value.values() if isinstance(value, dict) else value:
                walk(each)
        elif isinstance(value, float) and not math.isfinite(value):
            doubts.append("a number that is none")

    stored = json.loads(data.decode("utf-8-sig"), object_pairs_hook=once)
    walk(stored)
    return stored, ", ".join(doubts)


def same(a, b):
    """Whether two JSON values are the same in value and kind; 1 and 1.0 are, 1 and true are not."""
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return isinstance(b, list) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, bool) or not isinstance(a, int | float):
        return type(a) is type(b) and a == b
    return type(b) in (int, float) and a == b


def fits(stored, thing):
    """Whether a fingerprint is that of a thing, but for rounding."""
    own = fingerprint(thing)
    return (
        same([own["kind"], own["sizes"]], [stored["kind"], stored["sizes"]])
        and np.allclose(stored["probes"], own["probes"], rtol=0, atol=1e-5 * own["scale"])
        and np.isclose(stored["scale"], own["scale"], rtol=1e-5)
    )


def judged(read, data, name, tmp_path, contradicts):
    found = tally(read, data, name, tmp_path, COUNT, np.random.default_rng(7), contradicts)
    assert not found.wrong and not found.python, found
    assert found.counts["refused"] > COUNT / 3, found


def test_broken_pose_files_are_refused_or_read_as_they_are(session, model, tmp_path):
    save_pose(tmp_path / "pose.json", session, "smirk")

    def read(path):
        other = fresh(model)
        load_pose(path, other)
        return other

    def contradicts(other, data, _):
        stored, doubts = literally(data)
        found = state_to_dict(other.state)
        for part, thing in ((stored["mesh"], other.neutral), (stored["state"]["model"], model)):
            doubts += "" if fits(part, thing) else " another fingerprint"
        found["model"] = stored["state"]["model"]
        return doubts + ("" if same(found, stored["state"]) else " another state")

    judged(read, (tmp_path / "pose.json").read_bytes(), "a.json", tmp_path, contradicts)


def test_broken_clip_files_are_refused_or_read_as_they_are(session, model, tmp_path):
    clip = Clip(
        [0.5, 1.0, 3.0], np.random.default_rng(0).normal(size=(3, 3)), names=["a", "b", "c"]
    )
    save_clip(tmp_path / "clip.json", clip, session)

    def contradicts(clip, data, _):
        stored, doubts = literally(data)
        for part, thing in ((stored["mesh"], session.neutral), (stored["model"], model)):
            doubts += "" if fits(part, thing) else " another fingerprint"
        found = [clip.times.tolist(), clip.poses.tolist(), clip.easing, list(clip.names)]
        said = [stored[name] for name in ("times", "poses", "easing", "names")]
        return doubts + ("" if same(found, said) else " another clip")

    data = (tmp_path / "clip.json").read_bytes()
    judged(lambda path: load_clip(path, session), data, "b.json", tmp_path, contradicts)


def test_broken_logs_are_refused_or_done_as_they_are(session, model, tmp_path):
    save_pose(tmp_path / "pose.json", session)
    stored = json.loads((tmp_path / "pose.json").read_text())
    del stored["state"]  # so that it is the log that breaks

    def contradicts(log, data, _):
        stored, doubts = literally(data)
        if not same(log, stored["log"]):
            return doubts + " another log"
        other, rest = fresh(model), fresh(model).state
        try:
            replay(log, other)
        except ValueError as error:  # refused when it is done, in our words, leaving no trace
            in_python = PYTHON_WORDS.search(str(error)) or not str(error).startswith("log")
            traces = not other.state.same(rest) or other.log
            return doubts + str(error) * bool(in_python) + " traces" * bool(traces)
        said = [{k: v for k, v in entry.items() if k != "t"} for entry in stored["log"]]
        for entry in other.log:
            del entry["t"]
            if not any(same(entry, each) for each in said):
                doubts += f" {entry} was done"
        return doubts

    judged(read_log, json.dumps(stored).encode(), "c.json", tmp_path, contradicts)
