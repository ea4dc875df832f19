"""Keep environment.yml in step with pyproject.toml: `python tests/environment.py` writes it."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
REQUIREMENTS = [*PROJECT["dependencies"], *EXTRAS["glb"], *EXTRAS["test"]]
PIP_ONLY = {"DracoPy", "ezc3d", "libigl", "playwright", "pygltflib", "pythreejs"}  # PyPI


def environment_yml():
    """The text that environment.yml must have, from pyproject.toml alone."""
    conda = [d for d in REQUIREMENTS if d.split(">=")[0] not in PIP_ONLY]
    pip = [d for d in REQUIREMENTS if d.split(">=")[0] in PIP_ONLY]
    lines = [
        "# Written by `make lock` from pyproject.toml: change that file, not this one.",
        "name: facelab",
        "channels:",
        "  - conda-forge",
        "dependencies:",
        f"  - python{PROJECT['requires-python']},<3.14",
        "  - pip",
        *(f"  - {d}" for d in conda),
        "  - pip:",
        *(f"      - {d}" for d in pip),
        "      - --editable .",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    (ROOT / "environment.yml").write_text(environment_yml())
