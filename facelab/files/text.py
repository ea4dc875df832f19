"""Tables in text: lines, cells and numbers of a CSV, whoever wrote it, each with its place.

Read line by line, so that memory grows with what is kept and not with the file. Every spreadsheet's
way is known: UTF-8 and UTF-16 with or without a byte order mark; commas, semicolons or tabs;
decimal commas; quotes; any line end.
"""

import codecs
import csv
import io
import re
from pathlib import Path

from facelab.names import normalised
from facelab.storage import existing_file

_LONGEST_LINE = 1 << 22
_NUMBER = re.compile(r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d{1,4})?", re.ASCII)
_PLAIN = {  # lines in which float() finds nothing but numbers as they are written everywhere
    ",": re.compile(r"[0-9eE+\-.:; ,]*"),
    ";": re.compile(r"[0-9eE+\-.: ;]*"),
    "\t": re.compile(r"[0-9eE+\-.:; \t]*"),
}
_TIME = ("timecode", "time", "times", "timestamp", "timestamps", "t")
_TIME += ("elapsed", "elapsedtime", "timeelapsed", "mediatime", "frametime")
_SECONDS = (*_TIME, *(stem + unit for unit in ("seconds", "secs", "sec") for stem in ("", *_TIME)))
_SECONDS += tuple(stem + "s" for stem in _TIME)
_MILLISECONDS = tuple(
    stem + unit for unit in ("ms", "milliseconds", "msec") for stem in ("", *_TIME)
)
_UNREAD = tuple(
    stem + unit for unit in ("us", "ns", "microseconds", "nanoseconds") for stem in _TIME
)
_FRAME = ("frame", "frames", "frameid", "framenumber", "frameindex", "frameno", "field")
_FRAME += ("index", "idx")
_UTF = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF32_LE: "utf-32-le",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32-be",
    codecs.BOM_UTF16_LE: "utf-16-le",
    codecs.BOM_UTF16_BE: "utf-16-be",
}


def text_lines(path, what):
    """Lines of a text file with their numbers, in any of the encodings above.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, for the message ("table of weights").

    Yields
    ------
    number : int
        Counted from 1.
    line : str
        Without its end.
    ended : bool
        False for a last line without a line end.

    Raises
    ------
    FileNotFoundError, ValueError, TypeError
        For a missing or empty file, or one that is no text.
    """
    path = existing_file(path, what)
    with open(path, "rb") as source:
        head = source.read(4096)
        if head.startswith(b"PK\3\4"):
            raise ValueError(
                f"{path} is a spreadsheet or a zip archive; save its table as CSV, or unpack it."
            )
        mark = next((m for m in _UTF if head.startswith(m)), b"")
        encoding = _UTF.get(mark) or _unmarked(head)
        source.seek(len(mark))
        if encoding != "utf-8":
            source = io.BytesIO(_decoded(source.read(), encoding, path, what).encode())
        elif b"\r" in head and b"\n" not in head:
            source = io.BytesIO(source.read().replace(b"\r", b"\n"))  # lines of an old Macintosh
        number = 0
        while raw := source.readline(_LONGEST_LINE):
            number += 1
            if len(raw) == _LONGEST_LINE:
                raise ValueError(
                    f"{path}, line {number} is longer than {_LONGEST_LINE >> 20} MB: this is no "
                    f"{what}."
                )
            if b"\0" in raw:
                raise ValueError(
                    f"{path}, line {number}: a zero byte; this is a binary file or a damaged one, "
                    f"not a {what}."
                )
            try:
                line = raw.decode()
            except UnicodeDecodeError as error:
                raise ValueError(
                    f"{path}, line {number}: byte 0x{raw[error.start]:02x} at place "
                    f"{error.start + 1} is no UTF-8; save the {what} as UTF-8 text."
                ) from None
            yield number, line.rstrip("\r\n"), line.endswith("\n")


def _unmarked(head):
    """UTF-16 without a mark shows by a zero in every other byte."""
    for start, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(head) > 3 and not any(head[start::2]) and all(head[1 - start :: 2]):
            return encoding
    return "utf-8"


def _decoded(data, encoding, path, what):
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data[: error.start].decode(encoding, errors="replace").count("\n") + 1
        raise ValueError(
            f"{path}, line {line}: the text is marked as {encoding.upper()} but breaks off there; "
            f"save the {what} as UTF-8 text."
        ) from None


class TextTable:
    """A table being read: its header, then its rows one by one.

    Parameters
    ----------
    path : str or Path
    what : str
        What the file should be, for messages.

    Attributes
    ----------
    header : list of str
        Names of the columns, without blanks around them; empty ones at the end are left out.
    header_line : int
    ended : bool
        After the last row: False where its line end is missing.
    """

    def __init__(self, path, what):
        self.path, self.what, self.ended = Path(path), what, True
        self._lines = text_lines(path, what)
        self.delimiter = None
        self.header_line, line = self._first_line()
        self.delimiter = self.delimiter or delimiter_of(line)
        self.header = [name.strip() for name in self.cells(self.header_line, line)]
        while self.header and not self.header[-1]:
            self.header.pop()
        if all(_NUMBER.fullmatch(name) for name in self.header):
            raise ValueError(
                f"{self.place(self.header_line)}: numbers where the names of the columns should "
                "stand; put a line with a name for each column on top."
            )

    def _first_line(self):
        for number, line, _ in self._lines:
            if found := re.fullmatch(r"sep=([,;\t])", line.strip(" ")):
                self.delimiter = found[1]  # as spreadsheets say it
            elif line.strip() and not line.lstrip().startswith("#"):
                return number, line
        raise ValueError(f"{self.path}: blank lines only; export the {self.what} again.")

    def rows(self):
        """Rows that are not blank: line number, cells, and whether all its numbers are plain."""
        plain = _PLAIN[self.delimiter]
        for number, line, ended in self._lines:
            if line and not line.isspace():
                self.ended = ended
                if "," in line and self.delimiter != ",":
                    pointed = line.replace(",", ".")  # decimal commas
                    line = pointed if plain.fullmatch(pointed) else line
                yield number, self.cells(number, line), bool(plain.fullmatch(line))

    def cells(self, number, line):
        """The cells of a line; quotes must be closed within it."""
        if '"' not in line:
            return line.split(self.delimiter)
        try:
            return next(csv.reader([line], delimiter=self.delimiter, strict=True))
        except csv.Error:
            raise ValueError(
                f"{self.place(number)}: a quotation mark that is not closed, or stands "
                "within a value; remove it."
            ) from None

    def place(self, number, column=None):
        """File, line and column, for messages."""
        return f"{self.path}, line {number}" + (f", column {column}" if column else "")

    def number(self, number, name, cell):
        """The number in a cell as float; no number is `1_0`, NaN, infinity or another alphabet's.

        Raises
        ------
        ValueError
            Naming file, line, column and cell.
        """
        text = cell.strip(" ")
        value = as_number(text)
        if value is None:
            shown = text if len(text) <= 40 else text[:40] + "..."
            raise ValueError(
                f"{self.place(number, name)}: "
                + (f"{shown!r} is no number" if text else "the cell is empty")
                + (
                    "; take the signs % off and give scale=0.01."
                    if as_number(text.removesuffix("%").strip()) is not None and "%" in text
                    else "; repair it, or empty all numbers of the row if nothing was seen there."
                )
            )
        if abs(value) > 1e300:
            raise ValueError(f"{self.place(number, name)}: {text[:40]} is beyond what is counted.")
        return value


def as_number(text):
    """The number that a text is, as a float, with a point or a comma; None if it is none.

    No number is `1_0`, NaN, infinity or another alphabet's; what is too large becomes infinite.

    Examples
    --------
    >>> as_number("0,5"), as_number("1_0")
    (0.5, None)
    """
    return float(text.replace(",", ".")) if _NUMBER.fullmatch(text) else None


def time_columns(header, coded=True):
    """Which columns of a table tell the time, by their names; `coded` if one may hold time codes.

    Returns
    -------
    time : int or None
        The one that tells most: a time code, seconds, or milliseconds.
    milliseconds : bool
    frame : int or None

    Examples
    --------
    >>> time_columns(["Frame", "Time (Seconds)", "jawOpen"])
    (1, False, 0)
    """
    keys = [normalised(name) for name in header]
    names = [n for n in (*_SECONDS, *_MILLISECONDS) if coded or not n.startswith("timecode")]
    time = next((keys.index(name) for name in names if name in keys), None)
    frames = (k for k, key in enumerate(keys) if key in _FRAME or (k == 0 and not header[0]))
    return time, time is not None and keys[time] in _MILLISECONDS, next(frames, None)


def tells_time(name):
    """Whether a column of that name counts time or frames, in whatever unit.

    Examples
    --------
    >>> tells_time("Time (ms)"), tells_time("timestamp_us"), tells_time("jawOpen")
    (True, True, False)
    """
    return normalised(name) in {*_SECONDS, *_MILLISECONDS, *_UNREAD, *_FRAME}


def delimiter_of(line):
    """What parts the cells of a line: tab, semicolon or comma."""
    bare = re.sub(r'"[^"]*"', "", line)
    return max("\t;,", key=bare.count) if any(d in bare for d in "\t;,") else ","
