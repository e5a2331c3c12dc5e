"""Panel of a conic or an asphere on a drawing (ISO 10110-12): formula, constants and a sag table."""

from __future__ import annotations

import math
import re

from lensdesign.analysis.sag_tables import SagTable, sag_table
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import DrawnTerms
from lensdesign.manufacture.drawing.primitives import Area, Item, Text, cell, fitted, line, text_width_mm

LINE_MM, TEXT_MM = 4.1, 2.6

SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


def asphere_panel(
    lens: Lens, index: int, name: str, area: Area, conic_tolerance: float | None = None
) -> list[Item]:
    """Draw formula, constants and sag table of one surface.

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
    conic_tolerance
        Tolerance (±) of the conic constant (default: none).
    """
    surface = lens.surfaces[index]
    top = area.top - LINE_MM
    items: list[Item] = [
        cell(Area(area.left, top, area.right, area.top), f"{name}: {surface.kind}; r, z in mm", 3.0)
    ]
    drawn = surface.shape.drawn()
    conic = surface.conic if "conic" in surface.shape_keys else None
    formula, rows_of_formula = _formula(surface.radius_mm, conic, drawn, Area(*area[:3], top))
    items += formula
    top -= rows_of_formula * LINE_MM
    constants = _constants(surface.radius_mm, conic, drawn, conic_tolerance)
    # Largest number of constants in a column.
    max_rows = 11
    columns = 1 if len(constants) <= max_rows else 2
    size = min(fitted(text, area.width / columns - 3.0, TEXT_MM)[1] for text in constants)
    rows = -(-len(constants) // columns)
    width = area.width / columns
    for i, text in enumerate(constants):
        column, row = divmod(i, rows)
        x, y = area.left + column * width, top - row * LINE_MM
        items.append(cell(Area(x, y - LINE_MM, x + width, y), text, size))
    top -= (rows + 0.4) * LINE_MM
    if surface.semi_diameter_mm is not None:
        # The drawing specifies the nominal shape, not a measured one.
        spacing = _spacing(surface.semi_diameter_mm)
        items += _sags(sag_table(lens.with_surface(index, figure=None), index, spacing), area, top)
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


def _formula(
    radius: float | None, conic: float | None, drawn: DrawnTerms, area: Area
) -> tuple[list[Item], float]:
    """Draw the formula z(r) with a fraction bar; return also its height in lines.

    Terms that would make it small stand on a line of their own.
    """
    curved, above = radius is not None, "r²"
    below = f"R (1 + √(1 − {'' if conic is None else '(1 + k) '}r²/R²))"
    terms, width_mm = _typeset(drawn.formula), area.width - 4.0
    head, tail = "z(r) = ", f" + {terms}" if terms and curved else terms
    conic_mm = text_width_mm(head + (below if curved else ""), 1.0)
    is_on_one_line = conic_mm + text_width_mm(tail, 1.0) <= width_mm / (0.75 * TEXT_MM) or not curved
    size = min(TEXT_MM, width_mm / (conic_mm + (text_width_mm(tail, 1.0) if is_on_one_line else 0.0)))
    x, y = area.left + 1.5, area.top - 1.4 * LINE_MM
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
        return [*items, *([Text(x + text_width_mm(" ", size), y, tail.strip(), size)] if tail else [])], 2.6
    text, size = fitted(tail.strip(), width_mm, TEXT_MM)
    return [*items, Text(area.left + 3.0, y - 1.9 * LINE_MM, text, size)], 4.0


def _spacing(semi_mm: float) -> float:
    """Return the smallest round spacing in mm with at most nine steps to the rim."""
    decade = 10.0 ** math.floor(math.log10(semi_mm / 9.0))
    # These steps are so close to each other that a table has 7 to 10 rows.
    steps = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * decade for step in steps if semi_mm / (step * decade) <= 9.0)


def _sags(table: SagTable, area: Area, top: float) -> list[Item]:
    heads = ("r (mm)", "z (mm)", "dz/dr", "Δ (µm)")
    values = zip(table.radial_height_mm, table.sag_mm, table.slope, table.departure_mm, strict=True)
    rows = [(f"{r:.5g}", f"{z:z.6f}", f"{slope:z.5f}", f"{1e3 * dz:z.3f}") for r, z, slope, dz in values]
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
    sphere = f"the best-fit sphere of R = {table.best_fit_radius_mm:.7g} mm"
    note = f"Δ: from {'the plane' if math.isinf(table.best_fit_radius_mm) else sphere}"
    text, size = fitted(note, area.width - 3.0, 2.4)
    items.append(Text(area.left + 1.5, y + 0.3 * LINE_MM, text, size))
    return items
