"""What makes a face more than a sum: the jaw turns, lids slide over the eyeball, lips meet.

Each part takes the positions of many frames, (n_frames, n_vertices, 3) in millimetres, and moves
them in place. Its work on one vertex needs no other vertex, save that lips meet at their rims;
so few vertices are cheap. At zero weights it moves nothing, exactly.
"""

from dataclasses import dataclass

import numpy as np

from data_synth.muscles import bell, ease
from data_synth.units import UNITS


@dataclass(frozen=True)
class JawMove:
    """Motion of the mandible: opening and turn to the left in degrees, slide forward in mm."""

    open: float = 0.0
    turn: float = 0.0
    forward: float = 0.0


JAW = {
    "AU26": JawMove(open=6.5),
    "AU27": JawMove(open=16.0),
    "AU29": JawMove(forward=6.5),
    "AU30L": JawMove(turn=5.0),
    "AU30R": JawMove(turn=-5.0),
}
_MOST_OPEN = 18.0  # degrees; units that open the jaw together never pass it by much

# How far each unit leaves the lids open: factors on the distance of the upper and of the lower
# margin from the line where they meet.
LIDS = {
    "AU4": (0.95, 1.0), "AU5": (1.28, 1.08), "AU6": (0.96, 0.72), "AU7": (0.84, 0.4),
    "AU9": (0.93, 0.75), "AU12": (1.0, 0.94), "AU45": (0.0, 0.0),
}  # fmt: skip
_LID_GAP = 0.12  # mm between the margins of closed lids
_LIP_GAP = 0.1  # mm between lips that touch, or less where they are nearer at rest


class Jaw:
    """The mandible's hinge, and how much of its motion the skin takes part in."""

    def __init__(self, skin, jaw_axis, style):
        self.point, self.axis = (np.asarray(a, dtype=float) for a in jaw_axis)
        self.style, self.scale = style, skin.scale
        self.weights = _mandible(skin)
        moves = [JAW.get(name, JawMove()) for name in UNITS]
        self.moves = np.array([(m.open, m.turn, skin.scale * m.forward) for m in moves])

    def apply(self, X, W, vertices):
        """Turn and slide the positions X (n_frames, n_vertices, 3), in place."""
        driven = np.flatnonzero(np.abs(self.moves).any(1))
        W = W[:, driven]
        if not W.any():
            return
        # opening saturates: a p-norm is the unit itself when it acts alone
        opening = np.minimum(self.moves[driven, 0] * np.maximum(W, 0.0), 60.0)
        opening = (opening**4).sum(1) ** 0.25
        over = np.maximum(opening - _MOST_OPEN, 0.0)
        opening = opening - over + 3.0 * np.tanh(over / 3.0)
        turn, forward = W @ self.moves[driven, 1], W @ self.moves[driven, 2]
        glide = self.scale * self.style.glide * (opening / 20.0) ** 1.5
        moving = np.flatnonzero(self.weights[vertices] > 0.0)
        m = self.weights[vertices[moving]]
        P = X[:, moving] - self.point
        x, y, z = P[..., 0], P[..., 1], P[..., 2]
        a = np.radians(opening)[:, None] * m
        c, s = np.cos(a), np.sin(a)
        y, z = c * y - s * z, s * y + c * z  # down and back about the hinge
        b = np.radians(turn)[:, None] * m
        c, s = np.cos(b), np.sin(b)
        x, z = c * x + s * z, c * z - s * x
        slide = (forward + glide)[:, None] * m
        X[:, moving] += np.stack([x, y, z + slide], axis=-1) - P


def _mandible(skin):
    """Share of the jaw's motion at every vertex: 1 on chin and lower lip, 0 above the mouth."""
    mark, scale = skin.landmark, skin.scale
    x, y, z = skin.vertices.T
    corner, chin, ala = mark("mouth_corner_left"), mark("chin"), mark("nostril_left_outer")
    lip = mark("lip_lower")
    lateral = np.abs(x) / corner[0]
    low = skin.upperness < 0.5
    front = z > chin[2] - 42.0 * scale
    moving = low & front & (y < lip[1] + 4.0 * scale - 6.0 * scale * np.maximum(lateral - 0.35, 0))
    moving &= lateral < 0.35 + 0.05 * np.maximum(lip[1] + 4.0 - y, 0.0) / scale
    moving &= lateral < 1.35
    rims = skin.curves["upper_lip_inner"], skin.curves["upper_lip_outer"]
    still = (y > ala[1]) | ((skin.upperness > 0.5) & (skin.from_lips < 1.0) & (lateral < 0.35))
    still[np.concatenate([rim[[0, -1]] for rim in rims])] = False
    ears = (z < mark("jaw_left_1")[2] + 4.0) & (y > corner[1])
    still = (still | ears) & ~moving
    given = np.concatenate([np.flatnonzero(moving), np.flatnonzero(still)])
    values = np.repeat([1.0, 0.0], [moving.sum(), still.sum()])
    filled = ease(skin.fill(given, values, order=1))
    return np.clip(skin.smooth(filled, 5.0), 0.0, 1.0)


class Lids:
    """The lids of one eye: shells that turn about the eyeball between the two canthi."""

    def __init__(self, skin, side, eyeball, style):
        self.side, (self.centre, self.radius) = side, eyeball
        upper = skin.curves[f"upper_lid_{side}"]
        across = skin.vertices[upper[-1]] - skin.vertices[upper[0]]
        across /= np.linalg.norm(across)
        forward = np.array([0.0, 0.0, 1.0])
        forward -= (forward @ across) * across
        self.forward = forward / np.linalg.norm(forward)
        up = np.cross(self.forward, across)
        self.up = up * np.sign(up[1])
        self.across = across
        rest = np.linalg.norm(skin.vertices - self.centre, axis=1)
        closing = self._closing(skin, style)
        near = (np.abs(closing) > 1e-9).any(1) | (rest < self.radius + 9.0)
        self.vertices = np.flatnonzero(near)
        self.closing = closing[near]
        self.least = np.minimum(rest[near], self.radius + 0.3) - 1e-9

    def _angle(self, points):
        """Elevation about the axis between the canthi, radians."""
        return np.arctan2((points - self.centre) @ self.up, (points - self.centre) @ self.forward)

    def _closing(self, skin, style):
        """Turn that closes the eye, radians: (n_vertices, 2), part of the upper, of the lower."""
        given, values = [], []
        for edge in ("lid", "lid_back", "lid_inner"):
            upper, lower = (skin.curves[f"{lid}_{edge}_{self.side}"] for lid in ("upper", "lower"))
            high, low = self._angle(skin.vertices[upper]), self._angle(skin.vertices[lower])
            at_high = (skin.vertices[upper] - self.centre) @ self.across
            at_low = (skin.vertices[lower] - self.centre) @ self.across
            if edge != "lid_inner":
                room = _LID_GAP / self.radius  # closed lids touch, they do not cut into each other
                down = np.maximum(high - np.interp(at_high, at_low, low) - room, 0.0)
                rise = np.maximum(np.interp(at_low, at_high, high) - low - room, 0.0)
                down *= self._share(at_high, style.lower_lid) - 1.0
                rise *= self._share(at_low, style.lower_lid)
                margin = at_high, down, at_low, rise
            else:  # the inner edge follows the margin
                down, rise = np.interp(at_high, *margin[:2]), np.interp(at_low, *margin[2:])
            for line, turn, column in ((upper, down, 0), (lower, rise, 1)):
                turn[[0, -1]] = 0.0
                given.append(line)
                values.append(np.eye(2)[column] * turn[:, None])
        given, first = np.unique(np.concatenate(given), return_index=True)
        values = np.vstack(values)[first]
        fixed = np.setdiff1d(self._fixed(skin), given)
        return skin.fill(
            np.concatenate([given, fixed]), np.vstack([values, np.zeros((len(fixed), 2))]), order=2
        )

    @staticmethod
    def _share(at, middle):
        """Share of the lower lid in closing, along it: half at the canthi, so that none hooks."""
        return middle + (0.5 - middle) * np.abs(2.0 * (at - at[0]) / (at[-1] - at[0]) - 1.0) ** 3

    def _fixed(self, skin):
        """Vertices that the lids do not move: brow and above, cheek, nose, the other eye."""
        margin = [skin.curves[f"{lid}_lid_{self.side}"] for lid in ("upper", "lower")]
        away = skin.vertices - self.centre
        high = away @ self.up
        limit = np.where(high > 0.0, 15.0, 11.0) * skin.scale
        return np.flatnonzero(skin.distance(np.concatenate(margin)) > limit)

    def apply(self, X, W, vertices):
        """Slide the lids of positions X (n_frames, n_vertices, 3) in place; keep the eye free."""
        here = np.flatnonzero(np.isin(vertices, self.vertices, assume_unique=True))
        if not len(here):
            return
        own = np.searchsorted(self.vertices, vertices[here])
        P = X[:, here] - self.centre
        open_upper, open_lower = self.openness(W)
        turn = (1.0 - open_upper)[:, None] * self.closing[own, 0]
        turn += (1.0 - open_lower)[:, None] * self.closing[own, 1]
        c, s = np.cos(turn), np.sin(turn)
        p, q = P @ self.forward, P @ self.up
        move = ((c - 1.0) * p - s * q)[..., None] * self.forward
        move += ((c - 1.0) * q + s * p)[..., None] * self.up
        P += move
        distance = np.sqrt(np.einsum("fvd,fvd->fv", P, P))
        short = np.maximum(self.least[own] - distance, 0.0) / np.maximum(distance, 1e-9)
        X[:, here] += move + short[..., None] * P  # out of the eyeball

    def openness(self, W):
        """How open the upper and the lower lid are, 0 closed, 1 as at rest: two (n_frames,)."""
        upper, lower = np.ones(len(W)), np.ones(len(W))
        other = "R" if self.side == "left" else "L"
        for k, name in enumerate(UNITS):
            factors = LIDS.get(name) or LIDS.get(name[:-1])
            if factors and name[-1] != other:
                upper *= np.maximum(1.0 + W[:, k] * (factors[0] - 1.0), 0.0)
                lower *= np.maximum(1.0 + W[:, k] * (factors[1] - 1.0), 0.0)
        return upper, lower


class Contact:
    """Lips that meet: where the rims would cross, both give way, up and down."""

    def __init__(self, skin, style):
        self.rims = skin.curves["upper_lip_inner"], skin.curves["lower_lip_inner"]
        self.give = style.lip_give, 1.0 - style.lip_give
        self.spread = [self._spread(skin, rim, lip) for lip, rim in enumerate(self.rims)]
        rest = self.overlap(*(skin.vertices[None, rim] for rim in self.rims), room=(1.0, 1.0))
        self.room = tuple(np.clip(1.0 - push[0], 0.0, _LIP_GAP) for push in rest)

    @staticmethod
    def _spread(skin, rim, lip):
        """How the skin of one lip follows its rim, (n_rim, n_vertices); each rim vertex itself."""
        share = skin.upperness if lip == 0 else 1.0 - skin.upperness
        reach = bell(skin.distance(rim) / (13.0 * skin.scale)) * ease(2.0 * share - 0.9)
        at = np.interp(skin.vertices[:, 0], skin.vertices[rim, 0], np.arange(len(rim)))
        spread = reach * np.maximum(1.0 - np.abs(at - np.arange(len(rim))[:, None]), 0.0)
        spread[:, rim] = np.eye(len(rim))
        spread[[0, -1]] = 0.0  # the corners belong to both lips
        return spread

    def seal(self, field):
        """Let both rims move alike in a displacement field (n_vertices, 3) that would part them."""
        part = field[self.rims[0]] - field[self.rims[1]]
        part[:, 1] = np.maximum(part[:, 1], 0.0)  # what presses them together, `apply` answers
        for lip, sign in ((0, -1.0), (1, 1.0)):
            field += sign * self.give[lip] * (self.spread[lip].T @ part)

    def apply(self, X, vertices, rims):
        """Part the lips of X in place, given the rims' positions, two (n_frames, n_rim, 3)."""
        rims = [rim.copy() for rim in rims]
        way = [np.zeros(rim.shape[:2]) for rim in rims]
        for _ in range(4):  # each round shares out what is left of the overlap
            push = self.overlap(*rims, self.room)
            if not any(p.any() for p in push):
                break
            for lip, sign in ((0, 1.0), (1, -1.0)):
                push[lip][:, [0, -1]] = 0.0
                way[lip] += sign * self.give[lip] * push[lip]
                rims[lip][..., 1] += sign * self.give[lip] * push[lip]
        for lip in range(2):
            if way[lip].any():
                X[..., 1] += way[lip] @ self.spread[lip][:, vertices]

    @staticmethod
    def overlap(upper, lower, room):
        """How far each rim vertex is nearer to the other rim than `room`, or beyond it, mm.

        All of them come in two: (n_frames, n_rim, 3) the rims, (n_rim,) or a number the room,
        (n_frames, n_rim) the result.
        """
        push = np.zeros(upper.shape[:2]), np.zeros(lower.shape[:2])
        near = (upper[:, 1:-1, 1] - lower[:, 1:-1, 1]).min(1) < 2.0
        for f in np.flatnonzero(near):
            (xu, yu), (xl, yl) = upper[f, :, :2].T, lower[f, :, :2].T
            push[0][f] = np.maximum(np.interp(xu, xl, yl) + room[0] - yu, 0.0)
            push[1][f] = np.maximum(yl + room[1] - np.interp(xl, xu, yu), 0.0)
        return push
