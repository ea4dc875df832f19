import numpy as np
import pytest

from facelab.studies.figure5 import ErrorGrid
from facelab.widgets import ErrorView


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
