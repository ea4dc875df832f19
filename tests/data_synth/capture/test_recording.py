import numpy as np
import pytest

from data_synth.capture import SIZES
from data_synth.capture.faults import bursts
from data_synth.capture.recording import RADIUS
from data_synth.performance import SENTENCES
from facelab.files import read_c3d


def deviations(capture, take):
    """Measured minus true positions of the real markers, (n_frames, n_markers, 3); NaN = hidden."""
    markers, true = capture.markers(take), capture.true_markers(take)
    return markers.select(true.names).positions - true.positions


def unswapped(capture, take):
    """True where a marker bears its own name: (n_frames, n_markers)."""
    truth = capture.truth(take)
    own = np.ones((truth.weights.n_frames, len(capture.sites.names)), dtype=bool)
    for first, stop, a, b in truth.swaps:
        own[first:stop, [capture.sites.names.index(n) for n in (a, b)]] = False
    return own


def takes_of(capture):
    return [take for names in capture.takes.values() for take in names]


def test_takes_are_listed_by_kind(capture):
    assert capture.takes["train"] == ("pride_1", "rage_1", "contempt_1")
    assert capture.takes["test"] == ("pride_5", "rage_5", "contempt_5")
    assert capture.takes["rom"] == ("rom",)
    assert len(capture.takes["facs"]) == 4
    assert capture.texts["rage_1"] == SENTENCES["rage_1"].text
    assert "M1" in repr(capture)


def test_marker_centres_lie_a_radius_off_the_skin_on_its_outer_side(capture, rig):
    """Against the dense surface, rebuilt and posed by another road than the markers' own."""
    for take in ("rage_1", "rom"):
        truth, frames = capture.truth(take), np.arange(5, 100, 30)
        skin = capture.surface(take, frames).astype(float)
        feet = np.einsum(
            "mc,fmcx->fmx", capture.sites.weights, skin[:, rig.neutral.faces[capture.sites.faces]]
        )
        R, t = truth.rotation[frames], truth.translation[frames]
        back = np.einsum(
            "fyx,fmy->fmx", R, capture.true_markers(take).positions[frames] - t[:, None]
        )
        off = back - feet
        np.testing.assert_allclose(np.linalg.norm(off, axis=2), RADIUS, atol=1e-4)  # float32 skin
        for f in range(len(frames)):
            normals = rig.neutral.with_vertices(skin[f]).normals[rig.neutral.faces]
            outward = normals[capture.sites.faces].mean(axis=1)
            # not less than 45 degrees, even in a fold
            assert ((off[f] * outward).sum(axis=1) > 0.7 * RADIUS).mean() > 0.97


def test_head_pose_is_the_one_that_brings_skin_to_markers(capture):
    """Recovered from the noisy markers by a rigid fit: within 0.1 mm and 0.1 degrees."""
    take = "contempt_1"
    truth, markers = capture.truth(take), capture.markers(take)
    assert np.allclose(np.linalg.det(truth.rotation), 1)
    clean = capture.true_markers(take).positions
    own = unswapped(capture, take)
    for f in range(0, markers.n_frames, 40):
        R, t = truth.rotation[f], truth.translation[f]
        seen = own[f] & markers.visible[f, : clean.shape[1]]
        P = (clean[f, seen] - t) @ R
        Q = markers.positions[f, : clean.shape[1]][seen]
        U, _, Vt = np.linalg.svd((Q - Q.mean(0)).T @ (P - P.mean(0)))
        fit = U @ Vt
        turn = np.degrees(np.arccos(np.clip((np.trace(fit @ R.T) - 1) / 2, -1, 1)))
        assert turn < 0.1
        assert np.linalg.norm(Q.mean(0) - (P.mean(0) @ R.T + t)) < 0.1


def test_the_head_moves_in_the_capture_volume(capture):
    truth = capture.truth("rom")
    assert np.ptp(truth.translation, axis=0).max() > 5
    assert 1000 < truth.translation[:, 1].mean() < 1400


def test_noise_is_as_strong_as_the_truth_says(capture):
    wanted = capture.truth("rom").noise
    assert (0.1 <= wanted).all()
    assert (wanted <= 0.3).all()
    own = unswapped(capture, "rom")
    noise = np.nanstd(deviations(capture, "rom")[own], axis=0)
    np.testing.assert_allclose(noise, wanted, rtol=0.05)


def test_two_to_five_per_cent_are_occluded_in_bursts(capture):
    hidden = np.concatenate([np.isnan(deviations(capture, t)[..., 0]) for t in takes_of(capture)])
    assert 0.02 < hidden.mean() < 0.05
    starts = (np.diff(hidden.astype(int), axis=0) == 1).sum()
    mean_seconds = hidden.sum() / starts / SIZES["small"].fps
    assert 0.08 < mean_seconds < 0.2  # single frames at random would last 0.017 s


def test_occlusions_gather_where_the_skin_turns_away():
    hazard = np.ones((600, 50))
    hazard[:, :25] = 4
    hidden = bursts(np.random.default_rng(0), hazard, 0.03, 60.0)
    assert hidden[:, :25].mean() > 2.5 * hidden[:, 25:].mean()


def test_outside_the_swaps_every_marker_is_what_its_name_says(capture):
    for take in takes_of(capture):
        off = deviations(capture, take)[unswapped(capture, take)]
        assert np.nanmax(np.abs(off)) < 6 * max(capture.truth(take).noise)


def test_in_a_swap_two_neighbours_bear_each_others_name(capture):
    count = 0
    for take in takes_of(capture):
        markers, true = capture.markers(take), capture.true_markers(take)
        for first, stop, a, b in capture.truth(take).swaps:
            seen = markers[first:stop].select([b, a]).positions
            off = seen - true[first:stop].select([a, b]).positions
            if np.isfinite(off).any():
                assert np.nanmax(np.abs(off)) < 6 * max(capture.truth(take).noise)
            count += 1
    assert count > 0


def test_ghosts_are_seen_when_the_truth_says_and_never_else(capture):
    count = 0
    for take in takes_of(capture):
        markers, ghosts = capture.markers(take), capture.truth(take).ghosts
        names = set(markers.names) - set(capture.sites.names)
        assert names == {g.name for g in ghosts}
        for name in names:
            expected = np.zeros(markers.n_frames, dtype=bool)
            for g in ghosts:
                expected[g.first : g.stop] |= g.name == name
            np.testing.assert_array_equal(markers.select([name]).visible[:, 0], expected)
        count += len(ghosts)
    assert count > 0


def test_capture_files_go_the_way_of_real_ones(capture):
    read = read_c3d(capture.path("pride_1"))
    np.testing.assert_array_equal(read.positions, capture.markers("pride_1").positions)
    assert read.names[: len(capture.sites.names)] == capture.sites.names
    assert read.fps == SIZES["small"].fps


def test_surfaces_are_rebuilt_on_demand(capture, rig):
    whole = capture.surface("pride_5", slice(10, 14))
    assert whole.shape == (4, rig.neutral.n_vertices, 3)
    assert whole.dtype == np.float32
    part = capture.surface("pride_5", [12, 10], vertices=[7, 3])
    np.testing.assert_allclose(part, whole[[2, 0]][:, [7, 3]], atol=1e-5)
    weights = capture.truth("pride_5").weights.weights[12]
    np.testing.assert_allclose(whole[2], rig.shape(weights), atol=1e-4)


@pytest.mark.parametrize(
    "asked, words",
    [
        ({"take": "joy_1"}, "take='joy_1' is unknown; choose one of 'pride_1'"),
        ({"frames": [0, 9999]}, "frames holds 9999, but there are"),
        ({"frames": [-1]}, "frames holds -1"),
        ({"vertices": [10**6]}, "vertices holds 1000000, but there are 3000: 0 to 2999"),
        ({"frames": np.zeros(100_000, int)}, "3.4 GiB; ask for fewer frames"),
    ],
)
def test_surfaces_that_are_not_there_are_refused(capture, asked, words):
    with pytest.raises(ValueError, match=words):
        capture.surface(**{"take": "rom", **asked})


@pytest.mark.parametrize("method", ["markers", "truth", "path", "true_markers"])
def test_an_unknown_take_names_the_known_ones(capture, method):
    with pytest.raises(ValueError, match=r"take='pride_9' is unknown; .*'rom', 'facs_01'"):
        getattr(capture, method)("pride_9")
