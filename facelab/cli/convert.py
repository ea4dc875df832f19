"""facelab convert: one kind of file becomes another."""

from facelab import files
from facelab.cli.batch import UsageError
from facelab.cli.inputs import MARKERS, MESHES, RIGS, WEIGHTS, refuse_unused
from facelab.cli.pose import WRITERS

EXAMPLE = """\
What is read follows from what is written: a mesh for OBJ, PLY and GLB, weights for CSV, markers for
C3D, a rig for npz. With --rig a GLB keeps shapes. Motion (npz) becomes GLB.

examples:
  facelab convert scan.stl -o scan.ply
  facelab convert takes -o live --to csv --live-link
  facelab convert session.trc -o session.c3d --unit mm
  facelab convert shapes -o head.glb --rig
"""
READS = tuple(dict.fromkeys(MESHES + WEIGHTS + MARKERS))
WRITES = (".glb", ".obj", ".ply", ".csv", ".c3d", ".npz")
_USED = {".csv": ("fps", "live_link"), ".c3d": ("unit", "fps", "subject")}
_OF_SHAPES = ("mesh", "scale", "rig")


def reads(options):
    """Endings that can become what is asked for: of files in a folder."""
    ending = _ending(options)
    if ending == ".npz" or options.rig:
        return RIGS
    return {".csv": WEIGHTS, ".c3d": MARKERS, ".glb": (*MESHES, ".npz")}.get(ending, MESHES)


def single(options):
    """Whether a folder is one input: a rig as OBJ files."""
    return options.rig or _ending(options) == ".npz"


def _ending(options):
    if options.to:
        return f".{options.to}"
    ending = options.out.suffix.lower()
    return ending if ending in WRITES and not options.out.is_dir() else WRITES[0]


def add_options(parser):
    """Options of this command alone."""
    parser.add_argument("--rig", action="store_true", help="keep the shapes of a rig")
    parser.add_argument("--live-link", action="store_true", help="CSV as Live Link Face has it")
    parser.add_argument("--mesh", metavar="NAME", help="the part of a mesh or rig file")
    parser.add_argument("--scale", type=float, help="millimetres in the unit of the file")
    parser.add_argument("--unit", choices=("mm", "cm", "dm", "m", "in", "ft"), help="of markers")
    parser.add_argument("--fps", type=float, metavar="RATE", help="where the file says none")
    parser.add_argument("--subject", metavar="NAME", help="only markers of this subject")
    parser.add_argument("--modes", type=int, help="targets of a motion as GLB (30)")


def maker(options):
    """What does one job."""
    ending = _ending(options)
    if options.live_link and ending != ".csv":
        raise UsageError("--live-link is a kind of CSV; write that with --to csv, or -o NAME.csv.")
    used = _USED.get(ending, _OF_SHAPES)
    if ending == ".glb" and not options.rig:
        used += ("modes",)
    odd = {"modes", *_OF_SHAPES}.union(*_USED.values()).difference(used)
    why = f"of no use where the result is {ending[1:].upper()}; leave it out."
    refuse_unused(options, sorted(odd), why)

    def make(job):
        path, kind = job.sources[0], job.target.suffix.lower()
        if options.rig or kind == ".npz":
            return _rig(path, job.target, options)
        if kind == ".csv":
            return _weights(path, job.target, options)
        if kind == ".c3d":
            return _markers(path, job.target, options)
        if path.suffix.lower() == ".npz":
            return _of_npz(path, job.target, options)
        mesh = files.read_mesh(path, mesh=options.mesh, scale=options.scale)
        WRITERS[kind](job.target, mesh)
        return {"vertices": mesh.n_vertices, "triangles": len(mesh.faces)}

    return make


def _weights(path, target, options):
    take = files.read_weights(path, fps=options.fps)
    (files.write_live_link_csv if options.live_link else files.write_weights_csv)(target, take)
    return {
        "frames": take.n_frames,
        "lost_frames": int((~take.valid).sum()),
        "weights": len(take.names),
        "report": str(take.report),
    }


def _markers(path, target, options):
    take = files.read_markers(path, unit=options.unit, fps=options.fps, subject=options.subject)
    files.write_c3d(target, take)
    return {
        "frames": take.n_frames,
        "markers": len(take.names),
        "share_hidden": float(1 - take.visible.mean()) if take.visible.size else 0.0,
        "report": str(take.report),
    }


def _rig(path, target, options):
    rig = files.read_rig(path, mesh=options.mesh, scale=options.scale)
    kind = target.suffix.lower()
    if kind == ".npz":
        files.write_rig(target, rig)
    elif kind == ".glb":
        files.write_glb(target, rig.neutral, rig.deltas, rig.names)
    else:
        raise ValueError(f"{target}: a rig is written as npz or GLB; choose one of these endings.")
    return {"shapes": len(rig.names), "vertices": rig.neutral.n_vertices}


def _of_npz(path, target, options):
    kind = files.npz_kind(path)
    if kind != "motion" or target.suffix.lower() != ".glb":
        held = f"a {kind}" if kind else "arrays"
        raise ValueError(
            f"{path} holds {held}; a motion becomes GLB, a rig GLB or npz (with --rig), weights "
            "CSV, markers C3D."
        )
    if options.mesh is not None or options.scale is not None:
        raise ValueError(f"{path} is a motion, in millimetres; leave out --mesh and --scale.")
    motion = files.read_motion(path)
    rms = files.write_motion_glb(target, motion, 30 if options.modes is None else options.modes)
    return {"frames": motion.n_frames, "modes_rms_mm": rms}
