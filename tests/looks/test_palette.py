"""Region colours are told apart, in numbers, by everyone."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from scipy.spatial import Delaunay
from shapes import grid_mesh

from facelab import plotting
from facelab.looks.palette import PALETTE, VISIONS, ciede2000, differences, lab, map_colors
from facelab.segmentation.regions import Regions

SHARMA = [  # from the table of test data of Sharma, Wu and Dalal 2005
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, 3.1571, -77.2803), (50.0, 0.0, -82.7485), 2.8615),
    ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
    ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


@pytest.mark.parametrize(("a", "b", "wanted"), SHARMA)
def test_the_difference_is_that_of_the_published_pairs(a, b, wanted):
    assert ciede2000(np.array(a), np.array(b)) == pytest.approx(wanted, abs=1e-4)
    assert ciede2000(np.array(b), np.array(a)) == pytest.approx(wanted, abs=1e-4)


def test_lab_of_known_colours():
    np.testing.assert_allclose(lab([[1, 1, 1], [0, 0, 0]]), [[100, 0, 0], [0, 0, 0]], atol=1e-2)
    np.testing.assert_allclose(lab([[1, 0, 0]]), [[53.24, 80.09, 67.20]], atol=0.02)


def test_greys_look_the_same_to_all_and_red_and_green_alike_to_some():
    grey = np.full((1, 3), 0.5)
    for vision in VISIONS:
        np.testing.assert_allclose(lab(grey, vision), lab(grey), atol=0.1)
    pair = np.array([[0.71, 0.43, 0.0], [0.50, 0.50, 0.0]])
    normal, deutan = (ciede2000(*lab(pair, v)) for v in ("normal", "deutan"))
    assert deutan < 0.4 * normal


def test_any_two_of_the_twenty_colours_differ_by_10_in_every_vision():
    apart = differences([to_rgb(c) for c in PALETTE])
    np.fill_diagonal(apart, np.inf)
    assert len(PALETTE) == 20 and apart.min() > 10  # aim 8; 10.7 at the closest pair


def random_map(n, rng):
    """Which of n places touch: neighbours of Delaunay's triangulation, as on a surface."""
    touch = np.zeros((n, n), dtype=bool)
    for a, b, c in Delaunay(rng.uniform(size=(n, 2))).simplices:
        for i, j in ((a, b), (b, c), (c, a)):
            touch[i, j] = touch[j, i] = True
    return touch


@pytest.mark.parametrize("n", [3, 6, 9, 13, 16, 20])
def test_regions_that_touch_differ_by_15_in_every_vision(n, rng):
    for _ in range(4):
        touch = random_map(n, rng)
        chosen = map_colors(touch)
        assert len(set(chosen)) == n
        apart = differences([to_rgb(PALETTE[c]) for c in chosen])
        assert apart[touch].min() >= 15


def test_more_regions_than_colours_still_differ_where_they_touch(rng):
    touch = random_map(30, rng)
    chosen = map_colors(touch)
    assert (chosen[:, None] != chosen)[touch].all()


def test_colours_that_are_kept_stay(rng):
    touch = random_map(8, rng)
    kept = np.array([3, -1, -1, 0, -1, -1, -1, -1])
    chosen = map_colors(touch, kept)
    assert chosen[0] == 3 and chosen[3] == 0 and len(set(chosen)) == 8


def test_a_face_of_regions_gets_them():
    mesh = grid_mesh(9, 9)
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    labels = (x > np.median(x)).astype(int) + 2 * (y > np.median(y))
    colors = plotting.region_colors(Regions(labels, mesh))
    apart = differences(colors)
    assert apart[np.triu_indices(4, 1)].min() >= 15
