"""Tables that a notebook shows as HTML, and a terminal as text."""

from html import escape
from numbers import Integral, Real

_CELL = "padding: 2px 10px; white-space: nowrap; text-align: "


class Table:
    """Rows under headings with units, sorted by what matters; the last value of a notebook cell.

    Parameters
    ----------
    columns : sequence of str
        Headings, units in brackets.
    rows : iterable of sequences
        One value for a column; numbers are aligned, None is left empty.
    digits : int, default=2
        Decimals of numbers that are not whole.
    sort : str, optional
        The heading to sort by; with a minus before it from large to small.
    title : str, default=""

    Raises
    ------
    ValueError
        If a row has not one value for a column, or `sort` is no heading.

    Examples
    --------
    >>> Table(["actor", "skin (mm)"], [("M2", 0.951), ("M1", 0.82)], sort="skin (mm)")
    actor  skin (mm)
    M1          0.82
    M2          0.95
    """

    def __init__(self, columns, rows, digits=2, sort=None, title=""):
        self.columns, self.title = tuple(columns), title
        self.digits = digits
        rows = [tuple(row) for row in rows]
        if any(len(row) != len(self.columns) for row in rows):
            raise ValueError(f"each row needs {len(self.columns)} values, one for a column.")
        if sort is not None:
            if sort.removeprefix("-") not in self.columns:
                raise ValueError(f"sort={sort!r} is no heading; there are {self.columns}.")
            at = self.columns.index(sort.removeprefix("-"))
            rows.sort(key=lambda row: row[at], reverse=sort.startswith("-"))
        self.rows = rows

    def _text(self, value):
        if value is None:
            return ""
        whole = isinstance(value, Integral | str) or not isinstance(value, Real)
        return str(value) if whole else f"{value:.{self.digits}f}"

    def _right(self):
        """Which columns hold numbers."""
        return [
            all(row[k] is None or isinstance(row[k], Real) for row in self.rows)
            for k in range(len(self.columns))
        ]

    def __repr__(self):
        lines = [self.columns, *([self._text(v) for v in row] for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        right = self._right()
        text = [
            "  ".join(
                cell.rjust(w) if r else cell.ljust(w)
                for cell, w, r in zip(line, widths, right, strict=True)
            ).rstrip()
            for line in lines
        ]
        return "\n".join([self.title, *text] if self.title else text)

    def _repr_html_(self):
        sides = ["right" if r else "left" for r in self._right()]

        def line(cells, tag):
            inside = (
                f'<{tag} style="{_CELL}{side}">{escape(cell)}</{tag}>'
                for cell, side in zip(cells, sides, strict=True)
            )
            return f"<tr>{''.join(inside)}</tr>"

        body = "".join(line(map(self._text, row), "td") for row in self.rows)
        title = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        return (
            f"<table>{title}<thead>{line(self.columns, 'th')}</thead><tbody>{body}</tbody></table>"
        )
