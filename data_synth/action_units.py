"""The forty action units as a nonlinear rig: muscles pull, the jaw turns, lids slide, lips meet.

Each unit is a row of `MUSCLES`, and of `JAW` and `LIDS` in `data_synth.articulation`; all lengths
in these tables are millimetres on the average face, at weight 1, on the person's left (x
outward); the right side is its mirror.
`ActionUnitRig.shape` combines them in this order:

1. muscles add up, with some saturation where several pull the same skin;
2. the skin of the lower face turns with the jaw about the hinge between the condyles;
3. lips that meet push each other away and share the way;
4. lids turn about their eyeball, and skin that would enter the eyeball is kept outside.

A unit alone gives the displacement d_i of Yu and Liu (2014, Eq. 1); together they are not a sum.
"""

from dataclasses import fields, replace
from functools import cached_property, lru_cache

import numpy as np

from data_synth.actors import ACTORS, Style
from data_synth.articulation import Contact, Jaw, Lids
from data_synth.muscles import Fold, Linear, Lips, Orbicularis, Pad, Sheet, Skin, ease
from data_synth.template import build_template
from data_synth.units import UNITS, expand
from facelab.checks import as_finite, as_indices, check_choice, check_index
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.keeping import keep_arrays, source_stamp
from facelab.rig import BlendshapeRig

# Places on the left side: a landmark, and an offset from it in mm on the average face.
_CORNER, _ALA = "mouth_corner_left", "nostril_left_outer"
_ZYGOMA = ("eye_left_outer", (9.0, -21.0, -6.0))
_ZYGOMA_MEDIAL = ("eye_left_outer", (-2.0, -23.0, 8.0))
_INFRAORBITAL = ("eye_left_lower_inner", (2.0, -9.0, 0.0))
_NOSE_SIDE = ("eye_left_inner", (-4.0, 1.0, 2.0))
_ALAR_CREASE = (_ALA, (7.0, 6.0, -8.0))
_UPPER_LIP_SIDE = ("lip_upper_left_outer", (-1.0, 3.0, 1.0))
_CHEEK = (_CORNER, (18.0, 25.0, -3.0))
_MALAR = ("eye_left_lower_outer", (11.0, -23.0, -5.0))
_BUCCAL = (_CORNER, (17.0, 4.0, -9.0))
_MASSETER = (_CORNER, (32.0, 2.0, -35.0))
_JAW_FRONT = ("jaw_left_7", (3.0, 3.0, 0.0))
_CHIN_BOSS = ("chin", (0.0, 13.0, 11.0))
_CHIN_SIDE = ("chin", (13.0, 10.0, 5.0))
_NASOLABIAL = (_ALAR_CREASE, (_CORNER, (5.0, 14.0, 1.0)), (_CORNER, (10.0, 0.0, -3.0)))
_CROWS_FEET = tuple(
    (("eye_left_outer", (5.0, y, -3.0)), ("eye_left_outer", (15.0, 1.8 * y, -14.0)))
    for y in (6.0, 1.0, -4.5)
)
_FURROWS = tuple(
    tuple((f"brow_left_{i}", (0.0, y, -1.0)) for i in (5, 4, 3, 2)) for y in (10.0, 18.0, 26.0)
)
_SMILE = Linear(_ZYGOMA, _CORNER, 12.5, angle=50.0, beyond=26.0)


# Muscles of each unit; names without a side stand for both sides at once.
MUSCLES = {
    "AU1": (
        Sheet(share=(1.0, 0.8, 0.4, 0.1, 0.0), move=(0.0, 7.0, -0.6), above=38.0, below=17.0),
        *(Fold(line[:3], 0.5, ridge=(0.0, 1.0), reach=3.5) for line in _FURROWS),
    ),
    "AU2": (
        Sheet(share=(0.1, 0.45, 0.95, 1.0, 0.75), move=(0.9, 7.5, -1.8), above=36.0, below=19.0),
        *(Fold(line[1:], 0.4, ridge=(0.0, 1.0), reach=3.5) for line in _FURROWS),
    ),
    "AU4": (
        Linear(("nose_bridge_1", (3.0, 3.0, -1.0)), "brow_left_3", 4.0, angle=55.0, beyond=20.0),
        Sheet(share=(0.8, 1.0, 0.8, 0.5, 0.15), move=(-1.0, -3.6, 0.8), above=24.0, below=16.0),
        Fold((("brow_left_5", (-6.0, -4.0, 0.0)), ("brow_left_5", (-6.5, 8.0, 0.0))), 0.9,
             ridge=(1.0, 0.0)),
    ),
    "AU5": (Sheet(share=(0.0, 0.1, 0.15, 0.1, 0.0), move=(0.0, 1.0, 0.0), below=14.0),),
    "AU6": (
        Orbicularis(below=2.5, outer=2.5, above=0.8, radius=13.0, width=18.0),
        Pad(_MALAR, move=(-0.6, 4.0, 0.5), swell=0.8, reach=36.0),
        *(Fold(line, 0.6, ridge=(0.0, 1.0), reach=2.5) for line in _CROWS_FEET),
    ),
    "AU7": (
        Orbicularis(below=2.2, outer=1.2, above=0.4, radius=7.0, width=12.0),
        Linear(_NOSE_SIDE, ("eye_left_lower_outer", (-3.0, -6.0, 0.0)), 2.2, angle=55.0,
               beyond=18.0),
    ),
    "AU45": (Sheet(share=(0.0, 0.3, 0.3, 0.2, 0.0), move=(0.0, -0.5, 0.0), below=14.0),),
    "AU9": (
        Linear(_NOSE_SIDE, _ALA, 5.5, angle=38.0, beyond=22.0),
        Linear(_NOSE_SIDE, _INFRAORBITAL, 3.5, angle=60.0, beyond=24.0),
        Linear(_INFRAORBITAL, (_CORNER, (2.0, 12.0, 4.0)), 3.5, angle=40.0, beyond=18.0),
        Sheet(share=(1.0, 0.8, 0.5, 0.2, 0.0), move=(-0.7, -2.8, 0.3), above=24.0, below=18.0),
        Fold((("nose_bridge_2", (3.0, 5.0, 0.0)), ("nose_bridge_2", (8.0, 0.0, -4.0))), 0.7,
             ridge=(0.0, 1.0), reach=3.0),
        Lips(upper=(0.0, 2.5, 0.0), reach=16.0),
        Fold(_NASOLABIAL[:2], 1.0),
    ),
    "AU10": (
        Linear(_INFRAORBITAL, _UPPER_LIP_SIDE, 5.5, angle=38.0, beyond=15.0),
        Lips(upper=(0.0, 1.8, 0.0), reach=16.0),
        Fold(_NASOLABIAL[:2], 1.2),
    ),
    "AU11": (
        Linear(_ZYGOMA_MEDIAL, (_CORNER, (-4.0, 10.0, 3.0)), 5.0, angle=36.0, beyond=18.0),
        Fold(_NASOLABIAL, 1.6),
    ),
    "AU12": (
        _SMILE,
        Pad(_CHEEK, move=(0.8, 3.0, 0.0), swell=1.5, reach=28.0),
        Lips(upper=(0.0, 1.2, -1.2), lower=(0.0, 1.6, -1.0), reach=16.0),
        Pad(_CHIN_BOSS, move=(0.0, 0.8, 0.0), reach=24.0),
        Fold(_NASOLABIAL, 1.2, reach=5.5),
    ),
    "AU13": (
        Linear(_INFRAORBITAL, _CORNER, 7.5, angle=38.0, beyond=20.0, lift=(0.8, 0.0, -1.5)),
        Pad(_CHEEK, move=(0.3, 2.5, 0.0), swell=2.0, reach=26.0),
        Fold(_NASOLABIAL, 1.0),
    ),
    "AU14": (
        Linear(_MASSETER, _CORNER, 2.5, angle=40.0, beyond=18.0),
        Pad(_CORNER, move=(0.3, 2.5, -4.5), reach=24.0),
        Fold(((_CORNER, (4.0, 9.0, 0.0)), (_CORNER, (7.0, 0.0, -2.0)),
              (_CORNER, (5.0, -9.0, 0.0))), 0.7, ridge=(1.0, 0.0), reach=5.5),
    ),
    "AU15": (
        Linear(_JAW_FRONT, _CORNER, 6.5, angle=42.0, beyond=17.0),
        Pad(_CHIN_BOSS, swell=0.8, reach=16.0),
        Fold(((_CORNER, (2.0, -2.0, 0.0)), (_CORNER, (5.0, -14.0, -1.0))), 0.6, reach=5.5),
    ),
    "AU16": (
        Linear(_CHIN_SIDE, ("lip_lower_left_inner", (0.0, 1.0, 0.0)), 2.5, angle=60.0,
               beyond=16.0, lift=(0.3, 0.0, 0.0)),
        Lips(lower=(0.0, -3.6, -0.6), corner=(0.0, -0.8, -0.2), reach=20.0),
    ),
    "AU17": (
        Pad(_CHIN_BOSS, move=(0.0, 6.0, 0.0), swell=2.0, reach=34.0),
        Lips(lower=(0.0, 4.5, 2.5), corner=(0.0, -0.5, 0.0), reach=18.0, roll=6.0),
    ),
    "AU18": (
        Lips(upper=(0.0, 2.0, 6.5), lower=(0.0, -1.0, 5.5), corner=(-8.5, 0.5, 7.0), reach=26.0),
    ),
    "AU20": (
        Linear(_MASSETER, (_CORNER, (0.0, -2.0, 0.0)), 8.5, angle=48.0, beyond=26.0,
               lift=(0.0, -1.5, 0.0)),
    ),
    "AU22": (
        Lips(upper=(0.0, 3.5, 5.5), lower=(0.0, -4.5, 4.0), corner=(-4.5, 0.0, 6.5), reach=24.0,
             roll=14.0),
    ),
    "AU23": (
        Lips(upper=(0.0, -1.2, -1.0), lower=(0.0, 1.2, -1.2), corner=(-2.8, 0.0, 0.5), reach=14.0,
             roll=-16.0),
    ),
    "AU24": (
        Lips(upper=(0.0, -2.2, -0.8), lower=(0.0, 2.6, 0.2), corner=(-1.0, 1.2, 0.3), reach=18.0,
             roll=-7.0),
        Pad(_CHIN_BOSS, move=(0.0, 2.8, 0.0), swell=1.2, reach=28.0),
    ),
    "AU25": (
        Lips(upper=(0.0, 1.5, 0.2), lower=(0.0, -3.8, 0.3), corner=(0.0, -0.4, 0.0), reach=14.0),
    ),
    "AU26": (Lips(corner=(-1.5, 0.0, 0.0), reach=26.0),),
    "AU27": (
        Lips(upper=(0.0, 1.0, -0.5), lower=(0.0, -2.0, -0.5), corner=(-4.5, 0.0, -1.0), reach=30.0),
        Pad(_BUCCAL, swell=-2.0, reach=26.0),
    ),
    "AU28": (
        Lips(upper=(0.0, -3.5, -4.0), lower=(0.0, 4.5, -4.0), corner=(-0.5, 0.0, -1.0), reach=18.0,
             roll=-38.0),
    ),
    "AU34": (
        Pad(_BUCCAL, move=(0.0, 0.0, 2.0), swell=7.5, reach=36.0),
        Lips(upper=(0.0, 0.3, 2.5), lower=(0.0, -0.3, 2.5), corner=(-1.5, 0.5, 5.0), reach=22.0),
    ),
    "AU35": (
        Pad(_BUCCAL, swell=-6.0, reach=28.0),
        Lips(corner=(-3.0, 0.0, 1.0), reach=16.0),
    ),
    "AU38": (
        Pad((_ALA, (4.0, 5.0, -2.0)), move=(1.8, 0.4, 0.0), swell=0.9, reach=12.0),
    ),
}  # fmt: skip

# Units that part the lips; all others leave closed lips closed: both rims move alike.
_PARTING = ("AU9", "AU10", "AU11", "AU16", "AU22", "AU25", "AU26", "AU27")

# Bulging: thickness of the tissue, mm, that swells by the area which the skin above it loses.
_TISSUE = 9.0

# How far skin that is pulled drags the skin around it, mm.
_DRAG = 22.0


def _muscle_fields(skin, template, style, contact):
    """Displacement by the muscles of each unit, (n_units, n_vertices, 3) mm, as "muscles"."""
    mirror, flip = template.mirror, np.array([-1.0, 1.0, 1.0])
    share = skin.left_share()[:, None]
    by_unit = {}
    for name, muscles in MUSCLES.items():
        muscles = _styled(name, muscles, style)
        field = sum(m.field(skin) for m in muscles if not isinstance(m, (Lips, Fold)))
        field = field + np.zeros_like(skin.vertices)
        field = skin.smooth(field, 2.5)
        # skin is elastic: what is pulled drags its surroundings along, fainter and wider
        field = 0.85 * field + 0.45 * skin.smooth(field, _DRAG * skin.scale * style.spread)
        field *= skin.lid_free[:, None]
        lips = sum((m.field(skin) for m in muscles if isinstance(m, Lips)), 0.0 * skin.vertices)
        folds = sum(m.field(skin) for m in muscles if isinstance(m, Fold))
        field = field + style.fold * skin.lid_free[:, None] * folds
        sides = expand(name)
        if len(sides) == 2:
            field = field + share * lips
        else:
            field = share * field
            field = field + (field * flip)[mirror] + lips
        if name not in _PARTING:
            contact.seal(field)
        field = field + _bulge(skin, field, style)
        if name not in _PARTING:  # lips swell apart, too
            contact.seal(field)
        for side, other in zip(sides, (field, (field * flip)[mirror]), strict=False):
            by_unit[side] = other
    still = np.zeros_like(skin.vertices)
    return {"muscles": np.stack([by_unit.get(name, still) for name in UNITS])}


def _bulge(skin, field, style):
    """Skin that is pushed together swells along its normal, skin that is stretched thins."""
    loss = skin.smooth(skin.compression(field), 6.0 * skin.scale)
    loss = np.where(loss > 0.0, 0.5 * np.tanh(2.0 * loss), 0.35 * np.tanh(loss))
    loss = skin.smooth(loss * ease(skin.from_lips / (16.0 * skin.scale)), 7.0 * skin.scale)
    swell = _TISSUE * skin.scale * style.bulge * skin.lid_free * loss
    return swell[:, None] * skin.normals


def _styled(name, muscles, style):
    """A unit's muscles as one person has them."""
    if name == "AU12":
        a = np.radians(style.smile)
        x, y = 0.5, 0.85  # direction of zygomaticus major seen from the front
        turned = np.array([np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x])
        lift = _SMILE.pull * (turned - [x, y])
        levator = MUSCLES["AU10"][0]
        muscles = (
            replace(_SMILE, lift=(float(lift[0]), float(lift[1]), 0.0)),
            replace(levator, pull=style.canine * levator.pull),
            *muscles[1:],
        )
    if style.variation:
        rng = np.random.default_rng([style.variant, UNITS.index(expand(name)[0])])
        muscles = tuple(_individual(m, style.variation, rng) for m in muscles)
    return muscles


# What differs between people in a muscle; its places on the skin are landmarks and stay.
_VARIES = ("pull", "angle", "beyond", "share", "move", "swell", "reach", "upper", "lower", "corner",
           "roll", "below", "outer", "above", "depth")  # fmt: skip


def _individual(muscle, amount, rng):
    """A muscle with every strength and extent varied by a share, and its pull turned a little."""
    changes = {}
    for field in fields(muscle):
        if field.name in _VARIES:
            value = np.array(getattr(muscle, field.name), dtype=float)
            value = value * (1.0 + amount * rng.normal(size=value.shape).clip(-1.5, 1.5))
            changes[field.name] = value.tolist()
    if isinstance(muscle, Linear):
        turn = 0.7 * amount * muscle.pull * rng.normal(size=3).clip(-1.5, 1.5)
        changes["lift"] = tuple(np.array(muscle.lift) + turn)
    return replace(muscle, **changes)


# --- the rig ------------------------------------------------------------------------------------


class ActionUnitRig:
    """The forty action units of one face.

    Parameters
    ----------
    template : data_synth.template.Template
        The neutral face with its anatomy.
    style : Style, optional
        How its skin answers; the average if left out.
    keep : callable, optional
        Takes a function that makes arrays and gives them, perhaps from an earlier time.

    Attributes
    ----------
    names : tuple of str
        The forty units, as in `data_synth.units.UNITS`.
    neutral : TriangleMesh
        The face at rest, millimetres, with its 68 landmarks.
    style : Style
    """

    def __init__(self, template, style=None, keep=lambda make: make()):
        self.style = Style() if style is None else style
        if not isinstance(self.style, Style):
            raise TypeError(f"style must be a Style or None, got {type(style).__name__}.")
        self.names = UNITS
        self.template = template
        landmarks = dict(zip(MULTI_PIE, template.landmarks.tolist(), strict=True))
        self.neutral = TriangleMesh(template.vertices, template.faces, landmarks)
        skin = Skin(self.neutral, template.curves, template.regions, self.style.spread)
        self._contact = Contact(skin, self.style)
        kept = keep(lambda: _muscle_fields(skin, template, self.style, self._contact))
        self._muscles = kept["muscles"]
        self._strength = np.linalg.norm(self._muscles, axis=2)
        self._jaw = Jaw(skin, template.jaw_axis, self.style)
        self._lids = [
            Lids(skin, side, template.eyeballs[side], self.style) for side in ("left", "right")
        ]
        self._rims = np.unique(np.concatenate(self._contact.rims))

    def __repr__(self):
        return f"ActionUnitRig({len(self.names)} units on {self.neutral.n_vertices} vertices)"

    @cached_property
    def deltas(self):
        """d_i: displacement by each unit alone at weight 1, (40, n_vertices, 3), mm."""
        return self.animate(np.eye(len(self.names))) - self.neutral.vertices

    def linear(self):
        """The linear rig of the same units: neutral + sum of w_i d_i, a `BlendshapeRig`."""
        return BlendshapeRig(self.neutral, self.names, self.deltas)

    def weights_of(self, named):
        """Weights in the rig's order from a dict of names; a name without side is both sides.

        Raises
        ------
        ValueError
            For names that the rig does not have.
        """
        weights = np.zeros(len(self.names))
        for name, weight in named.items():
            for unit in expand(name):
                weights[self.names.index(unit)] = weight
        return weights

    def shape(self, weights):
        """The face at some weights, shape (n_vertices, 3), millimetres.

        Parameters
        ----------
        weights : dict of str to float, or array_like of shape (40,)
            Contraction of each unit, 0 at rest, 1 at the peak.

        Raises
        ------
        ValueError
            For unknown names, a wrong shape, or weights that are not finite.
        """
        if isinstance(weights, dict):
            weights = self.weights_of(weights)
        weights = as_finite(weights, "weights", (len(self.names),))
        return self.animate(weights[None])[0]

    def animate(self, W, vertices=None):
        """The face in many frames.

        Parameters
        ----------
        W : array_like of shape (n_frames, 40)
            Weights of the units, 0 at rest, 1 at the peak.
        vertices : array_like of int, optional
            Vertices wanted, in this order; all of them if left out. Few are much faster.

        Returns
        -------
        positions : ndarray of shape (n_frames, n_vertices, 3)
            Millimetres, equal to `shape` frame by frame.

        Raises
        ------
        ValueError, TypeError
            For a wrong shape, weights that are not finite, or vertices that do not exist.
        """
        W = as_finite(W, "W", ("n_frames", len(self.names)))
        n = self.neutral.n_vertices
        vertices = np.arange(n) if vertices is None else vertices
        wanted = as_indices(vertices, "vertices", n, "vertices")
        # the lips decide by their rims where they meet, so these always come along
        needed = np.union1d(wanted, self._rims)
        part = _Part(self, needed)
        out = np.empty((len(W), len(wanted), 3))
        columns = np.searchsorted(needed, wanted)
        block = max(1, 200_000 // len(needed))
        for start in range(0, len(W), block):
            out[start : start + block] = part.shapes(W[start : start + block])[:, columns]
        return out

    def unit_sequence(self, name, n_frames=30):
        """One unit from onset over its peak to offset.

        Parameters
        ----------
        name : str
            One of `names`.
        n_frames : int, default=30
            At least 3. The peak is at two fifths of the way, and its weight is exactly 1.

        Returns
        -------
        positions : ndarray of shape (n_frames, n_vertices, 3)
            Millimetres; first and last frame are the neutral. Jaw and lids move on arcs.
        """
        check_choice(name, "name", self.names)
        n_frames = check_index(n_frames, "n_frames", 100_000, "frames")
        if n_frames < 3:
            raise ValueError(f"n_frames={n_frames}, but onset, peak and offset need 3 or more.")
        peak = min(max(round(0.4 * (n_frames - 1)), 1), n_frames - 2)
        frames = np.arange(n_frames)
        rise, fall = frames / peak, (n_frames - 1 - frames) / (n_frames - 1 - peak)
        W = np.zeros((n_frames, len(self.names)))
        W[:, self.names.index(name)] = ease(np.minimum(rise, fall))
        return self.animate(W)


class _Part:
    """The rig on some of its vertices (ascending), ready to be evaluated."""

    def __init__(self, rig, vertices):
        self.rig, self.vertices = rig, vertices
        whole = len(vertices) == rig.neutral.n_vertices
        keep = slice(None) if whole else vertices
        self.rest = rig.neutral.vertices[keep]
        self.fields = rig._muscles[:, keep].reshape(len(rig.names), -1)
        self.strength2 = rig._strength[:, keep] ** 2
        self.rims = [np.searchsorted(vertices, rim) for rim in rig._contact.rims]

    def shapes(self, W):
        """Positions (n_frames, n_vertices, 3) for weights (n_frames, n_units)."""
        rig = self.rig
        X = (W @ self.fields).reshape(len(W), -1, 3)
        X *= self._saturation(X, W)[..., None]
        X += self.rest
        rig._jaw.apply(X, W, self.vertices)
        rig._contact.apply(X, self.vertices, [X[:, rim] for rim in self.rims])
        for lids in rig._lids:
            lids.apply(X, W, self.vertices)
        return X

    def _saturation(self, moved, W):
        """Factor on the sum of pulls where several units pull the same skin the same way.

        One unit alone keeps its displacement; r equal pulls give less than r times one.
        """
        if (np.count_nonzero(W, axis=1) <= 1).all():
            return np.ones(moved.shape[:2])
        alone = np.sqrt((W**2) @ self.strength2)
        r = np.sqrt(np.einsum("fvd,fvd->fv", moved, moved)) / np.maximum(alone, 1e-9)
        over = np.maximum(r - 1.0, 0.0)
        return (1.0 + over / (1.0 + over)) / (1.0 + over)


@lru_cache(maxsize=8)
def actor_rig(actor, n_vertices=8820):
    """The rig of one of the four actors, made once and kept in the cache.

    Parameters
    ----------
    actor : str
        One of `data_synth.actors.ACTORS`.
    n_vertices : int, default=8820
        Density of the template.

    Returns
    -------
    ActionUnitRig

    Raises
    ------
    ValueError
        For an unknown actor.
    """
    check_choice(actor, "actor", tuple(ACTORS))
    template = build_template(ACTORS[actor].anatomy, n_vertices)
    name = f"{actor}-{n_vertices}"
    key = {"code": source_stamp(__name__), "rig": name}
    return ActionUnitRig(
        template, ACTORS[actor].style, lambda make: keep_arrays(f"rigs/{name}", key, make)
    )
