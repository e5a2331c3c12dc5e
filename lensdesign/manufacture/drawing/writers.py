"""Writers of drawings: PDF with a page for each sheet, or SVG with the sheets below each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from lensdesign.manufacture.drawing.primitives import (
    FONT,
    SHEET_MM,
    Drawing,
    Item,
    Stroke,
    Text,
    plain,
    register_font,
)


def write_pdf(drawing: Drawing, path: Path) -> None:
    """Write a PDF; the same drawing yields identical bytes."""
    from reportlab.pdfgen.canvas import Canvas

    register_font()
    points_per_mm = 72.0 / 25.4
    canvas = Canvas(str(path), pagesize=tuple(points_per_mm * side for side in SHEET_MM), invariant=1)
    canvas.setTitle(plain(drawing.title))
    canvas.setCreator("lensdesign")
    for sheet in drawing.sheets:
        canvas.scale(points_per_mm, points_per_mm)
        canvas.setLineCap(1)
        canvas.setLineJoin(1)
        for item in sheet.items:
            _to_canvas(canvas, item)
        canvas.showPage()
    canvas.save()


def _to_canvas(canvas: Any, item: Item) -> None:
    if isinstance(item, Text):
        canvas.saveState()
        canvas.translate(item.x_mm, item.y_mm)
        canvas.rotate(90.0 if item.upward else 0.0)
        canvas.setFont(FONT, item.size_mm)
        draw = {"start": canvas.drawString, "middle": canvas.drawCentredString, "end": canvas.drawRightString}
        draw[item.anchor](0.0, 0.0, item.text)
        canvas.restoreState()
        return
    canvas.setLineWidth(item.width_mm)
    canvas.setDash(list(item.dashes_mm))
    path = canvas.beginPath()
    path.moveTo(*item.points[0])
    for point in item.points[1:]:
        path.lineTo(*point)
    if item.closed:
        path.close()
    canvas.drawPath(path, stroke=1, fill=int(item.filled))


def write_svg(drawing: Drawing, path: Path) -> None:
    """Write an SVG in mm; texts keep their width even if the viewer lacks the font."""
    width, height = SHEET_MM
    # Distance between the sheets of an SVG.
    gap_mm = 8.0
    total = len(drawing.sheets) * (height + gap_mm) - gap_mm
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{total:g}mm" '
        f'viewBox="0 0 {width:g} {total:g}">',
        f"<title>{escape(plain(drawing.title))}</title>",
        f'<rect width="{width:g}" height="{total:g}" fill="white"/>',
    ]
    for index, sheet in enumerate(drawing.sheets):
        top = index * (height + gap_mm)
        lines.append(
            f'<g transform="translate(0 {top:g})" fill="none" stroke="black" stroke-linecap="round" '
            f'stroke-linejoin="round" font-family="\'DejaVu Sans\', sans-serif">'
        )
        lines += [_svg_text(item) if isinstance(item, Text) else _svg_stroke(item) for item in sheet.items]
        lines.append("</g>")
    path.write_text("\n".join([*lines, "</svg>", ""]), encoding="utf-8")


def _svg_stroke(item: Stroke) -> str:
    points = " ".join(f"{x:.4f},{SHEET_MM[1] - y:.4f}" for x, y in item.points)
    dashes = f' stroke-dasharray="{" ".join(f"{d:g}" for d in item.dashes_mm)}"' if item.dashes_mm else ""
    fill = ' fill="black"' if item.filled else ""
    name = "polygon" if item.closed else "polyline"
    return f'<{name} points="{points}" stroke-width="{item.width_mm:g}"{dashes}{fill}/>'


def _svg_text(item: Text) -> str:
    x, y = item.x_mm, SHEET_MM[1] - item.y_mm
    rotation = f' transform="rotate(-90 {x:.4f} {y:.4f})"' if item.upward else ""
    return (
        f'<text x="{x:.4f}" y="{y:.4f}" font-size="{item.size_mm:.4f}" text-anchor="{item.anchor}" '
        f'textLength="{item.width_mm:.4f}" lengthAdjust="spacingAndGlyphs" xml:space="preserve" '
        f'fill="black" stroke="none"{rotation}>{escape(item.text)}</text>'
    )
