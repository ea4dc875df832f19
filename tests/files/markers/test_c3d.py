import os
import resource
import tracemalloc

import ezc3d
import numpy as np
import pytest
from c3d_maker import Maker
from mutants import COUNT, tally

from facelab.files import read_c3d, write_c3d
from facelab.motion import MarkerSequence


@pytest.fixture
def markers(rng):
    """40 frames of 9 markers in float32, as a file holds them; some are hidden."""
    P = rng.normal(scale=100, size=(40, 9, 3)).astype(np.float32)
    P[5, 3] = np.nan
    P[10:20, 0] = np.nan
    return MarkerSequence(P, tuple(f"m{i}" for i in range(9)), 120.0)


@pytest.fixture
def path(markers, tmp_path):
    write_c3d(tmp_path / "take.c3d", markers)
    return tmp_path / "take.c3d"


@pytest.fixture
def points(rng):
    """30 frames of 4 points in halves of a millimetre, one of them hidden for a while."""
    P = rng.integers(-300, 300, size=(30, 4, 3)) / 2 + 0.5
    P[7:9, 2] = np.nan
    return P


ABCD = ["chin", "nose_tip", "lip_upper", "lip_lower"]


# --- what comes back ------------------------------------------------------------------------------


def test_markers_come_back_as_they_were(path, markers):
    read = read_c3d(path)
    np.testing.assert_array_equal(read.positions, markers.positions)
    assert (read.names, read.fps) == (markers.names, 120.0)
    assert read.positions.dtype == np.float32


@pytest.mark.parametrize("scale", [-1.0, -0.01, 0.5])
@pytest.mark.parametrize("kind", ["Intel", "DEC", "MIPS"])
def test_every_processor_reads_alike_and_as_ezc3d_has_it(tmp_path, points, kind, scale):
    path = Maker(points, ABCD, kind, scale, rate=59.94).write(tmp_path / "k.c3d")
    read = read_c3d(path)
    np.testing.assert_array_equal(read.positions, points.astype(np.float32))
    assert (read.names, read.fps) == (tuple(ABCD), 59.94)
    if kind == "MIPS":
        return  # ezc3d does not know it
    peer = ezc3d.c3d(str(path))
    theirs = peer["data"]["points"][:3].transpose(2, 1, 0)
    seen = read.visible
    np.testing.assert_allclose(theirs[seen], read.positions[seen], rtol=1e-6)
    np.testing.assert_array_equal(peer["data"]["meta_points"]["residuals"][0].T >= 0, seen)


def test_what_is_written_is_what_ezc3d_reads(path, markers):
    peer = ezc3d.c3d(str(path))
    theirs = peer["data"]["points"][:3].transpose(2, 1, 0)
    np.testing.assert_array_equal(theirs[markers.visible], markers.positions[markers.visible])
    hidden = peer["data"]["meta_points"]["residuals"][0].T < 0
    np.testing.assert_array_equal(hidden, ~markers.visible)
    assert tuple(peer["parameters"]["POINT"]["LABELS"]["value"]) == markers.names
    assert peer["parameters"]["POINT"]["RATE"]["value"][0] == 120


@pytest.mark.parametrize(
    "unit, size",
    [("mm", 1), (" cm ", 10), ("M", 1000), ("meters", 1000), ("Millimeter", 1), ("meter", 1000),
     ("Meters", 1000), ("centimetres", 10), ("millimetre", 1), ("MM.", 1), ("inches", 25.4)],
)  # fmt: skip
def test_lengths_become_millimetres(tmp_path, unit, size):
    path = Maker(np.full((3, 2, 3), 0.5), ["a", "b"], units=unit).write(tmp_path / "u.c3d")
    np.testing.assert_allclose(np.unique(read_c3d(path).positions), 0.5 * size, rtol=1e-7)


def test_a_unit_and_a_rate_that_are_stated_win_over_the_file(tmp_path):
    path = Maker(np.ones((3, 2, 3)), ["a", "b"]).write(tmp_path / "u.c3d")
    read = read_c3d(path, unit="cm", fps=50)
    assert np.unique(read.positions) == 10
    assert read.fps == 50


@pytest.mark.parametrize("unit", ["furlong", "", "kg", "deg"])
def test_an_unknown_unit_is_refused_with_a_way_out(tmp_path, unit):
    path = Maker(np.ones((3, 2, 3)), ["a", "b"], units=unit).write(tmp_path / "u.c3d")
    with pytest.raises(ValueError, match=r"POINT:UNITS is .*mm, cm, dm, m, in, ft; say what it is"):
        read_c3d(path)
    with pytest.raises(ValueError, match="unit='furlong' is unknown; choose one of mm, cm"):
        read_c3d(path, unit="furlong")
    assert read_c3d(path, unit="m").positions[0, 0, 0] == 1000


def test_hidden_is_what_any_maker_means_by_it(tmp_path):
    """Residual -1, NaN, or the origin itself; the last is said."""
    points = np.ones((4, 3, 3))
    points[1, 0] = np.nan  # residual -1
    points[3, 2] = 0
    maker = Maker(points, ["a", "b", "c"])
    data = bytearray(maker.bytes())
    first = data.index(np.ones(3, dtype="<f4").tobytes())
    data[first + 2 * 48 + 16 : first + 2 * 48 + 20] = np.array([np.nan], "<f4").tobytes()
    (tmp_path / "o.c3d").write_bytes(data)
    read = read_c3d(tmp_path / "o.c3d")
    np.testing.assert_array_equal(np.argwhere(~read.visible), [[1, 0], [2, 1], [3, 2]])
    assert "1 position(s) at exactly 0, 0, 0 taken for hidden" in read.report.notes
    assert "1 position(s) with one or two coordinates only taken for hidden" in read.report.notes


# --- names ----------------------------------------------------------------------------------------


def test_labels_lose_their_blanks_and_points_without_one_get_one(tmp_path):
    maker = Maker(np.ones((3, 4, 3)), ["  chin ", "", "nose tip"])
    read = read_c3d(maker.write(tmp_path / "l.c3d"))
    assert read.names == ("chin", "unlabelled_2", "nose tip", "unlabelled_4")
    assert "2 marker(s) without a name called unlabelled_2, ..." in read.report.notes


def test_outputs_of_a_model_are_no_markers(tmp_path, points):
    labels = ["Anna:chin", "Anna:LNeckAngles", "Anna:nose_tip", "Anna:LNeckMoment"]
    maker = Maker(points, labels)
    maker.parameters |= {
        "POINT:ANGLES": ["LNeckAngles", ""], "POINT:SCALARS": [""],
        "POINT:MOMENTS": ["Bob:x"], "POINT:MOMENTS2": ["Anna:LNeckMoment"],
    }  # fmt: skip
    read = read_c3d(maker.write(tmp_path / "m.c3d"))
    assert read.names == ("chin", "nose_tip")
    np.testing.assert_array_equal(read.positions, points[:, [0, 2]].astype(np.float32))
    assert "2 output(s) of a model left out: 1 angles, 1 moments" in read.report.notes


def test_outputs_that_no_list_names_are_known_by_theirs(tmp_path, rng):
    labels = ["MouthAngle", "LNeckAngles", "Anna:LHipMoment", "brow_Power", "RNormalisedGRF"]
    points = rng.normal(scale=50, size=(3, 5, 3))
    read = read_c3d(Maker(points, labels).write(tmp_path / "m.c3d"))
    assert read.names == ("MouthAngle", "brow_Power")
    said = "3 output(s) of a model left out: 1 angles, 1 moments, 1 forces"
    assert said in read.report.notes


def test_markers_without_a_label_are_no_subject(tmp_path, points):
    labels = ["Anna:chin", "Anna:nose_tip", "Unlabeled:1018", "Unlabeled:1019"]
    read = read_c3d(Maker(points, labels).write(tmp_path / "s.c3d"))
    assert read.names == ("chin", "nose_tip", "Unlabeled:1018", "Unlabeled:1019")
    said = "2 marker(s) that Motive has not labelled (Unlabeled:1018, Unlabeled:1019)"
    assert said in read.report.notes


def test_a_file_of_nothing_but_angles_is_refused(tmp_path):
    maker = Maker(np.ones((3, 1, 3)), ["Neck"])
    maker.parameters["POINT:ANGLES"] = ["Neck"]
    with pytest.raises(ValueError, match=r"no markers in it, only outputs of a model \(1 angles\)"):
        read_c3d(maker.write(tmp_path / "m.c3d"))


def test_the_prefix_of_one_subject_goes(tmp_path):
    path = Maker(np.ones((3, 3, 3)), ["Anna:chin", "nose_tip", "Anna:lip"]).write(
        tmp_path / "s.c3d"
    )
    read = read_c3d(path)
    assert read.names == ("chin", "nose_tip", "lip")
    assert "prefix Anna: taken off the names" in read.report.notes


def test_of_two_subjects_one_can_be_chosen(tmp_path, points):
    labels = ["Anna:chin", "Bob:chin", "Anna:nose_tip", "wand"]
    path = Maker(points, labels).write(tmp_path / "s.c3d")
    both = read_c3d(path)
    assert both.names == tuple(labels)
    assert (
        "2 subjects (Anna, Bob): names keep their prefix; choose one with subject="
        in both.report.notes
    )
    anna = read_c3d(path, subject="Anna")
    assert anna.names == ("chin", "nose_tip")
    np.testing.assert_array_equal(anna.positions, both.positions[:, [0, 2]])
    assert "2 marker(s) of other subjects or of none left out (Bob)" in anna.report.notes
    with pytest.raises(ValueError, match="subject='Carl' is not in it; it has Anna, Bob"):
        read_c3d(path, subject="Carl")


def test_names_that_stand_twice_are_numbered_with_a_warning(tmp_path):
    path = Maker(np.ones((3, 4, 3)), ["a", "a ", "a_2", "a"]).write(tmp_path / "t.c3d")
    with pytest.warns(UserWarning, match=r"t\.c3d: name\(s\) that stand more than once .* a\."):
        read = read_c3d(path)
    assert read.names == ("a", "a_3", "a_2", "a_4")


def test_more_labels_than_one_parameter_holds(tmp_path):
    names = tuple(f"m{i}" for i in range(600))
    P = np.linspace(-100, 90, 3600).reshape(2, 600, 3)
    write_c3d(tmp_path / "n.c3d", MarkerSequence(P, names, 60))
    assert read_c3d(tmp_path / "n.c3d").names == names
    peer = ezc3d.c3d(str(tmp_path / "n.c3d"))["parameters"]["POINT"]
    assert peer["LABELS3"]["value"][-1] == "m599"


# --- counts that disagree: the size of the file is the judge --------------------------------------


def test_analog_channels_beside_the_markers_are_passed_over(tmp_path, points):
    maker = Maker(points, ABCD)
    maker.analog = np.arange(30 * 6).reshape(30, 6)
    maker.header |= {"analog": 6, "samples": 3}
    maker.parameters["ANALOG:USED"] = 2
    np.testing.assert_array_equal(
        read_c3d(maker.write(tmp_path / "a.c3d")).positions, points.astype(np.float32)
    )
    maker.header["analog"] = 60  # wrong: the parameter is right
    np.testing.assert_array_equal(
        read_c3d(maker.write(tmp_path / "a.c3d")).positions, points.astype(np.float32)
    )


@pytest.mark.parametrize("kind", ["Intel", "MIPS"])
@pytest.mark.parametrize("wrong", ["header", "parameter"])
def test_a_wrong_count_of_frames_gives_way_to_the_right_one(tmp_path, points, kind, wrong):
    maker = Maker(points, ABCD, kind)
    if wrong == "header":
        maker.header["last"] = 500
    else:
        maker.parameters["POINT:FRAMES"] = 12
    read = read_c3d(maker.write(tmp_path / "f.c3d"))
    np.testing.assert_array_equal(read.positions, points.astype(np.float32))
    assert any(
        "30 frames by the size of the file; it says: the header" in s for s in read.report.notes
    )


def test_a_count_that_is_short_by_a_frame_is_found_by_what_lies_there(tmp_path, points):
    """Both 29 and 30 frames fill the last block; only one of them leaves nothing but zeros."""
    maker = Maker(points, ABCD)
    maker.parameters["POINT:FRAMES"] = 29
    assert read_c3d(maker.write(tmp_path / "f.c3d")).n_frames == 30
    maker.parameters["POINT:FRAMES"] = 31
    assert read_c3d(maker.write(tmp_path / "f.c3d")).n_frames == 30


def test_counts_that_are_all_wrong_are_refused(tmp_path, points):
    maker = Maker(points, ABCD)
    maker.header["last"], maker.parameters["POINT:FRAMES"] = 12, 13
    with pytest.raises(ValueError, match=r"counts of frames .*the header 12, POINT:FRAMES 13"):
        read_c3d(maker.write(tmp_path / "f.c3d"))


@pytest.mark.parametrize("said", ["trial", "long", "float", "full", "wrapped"])
def test_takes_of_more_than_16_bits_of_frames_are_read(tmp_path, rng, said):
    points = rng.integers(1, 300, size=(70001, 1, 3)).astype(float)
    maker = Maker(points, ["chin"], rate=120.0)
    maker.parameters |= {
        "trial": {"TRIAL:ACTUAL_START_FIELD": [1, 0], "TRIAL:ACTUAL_END_FIELD": [70001 - 65536, 1]},
        "long": {"POINT:LONG_FRAMES": 70001.0},
        "float": {"POINT:FRAMES": 70001.0},
        "full": {},
        "wrapped": {"POINT:FRAMES": 70001 - 65536},
    }[said]
    if said == "wrapped":
        maker.header["last"] = 70001 - 65536
    read = read_c3d(maker.write(tmp_path / "long.c3d"))
    np.testing.assert_array_equal(read.positions, points.astype(np.float32))


def test_a_take_of_more_than_16_bits_of_frames_is_written(tmp_path, rng):
    P = rng.normal(scale=100, size=(70001, 2, 3)).astype(np.float32)
    take = MarkerSequence(P, ("a", "b"), 120)
    write_c3d(tmp_path / "long.c3d", take)
    np.testing.assert_array_equal(read_c3d(tmp_path / "long.c3d").positions, P)


def test_the_start_of_the_data_is_the_one_that_fits(tmp_path, points):
    maker = Maker(points, ABCD)
    for key, wrong in (("header", 5), ("header", 0), ("parameter", 5)):
        maker.header["start"] = wrong if key == "header" else None
        maker.parameters["POINT:DATA_START"] = wrong if key == "parameter" else None
        read = read_c3d(maker.write(tmp_path / "s.c3d"))
        np.testing.assert_array_equal(read.positions, points.astype(np.float32))


def test_what_follows_the_last_frame_is_said(tmp_path, points):
    maker = Maker(points, ABCD)
    maker.tail = bytes(2048)
    with pytest.warns(UserWarning, match=r"bytes after the last frame were not read"):
        read = read_c3d(maker.write(tmp_path / "t.c3d"))
    assert read.n_frames == 30
    maker.tail, maker.pads = b"", False
    assert read_c3d(maker.write(tmp_path / "t.c3d")).n_frames == 30  # without a word


def test_rotations_behind_the_points_are_passed_over(tmp_path, points):
    maker = Maker(points, ABCD)
    maker.parameters |= {"ROTATION:USED": 1, "ROTATION:DATA_START": 7}
    maker.tail = bytes(4096)
    assert len(maker.bytes()) - 4096 == 6 * 512
    assert read_c3d(maker.write(tmp_path / "r.c3d")).n_frames == 30


def test_rates_that_disagree_ask_for_a_word(tmp_path, points):
    maker = Maker(points, ABCD)
    maker.header["rate"] = 60.0
    path = maker.write(tmp_path / "r.c3d")
    with pytest.raises(ValueError, match=r"header says 60 frames/s, POINT:RATE 100; say .* fps="):
        read_c3d(path)
    assert read_c3d(path, fps=60).fps == 60
    maker.header["rate"] = 0.0
    assert read_c3d(maker.write(path)).fps == 100


# --- what is refused ------------------------------------------------------------------------------


def test_missing_empty_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such C3D file"):
        read_c3d(tmp_path / "none.c3d")
    (tmp_path / "empty.c3d").touch()
    with pytest.raises(ValueError, match="is empty"):
        read_c3d(tmp_path / "empty.c3d")
    (tmp_path / "text.c3d").write_text("frame,x,y,z\n" * 100)
    with pytest.raises(ValueError, match=r"text\.c3d: not a C3D file"):
        read_c3d(tmp_path / "text.c3d")


@pytest.mark.parametrize("share", [0.01, 0.1, 0.2, 0.5, 0.9, 0.94])
def test_a_file_that_is_cut_short_is_refused(path, share):
    """The last 5 % are padding: a file that lacks only these is whole."""
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match=r"take\.c3d: (damaged|not a C3D file)"):
        read_c3d(path)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"POINT:USED": 3}, "counts 4 points in a frame, POINT:USED 3"),
        ({"POINT:SCALE": 0.5}, "header's scale is -1, POINT:SCALE is 0.5"),
    ],
)
def test_a_header_that_contradicts_the_parameters_is_refused(tmp_path, points, change, words):
    maker = Maker(points, ABCD)
    maker.parameters |= change
    with pytest.raises(ValueError, match=words):
        read_c3d(maker.write(tmp_path / "c.c3d"))


def test_a_parameter_that_does_not_fill_its_record_is_refused(tmp_path, points):
    """Fewer labels than there is room for would leave the rest without a name."""
    data = bytearray(Maker(points, ABCD).bytes())
    at = data.index(b"LABELS") + 6 + 2 + 2  # behind the step to the next, type, dimensions
    assert tuple(data[at : at + 2]) == (9, 4)
    data[at + 1] = 3
    (tmp_path / "p.c3d").write_bytes(data)
    with pytest.raises(ValueError, match="the parameter POINT:LABELS does not fill"):
        read_c3d(tmp_path / "p.c3d")


def test_positions_beyond_a_kilometre_are_damage(path):
    data = bytearray(path.read_bytes())
    data[-800:-796] = np.array([1e30], dtype="<f4").tobytes()
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"m\d in frame 37 .* more than a kilometre away"):
        read_c3d(path)


def test_what_a_mutant_says_does_not_contradict_itself(path, markers, tmp_path, rng):
    """Frames, points and names are said twice in the file, so a change of one shows."""
    check = contradiction(markers)
    found = tally(read_c3d, path.read_bytes(), "m.c3d", tmp_path, COUNT, rng, check)
    assert not found.wrong and not found.python, found
    assert found.slowest < 10


def contradiction(markers):
    """What a reading of a broken file of these markers may not say, without a word."""

    def contradicts(read, data, said):
        if said:
            return ""
        if read.positions.shape != markers.positions.shape:
            return f"{read.positions.shape} in place of {markers.positions.shape}"
        if not np.isfinite(read.positions[read.visible]).all():
            return "positions that are not finite"
        return "" if abs(read.fps / markers.fps - 1) < 1e-3 else f"{read.fps} frames/s"

    return contradicts


def test_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.c3d")
    with pytest.raises(ValueError, match="is not a file"):
        read_c3d(tmp_path / "pipe.c3d")


# --- writing --------------------------------------------------------------------------------------


def test_a_full_disk_leaves_the_old_file_and_says_so(path, rng):
    before = path.read_bytes()
    large = MarkerSequence(rng.normal(size=(3000, 9, 3)), tuple("abcdefghi"), 120)
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, old[1]))
    try:
        with pytest.raises(OSError):
            write_c3d(path, large)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)
    assert path.read_bytes() == before
    assert [f.name for f in path.parent.iterdir()] == ["take.c3d"]


def test_a_disk_that_loses_what_it_was_given_is_found_out(path, markers, monkeypatch):
    """What is on the disk is read back before it takes the place of the good file."""
    before = path.read_bytes()

    def lose(handle):
        os.ftruncate(handle, 2048)

    monkeypatch.setattr("facelab.files.markers.c3d_write.os.fsync", lose)
    with pytest.raises(ValueError, match=r"cannot be kept in a C3D file: .*take\.c3d: .*cut short"):
        write_c3d(path, markers)
    assert path.read_bytes() == before


@pytest.mark.parametrize("shape", [(0, 2, 3), (3, 0, 3)])
def test_what_a_file_cannot_hold_is_refused(tmp_path, shape):
    names = tuple(f"m{i}" for i in range(shape[1]))
    with pytest.raises(ValueError, match="a C3D file holds 1 to 65535 markers"):
        write_c3d(tmp_path / "x.c3d", MarkerSequence(np.ones(shape), names, 60))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name, words",
    [
        ("chin ", "cannot be kept"), ("", "cannot be kept"), ("a\nb", "cannot be kept"),
        ("x" * 128, "cannot be kept"), ("a\0", "cannot be kept"),
        ("Anna:chin", "'Anna:chin' would come back as 'chin'"),
    ],
)  # fmt: skip
def test_names_that_would_not_come_back_are_refused(tmp_path, name, words):
    with pytest.raises(ValueError, match=words):
        write_c3d(tmp_path / "x.c3d", MarkerSequence(np.ones((2, 1, 3)), (name,), 60))
    assert not list(tmp_path.iterdir())


def test_names_of_any_script_and_of_two_subjects_come_back(tmp_path):
    names = ("Anna:Mundwinkel_ß", "Bob:颏")
    write_c3d(tmp_path / "x.c3d", MarkerSequence(np.ones((2, 2, 3)), names, 60))
    assert read_c3d(tmp_path / "x.c3d").names == names


def test_a_visible_marker_at_a_value_that_fills_gaps_is_refused(tmp_path, rng):
    P = rng.normal(scale=50, size=(3, 2, 3))
    P[1, 1] = -9999
    with pytest.raises(ValueError, match=r"b in frame 1 .* nan\]: that fills gaps.* make it NaN"):
        write_c3d(tmp_path / "x.c3d", MarkerSequence(P, ("a", "b"), 60))
    assert not list(tmp_path.iterdir())


def test_a_visible_marker_at_the_origin_is_refused(tmp_path):
    P = np.ones((3, 2, 3))
    P[1, 1] = 0
    with pytest.raises(ValueError, match=r"b in frame 1 .* exactly 0, 0, 0 means hidden"):
        write_c3d(tmp_path / "x.c3d", MarkerSequence(P, ("a", "b"), 60))


def test_equal_markers_make_equal_files(path, markers):
    before = path.read_bytes()
    write_c3d(path, markers)
    assert path.read_bytes() == before


def test_a_long_take_is_read_within_its_own_size(tmp_path):
    """Beside the positions that are handed over, only pieces of the file are held."""
    P = np.ones((10_000, 150, 3), dtype=np.float32) + np.arange(150, dtype=np.float32)[:, None]
    write_c3d(tmp_path / "l.c3d", MarkerSequence(P, [f"m{i}" for i in range(150)], 120))
    tracemalloc.start()
    try:
        read = read_c3d(tmp_path / "l.c3d")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    pieces = 2**23 * 4  # of the file, as it is, as numbers, and scaled
    assert peak < 1.8 * read.positions.nbytes + pieces
