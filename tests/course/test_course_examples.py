"""The examples in the docstrings of the course and of its studies run, and say what they did."""

import doctest
from importlib import import_module

import pytest

MODULES = [
    *(f"facelab.course.{m}" for m in ("exercises", "lesson", "settings", "site", "tables", "toys")),
    "facelab.studies.captures",
]


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name):
    import numpy

    module = import_module(name)
    failed, tried = doctest.testmod(module, extraglobs={"np": numpy})
    assert tried and not failed
