"""BLAS on one thread: matrices as small as those of a face lose time on several.

A solve with 390 unknowns takes 0.8 ms on one thread of a machine with two, 8 ms on both.
"""

import scipy.linalg  # noqa: F401  loads its BLAS: only what is loaded is found
import sklearn.utils  # noqa: F401  loads its OpenMP
from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()  # to look for the libraries anew takes 2 ms each time


def one_thread():
    """Context in which BLAS and OpenMP work on one thread."""
    return _threads.limit(limits=1)


single_threaded = _threads.wrap(limits=1)
"""Decorator for a function that works within `one_thread`."""
