"""facelab train: takes become a model of a face that can be posed."""

from facelab import files
from facelab.cli.inputs import (
    MARKERS,
    WEIGHTS,
    Takes,
    add_marker_options,
    add_rig_options,
    face_beside,
)
from facelab.cli.terminal import watched
from facelab.models import HolisticModel, rms_error
from facelab.pipeline import model_from_take

EXAMPLE = """\
One file as output: all takes, of one person in one session, make one model. A folder as output: a
model for each take. Beside NAME.npz stands NAME.face.npz, the face that the model poses. Motions
make one model if they were registered with one --rest: each has its own neutral if not.

examples:
  facelab train takes -o models/actor.npz --components 20 --regions 13
  facelab train motion -o models --report models.json
  facelab train shots/*.csv --rig head.glb --noise 0.3 -o models/head.npz --holistic
"""
READS, WRITES = tuple(dict.fromkeys(MARKERS + WEIGHTS)), (".npz",)
TOGETHER = True


def add_options(parser):
    """Options of this command alone."""
    add_marker_options(parser)
    add_rig_options(parser)
    parser.add_argument("--holistic", action="store_true", help="one PCA for the whole face")
    parser.add_argument("--components", type=int, default=20, help="modes of each region")
    parser.add_argument("--control", type=int, default=397, help="vertices to solve for")
    parser.add_argument("--regions", type=int, metavar="N", help="found by the data if left out")
    parser.add_argument(
        "--noise", type=float, default=0.0, help="put on the motion, mm; 0.3 for one out of a rig"
    )
    parser.add_argument("--seed", type=int, default=0)


def written(target):
    """All files of a result: the model and its face."""
    return [target, face_beside(target)]


def maker(options):
    """What does one job."""
    takes = Takes(options)

    def make(job):
        read = [takes.read(path) for path in job.sources]
        face = model_from_take(
            read, takes.face(read), options.components, options.control, options.noise,
            random_state=options.seed, progress=watched(options), n_regions=options.regions,
        )  # fmt: skip
        model, X = face.model, face.motion.displacements()
        if options.holistic:
            model = HolisticModel(options.components, options.seed).fit(X)
        files.write_face(face_beside(job.target), face.neutral, face.binding)
        model.save(job.target)  # last: where it is, all is
        return {
            "takes": len(read),
            "frames": len(X),
            "lost_frames": face.motion.n_frames - len(X),
            "regions": 1 if options.holistic else face.regions.n_regions,
            "coefficients": model.n_coefficients,
            "rms_mm": rms_error(X, model.reconstruct(X)),
            "size_of_motion_mm": rms_error(X, 0 * X),
            "vertices": face.neutral.n_vertices,
            "control_vertices": len(face.samples),
            "binding_rms_mm": face.binding_error,
            "share_thrown_away": [r.share_rejected for r in face.registrations],
            "report": face.report,
        }

    return make
