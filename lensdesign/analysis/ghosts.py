"""Ghost of a lens: light that is reflected twice between its first and last surface.

The ghost is coherent with the direct light and therefore causes fringes. At a relative irradiance r their
contrast is 2 sqrt(r) / (1 + r). The sensor records only fringes with periods of more than two pixels.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lensdesign.analysis.double_reflections import has_ideal_coatings
from lensdesign.analysis.paraxial import FirstOrder, cardinal_points
from lensdesign.analysis.space_bandwidth import sensor_spread_sine
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import launch_compiled
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_indices, ghost_order, ghost_system
from lensdesign.raytrace.polarization import axial_reflection
from lensdesign.raytrace.rays import trace_compiled


@dataclass(frozen=True)
class GhostOnPlane:
    """The ghost of one object point on one plane, along y.

    Attributes
    ----------
    field_mm, plane_distance_mm : float
        Height of the object point, and distance of the plane from the exit vertex.
    from_mm, to_mm : float
        Range of y that the ghost covers.
    fringes_from_mm, fringes_to_mm : float or None
        Range of y in which the fringes of ghost and direct light have periods of more than two pixels; None
        if there is no such range.
    relative_irradiance, contrast : float or None
        Irradiance of the ghost relative to that of the direct light, and contrast of the fringes, both in the
        middle of that range.
    """

    field_mm: float
    plane_distance_mm: float
    from_mm: float
    to_mm: float
    fringes_from_mm: float | None
    fringes_to_mm: float | None
    relative_irradiance: float | None
    contrast: float | None


@dataclass(frozen=True)
class GhostReport:
    """The ghost of a lens.

    Attributes
    ----------
    fraction : float
        Fraction of the light that is left after both reflections at normal incidence (0 to 1).
    efl_mm, bfl_mm : float
        Effective and back focal length of the ghost; see :class:`lensdesign.analysis.paraxial.FirstOrder`.
    on_planes : tuple of GhostOnPlane
        Ghosts of the object points at the centre and at the edge of the field, for each plane.

    Examples
    --------
    See :func:`ghost_report`.
    """

    fraction: float
    efl_mm: float
    bfl_mm: float
    on_planes: tuple[GhostOnPlane, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, with `fraction` under the key ``share``."""
        values = asdict(self)
        return {"share": values.pop("fraction"), **values}


def uncoated_ghost_fraction(lens: Lens, wavelength_um: float | None = None) -> float:
    """Return the fraction of light left after reflection at both uncoated outer surfaces.

    The Fresnel reflectances are those of normal incidence, at a vacuum wavelength (default: the first of the
    lens).
    """
    n = lens.indices(lens.wavelengths_um[0] if wavelength_um is None else wavelength_um)
    first, last = ((n[i] - n[i + 1]) / (n[i] + n[i + 1]) for i in (0, -2))
    return float((first * last) ** 2)


def ghost_fraction(lens: Lens, wavelength_um: float | None = None) -> float:
    """Return the fraction of light left after reflection at both outer surfaces, at normal incidence.

    The reflectances are those of the coatings of the design, or of uncoated surfaces if all coatings are
    ideal, at a vacuum wavelength (default: the first of the lens).
    """
    if has_ideal_coatings(lens):
        return uncoated_ghost_fraction(lens, wavelength_um)
    system = compile_system(lens, lens.wavelengths_um[0] if wavelength_um is None else wavelength_um)
    first, last = (axial_reflection(system, i) for i in (0, system.surfaces - 1))
    return float(abs(first * last) ** 2)


def ghost_first_order(lens: Lens, wavelength_um: float | None = None) -> FirstOrder:
    """Return the cardinal points for light that is reflected at the last and then at the first surface.

    `front_principal_z_mm` and `ffl_mm` are measured from the front vertex. `rear_principal_z_mm` includes the
    backward path and is not a position on the lens.
    """
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    count = len(lens.surfaces)
    order = ghost_order(count, 0, count - 1)
    return cardinal_points(
        [lens.surfaces[i].curvature for i in order],
        np.diff(np.asarray(lens.vertex_z_mm)[order]),
        ghost_indices(lens.indices(wavelength_um), 0, count - 1),
    )


def ghost_report(
    lens: Lens, fraction: float | None = None, wavelength_um: float | None = None
) -> GhostReport:
    """Compute the ghost between the first and the last surface on the planes of the design.

    Parameters
    ----------
    lens
        The nominal lens.
    fraction
        Fraction of the light that is left after both reflections (default: that of normal incidence, with the
        coatings of the design, or of uncoated surfaces if all coatings are ideal).
    wavelength_um
        Vacuum wavelength (default: the first of the design).

    Returns
    -------
    GhostReport

    Raises
    ------
    InputError
        If the lens has only one surface, the fraction is not from 0 to 1, or too few rays arrive.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> round(ghost_report(lens).fraction, 5)
    0.00181
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    if fraction is None:
        fraction = ghost_fraction(lens, wavelength)
    if not 0.0 <= fraction <= 1.0:
        raise InputError(f"fraction of the ghost = {fraction!r}: must be from 0 to 1")
    direct = compile_system(lens, wavelength)
    ghost = ghost_system(direct, 0, direct.surfaces - 1)
    paraxial = ghost_first_order(lens, wavelength)
    points = [(h, z) for z in lens.sensor.plane_distances_mm for h in (0.0, lens.half_field_mm)]
    on_planes = (_on_plane(lens, direct, ghost, fraction, wavelength, *point) for point in points)
    return GhostReport(fraction, paraxial.efl_mm, paraxial.bfl_mm, tuple(on_planes))


def _on_plane(
    lens: Lens,
    direct: CompiledSystem,
    ghost: CompiledSystem,
    fraction: float,
    wavelength_um: float,
    field_mm: float,
    distance_mm: float,
) -> GhostOnPlane:
    """Return the ghost of an object point on a plane."""
    y, sine, irradiance = _fan(lens, direct, ghost, field_mm, distance_mm)
    direct_y, direct_sine, direct_irradiance = _fan(lens, direct, direct, field_mm, distance_mm)
    overlap = (y >= direct_y[0]) & (y <= direct_y[-1])
    difference = np.abs(sine - np.interp(y, direct_y, direct_sine))
    resolved = overlap & (difference < sensor_spread_sine(lens, wavelength_um))
    ends = float(y[0]), float(y[-1])
    if not np.any(resolved):
        return GhostOnPlane(field_mm, distance_mm, *ends, None, None, None, None)
    fringes = float(y[resolved][0]), float(y[resolved][-1])
    middle = 0.5 * (fringes[0] + fringes[1])
    relative = np.interp(middle, y, irradiance) / np.interp(middle, direct_y, direct_irradiance)
    ratio = fraction * float(relative)
    return GhostOnPlane(field_mm, distance_mm, *ends, *fringes, ratio, 2.0 * math.sqrt(ratio) / (1.0 + ratio))


def _fan(
    lens: Lens, direct: CompiledSystem, system: CompiledSystem, field_mm: float, distance_mm: float
) -> tuple[Array, Array, Array]:
    """Return y, sine of the angle to the axis, and irradiance of the rays that arrive, in order of y."""
    count, width = 2001, 1e-4  # rays of the fan, and width of a tube of rays in stop coordinates
    stop_y = np.linspace(-1.0, 1.0, count)
    pupil = np.concatenate(
        [np.column_stack([np.full(count, x), (1.0 - width) * stop_y]) for x in (0.0, width)]
    )
    origins, directions = launch_compiled(
        direct, [(0.0, field_mm)], pupil, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    rays = trace_compiled(system, origins, directions, lens.exit_vertex_z_mm + distance_mm)
    ok = rays.ok.reshape(2, count).all(axis=0)
    if np.count_nonzero(ok) < 3:
        raise InputError(
            f"field {field_mm:g} mm: fewer than three rays arrive on the plane {distance_mm:g} mm behind the "
            "lens; choose another plane or a smaller field"
        )
    position = rays.position.reshape(2, count, 3)[:, ok]
    y = position[0, :, 1]
    area = np.abs((position[1, :, 0] - position[0, :, 0]) / width * np.gradient(y, stop_y[ok]))
    order = np.argsort(y)
    sine = rays.direction.reshape(2, count, 3)[0, ok, 1]
    return y[order], sine[order], 1.0 / np.maximum(area[order], 1e-300)
