"""Largest spreads and footprints of drawn lenses, with exact derivatives by design variables.

Each ray follows the perturbations to first order; which ray is the outermost is determined for each drawn
lens anew. Only rays that can be the outermost of some lens are followed for all of them, and only those that
are are differentiated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.problem import Rays
from lensdesign.tracing.bundles import pupil_rings
from tolerancing.merits.context import Sampling
from tolerancing.merits.rays import FootprintRadius, RayMerit
from tolerancing.wavefronts.arrivals import arrivals_by
from tolerancing.wavefronts.goals.design import STEP, DesignPoint, TracedRays
from tolerancing.wavefronts.motions import Motions, motions_of

DEVIATIONS = 4.0
"""Rays that are further behind the outermost one, in standard deviations of both, are never the outermost."""

LEADING, WIDER = 48, 1.5
"""Deviations of so many rays with the largest nominal loads are calculated first; those of others are taken
to be at most so much larger than the largest of these."""

FAN, HEIGHTS = 41, (0.4, 0.7, 0.85)
"""Points of a fan along each field point's own azimuth, where extreme rays mostly lie; and field heights, as
fractions of the largest, beside the axis and the rim, where a limit holds over the whole field."""


def judged_rays(merit: RayMerit, lens: Lens, sampling: Sampling) -> Rays:
    """Rays by which a search judges a limit: the merit's own rings over the stop, and fans beside them.

    Trials trace the extreme rays of the nominal lens instead, which to find takes longer than all else that a
    search does with a lens.
    """
    fields = list(merit.points(lens))
    stop = pupil_rings(sampling.rings, sampling.arms, edge=True).points
    if not merit.field_points_mm:
        rim = np.array(fields[1:])
        fields += [tuple(point) for share in HEIGHTS for point in (share * rim).tolist()]
    along = np.linspace(-1.0, 1.0, FAN)
    where, points = [], []
    for field in np.array(fields, float).reshape(-1, 2):
        height = float(np.hypot(*field))
        azimuth = field / height if height else np.array([0.0, 1.0])
        points += [stop, along[:, None] * azimuth]
        where.append(np.tile(field, (len(stop) + FAN, 1)))
    return Rays(np.concatenate(where), np.concatenate(points))


class FollowedRays:
    """Rays of a design on the first sensor plane, and how they follow perturbations to first order.

    Parameters
    ----------
    design
        Its compensators count for nothing: they adapt a model, not the lens.
    rays
        Object points and stop points.
    """

    def __init__(self, design: DesignPoint, rays: Rays) -> None:
        self.design, self.rays = design, rays
        self.traced = TracedRays(design, rays, None)
        if not np.all(self.traced.ok):
            raise DesignError("rays of a limit on rays do not all pass the lens")
        trace = self.traced.trace
        self.values = np.stack([trace.plane_points[:, 0], trace.cosines], axis=1)

    @cached_property
    def responses(self) -> Array:
        """Of positions and direction cosines to the changes, shape (n, 2, 2, d)."""
        design, paths = self.design, self.traced.still
        motions = Motions(paths, design.figures(paths))
        found = np.stack(arrivals_by(motions, design.lens.stop_index), axis=1)
        return self._perturbed(found @ motions_of(design.changes) * design.multiplier)

    def responses_by(self, variable: int) -> Array:
        """Their derivatives by a variable, of the same shape."""
        design, paths = self.design, self.traced.moved(variable)
        changes, multiplier = design.moved_changes(variable)
        motions = Motions(paths, design.moved_figures(paths, self.traced.still, variable))
        found = np.stack(arrivals_by(motions, design.lens.stop_index), axis=1)
        return self._perturbed((found @ motions_of(changes) * multiplier).imag / STEP)

    @cached_property
    def values_by(self) -> Array:
        """Derivatives of nominal positions and cosines by the variables, shape (n, 2, 2, v)."""
        trace = self.traced.trace
        return np.stack([trace.plane_points_by[:, 0], trace.cosines_by], axis=1)

    def _perturbed(self, responses: Array) -> Array:
        compensators = len(self.design.scatter.limits)
        return responses[..., : responses.shape[-1] - compensators]

    def part(self, which: NDArray[np.int64]) -> FollowedRays:
        """Some of the rays."""
        return FollowedRays(self.design, self.rays.take(which))


@dataclass(frozen=True, eq=False)
class RayLoads:
    """Loads on a limit of spreads or footprints.

    Attributes
    ----------
    merit : LargestSpread or FootprintRadius
    followed : FollowedRays
        All rays that are judged.
    amounts : ndarray, shape (t, d)
        Of the drawn lenses' changes.
    """

    merit: RayMerit
    followed: FollowedRays
    amounts: Array
    softness: float | None = None

    @property
    def sign(self) -> float:
        """1 for an upper limit."""
        return 1.0 if self.merit.at_most is not None else -1.0

    @cached_property
    def _candidates(self) -> FollowedRays:
        """Rays that can be the outermost of some lens."""
        loads, _ = self._load(self.followed.values, self._further)
        leading = np.argsort(-loads)[:LEADING]
        widest = WIDER * np.max(self._deviations(self.followed.part(leading)))
        near = self.followed.part(np.flatnonzero(loads >= np.max(loads) - 2.0 * DEVIATIONS * widest))
        loads, _ = self._load(near.values, self._further)
        reach = DEVIATIONS * self._deviations(near)
        return near.part(np.flatnonzero(loads + reach >= np.max(loads - reach)))

    def _deviations(self, rays: FollowedRays) -> Array:
        """Standard deviations of the rays' loads."""
        _, slopes = self._load(rays.values, self._further)
        responses = np.einsum("nac,nacd->nd", slopes, rays.responses)
        moments = self.amounts.T @ self.amounts / len(self.amounts)
        return np.sqrt(np.maximum(np.sum((responses @ moments) * responses, axis=1), 0.0))

    @cached_property
    def _outermost(self) -> tuple[Array, NDArray[np.intp], Array]:
        """Loads of the lenses, the ray that gives each, and slopes by that ray's values, shape (t, 2, 2)."""
        rays = self._candidates
        n = len(rays.values)
        moved = self.amounts @ rays.responses.reshape(4 * n, -1).T
        values = rays.values + moved.reshape(-1, n, 2, 2)
        loads, slopes = self._load(values, self._further)
        worst = np.argmax(loads, axis=1)
        lenses = np.arange(len(worst))
        return loads[lenses, worst], worst, slopes[lenses, worst]

    @property
    def loads(self) -> Array:
        """Square of the largest sine or footprint over that of the limit, shape (t,)."""
        return self._outermost[0]

    def weighted(self, weights: Array) -> Array:
        """Derivatives of the sum of the loads with these weights, shape (v,)."""
        _, worst, slopes = self._outermost
        used, place = np.unique(worst, return_inverse=True)
        rays, pull = self._candidates.part(used), weights[:, None, None] * slopes
        nominal, moved = np.zeros((len(used), 2, 2)), np.zeros((len(used), 2, 2, self.amounts.shape[1]))
        for number in range(len(used)):
            own = place.ravel() == number
            nominal[number] = np.sum(pull[own], axis=0)
            moved[number] = np.einsum("tac,td->acd", pull[own], self.amounts[own])
        by: Array = np.einsum("nac,nacv->v", nominal, rays.values_by)
        by = by + [float(np.sum(moved * rays.responses_by(v))) for v in range(len(by))]
        if self._follows_the_sensor:
            by += self._by_planes(weights)
        return np.asarray(by)

    @property
    def _further(self) -> float:
        """From the first sensor plane to that of the limit, in mm."""
        planes = self.followed.design.lens.sensor.plane_distances_mm
        own = self.merit.plane_distance_mm if isinstance(self.merit, FootprintRadius) else None
        return (own or planes[-1]) - planes[0]

    @property
    def _follows_the_sensor(self) -> bool:
        return isinstance(self.merit, FootprintRadius) and self.followed.design.problem.heat is not None

    def _by_planes(self, weights: Array) -> Array:
        """By the distance between the planes, which heat changes with the lens."""
        design = self.followed.design
        step = 1e-3
        ends = [self._at_distance(self._further + sign * step) for sign in (1.0, -1.0)]
        by = float(weights @ (ends[0] - ends[1])) / (2.0 * step)
        planes = [design.problem.planes_by(design.point, v) for v in range(len(design.variables))]
        own = isinstance(self.merit, FootprintRadius) and self.merit.plane_distance_mm is not None
        return by * np.array([(0.0 if own else p[-1]) - p[0] for p in planes])

    def _at_distance(self, further: float) -> Array:
        """Loads with the outermost rays as they are and another distance between the planes."""
        _, worst, _ = self._outermost
        rays = self._candidates
        moved = np.einsum("td,tacd->tac", self.amounts, rays.responses[worst])
        return self._load(rays.values[worst] + moved, further)[0]

    def _load(self, values: Array, further: float) -> tuple[Array, Array]:
        """Loads of rays with these positions and cosines, shape (..., 2, 2), and their slopes by them."""
        position, cosines = values[..., 0, :], values[..., 1, :]
        slopes = np.zeros_like(values)
        if not isinstance(self.merit, FootprintRadius):
            limit = np.sin(np.deg2rad(self.merit.limit)) ** 2
            slopes[..., 1, :] = 2.0 * cosines / limit
            return np.sum(cosines**2, axis=-1) / limit, slopes
        limit = self.merit.limit**2
        along = np.sqrt(np.maximum(1.0 - np.sum(cosines**2, axis=-1), 1e-12))[..., None]
        across = position + further * cosines / along
        slopes[..., 0, :] = 2.0 * across / limit
        turned = np.sum(across * cosines, axis=-1, keepdims=True) * cosines / along**3
        slopes[..., 1, :] = 2.0 * further / limit * (across / along + turned)
        return np.sum(across**2, axis=-1) / limit, slopes
