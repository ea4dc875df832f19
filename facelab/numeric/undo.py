"""Undo for any session: steps, strokes, groups, all or nothing; a log of edits; those who watch.

A session owns a `History` of its states and declares its edits by `edit`; that they are undone,
logged and replayed follows.
"""

import functools
import inspect
import operator
import threading
import time
import warnings
import weakref
from contextlib import contextmanager

import numpy as np

from facelab.numeric.threads import one_thread

_lock = threading.RLock()


@contextmanager
def turn():
    """Context in which a history changes or a page answers, in one thread at a time.

    JupyterLab lets widgets call from threads of their own (subshells of the kernel), beside each
    other and beside the code of a cell. BLAS works on one thread there, too: with a browser at work
    on the same processors, a product of half a millisecond takes 170 ms on two.
    """
    with _lock, one_thread():
        yield


def in_turn(method):
    """Only one thread at a time is in such a method, of whatever object."""

    @functools.wraps(method)
    def waiting(*args, **kwargs):
        with turn():
            return method(*args, **kwargs)

    return waiting


class History:
    """Steps of a session that can be undone, and what was done when.

    Parameters
    ----------
    state : object
        The first one. States never change.
    same : callable, optional
        Whether two states are the same; `state.same(other)` if left out.
    clock : callable
        Seconds.
    most : int, optional
        Steps kept; all of them if left out.

    Attributes
    ----------
    state : object
        The present one; what is under way is not in it.
    live : object or None
        What is under way and no step yet, such as a drag; a value that never changes.
    aside : object
        A setting that belongs to no step: undo leaves it alone.
    """

    def __init__(self, state, same=None, clock=time.time, most=None):
        # values that never change, so that `whole` need only remember them
        self._past, self.state, self._future = (), state, ()
        self._stroke = None  # that may go on: key, states under its step, what could be redone
        self._under = None  # in a group: the states on which its step stands
        self._acts, self._entries = (), ()  # of the log, those of a step together; of the group
        self.live = self.aside = None
        self._same = same or type(state).same
        self._clock, self._started = clock, clock()
        self._kept = slice(None if most is None else -most, None)
        self._depth, self._observers = 0, []

    # --- steps ------------------------------------------------------------------------------------

    @property
    def states(self):
        """States of all steps that can be undone or redone, the present one first: list."""
        return [self.state, *reversed(self._past), *reversed(self._future)]

    @property
    def line(self):
        """All states from the first to the last undone step: list; the present is `n_undo`."""
        return [*self._past, self.state, *reversed(self._future)]

    def go(self, place):
        """Undo or redo up to a place in `line`; a drag under way is given up.

        Raises
        ------
        ValueError
            For a place that does not exist; nothing changes.
        """
        if place not in range(len(self.line)):
            raise ValueError(f"place={place!r}, but there are the steps 0 to {len(self.line) - 1}.")
        self.cancel()
        with self.whole():
            while self.n_undo > place:
                self.undo()
            while self.n_undo < place:
                self.redo()

    @property
    def can_undo(self):
        """Whether there is a step to go back to."""
        return self.n_undo > 0 or self.live is not None

    @property
    def can_redo(self):
        """Whether there is an undone step."""
        return self.n_redo > 0

    @property
    def n_undo(self):
        """Steps that can be undone."""
        return len(self._past)

    @property
    def n_redo(self):
        """Steps that can be redone."""
        return len(self._future)

    @in_turn
    def undo(self):
        """Go one step back; False if there is none. A drag under way is given up instead."""
        self._refuse_in_group()
        if self.live is not None:
            self.cancel()
            return True
        if not self._past:
            return False
        with self.whole():
            self._future = (*self._future, self.state)
            *past, self.state = self._past
            self._past = tuple(past)
            self.note("undo")
        return True

    @in_turn
    def redo(self):
        """Go one undone step forward again; False if there is none."""
        self._refuse_in_group()
        if not self._future:
            return False
        with self.whole():
            self._past, self.live = (*self._past, self.state), None
            *future, self.state = self._future
            self._future = tuple(future)
            self.note("redo")
        return True

    @in_turn
    def cancel(self):
        """Give up the drag under way; all is as it was before."""
        if self.live is not None:
            self.live = None
            self.tell("move")

    @in_turn
    def make(self, state):
        """Make a state the present one, by a step of its own or that of the group under way.

        Returns
        -------
        bool
            False if it is the same as the present one: then nothing is done.
        """
        if self._same(state, self.state):
            return False
        if self._under is None:
            self._past, self._stroke = (*self._past, self.state)[self._kept], None
        else:
            self._past = self._under
        self.state, self._future = state, ()
        return True

    # --- groups -----------------------------------------------------------------------------------

    @contextmanager
    def whole(self):
        """All that is done inside stays, or an error takes all of it back; told of at the end."""
        with turn():
            before = vars(self).copy()
            self._depth += 1
            try:
                yield
            except BaseException:
                vars(self).update(before)
                raise
            self._depth -= 1
            if self.state is not before["state"] or self.aside != before["aside"]:
                self.tell("step")

    @contextmanager
    def group(self, key=None):
        """All edits inside are one step of undo; an error inside takes all of them back.

        Parameters
        ----------
        key : str, optional
            The step goes on with the last one if that was made under the same key and nothing came
            between (`settle` ends that): so one stroke of a slider is one step.
        """
        if not (key is None or isinstance(key, str)):
            raise TypeError(f"key is a {type(key).__name__}; give a name, such as the slider's.")
        with self.whole():
            if self._under is not None:  # part of the group around it
                yield
                return
            stroke = self._stroke
            if key is None or stroke is None or key != stroke[0]:
                self._stroke = key, (*self._past, self.state), self._future
            else:  # it goes on
                *acts, self._entries = self._acts or ((),)
                self._acts = tuple(acts)
            self._under = self._stroke[1]
            yield
            self._close(stroke)

    def _close(self, stroke):
        (key, under, ahead), self._under = self._stroke, None
        made = self._past is under
        if made and self._same(self.state, under[-1]):  # it came back to where it began
            *past, self.state = under
            self._past, self._future = tuple(past), ahead
        elif made:
            self._past = under[self._kept]
        if not made and not self._entries:  # nothing was done
            self._stroke = stroke
        elif key is None or not made:
            self._stroke = None
        if self._entries:
            self._acts, self._entries = (*self._acts, self._entries), ()

    @in_turn
    def settle(self):
        """End the stroke: the next change makes a step of its own."""
        self._stroke = None

    def _refuse_in_group(self):
        if self._under is not None:
            raise RuntimeError(
                "undo, redo, the log and saving belong outside `with session.group()`."
            )

    # --- the log ----------------------------------------------------------------------------------

    @property
    def log(self):
        """Every edit with its time since the start, seconds: list of {"t", "do", ...arguments}.

        Those of one step, if they are several, stand between "group" and "end". Of edits in one
        step that replace each other, as those of a stroke, only the last is kept.
        """
        self._refuse_in_group()
        log = []
        for act in self._acts:
            first, last = {"t": act[0]["t"], "do": "group"}, {"t": act[-1]["t"], "do": "end"}
            log += act if len(act) == 1 else (first, *act, last)
        return log

    @in_turn
    def note(self, do, over=None, **arguments):
        """Write into the log that something was done.

        Parameters
        ----------
        over : iterable of str, optional
            Arguments that say where it was done: it replaces the entry before it in the same step
            if that did the same there. It replaces none if left out.
        **arguments
            As JSON has them.
        """
        entry = {"t": round(self._clock() - self._started, 3), "do": do, **arguments}
        if self._under is None:
            self._acts, self._stroke = (*self._acts, (entry,)), None
            return
        before = self._entries
        if over is not None and before and before[-1].keys() == entry.keys():
            if all(before[-1][k] == entry[k] for k in ("do", *over)):
                before = before[:-1]
        self._entries = (*before, entry)

    # --- those who watch --------------------------------------------------------------------------

    def observe(self, callback):
        """Call back after every change, so that views of the session stay in step.

        What goes wrong in a callback becomes a warning, after all have been called: the change
        itself stands.

        Parameters
        ----------
        callback : callable
            Called with "step" after an edit, an undo or a redo (once for a group), and with "move"
            when a drag under way has moved or was given up. A bound method is held weakly: it
            goes when its object goes.
        """
        held = inspect.ismethod(callback)
        self._observers.append(weakref.WeakMethod(callback) if held else lambda: callback)

    def unobserve(self, callback):
        """Call it back no more."""
        self._observers = [known for known in self._observers if known() != callback]

    def tell(self, what):
        """Tell those who watch, unless what is being done is not yet whole."""
        if self._depth:
            return
        alive = [(known, known()) for known in self._observers]
        self._observers = [known for known, callback in alive if callback is not None]
        failed = []
        for _, callback in alive:
            try:
                if callback is not None:
                    callback(what)
            except Exception as error:
                failed.append((callback, error))
        for callback, error in failed:
            who = getattr(callback, "__qualname__", repr(callback))
            what_failed = f"{type(error).__name__}: {error}"
            warnings.warn(
                f"the change stands, but the observer {who} failed to follow it: {what_failed}",
                RuntimeWarning,
                stacklevel=3,
            )


def plain(value):
    """The value as JSON has it, and nothing of it shared."""
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value.item() if isinstance(value, np.generic) else value
    return np.asarray(value).tolist()


def edit(method=None, *, over=None, **forms):
    """Declare a method of a session as an edit: one step, one entry of the log, all or nothing.

    The method changes nothing itself: it returns the state that is wanted, or None if it did
    something beside the states. Before it begins, the session lets go of what is under way.

    Parameters
    ----------
    over : iterable of str, optional
        See `History.note`.
    **forms : (write, read)
        For an argument that JSON cannot hold: `write(value)` gives what stands in the log, and
        `read(stored, session, models)` the value again.
    """
    if method is None:
        return functools.partial(edit, over=over, **forms)
    names = list(inspect.signature(method).parameters)[1:]

    @functools.wraps(method)
    def wrapper(self, *args, **kwargs):
        history = self.history
        with history.whole():
            _let_go(self)
            state = method(self, *args, **kwargs)
            if state is None or history.make(state):
                given = dict(zip(names, args, strict=False)) | kwargs
                written = {k: forms[k][0](v) if k in forms else plain(v) for k, v in given.items()}
                history.note(method.__name__, over, **written)

    wrapper.reads = {name: read for name, (_, read) in forms.items()}
    return wrapper


def edit_named(kind, name):
    """The edit that a class of sessions declares by a name, also to set a property, or None."""
    found = getattr(kind, name, None)
    found = getattr(found, "fset", found)
    return found if hasattr(found, "reads") else None


def has_history(cls):
    """Class decorator: what people do with the `history` of a session they do with the session."""
    get = operator.attrgetter("history.state")
    cls.state = property(get, doc="The present state; what is under way is not in it.")
    for name in ("can_undo", "can_redo", "n_undo", "n_redo"):
        get = operator.attrgetter(f"history.{name}")
        setattr(cls, name, property(get, doc=getattr(History, name).__doc__))
    for name in ("undo", "redo", "cancel", "settle", "observe"):
        setattr(cls, name, _passed_on(getattr(History, name)))
    cls.group = _group
    return cls


def _passed_on(method):
    @functools.wraps(method)
    def call(self, *args, **kwargs):
        return method(self.history, *args, **kwargs)

    return call


@contextmanager
@functools.wraps(History.group)
def _group(self, key=None):
    with self.history.whole():
        _let_go(self)
        with self.history.group(key):
            yield
            _let_go(self)


def _let_go(session):
    if session.history.live is not None:
        session.release()
