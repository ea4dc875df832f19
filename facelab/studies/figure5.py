"""What Tena et al. 2011 read off their Fig. 5 and 6, as numbers.

Curves are those of `generalisation.synthetic`: keyed by training set ("M1+F1"), family and target.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from facelab.models.evaluation import rms_error, variance_across
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.studies.generalisation import EACH, face_regions

REGION = "region beta=0.5"
MARKER = 1.5
"""Radius of the paper's markers, millimetres."""


def of_person(curves, person, training, family, target="frames"):
    """One actor's part of a curve: ErrorCurve."""
    curve = curves[training, family, target]
    return curve.of(np.char.startswith(curve.takes, f"{person}/"))


def error_at(curves, person, training, family, n, target="frames"):
    """E_RMS of one actor with n components (of each region), millimetres."""
    curve = of_person(curves, person, training, family, target)
    return float(curve.rms[np.flatnonzero(curve.components == n)[0]])


def training_sets(curves):
    """Training sets, from one actor to all."""
    return list(dict.fromkeys(training for training, _, _ in curves))


@dataclass(frozen=True)
class Spread:
    """How errors differ across individuals, regions against the whole face.

    Attributes
    ----------
    training : str
    lower, sizes : int
        In how many of how many sizes the variance over the actors is lower with regions.
    lower_relative : int
        The same for the standard deviation divided by the mean error.
    ratio : float
        Of the variances, region / holistic, the middle one over the sizes.
    """

    training: str
    lower: int
    sizes: int
    lower_relative: int
    ratio: float


def spreads(curves, people, family=REGION, sizes=EACH):
    """Less variance across individuals", for each training set: list of Spread."""
    rows = []
    for training in training_sets(curves):
        variance, relative = {}, {}
        for name in ("holistic", family):
            four = [of_person(curves, p, training, name) for p in people]
            pick = [int(np.flatnonzero(four[0].components == n)[0]) for n in sizes]
            variance[name] = variance_across(four)[pick]
            relative[name] = np.sqrt(variance[name]) / np.mean([c.rms[pick] for c in four], axis=0)
        rows.append(
            Spread(
                training,
                int((variance[family] < variance["holistic"]).sum()),
                len(sizes),
                int((relative[family] < relative["holistic"]).sum()),
                float(np.median(variance[family] / variance["holistic"])),
            )
        )
    return rows


def adding(curves, people, families=("holistic", REGION), sizes=EACH):
    """What adding an actor to the training set does to errors.

    Returns
    -------
    added, first : ndarray of shape (n_added, n_families, n_sizes)
        Error with the actor over error without: on the one added, and on the first one, who was
        there from the start. Below 1 where it helps.
    """
    sets, added, first = training_sets(curves), [], []
    for before, after in pairwise(sets):
        new = after.split("+")[-1]
        for rows, person in ((added, new), (first, people[0])):
            rows.append(
                [
                    [
                        error_at(curves, person, after, family, n)
                        / error_at(curves, person, before, family, n)
                        for n in sizes
                    ]
                    for family in families
                ]
            )
    return np.array(added), np.array(first)


@dataclass(frozen=True, eq=False)
class ErrorGrid:
    """Errors by number of regions and of components, trained on one actor, tested on several.

    Attributes
    ----------
    counts, sizes : tuple of int
        Numbers of regions; components of each region.
    region : ndarray of shape (n_counts, n_sizes, n_actors)
        E_RMS, millimetres.
    holistic : ndarray of shape (n_sizes, n_actors)
        The whole face with as many components as one region has.
    as_many : ndarray of shape (n_counts, n_sizes, n_actors)
        The whole face with as many components as all regions together.
    """

    counts: tuple
    sizes: tuple
    region: np.ndarray
    holistic: np.ndarray
    as_many: np.ndarray


def error_grid(actors, counts=(5, 9, 13, 20, 30), sizes=(1, 2, 5, 10, 20), target="truth"):
    """Errors against the number of regions and of their components: ErrorGrid.

    Parameters
    ----------
    actors : dict of str to RegisteredActor
        The first one's training sentences teach, and its full set gives the regions; the test
        sentences of all are rebuilt.
    counts, sizes : sequence of int
    target : {"frames", "truth"}
        What errors are measured against.
    """
    first = next(iter(actors.values()))
    X = first.motion("train").displacements()
    tests = [a.motion("test").displacements() for a in actors.values()]
    wanted = tests
    if target == "truth":
        wanted = [a.truth("test").displacements() for a in actors.values()]

    def errors(model):
        return [rms_error(w, model.reconstruct(x)) for x, w in zip(tests, wanted, strict=True)]

    most = min(len(X) - 1, X.shape[1])
    whole = HolisticModel(min(max(counts) * max(sizes), most)).fit(X)
    region, as_many = [], []
    for count in counts:
        rich = RegionModel(face_regions(first, count), max(sizes)).fit(X)
        region.append([errors(rich.truncated(n)) for n in sizes])
        as_many.append([errors(whole.truncated(min(count * n, most))) for n in sizes])
    holistic = [errors(whole.truncated(n)) for n in sizes]
    return ErrorGrid(*map(tuple, (counts, sizes)), *map(np.array, (region, holistic, as_many)))


def within_marks(X, X_hat, radius=MARKER):
    """Fig. 6 by its own criterion: the share of markers that lie within the grey vertices.

    Parameters
    ----------
    X, X_hat : ndarray of shape (n_frames, 3 * n_vertices)
        True places of the marked vertices and those of the reconstruction, millimetres.
    radius : float, default=1.5
        Of a mark: that of the paper's markers of 3 mm.

    Returns
    -------
    ndarray of shape (n_frames,)
        From 0 to 1.
    """
    off = np.asarray(X_hat, dtype=float) - np.asarray(X, dtype=float)
    distance = np.linalg.norm(off.reshape(len(off), -1, 3), axis=2)
    return (distance <= radius).mean(axis=1)
