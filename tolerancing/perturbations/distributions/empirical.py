"""Distribution of measured deviations."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import PrivateAttr, field_validator

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import as_path
from lensdesign.common.tables import read_number, read_table
from lensdesign.errors import InputError
from tolerancing.perturbations.distributions.base import Distribution, check_factor

MOST_BYTES = 10_000_000
"""Largest allowed size of a file of measured values."""


@dataclass(frozen=True)
class _Measured:
    """Measured values in increasing order; two objects are equal if their digests are equal."""

    digest: str
    values: Array = field(compare=False, repr=False)


class Empirical(Distribution):
    """Distribution of measured deviations from a column of a CSV file with a header line; `mean` shifts them.

    The reader of a study file reads the values together with the study (:meth:`loaded`). A distribution made
    in Python reads them at their first use. Quantiles are interpolated linearly between the measured values
    in increasing order.

    Attributes
    ----------
    file
        The CSV file, relative to the study file; in Python, relative to the current folder.
    column
        Name of the column in the header line.
    """

    kind = "empirical"
    widths = ()

    file: Path
    column: str

    _measured: _Measured | None = PrivateAttr(default=None)

    _path = field_validator("file", mode="before")(as_path)

    @property
    def file_name(self) -> str:
        return str(self.file)

    def loaded(self, folder: Path) -> Self:
        """Return this distribution together with its measured values.

        Raises
        ------
        InputError
            If `file`, relative to `folder`, cannot be read or is larger than `MOST_BYTES`; if it has no such
            column or several; if a cell is not a finite number; or if there are no two different values.
        """
        return self._with(_read_column(folder / self.file, self.column))

    @property
    def values(self) -> Array:
        """The measured values in increasing order, read from the file at their first use."""
        return self._read().values

    @property
    def digest(self) -> str:
        """SHA-256 of the measured values in increasing order."""
        return self._read().digest

    def quantile(self, probability: Array) -> Array:
        ranks = np.linspace(0.0, 1.0, len(self.values))
        return self.mean + np.interp(probability, ranks, self.values)

    @property
    def standard_deviation(self) -> float:
        a, b = self.values[:-1] - self._middle, self.values[1:] - self._middle
        return math.sqrt(float(np.mean(a * a + a * b + b * b)) / 3.0)

    @property
    def largest(self) -> float:
        return float(np.max(np.abs(self.values - self._middle)))

    @property
    def centre(self) -> float:
        return self.mean + self._middle

    def scaled(self, factor: float) -> Self:
        check_factor(factor)
        return self._with(self._middle + factor * (self.values - self._middle))

    @property
    def _middle(self) -> float:
        """Expected value; the density is uniform between two neighbouring measured values."""
        return float(np.mean(0.5 * self.values[:-1] + 0.5 * self.values[1:]))

    def _read(self) -> _Measured:
        if self._measured is None:
            self._measured = _measured(_read_column(self.file, self.column))
        return self._measured

    def _with(self, values: Array) -> Self:
        changed = self.model_copy()
        changed._measured = _measured(values)
        return changed


def _measured(values: Array) -> _Measured:
    ordered = np.sort(values) + 0.0  # turns -0.0 into 0.0, so that equal values have equal digests
    ordered.flags.writeable = False
    return _Measured(hashlib.sha256(ordered.astype("<f8").tobytes()).hexdigest(), ordered)


def _read_column(path: Path, column: str) -> Array:
    """Read a column of a table whose first line names the columns."""
    table = read_table(path, MOST_BYTES)
    values = [_value(cell, column, location) for cell, location in table.column(column)]
    if len(values) < 2:
        raise InputError(f"{path}: column {column!r} has {len(values)} values: must be at least 2")
    if min(values) == max(values):
        raise InputError(
            f"{path}: column {column!r} has only the value {values[0]:g}: give two different values"
        )
    return np.array(values)


def _value(text: str, column: str, location: str) -> float:
    value = read_number(text, location, column)
    if not abs(value) <= 1e9:
        raise InputError(f"{location}: {column} = {value}: must be a finite number from -1e9 to 1e9")
    return value
