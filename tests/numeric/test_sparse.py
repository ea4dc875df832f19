"""Sparse factors, and the number of threads they work on."""

import numpy as np
import pytest
import scipy.sparse as sp
from threadpoolctl import threadpool_info, threadpool_limits

from facelab.numeric.sparse import SparseFactor
from facelab.numeric.threads import one_thread, single_threaded


def threads():
    return {library["num_threads"] for library in threadpool_info()}


@pytest.mark.parametrize("columns", [(), (3,)])
def test_a_factor_solves_what_a_dense_solver_solves(rng, columns):
    R = sp.random_array((60, 40), density=0.1, rng=rng)
    A = R.T @ R + 0.1 * sp.eye_array(40)
    b = rng.normal(size=(40, *columns))
    x = np.linalg.solve(A.toarray(), b)
    np.testing.assert_allclose(SparseFactor(A).solve(b), x, atol=1e-9 * np.abs(x).max())


def test_within_one_thread_every_library_works_on_one():
    with threadpool_limits(2):
        with one_thread():
            assert threads() == {1}
        assert single_threaded(threads)() == {1}
        assert 2 in threads()
