"""Cut a face into regions by how its vertices move together and lie together.

Tena et al. 2011, section 4.2: correlation of the motion, distance along the mesh, spectral
clusters of both, as many as stay compact.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components
from sklearn.cluster import KMeans
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits
from tqdm.auto import tqdm

from facelab.errors import as_finite, check_choice, check_number
from facelab.mesh import TriangleMesh


def motion_correlation(positions, still=1e-6):
    """C-bar: how alike two vertices move, averaged over the three axes.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_vertices, 3)
        Millimetres.
    still : float, default=1e-6
        A coordinate whose standard deviation is at most this many millimetres does not move:
        its correlation with any other is 0/0 and counts as 0, with itself as 1.

    Returns
    -------
    C_bar : ndarray of shape (n_vertices, n_vertices)
        Between -1 and 1, diagonal 1.

    References
    ----------
    Tena et al. 2011, section 4.2: normalised correlation matrices C_x, C_y, C_z, averaged.
    """
    positions = as_finite(positions, "positions", ("n_frames", "n_vertices", 3))
    if len(positions) < 2:
        raise ValueError(f"positions has {len(positions)} frame(s); correlation needs 2 or more.")
    C_bar = np.zeros((positions.shape[1],) * 2)
    for axis in range(3):
        D = positions[:, :, axis] - positions[:, :, axis].mean(axis=0)
        size = np.sqrt((D**2).sum(axis=0))
        moves = size > still * np.sqrt(len(D))
        D = np.where(moves, D / np.where(moves, size, 1), 0)
        C_bar += D.T @ D / 3
    np.fill_diagonal(C_bar, 1)
    return C_bar.clip(-1, 1)


def affinity(C_bar, G, lam=0.7, r=10.0, threshold=0.7):
    """A: correlation and nearness in one matrix.

    Parameters
    ----------
    C_bar : ndarray of shape (n_vertices, n_vertices)
        From `motion_correlation`.
    G : ndarray of shape (n_vertices, n_vertices)
        Distances along the mesh, millimetres, from `TriangleMesh.geodesics`.
    lam : float, default=0.7
        λ: weight of the correlation, 0 to 1; 0 gives G-bar alone, 1 gives C-bar alone.
    r : float, default=10
        Distance over which nearness falls to 1/e, millimetres.
    threshold : float, default=0.7
        Correlations below it become 0.

    Returns
    -------
    A : ndarray of shape (n_vertices, n_vertices)
        Between 0 and 1, symmetric.

    References
    ----------
    Tena et al. 2011, Eq. 11 and 12.
    """
    lam = check_number(lam, "lam", low=0, high=1)
    r = check_number(r, "r", above=0)
    threshold = check_number(threshold, "threshold", low=0, high=1)
    if np.shape(C_bar) != np.shape(G):
        raise ValueError(f"C_bar has shape {np.shape(C_bar)}, G {np.shape(G)}; they must agree.")
    G_bar = np.exp(-np.asarray(G) / r)  # Eq. 11
    return lam * np.where(C_bar >= threshold, C_bar, 0) + (1 - lam) * G_bar  # Eq. 12


def spectral_embedding(A, k):
    """Rows of the k leading eigenvectors of D^-1/2 A D^-1/2, scaled to length one.

    Parameters
    ----------
    A : ndarray of shape (n, n)
        Affinity; its diagonal is not used.
    k : int

    Returns
    -------
    Y : ndarray of shape (n, k)

    References
    ----------
    Ng, Jordan and Weiss 2001, steps 1 to 4. scikit-learn's SpectralClustering leaves out the
    last of them, the scaling of the rows, and finds other clusters.
    """
    return _leading(_normalised(A), k)


def _normalised(A):
    A = np.array(A, dtype=float)
    np.fill_diagonal(A, 0)
    degree = A.sum(axis=1)
    scale = 1 / np.sqrt(np.where(degree > 0, degree, 1))
    return A * scale[:, None] * scale


def _leading(L, k):
    n = len(L)
    _, vectors = eigh(L, subset_by_index=[n - k, n - 1])
    vectors = vectors[:, ::-1]
    signs = np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(k)])
    Y = vectors * signs
    length = np.linalg.norm(Y, axis=1, keepdims=True)
    return Y / np.where(length > 0, length, 1)


def spectral_clusters(A, k, n_init=20, random_state=None):
    """Cluster number of each vertex, 0 to k - 1, by spectral clustering.

    Parameters
    ----------
    A : ndarray of shape (n, n)
    k : int
    n_init : int, default=20
        Runs of k-means; the one with the smallest sum of distances to the centres is kept.
    random_state : int, RandomState or None

    Returns
    -------
    labels : ndarray of int, shape (n,)
        Numbered in the order of their first vertex, so that a rerun looks the same.

    References
    ----------
    Ng, Jordan and Weiss 2001; Tena et al. 2011, section 4.2 (20 runs).
    """
    if not 1 <= k <= len(A):
        raise ValueError(f"k={k}, but {len(A)} vertices allow 1 to {len(A)} clusters.")
    return _cluster_rows(spectral_embedding(A, k), k, n_init, random_state)


def _cluster_rows(Y, k, n_init, random_state):
    labels = KMeans(k, n_init=n_init, random_state=random_state).fit_predict(Y)
    order = list(dict.fromkeys(labels.tolist()))
    return np.argsort(order)[labels]


@dataclass(frozen=True)
class Compactness:
    """What keeps one set of clusters from being compact.

    Parameters
    ----------
    k : int
        Number of clusters.
    pieces : tuple of int
        Connected pieces of each cluster on the mesh; more than one stops the growth of k.
    loose : tuple of int
        Vertices of each cluster that are in no triangle wholly inside it.
    """

    k: int
    pieces: tuple
    loose: tuple

    @property
    def compact(self):
        """Whether every cluster is in one piece."""
        return max(self.pieces) == 1

    def __str__(self):
        split = [i for i, p in enumerate(self.pieces) if p > 1]
        reason = (
            "compact"
            if self.compact
            else f"cluster {split[0]} is in {self.pieces[split[0]]} pieces"
        )
        return (
            f"k = {self.k:2d}: {reason}; {sum(self.loose)} vertices without a triangle of their own"
        )


def compactness(labels, mesh):
    """Whether clusters hang together on the mesh, by both readings of the paper.

    The paper calls a cluster non-compact "if some of its vertices do not form triangles on the
    template mesh". We stop on clusters in several pieces, and report vertices without a
    triangle wholly inside their cluster as well.

    Parameters
    ----------
    labels : ndarray of int, shape (n_vertices,)
    mesh : TriangleMesh

    Returns
    -------
    Compactness
    """
    labels = np.asarray(labels)
    k = int(labels.max()) + 1
    inside = mesh.edges[labels[mesh.edges[:, 0]] == labels[mesh.edges[:, 1]]]
    graph = sp.coo_array((np.ones(len(inside)), inside.T), shape=mesh.adjacency.shape)
    piece = connected_components(graph, directed=False)[1]
    pieces = tuple(len(np.unique(piece[labels == i])) for i in range(k))
    whole = mesh.faces[(labels[mesh.faces] == labels[mesh.faces[:, :1]]).all(axis=1)]
    formed = np.zeros(len(labels), dtype=bool)
    formed[whole] = True
    loose = tuple(int((~formed[labels == i]).sum()) for i in range(k))
    return Compactness(k, pieces, loose)


@dataclass(frozen=True, eq=False)
class Regions:
    """A face cut into regions that share vertices along their boundaries.

    Parameters
    ----------
    labels : ndarray of int, shape (n_vertices,)
        The one region each vertex belongs to of itself, 0 to n_regions - 1.
    mesh : TriangleMesh
    sharing : {"one-sided", "both", "none"}
        For every edge that crosses from region i to a later region j: the end in i belongs to j
        too; both ends belong to both; nothing is shared.
    rings : int, default=1
        Width of the shared band in edges.
    tried : tuple of Compactness
        What was seen while the number of regions grew.
    held : ndarray of bool, shape (n_regions, n_vertices), optional
        Which region holds which vertex, if not by the rule of `sharing` on this mesh.
    samples : ndarray of int, optional
        The vertices between which the shared bands were drawn, if not all of this mesh: those of
        the control mesh that the regions were carried over from.

    Raises
    ------
    ValueError
        If a label is missing or a vertex has none, or if `held` leaves a vertex out of its region.

    References
    ----------
    Tena et al. 2011, section 3.1: regions share boundary vertices. Their authors chose them by
    hand; the rule here is ours.
    """

    labels: np.ndarray
    mesh: TriangleMesh
    sharing: str = "one-sided"
    rings: int = 1
    tried: tuple = ()
    held: np.ndarray = None
    samples: np.ndarray = None

    def __post_init__(self):
        labels = np.asarray(self.labels)
        if labels.shape != (self.mesh.n_vertices,) or labels.dtype.kind not in "iu":
            raise ValueError(
                f"labels has shape {labels.shape} and type {labels.dtype}, but needs one integer "
                f"for each of the {self.mesh.n_vertices} vertices."
            )
        missing = sorted(set(range(int(labels.max()) + 1)) - set(labels.tolist()))
        if labels.min() < 0 or missing:
            raise ValueError(
                f"labels must use every number from 0 up; smallest {labels.min()}, "
                f"unused {missing[:5]}."
            )
        check_choice(self.sharing, "sharing", ("one-sided", "both", "none"))
        if self.rings < 1:
            raise ValueError(f"rings={self.rings}, but a shared band is 1 or more edges wide.")
        object.__setattr__(self, "labels", labels)
        if self.held is not None:
            held, wanted = np.asarray(self.held), (self.n_regions, self.mesh.n_vertices)
            if held.shape != wanted or not held[labels, np.arange(wanted[1])].all():
                raise ValueError(
                    f"held has shape {held.shape}, but needs shape {wanted} and True for each "
                    "vertex in the region of its label."
                )
            object.__setattr__(self, "held", held.astype(bool))

    def __repr__(self):
        return (
            f"Regions({self.n_regions} on {self.mesh.n_vertices} vertices, "
            f"{100 * self.shared_share:.0f} % of them shared)"
        )

    @property
    def n_regions(self):
        """M: number of regions."""
        return int(self.labels.max()) + 1

    @cached_property
    def members(self):
        """Vertices of each region, its own and the shared ones, ascending: list of int arrays."""
        if self.held is not None:
            return [np.flatnonzero(m) for m in self.held]
        member = np.zeros((self.n_regions, self.mesh.n_vertices), dtype=bool)
        member[self.labels, np.arange(self.mesh.n_vertices)] = True
        if self.sharing != "none":
            a, b = self.mesh.edges.T
            both = np.vstack([np.stack([a, b], axis=1), np.stack([b, a], axis=1)])
            for _ in range(self.rings):
                grown = member.copy()
                for i in range(self.n_regions):
                    reached = both[member[i][both[:, 0]], 1]
                    if self.sharing == "one-sided":  # only later regions reach into earlier ones
                        reached = reached[self.labels[reached] <= i]
                    grown[i, reached] = True
                member = grown
        return [np.flatnonzero(m) for m in member]

    @cached_property
    def holders(self):
        """Number of regions that hold each vertex: ndarray of int, shape (n_vertices,)."""
        return np.bincount(np.concatenate(self.members), minlength=self.mesh.n_vertices)

    @property
    def shared_share(self):
        """Share of the vertices that more than one region holds, 0 to 1."""
        return float((self.holders > 1).mean())

    def carried_to(self, mesh, samples):
        """The same regions on a dense mesh: each vertex is held by those of its nearest sample.

        The shared bands keep their width in millimetres. Drawn anew along the finer edges they
        would be narrower, regions would hang together less, and a vertex shared on the control
        mesh would be one region's alone on the dense one.

        Parameters
        ----------
        mesh : TriangleMesh
            The dense mesh.
        samples : ndarray of int, shape (n_vertices of these regions,)
            Where the vertices of these regions lie on it.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If there is not one sample for each vertex of these regions.
        """
        if len(np.atleast_1d(samples)) != self.mesh.n_vertices:
            raise ValueError(
                f"samples names {len(np.atleast_1d(samples))} vertices, but these regions lie on "
                f"{self.mesh.n_vertices}; give the place of each of them on the dense mesh."
            )
        nearest = mesh.nearest_of(samples)
        held = np.zeros((self.n_regions, self.mesh.n_vertices), dtype=bool)
        for region, vertices in zip(held, self.members, strict=True):
            region[vertices] = True
        samples = np.asarray(samples)
        drawn = samples if self.samples is None else samples[self.samples]
        return Regions(
            self.labels[nearest],
            mesh,
            self.sharing,
            self.rings,
            self.tried,
            held[:, nearest],
            drawn,
        )


def segment_face(
    motion,
    lam=0.7,
    r=10.0,
    threshold=0.7,
    n_regions=None,
    max_regions=30,
    sharing="one-sided",
    n_init=20,
    random_state=None,
    progress=True,
):
    """Cut a face into regions from its motion.

    Parameters
    ----------
    motion : MotionSequence
        On a mesh in one piece; about 400 vertices are quick, 15 frames a second are enough.
    lam, r, threshold : float
        λ, r and the threshold on the correlation, see `affinity`.
    n_regions : int, optional
        Number of regions. If left out, k grows from 2 until a cluster is in several pieces and
        the last k before that is taken.
    max_regions : int, default=30
        Where the growth ends in any case.
    sharing : {"one-sided", "both", "none"}
        Which vertices two neighbours share, see `Regions`.
    n_init : int, default=20
        Runs of k-means for each k.
    random_state : int, RandomState or None
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    Regions
        `tried` tells for each k whether it was compact.

    Raises
    ------
    ValueError
        For a mesh in several pieces, fewer than two valid frames, or a parameter out of range.

    References
    ----------
    Tena et al. 2011, section 4.2, Eq. 11 and 12.
    """
    mesh = motion.mesh
    C_bar = motion_correlation(motion.positions[motion.valid])
    A = affinity(C_bar, mesh.geodesics(), lam, r, threshold)
    seed = int(check_random_state(random_state).randint(2**31 - 1))
    with threadpool_limits(1):  # matrices this small lose time on several threads
        if n_regions is not None:
            labels = spectral_clusters(A, n_regions, n_init, seed)
            return Regions(labels, mesh, sharing, tried=(compactness(labels, mesh),))
        L = _normalised(A)
        best, tried = np.zeros(mesh.n_vertices, dtype=int), []
        most = min(max_regions, mesh.n_vertices)
        with tqdm(desc="regions tried", disable=not progress, leave=False) as bar:
            for k in range(2, most + 1):
                labels = _cluster_rows(_leading(L, k), k, n_init, seed)
                tried.append(compactness(labels, mesh))
                bar.update()
                if not tried[-1].compact:
                    break
                best = labels
            else:
                warnings.warn(
                    f"every k up to max_regions={most} is compact, so the motion sets no number of "
                    f"regions: {most} are taken. Choose one with n_regions.",
                    stacklevel=2,
                )
    return Regions(best, mesh, sharing, tried=tuple(tried))
