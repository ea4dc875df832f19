"""Landmarks of a face by clicking on it, by name."""

import ipywidgets as widgets
import numpy as np

from facelab.data.actors import load_template
from facelab.expression.landmarks import guess_landmarks
from facelab.files.landmarks import read_landmarks, write_landmarks
from facelab.geometry.alignment import procrustes
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.looks.eyes import ball_mesh
from facelab.numeric.undo import History
from facelab.widgets.lab import button, row
from facelab.widgets.own_face import shown_parts
from facelab.widgets.page import Page, markup, path_in, shows_errors, uploaded, written
from facelab.widgets.parts import ROOT, ItemList
from facelab.widgets.thumbnail import Thumbnails
from facelab.widgets.viewer import FaceView

SIX = (
    *("eye_right_outer", "eye_left_outer", "nose_tip"),
    *("mouth_corner_right", "mouth_corner_left", "chin"),
)
"""Landmarks that a fit can start from: not on one line, nor in one plane."""

_STILL = 300, 340  # pixels
_DOT, _YELLOW = 0.011, (1.0, 0.84, 0.0)  # of the height of the face
_FAR = 3.0  # times as far from where the others put it as is usual: worth a look
_USUAL = 4.0  # mm, at the least; faces differ


class LandmarkPicker(Page):
    """A page in which landmarks are set by clicking on a face.

    One name is asked for after the other; a click on a name in the list asks for that one again.
    Those set are held against the place where a face has them: exchanged sides, a wrong order and
    single ones far off are said at once.

    Parameters
    ----------
    mesh : TriangleMesh or BlendshapeRig
        The face, millimetres; landmarks that it has are there at the start. Of a rig, those that
        are missing can be guessed from its shapes by a button (`guess_landmarks`).
    names : sequence of str, optional
        Landmarks to set, of `MULTI_PIE`; the six that a fit needs if left out.
    props : iterable of Prop or (TriangleMesh, colors), optional
        What is shown beside it; for a rig its own parts, or eyes and teeth made for it, if left
        out.
    width, height : int
        Size of the canvas, pixels.
    folder : str or Path, default="."
        Where Save writes.

    Attributes
    ----------
    landmarks : dict of str to int
        Vertex of each landmark that is set.
    mesh : TriangleMesh
        The face with these landmarks.
    widget : ipywidgets.Widget
        The whole page; it shows itself as the last line of a cell.

    Raises
    ------
    TypeError, ValueError
        For what is no mesh, or a name that is no landmark.
    """

    def __init__(self, mesh, names=SIX, props=None, width=470, height=540, folder="."):
        self._rig = mesh if hasattr(mesh, "deltas") else None
        mesh = mesh if self._rig is None else self._rig.neutral
        if not isinstance(mesh, TriangleMesh):
            raise TypeError(f"mesh is a {type(mesh).__name__}; give a TriangleMesh or a rig.")
        names = tuple(names)
        odd = [name for name in names if name not in MULTI_PIE]
        if odd or not names or len(set(names)) < len(names):
            raise ValueError(
                f"names: {', '.join(map(repr, odd)) or 'none, or one twice'}; give names of "
                f"facelab.geometry.MULTI_PIE, such as {', '.join(SIX)}."
            )
        self.names, self.folder, self._face = names, folder, mesh
        own = {n: v for n, v in mesh.landmarks.items() if n in names}
        self.history = History(own, same=dict.__eq__)
        model = load_template(4375)
        self._typical = {n: model.vertices[v] for n, v in model.landmarks.items()}
        if props is None:
            props = () if self._rig is None else shown_parts(self._rig, self._rig.parts)
        self.view, self._props = FaceView(mesh, props, width, height), list(props)
        self.view.on_press = self._press
        self.list = ItemList("choice", self._react)
        self.map = widgets.HTML()
        self.undo = widgets.Button(description="Undo", layout={"width": "72px"})
        self.name = widgets.Text(value="landmarks", layout={"width": "150px"})
        self.save = widgets.Button(description="Save", layout={"width": "72px"})
        self.guess = button(
            "Guess", "Those that are missing, from how the rig's shapes move", self._guess
        )
        self.guess.disabled = self._rig is None
        self.upload = widgets.FileUpload(
            accept=".ljson,.pp,.json,.txt,.csv,.npy,.npz", description="Open",
            tooltip="Landmarks from a file", layout={"width": "auto"},
        )  # fmt: skip
        self.upload.observe(self._open, names="value")
        self._verdict, self._result = widgets.HTML(), widgets.HTML()
        self._build_messages()
        self.undo.on_click(self._undo)
        self.save.on_click(self._save)
        side = widgets.VBox(
            [
                self.map,
                self.list,
                row(self.undo, self.guess, self.upload, self.name, self.save),
                *(self._verdict, self._message, self._result),
            ]
        )
        left = widgets.VBox([self.view.widget, self._status])
        left.add_class("facelab-stage")
        side.add_class("facelab-side")
        self.widget = widgets.HBox([left, side])
        self.widget.add_class(ROOT)
        self.wanted = next((n for n in names if n not in own), names[0])
        self.refresh()

    @property
    def landmarks(self):
        """Vertex of each landmark that is set, by name."""
        return dict(self.history.state)

    @property
    def mesh(self):
        """The face with the landmarks that are set: TriangleMesh."""
        marks = {**self._face.landmarks, **self.landmarks}
        return TriangleMesh(self._face.vertices, self._face.faces, marks, self._face.texture)

    def picture(self):
        """The face with a dot on each landmark that is set: bytes of a PNG."""
        V = self._face.vertices
        radius = _DOT * np.ptp(V[:, 1])
        dot = ball_mesh(radius)[0]
        paint = np.tile(_YELLOW, (dot.n_vertices, 1))
        dots = [
            (dot.with_vertices(dot.vertices + V[vertex] + [0, 0, radius]), paint)
            for vertex in self.landmarks.values()
        ]
        return Thumbnails(self._face, [*self._props, *dots], *_STILL).png(V)

    def _settings_in_words(self):
        return (self.verdict(),)

    # --- what a hand does -------------------------------------------------------------------------

    def set(self, name, vertex):
        """Put a landmark on a vertex, and ask for the next that is missing."""
        self.history.make({**self.history.state, name: int(vertex)})
        missing = [n for n in self.names if n not in self.history.state]
        self.wanted = missing[0] if missing else name
        self.refresh()

    @shows_errors
    def _press(self, vertex):
        self.view.end_drag()
        self.clear()
        self.set(self.wanted, vertex)

    @shows_errors
    def _react(self, do, name):
        if do == "remove":
            self.history.make({n: v for n, v in self.history.state.items() if n != name})
        self.wanted = name
        self.refresh()

    @shows_errors
    def _undo(self, _):
        if self.history.can_undo:
            before = self.history.state
            self.history.undo()
            changed = [n for n in self.names if before.get(n) != self.history.state.get(n)]
            self.wanted = changed[0] if changed else self.wanted
        self.refresh()

    @shows_errors
    def _guess(self, _):
        self._take(guess_landmarks(self._rig))

    @shows_errors
    def _open(self, change):
        if change["new"]:
            with uploaded(self.upload) as path:
                self._take(read_landmarks(path, self._face))

    def _take(self, found):
        """Set what is missing of some landmarks, as one step."""
        new = {n: v for n, v in found.items() if n in self.names and n not in self.landmarks}
        self.clear()
        self.history.make({**self.history.state, **new})
        missing = [n for n in self.names if n not in self.history.state]
        self.wanted = missing[0] if missing else self.wanted
        self.refresh()

    @shows_errors
    def _save(self, _):
        self._result.value = ""
        path = path_in(self.folder, self.name.value, ".ljson")
        again = path.exists()
        write_landmarks(path, self.mesh.vertices, self.mesh.landmarks)
        self._result.value = written(path, again=again)

    # --- what is shown ----------------------------------------------------------------------------

    def refresh(self):
        """Show the landmarks as they are now."""
        marks, V = self.landmarks, self._face.vertices
        self.view.show_pins({vertex: V[vertex] for vertex in marks.values()}, takes=False)
        remove = [["remove", "✕", "Take it away", False]]
        self.list.items = [
            {
                "id": name,
                "name": name.replace("_", " "),
                "note": f"vertex {marks[name]}" if name in marks else "click on the face",
                "buttons": remove if name in marks else [],
            }
            for name in self.names
        ]
        self.list.chosen = self.names.index(self.wanted)
        self.undo.disabled = not self.history.can_undo
        self.map.value = self._drawn_map()
        self._verdict.value = markup('<div style="line-height:1.35">{}</div>', self.verdict())
        asked = self.wanted.replace("_", " ")
        self.say(
            f"Click on: {asked}. Left and right are the person's."
            if self.wanted not in marks
            else f"All are set. A click on the face moves: {asked}. Choose another in the list."
        )

    def verdict(self):
        """What is odd about the landmarks that are set, in words."""
        marks = [n for n in self.landmarks if n in self._typical]
        if len(marks) < 4:
            return f"{len(self.landmarks)} of {len(self.names)} set."
        there = self._face.vertices[[self.landmarks[n] for n in marks]]
        typical = np.array([self._typical[n] for n in marks])
        likeness = procrustes(typical, there, scale=True)
        if likeness.mirrored:
            return "Left and right are exchanged: they are the person's, not the viewer's."
        left = np.array(
            [
                np.linalg.norm(
                    procrustes(typical[keep], there[keep], scale=True).apply(typical[[k]])
                    - there[k]
                )
                for k, keep in enumerate(~np.eye(len(marks), dtype=bool))
            ]
        )
        usual = max(float(np.median(left)), _USUAL)
        far = [k for k in np.argsort(-left) if left[k] > _FAR * usual]
        if far:
            worst = marks[far[0]].replace("_", " ")
            return (
                f"{worst} lies {left[far[0]]:.0f} mm from where the others put it; "
                "look at its name and place."
            )
        return f"{len(self.landmarks)} of {len(self.names)} set; they agree with a face."

    def _on_top(self, dot):
        return dot[0] in self.names, dot[0] == self.wanted

    def _drawn_map(self):
        """The 68 landmarks on a face as a drawing, the one that is asked for marked."""
        P = np.array([self._typical[n][:2] for n in MULTI_PIE]) * [1, -1]
        low, size = P.min(axis=0) - 8, np.ptp(P, axis=0) + 16
        dots = []
        for name, (x, y) in sorted(zip(MULTI_PIE, P, strict=True), key=self._on_top):
            radius, color = 1.6, "#b9b4ad"
            if name in self.names:
                radius, color = 3.0, "#12406b" if name in self.landmarks else "#7d776f"
            if name == self.wanted:
                radius, color = 5.0, "#d95f02"
            dots.append(
                markup(
                    '<circle cx="{:.1f}" cy="{:.1f}" r="{}" fill="{}"><title>{}</title></circle>',
                    *(x, y, radius, color, name),
                )
            )
        box = " ".join(f"{x:.0f}" for x in (*low, *size))
        return markup(
            '<svg viewBox="{}" style="height:170px;width:100%">{}</svg>',
            *(box, markup("").join(dots)),
        )
