"""Triangle meshes: the ground that everything else stands on.

Lengths are millimetres. Head frame: x to the person's left, y up, z forward.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra

from facelab.checks import as_finite, as_indices, check_choice, check_index, check_number
from facelab.geometry.texture import Texture
from facelab.geometry.welding import same_place, shrunk

MULTI_PIE = (
    *(f"jaw_right_{i}" for i in range(1, 9)),
    "chin",
    *(f"jaw_left_{i}" for i in range(8, 0, -1)),
    *(f"brow_right_{i}" for i in range(1, 6)),  # outer end to inner end
    *(f"brow_left_{i}" for i in range(5, 0, -1)),
    *("nose_bridge_1", "nose_bridge_2", "nose_bridge_3", "nose_tip"),
    *("nostril_right_outer", "nostril_right_inner", "nose_base"),
    *("nostril_left_inner", "nostril_left_outer"),
    *("eye_right_outer", "eye_right_upper_outer", "eye_right_upper_inner"),
    *("eye_right_inner", "eye_right_lower_inner", "eye_right_lower_outer"),
    *("eye_left_inner", "eye_left_upper_inner", "eye_left_upper_outer"),
    *("eye_left_outer", "eye_left_lower_outer", "eye_left_lower_inner"),
    *("mouth_corner_right", "lip_upper_right_outer", "lip_upper_right_inner", "lip_upper"),
    *("lip_upper_left_inner", "lip_upper_left_outer", "mouth_corner_left"),
    *("lip_lower_left_outer", "lip_lower_left_inner", "lip_lower"),
    *("lip_lower_right_inner", "lip_lower_right_outer"),
    *("mouth_inner_right", "mouth_inner_upper_right", "mouth_inner_upper"),
    *("mouth_inner_upper_left", "mouth_inner_left", "mouth_inner_lower_left"),
    *("mouth_inner_lower", "mouth_inner_lower_right"),
)
"""Names of the 68 facial landmarks in the Multi-PIE order; left and right are the person's."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh that never changes; a moved face is a new mesh with the same faces.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
        Positions, millimetres.
    faces : ndarray of int, shape (n_faces, 3)
        Vertex indices, counter-clockwise seen from outside.
    landmarks : dict of str to int, optional
        Named vertices; the 68 facial ones are called as in `MULTI_PIE`.
    texture : Texture, optional
        Its base colours.

    Raises
    ------
    ValueError
        For wrong shapes, coordinates that are not finite, an index out of range, a face that
        uses a vertex twice, no vertices or no faces.

    Examples
    --------
    >>> from facelab import TriangleMesh
    >>> corners = [[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]]
    >>> square = TriangleMesh(corners, [[0, 1, 2], [0, 2, 3]])
    >>> square.n_vertices, float(square.face_areas.sum())
    (4, 100.0)
    """

    vertices: np.ndarray
    faces: np.ndarray
    landmarks: dict = field(default_factory=dict)
    texture: Texture | None = None

    def __post_init__(self):
        V = as_finite(self.vertices, "vertices", ("n_vertices", 3))
        F = np.asarray(self.faces)
        if len(V) == 0:
            raise ValueError("vertices is empty: a mesh needs at least three vertices.")
        if F.size == 0:
            raise ValueError("faces is empty: a mesh needs at least one triangle.")
        if F.ndim != 2 or F.shape[1] != 3 or F.dtype.kind not in "iu":
            raise ValueError(
                f"faces has shape {F.shape} and type {F.dtype}, but needs shape (n_faces, 3) and "
                "integers; triangulate polygons first."
            )
        F = F.astype(np.int64)
        out = np.flatnonzero(((F < 0) | (F >= len(V))).any(axis=1))
        if out.size:
            raise ValueError(
                f"faces[{out[0]}] = {F[out[0]].tolist()} names a vertex that does not exist: "
                f"indices run from 0 to {len(V) - 1}."
            )
        twice = np.flatnonzero((F == np.roll(F, 1, axis=1)).any(axis=1))
        if twice.size:
            raise ValueError(
                f"faces[{twice[0]}] = {F[twice[0]].tolist()} uses a vertex twice; remove it."
            )
        if self.texture is not None and len(self.texture.uv) != len(F):
            raise ValueError(
                f"texture has {len(self.texture.uv)} faces, but the mesh {len(F)}; give one of the "
                "same faces."
            )
        landmarks = {
            name: check_index(vertex, f"landmarks[{name!r}]", len(V), "vertices")
            for name, vertex in self.landmarks.items()
        }
        for name, array in (("vertices", V), ("faces", F)):
            array = array.copy()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "landmarks", landmarks)

    def __repr__(self):
        return f"TriangleMesh({self.n_vertices} vertices, {len(self.faces)} faces)"

    @property
    def n_vertices(self):
        """Number of vertices."""
        return len(self.vertices)

    def with_vertices(self, vertices):
        """The same faces, landmarks and texture on other positions, (n_vertices, 3), mm."""
        vertices = as_finite(vertices, "vertices", self.vertices.shape)
        moved = TriangleMesh(vertices, self.faces, self.landmarks, self.texture)
        if "edges" in self.__dict__:  # what only the faces decide is carried over
            moved.__dict__["edges"] = self.edges
        return moved

    @cached_property
    def edges(self):
        """Edges as ordered vertex pairs, each once: ndarray of int, shape (n_edges, 2)."""
        return np.unique(np.sort(self._half_edges, axis=1), axis=0)

    @property
    def _half_edges(self):
        return np.vstack([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])

    @cached_property
    def adjacency(self):
        """Edge lengths, millimetres: symmetric sparse array, shape (n_vertices, n_vertices)."""
        a, b = self.edges.T
        length = np.linalg.norm(self.vertices[a] - self.vertices[b], axis=1)
        n = self.n_vertices
        one_way = sp.coo_array((np.maximum(length, 1e-12), (a, b)), shape=(n, n))
        return sp.csr_array(one_way + one_way.T)

    @cached_property
    def pieces(self):
        """Connected piece that each vertex belongs to: ndarray of int, shape (n_vertices,)."""
        return connected_components(self.adjacency, directed=False)[1]

    @cached_property
    def face_areas(self):
        """Areas of the triangles, square millimetres, shape (n_faces,)."""
        return np.linalg.norm(_cross_products(self.vertices, self.faces), axis=1) / 2

    @cached_property
    def vertex_areas(self):
        """A third of the triangles around each vertex, square millimetres, shape (n_vertices,)."""
        thirds = np.repeat(self.face_areas / 3, 3)
        return np.bincount(self.faces.ravel(), thirds, minlength=self.n_vertices)

    @cached_property
    def normals(self):
        """Unit vertex normals, area-weighted, shape (n_vertices, 3)."""
        return vertex_normals(self.vertices, self.faces)

    @cached_property
    def boundary_loops(self):
        """Boundary as closed loops of vertices, longest (in vertices) first: list of int arrays."""
        half = self._half_edges
        key = np.sort(half, axis=1)
        _, inverse, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
        border = half[count[inverse.ravel()] == 1]
        follow = {}
        for a, b in border.tolist():
            follow.setdefault(a, []).append(b)
        loops = []
        while follow:
            start = next(iter(follow))
            loop, at = [], start
            while at in follow:
                loop.append(at)
                ahead = follow[at]
                at_next = ahead.pop()
                if not ahead:
                    del follow[at]
                at = at_next
            loops.append(np.array(loop))
        return sorted(loops, key=len, reverse=True)

    def geodesics(self, sources=None):
        """Distances along the edges of the mesh, as Isomap measures them.

        Parameters
        ----------
        sources : array_like of int, optional
            Vertices to measure from; all of them if left out.

        Returns
        -------
        G : ndarray of shape (n_sources, n_vertices)
            Millimetres.

        Raises
        ------
        ValueError
            If the mesh is in several pieces: distances between them are not defined.

        References
        ----------
        Tena et al. 2011, section 4.2, G of Eq. 11.
        """
        self.check_connected()
        if sources is not None and np.ndim(sources) > 0:
            sources = as_indices(sources, "sources", self.n_vertices, "vertices")
        elif sources is not None:
            sources = check_index(sources, "sources", self.n_vertices, "vertices")
        return dijkstra(self.adjacency, directed=False, indices=sources)

    def check_connected(self):
        """Refuse a mesh in several pieces, naming their sizes."""
        sizes = np.bincount(self.pieces)
        if len(sizes) > 1:
            shown = ", ".join(map(str, sorted(sizes.tolist(), reverse=True)[:6]))
            index = same_place(self.vertices)
            joined = sp.coo_array((np.ones(len(self.edges)), index[self.edges].T))
            joined.resize((index.max() + 1,) * 2)
            left = connected_components(joined, directed=False)[0]
            advice = f"keep the largest with mesh.submesh(mesh.pieces == {sizes.argmax()})"
            if left < len(sizes):  # loose triangles, or seams
                advice = "vertices at the same place are not joined: use mesh.welded()[0]"
                if left > 1:
                    advice += f", and of its {left} pieces the largest"
            raise ValueError(
                f"the mesh is in {len(sizes)} pieces of {shown}{', ...' * (len(sizes) > 6)} "
                f"vertices, and distances along the surface need one piece; {advice}."
            )

    def submesh(self, keep):
        """The part of the mesh on some of its vertices, in the order given.

        Parameters
        ----------
        keep : array_like of int or of bool
            Vertex indices, or a mask of shape (n_vertices,).

        Returns
        -------
        TriangleMesh
            With the faces whose three vertices are kept, their texture, and the landmarks that
            are kept.

        Raises
        ------
        ValueError, TypeError
            For an index that is out of range or stands twice, or if no face is left.
        """
        keep = np.asarray(keep)
        if keep.dtype == bool:
            if keep.shape != (self.n_vertices,):
                raise ValueError(
                    f"keep has shape {keep.shape}, but a mask needs one bool for each of the "
                    f"{self.n_vertices} vertices."
                )
            keep = np.flatnonzero(keep)
        keep = as_indices(keep, "keep", self.n_vertices, "vertices")
        new = np.full(self.n_vertices, -1)
        new[keep] = np.arange(len(keep))
        faces = new[self.faces]
        landmarks = {k: int(new[v]) for k, v in self.landmarks.items() if new[v] >= 0}
        whole = (faces >= 0).all(axis=1)
        texture = None if self.texture is None else self.texture.on(whole)
        return TriangleMesh(self.vertices[keep], faces[whole], landmarks, texture)

    def welded(self, tolerance=0.0):
        """The mesh with vertices at the same place joined, and where each vertex went.

        Makes one surface of the loose triangles of an STL file, and closes the seams that texture
        coordinates cut into GLB and PLY files. Triangles that shrink to a line or a point go.

        Parameters
        ----------
        tolerance : float, default=0.0
            Millimetres between vertices that are joined, from one to the next; by default only
            those in exactly the same place.

        Returns
        -------
        mesh : TriangleMesh
            Its vertices in the order in which they first stand in this one; landmarks and texture
            are kept.
        index : ndarray of int, shape (n_vertices,)
            Vertex of the new mesh for each one of this: `mesh.vertices[index]` is as before.

        Raises
        ------
        ValueError
            For a tolerance below 0 or as long as the edges are, or if no triangle is left.

        Examples
        --------
        >>> V = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        >>> mesh, index = TriangleMesh(V, np.array([[0, 1, 2], [3, 4, 5]])).welded()
        >>> mesh, index.tolist()
        (TriangleMesh(4 vertices, 2 faces), [0, 1, 2, 1, 3, 2])
        """
        tolerance = check_number(tolerance, "tolerance", low=0)
        index = same_place(self.vertices, tolerance)
        kept = np.unique(index, return_index=True)[1]
        gone = shrunk(self.faces, index)
        texture = None if self.texture is None else self.texture.on(~gone)
        landmarks = {name: int(index[v]) for name, v in self.landmarks.items()}
        mesh = TriangleMesh(self.vertices[kept], index[self.faces[~gone]], landmarks, texture)
        return mesh, index

    def laplacian(self, weights="uniform", normalised=True):
        """The Laplacian of the mesh.

        Parameters
        ----------
        weights : {"uniform", "cotangent"}
            Same weight for each neighbour, or half the sum of the cotangents of the two angles
            that face the edge.
        normalised : bool, default=True
            Each row divided by its diagonal, as Yu and Liu print it; otherwise symmetric.

        Returns
        -------
        L : sparse array of shape (n_vertices, n_vertices)
            Diagonal positive; each row sums to zero.

        References
        ----------
        Yu and Liu 2014, Eq. 11.
        """
        check_choice(weights, "weights", ("uniform", "cotangent"))
        n = self.n_vertices
        if weights == "uniform":
            a, b = self.edges.T
            w = np.ones(len(a))
        else:
            V, F = self.vertices, self.faces
            a, b, w = [], [], []
            for k in range(3):  # the angle at corner k faces the edge between the two others
                u, v = V[F[:, k - 2]] - V[F[:, k]], V[F[:, k - 1]] - V[F[:, k]]
                area2 = np.linalg.norm(np.cross(u, v), axis=1)
                a.append(F[:, k - 2])  # half the cotangent: u . v / |u x v| / 2
                b.append(F[:, k - 1])
                w.append((u * v).sum(axis=1) / np.maximum(area2, 1e-12) / 2)
            a, b, w = map(np.concatenate, (a, b, w))
        W = sp.coo_array((w, (a, b)), shape=(n, n))
        W = sp.csr_array(W + W.T)
        degree = np.asarray(W.sum(axis=1)).ravel()
        L = sp.diags_array(degree) - W
        if normalised:  # Eq. 11: 1 on the diagonal, -alpha_ij = -w_ij / sum_j w_ij beside it
            L = sp.diags_array(1 / np.where(degree == 0, 1, degree)) @ L
        return sp.csr_array(L)

    def subsample(self, n_vertices, keep=()):
        """Spread samples evenly over the surface and give them triangles of their own.

        Boundary loops (lids, lips, outline) are sampled along themselves, so that the small mesh
        keeps the openings of the large one; the rest by farthest points, then moved to the middle
        of their cells. Three samples form a triangle where their cells meet.

        Parameters
        ----------
        n_vertices : int
            Number of samples, exactly.
        keep : iterable of int
            Vertices that must be among the samples.

        Returns
        -------
        indices : ndarray of int, shape (n_vertices,)
            The samples, ascending, as vertices of this mesh.
        mesh : TriangleMesh
            The samples with their triangles; each sample has two or more.

        Raises
        ------
        ValueError
            If there are fewer vertices than asked for, or if so few (or so many) are asked for
            that they cannot form a surface with the openings of this one.

        References
        ----------
        Tena et al. 2011, section 4.1: 8,820 vertices "uniformly" subsampled to 397.
        """
        return _subsample(self, n_vertices, list(keep))

    def nearest_of(self, samples):
        """Index into `samples` of the one nearest along the surface: int, shape (n_vertices,)."""
        self.check_connected()
        samples = as_indices(samples, "samples", self.n_vertices, "vertices")
        return _nearest_sample(self.adjacency, samples)


def _cross_products(V, F):
    a, b, c = V[F[:, 0]], V[F[:, 1]], V[F[:, 2]]
    return np.cross(b - a, c - a)


def vertex_normals(V, F):
    """Unit vertex normals, area-weighted: shape (n_vertices, 3); zero where no face is."""
    return vertex_normals_by(normals_operator(F, len(V)), V, F)


def normals_operator(F, n):
    """Sparse (n, n_faces) array that sums over the faces at each vertex; found once per mesh."""
    faces = np.repeat(np.arange(len(F)), 3)
    return sp.csr_array((np.ones(F.size), (F.ravel(), faces)), shape=(n, len(F)))


def vertex_normals_by(operator, V, F):
    """`vertex_normals` with the operator of the mesh at hand, as for every frame of a drag."""
    total = operator @ _cross_products(V, F)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length == 0, 1, length)


def _subsample(mesh, n_samples, keep):
    n = mesh.n_vertices
    if not isinstance(n_samples, (int, np.integer)):
        raise TypeError(f"n_vertices={n_samples!r} is not an integer.")
    if not 4 <= n_samples <= n:
        raise ValueError(f"n_vertices={n_samples}, but this mesh allows 4 to {n}.")
    keep = as_indices(list(dict.fromkeys(keep)), "keep", n, "vertices").tolist()
    if len(keep) > n_samples:
        raise ValueError(f"keep names {len(keep)} vertices, but only n_vertices={n_samples} fit.")
    mesh.check_connected()
    graph = mesh.adjacency
    spacing = np.sqrt(mesh.face_areas.sum() / n_samples * 2 / np.sqrt(3))
    loops = _along_loops(mesh, spacing, keep)
    fixed = list(dict.fromkeys([*keep, *loops]))[: max(len(keep), n_samples - 1)]
    banned = np.zeros(n, dtype=bool)
    for _ in range(12):
        samples = _farthest_points(graph, fixed, n_samples, banned)
        samples = _centre(mesh, samples, set(fixed), banned)
        faces = _dual_faces(mesh, samples)
        count = np.bincount(faces.ravel(), minlength=n_samples)
        poor = {samples[i] for i in np.flatnonzero(count < 2)} - set(keep)
        torn = _met_twice(faces)
        if not poor and not len(torn):
            break
        if poor:  # a sample whose cell meets no two others is taken out, and others tried
            fixed = [s for s in fixed if s not in poor]
            # such as the bottom of a nostril, with one cell all around it
            banned |= np.isin(samples, list(poor))[_nearest_sample(graph, samples)]
        # where two cells meet along two lines, a sample of its own goes between them
        fixed = list(dict.fromkeys([*fixed, *_between(mesh, samples, torn)]))
        if len(fixed) > n_samples:
            break
    order = np.argsort(samples)
    rank = np.argsort(order)
    indices = np.asarray(samples)[order]
    if (count < 2).any():
        raise ValueError(
            f"n_vertices={n_samples} is too few (or too many) for this mesh: "
            f"{int((count < 2).sum())} samples lack triangles of their own. Ask for another number."
        )
    where = {int(v): i for i, v in enumerate(indices)}
    landmarks = {k: where[v] for k, v in mesh.landmarks.items() if v in where}
    small = TriangleMesh(mesh.vertices[indices], rank[faces], landmarks)
    if len(torn) or _topology(small) != _topology(mesh):
        raise ValueError(
            f"n_vertices={n_samples} is too few for this mesh: its surface or one of its "
            f"{len(mesh.boundary_loops)} openings would be torn or closed. Ask for more."
        )
    return indices, small


def _topology(mesh):
    """Euler characteristic and number of boundary loops."""
    return mesh.n_vertices - len(mesh.edges) + len(mesh.faces), len(mesh.boundary_loops)


def _met_twice(faces):
    """Edges that two faces run through in the same direction: no surface does that."""
    half = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    half, count = np.unique(half, axis=0, return_counts=True)
    return np.unique(np.sort(half[count > 1], axis=1), axis=0)


def _between(mesh, samples, pairs):
    """For each pair of cells the vertex on their border that is farthest from all samples."""
    if not len(pairs):
        return []
    near = dijkstra(mesh.adjacency, directed=False, indices=samples, min_only=True)
    cells = np.sort(_nearest_sample(mesh.adjacency, samples)[mesh.edges], axis=1)
    borders = [mesh.edges[(cells == pair).all(axis=1)].ravel() for pair in pairs]
    return [int(border[near[border].argmax()]) for border in borders]


def _along_loops(mesh, spacing, keep):
    """Vertices about `spacing` apart along each boundary loop, starting at a kept one if any."""
    found = []
    for loop in mesh.boundary_loops:
        kept = [i for i, v in enumerate(loop) if v in keep]
        loop = np.roll(loop, -kept[0]) if kept else loop
        closed = mesh.vertices[np.append(loop, loop[0])]
        along = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
        count = max(3, round(along[-1] / spacing))
        stops = np.arange(count) * along[-1] / count
        found += loop[np.abs(along[:-1, None] - stops).argmin(axis=0)].tolist()
    return found


def _farthest_points(graph, seeds, n_samples, banned):
    """Seeds, then one by one the vertex farthest from all chosen so far, none of the banned."""
    chosen = list(seeds) or [0]
    near = dijkstra(graph, directed=False, indices=chosen, min_only=True)
    while len(chosen) < n_samples:
        at = int(np.where(banned, 0, near).argmax())
        if near[at] == 0 or banned[at]:
            raise ValueError(
                f"n_vertices={n_samples} is too few (or too many) for this mesh: so many samples "
                "do not find two triangles each. Ask for another number."
            )
        chosen.append(at)
        near = np.minimum(near, dijkstra(graph, directed=False, indices=at, limit=near.max()))
    return chosen


def _nearest_sample(graph, samples):
    """Index into `samples` of the one nearest along the surface, for each vertex."""
    _, _, source = dijkstra(
        graph, directed=False, indices=samples, min_only=True, return_predecessors=True
    )
    place = np.empty(graph.shape[0], dtype=int)
    place[samples] = np.arange(len(samples))
    return place[source]


def _centre(mesh, samples, fixed, banned, rounds=4):
    """Lloyd's rounds: each free sample moves to the vertex nearest to the middle of its cell."""
    for _ in range(rounds):
        cell = _nearest_sample(mesh.adjacency, samples)
        size = np.bincount(cell, minlength=len(samples))[:, None]
        middle = np.stack(
            [np.bincount(cell, x, minlength=len(samples)) for x in mesh.vertices.T], axis=1
        )
        middle /= size
        off = np.linalg.norm(mesh.vertices - middle[cell], axis=1)
        off[banned & ~np.isin(np.arange(len(off)), samples)] = np.inf
        order = np.lexsort((off, cell))
        first = order[np.searchsorted(cell[order], np.arange(len(samples)))]
        samples = [s if s in fixed else int(f) for s, f in zip(samples, first, strict=True)]
    return samples


def _dual_faces(mesh, samples):
    """Triangles of samples whose three cells meet in one triangle of the mesh."""
    faces = _nearest_sample(mesh.adjacency, samples)[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]
