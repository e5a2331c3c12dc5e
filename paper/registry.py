"""Every element, in the paper's order."""

from __future__ import annotations

from paper.element import Element
from paper.elements.lens import design_process, form_errors, matching, rays, table
from paper.elements.method import slicing

_ALL: tuple[Element, ...] = (
    *matching.ELEMENTS,
    *table.ELEMENTS,
    *design_process.ELEMENTS,
    *rays.ELEMENTS,
    *form_errors.ELEMENTS,
    *slicing.ELEMENTS,
)
ELEMENTS: dict[str, Element] = {element.key: element for element in _ALL}
