"""Random walks through both sessions, a quarter of the actions bad; see `tests/soak.py` too."""

import numpy as np
import pytest
from soak import Walk, walks

from facelab.numeric.undo import History


@pytest.mark.parametrize("seed", [1, 2])
def test_random_walks_leave_no_trace_of_what_was_refused_and_come_back_exactly(seed):
    found = walks(1500, seed)
    for walk in ("posing", "bound", "expression"):
        bad = found[walk]["bad refused"] + found[walk]["bad done"]
        assert found[walk]["done"] > 150 and bad > 40


class Leaky:
    """A session with one fault: what it refuses it has half done."""

    vertices = np.zeros(3)

    def __init__(self):
        self.history = History(0, int.__eq__)

    @property
    def state(self):
        return self.history.state

    def act(self):
        self.history.make(self.state + 1)
        raise ValueError("refused")


def test_a_walk_notices_what_a_refusal_leaves_behind(tmp_path):
    session = Leaky()
    with pytest.raises(AssertionError, match=r"act was refused \(refused\) and left a trace"):
        Walk(session, np.random.default_rng(0), tmp_path).step("act", session.act, bad=False)
