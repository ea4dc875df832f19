"""Pose a face by pulling vertices: the solver and the session.

Tena et al. 2011, section 3.2. Coefficients here are counted from the neutral face: zero is
exactly the neutral, in every region, so the part of it that a model cannot express stays.
"""

from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.utils.validation import check_is_fitted
from threadpoolctl import ThreadpoolController

from facelab.errors import as_finite, check_choice, check_index, check_number
from facelab.models import RegionModel

REFERENCE_VERTICES = 397
"""Mesh density at which beta and gamma have the values of the paper."""

_threads = ThreadpoolController()  # solves this small lose time on several threads


class PoseSolver:
    """Coefficients that bring pinned vertices to their targets (Eq. 9 and 10).

    The paper's beta and gamma belong to an orthonormal basis on 397 vertices, evenly spread; they
    are scaled so that both mean the same at every density N.

    - A row of such a basis shrinks with sqrt(N), for a squared coefficient is a sum over the
      vertices of the motion it makes: gamma is scaled by 397 / N.
    - The boundary term is a sum over shared vertices, whose number grows with sqrt(N) in a band
      one edge wide: beta is scaled by sqrt(397 / N).
    - Regions carried over from a control mesh (`Regions.carried_to`) keep bands as wide as they
      were. The boundary term is then summed over the n control vertices alone, with
      sqrt(397 / n): summed over all, it would see gaps between them that it does not see on the
      control mesh, and hold every pin back.
    - Dense meshes are seldom even: eyelids and lips would resist more than cheeks. So beyond 397
      vertices each counts in the last term by its share of the surface in place of 1 / N.

    Up to 397 vertices this is Eq. 9 to the letter, with scaled weights. Trained on 397 or on all
    6,706 vertices of the same face, models answer the same pins alike: the pinned vertex follows
    as far and the motion reaches as far, within 10 % for about nine pins in ten; the rest is the
    choice of samples, felt most where the face hardly moves (nose tip, outline of the jaw).

    Parameters
    ----------
    model : RegionModel or HolisticModel
        Fitted. Any linear basis will do; it need not be orthonormal.
    beta : float, default=0.5
        β: weight of the agreement of regions on shared vertices, 0 or more.
    gamma : float, default=0.025
        γ: weight of staying near the state before the pins, more than 0.
    shared_pins : {"blended", "copies"}
        What a pin on a vertex of m regions holds. "copies" is Eq. 9 to the letter: each region's
        copy of the vertex is drawn to the target, which also draws the copies together, so that
        merely pressing there moves the face (by up to 0.4 mm in our trials). "blended" holds
        what is seen, the mean of the copies, with m times the weight: pressing changes nothing.
        Both are the same where one region holds the vertex, and where the copies agree.
    mesh : TriangleMesh, optional
        The mesh of the model, for its areas; that of the model's regions if left out. Where there
        is none, every vertex counts the same.

    References
    ----------
    Tena et al. 2011, Eq. 8 to 10. Their Eq. 7 has a wrong index in its last term; Eq. 10 is
    right. Each pair of regions is summed once.
    """

    def __init__(self, model, beta=0.5, gamma=0.025, shared_pins="blended", mesh=None):
        check_is_fitted(model)
        self.model = model
        self.shared_pins = check_choice(shared_pins, "shared_pins", ("blended", "copies"))
        self.beta = check_number(beta, "beta", low=0)
        self.gamma = check_number(gamma, "gamma", above=0)
        self.n_vertices = len(model.mean_) // 3
        regions = model.regions
        if mesh is None and regions is not None:
            mesh = regions.mesh
        samples = None if regions is None else regions.samples
        boundary, n_drawn = model.boundary_, self.n_vertices
        if samples is not None:
            boundary, n_drawn = model._boundary_matrix(samples), len(samples)
        weights = _vertex_weights(self.n_vertices, mesh)
        self._gamma = self.gamma * _coefficient_weights(model, weights)
        # the part of the matrix of Eq. 10 that does not depend on the pins
        self._at_rest = self.beta * np.sqrt(REFERENCE_VERTICES / n_drawn) * boundary + self._gamma

    def rows(self, vertex):
        """What a pin on this vertex holds, shape (3 * n, P): rows of Eq. 9, n times x, y, z.

        n is the number of regions that hold the vertex for pins on copies (each row block is one
        B_k^i), and 1 for blended pins.
        """
        columns = 3 * vertex + np.arange(3)
        found = []
        for at, B, s in self.model._parts():
            first = np.searchsorted(at, columns[0])
            if first < len(at) and at[first] == columns[0]:
                row = np.zeros((3, self.model.n_coefficients_))
                row[:, s] = B[:, first : first + 3].T
                found.append(row)
        if self.shared_pins == "blended":  # sqrt(m) times the mean: the weight of m copies
            return sum(found) / np.sqrt(len(found))
        return np.concatenate(found)

    def _pull(self, vertex):
        """Right side of Eq. 10 for a unit target of this pin, shape (P, 3)."""
        J = self.rows(vertex)
        blended = self.shared_pins == "blended"
        weight = np.sqrt(self.model.holders_[3 * vertex]) if blended else 1
        return weight * J.reshape(-1, 3, J.shape[1]).sum(axis=0).T

    def factor(self, vertices):
        """Factorised matrix of Eq. 10 for pins on these vertices."""
        A = self._at_rest.copy()
        if len(vertices):
            J = np.concatenate([self.rows(v) for v in vertices])
            A += J.T @ J
        return cho_factor(A, overwrite_a=True, check_finite=False)

    def solve(self, pins, c_0=None):
        """Coefficients at the minimum of Eq. 9.

        Parameters
        ----------
        pins : dict of int to ndarray of shape (3,)
            Vertex to wanted displacement from the neutral, millimetres.
        c_0 : ndarray of shape (P,), optional
            State before the pins were set; the neutral if left out.

        Returns
        -------
        c : ndarray of shape (P,)
        """
        c_0 = np.zeros(self.model.n_coefficients_) if c_0 is None else c_0
        rhs = self._gamma @ c_0
        for vertex, target in pins.items():
            rhs = rhs + self._pull(vertex) @ target
        with _threads.limit(limits=1):
            return cho_solve(self.factor(pins), rhs, check_finite=False)

    def sensitivity(self, vertices, moving):
        """How the coefficients follow the target of one pin: dc / dt, shape (P, 3).

        While one pin moves the matrix of Eq. 10 stands still, so the pose is affine in its target.
        """
        with _threads.limit(limits=1):
            return cho_solve(self.factor(vertices), self._pull(moving), check_finite=False)

    def displacements(self, coefficients):
        """Displacements from the neutral, shared vertices blended: shape (n, n_vertices, 3)."""
        return self.model.blend(np.atleast_2d(coefficients)).reshape(-1, self.n_vertices, 3)


def _vertex_weights(n_vertices, mesh):
    """What each vertex counts, 397 / N on average: shape (n_vertices,)."""
    if mesh is None or n_vertices <= REFERENCE_VERTICES:
        return np.full(n_vertices, REFERENCE_VERTICES / n_vertices)
    areas = np.maximum(
        mesh.vertex_areas, mesh.vertex_areas.mean() / 100
    )  # a vertex of slivers still counts a little
    return REFERENCE_VERTICES * areas / areas.sum()


def _coefficient_weights(model, weights):
    """W of the last term (c_0 - c)^T W (c_0 - c): 397 / N times one for even weights, (P, P)."""
    if np.ptp(weights) == 0:
        return weights[0] * np.eye(model.n_coefficients_)
    W = np.zeros((model.n_coefficients_,) * 2)
    for columns, B, s in model._parts():
        U, _, Vt = np.linalg.svd(B, full_matrices=False)
        Q = U @ Vt  # B itself where it is orthonormal, else the orthonormal basis nearest to it
        W[s, s] = (Q * np.repeat(weights, 3)[columns]) @ Q.T
    return W


@dataclass(frozen=True, eq=False)
class PoseState:
    """One moment of a session: all that decides the pose.

    Parameters
    ----------
    model : RegionModel or HolisticModel
    pins : mapping of int to ndarray of shape (3,)
        Model vertex to wanted displacement from the neutral, millimetres.
    beta, gamma : float
    c_0 : ndarray of shape (P,)
        State before the pins were set.
    coefficients : ndarray of shape (P,)
        The answer.
    """

    model: RegionModel = field(repr=False)
    pins: MappingProxyType
    beta: float
    gamma: float
    c_0: np.ndarray = field(repr=False)
    coefficients: np.ndarray = field(repr=False)


@dataclass
class _Drag:
    vertex: int  # in the model
    start: np.ndarray  # (3,) target displacement when the drag began, mm
    target: np.ndarray  # (3,)
    D: np.ndarray  # (3 * n_displayed, 3): millimetres of pose for a millimetre of target
    x: np.ndarray  # (3 * n_displayed,): the pose when the drag began, mm


class PosingSession:
    """Everything a person can do to a pose, without any widget.

    Parameters
    ----------
    model : RegionModel or HolisticModel
        Fitted on displacements of `neutral` or of its control vertices.
    neutral : TriangleMesh
        The face at rest that is shown and pulled, millimetres.
    beta : float, default=0.5
        β, see `PoseSolver`.
    gamma : float, default=0.025
        γ, see `PoseSolver`.
    binding : LinearBinding, optional
        If the model has only the control vertices of a denser face: how that follows them. Then
        `neutral` is the dense face, and pulling one of its vertices pulls the control vertex
        nearest to it (its handle) by as much.
    shared_pins : {"blended", "copies"}
        What a pin on a vertex of several regions holds, see `PoseSolver`.

    Raises
    ------
    ValueError
        If model, neutral and binding do not belong together.

    Notes
    -----
    Eq. 9 is solved for the change since the state before the pins: what gaps a kept pose has at
    the boundaries stay as they are, and only further ones cost. Else the first pin after `keep`,
    or a mere press, would close the old gaps and move the face (by 1 mm in our trials).

    References
    ----------
    Tena et al. 2011, sections 3.2 and 6.
    """

    def __init__(self, model, neutral, beta=0.5, gamma=0.025, binding=None, shared_pins="blended"):
        self.neutral = neutral
        self.binding = binding
        self.shared_pins = shared_pins
        if binding is not None and binding.mesh.n_vertices != neutral.n_vertices:
            raise ValueError(
                f"binding carries {binding.mesh.n_vertices} vertices, but neutral has "
                f"{neutral.n_vertices}; bind the neutral itself."
            )
        self._check_model(model)
        solver = self._new_solver(model, beta, gamma)
        rest = np.zeros(model.n_coefficients_)
        pins = MappingProxyType({})
        self._past = [PoseState(model, pins, solver.beta, solver.gamma, rest, rest)]
        self._future = []
        self._drag = None
        self._last_solver = solver
        self._shown = None, None  # a state and its vertices

    def _new_solver(self, model, beta, gamma):
        mesh = self.neutral if self.binding is None else None
        return PoseSolver(model, beta, gamma, self.shared_pins, mesh)

    def _check_model(self, model):
        if not isinstance(model, RegionModel):
            raise TypeError(
                f"model is a {type(model).__name__}, but a session poses with a RegionModel or a "
                "HolisticModel."
            )
        check_is_fitted(model)
        n_model = len(model.mean_) // 3
        n_control = self.neutral.n_vertices if self.binding is None else len(self.binding.samples)
        if n_model != n_control:
            raise ValueError(
                f"the model has {n_model} vertices, but {n_control} are to be posed; train it on "
                "motion of this face, or give the binding from its control vertices to the face."
            )

    # --- what is shown ----------------------------------------------------------------------------

    @property
    def state(self):
        """The present `PoseState`; a drag under way is not in it before its release."""
        return self._past[-1]

    @property
    def model(self):
        """The model that poses the face."""
        return self.state.model

    @property
    def beta(self):
        """β, weight of boundary agreement."""
        return self.state.beta

    @property
    def gamma(self):
        """γ, weight of staying near c_0."""
        return self.state.gamma

    @property
    def vertices(self):
        """The pose on screen, shape (n_vertices, 3), millimetres."""
        if self._drag is not None:
            drag = self._drag
            return (drag.x + drag.D @ (drag.target - drag.start)).reshape(-1, 3)
        if self._shown[0] is not self.state:
            moved = self._displayed(self.state.coefficients)[0]
            self._shown = self.state, self.neutral.vertices + moved
        return self._shown[1].copy()

    @property
    def can_undo(self):
        """Whether there is a step to go back to."""
        return len(self._past) > 1 or self._drag is not None

    @property
    def can_redo(self):
        """Whether there is an undone step."""
        return bool(self._future)

    @property
    def pins(self):
        """Pinned vertices of the shown face and their targets: dict of int to ndarray (3,)."""
        state_pins = dict(self.state.pins)
        if self._drag is not None:
            state_pins[self._drag.vertex] = self._drag.target
        shown = {self._shown_vertex(v): t for v, t in state_pins.items()}
        return {v: self.neutral.vertices[v] + t for v, t in shown.items()}

    def handle(self, vertex):
        """The vertex that moves when this one is pulled: itself, or its nearest control vertex."""
        vertex = check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")
        return self._shown_vertex(self._model_vertex(vertex))

    def _model_vertex(self, vertex):
        return vertex if self.binding is None else int(self.binding.handle_of[vertex])

    def _shown_vertex(self, vertex):
        return vertex if self.binding is None else int(self.binding.samples[vertex])

    def _displayed(self, coefficients):
        """Displacements of the shown face for rows of coefficients: (n, n_vertices, 3)."""
        control = self._solver.displacements(coefficients)
        if self.binding is None:
            return control
        n, n_control, _ = control.shape
        flat = self.binding.carry(control.transpose(1, 0, 2).reshape(n_control, -1))
        return flat.reshape(-1, n, 3).transpose(1, 0, 2)

    # --- dragging ---------------------------------------------------------------------------------

    def press(self, vertex):
        """Take hold of a vertex where it is: pressing alone changes nothing.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.

        Returns
        -------
        D : ndarray of shape (n_vertices, 3, 3)
            D[v, :, a] is how vertex v moves, in millimetres, when the target moves by one
            millimetre along axis a.
        """
        vertex = check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")
        if self._drag is not None:
            self.release()
        x = self.vertices
        held = self._model_vertex(vertex)
        shown = self._shown_vertex(held)
        pins = self.state.pins
        start = pins[held] if held in pins else x[shown] - self.neutral.vertices[shown]
        C = self._solver.sensitivity([*(v for v in pins if v != held), held], held)
        D = self._displayed(C.T).transpose(1, 2, 0)
        self._drag = _Drag(held, start, start, D.reshape(-1, 3), x.ravel())
        return D

    def drag(self, vertex, target):
        """Pull a vertex towards a target; the face follows at once.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.
        target : array_like of shape (3,)
            Where it should be, millimetres.

        Raises
        ------
        ValueError
            For a vertex that does not exist or a target that is not finite; nothing changes.
        """
        target = as_finite(target, "target", (3,), remedy="give three finite coordinates")
        vertex = check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")
        if self._drag is None or self._drag.vertex != self._model_vertex(vertex):
            self.press(vertex)
        self._drag.target = target - self._grip(vertex)

    def _grip(self, vertex):
        """Where the target has to be for no displacement of the handle, shape (3,), mm."""
        drag = self._drag
        if vertex == self._shown_vertex(drag.vertex) or drag.vertex in self.state.pins:
            return self.neutral.vertices[vertex]
        # a neighbour of the handle stands elsewhere: what counts is how far it is pulled from there
        return drag.x.reshape(-1, 3)[vertex] - drag.start

    def release(self):
        """Let go: the pin stays where it was dragged to, and the drag becomes one step of undo.

        A press without a drag leaves no pin: `hold` sets one where a vertex is.
        """
        if self._drag is None:
            return
        drag, self._drag = self._drag, None
        if drag.target is drag.start:
            return
        self._step(pins={**self.state.pins, drag.vertex: drag.target})

    def hold(self, vertex):
        """Pin a vertex where it is, so that later pulls leave it there."""
        self.press(vertex)
        self._drag.target = self._drag.start.copy()
        self.release()

    def cancel(self):
        """Give up the drag under way; the face is as it was before."""
        self._drag = None

    # --- edits ------------------------------------------------------------------------------------

    @property
    def _solver(self):
        return self._solver_for(self.state)

    def _solver_for(self, state):
        last = self._last_solver
        if (last.model, last.beta, last.gamma) != (state.model, state.beta, state.gamma):
            self._last_solver = self._new_solver(state.model, state.beta, state.gamma)
        return self._last_solver

    def _step(self, **changes):
        state = replace(self.state, **changes)
        solver = self._solver_for(state)
        before = solver.displacements(state.c_0)[0]
        moves = {v: t - before[v] for v, t in state.pins.items()}
        coefficients = state.c_0 + solver.solve(moves)
        pins = MappingProxyType(dict(state.pins))
        self._past.append(replace(state, pins=pins, coefficients=coefficients))
        self._future = []

    def remove_pin(self, vertex):
        """Take a pin away; the others keep holding.

        Raises
        ------
        ValueError
            If the vertex is not pinned.
        """
        held = self._model_vertex(
            check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")
        )
        if self._shown_vertex(held) not in self.pins:
            known = ", ".join(map(str, self.pins)) or "none"
            raise ValueError(f"vertex={vertex} is not pinned; pinned are: {known}.")
        self.release()
        self._step(pins={v: t for v, t in self.state.pins.items() if v != held})

    def keep(self):
        """Make the present pose the state that pins start from, and take all pins away."""
        self.release()
        self._step(pins={}, c_0=self.state.coefficients)

    def reset(self):
        """Back to the neutral face without pins; beta and gamma stay."""
        self.release()
        self._step(pins={}, c_0=np.zeros(self.model.n_coefficients_))

    def set(self, beta=None, gamma=None):
        """Change beta or gamma; the pins are solved for anew.

        Raises
        ------
        ValueError
            For a beta below 0 or a gamma not above 0; nothing changes.
        """
        beta = self.beta if beta is None else check_number(beta, "beta", low=0)
        gamma = self.gamma if gamma is None else check_number(gamma, "gamma", above=0)
        self.release()
        if (beta, gamma) != (self.beta, self.gamma):
            self._step(beta=beta, gamma=gamma)

    def undo(self):
        """Go one step back; False if there is none. A drag under way is given up instead."""
        if self._drag is not None:
            self.cancel()
            return True
        if len(self._past) == 1:
            return False
        self._future.append(self._past.pop())
        return True

    def redo(self):
        """Go one undone step forward again; False if there is none."""
        if not self._future:
            return False
        self.cancel()
        self._past.append(self._future.pop())
        return True

    def use(self, model):
        """Pose with another model of the same face, under the same pins.

        The state before the pins is expressed in the new model as well as it can be.

        Raises
        ------
        ValueError
            If the model is of another face; nothing changes.
        """
        self._check_model(model)
        self.release()
        if model is self.model:
            return
        before = self._solver.displacements(self.state.c_0).reshape(1, -1)
        c_0 = (model.transform(before) - model.transform(np.zeros_like(before)))[0]
        self._step(model=model, c_0=c_0)
