"""Every element, in the paper's order."""

from __future__ import annotations

from paper.element import Element
from paper.elements.lens import design_process, form_errors, matching, rays, table
from paper.elements.method import measurement, path, refocusing, resampling, slicing
from paper.elements.results import (
    chart,
    full_size,
    future,
    influences,
    overview,
    paper_way,
    retrieval,
    spectrum,
    tissue,
)

_ALL: tuple[Element, ...] = (
    overview.FIGURE_1,
    *matching.ELEMENTS,
    *table.ELEMENTS,
    *design_process.ELEMENTS,
    *rays.ELEMENTS,
    spectrum.FIGURE_2E,
    *form_errors.ELEMENTS,
    measurement.FIGURE_3,
    *slicing.ELEMENTS,
    *refocusing.ELEMENTS,
    chart.FIGURE_5,
    full_size.FULL_SIZE,
    paper_way.THE_PAPERS_WAY,
    tissue.FIGURE_6,
    influences.FIGURE_7A,
    influences.FIGURE_7BC,
    retrieval.FIGURE_8,
    future.DISCUSSION,
    measurement.FIGURE_9,
    retrieval.FIGURE_10,
    *resampling.ELEMENTS,
    *path.ELEMENTS,
)
ELEMENTS: dict[str, Element] = {element.key: element for element in _ALL}
