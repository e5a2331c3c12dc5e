"""Plane, sphere and conic (ISO 10110-12)::

    z(r) = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2))

with curvature c = 1/radius (0 for a plane) and conic constant k.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import DrawnTerms, FormulaShape, Point, Residual, curvature_of


class Conic(FormulaShape):
    """Surface of revolution of a conic section."""

    NAME = "conic"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic")
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic")

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        return cls(np.array([curvature_of(values["radius_mm"]), values["conic"]]))

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        slope = c / root
        return c * r2 / (1.0 + root), slope * x, slope * y

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        c, q = terms[0], 1.0 + terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - q * c * c * r2)
        level = z - 0.5 * c * (r2 + q * z * z)
        return 2.0 * level * root, 1.0 - q * c * z + root, -c * x, -c * y, root

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        root = np.sqrt(1.0 - (1.0 + k) * c * c * (x * x + y * y))
        slope = c / root
        more = (1.0 + k) * slope * slope * slope
        return slope + more * x * x, more * x * y, slope + more * y * y

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        slope = 1.0 / (root * root * root)
        sag = r2 / (root * (1.0 + root))
        if j == 1:
            slope = 0.5 * c * c * c * r2 * slope
            sag = 0.5 * c * c * c * r2 * sag / (1.0 + root)
        return sag, slope * x, slope * y

    def ends(self) -> Array:
        c, k = self.terms[..., :1], self.terms[..., 1:2]
        return np.asarray((1.0 + k) * c * c)

    @property
    def kind(self) -> str:
        if self.curvature == 0.0:
            return "plane"
        return "conic" if self.terms[..., 1] else "sphere"

    def drawn(self) -> DrawnTerms:
        return DrawnTerms()

    def zemax(self) -> tuple[str, dict[int, float]]:
        return "STANDARD", {}

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        return {} if kind == "STANDARD" else None

    def codev(self) -> tuple[str, dict[str, float]]:
        return "CON", {}
