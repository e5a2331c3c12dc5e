"""Sphere with a departure along its normal (the form of Forbes' Qbfs)::

    z(r) = c r^2 / (1 + w) + (b2 r^2 + b4 r^4 + ...) / w,    w = sqrt(1 - c^2 r^2)

with the curvature c of the sphere and coefficients in mm^-1, mm^-3, ... The sum is the departure along the
normal of the sphere, to first order; division by the cosine w makes it one along z.

Design files have no such shape. Other shapes are traced with this formula.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.shapes.base import FormulaShape, Point, Residual

DEPARTURES = tuple(f"departure_{order}" for order in range(2, 24, 2))


class SphereDeparture(FormulaShape):
    """Surface of revolution: a sphere, and even powers of the radial height over the cosine of its normal."""

    NAME = "sphere with departure"
    KEYS: ClassVar[tuple[str, ...]] = ()
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", *DEPARTURES)
    PARAMETERS: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        raise InputError(f"a design file has no surface of shape {cls.NAME}")

    @staticmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        c = terms[0]
        r2 = x * x + y * y
        over = 1.0 / np.sqrt(1.0 - c * c * r2)
        total, by_r2, power = 0.0 * r2, 0.0 * r2, 1.0 + 0.0 * r2
        for j in range(1, len(terms)):
            by_r2 = by_r2 + j * terms[j] * power
            power = power * r2
            total = total + terms[j] * power
        gradient = over * (c + 2.0 * by_r2 + c * c * total * over * over)
        return c * r2 * over / (1.0 + over) + total * over, gradient * x, gradient * y

    @staticmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        # Below the departure lies a sphere.
        c = terms[0]
        r2 = x * x + y * y
        square = 1.0 - c * c * r2
        over2, root = 1.0 / square, np.sqrt(square)
        total, by_r2, power = 0.0 * r2, 0.0 * r2, 1.0 + 0.0 * r2
        for j in range(1, len(terms)):
            by_r2 = by_r2 + j * terms[j] * power
            power = power * r2
            total = total + terms[j] * power
        height = z - total * root * over2
        level = height - 0.5 * c * (r2 + height * height)
        across = -(c + 2.0 * by_r2 + c * c * total * over2)
        return 2.0 * level * root, 1.0 - c * height + root, across * x, across * y, root

    @staticmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        c = terms[0]
        r2 = x * x + y * y
        over = 1.0 / np.sqrt(1.0 - c * c * r2)
        # The sum with its first and second derivatives with respect to r^2.
        total, first, second = 0.0 * r2, 0.0 * r2, 0.0 * r2
        before, power = 0.0 * r2, 1.0 + 0.0 * r2
        for j in range(1, len(terms)):
            second = second + j * (j - 1) * terms[j] * before
            first = first + j * terms[j] * power
            before = power
            power = power * r2
            total = total + terms[j] * power
        # First and second derivatives of 1 / w with respect to r^2.
        bent = 0.5 * c * c * over * over * over
        bent_twice = 1.5 * c * c * over * over * bent
        slope = over * (c + 2.0 * first) + 2.0 * total * bent
        more = c * c * c * over * over * over + 4.0 * (
            second * over + 2.0 * first * bent + total * bent_twice
        )
        return slope + more * x * x, more * x * y, slope + more * y * y

    @staticmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        c = terms[0]
        r2 = x * x + y * y
        over = 1.0 / np.sqrt(1.0 - c * c * r2)
        if j >= 1:
            power = r2 ** (j - 1)
            gradient = power * over * (2.0 * j + c * c * r2 * over * over)
            return power * r2 * over, gradient * x, gradient * y
        total, by_r2, power = 0.0 * r2, 0.0 * r2, 1.0 + 0.0 * r2
        for i in range(1, len(terms)):
            by_r2 = by_r2 + i * terms[i] * power
            power = power * r2
            total = total + terms[i] * power
        cube = over * over * over
        sag = r2 * over * over / (1.0 + over) + total * c * r2 * cube
        gradient = cube * (1.0 + 2.0 * c * (r2 * by_r2 + total) + 3.0 * c * c * c * r2 * total * over * over)
        return sag, gradient * x, gradient * y

    @staticmethod
    def start(terms: Any) -> tuple[Any, Any]:
        return terms[0], 0.0 * terms[0]

    def ends(self) -> Array:
        return np.asarray(self.terms[..., :1] ** 2)

    def departure(self, r: ArrayLike) -> tuple[Array, Array]:
        sag, _, slope = self.sag_and_slopes(0.0, r)
        sphere, _, slope_of_sphere = type(self)(self.terms[:1]).sag_and_slopes(0.0, r)
        return sag - sphere, slope - slope_of_sphere

    @property
    def curvature(self) -> float:
        return float(self.terms[..., 0]) + 2.0 * float(np.sum(self.terms[..., 1:2]))

    @property
    def kind(self) -> str:
        if np.any(self.terms[..., 1:]):
            return self.NAME
        return "sphere" if self.terms[..., 0] else "plane"
