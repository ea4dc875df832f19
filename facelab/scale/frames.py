"""Frames of many takes as one Dask array, read where they are worked on."""

from dataclasses import dataclass, field

import numpy as np

from facelab.files import read_motion
from facelab.geometry.mesh import TriangleMesh
from facelab.scale.spread import each


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of several takes on one mesh.

    Parameters
    ----------
    X : dask.array.Array of shape (n_frames, 3 * n_vertices)
        Displacements from the neutral of all valid frames, millimetres; one block a take.
    mesh : TriangleMesh
        The neutral, that of the first take.
    fps : float
        Of the first take.
    failed : dict of str to str
        Takes that could not be read, or do not go with the first, and why.
    """

    X: object = field(repr=False)
    mesh: TriangleMesh
    fps: float
    failed: dict

    @property
    def positions(self):
        """Where the vertices are: Dask array of shape (n_frames, n_vertices, 3)."""
        V = self.mesh.vertices
        return self.X.reshape(len(self.X), *V.shape) + V


def frames_of(paths, client, samples=None, control=None):
    """The frames of takes that were registered, as one Dask array.

    Nothing is kept: each block is read by the worker that needs it. A take that cannot be read is
    left out, and named.

    Parameters
    ----------
    paths : sequence of str or Path
        Motions as `facelab register` and `files.write_motion` leave them; the workers see them.
    client : distributed.Client
        From `cluster`.
    samples : array_like of int, optional
        Only these vertices, which are those of the mesh `control`.
    control : TriangleMesh, optional

    Returns
    -------
    Frames

    Raises
    ------
    ValueError
        If not one take can be read.
    """
    import dask.array as da
    from dask import delayed

    paths = [str(path) for path in paths]
    seen, failed = {}, {}
    for i, found, error in each(_look, paths, client):
        if error is None:
            seen[i] = found
        else:
            failed[paths[i]] = str(error)
    good = sorted(seen)
    if not good:
        raise ValueError(f"not one take can be used: {next(iter(failed.values()), 'none given')}")
    _, mesh, fps = seen[good[0]]
    for i in good[1:]:
        if not _same(mesh, seen[i][1]):
            failed[paths[i]] = (
                f"{paths[i]} moves another neutral than {paths[good[0]]}; register the takes of "
                "one person with one --rest."
            )
    good = [i for i in good if paths[i] not in failed]
    n = mesh.n_vertices if samples is None else len(samples)
    blocks = [
        da.from_delayed(delayed(_read)(paths[i], samples), (seen[i][0], 3 * n), float) for i in good
    ]
    return Frames(da.concatenate(blocks), control or mesh, fps, failed)


def _look(path):
    motion = read_motion(path)
    return int(motion.valid.sum()), motion.mesh, motion.fps


def _read(path, samples):
    motion = read_motion(path)
    X = motion.displacements()
    if samples is not None:
        X = X.reshape(len(X), -1, 3)[:, samples].reshape(len(X), -1)
    return X


def _same(a, b):
    return np.array_equal(a.faces, b.faces) and np.allclose(a.vertices, b.vertices, atol=1e-3)
