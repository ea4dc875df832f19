"""How long each notebook computes: `python tests/notebooks/seconds.py [NAME ...]`.

Seconds of the processor on one thread, once all data are made: on a quiet machine one waits about
as long, and a busy one, where they grow to twice as many, is no place to measure them. They are
written into the page for lecturers and the first notebook.
"""

import argparse
import json
import os
import re

import nbformat
from nbclient import NotebookClient
from reader import FOLDER, NOTEBOOKS, read

PAGE = FOLDER / "lecturers.md"
START = FOLDER / "00_start.ipynb"
_LINE = re.compile(r"^\| (\d\d) \| (\d+) \|$", re.M)
_MAP = re.compile(r"(\| \[(\d\d) [^|]*\|[^|]*\|[^|]*\| )(\d+) s( \|)")
_ASK = "import os\nsum(os.times()[:4])"


def seconds_of(name):
    """Seconds of the processor that a notebook takes from top to bottom, its kernel's start too."""
    notebook = read(name)
    notebook.cells.append(nbformat.v4.new_code_cell(_ASK))
    folder = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(notebook, timeout=600, resources=folder, store_widget_state=False).execute()
    return float(notebook.cells[-1].outputs[0].data["text/plain"])


def in_page(text):
    """The numbers of the page for lecturers: dict of "01" to seconds."""
    return {number: int(seconds) for number, seconds in _LINE.findall(text)}


def in_start(notebook):
    """The numbers of the first notebook's map: dict of "01" to seconds."""
    text = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    return {number: int(seconds) for _, number, seconds, _ in _MAP.findall(text)}


def write(found):
    """Put numbers, as `in_page` gives them, into both places."""
    text = PAGE.read_text(encoding="utf-8")
    text = _LINE.sub(lambda m: f"| {m[1]} | {found[m[1]]} |", text)
    PAGE.write_text(text, encoding="utf-8")
    start = json.loads(START.read_text(encoding="utf-8"))
    for cell in start["cells"]:
        source = _MAP.sub(lambda m: f"{m[1]}{found[m[2]]} s{m[4]}", "".join(cell["source"]))
        cell["source"] = source.splitlines(keepends=True)
    START.write_text(json.dumps(start, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main():
    """Measure, say and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="notebooks, such as 04_models; all if left out")
    names = parser.parse_args().names or NOTEBOOKS
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for name in names:
        seconds = round(seconds_of(name))
        print(f"{name}: {seconds} s", flush=True)
        write(in_page(PAGE.read_text(encoding="utf-8")) | {name[:2]: seconds})


if __name__ == "__main__":
    main()
