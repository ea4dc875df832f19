"""The lines that every mesh keeps to: loops round the openings, midline, border; and landmarks.

They are laid on the average face, in even steps there, and never move again.
"""

from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from data_synth.anatomy import Anatomy
from data_synth.template.features import (
    MOUTH_V,
    NOSTRIL_CENTRE,
    eye_layout,
    mouth_layout,
    nostril_layout,
)
from data_synth.template.plane import arc_length
from data_synth.template.surface import control_points

_BORDER = ("trichion_lateral", "hairline_upper", "hairline_corner", "hairline_temple",
           "temple_hairline_1", "temple_hairline_2", "temple_hairline_3", "sideburn_1",
           "sideburn_2", "sideburn_3", "ramus_upper", "ramus_lower", "gonion_under",
           "underside_4", "underside_3", "underside_2", "underside_1")  # fmt: skip


def _named_places():
    """Layout place of every single named control point."""
    names, places, _, _ = control_points(Anatomy())
    return dict(zip(names, places, strict=True))


def border_line():
    """The outer edge of the left half in the layout, top to bottom, (n, 2)."""
    named = _named_places()
    knots = [named["midline.trichion"], *(named[f"skin.{k}"] for k in _BORDER)]
    knots = np.array([*knots, named["midline.cervicale"]])
    chord = arc_length(knots)
    # level where it meets the midline, so that the mirrored halves join smoothly
    spline = CubicSpline(chord, knots, bc_type=((1, (1.0, 0.0)), (1, (-1.0, 0.0))))
    line = spline(np.linspace(0.0, chord[-1], 400))
    line[[0, -1], 0] = 0.0
    return line


def landmark_places():
    """Layout places of the landmarks of the left half that lie on no loop: number -> (u, v)."""
    named = _named_places()

    def between(a, b, t=0.5):
        return (1 - t) * named[a] + t * named[b]

    def mid(name):
        return named[f"midline.{name}"]

    return {
        8: mid("menton"),
        9: named["skin.menton_lateral"],
        10: named["skin.jaw_border_1"],
        11: named["skin.jaw_border_2"],
        12: named["skin.jaw_border_3"] * [1.06, 0.98],
        13: between("skin.gonion", "skin.masseter", 0.25),
        14: between("skin.masseter", "skin.ramus_upper"),
        15: between("skin.cheek_back", "skin.sideburn_3"),
        16: between("skin.zygion", "skin.sideburn_1", 0.55),
        22: named["orbit.brow_medial"],
        23: between("orbit.brow_medial", "orbit.brow_middle", 0.75) + np.array([0.0, 0.8]),
        24: between("orbit.brow_middle", "orbit.brow_peak", 0.45) + np.array([0.0, 0.6]),
        25: between("orbit.brow_peak", "orbit.brow_tail", 0.2) + np.array([0.0, 0.6]),
        26: named["orbit.brow_tail"],
        27: mid("nasion"),
        28: mid("rhinion") * 0.4 + mid("nasion") * 0.6,
        29: mid("rhinion") * 0.6 + mid("supratip") * 0.4,
        30: mid("pronasale"),
        33: mid("subnasale"),
        34: named["nose.columella_base"],
        35: np.array([13.8, -46.7]),
    }


# --- even steps -----------------------------------------------------------------------------------


def edge_length(places):
    """Wanted edge length in the mesh as a share of its largest; finer at eyes, mouth, nostrils."""
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    eye, _ = cKDTree(eye_layout("margin", theta)).query(places)
    mouth, _ = cKDTree(mouth_layout("contact", 0.5 * theta)).query(places)
    nostril = np.hypot(*(places - NOSTRIL_CENTRE).T) - 6.5
    size = np.minimum(0.50 + 0.026 * np.maximum(eye - 4.0, 0.0),
                      0.50 + 0.026 * np.maximum(mouth - 5.0, 0.0))  # fmt: skip
    return np.minimum(np.minimum(size, 0.52 + 0.026 * np.maximum(nostril, 0.0)), 1.0)


def _steps(surface, line, h):
    """Length on the face of each piece of a dense layout line, in steps of h * `edge_length`."""
    length = np.linalg.norm(np.diff(surface(line), axis=0), axis=1)
    return length / (h * edge_length(0.5 * (line[1:] + line[:-1])))


def _even_stations(surface, line, h, count=None):
    """Resample a dense layout line at even steps on the face."""
    length = np.append(0.0, np.cumsum(_steps(surface, line, h)))
    n = count or max(round(length[-1]), 2)
    t = np.interp(np.linspace(0.0, length[-1], n + 1), length, np.arange(len(line)))
    return np.column_stack([np.interp(t, np.arange(len(line)), c) for c in line.T])


def _midline_stations(surface, top, bottom, h, pins):
    """Even stations down a piece of the midline that pass through the pinned heights."""
    pins = [v for v in pins if bottom < v < top and abs(v - top) > 1e-6 and abs(v - bottom) > 1e-6]
    out = [[[0.0, top]]]
    for high, low in pairwise([top, *sorted(pins, reverse=True), bottom]):
        piece = np.column_stack([np.zeros(120), np.linspace(high, low, 120)])
        n = max(round(_steps(surface, piece, h).sum()), 1)
        out.append(_even_stations(surface, piece, h, n)[1:])
    stations = np.vstack(out)
    stations[:, 0] = 0.0
    return stations


def _even_angles(surface, layout, loop, h, stops):
    """Angles at which a loop is cut into even steps on the face, each stop among them."""
    arcs = []
    for start, stop in pairwise(stops):
        theta = np.linspace(start, stop, 500)
        length = np.append(0.0, np.cumsum(_steps(surface, layout(loop, theta), h)))
        even = np.linspace(0.0, length[-1], round(length[-1]) + 1)
        arcs.append(np.interp(even, length, theta))
    return np.concatenate([*(arc[:-1] for arc in arcs), arcs[-1][-1:]])


def _rim_loops(surface, h):
    """Fixed loops of the left half: dict of (n, 2) layout places; those of one opening are
    cut at the same angles, so that their vertices face each other."""
    loops = {}
    theta = _even_angles(surface, eye_layout, "margin", h, (0.0, np.pi, 2.0 * np.pi))[:-1]
    # equally many on both lids, so that the curves of the two end at the canthi
    n = np.searchsorted(theta, np.pi + 1e-9)
    if len(theta) != 2 * (n - 1):
        low = 2.0 * np.pi - theta[:n]
        theta = np.concatenate([theta[:n], low[-2:0:-1]])
    for name in ("margin", "back_edge", "tuck"):
        loops[f"eye.{name}"] = eye_layout(name, theta)
    theta = _even_angles(surface, nostril_layout, "rim", h, (2.0 * np.pi, 0.0))[:-1]
    for name in ("lip", "rim", "wall"):
        loops[f"nostril.{name}"] = nostril_layout(name, theta)
    theta = _even_angles(surface, mouth_layout, "contact", h, (0.0, 0.5 * np.pi))
    theta = np.concatenate([theta, np.pi - theta[-2::-1]])
    for name in ("contact", "roll", "vermilion", "border"):
        loops[f"mouth.{name}"] = mouth_layout(name, theta)
        loops[f"mouth.{name}"][[0, -1], 0] = 0.0
    return loops


# --- all of them ----------------------------------------------------------------------------------


def _closed(line):
    return np.vstack([line, line[:1]])


class Lines:
    """The fixed points of one density's left half.

    Parameters
    ----------
    surface : callable
        Layout places (n, 2) to points of the average face (n, 3), millimetres.
    h : float
        Largest edge, millimetres.
    n_vertices : int
        Of the whole face.

    Attributes
    ----------
    upper, lower, border : ndarray of shape (n, 2)
        Stations of the midline above and below the mouth, and of the outer edge between them.
    loops : dict of str to ndarray of shape (n, 2)
    marks : dict of int to ndarray of shape (2,)
        Landmarks that lie on no loop.
    places : ndarray of shape (n, 2)
        All points; those on the midline come first.
    index : dict of str to ndarray of int
        Where each line's points are among `places`; those of loops of the mouth without their
        ends, which are on the midline.
    n_half : int
        Vertices of the left half, midline included.
    """

    def __init__(self, surface, h, n_vertices):
        self.loops, self.marks = _rim_loops(surface, h), landmark_places()
        border, roll = border_line(), self.loops["mouth.roll"]
        pins = [line[i, 1] for k, line in self.loops.items() if "mouth" in k for i in (0, -1)]
        pins += [v for (u, v) in self.marks.values() if u == 0.0]
        upper = _midline_stations(surface, border[0, 1], roll[0, 1], h, pins)
        self.lower = _midline_stations(surface, roll[-1, 1], border[-1, 1], h, pins)
        if (n_vertices - len(upper) - len(self.lower)) % 2:  # the halves need an even rest
            i = int(np.argmax(-np.diff(upper[:, 1]) / edge_length(upper[:-1])))
            upper = np.insert(upper, i + 1, 0.5 * (upper[i] + upper[i + 1]), axis=0)
        self.upper = upper
        self.border = _even_stations(surface, border, h)[1:-1]
        n_mid = len(upper) + len(self.lower)
        self.n_half = (n_vertices - n_mid) // 2 + n_mid
        groups = {"upper_mid": upper, "lower_mid": self.lower, "border": self.border}
        groups |= {k: v for k, v in self.loops.items() if not k.startswith("mouth")}
        groups |= {k: v[1:-1] for k, v in self.loops.items() if k.startswith("mouth")}
        groups["marks"] = np.array([place for place in self.marks.values() if place[0] > 0.0])
        self.places = np.vstack(list(groups.values()))
        ends = np.cumsum([len(line) for line in groups.values()])
        self.index = {
            name: np.arange(end - len(line), end)
            for (name, line), end in zip(groups.items(), ends, strict=True)
        }

    @property
    def outer(self):
        """The outer edge from the lower end of the midline to the upper, (n, 2)."""
        return self.rims[2]

    @cached_property
    def rims(self):
        """Boundary lines of the left half, the domain on their left: list of (n, 2)."""
        outer = np.vstack([self.lower[-1:], self.border[::-1], self.upper[:1]])
        lid = _closed(self.loops["eye.tuck"])[::-1]
        return [self.upper, self.lower, outer, self.loops["mouth.roll"], lid]

    @property
    def all(self):
        """Every line whose edges must be edges of the mesh: list of (n, 2)."""
        mouth = [v for k, v in self.loops.items() if k.startswith("mouth")]
        return [
            *self.rims,
            *mouth,
            *(_closed(v) for k, v in self.loops.items() if not k.startswith("mouth")),
        ]

    @property
    def outline(self):
        """The domain as a polygon, openings not counted, (n, 2)."""
        return np.vstack([self.upper[:1], self.border, self.lower[-1:], [[0.0, 0.0]]])

    @property
    def holes(self):
        """Mouth and eye as polygons, (n, 2) each."""
        return [np.vstack([self.loops["mouth.roll"], [[-1.0, MOUTH_V]]]), self.loops["eye.tuck"]]

    @cached_property
    def midline(self):
        """Indices down the whole midline, the mouth's gap in it."""
        return np.concatenate([self.index["upper_mid"], self.index["lower_mid"]])

    @cached_property
    def ordered(self):
        """Indices along each line from end to end, loops of the mouth with their two ends."""
        ordered = {k: self.index[k] for k in self.loops if not k.startswith("mouth")}
        heights = self.places[self.midline, 1]
        for k, line in self.loops.items():
            if k.startswith("mouth"):
                ends = [self.midline[np.argmin(np.abs(heights - line[i, 1]))] for i in (0, -1)]
                ordered[k] = np.concatenate([ends[:1], self.index[k], ends[1:]])
        upper, lower = self.index["upper_mid"], self.index["lower_mid"]
        ordered["border"] = np.concatenate([upper[:1], self.index["border"], lower[-1:]])
        ordered["upper_midline"], ordered["lower_midline"] = upper, lower
        return ordered

    def edge_keys(self, n):
        """Keys (smaller * n + larger end) of the edges along all lines, which must not flip."""
        keys = []
        for name, line in self.ordered.items():
            ends = np.stack([line, np.roll(line, -1)], 1)
            ends = np.sort(ends if name.startswith(("eye", "nostril")) else ends[:-1])
            keys.append(ends[:, 0].astype(np.int64) * n + ends[:, 1])
        return np.concatenate(keys)
