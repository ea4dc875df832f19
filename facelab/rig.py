"""Blendshape rigs: a neutral face and named displacements that are added to it."""

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg.blas import daxpy

from facelab.checks import as_finite, check_count
from facelab.face_model import FaceModel
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.motion import MotionSequence, WeightSequence
from facelab.names import canonical, match_names, normalised


@dataclass(frozen=True, eq=False)
class RigSource:
    """Where a rig was read from, and how its vertices came about.

    Parameters
    ----------
    path : str
        File; of a folder of OBJ files, that of the face at rest.
    mesh : str
        The part of it that the rig is.
    index : ndarray of int, shape (n_file_vertices,)
        Vertex of the rig for each vertex of that part in the file: the two sides of a seam have
        the same. -1 for what the rig has no vertex for, see `BlendshapeRig.on`.
    scale : float
        Millimetres in the file's unit of length.
    apart : int
        Vertices of the rig that lie where another one does, but move otherwise: lips that touch.
    """

    path: str
    mesh: str
    index: np.ndarray
    scale: float
    apart: int = 0


@dataclass(frozen=True, eq=False)
class BlendshapeRig(FaceModel):
    """A face as a neutral mesh and a sum of weighted displacements (Yu and Liu 2014, Eq. 1).

    Posed by hand its weights stay within 0 and 1 (Lewis and Anjyo 2010, as Tena et al. 2011 quote
    them).

    Parameters
    ----------
    neutral : TriangleMesh
        The face at rest, millimetres.
    names : sequence of str
        Name of each shape, each once.
    deltas : ndarray of shape (n_shapes, n_vertices, 3)
        d_i: displacement of every vertex at weight 1, millimetres; float32 is kept.
    identities : dict of str to ndarray of shape (n_vertices, 3), optional
        Displacements that turn the neutral into other people, millimetres.
    parts : dict of str to TriangleMesh or BlendshapeRig, optional
        What else belongs to the head, by name: eyes, teeth, hair. A rig where it has shapes.
    source : RigSource, optional
        The file it was read from.

    Examples
    --------
    >>> from facelab import BlendshapeRig, TriangleMesh
    >>> face = TriangleMesh([[0, 0, 0], [10, 0, 0], [0, 10, 0]], [[0, 1, 2]])
    >>> rig = BlendshapeRig(face, ["raise"], [[[0, 0, 0], [0, 0, 0], [0, 4, 0]]])
    >>> rig.shape({"raise": 0.5})[2].tolist()
    [0.0, 12.0, 0.0]
    """

    neutral: TriangleMesh
    names: tuple
    deltas: np.ndarray
    identities: dict = field(default_factory=dict)
    parts: dict = field(default_factory=dict)
    source: RigSource | None = None

    bounds = (0.0, 1.0)
    named = True

    def __post_init__(self):
        names = tuple(self.names)
        deltas = np.asarray(self.deltas)
        if not names:
            raise ValueError("names is empty: a rig needs at least one shape.")
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names holds {', '.join(twice)} more than once; each needs its own.")
        as_finite(deltas, "deltas", (len(names), self.neutral.n_vertices, 3))
        for name, shift in self.identities.items():
            as_finite(shift, f"identities[{name!r}]", (self.neutral.n_vertices, 3))
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "deltas", deltas if deltas.dtype.kind == "f" else deltas * 1.0)

    def __repr__(self):
        return f"BlendshapeRig({len(self.names)} shapes on {self.neutral.n_vertices} vertices)"

    # --- what a session asks of any model ---------------------------------------------------------

    @property
    def mesh(self):
        """The face at rest."""
        return self.neutral

    @cached_property
    def basis(self):
        """The displacements in float64, as they lie in memory: (n_shapes, n_vertices, 3), mm."""
        return np.ascontiguousarray(self.deltas, dtype=float)

    def displacements(self, coefficients):
        """Displacements from the neutral, shape (n, n_vertices, 3); only active units are added."""
        D = self.basis.reshape(len(self.names), -1)
        W = np.atleast_2d(coefficients)
        X = np.zeros((len(W), D.shape[1]))
        for x, w in zip(X, W, strict=True):
            for k in np.flatnonzero(w):
                daxpy(D[k], x, a=w[k])  # in place
        return X.reshape(len(W), -1, 3)

    def component_names(self, region):
        """Names of the units: list of str."""
        return list(self.names)

    def fingerprint_parts(self):
        """The names of the units and their displacements."""
        return "rig", list(self.names), [self.deltas]

    def encode_weights(self, take):
        """Recorded weights in the rig's order, see `rig_weights`."""
        return self.rig_weights(take)

    # --- shapes and takes -------------------------------------------------------------------------

    def weights_of(self, named):
        """Weights in the rig's order from a dict of names; the others are zero.

        Raises
        ------
        ValueError
            For names that the rig does not have.
        """
        unknown = sorted(set(named) - set(self.names))
        if unknown:
            raise ValueError(
                f"unknown shape(s) {', '.join(unknown)}; this rig has {', '.join(self.names)}."
            )
        return np.array([float(named.get(name, 0)) for name in self.names])

    def shape(self, weights):
        """Vertices at the given weights, shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        weights : dict of str to float, or array_like of shape (n_shapes,)
        """
        if isinstance(weights, dict):
            weights = self.weights_of(weights)
        weights = as_finite(weights, "weights", (len(self.names),))
        return self.neutral.vertices + np.tensordot(weights, self.deltas, axes=1)

    def renamed(self, mapping):
        """The rig with other names for some of its shapes, and its parts alike.

        Parameters
        ----------
        mapping : dict of str to str
            New names by old ones; shapes that are not in it keep theirs.

        Raises
        ------
        ValueError
            For a name that the rig does not have, or if two shapes would have the same.
        """
        self.weights_of(dict.fromkeys(mapping, 0))
        parts = {
            name: part.renamed({k: v for k, v in mapping.items() if k in part.names})
            if isinstance(part, BlendshapeRig)
            else part
            for name, part in self.parts.items()
        }
        return replace(self, names=[mapping.get(n, n) for n in self.names], parts=parts)

    @cached_property
    def still(self):
        """Vertices of pieces that no shape moves by 0.001 mm, as eyeballs: bool (n_vertices,)."""
        moves = np.zeros(self.neutral.n_vertices, dtype=bool)
        for delta in self.deltas:
            moves |= (np.abs(delta) > 1e-3).any(axis=1)
        return np.bincount(self.neutral.pieces, moves)[self.neutral.pieces] == 0

    def on(self, vertices, mesh=None):
        """The rig on some of its vertices; its source leads back to these.

        Parameters
        ----------
        vertices : ndarray of int, shape (n_kept,)
        mesh : TriangleMesh, optional
            Triangles for the kept vertices, from `TriangleMesh.subsample`; the triangles that
            lie wholly among the kept vertices if left out.
        """
        source = self.source
        if source is not None:
            new = np.full(self.neutral.n_vertices + 1, -1)  # the last one for what has none: -1
            new[vertices] = np.arange(len(vertices))
            source = replace(source, index=new[source.index])
        return BlendshapeRig(
            self.neutral.submesh(vertices) if mesh is None else mesh,
            self.names,
            self.deltas[:, vertices],
            {name: shift[vertices] for name, shift in self.identities.items()},
            source=source,
        )

    def animate(self, take, dtype=np.float32):
        """Drive the rig with recorded weights.

        Recorded names find the rig's own, see `match` (`eyeBlinkLeft` drives `eyeBlink_L`; a
        name without a side drives both sides). Weights are clipped to [0, 1]. Recorded shapes
        that the rig does not have move nothing; shapes that were not recorded rest at zero: both
        are said in a warning. Lost frames stay lost: their positions are the neutral and `valid`
        is False.

        Parameters
        ----------
        take : WeightSequence
        dtype : numpy dtype, default=float32
            Type of the positions.

        Returns
        -------
        MotionSequence
            Positions of shape (n_frames, n_vertices, 3), millimetres.

        Raises
        ------
        ValueError
            If no recorded name drives any shape of the rig, or names are unclear.
        """
        check_face_size(self.neutral.vertices, "rig")
        weights = self.rig_weights(take)
        flat = self.deltas.reshape(len(self.names), -1).astype(dtype)
        moved = weights.astype(dtype) @ flat
        moved += self.neutral.vertices.ravel().astype(dtype)
        positions = moved.reshape(len(weights), -1, 3)
        return MotionSequence(positions, take.fps, self.neutral, take.valid)

    def match(self, take):
        """What of the rig a take drives, what it does not, and what of the take is left over.

        Parameters
        ----------
        take : WeightSequence

        Returns
        -------
        facelab.names.NameMatch
            Printed, a report. Case, separators, the spelling of sides and prefixes do not matter;
            `renamed`, of the rig or of the take, mends what does.

        Raises
        ------
        ValueError
            Where several names read alike, see `facelab.names.match_names`.

        Examples
        --------
        >>> import facelab
        >>> face = facelab.TriangleMesh([[0, 0, 0], [90, 0, 0], [0, 90, 0]], [[0, 1, 2]])
        >>> rig = facelab.BlendshapeRig(face, ["head.JawOpen", "nod"], np.ones((2, 3, 3)))
        >>> rig.match(facelab.WeightSequence([[0.5]], ["jawOpen"], fps=30))
        NameMatch(1 of 2 shapes driven by 1 of 1 names)
        """
        return match_names(self.names, take.names)

    def plausible_mixtures(self, n_frames=600, fps=30.0, random_state=0):
        """Faces that the rig makes of a few of its shapes at once, where there is no take.

        Each frame mixes one to six units at random weights. A unit is a shape, or both sides of
        one: these move together in three frames of four, nearly alike. Units that undo each other
        (a jaw to the left and to the right, a brow up and down: displacements with a cosine below
        -0.4) do not meet.

        Parameters
        ----------
        n_frames : int, default=600
        fps : float, default=30.0
            The frames have no order in time; a rate is only needed to go on with them as a take.
        random_state : int, default=0

        Returns
        -------
        WeightSequence
            Weights from 0 to 1, by the rig's names.

        Examples
        --------
        >>> import facelab
        >>> take = facelab.load_example().rig.plausible_mixtures(100)
        >>> take.n_frames, bool(1 < (take.weights > 0).sum(axis=1).mean() < 12)
        (100, True)
        """
        n_frames = check_count(n_frames, "n_frames", 1, None, "frames")
        rng = np.random.default_rng(random_state)
        flat = self.deltas.reshape(len(self.names), -1).astype(float)
        size = np.linalg.norm(flat, axis=1)
        unit = flat / np.where(size > 0, size, 1)[:, None]
        contrary = unit @ unit.T < -0.4
        sided = {}
        for k, name in enumerate(self.names):
            if size[k] > 0:
                plain = normalised(name)
                sided.setdefault(plain.removesuffix("left").removesuffix("right"), []).append(k)
        pairs = [k for k in sided.values() if len(k) == 2 and not contrary[k[0], k[1]]]
        single = [[k] for k in np.flatnonzero(size > 0) if not any(k in pair for pair in pairs)]
        units = pairs + single
        if not units:
            raise ValueError(
                f"rig: its {len(self.names)} shapes move nothing, so nothing can be mixed of them; "
                "export it again with its shapes."
            )
        W = np.zeros((n_frames, len(self.names)))
        for row in W:
            for _ in range(rng.integers(1, 7)):
                shapes = units[rng.integers(len(units))]
                if contrary[shapes][:, row > 0].any():
                    continue
                if len(shapes) == 2 and rng.random() < 0.25:
                    shapes = [shapes[rng.integers(2)]]
                row[shapes] = rng.beta(1.2, 1.5) * rng.uniform(0.85, 1, len(shapes))
        return WeightSequence(W, self.names, fps)

    def rig_weights(self, take):
        """Recorded weights in the rig's order, clipped to [0, 1]; zero in lost frames.

        Returns
        -------
        W : ndarray of shape (n_frames, n_shapes)

        Raises
        ------
        ValueError
            If no recorded name drives any shape of the rig, or names are unclear (see `match`).

        Warns
        -----
        UserWarning
            Of shapes that nothing drives, and of recorded motion that drives nothing. (Not of the
            tongue, which hardly a face has.)
        """
        match = self.match(take)
        if not match.driven:
            raise ValueError(
                f"no recorded name drives this rig: recorded are {_few(take.names)}, the rig has "
                f"{_few(self.names)}; rename the columns of the take (take.renamed) or the shapes "
                "(rig.renamed), or translate the take from the rig that it was made for."
            )
        column = {name: k for k, name in enumerate(take.names)}
        moves = np.abs(take.weights[take.valid]).max(axis=0, initial=0) > 0.01
        lost = [n for n in match.left_over if moves[column[n]] and canonical(n) != "tongueOut"]
        if match.idle or lost:
            said = [f"not driven: {_few(match.idle)}"] * bool(match.idle)
            said += [f"recorded, but drives nothing: {_few(lost)}"] * bool(lost)
            warnings.warn(
                f"the take drives {len(match.driven)} of {len(self.names)} shapes; "
                f"{'; '.join(said)}. rig.match(take) tells all.",
                stacklevel=2,
            )
        W = np.zeros((take.n_frames, len(self.names)))
        for k, name in enumerate(self.names):
            if name in match.driven:
                W[:, k] = take.weights[:, column[match.driven[name]]]
        W[~take.valid] = 0
        return W.clip(0, 1)


def _few(names):
    return f"{', '.join(names[:6])}{', ...' * (len(names) > 6)}"
