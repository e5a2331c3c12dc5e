"""The interface of a surface shape: sag over (x, y), its derivatives, and its form in lens files.

A shape has a formula of its own (:class:`FormulaShape`), or is a linear combination of the terms of another
one's formula (:mod:`lensdesign.lens.shapes.expanded`).

Each formula is written once, as a plain function of numbers that calls NumPy's functions only. The same
function accepts arrays, complex numbers (for complex-step derivatives) and Numba's scalars.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.errors import InputError

Array = NDArray[Any]
Point = tuple[Any, Any, Any]
Residual = tuple[Any, Any, Any, Any, Any]

COEFFICIENTS = {
    "asphere": tuple(f"asphere_{order}" for order in range(4, 44, 2)),
    "odd_asphere": tuple(f"odd_asphere_{order}" for order in range(3, 13)),
    "q_mm": tuple(f"q_{m}_mm" for m in range(10)),
}
"""Names of the terms that the keys of a design file with several numbers contain, in their order."""


@dataclass(frozen=True)
class DrawnTerms:
    """Terms of a formula on a drawing.

    Attributes
    ----------
    formula : str
        The terms that are added to the leading fraction, with digits after ``_`` for subscripts and after
        ``^`` for superscripts; empty if there are none.
    constants : tuple of (str, float)
        Symbols and values of the constants in the formula.
    fraction : tuple of str
        Numerator and denominator of the leading fraction; None for that of a conic with R and k, or of a
        plane.
    definitions : tuple of (str, DrawnTerms)
        Symbols in the formula that have a formula of their own, without constants.
    """

    formula: str = ""
    constants: tuple[tuple[str, float], ...] = ()
    fraction: tuple[str, str] | None = None
    definitions: tuple[tuple[str, DrawnTerms], ...] = ()


@dataclass(frozen=True)
class Section:
    """Curve in which a plane through the axis cuts a surface: a conic, and a departure from it along z.

    Attributes
    ----------
    kind : str
        Name of the simplest shape of revolution with this section, or of the shape of the surface.
    curvature, conic : float
        Curvature in 1/mm and conic constant of the conic.
    edge_radius_mm : float
        Radial height at which the conic ends; inf if it has no edge.
    departure
        Function of radial heights in mm that returns the departure in mm, and its slope.
    """

    kind: str
    curvature: float
    conic: float
    edge_radius_mm: float
    departure: Callable[[Array], tuple[Array, Array]]

    def sag_and_slope(self, r: ArrayLike) -> tuple[Array, Array]:
        """Return the sag in mm and the slope at radial heights in mm."""
        r = np.asarray(r, float)
        root = np.sqrt(1.0 - (1.0 + self.conic) * self.curvature**2 * r * r)
        departure, slope = self.departure(r)
        return self.curvature * r * r / (1.0 + root) + departure, self.curvature * r / root + slope


@dataclass(frozen=True, eq=False)
class Shape(ABC):
    """Shape of a surface around its vertex, with z along the axis.

    Attributes
    ----------
    terms : ndarray, shape (n,) or (trials, n)
        Parameters of the shape, in the order of `TERMS`, which may be longer. The first is the curvature in
        1/mm of the conic or sphere, in the y-z meridian, to which others add. A leading axis holds many
        perturbed copies.
    """

    terms: Array

    NAME: ClassVar[str]
    """Value of `shape` in a design file."""

    KEYS: ClassVar[tuple[str, ...]]
    """Keys of a design file that define the terms; fields of :class:`lensdesign.Surface`."""

    TERMS: ClassVar[tuple[str, ...]]
    """Names of the terms."""

    PARAMETERS: ClassVar[tuple[str, ...]]
    """Parameters that an optimizer may vary, by their names in a design file."""

    ROTATIONAL: ClassVar[bool] = True
    """True if the surface is rotationally symmetric."""

    COORDINATE: ClassVar[str] = "r"
    """Coordinate whose powers the coefficients multiply."""

    ZEMAX_LOST: ClassVar[Mapping[int, str]] = {}
    """Parameters of the Zemax surface that this shape cannot represent: description by number."""

    @classmethod
    @abstractmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        """Return the shape with the given values of `KEYS`."""

    @abstractmethod
    def ends(self) -> Array:
        """Return 1 / r^2 for each radial height r in mm at which a section of the surface ends.

        The shape is (..., sections). A value of 0 or less means that the section has no edge.
        """

    @property
    @abstractmethod
    def kind(self) -> str:
        """Name of the simplest shape that has this form."""

    @property
    @abstractmethod
    def traced(self) -> FormulaShape:
        """The same surface as a shape with a formula, with which rays are traced."""

    @abstractmethod
    def traced_by(self, term: str) -> dict[str, float]:
        """Return the derivatives of the terms of `traced` with respect to a term, without zeros."""

    def section(self, azimuth_rad: float) -> Section:
        """Return the section of the surface at an azimuth, from +x towards +y."""
        shape = self.traced
        curvature, conic = shape.start(shape.terms)
        return Section(self.kind, float(curvature), float(conic), self.edge_radius_mm, shape.departure)

    def zemax(self) -> tuple[str, dict[int, float]]:
        """Return type and numbered parameters (PARM) of the Zemax surface, besides CURV and CONI."""
        raise InputError(f"a .zmx file cannot hold a surface of shape {self.NAME}")

    def zemax_extra_data(self) -> dict[int, float]:
        """Return the extra data (XDAT) of the Zemax surface by number."""
        return {}

    @classmethod
    def keys_of_zemax(
        cls, kind: str, values: Mapping[int, float], extra_data: Mapping[int, float]
    ) -> dict[str, Any] | None:
        """Return the keys besides radius_mm and conic of a Zemax surface; None for another surface type.

        Parameters
        ----------
        kind
            Surface type.
        values, extra_data
            Numbered parameters (PARM) and extra data (XDAT).
        """
        return None

    def codev(self) -> tuple[str, dict[str, float]]:
        """Return the CODE V surface type and the values of its terms by letter, besides radius and K."""
        raise InputError(f"a .seq file cannot hold a surface of shape {self.NAME}")

    def drawn(self) -> DrawnTerms:
        """Return what a drawing states of the surface besides its conic."""
        raise InputError(f"a drawing cannot describe a surface of shape {self.NAME}")

    @property
    def curvature(self) -> float:
        """Curvature at the vertex in the y-z meridian, in 1/mm."""
        return float(self.terms[..., 0])

    @property
    def edge_radius_mm(self) -> float:
        """Radial height at which the surface ends (tangent parallel to the axis); inf if it has no edge."""
        with np.errstate(over="ignore"):
            largest = float(np.max(self.ends(), initial=0.0))
        return 1.0 / math.sqrt(largest) if largest > 0.0 else math.inf

    def sag(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the sag in mm at (x, y), with a leading axis for many copies; NaN beyond the edge."""
        return self.sag_and_slopes(x, y)[0]

    @abstractmethod
    def sag_and_slopes(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the sag in mm and its slopes along x and y."""

    @abstractmethod
    def second_derivatives(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the second derivatives of the sag in 1/mm: xx, xy and yy."""

    @abstractmethod
    def derivatives_by(self, term: str, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Return the derivatives of the sag and of its slopes with respect to a term."""

    @classmethod
    def coefficient_label(cls, term: str) -> str:
        """Return the label of a coefficient (:data:`COEFFICIENTS`): r^4, Q0, ..."""
        if term in COEFFICIENTS["q_mm"]:
            return f"Q{COEFFICIENTS['q_mm'].index(term)}"
        return f"{cls.COORDINATE}^{order_of(term)}"

    def term_index(self, term: str) -> int:
        """Return the index of a term in `terms`.

        Raises
        ------
        InputError
            If this shape has no such term.
        """
        known = self.TERMS[: self.terms.shape[-1]]
        if term not in known:
            raise InputError(f"{term} is no term of this surface ({self.NAME}); it has {', '.join(known)}")
        return known.index(term)

    def term(self, name: str) -> float:
        """Return the value of a term; 0 if the surface has no such term."""
        known = self.TERMS[: self.terms.shape[-1]]
        return float(self.terms[known.index(name)]) if name in known else 0.0

    def moved(self, term: str, change: Any) -> Self:
        """Return the shape with a change, real or complex, of one term."""
        step = np.zeros(self.terms.shape[-1], np.result_type(self.terms, type(change)))
        step[self.term_index(term)] = change
        return replace(self, terms=self.terms + step)

    def trial(self, index: int) -> Self:
        """Return the shape of one copy; a single shape applies to every copy."""
        if self.terms.ndim == 1:
            return self
        return replace(self, terms=self.terms[min(index, len(self.terms) - 1)])

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        """Return the key of a design file, with its new value, that sets a term to a value."""
        if term.startswith("curvature"):
            return {parameter_of(term): None if value == 0.0 else float(1.0 / value)}
        return {term: float(value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        """Return the values of `KEYS` for the shape with all lengths scaled."""
        return {
            key: factor * value if key.endswith("_mm") and value is not None else value
            for key, value in values.items()
        }


class FormulaShape(Shape):
    """Shape with a formula of its own, which is also compiled."""

    @staticmethod
    @abstractmethod
    def sag_and_gradient(terms: Any, x: Any, y: Any) -> Point:
        """Return the sag in mm at (x, y) in mm and its slopes along x and y; NaN beyond the edge."""

    @staticmethod
    @abstractmethod
    def sag_hessian(terms: Any, x: Any, y: Any) -> Point:
        """Return the second derivatives of the sag in 1/mm: xx, xy and yy."""

    @staticmethod
    @abstractmethod
    def term_derivatives(terms: Any, j: int, x: Any, y: Any) -> Point:
        """Return the derivatives of the three values of `sag_and_gradient` with respect to term j."""

    @staticmethod
    @abstractmethod
    def residual_and_normal(terms: Any, x: Any, y: Any, z: Any) -> Residual:
        """Return z minus the sag at (x, y), and a normal of the surface there, for a step of Newton's method.

        Compiled tracing uses this form of the sag and its slopes, which takes fewer quotients.

        Returns
        -------
        top, bottom
            Numerator and denominator of the residual z - sag, multiplied by the z of the normal.
        nx, ny, nz
            Normal: -nx / nz and -ny / nz are the slopes along x and y. Its length is arbitrary.
        """

    @staticmethod
    def start(terms: Any) -> tuple[Any, Any]:
        """Return curvature and conic constant of the conic at which Newton's method starts."""
        return terms[0], terms[1]

    def departure(self, r: ArrayLike) -> tuple[Array, Array]:
        """Return the difference of the sag from that of the conic of :meth:`start`, and its slope.

        Parameters
        ----------
        r
            Radial heights in mm; the surface is one of revolution.
        """
        sag, _, slope = self.moved("curvature", -self.terms[0]).sag_and_slopes(0.0, r)
        return sag, slope

    @property
    def traced(self) -> FormulaShape:
        return self

    def traced_by(self, term: str) -> dict[str, float]:
        return {term: 1.0}

    def sag_and_slopes(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        return self._evaluated(self.sag_and_gradient, x, y)

    def second_derivatives(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        return self._evaluated(self.sag_hessian, x, y)

    def derivatives_by(self, term: str, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        j = self.term_index(term)
        return self._evaluated(lambda terms, x, y: self.term_derivatives(terms, j, x, y), x, y)

    def _evaluated(self, function: Any, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        terms = self.terms.T
        across, down = np.asarray(x), np.asarray(y)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = function(terms[..., None] if terms.ndim > 1 else terms, across, down)
        same = across.shape == down.shape
        points = across.shape if same else np.broadcast_shapes(across.shape, down.shape)
        full = terms.shape[1:] + points if terms.ndim > 1 else points
        a, b, c = (value if np.shape(value) == full else np.broadcast_to(value, full) for value in found)
        return a, b, c


def with_coefficient(coefficients: Sequence[float], position: int, value: float) -> tuple[float, ...]:
    """Return coefficients with another one at a position, beyond their end if need be."""
    found = [*coefficients, *[0.0] * (position + 1 - len(coefficients))]
    found[position] = float(value)
    return tuple(found)


def azimuths_rad(*shapes: Shape) -> Array:
    """Return the azimuths at which surfaces are examined: 64, or 90 degrees alone if all are rotational."""
    if all(shape.ROTATIONAL for shape in shapes):
        return np.array([0.5 * math.pi])
    count = 64
    return 0.5 * math.pi + 2.0 * math.pi * np.arange(count) / count


def directions(*shapes: Shape) -> tuple[Array, Array]:
    """Return x and y of the unit vectors along :func:`azimuths_rad`."""
    if all(shape.ROTATIONAL for shape in shapes):
        return np.zeros(1), np.ones(1)
    angles = azimuths_rad(*shapes)
    return np.cos(angles), np.sin(angles)


def axial_gaps_mm(front: Shape, back: Shape, distance_mm: float, heights_mm: Array) -> Array:
    """Return the gap along the axis between two surfaces at each height, the least of all azimuths."""
    x, y = (heights_mm[:, None] * component for component in directions(front, back))
    return np.asarray(distance_mm + np.min(back.sag(x, y) - front.sag(x, y), axis=1))


def parameter_of(term: str) -> str:
    """Return the name of a term in design files, which give radii in place of curvatures."""
    return term.replace("curvature", "radius") + "_mm" if term.startswith("curvature") else term


def term_of(parameter: str) -> str:
    """Return the term that a parameter of a design file sets."""
    radius = parameter.removesuffix("_mm")
    return radius.replace("radius", "curvature") if parameter.startswith("radius") else parameter


def length_power(parameter: str) -> int:
    """Return the power of a length in a parameter: 1 - n for the coefficient of r^n, 1 for a length, or 0."""
    return 1 - order_of(parameter) if "asphere_" in parameter else int(parameter.endswith("_mm"))


def order_of(term: str) -> int:
    """Return the power that a coefficient multiplies."""
    return int(term.rpartition("_")[2])


def radius_of(curvature: float) -> float:
    """Return the radius in mm for which :func:`curvature_of` gives exactly this curvature, other than 0."""
    near = 1.0 / curvature
    candidates = (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf))
    return next((radius for radius in candidates if 1.0 / radius == curvature), near)


def curvature_of(radius_mm: float | None) -> float:
    """Return 1/radius in 1/mm; 0 for a plane."""
    return 0.0 if radius_mm is None else 1.0 / radius_mm
