"""Sequences in time: positions of a mesh or of markers, weights of a rig. Arrays with names."""

from dataclasses import dataclass, field, replace

import numpy as np

from facelab.checks import as_finite, check_number
from facelab.geometry.mesh import TriangleMesh


def _valid_mask(valid, n_frames):
    valid = np.ones(n_frames, dtype=bool) if valid is None else np.asarray(valid)
    if valid.shape != (n_frames,) or valid.dtype != bool:
        raise ValueError(
            f"valid has shape {valid.shape} and type {valid.dtype}, but needs one bool for each of "
            f"the {n_frames} frames."
        )
    return valid


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
        Millimetres, head frame, head motion removed; float32 is kept as it is.
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
        positions = np.asarray(self.positions)
        wanted = (self.mesh.n_vertices, 3)
        if positions.ndim != 3 or positions.shape[1:] != wanted:
            raise ValueError(
                f"positions has shape {positions.shape}, but the mesh asks for "
                f"(n_frames, {wanted[0]}, 3)."
            )
        if positions.dtype.kind != "f":
            positions = positions.astype(float)
        valid = _valid_mask(self.valid, len(positions))
        bad = valid & ~np.isfinite(positions).all(axis=(1, 2))
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
        noise = np.random.default_rng(random_state).normal(scale=sigma, size=self.positions.shape)
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

    def __post_init__(self):
        names = tuple(self.names)
        weights = np.asarray(self.weights, dtype=float)
        if weights.ndim != 2 or weights.shape[1] != len(names):
            raise ValueError(
                f"weights has shape {weights.shape}, but {len(names)} names ask for "
                f"(n_frames, {len(names)})."
            )
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names holds {', '.join(twice)} more than once; each needs its own.")
        valid = _valid_mask(self.valid, len(weights))
        as_finite(weights[valid], "weights", ("n_frames", len(names)), "valid frames")
        angles = {name: np.asarray(angle, dtype=float) for name, angle in self.angles.items()}
        for name, angle in angles.items():
            if angle.shape != valid.shape:
                raise ValueError(
                    f"angles[{name!r}] has shape {angle.shape}, but there are {len(valid)} frames."
                )
            as_finite(angle[valid], f"angles[{name!r}]", (int(valid.sum()),), "valid frames")
        object.__setattr__(self, "angles", angles)
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "valid", valid)
        object.__setattr__(self, "fps", check_number(self.fps, "fps", above=0))

    def __repr__(self):
        return (
            f"WeightSequence({self.n_frames} frames of {len(self.names)} weights, "
            f"{self.fps:g} frames/s, {int((~self.valid).sum())} lost)"
        )

    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            raise TypeError("give a slice or an array of frames; weights[i] is a single frame.")
        return replace(
            self,
            weights=self.weights[frames],
            valid=self.valid[frames],
            angles={k: a[frames] for k, a in self.angles.items()},
        )


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
        names = tuple(self.names)
        positions = np.asarray(self.positions)
        if positions.ndim != 3 or positions.shape[1:] != (len(names), 3):
            raise ValueError(
                f"positions has shape {positions.shape}, but {len(names)} names ask for "
                f"(n_frames, {len(names)}, 3)."
            )
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"names holds {', '.join(twice)} more than once; each needs its own.")
        if positions.dtype.kind != "f":
            positions = positions.astype(float)
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
        names = tuple(names)
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
        rng = np.random.default_rng(random_state)
        hidden = ~self.visible
        wanted = share * hidden.size
        while (lacking := wanted - hidden.sum()) > 0:
            for _ in range(int(np.ceil(lacking / length))):
                first = rng.integers(1 - length, self.n_frames)
                marker = rng.integers(self.n_markers)
                hidden[max(first, 0) : first + length, marker] = True
        return replace(self, positions=np.where(hidden[..., None], np.nan, self.positions))
