"""Tiles and super-tiles of a whole field: where each lies on the plane, and its light carried there and back.

A tile's field without its carrier is band-limited by the tile's own width, that of a super-tile by its own.
So a tile is computed on a coarse grid of its own, carried to the super-tile's grid with the difference of
both carriers, and a super-tile from there to the plane with the super-tile's carrier.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.engines.tiles.operator import BAND_MARGIN, Tile, folded, fourier_plan
from wavesim.engines.whole_field.factors import FieldFactors
from wavesim.engines.whole_field.kernel import collector, expander
from wavesim.engines.whole_field.ray_maps import REACH, FieldMaps
from wavesim.fields.resampling import OVERSAMPLING, Kernel, Weights, coarse_axis, interpolation
from wavesim.fields.resampling_kernel import collect_along_y
from wavesim.rays.maps import SmoothMap
from wavesim.runtime.device import Precision
from wavesim.scene.engine import Scene

Array = NDArray[np.float64]

TAPER = 3.0
"""Samples of a super-tile's grid over which the aperture's edge rises."""

TAPER_LOSS = 0.059
"""Integral of the squared difference between a sharp edge and 3 e^2 - 2 e^3, over the edge's width."""

SMOOTH_SAMPLES = 150
"""Of phase and edge over half of a footprint."""


@dataclass(frozen=True, eq=False)
class Ways:
    """Interpolation from a coarse grid to a part of a fine one: of the field, and of what is smooth.

    Attributes
    ----------
    field : (Weights, Weights)
        Along y and x, in float32.
    first, share : two ndarrays each
        First of four samples and their shares, along y and x, on the grid of what is smooth.
    """

    field: tuple[Weights, Weights]
    first: tuple[NDArray[np.int64], NDArray[np.int64]]
    share: tuple[Array, Array]


def ways_between(
    coarse: tuple[Array, Array], smooth: tuple[Array, Array], fine: tuple[Array, Array], kernel: Kernel
) -> Ways:
    """Weights from axes (y, x) of two coarse grids to those of a fine one."""
    field = [interpolation(c, f, kernel).astype(np.float32) for c, f in zip(coarse, fine, strict=True)]
    cubic = [_cubic(s, f) for s, f in zip(smooth, fine, strict=True)]
    return Ways((field[0], field[1]), (cubic[0][0], cubic[1][0]), (cubic[0][1], cubic[1][1]))


def _cubic(coarse: Array, fine: Array) -> tuple[NDArray[np.int64], Array]:
    """First of four samples for each fine one, and Lagrange's weights of them."""
    place = (fine - coarse[0]) / (coarse[1] - coarse[0])
    first = np.clip(np.floor(place).astype(np.int64) - 1, 0, len(coarse) - 4)
    t = place - first - 1.0
    shares = [-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -(t + 1) * t * (t - 2) / 2]
    return first, np.stack([*shares, (t + 1) * t * (t - 1) / 6], axis=-1)


@dataclass(frozen=True, eq=False)
class Carried:
    """One step from a coarse grid to a window of a fine one, with its carrier.

    Attributes
    ----------
    ways : Ways
    turns : ndarray
        Phase of the carrier over 2 pi, on the smooth grid.
    edge : ndarray of float32
        0 where the aperture is dark, from 1 on where it is open, on the smooth grid.
    window : (slice, slice)
        Of the fine grid.
    """

    ways: Ways
    turns: Array
    edge: NDArray[np.float32]
    window: tuple[slice, slice]

    def add(
        self, coarse: NDArray, fine: NDArray, rows: tuple[float, float] = (0.0, 1.0), first_row: int = 0
    ) -> None:
        """Add a coarse field to a fine one.

        Parameters
        ----------
        coarse, fine
            The fields.
        rows
            From one share of the window's rows to another.
        first_row
            Of the fine grid, where `fine` holds some of its rows.
        """
        inside, across = self.window
        start, stop = max(inside.start, first_row), min(inside.stop, first_row + fine.shape[0])
        if start >= stop:
            return
        part, w = fine[start - first_row : stop - first_row, across], self._ways_of(start, stop)
        along_y, along_x = w.field
        begin, end = (round(share * part.shape[0]) for share in rows)
        expander(along_y.weight.shape[1])(
            coarse,
            along_y.first,
            along_y.weight,
            along_x.first,
            along_x.weight,
            self.turns,
            self.edge,
            w.first[0],
            w.share[0],
            w.first[1],
            w.share[1],
            part,
            begin,
            end,
        )

    def _ways_of(self, start: int, stop: int) -> Ways:
        """To some of the fine grid's rows."""
        w, rows = self.ways, slice(start - self.window[0].start, stop - self.window[0].start)
        along_y = replace(w.field[0], first=w.field[0].first[rows], weight=w.field[0].weight[rows])
        first, share = (w.first[0][rows], w.first[1]), (w.share[0][rows], w.share[1])
        return Ways((along_y, w.field[1]), first, share)

    def collect_rows(self, fine: NDArray, middle: NDArray, rows: tuple[float, float] = (0.0, 1.0)) -> None:
        """Fine rows onto coarse columns, without the carrier: the first half of the conjugate transpose."""
        part, w = fine[self.window], self.ways
        begin, end = (round(share * part.shape[0]) for share in rows)
        along_x = w.field[1]
        collector(along_x.weight.shape[1])(
            part,
            self.turns,
            self.edge,
            w.first[0],
            w.share[0],
            w.first[1],
            w.share[1],
            along_x.first,
            along_x.weight,
            middle,
            begin,
            end,
        )

    def collect_columns(
        self, middle: NDArray, coarse: NDArray, columns: tuple[float, float] = (0.0, 1.0)
    ) -> None:
        """Rows of the first half onto coarse rows: the second half."""
        begin, end = (round(share * coarse.shape[1]) for share in columns)
        along_y = self.ways.field[0]
        collect_along_y(middle, along_y.first, along_y.weight, coarse, begin, end)

    @property
    def shapes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Of the array between both halves, and of the coarse one."""
        along_y, along_x = self.ways.field
        return (len(along_y.first), along_x.coarse), (along_y.coarse, along_x.coarse)


@dataclass(frozen=True, eq=False)
class FieldSettings:
    """What all tiles of a field have in common.

    Attributes
    ----------
    scene : Scene
    axes : (y, x)
        Of the plane, in mm.
    maps : FieldMaps
    factors : FieldFactors
    kernel : Kernel
    precision : Precision
    """

    scene: Scene
    axes: tuple[Array, Array]
    maps: FieldMaps
    factors: FieldFactors
    kernel: Kernel
    precision: Precision

    def steps_mm(self, reach_mm: Array) -> Array:
        """Sample spacings that hold the light of points within a reach (y, x) without their carrier."""
        band = self.scene.wavenumber_per_mm * (reach_mm @ self.maps.slopes_per_mm)
        return np.asarray(math.pi / (OVERSAMPLING * BAND_MARGIN * band))

    @property
    def half_width_mm(self) -> Array:
        """Of every footprint, its margin included."""
        return self.maps.carriers.half_width

    @property
    def tile_steps_mm(self) -> Array:
        """Sample spacings of a tile's own grid."""
        return self.steps_mm(np.max(np.abs(self.factors.spans_mm), axis=1))


class SuperTile:
    """Some neighbouring tiles, and the coarse grid on which they are summed.

    Parameters
    ----------
    settings
        Of the field.
    tiles
        Its tiles.
    """

    def __init__(self, settings: FieldSettings, tiles: tuple[Tile, ...]) -> None:
        self.settings, self.tiles = settings, tiles
        self.part = _around([tile.part for tile in tiles])
        centres = np.array([t.centre_mm[::-1] for t in tiles])
        middle = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
        self.carrier: SmoothMap = settings.maps.carriers.at((float(middle[0]), float(middle[1])))
        reach = np.max(np.abs(centres - middle), axis=0) + np.max(np.abs(settings.factors.spans_mm), axis=1)
        self.steps_mm = settings.steps_mm(reach)
        others = np.array([settings.maps.carriers.middle((float(y), float(x))) for y, x in centres])
        low = others.min(axis=0) - settings.half_width_mm
        high = others.max(axis=0) + settings.half_width_mm
        self.window = window_between(settings.axes, low, high)
        self.empty = any(w.stop - w.start < 1 for w in self.window)
        if self.empty:
            return
        fine = tuple(a[w] for a, w in zip(settings.axes, self.window, strict=True))
        self.axes = tuple(
            coarse_axis(f, float(h), settings.kernel) for f, h in zip(fine, self.steps_mm, strict=True)
        )
        smooth = tuple(_smooth_axis(f, settings) for f in fine)
        values = self.carrier.on_axes(smooth)
        turns = values[0] / (1e-3 * settings.scene.wavelength_um)
        shift = float(np.max(np.abs(others - self.carrier.middle) / settings.half_width_mm))
        opening = ((1.0 + shift) * REACH) ** 2 + 0.1 - values[4]
        ways = ways_between(
            (self.axes[0], self.axes[1]), (smooth[0], smooth[1]), (fine[0], fine[1]), settings.kernel
        )
        # Whole wherever a tile has light; beyond, rows end.
        self.carried = Carried(ways, turns, (1e3 * opening).astype(np.float32), self.window)

    @property
    def shape(self) -> tuple[int, int]:
        """Of its grid."""
        return len(self.axes[0]), len(self.axes[1])

    def within(self, tile: Tile) -> tuple[slice, slice]:
        """Where a tile's samples lie among those of `part`."""
        rows, columns = (
            slice(p.start - w.start, p.stop - w.start) for p, w in zip(tile.part, self.part, strict=True)
        )
        return rows, columns

    @property
    def tile_shape(self) -> tuple[int, int]:
        """Of the own grid of one of its tiles, at most."""
        ends = zip(self.settings.half_width_mm, self.settings.tile_steps_mm, strict=True)
        rows, columns = (math.ceil(2.0 * h / s) + self.settings.kernel.taps + 1 for h, s in ends)
        return rows, columns


def _around(parts: Sequence[tuple[slice, ...]]) -> tuple[slice, slice]:
    """The smallest rectangle of samples that holds some others."""
    rows, columns = (
        slice(min(p.start for p in along), max(p.stop for p in along)) for along in zip(*parts, strict=True)
    )
    return rows, columns


def window_between(axes: Sequence[Array], low: Array, high: Array) -> tuple[slice, slice]:
    """Samples of two axes (y, x) between two points."""
    rows, columns = (
        slice(int(np.searchsorted(a, b)), int(np.searchsorted(a, h, side="right")))
        for a, b, h in zip(axes, low, high, strict=True)
    )
    return rows, columns


def _smooth_axis(fine: Array, settings: FieldSettings) -> Array:
    """Samples between which phase and edge are cubic."""
    step = float(np.max(settings.half_width_mm)) / SMOOTH_SAMPLES
    count = math.ceil((fine[-1] - fine[0]) / step) + 4
    return np.asarray(0.5 * (fine[0] + fine[-1]) + step * (np.arange(count) - 0.5 * (count - 1)))


class FieldTile:
    """One tile on its super-tile's grid.

    Parameters
    ----------
    group
        Its super-tile.
    tile
        Part of the object.
    """

    def __init__(self, group: SuperTile, tile: Tile) -> None:
        settings, scene = group.settings, group.settings.scene
        centre = (tile.centre_mm[1], tile.centre_mm[0])
        carrier = settings.maps.carriers.at(centre)
        low, high = carrier.middle - settings.half_width_mm, carrier.middle + settings.half_width_mm
        window = window_between(group.axes, low, high)
        fine = tuple(a[w] for a, w in zip(group.axes, window, strict=True))
        steps = settings.tile_steps_mm
        axes = tuple(coarse_axis(f, float(h), settings.kernel) for f, h in zip(fine, steps, strict=True))
        path, amplitude, py, px, edge = carrier.each_on_axes(axes)
        wavelength_mm = 1e-3 * scene.wavelength_um
        turns = (path - next(group.carrier.each_on_axes(axes))) / wavelength_mm
        turns += -0.25 - 0.25 * settings.maps.caustics
        # The edge's square of a share falls by 2 over half a footprint.
        per_mm = 2.0 / float(np.max(settings.half_width_mm))
        rise = per_mm * TAPER * float(np.max(group.steps_mm))
        opening = (0.5 + (1.0 - edge) / rise).astype(np.float32)
        ways = ways_between((axes[0], axes[1]), (axes[0], axes[1]), (fine[0], fine[1]), settings.kernel)
        self.carried = Carried(ways, turns, opening, window)
        limit = np.pi / (scene.wavenumber_per_mm * tile.pitch_mm)
        reach = per_mm * 0.5 * settings.kernel.taps * float(np.max(steps))
        self.needed = (edge < 1.0 + 0.5 * rise + reach) & (np.abs(py) <= limit) & (np.abs(px) <= limit)
        expansion = settings.factors.at(centre)
        self.tile_factors = expansion.tile_factors(list(tile.offsets_mm)).astype(np.complex64)
        assert expansion.sensor_factors is not None
        scale = (amplitude[self.needed] / wavelength_mm).astype(np.float32)
        self.weights = np.empty((expansion.rank, len(scale)), np.complex64)
        for r, factor in enumerate(expansion.sensor_factors.each_on_axes(axes)):
            self.weights[r] = scale * factor[self.needed]
        angles = scene.wavenumber_per_mm * tile.pitch_mm * np.stack([py[self.needed], px[self.needed]])
        self.precision = settings.precision
        self.angles = folded(angles, self.precision.dtype)

    def _plan(self, kind: int) -> Any:
        return fourier_plan(kind, self.angles, self.tile_factors.shape, self.precision, 1)

    def add(self, values: NDArray, result: NDArray) -> None:
        """Add the field of the tile's part of the object to the super-tile's grid."""
        if not np.any(self.needed):
            return
        modes = np.ascontiguousarray(self.tile_factors * values)
        spectrum = np.atleast_2d(self._plan(2).execute(modes if len(modes) > 1 else modes[0]))
        field = np.zeros(self.needed.shape, np.complex64)
        field[self.needed] = np.einsum("rn,rn->n", self.weights, spectrum)
        self.carried.add(field, result)

    def collect(self, values: NDArray) -> NDArray:
        """Conjugate transpose: from the super-tile's grid to the tile's part of the object."""
        if not np.any(self.needed):
            return np.zeros(self.tile_factors.shape[1:], np.complex64)
        between, coarse = (np.zeros(shape, np.complex64) for shape in self.carried.shapes)
        self.carried.collect_rows(values, between)
        self.carried.collect_columns(between, coarse)
        strength = self.weights.conj() * coarse[self.needed]
        strength = np.ascontiguousarray(strength if len(strength) > 1 else strength[0])
        modes = self._plan(1).execute(strength).reshape(self.tile_factors.shape)
        return np.asarray(np.sum(self.tile_factors.conj() * modes, axis=0))
