"""Shapes whose sag is a linear combination of the terms of another formula.

Rays are traced with the other formula. A change of a term is the same combination of changes of its terms.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.shapes.base import FormulaShape, Shape


@dataclass(frozen=True, eq=False)
class ExpandedShape(Shape):
    """Shape of revolution that is a linear combination of the terms of a formula.

    Attributes
    ----------
    normalization_radius_mm : float
        Radial height by which the polynomials of the shape are normalized.
    """

    normalization_radius_mm: float

    FORMULA: ClassVar[type[FormulaShape]]
    """Shape with the formula."""

    @staticmethod
    @abstractmethod
    def expansion(count: int, normalization_radius_mm: float) -> Array:
        """Return the matrix that gives the terms of the formula from a number of terms of this shape."""

    @cached_property
    def _expansion(self) -> Array:
        return self.expansion(self.terms.shape[-1], self.normalization_radius_mm)

    def renormalized(self, normalization_radius_mm: float) -> Self:
        """Return the same surface with another normalization radius.

        Raises
        ------
        InputError
            If no values of the terms give this surface.
        """
        matrix = self.expansion(self.terms.shape[-1], normalization_radius_mm)
        wanted = self.traced.terms
        size = np.linalg.norm(matrix, axis=1)
        terms = np.linalg.lstsq(matrix / size[:, None], wanted / size, rcond=None)[0]
        rounding = 1e-9
        if np.any(np.abs(matrix @ terms - wanted) > rounding * size * np.abs(terms).max()):
            raise InputError(
                f"a surface of shape {self.NAME} has no other normalization radius: its departure ends at a "
                "normalization radius of its own"
            )
        return replace(self, terms=terms, normalization_radius_mm=normalization_radius_mm)

    @cached_property
    def traced(self) -> FormulaShape:
        return self.FORMULA(self.terms @ self._expansion.T)

    def traced_by(self, term: str) -> dict[str, float]:
        column = self._expansion[:, self.term_index(term)]
        names = self.FORMULA.TERMS[: len(column)]
        return {name: float(value) for name, value in zip(names, column, strict=True) if value}

    def sag_and_slopes(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        return self.traced.sag_and_slopes(x, y)

    def second_derivatives(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        return self.traced.second_derivatives(x, y)

    def derivatives_by(self, term: str, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        parts = [
            [factor * one for one in self.traced.derivatives_by(name, x, y)]
            for name, factor in self.traced_by(term).items()
        ]
        sag, by_x, by_y = (np.sum(same, axis=0) for same in zip(*parts, strict=True))
        return sag, by_x, by_y

    def ends(self) -> Array:
        return self.traced.ends()

    @property
    def curvature(self) -> float:
        return self.traced.curvature


def powers_of_r(coefficients: Any, first_power: int, normalization_radius_mm: float) -> Array:
    """Return coefficients of powers of r in mm from those of powers of u = r / r_norm.

    Parameters
    ----------
    coefficients
        Coefficients of u^first_power, u^(first_power + 2), ... along the first axis.
    first_power
        Lowest power.
    normalization_radius_mm
        The normalization radius r_norm; the result is not finite if it is far too small.
    """
    powers = first_power + 2 * np.arange(len(coefficients))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(coefficients / normalization_radius_mm ** powers[:, None], float)
