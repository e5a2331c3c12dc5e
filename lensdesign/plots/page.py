"""The lens in 3D as one page for a browser, which needs nothing beside itself.

The page draws with WebGL 2 by a small script of its own: lines of constant width, glass that darkens at its
rim, and a parallel projection, in which a scale bar holds.
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
from lensdesign.errors import InputError, atomic_path
from lensdesign.lens.lens import Lens
from lensdesign.plots.scene import SHARP_DEG, ScenePart, scene_parts
from lensdesign.plots.scene3d import VIEW_CHORD_SHARE

EDGE_COLORS = {"glass": "#4A7FA5", "plane": "#404040"}
"""Colours of the edges of bodies."""


@dataclass(frozen=True)
class PageSummary:
    """What a page holds.

    Attributes
    ----------
    bodies, rays, triangles
        Numbers of glass elements, rays, and triangles in all.
    bytes
        Size of the file.
    """

    bodies: int
    rays: int
    triangles: int
    bytes: int

    def as_dict(self) -> dict[str, int]:
        """For JSON."""
        return asdict(self)


def write_view(lens: Lens, path: str | os.PathLike[str]) -> PageSummary:
    """Write a page that shows the lens in a browser, turns it, and loads nothing from anywhere.

    Parameters
    ----------
    lens
        Any lens whose elements close; surfaces without a semi-diameter are as large as their footprint.
    path
        File to write, with the suffix .html.

    Raises
    ------
    InputError
        If the suffix is another, an element does not close, no light passes, or the file cannot be written.
    """
    if Path(path).suffix.lower() != ".html":
        raise InputError(f"cannot write {path}: a view is written as .html alone")
    chord_error_um = (
        1e3 * VIEW_CHORD_SHARE * lens.stop_semi_diameter_mm * max(1.0, 0.5 * len(lens.glass_fronts))
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
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("lensdesign.plots"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    legend = [{"number": i, "kind": p.kind, "color": p.color, "label": p.label} for i, p in enumerate(parts)]
    return environment.get_template("view.html.j2").render(
        title=lens.title or "Lens",
        groups=[(kind, list(group)) for kind, group in groupby(legend, lambda entry: entry["kind"])],
        figures=_figures(lens),
        chord_error=f"{chord_error_um:.2g} µm",
        scene={"smooth": math.cos(math.radians(2.0 * SHARP_DEG)), "parts": [_packed(p) for p in parts]},
    )


def _packed(part: ScenePart) -> dict[str, Any]:
    """A part as the page takes it: floats and whole numbers of 32 bits, little endian, in base 64."""
    return {
        "kind": part.kind,
        "label": part.label,
        "color": part.color,
        "edge": EDGE_COLORS.get(part.kind),
        "opacity": part.opacity,
        "below": part.label_below,
        "vertices": _base64(part.vertices, "<f4"),
        "faces": _base64(part.faces, "<u4"),
        "lines": _base64(part.lines, "<f4"),
        "points": part.lines.shape[1],
    }


def _base64(numbers: ArrayLike, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(numbers, kind).tobytes()).decode("ascii")


def _figures(lens: Lens) -> list[tuple[str, str, bool]]:
    """Name, value and whether it misses its limit, of what a reader asks first."""
    report, sensor = check_design(lens), lens.sensor
    (across, down), (width, height) = sensor.pixels, sensor.size_mm
    beyond = any(not c.met for c in report.constraints if "(Eq. 2)" in c.name)
    light = ", ".join(f"{1e3 * w:.5g}" for w in lens.wavelengths_um)
    return [
        ("field", f"Ø {lens.object.field_diameter_mm:g} mm", False),
        ("numerical aperture", f"{lens.object.numerical_aperture:g}", False),
        ("wavelength", f"{light} nm", False),
        ("resolution", f"{report.resolution_um:.3g} µm", False),
        ("working distance", f"{lens.object.working_distance_mm:g} mm", False),
        ("spread", f"{report.max_spread_deg:.3f}° (limit {report.spread_limit_deg:.3f}°)", beyond),
        ("sensor", f"{across} × {down} pixels of {sensor.pixel_pitch_um:g} µm", False),
        ("", f"{width:.4g} × {height:.4g} mm", False),
    ]
