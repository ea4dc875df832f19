"""Sequences in time: positions of a mesh or of markers, weights of a rig. Arrays with names."""

from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from facelab.checks import (
    as_finite,
    as_floats,
    check_index,
    check_names,
    check_number,
    check_type,
    refuse_mask,
)
from facelab.geometry.alignment import rigid_motion
from facelab.geometry.mesh import TriangleMesh
from facelab.numeric.filters import one_euro, zero_phase
from facelab.numeric.seeds import as_generator
from facelab.numeric.threads import single_threaded


def _valid_mask(valid, n_frames):
    valid = np.ones(n_frames, dtype=bool) if valid is None else np.asarray(valid)
    if valid.shape != (n_frames,) or valid.dtype != bool:
        raise ValueError(
            f"valid has shape {valid.shape} and type {valid.dtype}, but needs one bool for each of "
            f"the {n_frames} frames."
        )
    return valid


def _finite(positions, block=256):
    """Frames without NaN and infinite values; in blocks, for positions larger than the memory."""
    finite = np.empty(len(positions), dtype=bool)
    for first in range(0, len(positions), block):
        part = slice(first, first + block)
        finite[part] = np.isfinite(positions[part]).all(axis=(1, 2))
    return finite


class _Sequence:
    """What all sequences share: frames at a fixed rate, some of them lost."""

    @property
    def n_frames(self):
        """Number of frames, lost ones included."""
        return len(self.valid)

    @property
    def duration(self):
        """Seconds."""
        return self.n_frames / self.fps

    def resampled(self, fps):
        """The same take at a lower rate: the frames nearest to the new beat, none made up.

        Parameters
        ----------
        fps : float
            Frames a second, at most the sequence's own.
        """
        fps = check_number(fps, "fps", above=0)
        if fps > self.fps:
            raise ValueError(
                f"fps={fps:g}, but the sequence has {self.fps:g}: frames are not made up."
            )
        count = min(self.n_frames, max(1, int(np.floor(self.duration * fps + 1e-9))))
        picked = np.minimum(np.round(np.arange(count) * self.fps / fps), self.n_frames - 1)
        return replace(self[picked.astype(int)], fps=fps)


@dataclass(frozen=True, eq=False)
class MotionSequence(_Sequence):
    """Positions of every vertex of one mesh in every frame.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_vertices, 3)
        Millimetres, head frame, head motion removed; float32 is kept as it is, and so is a memory
        map.
    fps : float
        Frames a second.
    mesh : TriangleMesh
        The neutral face: its vertices are subtracted by `displacements`.
    valid : ndarray of bool, shape (n_frames,), optional
        False where the frame was lost; such frames keep their place in time.

    Examples
    --------
    >>> import numpy as np
    >>> from facelab import MotionSequence, TriangleMesh
    >>> face = TriangleMesh([[0, 0, 0], [10, 0, 0], [0, 10, 0]], [[0, 1, 2]])
    >>> motion = MotionSequence(face.vertices + np.zeros((60, 3, 3)), 30.0, face)
    >>> motion.duration, motion.resampled(15).n_frames, motion.displacements().shape
    (2.0, 30, (60, 9))
    """

    positions: np.ndarray
    fps: float
    mesh: TriangleMesh
    valid: np.ndarray = None

    def __post_init__(self):
        check_type(self.mesh, "mesh", TriangleMesh, "give the face at rest: facelab.read_mesh")
        wanted = (self.mesh.n_vertices, 3)
        shape = f"(n_frames, {wanted[0]}, 3)"
        positions = as_floats(self.positions, "positions", shape, "mark lost frames in `valid`")
        if positions.ndim != 3 or positions.shape[1:] != wanted:
            raise ValueError(
                f"positions has shape {positions.shape}, but the mesh asks for "
                f"(n_frames, {wanted[0]}, 3)."
            )
        valid = _valid_mask(self.valid, len(positions))
        bad = valid & ~_finite(positions)
        if bad.any():
            raise ValueError(
                f"positions holds NaN or infinite values in {int(bad.sum())} frame(s), the first "
                f"{int(np.flatnonzero(bad)[0])}; mark lost frames in `valid`."
            )
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "valid", valid)
        object.__setattr__(self, "fps", check_number(self.fps, "fps", above=0))

    def __repr__(self):
        return (
            f"MotionSequence({self.n_frames} frames of {self.mesh.n_vertices} vertices, "
            f"{self.fps:g} frames/s, {int((~self.valid).sum())} lost)"
        )

    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            raise TypeError("give a slice or an array of frames; positions[i] is a single frame.")
        return replace(self, positions=self.positions[frames], valid=self.valid[frames])

    @single_threaded  # a cut may hang on the last bit, which is another on several threads
    def aligned(self):
        """The same motion with each frame laid onto the neutral by whole-face Procrustes.

        What all of the face does together, an open jaw included, is taken for the head's motion,
        as in the paper; registration by parts that hardly move (`head="rigid"`) leaves it in.

        Returns
        -------
        MotionSequence

        References
        ----------
        Tena et al. 2011, section 4.1: all meshes were aligned to the template by Procrustes.
        """
        turn = rigid_motion(self.positions, self.mesh.vertices)
        return replace(self, positions=turn.to_head(self.positions))

    def displacements(self):
        """Motion of the valid frames away from the neutral face, as estimators take it.

        Returns
        -------
        X : ndarray of shape (n_valid, 3 * n_vertices)
            Millimetres; x, y, z of a vertex side by side.
        """
        moved = self.positions[self.valid].astype(float) - self.mesh.vertices
        return moved.reshape(len(moved), -1)

    def with_noise(self, sigma, random_state=None):
        """The motion as a capture would see it: Gaussian noise on every coordinate.

        Parameters
        ----------
        sigma : float
            Standard deviation per axis, millimetres; 0.1 to 0.3 is usual for optical capture.
        random_state : int, Generator or None
        """
        sigma = check_number(sigma, "sigma", low=0)
        noise = as_generator(random_state).normal(scale=sigma, size=self.positions.shape)
        return replace(self, positions=self.positions + noise)


@dataclass(frozen=True, eq=False)
class WeightSequence(_Sequence):
    """Weights of named shapes in every frame.

    Parameters
    ----------
    weights : ndarray of shape (n_frames, n_names)
        Nominally 0 to 1; NaN only in frames that are not valid.
    names : sequence of str
        Name of each column, each once.
    fps : float
        Frames a second.
    valid : ndarray of bool, shape (n_frames,), optional
        False where the frame was lost.
    angles : dict of str to ndarray of shape (n_frames,), optional
        Head and eye angles recorded beside the weights, radians.
    others : dict of str to ndarray of shape (n_frames,), optional
        Numbers that were recorded beside them and are neither; NaN where there was none.
    gaps : dict of int to float, optional
        Seconds missing before a frame (not the first), where a recording was interrupted for so
        long that lost frames do not stand for it. Nothing is interpolated or smoothed across.
    report : object, optional
        What the reader of the file found, printable; stays with every part of the sequence.

    Examples
    --------
    >>> from facelab import WeightSequence
    >>> take = WeightSequence([[0.0, 0.1], [0.5, 0.2]], ["jawOpen", "eyeBlinkLeft"], fps=60)
    >>> take.n_frames, take.names
    (2, ('jawOpen', 'eyeBlinkLeft'))
    """

    weights: np.ndarray
    names: tuple
    fps: float
    valid: np.ndarray = None
    angles: dict = field(default_factory=dict)
    others: dict = field(default_factory=dict)
    gaps: dict = field(default_factory=dict)
    report: object = None

    def __post_init__(self):
        names = check_names(self.names)
        refuse_mask(self.weights, "weights", "mark lost frames in `valid`")
        weights = np.asarray(self.weights)
        if weights.dtype.kind not in "fiu":
            raise TypeError(
                f"weights is an array of {weights.dtype}, but weights are numbers; give floats."
            )
        weights = weights.astype(float, copy=False)
        if weights.ndim != 2 or weights.shape[1] != len(names):
            raise ValueError(
                f"weights has shape {weights.shape}, but {len(names)} names ask for "
                f"(n_frames, {len(names)})."
            )
        valid = _valid_mask(self.valid, len(weights))
        as_finite(weights[valid], "weights", ("n_frames", len(names)), "valid frames")
        angles, others = (
            {name: np.asarray(values, dtype=float) for name, values in beside.items()}
            for beside in (self.angles, self.others)
        )
        for what, beside in (("angles", angles), ("others", others)):
            for name, values in beside.items():
                if values.shape != valid.shape:
                    raise ValueError(
                        f"{what}[{name!r}] has shape {values.shape}, but there are {len(valid)} "
                        "frames."
                    )
        for name, angle in angles.items():
            as_finite(angle[valid], f"angles[{name!r}]", (int(valid.sum()),), "valid frames")
        gaps = dict(sorted(self.gaps.items()))
        for frame, seconds in gaps.items():
            check_index(frame, "frame of a gap", len(valid), "frames")
            check_number(seconds, f"gaps[{frame}]", above=0)
        if 0 in gaps:
            raise ValueError("gaps names frame 0, but nothing comes before it: leave it out.")
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "others", others)
        object.__setattr__(self, "gaps", gaps)
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "valid", valid)
        object.__setattr__(self, "fps", check_number(self.fps, "fps", above=0))

    def __repr__(self):
        gaps = f", {len(self.gaps)} gap{'s' * (len(self.gaps) > 1)} in time" if self.gaps else ""
        return (
            f"WeightSequence({self.n_frames} frames of {len(self.names)} weights, "
            f"{self.fps:g} frames/s, {int((~self.valid).sum())} lost{gaps})"
        )

    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            raise TypeError("give a slice or an array of frames; weights[i] is a single frame.")
        missing = np.cumsum(self._missing())[frames]
        missing = np.diff(missing, prepend=missing[:1])
        return replace(
            self,
            weights=self.weights[frames],
            valid=self.valid[frames],
            angles={k: a[frames] for k, a in self.angles.items()},
            others={k: a[frames] for k, a in self.others.items()},
            gaps={int(i): float(missing[i]) for i in np.flatnonzero(missing > 1e-9)},
        )

    def _missing(self):
        """Seconds missing before each frame, shape (n_frames,)."""
        missing = np.zeros(self.n_frames)
        missing[list(self.gaps)] = list(self.gaps.values())
        return missing

    @property
    def times(self):
        """Seconds of each frame after the first, gaps included: ndarray of shape (n_frames,)."""
        return np.arange(self.n_frames) / self.fps + np.cumsum(self._missing())

    def stretches(self):
        """Slices of frames that follow one another, none of them lost and no gap between them.

        Examples
        --------
        >>> take = WeightSequence([[0.1], [0.2], [0.3], [0.4]], ["jawOpen"], 30, gaps={3: 5.0})
        >>> take.stretches()
        [slice(0, 3, None), slice(3, 4, None)]
        """
        joined = self.valid[1:] & self.valid[:-1]
        joined[[frame - 1 for frame in self.gaps]] = False
        edges = [0, *(np.flatnonzero(~joined) + 1).tolist(), self.n_frames]
        return [slice(a, b) for a, b in pairwise(edges) if a < b and self.valid[a]]

    def renamed(self, mapping):
        """The same weights under other names.

        Parameters
        ----------
        mapping : dict of str to str, or callable
            New names by old ones; names that it does not hold stay. A function is asked for each.

        Returns
        -------
        WeightSequence

        Raises
        ------
        ValueError
            For names that the sequence does not have, or two shapes that would share one.

        Examples
        --------
        >>> take = WeightSequence([[0.2, 0.4]], ["jawOpen", "AU12L"], 30)
        >>> take.renamed({"AU12L": "mouthSmileLeft"}).names
        ('jawOpen', 'mouthSmileLeft')
        """
        if callable(mapping):
            mapping = {name: mapping(name) for name in self.names}
        unknown = sorted(set(mapping) - set(self.names))
        if unknown:
            raise ValueError(
                f"mapping names {', '.join(unknown)}, which the sequence does not have; it has "
                f"{', '.join(self.names)}."
            )
        return replace(self, names=tuple(mapping.get(name, name) for name in self.names))

    def calibrated(self, neutral, clip=True):
        """The take with a resting face taken off, so that rest is 0.

        Nobody's face rests at 0 for a tracker. The resting weights are subtracted, so full weights
        come down by as much.

        Parameters
        ----------
        neutral : int, slice, dict of str to float, or array_like of shape (n_names,)
            Where the face rests: a frame; frames, of which the median counts; or the weights
            themselves, those not named in a dict being 0.
        clip : bool, default=True
            Raise what falls below 0 to 0. Leave it out for shapes that go both ways.

        Returns
        -------
        WeightSequence

        Raises
        ------
        ValueError, TypeError
            For a frame that is lost or not there, names that the sequence does not have, or an
            array of another length.

        Examples
        --------
        >>> take = WeightSequence([[0.1, 0.3], [0.6, 0.2]], ["jawOpen", "mouthClose"], 30)
        >>> take.calibrated(neutral=0).weights.tolist()
        [[0.0, 0.0], [0.5, 0.0]]
        """
        weights = self.weights - self._rest(neutral)
        return replace(self, weights=np.maximum(weights, 0) if clip else weights)

    def _rest(self, neutral):
        if isinstance(neutral, dict):
            unknown = sorted(set(neutral) - set(self.names))
            if unknown:
                raise ValueError(
                    f"neutral names {', '.join(unknown)}, which the sequence does not have; it has "
                    f"{', '.join(self.names)}."
                )
            rest = [check_number(neutral.get(n, 0.0), f"neutral[{n!r}]") for n in self.names]
            return np.array(rest)
        if isinstance(neutral, (int, np.integer)) and not isinstance(neutral, bool):
            frame = check_index(neutral, "neutral", self.n_frames, "frames")
            neutral = slice(frame, frame + 1)
        if isinstance(neutral, slice):
            rest = self.weights[neutral][self.valid[neutral]]
            if not len(rest):
                raise ValueError(
                    f"neutral={neutral}: no frame there, or all of them are lost; choose frames in "
                    "which the face was seen at rest."
                )
            return np.median(rest, axis=0)
        return as_finite(neutral, "neutral", (len(self.names),))

    def smoothed(self, cutoff=6.0, beta=None):
        """The take without jitter: weights and angles filtered, lost frames and gaps left alone.

        Each stretch of frames that follow one another is filtered by itself, nothing across a lost
        frame or a gap.

        Parameters
        ----------
        cutoff : float, default=6.0
            Hertz. What is slower stays, what is faster goes; lower is smoother.
        beta : float, optional
            Left out: a zero-phase low-pass, which looks ahead and is never late. Given: the
            One-Euro filter, as a live stream needs it, which only looks back; `cutoff` is then that
            of a face at rest (1 Hz is usual) and rises by `beta` hertz for each unit of weight a
            second.

        Returns
        -------
        WeightSequence

        Raises
        ------
        ValueError
            For a cut-off that the rate of the take cannot hold.

        References
        ----------
        Casiez, Roussel and Vogel 2012, "1 Euro Filter", CHI (`beta`); see
        `facelab.numeric.filters` for both.
        """
        cutoff = check_number(cutoff, "cutoff", above=0)
        beta = beta if beta is None else check_number(beta, "beta", low=0)
        keep = zero_phase if beta is None else partial(one_euro, beta=beta)
        tracks = [*self.angles.values(), *self.weights.T]
        tracks = np.column_stack(tracks) if tracks else np.empty((self.n_frames, 0))
        for part in self.stretches():
            tracks[part] = keep(tracks[part], self.fps, cutoff)
        n = len(self.angles)
        angles = dict(zip(self.angles, tracks[:, :n].T, strict=True))
        return replace(self, weights=tracks[:, n:], angles=angles)


@dataclass(frozen=True, eq=False)
class MarkerSequence(_Sequence):
    """Positions of named markers in every frame, as a capture system delivers them.

    Parameters
    ----------
    positions : ndarray of shape (n_frames, n_markers, 3)
        Millimetres, in the capture system's frame, head motion included; NaN where a marker was
        occluded, never 0. float32 is kept as it is.
    names : sequence of str
        Name of each marker, each once.
    fps : float
        Frames a second.
    report : object, optional
        What the reader of the file found, printable; stays with every part of the sequence.

    Examples
    --------
    >>> import numpy as np
    >>> from facelab import MarkerSequence
    >>> positions = np.zeros((2, 2, 3))
    >>> positions[1, 0] = np.nan  # the chin was hidden in the second frame
    >>> MarkerSequence(positions, ["chin", "nose_tip"], fps=120).visible.tolist()
    [[True, True], [False, True]]
    """

    positions: np.ndarray
    names: tuple
    fps: float
    report: object = None

    def __post_init__(self):
        names = check_names(self.names)
        shape = f"(n_frames, {len(names)}, 3)"
        positions = as_floats(self.positions, "positions", shape, "an occluded marker has NaN")
        if positions.ndim != 3 or positions.shape[1:] != (len(names), 3):
            raise ValueError(
                f"positions has shape {positions.shape}, but {len(names)} names ask for "
                f"(n_frames, {len(names)}, 3)."
            )
        missing = np.isnan(positions)
        for bad, what in (
            (np.isinf(positions).any(axis=2), "infinite values"),
            (missing.any(axis=2) & ~missing.all(axis=2), "markers seen in part"),
        ):
            if bad.any():
                frame, marker = (int(i) for i in np.argwhere(bad)[0])
                raise ValueError(
                    f"positions holds {what}, {int(bad.sum())} in all, the first is "
                    f"{names[marker]} in frame {frame}; an occluded marker has NaN in x, y and z."
                )
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "fps", check_number(self.fps, "fps", above=0))

    def __repr__(self):
        hidden = 1 - self.visible.mean() if self.positions.size else 0.0
        return (
            f"MarkerSequence({self.n_frames} frames of {self.n_markers} markers, "
            f"{self.fps:g} frames/s, {100 * hidden:.1f} % occluded)"
        )

    @property
    def n_frames(self):
        """Number of frames, those without any marker included."""
        return len(self.positions)

    @property
    def n_markers(self):
        """Number of markers."""
        return len(self.names)

    @property
    def visible(self):
        """True where a marker was seen: ndarray of bool, shape (n_frames, n_markers)."""
        return ~np.isnan(self.positions[..., 0])

    @property
    def valid(self):
        """True where at least one marker was seen: ndarray of bool, shape (n_frames,)."""
        return self.visible.any(axis=1)

    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            raise TypeError("give a slice or an array of frames; positions[i] is a single frame.")
        return replace(self, positions=self.positions[frames])

    def select(self, names):
        """Only the markers named, in the order given.

        Raises
        ------
        ValueError
            For names that the sequence does not have.
        """
        names = check_names(names)
        unknown = sorted(set(names) - set(self.names))
        if unknown:
            raise ValueError(
                f"unknown marker(s) {', '.join(unknown)}; "
                f"this sequence has {', '.join(self.names)}."
            )
        columns = [self.names.index(name) for name in names]
        return replace(self, positions=self.positions[:, columns], names=names)

    def renamed(self, mapping):
        """The same markers under other names.

        Parameters
        ----------
        mapping : dict of str to str
            Old name to new; markers that it does not have keep theirs.

        Raises
        ------
        ValueError
            For names that the sequence does not have, and if two markers would be called the same.
        """
        unknown = sorted(set(mapping) - set(self.names))
        if unknown:
            raise ValueError(
                f"mapping has {', '.join(unknown)}, which are no markers of this sequence; it has "
                f"{', '.join(self.names)}."
            )
        return replace(self, names=tuple(mapping.get(name, name) for name in self.names))

    def with_gaps(self, share, seconds=0.12, random_state=None):
        """The same markers with more of them occluded, in bursts.

        Parameters
        ----------
        share : float
            Of all markers in all frames that is to be missing in the end, 0 to 0.95; those that are
            missing already count. Nothing changes where more are missing than that.
        seconds : float, default=0.12
            How long each is hidden.
        random_state : int or Generator, optional

        Returns
        -------
        MarkerSequence
        """
        share = check_number(share, "share", low=0, high=0.95)
        length = max(1, round(check_number(seconds, "seconds", above=0) * self.fps))
        rng = as_generator(random_state)
        hidden = ~self.visible
        wanted = share * hidden.size
        while (lacking := wanted - hidden.sum()) > 0:
            for _ in range(int(np.ceil(lacking / length))):
                first = rng.integers(1 - length, self.n_frames)
                marker = rng.integers(self.n_markers)
                hidden[max(first, 0) : first + length, marker] = True
        return replace(self, positions=np.where(hidden[..., None], np.nan, self.positions))
