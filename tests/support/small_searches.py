"""A singlet to be found from a plate, and a check of the derivatives by which a search moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.optimization.specification.specification import Specification


def singlet_from_plate(
    field_mm: float = 3.0,
    aperture: float = 0.4,
    material: str = "N-SF11",
    thickest_mm: float = 15.0,
    sensor: dict[str, Any] | None = None,
    **more: Any,
) -> Specification:
    """A specification of a singlet with an aspheric back, by default of high index for a wide field."""
    own = {"pixel_pitch_um": 2.4, "pixels": [7000, 5472], "plane_distances_mm": [2.0, 8.0]}
    return Specification.model_validate(
        {
            "wavelengths_um": [0.532],
            "object": {
                "field_diameter_mm": field_mm,
                "numerical_aperture": aperture,
                "working_distance_mm": 13.5,
            },
            "sensor": own | (sensor or {}),
            "surface": [
                {"thickness_mm": 3.0, "material": material, "semi_diameter_mm": 7.51, "stop": True},
                {},
            ],
            "optimize": {"goal": "thinnest lens", "start": "plate", "stop": "numerical aperture"},
            "variable": [
                {"surface": 1, "parameter": "radius_mm", "smallest_radius_mm": 5.0},
                {"surface": 2, "parameter": "radius_mm", "smallest_radius_mm": 5.0},
                {"surface": 2, "parameter": "conic", "bounds": [-5.0, 1.0]},
                {"surface": 1, "parameter": "thickness_mm", "bounds": [1.0, thickest_mm]},
            ],
        }
        | more
    )


def assert_gradients(problem: DesignProblem, point: np.ndarray, rays: Rays) -> None:
    """Goals and constraints change as their derivatives say."""
    exact = problem.evaluate(point, rays)
    for j in range(len(point)):
        step = 1e-6 * np.eye(len(point))[j]
        above, below = problem.evaluate(point + step, rays), problem.evaluate(point - step, rays)
        for name in ("goals", "constraints"):
            numeric = (getattr(above, name) - getattr(below, name)) / 2e-6
            mine = getattr(exact, f"{name}_by")[:, j]
            np.testing.assert_allclose(mine, numeric, atol=2e-6 * max(1.0, np.abs(mine).max()))
