"""Names that are HTML, in every lab of one page: the browser runs none of them."""

import pytest
from browser_lab import ROOT, Lab, write_notebook

CELLS = [
    """
import sys, pathlib
sys.path[:0] = {paths!r}
import test_page
labs = test_page.hostile_labs(pathlib.Path("."))
lab, session = labs[0], labs[0].session
for each in labs:
    each.fail(ValueError(test_page.hostile("error")))
labs[0]""",
    "labs[1]",
    "labs[2]",
]


@pytest.fixture(scope="module")
def hostile_page(server):
    paths = [str(ROOT / "tests" / "widgets"), str(ROOT / "tests")]
    lab = Lab(server)
    try:
        cells = [CELLS[0].replace("{paths!r}", repr(paths)), *CELLS[1:]]
        lab.open(write_notebook(lab.folder / "source" / "hostile.ipynb", cells))
        yield lab
    finally:
        lab.close()


def test_no_name_runs_as_script_in_the_page(hostile_page):
    lab, page = hostile_page, hostile_page.page
    page.locator(".facelab-unit").first.wait_for()
    for tab in ("Sliders", "Poses", "Time", "Steps", "Files", "Pins"):
        page.get_by_role("tab", name=tab, exact=True).first.click()  # the posing lab's
        lab.settle()
    lab.run("lab.view.names = [test_page.hostile('vertex')] * len(lab.view.vertices)")
    lab.settle()
    box = lab.bring_into_view()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.locator(".facelab-label").first.wait_for()
    assert "<img src=x" in page.locator(".facelab-label").first.text_content()
    page.wait_for_timeout(500)  # a picture that cannot be loaded is reported a moment later
    assert page.evaluate("window.hacked ?? null") is None
    shown = page.locator(".jp-OutputArea").all_inner_texts()
    assert any("<img src=x" in text for text in shown), "the names are not shown at all"
    assert page.locator("img[src='x']").count() == 0
