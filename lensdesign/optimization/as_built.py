"""What a search asks of tolerances: how a lens will be as built.

Tolerance studies are read by a package above this one, which gives its reader as an entry point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.optimization.specification.sections import Tolerances

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens

READERS = "lensdesign.as_built"
"""Entry points that read a tolerance study."""


@dataclass(frozen=True)
class AsBuiltValues:
    """Predictions of a lens for a search; p object points, v variables.

    Attributes
    ----------
    rms_waves, rms_by : ndarray, shapes (p,) and (p, v)
        Root of the mean square of the wavefront error over pupil and lenses, and its derivatives.
    failing, failing_by : float, and ndarray of shape (v,)
        Fraction of lenses that miss at least one limit of the study, of those limits that can be predicted;
        smoothed where derivatives are asked for.
    """

    rms_waves: Array
    rms_by: Array
    failing: float
    failing_by: Array


@dataclass(frozen=True)
class LossValues:
    """Mean reconstruction losses of a lens as built; m merits `reconstruction_loss`, v variables.

    Attributes
    ----------
    losses, losses_by : ndarray, shapes (m,) and (m, v)
        Mean over lenses of each merit, and its derivatives.
    scale
        Largest mean of the study's own lens.
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
        The merit's name.
    conditions
        Its object points and other settings in words.
    calibrated
        Whether the reconstruction's model adapts the compensators of the study.
    mean, error
        Over trials, and its standard error.
    predicted
        The same without trials.
    """

    merit: str
    conditions: str
    calibrated: bool
    mean: float
    error: float
    predicted: float


@dataclass(frozen=True)
class MeritYield:
    """Fraction of lenses that keep the limit of one merit, whatever they do to the others.

    Attributes
    ----------
    merit
        The merit's name.
    limit
        Its limit in words.
    conditions
        Its object points and other settings in words.
    good, low, high
        Fraction of trials, and its 95 % interval.
    predicted
        The same without trials; None for a merit that trials alone can score.
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
    """What is predicted of a finished lens, by the function that `tolerancing predict` prints.

    Attributes
    ----------
    rms_waves : tuple of float
        At each object point, over pupil and lenses.
    good
        Fraction of lenses that keep all limits that can be predicted; NaN where none can.
    merits : dict
        The same fraction for each of these limits alone, by the merits' names.
    """

    rms_waves: tuple[float, ...]
    good: float
    merits: dict[str, float]


@dataclass(frozen=True)
class TrialsOf:
    """What fresh Monte Carlo trials make of a lens.

    Attributes
    ----------
    name
        Which lens it is.
    trials
        How many.
    rms_waves : tuple of float
        At each object point, over pupil and lenses.
    rms_errors_waves : tuple of float
        Their standard errors.
    predicted_rms_waves : tuple of float
        The same without trials.
    good, low, high
        Yield: the fraction of lenses that keep all limits of the study, and its 95 % interval.
    predicted_good
        Predicted fraction of lenses that keep all limits that can be predicted; None where none can.
    merits : tuple of MeritYield
        Each limit of the study by itself.
    losses : tuple of MeritLoss
        Each merit `reconstruction_loss` of the study, where goal or constraints ask for them.
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
    """Start and result beside each other, by trials that the search did not know.

    Attributes
    ----------
    points_mm : tuple of (x, y)
        Object points of the study's merits of the wavefront.
    wavelengths_um : tuple of float or None
        At which each is judged; None: the lens's first.
    limits_waves : tuple of float
        Largest root mean square of a good lens at each.
    seed
        With which a run of the study draws the same trials.
    trials_only : tuple of str
        Names of the merits that cannot be predicted: the search left them out, trials count them.
    rows : tuple of TrialsOf
        The result stands last, as designed and then at each temperature that is asked for.
    """

    points_mm: tuple[tuple[float, float], ...]
    wavelengths_um: tuple[float | None, ...]
    limits_waves: tuple[float, ...]
    seed: int
    trials_only: tuple[str, ...]
    rows: tuple[TrialsOf, ...]

    @property
    def places(self) -> tuple[str, ...]:
        """Object points in words, with the wavelength where it is not the lens's first."""
        pairs = zip(self.points_mm, self.wavelengths_um, strict=True)
        return tuple(
            f"({x:g}, {y:g}) mm" + ("" if wavelength is None else f", {wavelength:g} um")
            for (x, y), wavelength in pairs
        )


class AsBuilt(Protocol):
    """A tolerance study, as searches use it."""

    @property
    def points_mm(self) -> tuple[tuple[float, float], ...]:
        """Object points that are judged."""

    @property
    def loss_merits(self) -> tuple[str, ...]:
        """Names of the study's merits `reconstruction_loss`."""

    def check(self, lens: Lens) -> None:
        """Refuse, with a DesignError, tolerances of what a lens does not have."""

    def check_yields(self) -> None:
        """Refuse, with a DesignError, a study of which no yield can be predicted."""

    def check_losses(self, lens: Lens) -> None:
        """Refuse, with a DesignError, losses that a search for such a lens cannot know."""

    def evaluate(self, problem: Any, point: Array, derivatives: bool) -> AsBuiltValues:
        """Predict the lens at a point of the unit box of a `DesignProblem`.

        Derivatives are by the variables' own values.
        """

    def predict(self, lens: Lens) -> AsBuiltPrediction:
        """Predict a finished lens without trials, as reports show it."""

    def losses(self, problem: Any, point: Array, derivatives: bool) -> LossValues:
        """Predict mean reconstruction losses of the lens at a point of the unit box."""

    def scaled(self, factor: float) -> AsBuilt:
        """The study with all tolerances multiplied."""

    def priced(self, costs: Path | None, cost: float | None) -> AsBuilt:
        """The study with a table of costs; where a cost is given, tolerances are multiplied to cost it."""

    def cost(self, lens: Lens) -> float:
        """What the tolerances of a lens cost, its elements included.

        Refuse, with an InputError, a table without a price for one of them.
        """

    @property
    def reference(self) -> Lens:
        """The lens that the study was written for."""

    def trials(self, lenses: Sequence[tuple[str, Lens]], count: int, seed: int = 0) -> AsBuiltReport:
        """Try named lenses by so many fresh trials each."""


def read_as_built(tolerances: Tolerances) -> AsBuilt:
    """Read a tolerance study for a search.

    Raises
    ------
    DesignError
        If there is no such file, it is no study, or no package that reads one is installed.
    """
    study = Path(tolerances.study)
    if not study.is_file():
        raise DesignError(f"tolerances: study = {tolerances.study!r}: there is no such file")
    files = [Path(file) for file in (tolerances.study, tolerances.costs) if file is not None]
    changed = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
    return _read(study, changed, tolerances)


@lru_cache(maxsize=4)
def _read(path: Path, _changed: tuple[int, ...], tolerances: Tolerances) -> AsBuilt:
    from importlib.metadata import entry_points

    readers = tuple(entry_points(group=READERS, name="study"))
    if not readers:
        raise DesignError(f"tolerances: no package that reads a study is installed (entry point {READERS})")
    found: AsBuilt = readers[0].load()(path)
    costs = None if tolerances.costs is None else Path(tolerances.costs)
    return found.scaled(tolerances.factor).priced(costs, tolerances.cost)


def untraceable(points: int, variables: int) -> AsBuiltValues:
    """Values of a lens that has no wavefronts."""
    nowhere = np.full(points, np.inf)
    return AsBuiltValues(nowhere, np.zeros((points, variables)), np.inf, np.zeros(variables))


def without_losses(merits: int, variables: int) -> LossValues:
    """Values of a lens that has no reconstruction."""
    return LossValues(np.full(merits, np.inf), np.zeros((merits, variables)), 1.0)
