"""One moment of a posing session, as a value."""

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from facelab.checks import as_finite, check_number
from facelab.posing.fingerprint import differs, fingerprint
from facelab.posing.ranges import check_gaze
from facelab.posing.stored import check_entries, entry

_STORED = "model", "beta", "gamma", "limit", "pins", "c_0", "molded", "coefficients"


def frozen_copy(array):
    """A copy as float64 that cannot be written to; the array itself if that is so already."""
    own = isinstance(array, np.ndarray) and array.dtype == float and array.base is None
    if not own or array.flags.writeable:
        array = np.array(array, dtype=float)
        array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class PoseState:
    """One moment of a session: all that decides the pose. Keep it to come back to it.

    It has copies of its own of all arrays, and they cannot be written to.

    Parameters
    ----------
    model : FaceModel
    pins : mapping of int to ndarray of shape (3,)
        Vertex of the shown face to wanted displacement from the neutral, millimetres.
    beta, gamma : float
    c_0 : ndarray of shape (P,)
        Pose that was kept before the pins were set.
    coefficients : ndarray of shape (P,)
        The answer.
    molded : ndarray of shape (P,)
        What sliders have added to c_0.
    weights : mapping of int to float
        Of the pins, where not 1.
    locked : frozenset of int
        Pins that no drag moves.
    limit : float or None
        Standard deviations, see `PoseSolver`.
    hidden : frozenset of int
        Pins that are not drawn; they hold all the same.
    called : mapping of int to str
        Names given to pins.
    gaze : (float, float)
        Degrees that both eyes are turned by hand, to the person's left and up, beyond what the
        skin around them says.
    """

    model: object = field(repr=False)
    pins: MappingProxyType
    beta: float
    gamma: float
    c_0: np.ndarray = field(repr=False)
    coefficients: np.ndarray = field(repr=False)
    molded: np.ndarray = field(repr=False)
    weights: MappingProxyType = field(default_factory=dict)
    locked: frozenset = frozenset()
    limit: float | None = None
    hidden: frozenset = frozenset()
    called: MappingProxyType = field(default_factory=dict)
    gaze: tuple = (0.0, 0.0)

    def __post_init__(self):
        pins = {v: frozen_copy(t) for v, t in self.pins.items()}
        weights = {v: w for v, w in self.weights.items() if w != 1}
        called = {v: name for v, name in self.called.items() if name}
        values = {"pins": pins, "weights": weights, "called": called}
        values = {name: MappingProxyType(value) for name, value in values.items()}
        for name in ("c_0", "coefficients", "molded"):
            values[name] = frozen_copy(getattr(self, name))
        values["gaze"] = tuple(float(degrees) for degrees in self.gaze)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def weights_of(self, vertices):
        """Weights of pins, 1 where none was set: list of float."""
        return [self.weights.get(v, 1.0) for v in vertices]

    def check_pinned(self, vertex):
        """Refuse a vertex without a pin."""
        if vertex not in self.pins:
            known = ", ".join(map(str, self.pins)) or "none"
            raise ValueError(f"vertex={vertex} is not pinned; pinned are: {known}.")

    def check_unlocked(self, vertex):
        """Refuse a locked pin."""
        if vertex in self.locked:
            raise ValueError(
                f"vertex={vertex} is a locked pin; unlock it first: "
                f"set_pin({vertex}, locked=False)."
            )

    def without(self, gone):
        """What changes when some pins go, with their weights and locks: dict."""
        return self.placed({v: (v, t) for v, t in self.pins.items() if v not in gone})

    def placed(self, places):
        """What changes when pins stand elsewhere, or go, or are there twice: dict.

        Parameters
        ----------
        places : dict of int to (int, ndarray of shape (3,))
            For each vertex that shall be pinned the pin that it takes after, and its displacement.
        """
        after = {v: pin for v, (pin, _) in places.items()}
        return {
            "pins": {v: t for v, (_, t) in places.items()},
            "weights": {v: self.weights.get(pin, 1.0) for v, pin in after.items()},
            "locked": frozenset(v for v, pin in after.items() if pin in self.locked),
            "hidden": frozenset(v for v, pin in after.items() if pin in self.hidden),
            "called": {v: self.called.get(pin, "") for v, pin in after.items()},
        }

    def bare(self, c_0):
        """What changes when all pins go and the pose starts from c_0: dict."""
        return {**self.without(self.pins.keys()), "c_0": c_0, "molded": np.zeros_like(c_0)}

    def same(self, other):
        """Whether nothing at all differs."""
        return (
            self.model is other.model
            and (self.beta, self.gamma, self.limit) == (other.beta, other.gamma, other.limit)
            and (self.locked, self.hidden) == (other.locked, other.hidden)
            and self.gaze == other.gaze
            and (self.weights, self.called) == (other.weights, other.called)
            and self.pins.keys() == other.pins.keys()
            and all(np.array_equal(t, other.pins[v]) for v, t in self.pins.items())
            and np.array_equal(self.c_0, other.c_0)
            and np.array_equal(self.molded, other.molded)
            and np.array_equal(self.coefficients, other.coefficients)
        )


def state_to_dict(state):
    """A `PoseState` for JSON; numbers keep every bit."""
    return {
        "model": fingerprint(state.model),
        "beta": state.beta,
        "gamma": state.gamma,
        "limit": state.limit,
        "pins": [
            {
                "vertex": int(v),
                "displacement": np.asarray(t).tolist(),
                "weight": state.weights.get(v, 1.0),
                "locked": v in state.locked,
                **({"hidden": True} if v in state.hidden else {}),
                **({"name": state.called[v]} if v in state.called else {}),
            }
            for v, t in state.pins.items()
        ],
        "c_0": state.c_0.tolist(),
        "molded": state.molded.tolist(),
        "coefficients": state.coefficients.tolist(),
        **({"gaze": list(state.gaze)} if any(state.gaze) else {}),
    }


def state_from_dict(stored, session, models=()):
    """The `PoseState` of a dict: all of the kind it should be; `session.restore` judges the rest.

    Raises
    ------
    ValueError, TypeError
        For what is missing, of another kind, not finite, or there twice.
    """
    check_entries(stored, (*_STORED, "gaze"))
    pins, weights, locked, hidden, called = {}, {}, set(), set(), {}
    for pin in entry(stored, "pins", list):
        v = entry(pin, "vertex", int)
        check_entries(pin, ("vertex", "displacement", "weight", "locked", "hidden", "name"))
        if v in pins:
            raise ValueError(f"vertex={v} is pinned twice")
        pins[v] = as_finite(entry(pin, "displacement", list), f"displacement of pin {v}", (3,))
        weights[v] = check_number(entry(pin, "weight", float), f"weight of pin {v}")
        locked |= {v} if entry(pin, "locked", bool) else set()
        hidden |= {v} if "hidden" in pin and entry(pin, "hidden", bool) else set()
        called[v] = entry(pin, "name", str) if "name" in pin else ""
    model = find_model(entry(stored, "model", dict), session, models)
    arrays = {
        name: as_finite(entry(stored, name, list), name, (model.n_coefficients,))
        for name in ("c_0", "molded", "coefficients")
    }
    beta, gamma = (check_number(entry(stored, x, float), x) for x in ("beta", "gamma"))
    limit = entry(stored, "limit", float, type(None))
    limit = limit if limit is None else check_number(limit, "limit")
    kept = {"weights": weights, "locked": frozenset(locked), "limit": limit}
    kept |= {"hidden": frozenset(hidden), "called": called}
    if "gaze" in stored:
        kept["gaze"] = check_gaze(entry(stored, "gaze", list))
    return PoseState(model, pins, beta, gamma, **arrays, **kept)


def find_model(stored, session, models):
    """The model of a fingerprint: the session's own, one that it had before, or one given."""
    given = models.values() if isinstance(models, dict) else models
    reasons = []
    for model in (*session.models, *given):
        reasons.append(differs(stored, fingerprint(model)))
        if not reasons[-1]:
            return model
    raise ValueError(f"it was made with another model: {reasons[0]}; use that model.")
