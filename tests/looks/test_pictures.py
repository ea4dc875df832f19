"""Pictures without a browser: what is nearest is seen, and nothing is seen through."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import ndimage
from shapes import sphere_mesh

from facelab import plotting
from facelab.data import load_template
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import face_props
from facelab.looks.light import shaded
from facelab.looks.occlusion import openness, skin_colors
from facelab.looks.raster import rasterise


def test_the_nearest_triangle_is_found_as_by_trying_each_at_each_pixel(rng):
    corners = rng.uniform(-3, 20, (40, 3, 2))
    corners[0, 1] = corners[0, 0]  # without area
    depth = rng.normal(size=(40, 3))
    face, weights = rasterise(corners, depth, 17, 13)
    for y in range(13):
        for x in range(17):
            best = -1, -np.inf
            for k in range(1, 40):
                A = np.vstack([corners[k].T, np.ones(3)])
                share = np.linalg.solve(A, [x + 0.5, y + 0.5, 1])
                if (share > 0).all() and share @ depth[k] > best[1]:
                    best = k, share @ depth[k]
                    at = share
            assert face[y, x] == best[0]
            if best[0] >= 0:
                np.testing.assert_allclose(weights[y, x], at, atol=1e-9)


@pytest.mark.parametrize("view", ["front", "left"])
def test_no_hole_is_left_where_eyes_and_mouth_are(view):
    face = load_template(4375)
    figure, axes = plotting.new_row(1, 3)
    plotting.draw_face(axes[0], face, view=view)
    (picture,) = axes[0].get_images()
    clear = np.asarray(picture.get_array())[..., 3] == 0
    _, n = ndimage.label(np.pad(clear, 1, constant_values=True))
    assert n == 1  # the page around the face
    plt.close(figure)


def test_a_face_is_drawn_with_its_eyes_or_without():
    face = load_template(4375)
    figure, axes = plotting.new_row(2, 3)
    white = []
    for ax, props in zip(axes, (None, ()), strict=True):
        plotting.draw_face(ax, face, props=props)
        image = np.asarray(ax.get_images()[0].get_array())
        seen = image[..., 3] == 1
        tint = np.ptp(image[..., :3], axis=2)[seen] / image[..., :3].max(axis=2)[seen]
        white.append((tint < 0.12).sum())
    assert white[0] > 40 > white[1]
    plt.close(figure)


def test_points_are_drawn_where_the_skin_is():
    face = load_template(4375)
    figure, axes = plotting.new_row(1, 3)
    project = plotting.draw_face(axes[0], face)
    x0, x1, y0, y1 = axes[0].get_images()[0].get_extent()
    at = project(face.vertices)
    np.testing.assert_allclose(
        [x0, x1, y0, y1], [*at.min(0), *at.max(0)][::2] + [*at.min(0), *at.max(0)][1::2]
    )
    plt.close(figure)


def test_what_faces_the_light_is_brighter_than_what_faces_away():
    N = np.array([[-0.4, 0.5, 0.77], [0.4, -0.5, 0.77]])
    light, dark = shaded(np.full((2, 3), 0.5), N, np.zeros(2))
    assert (light > 1.3 * dark).all()
    wet = shaded(np.full((1, 3), 0.1), np.array([[-0.23, 0.28, 0.93]]), np.ones(1))
    assert wet.min() > 0.6  # a glint


def test_all_light_reaches_a_ball_and_little_the_inside_of_one():
    ball = sphere_mesh(3, radius=50.0)
    assert openness(ball).min() > 0.97
    inside = TriangleMesh(ball.vertices, ball.faces[:, ::-1])
    assert openness(inside).max() < 0.05


def test_a_high_wall_takes_half_of_the_light_from_the_floor_before_it():
    t = np.linspace(-1, 1, 41)
    x, z = np.meshgrid(60 * t, np.linspace(0, 20, 9))
    floor = np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3)
    wall = floor[:, [0, 2, 1]] * [1, 4, 1]  # it stands on the edge z = 0 and faces the floor
    k = np.arange(9 * 41).reshape(9, 41)
    a, b, c, d = (m.ravel() for m in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    F = np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)])
    both = TriangleMesh(np.vstack([floor, wall]), np.vstack([F, F[:, ::-1] + len(floor)]))
    assert both.normals[k[4, 20]][1] > 0.99 and both.normals[len(floor) + k[4, 20]][2] > 0.99
    light = openness(both)
    # half of the sky is hidden there, but for what comes past the ends of the wall
    assert light[k[4, 20]] == pytest.approx(0.55, abs=0.06)


def test_skin_is_darker_in_the_mouth_and_not_around_the_eyes():
    face = load_template(4375)
    colors = skin_colors(face, "#ffffff", face_props(face))
    marks = face.landmarks
    assert colors[marks["mouth_inner_upper"]].max() < colors[marks["brow_left_3"]].min()
    assert colors[marks["eye_left_upper_inner"]].min() > 0.8
