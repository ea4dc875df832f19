"""Markers judged one by one: exchanged names, and markers that are not where they are said to be.

A true peak and a stray marker can lie equally far from where the others lead them, the more so the
fewer markers there are. But skin moves smoothly in time, and a stray one jumps: away, and back.
"""

from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from facelab.geometry.alignment import rigid_motion
from facelab.numeric.quantiles import nan_quantile
from facelab.registration.layout import MarkerLayout

_LEAST = 5.0  # mm; no jump is smaller: more than noise makes in one frame, or a blink
_PAIR = 25.0  # mm; exchanges are looked for this far, or as far as the neighbours of a marker are
_SURE = 0.7  # of the smallest jump: a change that is none for sure
_LEARNED = 2048  # frames that the motion of each marker is learned from
_NO_SKIN = 40.0  # mm from where the others lead it; a chin that opens is 15 mm off
_LONGEST = 1.0  # s that a marker may stray and still be known by its return
_LOOK_BACK = 60  # stretches of a track between jumps, that a later one may follow on
_BESIDE, _ALIKE = 6, 3  # of so many neighbours so many go along where the face itself moves fast
_ALONG = 0.2  # of a marker's change; what neighbours go less along is chance


def runs(mask):
    """First and stop frame of each run of True, marker by marker: (marker, first, stop)."""
    found = []
    for marker in np.flatnonzero(mask.any(axis=0)).tolist():
        column = np.concatenate([[False], mask[:, marker], [False]])
        edges = np.flatnonzero(column[1:] != column[:-1]).tolist()
        found += [(marker, a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return found


def spacing(rest):
    """Mean distance of each marker from the three next to it: ndarray of shape (n_markers,), mm."""
    return cKDTree(rest).query(rest, min(4, len(rest)))[0][:, 1:].mean(axis=1)


def find_swaps(layout, moved):
    """Neighbours whose direction is reversed and that fit better exchanged: put back, and where.

    Neighbours on the skin come closer and turn, but do not change sides.

    Parameters
    ----------
    layout : MarkerLayout
    moved : ndarray of shape (n_frames, n_markers, 3)
        Displacements, head frame, mm; NaN where not seen. Changed in place.

    Returns
    -------
    dict of (int, int) to list of int
        The frames in which each pair was exchanged.
    """
    rest = layout.fit.rest
    pairs = _pairs(rest)
    if len(pairs) == 0:
        return {}
    apart = rest[pairs[:, 0]] - rest[pairs[:, 1]]
    size = (apart**2).sum(axis=1)
    along = np.zeros((len(moved), len(pairs)))
    for axis in range(3):
        change = moved[..., axis]
        along += (change[:, pairs[:, 0]] - change[:, pairs[:, 1]]) * apart[:, axis]
    reversed_ = along < -1.3 * size  # never where one of them is NaN
    waiting = {}
    for pair in np.flatnonzero(reversed_.any(axis=0)).tolist():
        i, j = pairs[pair].tolist()
        frames = np.flatnonzero(reversed_[:, pair])
        without = moved[frames]
        here = without[:, [i, j]] + rest[[i, j]]
        without[:, [i, j]] = np.nan
        led = layout.filled(without)[:, [i, j]] + rest[[i, j]]
        for frame, ratio in _better_exchanged(here, led, frames.tolist()):
            waiting.setdefault(frame, []).append((ratio, i, j))
    found = _settled(waiting)
    for (i, j), at in found.items():
        _exchange(rest, moved, at, i, j)
    return found


def _better_exchanged(here, led, frames):
    """Frames in which two markers fit where they are led to far better exchanged, and how well.

    `here` and `led` are places, of shape (n_frames, 2, 3).
    """
    as_is = ((here - led) ** 2).sum(axis=(1, 2))
    exchanged = ((here[:, ::-1] - led) ** 2).sum(axis=(1, 2))
    better = np.flatnonzero(exchanged < 0.25 * as_is)
    return [(frames[k], float(exchanged[k] / as_is[k])) for k in better]


def _settled(waiting):
    """Of the exchanges (ratio, i, j) possible in each frame, the best: frames by pair."""
    found = {}
    for frame in sorted(waiting):
        busy = set()
        for _, i, j in sorted(waiting[frame]):
            if not busy & {i, j}:
                busy |= {i, j}
                found.setdefault((i, j), []).append(frame)
    return found


def _exchange(rest, moved, frames, i, j):
    """Displacements of two markers whose names were exchanged, put back in place."""
    at = np.ix_(frames, [i, j])
    moved[at] = (moved[at] + rest[[i, j]])[:, ::-1] - rest[[i, j]]


def _pairs(rest):
    """Markers that may be taken for each other: those in reach of both; (n_pairs, 2)."""
    reach = np.maximum(_PAIR, 1.6 * spacing(rest))
    pairs = cKDTree(rest).query_pairs(float(reach.max()), output_type="ndarray")
    apart = np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=1)
    return pairs[apart <= reach[pairs].min(axis=1)]


class StrayJudge:
    """How the markers of a take move, and which samples of them are not their own.

    Parameters
    ----------
    layout : MarkerLayout
    moved : ndarray of shape (n_frames, n_markers, 3)
        Displacements of the take, head frame, mm.
    seen : ndarray of bool, shape (n_frames, n_markers)
    fps : float
    weights : ndarray of shape (n_markers,)
        How rigidly each marker moves with the head.
    limit : float or None
        A marker farther than this from where the others lead it strays, mm. If None, only one that
        was never nearer than half as much again as its neighbours are, 12 mm or more.

    Attributes
    ----------
    step : ndarray of shape (n_markers,)
        The smallest change from one frame to the next that is a jump, mm.
    """

    def __init__(self, layout: MarkerLayout, moved, seen, fps, weights, limit=None):
        self.layout, self.fps, self.weights = layout, fps, weights
        rest = layout.fit.rest
        gap = spacing(rest)
        self._beside = cKDTree(rest).query(rest, min(_BESIDE + 1, len(rest)))[1][:, 1:]
        self.fixed = limit is not None
        self.limit = np.full(len(gap), limit) if self.fixed else np.maximum(12.0, 1.5 * gap)
        n_frames, n_markers = seen.shape
        length = 256
        n_parts = max(1, min(_LEARNED, n_frames) // length)
        firsts = np.linspace(0, max(n_frames - length, 0), n_parts).astype(int)
        steps, places = [], []
        for first in firsts:
            part = slice(first, first + length)
            d = np.where(seen[part, :, None], moved[part], np.nan).astype(float)
            e = self._apart(d)
            steps.append(np.fmin(_size(np.diff(d, axis=0)), _size(np.diff(e, axis=0))))
            places.append(e)
        steps, places = np.concatenate(steps), np.concatenate(places)
        known = np.isfinite(steps).any(axis=0)
        usual = np.zeros(n_markers)
        usual[known] = nan_quantile(steps[:, known], 0.9)
        self.step = np.maximum.reduce([np.full(n_markers, _LEAST), 0.2 * gap, 6 * usual])
        self._centre = np.zeros((n_markers, 3))
        self._range = np.full(n_markers, 2.0)
        known = np.isfinite(places[..., 0]).any(axis=0)
        if known.any():
            self._centre[known] = nan_quantile(places[:, known], 0.5)
            off = _size(places[:, known] - self._centre[known])
            self._range[known] += nan_quantile(off, 0.95)

    @property
    def margin(self):
        """Frames before and after some that have to be seen to judge them."""
        return round(1.5 * _LONGEST * self.fps)

    def _apart(self, d):
        """How far the seen markers are from where the others lead them; NaN where not seen."""
        e = self.layout.left_out(self.layout.filled(d))
        e[np.isnan(d)] = np.nan
        return e

    def find(self, moved):
        """Samples that are not believed.

        Parameters
        ----------
        moved : ndarray of shape (n_frames, n_markers, 3)
            Frames that follow one another, `margin` more at either end than are wanted; NaN where
            not seen. Changed in place: strays become NaN.

        Returns
        -------
        stray : ndarray of bool, shape (n_frames, n_markers)
        swaps : dict of (int, int) to list of int
            The frames in which two of them were each in the other's place: they are put back.
        full : ndarray of shape (n_frames, n_markers, 3)
            `moved` as it was given, filled.
        """
        full = self.layout.filled(moved)
        e = self.layout.left_out(full)
        e[np.isnan(moved)] = np.nan
        stray, swaps = self._jumped(moved, e), {}
        if stray.any():
            # they moved the head, and what their neighbours are judged by: once more without them
            d = moved.copy()
            self._without(stray, d, e)
            stray = self._jumped(d, e)
            swaps = self._exchanged(stray, d, e)
            for (i, j), frames in swaps.items():
                stray[np.ix_(frames, [i, j])] = False
                _exchange(self.layout.fit.rest, moved, frames, i, j)
            moved[stray] = np.nan
        if self.fixed:
            stray |= self._beyond(moved)
        elif (_size(e) > self.limit).any():
            stray |= self._never_home(moved)
        return stray, swaps, full

    def _exchanged(self, stray, d, e, most=12):
        """Strays that are in each other's places, however far apart: frames by pair."""
        rest = self.layout.fit.rest
        count = stray.sum(axis=1)
        waiting = {}
        for frame in np.flatnonzero((count >= 2) & (count <= most)).tolist():
            for i, j in combinations(np.flatnonzero(stray[frame]).tolist(), 2):
                waiting.setdefault((i, j), []).append(frame)
        found = {}
        for (i, j), frames in waiting.items():
            here = d[frames][:, [i, j]] + rest[[i, j]]
            led = here - e[frames][:, [i, j]]
            for frame, ratio in _better_exchanged(here, led, frames):
                found.setdefault(frame, []).append((ratio, i, j))
        return _settled(found)

    def _without(self, stray, d, e):
        """Displacements and distances from where the others lead, had some never been there.

        Both are changed in place, in the frames where there are some.
        """
        frames = np.flatnonzero(stray.any(axis=1))
        rest = self.layout.fit.rest
        moved, out = d[frames] + rest, stray[frames]
        without = np.where(out[..., None], np.nan, moved)
        motion = rigid_motion(without, rest, self.weights, robust=True)
        frames, moved, without = (a[motion.valid] for a in (frames, moved, without))
        motion = rigid_motion(without, rest, self.weights, robust=True)
        moved, without = motion.to_head(moved) - rest, motion.to_head(without) - rest
        full = self.layout.filled(without)
        apart = np.where(np.isfinite(without), self.layout.left_out(full), moved - full)
        d[frames] = moved
        e[frames] = np.where(np.isfinite(moved), apart, np.nan)

    def _jumped(self, d, e):
        """Stretches of each track that jump away and back: mask."""
        seen, cut = np.isfinite(d[..., 0]), self._cuts(d, e)
        stray = np.zeros(seen.shape, dtype=bool)
        for m in np.flatnonzero(cut.any(axis=0)):
            at = np.flatnonzero(seen[:, m])
            starts = np.flatnonzero(cut[at, m])
            unusual = _size(e[at, m] - self._centre[m]) / self._range[m]
            stray[at, m] = self._left(at, d, e, starts, 1 / (1 + unusual**2), m)
        return stray

    def _cuts(self, d, e):
        """Samples before which a track may have jumped: mask."""
        seen = np.isfinite(d[..., 0])
        frame = np.arange(len(d))[:, None]
        last = np.maximum.accumulate(np.where(seen, frame, -1), axis=0)
        before = np.vstack([np.full((1, d.shape[1]), -1), last[:-1]])
        both = seen & (before >= 0)
        marker = np.arange(d.shape[1])
        step = np.fmin(_size(d - d[before, marker]), _size(e - e[before, marker]))
        most = _SURE * self.step * np.sqrt(frame - before)
        cut = both & (step > most)
        for m in np.flatnonzero(cut.any(axis=0)):
            at = np.flatnonzero(cut[:, m])
            cut[at, m] = self._alone(d, e, before[at, m], at, m) > most[at, m]
        return cut

    def _alone(self, d, e, since, to, marker):
        """How far a marker went between frames where the others did not lead it, mm.

        A lip outruns a jaw that snaps open, for the layout is smooth, but goes the way of its
        neighbours; a stray one goes alone. One or two neighbours may be strays, too.
        """
        own, apart = d[to, marker] - d[since, marker], e[to, marker] - e[since, marker]
        size = _size(own)
        way = own / np.maximum(size, 1e-12)[:, None]
        led = ((own - apart) * way).sum(axis=1)
        beside = self._beside[marker]
        along = np.einsum("fmx,fx->fm", d[to][:, beside] - d[since][:, beside], way)
        along = np.sort(np.nan_to_num(along), axis=1)[:, -min(_ALIKE, len(beside))]
        common = np.minimum(led, along)
        return np.fmin(size, _size(apart) - np.where(common > _ALONG * size, common, 0))

    def _never_home(self, moved, rounds=4):
        """Stretches of tracks that never are within the limit, or leave it for far: mask.

        `moved` gets NaN. A true peak comes from the face and returns to it. The worst of a
        neighbourhood goes first.
        """
        stray = np.zeros(moved.shape[:2], dtype=bool)
        near = self._neighbours()
        for _ in range(rounds):
            e = self._apart(moved)
            off, cut = _size(e), self._cuts(moved, e)
            found = []
            for m in np.flatnonzero((off > self.limit).any(axis=0)):
                at = np.flatnonzero(np.isfinite(off[:, m]))
                for part in np.split(at, np.flatnonzero(cut[at, m])):
                    for away in self._away(part, off[part, m], self.limit[m]):
                        around = np.nan_to_num(off[np.ix_(away, near[m])]).mean(axis=0)
                        if off[away, m].mean() > 0.999 * around.max():
                            found.append((away, m))
            for part, m in found:
                stray[part, m] = True
                moved[part, m] = np.nan
            if not found:
                break
        return stray

    @staticmethod
    def _away(part, off, limit):
        """Of a stretch of a track, the frames that are no face's: list of ndarray.

        All of it if it never is within the limit, else what leaves it for where no skin goes, as a
        marker that falls off does.
        """
        beyond = off > limit
        if beyond.all():
            return [part] if part.size else []
        edges = np.flatnonzero(np.diff(beyond)) + 1
        cut = zip(np.split(part, edges), np.split(off, edges), strict=True)
        return [frames for frames, far in cut if far.max() > max(_NO_SKIN, 3 * limit)]

    def _neighbours(self):
        """The markers that each one leads, itself among them."""
        rest = self.layout.fit.rest
        near = cKDTree(rest).query_ball_point(rest, np.maximum(30.0, 1.5 * spacing(rest)))
        return [np.array(n) for n in near]

    def _left(self, at, d, e, starts, worth, marker):
        """The stretches of one track that are best left out, so that the others follow smoothly.

        What is left out costs its worth in frames, a jump between stretches that are kept half the
        longest stray. The cheapest choice is found stretch by stretch (dynamic programming).
        """
        starts = np.concatenate([[0], starts])
        stops = np.append(starts[1:], len(at)) - 1
        cost = np.concatenate([[0.0], np.cumsum(np.add.reduceat(worth, starts))])
        broken = 0.5 * _LONGEST * self.fps
        best, came = cost[:-1].copy(), np.full(len(starts), -1)  # as the first that is kept
        for s in range(1, len(starts)):
            p = np.arange(max(0, s - _LOOK_BACK), s)
            ends, here = stops[p], starts[s]
            step = self._alone(d, e, at[ends], at[[here]], marker)
            step /= self.step[marker] * np.sqrt(at[here] - at[ends])
            jump = np.clip((step - _SURE) / (1 - _SURE), 0, 1)
            total = best[p] + cost[s] - cost[p + 1] + broken * jump
            k = int(total.argmin())
            if total[k] < best[s]:
                best[s], came[s] = total[k], p[k]
        s = int((best + cost[-1] - cost[1:]).argmin())
        out = np.ones(len(at), dtype=bool)
        while s >= 0:
            out[starts[s] : stops[s] + 1] = False
            s = came[s]
        return out

    def _beyond(self, moved, rounds=4):
        """Markers beyond the limit from where the others lead them: mask; `moved` gets NaN.

        The worst of a neighbourhood goes first: it spoils what its neighbours are judged by.
        """
        near = self._neighbours()
        stray = np.zeros(moved.shape[:2], dtype=bool)
        frames = np.arange(len(moved))
        for _ in range(rounds):
            off = np.nan_to_num(_size(self._apart(moved[frames])))
            bad = off > self.limit
            for f, m in np.argwhere(bad):
                bad[f, m] = off[f, m] >= off[f, near[m]].max()
            stray[frames] |= bad
            moved[stray] = np.nan
            frames = frames[bad.any(axis=1)]
            if not frames.size:
                break
        return stray


def _size(vectors):
    """Lengths of vectors (..., 3)."""
    return np.sqrt(np.einsum("...x,...x->...", vectors, vectors))
