"""Toroid: a curve in the y-z plane, rotated about an axis parallel to y (Zemax OpticStudio's TOROIDAL)::

    z = g + C x^2 / (D + S),    D = 1 - C g,    S = sqrt(D^2 - C^2 x^2)

The curve is that of an even asphere, g(y) = conic + a4 y^4 + a6 y^6 + ... The axis of rotation lies at
z = R_x = 1 / C. Sections along x are circles; without a curvature C the surface is a cylinder.
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
    with_coefficient,
)
from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.even_asphere import (
    ORDERS,
    EvenAsphere,
    drawn_powers,
    without_zeros,
    written_coefficients,
)

ZEMAX_TERMS = range(3, 9)
"""Zemax's numbers of the coefficients of y^4 to y^14. Number 2, of y^2, has no counterpart in a design."""


class Toroid(FormulaShape):
    """Surface with two planes of symmetry, x = 0 and y = 0, and circles as sections along x."""

    NAME = "toroid"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "radius_x_mm", "asphere")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic", "curvature_x", *ORDERS)
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "radius_x_mm", *ORDERS[:9])
    ROTATIONAL = False
    COORDINATE = "y"
    ZEMAX_LOST: ClassVar[Mapping[int, str]] = {
        0: "extrapolation beyond the surface",
        2: "toroid term in y^2",
        13: "number of Zernike terms",
    }

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        y, x = curvature_of(values["radius_mm"]), curvature_of(values["radius_x_mm"])
        return cls(np.array([y, values["conic"], x, *values["asphere"]]))

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        c, k, across = terms[0], terms[1], terms[2]
        y2 = y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * y2)
        curve = c * y2 / (1.0 + root)
        slope = 0.5 * c / root
        power = y2
        for j in range(3, len(terms)):
            slope = slope + (j - 1) * terms[j] * power
            power = power * y2
            curve = curve + terms[j] * power
        d, u = 1.0 - across * curve, across * x
        s = np.sqrt(d - u) * np.sqrt(d + u)  # not a number beyond the axis of rotation, too
        return curve + across * x * x / (d + s), across * x / s, 2.0 * slope * y * d / s

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        c, q, across = terms[0], 1.0 + terms[1], terms[2]
        y2 = y * y
        root = np.sqrt(1.0 - q * c * c * y2)
        over = 1.0 / (root * (1.0 + root))
        curve, slope = c * y2 * root * over, 0.5 * c * (1.0 + root) * over
        power = y2
        for j in range(3, len(terms)):
            slope = slope + (j - 1) * terms[j] * power
            power = power * y2
            curve = curve + terms[j] * power
        d, u = 1.0 - across * curve, across * x
        s = np.copysign(np.sqrt(d * d - u * u), d)  # negative beyond the axis of rotation
        level = z - curve - 0.5 * across * (x * x + z * z - curve * curve)
        return 2.0 * level * s, 1.0 - across * z + s, -u, -2.0 * slope * y * d, s

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        c, k, across = terms[0], terms[1], terms[2]
        y2 = y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * y2)
        curve, slope, bend = c * y2 / (1.0 + root), c / root, c / (root * root * root)
        power = y2
        for j in range(3, len(terms)):
            slope = slope + 2 * (j - 1) * terms[j] * power
            bend = bend + 2 * (j - 1) * (2 * j - 3) * terms[j] * power
            power = power * y2
            curve = curve + terms[j] * power
        d = 1.0 - across * curve
        over = 1.0 / np.sqrt(d * d - across * across * x * x)
        by_x, by_curve = across * x * over, slope * y
        by_y = by_curve * d * over
        return (
            across * (1.0 + by_x * by_x) * over,
            across * by_x * by_y * over,
            (d * bend + across * (by_y * by_y - by_curve * by_curve)) * over,
        )

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        c, k, across = terms[0], terms[1], terms[2]
        y2 = y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * y2)
        curve, slope = c * y2 / (1.0 + root), c / root
        power = y2
        for i in range(3, len(terms)):
            slope = slope + 2 * (i - 1) * terms[i] * power
            power = power * y2
            curve = curve + terms[i] * power
        d = 1.0 - across * curve
        over = 1.0 / np.sqrt(d * d - across * across * x * x)
        by_x, by_y = across * x * over, slope * y * d * over
        if j == 2:
            sum_over = over / (1.0 + d * over)
            factor = x * x * over * sum_over
            along_x, along_y = sum_over * by_x + over * by_x, sum_over * (slope * y + by_y) + over * by_y
            return (
                factor,
                2.0 * x * over * sum_over + across * factor * along_x,
                across * factor * along_y,
            )
        if j >= 3:
            change = y2 ** (j - 1)
            change_of_slope = 2.0 * (j - 1) * y2 ** (j - 2) * y
        else:
            change = y2 / (root * (1.0 + root))
            change_of_slope = y / (root * root * root)
            if j == 1:
                change = 0.5 * c * c * c * y2 * change / (1.0 + root)
                change_of_slope = 0.5 * c * c * c * y2 * change_of_slope
        return (
            d * change * over,
            across * d * change * by_x * over * over,
            (d * change_of_slope + across * change * (d * by_y * over - slope * y)) * over,
        )

    @staticmethod
    def start(terms: Any) -> tuple[Any, Any]:
        # A paraboloid between the two sections, since it has no edge.
        return 0.5 * (terms[0] + terms[2]), 0.0 * terms[1] - 1.0

    def ends(self) -> Array:
        terms = np.moveaxis(self.terms, -1, 0)[..., None]
        along_y, across = (1.0 + terms[1]) * terms[0] ** 2, terms[2]
        # A circle along x ends as far from the axis of rotation as the curve; the nearest such point counts.
        # It is sought twice, the second time near the first result.
        fractions = np.linspace(0.0, 1.0, 257)
        with np.errstate(divide="ignore", invalid="ignore"):
            end_mm = (1.0 - 1e-12) / np.sqrt(np.maximum(along_y, across * across))
            start_mm = 0.0 * end_mm
            for _ in range(2):
                y_mm = np.where(across == 0.0, 0.0, start_mm + fractions * (end_mm - start_mm))
                curve = EvenAsphere.sag_and_gradient(np.delete(terms, 2, axis=0), 0.0, y_mm)[0]
                reach_mm = np.maximum((1.0 - across * curve) / np.abs(across), 0.0)
                squares = reach_mm**2 + y_mm**2
                nearest = np.argmin(np.real(squares), axis=-1, keepdims=True)
                start_mm, end_mm = (
                    np.take_along_axis(y_mm, np.clip(nearest + step, 0, len(fractions) - 1), axis=-1)
                    for step in (-1, 1)
                )
            along_x = 1.0 / np.take_along_axis(squares, nearest, axis=-1)
        return np.concatenate([along_y, np.where(across == 0.0, 0.0, along_x)], axis=-1)

    @property
    def kind(self) -> str:
        return self.NAME

    def section(self, azimuth_rad: float) -> Section:
        across, down = math.cos(azimuth_rad), math.sin(azimuth_rad)
        rounding = 1e-12
        if abs(down) < rounding:
            return Conic(np.array([self.terms[2], 0.0])).section(azimuth_rad)
        if abs(across) < rounding:
            return EvenAsphere(np.delete(self.terms, 2)).section(azimuth_rad)
        paraboloid = float(self.terms[0] * down**2 + self.terms[2] * across**2)

        def departure(r: Array) -> tuple[Array, Array]:
            sag, by_x, by_y = self.sag_and_slopes(r * across, r * down)
            return sag - 0.5 * paraboloid * r * r, by_x * across + by_y * down - paraboloid * r

        return Section(self.kind, paraboloid, -1.0, math.inf, departure)

    def drawn(self) -> DrawnTerms:
        c, k, across = map(float, self.terms[:3])
        powers = drawn_powers("A", range(4, 2 * len(self.terms) - 2, 2), self.terms[3:], "y")
        constants = [("Rx", 1.0 / across)] if across else []
        constants += [("Ry", 1.0 / c), ("ky", k)] if c else []
        conic = ("y^2", "Ry (1 + √(1 − (1 + ky) y^2/Ry^2))") if c else None
        curve = "g(y)", DrawnTerms(powers.formula or ("" if c else "0"), (), conic)
        if not across:
            return DrawnTerms("g(y)", (*constants, *powers.constants), None, (curve,))
        # With D, the formula is exact for both signs of Rx.
        fraction = ("x^2", "Rx (D + √(D^2 − x^2/Rx^2))")
        definitions = (("D", DrawnTerms("1 − g(y)/Rx")), curve)
        return DrawnTerms("g(y)", (*constants, *powers.constants), fraction, definitions)

    def zemax(self) -> tuple[str, dict[int, float]]:
        radius = radius_of(float(self.terms[2])) if self.terms[2] else 0.0
        values = written_coefficients(self.terms[3:], len(ZEMAX_TERMS), "y", "a .zmx file")
        return "TOROIDAL", dict(enumerate((radius, 0.0, *values), start=1))

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        if kind != "TOROIDAL":
            return None
        return {
            "shape": cls.NAME,
            "radius_x_mm": values.get(1) or None,
            "asphere": without_zeros([values.get(i, 0.0) for i in ZEMAX_TERMS]),
        }

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        if term not in ORDERS:
            return super().changed_keys(values, term, value)
        return {"asphere": with_coefficient(values["asphere"], ORDERS.index(term), value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        return EvenAsphere.scaled_keys(values, factor)
