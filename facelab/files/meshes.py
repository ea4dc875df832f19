"""Files in and out. Readers refuse what they cannot use and say where; writers write whole files.

Vertex order is sacred: every reader keeps it. A polygon becomes a fan of triangles.
"""

import codecs
import json
from itertools import pairwise
from pathlib import Path

import numpy as np

from facelab.geometry.mesh import TriangleMesh
from facelab.storage import atomic_path, existing_file


def read_obj(path):
    """The mesh of a Wavefront OBJ file, its vertices in the order of the file.

    Texture coordinates, normals, groups and materials are passed over, polygons become fans of
    triangles, relative (negative) indices are resolved.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    TriangleMesh
        In the file's own unit: multiply the vertices to get millimetres.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file; the message names file and line.
    """
    path = existing_file(path, "OBJ file")
    vertices, polygons = [], []
    for number, words in _obj_lines(path):
        if words[0] == b"v":
            vertices.append((number, words))
        elif words[0] == b"f":
            polygons.append((number, words, len(vertices)))
    V = _obj_vertices(path, vertices)
    F = _obj_faces(path, polygons, len(V))
    return TriangleMesh(V, F)


def read_obj_vertices(path):
    """Only the vertices of an OBJ file, shape (n_vertices, 3): for shapes with known faces."""
    path = existing_file(path, "OBJ file")
    return _obj_vertices(path, [line for line in _obj_lines(path) if line[1][0] == b"v"])


def _obj_lines(path):
    text = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    if b"\0" in text[:4096]:
        raise ValueError(f"{path}: this is a binary file, not an OBJ text file.")
    held = b""
    for number, line in enumerate([*text.splitlines(), b""], 1):
        line = held + line
        held = line[:-1] + b" " if line.endswith(b"\\") else b""
        words = [] if held else line.split(b"#", 1)[0].split()
        if words:
            yield number, words


def _obj_vertices(path, lines):
    if not lines:
        raise ValueError(f"{path}: no vertices (no line starts with 'v'); is this an OBJ file?")
    try:
        V = np.array([words[1:4] for _, words in lines], dtype=float)
    except ValueError:
        V = None
    if V is None or V.shape[1:] != (3,) or not np.isfinite(V).all():
        for number, words in lines:  # slow, only to say where
            text = b" ".join(words).decode(errors="replace")
            try:
                numbers = [float(w) for w in words[1:4]]
            except ValueError:
                raise ValueError(f"{path}, line {number}: {text!r} holds no numbers.") from None
            if len(numbers) != 3:
                raise ValueError(f"{path}, line {number}: {text!r} has not three coordinates.")
            if not np.isfinite(numbers).all():
                raise ValueError(
                    f"{path}, line {number}: {text!r} holds NaN or infinity; repair that vertex."
                )
    return V


def _obj_faces(path, lines, n_vertices):
    if not lines:
        raise ValueError(f"{path}: vertices but no faces (no line starts with 'f').")
    faces = []
    for number, words, so_far in lines:
        try:
            polygon = [int(word.split(b"/", 1)[0]) for word in words[1:]]
        except ValueError:
            text = b" ".join(words).decode(errors="replace")
            raise ValueError(f"{path}, line {number}: {text!r} is not a list of indices.") from None
        if len(polygon) < 3:
            raise ValueError(
                f"{path}, line {number}: a face with {len(polygon)} corner(s); it needs 3 or more."
            )
        for corner in polygon:
            if corner == 0 or corner > n_vertices or -corner > so_far:
                raise ValueError(
                    f"{path}, line {number}: index {corner} is out of range; the file has "
                    f"{n_vertices} vertices, counted from 1 (or back from -1)."
                )
        polygon = [i - 1 if i > 0 else so_far + i for i in polygon]
        if len(set(polygon)) < len(polygon):
            raise ValueError(f"{path}, line {number}: the face uses a vertex twice; remove it.")
        faces += [(polygon[0], b, c) for b, c in pairwise(polygon[1:])]
    return np.array(faces)


def write_obj(path, mesh):
    """Write a mesh as Wavefront OBJ, whole or not at all.

    Parameters
    ----------
    path : str or Path
    mesh : TriangleMesh
        Written in its own unit (millimetres here), nine significant digits.
    """
    with atomic_path(path) as part, open(part, "w") as out:
        out.write("# facelab; unit: millimetre\n")
        np.savetxt(out, mesh.vertices, fmt="v %.9g %.9g %.9g")
        np.savetxt(out, mesh.faces + 1, fmt="f %d %d %d")


def read_mesh(path):
    """The mesh of an OBJ, PLY, GLB, glTF or STL file, its vertices in the order of the file.

    Parameters
    ----------
    path : str or Path
        OBJ goes to `read_obj`; the others are read by trimesh, without merging vertices.

    Returns
    -------
    TriangleMesh
        In the file's own unit. The parts of a scene follow one another.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file, or an unknown kind.

    Examples
    --------
    >>> import facelab
    >>> facelab.files.write_obj("face.obj", facelab.load_template(4375))
    >>> facelab.read_mesh("face.obj").n_vertices
    4375
    """
    kinds = (".obj", ".ply", ".glb", ".gltf", ".stl")
    if Path(path).suffix.lower() not in kinds:
        raise ValueError(f"path={str(path)!r}: unknown kind; readable are {', '.join(kinds)}.")
    if Path(path).suffix.lower() == ".obj":
        return read_obj(path)
    import trimesh

    path = existing_file(path, "mesh file")
    try:
        if path.suffix.lower() == ".gltf":
            json.loads(path.read_bytes())  # for a damaged one trimesh looks for another file
        scene = trimesh.load_scene(path, process=False)
        parts = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh)]
    except Exception as error:  # each format fails in its own way: make it one
        raise ValueError(f"{path}: not a readable {path.suffix} file ({error}).") from error
    if not parts:
        raise ValueError(f"{path}: no triangles in it; is it a point cloud or an empty scene?")
    if path.suffix.lower() == ".ply":
        _refuse_cut_ply(path)
    start = np.cumsum([0] + [len(p.vertices) for p in parts])
    faces = np.vstack([p.faces + s for p, s in zip(parts, start[:-1], strict=True)])
    try:
        return TriangleMesh(np.vstack([p.vertices for p in parts]), faces)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _refuse_cut_ply(path):
    """Refuse an ASCII PLY that ends early: trimesh reads what is there without a word."""
    head, _, body = path.read_bytes().partition(b"end_header")
    if b"format ascii" not in head:
        return
    rows = [row.split() for row in body.splitlines() if row.strip()]
    wanted = sum(int(w[2]) for w in map(bytes.split, head.splitlines()) if w[:1] == [b"element"])
    last = head.rpartition(b"element face ")[2].splitlines()[1:]  # properties of the last element
    is_list = len(last) == 1 and last[0].startswith(b"property list")
    if len(rows) < wanted or (is_list and len(rows[-1]) <= int(rows[-1][0])):
        raise ValueError(
            f"{path}: the file ends early, after {len(rows)} of {wanted} rows; export it again."
        )


def write_ply(path, mesh):
    """Write a mesh as binary PLY, whole or not at all; positions in float32, millimetres."""
    import trimesh

    data = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="ply")
    with atomic_path(path) as part:
        part.write_bytes(data)
