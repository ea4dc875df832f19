"""BLAS on one thread: matrices as small as those of a face lose time on several.

A solve with 390 unknowns takes 0.8 ms on one thread of a machine with two, 8 ms on both.
"""

import functools
import os
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import scipy.linalg  # noqa: F401  loads its BLAS: only what is loaded is found
import sklearn.utils  # noqa: F401  loads its OpenMP
from threadpoolctl import OpenBLASController, ThreadpoolController


class _Limit:
    """Holds libraries to one thread while anybody is inside.

    Who is inside is held weakly, and what there was before is kept until it is restored: so nothing
    is left behind where a cell is interrupted on its way in or out.
    """

    def __init__(self, libraries):
        self._libraries, self._inside, self._before = libraries, weakref.WeakSet(), None

    def enter(self, who):
        """Limit the libraries."""
        self._before = self._before or self._libraries.info()
        first = not self._inside
        self._inside.add(who)
        if first:
            self._libraries.limit(limits=1)

    def leave(self, who):
        """Give the libraries the threads that they had, unless somebody else is inside."""
        self._inside.discard(who)
        if not self._inside and self._before:
            # threadpoolctl lets no thread lift what another has set
            OpenBLASController.clear_controlling_thread(force=True)
            self._libraries.limit(limits=self._before)
            OpenBLASController.clear_controlling_thread(force=True)
            self._before = None


_libraries = ThreadpoolController()  # to look for them anew takes 2 ms each time
_lock, _blas = threading.Lock(), _Limit(_libraries.select(user_api="blas"))
_own = threading.local()  # OpenMP counts for each thread


class one_thread:
    """Context in which BLAS and OpenMP work on one thread; of any number of threads at a time."""

    def __enter__(self):
        if not hasattr(_own, "openmp"):
            _own.openmp = _Limit(_libraries.select(user_api="openmp"))
        self._openmp = _own.openmp
        self._openmp.enter(self)
        with _lock:
            _blas.enter(self)
        return self

    def __exit__(self, *_):
        with _lock:
            _blas.leave(self)
        self._openmp.leave(self)


def single_threaded(function):
    """Decorator for a function that works within `one_thread`."""

    @functools.wraps(function)
    def alone(*args, **kwargs):
        with one_thread():
            return function(*args, **kwargs)

    return alone


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
