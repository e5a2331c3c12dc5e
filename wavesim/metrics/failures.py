"""Failure maps: errors of methods, and reactions of their guards, over two settings that a user chooses."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import stopped_down
from wavesim.analytic.beam import Beam
from wavesim.analytic.registry import AnalyticCase, analytic_case
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field, Grid, relative_error
from wavesim.fields.propagator import propagate
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics.comparison import lens_case
from wavesim.rays.ray_bundles import FoldError
from wavesim.scene.engine import Engine

SILENT, WARNED, REFUSED = 0, 1, 2

APERTURES = (0.1, 0.2, 0.3, 0.4, 0.5)
SLICES = (3, 6, 12, 25, 50, 100, 200)
TILES_MM = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
FIELD_SHARES = (0.0, 0.25, 0.5, 0.75, 0.95)
STEPS_UM = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
INCIDENCES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0)
DISTANCES_MM = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
PITCHES_UM = (0.3, 0.5, 0.8, 1.2, 2.0, 3.2)

BEAM_SPREAD, BEAM_WINDOW_UM = 0.12, 150.0


@dataclass(frozen=True, eq=False)
class FailureMap:
    """Errors of one method over two settings, and the reaction of its guard.

    Attributes
    ----------
    name, method : str
        Short name of the map, for file names; name of the method.
    x_label, y_label : str
        Labels of the settings with their units.
    x, y : tuple of float
        Values of the settings.
    error : ndarray, shape (y, x)
        Relative L2 error; NaN where there is no result even without the guard.
    guard : ndarray of int, shape (y, x)
        0 where the guard is silent, 1 where it warns, 2 where it refuses.
    """

    name: str
    method: str
    x_label: str
    y_label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    error: Array
    guard: NDArray[np.int_]


Cell = Callable[[float, float], tuple[float, int]]


def _map(
    name: str, method: str, labels: tuple[str, str], x: Sequence[float], y: Sequence[float], cell: Cell
) -> FailureMap:
    cells = [[cell(a, b) for a in x] for b in y]
    error = np.array([[c[0] for c in row] for row in cells])
    guard = np.array([[c[1] for c in row] for row in cells])
    return FailureMap(name, method, *labels, tuple(x), tuple(y), error, guard)


def failure_maps(lens: Lens, patch_mm: float) -> Iterator[FailureMap]:
    """Yield all maps; those of a lens use a meridional patch.

    Parameters
    ----------
    lens
        The lens. Small lenses take seconds, the paper's lens minutes (see :func:`lensdesign.scaled`).
    patch_mm
        Side of the object patch in mm, for the engine slices.
    """
    yield from slice_maps(lens, patch_mm)
    yield tile_map(lens)
    yield from step_maps()
    yield from free_space_maps()


def slice_maps(lens: Lens, patch_mm: float) -> Iterator[FailureMap]:
    """Yield maps of numerical aperture against slices, for both kinds of compensation."""
    cases = {aperture: lens_case(stopped_down(lens, aperture), patch_mm) for aperture in APERTURES}
    for kind in ("oblique", "vertical"):

        def cell(slices: float, aperture: float, kind: str = kind) -> tuple[float, int]:
            engine = engine_for(cases[aperture].scene, "slices", slices=int(slices), compensation=kind)
            return _run(engine, cases[aperture])

        labels = ("slices of each surface", "numerical aperture")
        yield _map(f"slices_{kind}", f"annular slices, {kind} compensation", labels, SLICES, APERTURES, cell)


def tile_map(lens: Lens) -> FailureMap:
    """Return the map of tile width against field height, for the simplest kind of tile."""
    half = lens.half_field_mm
    widths = [w for w in TILES_MM if w <= half]
    heights = [round(share * half, 4) for share in FIELD_SHARES]

    def cell(width: float, height: float) -> tuple[float, int]:
        case = lens_case(lens, width, height)
        # Error limit of the tiles. The guard warns above it and raises an error above three times the limit.
        tile_error = 0.1
        guarded = engine_for(
            case.scene, "eikonal", tile_width_mm=1.01 * width, quadratic="mean", error=tile_error
        )
        free = engine_for(case.scene, "eikonal", tile_width_mm=1.01 * width, quadratic="mean", error=1.0)
        return _run(guarded, case, free)

    labels = ("tile width (mm)", "field height (mm)")
    return _map("eikonal_tiles", "eikonal tiles, mean of the rest", labels, widths, heights, cell)


def step_maps() -> Iterator[FailureMap]:
    """Yield maps of step against angle of incidence, on a tilted plate."""
    for kind in ("substep", "staircase"):

        def cell(step_um: float, incidence: float, kind: str = kind) -> tuple[float, int]:
            case = analytic_case("tilted-plate", incidence_deg=incidence)
            return _run(engine_for(case.scene, "wpm", step_um=step_um, interface=kind), case)

        labels = ("step (µm)", "angle of incidence (°)")
        name = f"wave propagation method, {kind}"
        yield _map(f"wpm_{kind}", name, labels, STEPS_UM, INCIDENCES_DEG, cell)


def free_space_maps() -> Iterator[FailureMap]:
    """Yield maps of distance against pitch of a Gaussian beam, with automatic padding and without."""
    beam = Beam(0.532, BEAM_SPREAD)
    for name, method, pad in (
        ("free_space_auto", "angular spectrum, padding chosen", "auto"),
        ("free_space_bare", "angular spectrum without padding", None),
    ):

        def cell(distance: float, pitch_um: float, pad: Any = pad) -> tuple[float, int]:
            count = int(np.ceil(BEAM_WINDOW_UM / pitch_um))
            grid = Grid((count,), 1e-3 * pitch_um, 0.0)
            start = Field(grid, beam.field(grid.y_mm, np.zeros(count)), 0.532)
            exact = beam.field(grid.y_mm, np.full(count, distance))
            padded = (count,) if pad is None else pad

            def carried(check: bool) -> Field:
                return propagate(start, distance, pad=padded, check=check)

            guard, found = _guard(lambda: carried(True))
            seen = carried(False) if found is None else found
            return relative_error(seen.values, exact), guard

        labels = ("distance (mm)", "pitch (µm)")
        yield _map(name, method, labels, DISTANCES_MM, PITCHES_UM, cell)


def _guard(run: Callable[[], Field]) -> tuple[int, Field | None]:
    """Return the reaction of the guard, and the result if there is one."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = run()
        except (SamplingError, FoldError):
            return REFUSED, None
    return WARNED if any(issubclass(w.category, SamplingWarning) for w in caught) else SILENT, found


def _run(engine: Engine, case: AnalyticCase, unguarded: Engine | None = None) -> tuple[float, int]:
    """Return error and reaction of the guard; the error is that of an engine without the guard, if given."""
    guard, found = _guard(lambda: engine.forward(case.object_field))
    if unguarded is not None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = unguarded.forward(case.object_field)
        except (SamplingError, FoldError, InputError):
            return float("nan"), REFUSED
    return float("nan") if found is None else relative_error(found.values, case.exact.values), guard


def map_rows(found: FailureMap) -> list[dict[str, Any]]:
    """Return one table row for each cell."""
    words = ("silent", "warns", "refuses")
    return [
        {
            found.x_label: x,
            found.y_label: y,
            "relative_error": found.error[j, i],
            "guard": words[found.guard[j, i]],
        }
        for j, y in enumerate(found.y)
        for i, x in enumerate(found.x)
    ]
