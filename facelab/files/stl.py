"""STL, text or binary: loose triangles, which `TriangleMesh.welded` joins."""

import re

import numpy as np

from facelab.files.parts import MeshFile, check_coordinates
from facelab.files.words import damaged
from facelab.storage import existing_file

_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
_NUMBER = rb"[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:e[-+]?+\d++)?+"
_ANY = rb"(?:[-+]?+(?:nan|inf)[^\s]*+|" + _NUMBER + rb")"  # normals of triangles without area
_WORDS = [  # of one facet, and what each line of it should be
    (rb"facet\s++normal" + 3 * (rb"\s++" + _ANY), "'facet normal' and three numbers"),
    (rb"outer\s++loop", "'outer loop'"),
    *[(rb"vertex" + 3 * (rb"\s++" + _NUMBER), "'vertex' and three numbers")] * 3,
    (rb"endloop", "'endloop'"),
    (rb"endfacet", "'endfacet'"),
]
_XYZ = [8, 9, 10, 12, 13, 14, 16, 17, 18]  # words of a facet that are coordinates
_FACETS = re.compile(rb"\s*+(?:" + b"".join(w + rb"\s++" for w, _ in _WORDS) + rb")*+", re.I)
_SOLID = re.compile(rb"^[ \t]*+(end)?solid\b[ \t]*+([^\r\n]*+)", re.I | re.M)


def read_stl_file(path):
    """All that an STL file holds, its solids as parts: a `MeshFile`.

    Three vertices of its own for each triangle, in the order of the file; the normals are passed
    over, for the corners run counter-clockwise.

    Raises
    ------
    FileNotFoundError, ValueError
        For a missing, empty or damaged file; the message names the place.
    """
    path = existing_file(path, "STL file")
    size = path.stat().st_size
    with open(path, "rb") as source:
        head = source.read(84)
    promised = int.from_bytes(head[80:84], "little")
    is_text = head[:5].lower() == b"solid" and (size != 84 + 50 * promised or promised == 0)
    if is_text:
        corners, parts = _text(path, path.read_bytes())
    else:
        if size != 84 + 50 * promised:
            raise damaged(
                f"{path}: not a whole STL file: {size} bytes, but its header promises {promised} "
                f"triangles, which take {84 + 50 * promised}"
            )
        facets = np.fromfile(path, _FACET, offset=84)
        corners, parts = facets["corners"].reshape(-1, 3).astype(float), {}
    if not len(corners):
        raise ValueError(f"{path}: no triangles in it; export the mesh again.")
    check_coordinates(corners, lambda row: f"{path}, triangle {row // 3}")
    return MeshFile(path, corners, np.arange(len(corners)).reshape(-1, 3), parts)


def _text(path, data):
    """Corners of all triangles and the triangles of each named solid."""
    marks = list(_SOLID.finditer(data))
    begins, ends = marks[::2], marks[1::2]
    if len(begins) != len(ends) or any(m[1] for m in begins) or not all(m[1] for m in ends):
        raise damaged(f"{path}: its lines 'solid' and 'endsolid' do not alternate")
    gaps = zip(ends, [*(m.start() for m in begins[1:]), len(data)], strict=True)
    for end, ahead in gaps:
        if data[end.end() : ahead].strip():
            line = data[: end.end()].count(b"\n") + 2
            raise ValueError(f"{path}, line {line}: there is more after 'endsolid'.")
    corners, parts, n_faces = [], {}, 0
    for begin, end in zip(begins, ends, strict=True):
        block = data[begin.end() : end.start()]
        if not _FACETS.fullmatch(block):
            _refuse_text(path, block, data[: begin.end()].count(b"\n") + 1)
        words = block.split()
        corners.append(np.array(words).reshape(-1, 21)[:, _XYZ].astype(float).reshape(-1, 3))
        faces = np.arange(n_faces, n_faces + len(words) // 21)
        n_faces += len(faces)
        if len(faces):
            name = begin[2].decode(errors="replace").strip() or "solid"
            parts[name] = np.append(parts.get(name, faces[:0]), faces)
    return np.vstack([np.empty((0, 3)), *corners]), parts if len(parts) > 1 else {}


def _refuse_text(path, block, line):
    """Say which line is not as it should be."""
    k = 0
    for number, text in enumerate(block.splitlines(), line):
        if not text.strip():
            continue
        form, wanted = _WORDS[k % 7]
        if not re.fullmatch(form, text.strip(), re.I):
            raise ValueError(
                f"{path}, line {number}: {text.decode(errors='replace').strip()[:60]!r} stands "
                f"where {wanted} is wanted."
            )
        k += 1
    raise ValueError(f"{path}: the solid that begins in line {line} ends within a triangle.")
