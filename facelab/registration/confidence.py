"""How far the dense motion of a take can be off, vertex by vertex."""

import numpy as np
from scipy.spatial import cKDTree

from facelab.registration.warp import rows

_MARGIN = 1.2
"""From the expected error to one that nine in ten vertices stay below."""
_LIDS, _LIPS = (1.4, 8.0), (0.8, 12.0)
"""mm: how far the free edges of eyes and mouth move on their own, and how far into the skin."""
_GUIDED, _MOST = 8.0, 2.5
"""Where the next marker is farther away than this (mm), they move the more in proportion, at most
so many times. All these were read off the errors of the four synthetic actors over all takes, with
all markers and with 80 and 40 of them; `facelab.studies.reliability` shows what they are worth."""


def free_edges(mesh):
    """The places at which skin ends and moves on its own: lids and lips.

    Parameters
    ----------
    mesh : TriangleMesh
        With landmarks called eye_... and mouth_inner..., as in `facelab.geometry.MULTI_PIE`.

    Returns
    -------
    lids, lips : ndarray of int
        Vertices: of the openings of the mesh at eyes and mouth, or those landmarks where it is
        closed; empty if it has neither.

    Examples
    --------
    >>> import facelab
    >>> lids, lips = free_edges(facelab.load_template(4375))
    >>> len(lids) > 30, len(lips) > 30
    (True, True)
    """
    marks = [[], [], []]  # of the right eye, the left eye and the mouth
    for name, vertex in mesh.landmarks.items():
        for kind, start in enumerate(("eye_right", "eye_left", "mouth_inner")):
            if name.startswith(start):
                marks[kind].append(vertex)
    found = []
    loops = mesh.boundary_loops[1:]  # the longest is the border of the face
    for some in marks:
        places = mesh.vertices[some]
        near = [lp for lp in loops if some and _apart(mesh.vertices[lp], places) < 10]
        found.append(np.concatenate(near) if near else np.array(some, dtype=int))
    return np.concatenate(found[:2]), found[2]


def _apart(loop, places):
    return np.linalg.norm(loop.mean(axis=0) - places.mean(axis=0))


def expected_error(fit, left_out):
    """Error of the dense motion that nine in ten vertices stay below, RMS, mm: (n_vertices,).

    Two parts: the spread of the field between the markers, scaled by how well, nearby and in this
    take, markers were foretold by the others; and the lids and lips, whose free edges no marker
    foretells.

    Parameters
    ----------
    fit : MarkerFit
    left_out : ndarray of shape (n_markers,)
        Distance of each marker from where the others lead it, RMS over the take, millimetres; NaN
        for one never seen.
    """
    layout, noise, mesh = fit.layout, fit.preset.noise, fit.mesh
    expected = noise * np.sqrt(3 / layout.own)
    ratio = left_out / expected
    known = np.isfinite(ratio)
    near = layout.near[:, known]
    near = near / np.maximum(near.sum(axis=1, keepdims=True), 1e-12)
    square = 3 * (_MARGIN * layout.spread()) ** 2 * (near @ ratio[known] ** 2)
    feet = rows(mesh, fit.faces, fit.weights) @ mesh.vertices
    alone = cKDTree(feet[known]).query(mesh.vertices)[0] / _GUIDED if known.any() else _MOST
    for edge, (size, reach) in zip(free_edges(mesh), (_LIDS, _LIPS), strict=True):
        if len(edge):
            far = cKDTree(mesh.vertices[edge]).query(mesh.vertices)[0]
            square += (size * np.clip(alone, 1, _MOST) * np.exp(-((far / reach) ** 2))) ** 2
    return np.sqrt(square)
