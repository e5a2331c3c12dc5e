"""The beam behind a lens by traced rays: spread angle, footprint, spot and throughput.

Failed rays are excluded from every value, and every result states the throughput on which it is based.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.bundles import launch_pairs, pupil_rings
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.extremes import Extremes, Metric, find_extremes
from lensdesign.raytrace.plane_plate import PlanePlate
from lensdesign.raytrace.rays import RayTrace, trace_compiled

Perturbations = Mapping[int, SurfacePerturbation] | None


@dataclass(frozen=True)
class SpreadAngle:
    """Largest angle to the axis behind the lens.

    Attributes
    ----------
    spread_deg
        Largest angle over the whole field and pupil.
    field_mm, pupil
        Object point, and stop point relative to the semi-diameter, of the ray with the largest angle.
    field_heights_mm, per_field_deg
        Field heights, and the largest angle over the pupil at each; NaN where no ray passes.
    throughput
        Smallest throughput over the field heights.
    """

    spread_deg: float
    field_mm: tuple[float, float]
    pupil: tuple[float, float]
    field_heights_mm: tuple[float, ...]
    per_field_deg: tuple[float, ...]
    throughput: float


@dataclass(frozen=True)
class Footprint:
    """Extent of the light of the whole field on a plane behind the lens.

    Attributes
    ----------
    plane_distance_mm
        Distance of the plane from the exit vertex.
    radius_mm
        Largest distance of a ray from the axis.
    field_mm, pupil
        Object point and stop point of that ray.
    sensor_half_side_mm
        Half of the sensor's shorter side, which limits the radius, since the field is round. If a surface is
        not rotationally symmetric, each side of the sensor limits the light in its own direction.
    inside
        Whether all light lands on the sensor.
    margin_mm
        `sensor_half_side_mm` - `radius_mm`; if a surface is not rotationally symmetric, the smaller margin of
        both sides.
    throughput
        Smallest throughput over the field.
    """

    plane_distance_mm: float
    radius_mm: float
    field_mm: tuple[float, float]
    pupil: tuple[float, float]
    sensor_half_side_mm: float
    inside: bool
    margin_mm: float
    throughput: float


@dataclass(frozen=True)
class Spot:
    """Spot of one object point.

    Attributes
    ----------
    rms_diameter_mm
        Twice the RMS distance of the rays from their centroid.
    centroid_mm
        x and y of the centroid.
    throughput
        Fraction of the uniformly filled stop that passes (0 to 1).
    """

    rms_diameter_mm: float
    centroid_mm: tuple[float, float]
    throughput: float


@dataclass(frozen=True)
class Throughput:
    """Fraction of a uniformly filled stop that passes the lens.

    Attributes
    ----------
    throughput
        Smallest fraction over the field (0 to 1).
    field_heights_mm, per_field
        Field heights, and the fraction at each.
    """

    throughput: float
    field_heights_mm: tuple[float, ...]
    per_field: tuple[float, ...]


def largest_spread_angle(
    lens: Lens,
    wavelength_um: float | None = None,
    field_heights_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
) -> SpreadAngle:
    """Return the largest angle to the axis behind the lens over field and pupil (the left side of Eq. 2).

    A dense sampling is refined in field height, azimuth and pupil to a precision of 1e-6 deg.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    field_heights_mm
        Object heights (default: the whole field).
    pose, surface_perturbations
        Pose of the lens and perturbations of surfaces, as single values (default: nominal). With them, all
        azimuths of the field are searched.

    Returns
    -------
    SpreadAngle

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If a field height lies outside the field, or a perturbation has arrays of trials.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> round(largest_spread_angle(lens).spread_deg, 2)
    4.81
    """
    (found,), passes = _largest(lens, [None], wavelength_um, field_heights_mm, pose, surface_perturbations)
    return _spread(found, passes)


def footprint(
    lens: Lens,
    wavelength_um: float | None = None,
    plane_distance_mm: float = 3.0,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
) -> Footprint:
    """Return the radius of the light of the whole field on a plane, and whether it fits on the sensor.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    plane_distance_mm
        Distance of the plane from the nominal exit vertex.
    pose, surface_perturbations
        Pose of the lens and perturbations of surfaces, as single values (default: nominal).

    Returns
    -------
    Footprint

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If a perturbation has arrays of trials.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> round(footprint(lens, plane_distance_mm=2.0).radius_mm, 3)
    10.06
    """
    found = _largest(lens, [plane_distance_mm], wavelength_um, None, pose, surface_perturbations)
    return _footprint(lens, plane_distance_mm, *found)


def spread_angle_and_footprints(
    lens: Lens, wavelength_um: float, plane_distances_mm: Sequence[float], refined: bool = True
) -> tuple[SpreadAngle, tuple[Footprint, ...], Throughput]:
    """Return spread, footprint on each plane and throughput together, which is faster than one by one.

    Without `refined`, the values are the largest of a dense sampling, which takes a tenth of the time.
    """
    (angle, *reaches), passes = _largest(lens, [None, *plane_distances_mm], wavelength_um, refined=refined)
    each = len(reaches) // len(plane_distances_mm)
    footprints = tuple(
        _footprint(lens, distance, reaches[i * each : (i + 1) * each], passes)
        for i, distance in enumerate(plane_distances_mm)
    )
    return _spread(angle, passes), footprints, passes


def rms_spot_diameter(
    lens: Lens,
    wavelength_um: float | None = None,
    field_mm: float = 0.0,
    plane_distance_mm: float = 3.0,
) -> Spot:
    """Return the spot of one object point with a uniformly filled stop.

    Parameters
    ----------
    lens
        The lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    field_mm
        Height of the object point, along y.
    plane_distance_mm
        Distance of the spot's plane from the exit vertex.

    Returns
    -------
    Spot

    Raises
    ------
    DesignError
        If no ray passes the lens.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> round(rms_spot_diameter(lens, plane_distance_mm=2.0).rms_diameter_mm, 3)
    14.269
    """
    wavelength_um = _wavelength(lens, wavelength_um)
    samples = pupil_rings(rings=16, arms=48)
    field = np.tile([0.0, field_mm], (len(samples.points), 1))
    system = compile_system(lens, wavelength_um)
    lens.sensor.cover_glass_at(plane_distance_mm)
    rays = _trace(lens, system, field, samples.points, lens.exit_vertex_z_mm + plane_distance_mm)
    weights = samples.weights * rays.ok
    passed = float(weights.sum())
    if passed == 0.0:
        raise DesignError(_no_light(f"from the field height {field_mm:g} mm", wavelength_um))
    points = rays.position[:, :2]
    centroid = weights @ points / passed
    square = weights @ np.sum((points - centroid) ** 2, axis=-1) / passed
    return Spot(2.0 * math.sqrt(square), (float(centroid[0]), float(centroid[1])), passed)


def throughput(
    lens: Lens,
    wavelength_um: float | None = None,
    field_heights_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
    rings: int = 32,
    arms: int = 96,
) -> Throughput:
    """Return the fraction of a uniformly filled stop that passes the lens, for each field height.

    Rings up to the rim are weighted by the trapezoidal rule in r^2, so that clipping at the very rim has an
    effect.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength (default: the first of the lens).
    field_heights_mm
        Object heights (default: the whole field).
    pose, surface_perturbations
        Pose of the lens and perturbations of surfaces, as single values (default: nominal).
    rings, arms
        Number of rings, and number of points on each ring.

    Raises
    ------
    InputError
        If a field height lies outside the field, or a perturbation has arrays of trials.
    """
    wavelength_um = _wavelength(lens, wavelength_um)
    system, symmetric = _one_system(lens, wavelength_um, pose, surface_perturbations)
    heights = _heights(lens, field_heights_mm)
    azimuths = np.zeros(1) if symmetric else 2.0 * np.pi * np.arange(8) / 8
    fields = (heights[:, None, None] * np.stack([np.sin(azimuths), np.cos(azimuths)], axis=-1)).reshape(-1, 2)
    angle = 2.0 * np.pi * np.arange(arms) / arms
    radius = np.sqrt(np.linspace(0.0, 1.0, rings + 1))
    weights = np.full(rings + 1, 1.0 / rings)
    weights[[0, -1]] *= 0.5
    pupil = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1)
    pupil = pupil.reshape(-1, 2)
    rays = _trace(lens, system, np.repeat(fields, len(pupil), axis=0), np.tile(pupil, (len(fields), 1)))
    ok = rays.ok.reshape(len(heights), len(azimuths), rings + 1, arms)
    fractions = np.where(ok.all(axis=(2, 3)), 1.0, ok.mean(axis=3) @ weights)
    per_field = fractions.min(axis=1)
    return Throughput(float(per_field.min()), tuple(heights.tolist()), tuple(per_field.tolist()))


def observation_distance_mm(lens: Lens) -> float:
    """Return the distance from the exit vertex at which spots and arrival angles are evaluated.

    It is the paper's 3 mm (Figs. 2c and 2d) if that lies between the sensor planes, else the first plane.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> lens.sensor.plane_distances_mm, observation_distance_mm(lens)
    ((2.0, 22.0), 3.0)
    """
    paper_mm = 3.0
    first, *_, last = (*lens.sensor.plane_distances_mm, lens.sensor.plane_distances_mm[-1])
    return paper_mm if first <= paper_mm <= last else first


def _largest(
    lens: Lens,
    planes_mm: Sequence[float | None],
    wavelength_um: float | None,
    field_heights_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
    refined: bool = True,
) -> tuple[tuple[Extremes, ...], Throughput]:
    """Return extremes over field and pupil and the throughput.

    The metrics are the distances from the axis on planes, and the angle for a plane of None. Results of
    nominal lenses are cached, because commands request them repeatedly.
    """
    wavelength_um = _wavelength(lens, wavelength_um)
    system, _ = _one_system(lens, wavelength_um, pose, surface_perturbations)
    if field_heights_mm is not None:
        field_heights_mm = tuple(_heights(lens, field_heights_mm).tolist())
    if pose == Pose() and not surface_perturbations and not any(system.figures):
        # The indices are part of the key, because a catalogue file may have changed.
        indices = tuple(system.index.flat)
        return _cached_search(lens, tuple(planes_mm), wavelength_um, field_heights_mm, refined, indices)
    return _search(lens, planes_mm, wavelength_um, field_heights_mm, pose, surface_perturbations, refined)


@lru_cache(maxsize=64)
def _cached_search(
    lens: Lens,
    planes_mm: tuple[float | None, ...],
    wavelength_um: float,
    field_heights_mm: tuple[float, ...] | None,
    refined: bool,
    _index: tuple[float, ...],
) -> tuple[tuple[Extremes, ...], Throughput]:
    return _search(lens, planes_mm, wavelength_um, field_heights_mm, Pose(), None, refined)


def _search(
    lens: Lens,
    planes_mm: Sequence[float | None],
    wavelength_um: float,
    field_heights_mm: Sequence[float] | None,
    pose: Pose,
    surface_perturbations: Perturbations,
    refined: bool,
) -> tuple[tuple[Extremes, ...], Throughput]:
    system, symmetric = _one_system(lens, wavelength_um, pose, surface_perturbations)
    plate = system.cover_glass
    metrics = [metric for z in planes_mm for metric in ([_angle] if z is None else _reaches(lens, z, plate))]
    heights, whole = _heights(lens, field_heights_mm), field_heights_mm is None
    found = find_extremes(
        lens, system, metrics, heights, symmetric=symmetric, between_heights=whole, refined=refined
    )
    if any(math.isnan(f.value) for f in found):
        raise DesignError(f"{lens.title or 'the lens'}: {_no_light('of the field', wavelength_um)}")
    points = (32, 96) if refined else (8, 24)
    return found, throughput(lens, wavelength_um, field_heights_mm, pose, surface_perturbations, *points)


def _spread(found: Extremes, passes: Throughput) -> SpreadAngle:
    return SpreadAngle(
        spread_deg=math.degrees(found.value),
        field_mm=found.field_mm,
        pupil=found.pupil,
        field_heights_mm=passes.field_heights_mm,
        per_field_deg=tuple(np.rad2deg(found.values).tolist()),
        throughput=passes.throughput,
    )


def _footprint(
    lens: Lens, plane_distance_mm: float, found: Sequence[Extremes], passes: Throughput
) -> Footprint:
    """Return the footprint from the extremes of the metrics of :func:`_reaches`."""
    widest, *sides = found
    half_side = 0.5 * min(lens.sensor.size_mm)
    margin = half_side - widest.value
    if sides:
        margin = min(0.5 * s - side.value for s, side in zip(lens.sensor.size_mm, sides, strict=True))
    return Footprint(
        plane_distance_mm=plane_distance_mm,
        radius_mm=widest.value,
        field_mm=widest.field_mm,
        pupil=widest.pupil,
        sensor_half_side_mm=half_side,
        inside=margin >= 0.0,
        margin_mm=margin,
        throughput=passes.throughput,
    )


def _angle(_position: Array, direction: Array) -> Array:
    return np.arctan2(np.hypot(direction[..., 0], direction[..., 1]), direction[..., 2])


def _reaches(lens: Lens, plane_distance_mm: float, plate: PlanePlate | None) -> list[Metric]:
    """Return metrics of the distance from the axis; without rotational symmetry, also along x and y."""
    plane_z_mm = lens.exit_vertex_z_mm + plane_distance_mm
    is_behind_plate = lens.sensor.cover_glass_at(plane_distance_mm) is not None
    rotational = all(surface.shape.ROTATIONAL for surface in lens.surfaces)
    weights = [(1.0, 1.0)] if rotational else [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]

    def reach(along: tuple[float, float], position: Array, direction: Array) -> Array:
        forward = direction[..., 2] > 0.0
        length = (plane_z_mm - position[..., 2]) / np.where(forward, direction[..., 2], 1.0)
        points = position[..., :2] + length[..., None] * direction[..., :2]
        if plate is not None and is_behind_plate:
            points = points + plate.lateral_shift_mm(np.where(forward[..., None], direction[..., :2], 0.0))
        x, y = (along[i] * points[..., i] for i in (0, 1))
        return np.where(forward, np.hypot(x, y), -np.inf)

    return [partial(reach, along) for along in weights]


def _wavelength(lens: Lens, wavelength_um: float | None) -> float:
    return lens.wavelengths_um[0] if wavelength_um is None else wavelength_um


def _heights(lens: Lens, field_heights_mm: Sequence[float] | None) -> Array:
    if field_heights_mm is None:
        return np.linspace(0.0, lens.half_field_mm, 13)
    heights = np.atleast_1d(np.asarray(field_heights_mm, float))
    inside = (heights >= 0.0) & (heights <= lens.half_field_mm * (1.0 + 1e-12))
    if heights.ndim != 1 or not len(heights) or not np.all(inside):
        raise InputError(
            f"field_heights_mm = {field_heights_mm!r}: must be from 0 to {lens.half_field_mm:g} mm"
        )
    return heights


def _one_system(
    lens: Lens, wavelength_um: float, pose: Pose, surface_perturbations: Perturbations
) -> tuple[CompiledSystem, bool]:
    """Return the compiled lens, and whether it is rotationally symmetric."""
    system = compile_system(lens, wavelength_um, pose, surface_perturbations)
    if system.trials is not None:
        raise InputError("poses and perturbations must be single values here, not arrays of trials")
    return system, system.rotational


def _trace(
    lens: Lens, system: CompiledSystem, fields: Array, pupil: Array, plane_z_mm: float | None = None
) -> RayTrace:
    origins, directions = launch_pairs(
        system, fields, pupil, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    return trace_compiled(system, origins, directions, plane_z_mm)


def _no_light(which: str, wavelength_um: float) -> str:
    hint = "check for a semi_diameter_mm that is too small and for total reflection (material, radius_mm)"
    return f"no ray {which} passes at {wavelength_um:g} µm; {hint}"
