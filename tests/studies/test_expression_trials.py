import numpy as np
import pytest
from planted import bumpy_rig

from facelab.expression import prepare_units
from facelab.studies.expression_trials import (
    carry_errors,
    draw_mixtures,
    score,
    score_all,
    sort_weights,
    spoil,
    vertex_rms,
    weights_by_alpha,
    weights_by_peers,
)


@pytest.fixture(scope="module")
def rig():
    return bumpy_rig()


def test_mixtures_have_as_many_units_as_asked_each_number_as_often():
    W = draw_mixtures(20, 4000, active=(2, 5), low=0.3)
    count = (W > 0).sum(axis=1)
    np.testing.assert_allclose(np.bincount(count)[2:] / 4000, 0.25, atol=0.03)
    assert W[W > 0].min() >= 0.3
    assert W.max() <= 1
    np.testing.assert_array_equal(W, draw_mixtures(20, 4000, active=(2, 5), low=0.3))


def test_noise_has_its_size_and_twists_reach_no_farther_than_their_radius(sphere):
    V = sphere.vertices
    noisy = spoil(sphere, V, noise=0.7, random_state=1)
    assert (noisy - V).std() == pytest.approx(0.7, rel=0.05)
    twisted = spoil(sphere, V, twist=6.0, n_twists=1, radius=15.0, random_state=1)
    size = np.linalg.norm(twisted - V, axis=1)
    middle = size.argmax()
    assert size[middle] == pytest.approx(6.0)
    far = np.linalg.norm(V - V[middle], axis=1) > 15.0
    np.testing.assert_array_equal(size[far], 0)
    assert np.count_nonzero(size) > 5


def test_scores_count_units_by_hand():
    truth = np.array([[0.5, 0.8, 0, 0], [0, 0, 0.4, 0]])
    found = np.array([[0.5, 0.05, 0.3, 0], [0, -0.2, 0.4, 0]])
    result = score(truth, found)
    assert result.precision == pytest.approx(2 / 4)
    assert result.recall == pytest.approx(2 / 3)
    assert result.error == pytest.approx((0.75 + 0.3 + 0.2) / 8)
    assert score(truth, np.zeros((2, 4)))[:2] == (1.0, 0.0)


def test_every_method_finds_mixtures_that_nothing_spoils(rig):
    W = draw_mixtures(12, 6, active=(1, 4))
    sketches = [rig.shape(w) for w in W]
    found = weights_by_peers(rig, sketches, W) | weights_by_alpha(rig, sketches, W, lam=0.0)
    for name, weights in found.items():
        # penalties shrink; two steps may keep what the first gave to the wrong units
        loose = ("best" in name and "alpha" not in name) or name.startswith("two")
        np.testing.assert_allclose(weights, W, atol=0.1 if loose else 1e-6, err_msg=name)


def test_with_noise_choosing_alpha_and_penalties_beat_least_squares(rig):
    W = draw_mixtures(12, 20, active=(1, 3))
    sketches = [spoil(rig.neutral, rig.shape(w), noise=3, random_state=i) for i, w in enumerate(W)]
    basis = prepare_units(rig)
    peers = weights_by_peers(basis, sketches, W)
    by_alpha = weights_by_alpha(basis, sketches, W, 1.0, np.arange(0, 4, 0.05))
    error = {name: score(W, found).error for name, found in (peers | by_alpha).items()}
    assert error["lasso >= 0, best"] < error["least squares in [0, 1]"] < error["least squares"]
    assert error["best alpha"] == min(score(W, found).error for found in by_alpha.values())
    assert error["few units"] < error["best alpha"]  # which has seen the answer, but shrinks
    assert error["held_out"] < error["least squares in [0, 1]"]
    assert error["e_rms"] == pytest.approx(error["least squares in [0, 1]"], rel=0.05)


def test_scores_of_all_methods_are_those_of_each_alone(rig):
    W = draw_mixtures(12, 4, active=(1, 3))
    sketches = [spoil(rig.neutral, rig.shape(w), noise=2, random_state=i) for i, w in enumerate(W)]
    alphas = np.arange(0, 4, 0.5)
    together = score_all(rig, iter(sketches), W, {"strong": (1.0, alphas)})
    peers = weights_by_peers(rig, sketches, W)
    by_alpha = weights_by_alpha(rig, sketches, W, 1.0, alphas)
    assert set(together) == {*peers, *(f"Eq. 9, strong, {name}" for name in by_alpha)}
    assert together["ridge, best"] == score(W, peers["ridge, best"])
    assert together["Eq. 9, strong, held_out"] == score(W, by_alpha["held_out"])


def test_weights_are_sorted_into_those_put_in_and_the_largest_beside():
    truth, found = [0.3, 0, 0, 0.5, 0], [0.02, 0.2, 0.05, 0.6, -0.4]
    there, beside = sort_weights("ABCDE", found, truth)
    assert there == {"A": 0.02, "D": 0.6}
    assert list(beside.items()) == [("E", -0.4), ("B", 0.2)]


def test_the_rms_over_vertices_is_taken_by_hand():
    offsets = np.array([[[3, 4, 0], [0, 0, 0]], [[1, 0, 0], [0, 1, 0]]])
    np.testing.assert_allclose(vertex_rms(offsets), [5 / np.sqrt(2), 1])


def test_carried_units_are_off_by_nothing_on_a_shifted_face_and_by_what_is_added(rig):
    shifted = rig.neutral.with_vertices(rig.neutral.vertices + [5, -2, 1])
    off = carry_errors(rig, shifted, rig.deltas)
    assert len(off) == 3
    for method, size in off.items():
        np.testing.assert_allclose(size, 0, atol=1e-6, err_msg=method)
    moved = carry_errors(rig, shifted, rig.deltas + [0, 3, 4], ["copy"])["copy"]
    np.testing.assert_allclose(moved, 5, atol=1e-6)


def test_what_cannot_be_tried_is_refused(rig):
    with pytest.raises(ValueError, match=r"active=\(3, 30\), but 12 units"):
        draw_mixtures(12, active=(3, 30))
    with pytest.raises(ValueError, match="low=2"):
        draw_mixtures(12, low=2)
    with pytest.raises(ValueError, match="noise=-1"):
        spoil(rig.neutral, rig.neutral.vertices, noise=-1)
    with pytest.raises(ValueError, match="found has shape"):
        score(np.zeros((2, 3)), np.zeros((2, 4)))
    with pytest.raises(ValueError, match="sketches is empty"):
        weights_by_peers(rig, [], np.zeros((0, 12)))
    with pytest.raises(ValueError, match="truth has shape"):
        weights_by_alpha(rig, [rig.neutral.vertices], np.zeros((2, 12)))
    with pytest.raises(ValueError, match="weights has shape"):
        sort_weights(rig.names, np.zeros(3), np.zeros(12))
    with pytest.raises(ValueError, match="wanted has shape"):
        carry_errors(rig, rig.neutral, np.zeros((2, 3, 3)))
