"""Whether landmarks are where their names say: each is judged by all others.

From one face to another, landmarks move as a smooth field does: the size of the head, a strain, a
jaw that is open, and what differs from place to place. Under that Gaussian field each landmark is
foretold by the others (leave-one-out, in closed form), and names that are exchanged, shifted or
far off stand out. When they do, the simplest other naming that makes a face is looked for.
"""

import re
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from facelab.geometry.alignment import check_scale, procrustes, unit_of

LIMIT = 4.0
"""Refused beyond this many standard deviations from where the others put a landmark. Right ones
of 230 random faces stay below 1.9, of 130 expressions below 2, with 1.5 mm of noise below 2.6."""
DOUBTED = 3.0
"""Warned of from here on."""

_SIZE, _REACH, _FOUND = 4.0, 40.0, 2.0  # mm; of what differs; how exactly landmarks are found
_STRAIN, _JAW = 0.1, 15.0  # of the face as a whole; mm that a jaw or a lower lip may go
_STRAINED = 2.0  # standard deviations; right ones stay below 0.9, a mirrored face has 6
_ROUGH = 1.6  # energy; right ones stay below 0.8, mouth and lips exchanged together have 2.3
_SWAPPED = 12.0  # log odds for two names exchanged; right ones stay below 2
_THIN = 1.5  # mm RMS off a plane; those of the middle line have 0, those of both brows alone 1.9
_MOST_GROUPS = 7  # all ways of exchanging the sides of more would take seconds


@dataclass(frozen=True, eq=False)
class Judged:
    """How landmarks lie to each other.

    Parameters
    ----------
    off : ndarray of shape (n,)
        Distance of each from where the others put it, millimetres.
    doubt : ndarray of shape (n,)
        The same in standard deviations of what is usual there.
    strain : float
        Of the face as a whole, in standard deviations of what is usual.
    energy : float
        Of all together under the field, for each coordinate; about 1 where all are as usual.
    expected : ndarray of shape (n, 3)
        Where the others put each, frame of the data.
    swap : tuple (i, j, odds)
        The two that fit best exchanged, and the log odds for it.
    """

    off: np.ndarray = field(repr=False)
    doubt: np.ndarray = field(repr=False)
    strain: float
    energy: float
    expected: np.ndarray = field(repr=False)
    swap: tuple = field(repr=False)

    @property
    def wrong(self):
        """Whether something is: bool."""
        doubt, (_, _, odds) = self.doubt.max(), self.swap
        whole = self.strain > _STRAINED or self.energy > _ROUGH
        return bool(doubt > LIMIT or whole or odds > _SWAPPED)


def _free_jaw(places, names):
    """How far each landmark goes with the lower lip, and with an open jaw: shape (n, 2)."""
    lip = np.array([bool(re.search("lower", n)) and not n.startswith("eye") for n in names])
    jaw = np.array([n.startswith(("jaw", "chin")) for n in names])
    y = places[:, 1]
    low, high = y.min(), np.median(y)
    share = np.clip((high - y) / max(high - low, 1.0), 0, 1) * jaw  # a jaw turns about the ears
    return np.stack([lip, np.maximum(lip, share)], axis=1).astype(float)


def judge(source, target, names):
    """How far each landmark lies from where the others put it.

    Parameters
    ----------
    source : ndarray of shape (n, 3)
        Of a face in its head frame, millimetres.
    target : ndarray of shape (n, 3)
        Of another, any frame, millimetres.
    names : sequence of str

    Returns
    -------
    Judged

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> places = face.vertices[list(face.landmarks.values())]
    >>> moved = places + 0.0
    >>> moved[8] += [0, 0, 40]
    >>> found = judge(places, moved, list(face.landmarks))
    >>> int(found.off.argmax()), bool(abs(found.off[8] - 40) < 1)
    (8, True)
    """
    return _Field(source, names).judge(target)


class _Field:
    """What differs between two faces at the landmarks of one, as a Gaussian field."""

    def __init__(self, source, names):
        self.source, self.x = source, source - source.mean(axis=0)
        self.spread = _spread(source)
        x, jaw = self.x, _free_jaw(source, names)
        K = _SIZE**2 * np.exp(-np.linalg.norm(x[:, None] - x[None], axis=2) / _REACH)
        K += _FOUND**2 * np.eye(len(x)) + 20.0**2
        self.P = np.linalg.inv(K + _STRAIN**2 * x @ x.T + _JAW**2 * jaw @ jaw.T)
        self.own = np.diag(self.P)

    def judge(self, target):
        source, P, own = self.source, self.P, self.own
        scale = self.spread / _spread(target)  # not by pairs: wrong ones would shrink the face
        target = scale * target
        weights = np.ones(len(source))
        for width in (40.0, 20.0, 12.0, 8.0, 8.0):  # Geman-McClure, from wide to narrow
            likeness = procrustes(target, source, weights)
            moved = likeness.apply(target)
            apart = np.linalg.norm(moved - source, axis=1)
            weights = 1 / (1 + (apart / max(width, 1.5 * np.median(apart))) ** 2) ** 2
        # x_i less its mean given the others is (P x)_i / P_ii, its variance 1 / P_ii
        pull = P @ (moved - source)
        left = pull / own[:, None]
        doubt = np.linalg.norm(pull, axis=1) / np.sqrt(3 * own)
        strain = _STRAIN * np.linalg.norm(self.x.T @ pull) / 3  # of the whole, RMS of its nine
        # exchanging i and j adds D (e_i - e_j), D = t_j - t_i, to x: the change of x^T P x
        D = moved[None] - moved[:, None]
        change = 2 * (D * (pull[:, None] - pull[None])).sum(axis=2)
        change += (D**2).sum(axis=2) * (own[:, None] + own[None] - 2 * P)
        i, j = np.unravel_index(change.argmin(), change.shape)
        expected = likeness.inverse().apply(moved - left) / scale
        off = np.linalg.norm(left, axis=1) / scale
        swap = (int(i), int(j), float(-change[i, j] / 2))
        energy = float(((moved - source) * pull).sum() / pull.size)
        return Judged(off, doubt, float(strain), energy, expected, swap)


def check_landmarks(source, target, names, label, normals=None, known=None):
    """Refuse landmarks that cannot be those of a face, by name and with what is wrong.

    Parameters
    ----------
    source, target, names
        As for `judge`.
    label : str
        What the target is, for the message.
    normals : pair of ndarray of shape (n, 3), optional
        Of source and target, if the target is a surface: they tell a mirrored surface from names
        of left and right that are exchanged.
    known : dict of str to ndarray of shape (3,), optional
        Places of all landmarks of the source, for those whose names may have been meant.

    Returns
    -------
    judged : Judged

    Raises
    ------
    ValueError
        For another unit than millimetres, a mirrored face, exchanged sides, names in another
        order, two that are exchanged, and landmarks far from where the others put them.
    """
    spread = [_spread(points) for points in (source, target)]
    if spread[1] <= 1e-9 * max(np.abs(target).max(), 1e-300):
        raise ValueError(f"{label} lie all in one place; give the places of a face.")
    procrustes(target, source)  # refuses what lies on one line
    among = _Field(source, names)
    judged = among.judge(target)
    if not judged.wrong or unit_of(spread[0] / spread[1]):
        check_scale(spread[0] / spread[1], label)
    if not judged.wrong:
        return judged
    known = dict(zip(names, source, strict=True)) if known is None else known
    said = _sides(among, target, names, normals, known) or _order(among, target, names)
    said = said or _few(among, target, names, judged) or _nothing(judged, names)
    raise ValueError(f"{label}: {said}")


def check_spread(source, names, label):
    """Refuse landmarks that lie on one plane, for how wide a face is across it they do not say.

    Parameters
    ----------
    source, names, label
        As for `check_landmarks`.
    """
    off = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(source))
    if off < _THIN:
        shown = ", ".join(names[:8]) + ", ..." * (len(names) > 8)
        raise ValueError(
            f"{label} that are known here ({shown}) lie on one plane, {off:.1f} mm off it on "
            "average, as those of the middle line do: how the face goes across it stays open. Add "
            "landmarks on both sides, such as mouth_corner_left and _right, or look whether those "
            "of the sides are named as in facelab.geometry.MULTI_PIE."
        )


def _spread(points):
    """Median distance between two of some points: whatever their order, and a few far off."""
    i, j = np.triu_indices(len(points), 1)
    return float(np.median(np.linalg.norm(points[i] - points[j], axis=1)))


def _other_side(name):
    return re.sub("left|right", lambda m: {"left": "right", "right": "left"}[m[0]], name)


def _sides(among, target, names, normals, known):
    """Words for exchanged sides, of some parts or of all."""
    sided = [n for n in names if _other_side(n) != n and _other_side(n) in known]
    parts = sorted({n.split("_")[0] for n in sided})

    def exchanged(some):
        """The field of those that are meant if the sides of some parts are exchanged."""
        meant = [_other_side(n) if n in sided and n.split("_")[0] in some else n for n in names]
        return _Field(np.array([known[n] for n in meant]), meant)

    if not among.judge(target * [1, 1, -1]).wrong:
        return _mirror(among.source, target, normals, bool(parts))
    sizes = range(1, len(parts)) if len(parts) <= _MOST_GROUPS else (1, 2, len(parts) - 1)
    for some in (some for size in sizes for some in combinations(parts, size)):
        if not exchanged(some).judge(target).wrong:
            shown = ", ".join(f"{part}_..." for part in some)
            return (
                f"left and right are exchanged in the names of {shown}, while the others are "
                "right. Left and right are the person's, not the viewer's: rename these."
            )
    return None


def _mirror(source, target, normals, sided):
    """Words for data that a reflection brings to the face."""
    if not sided:
        return "mirrored. A reflection fits, and no turn does; negate one axis."
    if normals is None:
        return (
            "mirrored, or left and right are exchanged in all names; a face is so much alike on "
            "both sides that points alone do not tell. If the right eye of the person is called "
            "left, rename (left and right are the person's, not the viewer's); else negate one "
            "axis."
        )
    flip = np.array([1.0, 1.0, -1.0])
    turn = procrustes(target * flip, source, scale=True).rotation
    # of a surface in a mirror with its triangles as they are, the normals point inwards
    inwards = (-(normals[1] * flip) @ turn.T * normals[0]).sum()
    if inwards > 0:
        return (
            "mirrored. A reflection fits, and no turn does, and the surface is wound inwards, as "
            "when one axis is negated: negate it back."
        )
    return (
        "left and right are exchanged in all names (or the whole scan is mirrored and wound "
        "anew, which looks the same). Left and right are the person's, not the viewer's: rename "
        "the landmarks."
    )


def _order(among, target, names):
    """Words for names that are all there, in another order."""
    n = len(names)
    ways = [
        (np.roll(np.arange(n)[:: -1 if back else 1], by), by, back)
        for back in (False, True)
        for by in range(0 if back else 1, n)
    ]
    # the distances between the places decide which is looked at: no order changes them
    apart = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (among.source, target)]
    apart[1] *= among.spread / _spread(target)
    off = [np.median(np.abs(apart[1][np.ix_(o, o)] - apart[0])) for o, _, _ in ways]
    for k in np.argsort(off)[:3]:
        order, by, back = ways[k]
        kept = np.arange(n)
        lost = 2 * min(by, n - by)
        if not back and lost <= n // 3:  # among more names, what falls off is no landmark
            kept = kept[lost:] if by < n - by else kept[:-lost]
        some = _Field(among.source[kept], [names[i] for i in kept])
        if not some.judge(target[order[kept]]).wrong:
            i = kept[0]
            if back:
                how = "backwards" + (f" and shifted by {by}" if by else "")
            else:
                how = f"shifted by {min(by, n - by)} place(s)"
            return (
                f"the names are in another order than the places, {how}: the place called "
                f"{names[order[i]]} is that of {names[i]}, and so on. Name them in their order."
            )
    return None


def _few(among, target, names, judged):
    """Words for a few that are wrong among many that are right."""
    source = among.source
    i, j, odds = judged.swap
    if odds > _SWAPPED:
        order = np.arange(len(names))
        order[[i, j]] = j, i
        if not among.judge(target[order]).wrong:
            apart = np.linalg.norm(target[i] - target[j])
            return (
                f"the names {names[i]} ({judged.off[i]:.0f} mm) and {names[j]} "
                f"({judged.off[j]:.0f} mm) are exchanged: each lies where the others put the "
                f"other one, {apart:.0f} mm away. Exchange them."
            )
    kept, gone = np.arange(len(names)), []
    while judged.wrong:
        if len(gone) >= max(len(names) // 3, 1) or len(kept) <= 5:
            return None
        i, j, odds = judged.swap
        if judged.doubt.max() <= LIMIT and odds <= _SWAPPED:
            return None  # it is the whole that is strained
        worst = [judged.doubt.argmax()] if judged.doubt.max() > LIMIT else [i, j]
        gone += kept[worst].tolist()
        kept = np.delete(kept, worst)
        judged = judge(source[kept], target[kept], [names[k] for k in kept])
    said = []
    for k in gone:  # judged by those that are right alone
        some = np.append(kept, k)
        alone = judge(source[some], target[some], [names[m] for m in some])
        said.append((alone.off[-1], names[k], alone.expected[-1], target[k]))
    shown = ", ".join(f"{name} ({off:.0f} mm)" for off, name, _, _ in sorted(said, reverse=True))
    places = np.array([place for *_, place in said])
    instead = []
    for off, name, expected, _ in said:
        near = np.linalg.norm(places - expected, axis=1)
        if near.min() < min(10.0, off / 2):
            instead.append(f"{name} seems to be the place called {said[near.argmin()][1]}")
    hint = f" {'; '.join(instead)}." if instead else ""
    return (
        f"{shown} lie(s) far from where the others put the landmark.{hint} Check the name(s) or "
        "leave them out."
    )


def _nothing(judged, names):
    if judged.doubt.max() <= LIMIT:
        return (
            "the landmarks fit no face: as a whole they are flattened, stretched or sheared as no "
            "face is; look whether all three coordinates were read, in one unit."
        )
    worst = np.argsort(judged.off)[::-1][:4]
    shown = ", ".join(f"{names[i]} ({judged.off[i]:.0f} mm)" for i in worst)
    return (
        f"the names fit no face. {int((judged.doubt > LIMIT).sum())} of the {len(names)} "
        f"landmarks lie far from where the others put them, first of all {shown}. They are in "
        "another order, of another list, or not on a face; see facelab.geometry.MULTI_PIE."
    )
