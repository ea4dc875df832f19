"""Skin, texture and wireframe of a face in the viewer: other pictures of the same vertices."""

from pathlib import Path

import hand
import matplotlib.pyplot as plt
import numpy as np
import pytest

from facelab.files import read_rig
from facelab.geometry import Texture, TriangleMesh
from facelab.plotting import draw_face
from facelab.widgets import FaceView, PosingLab

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"


@pytest.fixture(scope="module")
def mesh():
    return read_rig(FIXTURES / "avatar_textured.glb", mesh="Head").neutral


def buffers(view):
    return view._face.geometry.attributes


def test_pictured_triangles_are_those_of_the_face_in_its_buffers(mesh):
    view = FaceView(mesh)
    view.look = "texture"
    (drawn,) = view._textured.children
    shared = drawn.geometry.attributes
    assert all(shared[name] is buffers(view)[name] for name in ("position", "normal", "color"))
    index = shared["index"].array.reshape(-1, 3)
    np.testing.assert_array_equal(
        shared["position"].array[index], np.float32(mesh.vertices[mesh.faces])
    )
    np.testing.assert_array_equal(shared["uv"].array[index], mesh.texture.uv)
    assert len(shared["position"].array) > mesh.n_vertices, "the seam needs doubles"


def test_the_doubles_ride_along_in_the_page_and_in_the_kernel(mesh):
    view = FaceView(mesh)
    view.look = "texture"
    posed = mesh.vertices + np.sin(mesh.vertices[:, ::-1] / 20)
    E, e = view._riders()
    view.show(posed)
    shared = view._textured.children[0].geometry.attributes
    index = shared["index"].array.reshape(-1, 3)
    np.testing.assert_allclose(shared["position"].array[index], posed[mesh.faces], atol=1e-4)
    by_page = np.vstack([posed, E @ posed + e])
    np.testing.assert_allclose(by_page[index], posed[mesh.faces], atol=1e-9)
    normals = view.normals[mesh.faces]
    np.testing.assert_allclose(shared["normal"].array[index], normals, atol=1e-6)


def test_what_the_mouse_picks_is_the_face_without_doubles_in_any_look(mesh):
    view = FaceView(mesh)
    for look in ("texture", "wireframe", "skin"):
        view.look = look
        index = buffers(view)["index"].array.reshape(-1, 3)[: len(mesh.faces)]
        np.testing.assert_array_equal(index, mesh.faces)
        assert view._hand.n_vertices == mesh.n_vertices
        assert view._hand.n_faces == len(mesh.faces)


def test_one_look_is_seen_at_a_time(mesh):
    view = FaceView(mesh)
    seen = {}
    for look in ("skin", "wireframe", "texture", "skin"):
        view.look = look
        textured = view._textured is not None and view._textured.visible
        seen[look] = view._face.visible, view._face.material.wireframe, textured
    assert seen["skin"] == (True, False, False) and seen["wireframe"] == (True, True, False)
    assert seen["texture"] == (False, False, True)


def test_triangles_without_a_picture_and_the_lining_keep_their_colours(mesh):
    uv = mesh.texture.uv.copy()
    uv[:100] = np.nan
    texture = Texture(mesh.texture.image, uv)
    view = FaceView(TriangleMesh(mesh.vertices, mesh.faces, texture=texture))
    view.look = "texture"
    pictured, plain = (
        m.geometry.attributes["index"].array.reshape(-1, 3) for m in view._textured.children
    )
    assert len(pictured) == len(mesh.faces) - 100
    np.testing.assert_array_equal(plain, mesh.faces[:100])


def test_an_unknown_look_and_a_texture_that_is_not_there_are_refused(grid):
    view = FaceView(grid)
    with pytest.raises(ValueError, match="the face has none"):
        view.look = "texture"
    with pytest.raises(ValueError, match="look"):
        view.look = "chrome"
    assert view.look == "skin"


def test_the_lab_shows_them_on_choice_and_its_face_is_pulled_as_ever(mesh):
    lab = PosingLab.open(FIXTURES / "avatar_textured.glb", n_regions=4)
    vertex = int(mesh.vertices[:, 2].argmax())
    ends = []
    for choice in ("skin", "texture", "wireframe", "regions"):
        lab.stage.paint.value = choice
        assert lab.view.look == (choice if choice != "regions" else "skin")
        lab.session.reset()
        hand.press(lab.view, vertex)
        hand.move(lab.view, [0, 3, 0])
        hand.let_go(lab.view, [0, 3, 0])
        ends.append(lab.session.vertices)
        lab.session.reset()
    assert np.abs(ends[0] - lab.session.neutral.vertices).max() > 0.1
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], atol=1e-9)


def test_the_lab_offers_no_texture_where_there_is_none():
    lab = PosingLab.open(FIXTURES / "avatar.glb", n_regions=4)
    assert "texture" not in dict(lab.stage.paint.options).values()
    assert "wireframe" in dict(lab.stage.paint.options).values()


def test_a_drawing_has_the_colours_of_the_picture(mesh):
    figure, ax = plt.subplots()
    draw_face(ax, mesh, props=(), shade=False)
    image = ax.images[0].get_array()
    left, right = image[image.shape[0] // 2, [image.shape[1] // 5, -image.shape[1] // 5]]
    plt.close(figure)
    assert left[0] > right[0] + 0.3, "the picture's right is on the person's right"


def test_a_still_part_has_the_colours_of_its_own_picture():
    rig = read_rig(FIXTURES / "avatar_textured.glb", mesh="Head")
    eye = rig.parts["EyeLeft"]
    white = np.full((2, 2, 3), 255, np.uint8)
    texture = Texture(white, np.zeros((len(eye.faces), 3, 2)))
    rig.parts["EyeLeft"] = TriangleMesh(eye.vertices, eye.faces, texture=texture)
    shown = dict(zip(rig.parts, PosingLab.open(rig, n_regions=4).props, strict=True))
    assert (shown["EyeLeft"].colors == 1).all() and (shown["Teeth"].colors < 1).all()
