"""A face from an anatomy: the mesh of a density laid over the surface, both sides."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from data_synth.anatomy import Anatomy
from data_synth.template.features import eyeball_centre
from data_synth.template.layout import layout_mesh
from data_synth.template.parts import LANDMARK_TWINS, named_curves, named_regions
from data_synth.template.surface import Surface
from facelab.numeric.threads import single_threaded


@dataclass(frozen=True)
class Template:
    """A face mesh with its anatomy written on it.

    Attributes
    ----------
    vertices : ndarray of shape (n_vertices, 3)
        Millimetres; x to the person's left, y up, z forward; the origin is midway between
        the centres of the eyeballs.
    faces : ndarray of shape (n_faces, 3), int
        Counter-clockwise seen from outside; the same for every anatomy.
    landmarks : ndarray of shape (68,), int
        Vertices of the 68 landmarks in Multi-PIE order.
    regions : dict of str to ndarray of int
        Vertices of each named part.  The parts cover the face without overlap.
    mirror : ndarray of shape (n_vertices,), int
        Each vertex's twin on the other side; itself on the midline.
    eyeballs : dict of str to (ndarray of shape (3,), float)
        Centre and radius, millimetres, for "left" and "right".
    jaw_axis : tuple of two ndarrays of shape (3,)
        A point on the hinge between the condyles, and its direction (to the left).
    curves : dict of str to ndarray of int
        Ordered vertices along lids, lips, midline and the outer border.
    anatomy : Anatomy
        What the face was built from.
    """

    vertices: np.ndarray
    faces: np.ndarray
    landmarks: np.ndarray
    regions: dict
    mirror: np.ndarray
    eyeballs: dict
    jaw_axis: tuple
    curves: dict
    anatomy: Anatomy


@lru_cache(maxsize=8)
def _topology(n_vertices):
    """All that depends on the density alone: faces, landmarks, regions, mirror, curves."""
    layout = layout_mesh(n_vertices)
    off = layout.places[:, 0] > 0.0
    n_half = len(off)
    right_of = np.arange(n_half)
    right_of[off] = n_half + np.arange(off.sum())
    mirror = np.concatenate([right_of, np.flatnonzero(off)])
    faces = np.vstack([layout.faces, right_of[layout.faces[:, ::-1]]])
    landmarks = np.empty(68, dtype=int)
    for number, vertex in layout.landmarks.items():
        landmarks[number] = vertex
        landmarks[LANDMARK_TWINS[number]] = right_of[vertex]
    regions, curves = (part(layout, right_of) for part in (named_regions, named_curves))
    return faces, landmarks, regions, mirror, curves


@single_threaded
def build_template(anatomy=None, n_vertices=8820):
    """Build the face of one anatomy.

    Parameters
    ----------
    anatomy : Anatomy, optional
        Measurements of the face; an average adult by default.
    n_vertices : int, default=8820
        Number of vertices, met exactly.  8820 is the dense template, 4375 the sparse one.

    Returns
    -------
    Template
        Faces built with equal `n_vertices` correspond vertex by vertex, whatever their
        anatomy.  The mesh of a density is made once (about three seconds) and kept in the cache.

    Raises
    ------
    TypeError
        If `anatomy` is no `Anatomy` or `n_vertices` no integer.
    ValueError
        If `n_vertices` is below 1500 (lids and lips would lose their loops) or above 40000.

    Examples
    --------
    >>> face = build_template(Anatomy(nose_width=38.0))
    >>> face.vertices.shape
    (8820, 3)
    """
    anatomy = Anatomy() if anatomy is None else anatomy
    if not isinstance(anatomy, Anatomy):
        raise TypeError(f"anatomy must be an Anatomy or None, got {type(anatomy).__name__}")
    if isinstance(n_vertices, bool) or not isinstance(n_vertices, (int, np.integer)):
        raise TypeError(f"n_vertices must be an integer, got {n_vertices!r}")
    if not 1500 <= n_vertices <= 40000:
        raise ValueError(
            f"n_vertices={n_vertices} is outside [1500, 40000]; use 4375 or 8820, or another "
            "number in that range"
        )
    layout = layout_mesh(int(n_vertices))
    faces, landmarks, regions, mirror, curves = _topology(int(n_vertices))
    half = Surface(anatomy)(layout.places, layout.basis)
    right = half[layout.places[:, 0] > 0.0] * [-1.0, 1.0, 1.0]
    centre = eyeball_centre(anatomy)
    radius = float(anatomy.eyeball_radius)
    return Template(
        vertices=np.vstack([half, right]),
        faces=faces.copy(),
        landmarks=landmarks.copy(),
        regions={k: v.copy() for k, v in regions.items()},
        mirror=mirror.copy(),
        eyeballs={"left": (centre, radius), "right": (centre * [-1.0, 1.0, 1.0], radius)},
        # the condyles sit before the ear openings, a little below the eyes
        jaw_axis=(np.array([0.0, -12.0, -anatomy.face_depth - 12.0]), np.array([1.0, 0.0, 0.0])),
        curves={k: v.copy() for k, v in curves.items()},
        anatomy=anatomy,
    )
