"""Equations in fences named math, typeset while the site is built: no scripts, no fonts, no network."""

from __future__ import annotations

import html
import re
from typing import Any

FENCE = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)
UNITS_PER_EM = 100.0
SCALE = 1.2  # of the text around: Times looks smaller than the page's letters


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put drawings in the place of TeX."""
    return FENCE.sub(_equations, markdown)


def _equations(fence: re.Match[str]) -> str:
    lines = [line for line in fence[1].splitlines() if line.strip()]
    return f'<div class="equation">{"".join(map(drawn, lines))}</div>'


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
