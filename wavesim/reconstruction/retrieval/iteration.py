"""An iteration of Appendix A in a few passes over memory.

At the size of a sensor, memory access takes more time than arithmetic. Fourier transforms are therefore
taken axis by axis. All work between two transforms along the same axis is done on a block of rows, or a
panel of columns, while it is in the processor's cache. One pass along columns applies the carriers and their
inverses. One pass along rows replaces the amplitudes. One pass along rows does A4, the mean over planes, A5,
and the first transform of the next iteration. A plane at distance 0 takes part only in the last of these
passes.

Sums over blocks are added in a fixed order, so that results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import TransferFunction
from wavesim.reconstruction.retrieval import kernel
from wavesim.runtime.fourier.lanes import LANES
from wavesim.runtime.fourier.panels import Panels, aligned, thread_buffer, transform_bytes

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
Sums = tuple[float, ...]
T = TypeVar("T")

BLOCK_BYTES = 2**20
"""Size of a block of rows, about a core's second-level cache. Blocks hold a multiple of `LANES` rows."""


@dataclass(frozen=True, eq=False)
class Plane:
    """Measured amplitudes of a plane and working memory; arrays have the shape (rows, columns).

    Attributes
    ----------
    amplitude : ndarray
        Measured amplitudes.
    known : ndarray of bool or None
        Pixels with valid data; None where all are valid.
    carrier : ndarray or None
        Transfer function to the plane over the number of samples, in panels, for frequencies that are not
        negative down the columns: shape (panels, rows // 2 + 1, 2, 16). None where the plane is the one
        sought.
    spectrum_panels : Panels or None
        Spectrum of the field along rows, or along both axes, during propagation; None where there is no
        carrier.
    """

    amplitude: Array
    known: NDArray[np.bool_] | None
    carrier: Array | None
    spectrum_panels: Panels | None

    @cached_property
    def power(self) -> float:
        """Sum of the squared amplitudes."""
        return math.fsum(float(np.sum(np.square(row, dtype=float))) for row in self.amplitude)


@dataclass(frozen=True)
class Block:
    """A block of rows, also with one neighbouring row on either side where there is one."""

    rows: slice
    extended: slice


@dataclass(frozen=True)
class AmplitudeMatch:
    """Agreement of a field's moduli with the amplitudes of a plane.

    Attributes
    ----------
    correlation : float
        Correlation A6; 0 where either amplitude is constant.
    residual : float
        L2 norm of the difference over that of the measured amplitude.
    """

    correlation: float
    residual: float


def rows_of(values: NDArray[Any]) -> NDArray[Any]:
    """Return samples as rows and columns; those of a line are one row."""
    return np.ascontiguousarray(values).reshape(-1, values.shape[-1])


def rows_of_block(shape: tuple[int, ...], value_bytes: int, with_neighbours: bool = False) -> int:
    """Return the number of rows of a block, given the bytes of one value.

    If `with_neighbours` is set, a row on either side is included in the size of the block.
    """
    size = max(BLOCK_BYTES // (value_bytes * shape[-1]) // LANES, 1) * LANES
    return max(size, 2 * LANES) - 2 if with_neighbours else size


def bytes_at_work(shape: tuple[int, int], dtype: DTypeLike) -> int:
    """Return the bytes of each thread: three blocks of rows, a panel of a spectrum, and transforms."""
    item = np.dtype(dtype).itemsize
    block = rows_of_block(shape, item, with_neighbours=True) + 2
    return (3 * block * shape[1] + LANES * shape[0]) * item + transform_bytes(shape, dtype)


def plane_for(
    grid: Grid,
    wavelength_um: float,
    distance_mm: float,
    amplitude: Array,
    known: NDArray[np.bool_] | None,
    dtype: Any,
) -> Plane:
    """Return a plane with working memory for fields of a complex type; the distance is from the plane
    sought.
    """
    propagator = TransferFunction(grid, wavelength_um, distance_mm, dtype)
    carrier = None if propagator.is_identity else _carrier_panels(propagator, grid.shape[-1])
    recorded = rows_of(amplitude).astype(np.zeros(0, dtype).real.dtype, copy=False)
    spectrum_panels = None if carrier is None else Panels(recorded.shape, dtype)
    return Plane(recorded, None if known is None else rows_of(known), carrier, spectrum_panels)


def _carrier_panels(propagator: TransferFunction, columns: int) -> Array:
    """Return a transfer function in panels, divided by the number of samples for unnormalized transforms."""
    count = -(-columns // LANES)
    factors = aligned((count, len(propagator.factor), 2, LANES), propagator.factor.dtype)
    factors[-1] = 0.0
    for index in range(count):
        panel_columns = propagator.columns[index * LANES : (index + 1) * LANES]
        part = propagator.factor[:, panel_columns] * factors.dtype.type(
            1.0 / (len(propagator.rows) * columns)
        )
        factors[index, :, 0, : len(panel_columns)], factors[index, :, 1, : len(panel_columns)] = (
            part.real,
            part.imag,
        )
    return factors


@dataclass(frozen=True, eq=False)
class Passes:
    """The passes of an iteration over planes.

    Fields have the shape (rows, columns) and are C-contiguous.

    Attributes
    ----------
    planes : sequence of Plane
        Planes, at most one of them without a carrier if there are several.
    pool : ThreadPoolExecutor
        Threads that process the blocks.
    """

    planes: Sequence[Plane]
    pool: ThreadPoolExecutor

    def start(self, now: ComplexArray) -> None:
        """Store the transform along rows of the field sought, for the first iteration."""
        if self._carried:
            self._map_blocks(lambda block: self._store_transform(now[block.rows], block), self._blocks())

    def propagate(self) -> None:
        """Propagate the field stored by :meth:`start` or :meth:`step` to all planes, except for transforms
        along rows.
        """
        carried = [_panels(plane) for plane in self._carried]

        def one(index: int) -> None:
            first_carried = carried[0]
            spectrum = thread_buffer("spectrum", first_carried.values[index].shape, first_carried.dtype)
            first_carried.along_columns(first_carried.values[index], spectrum, inverse=False)
            for plane, panels in zip(self._carried, carried, strict=True):
                _apply_carrier(spectrum, plane, index, False)
                panels.along_columns(panels.values[index], panels.values[index], inverse=True)

        if carried:
            self._map_blocks(one, range(len(carried[0].values)))

    def match(self, now: ComplexArray, plane: Plane) -> tuple[AmplitudeMatch, ComplexArray]:
        """Return the agreement with a plane after :meth:`propagate`, and the field on it."""
        field_on_plane = now if plane.carrier is None else np.empty_like(now)

        def one(block: Block) -> Sums:
            if plane.carrier is not None:
                self._field(plane, block.rows, field_on_plane[block.rows])
            return _compare(field_on_plane[block.rows], plane, block)

        return _match_of(self._map_blocks(one, self._blocks())), field_on_plane

    def step(
        self, now: ComplexArray, previous: ComplexArray, weights: tuple[float, float, float], tv_step: float
    ) -> AmplitudeMatch:
        """Do one iteration; its result overwrites `previous`.

        Parameters
        ----------
        now
            The field sought. Its transform was stored by :meth:`start` or by the last step.
        previous
            Field of the iteration before.
        weights
            Weight of the mean over planes, and weights of `now` and `previous`, which are subtracted.
        tv_step
            Step t of A4.
        """
        self.propagate()
        sums_of_first: list[Sums] = []
        powers = []
        for plane in self.planes:
            if plane.carrier is None:
                powers.append(self._replaced_power(now, plane))
                continue
            sums = self._replace_amplitudes(plane, is_compared=plane is self.planes[0])
            sums_of_first = sums if plane is self.planes[0] else sums_of_first
            powers.append(self._propagate_back(plane))
        least = float(np.finfo(now.dtype).tiny)
        # Fraction of the root mean square that is added to each modulus by which A4 divides.
        floor = 1e-6
        floors = [floor * math.sqrt(power / now.size) + least for power in powers]
        last = self._feed_back(now, previous, weights, tv_step, floors)
        return _match_of(sums_of_first or last)

    @property
    def _carried(self) -> list[Plane]:
        """Planes with carriers; the first one's panels store the transform at the end of an iteration."""
        return [plane for plane in self.planes if plane.carrier is not None]

    def _blocks(self, with_neighbours: bool = False) -> list[Block]:
        """Return the blocks of rows."""
        amplitude = self.planes[0].amplitude
        rows, size = len(amplitude), rows_of_block(amplitude.shape, 2 * amplitude.itemsize, with_neighbours)
        cuts = [*range(0, rows, size), rows]
        return [
            Block(slice(start, stop), slice(max(start - 1, 0), min(stop + 1, rows)))
            for start, stop in pairwise(cuts)
        ]

    def _map_blocks(self, work: Callable[[Any], T], parts: Sequence[Any]) -> list[T]:
        """Return the results for all blocks of rows, or panel indices, in their order."""
        if len(parts) == 1:
            return [work(parts[0])]
        return list(self.pool.map(work, parts))

    def _store_transform(self, field: ComplexArray, block: Block) -> None:
        """Store the transform of a block of rows for the next iteration."""
        _panels(self._carried[0]).put_rows(field, block.rows.start)

    def _field(self, plane: Plane, rows: slice, buffer: ComplexArray | None = None) -> ComplexArray:
        """Return rows of the field on a plane to which it has been propagated."""
        panels = _panels(plane)
        return panels.take_rows(
            rows.start,
            _thread_buffer("field", rows, panels.shape, panels.dtype) if buffer is None else buffer,
        )

    def _replaced_power(self, now: ComplexArray, plane: Plane) -> float:
        """Return the sum of |values|^2 of the field sought after A2 in its own plane."""
        known = plane.known
        if known is None:
            return plane.power

        def one(block: Block) -> float:
            part = _floats(now[block.rows]), plane.amplitude[block.rows], known[block.rows]
            return float(kernel.replaced_power(*part))

        return math.fsum(self._map_blocks(one, self._blocks()))

    def _replace_amplitudes(self, plane: Plane, is_compared: bool) -> list[Sums]:
        """Do A2 between two transforms along rows; return sums over blocks if the plane is compared."""

        def one(block: Block) -> Sums:
            field = self._field(plane, block.rows)
            sums = _compare(field, plane, block) if is_compared else ()
            kernel.replace(_floats(field), plane.amplitude[block.rows], _known(plane, block.rows))
            _panels(plane).put_rows(field, block.rows.start)
            return sums

        return self._map_blocks(one, self._blocks())

    def _propagate_back(self, plane: Plane) -> float:
        """Do A3 without the transform along rows; return the sum of |values|^2 by Parseval's theorem."""
        panels = _panels(plane)

        def one(index: int) -> float:
            panel = panels.values[index]
            panels.along_columns(panel, panel, inverse=False)
            power = _apply_carrier(panel, plane, index, True)
            panels.along_columns(panel, panel, inverse=True)
            return power

        return math.fsum(self._map_blocks(one, range(len(panels.values)))) * plane.amplitude.size

    def _feed_back(
        self,
        now: ComplexArray,
        previous: ComplexArray,
        weights: tuple[float, float, float],
        tv_step: float,
        floors: Sequence[float],
    ) -> list[Sums]:
        """Do A4, the mean, A5 and the transform along rows; return the sums of the plane sought."""
        real = now.real.dtype.type
        weight_of_mean, a, b = (real(weight) for weight in (weights[0] / len(self.planes), *weights[1:]))
        steps = [(real(floor), real(0.5 * tv_step)) for floor in floors]
        blocks = self._blocks(with_neighbours=True)
        first_carried = self._carried[0]
        # Rows next to a block are copied, because the block that owns them may overwrite them earlier.
        values = _panels(first_carried).values
        copied_rows = self._map_blocks(
            lambda block: [(row, values[:, row].copy()) for row in _neighbour_rows(block)], blocks
        )
        neighbours = dict(chain.from_iterable(copied_rows))

        def one(block: Block) -> Sums:
            mean = _thread_buffer("mean", block.rows, now.shape, now.dtype)
            sums: Sums = ()
            for plane, step in zip(self.planes, steps, strict=True):
                if plane.carrier is None:
                    sums = _compare(now[block.rows], plane, block)
                    field = _thread_buffer("field", block.extended, now.shape, now.dtype)
                    field[...] = now[block.extended]
                    kernel.replace(
                        _floats(field),
                        plane.amplitude[block.extended],
                        _known(plane, block.extended),
                    )
                elif plane is first_carried:
                    field = self._field_with_neighbours(plane, block, neighbours)
                else:
                    field = self._field(plane, block.extended)
                first = block.rows.start - block.extended.start
                kernel.add_smoothed(_floats(field), first, *step, plane is self.planes[0], _floats(mean))
            after = previous[block.rows]
            kernel.feed_back(_floats(mean), weight_of_mean, _floats(now[block.rows]), a, _floats(after), b)
            self._store_transform(after, block)
            return sums

        return self._map_blocks(one, blocks)

    def _field_with_neighbours(
        self, plane: Plane, block: Block, neighbours: dict[int, Array]
    ) -> ComplexArray:
        """Return rows of the field on a plane whose neighbouring rows have been copied."""
        panels, rows = _panels(plane), block.extended.stop - block.extended.start
        values = thread_buffer("beside", (len(panels.values), rows, 2, LANES), panels.dtype)
        values[...] = panels.values[:, block.extended]
        for row in _neighbour_rows(block):
            values[:, row - block.extended.start] = neighbours[row]
        return panels.take_rows(
            0, _thread_buffer("field", block.extended, panels.shape, panels.dtype), values
        )


def _neighbour_rows(block: Block) -> list[int]:
    """Return the rows next to those of a block."""
    above = [block.extended.start] if block.extended.start < block.rows.start else []
    return above + ([block.rows.stop] if block.rows.stop < block.extended.stop else [])


def _floats(values: ComplexArray) -> Array:
    return values.view(values.real.dtype)


def _known(plane: Plane, rows: slice) -> NDArray[np.bool_] | None:
    return None if plane.known is None else plane.known[rows]


def _panels(plane: Plane) -> Panels:
    assert plane.spectrum_panels is not None
    return plane.spectrum_panels


def _thread_buffer(name: str, rows: slice, shape: tuple[int, ...], dtype: Any) -> ComplexArray:
    """Return a thread's buffer for rows of a field of a shape."""
    return thread_buffer(name, (rows.stop - rows.start, 2 * shape[1]), dtype).view(dtype)


def _apply_carrier(spectrum: Array, plane: Plane, index: int, inverse: bool) -> float:
    """Multiply a panel of a spectrum by a plane's carrier or its conjugate; return the sum of |values|^2."""
    assert plane.carrier is not None
    return float(kernel.apply_transfer(spectrum, plane.carrier[index], inverse, _panels(plane).values[index]))


def _compare(field: ComplexArray, plane: Plane, block: Block) -> Sums:
    amplitude, known = plane.amplitude[block.rows], _known(plane, block.rows)
    return tuple(kernel.compare(_floats(field), amplitude, known))


def _match_of(sums: Sequence[Sums]) -> AmplitudeMatch:
    """Return the agreement from the sums over all blocks."""
    count, sx, sy, sxx, syy, sxy, off = (math.fsum(values) for values in zip(*sums, strict=True))
    x, y = sxx - sx * sx / count, syy - sy * sy / count
    # Variance over mean square below which amplitudes count as constant; their correlation is then 0.
    tolerance = 1e-12
    even = x <= tolerance * sxx or y <= tolerance * syy
    correlation = 0.0 if even else (sxy - sx * sy / count) / math.sqrt(x * y)
    return AmplitudeMatch(correlation, math.sqrt(off / syy) if syy > 0.0 else math.inf)
