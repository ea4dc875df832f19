"""Lines, polygons and triangles in the plane: nothing of faces in it.

`places` are points of the plane, shape (n, 2), and `points` the same ones in space.
"""

import numpy as np
from scipy.spatial import Delaunay, cKDTree


def arc_length(line):
    """How far along a line each of its points lies, in any dimension: shape (n,), from 0."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))


def inside(places, polygon):
    """Even-odd test of places (n, 2) against one polygon (m, 2)."""
    x, y = places.T
    odd = np.zeros(len(places), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return odd


def signed_area(places, a, b, c):
    """Twice the area of triangles, negative where they run clockwise, (n,)."""
    p, q = places[b] - places[a], places[c] - places[a]
    return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def _thinned(coordinates, radius, taken):
    """Indices of candidates no closer than `radius` to each other, nor to those taken already."""
    distance, _ = cKDTree(taken).query(coordinates)
    alive = np.flatnonzero(distance > 0.72 * radius)
    order = np.random.default_rng(1).permutation(alive)
    near = cKDTree(coordinates[order]).query_ball_point(coordinates[order], radius[order])
    free = np.ones(len(order), dtype=bool)
    chosen = []
    for i, neighbours in enumerate(near):
        if free[i]:
            chosen.append(order[i])
            free[neighbours] = False
    return np.array(chosen)


def choose_spread(coordinates, radius, taken, n):
    """Indices of `n` candidates as far from each other as may be, about in proportion to `radius`.

    Parameters
    ----------
    coordinates : ndarray of shape (n_candidates, n_dimensions)
    radius : ndarray of shape (n_candidates,)
    taken : ndarray of shape (n_taken, n_dimensions)
        Points from which the chosen ones keep away too.
    n : int
    """
    scale, enough, slack = 1.0, None, 1.004
    for _ in range(12):
        chosen = _thinned(coordinates, scale * radius, taken)
        if len(chosen) >= n:
            enough = chosen
            if len(chosen) <= 1.012 * n:
                break
        # the count falls with the square of the distance; aim a little over n
        scale *= np.sqrt(len(chosen) / (slack * n))
        slack += 0.001
    return enough[:n]


def _inner_edges(faces):
    """Edges c-d between two triangles: those triangles (k, 2), corners a, b, c, d, and a key.

    a faces the edge in the first triangle, b in the second.
    """
    corner = np.tile(np.arange(3), len(faces))
    owner = np.repeat(np.arange(len(faces)), 3)
    ends = np.stack([faces[owner, (corner + 1) % 3], faces[owner, (corner + 2) % 3]], 1)
    low, high = np.sort(ends).T
    key = low.astype(np.int64) * (faces.max() + 1) + high
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = order[same], order[same + 1]
    a, b = faces[owner[one], corner[one]], faces[owner[two], corner[two]]
    return np.stack([owner[one], owner[two]], 1), a, b, *ends[one].T, key[one]


def flip_edges(points, places, faces, kept, rounds=12):
    """Triangles whose edges are flipped until the angles that face them sum to at most 180 degrees.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
        In space, where the angles are taken.
    places : ndarray of shape (n, 2)
        In the plane, where no triangle may turn over.
    faces : ndarray of shape (n_faces, 3)
    kept : ndarray of int
        Keys (smaller * n + larger end) of edges that must stay.

    References
    ----------
    Lawson, Software for C1 surface interpolation, 1977.
    """
    faces = faces.copy()
    for _ in range(rounds):
        owners, a, b, c, d, key = _inner_edges(faces)

        def angle(apex, c=c, d=d):
            p, q = points[c] - points[apex], points[d] - points[apex]
            cos = (p * q).sum(1) / np.linalg.norm(p, axis=1) / np.linalg.norm(q, axis=1)
            return np.arccos(np.clip(cos, -1.0, 1.0))

        excess = angle(a) + angle(b) - np.pi
        valid = (signed_area(places, a, c, b) > 1e-3) & (signed_area(places, a, b, d) > 1e-3)
        wanted = np.flatnonzero((excess > 1e-6) & valid & ~np.isin(key, kept))
        if not len(wanted):
            break
        # an independent set: an edge flips if it is the worst of both its triangles
        best = np.zeros(len(faces))
        np.maximum.at(best, owners[wanted].ravel(), np.repeat(excess[wanted], 2))
        go = wanted[(excess[wanted, None] >= best[owners[wanted]]).all(1)]
        used = owners[go].ravel()
        if len(np.unique(used)) < len(used):  # exact ties: take one at a time
            for side in range(2):
                go = go[np.unique(owners[go, side], return_index=True)[1]]
            go = go[~np.isin(owners[go, 0], owners[go, 1])]
        faces[owners[go, 0]] = np.stack([a[go], c[go], b[go]], 1)
        faces[owners[go, 1]] = np.stack([a[go], b[go], d[go]], 1)
    return faces


def triangulate(places, outline, holes, ghosts):
    """Delaunay triangles of the layout inside the outline and outside the holes."""
    triangles = Delaunay(np.vstack([places, ghosts])).simplices
    triangles = triangles[(triangles < len(places)).all(1)]
    centres = places[triangles].mean(1)
    good = inside(centres, outline)
    for hole in holes:
        good &= ~inside(centres, hole)
    triangles = triangles[good]
    turned = signed_area(places, *triangles.T) < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def recover_edges(faces, kept, n):
    """Flip an edge where it crosses an edge of a loop that Delaunay left out."""
    for _ in range(4):
        owners, a, b, c, d, _ = _inner_edges(faces)
        crossing = np.isin(np.minimum(a, b).astype(np.int64) * n + np.maximum(a, b), kept)
        if not crossing.any():
            break
        k = np.flatnonzero(crossing)[0]
        faces[owners[k]] = [[a[k], c[k], b[k]], [a[k], b[k], d[k]]]
    return faces


def ghosts_beside(rims, outer):
    """Helper points just outside the domain that keep its boundary edges Delaunay.

    `rims` are the boundary lines, each with the domain on the left of its direction. All but the
    `outer` one bound openings, within which their helpers must stay.
    """
    ghosts = []
    for line in rims:
        step = np.diff(line, axis=0)
        outward = np.stack([step[:, 1], -step[:, 0]], 1)
        middle = 0.5 * (line[1:] + line[:-1])
        reach = np.full(len(step), 0.6)
        if line is not outer:  # narrow openings: come closer
            others = cKDTree(line)
            for _ in range(4):
                near, _ = others.query(middle + reach[:, None] * outward)
                reach[near < 0.9 * reach * np.linalg.norm(outward, axis=1)] *= 0.6
        ghosts.append(middle + reach[:, None] * outward)
    return np.vstack(ghosts)


def encroaches(places, lines):
    """Places within the circle over some edge of the lines: they would break that edge."""
    middle = np.vstack([0.5 * (line[1:] + line[:-1]) for line in lines])
    half = np.concatenate([0.5 * np.linalg.norm(np.diff(line, axis=0), axis=1) for line in lines])
    distance, nearest = cKDTree(middle).query(places, k=4)
    return (distance < 1.1 * half[nearest]).any(1)


def relax(points, places, faces, free, size):
    """Move free points to the centre of their triangles, weighed by area on the face."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    weight = area / size[faces].mean(1) ** 4  # keeps the grading
    centre = places[faces].mean(1)
    total, sums = np.zeros(len(places)), np.zeros_like(places)
    for k in range(3):
        np.add.at(total, faces[:, k], weight)
        np.add.at(sums, faces[:, k], weight[:, None] * centre)
    target = sums / np.maximum(total, 1e-12)[:, None]
    new = places.copy()
    new[free] += 0.75 * (target[free] - places[free])
    # take back moves that would turn a triangle over in the layout
    for _ in range(6):
        bad = np.unique(faces[signed_area(new, *faces.T) < 1e-3])
        if not len(bad):
            break
        new[bad] = places[bad]
    return new
