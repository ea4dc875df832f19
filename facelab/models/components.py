"""Principal components of motion: of frames in memory, or of frames that come in blocks.

Several sets of columns (the regions of a face) are decomposed in the same passes over the frames.
"""

import mmap

import numpy as np
from scipy.linalg import eigh
from tqdm.auto import tqdm

from facelab.checks import as_finite
from facelab.numeric.seeds import as_random_state
from facelab.numeric.threads import one_thread

LARGEST_EXACT = 1500
"""Square matrices up to this size are decomposed exactly; larger ones by a randomised SVD."""

BLOCK_BYTES = 2**24
"""Frames of a large array are read in blocks of this size, counted in float64."""


CACHED = 2**18
"""Numbers of frames in memory that are worked on at a time: as many as a processor keeps near."""


def check_moves(variances, mean):
    """Refuse frames whose largest variance is no more than the rounding of their mean."""
    if not max(v.max(initial=0) for v in variances) > 1e-12 * (mean @ mean):
        raise ValueError(
            "X holds still: all its frames are alike, so there is nothing to learn; give frames "
            "in which the face moves."
        )


def principal_components(X, n_components):
    """Mean, leading principal components and their variances.

    The smaller of covariance and Gram matrix is decomposed.

    Parameters
    ----------
    X : ndarray of shape (n_frames, n_features)
    n_components : int
        0 to min(n_frames, n_features).

    Returns
    -------
    mean : ndarray of shape (n_features,)
    components : ndarray of shape (n_components, n_features)
        Orthonormal rows, strongest first; the entry of largest magnitude in each is positive.
    variances : ndarray of shape (n_components,)
    """
    n_frames, n_features = X.shape
    mean = X.mean(axis=0)
    D = X - mean
    wide = n_features > n_frames
    square = D @ D.T if wide else D.T @ D
    variances, components = _leading(square / max(n_frames - 1, 1), n_components)
    if wide:  # D D^T u = s u gives D^T D (D^T u) = s (D^T u): the same variances
        components = D.T @ components
    return mean, _signed(components), variances


def components_of_sets(X, columns, n_components):
    """Principal components of several sets of columns of the same frames.

    Parameters
    ----------
    X : ndarray of shape (n_frames, n_features)
    columns : list of ndarray of int
    n_components : int
        Modes of each set; fewer of a set that has fewer columns or frames.

    Returns
    -------
    mean : ndarray of shape (n_features,)
    components, variances : lists of ndarray
        Of each set, as from `principal_components`.
    """
    mean, n_frames = X.mean(axis=0), len(X)
    many = len(columns) > 1
    sums = {i: 0.0 for i, c in enumerate(columns) if many and len(c) <= n_frames}
    step = max(64, CACHED // X.shape[1]) if sums else n_frames
    for start in range(0, n_frames if sums else 0, step):
        # some frames at a time, coordinates as rows: picked in the cache, not in the memory
        D = np.ascontiguousarray((X[start : start + step] - mean).T)
        for i in sums:
            part = D[columns[i]]
            sums[i] = sums[i] + (part @ part.T).astype(float)
    found = []
    for i, c in enumerate(columns):
        n = min(n_components, n_frames, len(c))
        if i in sums:
            square = (sums.pop(i) / max(n_frames - 1, 1)).astype(X.dtype)
            variances, modes = _leading(square, n)
            found.append((_signed(modes), variances))
        else:
            whole = np.array_equal(c, np.arange(X.shape[1]))  # picking would copy all frames
            found.append(principal_components(X if whole else X[:, c], n)[1:])
    return mean, *map(list, zip(*found, strict=True))


def leading_modes(square, n):
    """Largest n eigenvalues and their eigenvectors as rows, signed as `principal_components` does.

    Parameters
    ----------
    square : ndarray of shape (n_features, n_features)
        Symmetric.
    n : int

    Returns
    -------
    values : ndarray of shape (n,)
        None negative, largest first.
    modes : ndarray of shape (n, n_features)
        Orthonormal.
    """
    values, vectors = _leading(square, n)
    return values, _signed(vectors)


def _leading(square, n):
    """Largest n eigenvalues, none negative, and their eigenvectors as columns."""
    if n == 0:
        return np.zeros(0), np.zeros((len(square), 0))
    with one_thread():  # eigenvectors this small lose time on several threads
        values, vectors = eigh(square, subset_by_index=[len(square) - n, len(square) - 1])
    return values[::-1].clip(min=0), vectors[:, ::-1]


def components_of_sum(square, n_frames, n):
    """Leading n modes and their variances, from the sum of products of centred frames."""
    variances, modes = _leading(square / (n_frames - 1), n)
    return _signed(modes), variances


def _signed(columns):
    """Columns made orthonormal anew, as rows whose entry of largest magnitude is positive."""
    if not columns.size:
        return columns.T
    rows = np.linalg.qr(columns)[0].T  # weak columns lose orthonormality by rounding
    largest = rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)]
    return np.ascontiguousarray(rows * np.where(largest < 0, -1, 1)[:, None])


class _Covariance:
    """Modes from the covariance, summed up in one pass: exact."""

    passes = 1

    def __init__(self, columns, n_components):
        self.columns, self.n_components = columns, n_components
        self.sum = 0.0

    def part(self, D, number):
        D = D[:, self.columns].astype(float)
        return D.T @ D

    def end_pass(self, off, n_frames, number):
        # sum (x - m)(x - m)^T = sum x x^T - n m m^T, x counted from a place near the mean
        self.sum -= n_frames * np.outer(off[self.columns], off[self.columns])

    def result(self, n_frames):
        return components_of_sum(self.sum, n_frames, self.n_components)


class _Sketch:
    """Modes from a randomised SVD: the first pass spans a space, the last reads them off."""

    def __init__(self, columns, n_components, passes, rng):
        self.columns, self.n_components, self.passes = columns, n_components, passes
        # more than the modes wanted: what is cut off weighs little in those that are kept
        n = min(len(columns), n_components + max(10, n_components // 2))
        self.basis = rng.normal(size=(len(columns), n))
        self.sum = 0.0

    def part(self, D, number):
        D = D[:, self.columns]
        Y = D @ self.basis.astype(D.dtype)
        return Y.T @ Y if number == self.passes else D.T @ Y

    def end_pass(self, off, n_frames, number):
        if number == self.passes:
            return
        self.sum -= n_frames * np.outer(off[self.columns], off[self.columns] @ self.basis)
        self.basis, self.sum = np.linalg.qr(self.sum)[0], 0.0

    def result(self, n_frames):
        variances, turn = _leading(self.sum / (n_frames - 1), self.n_components)
        return _signed(self.basis @ turn), variances


def as_sets(columns, n_components, passes, rng):
    """For each set of columns what sums it up, in one pass or in `passes`: list."""
    sets = []
    for c in columns:
        n = min(n_components, len(c))
        wide = len(c) > LARGEST_EXACT
        sets.append(_Sketch(c, n, passes, rng) if wide else _Covariance(c, n))
    return sets


def components_of_blocks(
    blocks, columns, n_components, random_state=0, passes=2, n_features=None, progress=True
):
    """Principal components of several sets of columns, of frames that come in blocks.

    Memory does not grow with the number of frames. A set of up to `LARGEST_EXACT` columns keeps
    its covariance, summed up in one pass, and is exact; a wider one is found by a randomised SVD
    in two passes or more.

    Parameters
    ----------
    blocks : callable
        Gives an iterator over arrays of shape (n, n_features), the same ones at every call.
    columns : callable
        Takes n_features and gives the sets: a list of ndarray of int.
    n_components : int
        Modes of each set; fewer of a set that has fewer columns.
    random_state : int, RandomState or None
    passes : int, default=2
        Over the frames, where a set is wide: each one more turns its modes closer to the best.
    n_features : int, optional
        What each block must have; what the first has, if left out.
    progress : bool, default=True
        Show a progress bar for each pass.

    Returns
    -------
    n_frames : int
    mean : ndarray of shape (n_features,)
    components, variances : lists of ndarray
        Of each set, as from `principal_components`.

    Raises
    ------
    ValueError
        For values that are not finite, blocks of different widths, fewer than 2 frames, or blocks
        that are not the same at the second pass.

    References
    ----------
    Halko, Martinsson and Tropp 2011, section 4.5; Chan, Golub and LeVeque 1983.
    """
    rng = as_random_state(random_state)
    sets, seen, number, n_passes = [], [], 0, 1
    while number < n_passes:
        number += 1
        n_frames, total = 0, 0.0
        about = f"training, pass {number}"
        for block in tqdm(blocks(), desc=about, unit="block", leave=False, disable=not progress):
            X = _checked(block, n_features)
            if not len(X):
                continue
            if not sets:
                n_features = X.shape[1]
                shift = X.mean(
                    axis=0, dtype=float
                )  # near the mean: little is lost when that is taken off
                sets = as_sets(columns(n_features), n_components, passes, rng)
                n_passes = max(s.passes for s in sets)
            D = X - shift.astype(X.dtype)
            n_frames += len(D)
            total = total + D.sum(axis=0, dtype=float)
            for s in sets:
                if number <= s.passes:
                    s.sum += s.part(D, number)
        seen.append(n_frames)
        if n_frames < 2 or len(set(seen)) > 1:
            raise ValueError(
                f"X has {' and then '.join(map(str, seen))} frames in its blocks; give blocks with "
                "2 frames or more in all, and the same at each of the "
                f"{n_passes} passes (a list, or a function that gives them anew)."
            )
        off = total / n_frames
        for s in sets:
            if number <= s.passes:
                s.end_pass(off, n_frames, number)
        shift = shift + off
    found = [s.result(n_frames) for s in sets]
    return n_frames, shift, [c for c, _ in found], [v for _, v in found]


def _checked(block, n_features):
    """A block as it is in float32 (half the work of a sketch), else in float64."""
    X = np.asarray(block)
    shape = ("n_frames", n_features or "n_features")
    plain = X.dtype == np.float32 and X.ndim == 2 and not isinstance(block, np.ma.MaskedArray)
    if plain and X.shape[1] == (n_features or X.shape[1]) and np.isfinite(X).all():
        return X
    return as_finite(block, "X", shape, "one of the blocks")


def row_blocks(X):
    """Rows of an array, some at a time; pages of a memory-mapped file are given back."""
    step = max(1, BLOCK_BYTES // (8 * X.shape[1]))
    for start in range(0, len(X), step):
        yield X[start : start + step]
        _release(X)


def _release(X):
    mapped = X
    while isinstance(mapped, np.ndarray):
        mapped = mapped.base
    # changes to a private copy ("c") live in its pages alone
    shared = isinstance(mapped, mmap.mmap) and getattr(X, "mode", "c") != "c"
    if shared and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)
