"""What every page shares: it shows itself, says what went wrong, takes files in and gives them out.

Text that is not ours (names from files, messages of errors) becomes HTML only through `markup`,
which escapes it.
"""

import base64
import functools
import tempfile
import traceback
from contextlib import contextmanager
from pathlib import Path

import ipywidgets as widgets
from IPython.display import HTML, display
from markupsafe import Markup

from facelab.numeric.undo import in_turn
from facelab.widgets.in_touch import keep_free
from facelab.widgets.thumbnail import captioned

ASLEEP = "not running. Press Run (Shift and Enter)."
"""What a page says in a notebook that does not run."""
STILL = "facelab-still"
"""Class of the picture that stands for it there."""
_LIVE = "facelab-page"
# the picture goes while the page is there; without a page JupyterLab would say beside the picture
# that it knows no such widget: where it trusts a notebook, not
_INSTEAD = f""".jp-OutputArea:has(.{_LIVE}) .{STILL} {{ display: none; }}
.jp-OutputArea:has(.{STILL}) .jp-OutputArea-output.jupyter-widgets:not(:has(*)) {{
display: none; }}"""
_LINKED_BYTES = 12e6  # larger files get no link in the page


def markup(template, /, *texts, **named):
    """HTML of a template of ours with texts put in at its {}, each escaped.

    Examples
    --------
    >>> from facelab.widgets.page import markup
    >>> print(markup("<b>{}</b>", "<img src=x>"))
    <b>&lt;img src=x&gt;</b>
    """
    return Markup(template).format(*texts, **named)


def shows_errors(method):
    """Pass what a callback raises on to the `fail` of its page: else nobody would see it.

    Callbacks of all pages come one after the other, whatever thread calls them.
    Its `step_made` tells whether the state of the page's session, if it has one, is another now.
    """

    @functools.wraps(method)
    @in_turn
    def guarded(self, *args, **kwargs):
        session = getattr(self, "session", None)
        before = getattr(session, "state", None)
        try:
            return method(self, *args, **kwargs)
        except Exception as error:
            error.step_made = getattr(session, "state", None) is not before
            self.fail(error)

    return guarded


@contextmanager
def quiet(page):
    """Within, what is set on sliders and buttons is no edit of the person."""
    before, page.settling = page.settling, True
    try:
        yield
    finally:
        page.settling = before


class Page:
    """One base for all labs and views. Its `widget` is the whole page.

    A page shows itself as the last line of a cell. It has a line for what is going on (`say`) and
    a box for what went wrong (`fail`). `picture`, bytes of a PNG, stands for it in a notebook that
    does not run.
    """

    _after_error = "The face is as it was."
    _ours = (ValueError, TypeError, OSError)  # what is told in words of a person's own doing
    settling = False

    def _build_messages(self):
        self._status = widgets.HTML()
        self._message = widgets.HTML()

    def _repr_mimebundle_(self, **kwargs):
        still = {"text/plain": f"{type(self).__name__}: {ASLEEP}"}
        return {**self.widget._repr_mimebundle_(**kwargs), **still}

    def _ipython_display_(self):
        """Show the page, and above it what stands in the notebook where its kernel does not run."""
        if hasattr(self, "picture"):
            words = *self._settings_in_words(), f"{type(self).__name__}: {ASLEEP}"
            html = '<div class="{}"><img alt="{}" src="data:image/png;base64,{}"></div>'
            style = markup("<style>{}</style>", _INSTEAD)
            picture = captioned(self.picture(), *words)
            display(HTML(style + markup(html, STILL, " ".join(words), picture)))
        self.widget.add_class(_LIVE)
        keep_free(self.widget)
        display(self._repr_mimebundle_(), raw=True)

    def _settings_in_words(self):
        """Lines below the picture: what it shows, where one cannot read that off the sliders."""
        return ()

    def say(self, text):
        """Show what is going on: a text, escaped, or `markup`."""
        said = markup('<div class="facelab-status" role="status">{}</div>', text)
        if self._status.value != said:
            self._status.value = said

    def fail(self, error):
        """Show an error: what happened, where, and in words what is shown now."""
        where = ""
        if not isinstance(error, self._ours):
            frames = traceback.extract_tb(error.__traceback__)
            where = f"{type(error).__name__}: a fault of facelab"
            where += f", in {frames[-1].name}, line {frames[-1].lineno}." if frames else "."
        self._message.value = markup(
            '<div class="facelab-error" role="alert"><b>That did not work.</b> '
            '<span class="facelab-said">{}</span><br>{}'
            "<br><small>{}</small></div>",
            *(self.in_words(error), self._after_error, where),
        )

    def in_words(self, error):
        """What an error says, in words for the page."""
        return str(error)

    def clear(self):
        """Take away what the last error said."""
        self._message.value = ""


@contextmanager
def uploaded(upload):
    """The path of the file that was given to a `FileUpload`, for as long as it is needed."""
    (file,) = upload.value
    upload.value = ()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(file["name"].replace("\\", "/")).name
        path.write_bytes(bytes(file["content"]))
        yield path


def path_in(folder, name, ending=""):
    """Path of a file in a folder from what a person typed; it stays inside.

    Raises
    ------
    ValueError
        For an empty name, or one that is more than a name.
    """
    name = name.strip()
    if not name:
        raise ValueError("name is empty; write a file name.")
    if name in (".", "..") or any(sign in name for sign in "/\\:\0"):
        raise ValueError(
            f"name={name!r} leads out of the folder of the lab; write a file name alone, without "
            "/, \\ or :."
        )
    return Path(folder) / (name if name.endswith(ending) else name + ending)


def written(path, note="", again=False):
    """What was written and where, and whether again, with a link to download it."""
    size = path.stat().st_size
    link = ""
    if size <= _LINKED_BYTES:
        link = markup(
            ' <a download="{}" href="data:application/octet-stream;base64,{}"><u>Download</u></a>',
            *(path.name, base64.b64encode(path.read_bytes()).decode()),
        )
    over = " again, over the one before" if again else ""
    text = '<div class="facelab-status" role="status">Wrote <b>{}</b>{}, {:,.0f} kB. {}{}</div>'
    return markup(text, str(path), over, size / 1e3, note, link)
