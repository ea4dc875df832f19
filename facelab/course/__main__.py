"""`python -m facelab.course NOTEBOOK...`: writes into notebooks what is known elsewhere.

Hints and solutions come from the lessons, pictures from the notebooks' own stored outputs: the cell
with the tag `picture`, or else the first picture.
"""

import json
import re
import sys
from base64 import b64decode, b64encode
from importlib import import_module
from io import BytesIO
from pathlib import Path

from PIL import Image

from facelab.course.exercises import fold
from facelab.course.lesson import LESSONS
from facelab.storage import atomic_path
from facelab.widgets.page import ASLEEP, STILL

_WIDTH = 640  # pixels of a picture in a text
_MAP_WIDTH = 240  # and in the map of the first page
_VIEW = "application/vnd.jupyter.widget-view+json"
_COMPARED = "nbval-check-output"  # tag of cells whose outputs are compared with those stored
_LARGE = 40_000  # bytes of a stored picture that is worth a palette
_ASKED = re.compile(r"attachment:(\w+)\.png")


def folded(source, exercises):
    """A cell's markdown with the hint and the solution of its exercise as its lesson has them."""
    found = re.search(r"^\*\*Exercise (\d+)", source)
    exercise = exercises.get(int(found.group(1))) if found else None
    if exercise is None:
        return source
    return source.split("<details>")[0].rstrip() + "\n\n" + fold(exercise)


def picture_of(notebook):
    """The stored picture that stands for a notebook: PNG as bytes, or None if it has none."""
    tagged = [c for c in notebook["cells"] if "picture" in c["metadata"].get("tags", ())]
    for cell in [*tagged, *notebook["cells"]]:
        for output in cell.get("outputs", ()):
            if "image/png" in output.get("data", {}):
                return b64decode("".join(output["data"]["image/png"]))
    return None


def shrunk(png, width):
    """A picture no wider than so many pixels, of few colours: PNG as base64 text."""
    with Image.open(BytesIO(png)) as whole:
        if whole.mode == "P" and whole.width <= width:
            return b64encode(png).decode()  # is one already
        image = whole.convert("RGB")
    if image.width > width:
        image = image.resize((width, round(image.height * width / image.width)), Image.LANCZOS)
    file = BytesIO()
    image.quantize(128).save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()


def _picture(name, path, notebook):
    """The picture that a text asks for: its own, a file of docs, or that of another notebook."""
    if name == "picture":
        return picture_of(notebook), _WIDTH
    file = path.parent.parent / "docs" / f"{name}.png"
    if file.exists():
        return file.read_bytes(), _WIDTH
    others = sorted(path.parent.glob(f"{name}_*.ipynb"))
    if not others:
        return None, _WIDTH
    return picture_of(json.loads(others[0].read_text(encoding="utf-8"))), _MAP_WIDTH


def _lighten(data):
    """Large stored pictures of a cell get a palette: a third of the bytes, at the same size."""
    png = b64decode("".join(data.get("image/png", "")))
    if len(png) > _LARGE:
        data["image/png"] = shrunk(png, width=10**6)


def _seen(outputs):
    """Outputs without views of widgets, which are errors where no kernel runs.

    A page keeps its picture, or else the line that it does not run; a bar of progress goes.
    """
    pictured = any(STILL in "".join(o.get("data", {}).get("text/html", "")) for o in outputs)
    seen = []
    for output in outputs:
        data = output.get("data", {})
        if data.pop(_VIEW, None) is None:
            seen.append(output)
        elif ASLEEP in "".join(data.get("text/plain", "")) and not pictured:
            seen.append(output)
    return seen


def complete(path):
    """Write the folds and the pictures of a notebook in place; large outputs become lighter.

    Views of widgets are left out of the outputs: pictures and lines of text stand for them.

    Folds go to the cells whose text begins with `**Exercise N`. `attachment:picture.png` is the
    notebook's own picture, `attachment:05.png` that of notebook 05, `attachment:posing.png` the one
    in docs.
    """
    path = Path(path)
    lesson = path.stem.split("_", 1)[-1]
    plan = import_module(f"facelab.course.lessons.{lesson}") if lesson in LESSONS else None
    exercises = {e.number: e for e in plan.EXERCISES} if plan else {}
    notebook = json.loads(path.read_text(encoding="utf-8"))
    for cell in notebook["cells"]:
        if cell["cell_type"] != "markdown":
            for output in cell.get("outputs", ()):
                _lighten(output.get("data", {}))
            # where nbval compares outputs, it wants those of a run
            if "outputs" in cell and _COMPARED not in cell["metadata"].get("tags", ()):
                cell["outputs"] = _seen(cell["outputs"])
            continue
        source = folded("".join(cell["source"]), exercises)
        cell["source"] = source.splitlines(keepends=True)
        for name in _ASKED.findall(source):
            png, width = _picture(name, path, notebook)
            if png is not None:
                held = cell.setdefault("attachments", {})
                held[f"{name}.png"] = {"image/png": shrunk(png, width)}
    with atomic_path(path) as part:
        text = json.dumps(notebook, indent=1, ensure_ascii=False)
        part.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    for path in sorted(sys.argv[1:], reverse=True):  # the first page last: it shows all others
        complete(path)
