"""Pins that are hidden and named, sliders that are true, and one side copied onto the other."""

import json

import numpy as np
import pytest
from planted import bumps, quarters

from facelab.files.poses import load_pose, save_pose
from facelab.models.region import RegionModel
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions


@pytest.fixture
def parts(rng):
    mesh, labels = quarters()
    X = bumps(mesh, labels, rng)
    rig = BlendshapeRig(mesh, "abcdefgh", X.reshape(len(X), -1, 3)[:8])
    return mesh, RegionModel(Regions(labels, mesh), 6).fit(X), rig


@pytest.fixture
def session(parts):
    mesh, model, _ = parts
    return PosingSession(model, mesh)


@pytest.fixture
def rigged(parts):
    mesh, _, rig = parts
    return PosingSession(rig, mesh)


def test_a_pin_is_hidden_and_named_without_moving_the_face_and_undo_brings_all_back(session):
    session.pull(17, session.vertices[17] + [1.0, 2, 3])
    before = session.vertices
    session.set_pin(17, hidden=True, name=" smirk ")
    assert session.hidden == {17} and session.pin_names == {17: "smirk"}
    np.testing.assert_array_equal(session.vertices, before)
    session.set_pin(17, target=session.vertices[17])
    assert session.hidden == {17}, "a new target leaves the rest"
    session.set_pin(17, hidden=False, name="")
    assert not session.hidden and not session.pin_names
    session.undo()
    session.undo()
    assert session.hidden == {17}
    session.remove_pin(17)
    assert not session.hidden and not session.pin_names and not session.pins
    session.undo()
    session.keep()
    assert not session.hidden and not session.pin_names


@pytest.mark.parametrize(
    ("bad", "message"),
    [({"hidden": "yes"}, "hidden"), ({"name": 3}, "name"), ({"name": "x" * 61}, "61")],
)
def test_bad_marks_of_a_pin_are_refused_and_nothing_changes(session, bad, message):
    session.set_pin(17)
    before = session.state
    with pytest.raises((TypeError, ValueError), match=message):
        session.set_pin(17, **bad)
    assert session.state is before


def test_marks_of_pins_come_back_from_file_and_log_and_old_files_are_read(session, parts, tmp_path):
    mesh, model, _ = parts
    session.set_pin(17, session.vertices[17] + [0, 0, 4.0], hidden=True, name="smirk")
    session.set_pin(90)
    save_pose(tmp_path / "pose.json", session)
    other = PosingSession(model, mesh)
    load_pose(tmp_path / "pose.json", other)
    assert (other.hidden, other.pin_names) == ({17}, {17: "smirk"})
    again = replay(session.log, PosingSession(model, mesh))
    assert (again.hidden, again.pin_names) == ({17}, {17: "smirk"})
    plain = PosingSession(model, mesh)
    plain.set_pin(90)
    save_pose(tmp_path / "plain.json", plain)
    (pin,) = json.loads((tmp_path / "plain.json").read_text())["state"]["pins"]
    assert pin.keys() == {"vertex", "displacement", "weight", "locked"}, "as before"


def test_the_sliders_of_a_rig_show_the_weights_that_pins_made(rigged, parts):
    _, _, rig = parts
    face = rig.shape({"b": 0.6, "e": 0.3})
    for vertex in (10, 27, 40, 65, 90, 110):
        rigged.pull(vertex, face[vertex])
    shown = rigged.slider_values(0)
    np.testing.assert_array_equal(shown, rigged.coefficients)
    assert shown.argmax() == 1 and shown[1] > 0.05 and np.abs(rigged.mold_values(0)).max() == 0


@pytest.mark.parametrize("kind", ["session", "rigged"])
def test_a_slider_brings_the_pose_where_it_is_set_with_pins_and_without(kind, request):
    posed = request.getfixturevalue(kind)
    posed.slide(0, 1, 0.5)
    assert posed.slider_values(0)[1] == pytest.approx(0.5, abs=1e-6)
    posed.pull(27, posed.vertices[27] + [0, 0, 3.0])
    pins, before = posed.pins, posed.slider_values(0)[1]
    wanted = before + 0.2
    posed.slide(0, 1, wanted)
    assert abs(posed.slider_values(0)[1] - wanted) < 0.1 * abs(before - wanted)
    np.testing.assert_array_equal(posed.pins[27], pins[27])
    low, high = (0, 1) if kind == "rigged" else (-np.inf, np.inf)
    assert (posed.slider_values(0) >= low).all() and (posed.slider_values(0) <= high).all()


def test_a_slider_that_pins_hold_never_goes_the_other_way(session):
    for vertex in np.flatnonzero(session.region_labels == 0):
        session.set_pin(vertex, weight=1e3)
    before = session.slider_values(0)[0]
    session.slide(0, 0, before + 2)
    assert -1e-6 <= session.slider_values(0)[0] - before <= 2


def test_a_slide_out_of_bounds_is_refused(rigged):
    with pytest.raises(ValueError, match="value"):
        rigged.slide(0, 1, 1.5)
    with pytest.raises(ValueError, match="component"):
        rigged.slide(0, 99, 0.5)


def test_what_a_slider_moves_and_its_share_of_the_motion(session, rigged, parts):
    _, model, rig = parts
    np.testing.assert_allclose(rigged.moved_by(0), rig.deltas, atol=1e-9)
    assert rigged.shares(0) is None
    before = session.vertices
    moved, shares = session.moved_by(2), session.shares(2)
    assert shares.sum() == pytest.approx(1) and (np.diff(shares) <= 0).all()
    np.testing.assert_array_equal(session.vertices, before)
    session.apply(np.eye(model.n_coefficients)[model.slices[2].start] * 1.0)
    one = session.vertices - session.neutral.vertices
    scale = np.linalg.norm(moved[0]) / np.linalg.norm(one)
    np.testing.assert_allclose(moved[0], scale * one, atol=1e-9)


def test_one_side_is_copied_onto_the_other_and_the_midline_leans_no_more(parts, rng):
    mesh, _, rig = parts
    session = PosingSession(rig, mesh)
    partners = session.partners
    twins = [d[partners] * [-1, 1, 1] for d in rig.deltas]
    both = BlendshapeRig(mesh, "abcdefghABCDEFGH", np.concatenate([rig.deltas, twins]) / 40)
    session = PosingSession(both, mesh)
    session.apply(rng.uniform(0.2, 0.5, 16))
    x = session.vertices - mesh.vertices
    left = mesh.vertices[:, 0] > mesh.vertices[partners, 0]
    session.copy_side("left")
    y = session.vertices - mesh.vertices
    np.testing.assert_allclose(y[partners] * [-1, 1, 1], y, atol=0.02)
    assert np.abs(y - x)[left].mean() < 0.5 * np.abs(y - x)[partners[left]].mean()
    session.undo()
    np.testing.assert_allclose(session.vertices - mesh.vertices, x, atol=1e-12)
    with pytest.raises(ValueError, match="side"):
        session.copy_side("top")


def test_history_goes_to_any_step_and_tells_once(session):
    told = []
    session.observe(told.append)
    faces = [session.vertices]
    for vertex in (17, 40, 90):
        session.pull(vertex, session.vertices[vertex] + [0, 0, 3.0])
        faces.append(session.vertices)
    told.clear()
    for place in (0, 3, 1, 2):
        session.history.go(place)
        assert session.n_undo == place and len(session.history.line) == 4
        assert session.history.line[place] is session.state
        np.testing.assert_array_equal(session.vertices, faces[place])
    assert told == ["step"] * 4
    with pytest.raises(ValueError, match="place=4"):
        session.history.go(4)
