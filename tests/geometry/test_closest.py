"""Closest points of a surface, against a plain search through every triangle."""

import numpy as np
import pytest
from shapes import sphere_mesh

from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import TriangleMesh


def distance_to_segment(p, a, b):
    length2 = (b - a) @ (b - a)
    t = 0.0 if length2 == 0 else min(max((p - a) @ (b - a) / length2, 0.0), 1.0)
    return np.linalg.norm(a + t * (b - a) - p)


def distance_to_triangle(p, a, b, c):
    """To the plane if the foot lies inside all three sides, else to the nearest side."""
    normal, sides = np.cross(b - a, c - a), ((a, b), (b, c), (c, a))
    height = np.linalg.norm(normal) / max(np.linalg.norm(v - u) for u, v in sides)
    # thinner than a nanometre its sides are all of it, and its normal is rounding
    if height > 1e-6 and all(np.cross(v - u, p - u) @ normal >= 0 for u, v in sides):
        return abs((p - a) @ normal) / np.linalg.norm(normal)
    return min(distance_to_segment(p, u, v) for u, v in sides)


def by_hand(mesh, points):
    """Distance of each point from each triangle, shape (n_points, n_faces)."""
    corners = mesh.vertices[mesh.faces]
    return np.array([[distance_to_triangle(p, *abc) for abc in corners] for p in points])


def check(mesh, points, among=None):
    faces, barycentric = closest_points(mesh, points, among)
    places = np.einsum("nc,ncx->nx", barycentric, mesh.vertices[mesh.faces[faces]])
    far = by_hand(mesh, points)
    assert barycentric.min() >= 0
    np.testing.assert_allclose(barycentric.sum(axis=1), 1, atol=1e-12)
    rows = np.arange(len(points))
    if among is None:
        least = far.min(axis=1)
    else:
        least = np.array([row[some].min() for row, some in zip(far, among, strict=True)])
    np.testing.assert_allclose(far[rows, faces], least, atol=2e-9)
    np.testing.assert_allclose(np.linalg.norm(places - points, axis=1), least, atol=2e-9)
    return faces


@pytest.mark.parametrize("away", [0.1, 8.0, 300.0])
def test_the_place_found_is_the_closest_of_all_triangles(bumpy, rng, away):
    near = bumpy.vertices[rng.integers(bumpy.n_vertices, size=60)]
    check(bumpy, near + rng.normal(scale=away, size=near.shape))


def test_vertices_and_middles_of_edges_lie_on_the_surface_themselves(bumpy):
    check(bumpy, np.vstack([bumpy.vertices, bumpy.vertices[bumpy.edges].mean(axis=1)]))


@pytest.mark.parametrize("thin", [0.0, 1e-13, 1e-9, 1e-4])
def test_slivers_and_triangles_without_area_cost_no_exactness(rng, thin):
    # the middle of the long side of a square's half, pulled in by next to nothing
    V = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [3, 3 + thin, 0], [3, 3, 0]])
    mesh = TriangleMesh(
        V @ np.linalg.qr(rng.normal(size=(3, 3)))[0],
        [[0, 1, 2], [0, 2, 4], [0, 4, 3], [4, 2, 3], [0, 5, 2], [4, 5, 0]],
    )
    middle = mesh.vertices.mean(axis=0)
    points = middle + rng.normal(scale=5, size=(200, 3))
    check(mesh, np.vstack([points, mesh.vertices]))


def test_each_point_may_look_at_triangles_of_its_own(bumpy, rng):
    points = bumpy.vertices[:20] + rng.normal(scale=3, size=(20, 3))
    among = [rng.permutation(len(bumpy.faces))[:5] for _ in points]
    faces = check(bumpy, points, among)
    assert all(face in some for face, some in zip(faces, among, strict=True))


def test_the_closest_points_of_a_sphere_lie_towards_its_centre(rng):
    ball = sphere_mesh(3, radius=50.0)
    points = rng.normal(size=(200, 3))
    points *= rng.uniform(20, 90, (200, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    faces, barycentric = closest_points(ball, points)
    found = np.einsum("nc,ncx->nx", barycentric, ball.vertices[ball.faces[faces]])
    away = np.linalg.norm(points - found, axis=1)
    np.testing.assert_allclose(away, np.abs(np.linalg.norm(points, axis=1) - 50), atol=0.6)  # sag


def test_points_that_are_not_points_are_refused(bumpy):
    with pytest.raises(ValueError, match="points holds 1"):
        closest_points(bumpy, [[0, 0, np.nan]])
    with pytest.raises(ValueError, match="points has shape"):
        closest_points(bumpy, np.zeros((4, 2)))
