"""A reader of notebooks: changes settings, runs all cells, tries the answers to exercises."""

import ast
import re
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))
COARSE = "import matplotlib.pyplot\nmatplotlib.pyplot.rcParams['figure.dpi'] = 24"
"""Nobody looks at these pictures: `make test` draws them as they are."""
_CHECK = re.compile(r"^lesson\.check\((\d+)", re.M)


def read(name):
    """A notebook of the course by its file's stem."""
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def lesson_of(name):
    """The name of a notebook's lesson: its stem without the number."""
    return name.split("_", 1)[-1]


def tagged(notebook, tag):
    """All cells of a notebook that carry a tag."""
    return [cell for cell in notebook.cells if tag in cell.metadata.get("tags", ())]


def exercise_of(cell):
    """The number of the exercise that a cell answers; None for all other cells."""
    found = _CHECK.search(cell.source) if cell.cell_type == "code" else None
    return int(found.group(1)) if found else None


def with_settings(source, settings):
    """The lines of a settings cell with other values in them."""
    tree, left = ast.parse(source), dict(settings)
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and statement.targets[0].id in left:
            statement.value = ast.parse(repr(left.pop(statement.targets[0].id))).body[0].value
    assert not left, f"the settings cell has no {', '.join(left)}"
    return ast.unparse(tree)


def answered(source, answer):
    """The lines of an exercise's cell with an answer in place of the reader's."""
    return answer + "\n" + source[_CHECK.search(source).start() :]


def trials(cell, exercise):
    """What is run after an exercise's cell: (source, whether it is right)."""
    yield answered(cell.source, exercise.solution), True
    for wrong in exercise.wrong:
        yield answered(cell.source, wrong), False
    yield cell.source, None  # the cells that follow find it as it was


def run(name, settings=(), exercises=()):
    """Run a notebook from top to bottom, and after each exercise's cell its answers.

    Parameters
    ----------
    name : str
    settings : dict
        Other values for its settings cell.
    exercises : sequence of Exercise
        Those whose solution must be found right, and whose wrong answers wrong.
    """
    notebook = read(name)
    if settings:
        (cell,) = tagged(notebook, "settings")
        cell.source = with_settings(cell.source, settings)
    first = notebook.cells[0]
    by_number = {e.number: e for e in exercises}
    client = NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(FOLDER)}}, store_widget_state=False
    )
    with client.setup_kernel():
        client.execute_cell(nbformat.v4.new_code_cell(COARSE), 0)
        notebook.cells[0] = first
        for index, cell in enumerate(list(notebook.cells)):
            client.execute_cell(cell, index)
            if exercise_of(cell) in by_number:
                for source, right in trials(cell, by_number[exercise_of(cell)]):
                    client.execute_cell(_judged(source, exercise_of(cell), right), index)
                notebook.cells[index] = cell  # the client has put the last one there


def _judged(source, n, right):
    """The cell, and whether it was judged as it must be; where data stand in, it need not be."""
    found = f"lesson.verdicts[{n}]"
    lines = f"{source}\nassert not lesson.reference or {found}.right is {right}, {found}"
    return nbformat.v4.new_code_cell(lines)
