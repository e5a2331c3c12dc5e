"""Light that rough surfaces scatter: its fraction, its angles, and its halo on the planes of the sensor.

A height h of a refracting surface changes the phase of a ray by (2 pi / L) (n2 cos r - n1 cos i) h, with the
vacuum wavelength L, the indices n1 and n2, and the angles i of incidence and r of refraction. Two formulas
follow for Gaussian heights of the root mean square s and the correlation length l:

1. The surface scatters the fraction 1 - exp(-p^2) of the light, with the phase p of the height s. It is exact
   for a thin phase screen. Its limit p^2 for small p is the total integrated scatter of a transmitting
   surface.
2. The scattered power per solid angle is proportional to exp(-(pi l q / L)^2) in the offset q of the optical
   direction cosines along the surface (index times direction cosine). It falls to 1/e at L / (pi l).

The second formula holds for smooth surfaces (p^2 << 1) only: a light that is scattered twice has the relative
power p^2 / 2, and angles that are wider by sqrt(2). At `SMOOTH_PHASE_RAD` that is 4.5 % of the scattered
light. Both formulas need a correlation length longer than the wavelength. :attr:`RoughnessReport.notes`
states where they do not hold.

The fraction and the halo are means over many surfaces of equal statistics. In one lens, the scattered light
interferes with coherent direct light, in a random pattern. Relative to the intensity, the pattern has the
root mean square sqrt(2 F) for a scattered fraction F, which exceeds F by far. The part within the angles that
the pixels sample is in the frames. If that is most of the light, the roughness is a figure error on a small
scale, and the mean does not describe the frames of one lens.

References
----------
H. E. Bennett and J. O. Porteus, "Relation between surface roughness and specular reflectance at normal
incidence", J. Opt. Soc. Am. 51, 123 (1961).

J. E. Harvey, N. Choi, A. Krywonos and J. G. Marcen, "Calculating BRDFs from surface PSDs for moderately rough
optical surfaces", Proc. SPIE 7426, 74260I (2009).

A. Krywonos, J. E. Harvey and N. Choi, "Linear systems formulation of scattering theory for rough surfaces
with arbitrary incident and scattering angles", J. Opt. Soc. Am. A 28, 1121 (2011).

J. C. Stover, "Optical Scattering: Measurement and Analysis", 3rd edition (2012).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.space_bandwidth import sensor_spread_sine
from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.lens.surface_roughness import NO_ROUGHNESS
from lensdesign.raytrace.bundles import launch_compiled, pupil_rings
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled

SMOOTH_PHASE_RAD = 0.3
"""Largest root mean square phase of a smooth surface, for which formula 2 describes the scattered light."""

Perturbations = Mapping[int, SurfacePerturbation] | None


class RoughnessWarning(UserWarning):
    """Warning that the model of scattered light does not hold for a surface."""


@dataclass(frozen=True)
class SurfaceScatter:
    """Light that one surface scatters.

    Attributes
    ----------
    surface : int
        Number of the surface, from 1.
    rms_nm, correlation_length_um : float
        Roughness of the surface.
    mean_fraction, largest_fraction : float
        Scattered fraction of the light: mean over the rays of all field points, and largest of a ray.
    largest_phase_rad : float
        Root mean square phase of the roughness for the ray with the largest fraction.
    half_width_deg : float
        Angle to the direct light behind the lens at which the scattered power per solid angle falls to 1/e.
    halo_radius_mm : tuple of float
        Radius on each plane at which the scattered light of a ray falls to 1/e; also its root mean square
        distance from the ray.
    """

    surface: int
    rms_nm: float
    correlation_length_um: float
    mean_fraction: float
    largest_fraction: float
    largest_phase_rad: float
    half_width_deg: float
    halo_radius_mm: tuple[float, ...]


@dataclass(frozen=True)
class RoughnessReport:
    """Light that the rough surfaces of a lens scatter.

    Attributes
    ----------
    wavelength_um : float
        Vacuum wavelength.
    field_points_mm : tuple of (x, y)
        Object points.
    mean_fractions, largest_fractions : tuple of float
        Scattered fraction of the light of each object point: mean over the stop, and largest of a ray.
    half_width_deg : float
        Half-width of the scattered light of all surfaces, see :class:`SurfaceScatter`.
    plane_distances_mm, halo_radius_mm : tuple of float
        Distances of the planes from the exit vertex, and radius on each of the halo of all surfaces.
    resolved_fraction : float
        Fraction of the scattered light within the angles to the direct light that the pixels sample.
    interference_rms : float
        Root mean square of the pattern by interference of this part with coherent direct light in one lens,
        relative to the intensity.
    surfaces : tuple of SurfaceScatter
        Surfaces with roughness, front to back.
    notes : tuple of str
        Sentences on surfaces for which the model does not hold.

    Examples
    --------
    See :func:`roughness_report`.
    """

    wavelength_um: float
    field_points_mm: tuple[tuple[float, float], ...]
    mean_fractions: tuple[float, ...]
    largest_fractions: tuple[float, ...]
    half_width_deg: float
    plane_distances_mm: tuple[float, ...]
    halo_radius_mm: tuple[float, ...]
    resolved_fraction: float
    interference_rms: float
    surfaces: tuple[SurfaceScatter, ...]
    notes: tuple[str, ...]

    @property
    def mean_fraction(self) -> float:
        """Mean scattered fraction over all object points."""
        return float(np.mean(self.mean_fractions))


def scattered_fraction(phase_rad: Array) -> Array:
    """Return the fraction of light that Gaussian phases of a root mean square scatter (formula 1).

    Examples
    --------
    >>> round(float(scattered_fraction(0.1)), 5)
    0.00995
    """
    return np.asarray(-np.expm1(-np.square(phase_rad)))


def half_width_cosine(correlation_length_um: float, wavelength_um: float) -> float:
    """Return the offset of the optical direction cosine at which scattered light falls to 1/e (formula 2).

    Examples
    --------
    >>> round(half_width_cosine(10.0, 0.55), 4)
    0.0175
    """
    return wavelength_um / (math.pi * correlation_length_um)


@dataclass(frozen=True, eq=False)
class Refractions:
    """Refraction of rays at each surface.

    With perturbations of many trials, every array has a leading trial axis.

    Attributes
    ----------
    position, direction : ndarray, shape (n, surfaces, 3)
        Points on the surfaces in mm, and unit vectors of the rays behind them.
    normal : ndarray, shape (n, surfaces, 3)
        Unit normals along the change of the optical direction; NaN between media of equal index.
    path_per_height : ndarray, shape (n, surfaces)
        Change of the optical path per height of the surface, abs(n2 cos r - n1 cos i).
    ok : ndarray of bool, shape (n,)
        Whether the ray passes all surfaces.
    """

    position: Array
    direction: Array
    normal: Array
    path_per_height: Array
    ok: NDArray[np.bool_]


def refractions(system: CompiledSystem, origins: Array, directions: Array) -> Refractions:
    """Trace rays from surface to surface; arguments are those of :func:`lensdesign.raytrace.rays.trace`."""
    ok: NDArray[np.bool_] | bool = True
    positions, behind, changes = [], [], []
    position, direction = origins, directions
    for k in range(system.surfaces):
        rays = trace_compiled(system.part(k, k + 1), position, direction)
        before, after = (system.index[:, i].reshape(-1, 1, 1) for i in (k, k + 1))
        if system.trials is None:
            before, after = before[0], after[0]
        changes.append(after * rays.direction - before * direction)
        ok = ok & rays.ok
        position, direction = rays.position, np.where(rays.ok[..., None], rays.direction, direction)
        positions.append(position)
        behind.append(direction)
    # Snell's law in vectors: the change of the optical direction is along the normal.
    change = np.stack(changes, axis=-2)
    length = np.linalg.norm(change, axis=-1)
    # Rounding errors of equal indices have no direction.
    length = np.where(length < 1e-12, 0.0, length)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = np.where(length[..., None] > 0.0, change / length[..., None], np.nan)
    return Refractions(
        np.stack(positions, axis=-2), np.stack(behind, axis=-2), normal, length, np.asarray(ok)
    )


def roughness_phases_rad(
    lens: Lens, found: Refractions, wavelength_um: float, surface_perturbations: Perturbations = None
) -> Array:
    """Return the root mean square phases of rays at each surface; those of smooth surfaces are 0.

    Parameters
    ----------
    lens
        The nominal lens.
    found
        Refractions of the rays.
    wavelength_um
        Vacuum wavelength.
    surface_perturbations
        Perturbations of surfaces, whose roughness counts.

    Returns
    -------
    ndarray, shape (n, surfaces) or (trials, n, surfaces)

    Raises
    ------
    InputError
        If the roughness of a surface without a stated one is perturbed.
    """
    phases = np.zeros_like(found.path_per_height)
    for k, (rms_nm, _) in roughness_by_surface(lens, surface_perturbations).items():
        # One value for each trial, if there are trials.
        rms_um = 1e-3 * np.asarray(rms_nm)[..., None]
        phases[..., k] = 2.0 * np.pi / wavelength_um * rms_um * found.path_per_height[..., k]
    return phases


def roughness_by_surface(
    lens: Lens, surface_perturbations: Perturbations = None
) -> dict[int, tuple[Array, float]]:
    """Return root mean square height in nm and correlation length in um of rough surfaces by index from 0.

    The height is a number, or an array of shape (trials,). Its sign has no effect.

    Raises
    ------
    InputError
        If the roughness of a surface without a stated one is perturbed.
    """
    found: dict[int, tuple[Array, float]] = {}
    changes = surface_perturbations or {}
    for k, surface in enumerate(lens.surfaces):
        change = changes[k].roughness_rms_nm if k in changes else 0.0
        if surface.roughness is not None:
            stated = surface.roughness
            found[k] = np.abs(stated.rms_nm + np.asarray(change, float)), stated.correlation_length_um
        elif np.any(change):
            raise InputError(f"surface {k + 1}: roughness_rms_nm: {NO_ROUGHNESS}")
    return found


def roughness_report(
    lens: Lens,
    wavelength_um: float | None = None,
    field_points_mm: Sequence[tuple[float, float]] | None = None,
    plane_distances_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
) -> RoughnessReport | None:
    """Return the light that the rough surfaces of a lens scatter, from traced rays.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength (default: the shortest of the lens, of which most is scattered).
    field_points_mm
        Object points (default: centre and edge of the field).
    plane_distances_mm
        Distances of the planes from the exit vertex (default: those of the sensor).
    pose, surface_perturbations
        Pose of the lens and perturbations of surfaces, as single values (default: nominal).

    Returns
    -------
    RoughnessReport or None
        None if no surface has roughness.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If the roughness of a surface without a stated one is perturbed.

    Examples
    --------
    >>> from lensdesign import SurfaceRoughness, load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> rough = lens.with_surface(1, roughness=SurfaceRoughness(rms_nm=5.0, correlation_length_um=2.0))
    >>> report = roughness_report(rough)
    >>> round(report.mean_fractions[0], 5), [round(r, 2) for r in report.halo_radius_mm]
    (0.00122, [0.22, 1.97])
    """
    rough = roughness_by_surface(lens, surface_perturbations)
    if not rough:
        return None
    wavelength = min(lens.wavelengths_um) if wavelength_um is None else wavelength_um
    system = compile_system(lens, wavelength, pose, surface_perturbations)
    points = tuple(field_centre_and_edge(lens, system) if field_points_mm is None else field_points_mm)
    planes = tuple(lens.sensor.plane_distances_mm if plane_distances_mm is None else plane_distances_mm)
    stop = pupil_rings(edge=True)
    origins, directions = launch_compiled(
        system, points, stop.points, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    rays = refractions(system, origins, directions)
    phases = roughness_phases_rad(lens, rays, wavelength, surface_perturbations)
    weights = np.tile(stop.weights, len(points)) * rays.ok
    if not weights.any():
        raise DesignError(f"{lens.title or 'the lens'}: no ray passes at {wavelength:g} µm")
    total = scattered_fraction(np.linalg.norm(phases, axis=-1)).reshape(len(points), -1)
    of_point, passed = weights.reshape(total.shape), rays.ok.reshape(total.shape)
    scatters, widths = [], []
    for k, (rms_nm, length_um) in rough.items():
        powers = weights * phases[:, k] ** 2
        own = half_width_cosine(length_um, wavelength)
        sine_per_cosine, radius_per_cosine = _halo_per_cosine(lens, system, rays, k, powers, planes)
        sine, radii = own * sine_per_cosine, own * radius_per_cosine
        widths.append((float(powers.sum()), sine, radii))
        largest = float(np.max(phases[rays.ok, k]))
        scatters.append(
            SurfaceScatter(
                surface=k + 1,
                rms_nm=float(rms_nm),
                correlation_length_um=length_um,
                mean_fraction=float(weights @ scattered_fraction(phases[:, k]) / weights.sum()),
                largest_fraction=float(scattered_fraction(np.array(largest))),
                largest_phase_rad=largest,
                half_width_deg=_degrees(sine),
                halo_radius_mm=tuple(radii.tolist()),
            )
        )
    power = sum(p for p, _, _ in widths) or 1.0
    halo = np.sqrt(np.sum([p * radii**2 for p, _, radii in widths], axis=0) / power)
    limit = sensor_spread_sine(lens, wavelength)
    resolved = [_resolved(sine, limit) for _, sine, _ in widths]
    resolved_fraction = sum(p * r for (p, _, _), r in zip(widths, resolved, strict=True)) / power
    mean_fraction = float(np.sum(of_point * total) / of_point.sum())
    return RoughnessReport(
        wavelength_um=wavelength,
        field_points_mm=points,
        mean_fractions=tuple(
            (np.sum(of_point * total, axis=1) / np.maximum(of_point.sum(axis=1), 1e-300)).tolist()
        ),
        largest_fractions=tuple(np.max(np.where(passed, total, 0.0), axis=1).tolist()),
        half_width_deg=_degrees(math.sqrt(sum(p * sine**2 for p, sine, _ in widths) / power)),
        plane_distances_mm=planes,
        halo_radius_mm=tuple(halo.tolist()),
        resolved_fraction=resolved_fraction,
        interference_rms=math.sqrt(2.0 * mean_fraction * resolved_fraction),
        surfaces=tuple(scatters),
        notes=tuple(
            note
            for one, fraction in zip(scatters, resolved, strict=True)
            for note in _notes(one, wavelength, fraction)
        ),
    )


def field_centre_and_edge(lens: Lens, system: CompiledSystem) -> list[tuple[float, float]]:
    """Return the centre of the field and points on its edge: one, or eight without rotational symmetry."""
    angles = 2.0 * np.pi * np.arange(1 if system.rotational else 8) / 8
    edge = lens.half_field_mm * np.stack([np.sin(angles), np.cos(angles)], axis=-1)
    return [(0.0, 0.0), *((float(x), float(y)) for x, y in edge)]


def _halo_per_cosine(
    lens: Lens, system: CompiledSystem, rays: Refractions, k: int, powers: Array, planes_mm: Sequence[float]
) -> tuple[float, Array]:
    """Return sine behind the lens and radii on planes in mm, per unit offset of the optical cosine.

    Both are root mean square values over scattered rays, whose small offsets along the surface are isotropic.
    """
    use = np.flatnonzero((powers > 0.0) & rays.ok)
    if not len(use):
        return 0.0, np.zeros(len(planes_mm))
    normal, position = rays.normal[use, k], rays.position[use, k]
    index = float(system.index[0, k + 1])
    optical = index * rays.direction[use, k]
    across = np.sum(optical * normal, axis=-1, keepdims=True)
    along = optical - across * normal
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=-1)]
    first = np.cross(normal, axis)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    step, planes_z_mm = 1e-4, lens.exit_vertex_z_mm + np.asarray(planes_mm)
    squares_sine, squares_mm = np.zeros(len(use)), np.zeros((len(use), len(planes_mm)))
    ok = np.ones(len(use), bool)
    for tangent in (first, np.cross(normal, first)):
        ends = []
        for offset in (step, -step):
            moved = along + offset * tangent
            rest = np.sqrt(np.maximum(index**2 - np.sum(moved**2, axis=-1, keepdims=True), 0.0))
            leaving = (moved + np.sign(across) * rest * normal) / index
            leaving /= np.linalg.norm(leaving, axis=-1, keepdims=True)
            start = position
            if k + 1 < system.surfaces:
                behind = trace_compiled(system.part(k + 1, system.surfaces), position, leaving, clip=False)
                start, leaving = behind.position, behind.direction
                ok &= behind.ok
            lengths = (planes_z_mm - start[:, None, 2]) / np.where(ok, leaving[:, 2], 1.0)[:, None]
            points = start[:, None, :2] + lengths[..., None] * leaving[:, None, :2]
            if system.cover_glass is not None:
                points = points + system.cover_glass.lateral_shift_mm(leaving[:, :2])[:, None]
            ends.append((leaving[:, :2], points))
        (sine, mm), (other_sine, other_mm) = ends
        squares_sine += np.sum((0.5 * (sine - other_sine) / step) ** 2, axis=-1)
        squares_mm += np.sum((0.5 * (mm - other_mm) / step) ** 2, axis=-1)
    weights = powers[use] * ok
    # The offset has half of its mean square along each of both tangents.
    mean = 0.5 / max(float(weights.sum()), 1e-300)
    squares = np.where(ok, squares_sine, 0.0), np.where(ok[:, None], squares_mm, 0.0)
    return math.sqrt(mean * float(weights @ squares[0])), np.sqrt(mean * (weights @ squares[1]))


def _resolved(sine: float, limit: float) -> float:
    """Return the fraction of scattered light within the angle to the direct light that the pixels sample."""
    return 1.0 if sine == 0.0 else -math.expm1(-((limit / sine) ** 2))


def _notes(one: SurfaceScatter, wavelength_um: float, resolved: float) -> list[str]:
    notes, name = [], f"surface {one.surface}"
    if one.mean_fraction == 0.0:
        return []
    if one.largest_phase_rad > SMOOTH_PHASE_RAD:
        notes.append(
            f"{name}: rms_nm = {one.rms_nm:g}: the phase of {one.largest_phase_rad:.2g} rad rms exceeds the "
            f"{SMOOTH_PHASE_RAD:g} rad of a smooth surface; the scattered light is wider than stated"
        )
    if one.correlation_length_um < wavelength_um:
        notes.append(
            f"{name}: correlation_length_um = {one.correlation_length_um:g}: shorter than the wavelength of "
            f"{wavelength_um:g} µm; angles and halo are estimates, and the scattered fraction is an upper "
            "bound"
        )
    if resolved > 0.5:
        notes.append(
            f"{name}: correlation_length_um = {one.correlation_length_um:g}: the pixels sample the angles of "
            f"{100.0 * resolved:.0f} % of the scattered light, which interferes with the direct light. The "
            "smooth background is the mean of many lenses; one lens has a pattern of "
            f"{100.0 * math.sqrt(2.0 * one.mean_fraction * resolved):.2g} % rms of the intensity instead. "
            "State the heights of one lens as the figure of its surface"
        )
    return notes


def _degrees(sine: float) -> float:
    return math.degrees(math.asin(min(sine, 1.0)))
