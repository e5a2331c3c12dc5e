"""Forbes aspheres: a conic or a sphere, and a departure as a sum of orthogonal polynomials (ISO 10110-19).

With u = r / r_norm, the normalization radius r_norm at the rim, and coefficients q_m in mm::

    Qcon:  z(r) = conic  + u^4 sum q_m Qcon_m(u^2)
    Qbfs:  z(r) = sphere + u^2 (1 - u^2) / sqrt(1 - c^2 r^2) sum q_m Qbfs_m(u^2)

Terms of Qcon are orthogonal in sag. Terms of Qbfs are orthogonal in slope along the normal of the sphere of
curvature c, which meets the surface at the vertex and at the rim: the mean square slope of the departure is
the sum of the squared coefficients over r_norm^2, with the weight of the reference. Each coefficient has the
size of its effect, so that all have similar scales in an optimization.

References
----------
G. W. Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15, 5218 (2007).
G. W. Forbes, "Robust, efficient computational methods for axially symmetric optical aspheres",
Opt. Express 18, 19700 (2010), Eqs. (A.14) to (A.16), for the recurrence of Qbfs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
from numpy.polynomial import Polynomial

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import COEFFICIENTS, DrawnTerms, curvature_of, with_coefficient
from lensdesign.lens.shapes.conic import Conic
from lensdesign.lens.shapes.even_asphere import EvenAsphere, without_zeros
from lensdesign.lens.shapes.expanded import ExpandedShape, powers_of_r
from lensdesign.lens.shapes.sphere_departure import SphereDeparture

Q_TERMS = COEFFICIENTS["q_mm"]
MOST_Q_TERMS = len(Q_TERMS)

ZEMAX_FORBES_TYPE = "QED_TYPE"
"""Surface type of Forbes aspheres in OpticStudio. Its extra data are the kind (0 for Qbfs, 1 for Qcon), the
number of terms, the normalization radius and the terms. The file of an asphere that a vendor published
(Thorlabs ASL5040-UV) has this order: of all readings of its data, one as Qbfs along the normal of a conic
alone brings its rays together, within 0.5 µm instead of 100 µm and more."""


@cache
def qcon_polynomials() -> tuple[Polynomial, ...]:
    """Return Qcon_m as polynomials of u^2: the Jacobi polynomials P_m^(0,4)(2 u^2 - 1)."""
    return tuple(
        Polynomial(
            [(-1.0) ** (m + k) * math.comb(m, k) * math.comb(m + 4 + k, m) for k in range(m + 1)],
        )
        for m in range(MOST_Q_TERMS)
    )


@cache
def qbfs_polynomials() -> tuple[Polynomial, ...]:
    """Return Qbfs_m as polynomials of u^2."""
    simple = [Polynomial([2.0]), Polynomial([6.0, -8.0])]
    f, g, h = [2.0, 0.5 * math.sqrt(19.0)], [-0.5], list[float]()
    found = [Polynomial([1.0]), (simple[1] - g[0]) / f[1]]
    for m in range(2, MOST_Q_TERMS):
        simple.append(Polynomial([2.0, -4.0]) * simple[-1] - simple[-2])
        h.append(-0.5 * m * (m - 1) / f[m - 2])
        g.append(-(1.0 + g[m - 2] * h[m - 2]) / f[m - 1])
        f.append(math.sqrt(m * (m + 1) + 3.0 - g[m - 1] ** 2 - h[m - 2] ** 2))
        found.append((simple[m] - g[m - 1] * found[m - 1] - h[m - 2] * found[m - 2]) / f[m])
    return tuple(found)


@cache
def _coefficients(name: str) -> Array:
    """Return the coefficients of the departure of each term by powers of u^2, as columns.

    They are those of Qcon, over u^4, and of (1 - u^2) Qbfs, over u^2.
    """
    part = Polynomial([1.0, -1.0])
    polynomials = qcon_polynomials() if name == "Qcon" else [part * one for one in qbfs_polynomials()]
    matrix = np.zeros((len(polynomials[-1].coef), MOST_Q_TERMS))
    for column, polynomial in enumerate(polynomials):
        matrix[: len(polynomial.coef), column] = polynomial.coef
    return matrix


class _ForbesShape(ExpandedShape):
    """A Forbes asphere of either kind, with its keys and their changes."""

    ZEMAX_KIND: ClassVar[float]

    @classmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        conic = [values["conic"]] if "conic" in cls.KEYS else []
        terms = np.array([curvature_of(values["radius_mm"]), *conic, *values["q_mm"]])
        return cls(terms, values["normalization_radius_mm"])

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        if term not in Q_TERMS:
            return super().changed_keys(values, term, value)
        return {"q_mm": with_coefficient(values["q_mm"], Q_TERMS.index(term), value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        others = {key: value for key, value in values.items() if key != "q_mm"}
        return super().scaled_keys(others, factor) | {"q_mm": tuple(factor * q for q in values["q_mm"])}

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        if kind != ZEMAX_FORBES_TYPE or extra_data.get(1, 0.0) != cls.ZEMAX_KIND:
            return None
        count = min(MOST_Q_TERMS, int(extra_data.get(2, 0.0)))
        return {
            "shape": cls.NAME,
            "normalization_radius_mm": extra_data.get(3, 0.0),
            "q_mm": without_zeros([extra_data.get(4 + m, 0.0) for m in range(count)]),
        }

    @property
    def _q_mm(self) -> Array:
        return self.terms[..., self.TERMS.index(Q_TERMS[0]) :]

    def _drawn(self, formula: str) -> DrawnTerms:
        if not np.any(self._q_mm):
            return DrawnTerms()
        coefficients = ((f"q_{m}", float(q)) for m, q in enumerate(self._q_mm))
        return DrawnTerms(f"{formula}, u = r/r_N", (("r_N", self.normalization_radius_mm), *coefficients))


class Qcon(_ForbesShape):
    """Forbes asphere on a conic, orthogonal in sag: for strong departures."""

    NAME = "Qcon"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", "normalization_radius_mm", "q_mm")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", "conic", *Q_TERMS)
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", "conic", *Q_TERMS)
    FORMULA = EvenAsphere
    ZEMAX_KIND = 1.0

    @staticmethod
    def expansion(count: int, normalization_radius_mm: float) -> Array:
        of_u = _coefficients("Qcon")[: count - 2, : count - 2]
        matrix = np.eye(2 + len(of_u), count)
        matrix[2:, 2:] = powers_of_r(of_u, 4, normalization_radius_mm)
        return matrix

    @property
    def kind(self) -> str:
        return self.NAME if np.any(self._q_mm) else Conic(self.terms[..., :2]).kind

    def zemax(self) -> tuple[str, dict[int, float]]:
        return self.traced.zemax()

    def codev(self) -> tuple[str, dict[str, float]]:
        return self.traced.codev()

    def drawn(self) -> DrawnTerms:
        return self._drawn("u^4 Σ q_m Qcon_m (u^2)")


class Qbfs(_ForbesShape):
    """Forbes asphere on the sphere through vertex and rim, orthogonal in slope: for mild departures."""

    NAME = "Qbfs"
    KEYS: ClassVar[tuple[str, ...]] = ("radius_mm", "normalization_radius_mm", "q_mm")
    TERMS: ClassVar[tuple[str, ...]] = ("curvature", *Q_TERMS)
    PARAMETERS: ClassVar[tuple[str, ...]] = ("radius_mm", *Q_TERMS)
    FORMULA = SphereDeparture
    ZEMAX_KIND = 0.0

    @staticmethod
    def expansion(count: int, normalization_radius_mm: float) -> Array:
        of_u = _coefficients("Qbfs")[:count, : count - 1]
        matrix = np.eye(1 + len(of_u), count)
        matrix[1:, 1:] = powers_of_r(of_u, 2, normalization_radius_mm)
        return matrix

    @property
    def kind(self) -> str:
        return self.NAME if np.any(self._q_mm) else self.traced.kind

    def zemax(self) -> tuple[str, dict[int, float]]:
        return ZEMAX_FORBES_TYPE, {}

    def zemax_extra_data(self) -> dict[int, float]:
        q_mm = [float(q) for q in self._q_mm]
        return dict(enumerate([self.ZEMAX_KIND, float(len(q_mm)), self.normalization_radius_mm, *q_mm], 1))

    def drawn(self) -> DrawnTerms:
        cosine = " / √(1 − r^2/R^2)" if self.terms[0] else ""
        return self._drawn(f"u^2 (1 − u^2){cosine} Σ q_m Qbfs_m (u^2)")
