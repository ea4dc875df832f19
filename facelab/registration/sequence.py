"""A whole take of markers carried to the dense face (Tena et al. 2011, section 4.1).

With the layout of the markers known, every frame is a linear map: the head's motion is taken away,
exchanged and stray markers are put right, hidden ones filled, and dense frames made on demand.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import check_choice, check_number
from facelab.geometry.alignment import (
    HeadMotion,
    check_like,
    procrustes,
    rigid_motion,
    rigid_weights,
)
from facelab.motion import MotionSequence
from facelab.registration.fit import MarkerFit

_BLOCK = 1024  # frames worked on at a time


class Fault(NamedTuple):
    """Something wrong with markers in the frames first to stop - 1."""

    kind: str
    """"swap", "ghost", "stray" (away from where the others lead it) or "gap" (a long one)."""
    first: int
    stop: int
    names: tuple


@dataclass(frozen=True, eq=False)
class Registration:
    """A take registered: head motion, markers made whole, and dense frames on demand.

    Parameters
    ----------
    fit : MarkerFit
    fps : float
    head : HeadMotion
        From the head frame to the capture frame.
    displacements : ndarray of shape (n_frames, n_markers, 3)
        Of the markers from rest, head frame, all filled, millimetres.
    seen : ndarray of bool, shape (n_frames, n_markers)
        Measured and believed.
    valid : ndarray of bool, shape (n_frames,)
    faults : tuple of Fault
    missing : tuple of str
        Markers of the layout that the take does not name.
    """

    fit: MarkerFit
    fps: float
    head: HeadMotion = field(repr=False)
    displacements: np.ndarray = field(repr=False)
    seen: np.ndarray = field(repr=False)
    valid: np.ndarray = field(repr=False)
    faults: tuple = field(repr=False)
    missing: tuple = ()

    def __repr__(self):
        kinds = [f.kind for f in self.faults]
        counts = ", ".join(f"{kinds.count(k)} {k}s" for k in ("swap", "ghost", "stray", "gap"))
        return (
            f"Registration({len(self.valid)} frames, {int((~self.valid).sum())} lost, "
            f"{len(self.fit.names)} markers; {counts}; rms {self.rms:.2f} mm)"
        )

    @cached_property
    def _left(self):
        """Distance of the seen markers from the fitted surface's, NaN elsewhere: mm."""
        left = np.empty(self.seen.shape)
        for first in range(0, len(left), _BLOCK):
            moved = self.displacements[first : first + _BLOCK]
            off = moved - np.matmul(self.fit.layout.smooth, moved)
            left[first : first + _BLOCK] = np.linalg.norm(off, axis=2)
        left[~self.seen | ~self.valid[:, None]] = np.nan
        return left

    @property
    def rms(self):
        """Root mean squared distance of the markers that were seen, millimetres."""
        return float(_rms(self._left.ravel(), 0))

    @property
    def rms_per_marker(self):
        """The same for each marker, shape (n_markers,); NaN for one never seen."""
        return _rms(self._left, 0)

    @property
    def rms_per_frame(self):
        """The same for each frame, shape (n_frames,); NaN in lost frames."""
        return _rms(self._left, 1)

    @cached_property
    def left_out_per_marker(self):
        """Distance of each marker from where the others lead it, RMS over the take, mm."""
        # the residual of a linear smoother foretells the one of a fit without the marker
        own = np.maximum(1 - np.diag(self.fit.layout.smooth), 1e-9)
        return self.rms_per_marker / own

    @cached_property
    def confidence(self):
        """Expected error of the dense motion at each vertex, RMS, millimetres: (n_vertices,).

        The spread of the field between markers, scaled by how well, nearby and in this take,
        markers were foretold by the others. It does not know of errors in the neutral fit.
        """
        layout, noise = self.fit.layout, self.fit.preset.noise
        expected = noise * np.sqrt(3 / np.maximum(1 - np.diag(layout.smooth), 1e-9))
        ratio = self.left_out_per_marker / expected
        known = np.isfinite(ratio)
        near = np.abs(layout.carry[:, known])
        near = near / np.maximum(near.sum(axis=1, keepdims=True), 1e-12)
        return np.sqrt(3) * layout.spread() * np.sqrt(near @ ratio[known] ** 2)

    def positions(self, frames=None, vertices=None, block=256):
        """Dense positions of some frames, head frame: float32, shape (n_frames, n, 3), mm.

        Parameters
        ----------
        frames : slice or array_like of int, optional
            All if left out.
        vertices : array_like of int, optional
            Vertices of the mesh; all if left out.
        block : int, default=256
            Frames worked on at a time.
        """
        frames = slice(None) if frames is None else frames
        vertices = slice(None) if vertices is None else np.asarray(vertices)
        moved = self.displacements[frames]
        carry = self.fit.layout.carry[vertices].T.astype(np.float32)
        rest = self.fit.mesh.vertices[vertices].astype(np.float32)
        out = np.empty((len(moved), len(rest), 3), dtype=np.float32)
        for first in range(0, len(moved), block):
            part = np.ascontiguousarray(np.swapaxes(moved[first : first + block], 1, 2))
            part = part.astype(np.float32).reshape(-1, part.shape[2]) @ carry
            np.add(
                part.reshape(-1, 3, len(rest)).transpose(0, 2, 1), rest, out[first : first + block]
            )
        out[~self.valid[frames]] = np.nan
        return out

    def motion(self, vertices=None, mesh=None):
        """The whole take on some vertices: MotionSequence.

        Parameters
        ----------
        vertices : array_like of int, optional
            For instance those of `fit.mesh.subsample(397)`; all if left out.
        mesh : TriangleMesh, optional
            The triangles of those vertices, as `subsample` gives them.
        """
        if (vertices is None) != (mesh is None):
            raise ValueError("give vertices together with their mesh, as subsample returns them.")
        if mesh is None:
            neutral = self.fit.mesh
        else:
            neutral = mesh.with_vertices(self.fit.mesh.vertices[np.asarray(vertices)])
        return MotionSequence(self.positions(None, vertices), self.fps, neutral, self.valid)


def _rms(values, axis):
    square = np.nan_to_num(values) ** 2
    count = np.isfinite(values).sum(axis=axis)
    return np.sqrt(np.where(count, square.sum(axis=axis) / np.maximum(count, 1), np.nan))


def _runs(mask):
    """First and stop frame of each run of True, marker by marker: (marker, first, stop)."""
    edge = np.zeros((1, mask.shape[1]), dtype=int)
    step = np.diff(np.concatenate([edge, mask.astype(int), edge]), axis=0)
    marker, first = np.nonzero(step.T == 1)
    stop = np.nonzero(step.T == -1)[1]
    return list(zip(marker.tolist(), first.tolist(), stop.tolist(), strict=True))


def _find_swaps(layout, moved):
    """Pairs whose direction is reversed and that fit better exchanged: mask per pair, repaired.

    Neighbours on the skin come closer and turn, but do not change sides. Works on `moved` in
    place; gives a dict from pair to the frames in which it was exchanged.
    """
    rest = layout.fit.rest
    pairs = cKDTree(rest).query_pairs(25.0, output_type="ndarray")
    if len(pairs) == 0:
        return {}
    apart = rest[pairs[:, 0]] - rest[pairs[:, 1]]
    size = (apart**2).sum(axis=1)
    along = np.zeros((len(moved), len(pairs)))
    for axis in range(3):
        change = moved[..., axis]
        along += (change[:, pairs[:, 0]] - change[:, pairs[:, 1]]) * apart[:, axis]
    reversed_ = along < -1.3 * size  # never where one of them is NaN
    found = {}
    for frame in np.flatnonzero(reversed_.any(axis=1)):
        waiting = []
        for i, j in pairs[reversed_[frame]].tolist():
            without = moved[frame : frame + 1].copy()
            without[:, [i, j]] = np.nan
            led = layout.filled(without)[0, [i, j]] + rest[[i, j]]
            here = moved[frame, [i, j]] + rest[[i, j]]
            as_is, exchanged = ((here - led) ** 2).sum(), ((here[::-1] - led) ** 2).sum()
            if exchanged < 0.25 * as_is:
                waiting.append((exchanged / as_is, i, j))
        busy = set()
        for _, i, j in sorted(waiting):
            if not busy & {i, j}:
                busy |= {i, j}
                moved[frame, [i, j]] = (moved[frame, [i, j]] + rest[[i, j]])[::-1] - rest[[i, j]]
                found.setdefault((i, j), []).append(frame)
    return found


def _find_strays(layout, moved, limit, rounds=4):
    """Markers farther than `limit` from where the others lead them: mask; `moved` gets NaN.

    The worst of a neighbourhood goes first: it spoils what its neighbours are judged by.
    """
    near = [np.array(n) for n in cKDTree(layout.fit.rest).query_ball_point(layout.fit.rest, 30.0)]
    stray = np.zeros(moved.shape[:2], dtype=bool)
    frames = np.arange(len(moved))
    for _ in range(rounds):
        off = np.linalg.norm(layout.left_out(layout.filled(moved[frames])), axis=2)
        off[~np.isfinite(moved[frames][..., 0])] = 0
        bad = off > limit
        for f, m in np.argwhere(bad):
            bad[f, m] = off[f, m] >= off[f, near[m]].max()
        stray[frames] |= bad
        moved[stray] = np.nan
        frames = frames[bad.any(axis=1)]
        if not frames.size:
            break
    return stray


def _bridge(layout, full, seen, longest):
    """Short gaps: what the others say plus the marker's own way of differing, led across."""
    own = np.maximum(1 - np.diag(layout.smooth), 1e-9)

    def apart(frame, marker):
        return (full[frame, marker] - layout.smooth[marker] @ full[frame]) / own[marker]

    gaps = [g for g in _runs(~seen) if g[2] - g[1] <= longest and g[1] > 0 and g[2] < len(seen)]
    ends = [(apart(first - 1, m), apart(stop, m)) for m, first, stop in gaps]
    for (marker, first, stop), (before, after) in zip(gaps, ends, strict=True):
        t = (np.arange(first, stop) - first + 1)[:, None] / (stop - first + 1)
        full[first:stop, marker] += (1 - t) * before + t * after


def _block(layout, positions, weights, head, limit):
    """Some frames registered: head motion, filled displacements, seen, swaps, strays."""
    rest = layout.fit.rest
    motion = rigid_motion(positions, rest, weights, robust=True)
    moved = motion.to_head(positions) - rest
    swaps = _find_swaps(layout, moved)
    stray = _find_strays(layout, moved, limit)
    # back to the capture, put right, and the head once more
    positions = motion.to_capture(moved + rest)
    if head == "rigid":
        motion = rigid_motion(positions, rest, weights, robust=True)
    else:
        motion = rigid_motion(positions, rest)
    moved = motion.to_head(positions) - rest
    return motion, layout.filled(moved), np.isfinite(moved[..., 0]), swaps, stray


def _check_take(fit, positions):
    """Refuse a take that is mirrored, in other units, of another layout, or without a frame."""
    best = positions[np.isfinite(positions[..., 0]).sum(axis=1).argmax()]
    if not rigid_motion(1e6 * best[None], fit.rest).valid[0]:  # whatever the unit
        raise ValueError(
            f"none of the {len(positions)} frames has three markers that are not on one line; "
            "check that the take shows this layout."
        )
    likeness = procrustes(best, fit.rest, scale=True)
    spread = np.sqrt(fit.rest.var(axis=0).sum())
    if likeness.rms > 0.3 * spread and not likeness.mirrored:
        raise ValueError(
            f"the markers of the take lie {likeness.rms:.0f} mm from their places at rest, so they "
            "are named by another layout; fit the neutral of the same actor and session."
        )
    check_like(likeness, "the take")


def register_sequence(fit, markers, head="rigid", bridge=0.1, limit=8.0):
    """Carry a take of markers to the dense face.

    Parameters
    ----------
    fit : MarkerFit
        Of the same actor and session.
    markers : MarkerSequence
        Millimetres, capture frame. Markers that the layout does not have are taken for ghosts.
    head : {"rigid", "whole"}
        Head motion from the parts of the face that move least, robustly, or by ordinary
        Procrustes on all markers. (The paper aligns the 397 fitted vertices of each frame to
        those of the template: `rigid_motion` of `positions` gives that.)
    bridge : float, default=0.1
        Gaps up to this long keep what set the marker apart from its neighbours before and after,
        seconds; longer ones are reported. 0 solves every frame by its own markers alone.
    limit : float, default=8.0
        A marker farther from where the others lead it is a stray and not believed, millimetres.

    Returns
    -------
    Registration
        Exchanged markers are put back, ghosts and strays left out; `faults` lists all of them.
        A frame with fewer than three markers, or with markers on one line, is not valid.

    Raises
    ------
    ValueError
        If the take has fewer than three markers of the layout or no frame that shows them, is
        mirrored, not in millimetres, or named by another layout.

    Examples
    --------
    >>> import facelab
    >>> capture = facelab.data.load_capture("M1", size="small", progress=False)
    >>> take = capture.markers(capture.takes["train"][0])
    >>> rest = facelab.registration.rest_markers([take])
    >>> fit = facelab.fit_markers(facelab.load_template(4375), *rest)
    >>> bool(facelab.register_sequence(fit, take).valid.all())
    True
    """
    check_choice(head, "head", ("rigid", "whole"))
    bridge = check_number(bridge, "bridge", low=0)
    limit = check_number(limit, "limit", above=0)
    column = {name: i for i, name in enumerate(markers.names)}
    missing = tuple(n for n in fit.names if n not in column)
    if len(fit.names) - len(missing) < 3:
        raise ValueError(
            f"the take has {len(fit.names) - len(missing)} of the {len(fit.names)} markers of the "
            f"layout, but 3 or more are needed; missing: {', '.join(missing[:6])}, ..."
        )
    positions = np.full((markers.n_frames, len(fit.names), 3), np.nan)
    for i, name in enumerate(fit.names):
        if name in column:
            positions[:, i] = markers.positions[:, column[name]]
    _check_take(fit, positions)
    count = min(len(positions), 200)
    some = positions[np.linspace(0, len(positions) - 1, count).astype(int)]
    weights = rigid_weights(some, fit.rest)
    layout = fit.layout
    full = np.empty(positions.shape)
    parts, swaps = [], {}
    for first in range(0, len(positions), _BLOCK):
        part = slice(first, first + _BLOCK)
        moved, full[part], seen, exchanged, stray = _block(
            layout, positions[part], weights, head, limit
        )
        for pair, frames in exchanged.items():
            swaps.setdefault(pair, []).extend(first + f for f in frames)
        parts.append((moved.rotation, moved.translation, moved.rms, moved.valid, seen, stray))
    rotation, shift, rms, valid, seen, stray = map(np.concatenate, zip(*parts, strict=True))
    motion = HeadMotion(rotation, shift, rms, valid, weights)
    faults = _as_faults(fit.names, swaps, stray, len(positions))
    longest = round(bridge * markers.fps)
    if longest:
        _bridge(layout, full, seen, longest)
    hidden = np.isnan(positions[..., 0]) & valid[:, None]
    for marker, first, stop in _runs(hidden):
        if stop - first > longest:
            faults.append(Fault("gap", first, stop, (fit.names[marker],)))
    known = set(fit.names)
    extra = [i for i, name in enumerate(markers.names) if name not in known]
    if extra:
        for i, first, stop in _runs(markers.visible[:, extra]):
            faults.append(Fault("ghost", first, stop, (markers.names[extra[i]],)))
    faults = tuple(sorted(faults, key=lambda f: (f.first, f.kind, f.names)))
    full[~valid] = 0.0
    return Registration(fit, markers.fps, motion, full, seen, valid, faults, missing)


def _as_faults(names, swaps, stray, n_frames):
    faults = []
    for pair, frames in swaps.items():
        mask = np.zeros((n_frames, 1), dtype=bool)
        mask[frames] = True
        both = tuple(names[i] for i in pair)
        faults += [Fault("swap", first, stop, both) for _, first, stop in _runs(mask)]
    for marker, first, stop in _runs(stray):
        faults.append(Fault("stray", first, stop, (names[marker],)))
    return faults
