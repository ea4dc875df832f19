"""Principal components of frames in a Dask array, which no single machine need hold."""

import numpy as np

from facelab.checks import as_finite
from facelab.models.components import as_sets
from facelab.numeric.engine import block_sums
from facelab.numeric.seeds import as_random_state


def components_of_dask(X, columns, n_components, random_state=0, passes=4, progress=True):
    """Principal components of several sets of columns of a Dask array.

    The sums of `components_of_blocks`, taken where the blocks are: a set of up to `LARGEST_EXACT`
    columns is exact, a wider one is found by the same randomised SVD. (Dask's own
    `svd_compressed` keeps all frames on the workers, or all workers waiting.)

    Parameters
    ----------
    X : dask.array.Array of shape (n_frames, n_features)
        In blocks of some frames; each is read once in a pass and not kept.
    columns : callable
        Takes n_features and gives the sets: a list of ndarray of int.
    n_components : int
        Modes of each set; fewer of a set that has fewer columns.
    random_state : int, RandomState or None
    passes : int, default=4
        Over the frames, where a set is wide.
    progress : ignored
        The engine has its own.

    Returns
    -------
    n_frames : int
    mean : ndarray of shape (n_features,)
    components, variances : lists of ndarray
        Of each set, as from `principal_components`.

    Raises
    ------
    ValueError
        For values that are not finite, or fewer than 2 frames.
    Killed
        If workers were lost again and again on the same block.

    References
    ----------
    Halko, Martinsson and Tropp 2011, section 4.5; Chan, Golub and LeVeque 1983.
    """
    if X.ndim != 2:
        raise ValueError(f"X has {X.ndim} axes, but needs shape (n_frames, n_features).")
    n_features = X.shape[1]
    rng = as_random_state(random_state)
    sets = as_sets(columns(n_features), n_components, passes, rng)
    # counted from a place near the mean, little is lost when that is taken off
    n_first, first = block_sums(X.blocks[0], _sums, np.zeros(n_features), [], 1)
    shift = first / max(n_first, 1)
    for number in range(1, max(s.passes for s in sets) + 1):
        open_sets = [s for s in sets if number <= s.passes]
        n_frames, total, *sums = block_sums(X, _sums, shift, open_sets, number)
        if n_frames < 2:
            raise ValueError(f"X has {n_frames} frame(s) in all; give 2 or more.")
        off = total / n_frames
        for s, found in zip(open_sets, sums, strict=True):
            s.sum = found
            s.end_pass(off, n_frames, number)
        shift = shift + off
    found = [s.result(n_frames) for s in sets]
    return n_frames, shift, [B for B, _ in found], [v for _, v in found]


def _sums(block, number, shift, sets, which_pass):
    """Number of frames, their sum, and what each set sums up, counted from `shift`."""
    D = as_finite(block, "X", ("n_frames", len(shift)), f"block {number}") - shift
    return [len(D), D.sum(axis=0), *(s.part(D, which_pass) for s in sets)]
