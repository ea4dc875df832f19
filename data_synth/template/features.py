"""Nose, mouth and eyes: their points in space, and their places in the layout."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from data_synth.template.skin import midline_levels, midline_points, tip_forward


def nose_points(a):
    """Nose beside the midline: list of (name, xyz, layout place), mm."""
    y = midline_levels(a)
    mid = midline_points(a)
    sn_y, sn_z = y["subnasale"], a.subnasale_depth
    root, bridge = 0.5 * a.nose_root_width, 0.5 * a.nose_bridge_width
    tip, wing = 0.5 * a.nose_tip_width, 0.5 * a.nose_width
    p = tip_forward(a) / 18.5
    rise = a.nose_tip_height / 12.0
    crease = wing * 1.0, sn_y + 5.6, sn_z - 11.5 * p
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
        ("alar_groove", (0.62 * wing, sn_y + 13.0, front + 1.8), (14.2, -29)),
        ("alar_groove_top", (0.78 * wing, sn_y + 13.6, crease[2] + 5.2), (17.3, -29.5)),
        ("alar_groove_back", (0.95 * wing, sn_y + 11.6, crease[2] + 1.6), (20.3, -32)),
        ("ala_front", (0.80 * wing + 0.6 * bulge, sn_y + 8.0, front + 2.2), (15.2, -34)),
        ("ala", (0.98 * wing + 0.4 * bulge, sn_y + 5.2, crease[2] + 6.0), (19.2, -38)),
        ("ala_top", (0.91 * wing + 0.6 * bulge, sn_y + 9.6, crease[2] + 8.0), (18, -33.8)),
        ("alar_crease", crease, (22.5, -39.5)),
        ("alar_base", (0.9 * wing, sn_y - 0.8, crease[2] + 2.4), (20.5, -47)),
        ("ala_back_low", (0.99 * wing, sn_y + 1.6, crease[2] + 3.4), (21.3, -43)),
        ("alar_rim_front", (0.63 * wing, sn_y + show + 2.3, front + 3.2), (13, -38)),
        ("alar_rim", (0.84 * wing, sn_y + 0.6, crease[2] + 7.6), (17.2, -41.8)),
        ("columella_side", (0.17 * wing, sn_y + 1.8, sn_z + 7.5 * p), (3.4, -42)),
        ("columella_base", (0.24 * wing, sn_y + 0.2, sn_z + 0.4), (5, -47)),
        ("sill_base", (0.52 * wing, sn_y - 2.2, sn_z - 2.6), (11.5, -50.5)),
    ]


# Mouth loops, inside to outside, as ellipses in the layout (half breadth, rise, fall), and
# the breadth in space as a share of half the mouth width.
MOUTH_LOOPS = {
    "roll": ((25.2, 2.0, 2.0), 0.86),
    "contact": ((27.6, 4.0, 4.0), 0.945),
    "vermilion": ((29.2, 7.2, 8.2), 0.975),
    "border": ((31.0, 11.0, 12.5), 1.02),
}
MOUTH_V = -68.0
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
_EYE_MEDIAL, EYE_LATERAL = 20.0, 19.8  # half breadths of the lid margin in the layout
EYE_CENTRE_U = 95.0 * np.arctan2(31.25, 84.0 - 0.0125 * 31.25**2)


def mouth_layout(loop, theta):
    """Layout place of a mouth loop at angle theta (0 top, pi bottom), (..., 2)."""
    (breadth, rise, fall), _ = MOUTH_LOOPS[loop]
    c, s = np.cos(theta), np.sin(theta)
    s = np.where(np.abs(s) < 1e-9, 0.0, s)  # the midline is exact
    c = np.sign(c) * np.abs(c) ** _ROUNDNESS.get(loop, 1.0)
    return np.stack([breadth * s, MOUTH_V + np.where(c > 0, rise, fall) * c], -1)


def eye_layout(loop, theta):
    """Layout place of an eye loop at angle theta (0 outer canthus, pi/2 top), (..., 2)."""
    inset, rise, fall = EYE_LOOPS[loop]
    c, s = np.cos(theta), np.sin(theta)
    breadth = np.where(c > 0, EYE_LATERAL, _EYE_MEDIAL) + inset
    s = np.sign(s) * np.abs(s) ** _ROUNDNESS.get(loop, 1.0)
    return np.stack([EYE_CENTRE_U + breadth * c, np.where(s > 0, rise, fall) * s], -1)


def mouth_points(a, loop, theta):
    """Points of a mouth loop in space, (n, 3) mm; theta runs from 0 (top) to pi (bottom)."""
    y = midline_levels(a)
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
    peaks = np.array([0, a.cupids_bow / up, -0.08, -0.47, -0.84, -1.0]) * up
    top = curve([0, bow, 0.45, 0.75, 0.93, 1], peaks)
    top = y["labrale_superius"] + top + (corner_y + 0.5 - y["stomion"]) * s**6
    bottom = curve([0, 0.3, 0.6, 0.85, 1], np.array([0, 0.0, 0.14, 0.55, 1.0]) * low)
    bottom = y["labrale_inferius"] + bottom + (corner_y - 0.5 - y["stomion"]) * s**6
    z_top = a.labrale_superius_depth + (corner_z - a.labrale_superius_depth) * arch
    z_top = z_top + 0.5 * np.exp(-(((s - bow) / 0.12) ** 2))  # philtral columns end here
    z_bottom = a.labrale_inferius_depth + (corner_z - a.labrale_inferius_depth) * arch
    border_y, border_z = np.where(upper, top, bottom), np.where(upper, z_top, z_bottom)
    thin = 1.0 - s**3
    if loop == "border":
        return np.stack([x, border_y, border_z + 0.4 * thin], -1)  # the white roll
    if loop == "vermilion":
        swell = np.where(upper, a.upper_lip_fullness, a.lower_lip_fullness) * thin
        above, below = 0.5 * np.exp(-((s / 0.13) ** 2)), -0.2 * np.exp(-((s / 0.2) ** 2))
        tubercle = np.where(upper, above, below)
        share = np.where(upper, 0.48, 0.45)
        yy = line + gap + share * (border_y - line)
        inner = np.where(upper, 0.35, 0.25) * (z_line + 4.0 * thin)
        zz = np.where(upper, 0.65, 0.75) * border_z + inner
        return np.stack([x, yy, zz + swell + tubercle], -1)
    if loop == "contact":
        return np.stack([x, line + gap, z_line + 0.4 * thin], -1)
    # both slope down behind the line where the lips meet, so that nothing shows between them
    roll_y = np.where(upper, 2.4 * s**4 - 0.8, -2.4) * (1.0 - s**2)
    return np.stack([x, line + 2.2 * gap + roll_y, z_line - 3.8 * (0.45 + 0.55 * thin)], -1)


# Nostril loops: radii in the layout, and how far up the passage they lie (share of depth).
NOSTRIL_LOOPS = {"rim": ((4.3, 3.3), 0.0), "wall": ((3.0, 2.3), 0.5), "floor": ((1.4, 1.1), 1.0)}
NOSTRIL_CENTRE = np.array([10.2, -42.4])
_NOSTRIL_LIP = (5.6, 4.4)  # a loop of the mesh only, where the wing turns inward


def nostril_layout(loop, theta):
    """Layout place of a nostril loop at angle theta (0 front, pi/2 lateral), (..., 2)."""
    across, along = _NOSTRIL_LIP if loop == "lip" else NOSTRIL_LOOPS[loop][0]
    return NOSTRIL_CENTRE + np.stack([across * np.sin(theta), along * np.cos(theta)], -1)


def nostril_points(a, loop, theta):
    """Points of a loop of the left nostril in space, (n, 3) mm."""
    wing, p = 0.5 * a.nose_width, tip_forward(a) / 18.5
    sn_y, show = midline_levels(a)["subnasale"], a.columella_show
    sill = np.array([0.56 * wing, sn_y + 0.8, a.subnasale_depth - 4.2])
    apex = np.array([0.36 * wing, sn_y + show + 1.7, a.subnasale_depth + 7.6 * p])
    lateral = np.array([0.21 * wing, -0.5, -0.6])
    share = NOSTRIL_LOOPS[loop][1]
    shrink = 1.0 - 0.65 * share
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    # the roof rises from the sill to the front: it faces down, and so reads dark in any light
    rise = a.nostril_depth * share * (0.5 + 0.5 * c * shrink)
    up = np.array([0.0, 1.0, -0.4]) * rise
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


def eye_points(a, loop, theta):
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
        x = x + s**8 * (eyeball_centre(a)[0] + 1.03 * a.eyeball_radius - outer[0])
    # away from the margin the lid leaves the ball more and more for the rim of the orbit
    leaves = {"tarsus": (0.72, 1.0, 4), "crease": (0.62, 0.8, 3)}
    limb, slope, power = leaves.get(loop, (0.8, 1.25, 5))
    z = _ball_depth(a, x, y, a.eyeball_radius + radius, limb, slope)
    z = z + {"tarsus": 1.0, "crease": 2.2}.get(loop, 0.0) * height * (1 - s) ** 1.3
    # near the canthi the lids leave the ball for the corners of the orbit
    deep = {"tuck": -2.2, "back_edge": -1.3}.get(loop, 0.0)
    hold = 0.0 if loop == "tuck" else 1.0  # the caruncle hugs the ball
    for corner, near in ((inner, hold * (1 - s) ** power), (outer, s**power)):
        own = _ball_depth(a, corner[0], corner[1], a.eyeball_radius + radius.mean(), limb, slope)
        z = z + near * (corner[2] + deep - own)
    # but never into it
    above = {"tuck": 0.6, "back_edge": 0.45}.get(loop, 1.2 if loop == "margin" else 1.4)
    ball = (a.eyeball_radius + above) ** 2 - (x - eyeball_centre(a)[0]) ** 2 - y**2
    z = np.maximum(z, np.sqrt(np.maximum(ball, 0.0)))
    return np.stack([x, y, z], -1)


def orbit_points(a):
    """Skin between the lid crease and the brow, and under the lower lid: as `nose_points`."""
    inner, outer = _canthi(a)
    centre = eyeball_centre(a)[0]
    top, fold = a.brow_height, a.lid_fold
    lateral = 0.5 * a.frontal_width
    sulcus = 0.5 * (a.palpebral_height_upper + a.lid_crease_height + top)
    ridge = a.brow_ridge
    glabella, deep = a.glabella_depth, a.orbit_depth
    bone = 0.6 * (glabella - 24.5) + 0.5 * ridge  # the fold hangs from the brow
    hang = 0.35 * a.epicanthus
    nasion = 0.5 * (a.nasion_height + a.glabella_height)
    return [
        ("brow_medial", (0.21 * a.frontal_width * 0.55, top - 3.0, glabella - 2.8 + 0.3 * ridge),
         (13.5, 18.5)),
        ("brow_middle", (0.46 * lateral, top - 0.5, glabella - 6.2 + ridge), (29.5, 21.0)),
        ("brow_peak", (0.74 * lateral, top, glabella - 14.3 + ridge), (46.0, 21.5)),
        ("brow_tail", (0.95 * lateral, top - a.brow_tail_drop, glabella - 26.6 + 0.6 * ridge),
         (67.0, 15.5)),
        ("orbit_roof_medial",
         (0.5 * (inner[0] + centre) - 3.5, 0.85 * sulcus, 17.6 + bone - 0.7 * deep), (24.0, 13.5)),
        ("orbit_roof", (centre, sulcus + 0.4, 16.1 + bone + 0.8 * fold - deep), (38.5, 16.3)),
        ("orbit_roof_lateral",
         (0.35 * centre + 0.65 * outer[0], 0.95 * sulcus, 11.9 + bone + fold - 0.6 * deep),
         (52.0, 14.0)),
        ("orbit_lateral", (outer[0] + 4.0, outer[1] + 3.5, 1.0), (65.0, 5.0)),
        ("canthus_medial", (inner[0] - 3.0, inner[1] + 0.5 - hang, 10.0 + 0.7 * a.epicanthus),
         (13.0, -1.5)),
        ("root_wall", (0.58 * a.nose_root_width, nasion - 1.5,
                       18.3 + bone + 0.15 * (a.nasion_depth - 20.5) - 0.3 * deep), (12.7, 11.0)),
        ("lower_sulcus_medial", (inner[0] + 3.0, -11.0, 11.8), (22.0, -13.5)),
        ("lower_sulcus", (centre, -13.0, 12.8), (38.0, -15.5)),
        ("lower_sulcus_lateral", (0.4 * centre + 0.6 * outer[0], -10.0, 8.8), (53.5, -13.0)),
    ]  # fmt: skip
