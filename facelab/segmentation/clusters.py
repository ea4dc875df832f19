"""Spectral clusters of vertices (Ng, Jordan, Weiss), and whether they are compact."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh
from sklearn.cluster import KMeans
from sklearn.metrics.cluster import contingency_matrix

from facelab.checks import check_choice, check_count, check_type
from facelab.geometry.mesh import TriangleMesh

LARGE = 1500  # vertices beyond which Lanczos beats a full decomposition


def spectral_embedding(A, k, rows="unit"):
    """Rows of the k leading eigenvectors of D^-1/2 A D^-1/2, scaled.

    Parameters
    ----------
    A : ndarray or sparse array of shape (n, n)
        Affinity; its diagonal is not used.
    k : int
    rows : {"unit", "degree"}
        Each row is scaled to length one, as in the paper; or divided by the square root of its
        vertex's sum of affinities, as scikit-learn's SpectralClustering does instead.

    Returns
    -------
    Y : ndarray of shape (n, k)

    References
    ----------
    Ng, Jordan and Weiss 2001, steps 1 to 4.
    """
    check_choice(rows, "rows", ("unit", "degree"))
    n = A.shape[0]
    k = check_count(k, "k", 1, n, f"clusters of {n} vertices")
    L, root = normalised(A)
    X = leading(L, k)
    return unit_rows(X) if rows == "unit" else X / root[:, None]


def normalised(A):
    """D^-1/2 A D^-1/2 without the diagonal of A, and the roots of the degrees."""
    if sp.issparse(A):
        return _normalised_sparse(A)
    A = np.array(A, dtype=float)
    np.fill_diagonal(A, 0)  # Ng, Jordan and Weiss, steps 1 and 2
    degree = A.sum(axis=1)
    root = np.sqrt(np.where(degree > 0, degree, 1))
    A /= root[:, None]
    A /= root
    return A, root


def _normalised_sparse(A):
    A = sp.csr_array(A)
    data, rows = A.data.copy(), np.repeat(np.arange(A.shape[0], dtype=np.int32), np.diff(A.indptr))
    L = sp.csr_array((data, A.indices, A.indptr), shape=A.shape)  # the places are A's own
    data[rows == L.indices] = 0
    degree = L.sum(axis=1, dtype=float)
    root = np.sqrt(np.where(degree > 0, degree, 1))
    data /= root.astype(data.dtype)[rows]
    data /= root.astype(data.dtype)[L.indices]
    return L, root


def leading(L, k):
    n = L.shape[0]
    if n > LARGE and k < n // 10:
        # any fixed start will do that is not an eigenvector itself
        values, X = eigsh(L, k, which="LA", v0=np.arange(1, n + 1, dtype=L.dtype))
        X = X[:, np.argsort(-values)].astype(float)
    else:
        L = L.toarray().astype(float) if sp.issparse(L) else L
        X = eigh(L, subset_by_index=[n - k, n - 1])[1][:, ::-1]
    # eigenvectors (step 3) have no sign of their own: the largest entry is made positive
    return X * np.sign(X[np.abs(X).argmax(axis=0), np.arange(k)])


def unit_rows(X):
    length = np.linalg.norm(X, axis=1, keepdims=True)  # step 4
    return X / np.where(length > 0, length, 1)


def cluster_rows(Y, k, n_init, random_state):
    """Clusters by k-means, numbered in the order of their first row."""
    labels = KMeans(k, n_init=n_init, random_state=random_state).fit_predict(Y)
    order = list(dict.fromkeys(labels.tolist()))
    return np.argsort(order)[labels]


def renumbered(labels, like):
    """The same clusters, numbered like those of another cut that they overlap most.

    Parameters
    ----------
    labels, like : ndarray of int, shape (n_vertices,)
        Two cuts of the same vertices.

    Returns
    -------
    ndarray of int, shape (n_vertices,)
        A cluster without a counterpart takes a number that `like` does not use.
    """
    names, theirs = np.unique(labels), np.unique(like)
    mine, counterpart = linear_sum_assignment(-contingency_matrix(labels, like))
    new = np.full(len(names), -1)
    new[mine] = theirs[counterpart]
    new[new < 0] = theirs.max() + 1 + np.arange((new < 0).sum())
    return new[np.searchsorted(names, labels)]


@dataclass(frozen=True, repr=False)
class Compactness:
    """What keeps one set of clusters from being compact. Printed, it says so in words.

    Parameters
    ----------
    k : int
        Number of clusters.
    cut_off : tuple of tuple of tuple of int
        For each cluster the vertices of all its connected pieces but the largest.
    loose : tuple of tuple of int
        For each cluster its vertices that are in no triangle wholly inside it.
    """

    k: int
    cut_off: tuple
    loose: tuple

    @property
    def pieces(self):
        """Number of connected pieces of each cluster: tuple of int."""
        return tuple(1 + len(rest) for rest in self.cut_off)

    @property
    def compact(self):
        """Whether every cluster is in one piece."""
        return not any(self.cut_off)

    @property
    def formed(self):
        """Whether every vertex is in a triangle wholly inside its cluster."""
        return not any(self.loose)

    def __repr__(self):
        split = [
            f"cluster {i} is in {1 + len(rest)} pieces (cut off: vertex {_listed(sum(rest, ()))})"
            for i, rest in enumerate(self.cut_off)
            if rest
        ]
        n_loose = sum(map(len, self.loose))
        return (
            f"k = {self.k:2d}: {'; '.join(split) or 'compact'}; "
            f"{n_loose} vertices without a triangle of their own"
        )


def _listed(vertices, most=6):
    shown = ", ".join(map(str, vertices[:most]))
    return shown + f" and {len(vertices) - most} more" * (len(vertices) > most)


def compactness(labels, mesh):
    """Whether clusters hang together on the mesh, by both readings of the paper.

    The paper calls a cluster non-compact "if some of its vertices do not form triangles on the
    template mesh". That can mean that it is in several pieces, or that some vertex is in no
    triangle wholly inside it. Both are reported.

    Parameters
    ----------
    labels : ndarray of int, shape (n_vertices,)
    mesh : TriangleMesh

    Returns
    -------
    Compactness

    Raises
    ------
    ValueError
        If there is not one label for each vertex.
    """
    labels = as_labels(labels, mesh)
    k = int(labels.max()) + 1
    inside = mesh.edges[labels[mesh.edges[:, 0]] == labels[mesh.edges[:, 1]]]
    graph = sp.coo_array((np.ones(len(inside)), inside.T), shape=mesh.adjacency.shape)
    piece = connected_components(graph, directed=False)[1]
    size = np.bincount(piece)
    cut_off = []
    for i in range(k):
        own = np.unique(piece[labels == i])
        rest = np.delete(own, size[own].argmax())
        cut_off.append(tuple(tuple(np.flatnonzero(piece == p).tolist()) for p in rest))
    whole = mesh.faces[(labels[mesh.faces] == labels[mesh.faces[:, :1]]).all(axis=1)]
    alone = np.ones(len(labels), dtype=bool)
    alone[whole] = False
    loose = tuple(tuple(np.flatnonzero(alone & (labels == i)).tolist()) for i in range(k))
    return Compactness(k, tuple(cut_off), loose)


def as_labels(labels, mesh):
    check_type(mesh, "mesh", TriangleMesh, "give the one that the labels are of")
    labels = np.asarray(labels)
    if labels.shape != (mesh.n_vertices,) or labels.dtype.kind not in "iu":
        raise ValueError(
            f"labels has shape {labels.shape} and type {labels.dtype}, but needs one integer "
            f"for each of the {mesh.n_vertices} vertices."
        )
    return labels
