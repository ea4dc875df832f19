"""Pseudo-muscles: displacement fields on the skin, after Waters (1987), measured along the skin.

Every muscle is a small record of anatomical places and lengths; its `field` gives the
displacement of all vertices at full contraction, in millimetres. Places are landmarks of the
left side with an offset in millimetres on the average face. Distances run along the surface, so
that a pull on one lip does not leak to the other across the slit of the mouth.

References
----------
Waters, A muscle model for animating three-dimensional facial expression, SIGGRAPH 1987.
Crane, Weischedel, Wardetzky, Geodesics in heat, ACM TOG 2013.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from facelab.geometry.mesh import TriangleMesh
from facelab.numeric.sparse import SparseFactor

_AVERAGE_BREADTH = 143.4  # mm between the outermost jaw landmarks of the average face


def ease(x):
    """Smooth step from 0 at x <= 0 to 1 at x >= 1."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def bell(x):
    """Raised cosine: 1 at 0, 0 from |x| = 1 on."""
    return 0.5 + 0.5 * np.cos(np.pi * np.clip(np.abs(x), 0.0, 1.0))


class Skin:
    """The neutral surface with what muscles need to know of it.

    Parameters
    ----------
    mesh : TriangleMesh
        The neutral face with its 68 landmarks, millimetres.
    curves : dict of str to ndarray of int
        Lids and lips as ordered vertices, as in `data_synth.template.Template`.
    regions : dict of str to ndarray of int
        Vertices of each named part, as there.
    spread : float, default=1.0
        How far a pull is felt, as a factor on every reach (no unit).
    """

    def __init__(self, mesh: TriangleMesh, curves, regions, spread=1.0):
        self.mesh, self.curves, self.regions, self.spread = mesh, curves, regions, spread
        self.vertices, self.normals = mesh.vertices, mesh.normals
        ends = self.landmark("jaw_left_1") - self.landmark("jaw_right_1")
        self.scale = np.linalg.norm(ends) / _AVERAGE_BREADTH
        self._known = {}

    def landmark(self, name):
        """Position of a landmark, shape (3,), millimetres."""
        return self.vertices[self.mesh.landmarks[name]]

    def vertex(self, place):
        """The vertex nearest to a place: a landmark, or (landmark, (dx, dy, dz))."""
        name, offset = place if isinstance(place, tuple) else (place, (0.0, 0.0, 0.0))
        point = self.landmark(name) + self.scale * np.array(offset)
        return int(np.argmin(((self.vertices - point) ** 2).sum(1)))

    # --- calculus on the surface ----------------------------------------------------------

    @cached_property
    def _stiffness(self):
        return sp.csc_array(self.mesh.laplacian("cotangent", normalised=False))

    @cached_property
    def _mass(self):
        """Area of each vertex, square millimetres."""
        share = np.repeat(self.mesh.face_areas / 3.0, 3)
        return np.bincount(self.mesh.faces.ravel(), share, minlength=len(self.vertices))

    @cached_property
    def _gradient(self):
        """Per corner: gradient of its hat function, (n_faces, 3, 3), per mm."""
        corners = self.vertices[self.mesh.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double = np.maximum((normal**2).sum(1), 1e-12)[:, None]
        facing = [corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3] for k in range(3)]
        return np.stack([np.cross(normal, edge) / double for edge in facing], axis=1)

    def _factor(self, key, matrix):
        if key not in self._known:
            self._known[key] = SparseFactor(matrix)
        return self._known[key]

    def smooth(self, field, length):
        """A field (n_vertices, ...) with detail below `length` millimetres faded out."""
        system = self._factor(
            ("smooth", length), sp.diags_array(self._mass) + 0.5 * length**2 * self._stiffness
        )
        return system.solve((self._mass * field.T).T)

    def distance(self, sources):
        """Distance along the skin from the nearest source, shape (n_vertices,), millimetres.

        Heat method: the direction of heat that has spread for a short time points away from
        the sources. Smooth, and hardly dependent on the triangles.
        """
        sources = np.atleast_1d(sources)
        key = ("distance", sources.tobytes())
        if key in self._known:
            return self._known[key]
        area = sp.diags_array(self._mass)
        step = 3.0 * self.mesh.face_areas.mean()
        heat = np.zeros(len(self.vertices))
        heat[sources] = 1.0
        heat = self._factor("heat", area + step * self._stiffness).solve(heat)
        faces, gradient = self.mesh.faces, self._gradient
        flow = np.einsum("fc,fcd->fd", heat[faces], gradient)
        flow /= -np.maximum(np.linalg.norm(flow, axis=1, keepdims=True), 1e-300)
        out = np.einsum("fd,fcd->fc", flow * self.mesh.face_areas[:, None], gradient)
        divergence = np.bincount(faces.ravel(), out.ravel(), minlength=len(heat))
        distance = self._factor("poisson", self._stiffness + 1e-9 * area).solve(divergence)
        self._known[key] = np.maximum(distance - distance[sources].mean(), 0.0)
        return self._known[key]

    def fill(self, vertices, values, order=2):
        """The smoothest field with given values at some vertices.

        Parameters
        ----------
        vertices : ndarray of int, shape (n_given,)
        values : ndarray of shape (n_given,) or (n_given, n_fields)
        order : {1, 2}
            1 for a membrane (never beyond the values), 2 for a thin plate (no kinks).

        Returns
        -------
        field : ndarray of shape (n_vertices,) or (n_vertices, n_fields)
        """
        system = self._stiffness
        if order == 2:
            system = system @ sp.diags_array(1.0 / self._mass) @ system
        system = sp.csr_array(system)
        free = np.setdiff1d(np.arange(len(self.vertices)), vertices)
        field = np.zeros((len(self.vertices), *np.shape(values)[1:]))
        field[vertices] = values
        right = -(system[free][:, vertices] @ field[vertices])
        field[free] = self._factor(
            ("fill", order, np.sort(vertices).tobytes()), system[free][:, free]
        ).solve(right)
        return field

    def compression(self, field):
        """Share of area that each vertex loses under a displacement field, shape (n_vertices,)."""
        faces = self.mesh.faces
        gradient = np.einsum("fcd,fce->fde", field[faces], self._gradient)
        stretch = np.trace(gradient, axis1=1, axis2=2)
        weight = np.repeat(self.mesh.face_areas / 3.0, 3)
        total = np.bincount(faces.ravel(), weight * np.repeat(stretch, 3), len(field))
        return -total / self._mass

    # --- the mouth and the brow -------------------------------------------------------------

    @cached_property
    def from_lips(self):
        """Distance from the nearer lip border, 0 on the lips, shape (n_vertices,), mm."""
        borders = np.concatenate([self.curves["upper_lip_outer"], self.curves["lower_lip_outer"]])
        rims = np.concatenate([self.curves["upper_lip_inner"], self.curves["lower_lip_inner"]])
        red = self.distance(rims)[borders].mean()
        return np.maximum(self.distance(rims) - red, 0.0)

    @cached_property
    def nose_free(self):
        """0.2 on the nose, which its cartilage holds back, 1 from a centimetre beyond it."""
        nose = [v for name, v in self.regions.items() if name.startswith(("nose", "nostril"))]
        return 0.2 + 0.8 * ease(self.distance(np.concatenate(nose)) / (11.0 * self.scale))

    @cached_property
    def upperness(self):
        """1 on the upper lip and above, 0 on the lower lip and below, 0.5 beside the corners."""
        upper = self.curves["upper_lip_inner"][1:-1]
        lower = self.curves["lower_lip_inner"][1:-1]
        ends = self.curves["upper_lip_inner"][[0, -1]]
        given = np.concatenate([upper, lower, ends])
        values = np.repeat([1.0, 0.0, 0.5], [len(upper), len(lower), len(ends)])
        return ease(self.fill(given, values, order=1))

    @cached_property
    def lid_free(self):
        """0 on the lid margins, 1 from some millimetres beyond them, shape (n_vertices,)."""
        margins = [v for k, v in self.curves.items() if "_lid_" in k]
        return ease(self.distance(np.unique(np.concatenate(margins))) / (9.0 * self.scale))

    def left_share(self):
        """1 on the left, 0 on the right, smooth over the midline; sums to 1 with its mirror."""
        return ease(0.5 + self.vertices[:, 0] / (16.0 * self.scale))


@dataclass(frozen=True)
class Linear:
    """A muscle from bone to skin: skin is drawn towards the origin, most at the insertion.

    The zone of influence is Waters' sector: full along the fibre, nothing beyond `angle` from
    it; rising from the origin to the insertion, gone `beyond` millimetres past it.
    """

    origin: tuple
    insertion: tuple
    pull: float
    angle: float = 50.0
    beyond: float = 22.0
    lift: tuple = (0.0, 0.0, 0.0)
    """Added to the pull, in millimetres at the insertion."""

    def field(self, skin):
        """Displacements, shape (n_vertices, 3), millimetres."""
        origin, insertion = skin.vertex(self.origin), skin.vertex(self.insertion)
        to_origin, to_insertion = skin.distance(origin), skin.distance(insertion)
        length = to_origin[insertion]
        # angle at the origin from three distances along the skin (law of cosines)
        cosine = (to_origin**2 + length**2 - to_insertion**2) / np.maximum(
            2.0 * to_origin * length, 1e-9
        )
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        near = ease(to_origin / length)
        far = bell((to_origin - length) / (self.beyond * skin.scale * skin.spread))
        amount = bell(angle / (self.angle * skin.spread)) * np.where(to_origin < length, near, far)
        towards = skin.vertices[origin] - skin.vertices
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        pull = self.pull * towards + np.array(self.lift)
        return skin.scale * amount[:, None] * pull


@dataclass(frozen=True)
class Sheet:
    """Parallel fibres under the brow (frontalis): it moves as `share` says, from inner to outer.

    `share` holds the amounts at the five landmarks of the brow, inner end first; `move` is the
    displacement in millimetres; the skin follows up to `above` and `below` millimetres away.
    """

    share: tuple
    move: tuple
    above: float = 40.0
    below: float = 15.0

    def field(self, skin):
        """Displacements, shape (n_vertices, 3), millimetres."""
        brow = np.array([skin.landmark(f"brow_left_{i}") for i in (5, 4, 3, 2, 1)])
        x, y, _ = skin.vertices.T
        reach = skin.scale * skin.spread
        # beyond both ends of the brow the amount runs out smoothly
        knots = np.concatenate([[brow[0, 0] - 24 * reach], brow[:, 0], [brow[4, 0] + 18 * reach]])
        amount = np.interp(x, knots, [0.35 * self.share[0], *self.share, 0.0])
        height = y - np.interp(x, brow[:, 0], brow[:, 1])
        amount = amount * np.where(
            height > 0.0, bell(height / (self.above * reach)), bell(height / (self.below * reach))
        )
        return skin.scale * skin.smooth(amount, 4.0)[:, None] * np.array(self.move)


@dataclass(frozen=True)
class Lips:
    """A ring muscle round the mouth (orbicularis oris) and its helpers.

    Displacements in millimetres at the middle of each lip and at the corner (there x counts
    outward). Between them they follow the ellipse of the mouth, and they fade `reach`
    millimetres from the red of the lips. `roll` turns the red outward, in degrees (+ everts).
    """

    upper: tuple = (0.0, 0.0, 0.0)
    lower: tuple = (0.0, 0.0, 0.0)
    corner: tuple = (0.0, 0.0, 0.0)
    reach: float = 18.0
    roll: float = 0.0

    def field(self, skin):
        """Displacements, shape (n_vertices, 3), millimetres; already symmetric."""
        corner = skin.landmark("mouth_corner_left")
        x = skin.vertices[:, 0] / corner[0]
        inward = 1.12 * x / (1.0 + x**6) ** (1 / 6)  # the mouth narrows evenly
        x = np.clip(x, -1.0, 1.0)
        side = (x**2 * (1.5 - 0.5 * x**2))[:, None] ** 1.3
        up = skin.upperness[:, None]
        move = up * np.array(self.upper) + (1.0 - up) * np.array(self.lower)
        move = (1.0 - side) * move + side * np.array(self.corner)
        move[:, 0] = self.corner[0] * inward
        fade = bell(skin.from_lips / (self.reach * skin.scale * skin.spread))
        fade = (fade * skin.nose_free)[:, None]
        return skin.scale * fade * move + self._rolled(skin)

    def _rolled(self, skin):
        """Displacement of the red of the lips as it turns about the lip border."""
        field = np.zeros_like(skin.vertices)
        if self.roll == 0.0:
            return field
        for lip, sign in (("upper", 1.0), ("lower", -1.0)):
            border = skin.vertices[skin.curves[f"{lip}_lip_outer"]]
            x = skin.vertices[:, 0]
            axis = np.stack([np.interp(x, border[:, 0], border[:, k]) for k in (1, 2)], axis=1)
            side = 1.0 - np.clip(np.abs(x / border[-1, 0]), 0.0, 1.0) ** 2
            red = bell(skin.from_lips / 3.0)
            share = skin.upperness if lip == "upper" else 1.0 - skin.upperness
            weight = red * side * ease(2.0 * share - 1.0)
            angle = -sign * np.radians(self.roll) * weight
            y, z = (skin.vertices[:, 1:] - axis).T
            c, s = np.cos(angle), np.sin(angle)
            field[:, 1] += c * y - s * z - y
            field[:, 2] += s * y + c * z - z
        return field


@dataclass(frozen=True)
class Pad:
    """A soft pad that moves as a whole: `move` (x, y, z) and `swell` along the normal, mm."""

    place: tuple
    move: tuple = (0.0, 0.0, 0.0)
    swell: float = 0.0
    reach: float = 20.0

    def field(self, skin):
        """Displacements, shape (n_vertices, 3), millimetres."""
        distance = skin.distance(skin.vertex(self.place))
        amount = bell(distance / (self.reach * skin.scale * skin.spread))[:, None]
        return skin.scale * amount * (np.array(self.move) + self.swell * skin.normals)


@dataclass(frozen=True)
class Orbicularis:
    """The ring round the eye: skin is drawn towards the eye, most at `radius` from its margin.

    `below`, `outer` and `above` are the amounts, in millimetres, under the eye, beside its outer
    corner, and over it.
    """

    below: float
    outer: float
    above: float
    radius: float = 14.0
    width: float = 18.0

    def field(self, skin):
        """Displacements, shape (n_vertices, 3), millimetres."""
        margin = np.concatenate([skin.curves["upper_lid_left"], skin.curves["lower_lid_left"]])
        centre = skin.vertices[margin].mean(0)
        away = skin.vertices - centre
        angle = np.arctan2(away[:, 1], away[:, 0])  # 0 towards the temple
        lobes = [
            self.outer * bell(angle / 1.6),
            self.below * bell((angle + 0.5 * np.pi) / 1.6),
            self.above * bell((angle - 0.5 * np.pi) / 1.6),
        ]
        width = self.width * skin.scale * skin.spread
        distance = skin.distance(margin)
        ring = bell((distance - self.radius * skin.scale) / width)
        inward = -away / np.linalg.norm(away, axis=1, keepdims=True)
        inward -= (inward * skin.normals).sum(1, keepdims=True) * skin.normals
        return skin.scale * (ring * sum(lobes))[:, None] * inward


@dataclass(frozen=True)
class Fold:
    """Skin that folds along a line: a groove, and a soft ridge on one side of it.

    `ridge` is the side in the face's x, y plane, seen from the front, where skin piles up.
    """

    line: tuple
    depth: float
    ridge: tuple = (1.0, 0.3)
    reach: float = 4.5

    def field(self, skin):
        """Displacements along the normal, shape (n_vertices, 3), millimetres."""
        knots = np.array([skin.vertices[skin.vertex(place)] for place in self.line])
        points = _resample(knots, 40)
        offset = skin.vertices[:, None] - points
        nearest = (offset**2).sum(2).argmin(1)
        away = offset[np.arange(len(nearest)), nearest]
        away = away - (away * skin.normals).sum(1, keepdims=True) * skin.normals
        r = np.linalg.norm(away, axis=1) / (self.reach * skin.scale)
        side = away[:, :2] @ np.array(self.ridge) / np.linalg.norm(self.ridge)
        side = ease(0.5 + 0.5 * side / (1.5 * skin.scale))
        along = np.sin(np.pi * (nearest + 0.5) / len(points)) ** 0.6
        ridge = 1.3 * side * r * np.exp(-0.5 * (r / 1.2) ** 2)
        groove = np.exp(-((r / 0.6) ** 2))
        return skin.scale * (self.depth * along * (ridge - groove))[:, None] * skin.normals


def _resample(knots, n):
    """Points evenly spread along a polyline, (n, 3)."""
    at = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1)))
    return np.stack([np.interp(np.linspace(0, at[-1], n), at, x) for x in knots.T], axis=1)
