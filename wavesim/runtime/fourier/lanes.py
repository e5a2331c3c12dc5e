"""Vectors of sixteen numbers in compiled loops, one for each of sixteen rows or columns.

A compiler seldom turns a loop over distant memory addresses into vector instructions. The type :class:`Lanes`
states them explicitly: its sums, differences and products apply to sixteen numbers each, and LLVM translates
them to the vector instructions of the processor.
"""

# mypy: disable-error-code="misc"

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model
from numpy import empty
from numpy.typing import NDArray

from lensdesign.raytrace.cached_kernels import cached_njit

LANES = 16
"""Number of numbers in a vector."""

CACHE_LINE = 64
"""Size of a cache line in bytes. A vector that crosses the border of two lines takes twice the time."""

_WHOLE = ir.IntType(64)
_FUSED = ("contract",)


class Lanes(types.Type):
    """Numba type of a vector of sixteen numbers of one type."""

    def __init__(self, number: types.Type) -> None:
        self.number = number
        super().__init__(name=f"Lanes({number})")


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    """Data model of a vector, whose numbers are contiguous in memory."""

    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, ir.VectorType(manager[kind.number].get_value_type(), LANES))


def _arithmetic(function: Any, instruction: str) -> None:
    """Register an instruction of LLVM as an operator of two vectors."""

    @infer_global(function)
    class _Signature(AbstractTemplate):
        def generic(self, args: Any, _: Any) -> Any:
            alike = len(args) == 2 and isinstance(args[0], Lanes) and args[0] == args[1]
            return signature(args[0], *args) if alike else None

    @lower_builtin(function, Lanes, Lanes)
    def _made(_: Any, builder: Any, __: Any, values: Any) -> Any:
        return getattr(builder, instruction)(*values, flags=_FUSED)


for _function, _instruction in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _arithmetic(_function, _instruction)


def _vector_at(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    """Return a pointer to a vector of a contiguous array."""
    data = context.make_array(kind)(context, builder, array).data
    vector = ir.VectorType(context.get_value_type(kind.dtype), LANES)
    return builder.bitcast(builder.gep(data, [first]), vector.as_pointer())


def _loaded(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    return builder.load(_vector_at(context, builder, kind, array, first), align=kind.dtype.bitwidth // 8)


def _stored(context: Any, builder: Any, kind: Any, value: Any, array: Any, first: Any) -> None:
    builder.store(value, _vector_at(context, builder, kind, array, first), align=kind.dtype.bitwidth // 8)


@intrinsic
def load(_: Any, array: Any, first: Any) -> Any:
    """Return the vector array[first : first + 16] of a flat array."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _loaded(context, builder, signature.args[0], *values)

    return Lanes(array.dtype)(array, types.intp), codegen


@intrinsic
def store(_: Any, array: Any, first: Any, value: Any) -> Any:
    """Set array[first : first + 16] of a flat array to a vector."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        _stored(context, builder, signature.args[0], values[2], *values[:2])
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def alike(_: Any, number: Any) -> Any:
    """Return a vector whose sixteen numbers are equal."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        nothing = ir.Constant(context.get_value_type(signature.return_type), ir.Undefined)
        one = builder.insert_element(nothing, values[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(one, nothing, _lane_numbers([0] * LANES))

    return Lanes(number)(number), codegen


@intrinsic
def fetch(_: Any, array: Any, first: Any) -> Any:
    """Prefetch array[first] into the cache; `first` may lie outside the array."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = context.make_array(signature.args[0])(context, builder, values[0]).data
        byte, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        pointer = builder.bitcast(builder.gep(pointer, [values[1]]), byte)
        # Arguments: for reading, into all cache levels, data.
        builder.call(prefetch, [pointer, whole(0), whole(3), whole(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


def _choice(name: str, relation: str) -> Any:
    """Return a function for the elementwise minimum or maximum of two vectors."""

    def chosen(_: Any, one: Any, other: Any) -> Any:
        def codegen(__: Any, builder: Any, ___: Any, values: Any) -> Any:
            return builder.select(builder.fcmp_ordered(relation, *values), *values)

        return one(one, other), codegen

    chosen.__name__ = name
    return intrinsic(chosen)


smaller, larger = _choice("smaller", "<"), _choice("larger", ">")


def _shuffle(name: str, places: list[int]) -> Any:
    """Return a function that makes a vector of the numbers at some positions of two vectors."""

    def shuffled(_: Any, one: Any, other: Any) -> Any:
        def codegen(__: Any, builder: Any, ___: Any, values: Any) -> Any:
            return builder.shuffle_vector(*values, _lane_numbers(places))

        return one(one, other), codegen

    shuffled.__name__ = name
    return intrinsic(shuffled)


def _lane_numbers(numbers: Sequence[int]) -> Any:
    """Return the mask of a shuffle instruction of LLVM."""
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), list(numbers))


evens, odds = (_shuffle(name, [*range(k, 2 * LANES, 2)]) for k, name in enumerate(("evens", "odds")))
"""Numbers with even or odd positions in two vectors: real or imaginary parts of complex numbers."""

_IN_TURN = [k + LANES * part for k in range(LANES) for part in (0, 1)]
pairs, more_pairs = _shuffle("pairs", _IN_TURN[:LANES]), _shuffle("more_pairs", _IN_TURN[LANES:])
"""First and second half of the alternating numbers of two vectors."""


@intrinsic
def transpose(_: Any, source: Any, first: Any, step: Any, target: Any, to: Any, step_to: Any) -> Any:
    """Set target[to + j step_to + i] = source[first + i step + j] for i, j below 16, in flat arrays."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        flat_source, first, step, flat_target, to, step_to = values

        def after(start: Any, number: int, stride: Any) -> Any:
            return builder.add(start, builder.mul(stride, ir.Constant(_WHOLE, number)))

        kinds = signature.args[0], signature.args[3]
        rows = [_loaded(context, builder, kinds[0], flat_source, after(first, i, step)) for i in range(LANES)]
        for j, column in enumerate(_transposed(builder, rows)):
            _stored(context, builder, kinds[1], column, flat_target, after(to, j, step_to))
        return context.get_dummy_value()

    whole = types.intp
    return types.void(source, whole, whole, target, whole, whole), codegen


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Return the transpose of a square of vectors.

    Each round exchanges off-diagonal blocks, whose side doubles from round to round.
    """
    side = 1
    while side < LANES:
        upper = [j if not j & side else LANES + j - side for j in range(LANES)]
        lower = [j + side if not j & side else LANES + j for j in range(LANES)]
        for i in (i for i in range(LANES) if not i & side):
            pair = rows[i], rows[i + side]
            rows[i], rows[i + side] = (
                builder.shuffle_vector(*pair, _lane_numbers(of)) for of in (upper, lower)
            )
        side *= 2
    return rows


@cached_njit(nogil=True)
def whole(numbers: int) -> int:
    """Return `numbers`, rounded up to whole vectors."""
    return (numbers + LANES - 1) // LANES * LANES


@cached_njit(nogil=True)
def lines_for(count: int, numbers: int, like: NDArray) -> NDArray:
    """Return an uninitialised array of `count` lines that hold `numbers` each, of the type of `like`.

    Lines are rounded up to whole vectors. One more vector keeps their distance from a power of 2, at which
    they would share the same places of a cache.
    """
    wide = whole(numbers) + LANES
    room = empty(count * wide + CACHE_LINE // like.itemsize, like.dtype)
    start = -room.ctypes.data % CACHE_LINE // like.itemsize
    return room[start : start + count * wide].reshape(count, wide)


@cached_njit(nogil=True)
def moved_up(lines: NDArray, first: int, made: int, top: int) -> None:
    """Move lines from `first` to `made` to the start of the buffer, which now begins at line `top`."""
    for i in range(first, made):
        lines[i - first] = lines[i - top]
