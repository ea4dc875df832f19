"""The example under every name of the top level runs, and says what it did before."""

import doctest
import inspect
import os

import pytest

import facelab

NAMES = [n for n in facelab.__all__ if not inspect.ismodule(getattr(facelab, n))]
FILES = [
    n for n in facelab.files.__all__ if ">>>" in (inspect.getdoc(getattr(facelab.files, n)) or "")
]
DOWNLOADED = {
    "load_ict_facekit": "FACELAB_ICT",
    "load_markers": "FACELAB_ANIMFACE",
    "load_take": "FACELAB_CAPTURES",
}


@pytest.mark.parametrize("name", NAMES)
def test_the_example_of_every_public_name_runs(name, tmp_path, monkeypatch):
    if name in DOWNLOADED and not os.environ.get(DOWNLOADED[name]):
        pytest.skip(f"{DOWNLOADED[name]} is not set: the data of {name} are not on this machine")
    monkeypatch.chdir(tmp_path)  # what an example writes goes away again
    run_example(f"facelab.{name}", getattr(facelab, name))


@pytest.mark.parametrize("name", FILES)
def test_the_examples_of_files_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_example(f"facelab.files.{name}", getattr(facelab.files, name))


def run_example(name, thing):
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(thing), {}, name, None, None)
    assert test.examples, f"{name} has no example (>>>) in its docstring"
    said = []
    doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert not said, "".join(said)
