"""A face and what models make of it: all of a posing session that no edit changes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from facelab.checks import as_finite, as_numbers, check_index, check_type
from facelab.face_model import FaceModel
from facelab.geometry.binding import LinearBinding
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.geometry.symmetry import MIRROR, check_partners, mirror_partners
from facelab.posing.ranges import check_displacement, check_gaze, check_size, check_weight
from facelab.posing.solver import PoseSolver
from facelab.posing.state import PoseState

_SOLVERS_KEPT = 3  # so that going back to another model is quick


class PosedFace:
    """A face at rest, how a model's vertices move it, and the answers to the states of a session.

    Parameters
    ----------
    neutral, binding, shared_pins, partners
        As for `PosingSession`.

    Raises
    ------
    ValueError, TypeError
        If neutral, binding and partners do not belong together, or are none.
    """

    def __init__(self, neutral, binding, shared_pins, partners):
        check_type(neutral, "neutral", TriangleMesh, "give the face at rest")
        check_face_size(neutral.vertices, "neutral")
        if binding is not None:
            check_type(binding, "binding", LinearBinding, "give that of `bind_to_samples`")
        if binding is not None and binding.mesh.n_vertices != neutral.n_vertices:
            raise ValueError(
                f"binding carries {binding.mesh.n_vertices} vertices, but neutral has "
                f"{neutral.n_vertices}; bind the neutral itself."
            )
        if partners is not None:
            partners = check_partners(partners, neutral.n_vertices)
        self.neutral, self.binding, self.shared_pins = neutral, binding, shared_pins
        self._partners, self._solvers = partners, {}

    @property
    def partners(self):
        """Mirrored partner of each vertex, -1 for none: (n_vertices,) int."""
        if self._partners is None:
            self._partners = mirror_partners(self.neutral)
        return self._partners

    def check_model(self, model):
        """Refuse what is no model, not fitted, or of another face."""
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

    def check_state(self, state):
        """Refuse what is no `PoseState`, of another face, or one that its model cannot have."""
        check_type(state, "state", PoseState, "give one, such as session.state")
        self.check_model(state.model)
        solver = self.solver(state)  # refuses what it cannot use
        for v, target in state.pins.items():
            check_displacement(target, f"displacement of pin {self.vertex(v)}")
        for v, weight in state.weights.items():
            check_weight(weight, f"weight of pin {v}")
        check_gaze(state.gaze)
        named = state.locked | state.hidden | state.weights.keys() | state.called.keys()
        unpinned = named - state.pins.keys()
        if unpinned:
            raise ValueError(
                f"state locks, hides, names or weights {sorted(unpinned)}, which it does not pin."
            )
        for name in ("c_0", "molded", "coefficients"):
            as_finite(getattr(state, name), name, (solver.n_coefficients,))
        self._check_size(state)

    def _check_size(self, state):
        check_size(state.c_0)
        check_size(state.molded)
        self.solver(state).check(state.coefficients)

    def vertex(self, vertex):
        """The vertex as int, refused if the face has none of this number."""
        return check_index(vertex, "vertex", self.neutral.n_vertices, "vertices of the face")

    def place(self, vertex, target):
        """A target of a vertex as an array of its own, (3,), refused unless it is near the face."""
        target = as_finite(target, "target", (3,), remedy="give three finite coordinates").copy()
        check_displacement(target - self.neutral.vertices[vertex], "target")
        return target

    def solver(self, state):
        """The solver for the model and the settings of a state."""
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

    def solved(self, state, **changes):
        """The state with some changes, and the coefficients that answer its pins then (Eq. 9).

        Refused if the settings and weights allow no sound answer, or if that is beyond reason.
        """
        new = SimpleNamespace(**vars(state) | changes)  # a state that has no answer yet
        weights = [new.weights.get(v, 1.0) for v in new.pins]
        targets = np.array(list(new.pins.values()), dtype=float).reshape(-1, 3)
        c = self.solver(new).problem(list(new.pins), weights).solve(targets, new.c_0, new.molded)
        state = replace(state, **changes, coefficients=c)
        self._check_size(state)
        return state

    def vertices(self, state, coefficients):
        """The face for coefficients of the state's model, (P,) or (n, P), millimetres."""
        solver, P = self.solver(state), state.model.n_coefficients
        coefficients = as_numbers(coefficients, "coefficients", f"({P},) or (n, {P})")
        as_finite(np.atleast_2d(coefficients), "coefficients", ("n", P))
        check_size(coefficients)
        V = self.neutral.vertices + solver.shown(coefficients)
        return V[0] if coefficients.ndim == 1 else V

    def before_pins(self, state):
        """Displacements of the shown face that a state would have without its pins: (1, n, 3)."""
        own = self.solver(state)
        return own.shown(own.problem([]).solve(np.zeros((0, 3)), state.c_0, state.molded))

    def carried_over(self, state, model):
        """c_0 of a state without its pins, as another model can express it, (P,)."""
        return self.solver(replace(state, model=model)).encode(self.before_pins(state))[0]

    def mirrored(self, x):
        """Displacements of the shown face left for right, (n_vertices, 3)."""
        alone = np.flatnonzero(self.partners < 0)
        if alone.size:
            raise ValueError(
                f"{alone.size} vertices have no mirrored partner, the first {alone[0]}; give "
                "partners=mirror_partners(neutral, tolerance) with a larger tolerance."
            )
        return x[self.partners] @ MIRROR

    def gaps(self, state, coefficients):
        """How far regions disagree before blending, at each shown vertex: (n_vertices,), mm."""
        solver = self.solver(state)
        gap = solver.gaps(coefficients)
        if solver.binding is None:
            return gap
        return self.binding.carry(gap[:, None])[:, 0].clip(min=0)

    def region_labels(self, state):
        """Region of each vertex for the state's model, (n_vertices,) int; None without regions."""
        solver = self.solver(state)
        if solver.regions is None:
            return None
        labels = solver.regions.labels
        return labels if solver.binding is None else labels[self.binding.handle_of]
