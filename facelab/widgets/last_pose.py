"""The pose of last time: kept at each step that is made in the page, offered when it opens anew."""

import itertools
from datetime import datetime
from pathlib import Path

from IPython import get_ipython

from facelab.files.poses import is_of_another_face, load_library, save_library
from facelab.posing.fingerprint import fingerprint
from facelab.widgets.lab import Panel, button
from facelab.widgets.page import shows_errors

ENDING = ".last.json"
_NAME = "last"


class LastPose(Panel):
    """Keeps the pose in a file of the lab's folder, and has a button for the one found there.

    Only what a person does in the page is kept; a script can be run again.

    Attributes
    ----------
    path : Path
        The file, one for each face and the models at hand: what others cannot take up is theirs.
    state : PoseState or None
        What was found when the lab opened; it stays at hand when the file has another one.
    widgets : list
        The button, if there is a pose to go back to.
    """

    def _build(self):
        self.state, when = None, ""
        for path in files_of_face(self.lab, ENDING):
            self.path = path
            if not path.exists():
                break
            try:
                poses, _ = load_library(path, self.session, self.lab.models)
            except (OSError, ValueError):
                continue  # damaged
            if _NAME in poses:  # not if it is of another model
                self.state = poses[_NAME]
                when = datetime.fromtimestamp(self.path.stat().st_mtime).strftime("%d %b, %H:%M")
                break
        tip = "The pose that this face had when it was last posed in a page"
        found = self.state is not None and not self.state.same(self.session.state)
        self.widgets = [button(f"Back to the pose of {when}", tip, self._back)] * found

    def keep(self):
        """Keep the present pose, if it is the page that made it."""
        if asked_by_page():
            try:
                save_library(self.path, {_NAME: self.session.state}, self.session)
            except (OSError, ValueError) as error:
                why = self.lab.in_words(error)
                self.lab.say(f"This pose will not come back by itself: {why}")

    @shows_errors
    def _back(self, _):
        self.session.restore(self.state)
        self.widgets[0].layout.display = "none"


def files_of_face(lab, ending):
    """Paths in the folder of a lab, without end, that are not of another face: generator."""
    faces = fingerprint(lab.mesh)["sizes"][-1]
    for k in itertools.count(1):
        path = Path(lab.folder) / f"face-{faces[:6]}{f'-{k}' * (k > 1)}{ending}"
        if not is_of_another_face(path, lab.session):  # with the same triangles
            yield path


def asked_by_page():
    """Whether a widget of a page asks for what is being done, and not a cell or a script."""
    kernel = getattr(get_ipython(), "kernel", None)
    header = {} if kernel is None else kernel.get_parent().get("header", {})
    return header.get("msg_type") == "comm_msg"
