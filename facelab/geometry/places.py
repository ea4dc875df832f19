"""Names of the places of a face: of vertices, of regions, and of what a motion moves."""

import numpy as np

from facelab.geometry.alignment import procrustes
from facelab.geometry.symmetry import MIRROR, mirror_partners

_MARKS = {  # of an average face, millimetres; those with an x have a twin on the right
    "nose_tip": (0, 4, 131), "chin": (0, -76, 104), "lip_upper": (0, -25, 118),
    "lip_lower": (0, -44, 115), "mouth_corner_left": (25, -35, 102),
    "eye_left_inner": (18, 32, 92), "eye_left_outer": (45, 34, 86),
}  # fmt: skip
_PLACES = (  # of the same face: what a region is called by, what a vertex is, and where that is
    *(("forehead", "forehead", at) for at in ((0, 82, 110), (22, 85, 106), (45, 82, 88))),
    ("brow", "brow inner", (12, 59, 107)),
    ("brow", "brow", (36, 62, 99)),
    ("brow", "brow outer", (58, 53, 79)),
    ("between the brows", "between the brows", (0, 56, 109)),
    ("eye", "eyelid upper", (33, 41, 95)),
    ("eye", "eyelid lower", (33, 29, 93)),
    ("eye", "eye corner inner", (18, 32, 92)),
    ("eye", "eye corner outer", (46, 34, 85)),
    ("temple", "temple", (70, 52, 52)),
    ("nose bridge", "nose bridge", (0, 26, 115)),
    ("nose", "nose tip", (0, 4, 130)),
    ("nose", "nose side", (12, 8, 114)),
    ("nostril", "nostril", (12, -9, 110)),
    ("nose", "under the nose", (0, -15, 116)),
    ("cheek", "cheek upper", (36, 13, 96)),
    ("cheek", "cheekbone", (59, 12, 77)),
    ("cheek", "cheek", (46, -14, 86)),
    ("cheek", "smile line", (27, -10, 100)),
    ("mouth corner", "mouth corner", (26, -35, 102)),
    *(("upper lip", "upper lip", at) for at in ((0, -26, 117), (10, -26, 116), (18, -29, 111))),
    *(("lower lip", "lower lip", at) for at in ((0, -41, 115), (10, -41, 113), (18, -39, 109))),
    *(("chin", "chin", at) for at in ((0, -58, 108), (0, -74, 105), (20, -64, 99))),
    ("jaw", "jaw side", (50, -42, 78)),
    ("jaw", "jaw side", (43, -62, 73)),
    ("jaw", "jaw corner", (66, -25, 50)),
    ("jaw", "jaw by the ear", (72, 5, 42)),
    ("ear", "ear", (80, 10, 5)),
    *(("neck", "neck", at) for at in ((0, -98, 80), (0, -130, 50), (50, -110, 20), (0, -110, -70))),
    *(("head", "head", at) for at in ((0, 120, 70), (0, 130, 0), (70, 80, -10), (0, 60, -90))),
)
_PHRASES = {"chin down": "jaw open", "chin up": "jaw shut"}
_PHRASES |= {f"eyelid{s} upper{t} down": f"eye{s}{t} closed" for s in ("", "s") for t in ("",)}
_PHRASES |= {f"eyelid upper {side} down": f"eye {side} closed" for side in ("left", "right")}
_ALIKE = 0.7  # the motion of the other side is as strong as that: both sides move
_OTHER = {"left": "right", "right": "left"}


def mirrored_name(name):
    """The name with left and right exchanged.

    Examples
    --------
    >>> mirrored_name("mouth corner left")
    'mouth corner right'
    """
    return " ".join(_OTHER.get(word, word) for word in name.split(" "))


class FacePlaces:
    """What the places of a face are called.

    An average face with its places is laid over the landmarks; the nearest place gives its name.
    Both of a mirrored pair of vertices are asked at once, so that the name of one is the mirrored
    name of the other.

    Parameters
    ----------
    mesh : TriangleMesh
        Head frame, millimetres. Places are known where four or more of its landmarks are the tip of
        the nose, chin, lips, corners of the mouth and the eyes, as in `MULTI_PIE`.
    partners : ndarray of int, shape (n_vertices,), optional
        From `mirror_partners` if left out.

    Examples
    --------
    >>> import facelab
    >>> from facelab.geometry.places import FacePlaces
    >>> face = facelab.load_example().rig.neutral
    >>> places = FacePlaces(face)
    >>> places.vertex(face.landmarks["nose_tip"])
    'nose tip'
    """

    def __init__(self, mesh, partners=None):
        self.mesh = mesh
        self.partners = mirror_partners(mesh) if partners is None else np.asarray(partners)
        self._own = np.arange(mesh.n_vertices)
        self._paired = self.partners >= 0
        self._groups, self._names, anchors, twins = _both_sides()
        typical, there = _shared_marks(mesh)
        self.known = len(typical) >= 4
        self._at = None
        if self.known:
            anchors = procrustes(typical, there, scale=True).apply(anchors)
            away = np.linalg.norm(mesh.vertices[:, None] - anchors, axis=2)
            other = away[np.where(self._paired, self.partners, self._own)][:, twins]
            self._at = (away + np.where(self._paired[:, None], other, away)).argmin(axis=1)

    def vertex(self, vertex):
        """Name of a vertex: its place, or, on a face of no known places, its side and number."""
        if self._at is not None:
            return self._without_side(self._names[self._at[vertex]], vertex)
        for name, mark in self.mesh.landmarks.items():
            if mark == vertex:
                return name.replace("_", " ")
        return f"vertex {vertex}"

    def _without_side(self, name, vertex):
        """On the midline there is no side."""
        middle = self.partners[vertex] == vertex
        return " ".join(w for w in name.split(" ") if not (middle and w in _OTHER))

    # --- regions ----------------------------------------------------------------------------------

    def regions(self, labels):
        """A name for each region of `labels`, (n_vertices,) int: list of str.

        After the place that region and place share most of. Regions that are each other's mirror
        image have mirrored names; one across the midline is called without side.
        """
        n = int(labels.max()) + 1
        area = self.mesh.vertex_areas
        p = np.flatnonzero(self._paired)
        crossing = np.zeros((n, n))
        np.add.at(crossing, (labels[p], labels[self.partners[p]]), area[p])
        facing = crossing.argmax(axis=1)
        mutual = (facing[facing] == np.arange(n)) & (crossing.max(axis=1) > 0)
        shares, middles = self._shares(labels, n, area), self._middles(labels, n, area)
        found = {}
        for i in range(n):
            if mutual[i] and facing[i] < i:
                continue
            j = facing[i] if mutual[i] else None
            found[i] = self._region_name(shares, i, j, middles), j
        return _told_apart(found, middles[:, 1])

    def _shares(self, labels, n, area):
        """How far each region and each group of places are the same: dict of group to (n,)."""
        whole = np.bincount(labels, area, n).clip(1e-12)
        shares = {}
        for group in dict.fromkeys(self._groups) if self.known else ():
            here = np.array([g == group for g in self._groups])[self._at]
            both = np.bincount(labels[here], area[here], n)
            shares[group] = both / np.sqrt(whole * max(area[here].sum(), 1e-12))
        return shares

    def _region_name(self, shares, i, j, middles):
        if not shares:
            if j is None or i == j:
                return "region"
            return "region left" if middles[i, 0] > middles[j, 0] else "region right"
        score = {g: s[i] for g, s in shares.items()}
        if j is not None:  # the mirrored name is that of the twin
            score = {g: s + shares[mirrored_name(g)][j] for g, s in score.items()}
        best = max(score, key=score.get)
        if j is None:
            return best
        if i == j:
            return _both(best)
        if best.split(" ")[-1] in _OTHER:
            return best
        return f"{best} left" if middles[i, 0] > middles[j, 0] else f"{best} right"

    def _middles(self, labels, n, area):
        heavy = np.bincount(labels, area, n).clip(1e-12)
        return (
            np.stack([np.bincount(labels, area * x, n) for x in self.mesh.vertices.T], 1)
            / (heavy[:, None])
        )

    # --- motion -----------------------------------------------------------------------------------

    def motion(self, displacements, literal=False):
        """What displacements (n_vertices, 3) do, such as "mouth corner left up"; or "".

        Parameters
        ----------
        displacements : ndarray of shape (n_vertices, 3)
        literal : bool, default=False
            Say "chin down" and not "jaw open": the chin of a shrug goes up, too, without any jaw.
        """
        said = self._motion(displacements)
        return said if literal else _PHRASES.get(said, said)

    def _motion(self, displacements):
        size = np.linalg.norm(displacements, axis=1)
        p = int(size.argmax())
        if self._at is None or size[p] < 1e-6:
            return ""
        q = int(self.partners[p])
        if q in (-1, p) or size[q] < _ALIKE * size[p]:
            return self._moved(p, displacements[p])
        axis = np.abs(displacements[p]).argmax()
        ahead, seen = displacements[p], MIRROR @ displacements[q]
        if seen @ ahead > 0.5 * size[p] * size[q]:  # the same on both sides
            return self._moved(p, ahead, both=True)
        if axis == 0 and ahead[0] * displacements[q][0] > 0:
            way = "to the left" if ahead[0] > 0 else "to the right"
            return f"{_both(self._names[self._at[p]])} {way}"
        return self._moved(p if ahead[axis] > 0 else q, displacements[p if ahead[axis] > 0 else q])

    def _moved(self, vertex, d, both=False):
        name = self._without_side(self._names[self._at[vertex]], vertex)
        axis = int(np.abs(d).argmax())
        way = (("down", "up"), ("back", "forward"))[axis - 1][int(d[axis] > 0)] if axis else ""
        if axis == 0:
            side = {"left": 1, "right": -1}.get(name.split(" ")[-1])
            if side is None:
                way = "to the left" if d[0] > 0 else "to the right"
            else:
                way = "out" if side * d[0] > 0 else "in"
        return f"{_both(name) if both else name} {way}"


def _both_sides():
    """Groups, names, positions (A, 3) and mirrored twins of all places, the right ones too."""
    groups, names, at, twins = [], [], [], []
    for group, name, place in _PLACES:
        k = len(at)
        if not place[0]:
            groups, names, at = [*groups, group], [*names, name], [*at, place]
            twins.append(k)
            continue
        middle = group in _MIDDLE
        for side, x in (("left", place[0]), ("right", -place[0])):
            groups.append(group if middle else f"{group} {side}")
            names.append(f"{name} {side}")
            at.append((x, *place[1:]))
        twins += [k + 1, k]
    return groups, names, np.array(at, dtype=float), np.array(twins)


_MIDDLE = {group for group, _, at in _PLACES if not at[0]}


def _shared_marks(mesh):
    """Landmarks of the average face that the mesh has too: where they are in each, (n, 3)."""
    marks = dict(_MARKS)
    for name, at in _MARKS.items():
        if at[0]:
            marks[mirrored_name(name.replace("_", " ")).replace(" ", "_")] = (-at[0], *at[1:])
    shared = [name for name in marks if name in mesh.landmarks]
    there = mesh.vertices[[mesh.landmarks[name] for name in shared]]
    return np.array([marks[name] for name in shared], dtype=float), there


def _both(name):
    """A name without its side, of both: "brows", and "upper lip", which is one."""
    words = name.split(" ")
    if words[-1] not in _OTHER:
        return name
    words = words[:-1]
    one = " ".join(words)
    if any(one == n and not at[0] for _, n, at in _PLACES):
        return one
    noun = -2 if words[-1] in ("inner", "outer", "upper", "lower") else -1
    words[noun] += "s"
    return " ".join(words)


def _told_apart(found, heights):
    """The names of all regions: those alike are numbered, from the top of the face downwards."""
    named = {}
    for i, (name, j) in found.items():
        named[i] = [(i, name)] + ([(j, mirrored_name(name))] if j not in (None, i) else [])
    alike = {}
    for i, (name, _) in found.items():
        alike.setdefault(frozenset([name, mirrored_name(name)]), []).append(i)
    names = {}
    for units in alike.values():
        all_names = [name for i in units for _, name in named[i]]
        numbered = len(set(all_names)) < len(all_names)
        for k, i in enumerate(sorted(units, key=lambda i: -heights[i]), start=1):
            names |= {r: f"{name} {k}" if numbered else name for r, name in named[i]}
    return [names[i] for i in sorted(names)]
