"""Shapes and animation into a user's own file: everything else in it stays as it was."""

import re
import warnings
from pathlib import Path

import numpy as np

from facelab.checks import as_finite, check_type
from facelab.files.gltf_into import GltfEdit
from facelab.files.obj import read_obj_file
from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig
from facelab.storage import atomic_path, check_writable

_VERTEX = re.compile(
    rb"((?:\xef\xbb\xbf)?[ \t]*v[ \t]+)(\S+)([ \t]+)(\S+)([ \t]+)(\S+)(.*)", re.DOTALL
)
_GLTF = (".glb", ".gltf", ".vrm")
_MOVED = 0.1  # mm: seams are closed within less; vertices further off are others


def write_into(path, rig, shapes=None, take=None):
    """Write poses, fitted units or a take into a copy of the file that a rig was read from.

    In a GLB, glTF or VRM, shapes become morph targets of the rig's mesh, behind those it has, and
    the take an animation, also of other parts with shapes that it drives (teeth, tongue, lashes);
    materials, texture coordinates, skeleton and other meshes keep their bytes. Of a folder of
    OBJ files the one at rest is copied for each shape with its vertices moved: quads, groups and
    texture coordinates stay.

    Parameters
    ----------
    path : str or Path
        With the ending of the source; for OBJ a folder, or one .obj file for one shape. It may be
        the source itself, which is then replaced whole.
    rig : BlendshapeRig
        As `read_rig` gave it, renamed, or on some of its vertices (`rig.on`, `lab.rig` of a head
        in pieces; what it lacks stays as it is): its `source` tells the file.
    shapes : dict of str to array_like of shape (n_vertices, 3), optional
        Displacements of the rig's vertices, millimetres (of a pose: `session.vertices` less
        `session.neutral.vertices`); both sides of a seam get the same.
    take : WeightSequence, optional
        Drives the rig as `rig.animate` does, and new shapes by their own names. Lost frames get
        no key: the face moves from the last one seen to the next, and so over `gaps` in time.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        If the rig was not read from a file, the file has changed since, shapes do not fit or have
        a name that is there already, no name of the take drives anything, or the ending is
        another. Nothing is written then.

    Warns
    -----
    UserWarning
        That a compressed file is written uncompressed, or which columns of a take drive nothing.

    Examples
    --------
    >>> import numpy as np
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> smile = np.zeros((1, face.n_vertices, 3))
    >>> smile[0, face.landmarks["mouth_corner_left"]] = [4, 5, -2]
    >>> facelab.files.write_glb("head.glb", face, smile, ["smileLeft"])
    >>> rig = facelab.read_rig("head.glb")
    >>> facelab.files.write_into("posed.glb", rig, {"half": 0.5 * rig.deltas[0]})
    >>> facelab.read_rig("posed.glb").names
    ('smileLeft', 'half')
    """
    rig = check_type(rig, "rig", BlendshapeRig, "give a rig that read_rig has read")
    if rig.source is None:
        raise ValueError(
            "rig.source is None: it was not read from a file, so there is none to write into; "
            "write_glb and write_rig make a new one."
        )
    if take is not None:
        check_type(take, "take", WeightSequence, "give weights over time")
    shapes = _checked(shapes, rig)
    if not shapes and take is None:
        raise ValueError("neither shapes nor a take are given; there is nothing to write.")
    source = Path(rig.source.path)
    if source.suffix.lower() == ".obj":
        if take is not None:
            raise ValueError(
                f"take: OBJ files ({source}) hold no animation; write_weights_csv keeps the "
                "weights, write_glb a face that moves."
            )
        return _into_obj(Path(path), source, rig, shapes)
    if source.suffix.lower() not in _GLTF:
        raise ValueError(f"rig.source is {source}, of a kind that nothing is written into.")
    if Path(path).suffix.lower() != source.suffix.lower():
        raise ValueError(
            f"path={str(path)!r} does not end in {source.suffix}, as the source does; it stays of "
            "that kind."
        )
    check_writable(path)
    _into_gltf(path, source, rig, shapes, take)


def _checked(shapes, rig):
    shapes = {} if shapes is None else check_type(shapes, "shapes", dict, "name each shape")
    n = rig.neutral.n_vertices
    found = {}
    for name, moved in shapes.items():
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"shapes has the name {name!r}; give each shape a name.")
        found[name] = as_finite(moved, f"shapes[{name!r}]", ("n_vertices", 3))
        if len(found[name]) != n:
            raise ValueError(
                f"shapes[{name!r}] has {len(found[name])} vertices, but the rig {n}. Of a head in "
                "pieces a lab poses the face alone: what is posed there goes with lab.rig."
            )
    there = sorted(set(found) & set(rig.names))
    if there:
        raise ValueError(
            f"shapes: the file has {', '.join(there)} already; give other names, for what is "
            "there is not changed."
        )
    return found


def _of_file(moved, rig):
    """Displacements of the file's vertices; those that the rig does not have stay."""
    index = rig.source.index
    return np.where(index[:, None] < 0, 0.0, moved[index])


def _refuse_changed(source, V, rig):
    """Refuse a file whose vertices, in its unit, are not where the rig has them."""
    index = rig.source.index
    kept = index >= 0
    away = np.abs(V[kept] * rig.source.scale - rig.neutral.vertices[index[kept]])
    if away.size and away.max() > _MOVED:
        raise ValueError(
            f"{source}: its vertices lie up to {away.max():.3g} mm from those of the rig; the file "
            "has changed since the rig was read, read it again."
        )


def _into_gltf(path, source, rig, shapes, take):
    edit = GltfEdit(source, rig.source.mesh)
    if edit.n_vertices != len(rig.source.index) or edit.n_targets != len(rig.names):
        raise ValueError(
            f"{source}: {rig.source.mesh!r} has {edit.n_vertices} vertices and {edit.n_targets} "
            f"shapes, but the rig was read from {len(rig.source.index)} and {len(rig.names)}; the "
            "file has changed, read it again."
        )
    _refuse_changed(source, edit.vertices, rig)
    for name, moved in shapes.items():
        edit.add_shape(name, _of_file(moved, rig) / rig.source.scale)
    if take is not None:
        kept = np.flatnonzero(take.valid)
        if not len(kept):
            raise ValueError("take holds no valid frame.")
        weights = _weights(take, rig, shapes)[kept]
        edit.add_animation(take.times[kept], weights, _of_parts(take, rig, kept))
    if edit.unpacked:
        warnings.warn(
            f"{source}: it is compressed with {', '.join(edit.unpacked)}; {path} is written "
            "uncompressed. `gltf-transform` packs it again.",
            stacklevel=4,
        )
    edit.save(path)


def _weights(take, rig, shapes):
    """Weights of the rig's shapes and the new ones: (n_frames, n_targets)."""
    column = {name: k for k, name in enumerate(take.names)}
    new = [column.get(name) for name in shapes]
    own = [k for k in new if k is not None]
    rest = [k for k in range(len(take.names)) if k not in own]
    W = np.zeros((take.n_frames, len(rig.names)))
    if rest and len(rig.names):
        left = WeightSequence(
            take.weights[:, rest], [take.names[k] for k in rest], take.fps, take.valid
        )
        try:
            W = rig.rig_weights(left)
        except ValueError:
            if not own:
                raise
    added = np.zeros((take.n_frames, len(new)))
    for at, k in enumerate(new):
        if k is not None:
            added[:, at] = np.nan_to_num(take.weights[:, k])
    return np.hstack([W, added])


def _of_parts(take, rig, kept):
    """Weights of the other parts that a take drives (teeth, tongue, lashes), by their names."""
    found = {}
    for name, part in rig.parts.items():
        if hasattr(part, "match") and part.match(take).driven:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a part has not all shapes, which need not be said
                found[name] = part.rig_weights(take)[kept]
    return found


def _into_obj(path, rest, rig, shapes):
    one = path.suffix.lower() == ".obj"
    if one and len(shapes) != 1:
        raise ValueError(
            f"path={str(path)!r} is one OBJ file, but there are {len(shapes)} shapes; give a "
            "folder."
        )
    odd = [name for name in shapes if Path(name).name != name or name.startswith(".")]
    if odd and not one:
        raise ValueError(f"shapes: {odd[0]!r} makes no file name; give a plain one.")
    if len({name.casefold() for name in shapes}) < len(shapes):
        raise ValueError(
            "shapes: two names differ only in capitals, and many file systems hold them for the "
            "same file; rename one."
        )
    if not one and path.resolve() == rest.parent.resolve():
        _refuse_taken(path, shapes)
    base = read_obj_file(rest)
    moving = np.arange(len(base.vertices))
    if len(moving) != len(rig.source.index):
        moving = base.vertices_of(rig.source.mesh)
    if len(moving) != len(rig.source.index):
        raise ValueError(f"{rest}: it has changed since the rig was read; read it again.")
    _refuse_changed(rest, base.vertices[moving], rig)
    lines = rest.read_bytes().splitlines(keepends=True)
    at = [k for k, line in enumerate(lines) if _VERTEX.fullmatch(line)]
    if len(at) != len(base.vertices):
        raise ValueError(f"{rest}: some of its vertices go over two lines; export it again.")
    if any(line.startswith(b"vn") for line in lines):
        warnings.warn(
            f"{rest}: its normals (vn) are those of the face at rest and are copied as they are; "
            "let the program that opens the new files compute them.",
            stacklevel=3,
        )
    if not one:
        path.mkdir(parents=True, exist_ok=True)
    for name, moved in shapes.items():
        away = _of_file(moved, rig) / rig.source.scale
        V = base.vertices[moving] + away
        out = list(lines)
        still = ~away.any(axis=1)
        for row, v, stays in zip(moving, V, still, strict=True):
            if not stays:  # what does not move keeps its digits
                begin, _, a, _, b, _, end = _VERTEX.fullmatch(lines[at[row]]).groups()
                x, y, z = (b"%.9g" % c for c in v)
                out[at[row]] = b"".join([begin, x, a, y, b, z, end])
        with atomic_path(path if one else path / f"{name}.obj") as part:
            part.write_bytes(b"".join(out))


def _refuse_taken(folder, shapes):
    """Nothing that a rig was read from is written over."""
    there = {file.name.casefold(): file.name for file in folder.iterdir()}
    taken = [there[n] for n in (f"{name}.obj".casefold() for name in shapes) if n in there]
    if taken:
        raise ValueError(
            f"shapes: {folder} has {', '.join(taken)} already; give other names, for what is there "
            "is not changed."
        )
