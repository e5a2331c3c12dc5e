"""A lens at another temperature: glass and mount expand, and the refractive indices change.

Glass expands equally in all directions. Radii, thicknesses and apertures of a surface change by the expansion
of the glass that it bounds (the mean of both glasses at a cemented surface). Air spaces are set by a mount
that touches the edges of surfaces, at their clear semi-diameters. A space of length t between surfaces of
edge sags s and s' has the length L = t + s' - s at the edges. The mount expands to L (1 + a_m T), and the
vertex distance becomes

    t(T) - t = (a_m L - a' s' + a s) T,

with the coefficients a and a' of the surfaces before and behind the space. The same holds for the space
between object and front surface, and for those between last surface and sensor planes. Object and sensor
planes count as flat edges (s = 0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.thermal import REFERENCE_C, at_temperature
from lensdesign.lens.glass import Material, get_material, is_air, is_gap, is_vacuum
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled_edge
from lensdesign.lens.shapes.base import Shape, directions
from lensdesign.lens.surface import Surface

ALUMINIUM_PER_K = 23.6e-6
"""Linear expansion of aluminium 6061-T6 (ASM handbook, volume 2); a steel of grade 304 has 17.3e-6."""


@dataclass(frozen=True)
class ThermalExpansion:
    """Changes of a lens per kelvin.

    Attributes
    ----------
    surfaces_per_k : ndarray, shape (surfaces,)
        Relative expansion of each surface, in 1/K.
    object_mm_per_k
        Change of the working distance.
    thickness_mm_per_k : ndarray, shape (surfaces - 1,)
        Changes of the spaces behind each surface except the last.
    planes_mm_per_k : ndarray, shape (planes,)
        Changes of the distances of the sensor planes.
    """

    surfaces_per_k: Array
    object_mm_per_k: float
    thickness_mm_per_k: Array
    planes_mm_per_k: Array


@dataclass(frozen=True)
class ExpansionCoefficients:
    """Linear expansion coefficients of the glasses and the mount of a lens, in 1/K.

    Attributes
    ----------
    surfaces : ndarray, shape (surfaces,)
        Coefficient by which radius and aperture of each surface expand.
    glasses : tuple of float or None
        Coefficient of the glass behind each surface; None for air.
    mount
        Coefficient of the mount.
    """

    surfaces: Array
    glasses: tuple[float | None, ...]
    mount: float

    def of_space(self, surface: int, length: Array, sags: Array) -> Array:
        """Return the change per kelvin of the length of the space behind a surface.

        It is linear in `length` and `sags`. Applied to derivatives of both, it gives the derivatives of the
        change.

        Parameters
        ----------
        surface
            Index of the surface; -1 for the object space.
        length : ndarray, shape (...)
            Length of the space on the axis, in mm.
        sags : ndarray, shape (surfaces, ...)
            Sag of every surface at its edge, in mm.
        """
        glass = self.glasses[surface] if surface >= 0 else None
        if glass is not None:
            return glass * length
        change = self.mount * length
        if surface >= 0:
            change = change - (self.mount - self.surfaces[surface]) * sags[surface]
        if surface + 1 < len(self.surfaces):
            change = change + (self.mount - self.surfaces[surface + 1]) * sags[surface + 1]
        return change


def expansion_coefficients(
    lens: Lens, mount_expansion_per_k: float = ALUMINIUM_PER_K
) -> ExpansionCoefficients:
    """Return the linear expansion coefficients of the glasses and the mount of a lens.

    Raises
    ------
    MaterialError
        If the expansion of a glass is not known, or a glass is already given at a temperature. The message
        names surface and glass.
    """
    glasses = [None if glass is None else glass.thermal.expansion_per_k for glass in _media(lens)]
    surfaces = []
    for adjoining in zip([None, *glasses[:-1]], glasses, strict=True):
        known = [value for value in adjoining if value is not None]
        surfaces.append(sum(known) / len(known) if known else mount_expansion_per_k)
    return ExpansionCoefficients(np.array(surfaces), tuple(glasses), mount_expansion_per_k)


def thermal_expansion(lens: Lens, mount_expansion_per_k: float = ALUMINIUM_PER_K) -> ThermalExpansion:
    """Return the changes per kelvin of a lens and of the spaces around it.

    Parameters
    ----------
    lens
        Lens at `REFERENCE_C`.
    mount_expansion_per_k
        Linear expansion coefficient of the mount of elements, object and sensor.

    Raises
    ------
    MaterialError
        If the expansion of a glass is not known, or a glass is already given at a temperature.
    """
    coefficients = expansion_coefficients(lens, mount_expansion_per_k)
    sags = np.array([edge_sag_mm(s.shape, s.semi_diameter_mm) for s in lens.surfaces])
    last = len(lens.surfaces) - 1
    return ThermalExpansion(
        coefficients.surfaces,
        float(coefficients.of_space(-1, np.array(lens.object.working_distance_mm), sags)),
        np.array(
            [
                coefficients.of_space(i, np.array(s.thickness_mm or 0.0), sags)
                for i, s in enumerate(lens.surfaces[:last])
            ]
        ),
        coefficients.of_space(last, np.array(lens.sensor.plane_distances_mm), sags),
    )


def lens_at_temperature(
    lens: Lens, temperature_c: float, *, mount_expansion_per_k: float = ALUMINIUM_PER_K
) -> Lens:
    """Return the lens at another temperature, in air of that temperature.

    The names of its glasses include the temperature, as in ``N-BK7@50C``, so that the lens can be saved and
    traced. Its wavelengths are those in air of `REFERENCE_C`. Field, pixels, the cover glass
    of the sensor and measured figures stay as they are.

    Parameters
    ----------
    lens
        Lens as designed, at `REFERENCE_C`.
    temperature_c
        Temperature of the whole lens, its mount and the air, in degrees Celsius.
    mount_expansion_per_k
        Linear expansion coefficient of the mount of elements, object and sensor (default: aluminium).

    Returns
    -------
    Lens

    Raises
    ------
    MaterialError
        If the expansion or the change of index of a glass is not known, or a glass is already given at a
        temperature.
    DesignError
        If the result is not a valid lens.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> hot = lens_at_temperature(lens, 50.0)
    >>> hot.surfaces[0].material, round(hot.surfaces[0].radius_mm, 5)
    ('N-BK7@50C', 42.30901)
    """
    difference, per_kelvin = temperature_c - REFERENCE_C, thermal_expansion(lens, mount_expansion_per_k)
    surfaces = []
    for i, surface in enumerate(lens.surfaces):
        thickness = surface.thickness_mm
        if thickness is not None:
            thickness += float(per_kelvin.thickness_mm_per_k[i]) * difference
        surfaces.append(
            surface.replaced(
                **heated_keys(surface, float(per_kelvin.surfaces_per_k[i]) * difference),
                thickness_mm=thickness,
                material=heated_material(lens, i, temperature_c),
            )
        )
    planes = np.array(lens.sensor.plane_distances_mm) + per_kelvin.planes_mm_per_k * difference
    distance = lens.object.working_distance_mm + per_kelvin.object_mm_per_k * difference
    fronts = zip(lens.edges, lens.glass_fronts, strict=False)
    return lens.replaced(
        surfaces=tuple(surfaces),
        object=lens.object.replaced(working_distance_mm=distance),
        sensor=lens.sensor.replaced(plane_distances_mm=tuple(planes.tolist())),
        edges=tuple(
            scaled_edge(e, 1.0 + float(per_kelvin.surfaces_per_k[i]) * difference) for e, i in fronts
        ),
    )


def heated_keys(surface: Surface, expansion: float) -> dict[str, Any]:
    """Return the keys of shape, aperture and figure of a surface after a relative expansion."""
    factor, semi_diameter = 1.0 + expansion, surface.semi_diameter_mm
    keys = surface.shape_class.scaled_keys(surface.shape_keys, factor)
    figure = surface.figure
    # Zernike terms scale to the new rim; a measured grid in a file keeps its positions.
    if figure is not None and figure.semi_diameter_mm is not None:
        figure = figure.replaced(semi_diameter_mm=factor * figure.semi_diameter_mm)
    expanded = None if semi_diameter is None else factor * semi_diameter
    return {**keys, "semi_diameter_mm": expanded, "figure": figure}


def heated_material(lens: Lens, surface: int, temperature_c: float) -> str | float | None:
    """Return the material behind a surface (index from 0) at a temperature.

    Raises
    ------
    MaterialError
        If the change of its index is not known, or it is already given at a temperature.
    """
    material = lens.surfaces[surface].material
    if is_air(material):
        return material
    if is_vacuum(material):
        return at_temperature("VACUUM", temperature_c)
    glass = _glass(lens, surface)
    assert glass is not None
    if not glass.thermal.knows_index:
        raise MaterialError(
            f"surface {surface + 1}, {glass.name} ({glass.catalog}): the change of its index with "
            "temperature is not known; use a glass for which it is, or an AGF catalogue with a TD record"
        )
    return at_temperature(str(material), temperature_c)


def named_at(name: str, temperature_c: float | None) -> str:
    """Return the name of a quantity with the temperature at which it is required; None is as designed."""
    return name if temperature_c is None else f"{name} at {temperature_c:g} C"


def check_heat(lens: Lens) -> None:
    """Check that the thermal data of all glasses of a lens are known.

    Raises
    ------
    MaterialError
        If data are missing; the message names surface, glass and the missing data.
    """
    expansion_coefficients(lens)
    for i in range(len(lens.surfaces)):
        heated_material(lens, i, REFERENCE_C)


def _media(lens: Lens) -> list[Material | None]:
    """Return the glass behind each surface, or None for air; refuse a glass of unknown expansion."""
    media = [_glass(lens, i) for i in range(len(lens.surfaces))]
    for number, glass in enumerate(media, start=1):
        if glass is not None and glass.thermal.expansion_per_k is None:
            raise MaterialError(
                f"surface {number}, {glass.name} ({glass.catalog}): its thermal expansion is not known; use "
                "a glass for which it is, or an AGF catalogue with an ED record"
            )
    return media


def _glass(lens: Lens, surface: int) -> Material | None:
    material = lens.surfaces[surface].material
    if material is None or is_gap(material):
        return None
    if isinstance(material, str) and "@" in material:
        raise MaterialError(
            f"surface {surface + 1}, {material}: already given at a temperature; remove the part from '@' on"
        )
    return get_material(material, lens.glass_catalogs)


def edge_sag_mm(shape: Shape, semi_diameter_mm: float | None) -> float:
    """Return the mean sag in mm along the rim of a clear aperture; 0 without one."""
    if semi_diameter_mm is None:
        return 0.0
    x, y = directions(shape)
    return float(np.mean(shape.sag(semi_diameter_mm * x, semi_diameter_mm * y)))
