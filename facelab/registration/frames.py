"""Frames judged one by one: is this the face at all?

A frame of zeros, of noise, mirrored, in another unit or with its names exchanged still has a best
rigid motion, and would go on to the dense face. What true frames look like is learned from the
take itself: how far each marker usually is from its place at rest, and how long the distances
between the most rigid markers are.
"""

from typing import NamedTuple

import numpy as np

from facelab.geometry.alignment import check_like, procrustes, rigid_motion, rigid_weights
from facelab.numeric.quantiles import nan_quantile

REASONS = (
    "",
    "fewer than three markers",
    "markers on one line",
    "all markers in one point",
    "mirrored",
    "{:.3g} times the size of the face",
    "markers {:.3g} mm from their places",
    "{:.0f} % of its markers are strays",
)
"""Why a frame is not believed, in the order of `Frames.why`; {} is the number that goes with it."""

FEW, LINE, POINT, MIRRORED, SIZE, PLACES, STRAYS = range(1, 8)

_SIZE = 0.12  # of the logarithm; jaw fully open, the rigid parts of a face change by 0.03
_FAR = 4.0  # face radii from the middle of the frame: no marker of it, not even a stray one
_ANYWHERE = 1e8  # mm from the origin; no capture volume is that large
_TRUE = 0.97  # of the samples of each marker, by which its rigidity is judged
_SAMPLE = 400  # frames that a take is learned from


class Frames(NamedTuple):
    """Some frames, judged."""

    head: object
    """HeadMotion; NaN in frames that are not believed."""
    moved: np.ndarray
    """Displacements from rest, head frame, mm: (n_frames, n_markers, 3); NaN where not seen."""
    why: np.ndarray
    """What is wrong with each frame, 0 for nothing: an index of REASONS."""
    amount: np.ndarray
    """The number that goes with the reason."""
    far: np.ndarray
    """Markers so far from the others that they were left out: bool, (n_frames, n_markers)."""
    distance: np.ndarray
    """How far each of those is from the middle of its frame, in their order: mm."""


class FrameJudge:
    """What frames of a layout look like in a take.

    Parameters
    ----------
    rest : ndarray of shape (n_markers, 3)
        The markers at rest, head frame, millimetres.
    positions : callable
        Frames of the take by their numbers: (n, n_markers, 3), mm, NaN where not seen.
    n_frames : int

    Attributes
    ----------
    weights : ndarray of shape (n_markers,)
        How rigidly each moves with the head, see `rigid_weights`.
    usual : ndarray of shape (n_markers,)
        How far each is from its place at rest in 95 % of the true frames, mm.

    Raises
    ------
    ValueError
        If no frame looked at is one of this layout: it is then wrong all through, and said how.
    """

    def __init__(self, rest, positions, n_frames):
        self.rest = rest
        self.radius = float(np.linalg.norm(rest - rest.mean(axis=0), axis=1).max())
        picked = np.unique(np.linspace(0, n_frames - 1, min(n_frames, _SAMPLE)).astype(int))
        given = positions(picked)
        some, _, _ = self._near(given)
        self._choose_pairs(np.ones(len(rest)), 12)
        good = ~self._resized(some) & (np.isfinite(some[..., 0]).sum(axis=1) >= 3)
        motion = rigid_motion(some[good], rest, robust=True)
        off = np.linalg.norm(motion.to_head(some[good]) - rest, axis=2)
        seen = np.isfinite(off)
        near = seen & (off < 0.15 * self.radius)
        alike = motion.valid & (2 * near.sum(axis=1) > seen.sum(axis=1))
        if not alike.any():
            _refuse(given, rest, n_frames)
        some, off = some[good][alike], off[alike]
        # strays must not make a marker look loose
        beyond = off > self._most(off, _TRUE)
        self.weights = rigid_weights(np.where(beyond[..., None], np.nan, some), rest)
        self._choose_pairs(self.weights, min(12, max(4, len(rest) // 2)))
        motion = rigid_motion(some, rest, self.weights, robust=True)
        self.usual = self._most(np.linalg.norm(motion.to_head(some) - rest, axis=2), 0.95)

    def _most(self, off, share):
        """The distance below which each marker is in so many frames; a face's if never seen."""
        known = np.isfinite(off).any(axis=0)
        most = np.full(off.shape[1], self.radius)
        most[known] = nan_quantile(off[:, known], share)
        return most

    def _choose_pairs(self, weights, least, most=150):
        """Pairs of the most rigid markers, far enough apart to tell the size of a frame."""
        top = np.sort(np.argsort(-weights, kind="stable")[: max(least, len(weights) // 3)])
        a, b = (top[i] for i in np.triu_indices(len(top), 1))
        apart = np.linalg.norm(self.rest[a] - self.rest[b], axis=1)
        wide = np.flatnonzero(apart > 0.3 * self.radius)
        wide = wide[np.linspace(0, len(wide) - 1, min(most, len(wide))).astype(int)]
        self._pairs = a[wide], b[wide], apart[wide] ** 2

    def _resized(self, positions):
        """Frames in which most distances between rigid markers are not those at rest: bool."""
        a, b, square = self._pairs
        ratio = ((positions[:, a] - positions[:, b]) ** 2).sum(axis=2) / square
        wrong = (ratio < np.exp(-2 * _SIZE)) | (ratio > np.exp(2 * _SIZE))  # not where NaN
        count = np.isfinite(ratio).sum(axis=1)
        return (count >= 6) & (2 * wrong.sum(axis=1) > count)

    def _near(self, positions):
        """The frames with markers out of all proportion set to NaN; those; and how far they are."""
        ordered = np.sort(positions, axis=1)  # NaN comes last
        seen = np.isfinite(positions[..., 0])
        middle = np.maximum(seen.sum(axis=1) - 1, 0) // 2
        centre = np.take_along_axis(ordered, middle[:, None, None], axis=1)
        with np.errstate(over="ignore"):  # of two numbers near the largest there is
            off = np.abs(positions - centre).max(axis=2)
            far = (off > _FAR * self.radius) | (np.abs(positions).max(axis=2) > _ANYWHERE)
        return np.where(far[..., None], np.nan, positions), far, off[far]

    def judge(self, positions):
        """Head motion and displacements of some frames, and which of them are none of this face.

        Parameters
        ----------
        positions : ndarray of shape (n_frames, n_markers, 3)
            Capture frame, millimetres; NaN where not seen.

        Returns
        -------
        Frames
        """
        near, far, distance = self._near(positions)
        count = np.isfinite(positions[..., 0]).sum(axis=1)
        motion = rigid_motion(near, self.rest, self.weights, robust=True)
        moved = motion.to_head(near) - self.rest
        share = np.sqrt(self.weights)
        out = self._out_of_place(moved, share)
        again = np.flatnonzero(out)
        if again.size:  # a stray may lead the head where few of the rigid markers are seen
            even = np.maximum(share, 0.3)
            other = rigid_motion(near[again], self.rest, even, robust=True)
            instead = other.to_head(near[again]) - self.rest
            right = ~self._out_of_place(instead, even)
            out[again[right]], moved[again[right]] = False, instead[right]
            for name in ("rotation", "translation", "rms"):
                getattr(motion, name)[again[right]] = getattr(other, name)[right]
        why = np.zeros(len(near), dtype=np.int8)
        amount = np.zeros(len(near))
        scattered = 3 * far.sum(axis=1) > count
        why[~motion.valid & ~scattered] = LINE
        why[count < 3] = FEW
        suspect = (why != FEW) & (out | scattered | self._resized(near) | (why == LINE))
        for frame in np.flatnonzero(suspect):
            given = positions if scattered[frame] else near
            why[frame], amount[frame] = self._reason(given[frame], why[frame])
        moved[why > 0] = np.nan
        for part in (motion.rotation, motion.translation, motion.rms):
            part[why > 0] = np.nan
        motion.valid[:] = why == 0
        distance = distance[why[np.nonzero(far)[0]] == 0]
        return Frames(motion, moved, why, amount, far & (why == 0)[:, None], distance)

    def _out_of_place(self, moved, share):
        """Frames most of which is farther from rest than usual, counted by share: bool."""
        seen = np.isfinite(moved[..., 0])
        square = np.einsum("fmx,fmx->fm", moved, moved)
        beyond = square > (1.2 * (self.usual + 2)) ** 2  # not where NaN
        return 2 * (share * beyond).sum(axis=1) > (share * seen).sum(axis=1)

    def _reason(self, frame, known):
        """What a frame that is out of place looks like: index of REASONS and a number."""
        seen = np.isfinite(frame[:, 0])
        largest = np.abs(frame[seen]).max()
        unit = max(largest / 1e3, 1.0)  # so that squares of it can be taken
        scaled = frame / unit
        extent = unit * np.ptp(scaled[seen], axis=0).max()
        if extent < 1e-6 * self.radius:
            return POINT, 0.0
        if known == LINE or _flat(scaled[seen]) or _flat(self.rest[seen]):
            return LINE, 0.0
        like = procrustes(self.rest, scaled, scale=True)  # to the frame, whatever its size
        size = unit * like.scale
        left = like.rms / max(like.scale, 1e-300)  # on the scale of the face
        if like.mirrored:
            return MIRRORED, 0.0
        spread = np.sqrt(self.rest[seen].var(axis=0).sum())
        if left < 0.3 * spread and abs(np.log(size)) > 0.75 * _SIZE:
            return SIZE, size
        rigid = procrustes(self.rest, scaled) if unit == 1 else None
        return PLACES, float(rigid.rms if rigid else extent)


def _flat(points):
    """Whether points are on one line."""
    across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return across[1] < 1e-3 * across[0]


def _refuse(some, rest, n_frames):
    """Say what is wrong with a take in which no frame looked at shows the layout."""
    best = some[np.isfinite(some[..., 0]).sum(axis=1).argmax()]
    if not rigid_motion(0 * best[None], rest).valid[0]:  # by which markers are seen
        raise ValueError(
            f"none of the {n_frames} frames has three markers that are not on one line; "
            "check that the take shows this layout."
        )
    if np.ptp(best[np.isfinite(best[:, 0])], axis=0).max() == 0:
        raise ValueError(
            "all markers of the take are in one point; check what the capture system wrote for "
            "markers that it did not see."
        )
    unit = max(np.nanmax(np.abs(best)) / 1e9, 1.0)
    likeness = procrustes(best / unit, rest, scale=True)
    spread = np.sqrt(rest.var(axis=0).sum())
    if likeness.rms > 0.3 * spread and not likeness.mirrored:
        raise ValueError(
            f"the markers of the take lie {likeness.rms:.0f} mm from their places at rest, so they "
            "are named by another layout; fit the neutral of the same actor and session."
        )
    check_like(likeness, "the take")
    raise ValueError(
        f"the take: {1 / likeness.scale:.3g} times the size of the face that was fitted, and its "
        f"markers {likeness.rms:.1f} mm from their places; fit the neutral of the same actor and "
        "session, or scale the take."
    )
