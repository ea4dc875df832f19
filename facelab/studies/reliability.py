"""Whether the expected error of a registration holds: `python -m facelab.studies.reliability`.

On the synthetic actors the skin behind the markers is known. So of the vertices that are said to
be within a millimetre one can count those that are: with all markers, with few of them, and with
many hidden; lids and lips, where no marker is, apart.
"""

import argparse
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import as_finite, check_number
from facelab.data.actors import ACTORS, load_capture, load_template
from facelab.geometry.alignment import procrustes
from facelab.registration.confidence import free_edges
from facelab.registration.fit import fit_markers
from facelab.registration.rest import rest_markers
from facelab.registration.sequence import register_sequence
from facelab.studies.kept import kept

LIMITS = (0.5, 1.0, 2.0)
"""Millimetres that are asked about."""

PARTS = ("face", "lids", "lips")
"""Of the skin: without lids and lips, around the one, and around the others."""

_LIDS, _LIPS = 8.0, 11.0  # mm from the free edge that count as such
_LANDMARKS = 12  # that are kept of few markers, since a fit starts from them


@dataclass(frozen=True, eq=False)
class Reliability:
    """What was said of vertices, and what was found.

    Parameters
    ----------
    said : ndarray of shape (n,)
        Expected errors, millimetres.
    found : ndarray of shape (n,)
        RMS errors over the take, millimetres.

    Examples
    --------
    >>> r = Reliability(np.array([0.4, 0.4, 0.8, 3.0]), np.array([0.2, 0.6, 0.7, 1.0]))
    >>> r.share_said(1.0), round(r.share_within(1.0), 2), r.share_within(0.5)
    (0.75, 1.0, 0.5)
    """

    said: np.ndarray = field(repr=False)
    found: np.ndarray = field(repr=False)

    def share_said(self, limit):
        """Share of all vertices that are said to be within a limit (mm)."""
        return float((self.said <= limit).mean())

    def share_within(self, limit):
        """Of those said to be within a limit (mm), the share that is; NaN if there are none."""
        trusted = self.said <= limit
        return float((self.found[trusted] <= limit).mean()) if trusted.any() else float("nan")

    def curve(self, edges):
        """By bins of the said error: count, found RMS and share within what was said of each.

        Parameters
        ----------
        edges : array_like of shape (n_bins + 1,)
            Millimetres, rising.

        Returns
        -------
        count, rms, share : ndarray of shape (n_bins,)
            Vertices in the bin; their found error, mm; share whose found error is no larger than
            the said one. NaN where a bin is empty.
        """
        edges = as_finite(edges, "edges", ("n_edges",))
        where = np.digitize(self.said, edges) - 1
        inside = (where >= 0) & (where < len(edges) - 1)
        n = len(edges) - 1

        def per_bin(values):
            return np.bincount(where[inside], values[inside].astype(float), minlength=n)

        count = per_bin(np.ones(len(self.said)))
        full = np.where(count, count, np.nan)
        rms = np.sqrt(per_bin(self.found**2) / full)
        return count.astype(int), rms, per_bin(self.found <= self.said) / full

    @staticmethod
    def joined(several):
        """Several as one."""
        several = list(several)
        return Reliability(*(np.concatenate([getattr(r, a) for r in several])
                             for a in ("said", "found")))  # fmt: skip


def skin_parts(mesh):
    """Which vertices are of each of `PARTS`: dict of str to ndarray of bool, (n_vertices,)."""
    near = []
    for edge, reach in zip(free_edges(mesh), (_LIDS, _LIPS), strict=True):
        far = np.full(mesh.n_vertices, np.inf)
        if len(edge):
            far = cKDTree(mesh.vertices[edge]).query(mesh.vertices)[0]
        near.append(far < reach)
    lids, lips = near
    return dict(zip(PARTS, (~lids & ~lips, lids, lips & ~lids), strict=True))


def spread_markers(positions, names, landmarks, count):
    """Some of the markers, as far apart as they will go, twelve landmarks first: list of int.

    Parameters
    ----------
    positions : ndarray of shape (n_markers, 3)
        At rest, millimetres; NaN for one not seen, which is not chosen.
    names : sequence of str
    landmarks : collection of str
        Names that are landmarks.
    count : int
        All of them if there are no more.
    """
    seen = [i for i in range(len(names)) if np.isfinite(positions[i]).all()]
    known = [i for i in seen if names[i] in landmarks]
    chosen = known[:1] or seen[:1]
    for among, most in ((known, min(_LANDMARKS, count)), (seen, count)):
        while len(chosen) < min(most, len(among)):
            apart = positions[among][:, None] - positions[chosen]
            chosen.append(among[int(np.linalg.norm(apart, axis=2).min(axis=1).argmax())])
    return chosen


def reliability(actor, takes=None, n_markers=None, hidden=0.0, size="small", every=4):
    """What a registration says of its errors, against the true skin.

    Parameters
    ----------
    actor : str
        One of `facelab.data.ACTORS`.
    takes : sequence of str, optional
        All if left out.
    n_markers : int, optional
        So many of the markers, far apart; all if left out.
    hidden : float, default=0.0
        Share of the markers that is hidden, in bursts.
    size : {"small", "default"}
        Of the capture.
    every : int, default=4
        Frames are judged in steps of so many.

    Returns
    -------
    dict of str to Reliability
        For "face", "lids" and "lips". Kept in the cache.
    """
    hidden = float(check_number(hidden, "hidden", low=0, high=0.95))
    capture = load_capture(actor, size, progress=False)
    takes = list(capture.texts if takes is None else takes)
    found = kept(
        "reliability.reliability",
        [capture.seal, takes, n_markers, hidden, every],
        lambda: _judged(capture, takes, n_markers, hidden, every),
    )
    return {part: Reliability(found[f"{part}.said"], found[f"{part}.found"]) for part in PARTS}


def _judged(capture, takes, n_markers, hidden, every):
    template = load_template(capture.neutral.n_vertices)
    positions, names = rest_markers([capture.markers(t) for t in capture.texts])
    count = len(names) if n_markers is None else n_markers
    chosen = spread_markers(positions, names, template.landmarks, count)
    fit = fit_markers(template, positions[chosen], [names[i] for i in chosen])
    turn = procrustes(capture.neutral.vertices, fit.mesh.vertices).rotation
    parts = skin_parts(fit.mesh)
    found = {part: [] for part in parts}
    for take in takes:
        markers = capture.markers(take)
        markers = markers.select([n for n in markers.names if n in fit.names])
        if hidden:
            markers = markers.with_gaps(hidden, random_state=0)
        registration = register_sequence(fit, markers, progress=False)
        frames = np.arange(0, len(registration.valid), every)
        frames = frames[registration.valid[frames]]
        moved = registration.positions(frames) - fit.mesh.vertices
        true = (capture.surface(take, frames) - capture.neutral.vertices) @ turn.T
        error = np.sqrt(((moved - true) ** 2).sum(axis=2).mean(axis=0))
        for part, mask in parts.items():
            found[part].append(Reliability(registration.confidence[mask], error[mask]))
    arrays = {}
    for part, some in found.items():
        joined = Reliability.joined(some)
        arrays |= {f"{part}.said": joined.said, f"{part}.found": joined.found}
    return arrays


def table(rows):
    """Text of what was said and found: a line for each of a dict of str to `reliability`."""
    head = "of those said to be within  " + "".join(f"{limit:>16g} mm" for limit in LIMITS)
    lines = [head, "are so (share said so)"]
    for name, parts in rows.items():
        for part, r in parts.items():
            cells = (
                f"{r.share_within(k):10.2f} ({r.share_said(k):.2f}) "
                if r.share_said(k)
                else f"{'none said so':>18} "
                for k in LIMITS
            )
            lines.append(f"{name:>20} {part:>5}  " + "".join(cells))
    return "\n".join(lines)


def main(arguments=None):
    """Print the table for all actors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", choices=("small", "default"), default="small")
    parser.add_argument("--actors", nargs="+", choices=ACTORS, default=ACTORS)
    options = parser.parse_args(arguments)
    ways = {
        "all": {},
        "80": {"n_markers": 80},
        "40": {"n_markers": 40},
        "20 % hidden": {"hidden": 0.2},
    }
    for actor in options.actors:
        rows = {f"{actor}, {name}": reliability(actor, size=options.size, **way)
                for name, way in ways.items()}  # fmt: skip
        print(table(rows), flush=True)


if __name__ == "__main__":
    main()
