"""Linear face models: one PCA for the whole face, or one per region with soft boundaries.

Tena et al. 2011, section 3.1. Estimators after scikit-learn: `X` is (n_frames, 3 * n_vertices),
x, y, z of a vertex side by side, the neutral face subtracted, millimetres.
"""

import copy

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from facelab.checks import as_finite, check_choice, check_number, refuse_mask
from facelab.models.bases import RegionBases, columns_of
from facelab.models.components import (
    LARGEST_EXACT,
    check_moves,
    components_of_blocks,
    components_of_sets,
    row_blocks,
)
from facelab.models.distributed import components_of_dask
from facelab.motion import MotionSequence
from facelab.numeric.engine import is_dask
from facelab.segmentation.regions import Regions
from facelab.storage import save_npz

FILE = "linear-face-model", 1
ARRAYS = frozenset(
    "model n_components beta spread blending mean counts components variances labels vertices "
    "faces landmark_names landmarks sharing rings held samples softness share noise chosen".split()
)

N_COMPONENTS = 30
"""Modes that each region gets where nothing else is said and the data allow as many."""

_NOTHING = 1e-10
"""Of the largest variance; what moves less, a thousandth of a millimetre, is no motion."""

_FILL = "leave lost frames out, or fill their gaps"

BETA = 0.5
"""β of the paper: weight of the agreement of regions on their boundaries."""


class RegionModel(TransformerMixin, RegionBases, BaseEstimator):
    """One PCA per region of the face, all solved together with soft boundaries.

    Parameters
    ----------
    regions : Regions, optional
        From `segment_face`; the whole face as one region if left out.
    n_components : int or float, optional
        Modes to keep: an integer is their number, a float between 0 and 1 the share of the
        variance that they hold. A region never gets more than it has coordinates, or than the rank
        of its motion (a hundredth of a thousandth of the strongest counts as none). If left
        out, 30 (`N_COMPONENTS`), or as many as there are where frames or coordinates are fewer.
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
        n_components=None,
        beta=BETA,
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
        X : ndarray or Dask array of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres. A memory-mapped array is read in blocks
            (`fit_blocks`), never as a whole; a Dask array is summed up where its blocks are, by
            the scheduler that is set (`facelab.scale.cluster`).
        y : ignored

        Raises
        ------
        ValueError
            For NaN, too few frames for `n_components`, frames that are all alike, positions in
            place of displacements, regions that share no vertex, or a number of columns that is
            not three for each vertex of the regions.
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
        refuse_mask(X, "X", _FILL)
        if isinstance(X, np.memmap) and X.ndim == 2:
            return self.fit_blocks(lambda: row_blocks(X))
        if is_dask(X):
            learned = self._learned_of_blocks(X, 4, False, components_of_dask)
            vars(self).pop("feature_names_in_", None)
            return self._set_learned(*learned)
        frames = check_array(
            X,
            dtype=[np.float64, np.float32],
            ensure_min_samples=2,
            ensure_all_finite=False,
            estimator=self,
            input_name="X",
        )
        learned = self._learned(frames)
        validate_data(self, X, skip_check_array=True)  # keeps the names of the columns
        return self._set_learned(*learned)

    def _set_learned(self, mean, *modes):
        """`set_bases`, of displacements: positions would leave the face twice its size."""
        regions = getattr(self, "cut", self.regions)
        if regions is not None:
            V = regions.mesh.vertices.ravel()
            if np.linalg.norm(mean - V) < 0.2 * np.linalg.norm(mean):
                raise ValueError(
                    "X holds positions: its mean lies on the mesh of the regions. Models learn "
                    "displacements from the neutral: motion.displacements()."
                )
        return self.set_bases(mean, *modes)

    def _learned(self, X):
        """What `set_bases` takes, from frames in memory."""
        n_frames, n_features = X.shape
        members = self._members(n_features)
        columns = columns_of(members, n_features)
        if min(n_frames, max(map(len, columns))) > LARGEST_EXACT and not self._is_share:
            return self._learned_of_blocks(lambda: row_blocks(X), passes=4, progress=False)
        wanted = self._wanted(n_frames, columns)
        if not np.isfinite(X).all():
            as_finite(X, "X", X.shape, remedy=_FILL)
        mean, *found = components_of_sets(X, columns, self._most)
        return mean, members, *_cut(mean, *found, wanted, self.spread)

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
        learned = self._learned_of_blocks(
            blocks if callable(blocks) else lambda: iter(blocks), passes, progress
        )
        vars(self).pop("feature_names_in_", None)  # blocks have none
        return self._set_learned(*learned)

    def _learned_of_blocks(self, blocks, passes, progress, components=components_of_blocks):
        """What `set_bases` takes, from frames in blocks."""
        cuts = []

        def columns(n_features):
            members = self._members(n_features)
            cut = columns_of(members, n_features)
            cuts.append((members, cut))
            if self._is_share and max(map(len, cut)) > LARGEST_EXACT:
                raise ValueError(
                    f"n_components={self.n_components} is a share of a variance in "
                    f"{max(map(len, cut))} coordinates, too many to be decomposed whole; give a "
                    "number of modes."
                )
            return cut

        n_frames, mean, components, variances = components(
            blocks, columns, self._most, self.random_state, passes, progress=progress
        )
        members, cut = cuts[0]
        wanted = self._wanted(n_frames, cut)
        return mean, members, *_cut(mean, components, variances, wanted, self.spread)

    @property
    def _is_share(self):
        return isinstance(self.n_components, (float, np.floating))

    @property
    def _most(self):
        """Modes that one region may need."""
        n = self.n_components
        return N_COMPONENTS if n is None else np.inf if self._is_share else int(n)

    def _check_settings(self):
        n = self.n_components
        if isinstance(n, bool) or not (
            n is None or isinstance(n, (int, float, np.integer, np.floating))
        ):
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

    def _members(self, n_features):
        """Vertices of each region, None where the whole face is one; refused if they do not fit."""
        if self.regions is None:
            return None
        wanted = 3 * self.regions.mesh.n_vertices
        if n_features != wanted:
            raise ValueError(
                f"X has {n_features} columns, but the regions lie on "
                f"{self.regions.mesh.n_vertices} vertices and ask for {wanted}; train on "
                "motion of the mesh that was segmented, or carry the regions over."
            )
        return self.regions.members

    def _wanted(self, n_frames, columns):
        """Number or share of modes to keep, refused if frames and coordinates do not allow it."""
        limits = np.minimum(n_frames - 1, [len(c) for c in columns])
        each = self.spread == "each"
        # one region's own limit only cuts that region short; the frames limit all
        n_coordinates = len(np.unique(np.concatenate(columns)))
        most = min(n_frames - 1, n_coordinates) if each else int(limits.sum())
        if self.n_components is None:
            return min(N_COMPONENTS, most)
        if not self._is_share and not 1 <= self.n_components <= most:
            raise ValueError(
                f"n_components={self.n_components}, but {n_frames} frames of {n_coordinates} "
                f"coordinates allow 1 to {most}; lower n_components or add frames."
            )
        return self.n_components

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
        wanted = N_COMPONENTS if n_components is None else n_components
        cut = _cut(self.mean_, self.components_, self.variances_, wanted, other.spread)
        return other.set_bases(self.mean_, self.members_, *cut)

    @staticmethod
    def from_bases(regions, mean, bases, beta=BETA, blending="mean"):
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
        model = RegionModel(regions, beta=beta, blending=blending)
        model._check_settings()
        mean = as_finite(np.ravel(mean), "mean", ("3 * n_vertices",))
        members = model._members(len(mean))
        columns = columns_of(members, len(mean))
        if not isinstance(bases, (list, tuple)):
            shapes = np.asanyarray(bases)
            shapes = as_finite(shapes.reshape(len(shapes), -1), "bases", ("P", len(mean)))
            bases = [shapes[:, c] for c in columns]
        if len(bases) != len(columns):
            raise ValueError(f"bases has {len(bases)} entries for {len(columns)} regions.")
        bases = [
            as_finite(B, f"bases[{i}]", ("P", len(c)))
            for i, (B, c) in enumerate(zip(bases, columns, strict=True))
        ]
        units = [np.flatnonzero(B.any(axis=1)) for B in bases]
        if not sum(map(len, units)):
            raise ValueError("bases are all zero: nothing would ever move.")
        model.n_components = max(map(len, units))
        kept = [B[rows] for B, rows in zip(bases, units, strict=True)]
        model.set_bases(mean, members, kept, None)
        model.units_ = units
        return model

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
        refuse_mask(X, "X", _FILL)
        if not (isinstance(X, np.memmap) and X.ndim == 2):  # one of those is never read whole
            kinds = [np.float64, np.float32]
            X = validate_data(self, X, reset=False, dtype=kinds, ensure_all_finite=False)
        validate_data(self, X, reset=False, skip_check_array=True)
        Z, start = np.empty((len(X), self.n_coefficients)), 0
        for rows in row_blocks(X):
            stop = start + len(rows)
            where = "" if len(rows) == len(X) else f"frames {start} to {stop - 1}"
            D = as_finite(rows, "X", rows.shape, where, _FILL)
            Z[start:stop] = self.solved(D - self.mean_)
            start = stop
        return Z

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
        Z = np.atleast_2d(np.asanyarray(Z))
        if Z.shape[-1] != self.n_coefficients:
            raise ValueError(
                f"Z has {Z.shape[-1]} columns, but the model has {self.n_coefficients} "
                "coefficients."
            )
        return self.mean_ + self.blend(as_finite(Z, "Z", ("n_frames", "P"), remedy=_FILL))

    def reconstruct(self, X):
        """The model's best version of each frame, shape (n_frames, 3 * n_vertices)."""
        return self.inverse_transform(self.transform(X))

    # --- files ------------------------------------------------------------------------------------

    def save(self, path):
        """Write the fitted model, its regions and their mesh to an .npz file, without pickle.

        Read it with `load_model`: it answers as this one does, to the bit. The setting
        `random_state` and what the segmentation tried are not kept.
        """
        check_is_fitted(self)
        n = self.n_components
        arrays = dict(
            model=type(self).__name__,
            n_components=[] if n is None else n,
            beta=self.beta,
            spread=self.spread,
            blending=self.blending,
            mean=self.mean_,
            counts=self.n_components_,
            components=np.concatenate([B.ravel() for B in self.components_]),
        )
        if self.variances_ is not None:
            arrays["variances"] = np.concatenate(self.variances_)
        save_npz(path, *FILE, **arrays, **self.own_arrays())

    def own_arrays(self):
        """What a file holds of this kind of model alone: here the regions, if there are any."""
        return {} if self.regions is None else self.regions.packed()

    @classmethod
    def own_settings(cls, stored):
        """The settings in `own_arrays`: dict."""
        return dict(regions=Regions.unpacked(stored) if "labels" in stored else None)

    @classmethod
    def unpacked(cls, stored):
        """The model of a file that `save` wrote.

        Parameters
        ----------
        stored : StoredArrays
            Open; sizes are compared before an array is read.

        Raises
        ------
        ValueError, TypeError
            For arrays that are missing, do not fit together or make no model.
        """
        model = cls._of_settings(stored)
        mean = as_finite(stored.read("mean", ("n_features",), "f"), "mean", ("n_features",))
        members = model._members(len(mean))
        widths = [len(c) for c in columns_of(members, len(mean))]
        counts = stored.read("counts", (len(widths),), "iu")
        kept = counts.max() if model.spread == "each" else counts.sum()
        if counts.min() < 0 or not 0 < kept <= model._most or len(mean) == 0:
            raise ValueError(f"counts={counts.tolist()[:6]} are no numbers of modes of each region")
        counts = counts.tolist()
        sizes = [n * width for n, width in zip(counts, widths, strict=True)]
        flat = as_finite(stored.read("components", (sum(sizes),), "f"), "components", (sum(sizes),))
        variances = None
        if "variances" in stored:
            variances = _variances(stored.read("variances", (sum(counts),), "f"), counts)
        rows = np.split(flat, np.cumsum(sizes)[:-1])
        components = [x.reshape(n, w) for x, n, w in zip(rows, counts, widths, strict=True)]
        return model.set_bases(mean, members, components, variances)

    @classmethod
    def _of_settings(cls, stored):
        """A model that has learned nothing, with the settings of a file."""
        unset = stored.shape("n_components") == (0,)
        n = stored.read("n_components", (0,) if unset else (), "iuf")
        settings = dict(
            n_components=None if unset else n.item(),
            beta=stored.read("beta", (), "iuf").item(),
            spread=stored.read("spread", (), "U").item(),
            blending=stored.read("blending", (), "U").item(),
            **cls.own_settings(stored),
        )
        taken = cls._get_param_names()
        model = cls(**{name: value for name, value in settings.items() if name in taken})
        for name, value in settings.items():
            if name not in taken and value != getattr(model, name):
                raise ValueError(f"{name}={value!r}, which a {cls.__name__} cannot have")
        model._check_settings()
        return model


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


def _variances(flat, counts):
    """Variances of each region, refused unless they can be: never negative, strongest first."""
    flat = as_finite(flat, "variances", (sum(counts),))
    variances = np.split(flat, np.cumsum(counts)[:-1])
    if (flat < 0).any() or any((np.diff(v) > 0).any() for v in variances):
        raise ValueError("variances are negative, or rise within a region")
    return variances


def _cut(mean, components, variances, wanted, spread):
    """Modes and variances of each region, cut down to what is wanted and to what moves.

    Beyond the rank of the motion there are no modes, only directions that rounding chose; a pin
    would pull along them as readily as along any other.
    """
    check_moves(variances, mean)
    strongest = max(v.max(initial=0) for v in variances)
    counts = _how_many(variances, wanted, spread)
    counts = [
        min(n, int((v > _NOTHING * strongest).sum()))
        for n, v in zip(counts, variances, strict=True)
    ]
    kept = list(zip(components, variances, counts, strict=True))
    return [B[:n] for B, _, n in kept], [v[:n] for _, v, n in kept]


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
