"""What a shape of surface is: its sag over (x, y), with derivatives, and how files write it.

The formulas stand once. They are plain functions of numbers, in which NumPy's functions are the only ones
called, so that they take arrays, complex numbers (for derivatives by complex step) and Numba's scalars alike.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.errors import InputError

Array = NDArray[Any]
Point = tuple[Any, Any, Any]


@dataclass(frozen=True, eq=False)
class Shape(ABC):
    """A surface's shape about its vertex, z along the axis.

    Attributes
    ----------
    terms : ndarray, shape (n,) or (trials, n)
        Numbers of the formula, in the order of `TERMS`, which may be longer. The first two are the curvature
        in 1/mm and the conic constant of the meridian y-z. With a leading axis, those of many copies.
    """

    terms: Array

    NAME: ClassVar[str]
    """As `shape` in a design file."""

    KEYS: ClassVar[tuple[str, ...]]
    """Keys of a design file from which the terms come; fields of :class:`lensdesign.Surface`."""

    TERMS: ClassVar[tuple[str, ...]]

    PARAMETERS: ClassVar[tuple[str, ...]]
    """What an optimizer may vary, by its design file's name."""

    ROTATIONAL: ClassVar[bool] = True
    """Whether the surface is one of revolution."""

    ZEMAX_LOST: ClassVar[Mapping[int, str]] = {}
    """What a Zemax surface's parameters are that a design does not have, by number."""

    @classmethod
    @abstractmethod
    def of_keys(cls, values: Mapping[str, Any]) -> Self:
        """The shape for the values of a design file's `KEYS`."""

    @staticmethod
    @abstractmethod
    def height(terms: Any, x: Any, y: Any) -> Point:
        """Sag in mm over (x, y) in mm, and its slopes along x and y; NaN where the surface has ended."""

    @staticmethod
    @abstractmethod
    def bend(terms: Any, x: Any, y: Any) -> Point:
        """Second derivatives of the sag, along x twice, x and y, y twice; in 1/mm."""

    @staticmethod
    @abstractmethod
    def by_term(terms: Any, j: int, x: Any, y: Any) -> Point:
        """Derivatives of what `height` gives by term j."""

    @staticmethod
    def start(terms: Any) -> tuple[Any, Any]:
        """Curvature and conic constant of a conic from which rays find the surface by Newton's method."""
        return terms[0], terms[1]

    @abstractmethod
    def ends(self) -> Array:
        """One over the square of each radial height in mm at which some part ends, shape (..., parts).

        Not above 0 for a part that never does.
        """

    @property
    @abstractmethod
    def kind(self) -> str:
        """Name of the simplest shape that has this form."""

    def section(self, azimuth_rad: float) -> Shape:
        """The surface of revolution that has this one's meridian along an azimuth, from +x towards +y."""
        return self

    def zemax(self) -> tuple[str, dict[int, float]]:
        """Type and parameters by number (PARM) of Zemax OpticStudio's surface, beside CURV and CONI."""
        raise InputError(f"a .zmx file cannot hold a surface of shape {self.NAME}")

    @classmethod
    def keys_of_zemax(cls, kind: str, values: Mapping[int, float]) -> dict[str, Any] | None:
        """Keys beside radius_mm and conic for a surface type and its PARM; None for a type not its own."""
        return None

    def codev(self) -> tuple[str, dict[str, float]]:
        """Surface type and letters of its terms in CODE V, beside radius and K."""
        raise InputError(f"a .seq file cannot hold a surface of shape {self.NAME}")

    def drawn(self) -> tuple[float, ...]:
        """Coefficients of r^4, r^6, ... that the formula of ISO 10110-12 has beside its conic."""
        raise InputError(f"a drawing cannot describe a surface of shape {self.NAME}")

    @property
    def curvature(self) -> float:
        """In 1/mm, at the vertex in the meridian y-z."""
        return float(self.terms[..., 0])

    @property
    def edge_radius_mm(self) -> float:
        """Radial height at which the surface ends (its tangent stands upright); inf if it never does."""
        with np.errstate(over="ignore"):
            largest = float(np.max(self.ends(), initial=0.0))
        return 1.0 / math.sqrt(largest) if largest > 0.0 else math.inf

    def sag(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Sag in mm over (x, y); of many copies, with these as a leading axis. NaN beyond the edge."""
        return self.sag_and_slopes(x, y)[0]

    def sag_and_slopes(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Sag in mm, and its slopes along x and y."""
        return self._evaluated(self.height, x, y)

    def second_derivatives(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Of the sag, along x twice, x and y, y twice; in 1/mm."""
        return self._evaluated(self.bend, x, y)

    def derivatives_by(self, term: str, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Of the sag and its slopes, by a term."""
        j = self.place(term)
        return self._evaluated(lambda terms, x, y: self.by_term(terms, j, x, y), x, y)

    def _evaluated(self, function: Any, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        terms = self.terms.T
        across, down = np.asarray(x), np.asarray(y)
        with np.errstate(invalid="ignore", divide="ignore"):
            found = function(terms[..., None] if terms.ndim > 1 else terms, across, down)
        alike = across.shape == down.shape
        shape = across.shape if alike else np.broadcast_shapes(across.shape, down.shape)
        wide = terms.shape[1:] + shape if terms.ndim > 1 else shape
        a, b, c = (part if np.shape(part) == wide else np.broadcast_to(part, wide) for part in found)
        return a, b, c

    def place(self, term: str) -> int:
        """Where a term stands.

        Raises
        ------
        InputError
            If this shape has no such term.
        """
        held = self.TERMS[: self.terms.shape[-1]]
        if term not in held:
            raise InputError(f"{term} is no term of this surface ({self.NAME}); it has {', '.join(held)}")
        return held.index(term)

    def term(self, name: str) -> float:
        """Value of a term; 0 where the surface has no such term."""
        held = self.TERMS[: self.terms.shape[-1]]
        return float(self.terms[held.index(name)]) if name in held else 0.0

    def moved(self, term: str, change: Any) -> Self:
        """The same shape with a change, real or complex, of one term."""
        step = np.zeros(self.terms.shape[-1], np.result_type(self.terms, type(change)))
        step[self.place(term)] = change
        return type(self)(self.terms + step)

    def trial(self, number: int) -> Self:
        """The shape of one copy; a single shape is that of every copy."""
        return self if self.terms.ndim == 1 else type(self)(self.terms[min(number, len(self.terms) - 1)])

    @classmethod
    def changed_keys(cls, values: Mapping[str, Any], term: str, value: float) -> dict[str, Any]:
        """The key of a design file by which a term takes a value, with what it holds then."""
        if term.startswith("curvature"):
            return {parameter_of(term): None if value == 0.0 else float(1.0 / value)}
        return {term: float(value)}

    @classmethod
    def scaled_keys(cls, values: Mapping[str, Any], factor: float) -> dict[str, Any]:
        """The values of `KEYS` for the shape with all lengths scaled."""
        return {
            key: factor * value if key.endswith("_mm") and value is not None else value
            for key, value in values.items()
        }


DIRECTIONS = 64
"""In which a surface is looked at that is none of revolution."""


def azimuths_rad(*shapes: Shape) -> Array:
    """Azimuths that stand for all of some surfaces: that of the meridian y-z for those of revolution."""
    if all(shape.ROTATIONAL for shape in shapes):
        return np.array([0.5 * math.pi])
    return 0.5 * math.pi + 2.0 * math.pi * np.arange(DIRECTIONS) / DIRECTIONS


def directions(*shapes: Shape) -> tuple[Array, Array]:
    """x and y of unit vectors along :func:`azimuths_rad`."""
    if all(shape.ROTATIONAL for shape in shapes):
        return np.zeros(1), np.ones(1)
    angles = azimuths_rad(*shapes)
    return np.cos(angles), np.sin(angles)


def parameter_of(term: str) -> str:
    """A term as design files name it: they hold radii for curvatures."""
    return term.replace("curvature", "radius") + "_mm" if term.startswith("curvature") else term


def term_of(parameter: str) -> str:
    """The term that a design file's parameter stands for."""
    radius = parameter.removesuffix("_mm")
    return radius.replace("radius", "curvature") if parameter.startswith("radius") else parameter


def radius_of(curvature: float) -> float:
    """The radius in mm from which :func:`curvature_of` has this very curvature, other than 0."""
    near = 1.0 / curvature
    candidates = (near, math.nextafter(near, math.inf), math.nextafter(near, -math.inf))
    return next((radius for radius in candidates if 1.0 / radius == curvature), near)


def curvature_of(radius_mm: float | None) -> float:
    """1/radius in 1/mm; 0 for a plane."""
    return 0.0 if radius_mm is None else 1.0 / radius_mm
