"""What comes through between lips or lids: light onto what lies behind, and nothing else."""

import numpy as np
from scipy.sparse.csgraph import dijkstra

_BINS = 16  # across the opening
_BEND = 4  # degree of the line between its corners
_ARCH = 0.012  # 1/mm, of a mouth 50 mm wide: how lips lie further back to the sides
_FULL = 0.4  # of all light: with so much, what lies behind is as bright as it can be
_BEHIND = 0.3  # mm between closed lips and teeth
_NEAREST = 0.3  # mm: what lies at the lips or before them is lit as from so far behind


def before(mesh, ends, at):
    """Vertices of the lips, as far back as a point that is foremost behind them: (n,) of int.

    Parameters
    ----------
    mesh : TriangleMesh
        At rest, head frame, millimetres.
    ends : (int, int)
        Vertices of the corners.
    at : ndarray of shape (3,)
    """
    right, left = mesh.vertices[list(ends)]
    x, y, z = 50 * (mesh.vertices - at).T / np.linalg.norm(left - right)
    return np.flatnonzero((np.abs(x) < 27) & (np.abs(y) < 10) & (z > -1 - 2 * _ARCH * x**2))


class Gap:
    """The gap between the lips or the lids of a posed face, and what it lets through.

    Lips and lids seldom meet to the last tenth of a millimetre. What lies behind and is lit as skin
    is shines through as white specks.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, head frame, millimetres.
    ends : (int, int)
        Vertices of the corners, the one to the person's right first.
    sides : (int, int)
        A vertex of the upper lip or lid and one of the lower.
    skin : ndarray of int
        Vertices of both, with their edges; see `before`.
    closed : float
        Lips or lids less far apart dim what is behind them, and hold it back, millimetres.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_example().rig.neutral
    >>> corners = [face.landmarks[f"mouth_corner_{side}"] for side in ("right", "left")]
    >>> lips = [face.landmarks[name] for name in ("lip_upper", "lip_lower")]
    >>> at = face.vertices[lips[0]] - [0, 8, 12]
    >>> gap = Gap(face, corners, lips, before(face, corners, at), closed=3.0)
    >>> bool(gap.parted(face.vertices, at[None]) < 0.5)  # the mouth is closed
    True
    """

    def __init__(self, mesh, ends, sides, skin, closed):
        # along the skin it is far from one side to the other, however near they are
        above, below = dijkstra(mesh.adjacency, directed=False, indices=list(sides))[:, skin]
        told = above != below
        self._upper, self._all = (above < below)[told], np.concatenate([ends, skin[told]])
        self._closed = closed
        self._last = self._found = None

    def parted(self, vertices, points):
        """How open it is before each of some points: shape (n,), 0 closed, 1 open.

        Parameters
        ----------
        vertices : ndarray of shape (n_vertices, 3)
            The posed face, millimetres.
        points : ndarray of shape (n, 3)
            Behind the gap.
        """
        t = self._at(vertices, points)[0]
        return t * t * (3 - 2 * t)

    def light(self, vertices, points):
        """The same times the light that a long slit lets through, where teeth lie deep behind it.

        That is the share of the light from ahead that comes past the upper and the lower lip, full
        from `_FULL` on.
        """
        t, y, z, (top, top_z), (low, low_z) = self._at(vertices, points)
        # form factor of a slit: half the difference of the sines of the angles to its edges
        light = (_sine(top - y, top_z - z) - _sine(low - y, low_z - z)) / 2
        t = t * (light / _FULL).clip(0, 1)
        return t * t * (3 - 2 * t)

    def behind(self, vertices, points):
        """The points, with those that would come through closed lips held behind them: (n, 3)."""
        t, _, z, (_, top_z), (_, low_z) = self._at(vertices, points)
        held = (1 - t) * (z - np.minimum(top_z, low_z) + _BEHIND).clip(0)
        return points - held[:, None] * [0, 0, 1] if held.any() else points

    def _at(self, vertices, points):
        """How far it is parted at points, their height and depth, and those of both edges there."""
        V = vertices[self._all]
        if not np.array_equal(V, self._last):  # several parts ask in turn
            self._last, self._found = V, self._edges(V)
        start, across, line, edges = self._found
        u = ((points[:, 0] - start) / across).clip(0, 1)
        top, low = (
            (np.interp(u, knots, heights), np.interp(u, knots, depths))
            for knots, heights, depths in edges
        )
        t = ((top[0] - low[0]) / self._closed).clip(0, 1)
        return t, points[:, 1] - _powers(u) @ line, points[:, 2], top, low

    def _edges(self, V):
        """Where the gap starts, how wide and how bent it is, and its upper and lower edge."""
        right, left = V[:2]
        across = left[0] - right[0]
        V = V[2:]
        at = (V[:, 0] - right[0]) / across
        # the line from corner to corner may be steep: heights are counted from it
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
            edge = these[first]
            knots = np.concatenate([[0], (bins[first] + 0.5) / _BINS, [1]])
            heights = np.concatenate([ends[:1], height[edge], ends[1:]])
            depths = np.concatenate([right[2:], V[edge, 2], left[2:]])
            edges.append((knots, heights, depths))
        return right[0], across, line, edges


def _powers(u):
    return np.vander(u, _BEND + 1, increasing=True)


def _sine(up, ahead):
    return up / np.hypot(up, np.maximum(ahead, _NEAREST))
