import numpy as np
import pytest
from matplotlib.colors import to_rgb
from shown import shown

from facelab.studies.figure5 import ErrorGrid
from facelab.widgets import ErrorView
from facelab.widgets.error_view import _COLORS


@pytest.fixture
def grid():
    rng = np.random.default_rng(0)
    region, as_many = rng.uniform(0.2, 1, size=(2, 2, 3, 2))
    return ErrorGrid((5, 13), (1, 5, 10), region, rng.uniform(0.2, 1, size=(3, 2)), as_many)


def test_bars_are_the_errors_of_what_the_sliders_say(grid):
    view = ErrorView(grid, ["M1", "F1"], 1)
    view.regions.value, view.components.value = 1, 2
    assert view.errors == {
        "13 regions, 10 components each": grid.region[1, 2, 1],
        "whole face, 10 components": grid.holistic[2, 1],
        "whole face, 130 components": grid.as_many[1, 2, 1],
    }
    assert f"{grid.region[1, 2, 1]:.3f} mm" in view._bars.value
    assert "130 parameters" in view._status.value
    view.person.value = 0
    assert view.errors["whole face, 10 components"] == grid.holistic[2, 0]


def test_a_person_who_is_not_there_is_refused(grid):
    with pytest.raises(ValueError, match="person=2"):
        ErrorView(grid, ["M1", "F1"], 2)


def test_where_it_does_not_run_a_notebook_has_bars_as_long_as_the_errors(grid, monkeypatch):
    view = ErrorView(grid, ["M1", "F1"], 1)
    view.components.value = 2
    still, image, _ = shown(view, monkeypatch)
    assert "tested on F1" in still
    lengths = [
        np.isclose(image, to_rgb(color), atol=0.01).all(axis=2).sum(axis=1).max()
        for color in _COLORS
    ]
    errors = np.array(list(view.errors.values()))
    np.testing.assert_allclose(np.divide(lengths, lengths[0]), errors / errors[0], rtol=0.03)
