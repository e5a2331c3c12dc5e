"""What all results have in common: a table of names and values, their representations, and their files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table
from wavesim.runtime.result_files import new_results, write_json


class Result(ABC):
    """Base of results: each one states its table, and has its representations from it."""

    heading: ClassVar[str]
    """Title of the table in a notebook."""

    @abstractmethod
    def table(self) -> list[tuple[str, str]]:
        """Return name and value of the most important properties of the result, as text."""

    def _picture(self) -> NDArray[Any] | None:
        """Return the values that a notebook shows below the table, if any."""
        return None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name} {value}' for name, value in self.table())})"

    def _repr_html_(self) -> str:
        picture = self._picture()
        return html_table(self.heading, self.table(), "" if picture is None else html_picture(picture))


class WritableResult(Result):
    """Base of results that are written to a folder: plain values in a JSON file, arrays and pictures."""

    file: ClassVar[str]
    """Name of the JSON file."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""

    @abstractmethod
    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        """Write arrays, curves and pictures; the summary holds the plain values."""

    def write(self, folder: str | Path, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Write the files that the command writes: plain values (JSON), arrays and pictures.

        A failure leaves the folder as it was; otherwise, earlier files of the same names are replaced.

        Parameters
        ----------
        folder
            Folder of the result, which is created if it does not exist.
        more
            Further plain values for the JSON file, or other values for those of `as_dict`, such as `design`,
            the name of the lens in titles of pictures.

        Returns
        -------
        dict
            The plain values, with the paths of all files.

        Raises
        ------
        InputError
            If the folder or its files cannot be written.
        """
        summary = self.as_dict() | dict(more or {}) | {"versions": versions()}
        with new_results(Path(folder)) as new:
            self._write_files(new, summary)
            names = sorted([*(path.name for path in new.iterdir()), self.file])
            write_json(summary | {"files": names}, new / self.file)
        return summary | {"files": [str(Path(folder) / name) for name in names]}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    import platform
    from importlib.metadata import version

    return {"python": platform.python_version()} | {
        name: version(name) for name in ("transferlens", "numpy", "scipy", "finufft")
    }
