"""The benchmark's models on a real optical capture: markers only, each left out in turn.

There is no dense truth, and 41 markers have 123 coordinates: models are smaller than that.
"""

import numpy as np
from scipy.spatial import Delaunay

from facelab.geometry.mesh import TriangleMesh
from facelab.models.evaluation import rms_error
from facelab.models.global_local import GlobalLocalModel
from facelab.models.holistic import HolisticModel
from facelab.models.region import RegionModel
from facelab.motion import MotionSequence
from facelab.segmentation.segment import segment_face
from facelab.studies import few_markers
from facelab.studies.benchmark_data import NOISE

MARKER_SIZES = (5, 10, 20, 40, 80)
"""Parameters in all."""

MARKER_REGIONS = 5


def marker_models(X, mesh, sizes=MARKER_SIZES):
    """Models of markers by family, one after another; X is (n_frames, 3 * n_markers)."""
    motion = MotionSequence(X.reshape(len(X), -1, 3) + mesh.vertices, 15.0, mesh)
    regions = segment_face(motion, n_regions=MARKER_REGIONS, random_state=0, progress=False)
    whole = HolisticModel(max(sizes)).fit(X)
    split = RegionModel(regions, max(sizes)).fit(X)
    for n in sizes:
        yield "holistic", whole.truncated(n)
        yield "regions", split.truncated(n, "total")
        yield "global and local", GlobalLocalModel(regions, n).fit(X)


def left_out_error(model, X):
    """Error at markers that are left out, each told from the others, RMS over all, millimetres.

    The coefficients are the likeliest where each has the variance of training and each marker an
    error of `NOISE` an axis, with the boundary term of Eq. 6.
    """
    basis, moved = model.basis, X.reshape(len(X), -1, 3)
    _, deviations = model.training()
    A = model.beta * model.boundary()
    A += NOISE**2 * np.diag(1 / np.maximum(deviations, 1e-6) ** 2)
    off = moved - model.mean_.reshape(-1, 3)
    errors = []
    for i in range(model.n_vertices):
        B = np.delete(basis, i, axis=1).reshape(len(basis), -1)
        rest = np.delete(off, i, axis=1).reshape(len(off), -1)
        c = np.linalg.solve(A + B @ B.T, B @ rest.T).T
        errors.append(off[:, i] - np.tensordot(c, basis[:, i], axes=1))
    return float(np.sqrt((np.array(errors) ** 2).sum(axis=2).mean()))


def capture_rows(sizes=MARKER_SIZES):
    """Left-out markers of the real capture: the first halves of both takes asked about the second.

    Returns
    -------
    list of dict
        A row for each take, model and size; `seen_mm` is the error where all markers are seen.
        Ways without a model have no size.

    Raises
    ------
    DataUnavailable
    """
    fit, takes = few_markers.real_fit()
    moved = {name: few_markers.moved_markers(fit, take) for name, take in takes.items()}
    mesh = TriangleMesh(fit.rest, Delaunay(fit.rest[:, :2]).simplices)
    X = np.concatenate([x[: len(x) // 2].reshape(len(x) // 2, -1) for x in moved.values()])
    models = list(marker_models(X, mesh, sizes))
    rows = []

    def add(test, family, model, left_out, seen):
        size = None if model is None else model.n_coefficients
        about = dict(data="real capture", training="first halves", test=f"{test}, second half")
        errors = dict(left_out_mm=round(float(left_out), 3), seen_mm=seen and round(seen, 3))
        rows.append(about | dict(model=family, parameters=size) | errors)

    for test, x in moved.items():
        asked = x[len(x) // 2 :]
        for way, e in few_markers.left_out({"warp": fit}, asked).items():
            add(test, way, None, few_markers.rms(e), None)
        flat = asked.reshape(len(asked), -1)
        for family, model in models:
            seen = rms_error(flat, model.reconstruct(flat))
            add(test, family, model, left_out_error(model, flat), seen)
    return rows
