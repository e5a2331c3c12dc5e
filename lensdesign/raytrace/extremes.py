"""Extreme rays of a lens: the largest values of ray metrics over field and pupil.

A dense sampling locates the largest values; a direct search then refines each of them. The search polls
random directions, as mesh-adaptive direct search does, so that it can also follow the edge of a vignetted
pupil. It shortens its step whenever no direction is better. Maxima inside the pupil or the field are found as
well as those on the rim.

References
----------
C. Audet and J. E. Dennis, "Mesh adaptive direct search algorithms for constrained optimization",
SIAM J. Optim. 17, 188 (2006).
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
"""Value of each ray from its position on the last surface and its direction, each of shape (..., 3)."""
Evaluate = Callable[[Array, NDArray[np.int_]], Array]

FIELD, PUPIL = slice(0, 2), slice(2, 4)

PUPIL_STEP, AZIMUTHS = 1.0 / 16, 16
"""Radial step over the pupil and number of field azimuths of the dense sampling."""


@dataclass(frozen=True)
class Extremes:
    """Largest values of a metric, for each of some field heights and for the whole field.

    Attributes
    ----------
    values : ndarray, shape (heights,)
        Largest value over the pupil for each field height; NaN where no ray passes.
    value : float
        Largest value over field and pupil; NaN if no ray passes.
    field_mm, pupil : tuple of float
        Object point, and stop point relative to the semi-diameter, of the ray with the largest value.
    """

    values: Array
    value: float
    field_mm: tuple[float, float]
    pupil: tuple[float, float]


def find_extremes(
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

    All metrics are searched together, because the cost of small bundles is that of the calls of the tracer.

    Parameters
    ----------
    lens, system
        The nominal lens and the system compiled from it (one trial).
    metrics
        Metrics to maximize; values of failed rays are ignored.
    heights_mm
        Field heights for which the largest values are reported, shape (heights,).
    symmetric
        Whether the system is rotationally symmetric. Field points along y and half of the pupil then suffice.
    between_heights
        Whether to search for the largest value between the field heights, too.
    refined
        Whether to refine the maxima of the dense sampling by the direct search.

    Returns
    -------
    tuple of Extremes
        One for each metric.
    """

    def trace_rays(coordinates: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return final positions and directions of rays with these coordinates, and which rays arrive."""
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

    def all_metrics(coordinates: Array) -> Array:
        """Return the values of all metrics, shape (metrics, ...), at coordinates of shape (..., 4)."""
        position, direction, ok = trace_rays(coordinates)
        return np.where(ok, [metric(position, direction) for metric in metrics], -np.inf)

    def own_metric(coordinates: Array, sought: NDArray[np.int_]) -> Array:
        """Return the value of each start's own metric at coordinates of shape (starts, ..., 4).

        The indices `sought` of the metrics are in increasing order.
        """
        position, direction, ok = trace_rays(coordinates)
        values = np.empty(ok.shape)
        for metric, (i, j) in zip(metrics, pairwise(np.searchsorted(sought, range(count + 1))), strict=True):
            values[i:j] = metric(position[i:j], direction[i:j])
        return np.where(ok, values, -np.inf)

    count = len(metrics)
    starts = _starts(all_metrics, heights_mm, symmetric)
    per_height = len(starts) // count // len(heights_mm)
    sought = np.repeat(np.arange(count), len(starts) // count)
    heights = np.tile(np.repeat(heights_mm, per_height), count)
    if not refined:
        values = own_metric(starts, sought)
        tables = values.reshape(count, len(heights_mm), per_height).max(axis=2)
        return tuple(
            _extremes(table, starts[sought == m], values[sought == m]) for m, table in enumerate(tables)
        )
    around = 0.0 if symmetric else 2.0 * np.pi / AZIMUTHS * lens.half_field_mm
    pupil_steps = [PUPIL_STEP, PUPIL_STEP]
    steps = np.array([around, around, *pupil_steps])
    best, values = _climb(own_metric, starts, sought, steps, heights, heights)
    tables = values.reshape(count, len(heights_mm), per_height).max(axis=2)
    if between_heights:
        spacing = np.ptp(heights_mm) / max(1, len(heights_mm) - 1)
        steps = np.array([around, max(around, spacing), *pupil_steps])
        top = np.full_like(heights, lens.half_field_mm)
        best, values = _climb(own_metric, best, sought, steps, np.zeros_like(heights), top)
    return tuple(_extremes(table, best[sought == m], values[sought == m]) for m, table in enumerate(tables))


def _extremes(table: Array, best: Array, values: Array) -> Extremes:
    """Return the extremes of one metric from the best points and values of its starts."""
    worst = int(np.argmax(values))
    fx, fy, px, py = (float(v) for v in best[worst])
    return Extremes(
        values=np.where(np.isfinite(table), table, np.nan),
        value=float(values[worst]) if np.isfinite(values[worst]) else np.nan,
        field_mm=(fx, fy),
        pupil=(px, py),
    )


def _starts(evaluate: Callable[[Array], Array], heights_mm: Array, symmetric: bool) -> Array:
    """Return, for each metric and height, the best sample on the rim of the stop and the best inside."""
    azimuths = np.zeros(1) if symmetric else 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    radii = np.linspace(0.0, 1.0, round(1.0 / PUPIL_STEP) + 1)
    angles = np.linspace(0.0, np.pi, 25) if symmetric else 2.0 * np.pi * np.arange(48) / 48
    height, azimuth, radius, angle = np.meshgrid(heights_mm, azimuths, radii, angles, indexing="ij")
    coordinates = np.stack(
        [height * np.sin(azimuth), height * np.cos(azimuth), radius * np.sin(angle), radius * np.cos(angle)],
        axis=-1,
    )
    rim, inside = slice(-1, None), slice(0, -1)
    values = evaluate(coordinates)
    starts = [
        coordinates[i, :, region].reshape(-1, 4)[np.argmax(values[m, i, :, region])]
        for m in range(len(values))
        for i in range(len(heights_mm))
        for region in (rim, inside)
    ]
    return np.array(starts)


def _project(coordinates: Array, low_mm: Array, high_mm: Array) -> None:
    """Project stop points into the stop and object heights into their range, in place."""
    fx, fy, px, py = np.moveaxis(coordinates, -1, 0)
    field = np.hypot(fx, fy)
    allowed = np.clip(field, low_mm[:, None], high_mm[:, None])
    scale = np.where(field > 0.0, allowed / np.maximum(field, 1e-300), 1.0)
    excess = np.maximum(1.0, np.hypot(px, py))
    fx *= scale
    fy *= scale
    px /= excess
    py /= excess


def _climb(
    evaluate: Evaluate, starts: Array, sought: NDArray[np.int_], steps: Array, low_mm: Array, high_mm: Array
) -> tuple[Array, Array]:
    """Search for the largest value from every start (starts, 4) at once, until the steps are small.

    Each start maximizes the metric with the index `sought`; its field height stays between `low_mm` and
    `high_mm`.
    """
    polled_count, most_steps, finest_step = 24, 200, 1e-8  # half of the polled directions oppose the others
    rng = np.random.default_rng(0)
    best, values = starts.copy(), evaluate(starts, sought)
    size = np.full(len(starts), 0.5)
    for _ in range(most_steps):
        moving = np.flatnonzero(size >= finest_step)
        if not len(moving):
            break
        direction = rng.normal(size=(polled_count // 2, 4)) * (steps > 0.0)
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
