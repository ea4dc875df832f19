"""A scan made fit to be matched: its scraps left out, its triangles wound outwards."""

import warnings

import numpy as np

from facelab.checks import check_type
from facelab.geometry.closest import closest_points
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.winding import agreement, share_of, turned_over, wound_inwards
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
    inwards = wound_inwards(template)
    if inwards.any():
        raise ValueError(
            f"template: {share_of(template, inwards)} are wound inwards, so that the normals point "
            "into the head. Turn them over in the file, or with facelab.geometry.outwards."
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

    Parameters and answer as of `turned_from`, but for the scan itself.

    Warns
    -----
    UserWarning
        If anything was turned over.
    """
    turned = turned_from(scan, face)
    if turned.any():
        warnings.warn(
            f"scan: {share_of(scan, turned)} are wound inwards, so that the normals point into the "
            "head; they are turned over here. Turn them over in the file, or export it with "
            "outward normals.",
            stacklevel=3,
        )
    return turned_over(scan, turned)


def turned_from(scan, face):
    """Which triangles of a scan are wound otherwise than those of a face that lies on it.

    Neighbours are made to agree first, then each patch is turned over whose nearby part faces
    against the face.

    Parameters
    ----------
    scan : TriangleMesh
    face : TriangleMesh
        Near it, wound outwards.

    Returns
    -------
    ndarray of bool, shape (n_faces,)
    """
    turned, patch = agreement(scan)
    V = scan.vertices[scan.faces]
    cross = np.cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0])
    cross[turned] *= -1
    middle = V.mean(axis=1)
    at, weights = closest_points(face, middle)
    B = rows(face, at, weights)
    near = np.linalg.norm(B @ face.vertices - middle, axis=1) < _NEAR
    along = (cross * (B @ face.normals)).sum(axis=1)  # area that faces as the face does
    size = np.linalg.norm(cross, axis=1)
    n = int(patch.max()) + 1
    told = near & (patch >= 0) & (np.abs(along) > 0.3 * size)
    both = np.bincount(patch[told], size[told], minlength=n)
    against = np.bincount(patch[told], size[told] * (along[told] < 0), minlength=n)
    # patches too far away to tell go with the most
    most = against.sum() > _OPPOSED * both.sum()
    over = np.where(both > 0, against > _OPPOSED * both, most)
    return turned ^ ((patch >= 0) & np.append(over, False)[patch])


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
