"""What every part drawn by scripts of the lab's own is: it hears its kernel on a busy page too."""

import uuid
from pathlib import Path

import anywidget
import traitlets

_HERE = Path(__file__).parent
_ROUTE = "_reply_subshell_for"  # of ipykernel's comms: which thread hears what the page says


def script(*names):
    """Sources of these .js files as one, the one that stays in touch with the kernel first."""
    return "\n".join(
        (_HERE / f"{name}.js").read_text(encoding="utf-8") for name in ("in_touch", *names)
    )


def style(name):
    """Source of a .css file."""
    return (_HERE / f"{name}.css").read_text(encoding="utf-8")


def keep_free(widget):
    """Have a widget, and all that is in it, answer the page while a cell runs, too.

    ipykernel 7.4 hands what a page says to the thread that spoke to it last, so to that of a cell:
    it would wait until that has run. JupyterLab names a thread that is always free.
    """
    if hasattr(widget.comm, _ROUTE):
        setattr(widget.comm, _ROUTE, lambda _, named: named)
    for inside in getattr(widget, "children", ()):
        keep_free(inside)


class InTouch(anywidget.AnyWidget):
    """A widget whose script, made by `script`, has `initialize: stayInTouch`."""

    own_id = traitlets.Unicode().tag(sync=True)

    def __init__(self, **kwargs):
        own_id = uuid.uuid4().hex  # known to the page from the first
        super().__init__(model_id=own_id, own_id=own_id, **kwargs)
        keep_free(self)
