"""Even asphere (ISO 10110-12): a conic, and even powers of the radial height::

    z(r) = conic + a4 r^4 + a6 r^6 + ...

with coefficients in mm^-3, mm^-5, ...
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.shapes.base import (
    COEFFICIENTS,
    DrawnTerms,
    Point,
    Residual,
    curvature_of,
    with_coefficient,
)
from lensdesign.lens.shapes.conic import Conic

ORDERS = COEFFICIENTS["asphere"]

CODEV_LETTERS = "ABCDEFGHJ"
"""CODE V's letters of the coefficients of r^4 to r^20."""

ZEMAX_TERMS = range(2, 9)
"""Zemax's numbers of the coefficients of r^4 to r^16. Number 1, of r^2, has no counterpart in a design."""


class EvenAsphere(Conic):
    """Surface of revolution: a conic plus even powers of the radial height."""

    NAME = "even asphere"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "asphere")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic", *ORDERS)
    ZEMAX_LOST: ClassVar[Mapping[int, str]] = {1: "asphere term in r^2"}
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", *ORDERS[:9])

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        return cls(np.array([curvature_of(values["radius_mm"]), values["conic"], *values["asphere"]]))

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        sag = c * r2 / (1.0 + root)
        gradient = 0.5 * c / root
        power = r2
        for j in range(2, len(terms)):
            gradient = gradient + j * terms[j] * power
            power = power * r2
            sag = sag + terms[j] * power
        return sag, 2.0 * gradient * x, 2.0 * gradient * y

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        # Below the departure lies a conic.
        c, q = terms[0], 1.0 + terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - q * c * c * r2)
        departure, by_r2, power = 0.0 * r2, 0.0 * r2, r2
        for j in range(2, len(terms)):
            by_r2 = by_r2 + j * terms[j] * power
            power = power * r2
            departure = departure + terms[j] * power
        height = z - departure
        level = height - 0.5 * c * (r2 + q * height * height)
        across = -(c + 2.0 * by_r2 * root)
        return 2.0 * level * root, 1.0 - q * c * height + root, across * x, across * y, root

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        slope = c / root
        more = (1.0 + k) * slope * slope * slope
        power = 1.0
        for j in range(2, len(terms)):
            more = more + 4.0 * j * (j - 1) * terms[j] * power
            power = power * r2
            slope = slope + 2.0 * j * terms[j] * power
        return slope + more * x * x, more * x * y, slope + more * y * y

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        c, k = terms[0], terms[1]
        r2 = x * x + y * y
        if j >= 2:
            power = r2 ** (j - 1)
            return power * r2, 2.0 * j * power * x, 2.0 * j * power * y
        root = np.sqrt(1.0 - (1.0 + k) * c * c * r2)
        slope = 1.0 / (root * root * root)
        sag = r2 / (root * (1.0 + root))
        if j == 1:
            slope = 0.5 * c * c * c * r2 * slope
            sag = 0.5 * c * c * c * r2 * sag / (1.0 + root)
        return sag, slope * x, slope * y

    @property
    def kind(self) -> str:
        return "even asphere" if np.any(self.terms[..., 2:]) else super().kind

    def drawn(self) -> DrawnTerms:
        return drawn_powers("A", range(4, 2 * len(self.terms), 2), self.terms[2:])

    def zemax(self) -> tuple[str, dict[int, float]]:
        values = written_coefficients(self.terms[2:], len(ZEMAX_TERMS), "r", "a .zmx file")
        return ("EVENASPH", dict(enumerate((0.0, *values), start=1))) if values else ("STANDARD", {})

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        if kind != "EVENASPH":
            return None
        return {"asphere": without_zeros([values.get(i, 0.0) for i in ZEMAX_TERMS])}

    def codev(self) -> tuple[str, dict[str, float]]:
        values = written_coefficients(self.terms[2:], len(CODEV_LETTERS), "r", "a .seq file")
        return ("ASP" if values else "CON"), dict(zip(CODEV_LETTERS, values, strict=False))

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        if term not in ORDERS:
            return super().changed_keys(values, term, value)
        return {"asphere": with_coefficient(values["asphere"], ORDERS.index(term), value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        asphere = tuple(a / factor ** (2 * i + 3) for i, a in enumerate(values["asphere"]))
        return super().scaled_keys(values, factor) | {"asphere": asphere}


def drawn_powers(
    symbol: str, orders: Sequence[int], coefficients: Array, coordinate: str = "r"
) -> DrawnTerms:
    """Return what a drawing states of powers of a coordinate, with a symbol for the coefficients."""
    count = len(coefficients)
    shown = orders if count <= 2 else (orders[0], orders[-1])
    words = [f"{symbol}_{order} {coordinate}^{order}" for order in shown] if np.any(coefficients) else []
    constants = ((f"{symbol}_{n}", float(a)) for n, a in zip(orders, coefficients, strict=True))
    return DrawnTerms((" + … + " if count > 2 else " + ").join(words), tuple(constants))


def without_zeros(asphere: Sequence[float]) -> list[float]:
    """Return the coefficients without trailing zeros."""
    count = max((i for i, a in enumerate(asphere, start=1) if a), default=0)
    return list(asphere[:count])


def written_coefficients(coefficients: Array, most: int, symbol: str, kind: str) -> list[float]:
    """Return the coefficients of even powers of a symbol for a kind of file that holds a number of them.

    Raises
    ------
    InputError
        If there are more.
    """
    values = without_zeros([float(a) for a in coefficients])
    if len(values) > most:
        raise InputError(f"{len(values)} asphere terms; {kind} holds {most}, up to {symbol}^{2 * most + 2}")
    return values
