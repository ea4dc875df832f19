"""What few markers leave open, filled by what is known of faces.

As Eq. 9 of Tena et al. 2011 asks a linear model what a face does that reaches its pins, so this
asks linear models what a face does whose markers are seen. Models are trained on other people, so
they are not believed alone: the motion is a Gaussian field, its covariance that of the models plus
that of a smooth field whose sides mostly do the same, as those of faces do.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from facelab.checks import check_number
from facelab.face_model import FaceModel
from facelab.geometry.symmetry import MIRROR, mirror_twins
from facelab.registration.layout import SHIFT, covariance, filled, kernel, mapped


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of how faces move before their markers are seen.

    Parameters
    ----------
    shapes : ndarray of shape (n_shapes, n_vertices, 3)
        Independent of each other; their squares sum to 1 for an average vertex and axis.
    share : float
        Of the models in the variance, 0 to 1; the rest is the smooth field's.
    mirror : float
        Correlation of a place with the mirrored motion of its twin, in the smooth field.
    """

    shapes: np.ndarray
    share: float
    mirror: float


def made_prior(mesh, models, binding=None, share=0.25, mirror=0.5):
    """The prior of some models on a fitted face: Prior.

    Each mode varies as its standard deviation, not as the square of it: strong modes of other
    people, a jaw that drops far, are no less strange to this one than weak ones. Models count
    alike, whatever the size of the faces and motions that they were trained on.

    Parameters
    ----------
    mesh : TriangleMesh
        The fitted face.
    models : sequence of FaceModel
        Trained, so that their coefficients have spreads; on the vertices of the mesh, or on the
        samples of the binding. None at all is a prior of sides alone.
    binding : LinearBinding, optional
        From the vertices of the models to those of the mesh.
    share, mirror : float

    Raises
    ------
    ValueError, TypeError
        For models of other vertices or without spreads, or numbers beyond 0 to 1.
    """
    share = check_number(share, "share", low=0, high=1)
    mirror = check_number(mirror, "mirror", low=0, high=1)
    found = [np.zeros((0, mesh.n_vertices, 3))]
    for model in models:
        if not isinstance(model, FaceModel):
            raise TypeError(
                f"a model is a {type(model).__name__}; give face models, such as a RegionModel."
            )
        shapes = _shapes(model, mesh, binding)
        found.append(shapes / np.sqrt(len(models) * (shapes**2).sum(axis=0).mean()))
    return Prior(np.concatenate(found), share if len(models) else 0.0, mirror)


def _shapes(model, mesh, binding):
    """The modes of a model on the mesh, each as long as the square root of its deviation."""
    n = mesh.n_vertices if binding is None else len(binding.samples)
    if model.n_vertices != n:
        raise ValueError(
            f"a model moves {model.n_vertices} vertices, but {n} are needed: those of the fitted "
            "face, or the samples of binding."
        )
    learned = model.training()
    if learned is None:
        raise ValueError("a model has no variances; give one that was trained on motion.")
    mean, deviation = learned  # about the neutral, from which markers are counted too
    shapes = np.hypot(mean, deviation)[:, None, None] ** 0.5 * model.basis
    if binding is None:
        return shapes
    dense = binding.carry(np.moveaxis(shapes, 1, 0).reshape(n, -1))
    return np.moveaxis(dense.reshape(mesh.n_vertices, -1, 3), 0, 1)


class PriorLayout:
    """The dense motion of a face as a linear function of its markers and of a prior, found once.

    As `MarkerLayout`, which knows no faces; here an axis of a vertex hangs on all axes of the
    markers.

    Parameters
    ----------
    fit : MarkerFit
    prior : Prior

    Attributes
    ----------
    feet : ndarray of int, shape (n_markers,)
        The vertex nearest to each marker.
    smooth : ndarray of shape (3 * n_markers, 3 * n_markers)
        What becomes of the markers' own displacements, x, y, z of a marker side by side.
    own : ndarray of shape (n_markers,)
        Share of a marker's displacement that its own fit does not follow, over the axes.
    """

    def __init__(self, fit, prior):
        self.fit, self.prior = fit, prior
        mesh, preset = fit.mesh, fit.preset
        self.feet = mesh.faces[fit.faces, fit.weights.argmax(axis=1)]
        twin = mirror_twins(mesh)
        size = preset.motion_size**2
        self._shapes = np.sqrt(size * prior.share) * prior.shapes
        both = kernel(mesh, np.append(self.feet, twin[self.feet]), preset.motion_reach)
        here, there = np.hsplit(size * (1 - prior.share) * both, 2)
        self._here = here  # and mirrored, the same seen from either side
        self._there = prior.mirror * (there + here[twin]) / 2
        K = self._between(self.feet)
        own = covariance(K.reshape(len(K), -1))
        self._factor = cho_factor(own + preset.noise**2 * np.eye(len(own)), lower=True)
        self.smooth = cho_solve(self._factor, own).T
        n = len(self.feet)
        blocks = self.smooth.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]
        self._open = np.linalg.inv(np.eye(3) - blocks)
        self.own = 3 / np.trace(self._open, axis1=1, axis2=2)

    def _between(self, vertices):
        """Covariance of some vertices with the markers: shape (3 n, n_markers, 3)."""
        K = np.tensordot(self._shapes[:, vertices], self._shapes[:, self.feet], axes=(0, 0))
        K += self._here[vertices][:, None, :, None] * np.eye(3)[:, None]
        K += self._there[vertices][:, None, :, None] * MIRROR[:, None]
        return K.reshape(-1, len(self.feet), 3)

    def _flat(self, displacements):
        return displacements.reshape(len(displacements), -1)

    def smoothed(self, displacements):
        """What the fitted surface does at the markers: (n_frames, n_markers, 3), mm."""
        return (self._flat(displacements) @ self.smooth.T).reshape(displacements.shape)

    def carrier(self, vertices=slice(None)):
        """A function from displacements of all markers to those of some vertices.

        As that of `MarkerLayout`.
        """
        told = self._shapes[:, vertices].astype(np.float32)
        known = self._shapes[:, self.feet]
        both = mapped(np.hstack([self._here[vertices], self._there[vertices]]))

        def carried(displacements):
            # the forces at the markers; each moves the modes, its surroundings, and its twin's
            pull = cho_solve(self._factor, self._flat(displacements.astype(float)).T).T
            pull = pull.reshape(displacements.shape)
            weights = np.tensordot(pull, known, axes=((1, 2), (1, 2))).astype(np.float32)
            field = both(np.concatenate([pull, pull @ MIRROR], axis=1))
            return field + np.tensordot(weights, told, axes=1)

        return carried

    def filled(self, displacements):
        """Displacements of all markers, those not seen put where the seen ones lead them.

        As that of `MarkerLayout`.
        """
        seen = np.repeat(np.isfinite(displacements[..., 0]), 3, axis=1)
        full = filled(self.smooth, self._flat(displacements)[..., None], seen)
        return full.reshape(displacements.shape)

    def left_out(self, full):
        """How far each marker is from where the others lead it: (n_frames, n_markers, 3), mm."""
        off = full - self.smoothed(full)
        return np.einsum("mxy,fmy->fmx", self._open, off)

    @cached_property
    def near(self):
        """How strongly vertices hang on markers, any axis: shape (n_vertices, n_markers)."""
        n, near = len(self._here), np.empty(self._here.shape)
        for first in range(0, n, 1000):
            K = self._between(np.arange(first, min(first + 1000, n)))
            carry = cho_solve(self._factor, K.reshape(len(K), -1).T).T.reshape(-1, 3, *K.shape[1:])
            near[first : first + 1000] = np.sqrt((carry**2).sum(axis=(1, 3)) / 3)
        return near

    def spread(self):
        """Standard deviation of the field, given the markers, per axis: (n_vertices,), mm."""
        return self._spread

    @cached_property
    def _spread(self):
        n, left = len(self._here), np.empty(len(self._here))
        smooth = self.fit.preset.motion_size**2 * (1 - self.prior.share)
        # near the midline a place is its own twin, or nearly; how far, a straight line tells
        V, reach = self.fit.mesh.vertices, self.fit.preset.motion_reach
        apart = np.linalg.norm(V - V[mirror_twins(self.fit.mesh)], axis=1)
        twin = self.prior.mirror * (SHIFT + np.exp(-apart / reach))[:, None] * np.diag(MIRROR)
        for first in range(0, n, 1000):
            some = np.arange(first, min(first + 1000, n))
            K = self._between(some)
            told = solve_triangular(self._factor[0], K.reshape(len(K), -1).T, lower=True)
            known = (told**2).sum(axis=0).reshape(-1, 3)
            before = (self._shapes[:, some] ** 2).sum(axis=0) + smooth * (1 + SHIFT + twin[some])
            left[some] = np.maximum(before - known, 0).mean(axis=1)
        return np.sqrt(left)
