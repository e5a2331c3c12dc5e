"""The compiled formulas of all shapes: each function takes the code of a formula and its terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numba import njit

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.registry import formula_classes

# Inlined, because the call of a function of a few lines would double its cost.
_inline = njit(nogil=True, error_model="numpy", inline="always")


def _at_point(functions: Sequence[Callable[..., Any]], code: int = 0) -> Any:
    """Return one function of shape code, terms, x and y for the shapes from a code on."""
    own = _inline(functions[0])
    if len(functions) == 1:
        return _inline(lambda shape, terms, x, y: own(terms, x, y))
    other = _at_point(functions[1:], code + 1)

    @_inline
    def chosen(shape: int, terms: Any, x: float, y: float) -> Any:
        if shape == code:
            return own(terms, x, y)
        return other(shape, terms, x, y)

    return chosen


def _for_term(functions: Sequence[Callable[..., Any]], code: int = 0) -> Any:
    """Return one function like :func:`_at_point`, with the index of a term after the terms."""
    own = _inline(functions[0])
    if len(functions) == 1:
        return _inline(lambda shape, terms, j, x, y: own(terms, j, x, y))
    other = _for_term(functions[1:], code + 1)

    @_inline
    def chosen(shape: int, terms: Any, j: int, x: float, y: float) -> Any:
        if shape == code:
            return own(terms, j, x, y)
        return other(shape, terms, j, x, y)

    return chosen


sag_and_gradient = _at_point([shape.sag_and_gradient for shape in formula_classes()])
sag_hessian = _at_point([shape.sag_hessian for shape in formula_classes()])
term_derivatives = _for_term([shape.term_derivatives for shape in formula_classes()])

conic_sag_and_gradient = _inline(Conic.sag_and_gradient)
conic_sag_hessian = _inline(Conic.sag_hessian)
conic_term_derivatives = _inline(Conic.term_derivatives)

SOURCES = {__name__} | {base.__module__ for shape in formula_classes() for base in shape.__mro__[:-2]}
"""Modules that contain the formulas."""
