"""A lens at another temperature: its glass and its mount grow, its indices change, all together.

Glass grows alike in all directions: radii, thicknesses and apertures of a surface by the expansion of the
glass that it bounds (the mean of both, where it is cemented). Air spaces are held by a mount that stands on
the edges of surfaces, at their clear semi-diameters: of a space of length t between sags s and s', at the
edges L = t + s' - s, the mount grows L (1 + a_m T), and the vertices follow,

    t(T) - t = (a_m L - a' s' + a s) T,

with the expansions a of the surfaces before and behind it. So with the space between object and front
surface, and with those between last surface and sensor planes, which are mounted as flat edges of their
own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.thermal import REFERENCE_C, at_temperature
from lensdesign.lens.glass import Material, get_material, is_air
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled_edge
from lensdesign.lens.shapes.base import Shape, directions
from lensdesign.lens.surface import Surface

ALUMINIUM_PER_K = 23.6e-6
"""Linear expansion of aluminium 6061-T6 (ASM handbook, volume 2); a steel of grade 304 has 17.3e-6."""


@dataclass(frozen=True)
class ThermalExpansion:
    """How a lens grows; changes in mm for each K.

    Attributes
    ----------
    surfaces_per_k : ndarray, shape (surfaces,)
        Expansion of each surface, relative.
    object_mm_per_k
        Of the working distance.
    thickness_mm_per_k : ndarray, shape (surfaces - 1,)
        Of the spaces behind each surface but the last.
    planes_mm_per_k : ndarray, shape (planes,)
        Of the distances of the sensor's planes.
    """

    surfaces_per_k: Array
    object_mm_per_k: float
    thickness_mm_per_k: Array
    planes_mm_per_k: Array


@dataclass(frozen=True)
class Expansions:
    """Linear expansions of a lens's parts and of what holds them; in 1/K.

    Attributes
    ----------
    surfaces : ndarray, shape (surfaces,)
    glasses : tuple of float or None
        Of the glass behind each surface; None of air.
    mount
    """

    surfaces: Array
    glasses: tuple[float | None, ...]
    mount: float

    def of_space(self, surface: int, length: Array, sags: Array) -> Array:
        """Growth of the space behind a surface, from its length and the sags of all surfaces at their edges.

        It is linear in both, so that of their derivatives it makes the derivatives of the growth.

        Parameters
        ----------
        surface
            Index of the surface; -1 for the object's space.
        length : ndarray, shape (...)
            On the axis, in mm.
        sags : ndarray, shape (surfaces, ...)
            In mm.
        """
        glass = self.glasses[surface] if surface >= 0 else None
        if glass is not None:
            return glass * length
        grown = self.mount * length
        if surface >= 0:
            grown = grown - (self.mount - self.surfaces[surface]) * sags[surface]
        if surface + 1 < len(self.surfaces):
            grown = grown + (self.mount - self.surfaces[surface + 1]) * sags[surface + 1]
        return grown


def expansions(lens: Lens, mount_expansion_per_k: float = ALUMINIUM_PER_K) -> Expansions:
    """What a lens's parts expand by.

    Raises
    ------
    MaterialError
        If a glass has no known expansion, or is at a temperature already; the message names both.
    """
    own = [None if glass is None else glass.thermal.expansion_per_k for glass in _media(lens)]
    surfaces = []
    for before, behind in zip([None, *own[:-1]], own, strict=True):
        known = [value for value in (before, behind) if value is not None]
        surfaces.append(sum(known) / len(known) if known else mount_expansion_per_k)
    return Expansions(np.array(surfaces), tuple(own), mount_expansion_per_k)


def growth(lens: Lens, mount_expansion_per_k: float = ALUMINIUM_PER_K) -> ThermalExpansion:
    """How a lens and the spaces about it grow.

    Parameters
    ----------
    lens
        At `REFERENCE_C`.
    mount_expansion_per_k
        Linear expansion of what holds the lens, its elements, object and sensor apart.

    Raises
    ------
    MaterialError
        As of :func:`expansions`.
    """
    found = expansions(lens, mount_expansion_per_k)
    sags = np.array([edge_sag_mm(s.shape, s.semi_diameter_mm) for s in lens.surfaces])
    last = len(lens.surfaces) - 1
    return ThermalExpansion(
        found.surfaces,
        float(found.of_space(-1, np.array(lens.object.working_distance_mm), sags)),
        np.array(
            [
                found.of_space(i, np.array(s.thickness_mm or 0.0), sags)
                for i, s in enumerate(lens.surfaces[:last])
            ]
        ),
        found.of_space(last, np.array(lens.sensor.plane_distances_mm), sags),
    )


def lens_at_temperature(
    lens: Lens, temperature_c: float, *, mount_expansion_per_k: float = ALUMINIUM_PER_K
) -> Lens:
    """The lens as it is at another temperature, in air of that temperature.

    Its glasses are named with it, as in ``N-BK7@50C``, so that it can be saved, and traced in any of its
    wavelengths, which are those in air of `REFERENCE_C`. Field and pixels stay as they are, measured figures
    too.

    Parameters
    ----------
    lens
        As designed, at `REFERENCE_C`.
    temperature_c
        Of all of it.
    mount_expansion_per_k
        As of :func:`growth`.

    Raises
    ------
    MaterialError
        If of a glass it is not known how size or index change, or it is at a temperature already.
    DesignError
        If what comes out is no lens.
    """
    change, grown = temperature_c - REFERENCE_C, growth(lens, mount_expansion_per_k)
    surfaces = []
    for i, surface in enumerate(lens.surfaces):
        thickness = surface.thickness_mm
        if thickness is not None:
            thickness += float(grown.thickness_mm_per_k[i]) * change
        surfaces.append(
            surface.replaced(
                **heated_keys(surface, float(grown.surfaces_per_k[i]) * change),
                thickness_mm=thickness,
                material=heated_material(lens, i, temperature_c),
            )
        )
    planes = np.array(lens.sensor.plane_distances_mm) + grown.planes_mm_per_k * change
    distance = lens.object.working_distance_mm + grown.object_mm_per_k * change
    fronts = zip(lens.edges, lens.glass_fronts, strict=False)
    return lens.replaced(
        surfaces=tuple(surfaces),
        object=lens.object.replaced(working_distance_mm=distance),
        sensor=lens.sensor.replaced(plane_distances_mm=tuple(planes.tolist())),
        edges=tuple(scaled_edge(e, 1.0 + float(grown.surfaces_per_k[i]) * change) for e, i in fronts),
    )


def heated_keys(surface: Surface, growth: float) -> dict[str, Any]:
    """Keys of a surface's shape and aperture that it has when it has grown by a share."""
    factor, semi_diameter = 1.0 + growth, surface.semi_diameter_mm
    keys = surface.shape_class.scaled_keys(surface.shape_keys, factor)
    figure = surface.figure
    # Zernike terms are carried out to the new rim; a map in a file stays where it was measured.
    if figure is not None and figure.semi_diameter_mm is not None:
        figure = figure.replaced(semi_diameter_mm=factor * figure.semi_diameter_mm)
    grown = None if semi_diameter is None else factor * semi_diameter
    return {**keys, "semi_diameter_mm": grown, "figure": figure}


def heated_material(lens: Lens, surface: int, temperature_c: float) -> str | float | None:
    """What stands behind a surface, at a temperature.

    Raises
    ------
    MaterialError
        If it is not known how its index changes, or it is at a temperature already.
    """
    material = lens.surfaces[surface].material
    if is_air(material):
        return material
    glass = _glass(lens, surface)
    assert glass is not None
    if not glass.thermal.knows_index:
        raise MaterialError(
            f"surface {surface + 1}, {glass.name} ({glass.catalog}): no data says how its index changes with "
            "temperature; give a glass that has it, or an AGF catalogue with a TD record"
        )
    return at_temperature(str(material), temperature_c)


def named_at(name: str, temperature_c: float | None) -> str:
    """What something is called that is asked of a lens at a temperature; None is as designed."""
    return name if temperature_c is None else f"{name} at {temperature_c:g} C"


def check_heat(lens: Lens) -> None:
    """Refuse a lens of which it is not known what heat does to it.

    Raises
    ------
    MaterialError
        Which surface and glass, and what is missing.
    """
    expansions(lens)
    for i in range(len(lens.surfaces)):
        heated_material(lens, i, REFERENCE_C)


def _media(lens: Lens) -> list[Material | None]:
    """Glass behind each surface, or None; refuse one of unknown expansion."""
    media = [_glass(lens, i) for i in range(len(lens.surfaces))]
    for number, glass in enumerate(media, start=1):
        if glass is not None and glass.thermal.expansion_per_k is None:
            raise MaterialError(
                f"surface {number}, {glass.name} ({glass.catalog}): no data says how it expands with "
                "temperature; give a glass that has it, or an AGF catalogue with an ED record"
            )
    return media


def _glass(lens: Lens, surface: int) -> Material | None:
    material = lens.surfaces[surface].material
    if material is None or is_air(material):
        return None
    if isinstance(material, str) and "@" in material:
        raise MaterialError(f"surface {surface + 1}, {material}: is at a temperature already")
    return get_material(material, lens.glass_catalogs)


def edge_sag_mm(shape: Shape, semi_diameter_mm: float | None) -> float:
    """Mean sag along the rim of a clear aperture, where a mount holds it; 0 without one."""
    if semi_diameter_mm is None:
        return 0.0
    x, y = directions(shape)
    return float(np.mean(shape.sag(semi_diameter_mm * x, semi_diameter_mm * y)))
