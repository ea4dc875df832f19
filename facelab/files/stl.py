"""STL, text or binary: loose triangles, which `TriangleMesh.welded` joins."""

import codecs
import re
import warnings

import numpy as np

from facelab.files.parts import MeshFile, check_coordinates
from facelab.files.words import damaged
from facelab.storage import existing_file

_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
_NUMBER = rb"[-+]?+(?:\d++\.?+\d*+|\.\d++)(?:e[-+]?+\d++)?+"
_ANY = rb"(?:[-+]?+(?:nan|inf|1\.#)[^\s]*+|" + _NUMBER + rb")"  # normals of triangles without area
_WORDS = [  # of one facet, and what each line of it should be
    (rb"facet\s++normal" + 3 * (rb"\s++" + _ANY), "'facet normal' and three numbers"),
    (rb"outer\s++loop", "'outer loop'"),
    *[(rb"vertex" + 3 * (rb"\s++" + _NUMBER), "'vertex' and three numbers")] * 3,
    (rb"endloop", "'endloop'"),
    (rb"endfacet", "'endfacet'"),
]
_XYZ = [8, 9, 10, 12, 13, 14, 16, 17, 18]  # words of a facet that are coordinates
_FACETS = re.compile(rb"\s*+(?:" + b"".join(w + rb"\s++" for w, _ in _WORDS) + rb")*+", re.I)
_FIRST = rb"\bfacet[ \t]++normal[ \t]++" + _ANY  # ends a name, for all may stand in one line
_SOLID = re.compile(rb"\s*+solid\b((?:(?!" + _FIRST + rb")[^\n])*+)", re.I)
_NEXT = rb"\bsolid\b[^\n]{0,200}?" + _FIRST
_END = re.compile(rb"endsolid\b(?:(?!" + _NEXT + b"|" + _FIRST + rb")[^\n])*+", re.I)


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
    unsaid = promised in (0, 0xFFFFFFFF) and size > 84 and (size - 84) % 50 == 0
    if unsaid:
        warnings.warn(
            f"{path}: its header counts {promised} triangles, as programs write it that count "
            f"last; its size is that of {(size - 84) // 50}, which are read.",
            stacklevel=4,
        )
    if size == 84 + 50 * promised or unsaid:
        facets = np.fromfile(path, _FACET, offset=84)
        corners, parts = facets["corners"].reshape(-1, 3).astype(float), {}
    elif head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ValueError(f"{path}: this is UTF-16 text; save it as UTF-8, or export it again.")
    elif b"\0" in head:  # no text, and every count of triangles below 16 million holds one
        raise damaged(
            f"{path}: not a whole STL file: {size} bytes, but its header promises {promised} "
            f"triangles, which take {84 + 50 * promised}"
        )
    else:
        corners, parts = _text(path, path.read_bytes().removeprefix(codecs.BOM_UTF8))
    if not len(corners):
        raise ValueError(f"{path}: no triangles in it; export the mesh again.")
    check_coordinates(corners, lambda row: f"{path}, triangle {row // 3}")
    return MeshFile(path, corners, np.arange(len(corners)).reshape(-1, 3), parts)


def _text(path, data):
    """Corners of all triangles and the triangles of each named solid."""
    data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n").rstrip() + b"\n"
    corners, parts, n_faces, at = [], {}, 0, 0
    while at < len(data) - 1:
        begin = _SOLID.match(data, at)
        if not begin and at == 0:
            raise ValueError(
                f"{path}: it begins with {_shown(data)}, so it is no STL file: a text begins with "
                "'solid', and a binary file has the number of its triangles after 80 bytes."
            )
        if not begin:
            line, _ = _place(data, at)
            raise ValueError(f"{path}, line {line}: there is more after 'endsolid'.")
        facets = _FACETS.match(data, begin.end())
        end = _END.match(data, facets.end())
        if not end:
            _refuse_text(path, data, facets.end())
        words = facets[0].split()
        corners.append(np.array(words).reshape(-1, 21)[:, _XYZ].astype(float).reshape(-1, 3))
        faces = np.arange(n_faces, n_faces + len(words) // 21)
        n_faces += len(faces)
        if len(faces):
            name = begin[1].decode(errors="replace").strip() or "solid"
            parts[name] = np.append(parts.get(name, faces[:0]), faces)
        at = end.end()
    return np.vstack([np.empty((0, 3)), *corners]), parts if len(parts) > 1 else {}


def _refuse_text(path, data, at):
    """Say what stands at the end of the last whole triangle, or within the next one."""
    for k, (form, wanted) in enumerate(_WORDS):
        line, text = _place(data, at)
        if not text:
            inside = "within a triangle" if k else "without 'endsolid'"
            raise damaged(f"{path}: it ends {inside}")
        found = re.compile(form + rb"\s++", re.I).match(data, at)
        if not found:
            wanted = wanted if k else f"{wanted} or 'endsolid'"
            raise ValueError(f"{path}, line {line}: {text} stands where {wanted} is wanted.")
        at = found.end()


def _place(data, at):
    """Line of the next word, and what stands there."""
    at += len(data[at:]) - len(data[at:].lstrip())
    return data.count(b"\n", 0, at) + 1, _shown(data[at:])


def _shown(data):
    text = data.lstrip().partition(b"\n")[0][:60].decode(errors="replace").strip()
    return repr(text) if text else ""
