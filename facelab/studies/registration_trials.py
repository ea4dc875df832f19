"""A registration where the truth is known: place, head pose, hidden markers."""

import numpy as np

from facelab.geometry import procrustes, rigid_motion
from facelab.registration import fit_markers, register_sequence
from facelab.studies.few_markers import rms, thinned_fit


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
    rest.
    """
    truth, points = actor.capture.truth(take), actor.capture.neutral.vertices[actor.samples]
    room = points @ np.swapaxes(truth.rotation, 1, 2) + truth.translation[:, None]
    found = {}
    for way, head in head_ways(actor, take).items():
        link = procrustes(points, head.to_head(room)[:12].mean(axis=0))
        R = head.rotation @ link.rotation
        t = head.rotation @ link.translation + head.translation
        cosine = (np.einsum("fij,fij->f", R, truth.rotation) - 1) / 2
        degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        found[way] = degrees, np.linalg.norm(t - truth.translation, axis=1)
    return found


def hidden_cost(actor, take, shares, n_frames=240, every=8):
    """Error of the covered skin with a share of the markers hidden, mm RMS: list of float.

    Parameters
    ----------
    actor : RegisteredActor
    take : str
    shares : iterable of float
        0 to 1; hidden in bursts of 0.12 s.
    n_frames, every : int
        So many first frames, one in so many judged.
    """
    given, frames = actor.capture.markers(take)[:n_frames], slice(0, n_frames, every)
    runs = (register_sequence(actor.fit, given.with_gaps(s, random_state=0)) for s in shares)
    return [float(rms(actor.errors(run, take, frames)[:, actor.covered])) for run in runs]


def thinned_cost(actor, take, counts, n_frames=120, every=8):
    """Error of the covered skin with fewer markers: rows of (count, warp, prior), mm RMS.

    The prior knows of no other face: only that both sides of a face mostly do the same.
    """
    given, frames = actor.capture.markers(take)[:n_frames], slice(0, n_frames, every)
    rows = []
    for count in counts:
        fit = thinned_fit(actor.fit, min(count, len(actor.fit.names)))
        runs = [register_sequence(f, given) for f in (fit, fit.with_prior())]
        mm = [float(rms(actor.errors(run, take, frames)[:, actor.covered])) for run in runs]
        rows.append((len(fit.names), *mm))
    return rows
