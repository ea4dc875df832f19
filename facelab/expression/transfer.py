"""The intermediate model space: action units of one person carried to the face of another.

Yu and Liu 2014, sections III and V. A template in the topology of the source units is fitted to
the target's neutral; the units are carried to it; expressions are sketched, optimised and sent
back to the target's own mesh. Their movement mapping [11] and barycentric mapping [30] are not at
hand: both are built here from the description. All lengths are millimetres.
"""

from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from facelab.checks import as_finite, check_choice, check_count, check_number, check_type
from facelab.expression.contact import Contact
from facelab.expression.riding import Rider, closed, skin_of
from facelab.expression.units import find_alignment, sketch_positions
from facelab.geometry.alignment import procrustes
from facelab.geometry.deformation import LaplacianDeformer
from facelab.geometry.mesh import TriangleMesh
from facelab.geometry.size import check_face_size
from facelab.geometry.winding import outwards, turned_over
from facelab.motion import MotionSequence
from facelab.numeric.sparse import SparseFactor
from facelab.registration.fit import fit_scan
from facelab.registration.scan import turned_from
from facelab.rig import BlendshapeRig

METHODS = ("transfer", "mapping", "copy")
"""Ways to carry units: by deformation transfer, by movement mapping, as they are."""


class UnitCarrier:
    """Carries displacements of one mesh to another of the same topology.

    Parameters
    ----------
    source, target : TriangleMesh
        Two neutral faces with the same triangles, both in the head frame, millimetres.
    method : {"transfer", "mapping", "copy"}
        transfer: every triangle of the target is turned and stretched as its like on the source;
        units grow with the face. Between the synthetic actors mostly the nearest to the truth.
        mapping: each displacement follows the change of the surface around its vertex, a turn and
        a stretch found over `reach` millimetres; our stand-in for the method that the paper cites.
        copy: displacements stay as they are.
    reach : float, default=20.0
        Of mapping, millimetres: how far around a vertex the change of the surface is averaged.

    Raises
    ------
    ValueError
        If the triangles differ or the method is unknown.

    References
    ----------
    Movement mapping: only cited by Yu and Liu 2014, section III; ours follows the idea of Noh and
    Neumann, Expression Cloning, 2001; the average over a neighbourhood is ours. Deformation
    transfer: Sumner and Popovic 2004, triangles weighted by area.
    """

    def __init__(self, source, target, method="transfer", reach=20.0):
        for mesh, name in ((source, "source"), (target, "target")):
            check_type(mesh, name, TriangleMesh, "give the neutral face as a mesh")
        check_choice(method, "method", METHODS)
        self.reach = check_number(reach, "reach", above=0)
        if not _alike(source, target):
            raise ValueError(
                f"source has {source.n_vertices} vertices and {len(source.faces)} faces, target "
                f"{target.n_vertices} and {len(target.faces)}, or their triangles differ; fit the "
                "source's mesh to the target first, as IntermediateSpace does."
            )
        self.source, self.target, self.method = source, target, method

    def carry(self, displacements):
        """Displacements on the target, shape (n, n_vertices, 3), millimetres.

        Parameters
        ----------
        displacements : ndarray of shape (n, n_vertices, 3)
            Of the source from its neutral: units, or frames of one.
        """
        d = as_finite(displacements, "displacements", ("n", self.source.n_vertices, 3))
        if self.method == "copy":
            return d.copy()
        if self.method == "mapping":
            return (self.change @ d[..., None])[..., 0]
        return np.stack([self._transfer(one) for one in d]) if len(d) else d.copy()

    @cached_property
    def change(self):
        """How the surface around each vertex changes to the target: (n_vertices, 3, 3)."""
        mesh, F = self.source, self.source.faces
        edges, area = _edge_frames(mesh.vertices, F)
        G = _edge_frames(self.target.vertices, F)[0] @ np.linalg.inv(edges)
        around = np.zeros((mesh.n_vertices, 9))
        np.add.at(around, F, (area[:, None] * G.reshape(-1, 9) / 3)[:, None])
        M = sp.diags_array(np.maximum(mesh.vertex_areas, 1e-9))
        L = mesh.laplacian("cotangent", normalised=False)
        return SparseFactor(M + self.reach**2 * L).solve(around).reshape(-1, 3, 3)

    def _transfer(self, d):
        """Displacement whose gradient on each triangle is nearest to that of the source's."""
        F, inverse, pull, solver = self._equations
        S = _edge_frames(self.source.vertices + d, F)[0] @ inverse - np.eye(3)
        x = solver.solve(pull @ S.transpose(0, 2, 1).reshape(-1, 3))
        size = np.linalg.norm(d, axis=1)
        for piece in np.unique(self.source.pieces):  # gradients leave its place open
            own = self.source.pieces == piece
            quiet = own & (size <= np.quantile(size[own], 0.25))
            x[own] += (d - x)[quiet].mean(axis=0)
        return x

    @cached_property
    def _equations(self):
        V, F = self.target.vertices, self.target.faces
        a, b, c = V[F].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        across = np.stack([np.cross(normal, side) for side in (c - b, a - c, b - a)], axis=1)
        gradient = across / np.maximum((normal**2).sum(axis=1), 1e-12)[:, None, None]
        rows = np.arange(3 * len(F)).reshape(-1, 1, 3).repeat(3, axis=1)
        columns = F[..., None].repeat(3, axis=2)
        shape = (3 * len(F), len(V))
        G = sp.csr_array((gradient.ravel(), (rows.ravel(), columns.ravel())), shape=shape)
        pull = G.T @ sp.diags_array(np.repeat(self.target.face_areas, 3))
        solver = SparseFactor(pull @ G + 1e-9 * sp.eye_array(len(V)))
        return F, np.linalg.inv(_edge_frames(self.source.vertices, F)[0]), pull, solver


def _alike(a, b):
    return a.n_vertices == b.n_vertices and np.array_equal(a.faces, b.faces)


def _edge_frames(V, F):
    """Two edges of each triangle and its normal, as long as the root of twice its area; areas."""
    a, b, c = V[F].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    double = np.maximum(np.linalg.norm(normal, axis=1), 1e-9)
    normal = normal / np.sqrt(double)[:, None]
    return np.stack([b - a, c - a, normal], axis=2), double / 2


def _fitted(template, target, preset):
    """Vertices of the template on the target, and the fit: skin to skin, other parts along."""
    scan, _ = closed(target)
    outer = skin_of(scan)
    if not outer.all():
        scan = scan.submesh(outer)
    skin = skin_of(template)
    if skin.all():
        fit = fit_scan(template, scan, preset=preset)
        return fit.mesh.vertices, fit
    fit = fit_scan(template.submesh(skin), scan, preset=preset)
    V, under = template.vertices.copy(), template.vertices[skin]
    V[skin] = fit.mesh.vertices
    tree = cKDTree(under)
    for p in np.unique(template.pieces[~skin]):
        part = template.pieces == p
        near = np.unique(tree.query(template.vertices[part], k=min(20, len(under)))[1])
        move = procrustes(under[near], fit.mesh.vertices[near], scale=True)
        V[part] = move.apply(template.vertices[part])
    return V, fit


def _wound_as(target, face):
    """The target, its skin wound as the face that lies on it; other parts go with the most."""
    body, index = closed(target)
    skin = skin_of(body)[index][target.faces[:, 0]]
    under = TriangleMesh(target.vertices, target.faces[skin])
    turned = np.zeros(len(skin), dtype=bool)
    turned[skin] = turned_from(under, face)
    turned[~skin] = under.face_areas[turned[skin]].sum() > under.face_areas.sum() / 2
    return turned_over(target, turned)


class IntermediateSpace:
    """A target face, its sketches and the source's action units, all in one topology.

    Parameters
    ----------
    source : BlendshapeRig
        Action units of one person; its neutral, with landmarks, is the template.
    target : TriangleMesh
        Neutral face of another, any topology and frame, millimetres. With landmarks (as in
        `facelab.geometry.MULTI_PIE`), unless it has the triangles of the template.
    method : {"transfer", "mapping", "copy"}
        How units are carried, see `UnitCarrier`.
    register : bool, optional
        Fit the template to the target. If left out, only where its triangles are others.
    preset : str, default="close"
        Of the fit, see `facelab.registration.PRESETS`.
    contact : bool, default=False
        `to_target` holds lips and lids off each other, see `facelab.expression.Contact`.
        How long that takes stands in docs/contact.md.

    Attributes
    ----------
    rig : BlendshapeRig
        The carried units on the target's face, in the topology of the template, head frame.
    fit : facelab.registration.Fit or None
        Template to target; its `rms` is the registration error. None if it was not needed.

    Raises
    ------
    ValueError
        As `facelab.registration.fit_scan`; for register=False with other triangles.

    References
    ----------
    Yu and Liu 2014, sections III and V.

    Examples
    --------
    >>> import facelab
    >>> rig = facelab.load_example().rig
    >>> wider = rig.neutral.with_vertices(rig.neutral.vertices * [1.1, 1.0, 1.0])
    >>> facelab.IntermediateSpace(rig, wider).rig.names == rig.names
    True
    """

    def __init__(
        self, source, target, method="transfer", register=None, preset="close", contact=False
    ):
        check_type(source, "source", BlendshapeRig, "of an actor, take actor_rig(...).linear()")
        check_type(target, "target", TriangleMesh, "give the neutral face as a mesh")
        check_choice(contact, "contact", (True, False))
        check_face_size(source.neutral.vertices, "source")
        check_face_size(target.vertices, "target")
        alike = _alike(source.neutral, target)
        if register is False and not alike:
            raise ValueError("register=False, but target has other triangles; leave it out.")
        self.source, self.target, self.preset = source, target, preset
        self.contact, self.fit = contact, None
        template, V = outwards(source.neutral, "source"), target.vertices
        if register or not alike:
            V, self.fit = _fitted(template, target, preset)
        self._face = template.with_vertices(V)
        neutral = source.neutral.with_vertices(V)
        self.carrier = UnitCarrier(source.neutral, neutral, method)
        self.rig = BlendshapeRig(neutral, source.names, self.carrier.carry(source.deltas))

    def __repr__(self):
        said = f"registered, rms {self.fit.rms:.2f} mm" if self.fit else "same topology"
        return (
            f"IntermediateSpace({len(self.rig.names)} units by {self.carrier.method}, template "
            f"{self.rig.neutral.n_vertices} vertices, target {self.target.n_vertices}; {said})"
        )

    def _to_head(self, V):
        return self.fit.alignment.apply(V) if self.fit else V

    @cached_property
    def _own(self):
        """The target's own mesh, head frame, wound outwards."""
        if self.fit is None:
            return self._face
        return _wound_as(self.target.with_vertices(self._to_head(self.target.vertices)), self._face)

    @cached_property
    def _forth(self):
        """The target's own mesh, riding on the template."""
        return Rider(self._face, self._own)

    @cached_property
    def _back(self):
        """The template, riding on the target's own mesh."""
        return Rider(self._own, self._face, fade=None)

    @cached_property
    def _contact(self):
        return Contact(self._own)

    @property
    def covered(self):
        """Vertices of the template's skin that lie on the target: int, (n_covered,)."""
        if self.fit is None:
            return np.arange(self.rig.neutral.n_vertices)
        return np.flatnonzero(self._back.covered)

    @property
    def reached(self):
        """Vertices of the target's own skin that the template reaches: int, (n_reached,)."""
        if self.fit is None:
            return np.arange(self.target.n_vertices)
        return np.flatnonzero(self._forth.covered)

    def to_template(self, sketch, register=None):
        """A sketched expression of the target in the topology of the template.

        Parameters
        ----------
        sketch : TriangleMesh or ndarray of shape (n_target_vertices, 3)
            On the target's own mesh and in its frame: carried by the binding, exact for the
            neutral. A mesh with other triangles, in any frame, needs landmarks: the template is
            fitted to it, and rigid motion that no units explain is taken out.
        register : bool, optional
            Fit the template also to a mesh whose triangles are the target's, as if it were a scan.

        Returns
        -------
        ndarray of shape (n_vertices, 3)
            Head frame, millimetres; to be given to `regress_expression` with `rig`.

        Raises
        ------
        ValueError
            For NaN, for vertices of another number without triangles, and as `fit_scan`.
        """
        if isinstance(sketch, TriangleMesh) and (register or not _alike(sketch, self.target)):
            V, _ = _fitted(self._face, sketch, self.preset)
            # the landmarks alone take an open jaw for a nod
            return find_alignment(self.rig, V).apply(V)
        V = sketch_positions(sketch)
        if V.shape != self.target.vertices.shape:
            raise ValueError(
                f"sketch has shape {V.shape}, but the target's mesh asks for "
                f"{self.target.vertices.shape}; give a sketch of another topology as a "
                "TriangleMesh with landmarks."
            )
        return V.copy() if self.fit is None else self._back.carry(self._to_head(V))

    def to_target(self, vertices):
        """An expression of the template on the target's own mesh, detail kept.

        Parameters
        ----------
        vertices : ndarray of shape (n_vertices, 3)
            In the topology of the template, head frame, millimetres.

        Returns
        -------
        ndarray of shape (n_target_vertices, 3)
            In the target's own frame, millimetres; exact for the neutral.
        """
        V = as_finite(vertices, "vertices", self.rig.neutral.vertices.shape)
        own = V.copy() if self.fit is None else self._forth.carry(V)
        if self.contact:
            own = self._contact.off(own)
        return self.fit.alignment.inverse().apply(own) if self.fit else own

    def bring_to_life(self, weights, unit_sequence=None, n_frames=30, fps=30):
        """A still expression as a motion from rest over its peak to rest.

        Parameters
        ----------
        weights : dict of str to float, or array_like of shape (n_units,)
            Of the expression.
        unit_sequence : callable (name, n_frames) -> ndarray (n_frames, n_vertices, 3), optional
            How each unit of the source goes from onset to offset, positions, millimetres, as
            `data_synth.action_units.ActionUnitRig.unit_sequence` gives it. Each is carried to the
            target frame by frame. If left out, units move on straight lines.
        n_frames : int, default=30
            At least 3; the peak is at two fifths of the way.
        fps : float, default=30

        Returns
        -------
        MotionSequence
            On the template, head frame.
        """
        if isinstance(weights, dict):
            weights = self.rig.weights_of(weights)
        w = as_finite(weights, "weights", (len(self.rig.names),))
        n_frames = check_count(n_frames, "n_frames", 3, None, "frames (onset, peak, offset)")
        moved = np.zeros((n_frames, *self.rig.neutral.vertices.shape))
        if unit_sequence is None:
            peak = min(max(round(0.4 * (n_frames - 1)), 1), n_frames - 2)
            level = np.interp(np.arange(n_frames), [0, peak, n_frames - 1], [0, 1, 0])
            level = level**2 * (3 - 2 * level)
            moved += level[:, None, None] * np.tensordot(w, self.rig.deltas, axes=1)
        else:
            for k in np.flatnonzero(w):
                name = self.rig.names[k]
                frames = unit_sequence(name, n_frames)
                frames = as_finite(frames, f"unit_sequence({name!r})", moved.shape)
                moved += w[k] * self.carrier.carry(frames - self.source.neutral.vertices)
        return MotionSequence(self.rig.neutral.vertices + moved, fps, self.rig.neutral)


class SimplifiedRig:
    """Action units on a simplified mesh, whose optimised vertices drive the full one.

    Parameters
    ----------
    rig : BlendshapeRig
        On the full mesh.
    n_vertices : int, default=397
        Of the simplified mesh.
    anchor_weight : float, default=0.5
        Pull of the simplified mesh's vertices, alpha of Eq. 12.
    weights : {"uniform", "cotangent"}
        Of the Laplacian, Eq. 11.

    Attributes
    ----------
    rig : BlendshapeRig
        On the simplified mesh: what `regress_expression` takes.
    samples : ndarray of int, shape (n_vertices,)
        Its vertices, as vertices of the full mesh.

    References
    ----------
    Yu and Liu 2014, section V.A.
    """

    def __init__(self, rig, n_vertices=397, anchor_weight=0.5, weights="uniform"):
        check_type(rig, "rig", BlendshapeRig, "give units on the full mesh")
        check_face_size(rig.neutral.vertices, "rig")
        self.samples, mesh = rig.neutral.subsample(n_vertices)
        self.rig = rig.on(self.samples, mesh)
        self._deformer = LaplacianDeformer(rig.neutral, self.samples, anchor_weight, weights)

    def drive(self, vertices):
        """The full mesh, (n_full, 3), led by the simplified one's (n_vertices, 3), millimetres."""
        return self._deformer.deform(vertices)
