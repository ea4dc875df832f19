"""Linear face models: one PCA for the whole face, or one per region with soft boundaries.

Tena et al. 2011, section 3.1. Estimators after scikit-learn: `X` is (n_frames, 3 * n_vertices),
x, y, z of a vertex side by side, the neutral face subtracted, millimetres.
"""

import copy
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from facelab.checks import as_finite, check_choice, check_number
from facelab.models.blending import GradientBlend
from facelab.models.components import (
    LARGEST_EXACT,
    components_of_blocks,
    principal_components,
    row_blocks,
)
from facelab.motion import MotionSequence
from facelab.segmentation.regions import Regions, packed_regions
from facelab.storage import save_npz

FILE = "linear-face-model", 1


_FILL = "leave lost frames out, or fill their gaps"


class RegionModel(TransformerMixin, BaseEstimator):
    """One PCA per region of the face, all solved together with soft boundaries.

    Parameters
    ----------
    regions : Regions, optional
        From `segment_face`; the whole face as one region if left out.
    n_components : int or float, default=30
        Modes to keep: an integer is their number, a float between 0 and 1 the share of the
        variance that they hold. A small region never gets more than it has coordinates.
    beta : float, default=0.5
        β: weight of the agreement of shared vertices when coefficients are found (Eq. 6).
    spread : {"each", "total"}
        Whom `n_components` counts for: each region (the paper's way), or all regions together.
        A total is spent on the modes of the largest variance, wherever they are; a region that
        hardly moves may get none and then stays at its mean.
    blending : {"mean", "gradient"}
        How one surface is made of regions that disagree on shared vertices (`blend`).
    random_state : int, RandomState or None, default=0
        Used only for regions too wide for an exact decomposition (`fit_blocks`).

    Attributes
    ----------
    mean_ : ndarray of shape (n_features,)
        Average displacement from the neutral, millimetres.
    members_ : list of ndarray of int
        Vertices of each region, shared ones included; None where there is one region.
    components_ : list of ndarray of shape (P_i, 3 * n_vertices_i)
        B^i of Eq. 5 as rows; from `fit` orthonormal, strongest first.
    variances_ : list of ndarray of shape (P_i,), or None
        Variance along each mode, square millimetres; unknown where the bases were given.
    n_components_ : ndarray of int, shape (n_regions,)
        P_i: modes that each region got.
    boundary_ : ndarray of shape (P, P), P the sum of all P_i
        Matrix of the boundary term: zeta^T boundary_ zeta is the sum of squared differences of
        shared vertices over all pairs of regions.

    References
    ----------
    Tena et al. 2011, Eq. 1 to 7.

    Examples
    --------
    >>> import facelab
    >>> actor = facelab.load_registered("M1", size="small", progress=False)
    >>> motion = actor.motion("train")
    >>> regions = facelab.segment_face(motion, n_regions=6, random_state=0, progress=False)
    >>> X = motion.displacements()
    >>> model = facelab.RegionModel(regions, n_components=5).fit(X)
    >>> X_hat = model.inverse_transform(model.transform(X))
    >>> len(model.components_), bool(facelab.rms_error(X, X_hat) < 0.5)  # millimetres
    (6, True)
    """

    def __init__(
        self,
        regions=None,
        n_components=30,
        beta=0.5,
        spread="each",
        blending="mean",
        random_state=0,
    ):
        self.regions = regions
        self.n_components = n_components
        self.beta = beta
        self.spread = spread
        self.blending = blending
        self.random_state = random_state

    # --- learning ---------------------------------------------------------------------------------

    def fit(self, X, y=None):
        """Learn the modes of every region.

        Parameters
        ----------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres. A memory-mapped array is read in blocks
            (`fit_blocks`), never as a whole.
        y : ignored

        Raises
        ------
        ValueError
            For NaN, too few frames for `n_components`, regions that share no vertex, or a number
            of columns that is not three for each vertex of the regions.
        TypeError
            If `regions` are not `Regions`, `n_components` is neither a number nor a share, or X
            is a sequence in place of its displacements.
        """
        self._check_settings()
        if isinstance(X, MotionSequence):
            raise TypeError(
                "X is a MotionSequence, but models learn displacements from the neutral: "
                "fit(motion.displacements())."
            )
        if isinstance(X, np.memmap) and X.ndim == 2:
            return self.fit_blocks(lambda: row_blocks(X))
        kinds = [np.float64, np.float32]
        X = validate_data(self, X, dtype=kinds, ensure_min_samples=2, ensure_all_finite=False)
        n_frames, n_features = X.shape
        columns = self._columns(n_features)
        if min(n_frames, max(map(len, columns))) > LARGEST_EXACT and not self._is_share:
            return self.fit_blocks(lambda: row_blocks(X), passes=4, progress=False)
        self._check_count(n_frames, columns)
        if not np.isfinite(X).all():
            as_finite(X, "X", X.shape, remedy=_FILL)
        n = min(n_frames, self._most)
        parts = [principal_components(X[:, c], min(n, len(c))) for c in columns]
        self.mean_ = X.mean(axis=0)
        return self._keep(columns, [p[1] for p in parts], [p[2] for p in parts])

    def fit_blocks(self, blocks, passes=2, progress=True):
        """Learn from frames that do not fit into memory.

        Regions of up to 500 vertices are learned in one pass, exactly as by `fit`; wider ones by
        a randomised SVD in `passes` over the frames. Memory does not grow with their number.
        When stopped half way the model stays what it was.

        Parameters
        ----------
        blocks : iterable of ndarray of shape (n, 3 * n_vertices), or callable
            Displacements from the neutral, millimetres. For more than one pass it must give the
            same blocks again: a list, or a function that returns an iterator, not a generator.
        passes : int, default=2
            Over the frames, where a region is wide. On 2,400 coordinates of a synthetic actor the
            error of 30 modes found in 2, 3 and 4 passes is 6e-4, 7e-8 and 1e-10 above the least;
            with white noise of 0.3 mm, whose modes are all alike, 1e-2, 2e-4 and 6e-6.
        progress : bool, default=True
            Show a progress bar.

        Raises
        ------
        ValueError, TypeError
            As `fit`; also for a share of variance in wide regions, whose modes are not all found.
        """
        self._check_settings()
        found = []

        def columns(n_features):
            found.extend(self._columns(n_features))
            if self._is_share and max(map(len, found)) > LARGEST_EXACT:
                raise ValueError(
                    f"n_components={self.n_components} is a share of a variance in "
                    f"{max(map(len, found))} coordinates, too many to be decomposed whole; give a "
                    "number of modes."
                )
            return found

        n_frames, mean, components, variances = components_of_blocks(
            blocks if callable(blocks) else lambda: iter(blocks),
            columns,
            self._most,
            self.random_state,
            passes,
            progress=progress,
        )
        self._check_count(n_frames, found)
        self.mean_, self.n_features_in_ = mean, len(mean)
        return self._keep(found, components, variances)

    @property
    def _is_share(self):
        return not isinstance(self.n_components, (int, np.integer))

    @property
    def _most(self):
        """Modes that one region may need."""
        return np.inf if self._is_share else int(self.n_components)

    def _check_settings(self):
        n = self.n_components
        if isinstance(n, bool) or not isinstance(n, (int, float, np.integer, np.floating)):
            raise TypeError(
                f"n_components={n!r} is neither an integer nor a share between 0 and 1."
            )
        if self._is_share and not 0 < n < 1:
            raise TypeError(
                f"n_components={n!r} is not an integer, and a share of the variance must lie "
                "between 0 and 1; give one or the other."
            )
        check_number(self.beta, "beta", low=0)
        check_choice(self.spread, "spread", ("each", "total"))
        check_choice(self.blending, "blending", ("mean", "gradient"))
        if self.regions is not None:
            _check_regions(self.regions)

    def _columns(self, n_features):
        """Columns of each region; the regions' vertices are kept as `members_`."""
        if self.regions is None:
            self.members_ = None
            return [np.arange(n_features)]
        wanted = 3 * self.regions.mesh.n_vertices
        if n_features != wanted:
            raise ValueError(
                f"X has {n_features} columns, but the regions lie on "
                f"{self.regions.mesh.n_vertices} vertices and ask for {wanted}; train on "
                "motion of the mesh that was segmented, or carry the regions over."
            )
        self.members_ = self.regions.members
        return [_columns(vertices) for vertices in self.members_]

    def _check_count(self, n_frames, columns):
        """Refuse more modes than frames and coordinates allow."""
        limits = np.minimum(n_frames - 1, [len(c) for c in columns])
        each = self.spread == "each"
        # one region's own limit only cuts that region short; the frames limit all
        n_coordinates = len(np.unique(np.concatenate(columns)))
        most = min(n_frames - 1, n_coordinates) if each else int(limits.sum())
        if not self._is_share and not 1 <= self.n_components <= most:
            raise ValueError(
                f"n_components={self.n_components}, but {n_frames} frames of {n_coordinates} "
                f"coordinates allow 1 to {most}; lower n_components or add frames."
            )

    def _keep(self, columns, components, variances):
        """Cut what was found down to what was asked for."""
        counts = _how_many(variances, self.n_components, self.spread)
        pairs = list(zip(components, variances, counts, strict=True))
        return self._set_bases(columns, [B[:n] for B, _, n in pairs], [v[:n] for _, v, n in pairs])

    def _set_bases(self, columns, components, variances):
        self.columns_ = columns
        self.components_ = [np.ascontiguousarray(B) for B in components]
        self.variances_ = variances
        self.n_components_ = np.array([len(B) for B in components])
        ends = np.cumsum(self.n_components_)
        self.slices_ = [slice(e - p, e) for e, p in zip(ends, self.n_components_, strict=True)]
        self.holders_ = np.bincount(np.concatenate(columns), minlength=len(self.mean_))
        self.boundary_ = self._boundary_matrix()
        self._fit_solvers = {}
        self.__dict__.pop("_gradient_blend", None)
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

    def truncated(self, n_components, spread="each"):
        """A new model with only the strongest modes: what `fit` would have kept, without fitting.

        Parameters
        ----------
        n_components : int or float
        spread : {"each", "total"}
            As the settings of the same names; no region gets more modes than it has now.
        """
        check_is_fitted(self)
        if self.variances_ is None:
            raise ValueError("the modes of this model were given without variances: none is last.")
        other = copy.copy(self)
        other.n_components = n_components
        if type(self) is RegionModel:
            other.spread = spread
        other._check_settings()
        return other._keep(self.columns_, self.components_, self.variances_)

    @staticmethod
    def from_bases(regions, mean, bases, beta=0.5, blending="mean"):
        """A model with any linear basis in each region; rows need not be orthonormal (Eq. 4).

        Parameters
        ----------
        regions : Regions or None
            None: the whole face is one region.
        mean : ndarray of shape (3 * n_vertices,) or (n_vertices, 3)
            The shape at zero coefficients, as a displacement from the neutral, millimetres; zero
            for blendshapes.
        bases : list of ndarray of shape (P_i, 3 * n_vertices_i), or ndarray of shape
            (P, 3 * n_vertices) or (P, n_vertices, 3)
            The rows of B^i of each region; or shapes of the whole face, such as blendshapes, that
            are cut into the regions. Shapes that do not move a region are left out of it.
        beta : float, default=0.5
        blending : {"mean", "gradient"}

        Returns
        -------
        RegionModel
            Fitted; `units_` holds for each region which of its rows, or of the shapes, it has.
            Where rows depend on one another `transform` finds the smallest coefficients.

        Raises
        ------
        ValueError
            For another number of bases than of regions, wrong shapes, or values not finite.
        """
        mean = np.asarray(mean, dtype=float).ravel()
        model = RegionModel(regions, beta=beta, blending=blending)
        model._check_settings()
        mean = as_finite(mean, "mean", ("3 * n_vertices",))
        columns = model._columns(len(mean))
        if not isinstance(bases, (list, tuple)):
            shapes = np.asarray(bases, dtype=float)
            shapes = as_finite(shapes.reshape(len(shapes), -1), "bases", ("P", len(mean)))
            bases = [shapes[:, c] for c in columns]
        if len(bases) != len(columns):
            raise ValueError(f"bases has {len(bases)} entries for {len(columns)} regions.")
        bases = [
            as_finite(B, f"bases[{i}]", ("P", len(c)))
            for i, (B, c) in enumerate(zip(bases, columns, strict=True))
        ]
        model.units_ = [np.flatnonzero(B.any(axis=1)) for B in bases]
        if not sum(map(len, model.units_)):
            raise ValueError("bases are all zero: nothing would ever move.")
        model.mean_, model.n_features_in_ = mean, len(mean)
        model.n_components = max(map(len, model.units_))
        kept = [B[units] for B, units in zip(bases, model.units_, strict=True)]
        return model._set_bases(columns, kept, None)

    # --- coefficients and faces -------------------------------------------------------------------

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
        X = validate_data(
            self, X, reset=False, dtype=[np.float64, np.float32], ensure_all_finite=False
        )
        D = as_finite(X, "X", X.shape, remedy=_FILL) - self.mean_
        rhs = np.concatenate([D[:, columns] @ B.T for columns, B, _ in self._parts()], axis=1)
        return self._fit_solver(check_number(self.beta, "beta", low=0))(rhs.T).T

    def _fit_solver(self, beta):
        if beta not in self._fit_solvers:
            A = beta * self.boundary_
            for _, B, s in self._parts():
                A[s, s] += B @ B.T
            self._fit_solvers.clear()  # that of the last beta is enough
            self._fit_solvers[beta] = _solver(A)
        return self._fit_solvers[beta]

    def inverse_transform(self, Z):
        """Faces from coefficients, regions made one surface by `blend`.

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
            n, copies = len(Z), [B.T @ Z[:, s].T for _, B, s in self._parts()]
            stacked = np.concatenate([x.reshape(-1, 3 * n) for x in copies])
            x = self._gradient_blend.carry(stacked)
            return x.reshape(-1, 3, n).transpose(2, 0, 1).reshape(n, -1)
        X = np.zeros((len(self.mean_), len(Z)))  # so that regions are added row by row
        for columns, B, s in self._parts():
            X[columns] += B.T @ Z[:, s].T
        X /= self.holders_[:, None]
        return X.T

    def blend_rows(self, vertex):
        """One vertex of `blend` as a linear function of the coefficients: shape (3, P)."""
        if not self._blends_gradients:
            weights = [(c[::3] == 3 * vertex) / self.holders_[3 * vertex] for c in self.columns_]
        else:
            ends = np.cumsum([len(c) // 3 for c in self.columns_])
            weights = np.split(self._gradient_blend.weights(vertex), ends[:-1])
        rows = np.zeros((3, self.n_coefficients_))
        for (_, B, s), w in zip(self._parts(), weights, strict=True):
            used = np.flatnonzero(w)
            rows[:, s] = np.einsum("v,pva->ap", w[used], B.reshape(len(B), len(w), 3)[:, used])
        return rows

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

    # --- files ------------------------------------------------------------------------------------

    def save(self, path):
        """Write the fitted model, its regions and their mesh to an .npz file, without pickle.

        Read it with `load_model`: it answers as this one does, to the bit. The setting
        `random_state` and what the segmentation tried are not kept.
        """
        check_is_fitted(self)
        arrays = dict(
            model=type(self).__name__,
            n_components=self.n_components,
            beta=self.beta,
            spread=self.spread,
            blending=self.blending,
            mean=self.mean_,
            counts=self.n_components_,
            components=np.concatenate([B.ravel() for B in self.components_]),
        )
        if self.variances_ is not None:
            arrays["variances"] = np.concatenate(self.variances_)
        if self.regions is not None:
            arrays |= packed_regions(self.regions)
        save_npz(path, *FILE, **arrays)


def _check_regions(regions):
    if not isinstance(regions, Regions):
        raise TypeError(
            f"regions is a {type(regions).__name__}; give the Regions from segment_face, or "
            "Regions(labels, mesh)."
        )
    alone = [i for i, m in enumerate(regions.members) if (regions.holders[m] == 1).all()]
    if alone and regions.n_regions > 1 and regions.sharing != "none":
        raise ValueError(
            f"region(s) {', '.join(map(str, alone[:6]))} share no vertex with another, as Tena "
            f"et al. ask; the mesh is in {regions.mesh.pieces.max() + 1} piece(s). Train on one "
            "piece (mesh.submesh), or say so: Regions(labels, mesh, sharing='none')."
        )


def _how_many(variances, wanted, spread):
    """Modes that each region keeps, of those whose variances are given: list of int."""
    if spread == "total":
        region = np.repeat(np.arange(len(variances)), [len(v) for v in variances])
        strongest = np.argsort(-np.concatenate(variances), kind="stable")
        n = _leading_count(np.concatenate(variances)[strongest], wanted)
        return np.bincount(region[strongest[:n]], minlength=len(variances)).tolist()
    return [_leading_count(v, wanted) for v in variances]


def _leading_count(variances, wanted):
    if isinstance(wanted, (int, np.integer)):
        return min(int(wanted), len(variances))
    held = np.cumsum(variances)
    return min(int(np.searchsorted(held, wanted * held[-1])) + 1, len(variances))


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


def _columns(vertices):
    return (3 * np.asarray(vertices)[:, None] + np.arange(3)).ravel()
