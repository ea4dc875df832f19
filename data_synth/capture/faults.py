"""What the cameras make of the markers: noise, occlusion, swapped names, ghosts."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

_OFTEN_HIDDEN = ("chin", "mouth_corner_right", "mouth_corner_left", "lip_lower", "nose_base",
                 "jaw_right_6", "jaw_left_6", "jaw_right_8", "jaw_left_8")  # fmt: skip


class Swap(NamedTuple):
    """Two markers exchange their names in the frames first to stop - 1."""

    first: int
    stop: int
    a: str
    b: str


class Ghost(NamedTuple):
    """A marker that is not there, seen in the frames first to stop - 1."""

    first: int
    stop: int
    name: str


def bursts(rng, hazard, share, fps, seconds=0.12):
    """Occlusions that come in bursts: mask like `hazard`, the mean of which is about `share`."""
    n_frames = len(hazard)
    mean = max(seconds * fps, 1.0)
    start = rng.random(hazard.shape) < np.minimum(share / mean * hazard / hazard.mean(), 0.5)
    frame, marker = np.nonzero(start)
    stop = np.minimum(frame + rng.geometric(1 / mean, len(frame)), n_frames)
    steps = np.zeros((n_frames + 1, hazard.shape[1]), dtype=int)
    np.add.at(steps, (frame, marker), 1)
    np.add.at(steps, (stop, marker), -1)
    return np.cumsum(steps[:-1], axis=0) > 0


def _intervals(rng, n_frames, fps, per_second, shortest, longest):
    """Short intervals at random: list of (first, stop) frames."""
    found = []
    for _ in range(rng.poisson(per_second * n_frames / fps)):
        length = max(2, round(rng.uniform(shortest, longest) * fps))
        if length < n_frames:
            first = int(rng.integers(n_frames - length))
            found.append((first, first + length))
    return sorted(found)


def _draw_swaps(rng, sites, feet, n_frames, fps):
    pairs = sorted(cKDTree(feet).query_pairs(15.0))
    swaps = []
    for first, stop in _intervals(rng, n_frames, fps, 0.10, 0.05, 0.30):
        a, b = (sites.names[i] for i in pairs[rng.integers(len(pairs))])
        busy = {n for s in swaps if s.first < stop and first < s.stop for n in (s.a, s.b)}
        if not busy & {a, b}:
            swaps.append(Swap(first, stop, a, b))
    return tuple(swaps)


def _draw_ghosts(rng, n_frames, fps):
    ghosts = []
    for first, stop in _intervals(rng, n_frames, fps, 0.15, 0.03, 0.25):
        number = 1  # the lowest that no other ghost has at that time
        while any(g.stop > first and g.name == f"ghost{number}" for g in ghosts):
            number += 1
        ghosts.append(Ghost(first, stop, f"ghost{number}"))
    return tuple(ghosts)


def spoil(clean, normals, sites, feet, markers, fps, seed):
    """Positions as measured, and what was done to them.

    Parameters
    ----------
    clean, normals : ndarray of shape (n_frames, n_markers, 3)
        True centres, millimetres, and normals of the skin, in the capture frame.
    sites : Sites
    feet : ndarray of shape (n_markers, 3)
        Of the markers on the neutral face, millimetres.
    markers : data_synth.actors.Markers
    fps : float
    seed : list of int

    Returns
    -------
    positions : ndarray of shape (n_frames, n_markers + n_ghosts, 3)
    names : tuple of str
    swaps : tuple of Swap
    ghosts : tuple of Ghost
    """
    # a stream for each fault, so that one more marker does not change all of them
    rng, swapping, haunting = (np.random.default_rng([*seed, i]) for i in range(3))
    n_frames = len(clean)
    seen = clean + rng.normal(size=clean.shape) * markers.noise
    often = np.array([2.5 if n in _OFTEN_HIDDEN else 1.0 for n in sites.names])
    low = feet[:, 1] < np.interp(0.3, [0, 1], [feet[:, 1].min(), feet[:, 1].max()])
    hazard = np.where(low, 1.6, 1.0) * often * np.exp(-2.5 * normals[..., 2])
    hidden = bursts(rng, hazard, markers.occluded, fps)
    seen[hidden] = np.nan
    swaps = _draw_swaps(swapping, sites, feet, n_frames, fps)
    for first, stop, a, b in swaps:
        i, j = sites.names.index(a), sites.names.index(b)
        seen[first:stop, [i, j]] = seen[first:stop, [j, i]]
    ghosts = _draw_ghosts(haunting, n_frames, fps)
    extra = tuple(sorted({g.name for g in ghosts}, key=lambda n: int(n[5:])))
    columns = np.full((n_frames, len(extra), 3), np.nan)
    for first, stop, name in ghosts:
        near = clean[first:stop, haunting.integers(clean.shape[1])]
        aside = haunting.normal(size=3)
        aside *= haunting.uniform(5, 25) / np.linalg.norm(aside)
        drift = np.linspace(0, 1, stop - first)[:, None] * haunting.normal(0, 4, 3)
        columns[first:stop, extra.index(name)] = near + aside + drift
    return np.concatenate([seen, columns], axis=1), (*sites.names, *extra), swaps, ghosts
