import numpy as np
import pytest
from shapes import disk_mesh, grid_mesh

from facelab.geometry.mesh import TriangleMesh
from facelab.posing.sculpt import Sculpt


@pytest.fixture
def sculpt():
    return Sculpt(grid_mesh(21, 21, 5.0), radius=20.0)


def test_the_pulled_vertex_is_where_it_was_pulled_and_the_rest_follows_less_and_less(sculpt):
    target = sculpt.vertices[220] + [1.0, 2.0, 6.0]
    sculpt.drag(220, target)
    moved = np.linalg.norm(sculpt.vertices - sculpt.mesh.vertices, axis=1)
    np.testing.assert_allclose(sculpt.vertices[220], target)
    along_row = moved[220:225]
    assert (np.diff(along_row) < 0).all() and along_row[-1] == 0
    g = np.array([0, 5, 10, 15, 20])
    np.testing.assert_allclose(along_row / along_row[0], (1 - (g / 20) ** 2) ** 2, atol=1e-12)


def test_a_pull_goes_along_the_surface_and_not_across_a_gap():
    lips = disk_mesh(3, 24, inner=1.0, outer=30.0)
    apart = TriangleMesh(
        np.vstack([lips.vertices, lips.vertices + [0, 0, 0.1]]),
        np.vstack([lips.faces, lips.faces + lips.n_vertices]),
    )
    sculpt = Sculpt(apart, radius=25.0)
    sculpt.drag(0, apart.vertices[0] + [0, 0, 5])
    moved = np.linalg.norm(sculpt.vertices - apart.vertices, axis=1)
    assert (moved[: lips.n_vertices] > 0).sum() > 5
    assert (moved[lips.n_vertices :] == 0).all()


def test_the_answer_to_press_tells_every_later_move(sculpt):
    sculpt.drag(60, sculpt.vertices[60] + [0, 0, 3])
    sculpt.release()
    before = sculpt.vertices
    D = sculpt.press(82)
    np.testing.assert_array_equal(sculpt.vertices, before)
    offset = np.array([2.0, -1.0, 4.0])
    sculpt.drag(82, before[82] + offset)
    np.testing.assert_allclose(sculpt.vertices, before + D @ offset, atol=1e-12)
    np.testing.assert_array_equal(sculpt.pins[82], before[82] + offset)


def test_undo_and_redo_return_exactly_and_a_mere_press_is_no_step(sculpt):
    rest = sculpt.vertices
    assert not sculpt.undo() and not sculpt.redo() and not sculpt.can_undo
    sculpt.drag(60, rest[60] + [0, 0, 3])
    sculpt.release()
    once = sculpt.vertices
    sculpt.press(100)
    sculpt.release()
    sculpt.drag(200, rest[200] + [0, 0, 3])
    sculpt.cancel()
    np.testing.assert_array_equal(sculpt.vertices, once)
    assert sculpt.undo() and sculpt.can_redo
    np.testing.assert_array_equal(sculpt.vertices, rest)
    assert sculpt.redo() and not sculpt.can_redo
    np.testing.assert_array_equal(sculpt.vertices, once)


def test_a_second_vertex_is_pulled_on_top_of_the_first(sculpt):
    first, second = sculpt.vertices[60] + [0, 0, 3], sculpt.vertices[380] + [0, 0, 4]
    sculpt.drag(60, first)
    sculpt.drag(380, second)
    sculpt.release()
    np.testing.assert_allclose(sculpt.vertices[[60, 380]], [first, second])


def test_it_may_start_from_another_face_which_stays_as_it_was(sculpt):
    start = sculpt.mesh.vertices + [0, 0, 7.0]
    other = Sculpt(sculpt.mesh, start)
    other.drag(3, start[3] + [0, 5, 0])
    np.testing.assert_array_equal(start, sculpt.mesh.vertices + [0, 0, 7.0])
    np.testing.assert_allclose(other.vertices[3], start[3] + [0, 5, 0])


def test_a_target_given_is_not_held_by_reference(sculpt):
    target = sculpt.vertices[60] + [0, 0, 3]
    sculpt.drag(60, target)
    before = sculpt.vertices
    target += 100
    sculpt.pins[60][:] = 0
    np.testing.assert_array_equal(sculpt.vertices, before)


def test_what_makes_no_sense_is_refused_and_the_face_stays(sculpt):
    rest = sculpt.vertices
    with pytest.raises(ValueError, match="radius=0, but it must be more than 0"):
        Sculpt(sculpt.mesh, radius=0)
    with pytest.raises(TypeError, match="mesh is a ndarray, but must be of type TriangleMesh"):
        Sculpt(rest)
    with pytest.raises(ValueError, match="vertices has shape"):
        Sculpt(sculpt.mesh, rest[:-1])
    with pytest.raises(ValueError, match="vertex=441, but there are 441 vertices"):
        sculpt.press(441)
    with pytest.raises(ValueError, match="give three finite coordinates"):
        sculpt.drag(5, [0, np.nan, 0])
    np.testing.assert_array_equal(sculpt.vertices, rest)
