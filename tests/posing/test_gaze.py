"""Eyes turned by hand: by the rig's look shapes, else as part of the pose."""

import json

import numpy as np
import pytest
from planted import corner_regions

from facelab.data import load_template
from facelab.files.gltf import write_clip_glb, write_glb
from facelab.files.poses import load_clip, load_pose, save_clip, save_pose
from facelab.files.rigs import read_rig
from facelab.looks import face_props, followed, turn_eyes
from facelab.looks.gaze import look_units, look_weights
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.posing.clips import Clip, interpolate, interpolate_gaze
from facelab.posing.log import replay
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig

LOOKS = [f"eyeLook{way}{side}" for way in ("Up", "Down", "In", "Out") for side in ("Left", "Right")]


def region_model():
    X = np.random.default_rng(1).normal(size=(50, 126))
    return RegionModel(corner_regions(), 5).fit(X)


@pytest.fixture
def session():
    model = region_model()
    return PosingSession(model, model.regions.mesh)


def rig_of(names):
    mesh = corner_regions().mesh
    D = np.random.default_rng(2).normal(size=(len(names), mesh.n_vertices, 3))
    return BlendshapeRig(mesh, names, D)


@pytest.fixture
def rigged():
    rig = rig_of(["jawOpen", *LOOKS])
    return PosingSession(rig, rig.neutral)


def test_a_gaze_is_a_step_of_the_session_and_moves_no_skin(session):
    V = session.vertices
    session.look(10, -5)
    assert session.state.gaze == (10, -5) and session.gaze.tolist() == [10, -5]
    np.testing.assert_array_equal(session.vertices, V)
    session.keep()
    session.pull(3, V[3] + 1)
    assert session.state.gaze == (10, -5)
    session.mirror()
    assert session.state.gaze == (-10, -5)
    session.reset()
    assert session.state.gaze == (0, 0)
    session.history.go(0)
    assert session.state.gaze == (0, 0)
    session.redo()
    assert session.state.gaze == (10, -5)


@pytest.mark.parametrize("gaze", [(28, 0), (0, -27.1), (np.nan, 0)])
def test_a_gaze_beyond_any_eye_is_refused(session, gaze):
    with pytest.raises(ValueError, match="gaze"):
        session.look(*gaze)
    with pytest.raises(ValueError, match="gaze"):
        session.apply(np.zeros(20), gaze)
    assert not session.can_undo


def test_a_stroke_of_a_gaze_slider_is_one_step_and_is_replayed(session):
    for degrees in (1, 5, 9):
        with session.group("look left"):
            session.look(degrees, 0)
    assert session.n_undo == 1 and len(session.log) == 1
    again = replay(
        json.loads(json.dumps(session.log)), PosingSession(session.model, session.neutral)
    )
    assert again.state.gaze == (9, 0)


def test_a_pose_file_keeps_the_gaze_and_one_from_before_looks_ahead(session, tmp_path):
    path = tmp_path / "pose.json"
    save_pose(path, session)
    assert "gaze" not in json.loads(path.read_text())["state"], "older versions read it, too"
    session.look(10, -5)
    save_pose(tmp_path / "looking.json", session)
    load_pose(path, session)
    assert session.state.gaze == (0, 0)
    load_pose(tmp_path / "looking.json", session)
    assert session.state.gaze == (10, -5)
    stored = json.loads((tmp_path / "looking.json").read_text())
    stored["state"]["gaze"] = [10, 90]
    path.write_text(json.dumps(stored))
    with pytest.raises(ValueError, match="gaze up=90"):
        load_pose(path, session)


def test_a_clip_turns_the_eyes_between_its_keys_in_its_file_too(session, tmp_path):
    a = session.state
    session.look(20, 10)
    b = session.state
    clip = Clip.of([(0, a), (2, b)], "linear").with_key(4, a)
    np.testing.assert_allclose(clip.gaze_at(1), [10, 5])
    np.testing.assert_allclose(clip.moved_key(1, 3).without_key(0).gaze_at(3), [20, 10])
    np.testing.assert_allclose(clip.with_easing("smooth").gaze_at(0.5), [20 * 0.15625, 1.5625])
    np.testing.assert_allclose(interpolate_gaze(a, b, 0.25), [5, 2.5])
    save_clip(tmp_path / "clip.json", clip, session)
    np.testing.assert_array_equal(load_clip(tmp_path / "clip.json", session).gaze, clip.gaze)
    with pytest.raises(ValueError, match="gaze of key 1"):
        Clip([0.0], [interpolate(a, b, 0)], gaze=[[40, 0]])


def test_with_a_rig_a_gaze_is_the_weights_of_its_look_shapes(rigged):
    rigged.look(13.5, -6.75)
    weights = dict(zip(rigged.model.names, rigged.coefficients, strict=True))
    wanted = {"eyeLookOutLeft": 0.5, "eyeLookInRight": 0.5}
    wanted |= {"eyeLookDownLeft": 0.25, "eyeLookDownRight": 0.25}
    assert weights == pytest.approx({name: wanted.get(name, 0) for name in weights}, abs=1e-9)
    assert rigged.state.gaze == (0, 0)
    np.testing.assert_allclose(rigged.gaze, [13.5, -6.75], atol=1e-6)
    rigged.look(-27, 0)
    np.testing.assert_allclose(rigged.gaze, [-27, 0], atol=1e-6)
    assert rigged.n_undo == 2
    rigged.undo()
    np.testing.assert_allclose(rigged.gaze, [13.5, -6.75], atol=1e-6)


def test_pins_and_other_units_of_a_rig_stay_while_the_eyes_turn(rigged):
    rigged.slide(0, 0, 0.4)
    V = rigged.vertices
    rigged.pull(7, V[7] + [0, 0.3, 0])
    rigged.look(10, 0)
    assert list(rigged.pins) == [7]
    assert rigged.gaze[0] == pytest.approx(10, abs=1.5)  # as far as the pin lets it


def test_a_rig_without_look_shapes_keeps_the_gaze_in_the_pose():
    rig = rig_of(["jawOpen", "smile"])
    session = PosingSession(rig, rig.neutral)
    session.look(5, 0)
    assert session.state.gaze == (5, 0) and not session.coefficients.any()


def test_shapes_that_turn_an_eye_alike_share_the_gaze():
    turns = look_units(["eyeLookUpLeft", "eyeLookUpRight", "eyesLookUp", "eyesLookRight"])
    units, weights = look_weights(turns, (0, 13.5))
    assert units.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(weights, [0.25, 0.25, 0.25, 0])
    np.testing.assert_allclose(27 * (weights @ turns[0]), [0, 13.5])


def test_both_eyes_turn_by_the_degrees_that_are_asked_for():
    face = load_template(4375)
    props = face_props(face)
    turned = turn_eyes(props, (20, 10))
    for before, after in zip(props[:2], turned[:2], strict=True):
        rest, V = before.mesh.vertices, followed(after, face.vertices)
        # all rings of the ball lie about its axis
        axes = [np.cross(*(X[[12, 24]] - X[0])) for X in (rest[-48:], V[-48:])]
        axes = [a / np.linalg.norm(a) for a in axes]
        yaw, pitch = np.radians(20), np.radians(10)
        wanted = [np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)]
        np.testing.assert_allclose(np.abs(axes[0]), [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(np.sign(axes[1][2]) * axes[1], wanted, atol=1e-9)
    assert turned[2:] == props[2:]
    assert turn_eyes(props, (0, 0)) == props


def parts_in(path):
    """Vertices of each mesh of a GLB with their displacements at weight 1, by name, mm."""
    import pygltflib

    file = pygltflib.GLTF2().load(path)
    data = file.binary_blob()

    def read(index):
        at = file.accessors[index]
        out = np.zeros((at.count, 3))
        if at.sparse is None:
            start = file.bufferViews[at.bufferView].byteOffset
            return 1e3 * np.frombuffer(data, "<f4", 3 * at.count, start).reshape(-1, 3)
        n = at.sparse.count
        where, what = (
            file.bufferViews[x.bufferView].byteOffset for x in (at.sparse.indices, at.sparse.values)
        )
        values = np.frombuffer(data, "<f4", 3 * n, what).reshape(-1, 3)
        out[np.frombuffer(data, "<u4", n, where)] = values
        return 1e3 * out

    return {
        mesh.name: (
            read(mesh.primitives[0].attributes.POSITION),
            [read(target["POSITION"]) for target in mesh.primitives[0].targets or []],
        )
        for mesh in file.meshes
    }


def test_eyes_look_in_a_glb_of_a_pose_and_of_a_clip_as_in_the_session(tmp_path, rng):
    face = load_template(4375)
    model = HolisticModel(2).fit(rng.normal(size=(5, 3 * face.n_vertices)))
    session, props = PosingSession(model, face), face_props(face)
    ahead = session.state
    session.look(20, -5)
    eye = followed(turn_eyes(props, (20, -5))[0], face.vertices)
    write_glb(tmp_path / "pose.glb", face, props=turn_eyes(props, session.state.gaze))
    np.testing.assert_allclose(parts_in(tmp_path / "pose.glb")["eye_left"][0], eye, atol=1e-4)
    clip = Clip.of([(0, ahead), (1, session.state)])
    write_clip_glb(tmp_path / "clip.glb", clip, session, props)
    rest, targets = parts_in(tmp_path / "clip.glb")["eye_left"]
    np.testing.assert_allclose(rest + targets[1], eye, atol=1e-4)
    np.testing.assert_allclose(targets[0], 0, atol=1e-4)
    assert read_rig(tmp_path / "clip.glb").names == ("key 1", "key 2")
