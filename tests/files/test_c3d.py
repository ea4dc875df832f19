import ezc3d
import numpy as np
import pytest

from facelab.files import c3d
from facelab.files.c3d import read_c3d, write_c3d
from facelab.motion import MarkerSequence


@pytest.fixture
def markers(rng):
    """40 frames of 9 markers in float32, as a file holds them; some are occluded."""
    P = rng.normal(scale=100, size=(40, 9, 3)).astype(np.float32)
    P[5, 3] = np.nan
    P[10:20, 0] = np.nan
    return MarkerSequence(P, tuple(f"m{i}" for i in range(9)), 120.0)


@pytest.fixture
def path(markers, tmp_path):
    write_c3d(tmp_path / "take.c3d", markers)
    return tmp_path / "take.c3d"


def foreign(path, points, labels, units="mm", rate=100.0, residuals=None, analog=0):
    """A file as another tool would write it; points of shape (n_frames, n_points, 3)."""
    n_frames, n_points, _ = points.shape
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [rate]
    point["UNITS"]["value"] = [units]
    point["LABELS"]["value"] = labels
    data = np.ones((4, n_points, n_frames))
    data[:3] = points.transpose(2, 1, 0)
    file["data"]["points"] = data
    if residuals is not None:
        file["data"]["meta_points"]["residuals"] = residuals.T[None]
        file["data"]["meta_points"]["camera_masks"] = np.zeros((7, n_points, n_frames), bool)
    if analog:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [10 * rate]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"a{i}" for i in range(analog)]
        file["data"]["analogs"] = np.zeros((1, analog, 10 * n_frames))
    file.write(str(path))


# --- what comes back ------------------------------------------------------------------------------


def test_markers_come_back_as_they_were(path, markers):
    read = read_c3d(path)
    np.testing.assert_array_equal(read.positions, markers.positions)
    assert (read.names, read.fps) == (markers.names, 120.0)


def test_reading_in_process_and_in_the_child_agree(path):
    here, there = c3d.read_own_c3d(path), read_c3d(path)
    np.testing.assert_array_equal(here.positions, there.positions)
    assert here.names == there.names


@pytest.mark.parametrize("unit, size", [("mm", 1), (" cm ", 10), ("M", 1000), ("meters", 1000)])
def test_lengths_become_millimetres(tmp_path, unit, size):
    foreign(tmp_path / "u.c3d", np.full((3, 2, 3), 0.5), ["a", "b"], unit)
    assert np.unique(read_c3d(tmp_path / "u.c3d").positions) == 0.5 * size


def test_a_unit_that_is_stated_wins_over_the_file(tmp_path):
    foreign(tmp_path / "u.c3d", np.ones((3, 2, 3)), ["a", "b"], "mm")
    assert np.unique(read_c3d(tmp_path / "u.c3d", units="cm").positions) == 10


@pytest.mark.parametrize("unit", ["furlong", "", "kg"])
def test_an_unknown_unit_is_refused_with_a_way_out(tmp_path, unit):
    foreign(tmp_path / "u.c3d", np.ones((3, 2, 3)), ["a", "b"], unit)
    with pytest.raises(ValueError, match=r"POINT:UNITS is .*mm, cm, dm, m; say what it is"):
        read_c3d(tmp_path / "u.c3d")
    with pytest.raises(ValueError, match="units='furlong' is unknown; choose one of mm, cm"):
        read_c3d(tmp_path / "u.c3d", units="furlong")


def test_occluded_is_what_any_maker_means_by_it(tmp_path):
    """Residual -1, NaN, or the origin itself."""
    points = np.ones((4, 3, 3))
    residuals = np.zeros((4, 3))
    residuals[1, 0] = -1
    points[2, 1] = np.nan
    points[3, 2] = 0
    foreign(tmp_path / "o.c3d", points, ["a", "b", "c"], residuals=residuals)
    hidden = np.argwhere(~read_c3d(tmp_path / "o.c3d").visible)
    np.testing.assert_array_equal(hidden, [[1, 0], [2, 1], [3, 2]])


def test_labels_lose_their_blanks_and_points_without_one_get_one(tmp_path):
    foreign(tmp_path / "l.c3d", np.ones((3, 3, 3)), ["  chin ", "", "nose tip"])
    assert read_c3d(tmp_path / "l.c3d").names == ("chin", "unlabelled_2", "nose tip")


def test_files_of_scaled_integers_are_read_and_measured_as_such(tmp_path):
    """Half the bytes a value: a check that counts them as floats would refuse such files."""
    path = tmp_path / "int.c3d"
    foreign(path, np.zeros((50, 2, 3)), ["a", "b"])
    data = bytearray(path.read_bytes())
    scale = np.array([0.5], dtype="<f4").tobytes()
    data[12:16] = scale
    at = data.index(b"SCALE") + len(b"SCALE") + 4  # offset, type, number of dimensions
    at += data[at - 1]  # a dimension takes a byte
    assert bytes(data[at : at + 4]) == np.array([-1.0], dtype="<f4").tobytes()
    data[at : at + 4] = scale
    values = np.ones((50, 2, 4), dtype="<i2")
    values[..., :3] = np.arange(6).reshape(2, 3) + 1
    start = (int.from_bytes(data[16:18], "little") - 1) * 512
    path.write_bytes(bytes(data[:start]) + values.tobytes())
    np.testing.assert_allclose(read_c3d(path).positions[7], [[0.5, 1, 1.5], [2, 2.5, 3]])
    path.write_bytes(bytes(data[:start]) + values.tobytes()[:-1])
    with pytest.raises(ValueError, match="cut short: 50 frames of 2 points"):
        read_c3d(path)


def test_more_labels_than_one_parameter_holds(tmp_path):
    names = tuple(f"m{i}" for i in range(300))
    write_c3d(tmp_path / "n.c3d", MarkerSequence(np.ones((2, 300, 3)), names, 60))
    assert read_c3d(tmp_path / "n.c3d").names == names


def test_analog_channels_beside_the_markers_are_passed_over(tmp_path):
    foreign(tmp_path / "a.c3d", np.ones((20, 2, 3)), ["a", "b"], analog=3)
    assert read_c3d(tmp_path / "a.c3d").positions.shape == (20, 2, 3)
    cut = (tmp_path / "a.c3d").read_bytes()[: -512 - 200]
    (tmp_path / "a.c3d").write_bytes(cut)
    with pytest.raises(ValueError, match="cut short: 20 frames"):
        read_c3d(tmp_path / "a.c3d")


def test_a_label_that_stands_twice_is_refused(tmp_path):
    foreign(tmp_path / "t.c3d", np.ones((3, 2, 3)), ["a", "a "])
    with pytest.raises(ValueError, match=r"t\.c3d: names holds a more than once"):
        read_c3d(tmp_path / "t.c3d")


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


def test_more_frames_than_the_header_counts_are_not_dropped_in_silence(tmp_path):
    foreign(tmp_path / "long.c3d", np.ones((66000, 1, 3)), ["a"])
    with pytest.raises(ValueError, match="only 65535 frames of it can be read, and more follow"):
        read_c3d(tmp_path / "long.c3d")


def test_positions_beyond_a_kilometre_are_damage(path):
    data = bytearray(path.read_bytes())
    data[-800:-796] = np.array([1e30], dtype="<f4").tobytes()
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"damaged: 1 position\(s\) lie more than a kilometre"):
        read_c3d(path)


@pytest.mark.parametrize("seed", range(16))
def test_damage_anywhere_is_refused_or_harmless(path, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(path.read_bytes())
    part = [(0, 512), (512, 2048), (0, len(data)), (512, 1024)][seed % 4]
    for i in rng.integers(*part, 10):
        data[i] = rng.integers(256)
    path.write_bytes(data)
    first, last = np.frombuffer(bytes(data[6:10]), "<u2").astype(int)
    try:
        read = read_c3d(path)
    except ValueError as error:
        assert str(path) in str(error)
    else:
        assert read.positions.shape[:2] == (last - first + 1, int(data[2]) + 256 * int(data[3]))


@pytest.mark.parametrize(
    "accident, words",
    [
        ("import os; os.abort()", "damaged: its parts do not fit together .crash"),
        ("import time; time.sleep(60)", "no result within 1 s"),
        ("raise RuntimeError('lost the thread')", "RuntimeError: lost the thread"),
        ("bytearray(10**12)", "MemoryError"),
    ],
    ids=["crash", "hang", "exception", "memory"],
)
def test_an_accident_while_reading_is_a_value_error(path, monkeypatch, accident, words):
    monkeypatch.setattr(c3d, "_CHILD_MAIN", accident)
    monkeypatch.setattr(c3d, "_CHILD_SECONDS", 0.7)
    if "bytearray" in accident:
        monkeypatch.setattr(c3d, "_CHILD_MAIN", LIMIT + accident)
        monkeypatch.setattr(c3d, "_CHILD_SECONDS", 15)
    with pytest.raises(ValueError, match=words):
        read_c3d(path)


LIMIT = c3d._CHILD_MAIN.split("numpy.savez")[0]  # the child's own limit on memory


def test_the_child_does_not_load_the_package():
    """Its start must stay far below a second: it is paid for every file."""
    assert "facelab" not in c3d.inspect.getsource(c3d._parse) + c3d._CHILD_MAIN


# --- writing --------------------------------------------------------------------------------------


def test_a_write_that_fails_leaves_the_old_file(path, markers, monkeypatch):
    before = path.read_bytes()

    def fail(self, where):
        raise OSError("no space left")

    monkeypatch.setattr(ezc3d.c3d, "write", fail)
    with pytest.raises(OSError, match="no space"):
        write_c3d(path, markers)
    assert path.read_bytes() == before
    assert [f.name for f in path.parent.iterdir()] == ["take.c3d"]


@pytest.mark.parametrize("shape", [(0, 2, 3), (3, 0, 3), (65536, 1, 3)])
def test_what_a_file_cannot_hold_is_refused(tmp_path, shape):
    names = tuple(f"m{i}" for i in range(shape[1]))
    with pytest.raises(ValueError, match="a C3D file holds 1 to 65535"):
        write_c3d(tmp_path / "x.c3d", MarkerSequence(np.ones(shape), names, 60))
    assert not list(tmp_path.iterdir())


def test_equal_markers_make_equal_files(path, markers):
    before = path.read_bytes()
    write_c3d(path, markers)
    assert path.read_bytes() == before
