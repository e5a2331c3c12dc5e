"""Manufacturing drawings of a lens after ISO 10110: one sheet for each glass element."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import Field

from lensdesign.analysis.moulding import moulding_checks
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.text import alternatives
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element, closed_elements
from lensdesign.manufacture.drawing.asphere import asphere_panel
from lensdesign.manufacture.drawing.assumed import AssumedTolerances
from lensdesign.manufacture.drawing.moulding_list import LINE_MM as LIST_LINE_MM
from lensdesign.manufacture.drawing.moulding_list import moulding_lines, moulding_list
from lensdesign.manufacture.drawing.nominal import Stated, fitting, stated_lens
from lensdesign.manufacture.drawing.primitives import (
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
from lensdesign.manufacture.drawing.section_view import section_view
from lensdesign.manufacture.drawing.table import Material, coatings_of, data_table, material_of
from lensdesign.manufacture.drawing.tolerances import (
    DrawingTolerances,
    FormUnit,
    SurfaceTolerances,
    general_tolerances,
)

FRAME = Area(20.0, 10.0, SHEET_MM[0] - 10.0, SHEET_MM[1] - 10.0)
TITLE_TOP, TABLE_TOP = 34.0, 84.0

DRAWING_SUFFIXES = (".pdf", ".svg", ".dxf")

Label = Annotated[str, Field(max_length=1000)]


class DrawingOptions(FrozenModel):
    """Title block, tolerances and remark of a drawing.

    Attributes
    ----------
    title
        Title of the drawing (default: the title of the lens).
    number
        Number of the drawing or the part.
    revision, date, drawn_by
        Entries of the title block; an empty one is marked on the sheet as to be filled.
    form_unit
        Unit of the surface form tolerances 3/, ``fringes`` or ``nm``, on all sheets (default: fringe
        spacings, or nm where the tolerances are stated in nm).
    tolerances
        Tolerances of each glass element, front to back; None (default): general tolerances of ISO 10110-11.
    remark
        Line below the notes of each sheet (default: none).
    """

    title: Label = ""
    number: Label = ""
    revision: Label = ""
    date: Label = ""
    drawn_by: Label = ""
    form_unit: FormUnit | None = None
    tolerances: tuple[DrawingTolerances | None, ...] = ()
    remark: Label = ""


def lens_drawing(lens: Lens, options: DrawingOptions | None = None) -> Drawing:
    """Draw every glass element of a lens with its nominal values, without measured figures.

    Each sheet has a section view to scale, the table of ISO 10110-10, formula and sags of conics, aspheres,
    biconics and toroids (ISO 10110-12), and a title block. The section of a biconic or a toroid is the plane
    x = 0; a mark on the edge shows +y. A list states draft, gate and moulding checks of a moulded element.
    The left surface is the one that light meets first. The datum axis A of the centring tolerances (4/) is
    the axis of the edge at the mechanical semi-diameter of the lens.
    :func:`drawing_as_stated` rounds the values and chooses the edges.

    Parameters
    ----------
    lens
        The lens.
    options
        Title block and tolerances (default: general tolerances, empty title block).

    Returns
    -------
    Drawing
        One sheet for each glass element.

    Raises
    ------
    InputError
        If the lens has no glass element, ISO 10110-12 has no formula for a surface's shape, an element does
        not close or is too large for the general tolerances, or tolerances are given for more elements than
        the lens has.
    MaterialError
        If a glass is unknown.

    References
    ----------
    ISO 10110, "Optics and photonics: Preparation of drawings for optical elements and systems", parts 10
    (table representing data of optical elements), 11 (non-toleranced data) and 12 (aspheric surfaces).

    Examples
    --------
    >>> from lensdesign import lens_drawing, load_design
    >>> drawing = lens_drawing(load_design("designs/paper_singlet.toml"))
    >>> drawing.title, len(drawing.sheets)
    ('Spatial information transfer lens, Table 1', 1)
    """
    options = options or DrawingOptions()
    elements = closed_elements(lens)
    _check_tolerance_count(options, len(elements))
    sheets = tuple(_sheet(lens, element, options, len(elements)) for element in elements)
    return Drawing(options.title or lens.title or "Lens", sheets)


def write_drawing(drawing: Drawing, path: str | os.PathLike[str]) -> None:
    """Write a drawing as PDF, SVG or DXF.

    A PDF file has one page for each sheet. SVG and DXF files have the sheets below each other, in mm on
    paper.

    Parameters
    ----------
    drawing
        The drawing, from :func:`lens_drawing`.
    path
        File to write; its suffix, .pdf, .svg or .dxf, selects the format.

    Raises
    ------
    InputError
        If the suffix is not allowed, or the file cannot be written. An existing file then stays unchanged.

    Examples
    --------
    >>> from lensdesign import lens_drawing, load_design, write_drawing
    >>> write_drawing(lens_drawing(load_design("designs/paper_singlet.toml")), "lens.pdf")
    """
    from lensdesign.manufacture.drawing.writers import write_dxf, write_pdf, write_svg

    suffix = Path(path).suffix.lower()
    if suffix not in DRAWING_SUFFIXES:
        raise InputError(f"cannot write {path}: the name must end in {alternatives(DRAWING_SUFFIXES)}")
    with atomic_path(path) as temporary:
        dict(zip(DRAWING_SUFFIXES, (write_pdf, write_svg, write_dxf), strict=True))[suffix](
            drawing, temporary
        )


def _sheet(lens: Lens, element: Element, options: DrawingOptions, sheets: int) -> Sheet:
    tolerances = element_tolerances(element, options)
    material = material_of(lens, element, tolerances)
    sides = dict(zip(element.surfaces, (tolerances.left, tolerances.right), strict=True))
    aspheric = [i for i in element.surfaces if lens.surfaces[i].kind not in ("plane", "sphere")]
    _check_slopes(lens, sides, aspheric)
    upper = Area(FRAME.left, TABLE_TOP, FRAME.right, FRAME.top)
    checks = [check for check in moulding_checks(lens) if check.element == element.index + 1]
    # Width of the panel with formula and sags of one surface.
    panel_mm = 62.0
    view_area = upper._replace(right=upper.right - panel_mm * len(aspheric))
    list_area = Area(view_area.left + 2.0, view_area.bottom + 1.0, view_area.right - 4.0, view_area.top)
    listed = moulding_lines(element, checks, list_area.width)
    view_area = view_area._replace(bottom=view_area.bottom + len(listed) * LIST_LINE_MM)
    view = section_view(element, tolerances, view_area)
    items: list[Item] = [frame(FRAME, THICK_MM), *view.items, *moulding_list(listed, list_area)]
    for k, i in enumerate(aspheric):
        left = view_area.right + panel_mm * k
        name = "Left surface (L)" if i == element.surfaces[0] else "Right surface (R)"
        panel = Area(left, upper.bottom + 2.0, left + panel_mm, upper.top - 2.0)
        items += asphere_panel(lens, i, name, panel, sides[i])
    table = Area(FRAME.left, TITLE_TOP, FRAME.right, TABLE_TOP)
    items += data_table(element, coatings_of(lens, element), material, tolerances, table)
    mass = _mass_text(element, material.density_g_per_cm3)
    rows = _title_rows(options, lens, element, material, mass, view.scale_text, sheets)
    items += _title_block(rows, _notes(tolerances), options.remark)
    return Sheet(tuple(items))


def element_tolerances(
    element: Element, options: DrawingOptions, assumed: AssumedTolerances | None = None
) -> DrawingTolerances:
    """Return the tolerances of an element.

    Assumed values replace those of the options. Without options, the general tolerances of the element's size
    apply.

    Parameters
    ----------
    element
        The element.
    options
        Options of the drawing.
    assumed
        Values of a tolerance study (default: none).

    Raises
    ------
    InputError
        If the element is too large for the general tolerances.
    """
    base = options.tolerances[element.index] if element.index < len(options.tolerances) else None
    general = base is None
    if base is None:
        thickness = element.center_thickness_mm
        try:
            base = general_tolerances(max(2.0 * element.edge_mm, thickness))
        except InputError as error:
            raise InputError(f"{element.name}: {error}") from error
    if assumed is not None:
        base = assumed.stated(element.index, element.surfaces[0], base, general)
    return base if options.form_unit is None else base.replaced(form_unit=options.form_unit)


def drawing_as_stated(
    lens: Lens, options: DrawingOptions | None = None, assumed: AssumedTolerances | None = None
) -> tuple[Drawing, Stated]:
    """Draw a lens for manufacture: with chosen edges, rounded values and the tolerances of a study.

    Parameters
    ----------
    lens
        The lens as designed.
    options
        Title block and tolerances (default: general tolerances, empty title block).
    assumed
        Result of :func:`lensdesign.manufacture.drawing.assumed.load_tolerances`: values that a tolerance
        study assumed (default: none).

    Returns
    -------
    drawing : Drawing
        One sheet for each glass element.
    stated : Stated
        The lens of the drawing, with notes on chosen and rounded values.

    Raises
    ------
    InputError
        If :func:`lens_drawing` rejects the lens or the options, or if an element cannot be manufactured.
    """
    options = options or DrawingOptions()
    _check_tolerance_count(options, len(lens.glass_fronts))

    def tolerances_of(element: Element) -> DrawingTolerances:
        found = element_tolerances(element, options, assumed)
        given = options.tolerances[element.index] if element.index < len(options.tolerances) else None
        return fitting(element, found) if given is None else found

    stated = stated_lens(lens, tolerances_of)
    elements = closed_elements(stated.lens)
    tolerances = tuple(tolerances_of(element) for element in elements)
    tightened = tuple(
        f"{element.name}: ground diameter ±{own.diameter_mm:g} mm: more would cut into its clear aperture"
        for element, own in zip(elements, tolerances, strict=True)
        if own.diameter_mm != element_tolerances(element, options, assumed).diameter_mm
    )
    drawing = lens_drawing(stated.lens, options.replaced(tolerances=tolerances))
    return drawing, Stated(stated.lens, (*stated.notes, *tightened), tolerances)


def _check_tolerance_count(options: DrawingOptions, elements: int) -> None:
    if len(options.tolerances) > elements:
        raise InputError(
            f"tolerances are given for {len(options.tolerances)} elements, but the lens has {elements}"
        )


TitleCell = tuple[str, str, float]
"""Label, text, and width as a fraction of the frame."""


TO_BE_FILLED = "to be filled"
"""Entry of the title block without a value."""


def _check_slopes(lens: Lens, sides: dict[int, SurfaceTolerances], aspheric: list[int]) -> None:
    for index, side in sides.items():
        if side.slope is not None and index not in aspheric:
            raise InputError(
                f"slope: surface {index + 1} is a {lens.surfaces[index].kind}; a slope tolerance is allowed "
                "for conics, aspheres, biconics and toroids"
            )


def _mass_text(element: Element, density_g_per_cm3: float | None) -> str:
    volume_mm3 = element.volume_mm3 - element.gate_flat_volume_mm3
    return "" if density_g_per_cm3 is None else f"{1e-3 * density_g_per_cm3 * volume_mm3:.4g} g"


def _title_rows(
    options: DrawingOptions,
    lens: Lens,
    element: Element,
    material: Material,
    mass: str,
    scale: str,
    sheets: int,
) -> list[list[TitleCell]]:
    """Return the cells of the title block, row by row."""
    title = options.title or lens.title or "Lens"
    return [
        [
            ("Title", title, 0.52),
            ("Drawing no.", options.number, 0.22),
            ("Revision", options.revision, 0.14),
            ("Sheet", f"{element.index + 1} of {sheets}", 0.12),
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


def _title_block(rows: list[list[TitleCell]], notes: str, remark: str) -> list[Item]:
    """Draw labelled cells, with a line of notes and the remark below them."""
    notes_mm, remark_mm = 5.0, 4.0 if remark else 0.0
    step = (TITLE_TOP - FRAME.bottom - notes_mm - remark_mm) / len(rows)
    items: list[Item] = []
    for index, row in enumerate(rows):
        top = TITLE_TOP - index * step
        x = FRAME.left
        for label, text, fraction in row:
            width = fraction * FRAME.width
            items.append(cell(Area(x, top - 3.2, x + width, top - 0.4), label, 2.0))
            entry, size = (text, 3.6) if text else (TO_BE_FILLED, 2.6)
            items.append(cell(Area(x, top - step + 0.3, x + width, top - 3.3), entry, size, least_mm=2.6))
            if x > FRAME.left:
                items.append(line(x, top - step, x, top))
            x += width
        items.append(line(FRAME.left, top - step, FRAME.right, top - step))
    lines = Area(FRAME.left, FRAME.bottom + remark_mm, FRAME.right, FRAME.bottom + remark_mm + notes_mm)
    items.append(cell(lines, notes, 2.8))
    if remark:
        below = Area(FRAME.left, FRAME.bottom, FRAME.right, FRAME.bottom + remark_mm)
        items.append(cell(below, remark, 2.8))
    return items


def _notes(tolerances: DrawingTolerances) -> str:
    unit = "fringe spacings" if tolerances.form_unit == "fringes" else "nm"
    notes = [
        "Ind. according to ISO 10110",
        "dimensions in mm",
        f"3/ in {unit}, λ = {1e3 * tolerances.fringe_wavelength_um:.5g} nm",
        "4/ against datum axis A",
        "z positive to the right",
    ]
    return "; ".join([*notes, tolerances.source] if tolerances.source else notes)
