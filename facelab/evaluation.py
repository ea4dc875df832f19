"""How far a model is from the truth."""

import numpy as np


def rms_error(X, X_hat):
    """E_RMS: root mean squared distance per vertex, over all frames.

    Parameters
    ----------
    X, X_hat : ndarray of shape (n_frames, 3 * n_vertices) or (n_frames, n_vertices, 3)
        Truth and reconstruction, millimetres.

    Returns
    -------
    float
        Millimetres.

    Raises
    ------
    ValueError
        If the shapes differ or hold no frames.

    References
    ----------
    Tena et al. 2011, Eq. 13.
    """
    X, X_hat = np.asarray(X, dtype=float), np.asarray(X_hat, dtype=float)
    if X.shape != X_hat.shape:
        raise ValueError(f"X has shape {X.shape}, X_hat {X_hat.shape}; they must agree.")
    if X.size == 0 or X.ndim == 0 or X.shape[-1] % 3:
        raise ValueError(f"X has shape {X.shape}: no frames, or not three coordinates a vertex.")
    return float(np.sqrt(3 * np.mean((X - X_hat) ** 2)))
