"""Landmarks of a rig guessed from how its shapes move: enough for a first fit."""

import numpy as np
from scipy.spatial import cKDTree

from facelab.checks import check_type
from facelab.geometry.size import check_face_size
from facelab.geometry.winding import outwards
from facelab.names import arkit_names
from facelab.rig import BlendshapeRig

_NEEDED = {
    "jawOpen": "a jaw that opens",
    "mouthSmileLeft": "a smile on the left",
    "mouthSmileRight": "a smile on the right",
    "eyeBlinkLeft": "the left eye closed",
    "eyeBlinkRight": "the right eye closed",
}
_BORDER = 0.3  # of the way from the fullest of a lip to the fold beyond: where its red ends
_CORNER = 15.0  # mm from the end of the parted lips, within which the corner is looked for
_ALONG = 0.7  # cosine: a head may be tilted or turned by 45 degrees
_BACK = np.radians(4)  # by how much the eyes lie farther back than the mouth, seen from it
_LID = 0.5  # share of the largest motion of a blink that is left at the corners of the eye


def guess_landmarks(rig):
    """Ten landmarks of a rig, from its shapes: tip of the nose, chin, lips, corners.

    A smile moves the corner of the mouth most; where a jaw drops, lips part on the middle line; a
    blink ends at the corners of the eye. The head is held straight for it, so it may be tilted or
    turned. Off by at most 2.3 mm on Aura (whose landmarks are
    guesses too), 3.2 mm on the generic face (7 mm at its eyes where they are not open in the mesh)
    and 8 mm, at the chin, on a synthetic actor: enough to start a fit; look at them before you
    trust them.

    Parameters
    ----------
    rig : BlendshapeRig
        Head frame (x to the person's left, y up, z forward), millimetres, with shapes that by
        their names open the jaw, smile and close the eyes, on both sides (ARKit's or FACS's
        names, in any spelling; see `facelab.names.arkit_names`).

    Returns
    -------
    dict of str to int

    Raises
    ------
    ValueError
        If such a shape is missing or moves nothing, the jaw parts no lips, or the eyes do not lie
        above the mouth with the left one on the left: another frame, or sides exchanged in names.

    Warns
    -----
    UserWarning
        For triangles wound inwards, which are turned over.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> sorted(guess_landmarks(rig))[:3]
    ['chin', 'eye_left_inner', 'eye_left_outer']
    """
    check_type(rig, "rig", BlendshapeRig, "give a rig")
    check_face_size(rig.neutral.vertices, "rig")
    mesh = outwards(rig.neutral, "rig")
    skin = mesh.pieces == np.bincount(mesh.pieces).argmax()
    size = {name: np.where(skin, _size(rig, name), 0) for name in _NEEDED}
    missing = [f"{what} ({name})" for name, what in _NEEDED.items() if not size[name].any()]
    if missing:
        raise ValueError(
            f"rig has no shape that by its name is {', '.join(missing)}; rename its shapes "
            "(rig.renamed), or read or pick landmarks."
        )
    mesh, found = mesh.with_vertices(mesh.vertices @ _upright(mesh.vertices, size).T), {}
    V = mesh.vertices
    mouth = _parted(V, np.flatnonzero(skin), size["jawOpen"])
    for side, out in (("left", 1), ("right", -1)):
        end = mouth[(out * V[mouth, 0]).argmax()]
        near = np.linalg.norm(V - V[end], axis=1) < _CORNER
        found[f"mouth_corner_{side}"] = int((near * size[f"mouthSmile{side.title()}"]).argmax())
        blink = size[f"eyeBlink{side.title()}"]
        lid = _lids(mesh, blink)
        found[f"eye_{side}_inner"] = int(lid[(out * V[lid, 0]).argmin()])
        found[f"eye_{side}_outer"] = int(lid[(out * V[lid, 0]).argmax()])
    found.update(_on_the_middle(mesh, skin, size["jawOpen"], found))
    return found


def _size(rig, meaning):
    """How far shapes of a meaning move each vertex together, millimetres: (n_vertices,)."""
    found = [d for n, d in zip(rig.names, rig.deltas, strict=True) if meaning in arkit_names(n)]
    moved = np.sum(found, axis=0) if found else np.zeros_like(rig.deltas[0])
    return np.linalg.norm(moved, axis=1)


def _upright(V, size):
    """The turn to a head held straight: the eyes tell where left is; the mouth below, where up is.

    Refused where that is another frame.
    """
    left, right, one, other = (
        size[name] @ V / size[name].sum()
        for name in ("eyeBlinkLeft", "eyeBlinkRight", "mouthSmileLeft", "mouthSmileRight")
    )
    across, up = left - right, (left + right - one - other) / 2
    for way, axis, what in ((across, 0, "from the right eye to the left"), (up, 1, "upwards")):
        if way[axis] < _ALONG * np.linalg.norm(way):
            x, y, z = way / np.linalg.norm(way)
            raise ValueError(
                f"rig: by its shapes the way {what} is ({x:.1f}, {y:.1f}, {z:.1f}), and it must be "
                f"{'xyz'[axis]}: turn it into the head frame (x to the person's left, y up, z "
                "forward), or rename shapes whose sides are exchanged (rig.renamed). Else read or "
                "pick landmarks."
            )
    x = across / np.linalg.norm(across)
    z = np.cross(x, up)
    z /= np.linalg.norm(z)
    c, s = np.cos(_BACK), np.sin(_BACK)
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ [x, np.cross(z, x), z]


def _lids(mesh, blink):
    """Vertices between the corners of an eye: its opening in the mesh, or what a blink moves."""
    loops = [loop for loop in mesh.boundary_loops if blink[loop].mean() > 0.2 * blink.max()]
    if loops:
        return max(loops, key=lambda loop: blink[loop].mean())
    return np.flatnonzero(blink > _LID * blink.max())


def _parted(V, skin, jaw):
    """Vertices that the jaw leaves in place close above some that it takes along."""
    up, down = skin[jaw[skin] < 0.35 * jaw.max()], skin[jaw[skin] > 0.6 * jaw.max()]
    if not len(up) or not len(down):
        return skin
    away, at = cKDTree(V[down]).query(V[up])
    under = V[up, 1] > V[down[at], 1]
    close = (away < max(2 * np.median(np.sort(away)[:50]), 5.0)) & under
    return up[close] if close.any() else skin


def _on_the_middle(mesh, skin, jaw, found):
    """Nose, lips and chin along the middle line, from where the jaw parts it."""
    V, N = mesh.vertices, mesh.normals
    corners = V[[found["mouth_corner_left"], found["mouth_corner_right"]]]
    middle, width = corners.mean(axis=0), np.linalg.norm(corners[0] - corners[1])
    x, y, z = (V - middle).T / width
    line = np.flatnonzero(
        skin & (np.abs(x) < 0.05) & (np.abs(y) < 1.3) & (z > -0.2) & (N[:, 2] > 0)
    )
    line = line[np.argsort(-V[line, 1], kind="stable")]
    drops = jaw[line] > 0.5 * jaw.max()
    above, below = line[~drops & (y[line] > -0.4)], line[drops & (y[line] < 0.4)]
    if len(above) < 4 or len(below) < 4:
        raise ValueError(
            "rig: its jaw parts no lips on the middle line of the face; it must be in the head "
            "frame (x to the person's left, y up, z forward). Else read or pick landmarks."
        )
    nose = int(above[V[above, 2].argmax()])
    lip = above[V[above, 1] < V[nose, 1] - 0.25 * width][::-1]  # from the mouth upwards
    upper, _ = _border(V, lip, width)
    lower, fold = _border(V, below, width)
    under = below[fold:]
    turned = np.flatnonzero(N[under, 2] < 0.6)  # the skin turns under the chin
    chin = under[turned[0]] if turned.size else under[-1]
    return {"nose_tip": nose, "lip_upper": upper, "lip_lower": lower, "chin": int(chin)}


def _border(V, line, width):
    """Where the red of a lip ends along a line from the mouth, and the place of the fold."""
    z = V[line, 2]
    away = np.abs(V[line, 1] - V[line[0], 1])
    full = int(np.where(away < 0.3 * width, z, -np.inf).argmax())
    reach = (np.arange(len(z)) >= full) & (away < away[full] + 0.35 * width)
    fold = int(np.where(reach, z, np.inf).argmin())
    past = np.flatnonzero(z[full : fold + 1] <= z[full] - _BORDER * (z[full] - z[fold]))
    return int(line[full + (past[0] if past.size else 0)]), fold
