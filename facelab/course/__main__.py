"""`python -m facelab.course NOTEBOOK...`: hints and solutions of the lessons, written into them."""

import json
import re
import sys
from importlib import import_module
from pathlib import Path

from facelab.course.exercises import fold
from facelab.course.lesson import LESSONS


def folded(source, exercises):
    """A cell's markdown with the hint and the solution of its exercise as its lesson has them."""
    found = re.search(r"\*\*Exercise (\d+)", source)
    exercise = exercises.get(int(found.group(1))) if found else None
    if exercise is None:
        return source
    return source.split("<details>")[0].rstrip() + "\n\n" + fold(exercise)


def write_folds(path):
    """Write the folds of a notebook in place; cells that hold `**Exercise N` are theirs."""
    path = Path(path)
    lesson = path.stem.split("_", 1)[-1]
    if lesson not in LESSONS:
        return
    plan = import_module(f"facelab.course.lessons.{lesson}")
    exercises = {e.number: e for e in plan.EXERCISES}
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            source = folded("".join(cell["source"]), exercises)
            cell["source"] = source.splitlines(keepends=True)
    text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    for path in sys.argv[1:]:
        write_folds(path)
