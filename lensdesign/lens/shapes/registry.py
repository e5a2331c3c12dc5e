"""Registry of the surface shapes, one line each; the position of the line is its code in compiled tracing."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from lensdesign.lens.shapes.base import Shape, term_of

SHAPES = {
    "conic": "lensdesign.lens.shapes.conic:Conic",
    "even asphere": "lensdesign.lens.shapes.even_asphere:EvenAsphere",
    "biconic": "lensdesign.lens.shapes.biconic:Biconic",
}
"""Class of each shape by its name in design files. Rays intersect the first one, the conic, in closed
form."""


TERM_COUNTS = (8, 12)
"""Numbers of terms for which sums over terms are unrolled in compiled tracing. Rays through shapes with more
are traced one by one, because the compiler does not unroll longer sums.
"""


def padded_count(terms: int) -> int:
    """Return the number of terms to which arrays of terms are padded for compiled tracing."""
    return next((count for count in TERM_COUNTS if count >= terms), terms)


@cache
def shape_class(name: str) -> type[Shape]:
    """Return the class of a shape by its name."""
    module, _, attribute = SHAPES[name].partition(":")
    found: type[Shape] = getattr(import_module(module), attribute)
    return found


@cache
def shape_classes() -> tuple[type[Shape], ...]:
    """Return all classes in the order of the registry."""
    return tuple(shape_class(name) for name in SHAPES)


def code_of(shape: Shape) -> int:
    """Return the code of a shape in compiled ray tracing."""
    return list(SHAPES).index(shape.NAME)


@cache
def parameters() -> dict[str, type[Shape]]:
    """Return the surface parameters that an optimizer may vary, each with the first shape that has it."""
    return {name: shape for shape in reversed(shape_classes()) for name in shape.PARAMETERS}


def class_with(term: str) -> type[Shape]:
    """Return the first shape that has a term.

    Raises
    ------
    StopIteration
        If no shape has the term.
    """
    return next(shape for name, shape in parameters().items() if term_of(name) == term)
