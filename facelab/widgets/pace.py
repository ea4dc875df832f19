"""Sliders that tell the kernel at most ten times a second where they are."""

from pathlib import Path

import anywidget
import traitlets


class Pace(anywidget.AnyWidget):
    """Holds sliders back in the page; what they tell last always arrives.

    Parameters
    ----------
    sliders : ipywidgets.Widget
    """

    _esm = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
    sliders = traitlets.List().tag(sync=True)

    def __init__(self, *sliders):
        super().__init__(sliders=[slider.model_id for slider in sliders])
