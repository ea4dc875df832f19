"""Rigid and similarity Procrustes: where the head is, apart from what the face does.

Lengths are millimetres. A motion has no scale; a reflection is noticed, never fitted.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from facelab.checks import as_finite, as_numbers

_UNITS = {
    1000.0: "metres",
    304.8: "feet",
    100.0: "decimetres",
    25.4: "inches",
    10.0: "centimetres",
    0.1: "tenths of a millimetre",
    0.001: "micrometres",
}
_FLAT = 1.0  # mm; points nearer to one line than this leave the turn about it open

_WIDTHS = (8.0, 4.0, 2.0, 1.0, 1.0)  # from wide to narrow, so that a poor start does no harm


@dataclass(frozen=True, eq=False)
class Alignment:
    """A turn, a shift and, if asked for, a scale: x goes to `scale * rotation @ x + translation`.

    Parameters
    ----------
    rotation : ndarray of shape (3, 3)
        Determinant +1.
    translation : ndarray of shape (3,)
        Millimetres.
    scale : float
        1 for a motion.
    rms : float
        Root mean squared distance that it leaves, millimetres.
    mirrored : bool
        Whether a reflection would leave less than half of that: the data are left-handed.
    """

    rotation: np.ndarray
    translation: np.ndarray
    scale: float = 1.0
    rms: float = 0.0
    mirrored: bool = False

    def apply(self, points):
        """The points moved: shape (..., 3), millimetres."""
        return self.scale * np.asarray(points) @ self.rotation.T + self.translation

    def travel(self, points):
        """How far it moves the points: root mean squared distance, millimetres."""
        return float(np.sqrt(((self.apply(points) - points) ** 2).sum(axis=-1).mean()))

    @property
    def degrees(self):
        """Angle of the turn."""
        return float(np.degrees(Rotation.from_matrix(self.rotation).magnitude()))

    def inverse(self):
        """The alignment that takes everything back."""
        R, s = self.rotation.T, 1 / self.scale
        return Alignment(R, -s * R @ self.translation, s, s * self.rms, self.mirrored)


@dataclass(frozen=True, eq=False)
class HeadMotion:
    """The head in every frame: x of the reference is seen at `rotation @ x + translation`.

    Parameters
    ----------
    rotation : ndarray of shape (n_frames, 3, 3)
        Determinant +1; NaN in lost frames.
    translation : ndarray of shape (n_frames, 3)
        Millimetres; NaN in lost frames.
    rms : ndarray of shape (n_frames,)
        What the weighted points leave, millimetres.
    valid : ndarray of bool, shape (n_frames,)
        False where fewer than three points, or points on one line, were seen.
    weights : ndarray of shape (n_points,)
        Share of each point, 1 for the most rigid.
    """

    rotation: np.ndarray = field(repr=False)
    translation: np.ndarray = field(repr=False)
    rms: np.ndarray = field(repr=False)
    valid: np.ndarray = field(repr=False)
    weights: np.ndarray = field(repr=False)

    def to_head(self, positions):
        """Positions (n_frames, n, 3) of the capture in the frame of the head, millimetres."""
        return np.matmul(positions - self.translation[:, None], self.rotation)

    def to_capture(self, positions):
        """Positions (n_frames, n, 3) of the head frame as the capture saw them, millimetres."""
        turned = np.matmul(positions, np.swapaxes(self.rotation, -1, -2))
        return turned + self.translation[:, None]


def _kabsch(source, target, weights):
    """Best turns for a stack of problems, by SVD.

    Takes source (n, 3), target (..., n, 3) and weights (..., n); gives rotation (..., 3, 3), both
    means (..., 3) and the signed singular values (..., 3).
    """
    total = weights.sum(axis=-1)[..., None]
    mean_s = weights @ source / total
    mean_t = np.matmul(weights[..., None, :], target)[..., 0, :] / total
    pull = weights[..., None] * (target - mean_t[..., None, :])  # its sum is 0: source may stay
    # sum w |t - R s|^2 is least where trace(R^T C) is largest, C = sum w t s^T = U S V^T: R = U V^T
    U, S, Vt = np.linalg.svd(np.matmul(np.swapaxes(pull, -1, -2), source))
    sign = np.where(np.linalg.det(U) * np.linalg.det(Vt) < 0, -1.0, 1.0)
    U[..., 2] *= sign[..., None]  # the weakest direction gives way: still the best turn
    S[..., 2] *= sign
    return np.matmul(U, Vt), mean_s, mean_t, S


def _thickness(points, weights):
    """Spread of points (..., n, 3) across their best line, mm: two or one directions are 0."""
    total = weights.sum(axis=-1)[..., None]
    mean = np.matmul(weights[..., None, :], points)[..., 0, :] / total
    p = points - mean[..., None, :]
    S = np.linalg.eigvalsh(np.matmul(np.swapaxes(weights[..., None] * p, -1, -2), p))
    return np.sqrt(np.maximum(S[..., 1], 0) / total[..., 0])


def _check_points(points, name, shape):
    points = as_numbers(points, name, str(shape), "mark points not seen with NaN")
    if points.ndim != len(shape) or any(
        isinstance(n, int) and n != m for n, m in zip(shape, points.shape, strict=False)
    ):
        raise ValueError(f"{name} has shape {points.shape}, but needs {shape}.")
    if np.isinf(points).any():
        raise ValueError(f"{name} holds infinite values; mark points not seen with NaN.")
    return points


def _check_weights(weights, n):
    if weights is None:
        return np.ones(n)
    weights = as_finite(weights, "weights", (n,))
    if (weights < 0).any() or not (weights > 0).any():
        raise ValueError(
            f"weights holds {weights.min():g} to {weights.max():g}; give 0 or more, some above 0."
        )
    return weights


def procrustes(source, target, weights=None, scale=False):
    """The turn and shift, and the scale if wanted, that bring points closest to others.

    Parameters
    ----------
    source, target : array_like of shape (n_points, 3)
        Pairs, millimetres; a pair with NaN was not seen and takes no part.
    weights : array_like of shape (n_points,), optional
        Of the squared distances, 0 or more.
    scale : bool, default=False
        Whether size may change; never for motion.

    Returns
    -------
    Alignment
        From source to target; its rotation has determinant +1 and is the best of all such.

    Raises
    ------
    ValueError
        For unlike shapes, fewer than three pairs, or points on one line.

    References
    ----------
    Dryden and Mardia, Statistical Shape Analysis, 2002; Umeyama 1991 for the sign.
    """
    source = _check_points(source, "source", ("n_points", 3))
    target = _check_points(target, "target", source.shape)
    weights = _check_weights(weights, len(source))
    seen = np.isfinite(source + target).all(axis=1) & (weights > 0)
    s, t, w = source[seen], target[seen], weights[seen]
    if len(s) < 3:
        raise ValueError(f"{len(s)} pair(s) of points have both ends; a turn needs 3 or more.")
    extent = np.sqrt((w @ ((s - np.average(s, 0, w)) ** 2).sum(1)) / w.sum())
    if _thickness(s, w) <= 1e-6 * extent or extent == 0:
        raise ValueError(
            f"the {len(s)} points of source lie on one line, so the turn about it is open; add "
            "a point beside it."
        )
    middle = np.average(s, 0, w)
    R, mean_s, mean_t, S = _kabsch(s - middle, t, w)
    mean_s = mean_s + middle
    size_s, size_t = (w @ ((p - m) ** 2).sum(axis=1) for p, m in ((s, mean_s), (t, mean_t)))
    # the same sum as a parabola of the scale f: size_t - 2 f trace(S) + f^2 size_s
    factor = float(S.sum() / size_s) if scale else 1.0

    def left(S):  # weighted squares that are left with singular values S
        if scale:
            return size_t - max(S.sum(), 0) ** 2 / size_s
        return size_s + size_t - 2 * S.sum()

    rms = np.sqrt(max(left(S), 0) / w.sum())
    turned_over = np.sqrt(max(left(S * [1, 1, -1]), 0) / w.sum())
    mirrored = turned_over < 0.5 * rms and rms > 1e-6 * extent
    return Alignment(R, mean_t - factor * R @ mean_s, factor, float(rms), bool(mirrored))


def rigid_motion(positions, reference, weights=None, robust=False, scale=1.0):
    """The motion of the head in every frame, without scale.

    Parameters
    ----------
    positions : array_like of shape (n_frames, n_points, 3)
        Millimetres; NaN where a point was not seen.
    reference : array_like of shape (n_points, 3)
        The points at rest, millimetres; a point that is NaN takes no part.
    weights : array_like of shape (n_points,), optional
        Share of each point; all alike is ordinary Procrustes, as in the paper.
    robust : bool, default=False
        Whether points that disagree with the rest of their frame lose their say
        (Geman-McClure).
    scale : float, default=1.0
        Distance at which a point has a quarter of its say left, millimetres.

    Returns
    -------
    HeadMotion

    Raises
    ------
    ValueError
        For shapes that do not match or weights below 0.

    References
    ----------
    Tena et al. 2011, section 4.1. Weights and robustness are ours: on the whole face the paper's
    way moves with the expression.
    """
    reference = _check_points(reference, "reference", ("n_points", 3))
    positions = _check_points(positions, "positions", ("n_frames", *reference.shape))
    shares = _check_weights(weights, len(reference))
    there = np.isfinite(reference).all(axis=1)
    middle = reference[there].mean(axis=0) if there.any() else np.zeros(3)
    seen = np.isfinite(positions).all(axis=2) & there
    known = np.nan_to_num(reference - middle)
    W = shares * seen
    valid = (W > 0).sum(axis=1) >= 3
    valid[valid] = _thickness(known, W[valid]) > _FLAT
    n_frames = len(positions)
    R, shift = np.full((n_frames, 3, 3), np.nan), np.full((n_frames, 3), np.nan)
    rms = np.full(n_frames, np.nan)
    target, W = np.nan_to_num(positions[valid]), W[valid]
    w, rounds = W, len(_WIDTHS) if robust else 0
    for again in range(rounds + 1):
        turn, mean_s, mean_t, _ = _kabsch(known, target, w)
        place = mean_t - np.matmul(turn, mean_s[..., None])[..., 0]
        off = target - np.matmul(known, np.swapaxes(turn, -1, -2))
        off -= place[:, None]
        off = np.einsum("fmx,fmx->fm", off, off)
        if again < rounds:  # rho(d) = d^2 / (1 + d^2 / s^2), whose weight is (1 + d^2 / s^2)^-2
            w = W / (1 + off / (scale * _WIDTHS[again]) ** 2) ** 2
    rms[valid] = np.sqrt((w * off).sum(axis=1) / w.sum(axis=1))
    R[valid], shift[valid] = turn, place - turn @ middle
    return HeadMotion(R, shift, rms, valid, shares / shares.max())


def rigid_weights(positions, reference, floor=0.5, rounds=4):
    """How rigidly each point moves with the head over a take: weights for `rigid_motion`.

    Points are weighed by how little they move once the head's motion is taken away, found in
    turns with that motion: over a take the forehead and the nose stay, the mouth does not.

    Parameters
    ----------
    positions : array_like of shape (n_frames, n_points, 3)
        Millimetres, NaN where not seen.
    reference : array_like of shape (n_points, 3)
        At rest, millimetres.
    floor : float, default=0.5
        Motion below this is taken for noise, millimetres.
    rounds : int, default=4

    Returns
    -------
    weights : ndarray of shape (n_points,)
        1 for the most rigid point, 0 for one that is never seen.
    """
    weights = np.isfinite(np.asarray(reference)).all(axis=1).astype(float)
    for _ in range(rounds):
        motion = rigid_motion(positions, reference, weights, robust=True)
        at_home = motion.to_head(np.asarray(positions, dtype=float))
        off = ((at_home - reference) ** 2).sum(axis=2)
        seen = np.isfinite(off)
        mean = np.where(seen, off, 0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        weights = np.where(seen.any(axis=0), 1 / (floor**2 + mean) ** 2, 0.0)
        if not weights.any():
            return np.isfinite(np.asarray(reference)).all(axis=1).astype(float)
        weights /= weights.max()
    return weights


def check_like(alignment, name):
    """Refuse data that a similarity shows to be mirrored or in other units than millimetres.

    Parameters
    ----------
    alignment : Alignment
        Of the data to a face in millimetres, found with `scale=True`.
    name : str
        What the data are, for the message.

    Raises
    ------
    ValueError
        If a reflection fits far better, or if the data are less than half or more than twice
        as large as the face.
    """
    if alignment.mirrored:
        raise ValueError(
            f"{name}: mirrored. A reflection fits far better than any turn (left over "
            f"{alignment.rms:.1f} mm). Negate one axis, or check whether names of left and right "
            "are exchanged."
        )
    check_scale(alignment.scale, name)


def unit_of(scale):
    """The unit of lengths in which a face is so much smaller than in millimetres, or None.

    Parameters
    ----------
    scale : float
        How much larger a face in millimetres is than the data.

    Returns
    -------
    (factor, name) : (float, str), or None
        Lengths times the factor are millimetres. None if no unit is near.

    Examples
    --------
    >>> unit_of(950.0)
    (1000.0, 'metres')
    """
    near = min(_UNITS, key=lambda u: abs(np.log(scale / u)))
    return (near, _UNITS[near]) if abs(np.log(scale / near)) < 0.3 else None


def check_scale(scale, name):
    """Refuse data in other units than millimetres.

    Parameters
    ----------
    scale : float
        How much larger a face in millimetres is than the data.
    name : str
        What the data are, for the message.

    Raises
    ------
    ValueError
        If the data are less than half or more than twice as large as the face, with the factor
        that makes them millimetres.
    """
    if 0.5 <= scale <= 2:
        return
    unit = unit_of(scale)
    guess = "Scale it to millimetres first."
    if unit:
        guess = f"It looks like {unit[1]}: multiply by {unit[0]:g}."
    raise ValueError(
        f"{name}: {1 / scale:.4g} times the size of the face; millimetres are needed. {guess}"
    )
