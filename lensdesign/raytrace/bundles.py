"""Ray bundles: from field points through the aperture stop.

Bundles are launched at the stop surface itself: a ray is named by its field point and by the point on
the stop through which it goes. No entrance pupil stands in between, so a perturbed lens is filled as
its own stop demands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled


@dataclass(frozen=True)
class PupilSamples:
    """Points on the stop, as shares of its semi-diameter, with quadrature weights.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        x and y within the unit disc.
    weights : ndarray, shape (n,)
        Sum to 1; means over an evenly filled stop are ``sum(weights * values)``.
    """

    points: Array
    weights: Array


def pupil_rings(rings: int = 6, arms: int = 24, edge: bool = False) -> PupilSamples:
    """Rings for exact means over the evenly filled stop (Gauss-Legendre in r^2, Forbes 1988).

    Parameters
    ----------
    rings, arms
        Number of rings, and of points on each.
    edge
        Add a last ring on the rim, of weight 0, for largest and smallest values.
    """
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    radii = np.sqrt(0.5 * (nodes + 1.0))
    weights = 0.5 * weights
    if edge:
        radii, weights = np.append(radii, 1.0), np.append(weights, 0.0)
    angle = 2.0 * np.pi * np.arange(arms) / arms
    points = np.stack([np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle))], axis=-1)
    return PupilSamples(points.reshape(-1, 2), np.repeat(weights / arms, arms))


def pupil_fan(rays: int) -> PupilSamples:
    """A meridional fan along y, rim to rim."""
    y = np.linspace(-1.0, 1.0, rays)
    return PupilSamples(np.stack([np.zeros(rays), y], axis=-1), np.full(rays, 1.0 / rays))


def pupil_hexapolar(rings: int = 6) -> PupilSamples:
    """The centre and rings of 6, 12, 18, ... points: an even filling, as spot diagrams use."""
    points = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angle = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        points.append(ring / rings * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    stacked = np.concatenate(points)
    return PupilSamples(stacked, np.full(len(stacked), 1.0 / len(stacked)))


def launch(
    lens: Lens,
    field_points_mm: ArrayLike,
    pupil_points: ArrayLike,
    wavelength_um: float,
    pose: Pose = Pose(),
    surface_perturbations: Mapping[int, SurfacePerturbation] | None = None,
) -> tuple[Array, Array]:
    """Rays from object points through points of the stop.

    Parameters
    ----------
    lens
        The nominal lens.
    field_points_mm
        Object points, shape (fields, 2): x and y on the object plane.
    pupil_points
        Points on the stop as shares of its semi-diameter, shape (points, 2).
    wavelength_um, pose, surface_perturbations
        As in :func:`lensdesign.raytrace.rays.trace`; the stop moves with its surface.

    Returns
    -------
    origins, directions : ndarray, shape (fields * points, 3) or (trials, fields * points, 3)
        Field by field. A ray that cannot reach its stop point is aimed as closely as it goes.
    """
    system = compile_system(lens, wavelength_um, pose, surface_perturbations)
    return launch_compiled(
        system, field_points_mm, pupil_points, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )


def launch_compiled(
    system: CompiledSystem,
    field_points_mm: ArrayLike,
    pupil_points: ArrayLike,
    object_z_mm: float,
    stop_index: int,
    stop_semi_diameter_mm: float,
) -> tuple[Array, Array]:
    """As :func:`launch`, for a system that was compiled before."""
    fields, pupil = _points(field_points_mm, "field_points_mm"), _points(pupil_points, "pupil_points")
    return launch_pairs(
        system,
        np.repeat(fields, len(pupil), axis=0),
        np.tile(pupil, (len(fields), 1)),
        object_z_mm,
        stop_index,
        stop_semi_diameter_mm,
    )


def launch_pairs(
    system: CompiledSystem,
    field_points_mm: Array,
    pupil_points: Array,
    object_z_mm: float,
    stop_index: int,
    stop_semi_diameter_mm: float,
) -> tuple[Array, Array]:
    """As :func:`launch_compiled`, one ray from each field point through the stop point beside it."""
    origins = np.empty((len(field_points_mm), 3))
    origins[:, :2] = field_points_mm
    origins[:, 2] = object_z_mm
    xy = stop_semi_diameter_mm * pupil_points
    targets = _stop_points(system, stop_index, xy)
    directions = targets - origins
    dx, dy, dz = np.moveaxis(directions, -1, 0)  # a sum over an axis of three takes four times as long
    directions /= np.sqrt(dx * dx + dy * dy + dz * dz)[..., None]
    if stop_index > 0:
        directions = _aim(system, stop_index, origins, directions, xy)
    return origins, directions if system.trials is not None else directions[0]


def _points(values: ArrayLike, name: str) -> Array:
    array = np.atleast_2d(np.asarray(values, float))
    if array.ndim != 2 or array.shape[1] != 2 or not np.all(np.isfinite(array)):
        raise InputError(f"{name} has shape {array.shape}: must be finite and of shape (n, 2)")
    return array


def _stop_points(system: CompiledSystem, stop: int, xy: Array) -> Array:
    """Points of the stop surface in the fixed frame, shape (trials or 1, n, 3)."""
    sag = np.atleast_2d(system.shapes[stop].sag(xy[:, 0], xy[:, 1]))
    for figure in system.figures[stop]:
        sag = sag + figure.sag(xy[:, 0], xy[:, 1])
    local = np.empty((*sag.shape, 3))
    local[..., :2] = xy
    local[..., 2] = sag
    if system.tilted[stop]:
        local = local @ np.swapaxes(system.rotation[:, stop], -1, -2)
    return local + system.vertex[:, None, stop]


def _aim(system: CompiledSystem, stop: int, origins: Array, directions: Array, xy: Array) -> Array:
    """Turn rays by Newton's method until they go through given points of an inner stop."""
    part = slice(0, stop + 1)
    front = replace(
        system,
        rotation=np.ascontiguousarray(system.rotation[:, part]),
        vertex=np.ascontiguousarray(system.vertex[:, part]),
        shapes=system.shapes[part],
        index=np.ascontiguousarray(system.index[:, : stop + 2]),
        semi_diameter=system.semi_diameter[part],
        tilted=system.tilted[part],
        figures=system.figures[part],
    )
    trials = 1 if system.trials is None else system.trials
    cosines = np.array(np.broadcast_to(directions, (trials, *directions.shape[1:]))[..., :2])

    def miss(cosines: Array) -> tuple[Array, NDArray[np.bool_]]:
        rays = trace_compiled(front, origins, _unit(cosines), clip=False)
        position = rays.position.reshape(trials, -1, 3)
        local = (position - system.vertex[:, None, stop]) @ system.rotation[:, stop]
        return local[..., :2] - xy, rays.ok.reshape(trials, -1)

    step = 1e-6
    error, ok = miss(cosines)
    for _ in range(12):
        if not np.any(ok & (np.linalg.norm(error, axis=-1) > 1e-11)):
            break
        columns = [(miss(cosines + step * axis)[0] - error) / step for axis in np.eye(2)]
        jacobian = np.stack(columns, axis=-1)
        usable = ok & (np.abs(np.linalg.det(jacobian)) > 1e-9)
        jacobian[~usable] = np.eye(2)
        change = np.linalg.solve(jacobian, error[..., None])[..., 0] * usable[..., None]
        trial = np.clip(cosines - change, -0.99, 0.99)
        trial_error, trial_ok = miss(trial)
        better = usable & trial_ok & (np.linalg.norm(trial_error, axis=-1) < np.linalg.norm(error, axis=-1))
        if not np.any(better):
            break
        cosines[better], error[better] = trial[better], trial_error[better]
    return _unit(cosines)


def _unit(cosines: Array) -> Array:
    square = np.sum(cosines * cosines, axis=-1, keepdims=True)
    scale = np.where(square < 0.999, 1.0, np.sqrt(0.999 / np.maximum(square, 1e-300)))
    cosines = cosines * scale
    rest = np.sqrt(1.0 - np.sum(cosines * cosines, axis=-1, keepdims=True))
    return np.ascontiguousarray(np.concatenate([cosines, rest], axis=-1))
