"""Eyeballs made to fit between the lids of a face."""

import numpy as np
from matplotlib.colors import to_rgb

from facelab.geometry.mesh import TriangleMesh

IRIS = "#5a4029"
_GAP = 0.45  # mm between ball and lids
_IRIS_SHARE = 0.475  # of the radius of the ball: 5.9 mm of 12.4
_SEGMENTS = 48
# rings: share of the angle of the iris or degrees, colour (None for the iris) and its brightness
_RINGS = (
    *((0.0, "pupil", 1.0), (0.36, "pupil", 1.0), (0.40, "iris", 0.85), (0.55, "iris", 1.25)),
    *((0.80, "iris", 1.1), (0.95, "iris", 0.55), (1.0, "iris", 0.35), (1.06, "white", 0.86)),
    *((1.15, "white", 1.0), (1.6, "white", 1.0), (2.1, "white", 0.95), (2.8, "white", 0.85)),
    *((3.6, "white", 0.75), (4.2, "white", 0.7)),
)


def fitted_ball(rim, width, skin):
    """Centre and radius of an eyeball that the lids lie on, millimetres.

    Parameters
    ----------
    rim : ndarray of shape (n, 3)
        Along the lids.
    width : float
        From corner to corner.
    skin : ndarray of shape (m, 3)
        All of the face: what is near stays outside of the ball.
    """
    for _ in range(4):
        centre, radius = _sphere(rim, width)
        off = np.abs(np.linalg.norm(rim - centre, axis=1) - radius)
        kept = off <= 3 * np.median(off) + 0.02 * width  # not what lies beside the lids
        if kept.all():
            break
        rim = rim[kept]
    radius -= _GAP
    for _ in range(8):  # behind all that is nearer than the gap
        away = np.linalg.norm(skin - centre, axis=1)
        near = (away < radius + _GAP / 2) & (skin[:, 2] > centre[2] + 0.4 * radius)
        if not near.any():
            break
        centre[2] -= max(radius + _GAP / 2 - away[near].min(), 0.02)
    return centre, radius


def _sphere(rim, width):
    """Centre and radius of a sphere through points, by least squares."""
    # |v|^2 = 2 c . v + (r^2 - |c|^2) is linear in the centre c and the last bracket
    mean = rim.mean(axis=0)
    X = rim - mean
    A = np.c_[2 * X, np.ones(len(X))]
    # lids alone tell the radius badly: a usual one and a centre straight behind weigh in a little
    usual = 0.47 * width
    guess = np.array([0, 0, -0.66 * usual, usual**2 - (0.66 * usual) ** 2])
    pull = np.sqrt(len(X)) * 0.01 * np.diag([width, width, width, 1.0])
    left, right = np.vstack([A, pull]), np.r_[(X**2).sum(axis=1), pull @ guess]
    *centre, bracket = np.linalg.lstsq(left, right, rcond=None)[0]
    radius = np.sqrt(max(bracket + np.dot(centre, centre), 1.0))
    return mean + centre, float(np.clip(radius, 0.38 * width, 0.62 * width))


def ball_mesh(radius, iris=IRIS):
    """An eyeball about the origin that looks ahead, and its colours: (TriangleMesh, (n, 3)).

    It ends behind the equator, where no lid lets it be seen. Rings of vertices lie where the
    colour changes, so that pupil and iris have clean edges.
    """
    at_iris = np.arcsin(_IRIS_SHARE)
    around = 2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
    points, colors = [], []
    base = {"pupil": (0.02, 0.02, 0.02), "iris": to_rgb(iris), "white": (0.92, 0.90, 0.87)}
    streaks = 1 + 0.12 * np.sin(around * 7 + 1) * np.sin(around * 12)
    for share, kind, bright in _RINGS:
        tilt = share * at_iris
        ring = np.stack(
            [
                np.sin(tilt) * np.cos(around),
                np.sin(tilt) * np.sin(around),
                0 * around + np.cos(tilt),
            ],
            axis=1,
        )
        points.append(radius * ring)
        tone = bright * (streaks if kind == "iris" else np.ones(_SEGMENTS))
        if kind == "white":  # in the shade of the upper lid
            tone = tone * (1 - 0.22 * np.clip(ring[:, 1] * 1.5, 0, 1))
        colors.append(np.clip(tone[:, None] * base[kind], 0, 1))
    faces = []
    k = np.arange(_SEGMENTS)
    for ring in range(len(_RINGS) - 1):
        a, b = ring * _SEGMENTS + k, ring * _SEGMENTS + (k + 1) % _SEGMENTS
        c, d = a + _SEGMENTS, b + _SEGMENTS
        faces += [np.stack([a, c, d], axis=1)] + ([np.stack([a, d, b], axis=1)] if ring else [])
    mesh = TriangleMesh(np.concatenate(points), np.concatenate(faces))
    return mesh, np.concatenate(colors)


def turned(points, yaw, pitch):
    """Points about the origin, the person's eye turned to the left and up by radians."""
    c, s = np.cos(yaw), np.sin(yaw)
    side = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(pitch), np.sin(pitch)
    up = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    return points @ (side @ up).T
