"""Search for rays that are worse than those of the working set (exchange method)."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.exit_beam import spread_angle_and_footprints
from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.optimization.operands.operand import Operand
from lensdesign.optimization.operands.requirements import goal_operands, ray_constraint_operands
from lensdesign.optimization.problem import DesignProblem, Rays, finished_lens
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS, GHOST_GOAL

EXCESS = 3e-5
"""Smallest scaled excess over the working set for which a ray is added."""


def worse_rays(problem: DesignProblem, point: Array, rays: Rays, dense: Rays) -> Rays | None:
    """Return the rays that exceed every ray of the working set, one for each operand and sector of the stop.

    There may be several maxima (a skew ray on the rim, a meridional ray inside). Each sector is therefore
    searched, with its rim and its inside separately. Otherwise the sampling error at a sharp maximum could
    hide it behind a flat one.

    Parameters
    ----------
    problem, point
        The problem, and a point of its unit box.
    rays, dense
        The working set, and the dense set in which worse rays are searched.

    Returns
    -------
    Rays or None
        None if no ray is worse.
    """
    angle = np.degrees(np.arctan2(dense.pupil[:, 1], dense.pupil[:, 0]))
    # Width of the sectors of the stop, in each of which the worst ray is refined.
    sector_deg = 30.0
    # 90 degrees belongs to the sector below, since the halves of the stop are mirror images.
    sector = np.where(angle == 90.0, 90.0 - sector_deg, angle) // sector_deg
    sector += 100.0 * (np.linalg.norm(dense.pupil, axis=-1) > 1.0 - 1e-9)
    own, every = _operands(problem, point, rays), _operands(problem, point, dense)
    found: list[tuple[int, int, float]] = []
    for number, wide in enumerate(every):
        if wide.rays is None or not len(wide.values):
            continue
        top = np.max(wide.values)
        if top <= -0.02 and not wide.name.startswith("spread"):
            continue
        for which in np.unique(sector):
            inside = np.flatnonzero(sector[wide.rays] == which)
            if len(inside) and np.max(wide.values[inside]) >= top - 0.02:
                worst = inside[np.argmax(wide.values[inside])]
                found.append((number, int(wide.rays[worst]), float(wide.values[worst])))
    if not found:
        return None
    numbers, indices, values = (np.array(column) for column in zip(*found, strict=True))
    refined, values = _refined(problem, point, numbers, dense.select(indices), values)
    needed = np.array([np.max(own[number].values) for number in numbers]) + EXCESS
    worse = refined.select(np.flatnonzero(values > needed))
    return worse.with_rays(worse) if len(worse.pupil) else None


def hidden_rays(problem: DesignProblem, point: Array, rays: Rays) -> Rays | None:
    """Return the extreme rays that the check of the finished lens finds, if they exceed the working set.

    A lens without rotational symmetry has many maxima over azimuth. A dense set may miss the largest one.

    Parameters
    ----------
    problem, point
        The problem, and a point of its unit box.
    rays
        The working set.

    Returns
    -------
    Rays or None
        None if no ray is worse, or the lens cannot be made.
    """
    planes_mm = problem.specification.sensor.plane_distances_mm
    fields, pupil = [], []
    try:
        lens = finished_lens(problem, point, rays)
        for wavelength_um in lens.wavelengths_um:
            spread, footprints, _ = spread_angle_and_footprints(lens, wavelength_um, planes_mm)
            rays_of = [(spread.field_mm, spread.pupil), *((one.field_mm, one.pupil) for one in footprints)]
            fields += [field for field, _ in rays_of]
            pupil += [place for _, place in rays_of]
    except DesignError:
        return None
    factor = problem.base.object.field_diameter_mm / lens.object.field_diameter_mm
    extreme = Rays(factor * np.array(fields), np.array(pupil))
    own, others = _operands(problem, point, rays), _operands(problem, point, extreme)
    worse = [
        other.rays[other.values > np.max(one.values) + EXCESS]
        for one, other in zip(own, others, strict=True)
        if one.rays is not None and other.rays is not None and len(one.values)
    ]
    added = np.unique(np.concatenate([np.empty(0, np.int64), *worse]))
    return extreme.select(added) if len(added) else None


def _refined(
    problem: DesignProblem, point: Array, numbers: NDArray[np.int64], rays: Rays, values: Array
) -> tuple[Rays, Array]:
    """Return the worst rays near given ones and their values, by shrinking grids over field and stop."""
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
        near = Rays(_rotated(field, along, math.pi * step * steps[:, 1]), pupil)
        rows, best = _operands(problem, point, near), np.arange(len(numbers)) * len(steps) + len(steps) // 2
        for search, number in enumerate(numbers):
            row = rows[number]
            assert row.rays is not None  # only operands of rays are searched
            near_it = np.flatnonzero(row.rays // len(steps) == search)
            if len(near_it) and np.max(row.values[near_it]) >= values[search]:
                worst = near_it[np.argmax(row.values[near_it])]
                best[search], values[search] = row.rays[worst], row.values[worst]
        rays = near.select(best)
    return rays, values


def _rotated(height: Array, along: Array, angle_rad: Array) -> Array:
    """Return points at heights along directions, shape (n, 2), rotated by each of some angles."""
    angle = np.broadcast_to(angle_rad, height.shape)
    x = np.cos(angle) * along[:, :1] - np.sin(angle) * along[:, 1:]
    y = np.sin(angle) * along[:, :1] + np.cos(angle) * along[:, 1:]
    return np.column_stack([(height * x).ravel(), (height * y).ravel()])


def _operands(problem: DesignProblem, point: Array, rays: Rays) -> list[Operand]:
    """Return goals that may be those of rays, and constraints on rays, without derivatives."""
    specification, state = problem.specification, problem.state(point, rays, derivatives=False)
    is_of_lens = specification.optimize.goal in (*AS_BUILT_GOALS, GHOST_GOAL)
    goals = [] if is_of_lens else goal_operands(specification, state)
    return [*goals, *ray_constraint_operands(specification, state)]
