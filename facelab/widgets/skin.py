"""A face with its texture, in the buffers of the face without: the doubles at seams are riders."""

import numpy as np
import pythreejs as three
from PIL import Image

_MOST = 1024  # pixels along a side, in the page


def seam_doubles(mesh):
    """The vertices that a texture needs twice or more, where its seams run.

    Returns
    -------
    doubles : ndarray of int, shape (n_doubles,)
        Vertex of the mesh of each further one; none for a mesh without texture.
    faces : ndarray of int, shape (n_painted, 3)
        Triangles that have a picture; vertices from `mesh.n_vertices` on are doubles.
    uv : ndarray of shape (n_vertices + n_doubles, 2)
        Place of each in the picture.
    """
    n = mesh.n_vertices
    uv = np.zeros((n, 2))
    if mesh.texture is None or not mesh.texture.painted.any():
        return np.empty(0, int), np.empty((0, 3), int), uv
    on = mesh.texture.painted
    corners = np.column_stack([mesh.faces[on].ravel(), mesh.texture.uv[on].reshape(-1, 2)])
    places, inverse = np.unique(corners, axis=0, return_inverse=True)
    vertex = places[:, 0].astype(int)
    first = np.append(True, vertex[1:] != vertex[:-1])
    number = np.where(first, vertex, n + np.cumsum(~first) - 1)
    uv[vertex[first]] = places[first, 1:]
    uv = np.vstack([uv, places[~first, 1:]])
    return vertex[~first], number[inverse.ravel()].reshape(-1, 3), uv


def picture_of(texture):
    """The picture for the page, its sides powers of two so that it can be repeated."""
    height, width = texture.image.shape[:2]
    sides = [min(_MOST, 1 << (n - 1).bit_length()) for n in (width, height)]
    image = np.asarray(Image.fromarray(texture.image).resize(sides))
    return three.DataTexture(
        data=np.dstack([image, np.full(image.shape[:2], 255, np.uint8)]),
        format="RGBAFormat",
        type="UnsignedByteType",
        wrapS="RepeatWrapping",
        wrapT="RepeatWrapping",
        magFilter="LinearFilter",
        minFilter="LinearMipMapLinearFilter",
        generateMipmaps=True,
    )
