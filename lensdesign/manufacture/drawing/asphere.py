"""Panel of a conic, asphere, biconic or toroid on a drawing (ISO 10110-12): formula, constants, sags."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

from lensdesign.analysis.sag_tables import SagTable, radial_heights_mm, sag_table
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import DrawnTerms
from lensdesign.lens.surface import Surface
from lensdesign.manufacture.drawing.primitives import Area, Item, Text, cell, fitted, line, text_width_mm
from lensdesign.manufacture.drawing.tolerances import SurfaceTolerances

LINE_MM, TEXT_MM = 4.1, 2.6

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def asphere_panel(lens: Lens, index: int, name: str, area: Area, tolerances: SurfaceTolerances) -> list[Item]:
    """Draw formula, constants, slope tolerance and sag table of one surface.

    The sags of a biconic or a toroid are those along x and y; a note explains its orientation mark.

    Parameters
    ----------
    lens
        The lens.
    index
        Index of the surface, from 0.
    name
        Name of the surface on the drawing.
    area
        Area of the panel on the sheet.
    tolerances
        Tolerances of the surface; those of conic constant and slope are used.
    """
    surface = lens.surfaces[index]
    rotational = surface.shape.ROTATIONAL
    top = area.top - LINE_MM
    head = f"{name}: {surface.kind}; {'r' if rotational else 'x, y'}, z in mm"
    items: list[Item] = [cell(Area(area.left, top, area.right, area.top), head, 3.0)]
    drawn = surface.shape.drawn()
    conic = surface.conic if "conic" in surface.shape_keys and rotational else None
    radius = surface.radius_mm if rotational else None
    fraction = drawn.fraction or (None if radius is None else _conic_fraction(conic))
    sag = "z(r)" if rotational else "z(x, y)"
    for symbol, formula_of in ((sag, replace(drawn, fraction=fraction)), *drawn.definitions):
        formula, rows_of_formula = _formula(
            symbol, formula_of.fraction, formula_of.formula, Area(*area[:3], top)
        )
        items += formula
        top -= rows_of_formula * LINE_MM
    constants = _constants(radius, conic, drawn, tolerances.conic)
    # Largest number of constants in a column; several formulas need more of the height.
    max_rows = 6 if drawn.definitions else 11
    columns = 1 if len(constants) <= max_rows else 2
    size = min(fitted(text, area.width / columns - 3.0, TEXT_MM)[1] for text in constants)
    rows = -(-len(constants) // columns)
    width = area.width / columns
    for i, text in enumerate(constants):
        column, row = divmod(i, rows)
        x, y = area.left + column * width, top - row * LINE_MM
        items.append(cell(Area(x, y - LINE_MM, x + width, y), text, size))
    top -= (rows + 0.4) * LINE_MM
    if tolerances.slope is not None:
        for text in tolerances.slope.lines:
            items.append(cell(Area(area.left, top - LINE_MM, area.right, top), text, TEXT_MM))
            top -= LINE_MM
        top -= 0.4 * LINE_MM
    if surface.semi_diameter_mm is not None:
        # The table also has a head and a note.
        rows_left = math.floor((top - area.bottom) / LINE_MM - 3.1)
        spacing = _spacing(surface.semi_diameter_mm, min(9, rows_left - 1))
        # The drawing specifies the nominal shape, not a measured one.
        nominal = lens.with_surface(index, figure=None)
        if rotational:
            items += _sags(sag_table(nominal, index, spacing), area, top)
        else:
            items += _sags_along_x_and_y(nominal.surfaces[index], spacing, area, top)
    return items


def _constants(
    radius: float | None, conic: float | None, drawn: DrawnTerms, conic_tolerance: float | None
) -> list[str]:
    """Return the constants of the formula as texts, for r and z in mm."""
    allowed = "" if conic_tolerance is None else f" ±{conic_tolerance:g}"
    base = [] if radius is None else [f"R = {radius:.10g}"]
    base += [] if radius is None or conic is None else [f"k = {conic:.10g}{allowed}"]
    return base + [f"{_typeset(symbol)} = {value:.10g}" for symbol, value in drawn.constants]


def _typeset(formula: str) -> str:
    """Return a formula with subscripts and superscripts as characters."""
    raised = re.sub(r"\^(\d+)", lambda found: found[1].translate(SUPERSCRIPTS), formula)
    lowered = re.sub(r"_(\d+)", lambda found: found[1].translate(SUBSCRIPTS), raised)
    return re.sub(r"_m\b", "ₘ", lowered).replace("r_N", "rₙ")


def _conic_fraction(conic: float | None) -> tuple[str, str]:
    """Return numerator and denominator of the sag of a conic or a sphere (None)."""
    return "r^2", f"R (1 + √(1 − {'' if conic is None else '(1 + k) '}r^2/R^2))"


def _formula(sag: str, fraction: tuple[str, str] | None, terms: str, area: Area) -> tuple[list[Item], float]:
    """Draw the formula of a sag with a fraction bar; return also its height in lines.

    Terms that would make it small stand on a line of their own.
    """
    curved = fraction is not None
    above, below = map(_typeset, fraction or ("", ""))
    terms, width_mm = _typeset(terms), area.width - 4.0
    head, tail = f"{sag} = ", f" + {terms}" if terms and curved else terms
    conic_mm = text_width_mm(head + (below if curved else ""), 1.0)
    is_on_one_line = conic_mm + text_width_mm(tail, 1.0) <= width_mm / (0.75 * TEXT_MM) or not curved
    size = min(TEXT_MM, width_mm / (conic_mm + (text_width_mm(tail, 1.0) if is_on_one_line else 0.0)))
    x, y = area.left + 1.5, area.top - (1.4 if curved else 1.0) * LINE_MM
    items: list[Item] = [Text(x, y, head.rstrip(), size)]
    x += text_width_mm(head, size)
    if curved:
        width = text_width_mm(below, size)
        items += [
            Text(x + 0.5 * width, y + 0.36 * size + 1.0, above, size, "middle"),
            line(x, y + 0.36 * size, x + width, y + 0.36 * size, 0.2),
            Text(x + 0.5 * width, y + 0.36 * size - 0.5 - 0.8 * size, below, size, "middle"),
        ]
        x += width
    if is_on_one_line:
        x += text_width_mm(" ", size) if curved else 0.0
        rows = 2.6 if curved else 1.6
        return [*items, *([Text(x, y, tail.strip(), size)] if tail else [])], rows
    text, size = fitted(tail.strip(), width_mm, TEXT_MM)
    return [*items, Text(area.left + 3.0, y - 1.9 * LINE_MM, text, size)], 4.0


def _spacing(semi_mm: float, most_steps: int) -> float:
    """Return the smallest round spacing in mm with at most this number of steps to the rim."""
    decade = 10.0 ** math.floor(math.log10(semi_mm / most_steps))
    # These steps are so close to each other that a table with at most nine of them has 7 to 10 rows.
    steps = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * decade for step in steps if semi_mm / (step * decade) <= most_steps)


def _sags_along_x_and_y(surface: Surface, spacing_mm: float, area: Area, top: float) -> list[Item]:
    """Draw the sags of a biconic or a toroid along x and y, and the meaning of the orientation mark."""
    heights = radial_heights_mm(surface.semi_diameter_mm or 0.0, spacing_mm)
    along_x, along_y = surface.shape.sag(heights, 0.0 * heights), surface.shape.sag(0.0 * heights, heights)
    rows = [(f"{h:.5g}", f"{x:z.6f}", f"{y:z.6f}") for h, x, y in zip(heights, along_x, along_y, strict=True)]
    note = "▼ on the edge: orientation mark at +y; section x = 0"
    return _table(("h (mm)", "z(h, 0) (mm)", "z(0, h) (mm)"), rows, note, area, top)


def _sags(table: SagTable, area: Area, top: float) -> list[Item]:
    heads = ("r (mm)", "z (mm)", "dz/dr", "Δ (µm)")
    values = zip(table.radial_height_mm, table.sag_mm, table.slope, table.departure_mm, strict=True)
    rows = [(f"{r:.5g}", f"{z:z.6f}", f"{slope:z.5f}", f"{1e3 * dz:z.3f}") for r, z, slope, dz in values]
    sphere = f"the best-fit sphere of R = {table.best_fit_radius_mm:.7g} mm"
    note = f"Δ: from {'the plane' if math.isinf(table.best_fit_radius_mm) else sphere}"
    return _table(heads, rows, note, area, top)


def _table(
    heads: tuple[str, ...], rows: Sequence[tuple[str, ...]], note: str, area: Area, top: float
) -> list[Item]:
    """Draw a table of numbers with a note below it."""
    width = area.width / len(heads)
    size = min(fitted(text, width - 3.0, TEXT_MM)[1] for texts in rows for text in texts)
    items: list[Item] = []
    for row, texts in enumerate([heads, *rows]):
        y = top - row * LINE_MM
        for column, text in enumerate(texts):
            x = area.left + column * width
            items.append(cell(Area(x, y - LINE_MM, x + width, y), text, size, "end"))
    items.append(line(area.left + 1.5, top - LINE_MM, area.right - 1.5, top - LINE_MM, 0.2))
    y = top - (len(rows) + 2.1) * LINE_MM
    text, size = fitted(note, area.width - 3.0, 2.4)
    items.append(Text(area.left + 1.5, y + 0.3 * LINE_MM, text, size))
    return items
