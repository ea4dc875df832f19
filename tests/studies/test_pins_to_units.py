"""With no pins the face stays at rest: the chain's error is the motion itself."""

import numpy as np
import pytest

from facelab import BlendshapeRig
from facelab.studies import pins_to_units


def test_without_a_pin_nothing_is_told(bumpy, rng):
    rig = BlendshapeRig(bumpy, ("a", "b"), rng.normal(size=(2, bumpy.n_vertices, 3)))
    face, weights = pins_to_units.chain(None, rig, None, np.array([0.5, 0.1]), 0)
    moved = 0.5 * rig.deltas[0] + 0.1 * rig.deltas[1]
    assert face == pytest.approx(np.sqrt((moved**2).sum(axis=1).mean()))
    assert weights == pytest.approx(0.3)


def test_rows_are_means_over_frames(bumpy, rng):
    rig = BlendshapeRig(bumpy, ("a", "b"), rng.normal(size=(2, bumpy.n_vertices, 3)))
    frames = np.array([[0.5, 0.1], [0.2, 0.6]])
    ((n, face, weights),) = pins_to_units.table(None, rig, None, frames, (0,))
    each = [pins_to_units.chain(None, rig, None, w, 0) for w in frames]
    assert n == 0 and [face, weights] == pytest.approx(list(np.mean(each, axis=0)))
