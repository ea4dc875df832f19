"""Make one surface of regions that disagree where they meet, in the gradient domain."""

import numpy as np
import scipy.sparse as sp

from facelab.numeric.sparse import SparseFactor

BLEND_REACH = 20.0
"""Distance over which the gradient blend spreads a gap, to 1/e, millimetres."""


class GradientBlend:
    """The surface whose differences along edges are the mean of those that the regions want.

    Minimises sum_e w_e |u_a - u_b - g_e|^2 + sum_v A_v / reach^2 |u_v - m_v|^2 over the edges
    e = (a, b) and the vertices v of the mesh: g_e is the mean difference wanted by the regions that
    hold both ends (that of m where none does), m_v the mean of the copies of v, w_e the cotangent
    weight, A_v the area. Linear in the copies; factored once.

    Parameters
    ----------
    mesh : TriangleMesh
    members : list of ndarray of int
        Vertices of each region; their copies follow one another in this order.
    reach : float
        Distance over which a gap is spread, to 1/e, millimetres.

    References
    ----------
    Tena et al. 2011, section 3.1; Sorkine et al. 2004. Weights and anchors are ours: the first
    keep the reach the same on finer meshes, the second keep a pull on one side of the face from
    moving the other.
    """

    def __init__(self, mesh, members, reach=BLEND_REACH):
        n, (a, b) = mesh.n_vertices, mesh.edges.T
        n_edges, n_copies = len(a), sum(map(len, members))
        vertex, copies = np.concatenate(members), np.arange(n_copies)
        mean = sp.csr_array((np.ones(n_copies), (vertex, copies)), shape=(n, n_copies))
        mean = sp.diags_array(1 / mean.sum(axis=1)) @ mean
        edge, ones = np.arange(n_edges), np.ones(n_edges)
        E = sp.csr_array((ones, (edge, a)), shape=(n_edges, n))
        E -= sp.csr_array((ones, (edge, b)), shape=(n_edges, n))
        wanted = sp.csr_array((n_edges, n_copies))
        holders, start = np.zeros(n_edges), 0
        for vertices in members:
            place = np.full(n, -1)
            place[vertices] = start + np.arange(len(vertices))
            start += len(vertices)
            inside = np.flatnonzero((place[a] >= 0) & (place[b] >= 0))
            holders[inside] += 1
            for end, sign in ((a, 1.0), (b, -1.0)):
                entries = np.full(len(inside), sign), (inside, place[end[inside]])
                wanted += sp.csr_array(entries, shape=wanted.shape)
        g = sp.diags_array(1 / np.maximum(holders, 1)) @ wanted
        g += sp.diags_array((holders == 0).astype(float)) @ E @ mean
        L = mesh.laplacian("cotangent", normalised=False)
        # a weight below zero (an obtuse angle) would reward the wrong difference
        weight = sp.diags_array(np.maximum(-L[a, b], 0))
        area = np.maximum(mesh.vertex_areas, mesh.vertex_areas.mean() / 100)
        anchor = sp.diags_array(area / reach**2)
        # the gradient of the energy vanishes where S u = E^T w g + A / reach^2 m
        S = E.T @ weight @ E + anchor
        self._factor = SparseFactor(S)
        self._rhs = sp.csr_array(E.T @ weight @ g + anchor @ mean)

    def carry(self, copies):
        """Blended values, shape (n_vertices, n), of copies, shape (n_copies, n)."""
        return self._factor.solve(self._rhs @ copies)

    def weights(self, vertex):
        """What each copy counts at one vertex, shape (n_copies,)."""
        unit = np.zeros(self._rhs.shape[0])
        unit[vertex] = 1
        return self._rhs.T @ self._factor.solve(unit)
