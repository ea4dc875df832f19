"""What lies where on the mesh: landmarks, named regions and curves, of the left half and the whole.

`right_of` gives each vertex of the left half its twin on the right; itself on the midline.
"""

import numpy as np

from data_synth.anatomy import Anatomy
from data_synth.template.features import MOUTH_V, eye_layout, mouth_layout
from data_synth.template.plane import inside

# The landmark of the right side that mirrors each one of the left (or the midline).
LANDMARK_TWINS = {8: 8, 27: 27, 28: 28, 29: 29, 30: 30, 33: 33, 51: 51, 57: 57, 62: 62, 66: 66,
                  42: 39, 43: 38, 44: 37, 45: 36, 46: 41, 47: 40, 34: 32, 35: 31,
                  52: 50, 53: 49, 54: 48, 55: 59, 56: 58, 63: 61, 64: 60, 65: 67}  # fmt: skip
LANDMARK_TWINS |= {16 - k: k for k in range(8)} | {22 + k: 21 - k for k in range(5)}

# Parts of the face as polygons in the layout, left half; the first that holds a vertex names
# it, and what none holds is cheek.  Names ending in "_" come as a left and a right part.
REGIONS = {
    "nostril_": [(10.0 + 5.5 * np.cos(t), -42.6 + 3.6 * np.sin(t))
                 for t in np.arange(12) * np.pi / 6],
    "nose": [(-1, 7), (8, 7), (13.5, 0), (18.5, -12), (21.5, -24), (24, -38), (21.5, -47.5),
             (11.5, -48), (5, -48.3), (-1, -48.3)],
    "philtrum": [(-1, -48.2), (8, -48.2), (8, -60), (-1, -60)],
    "glabella": [(-1, 7), (8, 7), (11.5, 15.5), (11.5, 26.5), (-1, 26.5)],
    "brow_": [(11.4, 15.5), (30, 18), (50, 18.5), (70, 12), (76, 14), (71, 20), (51, 26),
              (30, 26), (11.4, 26.5)],
    "temple_": [(71, 48), (71, 20), (76, 14), (78, -4), (150, -4), (150, 80), (80, 80)],
    "forehead": [(-1, 26.4), (11.5, 26.4), (30, 26), (51, 26), (71, 20), (71, 48), (80, 80),
                 (-1, 80)],
    "eye_socket_": [(8, 7), (13.5, 0), (14.5, -3), (38, -3), (62, -1), (78, -1), (76, 14),
                    (70, 12), (50, 18.5), (30, 18), (11.4, 15.5)],
    "infraorbital_": [(14.4, -3), (78, -3), (78, -6), (56, -21), (21, -23), (18, -12)],
    "upper_lip_skin": [(7, -48.2), (21, -47.5), (24, -45), (37, -66), (-1, -66), (-1, -60),
                       (7.9, -60)],
    "lower_lip_skin": [(-1, -68), (36, -68), (34, -78), (26, -87.5), (-1, -87.5)],
    "chin": [(-1, -87.4), (26, -87.4), (34, -98), (34, -111), (26, -114.5), (-1, -114.5)],
    "submental": [(-1, -114.4), (26, -114.4), (34, -111), (60, -107.5), (84, -101), (150, -101),
                  (150, -150), (-1, -150)],
    "jaw_": [(34, -111), (34, -96), (40, -86), (75, -84), (110, -62), (150, -58), (150, -101),
             (84, -101), (60, -107.4)],
}  # fmt: skip


def loop_landmarks(lines, surface):
    """Landmarks of the left half on the midline and on the loops: number -> vertex.

    Parameters
    ----------
    lines : data_synth.template.lines.Lines
    surface : callable
        Layout places to points of the average face.
    """
    places, ordered, mid = lines.places, lines.ordered, lines.midline
    found = {
        number: mid[np.argmin(np.abs(places[mid, 1] - v))]
        for number, (u, v) in lines.marks.items()
        if u == 0.0
    }

    def pick(loop, upper, share):
        """Vertex of a loop at a share of its breadth, from inner to outer end."""
        line = ordered[loop]
        x = surface(places[line])[:, 0]
        centre = MOUTH_V if loop.startswith("mouth") else 0.0
        side = (places[line, 1] > centre) == upper
        wanted = x.min() + share * (x.max() - x.min())
        return line[np.argmin(np.abs(x - wanted) + np.where(side, 0.0, 1e3))]

    eye, border, contact = (ordered[k] for k in ("eye.margin", "mouth.border", "mouth.contact"))
    found[45], found[42] = eye[0], eye[len(eye) // 2]
    found[51], found[57] = border[0], border[-1]
    found[62], found[66] = contact[0], contact[-1]
    found[54], found[64] = border[len(border) // 2], contact[len(contact) // 2]
    bow = Anatomy().philtrum_width / Anatomy().mouth_width
    for loop, upper, shares in (
        ("eye.margin", True, {44: 0.70, 43: 0.30}),
        ("eye.margin", False, {46: 0.70, 47: 0.30}),
        ("mouth.border", True, {52: bow, 53: 0.62}),
        ("mouth.border", False, {56: 0.36, 55: 0.70}),
        ("mouth.contact", True, {63: 0.42}),
        ("mouth.contact", False, {65: 0.42}),
    ):
        found |= {number: pick(loop, upper, share) for number, share in shares.items()}
    return found


def named_regions(layout, right_of):
    """Vertices of each named part of the whole face: dict of str to ndarray of int."""
    places = layout.places
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    lids = inside(places, eye_layout("crease", theta))
    ends = [[-1.0, MOUTH_V - 12.5], [-1.0, MOUTH_V + 11.0]]
    lips = inside(places, np.vstack([mouth_layout("border", 0.5 * theta), ends]))
    lips[layout.lines["mouth.border"]] = True
    lips |= (
        (places[:, 0] == 0.0) & (places[:, 1] < MOUTH_V + 11.0) & (places[:, 1] > MOUTH_V - 12.5)
    )
    owner = np.full(len(places), "cheek_", dtype=object)
    for name, polygon in reversed(REGIONS.items()):
        owner[inside(places, np.array(polygon, dtype=float))] = name
    owner[lids & (places[:, 1] > 0.0)] = "upper_lid_"
    owner[lids & (places[:, 1] <= 0.0)] = "lower_lid_"
    owner[lips & (places[:, 1] > MOUTH_V)] = "upper_lip"
    owner[lips & (places[:, 1] <= MOUTH_V)] = "lower_lip"
    regions = {}
    for name in sorted(set(owner)):
        left = np.flatnonzero(owner == name)
        right = right_of[left]
        if name.endswith("_"):
            regions[f"{name}left"], regions[f"{name}right"] = left, np.sort(right)
        else:
            regions[name] = np.unique(np.concatenate([left, right]))
    return regions


def named_curves(layout, right_of):
    """Vertices along each named curve of the whole face, in order: dict of str to ndarray."""
    curves = {}
    for loop, name in (("margin", "lid"), ("back_edge", "lid_back"), ("tuck", "lid_inner")):
        line = layout.lines[f"eye.{loop}"]
        n = len(line) // 2
        upper = line[: n + 1][::-1]  # from the inner canthus to the outer
        lower = np.append(line[n:], line[0])
        for part, left in (("upper", upper), ("lower", lower)):
            curves[f"{part}_{name}_left"] = left
            curves[f"{part}_{name}_right"] = right_of[left]
    for loop, name in (("border", "outer"), ("contact", "inner"), ("roll", "roll")):
        line = layout.lines[f"mouth.{loop}"]
        n = len(line) // 2
        for part, left in (("upper", line[: n + 1]), ("lower", line[n:][::-1])):
            # from the right corner over the midline to the left corner
            curves[f"{part}_lip_{name}"] = np.concatenate([right_of[left][:0:-1], left])
    border = layout.lines["border"]
    curves["border"] = np.concatenate([border, right_of[border][-2:0:-1]])
    curves["upper_midline"] = layout.lines["upper_midline"]
    curves["lower_midline"] = layout.lines["lower_midline"]
    return curves
