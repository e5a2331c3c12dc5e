"""Vectors of sixteen numbers in compiled loops, one for each of sixteen rows or columns.

A loop over many places in memory a compiler seldom turns into vector instructions. Here it is told:
:class:`Lanes` is a type whose sums, differences and products are those of sixteen numbers each, and LLVM
makes of them what the processor has.
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
"""Numbers that a vector holds."""

CACHE_LINE = 64
"""Bytes: a vector that lies in two takes twice the time."""

_WHOLE = ir.IntType(64)
_FUSED = ("contract",)


class Lanes(types.Type):
    """Numba's type of sixteen numbers of one kind."""

    def __init__(self, number: types.Type) -> None:
        self.number = number
        super().__init__(name=f"Lanes({number})")


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    """Data model of a vector, whose numbers are contiguous in memory."""

    def __init__(self, manager: Any, kind: Lanes) -> None:
        super().__init__(manager, kind, ir.VectorType(manager[kind.number].get_value_type(), LANES))


def _arithmetic(function: Any, instruction: str) -> None:
    """Have Numba take an operator of two vectors for an instruction."""

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


def vector_at(context: Any, builder: Any, kind: Any, array: Any, first: Any, count: int = LANES) -> Any:
    """Pointer to sixteen numbers of a contiguous array, or as many, as a vector."""
    data = context.make_array(kind)(context, builder, array).data
    vector = ir.VectorType(context.get_value_type(kind.dtype), count)
    return builder.bitcast(builder.gep(data, [first]), vector.as_pointer())


def _loaded(context: Any, builder: Any, kind: Any, array: Any, first: Any) -> Any:
    return builder.load(vector_at(context, builder, kind, array, first), align=kind.dtype.bitwidth // 8)


def _stored(context: Any, builder: Any, kind: Any, value: Any, array: Any, first: Any) -> None:
    builder.store(value, vector_at(context, builder, kind, array, first), align=kind.dtype.bitwidth // 8)


@intrinsic
def load(_: Any, array: Any, first: Any) -> Any:
    """The vector array[first : first + 16], of a flat array."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _loaded(context, builder, signature.args[0], *values)

    return Lanes(array.dtype)(array, types.intp), made


@intrinsic
def store(_: Any, array: Any, first: Any, value: Any) -> Any:
    """array[first : first + 16] = the vector."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        _stored(context, builder, signature.args[0], values[2], *values[:2])
        return context.get_dummy_value()

    return types.void(array, types.intp, value), made


@intrinsic
def alike(_: Any, number: Any) -> Any:
    """A vector of one number sixteen times."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        nothing = ir.Constant(context.get_value_type(signature.return_type), ir.Undefined)
        one = builder.insert_element(nothing, values[0], ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(one, nothing, lane_numbers([0] * LANES))

    return Lanes(number)(number), made


@intrinsic
def fetch(_: Any, array: Any, first: Any) -> Any:
    """Have array[first] brought into the cache, which need not be an element."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = context.make_array(signature.args[0])(context, builder, values[0]).data
        byte, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        place = builder.bitcast(builder.gep(place, [values[1]]), byte)
        # To be read, into all levels, and data.
        builder.call(prefetch, [place, whole(0), whole(3), whole(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), made


def _choice(name: str, relation: str) -> Any:
    """Return the elementwise minimum or maximum of two vectors."""

    def chosen(_: Any, one: Any, other: Any) -> Any:
        def made(__: Any, builder: Any, ___: Any, values: Any) -> Any:
            return builder.select(builder.fcmp_ordered(relation, *values), *values)

        return one(one, other), made

    chosen.__name__ = name
    return intrinsic(chosen)


smaller, larger = _choice("smaller", "<"), _choice("larger", ">")


def _shuffle(name: str, places: list[int]) -> Any:
    """Some numbers of two vectors."""

    def shuffled(_: Any, one: Any, other: Any) -> Any:
        def made(__: Any, builder: Any, ___: Any, values: Any) -> Any:
            return builder.shuffle_vector(*values, lane_numbers(places))

        return one(one, other), made

    shuffled.__name__ = name
    return intrinsic(shuffled)


def lane_numbers(numbers: Sequence[int]) -> Any:
    """Return the shuffle mask of vectors in the form of LLVM."""
    return ir.Constant(ir.VectorType(ir.IntType(32), len(numbers)), list(numbers))


evens, odds = (_shuffle(name, [*range(k, 2 * LANES, 2)]) for k, name in enumerate(("evens", "odds")))
"""Every other number of two vectors: real parts of complex numbers, or imaginary ones."""

_IN_TURN = [k + LANES * part for k in range(LANES) for part in (0, 1)]
pairs, more_pairs = _shuffle("pairs", _IN_TURN[:LANES]), _shuffle("more_pairs", _IN_TURN[LANES:])
"""Numbers of two vectors in turn: the first ones of each, and the others."""


@intrinsic
def transpose(_: Any, source: Any, first: Any, step: Any, target: Any, to: Any, step_to: Any) -> Any:
    """target[to + j step_to + i] = source[first + i step + j] for i, j below 16, of flat arrays."""

    def made(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given, first, step, taking, to, step_to = values

        def after(start: Any, number: int, stride: Any) -> Any:
            return builder.add(start, builder.mul(stride, ir.Constant(_WHOLE, number)))

        kinds = signature.args[0], signature.args[3]
        rows = [_loaded(context, builder, kinds[0], given, after(first, i, step)) for i in range(LANES)]
        for j, column in enumerate(_transposed(builder, rows)):
            _stored(context, builder, kinds[1], column, taking, after(to, j, step_to))
        return context.get_dummy_value()

    whole = types.intp
    return types.void(source, whole, whole, target, whole, whole), made


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Vectors across vectors: squares of twice the side in every round, whose halves change places."""
    side = 1
    while side < LANES:
        upper = [j if not j & side else LANES + j - side for j in range(LANES)]
        lower = [j + side if not j & side else LANES + j for j in range(LANES)]
        for i in (i for i in range(LANES) if not i & side):
            pair = rows[i], rows[i + side]
            rows[i], rows[i + side] = (
                builder.shuffle_vector(*pair, lane_numbers(of)) for of in (upper, lower)
            )
        side *= 2
    return rows


@cached_njit(nogil=True)
def whole(numbers: int) -> int:
    """Numbers of vectors that hold so many."""
    return (numbers + LANES - 1) // LANES * LANES


@cached_njit(nogil=True)
def lines_for(count: int, numbers: int, like: NDArray) -> NDArray:
    """Room for so many lines of numbers of an array's kind, each with whole vectors and one more.

    Lines a power of two apart share few places of a cache.
    """
    wide = whole(numbers) + LANES
    room = empty(count * wide + CACHE_LINE // like.itemsize, like.dtype)
    start = -room.ctypes.data % CACHE_LINE // like.itemsize
    return room[start : start + count * wide].reshape(count, wide)
