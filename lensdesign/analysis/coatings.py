"""Effects of the coatings on the light: transmittance, apodization, and polarization behind the lens.

A report states them at one wavelength, for the surfaces and for the light of object points, from the Jones
matrices of traced rays (:mod:`lensdesign.raytrace.polarization`). Means are over the stop, for the rays that
pass the lens; lost rays count in the throughput, not here. Reflected light that meets the sensor is a ghost,
and is not part of a transmittance.

References
----------
R. A. Chipman, W.-S. T. Lam and G. Young, "Polarized Light and Optical Systems" (2018), chapters 6 and 9.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lensdesign.analysis.roughness import field_centre_and_edge
from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.files.surface_coatings import compile_coatings
from lensdesign.lens.coatings.coating import coating_text
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import launch_compiled, pupil_rings
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.polarization import (
    PolarizedRays,
    jones_matrices,
    surface_coefficients,
)
from lensdesign.raytrace.rays import trace_compiled


@dataclass(frozen=True)
class SurfaceTransmittance:
    """Coating of one surface, and the light that it transmits.

    Attributes
    ----------
    surface : int
        Number of the surface, from 1.
    coating : str
        The coating in a few words.
    transmittance : float
        Transmittance at normal incidence.
    largest_incidence_deg : float
        Largest angle of incidence of a ray, in the medium in front of the surface.
    transmittance_at_largest : float
        Transmittance of unpolarized light at this angle.
    """

    surface: int
    coating: str
    transmittance: float
    largest_incidence_deg: float
    transmittance_at_largest: float


@dataclass(frozen=True)
class PointTransmittance:
    """Light of one object point behind the lens.

    Attributes
    ----------
    field_mm : (x, y)
        Object point.
    transmittance : float
        Mean transmittance of unpolarized light.
    uncoated_transmittance : float
        The same if no surface had a coating (Fresnel reflections).
    apodization_rms : float
        Root mean square deviation of the amplitude from its mean, relative to the mean. The amplitude of a
        ray is the root of its transmittance.
    largest_diattenuation : float
        Largest diattenuation of a ray (0 to 1).
    largest_retardance_deg : float
        Largest retardance of a ray.
    crossed_rms : float
        Root mean square amplitude of the crossed polarization for light that is polarized along x or y,
        relative to that of all light. Ideal coatings have some, too: refraction rotates the polarization of
        skew rays.
    """

    field_mm: tuple[float, float]
    transmittance: float
    uncoated_transmittance: float
    apodization_rms: float
    largest_diattenuation: float
    largest_retardance_deg: float
    crossed_rms: float


@dataclass(frozen=True)
class CoatingReport:
    """Effects of the coatings of a lens on the light of one wavelength.

    Attributes
    ----------
    wavelength_um : float
        Vacuum wavelength.
    is_ideal : bool
        Whether all surfaces have the ideal coating, which transmits all light.
    surfaces : tuple of SurfaceTransmittance
        All surfaces, front to back.
    points : tuple of PointTransmittance
        Object points: the centre of the field first, then its edge.

    Examples
    --------
    See :func:`coating_report`.
    """

    wavelength_um: float
    is_ideal: bool
    surfaces: tuple[SurfaceTransmittance, ...]
    points: tuple[PointTransmittance, ...]

    @property
    def centre(self) -> PointTransmittance:
        """The light of the field's centre."""
        return self.points[0]

    @property
    def edge(self) -> PointTransmittance:
        """The worst value of each quantity on the edge of the field; the point is that of the first value."""
        edge = self.points[1:] or self.points
        return PointTransmittance(
            field_mm=edge[0].field_mm,
            transmittance=min(p.transmittance for p in edge),
            uncoated_transmittance=min(p.uncoated_transmittance for p in edge),
            apodization_rms=max(p.apodization_rms for p in edge),
            largest_diattenuation=max(p.largest_diattenuation for p in edge),
            largest_retardance_deg=max(p.largest_retardance_deg for p in edge),
            crossed_rms=max(p.crossed_rms for p in edge),
        )


def coating_report(
    lens: Lens,
    wavelength_um: float | None = None,
    field_points_mm: Sequence[tuple[float, float]] | None = None,
) -> CoatingReport:
    """Return the effects of a lens' coatings on the light, from traced rays.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    field_points_mm
        Object points (default: centre and edge of the field).

    Raises
    ------
    DesignError
        If no ray of an object point passes the lens.
    InputError
        If a coating's table ends before the angles of the rays, or a film is not known at the wavelength.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> report = coating_report(load_design("designs/paper_singlet.toml").with_coating("mgf2"))
    >>> report.surfaces[0].coating
    'MgF2, quarter wave at 532 nm'
    >>> [round(value, 3) for value in (report.centre.transmittance, report.centre.uncoated_transmittance)]
    [0.97, 0.913]
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    system = compile_system(lens, wavelength)
    points = field_centre_and_edge(lens, system) if field_points_mm is None else field_points_mm
    stop = pupil_rings(edge=True)
    origins, directions = launch_compiled(
        system, points, stop.points, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    rays = trace_compiled(system, origins, directions, record_hits=True)
    light = jones_matrices(system, origins, rays)
    uncoated = replace(system, coatings=compile_coatings(lens.with_coating("bare"), wavelength))
    without = jones_matrices(uncoated, origins, rays).transmittance
    results = []
    for point, chosen in zip(points, np.split(np.arange(len(rays.ok)), len(points)), strict=True):
        weights = stop.weights * rays.ok[chosen]
        if not weights.any():
            raise DesignError(
                f"{lens.title or 'the lens'}: no ray from the object point ({point[0]:g}, {point[1]:g}) mm "
                f"passes at {wavelength:g} µm"
            )
        own = PolarizedRays(
            light.jones[chosen], light.before[chosen], light.after[chosen], light.cos_incidence[chosen]
        )
        results.append(_point(point, own, without[chosen], weights / weights.sum()))
    surfaces = []
    for i, surface in enumerate(lens.surfaces):
        smallest = float(np.min(light.cos_incidence[..., i]))
        found, _ = surface_coefficients(system, i, np.array([1.0, smallest]))
        normal, at_largest = 0.5 * (np.abs(found.ts) ** 2 + np.abs(found.tp) ** 2)
        surfaces.append(
            SurfaceTransmittance(
                surface=i + 1,
                coating=coating_text(surface.coating, lens.wavelengths_um[0]),
                transmittance=float(normal),
                largest_incidence_deg=math.degrees(math.acos(smallest)),
                transmittance_at_largest=float(at_largest),
            )
        )
    is_ideal = all(coating.is_ideal for coating in system.coatings)
    return CoatingReport(wavelength, is_ideal, tuple(surfaces), tuple(results))


def _point(
    field_mm: tuple[float, float], rays: PolarizedRays, uncoated: Array, weights: Array
) -> PointTransmittance:
    """Return the light of an object point; the weights of its rays have the sum 1."""

    def mean(values: Array) -> float:
        return float(np.sum(weights * np.where(weights > 0.0, values, 0.0)))

    transmittance, amplitude = mean(rays.transmittance), mean(np.sqrt(rays.transmittance))
    variance = mean((np.sqrt(rays.transmittance) - amplitude) ** 2)
    crossed = 0.5 * (np.abs(rays.jones[:, 0, 1]) ** 2 + np.abs(rays.jones[:, 1, 0]) ** 2)
    return PointTransmittance(
        field_mm=field_mm,
        transmittance=transmittance,
        uncoated_transmittance=mean(uncoated),
        apodization_rms=math.sqrt(variance) / amplitude,
        largest_diattenuation=float(np.nanmax(rays.diattenuation)),
        largest_retardance_deg=math.degrees(float(np.nanmax(rays.retardance_rad))),
        crossed_rms=math.sqrt(mean(crossed) / transmittance),
    )
