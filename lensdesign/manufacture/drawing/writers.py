"""Writers of drawings: PDF with a page for each sheet, or SVG and DXF with the sheets below each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from lensdesign.manufacture.drawing.primitives import (
    CENTRE_LINE_DASHES,
    FONT,
    SHEET_MM,
    THICK_MM,
    Drawing,
    Item,
    Stroke,
    Text,
    plain,
    register_font,
)
from lensdesign.manufacture.dxf.dxf_files import CENTRE_LINE, new_document, save_document

SHEET_GAP_MM = 8.0
"""Distance between the sheets of an SVG or DXF file."""


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
    total = len(drawing.sheets) * (height + SHEET_GAP_MM) - SHEET_GAP_MM
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{total:g}mm" '
        f'viewBox="0 0 {width:g} {total:g}">',
        f"<title>{escape(plain(drawing.title))}</title>",
        f'<rect width="{width:g}" height="{total:g}" fill="white"/>',
    ]
    for index, sheet in enumerate(drawing.sheets):
        top = index * (height + SHEET_GAP_MM)
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


def write_dxf(drawing: Drawing, path: Path) -> None:
    """Write a DXF in mm on paper: lines, centre lines, filled areas and texts, each kind on its own layer."""
    document = new_document({"title": plain(drawing.title)}, CENTRE_LINE_DASHES)
    space = document.modelspace()
    for layer in ("VISIBLE_EDGES", "THIN_LINES", "FILLED", "TEXT"):
        document.layers.add(layer)
    document.layers.add("CENTRE_LINES", linetype=CENTRE_LINE)
    document.styles.add(FONT, font=f"{FONT}.ttf")
    for index, sheet in enumerate(drawing.sheets):
        bottom = -index * (SHEET_MM[1] + SHEET_GAP_MM)
        for item in sheet.items:
            if isinstance(item, Text):
                _dxf_text(space, item, bottom)
            else:
                _dxf_stroke(space, item, bottom)
    save_document(document, path)


def _dxf_stroke(space: Any, item: Stroke, bottom: float) -> None:
    from ezdxf.lldxf.const import VALID_DXF_LINEWEIGHTS

    points = [(x, bottom + y) for x, y in item.points]
    if item.filled:
        space.add_hatch(dxfattribs={"layer": "FILLED"}).paths.add_polyline_path(points, is_closed=True)
        return
    lines = (
        "CENTRE_LINES" if item.dashes_mm else "VISIBLE_EDGES" if item.width_mm >= THICK_MM else "THIN_LINES"
    )
    weight = min(VALID_DXF_LINEWEIGHTS, key=lambda allowed: abs(allowed - 100.0 * item.width_mm))
    space.add_lwpolyline(points, close=item.closed, dxfattribs={"layer": lines, "lineweight": weight})


def _dxf_text(space: Any, item: Text, bottom: float) -> None:
    """Add a text that keeps its width even if the viewer lacks the font."""
    from ezdxf.enums import TextEntityAlignment

    if not item.text.strip():
        return
    left, low, right, high = item.box
    ends = ((item.x_mm, low), (item.x_mm, high)) if item.upward else ((left, item.y_mm), (right, item.y_mm))
    # The height of a DXF text is that of its capital letters, here in DejaVu Sans.
    height = 0.729 * item.size_mm
    text = space.add_text(item.text, height=height, dxfattribs={"layer": "TEXT", "style": FONT})
    start, end = ((x, bottom + y) for x, y in ends)
    text.set_placement(start, end, align=TextEntityAlignment.FIT)
