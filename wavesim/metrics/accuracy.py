"""Error of engines relative to exact solutions, with the time and memory that they need."""

from __future__ import annotations

import time
import tracemalloc
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from wavesim.analytic.registry import AnalyticCase, analytic_case
from wavesim.engines.choosing import engine_for
from wavesim.engines.registry import engine_class
from wavesim.fields.field import Field, relative_error
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scattered_light import Light

TIMED_RUNS, SLOW_SECONDS = 3, 1.0
"""Number of runs after the set-up, of which the fastest counts. A run longer than `SLOW_SECONDS` is not
repeated, and its memory is measured during the same run.
"""


@dataclass(frozen=True)
class AnalyticResult:
    """Error of an engine relative to an exact solution, and its cost.

    Attributes
    ----------
    engine, solution : str
        Names of the engine and of the exact solution.
    radius_mm : float or None
        Radius of the first surface in mm; None for a plane.
    relative_error : float
        L2 norm of the difference over that of the exact field; nothing is fitted.
    uncertainty : float
        Relative error of the exact field.
    seconds, setup_seconds : float
        Time of one `forward` after the set-up, and of the set-up.
    peak_mb : float
        Peak memory of the engine in 1e6 bytes, set-up and result included.
    predicted : Cost
        Time and memory that the engine predicted.
    predicted_error : float
        Upper bound of the error that the engine predicted; infinite where it cannot predict one.
    settings : dict
        Settings that the engine used.
    warnings : tuple of str
        Warnings of the engine.
    """

    engine: str
    solution: str
    radius_mm: float | None
    relative_error: float
    uncertainty: float
    seconds: float
    setup_seconds: float
    peak_mb: float
    predicted: Cost
    predicted_error: float
    settings: dict[str, Any]
    warnings: tuple[str, ...]


def run_analytic_case(
    engine: str,
    solution: str = "cylinder",
    radius_mm: float | None = None,
    solution_arguments: Mapping[str, Any] | None = None,
    **settings: Any,
) -> AnalyticResult:
    """Compare an engine with an exact solution.

    Parameters
    ----------
    engine
        One of :data:`wavesim.engines.registry.ENGINES`.
    solution
        One of :data:`wavesim.analytic.registry.ANALYTIC_CASES`.
    radius_mm
        Radius of the cylinder or the sphere in mm. Default: the exact solution's own.
    solution_arguments
        Further arguments of the exact solution.
    **settings
        Settings of the engine.

    Returns
    -------
    AnalyticResult
        Error and cost.

    Raises
    ------
    InputError, SamplingError
        If a name or a value is invalid, or the engine refuses the scene.
    """
    arguments = dict(solution_arguments or {})
    if radius_mm is not None:
        arguments["radius_mm"] = radius_mm
    return compare_with_exact(analytic_case(solution, **arguments), engine, settings, solution)


def compare_with_exact(
    case: AnalyticCase, engine: str, settings: Mapping[str, Any], solution: str = ""
) -> AnalyticResult:
    """Compare an engine with the exact solution of a scene.

    Parameters
    ----------
    case
        The scene, its object field and its exact exit field.
    engine, settings
        As in :func:`wavesim.engines.choosing.engine_for`.
    solution
        Name of the exact solution, for the result.

    Raises
    ------
    InputError, SamplingError
        If a name or a value is invalid, or the engine refuses the scene.
    """
    engine_class(engine)  # its imports are not the engine's work
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        fresh = engine_for(case.scene, engine, **settings)
        predicted, predicted_error = fresh.cost(), fresh.predicted_error(Light(case.object_field))
        slow = predicted.seconds > SLOW_SECONDS
        with _traced(slow) as traced:
            built, seconds, setup_seconds, field = _timed(engine, case, settings)
        peak = traced[0] if slow else peak_bytes(engine, case, settings)
    return AnalyticResult(
        engine=engine,
        solution=solution,
        radius_mm=case.scene.lens.surfaces[0].radius_mm,
        relative_error=relative_error(field.values, case.exact.values),
        uncertainty=case.uncertainty,
        seconds=seconds,
        setup_seconds=setup_seconds,
        peak_mb=1e-6 * peak,
        predicted=predicted,
        predicted_error=predicted_error,
        settings={name: _plain(value) for name, value in built.settings().items()},
        warnings=tuple(dict.fromkeys(str(warning.message) for warning in caught)),
    )


def _plain(value: Any) -> Any:
    """Return a number of NumPy as a number of Python."""
    return value.item() if isinstance(value, np.generic) else value


def _timed(
    engine: str, case: AnalyticCase, settings: Mapping[str, Any]
) -> tuple[Engine, float, float, Field]:
    """Return the engine, seconds of a run, additional seconds of the first run, and the exit field."""
    started = time.perf_counter()
    built = engine_for(case.scene, engine, **settings)
    field = built.forward(case.object_field)
    first = time.perf_counter() - started
    best = _seconds(built, case.object_field)
    for _ in range(TIMED_RUNS - 1 if best < SLOW_SECONDS else 0):
        best = min(best, _seconds(built, case.object_field))
    return built, best, max(first - best, 0.0), field


def _seconds(engine: Engine, field: Field) -> float:
    started = time.perf_counter()
    engine.forward(field)
    return time.perf_counter() - started


def peak_bytes(engine: str, case: AnalyticCase, settings: Mapping[str, Any]) -> int:
    """Return the peak memory, in bytes, of a fresh engine and its run, as NumPy and Python report it."""
    with _traced() as peak:
        engine_for(case.scene, engine, **settings).forward(case.object_field)
    return peak[0]


@contextmanager
def _traced(enabled: bool = True) -> Iterator[list[int]]:
    """Append the peak memory, in bytes, of the code in the context to the list."""
    found: list[int] = []
    if not enabled:
        yield found
        return
    running = tracemalloc.is_tracing()
    if not running:
        tracemalloc.start()
    try:
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        yield found
        found.append(tracemalloc.get_traced_memory()[1] - before)
    finally:
        if not running:
            tracemalloc.stop()
