"""The markers of a face at rest, from takes that begin with it: one face, or refused."""

import warnings
from collections.abc import Iterable

import numpy as np
from scipy.spatial.distance import pdist

from facelab.checks import check_number, check_type
from facelab.geometry.alignment import check_scale, procrustes, rigid_motion, unit_of
from facelab.geometry.size import face_scale
from facelab.motion import MarkerSequence
from facelab.numeric.quantiles import nan_quantile

_ALIKE = 3.0  # mm; two takes of one session begin 0.2 to 0.7 mm apart, in the median of markers
_OTHER = 0.2  # of the face's own spread: these are other markers, or in another unit


def rest_markers(takes, seconds=0.05):
    """The markers of a face at rest, from takes that begin with it.

    Parameters
    ----------
    takes : MarkerSequence or sequence of MarkerSequence
        Of one actor in one session.
    seconds : float, default=0.05
        How long the face is at rest at the start of each.

    Returns
    -------
    positions : ndarray of shape (n_markers, 3)
        Median over those frames with the head's motion taken away, millimetres, in the frame of
        the first; NaN for a marker never seen in them.
    names : tuple of str
        Of the markers that are seen in a quarter of all frames or more; the others are ghosts.

    Raises
    ------
    TypeError
        If `takes` are no takes of markers.
    ValueError
        If fewer than three markers are seen often enough, if none of the takes starts with three,
        or if a take starts with other markers than the rest, mirrored or in another unit.

    Warns
    -----
    UserWarning
        For a take that starts with another face than the rest, and for more than one in twenty
        markers that are not seen at rest.

    Examples
    --------
    >>> import facelab
    >>> capture = facelab.data.load_capture("M1", size="small", progress=False)
    >>> positions, names = rest_markers([capture.markers("pride_1"), capture.markers("rage_1")])
    >>> positions.shape == (len(names), 3)
    True
    """
    several = isinstance(takes, Iterable) and not isinstance(takes, (MarkerSequence, str))
    takes = list(takes) if several else [takes]
    seconds = check_number(seconds, "seconds", low=0)
    for i, take in enumerate(takes):
        check_type(take, f"takes[{i}]", MarkerSequence, "read it with facelab.read_markers")
    if not any(take.n_frames for take in takes):
        raise ValueError("takes is empty; give one sequence of markers or more, with frames.")
    names = _often_seen(takes)
    frames = [_beginning(take, names, seconds) for take in takes]
    best = max(range(len(takes)), key=lambda i: _seen(frames[i]).sum(axis=1).max(initial=0))
    reference = frames[best][_seen(frames[best]).sum(axis=1).argmax()]
    for i, some in enumerate(frames):
        _check_same_face(some, reference, f"takes[{i}]", f"takes[{best}]")
    frames = np.concatenate(frames)
    for _ in range(2):
        motion = rigid_motion(frames, reference, robust=True)
        if not motion.valid.any():
            raise ValueError(
                f"the first {seconds:g} s hold no frame with three markers or more that are not "
                f"on one line; {_remedy(reference)}."
            )
        home = motion.to_head(frames)
        seen = np.isfinite(home[..., 0]).any(axis=0)
        reference = np.full(reference.shape, np.nan)
        reference[seen] = nan_quantile(home[:, seen], 0.5)
    hidden = [name for name, here in zip(names, seen, strict=True) if not here]
    if 20 * len(hidden) > len(names):
        warnings.warn(
            f"takes: {len(hidden)} of {len(names)} markers are not seen in the first {seconds:g} s "
            f"of any take and have no place at rest: {', '.join(hidden[:6])}"
            f"{', ...' * (len(hidden) > 6)}. A fit leaves them out. Give longer seconds, or takes "
            "that begin with all markers in view.",
            stacklevel=2,
        )
    return reference, names


def _often_seen(takes):
    """Names of the markers that are seen in a quarter of all frames or more."""
    seen = dict.fromkeys((name for take in takes for name in take.names), 0)
    for take in takes:
        for name, count in zip(take.names, take.visible.sum(axis=0), strict=True):
            seen[name] += count
    n_frames = sum(take.n_frames for take in takes)
    names = tuple(name for name, count in seen.items() if count >= n_frames / 4)
    if len(names) < 3:
        raise ValueError(
            f"takes hold {len(names)} marker(s) that are seen in a quarter of all frames or more, "
            "but a face at rest needs three; give takes of one actor and one session."
        )
    return names


def _beginning(take, names, seconds):
    """The first frames of a take, its markers in the order of some names; NaN where not seen."""
    n_frames = max(1, round(min(seconds * take.fps, take.n_frames)))
    first = take.positions[:n_frames]
    some = np.full((len(first), len(names), 3), np.nan)
    column = {name: i for i, name in enumerate(names)}
    known = [i for i, name in enumerate(take.names) if name in column]
    some[:, [column[take.names[i]] for i in known]] = first[:, known]
    return some


def _seen(frames):
    return np.isfinite(frames[..., 0])


def _check_same_face(frames, reference, name, other):
    """Refuse the beginning of a take that is not that of another, or say how far it is off."""
    motion = rigid_motion(frames, reference, robust=True)
    if not motion.valid.any():  # too little in common to tell
        return
    off = np.linalg.norm(motion.to_head(frames[motion.valid]) - reference, axis=2)
    apart = float(np.nanmedian(off))
    if apart < _ALIKE:
        return
    both = _seen(frames[motion.valid][:1])[0] & np.isfinite(reference[:, 0])
    here, there = frames[motion.valid][0, both], reference[both]
    spread = np.sqrt(there.var(axis=0).sum())
    if apart > _OTHER * spread:
        # by distances, whatever the order of names
        size = np.median(pdist(there)) / max(np.median(pdist(here)), 1e-300)
        if unit_of(size):
            check_scale(size, name)
        if procrustes(here, there).mirrored:
            raise ValueError(f"{name} is mirrored beside {other}: negate one axis.")
        raise ValueError(
            f"{name} begins with its markers {apart:.0f} mm from where {other} begins with them, "
            "so they are named by another layout; give takes of one actor and one session."
        )
    warnings.warn(
        f"{name} begins with another face than {other}: half of its markers lie {apart:.1f} mm "
        "or more from where that has them. Look whether both begin at rest, and are of one actor "
        "and one session.",
        stacklevel=3,
    )


def _remedy(frame):
    """What to do about a frame that is too thin for a face."""
    seen = frame[np.isfinite(frame[:, 0])]
    side = float(np.ptp(seen, axis=0).max()) if len(seen) > 2 else 0.0
    scale = face_scale(side)
    if scale is not None and scale > 1:
        return (
            f"its markers span {side:.3g} mm, and a face's 70 to 700: multiply positions by "
            f"{scale:g}"
        )
    return "give takes that begin with the face at rest"
