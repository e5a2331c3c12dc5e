"""Optical paths through a lens, and their derivatives by all parameters of the system.

By Fermat's principle the path V from an object point to a sensor point does not change, to first order, if
the points w of the ray on the surfaces are displaced. Its first derivative by a change of the lens is
therefore the change of path along the nominal ray. The second derivative by changes i and j includes the
displacement of the points: V_ij - V_iw (V_ww)^-1 V_wj (implicit function theorem). No perturbed ray is
traced.

All arrays may be complex, so that a complex step gives derivatives by design variables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.shapes.base import Shape

POSE = 12
"""Count of the parameters of a pose: the rotation matrix by rows, then the shift in mm."""


@dataclass(frozen=True)
class ParameterLayout:
    """Positions of the parameters of a system in one vector.

    The parameters are the poses of the stations (object, surfaces and sensor), the terms of the shapes, the
    refractive indices, and the ratio of the wavelengths.

    Attributes
    ----------
    terms : tuple of int
        Number of terms of the shape of each surface.
    """

    terms: tuple[int, ...]

    @property
    def surfaces(self) -> int:
        """Number of surfaces."""
        return len(self.terms)

    def pose(self, station: int) -> slice:
        """Return the positions of rotation and shift of a station; station 0 is the object."""
        return slice(POSE * station, POSE * (station + 1))

    def of_shape(self, surface: int) -> slice:
        """Return the positions of the terms of a surface's shape; the first surface is 0."""
        first = POSE * (self.surfaces + 2) + sum(self.terms[:surface])
        return slice(first, first + self.terms[surface])

    @property
    def indices(self) -> slice:
        """Positions of the refractive indices before the first and behind each surface."""
        first = POSE * (self.surfaces + 2) + sum(self.terms)
        return slice(first, first + self.surfaces + 1)

    @property
    def waves(self) -> int:
        """Position of the nominal wavelength divided by the actual one, which multiplies paths in waves."""
        return self.indices.stop

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.waves + 1


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of n rays through a centred lens with s surfaces.

    Attributes
    ----------
    shapes : tuple of Shape
        Shape of each surface.
    vertices_mm : ndarray, shape (s,)
        z of the surfaces' vertices.
    index : ndarray, shape (s + 1,)
        Refractive index before the first and behind each surface.
    objects_mm : ndarray, shape (n, 3)
        Starting points of the rays.
    heights_mm : ndarray, shape (n, s, 2)
        x and y of the intersections with each surface.
    sensors_mm : ndarray, shape (n, 3)
        End points of the rays.
    """

    shapes: tuple[Shape, ...]
    vertices_mm: Array
    index: Array
    objects_mm: Array
    heights_mm: Array
    sensors_mm: Array

    def subset(self, rays: slice) -> Paths:
        """Return a subset of the rays."""
        ends = self.objects_mm[rays], self.heights_mm[rays], self.sensors_mm[rays]
        return Paths(self.shapes, self.vertices_mm, self.index, *ends)

    @cached_property
    def layout(self) -> ParameterLayout:
        """Positions of the parameters of the system."""
        return ParameterLayout(tuple(shape.terms.shape[-1] for shape in self.shapes))

    @cached_property
    def _sags(self) -> list[tuple[Array, Array, Array]]:
        """Sag of each surface and its slopes along x and y."""
        return [
            shape.sag_and_slopes(self.heights_mm[:, k, 0], self.heights_mm[:, k, 1])
            for k, shape in enumerate(self.shapes)
        ]

    @cached_property
    def own_points(self) -> Array:
        """Points in each station's own frame, shape (n, s + 2, 3); the object point is an origin."""
        own = np.zeros((len(self.objects_mm), len(self.shapes) + 2, 3), self._kind)
        for k, (sag, _, _) in enumerate(self._sags, start=1):
            own[:, k, :2], own[:, k, 2] = self.heights_mm[:, k - 1], sag
        own[:, -1, :2] = self.sensors_mm[:, :2]
        return own

    @cached_property
    def _kind(self) -> np.dtype:
        return np.result_type(
            self.heights_mm, self.objects_mm, self.vertices_mm, self.index, *(s.terms for s in self.shapes)
        )

    @cached_property
    def _steps(self) -> tuple[Array, Array]:
        """Length of each segment, shape (n, s + 1), and its direction, shape (n, s + 1, 3)."""
        points = self.own_points.copy()
        points[:, 0], points[:, -1] = self.objects_mm, self.sensors_mm
        points[:, 1:-1, 2] += self.vertices_mm
        segments = np.diff(points, axis=1)
        lengths = np.sqrt(np.sum(segments * segments, axis=-1))
        return lengths, segments / lengths[..., None]

    @property
    def lengths(self) -> Array:
        """Length of each segment in mm, shape (n, s + 1)."""
        return self._steps[0]

    @property
    def directions(self) -> Array:
        """Direction cosines of each segment, shape (n, s + 1, 3)."""
        return self._steps[1]

    @property
    def path_mm(self) -> Array:
        """Optical path length, shape (n,)."""
        return np.asarray(self.lengths @ self.index)

    @property
    def cosines(self) -> Array:
        """Direction cosines at the object, shape (n, 3)."""
        return self.directions[:, 0]

    @cached_property
    def gradient(self) -> Array:
        """Derivatives of the path by the points, shape (n, s + 2, 3); normal to the surfaces."""
        optical = self.index[:, None] * self.directions
        edge = np.zeros_like(optical[:, :1])
        return np.concatenate([edge, optical], axis=1) - np.concatenate([optical, edge], axis=1)

    @cached_property
    def by_parameters(self) -> Array:
        """Derivatives of the path by the system's parameters, shape (n, parameters)."""
        layout, gradient = self.layout, self.gradient
        found = np.zeros((len(gradient), layout.size), gradient.dtype)
        for k in range(layout.surfaces + 2):
            rotation = gradient[:, k, :, None] * self.own_points[:, k, None, :]
            found[:, layout.pose(k)] = np.concatenate(
                [rotation.reshape(len(gradient), 9), gradient[:, k]], axis=1
            )
        for k, shape in enumerate(self.shapes):
            sags = [self.term_derivatives(k, term)[0] for term in shape.TERMS[: layout.terms[k]]]
            found[:, layout.of_shape(k)] = np.stack(sags, axis=1) * gradient[:, k + 1, 2:]
        found[:, layout.indices] = self.lengths
        found[:, layout.waves] = self.path_mm
        return found

    def by_sag_error(self, surface: int, sag: Array) -> Array:
        """Return the derivative of the path by a sag error at the rays, shape (n, ...)."""
        gradient = self.gradient[:, surface + 1, 2]
        return np.asarray(gradient.reshape(-1, *(1,) * (sag.ndim - 1)) * sag)

    def term_derivatives(self, surface: int, term: str) -> tuple[Array, Array, Array]:
        """Return derivatives of a surface's sag and of its slopes along x and y by a term of its shape."""
        x, y = self.heights_mm[:, surface, 0], self.heights_mm[:, surface, 1]
        return self.shapes[surface].derivatives_by(term, x, y)

    @cached_property
    def tangents(self) -> Array:
        """Derivatives of the point on each surface by its x and y, shape (n, s, 3, 2)."""
        found = np.zeros((len(self.objects_mm), len(self.shapes), 3, 2), self._kind)
        for k, (_, across, down) in enumerate(self._sags):
            found[:, k, 0, 0] = found[:, k, 1, 1] = 1.0
            found[:, k, 2, 0], found[:, k, 2, 1] = across, down
        return found

    @cached_property
    def hessian(self) -> Array:
        """Second derivatives of the path by the points, shape (n, 3 (s + 2), 3 (s + 2))."""
        lengths, directions = self.lengths, self.directions
        stations = len(self.shapes) + 2
        across = np.eye(3) - directions[..., :, None] * directions[..., None, :]
        across = across * (self.index / lengths)[..., None, None]
        found = np.zeros((len(lengths), stations, 3, stations, 3), across.dtype)
        for j in range(stations - 1):
            found[:, j, :, j] += across[:, j]
            found[:, j + 1, :, j + 1] += across[:, j]
            found[:, j, :, j + 1] -= across[:, j]
            found[:, j + 1, :, j] -= across[:, j]
        return found.reshape(len(lengths), 3 * stations, 3 * stations)

    def along_surfaces(self, vectors: Array) -> Array:
        """Return the x and y components on each surface of vectors of shape (n, 3 (s + 2), d)."""
        n, surfaces = len(vectors), len(self.shapes)
        inner = vectors.reshape(n, surfaces + 2, 3, -1)[:, 1:-1]
        return (np.swapaxes(self.tangents, 2, 3) @ inner).reshape(n, 2 * surfaces, -1)

    @cached_property
    def surface_hessian(self) -> Array:
        """Second derivatives of the path by x and y on the surfaces, shape (n, 2 s, 2 s)."""
        n, s = len(self.objects_mm), len(self.shapes)
        half = self.along_surfaces(self.hessian)
        half = half.reshape(n, 2 * s, s + 2, 3)[:, :, 1:-1]
        found = np.einsum("nwka,nkac->nwkc", half, self.tangents)
        for k, shape in enumerate(self.shapes):
            second_derivatives = shape.second_derivatives(self.heights_mm[:, k, 0], self.heights_mm[:, k, 1])
            gradient = self.gradient[:, k + 1, 2]
            for (i, j), derivative in zip(((0, 0), (0, 1), (1, 1)), second_derivatives, strict=True):
                found[:, 2 * k + i, k, j] += gradient * derivative
                if i != j:
                    found[:, 2 * k + j, k, i] += gradient * derivative
        return found.reshape(n, 2 * s, 2 * s)


@dataclass(frozen=True, eq=False)
class SagErrors:
    """Sag errors of one surface that some of the changes cause.

    Attributes
    ----------
    surface : int
        Index of the surface.
    columns : slice
        The changes that cause the sag errors.
    sag, slope_x, slope_y : ndarray, shape (n, columns)
        Sag error in mm and its slopes for a unit of each change.
    """

    surface: int
    columns: slice
    sag: Array
    slope_x: Array
    slope_y: Array
