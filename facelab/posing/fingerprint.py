"""What tells a model or mesh from others."""

from copy import deepcopy
from hashlib import sha256

import numpy as np

from facelab.checks import as_finite, check_number
from facelab.geometry.mesh import TriangleMesh
from facelab.posing.stored import entry

_PROBES = 4  # random projections in a fingerprint
_KEPT, _made = 16, {}  # by all the numbers: a page asks at each step, and probes take 50 ms
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
        faces = sha256(np.ascontiguousarray(thing.faces, dtype="<i8")).hexdigest()[:16]
        return _print("mesh", [thing.n_vertices, len(thing.faces), faces], [thing.vertices])
    kind, sizes, arrays = thing.fingerprint_parts()
    key = sha256(repr((kind, sizes, [np.shape(a) for a in arrays])).encode())
    for array in arrays:
        key.update(np.ascontiguousarray(array, dtype=float))
    if key.digest() not in _made:
        while len(_made) >= _KEPT:
            del _made[next(iter(_made))]
        _made[key.digest()] = _print(kind, sizes, arrays)
    return deepcopy(_made[key.digest()])


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
    """What differs between a stored fingerprint and one's own, in words; empty if nothing does.

    Raises
    ------
    ValueError, TypeError
        If it is no fingerprint.
    """
    kind, sizes = entry(stored, "kind", str), entry(stored, "sizes", list)
    probes = as_finite(entry(stored, "probes", list), "probes", (_PROBES,))
    scale = check_number(entry(stored, "scale", float), "scale", low=0)
    if kind != own["kind"]:
        return f"it is of a {kind[:20]}, not of a {own['kind']}"
    if sizes != own["sizes"] or list(map(type, sizes)) != list(map(type, own["sizes"])):
        return f"its sizes or names are {_short(sizes)}, not {_short(own['sizes'])}"
    off = np.abs([*probes - own["probes"], scale - own["scale"]]).max()
    return "its numbers are others" if off > _CLOSE * own["scale"] else ""


def _short(sizes):
    shown = ", ".join(str(size)[:20] for size in sizes[:6])
    return shown + (", ..." if len(sizes) > 6 else "")
