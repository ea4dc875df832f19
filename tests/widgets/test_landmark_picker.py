"""Landmarks by clicking."""

import io
import json
from datetime import datetime

import matplotlib.image
import numpy as np
import pytest

import facelab
from facelab.geometry.mesh import TriangleMesh
from facelab.widgets.landmark_picker import SIX, LandmarkPicker


@pytest.fixture(scope="module")
def face():
    return facelab.load_template(4375)


@pytest.fixture
def picker(face, tmp_path):
    return LandmarkPicker(TriangleMesh(face.vertices, face.faces), folder=tmp_path)


def click(picker, vertex):
    picker.view.on_press(vertex)


def test_six_clicks_set_the_six_one_after_the_other(picker, face):
    for name in SIX:
        assert picker.wanted == name
        click(picker, face.landmarks[name])
    assert picker.landmarks == {name: face.landmarks[name] for name in SIX}
    assert picker.mesh.landmarks == picker.landmarks
    assert "agree with a face" in picker._verdict.value
    again = facelab.fit_scan(face, picker.mesh)
    assert again.rms < 0.1


def test_a_click_on_a_name_sets_that_one_anew_and_undo_brings_the_old_one_back(picker, face):
    for name in SIX:
        click(picker, face.landmarks[name])
    picker._react("choose", "nose_tip")
    click(picker, 7)
    assert picker.landmarks["nose_tip"] == 7
    picker.undo.click()
    assert picker.landmarks["nose_tip"] == face.landmarks["nose_tip"]
    picker._react("remove", "chin")
    assert "chin" not in picker.landmarks and picker.wanted == "chin"
    picker.undo.click()
    assert "chin" in picker.landmarks


def test_exchanged_sides_and_single_ones_far_off_are_said(picker, face):
    other = {"left": "right", "right": "left"}
    for name in SIX:
        side = next((s for s in other if s in name), None)
        click(picker, face.landmarks[name.replace(side, other[side]) if side else name])
    assert "Left and right are exchanged" in picker.verdict()
    for name in SIX:
        picker.set(name, face.landmarks[name])
    picker.set("nose_tip", face.landmarks["eye_left_outer"])
    assert "nose tip lies" in picker.verdict()


def test_what_is_set_is_saved_beside_the_notebook(picker, face, tmp_path):
    for name in SIX:
        click(picker, face.landmarks[name])
    picker.name.value = "mine"
    picker.save.click()
    stored = json.loads((tmp_path / "mine.ljson").read_text())["groups"]["PTS"]
    assert [entry["label"] for entry in stored["labels"]] == list(SIX)
    points = np.array(stored["landmarks"]["points"])
    np.testing.assert_array_equal(points, face.vertices[[face.landmarks[n] for n in SIX]])
    assert "mine.ljson" in picker._result.value and "again" not in picker._result.value
    picker.save.click()
    assert "again, over the one before" in picker._result.value
    picker.name.value = "../x"
    picker.save.click()
    assert "leads out of the folder" in picker._message.value


def test_its_still_picture_has_a_dot_where_a_landmark_is_set(picker, face):
    def yellow():
        image = matplotlib.image.imread(io.BytesIO(picker.picture()))[..., :3]
        return np.argwhere((image[..., 0] > 0.7) & (image[..., 2] < 0.2))

    assert not len(yellow())
    picker.set("nose_tip", face.landmarks["nose_tip"])
    at = yellow()
    assert len(at) > 10 and np.ptp(at, axis=0).max() < 12, "one dot"
    picker.set("chin", face.landmarks["chin"])
    assert np.ptp(yellow(), axis=0)[0] > 40, "one more, below"


def test_a_rig_is_shown_with_eyes_by_its_own_shapes():
    rig = facelab.load_example().rig
    assert [prop.name for prop in LandmarkPicker(rig)._props][:2] == ["eye_left", "eye_right"]


def test_landmarks_that_the_mesh_has_are_there_at_the_start(face):
    picker = LandmarkPicker(face, names=("nose_tip", "chin"))
    assert picker.landmarks == {n: face.landmarks[n] for n in ("nose_tip", "chin")}


def test_names_that_are_no_landmarks_are_refused(face):
    with pytest.raises(ValueError, match="names: 'ear'; give names of"):
        LandmarkPicker(face, names=("ear",))
    with pytest.raises(TypeError, match="mesh is a str"):
        LandmarkPicker("face")


def test_a_rig_has_what_is_missing_guessed_in_one_step_and_what_is_set_stays(face, tmp_path):
    rig = facelab.load_example().rig
    bare = facelab.BlendshapeRig(
        TriangleMesh(rig.neutral.vertices, rig.neutral.faces), rig.names, rig.deltas
    )
    picker = LandmarkPicker(bare, folder=tmp_path)
    mine = rig.neutral.landmarks["chin"]
    picker.set("chin", mine)
    picker.guess.click()
    assert set(picker.landmarks) == set(SIX) and picker.landmarks["chin"] == mine
    V, known = rig.neutral.vertices, rig.neutral.landmarks
    for name, v in picker.landmarks.items():
        assert np.linalg.norm(V[v] - V[known[name]]) < 10, name
    picker.undo.click()
    assert picker.landmarks == {"chin": mine}
    assert LandmarkPicker(face).guess.disabled


def test_landmarks_of_a_file_are_opened(picker, face):
    content = json.dumps({name: face.landmarks[name] for name in SIX}).encode()
    file = {"name": "mine.json", "content": content, "type": "", "size": len(content)}
    picker.upload.set_trait("value", ({**file, "last_modified": datetime.now()},))
    assert picker._message.value == ""
    assert picker.landmarks == {name: face.landmarks[name] for name in SIX}
