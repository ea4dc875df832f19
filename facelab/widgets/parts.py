"""Parts of a page that ipywidgets lacks: keys under the mouse, lists with pictures and buttons."""

import traitlets

from facelab.widgets.in_touch import InTouch, script, style

ROOT = "facelab-lab"
"""Class of the element within which keys are heard."""


class Part(InTouch):
    """A part that the page draws, as what its `kind` says."""

    _esm, _css = script("parts"), style("parts")
    kind = traitlets.Unicode().tag(sync=True)


class Keys(Part):
    """Hears keys while the mouse or the focus is in the lab, and when the mouse goes down there.

    It also gives names to sliders, and to buttons whether they are pressed, for those who hear the
    page.

    Parameters
    ----------
    reactions : dict of str to callable
        By name of the key as the browser names it, lower case ("z", "Ctrl+z", "Escape", "Space").
    on_press : callable
        Called when the mouse goes down on a slider or a button, before that does anything.
    controls : iterable of ipywidgets.Widget
        Those of the lab. Before a key, a click or a press is told, they tell what they keep back.
    """

    heard = traitlets.List(traitlets.Unicode()).tag(sync=True)
    controls = traitlets.List(traitlets.Unicode()).tag(sync=True)
    root = traitlets.Unicode(ROOT).tag(sync=True)

    def __init__(self, reactions, on_press, controls=()):
        controls = [control.model_id for control in controls]
        super().__init__(kind="keys", heard=list(reactions), controls=controls)
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
    label : str
        What the list holds, for those who hear the page.

    Attributes
    ----------
    items : list of dict
        Each with name, and an id that is its own whatever becomes of the others; and note, tip,
        color, picture (PNG as base64), bar (0 to 1) with bar_color, buttons (name, sign, tip,
        whether pressed), as it has them.
    chosen : int
        Place of the chosen item, -1 for none.
    """

    shape = traitlets.Unicode().tag(sync=True)
    empty = traitlets.Unicode().tag(sync=True)
    label = traitlets.Unicode().tag(sync=True)
    items = traitlets.List().tag(sync=True)
    chosen = traitlets.Int(-1).tag(sync=True)

    def __init__(self, shape, react, empty="", label=""):
        super().__init__(kind="list", shape=shape, empty=empty, label=label)
        self.react = react
        self.on_msg(self._hear)

    def _hear(self, _, message, __):
        # the page may not know yet that an item has gone
        if any(item["id"] == message["item"] for item in self.items):
            self.react(message["do"], message["item"])


class Sliders(Part):
    """Sliders with names and numbers; only what a person moves is heard.

    Parameters
    ----------
    on_slide : callable
        Called with (id, value) of a slider that was moved, ten times a second at most.

    Attributes
    ----------
    items : list of dict
        id, name, tip, low and high of each, from the top; and log, if equal ways of the handle are
        equal factors. By hand none goes beyond low and high; a value that is beyond is shown as it
        is.
    values : list of float
        Of the items.
    color : str
        Of what is filled.
    """

    items = traitlets.List().tag(sync=True)
    values = traitlets.List().tag(sync=True)
    color = traitlets.Unicode().tag(sync=True)

    def __init__(self, on_slide):
        super().__init__(kind="sliders")
        self.on_slide = on_slide
        self.on_msg(self._hear)

    def _hear(self, _, message, __):
        try:
            # the page may not know yet that it shows others now
            if any(item["id"] == message["item"] for item in self.items):
                self.on_slide(message["item"], message["value"])
        finally:
            self.send({"heard": message["asked"]})


class Track(Part):
    """Key poses on a line of time: they can be dragged, and moved by the arrow keys.

    Parameters
    ----------
    react : callable
        Called with ("move" or "choose", time of a key, where to), seconds.

    Attributes
    ----------
    times : list of float
        Of the keys, seconds.
    length, now : float
        Seconds of the whole line, and where it stands.
    """

    times = traitlets.List().tag(sync=True)
    length = traitlets.Float(1.0).tag(sync=True)
    now = traitlets.Float(0.0).tag(sync=True)

    def __init__(self, react):
        super().__init__(kind="track")
        self.react = react
        self.on_msg(self._hear)

    def _hear(self, _, message, __):
        try:
            if message["item"] in self.times:  # the page may not know yet that it has gone
                self.react(message["do"], message["item"], message["to"])
        finally:
            self.send({"heard": message["asked"]})
