"""The lens in 3D as a self-contained page for a browser.

The page draws with WebGL 2 by a small script: lines of constant width, glass that darkens at its rim, and a
parallel projection, in which a scale bar is valid everywhere.
"""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.analysis.check import check_design
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.notebook import page_template
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.plots.scene import SHARP_DEG, ScenePart, scene_parts
from lensdesign.plots.scene3d import VIEW_CHORD_FRACTION


@dataclass(frozen=True)
class PageSummary:
    """Contents of a page.

    Attributes
    ----------
    bodies, rays, triangles
        Number of glass elements, of rays, and of all triangles.
    bytes
        Size of the file in bytes.
    """

    bodies: int
    rays: int
    triangles: int
    bytes: int

    def as_dict(self) -> dict[str, int]:
        """Return the summary as a dictionary for JSON."""
        return asdict(self)


def write_view(lens: Lens, path: str | os.PathLike[str]) -> PageSummary:
    """Write a self-contained HTML page with a 3D view of a lens that the reader can rotate.

    Parameters
    ----------
    lens
        A lens whose elements close. Surfaces without a semi-diameter have the size of their footprint.
    path
        File to write, with the suffix .html.

    Returns
    -------
    PageSummary
        Number of bodies, rays and triangles, and size of the file.

    Raises
    ------
    InputError
        If the suffix is not .html, an element does not close, no light passes, or the file cannot be
        written.

    Examples
    --------
    >>> from lensdesign import load_design, write_view
    >>> page = write_view(load_design("designs/paper_singlet.toml"), "lens.html")
    >>> page.bodies, page.rays
    (1, 57)
    """
    if Path(path).suffix.lower() != ".html":
        raise InputError(f"cannot write {path}: the name of a view must end in .html")
    chord_error_um = (
        1e3 * VIEW_CHORD_FRACTION * lens.stop_semi_diameter_mm * max(1.0, 0.5 * len(lens.glass_fronts))
    )
    parts = scene_parts(lens, chord_error_um)
    data = _page(lens, parts, chord_error_um).encode()
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
    return PageSummary(
        bodies=sum(part.kind == "glass" for part in parts),
        rays=sum(len(part.lines) for part in parts if part.kind == "rays"),
        triangles=sum(len(part.faces) for part in parts),
        bytes=len(data),
    )


def _page(lens: Lens, parts: Sequence[ScenePart], chord_error_um: float) -> str:
    legend = [{"number": i, "kind": p.kind, "color": p.color, "label": p.label} for i, p in enumerate(parts)]
    return page_template("lensdesign.plots", "view.html.j2").render(
        title=lens.title or "Lens",
        groups=[(kind, list(group)) for kind, group in groupby(legend, lambda entry: entry["kind"])],
        facts=_facts(lens),
        chord_error=f"{chord_error_um:.2g} µm",
        scene={"smooth": math.cos(math.radians(2.0 * SHARP_DEG)), "parts": [_packed(p) for p in parts]},
    )


def _packed(scene_part: ScenePart) -> dict[str, Any]:
    """Return a part for the page's script: 32-bit floats and integers, little endian, in base 64."""
    edge_colors = {"glass": "#4A7FA5", "plane": "#404040"}
    return {
        "kind": scene_part.kind,
        "label": scene_part.label,
        "color": scene_part.color,
        "edge": edge_colors.get(scene_part.kind),
        "opacity": scene_part.opacity,
        "below": scene_part.label_below,
        "vertices": _base64(scene_part.vertices, "<f4"),
        "faces": _base64(scene_part.faces, "<u4"),
        "lines": _base64(scene_part.lines, "<f4"),
        "points": scene_part.lines.shape[1],
    }


def _base64(values: ArrayLike, dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype).tobytes()).decode("ascii")


def _facts(lens: Lens) -> list[tuple[str, str, bool]]:
    """Return name, value, and whether a limit is violated, of the main properties of the lens."""
    report, sensor = check_design(lens), lens.sensor
    (columns, rows), (width, height) = sensor.pixels, sensor.size_mm
    beyond = any(not c.met for c in report.constraints if "(Eq. 2)" in c.name)
    light = ", ".join(f"{1e3 * w:.5g}" for w in lens.wavelengths_um)
    return [
        ("field", f"Ø {lens.object.field_diameter_mm:g} mm", False),
        ("numerical aperture", f"{lens.object.numerical_aperture:g}", False),
        ("wavelength", f"{light} nm", False),
        ("resolution", f"{report.resolution_um:.3g} µm", False),
        ("working distance", f"{lens.object.working_distance_mm:g} mm", False),
        ("spread", f"{report.max_spread_deg:.3f}° (limit {report.spread_limit_deg:.3f}°)", beyond),
        ("sensor", f"{columns} × {rows} pixels of {sensor.pixel_pitch_um:g} µm", False),
        ("", f"{width:.4g} × {height:.4g} mm", False),
    ]
