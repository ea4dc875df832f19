"""The views without a browser: traits are set as the page would, buffers are read back."""

import numpy as np
import pytest
from planted import bumps, quarters

from facelab.models import HolisticModel, RegionModel
from facelab.posing import PosingSession
from facelab.segmentation import Regions
from facelab.widgets import FaceView, PosingLab


@pytest.fixture
def lab(rng):
    mesh, labels = quarters()
    regions = Regions(labels, mesh)
    X = bumps(mesh, labels, rng)
    region, holistic = RegionModel(regions, 6).fit(X), HolisticModel(6).fit(X)
    return PosingLab(PosingSession(region, mesh), {"region": region, "holistic": holistic})


def face_of(view):
    """Positions on screen: the base and its three morphs, as three.js adds them."""
    base = view._position.array.astype(float)
    t = view._face.morphTargetInfluences
    moved = base + sum((m.array - base) * w for m, w in zip(view._morphs, t, strict=True))
    return moved[: view.mesh.n_vertices]


def pick(view, picker, vertex, point=None):
    """What the page sends when the mouse does something on a vertex of the face."""
    picker.object = view._face
    picker.face = [float(vertex)] * 3
    picker.point = tuple(view._V[vertex] if point is None else point)


def drag(lab, vertex, offset):
    view = lab.view
    pick(view, view._down, vertex)
    view._moved.object = view._plane
    view._moved.point = tuple(view._grab + offset)


def test_the_buffers_hold_the_face_on_screen(lab):
    mesh = lab.session.neutral
    np.testing.assert_allclose(face_of(lab.view), mesh.vertices, atol=1e-4)
    np.testing.assert_allclose(lab.view._normal.array[: mesh.n_vertices], mesh.normals, atol=1e-6)


def test_a_drag_sends_three_numbers_and_the_page_shows_the_session_s_face(lab):
    offset = np.array([2.0, 1.0, 3.0])
    before = lab.view._position.array.shape
    drag(lab, 17, offset)
    np.testing.assert_allclose(lab.view._face.morphTargetInfluences, offset, atol=1e-9)
    assert np.abs(lab.session.vertices - lab.session.neutral.vertices).max() > 1
    # float32 of positions up to 100 mm, summed: 1e-3 mm is far below what can be seen
    np.testing.assert_allclose(face_of(lab.view), lab.session.vertices, atol=1e-3)
    lab.view._up.point = (1.0, 1.0, 1.0)
    assert lab.view._face.morphTargetInfluences == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(face_of(lab.view), lab.session.vertices, atol=1e-4)
    assert lab.view._position.array.shape == before, "buffers must keep their shape"
    assert list(lab.session.pins) == [17] and not lab.undo.disabled


def test_a_morph_is_exact_at_a_second_drag_too(lab):
    drag(lab, 17, [2.0, 0, 1])
    lab.view._up.point = (1.0, 1.0, 1.0)
    drag(lab, 90, [0, -3.0, 1])
    np.testing.assert_allclose(face_of(lab.view), lab.session.vertices, atol=1e-3)


def test_pressing_the_same_spot_twice_is_noticed_twice(lab):
    for _ in range(2):
        pick(lab.view, lab.view._down, 17, point=(5.0, 5.0, 0.0))
        assert lab.view._dragging
        lab.view._up.point = (1.0, 1.0, 1.0)
        assert not lab.view._dragging


def test_leaving_the_canvas_ends_the_drag(lab):
    drag(lab, 17, [1.0, 1, 1])
    lab.view._left.point = (9.0, 9.0, 9.0)
    assert not lab.view._dragging and list(lab.session.pins) == [17]


def test_hovering_marks_the_vertex_and_keeps_the_camera_still(lab):
    pick(lab.view, lab.view._moved, 30)
    assert lab.view._hover.visible and not lab.view._orbit.enableRotate
    np.testing.assert_allclose(lab.view._hover.position, lab.session.neutral.vertices[30])
    lab.view._moved.object = None
    lab.view._moved.point = (0.0, 0.0, 1.0)
    assert not lab.view._hover.visible and lab.view._orbit.enableRotate


def test_an_error_in_a_callback_stands_in_the_page_and_the_pose_stays(lab, monkeypatch):
    before = lab.session.vertices

    def boom(*_):
        raise ValueError("a planted <mishap>")

    monkeypatch.setattr(lab.session, "drag", boom)
    drag(lab, 17, [1.0, 1, 1])
    assert "a planted &lt;mishap&gt;" in lab._message.value
    assert not lab.view._dragging
    np.testing.assert_array_equal(lab.session.vertices, before)
    monkeypatch.undo()
    drag(lab, 17, [1.0, 1, 1])
    assert lab._message.value == ""


def test_buttons_and_sliders_do_what_the_session_does(lab):
    neutral = lab.session.vertices
    drag(lab, 17, [2.0, 2, 2])
    lab.view._up.point = (1.0, 1.0, 1.0)
    posed = lab.session.vertices
    lab.undo.click()
    np.testing.assert_array_equal(face_of(lab.view), neutral.astype(np.float32))
    lab.redo.click()
    np.testing.assert_allclose(face_of(lab.view), posed, atol=1e-4)
    lab.gamma.value = 1.0
    assert lab.session.gamma == pytest.approx(1.0)
    assert np.linalg.norm(lab.session.vertices - neutral) < np.linalg.norm(posed - neutral)
    lab.model_choice.value = "holistic"
    assert lab.session.model is lab.models["holistic"]
    lab.reset.click()
    np.testing.assert_array_equal(lab.session.vertices, neutral)


def test_each_pin_has_a_row_with_a_button_that_removes_it(lab):
    for vertex in (17, 90):
        drag(lab, vertex, [1.0, 1, 1])
        lab.view._up.point = (float(vertex), 1.0, 1.0)
    first, _ = lab._pin_list.children
    first.children[0].click()
    assert list(lab.session.pins) == [90] and len(lab._pin_list.children) == 1


def test_colours_follow_the_regions_and_go_again(lab):
    plain = lab.view._color.array.copy()
    lab.show_regions.value = True
    painted = lab.view._color.array[: lab.session.neutral.n_vertices]
    labels = lab.session.model.regions.labels
    assert len(np.unique(painted, axis=0)) == len(np.unique(labels))
    lab.show_regions.value = False
    np.testing.assert_array_equal(lab.view._color.array, plain)


def test_there_is_room_for_any_number_of_pins(grid):
    view = FaceView(grid)
    points = np.random.default_rng(0).normal(size=(40, 3))
    view.show_pins(points, points + 1)
    np.testing.assert_allclose(view._ends.array[:80:2], points, atol=1e-6)
    np.testing.assert_allclose(view._ends.array[1:80:2], points + 1, atol=1e-6)
    view.show_pins(points[:0], points[:0])
    assert not view._marks.visible


def test_points_are_projected_as_the_camera_sees_them(grid):
    view = FaceView(grid, width=400, height=400)
    np.testing.assert_allclose(view.project(view._target), [[0.5, 0.5]], atol=1e-9)
    left, up = view.project(view._target + [[1, 0, 0], [0, 1, 0]])
    assert left[0] > 0.5 and up[1] < 0.5
    assert left[0] - 0.5 == pytest.approx(0.5 - up[1])


def test_the_lab_refuses_what_is_no_session_and_models_without_the_session_s_own(lab):
    with pytest.raises(TypeError, match="PosingSession"):
        PosingLab("session")
    with pytest.raises(ValueError, match="own model"):
        PosingLab(lab.session, {"other": lab.models["holistic"]})


@pytest.mark.parametrize(("beta", "gamma"), [(0, 0.025), (1000, 100), (0.5, 1e-9)])
def test_values_beyond_the_sliders_are_shown_at_their_ends_and_kept(lab, beta, gamma):
    session = PosingSession(lab.session.model, lab.session.neutral, beta=beta, gamma=gamma)
    other = PosingLab(session)
    other.refresh()
    other._slide(None)
    assert (session.beta, session.gamma, session.can_undo) == (beta, gamma, False)
    assert np.isfinite([other.beta.value, other.gamma.value]).all()
