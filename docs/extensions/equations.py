"""Equations, drawn while the site is built: no scripts, no fonts, no network."""

from __future__ import annotations

import html
from typing import Any

UNITS_PER_EM = 100.0
SCALE = 1.2  # of the text around: Times looks smaller than the page's letters


def setup(app: Any) -> dict[str, bool]:
    """Let Sphinx render mathematics by this module."""
    app.add_html_math_renderer("drawn", (_inline, None), (_block, None))
    app.config.html_math_renderer = "drawn"
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(translator: Any, node: Any) -> None:
    raise NotImplementedError(f"mathematics within a line: {node.astext()}; use a block")


def _block(translator: Any, node: Any) -> None:
    from docutils.nodes import SkipNode

    lines = [line for line in node.astext().splitlines() if line.strip()]
    translator.body.append(f'<div class="equation">{"".join(map(drawn, lines))}</div>')
    raise SkipNode


def drawn(tex: str) -> str:
    """One line of TeX, as far as Matplotlib knows it, as a drawing in the colour of the text around it."""
    from matplotlib import rc_context
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path
    from matplotlib.textpath import TextPath

    with rc_context({"mathtext.fontset": "stix"}):
        shape = TextPath((0.0, 0.0), f"${tex}$", size=UNITS_PER_EM, prop=FontProperties())
    box = shape.get_extents()
    letters = {Path.MOVETO: "M", Path.LINETO: "L", Path.CURVE3: "Q", Path.CURVE4: "C", Path.CLOSEPOLY: "Z"}
    parts = []
    for points, code in shape.iter_segments(curves=True, simplify=False):
        pairs = (
            ""
            if code == Path.CLOSEPOLY
            else " ".join(f"{x - box.x0:.1f} {box.y1 - y:.1f}" for x, y in points.reshape(-1, 2))
        )
        parts.append(letters[code] + pairs)
    return (
        f'<svg role="img" aria-label="{html.escape(tex)}" viewBox="0 0 {box.width:.1f} {box.height:.1f}" '
        f'style="width: {SCALE * box.width / UNITS_PER_EM:.3f}em"><path d="{"".join(parts)}"/></svg>'
    )
