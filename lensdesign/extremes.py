"""The worst ray of a lens: the largest value of a ray metric over field and pupil, refined until it stands.

A dense sampling finds where the largest values lie; a pattern search (every neighbour on a grid that halves
whenever its centre is best) then follows each of them. Maxima inside the pupil or the field are found as
well as those on the rim.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lensdesign.bundles import launch_pairs
from lensdesign.compiled import CompiledSystem
from lensdesign.system import Lens
from lensdesign.trace import RayTrace, trace_compiled

Array = NDArray[np.float64]
Metric = Callable[[RayTrace], Array]

HEIGHT, AZIMUTH, PUPIL_RADIUS, PUPIL_ANGLE = range(4)
FINEST_STEP = 1e-9
MOST_STEPS = 200


@dataclass(frozen=True)
class Extremes:
    """Largest values of a metric, for each field height of a table and for the whole field.

    Attributes
    ----------
    values : ndarray, shape (heights,)
        Largest value over the pupil for each field height; NaN where no ray passes.
    value : float
        Largest of all; NaN if no ray passes.
    field_mm, pupil : tuple of float
        Object point and stop point (shares of its semi-diameter) of the ray that has it.
    """

    values: Array
    value: float
    field_mm: tuple[float, float]
    pupil: tuple[float, float]


def extremes(
    lens: Lens,
    system: CompiledSystem,
    metric: Metric,
    heights_mm: Array,
    plane_z_mm: float | None = None,
    *,
    symmetric: bool = True,
    between_heights: bool = True,
) -> Extremes:
    """Find the largest value of a metric over field and pupil.

    Parameters
    ----------
    lens, system
        The nominal lens and what was compiled from it (one trial).
    metric
        Value of each ray from its trace; values of failed rays do not count.
    heights_mm
        Field heights of the table.
    plane_z_mm
        Plane on which rays end; None ends them on the last surface.
    symmetric
        Whether the system is rotationally symmetric: fields then lie along y, half of the pupil does.
    between_heights
        Whether the largest value is sought between the heights of the table, too.
    """

    def evaluate(coordinates: Array) -> Array:
        field, pupil = _points(coordinates)
        stop = lens.stop_index, lens.stop_semi_diameter_mm
        rays = trace_compiled(
            system, *launch_pairs(system, field, pupil, lens.object_z_mm, *stop), plane_z_mm
        )
        return np.where(rays.ok, metric(rays), -np.inf)

    starts, steps = _starts(evaluate, heights_mm, symmetric)
    free = [PUPIL_RADIUS, PUPIL_ANGLE] if symmetric else [AZIMUTH, PUPIL_RADIUS, PUPIL_ANGLE]
    best, values = _climb(evaluate, starts, steps, free, lens.half_field_mm)
    table = values.reshape(len(heights_mm), -1).max(axis=1)
    if between_heights:
        best, values = _climb(evaluate, best, steps, [HEIGHT, *free], lens.half_field_mm)
    worst = int(np.argmax(values))
    field, pupil = _points(best[worst : worst + 1])
    return Extremes(
        values=np.where(np.isfinite(table), table, np.nan),
        value=float(values[worst]) if np.isfinite(values[worst]) else np.nan,
        field_mm=(float(field[0, 0]), float(field[0, 1])),
        pupil=(float(pupil[0, 0]), float(pupil[0, 1])),
    )


def _points(coordinates: Array) -> tuple[Array, Array]:
    """Object points and stop points; both angles are measured from +y towards +x."""
    height, azimuth, radius, angle = coordinates.T
    return (
        np.stack([height * np.sin(azimuth), height * np.cos(azimuth)], axis=-1),
        np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=-1),
    )


def _starts(evaluate: Callable[[Array], Array], heights_mm: Array, symmetric: bool) -> tuple[Array, Array]:
    """For each height the best ray on the rim of the stop and the best inside, and the sampling's steps."""
    azimuths = np.zeros(1) if symmetric else 2.0 * np.pi * np.arange(16) / 16
    radii = np.linspace(0.0, 1.0, 17)
    angles = np.linspace(0.0, np.pi, 25) if symmetric else 2.0 * np.pi * np.arange(48) / 48
    axes = np.meshgrid(heights_mm, azimuths, radii, angles, indexing="ij")
    coordinates = np.stack(axes, axis=-1)
    values = evaluate(coordinates.reshape(-1, 4)).reshape(coordinates.shape[:-1])
    starts = []
    for i, part in product(range(len(heights_mm)), (slice(16, 17), slice(0, 16))):
        where = np.unravel_index(np.argmax(values[i, :, part]), values[i, :, part].shape)
        starts.append(coordinates[i, :, part][where])
    height_step = np.ptp(heights_mm) / max(1, len(heights_mm) - 1)
    steps = np.array([height_step, 2.0 * np.pi / 16, 1.0 / 16, np.pi / 24])
    return np.array(starts), steps


def _climb(
    evaluate: Callable[[Array], Array], starts: Array, steps: Array, free: list[int], half_field_mm: float
) -> tuple[Array, Array]:
    """Pattern search for the largest value from every start at once, along the free coordinates."""
    pattern = np.zeros((3 ** len(free), 4))
    pattern[:, free] = list(product((0.0, -1.0, 1.0), repeat=len(free)))
    best, values = starts.copy(), evaluate(starts)
    size = np.full(len(starts), 0.5)
    for _ in range(MOST_STEPS):
        active = np.flatnonzero(size > FINEST_STEP)
        if not len(active):
            break
        trial = best[active, None] + size[active, None, None] * (pattern * steps)
        trial[..., HEIGHT] = np.clip(trial[..., HEIGHT], 0.0, half_field_mm)
        trial[..., PUPIL_RADIUS] = np.clip(trial[..., PUPIL_RADIUS], 0.0, 1.0)
        found = evaluate(trial.reshape(-1, 4)).reshape(trial.shape[:-1])
        choice = np.argmax(found, axis=1)
        rows = np.arange(len(active))
        better = found[rows, choice] > values[active]
        moved = active[better]
        best[moved], values[moved] = trial[rows, choice][better], found[rows, choice][better]
        size[active[~better]] *= 0.5
    return best, values
