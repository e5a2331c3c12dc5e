"""Engines side by side: error against seconds and memory, over a range of settings of each.

Scenes are exact solutions and patches of the lens itself. The reference solution on a line is the wave
propagation method with fine steps and a wide window. On a plane it is the sum over all plane waves
(:mod:`wavesim.metrics.axisymmetric_reference`). Nothing is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import Lens
from wavesim.analytic.registry import AnalyticCase
from wavesim.engines.choosing import engine_for
from wavesim.engines.registry import ENGINES, engine_class
from wavesim.fields.field import Field, Grid
from wavesim.metrics.accuracy import compare_with_exact
from wavesim.scene.engine import Engine
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene
from wavesim.targets.patterns import band_limit

Progress = Callable[[int, int, str], None]

Variant = tuple[str, str, dict[str, Any]]
"""Family, engine and settings."""

REFERENCE_ZONES = 80.0
"""Width of the reference solution's margin for light that the rim diffracts, in Fresnel zones. Its relative
L2 error of a point's field is 0.23 % on a one-quarter twin of the paper's lens.
"""


@dataclass(frozen=True)
class Measured:
    """Measured error and cost of one engine with one setting on one scene.

    Attributes
    ----------
    scene : str
        Name of the scene.
    family : str
        Engine and its variant, which is the same for all points of a curve.
    setting : str
        Setting that varies along the curve.
    relative_error, seconds, setup_seconds, peak_mb : float
        Relative L2 error, times, and peak memory in 1e6 bytes; NaN if the engine refused the scene.
    predicted_error, predicted_seconds, predicted_mb : float
        Predictions of the engine.
    uncertainty : float
        Relative error of the reference solution.
    fastest, smallest : bool
        Whether no other point has a smaller error and less time, or less memory.
    message : str
        Warnings, or the reason for the refusal.
    """

    scene: str
    family: str
    setting: str
    relative_error: float
    seconds: float
    setup_seconds: float
    peak_mb: float
    predicted_error: float
    predicted_seconds: float
    predicted_mb: float
    uncertainty: float
    fastest: bool = False
    smallest: bool = False
    message: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for CSV and JSON; `said` is the key of the message in files."""
        return {"said" if name == "message" else name: value for name, value in vars(self).items()}


def variants(scene: Scene) -> tuple[Variant, ...]:
    """Return all engines over a range of their settings for a scene."""
    return tuple(
        (family, engine.name, settings)
        for name in ENGINES
        for engine in engine_class(name).implementations()
        for family, curve in engine.curves(scene).items()
        for settings in curve
    )


def lens_case(lens: Lens, patch_mm: float, field_mm: float = 0.0, **where: Any) -> AnalyticCase:
    """Return the case of a meridional patch that light of all directions fills evenly.

    Parameters
    ----------
    lens, patch_mm, field_mm
        As in :func:`wavesim.scene.patches.patch_scene`.
    **where
        Further arguments of that function.

    Returns
    -------
    AnalyticCase
        `exact` is the field of the wave propagation method with fine steps, and `uncertainty` its own
        estimate.
    """
    scene = patch_scene(lens, patch_mm, field_mm, meridional=True, **where)
    truth = reference_for(scene)
    start = random_field(scene.object_grid, scene.wavelength_um, lens.object.numerical_aperture)
    unknown = [part.relative_error for part in truth.error_terms()]
    return AnalyticCase(scene, start, truth.forward(start), float(np.sqrt(np.sum(np.square(unknown)))))


def reference_for(scene: Scene) -> Engine:
    """Return the wave propagation method with fine steps."""
    step_um = engine_for(scene, "wpm").settings()["step_um"]
    fine = engine_for(scene, "wpm", zones=REFERENCE_ZONES)
    # Step of the reference as a fraction of the one that the engine would choose.
    step_fraction = 0.5
    return engine_for(
        scene,
        "wpm",
        zones=REFERENCE_ZONES,
        step_um=min(step_fraction * step_um, float(fine.settings()["step_um"])),
    )


def random_field(grid: Grid, wavelength_um: float, numerical_aperture: float) -> Field:
    """Return speckle of unit mean intensity that fills a grid and the aperture evenly."""
    rng = np.random.default_rng(20260531)
    values = rng.standard_normal(grid.shape) + 1j * rng.standard_normal(grid.shape)
    values = band_limit(values, grid, wavelength_um, numerical_aperture)
    return Field(grid, values / np.sqrt(np.mean(np.abs(values) ** 2)), wavelength_um)


def compare(
    cases: dict[str, AnalyticCase],
    tried: Callable[[Scene], Sequence[Variant]] = variants,
    progress: Progress | None = None,
    most_seconds: float = 60.0,
) -> list[Measured]:
    """Compare engines with reference solutions.

    Parameters
    ----------
    cases
        Scenes with their reference exit fields, by name.
    tried
        Function that returns families, engines and settings for a scene.
    progress
        Callback with the completed number, the total number, and the name of the next run.
    most_seconds
        Runs with a longer predicted time are skipped; the result states it.

    Returns
    -------
    list of Measured
        Error and cost of each engine, setting and scene.

    Raises
    ------
    InputError
        If `most_seconds` is not above 0.
    """
    if not most_seconds > 0.0:
        raise InputError(f"most_seconds = {most_seconds!r}: must be above 0")
    results: list[Measured] = []
    of_cases = {name: tried(case.scene) for name, case in cases.items()}
    total = sum(map(len, of_cases.values()))
    for name, case in cases.items():
        rows: list[Measured] = []
        for family, engine, settings in of_cases[name]:
            if progress is not None:
                progress(len(results) + len(rows), total, f"{name}: {family} {_label(settings)}")
            rows.append(_measure(name, case, (family, engine, settings), most_seconds))
        results += with_front(rows)
    return results


def _measure(name: str, case: AnalyticCase, variant: Variant, most_seconds: float) -> Measured:
    family, engine, settings = variant
    label = _label(settings)
    nothing = (*(float("nan"),) * 7, case.uncertainty)
    try:
        cost = engine_for(case.scene, engine, **settings).cost()
        seconds = cost.setup_seconds + cost.seconds
        if seconds > most_seconds:
            return Measured(
                name, family, label, *nothing, message=f"skipped: predicted to take {seconds:.3g} s"
            )
        found = compare_with_exact(case, engine, settings)
    except (InputError, SamplingError) as problem:
        return Measured(name, family, label, *nothing, message=str(problem))
    return Measured(
        name,
        family,
        label,
        found.relative_error,
        found.seconds,
        found.setup_seconds,
        found.peak_mb,
        found.predicted_error,
        found.predicted.seconds,
        1e-6 * found.predicted.peak_bytes,
        found.uncertainty,
        message="; ".join(found.warnings),
    )


def _label(settings: dict[str, Any]) -> str:
    """Return the numeric settings as text; the other settings are part of the family's name."""
    return ", ".join(f"{name} {value:g}" for name, value in settings.items() if not isinstance(value, str))


def with_front(rows: list[Measured]) -> list[Measured]:
    """Return the rows of one scene, with the marks `fastest` and `smallest`."""

    def leads(row: Measured, cost: Callable[[Measured], float]) -> bool:
        better = [r for r in rows if r.relative_error < row.relative_error and cost(r) <= cost(row)]
        return not better and bool(np.isfinite(row.relative_error))

    return [
        replace(r, fastest=leads(r, lambda m: m.seconds), smallest=leads(r, lambda m: m.peak_mb))
        for r in rows
    ]


def families(rows: Sequence[Measured]) -> Iterator[tuple[str, list[Measured]]]:
    """Yield the curves in the order in which they were measured."""
    for family in dict.fromkeys(row.family for row in rows):
        yield family, [row for row in rows if row.family == family]
