"""Lids held off the eyes: a last step for what is shown."""

import numpy as np

_REACH, _FRONT = 8.0, 0.2  # mm from the ball; share of its radius ahead of its centre
_FILM = 0.1  # mm between lid and ball
_LAYERS = 1.6  # mm: of a lid so thick the outside stays outside of the inside


class Lids:
    """Pushes the skin around an eyeball out of it.

    Shapes move vertices along straight lines, and so through the ball. Each vertex is kept as far
    from the centre as the ball and half of what lay between them at rest demand; what keeps off
    by itself stays where it is, exactly.

    Parameters
    ----------
    rest : ndarray of shape (n_vertices, 3)
        The face at rest, head frame, millimetres.
    centre : ndarray of shape (3,)
    radius : float

    Examples
    --------
    >>> rest = np.array([[0.0, 0.0, 13.0], [0.0, 60.0, 0.0]])
    >>> lids = Lids(rest, np.zeros(3), 12.0)
    >>> lids.off(rest - [0, 0, 5]).round(2).tolist()
    [[0.0, 0.0, 12.6], [0.0, 60.0, -5.0]]
    """

    def __init__(self, rest, centre, radius):
        spoke = rest - centre
        away = np.linalg.norm(spoke, axis=1)
        self._near = np.flatnonzero((away < radius + _REACH) & (spoke[:, 2] > _FRONT * radius))
        away = away[self._near]
        wanted = radius + _FILM + 0.5 * (away - radius).clip(0, _LAYERS)
        self.centre, self.radius = np.asarray(centre, dtype=float), float(radius)
        self._least = np.minimum(wanted, away)

    def off(self, vertices):
        """A posed face with these lids off the eye: shape (n_vertices, 3), millimetres."""
        spoke = vertices[self._near] - self.centre
        away = np.linalg.norm(spoke, axis=1)
        inside = away < self._least
        if not inside.any():
            return vertices
        V = np.array(vertices, dtype=float)
        out = self._least[inside] / np.maximum(away[inside], 1e-9)
        V[self._near[inside]] = self.centre + spoke[inside] * out[:, None]
        return V
