"""Faces and action units against those of the generic face of ICT-FaceKit.

The scan is laid over the synthetic face by a similarity of the 68 landmarks and a smooth warp
through them. At each synthetic vertex with a partner on the scan the two displacements are
compared; fields are weighed by area, so that fine triangles at eyes and mouth count no more than
their share of the skin. No displacement is copied or fitted: places, strengths and reaches of the
muscles were set by hand, with this table in view.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from data_synth.units import UNIT_TABLE
from facelab.geometry.alignment import procrustes
from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import MULTI_PIE


@dataclass(frozen=True)
class Comparison:
    """One action unit beside its counterpart on the generic face.

    Attributes
    ----------
    unit : str
    shapes : tuple of str
        Shapes of the scan, added.
    cosine : float
        Of the two displacement fields on corresponding points, weighed by area.
    peaks : tuple of two float
        Largest displacement on the synthetic face and on the scan, millimetres.
    """

    unit: str
    shapes: tuple
    cosine: float
    peaks: tuple


def correspondence(rig, scan, reach=4.0):
    """Vertices of a rig and the points of a scan that lie on them.

    Parameters
    ----------
    rig : ActionUnitRig
    scan : BlendshapeRig
        With the 68 landmarks.
    reach : float, default=4.0
        Farthest a partner may be after the warp, millimetres.

    Returns
    -------
    vertices : ndarray of int, shape (n_pairs,)
        Vertices of the rig that have a partner.
    partners : ndarray of int, shape (n_pairs, 3)
        Vertices of the scan around each.
    shares : ndarray of shape (n_pairs, 3)
        Their weights; each row sums to 1.
    turn : ndarray of shape (3, 3)
        Scale and rotation that carry displacements of the scan to the rig's frame.
    """
    ours = rig.neutral.vertices[[rig.neutral.landmarks[k] for k in MULTI_PIE]]
    theirs = scan.neutral.vertices[[scan.neutral.landmarks[k] for k in MULTI_PIE]]
    over = procrustes(theirs, ours, scale=True)
    V, near = over.apply(scan.neutral.vertices), over.apply(theirs)
    V = V + RBFInterpolator(near, ours - near)(V)
    normals = scan.neutral.with_vertices(V).normals
    # normals tell upper from lower lip, and the lid's front from its back
    pull = 6.0
    tree = cKDTree(np.hstack([V, pull * normals]))
    query = np.hstack([rig.neutral.vertices, pull * rig.neutral.normals])
    partners = tree.query(query, k=3)[1]
    distance = np.linalg.norm(V[partners] - rig.neutral.vertices[:, None], axis=2)
    facing = np.einsum("vkd,vd->vk", normals[partners], rig.neutral.normals).min(1) > 0.5
    vertices = np.flatnonzero((distance.min(1) < reach) & facing)
    shares = 1.0 / np.maximum(distance[vertices], 0.1)
    shares /= shares.sum(1, keepdims=True)
    return vertices, partners[vertices], shares, over.scale * over.rotation


def distances(mesh, scan):
    """How far a face lies from another one, laid over it by a similarity of the 68 landmarks.

    Parameters
    ----------
    mesh, scan : TriangleMesh
        Both with the 68 landmarks.

    Returns
    -------
    ndarray of shape (n_vertices,)
        From each vertex of `mesh` to the nearest place of the scan's surface, millimetres of
        `mesh`.
    """
    ours, theirs = (m.vertices[[m.landmarks[k] for k in MULTI_PIE]] for m in (mesh, scan))
    over = scan.with_vertices(procrustes(theirs, ours, scale=True).apply(scan.vertices))
    faces, barycentric = closest_points(over, mesh.vertices)
    places = np.einsum("vc,vcd->vd", barycentric, over.vertices[over.faces[faces]])
    return np.linalg.norm(places - mesh.vertices, axis=1)


def compare(rig, scan):
    """Compare every unit that has a counterpart with it.

    Parameters
    ----------
    rig : ActionUnitRig
    scan : BlendshapeRig
        As `facelab.load_ict_facekit()` gives it.

    Returns
    -------
    list of Comparison
        In the order of the units; those without a counterpart are left out.
    """
    vertices, partners, shares, turn = correspondence(rig, scan)
    third = np.repeat(rig.neutral.face_areas / 3.0, 3)
    area = np.bincount(rig.neutral.faces.ravel(), third, rig.neutral.n_vertices)[vertices]
    rows = []
    for k, name in enumerate(rig.names):
        shapes = UNIT_TABLE[name].ict
        if not shapes:
            continue
        there = sum(scan.deltas[scan.names.index(s)] for s in shapes).astype(float)
        theirs = np.einsum("pk,pkd->pd", shares, there[partners]) @ turn.T
        ours = rig.deltas[k][vertices]
        rows.append(
            Comparison(
                name,
                shapes,
                _cosine(ours, theirs, area),
                tuple(float(np.linalg.norm(d, axis=1).max()) for d in (rig.deltas[k], there)),
            )
        )
    return rows


def _cosine(a, b, weight):
    """Cosine of two displacement fields (n, 3) under vertex weights (n,)."""
    dot = np.einsum("v,vd,vd->", weight, a, b)
    return float(dot / np.sqrt((weight @ (a**2)).sum() * (weight @ (b**2)).sum()))
