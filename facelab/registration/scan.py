"""A scan made fit to be matched: its scraps left out, its triangles wound outwards."""

import warnings

import igl
import numpy as np

from facelab.checks import check_type
from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import TriangleMesh
from facelab.registration.warp import rows

_SCRAP = 0.02  # of the area of the largest piece; an eyeball has more
_NEAR = 10.0  # mm; only what lies as near to the face has a say in how a piece is wound
_OPPOSED = 0.6  # share of that which faces inwards, to turn a piece over


def check_template(template):
    """Refuse a template whose landmarks lie off its surface, or that is wound inwards.

    Markers stand off the skin and scans are matched along its normals, so both would go wrong.

    Warns
    -----
    UserWarning
        For a surface that is cut where vertices lie at the same place.
    """
    check_type(template, "template", TriangleMesh, "facelab.load_template() is one")
    held = np.zeros(template.n_vertices, dtype=bool)
    held[template.faces] = True
    off = [name for name, vertex in template.landmarks.items() if not held[vertex]]
    if off:
        raise ValueError(
            f"template: its landmarks {', '.join(off[:6])}{', ...' * (len(off) > 6)} are vertices "
            "of no triangle, so they have no normal; give landmarks on the surface."
        )
    V = template.vertices[template.faces]
    area = np.cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0])
    out = (area * (V.mean(axis=1) - template.vertices[held].mean(axis=0))).sum(axis=1)
    if out.sum() < -0.3 * np.abs(out).sum():
        raise ValueError(
            "template: its triangles are wound inwards, so that the normals point into the head. "
            "Turn them over: TriangleMesh(template.vertices, template.faces[:, ::-1], "
            "template.landmarks)."
        )
    index = _joined(template)
    closed = len(_border(template.faces)) - len(_border(index[template.faces]))
    if closed > 0:
        warnings.warn(
            f"template: {closed} edges of its border lie on each other, as along the seams of a "
            "texture, and come apart when the face moves. Unless they are closed lids or lips, "
            "use template.welded()[0].",
            stacklevel=3,
        )


def check_scan(scan):
    """Refuse what is no surface."""
    check_type(scan, "scan", TriangleMesh, "read it with facelab.read_mesh")
    if not scan.face_areas.sum() > 0:
        raise ValueError("scan has no area: all its triangles are lines or points.")


def _joined(scan):
    """Vertices at the same place as one, as texture seams and STL files double them: index."""
    try:
        return scan.welded()[1]
    except ValueError:  # nothing would be left
        return np.arange(scan.n_vertices)


def without_scraps(scan, marks):
    """The scan without small loose pieces that hold no landmark, and a warning that says so.

    Parameters
    ----------
    scan : TriangleMesh
    marks : array_like of int
        Vertices that are landmarks.

    Returns
    -------
    TriangleMesh
        Same vertices; the triangles of pieces of less than 2 % of the largest one's area are gone.

    Warns
    -----
    UserWarning
        With their number and size.
    """
    index = _joined(scan)
    corners = index[scan.faces]
    real = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    if not real.any():
        return scan
    piece = TriangleMesh(scan.vertices, corners[real]).pieces[index]
    of_face = piece[scan.faces[:, 0]]
    area = np.bincount(of_face, scan.face_areas, minlength=piece.max() + 1)
    scrap = area < _SCRAP * area.max()
    scrap[piece[np.asarray(marks, dtype=int)]] = False
    gone = scrap[of_face]
    if not gone.any():
        return scan
    found = np.unique(of_face[gone])
    warnings.warn(
        f"scan: {len(found)} loose piece(s) of {int(gone.sum())} triangles in all, each less than "
        f"{100 * _SCRAP:g} % of the largest in area and without a landmark, are left out. If they "
        "belong to the face, join them to it.",
        stacklevel=3,
    )
    return TriangleMesh(scan.vertices, scan.faces[~gone], scan.landmarks)


def wound_outwards(scan, face):
    """The scan with its triangles wound as those of a face that lies on it, with a word.

    Neighbours are made to agree first, then each piece is turned over whose nearby part faces
    against the face.

    Parameters
    ----------
    scan : TriangleMesh
    face : TriangleMesh
        Near it, wound outwards.

    Returns
    -------
    TriangleMesh

    Warns
    -----
    UserWarning
        If anything was turned over.
    """
    corners = _joined(scan)[scan.faces]
    real = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    agreed, patch = igl.bfs_orient(np.ascontiguousarray(corners[real]))
    turned = np.zeros(len(scan.faces), dtype=bool)
    # the first corner stays or moves, the sense of going round tells
    first = (agreed == corners[real][:, :1]).argmax(axis=1)
    following = np.take_along_axis(agreed, ((first + 1) % 3)[:, None], axis=1)[:, 0]
    turned[real] = following != corners[real][:, 1]
    V = scan.vertices[scan.faces]
    cross = np.cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0])
    cross[turned] *= -1
    middle = V.mean(axis=1)
    at, weights = closest_points(face, middle)
    B = rows(face, at, weights)
    near = np.linalg.norm(B @ face.vertices - middle, axis=1) < _NEAR
    along = (cross * (B @ face.normals)).sum(axis=1)  # area that faces as the face does
    size = np.linalg.norm(cross, axis=1)
    label = np.full(len(scan.faces), -1)
    label[real] = patch
    n = int(patch.max()) + 1 if len(patch) else 0
    told = near & (label >= 0) & (np.abs(along) > 0.3 * size)
    both = np.bincount(label[told], size[told], minlength=n)
    against = np.bincount(label[told], size[told] * (along[told] < 0), minlength=n)
    # pieces too far away to tell go with the most
    most = against.sum() > _OPPOSED * both.sum()
    over = np.where(both > 0, against > _OPPOSED * both, most)
    turned ^= (label >= 0) & over[np.maximum(label, 0)]
    if not turned.any():
        return scan
    share = scan.face_areas[turned].sum() / scan.face_areas.sum()
    what = "all its triangles" if share > 0.99 else f"{int(turned.sum())} of its triangles"
    warnings.warn(
        f"scan: {what} ({100 * share:.3g} % of the area) are wound inwards, so that the normals "
        "point into the head; they are turned over here. Turn them over in the file, or export "
        "it with outward normals.",
        stacklevel=3,
    )
    faces = scan.faces.copy()
    faces[turned] = faces[turned][:, ::-1]
    return TriangleMesh(scan.vertices, faces, scan.landmarks)


def on_border(scan):
    """Which vertices lie on the border of a scan, seams closed: bool, shape (n_vertices,)."""
    index = _joined(scan)
    border = np.zeros(scan.n_vertices, dtype=bool)
    border[_border(index[scan.faces])] = True
    return border[index]


def _border(faces):
    """Edges of one triangle alone: ndarray of int, shape (n_edges, 2)."""
    half = np.sort(np.vstack([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    edges, count = np.unique(half[half[:, 0] != half[:, 1]], axis=0, return_counts=True)
    return edges[count == 1]
