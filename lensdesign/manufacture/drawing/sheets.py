"""Drawings of a lens for the shop that makes it, after ISO 10110: one sheet for each glass element."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_validator

from lensdesign.common.section import Section, tuples
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, closed_elements
from lensdesign.manufacture.drawing.asphere import asphere_panel
from lensdesign.manufacture.drawing.assumed import AssumedTolerances
from lensdesign.manufacture.drawing.nominal import Stated, fitting, stated_lens
from lensdesign.manufacture.drawing.section_view import section_view
from lensdesign.manufacture.drawing.strokes import (
    SHEET_MM,
    THICK_MM,
    Area,
    Drawing,
    Item,
    Sheet,
    cell,
    frame,
    line,
)
from lensdesign.manufacture.drawing.table import Material, data_table, material_of
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, general_tolerances

FRAME = Area(20.0, 10.0, SHEET_MM[0] - 10.0, SHEET_MM[1] - 10.0)
TITLE_TOP, TABLE_TOP = 34.0, 84.0
PANEL_MM = 62.0
"""Of the sheet's width, for formula and sags of one surface."""

SUFFIXES = (".pdf", ".svg")
Label = Annotated[str, Field(max_length=1000)]


class DrawingOptions(Section):
    """What a drawing says besides the lens.

    Attributes
    ----------
    title
        Of the drawing; empty for that of the lens.
    number
        Of the drawing or the part.
    date, drawn_by
        As they stand in the title block.
    tolerances
        One for each glass element, front to back; left out or None: the general tolerances of ISO 10110-11.
    remark
        Line below the notes of each sheet.
    """

    title: Label = ""
    number: Label = ""
    date: Label = ""
    drawn_by: Label = ""
    tolerances: tuple[DrawingTolerances | None, ...] = ()
    remark: Label = ""

    _lists = field_validator("tolerances", mode="before")(tuples)


def lens_drawing(lens: Lens, options: DrawingOptions | None = None) -> Drawing:
    """Draw every glass element of a lens, as designed: a measured figure is left out.

    Nothing is chosen or rounded for a shop; :func:`drawing_as_stated` does.

    Each sheet has a section to scale, the table of ISO 10110-10, formula and sags of conics and aspheres
    (ISO 10110-12) and a title block. Left is the surface that light meets first; the datum axis A, to which
    4/ refers, is that of the ground edge at the mechanical semi-diameter of the lens.

    Parameters
    ----------
    lens
        The lens.
    options
        Title block and tolerances.

    Raises
    ------
    InputError
        If there is no glass, ISO 10110-12 has no formula for a surface's shape, an element does not close or
        is too large for the general tolerances, or tolerances are given for more elements than there are.
    MaterialError
        If a glass is unknown.
    """
    options = options or DrawingOptions()
    elements = closed_elements(lens)
    _refuse_surplus(options, len(elements))
    sheets = tuple(_sheet(lens, element, options, len(elements)) for element in elements)
    return Drawing(options.title or lens.title or "Lens", sheets)


def write_drawing(drawing: Drawing, path: str | os.PathLike[str]) -> None:
    """Write a drawing as .pdf, a page for each sheet, or as .svg, the sheets below each other.

    Parameters
    ----------
    drawing
        The drawing.
    path
        The file; written over. Its ending chooses the format.

    Raises
    ------
    InputError
        If the name has another ending, or the file cannot be written; whatever stood there stays.
    """
    from lensdesign.manufacture.drawing.writers import write_pdf, write_svg

    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"cannot write {path}: the name must end in {' or '.join(SUFFIXES)}")
    with atomic_path(path) as temporary:
        (write_pdf if suffix == ".pdf" else write_svg)(drawing, temporary)


def _sheet(lens: Lens, element: Element, options: DrawingOptions, sheets: int) -> Sheet:
    tolerances = element_tolerances(element, options)
    material = material_of(lens, element, tolerances)
    aspheric = [i for i in element.surfaces if lens.surfaces[i].kind not in ("plane", "sphere")]
    upper = Area(FRAME.left, TABLE_TOP, FRAME.right, FRAME.top)
    room = upper._replace(right=upper.right - PANEL_MM * len(aspheric))
    view = section_view(element, tolerances, room)
    items: list[Item] = [frame(FRAME, THICK_MM), *view.items]
    for place, i in enumerate(aspheric):
        left = room.right + PANEL_MM * place
        name = "Left surface (L)" if i == element.surfaces[0] else "Right surface (R)"
        panel = Area(left, upper.bottom + 2.0, left + PANEL_MM, upper.top - 2.0)
        side = tolerances.left if i == element.surfaces[0] else tolerances.right
        items += asphere_panel(lens, i, name, panel, side.conic)
    media = lens.indices(lens.wavelengths_um[0])
    first, last = element.surfaces
    cemented = bool(media[first] != 1.0), bool(media[last + 1] != 1.0)
    table = Area(FRAME.left, TITLE_TOP, FRAME.right, TABLE_TOP)
    items += data_table(element, cemented, material, tolerances, table)
    items += _title_block(lens, element, options, (material, tolerances), view.scale_text, sheets)
    return Sheet(tuple(items))


def element_tolerances(
    element: Element, options: DrawingOptions, assumed: AssumedTolerances | None = None
) -> DrawingTolerances:
    """Tolerances of an element: those assumed, over those of the options or the general ones of its size.

    Raises
    ------
    InputError
        If it is too large for the general tolerances.
    """
    given = options.tolerances[element.number] if element.number < len(options.tolerances) else None
    general = given is None
    if given is None:
        thickness = element.back.vertex_z_mm - element.front.vertex_z_mm
        try:
            given = general_tolerances(max(2.0 * element.edge_mm, thickness))
        except InputError as error:
            raise InputError(f"{element.name}: {error}") from error
    if assumed is None:
        return given
    return assumed.stated(element.number, element.surfaces[0], given, general)


def drawing_as_stated(
    lens: Lens, options: DrawingOptions | None = None, assumed: AssumedTolerances | None = None
) -> tuple[Drawing, Stated]:
    """Draw a lens for a shop: edges chosen where the design has none, values rounded, tolerances as assumed.

    Parameters
    ----------
    lens
        As designed.
    options
        Title block and tolerances.
    assumed
        Of :func:`lensdesign.manufacture.drawing.assumed.load_tolerances`: what a tolerance study assumed.

    Returns
    -------
    drawing : Drawing
        As :func:`lens_drawing` makes it.
    stated : Stated
        The lens that is drawn, and what was chosen and rounded.

    Raises
    ------
    InputError
        As of :func:`lens_drawing`; also if an element cannot be made so.
    """
    options = options or DrawingOptions()
    _refuse_surplus(options, len(lens.glass_fronts))

    def tolerances_of(element: Element) -> DrawingTolerances:
        made = element_tolerances(element, options, assumed)
        given = options.tolerances[element.number] if element.number < len(options.tolerances) else None
        return fitting(element, made) if given is None else made

    stated = stated_lens(lens, tolerances_of)
    elements = closed_elements(stated.lens)
    made = tuple(tolerances_of(element) for element in elements)
    closer = tuple(
        f"{element.name}: ground diameter ±{own.diameter_mm:g} mm: more would cut into its clear aperture"
        for element, own in zip(elements, made, strict=True)
        if own.diameter_mm != element_tolerances(element, options, assumed).diameter_mm
    )
    drawing = lens_drawing(stated.lens, options.replaced(tolerances=made))
    return drawing, Stated(stated.lens, (*stated.notes, *closer), made)


def _refuse_surplus(options: DrawingOptions, elements: int) -> None:
    if len(options.tolerances) > elements:
        raise InputError(
            f"tolerances are given for {len(options.tolerances)} elements, but the lens has {elements}"
        )


def _title_block(
    lens: Lens,
    element: Element,
    options: DrawingOptions,
    made: tuple[Material, DrawingTolerances],
    scale: str,
    sheets: int,
) -> list[Item]:
    """Labelled cells in two rows, and a line of notes below them."""
    material, tolerances = made
    density = tolerances.density_g_per_cm3
    mass = "" if density is None else f"{1e-3 * density * element.volume_mm3:.4g} g"
    title = options.title or lens.title or "Lens"
    rows: list[list[tuple[str, str, float]]] = [
        [
            ("Title", title, 0.58),
            ("Drawing no.", options.number, 0.26),
            ("Sheet", f"{element.number + 1} of {sheets}", 0.16),
        ],
        [
            ("Part", element.name, 0.24),
            ("Material", material.name, 0.22),
            ("Mass", mass, 0.12),
            ("Scale", scale, 0.10),
            ("Drawn", options.drawn_by, 0.16),
            ("Date", options.date, 0.16),
        ],
    ]
    notes, remark = 5.0, 4.0 if options.remark else 0.0
    step = (TITLE_TOP - FRAME.bottom - notes - remark) / len(rows)
    items: list[Item] = []
    for number, row in enumerate(rows):
        top = TITLE_TOP - number * step
        x = FRAME.left
        for label, text, share in row:
            width = share * FRAME.width
            items.append(cell(Area(x, top - 3.2, x + width, top - 0.4), label, 2.0))
            if text:
                items.append(cell(Area(x, top - step + 0.3, x + width, top - 3.3), text, 3.6, least_mm=2.6))
            if x > FRAME.left:
                items.append(line(x, top - step, x, top))
            x += width
        items.append(line(FRAME.left, top - step, FRAME.right, top - step))
    lines = Area(FRAME.left, FRAME.bottom + remark, FRAME.right, FRAME.bottom + remark + notes)
    items.append(cell(lines, _notes(tolerances), 2.8))
    if options.remark:
        items.append(
            cell(Area(FRAME.left, FRAME.bottom, FRAME.right, FRAME.bottom + remark), options.remark, 2.8)
        )
    return items


def _notes(tolerances: DrawingTolerances) -> str:
    notes = [
        "Ind. according to ISO 10110",
        "dimensions in mm",
        f"3/ in fringe spacings, λ = {1e3 * tolerances.fringe_wavelength_um:.5g} nm",
        "4/ against datum axis A",
        "z positive to the right",
    ]
    return "; ".join([*notes, tolerances.source] if tolerances.source else notes)
