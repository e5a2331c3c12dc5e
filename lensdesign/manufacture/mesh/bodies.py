"""Glass bodies of a nominal or perturbed lens, and the result of meshing them.

A body whose surfaces are surfaces of revolution about the axis has exact meridians. Otherwise each surface is
described by its height along the axis above every point within the ground edge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SurfacePerturbation
from lensdesign.lens.shapes.intersection import intersect
from lensdesign.lens.solid import Element, glass_elements, validate_closed
from lensdesign.raytrace.compiled import CompiledSystem, compile_system

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class LensMesh:
    """A closed mesh and its errors.

    Attributes
    ----------
    mesh : trimesh.Trimesh
        Mesh in mm. The front vertex of the lens is the origin, +z points to the sensor, normals point
        outwards.
    chord_error_um
        Largest measured distance of the facets of the optical surfaces from the exact surfaces in um.
    edge_error_um
        Largest distance of the facets of the ground edge from its cylinder in um.
    volume_mm3
        Volume of the mesh in mm^3.
    exact_volume_mm3
        Volume of the exact body in mm^3, by quadrature.
    """

    mesh: trimesh.Trimesh
    chord_error_um: float
    edge_error_um: float
    volume_mm3: float
    exact_volume_mm3: float

    @property
    def triangles(self) -> int:
        """Number of facets."""
        return len(self.mesh.faces)

    @property
    def volume_error(self) -> float:
        """Relative error of the volume: mesh over exact body, minus 1."""
        return self.volume_mm3 / self.exact_volume_mm3 - 1.0

    @property
    def volume_tolerance(self) -> float:
        """Bound of :attr:`volume_error`: largest distance times the area of the mesh, over the volume."""
        distance_mm = 1e-3 * max(self.chord_error_um, self.edge_error_um)
        return float(distance_mm * self.mesh.area / self.exact_volume_mm3)


@dataclass(frozen=True)
class HeightSurface:
    """A surface of a perturbed lens, as heights along the axis of the lens.

    Attributes
    ----------
    system
        The perturbed lens without a pose.
    index
        Index of the surface, from 0.
    end_mm
        Radial height in mm beyond which the surface is flat; inf if it continues with its own sag.
    """

    system: CompiledSystem
    index: int
    end_mm: float

    @property
    def finest_mm(self) -> float:
        """Spacing of the finest figure in mm; inf without a figure."""
        return min((f.spacing_mm for f in self.system.figures[self.index]), default=np.inf)

    def heights(self, x: Array, y: Array) -> Array:
        """Return z in mm above points of the lens's frame; NaN where there is no surface."""
        vertex = self.system.vertex[0, self.index]
        if not self.system.tilted[self.index]:
            across, down, _ = self._clamped(x - vertex[0], y - vertex[1])
            return np.asarray(vertex[2] + self.system.sag(self.index, across, down))
        rotation = self.system.rotation[0, self.index]
        start = np.stack([x, y, np.full_like(x, vertex[2])], axis=-1).reshape(-1, 3)
        direction = np.broadcast_to(rotation[2], start.shape)
        distance, hit, converged = intersect(
            (start - vertex) @ rotation,
            direction,
            self.system.shapes[self.index].trial(0),
            self.system.sag_error(self.index),
        )
        z = np.where(hit & converged, vertex[2] + distance, np.nan)
        return np.asarray(z.reshape(x.shape))

    def rises(self, points: Array) -> tuple[Array, Array]:
        """Return the heights of points above the surface along the surface's z, and the slope's cosine.

        Their product is the distance of the points from the surface, to first order.

        Parameters
        ----------
        points
            Points in the lens's frame in mm, shape (..., 3).
        """
        own = (points - self.system.vertex[0, self.index]) @ self.system.rotation[0, self.index]
        x, y, flat = self._clamped(own[..., 0], own[..., 1])
        z, dx, dy = self.system.sag_and_slopes(self.index, x, y)
        slope2 = np.where(flat, 0.0, dx * dx + dy * dy)
        return own[..., 2] - z, 1.0 / np.sqrt(1.0 + slope2)

    def _clamped(self, x: Array, y: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the points, clamped to the start of the flat annulus, and which points were clamped."""
        if np.isinf(self.end_mm):
            return x, y, np.zeros(x.shape, bool)
        r = np.hypot(x, y)
        scale = np.minimum(1.0, self.end_mm / np.maximum(r, self.end_mm))
        return x * scale, y * scale, r > self.end_mm


@dataclass(frozen=True)
class PerturbedBodies:
    """The glass bodies of one perturbed lens.

    Attributes
    ----------
    system
        The perturbed lens without a pose.
    elements
        Its bodies, with those perturbations that keep them bodies of revolution.
    """

    system: CompiledSystem
    elements: tuple[Element, ...]

    def symmetric(self, index: int) -> bool:
        """Return whether a body is a body of revolution about the axis of the lens."""
        element = self.elements[index]
        return element.rotational and not any(
            self._displaced(i) or self.system.figures[i] for i in element.surfaces
        )

    def _displaced(self, i: int) -> bool:
        return bool(self.system.tilted[i] or np.any(self.system.vertex[0, i, :2]))

    def surfaces(self, index: int) -> tuple[HeightSurface, HeightSurface]:
        """Return the front and the back surface of a body."""
        element = self.elements[index]
        front, back = (
            HeightSurface(self.system, i, m.end_mm if len(end) and not self._displaced(i) else np.inf)
            for i, m, end in zip(element.surfaces, (element.front, element.back), element.ends, strict=True)
        )
        return front, back


def perturbed_bodies(
    lens: Lens, surface_perturbations: Mapping[int, SurfacePerturbation] | None, measured: bool
) -> PerturbedBodies:
    """Return the bodies of a lens with perturbed surfaces.

    Parameters
    ----------
    lens
        A lens with at least one glass element.
    surface_perturbations
        Deviations of single surfaces by surface index from 0; scalars only.
    measured
        Whether surfaces have their measured figures.

    Raises
    ------
    InputError
        If perturbations hold several trials, if the perturbed lens is not valid, or if a body of revolution
        does not close.
    """
    changes = dict(surface_perturbations or {})
    if not measured:
        for i, surface in enumerate(lens.surfaces):
            lens = lens if surface.figure is None else lens.with_surface(i, figure=None)
    system = compile_system(lens, lens.wavelengths_um[0], surface_perturbations=changes)
    if system.trials not in (None, 1):
        raise InputError(
            f"surface_perturbations hold {system.trials} trials; a mesh represents one lens, so give scalars"
        )
    for i, change in changes.items():
        lens = _with_design_deltas(lens, i, change)
    elements = tuple(_with_vertices(e, system) for e in glass_elements(lens))
    bodies = PerturbedBodies(system, elements)
    for index, element in enumerate(elements):
        if bodies.symmetric(index):
            validate_closed(element)
    return bodies


def _with_design_deltas(lens: Lens, i: int, change: SurfacePerturbation) -> Lens:
    """Return the lens with those deviations of one surface that a design file can represent."""
    surface = lens.surfaces[i]
    values: dict[str, Any] = {}
    for name, delta in change.shape_deltas().items():
        by = float(np.ravel(delta)[0])
        if name.startswith("radius"):
            values[name] = getattr(surface, name) + by
        else:
            keys = surface.shape_keys | values
            values |= surface.shape_class.changed_keys(keys, name, surface.shape.term(name) + by)
    if surface.thickness_mm is not None and np.any(change.thickness_mm):
        values["thickness_mm"] = surface.thickness_mm + float(np.ravel(change.thickness_mm)[0])
    return lens.with_surface(i, **values) if values else lens


def _with_vertices(element: Element, system: CompiledSystem) -> Element:
    front, back = (
        replace(m, vertex_z_mm=float(system.vertex[0, i, 2]))
        for m, i in zip((element.front, element.back), element.surfaces, strict=True)
    )
    return replace(element, front=front, back=back)
