"""A registered take beside its markers: play it, and hide markers to see what that costs."""

import ipywidgets as widgets
import numpy as np

from facelab.data.registered import RegisteredActor
from facelab.plotting import heat_colors
from facelab.registration.sequence import register_sequence
from facelab.studies.registration_trials import covered
from facelab.widgets.page import Page, shows_errors
from facelab.widgets.viewer import FaceView

_LIMIT = 2.0  # mm, the darkest colour


class RegistrationView(Page):
    """A page that plays a registered take, with a slider for the share of missing markers.

    Parameters
    ----------
    actor : RegisteredActor
    take : str
    width, height : int
        Size of the canvas, pixels.

    Attributes
    ----------
    view : FaceView
    missing : ipywidgets.FloatSlider
        Share of markers to hide, in bursts of 0.12 s; the take is registered anew.
    slider : ipywidgets.IntSlider
        The frame on screen.
    registration : Registration
        What is shown now.
    widget : ipywidgets.Widget
        The whole page; it shows itself as the last line of a cell.

    Raises
    ------
    TypeError, ValueError
        For another kind of actor, or a take that the actor does not have.
    """

    def __init__(self, actor, take, width=520, height=520):
        if not isinstance(actor, RegisteredActor):
            raise TypeError(
                f"actor is a {type(actor).__name__}; give what facelab.load_registered returns."
            )
        (self.take,) = actor.names([take])
        self.actor = actor
        self._given = actor.capture.markers(take)
        self._covered = covered(actor)
        self.view = FaceView(actor.fit.mesh, None, width, height)
        wide = {"layout": {"width": f"{max(width - 120, 240)}px"}}
        self.missing = widgets.FloatSlider(
            max=0.6, step=0.05, description="missing", readout_format=".0%",
            continuous_update=False, **wide,
        )  # fmt: skip
        last, fps = self._given.n_frames - 1, self._given.fps
        step = max(1, round(fps / 25))  # no more frames a second are sent to the page
        self._play = widgets.Play(max=last, step=step, interval=round(1000 * step / fps))
        self.slider = widgets.IntSlider(max=last, description="frame", **wide)
        self._link = widgets.jslink((self._play, "value"), (self.slider, "value"))
        self.colored = widgets.Checkbox(
            True, description=f"colour by error (white 0, dark blue {_LIMIT:g} mm)", indent=False
        )
        self._build_messages()
        self.missing.observe(self._hide, names="value")
        for control in (self.slider, self.colored):
            control.observe(self._refresh, names="value")
        self._register(0.0)
        rows = [widgets.HBox([self._play, self.slider]), self.missing, self.colored]
        self.widget = widgets.VBox([self.view.widget, *rows, self._status, self._message])

    def picture(self):
        """The skin of the frame on screen: bytes of a PNG."""
        return self.view.picture()

    def _settings_in_words(self):
        colored = f"; white 0, dark blue {_LIMIT:g} mm off" if self.colored.value else ""
        return (f"Frame {self.slider.value}, {self.missing.value:.0%} missing{colored}.",)

    @shows_errors
    def _hide(self, change):
        self._register(change["new"])
        self.clear()

    @shows_errors
    def _refresh(self, _):
        self._show(self.slider.value)
        self.clear()

    def _register(self, share):
        markers = self._given.with_gaps(share, random_state=0)
        registration = register_sequence(self.actor.fit, markers, progress=False)
        own = markers.select(self.actor.fit.names).positions
        self._markers = registration.head.to_head(own)
        self.registration = registration
        self._show(self.slider.value)

    def _show(self, frame):
        seen = np.isfinite(self._markers[frame, :, 0])
        text = f"{frame / self._given.fps:.2f} s; {seen.sum()} of {len(seen)} markers seen; "
        self.view.show_points(self._markers[frame])
        if self.registration.valid[frame]:
            self.view.show(self.registration.positions([frame])[0])
            error = self.actor.errors(self.registration, self.take, [frame])[0]
            self.view.paint(heat_colors(error, _LIMIT) if self.colored.value else None)
            rms = np.sqrt((error[self._covered] ** 2).mean())
            text += f"skin off by {rms:.2f} mm RMS where markers cover it"
        else:
            text += "this frame is lost, the face is an earlier one"
        self.say(text)
