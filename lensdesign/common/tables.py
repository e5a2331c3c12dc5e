"""The one reader of text tables that users hand in: lists, columns with a header, grids of numbers.

A table is read exactly or refused with its file and line. A decimal comma, a thousands separator and a cell
that no column claims are never interpreted: which of several meanings was intended cannot be decided from
the text. The exports of a spreadsheet differ by country, so the columns of a table with a header may be
separated by commas, semicolons or tabs.
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
_SIGNS = ("\N{MINUS SIGN}", "\N{EN DASH}", "\N{HYPHEN}", "\N{NON-BREAKING HYPHEN}")

SEPARATORS = (";", "\t", ",")
"""What may stand between the columns of a table with a header."""


def read_number(text: str, where: str, name: str = "") -> float:
    """The number that a cell holds: digits with a decimal point, and nothing else.

    Parameters
    ----------
    text
        The cell; spaces around the number do not count.
    where
        File and line, which messages begin with.
    name
        What the number is.

    Returns
    -------
    float
        The value; `nan` and `inf` as they are written, for the caller to judge.

    Raises
    ------
    InputError
        If the cell holds anything else, such as a decimal comma, a thousands separator or a unit.
    """
    cell = text.strip()
    word = _WORDS.get(cell.casefold())
    if word is not None:
        return word
    if _NUMBER.fullmatch(cell) and not _LEADING_ZERO.match(cell):
        return float(cell)
    said = f"{where}: {name} = {cell[:40]!r}" if name else f"{where}: {cell[:40]!r}"
    if _LEADING_ZERO.match(cell) and _NUMBER.fullmatch(cell):
        raise InputError(
            f"{said}: begins with a needless zero, as the digits behind a decimal comma do; write numbers "
            "with a decimal point and without leading zeros"
        )
    if _THOUSANDS.fullmatch(cell) and not (_DECIMAL_COMMA.fullmatch(cell) or _NUMBER.fullmatch(cell)):
        raise InputError(
            f"{said} is not a number: thousands separators are not read; write digits and at most one "
            "decimal point"
        )
    if _DECIMAL_COMMA.fullmatch(cell):
        raise InputError(
            f"{said} is not a number: a comma may be a decimal comma or a thousands separator; write a "
            f"decimal point, {cell.replace(',', '.')} if that is meant"
        )
    if cell[:1] in _SIGNS:
        raise InputError(f"{said} is not a number: its sign is a dash; write a hyphen, -")
    raise InputError(f"{said} is not a number")


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
        """Cells of a column, each with its file and line.

        Raises
        ------
        InputError
            If there is no such column, or several.
        """
        if self.names.count(name) != 1:
            if name in self.names:
                raise InputError(
                    f"{self.path}: {self.names.count(name)} columns are called {name!r}; one must be"
                )
            listed = ", ".join(own[:40] for own in self.names[:20])
            raise InputError(
                f"{self.path}: there is no column {name!r}; allowed: {listed}{did_you_mean(name, self.names)}"
            )
        place = self.names.index(name)
        return [(cells[place], f"{self.path}, line {line}") for line, cells in self.rows]


def read_table(path: Path, most_bytes: int = TABLE_BYTES) -> Table:
    """Read a table whose first line that is not empty names the columns; empty lines do not count.

    Columns are separated by commas, or by the semicolons or tabs that the first line holds outside of quotes.

    Raises
    ------
    InputError
        If the file cannot be read, is empty or no table, or a row has more or fewer cells than there are
        columns.
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
        raise DesignError(f"{path}: holds nothing; its first line must name the columns")
    return Table(path, names, tuple(rows))


def read_list(path: Path, name: str, most_bytes: int = TABLE_BYTES) -> list[tuple[float, str]]:
    """Numbers of a list, one a line, each with its file and line.

    Empty lines and what follows a # do not count. Behind the number, after a comma or semicolon, a remark
    may stand; one that begins like a number is refused.

    Parameters
    ----------
    path
        The file.
    name
        What the numbers are, for messages.
    most_bytes
        Most bytes that are read.

    Raises
    ------
    InputError
        If the file cannot be read, or a line does not hold one number.
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
    """A row of a grid: numbers between commas; nothing between commas is NaN.

    Raises
    ------
    InputError
        If a cell is not a number.
    """
    return [read_number(cell.strip() or "nan", where) for cell in text.split(",")]


def validate_no_comma_pairs(rows: Sequence[tuple[str, str]]) -> None:
    """Refuse a grid whose whole numbers come in pairs, as those with decimal commas do.

    Such a grid has no decimal point, twice as many columns as it was meant to have, and signs in every other
    column at most.

    Parameters
    ----------
    rows
        Text, and file and line, of each row.

    Raises
    ------
    InputError
        Naming the first line.
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
    """A text before and behind the first of some characters, and the character."""
    places = [place for character in separators if (place := text.find(character)) >= 0]
    if not places:
        return text, "", ""
    return text[: min(places)], text[min(places)], text[min(places) + 1 :]


def _separator(lines: Sequence[str]) -> str:
    """What separates the columns of a table: the first of `SEPARATORS` that its header holds."""
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
    """Neighbouring cells that together read as a number with a decimal comma."""
    for first, second in pairwise(cells):
        if re.fullmatch(r"[+-]?[0-9]+", first) and re.fullmatch(r"[0-9]+", second):
            yield f"{first},{second}"
