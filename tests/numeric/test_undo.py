"""The one undo: of a counter here, so that nothing but steps is looked at."""

import operator
import threading

import pytest
from threadpoolctl import ThreadpoolController

from facelab.numeric.undo import History, edit, edit_named, has_history


@has_history
class Counter:
    """A session whose state is a number; a bid is under way until it is let go."""

    def __init__(self, most=None):
        self.history = History(0, operator.eq, clock=lambda: 0, most=most)
        self.history.aside = "plain"

    def bid(self, by):
        self.history.live = by

    def release(self):
        with self.history.whole():
            by, self.history.live = self.history.live, None
            if by == 99:
                raise ValueError("too much")
            self.history.make(self.state + by)
            self.history.note("bid", by=by)

    @edit
    def add(self, n):
        return self.state + n

    @edit(over=("place",))
    def write(self, place, n):
        return n

    @edit(word=(len, lambda stored, session, models: stored * "x"))
    def spell(self, word="x"):
        if word == "bad":
            raise ValueError("no word")
        return self.state + len(word)

    @property
    def mood(self):
        return self.history.aside

    @mood.setter
    @edit
    def mood(self, on):
        self.history.aside = on


def done(counter):
    return [tuple(v for k, v in entry.items() if k != "t") for entry in counter.history.log]


def tick(counter, n, key="slider", place=0):
    with counter.group(key):
        counter.write(place, n)


def test_edits_are_steps_back_and_forth_and_a_change_of_nothing_is_none():
    c = Counter()
    c.add(1)
    c.add(0)
    c.add(n=2)
    assert (c.state, c.n_undo, c.n_redo) == (3, 2, 0)
    assert c.undo() and c.state == 1 and c.undo() and c.state == 0 and not c.undo()
    assert c.redo() and c.redo() and c.state == 3 and not c.redo()
    assert c.undo() and c.can_redo
    c.add(5)
    assert not c.can_redo and c.state == 6
    assert done(c) == [
        *(("add", 1), ("add", 2), ("undo",), ("undo",), ("redo",), ("redo",), ("undo",), ("add", 5))
    ]


def test_what_is_under_way_is_given_up_by_undo_and_let_go_by_an_edit():
    c = Counter()
    c.bid(3)
    assert c.can_undo and c.undo() and c.state == 0 and not c.can_undo
    c.bid(3)
    c.add(1)
    assert (c.state, c.n_undo) == (4, 2)
    c.undo()
    c.bid(7)
    assert c.redo() and c.state == 4 and c.history.live is None


@pytest.mark.parametrize("bid", [5, 99])
def test_a_refused_edit_or_group_leaves_no_trace_of_what_was_under_way_either(bid):
    c = Counter()
    c.add(1)
    c.undo()
    c.bid(bid)
    heard = []
    c.observe(heard.append)
    before = vars(c.history).copy()
    with pytest.raises(ValueError, match=r"no word|too much"):
        c.spell("bad")
    with pytest.raises(ValueError, match=r"no word|too much"), c.group("slider"):
        c.mood = "high"
        c.add(2)
        c.spell("bad")
    with pytest.raises((TypeError, ValueError)), c.group(float("nan")):
        pass
    with pytest.raises((TypeError, ValueError)):
        c.add(1, 2, 3)
    assert vars(c.history) == before and heard == []


def test_a_refused_edit_inside_a_group_is_taken_back_alone():
    c = Counter()
    with c.group():
        c.add(1)
        with pytest.raises(ValueError, match="no word"), c.group():
            c.add(10)
            c.spell("bad")
        c.add(2)
    assert (c.state, c.n_undo) == (3, 1)
    assert done(c) == [("group",), ("add", 1), ("add", 2), ("end",)]


def test_a_stroke_is_one_step_and_one_entry_until_something_comes_between():
    c = Counter()
    for n in range(1, 1001):
        tick(c, n)
    assert (c.n_undo, done(c)) == (1, [("write", 0, 1000)])
    c.settle()
    tick(c, 1)
    tick(c, 2, place=1)  # elsewhere: both stay in the log, in one step
    assert c.n_undo == 2
    c.mood = "high"
    tick(c, 3)
    tick(c, 4, "other")
    tick(c, 5)
    assert c.n_undo == 5
    assert done(c) == [
        *(("write", 0, 1000), ("group",), ("write", 0, 1), ("write", 1, 2), ("end",)),
        *(("mood", "high"), ("write", 0, 3), ("write", 0, 4), ("write", 0, 5)),
    ]


def test_a_stroke_that_comes_back_leaves_what_could_be_redone():
    c = Counter()
    c.add(5)
    c.undo()
    tick(c, 3)
    assert not c.can_redo
    tick(c, 0)
    assert (c.state, c.n_undo, c.n_redo) == (0, 0, 1)
    tick(c, 4)
    tick(c, 5)
    assert (c.n_undo, c.n_redo) == (1, 0)
    assert done(c) == [("add", 5), ("undo",), ("write", 0, 5)]


def test_no_more_steps_are_kept_than_asked_for():
    c = Counter(most=3)
    for n in range(1, 8):
        tick(c, n, str(n)) if n % 2 else c.add(1)
    assert c.n_undo == 3
    while c.undo():
        pass
    assert c.state == 4


def test_undo_and_the_log_belong_outside_groups():
    c = Counter()
    for call in (c.undo, c.redo, lambda: c.history.log):
        with pytest.raises(RuntimeError, match="belong outside"), c.group():
            c.add(1)
            call()
    assert c.state == 0 and c.history.log == []


def test_those_who_watch_hear_once_of_all_that_is_done_as_one():
    c, heard = Counter(), []
    c.observe(heard.append)
    with c.group():
        c.add(1)
        c.mood = "high"
        c.add(2)
    assert heard == ["step"]
    c.bid(4)
    c.add(1)  # lets go first
    c.mood = "low"
    c.undo()
    c.bid(4)
    c.cancel()
    assert heard == ["step"] * 4 + ["move"]


def test_undo_leaves_alone_what_stands_aside():
    c = Counter()
    c.mood = "high"
    c.add(1)
    c.undo()
    assert (c.mood, c.n_undo) == ("high", 0)


def test_an_edit_says_how_its_arguments_are_written_and_read():
    c = Counter()
    c.spell("abc")
    c.spell(word="ab")
    c.spell()
    assert done(c) == [("spell", 3), ("spell", 2), ("spell",)]
    assert edit_named(Counter, "spell").reads["word"](3, c, ()) == "xxx"
    assert edit_named(Counter, "mood") is Counter.mood.fset
    assert all(
        edit_named(Counter, name) is None for name in ("bid", "history", "undo", "__init__", "x")
    )


def test_a_second_thread_waits_for_the_step_under_way():
    counter, begun = Counter(), threading.Event()

    def settle():
        begun.wait(5)
        counter.history.settle()

    other = threading.Thread(target=settle)
    other.start()
    with counter.history.group("stroke"):
        begun.set()
        other.join(0.2)
        assert other.is_alive(), "it came between"
        counter.history.make(2)
    other.join(5)
    assert counter.history.n_undo == 1 and counter.history.state == 2


def test_an_edit_and_who_watches_it_compute_on_one_thread():
    counter, seen = Counter(), []
    libraries = ThreadpoolController().select(user_api="blas")

    def watch(_):
        seen.extend(library["num_threads"] for library in libraries.info())

    counter.history.observe(watch)
    with libraries.limit(limits=2):
        counter.add(2)
    assert seen and set(seen) == {1}
