"""Poses, clips and meshes of the posing lab as files."""

import warnings
from pathlib import Path

import ipywidgets as widgets

from facelab.files.gltf import write_clip_glb, write_glb
from facelab.files.obj import write_obj
from facelab.files.ply import write_ply
from facelab.files.poses import load_clip, load_pose, save_clip, save_pose
from facelab.files.takes import write_live_link_csv
from facelab.looks import turn_eyes
from facelab.motion import WeightSequence
from facelab.widgets import last_pose
from facelab.widgets.lab import WIDTH, Panel, row
from facelab.widgets.page import markup, path_in, shows_errors, uploaded, written
from facelab.widgets.posing_clips import OTHER_MODEL
from facelab.widgets.posing_library import ENDING

_NO_POSES = ENDING, last_pose.ENDING
_FPS = 30.0  # of a clip as weights


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
        self.live_link, self.clip_live_link = self._button("Live Link"), self._button("Live Link")
        for each in (self.live_link, self.clip_live_link):
            each.layout.width = "82px"
            each.tooltip = "The rig's weights under ARKit's names, as Live Link Face records them"
        self.with_props = widgets.Checkbox(
            True,
            description="eyes and teeth",
            indent=False,
            tooltip="GLB files hold them as meshes of their own",
            layout={"width": "auto"},
        )
        rows = {
            "pose": [self.save, self.load, self.live_link],
            "mesh": [self.obj, self.ply, self.glb, self.with_props],
            "clip": [self.save_clip, self.load_clip, self.clip_glb, self.clip_live_link],
        }
        self._result = widgets.HTML()
        self.widget = widgets.VBox(
            [
                self.name,
                *(
                    row(widgets.Label(text, layout={"width": "40px"}), *buttons)
                    for text, buttons in rows.items()
                ),
                row(self.upload, self.open_rig),
                self._result,
            ]
        )
        self.upload.observe(self._open, names="value")
        self.open_rig.observe(self._open_rig, names="value")
        self._list_files()

    def _button(self, text):
        button = widgets.Button(description=text, layout={"width": "62px"})
        button.on_click(self._press)
        return button

    def _list_files(self):
        found = [p.name for p in Path(self.lab.folder).glob("*.json")]
        shown = [n for n in found if not n.startswith(".") and not n.endswith(_NO_POSES)]
        names = {name.removesuffix(".json").removesuffix(".clip") for name in shown}
        self.name.options = sorted(names)[:200]

    def _path(self, ending):
        return path_in(self.lab.folder, self.name.value, ending)

    @shows_errors
    def _press(self, button):
        self._result.value = ""
        self.lab.clear()
        session, clip = self.session, self.lab.clip
        shown = session if button in (self.load, self.load_clip) else clip.on_screen()
        posed = session.neutral.with_vertices(shown.vertices)
        props = self.lab.props if self.with_props.value else ()
        turned = turn_eyes(props, shown.state.gaze)
        write = {
            self.save: (".json", lambda path: save_pose(path, shown)),
            self.obj: (".obj", lambda path: write_obj(path, posed)),
            self.ply: (".ply", lambda path: write_ply(path, posed)),
            self.glb: (".glb", lambda path: write_glb(path, posed, props=turned)),
            self.save_clip: (".clip.json", lambda path: save_clip(path, self._clip(), session)),
            self.clip_glb: (
                ".clip.glb",
                lambda path: write_clip_glb(path, self._clip(), session, props),
            ),
            self.live_link: (".livelink.csv", lambda path: self._weights(path, shown)),
            self.clip_live_link: (
                ".clip.livelink.csv",
                lambda path: self._weights(path),
            ),
        }
        if button in write:
            ending, do = write[button]
            path = self._path(ending)
            again = path.exists()
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                do(path)
            self._result.value = written(path, " ".join(str(w.message) for w in said), again)
            self._list_files()
        elif button is self.load:
            path = self._path(".json")
            load_pose(path, session)
            self._result.value = markup("Loaded <b>{}</b>.", path.name)
        else:
            path = self._path(".clip.json")
            clip.exchange(load_clip(path, session), "the key poses")
            self._result.value = markup("Loaded <b>{}</b>: see the tab Time.", path.name)

    def _weights(self, path, shown=None):
        """Write the weights of the clip, or of what is shown, as Live Link Face records them."""
        session = self.session
        if not session.model.named:
            raise ValueError("only a rig has weights; choose the rig among the models above first.")
        weights = shown.coefficients[None] if shown else self._clip().sample(_FPS)[1]
        write_live_link_csv(path, WeightSequence(weights, session.model.names, _FPS))

    def _clip(self):
        if self.lab.clip.clip is None:
            raise ValueError("there is no clip yet; set key poses in the tab Time first.")
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
