"""The mesh in the layout, made once per density on the average face: even triangles there."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import RectBivariateSpline

from data_synth.anatomy import Anatomy
from data_synth.template import features, plane
from data_synth.template.lines import Lines, border_line, edge_length
from data_synth.template.parts import loop_landmarks
from data_synth.template.surface import Surface, kernel_basis
from facelab.keeping import keep_arrays, source_stamp
from facelab.numeric.threads import single_threaded

_RELAX = 16  # rounds
_GRID = 0.7  # layout mm between candidates
_SEPARATION = 0.22  # layout mm count this much in distances, so that touching lips stay apart


class _Sheet:
    """The average surface as bicubic splines over a grid of the layout, quick to evaluate.

    Meshing asks for some hundred thousand places; it needs them to a few hundredths of a
    millimetre only.
    """

    def __init__(self):
        u, v = np.arange(-4.0, 152.0), np.arange(-142.0, 68.0)
        places = np.stack(np.meshgrid(np.abs(u), v, indexing="ij"), -1).reshape(-1, 2)
        points = np.zeros((len(places), 3))
        near = plane.inside(places, 1.1 * border_line())  # some room around, for the splines
        points[near] = Surface(Anatomy())(places[near])
        grid = points.reshape(len(u), len(v), 3)
        grid[u < 0.0, :, 0] *= -1.0
        self._splines = [RectBivariateSpline(u, v, grid[..., k]) for k in range(3)]

    def __call__(self, places, du=0, dv=0):
        """Points in space, or their derivatives by the layout's coordinates, (n, 3) mm."""
        u, v = places.T
        return np.stack([s.ev(u, v, dx=du, dy=dv) for s in self._splines], -1)

    def apart(self, places):
        """Coordinates in which distances between mesh points are taken, (n, 5)."""
        return np.column_stack([self(places), _SEPARATION * places])


@dataclass(frozen=True)
class Layout:
    """One density: the left half in the layout, and who lies where.

    Attributes
    ----------
    places : ndarray of shape (n, 2)
    faces : ndarray of shape (n_faces, 3)
    lines : dict of str to ndarray of int
        Vertices along loops, midline and border, in their order.
    landmarks : dict of int to int
        Vertex of each landmark of the left half, by its number.
    basis : tuple of ndarray
        Kernel values, so that building a face is a matrix product.
    """

    places: np.ndarray
    faces: np.ndarray
    lines: dict
    landmarks: dict
    basis: tuple


def _candidates(sheet, n_vertices):
    """Places where a vertex may be, their wanted edge length as a share, and the largest in mm."""
    rng = np.random.default_rng(0)
    theta = np.linspace(0.0, np.pi, 200)
    mouth = np.vstack([features.mouth_layout("roll", theta), [[-1.0, features.MOUTH_V]]])
    eye = features.eye_layout("tuck", 2.0 * theta[:-1])
    grid = np.stack(np.meshgrid(np.arange(0.35, 150.0, _GRID), np.arange(-140.0, 65.0, _GRID)), -1)
    grid = grid.reshape(-1, 2) + rng.uniform(-0.3, 0.3, (grid.size // 2, 2))
    inside, *openings = (plane.inside(grid, line) for line in (border_line(), mouth, eye))
    grid = grid[inside & ~np.any(openings, axis=0)]
    size = edge_length(grid)
    # area element of the map, to know how many points a given edge length needs
    area = np.linalg.norm(np.cross(sheet(grid, du=1), sheet(grid, dv=1)), axis=1)
    h = np.sqrt((area / size**2).sum() * 0.49 / (0.866 * 0.5 * n_vertices))
    # drawn by density, so that steep places get their share
    keep = rng.random(len(grid)) < np.minimum(1.0, 9.0 * area / (size * h) ** 2 * 0.49)
    return grid[keep], size[keep], h


@lru_cache(maxsize=8)
@single_threaded  # the last digit of a sum depends on their number, and the mesh on that digit
def layout_mesh(n_vertices):
    """Even triangles over the left half for n_vertices in all, made once and kept: Layout."""
    key = {"code": source_stamp(__name__), "n_vertices": n_vertices}
    kept = keep_arrays(f"layouts/{n_vertices}", key, lambda: _laid_out(n_vertices))
    lines = {name[6:]: line for name, line in kept.items() if name.startswith("lines.")}
    landmarks = dict(kept["landmarks"].tolist())
    return Layout(kept["places"], kept["faces"], lines, landmarks, kernel_basis(kept["places"]))


def _laid_out(n_vertices):
    """All of a `Layout` but its basis, as arrays."""
    sheet = _Sheet()
    grid, size, h = _candidates(sheet, n_vertices)
    lines = Lines(sheet, h, n_vertices)
    clear = ~plane.encroaches(grid, lines.all)
    # no room for more where lips and lids meet
    canthus = features.EYE_CENTRE_U + features.EYE_LATERAL - 2.6
    for corner in ([26.4, features.MOUTH_V], [canthus, 0.0]):
        clear &= np.linalg.norm(grid - corner, axis=1) > 1.6
    grid, size = grid[clear], size[clear]
    taken, n_free = sheet.apart(lines.places), lines.n_half - len(lines.places)
    chosen = plane.choose_spread(sheet.apart(grid), 0.8 * h * size, taken, n_free)
    places = np.vstack([lines.places, grid[chosen]])
    kept = lines.edge_keys(len(places))
    ghosts = plane.ghosts_beside(lines.rims, lines.outer)
    faces = plane.triangulate(places, lines.outline, lines.holes, ghosts)
    faces = plane.recover_edges(faces, kept, len(places))
    free = np.arange(len(places)) >= len(lines.places)
    wanted = edge_length(places)
    for k in range(_RELAX):
        points = sheet(places)
        faces = plane.flip_edges(points, places, faces, kept, rounds=12 if k == 0 else 4)
        places = plane.relax(points, places, faces, free, wanted)
    faces = plane.flip_edges(sheet(places), places, faces, kept, rounds=20)
    spots = [number for number, place in lines.marks.items() if place[0] > 0.0]
    landmarks = dict(zip(spots, lines.index["marks"], strict=True)) | loop_landmarks(lines, sheet)
    named = {f"lines.{name}": line for name, line in lines.ordered.items()}
    return dict(places=places, faces=faces, landmarks=list(landmarks.items()), **named)
