"""Every shape, by one line each; the line's place is the number by which compiled rays know it."""

from __future__ import annotations

from functools import cache
from importlib import import_module

from lensdesign.lens.shapes.base import Shape, term_of

SHAPES = {
    "conic": "lensdesign.lens.shapes.conic:Conic",
    "even asphere": "lensdesign.lens.shapes.even_asphere:EvenAsphere",
    "biconic": "lensdesign.lens.shapes.biconic:Biconic",
}
"""Class of each shape, by its name in design files. The first is the one that rays meet in closed form."""


@cache
def shape_class(name: str) -> type[Shape]:
    """The class of a shape."""
    module, _, attribute = SHAPES[name].partition(":")
    found: type[Shape] = getattr(import_module(module), attribute)
    return found


@cache
def shape_classes() -> tuple[type[Shape], ...]:
    """All of them, in the registry's order."""
    return tuple(shape_class(name) for name in SHAPES)


def code_of(shape: Shape) -> int:
    """Number by which compiled rays know a shape."""
    return list(SHAPES).index(shape.NAME)


@cache
def parameters() -> dict[str, type[Shape]]:
    """What an optimizer may vary of a surface, each with a shape that has it."""
    return {name: shape for shape in reversed(shape_classes()) for name in shape.PARAMETERS}


def class_with(term: str) -> type[Shape]:
    """The first shape that has a term.

    Raises
    ------
    KeyError
        If none has.
    """
    return next(shape for name, shape in parameters().items() if term_of(name) == term)
