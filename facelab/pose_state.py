"""One moment of a posing session, as a value."""

from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np


def frozen_copy(array):
    """A copy as float64 that cannot be written to."""
    array = np.array(array, dtype=float)
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class PoseState:
    """One moment of a session: all that decides the pose. Keep it to come back to it.

    It has copies of its own of all arrays, and they cannot be written to.

    Parameters
    ----------
    model : RegionModel, HolisticModel or BlendshapeRig
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

    def __post_init__(self):
        pins = {v: frozen_copy(t) for v, t in self.pins.items()}
        values = {"pins": MappingProxyType(pins), "weights": MappingProxyType(dict(self.weights))}
        for name in ("c_0", "coefficients", "molded"):
            values[name] = frozen_copy(getattr(self, name))
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def same(self, other):
        """Whether nothing at all differs."""
        return (
            self.model is other.model
            and (self.beta, self.gamma, self.limit) == (other.beta, other.gamma, other.limit)
            and (self.locked, dict(self.weights)) == (other.locked, dict(other.weights))
            and self.pins.keys() == other.pins.keys()
            and all(np.array_equal(t, other.pins[v]) for v, t in self.pins.items())
            and np.array_equal(self.c_0, other.c_0)
            and np.array_equal(self.molded, other.molded)
            and np.array_equal(self.coefficients, other.coefficients)
        )
