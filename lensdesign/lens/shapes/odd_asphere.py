"""Odd asphere: a conic, and all powers of the radial height from the third on::

    z(r) = conic + b3 r^3 + b4 r^4 + b5 r^5 + ...

with coefficients in mm^-2, mm^-3, mm^-4, ... A first power would be a tip at the vertex, and a second one
would change the curvature.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.shapes.base import (
    COEFFICIENTS,
    DrawnTerms,
    FormulaShape,
    Point,
    Residual,
    curvature_of,
    with_coefficient,
)
from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.even_asphere import drawn_powers, without_zeros

POWERS = range(3, 13)
ODD_TERMS = COEFFICIENTS["odd_asphere"]

ZEMAX_TERMS = range(3, 9)
"""Zemax's numbers of the coefficients of r^3 to r^8; numbers 1 and 2 have no counterpart in a design."""


class OddAsphere(Conic):
    """Surface of revolution: a conic plus even and odd powers of the radial height."""

    NAME = "odd asphere"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "odd_asphere")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic", *ODD_TERMS)
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", *ODD_TERMS)
    ZEMAX_LOST: ClassVar[Mapping[int, str]] = {1: "odd asphere term in r", 2: "odd asphere term in r^2"}

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        return cls(np.array([curvature_of(values["radius_mm"]), values["conic"], *values["odd_asphere"]]))

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root, r = np.sqrt(1.0 - (1.0 + k) * c * c * r2), np.sqrt(r2)
        sag = c * r2 / (1.0 + root)
        gradient = c / root
        power = r
        for j in range(2, len(terms)):
            gradient = gradient + (j + 1.0) * terms[j] * power
            power = power * r
            sag = sag + terms[j] * power * r
        return sag, gradient * x, gradient * y

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        # Below the departure lies a conic.
        c, q = terms[0], 1.0 + terms[1]
        r2 = x * x + y * y
        root, r = np.sqrt(1.0 - q * c * c * r2), np.sqrt(r2)
        departure, slope_by_r, power = 0.0 * r, 0.0 * r, r
        for j in range(2, len(terms)):
            slope_by_r = slope_by_r + (j + 1.0) * terms[j] * power
            power = power * r
            departure = departure + terms[j] * power * r
        height = z - departure
        level = height - 0.5 * c * (r2 + q * height * height)
        across = -(c + slope_by_r * root)
        return 2.0 * level * root, 1.0 - q * c * height + root, across * x, across * y, root

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root, r = np.sqrt(1.0 - (1.0 + k) * c * c * r2), np.sqrt(r2)
        slope = c / root
        more = (1.0 + k) * slope * slope * slope
        # At the vertex x^2 / r is 0; the small number avoids 0 / 0.
        power = 1.0 / (r + 1e-150)
        for j in range(2, len(terms)):
            more = more + (j + 1.0) * (j - 1.0) * terms[j] * power
            power = power * r
            slope = slope + (j + 1.0) * terms[j] * power * r
        return slope + more * x * x, more * x * y, slope + more * y * y

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        if j >= 2:
            r = np.sqrt(r2)
            power = r ** (j - 1)
            return power * r2, (j + 1.0) * power * x, (j + 1.0) * power * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        slope = 1.0 / (root * root * root)
        sag = r2 / (root * (1.0 + root))
        if j == 1:
            slope = 0.5 * c * c * c * r2 * slope
            sag = 0.5 * c * c * c * r2 * sag / (1.0 + root)
        return sag, slope * x, slope * y

    @property
    def kind(self) -> str:
        return "odd asphere" if np.any(self.terms[..., 2:]) else super().kind

    def drawn(self) -> DrawnTerms:
        return drawn_powers("B", POWERS[: len(self.terms) - 2], self.terms[2:])

    def zemax(self) -> tuple[str, dict[int, float]]:
        values = without_zeros([float(a) for a in self.terms[2:]])
        if len(values) > len(ZEMAX_TERMS):
            raise InputError(f"{len(values)} odd_asphere terms; a .zmx file holds 6, up to r^8")
        return "ODDASPHE", dict(enumerate((0.0, 0.0, *values), start=1))

    def codev(self) -> tuple[str, dict[str, float]]:
        return FormulaShape.codev(self)

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        if kind != "ODDASPHE":
            return None
        return {
            "shape": cls.NAME,
            "odd_asphere": without_zeros([values.get(i, 0.0) for i in ZEMAX_TERMS]),
        }

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        if term not in ODD_TERMS:
            return super().changed_keys(values, term, value)
        return {"odd_asphere": with_coefficient(values["odd_asphere"], ODD_TERMS.index(term), value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        coefficients = tuple(
            b / factor ** (power - 1) for power, b in zip(POWERS, values["odd_asphere"], strict=False)
        )
        return super().scaled_keys(values, factor) | {"odd_asphere": coefficients}
