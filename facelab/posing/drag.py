"""A vertex held by the mouse: a press finds once what each move then costs one product."""

from dataclasses import dataclass, replace

import numpy as np

from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.symmetry import MIRROR
from facelab.posing.bounded import BoundedPull


def moving_with(vertex, partner, place):
    """What a pull of a vertex moves, see `targets`: its partner by the mirrored pull.

    Parameters
    ----------
    vertex : int
    partner : int
        -1 for none; the vertex itself keeps to the midline.
    place : callable
        Gives the displacement of a vertex, (3,).
    """
    if partner == vertex:
        return {vertex: (place(vertex), (np.eye(3) + MIRROR) / 2)}
    moving = {vertex: (place(vertex), np.eye(3))}
    return moving if partner < 0 else {**moving, partner: (place(partner), MIRROR)}


def targets(moving, vertex, target):
    """Targets of all vertices that move when one is pulled to a target: dict of int to (3,).

    Parameters
    ----------
    moving : dict of int to (start, M)
        Where each is, as a displacement (3,), and the (3, 3) matrix that turns the pull into its
        own.
    vertex : int
        The one that is pulled.
    target : ndarray of shape (3,)
        Wanted displacement of it, millimetres.
    """
    pull = target - moving[vertex][0]
    return {v: start + M @ pull for v, (start, M) in moving.items()}


@dataclass(frozen=True, eq=False)
class Drag:
    """A drag under way, as a value: `to` gives the next one.

    While one vertex is dragged the matrix of Eq. 10 stands still, so that the pose is affine in its
    target (with a limit and in a rig it is not: there every move solves).

    Parameters
    ----------
    solver : PoseSolver
    state : PoseState
        When the drag began.
    neutral : TriangleMesh
    vertex : int
    moving : dict
        See `targets`.
    problem : object
        Of the solver, for the pins of the state and those that move.
    pins : dict of int to ndarray of shape (3,)
        Targets of them all when the drag began.
    c, V : ndarray of shape (P,), (n_vertices, 3)
        Coefficients and vertices when it began, or now if the pose is not affine.
    slope : ndarray of shape (P, 3) or None
        Coefficients for a millimetre of pull.
    D : ndarray of shape (n_vertices, 3, 3) or None
        D[v, :, a] is how vertex v moves for a millimetre of pull along axis a.
    asked : ndarray of shape (3,) or None
        Where the vertex was to go, millimetres; None before it moves.
    target : ndarray of shape (3,)
        The displacement of it that is sought.
    """

    solver: object
    state: object
    neutral: TriangleMesh
    vertex: int
    moving: dict
    problem: object
    pins: dict
    c: np.ndarray
    V: np.ndarray
    slope: np.ndarray | None
    D: np.ndarray | None
    target: np.ndarray
    asked: np.ndarray | None = None

    @classmethod
    def begin(cls, solver, state, neutral, vertex, moving, V):
        """The drag of a vertex that has not moved yet."""
        pins = {v: start for v, (start, _) in moving.items()}
        pins = {**state.pins, **pins}
        problem = solver.problem(list(pins), state.weights_of(pins))
        slope = D = None
        if solver.affine:
            slope = _slope(problem, moving)
            D = np.ascontiguousarray(solver.shown(slope.T).transpose(1, 2, 0))
        start = moving[vertex][0]
        c = state.coefficients
        return cls(solver, state, neutral, vertex, moving, problem, pins, c, V, slope, D, start)

    def to(self, place):
        """The drag with the vertex pulled to a place, (3,), millimetres."""
        start = self.moving[self.vertex][0]
        target = self.solver.capped(self.vertex, place - self.neutral.vertices[self.vertex], start)
        moved = replace(self, target=target, asked=place)
        if self.slope is not None:
            return moved
        wanted = np.array(list({**self.pins, **moved.targets}.values()))
        c = self.problem.solve(wanted, self.state.c_0, self.state.molded)
        return replace(moved, c=c, V=self.neutral.vertices + self.solver.shown(c)[0])

    @property
    def answer(self):
        """How the face follows: D, or a `BoundedPull`, or None if the face is too large for one."""
        solver, state = self.solver, self.state
        if self.D is not None or solver.basis is None:
            return self.D
        problem, centre, radius = self.problem, None, 0.0
        if solver.limit is not None:
            start = self.moving[self.vertex][0]
            centre, radius = solver.ball(self.vertex, start)
            centre = centre + self.neutral.vertices[self.vertex]
        pins = np.array(list(self.pins.values()))
        return BoundedPull(
            state.coefficients,
            problem.free(pins, state.c_0, state.molded),
            _slope(problem, self.moving),
            problem.inverse,
            *problem.ends(state.c_0),
            solver.basis,
            centre,
            radius,
        )

    @property
    def targets(self):
        """Targets now of all that moves, displacements: dict of int to ndarray of shape (3,)."""
        return targets(self.moving, self.vertex, self.target)

    @property
    def coefficients(self):
        """Of the pose on screen, shape (P,)."""
        return self.c.copy() if self.slope is None else self.c + self.slope @ self._pull

    @property
    def vertices(self):
        """The face on screen, shape (n_vertices, 3), millimetres."""
        if self.D is None:
            return self.V.copy()
        # as one matrix: a stack of 3 x 3 takes numpy ten times as long
        return self.V + (self.D.reshape(-1, 3) @ self._pull).reshape(-1, 3)

    @property
    def _pull(self):
        return self.target - self.moving[self.vertex][0]


def _slope(problem, moving):
    """How the coefficients follow the pull of all that it moves, shape (P, 3)."""
    at = problem.vertices.index
    return sum(problem.slope(at(v)) @ M for v, (_, M) in moving.items())
