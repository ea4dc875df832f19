"""Poses to keep in the posing lab: a strip of pictures, and files."""

import base64
from pathlib import Path

import ipywidgets as widgets

from facelab.files.gltf import write_clip_glb, write_glb
from facelab.files.obj import write_obj
from facelab.files.ply import write_ply
from facelab.files.poses import load_clip, load_pose, save_clip, save_pose
from facelab.posing.clips import interpolate
from facelab.widgets.page import markup, path_in, quiet, shows_errors, uploaded, written
from facelab.widgets.parts import ItemList
from facelab.widgets.posing_clips import OTHER_MODEL
from facelab.widgets.posing_panels import WIDTH, Panel

_STEP = 0.01


class StripPanel(Panel):
    """Poses as pictures; between two of them one can blend.

    Attributes
    ----------
    poses : dict of str to PoseState
        By name, in the order of the strip.
    """

    def _build(self):
        self.poses, self._pictures = {}, {}
        self.strip = ItemList("strip", self._react)
        self.name = widgets.Text(placeholder="name", layout={"width": "150px"})
        self.keep = widgets.Button(
            description="Add this pose",
            tooltip="Add the pose to the strip",
            layout={"width": "auto"},
        )
        self.a, self.b = (
            widgets.Dropdown(description=text, layout={"width": "164px"}) for text in ("from", "to")
        )
        self.share = widgets.FloatSlider(
            min=0, max=1, step=_STEP, description="blend", layout={"width": WIDTH}
        )
        for control in (self.a, self.b, self.share):
            control.style.description_width = "40px"
        self.widget = widgets.VBox(
            [
                widgets.HBox([self.name, self.keep]),
                self.strip,
                widgets.HBox([self.a, self.b]),
                self.share,
            ]
        )
        self.add("neutral")
        self.keep.on_click(lambda _: self._keep())
        self.share.observe(self._blend, names="value")

    def add(self, name=""):
        """Add the pose on screen to the strip; one of the same name is replaced."""
        name = name or self._free_name()
        self.poses[name] = self.session.state
        picture = self.lab.thumbnails.png(self.session.vertices)
        self._pictures[name] = base64.b64encode(picture).decode()
        self._draw()

    def _free_name(self):
        return next(
            f"pose {k}" for k in range(1, len(self.poses) + 2) if f"pose {k}" not in self.poses
        )

    def _draw(self):
        remove = [["remove", "✕", "Take it off the strip", False]]
        self.strip.items = [
            {"id": name, "name": name, "tip": name, "picture": picture, "buttons": remove}
            for name, picture in self._pictures.items()
        ]
        with quiet(self):
            for choice in (self.a, self.b):
                before = choice.value
                choice.options = list(self.poses)
                choice.value = before if before in self.poses else next(iter(self.poses), None)

    @shows_errors
    def _keep(self):
        self.add(self.name.value.strip())
        self.name.value = ""

    @shows_errors
    def _react(self, do, name):
        if do == "choose":
            self.session.restore(self.poses[name])
        else:
            del self.poses[name], self._pictures[name]
            self._draw()

    @shows_errors
    def _blend(self, change):
        if self.settling:
            return
        if not self.poses:
            raise ValueError("the strip is empty; add the poses to blend first.")
        a, b = self.poses[self.a.value], self.poses[self.b.value]
        with self.session.group("blend"):
            self.session.use(a.model)
            self.session.apply(interpolate(a, b, change["new"]))


class FilePanel(Panel):
    """Poses, clips and meshes as files, in a folder beside the notebook and to download."""

    def _build(self):
        self.name = widgets.Combobox(
            value="pose", description="name", ensure_option=False, layout={"width": WIDTH}
        )
        self.name.style.description_width = "56px"
        self.save, self.load = self._button("Save"), self._button("Load")
        self.obj, self.ply, self.glb = (self._button(text) for text in ("OBJ", "PLY", "GLB"))
        self.save_clip, self.load_clip = self._button("Save"), self._button("Load")
        self.clip_glb = self._button("GLB")
        self.upload = widgets.FileUpload(
            accept=".json", description="Open a pose file", layout={"width": "auto"}
        )
        self.open_rig = widgets.FileUpload(
            accept=".glb,.gltf,.vrm,.npz",
            description="Open a rig",
            tooltip="Pose your own head: a GLB, VRM or glTF with shapes",
            layout={"width": "auto"},
        )
        rows = {
            "pose": [self.save, self.load],
            "mesh": [self.obj, self.ply, self.glb],
            "clip": [self.save_clip, self.load_clip, self.clip_glb],
        }
        self._result = widgets.HTML()
        self.widget = widgets.VBox(
            [
                self.name,
                *(
                    widgets.HBox([widgets.Label(text, layout={"width": "56px"}), *buttons])
                    for text, buttons in rows.items()
                ),
                widgets.HBox([self.upload, self.open_rig]),
                self._result,
            ]
        )
        self.upload.observe(self._open, names="value")
        self.open_rig.observe(self._open_rig, names="value")
        self._list_files()

    def _button(self, text):
        button = widgets.Button(description=text, layout={"width": "72px"})
        button.on_click(self._press)
        return button

    def _list_files(self):
        found = [p.name for p in Path(self.lab.folder).glob("*.json")]
        shown = [name for name in found if not name.startswith(".")]  # the rest is unfinished
        names = {name.removesuffix(".json").removesuffix(".clip") for name in shown}
        self.name.options = sorted(names)[:200]

    def _path(self, ending):
        return path_in(self.lab.folder, self.name.value, ending)

    @shows_errors
    def _press(self, button):
        session, clip = self.session, self.lab.clip
        posed = session.neutral.with_vertices(session.vertices)
        write = {
            self.save: (".json", lambda path: save_pose(path, session)),
            self.obj: (".obj", lambda path: write_obj(path, posed)),
            self.ply: (".ply", lambda path: write_ply(path, posed)),
            self.glb: (".glb", lambda path: write_glb(path, posed)),
            self.save_clip: (".clip.json", lambda path: save_clip(path, self._clip(), session)),
            self.clip_glb: (".clip.glb", lambda path: write_clip_glb(path, self._clip(), session)),
        }
        if button in write:
            ending, do = write[button]
            path = self._path(ending)
            do(path)
            self._result.value = written(path)
            self._list_files()
        elif button is self.load:
            path = self._path(".json")
            load_pose(path, session)
            self._result.value = markup("Loaded <b>{}</b>.", path.name)
        else:
            path = self._path(".clip.json")
            clip.set_clip(load_clip(path, session))
            self._result.value = markup("Loaded <b>{}</b>: see the tab Clip.", path.name)

    def _clip(self):
        if self.lab.clip.clip is None:
            raise ValueError("there is no clip yet; set key poses in the tab Clip first.")
        if self.lab.clip.model is not self.session.model:
            raise ValueError(OTHER_MODEL)
        return self.lab.clip.clip

    @shows_errors
    def _open_rig(self, change):
        if not change["new"]:
            return
        self.lab.say("Reading the rig, and learning how it moves ...")
        with uploaded(self.open_rig) as path:
            self.lab.become(path)

    @shows_errors
    def _open(self, change):
        if not change["new"]:
            return
        with uploaded(self.upload) as path:
            load_pose(path, self.session)
        self._result.value = markup("Loaded <b>{}</b>.", path.name)
