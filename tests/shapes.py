"""Small meshes that tests know all about."""

import numpy as np

from facelab.geometry.mesh import TriangleMesh


def grid_mesh(columns, rows, spacing=1.0):
    """A flat rectangle of right triangles in the plane z = 0, facing +z."""
    y, x = np.mgrid[:rows, :columns]
    V = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * spacing
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([a, a + 1, a + columns + 1], axis=1)
    upper = np.stack([a, a + columns + 1, a + columns], axis=1)
    return TriangleMesh(V, np.stack([lower, upper], axis=1).reshape(-1, 3))


def disk_mesh(rings, sectors, inner=0.0, outer=1.0):
    """A flat disk facing +z, or a ring if `inner` is above zero; its borders are polygons."""
    radii = np.linspace(inner, outer, rings + 1)[0 if inner else 1 :]
    angle = 2 * np.pi * np.arange(sectors) / sectors
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    V = (radii[:, None, None] * circle).reshape(-1, 3)
    k = np.arange(sectors)
    ahead = (k + 1) % sectors
    F = []
    for ring in range(len(radii) - 1):
        low, high = ring * sectors, (ring + 1) * sectors
        F += [np.stack([low + k, high + k, high + ahead], axis=1)]
        F += [np.stack([low + k, high + ahead, low + ahead], axis=1)]
    if not inner:  # the innermost ring closes over a centre
        F += [np.stack([np.full(sectors, len(V)), k, ahead], axis=1)]
        V = np.vstack([V, np.zeros(3)])
    return TriangleMesh(V, np.vstack(F))


def finger_mesh(width=4.0, height=60.0, radius=60.0):
    """A flat disk from whose middle a closed tube rises, thinner than a coarse mesh is fine."""
    flat = disk_mesh(40, 36)
    x, y, _ = flat.vertices.T
    s, angle = np.hypot(x, y), np.arctan2(y, x)  # s runs from the tip, 0, to the outline, 1
    along = np.where(
        s < 0.5, np.minimum(1, s / 0.1) * width, width + (2 * s - 1) * (radius - width)
    )
    up = height * np.clip((0.5 - s) / 0.4, 0, 1)
    return flat.with_vertices(np.stack([along * np.cos(angle), along * np.sin(angle), up], axis=1))


def sphere_mesh(rounds, radius=1.0):
    """An icosahedron, each face cut in four `rounds` times, on a sphere; facing outwards."""
    g = (1 + 5**0.5) / 2
    V = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    V += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    F = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4)]
    F += [(11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8)]
    F += [(3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    for _ in range(rounds):
        middle = {}

        def half_way(a, b, V=V, middle=middle):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(V)
                V.append(tuple((np.array(V[a]) + V[b]) / 2))
            return middle[key]

        cut = [(a, b, c, half_way(a, b), half_way(b, c), half_way(c, a)) for a, b, c in F]
        F = [t for a, b, c, d, e, f in cut for t in ((a, d, f), (b, e, d), (c, f, e), (d, e, f))]
    V = np.array(V, dtype=float)
    return TriangleMesh(radius * V / np.linalg.norm(V, axis=1, keepdims=True), np.array(F))


def tetrahedron():
    V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    return TriangleMesh(V, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
