"""The plain NumPy ray trace: slow, readable, the oracle for the kernel.

It also takes complex rays and systems, so that derivatives can be had by complex step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.lens.shapes.intersection import RIM_TOLERANCE, intersect, sag_and_slopes
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.status import Status

Array = NDArray[Any]


def trace_numpy(
    system: CompiledSystem, origins: Array, directions: Array, plane_z_mm: float | None, clip: bool = True
) -> tuple[Array, Array, Array, NDArray[np.int8], NDArray[np.int16], Array]:
    """Trace rays through one lens (the first trial of `system`).

    Parameters
    ----------
    system
        The compiled lens.
    origins, directions
        Shape (n, 3), in the fixed frame.
    plane_z_mm
        Plane z = constant on which rays end; None stops them at the last surface.
    clip
        Whether clear semi-diameters stop rays.

    Returns
    -------
    position, direction, opl, status, failed_surface, hits
        As in :class:`lensdesign.raytrace.rays.RayTrace`.
    """
    position, direction = np.array(origins), np.array(directions)
    opl = np.zeros(len(position), position.dtype)
    status = np.zeros(len(position), np.int8)
    failed = np.full(len(position), -1, np.int16)
    hits = np.zeros((len(position), system.surfaces, 3), position.dtype)
    for i in range(system.surfaces):
        _refract_at(system, i, position, direction, opl, status, failed, clip)
        hits[:, i] = position
    if plane_z_mm is not None:
        alive = status == Status.OK
        forward = alive & (np.real(direction[:, 2]) > 0.0)
        _fail(status, failed, alive & ~forward, Status.MISSED, system.surfaces)
        distance = (plane_z_mm - position[forward, 2]) / direction[forward, 2]
        position[forward] += distance[:, None] * direction[forward]
        opl[forward] += system.index[0, -1] * distance
    return position, direction, opl, status, failed, hits


def _refract_at(
    system: CompiledSystem,
    i: int,
    position: Array,
    direction: Array,
    opl: Array,
    status: NDArray[np.int8],
    failed: NDArray[np.int16],
    clip: bool,
) -> None:
    rotation, vertex = system.rotation[0, i], system.vertex[0, i]
    shape = system.shapes[i].trial(0)
    sag_error = system.sag_error(i)
    alive = status == Status.OK
    local, ray = (position - vertex) @ rotation, direction @ rotation
    distance, hit, converged = intersect(local, ray, shape, sag_error)
    _fail(status, failed, alive & ~hit, Status.MISSED, i)
    _fail(status, failed, alive & hit & ~converged, Status.NOT_CONVERGED, i)
    reached = alive & hit & converged
    point = local + distance[:, None] * ray
    position[reached] = (point @ rotation.T + vertex)[reached]
    opl[reached] += system.index[0, i] * distance[reached]
    r2 = np.real(point[:, 0] ** 2 + point[:, 1] ** 2)
    inside = r2 <= (system.semi_diameter[i] * (1.0 + RIM_TOLERANCE)) ** 2 if clip else np.ones_like(reached)
    _fail(status, failed, reached & ~inside, Status.CLIPPED, i)
    reached &= inside

    _, by_x, by_y = sag_and_slopes(shape, point[:, 0], point[:, 1], sag_error)
    upward = np.stack([-by_x, -by_y, np.ones_like(by_x)], axis=-1)
    normal = upward / np.sqrt(np.sum(upward * upward, axis=-1, keepdims=True))
    ratio = system.index[0, i] / system.index[0, i + 1]
    cos_in = np.sum(normal * ray, axis=-1)
    square = 1.0 - ratio**2 * (1.0 - cos_in**2)
    total = np.real(square) < 0.0
    _fail(status, failed, reached & total, Status.TOTAL_REFLECTION, i)
    reached &= ~total
    cos_out = np.sqrt(np.where(total, 1.0, square))
    refracted = ratio * ray + (cos_out - ratio * cos_in)[:, None] * normal
    direction[reached] = (refracted @ rotation.T)[reached]


def _fail(
    status: NDArray[np.int8], failed: NDArray[np.int16], where: NDArray[np.bool_], why: Status, i: int
) -> None:
    status[where] = why
    failed[where] = i
