"""The formulas of shapes for compiled kernels, which compile only those that a lens needs.

Each function takes the formulas of the lens, whose type decides what is compiled
(:func:`lensdesign.lens.shapes.registry.needed_formulas`), the code of a formula and its terms. The functions
exist in compiled code only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from numba import njit
from numba.extending import overload

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.registry import formula_classes

# Inlined, because the call of a function of a few lines would double its cost.
_inline = njit(nogil=True, error_model="numpy", inline="always")


def lengths_of(formulas: Any) -> tuple[int, ...]:
    """Return the lengths of the tuples of formulas from their Numba type."""
    return tuple(len(one.types) for one in formulas.types)


def _of_code(functions: Sequence[tuple[int, Callable[..., Any]]]) -> Any:
    """Return one function of shape code, terms, x and y for functions with their codes."""
    code, own = functions[0][0], _inline(functions[0][1])
    if len(functions) == 1:
        return _inline(lambda shape, terms, x, y: own(terms, x, y))
    other = _of_code(functions[1:])

    @_inline
    def chosen(shape: int, terms: Any, x: float, y: float) -> Any:
        if shape == code:
            return own(terms, x, y)
        return other(shape, terms, x, y)

    return chosen


def _of_term(functions: Sequence[tuple[int, Callable[..., Any]]]) -> Any:
    """Return one function like :func:`_of_code`, with the index of a term after the terms."""
    code, own = functions[0][0], _inline(functions[0][1])
    if len(functions) == 1:
        return _inline(lambda shape, terms, j, x, y: own(terms, j, x, y))
    other = _of_term(functions[1:])

    @_inline
    def chosen(shape: int, terms: Any, j: int, x: float, y: float) -> Any:
        if shape == code:
            return own(terms, j, x, y)
        return other(shape, terms, j, x, y)

    return chosen


@cache
def _chosen(name: str, lengths: tuple[int, ...]) -> Any:
    """Return the compiled function of a name for the conic and the needed formulas."""
    needed = [
        (code, getattr(shape, name))
        for code, shape in enumerate(formula_classes())
        if code == 0 or lengths[code - 1]
    ]
    return _of_term(needed) if name == "term_derivatives" else _of_code(needed)


def sag_and_gradient(formulas: Any, code: int, terms: Any, x: float, y: float) -> Any:
    """Return the sag in mm at (x, y) in mm and its slopes along x and y."""
    raise NotImplementedError("compiled code only")


def sag_hessian(formulas: Any, code: int, terms: Any, x: float, y: float) -> Any:
    """Return the second derivatives of the sag in 1/mm: xx, xy and yy."""
    raise NotImplementedError("compiled code only")


def term_derivatives(formulas: Any, code: int, terms: Any, j: int, x: float, y: float) -> Any:
    """Return the derivatives of sag and slopes with respect to term j."""
    raise NotImplementedError("compiled code only")


def _implementation(name: str) -> Callable[..., Any]:
    """Return Numba's implementation of a function of a point by its name."""

    def of_types(formulas: Any, code: Any, terms: Any, x: Any, y: Any) -> Any:
        chosen = _chosen(name, lengths_of(formulas))

        def implementation(formulas: Any, code: Any, terms: Any, x: Any, y: Any) -> Any:
            return chosen(code, terms, x, y)

        return implementation

    return of_types


overload(sag_and_gradient, inline="always")(_implementation("sag_and_gradient"))
overload(sag_hessian, inline="always")(_implementation("sag_hessian"))


@overload(term_derivatives, inline="always")
def _term_derivatives(formulas: Any, code: Any, terms: Any, j: Any, x: Any, y: Any) -> Any:
    chosen = _chosen("term_derivatives", lengths_of(formulas))

    def implementation(formulas: Any, code: Any, terms: Any, j: Any, x: Any, y: Any) -> Any:
        return chosen(code, terms, j, x, y)

    return implementation


conic_sag_and_gradient = _inline(Conic.sag_and_gradient)
conic_sag_hessian = _inline(Conic.sag_hessian)
conic_term_derivatives = _inline(Conic.term_derivatives)

SOURCES = {__name__} | {base.__module__ for shape in formula_classes() for base in shape.__mro__[:-2]}
"""Modules that contain the formulas."""
