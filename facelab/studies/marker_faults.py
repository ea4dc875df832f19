"""How well faults of markers are found: planted in clean takes, then looked for.

Nothing tells a true peak from a stray marker for sure, so it is counted: what was planted and
found, what was true and thrown away, over layouts from dense to sparse.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import check_number
from facelab.motion import MarkerSequence
from facelab.registration import fit_markers, register_sequence, rest_markers

STARTERS = ("chin", "nose_tip", "nose_bridge_1", "mouth_corner_left", "mouth_corner_right",
            "lip_upper", "brow_left_1", "brow_right_1", "brow_left_5", "brow_right_5")  # fmt: skip
"""Landmarks that thinned layouts keep, since the fit of a neutral starts from them."""


class Planted(NamedTuple):
    """A take with faults put in."""

    take: MarkerSequence
    strays: np.ndarray
    """How far each sample was moved, mm: shape (n_frames, n_markers), 0 for most."""
    swaps: dict
    """Frames in which two markers were exchanged, by the pair of names (a frozenset)."""


class Found(NamedTuple):
    """What `register_sequence` made of a planted take."""

    recall: float
    """Of the strays that were to be found, the share that was not believed."""
    precision: float
    """Of all samples thrown away, the share that was planted."""
    swap_recall: float
    """Of the exchanged pairs, frame by frame, the share put back."""
    swap_precision: float
    """Of the pairs put back, the share that was exchanged."""
    lost: float
    """Of the true samples, the share thrown away."""


def thinned(take, rest, names, spacing, keep=()):
    """Fewer markers of a take, evenly: none nearer to another than a distance, at rest.

    Parameters
    ----------
    take : MarkerSequence
    rest : ndarray of shape (n_markers, 3)
        Where the markers are at rest, mm; NaN for one that was not seen.
    names : sequence of str
        Theirs.
    spacing : float
        Millimetres.
    keep : sequence of str
        Markers that stay whatever their distance, such as the landmarks that a fit starts from.

    Returns
    -------
    MarkerSequence

    Examples
    --------
    >>> import numpy as np
    >>> from facelab import MarkerSequence
    >>> row = np.array([[0.0, 0, 0], [5, 0, 0], [10, 0, 0], [15, 0, 0]])
    >>> thinned(MarkerSequence(row[None], "abcd", 60), row, "abcd", 8.0).names
    ('a', 'c')
    """
    spacing = check_number(spacing, "spacing", low=0)
    chosen = [i for i, name in enumerate(names) if name in set(keep)]
    for i in range(len(names)):
        apart = np.linalg.norm(rest[chosen] - rest[i], axis=1)
        if np.isfinite(rest[i]).all() and not (apart < spacing).any():
            chosen.append(i)
    chosen = {names[i] for i in chosen}
    return take.select([name for name in take.names if name in chosen])


def planted(take, share=0.01, sizes=(5.0, 40.0), longest=30, n_swaps=4, random_state=None):
    """A take with strays and exchanged neighbours put in.

    Half of the strays are single frames, the others runs of 5 frames or more; each is moved by one
    vector all along. A tenth of a second after one stray of a marker, there is no other of it.

    Parameters
    ----------
    take : MarkerSequence
    share : float, default=0.01
        Of the samples that stray.
    sizes : (float, float)
        From and to which distance, millimetres.
    longest : int, default=30
        Frames of the longest run.
    n_swaps : int, default=4
        Exchanges of neighbours, each 5 to `longest` frames long.
    random_state : int or Generator, optional

    Returns
    -------
    Planted
    """
    rng = np.random.default_rng(random_state)
    positions = take.positions.astype(float)
    seen = take.visible
    strays, taken = np.zeros(seen.shape), ~seen
    pause = max(1, round(take.fps / 10))
    swaps = {}
    middle = np.nanmedian(positions - np.nanmedian(positions, axis=1, keepdims=True), axis=0)
    _, near = cKDTree(middle).query(middle, 4)
    for _ in range(100 * n_swaps):
        if len(swaps) == n_swaps:
            break
        a = int(rng.integers(take.n_markers))
        b, length = int(near[a, rng.integers(1, 4)]), int(rng.integers(5, longest + 1))
        first = int(rng.integers(pause, max(pause + 1, take.n_frames - length - pause)))
        pair = frozenset((take.names[a], take.names[b]))
        around = slice(first - pause, first + length + pause)
        if pair in swaps or taken[around, [a]].any() or taken[around, [b]].any():
            continue
        part = np.arange(first, min(first + length, take.n_frames))
        positions[part[:, None], [a, b]] = positions[part[:, None], [b, a]]
        swaps[pair] = set(part.tolist())
        taken[around, a] = taken[around, b] = True
    wanted = share * seen.sum()
    for _ in range(int(100 * wanted) + 1):
        if (strays > 0).sum() >= wanted:
            break
        marker, first = int(rng.integers(take.n_markers)), int(rng.integers(take.n_frames))
        single = rng.random() < 0.9  # as runs are long, so half of the samples are of either kind
        stop = first + (1 if single else int(rng.integers(5, longest + 1)))
        around = slice(max(0, first - pause), stop + pause)
        if taken[around, marker].any() or stop > take.n_frames:
            continue
        away = rng.normal(size=3)
        size = rng.uniform(*sizes)
        positions[first:stop, marker] += size * away / np.linalg.norm(away)
        strays[first:stop, marker] = size
        taken[around, marker] = True
    return Planted(MarkerSequence(positions, take.names, take.fps), strays, swaps)


def measure(fit, spoiled, least=0.0, **options):
    """Register a planted take and count.

    Parameters
    ----------
    fit : MarkerFit
    spoiled : Planted
        Of markers of that layout.
    least : float, default=0
        Strays smaller than this need not be found, mm.
    **options
        See `register_sequence`.

    Returns
    -------
    Found
    """
    take = spoiled.take.select([n for n in spoiled.take.names if n in set(fit.names)])
    order = [spoiled.take.names.index(n) for n in take.names]
    size = spoiled.strays[:, order]
    found = register_sequence(fit, take, progress=False, **options)
    columns = [fit.names.index(n) for n in take.names]
    thrown = take.visible & ~found.seen[:, columns]
    exchanged = {frozenset(f.names): set() for f in found.faults if f.kind == "swap"}
    for fault in found.faults:
        if fault.kind == "swap":
            exchanged[frozenset(fault.names)] |= set(range(fault.first, fault.stop))
    right = sum(len(frames & spoiled.swaps.get(p, set())) for p, frames in exchanged.items())
    back, given = (sum(map(len, s.values())) for s in (exchanged, spoiled.swaps))
    wanted, true = size > least, np.array(size == 0) & take.visible
    for pair, frames in spoiled.swaps.items():  # thrown away is not wrong for them
        true[np.ix_(sorted(frames), [take.names.index(n) for n in pair])] = False
    return Found(
        _share((thrown & wanted).sum(), wanted.sum()),
        _share((thrown & ~true).sum(), thrown.sum()),
        _share(right, given),
        _share(right, back),
        _share((thrown & true).sum(), true.sum()),
    )


def by_spacing(template, takes, spacings, random_state=0, **options):
    """Count over layouts from dense to sparse, each of them fitted anew.

    Parameters
    ----------
    template : TriangleMesh
        With landmarks.
    takes : sequence of MarkerSequence
        Of one actor, each starting at rest, and without faults: see `without_faults`.
    spacings : sequence of float
        Least distance of two markers, mm; 0 leaves the layout as it is.
    random_state : int, default=0
    **options
        See `planted`.

    Returns
    -------
    list of (float, int, Found)
        Median distance of a marker from the three next to it, mm; number of markers; and the mean
        over takes of what was found. To be found were strays of more than half that distance, and
        more than 8 mm.
    """
    rest, names = rest_markers(takes)
    rows = []
    for spacing in spacings:
        few = [thinned(take, rest, names, spacing, STARTERS) for take in takes]
        fit = fit_markers(template, *rest_markers(few))
        apart = float(np.median(_spacing(fit.rest)))
        found = [
            measure(fit, planted(take, random_state=random_state + k, **options), _least(apart))
            for k, take in enumerate(few)
        ]
        rows.append((apart, len(fit.names), Found(*np.mean(found, axis=0).tolist())))
    return rows


def without_faults(capture, take):
    """The markers of a take of a synthetic actor, exchanges put back and ghosts left out.

    Parameters
    ----------
    capture : data_synth.capture.Capture
    take : str

    Returns
    -------
    MarkerSequence
    """
    markers, truth = capture.markers(take), capture.truth(take)
    positions = markers.positions.copy()
    for swap in truth.swaps:
        frames = np.arange(swap.first, swap.stop)[:, None]
        pair = [markers.names.index(swap.a), markers.names.index(swap.b)]
        positions[frames, pair] = positions[frames, pair[::-1]]
    ghosts = {ghost.name for ghost in truth.ghosts}
    whole = MarkerSequence(positions, markers.names, markers.fps)
    return whole.select([name for name in markers.names if name not in ghosts])


def _spacing(rest):
    return cKDTree(rest).query(rest, 4)[0][:, 1:].mean(axis=1)


def _least(apart):
    """Strays smaller than this do little harm and need not be found, mm."""
    return max(8.0, apart / 2)


def _share(part, whole):
    return float(part / whole) if whole else 1.0
