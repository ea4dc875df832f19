"""How the cut of Tena et al. 2011, section 4.2, depends on the alignment and on the capture.

`python -m facelab.studies.segmentation_trials` writes the table over three captures of M1 and the
recorded takes of the generic face as CSV.
"""

import argparse
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from sklearn.metrics import adjusted_rand_score

from facelab import data
from facelab.checks import check_count
from facelab.data.registered import load_registered
from facelab.geometry.symmetry import mirror_agreement, mirror_twins
from facelab.segmentation.segment import Affinity
from facelab.studies.generalisation import NOISE, write_csv

ALIGNMENTS = ("as in the paper", "head held")
"""Every frame laid onto the template by Procrustes on the whole face (section 4.1); or the head
held still by the parts that move least, which is this lab's own way."""

K = (9, 13, 14)
"""Cuts of the paper's Fig. 4."""


@dataclass(frozen=True)
class Cut:
    """One motion, cut in one way: a row of the table.

    Attributes
    ----------
    name : str
        Of the motion.
    alignment : str
        One of `ALIGNMENTS`.
    stops : int
        Regions at which growth from 2 stops.
    whole : tuple of int
        Those of `K` at which every cluster of A is in one piece.
    like_motion : float
        Adjusted Rand index of A's clusters and those of C-bar (thresholded), lowest over `K`.
    symmetry, symmetry_distance, symmetry_chance : float
        Agreement with the mirror image at 13 regions: of A, of G-bar alone, and the mean of cuts
        around random seeds.
    """

    name: str
    alignment: str
    stops: int
    whole: tuple
    like_motion: float
    symmetry: float
    symmetry_distance: float
    symmetry_chance: float


def cut_both_ways(name, motion, twins, max_regions=40, n_chance=50):
    """Rows for one motion: aligned as in the paper, and with the head held.

    Parameters
    ----------
    name : str
    motion : MotionSequence
        With the head held.
    twins : ndarray of int, shape (n_vertices,)
        Each vertex's like on the other side, from `mirror_twins`.
    max_regions : int
        Where growth ends in any case.
    n_chance : int
        Random cuts.

    Returns
    -------
    list of Cut
    """
    return [
        _cut(name, way, moved, twins, max_regions, n_chance)
        for way, moved in zip(ALIGNMENTS, (motion.aligned(), motion), strict=True)
    ]


def _cut(name, way, motion, twins, max_regions, n_chance):
    both = Affinity.of(motion)
    given = dict(random_state=0, progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # growth that does not stop: the row says max_regions
        grown = both.segment(max_regions=max_regions, **given)
    cuts = {k: both.segment(k, **given) for k in K}
    alone = {k: both.with_(lam=1).segment(k, **given) for k in K}
    like = [adjusted_rand_score(cuts[k].labels, alone[k].labels) for k in K]
    place = both.with_(lam=0).segment(13, **given)
    return Cut(
        name,
        way,
        grown.n_regions,
        tuple(k for k in K if cuts[k].tried[0].compact),
        float(min(like)),
        float(mirror_agreement(cuts[13].labels, twins)),
        float(mirror_agreement(place.labels, twins)),
        float(np.mean(chance_symmetry(motion.mesh, twins, 13, n_chance))),
    )


def chance_symmetry(mesh, twins, n_regions, n_draws=100, random_state=0):
    """Mirror agreement of cuts around random seeds: ndarray of shape (n_draws,)."""
    n_regions = check_count(n_regions, "n_regions", 2, mesh.n_vertices, "vertices")
    rng = np.random.default_rng(random_state)
    seeds = (rng.choice(mesh.n_vertices, n_regions, replace=False) for _ in range(n_draws))
    return np.array([mirror_agreement(mesh.nearest_of(some), twins) for some in seeds])


def actor_motion(random_state=0, size="default", progress=True):
    """M1's full set in one capture, and the twins of its vertices."""
    actor = load_registered("M1", size, random_state, progress=progress)
    mirror = actor.capture.rig.template.mirror
    return actor.motion(), mirror_twins(actor.fit.mesh, actor.samples, mirror)


def recorded_motion(take, noise_seed=0):
    """A recorded take on the generic face, with noise as of a capture, and the twins.

    The motion is linear in the rig's 53 shapes, and the face is mirror-symmetric by construction,
    so its symmetry proves nothing.
    """
    face = data.load_ict_facekit()
    samples, mesh = face.neutral.subsample(397)
    motion = face.on(samples, mesh).animate(data.load_take(take).resampled(15))
    return motion.with_noise(NOISE, noise_seed), mirror_twins(face.neutral, samples)


def table(captures=(0, 1, 2), size="default", takes=data.TAKES, progress=True):
    """The table: captures of M1, and recorded takes where they are at hand.

    Returns
    -------
    list of Cut
    """
    rows = []
    for seed in captures:
        name = f"synthetic M1, capture {seed}"
        rows += cut_both_ways(name, *actor_motion(seed, size, progress))
    for take in takes:
        rows += cut_both_ways(f"generic face, {take}", *recorded_motion(take))
    return rows


def main(arguments=None):
    """Write `segmentation.csv`."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.segmentation_trials", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the CSV file")
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    rows = table()
    write_csv(out / "segmentation.csv", [asdict(row) for row in rows])
    print(f"{len(rows)} cuts in {out / 'segmentation.csv'}")


if __name__ == "__main__":
    main()
