"""Whether texts and lines of a drawing keep clear of each other; lenses and tolerances to draw."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.primitives import SHEET_MM, Drawing, Sheet, Stroke
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, SurfaceTolerances

SECTIONS: dict[str, Any] = {
    "wavelengths_um": [0.532],
    "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 1000.0},
    "sensor": {"pixel_pitch_um": 3.2, "pixels": [4000, 3000], "plane_distances_mm": [2.0, 20.0]},
}

FULL = DrawingTolerances(
    left=SurfaceTolerances(
        radius_mm=0.0125,
        irregularity_fringes=0.5,
        symmetric_fringes=0.25,
        centring_arcmin=1.5,
        imperfections="3x0.16",
        laser_damage="10 J/cm²; 532 nm; 10 ns",
        chamfer_mm=(0.1, 0.3),
        coating="AR, R < 0.25 % at 532 nm, 0° to 30°",
    ),
    right=SurfaceTolerances(radius_fringes=3.0, test_diameter_mm=10.0),
    thickness_mm=0.05,
    diameter_mm=0.1,
    stress_birefringence="10",
    bubbles="3x0.1",
    inhomogeneity="2;3",
    fringe_wavelength_um=0.6328,
    density_g_per_cm3=2.51,
    source="agreed with the shop",
)


def lens_of(*surfaces: dict[str, Any], **more: Any) -> Lens:
    return Lens.model_validate(SECTIONS | {"surface": list(surfaces)} | more)


def singlet(
    front: float | None, back: float | None, thickness: float, semi: tuple[float, float], **more: Any
) -> Lens:
    return lens_of(
        {"radius_mm": front, "thickness_mm": thickness, "material": "N-BK7", "semi_diameter_mm": semi[0]},
        {"radius_mm": back, "semi_diameter_mm": semi[1]} | more,
    )


def said(sheet: Sheet) -> list[str]:
    return [text.text for text in sheet.texts]


def overlapping(one: Any, other: Any) -> Any:
    """Pairs, as indices, of rectangles (left, bottom, right, top) that have a point inside in common."""
    a, b = np.array(one)[:, None], np.array(other)[None]
    return np.argwhere(np.all((a[..., :2] < b[..., 2:]) & (b[..., :2] < a[..., 2:]), axis=-1))


def assert_tidy(drawing: Drawing) -> None:
    """Texts and lines on the page, no text over another, nor over a line along x or y."""
    for sheet in drawing.sheets:
        texts, boxes = sheet.texts, np.array([text.box for text in sheet.texts])
        assert np.all((boxes > 0.0) & (boxes < [*SHEET_MM, *SHEET_MM]))
        assert min(text.size_mm for text in texts) >= 1.6
        for i, j in overlapping(boxes, boxes):
            assert i == j, (texts[i], texts[j])
        strokes = [item for item in sheet.items if isinstance(item, Stroke)]
        points = np.concatenate([stroke.points for stroke in strokes])
        assert np.all((points > 0.0) & (points < SHEET_MM))
        pairs = np.array([stroke.points for stroke in strokes if len(stroke.points) == 2])
        straight = pairs[np.any(pairs[:, 0] == pairs[:, 1], axis=-1)]
        lines = np.concatenate([straight.min(axis=1), straight.max(axis=1)], axis=-1)
        for i, j in overlapping(boxes, lines):
            raise AssertionError((texts[i], lines[j]))
