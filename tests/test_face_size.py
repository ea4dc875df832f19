"""A face whose size is no face's is noticed by all that take it for one."""

import warnings

import numpy as np
import pytest
from planted import bumps, quarters

import facelab
from facelab.geometry.mesh import TriangleMesh


def takers(k, folder=None):
    """What takes a face, by name, on one whose unit of length has 1 / k to the millimetre."""
    mesh, labels = quarters()
    mesh = TriangleMesh(mesh.vertices * (k * 200 / np.ptp(mesh.vertices, axis=0).max()), mesh.faces)
    X = k * bumps(mesh, labels, np.random.default_rng(1))
    motion = facelab.MotionSequence(mesh.vertices + X.reshape(len(X), -1, 3), 30.0, mesh)
    rig = facelab.BlendshapeRig(mesh, ["a", "b"], X[:2].reshape(2, -1, 3))
    model = facelab.HolisticModel(3).fit(X)
    take = facelab.WeightSequence([[0.5, 0.2]], ["a", "b"], fps=30)
    cut = dict(n_regions=2, random_state=0, progress=False)
    return {
        "segment_face": lambda: facelab.segment_face(motion, **cut),
        "PosingSession": lambda: facelab.PosingSession(model, mesh),
        "regress_expression": lambda: facelab.expression.prepare_units(rig, still="drop"),
        "animate": lambda: rig.animate(take),
        "write_rig": lambda: facelab.files.write_rig(folder / "rig.npz", rig),
        "SimplifiedRig": lambda: facelab.expression.SimplifiedRig(rig, 20),
        "IntermediateSpace": lambda: facelab.IntermediateSpace(rig, mesh),
    }


@pytest.mark.parametrize("name", takers(1.0))
def test_metres_and_centimetres_are_noticed_with_the_factor(name, tmp_path):
    for k, factor in ((0.001, "1000"), (0.1, "10")):
        with pytest.warns(UserWarning, match=rf"multiply its lengths by {factor}\b"):
            try:
                takers(k, tmp_path)[name]()
            except ValueError:  # in metres all units are still
                pass
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*longest side.*")
        takers(1.0, tmp_path)[name]()
