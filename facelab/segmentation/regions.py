"""Regions of a face and their shared boundaries."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from facelab.checks import as_indices, check_choice, check_count, check_type
from facelab.geometry.mesh import TriangleMesh
from facelab.segmentation.clusters import as_labels


@dataclass(frozen=True, eq=False)
class Regions:
    """A face cut into regions that share vertices along their boundaries.

    Parameters
    ----------
    labels : ndarray of int, shape (n_vertices,)
        The one region each vertex belongs to of itself, 0 to n_regions - 1.
    mesh : TriangleMesh
    sharing : {"one-sided", "both", "none"}
        For every edge that crosses from region i to a later region j: the end in i belongs to j
        too; both ends belong to both; nothing is shared.
    rings : int, default=1
        Width of the shared band in edges.
    tried : tuple of Compactness
        What was seen while the number of regions grew.
    why : str
        In words, why there are as many regions as there are.
    held : ndarray of bool, shape (n_regions, n_vertices), optional
        Which region holds which vertex, if not by the rule of `sharing` on this mesh.
    samples : ndarray of int, optional
        The vertices between which the shared bands were drawn, if not all of this mesh: those of
        the control mesh that the regions were carried over from.

    Raises
    ------
    ValueError
        If a label is missing or a vertex has none, or if `held` leaves a vertex out of its region.

    References
    ----------
    Tena et al. 2011, section 3.1: regions share boundary vertices. Their authors chose them by
    hand; the rule here is ours.
    """

    labels: np.ndarray
    mesh: TriangleMesh
    sharing: str = "one-sided"
    rings: int = 1
    tried: tuple = ()
    held: np.ndarray = None
    samples: np.ndarray = None
    why: str = "The labels were given."

    def __post_init__(self):
        labels = as_labels(self.labels, self.mesh)
        most = min(int(labels.max()) + 1, len(labels) + 5)  # a label may be any number at all
        missing = np.setdiff1d(np.arange(most), labels)[:5].tolist()
        if labels.min() < 0 or missing:
            raise ValueError(
                f"labels must use every number from 0 up; smallest {labels.min()}, "
                f"unused {missing}."
            )
        check_choice(self.sharing, "sharing", ("one-sided", "both", "none"))
        what = "edges across a shared band (to share nothing, set sharing='none')"
        check_count(self.rings, "rings", 1, None, what)
        object.__setattr__(self, "labels", labels)
        if self.held is not None:
            held, wanted = np.asarray(self.held), (self.n_regions, self.mesh.n_vertices)
            if held.shape != wanted or not held[labels, np.arange(wanted[1])].all():
                raise ValueError(
                    f"held has shape {held.shape}, but needs shape {wanted} and True for each "
                    "vertex in the region of its label."
                )
            object.__setattr__(self, "held", held.astype(bool))

    def __repr__(self):
        return (
            f"Regions({self.n_regions} on {self.mesh.n_vertices} vertices, "
            f"{100 * self.shared_share:.0f} % of them shared)"
        )

    @property
    def n_regions(self):
        """M: number of regions."""
        return int(self.labels.max()) + 1

    @property
    def order(self):
        """Vertices sorted by region, to show a matrix as blocks: A[np.ix_(order, order)]."""
        return np.argsort(self.labels, kind="stable")

    @cached_property
    def members(self):
        """Vertices of each region, its own and the shared ones, ascending: list of int arrays."""
        if self.held is not None:
            return [np.flatnonzero(m) for m in self.held]
        member = np.zeros((self.n_regions, self.mesh.n_vertices), dtype=bool)
        member[self.labels, np.arange(self.mesh.n_vertices)] = True
        if self.sharing != "none":
            a, b = self.mesh.edges.T
            both = np.vstack([np.stack([a, b], axis=1), np.stack([b, a], axis=1)])
            for _ in range(self.rings):
                grown = member.copy()
                for i in range(self.n_regions):
                    reached = both[member[i][both[:, 0]], 1]
                    if self.sharing == "one-sided":  # only later regions reach into earlier ones
                        reached = reached[self.labels[reached] <= i]
                    grown[i, reached] = True
                if (grown == member).all():
                    break  # bands wider than the face are as wide as the face
                member = grown
        return [np.flatnonzero(m) for m in member]

    @cached_property
    def holders(self):
        """Number of regions that hold each vertex: ndarray of int, shape (n_vertices,)."""
        return np.bincount(np.concatenate(self.members), minlength=self.mesh.n_vertices)

    @property
    def shared_share(self):
        """Share of the vertices that more than one region holds, 0 to 1."""
        return float((self.holders > 1).mean())

    def carried_to(self, mesh, samples):
        """The same regions on a dense mesh: each vertex is held by those of its nearest sample.

        The shared bands keep their width in millimetres. Drawn anew along the finer edges they
        would be narrower, regions would hang together less, and a vertex shared on the control
        mesh would be one region's alone on the dense one.

        Parameters
        ----------
        mesh : TriangleMesh
            The dense mesh.
        samples : ndarray of int, shape (n_vertices of these regions,)
            Where the vertices of these regions lie on it.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If there is not one sample for each vertex of these regions.
        """
        check_type(mesh, "mesh", TriangleMesh, "give the dense mesh")
        if len(np.atleast_1d(samples)) != self.mesh.n_vertices:
            raise ValueError(
                f"samples names {len(np.atleast_1d(samples))} vertices, but these regions lie on "
                f"{self.mesh.n_vertices}; give the place of each of them on the dense mesh."
            )
        nearest = mesh.nearest_of(samples)
        held = np.zeros((self.n_regions, self.mesh.n_vertices), dtype=bool)
        for region, vertices in zip(held, self.members, strict=True):
            region[vertices] = True
        samples = np.asarray(samples)
        drawn = samples if self.samples is None else samples[self.samples]
        return replace(
            self, labels=self.labels[nearest], mesh=mesh, held=held[:, nearest], samples=drawn
        )

    def packed(self):
        """Arrays from which `unpacked` makes the same regions: dict of str to array.

        What the segmentation tried is not kept.
        """
        mesh = self.mesh
        arrays = dict(
            labels=self.labels,
            vertices=mesh.vertices,
            faces=mesh.faces,
            landmark_names=np.array(list(mesh.landmarks), dtype=str),
            landmarks=np.array(list(mesh.landmarks.values()), dtype=int),
            sharing=self.sharing,
            rings=self.rings,
        )
        if self.held is not None:
            arrays["held"] = self.held
        if self.samples is not None:
            arrays["samples"] = self.samples
        return arrays

    @classmethod
    def unpacked(cls, stored):
        """Regions from the arrays of `packed` in a file.

        Parameters
        ----------
        stored : StoredArrays
            Open; sizes are compared before an array is read.

        Raises
        ------
        ValueError, TypeError
            For arrays that are missing, do not fit together or make no regions of a mesh.
        """
        vertices = stored.read("vertices", ("n_vertices", 3), "f")
        n = len(vertices)
        names = stored.read("landmark_names", ("n_landmarks",), "U").tolist()
        places = stored.read("landmarks", (len(names),), "iu").tolist()
        if len(set(names)) < len(names):
            raise ValueError("landmark_names holds a name twice")
        mesh = TriangleMesh(
            vertices,
            stored.read("faces", ("n_faces", 3), "iu"),
            dict(zip(names, places, strict=True)),
        )
        labels = stored.read("labels", (n,), "iu")
        held = samples = None
        if "held" in stored:
            held = stored.read("held", (int(labels.max(initial=0)) + 1, n), "b")
        if "samples" in stored:
            samples = stored.read("samples", ("n_samples",), "iu")
            samples = as_indices(samples, "samples", n, "vertices of the mesh")
        rings = int(stored.read("rings", (), "iu"))
        return cls(
            labels, mesh, str(stored.read("sharing", (), "U")), rings, held=held, samples=samples
        )
