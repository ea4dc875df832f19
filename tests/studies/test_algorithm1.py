"""Algorithm 1 as printed: what alpha gains once the error is measured after the deformation."""

import numpy as np
import pytest

from facelab.expression import SimplifiedRig, prepare_units, regress_expression
from facelab.studies.algorithm1 import EPSILON, algorithm_1
from facelab.studies.expression_trials import spoil


@pytest.fixture(scope="module")
def actor():
    from data_synth.action_units import actor_rig

    return actor_rig("M1", 1500).linear()


@pytest.fixture(scope="module")
def sketch(actor):
    return spoil(actor.neutral, actor.shape({"AU12L": 0.8, "AU4": 0.6}), 0.3, 4, random_state=0)


def test_on_the_full_mesh_no_alpha_beats_the_plain_bounded_fit(actor, sketch):
    found = algorithm_1(actor, sketch, alphas=np.arange(0, 8, 0.25))
    assert -1e-3 < found.gain <= 1e-12
    fit = regress_expression(actor, sketch, 0.015, np.arange(0, 8, 0.25))
    np.testing.assert_allclose(found.rms, fit.rms, rtol=1e-9)
    np.testing.assert_allclose(found.e_rms, fit.e_rms, rtol=1e-9)


def test_on_a_simplified_mesh_an_alpha_may_win_but_next_to_nothing(actor, sketch):
    found = algorithm_1(actor, sketch, n_vertices=300)
    assert abs(found.gain) < 0.005
    assert len(found.alphas) == 101 and found.faces.shape == (101, 1500, 3)
    np.testing.assert_array_equal(found.within, found.rms <= EPSILON * np.sqrt(1500))


def test_the_error_is_that_of_the_deformed_mesh(actor, sketch):
    found = algorithm_1(actor, sketch, lam=0.1, alphas=[3], n_vertices=300)
    simple = SimplifiedRig(actor, 300)
    fit = regress_expression(prepare_units(simple.rig), sketch[simple.samples], 0.1, [3])
    off = simple.drive(fit.vertices(0)) - sketch
    assert found.rms[0] == pytest.approx(np.sqrt((off**2).sum() / 1500), rel=1e-12)
