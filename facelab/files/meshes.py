"""A mesh from any kind of file, chosen by its ending."""

import warnings
from pathlib import Path

from facelab.checks import check_choice, check_number
from facelab.files.gltf_read import read_gltf_file
from facelab.files.obj import read_obj_file
from facelab.files.ply import read_ply_file
from facelab.files.stl import read_stl_file
from facelab.geometry.size import check_face_size

KINDS = (".obj", ".ply", ".glb", ".gltf", ".vrm", ".stl")
"""Endings of files that hold a mesh that can be read."""

_METRES = 1000.0  # the unit of glTF, by its specification
_ELSEWHERE = {
    ".fbx": "open it in Blender (File > Import > FBX) and save it as GLB (File > Export > glTF "
    "2.0, with Shape Keys under Data > Mesh), or convert it with FBX2glTF",
    ".blend": "open it in Blender and save it as GLB (File > Export > glTF 2.0)",
    ".dae": "open it in Blender (File > Import > Collada) and save it as GLB",
    ".abc": "export it as GLB with its shapes, for an Alembic file holds frames and no shapes",
    ".obj": "a rig is a folder of them, the face at rest and one for each shape; give the folder",
}
_ELSEWHERE |= dict.fromkeys(
    (".usd", ".usda", ".usdc", ".usdz"),
    "open it in Blender (File > Import > USD) and save it as GLB",
)
_ELSEWHERE |= dict.fromkeys((".zip", ".gz"), "unpack it first")
_ELSEWHERE |= dict.fromkeys(
    (".ma", ".mb"), "export it from Maya as FBX, then open that in Blender and save it as GLB"
)


def read_mesh(path, mesh=None, scale=None, bad_faces="refuse"):
    """The mesh of an OBJ, PLY, STL, GLB, glTF or VRM file, its vertices in the order of the file.

    Parameters
    ----------
    path : str or Path
    mesh : str, optional
        The part to read, by name: an object or group of an OBJ, a solid of an STL, a node or mesh
        of a glTF. All parts, one after the other, if left out; see `read_parts`.
    scale : float, optional
        Millimetres in the file's unit of length: 10 for centimetres. By default 1000 for glTF,
        which counts in metres, and 1 for the others, which do not say.
    bad_faces : {"refuse", "leave out"}
        What to do about faces of OBJ and PLY files that use a vertex twice or one that does not
        exist.

    Returns
    -------
    TriangleMesh
        Millimetres. Vertices at the same place are not joined: the loose triangles of an STL, or
        the two sides of a seam in GLB and PLY; `mesh.welded()` joins them. `texture` is the
        picture of base colours, of an OBJ by its material library; of a GLB, glTF or VRM file
        where one part is read.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing, empty or damaged file, an unknown kind, or a part that it does not have;
        the message names the place in the file.

    Warns
    -----
    UserWarning
        Of what was left out (bad faces, morph targets, unknown keywords), of parts that were put
        one behind the other, and of a size that is no face's, with the factor.

    Examples
    --------
    >>> import facelab
    >>> facelab.files.write_obj("face.obj", facelab.load_template(4375))
    >>> facelab.read_mesh("face.obj").n_vertices
    4375
    """
    held, scale = _held(path, mesh, scale, bad_faces)
    if mesh is None and len(held.owned) > 1:
        warnings.warn(
            f"{held.path}: {held.contents()}; they follow one another in one mesh. Choose one with "
            f"mesh={next(iter(held.owned))!r}.",
            stacklevel=2,
        )
    found = held.whole(scale) if mesh is None else held.part(_named(held, mesh), scale)
    check_face_size(found.vertices / scale, held.path, scale, part=mesh is not None)
    return found


def read_parts(path, scale=None, bad_faces="refuse"):
    """The named parts of a mesh file, each as a TriangleMesh of its own; parameters of `read_mesh`.

    Returns
    -------
    dict of str to TriangleMesh
        Millimetres, in the order of the file; the whole mesh under the file's name if it has no
        named parts.
    """
    held, scale = _held(path, None, scale, bad_faces)
    if not held.parts:
        return {held.path.stem: held.whole(scale)}
    return {name: held.part(name, scale) for name in held.parts}


def _held(path, mesh, scale, bad_faces):
    """The `MeshFile`, and millimetres in its unit."""
    check_choice(bad_faces, "bad_faces", ("refuse", "leave out"))
    if mesh is not None and not isinstance(mesh, str):
        raise TypeError(f"mesh={mesh!r} is a {type(mesh).__name__}; give the name of a part.")
    kind = check_kind(path, KINDS)
    if scale is None:
        scale = unit_of(kind)
    scale = check_number(scale, "scale", above=0)
    if kind == ".obj":
        return read_obj_file(path, bad_faces), scale
    if kind == ".ply":
        return read_ply_file(path, bad_faces), scale
    if kind == ".stl":
        return read_stl_file(path), scale
    return read_gltf_file(path, mesh), scale


def _named(held, mesh):
    """The part that was asked for; a glTF was read for it alone, under its node's name."""
    return next(iter(held.owned)) if held.owned else mesh


def unit_of(kind):
    """Millimetres in the unit of a kind of file: 1 where it does not say."""
    return _METRES if kind in (".glb", ".gltf", ".vrm") else 1.0


def check_kind(path, kinds):
    """The ending of a path in lower case, refused unless it is one of the kinds.

    Raises
    ------
    ValueError
        With the kinds there are, and what to do about one that other programs can convert.
    TypeError
        For what is no path.
    """
    if not isinstance(path, (str, Path)):
        raise TypeError(f"path is a {type(path).__name__}; give a str or a Path.")
    kind = Path(path).suffix.lower()
    if kind not in kinds:
        remedy = f": {_ELSEWHERE[kind]}" if kind in _ELSEWHERE else ""
        raise ValueError(
            f"path={str(path)!r}: unknown kind; readable are {', '.join(kinds)}{remedy}."
        )
    return kind
