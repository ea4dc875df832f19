"""A registration where the truth is known: place, head pose, hidden markers."""

from functools import partial

import numpy as np

from facelab.geometry import procrustes, rigid_motion
from facelab.models.evaluation import rms_error
from facelab.registration import fit_markers, register_sequence
from facelab.studies.few_markers import rms, thinned_fit
from facelab.studies.kept import kept


def misplaced(actor, V):
    """Distance of each vertex from its true place on the actor's skin, mm: (n_vertices,).

    Parameters
    ----------
    actor : RegisteredActor
    V : ndarray of shape (n_vertices, 3)
        A shape of the template, anywhere in space.
    """
    true = actor.capture.neutral.vertices
    return np.linalg.norm(V - procrustes(true, V).apply(true), axis=1)


def refused(template, positions, names):
    """The words with which markers are refused; None where they are taken.

    Parameters
    ----------
    template : TriangleMesh
    positions : ndarray of shape (n_markers, 3)
    names : sequence of str
    """
    try:
        fit_markers(template, positions, names)
    except ValueError as error:
        return str(error)
    return None


def spoilt_names(names):
    """Names of markers as they go wrong: what happened to the names after it.

    Returns
    -------
    dict of str to list of str
    """
    i, j = names.index("chin"), names.index("nose_tip")
    return {
        "left and right of the brows exchanged": [
            _other_side(n) if n.startswith("brow") else n for n in names
        ],
        "left and right of all exchanged": [_other_side(n) for n in names],
        "chin and nose exchanged": [
            names[{i: j, j: i}.get(k, k)] for k in range(len(names))
        ],
        "all shifted by one": [*names[1:], names[0]],
    }  # fmt: skip


def _other_side(name):
    return name.replace("left", "*").replace("right", "left").replace("*", "right")


def head_ways(actor, take):
    """The head's motion in a take by three ways: dict of "paper", "whole" and "rigid".

    "paper" is ordinary Procrustes of the template's samples, "whole" that of all markers, "rigid"
    the package's default.
    """
    rigid, whole = actor.registration(take), actor.registration(take, head="whole")
    samples = actor.samples
    room = rigid.head.to_capture(rigid.positions(None, samples).astype(float))
    paper = rigid_motion(room, rigid.fit.mesh.vertices[samples])
    return {"paper": paper, "whole": whole.head, "rigid": rigid.head}


def head_errors(actor, take):
    """Error of each way in every frame of a take: dict of way to degrees and mm.

    Where a way puts its origin is its own choice: that constant is read off the first frames, at
    rest. Kept in the cache.
    """
    found = kept(
        "registration_trials.head_errors",
        [*_told_by(actor), take],
        lambda: _head_errors(actor, take),
    )
    return {way: tuple(errors) for way, errors in found.items()}


def _told_by(actor):
    """What says which actor, capture and fit this is."""
    return actor.capture.seal, actor.fit.mesh.vertices, actor.fit.rest, actor.fit.preset


def _head_errors(actor, take):
    truth, points = actor.capture.truth(take), actor.capture.neutral.vertices[actor.samples]
    room = points @ np.swapaxes(truth.rotation, 1, 2) + truth.translation[:, None]
    found = {}
    for way, head in head_ways(actor, take).items():
        link = procrustes(points, head.to_head(room)[:12].mean(axis=0))
        R = head.rotation @ link.rotation
        t = head.rotation @ link.translation + head.translation
        cosine = (np.einsum("fij,fij->f", R, truth.rotation) - 1) / 2
        degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        found[way] = np.stack([degrees, np.linalg.norm(t - truth.translation, axis=1)])
    return found


def met(actor, takes):
    """Registered takes against the skin itself: frames, error and motion, both mm RMS.

    Parameters
    ----------
    actor : RegisteredActor
    takes : str or sequence of str
        As `RegisteredActor.motion` takes them. What is found is kept in the cache.
    """

    def judged():
        found, true = (m.displacements() for m in (actor.motion(takes), actor.truth(takes)))
        return {"mm": [rms_error(true, found), rms_error(true, 0 * true)], "frames": len(found)}

    names = actor.names(takes)
    stored = kept("registration_trials.met", [*_told_by(actor), actor.fps, names], judged)
    return int(stored["frames"]), *stored["mm"].tolist()


def hidden_cost(actor, take, shares, n_frames=240, every=8):
    """Error of the covered skin with a share of the markers hidden, mm RMS: list of float.

    Kept in the cache, share by share.

    Parameters
    ----------
    actor : RegisteredActor
    take : str
    shares : iterable of float
        0 to 1; hidden in bursts of 0.12 s.
    n_frames, every : int
        So many first frames, one in so many judged.
    """

    def cost(share):
        given = actor.capture.markers(take)[:n_frames].with_gaps(share, random_state=0)
        return {"mm": _covered_error(actor, actor.fit, given, take, every)}

    of = (*_told_by(actor), take, n_frames, every)
    study = "registration_trials.hidden_cost"
    return [float(kept(study, [*of, float(s)], partial(cost, s))["mm"]) for s in shares]


def thinned_cost(actor, take, counts, n_frames=120, every=8):
    """Error of the covered skin with fewer markers: rows of (count, warp, prior), mm RMS.

    The prior knows of no other face: only that both sides of a face mostly do the same. Kept in
    the cache, count by count.
    """

    def cost(count):
        given = actor.capture.markers(take)[:n_frames]
        fit = thinned_fit(actor.fit, count)
        fits = fit, fit.with_prior()
        return {"mm": [_covered_error(actor, f, given, take, every) for f in fits]}

    of = (*_told_by(actor), take, n_frames, every)
    study = "registration_trials.thinned_cost"
    counts = [min(count, len(actor.fit.names)) for count in counts]
    return [(n, *kept(study, [*of, n], partial(cost, n))["mm"].tolist()) for n in counts]


def covered(actor):
    """`actor.covered`, kept in the cache: skin near a marker, bool, shape (n_vertices,)."""
    study = "registration_trials.covered"
    return kept(study, _told_by(actor), lambda: {"skin": actor.covered})["skin"]


def _covered_error(actor, fit, markers, take, every):
    """Error of the covered skin in some frames of a take, mm RMS."""
    registration = register_sequence(fit, markers)
    errors = actor.errors(registration, take, slice(0, markers.n_frames, every))
    return rms(errors[:, covered(actor)])
