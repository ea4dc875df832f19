"""Closed lips show no teeth, closed lids no eye: counted in pictures, pixel by pixel."""

import io
from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest

from data_synth.action_units import actor_rig
from facelab.geometry.mesh import TriangleMesh
from facelab.looks import face_props, followed, shown
from facelab.looks.gap import Gap
from facelab.widgets import FaceView
from facelab.widgets.thumbnail import Thumbnails

SIZES = (240, 276), (320, 368), (640, 736)
CLOSED = {
    "rest": (), "smile": ("AU12L", "AU12R"), "frown": ("AU15",), "pucker": ("AU18",),
    "press": ("AU24",), "tight": ("AU23",), "suck": ("AU28",),
}  # fmt: skip


@pytest.fixture(scope="module", params=("F1", "M1"))
def rig(request):
    return actor_rig(request.param).linear()


def posed(rig, units):
    return rig.shape(dict.fromkeys(units, 1.0))


def undimmed(props):
    """The parts as bright everywhere as they are made."""
    return [replace(prop, gap=None) for prop in props]


def white(rig, props, vertices, size):
    """Number of pixels of teeth between the lips: bright and with little colour."""
    drawn = Thumbnails(rig.neutral, props, *size).png(vertices)
    image = matplotlib.image.imread(io.BytesIO(drawn))[..., :3]
    marks = rig.neutral.landmarks
    scale = min(np.array(size) / np.ptp(rig.neutral.vertices[:, :2], axis=0)) / 1.12
    middle = (rig.neutral.vertices.min(axis=0) + rig.neutral.vertices.max(axis=0))[:2] / 2
    ends = vertices[[marks["mouth_corner_right"], marks["mouth_corner_left"]], :2] - middle
    (x0, y0), (x1, y1) = ends * [scale, -scale] + np.array(size) / 2
    top, low = int(min(y0, y1) - 12 * scale), int(max(y0, y1) + 25 * scale)
    mouth = image[top:low, int(x0) : int(x1)]
    return int(((mouth.min(axis=2) > 0.5) & (np.ptp(mouth, axis=2) < 0.16)).sum())


@pytest.mark.parametrize("pose", CLOSED)
def test_no_white_speck_of_teeth_is_seen_between_closed_lips(rig, pose):
    props, V = face_props(rig.neutral), posed(rig, CLOSED[pose])
    sizes = SIZES if pose in ("rest", "smile") else SIZES[:2]
    assert not any(white(rig, props, V, size) for size in sizes)


def test_teeth_lit_as_the_skin_would_be_seen_as_specks(rig):
    V, bare = posed(rig, CLOSED["smile"]), undimmed(face_props(rig.neutral))
    assert sum(white(rig, bare, V, size) for size in SIZES) > 5


def test_an_open_mouth_shows_its_teeth_nearly_as_bright_as_they_are(rig):
    props, V = face_props(rig.neutral), posed(rig, ["AU26"])
    for size in SIZES[:2]:
        before = white(rig, undimmed(props), V, size)
        assert before > 10 and white(rig, props, V, size) > 0.85 * before


def flat_lips(z=10.0):
    """Two sheets that touch along y = 0 and are one only at the corners of the mouth."""
    x, y = np.meshgrid(np.linspace(-25, 25, 41), [0.0, 4.0, 8.0])
    upper = np.stack([x, y, z + 0 * x], axis=-1).reshape(-1, 3)
    k = np.arange(len(upper)).reshape(x.shape)
    a, b, c, d = (m.ravel() for m in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    F = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    lower = F[:, ::-1] + len(upper)
    for corner in (0, 40):
        lower[lower == corner + len(upper)] = corner
    marks = {"lip_upper": 41 + 20, "lip_lower": len(upper) + 41 + 20}
    V = np.vstack([upper, upper * [1, -1, 1]])
    return TriangleMesh(V, np.vstack([F, lower]), marks)


def flat_gap(lips):
    sides = [lips.landmarks[name] for name in ("lip_upper", "lip_lower")]
    return Gap(lips, (0, 40), sides, np.arange(lips.n_vertices), 3.0)


def parted(lips, gap):
    V = lips.vertices.copy()
    half = len(V) // 2
    V[:half, 1] += gap / 2
    V[half:, 1] -= gap / 2
    V[[0, 40], 1] = 0
    return V


def test_light_on_teeth_is_that_of_a_long_slit():
    """In closed form, at the middle of two flat lips."""
    lips, gap, depth = flat_lips(), 6.0, 10.0
    y = np.array([0.0, 2.0, 5.0, 40.0])
    points = np.stack([0 * y, y, 0 * y], axis=1)
    V, slit = parted(lips, gap), flat_gap(lips)
    share = slit.light(V, points)
    up, down = gap / 2 - y, -gap / 2 - y
    t = (up / np.hypot(up, depth) - down / np.hypot(down, depth)) / 2 / 0.4
    t = t.clip(0, 1)
    np.testing.assert_allclose(share, t * t * (3 - 2 * t), atol=1e-6)
    assert slit.behind(V, points) is points
    assert slit.parted(V, points).tolist() == [1, 1, 1, 1]


def test_teeth_do_not_come_through_closed_lips_and_are_not_held_by_open_ones():
    lips = flat_lips(z=10.0)
    gap = flat_gap(lips)
    tooth = np.array([[0.0, 1.0, 12.0], [3.0, 1.0, 4.0]])  # one before the lips, one behind
    held = gap.behind(lips.vertices, tooth)
    assert gap.light(lips.vertices, tooth).tolist() == [0, 0]
    np.testing.assert_allclose(held, [[0, 1, 9.7], [3, 1, 4]], atol=1e-9)
    assert gap.behind(parted(lips, 6.0), tooth) is tooth


def test_a_mouth_that_looks_open_is_not_changed_in_what_is_written(rig):
    """Files keep teeth as they are made: other programs bring light of their own."""
    teeth = next(prop for prop in face_props(rig.neutral) if prop.name == "teeth_upper")
    assert followed(teeth, rig.neutral.vertices) is teeth.mesh.vertices
    assert shown(teeth, rig.neutral.vertices)[1].max() < 0.3 < teeth.colors.max()


def test_the_page_shows_teeth_in_the_dark_of_a_closed_mouth_from_the_start(rig):
    props = face_props(rig.neutral)
    view = FaceView(rig.neutral, props)
    teeth = view._props.meshes[2].geometry.attributes["color"]
    assert teeth.array.max() < 0.3
    view.show(posed(rig, ["AU26"]))
    assert teeth.array.max() > 0.8


def eye_pixels(rig, props, vertices, size, gaze):
    """Bright pixels and all that are neither skin nor dark, in the picture of each eye."""
    drawn = Thumbnails(rig.neutral, props, *size).png(vertices, gaze)
    image = matplotlib.image.imread(io.BytesIO(drawn))[..., :3]
    V, marks = rig.neutral.vertices, rig.neutral.landmarks
    scale = min(np.array(size) / np.ptp(V[:, :2], axis=0)) / 1.12
    middle, found = (V.min(axis=0) + V.max(axis=0))[:2] / 2, {}
    for side in ("left", "right"):
        ends = V[[marks[f"eye_{side}_{end}"] for end in ("inner", "outer")], :2] - middle
        x, y = (ends * [scale, -scale] + np.array(size) / 2).T
        top, low = int(y.min() - 12 * scale), int(y.max() + 12 * scale)
        eye = image[top:low, int(x.min()) : int(x.max()) + 1]
        found[side] = int(((eye.min(axis=2) > 0.4) & (np.ptp(eye, axis=2) < 0.12)).sum())
    return found


@pytest.mark.parametrize("gaze", [(0, 0), (25, 0), (0, 20), (0, -20)])
def test_no_white_of_an_eye_is_seen_through_closed_lids_wherever_it_looks(rig, gaze):
    props = face_props(rig.neutral, rig)
    for closed in (("left", "right"), ("left",), ("right",)):
        V = posed(rig, [f"AU45{side[0].upper()}" for side in closed])
        found = eye_pixels(rig, props, V, SIZES[1], gaze)
        for side, n in found.items():
            assert n == 0 if side in closed else n > 5, (side, closed)


def test_lids_that_fail_to_meet_leave_a_dark_line_and_no_white(rig):
    """A blink of nine tenths: the eye between the lids is seen, but in their shade."""
    props = face_props(rig.neutral, rig)
    almost = rig.shape({"AU45L": 0.93, "AU45R": 0.93})
    dark = {side: 0 for side in ("left", "right")}
    assert eye_pixels(rig, props, almost, SIZES[2], (25, 0)) == dark
    lit = undimmed(props)
    assert min(eye_pixels(rig, lit, almost, SIZES[2], (25, 0)).values()) > 5
