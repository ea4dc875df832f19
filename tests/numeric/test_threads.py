"""BLAS on one thread, and work side by side: in order, and no more of it than is wanted."""

import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from facelab.numeric.threads import one_thread, side_by_side

BLAS = ThreadpoolController().select(user_api="blas")


def n_threads():
    """That BLAS works on: set of int."""
    return {library["num_threads"] for library in BLAS.info()}


@pytest.fixture
def two_threads():
    """BLAS on two threads, whatever the machine or the environment says."""
    before = BLAS.limit(limits=2)
    with one_thread():
        pass  # the limit above is nobody's now
    yield
    before.restore_original_limits()
    with one_thread():
        pass


@pytest.mark.parametrize("first_out", [0, 1])
def test_threads_that_overlap_leave_no_limit_behind(two_threads, first_out):
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        hands, within = (first, second), []
        for hand in hands:
            within.append(hand.submit(lambda: one_thread().__enter__()).result(5))
            assert n_threads() == {1}
        for k in (first_out, 1 - first_out):
            hands[k].submit(within[k].__exit__, None, None, None).result(5)
        assert n_threads() == {2}
    with one_thread():
        assert n_threads() == {1}
    assert n_threads() == {2}


def test_an_interrupted_cell_leaves_no_limit_behind_and_does_not_lift_it_for_ever(two_threads):
    rng, interrupts = np.random.default_rng(0), 0

    def interrupt(*_):
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        for _ in range(300):
            try:
                signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-4, 2e-3))
                while True:
                    with one_thread(), one_thread():
                        pass
            except KeyboardInterrupt:
                interrupts += 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    with one_thread():
        assert n_threads() == {1}
    assert n_threads() == {2} and interrupts == 300


def test_work_that_is_given_up_in_another_thread_leaves_no_limit_behind(two_threads):
    results = side_by_side(abs, range(50))
    next(results)
    with ThreadPoolExecutor(1) as other:
        other.submit(results.close).result(5)
    assert n_threads() == {2}


def test_results_come_in_the_order_of_the_items_whichever_is_done_first():
    def slow_first(item):
        time.sleep(0.02 if item == 0 else 0)
        return item

    assert list(side_by_side(slow_first, range(8))) == list(range(8))


def test_what_fails_fails_in_its_place_and_ends_the_rest():
    begun = []

    def work(item):
        begun.append(item)
        time.sleep(0.01)
        if item == 2:
            raise ValueError("the third")
        return item

    results = side_by_side(work, range(2000))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ValueError, match="the third"):
        next(results)
    assert len(begun) < 2000


def test_who_stops_asking_ends_the_rest():
    begun = []

    def work(item):
        begun.append(item)
        time.sleep(0.01)

    with closing(side_by_side(work, range(2000))) as results:
        next(results)
    done = len(begun)
    time.sleep(0.05)
    assert len(begun) == done < 2000
