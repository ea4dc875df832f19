"""Cut a face into regions by how its vertices move together and lie together.

Tena et al. 2011, section 4.2: correlation of the motion, distance along the mesh, spectral
clusters of both, as many as stay compact.
"""

import warnings
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from sklearn.metrics import adjusted_rand_score
from tqdm.auto import tqdm

from facelab.checks import check_choice, check_count, check_number, check_type
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.motion import MotionSequence
from facelab.numeric.seeds import as_random_state
from facelab.numeric.threads import one_thread
from facelab.segmentation.clusters import (
    LARGE,
    cluster_rows,
    compactness,
    leading,
    normalised,
    unit_rows,
)
from facelab.segmentation.dense import Correlations, Distances, sparse_affinity
from facelab.segmentation.regions import Regions
from facelab.segmentation.similarity import affinity, motion_correlation, nearness


@dataclass(frozen=True, eq=False)
class Affinity:
    """How alike the vertices of a face are: in motion, in place, and in both. It cuts the face.

    The matrices are found once; other settings cost a fraction of that: `affinity.with_(lam=0.5)`.

    Parameters
    ----------
    mesh : TriangleMesh
        In one piece.
    C_bar : ndarray of shape (n_vertices, n_vertices), or Correlations
        From `motion_correlation`; of more than 1,500 vertices rows are found when asked for.
    G : ndarray of shape (n_vertices, n_vertices), or Distances
        Distances along the mesh, millimetres; again rows when asked for, where vertices are many.
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
    def of(cls, motion, **settings):
        """Measure the affinity of the vertices in a motion; lost frames do not count.

        Parameters
        ----------
        motion : MotionSequence
        **settings
            `lam`, `r` and `threshold`, where they are not those of the paper.

        Raises
        ------
        TypeError
            If `motion` is something else, such as an array of positions.
        ValueError
            For a mesh in several pieces or fewer than two valid frames.

        Warns
        -----
        UserWarning
            For frames that are all alike, which say nothing of how the face moves.
        """
        check_type(motion, "motion", MotionSequence, "MotionSequence(positions, fps, mesh)")
        motion.mesh.check_connected()
        check_face_size(motion.mesh.vertices, "motion")
        positions = motion.positions if motion.valid.all() else motion.positions[motion.valid]
        if len(positions) < 2:
            raise ValueError(
                f"motion has {len(positions)} frame(s) that are valid, but correlation needs 2 or "
                "more; give a longer take."
            )
        if all((frame == positions[0]).all() for frame in positions):
            warnings.warn(
                f"motion holds still: all its {len(positions)} frames are alike, so the face is "
                "cut by place alone; give a take in which it moves.",
                stacklevel=3,
            )
        mesh = motion.mesh
        G = Distances(mesh) if mesh.n_vertices > LARGE else mesh.geodesics()
        return cls(mesh, _correlation(positions), G, **settings)

    def with_(self, **settings):
        """The same motion and mesh with another `lam`, `r` or `threshold`."""
        return replace(self, **settings)

    @cached_property
    def G_bar(self):
        """Nearness, Eq. 11: ndarray of shape (n_vertices, n_vertices)."""
        return nearness(self.G, self.r)

    @cached_property
    def A(self):
        """Affinity, Eq. 12: ndarray of shape (n_vertices, n_vertices); sparse if they are many."""
        if isinstance(self.C_bar, Correlations) and isinstance(self.G, Distances):
            return sparse_affinity(self.C_bar, self.G, self.lam, self.r, self.threshold)
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
        """Cut the face into regions: spectral clusters, as many as stay compact.

        Parameters
        ----------
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
            If `n_regions` is no integer.
        ValueError
            For a parameter out of range.

        References
        ----------
        Tena et al. 2011, section 4.2.
        """
        mesh, n = self.mesh, self.mesh.n_vertices
        if n_regions is not None:
            what = f"clusters of {n} vertices"
            n_regions = check_count(n_regions, "n_regions", 1, n, what)
        max_regions = min(check_count(max_regions, "max_regions", 1, None, "clusters"), n)
        n_init = check_count(n_init, "n_init", 1, None, "runs of k-means")
        check_choice(reading, "reading", ("pieces", "triangles"))
        seed = int(as_random_state(random_state).randint(2**31 - 1))
        best, tried = np.zeros(n, dtype=int), []
        # matrices as small as the paper's lose time on several threads
        with (
            one_thread() if n <= LARGE else nullcontext(),
            tqdm(desc="regions tried", disable=not progress, leave=False) as bar,
        ):
            X = leading(normalised(self.A)[0], n_regions or max_regions)
            for k in [n_regions] if n_regions else range(2, max_regions + 1):
                labels = cluster_rows(unit_rows(X[:, :k]), k, n_init, seed)
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


def _correlation(positions):
    dense = positions.shape[1] > LARGE
    return Correlations(positions) if dense else motion_correlation(positions)


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


def segment_face(motion, lam=0.7, r=10.0, threshold=0.7, **settings):
    """Cut a face into regions from its motion.

    Parameters
    ----------
    motion : MotionSequence
        On a mesh in one piece; about 400 vertices are quick, 15 frames a second are enough.
    lam, r, threshold : float
        λ, r and the threshold on the correlation, see `affinity`.
    **settings
        Of the cut: `n_regions` (found if left out), `max_regions`, `reading`, `sharing`, `rings`,
        `n_init`, `random_state` and `progress`, see `Affinity.segment`.

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

    Examples
    --------
    >>> import facelab
    >>> motion = facelab.load_registered("M1", size="small", progress=False).motion("train")
    >>> facelab.segment_face(motion, n_regions=6, random_state=0, progress=False).n_regions
    6
    """
    return Affinity.of(motion, lam=lam, r=r, threshold=threshold).segment(**settings)


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
        `lam`, `r` and `threshold` of `Affinity`.

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
    rng = as_random_state(random_state)
    whole = Affinity.of(motion, **settings)
    frames = np.flatnonzero(motion.valid)
    length = max(1, round(check_number(block, "block", above=0) * motion.fps))
    if length > len(frames):
        raise ValueError(
            f"block={block:g} s is {length} frames, but the motion has {len(frames)}; shorten it."
        )

    def cut(measured):
        seed = rng.randint(2**31 - 1)
        return measured.segment(n_regions, n_init=n_init, random_state=seed, progress=False).labels

    reference, labels = cut(whole), []
    for _ in range(n_draws):
        drawn = whole
        if over == "frames":
            starts = rng.randint(len(frames) - length + 1, size=-(-len(frames) // length))
            picked = frames[(starts[:, None] + np.arange(length)).ravel()[: len(frames)]]
            drawn = whole.with_(C_bar=_correlation(motion.positions[picked]))
        labels.append(cut(drawn))
    return np.array([adjusted_rand_score(reference, x) for x in labels]), np.array(labels)
