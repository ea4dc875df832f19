import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import grid_mesh

from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MarkerSequence, MotionSequence, WeightSequence

MESH = TriangleMesh([[0, 0, 0], [10, 0, 0], [0, 10, 0], [10, 10, 5]], [[0, 1, 2], [1, 3, 2]])


def motion(n_frames=6, fps=30.0, valid=None, dtype=float):
    """Positions in which frame f, vertex v, axis a reads 100 f + 10 v + a."""
    f, v, a = np.ogrid[:n_frames, :4, :3]
    return MotionSequence((100 * f + 10 * v + a).astype(dtype), fps, MESH, valid)


def weights(n_frames=6, fps=60.0, valid=None, **more):
    W = np.arange(2.0 * n_frames).reshape(n_frames, 2)
    return WeightSequence(W, ("jawOpen", "mouthClose"), fps, valid, **more)


# --- resampling -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "old, new", [(60, 30), (60, 24), (30, 29.97), (120, 7), (30, 30), (60, 25)]
)
def test_resampled_frames_are_those_nearest_to_the_new_beat(old, new):
    slow = weights(240, old).resampled(new)
    picked = slow.weights[:, 0] / 2  # the first column counts frames in twos
    np.testing.assert_array_equal(picked, np.round(picked))
    beat = np.arange(slow.n_frames) / new
    # nearest: never further than half an old frame; the last may not lie beyond the take
    assert (np.abs(picked / old - beat) <= 0.5 / old + 1e-9).all()


@pytest.mark.parametrize("new", [60, 59, 30, 25, 24, 12.5, 1])
def test_a_resampled_take_lasts_as_long(new):
    take = weights(600, 60)
    slow = take.resampled(new)
    assert slow.fps == new
    assert 0 <= take.duration - slow.duration < 1 / new + 1e-9


def test_a_take_at_half_its_rate_is_every_other_frame():
    np.testing.assert_array_equal(weights(10, 60).resampled(30).weights, weights(10).weights[::2])


def test_lost_frames_and_angles_stay_with_their_frames():
    valid = np.arange(8) != 4
    take = weights(8, 60, valid, angles={"HeadYaw": np.arange(8) * 0.1})
    slow = take.resampled(30)
    np.testing.assert_array_equal(slow.valid, [True, True, False, True])
    np.testing.assert_allclose(slow.angles["HeadYaw"], [0, 0.2, 0.4, 0.6])


def test_resampling_makes_up_no_frames():
    with pytest.raises(ValueError, match="fps=120, but the sequence has 60"):
        weights(6, 60).resampled(120)


@pytest.mark.parametrize("fps", [0, -30, np.nan])
def test_a_rate_that_is_none_is_refused(fps):
    with pytest.raises(ValueError, match=r"fps=.*must be .*more than 0"):
        weights().resampled(fps)


@pytest.mark.parametrize("n_frames", [0, 1, 2])
def test_very_short_takes_can_be_resampled(n_frames):
    assert weights(n_frames, 60).resampled(24).n_frames == min(n_frames, 1)


def test_duration_is_frames_by_rate():
    assert weights(90, 60).duration == 1.5


# --- motion of a mesh -----------------------------------------------------------------------------


def test_displacements_are_x_y_z_side_by_side_with_the_neutral_taken_away():
    X = motion(3).displacements()
    assert X.shape == (3, 12)
    for frame in range(3):
        for vertex in range(4):
            for axis in range(3):
                expected = 100 * frame + 10 * vertex + axis - MESH.vertices[vertex, axis]
                assert X[frame, 3 * vertex + axis] == expected


def test_the_neutral_is_no_displacement():
    still = MotionSequence(np.tile(MESH.vertices, (5, 1, 1)), 30, MESH)
    assert not still.displacements().any()


def test_lost_frames_have_no_displacement_but_keep_their_place():
    valid = np.array([True, False, True, True, False, True])
    take = motion(6, valid=valid)
    assert take.n_frames == 6
    np.testing.assert_array_equal(take.displacements(), motion(6).displacements()[valid])


def test_float32_stays_float32_but_displacements_are_float64():
    take = motion(3, dtype=np.float32)
    assert take.positions.dtype == np.float32
    assert take.displacements().dtype == np.float64


def test_a_slice_of_a_take_is_a_take():
    part = motion(6, valid=np.arange(6) != 3)[2:5]
    np.testing.assert_array_equal(part.positions, motion(6).positions[2:5])
    np.testing.assert_array_equal(part.valid, [True, False, True])
    assert (part.fps, part.mesh) == (30, MESH)


def test_positions_that_are_not_finite_are_allowed_in_lost_frames_only():
    P = motion(4).positions
    P[2] = np.nan
    assert MotionSequence(P, 30, MESH, np.arange(4) != 2).displacements().shape == (3, 12)
    with pytest.raises(
        ValueError, match=r"NaN or infinite values in 1 frame.*the first 2.*`valid`"
    ):
        MotionSequence(P, 30, MESH)


@pytest.mark.parametrize(
    "shape", [(5, 3, 3), (5, 4, 2), (4, 3), (5, 12)], ids=lambda s: "x".join(map(str, s))
)
def test_positions_of_another_mesh_are_refused(shape):
    with pytest.raises(ValueError, match=r"positions has shape .* asks for \(n_frames, 4, 3"):
        MotionSequence(np.zeros(shape), 30, MESH)


@pytest.mark.parametrize("make", [motion, weights])
@pytest.mark.parametrize(
    "valid", [np.ones(5, bool), np.ones(6), np.ones((6, 1), bool)], ids=["short", "floats", "2d"]
)
def test_a_mask_needs_one_bool_for_each_frame(make, valid):
    with pytest.raises(ValueError, match=r"valid has shape .*one bool for each of the 6 frames"):
        make(6, valid=valid)


@pytest.mark.parametrize("make", [motion, weights])
@pytest.mark.parametrize("fps", [0, -1, np.inf, np.nan])
def test_a_sequence_needs_a_rate(make, fps):
    with pytest.raises(ValueError, match=r"fps=.*more than 0"):
        make(fps=fps)


@pytest.mark.parametrize("make", [motion, weights])
def test_a_rate_in_words_is_refused(make):
    with pytest.raises(TypeError, match="fps='fast' is not a number"):
        make(fps="fast")


@pytest.mark.parametrize("make", [motion, weights])
def test_one_frame_is_no_sequence(make):
    with pytest.raises(TypeError, match="give a slice"):
        make()[3]


# --- weights --------------------------------------------------------------------------------------


def test_a_slice_of_weights_takes_mask_and_angles_along():
    take = weights(6, valid=np.arange(6) != 3, angles={"HeadYaw": np.arange(6)})
    part = take[1:5]
    np.testing.assert_array_equal(part.weights, take.weights[1:5])
    np.testing.assert_array_equal(part.valid, [True, True, False, True])
    np.testing.assert_array_equal(part.angles["HeadYaw"], [1, 2, 3, 4])


def test_weights_that_are_not_finite_are_allowed_in_lost_frames_only():
    W = np.full((4, 2), 0.5)
    W[1] = np.nan
    WeightSequence(W, ("a", "b"), 30, np.arange(4) != 1)
    with pytest.raises(ValueError, match=r"weights in valid frames holds 2 value.*NaN"):
        WeightSequence(W, ("a", "b"), 30)


@pytest.mark.parametrize(
    "W, names, words",
    [
        (np.zeros((3, 2)), ("a",), r"weights has shape \(3, 2\), but 1 names ask for"),
        (np.zeros(3), ("a", "b", "c"), r"weights has shape \(3,\)"),
        (np.zeros((3, 3)), ("a", "b", "a"), "names holds a more than once"),
    ],
)
def test_weights_that_do_not_fit_their_names_are_refused(W, names, words):
    with pytest.raises(ValueError, match=words):
        WeightSequence(W, names, 30)


def test_angles_need_one_value_for_each_frame():
    with pytest.raises(ValueError, match=r"angles.'HeadYaw'. has shape \(5,\), but there are 6"):
        weights(6, angles={"HeadYaw": np.zeros(5)})


# --- gaps, names, rest and jitter -----------------------------------------------------------------


def test_a_gap_stays_in_its_place_when_a_take_is_cut():
    take = weights(10, 50, gaps={4: 2.0, 8: 3.0})
    np.testing.assert_allclose(take.times, np.arange(10) / 50 + np.repeat([0, 2, 5], [4, 4, 2]))
    assert take[2:].gaps == {2: 2.0, 6: 3.0}
    assert take[4:8].gaps == {}  # nothing is missing before its first frame
    assert take[[0, 9]].gaps == {1: 5.0}
    assert take[np.arange(10) != 4].gaps == {4: 2.0, 7: 3.0}
    assert take[::-1].gaps == take[:0].gaps == {}
    assert take.resampled(25).gaps == {2: 2.0, 4: 3.0}
    assert repr(take).endswith("0 lost, 2 gaps in time)")


@pytest.mark.parametrize(
    "gaps, words",
    [
        ({0: 1.0}, "gaps names frame 0, but nothing comes before it"),
        ({6: 1.0}, "frame of a gap=6, but there are 6 frames"),
        ({2: 0.0}, r"gaps\[2\]=0.0, but it must be more than 0"),
        ({2: np.nan}, r"gaps\[2\]=nan"),
    ],
)
def test_gaps_that_cannot_be_are_refused(gaps, words):
    with pytest.raises(ValueError, match=words):
        weights(6, gaps=gaps)


def test_stretches_end_at_lost_frames_and_gaps():
    valid = ~np.isin(np.arange(12), (0, 4, 5, 11))
    take = weights(12, valid=valid, gaps={5: 3.0, 8: 3.0})
    assert take.stretches() == [slice(1, 4), slice(6, 8), slice(8, 11)]
    assert weights(3).stretches() == [slice(0, 3)]
    assert weights(0).stretches() == weights(2, valid=np.zeros(2, dtype=bool)).stretches() == []


def test_what_was_recorded_beside_stays_with_its_frames():
    take = weights(6, others={"mood": [1, 2, np.nan, 4, 5, 6]}, report="said")
    np.testing.assert_array_equal(take[1:4].others["mood"], [2, np.nan, 4])
    assert take[1:4].report == "said"
    with pytest.raises(ValueError, match=r"others.'mood'. has shape \(2,\), but there are 6"):
        weights(6, others={"mood": [1, 2]})


@pytest.mark.parametrize("bad", [[["0.25", "0.5"]], [[True, False]], [[None, 1.0]]])
def test_only_numbers_are_weights(bad):
    with pytest.raises(TypeError, match=r"weights is an array of .* give floats"):
        WeightSequence(bad, ("a", "b"), 30)


def test_a_take_is_renamed_by_table_or_rule():
    take = weights()
    assert take.renamed({"jawOpen": "AU26"}).names == ("AU26", "mouthClose")
    swapped = take.renamed({"jawOpen": "mouthClose", "mouthClose": "jawOpen"})
    assert swapped.names == ("mouthClose", "jawOpen")
    assert take.renamed(str.upper).names == ("JAWOPEN", "MOUTHCLOSE")
    np.testing.assert_array_equal(swapped.weights, take.weights)
    with pytest.raises(ValueError, match="mapping names JawOpen, which the sequence does not have"):
        take.renamed({"JawOpen": "jaw"})
    with pytest.raises(ValueError, match="names holds mouthClose more than once"):
        take.renamed({"jawOpen": "mouthClose"})


def test_a_resting_face_taken_off_rests_at_zero():
    W = np.array([[0.1, 0.2], [0.1, 0.4], [0.3, 0.3], [0.9, 0.05]])
    take = WeightSequence(W, ("a", "b"), 30)
    for neutral, rest in (
        (1, [0.1, 0.4]),
        (slice(0, 3), [0.1, 0.3]),  # the median
        ({"b": 0.3}, [0, 0.3]),
        ([0.1, 0.05], [0.1, 0.05]),
    ):
        np.testing.assert_allclose(
            take.calibrated(neutral).weights, np.maximum(W - rest, 0), atol=1e-15
        )
        np.testing.assert_allclose(take.calibrated(neutral, clip=False).weights, W - rest)
    assert not take.calibrated(2).weights[2].any()


def test_lost_frames_are_no_rest_and_stay_lost():
    W = np.array([[0.1, 0.2], [np.nan, np.nan], [0.3, 0.3]])
    take = WeightSequence(W, ("a", "b"), 30, [True, False, True])
    np.testing.assert_allclose(take.calibrated(slice(None)).weights[2], [0.1, 0.05])
    np.testing.assert_array_equal(take.calibrated(0).valid, take.valid)
    for neutral in (1, slice(1, 2), slice(5, 9)):
        with pytest.raises(ValueError, match="no frame there, or all of them are lost"):
            take.calibrated(neutral)
    for neutral, words in (
        (3, "neutral=3, but there are 3 frames"),
        ({"c": 1.0}, "neutral names c, which the sequence does not have"),
        ([0.1], r"neutral has shape \(1,\), but needs shape \(2,\)"),
        ([0.1, np.nan], "neutral holds 1 value"),
    ):
        with pytest.raises(ValueError, match=words):
            take.calibrated(neutral)


@pytest.mark.parametrize("beta", [None, 2.0], ids=["zero-phase", "One-Euro"])
def test_each_stretch_is_smoothed_by_itself_and_nothing_across(beta, rng):
    W, yaw = rng.uniform(size=(60, 2)), rng.normal(size=60)
    valid = ~np.isin(np.arange(60), (20, 21, 40))
    W[~valid], yaw[~valid] = np.nan, np.nan
    take = WeightSequence(W, ("a", "b"), 60, valid, {"HeadYaw": yaw}, gaps={50: 9.0})
    smooth = take.smoothed(4, beta)
    np.testing.assert_array_equal(smooth.valid, valid)
    assert np.isnan(smooth.weights[~valid]).all() and smooth.gaps == take.gaps
    for part in (slice(0, 20), slice(22, 40), slice(41, 50), slice(50, 60)):
        alone = take[part].smoothed(4, beta)
        np.testing.assert_array_equal(smooth.weights[part], alone.weights)
        np.testing.assert_array_equal(smooth.angles["HeadYaw"][part], alone.angles["HeadYaw"])
        assert np.abs(np.diff(alone.weights, axis=0)).mean() < 0.2  # of 0.33 between random numbers


def test_smoothing_takes_jitter_away_and_leaves_the_motion(rng):
    t = np.arange(600) / 60
    truth = 0.5 + 0.3 * np.sin(2 * np.pi * t)
    noisy = truth + rng.normal(scale=0.02, size=600)
    take = WeightSequence(np.column_stack([noisy, noisy]), ("a", "b"), 60)
    error = np.abs(take.smoothed(4).weights[:, 0] - truth)[30:-30].mean()
    assert error < 0.5 * np.abs(noisy - truth).mean()


def test_smoothing_refuses_what_the_rate_cannot_hold():
    with pytest.raises(ValueError, match="cutoff=30 hertz, but 60 frames a second hold"):
        weights(9, 60).smoothed(30)
    with pytest.raises(ValueError, match=r"beta=-1, but it must be 0 or more"):
        weights(9, 60).smoothed(1, beta=-1)


# --- markers --------------------------------------------------------------------------------------


def markers(**changed):
    P = np.arange(24.0).reshape(4, 2, 3)
    P[1, 0] = np.nan
    P[2] = np.nan
    return MarkerSequence(**{"positions": P, "names": ("LBRO", "RBRO"), "fps": 120.0, **changed})


def test_occluded_markers_are_those_without_a_position():
    take = markers()
    np.testing.assert_array_equal(take.visible, [[1, 1], [0, 1], [0, 0], [1, 1]])
    np.testing.assert_array_equal(take.valid, [True, True, False, True])


def test_markers_are_picked_by_name_in_the_order_given():
    both = markers().select(["RBRO", "LBRO"])
    assert both.names == ("RBRO", "LBRO")
    np.testing.assert_array_equal(both.positions, markers().positions[:, ::-1])


@pytest.mark.parametrize(
    "changed, words",
    [
        ({"positions": np.zeros((4, 3, 3))}, r"positions has shape \(4, 3, 3\), but 2 names"),
        ({"positions": np.full((4, 2, 3), np.inf)}, "infinite values, 8 in .* LBRO in frame 0"),
        ({"positions": np.array([[[0, np.nan, 0], [0, 0, 0]]])}, "seen in part.*LBRO in frame 0"),
        ({"names": ("A", "A")}, "names holds A more than once"),
        ({"fps": 0}, "fps=0"),
    ],
)
def test_markers_that_cannot_be_are_refused(changed, words):
    with pytest.raises(ValueError, match=words):
        markers(**changed)


def test_unknown_markers_are_refused_by_name():
    with pytest.raises(ValueError, match=r"unknown marker.s. NOSE; this sequence has LBRO, RBRO"):
        markers().select(["NOSE", "LBRO"])


@pytest.mark.parametrize(
    "take, words",
    [
        (motion(5, valid=np.arange(5) != 1), "5 frames of 4 vertices, 30 frames/s, 1 lost"),
        (weights(5), "5 frames of 2 weights, 60 frames/s, 0 lost"),
        (markers(), "4 frames of 2 markers, 120 frames/s, 37.5 % occluded"),
    ],
    ids=["motion", "weights", "markers"],
)
def test_a_sequence_says_what_it_is(take, words):
    assert words in repr(take)


def test_gaps_reach_the_share_asked_for_in_bursts(rng):
    markers = MarkerSequence(rng.normal(size=(400, 50, 3)), [f"m{i}" for i in range(50)], 60)
    gappy = markers.with_gaps(0.3, seconds=0.2, random_state=1)
    hidden = ~gappy.visible
    assert 0.3 <= hidden.mean() < 0.32
    edges = np.diff(hidden.astype(int), axis=0)
    starts, stops = (edges == 1).sum(), (edges == -1).sum()
    assert hidden.sum() / max(starts, stops) >= 12  # frames of a burst
    np.testing.assert_array_equal(gappy.positions[~hidden], markers.positions[~hidden])
    again = markers.with_gaps(0.3, seconds=0.2, random_state=1)
    np.testing.assert_array_equal(again.positions, gappy.positions)
    assert gappy.with_gaps(0.1, random_state=0).visible.sum() == gappy.visible.sum()


@pytest.mark.parametrize("wrong", [{"share": 1.0}, {"share": -0.1}, {"share": 0.1, "seconds": 0}])
def test_gaps_that_cannot_be_made_are_refused(wrong):
    markers = MarkerSequence(np.zeros((4, 2, 3)), ("a", "b"), 60)
    with pytest.raises(ValueError, match=list(wrong)[-1]):
        markers.with_gaps(**wrong)


def test_aligned_takes_away_what_all_of_the_face_does_together(rng):
    mesh = grid_mesh(6, 5, spacing=10.0)
    moved = mesh.vertices + rng.normal(scale=0.1, size=(8, 30, 3))
    turns = Rotation.random(8, random_state=0).as_matrix()
    away = np.einsum("fij,fvj->fvi", turns, moved) + rng.normal(scale=50, size=(8, 1, 3))
    at_home = MotionSequence(moved, 30.0, mesh).aligned().positions
    np.testing.assert_allclose(
        MotionSequence(away, 30.0, mesh).aligned().positions, at_home, atol=1e-3
    )
    centre = at_home.mean(axis=1) - mesh.vertices.mean(axis=0)
    np.testing.assert_allclose(centre, 0, atol=1e-4)
    cross = np.cross(mesh.vertices - mesh.vertices.mean(axis=0), at_home).sum(axis=1)
    np.testing.assert_allclose(cross, 0, atol=0.05)  # no turn is left that would bring it nearer
