"""Propagation from slice to slice: plane waves in front of a surface, samples of each slice, waves behind it.

A slice covers a part of its window, and its waves lie within a band. The Fourier transforms between waves and
samples therefore compute only the required rows and columns, some at a time. They keep the precision of the
given field. Phases are computed in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from lensdesign.raytrace.plane_plate import PlanePlate
from wavesim.engines.slices.samples import SlicedSurface
from wavesim.engines.slices.windows import Waves, block, transferred
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import BandLimit, PlaneWaves
from wavesim.runtime.threads import for_blocks

Sides = tuple[Waves, Waves]


@dataclass(frozen=True, eq=False)
class SurfaceTransfer:
    """Propagation from the object to the exit grid.

    Attributes
    ----------
    object_grid, exit_grid : Grid
        Grids of the field in front of the lens and behind it.
    sides : sequence of (Waves, Waves)
        Plane waves in front of every surface and behind it, in its window.
    surfaces : sequence of SlicedSurface
        Samples of every surface by slice.
    arriving : BandLimit
        Lateral shifts from the object to the first surface that are transmitted.
    plate : PlanePlate or None
        Cover glass of the sensor between the last surface and the exit grid.
    """

    object_grid: Grid
    exit_grid: Grid
    sides: Sequence[Sides]
    surfaces: Sequence[SlicedSurface]
    arriving: BandLimit
    plate: PlanePlate | None = None

    def forward(self, values: Any) -> Any:
        """Return the field on the exit grid for a field on the object grid."""
        first, last = self.sides[0][0], self.sides[-1][1]
        orders = first.resolved_by(self.object_grid)
        spectrum = _widened(first.analyze(values, self.object_grid, orders), first)
        spectrum = propagated(first, spectrum, self._start_mm[0] - self.object_grid.z_mm, self.arriving)
        for i, ((front, behind), surface) in enumerate(zip(self.sides, self.surfaces, strict=True)):
            if i > 0:
                leg = self._start_mm[i] - self._end_mm[i - 1]
                spectrum = _to_next(spectrum, self.sides[i - 1][1], front, leg)
            spectrum = through_surface(front, behind, surface, spectrum)
        spectrum = propagated(last, spectrum, self.exit_grid.z_mm - self._end_mm[-1], plate=self.plate)
        return last.synthesize(spectrum, self.exit_grid, last.orders)

    def adjoint(self, values: Any) -> Any:
        """Apply the exact adjoint to a field on the exit grid."""
        first, last = self.sides[0][0], self.sides[-1][1]
        spectrum = last.analyze(values, self.exit_grid, last.orders)
        back = None if self.plate is None else replace(self.plate, thickness_mm=-self.plate.thickness_mm)
        spectrum = propagated(last, spectrum, self._end_mm[-1] - self.exit_grid.z_mm, plate=back)
        for i in reversed(range(len(self.sides))):
            front, behind = self.sides[i]
            spectrum = through_surface(behind, front, self.surfaces[i], spectrum, adjoint=True)
            if i > 0:
                leg = self._end_mm[i - 1] - self._start_mm[i]
                spectrum = _to_next(spectrum, front, self.sides[i - 1][1], leg)
        spectrum = propagated(first, spectrum, self.object_grid.z_mm - self._start_mm[0], self.arriving)
        orders = first.resolved_by(self.object_grid)
        return first.synthesize(_narrowed(spectrum, first, orders), self.object_grid, orders)

    @property
    def _start_mm(self) -> list[float]:
        return [float(surface.before_mm[0]) for surface in self.surfaces]

    @property
    def _end_mm(self) -> list[float]:
        return [float(surface.behind_mm[-1]) for surface in self.surfaces]


def _to_next(spectrum: Any, source: Waves, target: Waves, leg_mm: float) -> Any:
    """Propagate from one surface's plane and window to the next's; the step is done in the wider window."""
    wider = source.grid.half_widths_mm[0] > target.grid.half_widths_mm[0]
    spectrum = propagated(source, spectrum, leg_mm if wider else 0.0)
    return propagated(target, transferred(spectrum, source, target), 0.0 if wider else leg_mm)


def _narrowed(spectrum: Any, waves: Waves, orders: Sequence[int]) -> Any:
    """Return the waves up to some orders."""
    return spectrum[tuple(slice(m - n, m + n + 1) for m, n in zip(waves.orders, orders, strict=True))]


def _widened(spectrum: Any, waves: Waves) -> Any:
    """Return a spectrum with zeros for the waves of higher orders."""
    if spectrum.shape == waves.shape:
        return spectrum
    result = np.zeros(waves.shape, dtype=spectrum.dtype)
    orders = [n // 2 for n in spectrum.shape]
    result[tuple(slice(m - n, m + n + 1) for m, n in zip(waves.orders, orders, strict=True))] = spectrum
    return result


def through_surface(
    source: Waves, target: Waves, surface: SlicedSurface, spectrum: Any, adjoint: bool = False
) -> Any:
    """Propagate the waves of one medium at the first slice to those of the other medium at the last slice.

    These are Eqs. C1 to C4, or C5 to C7. Each slice adds its waves to the sum, which then moves on to the
    plane of the next slice, so that the last slice's plane is the virtual plane.

    The exact adjoint runs from the last slice to the first, with conjugate factors.

    Parameters
    ----------
    source, target
        Waves in front of the surface and behind it, in its window; swapped for the adjoint.
    surface
        Samples of the surface by slice.
    spectrum
        Incident waves within their band; overwritten.
    adjoint
        Whether to apply the adjoint.
    """
    arriving = np.reshape(spectrum, _plane(source.shape))
    total = np.zeros(_plane(target.shape), dtype=spectrum.dtype)
    rows = max(arriving.shape[0], total.shape[0])
    widest = max(b.columns.stop - b.columns.start for b in surface.boxes)
    between = np.empty((rows, widest), dtype=spectrum.dtype)
    order = range(len(surface.boxes))
    start, end = surface.before_mm, surface.behind_mm
    if adjoint:
        order, start, end = order[::-1], end, start
    steps = _Steps(source), _Steps(target)
    last = order[0]
    for q in order:
        work = _Slice(surface, q, _plane(source.grid.shape), adjoint)
        steps[0].prepare(float(start[q] - start[last]), spectrum.dtype)
        steps[1].prepare(float(end[q] - end[last]), spectrum.dtype)
        work.take_rows(arriving, steps[0], between)
        work.pass_columns(arriving.shape[0], total.shape[0], between)
        work.give_rows(total, steps[1], between)
        last = q
    return np.reshape(total, target.shape)


def propagated(
    waves: Waves,
    spectrum: Any,
    distance_mm: float,
    limit: BandLimit | None = None,
    plate: PlanePlate | None = None,
) -> Any:
    """Propagate waves over a distance, in place; those beyond the band or the limit become 0.

    Distance and thickness of a plate are negative for propagation backwards.
    """
    plane = np.reshape(spectrum, _plane(waves.shape))
    step = _Steps(waves)
    step.factor = step_factor(waves, distance_mm, spectrum.dtype, limit, plate)
    _in_blocks(lambda a, b: step.multiply(plane[a:b], a), plane.shape[0], plane.shape[1])
    return spectrum


@dataclass(frozen=True, eq=False)
class _Slice:
    """Transforms of one slice: from waves to samples, along rows and columns, and back to waves."""

    surface: SlicedSurface
    which: int
    shape: tuple[int, int]
    adjoint: bool

    def take_rows(self, arriving: Any, step: _Steps, between: Any) -> None:
        """Propagate to the plane of the slice (P in Eqs. C1, C5), and transform along x to its columns."""
        columns = self._columns
        width, order = columns.stop - columns.start, arriving.shape[1] // 2

        def work(a: int, b: int) -> None:
            part = arriving[a:b]
            step.multiply(part, a)
            if self.shape[1] > 1:
                full = np.zeros((b - a, self.shape[1]), dtype=part.dtype)
                full[:, : order + 1] = part[:, order:]
                full[:, self.shape[1] - order :] = part[:, :order]
                part = scipy.fft.ifft(full, axis=1, overwrite_x=True, workers=1)[:, columns]
            between[a:b, :width] = part

        _in_blocks(work, arriving.shape[0], self.shape[1])

    def pass_columns(self, source_rows: int, target_rows: int, between: Any) -> None:
        """Transform along y to samples, multiply them by their factors, and transform back to waves."""
        surface, box, rows = self.surface, self.surface.boxes[self.which], self._rows
        count, order, other = self.shape[0], source_rows // 2, target_rows // 2

        def work(a: int, b: int) -> None:
            full = np.zeros((count, b - a), dtype=between.dtype)
            full[: order + 1] = between[order:source_rows, a:b]
            full[count - order :] = between[:order, a:b]
            wave = scipy.fft.ifft(full, axis=0, overwrite_x=True, workers=1)
            columns = slice(box.columns.start + a, box.columns.start + b)
            factor = np.asarray(surface.factors[box.rows, columns], dtype=between.dtype)
            is_own = np.asarray(surface.indices[box.rows, columns]) == surface.labels[self.which]
            # Eqs. C3, C6: the phase compensation.
            kept = wave[rows] * (np.conj(factor) if self.adjoint else factor)
            # Eqs. C1, C5: the pupil of the slice.
            wave[: rows.start] = 0.0
            wave[rows.stop :] = 0.0
            wave[rows] = np.where(is_own, kept, np.zeros_like(kept))
            sums = scipy.fft.fft(wave, axis=0, overwrite_x=True, workers=1)
            between[other:target_rows, a:b] = sums[: other + 1]
            between[:other, a:b] = sums[count - other :]

        _in_blocks(work, box.columns.stop - box.columns.start, count)

    def give_rows(self, total: Any, step: _Steps, between: Any) -> None:
        """Transform along x, from the columns of the slice to waves, and add them to the total (C4, C7)."""
        columns = self._columns
        width, order = columns.stop - columns.start, total.shape[1] // 2

        def work(a: int, b: int) -> None:
            sums = total[a:b]
            step.multiply(sums, a)
            if self.shape[1] == 1:
                sums += between[a:b, :width]
                return
            full = np.zeros((b - a, self.shape[1]), dtype=total.dtype)
            full[:, columns] = between[a:b, :width]
            waves = scipy.fft.fft(full, axis=1, overwrite_x=True, workers=1)
            sums[:, order:] += waves[:, : order + 1]
            sums[:, :order] += waves[:, self.shape[1] - order :]

        _in_blocks(work, total.shape[0], self.shape[1])

    @property
    def _rows(self) -> slice:
        return _moved(self.surface.boxes[self.which].rows, self.surface.corner[0])

    @property
    def _columns(self) -> slice:
        return _moved(self.surface.boxes[self.which].columns, self.surface.corner[1])


class _Steps:
    """Factors of plane waves from plane to plane; the last factor is stored, since most steps repeat.

    A factor is equal for an order and its negative, so that only a quarter of it is stored.
    """

    def __init__(self, waves: Waves) -> None:
        self.waves = waves
        self.step_mm = 0.0
        self.factor: Any = None
        self.is_zero = False

    def prepare(self, step_mm: float, dtype: np.dtype[Any]) -> None:
        """Compute the factor of a step, unless it is the previous one."""
        # Steps are rounded so that equal ones share a factor; the phase error stays below 1e-5 rad.
        step_grain_mm = 1e-12
        step_mm = round(step_mm / step_grain_mm) * step_grain_mm
        self.is_zero = step_mm == 0.0
        if self.is_zero or step_mm == self.step_mm:
            return
        # Frees the old factor before the new one is computed.
        self.factor = None
        self.step_mm, self.factor = step_mm, step_factor(self.waves, step_mm, dtype)

    def multiply(self, rows_of_spectrum: Any, start: int) -> None:
        """Multiply rows of a spectrum, from one on, by the factor, in place."""
        if self.is_zero:
            return
        down, across = self.factor.shape[0] - 1, self.factor.shape[1] - 1
        rows = abs(np.arange(start, start + rows_of_spectrum.shape[0]) - down)
        factor = self.factor[rows]
        rows_of_spectrum[:, across:] *= factor
        if across > 0:
            rows_of_spectrum[:, :across] *= factor[:, :0:-1]


def step_factor(
    waves: Waves,
    distance_mm: float,
    dtype: np.dtype[Any],
    limit: BandLimit | None = None,
    plate: PlanePlate | None = None,
) -> Any:
    """Return the factor of each wave of orders from 0 on, in the precision of `dtype`.

    It is 0 beyond the band, and where `limit` blocks the radial shift.
    """
    medium = waves.medium
    steps = [f.step for f in waves.frequencies(waves.orders)]
    down, across = (
        step * np.arange(m + 1, dtype=np.float64)
        for m, step in zip((*waves.orders, 0)[:2], (*steps, 0.0)[:2], strict=True)
    )
    result = np.empty((down.shape[0], across.shape[0]), dtype=dtype)

    def work(a: int, b: int) -> None:
        cycles = [np.reshape(down[a:b], (-1, 1)), np.reshape(across, (1, -1))]
        plane_waves = PlaneWaves(cycles, medium.wavelength_um, medium.index, medium.smallest_kz_per_mm)
        factor = plane_waves.transfer_function(distance_mm, plate=plate, dtype=dtype)
        if limit is not None:
            y_mm, x_mm = plane_waves.lateral_shift_mm(distance_mm)
            weight = limit.weight(np.sqrt(y_mm**2 + x_mm**2))
            factor *= np.asarray(weight, factor.real.dtype)
        result[a:b] = factor

    _in_blocks(work, result.shape[0], result.shape[1])
    return result


def _plane(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return the shape of a plane; a line is a plane of one column."""
    return shape[0], (*shape, 1)[1]


def _moved(interval: slice, by: int) -> slice:
    return slice(interval.start + by, interval.stop + by)


def _in_blocks(work: Callable[[int, int], None], count: int, samples: int) -> None:
    """Process rows or columns of so many samples each, in threads."""
    for_blocks(work, count, block(samples))
