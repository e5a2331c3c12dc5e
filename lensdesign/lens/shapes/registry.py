"""Registry of the surface shapes, one line each, and of the formulas with which rays are traced."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from lensdesign.lens.shapes.base import FormulaShape, Shape, term_of

SHAPES = {
    "conic": "lensdesign.lens.shapes.conic:Conic",
    "even asphere": "lensdesign.lens.shapes.even_asphere:EvenAsphere",
    "odd asphere": "lensdesign.lens.shapes.odd_asphere:OddAsphere",
    "biconic": "lensdesign.lens.shapes.biconic:Biconic",
    "toroid": "lensdesign.lens.shapes.toroid:Toroid",
    "Qcon": "lensdesign.lens.shapes.forbes:Qcon",
    "Qbfs": "lensdesign.lens.shapes.forbes:Qbfs",
}
"""Class of each shape by its name in design files."""

FORMULAS = (
    "lensdesign.lens.shapes.conic:Conic",
    "lensdesign.lens.shapes.even_asphere:EvenAsphere",
    "lensdesign.lens.shapes.biconic:Biconic",
    "lensdesign.lens.shapes.sphere_departure:SphereDeparture",
    "lensdesign.lens.shapes.odd_asphere:OddAsphere",
    "lensdesign.lens.shapes.toroid:Toroid",
)
"""Classes of the formulas; the position is the code in compiled tracing. Rays intersect the first one, the
conic, in closed form.
"""

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
    found: type[Shape] = _loaded(SHAPES[name])
    return found


@cache
def shape_classes() -> tuple[type[Shape], ...]:
    """Return all classes in the order of the registry."""
    return tuple(shape_class(name) for name in SHAPES)


@cache
def formula_classes() -> tuple[type[FormulaShape], ...]:
    """Return all classes of formulas in the order of their codes."""
    return tuple(map(_loaded, FORMULAS))


def _loaded(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


def code_of(shape: FormulaShape) -> int:
    """Return the code of a formula in compiled ray tracing."""
    return formula_classes().index(type(shape))


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
