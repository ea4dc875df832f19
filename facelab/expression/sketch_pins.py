"""The pins of a sketch that is pulled by hand, vertex by vertex."""

from types import MappingProxyType

import numpy as np

from facelab.checks import as_finite, check_choice, check_index, check_type
from facelab.expression.units import sketch_positions
from facelab.posing.sculpt import Sculpt

BY_HAND = "pulled by hand"
"""Where a sketch comes from that was pulled."""

NO_PINS = {
    "pulls": MappingProxyType({}), "hidden": frozenset(), "called": MappingProxyType({}),
}  # fmt: skip
"""What changes when another sketch comes."""


def fixed_positions(sketch):
    """A copy of a sketch's positions that cannot be written to, (n_vertices, 3), millimetres."""
    V = sketch_positions(sketch).copy()
    V.flags.writeable = False
    return V


class SketchPins:
    """Pins as a part of `ExpressionSession`: pulls of the sketch add up, in any order."""

    @property
    def pins(self):
        """Vertices by which the sketch was pulled, and where they are: dict of int to (3,)."""
        return {v: self.sketch[v] for v in self.state.pulls}

    @property
    def hidden(self):
        """Pins that are not drawn: frozenset of int."""
        return self.state.hidden

    @property
    def pin_names(self):
        """Names given to pins: dict of int to str."""
        return dict(self.state.called)

    def set_pin(self, vertex, target=None, hidden=None, name=None):
        """Pull a vertex of the sketch to a target, as `Sculpt` does; hide or name its pin.

        Parameters
        ----------
        vertex : int
        target : array_like of shape (3,), optional
            Millimetres; the pin stays where it is if left out.
        hidden : bool, optional
        name : str, optional
            Empty for none.

        Raises
        ------
        ValueError, TypeError
            For a vertex that does not exist, or a target that is not finite; nothing changes.
        """
        changes, state = {}, self.state
        vertex = check_index(vertex, "vertex", self.rig.neutral.n_vertices, "vertices of the face")
        if target is not None or vertex not in state.pulls:
            target = self.sketch[vertex] if target is None else target
            target = as_finite(target, "target", (3,), remedy="give three finite coordinates")
            changes = self._pulled(vertex, target - self.sketch[vertex])
        if hidden is not None:
            on = check_choice(hidden, "hidden", (True, False))
            changes["hidden"] = state.hidden | {vertex} if on else state.hidden - {vertex}
        if name is not None:
            called = {**state.called, vertex: check_type(name, "name", str, "give a text").strip()}
            changes["called"] = MappingProxyType({v: n for v, n in called.items() if n})
        self._step(**changes)

    def remove_pin(self, vertex):
        """Take a pull of the sketch back, and its pin away.

        Raises
        ------
        ValueError
            For a vertex that is no pin.
        """
        state = self.state
        if vertex not in state.pulls:
            raise ValueError(f"vertex={vertex} is no pin of this sketch.")
        changes = self._pulled(vertex, -np.array(state.pulls[vertex]))
        for name in ("pulls", "called"):
            kept = changes.get(name, getattr(state, name))
            changes[name] = MappingProxyType({v: x for v, x in kept.items() if v != vertex})
        self._step(**changes, hidden=state.hidden - {vertex})

    def _pulled(self, vertex, went):
        """What changes when the sketch is pulled by a vertex, softly: dict."""
        sketch = self.sketch
        follow = Sculpt(self.rig.neutral, sketch).follow(vertex)
        return {
            "sketch": fixed_positions(sketch + follow[:, None] * went),
            "origin": BY_HAND,
            "pulls": self._pulls_and(vertex, went),
        }

    def _pulls_and(self, vertex, went):
        so_far = np.array(self.state.pulls.get(vertex, (0.0, 0.0, 0.0)))
        pulls = {v: o for v, o in self.state.pulls.items() if v != vertex}
        return MappingProxyType({**pulls, vertex: tuple((so_far + went).tolist())})
