"""Table of a drawing after ISO 10110-10: left surface, material, right surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from lensdesign.lens.coatings.coating import Coating, coating_text
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import Element
from lensdesign.lens.surface import Surface
from lensdesign.manufacture.drawing.primitives import THICK_MM, Area, Item, Text, cell, circle, frame, line
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, SurfaceTolerances

OPEN = "–"
"""Text of an indication without a value."""


@dataclass(frozen=True)
class Material:
    """Name of a glass, the rows of its column, and its density in g/cm^3 (None: unknown)."""

    name: str
    rows: tuple[str, ...]
    density_g_per_cm3: float | None = None


def material_of(lens: Lens, element: Element, tolerances: DrawingTolerances) -> Material:
    """Return name and catalogue of an element's glass, its indices and the codes 0/, 1/ and 2/."""
    from lensdesign.lens.glass import get_material, glass_summary, refractive_index

    glass = element.front.surface.material
    assert glass is not None  # every element consists of glass
    summary = glass_summary(glass, lens.glass_catalogs)
    constant = summary["catalog"] == "constant"
    name = f"n = {summary['name']}" if constant else f"{summary['name']} ({summary['catalog']})"
    fraunhofer = [] if summary["nd"] is None or constant else [f"n(587.56 nm) = {summary['nd']:.5f}"]
    if summary["vd"] is not None:
        abbe = f" ±{tolerances.abbe_percent:g} %" if tolerances.abbe_percent else ""
        abbe += tolerances.mark("abbe_percent")
        fraunhofer.append(f"ν(587.56 nm) = {summary['vd']:.2f}{abbe}")
    max_wavelengths = 2
    indices = [
        f"n({1e3 * wavelength:.6g} nm) = {refractive_index(glass, wavelength, lens.glass_catalogs):.6f}"
        for wavelength in lens.wavelengths_um[:max_wavelengths]
    ]
    if tolerances.index is not None:
        indices[-1] += f" ±{tolerances.index:g}{tolerances.mark('index')}"
    more = len(lens.wavelengths_um) - max_wavelengths
    density = tolerances.density_g_per_cm3 or get_material(glass, lens.glass_catalogs).density_g_per_cm3
    return Material(
        name,
        (
            name,
            "   ".join(fraunhofer) or OPEN,
            "   ".join(indices) + (f"   and {more} more" if more > 0 else ""),
            "",
            f"0/ {tolerances.stress_birefringence or OPEN}{tolerances.mark('stress_birefringence')}",
            f"1/ {tolerances.bubbles.replace('x', ' × ') or OPEN}{tolerances.mark('bubbles')}",
            f"2/ {tolerances.inhomogeneity or OPEN}{tolerances.mark('inhomogeneity')}",
            f"density {density:.4g} g/cm³" if density else "",
        ),
        density,
    )


def coatings_of(lens: Lens, element: Element) -> tuple[str, str]:
    """Return the coatings of an element's left and right surface in the design; empty for ideal ones.

    The films between two cemented elements belong to the right surface of the first one.
    """
    media = lens.indices(lens.wavelengths_um[0])
    first, last = element.surfaces
    texts = []
    for index, is_cemented in ((first, media[first] != 1.0), (last, media[last + 1] != 1.0)):
        coating = lens.surfaces[index].coating
        if coating in ("ideal", "bare") or (is_cemented and index == first):
            text = "uncoated" if coating == "bare" and not is_cemented else ""
        else:
            text = coating_text(coating, lens.wavelengths_um[0])
            text = f"as {text}" if isinstance(coating, Coating) and coating.file is not None else text
        texts.append(", ".join(word for word in ("cemented" if is_cemented else "", text) if word))
    return texts[0], texts[1]


def data_table(
    element: Element,
    coatings: tuple[str, str],
    material: Material,
    tolerances: DrawingTolerances,
    area: Area,
) -> list[Item]:
    """Draw the three columns of the table.

    Parameters
    ----------
    element
        Element with its left and right surface and their bevels.
    coatings
        Coatings of the left and the right surface, for sheets whose tolerances state none.
    material
        Contents of the middle column.
    tolerances
        Tolerances of the element.
    area
        Area of the table on the sheet.
    """
    (_, front_bevel), (_, back_bevel) = element.edge.sides()
    left, right = tolerances.left, tolerances.right
    left_rows = _surface_rows(element.front.surface, left, tolerances, 1.0, coatings[0], front_bevel)
    right_rows = _surface_rows(element.back.surface, right, tolerances, -1.0, coatings[1], back_bevel)
    material_rows = material.rows
    if element.front.surface.roughness is not None or element.back.surface.roughness is not None:
        left_rows = (*left_rows, _texture(element.front.surface))
        right_rows = (*right_rows, _texture(element.back.surface))
        material_rows = (*material_rows, "")
    columns = (
        ("Left surface (L)", left_rows),
        ("Material", material_rows),
        ("Right surface (R)", right_rows),
    )
    step = area.height / (len(left_rows) + 1)
    width = area.width / len(columns)
    items: list[Item] = [frame(area, THICK_MM)]
    for index, (head, rows) in enumerate(columns):
        x = area.left + index * width
        items.append(cell(Area(x, area.top - step, x + width, area.top), head, 3.2, "middle"))
        items += _column(rows, Area(x, area.bottom, x + width, area.top - step), is_surface=index != 1)
        if index:
            items.append(line(x, area.bottom, x, area.top, THICK_MM))
    items.append(line(area.left, area.top - step, area.right, area.top - step, THICK_MM))
    return items


def _column(rows: Sequence[str], area: Area, is_surface: bool) -> list[Item]:
    items: list[Item] = []
    step = area.height / len(rows)
    coating_row = 3
    for row, text in enumerate(rows):
        top = area.top - row * step
        row_area = Area(area.left, top - step, area.right, top)
        if is_surface and row == coating_row:
            x, y = area.left + 3.7, top - 0.5 * step
            items += [circle(x, y, 0.42 * step), Text(x, y - 0.9, "λ", 2.6, "middle")]
            row_area = Area(area.left + 6.0, *row_area[1:])
        if text:
            items.append(cell(row_area, text))
    return items


def _surface_rows(
    surface: Surface,
    tolerances: SurfaceTolerances,
    sheet: DrawingTolerances,
    outward: float,
    coating: str,
    bevel_mm: float,
) -> tuple[str, ...]:
    semi = surface.semi_diameter_mm
    return (
        _radius(surface, tolerances, outward, sheet.fringe_wavelength_um),
        clear_text(semi) if semi is not None else f"Øₑ {OPEN}",
        f"Prot. chamfer {_chamfer(bevel_mm, tolerances)}",
        tolerances.coating or coating or OPEN,
        _form(tolerances, sheet),
        _centring(tolerances),
        f"5/ {tolerances.imperfections.replace('x', ' × ') or OPEN}{tolerances.mark('imperfections')}",
        f"6/ {tolerances.laser_damage or OPEN}",
    )


def _texture(surface: Surface) -> str:
    """Return the surface texture of the design (ISO 10110-8): polished, with the largest Rq."""
    return f"P Rq {OPEN if surface.roughness is None else f'{surface.roughness.rms_nm:g} nm'}"


def clear_text(semi_diameter_mm: float) -> str:
    """Return the text of a clear diameter; from 1 mm on it is rounded up to 0.01 mm."""
    diameter = 2.0 * semi_diameter_mm
    return f"Øₑ {0.01 * math.ceil(100.0 * diameter - 1e-6) if diameter >= 1.0 else diameter:.6g}"


def _chamfer(bevel_mm: float, tolerances: SurfaceTolerances) -> str:
    """Return the text of the design's bevel, or else the range of the tolerances."""
    if bevel_mm:
        return f"{bevel_mm:g} × 45°"
    allowed = tolerances.chamfer_mm
    return f"{allowed[0]:g} - {allowed[1]:g}{tolerances.mark('chamfer_mm')}" if allowed else OPEN


def _centring(tolerances: SurfaceTolerances) -> str:
    """Return indication 4/, with the lateral displacement of an asphere in brackets."""
    tilt, decenter = tolerances.centring_arcmin, tolerances.decenter_mm
    displacement = f" ({decenter:g}{tolerances.mark('decenter_mm')})" if decenter is not None else ""
    angle = f"{tilt:g}′{tolerances.mark('centring_arcmin')}" if tilt is not None else OPEN
    return f"4/ {angle}{displacement}"


def _radius(surface: Surface, tolerances: SurfaceTolerances, outward: float, fringe_um: float) -> str:
    """Return the vertex radius with CX or CC; a tolerance in brackets follows from the fringes of 3/."""
    kind = "" if surface.kind in ("plane", "sphere") else f", {surface.kind}"
    sections: tuple[tuple[str, float | None], ...] = (("R", surface.radius_mm),)
    if not surface.shape.ROTATIONAL:
        sections = (("Rx", surface.radius_x_mm), ("Ry", surface.radius_mm))
    texts = (
        f"{name} {_one_radius(surface, radius, tolerances, outward, fringe_um)}" for name, radius in sections
    )
    return ", ".join(texts) + kind


def _one_radius(
    surface: Surface, radius_mm: float | None, tolerances: SurfaceTolerances, outward: float, fringe_um: float
) -> str:
    if radius_mm is None:
        return "∞"
    own = tolerances.radius_mm
    tolerance = f" ±{own:g}{tolerances.mark('radius_mm')}" if own is not None else ""
    if not tolerance and (allowed := tolerances.radius_allowed_mm(surface, fringe_um, radius_mm)):
        tolerance = f" (±{allowed:.2g})"
    side = "CX" if outward * radius_mm > 0.0 else "CC"
    return f"{abs(radius_mm):.8g}{tolerance} {side}"


def _form(tolerances: SurfaceTolerances, sheet: DrawingTolerances) -> str:
    """Return indication 3/A(B/C) in the unit of the sheet, with the test diameter if it is given."""

    def indication(name: str) -> str:
        value = getattr(tolerances, name)
        return OPEN if value is None else sheet.form_text(value, tolerances.mark(name))

    a, b, c, rms = (
        indication(name)
        for name in (
            "radius_fringes",
            "irregularity_fringes",
            "symmetric_fringes",
            "rms_irregularity_fringes",
        )
    )
    if a == b == rms == OPEN:
        return f"3/ {OPEN}"
    inner = b if c == OPEN else f"{b}/{c}"
    diameter = tolerances.test_diameter_mm
    gap = "" if sheet.form_unit == "fringes" else " "
    return (
        f"3/ {a}{gap}({inner})"
        + (f" RMSi < {rms}" if rms != OPEN else "")
        + (f" (all Ø {diameter:g}{tolerances.mark('test_diameter_mm')})" if diameter is not None else "")
    )
