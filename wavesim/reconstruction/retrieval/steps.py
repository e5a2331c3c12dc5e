"""An iteration of Appendix A in a few passes over the memory.

At the size of a sensor the time goes into memory and not into arithmetic. Fourier transforms are therefore
taken axis by axis, and whatever lies between two transforms along the same axis is done to a block of rows or
a panel of columns as long as it is in the processor's cache: along columns to the carriers and back, along
rows to the amplitudes and back, along rows to A4, the mean, A5 and the next iteration's first transform. A
plane at distance 0 takes part in the last of them alone.

Sums over blocks are taken in their order, so that results do not depend on the number of threads.
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
from wavesim.runtime.fourier.panels import Panels, aligned, thread_room, transform_bytes

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
Sums = tuple[float, ...]
T = TypeVar("T")

BLOCK_BYTES = 2**20
"""Of a block of rows, about a core's second-level cache; they are a multiple of those transformed at once."""

FLOOR = 1e-6
"""Of the root mean square: added to each modulus that A4 divides by."""

EVEN = 1e-12
"""Variance over mean square below which amplitudes are even, and correlate with nothing."""


@dataclass(frozen=True, eq=False)
class Plane:
    """Amplitudes on a plane, and work space; all arrays of shape (rows, columns).

    Attributes
    ----------
    amplitude : ndarray
        Recorded.
    known : ndarray of bool or None
        Pixels that tell something; None where all do.
    carrier : ndarray or None
        Factors of a spectrum's panels on the way to the plane, over the number of samples, for frequencies
        that are not negative down the columns: shape (panels, rows // 2 + 1, 2, 16). None where the plane is
        the one sought.
    there : Panels or None
        The field's spectrum along rows, or along both axes, on the way; None where there is no carrier.
    """

    amplitude: Array
    known: NDArray[np.bool_] | None
    carrier: Array | None
    there: Panels | None

    @cached_property
    def power(self) -> float:
        """Sum of the amplitudes' squares."""
        return math.fsum(float(np.sum(np.square(row, dtype=float))) for row in self.amplitude)


@dataclass(frozen=True)
class Block:
    """Rows: `own`, and `wide` with a neighbour on either side where there is one."""

    own: slice
    wide: slice


@dataclass(frozen=True)
class Match:
    """How well a field's moduli meet the amplitudes of a plane.

    Attributes
    ----------
    correlation : float
        A6; 0 where either is even.
    residual : float
        L2 norm of the difference over that of the recorded amplitude.
    """

    correlation: float
    residual: float


def rows_of(values: NDArray[Any]) -> NDArray[Any]:
    """Samples as rows and columns; those of a line are one row."""
    return np.ascontiguousarray(values).reshape(-1, values.shape[-1])


def rows_of_block(shape: tuple[int, ...], value_bytes: int, with_neighbours: bool = False) -> int:
    """Of a plane, given what one value takes; neighbours on either side are transformed with them."""
    size = max(BLOCK_BYTES // (value_bytes * shape[-1]) // LANES, 1) * LANES
    return max(size, 2 * LANES) - 2 if with_neighbours else size


def bytes_at_work(shape: tuple[int, int], dtype: DTypeLike) -> int:
    """Of each thread: three blocks of rows, a panel of a spectrum, and what transforms take."""
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
    """A plane with its work space, for fields of a complex type; distance from the plane sought."""
    way = TransferFunction(grid, wavelength_um, distance_mm, dtype)
    carrier = None if way.is_none else _in_panels(way, grid.shape[-1])
    recorded = rows_of(amplitude).astype(np.zeros(0, dtype).real.dtype, copy=False)
    there = None if carrier is None else Panels(recorded.shape, dtype)
    return Plane(recorded, None if known is None else rows_of(known), carrier, there)


def _in_panels(way: TransferFunction, columns: int) -> Array:
    """A way's factors as a plane has them; transforms there and back multiply by the number of samples."""
    count = -(-columns // LANES)
    factors = aligned((count, len(way.factor), 2, LANES), way.factor.dtype)
    factors[-1] = 0.0
    for number in range(count):
        own = way.columns[number * LANES : (number + 1) * LANES]
        part = way.factor[:, own] * factors.dtype.type(1.0 / (len(way.rows) * columns))
        factors[number, :, 0, : len(own)], factors[number, :, 1, : len(own)] = part.real, part.imag
    return factors


@dataclass(frozen=True, eq=False)
class Passes:
    """The passes of an iteration over planes.

    Fields are of shape (rows, columns), and C-contiguous.

    Attributes
    ----------
    planes : sequence of Plane
        At most one without a carrier, if there are several.
    pool : ThreadPoolExecutor
        That blocks are shared out to.
    """

    planes: Sequence[Plane]
    pool: ThreadPoolExecutor

    def begin(self, now: ComplexArray) -> None:
        """Take the first transform, along rows, of the field sought."""
        if self._carried:
            self._over(lambda block: self._leave(now[block.own], block), self._blocks())

    def arrive(self) -> None:
        """Carry what :meth:`begin` or :meth:`step` has left to all planes, but for transforms along rows."""
        carried = [_panels(plane) for plane in self._carried]

        def one(number: int) -> None:
            lead = carried[0]
            spectrum = thread_room("spectrum", lead.values[number].shape, lead.dtype)
            lead.along_columns(lead.values[number], spectrum, back=False)
            for plane, panels in zip(self._carried, carried, strict=True):
                _carry(spectrum, plane, number, False)
                panels.along_columns(panels.values[number], panels.values[number], back=True)

        if carried:
            self._over(one, range(len(carried[0].values)))

    def match(self, now: ComplexArray, plane: Plane) -> tuple[Match, ComplexArray]:
        """How well a plane is met after :meth:`arrive`, and the field there."""
        there = now if plane.carrier is None else np.empty_like(now)

        def one(block: Block) -> Sums:
            if plane.carrier is not None:
                self._field(plane, block.own, there[block.own])
            return _compared(there[block.own], plane, block)

        return _match(self._over(one, self._blocks())), there

    def step(
        self, now: ComplexArray, before: ComplexArray, weights: tuple[float, float, float], tv_step: float
    ) -> Match:
        """One iteration: what follows on `now` takes the place of `before`.

        Parameters
        ----------
        now
            The field sought, whose transform :meth:`begin` or the last step has left.
        before
            Of the iteration before.
        weights
            Of the mean over the planes, and, subtracted, of `now` and `before`.
        tv_step
            Step t of A4.

        Returns
        -------
        Match
            Of `now` on the first plane.
        """
        self.arrive()
        met: list[Sums] = []
        powers = []
        for plane in self.planes:
            if plane.carrier is None:
                powers.append(self._replaced_power(now, plane))
                continue
            sums = self._replace_there(plane, watched=plane is self.planes[0])
            met = sums if plane is self.planes[0] else met
            powers.append(self._bring_back(plane))
        least = float(np.finfo(now.dtype).tiny)
        floors = [FLOOR * math.sqrt(power / now.size) + least for power in powers]
        last = self._follow(now, before, weights, tv_step, floors)
        return _match(met or last)

    @property
    def _carried(self) -> list[Plane]:
        """Planes with carriers. The first one's panels take the transform that an iteration leaves."""
        return [plane for plane in self.planes if plane.carrier is not None]

    def _blocks(self, with_neighbours: bool = False) -> list[Block]:
        """Of rows."""
        amplitude = self.planes[0].amplitude
        rows, size = len(amplitude), rows_of_block(amplitude.shape, 2 * amplitude.itemsize, with_neighbours)
        cuts = [*range(0, rows, size), rows]
        return [
            Block(slice(start, stop), slice(max(start - 1, 0), min(stop + 1, rows)))
            for start, stop in pairwise(cuts)
        ]

    def _over(self, work: Callable[[Any], T], parts: Sequence[Any]) -> list[T]:
        """What each block of rows or number of a panel gives, in their order."""
        if len(parts) == 1:
            return [work(parts[0])]
        return list(self.pool.map(work, parts))

    def _leave(self, field: ComplexArray, block: Block) -> None:
        """Take a block of rows of the field sought for the next iteration."""
        _panels(self._carried[0]).put_rows(field, block.own.start)

    def _field(self, plane: Plane, rows: slice, room: ComplexArray | None = None) -> ComplexArray:
        """Rows of the field on a plane that has been carried there."""
        panels = _panels(plane)
        return panels.take_rows(
            rows.start, _room("field", rows, panels.shape, panels.dtype) if room is None else room
        )

    def _replaced_power(self, now: ComplexArray, plane: Plane) -> float:
        """Sum of |values|^2 of the field sought after A2 in its own plane."""
        known = plane.known
        if known is None:
            return plane.power

        def one(block: Block) -> float:
            part = _floats(now[block.own]), plane.amplitude[block.own], known[block.own]
            return float(kernel.replaced_power(*part))

        return math.fsum(self._over(one, self._blocks()))

    def _replace_there(self, plane: Plane, watched: bool) -> list[Sums]:
        """A2, between two transforms along rows; sums over blocks if it is watched."""

        def one(block: Block) -> Sums:
            field = self._field(plane, block.own)
            sums = _compared(field, plane, block) if watched else ()
            kernel.replace(_floats(field), plane.amplitude[block.own], _known(plane, block.own))
            _panels(plane).put_rows(field, block.own.start)
            return sums

        return self._over(one, self._blocks())

    def _bring_back(self, plane: Plane) -> float:
        """A3, but for the transform along rows; the sum of |values|^2 by Parseval's theorem."""
        panels = _panels(plane)

        def one(number: int) -> float:
            panel = panels.values[number]
            panels.along_columns(panel, panel, back=False)
            power = _carry(panel, plane, number, True)
            panels.along_columns(panel, panel, back=True)
            return power

        return math.fsum(self._over(one, range(len(panels.values)))) * plane.amplitude.size

    def _follow(
        self,
        now: ComplexArray,
        before: ComplexArray,
        weights: tuple[float, float, float],
        tv_step: float,
        floors: Sequence[float],
    ) -> list[Sums]:
        """A4, the mean and A5, and the transform along rows of what they give; sums of a plane sought."""
        real = now.real.dtype.type
        own, a, b = (real(weight) for weight in (weights[0] / len(self.planes), *weights[1:]))
        steps = [(real(floor), real(0.5 * tv_step)) for floor in floors]
        blocks = self._blocks(with_neighbours=True)
        lead = self._carried[0]
        # Their own block overwrites them, perhaps before its neighbours have read them.
        values = _panels(lead).values
        apart = self._over(lambda block: [(row, values[:, row].copy()) for row in _beside(block)], blocks)
        beside = dict(chain.from_iterable(apart))

        def one(block: Block) -> Sums:
            mean = _room("mean", block.own, now.shape, now.dtype)
            sums: Sums = ()
            for plane, step in zip(self.planes, steps, strict=True):
                if plane.carrier is None:
                    sums = _compared(now[block.own], plane, block)
                    field = _room("field", block.wide, now.shape, now.dtype)
                    field[...] = now[block.wide]
                    kernel.replace(_floats(field), plane.amplitude[block.wide], _known(plane, block.wide))
                elif plane is lead:
                    field = self._field_beside(plane, block, beside)
                else:
                    field = self._field(plane, block.wide)
                first = block.own.start - block.wide.start
                kernel.add_smoothed(_floats(field), first, *step, plane is self.planes[0], _floats(mean))
            after = before[block.own]
            kernel.feed_back(_floats(mean), own, _floats(now[block.own]), a, _floats(after), b)
            self._leave(after, block)
            return sums

        return self._over(one, blocks)

    def _field_beside(self, plane: Plane, block: Block, beside: dict[int, Array]) -> ComplexArray:
        """Rows of the field on a plane of which those beside a block have been set aside."""
        panels, rows = _panels(plane), block.wide.stop - block.wide.start
        values = thread_room("beside", (len(panels.values), rows, 2, LANES), panels.dtype)
        values[...] = panels.values[:, block.wide]
        for row in _beside(block):
            values[:, row - block.wide.start] = beside[row]
        return panels.take_rows(0, _room("field", block.wide, panels.shape, panels.dtype), values)


def _beside(block: Block) -> list[int]:
    """Rows next to a block's own."""
    above = [block.wide.start] if block.wide.start < block.own.start else []
    return above + ([block.own.stop] if block.own.stop < block.wide.stop else [])


def _floats(values: ComplexArray) -> Array:
    return values.view(values.real.dtype)


def _known(plane: Plane, rows: slice) -> NDArray[np.bool_] | None:
    return None if plane.known is None else plane.known[rows]


def _panels(plane: Plane) -> Panels:
    assert plane.there is not None
    return plane.there


def _room(name: str, rows: slice, shape: tuple[int, ...], dtype: Any) -> ComplexArray:
    """A thread's room for rows of a field of a shape."""
    return thread_room(name, (rows.stop - rows.start, 2 * shape[1]), dtype).view(dtype)


def _carry(spectrum: Array, plane: Plane, number: int, back: bool) -> float:
    """Carry a panel of a spectrum to a plane or back, into the plane's own; the sum of its |values|^2."""
    assert plane.carrier is not None
    return float(kernel.carry(spectrum, plane.carrier[number], back, _panels(plane).values[number]))


def _compared(field: ComplexArray, plane: Plane, block: Block) -> Sums:
    amplitude, known = plane.amplitude[block.own], _known(plane, block.own)
    return tuple(kernel.compare(_floats(field), amplitude, known))


def _match(sums: Sequence[Sums]) -> Match:
    """From the sums over all blocks."""
    count, sx, sy, sxx, syy, sxy, off = (math.fsum(values) for values in zip(*sums, strict=True))
    x, y = sxx - sx * sx / count, syy - sy * sy / count
    even = x <= EVEN * sxx or y <= EVEN * syy
    correlation = 0.0 if even else (sxy - sx * sy / count) / math.sqrt(x * y)
    return Match(correlation, math.sqrt(off / syy) if syy > 0.0 else math.inf)
