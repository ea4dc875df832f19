"""Blendshape rigs from files: GLB, glTF and VRM, folders of OBJ files, and facelab's own."""

import re
import warnings
from itertools import combinations, islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import check_number, check_type
from facelab.files.gltf_read import GltfScene
from facelab.files.meshes import check_kind, unit_of
from facelab.files.npz import mesh_arrays
from facelab.files.obj import read_obj_file, read_obj_polygons, read_obj_rows
from facelab.files.words import distinct, listed, quoted
from facelab.geometry.alignment import procrustes
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size, face_scale, longest_side, mesh_scale
from facelab.geometry.welding import alike, near_borders, numbered, same_place, shrunk
from facelab.rig import BlendshapeRig, RigSource
from facelab.storage import load_npz, save_npz

KINDS = (".glb", ".gltf", ".vrm", ".npz")
"""Endings of files that hold a rig that can be read; a folder of OBJ files is another kind."""

_FACIAL = re.compile(
    r"brow|blink|eye|lid|cheek|nose|nostril|mouth|lip|jaw|chin|smile|frown|viseme|tongue|pucker|"
    r"^au_?\d|^fcl_",
    re.IGNORECASE,
)
_NEUTRAL = ("neutral", "rest", "basis", "base", "default")  # the plainest word first
_PLACE = 0.001  # mm: vertices so near to each other are in one place
_SAME = 0.01  # mm: and are two sides of a seam, if no shape moves them more apart than this
_NEAR = 0.05  # mm: two sides of a seam in coarse coordinates, of which each primitive has its own
_FAR = 0.5  # of the spread of a face: no expression moves all of it so far on average
_SHIFT = 0.01  # of it: a shape that moves the whole head further is said
_STAYS = 0.002  # of it: what moves less stays in its place
_EQUAL = 1e-6  # of the longest side: the digits of a text file
_POINT = 0.1  # mm: what is smaller is a place in a scene, not a part of a head
_MOVES = 0.1  # mm: what moves less is no expression
_BODY = 7.0  # a mesh so many times as large as what its shapes move is a body with a face


def read_rig(path, mesh=None, scale=None, neutral=None):
    """A blendshape rig from a GLB, glTF or VRM file, a folder of OBJ files, or our own npz.

    Vertices at the same place that all shapes move alike are joined, so that seams of texture
    coordinates are closed; `rig.source.index` leads back. Lips that touch stay apart.

    Parameters
    ----------
    path : str or Path
        A file, or a folder with one OBJ for the face at rest and one for each shape, named after
        it, all with the same vertices.
    mesh : str, optional
        The part whose shapes to read; that with the most facial ones if left out.
    scale : float, optional
        Millimetres in the file's unit of length: 10 for centimetres. If left out, glTF counts in
        metres and OBJ in millimetres, unless the size says otherwise: then the unit that makes it
        a face is taken, with a warning.
    neutral : str, optional
        Name of the OBJ at rest, found by its name if left out.

    Returns
    -------
    BlendshapeRig
        Millimetres. Names as in the file; `parts` are the other meshes of the file (eyes, teeth),
        `source` tells where all came from, `neutral.texture` is the picture of base colours
        (PNG or JPEG).

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing or damaged file, one without shapes, another kind of file (with the way to
        convert it), or a part that it does not have.

    Warns
    -----
    UserWarning
        Of a unit that was taken from the size, of shapes without name or that move the whole head,
        of other parts that have the shapes of the face, and of what was left out.

    Examples
    --------
    >>> import numpy as np
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> smile = np.zeros((1, face.n_vertices, 3))
    >>> smile[0, face.landmarks["mouth_corner_left"]] = [4, 5, -2]
    >>> facelab.files.write_glb("head.glb", face, smile, ["smileLeft"])
    >>> facelab.read_rig("head.glb")
    BlendshapeRig(1 shapes on 4375 vertices)
    """
    if scale is not None:
        scale = check_number(scale, "scale", above=0)
    if isinstance(path, (str, Path)) and Path(path).is_dir():
        return _from_folder(Path(path), mesh, scale, neutral)
    if isinstance(path, (str, Path)) and not (Path(path).suffix or Path(path).exists()):
        raise FileNotFoundError(f"path={str(path)!r}: there is no such file or folder.")
    kind = check_kind(path, KINDS)
    if neutral is not None:
        raise ValueError(f"neutral={neutral!r} names an OBJ of a folder, but {path} is a file.")
    if kind == ".npz":
        if mesh is not None or scale is not None:
            raise ValueError(
                f"{path}: such a file holds one mesh in millimetres; leave out mesh and scale."
            )
        return _from_npz(path)
    return _from_gltf(path, mesh, scale)


# --- GLB, glTF, VRM -------------------------------------------------------------------------------


def _from_gltf(path, mesh, scale):
    scene = GltfScene(path)
    chosen = None if mesh is None else scene.find(mesh)
    shaped = [name for k, name in enumerate(scene.names) if scene.n_targets(k)]
    if not shaped:
        raise ValueError(
            f"{scene.path}: no morph targets in it; export it with shape keys (Blender: File > "
            "Export > glTF 2.0, Data > Mesh > Shape Keys), or read it with read_mesh."
        )
    if chosen is not None and not scene.n_targets(chosen):
        raise ValueError(
            f"{scene.path}: mesh={mesh!r} has no morph targets; those with some are "
            f"{quoted(shaped, 20)}."
        )
    parts = [scene.part(k, shapes=True, texture=True) for k in range(len(scene.names))]
    names = [_distinct(scene.path, part) for part in parts]
    if chosen is None:
        chosen = max(range(len(parts)), key=lambda k: _facial(names[k], parts[k]))
        same = [k for k in range(len(parts)) if _as_large(parts[k], parts[chosen])]
        same = [k for k in same if set(names[k]) == set(names[chosen])]
        chosen = max(same, key=lambda k: len(parts[k].vertices))  # of several levels of detail
    head = parts[chosen]
    scale = _unit(scene.path, head.vertices, head.deltas, unit_of(".glb"), scale)
    _say_displaced(path, mesh, names[chosen], head.vertices * scale, head.deltas, scale)
    _say_reach(scene.path, head, scale)
    _say_other_faces(scene.path, mesh, parts, names, chosen, _PLACE / scale)
    if not head.deltas.any():
        warnings.warn(
            f"{scene.path}: none of the {len(head.deltas)} shapes of {head.name!r} moves a vertex, "
            "so it cannot be posed; export it with the positions of its shapes, not their normals "
            "alone.",
            stacklevel=3,
        )
    shown = scene.weights_at_rest(chosen, names[chosen])
    if shown:
        said = [f"{name} at {weight:g}" for name, weight in shown.items()]
        warnings.warn(
            f"{scene.path}: the file shows {head.name!r} with {listed(said)}; the face "
            "at rest is read without.",
            stacklevel=3,
        )
    others = {}
    for k, part in enumerate(parts):
        if k != chosen and _has_size(scene.path, part, scale):
            rest, deltas, _, _ = _welded(scene.path, part, scale)
            others[part.name] = BlendshapeRig(rest, names[k], deltas) if names[k] else rest
    rest, deltas, index, apart = _welded(scene.path, head, scale)
    source = RigSource(str(path), head.name, index, scale, apart)
    return BlendshapeRig(rest, names[chosen], deltas, {}, others, source)


def _facial(names, part):
    """How much of a face a part is: facial shapes that move something, then how large that is."""
    moved = [(d != 0).any(axis=1) for d in part.deltas]
    facial = sum(1 for n, m in zip(names, moved, strict=True) if m.any() and _FACIAL.search(n))
    face = part.vertices[np.any(moved, axis=0)] if moved else ()
    return facial, sum(m.any() for m in moved), longest_side(face) if len(face) else 0


def _say_other_faces(path, mesh, parts, names, chosen, near):
    """Say which other parts have the same shapes and touch the face, or are as large."""
    head, whole = parts[chosen], _facial(names[chosen], parts[chosen])
    tree, touch, like = cKDTree(head.vertices), [], []
    for k, part in enumerate(parts):
        if k == chosen or set(names[k]) != set(names[chosen]):
            continue
        facial = _facial(names[k], part)
        shared = np.isfinite(tree.query(part.vertices, distance_upper_bound=near)[0])
        as_large = _as_large(part, head)
        if facial[1] and not as_large and 2 < shared.sum() < 0.5 * len(shared):
            touch.append(part.name)
        elif as_large or (facial[0] == whole[0] and facial[2] > 0.8 * whole[2]):
            like.append(part.name)
    if touch:
        warnings.warn(
            f"{path}: {head.name!r} alone is read as the face, but {quoted(touch)} have the same "
            "shapes and touch it. If they are pieces of one face, join them to one mesh (Blender: "
            "select them, Ctrl+J) and export again.",
            stacklevel=4,
        )
    if like and mesh is None:
        warnings.warn(
            f"{path}: {head.name!r} is read as the face; {quoted(like)} have the same shapes and "
            f"are as large. Choose one with mesh={like[0]!r}.",
            stacklevel=4,
        )


def _as_large(part, other):
    """Whether two parts fill the same box, as two levels of detail do."""
    boxes = [np.stack([p.vertices.min(axis=0), p.vertices.max(axis=0)]) for p in (part, other)]
    return np.abs(boxes[0] - boxes[1]).max() < 0.05 * longest_side(other.vertices)


def _say_reach(path, head, scale):
    """Say shapes that move further than the head is long, or hardly at all."""
    most = float(max(np.linalg.norm(d, axis=1).max() for d in head.deltas)) * scale
    if most and not _MOVES < most < longest_side(head.vertices) * scale:
        warnings.warn(
            f"{path}: the shapes of {head.name!r} move it by at most {most:.3g} mm, and it is "
            f"{longest_side(head.vertices) * scale:.0f} mm long: they seem to be in another unit "
            "than the mesh. Apply the scale of the object before the export (Blender: Ctrl+A).",
            stacklevel=4,
        )


def _has_size(path, part, scale):
    """Whether a part can be shown; one that stands for nothing is said."""
    found = len(part.faces) and longest_side(part.vertices) * scale > _POINT
    if not found:
        warnings.warn(
            f"{path}: {part.name!r} lies in one point, or its triangles do; it is passed over.",
            stacklevel=4,
        )
    return found


def _distinct(path, part):
    """Names of a part's targets, each once and none empty."""
    names = list(part.names)
    found = distinct([name or f"target {k + 1}" for k, name in enumerate(names)])
    if found != names:
        odd = [new for name, new in zip(names, found, strict=True) if name != new]
        warnings.warn(
            f"{path}: {len(odd)} morph target(s) of {part.name!r} have no name, or one that is "
            f"there twice; they are called {listed(odd)}.",
            stacklevel=4,
        )
    return found


# --- a folder of OBJ files ------------------------------------------------------------------------


def _from_folder(folder, mesh, scale, neutral):
    found = [f for f in sorted(folder.iterdir()) if f.suffix.lower() == ".obj" and f.is_file()]
    found = [f for f in found if not f.name.startswith(".")]  # hidden, as of other systems
    files = {f.stem: f for f in found}
    if len(files) < len(found):
        twice = [f.name for f in found if files[f.stem] != f]
        raise ValueError(
            f"{folder}: {', '.join(twice)} and a file that differs only in the capitals of its "
            "ending have one name; take one out of the folder."
        )
    if len(files) < 2:
        raise ValueError(
            f"{folder}: {len(files)} OBJ file(s) in it; a rig needs one for the face at rest and "
            "one for each shape."
        )
    rest = _neutral_of(folder, files, neutral)
    rest_lines = read_obj_rows(files[rest])[1]
    base = read_obj_file(files.pop(rest))
    kept = slice(None) if mesh is None else base.vertices_of(mesh)
    face = base.whole() if mesh is None else base.part(mesh)
    V = face.vertices
    deltas, still = np.zeros((len(files), len(V), 3), np.float32), []
    for k, (name, file) in enumerate(files.items()):
        shape, lines = read_obj_rows(file)
        if len(shape) != len(base.vertices):
            raise ValueError(
                f"{file}: {len(shape)} vertices, but {rest}.obj has "
                f"{len(base.vertices)}; all shapes of a rig need the same. Take other files out of "
                "the folder, or name the face at rest with neutral=."
            )
        if lines != rest_lines and _other_faces(file, base):
            raise ValueError(
                f"{file}: its faces are not those of {rest}.obj, so its vertices stand in another "
                "order, or it is another mesh; export it again with 'keep vertex order'."
            )
        _refuse_far(file, rest, shape, base.vertices)
        if np.abs(shape - base.vertices).max() <= _EQUAL * longest_side(base.vertices):
            still.append(name)
        deltas[k] = shape[kept] - V
    if len(still) == len(files):
        raise ValueError(
            f"{folder}: all of its OBJ files hold the same face, so there is no shape."
        )
    if still:
        warnings.warn(
            f"{folder}: {listed(f'{n}.obj' for n in still)} ({len(still)}) hold the face at rest "
            f"as {rest}.obj does, and are left out.",
            stacklevel=3,
        )
        deltas = deltas[[name not in still for name in files]]
    names = [name for name in files if name not in still]
    scale = _unit(folder, V, deltas, unit_of(".obj"), scale)
    _say_displaced(folder, mesh, [f"{n}.obj" for n in names], V * scale, deltas, scale)
    read = SimpleNamespace(vertices=V, faces=face.faces, deltas=deltas, texture=face.texture)
    rest_mesh, deltas, index, apart = _welded(folder, read, scale)
    source = RigSource(str(folder / f"{rest}.obj"), mesh or rest, index, scale, apart)
    return BlendshapeRig(rest_mesh, names, deltas, source=source)


def _other_faces(file, base):
    """Whether a shape joins other vertices than the face at rest, in whatever order of faces."""
    if _polygons(file) == _polygons(base.path):
        return False
    faces = read_obj_file(file).faces
    own, others = ({tuple(f) for f in np.sort(F, axis=1).tolist()} for F in (faces, base.faces))
    # whoever cut quads into triangles may have cut some otherwise, where they bend otherwise
    quads = _quads(own - others, others)
    return len(own) != len(others) or quads is None or quads != _quads(others - own, own)


def _polygons(path):
    """Vertices of each face of an OBJ file, in an order of its own."""
    corners, counts = read_obj_polygons(path)
    corners = iter(corners)
    return sorted(sorted(islice(corners, n)) for n in counts)


def _quads(triangles, others):
    """Quads of pairs of triangles along the edges that others do not have; None if not all pair."""
    edges = {edge for triangle in others for edge in combinations(triangle, 2)}
    quads = {}
    for triangle in triangles:
        new = [edge for edge in combinations(triangle, 2) if edge not in edges]
        if len(new) != 1:
            return None
        quads.setdefault(new[0], set()).update(triangle)
    return sorted(map(sorted, quads.values()))


def _refuse_far(file, rest, shape, V):
    """Refuse a shape that is no expression of V."""
    size = _spread(V)
    far = np.sqrt(((shape - V) ** 2).sum(axis=1).mean()) / size if size else 0
    if far > _FAR:
        raise ValueError(
            f"{file}: its vertices lie {far:.2g} times as far from those of {rest}.obj as these "
            "from their middle; they stand in another order, unit or frame, or at another place in "
            "the scene. Export it as the others."
        )


def _neutral_of(folder, files, neutral):
    """Name of the file at rest."""
    if neutral is not None:
        name = check_type(neutral, "neutral", str, "give the name of an OBJ file")
        name = name[:-4] if name.lower().endswith(".obj") else name
        if name not in files:
            raise ValueError(
                f"{folder}: neutral={neutral!r} is not in it; its OBJ files are {listed(files, 8)}."
            )
        return name
    found = []
    for word in _NEUTRAL:
        found = [n for n in files if re.search(rf"(?<![a-z]){word}(?![a-z])", _apart(n), re.I)]
        if len(found) == 1:
            return found[0]
        if found:
            break
    by_name = f"by their names {listed(found)}" if found else "no name tells"
    raise ValueError(
        f"{folder}: which OBJ is the face at rest? {by_name[0].upper()}{by_name[1:]}; give "
        f"neutral=, one of {listed(files, 8)}."
    )


def _apart(name):
    """A name with its words apart: headNeutral, head_Neutral."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)


# --- facelab's own --------------------------------------------------------------------------------


def write_rig(path, rig):
    """Write a rig to an .npz file that `read_rig` reads, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    rig : BlendshapeRig
        Its neutral with landmarks, shapes and identities; parts and source are not kept.
    """
    check_type(rig, "rig", BlendshapeRig, "give a rig")
    check_face_size(rig.neutral.vertices, "rig")
    people = rig.identities
    save_npz(
        path,
        "rig",
        1,
        names=np.array(rig.names, dtype=str),
        deltas=rig.deltas,
        identity_names=np.array(list(people), dtype=str),
        identities=np.array(list(people.values())).reshape(-1, rig.neutral.n_vertices, 3),
        **mesh_arrays(rig.neutral),
    )


def _from_npz(path):
    data = load_npz(path, "rig", 1)
    kinds = {"vertices": "f", "deltas": "f", "identities": "f", "faces": "iu", "landmarks": "iu"}
    kinds |= {"names": "U", "landmark_names": "U", "identity_names": "U"}
    for name, kind in kinds.items():
        if name not in data or data[name].dtype.kind not in kind:
            raise ValueError(f"{path}: its array {name!r} is missing or of another type.")
    pairs = (("landmark_names", "landmarks"), ("identity_names", "identities"))
    for names, values in pairs:
        if data[names].ndim != 1 or data[names].shape != data[values].shape[:1]:
            raise ValueError(f"{path}: {names} and {values} are not of the same number.")
    marks, people = (
        {n: v for n, v in zip(data[a].tolist(), data[b], strict=True)} for a, b in pairs
    )
    try:
        mesh = TriangleMesh(data["vertices"], data["faces"], marks)
        rig = BlendshapeRig(mesh, np.atleast_1d(data["names"]).tolist(), data["deltas"], people)
    except (ValueError, TypeError) as error:  # ours
        raise ValueError(f"{path}: {error}") from None
    check_face_size(mesh.vertices, path)
    return rig


# --- both -----------------------------------------------------------------------------------------


def _unit(path, V, deltas, declared, scale):
    """Millimetres in the file's unit: what was given, what its kind declares, or what fits."""
    if scale is not None:
        check_face_size(V, path, scale)
        return scale
    side = longest_side(V)
    moves = np.zeros(len(V))
    for delta in deltas:
        moves = np.maximum(moves, np.linalg.norm(delta, axis=1))
    moved = moves > 0.05 * moves.max() if len(moves) else moves
    face = longest_side(V[moved]) if moved.any() else side
    body = 0 < _BODY * face < side  # what the shapes move is its face
    side = face if body else side
    found, unit = mesh_scale(side, whole=not body)
    if found == declared or face_scale(side * declared) == 1:
        return declared
    if found is None or face_scale(side * declared) == 0.1:  # it may as well be a whole body
        check_face_size(V, path, declared)
        return declared
    warnings.warn(
        f"{path}: its face is {side:.4g} long, which makes no face at {declared:g} mm to the unit; "
        f"it is read with scale={found:g}, {unit}. Give scale= to say what it is.",
        stacklevel=4,
    )
    return found


def _say_displaced(path, mesh, names, V, deltas, scale):
    """Say which shapes move the whole head; all do so of an eye, if that mesh was asked for."""
    found = {n: _displaced(V, d * np.float32(scale)) for n, d in zip(names, deltas, strict=True)}
    said = [f"{name} ({how})" for name, how in found.items() if how]
    if said and (mesh is None or 2 * len(said) < len(names)):
        warnings.warn(
            f"{path}: {len(said)} shape(s) move the whole head, skull and neck too: "
            f"{listed(said)}; if that is not meant, put each where the face at rest is, in its "
            "size, and export again.",
            stacklevel=4,
        )


def _displaced(V, delta):
    """How a shape moves the whole head, in words; nothing where some of it stays in its place."""
    size, away = _spread(V), np.linalg.norm(delta, axis=1)
    if (away < _STAYS * size).mean() > 0.02:
        return ""
    moved, left = V + delta, np.zeros(len(V))
    for _ in range(12):  # of what moves alike, the expression left out
        core = left <= np.quantile(left, 0.4)
        try:
            fit = procrustes(V[core], moved[core], scale=True)
        except ValueError:  # on one line: no head
            return ""
        left = np.linalg.norm(fit.apply(V) - moved, axis=1)
    goes = np.median(np.linalg.norm(fit.apply(V) - V, axis=1))
    if goes < _SHIFT * size or (left < 0.25 * goes).mean() < 0.25:
        return ""
    middle = V.mean(axis=0)
    shift = np.linalg.norm(fit.apply(middle) - middle)
    how = [f"by {shift:.1f} mm"] if shift > 0.2 * goes else []
    if abs(fit.scale - 1) * size > 0.2 * goes:
        how.append(f"{abs(fit.scale - 1):.1%} {'larger' if fit.scale > 1 else 'smaller'}")
    if np.radians(fit.degrees) * size > 0.2 * goes:
        how.append(f"turned by {fit.degrees:.1f} degrees")
    return ", ".join(how)


def _spread(V):
    """Root mean squared distance of vertices from their middle."""
    return np.sqrt(((V - V.mean(axis=0)) ** 2).sum(axis=1).mean())


def _welded(path, part, scale):
    """The mesh and its shapes in millimetres, seams closed.

    Returns
    -------
    mesh : TriangleMesh
    deltas : ndarray of float32
    index : ndarray of int
        Vertex of the mesh for each one of the part.
    apart : int
        Vertices at the place of another one that move otherwise.
    """
    V, deltas = part.vertices * scale, part.deltas * np.float32(scale)
    if not longest_side(V) > _POINT:
        raise ValueError(
            f"{path}: all vertices lie within {longest_side(V):.2g} mm; give scale=, the "
            "millimetres in its unit of length, or export the file again."
        )
    place = same_place(V, _PLACE)
    index = alike(place, deltas, _SAME)
    index = _along_borders(V, part.faces, deltas, index)
    kept = np.unique(index, return_index=True)[1]
    apart = len(np.unique([place, index], axis=1).T) - int(place.max()) - 1
    try:
        gone = shrunk(part.faces, index)
        texture = None if part.texture is None else part.texture.on(~gone)
        mesh = TriangleMesh(V[kept], index[part.faces[~gone]], texture=texture)
    except ValueError as error:  # ours, from the one place that checks a mesh
        raise ValueError(f"{path}: {error}") from None
    return mesh, deltas[:, kept], index, apart


def _along_borders(V, faces, deltas, index):
    """Groups of vertices joined also where borders meet nearly and move alike.

    Where a triangle would be lost, as of a narrow strip, nothing is joined.
    """
    kept = np.unique(index, return_index=True)[1]
    F = index[faces[~shrunk(faces, index)]]
    near = near_borders(V[kept], F, _NEAR)
    if near.max() + 1 == len(kept):
        return index
    joined = alike(near, deltas[:, kept], _NEAR)
    torn = np.unique(F[shrunk(F, joined)])
    joined[torn] = len(kept) + torn
    return numbered(joined)[index]
