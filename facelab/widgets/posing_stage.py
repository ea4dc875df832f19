"""The faces of the posing lab, what is shown on them, and the mouse that pulls them."""

from contextlib import suppress

import ipywidgets as widgets
import numpy as np
from scipy.interpolate import CubicSpline

from facelab.plotting import region_colors
from facelab.widgets.lab import Panel, toggle
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.posing_panels import shade
from facelab.widgets.viewer import FaceView

_LOCKED, _FREE = (0.80, 0.25, 0.15), (1.0, 0.85, 0.0)
_SIDE_BY_SIDE = 0.62  # of the size of a single view
_GAP_SHOWN, _DISTANCE_SHOWN = 1.0, 4.0  # mm, and typical distances: where the colours end
_SAME = 0.01  # mm
_CHOSEN = 0.1, 0.1, 0.1  # the outline of the region whose sliders are shown
_KNOTS = 3  # of the values of a slider each so-many-th is solved for
_CHANGES, _UNSEEN = 24, 0.003  # of the face at most, each of more mm
_NOTHING = "nothing"
_PAINTS = {
    "skin": "skin",
    "regions": "regions",
    "gaps before blending": "gaps",
    "how far from training": "plausibility",
    "wireframe": "wireframe",
}
_LOOKS = "skin", "texture", "wireframe"


class Stage(Panel):
    """The face that is posed, and on choice beside it the answer of another model to its pins.

    Attributes
    ----------
    view, other_view : FaceView
        The other one is None until it is first wanted.
    answers : list of (FaceView, PosingSession)
        What is on screen: the lab's session, and one of the other model with the same pins.
    held, hovered : int or None
        Vertex that the mouse has taken hold of, and the one under it.
    """

    def _build(self):
        self.view, self.other_view = self._new_view(*self.lab.size), None
        self.held = self.hovered = None
        self.beside = _half([_NOTHING], "compare", "The answer of another model to the same pins")
        paints = _PAINTS if self.lab.mesh.texture is None else {**_PAINTS, "texture": "texture"}
        self.paint = _half(paints, "colour", "What the colours of the face say")
        self.ghost = toggle("Ghost", "The pose before the last step that moved the face, pale")
        self._captions = widgets.HTML(), widgets.HTML()
        first = widgets.VBox([self._captions[0], self.view.widget], layout=_growing())
        self.widget = widgets.HBox([first], layout={"flex_flow": "row nowrap"})
        self.beside.observe(self._choose_beside, names="value")
        self.paint.observe(self._choose_paint, names="value")
        self.ghost.observe(self._show_ghost, names="value")

    def refresh(self):
        """Show the models to choose from, the faces, and what is on them."""
        own = self.lab.model_name
        others = [name for name in self.lab.models if name != own]
        with quiet(self):
            chosen = self.beside.value
            self.beside.options = [_NOTHING, *others]
            self.beside.value = chosen if chosen in others else _NOTHING
        self._arrange()
        self.ask()
        self.show()
        self.color()
        self._show_ghost()

    def show(self):
        """Show the pose, or the frame of a clip that is on."""
        for view, session in self.answers:
            view.gaze = self.lab.gaze
            view.show(self.lab.vertices if session is self.session else session.vertices)
        self.show_pins()

    def legend(self):
        """What the colours say, empty where they need no words."""
        if self.paint.value == "gaps":
            most = self.session.gaps().max()
            return f"Gaps between regions: at most {most:.2f} mm; dark from {_GAP_SHOWN:g} mm."
        if self.paint.value == "plausibility":
            far = f"{_DISTANCE_SHOWN:g} times as far as is typical"
            return f"Pale: as in training. Dark: {far}, or more."
        return ""

    @shows_errors
    def _choose_beside(self, _):
        if not self.settling:
            self.lab.refresh()

    @shows_errors
    def _choose_paint(self, _):
        self.color()
        self.lab.tell()

    def _new_view(self, width, height, **kwargs):
        view = FaceView(self.lab.mesh, self.lab.props, width, height, **kwargs)
        view.on_hover, view.on_press = self._hover, self._press
        view.on_move, view.on_release = self._move, self._release
        view.names = [self.lab.name_of(v) for v in range(self.lab.mesh.n_vertices)]
        return view

    @property
    def views(self):
        """Views on the page: one, or two that are compared."""
        return [self.view] + [self.other_view] * (self.beside.value != _NOTHING)

    def _arrange(self):
        """One view, or two side by side with the names of their models.

        A view once made stays in the page: taking it away would stop the shared orbit, and that
        divides by the height of its canvas, so it is only covered up.
        """
        wanted, (width, height) = self.views, self.lab.size
        if None in wanted:
            self.other_view = self._new_view(width, height, linked_to=self.view)
            wanted[1] = self.other_view
            box = widgets.VBox([self._captions[1], self.other_view.widget], layout=_growing())
            self.widget.children = [*self.widget.children, box]
        both = len(wanted) == 2
        names = self.lab.model_name, self.beside.value
        for caption, name in zip(self._captions, names, strict=True):
            caption.value = markup("<b>{}</b>", name)
            caption.layout.display = "flex" if both else "none"
        for box in self.widget.children[1:]:
            box.layout.visibility = "visible" if both else "hidden"
            box.layout.flex, box.layout.height = ("1 1 0", "auto") if both else ("0 0 0", "0px")
        scale = _SIDE_BY_SIDE if both else 1
        for view in wanted:
            view.resize(round(scale * width), round(scale * height))

    def ask(self):
        """Give each view a session: the lab's own, and one of the other model under its pins."""
        self.answers = [(self.view, self.session)]
        if self.beside.value != _NOTHING:
            other = self.session.copy()
            other.use(self.lab.models[self.beside.value])
            self.answers.append((self.other_view, other))

    def show_pins(self):
        """Show the pins, unless a frame is shown in place of the pose."""
        pins = self.session.pins if self.lab.frame is None else {}
        pins = {v: t for v, t in pins.items() if v not in self.session.hidden}
        locked = self.session.locked
        colors = [_LOCKED if v in locked else _FREE for v in pins]
        for view, _ in self.answers:
            view.show_pins(pins, colors, self.session.pin_names)

    def begin_slide(self, hold, slider, name, values):
        """Tell the page the faces that a slider of beta or gamma will go through."""
        if self.lab.frame is not None:
            return
        for view, session in self.answers:
            with suppress(ValueError):  # a value that is refused is said when it is asked for
                shares, changes = _course(session, name, values)
                if len(changes):
                    view.begin_slide(hold, slider, shares, changes)

    def end_slide(self, hold):
        """The slider has been let go of: what the page was sent is shown."""
        for view, _ in self.answers:
            view.end_slide(hold)

    @shows_errors
    def _show_ghost(self, _=None):
        """The last other shape of the face, where that is wanted: not all steps move it."""
        session = self.session
        wanted = self.ghost.value and self.lab.frame is None
        steps = session.history.line[: session.n_undo][::-1] if wanted else ()
        faces, now = map(session.vertices_in, steps), session.vertices
        ghost = next((V for V in faces if np.abs(V - now).max() > _SAME), None)
        for view, _ in self.answers:
            view.show_ghost(ghost)

    def color(self):
        """Colour the faces as chosen, the region whose sliders are shown within an outline."""
        for view, session in self.answers:
            view.paint(self._colors_of(session))
            view.look = self.paint.value if self.paint.value in _LOOKS else "skin"

    def _colors_of(self, session):
        """Colours of the face, shape (n_vertices, 3), or None for skin."""
        labels = session.region_labels
        if self.paint.value == "gaps":
            return shade("PuBuGn", session.gaps() / _GAP_SHOWN)
        if self.paint.value in _LOOKS or labels is None:
            return None
        if self.paint.value == "regions":
            colors = region_colors(session.regions)[labels]
        else:
            colors = shade("YlOrBr", self.lab.distance(session) / _DISTANCE_SHOWN)[labels]
        a, b = self.lab.mesh.edges.T
        rim = np.r_[a, b][np.tile(labels[a] != labels[b], 2)]
        colors[rim[labels[rim] == self.lab.shape.region]] = _CHOSEN
        return colors

    # --- the mouse --------------------------------------------------------------------------------

    @shows_errors
    def _hover(self, vertex):
        self.hovered = vertex

    @shows_errors
    def _press(self, vertex):
        if self.lab.frame is not None:
            self.lab.clip.take_up()
        self._clicking, self.held = True, vertex
        self.lab.clear()
        self.ask()
        self._hands = []
        for view, posed in self.answers:
            answer, start = posed.press(vertex), posed.pins[vertex]
            self._hands.append((view, posed, answer))
            self._from = start if posed is self.session else self._from
            if answer is not None:
                drawn = start + view.vertices[vertex] - posed.vertices[vertex]
                view.begin_pull(answer, vertex, drawn, self._from - start)

    @shows_errors
    def _move(self, offset):
        if self.held is None:
            return
        self._clicking = False
        target = self._from + offset
        self.session.drag(self.held, target)
        for view, posed, answer in self._hands:
            if answer is not None:  # the page draws the skin
                if posed is self.session:
                    view.carry_props(self.lab.vertices)
                continue
            if posed is not self.session:
                posed.drag(self.held, target)
            view.show(self.lab.vertices if posed is self.session else posed.vertices)
        self.show_pins()

    @shows_errors
    def _release(self):
        vertex, self.held = self.held, None
        if vertex is None:
            return
        self.session.release()
        if self._clicking:
            self.lab.refresh()
            self.lab.shape.choose_at(vertex)

    def give_up(self):
        """Let go of what the mouse has taken hold of."""
        for view in self.views:
            view.end_drag()
        self.held = None


def _course(session, name, values):
    """Faces for values of beta or gamma as shares of few changes of the face on screen.

    Returns
    -------
    shares : ndarray of shape (n_values, n_changes)
    changes : ndarray of shape (n_changes, n_vertices, 3)
        Millimetres, largest first.
    """
    bounded = session.limit is not None or session.model.bounds is not None  # answers have kinks
    places, c = np.arange(len(values)), session.coefficients
    knots = np.union1d(places[:: 1 if bounded else _KNOTS], places[-1:])
    C = CubicSpline(knots, session.answers_to(name, [values[k] for k in knots]))(places)
    U, sizes, directions = np.linalg.svd(C - c, full_matrices=False)
    shares = (U * sizes)[:, :_CHANGES]
    changes = session.vertices_of(c + directions[:_CHANGES]) - session.vertices_of(c)
    seen = np.abs(shares).max(axis=0) * np.abs(changes).max(axis=(1, 2)) > _UNSEEN
    return shares[:, seen], changes[seen]


def _half(options, text, tip):
    made = widgets.Dropdown(options=options, description=text, layout={"width": "48%"})
    made.style.description_width, made.tooltip = "58px", tip
    return made


def _growing():
    return widgets.Layout(flex="1 1 0", min_width="0", overflow="hidden")
