"""What is installed is what is in the source tree: an editable install hides what is left out."""

import json
import shutil
import subprocess
import sys
import sysconfig

import pytest
from environment import ROOT

from facelab.cli.course import KINDS

PACKAGES = ("facelab", "data_synth")
LOOK = """
import importlib, json, sys
from pathlib import Path
packages, modules = json.loads(sys.argv[1])
homes = [Path(importlib.import_module(name).__file__).parent for name in packages]
for name in modules:
    importlib.import_module(name)
files = [str(f.relative_to(h.parent)) for h in homes for f in h.rglob("*") if f.is_file()]
print(json.dumps([[str(h) for h in homes], files]))
"""

DRAG = """
import json
import numpy as np
import facelab
from facelab.widgets import PosingLab
session = PosingLab.example().session
corner = session.neutral.landmarks["mouth_corner_left"]
rest = session.vertices.copy()
session.drag(corner, rest[corner] + [6, 4, 0])
session.release()
moved = np.linalg.norm(session.vertices - rest, axis=1)
right = session.neutral.vertices[:, 0] < -20
print(json.dumps([facelab.__file__, moved[corner], float(moved[right].mean())]))
"""


def in_tree():
    """Every file of the packages, as paths from the root."""
    files = [f.relative_to(ROOT) for p in PACKAGES for f in (ROOT / p).rglob("*") if f.is_file()]
    return {f.as_posix() for f in files if "__pycache__" not in f.parts}


def run(*command, cwd=None):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(map(str, command))}:\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Python of a new environment with the wheel, and nothing else of ours, in it."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"  # a copy: what an earlier build left in the tree would be packed too
    unmade = shutil.ignore_patterns("__pycache__")
    for name in (*PACKAGES, "notebooks", "app"):
        shutil.copytree(ROOT / name, source / name, ignore=unmade)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    alone = ("--no-deps", "--no-index")
    run(*pip, "wheel", *alone, "--no-build-isolation", "--wheel-dir", folder, source)
    (wheel,) = folder.glob("facelab-*.whl")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    run(*pip, "--python", python, "install", *alone, wheel)
    # all that facelab needs, from here; what is installed in place is not found by this line
    (site,) = (folder / "venv").glob("lib/python*/site-packages")
    (site / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


@pytest.mark.long
def test_every_module_and_every_file_of_the_tree_is_in_the_wheel(installed, tmp_path):
    files = in_tree()
    dotted = [f.removesuffix(".py").replace("/", ".") for f in files if f.endswith(".py")]
    modules = sorted(m.removesuffix(".__init__") for m in dotted if not m.endswith("__main__"))
    asked = json.dumps([PACKAGES, modules])
    homes, found = json.loads(run(installed, "-I", "-c", LOOK, asked, cwd=tmp_path))
    assert all(home.startswith(str(installed.parents[1])) for home in homes)
    assert {f for f in found if "__pycache__" not in f} == files


@pytest.mark.long
def test_the_command_of_the_wheel_copies_the_course_and_the_page(installed, tmp_path):
    command = installed.parent / ("facelab.exe" if sys.platform == "win32" else "facelab")
    for name, part in (("lab", "notebooks"), ("app", "app")):
        run(command, name, tmp_path / part, "--only-copy", cwd=tmp_path)
        ours = {p.name: p.read_bytes() for p in (ROOT / part).glob("*") if p.suffix in KINDS}
        assert {p.name: p.read_bytes() for p in (tmp_path / part).iterdir()} == ours


@pytest.mark.long
def test_the_lab_of_the_wheel_follows_a_hand(installed, tmp_path):
    said = run(installed, "-I", "-c", DRAG, cwd=tmp_path).splitlines()[-1]
    home, corner, other_side = json.loads(said)
    assert home.startswith(str(installed.parents[1]))
    assert 4 < corner < 9  # pulled by 7.2 mm
    assert other_side < 1
