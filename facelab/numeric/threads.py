"""BLAS on one thread: matrices as small as those of a face lose time on several.

A solve with 390 unknowns takes 0.8 ms on one thread of a machine with two, 8 ms on both.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import scipy.linalg  # noqa: F401  loads its BLAS: only what is loaded is found
import sklearn.utils  # noqa: F401  loads its OpenMP
from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()  # to look for the libraries anew takes 2 ms each time


def one_thread():
    """Context in which BLAS and OpenMP work on one thread."""
    return _threads.limit(limits=1)


single_threaded = _threads.wrap(limits=1)
"""Decorator for a function that works within `one_thread`."""

_MOST = 4
"""Threads at most: each has its own part of the work in memory."""


def side_by_side(function, items):
    """Results of a function for each item, in their order, on as many threads as there are cores.

    Parameters
    ----------
    function : callable
        Of one item; what it asks of others must not depend on which came before.
    items : sequence

    Yields
    ------
    object
        One for each item. Those not begun are left when one fails or the caller stops.

    Examples
    --------
    >>> list(side_by_side(abs, [-3, 2, -1]))
    [3, 2, 1]
    """
    pool = ThreadPoolExecutor(min(_MOST, os.cpu_count() or 1))
    try:
        with one_thread():
            yield from pool.map(function, items)
    finally:
        pool.shutdown(cancel_futures=True)
