"""facelab read-units: sketched faces, or a mesh in motion, become weights of a rig's units."""

import numpy as np

from facelab import files
from facelab.cli.batch import UsageError
from facelab.cli.inputs import MESHES, add_rig_options, read_rig
from facelab.expression import (
    find_units,
    prepare_units,
    regress_expression,
    regress_sequence,
)
from facelab.motion import WeightSequence

EXAMPLE = """\
A sketch is a mesh with the rig's vertices in their order; a motion comes from `facelab register`.
Of a sketch the few units are read that its own roughness could not feign; --all takes every unit
that makes it match better. Of a motion all units are read, frame after frame.

examples:
  facelab read-units smile.obj --rig head.glb -o smile.csv
  facelab read-units sketches --rig shapes -o weights --align --report weights.json
  facelab read-units take.npz --rig face.npz -o take.csv --smooth 0.004
"""
READS, WRITES = (*MESHES, ".npz"), (".csv",)


def add_options(parser):
    """Options of this command alone."""
    add_rig_options(parser, required=True)
    parser.add_argument(
        "--sketch-scale", type=float, metavar="MM", help="millimetres in the sketches' unit"
    )
    parser.add_argument("--align", action="store_true", help="take rigid motion out of sketches")
    parser.add_argument(
        "--free", action="store_true", help="weights beyond 0 to 1, which are the bounds if not"
    )
    parser.add_argument("--all", action="store_true", help="of a sketch too, all units")
    parser.add_argument(
        "--lam", type=float, default=0.0, help="λ of Eq. 9, mm: weight of --alpha, over all units"
    )
    parser.add_argument("--alpha", type=float, default=0.0, help="wanted sum of the weights")
    parser.add_argument("--smooth", type=float, default=0.004, help="of motion, millimetre seconds")


def maker(options):
    """What does one job."""
    if options.alpha and not options.lam:
        raise UsageError("--alpha is weighed by --lam, which is 0: give that too.")
    rig = read_rig(options)
    basis = prepare_units(rig)
    bounds = None if options.free else (0, 1)

    def make(job):
        path = job.sources[0]
        if path.suffix.lower() == ".npz":
            if options.align or options.sketch_scale is not None:
                raise ValueError(
                    f"{path} is a motion, but --align and --sketch-scale are for sketches; read it "
                    "without them."
                )
            motion = files.read_motion(path)
            take = regress_sequence(
                basis, motion, options.lam, options.alpha, bounds, options.smooth
            )
            rms = _rms(rig, motion, take.weights)
        else:
            scale = _scale(path, rig) if options.sketch_scale is None else options.sketch_scale
            sketch = _on_rig(files.read_mesh(path, scale=scale), rig, path)
            weights, rms = _of_sketch(basis, sketch, bounds, options)
            take = WeightSequence(weights[None], rig.names, 1.0)
        files.write_weights_csv(job.target, take)
        strongest = np.abs(take.weights).max(axis=0)
        used = {n: w for n, w in zip(rig.names, strongest.tolist(), strict=True) if w > 0.05}
        return {
            "frames": take.n_frames,
            "rms_mm": float(rms),
            "units_used": len(used),
            "units": used,
            "units_left_out": list(basis.dropped),
        }

    return make


def _of_sketch(basis, sketch, bounds, options):
    """Weights of one sketch, and its distance from what they make, RMS, millimetres."""
    align = True if options.align else "check"
    if options.all or options.lam:
        fit = regress_expression(basis, sketch, options.lam, [options.alpha], bounds, align=align)
        return fit.weights[0], fit.rms[0]
    found = find_units(basis, sketch, bounds, align=align)
    return found.weights, found.rms


def _scale(path, rig):
    """That of the rig where both are OBJ files, which do not say theirs."""
    source = "" if rig.source is None else rig.source.path
    both = path.suffix.lower() == ".obj" and source.lower().endswith(".obj")
    return rig.source.scale if both else None


def _on_rig(mesh, rig, path):
    """The vertices of a sketch in the rig's order, in which the two sides of a seam are one."""
    n = rig.neutral.n_vertices
    index = None if rig.source is None else rig.source.index
    if mesh.n_vertices == n:
        return mesh.vertices
    if index is not None and mesh.n_vertices == len(index):
        vertices = np.zeros((n, 3))
        vertices[index] = mesh.vertices
        return vertices
    raise ValueError(
        f"{path} has {mesh.n_vertices} vertices, but the rig has {n}; export the sketch from the "
        "rig's own mesh, all vertices in their order."
    )


def _rms(rig, motion, W, block=64):
    """Distance of the valid frames from what the weights make, RMS, millimetres."""
    flat, total = rig.basis.reshape(len(rig.names), -1), 0.0
    valid = np.flatnonzero(motion.valid)
    for some in (valid[i : i + block] for i in range(0, len(valid), block)):
        X = motion.positions[some] - rig.neutral.vertices
        total += ((X.reshape(len(some), -1) - W[some] @ flat) ** 2).sum()
    return np.sqrt(total / (len(valid) * rig.neutral.n_vertices))
