import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facelab.geometry.alignment import check_like, procrustes, rigid_motion, rigid_weights


@pytest.fixture
def cloud(rng):
    """Forty points spread like a face: wide, high, not very deep."""
    return rng.normal(size=(40, 3)) * [50.0, 70.0, 25.0]


def moved(points, rng, size=1.0):
    R = Rotation.random(random_state=rng).as_matrix()
    t = rng.normal(scale=300, size=3)
    return size * points @ R.T + t, R, t


def cost(R, source, target, weights):
    """Weighted squares left by a turn with the best shift."""
    off = target - source @ R.T
    off -= np.average(off, axis=0, weights=weights)
    return weights @ (off**2).sum(axis=1)


@pytest.mark.parametrize("size", [1.0, 0.5, 1000.0])
def test_a_planted_similarity_is_found_and_taken_back(cloud, rng, size):
    target, R, t = moved(cloud, rng, size)
    found = procrustes(cloud, target, scale=True)
    np.testing.assert_allclose(found.rotation, R, atol=1e-10)
    np.testing.assert_allclose(found.translation, t, atol=1e-8)
    assert found.scale == pytest.approx(size, rel=1e-12)
    np.testing.assert_allclose(found.inverse().apply(target), cloud, atol=1e-8)


def test_a_motion_keeps_size_whatever_the_data(cloud, rng):
    target, R, _ = moved(cloud, rng, size=2.0)
    found = procrustes(cloud, target)
    assert found.scale == 1.0
    np.testing.assert_allclose(found.rotation, R, atol=1e-10)


@pytest.mark.parametrize("shape", ["noise", "mirrored", "flat"])
def test_the_turn_is_proper_and_no_other_is_better(cloud, rng, shape):
    if shape == "noise":  # unrelated points: the best orthogonal map is often a reflection
        source, target = rng.normal(size=(2, 5, 3))
    elif shape == "mirrored":
        source, target = cloud, cloud * [-1, 1, 1]
    else:
        source = cloud * [1, 1, 0]
        target = moved(source, rng)[0] + rng.normal(size=cloud.shape)
    w = rng.uniform(0.1, 1, len(source))
    R = procrustes(source, target, w).rotation
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)
    best = cost(R, source, target, w)
    nearby = Rotation.from_rotvec(rng.normal(scale=0.02, size=(200, 3))).as_matrix() @ R
    anywhere = Rotation.random(2000, random_state=rng).as_matrix()
    for other in np.concatenate([nearby, anywhere]):
        assert cost(other, source, target, w) >= best * (1 - 1e-12)


def test_rms_is_what_is_left(cloud, rng):
    target = moved(cloud, rng)[0] + rng.normal(size=cloud.shape)
    for scale in (False, True):
        found = procrustes(cloud, target, scale=scale)
        left = np.sqrt(((found.apply(cloud) - target) ** 2).sum(axis=1).mean())
        assert found.rms == pytest.approx(left, rel=1e-9)


def test_the_way_moved_and_the_angle_are_those_of_the_motion(cloud):
    turn = Rotation.from_rotvec(np.radians(25) * np.array([0, 0.6, 0.8]))
    found = procrustes(cloud, turn.apply(cloud) + [30, 0, 4])
    assert found.degrees == pytest.approx(25, abs=1e-9)
    way = np.linalg.norm(turn.apply(cloud) + [30, 0, 4] - cloud, axis=1)
    assert found.travel(cloud) == pytest.approx(np.sqrt((way**2).mean()), rel=1e-9)


def test_a_point_of_weight_zero_and_one_not_seen_have_no_say(cloud, rng):
    target, R, _ = moved(cloud, rng)
    target[0] += 500
    target[1] = np.nan
    weights = np.ones(40)
    weights[0] = 0
    np.testing.assert_allclose(procrustes(cloud, target, weights).rotation, R, atol=1e-10)


def test_mirrored_data_is_noticed_and_never_fitted_with_a_reflection(cloud, rng):
    target = moved(cloud, rng)[0]
    mirrored = procrustes(cloud * [-1, 1, 1] + rng.normal(size=cloud.shape), target, scale=True)
    assert mirrored.mirrored and np.linalg.det(mirrored.rotation) > 0
    assert not procrustes(cloud + rng.normal(size=cloud.shape), target).mirrored
    with pytest.raises(ValueError, match=r"the markers: mirrored.*Negate one axis"):
        check_like(mirrored, "the markers")


def test_flat_data_is_not_called_mirrored(cloud, rng):
    flat = cloud * [1, 1, 0]  # its mirror image is also a turn of it
    assert not procrustes(flat * [-1, 1, 1], flat).mirrored


@pytest.mark.parametrize(
    ("factor", "unit"), [(1e-3, "metres: multiply by 1000"), (0.1, "centimetres"), (7.0, "Scale")]
)
def test_other_units_are_noticed_by_size(cloud, rng, factor, unit):
    with pytest.raises(ValueError, match=unit):
        check_like(procrustes(factor * cloud, moved(cloud, rng)[0], scale=True), "scan")
    check_like(procrustes(1.2 * cloud, cloud, scale=True), "a large head")


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "3 or more"),
        (np.arange(6)[:, None] * np.ones(3), np.arange(6)[:, None] * np.ones(3), "one line"),
        (np.zeros((4, 3)), np.zeros((4, 3)), "one line"),
        (np.eye(3), np.ones((4, 3)), "target has shape"),
        (np.full((3, 3), np.inf), np.eye(3), "infinite"),
    ],
)
def test_what_leaves_the_turn_open_is_refused(source, target, message):
    with pytest.raises(ValueError, match=message):
        procrustes(source, target)


@pytest.mark.parametrize("weights", [[-1, 1, 1], [0, 0, 0]])
def test_bad_weights_are_refused(weights):
    with pytest.raises(ValueError, match="weights holds"):
        procrustes(np.eye(3), np.eye(3), weights)


def planted_head(cloud, rng, n_frames=60):
    """A head that turns while the lower third of its points talks."""
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.02, size=(n_frames, 3)), axis=0))
    shift = np.cumsum(rng.normal(size=(n_frames, 3)), axis=0) + [100, 1200, 0]
    talking = cloud[:, 1] < np.quantile(cloud[:, 1], 0.33)
    face = np.repeat(cloud[None], n_frames, axis=0)
    open_ = 8 + 8 * np.sin(np.arange(n_frames) / 3)
    face[:, talking] -= open_[:, None, None] * [0, 1, 1]  # down and back, as a jaw
    R = turn.as_matrix()
    seen = np.matmul(face, np.swapaxes(R, 1, 2)) + shift[:, None]
    return seen + rng.normal(scale=0.2, size=seen.shape), R, shift, talking


def test_the_rigid_parts_are_found_and_tell_the_head_from_the_face(cloud, rng):
    seen, R, shift, talking = planted_head(cloud, rng)
    weights = rigid_weights(seen, cloud)
    assert weights[talking].max() < 0.1 < 0.5 < weights[~talking].min()
    turns = {}
    for name, options in {"rigid": {"weights": weights, "robust": True}, "whole": {}}.items():
        motion = rigid_motion(seen, cloud, **options)
        off = Rotation.from_matrix(motion.rotation @ np.swapaxes(R, 1, 2)).magnitude()
        turns[name] = np.degrees(np.sqrt((off**2).mean()))
        np.testing.assert_allclose(np.linalg.det(motion.rotation), 1)
    assert turns["rigid"] < 0.15 < 1 < turns["whole"]  # noise 0.2 mm over a lever of 50 mm
    assert np.abs(rigid_motion(seen, cloud, weights, True).translation - shift).max() < 0.5


def test_a_robust_motion_shrugs_off_wild_points(cloud, rng):
    seen, R, _, _ = planted_head(cloud, rng)
    weights = rigid_weights(seen, cloud)
    wild = np.flatnonzero(weights > 0.5)[:4]
    seen[:, wild] += 15
    motion = rigid_motion(seen, cloud, weights, robust=True)
    off = Rotation.from_matrix(motion.rotation @ np.swapaxes(R, 1, 2)).magnitude()
    assert np.degrees(off).max() < 0.3


def test_head_frame_and_capture_frame_are_inverse(cloud, rng):
    seen, *_ = planted_head(cloud, rng)
    motion = rigid_motion(seen, cloud)
    np.testing.assert_allclose(motion.to_capture(motion.to_head(seen)), seen, atol=1e-9)


def test_each_frame_is_the_same_as_alone(cloud, rng):
    seen, *_ = planted_head(cloud, rng)
    seen[3, :20] = np.nan
    motion = rigid_motion(seen, cloud)
    for frame in (0, 3, 17):
        alone = procrustes(cloud, seen[frame])
        np.testing.assert_allclose(motion.rotation[frame], alone.rotation, atol=1e-9)
        np.testing.assert_allclose(motion.translation[frame], alone.translation, atol=1e-6)
        assert motion.rms[frame] == pytest.approx(alone.rms, rel=1e-6)


def test_frames_with_too_little_are_lost_and_keep_their_place(cloud, rng):
    seen, *_ = planted_head(cloud, rng)
    reference = cloud.copy()
    reference[:4] = np.outer(np.arange(4), [10, 20, 5])  # four points on one line
    seen[1] = np.nan
    seen[2, 2:] = np.nan
    seen[4, 4:] = np.nan
    motion = rigid_motion(seen, reference)
    assert np.flatnonzero(~motion.valid).tolist() == [1, 2, 4]
    assert (
        np.isnan(motion.rotation[[1, 2, 4]]).all() and np.isfinite(motion.rms[motion.valid]).all()
    )
