"""How a perturbation scatters: distributions by their quantiles, one class and one registry line each.

A distribution turns a probability into a value. Whatever makes the probabilities
(:mod:`tolerancing.perturbations.draws`, :mod:`tolerancing.perturbations.dependence`) therefore stays apart
from the shapes of the distributions.
"""

from __future__ import annotations

import csv
import hashlib
import math
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import PrivateAttr, field_validator, model_validator

from lensdesign.common.section import Finite, Positive, Section, as_path
from lensdesign.common.toml_files import did_you_mean, read_text
from lensdesign.errors import InputError

Array = NDArray[np.float64]

NARROWEST_LIMIT, WIDEST_LIMIT = 1e-3, 30.0
"""Limits of a truncated normal distribution, in sigma, beyond which it is another distribution."""

MOST_MEGABYTES = 10
"""Largest file of measured values."""


class Distribution(Section):
    """A distribution about `mean`; all values in the unit of the parameter that it perturbs.

    Attributes
    ----------
    mean
        Systematic deviation from nominal.
    """

    kind: ClassVar[str]
    widths: ClassVar[tuple[str, ...]]

    mean: Finite = 0.0

    @property
    def file_name(self) -> str | None:
        """A file beside the study that holds the distribution."""
        return None

    def loaded(self, folder: Path) -> Self:
        """The distribution with what its file holds; relative to a folder."""
        return self

    def quantile(self, probability: Array) -> Array:
        """Value below which a share `probability`, within 0 and 1, of all parts lies."""
        raise NotImplementedError

    @property
    def standard_deviation(self) -> float:
        """Standard deviation."""
        raise NotImplementedError

    @property
    def largest(self) -> float:
        """Largest deviation from the centre, either way, that counts as the tolerance."""
        raise NotImplementedError

    @property
    def centre(self) -> float:
        """Expected value."""
        return self.mean

    def scaled(self, factor: float) -> Self:
        """The same distribution with its width, but not its centre, multiplied.

        Raises
        ------
        InputError
            If the factor is not a finite number above 0.
        DesignError
            If a width becomes larger or smaller than a width can be.
        """
        _check_factor(factor)
        return self.replaced(**{name: factor * getattr(self, name) for name in self.widths})


class Normal(Distribution):
    """Normal distribution of standard deviation `sigma`; two sigma count as the tolerance."""

    kind = "normal"
    widths = ("sigma",)

    sigma: Positive

    def quantile(self, probability: Array) -> Array:
        from scipy.special import ndtri

        return self.mean + self.sigma * np.asarray(ndtri(probability))

    @property
    def standard_deviation(self) -> float:
        return self.sigma

    @property
    def largest(self) -> float:
        return 2.0 * self.sigma


class TruncatedNormal(Distribution):
    """Normal distribution of which parts farther than `limit` from the mean are sorted out."""

    kind = "truncated_normal"
    widths = ("sigma", "limit")

    sigma: Positive
    limit: Positive

    @model_validator(mode="after")
    def _truncates(self) -> Self:
        edge = self.limit / self.sigma
        if not NARROWEST_LIMIT <= edge <= WIDEST_LIMIT:
            raise ValueError(
                f"limit = {self.limit:g} is {edge:.3g} sigma; allowed: {NARROWEST_LIMIT:g} to "
                f"{WIDEST_LIMIT:g}; beyond, the distribution is {'uniform' if edge < 1.0 else 'normal'}"
            )
        return self

    def quantile(self, probability: Array) -> Array:
        from scipy.special import ndtr, ndtri

        tail = ndtr(-self.limit / self.sigma)
        inside = tail + probability * (1.0 - 2.0 * tail)
        deviation = self.sigma * np.asarray(ndtri(inside))
        return self.mean + np.clip(deviation, -self.limit, self.limit)

    @property
    def standard_deviation(self) -> float:
        edge = self.limit / self.sigma
        density = math.exp(-0.5 * edge * edge) / math.sqrt(2.0 * math.pi)
        shrink = 1.0 - 2.0 * edge * density / math.erf(edge / math.sqrt(2.0))
        return self.sigma * math.sqrt(max(shrink, 0.0))

    @property
    def largest(self) -> float:
        return self.limit


class Bounded(Distribution):
    """A symmetric distribution within `half_width` of the mean."""

    widths = ("half_width",)

    half_width: Positive

    @property
    def largest(self) -> float:
        return self.half_width


class Uniform(Bounded):
    """All values within `half_width` of the mean, alike."""

    kind = "uniform"

    def quantile(self, probability: Array) -> Array:
        return self.mean + self.half_width * (2.0 * probability - 1.0)

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(3.0)


class Triangular(Bounded):
    """Density that falls evenly from the mean to nothing at `half_width`."""

    kind = "triangular"

    def quantile(self, probability: Array) -> Array:
        side, tail = _side_and_tail(probability)
        return self.mean + self.half_width * side * (1.0 - np.sqrt(2.0 * tail))

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(6.0)


class Parabolic(Bounded):
    """Density proportional to 1 - (deviation / half_width)^2."""

    kind = "parabolic"

    def quantile(self, probability: Array) -> Array:
        # The share beyond t, (2 - 3 t + t^3) / 4, is sin^2 angle where t = 2 cos((pi + 2 angle) / 3).
        side, tail = _side_and_tail(probability)
        angle = np.arcsin(np.sqrt(tail)) * (2.0 / 3.0)
        return self.mean + self.half_width * side * (np.cos(angle) - math.sqrt(3.0) * np.sin(angle))

    @property
    def standard_deviation(self) -> float:
        return self.half_width / math.sqrt(5.0)


class EndPoint(Bounded):
    """Half of the parts at the lower end of the tolerance, half at the upper."""

    kind = "end_point"

    def quantile(self, probability: Array) -> Array:
        return self.mean + np.where(np.asarray(probability) < 0.5, -self.half_width, self.half_width)

    @property
    def standard_deviation(self) -> float:
        return self.half_width


@dataclass(frozen=True)
class _Measured:
    """Measured values in rising order; equal if their digests are."""

    digest: str
    values: Array = field(compare=False, repr=False)


class Empirical(Distribution):
    """Deviations as they were measured, a column of a CSV file with a header line; `mean` shifts them.

    The values are read by :meth:`loaded`, after which the distribution can be drawn from. Between the
    measured values, in rising order, quantiles are interpolated linearly.

    Attributes
    ----------
    file
        The CSV file, relative to the study file.
    column
        Name of the column, as the header line gives it.
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
        """This distribution together with its measured values.

        Raises
        ------
        InputError
            If `file`, relative to `folder`, cannot be read or is larger than `MOST_MEGABYTES`, has no such
            column or several, lacks a finite number in a cell, or has not two different ones.
        """
        return self._with(_read_column(folder / self.file, self.column))

    @property
    def values(self) -> Array:
        """The measured values in rising order; an InputError if they have not been read."""
        return self._read().values

    @property
    def digest(self) -> str:
        """SHA-256 of the measured values in rising order."""
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
        _check_factor(factor)
        return self._with(self._middle + factor * (self.values - self._middle))

    @property
    def _middle(self) -> float:
        """Expected value of the measured values; between two neighbours all are alike."""
        return float(np.mean(0.5 * self.values[:-1] + 0.5 * self.values[1:]))

    def _read(self) -> _Measured:
        if self._measured is None:
            raise InputError(f"{self.file}: column {self.column!r} has not been read")
        return self._measured

    def _with(self, values: Array) -> Self:
        ordered = np.sort(values) + 0.0  # there is one zero
        ordered.flags.writeable = False
        changed = self.model_copy()
        changed._measured = _Measured(hashlib.sha256(ordered.astype("<f8").tobytes()).hexdigest(), ordered)
        return changed


def _check_factor(factor: float) -> None:
    if not 0.0 < factor < math.inf:
        raise InputError(f"scale = {factor!r}: must be a finite number above 0")


def _side_and_tail(probability: Array) -> tuple[Array, Array]:
    """Which side of the mean a value lies on, -1 or 1, and the share of parts beyond it on that side."""
    probability = np.asarray(probability)
    lower = probability < 0.5
    return np.where(lower, -1.0, 1.0), np.where(lower, probability, 1.0 - probability)


def _read_column(path: Path, column: str) -> Array:
    """A column of a CSV file, whose first line names the columns; empty lines are passed over."""
    _refuse_large(path)
    reader = csv.reader(read_text(path).splitlines(), skipinitialspace=True)
    place: int | None = None
    values = []
    try:
        for row in reader:
            if not any(cell.strip() for cell in row):
                continue
            if place is None:
                place = _place([cell.strip() for cell in row], column, path)
            else:
                values.append(_value(row, place, column, f"{path}, line {reader.line_num}"))
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: not a CSV file: {error}") from error
    if place is None:
        raise InputError(f"{path}: holds nothing; its first line must name the columns")
    if len(values) < 2:
        raise InputError(f"{path}: column {column!r} holds {len(values)} values: must be at least 2")
    if min(values) == max(values):
        raise InputError(f"{path}: column {column!r} holds nothing but {values[0]:g}: it must scatter")
    return np.array(values)


def _refuse_large(path: Path) -> None:
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"cannot read {path}: it is no regular file")
    if status.st_size > MOST_MEGABYTES * 1_000_000:
        raise InputError(f"{path}: {status.st_size / 1e6:.1f} MB; allowed: up to {MOST_MEGABYTES} MB")


def _place(header: list[str], column: str, path: Path) -> int:
    if header.count(column) == 1:
        return header.index(column)
    if column in header:
        raise InputError(f"{path}: {header.count(column)} columns are called {column!r}; one must be")
    listed = ", ".join(name[:40] for name in header[:20])
    raise InputError(
        f"{path}: there is no column {column!r}; allowed: {listed}{did_you_mean(column, header)}"
    )


def _value(row: list[str], place: int, column: str, where: str) -> float:
    if place >= len(row):
        raise InputError(f"{where}: no value in column {column!r}")
    try:
        value = float(row[place].replace("_", "no digit"))
    except ValueError:
        raise InputError(f"{where}: {column} = {row[place][:40]!r} is not a number") from None
    if not abs(value) <= 1e9:
        raise InputError(f"{where}: {column} = {value}: must be a finite number, 1e9 at most either way")
    return value


DISTRIBUTIONS: dict[str, type[Distribution]] = {
    shape.kind: shape
    for shape in (
        Normal,
        TruncatedNormal,
        Uniform,
        Triangular,
        Parabolic,
        EndPoint,
        Empirical,
    )
}
"""Distributions by the name that a study file gives."""
