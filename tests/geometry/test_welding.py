import numpy as np
import pytest
from shapes import grid_mesh, sphere_mesh

from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.polygons import triangulate
from facelab.geometry.size import check_face_size, face_scale, longest_side, mesh_scale
from facelab.geometry.welding import alike, same_place


def soup(mesh, rng=None):
    """Loose triangles, in another order if a generator is given."""
    faces = mesh.faces if rng is None else rng.permutation(mesh.faces)
    n = len(faces)
    return TriangleMesh(mesh.vertices[faces.ravel()], np.arange(3 * n).reshape(-1, 3))


# --- welding --------------------------------------------------------------------------------------


def test_loose_triangles_become_the_surface_they_came_from(rng):
    ball = sphere_mesh(2, radius=80.0)
    loose = soup(ball, rng)
    mesh, index = loose.welded()
    np.testing.assert_array_equal(mesh.vertices[index], loose.vertices)
    assert (mesh.n_vertices, len(mesh.faces)) == (ball.n_vertices, len(ball.faces))
    assert mesh.pieces.max() == 0 and not mesh.boundary_loops
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], loose.vertices[loose.faces])


def test_vertices_keep_the_order_in_which_they_first_stand(rng):
    loose = soup(sphere_mesh(1), rng)
    _, index = loose.welded()
    first = np.unique(index, return_index=True)[1]
    assert (np.diff(first) > 0).all()


def test_a_mesh_without_such_vertices_stays_as_it_is(bumpy):
    mesh, index = bumpy.welded()
    np.testing.assert_array_equal(mesh.vertices, bumpy.vertices)
    np.testing.assert_array_equal(mesh.faces, bumpy.faces)
    assert index.tolist() == list(range(bumpy.n_vertices)) and mesh.landmarks == bumpy.landmarks


def test_landmarks_move_along_and_triangles_that_shrink_to_a_line_go():
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [5, 5, 0]], dtype=float)
    mesh = TriangleMesh(V, [[0, 1, 2], [1, 3, 4]], {"a": 3, "b": 4})
    mesh, index = mesh.welded()
    assert index.tolist() == [0, 1, 2, 1, 3]
    assert mesh.faces.tolist() == [[0, 1, 2]] and mesh.landmarks == {"a": 1, "b": 3}


def test_plus_and_minus_zero_are_one_place():
    assert same_place(np.array([[0.0, 1, 2], [-0.0, 1, 2]])).tolist() == [0, 0]


@pytest.mark.parametrize("tolerance, n", [(0.0, 240), (0.1, 42)])
def test_a_tolerance_joins_what_nearly_meets(rng, tolerance, n):
    loose = soup(sphere_mesh(1, radius=80.0))
    shaken = loose.with_vertices(loose.vertices + rng.normal(scale=0.01, size=(240, 3)))
    mesh, index = shaken.welded(tolerance)
    assert mesh.n_vertices == n
    assert np.abs(mesh.vertices[index] - shaken.vertices).max() <= tolerance


@pytest.mark.parametrize("tolerance, words", [(-1, "0 or more"), (500, "whole neighbourhoods")])
def test_a_tolerance_that_makes_no_sense_is_refused(tolerance, words):
    with pytest.raises(ValueError, match=f"tolerance=.*{words}"):
        sphere_mesh(2, radius=80.0).welded(tolerance)


def test_vertices_in_one_place_are_alike_only_if_all_shapes_move_them_so():
    place = np.array([0, 1, 0, 0, 1, 0])
    shapes = np.zeros((2, 6, 3))
    shapes[0, [2, 5], 1] = 1.0
    shapes[1, 4] = 0.001
    assert alike(place, shapes, 0.01).tolist() == [0, 1, 2, 0, 1, 2]
    assert alike(place, shapes, 0).tolist() == [0, 1, 2, 0, 3, 2]
    assert alike(place, shapes[:0], 0).tolist() == place.tolist()


# --- advice ---------------------------------------------------------------------------------------


def test_the_advice_about_pieces_is_right_for_the_case():
    ball = sphere_mesh(1, radius=80.0)
    with pytest.raises(ValueError, match=r"use mesh.welded\(\)\[0\]\.$"):
        soup(ball).check_connected()
    grid = grid_mesh(3, 3)
    small = TriangleMesh(grid.vertices + 500, grid.faces)
    both = TriangleMesh(
        np.vstack([small.vertices, ball.vertices]), np.vstack([small.faces, ball.faces + 9])
    )
    with pytest.raises(ValueError, match=r"keep the largest with mesh.submesh\(mesh.pieces == 1\)"):
        both.check_connected()
    assert both.submesh(both.pieces == 1).n_vertices == ball.n_vertices
    with pytest.raises(ValueError, match=r"welded\(\)\[0\], and of its 2 pieces the largest"):
        soup(both).check_connected()


# --- polygons -------------------------------------------------------------------------------------


def area(V, F):
    return np.cross(V[F[:, 1]] - V[F[:, 0]], V[F[:, 2]] - V[F[:, 0]])[:, 2] / 2


def star(n, rng=None):
    """A star of 2 n corners, counter-clockwise in the plane z = 0, and its area."""
    angle = np.pi * np.arange(2 * n) / n
    radius = np.where(np.arange(2 * n) % 2, 0.3, 1.0)
    V = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    return V, 2 * n * 0.5 * 0.3 * np.sin(np.pi / n)


@pytest.mark.parametrize("n", [2, 3, 5, 12])
@pytest.mark.parametrize("turn", [0, 1, 3])
def test_a_star_is_cut_into_triangles_inside_it(n, turn):
    V, whole = star(n)
    corners = np.roll(np.arange(2 * n), turn)
    F, polygon = triangulate(V, corners, np.array([2 * n]))
    assert len(F) == 2 * n - 2 and not polygon.any()
    assert (area(V, F) > 0).all()  # none faces the other way: so they do not overlap
    assert area(V, F).sum() == pytest.approx(whole)


@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)])
def test_it_does_not_matter_how_a_polygon_lies_in_space(axes):
    V, whole = star(5)
    turned = V[:, axes]
    F, _ = triangulate(turned, np.arange(10), np.array([10]))
    a = np.linalg.norm(
        np.cross(turned[F[:, 1]] - turned[F[:, 0]], turned[F[:, 2]] - turned[F[:, 0]]), axis=1
    )
    assert a.sum() / 2 == pytest.approx(whole)


def test_polygons_of_many_sizes_keep_their_order():
    V, _ = star(5)
    corners = np.array([0, 2, 4, *range(10), 0, 2, 4, 6])
    F, polygon = triangulate(V, corners, np.array([3, 10, 4]))
    assert polygon.tolist() == [0] + [1] * 8 + [2] * 2
    assert F[0].tolist() == [0, 2, 4] and F[-2:].tolist() == [[0, 2, 4], [0, 4, 6]]


def test_an_endless_polygon_that_bends_inwards_is_refused():
    V, _ = star(600)
    with pytest.raises(ValueError, match=r"1 polygon\(s\) with up to 1200 corners bend inwards"):
        triangulate(V, np.arange(1200), np.array([1200]))


# --- size -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("face", [110, 220, 400])  # a mask, a face, a head with its neck
@pytest.mark.parametrize("scale", [0.1, 1, 10, 100, 1000])
def test_the_unit_of_a_face_is_told_by_its_size(face, scale):
    assert face_scale(face / scale) == scale


@pytest.mark.parametrize(
    "side, scale, said",
    [
        (7.05, 25.4, "inches (or centimetres: 10)"),  # 179 mm, and no face of 70
        (5.0, 25.4, "inches (or decimetres: 100)"),
        (11.0, 10, "centimetres (or inches: 25.4)"),
        (40.0, 10, "centimetres"),
        (0.2, 1000, "metres"),
        (2.2, 100, "decimetres"),
    ],
)
def test_a_face_that_tens_make_none_is_in_inches(side, scale, said):
    assert mesh_scale(side) == (scale, said)
    assert mesh_scale(side, whole=False)[0] == face_scale(side)


@pytest.mark.parametrize("side", [0, 1e-4, 1e5])
def test_what_no_unit_makes_a_face_has_none(side):
    assert face_scale(side) is None and mesh_scale(side)[0] is None


def test_a_face_in_millimetres_is_silent(recwarn):
    ball = sphere_mesh(2, radius=110.0)
    assert longest_side(ball.vertices) == pytest.approx(220, rel=0.01)
    assert check_face_size(ball.vertices, "rig")
    assert check_face_size(ball.vertices / 1000, "head.glb", 1000)
    assert check_face_size(ball.vertices / 10, "eye.obj", 1, part=True)
    assert not recwarn.list


@pytest.mark.parametrize(
    "k, scale, words",
    [
        (0.001, None, "rig: its longest side is 0.22 mm.* metres: multiply its lengths by 1000"),
        (0.1, None, r"centimetres \(.*\): multiply its lengths by 10"),
        (10, None, "tenths of a millimetre, or a whole body: multiply its lengths by 0.1"),
        (0.1, 1, r"looks like centimetres \(.*\): give scale=10"),
        (0.1, 1000, r"its longest side is 2.2e.04 mm.* centimetres \(.*\): give scale=10"),
        (1 / 25.4, 1, r"looks like inches \(or centimetres: 10\): give scale=25\.4"),
        (1e-6, None, "no unit of length makes it a face"),
    ],
)
def test_another_size_is_said_with_the_factor(k, scale, words):
    ball = sphere_mesh(3, radius=110.0)
    with pytest.warns(UserWarning, match=words):
        assert not check_face_size(ball.vertices * k, "rig", scale)
