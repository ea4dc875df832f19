"""What tells a model or mesh from others."""

import hashlib

import numpy as np

from facelab.geometry.mesh import TriangleMesh

_PROBES = 4  # random projections in a fingerprint


_CLOSE = 1e-6  # of their size: the same training on another machine differs by rounding


def fingerprint(thing):
    """What tells a model or mesh from others, as a small dict for JSON.

    Sizes, and a few random projections of all its numbers, to be compared with a tolerance: a
    model trained again on the same data is the same, though its last bits differ.

    Parameters
    ----------
    thing : FaceModel or TriangleMesh
    """
    if isinstance(thing, TriangleMesh):
        faces = hashlib.sha256(np.ascontiguousarray(thing.faces, dtype="<i8")).hexdigest()[:16]
        return _print("mesh", [thing.n_vertices, len(thing.faces), faces], [thing.vertices])
    return _print(*thing.fingerprint_parts())


def _print(kind, sizes, arrays):
    rng = np.random.default_rng(0)
    probes = np.zeros(_PROBES)
    scale = 0.0
    for array in arrays:
        x = np.ravel(array).astype(float)
        probes += rng.standard_normal((_PROBES, x.size)) @ x
        scale += x @ x
    return {"kind": kind, "sizes": sizes, "scale": float(np.sqrt(scale)), "probes": probes.tolist()}


def differs(stored, own):
    """What differs between two fingerprints, in words; empty if nothing does."""
    if stored["kind"] != own["kind"]:
        return f"it is of a {stored['kind']}, not of a {own['kind']}"
    if stored["sizes"] != own["sizes"]:
        return f"its sizes or names are {_short(stored['sizes'])}, not {_short(own['sizes'])}"
    off = np.abs(np.subtract(stored["probes"], own["probes"])).max()
    return "its numbers are others" if off > _CLOSE * own["scale"] else ""


def _short(sizes):
    shown = ", ".join(map(str, sizes[:6]))
    return shown + (", ..." if len(sizes) > 6 else "")
