"""The expression lab without a browser: traits are set as the page would, buffers are read back."""

from datetime import datetime

import numpy as np
import pytest
from hand import drawn as on
from hand import let_go as release
from hand import move, press
from planted import bumps, quarters

from facelab.expression.session import ALPHAS, ExpressionSession
from facelab.files.obj import write_obj
from facelab.files.takes import read_weights
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.widgets.expression_lab import ExpressionLab

NAMES = ("AU1", "AU4", "AU12L", "AU12R", "AU26", "AU35")
TRUTH = {"AU4": 0.7, "AU12L": 0.4, "AU35": 0.9}


@pytest.fixture(scope="module")
def rig():
    mesh, labels = quarters()
    rng = np.random.default_rng(5)
    deltas = bumps(mesh, labels, rng, n_frames=len(NAMES), width=25.0).reshape(len(NAMES), -1, 3)
    return BlendshapeRig(mesh, NAMES, deltas)


@pytest.fixture
def posing(rig):
    mesh, labels = quarters()
    X = bumps(mesh, labels, np.random.default_rng(6))
    return PosingSession(RegionModel(Regions(labels, mesh), 6).fit(X), mesh)


@pytest.fixture
def lab(rig, posing, tmp_path):
    V = rig.shape(TRUTH)
    frames = np.stack([rig.neutral.vertices, V, V])
    take = MotionSequence(frames, 30, rig.neutral, np.array([True, True, False]))
    other = BlendshapeRig(rig.neutral, NAMES, -rig.deltas)
    session = ExpressionSession(rig, V, lam=0.3, origin="planted")
    sketches = {"posed": posing, "take": take, "turned": V @ np.diag([-1.0, 1, -1])}
    others = {"mirror": (other, [(rig.neutral, np.ones((rig.neutral.n_vertices, 3)))]), "bare": rig}
    return ExpressionLab(session, sketches, others, folder=tmp_path)


def shows_the_session(lab):
    # float32 of positions up to 100 mm
    np.testing.assert_allclose(on(lab.sketch_view), lab.session.sketch, atol=1e-3)
    # while the page draws a pull it takes the very best alpha, not the best of those looked at
    near = 0.01 if lab.sketch_view.dragging else 1e-3
    np.testing.assert_allclose(on(lab.view), lab.session.vertices, atol=near)
    np.testing.assert_allclose(lab.bars.weights, lab.session.weights, atol=1e-4)
    assert ALPHAS[lab.curve.place] == pytest.approx(lab.session.alpha, abs=0.051)
    assert lab.curve.best == lab.session.fit.best
    np.testing.assert_allclose(lab.curve.rms, lab.session.fit.rms, atol=1e-4)
    return True


def drag(lab, vertex, offset):
    press(lab.sketch_view, vertex)
    move(lab.sketch_view, offset)


def let_go(lab):
    release(lab.sketch_view)


def edit(lab, what, name, weight=0.0):
    """What the page sends after an edit of a unit's bar or a click on its buttons."""
    edits = [[what, NAMES.index(name), weight]]
    lab.bars._handle_custom_msg({"edits": edits, "asked": 0.5}, [])


def test_a_new_lab_shows_the_sketch_and_the_face_its_units_make(lab):
    assert shows_the_session(lab)
    assert lab.source.value == "planted" and "neutral" in lab.source.options
    assert lab.undo.disabled and lab.redo.disabled and lab._message.value == ""
    assert [u["name"] for u in lab.bars.units] == list(NAMES)
    assert all(len(u["picture"]) > 500 for u in lab.bars.units)


def test_moving_alpha_changes_face_and_weights_and_not_the_sketch(lab):
    before, sketch = on(lab.view), on(lab.sketch_view)
    lab.curve.place = 5
    assert lab.session.alpha == ALPHAS[5] and shows_the_session(lab)
    assert np.abs(on(lab.view) - before).max() > 0.1
    np.testing.assert_array_equal(on(lab.sketch_view), sketch)
    assert "α = 0.5: sum" in lab._sum.value
    lab.curve.place = 150
    assert "cannot be reached" in lab._status.value
    lab.best.click()
    np.testing.assert_allclose(on(lab.view), before, atol=1e-4)


def test_a_move_of_alpha_sends_little_beside_the_face(lab):
    sent = []
    for part in (lab.bars, lab.curve, lab._sum, lab._status, lab.sketch_view._hand):
        part.observe(lambda change, part=part: sent.append((part, change["name"])))
    lab.curve.place = 12
    lab.curve.place = 13
    assert {name for part, name in sent if part is lab.curve} == {"place"}
    assert {name for part, name in sent if part is lab.bars} == {"weights"}


@pytest.mark.parametrize("choice", ["free", "not negative", "0 to 1"])
def test_settings_of_the_page_are_those_of_the_session(lab, choice):
    slide_lam(lab, 0.05)
    lab.bounds.value = choice
    lab.criterion.value = "gcv"
    lab.clamp.value = True
    state = lab.session.state
    assert (state.lam, state.bounds, state.criterion, state.clamp) == (0.05, choice, "gcv", True)
    assert shows_the_session(lab)
    while not lab.undo.disabled:
        lab.undo.click()
    assert (lab.lam.values[0], lab.bounds.value, lab.criterion.value) == (0.3, "0 to 1", "e_rms")
    assert not lab.clamp.value and shows_the_session(lab)


def slide_lam(lab, value):
    lab.lam._handle_custom_msg({"item": "lam", "value": value, "asked": 1}, [])


def test_a_stroke_of_lambda_is_one_step_and_what_a_script_sets_is_no_edit(lab):
    for value in (0.2, 0.1, 0.07):
        slide_lam(lab, value)
    assert lab.session.n_undo == 1 and lab.lam.values == [0.07]
    lab.session.set(lam=20)
    assert lab.lam.values == [20.0] and lab.session.state.lam == 20
    lab.session.set(lam=0)
    assert lab.lam.values == [1e-3] and lab.session.state.lam == 0


def test_units_are_locked_excluded_set_by_hand_and_freed(lab):
    edit(lab, "lock", "AU4")
    assert lab.session.state.locked == {"AU4": pytest.approx(0.7, abs=0.05)}
    for weight in (0.1, 0.15, 0.2):
        edit(lab, "weight", "AU12R", weight)
    edit(lab, "settle", "AU12R")
    edit(lab, "exclude", "AU35")
    assert lab.bars.states == ["free", "locked", "free", "locked", "free", "excluded"]
    assert lab.bars.weights[3] == 0.2 and lab.bars.weights[5] == 0 and shows_the_session(lab)
    lab.undo.click()
    lab.undo.click()
    assert lab.bars.states == ["free", "locked", "free", "free", "free", "free"]
    edit(lab, "lock", "AU4")
    assert not lab.session.state.locked
    edit(lab, "exclude", "AU1")
    edit(lab, "exclude", "AU1")
    edit(lab, "exclude", "AU1")
    lab.free.click()
    assert lab.bars.states == ["free"] * 6 and shows_the_session(lab)


def test_edits_that_waited_for_the_kernel_count_one_by_one_and_the_page_is_told(lab, monkeypatch):
    told, refused = [], NAMES.index("AU35")
    monkeypatch.setattr(lab.bars, "send", told.append)
    k = NAMES.index("AU12R")
    edits = [["weight", k, 0.6], ["settle", k, 0], ["lock", NAMES.index("AU4"), 0]]
    lab.bars._handle_custom_msg({"edits": edits, "asked": 0.25}, [])
    locked = lab.session.state.locked
    assert set(locked) == {"AU12R", "AU4"} and locked["AU12R"] == 0.6
    lab.bars._handle_custom_msg({"edits": [["weight", refused, 7.0]], "asked": 0.5}, [])
    assert told == [{"heard": 0.25}, {"heard": 0.5}], "a page that is not told would wait for ever"


def test_pulling_the_sketch_pulls_single_vertices_and_the_units_follow_at_once(lab):
    sketch = lab.session.sketch
    drag(lab, 40, [0.0, 0, 8])
    assert lab.session.state.origin == "pulled by hand" and shows_the_session(lab)
    np.testing.assert_allclose(lab.session.sketch[40], sketch[40] + [0, 0, 8], atol=1e-9)
    move(lab.sketch_view, [0, 0, 10.0])
    let_go(lab)
    assert lab.source.value == "pulled by hand" and shows_the_session(lab)
    lab.undo.click()
    np.testing.assert_array_equal(lab.session.sketch, sketch)
    assert not lab.session.can_undo, "a pull is one step"


@pytest.mark.parametrize("how", ["alpha", "free", "locked"])
def test_what_the_page_draws_of_the_units_follows_the_settings(lab, how):
    if how == "alpha":
        lab.session.set(alpha=1.3)
    elif how == "free":
        lab.session.set(bounds="free")
    else:
        lab.session.lock("AU4", 0.2)
    before = on(lab.view)
    drag(lab, 40, [0.0, 0, 8])
    assert shows_the_session(lab) and np.abs(on(lab.view) - before).max() > 0.05
    let_go(lab)
    assert shows_the_session(lab)


def test_weights_that_are_no_plain_fit_are_left_to_the_kernel(lab):
    lab.clamp.value = True
    drag(lab, 40, [0.0, 0, 8])
    assert lab.session.follow(np.zeros((lab.view.mesh.n_vertices, 3, 3))) is None
    assert shows_the_session(lab)


def test_a_posed_sketch_is_pulled_by_its_model_and_undone_with_it(lab, posing):
    lab.source.value = "posed"
    drag(lab, 17, [0.0, 0, 6])
    np.testing.assert_allclose(lab.session.sketch, posing.vertices, atol=1e-9)
    assert shows_the_session(lab)
    let_go(lab)
    assert list(posing.pins) == [17] and lab.session.state.origin == "posed"
    assert np.abs(posing.vertices - posing.neutral.vertices).max() > 1
    lab.undo.click()
    np.testing.assert_allclose(posing.vertices, posing.neutral.vertices, atol=1e-9)
    np.testing.assert_allclose(lab.session.sketch, posing.vertices, atol=1e-9)
    lab.redo.click()
    assert list(posing.pins) == [17] and shows_the_session(lab)
    np.testing.assert_allclose(lab.session.sketch, posing.vertices, atol=1e-9)


@pytest.mark.parametrize("how", ["Escape", "z", "button"])
@pytest.mark.parametrize("source", ["planted", "posed"])
def test_a_pull_is_given_up_for_good_and_all_is_as_before(lab, posing, source, how):
    if source == "posed":
        lab.source.value = source
    drag(lab, 40, [0.0, 0, 4])
    let_go(lab)
    lab.session.set(alpha=1.5)
    lab.session.undo()
    before, line = lab.session.state, lab.session.history.line
    posed, steps = posing.state, posing.history.line
    drag(lab, 17, [0.0, 0, 8])
    assert lab.session.state is not before
    if how == "button":
        lab.undo.click()
    else:
        lab.keys._handle_custom_msg({"key": how}, [])
    assert not lab.sketch_view.dragging and shows_the_session(lab)
    move(lab.sketch_view, [0.0, 0, 9])
    let_go(lab)
    assert lab.session.state is before and lab.session.history.line == line
    assert posing.state is posed and posing.history.line == steps and not posing.dragging
    drag(lab, 17, [0.0, 0, 8])
    let_go(lab)
    assert lab.session.history.line == [*line[:-1], lab.session.state], "and it is pulled again"


def test_a_pull_that_fails_on_its_way_leaves_sketch_and_pose_as_they_were(lab, posing, monkeypatch):
    lab.source.value = "posed"
    before = lab.session.state
    drag(lab, 17, [0.0, 0, 3])
    monkeypatch.setattr(lab.session, "load", lambda *_, **__: 1 / 0)
    move(lab.sketch_view, [0.0, 0, 5])
    assert "ZeroDivisionError" in lab._message.value and lab.session.state is before
    np.testing.assert_array_equal(lab.session.sketch, posing.vertices)


def test_a_pose_pulled_elsewhere_is_followed(lab, posing):
    posing.drag(30, posing.neutral.vertices[30] + [0, 0, 5])
    assert lab.session.state.origin == "planted", "only once it is the sketch"
    lab.source.value = "posed"
    posing.drag(30, posing.neutral.vertices[30] + [0, 0, 9])
    posing.release()
    np.testing.assert_allclose(lab.session.sketch, posing.vertices, atol=1e-9)
    assert shows_the_session(lab)


def test_pulls_here_and_elsewhere_are_steps_of_their_own(lab, posing):
    lab.source.value = "posed"
    drag(lab, 17, [0.0, 0, 6])
    let_go(lab)
    pulled = lab.session.sketch
    posing.drag(30, posing.neutral.vertices[30] + [0, 0, 9])
    posing.release()
    assert np.abs(lab.session.sketch - pulled).max() > 0.1
    lab.undo.click()
    np.testing.assert_allclose(lab.session.sketch, pulled, atol=1e-9)
    np.testing.assert_allclose(posing.vertices, pulled, atol=1e-9)


def test_a_take_is_scrubbed_frame_by_frame(lab, rig):
    lab.source.value = "take"
    assert lab.frame.layout.display == "flex" and (lab.frame.value, lab.frame.max) == (0, 2)
    assert np.abs(lab.session.weights).max() < 1e-9
    lab.frame.value = 1
    np.testing.assert_allclose(lab.session.sketch, rig.shape(TRUTH), atol=1e-9)
    assert shows_the_session(lab)
    lab.frame.value = 2
    assert "frame 2 was lost" in lab._message.value and lab.frame.value == 1
    lab.undo.click()
    assert lab.source.value == "take" and lab.frame.value == 0
    lab.undo.click()
    assert lab.source.value == "planted" and lab.frame.layout.display == "none"


def test_a_mesh_file_is_taken_in_its_own_unit(lab, rig, tmp_path):
    V = rig.shape({"AU26": 0.5})
    write_obj(tmp_path / "mine.obj", rig.neutral.with_vertices(V / 10))
    file = {"name": "mine.obj", "content": (tmp_path / "mine.obj").read_bytes()}
    file |= {"type": "", "size": 1, "last_modified": datetime.now()}
    lab.upload.set_trait("value", (file,))
    assert "times the size" in lab._message.value and lab.source.value == "planted"
    lab.unit.value = "cm"
    lab.upload.set_trait("value", (file,))
    assert lab._message.value == "" and lab.source.value == "mine.obj"
    np.testing.assert_allclose(lab.session.sketch, V, atol=1e-6)


def test_a_sketch_that_is_not_aligned_is_refused_with_a_message_or_aligned(lab):
    before = lab.session.state
    lab.source.value = "turned"
    assert "sketch is not aligned" in lab._message.value and "as they were" in lab._message.value
    assert lab.session.state is before and lab.source.value == "planted"
    lab.align.value = True
    lab.source.value = "turned"
    assert lab._message.value == "" and lab.source.value == "turned"
    assert lab.session.rms < 0.1


def test_distance_is_shown_in_colours_with_a_key(lab):
    skin = lab.view._color.array.copy()
    lab.curve.place = 0
    lab.difference.value = True
    assert "mm" in lab._key.value
    n = lab.view.mesh.n_vertices
    colors = lab.view._color.array[:n]
    order = np.argsort(lab.session.distance)
    assert colors[order[0]].sum() > colors[order[-1]].sum() + 0.5, "near is light, far is dark"
    lab.best.click()
    assert not np.array_equal(lab.view._color.array[:n], colors)
    lab.difference.value = False
    np.testing.assert_array_equal(lab.view._color.array, skin)


def test_the_expression_is_shown_on_another_face_too(lab):
    lab.other.value = "mirror"
    neutral = lab.session.rig.neutral.vertices
    np.testing.assert_allclose(on(lab._other_view) - neutral, neutral - on(lab.view), atol=1e-3)
    lab.curve.place = 3
    np.testing.assert_allclose(on(lab._other_view) - neutral, neutral - on(lab.view), atol=1e-3)
    assert len(lab._views.children) == 3
    lab.other.value = "bare"
    np.testing.assert_allclose(on(lab._other_view), on(lab.view), atol=1e-3)
    lab.other.value = ""
    assert len(lab._views.children) == 2


def test_a_face_that_lacks_a_unit_in_use_is_refused_with_a_message_and_the_lab_goes_on(lab, rig):
    fewer = BlendshapeRig(rig.neutral, NAMES[:3], rig.deltas[:3])
    lab.others["fewer"] = fewer, ()
    lab.other.options = [*lab.other.options, "fewer"]
    lab.other.value = "bare"
    lab.other.value = "fewer"
    assert "face lacks AU35" in lab._message.value
    assert lab.other.value == "" and len(lab._views.children) == 2
    lab.curve.place = 5
    assert lab._message.value == "" and shows_the_session(lab)


def test_another_face_that_cannot_follow_any_more_is_told_in_a_note(lab, rig):
    lab.others["fewer"] = BlendshapeRig(rig.neutral, NAMES[:3], rig.deltas[:3]), ()
    lab.other.options = [*lab.other.options, "fewer"]
    for name in NAMES[3:]:
        edit(lab, "exclude", name)
    lab.other.value = "fewer"
    assert len(lab._views.children) == 3 and "fewer" not in lab._status.value
    before = on(lab._other_view)
    edit(lab, "weight", "AU35", 0.5)
    assert "fewer is as it was: face lacks AU35" in lab._status.value
    assert lab._message.value == "" and shows_the_session(lab)
    np.testing.assert_array_equal(on(lab._other_view), before)
    edit(lab, "exclude", "AU35")
    assert "fewer" not in lab._status.value


def test_controls_still_edit_after_an_error_while_they_were_set(lab, monkeypatch):
    def boom(*_):
        raise ValueError("a planted mishap")

    for broken in ("_pins", "_place_of"):
        monkeypatch.setattr(lab, broken, boom)
        with pytest.raises(ValueError, match="mishap"):
            lab.refresh()
        monkeypatch.undo()
        assert not lab.settling


def test_an_uploaded_file_is_known_by_its_name_alone(lab, rig, tmp_path):
    write_obj(tmp_path / "mine.obj", rig.neutral)
    file = {"name": "../there/mine.obj", "content": (tmp_path / "mine.obj").read_bytes()}
    file |= {"type": "", "size": 1, "last_modified": datetime.now()}
    lab.upload.set_trait("value", (file,))
    assert lab._message.value == "" and lab.source.value == "mine.obj"


def test_two_labs_on_one_session_stay_in_step(lab):
    other = ExpressionLab(lab.session)
    edit(lab, "exclude", "AU4")
    assert other.bars.states[1] == "excluded" and shows_the_session(other)
    slide_lam(other, 0.05)
    assert lab.lam.values == [0.05] and shows_the_session(lab)
    drag(lab, 40, [0.0, 0, 8])
    let_go(lab)
    assert other.source.value == "pulled by hand" and shows_the_session(other)
    lab.undo.click()
    assert shows_the_session(other) and not other.redo.disabled
    lab.session.set(bounds="free", alpha=3)
    for one in (lab, other):
        assert one.bounds.value == "free" and shows_the_session(one)


def test_a_lab_shows_what_it_does_itself_once(lab, monkeypatch):
    shown = []
    monkeypatch.setattr(lab, "refresh", lambda: shown.append("all"))
    monkeypatch.setattr(lab, "_show_answer", lambda: shown.append("answer"))
    lab.curve.place = 5
    lab.undo.click()
    assert shown == ["answer", "all"]


def test_results_are_saved_where_the_folder_is_and_what_is_lost_is_said(lab, tmp_path):
    lab.save.click()
    assert "expression.csv" in lab._result.value and "Download" in lab._result.value
    table = read_weights(tmp_path / "expression.csv")
    np.testing.assert_array_equal(table.weights[0], lab.session.weights)
    lab.file.value = "arkit.livelink.csv"
    lab.save.click()
    assert "AU35" in lab._result.value and lab._message.value == ""
    assert "again" not in lab._result.value
    lab.save.click()
    assert "again, over the one before" in lab._result.value
    lab.file.value = "nowhere/pose.json"
    lab.save.click()
    assert "leads out of the folder" in lab._message.value and not (tmp_path / "nowhere").exists()
    assert lab._result.value == "", "what was written before is not what failed now"
    assert "facelab-status" in lab.tabs.children[-2].children[1].value, "text that wraps"


def test_an_error_in_a_drag_is_shown_and_all_stays_as_it_was(lab, monkeypatch):
    def boom(*_, **__):
        raise ValueError("a planted <mishap>")

    before = lab.session.state
    monkeypatch.setattr(lab.session, "load", boom)
    drag(lab, 17, [0.0, 0, 5])
    assert "a planted &lt;mishap&gt;" in lab._message.value
    assert lab.session.state is before and not lab.sketch_view.dragging
    monkeypatch.undo()
    assert shows_the_session(lab)
    drag(lab, 17, [0.0, 0, 5])
    assert lab._message.value == ""


def test_a_lab_needs_a_session(rig):
    with pytest.raises(TypeError, match="session is a BlendshapeRig"):
        ExpressionLab(rig)
