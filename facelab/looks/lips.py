"""What comes through between the lips: light onto the teeth, and teeth not through closed lips."""

import numpy as np
from scipy.sparse.csgraph import dijkstra

_BINS = 16  # across the mouth
_BEND = 4  # degree of the line of the mouth
_ARCH = 0.012  # 1/mm: how the lips lie further back to the sides
_FULL = 0.4  # of all light: with so much teeth are as bright as they can be
_CLOSED = 3.0  # mm: lips less far apart dim what is behind them, and hold it back
_BEHIND = 0.3  # mm between closed lips and teeth
_NEAREST = 0.3  # mm: a tooth at the lips or before them is lit as from so far behind


class Lips:
    """The gap between the lips of a posed face, and what it lets through.

    Lips seldom meet to the last tenth of a millimetre, and teeth that are lit as skin is shine
    through as white specks. Here a tooth gets the light of a long slit: what share of the light
    from ahead comes past the upper and the lower lip.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, head frame, millimetres, with the landmarks of the corners of the mouth,
        `lip_upper` and `lip_lower`.
    at : ndarray of shape (3,)
        Where the upper front teeth are.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> at = rig.neutral.vertices[rig.neutral.landmarks["lip_upper"]] - [0, 8, 12]
    >>> share, _ = Lips(rig.neutral, at).seen(rig.neutral.vertices, at[None])
    >>> bool(share[0] < 0.3)  # the mouth is closed
    True
    """

    def __init__(self, mesh, at):
        V, marks = mesh.vertices, mesh.landmarks
        ends = [marks["mouth_corner_right"], marks["mouth_corner_left"]]
        right, left = V[ends]
        scale = np.linalg.norm(left - right) / 50
        off = (V - at) / scale
        # before the teeth, and between the corners
        off[:, 1] -= ((right + left)[1] / 2 - at[1]) / scale * (off[:, 0] / 25) ** 2
        near = (np.abs(off[:, 0]) < 27) & (np.abs(off[:, 1]) < 10)
        near &= off[:, 2] > -1 - 2 * _ARCH * off[:, 0] ** 2
        # along the skin it is far from one lip to the other, however near they are
        start = [marks["lip_upper"], marks["lip_lower"]]
        above, below = dijkstra(mesh.adjacency, directed=False, indices=start)
        near = np.flatnonzero(near & (above != below))
        self._upper, self._all = (above < below)[near], np.concatenate([ends, near])
        self._last = self._found = None

    def seen(self, vertices, points):
        """What lips let through to what lies behind them.

        Parameters
        ----------
        vertices : ndarray of shape (n_vertices, 3)
            The posed face, millimetres.
        points : ndarray of shape (n, 3)
            Of teeth or a tongue.

        Returns
        -------
        share : ndarray of shape (n,)
            Of the brightness that each has in an open mouth, 0 to 1.
        points : ndarray of shape (n, 3)
            Those that would come through closed lips held behind them.
        """
        V = vertices[self._all]
        if not np.array_equal(V, self._last):  # several parts ask in turn
            self._last, self._found = V, self._edges(V)
        start, across, line, edges = self._found
        u = ((points[:, 0] - start) / across).clip(0, 1)
        (top, top_z), (low, low_z) = (
            (np.interp(u, knots, heights), np.interp(u, knots, depths))
            for knots, heights, depths in edges
        )
        # form factor of a slit: half the difference of the sines of the angles to its edges
        y, z = points[:, 1] - _powers(u) @ line, points[:, 2]
        light = (_sine(top - y, top_z - z) - _sine(low - y, low_z - z)) / 2
        parted = ((top - low) / _CLOSED).clip(0, 1)
        t = parted * (light / _FULL).clip(0, 1)
        held = (1 - parted) * (z - np.minimum(top_z, low_z) + _BEHIND).clip(0)
        if held.any():
            points = points - held[:, None] * [0, 0, 1]
        return t * t * (3 - 2 * t), points

    def _edges(self, V):
        """Where the mouth starts, how wide and how bent it is, and the edges of its lips."""
        right, left = V[:2]
        across = left[0] - right[0]
        V = V[2:]
        at = (V[:, 0] - right[0]) / across
        # the line of the mouth may be steep: heights are counted from it
        X = _powers(at)
        line = np.linalg.solve(X.T @ X, X.T @ V[:, 1])
        height = V[:, 1] - X @ line
        ends = np.array([right[1] - line[0], left[1] - line.sum()])
        between, edges = (at > 0) & (at < 1), []
        for own, sign in ((self._upper, 1), (~self._upper, -1)):
            these = np.flatnonzero(own & between)
            bins = (at[these] * _BINS).astype(int)
            order = np.lexsort((sign * height[these], bins))  # the lowest or highest skin first
            first = order[np.flatnonzero(np.diff(bins[order], prepend=-1))]
            lip = these[first]
            knots = np.concatenate([[0], (bins[first] + 0.5) / _BINS, [1]])
            heights = np.concatenate([ends[:1], height[lip], ends[1:]])
            depths = np.concatenate([right[2:], V[lip, 2], left[2:]])
            edges.append((knots, heights, depths))
        return right[0], across, line, edges


def _powers(u):
    return np.vander(u, _BEND + 1, increasing=True)


def _sine(up, ahead):
    return up / np.hypot(up, np.maximum(ahead, _NEAREST))
