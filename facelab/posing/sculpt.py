"""Pull single vertices of a face by hand, without any model: a rough sketch of an expression."""

import numpy as np
from scipy.sparse.csgraph import dijkstra

from facelab.checks import as_finite, check_index, check_number, check_type
from facelab.geometry.mesh import TriangleMesh
from facelab.numeric.undo import History, has_history
from facelab.posing.state import frozen_copy


@has_history
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
    history : History
        Its pulls: undo, redo, `cancel` and `observe` are its.
    """

    def __init__(self, mesh, vertices=None, radius=20.0):
        self.mesh = check_type(mesh, "mesh", TriangleMesh, "give the face at rest")
        self.radius = check_number(radius, "radius", above=0)
        start = mesh.vertices if vertices is None else vertices
        start = as_finite(start, "vertices", mesh.vertices.shape)
        # live is the vertex held, its target (3,) and how all follow it (n_vertices,)
        self.history = History(frozen_copy(start), np.array_equal)

    @property
    def vertices(self):
        """The face as it is pulled now, shape (n_vertices, 3), millimetres."""
        V = self.state
        if self.history.live is None:
            return V.copy()
        vertex, target, follow = self.history.live
        return V + follow[:, None] * (target - V[vertex])

    @property
    def pins(self):
        """The vertex held and its target: dict of int to ndarray (3,), empty between pulls."""
        held = self.history.live
        return {} if held is None else {held[0]: held[1].copy()}

    def follow(self, vertex):
        """Share by which each vertex follows a pulled one, shape (n_vertices,)."""
        g = dijkstra(self.mesh.adjacency, directed=False, indices=vertex, limit=self.radius)
        return np.maximum(1 - (g / self.radius) ** 2, 0) ** 2  # g is inf beyond the radius

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
        follow = self.follow(vertex)
        self.history.live = vertex, self.state[vertex].copy(), follow
        return follow[:, None, None] * np.eye(3)

    def drag(self, vertex, target):
        """Pull a vertex to a target, shape (3,), millimetres."""
        target = as_finite(target, "target", (3,), remedy="give three finite coordinates")
        held = self.history.live
        if held is None or held[0] != vertex:
            self.press(vertex)
        self.history.live = vertex, target.copy(), self.history.live[2]
        self.history.tell("move")

    def release(self):
        """Let go: the face stays as it was pulled; a press without a drag leaves no step."""
        with self.history.whole():
            V, self.history.live = self.vertices, None
            self.history.make(frozen_copy(V))
