"""A hand for views without a page: it sends the kernel what the page would."""

import numpy as np


def in_scene(view, point):
    """A point of the head frame as the page tells it: from the middle of the face."""
    V = view.mesh.vertices
    return tuple(np.asarray(point) - (V.min(axis=0) + V.max(axis=0)) / 2)


def pick(view, picker, vertex, point=None, shift=False):
    """What the page sends when the mouse does something on a vertex of the face."""
    with picker.hold_trait_notifications():
        picker.object = view._face
        picker.face = [float(vertex)] * 3
        picker.modifiers = [shift, False, False, False]
        picker.point = in_scene(view, view._V[vertex] if point is None else point)


def move(view, offset):
    """Move what is held by an offset in millimetres from where it was taken hold of."""
    view._moved.object = view._plane
    view._moved.point = in_scene(view, view._grab + offset)
