"""Panels of the posing lab: how the face answers pins; regions and their sliders."""

import ipywidgets as widgets
import matplotlib
import numpy as np
from matplotlib.colors import to_hex, to_rgb

from facelab.looks.gaze import WIDEST
from facelab.plotting import SKIN, region_colors
from facelab.widgets.lab import WIDTH, Panel, button, row, toggle
from facelab.widgets.pace import Pace
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.parts import ItemList, Sliders
from facelab.widgets.pins import PinPanel

_PREFERRED = (1, 1.25, 1.6, 2, 2.5, 3.2, 4, 5, 6.3, 8)  # ten equal steps of a decade
_LIMIT = 3.0  # standard deviations
_MOLD = {"beta": 0.01, "gamma": 1.0}
_PLAIN = "#9aa5b1"
_GAZE = (
    ("left", "eyes, right to left", "Both eyes to the person's left (+) or right (-), degrees"),
    ("up", "eyes, down to up", "Both eyes up (+) or down (-), degrees"),
)
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


class PosePanel(Panel):
    """How the face answers, how the mouse works, and the pins."""

    def _build(self):
        self.beta = _scale(
            "Regions agree β",
            "How strongly neighbouring regions must agree at their seam",
            -3,
            2,
            [0.0],
        )
        self.gamma = _scale(
            "Stay close γ", "How strongly the face stays close to the pose before the pins", -4, 1
        )
        self.symmetric = toggle("Both sides", "Every drag acts on both sides of the face")
        self.along = toggle(
            "In and out", "Drag along the normal of the skin, as with the shift key"
        )
        self.limit = toggle(
            "Stay natural", f"Stay within {_LIMIT:g} standard deviations of training"
        )
        self.pin_list = PinPanel(self.lab)
        self.pins = self.pin_list.list
        toggles = row(self.symmetric, self.along, self.limit)
        self.widget = widgets.VBox([toggles, self.pin_list.widget, self.beta, self.gamma])
        self._held, self._sliding = None, False
        self.pace = Pace(self.beta, self.gamma, on_hold=self._hold, on_let=self._let)
        self.beta.observe(self._slide, names="value")
        self.gamma.observe(self._slide, names="value")
        for each in (self.symmetric, self.along, self.limit):
            each.observe(self._switch, names="value")

    def refresh(self):
        """Show the settings and the pins."""
        session = self.session
        with quiet(self):
            for slider, value in ((self.beta, session.beta), (self.gamma, session.gamma)):
                _settle(slider, value)
            self.symmetric.value = session.symmetric
            self.limit.value = session.limit is not None
        self.pin_list.refresh()

    def toggle_lock(self, vertex):
        """Lock a pin, or free it; a vertex without one is pinned where it is, and locked."""
        self.pin_list.toggle_lock(vertex)

    def remove_pin(self, vertex):
        """Remove the pin under the mouse, or the one that Tab has chosen."""
        if vertex not in self.session.pins:
            known = ", ".join(item["name"] for item in self.pins.items) or "none"
            raise ValueError(f"the point under the mouse is not pinned; pinned are: {known}.")
        self.session.remove_pin(vertex)

    def _name_of(self, slider):
        return "beta" if slider is self.beta else "gamma"

    @shows_errors
    def _hold(self, slider, hold):
        values = [value for _, value in slider.options]
        self._held = hold
        self.lab.stage.begin_slide(hold, slider, self._name_of(slider), values)

    @shows_errors
    def _let(self, _, hold):
        self.lab.stage.end_slide(hold)
        self._held = None

    def note_change(self):
        """The session has changed: but by the slider that is held, the page draws that no more."""
        if self._held is not None and not self._sliding:
            self.lab.stage.end_slide(self._held)
            self._held = None

    @shows_errors
    def _slide(self, change):
        if not self.settling:
            name, self._sliding = self._name_of(change["owner"]), True
            try:
                with self.session.group(name):
                    self.session.set(**{name: change["new"]})
            finally:
                self._sliding = False

    @shows_errors
    def _switch(self, change):
        for view in self.lab.stage.views:
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
        self.regions = ItemList("choice", self._choose, label="Regions")
        self.regions.layout.max_height = "150px"
        self.mold = toggle(
            "Only here", "β relaxed and γ raised: what a slider does stays in its region"
        )
        self.neutral = button(
            "Reset region", "This region back to the neutral, its pins away", self._reset
        )
        self.sorted = toggle("Strongest first", "Order the sliders by what they do to the pose now")
        self._title = widgets.HTML()
        self.sliders, self.gaze = Sliders(self._slide), Sliders(self._look)
        self.gaze.items = [
            {"id": name, "name": text, "tip": tip, "low": -WIDEST, "high": WIDEST}
            for name, text, tip in _GAZE
        ]
        self.gaze.color = _PLAIN
        if not any(getattr(prop, "look", None) for prop in self.lab.props):
            self.gaze.layout.display = "none"  # no eyes, or still ones of a file
        head = row(self._title, self.sorted, self.mold, self.neutral)
        self.widget = widgets.VBox([self.gaze, self.regions, head, self.sliders])
        self.mold.observe(self._relax, names="value")
        self.sorted.observe(lambda _: self.refresh(), names="value")

    def refresh(self):
        """Show the regions, and the sliders of the chosen one as the pose on screen has them."""
        session = self.session
        if self._model is not session.model:
            self._model, self.region = session.model, 0
            regions, labels = session.regions, session.region_labels
            self._names = ["whole face"] if labels is None else self.lab.places.regions(labels)
            self._said = {}
            self._colors = (
                [_PLAIN] if regions is None else [to_hex(c) for c in region_colors(regions)]
            )
        distance = self.lab.distance(session)
        self.regions.items = [self._row(i, name, distance) for i, name in enumerate(self._names)]
        self.regions.chosen = self.region
        self._title.value = markup("<b>{}</b>", self._names[self.region])
        if not session.beta == _MOLD["beta"]:
            with quiet(self):
                self.mold.value = False
        self.gaze.values = np.round(session.gaze, 3).tolist()
        said, order = self.slider_names(self.region), self._order()
        values, ranges = session.slider_values(self.region), session.mold_ranges(self.region)
        model = self.lab.model_name  # what was moved before another was chosen is not of that
        with self.sliders.hold_sync():
            self.sliders.color = self._colors[self.region]
            self.sliders.items = [
                {"id": f"{self.region} {k} {model}", "name": said[k][0], "tip": said[k][1]}
                | dict(zip(("low", "high"), map(float, ranges[k]), strict=True))
                for k in order
            ]
            self.sliders.values = [float(values[k]) for k in order]

    def slider_names(self, region):
        """Name and tip of each slider of a region: what it moves, as well as it can be said."""
        if region not in self._said:
            session, places = self.session, self.lab.places
            names, shares = session.mold_names(region), session.shares(region)
            moved = session.moved_by(region)
            self._reach = np.linalg.norm(moved, axis=2).max(axis=1)
            said, seen = [], []
            for k, name in enumerate(names):  # those of a rig say themselves what they are for
                does = places.motion(moved[k], literal=session.model.named)
                tip = f"{name}: {does}, {self._reach[k]:.1f} mm".replace(": ,", ":")
                if shares is not None:
                    share = _percent(shares[k])
                    tip += f" for one standard deviation; {share} of the region's motion"
                    side = self._names[region].split(" ")[-1]  # said by the region's own name
                    if side in ("left", "right"):
                        does = " ".join(w for w in does.split(" ") if w != side)
                    name = f"{does or name}, {share}"
                seen.append(name)
                n = seen.count(name)
                said.append((f"{name} ({n})" if n > 1 else name, tip))
            self._said[region] = said, self._reach
        return self._said[region][0]

    def _order(self):
        """Sliders in the order on screen: as the model has them, or by millimetres in the pose."""
        n = len(self.slider_names(self.region))
        if not self.sorted.value:
            return range(n)
        moved = np.abs(self.session.slider_values(self.region)) * self._said[self.region][1]
        return np.lexsort((-self._said[self.region][1], -moved))

    def _row(self, i, name, distance):
        row = {"id": i, "name": name, "color": self._colors[i]}
        if distance is not None:
            row["bar"], row["note"] = float(distance[i] / 4), f"{distance[i]:.1f}"
            row["bar_color"] = next(color for end, color in _GAUGE if distance[i] < end)
            row["tip"] = (
                f"{name}: {distance[i]:.2f} times as far from the average as is typical in training"
            )
        return row

    @shows_errors
    def _slide(self, slider, value):
        region, k = map(int, slider.split(" ", 2)[:2])
        with self.session.group(f"mold {slider}"):
            self.session.slide(region, k, value)

    @shows_errors
    def _look(self, way, degrees):
        gaze = dict(zip(("left", "up"), self.session.gaze.clip(-WIDEST, WIDEST), strict=True))
        with self.session.group(f"look {way}"):
            self.session.look(**{**gaze, way: degrees})

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
        self.lab.stage.color()

    def choose_at(self, vertex):
        """Choose the region of a vertex of the face."""
        labels = self.session.region_labels
        if labels is not None:
            self._choose("choose", int(labels[vertex]))

    @shows_errors
    def _reset(self, _):
        self.session.reset_region(self.region)


def _percent(share):
    """A share in per cent, below one with one digit that counts."""
    share = 100 * float(share)
    low = np.format_float_positional(share, precision=1, fractional=False, trim="-")
    return f"{low if share < 1 else round(share)}\u00a0%"


def _scale(text, tip, low, high, first=()):
    """A slider over preferred numbers from 10^low to 10^high, and what stands before them."""
    decades = [f * 10.0**d for d in range(low, high) for f in _PREFERRED] + [10.0**high]
    numbers = [*first, *(float(f"{x:.3g}") for x in decades)]
    return widgets.SelectionSlider(
        options=[(f"{x:.3g}", x) for x in numbers],
        description=text,
        tooltip=tip,
        layout={"width": WIDTH},
        style={"description_width": "108px"},
    )


def _settle(slider, value):
    """Show a value on a scale, made room for if it is not on it."""
    numbers = [x for _, x in slider.options]
    if value not in numbers:
        slider.options = [(f"{x:.3g}", x) for x in sorted([*numbers, value])]
    slider.value = value
