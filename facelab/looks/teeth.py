"""Teeth, gums and a tongue, made after the measures of an adult mouth."""

import numpy as np
from scipy.interpolate import CubicSpline

from facelab.geometry.mesh import TriangleMesh

_ARCH = np.array(  # mm to the side and back from the middle of the upper front teeth
    [(0, 0), (4.5, -0.5), (9, -2.2), (13, -4.9), (16.8, -8.8), (20, -13.5), (22.5, -19),
     (24.5, -25), (26.2, -32), (27.4, -40), (28, -48)]
)  # fmt: skip
_UPPER = ((8.6, 10.5), (6.6, 9.2), (7.6, 10.2), (7.0, 8.4), (6.8, 7.8), (9.6, 7.4))
_LOWER = ((5.3, 8.8), (5.9, 9.0), (6.9, 10.2), (7.0, 8.4), (7.1, 7.8), (10.5, 7.4))
"""Width and height of the crowns of one side, from the middle outwards, millimetres."""
_ENAMEL, _GUM, _TONGUE = (0.90, 0.87, 0.80), (0.66, 0.36, 0.35), (0.62, 0.31, 0.31)
_ACROSS = np.array([-1.0, -0.86, -0.5, 0.0, 0.5, 0.86, 1.0])
_DOWN = np.array([0.0, 0.25, 0.55, 0.85, 1.0])
_OVERLAP, _OVERJET = 1.9, 2.4  # mm: upper front teeth below the lips' line, before the lower


def row_of_teeth(upper, scale=1.0):
    """A row of twelve teeth with its gum: (TriangleMesh, colors).

    The origin is where the lips meet; x to the left, y up, z forward, millimetres. The labial side
    of the upper front teeth is at z = 0.

    Parameters
    ----------
    upper : bool
    scale : float
        1 for a mouth 50 mm wide.
    """
    sizes = _UPPER if upper else _LOWER
    sign = -1 if upper else 1  # crowns point down or up
    edge = -_OVERLAP if upper else -_OVERLAP + 0.9
    back = 0.0 if upper else -_OVERJET
    along, parts = _curve(), []
    start = 0.12
    for k, (width, height) in enumerate(sizes):
        for side in (-1, 1):
            parts.append(_tooth(along, side, start, width, height, k, sign, edge))
        start += width
    parts.append(_gum(along, start, sign, edge))
    V, F, C = _joined(parts)
    V = V + [0, 0, back]
    # towards the back the rows meet higher up
    V[:, 1] += 0.10 * np.clip(-V[:, 2] - 3, 0, None)
    return TriangleMesh(scale * V, F), C


def tongue(scale=1.0):
    """A tongue at rest in the lower row: (TriangleMesh, colors), origin as `row_of_teeth`."""
    u, v = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 9))
    half = 17.5 * np.sqrt(np.clip(1 - (1 - np.clip(v / 0.45, 0, 1)) ** 2.2, 0.02, 1))
    x = u * half
    z = -8.5 - 42 * v
    y = (
        -3.5
        + 4.0 * np.sin(np.pi * np.clip(v, 0, 0.6) / 1.2)
        - 5.0 * u**4
        - 1.3 * np.exp(-30 * u**2)
    )
    y -= 4.0 * (1 - np.clip(v / 0.12, 0, 1))
    V = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    F = _grid_faces(9, 11)
    shade = np.clip(1.05 - 0.7 * v, 0.3, 1).reshape(-1, 1)
    return TriangleMesh(scale * V, F), shade * _TONGUE


def _curve():
    """The arch as a function of the way along it: (s) to x, z and outward direction."""
    fine = np.linspace(0, 1, 400)
    t = np.linspace(0, 1, len(_ARCH))
    points = CubicSpline(t, _ARCH)(fine)
    way = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))

    def along(s):
        x, z = (np.interp(s, way, points[:, i]) for i in (0, 1))
        dx, dz = (np.interp(s, way, np.gradient(points[:, i], way)) for i in (0, 1))
        return x, z, -dz, dx

    return along


def _tooth(along, side, start, width, height, k, sign, edge):
    """Front and biting edge of one tooth: vertices, faces, colours."""
    u, v = np.meshgrid(_ACROSS, np.append(_DOWN, [1.0, 0.9]))
    rows = len(v)
    back = np.repeat(np.append(np.zeros(len(_DOWN)), [1.6, 3.0]), len(_ACROSS)).reshape(rows, -1)
    # narrower at the neck, rounded towards its neighbours
    narrow = 1 - 0.09 * (1 - v) ** 2 - (0.06 if k < 2 else 0.12) * v**6
    s = start + width / 2 * (1 + u * narrow)
    x, z, nx, nz = along(s)
    bulge = 0.9 * (1 - np.abs(u) ** 3) * (0.55 + 0.45 * np.sin(np.pi * np.clip(v, 0, 1) * 0.8))
    bulge = bulge - 0.55 * np.abs(u) ** 6 - back
    # the edge: round corners; a point on the canine, cusps behind it
    shape = {2: 1.5 * np.abs(u)}.get(k, (0.35 if k < 2 else 0.9) * np.abs(u) ** (4 if k < 2 else 2))
    short = {1: 0.6, 2: 0.0}.get(k, 0.25 * max(k - 2, 0))
    y = edge - sign * (1 - v) * height - sign * v * (shape + short)
    V = np.stack([side * (x + bulge * nx), y, z + bulge * nz], axis=-1).reshape(-1, 3)
    F = _grid_faces(rows, len(_ACROSS))
    # rows run towards the edge, columns away from the middle
    if (side > 0) != (sign < 0):
        F = F[:, ::-1]
    tone = (1 - 0.22 * np.abs(u) ** 8) * (1 - 0.035 * k) * (0.90 + 0.10 * np.clip(v, 0, 1))
    tone = tone * np.where(back > 1.7, 0.5, 1.0)
    return V, F, tone.reshape(-1, 1) * _ENAMEL


def _gum(along, length, sign, edge):
    """A band of gum over the necks of the teeth: vertices, faces, colours."""
    s = np.linspace(-length, length, 61)
    heights = np.array([5.8, 7.5, 9.5, 13.0])
    out = np.array([-0.8, 0.55, 0.5, -2.0])
    h, ss = np.meshgrid(heights, s, indexing="ij")
    o = np.repeat(out[:, None], len(s), axis=1)
    x, z, nx, nz = along(np.abs(ss))
    V = np.stack([np.sign(ss) * (x + o * nx), edge - sign * h, z + o * nz], axis=-1)
    F = _grid_faces(len(heights), len(s))
    F = F if sign > 0 else F[:, ::-1]
    tone = np.array([0.85, 1.0, 0.95, 0.6])[:, None] + 0 * ss
    return V.reshape(-1, 3), F, tone.reshape(-1, 1) * _GUM


def _grid_faces(rows, columns):
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, d), (a, d, b))])


def _joined(parts):
    start = np.cumsum([0] + [len(V) for V, _, _ in parts])
    return (
        np.concatenate([V for V, _, _ in parts]),
        np.concatenate([F + s for (_, F, _), s in zip(parts, start, strict=False)]),
        np.concatenate([C for _, _, C in parts]),
    )
