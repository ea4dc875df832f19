"""A take to be played: the skin, the markers if there are any, and a slider through time."""

import ipywidgets as widgets

from facelab.motion import MarkerSequence, MotionSequence
from facelab.widgets.page import Page, shows_errors
from facelab.widgets.viewer import FaceView

_SHOWN_PER_SECOND = 25  # no more frames than this are sent to the page


class Player(Page):
    """A page in which a take is played.

    Parameters
    ----------
    motion : MotionSequence
        The skin in every frame. A lost frame shows the last one that was not, and says so.
    markers : MarkerSequence, optional
        Of the same frames, in the head frame as well; occluded ones are not drawn.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth to show with the face; if left out, those that
        `facelab.looks.face_props` makes.
    width, height : int
        Size of the canvas, pixels.

    Attributes
    ----------
    view : FaceView
    slider : ipywidgets.IntSlider
        The frame on screen; setting its `value` shows another.
    widget : ipywidgets.Widget
        The whole page; a player shows itself as the last line of a cell.

    Raises
    ------
    TypeError, ValueError
        For other kinds of arguments, an empty take, or markers of other frames.
    """

    def __init__(self, motion, markers=None, props=None, width=520, height=520):
        if not isinstance(motion, MotionSequence):
            raise TypeError(f"motion is a {type(motion).__name__}, but must be a MotionSequence.")
        if not motion.n_frames:
            raise ValueError("motion has no frames: there is nothing to play.")
        if markers is not None:
            if not isinstance(markers, MarkerSequence):
                raise TypeError(
                    f"markers is a {type(markers).__name__}, but must be a MarkerSequence."
                )
            if (markers.n_frames, markers.fps) != (motion.n_frames, motion.fps):
                raise ValueError(
                    f"markers has {markers.n_frames} frames at {markers.fps:g} a second, but "
                    f"motion has {motion.n_frames} at {motion.fps:g}; resample one of them."
                )
        self.motion, self.markers = motion, markers
        self.view = FaceView(motion.mesh, props, width, height)
        self._build_controls(width)
        self.widget = widgets.VBox(
            [self.view.widget, widgets.HBox([self._play, self.slider]), self._status, self._message]
        )
        self._show(0)

    def _build_controls(self, width):
        last, fps = self.motion.n_frames - 1, self.motion.fps
        step = max(1, round(fps / _SHOWN_PER_SECOND))
        self._play = widgets.Play(max=last, step=step, interval=round(1000 * step / fps))
        self.slider = widgets.IntSlider(
            max=last, description="frame", layout={"width": f"{max(width - 200, 200)}px"}
        )
        self._link = widgets.jslink((self._play, "value"), (self.slider, "value"))
        self._build_messages()
        self.slider.observe(self._slide, names="value")

    def picture(self):
        """The skin of the frame on screen: bytes of a PNG."""
        return self.view.picture()

    @shows_errors
    def _slide(self, change):
        self._show(change["new"])
        self.clear()

    def _show(self, frame):
        text = f"{frame / self.motion.fps:.2f} s"
        if self.motion.valid[frame]:
            self.view.show(self.motion.positions[frame])
        else:
            text += "; this frame was lost, the face is an earlier one"
        if self.markers is not None:
            self.view.show_points(self.markers.positions[frame])
            seen = int(self.markers.visible[frame].sum())
            text += f"; {seen} of {self.markers.n_markers} markers seen"
        self.say(text)
