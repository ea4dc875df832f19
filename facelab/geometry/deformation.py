"""A few vertices that carry a dense face."""

import numpy as np
import scipy.sparse as sp

from facelab.checks import as_finite, as_indices, check_number
from facelab.numeric.sparse import SparseFactor


class LaplacianDeformer:
    """A mesh that keeps its Laplacian coordinates while some of its vertices are pulled.

    Everything but the positions is settled once: a new pull costs two triangular solves.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, millimetres.
    anchors : array_like of int, shape (n_anchors,)
        Pulled vertices, each once; one or more in every piece of the mesh.
    anchor_weight : float, default=0.5
        Pull of the anchors (no unit), alpha of Eq. 12.
    weights : {"uniform", "cotangent"}
        Of the Laplacian, Eq. 11.

    Raises
    ------
    ValueError
        For anchors outside the mesh or twice, a weight that is not positive, or a piece of the
        mesh without an anchor.

    References
    ----------
    Yu and Liu 2014, Eq. 11-15. Eq. 14 prints the neutral's anchors on the right side, with which
    nothing would move; meant are the optimised positions.
    """

    def __init__(self, mesh, anchors, anchor_weight=0.5, weights="uniform"):
        self.mesh = mesh
        self.anchors = as_indices(anchors, "anchors", mesh.n_vertices, "vertices")
        self.anchor_weight = check_number(anchor_weight, "anchor_weight", above=0)
        loose = np.setdiff1d(np.unique(mesh.pieces), mesh.pieces[self.anchors])
        if loose.size:
            first = int(np.flatnonzero(mesh.pieces == loose[0])[0])
            raise ValueError(
                f"anchors leave {loose.size} piece(s) of the mesh free, the one of vertex {first} "
                "among them; anchor a vertex of each piece, or keep one piece (mesh.submesh)."
            )
        L = mesh.laplacian(weights)  # Eq. 11
        pull = np.zeros(mesh.n_vertices)
        pull[self.anchors] = self.anchor_weight**2
        # Eq. 12 is |A V - b|^2, A = [L; alpha at the anchors], b = [delta; alpha anchors] (Eq. 14)
        self._bent = L.T @ (L @ mesh.vertices)  # L^T delta, the part of A^T b that stays
        self._factor = SparseFactor(L.T @ L + sp.diags_array(pull))  # A^T A of Eq. 15

    def deform(self, positions):
        """Vertices of the deformed mesh, shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        positions : ndarray of shape (n_anchors, 3)
            Where the anchors shall go, millimetres; they come near, not all the way.
        """
        positions = as_finite(positions, "positions", (len(self.anchors), 3))
        right = self._bent.copy()  # A^T b of Eq. 15
        right[self.anchors] += self.anchor_weight**2 * positions
        return self._factor.solve(right)


def laplacian_deform(mesh, anchors, positions, anchor_weight=0.5, weights="uniform"):
    """Deform a mesh so that its anchors come near positions and its local shape stays.

    For many positions of the same anchors, keep a `LaplacianDeformer`.

    Parameters
    ----------
    mesh, anchors, anchor_weight, weights
        As for `LaplacianDeformer`.
    positions : ndarray of shape (n_anchors, 3)
        Millimetres.

    Returns
    -------
    ndarray of shape (n_vertices, 3)
        Millimetres.

    References
    ----------
    Yu and Liu 2014, Eq. 11-15.
    """
    return LaplacianDeformer(mesh, anchors, anchor_weight, weights).deform(positions)
