"""BLAS on one thread: matrices as small as those of a face lose time on several.

A solve with 390 unknowns takes 0.8 ms on one thread of a machine with two, 8 ms on both.
"""

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ContextDecorator

import scipy.linalg  # noqa: F401  loads its BLAS: only what is loaded is found
import sklearn.utils  # noqa: F401  loads its OpenMP
from threadpoolctl import OpenBLASController, ThreadpoolController

_libraries = ThreadpoolController()  # to look for them anew takes 2 ms each time
_blas, _openmp = (_libraries.select(user_api=name) for name in ("blas", "openmp"))


class _OneThread(ContextDecorator):
    """What `one_thread` gives: any number of threads may be within, one inside another too.

    BLAS has one limit for all of them, set by the first that comes and lifted by the last that
    goes: were each to restore what it found, threads that overlap would leave the limit behind.
    OpenMP has one for each thread.
    """

    def __init__(self):
        self._lock, self._inside, self._before = threading.Lock(), 0, None
        self._own = threading.local()

    def __enter__(self):
        own = vars(self._own)
        own["depth"] = own.get("depth", 0) + 1
        if own["depth"] == 1:
            own["openmp"] = _openmp.limit(limits=1)
            with self._lock:
                if not self._inside:
                    self._before = _blas.limit(limits=1)
                self._inside += 1
        return self

    def __exit__(self, *_):
        own = vars(self._own)
        own["depth"] -= 1
        if not own["depth"]:
            own["openmp"].restore_original_limits()
            with self._lock:
                self._inside -= 1
                if not self._inside:
                    # threadpoolctl lets no thread lift what another has set
                    OpenBLASController.clear_controlling_thread(force=True)
                    self._before.restore_original_limits()
                    OpenBLASController.clear_controlling_thread(force=True)


single_threaded = _OneThread()
"""Decorator for a function that works within `one_thread`."""


def one_thread():
    """Context in which BLAS and OpenMP work on one thread."""
    return single_threaded


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
