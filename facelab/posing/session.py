"""The posing session: everything that a person can do to a pose, without any widget.

Tena et al. 2011, sections 3.2 and 6. The mathematics is in `facelab.posing.solver`.
"""

import time
from copy import copy
from dataclasses import replace

import numpy as np

from facelab.checks import as_finite, as_numbers, check_choice, check_type
from facelab.geometry.symmetry import MIRROR
from facelab.models.region import BETA
from facelab.numeric.undo import History, edit, has_history
from facelab.posing.drag import Drag, moving_with, targets
from facelab.posing.face import PosedFace
from facelab.posing.fingerprint import fingerprint
from facelab.posing.molding import Molding
from facelab.posing.pins import PinEdits
from facelab.posing.ranges import GAMMA, check_beta, check_gamma, check_gaze
from facelab.posing.solver import check_limit
from facelab.posing.state import PoseState, find_model, state_from_dict, state_to_dict

_AS_IT_IS = object()


@has_history
class PosingSession(PinEdits, Molding):
    """Everything a person can do to a pose, without any widget.

    Parameters
    ----------
    model : FaceModel
        RegionModel, HolisticModel, BlendshapeRig or one of your own; fitted on displacements of
        `neutral` or of its control vertices.
    neutral : TriangleMesh
        The face at rest that is shown and pulled, millimetres.
    beta, gamma : float, default=0.5, 0.025
        β and γ, see `PoseSolver`.
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
    history : History
        Its steps, and what is under way: undo, redo, `cancel`, `settle` and `observe` are its.

    Raises
    ------
    ValueError, TypeError
        If model, neutral and binding do not belong together, or are none.

    Notes
    -----
    Eq. 9 is solved for the change since the state before the pins: what gaps a kept pose has at
    the boundaries stay as they are, and only further ones cost. Else the first pin after `keep`,
    or a mere press, would close the old gaps and move the face.

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
        beta=BETA,
        gamma=GAMMA,
        binding=None,
        shared_pins="blended",
        limit=None,
        partners=None,
        clock=time.time,
    ):
        self._face = PosedFace(neutral, binding, shared_pins, partners)
        self.neutral, self.binding, self.shared_pins = neutral, binding, shared_pins
        self._face.check_model(model)
        rest = np.zeros(model.n_coefficients)
        start = PoseState(
            model,
            {},
            check_beta(beta),
            check_gamma(gamma),
            *(rest, rest, rest),
            limit=check_limit(limit, model),
        )
        self._face.solver(start)  # refuses what it cannot use
        self.history = History(start, clock=clock)
        self.history.aside = False  # whether drags are symmetric; live is a `Drag`
        self._shown = None, None  # a state and its vertices

    def copy(self):
        """Another session of the same face in the same state, with steps of its own."""
        made = copy(self)
        made.history, made._shown = History(self.state), (None, None)
        made.history.aside = self.symmetric
        return made

    # --- what is shown ----------------------------------------------------------------------------

    @property
    def model(self):
        """The model that poses the face."""
        return self.state.model

    @property
    def models(self):
        """Models of all steps that can be undone or redone, the present one first: list."""
        return list(dict.fromkeys(state.model for state in self.history.states))

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
        """Standard deviations that coefficients are held to, or None, as for a rig.

        One set before `use` went to the rig acts again with the next model that knows any.
        """
        return self._solver.limit

    @property
    def affine(self):
        """Whether the pose is affine in a pull; if not, each move solves."""
        return self._solver.affine

    @property
    def dragging(self):
        """Whether a vertex is held."""
        return self.history.live is not None

    @property
    def log(self):
        """Every edit, for `replay`: list of {"t": seconds, "do": name, ...arguments}."""
        return self.history.log

    @property
    def coefficients(self):
        """The pose on screen as coefficients counted from the neutral (weights of a rig): (P,)."""
        return (self.history.live or self.state).coefficients.copy()

    @property
    def vertices(self):
        """The pose on screen, shape (n_vertices, 3), millimetres."""
        if self.dragging:
            return self.history.live.vertices
        if self._shown[0] is not self.state:
            self._shown = self.state, self.vertices_of(self.state.coefficients)
        return self._shown[1].copy()

    def vertices_of(self, coefficients):
        """The shown face for coefficients (P,) or (n, P): (n_vertices, 3) or (n, n_vertices, 3)."""
        return self._face.vertices(self.state, coefficients)

    def vertices_in(self, state):
        """The shown face in a `PoseState`, of any model: (n_vertices, 3), millimetres."""
        check_type(state, "state", PoseState, "give one, such as session.state")
        return self._face.vertices(state, state.coefficients)

    @property
    def pins(self):
        """Pinned vertices of the shown face and their targets: dict of int to ndarray (3,)."""
        live = self.history.live
        pins = self.state.pins if live is None else self.state.pins | live.targets
        return {v: self.neutral.vertices[v] + t for v, t in pins.items()}

    @property
    def regions(self):
        """Regions of the model, None if it has none."""
        return self._solver.regions

    @property
    def region_labels(self):
        """Region of each vertex of the shown face, (n_vertices,) int; None without regions."""
        return self._face.region_labels(self.state)

    @property
    def partners(self):
        """Mirrored partner of each vertex of the shown face, -1 for none: (n_vertices,) int."""
        return self._face.partners

    @property
    def symmetric(self):
        """Whether drags act on both sides of the face; may be set.

        The partner is pulled by the mirrored pull from where it is. A vertex on the midline keeps
        to it; one without a partner, or whose partner is locked, moves alone.
        """
        return self.history.aside

    @symmetric.setter
    @edit
    def symmetric(self, on):
        on = check_choice(on, "symmetric", (True, False))
        if on == self.symmetric:
            return self.state
        self.history.aside = on
        return None

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
        return self._face.gaps(self.state, self.coefficients)

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
            D[v, :, a] is how vertex v moves for a millimetre of pull along axis a. A `BoundedPull`
            where the pose is not affine in the pull, None if the face is too large for one.

        Raises
        ------
        ValueError
            For no vertex of the face or a locked pin; nothing changes.
        """
        self._hold(vertex)
        return self.history.live.answer

    def _hold(self, vertex):
        vertex = self._face.vertex(vertex)
        self.state.check_unlocked(vertex)
        with self.history.whole():
            self.release()
            self.history.live = Drag.begin(
                self._solver, self.state, self.neutral, vertex, self._moving(vertex), self.vertices
            )

    def _moving(self, vertex):
        """What a pull of this vertex moves, see `targets`."""
        partner = int(self.partners[vertex]) if self.symmetric else -1
        return moving_with(vertex, -1 if partner in self.locked else partner, self._place)

    def _place(self, vertex):
        """Displacement that the pin of a vertex asks for, or that the vertex has, (3,)."""
        if vertex in self.state.pins:
            return self.state.pins[vertex]
        return self.vertices[vertex] - self.neutral.vertices[vertex]

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
        vertex = self._face.vertex(vertex)
        target = self._face.place(vertex, target)
        with self.history.whole():
            if not self.dragging or self.history.live.vertex != vertex:
                self._hold(vertex)
            self.history.live = self.history.live.to(target)
        self.history.tell("move")

    def release(self):
        """Let go: the pin stays where it was dragged to, and the drag becomes one step of undo.

        A press without a drag leaves no pin: `hold` sets one where a vertex is.
        """
        drag = self.history.live
        if drag is not None:
            with self.history.whole():
                self.history.live = None
                pins = {**self.state.pins, **drag.targets}
                if drag.asked is not None and self.history.make(self._solved(pins=pins)):
                    self.history.note("pull", vertex=drag.vertex, target=drag.asked.tolist())

    @edit
    def pull(self, vertex, target):
        """Drag a vertex to a target and let go, see `drag`: one step."""
        vertex = self._face.vertex(vertex)
        target = self._face.place(vertex, target)
        self.state.check_unlocked(vertex)
        moving = self._moving(vertex)
        wanted = target - self.neutral.vertices[vertex]
        wanted = self._solver.capped(vertex, wanted, moving[vertex][0])
        return self._solved(pins={**self.state.pins, **targets(moving, vertex, wanted)})

    # --- edits ------------------------------------------------------------------------------------

    @property
    def _solver(self):
        return self._face.solver(self.state)

    def _solved(self, **changes):
        """The present state with some changes, solved for."""
        return self._face.solved(self.state, **changes)

    @edit
    def keep(self):
        """Make the present pose the state that pins start from, and take all pins away."""
        return self._solved(**self.state.bare(self.state.coefficients))

    @edit
    def reset(self):
        """Back to the neutral face without pins, looking ahead; beta, gamma and limit stay."""
        return self._solved(**self.state.bare(np.zeros_like(self.state.c_0)), gaze=(0.0, 0.0))

    @edit
    def reset_region(self, region):
        """One region back to neutral, its pins taken away; pins of other regions keep holding.

        What those pull along across the boundary stays pulled.

        Raises
        ------
        ValueError
            For a region that does not exist.
        """
        s, labels = self._solver.slice_of(region), self.region_labels
        c_0, molded = self.state.c_0.copy(), self.state.molded.copy()
        c_0[s] = molded[s] = 0
        inside = {v for v in self.state.pins if labels is None or labels[v] == region}
        return self._solved(**self.state.without(inside), c_0=c_0, molded=molded)

    @edit(over=())
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
            For one outside its range (see `PoseSolver`), beta and gamma too far apart, or a limit
            where the model knows no standard deviations; nothing changes.
        """
        changes, state = {}, self.state
        if beta is not None:
            changes["beta"] = check_beta(beta)
        if gamma is not None:
            changes["gamma"] = check_gamma(gamma)
        if limit is not _AS_IT_IS:
            changes["limit"] = check_limit(limit, state.model)
        if all(getattr(state, name) == value for name, value in changes.items()):
            return state
        return self._solved(**changes)

    def answers_to(self, name, values):
        """What the pins would make of the face for other values of beta or gamma: nothing changes.

        Parameters
        ----------
        name : {"beta", "gamma"}
        values : iterable of float

        Returns
        -------
        C : ndarray of shape (n_values, n_coefficients)

        Raises
        ------
        ValueError
            As `set`.
        """
        check_choice(name, "name", ("beta", "gamma"))
        return np.array([self._solved(**{name: x}).coefficients for x in values])

    @edit(over=())
    def apply(self, coefficients, gaze=None):
        """Pose with these coefficients, counted from the neutral; pins are taken away.

        Parameters
        ----------
        coefficients : array_like of shape (P,)
            Of a rig: weights, 0 to 1.
        gaze : array_like of shape (2,), optional
            As `PoseState` has it; it stays as it is if left out.
        """
        n = self._solver.n_coefficients
        state = self._applied(as_finite(coefficients, "coefficients", (n,)))
        return state if gaze is None else replace(state, gaze=check_gaze(gaze))

    def _applied(self, c):
        self._solver.check(c)
        return replace(self.state, **self.state.bare(c), coefficients=c)

    @edit(state=(state_to_dict, state_from_dict))
    def restore(self, state):
        """Go back to a `PoseState` of this face: pose, pins, weights of Eq. 9 and model.

        Raises
        ------
        ValueError, TypeError
            If it is none, of another face, or one that its model cannot have; nothing changes.
        """
        self._face.check_state(state)
        return state

    def check_state(self, state):
        """Refuse what `restore` would."""
        self._face.check_state(state)

    @edit
    def mirror(self):
        """The whole pose and its pins, left for right, as well as the model can.

        Raises
        ------
        ValueError
            If the mirror map leaves vertices without a partner.
        """
        left, up = self.state.gaze
        x = self._face.mirrored(self._face.before_pins(self.state)[0])
        pins = {int(self.partners[v]): (v, MIRROR @ t) for v, t in self.state.pins.items()}
        return replace(self._from(x, pins), gaze=(0.0 - left, up))

    def _from(self, x, pins):
        """The state with other pins, see `PoseState.placed`, on a face displaced by x, (n, 3)."""
        c_0 = self._solver.encode(x[None])[0]
        return self._solved(**self.state.placed(pins), c_0=c_0, molded=np.zeros_like(c_0))

    @edit
    def copy_side(self, side):
        """One half of the pose and its pins onto the other, as well as the model can.

        The answer is that to the pins on both sides, as if they had been pulled symmetrically.

        Parameters
        ----------
        side : {"left", "right"}
            The person's, that is copied; the midline loses what it leans to a side.

        Raises
        ------
        ValueError
            If the mirror map leaves vertices without a partner.
        """
        check_choice(side, "side", ("left", "right"))
        x = self._face.before_pins(self.state)[0]
        seen, at = self._face.mirrored(x), self.neutral.vertices[:, 0]
        out = (at - at[self.partners]) * (1 if side == "left" else -1)
        wanted = np.where((out > 0)[:, None], x, np.where((out < 0)[:, None], seen, (x + seen) / 2))
        pins = {}
        for v, t in self.state.pins.items():
            if out[v] > 0:
                pins |= {v: (v, t), int(self.partners[v]): (v, MIRROR @ t)}
            elif out[v] == 0:
                pins[v] = v, (t + MIRROR @ t) / 2
        return self._from(wanted, pins)

    @edit(model=(fingerprint, find_model))
    def use(self, model):
        """Pose with another model of the same face, under the same pins.

        The state before the pins is expressed in the new model as well as it can be.

        Raises
        ------
        ValueError
            If the model is of another face; nothing changes.
        """
        self._face.check_model(model)
        if model is self.model:
            return self.state
        c_0 = self._face.carried_over(self.state, model)
        return self._solved(model=model, c_0=c_0, molded=np.zeros_like(c_0))

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
        wanted = "n_frames", self.model.n_coefficients
        track = as_numbers(track, "track", f"({wanted[0]}, {wanted[1]})")
        if track.ndim != 2 or track.shape[1] != wanted[1]:
            raise ValueError(
                f"track has shape {track.shape}, but needs shape ({wanted[0]}, {wanted[1]}): give "
                "one that `encode` made with this model."
            )
        return self._solver.clipped(track + self.coefficients)
