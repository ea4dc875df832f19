"""One set of modes between a holistic and a region model, shrunk by the noise of the frames."""

import numpy as np
from sklearn.cluster import KMeans

from facelab.checks import as_finite, check_number, check_type
from facelab.models.components import check_moves, leading_modes, principal_components, row_blocks
from facelab.models.region import RegionModel
from facelab.numeric.threads import one_thread
from facelab.segmentation.regions import Regions

SOFTNESS = 25.0
"""Millimetres along the mesh over which one region fades into the next."""

SHARES = (0.0, 0.3, 0.7)
"""Shares of the variance that move region by region, of which held-out expressions choose one."""

N_EXPRESSIONS = 5
"""Clusters of frames; each is left out in turn to choose the share."""

LARGEST = 3000
"""Most coordinates: the covariance is held as a whole, and decomposed 16 times."""

_BAND = 20  # the strongest modes that share a scale; each further band is twice as wide
_SCALES = np.logspace(-1, 3, 9)  # of the variance of training
_ASKED = 100  # frames of a cluster that are rebuilt, at most
_FEW = 8  # frames for each cluster, at least


class GlobalLocalModel(RegionModel):
    """Modes of a covariance that lets regions of the face move by themselves, shrunk by the noise.

    With C the covariance of the frames, S_r diagonal the root of how far each vertex belongs to
    region r (fading over `softness`; the squares of a vertex sum up to one), and w the share,

        K = (1 - w) C + w sum_r S_r C S_r

    is the covariance of a face of which the share w moves region by region. Each vertex keeps its
    variance. The P leading eigenvectors of K are the modes, one orthonormal basis: where few are
    wanted they move the whole face, further ones move places. w = 0 is the holistic model. At
    `share=None` w is the one of `SHARES` that rebuilds held-out expressions best: frames are
    clustered, each cluster is left out in turn, and the error against its truth, which nobody
    knows, is estimated without bias from its noisy frames (Stein),

        |x - x_hat|^2 - n s^2 + 2 s^2 sum_k a_k

    with n coordinates, the noise variance s^2 and the shrinkage a_k of each mode. s^2 follows from
    the median of the eigenvalues of C, which in noise alone lies where Marchenko and Pastur have
    it. Coefficients of a frame are shrunk by a_k = t v_k / (t v_k + s^2), v_k the variance of mode
    k less that of the noise; the scale t, the likeliest for a band of modes in this very frame,
    lets frames be livelier than those of training (empirical Bayes).

    Parameters
    ----------
    cut : Regions
        From `segment_face`; `regions` of this model is None, for it has one basis.
    n_components : int, optional
        P; 30 if left out, or as many as the data allow.
    share : float, optional
        w, 0 to 1; chosen if left out.
    softness : float, default=25
        Millimetres.
    random_state : int, RandomState or None, default=0
        For the clusters.

    Attributes
    ----------
    share_ : float
        w.
    noise_ : float
        s, millimetres an axis.
    mean_, components_, variances_ : as of `HolisticModel`
        Variances include that of the noise.

    Notes
    -----
    `transform`, and so `reconstruct`, shrinks: it is meant for noisy frames, and is not linear.
    `encode`, which sessions use, does not.

    References
    ----------
    Tena et al. 2011, section 3, whose regions these are. A covariance multiplied entry by entry
    localises a model: Luethi et al. 2018, Gaussian process morphable models; Wilms et al. 2017,
    shape models based on the locality assumption. Stein 1981; Efron and Morris 1973; Gavish and
    Donoho 2014 for the median. The mixture with soft regions, bands and the choice by expressions
    are ours.

    Examples
    --------
    >>> import facelab
    >>> actor = facelab.load_registered("M1", size="small", progress=False)
    >>> motion = actor.motion("train")
    >>> cut = facelab.segment_face(motion, n_regions=6, random_state=0, progress=False)
    >>> model = facelab.models.GlobalLocalModel(cut, 20).fit(motion.displacements())
    >>> model.n_coefficients, model.share_ in (0.0, 0.3, 0.7)
    (20, True)
    """

    regions = None
    beta = 0.0
    spread = "each"
    blending = "mean"

    def __init__(self, cut, n_components=None, share=None, softness=SOFTNESS, random_state=0):
        self.cut = cut
        self.n_components = n_components
        self.share = share
        self.softness = softness
        self.random_state = random_state

    @property
    def mesh(self):
        """The mesh of the regions."""
        return self.cut.mesh

    def _check_settings(self):
        super()._check_settings()
        check_type(self.cut, "cut", Regions, "take those of segment_face")
        if self._is_share:
            raise TypeError(f"n_components={self.n_components!r} is not an integer.")
        if self.share is not None:
            check_number(self.share, "share", low=0, high=1)
        check_number(self.softness, "softness", above=0)

    # --- learning ---------------------------------------------------------------------------------

    def _learned_of_blocks(self, blocks, *_):
        """Blocks, and those of a Dask array, are gathered: a face so small fits into memory."""
        wanted = "n_frames", 3 * self.cut.mesh.n_vertices
        self._check_width(wanted[1])
        some = blocks() if callable(blocks) else [blocks]
        some = [x if isinstance(x, np.ndarray) else np.asarray(x) for x in some]
        frames = [as_finite(x, "X", wanted, "one of the blocks") for x in some]  # no masks either
        return self._learned(np.concatenate(frames))

    def _learned(self, X):
        n_frames, n_features = X.shape
        self._check_width(n_features)
        P = self._wanted(n_frames, [np.arange(n_features)])
        X = as_finite(X, "X", X.shape)
        share = self.shares_for(X, [P])[0] if self.share is None else float(self.share)
        with one_thread():
            noise = noise_variance(X)
            mean, variances, modes = _modes(X, self._kept_together(), share, P)
        check_moves([variances], mean)
        self._found = share, float(np.sqrt(noise))
        return mean, None, [modes], [variances]

    def shares_for(self, X, sizes):
        """The share that `fit` would choose for each number of modes: list of float.

        Parameters
        ----------
        X : ndarray of shape (n_frames, 3 * n_vertices)
        sizes : sequence of int
            All of them cost hardly more than the largest.
        """
        clusters = expressions(X, self.random_state)
        if clusters is None:
            return [SHARES[1]] * len(sizes)
        with one_thread():
            L, noise = self._kept_together(), noise_variance(X)
            risks = np.zeros((len(SHARES), len(sizes)))
            for k in range(clusters.max() + 1):
                out = np.flatnonzero(clusters == k)
                asked = X[out[np.unique(np.linspace(0, len(out) - 1, _ASKED).astype(int))]]
                for i, share in enumerate(SHARES):
                    mean, variances, modes = _modes(X[clusters != k], L, share, max(sizes))
                    D = asked - mean
                    Z = D @ modes.T
                    for j, P in enumerate(sizes):
                        risks[i, j] += estimated_error(D, Z[:, :P], variances[:P], noise)
        return [SHARES[i] for i in risks.argmin(axis=0)]

    def _check_width(self, n_features):
        if n_features != 3 * self.cut.mesh.n_vertices:
            raise ValueError(
                f"X has {n_features} columns, but cut lies on {self.cut.mesh.n_vertices} vertices "
                f"and asks for {3 * self.cut.mesh.n_vertices}; train on motion of the mesh that "
                "was segmented, or carry the regions over."
            )
        if n_features > LARGEST:
            raise ValueError(
                f"X has {n_features} columns, but at most {LARGEST} are decomposed; train on "
                "control vertices (`TriangleMesh.subsample`) and bind the face to them."
            )

    def set_bases(self, mean, members, components, variances):
        super().set_bases(mean, members, components, variances)
        if "_found" in vars(self):
            self.share_, self.noise_ = vars(self).pop("_found")
        return self

    def _kept_together(self):
        """sum_r s_r s_r^T: what region-wise motion keeps of the covariance of two vertices."""
        member = self.cut.labels == np.arange(self.cut.n_regions)[:, None]
        near = np.exp(-((self.mesh.geodesics() / self.softness) ** 2) / 2)
        belongs = member @ near
        s = np.sqrt(belongs / belongs.sum(axis=0))
        return s.T @ s

    # --- coefficients -----------------------------------------------------------------------------

    def transform(self, X):
        """Coefficients of noisy frames, shrunk: shape (n_frames, P).

        Parameters
        ----------
        X : ndarray of shape (n_frames, 3 * n_vertices)
            Displacements from the neutral, millimetres.
        """
        Z = super().transform(X)
        for rows in row_blocks(Z):
            rows *= shrinkage(rows, self.variances_[0], self.noise_**2)
        return Z

    # --- files ------------------------------------------------------------------------------------

    def own_arrays(self):
        arrays = self.cut.packed() | dict(softness=self.softness, share=self.share_)
        return arrays | dict(noise=self.noise_, chosen=self.share is None)

    @classmethod
    def own_settings(cls, stored):
        chosen = bool(stored.read("chosen", (), "b"))
        share = None if chosen else stored.read("share", (), "f").item()
        softness = stored.read("softness", (), "iuf").item()
        return dict(cut=Regions.unpacked(stored), share=share, softness=softness)

    @classmethod
    def unpacked(cls, stored):
        model = super().unpacked(stored)
        if len(model.mean_) != 3 * model.mesh.n_vertices:
            raise ValueError(f"a mean of {len(model.mean_)} coordinates, and another mesh")
        if model.variances_ is None:
            raise ValueError("no variances, which shrink the coefficients")
        model.share_ = check_number(stored.read("share", (), "f").item(), "share", low=0, high=1)
        model.noise_ = check_number(stored.read("noise", (), "f").item(), "noise", low=0)
        return model


def noise_variance(X):
    """Variance of white noise in frames, from the median of their principal variances.

    Parameters
    ----------
    X : ndarray of shape (n_frames, n_features)
        Signal of a rank well below half of the smaller side, and noise alike in all coordinates.

    Returns
    -------
    float
        In the square of X's unit.

    References
    ----------
    Gavish and Donoho 2014, The optimal hard threshold for singular values is 4/sqrt(3).
    """
    D = X - X.mean(axis=0)
    n, p = len(D) - 1, D.shape[1]  # centring costs a degree of freedom
    square = D @ D.T if n < p else D.T @ D
    values = np.sort(np.linalg.eigvalsh(square))[-min(n, p) :]
    ratio = min(n, p) / max(n, p)
    low, high = (1 - np.sqrt(ratio)) ** 2, (1 + np.sqrt(ratio)) ** 2
    x = np.linspace(low, high, 10001)[1:-1]
    held = np.cumsum(np.sqrt((high - x) * (x - low)) / x)  # Marchenko and Pastur, unnormalised
    median = x[np.searchsorted(held, held[-1] / 2)]
    return max(float(np.median(values)), 0.0) / (max(n, p) * median)


def expressions(X, random_state=0):
    """The cluster of like expressions that each frame is in: int of shape (n_frames,), or None.

    None where frames are too few to leave some out.
    """
    n_clusters = min(N_EXPRESSIONS, len(X) // _FEW)
    if n_clusters < 2:
        return None
    mean, modes, _ = principal_components(X, min(10, *X.shape))
    Z = (X - mean) @ modes.T
    return KMeans(n_clusters, n_init=3, random_state=random_state).fit_predict(Z)


def shrinkage(Z, variances, noise):
    """What is left of each coefficient of noisy frames, 0 to 1: shape (n_frames, P).

    Parameters
    ----------
    Z : ndarray of shape (n_frames, P)
        Counted from the mean.
    variances : ndarray of shape (P,)
        In training, that of the noise included, strongest first.
    noise : float
        Variance of the noise.

    References
    ----------
    Efron and Morris 1973: a prior whose scale is read off the data.
    """
    a = np.ones_like(Z)
    if noise <= 0:
        return a
    signal = np.maximum(variances - noise, 1e-3 * noise)
    start, width = 0, _BAND
    while start < len(signal):
        band = slice(start, start + width)
        spread = _SCALES[:, None] * signal[band]  # (n_scales, n_modes)
        total = spread + noise
        unlikely = np.log(total).sum(axis=1) + Z[:, band] ** 2 @ (1 / total).T
        a[:, band] = (spread / total)[unlikely.argmin(axis=1)]
        start, width = start + width, 2 * width
    return a


def estimated_error(D, Z, variances, noise):
    """Squared error against the truth of rebuilt noisy frames, without the truth: their mean.

    Stein's estimate, |x - x_hat|^2 - n s^2 + 2 s^2 sum_k a_k.

    Parameters
    ----------
    D : ndarray of shape (n_frames, n_features)
        Noisy frames, counted from the mean.
    Z : ndarray of shape (n_frames, P)
        Their coefficients in orthonormal modes, before they are shrunk.
    variances : ndarray of shape (P,)
    noise : float
        As for `shrinkage`.

    References
    ----------
    Stein 1981. That the scale of a band follows from the frame is left out of it.
    """
    a = shrinkage(Z, variances, noise)
    left = (D**2).sum(axis=1) - ((2 * a - a**2) * Z**2).sum(axis=1)
    return float((left - D.shape[1] * noise + 2 * noise * a.sum(axis=1)).mean())


def _modes(X, L, share, P):
    """Mean, variances and modes of K: shapes (n_features,), (P,) and (P, n_features)."""
    mean = X.mean(axis=0)
    D = (X - mean).reshape(len(X), -1)
    K = D.T @ D / (len(X) - 1)
    if share:
        n = len(L)
        blocks = K.reshape(n, 3, n, 3)
        blocks *= (1 - share + share * L)[:, None, :, None]
    variances, modes = leading_modes(K, P)
    return mean, variances, modes
