"""The list of pins of a lab: each with its name, and on choice its target in numbers."""

import ipywidgets as widgets
import numpy as np

from facelab.widgets.lab import WIDTH, Panel, row
from facelab.widgets.page import quiet, shows_errors
from facelab.widgets.parts import ItemList

_NO_PLACE = -1  # not None: a list with that chosen shows nothing
_FARTHEST = 100.0  # mm that a point can be typed away from its place at rest
_WEIGHTS = {"weak": 0.1, "normal": 1.0, "strong": 10.0}
_AXES = {
    "x": "From where the point rests, millimetres to the person's left",
    "y": "From where the point rests, millimetres up",
    "z": "From where the point rests, millimetres forward",
}


class PinPanel(Panel):
    """The pins of a session: weight, mirror, lock, hide, remove; name and target of the chosen one.

    `lab.pinned` is what has the pins: a PosingSession, or an ExpressionSession whose sketch is
    pulled by hand, which has neither weights nor locks.
    """

    def _build(self):
        self.chosen = None
        self.list = ItemList(
            "choice", self._react, "No pins yet: drag a point of the face.", label="Pins"
        )
        self.list.layout.max_height = "180px"
        self.name = widgets.Text(
            description="name", continuous_update=False, layout={"width": WIDTH}
        )
        self.target = [
            widgets.FloatText(
                description=axis, tooltip=tip, step=0.5, layout={"width": "31%"},
                style={"description_width": "14px"}, continuous_update=False,
            )
            for axis, tip in _AXES.items()
        ]  # fmt: skip
        self.name.style.description_width = "44px"
        self.name.tooltip = "What to call this pin; empty for the name of its place"
        self._editor = widgets.VBox([self.name, row(*self.target)])
        marks = self.lab.places.mesh.landmarks.values()
        places = {self.lab.name_of(v): int(v) for v in sorted(marks, reverse=True)}
        self.place = widgets.Dropdown(
            options=[("choose a place ...", _NO_PLACE), *sorted(places.items())],
            description="Pin", layout={"width": WIDTH}, style={"description_width": "44px"},
            tooltip="A pin without the mouse; arrow keys move it when the focus is on the face",
        )  # fmt: skip
        if not places or not hasattr(self.pinned, "hold"):
            self.place.layout.display = "none"
        self.widget = widgets.VBox([self.list, self._editor, self.place])
        self.place.observe(self._hold, names="value")
        self.name.observe(self._rename, names="value")
        for field in self.target:
            field.observe(self._type, names="value")

    @property
    def pinned(self):
        """The session that has the pins."""
        return self.lab.pinned

    def refresh(self):
        """Show the pins as they are."""
        pins = self.pinned.pins
        if self.chosen not in pins:
            self.chosen = None
        names, V = self._names(pins), self.lab.pinned_face
        self.list.items = [self._row(v, names[v], pins[v] - V[v]) for v in pins]
        self.list.chosen = list(pins).index(self.chosen) if self.chosen is not None else -1
        self._editor.layout.display = "none" if self.chosen is None else "flex"
        if self.chosen is None:
            return
        off = pins[self.chosen] - self.lab.mesh.vertices[self.chosen]
        locked = self.chosen in getattr(self.pinned, "locked", ())
        with quiet(self):
            self.name.value = names[self.chosen]
            for field, value in zip(self.target, off, strict=True):
                field.value, field.disabled = round(float(value), 2), locked

    def _names(self, pins):
        """The given name of each pin, or its place; those alike are numbered."""
        given, names = self.pinned.pin_names, {}
        for v in pins:
            name = given.get(v) or self.lab.name_of(v)
            n = sum(other.split(" (")[0] == name for other in names.values())
            names[v] = f"{name} ({n + 1})" if n else name
        return names

    def _row(self, vertex, name, gap):
        pinned, gap = self.pinned, float(np.linalg.norm(gap))
        buttons = []
        if hasattr(pinned, "locked"):
            locked, weight = vertex in pinned.locked, pinned.pin_weights.get(vertex, 1.0)
            near = min(_WEIGHTS, key=lambda name: abs(np.log(_WEIGHTS[name] / weight)))
            sign = {"weak": "○", "normal": "◐", "strong": "●"}[near]
            buttons = [
                ["weight", sign, f"Weight: {near} ({weight:g}). Click for the next", False],
                ["mirror", "⇋", "The same pin on the other side", False],
                ["lock", "⚓", "Unlock" if locked else "Lock", locked],
            ]
        hidden = vertex in pinned.hidden
        buttons += [
            ["hide", "◌" if hidden else "◉", "Show this pin" if hidden else "Hide it", hidden],
            ["remove", "✕", "Remove this pin", False],
        ]
        return {
            "id": int(vertex),
            "name": name,
            "note": f"{gap:.1f} mm" if gap >= 0.05 else "",
            "tip": f"{name} (vertex {vertex}): stops {gap:.2f} mm short of its target. "
            "Click to name it and to type its target",
            "buttons": buttons,
        }

    @shows_errors
    def _react(self, do, vertex):
        pinned = self.pinned
        if do == "choose":
            self.chosen = None if vertex == self.chosen else vertex
            self.refresh()
        elif do == "remove":
            pinned.remove_pin(vertex)
        elif do == "mirror":
            pinned.mirror_pin(vertex)
        elif do == "lock":
            self.toggle_lock(vertex)
        elif do == "hide":
            pinned.set_pin(vertex, hidden=vertex not in pinned.hidden)
        elif do == "weight":
            heavier = [w for w in _WEIGHTS.values() if w > 1.01 * pinned.pin_weights[vertex]]
            pinned.set_pin(vertex, weight=(heavier or list(_WEIGHTS.values()))[0])

    @shows_errors
    def _hold(self, change):
        if change["new"] != _NO_PLACE:
            with quiet(self):
                self.place.value = _NO_PLACE
            self.chosen = change["new"]
            self.pinned.hold(self.chosen)
            self.refresh()

    def toggle_lock(self, vertex):
        """Lock a pin, or free it; a vertex without one is pinned where it is, and locked."""
        self.pinned.set_pin(vertex, locked=vertex not in self.pinned.locked)

    @shows_errors
    def _rename(self, change):
        if not self.settling and self.chosen is not None:
            name = change["new"].strip()
            place = self.lab.name_of(self.chosen)
            self.pinned.set_pin(self.chosen, name="" if name == place else name)

    @shows_errors
    def _type(self, _):
        if self.settling or self.chosen is None:
            return
        rest, now = self.lab.mesh.vertices[self.chosen], self.pinned.pins[self.chosen]
        typed = np.array([field.value for field in self.target])
        far = np.abs(typed).max()
        if far > _FARTHEST:
            raise ValueError(f"no face goes as far as {far:g} mm; type {_FARTHEST:g} mm at most.")
        target = np.where(np.abs(typed - (now - rest)) < 0.006, now, rest + typed)
        self.pinned.set_pin(self.chosen, target)
