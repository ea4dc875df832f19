import re
import warnings

import numpy as np
import pytest
from capture_tables import motive, nexus, plain, qualisys, trc
from mutants import COUNT, tally

from facelab.files import read_markers

NAMES = ["chin", "nose_tip", "lip_upper", "lip_lower", "brow_left_1", "brow_right_1", "jaw_left_5"]


@pytest.fixture
def P(rng):
    """30 frames of 7 markers within a face; one is hidden for a while."""
    rest = rng.normal(scale=50, size=(7, 3))
    P = (rest + rng.normal(scale=2, size=(30, 7, 3))).round(3)
    P[4:9, 2] = np.nan
    return P


def read(tmp_path, text, name="take.csv", **options):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return read_markers(path, **options)


def check(take, P, fps, names=NAMES):
    assert take.names == tuple(names)
    assert take.fps == fps
    np.testing.assert_allclose(take.positions, P, atol=2e-5)  # float32 near 200 mm


@pytest.mark.parametrize("gap", [", ", ",\t", "\t,", " ,\t "])
def test_blanks_and_tabs_beside_commas_are_none_of_the_cells(tmp_path, P, gap):
    head, rows = plain(P, NAMES).split("\n", 1)
    check(read(tmp_path, head + "\n" + rows.replace(",", gap)), P, 100)
    quoted = motive(P, NAMES).replace(",", gap)  # quotes, too, come after the blanks
    check(read(tmp_path, quoted), P, 120)


# --- what each program writes ---------------------------------------------------------------------


@pytest.mark.parametrize("version, labels", [("1.22", False), ("1.23", True), ("1.25", True)])
@pytest.mark.parametrize("unit", ["Meters", "Centimeters", "Millimeters"])
def test_motive(tmp_path, P, unit, version, labels):
    take = read(tmp_path, motive(P, [f"Face:{n}" for n in NAMES], 120, unit, version, labels))
    np.testing.assert_allclose(take.positions, P, atol=1e-3)  # six digits of a metre
    assert (take.names, take.fps) == (tuple(NAMES), 120)
    assert "4 column(s) that are no markers left out (rigid body)" in take.report.notes
    assert "prefix Face: taken off the names" in take.report.notes


def test_motive_without_markers_is_refused(tmp_path, P):
    text = motive(P, NAMES).replace("Marker", "Rigid Body Marker")
    with pytest.raises(ValueError, match="no markers in it, only rigid body, rigid body marker"):
        read(tmp_path, text)


def test_motive_with_a_column_of_time_codes(tmp_path, P):
    lines = motive(P, NAMES, extra=False).splitlines()
    wide = []
    for line in lines[2:]:
        a, b, rest = line.split(",", 2)
        code = {"Frame": "TimeCode", "": ""}.get(a, "15:26:46:12.02")
        wide.append(",".join([a, b, code, rest]))
    take = read(tmp_path, "\n".join(lines[:2] + wide) + "\n")
    np.testing.assert_allclose(take.positions, P, atol=1e-3)


@pytest.mark.parametrize("first", [1, 250])
def test_nexus(tmp_path, P, first):
    take = read(tmp_path, nexus(P, [f"Anna:{n}" for n in NAMES], 250, first))
    check(take, P, 250)


def test_nexus_with_other_parts_before_and_behind(tmp_path, P):
    other = "Devices\n1000\n,,Plate\nFrame,Sub Frame,Fx\n,,N\n1,0,5\n1,1,5\n\n"
    take = read(tmp_path, nexus(P, NAMES, before=other, after=other.replace("Devices", "Joints")))
    check(take, P, 100)
    assert "1 other part(s) left out (devices)" in take.report.notes
    assert "what follows the rows left out, from line 45 on: Joints" in take.report.notes
    with pytest.raises(ValueError, match="line 22: rows go on behind a blank line"):
        read(tmp_path, nexus(P, NAMES).replace("\n16,", "\n\n16,"))


def test_nexus_velocities_are_no_positions(tmp_path, P):
    text = nexus(P, NAMES)
    head, *rows = text.split("\n\n")[0].split("\n")[2:]
    axes, units, *values = rows
    wide = [head + ",chin,,", axes + ",X',Y',Z'", units + ",mm/s,mm/s,mm/s"]
    wide += [v + ",1,2,3" for v in values]
    take = read(tmp_path, "\n".join(["Trajectories", "100", *wide]) + "\n")
    check(take, P, 100)
    assert "3 column(s) that are no positions left out (X', Y', Z')" in take.report.notes


@pytest.mark.parametrize("hidden", ["0.000", "", "NULL"])
@pytest.mark.parametrize("titled", [True, False])
def test_qualisys(tmp_path, P, titled, hidden):
    take = read(tmp_path, qualisys(P, NAMES, 120, titled, hidden, types=titled), "take.tsv")
    check(take, P, 120)
    if hidden == "0.000":
        assert "5 position(s) at exactly 0, 0, 0 taken for hidden" in take.report.notes


def test_qualisys_bodies_are_refused(tmp_path, P):
    with pytest.raises(ValueError, match="DATA_INCLUDED is '6D'"):
        read(tmp_path, qualisys(P, NAMES).replace("\t3D", "\t6D"), "take.tsv")


@pytest.mark.parametrize("unit, size", [("mm", 1), ("m", 1000), ("Centimeters", 10)])
def test_trc(tmp_path, P, unit, size):
    take = read(tmp_path, trc(P / size, NAMES, 60, unit, digits=8), "take.trc")
    check(take, P, 60)
    assert "axes as in the file, which TRC leaves open" in take.report.notes


def test_trc_with_tabs_at_the_ends_and_other_line_ends(tmp_path, P):
    text = trc(P, NAMES).replace("\n", "\t\r\n")
    check(read(tmp_path, text, "take.trc"), P, 60)
    check(read(tmp_path, trc(P, NAMES).replace("\n", "\r"), "take.trc"), P, 60)


@pytest.mark.parametrize("mark, decimal", [(",", "."), (";", "."), (";", ","), ("\t", ",")])
@pytest.mark.parametrize("joint", ["_", ".", " ", ":", ""])
def test_plain_tables(tmp_path, P, mark, decimal, joint):
    take = read(tmp_path, plain(P, NAMES, mark, decimal, 100, joint=joint))
    check(take, P, 100)
    assert "no unit in the file: taken as millimetres; another with unit=" in take.report.notes


def test_plain_tables_with_quotes_a_mark_and_windows_line_ends(tmp_path, P):
    lines = [line.split(",") for line in plain(P, NAMES).splitlines()]
    text = "".join(",".join(f'"{c}"' if c else c for c in line) + ",\r\n" for line in lines)
    check(read(tmp_path, "\ufeff" + text), P, 100)


def test_a_spreadsheet_in_utf_16_is_read(tmp_path, P):
    check(read(tmp_path, plain(P, NAMES, "\t").encode("utf-16")), P, 100)


def test_landmarks_of_openface_are_markers_and_its_pose_is_none(tmp_path, P):
    n = P.shape[1]
    header = ["frame", "timestamp", "success", "pose_Rx", "pose_Ry", "pose_Rz", "x_0"]
    header += [f"{axis}_{k}" for axis in "XYZ" for k in range(n)]
    P = np.nan_to_num(P, nan=0)  # as it writes what it did not find
    rows = [
        [i + 1, f"{i / 50:.3f}", 1, 0.1, 0.2, 0.3, 640, *(f"{c:.3f}" for c in frame.T.ravel())]
        for i, frame in enumerate(P)
    ]
    take = read(tmp_path, "\n".join(", ".join(map(str, row)) for row in [header, *rows]) + "\n")
    assert take.names == tuple(map(str, range(n))) and take.fps == 50
    seen = np.isfinite(take.positions)
    np.testing.assert_allclose(take.positions[seen], P[seen], atol=1e-3)
    assert not P[~seen].any()


def test_plain_tables_need_a_rate_from_somewhere(tmp_path, P):
    text = plain(P, NAMES, timed=False)
    with pytest.raises(ValueError, match="no frame rate in it, and no times; say it with fps="):
        read(tmp_path, text)
    check(read(tmp_path, text, fps=50), P, 50)


def test_a_row_of_empty_cells_is_a_frame_without_markers(tmp_path, P):
    P[11] = np.nan
    check(read(tmp_path, plain(P, NAMES, timed=False), fps=50), P, 50)
    check(read(tmp_path, plain(P, NAMES)), P, 100)
    check(read(tmp_path, trc(P, NAMES), "take.trc"), P, 60)


def test_time_codes_beside_markers_are_left_out(tmp_path, P):
    lines = plain(P, NAMES, timed=False).split()
    lines = ["TimeCode," + lines[0]] + [f"10:00:00:{i:02d},{v}" for i, v in enumerate(lines[1:])]
    take = read(tmp_path, "\n".join(lines) + "\n", fps=30)
    check(take, P, 30)
    assert "1 other column(s) left out (TimeCode)" in take.report.notes


@pytest.mark.parametrize("placed, turn", [("Head_T", "Head_R"), ("T", "R"), ("Head_", "Head_q")])
def test_rotations_of_what_other_columns_place_are_no_markers(tmp_path, P, placed, turn):
    lines = plain(P, NAMES, timed=False).split()
    more = [f"{stem}{axis}" for stem in (placed, turn) for axis in "xyz"]
    lines = [",".join([lines[0], *more])] + [f"{line},1,2,3,.1,.2,.3" for line in lines[1:]]
    take = read(tmp_path, "\n".join(lines) + "\n", fps=30)
    assert take.names == (*NAMES, placed.rstrip("_"))
    assert f"3 other column(s) left out ({turn}x, {turn}y, {turn}z)" in take.report.notes
    names = ["lip", "lip_r", "lip_v", *NAMES[3:]]  # a right and a lower lip
    for joint in ("_", ""):
        assert read(tmp_path, plain(P, names, joint=joint)).names == tuple(names)


@pytest.mark.parametrize(
    "turn",
    [
        *("Head Rotation ", "Head_rot_", "headRotate", "HeadRot", "Rotation.Head.", "chin_vel_"),
        *("Chin Velocity ", "chin_acceleration_", "Head_r", "Head_q", "chin_v", "quat_"),
    ],
)
def test_turns_and_speeds_are_no_markers_with_nothing_placed_beside_them(tmp_path, P, turn):
    lines = plain(P, NAMES, timed=False).split("\n")[:-1]
    lines = [",".join([lines[0], *(turn + axis for axis in "xyz")])] + [
        f"{line},12,13,14" for line in lines[1:]
    ]
    take = read(tmp_path, "\n".join(lines) + "\n", fps=30)
    check(take, P, 30)
    assert f"3 other column(s) left out ({turn}x, {turn}y, {turn}z)" in take.report.notes
    with pytest.raises(ValueError, match=r"no column is called like .* but of turns or speeds"):
        read(tmp_path, "Head_rot_x,Head_rot_y,Head_rot_z\n1,2,3\n", fps=30)


def test_a_name_above_three_axes(tmp_path, P):
    head = ["frame"] + [n for name in NAMES for n in (name, "", "")]
    lines = [",".join(head), ",".join([""] + list("xyz") * 7)]
    lines += [f"{i}," + line for i, line in enumerate(plain(P, NAMES, timed=False).split()[1:])]
    check(read(tmp_path, "\n".join(lines) + "\n", fps=30), P, 30)


def test_times_in_milliseconds_and_units_in_the_header(tmp_path, P):
    lines = plain(P / 10, NAMES, timed=False).split()
    lines[0] = lines[0].replace("_x", " X [cm]").replace("_y", " Y [cm]").replace("_z", " Z [cm]")
    lines = ["time_ms,quality," + lines[0]] + [f"{8 * i},1,{v}" for i, v in enumerate(lines[1:])]
    take = read(tmp_path, "\n".join(lines))
    np.testing.assert_allclose(take.positions, P, atol=1e-4)
    assert take.fps == 125
    assert "1 other column(s) left out (quality)" in take.report.notes


# --- time -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [24, 29.97, 59.94, 60, 119.88, 240])
def test_the_rate_that_is_meant_comes_out_of_times(tmp_path, rng, fps):
    P = rng.normal(scale=50, size=(400, 7, 3))
    take = read(tmp_path, plain(P, NAMES, fps=fps))
    assert take.fps == pytest.approx(fps, rel=1e-9)


@pytest.mark.parametrize(
    "title, step, start, rate",
    [
        *(("timestamp", 1000 / 60, 0, "0.06"), ("time", 1, 0, "1"), ("t", 1, 1, "1")),
        *(("time", 1000 / 60, 1690000000000, "0.06"), ("time_ms", 1 / 60, 0, "6e+04")),
    ],
)
def test_times_at_the_pace_of_no_capture_are_refused(tmp_path, P, title, step, start, rate):
    head, *rows = plain(P, NAMES, timed=False).split()
    times = [start + step * i for i in range(30)]
    times = [round(t, 5) if step < 1 else round(t) for t in times]
    rows = [f"{t},{row}" for t, row in zip(times, rows, strict=True)]
    text = "\n".join([f"{title},{head}", *rows]) + "\n"
    words = rf"column {title} amounts to {re.escape(rate)}\d* frames/s.* 5 to 2000; name it time_ms"
    with pytest.raises(ValueError, match=words):
        read(tmp_path, text)
    check(read(tmp_path, text, fps=60), P, 60)


@pytest.mark.parametrize("write", [plain, trc, qualisys], ids=lambda f: f.__name__)
def test_frames_missing_in_time_keep_their_place(tmp_path, P, write):
    lines = write(P, NAMES).splitlines(keepends=True)
    text = "".join(lines[:-10] + lines[-7:])
    text = text.replace("FRAMES\t30\n", "FRAMES\t27\n").replace("60.00\t30\t7", "60.00\t27\t7")
    take = read(tmp_path, text, "take." + {plain: "csv", trc: "trc", qualisys: "tsv"}[write])
    P[20:23] = np.nan
    np.testing.assert_allclose(take.positions, P, atol=2e-5)
    assert "3 frame(s) missing in time: all markers hidden there" in take.report.notes


def test_a_gap_is_no_million_frames(tmp_path, P):
    text = plain(P, NAMES).replace("\n0.2900,", "\n999999.0000,")
    with pytest.raises(ValueError, match="frames are missing in time between 30 that are there"):
        read(tmp_path, text)


def test_a_rate_that_the_times_deny_asks_for_a_word(tmp_path, P):
    text = trc(P, NAMES).replace("60.00\t60.00\t30", "10.00\t60.00\t30")
    with pytest.raises(ValueError, match=r"header says 10 frames/s, the column of times 6"):
        read(tmp_path, text, "take.trc")
    take = read(tmp_path, text, "take.trc", fps=60)
    assert take.fps == 60
    assert "60 frames/s as said with fps=, not as in the file" in take.report.notes


def test_times_out_of_step_are_refused(tmp_path, P):
    lines = plain(P, NAMES).splitlines()
    late = [0.01 * i + 0.06 * (i > 5) + 0.004 * (i > 15) - 0.043 * (i > 25) for i in range(30)]
    rows = [f"{t},{row.split(',', 1)[1]}" for t, row in zip(late, lines[1:], strict=True)]
    text = "\n".join(lines[:1] + rows)
    with pytest.raises(ValueError, match=r"take\.csv(, line \d+)?: the time"):
        read(tmp_path, text)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cell", ["1_0", "١٢", "inf", "1e400", "0x1F", "true", "1.2.3", "--1", "1e"]
)
@pytest.mark.parametrize("write", [plain, motive, nexus, qualisys, trc], ids=lambda f: f.__name__)
def test_a_cell_that_is_no_number_is_named(tmp_path, P, write, cell):
    text = write(P, NAMES)
    lines = text.splitlines()
    mark = "\t" if write in (qualisys, trc) else ","
    row = lines[-4].split(mark)
    row[-2] = cell
    lines[-4] = mark.join(row)
    name = "take.trc" if write is trc else "take.csv"
    with pytest.raises(ValueError, match=rf"{name}, line {len(lines) - 3}, column jaw_left_5") as e:
        read(tmp_path, "\n".join(lines) + "\n", name)
    assert "is not a number" in str(e.value)


@pytest.mark.parametrize("write", [motive, nexus, qualisys, trc], ids=lambda f: f.__name__)
def test_a_row_of_another_length_is_refused_by_line(tmp_path, P, write):
    lines = write(P, NAMES).rstrip("\n").splitlines()
    mark = "\t" if write in (qualisys, trc) else ","
    lines[-4] += f"{mark}1.5"
    name = "take.trc" if write is trc else "take.csv"
    with pytest.raises(ValueError, match=rf"line {len(lines) - 3}: \d+ values, but the header"):
        read(tmp_path, "\n".join(lines) + "\n", name)


@pytest.mark.parametrize("write", [motive, qualisys, trc], ids=lambda f: f.__name__)
@pytest.mark.parametrize("change", ["short", "long"])
def test_rows_that_the_header_does_not_count_are_refused(tmp_path, P, write, change):
    text = write(P, NAMES)
    said = {motive: "Exported Frames,30", qualisys: "FRAMES\t30", trc: "60.00\t30\t7"}[write]
    assert said in text
    text = text.replace(said, said.replace("30", "29" if change == "long" else "31"))
    name = "take.trc" if write is trc else "take.csv"
    with pytest.raises(ValueError, match=r"header counts (29|31) frames, but 30 rows follow"):
        read(tmp_path, text, name)


def test_a_last_row_cut_short_goes_with_a_warning(tmp_path, P):
    text = plain(P, NAMES)
    (tmp_path / "take.csv").write_text(text[:-40])
    with pytest.warns(UserWarning, match="line 31, the last, is cut short: left out"):
        take = read_markers(tmp_path / "take.csv")
    np.testing.assert_allclose(take.positions, P[:-1], atol=2e-5)


def test_doubled_names_are_numbered_and_columns_called_alike_refused(tmp_path, P):
    names = ["chin", "chin", *NAMES[2:]]
    (tmp_path / "take.trc").write_text(trc(P, names))
    with pytest.warns(UserWarning, match="more than once were numbered: chin"):
        take = read_markers(tmp_path / "take.trc")
    assert take.names[:2] == ("chin", "chin_2")
    with pytest.raises(ValueError, match="line 1: two columns are called chin_x"):
        read(tmp_path, plain(P, names))


def test_what_is_no_table_of_markers_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no column is called like chin_x, chin_y, chin_z"):
        read(tmp_path, "a,b,c\n1,2,3\n")
    with pytest.raises(ValueError, match="only blank lines"):
        read(tmp_path, "\n\n\n")
    with pytest.raises(ValueError, match="a zero byte; this is a binary file"):
        read(tmp_path, b"chin_x,chin_y,chin_z\n1,2,\0\n")
    with pytest.raises(ValueError, match="line 2: a carriage return in the middle of the line"):
        read(tmp_path, "chin_x,chin_y,chin_z\n1,2\r,3\n4,5,6\n")
    with pytest.raises(ValueError, match="no column is called like"):
        read(tmp_path, "x" * 200_000 + ",y,z\n1,2,3\n")
    with pytest.raises(ValueError, match="not a TRC file"):
        read(tmp_path, "a,b,c\n1,2,3\n", "take.trc")
    with pytest.raises(ValueError, match="no frames below the header"):
        read(tmp_path, "a_x,a_y,a_z\n", fps=10)


def test_a_wide_header_and_many_blank_lines_take_no_memory(tmp_path):
    """Rows times columns would be 100 GB."""
    head = ",".join(f"m{i}_x,m{i}_y,m{i}_z" for i in range(20_000))
    with pytest.raises(ValueError, match="no frames below the header"):
        read(tmp_path, head + "\n" * 200_000, fps=10)
    row = ",".join(str(37 * i % 200) for i in range(60_000)) + "\n"
    assert read(tmp_path, head + "\n" + 2 * row, fps=10).positions.shape == (2, 20_000, 3)


@pytest.mark.parametrize("write", [plain, motive, nexus, qualisys, trc], ids=lambda f: f.__name__)
def test_what_a_mutant_says_does_not_contradict_itself(tmp_path, rng, P, write):
    name = "m.trc" if write is trc else "m.csv"
    found = tally(
        read_markers, write(P, NAMES).encode(), name, tmp_path, COUNT, rng, contradiction(write)
    )
    assert not found.wrong and not found.python, found
    assert found.slowest < 10


def contradiction(write):
    """What the file itself denies: counts that it states, columns that it names, its rate."""

    def contradicts(take, data, said):
        if not np.isfinite(take.positions[take.visible]).all():
            return "positions that are not finite"
        lines = data.decode("utf-8", "replace").replace("\r\n", "\n").split("\n")
        lines = lines[:-1] if not lines[-1] else lines
        numbered = [line for line in lines if line.lstrip(' "+-.')[:1].isdigit()]
        rows = [line for line in numbered if line.count("\t") + line.count(",") > 9]
        lost = sum(int(s.split()[0]) for s in take.report.notes if "missing in time" in s)
        cut = any("cut short" in s for s in said) and lines[-1] == rows[-1]
        if take.n_frames - lost + cut != len(rows):
            return f"{take.n_frames} frames out of {len(rows)} rows, {lost} lost"
        columns = max(map(len, (row.replace("\t", ",").split(",") for row in rows)))
        if 3 * take.n_markers > columns:
            return f"{take.n_markers} markers out of {columns} columns"
        return ""

    return contradicts


@pytest.mark.parametrize("write", [motive, qualisys], ids=["motive", "qualisys"])
@pytest.mark.parametrize("padded", [False, True])
def test_what_a_spreadsheet_saved_again_is_read(tmp_path, P, write, padded):
    """Semicolons and decimal commas, rows filled up to the widest."""
    text = write(P, NAMES).replace("\r\n", "\n")
    text = re.sub(r"\t|,(?! )", ";", text).replace(".", ",")
    lines = text.splitlines()
    width = max(line.count(";") for line in lines)
    lines = [line + ";" * (width - line.count(";")) * padded for line in lines]
    take = read(tmp_path, "\n".join(lines) + "\n")
    np.testing.assert_allclose(take.positions, P, atol=1e-3)
    assert (take.names, take.fps) == (tuple(NAMES), 120)


def test_markers_that_motive_has_not_labelled_are_said(tmp_path, P):
    take = read(tmp_path, motive(P, [*NAMES[:5], "Unlabeled 1001", "Unlabeled 1002"]))
    said = "2 marker(s) that Motive has not labelled (Unlabeled 1001, Unlabeled 1002)"
    assert said in take.report.notes


def test_a_second_table_of_trajectories_is_left_out_with_a_word(tmp_path, P):
    path = tmp_path / "two.csv"
    path.write_text(nexus(P, NAMES, after=nexus(P, [f"Eve:{n}" for n in NAMES])))
    with pytest.warns(UserWarning, match=r"left out, from line 37 on: Trajectories; write it to"):
        assert read_markers(path).n_markers == len(NAMES)
