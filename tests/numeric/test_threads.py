"""Work side by side: in order, and no more of it than is wanted."""

import time
from contextlib import closing

import pytest

from facelab.numeric.threads import side_by_side


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
