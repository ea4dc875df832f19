"""Eyes, teeth and tongue: they fit the face, follow it, and are shown and written with it."""

import numpy as np
import pytest
from shapes import grid_mesh

from data_synth.action_units import actor_rig
from data_synth.actors import ACTORS
from data_synth.template import build_template
from facelab.data import load_template, synthetic_props
from facelab.files import write_glb
from facelab.geometry.jaw import Jaw
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.looks import face_props, followed, lids_off
from facelab.looks.eyes import turned
from facelab.looks.gaze import FULL, Gaze
from facelab.rig import BlendshapeRig
from facelab.widgets import FaceView
from facelab.widgets.props import PropMeshes


@pytest.fixture(scope="module", params=sorted(ACTORS))
def actor(request):
    return build_template(ACTORS[request.param].anatomy)


def by_name(props):
    return {prop.name: prop for prop in props}


def test_an_eye_found_from_the_lids_is_the_one_that_the_face_was_built_around(actor):
    props = by_name(synthetic_props(actor))
    for side, (centre, radius) in actor.eyeballs.items():
        spoke = props[f"eye_{side}"].mesh.vertices - centre
        seen = spoke[:, 2] > 0.5 * radius
        assert np.abs(np.linalg.norm(spoke[seen], axis=1) - radius).max() < 0.75  # mm


def test_no_skin_lies_inside_an_eye_and_no_lip_behind_the_front_teeth(actor):
    props = by_name(synthetic_props(actor))
    for side in ("left", "right"):
        V = props[f"eye_{side}"].mesh.vertices
        front = V[:, 2].argmax()
        radius = np.linalg.norm(V - V[front], axis=1).max() / 2  # it ends behind the equator
        centre = V[front] - [0, 0, radius]
        assert np.linalg.norm(actor.vertices - centre, axis=1).min() > 0.98 * radius
    teeth = props["teeth_upper"].mesh.vertices
    middle = np.abs(teeth[:, 0]) < 6
    near = np.abs(actor.vertices - teeth[middle].mean(axis=0))
    lips = actor.vertices[(near[:, 0] < 6) & (near[:, 1] < 6) & (near[:, 2] < 15)]
    assert lips[:, 2].min() > teeth[middle, 2].max()


def test_lower_teeth_go_with_a_jaw_that_turns_and_upper_teeth_stay():
    face = load_template(4375)
    props = by_name(face_props(face))
    chin = face.landmarks["chin"]
    lower = props["teeth_lower"]
    joint = Jaw(face.vertices, chin, [0, -12, -64])
    turn = np.radians(12.0)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    opened = (face.vertices - joint.joint) @ R.T + joint.joint
    motion = joint.motion(opened)
    np.testing.assert_allclose(motion.apply(face.vertices), opened, atol=1e-9)
    moved = followed(lower, opened) - lower.mesh.vertices
    assert moved[:, 1].max() < -5  # mm down
    size = np.linalg.norm(np.diff(followed(lower, opened), axis=0), axis=1)
    rigid = np.linalg.norm(np.diff(lower.mesh.vertices, axis=0), axis=1)
    np.testing.assert_allclose(size, rigid, atol=1e-9)
    upper = props["teeth_upper"]
    assert followed(upper, opened) is upper.mesh.vertices


def test_eyes_turn_as_the_look_shapes_of_the_rig_say(rng):
    face = load_template(4375)
    n = face.n_vertices
    D = rng.normal(scale=0.5, size=(4, n, 3))
    rig = BlendshapeRig(face, ["EyeLookUp_L", "eyeLookOutLeft", "eyeLookOutRight", "blink"], D)
    centre = by_name(face_props(face))["eye_left"].mesh.vertices.mean(axis=0)
    yaw, pitch = Gaze(rig, centre, "left").angles(rig.shape([0.5, 0.25, 1, 1]))
    assert yaw == pytest.approx(0.25 * FULL, rel=0.02)  # the ridge holds back a little
    assert pitch == pytest.approx(0.5 * FULL, rel=0.02)
    yaw, _ = Gaze(rig, centre, "right").angles(rig.shape([0, 0, 0.5, 0]))
    assert yaw < 0  # outwards is to the person's right
    eye = by_name(face_props(face, rig))["eye_left"]
    ahead = followed(eye, rig.shape([0, 1, 0, 0]))[0] - eye.mesh.vertices[0]
    assert ahead[0] > 4  # mm: the pupil goes to the person's left
    assert by_name(face_props(face))["eye_left"].move is None


def test_an_eye_turns_to_the_left_and_up():
    ahead = np.array([[0.0, 0, 1]])
    np.testing.assert_allclose(turned(ahead, np.pi / 2, 0), [[1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(turned(ahead, 0, np.pi / 2), [[0, 1, 0]], atol=1e-12)


def test_nothing_is_made_for_a_mesh_that_does_not_tell_where():
    assert face_props(grid_mesh(6, 5)) == []
    face = load_template(4375)
    marks = {name: v for name, v in face.landmarks.items() if name != "chin"}
    assert face_props(TriangleMesh(face.vertices, face.faces, marks)) == []
    lying = face.with_vertices(face.vertices[:, [0, 2, 1]] * [1, 1, -1])
    assert face_props(lying) == []
    V = np.vstack([face.vertices, face.vertices / 8])  # a part of its own
    two = TriangleMesh(V, np.vstack([face.faces, face.faces + face.n_vertices]), face.landmarks)
    assert face_props(two) == []


def test_parts_in_the_page_follow_the_face_and_still_ones_are_not_sent_again():
    rig = actor_rig("M1").linear()
    props = face_props(rig.neutral)
    shown = PropMeshes([*props, (props[0].mesh, props[0].colors)])
    sent = []
    for mesh in shown.meshes:
        position = mesh.geometry.attributes["position"]
        position.observe(lambda change, m=mesh: sent.append(shown.meshes.index(m)), names=["array"])
    shown.follow(rig.neutral.vertices)
    assert sent == []
    shown.follow(rig.shape({"AU27": 1}))
    assert {3, 4} <= set(sent) <= {2, 3, 4}  # lower teeth and tongue; no eye


def test_parts_are_written_as_meshes_of_their_own_with_the_same_targets(tmp_path):
    import pygltflib

    rig = actor_rig("M1").linear()
    names = ["AU27", "AU12L"]
    deltas = np.stack([rig.shape({n: 1}) - rig.neutral.vertices for n in names])
    props = face_props(rig.neutral)
    way = dict(times=[0.0, 1.0], weights=[[0, 0], [1, 0]])
    write_glb(tmp_path / "face.glb", rig.neutral, deltas, names, **way, props=props)
    file = pygltflib.GLTF2().load(tmp_path / "face.glb")
    assert [mesh.name for mesh in file.meshes] == ["face", *(prop.name for prop in props)]
    told = {mesh.name: (mesh.extras or {}).get("targetNames") for mesh in file.meshes}
    assert told["teeth_lower"] == told["face"] == names and told["teeth_upper"] is None
    moving = [channel.target.node for channel in file.animations[0].channels]
    assert [file.nodes[node].name for node in moving] == ["face", "teeth_lower", "tongue"]
    for prop in props:
        mesh = next(m for m in file.meshes if m.name == prop.name)
        assert file.accessors[mesh.primitives[0].attributes.COLOR_0].count == prop.mesh.n_vertices
    assert MULTI_PIE  # the face of the file is the face alone
    assert file.accessors[file.meshes[0].primitives[0].attributes.POSITION].count == 8820


def test_lids_that_would_cut_an_eye_are_held_off_it_and_nothing_else_moves():
    rig = actor_rig("M1").linear()
    props = face_props(rig.neutral)
    assert lids_off(props, rig.neutral.vertices) is rig.neutral.vertices
    eye = by_name(props)["eye_left"].mesh.vertices
    centre = eye[eye[:, 2].argmax()] - [0, 0, np.linalg.norm(eye - eye[0], axis=1).max() / 2]
    near = np.linalg.norm(rig.neutral.vertices - centre, axis=1) < 20
    pressed = rig.neutral.vertices - np.where(near[:, None], [0, 0, 2.0], 0)
    shown = lids_off(props, pressed)
    moved = np.linalg.norm(shown - pressed, axis=1) > 0
    assert 20 < moved.sum() < near.sum() and not moved[~near].any()
    front = near & (pressed[:, 2] > centre[2] + 5)
    radius = np.linalg.norm(eye[0] - centre)
    away = [np.linalg.norm(V[front] - centre, axis=1).min() for V in (pressed, shown)]
    assert away[0] < radius < away[1]


def test_the_page_shows_lids_off_the_eyes_unless_told_not_to():
    rig = actor_rig("M1").linear()
    view = FaceView(rig.neutral, face_props(rig.neutral))
    pressed = rig.neutral.vertices - [0, 0, 2.0]
    view.show(pressed)
    assert np.abs(view.vertices - pressed).max() > 0.5  # mm
    view.lids_off = False
    view.show(pressed)
    assert (view.vertices == pressed).all()
