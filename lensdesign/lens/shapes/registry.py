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

FORMULAS: dict[str, tuple[int, ...]] = {
    "lensdesign.lens.shapes.conic:Conic": (),
    "lensdesign.lens.shapes.even_asphere:EvenAsphere": (4, 8, 12),
    "lensdesign.lens.shapes.biconic:Biconic": (4,),
    "lensdesign.lens.shapes.sphere_departure:SphereDeparture": (4, 8, 12),
    "lensdesign.lens.shapes.odd_asphere:OddAsphere": (4, 8),
    "lensdesign.lens.shapes.toroid:Toroid": (4, 8),
}
"""Classes of the formulas, with the numbers of terms for which compiled tracing unrolls their sums.

The position is the code of a formula in compiled tracing. Rays intersect the first one, the conic, in closed
form. Rays through shapes with more terms are traced one by one, because the compiler does not unroll longer
sums.
"""

TERM_COUNTS = (4, 8, 12)
"""Numbers of terms to which arrays of terms are padded."""


FormulaLengths = tuple[tuple[None, ...], ...]
"""For each formula but the first, a tuple as long as the sums of terms that are compiled for it; empty if the
formula is not needed, or its sums are not unrolled. Numba compiles a kernel for each type of its arguments,
and the lengths of tuples belong to their type."""


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
def unrolled_count(code: int, terms: int) -> int:
    """Return for how many terms sums of a formula are unrolled if arrays of terms have a given length.

    The result is 0 if the formula has more terms than are unrolled.
    """
    counts, most = tuple(FORMULAS.values())[code], len(formula_classes()[code].TERMS)
    return next((count for count in counts if count >= min(terms, most)), 0)


@cache
def needed_formulas(codes: bytes, terms: int) -> FormulaLengths:
    """Return the formulas that a kernel needs, for the codes of all surfaces and their number of terms."""
    return tuple(
        (None,) * max(1, unrolled_count(code, terms)) if code in codes else ()
        for code in range(1, len(FORMULAS))
    )


@cache
def parameters() -> dict[str, type[Shape]]:
    """Return the surface parameters that an optimizer may vary, each with the first shape that has it."""
    found: dict[str, type[Shape]] = {}
    for shape in shape_classes():
        for name in shape.PARAMETERS:
            found.setdefault(name, shape)
    return found


def class_with(term: str) -> type[Shape]:
    """Return the first shape that has a term.

    Raises
    ------
    StopIteration
        If no shape has the term.
    """
    return next(shape for name, shape in parameters().items() if term_of(name) == term)
