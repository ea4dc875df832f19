"""Panels of the posing lab: the pins and how the face answers them; regions and their sliders."""

import re

import ipywidgets as widgets
import matplotlib
import numpy as np
from matplotlib.colors import to_hex, to_rgb

from facelab.plotting import SKIN, region_colors
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.parts import ItemList

WIDTH = "330px"
_PREFERRED = (1, 1.25, 1.6, 2, 2.5, 3.2, 4, 5, 6.3, 8)  # ten equal steps of a decade
_WEIGHTS = {"weak": 0.1, "normal": 1.0, "strong": 10.0}
_LIMIT = 3.0  # standard deviations
_MOLD = {"beta": 0.01, "gamma": 1.0}
_PLAIN = "#9aa5b1"
_GAUGE = (
    (2, "#2c7fb8"),
    (3.5, "#d98b00"),
    (np.inf, "#b30000"),
)  # typical distances: usual, far, wild


def shade(name, share):
    """Skin at 0 to the end of a colour map at 1: shape (n, 3)."""
    share = np.clip(share, 0, 1)[:, None]
    strong = matplotlib.colormaps[name](0.35 + 0.6 * share[:, 0])[:, :3]
    mix = np.clip(4 * share, 0, 1)  # in a quarter of the way from skin to the map
    return (1 - mix) * to_rgb(SKIN) + mix * strong


class Panel:
    """Part of a lab: its `widget`, and `refresh` to show the session as it is."""

    def __init__(self, lab):
        self.lab, self.settling = lab, False
        self._build()

    @property
    def session(self):
        return self.lab.session

    def fail(self, error):
        """Errors are shown by the lab."""
        self.lab.fail(error)


class PosePanel(Panel):
    """beta, gamma, how the mouse works, and the pins."""

    def _build(self):
        self.beta = _scale("β agree", "How strongly neighbouring regions must agree", -3, 2, [0.0])
        self.gamma = _scale("γ resist", "How strongly the face resists change", -4, 1)
        self.symmetric = _toggle("symmetric", "Every drag acts on both sides")
        self.along = _toggle("along normal", "Drag along the normal, as with the shift key", 116)
        self.limit = _toggle("soft limit", f"Stay within {_LIMIT:g} standard deviations")
        self.pins = ItemList("rows", self._react, empty="No pins yet: drag a point of the face.")
        toggles = widgets.HBox([self.symmetric, self.along, self.limit])
        self.widget = widgets.VBox([self.beta, self.gamma, toggles, self.pins])
        self.beta.observe(self._slide, names="value")
        self.gamma.observe(self._slide, names="value")
        for toggle in (self.symmetric, self.along, self.limit):
            toggle.observe(self._switch, names="value")

    def refresh(self):
        session = self.session
        with quiet(self):
            for slider, value in ((self.beta, session.beta), (self.gamma, session.gamma)):
                _settle(slider, value)
            self.symmetric.value = session.symmetric
            self.limit.value = session.limit is not None
        self.pins.items = [self._row(vertex) for vertex in session.pins]

    def _row(self, vertex):
        session = self.session
        gap = np.linalg.norm(session.pins[vertex] - session.vertices[vertex])
        locked, weight = vertex in session.locked, session.pin_weights[vertex]
        near = min(_WEIGHTS, key=lambda name: abs(np.log(_WEIGHTS[name] / weight)))
        sign = {"weak": "○", "normal": "◐", "strong": "●"}[near]
        name = self.lab.name_of(vertex)
        return {
            "id": int(vertex),
            "name": name,
            "note": f"{gap:.1f} mm short",
            "tip": f"{name}: the vertex stops {gap:.2f} mm short of its target",
            "buttons": [
                ["weight", sign, f"Weight: {near} ({weight:g}). Click for the next", False],
                ["mirror", "⇋", "The same pin on the other side", False],
                ["lock", "🔒" if locked else "🔓", "Unlock" if locked else "Lock", locked],
                ["remove", "✕", "Remove this pin", False],
            ],
        }

    @shows_errors
    def _react(self, do, vertex):
        session = self.session
        if do == "remove":
            session.remove_pin(vertex)
        elif do == "mirror":
            session.mirror_pin(vertex)
        elif do == "lock":
            self.toggle_lock(vertex)
        elif do == "weight":
            weights = list(_WEIGHTS.values())
            heavier = [w for w in weights if w > 1.01 * session.pin_weights[vertex]]
            session.set_pin(vertex, weight=(heavier or weights)[0])

    def toggle_lock(self, vertex):
        """Lock a pin, or free it; a vertex without one is pinned where it is, and locked."""
        self.session.set_pin(vertex, locked=vertex not in self.session.locked)

    @shows_errors
    def _slide(self, change):
        if not self.settling:
            name = "beta" if change["owner"] is self.beta else "gamma"
            with self.session.group(name):
                self.session.set(**{name: change["new"]})

    @shows_errors
    def _switch(self, change):
        for view in self.lab.views:
            view.along_normal = self.along.value
        if self.settling:
            return
        if change["owner"] is self.symmetric:
            self.session.symmetric = change["new"]
        elif change["owner"] is self.limit:
            self.session.set(limit=_LIMIT if change["new"] else None)


class ShapePanel(Panel):
    """The regions, how far each is from training, and the sliders that mold one of them."""

    def _build(self):
        self.region = 0
        self._model = None
        self.regions = ItemList("choice", self._choose)
        self.regions.layout.max_height = "190px"
        self.mold = _toggle(
            "mold", "β relaxed and γ raised: what a slider does stays in its region"
        )
        self.neutral = widgets.Button(
            description="Reset region",
            tooltip="This region back to the neutral, its pins away",
            layout={"width": "110px"},
        )
        self._title = widgets.HTML(layout={"width": "110px"})
        self.sliders = []
        self._box = widgets.VBox(layout={"max_height": "210px", "overflow": "hidden auto"})
        head = widgets.HBox([self._title, self.mold, self.neutral])
        self.widget = widgets.VBox([self.regions, head, self._box])
        self.neutral.on_click(self._reset)
        self.mold.observe(self._relax, names="value")

    def refresh(self):
        session = self.session
        if self._model is not session.model:
            self._model, self.region = session.model, 0
            self._names = region_names(session)
            regions = session.regions
            self._colors = (
                [_PLAIN] if regions is None else [to_hex(c) for c in region_colors(regions)]
            )
        distance = self.lab.distance(session)
        self.regions.items = [self._row(i, name, distance) for i, name in enumerate(self._names)]
        self.regions.chosen = self.region
        self._title.value = markup("<b>{}</b>", self._names[self.region])
        names = session.mold_names(self.region)
        for k in range(len(self.sliders), len(names)):
            self.sliders.append(self._new_slider(k))
        with quiet(self):
            if not session.beta == _MOLD["beta"]:
                self.mold.value = False
            self._box.children = self.sliders[: len(names)]
            values, ranges = session.mold_values(self.region), session.mold_ranges(self.region)
            for slider, name, value, (low, high) in zip(
                self.sliders, names, values, ranges, strict=False
            ):
                low, high = min(low, value), max(high, value)
                with slider.hold_sync():
                    slider.min, slider.max = min(low, slider.max), max(high, slider.min)
                    slider.min, slider.max, slider.value = low, high, value
                    slider.description = name
                    slider.style.handle_color = self._colors[self.region]

    def _row(self, i, name, distance):
        row = {"id": i, "name": name, "color": self._colors[i]}
        if distance is not None:
            row["bar"], row["note"] = float(distance[i] / 4), f"{distance[i]:.1f}"
            row["bar_color"] = next(color for end, color in _GAUGE if distance[i] < end)
            row["tip"] = (
                f"{name}: {distance[i]:.2f} times as far from the average as is typical in training"
            )
        return row

    def _new_slider(self, k):
        slider = widgets.FloatSlider(
            step=0.05,
            readout_format=".2f",
            layout={"width": "304px", "flex": "0 0 auto"},
            style={"description_width": "96px"},
        )
        slider.observe(lambda change: self._slide(k, change), names="value")
        return slider

    @shows_errors
    def _slide(self, k, change):
        # the page rounds a value to its slider's grid and sends it back: that is no edit
        rounded = abs(change["new"] - self.session.mold_values(self.region)[k]) <= 0.026
        if not self.settling and not rounded:
            with self.session.group(f"mold {self.region} {k}"):
                self.session.mold(self.region, k, change["new"])

    @shows_errors
    def _relax(self, change):
        if self.settling:
            return
        if change["new"]:
            self._before = {"beta": self.session.beta, "gamma": self.session.gamma}
            self.session.set(**_MOLD)
        else:
            self.session.set(**self._before)

    @shows_errors
    def _choose(self, _, region):
        self.region = region
        self.refresh()

    def choose_at(self, vertex):
        """Choose the region of a vertex of the face."""
        labels = self.session.region_labels
        if labels is not None:
            self._choose("choose", int(labels[vertex]))

    @shows_errors
    def _reset(self, _):
        self.session.reset_region(self.region)


def region_names(session):
    """A name for each region, from the landmark nearest to its middle: list of str."""
    labels, face = session.region_labels, session.neutral
    if labels is None:
        return ["whole face"]
    names = []
    for region in range(labels.max() + 1):
        middle = face.vertices[labels == region].mean(axis=0)
        marks = face.landmarks or {f"region {region}": 0}
        near = min(marks, key=lambda name: np.linalg.norm(face.vertices[marks[name]] - middle))
        name = re.sub(r"_(\d|upper|lower|inner|outer|tip|bridge|base|corner)+", "", near)
        names.append(name.replace("_", " "))
    return [
        f"{name} {names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def _toggle(text, tip, width=98):
    return widgets.ToggleButton(
        description=text, tooltip=tip, layout={"width": f"{width}px", "height": "26px"}
    )


def _scale(text, tip, low, high, first=()):
    """A slider over preferred numbers from 10^low to 10^high, and what stands before them."""
    decades = [f * 10.0**d for d in range(low, high) for f in _PREFERRED] + [10.0**high]
    numbers = [*first, *(float(f"{x:.3g}") for x in decades)]
    return widgets.SelectionSlider(
        options=[(f"{x:.3g}", x) for x in numbers],
        description=text,
        tooltip=tip,
        layout={"width": WIDTH},
        style={"description_width": "56px"},
    )


def _settle(slider, value):
    """Show a value on a scale, made room for if it is not on it."""
    numbers = [x for _, x in slider.options]
    if value not in numbers:
        slider.options = [(f"{x:.3g}", x) for x in sorted([*numbers, value])]
    slider.value = value
