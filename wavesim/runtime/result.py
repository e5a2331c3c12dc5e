"""What all results have in common: a table of names and values, their representations, and their files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table


class Result(ABC):
    """Base of results: each one states its rows, and has its representations from them."""

    heading: ClassVar[str]
    """Title of the table in a notebook."""

    def table(self) -> list[tuple[str, str]]:
        """Return name and value of the most important properties of the result, as text."""
        return self._rows()

    @abstractmethod
    def _rows(self) -> list[tuple[str, str]]:
        """Return name and value of each row."""

    def _picture(self) -> NDArray[Any] | None:
        """Return the values that a notebook shows below the table, if any."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name} {value}' for name, value in self.table())})"

    def _repr_html_(self) -> str:
        picture = self._picture()
        return html_table(self.heading, self.table(), "" if picture is None else html_picture(picture))
