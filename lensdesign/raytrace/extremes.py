"""The worst rays of a lens: the largest values of ray metrics over field and pupil, refined until they stand.

A dense sampling finds where the largest values lie; a direct search then follows each of them. It polls
random directions (every direction comes up in the end, as in mesh-adaptive direct search: Audet and Dennis,
SIAM J. Optim. 17, 188, 2006), so that it also creeps along the edge of a vignetted pupil, and shortens its
step whenever no direction is better. Maxima inside the pupil or the field are found as well as on the rim.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import launch_pairs
from lensdesign.raytrace.compiled import CompiledSystem
from lensdesign.raytrace.rays import trace_compiled

Metric = Callable[[Array, Array], Array]
"""Value of each ray from where it leaves the last surface, and its direction; of shape (..., 3) each."""
Evaluate = Callable[[Array, NDArray[np.int_]], Array]

FIELD, PUPIL = slice(0, 2), slice(2, 4)
FINEST_STEP = 1e-8
MOST_STEPS = 200
POLLED = 24
"""Directions that are polled at a step, half of them the opposites of the others."""

PUPIL_STEP, AZIMUTHS = 1.0 / 16, 16
"""Of the dense sampling."""


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
    metrics: Sequence[Metric],
    heights_mm: Array,
    *,
    symmetric: bool = True,
    between_heights: bool = True,
    refined: bool = True,
) -> tuple[Extremes, ...]:
    """Find the largest value of each metric over field and pupil.

    All are sought at once: small bundles cost a call of the tracer each, however few their rays.

    Parameters
    ----------
    lens, system
        The nominal lens and what was compiled from it (one trial).
    metrics
        What is sought; values of failed rays do not count.
    heights_mm
        Field heights of the table.
    symmetric
        Whether the system is rotationally symmetric: fields then lie along y, half of the pupil does.
    between_heights
        Whether the largest value is sought between the heights of the table, too.
    refined
        Whether what the dense sampling finds is followed to where it is largest.

    Returns
    -------
    tuple of Extremes, one for each metric
    """

    def ends(coordinates: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Where rays of these coordinates end, where they head, and which arrive."""
        flat, shape = coordinates.reshape(-1, 4), coordinates.shape[:-1]
        origins, directions = launch_pairs(
            system,
            flat[:, FIELD],
            flat[:, PUPIL],
            lens.object_z_mm,
            lens.stop_index,
            lens.stop_semi_diameter_mm,
        )
        rays = trace_compiled(system, origins, directions)
        return rays.position.reshape(*shape, 3), rays.direction.reshape(*shape, 3), rays.ok.reshape(shape)

    def every(coordinates: Array) -> Array:
        """Values of all metrics, shape (metrics, ...), at coordinates of shape (..., 4)."""
        position, direction, ok = ends(coordinates)
        return np.where(ok, [metric(position, direction) for metric in metrics], -np.inf)

    def own(coordinates: Array, sought: NDArray[np.int_]) -> Array:
        """Values at coordinates of shape (starts, ..., 4) of the metric that each start, in order, seeks."""
        position, direction, ok = ends(coordinates)
        values = np.empty(ok.shape)
        for metric, (i, j) in zip(metrics, pairwise(np.searchsorted(sought, range(count + 1))), strict=True):
            values[i:j] = metric(position[i:j], direction[i:j])
        return np.where(ok, values, -np.inf)

    count = len(metrics)
    starts = _starts(every, heights_mm, symmetric)
    per_height = len(starts) // count // len(heights_mm)
    sought = np.repeat(np.arange(count), len(starts) // count)
    heights = np.tile(np.repeat(heights_mm, per_height), count)
    if not refined:
        values = own(starts, sought)
        tables = values.reshape(count, len(heights_mm), per_height).max(axis=2)
        return tuple(
            _extremes(table, starts[sought == m], values[sought == m]) for m, table in enumerate(tables)
        )
    around = 0.0 if symmetric else 2.0 * np.pi / AZIMUTHS * lens.half_field_mm
    pupil_steps = [PUPIL_STEP, PUPIL_STEP]
    steps = np.array([around, around, *pupil_steps])
    best, values = _climb(own, starts, sought, steps, heights, heights)
    tables = values.reshape(count, len(heights_mm), per_height).max(axis=2)
    if between_heights:
        spacing = np.ptp(heights_mm) / max(1, len(heights_mm) - 1)
        steps = np.array([around, max(around, spacing), *pupil_steps])
        top = np.full_like(heights, lens.half_field_mm)
        best, values = _climb(own, best, sought, steps, np.zeros_like(heights), top)
    return tuple(_extremes(table, best[sought == m], values[sought == m]) for m, table in enumerate(tables))


def _extremes(table: Array, best: Array, values: Array) -> Extremes:
    """What was found for one metric."""
    worst = int(np.argmax(values))
    fx, fy, px, py = (float(v) for v in best[worst])
    return Extremes(
        values=np.where(np.isfinite(table), table, np.nan),
        value=float(values[worst]) if np.isfinite(values[worst]) else np.nan,
        field_mm=(fx, fy),
        pupil=(px, py),
    )


def _starts(evaluate: Callable[[Array], Array], heights_mm: Array, symmetric: bool) -> Array:
    """For each metric and height the best sample on the rim of the stop and the best inside."""
    azimuths = np.zeros(1) if symmetric else 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    radii = np.linspace(0.0, 1.0, round(1.0 / PUPIL_STEP) + 1)
    angles = np.linspace(0.0, np.pi, 25) if symmetric else 2.0 * np.pi * np.arange(48) / 48
    height, azimuth, radius, angle = np.meshgrid(heights_mm, azimuths, radii, angles, indexing="ij")
    coordinates = np.stack(
        [height * np.sin(azimuth), height * np.cos(azimuth), radius * np.sin(angle), radius * np.cos(angle)],
        axis=-1,
    )
    parts = [slice(-1, None), slice(0, -1)]
    values = evaluate(coordinates)
    starts = [
        coordinates[i, :, part].reshape(-1, 4)[np.argmax(values[m, i, :, part])]
        for m in range(len(values))
        for i in range(len(heights_mm))
        for part in parts
    ]
    return np.array(starts)


def _project(coordinates: Array, low_mm: Array, high_mm: Array) -> None:
    """Put stop points back into the stop, and object points back between their least and largest heights.

    Coordinates of shape (starts, polled, 4), overwritten.
    """
    fx, fy, px, py = np.moveaxis(coordinates, -1, 0)
    field = np.hypot(fx, fy)
    allowed = np.clip(field, low_mm[:, None], high_mm[:, None])
    scale = np.where(field > 0.0, allowed / np.maximum(field, 1e-300), 1.0)
    share = np.maximum(1.0, np.hypot(px, py))
    fx *= scale
    fy *= scale
    px /= share
    py /= share


def _climb(
    evaluate: Evaluate, starts: Array, sought: NDArray[np.int_], steps: Array, low_mm: Array, high_mm: Array
) -> tuple[Array, Array]:
    """Direct search for the largest value from every start (starts, 4) at once, until its steps are fine.

    Each start seeks the metric `sought`; its field height stays between `low_mm` and `high_mm`.
    """
    rng = np.random.default_rng(0)
    best, values = starts.copy(), evaluate(starts, sought)
    size = np.full(len(starts), 0.5)
    for _ in range(MOST_STEPS):
        moving = np.flatnonzero(size >= FINEST_STEP)
        if not len(moving):
            break
        direction = rng.normal(size=(POLLED // 2, 4)) * (steps > 0.0)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        polled = np.concatenate([direction, -direction]) * steps
        trial = best[moving, None, :] + size[moving, None, None] * polled
        _project(trial, low_mm[moving], high_mm[moving])
        found = evaluate(trial, sought[moving])
        choice = np.arange(len(moving)), np.argmax(found, axis=1)
        better = found[choice] > values[moving]
        rows = moving[better]
        best[rows], values[rows] = trial[choice][better], found[choice][better]
        size[moving] *= np.where(better, 1.5, 0.7)
        size = np.minimum(size, 1.0)
    return best, values
