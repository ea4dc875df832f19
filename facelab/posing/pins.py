"""The pins of a posing session: what a hand can do to them, beside pulling."""

from facelab.checks import check_choice, check_type
from facelab.geometry.symmetry import MIRROR
from facelab.numeric.undo import edit
from facelab.posing.ranges import check_weight

_LONGEST = 60  # letters of a name


class PinEdits:
    """Pins as a part of `PosingSession`: each edit is a step of its own."""

    @property
    def pin_weights(self):
        """Weights of the pins: dict of int to float."""
        return dict(zip(self.state.pins, self.state.weights_of(self.state.pins), strict=True))

    @property
    def locked(self):
        """Pins that no drag moves: frozenset of int."""
        return self.state.locked

    @property
    def hidden(self):
        """Pins that are not drawn, though they hold: frozenset of int."""
        return self.state.hidden

    @property
    def pin_names(self):
        """Names given to pins: dict of int to str."""
        return dict(self.state.called)

    def hold(self, vertex):
        """Pin a vertex where it is, so that later pulls leave it there."""
        self.set_pin(vertex)

    @edit
    def set_pin(self, vertex, target=None, weight=None, locked=None, hidden=None, name=None):
        """Make a pin, or move, weight, lock or unlock one.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.
        target : array_like of shape (3,), optional
            Millimetres; if left out, that of the pin, or where the vertex is.
        weight : float, optional
            Of the pin in Eq. 9, 1e-6 to 1e6; 1 unless set.
        locked : bool, optional
            A locked pin is neither dragged, mirrored upon nor removed; resets take it away.
        hidden : bool, optional
            A hidden pin is not drawn, and holds.
        name : str, optional
            What to call it; empty for the name of its place.

        Raises
        ------
        ValueError
            For a vertex that does not exist, a bad target or weight, or a new target for a pin
            that is locked and stays so; nothing changes.
        """
        vertex, state = self._face.vertex(vertex), self.state
        if target is not None:
            target = self._face.place(vertex, target) - self.neutral.vertices[vertex]
            if locked is not False:
                self.state.check_unlocked(vertex)
        weights = dict(state.weights)
        if weight is not None:
            weights[vertex] = check_weight(weight)
        called = dict(state.called)
        if name is not None:
            called[vertex] = _short(name)
        pin = self._place(vertex) if target is None else target
        return self._solved(
            pins={**state.pins, vertex: pin},
            weights=weights,
            locked=_with(state.locked, vertex, locked, "locked"),
            hidden=_with(state.hidden, vertex, hidden, "hidden"),
            called=called,
        )

    @edit
    def remove_pin(self, vertex):
        """Take a pin away; the others keep holding.

        Raises
        ------
        ValueError
            If the vertex is not pinned, or locked.
        """
        vertex = self._face.vertex(vertex)
        self.state.check_pinned(vertex)
        self.state.check_unlocked(vertex)
        return self._solved(**self.state.without({vertex}))

    @edit
    def mirror_pin(self, vertex):
        """Put the mirrored pin, its weight too, on the vertex's partner.

        Raises
        ------
        ValueError
            If the vertex is not pinned, or has no partner on the other side, or a locked one.
        """
        vertex = self._face.vertex(vertex)
        self.state.check_pinned(vertex)
        partner = int(self.partners[vertex])
        if partner in (-1, vertex):
            raise ValueError(f"vertex={vertex} has no partner on the other side of the face.")
        self.state.check_unlocked(partner)
        state = self.state
        weights = {**state.weights, partner: state.weights.get(vertex, 1)}
        pins = {**state.pins, partner: MIRROR @ state.pins[vertex]}
        return self._solved(pins=pins, weights=weights)


def _with(vertices, vertex, on, name):
    """The set of vertices with one more, or one less, or as it is where `on` is None."""
    if on is None:
        return vertices
    return vertices | {vertex} if check_choice(on, name, (True, False)) else vertices - {vertex}


def _short(name):
    name = check_type(name, "name", str, "give a text").strip()
    if len(name) > _LONGEST:
        raise ValueError(f"name has {len(name)} letters; give at most {_LONGEST}.")
    return name
