"""What every reader of meshes gives: vertices in the file's order, triangles, and named parts."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from facelab.geometry.mesh import TriangleMesh
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
        return f"its parts are {', '.join(sizes[:20])}{', ...' * (len(sizes) > 20)}"

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


def refuse_bad_faces(path, places, bad_faces, n_faces):
    """Refuse bad faces, naming the first and where the others are; or warn that they are left out.

    Parameters
    ----------
    path : Path
    places : list of (str, str)
        Place and reason of each, in the order of the file.
    bad_faces : {"refuse", "leave out"}
    n_faces : int
        In all; it is refused in any case that none is left.
    """
    if not places:
        return
    (where, reason), others = places[0], [p for p, _ in places[1:]]
    more = f", ... ({len(others)})" if len(others) > 6 else ""
    also = f" (so are {', '.join(others[:6])}{more})" if others else ""
    if bad_faces == "refuse" or len(places) == n_faces:
        remedy = (
            "remove it" if len(places) == n_faces else 'remove it, or give bad_faces="leave out"'
        )
        raise ValueError(f"{path}, {where}: {reason}{also}; {remedy}.")
    warnings.warn(
        f"{path}: {len(places)} of {n_faces} faces are left out: {where}: {reason}{also}.",
        stacklevel=5,
    )
