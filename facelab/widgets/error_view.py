"""Errors of region models against whole faces, for every number of regions and components."""

import io

import ipywidgets as widgets
from matplotlib.figure import Figure

from facelab.checks import check_index
from facelab.widgets.page import Page, markup

_COLORS = "#d55e00", "#0072b2", "#56b4e9"  # regions, whole face twice: as in the figures
_WIDE = {"style": {"description_width": "96px"}}  # the longest name is 'components'


class ErrorView(Page):
    """A page with two sliders and three bars; all errors were found beforehand.

    Parameters
    ----------
    grid : facelab.studies.figure5.ErrorGrid
    people : sequence of str
        Names of the actors of the grid, in order.
    person : int, default=0
        Who is shown first.

    Attributes
    ----------
    regions, components, person : ipywidgets.Widget
        The controls.
    errors : dict of str to float
        The bars on screen, millimetres.
    widget : ipywidgets.Widget
    """

    def __init__(self, grid, people, person=0):
        self.grid = grid
        person = check_index(person, "person", len(people), "people")
        options = [(str(n), i) for i, n in enumerate(grid.counts)]
        self.regions = widgets.SelectionSlider(options=options, description="regions", **_WIDE)
        options = [(str(n), i) for i, n in enumerate(grid.sizes)]
        self.components = widgets.SelectionSlider(
            options=options, description="components", **_WIDE
        )
        options = [(name, i) for i, name in enumerate(people)]
        self.person = widgets.Dropdown(
            options=options, value=person, description="tested on", **_WIDE
        )
        self._build_messages()
        self._bars = widgets.HTML()
        controls = (self.regions, self.components, self.person)
        for control in controls:
            control.observe(self._changed, names="value")
        self.widget = widgets.VBox([*controls, self._bars, self._status, self._message])
        self._changed(None)

    def picture(self):
        """The bars: bytes of a PNG."""
        figure = Figure(figsize=(6.2, 1.5), dpi=100, layout="constrained")
        axes = figure.subplots()
        bars = axes.barh(list(self.errors), list(self.errors.values()), color=_COLORS, height=0.6)
        axes.bar_label(bars, fmt=" %.3f mm", fontsize=9)
        axes.set(xlim=(0, 1.35 * self._longest), xticks=[], ylim=(2.5, -0.5))
        axes.tick_params(left=False, labelsize=9)
        axes.spines[:].set_visible(False)
        file = io.BytesIO()
        figure.savefig(file)
        return file.getvalue()

    def _settings_in_words(self):
        return (f"RMS error, tested on {self.person.label}.",)

    @property
    def _longest(self):
        """Of all bars that the sliders can show for a person, millimetres."""
        k = self.person.value
        return max(self.grid.region[..., k].max(), self.grid.holistic[:, k].max())

    def _changed(self, _):
        i, j, k = self.regions.value, self.components.value, self.person.value
        grid = self.grid
        count, size = grid.counts[i], grid.sizes[j]
        each, in_all = (_several(n, "component") for n in (size, count * size))
        self.errors = {
            f"{_several(count, 'region')}, {each} each": float(grid.region[i, j, k]),
            f"whole face, {each}": float(grid.holistic[j, k]),
            f"whole face, {in_all}": float(grid.as_many[i, j, k]),
        }
        row = (
            '<div style="display:flex;align-items:center"><span style="width:17em">{}</span>'
            '<span style="background:{};height:1em;width:{}px"></span>&nbsp;{} mm</div>'
        )
        self._bars.value = "".join(
            markup(row, name, color, f"{300 * mm / self._longest:.0f}", f"{mm:.3f}")
            for (name, mm), color in zip(self.errors.items(), _COLORS, strict=True)
        )
        self.say(f"{count * size} parameters in all; stored and reckoned with as {size} are.")


def _several(n, what):
    return f"{n} {what}" + "s" * (n != 1)
