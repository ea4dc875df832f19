"""What stands beside the face in both labs: pins, steps, sliders, library, time, words."""

import re

import numpy as np
import pytest
from planted import bumps, quarters
from shown import shown

import facelab
from facelab.expression.session import ExpressionSession
from facelab.files.poses import load_library, load_pose, read_log, save_library
from facelab.files.takes import read_live_link_csv
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import face_props, followed, turn_eyes
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.widgets import ExpressionLab, PosingLab

UNITS = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp")


@pytest.fixture
def parts(rng):
    mesh, labels = quarters()
    mesh = TriangleMesh(mesh.vertices, mesh.faces, {"nose_tip": 17})
    X = bumps(mesh, labels, rng)
    rig = BlendshapeRig(mesh, UNITS, X.reshape(len(X), -1, 3)[:4])
    return RegionModel(Regions(labels, mesh), 6).fit(X), rig


@pytest.fixture
def lab(parts, tmp_path):
    model, rig = parts
    session = PosingSession(model, rig.neutral)
    return PosingLab(session, {"region": model, "rig": rig}, folder=tmp_path)


@pytest.fixture
def expression(parts, tmp_path):
    model, rig = parts
    posing = PosingSession(model, rig.neutral)
    session = ExpressionSession(rig, rig.shape({"jawOpen": 0.5}), origin="planted")
    return ExpressionLab(session, {"posed": posing}, folder=tmp_path)


def press(part, do, item, **more):
    part._handle_custom_msg({"do": do, "item": item, **more}, [])


def pull(session, vertex, by):
    session.pull(vertex, session.vertices[vertex] + by)


# --- beta and gamma -------------------------------------------------------------------------------


@pytest.mark.parametrize("name, model", [("beta", "region"), ("gamma", "region"), ("gamma", "rig")])
def test_the_page_is_told_the_faces_that_a_slider_goes_through(lab, monkeypatch, name, model):
    session, panel, slider, told = lab.session, lab.pose, getattr(lab.pose, name), []
    session.use(lab.models[model])
    pull(session, 17, [1.0, 0, 3])
    monkeypatch.setattr(type(lab.view._hand), "send", lambda _, *sent: told.append(sent))
    monkeypatch.setattr(type(lab.view._hand), "_tell", lambda _, *sent: told.append(sent))
    hold = {"slider": slider.model_id, "name": "first"}
    panel.pace._handle_custom_msg({"do": "hold", **hold}, [])
    ((message, kind, arrays),) = told
    assert (message["press"], message["slider"], kind) == ("first", slider.model_id, "course")
    shares, D = arrays["shares"], arrays["D"]
    assert message["n_changes"] == len(D) == shares.shape[1]
    drawn = session.vertices + np.tensordot(shares, D, axes=1)
    now, steps = session.vertices, session.n_undo
    ways = [np.abs(V - now).max() for V in drawn]
    assert max(ways) > 0.2
    for index in range(0, len(drawn), 4):
        slider.index = index
        assert np.abs(drawn[index] - session.vertices).max() < 0.01 * max(ways)
    assert session.n_undo == steps + 1, "a slide is one step"
    panel.pace._handle_custom_msg({"do": "let", **hold, "index": 3}, [])
    assert slider.index == 3 and lab.view._hand.settled == "first"
    assert getattr(session, name) == slider.options[3][1]


def test_what_changes_the_session_while_a_slider_is_held_is_shown(lab):
    slider, shown = lab.pose.gamma, lab.view._hand
    pull(lab.session, 17, [1.0, 0, 3])
    hold = {"slider": slider.model_id, "name": "first"}
    lab.pose.pace._handle_custom_msg({"do": "hold", **hold}, [])
    slider.index += 3
    assert shown.settled != "first", "the page draws that itself"
    pull(lab.session, 3, [1.0, 0, 3])
    assert shown.settled == "first"
    slider.index += 3
    lab.pose.pace._handle_custom_msg({"do": "let", **hold, "index": slider.index}, [])
    lab.pose.pace._handle_custom_msg({"do": "hold", **hold, "name": "second"}, [])
    lab.session.undo()
    assert shown.settled == "second"


def test_no_slide_is_drawn_over_a_frame_of_a_clip(keyed, monkeypatch):
    told, slider = [], keyed.pose.gamma
    monkeypatch.setattr(type(keyed.view._hand), "_tell", lambda _, *sent: told.append(sent))
    hold = {"slider": slider.model_id, "name": "first"}
    pull(keyed.session, 17, [1.0, 0, 3])
    keyed.clip.slider.value = 40
    keyed.pose.pace._handle_custom_msg({"do": "hold", **hold}, [])
    assert keyed.frame is not None and not told
    keyed.clip.stop.click()
    keyed.pose.pace._handle_custom_msg({"do": "hold", **hold}, [])
    assert told


# --- pins -----------------------------------------------------------------------------------------


def test_the_target_of_a_chosen_pin_is_typed_in_millimetres_and_undone(lab):
    panel, session = lab.pose.pin_list, lab.session
    pull(session, 17, [1.0, 2, 3])
    assert panel._editor.layout.display == "none"
    press(panel.list, "choose", 17)
    assert [f.value for f in panel.target] == [1.0, 2.0, 3.0]
    panel.target[1].value = 5.5
    went = session.pins[17] - session.neutral.vertices[17]
    np.testing.assert_allclose(went, [1, 5.5, 3], atol=1e-9)
    session.undo()
    assert panel.target[1].value == 2.0
    press(panel.list, "lock", 17)
    assert all(f.disabled for f in panel.target)


def test_a_pin_is_named_and_hidden_and_names_alike_are_numbered(lab):
    panel, session = lab.pose.pin_list, lab.session
    for vertex in (17, 90):
        pull(session, vertex, [0, 0, 2.0])
    press(panel.list, "choose", 90)
    panel.name.value = "nose tip"
    assert [row["name"] for row in panel.list.items] == ["nose tip", "nose tip (2)"]
    assert session.pin_names == {90: "nose tip"}
    press(panel.list, "hide", 90)
    assert session.hidden == {90}
    assert [pin[0] for pin in lab.view._hand.pins] == [17], "it holds, but is not drawn"
    panel.name.value = ""
    assert not session.pin_names and panel.list.items[1]["name"] == "vertex 90"


def test_the_expression_lab_lists_pins_of_pulls_by_hand_and_of_a_posed_sketch(expression):
    lab, session = expression, expression.session
    neutral = session.rig.neutral.vertices
    session.set_pin(17, session.sketch[17] + [0, 0, 4.0])
    (row,) = lab.pins.list.items
    assert row["name"] == "nose tip" and row["note"] == ""
    assert [button[0] for button in row["buttons"]] == ["hide", "remove"]
    press(lab.pins.list, "choose", 17)
    lab.pins.target[2].value = 1.0
    np.testing.assert_allclose(
        session.sketch[17] - neutral[17], [*(session.sketch[17] - neutral[17])[:2], 1.0]
    )
    press(lab.pins.list, "remove", 17)
    assert lab.pins.list.items == [] and lab.sketch_view._hand.pins == []
    lab.source.value = "posed"
    posing = lab.sketches["posed"]
    pull(posing, 90, [0, 0, 5.0])
    assert [row["id"] for row in lab.pins.list.items] == [90]
    press(lab.pins.list, "lock", 90)
    assert posing.locked == {90}


# --- steps ----------------------------------------------------------------------------------------


def test_steps_are_told_in_words_and_a_click_goes_to_one(lab):
    session = lab.session
    pull(session, 17, [0, 0, 3.0])
    posed = session.vertices
    session.set(beta=0.25)
    session.set_pin(17, locked=True)
    session.set_pin(17, locked=False)
    session.remove_pin(17)
    session.reset()
    session.use(lab.models["rig"])
    session.slide(0, 1, 0.5)
    said = [row["name"] for row in reversed(lab.steps.list.items)]
    assert said[:5] == [
        *("the start", "pull nose tip", "Regions agree β 0.25", "lock nose tip", "unlock nose tip"),
    ]
    assert said[-2:] == ["model: rig", "slider"]
    press(lab.steps.list, "choose", 1)
    np.testing.assert_allclose(session.vertices, posed, atol=1e-12)
    assert session.n_undo == 1 and lab.steps.list.items[0]["note"] == "undone"
    assert lab.steps.list.items[lab.steps.list.chosen]["id"] == 1


def test_the_steps_of_the_expression_lab_take_the_posed_sketch_along(expression):
    lab, session = expression, expression.session
    lab.source.value = "posed"
    posing = lab.sketches["posed"]
    for vertex in (17, 90):
        pull(posing, vertex, [0, 0, 5.0])
    session.set(alpha=1.5)
    session.exclude("jawOpen")
    session.lock("browInnerUp", 0.5)
    session.free()
    said = [row["name"] for row in reversed(lab.steps.list.items)]
    assert said[1:] == [
        *("sketch: posed", "sketch: posed", "sketch: posed", "α 1.5", "leave out jawOpen"),
        *("browInnerUp held at 0.50", "free all"),
    ]
    press(lab.steps.list, "choose", 2)
    assert list(posing.pins) == [17]
    np.testing.assert_allclose(session.sketch, posing.vertices, atol=1e-9)
    press(lab.steps.list, "choose", 3)
    assert list(posing.pins) == [17, 90]


# --- sliders --------------------------------------------------------------------------------------


def test_sliders_of_a_rig_show_what_pins_made_and_are_sorted_by_what_they_do(lab, parts):
    _, rig = parts
    lab.session.use(rig)
    face = rig.shape({"mouthSmileRight": 0.8})
    for vertex in range(5, 110, 15):
        lab.session.pull(vertex, face[vertex])
    shown = lab.shape.sliders.values
    assert shown == list(lab.session.coefficients)
    assert int(np.argmax(shown)) == 2
    lab.shape.sorted.value = True
    assert lab.shape.sliders.items[0]["name"] == "mouthSmileRight"
    assert lab.shape.sliders.values[0] == max(shown)


def test_a_component_says_what_it_moves_and_how_much(lab, monkeypatch):
    monkeypatch.setattr(lab.places, "motion", lambda x, literal: f"moved {np.abs(x).max() > 0}")
    lab.shape._said = {}
    lab.refresh()
    said = [item["name"] for item in lab.shape.sliders.items]
    shares = [float(re.match(r"moved True, ([\d.]+)\u00a0%", text)[1]) for text in said]
    assert shares == sorted(shares, reverse=True) and 97 <= sum(shares) <= 103
    assert "mm for one standard deviation" in lab.shape.sliders.items[0]["tip"]


def test_names_of_components_tell_them_apart(lab, monkeypatch):
    shares = np.array([0.9, 0.08, 0.0126, 0.0034, 0.0033, 0.000024])
    monkeypatch.setattr(lab.session, "shares", lambda _: shares)
    monkeypatch.setattr(lab.places, "motion", lambda *_, **__: "lip up")
    lab.shape._said = {}
    said = [name.replace("\u00a0", " ") for name, _ in lab.shape.slider_names(0)]
    assert said == [
        *("lip up, 90 %", "lip up, 8 %", "lip up, 1 %", "lip up, 0.3 %", "lip up, 0.3 % (2)"),
        "lip up, 0.002 %",
    ]


def test_what_a_unit_of_a_rig_moves_is_said_literally(lab, expression, monkeypatch):
    said = lambda x, literal=False: "chin up" if literal else "jaw shut"  # noqa: E731
    for each in (lab, expression):
        monkeypatch.setattr(each.places, "motion", said)
    lab.shape._said = {}
    assert "jaw shut" in lab.shape.slider_names(0)[0][1]
    lab.session.use(lab.models["rig"])
    assert "jawOpen: chin up" in lab.shape.sliders.items[0]["tip"]
    expression._build_parts()
    assert "jawOpen: chin up" in expression.bars.units[0]["tip"]


@pytest.fixture(scope="module")
def seeing():
    """A lab of a face with eyes."""
    face = facelab.load_template(4375)
    X = np.random.default_rng(0).normal(size=(4, 3 * face.n_vertices))
    session = PosingSession(HolisticModel(2).fit(X), face)
    return PosingLab(session, props=face_props(face))


def slide(part, item, value):
    part._handle_custom_msg({"item": item, "value": value, "asked": 1}, [])


def test_two_sliders_turn_both_eyes_in_view_picture_library_and_clip(seeing, tmp_path):
    lab, session = seeing, seeing.session
    eye, still = lab.view._props.meshes[0], lab.picture()
    drawn = eye.geometry.attributes["position"]
    ahead = drawn.array
    slide(lab.shape.gaze, "left", 10)
    slide(lab.shape.gaze, "left", 20)
    slide(lab.shape.gaze, "up", -10)
    assert session.state.gaze == (20, -10) and lab.shape.gaze.values == [20, -10]
    assert session.n_undo == 2, "each slider is a step"
    wanted = followed(turn_eyes(lab.props, (20, -10))[0], session.vertices)
    np.testing.assert_allclose(drawn.array, wanted, atol=1e-4)
    assert [item["name"] for item in lab.steps.list.items] == ["eyes", "eyes", "the start"]
    assert lab.picture() != still
    lab.strip.path = tmp_path / "poses.library.json"
    lab.strip.add("aside")
    assert len({item["picture"] for item in lab.strip.strip.items}) == 2
    lab.clip._add_key()
    session.reset()
    np.testing.assert_array_equal(drawn.array, ahead)
    lab.clip.slider.value = 50
    lab.clip.stop.click()
    lab.clip._add_key()
    lab.clip.slider.value = 25
    assert lab.gaze == pytest.approx((10, -5))
    halfway = followed(turn_eyes(lab.props, (10, -5))[0], session.vertices)
    np.testing.assert_allclose(drawn.array, halfway, atol=1e-4)
    lab.clip._pose_frame()
    assert session.state.gaze == pytest.approx((10, -5))
    lab.strip._react("choose", "aside")
    assert session.state.gaze == (20, -10)


def test_a_gaze_slider_is_out_of_sight_where_there_are_no_eyes(lab, seeing):
    assert lab.shape.gaze.layout.display == "none"
    assert seeing.shape.gaze.layout.display is None


def test_a_pin_can_be_set_without_the_mouse(lab):
    place, pins = lab.pose.pin_list.place, lab.pose.pin_list
    place.value = dict(place.options)["nose tip"]
    assert lab.session.pins.keys() == {17} == {pins.chosen} and place.index == 0
    pins.target[2].value = 3.0
    np.testing.assert_allclose(lab.session.pins[17] - lab.mesh.vertices[17], [0, 0, 3])


def test_half_a_face_is_mirrored_by_button(lab):
    pull(lab.session, 17, [1.0, 0, 4])
    lab._buttons["R → L"].click()
    x = lab.session.vertices - lab.session.neutral.vertices
    assert "bake" in lab._buttons["Bake pins"].tooltip.lower() or lab._message.value == ""
    assert lab.steps.list.items[0]["name"] == "R → L" and np.abs(x).max() > 0.1
    partners = lab.session.partners
    off = np.linalg.norm(x - x[partners] * [-1, 1, 1], axis=1).max()
    assert f"up to {off:.1f} mm from the mirror image" in lab._status.value
    lab._buttons["Swap sides"].click()
    y = lab.session.vertices - lab.session.neutral.vertices
    off = np.linalg.norm(y - x[partners] * [-1, 1, 1], axis=1).max()
    assert f"up to {off:.1f} mm from the mirror image" in lab._status.value
    lab.reset.click()
    lab._buttons["Swap sides"].click()
    assert "mirror image" not in lab._status.value


def test_steps_tell_apart_what_leads_to_states_alike(lab):
    session, steps = lab.session, lab.steps
    pull(session, 17, [0, 0, 3.0])
    for edit, said in (
        (lambda: session.set_pin(17, session.pins[17] + 1), "target of nose tip"),
        (lambda: session.hold(90), "hold vertex 90"),
        (lambda: session.set_pin(17, hidden=True), "hide nose tip"),
        (lambda: session.set_pin(17, hidden=False), "show nose tip"),
        (lambda: session.set_pin(17, hidden=True), "hide nose tip"),
        (lambda: session.set_pin(17, name="tip"), "name nose tip"),
        (lambda: session.set_pin(17, weight=10), "weight of nose tip"),
        (lambda: session.set_pin(11, locked=True), "lock vertex 11"),
        (session.mirror, "swap sides"),
        (lambda: session.copy_side("left"), "L → R"),
        (session.keep, "pins baked"),
        (lambda: pull(session, 17, [0, 0, 3.0]), "pull nose tip"),
        (lambda: session.set_pin(17, hidden=True, name="tip"), "hide nose tip"),
        (session.reset, "reset"),
        (lambda: session.slide(0, 0, 1.0), "slider"),
        (session.reset, "reset"),
    ):
        edit()
        assert steps.list.items[0]["name"] == said
    told = [row["name"] for row in steps.list.items]
    lab.session.history.go(3)
    assert [row["name"] for row in steps.list.items] == told


def test_a_mirrored_pin_is_no_pull_in_the_steps(parts):
    model, rig = parts
    partners = np.arange(rig.n_vertices)
    partners[[17, 18]] = 18, 17
    lab = PosingLab(PosingSession(model, rig.neutral, partners=partners))
    pull(lab.session, 17, [0, 0, 3.0])
    lab.session.mirror_pin(17)
    assert lab.steps.list.items[0]["name"] == "mirror pin nose tip"


def test_steps_made_before_the_lab_are_told_from_their_states(parts):
    model, rig = parts
    session = PosingSession(model, rig.neutral)
    pull(session, 17, [0, 0, 3.0])
    session.set_pin(17, hidden=True, name="tip")
    session.set_pin(17, hidden=False)
    session.reset()
    said = [row["name"] for row in PosingLab(session).steps.list.items]
    assert said == ["reset", "show nose tip", "hide nose tip", "pull nose tip", "the start"]


def test_the_ghost_is_of_the_last_step_that_moved_the_face(lab):
    lab.stage.ghost.value = True
    lab.session.set(beta=0.3)
    assert lab.view._ghost is None or not lab.view._ghost.visible, "nothing has moved yet"
    before = lab.session.vertices
    pull(lab.session, 17, [0, 0, 4.0])
    lab.session.set_pin(17, hidden=True)
    lab.session.set_pin(17, name="tip")
    at = lab.view._ghost.geometry.attributes["position"].array
    assert lab.view._ghost.visible
    np.testing.assert_allclose(at, before, atol=1e-4)


def test_the_ghost_is_the_pose_before_the_last_step(lab):
    pull(lab.session, 17, [0, 0, 4.0])
    before = lab.session.vertices
    lab.stage.ghost.value = True
    pull(lab.session, 90, [0, 0, 4.0])
    ghost = lab.view._ghost
    at = ghost.geometry.attributes["position"].array
    np.testing.assert_allclose(at, before, atol=1e-4)
    lab.session.undo()
    np.testing.assert_allclose(at.shape, before.shape)
    rest = ghost.geometry.attributes["position"].array
    np.testing.assert_allclose(rest, lab.session.neutral.vertices, atol=1e-4)
    lab.stage.ghost.value = False
    assert not ghost.visible


# --- library, time, files -------------------------------------------------------------------------


def test_the_library_comes_back_after_a_restart_with_names_order_and_pictures(lab, parts, tmp_path):
    model, rig = parts
    assert list(tmp_path.iterdir()) == [], "nothing is written unasked"
    pull(lab.session, 17, [0, 0, 9.0])
    lab.strip.name.value = "bump"
    lab.strip.keep.click()
    lab.session.use(rig)
    lab.session.slide(0, 0, 0.7)
    lab.strip.add("jaw")
    press(lab.strip.strip, "earlier", "jaw")
    assert list(lab.strip.poses) == ["neutral", "jaw", "bump"]
    assert lab.strip.strip.chosen == 1
    lab.strip.name.value = "open"
    lab.strip.rename.click()
    pictures = [item["picture"] for item in lab.strip.strip.items]
    assert len(set(pictures)) == 3
    again = PosingLab(
        PosingSession(model, rig.neutral), {"region": model, "rig": rig}, folder=tmp_path
    )
    assert [item["name"] for item in again.strip.strip.items] == ["neutral", "open", "bump"]
    assert [item["picture"] for item in again.strip.strip.items] == pictures
    press(again.strip.strip, "choose", "open")
    assert again.session.model is rig and again.session.coefficients[0] == pytest.approx(0.7)
    save_library(again.last.path, {"last": again.session.state}, again.session)
    again.files._list_files()
    assert again.files.name.options == (), "a library is no pose, nor is the pose of last time"


def test_a_library_that_cannot_be_read_is_left_alone_and_told(lab, parts, tmp_path):
    model, rig = parts
    path = lab.strip.path
    path.write_text("{ broken")
    other = PosingLab(PosingSession(model, rig.neutral), folder=tmp_path)
    assert "Not read" in other.strip._about.value
    other.strip.add("mine")
    assert path.read_text() == "{ broken" and other.strip.path.exists()
    again = PosingLab(PosingSession(model, rig.neutral), folder=tmp_path)
    assert "Not read" in again.strip._about.value and "mine" in again.strip.poses
    again.strip.add("more")
    assert list(load_library(again.strip.path, again.session)[0]) == ["neutral", "mine", "more"]
    lab.strip.add("late")  # the file broke while this lab was open
    assert path.read_text() == "{ broken"
    assert list(lab.strip.poses) == ["neutral", "mine", "more", "late"]


def test_what_was_kept_in_place_of_a_library_is_found_when_that_can_be_read_again(
    lab, parts, tmp_path
):
    model, rig = parts
    path = lab.strip.path

    def opened():
        return PosingLab(PosingSession(model, rig.neutral), folder=tmp_path)

    lab.strip.add("smile")
    whole = path.read_bytes()
    path.write_text("{ broken")
    other = opened()
    pull(other.session, 17, [0, 0, 2.0])
    for name in ("smile", "frown"):
        other.strip.add(name)
    path.write_bytes(whole)
    names = ["neutral", "smile", "smile (2)", "frown"]
    for again in (opened(), opened()):
        assert list(again.strip.poses) == names
    assert again.strip.poses["smile"].same(lab.strip.poses["smile"])
    assert other.strip.path.exists(), "reading changes no file"
    press(again.strip.strip, "remove", "frown")
    assert list(load_library(path, lab.session)[0]) == names[:3]
    assert not other.strip.path.exists()
    assert list(opened().strip.poses) == names[:3], "what was taken out stays out"


def test_a_library_of_another_face_of_the_same_mesh_is_left_alone(lab, parts, tmp_path):
    _, rig = parts
    lab.strip.add("mine")
    before = lab.strip.path.read_bytes()
    X = np.random.default_rng(0).normal(size=(4, rig.neutral.n_vertices, 3))
    other = BlendshapeRig(rig.neutral.with_vertices(1.1 * rig.neutral.vertices), UNITS, X)
    for name in ("first", "second"):
        one = PosingLab(PosingSession(other, other.neutral), folder=tmp_path)
        one.strip.add(name)
    assert list(one.strip.poses) == ["neutral", "first", "second"]
    assert lab.strip.path.read_bytes() == before
    assert one.strip.path.name == lab.strip.path.name.replace(".library", "-2.library")
    assert "Not read" not in one.strip._about.value


def test_an_error_goes_away_with_the_next_thing_that_works(lab, tmp_path):
    def fails():
        lab.files.name.value = "no such pose"
        lab.files.load.click()
        assert "no such pose" in lab._message.value

    lab.strip.add("mine")
    lab.clip.key.click()
    for act in (
        lambda: press(lab.strip.strip, "remove", "mine"),
        lab.strip.back.button.click,
        lambda: press(lab.clip.keys, "remove", 0),
        lab.clip.back.button.click,
        lab.files.ply.click,
    ):
        fails()
        act()
        assert lab._message.value == ""


def test_two_labs_of_a_face_keep_what_each_other_added_and_took_out(lab, parts, tmp_path):
    model, rig = parts
    a, b = lab, PosingLab(PosingSession(model, rig.neutral), lab.models, folder=tmp_path)
    pull(b.session, 17, [0, 0, 3.0])
    a.strip.add("from A")
    b.strip.add("from B")
    a.strip.add("again A")
    assert list(a.strip.poses) == ["neutral", "from A", "from B", "again A"]

    def stored():
        return list(load_library(a.strip.path, a.session, lab.models)[0])

    assert stored() == list(a.strip.poses)
    press(b.strip.strip, "remove", "from A")
    assert stored() == ["neutral", "from B", "again A"]
    press(b.strip.strip, "choose", "from B")
    b.strip.name.value = "named"
    b.strip.rename.click()
    press(a.strip.strip, "later", "from A")
    assert "taken out elsewhere" in a._message.value
    assert stored() == list(a.strip.poses) == ["neutral", "named", "again A"]
    b.strip.add("late")
    a.strip.name.value = "late"
    a.strip.keep.click()
    assert "added elsewhere" in a._message.value and "late" in a.strip.poses
    assert b.strip.poses["late"].same(a.strip.poses["late"])


def test_rename_renames_the_pose_that_was_clicked(lab):
    lab.strip.add("X")  # the neutral, too
    for name in ("pose 1", "smirk"):
        pull(lab.session, 17, [0, 0, 2.0])
        lab.strip.add(name)
    assert lab.strip.strip.chosen == 3
    press(lab.strip.strip, "choose", "X")
    assert lab.strip.strip.chosen == 1, "of two alike, the one that was clicked"
    lab.strip.name.value = "RENAMED"
    lab.strip.rename.click()
    assert list(lab.strip.poses) == ["neutral", "RENAMED", "pose 1", "smirk"]
    assert lab.strip.strip.chosen == 1
    press(lab.strip.strip, "choose", "neutral")
    assert lab.strip.strip.chosen == 0
    pull(lab.session, 90, [0, 0, 2.0])
    assert lab.strip.strip.chosen == -1
    lab.strip.name.value = "nothing"
    lab.strip.rename.click()
    assert "no pose is chosen" in lab._message.value


def test_enter_in_the_name_of_a_pose_adds_it(lab):
    lab.strip.name.value = "bump"
    lab.strip.name._handle_custom_msg({"event": "submit"}, [])
    assert list(lab.strip.poses) == ["neutral", "bump"] and lab.strip.name.value == ""


def test_a_pose_taken_out_of_the_library_can_be_put_back(lab):
    strip, shown = lab.strip, lambda: lab.strip.back.widget.layout.display != "none"
    for name in ("smirk", "bump"):
        pull(lab.session, 17, [0, 0, 2.0])
        strip.add(name)
    smirk, n_undo = strip.poses["smirk"], lab.session.n_undo
    assert not shown()
    press(strip.strip, "remove", "smirk")
    assert list(strip.poses) == ["neutral", "bump"] and shown()
    assert "smirk" in strip.back._text.value
    strip.back.button.click()
    assert list(strip.poses) == ["neutral", "smirk", "bump"] and not shown()
    assert strip.poses["smirk"].same(smirk) and lab.session.n_undo == n_undo
    assert list(load_library(strip.path, lab.session)[0]) == list(strip.poses)
    press(strip.strip, "remove", "smirk")
    strip.add("smirk")
    strip.back.button.click()
    assert "there is another smirk" in lab._message.value and shown()
    strip.name.value = "new smirk"
    strip.rename.click()
    strip.back.button.click()
    assert list(strip.poses) == ["neutral", "smirk", "bump", "new smirk"]


def test_a_pose_that_add_replaced_is_put_back_and_exchanged_again(lab):
    strip = lab.strip
    strip.add("smirk")
    strip.add("bump")
    before = strip.poses["smirk"]
    pull(lab.session, 17, [0, 0, 2.0])
    strip.add("smirk")
    after = strip.poses["smirk"]
    assert "Replaced <b>smirk</b>" in strip.back._text.value and not after.same(before)
    for wanted in (before, after, before):
        strip.back.button.click()
        assert lab._message.value == "" and strip.poses["smirk"].same(wanted)
        stored, _ = load_library(strip.path, lab.session)
        assert list(stored) == ["neutral", "smirk", "bump"] and stored["smirk"].same(wanted)
    strip.strip.chosen = 1
    strip.name.value = "renamed"
    strip.rename.click()
    strip.back.button.click()
    assert list(strip.poses) == ["neutral", "smirk", "renamed", "bump"]
    assert strip.back.widget.layout.display == "none"


def test_a_library_that_cannot_be_written_lasts_as_long_as_the_page(lab, tmp_path):
    strip = lab.strip
    (tmp_path / "file").write_text("no folder")
    strip.path = tmp_path / "file" / "poses.library.json"
    pull(lab.session, 17, [0, 0, 2.0])
    strip.name.value = "bump"
    strip.keep.click()
    assert list(strip.poses) == ["neutral", "bump"] and strip.name.value == ""
    assert lab._message.value == "" and "Not kept: " in strip._about.value
    assert "; these poses last as long as this page." in strip._about.value
    assert "Not kept" in lab._status.value, "the panel may be out of sight"
    press(strip.strip, "remove", "bump")
    strip.back.button.click()
    assert list(strip.poses) == ["neutral", "bump"] and lab._message.value == ""
    strip.path = tmp_path / "poses.library.json"
    strip.add("more")
    assert "Not kept" not in strip._about.value
    assert list(load_library(strip.path, lab.session)[0]) == ["neutral", "bump", "more"]


def test_a_pose_chosen_while_the_clip_plays_stays(keyed, monkeypatch):
    lab, clip, now = keyed, keyed.clip, [0.0]
    monkeypatch.setattr("facelab.widgets.posing_clips.time.monotonic", lambda: now[0])
    lab.strip.add("open")
    lab.session.reset()
    clip.slider.value, clip.play.playing = 40, True
    press(lab.strip.strip, "choose", "open")
    assert not clip.play.playing and lab.frame is None
    clip.slider.value = 41  # the page had sent it before
    np.testing.assert_array_equal(lab.vertices, lab.session.vertices)
    assert lab.frame is None and lab.session.coefficients[0] == pytest.approx(0.8)
    now[0] += 5  # over a slow wire, or on a busy machine
    clip.slider.value = 42
    assert lab.frame is None
    clip._pace._handle_custom_msg(
        {"do": "told", "asked": 1}, []
    )  # the page, that no more is on its way
    assert clip.track.now == clip.seconds == 42 / 25
    clip.slider.value = 43
    assert lab.frame is not None


def test_a_page_that_is_gone_holds_no_frame_back_for_ever(keyed, monkeypatch):
    clip, now = keyed.clip, [0.0]
    monkeypatch.setattr("facelab.widgets.posing_clips.time.monotonic", lambda: now[0])
    clip.slider.value, clip.play.playing = 40, True
    clip.stop.click()
    now[0] += 61
    clip.slider.value = 41
    assert keyed.frame is not None


def test_of_two_stops_the_answer_to_the_first_is_none(keyed):
    clip = keyed.clip
    for frame in (40, 30):
        clip.slider.value, clip.play.playing = frame, True
        clip.stop.click()
        if frame == 40:
            clip._pace._handle_custom_msg({"do": "told", "asked": 1}, [])
    clip._pace._handle_custom_msg({"do": "told", "asked": 1}, [])
    clip.slider.value = 31
    assert keyed.frame is None
    clip._pace._handle_custom_msg({"do": "told", "asked": 2}, [])
    clip.slider.value = 32
    assert keyed.frame is not None


def test_the_neutral_of_a_new_library_is_neutral(parts, tmp_path):
    model, rig = parts
    session = PosingSession(model, rig.neutral)
    pull(session, 17, [0, 0, 2.0])
    session.look(10, 0)
    strip = PosingLab(session, folder=tmp_path).strip
    neutral = strip.poses["neutral"]
    assert not neutral.coefficients.any() and neutral.gaze == (0, 0) and not neutral.pins
    assert session.pins and strip.strip.chosen == -1


def test_a_pose_that_cannot_be_written_is_told_and_its_name_stays(lab, monkeypatch):
    lab.strip.add("first")

    def full(path, poses, session):
        raise OSError("the disk is full")

    monkeypatch.setattr("facelab.widgets.posing_library.save_library", full)
    lab.strip.name.value = "second"
    lab.strip.keep.click()
    assert "disk is full" in lab._message.value and lab.strip.name.value == "second"
    assert list(lab.strip.poses) == ["neutral", "first"], "the strip shows what is kept"


def test_poses_of_a_model_that_is_not_at_hand_are_counted_and_not_overwritten(lab, parts, tmp_path):
    model, rig = parts
    path, session = lab.strip.path, lab.session
    states = {"a": session.state}
    session.use(rig)
    save_library(path, {**states, "b": session.state}, session)
    alone = PosingLab(PosingSession(model, rig.neutral), folder=tmp_path)
    assert list(alone.strip.poses) == ["a"] and "1 of another model" in alone.strip._about.value
    alone.strip.add("c")
    poses, others = load_library(path, PosingSession(rig, rig.neutral), [model])
    assert list(poses) == ["a", "b", "c"] and others == []
    np.testing.assert_array_equal(poses["b"].coefficients, session.coefficients)
    alone = PosingLab(PosingSession(model, rig.neutral), folder=tmp_path)
    assert list(alone.strip.poses) == ["a", "c"], "one file keeps all poses of a face"
    alone.strip.name.value = "b"
    alone.strip.keep.click()
    assert "b is in the library already" in alone._message.value
    assert alone.strip.name.value == "b" and list(alone.strip.poses) == ["a", "c"]


def test_a_damaged_library_is_refused_with_its_place(lab, tmp_path):
    path = tmp_path / "library.json"
    save_library(path, {"a": lab.session.state}, lab.session)
    text = path.read_text()
    for bad in (
        text.replace('"name": "a"', '"name": 3'),
        text.replace("facelab-library", "facelab-pose"),
        text[: len(text) // 2],
    ):
        path.write_text(bad)
        with pytest.raises(ValueError, match=re.escape(str(path))):
            load_library(path, lab.session)


def test_keys_are_dragged_along_the_line_of_time(lab):
    lab.clip.key.click()
    lab.clip.slider.value = 50
    pull(lab.session, 17, [0, 0, 4.0])
    lab.clip.key.click()
    assert lab.clip.track.times == [0.0, 2.0] and lab.clip.track.length == 3.0
    press(lab.clip.track, "move", 2.0, to=1.2, asked=1)
    assert lab.clip.track.times == [0.0, 1.2] and lab.clip.track.now == pytest.approx(1.2)
    press(lab.clip.track, "move", 1.2, to=0.0, asked=2)
    assert "a key at 0.00 s already" in lab._message.value
    assert lab.clip.track.times == [0.0, 1.2]
    press(lab.clip.track, "choose", 0.0, to=0.0, asked=3)
    assert lab.clip.seconds == 0


@pytest.fixture
def keyed(lab):
    """A lab of a rig with keys at 1.32 s, the neutral, and at 2 s, the jaw open."""
    lab.session.use(lab.models["rig"])
    lab.clip.length.value = 3.0
    for seconds, weight in ((1.32, 0.0), (2.0, 0.8)):
        lab.session.slide(0, 0, weight)
        lab.clip.slider.value = round(25 * seconds)
        lab.clip.stop.click()
        lab.clip.key.click()
    lab.clear()
    return lab


def test_a_clip_is_no_shorter_than_its_last_key(keyed):
    clip = keyed.clip
    clip.length.value = 0.5
    assert clip.length.value == clip.track.length == 2.0 and clip.slider.max == 50
    assert "the last key is at 2.00 s" in keyed._message.value
    clip.length.value = 2.5
    assert clip.length.value == 2.5 and clip.slider.max == 62 + 1
    clip.set_clip(clip.clip.moved_key(1, 1000.01))
    assert clip.length.value == 1000.01 and clip.slider.max == 25001


def test_a_key_taken_out_can_be_put_back(keyed):
    clip = keyed.clip
    before, n_undo = clip.clip, keyed.session.n_undo

    def take_out(time):
        press(clip.keys, "remove", time)
        assert clip.back.widget.layout.display != "none"

    take_out(1.32)
    assert "1.32 s" in clip.back._text.value and clip.track.times == [2.0]
    clip.back.button.click()
    assert clip.back.widget.layout.display == "none" and keyed.session.n_undo == n_undo
    for name in ("times", "poses", "gaze", "names"):
        np.testing.assert_array_equal(getattr(clip.clip, name), getattr(before, name))
    take_out(1.32)
    take_out(2.0)
    assert clip.clip is None
    clip.back.button.click()
    assert clip.track.times == [2.0], "of all, the last that was taken out"
    take_out(2.0)
    clip.slider.value = 0
    clip.key.click()
    press(clip.track, "move", 0.0, to=2.0, asked=1)
    clip.back.button.click()
    assert "another key at 2.00 s" in keyed._message.value and clip.track.times == [2.0]


def test_a_key_or_a_clip_that_was_replaced_can_be_put_back(keyed):
    lab, clip = keyed, keyed.clip
    first = clip.clip
    lab.files.save_clip.click()
    lab.session.slide(0, 0, 0.4)
    clip.key.click()  # over the one at 2 s
    second = clip.clip
    assert "Replaced <b>the key at 2.00 s</b>" in clip.back._text.value
    for wanted in (first, second, first):
        clip.back.button.click()
        assert clip.clip is wanted and lab._message.value == ""
    clip.set_clip(second.moved_key(1, 1.5))
    assert clip.back.widget.layout.display == "none", "what was there is no longer"
    third = clip.clip
    lab.files.load_clip.click()
    assert "Replaced <b>the key poses</b>" in clip.back._text.value
    lab.session.use(lab.models["region"])
    clip.back.button.click()
    assert "of another model" in lab._message.value and clip.clip is not third
    lab.session.use(lab.models["rig"])
    clip.back.button.click()
    assert clip.clip is third


def test_what_is_kept_of_a_frame_of_a_clip_is_what_is_on_screen(keyed, tmp_path):
    lab, clip = keyed, keyed.clip
    lab.session.reset()
    clip.slider.value = round(25 * 1.64)
    share = clip.clip.at(clip.seconds)
    shown = lab.vertices
    assert 0.2 < share[0] < 0.6 and not np.allclose(shown, lab.session.vertices)
    assert "your pose is not" in clip._about.value
    n_undo = lab.session.n_undo
    lab.strip.add("between")
    np.testing.assert_allclose(lab.strip.poses["between"].coefficients, share)
    assert lab.strip.strip.chosen == -1, "the pose of the session is not on screen"
    for button in (lab.files.obj, lab.files.live_link, lab.files.save):
        button.click()
    assert lab._message.value == ""
    mesh = facelab.files.read_mesh(tmp_path / "pose.obj")
    np.testing.assert_allclose(mesh.vertices, shown, atol=1e-3)
    one = read_live_link_csv(tmp_path / "pose.livelink.csv", fps=30)
    assert one.weights[0, one.names.index("jawOpen")] == pytest.approx(share[0], abs=1e-6)
    again = PosingSession(lab.models["rig"], lab.session.neutral)
    load_pose(tmp_path / "pose.json", again)
    np.testing.assert_allclose(again.vertices, shown)
    log = read_log(tmp_path / "pose.json")
    again = replay(log, PosingSession(lab.models["rig"], lab.session.neutral))
    np.testing.assert_allclose(again.vertices, shown)
    clip.key.click()
    assert len(clip.track.times) == 3
    np.testing.assert_allclose(clip.clip.poses[1], share)
    assert lab.session.n_undo == n_undo and not lab.session.coefficients.any()
    clip.stop.click()
    assert "your pose is not" not in clip._about.value
    lab.strip.add("posed")
    assert not lab.strip.poses["posed"].coefficients.any()


@pytest.mark.parametrize("kept", ["add", "key", "save"])
def test_what_is_kept_during_a_drag_is_what_is_on_screen(lab, kept):
    lab.stage._press(17)
    lab.stage._move(np.array([0, 0, 4.0]))
    shown = lab.session.vertices
    if kept == "add":
        lab.strip.add("held")
        got = lab.session.vertices_in(lab.strip.poses["held"])
    elif kept == "key":
        lab.clip.key.click()
        got = lab.session.vertices_of(lab.clip.clip.poses[0])
    else:
        lab.files.save.click()
        again = PosingSession(lab.session.model, lab.mesh)
        load_pose(lab.files.lab.folder / "pose.json", again)
        got = again.vertices
    assert np.abs(shown - lab.mesh.vertices).max() > 1 and lab._message.value == ""
    np.testing.assert_allclose(got, shown, atol=1e-9)
    lab.stage._release()
    assert lab.session.n_undo == 1 and not lab.session.dragging
    np.testing.assert_allclose(lab.session.vertices, shown, atol=1e-9)


def test_the_frame_of_keys_that_are_gone_leaves_the_screen(keyed):
    lab, clip = keyed, keyed.clip
    clip.slider.value = 45
    press(clip.keys, "remove", 2.0)
    np.testing.assert_array_equal(lab.vertices, lab.session.neutral.vertices)
    press(clip.keys, "remove", 1.32)
    assert lab.frame is None and "your pose is not" not in clip._about.value
    clip.key.click()
    assert clip.track.times == [1.8]
    np.testing.assert_allclose(clip.clip.poses[0], lab.session.coefficients)


def test_a_file_written_over_another_says_so_and_a_failure_takes_the_old_words_away(lab):
    for _ in range(2):
        before = lab.files._result.value
        lab.files.save.click()
    assert "again, over" not in before and "again, over the one before" in lab.files._result.value
    lab.files.name.value = "a/b"
    lab.files.save.click()
    assert "leads out of the folder" in lab._message.value and lab.files._result.value == ""


def test_weights_of_a_rig_leave_as_live_link_records_them(lab, parts, tmp_path):
    _, rig = parts
    lab.files.live_link.click()
    assert "only a rig has weights" in lab._message.value
    lab.session.use(rig)
    lab.clip.key.click()
    lab.clip.slider.value = 25
    lab.session.slide(0, 0, 0.75)
    lab.clip.key.click()
    lab.files.live_link.click()
    assert "Download" in lab.files._result.value
    one = read_live_link_csv(tmp_path / "pose.livelink.csv", fps=30)
    assert one.weights[0, one.names.index("jawOpen")] == pytest.approx(0.75)
    lab.files.clip_live_link.click()
    clip = read_live_link_csv(tmp_path / "pose.clip.livelink.csv")
    jaw = clip.weights[:, clip.names.index("jawOpen")]
    assert len(jaw) == 31 and jaw[0] == 0 and jaw[-1] == pytest.approx(0.75)


# --- words, and where it does not run -------------------------------------------------------------


def test_errors_speak_of_points_and_buttons_and_not_of_arguments(lab):
    pull(lab.session, 17, [0, 0, 2.0])
    lab.session.set_pin(17, locked=True)
    press(lab.pose.pins, "remove", 17)
    said = lab._message.value
    assert "nose tip is a locked pin; unlock it first" in said
    assert "set_pin" not in said and "vertex=" not in said and "ValueError" not in said


@pytest.mark.parametrize(
    "error, said",
    [
        ("path='/tmp/x/nosuffix': end it in .csv.", "The file 'nosuffix': end it in .csv."),
        (
            'path="it\'s.json": there is no such file.',
            'The file "it\'s.json": there is no such file.',
        ),
        ("it is path='a.json'.", "it is the file 'a.json'."),
        ("name is empty; write one.", "The name is empty; write one."),
        ("name has 61 letters; give 60.", "The name has 61 letters; give 60."),
        ("name='../a' leads out.", "The name '../a' leads out."),
        ("alpha=-1 is below 0.", "α -1 is below 0."),
    ],
)
def test_files_and_names_are_called_so_in_errors(lab, error, said):
    assert lab.in_words(ValueError(error)) == said


@pytest.mark.parametrize(
    "act, said",
    [
        (lambda lab: lab.files.load.click(), "The file &#39;nothere.json&#39;: there is no such"),
        (lambda lab: lab.files.load_clip.click(), "The file &#39;nothere.clip.json&#39;: there is"),
    ],
)
def test_a_file_that_is_not_there_is_told_as_a_file(lab, act, said):
    lab.files.name.value = "nothere"
    act(lab)
    assert said in lab._message.value


def test_what_cannot_be_written_is_told_as_a_file(expression):
    expression.file.value = "nosuffix"
    expression.save.click()
    assert "The file &#39;nosuffix&#39;: end it in .csv" in expression._message.value
    expression.file.value = ""
    expression.save.click()
    assert "The name is empty; write a file name." in expression._message.value


def test_a_fault_of_our_own_is_told_as_one_with_its_place(lab, monkeypatch):
    monkeypatch.setattr(lab.session, "undo", lambda: 1 / 0)
    pull(lab.session, 17, [0, 0, 2.0])
    lab.undo.click()
    assert "ZeroDivisionError: a fault of facelab, in" in lab._message.value


@pytest.mark.parametrize("which", ["lab", "expression"])
def test_where_it_does_not_run_a_notebook_has_a_picture_and_says_press_run(
    which, request, monkeypatch
):
    page = request.getfixturevalue(which)
    still, image, bundle = shown(page, monkeypatch)
    assert "Press Run" in bundle["text/plain"] and "HBox" not in bundle["text/plain"]
    assert image.min() < 0.5 < image.max() and "Press Run" in still
    # the page takes its place
    (live,) = re.findall(r"has\(\.([\w-]+)\) \.facelab-still { display: none", still)
    assert live in page.widget._dom_classes


def test_another_face_in_the_same_page_leaves_nothing_of_the_first(lab, parts):
    _, rig = parts
    page, first = lab.widget, lab.session
    other = PosingSession(rig, rig.neutral.with_vertices(rig.neutral.vertices * 1.1))
    lab.take_up(other)
    assert lab.widget is page and lab.session is other and lab.mesh is other.neutral
    pull(first, 17, [0, 0, 3.0])
    assert lab.pose.pins.items == [], "the first session is not followed any more"
    pull(other, 17, [0, 0, 3.0])
    assert [row["id"] for row in lab.pose.pins.items] == [17]
    with pytest.raises(TypeError, match="PosingSession"):
        lab.take_up(rig)
    assert lab.session is other


def test_a_rig_without_landmarks_has_places_named_all_the_same():
    rig = facelab.load_example().rig
    small = rig.on(*rig.neutral.subsample(900))
    bare = TriangleMesh(small.neutral.vertices, small.neutral.faces)
    lab = ExpressionLab(ExpressionSession(BlendshapeRig(bare, small.names, small.deltas)))
    names = {lab.name_of(v) for v in range(bare.n_vertices)}
    assert {"nose tip", "chin", "mouth corner left", "brow right"} <= names


def test_a_pose_is_loaded_over_a_frame_that_the_model_cannot_pose(lab, monkeypatch):
    pull(lab.session, 17, [0, 0, 3.0])
    pose = lab.session.vertices
    lab.files.name.value = "kept"
    lab.files.save.click()
    lab.session.reset()

    def impossible():
        raise ValueError("no pose of the model")

    monkeypatch.setattr(lab.clip, "on_screen", impossible)
    lab.files.load.click()
    assert lab._message.value == ""
    np.testing.assert_array_equal(lab.session.vertices, pose)


# --- messages that cross each other ---------------------------------------------------------------


def test_what_a_page_says_of_things_that_are_gone_does_nothing_to_others(keyed):
    lab, session, clip = keyed, keyed.session, keyed.clip
    lab.strip.add("mine")
    pull(session, 17, [0, 0, 2.0])
    session.remove_pin(17)
    press(clip.keys, "remove", 1.32)
    press(lab.strip.strip, "remove", "mine")
    state, poses = session.state, list(lab.strip.poses)
    for do in ("hide", "lock", "weight", "remove"):
        press(lab.pose.pins, do, 17)
    for do in ("choose", "remove"):
        press(lab.strip.strip, do, "mine")
        press(clip.keys, do, 1.32)
    press(clip.track, "move", 1.32, to=0.2, asked=1)
    press(lab.shape.regions, "choose", 3)  # of the region model: the rig is one
    assert session.state is state and list(lab.strip.poses) == poses
    assert clip.track.times == [2.0] and lab._message.value == "" and lab.shape.region == 0


def test_the_page_hears_of_each_move_of_a_key_also_of_one_that_is_refused(keyed):
    heard, track = [], keyed.clip.track
    track.send = lambda content: heard.append(content["heard"])
    press(track, "move", 1.32, to=1.0, asked=1)
    press(track, "move", 1.0, to=2.0, asked=2)
    press(track, "move", 0.52, to=0.6, asked=3)
    assert heard == [1, 2, 3] and track.times == [1.0, 2.0]


def test_a_step_is_meant_as_it_was_shown_and_not_by_its_place(lab):
    session = lab.session
    for vertex in (17, 90):
        pull(session, vertex, [0, 0, 2.0])
    session.undo()
    shown = lab.steps.list.items[0]
    assert shown["note"] == "undone"
    session.set(beta=0.1)
    session.set(gamma=0.1)
    state = session.state
    press(lab.steps.list, "choose", shown["id"])
    assert session.state is state, "the step has gone"
    press(lab.steps.list, "choose", lab.steps.list.items[-1]["id"])
    assert session.n_undo == 0


def test_a_slider_of_another_model_moves_nothing_of_this_one(lab):
    moved = lab.shape.sliders.items[0]["id"]
    lab.session.use(lab.models["rig"])
    state = lab.session.state
    slide(lab.shape.sliders, moved, 0.5)
    assert lab.session.state is state


def test_of_two_hands_on_one_session_the_last_one_has_it(lab):
    twin = PosingLab(lab.session, lab.models, folder=lab.folder)
    hands = {lab: 17, twin: 90}
    for each, vertex in hands.items():
        each.view._hear({"do": "press", "press": str(vertex), "vertex": vertex})
        each.view._hear({"do": "move", "press": str(vertex), "offset": [0, 0, 1.0]})
    assert lab.stage.held is None and "given up" in lab._status.value
    for offset in ([0, 0, 2.0], [0, 0, 3.0]):
        for vertex, each in zip((17, 90), (lab, twin), strict=True):
            each.view._hear({"do": "move", "press": str(vertex), "offset": offset})
    for each, vertex in hands.items():
        each.view._hear({"do": "release", "press": str(vertex), "offset": [0, 0, 3.0]})
    assert lab.session.n_undo == 2
    went = [lab.session.pins[v] - lab.mesh.vertices[v] for v in hands.values()]
    np.testing.assert_allclose(np.array(went)[:, 2], [1, 3], atol=0.2)


def test_a_source_of_sketches_keeps_its_place_when_the_sketch_is_pulled(expression):
    before = expression.source.options
    expression.session.set_pin(17, expression.session.sketch[17] + [0, 0, 2.0])
    expression.source.value = "neutral"
    expression.session.set_pin(17, expression.session.sketch[17] + [0, 0, 2.0])
    after = expression.source.options
    assert expression.source.value == "pulled by hand"
    assert [before.index(n) for n in ("posed", "neutral")] == [0, 1]
    assert [after.index(n) for n in ("posed", "neutral")] == [0, 1]


def test_the_page_learns_where_alpha_is_though_it_was_moved_meanwhile(expression):
    sent, curve = [], expression.curve
    curve.send = sent.append
    curve.place = 12
    assert sent == [{"heard": 12, "place": 12}]
