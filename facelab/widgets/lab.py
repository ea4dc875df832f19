"""What both labs share: the face on the left, tidy controls beside it, steps, keys and words."""

import contextlib
import re
from functools import cached_property
from itertools import count
from weakref import WeakKeyDictionary

import ipywidgets as widgets

from facelab.expression.landmarks import guess_landmarks
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.places import FacePlaces
from facelab.widgets.in_touch import keep_free
from facelab.widgets.page import Page, markup, shows_errors
from facelab.widgets.parts import ROOT, ItemList, Keys

WIDTH = "calc(100% - 4px)"  # of a control that takes a whole row
_STEPS_SHOWN = 80


class Panel:
    """Part of a lab: its `widget`, and `refresh` to show the session as it is."""

    def __init__(self, lab):
        self.lab, self.settling = lab, False
        self._build()

    @property
    def session(self):
        return self.lab.session

    def fail(self, error):
        """Errors are shown by the lab."""
        self.lab.fail(error)


_PARAMETERS = {"beta": "Regions agree (β)", "gamma": "Stay close (γ)", "lam": "λ", "alpha": "α"}
_PARAMETERS |= {"path": "the file", "name": "the name"}
_VALUE = r"""'[^']*'|"[^"]*"|\[[^]]*\]|-?[\w.+-]*\w"""


class Lab(Page):
    """One base for both labs: a page of a face, or two, and of panels in tabs beside them.

    A lab has a `session` with a history, and says in `step_words(before, after)` what a step did.
    """

    def _begin(self):
        """What stays when the face is another one: the page itself."""
        self.widget = widgets.HBox()
        self.widget.add_class(ROOT)
        self._build_messages()

    def _lay_out(self, stage, above, panels, reactions, keys):
        """Put the page together: what is seen, controls always in view, and panels by their tab."""
        self.steps = StepPanel(self)
        panels = {**panels, "Steps": self.steps}
        self.tabs = widgets.Tab([p.widget for p in panels.values()], titles=tuple(panels))
        reactions = {key: self._guarded(act) for key, act in reactions.items()}
        controls = (c for part in (*stage, *above, self.tabs) for c in _inside(part))
        self.keys = Keys(reactions, self._settle, controls)
        stage = widgets.VBox([*stage, self._status, self._message])
        self._panel = widgets.VBox([*above, self.tabs, widgets.HTML(_key_list(keys)), self.keys])
        stage.add_class("facelab-stage")
        self._panel.add_class("facelab-side")
        self.widget.children = [stage, self._panel]
        keep_free(self.widget)

    @shows_errors
    def _settle(self):
        self.session.settle()

    def _guarded(self, action):
        @shows_errors
        def react(self):
            action()

        return lambda: react(self)

    @cached_property
    def places(self):
        """Names of the places of the face; one without landmarks has them guessed for that."""
        mesh, partners = self.mesh, getattr(self.session, "partners", None)
        found = FacePlaces(mesh, partners)
        if not found.known and self.rig is not None:
            with contextlib.suppress(ValueError):  # its shapes do not tell
                marks = guess_landmarks(self.rig)
                return FacePlaces(TriangleMesh(mesh.vertices, mesh.faces, marks), partners)
        return found

    def name_of(self, vertex):
        """A vertex in words: the place where it lies, or its number."""
        return self.places.vertex(vertex)

    def go(self, place):
        """Undo or redo up to a step, counted from the first."""
        self.session.history.go(place)

    def in_words(self, error):
        """What an error says, in words of the page: buttons and points, not arguments."""
        text = re.sub(r":? ?\b[a-z_.]+\([^()]*=[^()]*\)", "", str(error))
        text = re.sub(r"^name (is|has) ", r"The name \1 ", text)
        return re.sub(rf"\b([a-z_]+)=({_VALUE})", self._word, text)

    def _word(self, found):
        name, value = found.groups()
        if name == "vertex" and value.isdigit() and int(value) < self.mesh.n_vertices:
            return self.name_of(int(value))
        if name == "path":  # the folder is the lab's own, or one of no meaning
            value = value[0] + re.split(r"[/\\]", value[1:])[-1]
        said = f"{_PARAMETERS.get(name, name.replace('_', ' '))} {value}"
        return re.sub("^the ", "The ", said) if not found.start() else said


class StepPanel(Panel):
    """All steps in words; a click goes back, or forward, to one."""

    def _build(self):
        self._numbers, self._count = WeakKeyDictionary(), count()  # of states, for the page
        self.list = ItemList("choice", self._react, label="Steps")
        self.list.layout.max_height = "330px"
        self.widget = self.list

    def refresh(self):
        """Show the steps, the newest on top; those undone are pale."""
        history = self.session.history
        line, now = history.line, history.n_undo
        first = max(0, min(now, len(line) - _STEPS_SHOWN))
        shown = range(first, min(len(line), first + _STEPS_SHOWN))
        numbers = {k: self._number(line[k]) for k in shown}
        words = {k: self.lab.step_words(line[k - 1], line[k]) if k else "the start" for k in shown}
        self.list.items = [
            {
                "id": numbers[k],
                "name": words[k],
                "note": "undone" if k > now else "",
                "tip": "Go to this step",
            }
            for k in reversed(shown)
        ]
        self.list.chosen = shown[-1] - now

    def _number(self, state):
        """A number of its own: a place in line may be another step's by the time it is clicked."""
        if state not in self._numbers:
            self._numbers[state] = next(self._count)
        return self._numbers[state]

    @shows_errors
    def _react(self, _, number):
        self.lab.go([self._number(state) for state in self.session.history.line].index(number))


def _inside(widget):
    """A widget and all that is in it: generator."""
    yield widget
    for child in getattr(widget, "children", ()):
        yield from _inside(child)


def button(text, tip, react, width="auto"):
    """A button with a tooltip."""
    made = widgets.Button(description=text, tooltip=tip, layout={"width": width})
    made.on_click(react)
    return made


def toggle(text, tip, width="auto"):
    """A button that stays pressed."""
    return widgets.ToggleButton(
        description=text, tooltip=tip, layout={"width": width, "height": "26px"}
    )


def row(*children):
    """Controls beside each other; those that find no room go below."""
    return widgets.HBox(children, layout={"flex_flow": "row wrap"})


def _key_list(keys):
    rows = (markup("<b>{}</b><span>{}</span>", key, what) for key, what in keys.items())
    return markup(
        '<details class="facelab-keys"><summary>Keys, while the mouse or the focus is in the lab'
        "</summary><div>{}</div></details>",
        markup("").join(rows),
    )
