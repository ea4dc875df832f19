import numpy as np
import pytest

import facelab
from facelab import data
from facelab.geometry.alignment import procrustes
from facelab.motion import MarkerSequence
from facelab.studies import few_markers


@pytest.fixture(scope="module")
def actors():
    return {n: facelab.load_registered(n, size="small", progress=False) for n in ("M1", "F1")}


@pytest.fixture(scope="module")
def fit(actors):
    return few_markers.thinned_fit(actors["M1"].fit, 30)


def test_thinned_markers_are_spread_wider_and_are_those_of_the_fit(actors, fit):
    whole = actors["M1"].fit
    assert len(set(fit.names)) == 30 and set(fit.names) <= set(whole.names)
    places = [whole.rest[whole.names.index(name)] for name in fit.names]
    np.testing.assert_array_equal(fit.rest, places)
    assert fit.layout.smooth.shape == (30, 30)

    def nearest(rest):
        apart = np.linalg.norm(rest[:, None] - rest, axis=2) + np.diag(np.full(len(rest), np.inf))
        return apart.min(axis=1)

    assert nearest(fit.rest).min() > 2 * np.median(nearest(whole.rest))


def test_the_head_is_taken_away_before_markers_are_compared(fit, rng):
    """Planted: markers at rest, carried about; one frame with a hidden marker is left out."""
    turn = procrustes(rng.normal(size=(5, 3)), rng.normal(size=(5, 3))).rotation
    here = fit.rest @ turn.T + [100, 20, 3]
    positions = np.stack([fit.rest, here, here, fit.rest])
    positions[2, 4] = np.nan
    take = MarkerSequence(positions, fit.names, 60)
    moved = few_markers.moved_markers(fit, take, every=1)
    assert moved.shape == (3, 30, 3)
    np.testing.assert_allclose(moved, 0, atol=1e-4)


def test_each_way_tells_a_marker_from_the_others_alone(fit, rng):
    moved = rng.normal(size=(3, 30, 3))
    errors = few_markers.left_out({"warp": fit, "prior": fit.with_prior()}, moved)
    assert list(errors) == [*few_markers.PLAIN, "warp", "prior"]
    apart = np.linalg.norm(fit.rest - fit.rest[7], axis=1)
    three = apart.argsort()[1:4]
    expected = np.linalg.norm(moved[:, 7] - moved[:, three].mean(axis=1), axis=1)
    np.testing.assert_allclose(errors["three nearest"][:, 7], expected)
    other = moved.copy()
    other[:, 7] += [5.0, 0.0, 0.0]  # what the others say of it stays the same
    again = few_markers.left_out({"warp": fit, "prior": fit.with_prior()}, other)
    for way in errors:
        assert (np.abs(again[way][:, 7] - errors[way][:, 7]) <= 5 + 1e-9).all()
        assert not np.allclose(again[way][:, 7], errors[way][:, 7])


def test_a_shift_of_all_markers_is_told_exactly_by_every_plain_way(fit):
    shift = np.broadcast_to([1.0, 2.0, 3.0], (2, 30, 3))
    errors = few_markers.left_out({"warp": fit}, shift)
    for way in few_markers.PLAIN:
        np.testing.assert_allclose(errors[way], 0, atol=1e-8)
    assert errors["warp"].max() < 0.1


def test_models_of_mirrored_frames_know_both_sides(actors):
    actor = actors["M1"]
    X = actor.truth("train").displacements()[::4]
    models = few_markers.prior_models([X], actor.fit.mesh, actor.samples, 10, 3)
    assert [m.n_vertices for m in models] == [397, 397]
    mean = models[0].mean_.reshape(-1, 3)
    small = actor.mesh
    sides = [small.vertices[:, 0] > 10, small.vertices[:, 0] < -10]
    amounts = [np.linalg.norm(mean[side], axis=1).mean() for side in sides]
    assert abs(amounts[0] / amounts[1] - 1) < 0.2


def test_on_an_actor_the_warp_is_no_worse_than_radial_basis_functions(actors, monkeypatch):
    monkeypatch.setattr(few_markers, "COUNTS", (25, 1000))
    found = few_markers.by_count(actors, n_takes=1, every=8, progress=False)
    assert list(found) == [("M1", 25), ("F1", 25)]  # none has 1,000
    for mm in found.values():
        assert mm["warp"] < mm["radial basis"]


def test_without_the_capture_an_actor_stands_in_and_is_called_so(actors, monkeypatch):
    def missing(name):
        raise data.DataUnavailable("not at hand")

    monkeypatch.setattr(data, "load_markers", missing)
    face = few_markers.load_few_markers(actors["M1"].fit.mesh, actors["M1"])
    assert face.about.startswith("SYNTHETIC: M1") and "not at hand" in face.about
    assert face.credit == "synthetic" and len(face.fit.names) == 41
    moved = few_markers.moved_markers(face.fit, next(iter(face.takes.values())), every=1)
    assert np.isfinite(moved).all() and len(moved) > 5
