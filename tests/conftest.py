"""What many tests share: one seeded generator, small meshes, and the real data where it is."""

import os
from pathlib import Path

import numpy as np
import pytest
from shapes import disk_mesh, grid_mesh, sphere_mesh

from facelab.geometry.mesh import TriangleMesh


@pytest.fixture
def rng():
    return np.random.default_rng(20110807)


@pytest.fixture
def grid():
    return grid_mesh(6, 5)


@pytest.fixture
def holed_disk():
    return disk_mesh(12, 48, inner=10.0, outer=40.0)


@pytest.fixture
def sphere():
    return sphere_mesh(3, radius=50.0)


@pytest.fixture
def bumpy(rng):
    """A curved patch of uneven triangles, with landmarks: nothing in it is special."""
    flat = grid_mesh(7, 6, spacing=10.0)
    V = flat.vertices + rng.normal(scale=1.5, size=flat.vertices.shape)
    return TriangleMesh(V, flat.faces, {"nose_tip": 17, "chin": 3})


@pytest.fixture(scope="session")
def ict_root():
    root = os.environ.get("FACELAB_ICT")
    if not root:
        pytest.skip("FACELAB_ICT is not set: no clone of ICT-FaceKit on this machine")
    return Path(root)


@pytest.fixture(scope="session")
def ict_cache(ict_root, tmp_path_factory):
    """A cache folder of this run; the files of ICT-FaceKit are parsed into it once."""
    from facelab.data.ict import load_ict_facekit

    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FACELAB_CACHE", str(folder))
        load_ict_facekit(ict_root)
    return folder


@pytest.fixture(scope="session")
def real_rig(ict_root, ict_cache):
    """The narrow face of ICT-FaceKit with its 53 expressions."""
    from facelab.data.ict import load_ict_facekit

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FACELAB_CACHE", str(ict_cache))
        return load_ict_facekit(ict_root)


@pytest.fixture(scope="session")
def captures_root():
    root = os.environ.get("FACELAB_CAPTURES")
    if not root:
        pytest.skip("FACELAB_CAPTURES is not set: no recorded takes on this machine")
    return Path(root)


@pytest.fixture(scope="session")
def real_takes(captures_root):
    """Both recorded takes by name."""
    from facelab.data.takes import TAKES, load_take

    return {name: load_take(name, captures_root) for name in TAKES}
