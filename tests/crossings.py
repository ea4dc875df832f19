"""Corner angles of triangles, and triangles that cut through each other."""

import numpy as np
from scipy.spatial import cKDTree


def angles(vertices, faces):
    """Corner angles of each triangle in degrees, (n_faces, 3)."""
    corners = vertices[faces]
    p = np.roll(corners, -1, axis=1) - corners
    q = np.roll(corners, 1, axis=1) - corners
    cos = (p * q).sum(2) / np.linalg.norm(p, axis=2) / np.linalg.norm(q, axis=2)
    return np.degrees(np.arccos(np.clip(cos, -1.0, 1.0)))


def pierced(start, end, triangles):
    """Whether segments (k, 3)-(k, 3) pass through triangles (k, 3, 3); touching counts not."""
    a = triangles[:, 0]
    u, v, d = triangles[:, 1] - a, triangles[:, 2] - a, end - start
    normal = np.cross(u, v)
    slope = (normal * d).sum(1)
    safe = np.where(np.abs(slope) < 1e-12, 1.0, slope)
    t = -(normal * (start - a)).sum(1) / safe
    hit = start + t[:, None] * d - a
    area2 = (normal**2).sum(1)
    beta = (np.cross(hit, v) * normal).sum(1) / area2
    gamma = (np.cross(u, hit) * normal).sum(1) / area2
    eps = 1e-9
    return (
        (np.abs(slope) > 1e-12) & (t > eps) & (t < 1 - eps)
        & (beta > eps) & (gamma > eps) & (beta + gamma < 1 - eps)
    )  # fmt: skip


def self_intersections(vertices, faces):
    """Pairs of triangles that cut through each other, (k, 2)."""
    corners = vertices[faces]
    low, high = corners.min(1), corners.max(1)
    centre = 0.5 * (low + high)
    radius = 0.5 * np.linalg.norm(high - low, axis=1)
    # near triangles are found by size class, so that few large ones cost little
    pairs = cKDTree(centre).query_pairs(2.0 * np.quantile(radius, 0.98), output_type="ndarray")
    big = np.flatnonzero(radius > np.quantile(radius, 0.98))
    near = cKDTree(centre).query_ball_point(centre[big], 2.0 * radius.max())
    more = np.array([(i, j) for i, js in zip(big, near, strict=True) for j in js if i != j])
    pairs = np.unique(np.sort(np.vstack([pairs, more]), axis=1), axis=0)
    i, j = pairs.T
    pairs = pairs[((low[i] <= high[j]) & (low[j] <= high[i])).all(1)]
    shared = (faces[pairs[:, 0], :, None] == faces[pairs[:, 1], None, :]).sum((1, 2))
    pairs = pairs[shared < 2]  # triangles that share an edge cannot cross
    bad = np.zeros(len(pairs), dtype=bool)
    for one, two in (pairs.T, pairs.T[::-1]):
        for k in range(3):
            s, e = faces[one, k], faces[one, (k + 1) % 3]
            # an edge that starts at a common corner can only touch
            free = ~((faces[two] == s[:, None]) | (faces[two] == e[:, None])).any(1)
            bad[free] |= pierced(vertices[s[free]], vertices[e[free]], corners[two[free]])
    return pairs[bad]
