"""The two sides of a face: partners across the midline, found by geometry."""

import numpy as np
from scipy.spatial import cKDTree

from facelab.errors import check_number

MIRROR = np.diag([-1.0, 1, 1])
"""Mirrors displacements: x runs to the person's left."""


def mirror_map(mesh, tolerance=None):
    """Mirrored partner of every vertex, found by geometry alone.

    Vertices are reflected about the plane x = c, c the middle of the pairs found; two vertices are
    partners if each is the other's nearest. A vertex on the midline is its own partner.

    Parameters
    ----------
    mesh : TriangleMesh
        A face in the head frame, millimetres.
    tolerance : float, optional
        Largest distance between a vertex and its partner's reflection, millimetres; twice the
        median edge if left out.

    Returns
    -------
    partners : ndarray of int, shape (n_vertices,)
        -1 where a vertex has none.
    """
    V = mesh.vertices
    if tolerance is None:
        a, b = mesh.edges.T
        tolerance = 2 * np.median(np.linalg.norm(V[a] - V[b], axis=1))
    tolerance = check_number(tolerance, "tolerance", above=0)
    tree, own = cKDTree(V), np.arange(len(V))
    c = (V[:, 0].min() + V[:, 0].max()) / 2
    for _ in range(10):
        off, nearest = tree.query(V * [-1, 1, 1] + [2 * c, 0, 0])
        mutual = (nearest[nearest] == own) & (off <= tolerance)
        if not mutual.any():
            break
        c = (V[mutual, 0] + V[nearest[mutual], 0]).mean() / 2
    return np.where(mutual, nearest, -1)


def check_partners(partners, n_vertices):
    """The partners as an int array, refused unless they go both ways.

    Raises
    ------
    ValueError
        For another number of vertices, or a partner who has another partner.
    """
    partners = np.asarray(partners)
    if partners.shape != (n_vertices,) or partners.dtype.kind not in "iu":
        raise ValueError(
            f"partners has shape {partners.shape} and type {partners.dtype}, but needs one "
            f"integer for each of the {n_vertices} vertices; use mirror_map(neutral)."
        )
    paired = np.flatnonzero(partners >= 0)
    if (partners >= n_vertices).any() or (partners[partners[paired]] != paired).any():
        raise ValueError("partners must go both ways: partners[partners[v]] is v, or -1.")
    return partners
