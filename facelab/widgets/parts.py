"""Parts of a page that ipywidgets lacks: keys under the mouse, lists with pictures and buttons."""

from pathlib import Path

import anywidget
import traitlets

_HERE = Path(__file__).parent
ROOT = "facelab-lab"
"""Class of the element within which keys are heard."""


def drawn_by(source):
    """The .js and the .css of a part, by the name that they share."""
    return [(_HERE / f"{source}.{ending}").read_text() for ending in ("js", "css")]


class Part(anywidget.AnyWidget):
    """A part that the page draws, as what its `kind` says."""

    _esm, _css = drawn_by("parts")
    kind = traitlets.Unicode().tag(sync=True)


class Keys(Part):
    """Hears keys while the mouse is over the lab, and when the mouse goes down beside a canvas.

    Parameters
    ----------
    reactions : dict of str to callable
        By name of the key as the browser names it, lower case ("z", "Ctrl+z", "Escape", "Space").
    on_press : callable
        Called when the mouse goes down on a slider or a button, before that does anything.
    """

    heard = traitlets.List(traitlets.Unicode()).tag(sync=True)
    root = traitlets.Unicode(ROOT).tag(sync=True)

    def __init__(self, reactions, on_press):
        super().__init__(kind="keys", heard=list(reactions))
        self.reactions, self.on_press = reactions, on_press
        self.on_msg(self._hear)

    def _hear(self, _, message, __):
        if "key" in message:
            self.reactions[message["key"]]()
        else:
            self.on_press()


class ItemList(Part):
    """A list of rows or pictures with buttons.

    Parameters
    ----------
    shape : {"rows", "choice", "strip"}
        Plain rows, rows of which one is chosen, or a strip of pictures.
    react : callable
        Called with ("choose" or the name of a button, id of the item).
    empty : str
        What to show for no items.

    Attributes
    ----------
    items : list of dict
        Each with id and name; and note, tip, color, picture (PNG as base64), bar (0 to 1) with
        bar_color, buttons (name, sign, tip, whether pressed), as it has them.
    chosen : int
        Place of the chosen item, -1 for none.
    """

    shape = traitlets.Unicode().tag(sync=True)
    empty = traitlets.Unicode().tag(sync=True)
    items = traitlets.List().tag(sync=True)
    chosen = traitlets.Int(-1).tag(sync=True)

    def __init__(self, shape, react, empty=""):
        super().__init__(kind="list", shape=shape, empty=empty)
        self.on_msg(lambda _, message, __: react(message["do"], message["item"]))
