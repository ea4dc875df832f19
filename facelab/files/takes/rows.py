"""Rows of a table in text, read by what each column is: time, weights, or something else."""

from array import array
from operator import itemgetter

import numpy as np

from facelab.files.takes.recording import Recording

_EMPTY = ("", "nan", "NaN", "na", "NA", "null", "None")


def read_rows(table, columns, rows=None):
    """The rows of a table as a `Recording`.

    A row without a face holds no numbers, or a time code and the count 0. A last row that is cut
    short is left out with a word. What a reader may still find contradictory is refused here: rows
    of another length, counts that change, cells that are no numbers.

    Parameters
    ----------
    table : TextTable
        With its rows still to come.
    columns : Columns
    rows : iterable, optional
        Its rows, if they are not just as they stand there.

    Returns
    -------
    Recording

    Raises
    ------
    ValueError
        Naming file, line and column.
    """
    reader = _Reader(table, columns)
    doubt = None  # a last row may be cut, no other
    for number, cells, plain in table.rows() if rows is None else rows:
        if doubt is not None:
            raise doubt
        try:
            reader.add(number, cells, plain)
        except _CutError as error:
            doubt = error
    found = reader.recording()
    path = table.path
    if doubt is not None:
        found.warned.append(f"the last row, line {reader.last}, is cut short and left out")
    elif not table.ended and reader.cut_within_a_number():
        reader.drop_last(found)
        found.warned.append(
            f"the last row, line {reader.last}, ends in a number with fewer digits than all others "
            "there: cut short and left out"
        )
    elif not table.ended:
        found.warned.append(
            f"the last row, line {reader.last}, has no line end: its last number may be cut"
        )
    if not len(found.rows):
        raise ValueError(f"{path}: no frames below the header, line {table.header_line}.")
    return found


class _CutError(ValueError):
    """A row that is too short: the last one may be."""


class _Reader:
    def __init__(self, table, columns):
        self.table, self.columns = table, columns
        self.width = len(table.header)
        at = list(columns.numbers)
        self.pick = itemgetter(*at) if len(at) > 1 else lambda cells: [cells[k] for k in at]
        self.names = list(columns.numbers.values())
        self.values = array("d")
        self.rows, self.codes, self.frames = [], [], []
        self.others = {k: [] for k in columns.others}
        self.count = self.fps = self.last = None
        self.tails = []

    def add(self, number, cells, plain):
        """Take one row in; nothing of it is kept if it is refused."""
        self.last, columns, place = number, self.columns, self.table.place(number)
        if len(cells) != self.width:
            cells = self._fitted(cells, place)
        picked, counted = self.pick(cells), None
        if columns.count is not None:
            counted = self._whole(number, columns.count, cells)
        bare = [cell.strip() for cell in picked]
        if counted == 0 or all(cell in _EMPTY for cell in bare):
            written = all(bare)  # as NaN: no row that was cut
            values = self._lost(picked, None if written else counted, place)
        else:
            values = self._numbers(number, picked, plain)
            self._same_count(counted, number)
        if columns.frame is not None:
            self.frames.append(self._whole(number, columns.frame, cells))
        if columns.fps is not None:
            self._same_fps(number, cells[columns.fps])
        if columns.time is not None:
            self.codes.append(cells[columns.time].strip())
        for k, column in self.others.items():
            column.append(cells[k].strip())
        self.rows.append(number)
        self.values.extend(values)
        self.tails = [*self.tails[-3:], cells[self.width - 1]]

    def _fitted(self, cells, place):
        while len(cells) > self.width and not cells[-1].strip():
            cells = cells[:-1]
        if len(cells) > self.width:
            raise ValueError(
                f"{place}: {len(cells)} values, but the header names {self.width} columns; remove "
                "what is too much, or name it."
            )
        if len(cells) < self.width:
            count = self.columns.count
            if count is None or len(cells) <= count or cells[count].strip() != "0":
                raise _CutError(
                    f"{place}: {len(cells)} values, but the header names {self.width} columns; "
                    "complete the row, or remove it."
                )
            cells = cells + [""] * (self.width - len(cells))  # a frame without a face
        return cells

    def _whole(self, number, column, cells):
        name, text = self.table.header[column] or f"{column + 1}", cells[column].strip()
        value = self.table.number(number, name, text)
        if value % 1 or not 0 <= value < 1e15:
            raise ValueError(f"{self.table.place(number, name)}: {text!r} is no whole number.")
        return int(value)

    def _lost(self, picked, counted, place):
        for name, cell in zip(self.names, picked, strict=True):
            if cell.strip(" 0.,") not in _EMPTY:
                raise ValueError(
                    f"{place}: the row counts 0 weights, for a frame without a face, but has "
                    f"{name} {cell.strip()[:40]}; remove one or the other."
                )
        if counted:
            raise _CutError(f"{place}: the row counts {counted} weights but has none; complete it.")
        return [np.nan] * len(picked)

    def _numbers(self, number, picked, plain):
        if plain:
            try:
                return [float(cell) for cell in picked]
            except ValueError:
                pass  # below it is said where
        values = []
        for k, name, cell in zip(self.columns.numbers, self.names, picked, strict=True):
            try:
                values.append(self.table.number(number, name, cell))
            except ValueError as error:
                if k == self.width - 1 and not self.table.ended:
                    raise _CutError(str(error)) from None
                if not self.rows and self.table.what == "table of weights":
                    raise ValueError(
                        f"{error} If the column holds no weights, name those that do: names=[...]."
                    ) from None
                raise
        return values

    def _same_count(self, counted, number):
        if self.count is None:
            self.count = counted
        elif counted != self.count:
            raise ValueError(
                f"{self.table.place(number)}: the row counts {counted} weights, those before "
                f"{self.count}; one of them is damaged."
            )

    def _same_fps(self, number, text):
        if self.fps is None:
            self.fps = text.strip()
            rate = self.table.number(number, self.table.header[self.columns.fps], text)
            if rate <= 0:
                raise ValueError(
                    f"{self.table.place(number)}: a rate of {text.strip()} frames a second; "
                    "it must be more than 0."
                )
        elif text.strip() != self.fps:
            raise ValueError(
                f"{self.table.place(number)}: here should be {self.fps} frames a second, as "
                f"above, but there is {text.strip()[:40]!r}; the table was cut or edited."
            )

    def cut_within_a_number(self):
        """True if all rows but the last end in as many decimals, at least four, and it in fewer."""
        decimals = [len(tail.strip().partition(".")[2]) for tail in self.tails]
        return len(decimals) > 3 and decimals[-1] < min(decimals[:-1]) == max(decimals[:-1]) > 3

    def drop_last(self, found):
        """Leave the last row of the recording out."""
        found.values, found.rows = found.values[:-1], found.rows[:-1]
        found.codes = found.codes and found.codes[:-1]
        found.frames = found.frames and found.frames[:-1]
        found.others = {name: column[:-1] for name, column in found.others.items()}

    def recording(self):
        columns, n = self.columns, len(self.rows)
        others, texts = {}, []
        for k, cells in self.others.items():
            try:
                others[columns.others[k]] = np.array(
                    [np.nan if c in _EMPTY else self.table.number(0, "", c) for c in cells]
                )
            except ValueError:
                texts.append(columns.others[k])
        codes = self.codes if columns.time is not None else None
        if codes and columns.milliseconds:
            codes = [self._milliseconds(r, c) for r, c in zip(self.rows, codes, strict=True)]
        found = Recording(
            path=self.table.path,
            names=self.names,
            values=np.array(self.values).reshape(n, len(self.names)),
            rows=self.rows,
            codes=codes,
            frames=self.frames if columns.frame is not None else None,
            count=self.count,
            fps=None if self.fps is None else float(self.fps.replace(",", ".")),
            others=others,
        )
        if texts:
            found.warned.append(f"columns of text are left out: {', '.join(texts)}")
        return found

    def _milliseconds(self, number, text):
        value = self.table.number(number, self.table.header[self.columns.time], text)
        return f"{value / 1000:.6f}"
