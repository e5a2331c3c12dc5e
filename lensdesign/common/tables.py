"""Reader of text tables of users: lists, columns with a header, grids of numbers.

A table is read exactly, or refused with its file and line. A decimal comma, a thousands separator and a cell
without a column are never interpreted, since their meaning is ambiguous. Exports of spreadsheets differ by
country, so the columns of a table with a header may be separated by commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from lensdesign.common.input_files import TABLE_BYTES
from lensdesign.common.toml_files import did_you_mean, read_text
from lensdesign.errors import DesignError, InputError

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", re.ASCII)
_WORDS = {"nan": math.nan, "inf": math.inf, "+inf": math.inf, "-inf": -math.inf}
_LEADING_ZERO = re.compile(r"[+-]?0[0-9]")
_DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:[ ,.'\u2019\u00a0\u202f][0-9]{3})+(?:[.,][0-9]*)?")
_STARTS_WITH_DIGIT = re.compile(r"[+-]?[.]?[0-9]")

SEPARATORS = (";", "\t", ",")
"""Allowed separators of the columns of a table with a header."""


def read_number(text: str, where: str, name: str = "") -> float:
    """Return the number in a cell, which must be written as digits with a decimal point.

    Parameters
    ----------
    text
        The cell; spaces around the number are ignored.
    where
        File and line, with which messages begin.
    name
        Name of the number in messages.

    Returns
    -------
    float
        The value; `nan` and `inf` are returned as such.

    Raises
    ------
    InputError
        If the cell contains anything else, such as a decimal comma, a thousands separator or a unit.
    """
    cell = text.strip()
    word = _WORDS.get(cell.casefold())
    if word is not None:
        return word
    if _NUMBER.fullmatch(cell) and not _LEADING_ZERO.match(cell):
        return float(cell)
    prefix = f"{where}: {name} = {cell[:40]!r}" if name else f"{where}: {cell[:40]!r}"
    if _LEADING_ZERO.match(cell) and _NUMBER.fullmatch(cell):
        raise InputError(
            f"{prefix}: begins with a zero, like the digits after a decimal comma; write numbers with "
            "a decimal point and without leading zeros"
        )
    if _THOUSANDS.fullmatch(cell) and not (_DECIMAL_COMMA.fullmatch(cell) or _NUMBER.fullmatch(cell)):
        raise InputError(
            f"{prefix} is not a number: thousands separators are not read; write digits and at most one "
            "decimal point"
        )
    if _DECIMAL_COMMA.fullmatch(cell):
        raise InputError(
            f"{prefix} is not a number: a comma may be a decimal comma or a thousands separator; write a "
            f"decimal point, {cell.replace(',', '.')} if that is meant"
        )
    signs = ("\N{MINUS SIGN}", "\N{EN DASH}", "\N{HYPHEN}", "\N{NON-BREAKING HYPHEN}")
    if cell[:1] in signs:
        raise InputError(f"{prefix} is not a number: its sign is a dash; write a hyphen, -")
    raise InputError(f"{prefix} is not a number")


@dataclass(frozen=True)
class Table:
    """A table whose first line names its columns.

    Attributes
    ----------
    path
        The file.
    names
        Names of the columns.
    rows
        Line number and cells of each row; all rows have as many cells as there are names.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[int, tuple[str, ...]], ...]

    def column(self, name: str) -> list[tuple[str, str]]:
        """Return the cells of a column, each with its file and line.

        Raises
        ------
        InputError
            If there is no such column, or more than one.
        """
        if self.names.count(name) != 1:
            if name in self.names:
                raise InputError(
                    f"{self.path}: {self.names.count(name)} columns are called {name!r}; allowed: one"
                )
            listed = ", ".join(own[:40] for own in self.names[:20])
            raise InputError(
                f"{self.path}: there is no column {name!r}; allowed: {listed}{did_you_mean(name, self.names)}"
            )
        index = self.names.index(name)
        return [(cells[index], f"{self.path}, line {line}") for line, cells in self.rows]


def read_table(path: Path, most_bytes: int = TABLE_BYTES) -> Table:
    """Read a table whose first non-empty line names the columns; empty lines are ignored.

    Columns are separated by commas, or by semicolons or tabs if the first line contains them outside quotes.

    Raises
    ------
    InputError
        If the file cannot be read, is empty or not a table, or the number of cells of a row differs from the
        number of columns.
    """
    lines = read_text(path, most_bytes).splitlines()
    reader = csv.reader(lines, delimiter=_separator(lines), skipinitialspace=True)
    names: tuple[str, ...] = ()
    rows = []
    try:
        for row in reader:
            cells = tuple(cell.strip() for cell in row)
            if not any(cells):
                continue
            if not names:
                names = cells
                continue
            _check_width(cells, names, f"{path}, line {reader.line_num}")
            rows.append((reader.line_num, cells))
    except csv.Error as error:
        raise DesignError(f"{path}, line {reader.line_num}: not a CSV file: {error}") from error
    if not names:
        raise DesignError(f"{path}: is empty; its first line must name the columns")
    return Table(path, names, tuple(rows))


def read_list(path: Path, name: str, most_bytes: int = TABLE_BYTES) -> list[tuple[float, str]]:
    """Return the numbers of a list, one per line, each with its file and line.

    Empty lines and text after a # are ignored. A remark may follow the number after a comma or semicolon; a
    remark that begins like a number is refused.

    Parameters
    ----------
    path
        The file.
    name
        Name of the numbers in messages.
    most_bytes
        Largest size of the file in bytes.

    Raises
    ------
    InputError
        If the file cannot be read, or a line does not contain exactly one number.
    """
    found = []
    for count, line in enumerate(read_text(path, most_bytes).splitlines(), start=1):
        text, where = line.split("#")[0].strip(), f"{path}, line {count}"
        if not text:
            continue
        first, separator, remark = _at_first(text, ",;")
        if separator and _STARTS_WITH_DIGIT.match(remark.strip()):
            raise InputError(
                f"{where}: {text[:40]!r}: holds more than one number, or a decimal comma; write one {name} a "
                "line, with a decimal point"
            )
        found.append((read_number(first, where, name), where))
    return found


def read_grid_row(text: str, where: str) -> list[float]:
    """Return a row of a grid: numbers separated by commas; an empty cell is NaN.

    Raises
    ------
    InputError
        If a cell is not a number.
    """
    return [read_number(cell.strip() or "nan", where) for cell in text.split(",")]


def validate_no_comma_pairs(rows: Sequence[tuple[str, str]]) -> None:
    """Refuse a grid of whole numbers that may be pairs separated by decimal commas.

    Such a grid has no decimal point, twice the intended number of columns, and signs in every other column at
    most.

    Parameters
    ----------
    rows
        Text of each row, with its file and line.

    Raises
    ------
    InputError
        If the grid has this form; the message names the first line.
    """
    cells = [[cell.strip() for cell in text.split(",")] for text, _ in rows]
    width = len(cells[0]) if cells else 0
    if width < 2 or width % 2 or any(not re.fullmatch(r"[+-]?[0-9]+", c) for row in cells for c in row):
        return
    if any(cell[0] in "+-" for row in cells for cell in row[1::2]):
        return
    signs = any(cell[0] in "+-" for row in cells for cell in row[0::2])
    if signs or width == 2 * len(rows):
        raise InputError(
            f"{rows[0][1]}: {rows[0][0][:40]!r}: may be {width} whole numbers or {width // 2} with decimal "
            "commas; write at least one number of the grid with a decimal point (12.0)"
        )


def _at_first(text: str, separators: str) -> tuple[str, str, str]:
    """Return the text before the first of some characters, the character, and the text after it."""
    positions = [position for character in separators if (position := text.find(character)) >= 0]
    if not positions:
        return text, "", ""
    first = min(positions)
    return text[:first], text[first], text[first + 1 :]


def _separator(lines: Sequence[str]) -> str:
    """Return the separator of the columns: the first of `SEPARATORS` that the header contains."""
    header = next((line for line in lines if line.strip(" ,;\t")), "")
    bare = re.sub(r'"[^"]*"', "", header)
    return next((separator for separator in SEPARATORS if separator in bare), ",")


def _check_width(cells: tuple[str, ...], names: tuple[str, ...], where: str) -> None:
    if len(cells) > len(names):
        surplus = next(_pairs(cells), "")
        hint = f"; {surplus!r} may hold a decimal comma: write a decimal point" if surplus else ""
        raise InputError(
            f"{where}: {len(cells)} cells, but the first line names {len(names)} "
            f"{'column' if len(names) == 1 else 'columns'}: must be equal{hint}"
        )
    if len(cells) < len(names):
        lacking = names[len(cells)]
        raise InputError(
            f"{where}: no value in column {lacking!r}: {len(cells)} cells, but the first line names "
            f"{len(names)} columns"
        )


def _pairs(cells: Sequence[str]) -> Iterator[str]:
    """Yield neighbouring cells that together form a number with a decimal comma."""
    for first, second in pairwise(cells):
        if re.fullmatch(r"[+-]?[0-9]+", first) and re.fullmatch(r"[0-9]+", second):
            yield f"{first},{second}"
