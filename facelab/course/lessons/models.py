"""The notebook on models: regions against the whole face, on unseen frames and other people."""

import numpy as np

from facelab.course.exercises import Exercise, number
from facelab.course.settings import Setting

SETTINGS = {
    "person": Setting("F1", choices=("M1", "F1", "M2", "F2")),
    "n_components": Setting(10, within=(1, 40)),
    "beta": Setting(0.5, within=(0, 100)),
    "gamma": Setting(0.025, within=(0.001, 10)),
}
OTHERS = ({"person": "M2"}, {"n_components": 3}, {"beta": 5.0}, {"gamma": 0.5})


def half_gap(answer, gap_at):
    beta = number(answer, "a value of β")
    if not 0 <= beta <= 1e6:
        return "β is 0 or more, and a million is the most"
    left = gap_at(beta) / gap_at(0)
    if abs(left - 0.5) < 0.025:
        return None
    return f"{100 * left:.0f} % of the gap is left; {'larger' if left > 0.5 else 'smaller'} β"


def parameters(answer, n_regions, n_components):
    off = number(answer, "a number of parameters") - n_regions * n_components
    if off == 0:
        return None
    if number(answer) == n_components:
        return "so many has the holistic model; every region has as many of its own"
    return f"too {'many' if off > 0 else 'few'}; each region has coefficients of its own"


def where_even(answer, grid, count, person):
    n = number(answer, "a number of components")
    if n not in grid.sizes:
        return f"the grid has {', '.join(map(str, grid.sizes))}"
    at = grid.region[grid.counts.index(count), :, person]
    best = grid.sizes[int(np.argmin(at))]
    if n == best:
        return None
    said = at[grid.sizes.index(int(n))]
    return f"{said:.3f} mm there, but {at.min():.3f} mm somewhere else; look along the row"


EXERCISES = (
    Exercise(
        1,
        half_gap,
        "agreement is bought with the error of each half",
        "Try 1, then 2. The gap falls steadily as β grows.",
        "answer = 1.7",
        ("answer = 0", "answer = 50", "answer = -1"),
    ),
    Exercise(
        2,
        parameters,
        "so many are keyed or sent for a frame; stored are as many as for the whole face",
        "Thirteen regions, each with its own coefficients.",
        "answer = regions.n_regions * n_components",
        ("answer = n_components", "answer = 1", "answer = 'many'"),
    ),
    Exercise(
        3,
        where_even,
        "how little the last columns differ is what the noise of the capture leaves to gain",
        "`grid.region[2]` is 13 regions: sizes down, actors across. Where is it smallest?",
        "answer = grid.sizes[int(np.argmin(grid.region[2, :, at]))]",
        ("answer = 1", "answer = 7"),
    ),
)
