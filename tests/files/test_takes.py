import gzip
import io
import json
import re
import warnings
import zipfile

import numpy as np
import pytest
from mutants import COUNT, tally
from recordings import PASCAL, code, live_link, values

from facelab.files.takes import read_weights, write_weights_csv
from facelab.motion import WeightSequence
from facelab.names import ANGLES, ARKIT

W = values(6, 3)
NAMES = ["AU35", "my unit; left", "ü"]


@pytest.fixture
def read(tmp_path):
    """Read text, bytes or, as JSON, anything else, without a word unless one is expected."""

    def read(content, name="w.csv", **options):
        path = tmp_path / name
        if not isinstance(content, (str, bytes)):
            content = json.dumps(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_weights(path, **options)

    return read


def table(header, rows, sep=",", end="\n"):
    return end.join([sep.join(header), *(sep.join(map(str, row)) for row in rows)]) + end


def some_take(rng, names=NAMES, n_frames=9, fps=29.97, lost=(0, 4), **more):
    weights = rng.uniform(size=(n_frames, len(names)))
    valid = np.ones(n_frames, dtype=bool)
    valid[list(lost)] = False
    weights[~valid] = np.nan
    return WeightSequence(weights, names, fps, valid, **more)


# --- our own table --------------------------------------------------------------------------------


def test_angles_of_our_own_table_are_radians_without_a_word(tmp_path, rng, recwarn):
    angles = {"HeadYaw": np.linspace(0, 2.5, 9), "HeadRoll": np.arange(9) / 10}
    write_weights_csv(tmp_path / "w.csv", some_take(rng, lost=(), angles=angles))
    found = read_weights(tmp_path / "w.csv").angles
    assert not len(recwarn)
    np.testing.assert_array_equal(found["HeadYaw"], angles["HeadYaw"])


@pytest.mark.parametrize(
    "names",
    [
        NAMES,
        ["one"],
        ['say "a", b', "tab\tinside", "#1", "JawOpen", "jawOpen", "time", "fps2"],
        [f"{n}_x" for n in ARKIT],
        [*PASCAL],
        ["1", "2"],
    ],
    ids=len,
)
def test_a_table_comes_back_exactly_with_its_own_names(tmp_path, rng, names):
    given = some_take(rng, names)
    given.weights[1, 0] = 1e-17
    given.weights[2, 0] = -999.25
    write_weights_csv(tmp_path / "w.csv", given)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_weights(tmp_path / "w.csv")
    assert (read.names, read.fps) == (given.names, given.fps)
    np.testing.assert_array_equal(read.valid, given.valid)
    np.testing.assert_array_equal(read.weights, given.weights)


def test_angles_come_along(tmp_path, rng):
    given = some_take(rng)
    angles = {n: np.where(given.valid, rng.uniform(-3, 3, size=9), np.nan) for n in ANGLES[1:3]}
    given = WeightSequence(given.weights, NAMES, 30, given.valid, angles)
    write_weights_csv(tmp_path / "w.csv", given)
    read = read_weights(tmp_path / "w.csv")
    assert read.names == given.names
    for name, angle in angles.items():
        np.testing.assert_array_equal(read.angles[name], angle)


def test_what_the_table_cannot_hold_is_refused_and_leaves_no_file(tmp_path, rng):
    for given, words in (
        (some_take(rng, gaps={5: 9.0}), r"lacks 9 s before frame 5.*take\[:5\]"),
        (some_take(rng, lost=range(9)), "no valid frame"),
        (some_take(rng, n_frames=0, lost=()), "no valid frame"),
        (some_take(rng, ["two\nlines"]), r"names that the table cannot hold: 'two\\nlines'"),
        (some_take(rng, [" a", "", "HeadYaw"]), "cannot hold: ' a', '', 'HeadYaw'"),
        (some_take(rng, lost=(), angles={"turn": np.zeros(9)}), "cannot hold: 'turn'"),
        (some_take(rng, lost=(), angles={"HeadYaw": np.full(9, 7.0)}), "9 values that no weight"),
        (WeightSequence([[2e3]], ["a"], 30), "1 values that no weight"),
    ):
        with pytest.raises(ValueError, match=words):
            write_weights_csv(tmp_path / "w.csv", given)
    assert not list(tmp_path.iterdir())
    with pytest.warns(UserWarning, match="not written: Happy"):
        write_weights_csv(tmp_path / "w.csv", some_take(rng, others={"Happy": np.zeros(9)}))


@pytest.mark.parametrize(
    "text, complaint",
    [
        ("AU1,AU2\n0,1\n", r"w\.csv: nothing in it tells the time; .*fps=30"),
        ("frame,fps,AU1\n", "no frames below the header, line 1"),
        ("frame,fps\n0,30\n", "no column of weights"),
        ("frame,fps,AU1\n0,30.0,0.5\n2,30.0,0.5\n", "line 3: here should be frame 1, not 2"),
        ("frame,fps,AU1\n\n0,30.0,0.5\n\n2,30.0,0.5\n", "line 5: here should be frame 1"),
        ("frame,fps,AU1\n0,30.0,0.5\n1,60.0,0.5\n", "line 3: here should be 30.0 frames a sec"),
        ("frame,fps,AU1\n0,30.0,0.5,1\n", "line 2: 4 values, but the header names 3"),
        ("frame,fps,AU1\n0,30.0,half\n1,30.0,1\n", "line 2, column AU1: 'half' is no number"),
        ("frame,fps,AU1\n0\n1,30.0,1\n", "line 2: 1 values, but the header names 3"),
        ("frame,fps,AU1\n0,abc,0.5\n", r"w\.csv, line 2, column fps: 'abc' is no number"),
        ("frame,fps,AU1\n0,-1,0.5\n", "line 2: a rate of -1 frames a second"),
        ("frame,fps,AU1\n0.5,30,0.5\n", "line 2, column frame: '0.5' is no whole number"),
        ("frame,fps,AU1,AU2\n0,30.0,nan,1\n", "line 2, column AU1: 'nan' is no number"),
        ("frame,fps,AU1,AU2\n0,30.0,,1\n", "line 2, column AU1: the cell is empty"),
        ("frame,fps,AU1,AU2\n0,30.0,1e308,1\n", "line 2, column AU1: .*beyond any weight"),
        ("frame,fps,AU1,AU2\n0,30.0,1e999,1\n", "line 2, column AU1: NaN, infinity"),
        ("frame,fps,AU1,AU2\n0,3_0.0,1,1\n", "line 2, column fps: '3_0.0' is no number"),
        ("frame,fps,AU1,AU1\n0,30.0,1,1\n", "line 1: columns that name the same: AU1 and AU1"),
        ("frame,fps,,AU1\n0,30.0,1,1\n", "line 1: column 3 has no name"),
    ],
)
def test_a_damaged_table_is_refused_with_its_place(read, text, complaint):
    with pytest.raises(ValueError, match=complaint):
        read(text)


# --- other tables ---------------------------------------------------------------------------------


@pytest.mark.parametrize("sep", [",", ";", "\t"])
def test_a_table_without_time_needs_its_rate(read, sep):
    text = table(["a", "b", "c"], W, sep)
    with pytest.raises(ValueError, match="nothing in it tells the time; give the rate"):
        read(text)
    take = read(text, fps=25)
    assert (take.names, take.fps) == (("a", "b", "c"), 25)
    np.testing.assert_array_equal(take.weights, W)


@pytest.mark.parametrize(
    "name, times",
    [
        ("time", [f"{i / 30:.4f}" for i in range(6)]),
        ("Timestamp", [f"{1.6e9 + i / 30:.4f}" for i in range(6)]),
        ("timestamp_ms", [f"{1000 * i / 30:.1f}" for i in range(6)]),
        ("Time (Seconds)", [f"{i / 30:.4f}" for i in range(6)]),
        ("timeCode", [code(i) for i in range(26, 32)]),
        ("t", [f"00:00:{i / 30:06.3f}" for i in range(6)]),
    ],
)
def test_time_is_known_by_its_name(read, name, times):
    take = read(table([name, "a", "b", "c"], [[t, *w] for t, w in zip(times, W, strict=True)]))
    assert (take.names, take.fps, take.n_frames) == (("a", "b", "c"), 30, 6)
    np.testing.assert_array_equal(take.weights, W)
    # a rate that is given goes before
    assert read(table([name, "a"], zip(times, W[:, 0], strict=True)), fps=24).fps == 24


def test_a_weight_beyond_all_is_named_with_its_value_beside_angles_in_degrees(read):
    rows = [[f"{i / 30:.4f}", 45 + i, 5 if i == 3 else 0.1] for i in range(9)]
    with pytest.raises(ValueError, match="line 5, column a: 5 is no weight of 0 to 1"):
        read(table(["time", "HeadYaw", "a"], rows))


def test_a_row_missing_in_time_is_a_lost_frame(read):
    take = read(table(["time", "a"], [[f"{i / 50:.3f}", 0.5] for i in (0, 1, 2, 5, 6, 7)]))
    np.testing.assert_array_equal(take.valid, [1, 1, 1, 0, 0, 1, 1, 1])


@pytest.mark.parametrize("name", ["frame", "Frame_ID", "index", ""])
def test_frame_numbers_place_the_rows(read, name):
    take = read(table([name, "a"], [[i, 0.5] for i in (7, 8, 11)]), fps=30)
    np.testing.assert_array_equal(take.valid, [1, 1, 0, 0, 1])
    take = read(table([name, "a"], [[i, 0.5] for i in (0, 2, 4, 6)]), fps=30)
    assert take.n_frames == 4  # every second frame of a video is every frame of the take
    with pytest.warns(UserWarning, match="time is missing at 1 place"):
        take = read(table([name, "a"], [[i, 0.5] for i in (0, 1, 2, 400)]), fps=30)
    assert take.gaps == {3: pytest.approx(397 / 30)}
    with pytest.raises(ValueError, match=r"line 3: frame 4 follows frame 4; put the rows in order"):
        read(table([name, "a"], [[4, 0.5], [4, 0.5]]), fps=30)


def test_empty_rows_are_lost_frames(read):
    for empty in ("", "nan", "NaN", "null"):
        rows = [[0, *W[0]], [1, empty, empty, empty], [2, *W[2]]]
        take = read(table(["frame", "a", "b", "c"], rows), fps=30)
        np.testing.assert_array_equal(take.valid, [True, False, True])


def test_a_last_row_without_its_line_end_is_said(read):
    text = table(["frame", "fps", "a"], [[0, 30.0, 0.5], [1, 30.0, 0.25]])
    with pytest.warns(UserWarning, match="last row, line 3, has no line end: .* may be cut"):
        np.testing.assert_array_equal(read(text[:-1]).weights[:, 0], [0.5, 0.25])
    with pytest.warns(UserWarning, match="last row, line 3, is cut short and left out"):
        assert read(text[:-6]).n_frames == 1


def test_a_table_of_live_link_is_known_by_its_header(read):
    text = live_link([code(i) for i in range(35)], rows=[*values(34, 61).tolist(), None])
    take = read(text)
    assert (take.names, take.fps, take.n_frames) == (ARKIT, 30, 35)
    assert not take.valid[-1]


def test_arkits_names_among_others_are_read_and_the_others_kept_apart(read):
    header = ["", "timeCode", *(f"blendShapes.{n}" for n in PASCAL), "emotion_values.joy"]
    rows = [[i, f"{i / 30:.6f}", *w] for i, w in enumerate(values(40, 53))]
    with pytest.warns(UserWarning, match="kept apart in others: emotion_values.joy"):
        take = read(table(header, rows))
    assert (take.names, take.fps) == (ARKIT, 30)
    np.testing.assert_array_equal(take.others["emotion_values.joy"], values(40, 53)[:, 52])


def test_a_rig_of_its_own_keeps_its_own_names(read):
    names = [n.replace("Left", "_L").replace("Right", "_R") for n in ARKIT] + ["browInnerUp_L"]
    assert read(table(names, values(4, 53)), fps=30).names == tuple(names)


def test_columns_can_be_chosen(read):
    header = ["frame", "timestamp", "success", "pose_Tx", "AU01_r", "AU02_r", "mood"]
    rows = [[i, i / 30, 1, 480.5, 1.5, 3.25, "happy"] for i in range(9)]
    with pytest.warns(UserWarning, match="text are left out: mood"):
        take = read(table(header, rows), names=["AU02_r", "AU01_r"], scale=0.2)
    assert take.names == ("AU02", "AU01")  # an intensity; the r is no side
    np.testing.assert_allclose(take.weights[0], [0.65, 0.3])
    assert set(take.others) == {"success", "pose_Tx"}
    with pytest.raises(ValueError, match="line 1: no column AU99; there are frame, timestamp"):
        read(table(header, rows), names=["AU99"])
    with pytest.raises(TypeError, match="names='AU01_r' is one str"):
        read(table(header, rows), names="AU01_r")


def test_intensities_of_openface_are_weights_from_0_to_1_of_both_sides(read):
    header = ["frame", "face_id", "timestamp", "success", "pose_Tx", "AU01_r", "AU12_r", "AU12_c"]
    rows = [[i + 1, 0, i / 30, i != 4, 480.5, 1.5, 0.1 * i, 1] for i in range(9)]
    rows = [[int(v) if isinstance(v, bool) else v for v in row] for row in rows]
    with pytest.warns(UserWarning, match=r"from 0 to 5, are read with scale=0\.2"):
        take = read(table(header, rows))
    assert take.names == ("AU01", "AU12") and take.fps == 30
    np.testing.assert_allclose(take.weights[take.valid, 1], [0.02 * i for i in range(9) if i != 4])
    assert take.valid.tolist() == [i != 4 for i in range(9)]  # no success, no face
    assert set(take.others) == {"face_id", "success", "pose_Tx", "AU12_c"}
    np.testing.assert_allclose(read(table(header, rows), scale=0.1).weights[0, 0], 0.15)


def test_many_columns_kept_apart_are_not_all_told(read):
    header = ["time", "AU12_r", *(f"x_{k}" for k in range(700))]
    rows = [[i / 30, 1, *[0] * 700] for i in range(9)]
    with pytest.warns(UserWarning, match=r"x_11, \.\.\. \(700\)\.$"):
        read(table(header, rows))


def test_a_column_of_words_is_refused_with_what_to_give(read):
    header = ["frame", "AU1", "took"]
    rows = [[i, 0.5, "00:01"] for i in range(9)]
    with pytest.raises(ValueError, match=r"column took: '00:01' is no number; .* names=\["):
        read(table(header, rows), fps=30)
    assert read(table(header, rows), fps=30, names=["AU1"]).names == ("AU1",)


def test_times_with_a_date_are_clock_times(read):
    rows = [[f"2026-05-01T23:59:59.{i * 4:02d}0+02:00", 0.5] for i in range(20)]
    rows += [[f"2026-05-02 00:00:00.{(i * 4 - 80) % 100:02d}0Z", 0.5] for i in range(45, 60)]
    assert read(table(["timestamp", "AU1"], rows)).fps == 25


def test_whole_numbers_for_times_are_refused_with_what_to_do(read):
    rows = [[1_700_000_000_000 + 40 * i, 0.5] for i in range(9)]
    with pytest.raises(ValueError, match=r"count rows or whole seconds.*timestamp_ms.*fps=30"):
        read(table(["timestamp", "AU1"], rows))
    assert read(table(["timestamp_ms", "AU1"], rows)).fps == 25


@pytest.mark.parametrize(
    ("start", "words"),
    [(gzip.compress(b"a,b"), "packed with gzip; unpack"), (b"PK\3\4...", "a spreadsheet or a zip")],
    ids=["gzip", "zip"],
)
def test_packed_tables_are_refused_with_what_to_do(tmp_path, start, words):
    (tmp_path / "w.csv").write_bytes(start)
    with pytest.raises(ValueError, match=words):
        read_weights(tmp_path / "w.csv")


def test_percent_is_noticed_unless_it_is_said(read):
    text = table(["a", "b", "c"], 100 * W)
    with pytest.raises(ValueError, match=r"w.csv, line 2, column a: .*scale=0.01"):
        read(text, fps=30)
    np.testing.assert_allclose(read(text, fps=30, scale=0.01).weights, W)
    np.testing.assert_allclose(read(text, fps=30, scale=1).weights, 100 * W)


# --- JSON -----------------------------------------------------------------------------------------


def categories(row, names):
    """A frame as MediaPipe tells it."""
    scores = [{"index": 0, "score": 0.0, "categoryName": "_neutral"}]
    return scores + [{"score": w, "categoryName": n} for n, w in zip(names, row, strict=True)]


@pytest.mark.parametrize("form", ["bare", "python", "script", "flat", "inner", "lines"])
def test_categories_of_mediapipe_are_weights(tmp_path, form):
    W = np.random.default_rng(0).uniform(0, 1, (9, 52)).round(4)
    faces = [[categories(row, ARKIT)] for row in W.tolist()]
    faces[0] = faces[5] = []  # no face was seen
    frames = {
        "bare": [face and face[0] for face in faces],
        "python": [{"timestamp_ms": 40 * i, "face_blendshapes": f} for i, f in enumerate(faces)],
        "script": [
            {"time": i / 25, "faceBlendshapes": [{"categories": c, "headIndex": -1} for c in face]}
            for i, face in enumerate(faces)
        ],
    }
    frames["flat"] = [
        {"timestampMs": 40 * i, "categories": face[0] if face else []}
        for i, face in enumerate(faces)
    ]
    frames["inner"] = [[frame] for frame in frames["flat"]]
    frames["lines"] = frames["python"]
    path = tmp_path / ("w.jsonl" if form == "lines" else "w.json")
    lines = "\n".join(map(json.dumps, frames["lines"]))
    path.write_text(lines if form == "lines" else json.dumps(frames[form]))
    with pytest.warns(UserWarning, match="kept apart in others: _neutral"):
        take = read_weights(path, fps=25 if form == "bare" else None)
    assert (take.names, take.fps) == (ARKIT, 25)
    assert np.flatnonzero(~take.valid).tolist() == [0, 5]
    np.testing.assert_allclose(take.weights[take.valid], W[take.valid])


def test_a_line_of_json_that_is_damaged_is_named(tmp_path):
    lines = [json.dumps({"time": i / 25, "a": 0.5}) for i in range(9)]
    for k, change in ((4, lambda s: s.replace(":", ";")), (8, lambda s: s[:-6])):
        text = "\n".join(change(line) if i == k else line for i, line in enumerate(lines))
        (tmp_path / "w.jsonl").write_text(text)
        with pytest.raises(ValueError, match=rf"w\.jsonl, line {k + 1}, column \d+: no JSON from"):
            read_weights(tmp_path / "w.jsonl")


def test_two_faces_in_a_frame_are_refused(tmp_path):
    faces = [[categories([0.5] * 52, ARKIT)] * 2] * 3
    (tmp_path / "w.json").write_text(json.dumps([{"face_blendshapes": f} for f in faces]))
    with pytest.raises(ValueError, match=r"frame 0 holds 2 lists or tables, as of 2 faces, but"):
        read_weights(tmp_path / "w.json", fps=30)
    (tmp_path / "w.json").write_text(json.dumps([{"categories": [*f[0], *f[1]]} for f in faces]))
    with pytest.raises(ValueError, match=r"frame 0 has 106 weights of 53 names, as of several"):
        read_weights(tmp_path / "w.json", fps=30)
    beside = {"names": ["a", "b"], "frames": [{"time": 0.1, "weights": [[1, 0], [0, 1]]}]}
    (tmp_path / "w.json").write_text(json.dumps(beside))
    with pytest.raises(ValueError, match=r"frame 0 holds 2 lists or tables, as of 2 faces, but"):
        read_weights(tmp_path / "w.json")


ROWS = W.tolist()
FRAMES = [dict(zip("abc", row, strict=True)) for row in ROWS]
TIMED = [{"time": i / 30, **row} for i, row in enumerate(FRAMES)]


@pytest.mark.parametrize(
    "content",
    [
        {"fps": 30, "names": ["a", "b", "c"], "weights": ROWS},
        {
            "exportFps": 30.0,
            "numPoses": 3,
            "numFrames": 6,
            "facsNames": ["a", "b", "c"],
            "weightMat": ROWS,
        },
        {
            "names": ["a", "b", "c"],
            "metadata": {"fps": 30.0, "frame_count": 6},
            "frames": [{"weights": row, "time": i / 30} for i, row in enumerate(ROWS)],
        },
        {"frame_rate": 30, "frames": [{"blendshapes": row} for row in FRAMES]},
        TIMED,
        [{"timestamp": i / 30, "blendShapes": row} for i, row in enumerate(FRAMES)],
        {"fps": 30, **{n: W[:, k].tolist() for k, n in enumerate("abc")}},
        {"time": [i / 30 for i in range(6)], **{n: W[:, k].tolist() for k, n in enumerate("abc")}},
    ],
    ids=lambda content: " ".join(content) if isinstance(content, dict) else "frames",
)
def test_json_of_every_form_is_read(read, content):
    take = read(content, "w.json")
    assert (take.names, take.fps, take.n_frames) == (("a", "b", "c"), 30, 6)
    np.testing.assert_array_equal(take.weights, W)


def test_lost_frames_of_json_are_null_or_empty(read):
    content = {"fps": 30, "names": ["a", "b", "c"], "weights": [ROWS[0], None, [], [None] * 3]}
    np.testing.assert_array_equal(read(content, "w.json").valid, [True, False, False, False])


def test_arkits_names_are_told_from_others_in_json_too(read):
    rows = [dict(zip(["_neutral", *ARKIT], w, strict=True)) for w in values(5, 53).tolist()]
    with pytest.warns(UserWarning, match="kept apart in others: _neutral"):
        assert read(rows, "w.json", fps=30).names == ARKIT


GOOD = {"fps": 30, "names": ["a", "b", "c"], "weights": ROWS}


@pytest.mark.parametrize(
    "content, words",
    [
        ({**GOOD, "weights": [["0.25", 0.1, 0.2]]}, r"frame 0, a: '0.25' \(str\) is no number"),
        ({**GOOD, "weights": [[True, 0.1, 0.2]]}, r"frame 0, a: 'True' \(bool\) is no number"),
        ({**GOOD, "weights": [*ROWS, [0.1, None, 0.2]]}, "frame 6, column b: NaN, infinity or not"),
        ({**GOOD, "weights": [*ROWS, [0.1, 0.2]]}, "frame 6 has 2 weights for 3 names"),
        ({**GOOD, "weights": [ROWS[0], "x"]}, "lists of different length|no weights found"),
        ({**GOOD, "fps": "30"}, r"frames a second: '30' \(str\) is no number"),
        ({**GOOD, "fps": True}, "frames a second: 'True'"),
        ({**GOOD, "fps": -30}, "-30 frames a second"),
        ({**GOOD, "numFrames": 7}, "says numframes=7, but holds 6"),
        ({"names": ["a", "a", "b"], "weights": ROWS, "fps": 30}, "name the same: a and a"),
        ({"fps": 30, "weights": ROWS}, "weights without names"),
        ({"names": ["a", "b", "c"], "weights": ROWS}, "nothing in it tells the time"),
        ([*TIMED, {"time": 0.2, "a": 1, "b": 1}], "frame 6 has not the names of the first: c"),
        ({"fps": 30, "a": [0.1], "b": [0.1, 0.2]}, "lists of different length: a 1, b 2"),
        ({"version": 2}, "no weights found in it"),
        (3, "neither names nor frames on top"),
        ([], "no frames with weights in it"),
        ([[0.1, 0.2]], "weights without names"),
        ("{", "line 1, column 2: no JSON from here on"),
        ('{"fps": NaN}', "NaN is no number"),
        ('{"fps": 30, "fps": 30}', "fps stand more than once"),
        ('{"fps": 30, "a": [1e999]}', r"a, frame 0: 'inf' \(float\) is no number"),
        ('{"fps": 30, "a": [' + "9" * 6000 + "]}", r"a, frame 0: 'inf' \(float\) is no number"),
        ("[" * 100_000, "no JSON text"),
        (b'{"fps": 30, "a\xff": [1]}', "no JSON text"),
    ],
)
def test_json_that_says_something_else_is_refused_in_words(read, content, words):
    with pytest.raises(ValueError, match=r"w\.json.*" + f"(?:{words})"):
        read(content, "w.json")


# --- npz ------------------------------------------------------------------------------------------


def npz(**arrays):
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


@pytest.mark.parametrize(
    "arrays",
    [
        {"names": ["a", "b", "c"], "weights": W, "fps": 30.0},
        {"names": ["a", "b", "c"], "weights": np.asfortranarray(W), "times": np.arange(6) / 30},
        {"time": np.arange(6) / 30, "a": W[:, 0], "b": W[:, 1], "c": W[:, 2]},
    ],
)
def test_npz_is_read_in_every_form(read, arrays):
    take = read(npz(**arrays), "w.npz")
    assert (take.names, take.fps, take.n_frames) == (("a", "b", "c"), 30, 6)
    np.testing.assert_array_equal(take.weights, W)


def test_lost_frames_of_npz_are_not_valid(read):
    take = read(npz(names=["a", "b", "c"], weights=W, fps=30, valid=np.arange(6) != 2), "w.npz")
    np.testing.assert_array_equal(np.flatnonzero(~take.valid), [2])
    assert np.isnan(take.weights[2]).all()


def hollow(shape, size=64, descr="<f8"):
    """An npz whose array says it is larger than it is."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            head, {"descr": descr, "fortran_order": False, "shape": shape}
        )
        archive.writestr("weights.npy", head.getvalue() + bytes(size))
        names = io.BytesIO()
        np.save(names, np.array(["a"]))
        archive.writestr("names.npy", names.getvalue())
    return out.getvalue()


@pytest.mark.parametrize(
    "content, words",
    [
        (b"hello", "not a readable npz file of weights .it is no whole zip"),
        (npz(names=["a", "b", "c"], weights=W)[:-30], "not a readable npz file of weights"),
        (hollow((10**6, 10**6)), "weights.*is not as large as its header says"),
        (npz(weights=W, fps=30), "weights without names"),
        (
            npz(names=["a", "b"], weights=W, fps=30),
            r"weights has shape \(6, 3\), but shape \(n_frames, 2\)",
        ),
        (npz(names=["a", "b", "c"], weights=W), "nothing in it tells the time"),
        (npz(names=["a", "b", "c"], weights=W, fps=0), "fps is 0, but must be one rate above 0"),
        (npz(names=["a", "b", "c"], weights=W, fps=np.nan), "fps is nan"),
        (npz(names=["a", "b", "c"], weights=W > 0.5, fps=30), "weights is of type bool"),
        (npz(names=["a", "b", "c"], weights=W.astype(str), fps=30), "weights is of type <U"),
        (npz(names=[b"a", b"b", b"c"], weights=W, fps=30), "names.*is no plain array"),
        (npz(names=["a"], weights=W[:, :1], fps=30, valid=[True]), r"valid has shape \(1,\)"),
        (npz(a=W, fps=30), "neither names and weights, nor a track"),
        (npz(names=["a", "b", "c"], weights=np.where(W > 0.8, np.nan, W), fps=30), "NaN"),
        (npz(names=["a", "b", "c"], weights=W * 100, fps=30), "scale=0.01"),
    ],
)
def test_npz_that_says_something_else_is_refused_in_words(read, content, words):
    with pytest.raises(ValueError, match=r"w\.npz.*" + words):
        read(content, "w.npz")


def test_an_array_that_nobody_asked_for_is_not_unpacked(read):
    """A hundred kilobytes that hold a hundred megabytes of zeros beside the weights."""
    import tracemalloc

    content = npz(names=["a", "b", "c"], weights=W, fps=30, other=np.zeros((100, 1000, 1000), "i1"))
    tracemalloc.start()
    with pytest.warns(UserWarning, match="left out: other"):
        read(content, "w.npz")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


# --- broken files ---------------------------------------------------------------------------------


def contradicts(take, data, said):
    """What in a take its table denies, read by a second road: lines and commas, nothing else."""
    lines = [line.split(",") for line in data.decode().split("\n") if line.strip()]
    header, rows = lines[0], lines[1:]
    if any("cut short" in words for words in said):
        rows = rows[:-1]
    if take.n_frames != len(rows) or take.report.rows != len(rows):
        return f"{take.n_frames} frames, but the file has {len(rows)} rows"
    if [*take.names, *take.angles] != [re.sub('^"(.*)"$', r"\1", h.strip()) for h in header[2:]]:
        return "other names"
    if [int(row[0]) for row in rows] != list(range(len(rows))):
        return "rows out of order"
    if {float(row[1]) for row in rows} != {take.fps}:
        return "another rate"
    number = re.compile(r" *[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)? *", re.ASCII)
    for row, weights, valid in zip(rows, take.weights, take.valid, strict=True):
        cells = [c.strip('"') for c in row[2 : 2 + len(take.names)]]
        if valid != any(c.strip() not in ("", "nan", "NaN", "null") for c in cells):
            return "a row with weights lost, or without them kept"
        if valid and not all(number.fullmatch(c) for c in cells):
            return f"cells that are no numbers: {cells}"
        if valid and [float(c) for c in cells] != weights.tolist():
            return "other values"
    if not data.endswith(b"\n") and not any("line end" in w or "cut short" in w for w in said):
        return "the end is missing, and nothing was said"
    return "" if np.abs(take.weights[take.valid]).max() <= 1000 else "weights that are none"


def test_broken_tables_are_refused_in_words_or_read_as_they_are(tmp_path, rng):
    write_weights_csv(tmp_path / "good.csv", some_take(rng, ["AU1", "AU12L", "jawOpen"], 15))
    good = (tmp_path / "good.csv").read_bytes()
    rng = np.random.default_rng(5)
    found = tally(read_weights, good, "w.csv", tmp_path, COUNT, rng, contradicts)
    assert not found.wrong and not found.python, found
    assert found.counts["refused"] > COUNT / 2


def said_by(data):
    """Names and rows of weights as a JSON or npz file has them, read in the plainest way."""
    if data[:2] == b"PK":
        stored = np.load(io.BytesIO(data))
        return [str(name) for name in stored["names"]], stored["weights"].tolist()
    told = json.loads(data.decode("utf-8-sig"))
    if isinstance(told, dict):
        told = {key.lower(): value for key, value in told.items()}
        return told["names"], told["weights"]
    names = [name for name in told[0] if name != "time"]
    return names, [[frame.get(name) for name in names] for frame in told]


def denied(take, data, said):
    """What the file itself denies: names, values, the number of rows."""
    seen = take.weights[take.valid]
    if not np.isfinite(seen).all() or np.abs(seen).max() > 2 or take.n_frames > 2 * len(data):
        return "weights or frames that are none"
    names, rows = said_by(data)
    if list(take.names) != names:
        return f"names {take.names} in place of {names}"
    rows = [row for row in rows if row and not any(v is None or v != v for v in row)]
    if not said and len(rows) != len(seen):
        return f"{len(seen)} frames with weights in place of {len(rows)}"
    return "" if said or seen.tolist() == rows else "other values"


@pytest.mark.parametrize("form", ["frames", "matrix", "npz"])
def test_broken_json_and_npz_are_refused_in_words_or_hold_weights(tmp_path, form):
    content = {"frames": TIMED, "matrix": {**GOOD, "numFrames": 6}}.get(form)
    data = json.dumps(content).encode() if content else npz(names=["a", "b", "c"], weights=W, fps=9)
    name = "w.npz" if form == "npz" else "w.json"
    rng = np.random.default_rng(5)
    found = tally(read_weights, data, name, tmp_path, COUNT, rng, denied)
    assert not found.wrong and not found.python, found
