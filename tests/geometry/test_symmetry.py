"""Twins across the midline of a face, and cuts held against their mirror image."""

import numpy as np
import pytest
from shapes import grid_mesh

from facelab.geometry.symmetry import mirror_agreement, mirror_partners, mirror_twins


def mirrored_grid(columns=9, rows=6):
    """A grid with its middle column on x = 0, and each vertex's twin."""
    flat = grid_mesh(columns, rows, 5.0)
    mesh = flat.with_vertices(flat.vertices - [2.5 * (columns - 1), 0, 0])
    row, column = np.divmod(np.arange(mesh.n_vertices), columns)
    return mesh, row * columns + columns - 1 - column


def test_twins_lie_where_the_mirror_shows_them():
    mesh, twins = mirrored_grid()
    np.testing.assert_array_equal(mirror_twins(mesh), twins)
    np.testing.assert_array_equal(mirror_twins(mesh, mirror=twins), twins)


def test_twins_of_samples_are_the_samples_nearest_to_the_twins_of_their_vertices(rng):
    mesh, twins = mirrored_grid(13, 10)
    samples = np.sort(rng.choice(mesh.n_vertices, size=30, replace=False))
    found = mirror_twins(mesh, samples)
    G = mesh.geodesics()
    for i, j in enumerate(found):
        reached = G[twins[samples[i]], samples]
        assert reached[j] == reached.min()


def test_a_symmetric_cut_scores_one_however_it_is_numbered(rng):
    mesh, twins = mirrored_grid()
    quadrant = 2 * (mesh.vertices[:, 0] > 1) + (mesh.vertices[:, 1] > 12)
    assert mirror_agreement(np.abs(mesh.vertices[:, 0]) > 11, twins) == 1
    middle = np.abs(mesh.vertices[:, 0]) < 1
    assert mirror_agreement(np.where(middle, 5, quadrant), twins) == 1


def test_a_cut_that_knows_nothing_of_its_mirror_image_scores_nothing(rng):
    _, twins = mirrored_grid(31, 30)
    scores = [mirror_agreement(rng.integers(4, size=len(twins)), twins) for _ in range(20)]
    assert abs(np.mean(scores)) < 0.01


def test_twins_need_one_entry_for_each_vertex():
    mesh, twins = mirrored_grid()
    with pytest.raises(ValueError, match="mirror has shape"):
        mirror_twins(mesh, mirror=twins[:-1])


def test_partners_are_the_twins_of_a_symmetric_face_wherever_it_stands():
    mesh, twins = mirrored_grid()
    moved = mesh.with_vertices(mesh.vertices + [3.0, 0, 0])
    np.testing.assert_array_equal(mirror_partners(moved), twins)


@pytest.mark.parametrize("bad", [lambda t: t[:-1], lambda t: t + 1, lambda t: t - 1.0])
def test_agreement_needs_a_twin_for_each_label(bad):
    _, twins = mirrored_grid()
    with pytest.raises(ValueError, match=r"labels has shape \(54,\), twins shape"):
        mirror_agreement(np.zeros(54, dtype=int), bad(twins))


@pytest.mark.parametrize("find", [mirror_partners, mirror_twins])
def test_an_array_is_no_face(find):
    with pytest.raises(TypeError, match="mesh is a ndarray, but must be of type TriangleMesh"):
        find(np.zeros((4, 3)))
