import warnings

import numpy as np
import pytest
from shapes import sphere_mesh

from data_synth.template import build_template
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.geometry.texture import Texture
from facelab.geometry.winding import outwards, wound_inwards


@pytest.fixture(scope="module")
def face():
    face = build_template(n_vertices=1500)
    marks = dict(zip(MULTI_PIE, face.landmarks.tolist(), strict=True))
    return TriangleMesh(face.vertices, face.faces, marks)


def part_of(face, kind):
    x, y, _ = face.vertices[face.faces].mean(axis=1).T
    rng = np.random.default_rng(0)
    return {
        "all": np.ones(len(x), dtype=bool),
        "left half": x > 0,
        "lower face": y < -40,
        "a few": rng.random(len(x)) < 0.05,
        "half at random": rng.random(len(x)) < 0.5,
    }[kind]


def flipped(face, which):
    faces = face.faces.copy()
    faces[which] = faces[which][:, ::-1]
    return TriangleMesh(face.vertices, faces, face.landmarks)


@pytest.mark.parametrize("kind", ["all", "left half", "lower face", "a few", "half at random"])
@pytest.mark.parametrize("soup", [False, True])
def test_what_is_wound_inwards_is_turned_over_and_nothing_else(face, kind, soup):
    which = part_of(face, kind)
    wrong = flipped(face, which)
    if soup:  # loose triangles, as of an STL file
        wrong = TriangleMesh(
            wrong.vertices[wrong.faces.ravel()], np.arange(3 * len(which)).reshape(-1, 3)
        )
    np.testing.assert_array_equal(wound_inwards(wrong), which)
    with pytest.warns(UserWarning, match=r"rig: .* of its triangles|rig: all its triangles"):
        mended = outwards(wrong, "rig")
    np.testing.assert_array_equal(np.sort(mended.faces, axis=1), np.sort(wrong.faces, axis=1))
    there, right = (m.vertices[m.faces] for m in (mended, face))
    cross = [np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0]) for T in (there, right)]
    np.testing.assert_allclose(*cross, atol=1e-9)


def test_a_face_wound_outwards_stays_the_same_one_without_a_word(face):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert outwards(face) is face


def test_other_pieces_and_a_film_on_the_skin_stay_as_they_are(face):
    eye = sphere_mesh(2, 12.0)
    V = np.vstack([face.vertices, eye.vertices])
    F = np.vstack([face.faces, eye.faces[:, ::-1] + face.n_vertices])  # a hollow
    F[3] = F[3][::-1]  # one triangle of 2,826
    assert not wound_inwards(TriangleMesh(V, F, face.landmarks)).any()


def test_a_hollow_behind_the_lips_faces_into_itself(face):
    bag = sphere_mesh(2, 20.0)
    top = face.landmarks["mouth_inner_upper"]
    V = np.vstack([face.vertices, bag.vertices + face.vertices[top] - bag.vertices[0]])
    F = np.vstack([face.faces, bag.faces[:, ::-1] + face.n_vertices])  # hangs on one vertex
    assert not wound_inwards(TriangleMesh(V, F, face.landmarks)).any()
    assert wound_inwards(TriangleMesh(V, F[:, ::-1], face.landmarks)).all()


def test_the_picture_stays_on_its_triangles(face, rng):
    texture = Texture(np.zeros((2, 2, 3), np.uint8), rng.random((len(face.faces), 3, 2)))
    wrong = TriangleMesh(face.vertices, face.faces[:, ::-1], face.landmarks, texture)
    with pytest.warns(UserWarning, match="all its triangles"):
        mended = outwards(wrong)
    np.testing.assert_array_equal(mended.texture.uv, texture.uv[:, ::-1])
