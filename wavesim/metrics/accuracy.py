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
from wavesim.scene.light import Light

TIMED_RUNS, SLOW_SECONDS = 3, 1.0
"""Runs of which the fastest counts, once set up; a run longer than this is not repeated, and its memory is
measured while it is timed."""


@dataclass(frozen=True)
class AnalyticResult:
    """Error of an engine relative to an exact solution, and its cost.

    Attributes
    ----------
    engine, oracle : str
        Names.
    radius_mm : float or None
        Of the first surface; None for a plane.
    relative_error : float
        L2 norm of the difference over that of the exact field; nothing is fitted.
    uncertainty : float
        Relative error of the exact field.
    seconds, setup_seconds : float
        For one `forward` once set up, and for what was done once before.
    peak_mb : float
        Most memory that the engine held at one time, set-up and result included, in 1e6 bytes.
    predicted : Cost
        What the engine said beforehand that it would take.
    predicted_error : float
        And how far it would be off at most; infinite where it cannot tell.
    settings : dict
        Of the engine, as it used them.
    warnings : tuple of str
        What the engine warned of.
    """

    engine: str
    oracle: str
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
    oracle: str = "cylinder",
    radius_mm: float | None = None,
    oracle_arguments: Mapping[str, Any] | None = None,
    **settings: Any,
) -> AnalyticResult:
    """Hold an engine against an exact solution.

    Parameters
    ----------
    engine
        One of :data:`wavesim.engines.registry.ENGINES`.
    oracle
        One of :data:`wavesim.analytic.registry.ORACLES`.
    radius_mm
        Of the cylinder or the sphere; left out, the oracle's own.
    oracle_arguments
        Further arguments of the oracle.
    **settings
        Of the engine.

    Raises
    ------
    InputError, SamplingError
        If a name or a value is not usable, or the engine refuses the scene.
    """
    arguments = dict(oracle_arguments or {})
    if radius_mm is not None:
        arguments["radius_mm"] = radius_mm
    return compare_with_exact(analytic_case(oracle, **arguments), engine, settings, oracle)


def compare_with_exact(
    case: AnalyticCase, engine: str, settings: Mapping[str, Any], oracle: str = ""
) -> AnalyticResult:
    """Hold an engine against a scene whose answer is known.

    Parameters
    ----------
    case
        The scene.
    engine, settings
        As for :func:`wavesim.engines.choosing.engine_for`.
    oracle
        Name of the scene, for the result.

    Raises
    ------
    InputError, SamplingError
        If a name or a value is not usable, or the engine refuses the scene.
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
        oracle=oracle,
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
    """A number of NumPy as one of Python."""
    return value.item() if isinstance(value, np.generic) else value


def _timed(
    engine: str, case: AnalyticCase, settings: Mapping[str, Any]
) -> tuple[Engine, float, float, Field]:
    """The engine, seconds for a run, seconds that the first run took longer, and the exit field."""
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
    """Most bytes that a fresh engine and its run hold at one time, as NumPy and Python tell it."""
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
