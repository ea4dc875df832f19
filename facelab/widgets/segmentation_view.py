"""A face whose regions follow the sliders of the segmentation, live."""

import warnings

import ipywidgets as widgets

from facelab.plotting import region_colors
from facelab.segmentation.segment import Affinity
from facelab.widgets.page import Page, markup, shows_errors
from facelab.widgets.viewer import FaceView


class SegmentationView(Page):
    """A page in which λ, r, the threshold and the number of regions are tried out.

    Parameters
    ----------
    affinity : Affinity
        How alike the vertices of the face are; where the sliders start.
    face : TriangleMesh, optional
        A dense face to colour instead of the control mesh.
    samples : array_like of int, optional
        Where the vertices of the control mesh lie on it.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth to show with the face; if left out, those that
        `facelab.looks.face_props` makes.
    n_regions : int, default=9
        Where that slider starts.
    random_state : int, default=0
        The same for every cut, so that a slider moved back shows the same again.
    width, height : int
        Size of the canvas, pixels.

    Attributes
    ----------
    regions : Regions
        The cut on screen; when one fails, the last that did not.
    lam, r, threshold, n_regions, grow : ipywidgets.Widget
        The controls; setting their `value` cuts anew. With `grow` on, the number of regions is
        found as in the paper.
    view : FaceView
    widget : ipywidgets.Widget
        The whole page; the view shows itself as the last line of a cell.

    Raises
    ------
    TypeError, ValueError
        If `affinity` is something else, or only one of `face` and `samples` is given.
    """

    _after_error = "The regions are as they were."

    def __init__(
        self,
        affinity,
        face=None,
        samples=None,
        props=None,
        n_regions=9,
        random_state=0,
        width=520,
        height=520,
    ):
        if not isinstance(affinity, Affinity):
            raise TypeError(
                f"affinity is a {type(affinity).__name__}; give Affinity.of(motion), a Affinity."
            )
        if (face is None) != (samples is None):
            raise ValueError("face and samples belong together: give both, or neither.")
        self.affinity, self._seed = affinity, random_state
        self._on_screen = slice(None) if face is None else face.nearest_of(samples)
        self.view = FaceView(affinity.mesh if face is None else face, props, width, height)
        self._build_controls(n_regions)
        self.widget = widgets.VBox(
            [
                self.view.widget,
                *(self.lam, self.r, self.threshold),
                widgets.HBox([self.n_regions, self.grow]),
                *(self._status, self._message),
            ]
        )
        self.regions, self._colors = None, None
        self._cut()

    def _build_controls(self, n_regions):
        start = self.affinity
        most = min(30, start.mesh.n_vertices)
        self.lam = _slider("λ", start.lam, 0, 1, 0.05)
        self.r = _slider("r (mm)", start.r, 1, max(40, start.r), 1)
        self.threshold = _slider("threshold", start.threshold, 0, 1, 0.05)
        self.n_regions = widgets.IntSlider(
            value=n_regions, min=1, max=max(most, n_regions), description="regions"
        )
        self.grow = widgets.Checkbox(description="as many as stay compact", indent=False)
        self._build_messages()
        for control in (self.lam, self.r, self.threshold, self.n_regions, self.grow):
            control.observe(self._changed, names="value")

    def picture(self):
        """The face in the colours of its regions: bytes of a PNG."""
        return self.view.picture()

    def _settings_in_words(self):
        settings = "λ {:.2f}, r {:g} mm, threshold {:.2f}".format(
            *(slider.value for slider in (self.lam, self.r, self.threshold))
        )
        return (f"{settings}: {self.regions.n_regions} regions.",)

    @shows_errors
    def _changed(self, _):
        self._cut()
        self.clear()

    def _cut(self):
        affinity = self.affinity.with_(
            lam=self.lam.value, r=self.r.value, threshold=self.threshold.value
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that all k were compact: `why` says it
            regions = affinity.segment(
                None if self.grow.value else self.n_regions.value,
                max_regions=self.n_regions.max,
                random_state=self._seed,
                progress=False,
            )
        before = None if self.regions is None else (self.regions, self._colors)
        colors = region_colors(regions, like=before)  # so that a region keeps its colour
        self.view.paint(colors[regions.labels][self._on_screen])
        self.regions, self._colors = regions, colors
        self.n_regions.disabled = self.grow.value
        self.say(markup("{}<br>{}", regions, regions.why))


def _slider(name, value, low, high, step):
    return widgets.FloatSlider(
        value=value, min=low, max=high, step=step, description=name, readout_format=".2f"
    )
