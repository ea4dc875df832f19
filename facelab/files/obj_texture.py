"""The picture of an OBJ mesh, by way of its material library.

References
----------
Wavefront Technologies, Advanced Visualizer manual, appendices B1 (object files) and B2 (materials).
"""

import codecs
import re

import numpy as np

from facelab.files.pictures import MOST_BYTES, bytes_beside, most_seen, picture
from facelab.files.words import damaged
from facelab.geometry.texture import Texture

_COMMENT = re.compile(rb"(?:^|\s)#")
_MOST_OF_TEXT = 16 << 20  # bytes of a library


def texture_of(path, places, libraries, materials, corners, polygon):
    """The texture of a mesh, or None; of several pictures the one on most triangles.

    Parameters
    ----------
    path : Path
    places : list of (int, list of bytes)
        Number and words of each line of texture coordinates.
    libraries : list of bytes
        Rest of each line that names material libraries.
    materials : list of (int, bytes)
        How many polygons stand before a material is taken up, and its name.
    corners : ndarray of int, shape (n_faces, 3)
        Place of each corner of each triangle, -1 for none.
    polygon : ndarray of int, shape (n_faces,)
        That each triangle comes from, as the file has them.

    Returns
    -------
    Texture or None
    """
    pictures = {}
    for names in libraries:
        pictures |= _library(path, names)
    starts = [begin for begin, _ in materials]
    used = np.array([pictures.get(name, "") for _, name in [(0, b""), *materials]])
    on = used[np.searchsorted(starts, polygon, side="right")]
    on[(corners < 0).any(axis=1)] = ""
    found, counts = np.unique(on[on != ""], return_counts=True)
    if not found.size:
        return None
    chosen = most_seen(path, dict(zip(found.tolist(), counts.tolist(), strict=True)))
    uv = np.full((len(polygon), 3, 2), np.nan, np.float32)
    uv[on == chosen] = _coordinates(path, places)[corners[on == chosen]]
    return Texture(_image(path, chosen), uv)


def uncommented(line):
    """A line, in bytes, without its comment; a `#` within a word is part of a name."""
    return _COMMENT.split(line, maxsplit=1)[0] if b"#" in line else line


def _coordinates(path, places):
    """Texture coordinates, from the upper left corner down: shape (n, 2)."""
    try:
        uv = np.array([(words[1:] + [b"0"])[:2] for _, words in places], dtype=float)
    except ValueError:
        uv = np.full((1, 2), np.nan)
    if not (np.abs(uv) < 1e4).all():
        raise damaged(f"{path}: lines that start with 'vt' do not all hold sound numbers")
    return uv * [1, -1] + [0, 1]


def _library(path, names):
    """What each material of libraries says of its picture; one name, blanks and all, or many."""
    names = names.decode(errors="replace").replace("\\", "/")
    pictures, current = {}, None
    for name in [names] if (path.parent / names).is_file() else names.split():
        text = bytes_beside(path, name, "a material library (mtllib)", _MOST_OF_TEXT)
        for line in text.removeprefix(codecs.BOM_UTF8).splitlines():
            word, _, rest = uncommented(line).strip().partition(b" ")
            if word == b"newmtl":
                current = rest.strip()
            elif word.lower() == b"map_kd":
                pictures[current] = rest.strip().decode(errors="replace")
    return pictures


def _image(path, said):
    """The picture that a material names, from the folder of the mesh."""
    if said.startswith("-"):
        raise ValueError(
            f"{path}: its materials give options with a picture (map_Kd {said[:40]!r}), which are "
            "not read; give the name of the picture alone."
        )
    name = said.replace("\\", "/")
    if ":" in name or name.startswith("/"):  # where it was when the file was written
        name = name.rsplit("/", 1)[-1]
    stored = bytes_beside(path, name, "a picture (map_Kd)", MOST_BYTES)
    return picture(stored, f"{path}: the picture {name!r}")
