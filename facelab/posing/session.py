"""The posing session: everything that a person can do to a pose, without any widget.

Tena et al. 2011, sections 3.2 and 6. The mathematics is in `facelab.posing.solver`.
"""

import time
from dataclasses import dataclass, replace

import numpy as np

from facelab.checks import as_finite, check_index, check_number, check_type
from facelab.face_model import FaceModel
from facelab.geometry.binding import LinearBinding
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.symmetry import MIRROR, check_partners, mirror_partners
from facelab.numeric.undo import History, logged
from facelab.posing.fingerprint import fingerprint
from facelab.posing.solver import REFERENCE_VERTICES, STIFFNESS, PoseSolver, check_limit
from facelab.posing.state import PoseState, state_to_dict

__all__ = [
    "REFERENCE_VERTICES",
    "STIFFNESS",
    "PoseSolver",
    "PoseState",
    "PosingSession",
    "mirror_partners",
]

_AS_IT_IS = object()
_NO_PINS = {"pins": {}, "weights": {}, "locked": frozenset()}
_SOLVERS_KEPT = 3  # so that going back to another model is quick


@dataclass
class _Drag:
    vertex: int
    start: np.ndarray  # (3,) target displacement when the drag began, mm
    target: np.ndarray  # (3,)
    moving: dict  # vertex to (its start, (3, 3) matrix that turns the pull into its own)
    problem: object
    fixed: np.ndarray  # (n_pins, 3) targets of all pins of the problem when the drag began
    c: np.ndarray  # (P,) coefficients when the drag began, or now if not affine
    x: np.ndarray  # (3 * n_vertices,) the pose likewise, mm
    slope: np.ndarray | None = None  # (P, 3): coefficients for a millimetre of target
    D: np.ndarray | None = None  # (3 * n_vertices, 3): millimetres of pose for one of target
    asked: np.ndarray | None = None  # (3,) where the vertex was to go, mm

    def targets(self):
        """Targets now of all that moves: dict of int to ndarray of shape (3,)."""
        pull = self.target - self.start
        return {v: start + M @ pull for v, (start, M) in self.moving.items()}


class PosingSession(History):
    """Everything a person can do to a pose, without any widget.

    Parameters
    ----------
    model : FaceModel
        RegionModel, HolisticModel, BlendshapeRig or one of your own; fitted on displacements of
        `neutral` or of its control vertices.
    neutral : TriangleMesh
        The face at rest that is shown and pulled, millimetres.
    beta : float, default=0.5
        β, see `PoseSolver`.
    gamma : float, default=0.025
        γ, see `PoseSolver`.
    binding : LinearBinding, optional
        How the dense `neutral` follows control vertices, for models that have only those. Pins
        hold the very vertex that was pulled, between control vertices too.
    shared_pins : {"blended", "copies"}
        What a pin on a vertex of several regions holds, see `PoseSolver`.
    limit : float, optional
        Standard deviations beyond which coefficients are drawn back, see `PoseSolver`; not for a
        rig, whose weights stay within 0 and 1.
    partners : ndarray of int, shape (n_vertices,), optional
        Mirrored partner of each vertex, -1 for none; from `mirror_partners` if left out.
    clock : callable, default=time.time
        Seconds, for the log.

    Attributes
    ----------
    log : list of dict
        Every edit with its time since the start, in seconds: {"t", "do", ...arguments}.
        `facelab.posing.replay` does them again.

    Raises
    ------
    ValueError, TypeError
        If model, neutral and binding do not belong together, or are none.

    Notes
    -----
    Eq. 9 is solved for the change since the state before the pins: what gaps a kept pose has at
    the boundaries stay as they are, and only further ones cost. Else the first pin after `keep`,
    or a mere press, would close the old gaps and move the face (by 1 mm in our trials).

    References
    ----------
    Tena et al. 2011, sections 3.2 and 6.

    Examples
    --------
    >>> import facelab
    >>> actor = facelab.load_registered("M1", size="small", progress=False)
    >>> motion = actor.motion("train")
    >>> model = facelab.HolisticModel(n_components=10).fit(motion.displacements())
    >>> session = facelab.PosingSession(model, motion.mesh)
    >>> session.drag(0, motion.mesh.vertices[0] + [0, 2, 0])  # millimetres; y is up
    >>> session.release()
    >>> session.n_undo
    1
    """

    def __init__(
        self,
        model,
        neutral,
        beta=0.5,
        gamma=0.025,
        binding=None,
        shared_pins="blended",
        limit=None,
        partners=None,
        clock=time.time,
    ):
        if not isinstance(neutral, TriangleMesh):
            raise TypeError(f"neutral is a {type(neutral).__name__}; give a TriangleMesh.")
        if not (binding is None or isinstance(binding, LinearBinding)):
            raise TypeError(
                f"binding is a {type(binding).__name__}; give the LinearBinding of "
                "`bind(neutral, samples)`."
            )
        self.neutral = neutral
        self.binding = binding
        self.shared_pins = shared_pins
        if binding is not None and binding.mesh.n_vertices != neutral.n_vertices:
            raise ValueError(
                f"binding carries {binding.mesh.n_vertices} vertices, but neutral has "
                f"{neutral.n_vertices}; bind the neutral itself."
            )
        self._partners = partners
        if partners is not None:
            self._partners = check_partners(partners, neutral.n_vertices)
        self._symmetric = False
        self._check_model(model)
        self._solvers = {}
        rest = np.zeros(model.n_coefficients)
        start = PoseState(
            model,
            {},
            check_number(beta, "beta", low=0),
            check_number(gamma, "gamma", above=0),
            *(rest, rest, rest),
            limit=check_limit(limit, model),
        )
        self._solver_for(start)  # refuses what it cannot use
        super().__init__(start, clock)
        self._drag = None
        self._shown = None, None  # a state and its vertices

    def _check_model(self, model):
        remedy = "give a fitted RegionModel or HolisticModel, or a BlendshapeRig"
        check_type(model, "model", FaceModel, remedy)
        model.check_fitted()
        sizes = {self.neutral.n_vertices}
        if self.binding is not None:
            sizes.add(len(self.binding.samples))
        if model.n_vertices not in sizes:
            raise ValueError(
                f"the model has {model.n_vertices} vertices, but {min(sizes)} are to be posed; "
                "train it on motion of this face, or give the binding from its control vertices to "
                "the face."
            )

    # --- what is shown ----------------------------------------------------------------------------

    @property
    def model(self):
        """The model that poses the face."""
        return self.state.model

    @property
    def models(self):
        """Models of all steps that can be undone or redone, the present one first: list."""
        steps = [*reversed(self._past), *reversed(self._future)]
        return list(dict.fromkeys(state.model for state in steps))

    @property
    def beta(self):
        """β, weight of boundary agreement."""
        return self.state.beta

    @property
    def gamma(self):
        """γ, weight of staying near c_0."""
        return self.state.gamma

    @property
    def limit(self):
        """Standard deviations that coefficients are held to, or None.

        None for a rig, whose weights stay within 0 and 1; a limit set before `use` went to the rig
        acts again with the next model that knows standard deviations.
        """
        return self._solver.limit

    @property
    def affine(self):
        """Whether the pose is affine in the target of a drag; if not, each move solves."""
        return self._solver.affine

    @property
    def dragging(self):
        """Whether a vertex is held."""
        return self._drag is not None

    @property
    def coefficients(self):
        """The pose on screen as coefficients counted from the neutral (weights of a rig): (P,)."""
        drag = self._drag
        if drag is None:
            return self.state.coefficients.copy()
        if drag.slope is None:
            return drag.c.copy()
        return drag.c + drag.slope @ (drag.target - drag.start)

    @property
    def vertices(self):
        """The pose on screen, shape (n_vertices, 3), millimetres."""
        drag = self._drag
        if drag is not None:
            x = drag.x if drag.D is None else drag.x + drag.D @ (drag.target - drag.start)
            return x.reshape(-1, 3).copy()
        if self._shown[0] is not self.state:
            self._shown = self.state, self.vertices_of(self.state.coefficients)
        return self._shown[1].copy()

    def vertices_of(self, coefficients):
        """The shown face for any coefficients, millimetres.

        Parameters
        ----------
        coefficients : ndarray of shape (P,) or (n, P)
            Counted from the neutral.

        Returns
        -------
        V : ndarray of shape (n_vertices, 3) or (n, n_vertices, 3)
        """
        n = self._solver.n_coefficients
        coefficients = np.asarray(coefficients, dtype=float)
        as_finite(np.atleast_2d(coefficients), "coefficients", ("n", n))
        V = self.neutral.vertices + self._solver.shown(coefficients)
        return V[0] if coefficients.ndim == 1 else V

    @property
    def pins(self):
        """Pinned vertices of the shown face and their targets: dict of int to ndarray (3,)."""
        pins = dict(self.state.pins)
        if self._drag is not None:
            pins |= self._drag.targets()
        return {v: self.neutral.vertices[v] + t for v, t in pins.items()}

    @property
    def pin_weights(self):
        """Weights of the pins: dict of int to float."""
        return {v: self.state.weights.get(v, 1.0) for v in self.state.pins}

    @property
    def locked(self):
        """Pins that no drag moves: frozenset of int."""
        return self.state.locked

    @property
    def regions(self):
        """Regions of the model, None if it has none."""
        return self._solver.regions

    @property
    def region_labels(self):
        """Region of each vertex of the shown face, (n_vertices,) int; None without regions."""
        if self.regions is None:
            return None
        labels = self.regions.labels
        return labels if self._solver.binding is None else labels[self.binding.handle_of]

    @property
    def partners(self):
        """Mirrored partner of each vertex of the shown face, -1 for none: (n_vertices,) int."""
        if self._partners is None:
            self._partners = mirror_partners(self.neutral)
        return self._partners

    @property
    def symmetric(self):
        """Whether drags act on both sides of the face; may be set.

        The partner is pulled by the mirrored pull from where it is. A vertex on the midline keeps
        to it; one without a partner, or whose partner is locked, moves alone.
        """
        return self._symmetric

    @symmetric.setter
    def symmetric(self, on):
        self.release()
        if bool(on) != self._symmetric:
            self._symmetric = bool(on)
            self._note("symmetric", on=self._symmetric)
            self._tell("step")

    def plausibility(self):
        """Mahalanobis distance of each region of the pose from training, shape (n_regions,).

        In training its square is the number of the region's modes on average. None for a rig or
        given bases, which know no variances.
        """
        return self._solver.mahalanobis(self.coefficients)

    def gaps(self):
        """How far regions disagree before blending, at each shown vertex: (n_vertices,), mm.

        The largest distance of a region's copy from the vertex seen; 0 where one region holds it.
        """
        gap = self._solver.gaps(self.coefficients)
        if self._solver.binding is None:
            return gap
        return self.binding.carry(gap[:, None])[:, 0].clip(min=0)

    # --- dragging ---------------------------------------------------------------------------------

    def _vertex(self, vertex):
        return check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")

    def press(self, vertex):
        """Take hold of a vertex where it is: pressing alone changes nothing.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.

        Returns
        -------
        D : ndarray of shape (n_vertices, 3, 3) or None
            D[v, :, a] is how vertex v moves, in millimetres, when the target moves by one
            millimetre along axis a. None if the pose is not affine in the target.

        Raises
        ------
        ValueError
            For a vertex that does not exist or a locked pin; nothing changes.
        """
        vertex = self._vertex(vertex)
        self._check_unlocked(vertex)
        self.release()
        V, c = self.vertices, self.coefficients
        pins = dict(self.state.pins)
        moving = {}
        for v, M in self._moving(vertex).items():
            pins.setdefault(v, V[v] - self.neutral.vertices[v])
            moving[v] = pins[v], M
        problem = self._solver.problem(list(pins), self._weights(pins))
        start, fixed = pins[vertex], np.array(list(pins.values()))
        drag = _Drag(vertex, start, start, moving, problem, fixed, c, V.ravel())
        if self.affine:
            at = problem.vertices.index
            drag.slope = sum(problem.slope(at(v)) @ M for v, (_, M) in moving.items())
            D = self._solver.shown(drag.slope.T).transpose(1, 2, 0)
            drag.D = D.reshape(-1, 3)
        self._drag = drag
        return D if self.affine else None

    def _moving(self, vertex):
        """What a pull of this vertex moves, and the matrices that turn the pull into theirs."""
        if not self.symmetric or self.partners[vertex] < 0:
            return {vertex: np.eye(3)}
        partner = int(self.partners[vertex])
        if partner == vertex:
            return {vertex: (np.eye(3) + MIRROR) / 2}
        if partner in self.locked:
            return {vertex: np.eye(3)}
        return {vertex: np.eye(3), partner: MIRROR}

    def _weights(self, pins, state=None):
        weights = (self.state if state is None else state).weights
        return [weights.get(v, 1.0) for v in pins]

    def _check_unlocked(self, vertex):
        if vertex in self.locked:
            raise ValueError(
                f"vertex={vertex} is a locked pin; unlock it first: "
                f"set_pin({vertex}, locked=False)."
            )

    def drag(self, vertex, target):
        """Pull a vertex towards a target; the face follows at once.

        With a limit, a target beyond what is sane for the vertex (`PoseSolver.reach`) is brought
        back to there.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.
        target : array_like of shape (3,)
            Where it should be, millimetres.

        Raises
        ------
        ValueError
            For a vertex that does not exist, a locked pin, or a target that is not finite;
            nothing changes.
        """
        target = as_finite(target, "target", (3,), remedy="give three finite coordinates").copy()
        vertex = self._vertex(vertex)
        if self._drag is None or self._drag.vertex != vertex:
            self.press(vertex)
        drag = self._drag
        drag.asked = target
        drag.target = self._solver.capped(
            vertex, target - self.neutral.vertices[vertex], drag.start
        )
        if drag.slope is None:
            pins = drag.targets()
            wanted = [
                pins.get(v, t) for v, t in zip(drag.problem.vertices, drag.fixed, strict=True)
            ]
            state = self.state
            drag.c = drag.problem.solve(np.array(wanted), state.c_0, state.molded)
            drag.x = self.vertices_of(drag.c).ravel()
        self._tell("move")

    def release(self):
        """Let go: the pin stays where it was dragged to, and the drag becomes one step of undo.

        A press without a drag leaves no pin: `hold` sets one where a vertex is.
        """
        if self._drag is None:
            return
        drag, self._drag = self._drag, None
        if drag.target is drag.start:
            return
        before = self.state
        self._step(pins={**self.state.pins, **drag.targets()})
        if self.state is not before:
            self._note("pull", vertex=drag.vertex, target=drag.asked)
            self._tell("step")

    def cancel(self):
        """Give up the drag under way; the face is as it was before."""
        if self._drag is not None:
            self._drag = None
            self._tell("move")

    # --- pins -------------------------------------------------------------------------------------

    def hold(self, vertex):
        """Pin a vertex where it is, so that later pulls leave it there."""
        self.set_pin(vertex)

    @logged
    def set_pin(self, vertex, target=None, weight=None, locked=None):
        """Make a pin, or move, weight, lock or unlock one.

        Parameters
        ----------
        vertex : int
            Vertex of the shown face.
        target : array_like of shape (3,), optional
            Millimetres; if left out, that of the pin, or where the vertex is.
        weight : float, optional
            Of the pin in Eq. 9, more than 0; 1 unless set.
        locked : bool, optional
            A locked pin is neither dragged, mirrored upon nor removed; resets take it away.

        Raises
        ------
        ValueError
            For a vertex that does not exist, a bad target or weight, or a new target for a pin
            that is locked and stays so; nothing changes.
        """
        vertex = self._vertex(vertex)
        if target is not None:
            target = as_finite(target, "target", (3,), remedy="give three finite coordinates")
            if locked is not False:
                self._check_unlocked(vertex)
        if weight is not None:
            weight = check_number(weight, "weight", above=0)
        self.release()
        state = self.state
        if target is not None:
            pin = target - self.neutral.vertices[vertex]
        else:
            pin = state.pins.get(vertex, self.vertices[vertex] - self.neutral.vertices[vertex])
        weights = {**state.weights, **({} if weight is None else {vertex: weight})}
        kept = state.locked if locked is None else state.locked - {vertex}
        self._step(
            pins={**state.pins, vertex: pin},
            weights={v: w for v, w in weights.items() if w != 1},
            locked=kept | {vertex} if locked else kept,
        )

    @logged
    def remove_pin(self, vertex):
        """Take a pin away; the others keep holding.

        Raises
        ------
        ValueError
            If the vertex is not pinned, or locked.
        """
        vertex = self._vertex(vertex)
        self._check_pinned(vertex)
        self._check_unlocked(vertex)
        self.release()
        self._step(**self._without({vertex}))

    def _check_pinned(self, vertex):
        if vertex not in self.pins:
            known = ", ".join(map(str, self.pins)) or "none"
            raise ValueError(f"vertex={vertex} is not pinned; pinned are: {known}.")

    def _without(self, gone):
        """Pins, weights and locks of the state without those of some vertices."""
        state = self.state
        return dict(
            pins={v: t for v, t in state.pins.items() if v not in gone},
            weights={v: w for v, w in state.weights.items() if v not in gone},
            locked=state.locked - set(gone),
        )

    @logged
    def mirror_pin(self, vertex):
        """Put the mirrored pin, its weight too, on the vertex's partner.

        Raises
        ------
        ValueError
            If the vertex is not pinned, or has no partner on the other side, or a locked one.
        """
        vertex = self._vertex(vertex)
        self._check_pinned(vertex)
        partner = int(self.partners[vertex])
        if partner in (-1, vertex):
            raise ValueError(f"vertex={vertex} has no partner on the other side of the face.")
        self._check_unlocked(partner)
        self.release()
        state = self.state
        weights = {v: w for v, w in state.weights.items() if v != partner}
        if vertex in weights:
            weights[partner] = weights[vertex]
        self._step(pins={**state.pins, partner: MIRROR @ state.pins[vertex]}, weights=weights)

    # --- edits ------------------------------------------------------------------------------------

    @property
    def _solver(self):
        return self._solver_for(self.state)

    def _solver_for(self, state):
        key = state.model, state.beta, state.gamma, state.limit
        if key not in self._solvers:
            while len(self._solvers) >= _SOLVERS_KEPT:
                del self._solvers[next(iter(self._solvers))]
            self._solvers[key] = self._new_solver(state)
        return self._solvers[key]

    def _new_solver(self, state):
        model = state.model
        bound = self.binding is not None and model.n_vertices == len(self.binding.samples)
        binding, mesh = (self.binding, None) if bound else (None, self.neutral)
        limit = state.limit if model.bounds is None else None
        return PoseSolver(model, state.beta, state.gamma, self.shared_pins, mesh, binding, limit)

    def _step(self, **changes):
        """Solve for the changed state and make it the present one; a change of nothing is none."""
        state = replace(self.state, **changes)
        problem = self._solver_for(state).problem(
            list(state.pins), self._weights(state.pins, state)
        )
        targets = np.array(list(state.pins.values()), dtype=float).reshape(-1, 3)
        self._push(replace(state, coefficients=problem.solve(targets, state.c_0, state.molded)))

    @logged
    def keep(self):
        """Make the present pose the state that pins start from, and take all pins away."""
        self.release()
        c = self.state.coefficients
        self._step(**_NO_PINS, c_0=c, molded=np.zeros_like(c))

    @logged
    def reset(self):
        """Back to the neutral face without pins; beta, gamma and limit stay."""
        self.release()
        rest = np.zeros_like(self.state.c_0)
        self._step(**_NO_PINS, c_0=rest, molded=rest)

    @logged
    def reset_region(self, region):
        """One region back to neutral, its pins taken away; pins of other regions keep holding.

        What those pull along across the boundary stays pulled.

        Raises
        ------
        ValueError
            For a region that does not exist.
        """
        s = self._solver.slice_of(region)
        self.release()
        if self.regions is None:
            self.reset()
            return
        c_0, molded = self.state.c_0.copy(), self.state.molded.copy()
        c_0[s] = molded[s] = 0
        inside = {v for v in self.state.pins if self.region_labels[v] == region}
        self._step(**self._without(inside), c_0=c_0, molded=molded)

    @logged
    def set(self, beta=None, gamma=None, limit=_AS_IT_IS):
        """Change beta, gamma or the limit; the pins are solved for anew.

        Parameters
        ----------
        beta, gamma : float, optional
        limit : float or None, optional
            None takes the limit away.

        Raises
        ------
        ValueError
            For a beta below 0, a gamma or limit not above 0, or a limit where the model knows no
            standard deviations; nothing changes.
        """
        state = self.state
        changed = replace(
            state,
            beta=state.beta if beta is None else check_number(beta, "beta", low=0),
            gamma=state.gamma if gamma is None else check_number(gamma, "gamma", above=0),
            limit=state.limit if limit is _AS_IT_IS else check_limit(limit, state.model),
        )
        self._solver_for(changed)  # refuses what it cannot use
        self.release()
        if not changed.same(state):
            self._step(beta=changed.beta, gamma=changed.gamma, limit=changed.limit)

    @logged
    def apply(self, coefficients):
        """Pose with these coefficients, counted from the neutral; pins are taken away.

        Parameters
        ----------
        coefficients : array_like of shape (P,)
            Of a rig: weights, 0 to 1.
        """
        c = as_finite(coefficients, "coefficients", (self._solver.n_coefficients,))
        self._solver.check(c)
        self.release()
        c = c.copy()
        state = replace(self.state, **_NO_PINS, c_0=c, molded=np.zeros_like(c))
        self._push(replace(state, coefficients=c))

    @logged
    def restore(self, state):
        """Go back to a `PoseState` of this face: pose, pins, weights of Eq. 9 and model.

        Raises
        ------
        ValueError, TypeError
            If it is none, of another face, or one that its model cannot have; nothing changes.
        """
        if not isinstance(state, PoseState):
            raise TypeError(f"state is a {type(state).__name__}; give a PoseState (session.state).")
        self._check_model(state.model)
        check_number(state.beta, "beta", low=0)
        solver = self._solver_for(state)  # refuses what it cannot use
        for v, target in state.pins.items():
            as_finite(target, f"displacement of pin {self._vertex(v)}", (3,))
        for v, weight in state.weights.items():
            check_number(weight, f"weight of pin {v}", above=0)
        unpinned = (state.locked | state.weights.keys()) - state.pins.keys()
        if unpinned:
            raise ValueError(f"state locks or weights {sorted(unpinned)}, which it does not pin.")
        for name in ("c_0", "molded", "coefficients"):
            as_finite(getattr(state, name), name, (solver.n_coefficients,))
        solver.check(state.coefficients)
        self.release()
        self._push(state)

    @logged
    def mirror(self):
        """The whole pose, left for right, as well as the model can; pins are taken away.

        Raises
        ------
        ValueError
            If the mirror map leaves vertices without a partner.
        """
        alone = np.flatnonzero(self.partners < 0)
        if alone.size:
            raise ValueError(
                f"{alone.size} vertices have no mirrored partner, the first {alone[0]}; give "
                "partners=mirror_partners(neutral, tolerance) with a larger tolerance."
            )
        self.release()
        x = self.vertices - self.neutral.vertices
        self.apply(self._solver.encode((x[self.partners] @ MIRROR)[None])[0])

    @logged
    def use(self, model):
        """Pose with another model of the same face, under the same pins.

        The state before the pins is expressed in the new model as well as it can be.

        Raises
        ------
        ValueError
            If the model is of another face; nothing changes.
        """
        self._check_model(model)
        state = self.state
        n = model.n_coefficients
        new = self._solver_for(replace(state, model=model, c_0=np.zeros(n)))
        self.release()
        if model is self.model:
            return
        state = self.state
        bare = self._solver.problem([]).solve(np.zeros((0, 3)), state.c_0, state.molded)
        c_0 = new.encode(self._solver.shown(bare))[0]
        self._step(model=model, c_0=c_0, molded=np.zeros(n))

    # --- molding ----------------------------------------------------------------------------------

    @logged
    def mold(self, region, component, value):
        """Set a component of a region in the state that the pose holds to, c_0.

        Eq. 9 without pins: with a small beta and a large gamma the pose takes the value whole,
        otherwise the neighbours give and take. Pins keep holding.

        Parameters
        ----------
        region : int
            0 for a holistic model or a rig.
        component : int
            Of the region, strongest first; of a rig, the unit.
        value : float
            Standard deviations from the neutral (coefficients if the model knows no variances);
            of a rig, the weight, 0 to 1.

        Raises
        ------
        ValueError
            For a region, component or value out of range; nothing changes.
        """
        solver = self._solver
        s = solver.slice_of(region)
        k = s.start + check_index(component, "component", s.stop - s.start, "components")
        value = check_number(value, "value", *solver.mold_bounds)
        self.release()
        molded = self.state.molded.copy()
        molded[k] = value * solver.deviations[k] - self.state.c_0[k]
        self._step(molded=molded)

    def mold_values(self, region):
        """Where the sliders of a region stand, in the unit of `mold`: shape (P_i,)."""
        s = self._solver.slice_of(region)
        return (self.state.c_0 + self.state.molded)[s] / self._solver.deviations[s]

    def mold_ranges(self, region):
        """Sensible ends for those sliders, shape (P_i, 2): 0 to 1, or 3 standard deviations."""
        return np.tile(self._solver.mold_ends, (len(self.mold_names(region)), 1))

    def mold_names(self, region):
        """Names of those sliders: list of str."""
        return self._solver.names(region)

    # --- recorded takes ---------------------------------------------------------------------------

    def encode(self, take):
        """Coefficients of a recorded take, counted from the neutral.

        Parameters
        ----------
        take : MotionSequence or WeightSequence
            Motion of the shown face or of the model's vertices; for a rig also recorded weights.

        Returns
        -------
        track : ndarray of shape (n_frames, P)
            NaN in lost frames.
        """
        found = self._solver.encode_take(take)
        track = np.full((take.n_frames, found.shape[1]), np.nan)
        track[take.valid] = found
        return track

    def overlay(self, track):
        """A take's coefficients with the present pose laid over as an offset: (n_frames, P).

        Weights of a rig are kept within 0 and 1.
        """
        return self._solver.clipped(np.asarray(track) + self.coefficients)

    def _memory(self):
        return super()._memory(), self._symmetric

    def _recall(self, memory):
        steps, self._symmetric = memory
        super()._recall(steps)

    def _plain(self, value):
        if isinstance(value, PoseState):
            return state_to_dict(value)
        if isinstance(value, FaceModel):
            return fingerprint(value)
        return super()._plain(value)
