"""Quantiles of tracks with gaps."""

import numpy as np


def nan_quantile(values, share):
    """The quantile of each track, samples that are NaN left out, as `numpy.nanquantile` has it.

    That one goes through the tracks one by one in Python; here all are sorted at once.

    Parameters
    ----------
    values : ndarray of shape (n_samples, ...)
        One or more samples of each track are known.
    share : float
        0 to 1; 0.5 is the median.

    Returns
    -------
    ndarray of shape (...)

    Examples
    --------
    >>> nan_quantile(np.array([[1.0, 4.0], [np.nan, 6.0], [3.0, 5.0]]), 0.5)
    array([2., 5.])
    """
    ordered = np.sort(values, axis=0)  # NaN comes last
    last = (~np.isnan(values)).sum(axis=0, keepdims=True) - 1
    place = share * last
    below = place.astype(int)
    low = np.take_along_axis(ordered, below, axis=0)
    high = np.take_along_axis(ordered, np.minimum(below + 1, last), axis=0)
    return (low + (high - low) * (place - below))[0]
