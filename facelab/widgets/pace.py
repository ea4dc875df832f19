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
    """

    _esm = script("pace")
    sliders = traitlets.List().tag(sync=True)
    every = traitlets.Int().tag(sync=True)

    def __init__(self, *sliders, every=100):
        super().__init__(sliders=[slider.model_id for slider in sliders], every=every)
        self._asked = 0
        self._react = None
        self.on_msg(self._hear)

    def when_told(self, react):
        """Have `react()` called once the page, having heard all so far, has told all it had to."""
        self._asked, self._react = self._asked + 1, react
        self.send({"asked": self._asked})

    def _hear(self, _, message, __):
        if message["asked"] == self._asked:
            self._react()
