"""What a drawing says of a conic or an asphere (ISO 10110-12): formula, constants, and a few sags."""

from __future__ import annotations

import math

from lensdesign.analysis.sag_tables import SagTable, sag_table
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.strokes import Area, Item, Text, cell, fitted, line, text_width_mm

LINE_MM, TEXT_MM = 4.1, 2.6
STEPS = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Round spacings within a decade, so near to each other that a table has from 7 to 10 rows."""

MOST_ROWS = 11
"""Of constants in a column."""

DIGITS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉"), str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Below and above the line."""


def asphere_panel(
    lens: Lens, number: int, name: str, area: Area, conic_tolerance: float | None = None
) -> list[Item]:
    """Formula and constants of one surface, and its sag table.

    Parameters
    ----------
    lens
        The lens.
    number
        Index of the surface, from 0.
    name
        What the drawing calls it.
    area
        Where the panel stands.
    conic_tolerance
        Of the conic constant, to both sides.
    """
    surface = lens.surfaces[number]
    top = area.top - LINE_MM
    items: list[Item] = [
        cell(Area(area.left, top, area.right, area.top), f"{name}: {surface.kind}; r, z in mm", 3.0)
    ]
    items += _formula(surface.radius_mm is not None, surface.shape.drawn(), Area(*area[:3], top))
    top -= 2.6 * LINE_MM
    constants = _constants(surface.radius_mm, surface.conic, surface.shape.drawn(), conic_tolerance)
    columns = 1 if len(constants) <= MOST_ROWS else 2
    size = min(fitted(text, area.width / columns - 3.0, TEXT_MM)[1] for text in constants)
    rows = -(-len(constants) // columns)
    width = area.width / columns
    for place, text in enumerate(constants):
        column, row = divmod(place, rows)
        x, y = area.left + column * width, top - row * LINE_MM
        items.append(cell(Area(x, y - LINE_MM, x + width, y), text, size))
    top -= (rows + 0.4) * LINE_MM
    if surface.semi_diameter_mm is not None:
        # The drawing is of the shape to be made, not of one that was measured.
        spacing = _spacing(surface.semi_diameter_mm)
        items += _sags(sag_table(lens.with_surface(number, figure=None), number, spacing), area, top)
    return items


def _constants(
    radius: float | None, conic: float, asphere: tuple[float, ...], conic_tolerance: float | None
) -> list[str]:
    """For r and z in mm, as the drawing's dimensions are."""
    allowed = "" if conic_tolerance is None else f" ±{conic_tolerance:g}"
    base = [] if radius is None else [f"R = {radius:.10g}", f"k = {conic:.10g}{allowed}"]
    terms = [
        f"A{str(order).translate(DIGITS[0])} = {value:.10g}"
        for order, value in zip(range(4, 4 + 2 * len(asphere), 2), asphere, strict=True)
    ]
    return base + terms


def _formula(curved: bool, asphere: tuple[float, ...], area: Area) -> list[Item]:
    """z(r), its fraction set as one."""
    above, below = "r²", "R (1 + √(1 − (1 + k) r²/R²))"
    count = len(asphere)
    orders = [4] if count == 1 else [4, 6] if count == 2 else [4, 2 + 2 * count]
    words = [f"A{str(n).translate(DIGITS[0])} r{str(n).translate(DIGITS[1])}" for n in orders]
    terms = (" + … + " if count > 2 else " + ").join(words) if any(asphere) else ""
    head, tail = "z(r) = ", f" + {terms}" if terms and curved else terms
    per_mm = text_width_mm(head + tail + (below if curved else ""), 1.0)
    size = min(TEXT_MM, (area.width - 4.0) / per_mm)
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
    if tail:
        items.append(Text(x + text_width_mm(" ", size), y, tail.strip(), size))
    return items


def _spacing(semi_mm: float) -> float:
    """Smallest round spacing that leads to the rim in at most nine steps."""
    decade = 10.0 ** math.floor(math.log10(semi_mm / 9.0))
    return next(step * decade for step in STEPS if semi_mm / (step * decade) <= 9.0)


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
    shown, size = fitted(note, area.width - 3.0, 2.4)
    items.append(Text(area.left + 1.5, y + 0.3 * LINE_MM, shown, size))
    return items
