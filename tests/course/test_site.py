"""The course as static pages: every link leads somewhere, every picture is in its page."""

from html.parser import HTMLParser
from importlib import import_module

import nbformat
import pytest

from facelab.course import site
from facelab.course.lesson import LESSONS


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    site.build(folder)
    return folder


def test_no_link_of_the_site_leads_nowhere(pages):
    assert not site.broken_links(pages)


def test_the_first_page_leads_to_every_notebook(pages):
    index = (pages / "index.html").read_text(encoding="utf-8")
    for path in pages.glob("0*.html"):
        assert f'href="{path.name}"' in index, f"the first page has no link to {path.name}"


def test_pictures_are_part_of_their_page(pages):
    for path in pages.glob("0*.html"):
        text = path.read_text(encoding="utf-8")
        assert "data:image/png;base64" in text and "attachment:" not in text


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    cells = [
        nbformat.v4.new_markdown_cell("[gone](99_gone.ipynb) [here](#here) [x](https://x.org)")
    ]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), tmp_path / "00_start.ipynb")
    site.build(tmp_path / "out", [tmp_path / "00_start.ipynb"], [])
    broken = site.broken_links(tmp_path / "out")
    assert broken == ["index.html: 99_gone.ipynb", "index.html: #here"]


class _Folds(HTMLParser):
    """The text of a page that is not folded away."""

    def __init__(self):
        super().__init__()
        self.depth, self.open, self.folded = 0, [], []

    def handle_starttag(self, tag, _):
        self.depth += tag == "details"

    def handle_endtag(self, tag):
        self.depth -= tag == "details"

    def handle_data(self, data):
        (self.folded if self.depth else self.open).append(data)


@pytest.mark.parametrize("lesson", LESSONS)
def test_hints_and_solutions_are_folded_away(pages, lesson):
    (path,) = pages.glob(f"0?_{lesson}.html")
    page = _Folds()
    page.feed(path.read_text(encoding="utf-8"))
    shown, folded = ("".join(part) for part in (page.open, page.folded))
    for exercise in import_module(f"facelab.course.lessons.{lesson}").EXERCISES:
        assert exercise.solution in folded and exercise.solution not in shown
    assert page.depth == 0
