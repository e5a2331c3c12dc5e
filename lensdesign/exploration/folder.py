"""Folder of an exploration: results so far, the front as a table, and a design file for each lens."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.clusters import toolkit_version
from lensdesign.common.input_files import TABLE_BYTES, check_input
from lensdesign.common.text import safe_cell
from lensdesign.errors import InputError
from lensdesign.exploration.front import ExploredPoint, front_of
from lensdesign.exploration.objectives import Axis
from lensdesign.files.design import design_text, load_design
from lensdesign.optimization.specification.specification import Specification

ENDS, FRONT = "searches.jsonl", "front.csv"


@dataclass(frozen=True)
class ExplorationFolder:
    """Folder that stores the results of an exploration, so that it can be resumed.

    Attributes
    ----------
    path : Path
        The folder.
    fingerprint : str
        Hash of all inputs of the exploration. A folder with another fingerprint is rejected.
    """

    path: Path
    fingerprint: str

    def begin(self, fresh: bool = False) -> dict[str, ExploredPoint]:
        """Create the folder, or read the results of this exploration from it.

        Parameters
        ----------
        fresh
            Whether to discard existing results (default: False).

        Returns
        -------
        dict
            Results by key.

        Raises
        ------
        InputError
            If the folder holds another exploration or other files, or cannot be read.
        """
        try:
            return self._begin(fresh)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(
                f"cannot use the folder {self.path}: {getattr(error, 'strerror', None) or error}"
            ) from error

    def _begin(self, fresh: bool) -> dict[str, ExploredPoint]:
        ends = self.path / ENDS
        if fresh and ends.exists():
            ends.unlink()
        if not ends.exists():
            if self.path.exists() and not fresh and any(self.path.iterdir()):
                raise InputError(
                    f"{self.path}: holds other files, but no {ENDS}; give an empty or a new folder"
                )
            self.path.mkdir(parents=True, exist_ok=True)
            with atomic_path(ends) as temporary:
                temporary.write_text(json.dumps({"exploration": self.fingerprint}) + "\n", encoding="utf-8")
            return {}
        check_input(ends, TABLE_BYTES)
        first, *lines = ends.read_text(encoding="utf-8").splitlines() or [""]
        if _read(first).get("exploration") != self.fingerprint:
            raise InputError(
                f"{self.path}: holds an exploration of another specification, study or objectives, or of "
                "another version; give another folder, or --fresh to replace it"
            )
        # The last line may be incomplete if the process was killed; its search is repeated.
        found = [_explored(self.path, row) for row in map(_read, lines) if "key" in row]
        return {one.key: one for one in found if one is not None}

    def keep(self, one: ExploredPoint) -> None:
        """Append the result of a search, and write the design file of its lens."""
        name = _name(one)
        if one.lens is not None:
            with atomic_path(self.path / name) as temporary:
                temporary.write_text(design_text(one.lens, self.path), encoding="utf-8")
        row = {
            "key": one.key,
            "glasses": one.glasses,
            "values": one.values,
            "point": list(one.point),
            "design": name if one.lens is not None else None,
        }
        try:
            with (self.path / ENDS).open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(f"cannot write {self.path / ENDS}: {error.strerror or error}") from error

    def write_front(self, explored: Sequence[ExploredPoint], axes: Sequence[Axis]) -> Path:
        """Write all lenses as a table (CSV) with a column that marks those on the front."""
        front = {one.key for one in front_of(explored, axes)}
        columns = [axis.objective.column for axis in axes]
        lenses = [one for one in explored if one.lens is not None]
        order = sorted(lenses, key=lambda one: [one.values[column] for column in columns])
        with atomic_path(self.path / FRONT) as temporary, temporary.open("w", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["design", "glasses", *columns, "on_front"])
            for one in order:
                cells = [f"{one.values[column]:.9g}" for column in columns]
                rows.writerow([_name(one), safe_cell(one.glasses), *cells, int(one.key in front)])
        return self.path / FRONT


def folder_for(
    path: Path, specification: Specification, axes: Sequence[Axis], lenses: int
) -> ExplorationFolder:
    """Return the folder of an exploration, with the fingerprint of all inputs that affect its results."""
    tolerances = specification.tolerances
    files = [] if tolerances is None else [tolerances.study, tolerances.costs]
    inputs = {
        "version": toolkit_version(),
        "specification": specification.model_dump(mode="json", exclude={"tolerances"}),
        "tolerances": None if tolerances is None else tolerances.model_dump(exclude={"study", "costs"}),
        "files": [None if file is None else Path(file).read_text(encoding="utf-8") for file in files],
        "axes": [(axis.objective.name, axis.bounds) for axis in axes],
        "lenses": lenses,
    }
    text = json.dumps(inputs, sort_keys=True, default=str)
    return ExplorationFolder(path, hashlib.sha256(text.encode()).hexdigest())


def _read(line: str) -> dict[str, Any]:
    try:
        row = json.loads(line)
    except json.JSONDecodeError:
        return {}
    return row if isinstance(row, dict) else {}


def _explored(folder: Path, row: dict[str, Any]) -> ExploredPoint | None:
    """Return the result in a row; None if its lens cannot be read, so that the search is repeated."""
    try:
        lens = None if row["design"] is None else load_design(folder / row["design"])
        return ExploredPoint(row["key"], row["glasses"], row["values"], tuple(row["point"]), lens)
    except (KeyError, InputError, TypeError, OSError):
        return None


def _name(one: ExploredPoint) -> str:
    """Return the file name of a lens: its key in portable characters, and a hash."""
    words = re.sub(r"[^A-Za-z0-9.]+", "_", one.key).strip("_")
    return f"{words[:80]}_{hashlib.sha256(one.key.encode()).hexdigest()[:6]}.toml"
