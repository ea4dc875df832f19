"""The holistic model: one region, the whole face."""

from facelab.models.region import RegionModel


class HolisticModel(RegionModel):
    """One PCA for the whole face: a `RegionModel` with a single region.

    Parameters
    ----------
    n_components : int or float, optional
        Number of modes, or share of the variance; 30 if left out, or as many as the data allow.
    random_state : int, RandomState or None, default=0

    References
    ----------
    Tena et al. 2011, Eq. 1 to 4.

    Examples
    --------
    >>> import facelab
    >>> actor = facelab.load_registered("M1", size="small", progress=False)
    >>> X = actor.motion("train").displacements()
    >>> model = facelab.HolisticModel(n_components=10).fit(X)
    >>> model.transform(X).shape[1]
    10
    """

    regions = None
    beta = 0.0
    spread = "each"
    blending = "mean"

    def __init__(self, n_components=None, random_state=0):
        self.n_components = n_components
        self.random_state = random_state
