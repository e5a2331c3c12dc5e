"""Steps of the ray kernel for shapes other than conics: blocks of rays in loops that the compiler vectorizes.

:func:`through_shape` traces a block of rays through a surface as if no ray failed, like
:func:`lensdesign.raytrace.conic_kernel.through_conic`, whose arguments it has. Newton's method starts at a
conic near the surface. All rays of a block take the same number of steps, mostly three, which is cheaper than
a test of each ray. Rays that have not arrived then count as uncertain.

Sums over the terms of a shape have a fixed number of terms, because the compiler vectorizes over rays only if
it can unroll the loop over terms. Shapes with fewer terms are padded with zeros.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

from numba import njit
from numba.extending import overload

from lensdesign.lens.shapes.base import FormulaShape
from lensdesign.lens.shapes.compiled import lengths_of
from lensdesign.lens.shapes.registry import FORMULAS, formula_classes
from lensdesign.raytrace.conic_kernel import BLOCK, OPL, L, M, N, X, Y, Z, intersect_conic

_jit = njit(nogil=True, error_model="numpy")
_inline = njit(nogil=True, error_model="numpy", inline="always")

FIRST_STEPS, MOST_STEPS = 2, 8
"""Newton steps before the first test whether rays have arrived (for surfaces of revolution), and after which
the test is final."""

ARRIVED = 3e-13
"""Last step, over 1 mm plus the distance, up to which a ray has arrived: the normal, which is that before the
step, is then right to rounding."""


def _first(count: int) -> Any:
    """Return a compiled function that returns the first values of an array as a tuple of known length."""
    if count == 1:
        return _inline(lambda values: (values[0],))
    fewer, last = _first(count - 1), count - 1
    return _inline(lambda values: fewer(values) + (values[last],))  # noqa: RUF005


def _through(shape: type[FormulaShape], count_of_terms: int) -> Any:
    """Return the compiled passage of a block through a shape with a number of terms."""
    # The conic at which the steps start is farther from a surface that is not one of revolution.
    first_steps = FIRST_STEPS if shape.ROTATIONAL else FIRST_STEPS + 1
    first, residual_and_normal = _first(count_of_terms), _inline(shape.residual_and_normal)

    def through(ray, after, work, z0, c, k, own, n1, ratio, limit, count):
        terms = first(own)
        for i in range(count):
            z, dz = ray[Z + i] - z0, ray[N + i]
            t, _ = intersect_conic(ray[X + i], ray[Y + i], z, ray[L + i], ray[M + i], dz, c, k)
            # A ray that starts behind the conic's edge fails, and is traced alone.
            work[BLOCK + i] = t if 1.0 - (1.0 + k) * c * (z + t * dz) > 0.0 else math.nan
        for _ in range(first_steps):
            for i in range(count):
                t, dx, dy, dz = work[BLOCK + i], ray[L + i], ray[M + i], ray[N + i]
                top, bottom, nx, ny, nz = residual_and_normal(
                    terms, ray[X + i] + t * dx, ray[Y + i] + t * dy, ray[Z + i] - z0 + t * dz
                )
                work[BLOCK + i] = t - top / (bottom * (nx * dx + ny * dy + nz * dz))
        uncertain = 0
        for _ in range(first_steps, MOST_STEPS):
            unsettled = uncertain = 0
            for i in range(count):
                before, dx, dy, dz = work[BLOCK + i], ray[L + i], ray[M + i], ray[N + i]
                top, bottom, nx, ny, nz = residual_and_normal(
                    terms, ray[X + i] + before * dx, ray[Y + i] + before * dy, ray[Z + i] - z0 + before * dz
                )
                along = nx * dx + ny * dy + nz * dz
                step = top / (bottom * along)
                t = before - step
                x, y = ray[X + i] + t * dx, ray[Y + i] + t * dy
                normal2 = nx * nx + ny * ny + nz * nz
                square_out = normal2 * (1.0 - ratio * ratio) + ratio * ratio * along * along
                gain = (math.sqrt(square_out) - ratio * along) / normal2
                error = abs(step) - ARRIVED * (1.0 + abs(t))
                within = limit - (x * x + y * y)
                least = along if along < within else within
                least = least if least < nz else nz
                least = least if least < -error else -error
                least = least if least < square_out else square_out  # NaN is chosen, too
                unsettled += 1 if error > 0.0 else 0
                uncertain += 0 if least > 0.0 else 1
                work[i] = least
                # A ray that has arrived stays where it is while others of its block go on.
                work[BLOCK + i] = t if error > 0.0 else before
                after[X + i] = x
                after[Y + i] = y
                after[Z + i] = ray[Z + i] + t * dz
                after[OPL + i] = ray[OPL + i] + n1 * t
                after[L + i] = ratio * dx + gain * nx
                after[M + i] = ratio * dy + gain * ny
                after[N + i] = ratio * dz + gain * nz
            if unsettled == 0:
                break
        return uncertain

    return _named(through, f"through_{shape.__name__}_{count_of_terms}")


@cache
def _passages(lengths: tuple[int, ...]) -> tuple[tuple[int, Any], ...]:
    """Return code and compiled passage of the needed formulas whose sums are unrolled."""
    classes, counts = formula_classes(), tuple(FORMULAS.values())
    return tuple(
        (code, _through(classes[code], length))
        for code, length in enumerate(lengths, 1)
        if length in counts[code]
    )


def _named(function: Any, name: str) -> Any:
    """Return a function compiled under a name of its own.

    Functions that are made in a call have equal names. Numba tells them apart by their number in the process
    that compiles them, which another process gives to another function. If cached kernels of both are loaded
    together, the linker takes the first function of a name for all.
    """
    function.__qualname__ = name
    return _jit(function)


def _dispatched(passages: Sequence[tuple[int, Any]]) -> Any:
    """Return one function of a shape's code for passages with their codes."""
    code, own = passages[0]
    name = "chosen_" + "_".join(passage.py_func.__qualname__ for _, passage in passages)
    if len(passages) == 1:

        def only(shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count):
            return own(ray, after, work, z0, c, k, terms, n1, ratio, limit, count)

        return _named(only, name)
    other = _dispatched(passages[1:])

    def chosen(shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count):
        if shape == code:
            return own(ray, after, work, z0, c, k, terms, n1, ratio, limit, count)
        return other(shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count)

    return _named(chosen, name)


def through_shape(formulas, shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count):
    """Trace a block of rays through a shape with the given code, see :func:`through_conic`.

    It exists in compiled code only, for shapes of :func:`is_vectorized`.
    """
    raise NotImplementedError("compiled code only")


@overload(through_shape)
def _through_shape(formulas, shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count):
    passages = _passages(lengths_of(formulas))
    if not passages:
        return lambda formulas, shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count: count
    chosen = _dispatched(passages)
    return lambda formulas, shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count: chosen(
        shape, ray, after, work, z0, c, k, terms, n1, ratio, limit, count
    )


def is_vectorized(formulas, shape):
    """Return whether :func:`through_shape` traces the shape with a code; it exists in compiled code only."""
    raise NotImplementedError("compiled code only")


@overload(is_vectorized)
def _is_vectorized(formulas, shape):
    codes = tuple(code for code, _ in _passages(lengths_of(formulas)))
    if not codes:
        return lambda formulas, shape: False
    return lambda formulas, shape: shape in codes
