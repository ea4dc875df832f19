"""Everything a person can do to read action units off a sketch, without any widget."""

import warnings
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from facelab.checks import check_choice, check_index, check_number, check_type
from facelab.expression.reading import find_units
from facelab.expression.regression import CRITERIA, LAMS, ExpressionFit, regress_expression
from facelab.expression.sketch_pins import NO_PINS, SketchPins, fixed_positions
from facelab.expression.transfer import IntermediateSpace
from facelab.expression.units import as_basis
from facelab.files.meshes import read_mesh
from facelab.files.obj import write_obj
from facelab.files.poses import save_pose
from facelab.files.takes import write_live_link_csv, write_weights_csv
from facelab.motion import MotionSequence, WeightSequence
from facelab.numeric.undo import History, has_history
from facelab.posing.bounded import LARGEST_BASIS, BoundedPull, FaceBasis
from facelab.posing.session import PosingSession
from facelab.rig import BlendshapeRig

ALPHAS = np.concatenate([np.arange(100) / 10, np.arange(10.0, 101)])
"""Alphas looked at, 0 to 100: fine steps up to 10, where the sums of natural faces lie."""

BOUNDS = {"free": None, "not negative": (0, None), "0 to 1": (0, 1)}
"""Bounds of the weights by name; the paper names none (see design)."""

LOCKS = -1e3, 1e3
"""Ends of a weight set by hand."""

ALIGN = ("check", True, False)
"""Refuse a sketch that is moved as a whole, take that motion out, or fit it as it is."""

_STEPS = 200  # of undo: each keeps a face and a path


@dataclass(frozen=True, eq=False)
class ExpressionState:
    """One moment of a session: all that decides the weights, and the answer.

    Parameters
    ----------
    sketch : ndarray of shape (n_vertices, 3)
        As it was loaded, millimetres.
    origin : str
        Where the sketch came from, in words.
    alpha : float or None
        Wanted sum of the weights; None follows the best one.
    lam : float
    bounds : str
        One of `BOUNDS`.
    criterion : str
        How the best alpha is chosen.
    align : {"check", True, False}
    clamp : bool
        Whether vertices beyond their boundary fall back to it.
    locked : mapping of str to float
        Weights set by hand.
    excluded : frozenset of str
        Units held at 0.
    fit : ExpressionFit
        The whole path over alpha.
    pulls : mapping of int to tuple of 3 floats
        Pins of a sketch that was pulled by hand: how far each vertex was pulled, millimetres.
    hidden : frozenset of int
        Pins that are not drawn.
    called : mapping of int to str
        Names given to pins.
    """

    sketch: np.ndarray = field(repr=False)
    origin: str
    alpha: float | None
    lam: float
    bounds: str
    criterion: str
    align: object
    clamp: bool
    locked: MappingProxyType
    excluded: frozenset
    fit: ExpressionFit = field(default=None, repr=False)
    pulls: MappingProxyType = field(default_factory=dict)
    hidden: frozenset = frozenset()
    called: MappingProxyType = field(default_factory=dict)

    def same(self, other):
        """Whether nothing differs that the weights depend on."""
        return np.array_equal(self.sketch, other.sketch) and all(
            getattr(self, f.name) == getattr(other, f.name)
            for f in fields(self)
            if f.name not in ("sketch", "fit")
        )


@has_history
class ExpressionSession(SketchPins):
    """Find the action units of a sketch, step by step, with undo.

    A step that fails (a sketch with NaN, of another face, not aligned) changes nothing. The whole
    path over alpha is solved once for each setting; moving alpha only reads it.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
        The face and its units; a basis from `prepare_units` decides what becomes of still and
        dependent units.
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3), optional
        On the vertices of the rig, millimetres; the neutral if left out.
    lam : float, default=1.0
        λ, weight of sum(w) = alpha, millimetres, see `regress_expression`.
    bounds : str, default="0 to 1"
        One of `BOUNDS`: "free", "not negative", "0 to 1".
    origin : str
        Where the sketch came from, in words.

    Attributes
    ----------
    basis : UnitBasis
    rig : BlendshapeRig
    history : History
        Its steps, the last 200: undo, redo, `settle`, `group` and `observe` are its.
    dropped : frozenset of str
        Units that were left out because they move nothing of their own.

    Raises
    ------
    ValueError, TypeError
        As `regress_expression`.

    References
    ----------
    Yu and Liu 2014, section IV.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> session = facelab.ExpressionSession(rig, rig.shape({rig.names[0]: 0.5}))
    >>> bool(session.fit.rms[session.fit.best] < 0.01)  # millimetres
    True
    """

    def __init__(self, rig, sketch=None, lam=1.0, bounds="0 to 1", origin="sketch"):
        self.basis = as_basis(rig)
        self.rig = self.basis.rig
        self.dropped = frozenset(self.basis.dropped)
        self._shown = None, None  # a state and its displacements
        start = ExpressionState(
            sketch=fixed_positions(self.rig.neutral if sketch is None else sketch),
            origin="neutral" if sketch is None else origin,
            alpha=None,
            lam=check_number(lam, "lam", *LAMS),
            bounds=check_choice(bounds, "bounds", tuple(BOUNDS)),
            criterion="e_rms",
            align="check",
            clamp=False,
            locked=MappingProxyType({}),
            excluded=frozenset(),
        )
        self.history = History(self._solved(start), most=_STEPS)

    # --- what is shown ----------------------------------------------------------------------------

    @property
    def fit(self):
        """The present `ExpressionFit`: weights and errors for every alpha."""
        return self.state.fit

    @property
    def names(self):
        """Units, in the order of the weights."""
        return self.rig.names

    @property
    def best_alpha(self):
        """Best alpha by the criterion of the session."""
        return float(self.fit.alphas[self.fit.best])

    @property
    def alpha(self):
        """Alpha of the face on screen."""
        return self.best_alpha if self.state.alpha is None else self.state.alpha

    @property
    def weights(self):
        """Weights of all units at the present alpha, shape (K,)."""
        return self.fit.at(self.alpha)

    @property
    def named(self):
        """The units that take part and their weights, strongest first: dict of str to float."""
        w = self.weights
        return {self.names[i]: float(w[i]) for i in np.argsort(-np.abs(w)) if abs(w[i]) > 1e-6}

    @property
    def sketch(self):
        """The sketch as it is fitted, aligned if that was asked for: (n_vertices, 3), mm."""
        return self.rig.neutral.vertices + self.fit.displacement

    @property
    def vertices(self):
        """The optimised face S_0 + sum w_i d_i (Eq. 1), shape (n_vertices, 3), millimetres."""
        moved = self._moved()
        moved = self.basis.clamped(moved) if self.state.clamp else moved
        return self.rig.neutral.vertices + moved

    def _moved(self):
        if self._shown[0] is not self.state:
            self._shown = self.state, self.basis.moved(self.weights)
        return self._shown[1]

    @property
    def distance(self):
        """From the optimised face to the sketch at each vertex, millimetres, (n_vertices,)."""
        return np.linalg.norm(self.vertices - self.sketch, axis=1)

    @property
    def rms(self):
        """Root mean squared distance a vertex, millimetres."""
        return float(np.sqrt((self.distance**2).mean()))

    @property
    def excess(self):
        """How far each vertex would go beyond its boundary, mm, (n_vertices,); mostly 0.

        The boundary is the largest displacement that any one unit gives the vertex.
        """
        return self.basis.excess(self._moved())

    @property
    def reach(self):
        """Smallest and largest sum of the weights that bounds, locks and exclusions allow."""
        k = self.basis.kept
        return float(self.fit.lo[k].sum()), float(self.fit.hi[k].sum())

    @property
    def note(self):
        """What has to be said about the present alpha; empty if nothing."""
        low, high = self.reach
        if low - 1e-9 <= self.alpha <= high + 1e-9:
            return ""
        side = f"at most {high:.3g}" if self.alpha > high else f"at least {low:.3g}"
        return (
            f"α = {self.alpha:g} cannot be reached: the weights sum to {side} here, so α only "
            "pulls them there."
        )

    # --- the sketch -------------------------------------------------------------------------------

    def load(self, sketch, origin="sketch", live=False, pulled=None):
        """Take another sketch; all settings stay.

        Parameters
        ----------
        sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
            On the vertices of the rig, millimetres: a posed face (`PosingSession.vertices`), a
            sculpted one (`Sculpt.vertices`), a frame.
        origin : str
            Where it came from, in words.
        live : bool, default=False
            While the sketch is still being drawn: a stroke of such calls is one step of undo,
            ended by `settle`.
        pulled : int, optional
            The vertex by which the present sketch was pulled (`Sculpt`) to make this one; it
            becomes a pin. Pins of another sketch go.

        Raises
        ------
        ValueError
            For NaN, another number of vertices, another size, or a sketch that is not aligned
            (unless `set(align=...)` says otherwise); nothing changes.
        """
        check_type(origin, "origin", str, "say in words where the sketch came from")
        V, marks = fixed_positions(sketch), dict(NO_PINS)
        if pulled is not None:
            went = V[pulled] - self.sketch[pulled]
            marks = {"pulls": self._pulls_and(pulled, went)}
        self._step("sketch" if live else None, sketch=V, origin=origin, **marks)

    def load_file(self, path, scale=None, origin=None):
        """Take the mesh of an OBJ, PLY, GLB, glTF or STL file as the sketch.

        Parameters
        ----------
        path : str or Path
        scale : float, optional
            Millimetres in the file's unit of length: 10 for centimetres; as `read_mesh` if left
            out.
        origin : str, optional
            What to call it; the path if left out.
        """
        self.load(read_mesh(path, scale=scale).vertices, origin or str(path))

    def load_frame(self, motion, frame, origin=None, live=False):
        """Take one frame of a MotionSequence as the sketch.

        Raises
        ------
        ValueError
            For a frame that does not exist or was lost, and as `load`.
        """
        check_type(motion, "motion", MotionSequence, "give a single face to load")
        frame = check_index(frame, "frame", motion.n_frames, "frames")
        if not motion.valid[frame]:
            raise ValueError(f"frame={frame} was lost in the recording; choose another one.")
        self.load(motion.positions[frame], origin or f"frame {frame}", live)

    # --- settings ---------------------------------------------------------------------------------

    def set(self, alpha=None, lam=None, bounds=None, criterion=None, align=None, clamp=None):
        """Change one setting or more; what is left out stays.

        A stroke of changes of alpha alone, or of lam alone, is one step of undo.

        Parameters
        ----------
        alpha : float or "best"
            Wanted sum of the weights, 0 to 100, or always the best by the criterion.
        lam : float
            λ, millimetres: 0 to 1,000, and less where units are alike.
        bounds : str
            One of `BOUNDS`.
        criterion : str
            See `ExpressionFit.choose`.
        align : {"check", True, False}
            Refuse a sketch that is moved as a whole, take that motion out, or fit it as it is.
        clamp : bool
            Whether vertices beyond their boundary fall back to it.

        Raises
        ------
        ValueError, TypeError
            For a value that is not allowed; nothing changes.
        """
        changes = {}
        if isinstance(alpha, str) and check_choice(alpha, "alpha", ("best",)):
            changes["alpha"] = None
        elif alpha is not None:
            changes["alpha"] = check_number(alpha, "alpha", low=ALPHAS[0], high=ALPHAS[-1])
        if lam is not None:
            changes["lam"] = check_number(lam, "lam", *LAMS)
        for name, value, choices in (
            ("bounds", bounds, tuple(BOUNDS)),
            ("criterion", criterion, CRITERIA),
            ("align", align, ALIGN),
            ("clamp", clamp, (True, False)),
        ):
            if value is not None:
                changes[name] = check_choice(value, name, choices)
        stroke = "".join(changes)
        self._step(stroke if stroke in ("alpha", "lam") else None, **changes)

    def lock(self, name, weight=None):
        """Hold a unit at a weight: set by hand, or the present one if left out.

        The others are solved for anew. A hand may go beyond the bounds, to 1,000 either way. A
        stroke of weights for the same unit is one step of undo.
        """
        index = self._index(name)
        weight = self.weights[index] if weight is None else check_number(weight, "weight", *LOCKS)
        locked = {**self.state.locked, name: float(weight)}
        self._step(
            f"lock {name}",
            locked=MappingProxyType(locked),
            excluded=self.state.excluded - {name},
        )

    def exclude(self, name):
        """Leave a unit out: its weight is 0, and the others are solved for anew."""
        self._index(name)
        self._step(locked=self._locked_but(name), excluded=self.state.excluded | {name})

    def free(self, name=None):
        """Let a unit go that was locked or excluded; all of them if no name is given."""
        if name is None:
            self._step(locked=MappingProxyType({}), excluded=frozenset())
            return
        self._index(name)
        if name not in self.state.locked and name not in self.state.excluded:
            raise ValueError(f"name={name!r} is neither locked nor excluded.")
        self._step(locked=self._locked_but(name), excluded=self.state.excluded - {name})

    def keep_found(self):
        """Exclude all units but those that `find_units` finds in the sketch, one step of undo.

        Returns
        -------
        UnitReading
        """
        state = self.state
        found = find_units(
            self.basis,
            state.sketch,
            BOUNDS[state.bounds],
            locked=state.locked,
            align=state.align,
        )
        there = set(found.units) | set(state.locked) | set(self.dropped)
        self._step(alpha=None, excluded=frozenset(self.names) - there)
        return found

    def _locked_but(self, name):
        return MappingProxyType({n: w for n, w in self.state.locked.items() if n != name})

    def _index(self, name):
        if name not in self.names:
            raise ValueError(f"name={name!r} is no unit here; there are {', '.join(self.names)}.")
        if name in self.dropped:
            raise ValueError(f"name={name!r} moves nothing of its own and was left out.")
        return self.names.index(name)

    # --- while the sketch is pulled ---------------------------------------------------------------

    def follow(self, D):
        """How the optimised face follows while the sketch is pulled.

        At the present alpha; where the best by e_rms is followed that is the plain fit, whatever
        the pull.

        Parameters
        ----------
        D : ndarray of shape (n_vertices, 3, 3)
            D[v, :, a] is how vertex v of the sketch moves for a millimetre of pull along axis a.

        Returns
        -------
        BoundedPull or None
            None where the weights are not those of a bounded least squares problem (aligned or
            clamped), or the face is too large.
        """
        state, fit, basis = self.state, self.fit, self.basis
        if state.align is True or state.clamp or self._face_basis is None:
            return None
        n, k = basis.rig.neutral.n_vertices, basis.kept
        best = state.alpha is None and state.criterion == "e_rms"
        pull = 0.0 if best else state.lam**2
        inverse = np.linalg.inv(basis.gram / n + pull)
        sketch = np.column_stack([fit.displacement.ravel(), D.reshape(-1, 3)])
        sides = basis.R.T @ (basis.Q.T @ sketch) / n
        sides[:, 0] += pull * self.alpha
        free = inverse @ sides
        return BoundedPull(
            start=self.weights[k],
            free=free[:, 0],
            slope=free[:, 1:],
            inverse=inverse,
            lo=fit.lo[k],
            hi=fit.hi[k],
            give=np.zeros(len(k)),
            basis=self._face_basis,
        )

    @cached_property
    def _face_basis(self):
        deltas = self.rig.deltas[self.basis.kept]
        return None if 4 * deltas.size > LARGEST_BASIS else FaceBasis(np.float32(deltas), None)

    # --- steps ------------------------------------------------------------------------------------

    def _solved(self, state, before=None):
        """The state with its fit: that of the state before, unless what it depends on changed."""
        shared = ("sketch", "lam", "bounds", "align", "locked", "excluded")
        if before is not None and all(getattr(state, a) is getattr(before, a) for a in shared):
            return replace(state, fit=replace(before.fit, criterion=state.criterion))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # alphas out of reach: `note` says so
            fit = regress_expression(
                self.basis,
                state.sketch,
                state.lam,
                ALPHAS,
                BOUNDS[state.bounds],
                locked=state.locked,
                excluded=state.excluded,
                align=state.align,
                criterion=state.criterion,
            )
        fit.best  # noqa: B018 (found now, or the sketch is refused)
        return replace(state, fit=fit)

    def _step(self, stroke=None, **changes):
        """Make the changes a step of undo, or part of the stroke under way, if they are any."""
        state = replace(self.state, **changes)
        if not state.same(self.state):
            with self.history.group(stroke):
                self.history.make(self._solved(state, self.state))

    # --- where the result goes --------------------------------------------------------------------

    def on(self, face):
        """The same expression on another face: its vertices, shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        face : BlendshapeRig or IntermediateSpace
            Of another person, with units of the same names; those it has beyond them rest at 0.
            A space gives the face on its target's own mesh.

        Raises
        ------
        TypeError, ValueError
            If it is no such face, or lacks a unit that takes part.
        """
        kinds = (BlendshapeRig, IntermediateSpace)
        check_type(face, "face", kinds, "give units of the same names on that face")
        if isinstance(face, IntermediateSpace):
            return face.to_target(self.on(face.rig))
        missing = [n for n, w in self.named.items() if n not in face.names and abs(w) > 1e-3]
        if missing:
            raise ValueError(
                f"face lacks {', '.join(missing)}, which take part in this expression; exclude "
                "them here, or give a face with the same units."
            )
        return face.shape({n: w for n, w in self.named.items() if n in face.names})

    def take(self, fps=30.0):
        """The weights as a WeightSequence of one frame: what files and tables are written from."""
        return WeightSequence(self.weights[None], self.names, fps)

    def save(self, path):
        """Write the result; the end of the name says as what.

        Parameters
        ----------
        path : str or Path
            `.livelink.csv`: the weights under ARKit's names, as Live Link Face records them.
            Any other `.csv`: a table of the weights. `.json`: a pose, for `facelab.files.load_pose`
            with a PosingSession on this rig. `.obj`: the optimised face.

        Returns
        -------
        str
            What the file could not hold; empty if nothing.

        Raises
        ------
        ValueError
            For another end, or weights that such a file cannot hold; no file is left.
        """
        name = str(path).lower()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            if name.endswith(".livelink.csv"):
                write_live_link_csv(path, self.take())
            elif name.endswith(".csv"):
                write_weights_csv(path, self.take())
            elif name.endswith(".json"):
                posing = PosingSession(self.rig, self.rig.neutral)
                try:
                    posing.apply(self.weights)
                except ValueError as error:
                    raise ValueError(
                        f"{error} For a pose choose bounds='0 to 1' and lock nothing beyond them, "
                        "or save as .csv."
                    ) from None
                save_pose(path, posing, self.state.origin)
            elif name.endswith(".obj"):
                write_obj(path, self.rig.neutral.with_vertices(self.vertices))
            else:
                raise ValueError(
                    f"path={str(path)!r}: end it in .csv, .livelink.csv, .json or .obj."
                )
        return " ".join(str(w.message) for w in said)
