"""From slice to slice through a lens: waves in front of a surface, what each slice takes, waves behind it.

A slice lies in a part of its window, and its waves within a band: of the Fourier transforms from waves to
samples and back only the rows and columns are done that these take, some at a time. Works in the precision
and the memory of the field that is given, by any array library that indexes as NumPy does (CuPy). Phases are
formed in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wavesim.engines.slices.samples import SlicedSurface
from wavesim.engines.slices.windows import Waves, block, handed_over
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import BandLimit, axial_wavenumbers, lateral_shift_mm, phasor_of
from wavesim.runtime.arrays import array_module, fft, ifft
from wavesim.runtime.threads import for_blocks

STEP_GRAIN_MM = 1e-12
"""Steps between planes are rounded to it, so that equal ones are equal; some thousand err by 1e-5 rad."""

Sides = tuple[Waves, Waves]


@dataclass(frozen=True, eq=False)
class SurfaceTransfer:
    """From the object to the exit.

    Attributes
    ----------
    object_grid, exit_grid : Grid
        Samples of the field in front of the lens and behind it.
    sides : sequence of (Waves, Waves)
        Of every surface: those in front of it and behind it, in its window.
    surfaces : sequence of SlicedSurface
        Their samples by slice.
    arriving : PassBand
        Walks of the object's waves that are let pass to the first surface.
    """

    object_grid: Grid
    exit_grid: Grid
    sides: Sequence[Sides]
    surfaces: Sequence[SlicedSurface]
    arriving: BandLimit

    def forward(self, values: Any) -> Any:
        """Field on the exit grid of one on the object grid."""
        first, last = self.sides[0][0], self.sides[-1][1]
        held = first.held_by(self.object_grid)
        spectrum = _widened(first.gathered(values, self.object_grid, held), first)
        spectrum = carried(first, spectrum, self._start_mm[0] - self.object_grid.z_mm, self.arriving)
        for i, ((front, behind), surface) in enumerate(zip(self.sides, self.surfaces, strict=True)):
            if i > 0:
                leg = self._start_mm[i] - self._end_mm[i - 1]
                spectrum = _to_next(spectrum, self.sides[i - 1][1], front, leg)
            spectrum = through_surface(front, behind, surface, spectrum)
        spectrum = carried(last, spectrum, self.exit_grid.z_mm - self._end_mm[-1])
        return last.spread(spectrum, self.exit_grid, last.orders)

    def adjoint(self, values: Any) -> Any:
        """Field on the object grid of one on the exit grid: the exact adjoint."""
        first, last = self.sides[0][0], self.sides[-1][1]
        spectrum = last.gathered(values, self.exit_grid, last.orders)
        spectrum = carried(last, spectrum, self._end_mm[-1] - self.exit_grid.z_mm)
        for i in reversed(range(len(self.sides))):
            front, behind = self.sides[i]
            spectrum = through_surface(behind, front, self.surfaces[i], spectrum, back=True)
            if i > 0:
                leg = self._end_mm[i - 1] - self._start_mm[i]
                spectrum = _to_next(spectrum, front, self.sides[i - 1][1], leg)
        spectrum = carried(first, spectrum, self.object_grid.z_mm - self._start_mm[0], self.arriving)
        held = first.held_by(self.object_grid)
        return first.spread(_narrowed(spectrum, first, held), self.object_grid, held)

    @property
    def _start_mm(self) -> list[float]:
        return [float(surface.before_mm[0]) for surface in self.surfaces]

    @property
    def _end_mm(self) -> list[float]:
        return [float(surface.behind_mm[-1]) for surface in self.surfaces]


def _to_next(spectrum: Any, source: Waves, target: Waves, leg_mm: float) -> Any:
    """From one surface's plane and window to the next's; the wider window carries."""
    wider = source.grid.half_widths_mm[0] > target.grid.half_widths_mm[0]
    spectrum = carried(source, spectrum, leg_mm if wider else 0.0)
    return carried(target, handed_over(spectrum, source, target), 0.0 if wider else leg_mm)


def _narrowed(spectrum: Any, waves: Waves, orders: Sequence[int]) -> Any:
    """Waves up to some orders."""
    return spectrum[tuple(slice(m - n, m + n + 1) for m, n in zip(waves.orders, orders, strict=True))]


def _widened(spectrum: Any, waves: Waves) -> Any:
    """With zeros for the waves of higher orders."""
    if spectrum.shape == waves.shape:
        return spectrum
    result = array_module(spectrum).zeros(waves.shape, dtype=spectrum.dtype)
    orders = [n // 2 for n in spectrum.shape]
    result[tuple(slice(m - n, m + n + 1) for m, n in zip(waves.orders, orders, strict=True))] = spectrum
    return result


def through_surface(
    source: Waves, target: Waves, surface: SlicedSurface, spectrum: Any, back: bool = False
) -> Any:
    """Take the waves of one medium at the first slice, and sum those of the other at the last.

    Backwards from the last slice to the first, with conjugate factors, it is the exact adjoint.

    Parameters
    ----------
    source, target
        Waves in front of the surface and behind it, in its window; the other way round if backwards.
    surface
        Its slices.
    spectrum
        Waves that arrive, within their band; changed.
    back
        Whether to go backwards.
    """
    xp = array_module(spectrum)
    arriving = xp.reshape(spectrum, _plane(source.shape))
    total = xp.zeros(_plane(target.shape), dtype=spectrum.dtype)
    rows = max(arriving.shape[0], total.shape[0])
    widest = max(b.columns.stop - b.columns.start for b in surface.boxes)
    between = xp.empty((rows, widest), dtype=spectrum.dtype)
    order = range(len(surface.boxes))
    start, end = surface.before_mm, surface.behind_mm
    if back:
        order, start, end = order[::-1], end, start
    steps = _Steps(source), _Steps(target)
    last = order[0]
    for q in order:
        work = _Slice(surface, q, _plane(source.grid.shape), back)
        steps[0].prepare(float(start[q] - start[last]), spectrum)
        steps[1].prepare(float(end[q] - end[last]), spectrum)
        work.take_rows(arriving, steps[0], between)
        work.pass_columns(arriving.shape[0], total.shape[0], between)
        work.give_rows(total, steps[1], between)
        last = q
    return xp.reshape(total, target.shape)


def carried(waves: Waves, spectrum: Any, distance_mm: float, let: BandLimit | None = None) -> Any:
    """Waves after a distance, those beyond the band left out, or whose walk is; the spectrum is changed."""
    plane = array_module(spectrum).reshape(spectrum, _plane(waves.shape))
    step = _Steps(waves)
    step.factor = step_factor(waves, distance_mm, spectrum, let)
    _in_blocks(lambda a, b: step.multiply(plane[a:b], a), plane.shape[0], plane.shape[1], spectrum)
    return spectrum


@dataclass(frozen=True, eq=False)
class _Slice:
    """One slice: its waves become samples, row by row and column by column, and waves again."""

    surface: SlicedSurface
    which: int
    shape: tuple[int, int]
    back: bool

    def take_rows(self, arriving: Any, step: _Steps, between: Any) -> None:
        """Along x, from waves to the columns of the slice."""
        columns = self._columns
        width, order = columns.stop - columns.start, arriving.shape[1] // 2
        xp = array_module(arriving)

        def work(a: int, b: int) -> None:
            part = arriving[a:b]
            step.multiply(part, a)
            if self.shape[1] > 1:
                full = xp.zeros((b - a, self.shape[1]), dtype=part.dtype)
                full[:, : order + 1] = part[:, order:]
                full[:, self.shape[1] - order :] = part[:, :order]
                part = ifft(full, 1, overwrite=True, workers=1)[:, columns]
            between[a:b, :width] = part

        _in_blocks(work, arriving.shape[0], self.shape[1], arriving)

    def pass_columns(self, given: int, taken: int, between: Any) -> None:
        """Along y, from waves to samples, their factors, and back to waves of the other medium."""
        surface, box, rows = self.surface, self.surface.boxes[self.which], self._rows
        count, order, other = self.shape[0], given // 2, taken // 2
        xp = array_module(between)

        def work(a: int, b: int) -> None:
            full = xp.zeros((count, b - a), dtype=between.dtype)
            full[: order + 1] = between[order:given, a:b]
            full[count - order :] = between[:order, a:b]
            wave = ifft(full, 0, overwrite=True, workers=1)
            columns = slice(box.columns.start + a, box.columns.start + b)
            factor = xp.asarray(surface.factors[box.rows, columns], dtype=between.dtype)
            here = xp.asarray(surface.numbers[box.rows, columns]) == surface.labels[self.which]
            kept = wave[rows] * (xp.conj(factor) if self.back else factor)
            wave[: rows.start] = 0.0
            wave[rows.stop :] = 0.0
            wave[rows] = xp.where(here, kept, xp.zeros_like(kept))
            sums = fft(wave, axis=0, overwrite=True, workers=1)
            between[other:taken, a:b] = sums[: other + 1]
            between[:other, a:b] = sums[count - other :]

        _in_blocks(work, box.columns.stop - box.columns.start, count, between)

    def give_rows(self, total: Any, step: _Steps, between: Any) -> None:
        """Along x, from the columns of the slice to waves, which are added to what is there."""
        columns = self._columns
        width, order = columns.stop - columns.start, total.shape[1] // 2
        xp = array_module(total)

        def work(a: int, b: int) -> None:
            sums = total[a:b]
            step.multiply(sums, a)
            if self.shape[1] == 1:
                sums += between[a:b, :width]
                return
            full = xp.zeros((b - a, self.shape[1]), dtype=total.dtype)
            full[:, columns] = between[a:b, :width]
            waves = fft(full, axis=1, overwrite=True, workers=1)
            sums[:, order:] += waves[:, : order + 1]
            sums[:, :order] += waves[:, self.shape[1] - order :]

        _in_blocks(work, total.shape[0], self.shape[1], total)

    @property
    def _rows(self) -> slice:
        return _moved(self.surface.boxes[self.which].rows, self.surface.corner[0])

    @property
    def _columns(self) -> slice:
        return _moved(self.surface.boxes[self.which].columns, self.surface.corner[1])


class _Steps:
    """Factors of plane waves from plane to plane; the last one is kept, since steps mostly repeat.

    A factor is the same for an order and its negative: a quarter of it is kept.
    """

    def __init__(self, waves: Waves) -> None:
        self.waves = waves
        self.step_mm = 0.0
        self.factor: Any = None
        self.none = False

    def prepare(self, step_mm: float, like: Any) -> None:
        """Make ready for a step."""
        step_mm = round(step_mm / STEP_GRAIN_MM) * STEP_GRAIN_MM
        self.none = step_mm == 0.0
        if self.none or step_mm == self.step_mm:
            return
        # Frees the old factor before the new one is made.
        self.factor = None
        self.step_mm, self.factor = step_mm, step_factor(self.waves, step_mm, like)

    def multiply(self, part: Any, start: int) -> None:
        """Rows of a spectrum from one on, in place."""
        if self.none:
            return
        xp = array_module(part)
        down, across = self.factor.shape[0] - 1, self.factor.shape[1] - 1
        rows = abs(xp.arange(start, start + part.shape[0]) - down)
        factor = self.factor[rows]
        part[:, across:] *= factor
        if across > 0:
            part[:, :across] *= factor[:, :0:-1]


def step_factor(waves: Waves, distance_mm: float, like: Any, let: BandLimit | None = None) -> Any:
    """Factor of each wave of orders from 0 on, in the library and precision of an array.

    It is 0 beyond the band, and where `let` stops the walk from the axis.
    """
    xp, medium = array_module(like), waves.medium
    steps = [f.step for f in waves.frequencies(waves.orders)]
    down, across = (
        step * xp.arange(m + 1, dtype=xp.float64)
        for m, step in zip((*waves.orders, 0)[:2], (*steps, 0.0)[:2], strict=True)
    )
    result = xp.empty((down.shape[0], across.shape[0]), dtype=like.dtype)

    def work(a: int, b: int) -> None:
        cycles = [xp.reshape(down[a:b], (-1, 1)), xp.reshape(across, (1, -1))]
        kz, _ = axial_wavenumbers(cycles, medium.wavelength_um, medium.index, xp)
        factor = phasor_of(kz * distance_mm, like.dtype, xp) * (kz > medium.smallest_kz_per_mm)
        if let is not None:
            walks = lateral_shift_mm(cycles, kz, distance_mm, xp)
            weight = let.weight(xp.sqrt(walks[0] ** 2 + walks[1] ** 2), xp)
            factor = factor * xp.asarray(
                weight, dtype=xp.float32 if like.dtype == xp.complex64 else xp.float64
            )
        result[a:b] = factor

    _in_blocks(work, result.shape[0], result.shape[1], like)
    return result


def _plane(shape: tuple[int, ...]) -> tuple[int, int]:
    """A line is a plane of one column."""
    return shape[0], (*shape, 1)[1]


def _moved(part: slice, by: int) -> slice:
    return slice(part.start + by, part.stop + by)


def _in_blocks(work: Callable[[int, int], None], count: int, samples: int, like: Any) -> None:
    """Work on rows or columns of so many samples each, in threads where the arrays are NumPy's."""
    step = block(samples, like)
    if isinstance(like, np.ndarray):
        for_blocks(work, count, step)
        return
    for start in range(0, count, step):
        work(start, min(start + step, count))
