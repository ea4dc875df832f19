"""Which way round the triangles of a surface go, and turning over those that face inwards."""

import warnings

import igl
import numpy as np

from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.texture import Texture
from facelab.geometry.welding import same_place

_CLEAR = 0.3  # of all that faces in or out; a patch with less is flat or curled
_LARGE = 0.2  # of the area of the skin; smaller patches may be hollows, as of the mouth
_FEW = 0.01  # of the area of the skin: as much may be films on it, as over the eyes


def agreement(mesh):
    """What to turn over so that neighbours agree, and the patches in which they then do.

    Vertices in one place count as one, as texture seams and STL files double them.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    turned : ndarray of bool, shape (n_faces,)
    patch : ndarray of int, shape (n_faces,)
        -1 for triangles that are lines or points.
    """
    corners = same_place(mesh.vertices)[mesh.faces]
    real = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    turned, patch = np.zeros(len(corners), dtype=bool), np.full(len(corners), -1)
    if not real.size:
        return turned, patch
    agreed, patch[real] = igl.bfs_orient(np.ascontiguousarray(corners[real]))
    # the first corner stays or moves, the sense of going round tells
    first = (agreed == corners[real][:, :1]).argmax(axis=1)
    following = np.take_along_axis(agreed, ((first + 1) % 3)[:, None], axis=1)[:, 0]
    turned[real] = following != corners[real][:, 1]
    return turned, patch


def turned_over(mesh, which):
    """The mesh with some of its triangles, bool of shape (n_faces,), the other way round."""
    if not np.any(which):
        return mesh
    faces, texture = mesh.faces.copy(), mesh.texture
    faces[which] = faces[which][:, ::-1]
    if texture is not None:
        uv = texture.uv.copy()
        uv[which] = uv[which][:, ::-1]
        texture = Texture(texture.image, uv)
    return TriangleMesh(mesh.vertices, faces, mesh.landmarks, texture)


def wound_inwards(mesh):
    """Which triangles of the skin are wound inwards, told from the surface alone.

    The skin is the pieces that hold landmarks, the largest where there are none. Neighbours are
    made to agree, then a large patch faces outwards if it faces away from its own middle; of others
    the fewer are taken for wrong.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    ndarray of bool, shape (n_faces,)
        Of other pieces, such as eyes and teeth, all are False, and so are all of less than 1 % of
        the area, which harm no normal much.
    """
    turned, patch = agreement(mesh)
    skin = (patch >= 0) & _of_skin(mesh)
    turned &= skin
    V, own = mesh.vertices[mesh.faces[skin]], patch[skin]
    cross, middle = np.cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0]), V.mean(axis=1)
    cross[turned[skin]] *= -1
    area = np.linalg.norm(cross, axis=1)
    whole = np.maximum(np.bincount(own, area), 1e-12)
    centre = np.stack([np.bincount(own, area * x) / whole for x in middle.T], axis=1)
    out = (cross * (middle - centre[own])).sum(axis=1)
    both, net = np.bincount(own, np.abs(out)), np.bincount(own, out)
    fewer = np.bincount(own, area * turned[skin]) > whole / 2
    clear = (np.abs(net) > _CLEAR * both) & (whole > _LARGE * whole.sum())
    turn = turned[skin] ^ np.where(clear, net < 0, fewer)[own]
    if clear.any() and area[turn & clear[own]].sum() > whole[clear].sum() / 2:
        turn ^= ~clear[own]  # small ones go with the most
    turned[skin] = turn & (area[turn].sum() > _FEW * area.sum())
    return turned


def outwards(mesh, label="mesh"):
    """The mesh with the triangles of its skin wound outwards, in their order, with a word.

    Parameters
    ----------
    mesh : TriangleMesh
    label : str
        What it is, for the word.

    Returns
    -------
    TriangleMesh
        The same one if there is nothing to turn over.

    Warns
    -----
    UserWarning
        If anything was turned over.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> outwards(face) is face
    True
    """
    which = wound_inwards(mesh)
    if which.any():
        warnings.warn(
            f"{label}: {share_of(mesh, which)} are wound inwards, so that the normals point into "
            "the head; they are turned over here. Turn them over in the file, or export it with "
            "outward normals.",
            stacklevel=3,
        )
    return turned_over(mesh, which)


def share_of(mesh, which):
    """Words for some of the triangles of a mesh: how many, and how much of the area."""
    share = mesh.face_areas[which].sum() / max(mesh.face_areas.sum(), 1e-12)
    what = "all its triangles" if share > 0.99 else f"{int(which.sum())} of its triangles"
    return f"{what} ({100 * share:.3g} % of the area)"


def _of_skin(mesh):
    """Triangles of the pieces, seams closed, that hold landmarks, or else of the largest: bool."""
    index = same_place(mesh.vertices)
    corners = index[mesh.faces]
    real = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    if not real.any():
        return real
    pieces = TriangleMesh(mesh.vertices, corners[real]).pieces
    own, marks = pieces[corners[:, 0]], index[np.array(list(mesh.landmarks.values()), dtype=int)]
    marks = marks[np.isin(marks, corners[real])]
    return np.isin(own, pieces[marks] if marks.size else np.bincount(own, mesh.face_areas).argmax())
