"""facelab pose: poses and clips that were kept become meshes."""

from facelab import files
from facelab.cli.batch import UsageError
from facelab.cli.inputs import add_rig_options, path_of, read_model, read_rig, refuse_unused
from facelab.files.json_items import load_json
from facelab.posing import PosingSession
from facelab.storage import existing_file

EXAMPLE = """\
The poses must be of that very model and face: as they come from `facelab train`, or a rig.

examples:
  facelab pose smirk.json --model models/actor.npz -o smirk.obj
  facelab pose poses --model models/actor.npz -o meshes --to ply
  facelab pose clip.json --rig head.glb -o clip.glb
"""
READS, WRITES = (".json",), (".obj", ".ply", ".glb")
WRITERS = {".obj": files.write_obj, ".ply": files.write_ply, ".glb": files.write_glb}


def add_options(parser):
    """Options of this command alone."""
    parser.add_argument("--model", metavar="NPZ", help="from `facelab train`")
    add_rig_options(parser)


def maker(options):
    """What does one job."""
    if (options.model is None) == (options.rig is None):
        raise UsageError("give --model or --rig: the one that the poses were made with.")
    if options.model is None:
        rig = read_rig(options)
        parts = rig, rig.neutral, None
    else:
        refuse_unused(options, ("mesh", "scale"), "that is for a --rig, not for a --model.")
        parts = read_model(path_of(options.model))
    model, neutral, binding = parts

    def make(job):
        path, kind = job.sources[0], job.target.suffix.lower()
        session = PosingSession(model, neutral, binding=binding)
        held = load_json(existing_file(path, "pose file").read_bytes(), path, "pose file").value
        if held.get("format") == "facelab-clip":
            clip = files.load_clip(path, session)
            if kind != ".glb":
                raise ValueError(f"{path} is a clip, which only GLB holds; write it with --to glb.")
            files.write_clip_glb(job.target, clip, session)
            return {"keys": len(clip.times), "seconds_of_clip": float(clip.times[-1])}
        files.load_pose(path, session)
        WRITERS[kind](job.target, neutral.with_vertices(session.vertices))
        moved = ((session.vertices - neutral.vertices) ** 2).sum(axis=1) ** 0.5
        return {
            "vertices": neutral.n_vertices,
            "coefficients": model.n_coefficients,
            "largest_displacement_mm": float(moved.max()),
            "pins": len(session.state.pins),
        }

    return make
