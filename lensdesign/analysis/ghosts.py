"""Where the ghost of a lens falls: light that is reflected twice between its first and last surface.

It is coherent with the light that goes straight through, so that it shows as fringes: of a relative
irradiance r they have the contrast 2 sqrt(r) / (1 + r). Only fringes wider than two pixels are recorded.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lensdesign.analysis.matching import spread_limit_sine
from lensdesign.analysis.paraxial import FirstOrder, cardinal_points
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import launch_compiled
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.ghosts import ghost_indices, ghost_order, ghost_system
from lensdesign.raytrace.rays import trace_compiled

FAN = 2001
"""Rays from rim to rim along y."""

ASIDE = 1e-4
"""In stop coordinates along x, for the width of a tube of rays."""


@dataclass(frozen=True)
class GhostOnPlane:
    """The ghost of one object point on one plane, along y.

    Attributes
    ----------
    field_mm, plane_distance_mm : float
        Height of the object point; distance from the exit vertex.
    from_mm, to_mm : float
        Where it falls.
    fringes_from_mm, fringes_to_mm : float or None
        The part of it in which its fringes with the straight light are wider than two pixels; None where
        there is none.
    relative_irradiance, contrast : float or None
        In the middle of that part: over the straight light's, and of the fringes.
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
    share : float
        Of the light, that both reflections leave.
    efl_mm, bfl_mm : float
        Its effective and back focal lengths, as of :class:`lensdesign.analysis.paraxial.FirstOrder`.
    on_planes : tuple of GhostOnPlane
        Object points in the middle and at the edge of the field, one plane after the other.
    """

    share: float
    efl_mm: float
    bfl_mm: float
    on_planes: tuple[GhostOnPlane, ...]

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self)


def uncoated_ghost_share(lens: Lens, wavelength_um: float | None = None) -> float:
    """Share of light that bare first and last surfaces reflect both, met head-on (Fresnel)."""
    n = lens.indices(lens.wavelengths_um[0] if wavelength_um is None else wavelength_um)
    first, last = ((n[i] - n[i + 1]) / (n[i] + n[i + 1]) for i in (0, -2))
    return float((first * last) ** 2)


def ghost_first_order(lens: Lens, wavelength_um: float | None = None) -> FirstOrder:
    """Cardinal points for the light that the last surface reflects, then the first one.

    `front_principal_z_mm` and `ffl_mm` count from the front vertex; the others from the end of the way there
    and back, so that only `efl_mm` and `bfl_mm` mean places of the lens itself.
    """
    wavelength_um = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    count = len(lens.surfaces)
    order = ghost_order(count, 0, count - 1)
    return cardinal_points(
        [lens.surfaces[i].curvature for i in order],
        np.diff(np.asarray(lens.vertex_z_mm)[order]),
        ghost_indices(lens.indices(wavelength_um), 0, count - 1),
    )


def ghost_report(lens: Lens, share: float | None = None, wavelength_um: float | None = None) -> GhostReport:
    """Where the ghost between the first and the last surface falls on the design's planes.

    Parameters
    ----------
    lens
        The nominal lens.
    share
        Of the light, that both reflections leave; left out, that of uncoated surfaces.
    wavelength_um
        The design's first one if left out.

    Raises
    ------
    InputError
        If the lens has one surface only, or the share is not from 0 to 1.
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    if share is None:
        share = uncoated_ghost_share(lens, wavelength)
    if not 0.0 <= share <= 1.0:
        raise InputError(f"ghost share = {share!r}: must be from 0 to 1")
    straight = compile_system(lens, wavelength)
    ghost = ghost_system(straight, 0, straight.surfaces - 1)
    paraxial = ghost_first_order(lens, wavelength)
    places = [(h, z) for z in lens.sensor.plane_distances_mm for h in (0.0, lens.half_field_mm)]
    on_planes = (_on_plane(lens, straight, ghost, share, wavelength, *place) for place in places)
    return GhostReport(share, paraxial.efl_mm, paraxial.bfl_mm, tuple(on_planes))


def _on_plane(
    lens: Lens,
    straight: CompiledSystem,
    ghost: CompiledSystem,
    share: float,
    wavelength_um: float,
    field_mm: float,
    distance_mm: float,
) -> GhostOnPlane:
    y, sine, density = _fan(lens, straight, ghost, field_mm, distance_mm)
    place, direct_sine, direct = _fan(lens, straight, straight, field_mm, distance_mm)
    met = (y >= place[0]) & (y <= place[-1])
    apart = np.abs(sine - np.interp(y, place, direct_sine))
    wide = met & (apart < spread_limit_sine(wavelength_um, lens.sensor.pixel_pitch_um))
    ends = float(y[0]), float(y[-1])
    if not np.any(wide):
        return GhostOnPlane(field_mm, distance_mm, *ends, None, None, None, None)
    among = y[wide]
    middle = 0.5 * (among[0] + among[-1])
    ratio = share * float(np.interp(middle, y, density) / np.interp(middle, place, direct))
    fringes = float(among[0]), float(among[-1])
    return GhostOnPlane(field_mm, distance_mm, *ends, *fringes, ratio, 2.0 * math.sqrt(ratio) / (1.0 + ratio))


def _fan(
    lens: Lens, straight: CompiledSystem, system: CompiledSystem, field_mm: float, distance_mm: float
) -> tuple[Array, Array, Array]:
    """Of rays that arrive, from low to high: place along y, sine of the angle to the axis, and irradiance."""
    up = np.linspace(-1.0, 1.0, FAN)
    pupil = np.concatenate([np.column_stack([np.full(FAN, x), (1.0 - ASIDE) * up]) for x in (0.0, ASIDE)])
    origins, directions = launch_compiled(
        straight, [(0.0, field_mm)], pupil, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    rays = trace_compiled(system, origins, directions, lens.exit_vertex_z_mm + distance_mm)
    ok = rays.ok.reshape(2, FAN).all(axis=0)
    if np.count_nonzero(ok) < 3:
        raise InputError(f"field {field_mm:g} mm: fewer than three rays of its light arrive")
    position = rays.position.reshape(2, FAN, 3)[:, ok]
    y = position[0, :, 1]
    tube = np.abs((position[1, :, 0] - position[0, :, 0]) / ASIDE * np.gradient(y, up[ok]))
    low_first = np.argsort(y)
    sine = rays.direction.reshape(2, FAN, 3)[0, ok, 1]
    return y[low_first], sine[low_first], 1.0 / np.maximum(tube[low_first], 1e-300)
