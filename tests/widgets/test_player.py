"""The player without a browser: set the slider, read what would be sent to the page."""

import numpy as np
import pytest
from shown import shown

from facelab.geometry.mesh import vertex_normals
from facelab.motion import MarkerSequence, MotionSequence
from facelab.widgets import FaceView, Player


@pytest.fixture
def take(grid, rng):
    """Ten frames of a moving grid with three markers; the second is hidden in frame 4."""
    positions = grid.vertices + rng.normal(size=(10, grid.n_vertices, 3))
    points = positions[:, [0, 7, 20]] + [0, 0, 1.5]
    points[4, 1] = np.nan
    points[9] = np.nan
    valid = np.arange(10) != 6
    positions[6] = np.nan
    return MotionSequence(positions, 60, grid, valid), MarkerSequence(points, "abc", 60)


def skin(player):
    n = player.motion.mesh.n_vertices
    return player.view._position.array[:n]


def cloud(player):
    """Positions of the markers drawn, each once."""
    return np.unique(player.view._points.array, axis=0) if player.view._cloud.visible else []


def test_the_slider_shows_its_frame(take):
    motion, markers = take
    player = Player(motion, markers)
    for frame in (0, 3, 8, 3):
        player.slider.value = frame
        np.testing.assert_allclose(skin(player), motion.positions[frame], atol=1e-5)
        normals = vertex_normals(motion.positions[frame], motion.mesh.faces)
        np.testing.assert_allclose(player.view._normal.array[: len(normals)], normals, atol=1e-5)
        np.testing.assert_allclose(
            cloud(player), np.unique(markers.positions[frame], axis=0), atol=1e-5
        )
    assert "3 of 3 markers" in player._status.value


def test_occluded_markers_are_not_drawn(take):
    motion, markers = take
    player = Player(motion, markers)
    player.slider.value = 4
    seen = np.unique(markers.positions[4, [0, 2]], axis=0)
    np.testing.assert_allclose(cloud(player), seen, atol=1e-5)
    assert "2 of 3 markers" in player._status.value
    player.slider.value = 9
    assert len(cloud(player)) == 0
    player.slider.value = 8
    assert len(cloud(player)) == 3


def test_a_lost_frame_keeps_the_face_before_and_says_so(take):
    motion, _ = take
    player = Player(motion)
    player.slider.value = 5
    player.slider.value = 6
    np.testing.assert_allclose(skin(player), motion.positions[5], atol=1e-5)
    assert "lost" in player._status.value
    player.slider.value = 7
    assert "lost" not in player._status.value


def test_without_markers_none_are_drawn(take):
    player = Player(take[0])
    assert not player.view._cloud.visible
    assert "markers" not in player._status.value


@pytest.mark.parametrize(
    "fps, step, interval", [(120, 5, 42), (60, 2, 33), (25, 1, 40), (10, 1, 100)]
)
def test_it_plays_in_real_time_and_sends_few_frames(take, fps, step, interval):
    motion = MotionSequence(take[0].positions[:5], fps, take[0].mesh)
    player = Player(motion)
    assert (player._play.step, player._play.interval, player._play.max) == (step, interval, 4)
    assert player._link.source == (player._play, "value")
    assert player._link.target == (player.slider, "value")


def test_an_error_is_shown_in_the_page_and_goes_away(take, monkeypatch):
    player = Player(*take)
    before = skin(player).copy()

    def broken(vertices):
        raise RuntimeError("no <paint> left")

    monkeypatch.setattr(player.view, "show", broken)
    player.slider.value = 2
    assert "no &lt;paint&gt; left" in player._message.value
    np.testing.assert_array_equal(skin(player), before)
    monkeypatch.undo()
    player.slider.value = 3
    assert player._message.value == ""


def test_it_refuses_what_it_cannot_play(take):
    motion, markers = take
    with pytest.raises(TypeError, match="motion is a ndarray"):
        Player(motion.positions)
    with pytest.raises(TypeError, match="markers is a ndarray"):
        Player(motion, markers.positions)
    with pytest.raises(ValueError, match="no frames"):
        Player(motion[:0])
    with pytest.raises(ValueError, match="9 frames at 60 a second, but motion has 10"):
        Player(motion, markers[:9])
    with pytest.raises(ValueError, match="10 frames at 30 a second"):
        Player(motion, MarkerSequence(markers.positions, "abc", 30))


def test_points_keep_their_buffer_and_grow_it_where_needed(grid):
    view = FaceView(grid)
    view.show_points(np.ones((4, 3)))
    buffer = view._points
    view.show_points(np.zeros((4, 3)))
    assert view._points is buffer
    view.show_points(np.eye(3).repeat(2, axis=0))
    assert view._points.array.shape == (6, 3)
    view.show_points(np.empty((0, 3)))
    assert not view._cloud.visible
    for wrong in (np.zeros(3), np.zeros((2, 2))):
        with pytest.raises(ValueError, match="must be"):
            view.show_points(wrong)


def test_a_view_that_poses_nothing_leaves_the_mouse_to_the_camera(grid):
    view = FaceView(grid)
    assert not view._hand.grabs
    view.on_press = lambda vertex: None
    assert view._hand.grabs


def test_where_it_does_not_run_a_notebook_has_the_frame_on_screen(take, monkeypatch):
    player = Player(*take)
    _, first, _ = shown(player, monkeypatch)
    player.slider.value = 3
    still, later, _ = shown(player, monkeypatch)
    assert "Press Run" in still and not np.array_equal(first, later)
