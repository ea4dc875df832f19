"""A rig of one's own in the posing lab, and the mixtures that a region model learns from."""

import numpy as np
import pytest
from planted import bumpy_rig

from facelab.motion import WeightSequence
from facelab.rig import BlendshapeRig
from facelab.widgets.own_face import own_face


@pytest.fixture
def sided():
    """A rig whose jaw goes left and right, and whose two smiles are on two sides."""
    rig = bumpy_rig()
    deltas = np.zeros((5, rig.neutral.n_vertices, 3))
    deltas[0, :40, 0], deltas[1, :40, 0] = 3.0, -3.0
    deltas[2, 40:60, 1], deltas[3, 60:80, 1] = 2.0, 2.0
    names = ("jawLeft", "jawRight", "mouthSmileLeft", "mouthSmile_R", "nothing")
    return BlendshapeRig(rig.neutral, names, deltas)


def test_shapes_that_undo_each_other_never_meet(sided):
    W = sided.plausible_mixtures(500).weights
    assert (W[:, 0] > 0).any() and (W[:, 1] > 0).any()
    assert not ((W[:, 0] > 0) & (W[:, 1] > 0)).any()


def test_both_sides_of_a_unit_move_together_in_most_frames_and_nearly_alike(sided):
    left, right = sided.plausible_mixtures(500).weights[:, 2:4].T
    one, both = (left > 0) ^ (right > 0), (left > 0) & (right > 0)
    assert 0.05 < one.sum() / (one | both).sum() < 0.4
    assert np.median(np.abs(left - right)[both]) < 0.2


def test_weights_are_those_of_a_face_and_the_same_each_time(sided):
    take = sided.plausible_mixtures(300, random_state=4)
    assert take.weights.min() >= 0 and 0.5 < take.weights.max() <= 1
    assert not take.weights[:, 4].any()  # a shape that moves nothing is no unit
    np.testing.assert_array_equal(
        take.weights, sided.plausible_mixtures(300, random_state=4).weights
    )
    assert not np.array_equal(take.weights, sided.plausible_mixtures(300).weights)


@pytest.mark.parametrize("weight, lost", [(0.0, False), (0.7, False), (0.7, True)])
def test_a_take_that_holds_the_face_still_teaches_nothing(sided, weight, lost):
    W = np.full((40, 5), weight)
    W[0] = 0 if lost else weight
    valid = np.arange(40) > 0
    with pytest.raises(ValueError, match="moves the rig by 0 mm in 39 valid frames"):
        own_face(sided, WeightSequence(W, sided.names, 30, valid))
