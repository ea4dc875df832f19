import re
import warnings
from itertools import pairwise

import numpy as np
import pytest
from mutants import COUNT, tally
from recordings import FULL, PASCAL, code, drop_frame, live_link, values

from facelab.files.takes import read_live_link_csv, read_weights, to_arkit, write_live_link_csv
from facelab.motion import WeightSequence
from facelab.names import ANGLES, ARKIT, canonical

CODES = [code(i) for i in range(40)]
QUIET = pytest.mark.filterwarnings("ignore::UserWarning")


@pytest.fixture
def read(tmp_path):
    """Read text, or bytes, as a Live Link file."""

    def read(content, **options):
        path = tmp_path / "take.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_live_link_csv(path, **options)

    return read


@pytest.fixture
def strict(read):
    """As `read`, but nothing may be said."""

    def strict(content, **options):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return read(content, **options)

    return strict


# --- headers and cells ----------------------------------------------------------------------------


def test_a_take_has_arkits_names_and_its_angles_apart(strict):
    take = strict(live_link(CODES))
    W = values(40, 61)
    assert take.names == ARKIT
    np.testing.assert_array_equal(take.weights, W[:, :52])
    assert tuple(take.angles) == ANGLES
    np.testing.assert_array_equal(take.angles["RightEyeRoll"], W[:, 60])
    assert (take.fps, take.n_frames, take.valid.all()) == (30, 40, True)
    assert (take.others, take.gaps) == ({}, {})


def quoted(text):
    return re.sub(r"[^,\n]+", r'"\g<0>"', text)


SPELLINGS = {
    "the app of before": live_link(CODES, count="BlendShapeCount"),
    "the first app": live_link(CODES, columns=(*ARKIT, *ANGLES)),
    "lower case": live_link(CODES).lower(),
    "sides as _L": live_link(CODES, columns=[n.replace("Left", "_L") for n in PASCAL] + [*ANGLES]),
    "a namespace": live_link(CODES, columns=[f"blendShapes.{n}" for n in FULL]),
    "a prefix": live_link(CODES, columns=[f"ARKit_{n}" for n in FULL]),
    "rows numbered by pandas": "".join(
        f"{k - 1 if k else ''},{line}\n" for k, line in enumerate(live_link(CODES).splitlines())
    ),
    "comma at the end": live_link(CODES).replace("\n", ",\n"),
    "commas at the end": live_link(CODES).replace("\n", ",,,\n"),
    "semicolons": live_link(CODES, sep=";"),
    "semicolons, sep=": "sep=;\n" + live_link(CODES, sep=";"),
    "semicolons, decimal commas": live_link(CODES, sep=";").replace(".", ","),
    "tabs": live_link(CODES, sep="\t"),
    "tabs, decimal commas": live_link(CODES, sep="\t").replace(".", ","),
    "quotes": quoted(live_link(CODES)),
    "quotes, decimal commas": quoted(live_link(CODES)).replace(".", ","),
    "blanks around": live_link(CODES, sep=" , "),
    "Windows": live_link(CODES, end="\r\n"),
    "old Macintosh": live_link(CODES, end="\r"),
    "blank lines": live_link(CODES, end="\n\n"),
    "a blank line on top": "\n" + live_link(CODES),
    "a word on top": "# recorded on a Tuesday\n" + live_link(CODES),
    "UTF-8 with mark": b"\xef\xbb\xbf" + live_link(CODES).encode(),
    "UTF-16": live_link(CODES).encode("utf-16"),
    "UTF-16, big end": b"\xfe\xff" + live_link(CODES).encode("utf-16-be"),
    "UTF-16 without mark": live_link(CODES).encode("utf-16-le"),
    "UTF-16, big end, without mark": live_link(CODES).encode("utf-16-be"),
    "UTF-32": live_link(CODES).encode("utf-32"),
    "a point less": live_link(CODES).replace(".000,61", ",61"),
}


@pytest.mark.parametrize("text", SPELLINGS.values(), ids=SPELLINGS)
def test_all_who_write_such_files_are_read_alike(strict, text):
    take, plain = strict(text), strict(live_link(CODES))
    assert (take.names, take.fps, take.n_frames) == (plain.names, plain.fps, plain.n_frames)
    np.testing.assert_array_equal(take.weights, plain.weights)
    np.testing.assert_array_equal(take.angles["HeadYaw"], plain.angles["HeadYaw"])


def test_columns_come_in_any_order(strict, rng):
    W, order = values(40, 61), rng.permutation(61)
    take = strict(live_link(CODES, [FULL[k] for k in order], W[:, order].tolist()))
    for name, column in zip(take.names, take.weights.T, strict=True):
        np.testing.assert_array_equal(column, W[:, [canonical(n) for n in FULL].index(name)])
    lines = [line.split(",") for line in live_link(CODES).splitlines()]
    swapped = "\n".join(",".join([*line[2:], line[1], line[0]]) for line in lines) + "\n"
    np.testing.assert_array_equal(strict(swapped).weights, strict(live_link(CODES)).weights)


def test_columns_that_are_neither_weights_nor_angles_are_named_and_kept_apart(read):
    W = np.hstack([values(40, 52), values(40, 2) * 100])
    text = live_link(CODES, [*PASCAL, "Happy", "Sad"], W.tolist())
    with pytest.warns(UserWarning, match="neither weights nor angles.*others: Happy, Sad"):
        take = read(text)
    assert take.names == ARKIT
    assert set(take.others) == {"Happy", "Sad"}
    np.testing.assert_allclose(take.others["Sad"], W[:, 53])
    assert take.report.others == ("Happy", "Sad")


def test_words_in_a_foreign_column_are_left_out_with_a_word(read):
    rows = [[*row, mood] for row, mood in zip(values(3, 52).tolist(), "abc", strict=True)]
    with pytest.warns(UserWarning, match="columns of text are left out: Mood"):
        assert read(live_link(CODES[:3], [*PASCAL, "Mood"], rows)).others == {}


def test_missing_weights_are_named_not_made_up(read):
    with pytest.warns(UserWarning, match=r"no column for 1 of ARKit's 52 .*: tongueOut\.$"):
        take = read(live_link(CODES, [n for n in FULL if n != "TongueOut"]))
    assert "tongueOut" not in take.names
    assert take.report.missing == ("tongueOut",)


def test_a_count_that_is_none_of_the_columns_is_said(read):
    text = live_link(CODES, PASCAL).replace(",52,", ",61,")
    with pytest.warns(UserWarning, match="rows count 61 weights, the header names 52"):
        read(text)


# --- values ---------------------------------------------------------------------------------------


def test_weights_are_kept_as_recorded_not_clipped(strict):
    W = values(2, 61)
    W[:, :3] = [[1.2, -0.1, 0.5], [1.3, 0.1, 0.6]]
    take = strict(live_link([code(28), code(29)], rows=W.tolist()))
    np.testing.assert_array_equal(take.weights, W[:, :52])
    assert take.report.outside == 3


def test_percent_is_noticed_and_read_on_request(read, strict):
    W = values(40, 61) * 100
    W[:, 52:] /= 100
    text = live_link(CODES, rows=W.tolist())
    with pytest.raises(ValueError, match=r"take.csv, line 2, column eyeBlinkLeft: .*scale=0\.01"):
        read(text)
    take = strict(text, scale=0.01)
    np.testing.assert_allclose(take.weights, values(40, 61)[:, :52])
    np.testing.assert_allclose(take.angles["HeadYaw"], values(40, 61)[:, 52])


@pytest.mark.parametrize("bad", ["2.5", "-3", "1e5", "1e308", "99"])
def test_a_value_that_is_no_weight_is_refused_with_its_place(read, bad):
    text = live_link(CODES).splitlines()
    cells = text[6].split(",")
    cells[2 + FULL.index("JawOpen")] = bad
    text[6] = ",".join(cells)
    with pytest.raises(ValueError, match=r"take.csv, line 7, column jawOpen: .*no weight of 0 to"):
        read("\n".join(text) + "\n")
    if float(bad) > 1000:
        with pytest.raises(ValueError, match=r"line 7, column jawOpen: .* beyond any weight"):
            read("\n".join(text) + "\n", scale=1)


@pytest.mark.parametrize(
    "bad",
    ["1_0", "0_1.5", "١٢", "０.５", "0x1F", "nan", "inf", "-Infinity", "1.2.3", "½", "open", "-"],
)
def test_what_is_no_number_is_refused_with_its_place(read, bad):
    text = live_link(CODES).splitlines()
    text[6] = text[6].replace(text[6].split(",")[5], bad, 1)
    with pytest.raises(ValueError, match=r"take.csv, line 7, column eyeLookOutLeft: .* no number"):
        read("\n".join(text) + "\n")


def test_an_empty_cell_is_refused_with_its_place(read):
    text = live_link(CODES).splitlines()
    text[6] = text[6].replace(text[6].split(",")[5], "", 1)
    with pytest.raises(ValueError, match=r"line 7, column eyeLookOutLeft: the cell is empty"):
        read("\n".join(text) + "\n")


def test_weights_far_from_0_to_1_are_kept_and_said(read):
    W = values(40, 61)
    W[3, 17], W[9, 2] = -0.6, 1.7
    with pytest.warns(UserWarning, match=r"2 weights lie far .* first in line 5.* jawOpen -0.6"):
        np.testing.assert_array_equal(read(live_link(CODES, rows=W.tolist())).weights, W[:, :52])


def test_angles_in_degrees_are_not_taken_for_radians(read):
    W = values(40, 61)
    W[:, FULL.index("HeadYaw")] *= 30
    with pytest.warns(UserWarning, match=r"HeadYaw turn further than radians.* apart, in others"):
        take = read(live_link(CODES, rows=W.tolist()))
    assert not take.angles and tuple(take.others) == ANGLES  # one file, one unit
    for name in ANGLES:
        np.testing.assert_allclose(take.others[name], W[:, FULL.index(name)])
    W[3, FULL.index("HeadYaw")] = 1e7
    with pytest.raises(ValueError, match=r"line 5, column HeadYaw: 1e\+07 is no angle"):
        read(live_link(CODES, rows=W.tolist()))


def test_angles_beyond_half_a_turn_are_said(read):
    W = values(40, 61)
    W[:, FULL.index("HeadYaw")] = 4
    with pytest.warns(UserWarning, match="HeadYaw turn further than half a turn in radians"):
        assert "HeadYaw" in read(live_link(CODES, rows=W.tolist())).angles


@pytest.mark.parametrize(
    "name, most", [("HeadYaw", 1.7), ("HeadPitch", 1.4), ("HeadRoll", 2.2), ("LeftEyeYaw", 1.3)]
)
def test_angles_that_no_head_turns_in_radians_are_said(read, name, most):
    W = values(40, 61)
    W[21, FULL.index("HeadYaw")] = 1.55  # as far as a head turns
    W[20, FULL.index(name)] = -most
    words = f"{name} turn further than a head or an eye does in radians, up to {most}"
    with pytest.warns(UserWarning, match=words):
        assert name in read(live_link(CODES, rows=W.tolist())).angles


def test_angles_in_whole_tenths_are_said(read):
    W = values(40, 61)
    W[:, 52:] = W[:, 52:].round(1)
    with pytest.warns(UserWarning, match="all angles are whole tenths; if these are degrees"):
        read(live_link(CODES, rows=W.tolist()))


def test_a_row_of_nan_is_a_lost_frame(read):
    W = values(40, 61)
    W[7] = np.nan
    take = read(live_link(CODES, rows=W.tolist()))
    assert np.flatnonzero(~take.valid).tolist() == [7]


# --- lost frames ----------------------------------------------------------------------------------


@pytest.mark.parametrize("tail", ["", "," * 61, ",0" * 61, ",0.0000" * 61], ids=len)
def test_rows_without_a_face_are_lost_frames_in_their_place(strict, tail):
    rows = values(40, 61).tolist()
    for i in (0, 11, 12, 39):
        rows[i] = None
    text = live_link(CODES, rows=rows).replace(",0\n", ",0" + tail + "\n")
    take = strict(text)
    np.testing.assert_array_equal(np.flatnonzero(~take.valid), [0, 11, 12, 39])
    assert np.isnan(take.weights[~take.valid]).all()
    assert take.report.no_face == 4
    np.testing.assert_array_equal(take.weights[13], values(40, 61)[13, :52])


def test_a_face_that_is_never_there_is_no_take(read):
    with pytest.raises(ValueError, match=r"take\.csv: no frame in it shows a face"):
        read(live_link(CODES, rows=[None] * 40))


@pytest.mark.parametrize("base, every", [(30, 1), (60, 2)])
def test_dropped_frames_come_back_as_lost_ones_in_their_place(strict, base, every):
    present = [i for i in range(90) if i not in (7, 30, 31, 32, 60)]
    take = strict(live_link([code(0.65 + every * i, base) for i in present]))
    assert take.n_frames == 90
    np.testing.assert_array_equal(np.flatnonzero(take.valid), present)
    np.testing.assert_array_equal(take.weights[present], values(85, 61)[:, :52])
    assert np.isnan(take.weights[~take.valid]).all()
    assert np.isnan(take.angles["HeadYaw"][~take.valid]).all()
    assert take.report.filled == 5


def test_a_frozen_frame_is_lost_but_one_that_moved_in_a_single_value_is_not(strict):
    rows = values(40, 61)
    rows[12] = rows[13] = rows[11]
    rows[20] = rows[19]
    rows[20, 60] += 0.0001  # only an angle differs
    take = strict(live_link(CODES, rows=rows.tolist()))
    np.testing.assert_array_equal(np.flatnonzero(~take.valid), [12, 13])
    assert take.report.repeated == 2
    assert strict(live_link(CODES, rows=rows.tolist()), repeats="kept").valid.all()


def test_many_frozen_frames_are_said(read):
    rows = np.repeat(values(20, 61), 2, axis=0).tolist()
    with pytest.warns(UserWarning, match=r"20 of 40 rows repeat .* repeats='kept'"):
        assert read(live_link(CODES, rows=rows)).valid.sum() == 20


def test_what_the_count_says_must_be_so(read):
    lines = live_link(CODES).splitlines()
    for line, words in (
        (lines[5].replace(",61,", ",0,"), "line 6: the row counts 0 weights.*but has eyeBlinkLeft"),
        (lines[5].replace(",61,", ",6,"), "line 6: the row counts 6 weights, those before 61"),
        (CODES[4] + ",61", "line 6: 2 values, but the header names 63"),
        (CODES[4] + ",61" + "," * 61, "line 6: the row counts 61 weights but has none"),
        (lines[5].replace(",61,", ",six,"), "line 6, column BlendshapeCount: 'six' is no number"),
        (lines[5].replace(",61,", ",6.5,"), "line 6, column BlendshapeCount: '6.5' is no whole"),
    ):
        with pytest.raises(ValueError, match=r"take\.csv, " + words):
            read("\n".join([*lines[:5], line, *lines[6:]]) + "\n")


@pytest.mark.parametrize("row", [1, 5])
@pytest.mark.parametrize("by", [read_live_link_csv, read_weights])
def test_a_cell_that_is_no_number_is_named_in_the_first_row_too(tmp_path, row, by):
    lines = live_link(CODES).splitlines()
    lines[row] = ",".join([*lines[row].split(",")[:2], "wide", *lines[row].split(",")[3:]])
    (tmp_path / "take.csv").write_text("\n".join(lines) + "\n")
    words = rf"take\.csv, line {row + 1}, column eyeBlinkLeft: 'wide' is no number"
    with pytest.raises(ValueError, match=words):
        by(tmp_path / "take.csv")


# --- a file that ends early -----------------------------------------------------------------------


@pytest.mark.parametrize("kept", [3, 20, 200, 300])
@pytest.mark.parametrize("end", ["", "\n"])
def test_a_last_row_cut_short_is_left_out_with_a_word(read, kept, end):
    text = live_link(CODES)
    text = text[: text.rstrip("\n").rindex("\n") + 1 + kept].rstrip(",")
    with pytest.warns(UserWarning, match=r"last row, line 41, is cut short and left out"):
        take = read(text + end)
    assert take.n_frames == 39
    np.testing.assert_array_equal(take.weights, values(40, 61)[:39, :52])


@pytest.mark.parametrize("last", ["", "-"])
def test_a_last_number_that_is_cut_to_none_is_left_out_too(read, last):
    text = live_link(CODES)
    text = text[: text.rindex(",") + 1] + last
    with pytest.warns(UserWarning, match="last row, line 41, is cut short and left out"):
        assert read(text).n_frames == 39
    with pytest.raises(ValueError, match="line 41, column RightEyeRoll"):
        read(text + "\n")


def test_a_row_cut_short_in_the_middle_is_refused(read):
    lines = live_link(CODES).splitlines(keepends=True)
    lines[20] = lines[20][:100] + "\n"
    with pytest.raises(ValueError, match=r"take\.csv, line 21: \d+ values, but the header"):
        read("".join(lines))


def test_a_last_number_with_fewer_digits_than_all_others_there_is_cut(read):
    W = values(40, 61)
    text = live_link(CODES, rows=[[f"{v:.6f}" for v in row] for row in W])
    with pytest.warns(UserWarning, match="line 41, ends in a number with fewer digits.*left out"):
        assert read(text[:-3]).n_frames == 39
    with pytest.warns(UserWarning, match="line 41, has no line end: its last number may be cut"):
        assert read(text[:-1]).n_frames == 40


# --- time -----------------------------------------------------------------------------------------


def test_one_row_a_second_is_refused_with_the_remedy(read, strict):
    text = live_link([code(0, start=i) for i in range(120)])
    with pytest.raises(ValueError, match=r"lines 2 to 121: .*amount to 1 frames/s.*fps=30"):
        read(text)
    take = strict(text, fps=25)
    assert (take.fps, take.n_frames, take.valid.all()) == (25, 120, True)
    assert "time codes not used" in str(take.report)


def test_fps_takes_the_rows_as_they_follow(strict):
    take = strict(live_link(["morning", *["later"] * 39]), fps=50)
    assert (take.fps, take.n_frames) == (50, 40)


@pytest.mark.parametrize("base", [30, 60])
def test_drop_frame_codes_are_those_of_29_97_and_59_94_and_nothing_is_lost(strict, base):
    start = 17982 * base // 30 * 20 + 60 * base - 300  # some frames before a minute, 03:20:59
    codes = [drop_frame(start + i, base) for i in range(600)]
    assert codes[0][:8] < "03:21:00" < codes[-1][:8]
    take = strict(live_link(codes))
    assert take.fps == base * 1000 / 1001
    assert (take.n_frames, take.valid.all()) == (len(codes), True)
    missing = [c for i, c in enumerate(codes) if i not in (100, 101)]
    take = strict(live_link(missing))
    np.testing.assert_array_equal(np.flatnonzero(~take.valid), [100, 101])


@pytest.mark.parametrize("sep", [",", ";", "\t"])
def test_a_drop_frame_mark_may_be_the_separator_too(strict, sep):
    codes = [drop_frame(36000 * 30 + i, 30) for i in range(40)]
    rows = values(40, 61).tolist()
    rows[5] = None
    for first in (None, rows[0]):
        take = strict(live_link(codes, rows=[first, *rows[1:]], sep=sep))
        assert take.fps == 30000 / 1001
        np.testing.assert_array_equal(take.weights[6], values(40, 61)[6, :52])
        assert take.valid.sum() == (38 if first is None else 39)


def test_a_take_passes_midnight(strict):
    codes = [code(i, start=86399) for i in range(60)]
    assert codes[-1].startswith("00:00:00")
    take = strict(live_link(codes))
    assert (take.n_frames, take.fps, take.valid.all()) == (60, 30, True)


def test_a_gap_is_a_mark_in_time_not_a_million_frames(read):
    """100 rows a quarter of an hour apart: 39 kB that must not become gigabytes."""
    codes = [code(i % 2, start=900 * (i // 2)) for i in range(90)]
    with pytest.warns(UserWarning, match=r"time is missing at 44 place.s., up to 899\.9 s"):
        take = read(live_link(codes))
    assert take.n_frames == 90
    assert set(take.gaps) == set(range(2, 90, 2))
    np.testing.assert_allclose(take.times[::2], 900 * np.arange(45))
    assert "gap: 899.93 s missing before frame 2" in str(take.report)


def test_short_gaps_are_lost_frames_and_long_ones_marks(read, strict):
    take = strict(live_link([code(i + 59 * (i >= 60)) for i in range(120)]))
    assert (take.n_frames, take.gaps) == (179, {})
    with pytest.warns(UserWarning, match="time is missing at 1 place"):
        take = read(live_link([code(i + 60 * (i >= 60)) for i in range(120)]))
    assert (take.n_frames, take.gaps) == (120, {60: 2.0})


def test_codes_that_place_no_frames_are_refused(read):
    for steps in ([1, 3, 2, 5], [1, 1, 9, 9], [1, 1, 1, 40], [2, 7, 1, 1, 3, 8]):
        with pytest.raises(ValueError, match=r"take\.csv, line.* rows lack .*fps=30"):
            read(live_link([code(i) for i in np.cumsum(steps * 20)]))


@pytest.mark.parametrize(
    "change, words",
    [
        ((4, ":04:03", ":03"), "line 5: time code '13:13:03.000' is not of the kind of the first"),
        ((4, "13:13", "13:73"), "line 5: time code '13:73:04:03.000' is not"),
        ((4, ":03.000", ":nan"), "line 5: time code .* is not"),
        ((4, ":03.000", ":-3.000"), "line 5: time code .* is not"),
        ((4, ":03.000", ":٣.000"), "line 5: time code .* is not"),
        ((4, ":03.000", ":01.000"), "line 5: .*01.000 runs back behind that of line 4.*fps=30"),
        ((4, ":03.000", ":02.000"), "line 5: .*02.000 repeats that of line 4.*fps=30"),
        ((19, "13:13", "12:13"), "line 20: time code 12:13.* runs back"),
        ((31, "13:13", "93:13"), "line 32: time code 93:13.* has 93 hours"),
        ((31, "05:00", "05:250"), "line 32: .* counts 250 frames in a second; 240 at most"),
    ],
)
def test_codes_that_cannot_be_are_refused_with_their_line(read, change, words):
    line, old, new = change
    lines = live_link(CODES).splitlines()
    assert old in lines[line]
    lines[line] = lines[line].replace(old, new, 1)
    with pytest.raises(ValueError, match=r"take\.csv, " + words):
        read("\n".join(lines) + "\n")


# --- what is no such file -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "is empty; export the Live Link CSV file again"),
        ("\n\n", "blank lines only"),
        ("time,a,b\n1,2,3\n", "line 1: no column a weight of ARKit"),
        (live_link(CODES).replace("Timecode", "Timeline"), "line 1: no column Timecode"),
        (live_link(CODES).replace(",JawOpen", ","), "line 1: column 20 has no name"),
        (
            live_link(CODES).replace("HeadYaw", "jaw_open"),
            "line 1: columns that name the same: JawOpen and jaw_open",
        ),
        (
            live_link(CODES).replace("HeadYaw", "Timecode"),
            "line 1: columns that name the same: Timecode and Timecode",
        ),
        (live_link([]), "no frames below the header, line 1"),
        ("1,2,3\n4,5,6\n", "line 1: numbers where the names"),
        (live_link(CODES).replace(",61,", ",61,0.5,", 1), "line 2: 64 values, but the header"),
        (live_link(CODES).replace(",61,", ',61,"', 1), "line 2: a quotation mark"),
        ("x" * 5_000_000, "line 1 is longer than 4 MB: this is no Live Link CSV file"),
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", r"line 1: byte 0x89 at place 1 is no UTF-8"),
        (b"glTF\x02\0\0\0", "line 1: a zero byte"),
        (live_link(CODES).encode("utf-16")[:-1], "marked as UTF-16-LE but breaks off"),
        (live_link(CODES).replace("0.", "\u00a00.", 1).encode("latin-1"), "line 2: byte 0xa0"),
    ],
)
def test_what_is_no_recording_is_refused_in_words(read, text, words):
    with pytest.raises(ValueError, match=r"take\.csv.*" + words):
        read(text)


def test_a_stray_quote_does_not_swallow_the_rest_of_the_file(read):
    lines = live_link([code(i) for i in range(4000)]).split("\n")
    lines[2] = lines[2].replace("61,", '61,"', 1)
    with pytest.raises(ValueError, match=r"take.csv, line 3: a quotation mark that is not closed"):
        read("\n".join(lines))


def test_a_missing_file_and_a_pipe_are_refused(tmp_path):
    import os

    with pytest.raises(FileNotFoundError, match=r"nowhere.csv.*there is no such Live Link CSV"):
        read_live_link_csv(tmp_path / "nowhere.csv")
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(ValueError, match=r"pipe.csv' is not a file"):
        read_live_link_csv(tmp_path / "pipe.csv")


def test_options_are_checked(read):
    for options, words in (
        ({"fps": 0}, "fps=0"),
        ({"scale": -1}, "scale=-1"),
        ({"repeats": "no"}, "repeats='no' is unknown"),
    ):
        with pytest.raises(ValueError, match=words):
            read(live_link(CODES), **options)


# --- real recordings ------------------------------------------------------------------------------


@pytest.mark.real
@pytest.mark.parametrize("name, rows", [("alex_rom_3", 4030), ("alex_rom_4", 3809)])
def test_the_real_takes_are_read_whole(captures_root, real_takes, name, rows):
    take = real_takes[name]
    lines = (captures_root / f"{name}.csv").read_text().split()[1:]
    assert len(lines) == take.report.rows == rows
    recorded = [line.split(",", 1) for line in lines]
    frozen = sum(a[1] == b[1] for a, b in pairwise(recorded))
    assert take.valid.sum() == rows - frozen
    assert (take.fps, take.names, tuple(take.angles)) == (30, ARKIT, ANGLES)
    clock = [np.array(s.split(":"), float) @ [3600, 60, 1, 1 / 60] for s, _ in recorded]
    # the clock of the phone and the count of frames agree over two minutes to a tenth of a second
    assert (take.n_frames - 1) / 30 == pytest.approx(clock[-1] - clock[0], abs=0.1)
    assert take.weights[0, take.names.index("eyeBlinkLeft")] == float(lines[0].split(",")[2])
    jaw = take.weights[take.valid, take.names.index("jawOpen")]
    assert jaw.max() > 0.5


# --- writing --------------------------------------------------------------------------------------


def some_take(rng, names=ARKIT, n_frames=40, fps=30.0, lost=(), **more):
    W = rng.uniform(size=(n_frames, len(names)))
    valid = np.ones(n_frames, dtype=bool)
    valid[list(lost)] = False
    W[~valid] = np.nan
    return WeightSequence(W, names, fps, valid, **more)


def same(read, given):
    assert (read.names, read.n_frames) == (given.names, given.n_frames)
    assert read.fps == pytest.approx(given.fps, rel=2e-6)
    np.testing.assert_array_equal(read.valid, given.valid)
    np.testing.assert_array_equal(read.weights, given.weights)
    assert read.gaps.keys() == given.gaps.keys()
    assert [*read.gaps.values()] == pytest.approx([*given.gaps.values()], abs=0.5 / given.fps)


@pytest.mark.parametrize("fps", [5, 10, 12, 15, 20, 24, 25, 29.97, 30, 50, 30000 / 1001, 59.94, 60])
@pytest.mark.parametrize("n_frames", [1, 2, 17, 200])
def test_a_take_comes_back_exactly_from_a_live_link_file(tmp_path, rng, fps, n_frames):
    if n_frames == 1 and fps != 60:
        fps = 30  # a single frame has no rate: thirtieths are assumed
    given = some_take(rng, n_frames=n_frames, fps=fps)
    write_live_link_csv(tmp_path / "take.csv", given)
    same(read_live_link_csv(tmp_path / "take.csv"), given)


def test_drop_frame_codes_are_written_over_a_minute_and_read_again(tmp_path, rng):
    given = some_take(rng, n_frames=2000, fps=30000 / 1001)
    write_live_link_csv(tmp_path / "take.csv", given)
    text = (tmp_path / "take.csv").read_text()
    assert "00:00:59;29" in text and "00:01:00;02" in text and "00:01:00;01" not in text
    same(read_live_link_csv(tmp_path / "take.csv"), given)


def test_tiny_and_awkward_numbers_come_back_exactly_without_exponents(tmp_path, rng):
    given = some_take(rng)
    given.weights[0, :5] = [1e-17, -1e-5, 1 / 3, 5e-324, 1.0]
    write_live_link_csv(tmp_path / "take.csv", given)
    assert "e" not in (tmp_path / "take.csv").read_text().partition("\n")[2]
    same(read_live_link_csv(tmp_path / "take.csv"), given)


@QUIET
@pytest.mark.parametrize("fps", [24, 29.97, 60])
def test_lost_frames_gaps_and_angles_come_along(tmp_path, rng, fps):
    given = some_take(rng, n_frames=300, fps=fps, lost=(0, 1, 7, 8, 150, 299), gaps={100: 700.0})
    angles = {n: np.where(given.valid, rng.normal(size=300), np.nan) for n in ANGLES[:4]}
    given = WeightSequence(
        given.weights, ARKIT, fps, given.valid, angles, gaps={100: 700.0, 200: 9.0}
    )
    write_live_link_csv(tmp_path / "take.csv", given)
    read = read_live_link_csv(tmp_path / "take.csv")
    same(read, given)
    for name in ANGLES:
        want = angles.get(name, np.where(given.valid, 0.0, np.nan))
        np.testing.assert_array_equal(read.angles[name], want)


def test_held_frames_are_said_and_can_be_kept(tmp_path, rng):
    given = some_take(rng)[[0, 1, 1, 1, 2]]
    with pytest.warns(UserWarning, match=r"2 of 5 frames repeat .* repeats='kept'"):
        write_live_link_csv(tmp_path / "take.csv", given)
    same(read_live_link_csv(tmp_path / "take.csv", repeats="kept"), given)


@pytest.mark.real
def test_a_recorded_take_written_again_is_the_same(tmp_path, real_takes):
    given = real_takes["alex_rom_3"][:300]
    write_live_link_csv(tmp_path / "again.csv", given)
    same(read_live_link_csv(tmp_path / "again.csv"), given)


def test_a_single_pose_of_an_actor_is_one_row(tmp_path):
    given = WeightSequence([[0.4, 0.25]], ["AU12L", "AU1"], 30.0)
    write_live_link_csv(tmp_path / "pose.csv", given)
    read = read_weights(tmp_path / "pose.csv")
    named = {n: w for n, w in zip(read.names, read.weights[0], strict=True) if w}
    assert named == {"mouthSmileLeft": 0.4, "browInnerUp": 0.25}


def test_what_cannot_be_written_leaves_no_file(tmp_path, rng):
    for given, complaint in (
        (some_take(rng, fps=29.9), r"fps=29.9, but a time code counts 24, 25"),
        (some_take(rng, fps=2), r"fps=2, but a time code counts"),
        (some_take(rng, ["AU35"]), "no unit with an ARKit name"),
        (some_take(rng, n_frames=3, lost=(0, 1, 2)), "no valid frame"),
        (some_take(rng, ["AU12L", "AU35"], 0), "no valid frame"),
        (WeightSequence([[2.5]], ["jawOpen"], 30), "holds 1 weights beyond 2"),
        (some_take(rng, gaps={5: 90_000.0}), "longer than a day"),
    ):
        with pytest.raises(ValueError, match=complaint):
            write_live_link_csv(tmp_path / "take.csv", given)
    assert not list(tmp_path.iterdir())


def test_units_that_share_a_name_give_it_their_strongest():
    given = WeightSequence([[0.2, 0.7, 0.1], [0.5, -0.8, 0.0]], ["AU26", "AU27", "AU12L"], 30)
    arkit = to_arkit(given)
    np.testing.assert_array_equal(arkit.weights[:, ARKIT.index("jawOpen")], [0.7, -0.8])
    np.testing.assert_array_equal(arkit.weights[:, ARKIT.index("mouthSmileLeft")], [0.1, 0])
    assert np.count_nonzero(arkit.weights) == 3


def test_used_units_without_a_counterpart_are_named_and_unused_ones_are_not():
    given = WeightSequence([[0.2, 0.7, 0.0]], ["AU12L", "AU35", "AU38"], 30)
    with pytest.warns(UserWarning, match=r"no such shape: AU35\.$"):
        to_arkit(given)


def test_no_frames_stay_no_frames():
    assert to_arkit(WeightSequence(np.empty((0, 2)), ["AU12L", "AU35"], 30)).n_frames == 0


def test_only_a_take_goes_to_arkit():
    with pytest.raises(TypeError, match="take is a ndarray, but must be of type WeightSequence"):
        to_arkit(np.zeros((3, 52)))


# --- broken files ---------------------------------------------------------------------------------


def contradicts(take, data, said):
    """What in a take its file denies, read by a second road: lines and commas, nothing else."""
    lines = [line.split(",") for line in data.decode().split("\n") if line.strip()]
    header, rows = lines[0], [[c.strip() for c in row] for row in lines[1:]]
    if any("cut short" in words for words in said):
        rows = rows[:-1]
    known = [(k, canonical(n)) for k, n in enumerate(header) if canonical(n)]
    weights = [(k, n) for k, n in known if n in ARKIT]
    if take.report.rows != len(rows):
        return f"{take.report.rows} rows, but the file has {len(rows)}"
    if take.names != tuple(n for _, n in weights):
        return "other names"
    unknown = {n for n in header if n and not canonical(n)} - {"Timecode", "BlendshapeCount"}
    told = " ".join(said)
    if any(n.strip() not in told for n in unknown):
        return f"columns passed over without a word: {unknown}"
    if (
        not np.isfinite(take.weights[take.valid]).all()
        or np.abs(take.weights[take.valid]).max() > 2
    ):
        return "weights that are none"
    at = header.index("BlendshapeCount") if "BlendshapeCount" in header else 1
    face = [row for row in rows if row[at] != "0"]
    number = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
    cells = [[row[k].strip('"') for k, _ in weights] for row in face]
    if not all(number.fullmatch(c) for row in cells for c in row):
        return "cells that are no numbers"
    frozen = ~take.valid & ~np.isnan(take.weights).any(axis=1)
    if not np.array_equal(np.array(cells, dtype=float), take.weights[take.valid | frozen]):
        return "other values"
    counts = {row[1] for row in face}
    if "BlendshapeCount" in header and len(counts) > 1:
        return f"counts that differ: {counts}"
    if len({row[0] for row in rows}) < len(rows):
        return "a time code twice"
    if take.n_frames > 2 * len(rows) + 120:
        return "frames out of nothing"
    return ""


def test_broken_recordings_are_refused_in_words_or_read_as_they_are(tmp_path):
    rows = values(25, 61).tolist()
    rows[7] = rows[8] = None
    good = live_link([code(i) for i in range(12, 37)], rows=rows).encode()
    rng = np.random.default_rng(5)
    found = tally(read_live_link_csv, good, "take.csv", tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found
    assert found.counts["refused"] > COUNT / 2
