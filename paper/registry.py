"""Every element, in the paper's order."""

from __future__ import annotations

from paper.element import Element
from paper.elements.lens import matching, table

_ALL: tuple[Element, ...] = (
    *matching.ELEMENTS,
    *table.ELEMENTS,
)
ELEMENTS: dict[str, Element] = {element.key: element for element in _ALL}
