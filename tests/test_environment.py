"""The lists of requirements agree with pyproject.toml, from which all are made."""

import re
import tomllib

import pytest
from environment import ROOT, environment_yml

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
REQUIREMENTS = PROJECT["dependencies"] + PROJECT["optional-dependencies"]["test"]


def _numbers(version):
    return [int(part) for part in re.findall(r"\d+", version)]


def test_environment_yml_is_what_pyproject_makes():
    assert (ROOT / "environment.yml").read_text() == environment_yml()


@pytest.mark.parametrize("requirement", REQUIREMENTS)
def test_every_requirement_is_in_environment_yml_with_its_bound(requirement):
    lines = [line.strip() for line in (ROOT / "environment.yml").read_text().splitlines()]
    assert f"- {requirement}" in lines


@pytest.mark.parametrize("requirement", REQUIREMENTS)
def test_every_requirement_is_locked_to_a_version_that_satisfies_it(requirement):
    name, least = requirement.split(">=")
    lock = (ROOT / "requirements.lock").read_text()
    locked = re.findall(rf"^{re.escape(name)}==([\w.]+)", lock, flags=re.MULTILINE)
    assert locked, f"{name} is not in requirements.lock: run `make lock`"
    assert all(_numbers(version) >= _numbers(least) for version in locked)


@pytest.mark.parametrize(
    "line", (ROOT / "requirements.lock").read_text().splitlines(), ids=lambda s: s.split("==")[0]
)
def test_every_line_of_the_lock_pins_one_exact_version(line):
    assert re.fullmatch(r"[a-z0-9-]+==[\w.]+( ; [\w .<>=!'()]+)?", line)


def test_python_bound_is_the_same_everywhere():
    bound = PROJECT["requires-python"]
    assert f"- python{bound},<3.14\n" in (ROOT / "environment.yml").read_text()
