"""What is written into notebooks: folds of the lessons, pictures of the stored outputs."""

from base64 import b64decode, b64encode
from io import BytesIO

import nbformat
from PIL import Image

from facelab.course import Exercise, fold
from facelab.course.__main__ import complete, folded, picture_of, shrunk

ONE = Exercise(1, None, "right", "a hint", "answer = 1", ("answer = 2",))


def png(width, color=(200, 30, 30)):
    file = BytesIO()
    Image.new("RGB", (width, 10), color).save(file, "PNG")
    return file.getvalue()


def with_picture(data, tags=()):
    picture = nbformat.v4.new_output("display_data", {"image/png": b64encode(data).decode()})
    cell = nbformat.v4.new_code_cell("draw()", outputs=[picture])
    cell.metadata["tags"] = list(tags)
    return cell


def test_a_fold_is_written_once_however_often():
    once = folded("**Exercise 1.** How many?", {1: ONE})
    assert once.endswith(fold(ONE)) and folded(once, {1: ONE}) == once


def test_a_text_that_only_speaks_of_an_exercise_is_left_alone():
    assert folded("See **Exercise 1** above.", {1: ONE}) == "See **Exercise 1** above."


def test_the_tagged_picture_stands_for_a_notebook_else_the_first():
    first, second = png(20), png(30)
    notebook = nbformat.v4.new_notebook(cells=[with_picture(first), with_picture(second)])
    assert picture_of(notebook) == first
    notebook.cells[1].metadata["tags"] = ["picture"]
    assert picture_of(notebook) == second
    assert picture_of(nbformat.v4.new_notebook()) is None


def test_pictures_are_no_wider_than_asked():
    with Image.open(BytesIO(b64decode(shrunk(png(100), 40)))) as image:
        assert image.size == (40, 4)


def test_a_notebook_gets_its_own_picture_and_that_of_another(tmp_path):
    (tmp_path / "notebooks").mkdir()
    text = nbformat.v4.new_markdown_cell("![a](attachment:picture.png) ![b](attachment:02.png)")
    own = nbformat.v4.new_notebook(cells=[text, with_picture(png(20))])
    other = nbformat.v4.new_notebook(cells=[with_picture(png(30))])
    nbformat.write(own, tmp_path / "notebooks" / "01_own.ipynb")
    nbformat.write(other, tmp_path / "notebooks" / "02_other.ipynb")
    complete(tmp_path / "notebooks" / "01_own.ipynb")
    held = nbformat.read(tmp_path / "notebooks" / "01_own.ipynb", 4).cells[0].attachments
    assert set(held) == {"picture.png", "02.png"}


def test_views_of_widgets_are_left_out_where_no_kernel_runs(tmp_path):
    def shown(data):
        return nbformat.v4.new_output("display_data", data)

    def view(text):
        data = {"application/vnd.jupyter.widget-view+json": {"model_id": "1"}, "text/plain": text}
        return shown(data)

    asleep = "Player: not running. Press Run (Shift and Enter)."
    still = shown({"text/html": '<div class="facelab-still"></div>'})
    table = shown({"text/html": "<table></table>", "text/plain": "a table"})
    bar = view("actors:  50%|#####     | 2/4")
    held = [still, view(asleep)], [bar, view(asleep)], [bar, table], [bar]
    cells = [nbformat.v4.new_code_cell("a", outputs=outputs) for outputs in held]
    cells[-1].metadata.tags = ["nbval-check-output"]
    path = tmp_path / "01_own.ipynb"
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    complete(path)
    left = [[dict(o.data) for o in cell.outputs] for cell in nbformat.read(path, 4).cells]
    assert left == [[still.data], [{"text/plain": asleep}], [table.data], [bar.data]]
