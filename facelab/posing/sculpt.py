"""Pull single vertices of a face by hand, without any model: a rough sketch of an expression."""

import numpy as np
from scipy.sparse.csgraph import dijkstra

from facelab.checks import as_finite, check_index, check_number
from facelab.geometry.mesh import TriangleMesh


class Sculpt:
    """A face whose skin follows a pulled vertex softly, near it and along the surface only.

    A vertex at distance g from the pulled one (along the edges, on the face at rest) follows by
    the share (1 - (g / radius)^2)^2, and not at all beyond the radius. So pulling the upper lip
    leaves the lower one alone. Taking hold, dragging, letting go and undo are called as in
    `PosingSession`, and a view may use either.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, millimetres.
    vertices : ndarray of shape (n_vertices, 3), optional
        The face to start from; the mesh's own if left out.
    radius : float, default=20.0
        Millimetres.

    Attributes
    ----------
    radius : float
        May be changed between pulls.
    """

    def __init__(self, mesh, vertices=None, radius=20.0):
        if not isinstance(mesh, TriangleMesh):
            raise TypeError(f"mesh is a {type(mesh).__name__}; give a TriangleMesh.")
        self.mesh = mesh
        self.radius = check_number(radius, "radius", above=0)
        start = mesh.vertices if vertices is None else vertices
        self._past = [as_finite(start, "vertices", mesh.vertices.shape).copy()]
        self._future = []
        self._drag = None  # vertex, target (3,), follow (n_vertices,)

    @property
    def vertices(self):
        """The face as it is pulled now, shape (n_vertices, 3), millimetres."""
        V = self._past[-1]
        if self._drag is None:
            return V.copy()
        vertex, target, follow = self._drag
        return V + follow[:, None] * (target - V[vertex])

    @property
    def pins(self):
        """The vertex held and its target: dict of int to ndarray (3,), empty between pulls."""
        return {} if self._drag is None else {self._drag[0]: self._drag[1].copy()}

    @property
    def can_undo(self):
        """Whether there is a pull to take back."""
        return len(self._past) > 1 or self._drag is not None

    @property
    def can_redo(self):
        """Whether there is a pull taken back."""
        return bool(self._future)

    def press(self, vertex):
        """Take hold of a vertex where it is.

        Returns
        -------
        D : ndarray of shape (n_vertices, 3, 3)
            D[v, :, a] is how vertex v moves, in millimetres, when the target moves by one
            millimetre along axis a.
        """
        vertex = check_index(vertex, "vertex", self.mesh.n_vertices, "vertices of the face")
        self.release()
        g = dijkstra(self.mesh.adjacency, directed=False, indices=vertex, limit=self.radius)
        follow = np.maximum(1 - (g / self.radius) ** 2, 0) ** 2  # g is inf beyond the radius
        self._drag = vertex, self._past[-1][vertex].copy(), follow
        return follow[:, None, None] * np.eye(3)

    def drag(self, vertex, target):
        """Pull a vertex to a target, shape (3,), millimetres."""
        target = as_finite(target, "target", (3,), remedy="give three finite coordinates")
        if self._drag is None or self._drag[0] != vertex:
            self.press(vertex)
        self._drag = self._drag[0], target.copy(), self._drag[2]

    def release(self):
        """Let go: the face stays as it was pulled; a press without a drag leaves no step."""
        if self._drag is not None:
            V = self.vertices
            self._drag = None
            if (V != self._past[-1]).any():
                self._past.append(V)
                self._future = []

    def cancel(self):
        """Give up the pull under way."""
        self._drag = None

    def undo(self):
        """Take the last pull back; False if there is none. A pull under way is given up instead."""
        if self._drag is not None:
            self.cancel()
        elif len(self._past) == 1:
            return False
        else:
            self._future.append(self._past.pop())
        return True

    def redo(self):
        """Pull again what was taken back; False if there is nothing."""
        if not self._future:
            return False
        self.cancel()
        self._past.append(self._future.pop())
        return True
