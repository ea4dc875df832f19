"""What a session, a clip or a file asks of any model of a face: stated once, here."""

from abc import ABC, abstractmethod

import numpy as np

from facelab.numeric.least_squares import solve_bounded
from facelab.numeric.threads import one_thread


class FaceModel(ABC):
    """A face that moves linearly: a basis times coefficients, counted from a neutral face.

    A model of your own derives from this class and states its `basis`; all else follows from it.
    What it knows better, it overrides: region models have regions that disagree and learned
    variances, rigs have names and bounds. Coefficients are counted from the neutral face: zero is
    exactly the neutral, in every region.

    Attributes
    ----------
    regions : Regions or None
        The regions it is made of.
    mesh : TriangleMesh or None
        Its vertices and triangles, where it knows them.
    bounds : (float, float) or None
        Ends that hold for every coefficient, both finite; None if they are free.
    named : bool
        Whether each coefficient is a shape with a name of its own, as in a rig.

    References
    ----------
    Tena et al. 2011, Eq. 1 and section 3: "applicable to linear models in general".
    """

    regions = None
    mesh = None
    bounds = None
    named = False

    @property
    @abstractmethod
    def basis(self):
        """What one of each coefficient moves: ndarray of shape (P, n_vertices, 3), millimetres."""

    # --- sizes and names --------------------------------------------------------------------------

    @property
    def n_vertices(self):
        """Vertices that it moves."""
        return self.basis.shape[1]

    @property
    def n_coefficients(self):
        """P: coefficients of all regions together."""
        return self.basis.shape[0]

    @property
    def slices(self):
        """Where the coefficients of each region are: list of slice."""
        return [slice(0, self.n_coefficients)]

    def component_names(self, region):
        """Names of a region's coefficients: list of str."""
        s = self.slices[region]
        return [f"component {k + 1}" for k in range(s.stop - s.start)]

    def check_fitted(self):
        """The model itself, refused (NotFittedError) if it has learned nothing yet."""
        return self

    def fingerprint_parts(self):
        """What tells it from other models: a kind, sizes or names, and all its numbers.

        Returns
        -------
        kind : str
        sizes : list of int or str
        arrays : list of ndarray
        """
        return type(self).__name__, [self.n_vertices, self.n_coefficients], [self.basis]

    # --- from coefficients to faces ---------------------------------------------------------------

    def displacements(self, coefficients):
        """Displacements from the neutral for rows of coefficients: (n, n_vertices, 3), mm."""
        return np.tensordot(np.atleast_2d(coefficients), self.basis, axes=1)

    def vertex_rows(self, vertex):
        """How one vertex follows the coefficients: shape (3, P)."""
        return self.basis[:, vertex].T

    def copy_rows(self, vertex):
        """How the copies of a vertex follow them, one for each region that holds it: [(3, P)]."""
        return [self.vertex_rows(vertex)]

    @property
    def holders(self):
        """Number of regions that hold each vertex: shape (n_vertices,)."""
        return np.ones(self.n_vertices, dtype=int)

    def gaps(self, coefficients):
        """How far copies lie from the vertex that is seen, at most: shape (n_vertices,), mm."""
        return np.zeros(self.n_vertices)

    # --- what Eq. 9 asks --------------------------------------------------------------------------

    def boundary(self, vertices=None):
        """Matrix of the boundary term over some vertices, all if left out: shape (P, P)."""
        return np.zeros((self.n_coefficients,) * 2)

    def resistance(self, weights):
        """W of the last term, (c_0 - c)^T W (c_0 - c), where vertices count so much: (P, P).

        The squared motion that an average coefficient makes, the same for each: so gamma means
        the same whatever the length of the shapes.
        """
        squares = (self.basis.reshape(self.n_coefficients, -1) ** 2) @ np.repeat(weights, 3)
        return squares.mean() * np.eye(self.n_coefficients)

    def training(self):
        """Mean and standard deviation of each coefficient in training, or None if unknown.

        Returns
        -------
        mean, deviations : ndarray of shape (P,)
            The mean counted from the neutral.
        """
        return None

    # --- from faces to coefficients ---------------------------------------------------------------

    def encode(self, X):
        """Coefficients that come nearest to displacements, within the bounds: shape (n, P).

        Parameters
        ----------
        X : ndarray of shape (n, n_vertices, 3)
            From the neutral, millimetres.
        """
        D = self.basis.reshape(self.n_coefficients, -1)
        X = X.reshape(len(X), -1)
        if self.bounds is None:
            return np.linalg.lstsq(D.T, X.T, rcond=None)[0].T
        H = D @ D.T
        H[np.diag_indices_from(H)] += 1e-9 * H.diagonal().max()  # shapes may depend on each other
        ends, at, found = [np.full(len(D), end) for end in self.bounds], None, []
        with one_thread():
            for g in X @ D.T:
                w, at = solve_bounded(H, g, *ends, at)
                found.append(w)
        return np.array(found).reshape(-1, len(D))

    def encode_weights(self, take):
        """Coefficients of recorded weights (`WeightSequence`), all frames: (n_frames, P)."""
        raise TypeError(
            f"take is a {type(take).__name__}; give a MotionSequence (recorded weights drive a "
            "rig, and this model is none)."
        )
