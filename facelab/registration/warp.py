"""The energy that a fit makes small: a smooth field that carries a template to its targets."""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from facelab.numeric.sparse import SparseFactor


class Preset(NamedTuple):
    """What a person chooses at once; all in millimetres."""

    reach: float
    """Of a difference of identity along the surface: places this far apart still share 0.6 of it,
    at three times the distance none."""
    size: float
    """How large such a difference is, per axis."""
    stages: tuple
    """Distance between data and surface that is let pass, from coarse to fine."""
    motion_reach: float
    """Of the motion of one face along the surface: places this far apart share 0.4 of it."""
    motion_size: float
    """As `size`, of the motion."""
    noise: float
    """Of a marker, per axis."""


PRESETS = {
    "balanced": Preset(60.0, 4.0, (4.0, 2.0, 1.0, 0.5, 0.5), 60.0, 5.0, 0.3),
    "smooth": Preset(90.0, 4.0, (4.0, 2.0, 1.0, 1.0), 90.0, 3.0, 0.6),
    "close": Preset(45.0, 6.0, (4.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.1), 45.0, 6.0, 0.15),
}
"""Balanced for clean data, smooth for noisy data, close to follow the data where it is exact."""


GLUED, SEEN = (
    1.0,
    2.0,
)  # mm; how exactly markers sit on landmarks, and landmarks are found on scans


def smooth_field(mesh, reach):
    """C with C^T C = Q, the precision of a smooth field of variance about 1 on the surface."""
    area = np.maximum(mesh.vertex_areas, 1e-6)
    L = mesh.laplacian("cotangent", normalised=False)
    # (1 / reach^2 - Laplacian) u = white noise: a Matern field, its variance reach^2 / 4 pi
    C = sp.diags_array(area / reach**2) + L
    return sp.csr_array(sp.diags_array(reach / np.sqrt(4 * np.pi * area)) @ C)


def rows(mesh, faces, weights):
    """Sparse (n_points, n_vertices): points of the surface as weighted vertices."""
    row = np.repeat(np.arange(len(faces)), 3)
    shape = (len(faces), mesh.n_vertices)
    return sp.csr_array((weights.ravel(), (row, mesh.faces[faces].ravel())), shape=shape)


def relaxed(mesh, start, match, preset):
    """Matching and smooth deformation in turns, from coarse to fine: vertices after each stage."""
    C = smooth_field(mesh.with_vertices(start), preset.reach)
    Q = C.T @ C / preset.size**2
    V = start
    for slack in preset.stages:
        B, target, w = match(mesh.with_vertices(V), slack)
        W = sp.diags_array(w)
        # u = V - start: min |C u|^2 / size^2 + (B (start + u) - target)^T W (...), its gradient 0
        V = start + SparseFactor(Q + B.T @ W @ B).solve(B.T @ W @ (target - B @ start))
        yield V


def sliding(mesh, faces, weights, points, height):
    """Where points of the surface should go: along the normal, to the height of the data."""
    B = rows(mesh, faces, weights)
    foot, normal = B @ mesh.vertices, B @ mesh.normals
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    gap = ((points - foot) * normal).sum(axis=1) - height
    return B, foot, normal, gap
