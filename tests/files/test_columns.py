import json
import re

import pytest

from facelab.files.takes import read_weights


@pytest.fixture
def read(tmp_path):
    """Read a table of text, or JSON of a column for each name."""

    def read(content, name="w.csv", **options):
        path = tmp_path / name
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
        return read_weights(path, **options)

    return read


def columns(*names):
    """A column for each name, its own values each."""
    return {name: [0.1 + 0.01 * k, 0.2 + 0.01 * k] for k, name in enumerate(names)}


def text(table, sep=","):
    rows = zip(*table.values(), strict=True)
    return "".join(sep.join(map(str, row)) + "\n" for row in [table, *rows])


@pytest.mark.parametrize(
    "name",
    [
        *("confidence", "Success", "quality", "face_confidence", "trackingQuality", "score"),
        *("head_rx", "head_tz", "headRotX", "Head Position Y", "rot_x", "TX", "head:rotation.x"),
        *("yaw", "neckYaw", "gaze_x", "pose_Rx", "jaw_rotX", "posX", "HeadRotation"),
    ],
)
@pytest.mark.parametrize("form", ["csv", "json"])
def test_what_is_no_weight_by_its_name_is_kept_apart_with_a_word(read, name, form):
    table = columns("smile_L", "mouthRoll", name)
    with pytest.warns(UserWarning, match=f"no weights, kept apart in others: {name}"):
        take = read(text(table) if form == "csv" else table, f"w.{form}", fps=30)
    assert take.names == ("smile_L", "mouthRoll")
    assert take.others[name].tolist() == table[name]


@pytest.mark.parametrize("name", ["time", "Time (ms)", "timestamp_us", "elapsed", "index"])
def test_a_second_column_of_times_or_frames_is_no_weight(read, name):
    table = {
        "frame": [0, 1],
        "timecode": ["00:00:01:00", "00:00:01:01"],
        **columns("smile_L", name),
    }
    with pytest.warns(UserWarning, match=f"kept apart in others: {re.escape(name)}"):
        take = read(text(table))
    assert take.names == ("smile_L",) and take.others[name].tolist() == table[name]


@pytest.mark.parametrize("name", ["elapsed", "Time Elapsed", "elapsed_seconds"])
def test_what_has_passed_is_a_time(read, name):
    assert read(text({name: [0.0, 0.04, 0.08], "smile_L": [0.1, 0.2, 0.3]})).fps == 25


@pytest.mark.parametrize(
    "name", ["CTRL_C_jaw.ty", "CTRL_expressions_jawOpen", "CNT_JAW.translateX", "jawOpen_score"]
)
def test_controls_of_a_rig_are_weights_whatever_they_are_called(read, name):
    assert read(text(columns("smile_L", name)), fps=30).names == ("smile_L", name)


def test_angles_of_live_link_are_angles_in_any_table(read):
    take = read(text(columns("smile_L", "head_yaw")), fps=30)
    assert take.names == ("smile_L",)
    assert take.angles["HeadYaw"].tolist() == columns("", "head_yaw")["head_yaw"]


def test_angles_behind_a_prefix_are_none_of_the_weights(read):
    names = [f"face_{n}" for n in ("jawOpen", "mouthClose", "eyeBlinkLeft", "HeadYaw")]
    take = read(text(columns(*names)), fps=30)
    assert take.names == tuple(names[:3])
    assert list(take.angles) == ["HeadYaw"]


def test_a_column_that_is_chosen_is_a_weight_whatever_its_name(read):
    with pytest.raises(ValueError, match=r"no column of weights; .* head_rx, quality. If .*names="):
        read(text(columns("head_rx", "quality")), fps=30)
    with pytest.warns(UserWarning, match="kept apart in others: quality"):
        assert read(text(columns("head_rx", "quality")), fps=30, names=["head_rx"]).names == (
            "head_rx",
        )


# --- JSON -----------------------------------------------------------------------------------------

NAMES, ROWS = ["jawOpen", "smile_L"], [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]
MATRIX = {"exportFps": 30, "facsNames": NAMES, "weightMat": ROWS}


def test_several_sets_of_weights_are_refused_by_name(read):
    sets = {
        "face": {"names": NAMES, "weights": ROWS},
        "body": {"names": ["arm", "leg"], "weights": ROWS},
    }
    with pytest.raises(ValueError, match=r"face, body each hold weights, .* a file of its own"):
        read({"fps": 30, **sets}, "w.json")
    assert read({"fps": 30, "about": {"by": "me"}, "face": sets["face"]}, "w.json").names == (
        "jawOpen",
        "smile_L",
    )


def test_what_stands_beside_a_matrix_for_each_frame_is_said(read):
    with pytest.warns(UserWarning, match="as long as the frames and left out: emotions, rotations"):
        take = read(MATRIX | {"emotions": [[1], [2], [3]], "rotations": [[0, 0]] * 3}, "w.json")
    assert take.weights.tolist() == ROWS


def test_times_beside_a_matrix_tell_the_rate(read):
    timed = {"names": NAMES, "weights": 2 * ROWS, "times": [0, 0.04, 0.08, 0.16, 0.2, 0.24]}
    take = read(timed, "w.json")
    assert (take.fps, take.valid.tolist()) == (25, [True] * 3 + [False] + [True] * 3)
    with pytest.raises(ValueError, match="2 times of 6 frames"):
        read(timed | {"times": [0, 1]}, "w.json")
    with pytest.raises(ValueError, match=r"states 30 frames/s, but its times run at 25; .* fps=30"):
        read(MATRIX | {"times": [0, 0.04, 0.08]}, "w.json")


def test_a_rate_that_no_face_is_recorded_with_is_refused_unless_it_is_given(read):
    with pytest.raises(ValueError, match=r"states 0\.0333 frames/s, .* fps=0\.0333"):
        read(MATRIX | {"exportFps": 0.0333}, "w.json")
    assert read(MATRIX | {"exportFps": 0.0333}, "w.json", fps=30).fps == 30


# --- numbers --------------------------------------------------------------------------------------


def test_bytes_and_signs_of_percent_are_refused_with_the_scale_to_give(read):
    with pytest.raises(ValueError, match=r"up to 255; .* scale=1/255"):
        read("jawOpen,smile_L\n12,0\n255,128\n", fps=30)
    for cell in ("12.5%", "12,5 %"):
        with pytest.raises(
            ValueError, match=rf"'{cell}' is no number; take the signs % off .*0\.01"
        ):
            read(f"jawOpen;smile_L\n{cell};0\n", fps=30)


def test_names_that_say_percent_are_read_so_with_a_word(read):
    table = "time,jawOpen (%),smile_L [%]\n0,0.5,1\n.04,1.5,2\n.08,1,0\n"
    with pytest.warns(UserWarning, match=r"its names say percent: read with scale=0\.01"):
        assert read(table).weights[1].tolist() == [0.015, 0.02]
    assert read(table, scale=1).weights[1].tolist() == [1.5, 2]


def test_a_column_missing_among_thousands_is_named_in_a_line(read):
    with pytest.raises(ValueError, match=r"no column x; there are u0, .* and 2988 more\.$"):
        read(",".join(f"u{k}" for k in range(3000)) + "\n", fps=30, names=["x"])


def test_decimals_without_a_zero_in_front_are_numbers_and_times(read):
    assert read("time,jawOpen\n0,.1\n.04,.2\n.08,.3\n").fps == 25
