"""The engine that a scene needs, and no more: the cheapest whose predicted error is allowed.

Engines say beforehand what they neglect and what they cost. Errors predicted are those of the exit field for
the light of one object, or for one that fills its grid evenly and sends light in all directions; they are
meant as upper bounds.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError, SamplingError, refuse_not_whole
from wavesim.engines.registry import AUTO, ENGINES, engine_class, settings_of
from wavesim.engines.surfaces.grids import LARGEST_BYTES, LONGEST_SECONDS
from wavesim.fields.guards import SamplingWarning
from wavesim.scene.engine import Engine, upper_bound
from wavesim.scene.light import Light
from wavesim.scene.scene import Scene
from wavesim.scene.settings import DEFAULT_ERROR


@dataclass(frozen=True)
class Prediction:
    """What an engine would do with a scene.

    Attributes
    ----------
    engine : str
        Name.
    settings : dict
        To be given to :func:`engine_for`.
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


def engine_for(
    scene: Scene,
    name: str = AUTO,
    *,
    error: float | None = None,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
    runs: int = 2,
    light: Light | None = None,
    **settings: Any,
) -> Engine:
    """An engine for a scene: the one named, or the cheapest that holds.

    Parameters
    ----------
    scene
        What is to be carried where.
    name
        One of :data:`wavesim.engines.registry.ENGINES`, or "auto": the one that :func:`choose` takes.
    error
        Relative L2 error of the exit field that is allowed; of an engine named, its setting of this name.
        Left out, 0.05 for the choice, and what the engine named has.
    memory_gb, runs, light
        As of :func:`choose`; they say nothing to an engine named.
    **settings
        Of the engine named; what is left out stays at the engine's own choice.

    Raises
    ------
    InputError
        If there is no such engine, or it does not know a setting or refuses its value.
    SamplingError
        If no engine holds; the message has the figures of each.
    """
    if error is not None:
        settings["error"] = error
    allowed = ("error", "memory_gb", "runs") if name == AUTO else settings_of(name)
    for setting in settings:
        if setting not in allowed:
            listed = f"allowed: {', '.join(allowed)}" if allowed else "it has none"
            raise InputError(
                f"engine {name}: {setting} = {settings[setting]!r}: there is no such setting; {listed}"
                f"{did_you_mean(setting, allowed)}"
            )
    if name != AUTO:
        return engine_class(name)(scene, **settings)
    built: dict[int, Engine] = {}
    most = DEFAULT_ERROR if error is None else error
    chosen = _chosen(scene, most, memory_gb, LONGEST_SECONDS, runs, light, built).chosen
    return built[id(chosen)]


def predict(scene: Scene, engine: str, light: Light | None = None, **settings: Any) -> Prediction:
    """What an engine says of a scene before it runs.

    Parameters
    ----------
    scene
        What is to be carried where.
    engine, settings
        As for :func:`engine_for`.
    light
        As of :func:`choose`.

    Raises
    ------
    InputError
        If there is no such engine or setting, or the light is not that of the scene.
    """
    return _predicted(engine_for(scene, engine, **settings), settings, light)


def _predicted(built: Engine, settings: dict[str, Any], light: Light | None) -> Prediction:
    if light is not None:
        light.refuse_beside(built.scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        try:
            cost, parts = built.cost(), built.neglected_of(light)
        except (InputError, SamplingError) as problem:
            return Prediction(built.name, settings, refused=str(problem))
    return Prediction(
        built.name,
        settings,
        upper_bound(parts),
        cost.seconds,
        cost.setup_seconds,
        cost.peak_bytes,
        parts[0].what if parts else "nothing",
    )


def predictions(
    scene: Scene, error: float, light: Light | None = None, built: dict[int, Engine] | None = None
) -> Iterator[Prediction]:
    """Predictions of all engines, each with its candidates up to the first that holds or brings no gain.

    `built` takes the engines that hold, by the identity of their predictions: what they have found out about
    the scene need not be found out again.
    """
    for name in ENGINES:
        engine, before = engine_class(name), math.inf
        for settings in engine.candidates(scene, error):
            one = engine(scene, **settings)
            found = _predicted(one, settings, light)
            yield found
            if built is not None and found.relative_error <= error:
                built[id(found)] = one
            if found.refused or found.relative_error <= error or found.relative_error > engine.gain * before:
                break
            before = found.relative_error


def affordable_engines(
    scene: Scene,
    errors: Sequence[float],
    *,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
    seconds: float = LONGEST_SECONDS,
    runs: int = 2,
    light: Light | None = None,
) -> list[Prediction]:
    """Return the predictions of all engines that memory and time allow, the most accurate first.

    Parameters
    ----------
    scene
        Lens, object grid and exit grid.
    errors
        Relative errors for which engines propose settings. The predicted errors need not be below them.
    memory_gb, seconds, runs, light
        As of :func:`choose`.
    """
    allowed = Allowed(math.inf, 1e9 * memory_gb, seconds, runs)
    weighed = (one for error in errors for one in predictions(scene, error, light))
    known = (one for one in weighed if math.isfinite(one.relative_error) and allowed.fault(one) is None)
    return sorted(known, key=lambda one: (one.relative_error, one.total_seconds(runs)))


def choose(
    scene: Scene,
    error: float = DEFAULT_ERROR,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
    seconds: float = LONGEST_SECONDS,
    runs: int = 2,
    light: Light | None = None,
) -> Choice:
    """Take the cheapest engine that holds.

    Parameters
    ----------
    scene
        What is to be carried where.
    error
        Relative L2 error of the exit field that is allowed; its square is the share of wrong energy.
    memory_gb, seconds
        Memory that may be used, and time that all runs may take.
    runs
        How often fields will be carried forward or back, over which the set-up is shared.
    light
        Behind the object; left out, it fills its grid evenly and goes in all directions.

    Raises
    ------
    InputError
        If a value is not usable, or the light is not that of the scene.
    SamplingError
        If no engine holds; the message has the figures of each.
    """
    return _chosen(scene, error, memory_gb, seconds, runs, light, None)


def _chosen(
    scene: Scene,
    error: float,
    memory_gb: float,
    seconds: float,
    runs: int,
    light: Light | None,
    built: dict[int, Engine] | None,
) -> Choice:
    if not 0.0 < error < 2.0:
        raise InputError(f"error = {error!r}: must be above 0 and below 2")
    for name, value in (("memory_gb", memory_gb), ("seconds", seconds)):
        if not value > 0.0:
            raise InputError(f"{name} = {value!r}: must be above 0")
    refuse_not_whole("runs", runs, 1)
    allowed = Allowed(error, 1e9 * memory_gb, seconds, runs)
    weighed = tuple(predictions(scene, error, light, built))
    holding = [p for p in weighed if allowed.fault(p) is None]
    if not holding:
        listed = "; ".join(f"{p.label}: {allowed.fault(p)}" for p in weighed)
        raise SamplingError(f"no engine carries this scene to a relative error of {error:g}. {listed}")
    best = min(holding, key=lambda p: p.total_seconds(runs))
    return Choice(best, weighed, _reason(best, weighed, allowed))


@dataclass(frozen=True)
class Allowed:
    """What a choice must keep to."""

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
