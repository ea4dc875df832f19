"""What goes to the terminal: one line at a time, without control characters, whoever listens."""

import contextlib
import os
import re
import sys

from tqdm import tqdm


def plain(text):
    """A text on one line, in which nothing commands a terminal: str.

    Line ends and tabs become blanks; other control characters, marks that turn the direction of
    writing, and bytes that are no text are written out.

    Examples
    --------
    >>> plain("take\\x1b[2J.csv:\\nno frames")
    'take\\\\x1b[2J.csv: no frames'
    """
    text = re.sub(r"\s*[\t\n\v\f\r]\s*", " ", str(text)).strip()
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def say(text):
    """A line on stdout. If nobody reads it any more the work goes on without a word."""
    _line(text, sys.stdout)


def complain(text):
    """A line on stderr."""
    _line(text, sys.stderr)


def _line(text, stream):
    text = plain(text)
    encoding = getattr(stream, "encoding", None) or "utf-8"
    text = text.encode(encoding, "backslashreplace").decode(encoding)
    with hushed():
        tqdm.write(text, file=stream)
        stream.flush()


def spell_out():
    """Whatever stdout and stderr have no letter for (λ, in a pipe on Windows) is written out."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


@contextlib.contextmanager
def hushed():
    """Where stdout or stderr is a pipe that was closed, it leads nowhere from here on."""
    try:
        yield
    except BrokenPipeError:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except BrokenPipeError:
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)


def watched(options):
    """Whether somebody looks at stderr, so that a bar of progress is worth while."""
    return sys.stderr.isatty() and not options.quiet
