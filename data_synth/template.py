"""A procedural human face: anatomical curves, a fair surface through them, an even mesh.

Three steps, each a few plain functions:

1. `control_points` turns an `Anatomy` into named points and curves in space (midline
   profile, lids, lips, nose, brow, cheek, jaw).  Each has a fixed place in a flat *layout*,
   the face unrolled like a map with openings for eyes and mouth.
2. `_Surface` is the smoothest map from the layout to space that passes through them (radial
   basis functions r**3, which minimise bending; mirrored, so symmetry is exact).
3. `_layout_mesh` triangulates the layout once per density, with loops around eyes and mouth,
   so that triangles are even *on the average face*.  It never sees another anatomy, so all
   faces of one density correspond vertex by vertex.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import Delaunay, cKDTree
from threadpoolctl import ThreadpoolController

from data_synth.anatomy import Anatomy

# one thread: the last digit of a sum depends on their number, and the mesh on the last digit
_threads = ThreadpoolController()

# ======================================================================================
# 1. Anatomy -> named points in space, and their places in the layout
# ======================================================================================

# Skin of the average face, (x, y, z) in mm on the person's left: x from the midline,
# y above the line of the eyeball centres, z before their coronal plane.  The last number
# is how far the point is lowered in the layout, to unfold the underside of the jaw.
# fmt: off
SKIN_POINTS = {
    # forehead and hairline, from the midline outward
    "trichion_lateral":     (20.0, 60.0, 8.0, 0),
    "hairline_upper":       (37.0, 57.5, -2.0, 0),
    "hairline_corner":      (49.0, 52.5, -12.5, 0),
    "hairline_temple":      (58.0, 45.0, -23.0, 0),
    "metopion_lateral":     (20.0, 42.0, 18.0, 0),
    "frontal_eminence":     (37.0, 42.0, 6.6, 0),
    "frontal_upper":        (49.5, 40.0, -6.0, 0),
    "frontal_medial":       (13.0, 31.0, 22.2, 0),
    "frontal_lower":        (29.0, 31.0, 14.8, 0),
    "frontal_lateral":      (44.5, 29.0, 2.6, 0),
    "frontotemporale":      (55.5, 26.0, -10.5, 0),
    "temple_upper":         (64.5, 27.0, -25.0, 0),
    "temple_lower":         (64.5, 9.0, -21.5, 0),
    "temple_hairline_1":    (65.5, 36.5, -29.0, 0),
    "temple_hairline_2":    (70.0, 24.0, -39.0, 0),
    "temple_hairline_3":    (72.5, 11.0, -46.5, 0),
    "sideburn_1":           (73.0, -4.0, -51.0, 0),
    # cheekbone and cheek
    "orbitale_medial":      (22.0, -19.0, 12.5, 0),
    "orbitale":             (32.0, -19.5, 13.5, 0),
    "orbitale_lateral":     (44.0, -15.0, 7.5, 0),
    "orbital_rim_lateral":  (53.5, 0.0, -1.5, 0),
    "malare_medial":        (31.0, -28.5, 15.3, 0),
    "malare":               (43.0, -24.0, 9.5, 0),
    "malare_lateral":       (54.5, -19.0, -3.5, 0),
    "zygion_anterior":      (63.5, -15.0, -19.5, 0),
    "zygion":               (69.5, -14.0, -35.0, 0),
    "cheek_medial":         (25.5, -37.0, 18.0, 0),
    "cheek_front":          (36.5, -38.0, 14.0, 0),
    "cheek_middle":         (48.0, -37.0, 5.0, 0),
    "cheek_lateral":        (57.5, -37.0, -9.0, 0),
    "cheek_back":           (65.5, -36.0, -28.0, 0),
    "sideburn_2":           (73.0, -21.0, -52.0, 0),
    "sideburn_3":           (71.0, -39.0, -52.0, 0),
    # around the mouth
    "nasolabial_upper":     (24.5, -47.0, 20.5, 0),
    "nasolabial_middle":    (30.0, -56.0, 18.5, 0),
    "nasolabial_lateral":   (40.0, -54.0, 11.5, 0),
    "buccal_upper":         (51.0, -54.0, 0.0, 0),
    "buccal_back":          (62.0, -55.0, -21.0, 0),
    "modiolus":             (33.0, -70.0, 14.8, 0),
    "buccal_front":         (42.0, -71.0, 6.5, 0),
    "buccal_middle":        (51.5, -71.0, -7.0, 0),
    "masseter":             (61.2, -68.0, -27.0, 0),
    "ramus_upper":          (66.8, -55.0, -50.0, 0),
    "ramus_lower":          (62.8, -67.5, -49.0, 0),
    # chin and jaw
    "marionette":           (28.5, -83.0, 14.6, 0),
    "paramental":           (38.0, -84.0, 6.0, 0),
    "body_of_jaw":          (48.6, -80.0, -7.5, 0),
    "sublabiale_lateral":   (14.0, -86.5, 23.8, 0),
    "mental_tubercle":      (11.5, -100.0, 26.0, 0),
    "chin_side":            (21.5, -99.0, 18.5, 0),
    "prejowl":              (33.0, -96.0, 8.5, 0),
    "jaw_side":             (43.8, -89.5, -4.5, 0),
    "antegonial":           (54.0, -80.5, -23.5, 0),
    "gonion":               (58.5, -73.5, -39.5, 0),
    "menton_lateral":       (14.0, -109.8, 14.0, 1),
    "jaw_border_1":         (27.0, -105.0, 4.0, 1),
    "jaw_border_2":         (39.5, -98.0, -9.5, 0),
    "jaw_border_3":         (49.0, -89.0, -23.5, 0),
    # underside of the jaw
    "submental_lateral":    (20.0, -113.3, -2.0, 12),
    "submandibular":        (33.0, -107.0, -13.5, 9),
    "gonion_under":         (57.0, -79.0, -46.5, 1),
    "underside_1":          (17.0, -116.0, -10.0, 17),
    "underside_2":          (31.0, -110.0, -20.0, 14),
    "underside_3":          (43.0, -101.0, -31.0, 10),
    "underside_4":          (50.5, -89.0, -41.5, 6),
}
# fmt: on

# Soft tissue: measurement -> places (x, y, reach, direction) it moves, in mm on the average
# face.  A point at the place moves by measurement * direction, others by a Gaussian of reach.
SOFT_TISSUE = {
    "malar_prominence": [((47.0, -21.0), 13.0, (0.55, 0.1, 0.8))],
    "cheek_fullness": [((48.0, -54.0), 19.0, (0.75, 0.0, 0.6))],
    "temple_hollow": [((62.0, 16.0), 12.0, (-0.9, 0.0, -0.2))],
    "brow_ridge": [((15.0, 19.0), 11.0, (0.0, 0.0, 1.0)), ((40.0, 20.0), 12.0, (0.1, 0.0, 0.9))],
    "orbit_depth": [((32.0, 14.0), 8.0, (0.0, 0.0, -1.0))],
    "jowl": [((36.0, -98.0), 11.0, (0.55, -0.6, 0.4))],
    "gonial_flare": [((58.0, -79.0), 14.0, (1.0, 0.0, 0.0))],
    "submental_fullness": [((8.0, -118.0), 18.0, (0.0, -1.0, 0.2))],
}


def _levels(a):
    """Heights of the midline landmarks, top to bottom, as a dict of y in mm."""
    y = {"trichion": a.nasion_height + a.forehead_height, "glabella": a.glabella_height}
    y["metopion"] = 0.5 * (y["trichion"] + y["glabella"]) + 2.0
    y["nasion"] = a.nasion_height
    y["subnasale"] = y["nasion"] - a.nose_height
    y["pronasale"] = y["subnasale"] + a.nose_tip_height
    y["labrale_superius"] = y["subnasale"] - a.philtrum_length
    y["stomion"] = y["labrale_superius"] - a.upper_vermilion_height
    y["labrale_inferius"] = y["stomion"] - a.lower_vermilion_height
    y["sublabiale"] = y["labrale_inferius"] - a.labiomental_height
    y["menton"] = y["sublabiale"] - a.chin_height
    y["pogonion"] = y["menton"] + 0.5 * a.chin_height
    return y


_SKIN_LEVELS = ("menton", "pogonion", "sublabiale", "stomion", "subnasale", "nasion",
                "glabella", "trichion")  # fmt: skip
_PLANE_LEVELS = ("menton", "pogonion", "sublabiale", "subnasale", "nasion", "glabella",
                 "metopion", "trichion")  # fmt: skip


def _skin(a):
    """Skin points of one anatomy: `SKIN_POINTS` carried to its measurements, (n, 3) mm."""
    mean = Anatomy()
    points = np.array(list(SKIN_POINTS.values()))[:, :3]
    y_mean, y_own = _levels(mean), _levels(a)
    levels = np.array([y_mean[k] for k in _SKIN_LEVELS])
    shift = np.array([y_own[k] - y_mean[k] for k in _SKIN_LEVELS])
    x, y, z = points.T
    # Breadths: each is a ratio to the average at its own height and distance from the midline.
    heights = np.array([-112.0, -100.0, -80.0, -15.0, 26.0, 60.0])
    cheek = a.bizygomatic_width / mean.bizygomatic_width
    chin = a.chin_width / mean.chin_width
    jaw = a.bigonial_width / mean.bigonial_width
    brow = a.frontal_width / mean.frontal_width
    inner = np.interp(y, heights, [chin, chin, 0.5 * (chin + jaw), cheek, brow, brow])
    edge = a.bitemporal_width / mean.bitemporal_width
    outer = np.interp(y, heights, [jaw, jaw, jaw, 0.5 * (cheek + edge), edge, brow])
    lateral = np.clip((x - 20.0) / 40.0, 0.0, 1.0)
    new = np.empty_like(points)
    new[:, 0] = x * ((1.0 - lateral) * inner + lateral * outer)
    # Heights follow the midline levels near the midline, and less so far from it, where
    # the eyes and the ears hold the skin.
    dy = np.interp(y, levels, shift)
    hold = np.where((y > -60.0) & (y < 30.0), 0.5 * lateral, 0.0)
    new[:, 1] = y + (1.0 - hold) * dy
    # Depths follow the midline profile, and face_depth at the sides.
    depth = {k: getattr(a, f"{k}_depth") - getattr(mean, f"{k}_depth") for k in _PLANE_LEVELS}
    order = np.array([y_mean[k] for k in _PLANE_LEVELS])
    dz = np.interp(y, order, [depth[k] for k in _PLANE_LEVELS])
    back = np.clip(-z / mean.face_depth, 0.0, 1.0)
    new[:, 2] = z + (1.0 - lateral) * dz - back * (a.face_depth - mean.face_depth)
    for name, places in SOFT_TISSUE.items():
        for place, reach, direction in places:
            weight = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * reach**2))
            new += getattr(a, name) * weight[:, None] * np.array(direction)
    return new


def _tip_forward(a):
    """How far the tip of the nose lies before the subnasale; sn-prn is measured aslant."""
    return np.sqrt(a.nasal_protrusion**2 - a.nose_tip_height**2)


def _midline(a):
    """Midline profile without the lips: names -> (y, z) mm."""
    y, z = _levels(a), {}
    for name in ("trichion", "metopion", "glabella", "nasion", "subnasale", "sublabiale",
                 "pogonion", "menton"):  # fmt: skip
        z[name] = (y[name], getattr(a, f"{name}_depth"))
    forward = _tip_forward(a)
    tip = (y["pronasale"], a.subnasale_depth + forward)
    root = z["nasion"]

    def dorsum(t, convexity):
        height, depth = (root[i] + t * (tip[i] - root[i]) for i in range(2))
        return height, depth + convexity

    z["supranasion"] = (root[0] + 6.5, 0.45 * root[1] + 0.55 * a.glabella_depth - 0.4)
    z["rhinion"] = dorsum(0.42, 0.2 + a.rhinion_convexity)
    z["mid_dorsum"] = dorsum(0.2, -0.8 + 0.5 * a.rhinion_convexity)
    z["supratip"] = dorsum(0.76, -0.3 + 0.5 * a.rhinion_convexity)
    z["tip_defining"] = (tip[0] + 2.8, tip[1] - 0.6)
    z["pronasale"] = tip
    z["infratip"] = (tip[0] - 6.0, tip[1] - 2.0)
    z["columella"] = (y["subnasale"] + 1.9, a.subnasale_depth + 0.42 * forward)
    z["subspinale"] = (y["subnasale"] - 1.5, a.subnasale_depth - 0.4)
    z["philtrum"] = (
        y["subnasale"] - 0.55 * a.philtrum_length,
        0.5 * (a.subnasale_depth + a.labrale_superius_depth) - 0.8 - a.philtrum_depth,
    )
    z["frontal"] = (0.5 * (y["metopion"] + y["glabella"]), 0.5 * (a.metopion_depth
                    + a.glabella_depth) + 0.2)  # fmt: skip
    z["hairline"] = (0.5 * (y["trichion"] + y["metopion"]), 0.5 * (a.trichion_depth
                     + a.metopion_depth) + 1.2)  # fmt: skip
    z["chin_pad"] = (
        0.55 * y["pogonion"] + 0.45 * y["menton"],
        0.75 * a.pogonion_depth + 0.25 * a.menton_depth + 1.2,
    )
    full = a.submental_fullness
    z["submentale"] = (y["menton"] - 4.0 - 0.6 * full, a.menton_depth - 14.0)
    z["cervicale"] = (y["menton"] - 5.5 - full, a.menton_depth - 25.0)
    return z


_MIDLINE_V = {  # heights in the layout: the nose and the lips need room to unfold
    "pronasale": -32.5, "tip_defining": -29.0, "supratip": -22.5, "rhinion": -11.0,
    "infratip": -37.3, "columella": -42.0, "subnasale": -47.5, "subspinale": -49.5,
    "philtrum": -53.0, "sublabiale": -88.5, "submentale": -126.0, "cervicale": -137.0,
}  # fmt: skip


def _nose(a):
    """Nose beside the midline: list of (name, xyz, layout place), mm."""
    y = _levels(a)
    mid = _midline(a)
    sn_y, sn_z = y["subnasale"], a.subnasale_depth
    root, bridge = 0.5 * a.nose_root_width, 0.5 * a.nose_bridge_width
    tip, wing = 0.5 * a.nose_tip_width, 0.5 * a.nose_width
    p = _tip_forward(a) / 18.5
    rise = a.nose_tip_height / 12.0
    crease = wing * 1.05, sn_y + 5.6, sn_z - 11.5 * p
    front = crease[2] + a.alar_length * p
    (_, z_n), (y_d, z_d), (y_r, z_r) = mid["nasion"], mid["mid_dorsum"], mid["rhinion"]
    (y_s, z_s), (y_p, z_p) = mid["supratip"], mid["pronasale"]
    show, bulge = a.columella_show, a.alar_bulge
    low, flat = z_n - 20.5, z_r - 33.3  # the cheek holds the foot of a low bridge
    return [
        ("root_edge", (0.5 * root, y["nasion"], z_n - 2.0), (6, 5)),
        ("root_side", (root, y["nasion"] - 1.5, 12.6 + 0.5 * low), (12, 4)),
        ("dorsum_edge_high", (0.52 * bridge, y_d, z_d - 1.8), (6, -3)),
        ("dorsum_side_high", (1.2 * bridge, y_d - 0.5, z_d - 9.2), (12, -3.5)),
        ("dorsum_edge", (0.58 * bridge, y_r, z_r - 1.7), (6, -11)),
        ("dorsum_side", (1.12 * bridge, y_r - 0.5, z_r - 8.0), (10.5, -12)),
        ("nasal_wall", (1.4 * bridge, y_r - 0.8, 21.6 + 0.75 * flat), (13.2, -12)),
        ("cheek_junction_high", (1.8 * bridge, y_r - 1.0, 16.6 + 0.4 * flat), (16.6, -11.7)),
        ("paranasal_high", (11.2 + bridge, y_r - 2.0, 11.8 + 0.1 * flat), (21.5, -13.0)),
        ("supratip_edge", (0.7 * tip, y_s, z_s - 2.2), (6.5, -22)),
        ("supratip_side", (1.12 * tip, y_s - 0.5, z_s - 7.4), (11, -22)),
        ("supratip_wall", (0.63 * wing, y_s - 0.3, z_s - 12.4), (14.0, -22.5)),
        ("cheek_junction", (0.83 * wing, y_s - 1.0, sn_z - 10.0), (17.6, -23.2)),
        ("paranasal", (1.06 * wing, y_s - 1.5, sn_z - 13.6), (22.0, -24.0)),
        ("dome", (0.6 * tip, y_p + 0.3, z_p - 1.7), (6, -31)),
        ("dome_low", (0.55 * tip, y_p - 5.6 * rise, z_p - 3.6), (5, -36.8)),
        ("dome_side", (1.1 * tip, y_p + 0.6, z_p - 7.0), (11, -30.5)),
        ("soft_triangle", (0.88 * tip, sn_y + 6.0, z_p - 7.6), (9, -36.4)),
        ("alar_groove", (0.62 * wing, sn_y + 13.2, front + 2.6), (14.2, -29)),
        ("alar_groove_top", (0.78 * wing, sn_y + 14.0, crease[2] + 6.2), (17.3, -29.5)),
        ("alar_groove_back", (0.95 * wing, sn_y + 11.6, crease[2] + 1.6), (20.3, -32)),
        ("ala_front", (0.80 * wing + 0.6 * bulge, sn_y + 8.0, front + 2.2), (15.2, -34)),
        ("ala", (0.97 * wing + 0.4 * bulge, sn_y + 5.2, crease[2] + 6.0), (19.2, -38)),
        ("ala_top", (0.90 * wing + 0.6 * bulge, sn_y + 9.8, crease[2] + 8.4), (18, -33.8)),
        ("alar_crease", crease, (22.5, -39.5)),
        ("alar_base", (0.9 * wing, sn_y - 0.8, crease[2] + 2.4), (20.5, -47)),
        ("ala_back_low", (0.99 * wing, sn_y + 1.6, crease[2] + 3.4), (21.3, -43)),
        ("alar_rim_front", (0.63 * wing, sn_y + show + 2.3, front + 3.2), (13, -38)),
        ("alar_rim", (0.84 * wing, sn_y + 0.6, crease[2] + 7.6), (17.2, -41.8)),
        ("columella_side", (0.17 * wing, sn_y + 1.8, sn_z + 7.5 * p), (3.4, -42)),
        ("columella_base", (0.24 * wing, sn_y + 0.2, sn_z + 0.4), (5, -47)),
        ("sill_base", (0.52 * wing, sn_y - 2.2, sn_z - 2.6), (11.5, -50.5)),
    ]


def _flat(x):
    """Lateral layout coordinate of a point of the front of the average face."""
    return 95.0 * np.arctan2(x, 84.0 - 0.0125 * x**2)


# Mouth loops, inside to outside, as ellipses in the layout (half breadth, rise, fall), and
# the breadth in space as a share of half the mouth width.
MOUTH_LOOPS = {
    "roll": ((25.2, 2.0, 2.0), 0.86),
    "contact": ((27.6, 4.0, 4.0), 0.945),
    "vermilion": ((29.2, 7.2, 8.2), 0.975),
    "border": ((31.0, 11.0, 12.5), 1.02),
}
_MOUTH_V = -68.0
# Eye loops: inset from the lid margin in the layout (breadth, upper, lower).
EYE_LOOPS = {
    "tuck": (-3.6, 2.0, 2.0),
    "back_edge": (-1.6, 4.2, 4.0),
    "margin": (0.0, 6.0, 5.8),
    "tarsus": (2.0, 8.8, 8.6),
    "crease": (4.0, 11.6, 11.6),
}
# Openings have round ends in the layout, or their rims would not be Delaunay edges.
_ROUNDNESS = {"roll": 0.6, "tuck": 0.6, "contact": 0.8, "back_edge": 0.8}
_EYE_MEDIAL, _EYE_LATERAL = 20.0, 19.8  # half breadths of the lid margin in the layout


def mouth_layout(loop, theta):
    """Layout place of a mouth loop at angle theta (0 top, pi bottom), (..., 2)."""
    (breadth, rise, fall), _ = MOUTH_LOOPS[loop]
    c, s = np.cos(theta), np.sin(theta)
    s = np.where(np.abs(s) < 1e-9, 0.0, s)  # the midline is exact
    c = np.sign(c) * np.abs(c) ** _ROUNDNESS.get(loop, 1.0)
    return np.stack([breadth * s, _MOUTH_V + np.where(c > 0, rise, fall) * c], -1)


def eye_layout(loop, theta):
    """Layout place of an eye loop at angle theta (0 outer canthus, pi/2 top), (..., 2)."""
    inset, rise, fall = EYE_LOOPS[loop]
    c, s = np.cos(theta), np.sin(theta)
    breadth = np.where(c > 0, _EYE_LATERAL, _EYE_MEDIAL) + inset
    s = np.sign(s) * np.abs(s) ** _ROUNDNESS.get(loop, 1.0)
    return np.stack([_flat(31.25) + breadth * c, np.where(s > 0, rise, fall) * s], -1)


def _mouth(a, loop, theta):
    """Points of a mouth loop in space, (n, 3) mm; theta runs from 0 (top) to pi (bottom)."""
    y = _levels(a)
    half = 0.5 * a.mouth_width
    s = np.sin(theta)
    upper = np.cos(theta) > 0
    x = half * MOUTH_LOOPS[loop][1] * s
    corner_y, corner_z = y["stomion"] - a.cheilion_drop, a.cheilion_depth
    bow = 0.5 * a.philtrum_width / half
    arch = s**2.4  # the dental arch that the lips wrap

    def curve(knots, values):
        return PchipInterpolator(knots, values)(s)

    line = y["stomion"] + curve([0, 0.3, 0.7, 1], [0, 0.5, 0.1, -a.cheilion_drop])
    gap = 0.5 * a.lip_gap * (1.0 - 0.85 * s**4) * np.where(upper, 1.0, -1.0)
    z_line = a.stomion_depth + (corner_z - 1.0 - a.stomion_depth) * arch
    up, low = a.upper_vermilion_height, a.lower_vermilion_height
    top = curve(
        [0, bow, 0.45, 0.75, 0.93, 1],
        np.array([0, a.cupids_bow / up, -0.08, -0.47, -0.84, -1.0]) * up,
    )
    top = y["labrale_superius"] + top + (corner_y + 0.5 - y["stomion"]) * s**6
    bottom = curve([0, 0.3, 0.6, 0.85, 1], np.array([0, 0.0, 0.14, 0.55, 1.0]) * low)
    bottom = y["labrale_inferius"] + bottom + (corner_y - 0.5 - y["stomion"]) * s**6
    z_top = a.labrale_superius_depth + (corner_z - a.labrale_superius_depth) * arch
    z_top = z_top + 0.5 * np.exp(-(((s - bow) / 0.12) ** 2))  # philtral columns end here
    z_bottom = a.labrale_inferius_depth + (corner_z - a.labrale_inferius_depth) * arch
    border_y, border_z = np.where(upper, top, bottom), np.where(upper, z_top, z_bottom)
    thin = 1.0 - s**3
    if loop == "border":
        return np.stack([x, border_y, border_z], -1)
    if loop == "vermilion":
        swell = np.where(upper, a.upper_lip_fullness, a.lower_lip_fullness) * thin
        tubercle = np.where(
            upper, 0.5 * np.exp(-((s / 0.13) ** 2)), -0.2 * np.exp(-((s / 0.2) ** 2))
        )
        share = np.where(upper, 0.48, 0.45)
        yy = line + gap + share * (border_y - line)
        zz = np.where(upper, 0.65, 0.75) * border_z + np.where(upper, 0.35, 0.25) * (
            z_line + 4.0 * thin
        )
        return np.stack([x, yy, zz + swell + tubercle], -1)
    if loop == "contact":
        return np.stack([x, line + gap, z_line + 0.4 * thin], -1)
    roll_y = np.where(upper, 1.2, -1.2) * thin
    return np.stack([x, line + 2.2 * gap + roll_y, z_line - 3.8 * (0.45 + 0.55 * thin)], -1)


# Nostril loops: radii in the layout, and how far up the passage they lie (share of depth).
NOSTRIL_LOOPS = {"rim": ((4.3, 3.3), 0.0), "wall": ((3.0, 2.3), 0.5), "floor": ((1.4, 1.1), 1.0)}
_NOSTRIL = np.array([10.2, -42.4])
_NOSTRIL_LIP = (5.6, 4.4)  # a loop of the mesh only, where the wing turns inward


def nostril_layout(loop, theta):
    """Layout place of a nostril loop at angle theta (0 front, pi/2 lateral), (..., 2)."""
    across, along = _NOSTRIL_LIP if loop == "lip" else NOSTRIL_LOOPS[loop][0]
    return _NOSTRIL + np.stack([across * np.sin(theta), along * np.cos(theta)], -1)


def _nostril(a, loop, theta):
    """Points of a loop of the left nostril in space, (n, 3) mm."""
    wing, p = 0.5 * a.nose_width, _tip_forward(a) / 18.5
    sn_y, show = _levels(a)["subnasale"], a.columella_show
    sill = np.array([0.56 * wing, sn_y + 0.8, a.subnasale_depth - 4.2])
    apex = np.array([0.36 * wing, sn_y + show + 1.7, a.subnasale_depth + 7.6 * p])
    lateral = np.array([0.21 * wing, -0.5, -0.6])
    share = NOSTRIL_LOOPS[loop][1]
    shrink = 1.0 - 0.55 * share**2
    up = np.array([0.0, 1.0, 0.1]) * a.nostril_depth * share
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    return 0.5 * (sill + apex) + up + shrink * (0.5 * c * (apex - sill) + s * lateral)


def eyeball_centre(a):
    """Centre of the left eyeball, (3,) mm."""
    return np.array([0.5 * a.interpupillary_distance, 0.0, 0.0])


def _ball_depth(a, x, y, radius, limb=0.8, slope=1.25):
    """Depth of a sphere around the left eyeball, continued as a cone beyond its limb."""
    centre = eyeball_centre(a)
    rho = np.hypot(x - centre[0], y)
    limb = limb * radius
    inside = np.sqrt(np.maximum(radius**2 - np.minimum(rho, limb) ** 2, 0.0))
    return inside - slope * np.maximum(rho - limb, 0.0)


def _canthi(a):
    """Inner and outer canthus of the left eye, two (3,) arrays, mm."""
    inner = np.array([0.5 * a.intercanthal_width, 0.0, a.endocanthion_depth])
    outer = np.array([0.5 * a.biocular_width, 0.0, a.exocanthion_depth])
    drop = np.tan(np.radians(a.canthal_tilt)) * (outer[0] - inner[0])
    inner[1], outer[1] = -0.3 - 0.55 * drop, -0.3 + 0.45 * drop
    return inner, outer


def _eye(a, loop, theta):
    """Points of a loop of the left eye in space, (n, 3) mm."""
    inner, outer = _canthi(a)
    s = 0.5 * (1.0 + np.cos(theta))  # 0 at the inner, 1 at the outer canthus
    upper = np.sin(theta) > 0

    def lid(peak, power):
        b = power * (1 - peak) / peak
        return s**power * (1 - s) ** b / (peak**power * (1 - peak) ** b)

    up = a.palpebral_height_upper * lid(0.46, 0.7 + 0.25 * a.epicanthus)
    down = -a.palpebral_height_lower * lid(0.56, 0.66)
    x = inner[0] + s * (outer[0] - inner[0])
    base = inner[1] + s * (outer[1] - inner[1])
    y = base + np.where(upper, up, down)
    # outward across the lid: vertical over the pupil, horizontal at the canthi
    out = np.stack([0.75 * np.cos(theta), np.sin(theta)], -1)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    height = np.abs(np.sin(theta))
    fold = a.epicanthus * np.where(upper, (1.0 - s) ** 4, 0.0)
    crease = np.where(upper, a.lid_crease_height, 5.2)
    travel, radius = {
        "tuck": (0.9 + 0.0 * s, 0.5),
        "back_edge": (0.0 * s - 0.35, 0.55),
        "margin": (0.25 + 0.0 * s, a.lid_thickness),
        "tarsus": (0.5 * crease * (0.4 + 0.6 * height), a.lid_thickness + 0.6),
        "crease": (crease * (0.45 + 0.55 * height), a.lid_thickness + 1.8),
    }[loop]
    radius = radius + np.zeros_like(s)
    if loop == "crease":
        radius = radius - np.where(upper, a.lid_crease_depth, 0.2) * height
    if loop == "tarsus":
        radius = radius + np.where(upper, 0.0, 0.3)
    if loop in ("tarsus", "crease"):  # an epicanthus hangs before the inner canthus
        travel, radius = travel * (1.0 - 0.3 * fold), radius + 1.2 * fold
    x, y = x + travel * out[:, 0], y + travel * out[:, 1]
    if loop == "tuck":  # the web of the inner canthus (caruncle) covers the edge of the ball
        x = x + (1 - s) ** 8 * (eyeball_centre(a)[0] - 0.83 * a.eyeball_radius - inner[0])
    # away from the margin the lid leaves the ball more and more for the rim of the orbit
    limb, slope, power = {"tarsus": (0.72, 1.0, 4), "crease": (0.62, 0.8, 3)}.get(
        loop, (0.8, 1.25, 5)
    )
    z = _ball_depth(a, x, y, a.eyeball_radius + radius, limb, slope)
    z = z + {"tarsus": 1.0, "crease": 2.2}.get(loop, 0.0) * height * (1 - s) ** 1.3
    # near the canthi the lids leave the ball for the corners of the orbit
    deep = {"tuck": -2.2, "back_edge": -1.3}.get(loop, 0.0)
    hold = 0.0 if loop == "tuck" else 1.0  # the caruncle hugs the ball
    for corner, near in ((inner, hold * (1 - s) ** power), (outer, s**power)):
        own = _ball_depth(a, corner[0], corner[1], a.eyeball_radius + radius.mean(), limb, slope)
        z = z + near * (corner[2] + deep - own)
    # but never into it
    above = {"margin": 1.2, "tarsus": 1.4, "crease": 1.4}.get(loop, 0.5)
    ball = (a.eyeball_radius + above) ** 2 - (x - eyeball_centre(a)[0]) ** 2 - y**2
    z = np.maximum(z, np.sqrt(np.maximum(ball, 0.0)))
    return np.stack([x, y, z], -1)


def _orbit(a):
    """Skin between the lid crease and the brow, and under the lower lid: as `_nose`."""
    inner, outer = _canthi(a)
    centre = eyeball_centre(a)[0]
    top, fold = a.brow_height, a.lid_fold
    lateral = 0.5 * a.frontal_width
    sulcus = 0.5 * (a.palpebral_height_upper + a.lid_crease_height + top)
    ridge = a.brow_ridge
    bone = 0.6 * (a.glabella_depth - 24.5) + 0.5 * ridge  # the fold hangs from the brow
    hang = 0.35 * a.epicanthus
    return [
        (
            "brow_medial",
            (0.21 * a.frontal_width * 0.55, top - 3.0, a.glabella_depth - 2.8 + 0.3 * ridge),
            (13.5, 18.5),
        ),
        ("brow_middle", (0.46 * lateral, top - 0.5, a.glabella_depth - 6.2 + ridge), (29.5, 21.0)),
        ("brow_peak", (0.74 * lateral, top, a.glabella_depth - 14.3 + ridge), (46.0, 21.5)),
        (
            "brow_tail",
            (0.95 * lateral, top - a.brow_tail_drop, a.glabella_depth - 26.6 + 0.6 * ridge),
            (67.0, 15.5),
        ),
        (
            "orbit_roof_medial",
            (0.5 * (inner[0] + centre) - 3.5, 0.85 * sulcus, 17.6 + bone - 0.7 * a.orbit_depth),
            (24.0, 13.5),
        ),
        (
            "orbit_roof",
            (centre, sulcus + 0.4, 16.1 + bone + 0.8 * fold - a.orbit_depth),
            (38.5, 16.3),
        ),
        (
            "orbit_roof_lateral",
            (
                0.35 * centre + 0.65 * outer[0],
                0.95 * sulcus,
                11.9 + bone + fold - 0.6 * a.orbit_depth,
            ),
            (52.0, 14.0),
        ),
        ("orbit_lateral", (outer[0] + 4.0, outer[1] + 3.5, 1.0), (65.0, 5.0)),
        (
            "canthus_medial",
            (inner[0] - 3.0, inner[1] + 0.5 - hang, 10.0 + 0.7 * a.epicanthus),
            (13.0, -1.5),
        ),
        (
            "root_wall",
            (
                0.58 * a.nose_root_width,
                0.5 * (a.nasion_height + a.glabella_height) - 1.5,
                18.3 + bone + 0.15 * (a.nasion_depth - 20.5) - 0.3 * a.orbit_depth,
            ),
            (12.7, 11.0),
        ),
        ("lower_sulcus_medial", (inner[0] + 3.0, -11.0, 11.8), (22.0, -13.5)),
        ("lower_sulcus", (centre, -13.0, 12.8), (38.0, -15.5)),
        ("lower_sulcus_lateral", (0.4 * centre + 0.6 * outer[0], -10.0, 8.8), (53.5, -13.0)),
    ]


# Folds of the skin: measurement -> lines in the layout (left half), reach, and whether skin
# swells on the outer side of the line (+1), or the line is a ridge (0) in itself.
FOLDS = {
    "nasolabial_fold": ([(25.0, -40.0), (28.5, -52.0), (34.5, -64.0), (38.5, -73.0)], 7.0, 1),
    "marionette_fold": ([(35.5, -73.0), (37.0, -82.0), (37.5, -92.0)], 6.0, 1),
    "tear_trough": ([(22.0, -9.0), (27.0, -17.0), (38.0, -23.0)], 4.0, -1),
    "eye_bag": ([(27.0, -14.0), (36.0, -16.5), (47.0, -14.5)], 4.0, 0),
}


@lru_cache(maxsize=1)
def _fold_lines():
    """Dense smooth lines of the folds: name -> (search tree, points, tangents, share 0 to 1)."""
    lines = {}
    for name, (line, _, _) in FOLDS.items():
        line = np.array(line)
        knots = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
        t = np.linspace(0.0, knots[-1], 60)
        dense = PchipInterpolator(knots, line)(t)
        lines[name] = cKDTree(dense), dense, np.gradient(dense, axis=0), t / knots[-1]
    return lines


def _folds(a, places):
    """Forward displacement of the skin by its folds, at layout places, (n, 3) mm."""
    amount = np.zeros(len(places))
    for name, (_, reach, kind) in FOLDS.items():
        size = getattr(a, name)
        if size == 0.0:
            continue
        tree, dense, tangents, share = _fold_lines()[name]
        distance, nearest = tree.query(places)
        tangent, away = tangents[nearest], places - dense[nearest]
        # positive on the person's left of the downward line
        side = np.sign(tangent[:, 0] * away[:, 1] - tangent[:, 1] * away[:, 0])
        along = np.sin(np.pi * (share[nearest] + 0.08) / 1.16) ** 0.7
        r = distance / reach
        groove = -np.exp(-((r / 0.6) ** 2))
        if kind > 0:  # a groove on the line, and a soft swelling at its outer side
            profile = 1.1 * np.where(side > 0, r, 0.0) * np.exp(-0.5 * (r / 1.3) ** 2)
            profile = profile + 0.55 * groove
        else:
            profile = np.exp(-(r**2)) if kind == 0 else groove
        amount += size * along * profile
    cleft = np.exp(-((places[:, 0] / 3.0) ** 2) - ((places[:, 1] + 103.0) / 7.0) ** 2)
    amount -= a.chin_cleft * cleft
    return amount[:, None] * np.array([0.0, 0.0, 1.0])


def _between(named):
    """Points on a smooth curve between named ones: layout places and points in space."""
    points, places = (np.array([row[k] for row in named], dtype=float) for k in (1, 2))
    # the layout sets the parameter, so that it is the same for every anatomy
    t = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    at = np.concatenate([a + (b - a) * np.array([0.25, 0.5, 0.75]) for a, b in pairwise(t)])
    return tuple(CubicSpline(t, rows, bc_type="natural")(at) for rows in (places, points))


def _unroll(points, drop):
    """Layout places of skin points of the average face."""
    x, y, z = points.T
    return np.stack([95.0 * np.arctan2(x, z + 62.0), y - drop], -1)


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
    names, places, points, stiffness = [], [], [], []

    def add(group, name, place, point, give):
        names.append(f"{group}.{name}")
        places.append(place)
        points.append(point)
        stiffness.append(give)

    mean = _midline(Anatomy())
    for name, (y, z) in _midline(anatomy).items():
        add("midline", name, (0.0, _MIDLINE_V.get(name, mean[name][0])), (0.0, y, z), 2.0)
    drop = np.array(list(SKIN_POINTS.values()))[:, 3]
    for name, place, point in zip(
        SKIN_POINTS, _unroll(_skin(Anatomy()), drop), _skin(anatomy), strict=True
    ):
        add("skin", name, place, point, 700.0)
    for name, point, place in _nose(anatomy):
        add("nose", name, place, point, 1.0)
    orbit = _orbit(anatomy)
    for name, point, place in orbit:
        add("orbit", name, place, point, 60.0)
    for line in ("brow_", "orbit_roof", "lower_sulcus"):
        own = [row for row in orbit if row[0].startswith(line)]
        for place, point in zip(*_between(own), strict=True):
            add("orbit", line.rstrip("_") + "_line", place, point, 60.0)
    theta = np.linspace(0.0, np.pi, 21)
    for loop in MOUTH_LOOPS:
        for place, point in zip(
            mouth_layout(loop, theta), _mouth(anatomy, loop, theta), strict=True
        ):
            add("mouth", loop, place, point, 0.0)
    theta = 2.0 * np.pi * np.arange(10) / 10
    for loop in NOSTRIL_LOOPS:
        for place, point in zip(
            nostril_layout(loop, theta), _nostril(anatomy, loop, theta), strict=True
        ):
            add("nostril", loop, place, point, 0.5)
    theta = 2.0 * np.pi * np.arange(28) / 28
    for loop in EYE_LOOPS:
        for place, point in zip(eye_layout(loop, theta), _eye(anatomy, loop, theta), strict=True):
            below = loop == "crease" and place[1] < 0.0
            add("eye", loop, place, point, 25.0 if below else 0.0)
    return names, np.array(places), np.array(points), np.array(stiffness)


# ======================================================================================
# 2. The fair surface
# ======================================================================================


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


class _Surface:
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
        return points + _folds(self.anatomy, places)

    def _smooth(self, places, basis=None):
        direct, across = basis if basis is not None else _basis(places)
        n = len(self.places)
        y_z = (direct + across) @ self.even[:n] + self.even[n] + places[:, 1:] * self.even[n + 1]
        x = (direct - across)[:, self.off] @ self.odd[:-1] + places[:, 0] * self.odd[-1]
        return np.column_stack([np.where(places[:, 0] == 0.0, 0.0, x), y_z])


def _basis(places):
    """Kernel values of layout places against the control places and their mirror images."""
    centres = _layout_system()[0]
    return _kernel(places, centres), _kernel(places, centres * [-1.0, 1.0])


# ======================================================================================
# 3. The mesh in the layout, made once per density on the average face
# ======================================================================================


class _Sheet:
    """The average surface as bicubic splines over a grid of the layout, quick to evaluate.

    Meshing asks for some hundred thousand places; it needs them to a few hundredths of a
    millimetre only.
    """

    def __init__(self, surface):
        u, v = np.arange(-4.0, 152.0, _SHEET_STEP), np.arange(-142.0, 68.0, _SHEET_STEP)
        places = np.stack(np.meshgrid(np.abs(u), v, indexing="ij"), -1).reshape(-1, 2)
        points = np.zeros((len(places), 3))
        near = _inside(places, 1.1 * _border_line())  # some room around, for the splines
        points[near] = surface(places[near])
        grid = points.reshape(len(u), len(v), 3)
        grid[u < 0.0, :, 0] *= -1.0
        self._splines = [RectBivariateSpline(u, v, grid[..., k]) for k in range(3)]

    def __call__(self, places, du=0, dv=0):
        """Points in space, or their derivatives by the layout's coordinates, (n, 3) mm."""
        u, v = places.T
        return np.stack([s.ev(u, v, dx=du, dy=dv) for s in self._splines], -1)


_SHEET_STEP = 1.0
_BORDER = ("trichion_lateral", "hairline_upper", "hairline_corner", "hairline_temple",
           "temple_hairline_1", "temple_hairline_2", "temple_hairline_3", "sideburn_1",
           "sideburn_2", "sideburn_3", "ramus_upper", "ramus_lower", "gonion_under",
           "underside_4", "underside_3", "underside_2", "underside_1")  # fmt: skip
_SEPARATION = 0.22  # layout mm count this much in distances, so that touching lips stay apart


def _named_places():
    """Layout place of every single named control point."""
    names, places, _, _ = control_points(Anatomy())
    return dict(zip(names, places, strict=True))


def _border_line():
    """The outer edge of the left half in the layout, top to bottom, (n, 2)."""
    named = _named_places()
    knots = [named["midline.trichion"], *(named[f"skin.{k}"] for k in _BORDER)]
    knots = np.array([*knots, named["midline.cervicale"]])
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1)))
    # level where it meets the midline, so that the mirrored halves join smoothly
    spline = CubicSpline(chord, knots, bc_type=((1, (1.0, 0.0)), (1, (-1.0, 0.0))))
    line = spline(np.linspace(0.0, chord[-1], 400))
    line[[0, -1], 0] = 0.0
    return line


def _inside(places, polygon):
    """Even-odd test of places (n, 2) against one polygon (m, 2)."""
    x, y = places.T
    inside = np.zeros(len(places), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return inside


def _to_segments(places, polygon):
    """Distance of places (n, 2) from a closed polygon's vertices (dense polygons only)."""
    return cKDTree(polygon).query(places)[0]


def _edge_length(places):
    """Wanted edge length in the mesh as a share of its largest; finer at eyes, mouth, nostrils."""
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    eye = _to_segments(places, eye_layout("margin", theta))
    half = mouth_layout("contact", 0.5 * theta)
    mouth = _to_segments(places, half)
    nostril = np.hypot(places[:, 0] - _NOSTRIL[0], places[:, 1] - _NOSTRIL[1]) - 6.5
    size = np.minimum(0.50 + 0.026 * np.maximum(eye - 4.0, 0.0),
                      0.50 + 0.026 * np.maximum(mouth - 5.0, 0.0))  # fmt: skip
    return np.minimum(np.minimum(size, 0.52 + 0.026 * np.maximum(nostril, 0.0)), 1.0)


def _even_stations(surface, line, h, count=None, graded=True):
    """Resample a dense layout line at even steps of h * `_edge_length` on the face."""
    points = surface(line)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if graded:
        step = step / (h * _edge_length(0.5 * (line[1:] + line[:-1])))
    length = np.append(0.0, np.cumsum(step))
    n = count or max(round(length[-1]), 2)
    t = np.interp(np.linspace(0.0, length[-1], n + 1), length, np.arange(len(line)))
    return np.column_stack([np.interp(t, np.arange(len(line)), c) for c in line.T])


def _landmark_places():
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


def _even_angles(surface, loop, h, start, stop):
    """Angles at which a loop (angle -> layout) is cut into even steps on the face."""
    theta = np.linspace(start, stop, 500)
    line = loop(theta)
    step = np.linalg.norm(np.diff(surface(line), axis=0), axis=1)
    step = step / (h * _edge_length(0.5 * (line[1:] + line[:-1])))
    length = np.append(0.0, np.cumsum(step))
    return np.interp(np.linspace(0.0, length[-1], round(length[-1]) + 1), length, theta)


def _loops(surface, h):
    """Fixed loops of the left half: dict of (n, 2) layout places; those of one opening are
    cut at the same angles, so that their vertices face each other."""

    def around(layout, leader, stops):
        arcs = [
            _even_angles(surface, lambda t: layout(leader, t), h, a, b) for a, b in pairwise(stops)
        ]
        return np.concatenate([*(arc[:-1] for arc in arcs), arcs[-1][-1:]])

    loops = {}
    theta = around(eye_layout, "margin", (0.0, np.pi, 2.0 * np.pi))[:-1]
    # equally many on both lids, so that the curves of the two end at the canthi
    n = np.searchsorted(theta, np.pi + 1e-9)
    if len(theta) != 2 * (n - 1):
        low = 2.0 * np.pi - theta[:n]
        theta = np.concatenate([theta[:n], low[-2:0:-1]])
    for name in ("margin", "back_edge", "tuck"):
        loops[f"eye.{name}"] = eye_layout(name, theta)
    theta = around(nostril_layout, "rim", (2.0 * np.pi, 0.0))[:-1]
    for name in ("lip", "rim", "wall"):
        loops[f"nostril.{name}"] = nostril_layout(name, theta)
    theta = around(mouth_layout, "contact", (0.0, 0.5 * np.pi))
    theta = np.concatenate([theta, np.pi - theta[-2::-1]])
    for name in ("contact", "roll", "vermilion", "border"):
        loops[f"mouth.{name}"] = mouth_layout(name, theta)
        loops[f"mouth.{name}"][[0, -1], 0] = 0.0
    return loops


def _space(surface, places):
    """Coordinates in which distances between mesh points are taken, (n, 5)."""
    return np.column_stack([surface(places), _SEPARATION * places])


def _fill(candidates, coordinates, radius, taken, rng):
    """Choose candidates no closer than `radius` to each other and to the taken ones."""
    alive = np.ones(len(candidates), dtype=bool)
    distance, _ = cKDTree(taken).query(coordinates)
    alive &= distance > 0.72 * radius
    order = rng.permutation(np.flatnonzero(alive))
    near = cKDTree(coordinates[order]).query_ball_point(coordinates[order], radius[order])
    free = np.ones(len(order), dtype=bool)
    chosen = []
    for i, neighbours in enumerate(near):
        if free[i]:
            chosen.append(order[i])
            free[neighbours] = False
    return np.array(chosen)


def _fill_exactly(candidates, coordinates, radius, taken, n):
    """Choose `n` candidates as far from each other as may be: `_fill` with scaled radii."""
    scale, enough, slack = 1.0, None, 1.004
    for _ in range(12):
        chosen = _fill(candidates, coordinates, scale * radius, taken, np.random.default_rng(1))
        if len(chosen) >= n:
            enough = chosen
            if len(chosen) <= 1.012 * n:
                break
        # the count falls with the square of the distance; aim a little over n
        scale *= np.sqrt(len(chosen) / (slack * n))
        slack += 0.001
    return enough[:n]


def _edges_of(faces):
    """Inner edges: their triangle pair (k, 2) and the corner facing them in each (k, 2)."""
    corner = np.tile(np.arange(3), len(faces))
    owner = np.repeat(np.arange(len(faces)), 3)
    pair = np.sort(np.stack([faces[owner, (corner + 1) % 3], faces[owner, (corner + 2) % 3]], 1))
    key = pair[:, 0].astype(np.int64) * (faces.max() + 1) + pair[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, two = order[same], order[same + 1]
    return np.stack([owner[one], owner[two]], 1), np.stack([corner[one], corner[two]], 1), key[one]


def _signed_area(places, a, b, c):
    p, q = places[b] - places[a], places[c] - places[a]
    return p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]


def _flip_edges(points, places, faces, kept, rounds=12):
    """Flip edges until opposite angles in space sum to at most 180 degrees (Lawson)."""
    faces = faces.copy()
    for _ in range(rounds):
        owners, corners, key = _edges_of(faces)
        a, b = faces[owners[:, 0], corners[:, 0]], faces[owners[:, 1], corners[:, 1]]
        c = faces[owners[:, 0], (corners[:, 0] + 1) % 3]
        d = faces[owners[:, 0], (corners[:, 0] + 2) % 3]

        def angle(apex, c=c, d=d):
            p, q = points[c] - points[apex], points[d] - points[apex]
            cos = (p * q).sum(1) / np.linalg.norm(p, axis=1) / np.linalg.norm(q, axis=1)
            return np.arccos(np.clip(cos, -1.0, 1.0))

        excess = angle(a) + angle(b) - np.pi
        valid = (_signed_area(places, a, c, b) > 1e-3) & (_signed_area(places, a, b, d) > 1e-3)
        wanted = np.flatnonzero((excess > 1e-6) & valid & ~np.isin(key, kept))
        if not len(wanted):
            break
        # an independent set: an edge flips if it is the worst of both its triangles
        best = np.zeros(len(faces))
        np.maximum.at(best, owners[wanted].ravel(), np.repeat(excess[wanted], 2))
        go = wanted[(excess[wanted, None] >= best[owners[wanted]]).all(1)]
        used = owners[go].ravel()
        if len(np.unique(used)) < len(used):  # exact ties: take one at a time
            _, first = np.unique(owners[go, 0], return_index=True)
            go = go[first]
            _, first = np.unique(owners[go, 1], return_index=True)
            go = go[first]
            go = go[~np.isin(owners[go, 0], owners[go, 1])]
        faces[owners[go, 0]] = np.stack([a[go], c[go], b[go]], 1)
        faces[owners[go, 1]] = np.stack([a[go], b[go], d[go]], 1)
    return faces


def _triangulate(places, outline, holes, ghosts):
    """Delaunay triangles of the layout inside the outline and outside the holes."""
    triangles = Delaunay(np.vstack([places, ghosts])).simplices
    triangles = triangles[(triangles < len(places)).all(1)]
    centres = places[triangles].mean(1)
    good = _inside(centres, outline)
    for hole in holes:
        good &= ~_inside(centres, hole)
    triangles = triangles[good]
    turned = _signed_area(places, *triangles.T) < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def _recover_edges(faces, kept, n):
    """Flip an edge where it crosses an edge of a loop that Delaunay left out."""
    for _ in range(4):
        owners, corners, _ = _edges_of(faces)
        a, b = faces[owners[:, 0], corners[:, 0]], faces[owners[:, 1], corners[:, 1]]
        wanted = np.isin(np.minimum(a, b).astype(np.int64) * n + np.maximum(a, b), kept)
        if not wanted.any():
            break
        k = np.flatnonzero(wanted)[0]
        c, d = (faces[owners[k, 0], (corners[k, 0] + i) % 3] for i in (1, 2))
        faces[owners[k]] = [[a[k], c, b[k]], [a[k], b[k], d]]
    return faces


@dataclass(frozen=True)
class _Layout:
    """One density: layout places of the left half, triangles, and who lies where."""

    places: np.ndarray  # (m, 2)
    faces: np.ndarray  # (t, 3) of the left half
    loops: dict  # loop name -> ordered indices of the left half
    landmarks: dict  # landmark number -> index of the left half
    basis: tuple  # kernel values, so that building a face is a matrix product


@lru_cache(maxsize=8)
@_threads.wrap(limits=1)
def _layout_mesh(n_vertices):
    """Even triangles over the left half for about n_vertices in all; see the module text."""
    rng = np.random.default_rng(0)
    surface = _Sheet(_Surface(Anatomy()))
    border = _border_line()
    theta = np.linspace(0.0, np.pi, 200)
    mouth_hole = np.vstack([mouth_layout("roll", theta), [[-1.0, _MOUTH_V]]])
    eye_hole = eye_layout("tuck", 2.0 * theta[:-1])
    grid = np.stack(np.meshgrid(np.arange(0.35, 150.0, 0.7), np.arange(-140.0, 65.0, 0.7)), -1)
    grid = grid.reshape(-1, 2) + rng.uniform(-0.3, 0.3, (grid.size // 2, 2))
    grid = grid[_inside(grid, border) & ~_inside(grid, mouth_hole) & ~_inside(grid, eye_hole)]
    size = _edge_length(grid)
    coordinates = _space(surface, grid)
    # area element of the map, to know how many points a given edge length needs
    area = np.linalg.norm(np.cross(surface(grid, du=1), surface(grid, dv=1)), axis=1)
    h = np.sqrt((area / size**2).sum() * 0.49 / (0.866 * 0.5 * n_vertices))
    # candidates are drawn by density, so that steep places get their share
    keep = rng.random(len(grid)) < np.minimum(1.0, 9.0 * area / (size * h) ** 2 * 0.49)
    grid, size, coordinates = grid[keep], size[keep], coordinates[keep]

    # fixed points: loops, midline, border, landmarks
    loops = _loops(surface, h)
    marks = _landmark_places()
    fixed = []
    top = np.column_stack(
        [np.zeros(800), np.linspace(border[0, 1], loops["mouth.roll"][0, 1], 800)]
    )
    low = np.column_stack(
        [np.zeros(800), np.linspace(loops["mouth.roll"][-1, 1], border[-1, 1], 800)]
    )
    on_loops = np.array([line[i, 1] for k, line in loops.items() if "mouth" in k for i in (0, -1)])
    pins = [v for (u, v) in marks.values() if u == 0.0]
    upper = _midline_stations(surface, top, h, np.append(on_loops, pins))
    lower = _midline_stations(surface, low, h, np.append(on_loops, pins))
    n_mid = len(upper) + len(lower)
    if (n_vertices - n_mid) % 2:  # the mirrored halves need an even rest
        gaps = -np.diff(upper[:, 1]) / _edge_length(upper[:-1])
        i = int(np.argmax(gaps))
        upper = np.insert(upper, i + 1, 0.5 * (upper[i] + upper[i + 1]), axis=0)
        n_mid += 1
    edge = _even_stations(surface, border, h)[1:-1]
    groups = {"upper_mid": upper, "lower_mid": lower, "border": edge}
    groups |= {k: v for k, v in loops.items() if not k.startswith("mouth")}
    groups |= {k: v[1:-1] for k, v in loops.items() if k.startswith("mouth")}
    index = {}
    for name, line in groups.items():
        index[name] = np.arange(len(line)) + len(fixed)
        fixed.extend(line)
    spots = np.array([p for p in marks.values() if p[0] > 0.0])
    index["marks"] = np.arange(len(spots)) + len(fixed)
    fixed = np.array([*fixed, *spots])
    n_half = (n_vertices - n_mid) // 2 + n_mid
    n_free = n_half - len(fixed)

    # boundary lines, the domain on their left
    close = [loops["eye.tuck"][0:1]]
    rims = [upper, lower, np.vstack([lower[-1:], edge[::-1], upper[:1]]),
            loops["mouth.roll"], np.vstack([loops["eye.tuck"], *close])[::-1]]  # fmt: skip
    lines = rims + [v for k, v in loops.items() if k.startswith("mouth")]
    lines += [np.vstack([v, v[:1]]) for k, v in loops.items() if not k.startswith("mouth")]
    clear = ~_encroaches(grid, lines)
    outer = _flat(31.25) + _EYE_LATERAL - 2.6
    for corner in ([26.4, _MOUTH_V], [outer, 0.0]):  # no room for more where lips and lids meet
        clear &= np.linalg.norm(grid - corner, axis=1) > 1.6
    grid, size, coordinates = grid[clear], size[clear], coordinates[clear]
    taken = _space(surface, fixed)
    chosen = _fill_exactly(grid, coordinates, 0.8 * h * size, taken, n_free)
    places = np.vstack([fixed, grid[chosen]])
    free = np.arange(len(places)) >= len(fixed)

    outline = np.vstack([upper[:1], edge, lower[-1:], [[0.0, 0.0]]])
    holes = [np.vstack([loops["mouth.roll"], [[-1.0, _MOUTH_V]]]), loops["eye.tuck"]]
    kept = _loop_keys(index, loops, upper, lower, len(places))
    ghosts = _ghosts(rims)
    faces = _recover_edges(_triangulate(places, outline, holes, ghosts), kept, len(places))
    wanted = np.append(_edge_length(places), 1.0)
    for k in range(_RELAX):
        points = surface(places)
        faces = _flip_edges(points, places, faces, kept, rounds=12 if k == 0 else 4)
        places = _relax(points, places, faces, free, wanted)
    faces = _flip_edges(surface(places), places, faces, kept, rounds=20)
    numbered = {n: i for n, i in zip([n for n, p in marks.items() if p[0] > 0], index["marks"],
                                     strict=True)}  # fmt: skip
    ordered = _ordered_loops(index, loops, upper, lower, places)
    numbered |= _mid_and_loop_landmarks(marks, index, places, ordered, surface)
    return _Layout(places, faces, ordered, numbered, _basis(places))


_RELAX = 16


def _midline_stations(surface, line, h, pins):
    """Even stations down a piece of the midline that pass through the pinned heights."""
    pins = [v for v in pins if line[-1, 1] < v < line[0, 1] and abs(v - line[0, 1]) > 1e-6
            and abs(v - line[-1, 1]) > 1e-6]  # fmt: skip
    stops = [line[0, 1], *sorted(pins, reverse=True), line[-1, 1]]
    out = [line[:1]]
    for top, bottom in pairwise(stops):
        piece = np.column_stack([np.zeros(120), np.linspace(top, bottom, 120)])
        points = surface(piece)
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        n = max(round((step / (h * _edge_length(0.5 * (piece[1:] + piece[:-1])))).sum()), 1)
        out.append(_even_stations(surface, piece, h, n)[1:])
    stations = np.vstack(out)
    stations[:, 0] = 0.0
    return stations


def _ordered_loops(index, loops, upper, lower, places):
    """Indices along each loop, mouth loops with their two midline points."""
    ordered = {k: index[k] for k in loops if not k.startswith("mouth")}
    mid = np.concatenate([index["upper_mid"], index["lower_mid"]])
    for k, line in loops.items():
        if k.startswith("mouth"):
            ends = [mid[np.argmin(np.abs(places[mid, 1] - line[i, 1]))] for i in (0, -1)]
            ordered[k] = np.concatenate([ends[:1], index[k], ends[1:]])
    ordered["border"] = np.concatenate(
        [index["upper_mid"][:1], index["border"], index["lower_mid"][-1:]]
    )
    ordered["upper_midline"], ordered["lower_midline"] = index["upper_mid"], index["lower_mid"]
    return ordered


def _loop_keys(index, loops, upper, lower, n):
    """Keys of the edges along loops, which must not be flipped."""
    places = np.zeros((n, 2))
    places[index["upper_mid"]], places[index["lower_mid"]] = upper, lower
    ordered = _ordered_loops(index, loops, upper, lower, places)
    keys = []
    for name, line in ordered.items():
        ends = np.stack([line, np.roll(line, -1)], 1)
        ends = np.sort(ends if name.startswith(("eye", "nostril")) else ends[:-1])
        keys.append(ends[:, 0].astype(np.int64) * n + ends[:, 1])
    return np.concatenate(keys)


def _ghosts(rims):
    """Helper points just outside the domain that keep its boundary edges Delaunay.

    `rims` are the boundary lines, each with the domain on the left of its direction;
    openings are closed lines, and their helpers must stay within the opening.
    """
    ghosts = []
    for line in rims:
        step = np.diff(line, axis=0)
        outward = np.stack([step[:, 1], -step[:, 0]], 1)
        middle = 0.5 * (line[1:] + line[:-1])
        reach = np.full(len(step), 0.6)
        if line is not rims[2]:  # narrow openings: come closer
            others = cKDTree(line)
            for _ in range(4):
                near, _ = others.query(middle + reach[:, None] * outward)
                reach[near < 0.9 * reach * np.linalg.norm(outward, axis=1)] *= 0.6
        ghosts.append(middle + reach[:, None] * outward)
    return np.vstack(ghosts)


def _encroaches(places, lines):
    """Places within the circle over some edge of the lines: they would break that edge."""
    middle = np.vstack([0.5 * (line[1:] + line[:-1]) for line in lines])
    half = np.concatenate([0.5 * np.linalg.norm(np.diff(line, axis=0), axis=1) for line in lines])
    distance, nearest = cKDTree(middle).query(places, k=4)
    return (distance < 1.1 * half[nearest]).any(1)


def _relax(points, places, faces, free, size):
    """Move free points to the centre of their triangles, weighed by area on the face."""
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    weight = area / size[faces].mean(1) ** 4  # keeps the grading
    centre = places[faces].mean(1)
    total, sums = np.zeros(len(places)), np.zeros_like(places)
    for k in range(3):
        np.add.at(total, faces[:, k], weight)
        np.add.at(sums, faces[:, k], weight[:, None] * centre)
    target = sums / np.maximum(total, 1e-12)[:, None]
    new = places.copy()
    new[free] += 0.75 * (target[free] - places[free])
    # take back moves that would turn a triangle over in the layout
    for _ in range(6):
        bad = np.unique(faces[_signed_area(new, *faces.T) < 1e-3])
        if not len(bad):
            break
        new[bad] = places[bad]
    return new


def _mid_and_loop_landmarks(marks, index, places, ordered, surface):
    """Landmarks of the left half on the midline and on the loops: number -> index."""
    found = {}
    mid = np.concatenate([index["upper_mid"], index["lower_mid"]])
    for number, (u, v) in marks.items():
        if u == 0.0:
            found[number] = mid[np.argmin(np.abs(places[mid, 1] - v))]

    def pick(loop, upper, share):
        """Vertex of a loop at a share of its breadth, from inner to outer end."""
        line = ordered[loop]
        x = surface(places[line])[:, 0]
        centre = _MOUTH_V if loop.startswith("mouth") else 0.0
        side = (places[line, 1] > centre) == upper
        wanted = x.min() + share * (x.max() - x.min())
        return line[np.argmin(np.abs(x - wanted) + np.where(side, 0.0, 1e3))]

    eye = ordered["eye.margin"]
    found[45], found[42] = eye[0], eye[len(eye) // 2]
    found[44], found[43] = pick("eye.margin", True, 0.70), pick("eye.margin", True, 0.30)
    found[46], found[47] = pick("eye.margin", False, 0.70), pick("eye.margin", False, 0.30)
    border, contact = ordered["mouth.border"], ordered["mouth.contact"]
    found[51], found[57] = border[0], border[-1]
    found[62], found[66] = contact[0], contact[-1]
    found[54], found[64] = border[len(border) // 2], contact[len(contact) // 2]
    bow = Anatomy().philtrum_width / Anatomy().mouth_width
    found[52], found[53] = pick("mouth.border", True, bow), pick("mouth.border", True, 0.62)
    found[56], found[55] = pick("mouth.border", False, 0.36), pick("mouth.border", False, 0.70)
    found[63], found[65] = pick("mouth.contact", True, 0.42), pick("mouth.contact", False, 0.42)
    return found


# The landmark of the right side that mirrors each one of the left (or the midline).
_LANDMARK_TWINS = {8: 8, 27: 27, 28: 28, 29: 29, 30: 30, 33: 33, 51: 51, 57: 57, 62: 62, 66: 66,
                   42: 39, 43: 38, 44: 37, 45: 36, 46: 41, 47: 40, 34: 32, 35: 31,
                   52: 50, 53: 49, 54: 48, 55: 59, 56: 58, 63: 61, 64: 60, 65: 67}  # fmt: skip
_LANDMARK_TWINS |= {16 - k: k for k in range(8)} | {22 + k: 21 - k for k in range(5)}


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


# Parts of the face as polygons in the layout, left half; the first that holds a vertex names
# it, and what none holds is cheek.  Names ending in "_" come as a left and a right part.
REGIONS = {
    "nostril_": [
        (10.0 + 5.5 * np.cos(t), -42.6 + 3.6 * np.sin(t)) for t in np.arange(12) * np.pi / 6
    ],
    "nose": [
        (-1, 7),
        (8, 7),
        (13.5, 0),
        (18.5, -12),
        (21.5, -24),
        (24, -38),
        (21.5, -47.5),
        (11.5, -48),
        (5, -48.3),
        (-1, -48.3),
    ],
    "philtrum": [(-1, -48.2), (8, -48.2), (8, -60), (-1, -60)],
    "glabella": [(-1, 7), (8, 7), (11.5, 15.5), (11.5, 26.5), (-1, 26.5)],
    "brow_": [
        (11.4, 15.5),
        (30, 18),
        (50, 18.5),
        (70, 12),
        (76, 14),
        (71, 20),
        (51, 26),
        (30, 26),
        (11.4, 26.5),
    ],
    "temple_": [(71, 48), (71, 20), (76, 14), (78, -4), (150, -4), (150, 80), (80, 80)],
    "forehead": [
        (-1, 26.4),
        (11.5, 26.4),
        (30, 26),
        (51, 26),
        (71, 20),
        (71, 48),
        (80, 80),
        (-1, 80),
    ],
    "eye_socket_": [
        (8, 7),
        (13.5, 0),
        (14.5, -3),
        (38, -3),
        (62, -1),
        (78, -1),
        (76, 14),
        (70, 12),
        (50, 18.5),
        (30, 18),
        (11.4, 15.5),
    ],
    "infraorbital_": [(14.4, -3), (78, -3), (78, -6), (56, -21), (21, -23), (18, -12)],
    "upper_lip_skin": [
        (7, -48.2),
        (21, -47.5),
        (24, -45),
        (37, -66),
        (-1, -66),
        (-1, -60),
        (7.9, -60),
    ],
    "lower_lip_skin": [(-1, -68), (36, -68), (34, -78), (26, -87.5), (-1, -87.5)],
    "chin": [(-1, -87.4), (26, -87.4), (34, -98), (34, -111), (26, -114.5), (-1, -114.5)],
    "submental": [
        (-1, -114.4),
        (26, -114.4),
        (34, -111),
        (60, -107.5),
        (84, -101),
        (150, -101),
        (150, -150),
        (-1, -150),
    ],
    "jaw_": [
        (34, -111),
        (34, -96),
        (40, -86),
        (75, -84),
        (110, -62),
        (150, -58),
        (150, -101),
        (84, -101),
        (60, -107.4),
    ],
}


def _regions(layout, right_of):
    """Named vertex sets of the whole face."""
    places = layout.places
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    lids = _inside(places, eye_layout("crease", theta))
    lips = _inside(
        places,
        np.vstack(
            [
                mouth_layout("border", 0.5 * theta),
                [[-1.0, _MOUTH_V - 12.5], [-1.0, _MOUTH_V + 11.0]],
            ]
        ),
    )
    lips[layout.loops["mouth.border"]] = True
    lips |= (
        (places[:, 0] == 0.0) & (places[:, 1] < _MOUTH_V + 11.0) & (places[:, 1] > _MOUTH_V - 12.5)
    )
    owner = np.full(len(places), "cheek_", dtype=object)
    for name, polygon in reversed(REGIONS.items()):
        owner[_inside(places, np.array(polygon, dtype=float))] = name
    owner[lids & (places[:, 1] > 0.0)] = "upper_lid_"
    owner[lids & (places[:, 1] <= 0.0)] = "lower_lid_"
    owner[lips & (places[:, 1] > _MOUTH_V)] = "upper_lip"
    owner[lips & (places[:, 1] <= _MOUTH_V)] = "lower_lip"
    regions = {}
    for name in sorted(set(owner)):
        left = np.flatnonzero(owner == name)
        right = right_of[left]
        if name.endswith("_"):
            regions[f"{name}left"], regions[f"{name}right"] = left, np.sort(right)
        else:
            regions[name] = np.unique(np.concatenate([left, right]))
    return regions


def _curves(layout, right_of):
    """Ordered vertex lists of the whole face."""
    curves = {}
    for loop, name in (("margin", "lid"), ("back_edge", "lid_back"), ("tuck", "lid_inner")):
        line = layout.loops[f"eye.{loop}"]
        n = len(line) // 2
        upper = line[: n + 1][::-1]  # from the inner canthus to the outer
        lower = np.append(line[n:], line[0])
        for part, left in (("upper", upper), ("lower", lower)):
            curves[f"{part}_{name}_left"] = left
            curves[f"{part}_{name}_right"] = right_of[left]
    for loop, name in (("border", "outer"), ("contact", "inner"), ("roll", "roll")):
        line = layout.loops[f"mouth.{loop}"]
        n = len(line) // 2
        for part, left in (("upper", line[: n + 1]), ("lower", line[n:][::-1])):
            # from the right corner over the midline to the left corner
            curves[f"{part}_lip_{name}"] = np.concatenate([right_of[left][:0:-1], left])
    border = layout.loops["border"]
    curves["border"] = np.concatenate([border, right_of[border][-2:0:-1]])
    curves["upper_midline"] = layout.loops["upper_midline"]
    curves["lower_midline"] = layout.loops["lower_midline"]
    return curves


@lru_cache(maxsize=8)
def _topology(n_vertices):
    """All that depends on the density alone: faces, landmarks, regions, mirror, curves."""
    layout = _layout_mesh(n_vertices)
    off = layout.places[:, 0] > 0.0
    n_half = len(off)
    right_of = np.arange(n_half)
    right_of[off] = n_half + np.arange(off.sum())
    mirror = np.concatenate([right_of, np.flatnonzero(off)])
    faces = np.vstack([layout.faces, right_of[layout.faces[:, ::-1]]])
    landmarks = np.empty(68, dtype=int)
    for number, vertex in layout.landmarks.items():
        landmarks[number] = vertex
        landmarks[_LANDMARK_TWINS[number]] = right_of[vertex]
    return faces, landmarks, _regions(layout, right_of), mirror, _curves(layout, right_of)


@_threads.wrap(limits=1)
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
        anatomy.  The first call for a density makes its mesh (about three seconds), later calls
        take some hundredths of a second.

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
    layout = _layout_mesh(int(n_vertices))
    faces, landmarks, regions, mirror, curves = _topology(int(n_vertices))
    half = _Surface(anatomy)(layout.places, layout.basis)
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
