"""What a pull does to the rest of the face: copies before blending, energy that goes astray."""

import numpy as np

from facelab.posing import PosingSession


def pulled(model, mesh, pins, **settings):
    """A session with pins set one after the other.

    Parameters
    ----------
    model : FaceModel
    mesh : TriangleMesh
    pins : dict of str or int to array_like of shape (3,)
        Landmark or vertex to offset, mm.
    **settings
        For `PosingSession`, such as beta, gamma or binding.
    """
    session = PosingSession(model, mesh, **settings)
    for name, offset in pins.items():
        vertex = mesh.landmarks[name] if isinstance(name, str) else int(name)
        session.pull(vertex, mesh.vertices[vertex] + np.asarray(offset, dtype=float))
    return session


def copies(session, region):
    """Where one region alone puts its vertices, before blending: members, positions in mm."""
    model, members = session.model, session.model.members_[region]
    moved = session.coefficients[model.slices_[region]] @ model.components_[region]
    return members, session.neutral.vertices[members] + moved.reshape(-1, 3)


def astray(session, vertex, outside):
    """Share of a pose's energy that lies outside, 0 to 1: squared motion over the surface.

    Parameters
    ----------
    session : PosingSession
    vertex : int
        The one that was pulled.
    outside : float, or ndarray of int of shape (n_vertices,)
        Farther away than this many mm; or labels: in another region than the vertex.
    """
    mesh = session.neutral
    energy = mesh.vertex_areas * ((session.vertices - mesh.vertices) ** 2).sum(axis=1)
    if np.ndim(outside):
        far = outside != outside[vertex]
    else:
        far = np.linalg.norm(mesh.vertices - mesh.vertices[vertex], axis=1) > outside
    return float(energy[far].sum() / energy.sum())


def many_pulls(model, control, labels, n_pulls=50, size=6.0, random_state=0):
    """Share of the energy outside the pulled region, of random pulls: ndarray of shape (n_pulls,).

    Parameters
    ----------
    model : FaceModel
    control : TriangleMesh
    labels : ndarray of int of shape (n_vertices,)
    n_pulls : int
        Vertices, none twice, each pulled once in a random direction.
    size : float
        Length of a pull, mm.
    random_state : int
        The same pulls for every model.
    """
    rng = np.random.default_rng(random_state)
    vertices = rng.choice(control.n_vertices, n_pulls, replace=False)
    ways = rng.normal(size=(n_pulls, 3))
    ways *= size / np.linalg.norm(ways, axis=1, keepdims=True)
    return np.array(
        [
            astray(pulled(model, control, {v: way}), v, labels)
            for v, way in zip(vertices, ways, strict=True)
        ]
    )


EDITS = {
    "left mouth corner up": ("mouth_corner_left", (4, 6, -2)),
    "right brow up": ("brow_right_3", (0, 6, 0)),
    "left lid down": ("eye_left_upper_outer", (0, -7, 0)),
    "right corner down": ("mouth_corner_right", (-1, -4, 0)),
    "upper lip forward": ("lip_upper", (0, 1, 4)),
}
"""Five edits as in Tena's Figure 7: name to landmark and offset, mm."""


def edited(session, edits=None, far=40.0):
    """One edit after the other, each pin kept: yields name, vertices and motion far away.

    Parameters
    ----------
    session : PosingSession
        Is changed.
    edits : dict, optional
        As `EDITS`, which is the default.
    far : float
        The largest motion farther than this from the edit is what nobody asked for, mm.
    """
    neutral = session.neutral
    for name, (landmark, offset) in (edits or EDITS).items():
        vertex, before = neutral.landmarks[landmark], session.vertices
        session.pull(vertex, neutral.vertices[vertex] + np.asarray(offset, dtype=float))
        moved = np.linalg.norm(session.vertices - before, axis=1)
        away = np.linalg.norm(neutral.vertices - neutral.vertices[vertex], axis=1) > far
        yield name, session.vertices, float(moved[away].max())
