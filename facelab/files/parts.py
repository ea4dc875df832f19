"""What every reader of meshes gives: vertices in the file's order, triangles, and named parts."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from facelab.checks import check_choice
from facelab.files.words import listed
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.polygons import triangulate
from facelab.geometry.texture import Texture

LONGEST = 1e12  # a length beyond it is damage, in any unit, and would overflow when squared


@dataclass(frozen=True, eq=False)
class MeshFile:
    """The meshes of one file.

    Parameters
    ----------
    path : Path
    vertices : ndarray of shape (n_vertices, 3)
        All of the file, in its order and unit.
    faces : ndarray of int, shape (n_faces, 3)
    parts : dict of str to ndarray of int
        Faces of each named part; parts may overlap, as groups of OBJ files do.
    owned : dict of str to ndarray of int, optional
        Vertices of each part; those of its faces if left out.
    texture : Texture, optional
    """

    path: Path
    vertices: np.ndarray
    faces: np.ndarray
    parts: dict = field(default_factory=dict)
    owned: dict = field(default_factory=dict)
    texture: Texture | None = None

    def whole(self, scale=1.0):
        """All of it as one TriangleMesh, lengths multiplied by `scale`."""
        return self._mesh(self.vertices * scale, self.faces, self.texture)

    def part(self, name, scale=1.0):
        """One part as a TriangleMesh, its vertices in the order of the file."""
        kept = self.vertices_of(name)
        new = np.full(len(self.vertices), -1)
        new[kept] = np.arange(len(kept))
        own = self.parts[name]
        texture = None if self.texture is None else self.texture.on(own)
        return self._mesh(self.vertices[kept] * scale, new[self.faces[own]], texture)

    def vertices_of(self, name):
        """Indices of a part's vertices, ascending.

        Raises
        ------
        ValueError
            For a name that the file does not have, with those it has.
        """
        if name not in self.parts:
            raise ValueError(f"{self.path}: mesh={name!r} is not in it; {self.contents()}.")
        if name in self.owned:
            return self.owned[name]
        return np.unique(self.faces[self.parts[name]])

    def contents(self):
        """The named parts in words, with the size of each."""
        if not self.parts:
            return "it has no named parts, leave mesh= out"
        sizes = [f"{n!r} ({len(self.vertices_of(n))} vertices)" for n in self.parts]
        return f"its parts are {listed(sizes, 20)}"

    def _mesh(self, vertices, faces, texture):
        try:
            return TriangleMesh(vertices, faces, texture=texture)
        except ValueError as error:  # ours, from the one place that checks a mesh
            raise ValueError(f"{self.path}: {error}") from None


def check_coordinates(V, place):
    """Refuse coordinates that are no lengths; `place` turns the row into words."""
    bad = np.flatnonzero(~(np.abs(V) < LONGEST).all(axis=1))
    if bad.size:
        raise ValueError(
            f"{place(bad[0])}: the coordinates {V[bad[0]].tolist()} hold NaN, infinity or a number "
            f"beyond {LONGEST:g}; the file is damaged, or that vertex has to be repaired."
        )


def triangles_of(path, V, corners, counts, bad_faces, place, lacks, words):
    """Triangles of the polygons of a file; bad ones are refused by their place, or left out.

    Bad are those with fewer than three corners, with one twice, or with one that is no vertex.

    Parameters
    ----------
    path : Path
    V : ndarray of shape (n_vertices, 3)
    corners : ndarray of int, shape (n_corners,)
        Vertices of the first polygon, then those of the second, and so on.
    counts : ndarray of int, shape (n_polygons,)
        Corners of each polygon.
    bad_faces : {"refuse", "leave out"}
    place : callable
        Turns the number of a polygon into words.
    lacks : callable
        Says which vertex is not there, of a number of a corner.
    words : (str, str)
        What is said of too few corners (`{}` of them), and of a vertex that is there twice.

    Returns
    -------
    F : ndarray of int, shape (n_faces, 3)
    polygon : ndarray of int, shape (n_faces,)
        That each triangle comes from.
    kept : ndarray of bool, shape (n_corners,)
        The corners of good polygons.
    """
    check_choice(bad_faces, "bad_faces", ("refuse", "leave out"))
    owner = np.repeat(np.arange(len(counts)), counts)
    reasons = {k: words[0].format(counts[k]) for k in np.flatnonzero(counts < 3).tolist()}
    for at in np.flatnonzero((corners < 0) | (corners >= len(V)))[::-1].tolist():
        reasons[int(owner[at])] = lacks(at)
    order = np.lexsort((corners, owner))
    again = (np.diff(corners[order]) == 0) & (np.diff(owner[order]) == 0)
    for k in np.unique(owner[order][1:][again]).tolist():
        reasons.setdefault(k, words[1])
    _refuse_bad_faces(path, [(place(k), reasons[k]) for k in sorted(reasons)], bad_faces, counts)
    good = np.ones(len(counts), dtype=bool)
    good[list(reasons)] = False
    kept = np.repeat(good, counts)
    try:
        F, polygon = triangulate(V, corners[kept], counts[good])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return F, np.flatnonzero(good)[polygon], kept


def _refuse_bad_faces(path, places, bad_faces, counts):
    """Refuse bad faces, naming the first and where the others are; or warn that they are left out.

    `places` are place and reason of each; that none would be left is refused in any case.
    """
    if not places:
        return
    n_faces = len(counts)
    (where, reason), others = places[0], [p for p, _ in places[1:]]
    also = f" (so are {listed(others)})" if others else ""
    if bad_faces == "refuse" or len(places) == n_faces:
        remedy = (
            "remove it" if len(places) == n_faces else 'remove it, or give bad_faces="leave out"'
        )
        raise ValueError(f"{path}, {where}: {reason}{also}; {remedy}.")
    warnings.warn(
        f"{path}: {len(places)} of {n_faces} faces are left out: {where}: {reason}{also}.",
        stacklevel=5,
    )
