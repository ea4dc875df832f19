"""`python -m facelab.course.site FOLDER`: the course as static pages, by nbconvert.

Every notebook becomes a page as it is stored, links between them lead from page to page, and the
first one is the index.
"""

import argparse
import re
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import nbformat
from nbconvert import HTMLExporter
from nbconvert.filters import markdown2html

from facelab.storage import atomic_path

ROOT = Path(__file__).resolve().parents[2]
FIRST = "00_start"
_FOLD = re.compile(r"<details>(<summary>[^<]*</summary>)\n\n(.*?)\n\n</details>", re.S)
_LINK = re.compile(r"\]\((?:\.\./)?(?:notebooks/|docs/)?([\w-]+)\.(ipynb|md)(#[^)]*)?\)")


def page_of(stem):
    """The name of a page: that of the notebook or text, the first one being the index."""
    return "index.html" if stem == FIRST else f"{stem}.html"


def relinked(markdown, stems):
    """Markdown whose links to other pages of the course lead to their HTML.

    >>> relinked("see [05](05_posing.ipynb)", {"05_posing"})
    'see [05](05_posing.html)'
    """

    def one(match):
        stem, _, place = match.groups()
        return f"]({page_of(stem)}{place or ''})" if stem in stems else match.group(0)

    return _LINK.sub(one, markdown)


def whole_folds(markdown):
    """Markdown whose folds are one block of HTML each: nbconvert opens those of several.

    >>> whole_folds("<details><summary>Hint</summary>\\n\\nadd *one*\\n\\n</details>")
    '<details><summary>Hint</summary><p>add <em>one</em></p></details>'
    """

    def one(match):
        inside = markdown2html(match[2]).strip().replace("\n\n", "\n&#10;")  # an empty line ends it
        return f"<details>{match[1]}{inside}</details>"

    return _FOLD.sub(one, markdown)


def _navigation(stems, own):
    links = (
        f"<b>{escape(s)}</b>" if s == own else f'<a href="{page_of(s)}">{escape(s)}</a>'
        for s in stems
    )
    return f'<nav style="font-size: small; padding: 8px">{" · ".join(links)}</nav>'


def build(folder, notebooks=None, texts=None):
    """Write the pages of the course into a folder: list of Path.

    Parameters
    ----------
    folder : str or Path
        Made where it is not there; pages of before are written over.
    notebooks, texts : iterable of Path, optional
        Those of the repository if left out: `notebooks/*.ipynb`, and `*.md` there and in docs.

    Raises
    ------
    FileNotFoundError
        If there is no notebook.
    """
    sources = sorted((ROOT / "notebooks").glob("*.ipynb")) if notebooks is None else list(notebooks)
    if texts is None:
        texts = (p for part in ("notebooks", "docs") for p in sorted((ROOT / part).glob("*.md")))
    sources += texts
    if not sources:
        raise FileNotFoundError(f"there are no notebooks under {ROOT}; run this in a source tree.")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    stems = [path.stem for path in sources]
    exporter = HTMLExporter(template_name="lab", embed_images=True)
    made = []
    for path in sources:
        notebook = _read(path)
        for cell in notebook.cells:
            if cell.cell_type == "markdown":
                cell.source = whole_folds(relinked(cell.source, stems))
        html, _ = exporter.from_notebook_node(notebook, {"metadata": {"name": path.stem}})
        html = re.sub(r"(<body[^>]*>)", rf"\1{_navigation(stems, path.stem)}", html, count=1)
        target = folder / page_of(path.stem)
        with atomic_path(target) as part:
            part.write_text(html, encoding="utf-8")
        made.append(target)
    return made


def _read(path):
    """A notebook; a text as a notebook of one cell."""
    if path.suffix == ".ipynb":
        return nbformat.read(path, as_version=4)
    text = path.read_text(encoding="utf-8")
    return nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(text)])


class _Links(HTMLParser):
    """All that a page leads to, and all places in it that can be led to."""

    def __init__(self):
        super().__init__()
        self.links, self.places = [], set()

    def handle_starttag(self, tag, attributes):
        held = dict(attributes)
        for key in ("href", "src"):
            if held.get(key):
                self.links.append(held[key])
        for key in ("id", "name"):
            if held.get(key):
                self.places.add(held[key])


def broken_links(folder):
    """Links of the pages of a folder that lead nowhere: list of "page: link".

    Links to other hosts are not followed, pictures that are part of the page hold no link.
    """
    pages = {}
    for path in sorted(Path(folder).glob("*.html")):
        pages[path.name] = _Links()
        pages[path.name].feed(path.read_text(encoding="utf-8"))
    broken = []
    for name, page in pages.items():
        for link in page.links:
            if re.match(r"[a-z]+:|//", link):
                continue
            target, place = urldefrag(link)
            places = pages.get(target or name, page).places
            gone = target and not (Path(folder) / unquote(target)).exists()
            if gone or (place and not {place, unquote(place)} & places):  # nbconvert quotes in ids
                broken.append(f"{name}: {link}")
    return broken


def main(arguments=None):
    """Build the pages and say what is broken: the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", default="site")
    made = build(parser.parse_args(arguments).folder)
    broken = broken_links(made[0].parent)
    print(f"{len(made)} pages in {made[0].parent}; open {made[0].parent / 'index.html'}")
    print(*(f"broken link: {link}" for link in broken), sep="\n", end="")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())
