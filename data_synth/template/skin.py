"""Forehead, cheeks, jaw and the midline profile, where an anatomy's measurements put them."""

from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from data_synth.anatomy import Anatomy
from data_synth.template.plane import arc_length

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


def skin_layout():
    """Layout places of `SKIN_POINTS`: the average face unrolled, shape (n, 2)."""
    x, y, z, drop = np.array(list(SKIN_POINTS.values())).T
    return np.stack([95.0 * np.arctan2(x, z + 62.0), y - drop], -1)


def midline_levels(a):
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


def skin_points(a):
    """Skin points of one anatomy: `SKIN_POINTS` carried to its measurements, (n, 3) mm."""
    mean = Anatomy()
    points = np.array(list(SKIN_POINTS.values()))[:, :3]
    y_mean, y_own = midline_levels(mean), midline_levels(a)
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


def tip_forward(a):
    """How far the tip of the nose lies before the subnasale; sn-prn is measured aslant."""
    return np.sqrt(a.nasal_protrusion**2 - a.nose_tip_height**2)


def midline_points(a):
    """Midline profile without the lips: names -> (y, z) mm."""
    y, z = midline_levels(a), {}
    for name in ("trichion", "metopion", "glabella", "nasion", "subnasale", "sublabiale",
                 "pogonion", "menton"):  # fmt: skip
        z[name] = (y[name], getattr(a, f"{name}_depth"))
    forward = tip_forward(a)
    tip = (y["pronasale"], a.subnasale_depth + forward)
    root = z["nasion"]

    def between(one, two, bulge):
        return 0.5 * (y[one] + y[two]), 0.5 * (z[one][1] + z[two][1]) + bulge

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
    hollow = 0.5 * (a.subnasale_depth + a.labrale_superius_depth) - 0.8 - a.philtrum_depth
    z["philtrum"] = (y["subnasale"] - 0.55 * a.philtrum_length, hollow)
    z["frontal"] = between("metopion", "glabella", 0.2)
    z["hairline"] = between("trichion", "metopion", 1.2)
    pad = 0.75 * a.pogonion_depth + 0.25 * a.menton_depth + 1.2
    z["chin_pad"] = (0.55 * y["pogonion"] + 0.45 * y["menton"], pad)
    full = a.submental_fullness
    z["submentale"] = (y["menton"] - 4.0 - 0.6 * full, a.menton_depth - 14.0)
    z["cervicale"] = (y["menton"] - 5.5 - full, a.menton_depth - 25.0)
    return z


MIDLINE_V = {  # heights in the layout: the nose and the lips need room to unfold
    "pronasale": -32.5, "tip_defining": -29.0, "supratip": -22.5, "rhinion": -11.0,
    "infratip": -37.3, "columella": -42.0, "subnasale": -47.5, "subspinale": -49.5,
    "philtrum": -53.0, "sublabiale": -88.5, "submentale": -126.0, "cervicale": -137.0,
}  # fmt: skip


# Folds of the skin: measurement -> lines in the layout (left half), reach, and whether skin
# swells on the outer side of the line (+1), or the line is a ridge (0) in itself.
FOLDS = {
    "nasolabial_fold": ([(25.0, -40.0), (28.5, -52.0), (34.5, -64.0), (38.5, -73.0)], 7.0, 1),
    "marionette_fold": ([(35.5, -73.0), (37.0, -82.0), (37.5, -92.0)], 6.0, 1),
    "tear_trough": ([(22.0, -9.0), (27.0, -17.0), (38.0, -23.0)], 4.0, -1),
    "lid_crease_depth": ([(19.5, 6.6), (27.5, 10.2), (39, 11.6), (51, 10), (60.5, 5)], 2.8, -1),
    "brow_hair": ([(12.0, 18.0), (20.0, 19.8), (33.0, 21.8), (48.0, 22.0), (69.0, 14.5)], 3.2, 0),
    "eye_bag": ([(27.0, -14.0), (36.0, -16.5), (47.0, -14.5)], 4.0, 0),
}


@lru_cache(maxsize=1)
def _fold_lines():
    """Dense smooth lines of the folds: name -> (search tree, points, tangents, share 0 to 1)."""
    lines = {}
    for name, (line, _, _) in FOLDS.items():
        line = np.array(line)
        knots = arc_length(line)
        t = np.linspace(0.0, knots[-1], 60)
        dense = PchipInterpolator(knots, line)(t)
        lines[name] = cKDTree(dense), dense, np.gradient(dense, axis=0), t / knots[-1]
    return lines


def fold_depths(a, places):
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
