"""The pose library: named poses as pictures, in a file that brings them back, and blends of two."""

import base64
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count

import ipywidgets as widgets
import numpy as np

from facelab.files.poses import read_library, save_library
from facelab.posing.clips import interpolate, interpolate_gaze
from facelab.posing.state import PoseState
from facelab.widgets.lab import WIDTH, Panel, button, row
from facelab.widgets.last_pose import files_of_face
from facelab.widgets.page import markup, quiet, shows_errors
from facelab.widgets.parts import ItemList
from facelab.widgets.put_back import PutBack

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
    path : Path
        The file, one for each face, written when the library is changed by hand. It is read again
        before that: what other labs added, and poses of models that are not at hand, stay in it.
    """

    def _build(self):
        self._items, self._pictures = {}, {}  # all of the file; by pose
        self._chosen = self._unread = self._unkept = None
        self.path = next(files_of_face(self.lab, ENDING))
        self.strip = ItemList("strip", self._react, label="Pose library")
        self.back = PutBack(self._put_back)
        self.name = widgets.Text(placeholder="name of the pose", layout={"width": "46%"})
        self.name.on_msg(lambda _, message, __: message.get("event") == "submit" and self._keep())
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
                *(self.strip, self.back.widget),
                row(self.a, self.b),
                *(self.share, self._about),
            ]
        )
        self.share.observe(self._blend, names="value")
        self._show(self._read() or {"neutral": self._neutral()})

    def _neutral(self):
        state = self.session.state
        rest = np.zeros_like(state.c_0)
        return replace(state, **state.bare(rest), coefficients=rest, gaze=(0.0, 0.0))

    @property
    def poses(self):
        """Poses of the models at hand, by name, in the order of the strip: dict to PoseState."""
        return _at_hand(self._items)

    def _read(self, name=None):
        """The library as it is now, and `name` must be in it.

        A file that cannot be read is left alone, and another one takes its place. What that has
        is added when the first can be read again.
        """
        items, kept, self._spare = self._items, {}, None
        while self.path.exists():
            try:
                items = {**self._stored(self.path), **kept}
            except (ValueError, OSError) as error:
                self._unread, kept = error, self._items
                self.path = _in_place_of(self.path)
                continue
            other = _in_place_of(self.path)
            with suppress(ValueError, OSError):  # mostly there is none; or it is of another face
                items, self._spare = _joined(items, self._stored(other)), other
            break
        if name is not None and name not in items:
            self._show(items)
            raise ValueError(f"{name} is in the library no more: it was taken out elsewhere.")
        return items

    def _stored(self, path):
        found = read_library(path, self.session, self.lab.models)
        return {k: self._known(k, pose) for k, pose in found.items()}

    def _known(self, name, pose):
        """The pose that is there already, if it is the same: it has its picture."""
        before = self.poses.get(name)
        return before if _same(before, pose) else pose

    def _write(self, items):
        """Write the library, then show it as it is now."""
        self._unkept = None
        try:
            save_library(self.path, items, self.session)
            if self._spare is not None:  # all that it has was read with the rest
                with suppress(OSError):
                    self._spare.unlink()
        except OSError as error:
            if self.path.exists():
                raise
            why = self.lab.in_words(error).rstrip(".")
            self._unkept = f"Not kept: {why}; these poses last as long as this page."
            self.lab.say(self._unkept)
        self._show(items)

    def _show(self, items):
        self.lab.clear()
        self._items, poses = items, _at_hand(items)
        self._pictures = {
            pose: self._pictures.get(pose) or self._picture(pose) for pose in poses.values()
        }
        self.strip.items = [
            {"id": k, "name": k, "tip": k, "picture": self._pictures[s], "buttons": _BUTTONS}
            for k, s in poses.items()
        ]
        self.refresh()
        with quiet(self):
            for choice in (self.a, self.b):
                before = choice.value
                choice.options = list(poses)
                choice.value = before if before in poses else next(iter(poses), None)
        self._tell(len(items) - len(poses))

    def _picture(self, pose):
        V = self.session.vertices_in(pose)
        return base64.b64encode(self.lab.thumbnails.png(V, pose.gaze)).decode()

    def _tell(self, n_others):
        unread = "" if self._unread is None else f"Not read: {self._unread} "
        once = "" if self.path.exists() else " once you add a pose"
        kept = self._unkept or f"Kept in {self.path.name}{once}."
        left_out = f" {n_others} of another model are in it, too." if n_others else ""
        text = f"{unread}{kept}{left_out}"
        self._about.value = markup('<div class="facelab-status">{}</div>', text)

    def add(self, name=""):
        """Add the pose on screen to the library; one of the same name is replaced."""
        seen, items = self.poses, self._read()
        name = name or _free_name(items)
        if name in items and name not in seen:
            self._show(items)
            raise ValueError(
                f"{name} is in the library already, added elsewhere or with another model; write "
                "another name."
            )
        before, pose = items.get(name), self.lab.clip.on_screen().state
        self._chosen = name
        self._write({**items, name: pose})
        if before is not None and not before.same(pose):
            self.back.offer(name, (name, before, list(items).index(name)), replaced=True)

    def refresh(self):
        """Mark the pose of the library that is on screen; of several alike, the one clicked on."""
        now, names = self.session.state, list(self.poses)
        here = [name for name, pose in self.poses.items() if pose.same(now)]
        if self.lab.frame is not None and not self.lab.clip.over_pose:
            here = []
        name = self._chosen if self._chosen in here else next(iter(here), None)
        self.strip.chosen = names.index(name) if here else -1

    @shows_errors
    def _keep(self):
        self.add(self.name.value.strip())
        self.name.value = ""

    @shows_errors
    def _rename(self):
        name, chosen = self.name.value.strip(), self.strip.chosen
        if chosen < 0:
            raise ValueError("no pose is chosen; click on the one to rename first.")
        old = list(self.poses)[chosen]
        items = self._read(old)
        if not name or name in items:
            raise ValueError("the name is empty or taken; write another one first.")
        self._chosen = name
        self._write({name if k == old else k: pose for k, pose in items.items()})
        self.name.value = ""

    @shows_errors
    def _react(self, do, name):
        if do == "choose":
            self._chosen = name
            self.session.restore(self.poses[name])
            if not self.lab.clip.over_pose:
                self.lab.clip.halt()
                if self.lab.frame is not None:
                    self.lab.show_pose()
            self.refresh()
            return
        items = self._read(name)
        names = list(items)
        place = names.index(name)
        if do == "remove":
            gone = name, items[name], place
            self._write({k: pose for k, pose in items.items() if k != name})
            self.back.offer(name, gone)
            return
        shown = list(_at_hand(items))
        other = shown.index(name) + (1 if do == "later" else -1)
        if 0 <= other < len(shown):
            names.insert(names.index(shown[other]), names.pop(place))
        self._write({k: items[k] for k in names})

    @shows_errors
    def _put_back(self):
        name, pose, place = self.back.gone
        items = self._read()
        if self.back.replaced and name in items:
            self._write({**items, name: pose})
            self.back.offer(name, (name, items[name], place), replaced=True)
            return
        if name in items:
            raise ValueError(f"there is another {name} in the library now; rename that one first.")
        listed = list(items.items())
        listed.insert(place, (name, pose))
        self._write(dict(listed))
        self.back.forget()

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


def _at_hand(items):
    """Poses whose model is at hand."""
    return {name: pose for name, pose in items.items() if isinstance(pose, PoseState)}


def _in_place_of(path):
    """The file that takes the place of one that cannot be read."""
    return path.with_name(f"new-{path.name}")


def _joined(items, more):
    """All poses of two libraries; another pose of a name that is taken is numbered."""
    joined = dict(items)
    for name, pose in more.items():
        numbered = (f"{name} ({k})" for k in count(2))
        free = (n for n in chain([name], numbered) if _same(joined.get(n, pose), pose))
        joined.setdefault(next(free), pose)
    return joined


def _same(a, b):
    """Whether two items of a library, poses or as they are stored, are the same."""
    both = isinstance(a, PoseState) and isinstance(b, PoseState)
    return a.same(b) if both else a == b


def _free_name(items):
    return next(f"pose {k}" for k in range(1, len(items) + 2) if f"pose {k}" not in items)
