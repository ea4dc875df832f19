"""A picture on a mesh."""

from dataclasses import dataclass

import numpy as np

from facelab.checks import as_finite


@dataclass(frozen=True, eq=False)
class Texture:
    """The base colours of a mesh: a picture, and where each corner of each triangle lies in it.

    Places are kept by corner, so that one vertex of a closed seam may lie on both its sides.

    Parameters
    ----------
    image : ndarray of uint8, shape (height, width, 3)
        sRGB.
    uv : ndarray of shape (n_faces, 3, 2)
        To the right and down from the upper left corner, 0 to 1; beyond, the picture is repeated.
        NaN for triangles that have no picture.

    Raises
    ------
    ValueError
        For another shape or type.

    Examples
    --------
    >>> import numpy as np
    >>> halves = np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8)
    >>> texture = Texture(halves, [[[0.1, 0.5], [0.4, 0.5], [0.9, 0.5]]])
    >>> texture.at_vertices(np.array([[0, 1, 2]]), 3, fill=(1, 1, 1)).tolist()
    [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """

    image: np.ndarray
    uv: np.ndarray

    def __post_init__(self):
        image = np.asarray(self.image)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or not image.size:
            raise ValueError(
                f"image has shape {image.shape} and type {image.dtype}, but needs (height, width, "
                "3) and uint8."
            )
        uv = np.asarray(self.uv, dtype=np.float32)
        as_finite(np.where(np.isnan(uv), 0, uv), "uv", ("n_faces", 3, 2))
        for name, array in (("image", image), ("uv", uv)):
            array = array.copy()
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self):
        height, width = self.image.shape[:2]
        return f"Texture({width} x {height} pixels on {len(self.uv)} faces)"

    @property
    def painted(self):
        """Faces that have a picture: bool (n_faces,)."""
        return ~np.isnan(self.uv).any(axis=(1, 2))

    def on(self, faces):
        """The texture of some of the faces, by their indices or a mask."""
        return Texture(self.image, self.uv[faces])

    def at_vertices(self, faces, n_vertices, fill):
        """Colours of the vertices, the mean of those of their corners.

        Parameters
        ----------
        faces : ndarray of int, shape (n_faces, 3)
        n_vertices : int
        fill : array_like of shape (3,)
            Of vertices that have no picture.

        Returns
        -------
        ndarray of shape (n_vertices, 3)
            0 to 1.
        """
        height, width = self.image.shape[:2]
        on = self.painted
        uv, corners = self.uv[on].reshape(-1, 2) % 1.0, np.asarray(faces)[on].ravel()
        column = np.minimum((uv[:, 0] * width).astype(int), width - 1)
        row = np.minimum((uv[:, 1] * height).astype(int), height - 1)
        colors = self.image[row, column] / 255
        count = np.bincount(corners, minlength=n_vertices)
        mean = (
            np.stack([np.bincount(corners, c, minlength=n_vertices) for c in colors.T], axis=1)
            / np.maximum(count, 1)[:, None]
        )
        return np.where(count[:, None] > 0, mean, np.asarray(fill, dtype=float))
