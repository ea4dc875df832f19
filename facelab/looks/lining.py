"""What is seen through the openings of a face: a dark lining behind lids and lips."""

import numpy as np

_NEAR, _DEEP = (0.36, 0.13, 0.12), (0.16, 0.05, 0.05)
_DEPTH = 0.45  # of the width of the opening


class Lining:
    """A pocket behind every opening of a face but its outline, which follows the rim.

    Without one, the page is seen through an open mouth. The pocket is linear in the vertices of
    the face, so a morph of the face carries it along.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, millimetres.

    Attributes
    ----------
    rim : ndarray of int, shape (n_rim,)
        Vertices of the face around its openings.
    faces : ndarray of int, shape (n_faces, 3)
        Counted from the first vertex of the lining.
    normals, colors : ndarray of shape (n_lining, 3)
    """

    def __init__(self, mesh):
        openings = sorted(mesh.boundary_loops, key=lambda rim: _length(mesh, rim))[:-1]
        rims, depths, faces, start = [], [], [], 0
        for rim in openings:
            n = len(rim)
            around = np.arange(n)
            ahead = (around + 1) % n
            for ring in (0, n):
                faces += [
                    np.stack([around, ahead, ahead + n], axis=1) + start + ring,
                    np.stack([around, ahead + n, around + n], axis=1) + start + ring,
                ]
            width = np.ptp(mesh.vertices[rim], axis=0).max()
            rims.append(np.asarray(rim))
            depths.append(_DEPTH * width)
            start += 3 * n
        self._rims, self._depths = rims, depths
        self.rim = np.concatenate(rims) if rims else np.empty(0, dtype=int)
        self.faces = np.concatenate(faces) if faces else np.empty((0, 3), dtype=int)
        self.normals = np.tile((0.0, 0.0, 1.0), (start, 1))
        self.colors = np.concatenate(
            [np.repeat([_NEAR, _DEEP, _DEEP], len(rim), axis=0) for rim in rims]
            or [np.empty((0, 3))]
        )

    def vertices(self, V):
        """Positions of the lining, shape (n_lining, 3), for a face at V, millimetres."""
        parts = [np.empty((0, 3))]
        for rim, depth in zip(self._rims, self._depths, strict=True):
            rim = V[rim]
            middle = rim.mean(axis=0)
            back = np.array([0.0, 0.0, depth])
            parts += [
                rim,
                0.9 * rim + 0.1 * middle - 0.7 * back,
                np.tile(middle - back, (len(rim), 1)),
            ]
        return np.concatenate(parts)


def _length(mesh, rim):
    V = mesh.vertices[rim]
    return np.linalg.norm(V - np.roll(V, 1, axis=0), axis=1).sum()
