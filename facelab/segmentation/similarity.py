"""How alike vertices move, how near they lie, and both in one (Tena et al. 2011, Eq. 11 and 12)."""

import numpy as np

from facelab.checks import as_finite, check_number
from facelab.numeric.engine import block_sums, is_dask


def motion_correlation(positions, still=1e-6):
    """C-bar: how alike two vertices move, averaged over the three axes.

    Parameters
    ----------
    positions : ndarray or Dask array of shape (n_frames, n_vertices, 3)
        Millimetres. Blocks of a Dask array are summed up where they are.
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
    if is_dask(positions):
        return _correlation_of_blocks(positions, still)
    positions = as_positions(positions)
    n_frames, n_vertices, _ = positions.shape
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


def _correlation_of_blocks(positions, still):
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(
            f"positions has shape {positions.shape}, but needs shape (n_frames, n_vertices, 3)."
        )
    shape = positions.shape[1:]
    n_first, first, _ = block_sums(positions.blocks[0], _products, np.zeros(shape), False)
    shift = first / max(n_first, 1)
    n_frames, total, squares = block_sums(positions, _products, shift, True)
    if n_frames < 2:
        raise ValueError(f"positions has {n_frames} frame(s); correlation needs 2 or more.")
    C_bar = np.zeros((shape[0],) * 2)
    for axis in range(3):
        off = total[:, axis] / n_frames
        C = squares[axis] - n_frames * np.outer(off, off)
        size = np.sqrt(np.diag(C).clip(min=0))
        size = np.where(size > still * np.sqrt(n_frames), size, np.inf)
        C_bar += C / size[:, None] / size / 3
    np.fill_diagonal(C_bar, 1)
    return np.clip(C_bar, -1, 1, out=C_bar)


def _products(block, number, shift, with_squares):
    """Number of frames, their sum, and the products of each axis, counted from `shift`."""
    shape = ("n_frames", *shift.shape)
    D = as_finite(block, "positions", shape, f"block {number}") - shift
    X = np.moveaxis(D, 2, 0)
    return [len(D), D.sum(axis=0), np.array([x.T @ x for x in X]) if with_squares else 0]


def as_positions(positions):
    positions = np.asarray(positions)
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(
            f"positions has shape {positions.shape}, but needs shape (n_frames, n_vertices, 3)."
        )
    if len(positions) < 2:
        raise ValueError(f"positions has {len(positions)} frame(s); correlation needs 2 or more.")
    return positions


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
