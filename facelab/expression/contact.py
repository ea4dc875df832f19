"""Lips and lids held off each other: a last step for a posed face, by the least bending.

Neither paper has it. Shapes that are added, or carried to another face, push one lip through the
other. Where they do, both give way: of all displacements that part them again the one is taken
that moves and bends the skin least.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from facelab.checks import as_finite
from facelab.expression.riding import closed
from facelab.geometry.closest import closest_points
from facelab.geometry.crossings import cutting
from facelab.geometry.mesh import TriangleMesh, normals_operator, vertex_normals_by
from facelab.geometry.winding import outwards
from facelab.looks.openings import SIDES, eye_opening
from facelab.numeric.least_squares import solve_bounded

_CREASE = 10.0  # a way along the skin is so many times longer where it turns over
_LIPS, _LIDS = (90.0, 8.0), (24.0, 14.0)  # mm: from the middle of a sheet; from the other one
_AROUND = 15.0  # mm of skin around that may give way
_SOFT = 6.0  # mm over which a push spreads
_DEEP = 3.0  # mm: what is deeper inside has come from elsewhere
_FILM = 0.05  # mm that are left between the sheets
_YIELD = 0.1  # share of what lacks that is left, so that contacts may contradict each other
_MOST = 5000  # vertices around an opening: every one is held against every other
_ROUNDS, _GROWS = 6, 1.5  # pushes, each for a film so many times thicker
_TRIES, _WIDE = 4, 1.0  # each without what folded; mm around it, more with each


class Contact:
    """Holds lips and lids off each other.

    Most crossings go, not all; docs/contact.md counts them, and has millimetres and seconds.

    What the face itself has at rest stays allowed: where its lips overlap by a millimetre, as those
    of many heads do so that no light comes through, they may overlap by that wherever they meet.
    A pose in which no sheet goes deeper comes back as it is, bit for bit; so does an opening where
    no way is found that leaves fewer crossings and not one more fold within a sheet.

    Parameters
    ----------
    mesh : TriangleMesh
        The face at rest, head frame, millimetres. With landmarks of the corners and lips; openings
        without theirs are left alone.

    Raises
    ------
    ValueError
        If more than 5,000 vertices lie around an opening.

    Attributes
    ----------
    slits : dict of str to Slit
        By name: mouth, eye_left, eye_right.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> contact = Contact(rig.neutral)
    >>> contact.off(rig.neutral.vertices) is rig.neutral.vertices
    True
    """

    def __init__(self, mesh):
        body, self._index = closed(outwards(mesh))
        self._first = np.unique(self._index, return_index=True)[1]
        self._shape = mesh.vertices.shape
        self.slits = {name: Slit(body, *seeds) for name, *seeds in _slits(body)}

    def off(self, vertices):
        """A posed face whose lips and lids do not go through each other, (n_vertices, 3), mm."""
        V = as_finite(vertices, "vertices", self._shape)
        body, moved = V[self._first], False
        for slit in self.slits.values():
            push = slit.push(body)
            if push is not None:
                body[slit.skin] += push
                moved = True
        return V + (body - V[self._first])[self._index] if moved else vertices

    def counts(self, vertices):
        """Crossings at each opening of a posed face: dict of name to (more, all, within).

        Pairs of triangles of two sheets beyond those of the face at rest, all such pairs, and
        pairs within one sheet.
        """
        body = as_finite(vertices, "vertices", self._shape)[self._first]
        return {
            name: (
                len(slit.crossings(body[slit.skin] + slit.overlap)),
                len(slit.crossings(body[slit.skin])),
                len(slit.folds(body[slit.skin])),
            )
            for name, slit in self.slits.items()
        }


def _slits(mesh):
    """Name, vertices of the upper and of the lower sheet, and reach, of each opening there is."""
    marks, V = mesh.landmarks, mesh.vertices
    if {"lip_upper", "lip_lower"} <= set(marks):
        yield "mouth", [marks["lip_upper"]], [marks["lip_lower"]], _LIPS
    for side in SIDES:
        opening = eye_opening(mesh, side)
        if opening is None:
            continue
        (start, end), rim = opening.corners, opening.rim
        along = (V[rim] - start) @ (end - start) / ((end - start) @ (end - start))
        above = V[rim, 1] - (start + along[:, None] * (end - start))[:, 1]
        middle = (along > 0.15) & (along < 0.85)
        upper, lower = rim[middle & (above > 0)], rim[middle & (above < 0)]
        if len(upper) and len(lower):
            yield f"eye_{side}", upper, lower, _LIDS


class Slit:
    """The two sheets of an opening, and the skin around that gives way.

    Parameters
    ----------
    mesh : TriangleMesh
        At rest, seams closed.
    upper, lower : sequence of int
        Vertices of each sheet, from which the others are told.
    reach : (float, float)
        How far sheets go from those vertices, and from the other sheet, millimetres.

    Attributes
    ----------
    skin : ndarray of int
        Vertices that may move.
    overlap : ndarray of shape (n_skin, 3)
        What would part the sheets at rest, millimetres.
    """

    def __init__(self, mesh, upper, lower, reach):
        V, n = mesh.vertices, mesh.n_vertices
        sheets = _sheets(mesh, upper, lower, reach[0])
        trees = [cKDTree(V[own]) for own in sheets]
        facing = [trees[1 - k].query(V[own])[0] < reach[1] for k, own in enumerate(sheets)]
        core = np.concatenate([own[near] for own, near in zip(sheets, facing, strict=True)])
        self.skin, self._faces, self._meet = np.zeros(0, dtype=int), [], []
        if not all(near.any() for near in facing):
            self.overlap = np.zeros((0, 3))
            return
        away = dijkstra(mesh.adjacency, directed=False, indices=core, min_only=True)
        self.skin = np.flatnonzero(away < _AROUND)
        if len(self.skin) > _MOST:
            raise ValueError(
                f"mesh has {len(self.skin)} vertices around one opening, and contact is found for "
                f"up to {_MOST}; thin it with `mesh.subsample`, or leave contact out."
            )
        local = np.full(n, -1)
        local[self.skin] = np.arange(len(self.skin))
        F = local[mesh.faces]
        kept = (F >= 0).all(axis=1)
        near = np.isin(mesh.faces, core).any(axis=1) & kept
        above, below = (np.isin(mesh.faces, own).sum(axis=1) >= 2 for own in sheets)
        self._faces = [F[near & above], F[near & below]]
        self._around = F[kept]
        self._normals = normals_operator(self._around, len(self.skin))
        self._compliance = _compliance(mesh, self.skin)
        rest = V[self.skin]
        self._sides = [
            _Side(rest, F, G) for F, G in zip(self._faces, self._faces[::-1], strict=True)
        ]
        self.overlap, self._known = np.zeros_like(rest), set()
        if len(self._cut(rest)):
            parted = self._parted(rest, np.inf, 20)
            self.overlap = self.overlap if parted is None else parted
            self._known = set(map(tuple, self._cut(rest + self.overlap).tolist()))

    def _cut(self, X):
        return cutting(X, *self._faces)

    def crossings(self, X):
        """Pairs of triangles of the two sheets that cut; those that nothing parts at rest aside."""
        if not self._faces:
            return set()
        return set(map(tuple, self._cut(X).tolist())) - self._known

    def folds(self, X):
        """Pairs of triangles of one sheet that cut: set of (sheet, triangle, triangle)."""
        return {(k, *pair) for k, F in enumerate(self._faces) for pair in cutting(X, F).tolist()}

    def push(self, vertices):
        """What parts the sheets of a posed face, (n_skin, 3), or None."""
        if not self._faces:
            return None
        V = vertices[self.skin]
        if not self.crossings(V + self.overlap):
            return None
        return self._parted(V, len(self.folds(V)), _ROUNDS)

    def _parted(self, V, most, rounds):
        """The best displacement after a few rounds of pushes, with at most so many folds."""
        X0 = V + self.overlap
        fewest, best = len(self.crossings(X0)), None
        before = self.folds(V)
        still = np.zeros(len(V), dtype=bool)
        for k in range(_TRIES):
            bad = set()
            for X in self._pushes(X0, still, rounds):
                n = len(self.crossings(X))
                if n >= fewest:
                    continue
                folds = self.folds(X - self.overlap) if most < np.inf else ()
                if len(folds) > most:
                    bad |= folds - before
                else:
                    fewest, best = n, X - X0
                if n == 0:
                    break
            if fewest == 0 or not bad:
                break
            at = np.unique([self._faces[which][[i, j]] for which, i, j in bad])
            still |= cKDTree(X0[at]).query(X0)[0] <= k * _WIDE
        return best

    def _pushes(self, X, still, rounds):
        """Faces after one push, after two, and so on."""
        film, held = _FILM, np.flatnonzero(still)
        back = np.linalg.solve(self._compliance[np.ix_(held, held)], self._compliance[held])
        for _ in range(rounds):
            normals = vertex_normals_by(self._normals, X, self._around)
            rows = [side.contacts(X, normals, film, still) for side in self._sides]
            A, n, depth = map(_stacked, zip(*rows, strict=True))
            give = A @ self._compliance
            give -= give[:, held] @ back
            # least d' K d / 2 with n . A d >= depth: the dual has a force of 0 or more for each
            H = (A @ give.T) * (n @ n.T)
            free = np.diagonal(H) > 1e-9
            H, give, n, depth = H[np.ix_(free, free)], give[free], n[free], depth[free]
            if not len(H):
                return
            H[np.diag_indices(len(H))] *= 1 + _YIELD
            force, _ = solve_bounded(H, depth, np.zeros(len(H)), np.full(len(H), np.inf))
            X = X + give.T @ (force[:, None] * n)
            yield X
            film *= _GROWS


def _sheets(mesh, upper, lower, far):
    """Vertices of the upper and of the lower sheet: those nearer to it along the skin.

    Ways that turn over a crease are long: so the corner of a mouth is parted along its crease.
    """
    A, N = mesh.adjacency.tocoo(), mesh.normals
    bend = 1 - (N[A.row] * N[A.col]).sum(axis=1)
    A = sp.csr_array((A.data * (1 + _CREASE * bend), (A.row, A.col)), shape=A.shape)
    a, b = (dijkstra(A, directed=False, indices=s, min_only=True) for s in (upper, lower))
    return np.flatnonzero((a < b) & (a < far)), np.flatnonzero((b <= a) & (b < far))


def _compliance(mesh, skin):
    """How far each vertex of the skin gives way to a force on each: (n_skin, n_skin).

    The inverse of a plate's stiffness, (M + s^2 L) M^-1 (M + s^2 L), held at its edge.
    """
    M = np.maximum(mesh.vertex_areas, 1e-3)[skin]
    L = mesh.laplacian("cotangent", normalised=False)[skin][:, skin]
    S = np.linalg.inv((sp.diags_array(M) + _SOFT**2 * L).toarray())
    return S @ (M[:, None] * S)


class _Side:
    """Places of one sheet, vertices and middles of edges, held against the other sheet."""

    def __init__(self, rest, own, other):
        edges = np.sort(np.concatenate([own[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
        vertices = np.unique(own)
        self._ends = np.concatenate(
            [np.stack([vertices, vertices], axis=1), np.unique(edges, axis=0)]
        )
        self._ends = self._ends[~np.isin(self._ends, other).any(axis=1)]
        self._kept, faces = np.unique(other, return_inverse=True)
        self._mesh = TriangleMesh(rest[self._kept], faces.reshape(-1, 3))
        self._other = other
        sides = np.sort(np.stack([other[:, [1, 2]], other[:, [2, 0]], other[:, [0, 1]]], 1), axis=2)
        key = sides[..., 0] * len(rest) + sides[..., 1]
        _, back, times = np.unique(key, return_inverse=True, return_counts=True)
        self._border = times[back].reshape(key.shape) == 1  # the edge that faces each corner

    def contacts(self, X, normals, film, still):
        """Contacts: rows that take displacements to their gaps, directions, what is lacking."""
        Y = X[self._kept]
        P, ends = X[self._ends].mean(axis=1), self._ends
        near = ((P > Y.min(axis=0) - film) & (P < Y.max(axis=0) + film)).all(axis=1)
        P, ends = P[near], ends[near]
        if not len(P):
            return sp.csr_array((0, len(X))), np.zeros((0, 3)), np.zeros(0)
        face, share = closest_points(self._mesh.with_vertices(Y), P)
        corners = self._other[face]
        foot = (share[..., None] * X[corners]).sum(axis=1)
        n = _unit((share[..., None] * normals[corners]).sum(axis=1))
        depth, off = ((foot - P) * n).sum(axis=1), np.linalg.norm(foot - P, axis=1)
        facing = (n * normals[ends].sum(axis=1)).sum(axis=1) < 0
        held = still[ends].any(axis=1) | still[corners].any(axis=1)
        rim = ((share < 1e-6) & self._border[face]).any(axis=1)
        # straight below the surface, or above it by less than the film
        use = (depth > -film) & (depth < _DEEP) & (np.abs(depth) > 0.7 * off - 1e-9)
        use &= facing & ~rim & ~held
        ends, corners, share, m = ends[use], corners[use], share[use], int(use.sum())
        rows = np.concatenate([np.repeat(np.arange(m), 2), np.repeat(np.arange(m), 3)])
        columns = np.concatenate([ends.ravel(), corners.ravel()])
        values = np.concatenate([np.full(2 * m, 0.5), -share.ravel()])
        A = sp.csr_array((values, (rows, columns)), shape=(m, len(X)))
        return A, n[use], depth[use] + film


def _stacked(parts):
    return sp.vstack(parts) if sp.issparse(parts[0]) else np.concatenate(parts)


def _unit(v):
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
