"""A hand for views without a page: it tells the kernel what a page would, and draws like one."""

import itertools

import numpy as np
from pulls import moved, target_in

from facelab.posing.bounded import BoundedPull
from facelab.widgets.hand import Hand

_presses = itertools.count()
_answers = {}  # of each view's last press: {view: (press, answer, ahead, target)}
_pulls = {}  # press: offset
_told = {}  # press: what each message of it says


def _answer(hand, press, pull, vertex, target, ahead):
    _answers[hand.model_id] = press, pull, np.asarray(ahead), np.asarray(target)


Hand.answer = _answer  # there is no page to answer


def press(view, vertex):
    """Take hold of a vertex, in the page."""
    name = f"press {next(_presses)}"
    _pulls[name] = np.zeros(3)
    _told[name] = {"press": name, "vertex": vertex}
    view._hear({**_told[name], "do": "press"})
    return name


def move(view, offset):
    """Move what is held by an offset in millimetres from where it was taken hold of."""
    name = view._grip.press
    if name is not None:
        _pulls[name] = np.array(offset, dtype=float)
        view._hear({**_told[name], "do": "move", "offset": list(offset)})


def let_go(view, offset=None):
    """Let go, at an offset if one is given; else where the last move was."""
    name = view._grip.press
    if name is not None and offset is None and _pulls[name].any():
        offset = _pulls[name].tolist()
    if name is not None:
        view._hear({**_told[name], "do": "release", "offset": offset})


def hover(view, vertex):
    """The mouse is over a vertex, or beside the face for None."""
    view._hear({"do": "hover", "vertex": vertex})


def drawn(view):
    """Positions that the page draws, shape (n_vertices, 3): what was sent, and the pull."""
    V = view._position.array[: view.mesh.n_vertices].astype(float)
    press, answer, ahead, target = _answers.get(view._hand.model_id, 4 * (None,))
    if press is None or press != view._grip.press:
        return V
    pull = _pulls[press] + ahead
    if not isinstance(answer, BoundedPull):
        return V + answer @ pull
    return V + moved(answer, target_in(answer, target + pull) - target)
