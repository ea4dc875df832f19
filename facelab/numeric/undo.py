"""Undo without end, groups of edits, a log that can be replayed, and those who watch."""

import functools
import inspect
import time
import warnings
import weakref
from contextlib import contextmanager

import numpy as np


def logged(edit):
    """Write the call of an edit down once it has done its work, if it changed the state."""
    names = list(inspect.signature(edit).parameters)[1:]

    @functools.wraps(edit)
    def wrapper(self, *args, **kwargs):
        before, outermost = self.state, not self._editing
        self._editing = True  # what an edit calls in its turn is part of it
        try:
            result = edit(self, *args, **kwargs)
        finally:
            self._editing = not outermost
        if outermost and self.state is not before:
            self._note(edit.__name__, **dict(zip(names, args, strict=False)), **kwargs)
            self._tell("step")
        return result

    return wrapper


class History:
    """Steps of a session that can be undone, and what was done when.

    A session derives from it and has `release` and `cancel` for a drag under way, which `dragging`
    tells. A state never changes and says by `same` whether another is the same.

    Parameters
    ----------
    state : object
        The first one.
    clock : callable
        Seconds.

    Attributes
    ----------
    log : list of dict
        Every edit with its time since the start, in seconds: {"t", "do", ...arguments}.
    """

    def __init__(self, state, clock=time.time):
        self._past, self._future = [state], []
        self._undone = []  # what could be redone before the groups that merge began
        self._group = self._merge_key = None
        self._clock, self._started, self._editing = clock, clock(), False
        self._observers = []
        self.log = []

    @property
    def state(self):
        """The present state; a drag under way is not in it before its release."""
        return self._past[-1]

    @property
    def can_undo(self):
        """Whether there is a step to go back to."""
        return self.n_undo > 0 or self.dragging

    @property
    def can_redo(self):
        """Whether there is an undone step."""
        return self.n_redo > 0

    @property
    def n_undo(self):
        """Steps that can be undone."""
        return len(self._past) - 1

    @property
    def n_redo(self):
        """Steps that can be redone."""
        return len(self._future)

    def undo(self):
        """Go one step back; False if there is none. A drag under way is given up instead."""
        self._refuse_in_group()
        if self.dragging:
            self.cancel()
            return True
        if not self.n_undo:
            return False
        self._future.append(self._past.pop())
        self._walked("undo")
        return True

    def redo(self):
        """Go one undone step forward again; False if there is none."""
        self._refuse_in_group()
        if not self._future:
            return False
        self.cancel()
        self._past.append(self._future.pop())
        self._walked("redo")
        return True

    def _walked(self, way):
        self._merge_key = None
        self._note(way)
        self._tell("step")

    def _refuse_in_group(self):
        if self._group is not None:
            raise RuntimeError("undo, redo and saving belong outside `with session.group()`.")

    def _push(self, state):
        """Make a state the present one; a change of nothing is no step."""
        if not state.same(self.state):
            self._past.append(state)
            self._future = []
            self._merge_key = None

    @contextmanager
    def group(self, key=None):
        """All edits inside are one step of undo; an error inside takes all of them back.

        Parameters
        ----------
        key : str, optional
            The step merges into the last one if that was grouped under the same key and nothing
            came between (`seal` ends that): so one drag of a slider is one step.
        """
        if self._group is not None:  # inside another one
            yield
            return
        self.release()
        start, future = len(self._past), self._future
        merges = key is not None and key == self._merge_key
        self._group = key or "group"
        try:
            with self._all_or_nothing():
                self._note("group", key=key)
                yield
                self.release()
        finally:
            self._group = None
        self._note("end")
        if len(self._past) > start:
            first = start - 1 if merges else start
            self._past[first:] = [self.state]
            self._merge_key = key
            self._undone = self._undone if merges else future
            if self.state.same(self._past[first - 1]):
                self._past.pop()
                self._future, self._merge_key = self._undone, None
            self._tell("step")

    @contextmanager
    def _all_or_nothing(self):
        """An error inside takes back all that was done, undone, redone and logged since."""
        self.release()
        memory = self._memory()
        try:
            yield
        except BaseException:
            self._recall(memory)
            self.cancel()
            self._tell("step")
            raise

    def _memory(self):
        """All that an error in a group or a log must bring back."""
        steps = list(self._past), list(self._future), list(self._undone)
        return *steps, list(self.log), self._merge_key

    def _recall(self, memory):
        self._past, self._future, self._undone, self.log[:], self._merge_key = memory

    def seal(self):
        """End merging by key: the next group makes a step of its own."""
        if self._merge_key is not None:
            self._merge_key = None
            self._note("seal")

    def _note(self, what, **arguments):
        t = round(self._clock() - self._started, 3)
        plain = {k: self._plain(a) for k, a in arguments.items()}
        self.log.append({"t": t, "do": what, **plain})

    def _plain(self, value):
        """The value as JSON has it, and nothing of it shared."""
        if isinstance(value, (list, tuple)):
            return [self._plain(each) for each in value]
        if value is None or isinstance(value, (bool, int, float, str)):
            return value.item() if isinstance(value, np.generic) else value
        return np.asarray(value).tolist()

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

    def _tell(self, what):
        if self._group is not None:
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
