"""Files in and out. Readers refuse what they cannot use and say where; writers write whole files.

Vertex order is sacred: every reader keeps it. A polygon becomes a fan of triangles.
"""

import codecs
import csv
import json
import os
import re
import tempfile
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from facelab.mesh import TriangleMesh
from facelab.motion import WeightSequence


@contextmanager
def atomic_path(path):
    """A temporary path beside `path` that takes its place when all went well, else vanishes."""
    path = _as_path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"path={str(path)!r}: the folder {path.parent} does not exist.")
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    try:
        yield Path(name)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _as_path(path):
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path is a {type(path).__name__}; give a str or a Path.")
    return Path(path)


def existing_file(path, what):
    """The path as a `Path`, refused unless it is a file with something in it.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, for the message ("OBJ file").

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing file, a folder or an empty file, or what is no path.
    """
    path = _as_path(path)
    if not path.exists():
        raise FileNotFoundError(f"path={str(path)!r}: there is no such {what}.")
    if not path.is_file():
        raise ValueError(f"path={str(path)!r} is not a file; give the path of one {what}.")
    if path.stat().st_size == 0:
        raise ValueError(f"path={str(path)!r} is empty; export the {what} again.")
    return path


# --- OBJ ------------------------------------------------------------------------------------------


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


# --- PLY, GLB and others, by trimesh --------------------------------------------------------------


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


# --- Live Link Face -------------------------------------------------------------------------------

_LIVE_LINK_ANGLES = tuple(
    f"{part}{axis}" for part in ("Head", "LeftEye", "RightEye") for axis in ("Yaw", "Pitch", "Roll")
)
_LONGEST_GAP = 600  # seconds that may be missing within one take


def read_live_link_csv(path):
    """A performance recorded with the Live Link Face app.

    Names become ARKit's own spelling (`eyeBlinkLeft`). Time codes put every frame in its place:
    frames that the recorder dropped are inserted as lost ones, and so are frames that repeat
    the one before exactly (the tracker had lost the face).

    Parameters
    ----------
    path : str or Path
        CSV with the columns Timecode, BlendShapeCount, 52 ARKit weights and nine angles.

    Returns
    -------
    WeightSequence
        `valid` is False in lost frames; weights as recorded, not clipped; `angles` in radians.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing or empty file, other columns, a row of another length, a value that is not
        a number; the message names file and line.
    """
    path = existing_file(path, "Live Link CSV file")
    with open(path, newline="", encoding="utf-8-sig", errors="replace") as source:
        try:
            lines = csv.reader(source, quoting=csv.QUOTE_NONE)
            rows = [(n, row) for n, row in enumerate(lines, 1) if row]
        except csv.Error as error:
            raise ValueError(f"{path}: not a CSV text file ({error}).") from error
    header = [name.strip() for name in rows[0][1]] if rows else []
    missing = [c for c in ("Timecode", "BlendShapeCount", "JawOpen") if c not in header]
    if missing or header[:2] != ["Timecode", "BlendShapeCount"] or "" in header:
        wrong = f"the column(s) {', '.join(missing)} are missing" if missing else "other columns"
        raise ValueError(
            f"{path}, line 1: {wrong}; a Live Link Face CSV starts with Timecode, BlendShapeCount "
            "and 52 ARKit names, and names every column."
        )
    twice = sorted({c for c in header if header.count(c) > 1})
    if twice:
        raise ValueError(f"{path}, line 1: column(s) {', '.join(twice)} stand more than once.")
    if len(rows) < 2:
        raise ValueError(f"{path}: no frames below the header.")
    stamps, values = [], []
    for number, row in rows[1:]:
        if len(row) != len(header):
            raise ValueError(
                f"{path}, line {number}: {len(row)} values, but the header names {len(header)}."
            )
        try:
            stamps.append(_time_code(row[0]))
            values.append([float(v) for v in row[2:]])
        except ValueError as error:
            raise ValueError(f"{path}, line {number}: {error}.") from None
        if not np.isfinite(values[-1]).all():
            raise ValueError(f"{path}, line {number}: NaN or infinity; remove that frame.")
    return _place_in_time(path, header[2:], np.array(values), stamps, [n for n, _ in rows[1:]])


def _time_code(text):
    found = re.fullmatch(r"(\d\d):([0-5]\d):([0-5]\d):(\d+(?:\.\d*)?)", text.strip(), re.ASCII)
    if not found:
        raise ValueError(f"time code {text!r} is not HH:MM:SS:FF.fff")
    hours, minutes, seconds = (int(p) for p in found.groups()[:3])
    return hours * 3600 + minutes * 60 + seconds, float(found[4])


def _place_in_time(path, names, values, stamps, lines):
    most = max(frame for _, frame in stamps)
    # only where a second ends the frames within it show their number; else 30 or 60 are assumed
    known = (24, 25, 30, 50, 60, 120) if stamps[0][0] != stamps[-1][0] else (30, 60, 120)
    base = next((rate for rate in known if most < rate), None)
    if base is None:
        raise ValueError(f"{path}: a time code counts {most:g} frames in a second; 120 at most.")
    seconds = np.array([second + frame / base for second, frame in stamps])
    step = np.diff(seconds)
    if (step <= 0).any():
        line = lines[np.flatnonzero(step <= 0)[0] + 1]
        raise ValueError(f"{path}, line {line}: the time code does not run forwards.")
    if (step > _LONGEST_GAP).any():
        line = lines[np.flatnonzero(step > _LONGEST_GAP)[0] + 1]
        raise ValueError(
            f"{path}, line {line}: the time code leaps {step.max():.0f} seconds, and a gap may "
            f"last {_LONGEST_GAP}; split the take there."
        )
    fps = float(round(1 / np.median(step))) if len(step) else float(base)
    if not 1 <= fps <= 120:
        raise ValueError(f"{path}: the time codes amount to {fps:g} frames/s; 1 to 120 make sense.")
    # counted step by step, for the recorder's clock drifts; jitter never puts two in one place
    slot = np.append(0, np.cumsum(np.maximum(1, np.round(step * fps)))).astype(int)
    valid = np.zeros(slot[-1] + 1, dtype=bool)
    valid[slot] = np.append(True, (np.diff(values, axis=0) != 0).any(axis=1))
    placed = np.full((len(valid), values.shape[1]), np.nan)
    placed[slot] = values
    is_angle = np.array([name in _LIVE_LINK_ANGLES for name in names])
    arkit = tuple(n[0].lower() + n[1:] for n in np.array(names)[~is_angle].tolist())
    angles = {n: placed[:, i] for i, n in enumerate(names) if is_angle[i]}
    return WeightSequence(placed[:, ~is_angle], arkit, fps, valid, angles)


# --- npz ------------------------------------------------------------------------------------------


def save_npz(path, kind, version, **arrays):
    """Write named arrays to one compressed file, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Ends in .npz.
    kind : str
        What the file holds; `load_npz` refuses files of another kind.
    version : int
        Layout of that kind; raise it when the arrays change.
    **arrays : array_like
        Numbers or strings; Python objects are refused, for they would need pickle.
    """
    if Path(path).suffix != ".npz":
        raise ValueError(f"path={str(path)!r} must end in .npz.")
    arrays = {name: np.asarray(a) for name, a in arrays.items()}
    objects = [name for name, a in arrays.items() if a.dtype.hasobject]
    if objects:
        raise TypeError(
            f"{', '.join(objects)}: Python objects cannot be stored; give plain arrays."
        )
    with atomic_path(path) as part, open(part, "wb") as out:
        np.savez_compressed(out, facelab_kind=kind, facelab_version=version, **arrays)


def load_npz(path, kind, version):
    """Arrays of a file written by `save_npz`, as a dict; never unpickles anything.

    Raises
    ------
    FileNotFoundError, ValueError
        If the file is missing, damaged, of another kind or of another version.
    """
    path = existing_file(path, "npz file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        found = str(arrays.pop("facelab_kind")), int(arrays.pop("facelab_version"))
    except Exception as error:  # zip, header and pickle refusals each raise their own
        raise ValueError(f"{path}: not a readable facelab npz file ({error}).") from error
    if found != (kind, version):
        raise ValueError(
            f"{path} holds {found[0]!r} of version {found[1]}, but {kind!r} of version {version} "
            "is wanted; make the file again with this version of facelab."
        )
    return arrays
