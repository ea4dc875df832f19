"""The fair surface: the smoothest map from the layout to space through a face's named points.

Radial basis functions r**3, which minimise bending; mirrored, so that symmetry is exact.
"""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import lu_factor, lu_solve

from data_synth.anatomy import Anatomy
from data_synth.template import features, skin
from data_synth.template.plane import arc_length


def _between(named):
    """Points on a smooth curve between named ones: layout places and points in space."""
    points, places = (np.array([row[k] for row in named], dtype=float) for k in (1, 2))
    t = arc_length(places)  # of the layout, so that it is the same for every anatomy
    at = np.concatenate([a + (b - a) * np.array([0.25, 0.5, 0.75]) for a, b in pairwise(t)])
    return tuple(CubicSpline(t, rows, bc_type="natural")(at) for rows in (places, points))


def _loops(anatomy):
    """Points on the loops of mouth, nostrils and eyes: (group, loop, place, point, stiffness)."""

    def around(n):
        return 2.0 * np.pi * np.arange(n) / n

    f = features
    for group, loops, layout, points, theta, give in (
        ("mouth", f.MOUTH_LOOPS, f.mouth_layout, f.mouth_points, np.linspace(0, np.pi, 41), 0.0),
        ("nostril", f.NOSTRIL_LOOPS, f.nostril_layout, f.nostril_points, around(16), 0.5),
        ("eye", f.EYE_LOOPS, f.eye_layout, f.eye_points, around(56), 0.0),
    ):
        for loop in loops:
            for place, point in zip(layout(loop, theta), points(anatomy, loop, theta), strict=True):
                below = loop == "crease" and place[1] < 0.0
                yield group, loop, place, point, 25.0 if below else give


def control_points(anatomy):
    """Named points through which the surface passes.

    Parameters
    ----------
    anatomy : Anatomy

    Returns
    -------
    names : list of str, length n
        `group.name`; several points of one loop share a name.
    places : ndarray of shape (n, 2)
        Where they lie in the layout; the same for every anatomy.
    points : ndarray of shape (n, 3)
        Where they lie in space, millimetres; midline and left side only.
    stiffness : ndarray of shape (n,)
        0 where the surface must pass, more where it may pass nearby.
    """
    mean = skin.midline_points(Anatomy())
    rows = [
        ("midline", name, (0.0, skin.MIDLINE_V.get(name, mean[name][0])), (0.0, y, z), 2.0)
        for name, (y, z) in skin.midline_points(anatomy).items()
    ]
    own = zip(skin.SKIN_POINTS, skin.skin_layout(), skin.skin_points(anatomy), strict=True)
    rows += [("skin", name, place, point, 700.0) for name, place, point in own]
    rows += [
        ("nose", name, place, point, 1.0) for name, point, place in features.nose_points(anatomy)
    ]
    orbit = features.orbit_points(anatomy)
    rows += [("orbit", name, place, point, 60.0) for name, point, place in orbit]
    for line in ("brow_", "orbit_roof", "lower_sulcus"):
        own = [row for row in orbit if row[0].startswith(line)]
        name = line.rstrip("_") + "_line"
        rows += [("orbit", name, *both, 60.0) for both in zip(*_between(own), strict=True)]
    rows += _loops(anatomy)
    groups, names, *arrays = zip(*rows, strict=True)
    names = [f"{group}.{name}" for group, name in zip(groups, names, strict=True)]
    return names, *map(np.array, arrays)


def _kernel(p, q):
    """r**3 between two sets of layout places."""
    r2 = (p[:, 0, None] - q[:, 0]) ** 2 + (p[:, 1, None] - q[:, 1]) ** 2
    return r2 * np.sqrt(r2)


@lru_cache(maxsize=1)
def _layout_system():
    """Factored interpolation systems of the control places: even (y, z) and odd (x) parts."""
    _, places, _, stiffness = control_points(Anatomy())
    mirrored = places * [-1.0, 1.0]
    off = places[:, 0] > 0.0
    direct, across = _kernel(places, places), _kernel(places, mirrored)
    n = len(places)
    even = np.zeros((n + 2, n + 2))
    even[:n, :n] = direct + across + np.diag(stiffness)
    even[:n, n] = even[n, :n] = 1.0
    even[:n, n + 1] = even[n + 1, :n] = places[:, 1]
    m = off.sum()
    odd = np.zeros((m + 1, m + 1))
    odd[:m, :m] = (direct - across)[np.ix_(off, off)] + np.diag(stiffness[off])
    odd[:m, m] = odd[m, :m] = places[off, 0]
    return places, off, lu_factor(even), lu_factor(odd)


class Surface:
    """Map from the layout to space for one anatomy; exactly symmetric about x = 0."""

    def __init__(self, anatomy):
        self.anatomy = anatomy
        self.places, self.off, even, odd = _layout_system()
        points = control_points(anatomy)[2]
        self.even = lu_solve(even, np.vstack([points[:, 1:], np.zeros((2, 2))]))
        self.odd = lu_solve(odd, np.append(points[self.off, 0], 0.0))

    def __call__(self, places, basis=None):
        """Points in space, (n, 3) mm, of layout places (n, 2) on the left half."""
        if basis is None:  # small pieces stay in the processor's cache
            cut = range(0, len(places), 500)
            points = np.vstack([self._smooth(places[i : i + 500]) for i in cut])
        else:
            points = self._smooth(places, basis)
        return points + skin.fold_depths(self.anatomy, places)

    def _smooth(self, places, basis=None):
        direct, across = basis if basis is not None else kernel_basis(places)
        n = len(self.places)
        y_z = (direct + across) @ self.even[:n] + self.even[n] + places[:, 1:] * self.even[n + 1]
        x = (direct - across)[:, self.off] @ self.odd[:-1] + places[:, 0] * self.odd[-1]
        return np.column_stack([np.where(places[:, 0] == 0.0, 0.0, x), y_z])


def kernel_basis(places):
    """Kernel values of layout places against the control places and their mirror images."""
    centres = _layout_system()[0]
    return _kernel(places, centres), _kernel(places, centres * [-1.0, 1.0])
