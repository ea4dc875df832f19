"""Eyes, teeth and a tongue for a face that came without: seen beside the skin, never computed with.

They are made here, not data. Each follows the face as it is posed: the upper teeth stay with the
skull, lower teeth and tongue go with the jaw, eyes turn with the rig's gaze.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import as_finite
from facelab.geometry.jaw import Jaw
from facelab.geometry.mesh import TriangleMesh
from facelab.looks.eyes import IRIS, ball_mesh, fitted_ball, turned
from facelab.looks.gap import Gap, before
from facelab.looks.gaze import Gaze
from facelab.looks.lids import Lids
from facelab.looks.openings import SIDES, eye_opening, mouth_opening
from facelab.looks.teeth import row_of_teeth, tongue

_LIP_BEHIND = 0.9  # mm between teeth and lips at rest
_FEWEST = 12  # vertices of a rim: coarse lids would cut into a ball
_NEEDED = {
    *(f"eye_{side}_{end}" for side in SIDES for end in ("inner", "outer")),
    *("mouth_corner_left", "mouth_corner_right", "chin"),
}
_LID_THICK = 5.0  # mm from the inner rim of a lid to its outer one, at most
_LIPS_CLOSED, _LIDS_CLOSED = 3.0, 2.5  # mm apart, or less
_DARK = np.array([0.10, 0.05, 0.05])  # share of its colour that is left behind closed lips and lids
_made = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class Prop:
    """A part that is shown with a face; it unpacks to (mesh, colors), as still parts are given.

    Parameters
    ----------
    name : str
        Such as `eye_left`.
    mesh : TriangleMesh
        With the face at rest, millimetres.
    colors : ndarray of shape (n_vertices, 3)
        0 to 1.
    move : callable, optional
        Takes the vertices of the face, shape (n, 3), to those of the part; it is still without.
    gloss : float
        0 for skin, 1 for what is wet.
    lids : Lids, optional
        Of an eye: they keep the skin off it.
    look : callable, optional
        Of an eye: takes the vertices of the face and a gaze to its own vertices, see `turn_eyes`.
    gap : Gap, optional
        Of the lids or lips before it: what they let through, see `shown`.
    """

    name: str
    mesh: TriangleMesh
    colors: np.ndarray
    move: Callable | None = field(default=None, repr=False)
    gloss: float = 0.0
    lids: Lids | None = field(default=None, repr=False)
    look: Callable | None = field(default=None, repr=False)
    gap: Gap | None = field(default=None, repr=False)

    def __iter__(self):
        return iter((self.mesh, self.colors))


def followed(prop, vertices):
    """Vertices of a part for a face at `vertices`, both of shape (n, 3), millimetres.

    Parameters
    ----------
    prop : Prop or (TriangleMesh, colors)
        A pair is a still part.
    """
    mesh, _ = prop
    move = getattr(prop, "move", None)
    return mesh.vertices if move is None else move(vertices)


def shown(prop, vertices):
    """A part as it is seen on a face at `vertices`: where it is and its colours, both (n, 3).

    As `followed`, but what lies behind closed lips and lids is dark, teeth and tongue are as bright
    as the lips let light through to them, and do not come through closed lips.

    Parameters
    ----------
    prop : Prop or (TriangleMesh, colors)
    vertices : ndarray of shape (n_vertices, 3)
        Millimetres.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template()
    >>> teeth = face_props(face)[2]
    >>> bool(shown(teeth, face.vertices)[1].max() < 0.5 * teeth.colors.max())  # a closed mouth
    True
    """
    V, (_, colors) = followed(prop, vertices), prop
    gap = getattr(prop, "gap", None)
    if gap is None:
        return V, colors
    if prop.lids is not None:
        share = gap.parted(vertices, V)
    else:
        share, V = gap.light(vertices, V), gap.behind(vertices, V)
    return V, colors * (_DARK + (1 - _DARK) * share[:, None])


def turn_eyes(props, gaze):
    """The parts with eyes that look elsewhere, beyond what the face itself says: list.

    Parameters
    ----------
    props : iterable of Prop or (TriangleMesh, colors)
        As made by `face_props`; what is no eye of it stays as it is.
    gaze : array_like of shape (2,)
        Degrees to the person's left and up, both eyes.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template()
    >>> eye = turn_eyes(face_props(face), (20, 0))[0]
    >>> ahead = followed(eye, face.vertices)[0] - eye.mesh.vertices[0]
    >>> bool(ahead[0] > 4)  # the pupil, millimetres to the person's left
    True
    """
    gaze = as_finite(gaze, "gaze", (2,))
    if not gaze.any():
        return list(props)
    return [
        replace(prop, move=lambda V, look=prop.look: look(V, gaze))
        if getattr(prop, "look", None)
        else prop
        for prop in props
    ]


def lids_off(props, vertices):
    """A posed face with its lids off its eyes, shape (n_vertices, 3), millimetres.

    A last step for what is shown or written; leave it out where positions are measured.

    Parameters
    ----------
    props : iterable of Prop or (TriangleMesh, colors)
        As made by `face_props` for the face; those without lids change nothing.
    vertices : ndarray of shape (n_vertices, 3)

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template()
    >>> lids_off(face_props(face), face.vertices) is face.vertices  # at rest they are
    True
    """
    for prop in props:
        lids = getattr(prop, "lids", None)
        vertices = vertices if lids is None else lids.off(vertices)
    return vertices


def face_props(face, rig=None, iris=IRIS):
    """Eyes, teeth and a tongue that fit a face.

    Parameters
    ----------
    face : TriangleMesh
        At rest, head frame, millimetres, with landmarks: the corners of the eyes and of the mouth,
        and the chin. Without them, or of a head in pieces, which has eyes of its own, nothing is
        made; nor are eyes where nothing is open between the lids.
    rig : BlendshapeRig, optional
        On this mesh: the eyes turn as its look shapes move the lids.
    iris : str
        A colour.

    Returns
    -------
    list of Prop

    Examples
    --------
    >>> import facelab
    >>> [prop.name for prop in face_props(facelab.load_template())]
    ['eye_left', 'eye_right', 'teeth_upper', 'teeth_lower', 'tongue']
    """
    key = None if rig is None else id(rig), iris
    made = _made.setdefault(face, {})
    if key not in made:
        fits = _NEEDED <= set(face.landmarks) and _upright(face) and not face.pieces.any()
        made[key] = _eyes(face, rig, iris) + _mouth(face) if fits else []
    return list(made[key])


def _eyes(face, rig, iris):
    props = []
    for side in SIDES:
        opening = eye_opening(face, side)
        if opening is None or len(opening.rim) < _FEWEST:
            continue
        centre, radius = fitted_ball(face.vertices[opening.rim], opening.width, face.vertices)
        ball, colors = ball_mesh(radius, iris)
        move, look = _looking(ball.vertices, centre, rig, side)
        props.append(
            Prop(
                f"eye_{side}",
                ball.with_vertices(ball.vertices + centre),
                colors,
                move,
                1.0,
                Lids(face.vertices, centre, radius),
                look,
                _lid_gap(face, side, opening.rim),
            )
        )
    return props


def _lid_gap(face, side, rim):
    marks, height = face.landmarks, face.vertices[rim, 1]
    ends = sorted(
        (marks[f"eye_{side}_{end}"] for end in ("inner", "outer")),
        key=lambda vertex: face.vertices[vertex, 0],
    )
    sides = rim[height.argmax()], rim[height.argmin()]
    away, nearest = cKDTree(face.vertices[rim]).query(face.vertices)
    ahead = face.vertices[:, 2] - face.vertices[rim[nearest], 2]
    skin = np.flatnonzero((away < _LID_THICK) & (ahead >= 0))  # the rim may lie within
    return Gap(face, ends, sides, skin, _LIDS_CLOSED)


def _looking(points, centre, rig, side):
    """How an eye turns with the rig's look shapes, None where it has none; and with a gaze too."""
    found = None if rig is None else Gaze(rig, centre, side)
    seen = found.angles if found is not None and found.found else None

    def look(V, gaze=(0.0, 0.0)):
        own = (0.0, 0.0) if seen is None else seen(V)
        return centre + turned(points, *(own + np.radians(gaze)))

    return look if seen else None, look


def _mouth(face):
    opening, V = mouth_opening(face), face.vertices
    scale = opening.width / 50
    at = _lips_meet(face, opening, scale)
    level = _eye_level(face)
    tall = level - V[face.landmarks["chin"]][1]
    # the condyles sit before the ears, a little below the eyes
    joint = np.array([at[0], level - 0.11 * tall, at[2] - 0.78 * tall])
    jaw = Jaw(V, face.landmarks["chin"], joint)
    marks, gap = face.landmarks, None
    if {"lip_upper", "lip_lower"} <= set(marks):
        corners = marks["mouth_corner_right"], marks["mouth_corner_left"]
        lips = marks["lip_upper"], marks["lip_lower"]
        gap = Gap(face, corners, lips, before(face, corners, at), _LIPS_CLOSED)
    props = []
    for name, (mesh, colors), gloss in (
        ("teeth_upper", row_of_teeth(True, scale), 0.55),
        ("teeth_lower", row_of_teeth(False, scale), 0.55),
        ("tongue", tongue(scale), 0.3),
    ):
        mesh = mesh.with_vertices(mesh.vertices + at)
        move = None if name == "teeth_upper" else _with(jaw, mesh)
        props.append(Prop(name, mesh, colors, move, gloss, gap=gap))
    return props


def _eye_level(face):
    return np.mean([face.vertices[face.landmarks[n]][1] for n in _NEEDED if n.startswith("eye")])


def _upright(face):
    """Whether a face stands in the head frame: left to the right of the picture, eyes above."""
    V, marks = face.vertices, face.landmarks
    across = V[marks["mouth_corner_left"]] - V[marks["mouth_corner_right"]]
    up = _eye_level(face) - V[marks["chin"]][1]
    return across[0] > 0.8 * np.linalg.norm(across) > 0 and up > 0.8 * np.linalg.norm(across)


def _with(jaw, mesh):
    return lambda V: jaw.motion(V).apply(mesh.vertices)


def _lips_meet(face, opening, scale):
    """Where the lips meet in the middle, moved back to where the upper front teeth are."""
    V, marks = face.vertices, face.landmarks
    middle = (opening.corners[0] + opening.corners[1]) / 2
    inner = [V[marks[n]] for n in ("mouth_inner_upper", "mouth_inner_lower") if n in marks]
    if not inner:
        lips = [V[marks[n]][2] for n in ("lip_upper", "lip_lower") if n in marks]
        inner = [[middle[0], middle[1], np.mean(lips or middle[2]) - 3 * scale]]
    at = np.mean(inner, axis=0)
    at[0] = middle[0]
    # skin before the front teeth, as far back as it reaches there
    off = (V - at) / scale
    lips = (np.abs(off[:, 0]) < 11) & (np.abs(off[:, 1]) < 8) & (off[:, 2] > -9)
    front = V[lips, 2] + 0.012 * (V[lips, 0] - at[0]) ** 2 / scale
    at[2] = min(at[2], front.min(initial=at[2])) - _LIP_BEHIND * scale
    return at
