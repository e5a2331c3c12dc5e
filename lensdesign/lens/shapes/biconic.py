"""Biconic: different conics along x and y (Zemax OpticStudio's BICONICX)::

    z = (cx x^2 + cy y^2) / (1 + sqrt(1 - (1 + kx) cx^2 x^2 - (1 + ky) cy^2 y^2))

with curvatures c = 1/radius and conic constants k. Each section through the axis is a conic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import (
    DrawnTerms,
    FormulaShape,
    Point,
    Residual,
    Section,
    curvature_of,
    radius_of,
)
from lensdesign.lens.shapes.conic import Conic


class Biconic(FormulaShape):
    """Surface with two planes of symmetry, x = 0 and y = 0."""

    NAME = "biconic"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "radius_x_mm", "conic_x")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic", "curvature_x", "conic_x")
    PARAMETERS: ClassVar[tuple[str, ...]] = KEYS
    ROTATIONAL = False

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        y, x = curvature_of(values["radius_mm"]), curvature_of(values["radius_x_mm"])
        return cls(np.array([y, values["conic"], x, values["conic_x"]]))

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        cy, ky, cx, kx = terms[0], terms[1], terms[2], terms[3]
        top = cx * x * x + cy * y * y
        root = np.sqrt(1.0 - (1.0 + kx) * cx * cx * x * x - (1.0 + ky) * cy * cy * y * y)
        over = 1.0 / (1.0 + root)
        factor = top * over * over / root
        return (
            top * over,
            (2.0 * over + (1.0 + kx) * cx * factor) * cx * x,
            (2.0 * over + (1.0 + ky) * cy * factor) * cy * y,
        )

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        cy, ky, cx, kx = terms[0], terms[1], terms[2], terms[3]
        qx, qy = (1.0 + kx) * cx * cx, (1.0 + ky) * cy * cy
        root = np.sqrt(1.0 - qx * x * x - qy * y * y)
        more, top = 1.0 + root, cx * x * x + cy * y * y
        both = root * more
        return (
            (z * more - top) * both,
            1.0,
            -(2.0 * cx * both + qx * top) * x,
            -(2.0 * cy * both + qy * top) * y,
            both * more,
        )

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        cy, ky, cx, kx = terms[0], terms[1], terms[2], terms[3]
        qx, qy = (1.0 + kx) * cx * cx, (1.0 + ky) * cy * cy
        top = cx * x * x + cy * y * y
        root = np.sqrt(1.0 - qx * x * x - qy * y * y)
        over = 1.0 / (1.0 + root)
        # First and second derivatives of f(w) = 1 / (1 + root) with respect to w = 1 - root^2.
        first = 0.5 * over * over / root
        second = 0.25 * over * over * (1.0 + 3.0 * root) * over / (root * root * root)
        along_x, along_y = 2.0 * qx * x, 2.0 * qy * y
        return (
            2.0 * cx * over
            + 4.0 * cx * x * first * along_x
            + top * (second * along_x * along_x + 2.0 * first * qx),
            2.0 * first * (cx * x * along_y + cy * y * along_x) + top * second * along_x * along_y,
            2.0 * cy * over
            + 4.0 * cy * y * first * along_y
            + top * (second * along_y * along_y + 2.0 * first * qy),
        )

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        cy, ky, cx, kx = terms[0], terms[1], terms[2], terms[3]
        qx, qy = (1.0 + kx) * cx * cx, (1.0 + ky) * cy * cy
        top = cx * x * x + cy * y * y
        root = np.sqrt(1.0 - qx * x * x - qy * y * y)
        over = 1.0 / (1.0 + root)
        first = 0.5 * over * over / root
        second = 0.25 * over * over * (1.0 + 3.0 * root) * over / (root * root * root)
        # The term changes the numerator by a u^2 and w by b u^2, with u = y for the first two terms, else x.
        if j == 0:
            a, b, of_x, of_y = 1.0, 2.0 * (1.0 + ky) * cy, 0.0, 1.0
        elif j == 1:
            a, b, of_x, of_y = 0.0, cy * cy, 0.0, 1.0
        elif j == 2:
            a, b, of_x, of_y = 1.0, 2.0 * (1.0 + kx) * cx, 1.0, 0.0
        else:
            a, b, of_x, of_y = 0.0, cx * cx, 1.0, 0.0
        u2 = of_x * x * x + of_y * y * y
        along_x, along_y = 2.0 * qx * x, 2.0 * qy * y
        mixed = a * u2 * first + top * second * b * u2
        both = a * over + top * first * b
        cross = 2.0 * first * b * u2
        return (
            u2 * both,
            mixed * along_x + 2.0 * of_x * x * both + cross * cx * x,
            mixed * along_y + 2.0 * of_y * y * both + cross * cy * y,
        )

    @staticmethod
    def start(terms: Any) -> tuple[Any, Any]:
        # A paraboloid between the two sections, since it has no edge.
        return 0.5 * (terms[0] + terms[2]), 0.0 * terms[1] - 1.0

    def ends(self) -> Array:
        y, x = ((1.0 + self.terms[..., i + 1]) * self.terms[..., i] ** 2 for i in (0, 2))
        return np.stack([y, x], axis=-1)

    @property
    def kind(self) -> str:
        return "biconic"

    def section(self, azimuth_rad: float) -> Section:
        x2, y2 = math.cos(azimuth_rad) ** 2, math.sin(azimuth_rad) ** 2
        (qy, qx), (cy, cx) = self.ends(), self.terms[::2]
        c = cx * x2 + cy * y2
        section = Conic(np.array([c, (qx * x2 + qy * y2) / (c * c) - 1.0 if c else 0.0]))
        return section.section(azimuth_rad)

    def drawn(self) -> DrawnTerms:
        cy, ky, cx, kx = map(float, self.terms)
        sections = [(name, c, k) for name, c, k in (("x", cx, kx), ("y", cy, ky)) if c]
        constants = [value for name, c, k in sections for value in ((f"R{name}", 1.0 / c), (f"k{name}", k))]
        above = " + ".join(f"{name}^2/R{name}" for name, _, _ in sections)
        below = "".join(f" − (1 + k{name}) {name}^2/R{name}^2" for name, _, _ in sections)
        return DrawnTerms("", tuple(constants), (above or "0", f"1 + √(1{below})"))

    def zemax(self) -> tuple[str, dict[int, float]]:
        radius = radius_of(float(self.terms[2])) if self.terms[2] else 0.0
        return "BICONICX", {1: radius, 2: float(self.terms[3])}

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        if kind != "BICONICX":
            return None
        return {"shape": cls.NAME, "radius_x_mm": values.get(1) or None, "conic_x": values.get(2, 0.0)}
