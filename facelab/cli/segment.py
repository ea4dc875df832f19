"""facelab segment: the face of a take cut into regions by how it moves."""

import json

from facelab import files
from facelab.cli.inputs import MARKERS, WEIGHTS, Takes, add_marker_options, add_rig_options
from facelab.cli.terminal import watched
from facelab.segmentation import segment_face
from facelab.storage import atomic_path, save_npz

EXAMPLE = """\
Beside the labels NAME.npz or NAME.json stands NAME.ply, the face coloured by region.

examples:
  facelab segment session.c3d -o regions.json
  facelab segment motion -o regions --regions 13
  facelab segment shot.csv --rig head.glb --noise 0.3 -o regions.npz
"""
READS, WRITES = tuple(dict.fromkeys(MARKERS + WEIGHTS)), (".npz", ".json")


def add_options(parser):
    """Options of this command alone."""
    add_marker_options(parser)
    add_rig_options(parser)
    parser.add_argument("--regions", type=int, metavar="N", help="found by the data if left out")
    parser.add_argument("--control", type=int, default=397, help="vertices that are cut")
    parser.add_argument("--rate", type=float, default=15.0, help="frames a second that decide")
    parser.add_argument("--noise", type=float, default=0.0, help="put on the motion, mm")
    parser.add_argument("--lam", type=float, default=0.7, help="λ: correlation against distance")
    parser.add_argument("--r", type=float, default=10.0, help="scale of distance, mm")
    parser.add_argument("--threshold", type=float, default=0.7, help="on the correlation")
    parser.add_argument("--seed", type=int, default=0)


def written(target):
    """All files of a result: the labels and the face in their colours."""
    return [target, target.with_suffix(".ply")]


def maker(options):
    """What does one job."""
    takes = Takes(options)

    def make(job):
        picture = written(job.target)[1]
        if picture.exists() and not job.target.exists() and not options.again:
            raise ValueError(
                f"{picture} is there and would be overwritten by the face in its colours; give "
                "the result another name, or --again."
            )
        motion, neutral, samples = takes.control(job.sources[0], options.control)
        if options.noise:
            motion = motion.with_noise(options.noise, options.seed)
        cut = segment_face(
            motion.resampled(min(options.rate, motion.fps)), options.lam, options.r,
            options.threshold, n_regions=options.regions, random_state=options.seed,
            progress=watched(options),
        )  # fmt: skip
        whole = cut if motion.mesh is neutral else cut.carried_to(neutral, samples)
        _draw(picture, whole)
        if job.target.suffix.lower() == ".json":
            _write_json(job.target, whole, cut.why)
        else:
            save_npz(job.target, "regions", 1, **whole.packed())
        return {
            "regions": whole.n_regions,
            "vertices": neutral.n_vertices,
            "control_vertices": len(samples),
            "lost_frames": int((~motion.valid).sum()),
            "shared_share": whole.shared_share,
            "why": cut.why,
        }

    return make


def _draw(path, regions):
    from facelab.plotting import region_colors  # matplotlib, a second to load

    files.write_ply(path, regions.mesh, region_colors(regions)[regions.labels])


def _write_json(path, regions, why):
    held = {
        "format": "facelab-regions",
        "version": 1,
        "n_regions": regions.n_regions,
        "why": why,
        "labels": regions.labels.tolist(),
        "members": [m.tolist() for m in regions.members],
    }
    with atomic_path(path) as part:
        part.write_text(json.dumps(held, allow_nan=False) + "\n")
