"""The expression lab: a sketch on the left, the face that action units make of it on the right."""

import base64
import functools
from pathlib import Path
from types import SimpleNamespace

import ipywidgets as widgets
import matplotlib
import numpy as np
from matplotlib.colors import to_hex

from facelab.checks import check_type
from facelab.expression.regression import CRITERIA
from facelab.expression.session import ALPHAS, BOUNDS, ExpressionSession
from facelab.expression.sketch_pins import BY_HAND
from facelab.looks import face_props
from facelab.motion import MotionSequence
from facelab.posing.sculpt import Sculpt
from facelab.posing.session import PosingSession
from facelab.widgets.expression_parts import AlphaCurve, UnitBars
from facelab.widgets.lab import WIDTH, Lab, button, row
from facelab.widgets.page import markup, path_in, quiet, shows_errors, uploaded, written
from facelab.widgets.parts import Sliders
from facelab.widgets.pins import PinPanel
from facelab.widgets.step_words import expression_step
from facelab.widgets.thumbnail import Thumbnails
from facelab.widgets.viewer import FaceView

_COLORS = "YlGnBu"
_PICTURE = (60, 66)  # pixels
_UNITS_OF_LENGTH = {"own": None, "mm": 1.0, "cm": 10.0, "m": 1000.0}
_LAMS = 1e-3, 10.0  # mm: ends of the slider
_KEYS = {"Z": "undo", "Y": "redo", "B": "best sum of the weights", "Esc": "give up a drag"}
_HINT = (
    "Left: the sketch. Drag a point of it to change it; drag beside it to turn both faces. "
    "Right: the face that the units make of it."
)


def _own(method):
    """A callback of the page: errors are shown, and what it does to the session is no news."""

    @functools.wraps(method)
    def acting(self, *args, **kwargs):
        outer, self._acting = self._acting, True
        try:
            return method(self, *args, **kwargs)
        finally:
            self._acting = outer

    return shows_errors(acting)


class ExpressionLab(Lab):
    """A page in which a sketched expression is explained by action units.

    Parameters
    ----------
    session : ExpressionSession
        What is shown; the lab only passes on what the mouse and the sliders do, and follows what
        is done elsewhere, as by another lab.
    sketches : dict of str to source, optional
        Sketches to choose from. A source is a face (TriangleMesh or vertices), a take
        (MotionSequence, with a slider through its frames), or a PosingSession: then pulling the
        sketch poses it by the model. All others are pulled vertex by vertex (`Sculpt`).
    others : dict of str to face or (face, props), optional
        Other faces to show the expression on: a BlendshapeRig or an IntermediateSpace each.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth, or still parts. If left out, those that `facelab.looks.face_props` makes.
    folder : str or Path
        Where results are saved and files are named from.
    width, height : int
        Size of one canvas, pixels.

    Attributes
    ----------
    session : ExpressionSession
    sketch_view, view : FaceView
        The sketch and the optimised face.
    curve : AlphaCurve
    bars : UnitBars
    widget : ipywidgets.Widget
        The whole page; a lab shows itself as the last line of a cell.
    """

    _after_error = "Sketch and weights are as they were."

    def __init__(
        self, session, sketches=None, others=None, props=None, folder=".", width=250, height=285
    ):
        self.session = check_type(session, "session", ExpressionSession, "ExpressionSession(rig)")
        mesh = session.rig.neutral
        self.sketches = {**(sketches or {}), "neutral": mesh}
        self.others = {
            name: other if isinstance(other, tuple) else (other, None)
            for name, other in (others or {}).items()
        }
        self.folder = Path(folder)
        self._props = face_props(mesh, session.rig) if props is None else list(props)
        self._size = width, height
        self.sketch_view = FaceView(mesh, self._props, width, height)
        self.view = FaceView(mesh, self._props, width, height, linked_to=self.sketch_view)
        self.sketch_view.names = [self.name_of(v) for v in range(self.mesh.n_vertices)]
        self.sketch_view.on_press = self._press
        self.sketch_view.on_move = self._move
        self.sketch_view.on_release = self._release
        self._puller = self._other_view = self._rms = self._followed = None
        self._other_note = ""
        self._painted = self._pulling = self._acting = False
        self._begin()
        self._build_parts()
        self._build_page()
        self.refresh()

    # --- the page ---------------------------------------------------------------------------------

    def _build_parts(self):
        rig = self.session.rig
        draw = Thumbnails(rig.neutral, self._props, *_PICTURE).png
        units = [
            {
                "name": name,
                "tip": f"{name}: {self.places.motion(rig.deltas[k], literal=True) or 'moves'}, "
                f"{np.linalg.norm(rig.deltas[k], axis=1).max():.1f} mm at weight 1",
                "picture": base64.b64encode(draw(rig.neutral.vertices + rig.deltas[k])).decode(),
            }
            for k, name in enumerate(rig.names)
        ]
        self.bars = UnitBars(units, self._edit)
        self.curve = AlphaCurve(ALPHAS, self._choose_alpha)
        wide = {"style": {"description_width": "96px"}, "layout": {"width": WIDTH}}
        self.lam = Sliders(self._slide)
        tip = "How strongly the sum of the weights is held to α"
        name = {"id": "lam", "name": "Hold sum λ (mm)", "tip": tip}
        self.lam.items = [{**name, "low": _LAMS[0], "high": _LAMS[1], "log": True}]
        self.lam.color = "#0072b2"
        self.bounds = widgets.Dropdown(options=list(BOUNDS), description="Weights", **wide)
        self.bounds.tooltip = "Between which ends the weights may lie"
        self.criterion = widgets.Dropdown(options=CRITERIA, description="Best by", **wide)
        self.criterion.tooltip = "How the best sum α is chosen"
        self.align, self.clamp, self.difference = (
            widgets.Checkbox(description=text, tooltip=tip, indent=False, layout={"width": WIDTH})
            for text, tip in (
                ("take motion of the whole head out", "Of the sketch, before it is read"),
                ("stop vertices at their boundary", "The furthest that any one unit moves them"),
                ("colour by distance to the sketch", "Dark: far from it"),
            )
        )
        self.undo = button("Undo", "One step back", self._press_button)
        self.redo = button("Redo", "One step forward again", self._press_button)
        self.best = button("Best α", "Follow the best sum of the weights", self._press_button)
        self.free = button("Free all", "Let go of locked and excluded units", self._press_button)
        self.sorted = widgets.Checkbox(
            description="strongest first", tooltip="Order the units by what they do to the face",
            indent=False, layout={"width": WIDTH},
        )  # fmt: skip
        self.source = widgets.Dropdown(options=self._sources(), description="Sketch", **wide)
        self.frame = widgets.IntSlider(description="Frame", **wide)
        self.unit = widgets.Dropdown(
            options=list(_UNITS_OF_LENGTH), layout={"width": "64px"},
            tooltip="Unit of length of the file; own: as it says itself",
        )  # fmt: skip
        self.upload = widgets.FileUpload(
            accept=".obj,.ply,.glb,.stl", description="Open a mesh in", layout={"width": "auto"},
            tooltip="A sketch from a file, with the vertices of this face",
        )  # fmt: skip
        self.other = widgets.Dropdown(
            options=["", *self.others], description="Also on", disabled=not self.others, **wide
        )
        for each in (self.source, self.frame, self.other):
            each.style.description_width = "54px"
        self.file = widgets.Text("expression.csv", layout={"width": "60%"})
        self.save = button(
            "Save",
            ".csv: a table; .livelink.csv: ARKit names; .json: a pose; .obj: the face",
            self._save,
        )
        self._key, self._sum, self._result = widgets.HTML(), widgets.HTML(), widgets.HTML()
        self.pins = PinPanel(self)

    def _build_page(self):
        self._views = widgets.HBox([self.sketch_view.widget, self.view.widget])
        self._views.add_class("facelab-views-row")
        curve = row(self.curve, self._sum)
        above = [self.source, self.frame, row(self.undo, self.redo, self.best, self.free)]
        fit = self.lam, self.bounds, self.criterion, self.clamp, self.align
        out = "Saved beside the notebook: .csv, .livelink.csv, .json or .obj"
        out = widgets.HTML(markup('<div class="facelab-status">{}</div>', out))
        panels = {
            "Units": [self.sorted, self.bars],
            "Pins": [self.pins.widget],
            "Fit": fit,
            "View": [self.other, self.difference, self._key],
            "Files": [row(self.upload, self.unit), out] + [row(self.file, self.save), self._result],
        }
        panels = {name: SimpleNamespace(widget=widgets.VBox([*p])) for name, p in panels.items()}
        reactions = {
            **dict.fromkeys(("z", "Ctrl+z"), self.undo.click),
            **dict.fromkeys(("y", "Ctrl+y"), self.redo.click),
            "b": lambda: self._pulling or self.best.click(),
            "Escape": self._give_up,
        }
        self._lay_out([self._views, curve], above, panels, reactions, _KEYS)
        for control in (self.bounds, self.criterion, self.align, self.clamp):
            control.observe(self._choose, names="value")
        for control, react in (
            (self.source, self._choose_source),
            (self.frame, self._choose_frame),
            (self.upload, self._take_file),
            (self.difference, self._show_difference),
            (self.other, self._choose_other),
            (self.sorted, self._sort),
        ):
            control.observe(react, names="value")
        for source in self.sketches.values():
            if isinstance(source, PosingSession):
                source.observe(self._posed)
        self.session.observe(self._follow)

    def _sources(self):
        # those to choose from first: the page names them by their place
        return list(dict.fromkeys([*self.sketches, self._place_of(self.session.state.origin)[0]]))

    # --- what is shown ----------------------------------------------------------------------------

    def refresh(self):
        """Show the session as it is now, sketch and settings too."""
        state = self.session.state
        self.clear()
        with quiet(self):
            self.sketch_view.show(self.session.sketch)
            self.sketch_view.show_pins(self._pins())
            name, frame = self._place_of(state.origin)
            if self.source.options != tuple(self._sources()):
                self.source.options = self._sources()
            self.source.value = name
            self.frame.layout.display = "none" if frame is None else "flex"
            if frame is not None:
                self.frame.max = self.sketches[name].n_frames - 1
                self.frame.value = frame
            self.bounds.value, self.criterion.value = state.bounds, state.criterion
            self.align.value, self.clamp.value = state.align is True, state.clamp
            self._show_history()
        self.pins.refresh()
        self._show_answer()
        self._show_difference()
        self._sort()

    @property
    def rig(self):
        """The rig whose units are read."""
        return self.session.rig

    def picture(self):
        """The face that the units make, for where the lab does not run: bytes of a PNG."""
        return Thumbnails(self.mesh, self._props, *self._size).png(self.session.vertices)

    @property
    def mesh(self):
        """The face at rest."""
        return self.session.rig.neutral

    @property
    def pinned(self):
        """What has the pins: the PosingSession of the sketch, or this session."""
        return self._posing() or self.session

    @property
    def pinned_face(self):
        """The face that the pins pull, shape (n_vertices, 3), millimetres."""
        return self.session.sketch

    def step_words(self, before, after):
        """What a step did, in words."""
        return expression_step(before, after, self.name_of)

    def go(self, place):
        """Go to a step, one by one: a PosingSession that made a sketch goes along."""
        while self.session.n_undo > place:
            self._walk(back=True)
        while self.session.n_undo < place:
            self._walk(back=False)
        self.refresh()

    @shows_errors
    def _follow(self, _):
        """Show what was done to the session elsewhere."""
        if not self._acting:
            self.refresh()

    def _show_history(self):
        self.undo.disabled = not self.session.can_undo
        self.redo.disabled = not self.session.can_redo
        self.steps.refresh()

    def _show_answer(self):
        """Show what the units make: all that may change while a slider or the mouse moves."""
        session, fit = self.session, self.session.fit
        if not (self._pulling and self._followed):
            self.view.show(session.vertices)
        self._other_note = ""
        if self._other_view is not None:
            try:
                self._other_view.show(session.on(self.others[self.other.value][0]))
            except Exception as error:  # the sketch and its units are shown all the same
                self._other_note = f"{self.other.value} is as it was: {error}"
        weights = np.round(session.weights, 4)
        self.bars.weights = weights.tolist()
        self.bars.states = [self._state_of(name) for name in session.names]
        self.lam.values = [float(max(session.state.lam, _LAMS[0]))]  # 0 has no place on it
        with quiet(self), self.curve.hold_sync():
            if fit.rms is not self._rms:
                self._rms, self.curve.rms = fit.rms, np.round(fit.rms, 4).tolist()
            self.curve.best, self.curve.reach = fit.best, min(session.reach[1], 1e6)
            self.curve.place = int(np.abs(ALPHAS - session.alpha).argmin())
        self._paint()
        self._tell()

    def _state_of(self, name):
        session = self.session
        if name in session.state.locked:
            return "locked"
        if name in session.state.excluded:
            return "excluded"
        return "dropped" if name in session.dropped else "free"

    def _tell(self):
        session = self.session
        following = " (best)" if session.state.alpha is None else ""
        over = session.excess
        self._sum.value = (
            f"α = {session.alpha:g}{following}: sum {session.weights.sum():.2f}, "
            f"RMS {session.rms:.3f} mm"
        )
        said = [note for note in (session.note, self._other_note) if note]
        if over.max() > 0.05:
            where = "stopped at" if session.state.clamp else "beyond"
            said.append(
                f"{np.count_nonzero(over > 0.05)} vertices {where} their boundary, the furthest by "
                f"{over.max():.1f} mm."
            )
        self.say(" ".join(said or [_HINT]))

    def _show_difference(self, _=None):
        """The scale of the colours: set anew when something has settled, not while it moves."""
        self._full = _nice(self.session.distance.max())
        self._key.value = _color_key(self._full) if self.difference.value else ""
        self._paint()

    def _paint(self):
        if self.difference.value:
            share = (self.session.distance / self._full).clip(0, 1)
            self.view.paint(matplotlib.colormaps[_COLORS](share)[:, :3])
        elif self._painted:
            self.view.paint(None)
        self._painted = self.difference.value

    def fail(self, error):
        """Show an error, give up the drag it happened in, and keep the last good state."""
        self._give_up()
        super().fail(error)

    # --- the mouse on the sketch ------------------------------------------------------------------

    def _posing(self):
        """The PosingSession that the sketch on screen comes from, or None."""
        source = self.sketches.get(self._place_of(self.session.state.origin)[0])
        if isinstance(source, PosingSession):
            # by rounding: a drag adds what its release solves
            if np.allclose(source.vertices, self.session.state.sketch, rtol=0, atol=1e-6):
                return source
        return None

    def _pins(self):
        pinned = self.pinned
        return {v: t for v, t in pinned.pins.items() if v not in pinned.hidden}

    @shows_errors
    def _press(self, vertex):
        session = self.session
        posing = self._posing()
        self._puller = posing or Sculpt(session.rig.neutral, session.sketch)
        self._pulled = session.state.origin if posing else BY_HAND
        self._pulling, self._before = True, session.state
        self._answer = self._puller.press(vertex)
        self._held, self._from = vertex, self._puller.pins[vertex]
        self.clear()
        session.settle()
        self._followed = None
        if self._answer is not None:  # the page draws the sketch
            self.sketch_view.begin_pull(self._answer, vertex, self._from)
        if isinstance(self._answer, np.ndarray):  # and what the units make of it
            self._followed = session.follow(self._answer)
            if self._followed is not None:
                self.view.begin_pull(self._followed, None, self._from)

    @_own
    def _move(self, offset):
        self._puller.drag(self._held, self._from + offset)
        by_hand = self._held if self._pulled == BY_HAND else None
        self.session.load(self._puller.vertices, self._pulled, live=True, pulled=by_hand)
        if self._answer is None:
            self.sketch_view.show(self.session.sketch)
        self._show_answer()

    @_own
    def _release(self):
        self._puller.release()
        self._pulling = False
        self.session.settle()
        self.refresh()

    def _give_up(self):
        """Give up a pull: the sketch, and the session that is pulled, are as they were before."""
        self.sketch_view.end_drag()
        if self._pulling:
            self._puller.cancel()
            with self.session.history.group("sketch"):  # back to the start of the stroke of `load`
                self.session.history.make(self._before)
        self._pulling = False
        self.session.settle()
        self.refresh()

    @_own
    def _posed(self, what):
        """Follow a PosingSession that is pulled elsewhere, as in a PosingLab on the same page."""
        origin = self.session.state.origin
        source = self.sketches.get(origin)
        if self._pulling or not isinstance(source, PosingSession):
            return
        self.session.load(source.vertices, origin, live=True)
        if what == "step":
            self.session.settle()
            self.refresh()
        else:
            self.sketch_view.show(self.session.sketch)
            self._show_answer()

    # --- controls ---------------------------------------------------------------------------------

    def _choose_alpha(self, place):
        if not self.settling:
            self._set(alpha=float(ALPHAS[place]))

    @_own
    def _set(self, **changes):
        """Pass on what only changes the answer: quick enough for a slider on the move."""
        self.session.set(**changes)
        self.clear()
        self._show_answer()
        self._show_history()

    @_own
    def _slide(self, _, lam):
        self._set(lam=lam)

    @_own
    def _choose(self, _):
        if not self.settling:
            self.session.set(
                bounds=self.bounds.value,
                criterion=self.criterion.value,
                align=True if self.align.value else "check",
                clamp=self.clamp.value,
            )
            self.refresh()

    @_own
    def _edit(self, what, unit, weight):
        session, name = self.session, self.session.names[unit]
        if what == "settle":
            session.settle()
            self.refresh()
            return
        if what == "weight":
            session.lock(name, weight)
        elif self._state_of(name) == {"lock": "locked", "exclude": "excluded"}[what]:
            session.free(name)
        elif what == "lock":
            session.lock(name)
            session.settle()
        else:
            session.exclude(name)
        self.clear()
        self._show_answer()
        self._show_history()

    @_own
    def _press_button(self, pressed):
        if pressed is self.best:
            self.session.set(alpha="best")
        elif pressed is self.free:
            self.session.free()
        else:
            self._walk(back=pressed is self.undo)
        self.refresh()

    def _walk(self, back):
        """One step back or forward, in the PosingSession too; a pull under way is given up."""
        if self._pulling:
            self._give_up()
            return
        session, before, posing = self.session, self.session.state, self._posing()
        session.undo() if back else session.redo()
        state = session.state
        if posing and state.origin == before.origin and state.sketch is not before.sketch:
            self._pulling = True  # what follows is not news
            posing.undo() if back else posing.redo()
            self._pulling = False

    @shows_errors
    def _sort(self, _=None):
        """The units in their own order, or by the millimetres that they move the face now."""
        n = len(self.session.names)
        reach = np.linalg.norm(self.session.rig.deltas, axis=2).max(axis=1)
        now = np.abs(self.session.weights) * reach
        self.bars.order = np.lexsort((-reach, -now)).tolist() if self.sorted.value else [*range(n)]

    # --- where sketches come from, and where results go -------------------------------------------

    def _place_of(self, origin):
        """Name of the source of a sketch, and the frame where it is a take."""
        name, _, frame = origin.rpartition(", frame ")
        return (name, int(frame)) if name in self.sketches and frame.isdigit() else (origin, None)

    @_own
    def _choose_source(self, change):
        if self.settling or change["new"] not in self.sketches:
            return
        source = self.sketches[change["new"]]
        if isinstance(source, MotionSequence):
            self._load_frame(change["new"], int(np.argmax(source.valid)))
        else:
            self.session.load(getattr(source, "vertices", source), change["new"])
        self.refresh()

    @_own
    def _choose_frame(self, change):
        if not self.settling:
            self._load_frame(self.source.value, change["new"], live=True)
            self.sketch_view.show(self.session.sketch)
            self._show_answer()
            self._show_history()

    def _load_frame(self, name, frame, live=False):
        origin = f"{name}, frame {frame}"
        self.session.load_frame(self.sketches[name], frame, origin, live)

    @_own
    def _take_file(self, change):
        if not change["new"]:
            return
        with uploaded(self.upload) as path:
            self.session.load_file(path, _UNITS_OF_LENGTH[self.unit.value], path.name)
        self.refresh()

    @shows_errors
    def _choose_other(self, change):
        self._other_view = None
        if change["new"]:
            face, props = self.others[change["new"]]
            try:
                self.session.on(face)
            except Exception:
                self.other.value = ""
                raise
            mesh = face.neutral if hasattr(face, "neutral") else face.target
            self._other_view = FaceView(mesh, props, *self._size, linked_to=self.sketch_view)
        views = [v.widget for v in (self.sketch_view, self.view, self._other_view) if v]
        self._views.children = views
        self._show_answer()

    @shows_errors
    def _save(self, _):
        self._result.value = ""
        path = path_in(self.folder, self.file.value)
        again = path.exists()
        left_out = self.session.save(path)
        self.clear()
        self._result.value = written(path, left_out, again)


def _nice(value):
    """The next of 1, 2, 5 times a power of ten, at least 0.1."""
    value = max(value, 0.1)
    power = 10.0 ** np.floor(np.log10(value))
    return next(n * power for n in (1, 2, 5, 10) if n * power >= value * (1 - 1e-9))


def _color_key(full):
    colors = [to_hex(c) for c in matplotlib.colormaps[_COLORS](np.linspace(0, 1, 9))]
    return (
        '<div style="display:flex;gap:6px;align-items:center;font-size:12px">0'
        f'<span style="width:180px;height:12px;background:linear-gradient(90deg,'
        f'{",".join(colors)})"></span>{full:g} mm</div>'
    )
