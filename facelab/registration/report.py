"""How far a fit can be trusted: what was used and what not, and what became of the surface."""

import warnings
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from facelab.geometry.crossings import cut

REACH = 15.0
"""Skin within this distance of a marker counts as drawn to it, millimetres."""
_LITTLE = 0.5  # of the template drawn to a scan; less is warned of
_HARDLY = 0.15  # less is refused
_TURNED = 0.02  # of the normals; right fits stay below 0.005
_USUAL, _EXPRESSIVE = "3 to 11", "13"  # degrees, measured on 40 faces and 60 expressions
_BENT = 18.0  # mean angle of the normals to the template's, degrees; more is warned of
_NO_FACE = 24.0  # more is refused: spheres, cylinders and sheets have 27 to 30
_FOLDED = -0.5  # cosine between neighbouring triangles


@dataclass(frozen=True, eq=False)
class FitReport:
    """What a fit says of itself.

    Parameters
    ----------
    drawn : float
        Share of the template that was drawn to data: vertices matched to a scan, or within 15 mm
        of a marker. Smoothness alone carried the rest.
    rms : float
        Root mean squared distance left at what was used, millimetres.
    n_used, n_unused : int
        Markers, or vertices with a match in a scan, that were believed, and that were not.
    unused_rms, unused_max : float
        Distance of those that were not from the fitted surface, millimetres; 0 if there are none.
    landmarks : dict of str to float
        How far each lies from where the others put it (leave-one-out), millimetres.
    turned : int
        Vertices whose normal points against that of the template, turned and scaled.
    folds : int
        Pairs of neighbouring triangles folded onto each other that are not so in the template.
    crossings : int
        Pairs of triangles that cut through each other and do not in the template.
    what : str
        "markers" or "vertices": what is counted.

    Examples
    --------
    >>> import facelab
    >>> face = facelab.load_template(4375)
    >>> fit = facelab.fit_scan(face, face.with_vertices(face.vertices * 1.05))
    >>> fit.report.turned, fit.report.folds, fit.report.crossings
    (0, 0, 0)
    """

    drawn: float
    rms: float
    n_used: int
    n_unused: int
    unused_rms: float
    unused_max: float
    landmarks: dict = field(repr=False)
    turned: int
    folds: int
    crossings: int
    what: str

    def __repr__(self):
        worst = sorted(self.landmarks, key=self.landmarks.get)[:-4:-1]
        far = ", ".join(f"{name} {self.landmarks[name]:.1f}" for name in worst)
        lines = [
            f"drawn to data   {100 * self.drawn:.0f} % of the template",
            f"used            {self.n_used} {self.what}, rms {self.rms:.2f} mm",
            f"not used        {self.n_unused} {self.what}"
            + (
                f", rms {self.unused_rms:.1f} mm, at most {self.unused_max:.1f}"
                if self.n_unused
                else ""
            ),
            f"landmarks       {far} mm from where the others put them, the other "
            f"{len(self.landmarks) - len(worst)} nearer",
            f"surface         {self.turned} normals turned over, {self.folds} folds, "
            f"{self.crossings} pairs of triangles that cut each other",
        ]
        return "\n".join(lines)


def made_report(mesh, before, residuals, used, drawn, landmarks, what):
    """The FitReport of a fitted mesh; `before` is the template turned and scaled to the face."""
    off = residuals[~used]
    return FitReport(
        float(np.mean(drawn)),
        _rms(residuals[used]),
        int(used.sum()),
        len(off),
        _rms(off),
        float(off.max()) if len(off) else 0.0,
        landmarks,
        n_turned(mesh, before),
        len(folds(mesh) - folds(before)),
        len(crossings(mesh) - crossings(before)),
        what,
    )


def _rms(values):
    largest = float(np.abs(values).max()) if len(values) else 0.0
    return largest * float(np.sqrt(((values / largest) ** 2).mean())) if largest else 0.0


def n_turned(mesh, before):
    """How many vertex normals of a mesh point against those before."""
    return int(((mesh.normals * before.normals).sum(axis=1) < 0).sum())


def _face_normals(mesh):
    V = mesh.vertices[mesh.faces]
    cross = np.cross(V[:, 1] - V[:, 0], V[:, 2] - V[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)


def folds(mesh):
    """Pairs of triangles with a common edge that lie folded onto each other: set of pairs.

    Examples
    --------
    >>> import facelab
    >>> V = [[0, 0, 0], [0, 2, 0], [2, 1, 0], [1.9, 1, 0.1]]
    >>> folds(facelab.TriangleMesh(V, [[0, 2, 1], [0, 1, 3]]))
    {(0, 1)}
    """
    half = np.vstack([mesh.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    owner = np.tile(np.arange(len(mesh.faces)), 3)
    half = np.sort(half, axis=1)
    order = np.lexsort(half.T)
    same = (half[order[1:]] == half[order[:-1]]).all(axis=1)
    a, b = owner[order[:-1][same]], owner[order[1:][same]]
    normals = _face_normals(mesh)
    bent = (normals[a] * normals[b]).sum(axis=1) < _FOLDED
    return set(map(tuple, np.sort(np.stack([a[bent], b[bent]], axis=1), axis=1).tolist()))


def crossings(mesh):
    """Pairs of triangles that cut through each other, without a common edge: set of pairs.

    An edge of one passes through the inside of the other; touching does not count.

    Examples
    --------
    >>> import facelab
    >>> V = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [5, 5, 0]]
    >>> crossings(facelab.TriangleMesh(V, [[0, 1, 2], [3, 4, 5]]))
    {(0, 1)}
    """
    F, corners = mesh.faces, mesh.vertices[mesh.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    pairs = _near_pairs((low + high) / 2, np.linalg.norm(high - low, axis=1) / 2)
    i, j = pairs.T
    pairs = pairs[((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)]
    found = cut(mesh.vertices, F[pairs[:, 0]], F[pairs[:, 1]])
    return set(map(tuple, pairs[found].tolist()))


def _near_pairs(centre, radius):
    """Pairs of balls that may meet; the few large ones are looked at apart."""
    usual = np.quantile(radius, 0.98)
    pairs = [cKDTree(centre).query_pairs(2 * usual, output_type="ndarray")]
    large = np.flatnonzero(radius > usual)
    if len(large):
        near = cKDTree(centre).query_ball_point(centre[large], radius[large] + radius.max())
        one = np.repeat(large, [len(n) for n in near])
        two = np.concatenate([np.asarray(n, dtype=int) for n in near])
        pairs.append(np.stack([one, two], axis=1)[one != two])
    pairs = np.sort(np.vstack(pairs), axis=1)
    n = len(centre)
    return np.stack(np.divmod(np.unique(pairs[:, 0] * n + pairs[:, 1]), n), axis=1)


def near_markers(mesh, feet):
    """Which vertices have a marker's foot within 15 mm: bool, shape (n_vertices,)."""
    return cKDTree(feet).query(mesh.vertices)[0] <= REACH


def check_surface(mesh, before, label):
    """Warn of a surface that turned over, or that is hardly a face any more; refuse one that is
    none."""
    cosine = np.clip((mesh.normals * before.normals).sum(axis=1), -1, 1)
    bent = float(np.degrees(np.arccos(cosine)).mean())
    if bent > _BENT:
        said = (
            f"{label}: to fit, the template bends by {bent:.0f} degrees on average, and to other "
            f"faces it bends by {_USUAL}, {_EXPRESSIVE} with a wide open jaw. "
        )
        if bent > _NO_FACE:
            raise ValueError(said + "This is no face; check what was read.")
        warnings.warn(
            said + "Look whether the result is a face, and whether the landmarks are right.",
            stacklevel=3,
        )
    turned = int((cosine < 0).sum())
    if turned > _TURNED * mesh.n_vertices:
        warnings.warn(
            f"{label}: {100 * turned / mesh.n_vertices:.0f} % of the normals turned over against "
            "the template, so the surface is folded; check the landmarks, or take "
            'preset="smooth".',
            stacklevel=3,
        )


def check_drawn(drawn):
    """Refuse a scan that next to none of the template is drawn to; warn of little."""
    share = float(np.mean(drawn))
    remedy = (
        "check that the scan shows the whole face, in one surface wound outwards, and that its "
        "landmarks lie on it"
    )
    if share < _HARDLY:
        raise ValueError(
            f"scan: only {100 * share:.0f} % of the template find a place on it that faces the "
            f"same way; {remedy}."
        )
    if share < _LITTLE:
        warnings.warn(
            f"scan: only {100 * share:.0f} % of the template is drawn to it, the rest is carried "
            f"by smoothness alone; {remedy}.",
            stacklevel=3,
        )
