"""Interface to tolerance studies: predictions of lenses as built for an optimization.

Tolerance studies are read by a package above this one, which registers its reader as an entry point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.consent import is_user_code_trusted
from lensdesign.errors import DesignError
from lensdesign.optimization.specification.sections import Tolerances

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class AsBuiltValues:
    """Predictions of a lens as built for a search: p object points, v variables.

    Attributes
    ----------
    rms_waves, rms_by : ndarray, shapes (p,) and (p, v)
        Root mean square of the wavefront error over pupil and lenses, and its derivatives.
    failing, failing_by : float, and ndarray of shape (v,)
        Fraction of lenses that violate at least one predictable limit of the study, and its derivatives; the
        fraction is smoothed if derivatives are requested.
    """

    rms_waves: Array
    rms_by: Array
    failing: float
    failing_by: Array


@dataclass(frozen=True)
class LossValues:
    """Mean reconstruction losses of a lens as built: m merits `reconstruction_loss`, v variables.

    Attributes
    ----------
    losses, losses_by : ndarray, shapes (m,) and (m, v)
        Mean of each merit over lenses, and its derivatives.
    scale
        Largest mean for the lens of the study.
    """

    losses: Array
    losses_by: Array
    scale: float


@dataclass(frozen=True)
class MeritLoss:
    """Mean of a merit `reconstruction_loss` over lenses as built.

    Attributes
    ----------
    merit
        Name of the merit.
    conditions
        Its object points and other settings as text.
    calibrated
        Whether the model of the reconstruction adapts the compensators of the study.
    mean, error
        Mean over trials, and its standard error.
    predicted
        Predicted mean without trials.
    """

    merit: str
    conditions: str
    calibrated: bool
    mean: float
    error: float
    predicted: float


@dataclass(frozen=True)
class MeritYield:
    """Fraction of lenses that keep the limit of one merit, regardless of the other merits.

    Attributes
    ----------
    merit
        Name of the merit.
    limit
        Its limit as text.
    conditions
        Its object points and other settings as text.
    good, low, high
        Fraction of trials, and its 95 % interval.
    predicted
        Predicted fraction without trials; None for a merit that cannot be predicted.
    """

    merit: str
    limit: str
    conditions: str
    good: float
    low: float
    high: float
    predicted: float | None


@dataclass(frozen=True)
class AsBuiltPrediction:
    """Prediction of a finished lens as built, as `tolerancing predict` prints it.

    Attributes
    ----------
    rms_waves : tuple of float
        Root mean square wavefront error over pupil and lenses, at each object point.
    good
        Yield: fraction of lenses that keep all limits of the study; NaN if it is not predicted.
    merits : dict
        Fraction of lenses that keep each predicted limit alone, by the name of the merit.
    within_searched
        Fraction of lenses that keep the limits that a search knows; NaN if there are none.
    """

    rms_waves: tuple[float, ...]
    good: float
    merits: dict[str, float]
    within_searched: float


@dataclass(frozen=True)
class TrialsOf:
    """Result of independent Monte Carlo trials of a lens.

    Attributes
    ----------
    name
        Name of the lens in reports.
    trials
        Number of trials.
    rms_waves : tuple of float
        Root mean square wavefront error over pupil and lenses, at each object point.
    rms_errors_waves : tuple of float
        Standard errors of `rms_waves`.
    predicted_rms_waves : tuple of float
        Predicted root mean squares without trials.
    good, low, high
        Yield: the fraction of lenses that keep all limits of the study, and its 95 % interval.
    predicted_good
        Predicted yield; None if it is not predicted.
    merits : tuple of MeritYield
        Yield of each limit of the study alone.
    losses : tuple of MeritLoss
        Means of the merits `reconstruction_loss`, if goal or constraints concern them.
    """

    name: str
    trials: int
    rms_waves: tuple[float, ...]
    rms_errors_waves: tuple[float, ...]
    predicted_rms_waves: tuple[float, ...]
    good: float
    low: float
    high: float
    predicted_good: float | None
    merits: tuple[MeritYield, ...]
    losses: tuple[MeritLoss, ...] = ()


@dataclass(frozen=True)
class AsBuiltReport:
    """Comparison of start and result by Monte Carlo trials that the search did not use.

    Attributes
    ----------
    points_mm : tuple of (x, y)
        Object points of the wavefront merits of the study.
    wavelengths_um : tuple of float or None
        Wavelength at each object point; None means the first of the lens.
    limits_waves : tuple of float
        Largest root mean square of a good lens at each object point.
    seed
        Seed with which a run of the study draws the same trials.
    trials_only : tuple of str
        Names of the merits that a search does not know. The trials include them.
    rows : tuple of TrialsOf
        Trials of each lens. The last rows are the result as designed, then at each temperature.
    """

    points_mm: tuple[tuple[float, float], ...]
    wavelengths_um: tuple[float | None, ...]
    limits_waves: tuple[float, ...]
    seed: int
    trials_only: tuple[str, ...]
    rows: tuple[TrialsOf, ...]

    @property
    def places(self) -> tuple[str, ...]:
        """Object points as text, with the wavelength if it is not the first of the lens."""
        pairs = zip(self.points_mm, self.wavelengths_um, strict=True)
        return tuple(
            f"({x:g}, {y:g}) mm" + ("" if wavelength is None else f", {wavelength:g} µm")
            for (x, y), wavelength in pairs
        )


class AsBuilt(Protocol):
    """Interface of a tolerance study for searches."""

    @property
    def points_mm(self) -> tuple[tuple[float, float], ...]:
        """Object points of the wavefront merits."""

    @property
    def loss_merits(self) -> tuple[str, ...]:
        """Names of the study's merits `reconstruction_loss`."""

    def check(self, lens: Lens) -> None:
        """Raise a DesignError if the tolerances do not apply to a lens."""

    def check_trials(self) -> None:
        """Raise an InputError if a merit cannot be scored, such as Python code that is not trusted."""

    def check_yields(self) -> None:
        """Raise a DesignError if no yield of the study can be predicted."""

    def check_whole_yields(self) -> None:
        """Raise a DesignError if the study has a limit without a prediction."""

    def check_losses(self, lens: Lens) -> None:
        """Raise a DesignError if the reconstruction losses of a lens cannot be predicted."""

    def evaluate(self, problem: Any, point: Array, derivatives: bool) -> AsBuiltValues:
        """Predict the lens at a point of the unit box of a `DesignProblem`.

        Derivatives are with respect to the values of the variables, not of the unit box.
        """

    def predict(self, lens: Lens) -> AsBuiltPrediction:
        """Predict a finished lens without trials."""

    def losses(self, problem: Any, point: Array, derivatives: bool) -> LossValues:
        """Predict mean reconstruction losses of the lens at a point of the unit box."""

    def scaled(self, factor: float) -> AsBuilt:
        """Return the study with all tolerances multiplied."""

    def write_scaled(self, factor: float, twin: Lens, design: Path) -> Path:
        """Write the study of the scaled lens beside its design file, and return its path."""

    def priced(self, costs: Path | None, cost: float | None) -> AsBuilt:
        """Return the study with a table of costs; its tolerances are multiplied to reach a given cost."""

    def cost(self, lens: Lens) -> float:
        """Return the cost of a lens and its tolerances; raise an InputError if a price is missing."""

    @property
    def reference(self) -> Lens:
        """The lens of the study."""

    def trials(self, lenses: Sequence[tuple[str, Lens]], count: int, seed: int = 0) -> AsBuiltReport:
        """Run a number of independent trials of each named lens."""


def read_as_built(tolerances: Tolerances) -> AsBuilt:
    """Read a tolerance study for a search.

    Raises
    ------
    DesignError
        If the file does not exist or is not a study, or no package that reads studies is installed.
    """
    study = Path(tolerances.study)
    if not study.is_file():
        raise DesignError(f"tolerances: study = {tolerances.study!r}: there is no such file")
    files = [Path(file) for file in (tolerances.study, tolerances.costs) if file is not None]
    changed = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
    return _read(study, changed, tolerances, is_user_code_trusted())


def as_built_by(name: str, lens: Lens) -> AsBuilt:
    """Return the study of a grade for a lens, or that of a study file.

    Parameters
    ----------
    name
        A grade of tolerances, such as ``precision``, or the path of a tolerance study.
    lens
        The lens, to which a grade is applied.

    Raises
    ------
    DesignError
        If it is neither, or no package that reads studies is installed.
    """
    found: AsBuilt = _reader()(Path(name), lens)
    return found


def check_trials_by(name: str) -> None:
    """Check that the merits of a study file can be scored; grades of tolerances always can.

    Raises
    ------
    InputError
        If the Python code of a merit is not trusted, or fails.
    """
    if Path(name).is_file():
        read_as_built(Tolerances(study=name)).check_trials()


def _reader() -> Any:
    """Return the function that reads a study."""
    from importlib.metadata import entry_points

    group = "lensdesign.as_built"
    readers = tuple(entry_points(group=group, name="study"))
    if not readers:
        raise DesignError(f"tolerances: no package that reads a study is installed (entry point {group})")
    return readers[0].load()


@lru_cache(maxsize=4)
def _read(path: Path, _changed: tuple[int, ...], tolerances: Tolerances, _is_trusted: bool) -> AsBuilt:
    found: AsBuilt = _reader()(path)
    costs = None if tolerances.costs is None else Path(tolerances.costs)
    return found.scaled(tolerances.factor).priced(costs, tolerances.cost)


def untraceable(points: int, variables: int) -> AsBuiltValues:
    """Return the values of a lens without wavefronts."""
    infinite = np.full(points, np.inf)
    return AsBuiltValues(infinite, np.zeros((points, variables)), np.inf, np.zeros(variables))


def without_losses(merits: int, variables: int) -> LossValues:
    """Return the values of a lens without a reconstruction."""
    return LossValues(np.full(merits, np.inf), np.zeros((merits, variables)), 1.0)
