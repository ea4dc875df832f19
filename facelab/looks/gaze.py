"""Where an eye looks, read off the skin around it as the rig's look shapes move that."""

import re

import numpy as np

from facelab.names import normalised

WIDEST = 27.0
"""How far the eye turns at weight 1 of a look shape, and by hand at most, degrees."""

FULL = np.radians(WIDEST)
"""The same in radians."""

_LOOK = re.compile(r"^eyes?look(up|down|in|out|left|right)(left|right)?$")
_REACH = 28.0  # mm around the middle of the eye
_RIDGE = 1e-3  # against shapes that move the lids nearly alike


def look_units(names):
    """What each unit of a rig adds to yaw and pitch of both eyes at weight 1.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    turns : ndarray of shape (2, n_units, 2)
        Left and right eye; to the person's left and up, shares of `WIDEST`, 0 for no look shape.

    Examples
    --------
    >>> look_units(["jawOpen", "eyeLookInRight"])[1].tolist()
    [[0.0, 0.0], [1.0, 0.0]]
    """
    turns = [[_turn(name, side) for name in names] for side in ("left", "right")]
    return np.array(turns, dtype=float).reshape(2, -1, 2)


def look_weights(turns, gaze):
    """Weights of the look shapes for a gaze: of their units, and those, (n,) and (n,).

    Parameters
    ----------
    turns : ndarray of shape (2, n_units, 2)
        From `look_units`.
    gaze : array_like of shape (2,)
        Degrees to the person's left and up, both eyes.
    """
    wanted = (turns @ (np.asarray(gaze) / WIDEST)).clip(0, 1)
    # where several shapes turn an eye the same way, each does its part
    alike = ((turns @ turns.transpose(0, 2, 1)) > 0.5).sum(axis=2).clip(1)
    units = np.flatnonzero(turns.any(axis=(0, 2)))
    return units, (wanted / alike).max(axis=0)[units]


class Gaze:
    """Yaw and pitch of one eye from a posed face.

    The weights of all shapes of the rig are estimated from the skin around the eye, linearly with
    a light ridge; those of the look shapes turn the eye. On poses of the rig itself they are
    nearly its own.

    Parameters
    ----------
    rig : BlendshapeRig
    centre : ndarray of shape (3,)
        Of the eyeball, millimetres.
    side : {"left", "right"}
    """

    def __init__(self, rig, centre, side):
        rest = rig.neutral.vertices
        self._near = np.flatnonzero(np.linalg.norm(rest - centre, axis=1) < _REACH)
        self._rest = rest[self._near]
        turns = np.array([_turn(name, side) for name in rig.names])
        D = rig.deltas[:, self._near].reshape(len(turns), -1).astype(float)
        looks = turns.any(axis=1) & (np.abs(D).max(axis=1, initial=0) > 1e-3)
        self.found = bool(looks.any())
        G = D @ D.T
        G[np.diag_indices_from(G)] += _RIDGE * np.trace(G) / max(len(G), 1) + 1e-12
        self._read = np.linalg.solve(G, D)[looks]
        self._turns = turns[looks]

    def angles(self, vertices):
        """Yaw to the person's left and pitch up, radians, for a face at (n_vertices, 3)."""
        if not self.found:
            return 0.0, 0.0
        weights = self._read @ (vertices[self._near] - self._rest).ravel()
        return tuple(FULL * (weights.clip(0, 1) @ self._turns).clip(-1, 1))


def _turn(name, side):
    """What a shape adds to yaw and pitch of the eye at a side, at weight 1."""
    found = _LOOK.match(normalised(name))
    if not found or found[2] not in (None, side):
        return 0.0, 0.0
    outwards = 1.0 if side == "left" else -1.0
    return {
        "up": (0.0, 1.0), "down": (0.0, -1.0), "left": (1.0, 0.0), "right": (-1.0, 0.0),
        "out": (outwards, 0.0), "in": (-outwards, 0.0),
    }[found[1]]  # fmt: skip
