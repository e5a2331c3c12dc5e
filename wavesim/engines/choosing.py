"""Choice of an engine: the cheapest one whose predicted error is allowed.

Every engine predicts its error and its cost before it runs. Predicted errors are upper bounds of the exit
field's relative L2 error, for the light of one object, or for light that fills the object grid evenly in all
directions.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

from lensdesign.common.given import FilePath, object_of
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError, SamplingError, validate_whole_number
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from wavesim.engines.registry import AUTO, ENGINES, engine_class, settings_of
from wavesim.engines.surfaces.grids import LARGEST_BYTES, LONGEST_SECONDS
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.rays.scalar_light import scalar_light_term
from wavesim.scene.engine import Engine, ErrorTerm, upper_bound
from wavesim.scene.patches import patch_scene
from wavesim.scene.polarization import AUTO as AUTO_POLARIZATION
from wavesim.scene.polarization import UNPOLARIZED, is_vector, polarization_text
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene
from wavesim.scene.settings import DEFAULT_ERROR


@dataclass(frozen=True)
class Prediction:
    """Predicted error and cost of an engine for a scene.

    Attributes
    ----------
    engine : str
        Name of the engine.
    settings : dict
        Its settings, as arguments of :func:`engine_for`.
    relative_error : float
        Upper bound of the exit field's relative L2 error; infinite where the engine cannot predict it.
    seconds, setup_seconds : float
        Time of one forward or adjoint, and of the set-up.
    peak_bytes : int
        Peak memory.
    neglected : str
        The neglected effect with the largest error.
    polarization : str or float
        Polarization of the scene; ``auto`` and ``scalar`` are scalar waves.
    refused : str
        Reason why the engine cannot propagate the scene. If it is not empty, the other values have no
        meaning.
    """

    engine: str
    settings: dict[str, Any]
    relative_error: float = math.inf
    seconds: float = math.inf
    setup_seconds: float = 0.0
    peak_bytes: int = 0
    neglected: str = ""
    refused: str = ""
    polarization: str | float = AUTO_POLARIZATION

    def total_seconds(self, runs: int) -> float:
        """Return the time of the set-up and a number of runs."""
        return self.setup_seconds + runs * self.seconds

    @property
    def label(self) -> str:
        """Engine and settings in a few words."""
        inside = ", ".join(
            f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in self.settings.items()
        )
        light = f" with {polarization_text(self.polarization)}" if is_vector(self.polarization) else ""
        return f"{self.engine} ({inside}){light}" if inside else f"{self.engine}{light}"


@dataclass(frozen=True)
class Choice:
    """The chosen engine, and all predictions.

    Attributes
    ----------
    chosen : Prediction
        Prediction of the chosen engine.
    predictions : tuple of Prediction
        Predictions of all engines, in the order in which they were tried.
    reason : str
        Reason for the choice, in a few sentences.
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
    """Return an engine for a scene: the named one, or the cheapest one that meets the error limit.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    name
        One of :data:`wavesim.engines.registry.ENGINES`, or "auto" for the one that :func:`choose` selects.
    error
        Allowed relative L2 error of the exit field; for a named engine, its setting of this name. Default:
        0.05 for the choice, the engine's own value for a named engine.
    memory_gb, runs, light
        As in :func:`choose`; without effect for a named engine.
    **settings
        Settings of the named engine. Default: the engine's own choice.

    Returns
    -------
    Engine
        The engine. Its set-up follows when it is first used.

    Raises
    ------
    InputError
        If there is no such engine or setting, or the engine does not allow the setting's value.
    SamplingError
        If no engine meets the limits; the message contains the predictions of all engines.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> from wavesim import engine_for, patch_scene
    >>> scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.01, meridional=True)
    >>> engine_for(scene, "wpm").name
    'wpm'
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
    """Predict error and cost of an engine for a scene, without a run.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    engine, settings
        Name and settings, as in :func:`engine_for`.
    light
        Light behind the object. Default: light that fills the object grid evenly, in all directions.

    Raises
    ------
    InputError
        If there is no such engine or setting, or the light has another grid or wavelength than the scene.
    """
    return _predicted(engine_for(scene, engine, **settings), settings, light, partial(_scalar_light, scene))


def _predicted(
    built: Engine, settings: dict[str, Any], light: Light | None, scalar: Callable[[], ErrorTerm | None]
) -> Prediction:
    if light is not None:
        light.validate_same_scene(built.scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        try:
            cost, terms = built.cost(), _with_scalar_light(built, light, scalar())
        except (InputError, SamplingError) as problem:
            return Prediction(
                built.name, settings, refused=str(problem), polarization=built.scene.polarization
            )
    return Prediction(
        built.name,
        settings,
        upper_bound(terms),
        cost.seconds,
        cost.setup_seconds,
        cost.peak_bytes,
        terms[0].description if terms else "nothing",
        polarization=built.scene.polarization,
    )


def _with_scalar_light(built: Engine, light: Light | None, scalar: ErrorTerm | None) -> tuple[ErrorTerm, ...]:
    """Return the error terms of an engine, with that of scalar light where there is one."""
    terms = built.error_terms_of(light)
    if scalar is None:
        return terms
    return tuple(sorted((*terms, scalar), key=lambda term: -term.relative_error))


def predicted_error_of(engine: Engine, light: Light | None = None) -> float:
    """Return an upper bound of an engine's relative error, with that of scalar light.

    It is the error by which :func:`choose` compares engines. :meth:`Engine.predicted_error` is without the
    error of scalar light.

    Parameters
    ----------
    engine
        Any engine.
    light
        Light behind the object; see :func:`choose`.
    """
    return upper_bound(_with_scalar_light(engine, light, _scalar_light(engine.scene)))


def _scalar_light(scene: Scene) -> ErrorTerm | None:
    """Return the error of scalar waves, if the scene leaves the polarization open and rays pass the lens."""
    return scalar_light_term(scene) if scene.polarization == AUTO_POLARIZATION else None


def predictions(
    scene: Scene, error: float, light: Light | None = None, built: dict[int, Engine] | None = None
) -> Iterator[Prediction]:
    """Yield the predictions of all engines, for each its candidates up to the first that meets the limit.

    Candidates of an engine also end where a further one no longer reduces the error enough. `built` receives
    the engines that meet the limit, by the identity of their predictions, so that their ray traces are
    reused.
    """
    needs_components = is_vector(scene.polarization)
    scalar = cache(partial(_scalar_light, scene))  # the same for all engines
    for engine in (one for name in ENGINES for one in engine_class(name).implementations()):
        if needs_components and not engine.carries_polarization:
            continue
        previous = math.inf
        for settings in engine.candidates(scene, error):
            candidate = engine(scene, **settings)
            found = _predicted(candidate, settings, light, scalar)
            yield found
            if built is not None and found.relative_error <= error:
                built[id(found)] = candidate
            if (
                found.refused
                or found.relative_error <= error
                or found.relative_error > engine.gain * previous
            ):
                break
            previous = found.relative_error


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
        Limits and light, as in :func:`choose`.
    """
    limits = _Limits(math.inf, 1e9 * memory_gb, seconds, runs)
    considered = (one for error in errors for one in predictions(scene, error, light))
    known = (p for p in considered if math.isfinite(p.relative_error) and limits.fault(p) is None)
    return sorted(known, key=lambda p: (p.relative_error, p.total_seconds(runs)))


def choose(
    scene: Scene | Lens | FilePath,
    error: float = DEFAULT_ERROR,
    memory_gb: float = 1e-9 * LARGEST_BYTES,
    seconds: float = LONGEST_SECONDS,
    runs: int = 2,
    light: Light | None = None,
) -> Choice:
    """Select the cheapest engine that meets the limits of error, memory and time.

    Engines propagate scalar waves, whose error for unpolarized light is one of the predicted terms. If that
    error alone is too large, only engines that carry the components of the field compete, unless the scene
    asks for ``scalar`` waves.

    Parameters
    ----------
    scene
        Lens, grids and wavelength. For a lens, or the path of a design file, it is the scene of a patch of
        0.1 mm on the axis, or of the whole field if that is smaller.
    error
        Allowed relative L2 error of the exit field; its square is the fraction of wrong energy.
    memory_gb
        Allowed peak memory in 1e9 bytes.
    seconds
        Allowed time of the set-up and all runs.
    runs
        Number of propagations, forward or adjoint, that share the set-up.
    light
        Light behind the object. Default: light that fills the object grid evenly, in all directions.

    Returns
    -------
    Choice
        The selected engine, the predictions of all engines, and the reason.

    Raises
    ------
    InputError
        If a value is not usable, or the light has another grid or wavelength than the scene.
    SamplingError
        If no engine meets the limits; the message contains the predictions of all engines.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> from wavesim import choose, patch_scene
    >>> scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.01, meridional=True)
    >>> choose(scene, error=0.1).chosen.engine
    'eikonal'
    """
    if not isinstance(scene, Scene):
        lens = object_of(scene, Lens, load_design, "scene")
        scene = patch_scene(lens, min(0.1, lens.object.field_diameter_mm))
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
    validate_whole_number("runs", runs, 1)
    limits = _Limits(error, 1e9 * memory_gb, seconds, runs)
    scalar, reason = _scalar_light(scene), ""
    if scalar is not None and upper_bound([scalar]) > error:
        scene = replace(scene, polarization=UNPOLARIZED)
        reason = (
            f"Scalar waves have a predicted error of {upper_bound([scalar]):.2g} for unpolarized light, so "
            "that the components of the field are propagated. "
        )
    considered = tuple(predictions(scene, error, light, built))
    acceptable = [p for p in considered if limits.fault(p) is None]
    if not acceptable:
        listed = "; ".join(f"{p.label}: {limits.fault(p)}" for p in considered)
        raise SamplingError(
            f"no engine reaches a relative error of {error:g} for this scene within the limits. "
            f"{reason}{listed}"
        )
    best = min(acceptable, key=lambda p: p.total_seconds(runs))
    return Choice(best, considered, reason + _reason(best, considered, limits))


@dataclass(frozen=True)
class _Limits:
    """Limits of error, memory and time of a choice."""

    error: float
    memory_bytes: float
    seconds: float
    runs: int

    def fault(self, prediction: Prediction) -> str | None:
        """Return why a prediction violates the limits, in a few words; None if it meets them."""
        if prediction.refused:
            return f"refused ({prediction.refused})"
        if prediction.relative_error > self.error:
            size = prediction.relative_error
            text = f"predicted relative error {size:.2g}" if math.isfinite(size) else "unknown relative error"
            return f"{text} ({prediction.neglected})"
        if prediction.peak_bytes > self.memory_bytes:
            return f"needs {prediction.peak_bytes / 1e9:.3g} GB (allowed: {self.memory_bytes / 1e9:.3g} GB)"
        seconds = prediction.total_seconds(self.runs)
        if seconds > self.seconds:
            return f"takes {seconds:.3g} s (allowed: {self.seconds:.3g} s)"
        return None


def _reason(best: Prediction, considered: tuple[Prediction, ...], limits: _Limits) -> str:
    seconds = best.total_seconds(limits.runs)
    lines = [
        f"{best.label}: predicted relative error {best.relative_error:.2g} (allowed: {limits.error:.2g}), "
        f"{seconds:.2g} s and {best.peak_bytes / 1e6:.3g} MB for {limits.runs} run(s)."
    ]
    for p in sorted(considered, key=lambda p: p.total_seconds(limits.runs)):
        if p is best:
            continue
        slower = f"meets the limits as well, but takes {p.total_seconds(limits.runs):.2g} s"
        lines.append(f"{p.label}: {limits.fault(p) or slower}.")
    return " ".join(lines)
