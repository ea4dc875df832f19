"""Cut a face into regions by how its vertices move together and lie together.

Tena et al. 2011, section 4.2: correlation of the motion, distance along the mesh, spectral
clusters of both, as many as stay compact.
"""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh
from sklearn.cluster import KMeans
from sklearn.metrics import adjusted_rand_score
from sklearn.metrics.cluster import contingency_matrix
from sklearn.utils import check_random_state
from threadpoolctl import threadpool_limits
from tqdm.auto import tqdm

from facelab.errors import as_finite, check_choice, check_count, check_number, check_type
from facelab.mesh import TriangleMesh
from facelab.motion import MotionSequence

_LARGE = 1500  # vertices beyond which Lanczos beats a full decomposition


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
    positions = np.asarray(positions)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(
            f"positions has shape {positions.shape}, but needs shape (n_frames, n_vertices, 3)."
        )
    n_frames, n_vertices, _ = positions.shape
    if n_frames < 2:
        raise ValueError(f"positions has {n_frames} frame(s); correlation needs 2 or more.")
    C_bar = np.zeros((n_vertices, n_vertices))
    for axis in range(3):  # one at a time: a dense face fills the memory soon enough
        name = f"positions[:, :, {axis}]"
        D = as_finite(positions[:, :, axis], name, ("n_frames", "n_vertices"))
        D = D - D.mean(axis=0)
        size = np.sqrt((D**2).sum(axis=0))
        moves = size > still * np.sqrt(n_frames)
        D /= np.where(moves, size, np.inf) * np.sqrt(3)  # the average of three
        C_bar += D.T @ D
    np.fill_diagonal(C_bar, 1)
    return np.clip(C_bar, -1, 1, out=C_bar)


def nearness(G, r=10.0):
    """G-bar: 1 for a vertex and itself, falling to 0 with the distance along the mesh.

    Parameters
    ----------
    G : ndarray of shape (n_vertices, n_vertices)
        Distances along the mesh, millimetres, from `TriangleMesh.geodesics`.
    r : float, default=10
        Distance over which it falls to 1/e, millimetres.

    Returns
    -------
    G_bar : ndarray of shape (n_vertices, n_vertices)

    References
    ----------
    Tena et al. 2011, Eq. 11.
    """
    r = check_number(r, "r", above=0)
    G_bar = np.divide(G, -r)
    return np.exp(G_bar, out=G_bar)


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
    threshold = check_number(threshold, "threshold", low=0, high=1)
    C_bar = as_finite(C_bar, "C_bar", ("n_vertices", "n_vertices"))
    if np.shape(C_bar) != np.shape(G):
        raise ValueError(f"C_bar has shape {np.shape(C_bar)}, G {np.shape(G)}; they must agree.")
    A = nearness(G, r)  # Eq. 11
    A *= 1 - lam
    np.add(A, np.multiply(C_bar, lam), out=A, where=C_bar >= threshold)  # Eq. 12
    return A


def spectral_embedding(A, k, rows="unit"):
    """Rows of the k leading eigenvectors of D^-1/2 A D^-1/2, scaled.

    Parameters
    ----------
    A : ndarray of shape (n, n)
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
    k = check_count(k, "k", 1, len(A), f"clusters of {len(A)} vertices")
    L, root = _normalised(A)
    X = _leading(L, k)
    return _unit_rows(X) if rows == "unit" else X / root[:, None]


def _normalised(A):
    """D^-1/2 A D^-1/2 without the diagonal of A, and the roots of the degrees."""
    A = np.array(A, dtype=float)
    np.fill_diagonal(A, 0)
    degree = A.sum(axis=1)
    root = np.sqrt(np.where(degree > 0, degree, 1))
    A /= root[:, None]
    A /= root
    return A, root


def _leading(L, k):
    n = len(L)
    if n > _LARGE and k < n // 10:
        # any fixed start will do that is not an eigenvector itself
        values, X = eigsh(L, k, which="LA", v0=np.arange(1.0, n + 1))
        X = X[:, np.argsort(-values)]
    else:
        X = eigh(L, subset_by_index=[n - k, n - 1])[1][:, ::-1]
    return X * np.sign(X[np.abs(X).argmax(axis=0), np.arange(k)])


def _unit_rows(X):
    length = np.linalg.norm(X, axis=1, keepdims=True)
    return X / np.where(length > 0, length, 1)


def _cluster_rows(Y, k, n_init, random_state):
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
    labels = _as_labels(labels, mesh)
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


def _as_labels(labels, mesh):
    labels = np.asarray(labels)
    if labels.shape != (mesh.n_vertices,) or labels.dtype.kind not in "iu":
        raise ValueError(
            f"labels has shape {labels.shape} and type {labels.dtype}, but needs one integer "
            f"for each of the {mesh.n_vertices} vertices."
        )
    return labels


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
    why : str
        In words, why there are as many regions as there are.
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
    why: str = "The labels were given."

    def __post_init__(self):
        labels = _as_labels(self.labels, self.mesh)
        missing = sorted(set(range(int(labels.max()) + 1)) - set(labels.tolist()))
        if labels.min() < 0 or missing:
            raise ValueError(
                f"labels must use every number from 0 up; smallest {labels.min()}, "
                f"unused {missing[:5]}."
            )
        check_choice(self.sharing, "sharing", ("one-sided", "both", "none"))
        what = "edges across a shared band (to share nothing, set sharing='none')"
        check_count(self.rings, "rings", 1, None, what)
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

    @property
    def order(self):
        """Vertices sorted by region, to show a matrix as blocks: A[np.ix_(order, order)]."""
        return np.argsort(self.labels, kind="stable")

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
        return replace(
            self, labels=self.labels[nearest], mesh=mesh, held=held[:, nearest], samples=drawn
        )


@dataclass(frozen=True, eq=False)
class Likeness:
    """How alike the vertices of a face are: in motion, in place, and in both.

    The matrices are found once; other settings cost a fraction of that: `likeness.with_(lam=0.5)`.

    Parameters
    ----------
    mesh : TriangleMesh
        In one piece.
    C_bar : ndarray of shape (n_vertices, n_vertices)
        From `motion_correlation`.
    G : ndarray of shape (n_vertices, n_vertices)
        Distances along the mesh, millimetres.
    lam, r, threshold : float
        λ, r and the threshold on the correlation, see `affinity`.

    References
    ----------
    Tena et al. 2011, section 4.2, Eq. 11 and 12.
    """

    mesh: TriangleMesh
    C_bar: np.ndarray
    G: np.ndarray
    lam: float = 0.7
    r: float = 10.0
    threshold: float = 0.7

    @classmethod
    def of(cls, motion, lam=0.7, r=10.0, threshold=0.7):
        """Measure the likeness of the vertices in a motion; lost frames do not count.

        Parameters
        ----------
        motion : MotionSequence
        lam, r, threshold : float

        Raises
        ------
        TypeError
            If `motion` is something else, such as an array of positions.
        ValueError
            For a mesh in several pieces or fewer than two valid frames.
        """
        check_type(motion, "motion", MotionSequence, "MotionSequence(positions, fps, mesh)")
        motion.mesh.check_connected()
        positions = motion.positions if motion.valid.all() else motion.positions[motion.valid]
        C_bar = motion_correlation(positions)
        return cls(motion.mesh, C_bar, motion.mesh.geodesics(), lam, r, threshold)

    def with_(self, **settings):
        """The same motion and mesh with another `lam`, `r` or `threshold`."""
        return replace(self, **settings)

    @cached_property
    def G_bar(self):
        """Nearness, Eq. 11: ndarray of shape (n_vertices, n_vertices)."""
        return nearness(self.G, self.r)

    @cached_property
    def A(self):
        """Affinity, Eq. 12: ndarray of shape (n_vertices, n_vertices)."""
        return affinity(self.C_bar, self.G, self.lam, self.r, self.threshold)

    def segment(
        self,
        n_regions=None,
        max_regions=30,
        reading="pieces",
        sharing="one-sided",
        rings=1,
        n_init=20,
        random_state=None,
        progress=True,
    ):
        """Cut the face into regions; parameters and result as in `segment_face`."""
        mesh, n = self.mesh, self.mesh.n_vertices
        if n_regions is not None:
            what = f"clusters of {n} vertices"
            n_regions = check_count(n_regions, "n_regions", 1, n, what)
        max_regions = min(check_count(max_regions, "max_regions", 1, None, "clusters"), n)
        n_init = check_count(n_init, "n_init", 1, None, "runs of k-means")
        check_choice(reading, "reading", ("pieces", "triangles"))
        seed = int(check_random_state(random_state).randint(2**31 - 1))
        best, tried = np.zeros(n, dtype=int), []
        # matrices as small as the paper's lose time on several threads
        with (
            threadpool_limits(1 if n <= _LARGE else None),
            tqdm(desc="regions tried", disable=not progress, leave=False) as bar,
        ):
            X = _leading(_normalised(self.A)[0], n_regions or max_regions)
            for k in [n_regions] if n_regions else range(2, max_regions + 1):
                labels = _cluster_rows(_unit_rows(X[:, :k]), k, n_init, seed)
                tried.append(compactness(labels, mesh))
                bar.update()
                if not n_regions and not _holds(tried[-1], reading):
                    break
                best = labels
            else:
                if not n_regions and tried:
                    warnings.warn(
                        f"every k up to max_regions={max_regions} is compact, so the motion sets "
                        f"no number of regions: {max_regions} are taken. Choose with n_regions.",
                        stacklevel=3,
                    )
        why = _why(tried, reading, asked=n_regions is not None)
        return Regions(best, mesh, sharing, rings, tuple(tried), why=why)


def _holds(seen, reading):
    return seen.compact if reading == "pieces" else seen.formed


def _why(tried, reading, asked):
    """Why the number of regions is what it is, from what was seen for each k."""
    if asked:
        return f"n_regions={tried[0].k} was asked for. {tried[0]}."
    if not tried:
        return "max_regions=1 was asked for."
    last = tried[-1]
    words = {
        "pieces": "every cluster in one piece",
        "triangles": "every vertex in a triangle of its own cluster",
    }
    other = "triangles" if reading == "pieces" else "pieces"
    if _holds(last, reading):
        text = f"{words[reading].capitalize()} up to k = {last.k}, the most allowed (max_regions)."
    else:
        text = f"{words[reading].capitalize()} up to k = {last.k - 1}, then no more. {last}."
    fails = [seen.k for seen in tried if not _holds(seen, other)]
    so_far = f"would have stopped at k = {fails[0] - 1}" if fails else "would have gone on"
    return f"{text} The other reading, {words[other]}, {so_far}."


def segment_face(
    motion,
    lam=0.7,
    r=10.0,
    threshold=0.7,
    n_regions=None,
    max_regions=30,
    reading="pieces",
    sharing="one-sided",
    rings=1,
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
        Number of regions. If left out, k grows from 2 until the clusters are no longer compact
        and the last k before that is taken.
    max_regions : int, default=30
        Where the growth ends in any case.
    reading : {"pieces", "triangles"}
        What compact means: every cluster in one piece, or every vertex in a triangle wholly
        inside its cluster. The paper's words allow both, see `compactness`.
    sharing : {"one-sided", "both", "none"}
        Which vertices two neighbours share, see `Regions`.
    rings : int, default=1
        Width of the shared band in edges.
    n_init : int, default=20
        Runs of k-means for each k.
    random_state : int, RandomState or None
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    Regions
        `tried` tells for each k whether it was compact, `why` what ended the growth.

    Raises
    ------
    TypeError
        If `motion` is no MotionSequence or `n_regions` no integer.
    ValueError
        For a mesh in several pieces, fewer than two valid frames, or a parameter out of range.

    References
    ----------
    Tena et al. 2011, section 4.2, Eq. 11 and 12.
    """
    return Likeness.of(motion, lam, r, threshold).segment(
        n_regions, max_regions, reading, sharing, rings, n_init, random_state, progress
    )


def stability(
    motion,
    n_regions,
    over="frames",
    n_draws=20,
    block=2.0,
    n_init=20,
    random_state=None,
    **settings,
):
    """How much a cut changes when the data, or only the seed, is drawn anew.

    Parameters
    ----------
    motion : MotionSequence
    n_regions : int
    over : {"frames", "seeds"}
        Frames are drawn with replacement, in blocks, since neighbours in time are alike (a
        moving-block bootstrap); or the frames stay and only k-means starts anew.
    n_draws : int, default=20
    block : float, default=2
        Length of a block, seconds.
    n_init : int, default=20
        Runs of k-means in each draw.
    random_state : int, RandomState or None
    **settings
        `lam`, `r` and `threshold` of `Likeness`.

    Returns
    -------
    scores : ndarray of shape (n_draws,)
        Adjusted Rand index of each draw against the cut of all frames; 1 is the same cut.
    labels : ndarray of int, shape (n_draws, n_vertices)

    Raises
    ------
    ValueError
        If a block is longer than the motion.
    """
    check_choice(over, "over", ("frames", "seeds"))
    n_draws = check_count(n_draws, "n_draws", 1, None, "draws")
    rng = check_random_state(random_state)
    whole = Likeness.of(motion, **settings)
    frames = np.flatnonzero(motion.valid)
    length = max(1, round(check_number(block, "block", above=0) * motion.fps))
    if length > len(frames):
        raise ValueError(
            f"block={block:g} s is {length} frames, but the motion has {len(frames)}; shorten it."
        )

    def cut(likeness):
        seed = rng.randint(2**31 - 1)
        return likeness.segment(n_regions, n_init=n_init, random_state=seed, progress=False).labels

    reference, labels = cut(whole), []
    for _ in range(n_draws):
        drawn = whole
        if over == "frames":
            starts = rng.randint(len(frames) - length + 1, size=-(-len(frames) // length))
            picked = frames[(starts[:, None] + np.arange(length)).ravel()[: len(frames)]]
            drawn = whole.with_(C_bar=motion_correlation(motion.positions[picked]))
        labels.append(cut(drawn))
    return np.array([adjusted_rand_score(reference, x) for x in labels]), np.array(labels)
