import numpy as np
import pytest

from facelab.files.live_link import read_live_link_csv
from facelab.files.takes import (
    ARKIT,
    arkit_names,
    read_weights_csv,
    to_arkit,
    write_live_link_csv,
    write_weights_csv,
)
from facelab.motion import WeightSequence


def take(rng, names, n_frames=40, fps=30.0, lost=()):
    W = rng.uniform(size=(n_frames, len(names)))
    valid = np.ones(n_frames, dtype=bool)
    valid[list(lost)] = False
    W[~valid] = np.nan
    return WeightSequence(W, names, fps, valid)


@pytest.mark.parametrize(
    "name, expected",
    [
        ("jawOpen", ("jawOpen",)),
        ("mouthSmile_L", ("mouthSmileLeft",)),
        ("browInnerUp_R", ("browInnerUp",)),
        ("mouthLeft", ("mouthLeft",)),
        ("AU12R", ("mouthSmileRight",)),
        ("AU4", ("browDownLeft", "browDownRight")),
        ("AU1", ("browInnerUp",)),
        ("AU28", ("mouthRollLower", "mouthRollUpper")),
        ("AU30L", ("jawLeft",)),
        ("AU30", ()),
        ("jaw", ()),
        ("mouth", ()),
        ("AU35", ()),
        ("AU11L", ()),
        ("mouth_L", ("mouthLeft",)),
        ("bulge", ()),
    ],
)
def test_a_unit_finds_its_name_in_arkit(name, expected):
    assert arkit_names(name) == expected


def test_the_names_are_those_that_recordings_have(real_takes):
    for recorded in real_takes.values():
        assert recorded.names == ARKIT


def test_every_shape_of_the_scanned_face_has_a_name_and_only_the_tongue_is_left(real_rig):
    found = [arkit_names(n) for n in real_rig.names]
    assert all(found)
    assert {*ARKIT} - {t for f in found for t in f} == {"tongueOut"}


def test_the_units_of_the_actors_go_where_their_table_says():
    from data_synth.units import UNIT_TABLE

    for unit in UNIT_TABLE.values():
        found = arkit_names(unit.name)
        assert {*found} <= {t for i in unit.ict for t in arkit_names(i)}, unit.name
        assert found or unit.name in ("AU11L", "AU11R", "AU13", "AU23", "AU25", "AU35", "AU38")


def test_units_that_share_a_name_give_it_their_strongest(rng):
    given = WeightSequence([[0.2, 0.7, 0.1], [0.5, -0.8, 0.0]], ["AU26", "AU27", "AU12L"], 30)
    arkit = to_arkit(given)
    np.testing.assert_array_equal(arkit.weights[:, ARKIT.index("jawOpen")], [0.7, -0.8])
    np.testing.assert_array_equal(arkit.weights[:, ARKIT.index("mouthSmileLeft")], [0.1, 0])
    assert np.count_nonzero(arkit.weights) == 3


def test_used_units_without_a_counterpart_are_named_and_unused_ones_are_not():
    given = WeightSequence([[0.2, 0.7, 0.0]], ["AU12L", "AU35", "AU38"], 30)
    with pytest.warns(UserWarning, match=r"no such shape: AU35\.$"):
        to_arkit(given)


@pytest.mark.parametrize("fps", [5.0, 10.0, 12.0, 15.0, 20.0, 24.0, 25.0, 30.0, 50.0, 60.0, 120.0])
@pytest.mark.parametrize("n_frames", [2, 17, 200])
def test_a_take_comes_back_from_a_live_link_file(tmp_path, rng, fps, n_frames):
    given = take(rng, ARKIT, n_frames, fps)
    write_live_link_csv(tmp_path / "take.csv", given)
    read = read_live_link_csv(tmp_path / "take.csv")
    assert (read.names, read.fps, read.n_frames) == (ARKIT, fps, n_frames)
    assert read.valid.all()
    np.testing.assert_allclose(read.weights, given.weights, rtol=1e-8)


def test_lost_frames_keep_their_place_and_angles_come_along(tmp_path, rng):
    given = take(rng, ARKIT, 50, lost=(7, 8, 30))
    angles = {"HeadYaw": np.where(given.valid, rng.normal(size=50), np.nan)}
    given = WeightSequence(given.weights, ARKIT, 30.0, given.valid, angles)
    write_live_link_csv(tmp_path / "take.csv", given)
    read = read_live_link_csv(tmp_path / "take.csv")
    np.testing.assert_array_equal(read.valid, given.valid)
    np.testing.assert_allclose(read.angles["HeadYaw"], angles["HeadYaw"], rtol=1e-8)
    np.testing.assert_allclose(read.weights, given.weights, rtol=1e-8)


def test_a_recorded_take_written_again_drives_the_face_alike(tmp_path, real_takes, real_rig):
    given = real_takes["alex_rom_3"][:300]
    write_live_link_csv(tmp_path / "again.csv", given)
    read = read_live_link_csv(tmp_path / "again.csv")
    first = int(given.valid.argmax())
    W = real_rig.rig_weights(given)[first : first + read.n_frames]
    np.testing.assert_allclose(real_rig.rig_weights(read), W, atol=1e-7)


def test_a_single_pose_of_an_actor_is_one_row(tmp_path):
    given = WeightSequence([[0.4, 0.25]], ["AU12L", "AU1"], 30.0)
    write_live_link_csv(tmp_path / "pose.csv", given)
    read = read_live_link_csv(tmp_path / "pose.csv")
    named = {n: w for n, w in zip(read.names, read.weights[0], strict=True) if w}
    assert named == {"mouthSmileLeft": 0.4, "browInnerUp": 0.25}


def test_a_table_comes_back_exactly_with_its_own_names(tmp_path, rng):
    given = take(rng, ["AU35", "my unit, left", "ü"], 9, 29.97, lost=(0, 4))
    write_weights_csv(tmp_path / "w.csv", given)
    read = read_weights_csv(tmp_path / "w.csv")
    assert (read.names, read.fps) == (given.names, given.fps)
    np.testing.assert_array_equal(read.valid, given.valid)
    np.testing.assert_array_equal(read.weights, given.weights)


def test_what_cannot_be_written_leaves_no_file(tmp_path, rng):
    for given, complaint in (
        (take(rng, ARKIT, 5, 29.97), r"fps=29.97, but a time code counts 24, 25"),
        (take(rng, ["AU35"], 5), "no unit with an ARKit name"),
        (take(rng, ARKIT, 3, lost=(0, 1, 2)), "no valid frame"),
        (take(rng, ["AU12L", "AU35"], 0), "no valid frame"),
    ):
        with pytest.raises(ValueError, match=complaint):
            write_live_link_csv(tmp_path / "take.csv", given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("AU1,AU2\n0,1\n", "not a weight table"),
        ("frame,fps,AU1\n", "not a weight table"),
        ("frame,fps,AU1\n0,30.0,0.5\n2,30.0,0.5\n", "line 3: here should be frame 1"),
        ("frame,fps,AU1\n0,30.0,0.5\n1,60.0,0.5\n", "line 3: here should be frame 1 at 30.0"),
        ("frame,fps,AU1\n0,30.0,0.5,1\n", "line 2: here should be frame 0"),
        ("frame,fps,AU1\n0,30.0,half\n", "line 2: could not convert"),
        ("\n\n", "not a weight table"),
        ("frame,fps,AU1\n0\n", "line 2: here should be frame 0"),
        ("frame,fps,AU1\n0,abc,0.5\n", r"w\.csv, line 2: fps='abc' is not a number\.$"),
        ("frame,fps,AU1\n0,-1,0.5\n", "line 2: fps=-1.0, but it must be more than 0"),
        ("frame,fps,AU1\n\n0,30.0,0.5\n\n2,30.0,0.5\n", "line 5: here should be frame 1"),
        ("frame,fps,AU1,AU2\n0,30.0,nan,1\n", "line 2 holds 1 value"),
    ],
)
def test_a_damaged_table_is_refused_with_its_line(tmp_path, text, complaint):
    (tmp_path / "w.csv").write_text(text)
    with pytest.raises(ValueError, match=complaint):
        read_weights_csv(tmp_path / "w.csv")


def test_no_frames_stay_no_frames():
    assert to_arkit(WeightSequence(np.empty((0, 2)), ["AU12L", "AU35"], 30)).n_frames == 0


def test_only_a_take_goes_to_arkit():
    with pytest.raises(TypeError, match="take is a ndarray, but must be of type WeightSequence"):
        to_arkit(np.zeros((3, 52)))
