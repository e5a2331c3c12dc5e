"""Lenses that tests make of a few surfaces, where object and sensor do not matter."""

from __future__ import annotations

from typing import Any

from lensdesign import Lens


def lens_of(*surfaces: dict[str, Any], **others: Any) -> Lens:
    """A lens of surfaces given as in a design file, before a sensor of two planes."""
    return Lens.model_validate(
        {
            "wavelengths_um": [0.532],
            "object": {"field_diameter_mm": 1.0, "numerical_aperture": 0.1, "working_distance_mm": 50.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [4000, 3000], "plane_distances_mm": [2.0, 20.0]},
            "surface": list(surfaces),
        }
        | others
    )
