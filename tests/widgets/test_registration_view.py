import numpy as np
import pytest
from shown import shown

import facelab
from facelab.looks import face_props, lids_off
from facelab.widgets import RegistrationView


@pytest.fixture(scope="module")
def actor():
    return facelab.load_registered("F1", size="small", progress=False)


@pytest.fixture
def view(actor):
    return RegistrationView(actor, "rage_5")


def test_a_frame_shows_the_registered_skin_and_the_markers_left(view, actor):
    view.slider.value = 40
    n = actor.fit.mesh.n_vertices
    skin = view.view._position.array[:n]
    registered = view.registration.positions([40])[0]
    expected = lids_off(face_props(actor.fit.mesh), registered)  # an eye is not cut by its lids
    assert (expected == registered).all(axis=1).mean() > 0.95
    np.testing.assert_allclose(skin, expected, atol=1e-3)
    seen = actor.capture.markers("rage_5").select(actor.fit.names).visible[40].sum()
    assert f"{seen} of {len(actor.fit.names)} markers" in view._status.value


def test_hiding_markers_registers_anew_and_raises_the_error(view):
    def error():
        return float(view._status.value.split("off by ")[1].split(" mm")[0])

    view.slider.value = 60
    before, text = view.registration, error()
    view.missing.value = 0.6
    assert view.registration is not before
    assert np.isfinite(view._markers[60, :, 0]).mean() < 0.7 and error() > text
    view.missing.value = 0.0
    np.testing.assert_array_equal(view.registration.displacements, before.displacements)


def test_an_error_is_shown_and_the_face_stays(view, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("the markers are on strike")

    before = view.registration
    monkeypatch.setattr("facelab.widgets.registration_view.register_sequence", fail)
    view.missing.value = 0.3
    assert "on strike" in view._message.value and view.registration is before
    monkeypatch.undo()
    view.slider.value = 10
    assert view._message.value == ""


def test_other_kinds_and_unknown_takes_are_refused(actor):
    with pytest.raises(TypeError, match="actor is a str"):
        RegistrationView("F1", "rage_5")
    with pytest.raises(ValueError, match="rage_99"):
        RegistrationView(actor, "rage_99")


def test_where_it_does_not_run_a_notebook_has_the_frame_on_screen(view, monkeypatch):
    view.slider.value = 40
    still, colored, _ = shown(view, monkeypatch)
    assert "Frame 40, 0% missing; white 0, dark blue 2 mm off." in still
    view.colored.value = False
    still, plain, _ = shown(view, monkeypatch)
    assert "Frame 40, 0% missing." in still and not np.array_equal(colored[:500], plain[:500])
