import numpy as np
import pytest
from scipy.spatial import cKDTree

from data_synth.action_units import actor_rig
from data_synth.actors import ACTORS
from data_synth.capture import SIZES
from data_synth.capture.sites import contours, place_markers
from data_synth.template.plane import inside
from facelab.geometry.mesh import MULTI_PIE


@pytest.fixture(scope="module")
def layouts():
    """Neutral, sites and feet of each actor's default layout, on the coarse mesh."""
    found = {}
    for number, actor in enumerate(ACTORS):
        mesh = actor_rig(actor, SIZES["small"].n_vertices).neutral
        sites = place_markers(mesh, ACTORS[actor].markers.spacing, [0, 6, number])
        feet = np.einsum("mc,mcx->mx", sites.weights, mesh.vertices[mesh.faces[sites.faces]])
        found[actor] = mesh, sites, feet
    return found


def test_every_actor_wears_another_layout_of_150_to_220_markers(layouts):
    counts = [len(sites.names) for _, sites, _ in layouts.values()]
    assert len(set(counts)) == 4
    assert 150 <= min(counts)
    assert max(counts) <= 220


@pytest.mark.parametrize("actor", ACTORS)
def test_markers_are_about_a_centimetre_apart(layouts, actor):
    mesh, sites, feet = layouts[actor]
    near = cKDTree(feet).query(feet, k=2)[0][:, 1]
    assert 9 < near.mean() < 13
    assert near.min() > 5
    np.testing.assert_allclose(sites.weights.sum(axis=1), 1)
    assert (sites.weights >= 0).all()
    assert sites.faces.max() < len(mesh.faces)


@pytest.mark.parametrize("actor", ACTORS)
def test_twenty_or_more_markers_sit_on_the_landmark_they_are_named_after(layouts, actor):
    mesh, sites, feet = layouts[actor]
    named = [i for i, n in enumerate(sites.names) if n in MULTI_PIE]
    assert len(named) >= 20
    at = mesh.vertices[[mesh.landmarks[sites.names[i]] for i in named]]
    assert np.linalg.norm(feet[named] - at, axis=1).max() < 2.0
    others = [n for n in sites.names if n not in MULTI_PIE]
    assert others == [f"m{i + 1:03d}" for i in range(len(others))]


@pytest.mark.parametrize("actor", ACTORS)
def test_no_marker_on_a_lids_edge_or_inside_the_lips(layouts, actor):
    mesh, _, feet = layouts[actor]
    for name, line in contours(mesh).items():
        # the landmark on the mouth's corner is the nearest that a marker comes to the lips' line
        assert cKDTree(line).query(feet)[0].min() > (1.0 if name == "mouth" else 4.0)
        assert not inside(feet[:, :2], line[:, :2]).any()


def test_sites_follow_from_the_seed(rig):
    a, b, c = (place_markers(rig.neutral, 11.5, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.weights, b.weights)
    assert a.weights.shape != c.weights.shape or not np.allclose(a.weights, c.weights)
