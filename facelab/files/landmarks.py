"""Named vertices of a mesh from files: menpo .ljson, MeshLab .pp, lists of indices, barycentric."""

import json
import math
import re
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import as_finite, check_index, check_number, check_type
from facelab.files.json_items import load_json
from facelab.files.text import as_number, text_lines
from facelab.files.words import damaged, listed
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.names import as_landmarks
from facelab.storage import StoredArrays, atomic_path, existing_file

KINDS = (".ljson", ".json", ".pp", ".txt", ".csv", ".npy", ".npz")
"""Endings of files that hold landmarks that can be read."""

_NUMBERED = {68: MULTI_PIE, 51: MULTI_PIE[17:]}  # lists without names in an order all know
_MOST = 4_000_000  # bytes; a file of landmarks has some thousands
_FAR = 5.0  # mm from the mesh: a landmark that belongs to another one, or another unit
_INTEGER = re.compile(r"-?\d{1,15}", re.ASCII)
# between words of a line; the colon of A:chin is none
_BETWEEN = re.compile(r"(?:[\s,;=\[\]()]|:(?![^\W\d]|\d+[^\W\d]))+")
_HEADER = {*"name names label landmark index indices idx vertex id x y z".split()}
_UP = ("eye_right_outer", "eye_left_outer", "chin", "nose_tip")


def write_landmarks(path, vertices, landmarks):
    """Write landmarks as .ljson, whole or not at all.

    Parameters
    ----------
    path : str or Path
    vertices : ndarray of shape (n_vertices, 3)
        Of the mesh, in the unit that the file shall have.
    landmarks : dict of str to int
        Vertex of each.

    Raises
    ------
    ValueError, TypeError
        For no landmarks, or one that is no vertex of the mesh.

    References
    ----------
    menpo project, landmark file format, version 3.
    """
    vertices = as_finite(vertices, "vertices", ("n_vertices", 3))
    if not landmarks:
        raise ValueError("landmarks is empty; set one or more first.")
    at = [
        check_index(v, f"landmarks[{n!r}]", len(vertices), "vertices") for n, v in landmarks.items()
    ]
    own = np.eye(len(at), dtype=bool).tolist()
    labels = [{"label": n, "mask": m} for n, m in zip(landmarks, own, strict=True)]
    group = {
        "landmarks": {"points": vertices[at].tolist(), "connectivity": []},
        "labels": labels,
    }
    with atomic_path(path) as part:
        held = {"version": 3, "groups": {"PTS": group}}
        part.write_text(json.dumps(held, ensure_ascii=False), encoding="utf-8")


def read_landmarks(path, mesh, names=None, scale=1.0):
    """Landmarks of a mesh: its vertices by name.

    Parameters
    ----------
    path : str or Path
        `.ljson` of menpo (version 1 to 3, three-dimensional) and `.pp` of MeshLab have points,
        which go to the nearest vertex. `.json` has those of menpo, or a vertex for each name,
        `{"chin": 1204}`, or a point, `[x, y, z]`. `.txt` and `.csv` have a vertex or a point in
        each line, with or without a name in front, `.npy` vertices. `.npz` has places in triangles,
        as FLAME's embeddings do: an array of triangles (n,) with `face` in its name, and one of
        barycentric weights (n, 3) with `b_coords` or `bary`; each goes to its nearest corner.
    mesh : TriangleMesh
        In its own frame, its vertices in the order of its file.
    names : sequence of str, optional
        For files without names. If left out, 68 landmarks are those of `facelab.geometry.MULTI_PIE`
        and 51 the same without the line of the jaw.
    scale : float, default=1
        Millimetres in the unit of points in the file.

    Returns
    -------
    dict of str to int
        For `TriangleMesh(mesh.vertices, mesh.faces, landmarks)`. Missing points are left out. Names
        of `facelab.geometry.MULTI_PIE` in another spelling (`JAW_RIGHT_1`, `brow_L_1`,
        `Actor:chin`) are spelled as there.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing or damaged file, another kind, points off the mesh, indices that it does not
        have, landmarks without names, two names that read alike, or left and right exchanged.

    Warns
    -----
    UserWarning
        Of landmarks that are missing in the file, and of two at one vertex.

    Examples
    --------
    >>> import facelab
    >>> from pathlib import Path
    >>> face = facelab.load_template(4375)
    >>> _ = Path("face.txt").write_text("CHIN 8\\nnose_tip 30\\n")
    >>> facelab.files.read_landmarks("face.txt", face)
    {'chin': 8, 'nose_tip': 30}
    """
    check_type(mesh, "mesh", TriangleMesh, "give the mesh that the landmarks are of")
    scale = check_number(scale, "scale", above=0)
    kind = Path(path).suffix.lower() if isinstance(path, (str, Path)) else ""
    path = existing_file(path, "file of landmarks")
    if kind not in KINDS:
        raise ValueError(f"{path}: unknown kind of landmarks; readable are {', '.join(KINDS)}.")
    if path.stat().st_size > _MOST:
        raise ValueError(f"{path}: {path.stat().st_size / 1e6:.0f} MB are no file of landmarks.")
    top = load_json(path.read_bytes(), path, "file of landmarks") if "json" in kind else None
    menpo = top is not None and {"version", "groups", "landmarks"} & set(top.value)
    if kind == ".pp" or menpo:
        found, places = _picked(path) if top is None else _ljson(path, top)
    else:
        read = {".npy": _npy, ".npz": _npz, ".txt": _listed, ".csv": _listed}
        found, places = read[kind](path, mesh) if top is None else _of_names(path, top)
    labels = _named(path, found, len(places), names)
    if places.ndim == 2:
        found = _nearest(path, mesh, labels, scale * places)
    else:
        out = (places < 0) | (places >= mesh.n_vertices)
        if out.any():
            raise ValueError(
                f"{path}: {labels[int(out.argmax())]} is vertex {places[out][0]}, but the mesh "
                f"has 0 to {mesh.n_vertices - 1}; give the mesh that they were set on, with its "
                "vertices in the order of its file."
            )
        found = dict(zip(labels, places.tolist(), strict=True))
    _check_places(path, mesh, found)
    return found


# --- points ---------------------------------------------------------------------------------------


def _ljson(path, top):
    """Names, or None, and points (n, 3), NaN where one is missing, of a file of menpo."""
    nested = isinstance(top.value.get("groups", []), dict)
    version = top.whole("version", 3 if nested else 2, low=1, high=3)
    if version == 1:
        names, rows = [], []
        for group in top.items("groups"):
            points = group.items("landmarks")
            label = group.text("label", "")
            rows += [_point(p, "point") for p in points]
            names += [label if len(points) == 1 else f"{label}_{k + 1}" for k in range(len(points))]
        return _known(names, len(rows)), _points(path, rows)
    if version == 3:
        groups = top.item("groups")
        if len(groups.value) != 1:
            raise ValueError(
                f"{path}: {len(groups.value)} groups of landmarks, and one is read; keep that one."
            )
        top = groups.item(next(iter(groups.value)))
    held = top.item("landmarks")
    points = held.listed("points", "a list of points")
    rows = [_point(points, k) for k in points.value]
    names = [None] * len(rows)
    for label in top.items("labels"):
        mask = label.value.get("mask")
        if isinstance(mask, list) and len(mask) == len(rows) and {*map(type, mask)} == {bool}:
            label.value["mask"] = np.flatnonzero(mask).tolist()  # as some write it; menpo's way
        mask = label.wholes("mask", of=rows)
        text = label.text("label", "")
        for k, v in enumerate(mask):
            names[v] = text if len(mask) == 1 else f"{text}_{k + 1}"
    return _known(names, len(rows)), _points(path, rows)


def _known(names, n):
    """Names, unless the order says more: groups of menpo's 68 points are called eye, mouth, ..."""
    full = len(names) == n and all(names) and len(set(names)) == n
    return names if full and not (n in _NUMBERED and any(x[-2:] == "_2" for x in names)) else None


def _point(item, key):
    value = item.value.get(key)
    if value is None or (isinstance(value, list) and value and all(v is None for v in value)):
        return [math.nan] * (len(value) if value else 3)
    if isinstance(value, list) and len(value) == 2:
        raise item.wrong(key, "a point of three numbers: landmarks of a picture have no depth")
    return item.numbers(key, 3)


def _points(path, rows):
    if not rows or any(len(r) != 3 for r in rows):
        raise ValueError(f"{path}: no points of three numbers in it.")
    return np.array(rows)


def _picked(path):
    """Names and points of the PickedPoints of MeshLab."""
    data = path.read_bytes()
    if b"<!ENTITY" in data.upper():
        raise ValueError(f"{path}: it defines entities, which MeshLab does not; it is not read.")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        line = getattr(error, "position", (1, 0))[0]
        raise ValueError(
            f"{path}, line {line}: no XML from here on; the file is cut or damaged, or not of "
            "MeshLab's PickPoints."
        ) from None
    names, rows = [], []
    for k, point in enumerate(root.iter("point"), 1):
        row = [as_number(point.get(axis, "")) for axis in "xyz"]
        if None in row or not np.isfinite(row).all():
            at = [f"{axis}={point.get(axis)!r}" for axis in "xyz"]
            raise ValueError(
                f"{path}: point {k} has {', '.join(at)[:90]}; x, y and z must be numbers."
            )
        if point.get("active", "1") != "0":
            rows.append(row)
            names.append(point.get("name", ""))
    if root.tag != "PickedPoints" or not rows:
        raise ValueError(f"{path}: no picked points in it; save them in MeshLab's PickPoints.")
    if all(_INTEGER.fullmatch(n) for n in names):  # MeshLab numbers what has no name
        names = None
    return names, np.array(rows)


def _nearest(path, mesh, labels, points):
    """Vertices nearest to points; refused if they lie off the mesh."""
    seen = np.isfinite(points).all(axis=1)
    if not seen.any():
        raise ValueError(f"{path}: all of its landmarks are missing.")
    if not seen.all():
        lost = [n for n, s in zip(labels, seen, strict=True) if not s]
        warnings.warn(f"{path}: {len(lost)} landmark(s) are missing: {listed(lost)}.", stacklevel=3)
    away, vertex = cKDTree(mesh.vertices).query(points[seen].clip(-1e12, 1e12))
    labels = [n for n, s in zip(labels, seen, strict=True) if s]
    far = away > _FAR
    if far.any():
        worst = int(away.argmax())
        raise ValueError(
            f"{path}: {far.sum()} of {len(far)} landmarks lie more than {_FAR:g} mm from any "
            f"vertex, {labels[worst]} {away[worst]:.4g} mm; they are of another mesh or frame, or "
            "of another unit: give scale=1000 for metres, 10 for centimetres."
        )
    return dict(zip(labels, vertex.tolist(), strict=True))


# --- indices --------------------------------------------------------------------------------------


def _listed(path, mesh):
    """Names, or None, and vertices, or points, of a list with a name in front of each or none.

    Points are three numbers in each line, not all of them whole or with a name in front; vertices
    without names may be many in a line.
    """
    lines = []
    for at, line, _ in text_lines(path, "list of landmarks"):
        words = [w.strip("\"'") for w in _BETWEEN.split(line.split("#")[0]) if w]
        if words and (lines or not {w.lower() for w in words} <= _HEADER):
            name = [] if as_number(words[0]) is not None else [words.pop(0)]
            lines.append((at, line.strip()[:60], name, words))
    if not lines:
        raise ValueError(f"{path}: no vertices in it.")
    named = [bool(name) for _, _, name, _ in lines]
    points = any(len(w) == 3 and (n or not _whole(w)) for _, _, n, w in lines)
    for (at, shown, _, words), own in zip(lines, named, strict=True):
        if points:
            good = len(words) == 3 and None not in map(as_number, words)
        else:
            good = _whole(words) and (len(words) == 1 or not own)
        if not good:
            raise ValueError(
                f"{path}, line {at}: {shown!r} is neither a list of vertices nor a name "
                "and a vertex, nor x, y and z of a point, as the other lines."
            )
        if own != named[0]:
            raise ValueError(f"{path}, line {at}: some landmarks have a name and others none.")
    names = [name for _, _, [name], _ in lines] if named[0] else None
    if points:
        return names, np.array([list(map(as_number, words)) for _, _, _, words in lines])
    return names, np.array([int(w) for _, _, _, words in lines for w in words], dtype=np.int64)


def _whole(words):
    return bool(words) and all(map(_INTEGER.fullmatch, words))


def _of_names(path, top):
    """Names and vertices, or points, of an object of JSON."""
    if not top.value:
        raise ValueError(f"{path}: it names no landmark.")
    if all(isinstance(value, list) for value in top.value.values()):
        return list(top.value), np.array([top.numbers(name, 3) for name in top.value])
    return list(top.value), np.array([top.whole(name) for name in top.value], dtype=np.int64)


def _npy(path, mesh):
    try:
        found = np.lib.format.open_memmap(path, mode="r")  # which takes no memory
    except Exception:  # a mere accident of the bytes decides which
        raise ValueError(
            f"{path}: it is cut or damaged, no npy file, or it holds pickled objects, which are "
            "never read."
        ) from None
    if found.dtype.kind not in "iu" or found.ndim != 1 or not found.size:
        raise ValueError(
            f"{path}: it holds {found.dtype} {found.shape}; an array of whole numbers (n,) is "
            "wanted."
        )
    if found.offset + found.nbytes != path.stat().st_size:
        raise damaged(f"{path}: it is longer than its header says")
    return None, _as_index(found)


def _npz(path, mesh):
    """Barycentric places, each at the nearest corner of its triangle."""
    with open(path, "rb") as file, StoredArrays(path, file, "npz file of landmarks") as stored:
        face = [n for n in stored.names if "face" in n.lower()]
        bary = [n for n in stored.names if "b_coords" in n.lower() or "bary" in n.lower()]
        if len(face) != 1 or len(bary) != 1:
            raise ValueError(
                f"{path}: it holds {listed(stored.names) or 'nothing'}; wanted are one array of "
                "triangles with 'face' in its name and one of weights with 'b_coords' or 'bary'."
            )
        faces = _as_index(stored.read(face[0], ("n",), "iu"))
        weights = stored.read(bary[0], (len(faces), 3), "f")
    if not len(faces):
        raise ValueError(f"{path}: no landmarks in it.")
    good = np.isfinite(weights).all(axis=1) & (np.abs(weights.sum(axis=1) - 1) < 1e-3)
    good &= (weights > -1e-3).all(axis=1)
    if not good.all():
        raise ValueError(
            f"{path}: the weights of landmark {int((~good).argmax())} are "
            f"{weights[~good][0].tolist()}; three from 0 up that sum to 1 are wanted."
        )
    if faces.min() < 0 or faces.max() >= len(mesh.faces):
        raise ValueError(
            f"{path}: triangle {faces.max() if faces.max() >= len(mesh.faces) else faces.min()} is "
            f"named, but the mesh has 0 to {len(mesh.faces) - 1}; give the mesh they were set on."
        )
    return None, mesh.faces[faces, weights.argmax(axis=1)]


def _as_index(numbers):
    """Whole numbers as int64; what is too large for that stays too large."""
    if numbers.dtype.kind == "u":
        numbers = np.minimum(numbers, np.uint64(2**62))
    return numbers.astype(np.int64)


# --- all ------------------------------------------------------------------------------------------


def _named(path, found, n, names):
    """A name for each landmark: those of the file, those given, or those of a known order."""
    if names is not None:
        if isinstance(names, str) or not all(isinstance(x, str) for x in names):
            raise TypeError(f"names={names!r} must be a list of names.")
        found = list(names)
        if len(found) != n:
            raise ValueError(f"{path}: {n} landmarks, but names has {len(found)}.")
    elif found is None:
        if n not in _NUMBERED:
            raise ValueError(
                f"{path}: {n} landmarks without names, and only an order of 68 or 51 is known; "
                "give names=."
            )
        found = _NUMBERED[n]
    twice = sorted({x for x in found if found.count(x) > 1})
    if twice or not all(found):
        raise ValueError(
            f"{path}: {f'{listed(twice)} stand(s) twice' if twice else 'a landmark has no name'}; "
            "each needs a name of its own (names=)."
        )
    try:
        return list(as_landmarks(MULTI_PIE, dict.fromkeys(found)))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _check_places(path, mesh, found):
    """Refuse sides exchanged, all or some, and warn of two landmarks at one vertex."""
    if set(_UP) <= set(found):
        right, left, chin, nose = (mesh.vertices[found[n]] for n in _UP)
        eyes = (right + left) / 2
        ahead = np.cross(left - right, eyes - chin)  # to the left times up is forward
        out = nose - (right + left + chin) / 3
        if ahead @ out < 0:
            raise ValueError(
                f"{path}: left and right are exchanged, or the landmarks stand in another order: "
                "seen with the chin below, the nose would point backwards. Left is the person's; "
                "give names= in the right order, or mend the file."
            )
    pairs = [(n, n.replace("left", "right")) for n in found if "left" in n]
    pairs = [(left, right) for left, right in pairs if right in found]
    across = [mesh.vertices[found[a]] - mesh.vertices[found[b]] for a, b in pairs]
    across = np.reshape(across, (-1, 3))
    away = across @ across.sum(axis=0)  # all to the one side
    if (away < 0).any():
        worst = int(away.argmin())
        raise ValueError(
            f"{path}: {' and '.join(pairs[worst])} stand the other way round than most of the "
            f"{len(pairs)} pairs ({int((away < 0).sum())} do): their sides are exchanged, or the "
            "landmarks stand in another order. Give names= in the right order, or mend the file."
        )
    at = {}
    for name, v in found.items():
        at.setdefault(v, []).append(name)
    both = [" and ".join(n) for n in at.values() if len(n) > 1]
    if both:
        warnings.warn(f"{path}: at one vertex are {listed(both)}.", stacklevel=3)
