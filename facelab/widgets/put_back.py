"""A way back for what was taken out of a list and is no step of the session."""

import ipywidgets as widgets

from facelab.widgets.lab import button
from facelab.widgets.page import markup


class PutBack:
    """A line that says what was taken out last, with a button that puts it back.

    Parameters
    ----------
    react : callable
        Called when the button is pressed.

    Attributes
    ----------
    name : str
        Of what was taken out.
    gone : object
        What was taken out, None for nothing.
    replaced : bool
        Whether something else has taken its place.
    widget : ipywidgets.Widget
        Shown while there is something to put back.
    """

    def __init__(self, react):
        self._text = widgets.HTML()
        self.button = button("Put back", "Put back what was taken out last", lambda _: react())
        self.widget = widgets.HBox([self._text, self.button], layout={"align_items": "center"})
        self.forget()

    def offer(self, name, gone, replaced=False):
        """Say that `gone` was taken out, or replaced, by its name."""
        self.name, self.gone, self.replaced = name, gone, replaced
        did = "Replaced" if replaced else "Removed"
        self._text.value = markup(
            '<div class="facelab-status" role="status">{} <b>{}</b>.</div>', did, name
        )
        self.widget.layout.display = "flex"

    def forget(self):
        """Nothing is to be put back."""
        self.gone, self.replaced = None, False
        self.widget.layout.display = "none"
