"""Wavefront OBJ: a small strict reader, for vertex order is sacred; and a writer."""

import codecs
import re
import warnings
from itertools import pairwise

import numpy as np

from facelab.files.obj_texture import texture_of, uncommented
from facelab.files.parts import MeshFile, check_coordinates, triangles_of
from facelab.files.pictures import or_left_out
from facelab.files.words import damaged, listed
from facelab.storage import atomic_path, existing_file

_KEYWORDS = set(  # of the format, beside v, vt, vn, f, fo, o and g: passed over
    b"vp deg bmat step cstype p l parm trim hole scrv sp end con s mg bevel "
    b"c_interp d_interp lod usemtl mtllib usemap maplib shadow_obj trace_obj ctech stech csh "
    b"bsp bzp cdc cdp res".split()
)
_FORMS = (b"surf", b"curv", b"curv2", b"call")  # what would be more of the mesh
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_NUMBERS = re.compile(rb"(?:[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:[eE][-+]?+\d++)?+(?: |\Z))*+")
_UNEVEN = (b"\\", b"\n ", b"\n\t", b"\r ", b"\r\t", b"\nv\t", b"\nf\t")  # goes on, or is set in
_CORNER = re.compile(rb"([-+]?\d{1,10})(?:/([-+]?\d{1,10})?(?:/([-+]?\d{1,10})?)?)?")
_PLAIN = [  # all corners of a file of one form: index, how many numbers, which of v, vt, vn
    (re.compile(rb"(?:-?\d{1,10} )*"), (0,)),
    (re.compile(rb"(?:-?\d{1,10}/-?\d{1,10} )*"), (0, 1)),
    (re.compile(rb"(?:-?\d{1,10}//-?\d{1,10} )*"), (0, 2)),
    (re.compile(rb"(?:-?\d{1,10}/-?\d{1,10}/-?\d{1,10} )*"), (0, 1, 2)),
]


def read_obj(path, bad_faces="refuse"):
    """The mesh of a Wavefront OBJ file, its vertices in the order of the file.

    The picture of base colour that its material library names becomes its texture; normals and
    all else of materials are passed over. Relative (negative) indices are resolved, polygons are
    cut into triangles that lie inside them.

    Parameters
    ----------
    path : str or Path
    bad_faces : {"refuse", "leave out"}
        What to do about faces with fewer than three corners, with a corner twice, or with a
        vertex that does not exist.

    Returns
    -------
    TriangleMesh
        In the file's own unit: multiply the vertices to get millimetres, or use `read_mesh`.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file; the message names file and line.

    Warns
    -----
    UserWarning
        Naming lines that were left out, unknown keywords, curves and surfaces that are no polygons,
        texture coordinates or normals that are named but not there, and a texture that could not
        be read.
    """
    return read_obj_file(path, bad_faces).whole()


def read_obj_vertices(path):
    """Only the vertices of an OBJ file, shape (n_vertices, 3): for shapes with known faces."""
    return read_obj_rows(path)[0]


def read_obj_rows(path):
    """Vertices of an OBJ file, shape (n_vertices, 3), and its lines of faces, to be compared."""
    path = existing_file(path, "OBJ file")
    text = _text(path)
    if not any(mark in text for mark in _UNEVEN):  # quick, for files as programs write them
        lines = text.splitlines()
        rows = [line for line in lines if line.startswith(b"v ")]
        words = b" ".join(rows).split()
        if len(words) == 4 * len(rows) > 0 and words[::4].count(b"v") == len(rows):
            del words[::4]
            if _NUMBERS.fullmatch(b" ".join(words)):
                V = np.array(words, dtype=float).reshape(-1, 3)
                if np.isfinite(V).all():
                    check_coordinates(V, lambda row: f"{path}, vertex {row}")
                    return V, [line for line in lines if line.startswith(b"f ")]
    lines = list(_lines(text))
    faces = [b" ".join(words) for _, words in lines if words[0] == b"f"]
    return _vertices(path, [(n, words) for n, words in lines if words[0] == b"v"]), faces


def read_obj_polygons(path):
    """Vertices of all corners of all faces of an OBJ file, and how many each face has: two lists.

    As the file has them, to be compared: bad ones are -1.
    """
    path = existing_file(path, "OBJ file")
    corners, _, counts = _corners(path, _Lines(path))
    return corners.tolist(), counts.tolist()


def read_obj_file(path, bad_faces="refuse"):
    """All that an OBJ file holds, its objects and groups as parts: a `MeshFile`; as `read_obj`."""
    path = existing_file(path, "OBJ file")
    lines = _Lines(path)
    V = _vertices(path, lines.vertices)
    corners, on_picture, counts = _corners(path, lines)
    _say_unknown(path, lines.unknown)
    if lines.forms:
        warnings.warn(
            f"{path}: {len(lines.forms)} curve(s), surface(s) or other file(s) that it calls are "
            f"not read, the first in line {lines.forms[0]}; export them as polygons.",
            stacklevel=3,
        )
    words = [word for _, corners, _ in lines.polygons for word in corners]
    F, owner, kept = triangles_of(
        path, V, corners, counts, bad_faces,
        place=lambda k: f"line {lines.polygons[k][0]}",
        lacks=lambda at: (
            f"index {words[at].split(b'/')[0].decode()} is out of range; the file has {len(V)} "
            "vertices, counted from 1 (or back from -1)"
        ),
        words=(
            "a face with {} corner(s); it needs 3 or more", "the face uses a vertex twice",
        ),
    )  # fmt: skip
    texture = None
    if lines.libraries and lines.materials and lines.places:
        polygon = np.repeat(np.arange(len(counts)), counts)
        own = on_picture[kept][_corner_of(F, owner, corners[kept], polygon[kept])]
        texture = or_left_out(
            texture_of, path, lines.places, lines.libraries, lines.materials, own, owner
        )
    return MeshFile(path, V, F, _parts(lines.sections, owner), texture=texture)


class _Lines:
    """The lines of an OBJ file by what they say, with their numbers or what stands before them."""

    def __init__(self, path):
        self.vertices, self.places, self.n_normals = [], [], 0
        self.polygons, self.sections, self.unknown = [], [], []
        self.libraries, self.materials, self.forms = [], [], []
        for number, words in _lines(_text(path)):
            word = words[0]
            if word == b"v":
                self.vertices.append((number, words))
            elif word in (b"f", b"fo"):
                self.polygons.append((number, words[1:], self.totals))
            elif word == b"vt":
                self.places.append((number, words))
            elif word == b"vn":
                self.n_normals += 1
            elif word in (b"o", b"g"):
                names = [b" ".join(words[1:])] if word == b"o" else words[1:]
                names = [n.decode(errors="replace") for n in names if n]
                self.sections.append((len(self.polygons), word, names))
            elif word == b"mtllib":
                self.libraries.append(b" ".join(words[1:]))
            elif word == b"usemtl":
                self.materials.append((len(self.polygons), b" ".join(words[1:])))
            elif word in _FORMS:
                self.forms.append(number)
            elif word not in _KEYWORDS:
                self.unknown.append((number, words))

    @property
    def totals(self):
        """Vertices, texture coordinates and normals so far."""
        return len(self.vertices), len(self.places), self.n_normals


def _corner_of(F, owner, corners, polygon):
    """Which corner of the polygons each corner of their triangles is: shape of F."""
    n = corners.max() + 1
    keys = polygon * n + corners  # no polygon has a vertex twice
    order = np.argsort(keys)
    return order[np.searchsorted(keys, owner[:, None] * n + F, sorter=order)]


def _text(path):
    text = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    if b"\0" in text[:4096]:
        raise ValueError(
            f"{path}: this is a binary file or UTF-16 text, not an OBJ text file; save it as "
            "UTF-8, or export it again."
        )
    return text


def _lines(text):
    """Number and words of every line that holds any, comments left out."""
    held = b""
    for number, line in enumerate([*text.splitlines(), b""], 1):
        line = held + line
        held = line[:-1] + b" " if line.endswith(b"\\") else b""
        words = [] if held else uncommented(line).split()
        if words:
            yield number, words


def _shown(words):
    text = b" ".join(words).decode(errors="replace")
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _say_unknown(path, unknown):
    """Refuse lines that look like data under a word that OBJ does not have; say the others."""
    for number, words in unknown:
        is_data = all(_NUMBER.fullmatch(w) or _CORNER.fullmatch(w) for w in words[1:])
        if (len(words) > 2 and is_data) or _NUMBER.fullmatch(words[0]):
            raise ValueError(
                f"{path}, line {number}: {_shown(words)} looks like data, but OBJ has no keyword "
                f"{_shown(words[:1])}; repair the line, or put '#' before it."
            )
    if unknown:
        words = sorted({_shown(w[:1]) for _, w in unknown})
        warnings.warn(
            f"{path}: {len(unknown)} line(s) with keywords that OBJ does not have were passed over:"
            f" {listed(words)}; the first is line {unknown[0][0]}.",
            stacklevel=4,
        )


def _vertices(path, lines):
    if not lines:
        raise ValueError(f"{path}: no vertices (no line starts with 'v'); is this an OBJ file?")
    lengths = {len(words) for _, words in lines}
    try:  # three coordinates, with a weight or a colour, or both, behind them
        V = np.array([words[1:4] for _, words in lines], dtype=float)
        if lengths != {4}:
            np.array([w for _, words in lines for w in words[4:]], dtype=float)
    except ValueError:
        V = None
    odd = V is None or not lengths <= {4, 5, 7, 8}
    if odd or not np.isfinite(V).all() or any(b"_" in b"".join(w) for _, w in lines):
        for number, words in lines:  # slow, only to say where
            _refuse_vertex(path, number, words)
    check_coordinates(V, lambda row: f"{path}, line {lines[row][0]}")
    return V


def _refuse_vertex(path, number, words):
    at = f"{path}, line {number}: {_shown(words)}"
    for word in words[1:]:
        if not _NUMBER.fullmatch(word):
            if word.lower().lstrip(b"+-") in (b"nan", b"inf", b"infinity"):
                raise ValueError(f"{at} holds NaN or infinity; repair that vertex.")
            if _NUMBER.fullmatch(word.replace(b",", b".")):
                raise ValueError(
                    f"{at} has decimal commas, but OBJ has points; export it again, with the "
                    "program set to English numbers."
                )
            raise damaged(f"{at} holds no numbers ({_shown([word])})")
    if len(words) < 4:
        raise ValueError(f"{at} has not three coordinates.")
    if len(words) not in (4, 5, 7, 8):
        raise ValueError(
            f"{at} has {len(words) - 1} numbers; three coordinates may be followed by a weight, by "
            "a colour, or both."
        )
    if not np.isfinite([float(w) for w in words[1:4]]).all():
        raise ValueError(f"{at} holds NaN or infinity; repair that vertex.")


def _corners(path, lines):
    """Vertex and texture coordinates of each corner of all faces, and how many a face has.

    Both are counted from 0; -1 where there is none.
    """
    polygons = lines.polygons
    if not polygons:
        raise ValueError(f"{path}: vertices but no faces (no line starts with 'f').")
    counts = np.array([len(words) for _, words, _ in polygons])
    joined = b" ".join([w for _, words, _ in polygons for w in words]) + b" " * bool(counts.sum())
    for form, columns in _PLAIN:
        if form.fullmatch(joined):
            numbers = np.fromstring(joined.replace(b"/", b" "), dtype=np.int64, sep=" ")
            found = np.zeros((counts.sum(), 3), dtype=np.int64)
            found[:, columns] = numbers.reshape(-1, len(columns))
            named = np.isin(np.arange(3), columns) & np.ones((len(found), 1), dtype=bool)
            break
    else:
        found, named = _mixed_corners(path, polygons)
    so_far = np.repeat(np.array([s for _, _, s in polygons]), counts, axis=0)
    index = np.where(found < 0, found + so_far, found - 1)
    index[(found == 0) | (index >= lines.totals)] = -1
    missing = (named & (index < 0))[:, 1:].any(axis=1)
    if missing.any():
        lines = np.repeat([n for n, _, _ in polygons], counts)[missing]
        warnings.warn(
            f"{path}: {len(set(lines.tolist()))} face(s) name texture coordinates or normals that "
            f"the file does not have, the first in line {lines[0]}; they are passed over here.",
            stacklevel=4,
        )
    return index[:, 0].copy(), np.where(named[:, 1], index[:, 1], -1), counts


def _mixed_corners(path, polygons):
    """Numbers of corners of many forms, 0 where there is none, and where there is one."""
    found, uneven = [], []
    for number, words, _ in polygons:
        matches = [_CORNER.fullmatch(w) for w in words]
        if not all(matches):
            raise ValueError(
                f"{path}, line {number}: {_shown([b'f', *words])} is not a list of indices."
            )
        if len({tuple(g is None for g in m.groups()) for m in matches}) > 1:
            uneven.append(number)
        found += [m.groups() for m in matches]
    if uneven:
        warnings.warn(
            f"{path}: {len(uneven)} face(s) give texture coordinates or normals to some of their "
            f"corners only, the first in line {uneven[0]}; they are passed over here.",
            stacklevel=5,
        )
    named = np.array([[g is not None for g in groups] for groups in found])
    return np.array([[int(g or 0) for g in groups] for groups in found], dtype=np.int64), named


def _parts(sections, owner):
    """Triangles of each object and group; a name of both is the object's."""
    parts, starts = {}, {}
    for kind in (b"o", b"g"):
        own = [(begin, names) for begin, word, names in sections if word == kind]
        taken = set(starts)
        for (begin, names), (end, _) in pairwise([*own, (np.inf, [])]):
            for name in names:
                if name not in taken:
                    starts.setdefault(name, []).append((begin, end))
    for name, runs in starts.items():
        mask = np.zeros(len(owner), dtype=bool)
        for begin, end in runs:
            mask |= (owner >= begin) & (owner < end)
        if mask.any():
            parts[name] = np.flatnonzero(mask)
    return parts


def write_obj(path, mesh):
    """Write a mesh as Wavefront OBJ, whole or not at all.

    Parameters
    ----------
    path : str or Path
    mesh : TriangleMesh
        Written in its own unit (millimetres here), nine significant digits.
    """
    with atomic_path(path) as part, open(part, "w", encoding="utf-8", newline="\n") as out:
        out.write("# facelab; unit: millimetre\n")
        np.savetxt(out, mesh.vertices, fmt="v %.9g %.9g %.9g")
        np.savetxt(out, mesh.faces + 1, fmt="f %d %d %d")
