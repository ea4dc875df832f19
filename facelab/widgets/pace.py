"""Sliders that tell the kernel no more often than it should hear where they are."""

import traitlets

from facelab.widgets.in_touch import InTouch, script


class Pace(InTouch):
    """Holds sliders back in the page; what they tell last always arrives.

    Parameters
    ----------
    sliders : ipywidgets.Widget
    every : int, default=100
        Milliseconds from one telling of a slider to its next.
    on_hold, on_let : callable, optional
        Called with (slider, name of the hold) when the mouse takes hold of a slider, which has an
        `index`, and when all that it had to tell after that is known.
    """

    _esm = script("pace")
    sliders = traitlets.List().tag(sync=True)
    every = traitlets.Int().tag(sync=True)
    watches = traitlets.Bool().tag(sync=True)

    def __init__(self, *sliders, every=100, on_hold=None, on_let=None):
        ids = [slider.model_id for slider in sliders]
        super().__init__(sliders=ids, every=every, watches=on_hold is not None)
        self._of_id = dict(zip(ids, sliders, strict=True))
        self._on_hold, self._on_let = on_hold, on_let
        self._asked, self._react = 0, None
        self.on_msg(self._hear)

    def when_told(self, react):
        """Have `react()` called once the page, having heard all so far, has told all it had to."""
        self._asked, self._react = self._asked + 1, react
        self.send({"do": "tell", "asked": self._asked})

    def _hear(self, _, message, __):
        if message["do"] == "told":
            if message["asked"] == self._asked:
                self._react()
            return
        slider = self._of_id[message["slider"]]
        if message["do"] == "hold":
            self._on_hold(slider, message["name"])
        else:
            slider.index = message["index"]  # it may come before what the slider itself says
            self._on_let(slider, message["name"])
