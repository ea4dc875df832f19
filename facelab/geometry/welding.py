"""Vertices at the same place: which they are, and what is left of the triangles."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


def same_place(vertices, tolerance=0.0):
    """A number for each vertex, the same for all in one place, ascending as they first stand.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
    tolerance : float, default=0.0
        Distance over which vertices count as in one place, from one to the next.

    Returns
    -------
    index : ndarray of int, shape (n_vertices,)

    Raises
    ------
    ValueError
        For a tolerance that spans whole neighbourhoods.

    Examples
    --------
    >>> same_place(np.array([[5, 0, 0], [1, 0, 0], [5, 0, 0], [1, 0, 1]])).tolist()
    [0, 1, 0, 2]
    """
    order = np.lexsort(vertices.T)
    ahead = vertices[order]
    index = np.empty(len(vertices), dtype=int)
    index[order] = np.cumsum(np.append(False, (ahead[1:] != ahead[:-1]).any(axis=1)))
    if tolerance > 0:
        places = np.unique(index, return_index=True)[1]
        tree = cKDTree(vertices[places])
        if tree.count_neighbors(tree, tolerance) > 30 * len(places):
            raise ValueError(
                f"tolerance={tolerance:g} joins vertices with whole neighbourhoods; give less than "
                "the length of an edge."
            )
        a, b = tree.query_pairs(tolerance, output_type="ndarray").T
        near = sp.coo_array((np.ones(len(a)), (a, b)), shape=(len(places),) * 2)
        index = connected_components(near, directed=False)[1][index]
    return numbered(index)


def near_borders(vertices, faces, tolerance):
    """As `same_place`, for borders alone: all vertices within a surface are places of their own.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
    faces : ndarray of int, shape (n_faces, 3)
    tolerance : float
        Where it spans whole neighbourhoods, as in a tuft of hair, borders are told apart exactly.

    Returns
    -------
    index : ndarray of int, shape (n_vertices,)
    """
    ends = np.sort(np.stack([faces.T.ravel(), np.roll(faces, -1, axis=1).T.ravel()]), axis=0)
    edges, count = np.unique(ends.T, axis=0, return_counts=True)
    border, index = np.unique(edges[count == 1]), np.arange(len(vertices))
    if len(border):
        try:
            near = same_place(vertices[border], tolerance)
        except ValueError:
            near = same_place(vertices[border])
        index[border] = len(vertices) + near
    return numbered(index)


def numbered(index):
    """The same groups, numbered from 0 in the order in which they first stand."""
    _, first, inverse = np.unique(index, return_index=True, return_inverse=True)
    place = np.empty(len(first), dtype=int)
    place[np.argsort(first)] = np.arange(len(first))
    return place[inverse.ravel()]


def alike(place, shapes, tolerance):
    """Groups of vertices that are in one place and move alike.

    Parameters
    ----------
    place : ndarray of int, shape (n_vertices,)
        From `same_place`.
    shapes : sequence of ndarray of shape (n_vertices, 3)
        Displacements.
    tolerance : float
        By which those of a vertex may differ from those of the first of its group.

    Returns
    -------
    index : ndarray of int, shape (n_vertices,)
        Numbered as they first stand.
    """
    group = np.full(len(place), -1)
    left = np.arange(len(place))
    while len(left):  # each round gives every place one more group, led by its first vertex left
        at, first = np.unique(place[left], return_index=True)
        leader = left[first][np.searchsorted(at, place[left])]
        differ = np.zeros(len(left))
        several = leader != left
        for shape in shapes:
            off = np.abs(shape[left[several]] - shape[leader[several]]).max(axis=1, initial=0)
            differ[several] = np.maximum(differ[several], off)
        joins = differ <= tolerance
        group[left[joins]] = leader[joins]
        left = left[~joins]
    return numbered(group)


def rejoined(faces, index):
    """Triangles after vertices were joined, without those that shrank to a line or a point."""
    return index[faces[~shrunk(faces, index)]]


def shrunk(faces, index):
    """Whether each triangle shrank to a line or a point when vertices were joined: bool."""
    faces = index[faces]
    return (faces == np.roll(faces, 1, axis=1)).any(axis=1)
