"""facelab translate: takes of one rig become takes of another."""

import numpy as np

from facelab import files
from facelab.cli.inputs import WEIGHTS, path_of
from facelab.expression import Translator
from facelab.expression.translate import NEAR

EXAMPLE = """\
Both rigs are GLB, VRM, npz, or a folder of OBJ files. Unless their triangles are the same, both
need landmarks: an npz keeps those of a rig.

examples:
  facelab translate take.csv --from arkit.npz --into head.npz -o head.csv
  facelab translate takes --from arkit.npz --into head.npz -o head --report head.json
"""
READS, WRITES = WEIGHTS, (".csv",)


def add_options(parser):
    """Options of this command alone."""
    parser.add_argument("--from", dest="source", required=True, metavar="RIG", help="of the takes")
    parser.add_argument("--into", required=True, metavar="RIG", help="whose shapes are wanted")
    parser.add_argument("--fps", type=float, metavar="RATE", help="where the file says none")
    parser.add_argument("--lam", type=float, default=0.07, help="mm: more leaves fewer shapes")
    parser.add_argument("--smooth", type=float, default=0.004, help="millimetre seconds")
    parser.add_argument(
        "--near", type=float, default=NEAR, help="0 to 1: nearness against the same shapes"
    )


def maker(options):
    """What does one job."""
    pair = Translator(*(files.read_rig(path_of(rig)) for rig in (options.source, options.into)))

    def make(job):
        take = files.read_weights(job.sources[0], fps=options.fps)
        made = pair.translate(take, options.lam, options.smooth, options.near)
        files.write_weights_csv(job.target, made)
        said, known = made.report, made.valid
        return {
            "frames": made.n_frames,
            "lost_frames": int((~known).sum()),
            "rms_mm": float(np.sqrt((said.errors[known] ** 2).mean())),
            "largest_mm": float(said.errors[known].max()),
            "size_of_motion_mm": float(np.sqrt((said.sizes[known] ** 2).mean())),
            "share_compared": said.compared,
            "active_shapes": said.active,
            "cannot_be_made": list(said.cannot),
            "report": str(said),
        }

    return make
