"""Super-tiles and their tiles on a device: the work of the compiled loops, written for an array module alone.

Interpolation is a product with matrices of few values in each row; they are kept as dense blocks along the
diagonal, since graphics processors are quickest at matrix products. Carriers are made block by block of rows,
as :mod:`wavesim.engines.whole_field.kernel` makes them, with phases in float64. A tile's polynomials are
evaluated on the device too: what is left for this computer are a few small arrays for each tile, which its
threads get ready while the device works.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from wavesim.engines.tiles.operator import Tile
from wavesim.engines.whole_field.on_cpu import Way
from wavesim.engines.whole_field.tiles import TAPER, Carried, SuperTile, Ways, ways_between, window_between
from wavesim.fields.resampling import Weights, coarse_axis
from wavesim.rays.maps import SmoothMap
from wavesim.runtime.blas import one_blas_thread
from wavesim.runtime.device import Device
from wavesim.runtime.threads import THREADS

Array = NDArray[np.float64]
Axes = tuple[Array, Array]

MOST_ROWS, LEAST_ROWS = 512, 16
"""Of a block."""

SAMPLE_BYTES = 64
"""That a sample of a row block takes while its carrier is made."""

AHEAD = 2
"""Tiles made ready before the device asks for them, for each thread."""


def carry_on(device: Device, way: Way, group: SuperTile, values: NDArray) -> NDArray[np.complex64]:
    """Do one super-tile's task on a device, as :func:`wavesim.engines.whole_field.on_cpu.carry` does it here.

    Parameters
    ----------
    device
        Which one.
    way
        Forward or adjoint.
    group
        The super-tile.
    values
        On `group.part` of the object, or on its own grid; in this computer's memory.

    Returns
    -------
    ndarray of complex64
        On its own grid, or on `group.part`, in this computer's memory.
    """
    given = device.to_device(values, np.complex64)
    height, width = (part.stop - part.start for part in group.part)
    result = device.xp.zeros(group.shape if way == "forward" else (height, width), dtype=np.complex64)
    plans: dict[tuple[int, ...], Any] = {}
    for frame in _frames(group):
        tile, place = DeviceTile(device, frame, plans), group.within(frame.tile)
        if way == "forward":
            tile.add(given[place], result)
        else:
            result[place] = tile.collect(given)
    return device.to_host(result)


def add_on(device: Device, carried: Carried, total: NDArray, plane: Any, first_row: int = 0) -> None:
    """Add a super-tile's field to rows of the plane, as
    :meth:`wavesim.engines.whole_field.tiles.Carried.add`.

    `total` lies in this computer's memory, `plane` in the device's.
    """
    _step(device, carried).add(device.to_device(total, np.complex64), plane, first_row)


def collect_on(device: Device, carried: Carried, plane: Any) -> NDArray[np.complex64]:
    """Conjugate transpose of :func:`add_on`: a super-tile's field from a plane in either memory."""
    return device.to_host(_step(device, carried).collect(plane))


def _step(device: Device, carried: Carried) -> DeviceStep:
    turns, edge = (device.to_device(values) for values in (carried.turns, carried.edge))
    return DeviceStep(device, carried.ways, turns, edge, carried.window)


@dataclass(frozen=True, eq=False)
class Blocks:
    """A matrix whose rows hold a few values beside each other, in dense blocks of rows on a device.

    Attributes
    ----------
    device : Device
    parts : tuple of (slice, slice, array)
        Rows, the columns that they need, and the block.
    shape : (int, int)
    """

    device: Device
    parts: tuple[tuple[slice, slice, Any], ...]
    shape: tuple[int, int]

    def times(self, values: Any) -> Any:
        """Product with an array of shape (columns, n)."""
        result = self.device.xp.empty((self.shape[0], values.shape[1]), dtype=values.dtype)
        for rows, columns, block in self.parts:
            result[rows] = product(block, values[columns])
        return result

    def transposed_times(self, values: Any) -> Any:
        """Product of the transpose with an array of shape (rows, n)."""
        result = self.device.xp.zeros((self.shape[1], values.shape[1]), dtype=values.dtype)
        for rows, columns, block in self.parts:
            result[columns] += product(block.T, values[rows])
        return result


def blocks_of(device: Device, weights: Weights, rows: int) -> Blocks:
    """Interpolation along one axis as blocks of so many rows."""
    parts = []
    count, taps = weights.weight.shape
    for start in range(0, count, rows):
        first, weight = weights.first[start : start + rows], weights.weight[start : start + rows]
        low, high = int(first.min()), int(first.max()) + taps
        block = np.zeros((len(first), high - low), weight.dtype)
        block[np.arange(len(first))[:, None], first[:, None] - low + np.arange(taps)] = weight
        parts.append((slice(start, start + len(first)), slice(low, high), device.to_device(block)))
    return Blocks(device, tuple(parts), (count, weights.coarse))


def product(block: Any, values: Any) -> Any:
    """Of a real matrix and C-contiguous values, which may be complex: no half of it is spent on zeros."""
    if values.dtype.kind != "c":
        return block @ values
    return (block @ values.view(block.dtype)).view(values.dtype)


class DeviceStep:
    """One step from a coarse grid to a window of a fine one, with its carrier, on a device.

    Parameters
    ----------
    device
        Which one.
    ways
        Interpolation along both axes.
    turns, edge
        Of the carrier on the smooth grid, as of :class:`wavesim.engines.whole_field.tiles.Carried`; on the
        device.
    window
        Of the fine grid.
    """

    def __init__(
        self, device: Device, ways: Ways, turns: Any, edge: Any, window: tuple[slice, slice]
    ) -> None:
        self.device, self.window = device, window
        width = window[1].stop - window[1].start
        rows = int(np.clip(device.memory_bytes // (SAMPLE_BYTES * width), LEAST_ROWS, MOST_ROWS))
        self.along_y, self.along_x = (blocks_of(device, way, rows) for way in ways.field)
        cubic = [
            Weights(first, share, count)
            for first, share, count in zip(ways.first, ways.share, turns.shape, strict=True)
        ]
        self.smooth_y, across = (blocks_of(device, way, rows) for way in cubic)
        self.turns, self.edge = (self._swapped(across.times(self._swapped(v))) for v in (turns, edge))

    def _swapped(self, values: Any) -> Any:
        return self.device.xp.ascontiguousarray(values.T)

    def _carrier(self, number: int, rows: slice) -> Any:
        """exp(2 pi i turns) times 3 e^2 - 2 e^3 of the edge, for some rows of a block."""
        xp, (_, smooth, shares) = self.device.xp, self.smooth_y.parts[number]
        turns = shares[rows] @ self.turns[smooth]
        turns -= xp.floor(turns + 0.5)
        angle = (2.0 * math.pi * turns).astype(np.float32)
        edge = xp.clip((shares[rows] @ self.edge[smooth]).astype(np.float32), 0.0, 1.0)
        passed = edge * edge * (3.0 - 2.0 * edge)
        carrier = xp.empty(angle.shape, dtype=np.complex64)
        carrier.real = passed * xp.cos(angle)
        carrier.imag = passed * xp.sin(angle)
        return carrier

    def add(self, coarse: Any, fine: Any, first_row: int = 0) -> None:
        """Add a coarse field to a fine one, or to its rows from `first_row` on."""
        middle = self._swapped(self.along_x.times(self._swapped(coarse)))
        top, end = self.window[0].start, first_row + fine.shape[0]
        for number, (rows, columns, block) in enumerate(self.along_y.parts):
            start, stop = max(top + rows.start, first_row), min(top + rows.stop, end)
            if start < stop:
                own = slice(start - top - rows.start, stop - top - rows.start)
                band = product(block[own], middle[columns])
                band *= self._carrier(number, own)
                fine[start - first_row : stop - first_row, self.window[1]] += band

    def collect(self, fine: Any) -> Any:
        """Conjugate transpose: the coarse field, on the device, of a fine one in either memory."""
        xp, (inside, across) = self.device.xp, self.window
        shape = self.along_y.shape[1], across.stop - across.start
        middle = xp.zeros(shape, dtype=np.complex64)
        for number, (rows, columns, block) in enumerate(self.along_y.parts):
            own = slice(inside.start + rows.start, inside.start + rows.stop)
            band = self._carrier(number, slice(None)).conj()
            band *= xp.asarray(fine[own, across])
            middle[columns] += product(block.T, band)
        return self._swapped(self.along_x.transposed_times(self._swapped(middle)))


@dataclass(frozen=True, eq=False)
class MapOnAxes:
    """Polynomials, and their terms along the axes of a grid: all that their values there follow from."""

    coefficients: NDArray
    along_y: Array
    along_x: Array

    def on(self, device: Device) -> Iterator[Any]:
        """Values of one function after the other, shape (ny, nx), on a device."""
        y, x = device.to_device(self.along_y), device.to_device(self.along_x.T)
        for coefficients in device.to_device(self.coefficients):
            yield y @ coefficients @ x


def _map_on_axes(smooth: SmoothMap, axes: Axes, functions: slice = slice(None)) -> MapOnAxes:
    order = smooth.coefficients.shape[1] - 1
    along_y, along_x = (
        chebyshev.chebvander((axis - middle) / half, order)
        for axis, middle, half in zip(axes, smooth.middle, smooth.half_width, strict=True)
    )
    return MapOnAxes(smooth.coefficients[functions], along_y, along_x)


@dataclass(frozen=True, eq=False)
class TileFrame:
    """A tile as far as this computer makes it ready; small arrays only.

    Attributes
    ----------
    group : SuperTile
    tile : Tile
    window : (slice, slice)
        Of the super-tile's grid.
    ways : Ways
        From the tile's own grid.
    carrier, shared, factors : MapOnAxes
        On its own grid: the tile's carrier, the super-tile's path, and sensor factors.
    tile_factors : ndarray of complex64
    taper : float
        Over which the edge's square of a share rises.
    reach : float
        By which interpolation looks beyond the edge, in the same measure.
    """

    group: SuperTile
    tile: Tile
    window: tuple[slice, slice]
    ways: Ways
    carrier: MapOnAxes
    shared: MapOnAxes
    factors: MapOnAxes
    tile_factors: NDArray[np.complex64]
    taper: float
    reach: float


def tile_frame(group: SuperTile, tile: Tile) -> TileFrame:
    """The part of :class:`wavesim.engines.whole_field.tiles.FieldTile` that needs no device."""
    settings = group.settings
    centre, half_mm = (tile.centre_mm[1], tile.centre_mm[0]), settings.half_width_mm
    carrier = settings.maps.carriers.at(centre)
    window = window_between(group.axes, carrier.middle - half_mm, carrier.middle + half_mm)
    fine = group.axes[0][window[0]], group.axes[1][window[1]]
    steps = settings.tile_steps_mm
    y, x = (coarse_axis(f, float(h), settings.kernel) for f, h in zip(fine, steps, strict=True))
    expansion = settings.factors.at(centre)
    assert expansion.sensor_factors is not None
    per_mm = 2.0 / float(np.max(half_mm))
    return TileFrame(
        group,
        tile,
        window,
        ways_between((y, x), (y, x), fine, settings.kernel),
        _map_on_axes(carrier, (y, x)),
        _map_on_axes(group.carrier, (y, x), slice(1)),
        _map_on_axes(expansion.sensor_factors, (y, x)),
        expansion.tile_factors(list(tile.offsets_mm)).astype(np.complex64),
        per_mm * TAPER * float(np.max(group.steps_mm)),
        per_mm * 0.5 * settings.kernel.taps * float(np.max(steps)),
    )


def _frames(group: SuperTile) -> Iterator[TileFrame]:
    """Tiles in their order, made ready by threads ahead of their use."""
    waiting, ready = iter(group.tiles), deque[Future[TileFrame]]()
    with one_blas_thread(), ThreadPoolExecutor(THREADS) as pool:
        while True:
            room = AHEAD * THREADS - len(ready)
            ready.extend(pool.submit(tile_frame, group, tile) for tile in islice(waiting, room))
            if not ready:
                return
            yield ready.popleft().result()


class DeviceTile:
    """One tile on its super-tile's grid, on a device; the same as
    :class:`wavesim.engines.whole_field.tiles.FieldTile`.

    Parameters
    ----------
    device
        Which one.
    frame
        The tile.
    plans
        Transforms of tiles of the same shape, for use again; added to.
    """

    def __init__(self, device: Device, frame: TileFrame, plans: dict[tuple[int, ...], Any]) -> None:
        self.device, self._plans, xp = device, plans, device.xp
        settings, scene = frame.group.settings, frame.group.settings.scene
        wavelength_mm = 1e-3 * scene.wavelength_um
        path, amplitude, py, px, edge = frame.carrier.on(device)
        turns = (path - next(frame.shared.on(device))) / wavelength_mm
        turns += -0.25 - 0.25 * settings.maps.caustics
        opening = (0.5 + (1.0 - edge) / frame.taper).astype(np.float32)
        self.step = DeviceStep(device, frame.ways, turns, opening, frame.window)
        limit = math.pi / (scene.wavenumber_per_mm * frame.tile.pitch_mm)
        needed = edge < 1.0 + 0.5 * frame.taper + frame.reach
        needed = needed & (abs(py) <= limit) & (abs(px) <= limit)
        self.shape = needed.shape
        self.places = xp.flatnonzero(needed)
        self.tile_factors = device.to_device(frame.tile_factors)
        scale = self._needed(amplitude / wavelength_mm).astype(np.float32)
        self.weights = xp.empty((len(frame.tile_factors), len(scale)), dtype=np.complex64)
        for number, factor in enumerate(frame.factors.on(device)):
            self.weights[number] = scale * self._needed(factor)
        self.precision = settings.precision
        per_turn = scene.wavenumber_per_mm * frame.tile.pitch_mm
        self.angles = [self._folded(per_turn * self._needed(cosine)) for cosine in (py, px)]

    def _needed(self, values: Any) -> Any:
        return values.ravel()[self.places]

    def _folded(self, angle: Any) -> Any:
        """Within half a turn, folded in float64."""
        return (self.device.xp.remainder(angle + math.pi, 2.0 * math.pi) - math.pi).astype(np.float32)

    def _plan(self, kind: int) -> Any:
        key = (kind, *self.tile_factors.shape)
        if key not in self._plans:
            self._plans[key] = self.device.plan(kind, self.tile_factors.shape, self.precision)
        self._plans[key].setpts(*self.angles)
        return self._plans[key]

    def add(self, values: Any, result: Any) -> None:
        """Add the field of the tile's part of the object to the super-tile's grid."""
        xp = self.device.xp
        if not len(self.places):
            return
        modes = xp.ascontiguousarray(self.tile_factors * values)
        spectrum = self._plan(2).execute(modes if len(modes) > 1 else modes[0])
        field = xp.zeros(self.shape, dtype=np.complex64)
        field.ravel()[self.places] = (self.weights * spectrum).sum(axis=0)
        self.step.add(field, result)

    def collect(self, values: Any) -> Any:
        """Conjugate transpose: from the super-tile's grid to the tile's part of the object."""
        xp = self.device.xp
        if not len(self.places):
            return xp.zeros(self.tile_factors.shape[1:], dtype=np.complex64)
        strength = self.weights.conj() * self._needed(self.step.collect(values))
        strength = xp.ascontiguousarray(strength if len(strength) > 1 else strength[0])
        modes = self._plan(1).execute(strength).reshape(self.tile_factors.shape)
        return (self.tile_factors.conj() * modes).sum(axis=0)
