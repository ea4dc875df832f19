"""A whole take of markers carried to the dense face (Tena et al. 2011, section 4.1).

With the layout of the markers known, every frame is a linear map: the head's motion is taken away,
frames that are none of this face are left out, exchanged and stray markers put right, hidden ones
filled, and dense frames made on demand.
"""

import warnings
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm.auto import tqdm

from facelab.checks import as_indices, check_choice, check_count, check_number, check_type
from facelab.geometry.alignment import HeadMotion, rigid_motion
from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MarkerSequence, MotionSequence
from facelab.numeric.quantiles import nan_quantile
from facelab.registration.confidence import expected_error
from facelab.registration.faults import StrayJudge, find_swaps, runs
from facelab.registration.fit import MarkerFit
from facelab.registration.frames import FEW, REASONS, STRAYS, FrameJudge
from facelab.storage import atomic_path

_BLOCK = 1024  # frames worked on at a time
_ELSEWHERE = 2.5  # mm; in a take of one's own, hardly a marker is never nearer to its rest


class Fault(NamedTuple):
    """Something wrong in the frames first to stop - 1."""

    kind: str
    """"frame" (not believed as a whole), or of markers: "swap", "ghost", "stray" (away from where
    the others lead it) or "gap" (a long one)."""
    first: int
    stop: int
    names: tuple
    """Of the markers; none for a frame."""
    reason: str = ""
    """Why a frame is not believed."""


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
        Of the markers from rest, head frame, all filled, millimetres; float32.
    seen : ndarray of bool, shape (n_frames, n_markers)
        Measured and believed.
    valid : ndarray of bool, shape (n_frames,)
    faults : tuple of Fault
    missing : tuple of str
        Markers of the layout that the take does not name.
    n_samples : int
        Places of markers of the layout that the take holds, right or wrong.
    rejected : ndarray of shape (n_strays,)
        How far each stray sample lay from where the others lead it, millimetres.
    """

    fit: MarkerFit
    fps: float
    head: HeadMotion = field(repr=False)
    displacements: np.ndarray = field(repr=False)
    seen: np.ndarray = field(repr=False)
    valid: np.ndarray = field(repr=False)
    faults: tuple = field(repr=False)
    missing: tuple = ()
    n_samples: int = 0
    rejected: np.ndarray = field(default=(), repr=False)

    def __repr__(self):
        kinds = Counter(f.kind for f in self.faults)
        counts = ", ".join(f"{kinds[k]} {k}s" for k in ("swap", "ghost", "stray", "gap"))
        thrown = "nothing thrown away"
        if self.share_rejected > 0:
            thrown = f"{100 * self.share_rejected:.2g} % of the samples thrown away"
        if len(self.rejected):
            thrown += f", the strays {self.rms_rejected:.3g} mm off"
        if self.left_out:
            count = len(self.left_out)
            thrown = f"{count} marker(s) left out as none of the face, of the others {thrown}"
        return (
            f"Registration({len(self.valid)} frames, {int((~self.valid).sum())} lost, "
            f"{len(self.fit.names)} markers; {counts}; rms {self.rms:.2f} mm of what was believed, "
            f"{thrown})"
        )

    @property
    def report(self):
        """What was believed and what was thrown away, and why, in words: str."""
        frames = [f for f in self.faults if f.kind == "frame"]
        lines = [repr(self)]
        if self.missing:
            named = ", ".join(self.missing[:6]) + ", ..." * (len(self.missing) > 6)
            lines.append(
                f"not in the take, led by the others: {len(self.missing)} of "
                f"{len(self.fit.names)} markers ({named})"
            )
        if self.left_out:
            named = ", ".join(self.left_out[:6]) + ", ..." * (len(self.left_out) > 6)
            lines.append(f"left out, as they lie off the face at rest: {named}")
        if frames:
            lines.append(f"frames not believed: {_places(frames, lambda f: f' ({f.reason})')}")
        for kind, said in (("stray", "strayed, not believed"), ("swap", "exchanged, put back")):
            found = {}
            for fault in self.faults:
                if fault.kind == kind:
                    found.setdefault(fault.names, []).append(fault)
            for names, faults in found.items():
                lines.append(f"{' and '.join(names)} {said}: frame {_places(faults)}")
        return "\n".join(lines)

    @cached_property
    def left_out(self):
        """Markers of the take that the fit left out as none of the face: tuple of str."""
        ghosts = {f.names[0] for f in self.faults if f.kind == "ghost"}
        return tuple(n for n in self.fit.left_out if n in ghosts)

    @cached_property
    def _left(self):
        """Squared distance of the seen markers from the fitted surface's, mm^2.

        Sums and counts over frames, per marker, and over markers, per frame.
        """
        n_frames, n_markers = self.seen.shape
        markers, frames = np.zeros((2, n_markers)), np.zeros((2, n_frames))
        for first in range(0, n_frames, _BLOCK):
            part = slice(first, first + _BLOCK)
            moved = self.displacements[part].astype(float)
            off = moved - self.fit.layout.smoothed(moved)
            square = np.where(self.seen[part], np.einsum("fmx,fmx->fm", off, off), 0.0)
            markers += square.sum(axis=0), self.seen[part].sum(axis=0)
            frames[:, part] = square.sum(axis=1), self.seen[part].sum(axis=1)
        return markers, frames

    @property
    def rms(self):
        """Root mean squared distance of the markers that were believed, millimetres.

        It says nothing of those that were not: see `share_rejected` and `rms_rejected`.
        """
        return float(_root_mean(*self._left[0].sum(axis=1)))

    @property
    def rms_per_marker(self):
        """The same for each marker, shape (n_markers,); NaN for one never believed."""
        return _root_mean(*self._left[0])

    @property
    def rms_per_frame(self):
        """The same for each frame, shape (n_frames,); NaN in lost frames."""
        return _root_mean(*self._left[1])

    @property
    def share_rejected(self):
        """Of the markers' places in the take, how many were thrown away: 0 to 1.

        Strays, and all markers of frames that are not believed.
        """
        return float(1 - self.seen.sum() / self.n_samples) if self.n_samples else 0.0

    @property
    def rms_rejected(self):
        """How far strays lay from where the others lead them, RMS, millimetres; NaN for none.

        Markers of frames that are not believed as a whole have no such place and do not count.
        """
        if not len(self.rejected):
            return float("nan")
        largest = self.rejected.max()  # whose square may be beyond all numbers
        return float(largest * np.sqrt(((self.rejected / largest) ** 2).mean()))

    @cached_property
    def left_out_per_marker(self):
        """Distance of each marker from where the others lead it, RMS over the take, mm."""
        # the residual of a linear smoother foretells the one of a fit without the marker
        return self.rms_per_marker / self.fit.layout.own

    @cached_property
    def confidence(self):
        """Error of the dense motion that nine in ten vertices stay below: mm, (n_vertices,).

        RMS over the take, of the motion from the neutral; see `expected_error`. It does not know
        of errors in the neutral fit.
        """
        return expected_error(self.fit, self.left_out_per_marker)

    def positions(self, frames=None, vertices=None, block=256, out=None, progress=False):
        """Dense positions of some frames, head frame: float32, shape (n_frames, n, 3), mm.

        Parameters
        ----------
        frames : slice or array_like of int, optional
            All if left out.
        vertices : array_like of int, optional
            Vertices of the mesh; all if left out.
        block : int, default=256
            Frames worked on at a time.
        out : ndarray, or str or Path, optional
            Where they go: an array of that shape, or a new file of NumPy's (`.npy`), of which a
            memory map is returned. A take of ten minutes, dense, is 7.6 GB: larger than the
            memory of many machines. The file is written whole or not at all.
        progress : bool, default=False
            Show a progress bar.

        Raises
        ------
        ValueError, TypeError, FileNotFoundError, PermissionError
            For an array of another shape, or a path that no file can be written to.
        """
        block = check_count(block, "block", 1, None, "frames")
        frames = _picked(frames, "frames", len(self.valid))
        vertices = _picked(vertices, "vertices", self.fit.mesh.n_vertices)
        moved, valid = self.displacements[frames], self.valid[frames]
        carried = self.fit.layout.carrier(vertices)
        rest = self.fit.mesh.vertices[vertices].astype(np.float32)
        shape = (len(moved), len(rest), 3)

        def blocks(place):
            """Each block in turn, made in the array that `place` gives for its frames."""
            bar = tqdm(
                total=len(moved), desc="dense frames", unit="frame", leave=False,
                disable=not progress, delay=1,
            )  # fmt: skip
            with bar:
                for first in range(0, len(moved), block):
                    part = moved[first : first + block]
                    made = place(first, len(part))
                    np.add(carried(part), rest, out=made)
                    made[~valid[first : first + block]] = np.nan
                    yield made
                    bar.update(len(made))

        if isinstance(out, (str, Path)):
            buffer = np.empty((min(block, len(moved)), *shape[1:]), dtype=np.float32)
            with atomic_path(out) as path, open(path, "wb") as file:
                about = {"descr": buffer.dtype.str, "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, about)
                for made in blocks(lambda first, count: buffer[:count]):
                    file.write(made.data)  # not through a map, whose pages would fill the memory
            return np.load(out, mmap_mode="r")
        if out is None:
            out = np.empty(shape, dtype=np.float32)
        elif not isinstance(out, np.ndarray):
            raise TypeError(f"out is a {type(out).__name__}; give an array or the path of a file.")
        elif out.shape != shape or out.dtype.kind != "f":
            raise ValueError(
                f"out has shape {out.shape} and type {out.dtype}, but needs {shape} of float32."
            )
        for _ in blocks(lambda first, count: out[first : first + count]):
            pass
        return out

    def motion(self, vertices=None, mesh=None, out=None, progress=False):
        """The whole take on some vertices: MotionSequence.

        Parameters
        ----------
        vertices : array_like of int, optional
            For instance those of `fit.mesh.subsample(397)`; all if left out.
        mesh : TriangleMesh, optional
            The triangles of those vertices, as `subsample` gives them.
        out, progress
            See `positions`.
        """
        if (vertices is None) != (mesh is None):
            raise ValueError("give vertices together with their mesh, as subsample returns them.")
        if mesh is None:
            neutral = self.fit.mesh
        else:
            check_type(mesh, "mesh", TriangleMesh, "subsample gives it with its vertices")
            vertices = _picked(vertices, "vertices", self.fit.mesh.n_vertices)
            neutral = mesh.with_vertices(self.fit.mesh.vertices[vertices])
        made = self.positions(None, vertices, out=out, progress=progress)
        return MotionSequence(made, self.fps, neutral, self.valid)


def _picked(chosen, name, size):
    """A slice, or indices of some of `size` things, from either, a mask or None for all."""
    if chosen is None or isinstance(chosen, slice):
        return slice(None) if chosen is None else chosen
    array = np.asarray(chosen)
    if array.dtype == bool and array.shape == (size,):
        return np.flatnonzero(array)
    return as_indices(array, name, size, name, distinct=False)


def _check_rest(take):
    """Say so where most markers never come near their places at rest: it is another face."""
    kept = np.flatnonzero(take.why == 0)
    kept = kept[np.linspace(0, len(kept) - 1, min(len(kept), 400)).astype(int)]
    off = np.linalg.norm(take.full[kept], axis=2)
    off[~take.seen[kept]] = np.nan
    known = np.isfinite(off).any(axis=0)
    if len(kept) < 10 or not known.any():
        return
    nearest = nan_quantile(off[:, known], 0.05)
    away = int((nearest > _ELSEWHERE).sum())
    if 2 * away > len(nearest):
        warnings.warn(
            f"markers: {away} of {len(nearest)} never come within {_ELSEWHERE:g} mm of their "
            "places at rest, so what sets the faces apart is taken for motion. Fit the neutral "
            "of the same actor and session, from frames at rest.",
            stacklevel=3,
        )


def _root_mean(total, count):
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _places(faults, what=lambda fault: "", most=8):
    """The frames of some faults, in words."""
    said = [f"{f.first}" + f" to {f.stop - 1}" * (f.stop - f.first > 1) + what(f) for f in faults]
    return ", ".join(said[:most]) + f" and {len(said) - most} more" * (len(said) > most)


def _bridge(layout, full, seen, longest):
    """Short gaps: what the others say plus the marker's own way of differing, led across."""

    def apart(frame, marker):
        return layout.left_out(full[frame : frame + 1])[0, marker].copy()  # not the whole row

    gaps = [g for g in runs(~seen) if g[2] - g[1] <= longest and g[1] > 0 and g[2] < len(seen)]
    ends = [(apart(first - 1, m), apart(stop, m)) for m, first, stop in gaps]
    for (marker, first, stop), (before, after) in zip(gaps, ends, strict=True):
        t = (np.arange(first, stop) - first + 1)[:, None] / (stop - first + 1)
        full[first:stop, marker] += (1 - t) * before + t * after


class _Take:
    """A take on its way: read, judged and filled in blocks, so that little of it is held at once.

    What is kept whole is what the result needs; positions are float64 only within a block.
    """

    def __init__(self, fit, markers):
        column = {name: i for i, name in enumerate(markers.names)}
        self.fit, self.markers = fit, markers
        self.missing = tuple(n for n in fit.names if n not in column)
        self._here = np.array([i for i, n in enumerate(fit.names) if n in column])
        self._there = np.array([column[fit.names[i]] for i in self._here])
        n_frames, n_markers = markers.n_frames, len(fit.names)
        self.judge = FrameJudge(fit.rest, self.positions, n_frames)
        self.full = np.zeros((n_frames, n_markers, 3), dtype=np.float32)
        self.seen = np.zeros((n_frames, n_markers), dtype=bool)
        self.rotation = np.full((n_frames, 3, 3), np.nan)
        self.translation = np.full((n_frames, 3), np.nan)
        self.rms = np.full(n_frames, np.nan)
        self.why = np.zeros(n_frames, dtype=np.int8)
        self.amount = np.zeros(n_frames)
        self.swapped = np.zeros(n_frames, dtype=bool)
        self.n_samples = 0
        self.swaps, self.strays, self.rejected = {}, [], []

    def positions(self, frames):
        """Some frames in the order of the layout: float64, NaN where not seen."""
        given = self.markers.positions[frames]
        out = np.full((len(given), len(self.fit.names), 3), np.nan)
        out[:, self._here] = given[:, self._there]
        return out

    def align(self, part):
        """Head motion, judged frame by frame, and exchanged markers put back."""
        positions = self.positions(part)
        self.n_samples += int(np.isfinite(positions[..., 0]).sum())
        found = self.judge.judge(positions)
        pairs = find_swaps(self.fit.layout, found.moved)
        self._note_swaps(part, part.start, pairs)
        self.seen[part] = np.isfinite(found.moved[..., 0])
        self.full[part] = found.moved
        self._keep_head(part, found.head)
        self.why[part], self.amount[part] = found.why, found.amount
        self._note_strays(part.start, found.far, found.distance)

    def _note_swaps(self, part, first, pairs):
        for pair, frames in pairs.items():
            at = [first + f for f in frames if part.start <= first + f < part.stop]
            self.swaps.setdefault(pair, []).extend(at)
            self.swapped[at] = True  # the head was found with their names exchanged

    def _note_strays(self, first, mask, distance):
        self.strays.append(np.argwhere(mask) + [first, 0])
        self.rejected.append(distance)

    def learn(self, fps, limit):
        """How the markers of this take move."""
        weights = self.judge.weights
        self.strayed = StrayJudge(self.fit.layout, self.full, self.seen, fps, weights, limit)

    def settle(self, part):
        """Strays left out, the head found once more where markers changed, hidden ones filled."""
        first, stop = max(0, part.start - self.strayed.margin), part.stop + self.strayed.margin
        wide = slice(first, stop)
        core = slice(part.start - first, part.stop - first)
        moved = np.where(self.seen[wide, :, None], self.full[wide], np.nan).astype(float)
        before = moved[core].copy()
        stray, swaps, full = self.strayed.find(moved)
        self._note_swaps(part, first, swaps)
        stray, full, moved = stray[core], full[core], moved[core]
        count = np.isfinite(before[..., 0]).sum(axis=1)
        many = (3 * stray.sum(axis=1) > count) & (count > 0)
        self._refuse_frames(part, many, STRAYS, 100 * stray.sum(axis=1) / np.maximum(count, 1))
        stray[many] = False
        changed = (stray.any(axis=1) | self.swapped[part]) & (self.why[part] == 0)
        if changed.any():
            at = part.start + np.flatnonzero(changed)
            moved[changed], few = self._realign(at, moved[changed], self.judge.weights)
            full[changed] = self.fit.layout.filled(moved[changed])
        self._note_strays(part.start, stray, np.linalg.norm((before - full)[stray], axis=1))
        self.full[part], self.seen[part] = full, np.isfinite(moved[..., 0])
        if changed.any():
            self._refuse_frames(at, few, FEW, 0)
        lost = self.why[part] > 0
        self.seen[part][lost], self.full[part][lost] = False, 0.0

    def settle_whole(self, part):
        """The head found anew, from all markers alike."""
        moved = np.where(self.seen[part, :, None], self.full[part], np.nan).astype(float)
        kept = part.start + np.flatnonzero(self.why[part] == 0)
        moved, _ = self._realign(kept, moved[kept - part.start], None)
        self.full[kept] = self.fit.layout.filled(moved)

    def _realign(self, frames, moved, weights):
        """Displacements of some frames with their head found anew, and which have too little."""
        rest = self.fit.rest
        motion = rigid_motion(moved + rest, rest, weights, robust=weights is not None)
        turn = self.rotation[frames]  # first by what is new, then by what was
        self.translation[frames] += np.matmul(turn, motion.translation[..., None])[..., 0]
        self.rotation[frames] = np.matmul(turn, motion.rotation)
        self.rms[frames] = motion.rms
        return motion.to_head(moved + rest) - rest, ~motion.valid

    def _refuse_frames(self, frames, mask, reason, amount):
        """Frames that are not believed after all."""
        at = np.arange(self.markers.n_frames)[frames][mask]
        self.why[at] = reason
        self.amount[at] = np.broadcast_to(amount, mask.shape)[mask]
        for part in (self.rotation, self.translation, self.rms):
            part[at] = np.nan

    def head(self):
        """The motion of the head: HeadMotion."""
        shares = self.judge.weights
        return HeadMotion(self.rotation, self.translation, self.rms, self.why == 0, shares)

    def faults(self, longest):
        """All that was wrong, by frame: tuple of Fault."""
        names, found = self.fit.names, []
        for pair, frames in self.swaps.items():
            both = tuple(names[i] for i in pair)
            found += [Fault("swap", a, b, both) for a, b in _stretches(np.sort(frames))]
        stray = np.concatenate(self.strays)
        for marker in np.unique(stray[:, 1]).tolist():
            frames = np.sort(stray[stray[:, 1] == marker, 0])
            found += [Fault("stray", a, b, (names[marker],)) for a, b in _stretches(frames)]
        for kind in np.unique(self.why[self.why > 0]).tolist():
            for a, b in _stretches(np.flatnonzero(self.why == kind)):
                said = REASONS[kind].format(float(np.median(self.amount[a:b])))
                found.append(Fault("frame", a, b, (), said))
        hidden = ~self.seen & (self.why == 0)[:, None]
        hidden[stray[:, 0], stray[:, 1]] = False
        for marker, a, b in runs(hidden):
            if b - a > longest:
                found.append(Fault("gap", a, b, (names[marker],)))
        known = set(names)
        extra = [i for i, name in enumerate(self.markers.names) if name not in known]
        for i, a, b in runs(self.markers.visible[:, extra]):
            found.append(Fault("ghost", a, b, (self.markers.names[extra[i]],)))
        return tuple(sorted(found, key=lambda f: (f.first, f.kind, f.names)))

    def _keep_head(self, frames, motion):
        self.rotation[frames] = motion.rotation
        self.translation[frames] = motion.translation
        self.rms[frames] = motion.rms


def _stretches(frames):
    """First and stop of each stretch of frame numbers that follow one another."""
    edges = np.flatnonzero(np.diff(frames) != 1) + 1
    return [(int(part[0]), int(part[-1]) + 1) for part in np.split(frames, edges) if len(part)]


def register_sequence(fit, markers, head="rigid", bridge=0.1, limit=None, progress=True):
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
    limit : float, optional
        A marker farther from where the others lead it is a stray and not believed, millimetres. If
        left out, markers are judged by how they move: one that jumps away and back within a second
        strays, and so does one that is never where it should be; a peak that comes and goes
        smoothly is kept. How far a jump is follows from how the marker moves in the take.
    progress : bool, default=True
        Show a progress bar if it takes more than a second.

    Returns
    -------
    Registration
        Exchanged markers are put back, ghosts and strays left out; `faults` lists all of them.
        A frame with fewer than three markers, with markers on one line or in one point, mirrored,
        of another size, far from how the face looks in the rest of the take, or with a third of
        its markers astray, is not valid, and a fault of kind "frame" says why. A marker farther
        from the others than any of a face is a stray like any other.

    Raises
    ------
    ValueError
        If the take has no frames, fewer than three markers of the layout or no frame that shows
        them, is mirrored all through, not in millimetres, or named by another layout.

    Warns
    -----
    UserWarning
        If most markers never come near their places at rest.

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
    check_type(fit, "fit", MarkerFit, "facelab.fit_markers makes one")
    check_type(markers, "markers", MarkerSequence, "read it with facelab.read_markers")
    check_choice(head, "head", ("rigid", "whole"))
    bridge = check_number(bridge, "bridge", low=0)
    limit = limit if limit is None else check_number(limit, "limit", above=0)
    if not markers.n_frames:
        raise ValueError("the take has no frames; check the range that was exported or selected.")
    known = set(markers.names)
    missing = tuple(n for n in fit.names if n not in known)
    if len(fit.names) - len(missing) < 3:
        raise ValueError(
            f"the take has {len(fit.names) - len(missing)} of the {len(fit.names)} markers of the "
            f"layout, but 3 or more are needed; missing: {', '.join(missing[:6])}, ..."
        )
    take = _Take(fit, markers)
    steps = [take.align, take.settle] + [take.settle_whole] * (head == "whole")
    bar = tqdm(
        total=len(steps) * markers.n_frames, desc="registering", unit="frame", leave=False,
        disable=not progress, delay=1,
    )  # fmt: skip
    with bar:
        for step in steps:
            if step == take.settle:
                take.learn(markers.fps, limit)
            block = 2 * _BLOCK if step == take.settle else _BLOCK  # which sees a margin, too
            for first in range(0, markers.n_frames, block):
                part = slice(first, min(first + block, markers.n_frames))
                step(part)
                bar.update(part.stop - first)
    longest = round(bridge * markers.fps)
    if longest:
        _bridge(fit.layout, take.full, take.seen, longest)
    take.full[take.why > 0] = 0.0
    _check_rest(take)
    return Registration(
        fit, markers.fps, take.head(), take.full, take.seen, take.why == 0, take.faults(longest),
        missing, take.n_samples, np.concatenate(take.rejected),
    )  # fmt: skip
