"""The rays by which a lens of the search is worse than its working set of rays shows (exchange method)."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.optimization.operands.operand import Row
from lensdesign.optimization.problem import DesignProblem, Rays

TOLERANCE = 3e-5
"""Rays that exceed the working set by less than this (scaled) are not worth another round."""

SECTOR_DEG = 30.0
"""Of the stop, in each of which the worst ray is refined."""


def worse_rays(problem: DesignProblem, point: Array, rays: Rays, dense: Rays) -> Rays | None:
    """Rays that exceed every ray of the working set: the worst of each kind and sector of the stop.

    Maxima compete (a skew ray on the rim, a meridional one inside), so each sector is searched, its rim
    apart from its inside: else the grid's error on a sharp maximum hides it behind a flat one.

    Parameters
    ----------
    problem, point
        The specification, and the lens at a point of its unit box.
    rays, dense
        The working set, and the dense set in which worse rays are sought.

    Returns
    -------
    Rays or None
        None where no ray is worse.
    """
    angle = np.degrees(np.arctan2(dense.pupil[:, 1], dense.pupil[:, 0]))
    # Straight up belongs to the sector before it: half of the stop is the other half's mirror image.
    sector = np.where(angle == 90.0, 90.0 - SECTOR_DEG, angle) // SECTOR_DEG
    sector += 100.0 * (np.linalg.norm(dense.pupil, axis=-1) > 1.0 - 1e-9)
    own, all_ = _rows(problem, point, rays), _rows(problem, point, dense)
    found: list[tuple[int, int, float]] = []
    for number, wide in enumerate(all_):
        if wide.rays is None or not len(wide.values):
            continue
        top = np.max(wide.values)
        if top <= -0.02 and not wide.name.startswith("spread"):
            continue
        for which in np.unique(sector):
            mine = np.flatnonzero(sector[wide.rays] == which)
            if len(mine) and np.max(wide.values[mine]) >= top - 0.02:
                worst = mine[np.argmax(wide.values[mine])]
                found.append((number, int(wide.rays[worst]), float(wide.values[worst])))
    if not found:
        return None
    numbers, indices, values = (np.array(column) for column in zip(*found, strict=True))
    refined, values = _refined(problem, point, numbers, dense.take(indices), values)
    needed = np.array([np.max(own[number].values) for number in numbers]) + TOLERANCE
    worse = refined.take(np.flatnonzero(values > needed))
    return worse.with_rays(worse) if len(worse.pupil) else None


def _refined(
    problem: DesignProblem, point: Array, numbers: NDArray[np.int64], rays: Rays, values: Array
) -> tuple[Rays, Array]:
    """The worst ray of a row in the neighbourhood of a ray, by shrinking grids over field and stop.

    Parameters
    ----------
    numbers, rays, values
        Row, ray and value there of each search, shape (n,).

    Returns
    -------
    rays, values
        The worst ray that each search found, and its value.
    """
    half, values = problem.base.half_field_mm, values.copy()
    around = (0.0,) if problem.rotational else (-1.0, 0.0, 1.0)
    five = np.linspace(-1, 1, 5)
    steps = np.array(list(itertools.product((-1.0, 0.0, 1.0), around, five, five)))
    fixed_fields = bool(problem.specification.constraints.field_spread)
    for step in 0.125 / 2.5 ** np.arange(7):  # first half of the widest gap of the dense rays, along the rim
        height = np.linalg.norm(rays.fields_mm, axis=-1, keepdims=True)
        along = np.where(height > 0.0, rays.fields_mm, [0.0, 1.0]) / np.where(height > 0.0, height, 1.0)
        field = np.clip(height + (0.0 if fixed_fields else step * half) * steps[:, 0], 0.0, half)
        pupil = (rays.pupil[:, None] + step * steps[:, 2:]).reshape(-1, 2)
        pupil /= np.maximum(1.0, np.linalg.norm(pupil, axis=-1, keepdims=True))
        near = Rays(_turned(field, along, math.pi * step * steps[:, 1]), pupil)
        rows, best = _rows(problem, point, near), np.arange(len(numbers)) * len(steps) + len(steps) // 2
        for search, number in enumerate(numbers):
            row = rows[number]
            assert row.rays is not None  # only rows of rays are searched
            mine = np.flatnonzero(row.rays // len(steps) == search)
            if len(mine) and np.max(row.values[mine]) >= values[search]:
                worst = mine[np.argmax(row.values[mine])]
                best[search], values[search] = row.rays[worst], row.values[worst]
        rays = near.take(best)
    return rays, values


def _turned(height: Array, along: Array, angle_rad: Array) -> Array:
    """Points at some heights along directions, shape (n, 2), that are turned by each of some angles."""
    turn = np.broadcast_to(angle_rad, height.shape)
    x = np.cos(turn) * along[:, :1] - np.sin(turn) * along[:, 1:]
    y = np.sin(turn) * along[:, :1] + np.cos(turn) * along[:, 1:]
    return np.column_stack([(height * x).ravel(), (height * y).ravel()])


def _rows(problem: DesignProblem, point: Array, rays: Rays) -> list[Row]:
    """All goals and constraints, without derivatives: only the worst is asked for."""
    goals, constraints = problem.rows(point, rays, derivatives=False)
    return [*goals, *constraints]
