"""Weights of one rig as weights of another, which has other shapes and another mesh.

Both rigs are brought onto one face in one topology, where their shapes can be compared vertex by
vertex. There the weights b of the one that are nearest to the weights a of the other minimise

    k ||A a - B b||^2 / n + (1 - k) ||B (b - M a)||^2 / n + lam^2 sum(b)    with 0 <= b <= 1

frame by frame; before, the takes are smoothed, as if (smooth fps)^2 ||b_t - b_(t-1)||^2 stood
beside it and no bounds. A and B are the shapes, n is the number of vertices, M the map: for each
single shape of the rig with more shapes the nearest few of the other. The first term alone brings
the shapes nearest, but then units are mixed to imitate how the other rig bulges and creases; the
second takes what both rigs call the same for the same. The whole is one energy of a and b, so the
way back minimises the same.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from facelab.checks import check_number, check_type
from facelab.expression.riding import closed, skin_of
from facelab.expression.transfer import IntermediateSpace
from facelab.geometry.alignment import procrustes
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.geometry.winding import outwards
from facelab.motion import WeightSequence
from facelab.names import arkit_names, as_landmarks
from facelab.numeric.least_squares import smoothed_sides, solve_bounded, solve_bounded_rows
from facelab.numeric.threads import one_thread
from facelab.rig import BlendshapeRig

FEW = 2.0
"""Millimetres: a shape of the map costs, at weight 1, what this error over the whole face does."""

SHARE = 0.55
"""But no more than what this share of the shape that it stands for does: small shapes keep one."""

NEAR = 0.015
"""k of the energy: share of plain nearness in it."""

_STILL = 0.1  # mm: shapes that move nothing further are none of the face
_TURNED = np.pi / 6  # of one head against another: more is another frame
_RIDGE = 1e-5  # of the mean unit: settles what shapes that are mixtures of others leave open
_NONE = 0.03  # a weight of the map below that is none
_MADE = 0.5  # a shape of which more than this share is left cannot be made
_LOST = 0.9  # of the motion, left over: two rigs of faces differ by less
_WHOLE, _MUCH = 0.995, 0.6  # share of the motion compared: said below the one, warned of the other
_SEEN = 0.05  # mm RMS: below that a shape moves nothing that could be compared

_PLACES = (  # shapes that move one place of the face most, which is then a landmark of both
    *("eyeBlinkLeft", "eyeBlinkRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    *("browDownLeft", "browDownRight", "mouthUpperUpLeft", "mouthUpperUpRight"),
    *("mouthLowerDownLeft", "mouthLowerDownRight"),
)


@dataclass(frozen=True, eq=False)
class TranslationReport:
    """How near the translated weights come; printed, a summary.

    Parameters
    ----------
    errors : ndarray of shape (n_frames,)
        What is left of the motion in each frame, RMS over the face, millimetres; NaN where lost.
    sizes : ndarray of shape (n_frames,)
        How far the face moves, alike.
    shape_errors : dict of str to float
        What the best few shapes of the other leave of each shape that moves, alike.
    shape_sizes : dict of str to float
    cannot : tuple of str
        Shapes that take part in the take and that the other rig cannot make: more than half is
        left.
    active : float
        Shapes at more than 0.01 in a frame, on average.
    compared : float
        Share of the motion (squared, by area of skin) that lies where both rigs have the face;
        errors and sizes tell of that alone.
    """

    errors: np.ndarray
    sizes: np.ndarray
    shape_errors: dict
    shape_sizes: dict
    cannot: tuple
    active: float
    compared: float = 1.0

    def __str__(self):
        rms, size = (_rms(x[np.isfinite(x)]) for x in (self.errors, self.sizes))
        worst = int(np.nanargmax(self.errors))
        lines = [
            f"The face moves {size:.2f} mm RMS, of which {rms:.2f} mm are left; at most "
            f"{self.errors[worst]:.2f} mm, in frame {worst}. {self.active:.1f} shapes are active "
            "in a frame."
        ]
        if self.compared < _WHOLE:
            lines.append(
                f"Compared is where both rigs have the face: {100 * self.compared:.0f} % of this "
                "motion lies there; of the rest nothing is known."
            )
        if self.cannot:
            said = [
                f"{n} ({self.shape_errors[n]:.2f} of {self.shape_sizes[n]:.2f} mm left)"
                for n in sorted(self.cannot, key=self.shape_errors.get, reverse=True)
            ]
            more = f" and {len(said) - 10} more" if len(said) > 10 else ""
            lines.append(f"More than half is left of {', '.join(said[:10])}{more}.")
        return "\n".join(lines)


class Translator:
    """Two rigs on one face, ready to translate takes of either.

    Parameters
    ----------
    rig, other : BlendshapeRig
        Of any topology, millimetres. With landmarks (see `facelab.geometry.MULTI_PIE`, six or
        more that both have), unless their triangles are the same.

    Attributes
    ----------
    space : IntermediateSpace
        How one of them came onto the face of the other: the one with more landmarks is the
        template, which is the same whichever way one translates.
    turned : bool
        The template is `other`.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> pair = facelab.expression.Translator(rig, rig.renamed({"jawOpen": "Mund"}))
    >>> pair.map_of("jawOpen")
    {'Mund': 1.0}
    """

    def __init__(self, rig, other):
        for one, name in ((rig, "rig"), (other, "other")):
            check_type(one, name, BlendshapeRig, "give a rig")
            check_face_size(one.neutral.vertices, name)
        self.rig, self.other = rig, other
        self.turned = turned = _rank(other) > _rank(rig)
        template, guest = (_with_places(r) for r in ((other, rig) if turned else (rig, other)))
        mesh = outwards(template.neutral, "other" if turned else "rig")
        template = BlendshapeRig(mesh, template.names, template.deltas)
        _refuse_turned(rig.neutral, other.neutral)
        self.space = IntermediateSpace(template, guest.neutral)
        own, theirs = _compared(self.space, guest)
        self._A, self._B = (theirs, own) if turned else (own, theirs)
        self._lain = _motions(rig, self.space.reached if turned else self.space.covered)
        for one, name in ((self._A, "rig"), (self._B, "other")):
            if np.abs(one).max(initial=0) < _STILL:
                raise ValueError(
                    f"{name}: its {len(one)} shapes move the face by less than {_STILL} mm where "
                    "both rigs have it; are they shapes of a face, and its lengths millimetres?"
                )

    def __repr__(self):
        return (
            f"Translator({len(self.rig.names)} shapes to {len(self.other.names)}, compared on "
            f"{self._A.shape[1] // 3} vertices)"
        )

    @cached_property
    def _grams(self):
        """A'A / n, A'B / n, B'B / n: square millimetres between all pairs of shapes."""
        n = self._A.shape[1] / 3
        with one_thread():
            return tuple(
                X @ Y.T / n for X, Y in ((self._A, self._A), (self._A, self._B), (self._B, self._B))
            )

    @cached_property
    def map(self):
        """The nearest few shapes of the other for each shape alone: (n_shapes, n_other)."""
        AA, AB, BB = self._grams
        return _few_nearest(BB, AB, AA)

    @cached_property
    def _energy(self):
        """Quadratic form of a and b: its blocks aa, ab and bb but for the share of nearness."""
        AA, AB, BB = self._grams
        K, L = len(AA), len(BB)
        if (K, _rank(self.rig)) >= (L, _rank(self.other)):
            M = self.map  # (K, L): ||B (b - M'a)||^2
            return M @ BB @ M.T, M @ BB, BB
        M = _few_nearest(AA, AB.T, BB)  # (L, K): ||A (a - M'b)||^2, as on the way back
        return AA, AA @ M.T, M @ AA @ M.T

    def map_of(self, name, least=0.02):
        """The shapes of the other, and their weights, that together are nearest to one shape.

        Parameters
        ----------
        name : str
            Of `rig`.
        least : float, default=0.02
            Weights below that are not named.

        Returns
        -------
        dict of str to float
            Largest first; empty for a shape that the other rig has nothing of.
        """
        row = self.map[int(np.flatnonzero(self.rig.weights_of({name: 1}))[0])]
        order = np.argsort(-row, kind="stable")
        return {self.other.names[k]: round(float(row[k]), 3) for k in order if row[k] >= least}

    @cached_property
    def shape_errors(self):
        """What the map leaves of each shape, RMS over the face, millimetres: dict of str."""
        return dict(
            zip(
                self.rig.names,
                self.difference(np.eye(len(self.map)), self.map).tolist(),
                strict=True,
            )
        )

    @cached_property
    def shape_sizes(self):
        """How far each shape moves the face, RMS, millimetres: dict of str."""
        size = np.sqrt(np.diagonal(self._grams[0]))
        return dict(zip(self.rig.names, size.tolist(), strict=True))

    def motion(self, a):
        """How far weights of `rig`, (n_frames, n_shapes), move the face: RMS, mm, (n_frames,)."""
        return np.sqrt(np.maximum(((a @ self._grams[0]) * a).sum(axis=1), 0))

    def compared(self, a):
        """Share of the motion by weights of `rig`, (n_frames, n_shapes), that is compared: 0 to 1.

        By squares, and by area of the skin of `rig`.
        """
        seen, all_ = (float(((a @ G) * a).sum()) for G in self._lain)
        return min(seen / all_, 1.0) if all_ > 0 else 1.0

    def difference(self, a, b):
        """RMS distance of the face by weights of `rig` from that of `other`: mm, (n_frames,).

        Parameters
        ----------
        a, b : ndarray of shape (n_frames, n_shapes), (n_frames, n_other)
        """
        AA, AB, BB = self._grams
        square = ((a @ AA) * a).sum(axis=1) + ((b @ BB - 2 * (a @ AB)) * b).sum(axis=1)
        return np.sqrt(np.maximum(square, 0))

    def translate(self, take, lam=0.07, smooth=0.004, near=NEAR):
        """A take of `rig` as a take of `other`; parameters and answer as of `translate`."""
        check_type(take, "take", WeightSequence, "read_weights gives one")
        lam = check_number(lam, "lam", low=0)
        near = check_number(near, "near", low=0, high=1)
        mu = (check_number(smooth, "smooth", low=0) * take.fps) ** 2
        a = self.rig.rig_weights(take)
        _, AB, BB = self._grams
        _, cross, own = self._energy
        H = near * BB + (1 - near) * own
        G = a @ (near * AB + (1 - near) * cross) - lam**2 / 2
        H, b = H + _RIDGE * np.diagonal(H).mean() * np.eye(len(H)), np.zeros((len(a), len(BB)))
        lo, hi = np.zeros(len(BB)), np.ones(len(BB))
        with one_thread():
            for part in take.stretches():
                side = smoothed_sides(H, G[part], mu) if mu else G[part]
                b[part] = solve_bounded_rows(H, side, lo, hi)
            report = self._report(a, b, take.valid)
        b[~take.valid] = np.nan
        return WeightSequence(
            b, self.other.names, take.fps, take.valid, take.angles, take.others, take.gaps, report
        )

    def _report(self, a, b, valid):
        size = self.motion(a)
        errors = np.where(valid, self.difference(a, b), np.nan)
        moves = dict(zip(self.rig.names, a.max(axis=0, initial=0) > 0.05, strict=True))
        cannot = tuple(
            n
            for n, mm in self.shape_sizes.items()
            if moves[n] and mm > _SEEN and self.shape_errors[n] > _MADE * mm
        )
        active, compared = (b > 0.01).sum(axis=1)[valid], self.compared(a[valid])
        if compared < _MUCH:
            warnings.warn(
                f"only {100 * compared:.0f} % of what the take moves lies where both rigs have the "
                "face; the rest of it is not compared, and the weights are told by that part "
                "alone. Look whether both show the whole face and their landmarks lie right.",
                stacklevel=4,
            )
        moved, left = (_rms(x[valid]) for x in (size, errors))
        if moved > _SEEN and left > _LOST * moved:
            warnings.warn(
                f"the take moves the face {moved:.2f} mm RMS, of which {left:.2f} mm are left: the "
                "weights make next to nothing of it. Look whether the shapes of each rig have "
                "their vertices in the order of its neutral face, and its landmarks lie right.",
                stacklevel=4,
            )
        return TranslationReport(
            errors,
            np.where(valid, size, np.nan),
            self.shape_errors,
            self.shape_sizes,
            cannot,
            float(active.mean()) if active.size else 0.0,
            compared,
        )


def translate(take, rig, other, lam=0.07, smooth=0.004, near=NEAR):
    """Weights over time of one rig as weights of another.

    Parameters
    ----------
    take : WeightSequence
        Drives `rig`, see `BlendshapeRig.match`.
    rig, other : BlendshapeRig
        As for `Translator`; keep one of those for several takes.
    lam : float, default=0.07
        Millimetres: a weight of 1 costs what this error over the whole face does. More leaves
        fewer shapes to edit.
    smooth : float, default=0.004
        Millimetre seconds: a weight that changes by 1 a second costs what an error of that many
        millimetres does, as in `regress_sequence`, but before the bounds; 0 for each frame alone.
    near : float, default=0.015
        1 brings the shapes as near as can be; less keeps to the map of single shapes, so that
        the way back gives the same weights again (see the head of `facelab.expression.translate`).

    Returns
    -------
    WeightSequence
        The shapes of `other` within [0, 1]; lost frames stay lost. Its `report` has the error in
        each frame and for each shape, and which shapes the other rig cannot make.

    Raises
    ------
    ValueError, TypeError
        As `Translator`, and for a take that drives nothing of `rig`.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> take = facelab.WeightSequence([[0.25], [0.5]], ["jawOpen"], fps=30)
    >>> to = facelab.expression.translate(take, rig, rig.renamed({"jawOpen": "Mund"}), lam=0)
    >>> to.weights[:, to.names.index("Mund")].round(2).tolist()
    [0.25, 0.5]
    """
    return Translator(rig, other).translate(take, lam, smooth, near)


# --- both rigs on one face ------------------------------------------------------------------------


def _rank(rig):
    """What makes one of two rigs the template: the same whichever is named first."""
    mesh, size = rig.neutral, float(np.abs(rig.deltas).sum())
    return len(mesh.landmarks), mesh.n_vertices, rig.names, size


def _refuse_turned(one, other):
    """Shapes go from head to head as they stand, so both have to stand alike."""
    theirs = as_landmarks(one.landmarks, other.landmarks)
    names = [n for n in one.landmarks if n in theirs]
    if len(names) < 4:
        return  # the same triangles, or too few for what follows, which says so
    places = (one, one.landmarks), (other, theirs)
    ends = [mesh.vertices[[marks[n] for n in names]] for mesh, marks in places]
    try:
        turn = Rotation.from_matrix(procrustes(*ends, scale=True).rotation)
    except ValueError:  # landmarks on one line
        return
    if turn.magnitude() > _TURNED:
        x, y, z = turn.as_rotvec() / turn.magnitude()
        raise ValueError(
            f"the head of other is turned by {np.degrees(turn.magnitude()):.0f} degrees against "
            f"that of rig, about ({x:.1f}, {y:.1f}, {z:.1f}): their files count up and forward "
            "otherwise, or the landmarks of one stand in another order or on the other side. Turn "
            "one of them, or mend them; x is to the person's left, y up, z forward."
        )


def _with_places(rig):
    """The rig with more landmarks: the places that shapes of a known meaning move most."""
    V = rig.neutral.vertices
    marks = dict(rig.neutral.landmarks)
    for place in _PLACES:
        size = [
            np.linalg.norm(d, axis=1)
            for name, d in zip(rig.names, rig.deltas, strict=True)
            if arkit_names(name) == (place,)
        ]
        for k, mm in enumerate(size):  # brows have two shapes of one name: left and right
            if mm.max() > 0:
                weight = (mm / mm.max()) ** 6
                middle = weight @ V / weight.sum()
                near = np.flatnonzero(weight > 0.5**6)
                marks[f"{place} {k}" if len(size) > 1 else place] = int(
                    near[np.linalg.norm(V[near] - middle, axis=1).argmin()]
                )
    mesh = TriangleMesh(V, rig.neutral.faces, marks)
    return BlendshapeRig(mesh, rig.names, rig.deltas)


def _compared(space, guest):
    """Shapes of the template's rig and of its guest on the vertices that both have: (K, 3 n)."""
    rest = guest.neutral.vertices
    if space.fit is None:
        own, theirs = space.rig.deltas, np.asarray(guest.deltas, dtype=float)
        return own.reshape(len(own), -1), theirs.reshape(len(theirs), -1)
    at_rest = space.to_template(rest)
    both = space.covered
    theirs = np.stack([(space.to_template(rest + d) - at_rest)[both] for d in guest.deltas])
    own = space.rig.deltas[:, both]
    return own.reshape(len(own), -1), theirs.reshape(len(theirs), -1)


def _motions(rig, covered):
    """Products of all shapes of a rig on the covered vertices of its skin, and on all of it."""
    body, index = closed(rig.neutral)
    skin, both = skin_of(body)[index], np.zeros(rig.neutral.n_vertices, dtype=bool)
    both[covered] = True
    area = rig.neutral.vertex_areas

    def products(where):
        X = (rig.deltas[:, where] * np.sqrt(area[where])[:, None]).reshape(len(rig.deltas), -1)
        return X @ X.T

    with one_thread():
        return products(skin & both), products(skin)


def _few_nearest(H, G, own):
    """The nearest few shapes for each row: chosen at a cost, then as near as these can be.

    H are the products of the shapes to choose from, `own` those of the shapes to make, G between.
    """
    few = np.minimum(FEW, SHARE * np.sqrt(np.diagonal(own)))[:, None]
    H = H + _RIDGE * np.diagonal(H).mean() * np.eye(len(H))
    lo, hi = np.zeros(len(H)), np.ones(len(H))
    chosen = solve_bounded_rows(H, G - few**2 / 2, lo, hi) > _NONE
    return np.stack([solve_bounded(H, g, lo, hi * c)[0] for g, c in zip(G, chosen, strict=True)])


def _rms(x):
    return float(np.sqrt((x**2).mean())) if len(x) else 0.0
