"""How open the skin is to the light from all around: nostrils and the inside of a mouth are not."""

from weakref import WeakKeyDictionary

import numpy as np
import scipy.sparse as sp
from matplotlib.colors import to_rgb

from facelab.looks.raster import rasterise

_DIRECTIONS, _PIXELS = 32, 110
_BIAS = 1.6  # pixels: a surface does not shade itself
_DARKEST = np.array([0.30, 0.20, 0.19])  # share of its colour that skin keeps where no light comes
_LID = 0.9
_made = WeakKeyDictionary()


def openness(mesh):
    """Share of the light from all around that reaches each vertex, shape (n_vertices,), 0 to 1.

    Found by looking at the mesh at rest from 32 directions, and kept with it. The same each
    time.

    Parameters
    ----------
    mesh : TriangleMesh

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> light = openness(face)
    >>> inner, brow = (face.landmarks[n] for n in ("mouth_inner_upper", "brow_left_3"))
    >>> bool(light[inner] < 0.7 * light[brow])
    True
    """
    if mesh not in _made:
        _made[mesh] = _smoothed(mesh, _looked_at(mesh))
    return _made[mesh]


def skin_colors(mesh, color, props=()):
    """A colour of skin for each vertex, darker and redder where little light comes: (n, 3).

    Parameters
    ----------
    mesh : TriangleMesh
    color : str
    props : iterable of Prop
        Around their eyes less: a lid that is folded at rest comes to light as it closes.
    """
    light = openness(mesh)[:, None]
    for prop in props:
        lids = getattr(prop, "lids", None)
        if lids is not None:
            away = np.linalg.norm(mesh.vertices - lids.centre, axis=1) / lids.radius
            t = ((2.6 - away) / 1.0).clip(0, 1)[:, None]
            light = np.maximum(light, _LID * t * t * (3 - 2 * t))
    return np.array(to_rgb(color)) * (_DARKEST + (1 - _DARKEST) * light)


def _looked_at(mesh):
    V, N = mesh.vertices - mesh.vertices.mean(axis=0), mesh.normals
    k = np.arange(_DIRECTIONS) + 0.5  # Fibonacci's lattice: evenly over the sphere
    turn, up = np.pi * (1 + 5**0.5) * k, 1 - 2 * k / _DIRECTIONS
    flat = np.sqrt(1 - up**2)
    seen, all_light = np.zeros(len(V)), np.zeros(len(V))
    for ahead in np.stack([flat * np.cos(turn), up, flat * np.sin(turn)], axis=1):
        right = np.cross([0.0, 1, 0], ahead)
        right /= np.linalg.norm(right)
        at = V @ np.stack([right, np.cross(ahead, right), ahead]).T
        low, high = at[:, :2].min(axis=0), at[:, :2].max(axis=0)
        scale = _PIXELS / (high - low).max()
        spot = (at[:, :2] - low) * scale
        size = np.ceil(spot.max(axis=0)).astype(int) + 1
        depth = at[mesh.faces, 2]
        face, weights = rasterise(spot[mesh.faces], depth, *size)
        light = np.clip(N @ ahead, 0, None)
        x, y = spot.astype(int).T
        face = face[y, x]
        nearest = np.einsum("nc,nc->n", weights[y, x], depth[face])
        nearest[face < 0] = -np.inf
        # seen aslant, a pixel spans more depth
        bias = _BIAS / scale / np.maximum(light, 0.25)
        seen += light * (at[:, 2] > nearest - bias)
        all_light += light
    return seen / np.maximum(all_light, 1e-9)


def _smoothed(mesh, values, rounds=2):
    a, b = mesh.edges.T
    n = mesh.n_vertices
    A = sp.coo_array((np.ones(2 * len(a)), (np.r_[a, b], np.r_[b, a])), shape=(n, n)).tocsr()
    degree = np.maximum(A.sum(axis=1), 1)
    for _ in range(rounds):
        values = 0.5 * values + 0.5 * (A @ values) / degree
    return values
