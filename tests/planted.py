"""Faces whose regions and motion are known because we put them there."""

import numpy as np
from shapes import grid_mesh, sphere_mesh

from facelab.geometry.mesh import TriangleMesh
from facelab.motion import MotionSequence
from facelab.rig import BlendshapeRig
from facelab.segmentation.regions import Regions


def quarters(columns=12, rows=10, spacing=8.0):
    """A grid and the quarter that each vertex lies in, numbered by first vertex."""
    mesh = grid_mesh(columns, rows, spacing)
    row, column = np.divmod(np.arange(mesh.n_vertices), columns)
    return mesh, 2 * (row >= rows // 2) + (column >= columns // 2)


def patch_motion(mesh, labels, rng, n_frames=120, noise=0.05):
    """Every patch moves as a rigid whole, independently of the others, by about 2 mm."""
    signals = rng.normal(scale=2.0, size=(n_frames, labels.max() + 1, 3))
    shift = signals[:, labels] + rng.normal(scale=noise, size=(n_frames, mesh.n_vertices, 3))
    return MotionSequence(mesh.vertices + shift, 30.0, mesh)


def waves(mesh, labels, rng, n_frames=80, n_modes=3, scale=3.0):
    """Displacements (n_frames, 3 N): in every patch its own smooth modes with its own weights."""
    X = np.zeros((n_frames, mesh.n_vertices, 3))
    size = np.ptp(mesh.vertices, axis=0).max()
    for patch in range(labels.max() + 1):
        for _ in range(n_modes):
            k, phase = rng.normal(scale=4 / size, size=3), rng.uniform(0, 6, size=3)
            shape = np.cos(mesh.vertices @ k[:, None] + phase) * rng.normal(size=3)
            weight = rng.normal(scale=scale, size=n_frames)
            X += np.where((labels == patch)[:, None], shape, 0) * weight[:, None, None]
    X += rng.normal(size=(1, 1, 3))  # the mean is not the neutral
    return X.reshape(n_frames, -1)


def bumps(mesh, labels, rng, n_frames=80, width=18.0):
    """Displacements (n_frames, 3 N): two bumps on every patch, each rising by itself."""
    X = np.zeros((n_frames, mesh.n_vertices, 3))
    for patch in range(labels.max() + 1):
        centre = mesh.vertices[labels == patch].mean(axis=0)
        rise = np.exp(-((np.linalg.norm(mesh.vertices - centre, axis=1) / width) ** 2))
        for _ in range(2):
            X += rng.normal(scale=2, size=(n_frames, 1, 1)) * rise[:, None] * rng.normal(size=3)
    return X.reshape(n_frames, -1)


def relabelled(mesh, order):
    """The same mesh with vertex order[i] called i."""
    new = np.argsort(order)
    return TriangleMesh(mesh.vertices[order], new[mesh.faces])


def three_strips(columns=9, rows=5, sharing="one-sided", rings=1):
    """Regions on a bumpy grid: three strips beside each other, two boundaries."""
    mesh = grid_mesh(columns, rows, 10.0)
    labels = np.minimum((np.arange(mesh.n_vertices) % columns) * 3 // columns, 2)
    return Regions(labels, mesh, sharing, rings)


def corner_regions(sharing="one-sided"):
    """Four regions that meet around one place, so that some vertices have three holders."""
    mesh, labels = quarters(7, 6, 10.0)
    return Regions(labels, mesh, sharing)


def bumpy_rig():
    """Twelve overlapping bumps on a sphere of 162 vertices; nothing in it is symmetric."""
    rng = np.random.default_rng(3)
    mesh = sphere_mesh(2, radius=50.0)
    centres = mesh.vertices[rng.permutation(mesh.n_vertices)[:12]]
    near = np.exp(-((np.linalg.norm(mesh.vertices - centres[:, None], axis=2) / 35) ** 2))
    deltas = near[..., None] * rng.normal(scale=6, size=(12, 1, 3))
    return BlendshapeRig(mesh, [f"AU{i}" for i in range(12)], deltas)
