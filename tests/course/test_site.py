"""The course as static pages: every link leads somewhere, every picture is in its page."""

import nbformat
import pytest

from facelab.course import site


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
