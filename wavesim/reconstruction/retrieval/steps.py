"""An iteration of Appendix A in a few passes over the memory.

At the size of a sensor the time goes into memory and not into arithmetic. Fourier transforms are therefore
taken axis by axis, and whatever lies between two transforms along the same axis is done to a block of rows or
columns as long as it is in the processor's cache: along columns to the carriers and back, along rows to the
amplitudes and back, along rows to A4, the mean, A5 and the next iteration's first transform. A plane at
distance 0 takes part in the last of them alone.

Sums over blocks are taken in their order, so that results do not depend on the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import PlaneWay
from wavesim.reconstruction.retrieval import kernel

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]
Sums = tuple[float, ...]
T = TypeVar("T")

BLOCK_BYTES = 2**20
"""Of a block: about a core's second-level cache."""

LEAST_BLOCK, AT_ONCE = 16, 8
"""Rows or columns in a block, or a multiple: transforms take a few at once by vector instructions, and what
is left over alone. And rows that make a block with neighbours on either side such a multiple."""

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
    carrier : PlaneWay or None
        None where the plane is the one sought.
    there : ndarray
        A field or its spectrum on the way; of no rows where there is no carrier.
    """

    amplitude: Array
    known: NDArray[np.bool_] | None
    carrier: PlaneWay | None
    there: ComplexArray


@dataclass(frozen=True)
class Block:
    """Rows or columns: `own`, and `wide` with a neighbour on either side where there is one."""

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


def plane_for(
    grid: Grid,
    wavelength_um: float,
    distance_mm: float,
    amplitude: Array,
    known: NDArray[np.bool_] | None,
    dtype: Any,
) -> Plane:
    """A plane with its work space, for fields of a complex type; distance from the plane sought."""
    way = PlaneWay(grid, wavelength_um, distance_mm, dtype)
    carrier = None if way.is_none else way
    recorded = rows_of(amplitude).astype(np.zeros(0, dtype).real.dtype, copy=False)
    there = np.empty((0, 0) if carrier is None else recorded.shape, dtype)
    return Plane(recorded, None if known is None else rows_of(known), carrier, there)


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
            self._over(lambda block: self._leave(now[block.own], block), self._blocks(0))

    def arrive(self) -> None:
        """Carry what :meth:`begin` or :meth:`step` has left to all planes, but for transforms along rows."""

        def one(block: Block) -> None:
            spectrum = scipy.fft.fft(self._carried[0].there[:, block.own], axis=0)
            for plane in self._carried:
                carried = spectrum if plane is self._carried[-1] else np.empty_like(spectrum)
                _carry(spectrum, plane, block, False, carried)
                plane.there[:, block.own] = scipy.fft.ifft(carried, axis=0, overwrite_x=True)

        if self._carried:
            self._over(one, self._blocks(1))

    def match(self, now: ComplexArray, plane: Plane) -> Match:
        """How well a plane is met after :meth:`arrive`; its work space, if it has any, then has the field."""

        def one(block: Block) -> Sums:
            if plane.carrier is None:
                return _compared(now[block.own], plane, block)
            plane.there[block.own] = field = scipy.fft.ifft(plane.there[block.own], axis=1)
            return _compared(field, plane, block)

        return _match(self._over(one, self._blocks(0)))

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
        """Planes with carriers. The first one's work space takes the transform that an iteration leaves."""
        return [plane for plane in self.planes if plane.carrier is not None]

    def _blocks(self, axis: int, with_neighbours: bool = False) -> list[Block]:
        """Of rows (axis 0) or columns."""
        shape = self.planes[0].amplitude.shape
        item = 2 * self.planes[0].amplitude.itemsize
        size = max(BLOCK_BYTES // (item * shape[1 - axis]) // LEAST_BLOCK, 1) * LEAST_BLOCK
        if with_neighbours:
            size += AT_ONCE - 2
        cuts = [*range(0, shape[axis], size), shape[axis]]
        return [
            Block(slice(start, stop), slice(max(start - 1, 0), min(stop + 1, shape[axis])))
            for start, stop in pairwise(cuts)
        ]

    def _over(self, work: Callable[[Block], T], blocks: Sequence[Block]) -> list[T]:
        """What each block gives, in their order."""
        if len(blocks) == 1:
            return [work(blocks[0])]
        return list(self.pool.map(work, blocks))

    def _leave(self, field: ComplexArray, block: Block) -> None:
        """Take a block of rows of the field sought for the next iteration."""
        self._carried[0].there[block.own] = scipy.fft.fft(field, axis=1)

    def _replaced_power(self, now: ComplexArray, plane: Plane) -> float:
        """Sum of |values|^2 of the field sought after A2 in its own plane."""

        def one(block: Block) -> float:
            part = (now[block.own], plane.amplitude[block.own], _known(plane, block.own))
            return float(kernel.replaced_power(*part))

        return math.fsum(self._over(one, self._blocks(0)))

    def _replace_there(self, plane: Plane, watched: bool) -> list[Sums]:
        """A2, between two transforms along rows; sums over blocks if it is watched."""

        def one(block: Block) -> Sums:
            field = scipy.fft.ifft(plane.there[block.own], axis=1)
            sums = _compared(field, plane, block) if watched else ()
            kernel.replace(field, plane.amplitude[block.own], _known(plane, block.own))
            plane.there[block.own] = scipy.fft.fft(field, axis=1, overwrite_x=True)
            return sums

        return self._over(one, self._blocks(0))

    def _bring_back(self, plane: Plane) -> float:
        """A3, but for the transform along rows; the sum of |values|^2 by Parseval's theorem."""

        def one(block: Block) -> float:
            spectrum = scipy.fft.fft(plane.there[:, block.own], axis=0)
            power = _carry(spectrum, plane, block, True, spectrum)
            plane.there[:, block.own] = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True)
            return power

        return math.fsum(self._over(one, self._blocks(1))) / plane.there.size

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
        blocks = self._blocks(0, with_neighbours=True)
        lead = self._carried[0]
        # Their own block overwrites them, perhaps before its neighbours have read them.
        beside = {row: lead.there[row].copy() for block in blocks for row in _beside(block)}

        def one(block: Block) -> Sums:
            mean = np.empty_like(before[block.own])
            sums: Sums = ()
            for plane, step in zip(self.planes, steps, strict=True):
                if plane.carrier is None:
                    sums = _compared(now[block.own], plane, block)
                    field = now[block.wide].copy()
                    kernel.replace(field, plane.amplitude[block.wide], _known(plane, block.wide))
                else:
                    field = plane.there[block.wide].copy()
                    for row in _beside(block) if plane is lead else ():
                        field[row - block.wide.start] = beside[row]
                    field = np.ascontiguousarray(scipy.fft.ifft(field, axis=1, overwrite_x=True))
                first = block.own.start - block.wide.start
                kernel.add_smoothed(_floats(field), first, *step, plane is self.planes[0], _floats(mean))
            after = before[block.own]
            kernel.feed_back(_floats(mean), own, _floats(now[block.own]), a, _floats(after), b)
            self._leave(after, block)
            return sums

        return self._over(one, blocks)


def _beside(block: Block) -> list[int]:
    """Rows next to a block's own."""
    above = [block.wide.start] if block.wide.start < block.own.start else []
    return above + ([block.own.stop] if block.own.stop < block.wide.stop else [])


def _floats(values: ComplexArray) -> Array:
    return values.view(values.real.dtype)


def _known(plane: Plane, rows: slice) -> NDArray[np.bool_] | None:
    return None if plane.known is None else plane.known[rows]


def _carry(spectrum: ComplexArray, plane: Plane, block: Block, back: bool, result: ComplexArray) -> float:
    """Carry columns of a spectrum to a plane or back; the sum of |values|^2 of the result."""
    assert plane.carrier is not None
    way, columns = plane.carrier, plane.carrier.columns[block.own]
    fields = _floats(spectrum), _floats(way.factor)
    return float(kernel.carry(*fields, way.rows, columns, back, _floats(result)))


def _compared(field: ComplexArray, plane: Plane, block: Block) -> Sums:
    amplitude, known = plane.amplitude[block.own], _known(plane, block.own)
    return tuple(kernel.compare(field, amplitude, known))


def _match(sums: Sequence[Sums]) -> Match:
    """From the sums over all blocks."""
    count, sx, sy, sxx, syy, sxy, off = (math.fsum(values) for values in zip(*sums, strict=True))
    x, y = sxx - sx * sx / count, syy - sy * sy / count
    even = x <= EVEN * sxx or y <= EVEN * syy
    correlation = 0.0 if even else (sxy - sx * sy / count) / math.sqrt(x * y)
    return Match(correlation, math.sqrt(off / syy) if syy > 0.0 else math.inf)
