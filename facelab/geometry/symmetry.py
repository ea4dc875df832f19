"""The two sides of a face: who faces whom across the midline, and motion seen in a mirror."""

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree
from sklearn.metrics import adjusted_rand_score

from facelab.checks import as_finite, as_indices, check_choice, check_number, check_type
from facelab.geometry.binding import bind_to_surface
from facelab.geometry.mesh import TriangleMesh

MIRROR = np.diag([-1.0, 1, 1])
"""Mirrors displacements: x runs to the person's left."""


def mirror_partners(mesh, tolerance=None):
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
    V = check_type(mesh, "mesh", TriangleMesh, "give a face in the head frame").vertices
    if tolerance is None:
        a, b = mesh.edges.T
        tolerance = 2 * np.median(np.linalg.norm(V[a] - V[b], axis=1))
    tolerance = check_number(tolerance, "tolerance", above=0)
    tree, own = cKDTree(V), np.arange(len(V))
    c = (V[:, 0].min() + V[:, 0].max()) / 2
    for _ in range(10):
        off, nearest = _nearest_to_reflected(tree, c)
        mutual = (nearest[nearest] == own) & (off <= tolerance)
        if not mutual.any():
            break
        c = (V[mutual, 0] + V[nearest[mutual], 0]).mean() / 2
    return np.where(mutual, nearest, -1)


def _nearest_to_reflected(tree, c=0.0):
    """Distance and index of the vertex nearest to each vertex reflected about x = c."""
    return tree.query(tree.data * [-1, 1, 1] + [2 * c, 0, 0])


def mirror_twins(mesh, samples=None, mirror=None):
    """For each vertex the one that takes its place in a mirror.

    Parameters
    ----------
    mesh : TriangleMesh
        A face in the head frame: its plane of symmetry is x = 0.
    samples : array_like of int, optional
        Vertices of the mesh to be paired among themselves; all of them if left out.
    mirror : ndarray of int, shape (n_vertices,), optional
        Each vertex's twin, where it is known; else the vertex nearest to the mirrored place.

    Returns
    -------
    ndarray of int, shape (n_vertices,) or (n_samples,)
        A sample's twin is the sample nearest, along the surface, to the twin of its vertex.
        Several may have the same one; `mirror_partners` pairs only those that agree.
    """
    check_type(mesh, "mesh", TriangleMesh, "give a face in the head frame")
    if mirror is None:
        mirror = _nearest_to_reflected(cKDTree(mesh.vertices))[1]
    mirror = np.asarray(mirror)
    if mirror.shape != (mesh.n_vertices,):
        raise ValueError(
            f"mirror has shape {mirror.shape}, but needs one twin for each of the "
            f"{mesh.n_vertices} vertices."
        )
    if samples is None:
        return mirror
    samples = as_indices(samples, "samples", mesh.n_vertices, "vertices")
    return mesh.nearest_of(samples)[mirror[samples]]


def mirror_agreement(labels, twins):
    """How far a cut is its own mirror image.

    Parameters
    ----------
    labels : ndarray of int, shape (n_vertices,)
    twins : ndarray of int, shape (n_vertices,)
        From `mirror_twins`.

    Returns
    -------
    float
        Adjusted Rand index between the labels and the mirrored labels: 1 if they are the same
        cut, about 0 for one that knows nothing of its mirror image.

    Raises
    ------
    ValueError
        If the twins are not one vertex for each label.
    """
    labels, twins = np.asarray(labels), np.asarray(twins)
    fits = labels.ndim == 1 and twins.shape == labels.shape and twins.dtype.kind in "iu"
    if not fits or not ((twins >= 0) & (twins < len(labels))).all():
        raise ValueError(
            f"labels has shape {labels.shape}, twins shape {twins.shape} and type {twins.dtype}; "
            "give one label and the index of one twin for each vertex (mirror_twins)."
        )
    return float(adjusted_rand_score(labels, labels[twins]))


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
            f"integer for each of the {n_vertices} vertices; use mirror_partners(neutral)."
        )
    paired = np.flatnonzero(partners >= 0)
    if (partners >= n_vertices).any() or (partners[partners[paired]] != paired).any():
        raise ValueError("partners must go both ways: partners[partners[v]] is v, or -1.")
    return partners


def mirror_weights(mesh):
    """Where the mirror image of each vertex lies on the mesh, as weights of its vertices.

    Parameters
    ----------
    mesh : TriangleMesh
        Nearly symmetric about x = 0, as a template is; the vertices need not be.

    Returns
    -------
    sparse array of shape (n_vertices, n_vertices)
        Rows sum to one: barycentric weights in the triangle nearest to the mirrored vertex.
    """
    check_type(mesh, "mesh", TriangleMesh, "give a face in the head frame")
    foot = bind_to_surface(mesh, mesh.vertices * [-1, 1, 1])
    n = mesh.n_vertices
    rows = np.repeat(np.arange(n), 3)
    entries = foot.barycentric.ravel(), (rows, mesh.faces[foot.faces].ravel())
    return sp.csr_array(sp.coo_array(entries, shape=(n, n)))


def mirrored(X, mirror):
    """Frames seen in a mirror: what the left did, the right does.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Displacements, millimetres.
    mirror : sparse array of shape (n_vertices, n_vertices)
        From `mirror_weights`.
    """
    X = as_finite(X, "X", ("n_frames", 3 * mirror.shape[0]))
    moved = X.reshape(len(X), -1, 3).transpose(1, 0, 2).reshape(mirror.shape[0], -1)
    seen = (mirror @ moved).reshape(-1, len(X), 3).transpose(1, 0, 2) * [-1, 1, 1]
    return seen.reshape(len(X), -1)


def symmetrised(X, mirror):
    """Frames whose two sides do the same: the mean of each frame and its mirror image.

    The parameters are those of `mirrored`.
    """
    return (X + mirrored(X, mirror)) / 2


def one_sided(X, mesh, side="left", width=10.0):
    """Frames of which only one side is left, the other at rest, with a smooth passage between.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Displacements, millimetres.
    mesh : TriangleMesh
    side : {"left", "right"}
        The person's.
    width : float, default=10
        Half the passage, to each side of x = 0, millimetres.
    """
    X = as_finite(X, "X", ("n_frames", 3 * mesh.n_vertices))
    width = check_number(width, "width", above=0)
    x = _towards(mesh, side)
    share = np.clip((x + width) / (2 * width), 0, 1)
    share = share**2 * (3 - 2 * share)
    return X * np.repeat(share, 3)


def other_side(X, mesh, side="left", width=10.0):
    """Share of the motion that lies on the other side of the face, 0 to 1: shape (n_frames,).

    Vertices within `width` of the middle count for neither side. The parameters are those of
    `one_sided`.
    """
    X = as_finite(X, "X", ("n_frames", 3 * mesh.n_vertices))
    x = _towards(mesh, side)
    energy = (X.reshape(len(X), -1, 3) ** 2).sum(axis=2)
    there, here = (energy[:, s * x > width].sum(axis=1) for s in (-1, 1))
    return there / np.maximum(there + here, np.finfo(float).tiny)


def _towards(mesh, side):
    """Distance of each vertex from the middle, more than 0 on this side, mm."""
    sign = {"left": 1, "right": -1}[check_choice(side, "side", ("left", "right"))]
    return sign * mesh.vertices[:, 0]
