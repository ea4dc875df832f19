"""The small set of one actor, made once; and a size of its own that takes half a second."""

import pytest

from data_synth.action_units import actor_rig
from data_synth.capture import SIZES, make_capture, reading, store
from data_synth.capture.recording import Size

TINY = Size(30.0, SIZES["small"].n_vertices, ("pride_1", "rage_5"), 3.0, 2)


@pytest.fixture(scope="package")
def rig():
    return actor_rig("M1", SIZES["small"].n_vertices)


@pytest.fixture(scope="package")
def capture(tmp_path_factory, rig):
    """The small set of M1."""
    folder = tmp_path_factory.mktemp("captures") / "M1"
    return make_capture("M1", folder, "small", 0, rig, progress=False)


@pytest.fixture
def tiny(monkeypatch, rig):
    """A size of its own, made in half a second with the face at hand."""
    monkeypatch.setitem(SIZES, "tiny", TINY)
    for module in (reading, store):
        monkeypatch.setattr(module, "actor_rig", lambda actor, n_vertices: rig)
