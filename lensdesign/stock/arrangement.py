"""Stock lenses in one or two orientations, one behind the other, as a lens of a specification."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge
from lensdesign.lens.glass import get_material, is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.reversal import mirrored_keys, reversed_surfaces
from lensdesign.lens.shapes.base import axial_gaps_mm
from lensdesign.lens.shapes.intersection import intersect
from lensdesign.lens.surface import Surface
from lensdesign.optimization.specification.specification import Specification
from lensdesign.stock.vendor_files import surface_tables

LEAST_GAP_MM = 0.01
"""Smallest distance between vertices of two lenses; a design needs one above 0."""


@dataclass(frozen=True, eq=False)
class StockLens:
    """A single lens or cemented group of one or more vendors' files.

    Attributes
    ----------
    files : tuple of str
        Files with this lens, relative to the folder; further ones differ in name or coating alone.
    title : str
        Title in the first file.
    surfaces : tuple of Surface
        Surfaces of the glass, front to back, with their clear semi-diameters.
    edge_semi_diameter_mm : float or None
        Radius of the edge; None means the largest clear semi-diameter.
    """

    files: tuple[str, ...]
    title: str
    surfaces: tuple[Surface, ...]
    edge_semi_diameter_mm: float | None = None

    @property
    def semi_diameter_mm(self) -> float:
        """Radius of the edge: the largest semi-diameter in the file."""
        return self.edge_semi_diameter_mm or max(surface.semi_diameter_mm or 0.0 for surface in self.surfaces)


@dataclass(frozen=True, eq=False)
class OrientedLens:
    """A stock lens in one of its two orientations."""

    lens: StockLens
    is_reversed: bool = False

    @cached_property
    def surfaces(self) -> tuple[Surface, ...]:
        """Surfaces in the order in which light meets them."""
        return reversed_surfaces(self.lens.surfaces) if self.is_reversed else self.lens.surfaces

    @property
    def name(self) -> str:
        """Name of the file without its suffix, and whether the lens is reversed."""
        return Path(self.lens.files[0]).stem + (" reversed" if self.is_reversed else "")


def orientations(lens: StockLens) -> tuple[OrientedLens, ...]:
    """Return both orientations of a lens; a single one if the lens is symmetric."""
    return (
        (OrientedLens(lens),)
        if _is_symmetric(lens.surfaces)
        else (OrientedLens(lens), OrientedLens(lens, True))
    )


def _is_symmetric(surfaces: Sequence[Surface]) -> bool:
    """Return whether a lens is the same when it is turned around."""
    spaces = [(surface.thickness_mm, surface.material) for surface in surfaces[:-1]]
    return spaces == spaces[::-1] and all(
        front.semi_diameter_mm == back.semi_diameter_mm
        and front.shape_class is back.shape_class
        and front.shape_keys == mirrored_keys(back)
        for front, back in zip(surfaces, reversed(surfaces), strict=True)
    )


def geometry_key(surfaces: Sequence[Surface]) -> str:
    """Return a text that is equal for lenses of equal surfaces and glasses."""
    return json.dumps(surface_tables(surfaces), sort_keys=True)


@dataclass(frozen=True, eq=False)
class Arrangement:
    """One or two stock lenses on the axis, each in one orientation.

    Attributes
    ----------
    parts : tuple of OrientedLens
        Lenses in the order in which light meets them.
    """

    parts: tuple[OrientedLens, ...]

    @property
    def name(self) -> str:
        """Names of the lenses, in order."""
        return " + ".join(part.name for part in self.parts)

    @property
    def thickness_mm(self) -> float:
        """Sum of the centre thicknesses of the lenses."""
        return sum(s.thickness_mm or 0.0 for part in self.parts for s in part.surfaces)

    def spacings_mm(self, specification: Specification) -> tuple[float, float]:
        """Return the smallest and the largest distance between the vertices of two lenses.

        The smallest keeps the air gap of the specification on the axis and at the edge. The largest is that
        of the only air space that is a variable of the specification, else what the largest thickness of the
        specification leaves, else the clear diameter of the wider lens. Both are 0 for a single lens.

        Raises
        ------
        InputError
            If the surfaces do not reach the edge, or no distance remains.
        """
        if len(self.parts) == 1:
            return 0.0, 0.0
        front, back = self.parts[0].surfaces[-1], self.parts[1].surfaces[0]
        widest = max(part.lens.semi_diameter_mm for part in self.parts)
        narrowest = float(np.min(axial_gaps_mm(front.shape, back.shape, 0.0, np.linspace(0.0, widest, 65))))
        if math.isnan(narrowest):
            raise InputError("a surface ends within the edge of the other lens")
        least = max(LEAST_GAP_MM, specification.constraints.min_air_gap_mm - min(narrowest, 0.0))
        # The check reads the saved design, in which the rounding of a sum may take a little.
        least += 1e-9 * widest
        low, high = least, 2.0 * max(part.lens.semi_diameter_mm for part in self.parts)
        stated = _stated_spacing_mm(specification)
        if stated is not None:
            low, high = max(least, stated[0]), stated[1]
        elif specification.constraints.max_lens_thickness_mm is not None:
            high = specification.constraints.max_lens_thickness_mm - self.thickness_mm
        if high < low:
            raise InputError(f"the lenses need a distance of {low:.4g} mm; allowed: at most {high:.4g} mm")
        return low, high

    def stop_semi_diameter_mm(self, specification: Specification, working_distances_mm: Array) -> Array:
        """Return the semi-diameter of the stop on the first surface; NaN where the light misses it."""
        distances = np.atleast_1d(np.asarray(working_distances_mm, float))
        if specification.optimize.stop == "fixed":
            return np.full(distances.shape, specification.stop_semi_diameter_mm)
        sine = specification.required_object.numerical_aperture
        flat = distances.ravel()
        position = np.stack([np.zeros_like(flat), np.zeros_like(flat), -flat], axis=-1)
        direction = np.tile([0.0, sine, math.sqrt(1.0 - sine * sine)], (len(flat), 1))
        with np.errstate(all="ignore"):
            length, hit, converged = intersect(position, direction, self.parts[0].surfaces[0].shape)
        height = np.where(hit & converged, length * sine, np.nan)
        return height.reshape(distances.shape)

    def design(
        self,
        specification: Specification,
        working_distance_mm: float,
        spacing_mm: float,
        glass_catalogs: Sequence[Path] = (),
    ) -> Lens:
        """Return the lens with object, sensor and wavelengths of the specification.

        The stop is on the first surface. Every element has the edge of its file.

        Raises
        ------
        InputError
            If these lenses form no valid design at these distances.
        """
        stop = float(self.stop_semi_diameter_mm(specification, np.array(working_distance_mm))[0])
        clear = self.parts[0].surfaces[0].semi_diameter_mm or 0.0
        if math.isnan(stop):
            raise InputError("the light of the numerical aperture misses the first surface")
        if stop > clear * (1.0 + 1e-9):
            raise InputError(f"the stop of {stop:.4g} mm exceeds the first surface of {clear:.4g} mm")
        return self._lens(specification, working_distance_mm, spacing_mm, min(stop, clear), glass_catalogs)

    def widest_design(
        self, specification: Specification, spacing_mm: float, glass_catalogs: Sequence[Path] = ()
    ) -> Lens:
        """Return the lens at the largest working distance, with the stop of the smallest one if that fits."""
        near, far = working_distances_mm(specification)
        stop = float(self.stop_semi_diameter_mm(specification, np.array(near))[0])
        clear = self.parts[0].surfaces[0].semi_diameter_mm or 0.0
        return self._lens(
            specification, far, spacing_mm, min(clear, stop if stop > 0.0 else clear), glass_catalogs
        )

    def _lens(
        self,
        specification: Specification,
        working_distance_mm: float,
        spacing_mm: float,
        stop_mm: float,
        glass_catalogs: Sequence[Path],
    ) -> Lens:
        surfaces, edges = [], []
        for i, part in enumerate(self.parts):
            own = list(part.surfaces)
            if i + 1 < len(self.parts):
                own[-1] = own[-1].replaced(thickness_mm=spacing_mm)
            surfaces += own
            glass = sum(not is_gap(surface.material) for surface in own)
            edges += [Edge(semi_diameter_mm=part.lens.semi_diameter_mm)] * glass
        surfaces[0] = surfaces[0].replaced(semi_diameter_mm=stop_mm, stop=True)
        distance = f", {spacing_mm:.4g} mm apart" if len(self.parts) > 1 else ""
        return specification.lens.replaced(
            title=f"{self.name}{distance}",
            glass_catalogs=self._needed_catalogs(glass_catalogs),
            object=specification.required_object.replaced(working_distance_mm=working_distance_mm),
            surfaces=tuple(surfaces),
            edges=tuple(edges),
        )

    def _needed_catalogs(self, catalogs: Sequence[Path]) -> tuple[Path, ...]:
        """Return the catalogues, or none if all glasses are those of the database."""
        own = {catalog.name for catalog in catalogs}
        glasses = {s.material for part in self.parts for s in part.surfaces if isinstance(s.material, str)}
        used = {get_material(glass, catalogs).catalog for glass in glasses}
        return tuple(catalogs) if used & own else ()


def _stated_spacing_mm(specification: Specification) -> tuple[float, float] | None:
    """Return the bounds of the only variable air space of the specification's lens, if there is one."""
    spaces = [
        variable.bounds
        for variable in specification.variables
        if variable.parameter == "thickness_mm"
        and variable.bounds is not None
        and is_gap(specification.surfaces[(variable.surface or 1) - 1].material)
    ]
    return spaces[0] if len(spaces) == 1 else None


def working_distances_mm(specification: Specification) -> tuple[float, float]:
    """Return the smallest and largest working distance that a specification permits."""
    for variable in specification.variables:
        if variable.parameter == "working_distance_mm" and variable.bounds is not None:
            return variable.bounds
    distance = specification.object.working_distance_mm
    return distance, distance
