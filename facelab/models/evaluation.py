"""How far models are from the truth, on people and motion they were not trained on.

Tena et al. 2011, section 5. Errors are kept frame by frame, so that they can be averaged over any
frames and drawn again by the bootstrap.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from sklearn.decomposition import MiniBatchSparsePCA

from facelab.checks import as_finite, as_floats, as_numbers, check_count, check_number, check_type
from facelab.face_model import FaceModel
from facelab.models.components import check_moves
from facelab.models.region import RegionModel
from facelab.numeric.seeds import as_generator


def rms_error(X, X_hat):
    """E_RMS: root mean squared distance per vertex, over all frames.

    Parameters
    ----------
    X, X_hat : ndarray of shape (n_frames, 3 * n_vertices) or (n_frames, n_vertices, 3)
        Truth and reconstruction, millimetres.

    Returns
    -------
    float
        Millimetres.

    Raises
    ------
    ValueError
        If the shapes differ or hold no frames.

    References
    ----------
    Tena et al. 2011, Eq. 13.

    Examples
    --------
    >>> import facelab
    >>> facelab.rms_error([[0.0, 0.0, 0.0]], [[3.0, 0.0, 4.0]])  # one vertex, off by 5 mm
    5.0
    """
    return float(np.sqrt(frame_errors(X, X_hat).mean()))  # Eq. 13


def frame_errors(X, X_hat):
    """Mean squared distance per vertex in each frame, square millimetres: shape (n_frames,).

    The inner sum of Tena et al., Eq. 13; the parameters are those of `rms_error`.
    """
    X, X_hat = (
        as_numbers(x, name, "(n_frames, 3 * n_vertices)")
        for x, name in ((X, "X"), (X_hat, "X_hat"))
    )
    if X.shape != X_hat.shape:
        raise ValueError(f"X has shape {X.shape}, X_hat {X_hat.shape}; they must agree.")
    if X.size == 0 or X.ndim == 0 or X.shape[-1] % 3:
        raise ValueError(f"X has shape {X.shape}: no frames, or not three coordinates a vertex.")
    return 3 * ((X - X_hat) ** 2).reshape(len(X), -1).mean(axis=1)


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Errors of models of growing size on the same frames.

    Parameters
    ----------
    components : ndarray of int, shape (n_models,)
        Most modes that one region of each model has; all of them where there is one region.
    parameters : ndarray of int, shape (n_models,)
        Coefficients of each model, all regions together.
    squares : ndarray of shape (n_models, n_frames)
        Mean squared distance per vertex in each frame, square millimetres.
    takes : ndarray of shape (n_frames,)
        The take that each frame belongs to.
    """

    components: np.ndarray
    parameters: np.ndarray
    squares: np.ndarray
    takes: np.ndarray

    @property
    def rms(self):
        """E_RMS (Eq. 13) of each model, millimetres: shape (n_models,)."""
        return np.sqrt(self.squares.mean(axis=1))

    def of(self, frames):
        """The same models on some of the frames: a mask of shape (n_frames,), or indices."""
        return replace(self, squares=self.squares[:, frames], takes=self.takes[frames])

    def draws(self, n_draws=500, random_state=0):
        """E_RMS of each model on takes drawn with repetition: shape (n_draws, n_models), mm.

        Frames of one take are alike, so whole takes are drawn, not frames.
        """
        rng = as_generator(random_state)
        _, take = np.unique(self.takes, return_inverse=True)
        count = np.bincount(take)
        sums = np.stack([np.bincount(take, s) for s in self.squares], axis=1)  # (n_takes, n_models)
        picked = rng.integers(len(count), size=(n_draws, len(count)))
        return np.sqrt(sums[picked].sum(axis=1) / count[picked].sum(axis=1)[:, None])

    def band(self, level=0.9, n_draws=500, random_state=0):
        """Where E_RMS lies at this level of confidence by the bootstrap: shape (2, n_models), mm.

        Parameters
        ----------
        level : float, default=0.9
        n_draws : int
        random_state : int or Generator
        """
        level = check_number(level, "level", above=0, high=1)
        outside = (1 - level) / 2
        return np.quantile(self.draws(n_draws, random_state), [outside, 1 - outside], axis=0)


def error_curves(models, X, targets=None, takes=None):
    """What each model makes of some frames, against one or several truths.

    Parameters
    ----------
    models : iterable of RegionModel
        Fitted; such as `(model.truncated(n) for n in (1, 2, 5))`: nested models need one fit.
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Frames to reconstruct: displacements from the neutral, millimetres.
    targets : dict of str to ndarray of shape (n_frames, 3 * n_vertices), optional
        What to compare with; X itself, as "frames", if left out.
    takes : array_like of shape (n_frames,), optional
        The take of each frame, for the bootstrap; every frame for itself if left out.

    Returns
    -------
    dict of str to ErrorCurve
    """
    if isinstance(models, FaceModel) or not isinstance(models, Iterable):
        raise TypeError(f"models is a {type(models).__name__}; give a list of fitted models.")
    targets = {"frames": X} if targets is None else targets
    check_type(targets, "targets", dict, 'give truths by name: {"clean": X}')
    X = as_floats(X, "X", "(n_frames, 3 * n_vertices)")
    if X.ndim != 2:
        raise ValueError(f"X has shape {X.shape}, but needs shape (n_frames, 3 * n_vertices).")
    takes = np.arange(len(X)) if takes is None else np.asarray(takes)
    if takes.shape != (len(X),):
        raise ValueError(f"takes has shape {takes.shape}, but X has {len(X)} frames.")
    components, parameters, squares = [], [], {name: [] for name in targets}
    for model in models:
        check_type(model, "a model", FaceModel, "give fitted models")
        X_hat = model.reconstruct(X)
        components.append(int(model.n_components_.max()))
        parameters.append(model.n_coefficients)
        for name, truth in targets.items():
            squares[name].append(frame_errors(truth, X_hat))
    sizes = np.array(components), np.array(parameters)
    return {name: ErrorCurve(*sizes, np.array(s), takes) for name, s in squares.items()}


def variance_across(curves):
    """Variance of E_RMS over individuals, for each model size: shape (n_models,), mm^2.

    Parameters
    ----------
    curves : list of ErrorCurve
        The same models, each curve on another individual.

    References
    ----------
    Tena et al. 2011, section 5: "less variance on the error obtained across individuals".
    """
    return np.var([curve.rms for curve in curves], axis=0)


def rank_of_motion(X, tolerance=0.01):
    """Components that rebuild frames to a tolerance: what the rig behind them amounts to.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Displacements without noise, millimetres; their mean counts as one component if it is not
        zero.
    tolerance : float, default=0.01
        E_RMS that may be left, millimetres.

    Returns
    -------
    int
    """
    X = as_finite(X, "X", ("n_frames", "3 * n_vertices"))
    tolerance = check_number(tolerance, "tolerance", low=0)
    s = np.linalg.svd(X, compute_uv=False)
    left = np.append(np.cumsum(s[::-1] ** 2)[::-1], 0)  # sum of squares beyond each rank
    return int((np.sqrt(3 * left / X.size) > tolerance).sum())


def sparse_model(X, n_components, alpha=1.0, random_state=0):
    """A whole-face model whose modes are sparse: each moves few coordinates.

    scikit-learn's mini-batch sparse PCA, for comparison at the same number of parameters.
    Coefficients are least squares, as in every other model here, not shrunk.

    Parameters
    ----------
    X : ndarray of shape (n_frames, 3 * n_vertices)
        Displacements from the neutral, millimetres.
    n_components : int
        Modes that stay empty are left out.
    alpha : float, default=1
        Weight of sparsity, X scaled to variance one.
    random_state : int

    Returns
    -------
    RegionModel
    """
    X = as_finite(X, "X", ("n_frames", "3 * n_vertices"))
    n_components = check_count(n_components, "n_components", 1, min(X.shape), "components")
    alpha = check_number(alpha, "alpha", low=0)
    check_moves([X.var(axis=0)], X.mean(axis=0))
    found = MiniBatchSparsePCA(
        n_components, alpha=alpha, max_iter=30, batch_size=32, random_state=random_state
    ).fit(X / X.std())
    return RegionModel.from_bases(None, X.mean(axis=0), [found.components_])
