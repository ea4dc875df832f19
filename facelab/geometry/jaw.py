"""How the jaw moves, read off the skin over the chin."""

import numpy as np

from facelab.geometry.alignment import Alignment


class Jaw:
    """A jaw that opens about the axis from ear to ear and slides as a whole, led by the chin.

    Parameters
    ----------
    rest : ndarray of shape (n_vertices, 3)
        The face at rest, head frame, millimetres.
    chin : int
        Vertex of the chin.
    joint : ndarray of shape (3,)
        A point on the axis.
    around : float, default=12.0
        Skin so near to the chin leads, millimetres.
    """

    def __init__(self, rest, chin, joint, around=12.0):
        self.joint = np.asarray(joint, dtype=float)
        self._near = np.flatnonzero(np.linalg.norm(rest - rest[chin], axis=1) < around)
        self._rest = rest[self._near].mean(axis=0)

    def motion(self, vertices):
        """Rigid motion from rest for a face at (n_vertices, 3): an `Alignment`.

        The skin may be drawn up over a closed jaw, so that is taken for no turn.
        """
        now = vertices[self._near].mean(axis=0)
        shift, before, after = now - self._rest, self._rest - self.joint, now - self.joint
        # from one direction in the plane of y and z to the other
        turn = np.arctan2(after[2], after[1]) - np.arctan2(before[2], before[1])
        turn = max((turn + np.pi) % (2 * np.pi) - np.pi, 0.0) if shift[1] < 0 else 0.0
        c, s = np.cos(turn), np.sin(turn)
        R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        slide = shift - (R - np.eye(3)) @ before
        slide[1] = 0
        return Alignment(R, self.joint - R @ self.joint + slide)
