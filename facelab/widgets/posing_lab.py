"""The posing lab: a face to pull, and beside it what else a hand can do to a pose."""

import contextlib
from pathlib import Path
from weakref import WeakKeyDictionary

import ipywidgets as widgets
import numpy as np

from facelab.data.examples import load_example
from facelab.files.rigs import read_rig
from facelab.geometry.binding import bind_to_samples
from facelab.geometry.symmetry import MIRROR
from facelab.looks import face_props
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.posing.session import PosingSession
from facelab.segmentation.segment import segment_face
from facelab.widgets.lab import Lab, button, row
from facelab.widgets.last_pose import LastPose
from facelab.widgets.own_face import own_face
from facelab.widgets.page import quiet, shows_errors
from facelab.widgets.posing_clips import ClipPanel
from facelab.widgets.posing_files import FilePanel
from facelab.widgets.posing_library import StripPanel
from facelab.widgets.posing_panels import PosePanel, ShapePanel
from facelab.widgets.posing_stage import Stage
from facelab.widgets.step_words import pose_step
from facelab.widgets.thumbnail import Thumbnails

_HINT = "Drag: pose. Beside the face: turn. Shift: along the normal. Alt: past a pin."
_ASKEW = 0.5  # mm that one side may be off the mirror image of the other without a word
_STILL = 340, 380  # pixels of the picture for where it does not run


class PosingLab(Lab):
    """A page in which a face is posed by click and drag.

    Parameters
    ----------
    session : PosingSession
        What is posed; the lab only shows it and passes on what the mouse and the sliders do. Two
        labs of one session stay in step, and a script that uses the session is seen in both.
    models : dict of str to model, optional
        Models to choose from, by the name on their button; the session's own must be among them.
    props : iterable of Prop or (TriangleMesh, colors), optional
        Eyes and teeth, or still parts. If left out, those that `facelab.looks.face_props` makes.
    takes : dict of str to MotionSequence (or tuple of forms of it), optional
        Recorded takes that can be played through the model, by name. A tuple holds the same take
        in several forms, such as motion and weights of a rig: what the model can take is played.
    width, height : int
        Size of the canvas, pixels.
    folder : str or Path, default="."
        Where files are written and looked for.

    Attributes
    ----------
    session : PosingSession
    view : FaceView
    about : str
        What the face is, real or synthetic; of `example`.
    widget : ipywidgets.Widget
        The whole page; a lab shows itself as the last line of a cell.
    """

    def __init__(
        self, session, models=None, props=None, takes=None, width=470, height=540, folder="."
    ):
        self.folder, self.size = folder, (width, height)
        self._begin()
        self.take_up(session, models, props, takes)

    @classmethod
    def example(cls, n_components=20, n_regions=9, **kwargs):
        """A lab of the example face: region model, holistic model and rig, and both takes.

        The models learn from the first take, on 397 vertices with 0.3 mm of noise.

        Parameters
        ----------
        n_components : int, default=20
            Modes of each region, and of the holistic model.
        n_regions : int, default=9
        **kwargs
            For `PosingLab`.
        """
        example = load_example()
        face = example.rig.neutral
        corners = [face.landmarks[f"mouth_corner_{side}"] for side in ("left", "right")]
        samples, control = face.subsample(397, keep=corners)
        small = example.rig.on(samples, control)
        motion = small.animate(example.train).with_noise(0.3, random_state=0)
        regions = segment_face(
            motion.resampled(15), n_regions=n_regions, random_state=0, progress=False
        )
        models = {
            "region": RegionModel(regions, n_components).fit(motion.displacements()),
            "holistic": HolisticModel(n_components).fit(motion.displacements()),
            "rig": example.rig,
        }
        both = {"first take": example.train, "second take": example.test}
        takes = {name: (small.animate(take), take) for name, take in both.items()}
        session = PosingSession(models["region"], face, binding=bind_to_samples(face, samples))
        lab = cls(session, models, example.props, takes, **kwargs)
        lab.about = example.about
        return lab

    @classmethod
    def open(cls, rig, take=None, n_components=20, n_regions=9, **kwargs):
        """A lab of one's own rig: the rig as it is, and a region model that learned from it.

        The region model learns from the take, or, where there is none, from plausible mixtures of
        the rig's own shapes (`BlendshapeRig.plausible_mixtures`), with 0.3 mm of noise.

        Parameters
        ----------
        rig : str, Path or BlendshapeRig
            A file or folder for `read_rig`, or a rig.
        take : WeightSequence, optional
            Weights of a performance, in any spelling of names that drives the rig.
        n_components : int, default=20
            Modes of each region.
        n_regions : int, default=9
        **kwargs
            For `PosingLab`.

        Raises
        ------
        FileNotFoundError, ValueError, TypeError
            As `read_rig`, and for a take that does not drive the rig.
        """
        rig = read_rig(rig) if isinstance(rig, (str, Path)) else rig
        arguments, about = own_face(rig, take, n_components, n_regions)
        lab = cls(**arguments, **kwargs)
        lab.about = about
        lab.say(about)
        return lab

    def become(self, rig, take=None):
        """Show and pose another rig in this page, as `open` makes one."""
        rig = read_rig(rig) if isinstance(rig, (str, Path)) else rig
        arguments, about = own_face(rig, take)
        self.take_up(**arguments)
        self.about = about
        self.say(about)

    def take_up(self, session, models=None, props=None, takes=None):
        """Show and pose what another session has, in this page; arguments as of the lab."""
        if not isinstance(session, PosingSession):
            raise TypeError(f"session is a {type(session).__name__}, but must be a PosingSession.")
        models = dict(models or {"model": session.model})
        if not any(model is session.model for model in models.values()):
            raise ValueError("models does not hold the session's own model; add it under a name.")
        if hasattr(self, "session"):
            self.session.history.unobserve(self._follow)
            del self.places
        self.session, self.models = session, models
        self.props = face_props(session.neutral, self.rig) if props is None else list(props)
        self.takes, self.about = dict(takes or {}), ""
        self.thumbnails = Thumbnails(session.neutral, self.props)
        self.stage = Stage(self)
        self.frame = None  # a callable that gives vertices to show in place of the session's

        self._made = WeakKeyDictionary()  # the entry of the log, as a list, for each state
        self._build()
        session.observe(self._follow)
        self.refresh()

    @property
    def mesh(self):
        """The face at rest."""
        return self.session.neutral

    @property
    def rig(self):
        """The rig among the models that moves the very face on screen, or None."""
        rigs = (m for m in self.models.values() if m.named)
        return next((rig for rig in rigs if rig.n_vertices == self.mesh.n_vertices), None)

    def picture(self):
        """The face as it is, for where the lab does not run: bytes of a PNG."""
        return Thumbnails(self.mesh, self.props, *_STILL).png(self.vertices, self.gaze)

    @property
    def pinned(self):
        """The session that has the pins."""
        return self.session

    @property
    def pinned_face(self):
        """The face that the pins pull, shape (n_vertices, 3), millimetres."""
        return self.session.vertices

    @property
    def view(self):
        """The view in which the face is posed: FaceView."""
        return self.stage.view

    # --- the page ---------------------------------------------------------------------------------

    def _build(self):
        self.model_choice = widgets.ToggleButtons(
            options=list(self.models), value=self.model_name, style={"button_width": "auto"}
        )
        self._buttons = {
            text: button(text, tip, self._press_button)
            for text, tip in {
                "Undo": "One step back",
                "Redo": "One step forward again",
                "Bake pins": "Keep this pose and take the pins away",
                "Reset": "Back to the neutral face",
                "L → R": "The person's left half onto the right one, pins too",
                "R → L": "The person's right half onto the left one, pins too",
                "Swap sides": "The whole pose, left for right, pins too",
            }.items()
        }
        self.undo, self.redo, self.keep, self.reset, _, _, self.mirror = self._buttons.values()
        self.pose, self.shape = PosePanel(self), ShapePanel(self)
        self.strip, self.clip = StripPanel(self), ClipPanel(self)
        self.files, self.last = FilePanel(self), LastPose(self)
        above = [
            row(self.model_choice, self.stage.ghost),
            row(self.stage.beside, self.stage.paint),
            row(*self._buttons.values(), *self.last.widgets),
        ]
        panels = {"Pins": self.pose, "Sliders": self.shape, "Poses": self.strip}
        panels |= {"Time": self.clip, "Files": self.files}
        self._lay_out([self.stage.widget], above, panels, self._reactions(), _KEYS)
        self.model_choice.observe(self._choose_model, names="value")

    @property
    def model_name(self):
        """Name of the session's model, None if it is of a script."""
        return next((n for n, m in self.models.items() if m is self.session.model), None)

    def fail(self, error):
        """Show an error, give up the drag it happened in, and keep the last good pose."""
        with contextlib.suppress(Exception):  # it may be the showing that failed
            self._give_up()
        made = getattr(error, "step_made", False)
        self._after_error = "The step was made." if made else "The pose is as it was."
        super().fail(error)

    # --- what is shown ----------------------------------------------------------------------------

    def refresh(self):
        """Show the session as it is now."""
        session = self.session
        self.clear()
        if self.model_name is None:  # a script gave the session a model of its own
            self.models["other"] = session.model
        with quiet(self):
            self.model_choice.options = list(self.models)
            self.model_choice.value = self.model_name
        self.undo.disabled, self.redo.disabled = not session.can_undo, not session.can_redo
        for panel in (self.pose, self.shape, self.clip, self.strip, self.steps, self.stage):
            panel.refresh()
        self.tell()

    def show(self):
        """Show the pose, or the frame of a clip that is on."""
        self.stage.show()

    def show_frame(self, frame):
        """Show what `frame()` gives, shape (n_vertices, 3), in place of the session's pose."""
        self.frame = frame
        self.show()

    def show_pose(self):
        """Show the session's pose again."""
        self.frame = None
        self.refresh()

    @property
    def vertices(self):
        """Vertices on screen in the first view, shape (n_vertices, 3), millimetres."""
        return self.session.vertices if self.frame is None else self.frame()

    @property
    def gaze(self):
        """Where the eyes on screen are turned, beyond what the skin says: see `PoseState`."""
        return self.session.state.gaze if self.frame is None else self.clip.gaze

    def tell(self):
        """Say what the colours on the face mean, or how to pose it."""
        self.say(self.stage.legend() or _HINT)

    def distance(self, session):
        """How far each region is from training, 1 as is typical: shape (n_regions,), or None."""
        distance = session.plausibility()
        sizes = [s.stop - s.start for s in session.model.slices]
        return None if distance is None else distance / np.sqrt(sizes)

    def step_words(self, before, after):
        """What a step did, in words."""
        names = {id(model): name for name, model in self.models.items()}
        return pose_step(before, after, self.name_of, names, *self._made.get(after, ()))

    def _follow(self, what):
        """The session has changed, by this lab, another one, or a script."""
        try:
            self.pose.note_change()
            held, live = self.stage.held, self.session.history.live
            over = held is not None and (live is None or live.vertex != held)
            if over:  # by an undo, or a pull elsewhere
                self.stage.give_up()
                self.refresh()
            if what == "step":
                self.frame = self.clip.frame if self.clip.over_pose else None
                self._note_step()
                self.last.keep()
                if over:
                    self.say("Your pull was given up: the pose was changed meanwhile.")
            elif self.stage.held is None:
                self.show()
        except Exception as error:
            error.step_made = what == "step"
            self.fail(error)

    def _note_step(self):
        session = self.session
        act = session.log[-1:]
        self._made.setdefault(session.state, act)
        self.refresh()

    # --- the panel's callbacks --------------------------------------------------------------------

    @shows_errors
    def _choose_model(self, change):
        if not self.settling:
            self.session.use(self.models[change["new"]])

    @shows_errors
    def _press_button(self, button):
        session = self.session
        {
            "Undo": session.undo,
            "Redo": session.redo,
            "Bake pins": session.keep,
            "Reset": session.reset,
            "L → R": lambda: self._to_the_other(lambda: session.copy_side("left")),
            "R → L": lambda: self._to_the_other(lambda: session.copy_side("right")),
            "Swap sides": lambda: self._to_the_other(session.mirror),
        }[button.description]()

    def _to_the_other(self, act):
        """Pose the other side like this one, and say how far off a model is that cannot do it."""
        rest, partners = self.mesh.vertices, self.session.partners
        before = self.session.vertices - rest
        act()
        after = self.session.vertices - rest
        mirrored = (before if act == self.session.mirror else after)[partners] @ MIRROR
        off = np.linalg.norm(after - mirrored, axis=1).max()
        if off > _ASKEW:
            self.say(f"As near as this model comes: up to {off:.1f} mm from the mirror image.")

    # --- keys -------------------------------------------------------------------------------------

    def _reactions(self):
        session = self.session
        return {
            **dict.fromkeys(("z", "Ctrl+z"), session.undo),
            **dict.fromkeys(("y", "Ctrl+y"), session.redo),
            "k": session.keep,
            "f": session.mirror,
            "m": self._next_model,
            "c": self._next_beside,
            "s": lambda: self.pose.symmetric.set_trait("value", not self.pose.symmetric.value),
            "n": lambda: self.pose.along.set_trait("value", not self.pose.along.value),
            "h": lambda: self._at_hovered(session.hold),
            "l": lambda: self._at_hovered(self.pose.toggle_lock),
            **dict.fromkeys(("x", "Delete"), lambda: self._at_hovered(self.pose.remove_pin)),
            "p": self.strip.add,
            **{k: lambda way=way: self.stage.view.look_from(way) for k, way in _VIEWS.items()},
            "Space": self.clip.toggle,
            "Escape": self._give_up,
        }

    def _at_hovered(self, action):
        if self.stage.hovered is None:
            raise ValueError("no point of the face is under the mouse; move it, or Tab to a pin.")
        action(self.stage.hovered)

    def _next_model(self):
        names = list(self.models)
        self.session.use(self.models[names[(names.index(self.model_name) + 1) % len(names)]])

    def _next_beside(self):
        beside = self.stage.beside
        names = list(beside.options)
        beside.value = names[(names.index(beside.value) + 1) % len(names)]

    def _give_up(self):
        self.stage.give_up()
        self.session.cancel()
        self.refresh()


_VIEWS = {"1": (0, 0, 1), "2": (0.7, 0, 0.7), "3": (-0.7, 0, 0.7)}
_KEYS = {
    "Z": "undo",
    "Y": "redo",
    "K": "bake the pins",
    "F": "swap sides",
    "S": "both sides",
    "N": "in and out",
    "M": "next model",
    "C": "compare",
    "H": "hold the point",
    "L": "lock it",
    "X": "remove its pin",
    "Delete": "remove it",
    "P": "pose to the library",
    "1": "from the front",
    "2": "from the left",
    "3": "from the right",
    "Space": "play",
    "Esc": "give up a drag",
}
