import literal
import numpy as np
import pytest
from real_face import NOISE, control_face, models

from facelab.evaluation import rms_error


def test_error_is_equation_13(rng):
    X, X_hat = rng.normal(size=(2, 7, 11, 3))
    assert rms_error(X, X_hat) == pytest.approx(literal.eq_13(X, X_hat), rel=1e-12)


def test_flat_frames_and_frames_of_points_have_the_same_error(rng):
    X, X_hat = rng.normal(size=(2, 7, 11, 3))
    flat = rms_error(X.reshape(7, 33), X_hat.reshape(7, 33))
    assert flat == pytest.approx(rms_error(X, X_hat), rel=1e-14)


def test_every_vertex_off_by_two_millimetres_is_an_error_of_two_millimetres(rng):
    away = rng.normal(size=(5, 9, 3))
    away *= 2 / np.linalg.norm(away, axis=2, keepdims=True)
    assert rms_error(away + 100, np.full_like(away, 100)) == pytest.approx(2, rel=1e-12)


def test_a_perfect_copy_has_no_error(rng):
    X = rng.normal(size=(4, 6))
    assert rms_error(X, X) == 0


def test_error_is_the_same_both_ways_and_grows_with_the_unit(rng):
    X, X_hat = rng.normal(size=(2, 4, 6))
    assert rms_error(X, X_hat) == rms_error(X_hat, X)
    assert rms_error(10 * X, 10 * X_hat) == pytest.approx(10 * rms_error(X, X_hat), rel=1e-12)


def test_noise_of_a_third_of_a_millimetre_on_each_axis_makes_a_floor_of_half_a_millimetre(rng):
    noise = rng.normal(scale=0.3, size=(200, 100, 3))
    # 0.3 sqrt(3); the estimate from 60,000 numbers is off by about 0.3 % (one sigma)
    assert rms_error(noise, np.zeros_like(noise)) == pytest.approx(0.3 * np.sqrt(3), rel=0.015)


def test_numbers_of_low_precision_are_summed_in_high_precision():
    X = np.full((3000, 300), 0.1, dtype=np.float32)
    expected = np.sqrt(3) * float(np.float32(0.1))
    assert rms_error(X, np.zeros_like(X)) == pytest.approx(expected, rel=1e-9)


def test_a_missing_number_is_not_passed_over():
    X = np.zeros((2, 6))
    X[1, 3] = np.nan
    assert np.isnan(rms_error(X, np.zeros((2, 6))))


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match=r"X has shape \(2, 6\), X_hat \(2, 9\)"):
        rms_error(np.zeros((2, 6)), np.zeros((2, 9)))


@pytest.mark.parametrize("shape", [(0, 6), (4, 0), (3, 4), (3, 3, 2), ()])
def test_no_frames_or_no_three_coordinates_are_refused(shape):
    with pytest.raises(ValueError, match="no frames, or not three coordinates"):
        rms_error(np.zeros(shape), np.zeros(shape))


# --- generalisation: learned from one take, tested on another -------------------------------------


@pytest.fixture(scope="module")
def face(real_rig, real_takes):
    return control_face(real_rig, real_takes["alex_rom_3"])


@pytest.fixture(scope="module")
def unseen(face, real_rig, real_takes):
    """Frames of the other take, with noise and without."""
    take = real_takes["alex_rom_4"].resampled(15)[::2]
    X = real_rig.on(face.samples, face.mesh).animate(take).displacements()
    return X + np.random.default_rng(5).normal(scale=NOISE, size=X.shape), X


@pytest.mark.real
@pytest.mark.parametrize("n_components", range(1, 11))
def test_regions_describe_unseen_motion_better_than_the_whole_face(face, unseen, n_components):
    noisy, truth = unseen
    region, whole = models(face, n_components)
    assert rms_error(noisy, region.reconstruct(noisy)) < rms_error(noisy, whole.reconstruct(noisy))
    assert rms_error(truth, region.reconstruct(noisy)) < rms_error(truth, whole.reconstruct(noisy))


@pytest.mark.real
def test_the_error_against_noisy_frames_comes_down_to_the_noise_and_falls_with_each_mode(
    face, unseen
):
    noisy, _ = unseen
    errors = []
    for n in (1, 2, 4, 6, 8):
        region = models(face, n)[0]
        errors.append(rms_error(noisy, region.reconstruct(noisy)))
    assert (np.diff(errors) < 0).all()
    assert errors[-1] == pytest.approx(NOISE * np.sqrt(3), rel=0.04)  # what is left of the motion


@pytest.mark.real
def test_the_truth_is_met_below_the_noise(face, unseen):
    noisy, truth = unseen
    for model in models(face, 20):
        assert rms_error(truth, model.reconstruct(noisy)) < 0.5 * NOISE * np.sqrt(3)
