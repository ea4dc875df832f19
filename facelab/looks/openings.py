"""The openings of a face: where lids and lips end, found from its border or its landmarks."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

SIDES = ("left", "right")
_BINS = 40  # directions in which the rim of an opening without a border is looked for


@dataclass(frozen=True)
class Opening:
    """The rim of an eye or of the mouth.

    Attributes
    ----------
    rim : ndarray of int
        Vertices around it.
    corners : tuple of ndarray of shape (3,)
        Its ends: of an eye the inner and the outer, of the mouth the left and the right.
    """

    rim: np.ndarray
    corners: tuple

    @property
    def width(self):
        """Distance of the ends, millimetres."""
        return float(np.linalg.norm(self.corners[1] - self.corners[0]))


def eye_opening(mesh, side):
    """The opening of the eye at a side, or None for a mesh without its two corners.

    Parameters
    ----------
    mesh : TriangleMesh
        With the landmarks `eye_left_inner`, `eye_left_outer` or those of the right.
    side : {"left", "right"}
    """
    return _opening(mesh, f"eye_{side}_inner", f"eye_{side}_outer")


def mouth_opening(mesh):
    """The opening of the mouth, or None for a mesh without its two corners.

    Where the skin goes on inwards its rim is only the corners: lips touch.
    """
    return _opening(mesh, "mouth_corner_left", "mouth_corner_right", touching=True)


def _opening(mesh, *names, touching=False):
    if not set(names) <= set(mesh.landmarks):
        return None
    corners = tuple(mesh.vertices[mesh.landmarks[name]] for name in names)
    width = np.linalg.norm(corners[1] - corners[0])
    middle = (corners[0] + corners[1]) / 2
    for rim in mesh.boundary_loops:
        off = np.linalg.norm(mesh.vertices[rim].mean(axis=0) - middle)
        # wider than a nostril, narrower than the outline
        if off < 0.35 * width and 0.5 < np.ptp(mesh.vertices[rim][:, 0]) / width < 1.3:
            return Opening(rim, corners)
    if touching:
        return Opening(np.array([mesh.landmarks[name] for name in names]), corners)
    rim = _seen_rim(mesh, middle, width)
    return None if rim is None else Opening(rim, corners)


def _seen_rim(mesh, middle, width):
    """The skin nearest to the middle of an opening, as seen from the front, all around it.

    For faces whose skin goes on inwards behind the lids. What lies deeper is the socket.
    """
    V = mesh.vertices
    near = np.flatnonzero(
        (np.abs(V - middle) < [0.7 * width, 0.8 * width, 0.32 * width]).all(axis=1)
    )
    if len(near) < 8:
        return None
    at = V[near, :2] - middle[:2]
    rim = near
    for _ in range(3):  # lids do not open symmetrically about the line of the corners
        angle = np.arctan2(at[:, 1], at[:, 0])
        sector = np.floor((angle + np.pi) / (2 * np.pi) * _BINS).astype(int) % _BINS
        order = np.lexsort((np.linalg.norm(at, axis=1), sector))
        first = order[np.unique(sector[order], return_index=True)[1]]
        rim = near[first]
        middle = (V[rim, :2].min(axis=0) + V[rim, :2].max(axis=0)) / 2
        at = V[near, :2] - middle
    away = np.linalg.norm(V[rim, :2] - middle, axis=1)
    # skin that goes on across, as on a scan, leaves nothing open
    if len(rim) < 0.6 * _BINS or away.min() < 0.1 * width:
        return None
    # a gap between two vertices of the lid shows what lies beside it
    return rim[away < 1.15 * median_filter(away, 7, mode="wrap")]
