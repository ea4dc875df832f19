"""From markers, or a scan, to one mesh in full correspondence.

Once for each face: a similarity and a smooth warp by landmarks, then matching to the surface from
coarse to fine. With the layout of the markers then fixed, the dense motion is a linear function of
theirs: `MarkerLayout`; `facelab.sequences` applies it to whole takes. Lengths are millimetres.

Tena et al. 2011, section 4.1, name Tena et al. 2006 for the method and describe none; that text is
not at hand, so the design is ours. The energy that trades fit against smoothness is that
of a Gaussian field on the surface (Lindgren, Rue and Lindstroem 2011), so its settings are lengths:
how far a deformation reaches, how large it is, how exact the markers are.
"""

import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import RBFInterpolator

from facelab.checks import as_numbers, check_choice, check_names, check_number
from facelab.geometry.alignment import Alignment, procrustes
from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import TriangleMesh
from facelab.names import as_landmarks
from facelab.registration.landmarks import DOUBTED, check_landmarks, check_spread, judge
from facelab.registration.layout import MarkerLayout
from facelab.registration.prior import Prior, PriorLayout, made_prior
from facelab.registration.report import check_drawn, check_surface, made_report, near_markers
from facelab.registration.scan import (
    check_scan,
    check_template,
    on_border,
    without_scraps,
    wound_outwards,
)
from facelab.registration.strangers import FACE, check_told, off_face, say_left_out
from facelab.registration.warp import GLUED, PRESETS, SEEN, Preset, relaxed, rows, sliding

_NEEDED = 6  # landmarks, for a warp in three directions that is not exact by chance
_GHOST = 3.0  # mm; a marker nearer to the surface is believed in any case
_SLACKS = 8.0  # times what a stage lets pass, beyond which no crowd of markers is believed


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """A template fitted to a face.

    Parameters
    ----------
    mesh : TriangleMesh
        The template in the shape of the face, in the template's own head frame.
    alignment : Alignment
        From the frame of the data to the head frame; no scale.
    steps : dict of str to ndarray of shape (n_vertices, 3)
        The shape after each step: "similarity", "warp", then "stage 1" and on.
    landmarks : tuple of str
        Those that gave the start.
    residuals : ndarray of shape (n_points,)
        Distance that is left at each marker, or at each matched vertex of a scan, millimetres.
    preset : Preset
    places : ndarray of shape (n_landmarks, 3)
        Where the data have the landmarks, head frame, millimetres.
    apart : ndarray of shape (n_vertices,)
        Distance of each vertex from the scan, millimetres.
    drawn : ndarray of bool, shape (n_vertices,)
        Which of them are matched to it.
    """

    mesh: TriangleMesh
    alignment: Alignment
    steps: dict = field(repr=False)
    landmarks: tuple = field(repr=False)
    residuals: np.ndarray = field(repr=False)
    preset: Preset = field(repr=False)
    places: np.ndarray = field(default=None, repr=False, kw_only=True)
    apart: np.ndarray = field(default=None, repr=False, kw_only=True)
    drawn: np.ndarray = field(default=None, repr=False, kw_only=True)

    def __repr__(self):
        r = self.report
        lost = f", {r.n_unused} not used (up to {r.unused_max:.0f} mm off)" if r.n_unused else ""
        far = max(r.landmarks, key=r.landmarks.get)
        return (
            f"{type(self).__name__}({r.n_used} {r.what} used, rms {r.rms:.2f} mm{lost}; "
            f"{100 * r.drawn:.0f} % drawn; {len(r.landmarks)} landmarks, {far} the farthest "
            f"from where the others put it ({r.landmarks[far]:.0f} mm); {r.turned} normals turned "
            f"over, {r.folds} folds, {r.crossings} cuts)"
        )

    @property
    def rms(self):
        """Root mean squared of `residuals`, millimetres."""
        return float(np.sqrt((self.residuals**2).mean()))

    @cached_property
    def report(self):
        """How far the fit can be trusted: FitReport."""
        off = self._landmarks_off(self.places, 0.0)
        return made_report(
            self.mesh, self._before, self.apart, self.drawn, self.drawn, off, "vertices"
        )

    @property
    def _before(self):
        return self.mesh.with_vertices(self.steps["similarity"])

    def _landmarks_off(self, places, height):
        before = self._before
        marks = [before.landmarks[name] for name in self.landmarks]
        source = before.vertices[marks] + height * before.normals[marks]
        off = judge(source, places, self.landmarks).off
        return dict(zip(self.landmarks, off.tolist(), strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class MarkerFit(Fit):
    """A template fitted to the markers of a face at rest: `Fit`, and where the markers sit.

    Parameters
    ----------
    names : tuple of str
        The markers that were seen at rest.
    rest : ndarray of shape (n_markers, 3)
        Where they are at rest, head frame, millimetres.
    faces, weights : ndarray of shape (n_markers,), (n_markers, 3)
        Their feet on the mesh: triangle and barycentric place.
    offset : float
        Height of a marker's centre over the skin, millimetres.
    prior : Prior, optional
        What fills the face between the markers, beside smoothness: see `with_prior`.
    left_out : dict of str to float
        Markers that are none of the face, and how far they lie off it, millimetres.
    """

    names: tuple = ()
    rest: np.ndarray = field(default=None, repr=False)
    faces: np.ndarray = field(default=None, repr=False)
    weights: np.ndarray = field(default=None, repr=False)
    offset: float = 1.5
    prior: Prior | None = field(default=None, repr=False)
    left_out: dict = field(default_factory=dict, repr=False)

    @cached_property
    def _as_landmarks(self):
        """The names of the markers, those of landmarks as the mesh spells them: list of str."""
        return list(as_landmarks(self.mesh.landmarks, dict.fromkeys(self.names)))

    @property
    def used(self):
        """Which markers the fit believed, not taking them for ghosts: bool, (n_markers,)."""
        held = np.isin(self._as_landmarks, self.landmarks)
        return held | (self.residuals <= _believed(self.residuals, self.preset.stages[-1]))

    @cached_property
    def report(self):
        """How far the fit can be trusted: FitReport."""
        row = {name: i for i, name in enumerate(self._as_landmarks)}
        off = self._landmarks_off(self.rest[[row[n] for n in self.landmarks]], self.offset)
        feet = rows(self.mesh, self.faces, self.weights) @ self.mesh.vertices
        drawn = near_markers(self.mesh, feet[self.used])
        apart = np.append(self.residuals, list(self.left_out.values()))
        used = np.append(self.used, np.zeros(len(self.left_out), dtype=bool))
        return made_report(self.mesh, self._before, apart, used, drawn, off, "markers")

    @cached_property
    def layout(self):
        """The linear map from these markers to dense motion: MarkerLayout or PriorLayout."""
        return MarkerLayout(self) if self.prior is None else PriorLayout(self, self.prior)

    def with_prior(self, *models, binding=None, share=0.25, mirror=0.5):
        """The same fit, its motion filled by linear models where the markers leave it open.

        Parameters
        ----------
        *models : FaceModel
            Trained on other faces, on the vertices of the mesh or on the samples of `binding`:
            a RegionModel, a HolisticModel, or several. Without one, that both sides of a face
            mostly do the same is all that is known.
        binding : LinearBinding, optional
            From the vertices of the models to those of the mesh: `bind_to_samples`.
        share : float, default=0.25
            How much of the motion is the models', 0 to 1; the rest is as smooth as without.
        mirror : float, default=0.5
            How much a place is taken to do what its twin on the other side does, 0 to 1.

        Returns
        -------
        MarkerFit

        Raises
        ------
        ValueError, TypeError
            For models of other vertices or without variances, or numbers beyond 0 to 1.

        Examples
        --------
        >>> import facelab
        >>> face = facelab.load_template(4375)
        >>> names = list(face.landmarks)
        >>> glued = face.vertices[list(face.landmarks.values())]
        >>> fit = facelab.fit_markers(face, glued, names, offset=0).with_prior()
        >>> fit.layout.smooth.shape  # every axis of a marker hangs on all axes of all markers
        (153, 153)
        """
        return replace(self, prior=made_prior(self.mesh, models, binding, share, mirror))


def _believed(off, slack):
    """How far off the surface a marker may lie and be believed, given how far all of them do."""
    return max(min(6 * np.median(np.abs(off)), _SLACKS * slack), _GHOST)


def _warped(template, positions, named, preset, label, height=0.0, normals=None):
    """Similarity and smooth warp by landmarks: data to head frame, and both steps' vertices.

    `positions` are of the data, `named` maps landmarks to their rows, `height` is that of the data
    over the skin, `normals` are those of the data if they are a surface.
    """
    known = [n for n in named if n in template.landmarks]
    if len(known) < _NEEDED:
        raise ValueError(
            f"{label} share {len(known)} name(s) with the landmarks of the template, but the fit "
            f"starts from {_NEEDED} or more. Name markers as in facelab.geometry.MULTI_PIE (chin, "
            f"nose_tip, ...); known here: {', '.join(known) or 'none'}; the template has "
            f"{', '.join(list(template.landmarks)[:8]) or 'none'}, ..."
        )
    marks = [template.landmarks[n] for n in known]
    source = template.vertices[marks] + height * template.normals[marks]
    check_spread(source, known, label)
    data = [named[n] for n in known]
    target = positions[data]
    both = None if normals is None else (template.normals[marks], normals[data])
    anywhere = list(template.landmarks.values())
    home = template.vertices[anywhere] + height * template.normals[anywhere]
    home = dict(zip(template.landmarks, home, strict=True))
    judged = check_landmarks(source, target, known, label, both, home)
    doubted = [
        f"{known[i]} ({judged.off[i]:.0f} mm)" for i in np.flatnonzero(judged.doubt > DOUBTED)
    ]
    if doubted:
        warnings.warn(
            f"{label}: {', '.join(doubted)} lie(s) rather far from where the others put the "
            "landmark; look whether the name is right.",
            stacklevel=3,
        )
    rigid = procrustes(target, source)
    target = rigid.apply(target)
    grown = procrustes(source, target, scale=True)
    V = grown.apply(template.vertices)
    from_here = grown.apply(source)
    warp = RBFInterpolator(
        from_here, target - from_here, kernel="linear", degree=1, smoothing=preset.size
    )
    return rigid, tuple(known), {"similarity": V, "warp": V + warp(V)}


def fit_markers(template, positions, names, offset=1.5, preset="balanced"):
    """Fit a template to the markers of a face at rest.

    Markers that lie more than 35 mm off the face that the landmarks show are of somebody else, a
    body or a cap: they are left out, see `MarkerFit.left_out`.

    Parameters
    ----------
    template : TriangleMesh
        With landmarks.
    positions : array_like of shape (n_markers, 3)
        Millimetres, any frame; NaN for a marker that was not seen: it is left out.
    names : sequence of str
        Of the markers; those called like a landmark, in whatever spelling, give the start.
    offset : float, default=1.5
        Height of a marker's centre over the skin, millimetres.
    preset : str, default="balanced"
        One of `PRESETS`.

    Returns
    -------
    MarkerFit

    Raises
    ------
    ValueError
        If six landmarks or more are not among the names, or all lie on one plane; for mirrored
        data, other units than millimetres, exchanged sides, names in another order, or landmarks
        far from where the others put them, by name; if a third of the other markers lie off the
        face, but too near to tell whose they are; and for a result that is no face.

    Warns
    -----
    UserWarning
        For a landmark rather far from where the others put it, for markers that are left out, and
        for a surface that folds.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> names = list(face.landmarks)
    >>> glued = face.vertices[list(face.landmarks.values())]
    >>> fit = facelab.fit_markers(face, glued + [0, 0, 100], names, offset=0)
    >>> bool(fit.residuals.max() < 0.5)  # millimetres
    True
    """
    check_template(template)
    preset = PRESETS[check_choice(preset, "preset", tuple(PRESETS))]
    offset = check_number(offset, "offset", low=0)
    names = check_names(names)
    wanted = f"({len(names)}, 3)"
    positions = as_numbers(positions, "positions", wanted, "a marker that was not seen has NaN")
    if positions.shape != (len(names), 3):
        raise ValueError(
            f"positions has shape {positions.shape}, but {len(names)} names ask for {wanted}."
        )
    if np.isinf(positions).any():
        raise ValueError(
            "positions holds infinite values; mark markers that were not seen with NaN."
        )
    seen = np.isfinite(positions).all(axis=1)
    if not seen.any():
        raise ValueError(
            f"positions holds no marker that was seen: all {len(names)} are NaN; give a frame "
            "that shows the face at rest."
        )
    names = tuple(n for n, s in zip(names, seen, strict=True) if s)
    positions = positions[seen]
    named = as_landmarks(template.landmarks, {name: i for i, name in enumerate(names)})
    rigid, known, steps = _warped(template, positions, named, preset, "the markers", offset)
    rest = rigid.apply(positions)
    off = off_face([template.with_vertices(V) for V in steps.values()], rest)
    stays = (off <= FACE) | np.isin(list(named), known)
    left_out = {names[i]: float(off[i]) for i in np.flatnonzero(~stays)}
    if left_out:
        say_left_out(left_out, len(names))
        names = tuple(n for n in names if n not in left_out)
        rest = rest[stays]
        kept = [name for name, stay in zip(named, stays, strict=True) if stay]
        named = {name: i for i, name in enumerate(kept)}
    fixed = np.array([named[name] for name in known])
    free = np.setdiff1d(np.arange(len(names)), fixed)
    star = [np.flatnonzero((template.faces == template.landmarks[n]).any(axis=1)) for n in known]

    def feet(mesh):
        """Nearest place on the surface; for landmarks, on the triangles round their vertex."""
        faces, weights = closest_points(mesh, rest)
        faces[fixed], weights[fixed] = closest_points(mesh, rest[fixed], star)
        return faces, weights

    marks = sp.eye_array(template.n_vertices, format="csr")[
        [template.landmarks[name] for name in known]
    ]
    pull = np.full(len(known), 1 / GLUED**2)

    def match(mesh, slack):
        faces, weights = feet(mesh)
        B, foot, normal, gap = sliding(mesh, faces, weights, rest, offset)
        share = np.ones(len(rest))
        if len(free):  # far off the surface, as a ghost at rest would be
            share[free] = 1 / (1 + (gap[free] / _believed(gap[free], slack)) ** 2) ** 2
        target = np.vstack([foot + gap[:, None] * normal, rest[fixed] - offset * normal[fixed]])
        return sp.vstack([B, marks]), target, np.append(share / slack**2, pull)

    for i, V in enumerate(relaxed(template, steps["warp"], match, preset)):
        steps[f"stage {i + 1}"] = V
    mesh = template.with_vertices(V)
    faces, weights = feet(mesh)
    _, foot, normal, _ = sliding(mesh, faces, weights, rest, offset)
    left = np.linalg.norm(foot + offset * normal - rest, axis=1)
    check_surface(mesh, template.with_vertices(steps["similarity"]), "the markers")
    fit = MarkerFit(
        mesh, rigid, steps, known, left, preset, names, rest, faces, weights, offset,
        left_out=left_out,
    )  # fmt: skip
    check_told(fit)
    return fit


def fit_scan(template, scan, landmarks=None, preset="balanced"):
    """Fit a template to a dense surface.

    Each vertex is drawn to the nearest place of the scan, along the normal. Not drawn are those
    whose nearest place is on the border of the scan, whose normal is more than 60 degrees from the
    one there, or which are much farther off than most: smoothness alone carries them.

    Parameters
    ----------
    template : TriangleMesh
        With landmarks.
    scan : TriangleMesh
        Millimetres, any frame; need not be in one piece.
    landmarks : sequence of str, optional
        Names to start from; all that both meshes have, in whatever spelling, if left out.
    preset : str, default="balanced"
        One of `PRESETS`.

    Returns
    -------
    Fit
        `residuals` are the distances to the scan of the vertices that are drawn to it.

    Raises
    ------
    ValueError
        As `fit_markers`, and if next to nothing of the template finds its place on the scan.

    Warns
    -----
    UserWarning
        For triangles wound inwards, which are turned over; for small loose pieces without a
        landmark, which are left out; if less than half of the template is drawn to the scan; and
        as `fit_markers`.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> fit = facelab.fit_scan(face, face.with_vertices(face.vertices * 1.05))
    >>> bool(fit.residuals.mean() < 0.2)  # millimetres
    True
    """
    check_template(template)
    check_scan(scan)
    preset = PRESETS[check_choice(preset, "preset", tuple(PRESETS))]
    chosen = tuple(scan.landmarks) if landmarks is None else check_names(landmarks)
    of_scan = as_landmarks(chosen, scan.landmarks)
    unknown = [n for n in chosen if n not in of_scan]
    if unknown:
        raise ValueError(f"landmarks names {', '.join(unknown)}, which the scan does not have.")
    named = as_landmarks(template.landmarks, {n: of_scan[n] for n in chosen})
    rigid, known, steps = _warped(
        template, scan.vertices, named, preset, "the scan's landmarks", normals=scan.normals
    )
    scan = scan.with_vertices(rigid.apply(scan.vertices))
    scan = without_scraps(scan, [named[n] for n in known])
    scan = wound_outwards(scan, template.with_vertices(steps["warp"]))
    border = on_border(scan)
    marks = [template.landmarks[n] for n in known]
    places = scan.vertices[[named[n] for n in known]]
    everything = sp.eye_array(template.n_vertices, format="csr")

    def nearest(mesh):
        faces, weights = closest_points(scan, mesh.vertices)
        at = rows(scan, faces, weights)
        place, normal = at @ scan.vertices, at @ scan.normals
        inside = ((weights > 1e-9) > border[scan.faces[faces]]).any(axis=1)
        agree = inside & ((normal * mesh.normals).sum(axis=1) > 0.5)
        apart = np.linalg.norm(place - mesh.vertices, axis=1)
        usual = np.median(apart[agree]) if agree.any() else np.inf
        return place, normal, agree & (apart < max(4 * usual, 5.0)), apart

    def match(mesh, slack):
        place, normal, drawn, _ = nearest(mesh)
        gap = ((place - mesh.vertices) * normal).sum(axis=1)
        target = np.vstack([mesh.vertices + gap[:, None] * normal, places])
        # a vertex is one of very many: its share is that of its neighbourhood of markers
        w = np.append(drawn * density / slack**2, np.full(len(marks), 1 / SEEN**2))
        return sp.vstack([everything, everything[marks]]), target, w

    density = min(1.0, 2000 / template.n_vertices)
    for i, V in enumerate(relaxed(template, steps["warp"], match, preset)):
        steps[f"stage {i + 1}"] = V
    mesh = template.with_vertices(V)
    _, _, drawn, apart = nearest(mesh)
    check_drawn(drawn)
    check_surface(mesh, template.with_vertices(steps["similarity"]), "scan")
    return Fit(
        mesh, rigid, steps, known, apart[drawn], preset, places=places, apart=apart, drawn=drawn
    )
