"""Every notebook runs from top to bottom, its exercises answer, and other settings do not stop it."""

import re
from importlib import import_module

import pytest
from reader import NOTEBOOKS, lesson_of, run

from facelab.course.lesson import LESSONS


def plan(name):
    """The settings and exercises of a notebook; None for one that has no lesson."""
    if lesson_of(name) in LESSONS:
        return import_module(f"facelab.course.lessons.{lesson_of(name)}")
    return None


def two_at_once(others):
    """Settings put together by twos where they name different things: fewer runs."""
    runs = []
    for other in others:
        free = (r for r in runs if len(r) == 1 and r[0].keys().isdisjoint(other))
        if (found := next(free, None)) is None:
            runs.append([other])
        else:
            found.append(other)
    return [{k: v for other in run for k, v in other.items()} for run in runs]


OTHERS = [
    pytest.param(name, other, id=re.sub(r"\W+", "_", f"{name} {other}"))
    for name in NOTEBOOKS
    if plan(name)
    for other in two_at_once(plan(name).OTHERS)
]


@pytest.mark.long
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_its_exercises_tell_right_from_wrong(name):
    run(name, exercises=plan(name).EXERCISES if plan(name) else ())


@pytest.mark.long
@pytest.mark.parametrize(("name", "settings"), OTHERS)
def test_other_settings_never_stop_a_notebook(name, settings):
    run(name, settings)
