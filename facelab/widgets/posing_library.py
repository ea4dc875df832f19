"""The pose library: named poses as pictures, in a file that brings them back, and blends of two."""

import base64
from pathlib import Path

import ipywidgets as widgets

from facelab.files.poses import load_library, save_library
from facelab.posing.clips import interpolate, interpolate_gaze
from facelab.posing.fingerprint import fingerprint
from facelab.widgets.lab import WIDTH, Panel, button, row
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.parts import ItemList

ENDING = ".library.json"
_STEP = 0.01
_BUTTONS = [
    ["earlier", "◀", "Move it one place forward", False],
    ["later", "▶", "Move it one place back", False],
    ["remove", "✕", "Take it out of the library", False],
]


class StripPanel(Panel):
    """Poses as pictures, kept in a file of the lab's folder; between two of them one can blend.

    Attributes
    ----------
    poses : dict of str to PoseState
        By name, in the order of the strip.
    path : Path
        The file, one for each face; written when the library is changed by hand.
    """

    def _build(self):
        self.poses, self._pictures, self._others = {}, {}, []
        faces = fingerprint(self.lab.mesh)["sizes"][-1]
        self.path = Path(self.lab.folder) / f"face-{faces[:6]}{ENDING}"
        self.strip = ItemList("strip", self._react, label="Pose library")
        self.name = widgets.Text(placeholder="name of the pose", layout={"width": "46%"})
        self.keep = button("Add", "Add the pose on screen under this name", lambda _: self._keep())
        self.rename = button("Rename", "Give the chosen pose this name", lambda _: self._rename())
        self.a, self.b = (
            widgets.Dropdown(description=text, layout={"width": "47%"}) for text in ("from", "to")
        )
        self.share = widgets.FloatSlider(
            min=0, max=1, step=_STEP, description="blend", layout={"width": WIDTH}
        )
        for control in (self.a, self.b, self.share):
            control.style.description_width = "40px"
        self._about = widgets.HTML()
        self.widget = widgets.VBox(
            [
                row(self.name, self.keep, self.rename),
                self.strip,
                row(self.a, self.b),
                *(self.share, self._about),
            ]
        )
        self.share.observe(self._blend, names="value")
        self._put("neutral", self.session.state)
        self._bring_back()
        self._draw()

    def _bring_back(self):
        """The library of the file, if there is one; one that cannot be read is left alone."""
        if not self.path.exists():
            self._tell("Kept in {} once you add a pose.", self.path.name)
            return
        try:
            poses, self._others = load_library(self.path, self.session, self.lab.models)
        except (ValueError, OSError) as error:
            self.path = self.path.with_name("new-" + self.path.name)
            self._tell("Not read: {} What you add is kept in {}.", error, self.path.name)
            return
        self.poses, self._pictures = {}, {}
        for name, state in poses.items():
            self._put(name, state)
        left_out = f" {len(self._others)} of another model are not shown." if self._others else ""
        self._tell("Kept in {}.{}", self.path.name, left_out)

    def _tell(self, template, *texts):
        self._about.value = markup(f'<div class="facelab-status">{template}</div>', *texts)

    def _put(self, name, state):
        V = self.session.vertices_in(state)
        self.poses[name] = state
        picture = self.lab.thumbnails.png(V, state.gaze)
        self._pictures[name] = base64.b64encode(picture).decode()

    def add(self, name=""):
        """Add the pose on screen to the library; one of the same name is replaced."""
        self._put(name or self._free_name(), self.session.state)
        self._changed()

    def _free_name(self):
        return next(
            f"pose {k}" for k in range(1, len(self.poses) + 2) if f"pose {k}" not in self.poses
        )

    def _changed(self):
        """Show the library, and write it."""
        self._draw()
        if self._others:
            self.path = self.path.with_name("new-" + self.path.name)
            self._others = []
        save_library(self.path, self.poses, self.session)
        self._tell("Kept in {}.", self.path.name)

    def _draw(self):
        self.strip.items = [
            {"id": name, "name": name, "tip": name, "picture": picture, "buttons": _BUTTONS}
            for name, picture in self._pictures.items()
        ]
        self.refresh()
        with quiet(self):
            for choice in (self.a, self.b):
                before = choice.value
                choice.options = list(self.poses)
                choice.value = before if before in self.poses else next(iter(self.poses), None)

    def refresh(self):
        """Mark the pose of the library that is on screen."""
        now = self.session.state
        here = [i for i, state in enumerate(self.poses.values()) if state is now]
        self.strip.chosen = here[0] if here else -1

    @shows_errors
    def _keep(self):
        self.add(self.name.value.strip())
        self.name.value = ""

    @shows_errors
    def _rename(self):
        name, chosen = self.name.value.strip(), self.strip.chosen
        if chosen < 0:
            raise ValueError("no pose is chosen; click on the one to rename first.")
        if not name or name in self.poses:
            raise ValueError("the name is empty or taken; write another one first.")
        old = list(self.poses)[chosen]
        for kept in (self.poses, self._pictures):
            items = [(name if k == old else k, v) for k, v in kept.items()]
            kept.clear()
            kept.update(items)
        self.name.value = ""
        self._changed()

    @shows_errors
    def _react(self, do, name):
        if do == "choose":
            self.session.restore(self.poses[name])
            return
        if do == "remove":
            del self.poses[name], self._pictures[name]
        else:
            names = list(self.poses)
            i = names.index(name)
            names.insert(max(i + (1 if do == "later" else -1), 0), names.pop(i))
            for kept in (self.poses, self._pictures):
                items = [(k, kept[k]) for k in names]
                kept.clear()
                kept.update(items)
        self._changed()

    @shows_errors
    def _blend(self, change):
        if self.settling:
            return
        if not self.poses:
            raise ValueError("the library is empty; add the poses to blend first.")
        a, b = self.poses[self.a.value], self.poses[self.b.value]
        with self.session.group("blend"):
            self.session.use(a.model)
            share = change["new"]
            self.session.apply(interpolate(a, b, share), interpolate_gaze(a, b, share))
