"""A face whose action units follow α, λ and the roughness of the sketch, at once."""

import ipywidgets as widgets
import numpy as np

from facelab.checks import check_type
from facelab.expression.regression import ExpressionFit
from facelab.widgets.page import Page, markup, shows_errors
from facelab.widgets.viewer import FaceView

_SHOWN = 8  # units in the table


class AlphaView(Page):
    """A page that shows fits made beforehand: a slider moved answers at once.

    Parameters
    ----------
    fits : dict of (float, float) to ExpressionFit
        From twist of the sketch and λ, both in millimetres: one fit for each pair, all on the
        same rig and alphas.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth to show with the face; if left out, those that
        `facelab.looks.face_props` makes.
    width, height : int
        Size of the canvas, pixels.

    Attributes
    ----------
    alpha, lam, twist : ipywidgets.Widget
        The controls; `sketch` shows the sketch in place of what was found.
    fit : ExpressionFit
        The one on screen.
    view : FaceView
    widget : ipywidgets.Widget

    Raises
    ------
    TypeError, ValueError
        If `fits` holds something else, or lacks a pair.
    """

    _after_error = "The face is as it was."

    def __init__(self, fits, props=None, width=420, height=460):
        for fit in fits.values():
            check_type(fit, "fits", ExpressionFit, "regress_expression gives one")
        twists, lams = (sorted({pair[i] for pair in fits}) for i in (0, 1))
        lacking = [(t, lam) for t in twists for lam in lams if (t, lam) not in fits]
        if not fits or lacking:
            raise ValueError(f"fits lacks {lacking or 'everything'}: one for each twist and lam.")
        self.fits = dict(fits)
        first = self.fits[twists[0], lams[0]]
        self.view = FaceView(first.basis.rig.neutral, props, width, height)
        # far from touching: floats as they were given, so that keys are found again
        self.alpha = widgets.SelectionSlider(
            options=[(f"{a:g}", i) for i, a in enumerate(first.alphas)], description="α"
        )
        self.lam = widgets.SelectionSlider(
            options=[(f"{v:g}", v) for v in lams], description="λ (mm)"
        )
        self.twist = widgets.SelectionSlider(
            options=[(f"{v:g}", v) for v in twists], description="twists (mm)"
        )
        self.sketch = widgets.Checkbox(description="show the sketch", indent=False)
        self._build_messages()
        controls = (self.alpha, self.lam, self.twist, self.sketch)
        for control in controls:
            control.observe(self._changed, names="value")
        beside = widgets.VBox([*controls, self._status, self._message])
        self.widget = widgets.HBox([self.view.widget, beside])
        self._changed(None)

    @property
    def fit(self):
        """The fit on screen."""
        return self.fits[self.twist.value, self.lam.value]

    def picture(self):
        """The face that the units make, or the sketch: bytes of a PNG."""
        return self.view.picture()

    def _settings_in_words(self):
        alpha = self.fit.alphas[self.alpha.value]
        settings = f"α {alpha:g}, λ {self.lam.value:g} mm, twists {self.twist.value:g} mm"
        return (f"{settings}: {self.fit.rms[self.alpha.value]:.3f} mm from the sketch.",)

    @shows_errors
    def _changed(self, _):
        fit, i = self.fit, self.alpha.value
        rest = fit.basis.rig.neutral.vertices
        self.view.show(rest + fit.displacement if self.sketch.value else fit.vertices(i))
        moves = np.abs(fit.weights[i]) * np.linalg.norm(fit.basis.rig.deltas, axis=(1, 2))
        strong = [k for k in np.argsort(-moves)[:_SHOWN] if fit.weights[i, k] > 0.005]
        said = ", ".join(f"{fit.names[k]} {fit.weights[i, k]:.2f}" for k in strong)
        self.say(
            markup(
                "{} mm from the sketch; the weights sum to {}.<br>{}",
                f"{fit.rms[i]:.3f}",
                f"{fit.sums[i]:.2f}",
                said or "no units",
            )
        )
        self.clear()
