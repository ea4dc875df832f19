"""Names of places: the left is the mirror of the right, and they say what is there."""

import numpy as np
import pytest
from planted import quarters
from shapes import grid_mesh

from facelab.data.actors import load_template
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.places import FacePlaces, mirrored_name
from facelab.geometry.symmetry import MIRROR


@pytest.fixture(scope="module")
def face():
    return load_template(4375)


@pytest.fixture(scope="module")
def places(face):
    return FacePlaces(face)


def mirrored(x, partners):
    return x[partners] @ MIRROR


def test_every_vertex_has_the_mirrored_name_of_its_partner_and_midline_ones_have_no_side(places):
    for v, partner in enumerate(places.partners):
        if partner >= 0:
            assert places.vertex(partner) == mirrored_name(places.vertex(v))
        if partner == v:
            assert not {"left", "right"} & set(places.vertex(v).split())


def test_a_crooked_face_has_mirrored_names_too(face, rng):
    bent = face.with_vertices(face.vertices + rng.normal(scale=0.3, size=face.vertices.shape))
    places = FacePlaces(bent)
    pairs = np.flatnonzero(places.partners >= 0)
    assert len(pairs) > 0.9 * bent.n_vertices
    for v in pairs:
        assert places.vertex(places.partners[v]) == mirrored_name(places.vertex(v))


@pytest.mark.parametrize(
    ("landmark", "name"),
    [
        ("nose_tip", "nose tip"),
        ("mouth_corner_left", "mouth corner left"),
        ("mouth_corner_right", "mouth corner right"),
        ("lip_upper", "upper lip"),
        ("chin", "chin"),
        ("brow_left_3", "brow left"),
        ("eye_right_outer", "eye corner outer right"),
        ("nostril_left_outer", "nostril left"),
    ],
)
def test_landmarks_lie_in_the_places_of_their_names(face, places, landmark, name):
    assert places.vertex(face.landmarks[landmark]) == name


def test_ten_landmarks_are_enough_and_fewer_leave_numbers(face):
    few = ("nose_tip", "chin", "mouth_corner_left", "mouth_corner_right")
    marks = {name: face.landmarks[name] for name in few}
    places = FacePlaces(TriangleMesh(face.vertices, face.faces, marks))
    assert places.vertex(face.landmarks["brow_left_3"]) == "brow left"
    none = FacePlaces(TriangleMesh(face.vertices, face.faces, {"chin": marks["chin"]}))
    assert none.vertex(marks["chin"]) == "chin" and none.vertex(17) == "vertex 17"


def cut(face, partners, pieces):
    """A symmetric cut of the face in bands from side to side, some of them halved."""
    band = np.digitize(face.vertices[:, 1], np.quantile(face.vertices[:, 1], pieces))
    side = (face.vertices[:, 0] > 0).astype(int)
    own = partners == np.arange(face.n_vertices)
    halved = (band % 2 == 0) & ~own
    return np.unique(np.where(halved, 2 * band + side, 2 * band), return_inverse=True)[1]


@pytest.mark.parametrize("pieces", [(0.3, 0.6), (0.2, 0.4, 0.6, 0.8)])
def test_mirrored_regions_have_mirrored_names_and_each_name_is_there_once(face, places, pieces):
    labels = cut(face, places.partners, pieces)
    names = places.regions(labels)
    assert len(set(names)) == len(names) == labels.max() + 1
    p = np.flatnonzero(places.partners >= 0)
    for i, name in enumerate(names):
        facing = np.bincount(labels[places.partners[p[labels[p] == i]]]).argmax()
        if facing != i:
            assert names[facing] == mirrored_name(name) != name
        else:
            assert not {"left", "right"} & set(name.split())


def test_names_do_not_depend_on_the_numbers_of_the_regions(face, places, rng):
    labels = cut(face, places.partners, (0.3, 0.6))
    order = rng.permutation(labels.max() + 1)
    names, others = places.regions(labels), places.regions(order[labels])
    assert [others[order[i]] for i in range(len(names))] == names


def test_regions_are_called_after_what_they_cover(face, places):
    marks = face.landmarks
    middles = ("mouth_corner_left", "mouth_corner_right", "brow_left_3", "brow_right_3", "nose_tip")
    at = face.vertices[[marks[name] for name in middles]]
    labels = np.linalg.norm(face.vertices[:, None] - at, axis=2).argmin(axis=1)
    names = places.regions(labels)
    assert names[2:] == ["brow left", "brow right", "nose"]
    assert names[1] == mirrored_name(names[0])


def test_without_landmarks_regions_still_tell_left_from_right():
    mesh, labels = quarters()  # 0 and 2 on the person's right
    names = FacePlaces(mesh).regions(labels)
    assert names == ["region right 2", "region left 2", "region right 1", "region left 1"]
    assert FacePlaces(mesh).motion(np.ones((mesh.n_vertices, 3))) == ""
    alone = grid_mesh(4, 4)
    assert FacePlaces(alone).regions(np.zeros(16, dtype=int)) == ["region"]


def push(face, *moves):
    """A soft push of landmarks: displacements (n_vertices, 3)."""
    x = np.zeros_like(face.vertices)
    for name, by in moves:
        away = np.linalg.norm(face.vertices - face.vertices[face.landmarks[name]], axis=1)
        x += np.exp(-((away / 8) ** 2))[:, None] * by
    return x


@pytest.mark.parametrize(
    ("moves", "said"),
    [
        ([("chin", (0, -9, 0))], "jaw open"),
        ([("mouth_corner_left", (1, 6, 0))], "mouth corner left up"),
        ([("mouth_corner_left", (5, 1, 0))], "mouth corner left out"),
        ([("mouth_corner_left", (0, 5, 0)), ("mouth_corner_right", (0, 5, 0))], "mouth corners up"),
        (
            [("mouth_corner_left", (-5, 0, 0)), ("mouth_corner_right", (5, 0, 0))],
            "mouth corners in",
        ),
        (
            [("mouth_corner_left", (5, 0, 0)), ("mouth_corner_right", (5, 0, 0))],
            "mouth corners to the left",
        ),
        ([("nose_tip", (0, 0, 3))], "nose tip forward"),
    ],
)
def test_a_motion_is_called_after_what_moves_most_and_where_it_goes(face, places, moves, said):
    x = push(face, *moves)
    assert places.motion(x) == said
    assert places.motion(mirrored(x, places.partners)) == mirrored_name(said)
    assert places.motion(0 * x) == ""


@pytest.mark.parametrize(
    ("mark", "by", "said", "literal"),
    [
        ("chin", (0, -9, 0), "jaw open", "chin down"),
        ("chin", (0, 9, 0), "jaw shut", "chin up"),
        ("eye_left_upper_inner", (0, -9, 0), "eye left closed", "eyelid upper left down"),
    ],
)
def test_a_motion_is_called_in_a_phrase_or_literally(face, places, mark, by, said, literal):
    x = push(face, (mark, by))
    assert places.motion(x) == said and places.motion(x, literal=True) == literal
