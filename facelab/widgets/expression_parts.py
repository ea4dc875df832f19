"""What the expression lab draws itself: the error over alpha, and a bar for each unit."""

import traitlets

from facelab.widgets.in_touch import script, style
from facelab.widgets.parts import Part


class _Drawn(Part):
    _esm, _css = script("expression_parts"), style("expression_parts")


class AlphaCurve(_Drawn):
    """RMS distance over alpha, the best one and the present one marked, and a slider below.

    Parameters
    ----------
    alphas : sequence of float
        Ascending, from 0.
    on_choose : callable
        Called with the place of an alpha that was chosen in the page.

    Attributes
    ----------
    rms : list of float
        For each alpha, millimetres.
    place, best : int
        Of the present and of the best alpha.
    reach : float
        Largest sum of the weights; beyond it the curve is shaded.
    """

    alphas = traitlets.List().tag(sync=True)
    rms = traitlets.List().tag(sync=True)
    best = traitlets.Int().tag(sync=True)
    reach = traitlets.Float().tag(sync=True)
    place = traitlets.Int().tag(sync=True, echo_update=False)

    def __init__(self, alphas, on_choose):
        super().__init__(kind="curve", alphas=list(alphas), rms=[0.0] * len(alphas))
        self.on_choose = on_choose
        self.observe(self._choose, names="place")

    def _choose(self, change):
        try:
            self.on_choose(change["new"])
        finally:
            self.send({"heard": change["new"], "place": self.place})


class UnitBars(_Drawn):
    """A row for each unit: picture, name, bar, lock, exclude.

    Parameters
    ----------
    units : list of dict
        name, tip, and picture (PNG as base64, may be empty) of each.
    on_edit : callable
        Called with "lock", "exclude", "weight" or "settle" (a drag ended), the number of the unit
        and the weight.

    Attributes
    ----------
    weights : list of float
    states : list of str
        "free", "locked", "excluded" or "dropped" for each unit.
    order : list of int
        Of the units from the top.
    """

    units = traitlets.List().tag(sync=True)
    weights = traitlets.List().tag(sync=True)
    states = traitlets.List().tag(sync=True)
    order = traitlets.List().tag(sync=True)

    def __init__(self, units, on_edit):
        blank = {"weights": [0.0] * len(units), "states": ["free"] * len(units)}
        blank["order"] = list(range(len(units)))
        super().__init__(kind="bars", units=units, **blank)
        self.on_edit = on_edit
        self.on_msg(self._hear)

    def _hear(self, _, message, __):
        try:
            for edit in message["edits"]:
                self.on_edit(*edit)
        finally:
            self.send({"heard": message["asked"]})
