"""How near the skin between few markers is told: the tables of notebook 02.

On a real capture nobody knows the skin, so each marker is left out in turn and told from the
others. On the synthetic actors the skin is known, and markers are thinned out.
`python -m facelab.studies.few_markers` prints all of it.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial.distance import cdist
from tqdm.auto import tqdm

from facelab import data
from facelab.geometry.alignment import rigid_motion, rigid_weights
from facelab.geometry.binding import bind_to_samples
from facelab.geometry.closest import closest_points
from facelab.geometry.symmetry import mirror_weights, mirrored
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.registration import MarkerFit, fit_markers, fit_scan, register_sequence, rest_markers
from facelab.rig import BlendshapeRig
from facelab.segmentation.segment import segment_face

COUNTS = (20, 40, 80, 160)
"""Markers that a synthetic actor is thinned to."""

N_REGIONS = 13
"""Regions of a model that serves as prior, as in the paper."""

BESIDE = ("eye_", "lip_", "nose_bridge")
"""Landmarks that markers of the real capture lie beside: glued round the mouth, on the rim of the
orbit. They start no fit, for lips drawn to them would stand open at rest."""

PLAIN = ("three nearest", "radial basis", "thin plate")
"""What the warp and the prior have to beat."""


# --- a real capture: each marker left out ---------------------------------------------------------


def real_fit(template=None):
    """The template fitted to the face of the real capture, and the takes: MarkerFit, dict.

    Raises
    ------
    DataUnavailable
        If the capture is not on this machine and cannot be downloaded.
    """
    glued = {a: b for a, b in data.ANIMFACE_LANDMARKS.items() if not b.startswith(BESIDE)}
    takes = {name: data.load_markers(name).renamed(glued) for name in data.MARKERS}
    template = data.load_template() if template is None else template
    return fit_markers(template, *rest_markers(list(takes.values()))), takes


class FewMarkers(NamedTuple):
    """A face seen by few markers, and its takes."""

    fit: MarkerFit
    takes: dict
    """Take (MarkerSequence) by name."""
    about: str
    """What it is, real or synthetic, in a sentence."""
    credit: str
    """To be printed on every figure that shows it."""


def load_few_markers(template, actor=None):
    """The real capture, or a synthetic actor where it cannot be had: FewMarkers.

    Parameters
    ----------
    template : TriangleMesh
    actor : RegisteredActor, optional
        Stands in, with as many markers; M1 if left out.
    """
    try:
        fit, takes = real_fit(template)
    except data.DataUnavailable as missing:
        actor = data.load_registered("M1") if actor is None else actor
        fit = thinned_fit(actor.fit, 41)
        takes = {name: actor.capture.markers(name) for name in actor.names("train")[:2]}
        about = f"SYNTHETIC: {actor.name} with 41 of the markers stands in. (Real data: {missing})"
        return FewMarkers(fit, takes, about, "synthetic")
    about = f"REAL: an optical capture of {len(fit.names)} markers, takes {', '.join(takes)}."
    return FewMarkers(fit, takes, about, "CC BY-SA 4.0, Miguel Ramos Carretero")


def moved_markers(fit, take, every=4):
    """Markers of a take from rest, the head's motion taken away: (n_frames, n_markers, 3), mm.

    Parameters
    ----------
    fit : MarkerFit
        Of the same face; every marker of it is in the take.
    take : MarkerSequence
    every : int, default=4
        Of how many frames one is looked at; of those, the ones that show all markers.
    """
    positions = take.select(fit.names).positions[::every]
    positions = positions[np.isfinite(positions).all(axis=(1, 2))]
    some = positions[np.linspace(0, len(positions) - 1, min(len(positions), 200)).astype(int)]
    head = rigid_motion(positions, fit.rest, rigid_weights(some, fit.rest), robust=True)
    return head.to_head(positions) - fit.rest


def left_out(fits, moved):
    """Error at each marker when the others tell it, by several ways.

    Parameters
    ----------
    fits : dict of str to MarkerFit
        Of the same markers; the layouts that are compared.
    moved : ndarray of shape (n_frames, n_markers, 3)
        From `moved_markers`.

    Returns
    -------
    dict of str to ndarray of shape (n_frames, n_markers)
        Distances, mm: of the ways in `PLAIN`, then of the fits.
    """
    rest = next(iter(fits.values())).rest
    weights = {way: np.zeros((len(rest), len(rest))) for way in PLAIN}
    for i, apart in enumerate(cdist(rest, rest)):
        others = np.delete(np.arange(len(rest)), i)
        weights["three nearest"][i, others[apart[others].argsort()[:3]]] = 1 / 3
        for way, kind in (("radial basis", "linear"), ("thin plate", "thin_plate_spline")):
            field = RBFInterpolator(rest[others], np.eye(len(others)), kernel=kind)
            weights[way][i, others] = field(rest[i : i + 1])[0]
    off = {way: moved - np.matmul(W, moved) for way, W in weights.items()}
    off |= {name: fit.layout.left_out(moved) for name, fit in fits.items()}
    return {name: np.linalg.norm(e, axis=2) for name, e in off.items()}


def rms(errors, axis=None):
    """Root of the mean square."""
    return np.sqrt((np.asarray(errors, dtype=float) ** 2).mean(axis=axis))


# --- models to fill from --------------------------------------------------------------------------


def generic_motion(template, samples, fps=5.0):
    """The generic face's two takes on samples of the template: displacements, (n_frames, 3 n), mm.

    Raises
    ------
    DataUnavailable
        If the generic face or its takes are not at hand.
    """
    rig = data.load_ict_facekit()
    fit = fit_scan(template, rig.neutral)
    face = rig.neutral.with_vertices(fit.alignment.apply(rig.neutral.vertices))
    faces, weights = closest_points(face, fit.mesh.vertices[samples])
    corners = rig.neutral.faces[faces]
    deltas = np.einsum("nc,kncx->knx", weights, rig.deltas[:, corners])
    deltas = deltas @ fit.alignment.rotation.T
    worn = BlendshapeRig(template.subsample(len(samples))[1], rig.names, deltas)
    moved = [worn.animate(data.load_take(name).resampled(fps)) for name in data.TAKES]
    return np.concatenate([motion.displacements() for motion in moved])


def prior_models(motions, template, samples, n_holistic=60, n_region=10):
    """A holistic and a region model of the motion of several faces, each frame mirrored too.

    Parameters
    ----------
    motions : sequence of ndarray of shape (n_frames, 3 * n_samples)
        Displacements of each face; all faces count alike, whatever the length and the size of
        their motion.
    template : TriangleMesh
    samples : ndarray of int, shape (n_samples,)
    n_holistic, n_region : int
        Modes of the one, and of each region of the other.

    Returns
    -------
    list of FaceModel
    """
    small = template.subsample(len(samples))[1]
    mirror = mirror_weights(small)
    frames = []
    for X in motions:
        both = np.concatenate([X, mirrored(X, mirror)])
        frames.append(both / np.sqrt((both**2).sum(axis=1).mean() * len(both) / 1e6))
    X = np.concatenate(frames)
    motion = MotionSequence(X.reshape(len(X), -1, 3) + small.vertices, 15.0, small)
    regions = segment_face(motion, n_regions=N_REGIONS, random_state=0, progress=False)
    return [HolisticModel(n_holistic).fit(X), RegionModel(regions, n_region).fit(X)]


def models_at_hand(template, actors):
    """Models to fill from: of synthetic actors and, where it can be had, of the generic face.

    Parameters
    ----------
    template : TriangleMesh
    actors : sequence of RegisteredActor

    Returns
    -------
    dict of str to list of FaceModel
        On the actors' samples.
    """
    samples = actors[0].samples
    motions = [actor.truth("train").displacements() for actor in actors]
    found = {"synthetic actors": prior_models(motions, template, samples)}
    try:
        generic = generic_motion(template, samples)
    except data.DataUnavailable:
        return found
    return found | {"generic face": prior_models([generic], template, samples)}


# --- synthetic actors: fewer markers --------------------------------------------------------------


def thinned_fit(fit, count):
    """A fit with fewer markers, spread as evenly as can be: MarkerFit.

    The neutral is that of all markers, so that only motion is compared.
    """
    near = np.linalg.norm(fit.rest - fit.rest.mean(axis=0), axis=1)
    chosen = [int(near.argmin())]
    far = np.full(len(near), np.inf)
    while len(chosen) < count:
        far = np.minimum(far, np.linalg.norm(fit.rest - fit.rest[chosen[-1]], axis=1))
        chosen.append(int(far.argmax()))
    at = np.sort(chosen)
    some = {k: getattr(fit, k)[at] for k in ("rest", "faces", "weights", "residuals")}
    return replace(fit, names=tuple(fit.names[i] for i in at), **some)


def by_count(actors, n_takes=1, every=16, progress=True):
    """Dense error on the synthetic actors against the number of markers, mm RMS over the skin.

    Parameters
    ----------
    actors : dict of str to RegisteredActor
    n_takes : int, default=1
        Test takes of each actor.
    every : int, default=16
        Of how many frames one is measured.
    progress : bool, default=True
        Show a progress bar.

    Returns
    -------
    dict of (str, int) to dict of str to float
        From actor and number of markers to the error of each way: "radial basis", "warp", and
        "prior", of models trained on the other actors.
    """
    found = {}
    first = next(iter(actors.values()))
    binding = bind_to_samples(first.fit.mesh, first.samples)  # all have the same triangles
    total = sum(count <= len(a.fit.names) for a in actors.values() for count in COUNTS)
    with tqdm(total=total, desc="fewer markers", disable=not progress, leave=False) as bar:
        for name, actor in actors.items():
            others = [a.truth("train").displacements() for n, a in actors.items() if n != name]
            mesh = actor.fit.mesh
            models = prior_models(others, mesh, actor.samples)
            takes = actor.names("test")[:n_takes]
            for count in COUNTS:
                if count > len(actor.fit.names):
                    continue
                fit = thinned_fit(actor.fit, count)
                fits = {"warp": fit, "prior": fit.with_prior(*models, binding=binding)}
                errors = {"radial basis": [], "warp": [], "prior": []}
                field = RBFInterpolator(fit.rest, np.eye(count), kernel="linear")(mesh.vertices)
                for take in takes:
                    markers = actor.capture.markers(take)
                    for way, fit in fits.items():
                        made = register_sequence(fit, markers)
                        frames = np.arange(0, markers.n_frames, every)
                        frames = frames[made.valid[frames]]
                        errors[way].append(actor.errors(made, take, frames).ravel())
                    errors["radial basis"].append(_apart(actor, field, made, take, frames))
                found[name, count] = {
                    way: float(rms(np.concatenate(e))) for way, e in errors.items()
                }
                bar.update()
    return found


def _apart(actor, field, made, take, frames):
    """Errors of displacements by weights of the markers."""
    true = actor.capture.surface(take, frames) - actor.capture.neutral.vertices
    moved = np.matmul(field, made.displacements[frames])
    return np.linalg.norm(moved - true @ actor.link.rotation.T, axis=2).ravel()


def _print(head, rows):
    print(*(f"{h:>16}" for h in head))
    for name, *values in rows:
        print(f"{name:>26}", *(f"{v:16.2f}" for v in values), flush=True)


def main():
    """Print both tables: markers left out of the real capture, and our actors with ever fewer."""
    template = data.load_template()
    actors = {name: data.load_registered(name) for name in data.ACTORS}
    real = load_few_markers(template)
    models = models_at_hand(template, list(actors.values()))
    binding = bind_to_samples(real.fit.mesh, next(iter(actors.values())).samples)
    fits = {"our warp": real.fit, "prior: sides alike": real.fit.with_prior()}
    for kind, some in models.items():
        fits[f"prior: {kind}"] = real.fit.with_prior(*some, binding=binding)
    all_of_them = [m for some in models.values() for m in some]
    fits["prior: all"] = real.fit.with_prior(*all_of_them, binding=binding)
    errors = [left_out(fits, moved_markers(real.fit, take)) for take in real.takes.values()]
    print(real.about, "Each marker left out in turn, mm RMS:", sep="\n")
    _print(real.takes, [(way, *(rms(e[way]) for e in errors)) for way in (*PLAIN, *fits)])
    print("Synthetic actors, all the skin, mm RMS; the prior is of the other three:")
    counted = by_count(actors)
    ways = next(iter(counted.values()))
    _print(ways, [(f"{name}, {n} markers", *e.values()) for (name, n), e in counted.items()])


if __name__ == "__main__":
    main()
