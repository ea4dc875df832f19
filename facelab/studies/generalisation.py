"""The errors of notebook 04, as curves and a table: `python -m facelab.studies.generalisation`.

Tena et al. 2011, section 5, Fig. 5, on the four synthetic actors and on a recorded performance,
against the frames and against the truth behind them. What takes long is computed once and kept in
the cache.
"""

import argparse
import csv
import hashlib
from copy import copy
from functools import cache
from pathlib import Path

import numpy as np
from tqdm.auto import tqdm

from facelab import data
from facelab.data.actors import ACTORS
from facelab.data.registered import load_registered
from facelab.geometry.symmetry import mirror_weights, other_side, symmetrised
from facelab.keeping import keep_arrays, source_stamp
from facelab.models.evaluation import ErrorCurve, error_curves, rms_error, sparse_model
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.posing.session import PosingSession
from facelab.segmentation.segment import segment_face
from facelab.storage import atomic_path, check_writable

N_REGIONS = 13
"""Regions of the paper. On the synthetic actors every k up to 30 is compact and sets no number."""

NOISE = 0.3
"""Noise added to the recorded motion, mm per axis: as an optical capture would have."""

EACH = (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 60)
TOTAL = (13, 20, 30, 50, 80, 130, 200, 300, 400)
SPARSE = (13, 30, 80)
HOLISTIC = (*EACH, 80, 130, 200, 300, 400)

FIGURE_5 = ("holistic", "region beta=0", "region beta=0.5")
"""The families of models of the paper's figure."""

FAMILIES = (*FIGURE_5, "region total", "sparse")
"""All that are compared; the last takes most of the time."""


def fitted_models(X, regions):
    """The families of models that are compared: dict of str to a function giving models by size.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Training frames, displacements from the neutral, millimetres.
    regions : Regions
    """
    most = min(len(X) - 1, X.shape[1])

    @cache
    def learned():  # modes do not depend on beta
        return RegionModel(regions, min(120, most)).fit(X)

    def holistic():
        rich = HolisticModel(min(max(HOLISTIC), most)).fit(X)
        return (rich.truncated(n) for n in HOLISTIC if n <= most)

    def region(beta, sizes=EACH, spread="each"):
        rich = copy(learned())
        rich.beta = beta
        return (rich.truncated(n, spread) for n in sizes)

    return {
        "holistic": holistic,
        "region beta=0": lambda: region(0.0),
        "region beta=0.5": lambda: region(0.5),
        "region total": lambda: region(0.5, TOTAL, "total"),
        "sparse": lambda: (sparse_model(X, n) for n in SPARSE),
    }


def compare(X, regions, tests, targets, takes, families=FAMILIES, progress=None):
    """Error curves of families trained on X: dict of family to dict of target to curve."""
    found, models = {}, fitted_models(X, regions)
    for name in families:
        found[name] = error_curves(models[name](), tests, targets, takes)
        if progress is not None:
            progress.update()
    return found


# --- four synthetic actors ------------------------------------------------------------------------


def load_actors(progress=True):
    """The four actors, registered: dict of name to RegisteredActor."""
    return {name: load_registered(name, progress=progress) for name in ACTORS}


def face_regions(actor, n_regions=N_REGIONS):
    """The regions of M1's full set, which serve all actors."""
    return segment_face(actor.motion(), n_regions=n_regions, random_state=0, progress=False)


def frames_of(actor, kind):
    """Registered and true displacements, and the take of each frame, "F1/rage_5"."""
    X, truth, takes = [], [], []
    for take in actor.takes[kind]:
        X.append(actor.motion(take).displacements())
        truth.append(actor.truth(take).displacements())
        takes += [f"{actor.name}/{take}"] * len(X[-1])
    return np.concatenate(X), np.concatenate(truth), np.array(takes)


def synthetic(actors, regions, families=FAMILIES, progress=True):
    """Fig. 5: models trained on one to four actors, on all test sentences.

    Parameters
    ----------
    actors : dict of str to RegisteredActor
        See `load_actors`.
    regions : Regions
    families : tuple of str
        Of models: all five, or the three of the paper (`FIGURE_5`), which are made in a fraction
        of the time.
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    dict of (str, str, str) to ErrorCurve
        From training set ("M1+F1"), family ("region beta=0.5") and target ("frames", the
        registered ones, or "truth", the skin itself). Frames of a curve are those of all four
        actors' test sentences; its takes are named "F1/rage_5".
    """
    names = tuple(actors)
    X, truth, takes = zip(*(frames_of(a, "test") for a in actors.values()), strict=True)
    X, truth, takes = (np.concatenate(x) for x in (X, truth, takes))
    train = [a.motion("train").displacements() for a in actors.values()]
    digest = hashlib.sha256(regions.labels.tobytes())
    for array in (X, truth, *train):
        digest.update(np.ascontiguousarray(array).tobytes())

    def make():
        curves, total = {}, len(names) * len(families)
        with tqdm(total=total, desc="models compared", disable=not progress, leave=False) as bar:
            for k in range(1, len(names) + 1):
                targets = {"frames": X, "truth": truth}
                found = compare(
                    np.concatenate(train[:k]), regions, X, targets, takes, families, bar
                )
                curves |= _keyed("+".join(names[:k]), found)
        return curves

    digest.update(repr(families).encode())
    return _kept("synthetic" if families == FAMILIES else "figure5", digest, make)


def _keyed(training, found):
    return {
        (training, family, target): curve
        for family, by_target in found.items()
        for target, curve in by_target.items()
    }


def _kept(name, digest, make):
    """Curves from the cache, or made and kept there, for these data, sizes and models."""
    digest.update(repr((EACH, TOTAL, SPARSE, HOLISTIC)).encode())
    key = {"data": digest.hexdigest(), "code": source_stamp("facelab.models")}
    return _unpacked(keep_arrays(f"results/{name}", key, lambda: _packed(make())))


def _packed(curves):
    arrays = {"keys": np.array([" | ".join(key) for key in curves])}
    for i, curve in enumerate(curves.values()):
        for what in ("components", "parameters", "squares", "takes"):
            arrays[f"{i}.{what}"] = getattr(curve, what)
    return arrays


def _unpacked(arrays):
    whats = ("components", "parameters", "squares", "takes")
    return {
        tuple(key.split(" | ")): ErrorCurve(*(arrays[f"{i}.{what}"] for what in whats))
        for i, key in enumerate(arrays["keys"].tolist())
    }


# --- a recorded performance -----------------------------------------------------------------------


def real():
    """The same on the generic face: trained on alex_rom_3, tested on alex_rom_4.

    The generic face of ICT-FaceKit (an average of scans), moved by two recorded takes of one
    performer: motion that is linear in its 53 shapes. 397 vertices, noise of 0.3 mm added. The
    takes differ, the face does not.

    Returns
    -------
    curves : dict of (str, str, str) to ErrorCurve
        As `synthetic`; takes are pieces of two seconds.
    regions : Regions
        Of the training take, as many as are compact.
    truth : ndarray of shape (n_frames, 3 * 397)
        The test frames without noise.

    Raises
    ------
    DataUnavailable
        If the data is not on this machine and cannot be downloaded.
    """
    face = data.load_ict_facekit()
    train, test = (data.load_take(name).resampled(15) for name in data.TAKES)
    samples, mesh = face.neutral.subsample(397)
    rig = face.on(samples, mesh)
    learned = rig.animate(train).with_noise(NOISE, 0)
    true = rig.animate(test)
    truth = true.displacements()
    X = true.with_noise(NOISE, 1).displacements()
    regions = segment_face(learned, random_state=0, progress=False)
    takes = np.arange(len(X)) // 30
    learned = learned.displacements()
    digest = hashlib.sha256(regions.labels.tobytes())
    for array in (learned, X, truth):
        digest.update(np.ascontiguousarray(array).tobytes())

    def make():
        targets = {"frames": X, "truth": truth}
        return _keyed("alex_rom_3", compare(learned, regions, X, targets, takes))

    curves = _kept("real", digest, make)
    return curves, regions, truth


# --- one side of the face -------------------------------------------------------------------------

ONE_SIDED = ("AU2L", "AU12L", "AU14L", "AU20L", "AU45L")
"""Units of the left side: outer brow, smile, dimple, stretch, wink."""

PULLS = {"mouth_corner_left": (4.0, 6.0, 0.0), "brow_left_3": (0.0, 6.0, 0.0)}
"""Landmark and how far it is pulled, mm."""


def asymmetry(actor, regions, n_components=20, template=None):
    """One-sided expressions by models that were trained on symmetric motion alone.

    Parameters
    ----------
    actor : RegisteredActor
        Its training sentences, registered; its rig makes the one-sided expressions, free of noise.
    regions : Regions
    n_components : int, default=20
        Of the holistic model, and of each region.
    template : TriangleMesh, optional
        The symmetric face that the actor was registered by; `load_template` if left out.

    Returns
    -------
    list of dict
        A row for each training motion (as it is, or symmetrised), model and expression: `error_mm`
        and `other_side`, the share of the motion made that lies on the right. Expressions are
        units of the left side, and pulls at it, which have no error.
    """
    template = (
        data.load_template(actor.capture.neutral.n_vertices) if template is None else template
    )
    middle = actor.mesh.with_vertices(template.vertices[actor.samples])
    X = actor.motion("train").displacements()
    rig = actor.capture.rig
    at = np.eye(len(rig.names))[[rig.names.index(name) for name in ONE_SIDED]]
    moved = rig.animate(at, actor.samples) - rig.neutral.vertices[actor.samples]
    wanted = moved.reshape(len(moved), -1)
    rows = []
    for training, frames in (
        ("as it is", X),
        ("symmetrised", symmetrised(X, mirror_weights(middle))),
    ):
        for name, model in {
            "holistic": HolisticModel(n_components),
            "region beta=0": RegionModel(regions, n_components, 0.0),
            "region beta=0.5": RegionModel(regions, n_components, 0.5),
        }.items():
            model.fit(frames)
            rest = model.reconstruct(np.zeros_like(wanted[:1]))
            made = model.reconstruct(wanted)
            for unit, x, x_hat in zip(ONE_SIDED, wanted, made, strict=True):
                rows.append(
                    dict(
                        training=training,
                        model=name,
                        expression=unit,
                        error_mm=rms_error(x[None], x_hat[None]),
                        other_side=float(other_side(x_hat[None] - rest, middle)[0]),
                    )
                )
            for landmark, pull in PULLS.items():
                session = PosingSession(model, middle, beta=model.beta)
                place = template.vertices[template.landmarks[landmark]]
                vertex = int(np.linalg.norm(middle.vertices - place, axis=1).argmin())
                session.drag(vertex, middle.vertices[vertex] + pull)
                posed = (session.vertices - middle.vertices).reshape(1, -1)
                rows.append(
                    dict(
                        training=training,
                        model=name,
                        expression=f"pull {landmark}",
                        error_mm=None,
                        other_side=float(other_side(posed, middle)[0]),
                    )
                )
    return rows


# --- tables ---------------------------------------------------------------------------------------


def table(curves, data, people=None):
    """Errors as rows: one for each training set, family, size, target and person.

    Parameters
    ----------
    curves : dict of (str, str, str) to ErrorCurve
    data : str
        Name of the data set, for the first column.
    people : sequence of str, optional
        Who is tested: the part of a take's name before the slash. All frames together if left out.

    Returns
    -------
    list of dict
        With E_RMS and its 90 % band by the bootstrap over takes, millimetres.
    """
    rows = []
    for (training, family, target), curve in curves.items():
        for person in people or [None]:
            part = curve
            if person is not None:
                part = curve.of(np.char.startswith(curve.takes, f"{person}/"))
            low, high = part.band()
            for i, rms in enumerate(part.rms):
                rows.append(
                    dict(
                        data=data,
                        training=training,
                        test=person or "alex_rom_4",
                        model=family,
                        components=int(part.components[i]),
                        parameters=int(part.parameters[i]),
                        target=target,
                        rms_mm=round(float(rms), 4),
                        low_mm=round(float(low[i]), 4),
                        high_mm=round(float(high[i]), 4),
                    )
                )
    return rows


def write_csv(path, rows):
    """Rows as CSV, whole or not at all; None is left empty."""
    with atomic_path(path) as part, open(part, "w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def main(arguments=None):
    """Write `generalisation.csv` and `asymmetry.csv`; say what is missing."""
    parser = argparse.ArgumentParser(
        prog="python -m facelab.studies.generalisation", description=__doc__
    )
    parser.add_argument("--out", default="results", type=Path, help="folder for the CSV files")
    out = parser.parse_args(arguments).out
    out.mkdir(parents=True, exist_ok=True)
    for name in ("generalisation.csv", "asymmetry.csv"):
        check_writable(out / name)  # before minutes of work
    actors = load_actors()
    regions = face_regions(actors["M1"])
    rows = table(synthetic(actors, regions), "synthetic actors", ACTORS)
    try:
        rows += table(real()[0], "generic face, alex takes")
    except data.DataUnavailable as missing:
        print(f"Without the generic face: {missing}")
    sides = asymmetry(actors["M1"], regions)
    write_csv(out / "generalisation.csv", rows)
    write_csv(out / "asymmetry.csv", [dict(data="synthetic actor M1", **row) for row in sides])
    print(f"{len(rows)} errors in {out / 'generalisation.csv'}, {len(sides)} in asymmetry.csv")


if __name__ == "__main__":
    main()
