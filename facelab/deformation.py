"""A few vertices that carry a dense face."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from facelab.mesh import TriangleMesh


@dataclass(frozen=True, eq=False)
class LinearBinding:
    """A dense face that follows control vertices linearly.

    Parameters
    ----------
    mesh : TriangleMesh
        The dense face at rest, millimetres.
    samples : ndarray of int, shape (n_control,)
        Control vertices, as vertices of the dense face.
    weights : sparse array of shape (n_vertices, n_control)
        Rows sum to one; a control vertex follows itself exactly.
    """

    mesh: TriangleMesh
    samples: np.ndarray
    weights: sp.csr_array

    @cached_property
    def handle_of(self):
        """Control vertex nearest along the surface to each dense vertex: int, (n_vertices,)."""
        return self.mesh.nearest_of(self.samples)

    def carry(self, displacements):
        """Dense displacements from those of the control vertices.

        Parameters
        ----------
        displacements : ndarray of shape (n_control, n_columns)
            Any linear quantity at the control vertices.

        Returns
        -------
        ndarray of shape (n_vertices, n_columns)
        """
        return self.weights @ displacements


def bind(mesh, samples, tolerance=1e-3):
    """Bind a dense face to control vertices so that it bends as little as it can between them.

    Each displacement field is the biharmonic one through the control vertices: it minimises the
    squared Laplacian over the surface. Weights below the tolerance are dropped and the rows
    scaled to sum to one again, so that a drag costs a thin sparse product.

    Parameters
    ----------
    mesh : TriangleMesh
        The dense face, in one piece.
    samples : ndarray of int, shape (n_control,)
        Control vertices, each once.
    tolerance : float, default=1e-3

    Returns
    -------
    LinearBinding

    Raises
    ------
    ValueError
        If the mesh is in pieces, a sample is not one of its vertices or stands twice.
    """
    samples = np.asarray(samples)
    n = mesh.n_vertices
    if samples.ndim != 1 or samples.dtype.kind not in "iu" or not samples.size:
        raise ValueError("samples must be a list of vertex indices, one for each control vertex.")
    if samples.min() < 0 or samples.max() >= n:
        raise ValueError(
            f"samples run from {samples.min()} to {samples.max()}, the mesh to {n - 1}."
        )
    if len(np.unique(samples)) < len(samples):
        raise ValueError("samples names a vertex twice; each control vertex needs its own.")
    mesh.check_connected()
    L = mesh.laplacian("cotangent", normalised=False)
    area = np.bincount(mesh.faces.ravel(), np.repeat(mesh.face_areas / 3, 3), minlength=n)
    Q = sp.csc_array(L.T @ sp.diags_array(1 / np.maximum(area, 1e-9)) @ L)
    free = np.setdiff1d(np.arange(n), samples)
    weights = sp.lil_array((n, len(samples)))
    weights[samples, np.arange(len(samples))] = 1
    weights = sp.csr_array(weights)
    if free.size:
        rows = sp.csr_array(Q)[free]
        with threadpool_limits(1):
            factor = splu(
                sp.csc_matrix(rows[:, free]),
                permc_spec="MMD_AT_PLUS_A",
                options={"SymmetricMode": True},
            )
            W = -factor.solve(rows[:, samples].toarray())
        W[np.abs(W) < tolerance] = 0
        W /= W.sum(axis=1, keepdims=True)
        place = sp.coo_array((np.ones(free.size), (free, np.arange(free.size))), (n, free.size))
        weights = sp.csr_array(weights + place @ sp.csr_array(W))
    return LinearBinding(mesh, samples, weights)
