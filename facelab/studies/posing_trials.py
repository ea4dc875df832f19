"""Poses of Tena et al. 2011, Fig. 1 and 7, by regions and by the whole face, and their reach."""

from dataclasses import dataclass

import numpy as np

from facelab.checks import check_number
from facelab.posing.session import PosingSession

FAR = 40.0
"""Distance along the skin from which motion is elsewhere, millimetres."""

WINK_AND_SMIRK = {
    "mouth_corner_left": (4.0, 6.0, -2.0),
    "eye_left_upper_inner": (0.0, -7.0, -1.0),
    "eye_left_lower_inner": (0.0, 2.0, 0.0),
    "brow_left_3": (0.0, -4.0, 0.0),
}
"""Pulls as in Fig. 1, by landmark, millimetres; the paper prints no numbers."""


@dataclass(frozen=True, eq=False)
class Sculpted:
    """A pose made pull after pull.

    Attributes
    ----------
    vertices : tuple of int
        Those pulled, in order.
    targets : ndarray of shape (n_pulls, 3)
        Millimetres.
    poses : ndarray of shape (n_pulls, n_vertices, 3)
        The face after each pull, millimetres.
    """

    vertices: tuple
    targets: np.ndarray
    poses: np.ndarray


def sculpt(model, mesh, pulls, beta=0.5, gamma=0.025):
    """Consecutive pulls at a face, each kept while the next is made, as in Fig. 7.

    Parameters
    ----------
    model : RegionModel or HolisticModel
        Fitted.
    mesh : TriangleMesh
        The neutral, on the model's vertices.
    pulls : dict of int to (x, y, z)
        Vertex and how far it is pulled from its place in the neutral, millimetres.
    beta, gamma : float
        Of Eq. 9; the paper's by default. A holistic model has no boundaries: Eq. 8.

    Returns
    -------
    Sculpted
    """
    session = PosingSession(model, mesh, beta=beta, gamma=gamma)
    poses, targets = [], []
    for vertex, pull in pulls.items():
        targets.append(mesh.vertices[vertex] + np.asarray(pull, dtype=float))
        session.drag(vertex, targets[-1])
        session.release()
        poses.append(session.vertices.copy())
    return Sculpted(tuple(pulls), np.array(targets), np.array(poses))


@dataclass(frozen=True)
class Locality:
    """How local single pulls are, the mean of several.

    Attributes
    ----------
    parameters : int
        Coefficients of the model.
    followed : float
        How far a pulled vertex goes the way of the pull, millimetres.
    beyond : float
        Motion beyond `FAR` from it, RMS over the vertices there, millimetres.
    """

    parameters: int
    followed: float
    beyond: float

    @property
    def per_millimetre(self):
        """Motion beyond at equal following: for every millimetre that the pulled vertex went.

        Poses are affine in the target, so a longer pull makes both numbers larger alike.
        """
        return self.beyond / self.followed


def locality(model, mesh, pulls, beta=0.5, gamma=0.025, far=FAR):
    """How far single pulls carry: each one alone, from the neutral.

    Parameters
    ----------
    model, mesh, pulls, beta, gamma
        As for `sculpt`.
    far : float, default=40
        Along the skin, millimetres.

    Returns
    -------
    Locality
    """
    far = check_number(far, "far", above=0)
    followed, beyond = [], []
    for vertex, pull in pulls.items():
        pull = np.asarray(pull, dtype=float)
        pose = sculpt(model, mesh, {vertex: pull}, beta, gamma).poses[0]
        moved = pose - mesh.vertices
        there = mesh.geodesics([vertex])[0] > far
        if not there.any():
            raise ValueError(f"far={far:g} mm is beyond the whole face; choose less.")
        followed.append(moved[vertex] @ pull / np.linalg.norm(pull))
        beyond.append(np.sqrt((moved[there] ** 2).sum(axis=1).mean()))
    return Locality(int(model.n_coefficients), float(np.mean(followed)), float(np.mean(beyond)))


def nearest_samples(mesh, dense, names):
    """The vertices of a control mesh nearest to landmarks of the dense one: dict of str to int.

    Parameters
    ----------
    mesh, dense : TriangleMesh
        In the same neutral pose.
    names : iterable of str
    """
    places = {name: dense.vertices[dense.landmarks[name]] for name in names}
    return {
        name: int(np.linalg.norm(mesh.vertices - place, axis=1).argmin())
        for name, place in places.items()
    }
