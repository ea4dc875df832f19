"""Pictures without a browser: what is nearest is seen, and nothing is seen through."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import ndimage

from facelab import plotting
from facelab.data import load_template
from facelab.looks.light import shaded
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
