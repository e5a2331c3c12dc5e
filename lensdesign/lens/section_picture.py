"""The section of a lens as a small SVG picture for notebooks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.lens.solid import Element


def section_svg(elements: Sequence[Element], height_px: int = 140) -> str:
    """Return the meridional section of glass elements as an SVG element: z to the right, the axis dashed."""
    glass_style = "fill:#a9d3ee;stroke:#35658a;stroke-width:1"
    halves = [element.outline(33) for element in elements]
    outlines = [np.concatenate([half, half[::-1] * [-1.0, 1.0]]) for half in halves]
    corners = np.concatenate(outlines)
    (radius, last), first = np.max(corners, axis=0), float(np.min(corners[:, 1]))
    scale = 0.5 * (height_px - 8) / radius
    width = scale * (last - first) + 40.0
    paths = "".join(
        "<path d='M"
        + "L".join(f"{20.0 + scale * (z - first):.1f} {0.5 * height_px - scale * r:.1f}" for r, z in outline)
        + f"Z' style='{glass_style}'/>"
        for outline in outlines
    )
    axis = f"<path d='M0 {0.5 * height_px:g}H{width:.0f}' style='stroke:#888;stroke-dasharray:8 3 2 3'/>"
    size = f"width='{width:.0f}' height='{height_px}'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' {size}>{paths}{axis}</svg>"
