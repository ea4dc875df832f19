"""The views without a browser: traits are set as the page would, buffers are read back."""

import io
import itertools
from datetime import datetime
from types import SimpleNamespace

import matplotlib.image
import numpy as np
import pytest
from hand import drawn, hover, let_go, move, press
from planted import bumps, quarters
from shapes import grid_mesh

from facelab.files.meshes import read_mesh
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import Lining
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions
from facelab.widgets import FaceView, PosingLab
from facelab.widgets.in_touch import keep_free
from facelab.widgets.parts import Keys
from facelab.widgets.thumbnail import Thumbnails

FAR = np.array([300.0, -200.0, 150.0])


@pytest.fixture
def models(rng):
    mesh, labels = quarters()
    X = bumps(mesh, labels, rng)
    deltas = X.reshape(len(X), -1, 3)[:4]
    return {
        "region": RegionModel(Regions(labels, mesh), 6).fit(X),
        "holistic": HolisticModel(6).fit(X),
        "rig": BlendshapeRig(mesh, "abcd", deltas),
    }


@pytest.fixture
def lab(models, rng, tmp_path):
    mesh = models["rig"].neutral
    walk = mesh.vertices + np.cumsum(rng.normal(size=(20, 1, 3)), axis=0)
    takes = {"walk": MotionSequence(walk, 25.0, mesh)}
    session = PosingSession(models["region"], mesh)
    return PosingLab(session, models, takes=takes, folder=tmp_path)


def skin_of(view):
    return view._color.array[: view.mesh.n_vertices]


def drag(lab, vertex, offset, view=None):
    press(view or lab.view, vertex)
    move(view or lab.view, offset)


def pull(lab, vertex, offset, **kwargs):
    drag(lab, vertex, offset, **kwargs)
    let_go(kwargs.get("view") or lab.view)


def on_row(lab, do, vertex):
    """Press a button of a pin's row."""
    lab.pose.pins._handle_custom_msg({"do": do, "item": vertex}, [])


def press_key(lab, key):
    lab.keys._handle_custom_msg({"key": key}, [])


# --- the face on screen ---------------------------------------------------------------------------


def test_the_buffers_hold_the_face_on_screen(lab):
    mesh = lab.session.neutral
    np.testing.assert_allclose(drawn(lab.view), mesh.vertices, atol=1e-4)
    np.testing.assert_allclose(lab.view._normal.array[: mesh.n_vertices], mesh.normals, atol=1e-6)


def test_while_a_vertex_is_pulled_the_page_draws_the_session_s_face_from_one_answer(lab):
    offset = np.array([2.0, 1.0, 3.0])
    before = lab.view._position.array
    drag(lab, 17, offset)
    assert lab.view._position.array is before, "no face is sent while the mouse moves"
    assert np.abs(lab.session.vertices - lab.session.neutral.vertices).max() > 1
    # float32 of positions up to 100 mm, summed: 1e-3 mm is far below what can be seen
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-3)
    let_go(lab.view)
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-4)
    assert lab.view._position.array.shape == before.shape, "buffers must keep their shape"
    assert list(lab.session.pins) == [17] and not lab.undo.disabled


def test_what_the_page_draws_is_right_at_a_second_drag_too(lab):
    pull(lab, 17, [2.0, 0, 1])
    drag(lab, 90, [0, -3.0, 1])
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-3)


@pytest.mark.parametrize("how", ["rig", "limit"])
def test_where_the_pose_is_not_affine_the_page_solves_and_draws_the_same(lab, how):
    if how == "rig":
        lab.model_choice.value = "rig"
    else:
        lab.pose.limit.value = True
        assert lab.session.limit == 3
    for offset in ([2.0, 1.0, 3.0], [0, 0, 12.0]):
        before = lab.view._position.array
        drag(lab, 17, offset)
        moved = lab.session.vertices
        assert np.abs(moved - lab.session.neutral.vertices).max() > 0.1
        assert lab.view._position.array is before
        np.testing.assert_allclose(drawn(lab.view), moved, atol=1e-3)
        lab.view.end_drag()
        lab.session.cancel()
    drag(lab, 17, offset)
    let_go(lab.view)
    np.testing.assert_allclose(drawn(lab.view), moved, atol=1e-4)


@pytest.mark.parametrize("how", ["rig", "limit"])
def test_a_face_too_large_for_the_page_to_solve_is_sent_whole(lab, how, monkeypatch):
    monkeypatch.setattr("facelab.posing.solver.LARGEST_BASIS", 0)
    if how == "rig":
        lab.model_choice.value = "rig"
    else:
        lab.pose.limit.value = True
    drag(lab, 17, [2.0, 1.0, 3.0])
    moved = lab.session.vertices
    assert np.abs(moved - lab.session.neutral.vertices).max() > 0.1
    np.testing.assert_allclose(drawn(lab.view), moved, atol=1e-4)


def test_the_place_of_the_release_counts_and_moves_before_it_need_not_arrive(lab):
    at = lab.session.neutral.vertices[17]
    press(lab.view, 17)
    let_go(lab.view, [1.25, 3.0, 2.0])
    np.testing.assert_allclose(lab.session.pins[17], at + [1.25, 3.0, 2.0], atol=1e-12)


def test_what_belongs_to_another_press_is_not_heard(lab):
    old = press(lab.view, 17)
    lab.view.end_drag()
    lab.session.cancel()
    press(lab.view, 90)
    for do in ("move", "release"):
        lab.view._hear({"do": do, "press": old, "offset": [5.0, 5, 5]})
    assert lab.view.dragging and list(lab.session.pins) == [90]
    let_go(lab.view, [1.0, 0, 0])
    assert list(lab.session.pins) == [90]


@pytest.mark.parametrize("order", list(itertools.permutations(["press", "move", "release"])))
def test_a_pull_ends_where_it_was_let_go_in_whatever_order_its_messages_come(lab, order):
    at = lab.session.neutral.vertices[17]
    told = {
        "press": {},
        "move": {"offset": [1.0, 1, 1]},
        "release": {"offset": [1.25, 3.0, 2.0]},
    }
    for do in order:
        lab.view._hear({"do": do, "press": "p", "vertex": 17, **told[do]})
    assert not lab.view.dragging and not lab.session.dragging
    assert lab.session.n_undo == 1 and lab.view._hand.settled == "p"
    np.testing.assert_allclose(lab.session.pins[17], at + [1.25, 3.0, 2.0], atol=1e-12)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_two_pulls_both_count_in_whatever_order_their_messages_come(lab, order):
    rest = lab.session.neutral.vertices
    first, second = ({"press": name, "vertex": v} for name, v in (("a", 17), ("b", 90)))
    let_go_first = {"do": "release", "offset": [1.0, 2.0, 3.0], **first}
    messages = (
        {"do": "press", **first},
        let_go_first,
        {"do": "press", "before": [let_go_first], **second},
        {"do": "release", "before": [let_go_first], "offset": [0.0, -1.0, 0.0], **second},
    )
    for k in order:
        lab.view._hear(messages[k])
    assert not lab.view.dragging and lab.session.n_undo == 2
    pins = lab.session.pins
    assert set(pins) == {17, 90}
    np.testing.assert_allclose(pins[17], rest[17] + [1.0, 2.0, 3.0], atol=1e-12)


def test_the_page_is_told_when_a_press_has_been_dealt_with(lab):
    first = press(lab.view, 17)
    assert lab.view._hand.settled != first
    let_go(lab.view)
    assert lab.view._hand.settled == first and not lab.view.dragging
    second = press(lab.view, 17)
    lab.view.end_drag()
    assert lab.view._hand.settled == second


def test_the_page_has_a_name_for_each_vertex(models, rng):
    mesh = models["rig"].neutral
    marked = TriangleMesh(mesh.vertices, mesh.faces, {"brow_left_3": 14})
    lab = PosingLab(PosingSession(models["holistic"], marked))
    names = lab.view.names
    assert names[14] == "brow left 3" == lab.name_of(14)
    far = int(np.linalg.norm(mesh.vertices - mesh.vertices[14], axis=1).argmax())
    assert names[far] == lab.name_of(far) == f"vertex {far}"
    with pytest.raises(ValueError, match="2 names"):
        lab.view.names = ["a", "b"]


def test_two_linked_views_share_the_camera_and_refuse_other_proportions(grid):
    a = FaceView(grid, width=300, height=300)
    b = FaceView(grid, width=150, height=150, linked_to=a)
    assert b._camera is a._camera
    assert b._orbit is a._orbit and a._orbit in b.widget.children[0].controls
    far = FaceView(grid.with_vertices(grid.vertices + FAR), width=300, height=300, linked_to=a)
    np.testing.assert_allclose(far.project(grid.vertices + FAR), a.project(grid.vertices))
    with pytest.raises(ValueError, match="same proportions"):
        FaceView(grid, width=300, height=150, linked_to=a)


def test_pins_are_told_by_vertex_target_and_colour(grid):
    view = FaceView(grid)
    view.show_pins({3: grid.vertices[3] + 1, 5: grid.vertices[5]}, [(1.0, 0, 0), (0, 0, 1.0)])
    first, second = view._hand.pins
    assert (first[0], first[2]) == (3, "#ff0000") and (second[0], second[2]) == (5, "#0000ff")
    np.testing.assert_array_equal(first[1], grid.vertices[3] + 1)
    view.show_pins({})
    assert view._hand.pins == []


def test_points_are_projected_as_the_camera_sees_them(grid):
    view = FaceView(grid, width=400, height=400)
    middle = grid.vertices.mean(axis=0)
    np.testing.assert_allclose(view.project(middle), [[0.5, 0.5]], atol=1e-9)
    left, up = view.project(middle + [[1, 0, 0], [0, 1, 0]])
    assert left[0] > 0.5 and up[1] < 0.5
    assert left[0] - 0.5 == pytest.approx(0.5 - up[1])


def test_a_face_anywhere_stands_in_the_middle_without_a_message_to_the_page(grid, monkeypatch):
    def sent(widget, *_, **__):
        pytest.fail(f"{widget!r} was sent a message: one sent before the page is there gets lost")

    monkeypatch.setattr("pythreejs._base.Three.ThreeWidget.exec_three_obj_method", sent)
    here, there = (FaceView(grid.with_vertices(grid.vertices + by)) for by in (0 * FAR, FAR))
    assert there._orbit.target == (0, 0, 0), "what the controls look at as they are made"
    assert there._camera.position == here._camera.position
    (head,) = (part for part in there._scene.children if there._face in part.children)
    V = there.vertices + head.position
    np.testing.assert_allclose(V.min(axis=0), -V.max(axis=0), atol=1e-9)
    np.testing.assert_allclose(there.project(grid.vertices + FAR), here.project(grid.vertices))


@pytest.fixture
def mouth():
    """A grid with a hole in it, and the vertices around the hole."""
    flat = grid_mesh(6, 6, 10.0)
    hole = np.isin(flat.faces, [14, 15, 20, 21]).all(axis=1)
    return TriangleMesh(flat.vertices, flat.faces[~hole]), [14, 15, 20, 21]


def test_an_opening_is_lined_behind_and_the_lining_follows_its_rim(mouth):
    mesh, rim = mouth
    lining = Lining(mesh)
    V = lining.vertices(mesh.vertices)
    assert lining.faces.max() == len(V) - 1 == len(lining.normals) - 1 == len(lining.colors) - 1
    assert {tuple(v) for v in mesh.vertices[rim]} <= {tuple(v) for v in V}
    assert V[:, 2].max() == 0 and V[:, 2].min() < -3, "it lies behind the face"
    E, e = FaceView(mesh)._riders()
    np.testing.assert_allclose(E @ mesh.vertices + e, V, atol=1e-9)
    posed = mesh.vertices + np.sin(mesh.vertices[:, ::-1])
    np.testing.assert_allclose(E @ posed + e, lining.vertices(posed), atol=1e-9)


def test_a_face_without_openings_has_no_lining(grid):
    assert len(Lining(grid).normals) == 0


def test_a_thumbnail_shows_the_face_it_is_given(mouth):
    mesh, _ = mouth
    small = Thumbnails(mesh, width=60, height=60)

    def picture(V):
        return matplotlib.image.imread(io.BytesIO(small.png(V)))[..., :3]

    rest, moved = picture(mesh.vertices), picture(mesh.vertices + [0, 20.0, 0])
    assert rest.shape == (60, 60, 3)
    middle, background = rest[30, 30], rest[0, 0]
    assert middle.max() < 0.5 < background.min(), "the opening is dark, the page is not"
    assert rest[52, 30].max() > 0.6 and np.allclose(moved[52, 30], background, atol=0.01)


# --- the panel ------------------------------------------------------------------------------------


def test_an_error_in_a_callback_stands_in_the_page_and_the_pose_stays(lab, monkeypatch):
    before = lab.session.vertices

    def boom(*_):
        raise ValueError("a planted <mishap>")

    monkeypatch.setattr(lab.session, "drag", boom)
    drag(lab, 17, [1.0, 1, 1])
    assert "a planted &lt;mishap&gt;" in lab._message.value
    assert not lab.view.dragging
    np.testing.assert_array_equal(lab.session.vertices, before)
    monkeypatch.undo()
    drag(lab, 17, [1.0, 1, 1])
    assert lab._message.value == ""


def test_an_error_after_a_step_says_that_the_step_was_made(lab, monkeypatch):
    def boom(*_):
        raise ValueError("a planted mishap")

    monkeypatch.setattr(lab.shape, "choose_at", boom)
    lab.session.drag(17, lab.session.vertices[17] + [2.0, 0, 0])
    lab.stage._clicking, lab.stage.held = True, 17
    lab.stage._release()
    assert "The step was made." in lab._message.value
    lab.files.name.value = ""
    lab.files.save.click()
    assert "The pose is as it was." in lab._message.value


def test_what_cannot_be_shown_after_a_step_is_told_in_the_page(lab, monkeypatch):
    def boom(*_):
        raise ValueError("a planted mishap")

    monkeypatch.setattr(lab.pose, "refresh", boom)
    lab.session.set(beta=2.0)  # by a script: the edit stands
    assert lab.session.beta == 2
    assert "The step was made." in lab._message.value and "mishap" in lab._message.value
    monkeypatch.undo()
    lab.session.set(beta=3.0)
    assert lab._message.value == ""


def test_buttons_and_sliders_do_what_the_session_does(lab):
    neutral = lab.session.vertices
    pull(lab, 17, [2.0, 2, 2])
    posed = lab.session.vertices
    lab.undo.click()
    np.testing.assert_array_equal(drawn(lab.view), neutral.astype(np.float32))
    lab.redo.click()
    np.testing.assert_allclose(drawn(lab.view), posed, atol=1e-4)
    lab.pose.gamma.value = 1.0
    assert lab.session.gamma == 1.0
    assert np.linalg.norm(lab.session.vertices - neutral) < np.linalg.norm(posed - neutral)
    lab.model_choice.value = "holistic"
    assert lab.session.model is lab.models["holistic"]
    lab.keep.click()
    assert not lab.session.pins
    lab.reset.click()
    np.testing.assert_array_equal(lab.session.vertices, neutral)


def test_beta_can_be_switched_off_and_one_slider_drag_is_one_step(lab):
    pull(lab, 17, [2.0, 2, 2])
    steps = lab.session.n_undo
    for value in (0.25, 0.1, 0.0):
        lab.pose.beta.value = value
    assert lab.session.beta == 0 and lab.session.n_undo == steps + 1
    lab.keys._handle_custom_msg({"press": True}, [])  # the mouse goes down on a slider again
    lab.pose.beta.value = 0.5
    assert lab.session.n_undo == steps + 2
    lab.undo.click()
    lab.undo.click()
    assert lab.session.beta == 0.5 == lab.pose.beta.value


@pytest.mark.parametrize(("beta", "gamma"), [(0, 0.025), (1000, 100), (0.5, 1e-9), (0.123, 0.5)])
def test_values_that_are_not_on_the_sliders_are_given_a_place_there(lab, beta, gamma):
    session = PosingSession(lab.session.model, lab.session.neutral, beta=beta, gamma=gamma)
    other = PosingLab(session)
    assert (other.pose.beta.value, other.pose.gamma.value) == (beta, gamma)
    assert not session.can_undo
    numbers = [x for _, x in other.pose.beta.options]
    assert numbers == sorted(numbers)


def test_each_pin_has_a_row_whose_buttons_weight_lock_mirror_and_remove_it(lab):
    session = lab.session
    for vertex in (17, 90):
        pull(lab, vertex, [1.0, 1, 1])
    first, second = lab.pose.pins.items
    assert (first["id"], second["id"]) == (17, 90) and "short of its target" in first["tip"]
    short = np.linalg.norm(session.pins[17] - session.vertices[17])
    assert first["note"] == f"{short:.1f} mm"
    on_row(lab, "weight", 17)
    assert session.pin_weights[17] == 10
    on_row(lab, "weight", 17)
    assert session.pin_weights[17] == 0.1
    on_row(lab, "lock", 17)
    assert session.locked == {17}
    on_row(lab, "remove", 17)
    assert "locked" in lab._message.value and 17 in session.pins
    on_row(lab, "mirror", 90)
    assert int(session.partners[90]) in session.pins
    on_row(lab, "remove", 90)
    assert 90 not in session.pins and len(lab.pose.pins.items) == 2


def test_a_locked_pin_is_not_dragged_and_the_page_says_why(lab):
    pull(lab, 17, [1.0, 1, 1])
    on_row(lab, "lock", 17)
    before = lab.session.vertices
    pull(lab, 17, [3.0, 1, 1])
    assert "locked pin" in lab._message.value
    np.testing.assert_array_equal(lab.session.vertices, before)


def test_symmetric_drags_pull_both_sides_and_are_drawn_so(lab):
    lab.pose.symmetric.value = True
    drag(lab, 17, [2.0, 1.0, 1.0])
    partner = int(lab.session.partners[17])
    assert partner not in (-1, 17)
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-3)
    let_go(lab.view)
    moved = lab.session.pins[partner] - lab.session.neutral.vertices[partner]
    np.testing.assert_allclose(moved, [-2, 1, 1], atol=1e-9)


def test_colours_follow_the_regions_and_go_again(lab):
    plain = lab.view._color.array.copy()
    lab.stage.paint.value = "regions"
    labels = lab.session.model.regions.labels
    for region in (2, 0):
        lab.shape.regions._handle_custom_msg({"do": "choose", "item": region}, [])
        outline = skin_of(lab.view).max(axis=1) < 0.11
        a, b = lab.session.neutral.edges.T
        rim = {*a[labels[a] != labels[b]], *b[labels[a] != labels[b]]}
        np.testing.assert_array_equal(
            np.flatnonzero(outline), sorted(v for v in rim if labels[v] == region)
        )
        inside = np.unique(skin_of(lab.view)[~outline], axis=0)
        assert len(inside) == len(np.unique(labels))
    lab.stage.paint.value = "skin"
    np.testing.assert_array_equal(lab.view._color.array, plain)


def test_gaps_are_dark_where_regions_disagree_and_plain_inside_them(lab):
    lab.pose.beta.value = 0.0
    pull(lab, 65, [0.0, 0, 8.0])  # beside a border of two regions
    lab.stage.paint.value = "gaps"
    gaps = lab.session.gaps()
    assert gaps.max() > 0.1 and f"{gaps.max():.2f} mm" in lab._status.value
    dark = skin_of(lab.view).sum(axis=1)
    assert dark[gaps.argmax()] < dark[gaps == 0].min()


def test_the_gauge_of_the_region_that_was_pulled_rises(lab):
    before = [row["bar"] for row in lab.shape.regions.items]
    pull(lab, 26, [0.0, 0, 20.0])
    rise = np.array([row["bar"] for row in lab.shape.regions.items]) - before
    assert rise.argmax() == lab.session.region_labels[26]
    lab.stage.paint.value = "plausibility"
    assert len(np.unique(skin_of(lab.view), axis=0)) == 4 + 1  # and the outline of the chosen one


def slide(lab, slider, value):
    slider = f"{slider} {lab.model_name}"
    lab.shape.sliders._handle_custom_msg({"item": slider, "value": value, "asked": 1}, [])


def test_the_sliders_of_a_region_mold_it_and_have_its_colour(lab):
    lab.shape.regions._handle_custom_msg({"do": "choose", "item": 2}, [])
    sliders = lab.shape.sliders
    assert sliders.color == lab.shape.regions.items[2]["color"]
    lab.shape.mold.value = True
    assert lab.session.beta < 0.05 and lab.session.gamma > 0.5
    steps = lab.session.n_undo
    for value in (0.5, 1.0, 2.0):
        slide(lab, "2 0", value)
    assert lab.session.n_undo == steps + 1
    assert lab.session.slider_values(2)[0] == pytest.approx(2.0)
    moved = np.linalg.norm(lab.session.vertices - lab.session.neutral.vertices, axis=1)
    labels = lab.session.region_labels
    assert moved[labels == 2].max() > 5 * moved[labels == 1].max()
    lab.shape.neutral.click()
    assert sliders.values == list(lab.session.slider_values(2))
    assert abs(sliders.values[0]) < 0.1, "what neighbours hold it to"
    lab.shape.mold.value = False
    assert (lab.session.beta, lab.session.gamma) == (0.5, 0.025)


def test_the_rig_has_its_units_as_sliders_and_no_gauge(lab):
    lab.model_choice.value = "rig"
    assert [item["name"] for item in lab.shape.sliders.items] == list("abcd")
    assert "bar" not in lab.shape.regions.items[0]
    slide(lab, "0 1", 0.8)
    np.testing.assert_allclose(lab.session.coefficients, [0, 0.8, 0, 0], atol=1e-9)


def test_regions_are_named_as_their_places_are(lab):
    names = [row["name"] for row in lab.shape.regions.items]
    assert names == lab.places.regions(lab.session.region_labels)
    lab.model_choice.value = "holistic"
    assert [row["name"] for row in lab.shape.regions.items] == ["whole face"]


# --- side by side, and in step --------------------------------------------------------------------


def test_another_model_answers_the_same_pins_beside_the_first(lab, models):
    pull(lab, 17, [2.0, 1, 3])
    lab.stage.beside.value = "holistic"
    a, b = (drawn(view) for view in (lab.view, lab.stage.other_view))
    alone = PosingSession(models["holistic"], lab.session.neutral)
    alone.set_pin(17, lab.session.pins[17])
    np.testing.assert_allclose(a, lab.session.vertices, atol=1e-4)
    np.testing.assert_allclose(b, alone.vertices, atol=1e-4)
    for view in (lab.view, lab.stage.other_view):  # dragged in either, the pin is the same in both
        pull(lab, 90, [1.0, 2, 0], view=view)
        alone.set_pin(90, lab.session.pins[90])
        np.testing.assert_allclose(drawn(lab.stage.other_view), alone.vertices, atol=1e-4)
    lab.stage.beside.value = lab.stage.beside.options[0]
    assert lab.stage.widget.children[1].layout.visibility == "hidden"
    assert lab.view._hand.size == list(lab.size)


@pytest.mark.parametrize("other", ["holistic", "rig"])
def test_both_views_follow_while_the_mouse_moves(lab, other):
    lab.stage.beside.value = other
    drag(lab, 17, [2.0, 1, 3])
    shown = [drawn(view) for view in (lab.view, lab.stage.other_view)]
    let_go(lab.view)
    for before, view in zip(shown, (lab.view, lab.stage.other_view), strict=True):
        np.testing.assert_allclose(before, drawn(view), atol=1e-3)


def test_two_labs_of_one_session_and_a_script_stay_in_step(lab):
    twin = PosingLab(lab.session, lab.models)
    drag(lab, 17, [2.0, 1, 3])
    np.testing.assert_allclose(drawn(twin.view), lab.session.vertices, atol=1e-4)
    let_go(lab.view)
    np.testing.assert_array_equal(drawn(twin.view), drawn(lab.view))
    assert [row["id"] for row in twin.pose.pins.items] == [17]
    twin.undo.click()
    np.testing.assert_array_equal(drawn(lab.view), drawn(twin.view))
    assert lab.undo.disabled
    lab.session.drag(90, lab.session.neutral.vertices[90] + [0, 0, 4])
    lab.session.release()
    lab.session.set(beta=0.25)
    for each in (lab, twin):
        np.testing.assert_allclose(drawn(each.view), lab.session.vertices, atol=1e-4)
        assert each.pose.beta.value == 0.25


def test_a_model_that_a_script_brings_is_shown_too(lab, rng):
    mesh, labels = quarters()
    lab.session.use(HolisticModel(3).fit(bumps(mesh, labels, rng)))
    assert lab.model_choice.value == "other"


# --- keys -----------------------------------------------------------------------------------------


def test_keys_do_what_the_list_says(lab):
    pull(lab, 17, [2.0, 1, 3])
    for key, pins in (("z", []), ("y", [17]), ("Ctrl+z", []), ("Ctrl+y", [17]), ("k", [])):
        press_key(lab, key)
        assert list(lab.session.pins) == pins
    press_key(lab, "s")
    assert lab.session.symmetric
    press_key(lab, "n")
    assert lab.view.along_normal
    press_key(lab, "m")
    assert lab.model_choice.value == "holistic"
    press_key(lab, "c")
    assert lab.stage.beside.value != lab.stage.beside.options[0]
    hover(lab.view, 30)
    press_key(lab, "h")
    assert list(lab.session.pins) == [30]
    press_key(lab, "l")
    press_key(lab, "l")
    press_key(lab, "x")
    assert not lab.session.pins
    press_key(lab, "p")
    assert list(lab.strip.poses) == ["neutral", "pose 1"]


def test_the_camera_can_be_sent_to_the_front_and_the_sides(lab):
    view = lab.view
    away = view._camera.position
    press_key(lab, "2")
    right, _, back = view._axes()
    np.testing.assert_allclose(back, [0.5**0.5, 0, 0.5**0.5], atol=1e-9)
    assert right @ [0, 0, 1] < 0, "seen from the person's left"
    press_key(lab, "1")
    np.testing.assert_allclose(view._camera.position, away, atol=1e-9)


def test_escape_gives_up_a_drag(lab):
    before = lab.session.vertices
    drag(lab, 17, [2.0, 1, 3])
    press_key(lab, "Escape")
    assert not lab.view.dragging
    np.testing.assert_allclose(drawn(lab.view), before, atol=1e-4)
    let_go(lab.view)
    assert not lab.session.pins


@pytest.mark.parametrize("how", ["key", "button", "session"])
def test_undo_gives_up_a_drag_for_good_and_undoes_nothing_else(lab, how):
    pull(lab, 90, [0, 0, 2.0])
    before = lab.session.vertices
    drag(lab, 17, [2.0, 1, 3])
    {
        "key": lambda: press_key(lab, "z"),
        "button": lab.undo.click,
        "session": lab.session.undo,
    }[how]()
    assert not lab.view.dragging
    move(lab.view, [3.0, 1, 3])
    np.testing.assert_allclose(drawn(lab.view), before, atol=1e-4)
    let_go(lab.view)
    assert list(lab.session.pins) == [90] and lab.session.n_undo == 1


def test_redo_gives_up_a_drag_for_good_too(lab):
    pull(lab, 90, [0, 0, 2.0])
    redone = lab.session.vertices
    lab.session.undo()
    drag(lab, 17, [2.0, 1, 3])
    press_key(lab, "y")
    assert "Your pull was given up" in lab._status.value
    move(lab.view, [3.0, 1, 3])
    let_go(lab.view)
    np.testing.assert_allclose(drawn(lab.view), redone, atol=1e-4)
    assert list(lab.session.pins) == [90] and lab.session.n_undo == 1


@pytest.mark.parametrize("key", ["x", "Delete"])
def test_the_pin_of_the_point_is_removed_by_key_and_what_is_none_is_told_by_name(lab, key):
    lab.session.pull(17, lab.session.neutral.vertices[17] + [0, 0, 2.0])
    lab.session.set_pin(17, name="tip")
    hover(lab.view, 18)
    press_key(lab, key)
    assert "the point under the mouse is not pinned; pinned are: tip." in lab._message.value
    hover(lab.view, 17)
    press_key(lab, key)
    assert not lab.session.pins and lab._message.value == ""


def test_a_key_that_wants_a_point_says_so_where_there_is_none(lab):
    press_key(lab, "h")
    assert "no point of the face" in lab._message.value


def test_every_key_that_is_heard_is_listed_in_the_page(lab):
    listed = next(w.value for w in lab._panel.children if "<details" in getattr(w, "value", ""))
    for key in lab.keys.heard:
        name = {"Escape": "Esc"}.get(key, key.removeprefix("Ctrl+"))
        assert f"<b>{name if len(name) > 1 else name.upper()}</b>" in listed
    assert isinstance(lab.keys, Keys)


# --- poses, clips, files --------------------------------------------------------------------------


def test_the_strip_keeps_poses_as_pictures_and_goes_back_to_them(lab):
    neutral = lab.session.vertices
    pull(lab, 17, [2.0, 1, 9])
    lab.strip.name.value = "bump"
    lab.strip.keep.click()
    posed = lab.session.vertices
    first, second = lab.strip.strip.items
    assert (first["name"], second["name"]) == ("neutral", "bump")
    assert first["picture"] != second["picture"]
    lab.strip.strip._handle_custom_msg({"do": "choose", "item": "neutral"}, [])
    np.testing.assert_array_equal(lab.session.vertices, neutral)
    lab.strip.strip._handle_custom_msg({"do": "choose", "item": "bump"}, [])
    np.testing.assert_array_equal(lab.session.vertices, posed)
    lab.strip.strip._handle_custom_msg({"do": "remove", "item": "neutral"}, [])
    assert list(lab.strip.poses) == ["bump"]


def test_the_blend_slider_goes_from_one_pose_to_another_in_one_step(lab):
    neutral = lab.session.vertices
    pull(lab, 17, [2.0, 1, 3])
    lab.strip.add("bump")
    posed = lab.session.vertices
    lab.strip.a.value, lab.strip.b.value = "neutral", "bump"
    steps = lab.session.n_undo
    for share in (0.2, 0.5):
        lab.strip.share.value = share
    np.testing.assert_allclose(lab.session.vertices, (neutral + posed) / 2, atol=1e-9)
    lab.strip.share.value = 1.0
    np.testing.assert_allclose(lab.session.vertices, posed, atol=1e-9)
    assert lab.session.n_undo == steps + 1


def test_a_clip_of_two_keys_is_scrubbed_and_its_frames_can_be_posed(lab):
    neutral = lab.session.vertices
    lab.clip.key.click()
    lab.clip.slider.value = 50
    pull(lab, 17, [2.0, 1, 3])
    lab.clip.key.click()
    posed = lab.session.vertices
    assert [row["name"] for row in lab.clip.keys.items] == ["key at 0.00 s", "key at 2.00 s"]
    lab.clip.slider.value = 25
    np.testing.assert_allclose(drawn(lab.view), (neutral + posed) / 2, atol=1e-4)
    assert lab.view._hand.pins == [], "a frame of the clip has no pins"
    drag(lab, 90, [1.0, 1, 1])  # taking hold of the frame makes it the pose
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-3)
    let_go(lab.view)
    lab.clip.keys._handle_custom_msg({"do": "choose", "item": 0}, [])
    np.testing.assert_allclose(drawn(lab.view), neutral, atol=1e-4)
    lab.clip.keys._handle_custom_msg({"do": "remove", "item": 0}, [])
    assert len(lab.clip.clip.times) == 1
    lab.clip.stop.click()
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-4)


def test_a_take_is_played_through_the_model_with_the_pose_on_top(lab):
    session, take = lab.session, lab.takes["walk"]
    lab.clip.source.value = "walk"
    lab.clip.slider.value = 7
    plain = session.vertices_of(session.encode(take)[7])
    np.testing.assert_allclose(drawn(lab.view), plain, atol=1e-4)
    drag(lab, 17, [2.0, 1, 3])
    offset = session.vertices - session.neutral.vertices
    np.testing.assert_allclose(drawn(lab.view), plain + offset, atol=1e-3)
    let_go(lab.view)
    np.testing.assert_allclose(drawn(lab.view), plain + offset, atol=1e-4)
    lab.clip.slider.value = 12
    later = session.vertices_of(session.encode(take)[12])
    np.testing.assert_allclose(drawn(lab.view), later + offset, atol=1e-4)
    lab.clip.pose_it.click()
    np.testing.assert_allclose(lab.session.vertices, later + offset, atol=1e-9)


def test_what_is_kept_of_a_frame_of_a_take_is_the_frame_with_the_pose_on_top(lab, tmp_path):
    session = lab.session
    pull(lab, 17, [2.0, 1, 3])
    pose = session.state
    lab.clip.source.value = "walk"
    lab.clip.slider.value = 12
    shown = lab.vertices
    assert np.abs(shown - session.vertices).max() > 1
    lab.strip.add("walking")
    np.testing.assert_allclose(session.vertices_in(lab.strip.poses["walking"]), shown, atol=1e-9)
    for button in (lab.files.save, lab.files.ply):
        button.click()
    saved = read_mesh(tmp_path / "pose.ply").vertices
    np.testing.assert_allclose(saved, shown, atol=1e-3)
    assert session.state is pose and lab.frame is not None, "the lab goes on as it was"
    lab.files.load.click()
    np.testing.assert_allclose(session.vertices, shown, atol=1e-9)


def test_a_pose_of_the_library_is_shown_in_place_of_a_frame_even_if_it_is_the_pose_already(lab):
    lab.clip.key.click()
    pull(lab, 17, [2.0, 1, 3])
    lab.strip.add("bump")
    lab.clip.slider.value = 10
    assert lab.strip.strip.chosen == -1, "what is on screen is none of the library"
    lab.strip.strip._handle_custom_msg({"do": "choose", "item": "bump"}, [])
    np.testing.assert_allclose(drawn(lab.view), lab.session.vertices, atol=1e-4)
    assert lab.frame is None and lab.strip.strip.chosen == 1


def test_a_pose_saved_by_name_is_loaded_in_another_lab(lab, tmp_path):
    pull(lab, 17, [2.0, 1, 3])
    lab.files.name.value = "smirk"
    lab.files.save.click()
    assert (tmp_path / "smirk.json").exists() and "Download" in lab.files._result.value
    other = PosingLab(
        PosingSession(lab.session.model, lab.session.neutral), lab.models, folder=tmp_path
    )
    assert "smirk" in other.files.name.options
    other.files.name.value = "smirk"
    other.files.load.click()
    np.testing.assert_allclose(other.session.vertices, lab.session.vertices, atol=1e-9)
    np.testing.assert_allclose(drawn(other.view), lab.session.vertices, atol=1e-4)


def test_an_uploaded_pose_is_opened_and_a_damaged_one_is_refused(lab, tmp_path):
    pull(lab, 17, [2.0, 1, 3])
    posed = lab.session.vertices
    lab.files.save.click()
    content = (tmp_path / "pose.json").read_bytes()
    lab.reset.click()

    def send(content):
        file = dict(name="mine.json", type="", size=len(content), content=content)
        lab.files.upload.value = ({**file, "last_modified": datetime.now()},)

    send(content[: len(content) // 2])
    assert "That did not work" in lab._message.value and not lab.session.pins
    send(content)
    np.testing.assert_allclose(lab.session.vertices, posed, atol=1e-9)


@pytest.mark.parametrize(
    ("button", "file"),
    [("obj", "pose.obj"), ("ply", "pose.ply"), ("glb", "pose.glb"), ("clip_glb", "pose.clip.glb")],
)
def test_meshes_and_clips_are_exported(lab, tmp_path, button, file):
    lab.clip.key.click()
    lab.clip.slider.value = 25
    pull(lab, 17, [2.0, 1, 3])
    lab.clip.key.click()
    getattr(lab.files, button).click()
    assert lab._message.value == ""
    assert (tmp_path / file).stat().st_size > 1000
    if button != "clip_glb":
        saved = read_mesh(tmp_path / file).vertices
        scale = np.ptp(lab.session.vertices) / np.ptp(saved)  # GLB counts in metres
        np.testing.assert_allclose(saved * scale, lab.session.vertices, atol=1e-2)


def test_a_clip_saved_by_name_is_loaded_again(lab):
    lab.clip.key.click()
    lab.files.save_clip.click()
    lab.clip.set_clip(None)
    lab.files.load_clip.click()
    assert lab.clip.clip is not None and lab.clip.clip.times[0] == 0


def test_a_clip_stays_with_the_model_that_made_it(lab, tmp_path):
    pull(lab, 17, [2.0, 2, 2])
    lab.clip.key.click()
    clip, made_by = lab.clip.clip, lab.session.model
    lab.session.use(lab.models["holistic"])
    for button in (lab.clip.key, lab.files.save_clip, lab.files.clip_glb):
        button.click()
        assert "key poses are of another model; choose that model" in lab._message.value
        assert lab.clip.clip is clip and lab.clip.model is made_by
    lab.clip.easing.value = "linear"
    assert lab.clip.model is made_by
    assert list(tmp_path.iterdir()) == []
    lab.session.use(made_by)
    lab.files.save_clip.click()
    assert [p.name for p in tmp_path.iterdir()] == ["pose.clip.json"]


def test_files_are_offered_by_the_names_they_were_given(lab):
    lab.clip.key.click()
    for name in ("smile", "frown"):
        lab.files.name.value = name
        lab.files.save_clip.click()
    lab.files.save.click()
    assert list(lab.files.name.options) == ["frown", "smile"]


def test_blending_on_an_empty_strip_says_so(lab):
    lab.strip._react("remove", "neutral")
    lab.strip.share.value = 0.5
    assert "the library is empty; add the poses to blend first" in lab._message.value


def test_playing_without_keys_and_files_without_a_name_are_refused_in_words(lab):
    lab.clip.slider.value = 3
    assert "no key pose yet" in lab._message.value
    lab.files.save_clip.click()
    assert "no clip yet" in lab._message.value
    lab.files.name.value = " "
    lab.files.save.click()
    assert "The name is empty" in lab._message.value


def test_the_lab_refuses_what_is_no_session_and_models_without_the_session_s_own(lab):
    with pytest.raises(TypeError, match="PosingSession"):
        PosingLab("session")
    with pytest.raises(ValueError, match="own model"):
        PosingLab(lab.session, {"other": lab.models["holistic"]})


def test_a_thousand_edits_leave_no_widgets_behind(lab):
    from ipywidgets.widgets.widget import _instances

    def edit(k):
        lab.session.drag(17 + k % 3, lab.session.neutral.vertices[17 + k % 3] + [0, 0, 1 + k % 4])
        lab.session.release()

    for k in range(20):
        edit(k)
    before = len(_instances)
    for k in range(100):
        edit(k)
    assert len(_instances) == before


def test_a_slider_that_the_page_still_shows_but_the_lab_does_not_is_no_edit(models):
    lab = PosingLab(PosingSession(models["holistic"], models["rig"].neutral))
    lab.session.pull(14, lab.session.vertices[14] + [0, 0, 3.0])
    steps, posed = lab.session.n_undo, lab.session.vertices
    slide(lab, "1 0", 1.0)
    assert lab.session.n_undo == steps
    np.testing.assert_array_equal(lab.session.vertices, posed)


def test_controls_of_a_face_that_came_later_answer_while_a_cell_runs_too(lab, models, monkeypatch):
    kept = []
    monkeypatch.setattr("facelab.widgets.lab.keep_free", kept.append)
    lab.take_up(PosingSession(models["rig"], lab.mesh))
    assert kept == [lab.widget] and lab.undo in _inside(lab.widget)


def test_a_part_and_all_in_it_is_heard_by_the_thread_that_the_page_names():
    def part(*children):
        comm = SimpleNamespace(_reply_subshell_for=lambda _, named: "that of a cell")
        return SimpleNamespace(comm=comm, children=children)

    button = part()
    keep_free(part(part(button)))
    assert button.comm._reply_subshell_for({}, "that of the page") == "that of the page"


def _inside(part):
    return [part, *(x for child in getattr(part, "children", ()) for x in _inside(child))]
