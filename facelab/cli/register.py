"""facelab register: takes of markers become a mesh in motion."""

from facelab import files
from facelab.cli.inputs import MARKERS, Takes, add_marker_options
from facelab.cli.terminal import watched
from facelab.registration import register_sequence

EXAMPLE = """\
examples:
  facelab register session.c3d -o session.npz
  facelab register takes -o motion --rest takes/neutral.c3d --report motion.json
  facelab register takes -o glb --to glb --modes 40 --template face.obj --landmarks face.ljson
"""
READS, WRITES = MARKERS, (".npz", ".glb")


def add_options(parser):
    """Options of this command alone."""
    add_marker_options(parser)
    parser.add_argument(
        "--head", choices=("rigid", "whole"), default="rigid",
        help="how head motion is found: by what hardly moves, or by the whole face (Tena 4.1)",
    )  # fmt: skip
    parser.add_argument(
        "--control", type=int, metavar="N", help="only N vertices, spread evenly (397); all if not"
    )
    parser.add_argument(
        "--modes", type=int, default=30, help="targets of a GLB: strongest modes of the motion"
    )


def maker(options):
    """What does one job."""
    takes = Takes(options)

    def make(job):
        take = takes.markers(job.sources[0])
        fit = takes.fit([take])
        found = register_sequence(fit, take, head=options.head, progress=watched(options))
        if options.control is None:
            motion = found.motion()
        else:
            motion = found.motion(*fit.mesh.subsample(options.control))
        numbers = {
            "frames": motion.n_frames,
            "lost_frames": int((~found.valid).sum()),
            "rms_mm": found.rms,
            "share_thrown_away": found.share_rejected,
            "rms_thrown_away_mm": found.rms_rejected,
            "neutral_rms_mm": fit.rms,
            "markers": len(fit.names),
            "missing_markers": list(found.missing),
            "report": f"{take.report}\n{fit!r}\n{found.report}",
        }
        if job.target.suffix.lower() == ".glb":
            numbers["modes_rms_mm"] = files.write_motion_glb(job.target, motion, options.modes)
        else:
            files.write_motion(job.target, motion)
        return numbers

    return make
