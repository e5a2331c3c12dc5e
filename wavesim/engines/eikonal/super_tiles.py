"""Tiles and super-tiles of a whole field: their positions on the plane, and their propagation to it.

The bandwidth of a tile's field without its carrier is proportional to the tile's width; the same holds for a
super-tile. A tile is therefore computed on its own coarse grid and interpolated to the super-tile's grid with
the difference of both carriers; a super-tile is interpolated to the plane with its own carrier.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.eikonal.plan import Tile, coarse_step_mm
from wavesim.engines.eikonal.ray_maps import REACH, MapsOverObject
from wavesim.engines.eikonal.residual import FactorsOverObject
from wavesim.fields.carrier_interpolation import (
    CarrierInterpolation,
    interpolation_weights,
)
from wavesim.fields.plane_waves import phasor_of
from wavesim.fields.resampling import Kernel, coarse_axis
from wavesim.rays.maps import MapOnAxes, SmoothMap
from wavesim.runtime.fourier.nonuniform import Precision, adjoint_of_terms, plan_of_terms, sum_of_terms
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Direction
from wavesim.scene.scene import Scene

TAPER = 3.0
"""Least width of the aperture's edge, in samples of a super-tile's grid."""

TAPER_LOSS = 0.059
"""Integral of the squared difference between a sharp edge and 3 e^2 - 2 e^3, over the edge's width."""


@dataclass(frozen=True, eq=False)
class SharedTileData:
    """Ray maps, residual and interpolation that all tiles of a hierarchy share.

    Attributes
    ----------
    scene : Scene
    axes : (y, x)
        Axes of the plane, in mm.
    maps : MapsOverObject
    softness : float
        Least width of the aperture's edge, in the squared relative distance from the centre to the edge.
    factors : FactorsOverObject
    kernel : Kernel
    precision : Precision
    """

    scene: Scene
    axes: tuple[Array, Array]
    maps: MapsOverObject
    softness: float
    factors: FactorsOverObject
    kernel: Kernel
    precision: Precision

    def steps_mm(self, reach_mm: Array, slopes_per_mm: Array) -> Array:
        """Return the sample spacings for the light of points within a reach (y, x), without their carrier."""
        return coarse_step_mm(self.scene.wavenumber_per_mm * (reach_mm @ slopes_per_mm))

    def rise_over(self, steps_mm: Array) -> float:
        """Return the width of the aperture's edge on grids of these steps, in squared relative distance."""
        # That square falls by 2 over half a footprint.
        drawn = 2.0 * TAPER * float(np.max(steps_mm)) / float(np.max(self.half_width_mm))
        return max(drawn, self.softness)

    @property
    def half_width_mm(self) -> Array:
        """Half-width of every footprint, including its margin."""
        return self.maps.carriers.half_width


class SuperTile:
    """Some neighbouring tiles, and the coarse grid on which they are summed.

    Parameters
    ----------
    shared
        Data that all tiles share.
    tiles
        Tiles of the super-tile.

    Attributes
    ----------
    steps_mm, tile_steps_mm : ndarray
        Sample spacings (y, x) of its grid, and of its tiles' own.
    """

    def __init__(self, shared: SharedTileData, tiles: tuple[Tile, ...]) -> None:
        self.shared, self.tiles = shared, tiles
        self.part = _around([tile.part for tile in tiles])
        centres = np.array([t.centre_mm[::-1] for t in tiles])
        middle = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
        self.carrier: SmoothMap = shared.maps.carriers.at((float(middle[0]), float(middle[1])))
        own_reach = np.max(np.abs(shared.factors.spans_mm), axis=1)
        slopes_per_mm = shared.maps.slopes_per_mm(centres)
        self.tile_steps_mm = shared.steps_mm(own_reach, slopes_per_mm)
        self.steps_mm = shared.steps_mm(np.max(np.abs(centres - middle), axis=0) + own_reach, slopes_per_mm)
        others = np.array([shared.maps.carriers.middle((float(y), float(x))) for y, x in centres])
        low = others.min(axis=0) - shared.half_width_mm
        high = others.max(axis=0) + shared.half_width_mm
        self.window = window_between(shared.axes, low, high)
        self.empty = any(w.stop - w.start < 1 for w in self.window)
        if self.empty:
            return
        fine = tuple(a[w] for a, w in zip(shared.axes, self.window, strict=True))
        self.axes = tuple(
            coarse_axis(f, float(h), shared.kernel) for f, h in zip(fine, self.steps_mm, strict=True)
        )
        smooth = tuple(_smooth_axis(f, shared) for f in fine)
        values = self.carrier.on_axes(smooth)
        phase_waves = values[0] / (1e-3 * shared.scene.wavelength_um)
        shift = float(np.max(np.abs(others - self.carrier.middle) / shared.half_width_mm))
        opening = ((1.0 + shift) * REACH) ** 2 + 0.1 - values[4]
        weights = interpolation_weights(
            (self.axes[0], self.axes[1]), (smooth[0], smooth[1]), (fine[0], fine[1]), shared.kernel
        )
        # The edge is open wherever a tile has light; rows end outside.
        self.interpolation = CarrierInterpolation(
            weights, phase_waves, (1e3 * opening).astype(np.float32), self.window
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the super-tile's grid."""
        return len(self.axes[0]), len(self.axes[1])

    def shape_of(self, direction: Direction) -> tuple[int, int]:
        """Return the shape of the result of a direction: of the grid, or of the part of the object."""
        height, width = (part.stop - part.start for part in self.part)
        return self.shape if direction == "forward" else (height, width)

    def within(self, tile: Tile) -> tuple[slice, slice]:
        """Return the position of a tile's samples within `part`."""
        rows, columns = (
            slice(p.start - w.start, p.stop - w.start) for p, w in zip(tile.part, self.part, strict=True)
        )
        return rows, columns

    @property
    def tile_shape(self) -> tuple[int, int]:
        """Largest shape of the own grid of one of its tiles."""
        ends = zip(self.shared.half_width_mm, self.tile_steps_mm, strict=True)
        rows, columns = (math.ceil(2.0 * h / s) + self.shared.kernel.taps + 1 for h, s in ends)
        return rows, columns


def _around(parts: Sequence[tuple[slice, ...]]) -> tuple[slice, slice]:
    """Return the smallest rectangle of samples that contains all parts."""
    rows, columns = (
        slice(min(p.start for p in along), max(p.stop for p in along)) for along in zip(*parts, strict=True)
    )
    return rows, columns


def window_between(axes: Sequence[Array], low: Array, high: Array) -> tuple[slice, slice]:
    """Return the samples of two axes (y, x) between two points."""
    rows, columns = (
        slice(int(np.searchsorted(a, b)), int(np.searchsorted(a, h, side="right")))
        for a, b, h in zip(axes, low, high, strict=True)
    )
    return rows, columns


def _smooth_axis(fine: Array, shared: SharedTileData) -> Array:
    """Return the samples between which phase and edge are interpolated by cubic polynomials."""
    # Number of samples of phase and edge over half of a footprint.
    smooth_samples = 150
    step = float(np.max(shared.half_width_mm)) / smooth_samples
    count = math.ceil((fine[-1] - fine[0]) / step) + 4
    return np.asarray(0.5 * (fine[0] + fine[-1]) + step * (np.arange(count) - 0.5 * (count - 1)))


class ObjectTile:
    """Propagation of one tile to its super-tile's grid.

    Parameters
    ----------
    group
        The super-tile.
    tile
        One of its tiles.
    cache
        Cache of transforms and weights that tiles of the same size share; extended by the object.
    """

    def __init__(self, group: SuperTile, tile: Tile, cache: dict[tuple[Any, ...], Any]) -> None:
        self._cache, shared = cache, group.shared
        centre, half_mm = (tile.centre_mm[1], tile.centre_mm[0]), shared.half_width_mm
        carrier = shared.maps.carriers.at(centre)
        window = window_between(group.axes, carrier.middle - half_mm, carrier.middle + half_mm)
        fine = group.axes[0][window[0]], group.axes[1][window[1]]
        y, x = (
            coarse_axis(f, float(h), shared.kernel) for f, h in zip(fine, group.tile_steps_mm, strict=True)
        )
        own = _terms(carrier, (y, x))
        path, amplitude, *cosines, edge = carrier.coefficients
        wavelength_mm = 1e-3 * shared.scene.wavelength_um
        path, py, px = MapOnAxes(np.stack([path, *cosines]), own).each()
        group_path = MapOnAxes(group.carrier.coefficients[:1], _terms(group.carrier, (y, x)))
        phase_waves = (path - next(group_path.each())) / wavelength_mm
        phase_waves += -0.25 - 0.25 * shared.maps.caustics
        amplitude, edge = MapOnAxes(np.stack([amplitude, edge]), own).single().each()
        rise = shared.rise_over(group.steps_mm)
        # Coarse axes are centred on fine ones, so that their relative position follows from the numbers of
        # samples. The number of coarse samples can differ by one for equal numbers of fine ones, by rounding.
        self._interpolation = CarrierInterpolation(
            self._cached(
                ("weights", len(fine[0]), len(fine[1]), len(y), len(x)),
                lambda: interpolation_weights((y, x), (y, x), fine, shared.kernel),
            ),
            phase_waves,
            0.5 + (1.0 - edge) / rise,
            window,
        )
        # Distance outside the edge that interpolation uses, in squared relative distance, which changes by 2
        # over half a footprint.
        reach = shared.kernel.taps * float(np.max(group.tile_steps_mm)) / float(np.max(half_mm))
        most = 0.5 * wavelength_mm / tile.pitch_mm
        needed = (edge < 1.0 + 0.5 * rise + reach) & (abs(py) <= most) & (abs(px) <= most)
        self._shape, self._places = needed.shape, np.flatnonzero(needed)
        expansion, offsets = shared.factors.at(centre), list(tile.offsets_mm)
        self._tile_factors = _exponential(expansion.shared_logarithm(offsets)) * self._cached(
            ("factors", *((len(o), round(1e9 * float(o[0]))) for o in offsets)),
            lambda: expansion.own_tile_factors(offsets).astype(np.complex64),
        )
        assert expansion.sensor_factors is not None
        factors = expansion.sensor_factors.coefficients
        parts = np.stack([factors.real, factors.imag], axis=1).reshape(-1, *factors.shape[1:])
        each = MapOnAxes(parts, _terms(expansion.sensor_factors, (y, x))).single().each()
        scale = self._needed(amplitude) * np.float32(1.0 / wavelength_mm)
        self._weights = np.empty((len(factors), len(scale)), dtype=np.complex64)
        for weight in self._weights:
            weight.real = scale * self._needed(next(each))
            weight.imag = scale * self._needed(next(each))
        self._precision = shared.precision
        per_mm, half = shared.scene.wavenumber_per_mm * tile.pitch_mm, np.float32(math.pi)
        angles = [(per_mm * self._needed(p)).astype(np.float32) for p in (py, px)]
        self._angles = [np.clip(angle, -half, half) for angle in angles]  # rounding may exceed half a turn

    def _cached(self, key: tuple[Any, ...], make: Callable[[], Any]) -> Any:
        if key not in self._cache:
            self._cache[key] = make()
        return self._cache[key]

    def _needed(self, values: Any) -> Any:
        return values.ravel().take(self._places)

    def _plan(self, kind: int) -> Any:
        shape = self._tile_factors.shape
        plan = self._cached((kind, *shape), lambda: plan_of_terms(kind, shape, self._precision))
        plan.setpts(*self._angles)
        return plan

    def add(self, values: Any, result: Any) -> None:
        """Add the field of the tile's part of the object to the super-tile's grid."""
        if not len(self._places):
            return
        field = np.zeros(self._shape, dtype=np.complex64)
        spectrum = sum_of_terms(self._plan(2), values, self._tile_factors, self._weights)
        field.ravel()[self._places] = spectrum
        self._interpolation.add(field, result)

    def collect(self, values: Any) -> Any:
        """Apply the conjugate transpose: from the super-tile's grid to the tile's part of the object."""
        if not len(self._places):
            return np.zeros(self._tile_factors.shape[1:], dtype=np.complex64)
        strength = self._needed(self._interpolation.collect(values))
        return adjoint_of_terms(self._plan(1), strength, self._tile_factors, self._weights)


def _terms(smooth: SmoothMap, axes: tuple[Array, Array]) -> tuple[NDArray, ...]:
    """Return the terms of a map along two axes, C-contiguous for fast matrix products."""
    return tuple(map(np.ascontiguousarray, smooth.along(axes).terms))


def _exponential(logarithm: NDArray[np.complex128]) -> NDArray[np.complex64]:
    """Return the exponential of a logarithm, from its parts: four times as fast as NumPy's complex one."""
    size = np.exp(logarithm.real.astype(np.float32))
    return np.asarray(phasor_of(logarithm.imag, np.complex64) * size)


def propagate_tiles(
    direction: Direction, group: SuperTile, values: NDArray, threads: int
) -> NDArray[np.complex64]:
    """Propagate one super-tile.

    Parameters
    ----------
    direction
        Forward or adjoint.
    group
        The super-tile.
    values
        Field on `group.part` of the object, or on its own grid.
    threads
        Threads that share the tiles.

    Returns
    -------
    ndarray of complex64
        Field on its own grid, or on `group.part`, where it is 0 outside the tiles.
    """
    shape = group.shape_of(direction)
    parts = np.zeros(shape, np.complex64)

    def one_thread(thread: int) -> NDArray[np.complex64]:
        # The fields of tiles overlap in the forward direction; their parts of the object do not.
        result = np.zeros(shape, np.complex64) if direction == "forward" else parts
        cache: dict[tuple[Any, ...], Any] = {}
        for one in group.tiles[thread::threads]:
            tile, position = ObjectTile(group, one, cache), group.within(one)
            if direction == "forward":
                tile.add(values[position], result)
            else:
                result[position] = tile.collect(values)
        return result

    with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
        first, *others = pool.map(one_thread, range(threads))
    for other in others if direction == "forward" else ():
        first += other
    return first
