"""What a pull does to the rest, on a strip of two regions where it can be seen."""

import numpy as np
import pytest

from facelab import HolisticModel, RegionModel
from facelab.course import two_humps
from facelab.segmentation import Regions
from facelab.studies import locality


@pytest.fixture(scope="module")
def strip():
    return two_humps()


@pytest.fixture(scope="module")
def halves(strip):
    mesh, X = strip
    return RegionModel(Regions((mesh.vertices[:, 0] > 45).astype(int), mesh), 1).fit(X)


def test_one_mode_lifts_both_humps_two_regions_without_agreement_only_one(strip, halves):
    mesh, X = strip
    one = locality.pulled(HolisticModel(1).fit(X), mesh, {5: (0, 10, 0)}, gamma=0.005)
    two = locality.pulled(halves, mesh, {5: (0, 10, 0)}, beta=0, gamma=0.005)
    assert one.vertices[15, 1] > 0.9 * one.vertices[5, 1] > 3
    assert two.vertices[5, 1] > 3 and abs(two.vertices[15, 1]) < 1e-9


def test_what_only_one_region_holds_is_shown_as_that_region_has_it(strip, halves):
    mesh, _ = strip
    session = locality.pulled(halves, mesh, {5: (0, 10, 0)})
    for region in (0, 1):
        members, P = locality.copies(session, region)
        alone = halves.regions.holders[members] == 1
        np.testing.assert_allclose(P[alone], session.vertices[members][alone], atol=1e-9)


def test_no_energy_goes_astray_beyond_the_face_and_all_of_it_beyond_nothing(strip, halves):
    session = locality.pulled(halves, strip[0], {5: (0, 10, 0)})
    assert locality.astray(session, 5, 1000.0) == 0
    everywhere = np.arange(strip[0].n_vertices)  # each vertex a region of its own
    assert 0.5 < locality.astray(session, 5, everywhere) < 1


def test_many_pulls_are_the_same_for_every_model_and_run(strip, halves):
    labels = halves.regions.labels
    first = locality.many_pulls(halves, strip[0], labels, 8)
    assert first.shape == (8,) and ((first >= 0) & (first <= 1)).all()
    np.testing.assert_array_equal(first, locality.many_pulls(halves, strip[0], labels, 8))


def test_edits_keep_their_pins_and_say_what_moved_far_away(strip, halves):
    from facelab import PosingSession

    mesh = strip[0]
    marked = type(mesh)(mesh.vertices, mesh.faces, {"left": 5, "right": 15})
    session = PosingSession(halves, marked, beta=0)
    edits = {"one": ("left", (0, 5, 0)), "two": ("right", (0, 3, 0))}
    told = list(locality.edited(session, edits, far=70))
    assert [name for name, *_ in told] == ["one", "two"] and set(session.pins) == {5, 15}
    assert all(far < 1e-9 for *_, far in told)  # without agreement nothing moves in the other half
