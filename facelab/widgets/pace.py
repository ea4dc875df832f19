"""Sliders that tell the kernel at most ten times a second where they are."""

import traitlets

from facelab.widgets.in_touch import InTouch, script


class Pace(InTouch):
    """Holds sliders back in the page; what they tell last always arrives.

    Parameters
    ----------
    sliders : ipywidgets.Widget
    """

    _esm = script("pace")
    sliders = traitlets.List().tag(sync=True)

    def __init__(self, *sliders):
        super().__init__(sliders=[slider.model_id for slider in sliders])
