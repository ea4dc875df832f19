"""A head that rides on a template: skin with the skin, other parts rigidly, the rest fading out."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from facelab.geometry.alignment import procrustes
from facelab.geometry.binding import bind_to_surface
from facelab.geometry.closest import closest_points
from facelab.geometry.jaw import Jaw
from facelab.geometry.mesh import MULTI_PIE, TriangleMesh
from facelab.geometry.size import longest_side
from facelab.geometry.welding import (
    alike,
    near_borders,
    numbered,
    rejoined,
    same_place,
    shrunk,
)
from facelab.geometry.winding import agreement, turned_over
from facelab.names import as_landmarks
from facelab.numeric.sparse import SparseFactor

FADE = 60.0
"""Millimetres along the surface over which motion fades out beyond what the template covers."""

_PLACE = 1e-3  # mm: vertices so near to each other are two sides of a seam
_NEAR = 0.1  # mm: so near to each other two pieces of one surface end along the same edges
_CORNER = 10.0  # mm: a fold so short is a corner of the mouth
_FACE = 100.0  # mm: a piece with landmarks and so long is a face by itself
_WORN = 0.8  # share of a piece near the skin that is worn on it: lashes, brows
_ROOT, _STANDS = 2.0, 0.4  # mm from the skin, and share of its border: a strip grows from there
_ON, _ROOTED = 0.05, 0.25  # the same of one whose roots are vertices of the skin
_FAR = 12.0  # mm from there to its other edge, less than over the front of an eye
_JOINT = np.array([0.0, 55.0, -85.0])  # mm from the chin to the joint of the jaw, about


def skin_of(mesh):
    """Vertices of the skin: the pieces that hold landmarks, or all where those make no face.

    Parameters
    ----------
    mesh : TriangleMesh
        Seams closed.

    Returns
    -------
    ndarray of bool, shape (n_vertices,)
    """
    marks = list(mesh.landmarks.values())
    found = np.isin(mesh.pieces, mesh.pieces[marks])
    if not found.any() or longest_side(mesh.vertices[found]) < _FACE:
        return np.ones(mesh.n_vertices, dtype=bool)
    return found


def closed(mesh):
    """The mesh with its seams closed, and its vertex for each vertex of this one.

    Vertices in one place are joined unless they face away from each other, as the two sides of a
    sheet do; pieces also where they end along the same edges, but for `_NEAR`. Landmarks are
    spelled as in `MULTI_PIE`.

    Returns
    -------
    mesh : TriangleMesh
    index : ndarray of int, shape (n_vertices,)
    """
    V, marks = mesh.vertices, as_landmarks(MULTI_PIE, mesh.landmarks)
    place = same_place(V, min(_PLACE, 5e-6 * longest_side(V)))
    reach = min(_NEAR, 5e-4 * longest_side(V))
    near = near_borders(V, mesh.faces, reach) if len(V) < 3 * len(mesh.faces) else place
    if min(place.max(), near.max()) + 1 == len(V):
        known = list(marks) == list(mesh.landmarks)
        return mesh if known else TriangleMesh(V, mesh.faces, marks), np.arange(len(V))
    # unit normals 60 degrees apart differ by at most 1 in each coordinate, opposed by more
    turned = turned_over(mesh, agreement(mesh)[0])
    index = alike(place, [turned.normals], 1.0)
    index = _along_edges(turned, near, index)
    index = _without_strips(mesh, index)
    kept = np.unique(index, return_index=True)[1]
    marks = {name: int(index[v]) for name, v in marks.items()}
    return TriangleMesh(V[kept], rejoined(mesh.faces, index), marks), index


def _without_strips(mesh, index):
    """Groups of vertices, but pieces that stand on a surface are not joined to it.

    A seam is of edges, and an edge has two triangles; where joining gives it more, as at the roots
    of lashes on a lid, the smaller pieces stand on it.
    """
    faces, piece = mesh.faces[~shrunk(mesh.faces, index)], mesh.pieces
    F, size = index[faces], np.bincount(piece)
    ends = np.sort(np.stack([F.T.ravel(), np.roll(F, -1, axis=1).T.ravel()]), axis=0)
    edge, owner = ends.T @ [F.max() + 1, 1], np.tile(piece[faces[:, 0]], 3)
    order = np.lexsort((owner, -size[owner], edge))
    edge, owner = edge[order], owner[order]
    place = np.arange(len(edge)) - np.searchsorted(edge, edge)  # among the triangles of its edge
    third = (place > 1) & (owner != owner[np.searchsorted(edge, edge)])
    shared = (edge[1:] == edge[:-1]) & (owner[1:] != owner[:-1])
    seams = np.union1d(owner[1:][shared], owner[:-1][shared])
    strips = np.union1d(owner[third], np.setdiff1d(owner, seams))
    apart = np.where(np.isin(piece, strips), piece + 1, 0)
    return np.unique(np.stack([index, apart], axis=1), axis=0, return_inverse=True)[1].ravel()


def _along_edges(mesh, place, index):
    """Groups of vertices joined also where just two triangles, of two pieces, share an edge.

    Not along a line where they fold back on each other: there lips or lids touch. A fold as short
    as at a corner of the mouth is none.
    """
    F = mesh.faces
    a, b = F.T.ravel(), np.roll(F, -1, axis=1).T.ravel()  # from a to b in one, from b to a in two
    owner, n = np.tile(np.arange(len(F)), 3), place.max() + 1
    _, edge, count = np.unique(
        np.sort([place[a], place[b]], axis=0).T @ [n, 1], return_inverse=True, return_counts=True
    )
    pairs = np.argsort(edge, kind="stable")
    pairs = pairs[(count == 2)[edge[pairs]]].reshape(-1, 2)
    pairs = pairs[place[a[pairs[:, 0]]] == place[b[pairs[:, 1]]]]
    one, two = pairs[mesh.pieces[a[pairs[:, 0]]] != mesh.pieces[a[pairs[:, 1]]]].T
    X = mesh.vertices[F]
    N = np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])
    N /= np.maximum(np.linalg.norm(N, axis=1, keepdims=True), 1e-12)
    folded = (N[owner[one]] * N[owner[two]]).sum(axis=1) < -0.5
    ends = np.append(a[one[folded]], b[one[folded]])
    line = _components(n, *place[ends].reshape(2, -1))[place[ends]]
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    np.minimum.at(low, line, mesh.vertices[ends])
    np.maximum.at(high, line, mesh.vertices[ends])
    folded[folded] = (high - low).max(axis=1)[line[: folded.sum()]] >= _CORNER
    one, two = one[~folded], two[~folded]
    ends = np.append(index[a[one]], index[b[one]]), np.append(index[b[two]], index[a[two]])
    return numbered(_components(index.max() + 1, *ends)[index])


def _components(n, a, b):
    """Number of the group of each of n things that pairs (a, b) hold together."""
    pairs = sp.coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    return connected_components(pairs, directed=False)[1]


class Rider:
    """A mesh that rides on another, and keeps its lips and lids apart.

    A vertex of the skin whose closest place on the carrier is far off or faces elsewhere (the
    inside of a lip is close to the other lip) does not ride: it follows its own neighbours,
    harmonically. Where the carrier has ended, that motion fades out along the surface, to nothing
    at `fade` millimetres or at the rim. Vertices on two sides of a seam move alike.

    Pieces that are not skin move rigidly: with the piece of the carrier in the same place, if
    there is one (eyes, teeth); else a piece behind the lips with the jaw, if it lies below the
    line of the mouth. What lies close on the skin all over (brows) rides on it, and a strip that
    stands off it (lashes) goes with the edge that it grows from. All others stay.

    Parameters
    ----------
    carrier, mesh : TriangleMesh
        In the same place, millimetres; the carrier's landmarks tell its skin and its mouth.
    far : float, default=5.0
        Distance from the carrier up to which the mesh rides, millimetres.
    fade : float or None
        None: motion goes on unchanged beyond the carrier.
    """

    def __init__(self, carrier, mesh, far=5.0, fade=FADE):
        self.rest = mesh.vertices
        body, self._index = closed(mesh)
        self._base, base_index = closed(carrier)
        self._first = np.unique(base_index, return_index=True)[1]
        skin = skin_of(self._base)
        self._skin = np.flatnonzero(skin)
        under = self._base if skin.all() else self._base.submesh(self._skin)
        self.binding = bind_to_surface(under, body)
        corners = under.faces[self.binding.faces]
        normal = (self.binding.barycentric[..., None] * under.normals[corners]).sum(axis=1)
        agrees = (normal * body.normals).sum(axis=1) > 0.5 * np.linalg.norm(normal, axis=1)
        rides = agrees & (np.linalg.norm(self.binding.offsets, axis=1) < far)
        own = _skin_pieces(body, rides, skin.all())
        rides[own & ~np.isin(body.pieces, body.pieces[rides])] = True  # a piece that none would
        self._body, self._own = body, own
        self.rides, self.loose = np.flatnonzero(rides & own), np.flatnonzero(~rides & own)
        if self.loose.size:
            L = body.laplacian("uniform", normalised=False)[self.loose]
            self._solver, self._pull = SparseFactor(L[:, self.loose]), -L[:, self.rides]
            self._left = np.ones((len(self.loose), 1))
            if fade is not None:
                ended = _on_outline(under, self.binding)
                self._left = _fading(body, self.loose, self.rides, ended, fade)[:, None]
        self._parts = [
            self._carried_by(np.flatnonzero(body.pieces == p), far)
            for p in np.unique(body.pieces[~own])
        ]

    @property
    def covered(self):
        """Vertices of the mesh that ride on the skin of the carrier: bool, (n_vertices,)."""
        return np.isin(self._index, self.rides)

    def carry(self, vertices):
        """The mesh on the moved carrier, exact at rest."""
        vertices = np.asarray(vertices)[self._first]
        V, rest = self._body.vertices.copy(), self._body.vertices
        moved = self.binding.carry(vertices[self._skin]) - rest
        V[self.rides] += moved[self.rides]
        if self.loose.size:
            V[self.loose] += self._left * self._solver.solve(self._pull @ moved[self.rides])
        for piece, move in self._parts:
            V[piece] = move(rest[piece], vertices, V)
        return self.rest + (V - rest)[self._index]

    # --- what is not skin -------------------------------------------------------------------------

    def _carried_by(self, piece, far):
        """Vertices of a piece, and how they go: (at rest, moved carrier, moved skin) to places."""
        V = self._body.vertices[piece]
        twin = self._twin(V)
        if twin is not None:
            rest = self._base.vertices[twin]
            return piece, lambda X, base, _: procrustes(rest, base[twin]).apply(X)
        skin = self._body.submesh(self._own)
        faces, weights = closest_points(skin, V)
        foot = (weights[..., None] * skin.vertices[skin.faces[faces]]).sum(axis=1)
        away = np.linalg.norm(foot - V, axis=1)
        edge = self._attached(piece, away)
        if edge.size:
            root, nearest = bind_to_surface(skin, V[edge]), cKDTree(V[edge]).query(V)[1]
            return piece, lambda X, _, head: X + (root.carry(head[self._own]) - V[edge])[nearest]
        facing = (weights * skin.normals[skin.faces[faces]][..., 2]).sum(axis=1)
        inside = self._behind_lips(V) and np.median(facing) < 0  # on the lining, as front teeth are
        if not (_is_ball(V) or inside) and (away < far).mean() > _WORN:
            worn = bind_to_surface(skin, V)
            return piece, lambda X, _, head: worn.carry(head[self._own])
        share = self._share_of_jaw(V)
        if share is not None:
            rest, chin = self._base.vertices, self._base.landmarks["chin"]
            jaw = Jaw(rest, chin, rest[chin] + _JOINT)
            return piece, lambda X, base, _: X + share * (jaw.motion(base).apply(X) - X)
        return piece, lambda X, *_: X

    def _attached(self, piece, away):
        """Vertices of a strip's border along which it grows from the skin: of lashes, of a hair.

        None behind the lips, where the roots of teeth lie as near to a lining.
        """
        V, none = self._body.vertices[piece], piece[:0]
        if not np.isin(self._body.faces[:, 0], piece).any():  # a vertex of no triangle
            return none
        loops = self._body.submesh(piece).boundary_loops
        if not loops or self._behind_lips(V) is not False:
            return none
        border = np.unique(np.concatenate(loops))
        on, near = (border[away[border] < least] for least in (_ON, _ROOT))
        if _ROOTED * len(border) < len(on) < len(border):  # the rest may lie along the lid
            return on
        if away.max() <= _ROOT or len(near) < max(2, _STANDS * len(border)):
            return none
        return near if cKDTree(V[near]).query(V)[0].max() < _FAR else none

    def _twin(self, V):
        """Vertices of the piece of the carrier that is in the same place and as large, or None."""
        others = np.setdiff1d(np.unique(self._base.pieces), self._base.pieces[self._skin])
        size, middle = longest_side(V), _middle(V)
        for p in others:
            piece = np.flatnonzero(self._base.pieces == p)
            there = self._base.vertices[piece]
            near = np.linalg.norm(_middle(there) - middle) < 0.25 * size
            if near and 0.6 < longest_side(there) / size < 1.6 and len(piece) > 3:
                return piece
        return None

    def _mouth(self):
        marks = self._base.landmarks
        return [
            self._base.vertices[marks[name]]
            for name in ("mouth_corner_left", "mouth_corner_right")
            if name in marks and "chin" in marks
        ]

    def _behind_lips(self, V):
        """Whether a piece lies where teeth and gums do; None where the mouth is not known."""
        corners = self._mouth()
        if len(corners) < 2:
            return None
        x, y, z = _middle(V) - np.mean(corners, axis=0)
        return bool(longest_side(V) <= 110 and abs(x) <= 35 and -80 < z < 20 and -40 < y < 30)

    def _share_of_jaw(self, V):
        """How far what lies behind the lips goes with the jaw: 1, 0 to 1 for each, or None."""
        if not self._behind_lips(V):
            return None
        left, right = self._mouth()
        # the line where the rows of teeth meet rises a little towards the back
        above = (V - (left + right) / 2) @ [0, 1, 0.1] - 3.0
        if np.ptp(above) < 35:  # a tooth, a row of teeth, a tongue
            return 1.0 if np.median(above) < 0 else None
        return np.clip(0.5 - above / 8, 0, 1)[:, None]  # gums, a lining: of both


def _is_ball(V):
    """Whether a piece is an eyeball: its vertices lie about a sphere of that size."""
    if len(V) < 12:
        return False
    # |v|^2 = 2 c . v + (r^2 - |c|^2) is linear in the centre c and the last bracket
    mean = V.mean(axis=0)
    A = np.c_[2 * (V - mean), np.ones(len(V))]
    c, square = np.split(np.linalg.lstsq(A, ((V - mean) ** 2).sum(axis=1), rcond=None)[0], [3])
    radius = np.sqrt(max(float(square[0] + c @ c), 0.0))
    off = np.linalg.norm(V - mean - c, axis=1) - radius
    round_about = np.ptp(V, axis=0).min() > 1.2 * radius  # more than a cap, as a lid is
    return bool(5 < radius < 30 and round_about and np.sqrt((off**2).mean()) < 0.12 * radius)


def _middle(V):
    return (V.min(axis=0) + V.max(axis=0)) / 2


def _skin_pieces(body, rides, whole):
    """Vertices of the pieces that are skin: those with landmarks, and those that mostly ride."""
    share = np.bincount(body.pieces, rides) / np.bincount(body.pieces)
    found = (share > 0.5)[body.pieces]
    marked = skin_of(body)
    if not marked.all():
        found |= marked
    if not found.any() or (whole and longest_side(body.vertices[found]) < _FACE):
        found[:] = True  # no face: toys, single patches
    return found


def _on_outline(carrier, binding):
    """Points whose foot is on the outer border of the carrier: bool."""
    loops = carrier.boundary_loops
    on = np.zeros(carrier.n_vertices, dtype=bool)
    if loops:
        on[max(loops, key=lambda loop: np.ptp(carrier.vertices[loop], axis=0).sum())] = True
    corners = carrier.faces[binding.faces]
    return ((binding.barycentric > 1e-6) <= on[corners]).all(axis=1)


def _fading(body, loose, rides, ended, fade):
    """What is left of the motion at each loose vertex: 1 inside, less and less beyond the end."""
    left = np.ones(body.n_vertices)
    among = body.adjacency[loose][:, loose]
    group = connected_components(among, directed=False)[1]
    outside = loose[np.isin(group, group[ended[loose]])]
    if not outside.size:
        return left[loose]
    beyond = np.zeros(body.n_vertices, dtype=bool)
    beyond[outside] = True
    away = dijkstra(body.adjacency, directed=False, indices=rides, min_only=True)
    still = beyond & (away >= fade)
    for loop in body.boundary_loops:
        still[loop] |= beyond[loop]
    if still.any():
        to = dijkstra(body.adjacency, directed=False, indices=np.flatnonzero(still), min_only=True)
        t = away[outside] / np.maximum(away[outside] + to[outside], 1e-9)
        left[outside] = 1 - t * t * (3 - 2 * t)
    return left[loose]
