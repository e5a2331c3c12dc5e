"""What a lens does to its rays: spread behind the lens, footprint, spot, throughput.

Failed rays are left out of every figure, and every figure states the throughput that it stands on.
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
from lensdesign.raytrace.extremes import Extremes, Metric, extremes
from lensdesign.raytrace.rays import RayTrace, trace_compiled

PAPER_DISTANCE_MM = 3.0
Perturbations = Mapping[int, SurfacePerturbation] | None

TABLE_HEIGHTS = 13
"""Field heights, evenly spaced from the axis to the edge of the field, of the tables over the field."""


@dataclass(frozen=True)
class Spread:
    """Largest angle to the axis behind the lens.

    Attributes
    ----------
    spread_deg
        Over the whole field and pupil.
    field_mm, pupil
        Object point, and point on the stop as shares of its semi-diameter, of the ray that has it.
    field_heights_mm, per_field_deg
        Table over the field: the largest angle over the pupil at each height; NaN where no ray passes.
    throughput
        Smallest throughput over the heights of the table.
    """

    spread_deg: float
    field_mm: tuple[float, float]
    pupil: tuple[float, float]
    field_heights_mm: tuple[float, ...]
    per_field_deg: tuple[float, ...]
    throughput: float


@dataclass(frozen=True)
class Footprint:
    """Where the light of the whole field lands on a plane behind the lens.

    Attributes
    ----------
    plane_distance_mm
        From the exit vertex.
    radius_mm
        Largest distance of a ray from the axis.
    field_mm, pupil
        Object point and stop point of that ray.
    sensor_half_side_mm
        Half of the sensor's shorter side; the field is round, so this is what the radius has to fit. Where a
        surface is none of revolution, light has to fit the sensor side by side.
    inside
        Whether all light lands on the sensor.
    margin_mm
        `sensor_half_side_mm` - `radius_mm`; where a surface is none of revolution, the smaller margin of both
        sides.
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
    """Spot of one object point: twice the RMS distance of its rays from their centroid."""

    rms_diameter_mm: float
    centroid_mm: tuple[float, float]
    throughput: float


@dataclass(frozen=True)
class Throughput:
    """Share of an evenly filled stop that passes the lens: smallest over the field, and per field height."""

    throughput: float
    field_heights_mm: tuple[float, ...]
    per_field: tuple[float, ...]


def largest_spread(
    lens: Lens,
    wavelength_um: float | None = None,
    field_heights_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
) -> Spread:
    """Largest angle to the axis behind the lens over field and pupil (the left side of Eq. 2).

    Sampled densely, then refined in field height, azimuth and pupil until it stands to 1e-6 deg.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength; None takes the lens's first.
    field_heights_mm
        Only these object heights; None takes the whole field.
    pose, surface_perturbations
        As in :func:`lensdesign.raytrace.rays.trace`, single values. Fields then cover every azimuth.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If a field height lies outside the field, or a perturbation holds arrays of trials.
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
    """Radius of all light on a plane behind the lens, and whether it fits on the sensor.

    Parameters are those of :func:`largest_spread`; `plane_distance_mm` is from the nominal exit vertex.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    """
    found = _largest(lens, [plane_distance_mm], wavelength_um, None, pose, surface_perturbations)
    return _footprint(lens, plane_distance_mm, *found)


def spread_and_footprints(
    lens: Lens, wavelength_um: float, plane_distances_mm: Sequence[float], refined: bool = True
) -> tuple[Spread, tuple[Footprint, ...], Throughput]:
    """As :func:`largest_spread`, :func:`footprint` on each plane and :func:`throughput`; faster at once.

    Not `refined`, values are the largest of a dense sampling, which takes a tenth of the time.
    """
    (angle, *rest), passes = _largest(lens, [None, *plane_distances_mm], wavelength_um, refined=refined)
    each = len(rest) // len(plane_distances_mm)
    footprints = tuple(
        _footprint(lens, distance, rest[i * each : (i + 1) * each], passes)
        for i, distance in enumerate(plane_distances_mm)
    )
    return _spread(angle, passes), footprints, passes


def rms_spot_diameter(
    lens: Lens,
    wavelength_um: float | None = None,
    field_mm: float = 0.0,
    plane_distance_mm: float = 3.0,
) -> Spot:
    """Twice the RMS distance of the rays of one object point from their centroid, stop filled evenly.

    Parameters
    ----------
    lens, wavelength_um
        Lens; vacuum wavelength, None takes the lens's first.
    field_mm
        Height of the object point, along y.
    plane_distance_mm
        Plane of the spot, from the exit vertex.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    """
    wavelength_um = _wavelength(lens, wavelength_um)
    samples = pupil_rings(rings=16, arms=48)
    field = np.tile([0.0, field_mm], (len(samples.points), 1))
    system = compile_system(lens, wavelength_um)
    rays = _trace(lens, system, field, samples.points, lens.exit_vertex_z_mm + plane_distance_mm)
    weights = samples.weights * rays.ok
    passed = float(weights.sum())
    if passed == 0.0:
        raise DesignError(_dark(f"from the field height {field_mm:g} mm", wavelength_um))
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
    """Share of an evenly filled stop that passes the lens, per field height and the smallest.

    Rings up to the very rim are weighted by the trapezoidal rule in r^2, so that a rim that is only just
    clipped shows. Parameters are those of :func:`largest_spread`, and how many rings of how many points.
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
    shares = np.where(ok.all(axis=(2, 3)), 1.0, ok.mean(axis=3) @ weights)
    per_field = shares.min(axis=1)
    return Throughput(float(per_field.min()), tuple(heights.tolist()), tuple(per_field.tolist()))


def observation_distance_mm(lens: Lens) -> float:
    """Distance from the exit vertex at which spots and arrival angles are looked at.

    The paper's 3 mm (Figs. 2c and 2d), where that lies between the sensor planes; else the first of these.
    """
    first, *_, last = (*lens.sensor.plane_distances_mm, lens.sensor.plane_distances_mm[-1])
    return PAPER_DISTANCE_MM if first <= PAPER_DISTANCE_MM <= last else first


def _largest(
    lens: Lens,
    planes_mm: Sequence[float | None],
    wavelength_um: float | None,
    field_heights_mm: Sequence[float] | None = None,
    pose: Pose = Pose(),
    surface_perturbations: Perturbations = None,
    refined: bool = True,
) -> tuple[tuple[Extremes, ...], Throughput]:
    """Extremes over field and pupil of the reach on planes, and for None of the angle, and the throughput.

    Those of a lens as it was designed are kept: a command asks for them again and again.
    """
    wavelength_um = _wavelength(lens, wavelength_um)
    system, _ = _one_system(lens, wavelength_um, pose, surface_perturbations)
    if field_heights_mm is not None:
        field_heights_mm = tuple(_heights(lens, field_heights_mm).tolist())
    if pose == Pose() and not surface_perturbations and not any(system.figures):
        # A catalogue's file may have changed since: the indices say so, the lens does not.
        indices = tuple(system.index.flat)
        return _of_nominal(lens, tuple(planes_mm), wavelength_um, field_heights_mm, refined, indices)
    return _searched(lens, planes_mm, wavelength_um, field_heights_mm, pose, surface_perturbations, refined)


@lru_cache(maxsize=64)
def _of_nominal(
    lens: Lens,
    planes_mm: tuple[float | None, ...],
    wavelength_um: float,
    field_heights_mm: tuple[float, ...] | None,
    refined: bool,
    _index: tuple[float, ...],
) -> tuple[tuple[Extremes, ...], Throughput]:
    return _searched(lens, planes_mm, wavelength_um, field_heights_mm, Pose(), None, refined)


def _searched(
    lens: Lens,
    planes_mm: Sequence[float | None],
    wavelength_um: float,
    field_heights_mm: Sequence[float] | None,
    pose: Pose,
    surface_perturbations: Perturbations,
    refined: bool,
) -> tuple[tuple[Extremes, ...], Throughput]:
    system, symmetric = _one_system(lens, wavelength_um, pose, surface_perturbations)
    metrics = [metric for z in planes_mm for metric in ([_angle] if z is None else _reaches(lens, z))]
    heights, whole = _heights(lens, field_heights_mm), field_heights_mm is None
    found = extremes(
        lens, system, metrics, heights, symmetric=symmetric, between_heights=whole, refined=refined
    )
    if any(math.isnan(f.value) for f in found):
        raise DesignError(f"{lens.title or 'the lens'}: {_dark('of the field', wavelength_um)}")
    points = (32, 96) if refined else (8, 24)
    return found, throughput(lens, wavelength_um, field_heights_mm, pose, surface_perturbations, *points)


def _spread(found: Extremes, passes: Throughput) -> Spread:
    return Spread(
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
    """From the extremes of the metrics of :func:`_reaches`."""
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


def _reaches(lens: Lens, plane_distance_mm: float) -> list[Metric]:
    """Distance from the axis on a plane; of a lens that is none of revolution, those along x and y, too."""
    plane_z_mm = lens.exit_vertex_z_mm + plane_distance_mm
    round_one = all(surface.shape.ROTATIONAL for surface in lens.surfaces)
    weights = [(1.0, 1.0)] if round_one else [(1.0, 1.0), (1.0, 0.0), (0.0, 1.0)]

    def reach(along: tuple[float, float], position: Array, direction: Array) -> Array:
        forward = direction[..., 2] > 0.0
        way = (plane_z_mm - position[..., 2]) / np.where(forward, direction[..., 2], 1.0)
        x, y = (along[i] * (position[..., i] + way * direction[..., i]) for i in (0, 1))
        return np.where(forward, np.hypot(x, y), -np.inf)

    return [partial(reach, along) for along in weights]


def _wavelength(lens: Lens, wavelength_um: float | None) -> float:
    return lens.wavelengths_um[0] if wavelength_um is None else wavelength_um


def _heights(lens: Lens, field_heights_mm: Sequence[float] | None) -> Array:
    if field_heights_mm is None:
        return np.linspace(0.0, lens.half_field_mm, TABLE_HEIGHTS)
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
    """The compiled lens, and whether it is still rotationally symmetric."""
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


def _dark(which: str, wavelength_um: float) -> str:
    hint = "look for a semi_diameter_mm that is too small, and for total reflection (material, radius_mm)"
    return f"no ray {which} passes at {wavelength_um:g} um; {hint}"
