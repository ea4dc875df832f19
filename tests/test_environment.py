"""The lists of requirements agree with pyproject.toml, from which all are made."""

import re
import warnings

import pytest
from environment import EXTRAS, PROJECT, REQUIREMENTS, ROOT, environment_yml

LOCK = (ROOT / "requirements.lock").read_text()
LOCKED = LOCK.replace("\\\n", "").splitlines()


def _numbers(version):
    return [int(part) for part in re.findall(r"\d+", version)]


def test_every_extra_is_locked():
    assert set(EXTRAS) == {"glb", "scale", "test"}


def test_environment_yml_is_what_pyproject_makes():
    assert (ROOT / "environment.yml").read_text() == environment_yml()


@pytest.mark.parametrize("requirement", REQUIREMENTS)
def test_every_requirement_is_in_environment_yml_with_its_bound(requirement):
    lines = [line.strip() for line in (ROOT / "environment.yml").read_text().splitlines()]
    assert f"- {requirement}" in lines


@pytest.mark.parametrize("requirement", REQUIREMENTS)
def test_every_requirement_is_locked_to_a_version_that_satisfies_it(requirement):
    name, least = requirement.split(">=")
    locked = re.findall(rf"^{re.escape(name.lower())}==([\w.]+)", LOCK, flags=re.MULTILINE)
    assert locked, f"{name} is not in requirements.lock: run `make lock`"
    assert all(_numbers(version) >= _numbers(least) for version in locked)


@pytest.mark.parametrize("line", LOCKED, ids=lambda line: line.split("==")[0])
def test_every_line_of_the_lock_pins_one_exact_version_by_checksums_and_no_place(line):
    pin = r"[a-z0-9-]+==[\w.]+( ; [\w .<>=!'()]+)?"
    assert re.fullmatch(rf"{pin} ( *--hash=sha256:[0-9a-f]{{64}})+ *", line)


def test_python_bound_is_the_same_everywhere():
    bound = PROJECT["requires-python"]
    assert f"- python{bound},<3.14\n" in (ROOT / "environment.yml").read_text()


@pytest.mark.parametrize("kind", [DeprecationWarning, PendingDeprecationWarning, FutureWarning])
def test_what_is_on_its_way_out_is_an_error_in_our_own_lines_only(kind):
    for module in ("facelab.widgets.viewer", "data_synth.capture"):
        with pytest.raises(kind, match="old"):
            warnings.warn_explicit("old", kind, "a.py", 1, module)
    with warnings.catch_warnings(record=True) as heard:
        warnings.warn_explicit("old", kind, "a.py", 1, "matplotlib.facelab")
    assert len(heard) == 1
