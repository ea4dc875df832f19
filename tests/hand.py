"""A hand for views without a page: it tells the kernel what a page would, and draws like one."""

import itertools

import numpy as np
from scipy.optimize import minimize

from facelab.posing.bounded import BoundedPull
from facelab.widgets.hand import Hand

_presses = itertools.count()
_answers = {}  # of each view's last press: {view: (press, answer, ahead, target)}
_pulls = {}  # press: offset


def _answer(hand, press, pull, vertex, target, ahead):
    _answers[hand.model_id] = press, pull, np.asarray(ahead), np.asarray(target)


Hand.answer = _answer  # there is no page to answer


def press(view, vertex):
    """Take hold of a vertex, in the page."""
    name = f"press {next(_presses)}"
    _pulls[name] = np.zeros(3)
    view._hear({"do": "press", "press": name, "vertex": vertex})
    return name


def move(view, offset):
    """Move what is held by an offset in millimetres from where it was taken hold of."""
    name = view._grip.press
    if name is not None:
        _pulls[name] = np.array(offset, dtype=float)
        view._hear({"do": "move", "press": name, "offset": list(offset)})


def let_go(view, offset=None):
    """Let go, at an offset if one is given; else where the last move was."""
    name = view._grip.press
    if name is not None and offset is None and _pulls[name].any():
        offset = _pulls[name].tolist()
    view._hear({"do": "release", "press": name, "offset": offset})


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
    if answer.centre is not None:
        off = target + pull - answer.centre
        off *= min(1, answer.radius / np.linalg.norm(off))
        pull = answer.centre + off - target
    return V + moved(answer, pull)


def moved(pull, t):
    """Displacements of a face under a pull t (3,), by a general minimiser of what it says."""
    f = pull.free + pull.slope @ t
    A = np.linalg.inv(pull.inverse)
    hard = pull.give == 0
    stiff = np.where(hard, 0, 1 / np.where(hard, 1, pull.give))

    def energy(c):
        beyond = c - c.clip(pull.lo, pull.hi)
        return (c - f) @ A @ (c - f) / 2 + stiff @ beyond**2 / 2, A @ (c - f) + stiff * beyond

    ends = zip(pull.lo, pull.hi, hard, strict=True)
    ends = [(lo, hi) if h else (None, None) for lo, hi, h in ends]
    tight = {"ftol": 0, "gtol": 1e-12, "maxiter": 10_000, "maxfun": 100_000, "maxcor": 50}
    c = minimize(energy, pull.start, jac=True, bounds=ends, method="L-BFGS-B", options=tight).x
    by = np.tensordot(c - pull.start, pull.basis.rows, 1)
    return by if pull.basis.weights is None else pull.basis.weights @ by
