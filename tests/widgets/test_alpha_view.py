import time

import numpy as np
import pytest
from planted import bumpy_rig
from shown import shown

from facelab.expression import prepare_units, regress_expression
from facelab.widgets import AlphaView


@pytest.fixture(scope="module")
def fits():
    basis = prepare_units(bumpy_rig())
    V = basis.rig.shape({basis.rig.names[0]: 0.8, basis.rig.names[5]: 0.4})
    rough = V + np.random.default_rng(0).normal(scale=0.5, size=V.shape)
    return {
        (twist, lam): regress_expression(basis, sketch, lam, [0, 1, 2, 5])
        for twist, sketch in ((0.0, V), (4.0, rough))
        for lam in (0.01, 1.0)
    }


def test_sliders_show_the_fit_that_was_made_for_them(fits):
    view = AlphaView(fits)
    view.lam.value, view.twist.value, view.alpha.value = 1.0, 4.0, 2
    fit = fits[4.0, 1.0]
    assert view.fit is fit
    np.testing.assert_allclose(view.view.vertices, fit.vertices(2), atol=1e-4)
    assert f"{fit.rms[2]:.3f} mm" in view._status.value
    view.sketch.value = True
    wanted = fit.basis.rig.neutral.vertices + fit.displacement
    np.testing.assert_allclose(view.view.vertices, wanted, atol=1e-4)


def test_the_strongest_mover_is_named_first(fits):
    view = AlphaView(fits)
    view.alpha.value = 1
    fit = fits[0.0, 0.01]
    moves = fit.weights[1] * np.linalg.norm(fit.basis.rig.deltas, axis=(1, 2))
    assert f"<br>{fit.names[int(moves.argmax())]} " in view._status.value


def test_an_answer_made_beforehand_takes_no_time_to_speak_of(fits):
    view = AlphaView(fits)
    took = []
    for i in (1, 2, 3) * 3:
        start = time.process_time()
        view.alpha.value = i
        took.append(time.process_time() - start)
    assert min(took) < 0.1


def test_pairs_that_lack_and_what_is_no_fit_are_refused(fits):
    some = dict(list(fits.items())[:3])
    with pytest.raises(ValueError, match=r"fits lacks \[\(4.0, 1.0\)\]"):
        AlphaView(some)
    with pytest.raises(TypeError, match="fits"):
        AlphaView({(0.0, 1.0): "fit"})


def test_where_it_does_not_run_a_notebook_has_the_face_as_the_sliders_stood(fits, monkeypatch):
    view = AlphaView(fits)
    _, at_rest, _ = shown(view, monkeypatch)
    view.twist.value, view.alpha.value = 4.0, 2
    still, image, _ = shown(view, monkeypatch)
    rms = f"{fits[4.0, 0.01].rms[2]:.3f} mm"
    assert f"α 2, λ 0.01 mm, twists 4 mm: {rms} from the sketch." in still
    assert at_rest.shape == image.shape and not np.array_equal(at_rest, image)
