import os

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from shapes import sphere_mesh

from data_synth.action_units import actor_rig
from facelab.data.aura import load_aura
from facelab.expression import guess_landmarks
from facelab.geometry.mesh import TriangleMesh
from facelab.registration import fit_scan
from facelab.rig import BlendshapeRig


@pytest.fixture(scope="module")
def actor():
    return actor_rig("F1", 4375).linear()


def off(rig, found):
    V, marks = rig.neutral.vertices, rig.neutral.landmarks
    return {n: float(np.linalg.norm(V[v] - V[marks[n]])) for n, v in found.items()}


def test_ten_landmarks_of_an_actor_are_near_where_they_are(actor):
    found = off(actor, guess_landmarks(actor))
    assert len(found) == 10 and max(found.values()) < 9  # millimetres
    assert max(found[n] for n in ("nose_tip", "lip_upper", "lip_lower")) < 3


def test_left_and_right_are_the_persons(actor):
    found, x = guess_landmarks(actor), actor.neutral.vertices[:, 0]
    for name, v in found.items():
        assert (x[v] > 0) == ("left" in name) or not ("left" in name or "right" in name), name


def test_the_size_of_the_shapes_and_still_pieces_do_not_matter(actor):
    eye = sphere_mesh(3, 12.0)
    V = np.vstack([actor.neutral.vertices, eye.vertices])
    F = np.vstack([actor.neutral.faces, eye.faces + actor.neutral.n_vertices])
    deltas = np.concatenate([0.7 * actor.deltas, np.zeros((40, eye.n_vertices, 3))], axis=1)
    both = BlendshapeRig(TriangleMesh(V, F), actor.names, deltas)
    assert guess_landmarks(both) == guess_landmarks(actor)


@pytest.mark.parametrize(
    "turned, words",
    [
        ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], "upwards is .* it must be y"),
        ([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], "from the right eye to the left is .* it must be x"),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, -1]], "from the right eye to the left is .* it must be x"),
        ([[-1, 0, 0], [0, -1, 0], [0, 0, 1]], "it must be"),
    ],
    ids=["z up", "to the side", "away", "upside down"],
)
def test_a_head_in_another_frame_is_refused_with_how_it_stands(actor, turned, words):
    R = np.array(turned).T
    mesh = TriangleMesh(actor.neutral.vertices @ R, actor.neutral.faces)
    with pytest.raises(ValueError, match=words):
        guess_landmarks(BlendshapeRig(mesh, actor.names, actor.deltas @ R))


@pytest.mark.parametrize("turn", [(-30, 0, 0), (35, 0, 0), (0, 40, 0), (0, 0, -35), (20, -25, 15)])
def test_a_head_tilted_or_turned_is_guessed_as_one_held_straight(actor, turn):
    R = Rotation.from_euler("xyz", turn, degrees=True).as_matrix().T
    mesh = TriangleMesh(actor.neutral.vertices @ R, actor.neutral.faces)
    rig = BlendshapeRig(mesh, actor.names, actor.deltas @ R)
    there, right = (actor.neutral.vertices[list(guess_landmarks(r).values())] for r in (rig, actor))
    # what lies beside the middle has a twin on the other side
    np.testing.assert_allclose(np.abs(there), np.abs(right), atol=1e-6)


@pytest.mark.parametrize("kind", ["all", "left half", "lower face", "a tenth"])
def test_triangles_wound_inwards_are_turned_over_for_it_with_a_word(actor, kind):
    mesh = actor.neutral
    x, y, _ = mesh.vertices[mesh.faces].mean(axis=1).T
    chance = np.random.default_rng(1).random(len(x))
    which = {"all": x < np.inf, "left half": x > 0, "lower face": y < -20, "a tenth": chance < 0.1}
    faces = np.where(which[kind][:, None], mesh.faces[:, ::-1], mesh.faces)
    wrong = BlendshapeRig(TriangleMesh(mesh.vertices, faces), actor.names, actor.deltas)
    with pytest.warns(UserWarning, match="rig: .* wound inwards"):
        found = guess_landmarks(wrong)
    assert found == guess_landmarks(actor)


@pytest.mark.real
def test_on_the_generic_face_they_are_within_four_millimetres(real_rig):
    assert max(off(real_rig, guess_landmarks(real_rig)).values()) < 4


@pytest.mark.real
def test_a_fit_from_guesses_on_both_faces_is_as_close_as_from_the_known(real_rig):
    if not os.environ.get("FACELAB_AURA"):
        pytest.skip("FACELAB_AURA is not set: no files of Aura on this machine")
    aura = load_aura()
    guesses = guess_landmarks(aura)
    assert max(off(aura, guesses).values()) < 2.5
    template, scan = (
        TriangleMesh(r.neutral.vertices, r.neutral.faces, guess_landmarks(r))
        for r in (real_rig, aura)
    )
    assert fit_scan(template, scan, preset="close").rms < 0.5


def test_what_the_shapes_do_not_tell_is_refused(actor):
    with pytest.raises(ValueError, match=r"a smile on the left \(mouthSmileLeft\).*renamed"):
        guess_landmarks(actor.renamed({"AU12L": "grin"}))
    with pytest.raises(TypeError, match="rig is a TriangleMesh"):
        guess_landmarks(actor.neutral)
    lying = actor.neutral.with_vertices(actor.neutral.vertices[:, [1, 2, 0]])
    with pytest.raises(ValueError, match="turn it into the head frame"):
        guess_landmarks(BlendshapeRig(lying, actor.names, actor.deltas[..., [1, 2, 0]]))
