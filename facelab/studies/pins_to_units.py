"""How well the whole chain does, from a few pins to a posed face to its action units."""

import numpy as np

from facelab.expression import ExpressionSession
from facelab.posing import PosingSession

HANDLES = (
    *("mouth_corner_left", "mouth_corner_right", "brow_left_5", "brow_right_5", "lip_lower"),
    *("brow_left_2", "brow_right_2", "lip_upper", "eye_left_upper_outer", "eye_right_upper_outer"),
    *("chin", "nose_tip"),
)
"""Landmarks that are pinned, the first ones first."""


def chain(model, rig, binding, weights, n_pins):
    """The face that pins make of a frame, and how it is read: face error (mm RMS), weight error.

    Parameters
    ----------
    model, binding
        Of a posing session on the rig's neutral.
    rig : BlendshapeRig
    weights : ndarray of shape (n_shapes,)
        Of the frame; only where its landmarks went is told to the session.
    n_pins : int
        How many landmarks; with none the face stays at rest, and all weights 0.
    """
    V = rig.shape(weights)
    if not n_pins:
        off = np.sqrt(((V - rig.neutral.vertices) ** 2).sum(axis=1).mean())
        return float(off), float(np.abs(weights).mean())
    posing = PosingSession(model, rig.neutral, binding=binding)
    for name in HANDLES[:n_pins]:
        vertex = rig.neutral.landmarks[name]
        posing.drag(vertex, V[vertex])
    posing.release()
    reader = ExpressionSession(rig, posing.vertices)
    off = np.sqrt(((reader.vertices - V) ** 2).sum(axis=1).mean())
    return float(off), float(np.abs(reader.weights - weights).mean())


def table(model, rig, binding, frames, counts):
    """Rows of (number of pins, face error mm RMS, weight error), means over frames.

    Parameters
    ----------
    frames : ndarray of shape (n_frames, n_shapes)
        Known weights.
    counts : iterable of int
    """
    return [
        (n, *map(float, np.mean([chain(model, rig, binding, w, n) for w in frames], axis=0)))
        for n in counts
    ]
