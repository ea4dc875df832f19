import json
import shutil

import numpy as np
import pytest
from scipy.spatial import cKDTree

import data_synth.__main__ as command
from data_synth import capture as module
from data_synth.actors import ACTORS
from data_synth.capture import (
    RADIUS,
    SIZES,
    Capture,
    Size,
    actor_rig,
    contours,
    fault,
    make_capture,
    open_capture,
    place_markers,
)
from data_synth.performance import SENTENCES
from facelab.data.actors import load_capture
from facelab.files import read_c3d
from facelab.geometry.mesh import MULTI_PIE

TINY = Size(30.0, SIZES["small"].n_vertices, ("pride_1", "rage_5"), 3.0, 2)


@pytest.fixture(scope="module")
def rig():
    return actor_rig("M1", SIZES["small"].n_vertices)


@pytest.fixture(scope="module")
def capture(tmp_path_factory, rig):
    """The small set of M1."""
    folder = tmp_path_factory.mktemp("captures") / "M1"
    return make_capture("M1", folder, "small", 0, rig, progress=False)


@pytest.fixture
def tiny(monkeypatch, rig):
    """A size of its own, made in half a second with the face at hand."""
    monkeypatch.setitem(SIZES, "tiny", TINY)
    monkeypatch.setattr(module, "actor_rig", lambda actor, n_vertices: rig)


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


# --- sites ----------------------------------------------------------------------------------------


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
        assert not module._within(feet, line).any()


def test_sites_follow_from_the_seed(rig):
    a, b, c = (place_markers(rig.neutral, 11.5, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.weights, b.weights)
    assert a.weights.shape != c.weights.shape or not np.allclose(a.weights, c.weights)


# --- what the cameras see -------------------------------------------------------------------------


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
    hidden = module._bursts(np.random.default_rng(0), hazard, 0.03, 60.0)
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


# --- the cache ------------------------------------------------------------------------------------


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path, tiny):
    about = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        made = make_capture("M1", tmp_path / name, "tiny", seed, progress=False)
        about.append(json.loads((made.folder / "manifest.json").read_text())["files"])
    assert about[0] == about[1]
    assert all(about[0][f] != about[2][f] for f in ("pride_1.c3d", "rom.c3d", "truth.npz"))


def test_a_capture_is_made_once(tmp_path, tiny, monkeypatch):
    first = open_capture("M1", tmp_path, "tiny", progress=False)
    assert first.folder == tmp_path / "data_synth-1-tiny-0" / "M1"
    monkeypatch.setattr(module, "make_capture", None)
    assert open_capture("M1", tmp_path, "tiny").texts == first.texts


def cut(folder):
    file = folder / "rom.c3d"
    file.write_bytes(file.read_bytes()[:-5000])


def flip(folder):
    data = bytearray((folder / "truth.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "truth.npz").write_bytes(data)


def older(folder):
    about = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**about, "code": "0123"}))


DAMAGE = {
    "rom.c3d damaged": cut,
    "truth.npz damaged": flip,
    "rage_5.c3d missing": lambda folder: (folder / "rage_5.c3d").unlink(),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "manifest is damaged": lambda folder: (folder / "manifest.json").write_text('{"files": '),
    "manifest is damaged .KeyError": lambda folder: (folder / "manifest.json").write_text("{}"),
}


@pytest.mark.parametrize("words, damage", DAMAGE.items(), ids=list(DAMAGE))
def test_a_half_written_cache_is_noticed_and_made_again(tmp_path, tiny, words, damage):
    made = open_capture("M1", tmp_path, "tiny", progress=False)
    damage(made.folder)
    with pytest.raises(ValueError, match=f"holds no whole capture: .*{words}"):
        Capture(made.folder)
    again = open_capture("M1", tmp_path, "tiny", progress=False)
    assert fault(again.folder) is None
    assert again.markers("rom").n_frames == 90
    assert [f.name for f in made.folder.parent.iterdir()] == ["M1"]


def test_a_cache_made_by_other_code_is_made_again_and_its_skin_not_guessed(tmp_path, tiny):
    made = open_capture("M1", tmp_path, "tiny", progress=False)
    older(made.folder)
    with pytest.raises(ValueError, match="made by another version of data_synth"):
        Capture(made.folder).surface("rom", [0])
    open_capture("M1", tmp_path, "tiny", progress=False).surface("rom", [0])


@pytest.mark.parametrize("accident", [KeyboardInterrupt, OSError, MemoryError])
def test_an_interrupted_run_leaves_nothing(tmp_path, tiny, monkeypatch, accident):
    written = []

    def write(path, markers):
        if len(written) == 2:
            raise accident("in the middle")
        written.append(path)
        path.write_bytes(b"something")

    monkeypatch.setattr(module, "write_c3d", write)
    with pytest.raises(accident):
        open_capture("M1", tmp_path, "tiny", progress=False)
    assert len(written) == 2
    assert not list((tmp_path / "data_synth-1-tiny-0").iterdir())


def test_what_a_killed_run_left_is_swept_away_in_time(tmp_path, tiny):
    left = tmp_path / ".M1.abcd.part"
    young = tmp_path / ".M1.efgh.part"
    for folder in (left, young):
        folder.mkdir()
        (folder / "rom.c3d").touch()
    module.os.utime(left, (0, 0))
    make_capture("M1", tmp_path / "M1", "tiny", progress=False)
    assert sorted(f.name for f in tmp_path.iterdir()) == [".M1.efgh.part", "M1"]


def test_two_that_make_the_same_capture_at_once_both_get_it(tmp_path, tiny, monkeypatch):
    """The other one is faster: our folder cannot take its place, and need not."""
    make = module.make_capture

    def slower(actor, folder, size, random_state, progress):
        make(actor, folder, size, random_state, progress=progress)
        return make(actor, folder, size, random_state, progress=progress)

    monkeypatch.setattr(module, "make_capture", slower)
    assert fault(open_capture("M1", tmp_path, "tiny", progress=False).folder) is None


def test_a_folder_with_something_in_it_is_not_written_over(tmp_path, tiny):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(FileExistsError, match="holds something already"):
        make_capture("M1", tmp_path, "tiny")
    assert [f.name for f in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_facade_keeps_captures_in_the_cache(tmp_path, tiny, monkeypatch):
    monkeypatch.setenv("FACELAB_CACHE", str(tmp_path))
    capture = load_capture("M1", "tiny", random_state=2, progress=False)
    assert capture.folder == tmp_path / "data_synth-1-tiny-2" / "M1"
    assert capture.random_state == 2


@pytest.mark.parametrize(
    "asked, error, words",
    [
        (
            {"actor": "M9"},
            ValueError,
            "actor='M9' is unknown; choose one of 'M1', 'F1', 'M2', 'F2'",
        ),
        ({"size": "huge"}, ValueError, "size='huge' is unknown; choose one of 'default', 'small'"),
        ({"random_state": -1}, ValueError, "random_state=-1, but it must be 0 or more"),
        ({"random_state": 1.5}, TypeError, "random_state=1.5 is not an integer"),
        ({"random_state": None}, TypeError, "random_state=None is not an integer"),
    ],
)
def test_what_cannot_be_made_is_refused_before_anything_is_written(tmp_path, asked, error, words):
    with pytest.raises(error, match=words):
        load_capture(**{"actor": "M1", "root": tmp_path, **asked})
    assert not list(tmp_path.iterdir())


def test_a_rig_with_other_units_is_refused(tmp_path, tiny, rig):
    other = rig.linear()
    object.__setattr__(other, "names", (*other.names[:-1], "AU99"))
    with pytest.raises(ValueError, match=r"rig.names is .*AU99, but must be the forty units"):
        make_capture("M1", tmp_path / "M1", "tiny", rig=other, progress=False)
    assert not list(tmp_path.iterdir())


# --- the command ----------------------------------------------------------------------------------


def test_the_command_makes_what_it_is_asked_for(tmp_path, tiny, capsys):
    assert command.main(["--out", str(tmp_path), "--actors", "M1", "--size", "tiny"]) == 0
    out, progress = capsys.readouterr()
    assert "Capture(M1" in out
    assert "M1: capture" in progress
    assert fault(tmp_path / "data_synth-1-tiny-0" / "M1") is None


def test_the_command_says_what_went_wrong(tmp_path, tiny, capsys, monkeypatch):
    (tmp_path / "file").touch()
    asked = ["--actors", "M1", "--size", "tiny", "--quiet", "--out"]
    assert command.main([*asked, str(tmp_path / "file")]) == 1
    assert "Could not write to" in capsys.readouterr().err

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "open_capture", interrupted)
    assert command.main([*asked, str(tmp_path)]) == 130
    assert "nothing half-made" in capsys.readouterr().err
    for wrong in (["--actors", "M7"], ["--size", "huge"], ["--random-state", "-1"]):
        with pytest.raises(SystemExit):
            command.main(wrong)


def test_no_other_mesh_is_needed_than_one_with_landmarks(rig, tmp_path, tiny):
    """Another rig that keeps to the protocol takes the same way: here the linear one."""

    class Linear:
        names, neutral, deltas = rig.names, rig.neutral, rig.deltas

        def animate(self, weights, vertices=None):
            pick = slice(None) if vertices is None else vertices
            moved = np.tensordot(weights, self.deltas[:, pick], axes=1)
            return self.neutral.vertices[pick] + moved

    made = make_capture("M1", tmp_path / "M1", "tiny", rig=Linear(), progress=False)
    assert made.surface("rom", [0]).shape == (1, rig.neutral.n_vertices, 3)
    shutil.rmtree(made.folder)
