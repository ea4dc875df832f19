import io
import os
import warnings
import zipfile

import numpy as np
import pytest
from capture_tables import plain, trc
from mutants import COUNT, tally

from facelab.files import read_markers, write_c3d
from facelab.motion import MarkerSequence

NAMES = ["chin", "nose_tip", "lip_upper", "brow_left_1", "brow_right_1", "jaw_left_5", "m1", "m2"]


@pytest.fixture
def P(rng):
    """20 frames of 8 markers over a face, one hidden at times."""
    P = rng.uniform(-1, 1, size=(8, 3)) * [60, 90, 40] + rng.normal(size=(20, 8, 3))
    P[3:5, 6] = np.nan
    return P


def saved(path, **arrays):
    np.savez(path, **arrays)
    return path


# --- the door -------------------------------------------------------------------------------------


def test_every_ending_finds_its_reader(tmp_path, P):
    take = MarkerSequence(P.astype(np.float32), NAMES, 100)
    write_c3d(tmp_path / "a.C3D", take)
    (tmp_path / "b.trc").write_text(trc(P, NAMES, 100))
    (tmp_path / "c.csv").write_text(plain(P, NAMES))
    saved(tmp_path / "d.npz", positions=P, names=NAMES, fps=100)
    for path in sorted(tmp_path.iterdir()):
        read = read_markers(path)
        np.testing.assert_allclose(read.positions, P, atol=2e-5)
        assert (read.names, read.fps) == (take.names, 100)
        assert str(read.report).startswith(
            f"{path.name}: 20 frames of 8 markers at 100 frames/s, 1.2 % hidden"
        )


def test_the_report_stays_with_parts_of_the_take(tmp_path, P):
    take = read_markers(saved(tmp_path / "d.npz", positions=P, names=NAMES, fps=100))
    part = take[3:9].select(["chin"]).renamed({"chin": "c"}).with_gaps(0.1, random_state=0)
    assert part.report is take.report


def test_what_is_no_file_of_markers_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"unknown kind of file; readable are \.c3d, \.trc, \.csv"):
        read_markers(tmp_path / "x.fbx")
    with pytest.raises(TypeError, match="path is a int"):
        read_markers(3)
    with pytest.raises(TypeError, match="unit=3 is not a string"):
        read_markers(saved(tmp_path / "e.npz", a=1), unit=3)
    with pytest.raises(TypeError, match="subject is a int"):
        read_markers(saved(tmp_path / "e.npz", a=1), subject=3)


@pytest.mark.parametrize("ending", ["c3d", "trc", "csv", "npz", "ma"])
def test_missing_empty_and_piped_files_are_refused(tmp_path, ending):
    path = tmp_path / f"take.{ending}"
    with pytest.raises(FileNotFoundError, match="there is no such"):
        read_markers(path)
    path.touch()
    with pytest.raises(ValueError, match="is empty"):
        read_markers(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ValueError, match="is not a file"):
        read_markers(path)


# --- size -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "size, words",
    [(0.001, "times 1000 it would be one, as if the unit were m: see unit="),
     (0.1, "times 10 it would be one, as if the unit were cm"),
     (10, "times 0.1 it would be one"), (1e-6, "which is no face")],
)  # fmt: skip
def test_a_size_that_is_no_face_s_is_said_with_the_factor(tmp_path, P, size, words):
    path = saved(tmp_path / "s.npz", positions=P * size, names=NAMES, fps=100)
    with pytest.warns(UserWarning, match=rf"s\.npz: the markers fill .*{words}"):
        take = read_markers(path)
    assert words in take.report.notes[-1]
    np.testing.assert_allclose(take.positions, P * size)  # nothing is repaired


def test_a_face_and_a_few_markers_pass_without_a_word(tmp_path, P):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_markers(saved(tmp_path / "s.npz", positions=P, names=NAMES, fps=100))
        few = P[:, :3] / 10  # who knows what three markers are
        read_markers(saved(tmp_path / "s.npz", positions=few, names=NAMES[:3], fps=100))


def test_the_right_unit_mends_the_size(tmp_path, P):
    path = saved(tmp_path / "s.npz", positions=P / 1000, names=NAMES, fps=100, unit="m")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(read_markers(path).positions, P)
        assert read_markers(path).report.notes == ()
    path = saved(tmp_path / "s.npz", positions=P / 10, names=NAMES, fps=100)
    np.testing.assert_allclose(read_markers(path, unit="cm").positions, P)


# --- values that fill gaps ------------------------------------------------------------------------


@pytest.mark.parametrize("value", [-1, -9999, 99999, 1000, -3.7e28])
@pytest.mark.parametrize("write", ["npz", "trc", "csv"])
def test_values_that_fill_gaps_are_hidden_markers_and_counted(tmp_path, rng, value, write):
    rest = rng.uniform(-1, 1, size=(8, 3)) * [60, 90, 40]
    P = (rest + np.sin(np.arange(60) / 8)[:, None, None] + 20).round(3)
    P[10:14, 3] = P[30, 3] = P[:, 6] = np.nan  # one is never seen
    path, filled = tmp_path / f"take.{write}", np.nan_to_num(P, nan=value)
    if write == "npz":
        saved(path, positions=filled, names=NAMES, fps=100, unit="mm")
    else:
        path.write_text({"trc": trc, "csv": plain}[write](filled, NAMES))
    take = read_markers(path)
    np.testing.assert_allclose(take.positions, P, atol=2e-5)
    words = "65 position(s) taken for hidden that fill a gap with one value in x, y and z"
    assert f"{words} ({value})" in take.report.notes


def test_once_beyond_reach_is_a_gap_and_once_within_is_a_place(tmp_path, P):
    for value, hidden in ((-9999, True), (30, False)):
        P[7, 2] = value
        take = read_markers(saved(tmp_path / "p.npz", positions=P, names=NAMES, fps=100))
        assert np.isnan(take.positions[7, 2]).all() == hidden


def test_places_with_one_value_in_x_y_and_z_that_markers_pass_through_are_kept(tmp_path, rng):
    still = np.tile([[5.0, 5, 5], [40, -20, 90], [0, 60, 10]], (40, 1, 1))
    slow = still + np.repeat(np.arange(8), 5)[:, None, None] * 0.1
    held = still + np.repeat(np.arange(-4, 4), 5)[:, None, None] * [1, 0, 0]
    for P in (
        still,
        slow,
        slow.round(),
        held,
        np.arange(40.0)[:, None, None] + np.zeros((1, 3, 3)),
    ):
        take = read_markers(saved(tmp_path / "p.npz", positions=P, names=NAMES[:3], fps=100))
        np.testing.assert_array_equal(take.positions[1:], P[1:])


@pytest.mark.parametrize("place", [(0, 0, -9999), (0, 0, -1), (-1, -1, 0), (9999, -9999, 9999)])
@pytest.mark.parametrize("write", [trc, plain], ids=["trc", "csv"])
def test_one_place_that_fills_gaps_is_hidden_and_counted(tmp_path, rng, place, write):
    P = rng.uniform(50, 200, (8, 3)) + np.cumsum(rng.normal(scale=0.3, size=(120, 8, 3)), axis=0)
    P[30:60, 2] = P[70:80, 2] = P[10:35, 5] = np.nan
    path = tmp_path / f"take.{write.__name__.replace('plain', 'csv')}"
    path.write_text(write(np.where(np.isnan(P), place, P), NAMES))
    take = read_markers(path)
    np.testing.assert_array_equal(take.visible, np.isfinite(P[..., 0]))
    told = " ".join(map(str, place))
    assert any("65 position(s) taken" in n and f"({told})" in n for n in take.report.notes)


def test_places_of_whole_numbers_that_a_marker_visits_stay(tmp_path, rng):
    drift = np.cumsum(rng.normal(scale=0.3, size=(60, 3, 3)), axis=0)
    held = drift + 40
    held[20:30] = np.round(held[20])  # within a millimetre of where it was
    for P in (
        np.round(40 + drift),  # whole numbers are what it counts in
        held,
        np.where(np.arange(60)[:, None, None] % 20 < 10, [[[1.0, 2, 3]]], [[[41.0, 2, 3]]])
        + np.zeros((1, 3, 1)),
        np.concatenate([np.full((60, 1, 3), [10.0, 20, 30]), drift[:, :2]], axis=1),  # at rest
    ):
        take = read_markers(saved(tmp_path / "p.npz", positions=P, names=NAMES[:3], fps=100))
        np.testing.assert_allclose(take.positions, P, rtol=1e-6)


# --- npz ------------------------------------------------------------------------------------------


def test_npz_keeps_float32_and_takes_integers(tmp_path, P):
    path = saved(tmp_path / "d.npz", positions=P.astype(np.float32), names=NAMES, fps=[50.0])
    assert read_markers(path).positions.dtype == np.float32
    whole = np.round(np.nan_to_num(P, nan=7)).astype(int)
    take = read_markers(saved(path, positions=whole, names=NAMES, fps=50))
    np.testing.assert_array_equal(take.positions, whole)


def test_arrays_of_an_npz_that_are_not_read_are_told(tmp_path, P):
    seen = np.isfinite(P[..., 0])
    path = saved(tmp_path / "v.npz", positions=P, names=NAMES, fps=100, unit="mm", seen=seen)
    assert "1 other array(s) left out (seen)" in read_markers(path).report.notes


@pytest.mark.parametrize(
    "change, words",
    [
        ({"names": NAMES[:-1]}, r"positions has shape \(20, 8, 3\), but shape \(n_frames, 7, 3\)"),
        ({"names": [1] * 8}, "names is of type int64, but text are wanted"),
        ({"positions": np.full((20, 8, 3), "x")}, "positions is of type <U1, but"),
        ({"positions": np.full((20, 8, 3), True)}, "positions is of type bool"),
        ({"positions": np.zeros((0, 8, 3))}, "positions holds no frames"),
        ({"positions": 3.0}, "positions holds no frames"),
        ({"fps": 0}, "fps is 0, but must be one number above 0"),
        ({"fps": np.nan}, "fps is nan, but must be one number above 0"),
        ({"fps": [1, 2]}, r"fps is \[1, 2\], but must be one number above 0"),
        ({"unit": "furlong"}, "unit is 'furlong'"),
        ({"positions": np.full((20, 8, 3), np.inf)}, "more than a kilometre away"),
        ({"positions": np.array([{}] * 3, dtype=object)}, "not a readable"),
        ({"positions": None}, "has no positions"),
        ({"fps": None}, "no frame rate in it; say it with fps="),
    ],
)
def test_arrays_that_are_no_capture_are_refused(tmp_path, P, change, words):
    arrays = {"positions": P, "names": NAMES, "fps": 100} | change
    arrays = {k: v for k, v in arrays.items() if v is not None}
    with pytest.raises(ValueError, match=rf"d\.npz: .*{words}"):
        read_markers(saved(tmp_path / "d.npz", **arrays))


def npy(shape, dtype="<f8", data=b""):
    """An array's file whose header promises more than it has."""
    out = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, header)
    return out.getvalue() + data


def test_arrays_that_promise_more_than_they_have_take_no_memory(tmp_path):
    with zipfile.ZipFile(tmp_path / "d.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("positions.npy", npy((10**7, 100, 3)))
    with pytest.raises(ValueError, match=r"not a readable .* npz file"):
        read_markers(tmp_path / "d.npz")


def test_arrays_out_of_all_proportion_to_their_file_are_refused(tmp_path):
    pressed = {"compression": zipfile.ZIP_DEFLATED, "compresslevel": 1}
    with zipfile.ZipFile(tmp_path / "d.npz", "w", **pressed) as archive:
        archive.writestr("positions.npy", npy((120_000, 100, 3), data=bytes(288_000_000)))
    with pytest.raises(ValueError, match=r"would take 0\.3 GB of memory"):
        read_markers(tmp_path / "d.npz")


def test_a_pickle_is_never_opened(tmp_path):
    np.savez(tmp_path / "d.npz", positions=np.array([print], dtype=object))
    with pytest.raises(ValueError, match="not a readable"):
        read_markers(tmp_path / "d.npz")


@pytest.mark.parametrize("pressed", [False, True])
def test_what_a_mutant_says_does_not_contradict_itself(tmp_path, P, rng, pressed):
    """Every array carries a checksum, so a mutant is refused, or is what it was."""
    save = np.savez_compressed if pressed else np.savez
    save(tmp_path / "good.npz", positions=P, names=NAMES, fps=100.0, unit="mm")

    def contradicts(take, data, said):
        same = np.array_equal(take.positions, P, equal_nan=True) and take.names == tuple(NAMES)
        return "" if (same and take.fps == 100) or said else "other values than were written"

    good = (tmp_path / "good.npz").read_bytes()
    found = tally(read_markers, good, "m.npz", tmp_path, COUNT, rng, contradicts, binary=True)
    assert not found.wrong and not found.python, found
