"""The engine that a scene needs, and no more: the cheapest whose predicted error is allowed.

Engines say beforehand what they neglect and what they cost. Errors predicted are those of the exit field for
an object that fills its grid evenly and sends light in all directions; they are meant as upper bounds.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lensdesign.errors import InputError, SamplingError
from wavesim.engines.registry import make_engine
from wavesim.engines.surfaces.grids import LARGEST_BYTES, LONGEST_SECONDS
from wavesim.engines.whole_field.engine import LEAST_ERROR, tiles_along
from wavesim.fields.guards import SamplingWarning
from wavesim.scene.engine import Engine, Scene

SLICES = (10, 30, 100, 300, 1000)
TILE_SHARE, LEAST_TILE_ERROR = 0.5, 1e-5
"""Of the error allowed, what eikonal tiles may leave by their width; and the least that may be asked for."""

MANY_TILES = 16
"""Along a side of the object, from which on tiles in two levels are worth their set-up."""

NARROWEST, WORTH = 8, 0.95
"""Narrowest tile tried, in object samples; what a step to narrower tiles must bring to go on."""


@dataclass(frozen=True)
class Prediction:
    """What an engine would do with a scene.

    Attributes
    ----------
    engine : str
        Name.
    settings : dict
        To be given to :func:`wavesim.engines.registry.make_engine`.
    relative_error : float
        Upper bound of the exit field's relative L2 error; infinite where the engine cannot tell.
    seconds, setup_seconds : float
        For one forward or adjoint, and once.
    peak_bytes : int
        Most memory at one time.
    neglected : str
        The worst of what is left out.
    refused : str
        Why the engine does not take the scene; empty if it does, and then the figures mean something.
    """

    engine: str
    settings: dict[str, Any]
    relative_error: float = math.inf
    seconds: float = math.inf
    setup_seconds: float = 0.0
    peak_bytes: int = 0
    neglected: str = ""
    refused: str = ""

    def total_seconds(self, runs: int) -> float:
        """Set-up and a number of runs."""
        return self.setup_seconds + runs * self.seconds

    @property
    def label(self) -> str:
        """Engine and settings in a few words."""
        inside = ", ".join(
            f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.settings.items()
        )
        return f"{self.engine} ({inside})" if inside else self.engine


@dataclass(frozen=True)
class Choice:
    """The engine taken, and all that was weighed.

    Attributes
    ----------
    chosen : Prediction
        Of the engine taken.
    predictions : tuple of Prediction
        Of all, in the order in which they were tried.
    reason : str
        Why, in a sentence or two.
    """

    chosen: Prediction
    predictions: tuple[Prediction, ...]
    reason: str


def predict(scene: Scene, engine: str, **settings: Any) -> Prediction:
    """What an engine says of a scene before it runs.

    Parameters
    ----------
    scene
        What is to be carried where.
    engine, settings
        As for :func:`wavesim.engines.registry.make_engine`.

    Raises
    ------
    InputError
        If there is no such engine or setting.
    """
    built = make_engine(engine, scene, **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        try:
            cost, parts, error = built.cost(), built.neglected(), built.predicted_error()
        except (InputError, SamplingError) as problem:
            return Prediction(engine, settings, refused=str(problem))
    return Prediction(
        engine,
        settings,
        error,
        cost.seconds,
        cost.setup_seconds,
        cost.peak_bytes,
        parts[0].what if parts else "nothing",
    )


def predictions(scene: Scene, error: float) -> Iterator[Prediction]:
    """Predictions of all engines, of each with the first settings that hold, or with all if none does."""
    yield predict(scene, "no-lens")
    yield predict(scene, "thin-lens")
    yield from _eikonal(scene, error)
    if tiles_along(scene) > MANY_TILES:
        tiles = min(max(TILE_SHARE * error, LEAST_ERROR), 1.0)
        yield predict(scene, "two-level", error=tiles)
    for slices in SLICES:
        found = predict(scene, "slices", slices=slices, compensation="oblique")
        yield found
        if found.relative_error <= error or found.refused:
            break
    yield predict(scene, "wpm")


def _eikonal(scene: Scene, error: float) -> Iterator[Prediction]:
    """Wide tiles, then narrower ones for as long as that helps."""
    tiles = max(TILE_SHARE * error, LEAST_TILE_ERROR)
    found = predict(scene, "eikonal", error=tiles)
    yield found
    grid = scene.object_grid
    width = max(n * grid.pitch_mm for n in grid.shape)
    while not found.refused and found.relative_error > error and width > NARROWEST * grid.pitch_mm:
        width, before = 0.5 * width, found.relative_error
        found = predict(scene, "eikonal", error=tiles, tile_width_mm=width)
        yield found
        if found.relative_error > WORTH * before:
            break


def choose(
    scene: Scene,
    error: float = 0.1,
    memory_bytes: float = LARGEST_BYTES,
    seconds: float = LONGEST_SECONDS,
    runs: int = 2,
) -> Choice:
    """Take the cheapest engine that holds.

    Parameters
    ----------
    scene
        What is to be carried where.
    error
        Relative L2 error of the exit field that is allowed; its square is the share of wrong energy.
    memory_bytes, seconds
        Memory that may be used, and time that all runs may take.
    runs
        How often fields will be carried forward or back, over which the set-up is shared.

    Raises
    ------
    InputError
        If a value is not usable.
    SamplingError
        If no engine holds; the message has the figures of each.
    """
    if not 0.0 < error < 2.0:
        raise InputError(f"error = {error!r}: must be above 0 and below 2")
    for name, value in (("memory_bytes", memory_bytes), ("seconds", seconds)):
        if not value > 0.0:
            raise InputError(f"{name} = {value!r}: must be above 0")
    if runs < 1:
        raise InputError(f"runs = {runs}: must be at least 1")
    allowed = Allowed(error, memory_bytes, seconds, runs)
    weighed = tuple(predictions(scene, error))
    holding = [p for p in weighed if allowed.fault(p) is None]
    if not holding:
        listed = "; ".join(f"{p.label}: {allowed.fault(p)}" for p in weighed)
        raise SamplingError(f"no engine carries this scene to a relative error of {error:g}. {listed}")
    best = min(holding, key=lambda p: p.total_seconds(runs))
    return Choice(best, weighed, _reason(best, weighed, allowed))


def chosen_engine(scene: Scene, **allowed: Any) -> Engine:
    """The engine that :func:`choose` takes with the same arguments, made."""
    chosen = choose(scene, **allowed).chosen
    return make_engine(chosen.engine, scene, **chosen.settings)


@dataclass(frozen=True)
class Allowed:
    """What a choice must keep to; as the arguments of :func:`choose`."""

    error: float
    memory_bytes: float
    seconds: float
    runs: int

    def fault(self, prediction: Prediction) -> str | None:
        """Why an engine does not do, in a few words."""
        if prediction.refused:
            return f"refused ({prediction.refused})"
        if prediction.relative_error > self.error:
            size = prediction.relative_error
            told = f"errs by {size:.2g}" if math.isfinite(size) else "cannot tell its error"
            return f"{told} ({prediction.neglected})"
        if prediction.peak_bytes > self.memory_bytes:
            return f"needs {prediction.peak_bytes / 1e9:.3g} GB of {self.memory_bytes / 1e9:.3g} GB allowed"
        seconds = prediction.total_seconds(self.runs)
        if seconds > self.seconds:
            return f"takes {seconds:.3g} s of {self.seconds:.3g} s allowed"
        return None


def _reason(best: Prediction, weighed: tuple[Prediction, ...], allowed: Allowed) -> str:
    seconds = best.total_seconds(allowed.runs)
    lines = [
        f"{best.label} errs by at most {best.relative_error:.2g} of {allowed.error:.2g} allowed, and takes "
        f"{seconds:.2g} s and {best.peak_bytes / 1e6:.3g} MB for {allowed.runs} run(s)."
    ]
    for p in sorted(weighed, key=lambda p: p.total_seconds(allowed.runs)):
        if p is best:
            continue
        fault = allowed.fault(p)
        lines.append(
            f"{p.label} {fault or f'does as well, but takes {p.total_seconds(allowed.runs):.2g} s'}."
        )
    return " ".join(lines)
