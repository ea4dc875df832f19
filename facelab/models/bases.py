"""A linear basis in each region of a face, and how the regions become one surface.

Tena et al. 2011, section 3.1: Eq. 5 to 7. What the bases are learned from is in
`facelab.models.region`.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.utils.validation import check_is_fitted

from facelab.checks import check_choice, check_number
from facelab.face_model import FaceModel
from facelab.models.blending import GradientBlend


class RegionBases(FaceModel):
    """The mathematics of a fitted `RegionModel`, which has settings and attributes.

    References
    ----------
    Tena et al. 2011, section 3.1.
    """

    def set_bases(self, mean, members, components, variances):
        """Take over what was learned or given, all at once.

        Parameters
        ----------
        mean : ndarray of shape (n_features,)
        members : list of ndarray of int, or None
            Vertices of each region; None where the whole face is one.
        components : list of ndarray of shape (P_i, 3 * n_vertices_i)
        variances : list of ndarray of shape (P_i,), or None
        """
        columns = columns_of(members, len(mean))
        components = [np.ascontiguousarray(B) for B in components]
        counts = np.array([len(B) for B in components])
        slices = [slice(e - p, e) for e, p in zip(np.cumsum(counts), counts, strict=True)]
        parts = list(zip(columns, components, slices, strict=True))
        learned = dict(
            mean_=mean,
            n_features_in_=len(mean),
            members_=members,
            columns_=columns,
            components_=components,
            variances_=variances,
            n_components_=counts,
            slices_=slices,
            holders_=np.bincount(np.concatenate(columns), minlength=len(mean)),
            boundary_=_boundary_over(parts, np.arange(len(mean))),
            _fit_solvers={},
        )
        for old in ("_gradient_blend", "units_"):
            vars(self).pop(old, None)
        vars(self).update(learned)
        return self

    @property
    def parts(self):
        """Columns, basis (rows) and place among the coefficients of each region: list of tuple."""
        return list(zip(self.columns_, self.components_, self.slices_, strict=True))

    # --- what a session asks of any model ---------------------------------------------------------

    @property
    def mesh(self):
        """The mesh of the regions, None where there are none."""
        return None if self.regions is None else self.regions.mesh

    @property
    def n_vertices(self):
        """Vertices of the face."""
        return len(self.mean_) // 3

    @property
    def n_coefficients(self):
        """P: number of coefficients of all regions together."""
        return int(self.n_components_.sum())

    @property
    def slices(self):
        """Where the coefficients of each region are: list of slice."""
        return self.slices_

    @property
    def basis(self):
        """What one of each coefficient moves, blended: (P, n_vertices, 3), millimetres."""
        return self.displacements(np.eye(self.n_coefficients))

    @property
    def holders(self):
        """Number of regions that hold each vertex: shape (n_vertices,)."""
        return self.holders_[::3]

    def check_fitted(self):
        """The model itself, refused (NotFittedError) if it has learned nothing yet."""
        check_is_fitted(self)
        return self

    def fingerprint_parts(self):
        """The number of vertices and of each region's modes, the mean and the modes."""
        sizes = [self.n_vertices, *(int(n) for n in self.n_components_)]
        return "model", sizes, [self.mean_, *self.components_]

    def displacements(self, coefficients):
        """Displacements from the neutral, shared vertices blended: shape (n, n_vertices, 3)."""
        return self.blend(np.atleast_2d(coefficients)).reshape(-1, self.n_vertices, 3)

    def vertex_rows(self, vertex):
        """One vertex of `blend` as a linear function of the coefficients: shape (3, P)."""
        if not self._blends_gradients:
            weights = [(c[::3] == 3 * vertex) / self.holders_[3 * vertex] for c in self.columns_]
        else:
            ends = np.cumsum([len(c) // 3 for c in self.columns_])
            weights = np.split(self._gradient_blend.weights(vertex), ends[:-1])
        rows = np.zeros((3, self.n_coefficients))
        for (_, B, s), w in zip(self.parts, weights, strict=True):
            used = np.flatnonzero(w)
            rows[:, s] = np.einsum("v,pva->ap", w[used], B.reshape(len(B), len(w), 3)[:, used])
        return rows

    def copy_rows(self, vertex):
        """One row block of shape (3, P) for each region that holds a vertex: B_k^i of Eq. 9."""
        found = []
        for columns, B, s in self.parts:
            first = np.searchsorted(columns, 3 * vertex)
            if first < len(columns) and columns[first] == 3 * vertex:
                row = np.zeros((3, self.n_coefficients))
                row[:, s] = B[:, first : first + 3].T
                found.append(row)
        return found

    def gaps(self, coefficients):
        """Largest distance of a region's copy of each vertex from the vertex seen: (N,), mm.

        This is what blending hides (Fig. 2, upper row).
        """
        seen = self.displacements(coefficients).ravel()
        gap = np.zeros(self.n_vertices)
        for columns, B, s in self.parts:
            off = np.linalg.norm((coefficients[s] @ B - seen[columns]).reshape(-1, 3), axis=1)
            at = columns[::3] // 3
            gap[at] = np.maximum(gap[at], off)
        return np.where(self.holders > 1, gap, 0)

    def boundary(self, vertices=None):
        """Matrix of the boundary term over some vertices, all if left out: shape (P, P)."""
        if vertices is None:
            return self.boundary_
        return _boundary_over(self.parts, columns_of([vertices])[0])

    def resistance(self, weights):
        """W of the last term, (c_0 - c)^T W (c_0 - c): a diagonal for even weights, (P, P)."""
        scale = 1.0
        if self.variances_ is None:  # bases given in units of their own
            scale = np.mean(np.concatenate([(B**2).sum(axis=1) for B in self.components_]))
        if np.ptp(weights) == 0:
            return scale * weights[0] * np.eye(self.n_coefficients)
        W = np.zeros((self.n_coefficients,) * 2)
        for columns, B, s in self.parts:
            U, _, Vt = np.linalg.svd(B, full_matrices=False)
            Q = U @ Vt  # B where it is orthonormal, else the orthonormal basis nearest to it
            W[s, s] = scale * (Q * np.repeat(weights, 3)[columns]) @ Q.T
        return W

    def training(self):
        """Mean (counted from the neutral) and standard deviations, (P,), or None if unknown."""
        if self.variances_ is None:
            return None
        return self.solved(self.mean_[None])[0], np.sqrt(np.concatenate(self.variances_))

    def encode(self, X):
        """Coefficients, counted from the neutral, of displacements (n, n_vertices, 3): (n, P)."""
        return self.solved(X.reshape(len(X), -1))

    # --- coefficients and faces -------------------------------------------------------------------

    def solved(self, D):
        """Coefficients of all regions, found together (Eq. 6 and 7): shape (n_frames, P).

        Parameters
        ----------
        D : ndarray of shape (n_frames, n_features)
            Displacements from the mean for coefficients as `transform` counts them, from the
            neutral for those of a session: the map is linear.
        """
        beta = check_number(self.beta, "beta", low=0)
        if beta not in self._fit_solvers:
            A = beta * self.boundary_  # Eq. 7: (B^T B + beta L) zeta = B^T v, all regions at once
            for _, B, s in self.parts:
                A[s, s] += B @ B.T
            self._fit_solvers.clear()  # that of the last beta is enough
            self._fit_solvers[beta] = _solver(A)
        rhs = np.concatenate([D[:, columns] @ B.T for columns, B, _ in self.parts], axis=1)
        return self._fit_solvers[beta](rhs.T).T

    def blend(self, Z):
        """Displacements from the mean face for rows of coefficients, as one surface.

        `blending="mean"`: shared vertices are the mean of their regions, the rest is as its
        region has it, and a gap ends as a step beside the shared vertices. "gradient": the
        surface whose differences along the edges of the mesh are the mean of those that the
        regions want, drawn softly to the mean of the regions; a gap is spread over about
        `BLEND_REACH` on both sides. Where regions agree both are the same. Both are linear in Z.

        Parameters
        ----------
        Z : ndarray of shape (n_frames, P)

        Returns
        -------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Millimetres.

        References
        ----------
        Tena et al. 2011, section 3.1, "gradient domain methods"; Sorkine et al. 2004. The weights
        and the soft anchors are ours.
        """
        if self._blends_gradients:
            n, copies = len(Z), [B.T @ Z[:, s].T for _, B, s in self.parts]
            stacked = np.concatenate([x.reshape(-1, 3 * n) for x in copies])
            x = self._gradient_blend.carry(stacked)
            return x.reshape(-1, 3, n).transpose(2, 0, 1).reshape(n, -1)
        X = np.zeros((len(self.mean_), len(Z)))  # so that regions are added row by row
        for columns, B, s in self.parts:
            X[columns] += B.T @ Z[:, s].T
        X /= self.holders_[:, None]
        return X.T

    @property
    def _blends_gradients(self):
        check_choice(self.blending, "blending", ("mean", "gradient"))
        return self.blending == "gradient" and self.members_ is not None

    @cached_property
    def _gradient_blend(self):
        return GradientBlend(self.regions.mesh, self.members_)

    def __getstate__(self):
        left_out = ("_gradient_blend", "_fit_solvers")  # factors: found again when needed
        state = {k: v for k, v in super().__getstate__().items() if k not in left_out}
        return {**state, "_fit_solvers": {}}

    def boundary_gap(self, Z):
        """Root mean square difference of shared vertices between regions, in each frame.

        Returns
        -------
        gap : ndarray of shape (n_frames,)
            Millimetres; over all pairs of regions and the vertices they share.
        """
        check_is_fitted(self)
        Z = np.atleast_2d(Z)
        pairs = 0
        for i, (columns_i, _, _) in enumerate(self.parts):
            pairs += sum(len(np.intersect1d(columns_i, c)) for c, _, _ in self.parts[i + 1 :])
        squares = np.einsum("fp,pq,fq->f", Z, self.boundary_, Z).clip(min=0)
        return np.sqrt(squares / max(pairs / 3, 1))


def columns_of(members, n_features=None):
    """The columns x, y, z of each region's vertices in a frame; all where there are no regions."""
    if members is None:
        return [np.arange(n_features)]
    return [(3 * np.asarray(m)[:, None] + np.arange(3)).ravel() for m in members]


def _boundary_over(parts, counted):
    """Matrix of the boundary term over some columns: shape (P, P)."""
    n = sum(len(B) for _, B, _ in parts)
    L = np.zeros((n, n))
    for i, (columns_i, B_i, s_i) in enumerate(parts):
        for columns_j, B_j, s_j in parts[i + 1 :]:
            shared, at_i, at_j = np.intersect1d(columns_i, columns_j, return_indices=True)
            inside = np.isin(shared, counted)
            at_i, at_j = at_i[inside], at_j[inside]
            if at_i.size:  # ||B_j^i c^i - B_i^j c^j||^2 of Eq. 6, each pair of regions once
                in_i, in_j = B_i[:, at_i], B_j[:, at_j]
                L[s_i, s_i] += in_i @ in_i.T
                L[s_j, s_j] += in_j @ in_j.T
                L[s_i, s_j] -= in_i @ in_j.T
                L[s_j, s_i] -= in_j @ in_i.T
    return L


def _solver(A):
    """Solves A x = b for a symmetric A, never negative; the smallest x where A is singular."""
    try:
        factor = cho_factor(A)
        d = np.diagonal(factor[0])
        if d.min() > 1e-6 * d.max():  # the squares bound the condition from below
            return lambda b: cho_solve(factor, b)
    except np.linalg.LinAlgError:
        pass
    values, U = np.linalg.eigh(A)
    seen = values > len(A) * np.finfo(float).eps * values[-1]
    U, values = U[:, seen], values[seen]
    return lambda b: U @ ((U.T @ b) / values[:, None])
