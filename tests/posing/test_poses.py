import json

import numpy as np
import pytest
from planted import corner_regions
from shapes import grid_mesh

from facelab.files.gltf import write_clip_glb
from facelab.files.poses import load_clip, load_pose, read_log, save_clip, save_pose
from facelab.geometry.mesh import TriangleMesh
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.posing.clips import Clip, interpolate
from facelab.posing.fingerprint import differs, fingerprint
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig


def trained(seed=1, n_components=5):
    X = np.random.default_rng(seed).normal(size=(50, 126))
    return RegionModel(corner_regions(), n_components).fit(X)


class Clock:
    """Seconds that pass by one a look."""

    def __init__(self):
        self.now = 1e9

    def __call__(self):
        self.now += 1
        return self.now


@pytest.fixture
def model():
    return trained()


def fresh(model, **settings):
    return PosingSession(model, corner_regions().mesh, clock=Clock(), **settings)


@pytest.fixture
def session(model):
    return fresh(model)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "pose.json"


def pull(session, vertex, by):
    session.drag(vertex, session.vertices[vertex] + by)
    session.release()


def edited(session):
    """A pose with something of everything in it."""
    pull(session, 3, [2.0, 1, 1 / 3])
    session.mold(1, 2, 0.7)
    session.keep()
    session.mold(0, 0, -1.1)
    pull(session, 20, [0.0, 0.1, -3])
    session.set_pin(20, weight=2.5, locked=True)
    session.hold(30)
    session.set(beta=0.3, gamma=0.04)
    return session


def assert_same_pose(one, two):
    np.testing.assert_array_equal(one.vertices, two.vertices)
    assert one.pins.keys() == two.pins.keys()
    for v, t in one.pins.items():
        np.testing.assert_array_equal(t, two.pins[v])
    for name in ("pin_weights", "locked", "beta", "gamma", "limit"):
        assert getattr(one, name) == getattr(two, name)
    for region in range(4):
        np.testing.assert_array_equal(one.mold_values(region), two.mold_values(region))


# --- poses ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [None, 2.0])
def test_a_pose_comes_back_to_the_bit_in_another_session(session, path, limit):
    edited(session).set(limit=limit)
    save_pose(path, session, name="smirk")
    other = fresh(trained())  # as after a restart: the same training, another object
    load_pose(path, other)
    assert_same_pose(other, session)
    pull(session, 8, [1.0, 0, 0])
    pull(other, 8, [1.0, 0, 0])
    assert_same_pose(other, session)
    other.undo()
    other.undo()
    np.testing.assert_array_equal(other.vertices, other.neutral.vertices)
    assert json.loads(path.read_text())["name"] == "smirk"


def test_a_pose_file_is_small_and_plain_json(session, path):
    save_pose(path, edited(session))
    assert path.stat().st_size < 10_000
    assert json.loads(path.read_text())["format"] == "facelab-pose"


def test_a_pose_is_found_among_other_models(session, path, model):
    save_pose(path, edited(session))
    other = fresh(HolisticModel(4).fit(np.random.default_rng(3).normal(size=(9, 126))))
    load_pose(path, other, models={"region": trained()})
    np.testing.assert_array_equal(other.vertices, session.vertices)


def test_a_pose_of_a_rig_comes_back(rng, path):
    mesh = corner_regions().mesh
    rig = BlendshapeRig(mesh, ["a", "b", "c"], rng.normal(size=(3, 42, 3)))
    session, other = fresh(rig), fresh(rig)
    pull(session, 3, [1.0, 1, 1])
    save_pose(path, session)
    load_pose(path, other)
    np.testing.assert_array_equal(other.vertices, session.vertices)


def changed(path, **entries):
    stored = json.loads(path.read_text())
    path.write_text(json.dumps({**stored, **entries}))


def changed_state(path, **entries):
    changed(path, state={**json.loads(path.read_text())["state"], **entries})


PIN = {"vertex": 3, "displacement": [0, 0, 1], "weight": 1, "locked": False}
TWICE = [PIN, PIN]
SPOILED = {
    "empty": (lambda p: p.write_text(""), "is empty; export the pose file again"),
    "cut": (lambda p: p.write_text(p.read_text()[:-40]), "its JSON breaks off or is damaged"),
    "binary": (lambda p: p.write_bytes(b"\xff\xfe\0\1"), "byte 0 of its JSON is no UTF-8"),
    "a list": (lambda p: p.write_text("[1, 2]"), "its JSON is no object"),
    "another format": (lambda p: changed(p, format="facelab-clip"), "not a pose file"),
    "newer": (lambda p: changed(p, version=2), "version 2, newer than known here"),
    "no version": (
        lambda p: changed(p, version=None),
        "its entry 'version' is null, but must be a whole number",
    ),
    "no state": (
        lambda p: changed(p, state=None),
        "its entry 'state' is null, but must be an object",
    ),
    "no mesh": (lambda p: changed(p, mesh={}), "its entry 'kind' is missing"),
    "no beta": (
        lambda p: changed_state(p, beta=None),
        "its entry 'beta' is null, but must be a number",
    ),
    "gamma": (lambda p: changed_state(p, gamma=0), "gamma=0"),
    "limit": (lambda p: changed_state(p, limit=-1), "limit=-1"),
    "too short": (lambda p: changed_state(p, coefficients=[0.0]), r"coefficients has shape \(1,\)"),
    "text": (lambda p: changed_state(p, c_0=["x"] * 20), "c_0 is a list that makes"),
    "NaN": (lambda p: changed_state(p, molded=[float("nan")] * 20), "NaN"),
    "vertex": (lambda p: changed_state(p, pins=[{**PIN, "vertex": 42}]), "vertex=42"),
    "half a pin": (
        lambda p: changed_state(p, pins=[{"vertex": 3}]),
        "its entry 'displacement' is missing",
    ),
    "flat pin": (lambda p: changed_state(p, pins=[{**PIN, "displacement": [0]}]), "of pin 3 has"),
    "no weight": (lambda p: changed_state(p, pins=[{**PIN, "weight": 0}]), "weight of pin 3=0"),
    "text for a number": (lambda p: changed_state(p, gamma="0.25"), "gamma' is a text"),
    "truth for a number": (lambda p: changed_state(p, beta=True), "beta' is true or false"),
    "text in a pin": (
        lambda p: changed_state(p, pins=[{**PIN, "displacement": ["1", 0, 0]}]),
        "displacement of pin 3 is a list that makes no array of numbers",
    ),
    "text for truth": (
        lambda p: changed_state(p, pins=[{**PIN, "locked": "no"}]),
        "'locked' is a text, but must be true or false",
    ),
    "two pins on a vertex": (lambda p: changed_state(p, pins=TWICE), "vertex=3 is pinned twice"),
    "endless": (lambda p: changed_state(p, beta=10**400), "beyond what a float can hold"),
    "twice": (
        lambda p: p.write_text(p.read_text().replace('"beta":', '"beta": 1, "beta":')),
        "the key 'beta' is in one object twice",
    ),
    "no fingerprint": (
        lambda p: changed_state(p, model={**fingerprint(trained()), "probes": [1, 2, 3]}),
        r"probes has shape \(3,\)",
    ),
    "other scale": (
        lambda p: changed_state(p, model={**fingerprint(trained()), "scale": 1.0}),
        "another model: its numbers are others",
    ),
    "more": (lambda p: changed(p, more=1), "it has 'more', which is unknown"),
    "more in the state": (lambda p: changed_state(p, Beta=1), "it has 'Beta', which is unknown"),
    "more in a pin": (lambda p: changed_state(p, pins=[{**PIN, "w": 1}]), "it has 'w', which"),
    "nameless": (lambda p: changed(p, name=3), "'name' is a whole number, but must be a text"),
    "a version of truth": (lambda p: changed(p, version=True), "'version' is true or false"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_file_is_refused_by_name_and_nothing_changes(session, path, name):
    spoil, message = SPOILED[name]
    save_pose(path, edited(session))
    spoil(path)
    other = edited(fresh(session.model))
    other.undo()
    before, steps = other.state, (other.n_undo, other.n_redo)
    with pytest.raises(ValueError, match=message) as caught:
        load_pose(path, other)
    assert str(path) in str(caught.value)
    assert other.state is before and (other.n_undo, other.n_redo) == steps


def test_a_missing_file_is_called_missing(session, path):
    with pytest.raises(FileNotFoundError, match="there is no such pose file"):
        load_pose(path, session)


@pytest.mark.parametrize("call", [save_pose, load_pose], ids=["save", "load"])
def test_what_is_no_path_is_called_so(session, call):
    with pytest.raises(TypeError, match="path is a NoneType; give a str or a Path"):
        call(None, session)


def test_a_pose_with_a_limit_is_refused_by_a_model_that_knows_no_variances(path):
    regions, bases = corner_regions(), np.random.default_rng(0).normal(size=(6, 42, 3))
    given = fresh(RegionModel.from_bases(regions, np.zeros(126), bases))
    save_pose(path, given)
    changed_state(path, limit=3)
    with pytest.raises(ValueError, match="knows none") as caught:
        load_pose(path, given)
    assert str(path) in str(caught.value) and given.n_undo == 0
    assert given.set(beta=2.0) is None and given.beta == 2


@pytest.mark.parametrize("weight", [-0.5, 1.5])
def test_a_pose_of_a_rig_beyond_its_weights_is_refused(rng, path, weight):
    mesh = corner_regions().mesh
    session = fresh(BlendshapeRig(mesh, ["a", "b", "c"], rng.normal(size=(3, 42, 3))))
    save_pose(path, session)
    changed_state(path, coefficients=[0, weight, 0])
    with pytest.raises(ValueError, match="those of this model lie between 0 and 1"):
        load_pose(path, session)
    assert session.n_undo == 0


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (trained(seed=2), "another model: its numbers are others"),
        (trained(n_components=4), "another model: its sizes"),
        (HolisticModel(20).fit(np.random.default_rng(1).normal(size=(50, 126))), "another model"),
    ],
    ids=["other data", "fewer modes", "holistic"],
)
def test_a_pose_of_another_model_is_refused(session, path, other, message):
    save_pose(path, edited(session))
    stranger = fresh(other)
    with pytest.raises(ValueError, match=message):
        load_pose(path, stranger)
    assert stranger.n_undo == 0


def test_a_pose_of_another_face_is_refused(session, path):
    save_pose(path, edited(session))
    mesh = corner_regions().mesh
    moved = TriangleMesh(mesh.vertices + np.eye(42, 3), mesh.faces)
    with pytest.raises(ValueError, match="another face: its numbers are others"):
        load_pose(path, PosingSession(session.model, moved))


def test_a_model_trained_again_is_the_same_up_to_rounding(model, rng):
    again = trained()
    for B in again.components_:
        B *= 1 + 1e-12 * rng.normal(size=B.shape)
    rounded = fingerprint(again)
    np.testing.assert_allclose(rounded["probes"], fingerprint(model)["probes"], rtol=1e-9)
    again.components_[2][1] *= -1  # the same mode with the other sign poses another face
    off = np.subtract(fingerprint(again)["probes"], fingerprint(model)["probes"])
    assert np.abs(off).max() > 1e-3


def test_a_pose_that_cannot_be_written_leaves_the_old_file(session, path, monkeypatch):
    save_pose(path, session)
    before = path.read_bytes()
    pull(session, 3, [1.0, 0, 0])

    def full(*_args, **_kwargs):
        raise OSError("no space left")

    monkeypatch.setattr("pathlib.Path.write_text", full)
    with pytest.raises(OSError, match="no space"):
        save_pose(path, session)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["pose.json"]


# --- the log of edits -----------------------------------------------------------------------------


def all_edits(session, other):
    """One of each thing a person can do, undo and groups among them."""
    edited(session)
    session.symmetric = True
    pull(session, 8, [1.0, 0.3, 0])
    session.symmetric = False
    session.mirror_pin(30)
    session.undo()
    session.undo()
    session.redo()
    for value in (0.2, 0.4):
        with session.group("slider"):
            session.mold(2, 1, value)
    session.settle()
    with session.group():
        pull(session, 25, [0.0, 1, 0])
        session.set(beta=1.0)
    session.undo()
    session.redo()
    session.set_pin(20, locked=False)
    session.remove_pin(20)
    kept = session.state
    session.set(limit=2.0)
    pull(session, 11, [40.0, 0, 0])
    session.set(limit=None)
    session.use(other)
    session.reset_region(3)
    session.apply(np.arange(other.n_coefficients) / 7)
    session.mirror()
    session.drag(5, session.vertices[5] + 1 / 3)
    session.keep()  # lets go of the drag
    session.restore(kept)
    pull(session, 11, [0.0, 0.7, 0])
    return session


def test_replaying_the_log_gives_the_same_pose_exactly(session, model, path):
    other = trained(seed=5, n_components=3)
    all_edits(session, other)
    save_pose(path, session)
    again = replay(read_log(path), fresh(model), [other])
    assert_same_pose(again, session)
    assert (again.n_undo, again.n_redo) == (session.n_undo, session.n_redo)
    while session.undo():  # and so it is at every step back
        again.undo()
        np.testing.assert_array_equal(again.vertices, session.vertices)


def test_every_entry_of_the_log_has_its_time_and_they_ascend(session):
    edited(session)
    times = [entry["t"] for entry in session.log]
    assert times == sorted(times) and times[0] > 0
    assert [entry["do"] for entry in session.log] == [
        "pull", "mold", "keep", "mold", "pull", "set_pin", "set_pin", "set"
    ]  # fmt: skip


def test_what_changes_nothing_or_fails_is_not_logged(session):
    session.keep()
    session.set(beta=0.5)
    session.press(3)
    session.release()
    session.undo()
    session.drag(3, [0.0, 0, 0])
    session.cancel()
    with pytest.raises(ValueError):
        session.set(beta=-1)
    assert session.log == []


@pytest.mark.parametrize(
    "entry",
    [
        {"do": "fly"},
        {"do": "_step"},
        {"do": "pull"},
        {"do": "pull", "vertex": 99, "target": [0, 0, 0]},
        {"do": "remove_pin", "vertex": 3},
        {"do": "use", "model": {"kind": "rig"}},
        {},
    ],
)
def test_an_entry_that_cannot_be_done_is_named(session, entry):
    with pytest.raises(ValueError, match=r"log\[0\]"):
        replay([{"t": 0, **entry}], session)


FAILING_LOGS = {
    "outside a group": [{"do": "mold", "region": 0, "component": 0, "value": 1}, {"do": "fly"}],
    "inside a group": [
        {"do": "group", "key": None},
        {"do": "mold", "region": 0, "component": 0, "value": 1},
        {"do": "fly"},
        {"do": "end"},
    ],
    "symmetric": [{"do": "symmetric", "on": True}, {"do": "fly"}],
    "further back": [{"do": "undo"}, {"do": "keep"}, {"do": "fly"}],
    "never ended": [
        {"do": "keep"},
        {"do": "group", "key": None},
        {"do": "mold", "region": 0, "component": 0, "value": 1},
    ],
    "ended twice": [{"do": "group", "key": "a"}, {"do": "end"}, {"do": "end"}],
    "nested": [{"do": "group", "key": "a"}, {"do": "group", "key": "a"}],
}


@pytest.mark.parametrize("name", FAILING_LOGS)
def test_a_log_that_fails_leaves_the_session_as_it_was_and_usable(session, name):
    edited(session)
    session.undo()
    before = (session.state, session.n_undo, session.n_redo, session.symmetric, list(session.log))
    heard = []
    session.observe(heard.append)
    with pytest.raises(ValueError, match="log") as caught:
        replay(FAILING_LOGS[name], session)
    after = (session.state, session.n_undo, session.n_redo, session.symmetric, list(session.log))
    assert after == before and caught.value is not None  # while the error is still alive
    assert heard == [] or heard[-1] == "step"
    assert session.redo() and session.undo()  # no group is left open


@pytest.mark.parametrize(
    ("log", "error", "message"),
    [
        (
            [{"do": "symmetric"}],
            ValueError,
            r"log\[0\] \('symmetric'\) .* its entry 'on' is missing",
        ),
        ([{"do": "use"}], ValueError, "its entry 'model' is missing"),
        ([{}], ValueError, r"log\[0\] .* its entry 'do' is missing"),
        (["x"], ValueError, r"log\[0\] \('x'\) cannot be done: it is no object"),
        ([None], ValueError, "it is no object"),
        ([{"do": []}], ValueError, r"log\[0\] \(\[\]\) cannot be done"),
        ([{"do": "end"}], ValueError, "no group is open"),
        (FAILING_LOGS["never ended"], ValueError, "log ends inside a group"),
        (FAILING_LOGS["inside a group"], ValueError, r"log\[2\] \('fly'\) cannot be done: no such"),
        ("pose.json", TypeError, "log is a str; give a list of entries"),
        (None, TypeError, "log is a NoneType"),
    ],
)
def test_a_log_that_cannot_be_replayed_says_where_and_why(session, log, error, message):
    with pytest.raises(error, match=message):
        replay(log, session)


def test_a_session_can_replay_its_own_log(session):
    session.set(beta=2.0)
    session.set(beta=1.0)
    assert len(replay(session.log, session).log) == 4


def test_a_pose_is_not_saved_inside_a_group(session, path):
    with pytest.raises(RuntimeError, match="saving belong outside"), session.group():
        save_pose(path, session)
    assert not path.exists()


def test_the_log_shares_nothing_with_the_caller_and_is_json_whatever_was_given(session, path):
    rest = session.neutral.vertices
    target = rest[3] + [1.0, 0, 0]
    session.drag(3, target)
    target += 100
    session.release()
    given = [float(x) for x in rest[8] + 1]
    session.set_pin(8, given)
    given[0] = 99.0
    single = np.float32(rest[20]) + np.float32(1)
    session.set_pin(20, [*single], weight=np.float32(2), locked=np.bool_(True))
    session.set_pin(np.int64(21), tuple(single))
    session.set(gamma=np.float64(0.5), limit=np.float32(3))
    session.apply([np.float32(0.5)] * 20)
    while session.undo():
        pass
    while session.redo():
        pass
    save_pose(path, session)
    entries = [entry for entry in read_log(path) if entry["do"] in ("pull", "set_pin")]
    np.testing.assert_array_equal(entries[0]["target"], rest[3] + [1.0, 0, 0])
    np.testing.assert_array_equal(entries[1]["target"], rest[8] + 1)
    assert entries[2]["weight"] == 2 and entries[2]["locked"] is True
    assert_same_pose(replay(read_log(path), fresh(session.model)), session)


@pytest.mark.parametrize(
    ("log", "message"),
    [
        ({}, "'log' is an object, but must be a list"),
        ([3], r"log\[0\] \(3\) cannot be done: it is no object"),
        ([{"t": 0, "do": "fly"}], "no such edit"),
        ([{"t": "0", "do": "keep"}], "'t' is a text, but must be a number"),
        ([{"t": 0, "do": "keep", "twice": True}], "it has 'twice', which is unknown"),
        ([{"t": 0, "do": "mold", "region": 0}], "its entry 'component' is missing"),
        ([{"t": 0, "do": "group", "key": 3}], "'key' is a whole number, but must be a text or"),
        ([{"t": 0, "do": "group"}], "log ends inside a group"),
        ([{"t": 10**400, "do": "keep"}], "beyond what a float can hold"),
    ],
)
def test_a_log_that_is_none_is_refused_when_it_is_read(session, path, log, message):
    save_pose(path, session)
    changed(path, log=log)
    with pytest.raises(ValueError, match=message) as caught:
        read_log(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("probe", [float("nan"), float("inf")])
def test_a_fingerprint_that_is_not_finite_fits_no_model(session, probe):
    own = fingerprint(session.model)
    with pytest.raises(ValueError, match="probes holds 1 value"):
        differs({**own, "probes": [probe, *own["probes"][1:]]}, own)
    assert differs(own, own) == ""


def test_logs_of_older_files_are_read_still(session):
    old = [
        {"t": 1, "do": "group", "key": "slider"},
        {"t": 2, "do": "mold", "region": 0, "component": 0, "value": 1},
        {"t": 3, "do": "end"},
        {"t": 4, "do": "group", "key": "slider"},
        {"t": 5, "do": "mold", "region": 0, "component": 0, "value": 2},
        {"t": 6, "do": "end"},
        {"t": 7, "do": "seal"},
        {"t": 8, "do": "group", "key": "slider"},
        {"t": 9, "do": "mold", "region": 0, "component": 0, "value": 3},
        {"t": 10, "do": "end"},
    ]
    replay(old, session)
    assert session.n_undo == 2 and [entry["value"] for entry in session.log] == [2, 3]


# --- clips ----------------------------------------------------------------------------------------


@pytest.fixture
def clip(rng):
    return Clip([0.5, 1.0, 3.0], rng.normal(size=(3, 20)), names=["a", "b", "c"])


@pytest.mark.parametrize("easing", ["smooth", "linear"])
def test_a_clip_goes_through_its_keys_and_rests_at_its_ends(clip, easing):
    clip = Clip(clip.times, clip.poses, easing)
    for t, c in zip(clip.times, clip.poses, strict=True):
        np.testing.assert_allclose(clip.at(t), c, atol=1e-15)
    np.testing.assert_array_equal(clip.at(0), clip.poses[0])
    np.testing.assert_array_equal(clip.at(99), clip.poses[-1])
    assert clip.duration == 3


def test_between_keys_a_clip_stays_on_the_way_from_one_to_the_other(clip):
    for easing, share in (("linear", 0.25), ("smooth", 3 * 0.25**2 - 2 * 0.25**3)):
        c = Clip(clip.times, clip.poses, easing).at(1.5)
        np.testing.assert_allclose(
            c, (1 - share) * clip.poses[1] + share * clip.poses[2], atol=1e-15
        )
    shares = clip.shares(np.linspace(0, 4, 101))
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-15)
    assert shares.min() >= 0 and (np.count_nonzero(shares, axis=1) <= 2).all()


def test_a_smooth_clip_is_at_rest_in_every_key(clip):
    for t in clip.times:
        assert np.abs(clip.at(t + 1e-5) - clip.at(t - 1e-5)).max() < 1e-8


def test_samples_are_the_clip_at_a_steady_beat(clip):
    times, frames = clip.sample(fps=24)
    assert len(times) == 73 and times[-1] == 3
    np.testing.assert_allclose(frames[30], clip.at(30 / 24), atol=1e-15)


def test_keys_are_added_replaced_moved_and_taken_away(clip, rng):
    c = rng.normal(size=20)
    longer = clip.with_key(2.0, c, "new")
    assert longer.names == ("a", "b", "new", "c")
    np.testing.assert_array_equal(longer.at(2.0), c)
    np.testing.assert_array_equal(clip.with_key(1.0, c).at(1.0), c)
    moved = longer.moved_key(2, 9.0)
    assert moved.names == ("a", "b", "c", "new") and moved.duration == 9
    back = moved.without_key(3)
    np.testing.assert_array_equal(back.poses, clip.poses)
    assert back.names == clip.names


def test_a_clip_of_poses_in_any_order_has_them_in_time(session):
    start = session.state
    pull(session, 3, [1.0, 2, 0])
    clip = Clip.of([(2.0, session.state), (0.0, start)])
    np.testing.assert_array_equal(session.vertices_of(clip.at(2)), session.vertices)
    np.testing.assert_array_equal(session.vertices_of(clip.at(0)), session.neutral.vertices)
    np.testing.assert_array_equal(clip.with_key(3.0, start).at(3), clip.at(0))


def test_interpolation_between_two_poses_is_linear_in_every_vertex(session):
    a = session.state
    pull(session, 3, [1.0, 2, 0])
    b, rest = session.state, session.neutral.vertices
    third = session.vertices_of(interpolate(a, b, 1 / 3))
    np.testing.assert_allclose(third - rest, (session.vertices - rest) / 3, atol=1e-12)
    np.testing.assert_array_equal(interpolate(a, b, 0), a.coefficients)
    np.testing.assert_array_equal(interpolate(a, b, 1), b.coefficients)
    with pytest.raises(ValueError, match="share=2"):
        interpolate(a, b, 2)
    session.use(trained(seed=4))
    with pytest.raises(ValueError, match="two models"):
        interpolate(a, session.state, 0.5)
    with pytest.raises(ValueError, match="several models"):
        Clip.of([(0, a), (1, session.state)])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0], np.zeros((2, 3))), "must ascend"),
        (([1, 0], np.zeros((2, 3))), "must ascend"),
        (([-1, 0], np.zeros((2, 3))), "must ascend"),
        (([], np.zeros((0, 3))), "times is empty"),
        (([0, np.nan], np.zeros((2, 3))), "NaN"),
        (([0, 1], np.zeros((3, 3))), "poses has shape"),
        (([0, 1], [[0, np.inf], [0, 0]]), "infinite"),
        (([0], [[0.0]], "bouncy"), "easing='bouncy'"),
        (([0], [[0.0]], "smooth", ["a", "b"]), "names has 2 entries"),
    ],
)
def test_a_clip_that_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Clip(*arguments)


def test_keys_that_cannot_be_are_refused(clip):
    with pytest.raises(ValueError, match="index=3"):
        clip.without_key(3)
    with pytest.raises(ValueError, match="must ascend"):
        clip.moved_key(0, 1.0)
    with pytest.raises(ValueError, match="seconds=-1"):
        clip.with_key(-1, clip.poses[0])
    with pytest.raises(ValueError, match="coefficients has shape"):
        clip.with_key(1, np.zeros(3))
    with pytest.raises(ValueError, match="fps=0"):
        clip.sample(0)
    with pytest.raises(ValueError, match="more than memory should hold"):
        Clip([0, 1e6], np.zeros((2, 20))).sample(1000)


def test_a_clip_comes_back_from_its_file(session, clip, path):
    save_clip(path, clip, session)
    back = load_clip(path, session)
    np.testing.assert_array_equal(back.poses, clip.poses)
    np.testing.assert_array_equal(back.times, clip.times)
    assert (back.names, back.easing) == (clip.names, clip.easing)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"times": [0, 0, 1]}, "must ascend"),
        ({"poses": [[0.0]] * 3}, "clip has 1 coefficients in each pose, .* has 20"),
        ({"names": None, "version": 7}, "newer"),
        ({"easing": 4}, "'easing' is a whole number, but must be a text"),
        ({"times": [0, 1, 2e6]}, "must ascend from 0 or more to at most 1e.06"),
        ({"times": ["0", 1, 2]}, "times is a list that makes no array of numbers"),
        ({"poses": [[True] * 20] * 3}, "poses is a list that makes no array of numbers"),
        ({"poses": [[1e20] * 20] * 3}, "coefficients go up to 1e.20"),
        ({"names": ["a", "b", 3]}, "a name of a key is a int"),
        ({"names": ["a", "b"]}, "names has 2 entries for 3 keys"),
        ({"model": None}, "'model' is null, but must be an object"),
    ],
)
def test_a_spoiled_clip_is_refused(session, clip, path, entries, message):
    save_clip(path, clip, session)
    changed(path, **entries)
    with pytest.raises(ValueError, match=message):
        load_clip(path, session)


def test_a_clip_of_a_model_the_session_had_before_is_refused_too(session, clip, path):
    save_clip(path, clip, session)
    session.use(trained(seed=9))
    with pytest.raises(ValueError, match="another model: its numbers are others; use that model"):
        load_clip(path, session)
    session.undo()
    np.testing.assert_array_equal(load_clip(path, session).poses, clip.poses)


def test_a_clip_that_the_model_cannot_have_is_not_written(session, clip, path):
    session.use(trained(n_components=4))
    for write in (save_clip, write_clip_glb):
        with pytest.raises(
            ValueError, match=r"clip has 20 coefficients .* the session's model has"
        ):
            write(path, clip, session)
        with pytest.raises(TypeError, match="clip is a list, but must be of type Clip"):
            write(path, [1, 2], session)
    assert not path.exists()


def test_a_clip_is_not_changed_through_the_arrays_it_was_made_of(clip):
    times, poses = np.array([0.0, 1]), np.zeros((2, 3))
    made = Clip(times, poses)
    times += 5
    poses += 5
    np.testing.assert_array_equal(made.times, [0, 1])
    np.testing.assert_array_equal(made.poses, np.zeros((2, 3)))
    with pytest.raises(ValueError, match="read-only"):
        made.poses[0] = 1


def test_a_clip_beyond_the_weights_of_its_rig_is_refused(rng, path):
    mesh = corner_regions().mesh
    session = fresh(BlendshapeRig(mesh, ["a", "b", "c"], rng.normal(size=(3, 42, 3))))
    with pytest.raises(ValueError, match=r"from 0 to 1\.5, but those of the session's model lie"):
        save_clip(path, Clip([0.0], [[0, 1.5, 0]]), session)


def test_a_clip_of_another_model_is_refused(session, clip, path):
    save_clip(path, clip, session)
    with pytest.raises(ValueError, match="another model"):
        load_clip(path, fresh(trained(seed=9)))
    with pytest.raises(ValueError, match="another face"):
        load_clip(path, PosingSession(HolisticModel(1).fit(np.eye(9, 36)), grid_mesh(4, 3)))
