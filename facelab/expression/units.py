"""A rig and a sketch made ready for regression: units reduced, rigid motion found, bounds read."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from facelab.checks import as_finite, check_choice, check_number, check_type
from facelab.geometry.alignment import Alignment, procrustes
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.numeric.threads import one_thread
from facelab.rig import BlendshapeRig

MISALIGNED = 2.0
"""Rigid motion, RMS over the vertices in millimetres, from which a sketch is not aligned."""

FARTHEST = 1e7
"""Largest coordinate of a sketch, millimetres."""

DEPENDENT = 1e-5
"""Share of a unit that earlier units may leave unexplained before it counts as their mixture."""


# -- The rig, reduced once --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class UnitBasis:
    """A rig made ready for regression by `prepare_units`; every function here takes it as `rig`.

    Parameters
    ----------
    rig : BlendshapeRig
    kept : ndarray of int, shape (n_kept,)
        Units that take part, as indices into `rig.names`.
    Q, R : ndarray of shape (3 * n_vertices, n_kept), (n_kept, n_kept)
        D = Q R (Eq. 3): orthonormal columns and an upper triangle, millimetres.
    """

    rig: BlendshapeRig
    kept: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    _folds: dict = field(default_factory=dict, repr=False)

    @property
    def dropped(self):
        """Names of the units left out."""
        return tuple(n for i, n in enumerate(self.rig.names) if i not in set(self.kept.tolist()))

    @cached_property
    def gram(self):
        """D^T D, square millimetres, shape (n_kept, n_kept)."""
        return self.R.T @ self.R

    @property
    def largest(self):
        """Squared length of the largest unit, square millimetres."""
        return float(self.gram.diagonal().max())

    @cached_property
    def _flat(self):
        return np.asarray(self.rig.deltas, dtype=float).reshape(len(self.rig.names), -1)

    @cached_property
    def limit(self):
        """Vertex boundary: the largest displacement a unit gives it, mm, shape (n_vertices,)."""
        return np.linalg.norm(self.rig.deltas[self.kept], axis=2).max(axis=0).astype(float)

    @cached_property
    def rigid(self):
        """Rotation vector and shift beyond the units, from displacements: (6, 3 * n_vertices)."""
        V = self.rig.neutral.vertices
        V = V - V.mean(axis=0)
        size = np.sqrt((V**2).sum(axis=1).mean())
        C = np.zeros((len(V), 3, 6))
        C[:, :, :3] = np.cross(np.eye(3)[None], V[:, None] / size).transpose(0, 2, 1)
        C[:, :, 3:] = np.eye(3)
        C = C.reshape(-1, 6)
        C = C - self.Q @ (self.Q.T @ C)
        return np.linalg.pinv(C, rcond=1e-3) / np.repeat([size, 1], 3)[:, None]

    def project(self, d):
        """Q^T d, (n_kept,), and the squared length of what no units explain, square millimetres.

        Parameters
        ----------
        d : ndarray of shape (3 * n_vertices,)
            Displacements, millimetres.
        """
        c = self.Q.T @ d
        return c, float(((d - self.Q @ c) ** 2).sum())

    def moved(self, weights):
        """What weights of all units, (K,), add to the neutral: sum w_i d_i, (n_vertices, 3), mm."""
        return (weights @ self._flat).reshape(-1, 3)  # Eq. 1

    def excess(self, moved):
        """How far displaced vertices are beyond their boundary, mm, shape (n_vertices,).

        The boundary of a vertex is the largest displacement that any one unit gives it. Weights
        within [0, 1] do not keep it: units add up.
        """
        return np.maximum(np.linalg.norm(moved, axis=1) - self.limit, 0)

    def clamped(self, moved):
        """Displacements, (n_vertices, 3), that fall back to the boundary where they exceed it."""
        length = np.linalg.norm(moved, axis=1)
        return moved * np.minimum(1, self.limit / np.maximum(length, 1e-300))[:, None]

    def folds(self, n_folds, n_patches):
        """Parts of the face to be left out in turn, found once.

        Returns
        -------
        list of (out, D, G)
            Vertices left out, bool (n_vertices,); their rows of D^T, (n_kept, 3 * n_out); and
            D^T D over them, (n_kept, n_kept).
        """
        if (n_folds, n_patches) not in self._folds:
            V, n = self.rig.neutral.vertices, self.rig.neutral.n_vertices
            seeds = np.random.default_rng(0).permutation(n)[: min(n_patches, n)]
            fold = cKDTree(V[seeds]).query(V)[1] % n_folds
            parts = []
            for f in range(n_folds):
                out = fold == f
                if out.any() and not out.all():
                    D = np.asarray(self.rig.deltas[np.ix_(self.kept, np.flatnonzero(out))])
                    D = D.astype(float).reshape(len(self.kept), -1)
                    parts.append((out, D, D @ D.T))
            self._folds[n_folds, n_patches] = parts
        return self._folds[n_folds, n_patches]


def prepare_units(rig, still="drop", dependent="refuse", min_motion=0.1):
    """Reduce a rig once, for any number of regressions.

    Parameters
    ----------
    rig : BlendshapeRig
    still : {"drop", "refuse"}
        What to do with units that nowhere move the mesh by `min_motion`, all-zero ones among
        them: warn and leave them out by name (their weights are 0), or refuse.
    dependent : {"refuse", "drop"}
        What to do with a unit that is a mixture (or a copy) of units before it, up to 1e-5 of
        its size: its weight would be arbitrary.
    min_motion : float, default=0.1
        Millimetres.

    Returns
    -------
    UnitBasis

    Raises
    ------
    ValueError
        If units are still or dependent and refused, or if none is left.
    """
    check_type(rig, "rig", BlendshapeRig, "or a UnitBasis, which comes from one (prepare_units)")
    check_face_size(rig.neutral.vertices, "rig")
    check_choice(still, "still", ("drop", "refuse"))
    check_choice(dependent, "dependent", ("refuse", "drop"))
    min_motion = check_number(min_motion, "min_motion", low=0)
    reach = np.sqrt((rig.deltas**2).sum(axis=2).max(axis=1))
    quiet = (reach < min_motion) | (reach == 0)
    said = ", ".join(f"{rig.names[i]} ({reach[i]:.3g} mm)" for i in np.flatnonzero(quiet))
    if quiet.all():
        raise ValueError(
            f"rig has no unit that moves the mesh by min_motion={min_motion:g} mm: {said}; "
            "are its deltas in millimetres?"
        )
    if quiet.any() and still == "refuse":
        raise ValueError(
            f"rig holds units that move the mesh by less than min_motion={min_motion:g} mm: "
            f'{said}; remove them, or let still="drop" leave them out.'
        )
    if quiet.any():
        warnings.warn(f"left out, less than {min_motion:g} mm: {said}.", stacklevel=2)
    kept = np.flatnonzero(~quiet)
    D = np.asarray(rig.deltas[kept], dtype=float).reshape(len(kept), -1).T
    if D.shape[0] < D.shape[1]:
        raise ValueError(f"{D.shape[1]} units, but only {D.shape[0]} coordinates; use fewer units.")
    with one_thread():
        Q, R = np.linalg.qr(D)
        copies = np.abs(np.diag(R)) < DEPENDENT * np.linalg.norm(R, axis=0)
        if copies.any():
            said = _mixtures([rig.names[i] for i in kept], R, copies)
            if dependent == "refuse":
                raise ValueError(
                    f"rig holds units that follow from others: {said}; remove them, or leave them "
                    'out with prepare_units(rig, dependent="drop").'
                )
            warnings.warn(f"left out, they follow from others: {said}.", stacklevel=2)
            kept = kept[~copies]
            Q, R = np.linalg.qr(D[:, ~copies])
    return UnitBasis(rig, kept, Q, R)


def _mixtures(names, R, copies):
    """The dependent units, each with the others that make it."""
    own = np.flatnonzero(~copies)
    said = []
    for i in np.flatnonzero(copies):
        before = own[own < i]
        share = np.linalg.lstsq(R[:, before], R[:, i], rcond=None)[0]
        parts = [f"{s:.2g} {names[b]}" for b, s in zip(before, share, strict=True) if abs(s) > 0.01]
        said.append(f"{names[i]} = {' + '.join(parts)}")
    return "; ".join(said)


def as_basis(rig):
    return rig if isinstance(rig, UnitBasis) else prepare_units(rig)


# -- The sketch -------------------------------------------------------------------------------


def find_alignment(rig, sketch):
    """The rigid motion that carries a sketch to the neutral's place, seen past the expression.

    A best rigid fit alone would take an open jaw for a nod. Here units (with free weights) and
    rigid motion are fitted together, so a rig's own expressions are found aligned exactly.

    Parameters
    ----------
    rig : BlendshapeRig or UnitBasis
    sketch : TriangleMesh or ndarray of shape (n_vertices, 3)
        Millimetres.

    Returns
    -------
    Alignment
        Its `rms` is what units and rigid motion together leave of the sketch.
    """
    basis = as_basis(rig)
    V, N = sketch_vertices(basis, sketch), basis.rig.neutral.vertices
    centre = N.mean(axis=0)
    X = V - centre
    start = procrustes(X, N - centre)  # nearly there from anywhere
    A, b = start.rotation, start.translation
    for _ in range(50):  # Gauss-Newton: the units take what they can, `rigid` reads off the rest
        d = (X @ A.T + b + centre - N).ravel()
        x = basis.rigid @ d
        if np.abs(x).max() < 1e-9:
            break
        step = Rotation.from_rotvec(-x[:3]).as_matrix()
        A, b = step @ A, step @ b - x[3:]
    left = basis.project(d)[1] / len(N)
    return Alignment(A, b + centre - A @ centre, rms=float(np.sqrt(left)))


def sketch_positions(sketch):
    """Vertices of a sketch on any mesh, (n_vertices, 3)."""
    V = sketch.vertices if isinstance(sketch, TriangleMesh) else sketch
    V = as_finite(V, "sketch", ("n_vertices", 3))
    far = np.abs(V).max(initial=0)
    if far > FARTHEST:
        raise ValueError(
            f"sketch reaches {far:.3g} mm from the origin, but at most {FARTHEST:g} mm are "
            "allowed; bring it to millimetres and near the neutral face."
        )
    return V


def sketch_vertices(basis, sketch):
    V, n = sketch_positions(sketch), basis.rig.neutral.n_vertices
    if len(V) != n:
        raise ValueError(
            f"sketch has shape {V.shape}, but the rig's mesh asks for ({n}, 3): fit the "
            "template to the sketch first, or take the rig on the sketch's vertices (rig.on)."
        )
    return V


def sketch_displacement(basis, sketch, align):
    """d of Eq. 3, flat, millimetres, and the alignment applied (None if none)."""
    align = check_choice(align, "align", ("check", True, False))
    V, N = sketch_vertices(basis, sketch), basis.rig.neutral.vertices
    if align is False:
        return (V - N).ravel(), None
    size = np.sqrt(((V - V.mean(axis=0)) ** 2).sum() / ((N - N.mean(axis=0)) ** 2).sum())
    if not 0.8 < size < 1.25:
        raise ValueError(
            f"sketch is {size:.3g} times the size of the neutral face: bring it to millimetres and "
            "to this face's size, or pass align=False to take it as it is."
        )
    if align == "check":
        x = basis.rigid @ (V - N).ravel()
        turn = np.cross(x[:3], N - N.mean(axis=0)) + x[3:]
        if np.sqrt((turn**2).sum(axis=1).mean()) <= MISALIGNED:
            return (V - N).ravel(), None
    found = find_alignment(basis, V)
    if align == "check":
        raise ValueError(
            f"sketch is not aligned with the neutral face: a turn of {found.degrees:.1f} degrees "
            f"and a shift, {found.travel(V):.1f} mm RMS in all, that no units explain (allowed: "
            f"{MISALIGNED:g} mm); pass align=True to take it out, or align=False to fit it so."
        )
    return (found.apply(V) - N).ravel(), found


# -- Bounds and weights ------------------------------------------------------------------------


def read_bounds(names, bounds, locked=None, excluded=()):
    """lo and hi of every unit, shape (K,) each, locks and exclusions put in."""
    K = len(names)
    lo, hi = np.zeros(K), np.ones(K)
    excluded = [excluded] if isinstance(excluded, str) else excluded
    excluded = list(check_type(excluded, "excluded", Iterable, "give names of units"))
    remedy = f"give a weight by name, such as {{{names[0]!r}: 0.5}}"
    named = dict(check_type({} if locked is None else locked, "locked", Mapping, remedy))
    given = [*named, *excluded, *(bounds if isinstance(bounds, dict) else ())]
    unknown = sorted({str(n) for n in given if n not in names})
    if unknown:
        raise ValueError(f"unknown unit(s) {', '.join(unknown)}; this rig has {', '.join(names)}.")
    both = sorted({*named} & {*excluded})
    if both:
        raise ValueError(f"{', '.join(both)} is both locked and excluded; choose one.")
    if isinstance(bounds, dict):
        for name, pair in bounds.items():
            k = names.index(name)
            lo[k], hi[k] = _pair(pair, f"bounds[{name!r}]", [()])
    else:
        pair = (None, None) if bounds is None else bounds
        lo[:], hi[:] = _pair(pair, "bounds", [(), (K,)])
    for name, value in {**dict.fromkeys(excluded, 0.0), **named}.items():
        lo[names.index(name)] = hi[names.index(name)] = check_number(value, f"locked[{name!r}]")
    crossed = np.flatnonzero(lo > hi)
    if crossed.size:
        said = ", ".join(f"{names[i]} ({lo[i]:g} > {hi[i]:g})" for i in crossed[:6])
        raise ValueError(f"bounds: the lower is above the upper for {said}; swap them.")
    return lo, hi


def _pair(pair, name, shapes):
    """Lower and upper bound, None and infinity read as no bound."""
    try:
        low, high = pair
    except (TypeError, ValueError) as error:
        raise type(error)(
            f"{name}={pair!r}: give two bounds, lower and upper, None for no bound."
        ) from None
    return [_bound(low, -np.inf, name, shapes), _bound(high, np.inf, name, shapes)]


def _bound(value, none, name, shapes):
    try:
        bound = np.asarray(none if value is None else value, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"{name} holds {value!r}, which is no number.") from None
    if bound.shape not in shapes:
        wanted = " or ".join(map(str, shapes))
        raise ValueError(f"{name} holds a bound of shape {bound.shape}, but needs shape {wanted}.")
    if np.isnan(bound).any():
        raise ValueError(f"{name} holds NaN; use None for no bound.")
    return bound


def among_all(w, basis):
    """Weights of the kept units (..., n_kept) among all units, (..., K)."""
    full = np.zeros((*w.shape[:-1], len(basis.rig.names)))
    full[..., basis.kept] = w
    return full
