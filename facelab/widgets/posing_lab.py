"""The posing lab: a face to pull, the sliders of the model, undo, and a list of pins."""

import functools

import ipywidgets as widgets
import numpy as np

from facelab.plotting import region_colors
from facelab.posing import PosingSession
from facelab.widgets.errors import error_box, shows_errors
from facelab.widgets.viewer import FaceView

_STEP = 0.05  # of a slider, in powers of ten
_JITTER = 0.6  # mm: a hand that only clicks moves this far, and sets no pin
_HINT = "Drag a point of the face to pose it; drag beside the face to turn it; wheel to zoom."


class PosingLab:
    """A page in which a face is posed by click and drag.

    Parameters
    ----------
    session : PosingSession
        What is posed; the lab only shows it and passes on what the mouse and the sliders do.
    models : dict of str to model, optional
        Models to choose from, by the name on their button; the session's own must be among them.
    props : iterable of (TriangleMesh, colors), optional
        Still parts to show with the face, such as the eyes.
    width, height : int
        Size of the canvas, pixels.

    Attributes
    ----------
    session : PosingSession
    view : FaceView
    widget : ipywidgets.Widget
        The whole page; a lab shows itself as the last line of a cell.
    """

    def __init__(self, session, models=None, props=(), width=620, height=640):
        if not isinstance(session, PosingSession):
            raise TypeError(f"session is a {type(session).__name__}, but must be a PosingSession.")
        self.session = session
        self.models = dict(models or {"model": session.model})
        if not any(model is session.model for model in self.models.values()):
            raise ValueError("models does not hold the session's own model; add it under a name.")
        self.view = FaceView(session.neutral, props, width, height)
        self.view.on_hover = self._hover
        self.view.on_press = self._press
        self.view.on_move = self._move
        self.view.on_release = self._release
        self._painted = session.model
        self._build_panel()
        self.widget = widgets.HBox([self.view.widget, self._panel])
        self.refresh()

    def _repr_mimebundle_(self, **kwargs):
        return self.widget._repr_mimebundle_(**kwargs)

    # --- the panel --------------------------------------------------------------------------------

    def _build_panel(self):
        wide = {"layout": widgets.Layout(width="320px"), "style": {"description_width": "64px"}}
        name = next(n for n, m in self.models.items() if m is self.session.model)
        self.model_choice = widgets.ToggleButtons(
            options=list(self.models), value=name, style={"button_width": "150px"}
        )
        slider = functools.partial(_log_slider, **wide)
        self.beta = slider(
            self.session.beta, low=-3, high=2, description="β agree", readout_format=".3g"
        )
        self.gamma = slider(
            self.session.gamma, low=-4, high=1, description="γ resist", readout_format=".3g"
        )
        self.beta.tooltip = "How strongly neighbouring regions must agree where they meet"
        self.gamma.tooltip = "How strongly the face resists change"
        self.show_regions = widgets.Checkbox(description="colour the regions", indent=False)
        self.undo, self.redo, self.keep, self.reset = (
            widgets.Button(description=text, icon=icon, tooltip=tip, layout={"width": "76px"})
            for text, icon, tip in (
                ("Undo", "undo", "One step back"),
                ("Redo", "repeat", "One step forward again"),
                ("Keep", "check", "Keep this pose and take the pins away"),
                ("Reset", "refresh", "Back to the neutral face"),
            )
        )
        self._pin_list = widgets.VBox()
        self._status = widgets.HTML()
        self._message = widgets.HTML()
        self._panel = widgets.VBox(
            [
                self.model_choice,
                self.beta,
                self.gamma,
                self.show_regions,
                widgets.HBox([self.undo, self.redo, self.keep, self.reset]),
                self._pin_list,
                self._status,
                self._message,
            ],
            layout={"width": "370px", "padding": "4px 0 0 14px"},
        )
        self.model_choice.observe(self._choose_model, names="value")
        self.beta.observe(self._slide, names="value")
        self.gamma.observe(self._slide, names="value")
        self.show_regions.observe(self._paint, names="value")
        for button in (self.undo, self.redo, self.keep, self.reset):
            button.on_click(self._press_button)

    def _fail(self, error):
        """Show an error, give up the drag it happened in, and keep the last good pose."""
        self.view.end_drag()
        self.session.cancel()
        self.refresh()
        self._message.value = error_box(error, "The pose is as it was.")

    def refresh(self):
        """Show the session as it is now."""
        session = self.session
        self._message.value = ""
        self.view.show(session.vertices)
        self._show_pins()
        self._pin_list.children = [self._pin_row(vertex) for vertex in session.pins]
        self.undo.disabled = not session.can_undo
        self.redo.disabled = not session.can_redo
        self._settling = True
        for slider, value in ((self.beta, session.beta), (self.gamma, session.gamma)):
            slider.value = _within(slider, value)
        self.model_choice.value = next(n for n, m in self.models.items() if m is session.model)
        self._settling = False
        self.show_regions.disabled = session.model.regions is None
        if self._painted is not session.model:
            self._paint()
        self._status.value = f'<span style="color:#666">{_HINT}</span>'

    def _pin_row(self, vertex):
        gap = np.linalg.norm(self.session.pins[vertex] - self.session.vertices[vertex])
        remove = widgets.Button(
            icon="times", tooltip="Remove this pin", layout={"width": "34px", "height": "26px"}
        )
        remove.on_click(lambda _: self._remove(vertex))
        text = f"{self._name(vertex)}: {gap:.1f} mm short"
        return widgets.HBox([remove, widgets.Label(text)])

    def _name(self, vertex):
        names = {v: name for name, v in self.session.neutral.landmarks.items()}
        return names.get(vertex, f"vertex {vertex}").replace("_", " ")

    def _show_pins(self, but=None):
        pins = {v: target for v, target in self.session.pins.items() if v != but}
        vertices = self.session.vertices[list(pins)]
        self.view.show_pins(vertices, np.array(list(pins.values())).reshape(-1, 3))

    # --- the mouse --------------------------------------------------------------------------------

    @shows_errors
    def _hover(self, vertex):
        if vertex is None:
            self.view.show_hover(None)
        else:
            self.view.show_hover(self.session.vertices[self.session.handle(vertex)])

    @shows_errors
    def _press(self, vertex):
        self._clicking = True
        self._held = self.session.handle(vertex)
        D = self.session.press(vertex)
        self._from = self.session.pins[self._held]
        self._message.value = ""
        self.view.show_hover(None)
        self._show_pins(but=self._held)
        self.view.begin_morph(D, self._held, self._from)

    @shows_errors
    def _move(self, offset):
        if self._clicking and np.linalg.norm(offset) < _JITTER:
            return
        self._clicking = False
        self.session.drag(self._held, self._from + offset)
        self.view.morph(offset)

    @shows_errors
    def _release(self):
        self.session.release()
        self.refresh()

    # --- the panel's callbacks --------------------------------------------------------------------

    @shows_errors
    def _choose_model(self, change):
        if not self._settling:
            self.session.use(self.models[change["new"]])
            self.refresh()

    @shows_errors
    def _slide(self, _):
        if self._settling:
            return
        moved = {}
        for name, slider in (("beta", self.beta), ("gamma", self.gamma)):
            # the page rounds a value to its slider's grid and sends it back: that is no edit
            shown = _within(slider, getattr(self.session, name))
            if abs(np.log10(slider.value / shown)) > _STEP / 2:
                moved[name] = slider.value
        if moved:
            self.session.set(**moved)
            self.refresh()

    @shows_errors
    def _paint(self, _=None):
        self._painted = self.session.model
        regions = self.session.model.regions
        self.view.paint(self._region_colors(regions) if self.show_regions.value else None)

    def _region_colors(self, regions):
        if regions is None:
            return None
        labels = regions.labels
        if self.session.binding is not None:
            labels = labels[self.session.binding.handle_of]
        return region_colors(regions)[labels]

    @shows_errors
    def _press_button(self, button):
        {
            self.undo: self.session.undo,
            self.redo: self.session.redo,
            self.keep: self.session.keep,
            self.reset: self.session.reset,
        }[button]()
        self.refresh()

    @shows_errors
    def _remove(self, vertex):
        self.session.remove_pin(vertex)
        self.refresh()


def _log_slider(value, low, high, **kwargs):
    """A logarithmic slider whose grid holds its first value, from 10^low to about 10^high."""
    value = float(np.clip(value, 10.0**low, 10.0**high))
    start = np.log10(value)
    low = start - _STEP * np.ceil((start - low) / _STEP)
    return widgets.FloatLogSlider(value=value, base=10, min=low, max=high, step=_STEP, **kwargs)


def _within(slider, value):
    """The value, or the end of the slider that is nearest to it, as for a beta of zero."""
    return float(np.clip(value, slider.base**slider.min, slider.base**slider.max))
