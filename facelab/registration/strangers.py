"""Markers of somebody else, a body or a cap, told by how far they lie off the head."""

import warnings

import numpy as np

from facelab.geometry.closest import closest_points

FACE = 35.0
"""Markers farther from the template than this, brought to the landmarks, are none of the face,
millimetres. With six landmarks or more, right ones of the synthetic actors stay below 9, of random
faces, half of them with the jaw open by 22 mm, below 24."""
_UNSURE = 1 / 3  # of the markers that give no start; right fits leave 0.11 or less unused


def off_face(shapes, points):
    """Distance of points from the nearest of some shapes of a mesh: ndarray (n_points,), mm."""
    place = shapes[0].vertices
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers near the largest there is
        off = np.abs(points - place.mean(axis=0)).max(axis=1)
    near = np.flatnonzero(off < 10 * np.ptp(place, axis=0).max())
    found = []
    for mesh in shapes:
        faces, weights = closest_points(mesh, points[near])
        foot = np.einsum("nk,nkx->nx", weights, mesh.vertices[mesh.faces[faces]])
        found.append(np.linalg.norm(foot - points[near], axis=1))
    off[near] = np.min(found, axis=0)
    return off


def say_left_out(left_out, n_markers):
    """Warn of markers that are none of the face: by name, with their distance."""
    far = sorted(left_out, key=left_out.get, reverse=True)
    shown = ", ".join(f"{name} ({left_out[name]:.3g} mm)" for name in far[:6])
    warnings.warn(
        f"the markers: {len(far)} of {n_markers} lie more than {FACE:.0f} mm off the face that the "
        f"landmarks show and are left out, as of somebody else, a body or a cap: {shown}"
        f"{', ...' * (len(far) > 6)}. If they are of the face, check the names of the landmarks.",
        stacklevel=3,
    )


def check_told(fit):
    """Refuse a fit in which many markers lie off the face, but not far enough to tell whose."""
    lost = np.flatnonzero(~fit.used)
    n_free = len(fit.names) - len(fit.landmarks)
    if len(lost) > max(_UNSURE * n_free, 3):
        far = lost[np.argsort(-fit.residuals[lost])]
        shown = ", ".join(f"{fit.names[i]} ({fit.residuals[i]:.0f} mm)" for i in far[:6])
        raise ValueError(
            f"the markers: {len(far)} of the {n_free} that are no landmarks lie off the face that "
            f"the landmarks show, but too near to tell whose they are: {shown}"
            f"{', ...' * (len(far) > 6)}. Give the markers of one face alone, or name more "
            "landmarks."
        )
