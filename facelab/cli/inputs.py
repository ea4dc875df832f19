"""What commands read: takes of any kind, faces, models, and the options that say how."""

from pathlib import Path

from facelab import files
from facelab.cli.batch import UsageError
from facelab.cli.terminal import watched
from facelab.data import load_template
from facelab.files.markers import KINDS as MARKERS
from facelab.files.meshes import KINDS as MESHES
from facelab.files.rigs import KINDS as RIGS
from facelab.models import load_model
from facelab.motion import MarkerSequence, MotionSequence
from facelab.registration import PRESETS, fit_markers, register_sequence, rest_markers

WEIGHTS = (".csv", ".tsv", ".txt", ".json", ".jsonl", ".ndjson", ".npz")

__all__ = ["MARKERS", "MESHES", "RIGS", "WEIGHTS"]


# --- options --------------------------------------------------------------------------------------


def add_marker_options(parser):
    """How files of markers are read, and the template that they are fitted with."""
    group = parser.add_argument_group("takes of markers")
    group.add_argument("--unit", choices=("mm", "cm", "dm", "m", "in", "ft"))
    group.add_argument("--fps", type=float, metavar="RATE", help="where the file says none")
    group.add_argument("--subject", metavar="NAME", help="only markers of this subject")
    group.add_argument("--template", metavar="MESH", help="face to fit; a synthetic one if not")
    group.add_argument(
        "--landmarks", metavar="FILE", help="of the template: .ljson, .pp, or a list of vertices"
    )
    group.add_argument(
        "--rest", metavar="TAKE", help="that begins with the face at rest; each its own if not"
    )
    group.add_argument("--preset", choices=tuple(PRESETS), default="balanced")
    group.add_argument("--offset", type=float, default=1.5, help="of markers over the skin, mm")


def add_rig_options(parser, required=False):
    """The rig that weights drive."""
    parser.add_argument(
        "--rig", required=required, metavar="FILE", help="GLB, VRM, npz, or a folder of OBJ files"
    )
    parser.add_argument("--mesh", metavar="NAME", help="the part of the rig's file")
    parser.add_argument("--scale", type=float, help="millimetres in the unit of the rig's file")


# --- reading --------------------------------------------------------------------------------------


def refuse_unused(options, names, why):
    """Refuse options that are given where they would change nothing; `why` says so."""
    given = [n for n in names if not any(getattr(options, n) is v for v in (None, False))]
    if given:
        said = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UsageError(f"{said}: {why}")


class Takes:
    """Reads takes as options say, and knows the face that goes with them."""

    def __init__(self, options):
        self.options = options
        if getattr(options, "rig", None) and options.template:
            raise UsageError("--rig is for weights and --template for markers; give one of them.")
        if options.landmarks and not options.template:
            raise UsageError("--landmarks names vertices of a --template: give that too.")
        if getattr(options, "rig", None):
            how = ("unit", "subject", "rest")
            refuse_unused(options, how, "that is for takes of markers, but --rig is for weights.")
        elif hasattr(options, "rig"):
            refuse_unused(options, ("mesh", "scale"), "that is for a --rig: give that too.")
        self.rig = read_rig(options) if getattr(options, "rig", None) else None
        self.template = self._read_template() if options.template else None
        self._rest = path_of(options.rest) if options.rest else None
        self._fit = None

    def read(self, path):
        """A take: weights where there is a rig, else motion (our npz) or markers."""
        o = self.options
        if self.rig is not None:
            return files.read_weights(path, fps=o.fps)
        if path.suffix.lower() == ".npz" and files.npz_kind(path):
            return files.read_motion(path)
        return files.read_markers(path, unit=o.unit, fps=o.fps, subject=o.subject)

    def markers(self, path):
        """A take that must be one of markers."""
        take = self.read(path)
        if not isinstance(take, MarkerSequence):
            raise ValueError(f"{path} is a motion, registered already; give takes of markers.")
        return take

    def face(self, takes):
        """What `model_from_take` asks for beside these takes."""
        if self.rig is not None:
            return self.rig
        if isinstance(takes[0], MotionSequence):
            return None
        return self.fit(takes)

    def fit(self, takes):
        """The template fitted to the face at rest: of --rest once for all, else of these takes."""
        o = self.options
        if self._fit is not None:
            return self._fit
        if self.template is None:
            self.template = load_template()
        resting = takes if self._rest is None else [self.markers(self._rest)]
        fit = fit_markers(self.template, *rest_markers(resting), offset=o.offset, preset=o.preset)
        if self._rest is not None:
            self._fit = fit
        return fit

    def _read_template(self):
        o = self.options
        if o.landmarks is None:
            raise UsageError(
                f"--template {o.template}: the fit starts from landmarks; give --landmarks too."
            )
        mesh = files.read_mesh(path_of(o.template))
        marks = files.read_landmarks(path_of(o.landmarks), mesh)
        return type(mesh)(mesh.vertices, mesh.faces, marks)

    def control(self, path, n_control):
        """A take on few vertices, the face that they are of, and which: motion, mesh, samples."""
        take = self.read(path)
        if self.rig is not None:
            neutral = self.rig.neutral
        elif isinstance(take, MotionSequence):
            neutral = take.mesh
        else:
            fit = self.fit([take])
            shown = watched(self.options)
            neutral, take = fit.mesh, register_sequence(fit, take, progress=shown)
        if neutral.n_vertices <= n_control:
            samples, control = list(range(neutral.n_vertices)), neutral
        else:
            samples, control = neutral.subsample(n_control)
        if self.rig is not None:
            motion = self.rig.on(samples, control).animate(take)
        elif isinstance(take, MotionSequence):
            motion = MotionSequence(take.positions[:, samples], take.fps, control, take.valid)
        else:
            motion = take.motion(samples, control)
        return motion, neutral, samples


def path_of(text):
    """The path of an option as a Path, refused if nothing is there."""
    path = Path(text)
    if not text or not path.exists():
        raise UsageError(f"{text or 'a file without a name'} is not there.")
    return path


def read_rig(options):
    """The rig of the options."""
    return files.read_rig(path_of(options.rig), mesh=options.mesh, scale=options.scale)


def face_beside(path):
    """Where `facelab train` puts the face of a model: `smile.npz` has `smile.face.npz`."""
    return path.with_name(f"{path.stem}.face.npz")


def read_model(path):
    """A model from `facelab train`, the face that it poses and how that follows."""
    model = load_model(path)
    beside = face_beside(path)
    if beside.is_file():
        return model, *files.read_face(beside)
    if model.mesh is None:
        raise ValueError(
            f"{path} does not say which face it poses, and {beside.name} is not beside it; train "
            "the model again, or bring that file along."
        )
    return model, model.mesh, None
