"""The compiled formulas of all registered shapes: each function takes the code of a shape and its terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numba import njit

from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.registry import shape_classes

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


def _by_term(functions: Sequence[Callable[..., Any]], code: int = 0) -> Any:
    """Return one function like :func:`_at_point`, with the index of a term after the terms."""
    own = _inline(functions[0])
    if len(functions) == 1:
        return _inline(lambda shape, terms, j, x, y: own(terms, j, x, y))
    other = _by_term(functions[1:], code + 1)

    @_inline
    def chosen(shape: int, terms: Any, j: int, x: float, y: float) -> Any:
        if shape == code:
            return own(terms, j, x, y)
        return other(shape, terms, j, x, y)

    return chosen


height = _at_point([shape.height for shape in shape_classes()])
bend = _at_point([shape.bend for shape in shape_classes()])
by_term = _by_term([shape.by_term for shape in shape_classes()])

conic_height, conic_bend, conic_by_term = (_inline(f) for f in (Conic.height, Conic.bend, Conic.by_term))

SOURCES = {__name__} | {base.__module__ for shape in shape_classes() for base in shape.__mro__[:-2]}
"""Modules that contain the formulas."""
