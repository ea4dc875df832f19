"""Linear face models: one PCA for the whole face, or one per region with soft boundaries.

Tena et al. 2011, section 3.1. Estimators after scikit-learn: `X` is (n_frames, 3 * n_vertices),
x, y, z of a vertex side by side, the neutral face subtracted, millimetres.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import ThreadpoolController

from facelab.errors import check_number
from facelab.segmentation import Regions

_threads = ThreadpoolController()


def principal_components(X, n_components):
    """Mean, leading principal components and their variances.

    The smaller of covariance and Gram matrix is decomposed.

    Parameters
    ----------
    X : ndarray of shape (n_frames, n_features)
    n_components : int
        1 to min(n_frames, n_features).

    Returns
    -------
    mean : ndarray of shape (n_features,)
    components : ndarray of shape (n_components, n_features)
        Orthonormal rows, strongest first; the entry of largest magnitude in each is positive.
    variances : ndarray of shape (n_components,)
    """
    n_frames, n_features = X.shape
    mean = X.mean(axis=0)
    D = X - mean
    wide = n_features > n_frames
    square = D @ D.T if wide else D.T @ D
    last = [len(square) - n_components, len(square) - 1]
    with _threads.limit(limits=1):  # eigenvectors this small lose time on several threads
        variances, components = eigh(square, subset_by_index=last)
        components = D.T @ components if wide else components
        # strongest first; orthonormal anew, for weak columns lose it by rounding
        components = np.linalg.qr(components[:, ::-1])[0].T
    signs = np.sign(components[np.arange(n_components), np.abs(components).argmax(axis=1)])
    variances = variances[::-1].clip(min=0) / max(n_frames - 1, 1)
    return mean, components * signs[:, None], variances


class RegionModel(TransformerMixin, BaseEstimator):
    """One PCA per region of the face, all solved together with soft boundaries.

    Parameters
    ----------
    regions : Regions, optional
        From `segment_face`; the whole face as one region if left out.
    n_components : int, default=30
        P: modes of each region; fewer where a region is too small to hold as many.
    beta : float, default=0.5
        β: weight of the agreement of shared vertices when coefficients are found (Eq. 6).

    Attributes
    ----------
    mean_ : ndarray of shape (n_features,)
        Average displacement from the neutral, millimetres.
    members_ : list of ndarray of int
        Vertices of each region, shared ones included.
    components_ : list of ndarray of shape (P_i, 3 * n_vertices_i)
        B^i of Eq. 5 as rows: orthonormal, strongest first.
    variances_ : list of ndarray of shape (P_i,)
        Variance along each mode, square millimetres.
    n_components_ : ndarray of int, shape (n_regions,)
        P_i: modes that each region got.
    boundary_ : ndarray of shape (P, P), P the sum of all P_i
        Matrix of the boundary term: zeta^T boundary_ zeta is the sum of squared differences of
        shared vertices over all pairs of regions.

    References
    ----------
    Tena et al. 2011, Eq. 1 to 7.
    """

    def __init__(self, regions=None, n_components=30, beta=0.5):
        self.regions = regions
        self.n_components = n_components
        self.beta = beta

    def fit(self, X, y=None):
        """Learn the modes of every region.

        Parameters
        ----------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres.
        y : ignored

        Raises
        ------
        ValueError
            For NaN, too few frames for `n_components`, or a number of columns that is not three
            for each vertex of the regions.
        TypeError
            If `regions` are not `Regions` or `n_components` is not an integer.
        """
        X = validate_data(self, X, dtype=[np.float64, np.float32], ensure_min_samples=2)
        n_frames, n_features = X.shape
        most = min(n_frames - 1, n_features)  # centring costs one degree of freedom
        if not isinstance(self.n_components, (int, np.integer)) or isinstance(
            self.n_components, bool
        ):
            raise TypeError(f"n_components={self.n_components!r} is not an integer.")
        if not 1 <= self.n_components <= most:
            raise ValueError(
                f"n_components={self.n_components}, but {n_frames} frames of {n_features} "
                f"coordinates allow 1 to {most}; lower n_components or add frames."
            )
        check_number(self.beta, "beta", low=0)
        if self.regions is None:
            self.members_ = None
            columns = [np.arange(n_features)]
        else:
            if not isinstance(self.regions, Regions):
                raise TypeError(
                    f"regions is a {type(self.regions).__name__}; give the Regions from "
                    "segment_face, or Regions(labels, mesh)."
                )
            wanted = 3 * self.regions.mesh.n_vertices
            if n_features != wanted:
                raise ValueError(
                    f"X has {n_features} columns, but the regions lie on "
                    f"{self.regions.mesh.n_vertices} vertices and ask for {wanted}; train on "
                    "motion of the mesh that was segmented, or carry the regions over."
                )
            self.members_ = self.regions.members
            columns = [_columns(vertices) for vertices in self.members_]
        parts = [principal_components(X[:, c], min(self.n_components, len(c))) for c in columns]
        self.mean_ = X.mean(axis=0)
        return self._set_bases(columns, [p[1] for p in parts], [p[2] for p in parts])

    def _set_bases(self, columns, components, variances):
        self.columns_ = columns
        self.components_ = components
        self.variances_ = variances
        self.n_components_ = np.array([len(B) for B in components])
        ends = np.cumsum(self.n_components_)
        self.slices_ = [slice(e - p, e) for e, p in zip(ends, self.n_components_, strict=True)]
        self.holders_ = np.bincount(np.concatenate(columns), minlength=len(self.mean_))
        self.boundary_ = self._boundary_matrix()
        self._fit_factors = {}
        return self

    def _boundary_matrix(self, samples=None):
        """Matrix of the boundary term, summed over some vertices or over all."""
        n = int(self.n_components_.sum())
        counts = np.arange(len(self.mean_)) if samples is None else _columns(samples)
        L = np.zeros((n, n))
        for i, (columns_i, B_i, s_i) in enumerate(self._parts()):
            for columns_j, B_j, s_j in self._parts()[i + 1 :]:
                shared, at_i, at_j = np.intersect1d(columns_i, columns_j, return_indices=True)
                counted = np.isin(shared, counts)
                at_i, at_j = at_i[counted], at_j[counted]
                if at_i.size:  # ||B_j^i c^i - B_i^j c^j||^2, each pair of regions once
                    in_i, in_j = B_i[:, at_i], B_j[:, at_j]
                    L[s_i, s_i] += in_i @ in_i.T
                    L[s_j, s_j] += in_j @ in_j.T
                    L[s_i, s_j] -= in_i @ in_j.T
                    L[s_j, s_i] -= in_j @ in_i.T
        return L

    def _parts(self):
        return list(zip(self.columns_, self.components_, self.slices_, strict=True))

    def transform(self, X):
        """Coefficients of all regions, found together (Eq. 6 and 7).

        Parameters
        ----------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres.

        Returns
        -------
        Z : ndarray of shape (n_frames, P)
            zeta: the coefficients of region after region.
        """
        check_is_fitted(self)
        X = validate_data(self, X, reset=False, dtype=[np.float64, np.float32])
        D = X - self.mean_
        rhs = np.concatenate([D[:, columns] @ B.T for columns, B, _ in self._parts()], axis=1)
        return cho_solve(self._fit_factor(check_number(self.beta, "beta", low=0)), rhs.T).T

    def _fit_factor(self, beta):
        if beta not in self._fit_factors:
            A = beta * self.boundary_
            for _, B, s in self._parts():
                A[s, s] += B @ B.T
            self._fit_factors = {beta: cho_factor(A)}
        return self._fit_factors[beta]

    def inverse_transform(self, Z):
        """Faces from coefficients; shared vertices are the mean of their regions.

        Parameters
        ----------
        Z : ndarray of shape (n_frames, P)

        Returns
        -------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres.
        """
        check_is_fitted(self)
        Z = np.atleast_2d(np.asarray(Z, dtype=float))
        if Z.shape[1] != self.boundary_.shape[0]:
            raise ValueError(
                f"Z has {Z.shape[1]} columns, but the model has {self.boundary_.shape[0]} "
                "coefficients."
            )
        return self.mean_ + self.blend(Z)

    def blend(self, Z):
        """Displacements from the mean face for rows of coefficients, blended by the mean."""
        X = np.zeros((len(self.mean_), len(Z)))  # so that regions are added row by row
        for columns, B, s in self._parts():
            X[columns] += B.T @ Z[:, s].T
        X /= self.holders_[:, None]
        return X.T

    def reconstruct(self, X):
        """The model's best version of each frame, shape (n_frames, 3 * n_vertices)."""
        return self.inverse_transform(self.transform(X))

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
        for i, (columns_i, _, _) in enumerate(self._parts()):
            pairs += sum(len(np.intersect1d(columns_i, c)) for c, _, _ in self._parts()[i + 1 :])
        squares = np.einsum("fp,pq,fq->f", Z, self.boundary_, Z).clip(min=0)
        return np.sqrt(squares / max(pairs / 3, 1))

    @property
    def n_coefficients_(self):
        """P: number of coefficients of all regions together."""
        return int(self.n_components_.sum())


class HolisticModel(RegionModel):
    """One PCA for the whole face: a `RegionModel` with a single region.

    Parameters
    ----------
    n_components : int, default=30

    References
    ----------
    Tena et al. 2011, Eq. 1 to 4.
    """

    regions = None
    beta = 0.0

    def __init__(self, n_components=30):
        self.n_components = n_components


def _columns(vertices):
    return (3 * np.asarray(vertices)[:, None] + np.arange(3)).ravel()
