"""Largest spreads and footprints of drawn lenses, with exact derivatives by design variables.

Each ray follows the perturbations to first order, and each drawn lens has its own outermost ray. Only rays
that can be the outermost ray of some lens are followed for all lenses, and only actual outermost rays are
differentiated.
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
from lensdesign.raytrace.bundles import pupil_rings
from lensdesign.raytrace.plane_plate import PlanePlate, cover_plate
from tolerancing.merits.context import Sampling
from tolerancing.merits.rays import FootprintRadius, RayMerit
from tolerancing.prediction.goals.design import STEP, DesignPoint, TracedRays
from tolerancing.prediction.motions import Motions, motions_of
from tolerancing.prediction.sensor_ray_derivatives import arrivals_by

LEADING, BEHIND = 48, 6.0
"""Number of rays with the largest nominal loads, and distance from the largest nominal load within which any
other ray may be the outermost ray of a lens, in units of the largest standard deviation of these loads."""

PROBED, CLOSE = 128, 0.1
"""Number of drawn lenses that select the rays to follow, and largest distance of a selected ray from the
largest load of one of these lenses, in standard deviations of the largest loads."""

FAN, HEIGHTS = 41, (0.4, 0.7, 0.85)
"""Number of points of a fan along the azimuth of a field point, where most extreme rays lie, and additional
field heights, as fractions of the largest, for a limit over the whole field."""


def judged_rays(merit: RayMerit, lens: Lens, sampling: Sampling) -> Rays:
    """Return the rays by which a search evaluates a limit: the merit's rings over the stop, and fans.

    Trials trace the extreme rays of the nominal lens instead. Finding these would take longer than everything
    else that a search does with a lens.
    """
    fields = np.array(merit.points(lens), float).reshape(-1, 2)
    rings = pupil_rings(sampling.rings, sampling.arms, edge=True).points
    where, points = [np.repeat(fields, len(rings), axis=0)], [np.tile(rings, (len(fields), 1))]
    if not merit.field_points_mm:
        fields = np.concatenate([fields, *(fraction * fields[1:] for fraction in HEIGHTS)])
    along = np.linspace(-1.0, 1.0, FAN)[:, None]
    for field in fields:
        height = float(np.hypot(*field))
        points.append(along * (field / height if height else np.array([0.0, 1.0])))
        where.append(np.tile(field, (FAN, 1)))
    return Rays(np.concatenate(where), np.concatenate(points))


class FollowedRays:
    """Rays of a design on the first sensor plane, in air, and how they follow perturbations to first order.

    Parameters
    ----------
    design
        The design. Its compensators have no effect, because they adapt the model and not the lens.
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
        """Derivatives of positions and direction cosines by the changes, shape (n, 2, 2, d)."""
        design, paths = self.design, self.traced.nominal_paths
        motions = Motions(paths, design.sag_errors(paths))
        found = np.stack(arrivals_by(motions, design.lens.stop_index), axis=1)
        return self._perturbed(found @ motions_of(design.changes) * design.multiplier)

    def responses_by(self, variable: int) -> Array:
        """Return the derivatives of the responses by a variable, of the same shape."""
        design, paths = self.design, self.traced.moved(variable)
        changes, multiplier = design.moved_changes(variable)
        motions = Motions(paths, design.moved_sag_errors(paths, self.traced.nominal_paths, variable))
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

    def subset(self, which: NDArray[np.int64]) -> FollowedRays:
        """Return a subset of the rays."""
        return FollowedRays(self.design, self.rays.select(which))


@dataclass(frozen=True, eq=False)
class RayLoads:
    """Loads on a limit of spreads or footprints.

    Attributes
    ----------
    merit : LargestSpread or FootprintRadius
    followed : FollowedRays
        All evaluated rays.
    amounts : ndarray, shape (t, d)
        Amounts of the changes of the drawn lenses.
    """

    merit: RayMerit
    followed: FollowedRays
    amounts: Array
    softness: float | None = None

    @property
    def sign(self) -> float:
        """1 for an upper limit, -1 for a lower one."""
        return 1.0 if self.merit.at_most is not None else -1.0

    @cached_property
    def _candidates(self) -> FollowedRays:
        """Rays that can be the outermost ray of some lens."""
        loads = self._loads_of(self.followed.values)
        leading = self.followed.subset(np.argsort(-loads)[:LEADING])
        responses = np.einsum("nac,nacd->nd", self._slopes_of(leading.values), leading.responses)
        probed = self.amounts[:PROBED]
        reach = BEHIND * np.max(np.std(probed @ responses.T, axis=0))
        near = self.followed.subset(np.flatnonzero(loads >= np.max(loads) - reach))
        loads = self._drawn_loads(near, probed)
        largest = np.max(loads, axis=1, keepdims=True)
        close = np.any(loads >= largest - CLOSE * np.std(largest), axis=0)
        return near.subset(np.flatnonzero(close))

    def _drawn_loads(self, rays: FollowedRays, amounts: Array) -> Array:
        """Return the loads of all rays of drawn lenses, shape (t, n)."""
        used = self._used
        n, responses = len(rays.values), rays.responses[:, used]
        moved = amounts @ responses.reshape(-1, responses.shape[-1]).T
        return self._loads_of(rays.values[:, used] + moved.reshape(len(amounts), n, -1, 2))

    @cached_property
    def _outermost(self) -> tuple[Array, NDArray[np.intp], Array]:
        """Load of each lens, its outermost ray, and derivatives by the values of this ray, (t, 2, 2)."""
        rays = self._candidates
        loads = self._drawn_loads(rays, self.amounts)
        worst = np.argmax(loads, axis=1)
        slopes = np.empty((len(worst), 2, 2))
        for number in np.unique(worst):
            own = worst == number
            moved = np.tensordot(self.amounts[own], rays.responses[number], (1, 2))
            slopes[own] = self._slopes_of(rays.values[number] + moved)
        return loads[np.arange(len(worst)), worst], worst, slopes

    @property
    def loads(self) -> Array:
        """Square of the largest sine or footprint divided by that of the limit, shape (t,)."""
        return self._outermost[0]

    def weighted(self, weights: Array) -> Array:
        """Return derivatives of the weighted sum of the loads by the variables, shape (v,)."""
        _, worst, slopes = self._outermost
        used, place = np.unique(worst, return_inverse=True)
        rays, gradient = self._candidates.subset(used), weights[:, None, None] * slopes
        nominal, moved = np.zeros((len(used), 2, 2)), np.zeros((len(used), 2, 2, self.amounts.shape[1]))
        for number in range(len(used)):
            own = place.ravel() == number
            nominal[number] = np.sum(gradient[own], axis=0)
            moved[number] = np.tensordot(gradient[own], self.amounts[own], (0, 0))
        by: Array = np.einsum("nac,nacv->v", nominal, rays.values_by)
        by = by + [float(np.sum(moved * rays.responses_by(v))) for v in range(len(by))]
        if self._follows_the_sensor:
            by += self._by_planes(weights)
        return np.asarray(by)

    @property
    def _used(self) -> slice:
        """Coordinates that the loads depend on: for spreads only the direction cosines."""
        return slice(0, 2) if isinstance(self.merit, FootprintRadius) else slice(1, 2)

    @property
    def _further(self) -> float:
        """Distance from the first sensor plane to the plane of the limit, in mm."""
        planes = self.followed.design.lens.sensor.plane_distances_mm
        own = self.merit.plane_distance_mm if isinstance(self.merit, FootprintRadius) else None
        return (own or planes[-1]) - planes[0]

    @property
    def _follows_the_sensor(self) -> bool:
        return (
            isinstance(self.merit, FootprintRadius)
            and self.followed.design.problem.temperature_change is not None
        )

    def _by_planes(self, weights: Array) -> Array:
        """Return the derivatives by the distance between the planes, which changes with temperature."""
        design = self.followed.design
        step = 1e-3  # loads are quadratic in the distance, so central differences are exact
        ends = [self._at_distance(self._further + sign * step) for sign in (1.0, -1.0)]
        by = float(weights @ (ends[0] - ends[1])) / (2.0 * step)
        planes = [design.problem.planes_by(design.point, v) for v in range(len(design.variables))]
        own = isinstance(self.merit, FootprintRadius) and self.merit.plane_distance_mm is not None
        return by * np.array([(0.0 if own else p[-1]) - p[0] for p in planes])

    def _at_distance(self, further: float) -> Array:
        """Return the loads of the same outermost rays for another distance between the planes."""
        _, worst, _ = self._outermost
        rays = self._candidates
        moved = np.einsum("td,tacd->tac", self.amounts, rays.responses[worst])
        return self._loads_of(rays.values[worst] + moved, further)

    def _loads_of(self, values: Array, further: float | None = None) -> Array:
        """Return the loads of rays by positions and cosines, shape (..., 2, 2), or by cosines alone."""
        cosines = values[..., -1, :]
        if not isinstance(self.merit, FootprintRadius):
            return np.asarray(np.sum(cosines**2, axis=-1) / np.sin(np.deg2rad(self.merit.limit)) ** 2)
        across = values[..., 0, :] + self._beyond(cosines, further)
        return np.asarray(np.sum(across**2, axis=-1) / self.merit.limit**2)

    def _slopes_of(self, values: Array) -> Array:
        """Return derivatives of the loads by positions and cosines, shape (..., 2, 2)."""
        cosines, slopes = values[..., 1, :], np.zeros_like(values)
        if not isinstance(self.merit, FootprintRadius):
            slopes[..., 1, :] = 2.0 * cosines / np.sin(np.deg2rad(self.merit.limit)) ** 2
            return slopes
        across = values[..., 0, :] + self._beyond(cosines)
        along = self._along(cosines)
        slopes[..., 0, :] = 2.0 * across / self.merit.limit**2
        turned = np.sum(across * cosines, axis=-1, keepdims=True) * cosines / along**3
        slopes[..., 1, :] = 2.0 * self._further / self.merit.limit**2 * (across / along + turned)
        if self._plate is not None:
            by_cosines = self._plate.shift_by_cosines(cosines)
            slopes[..., 1, :] += 2.0 / self.merit.limit**2 * np.einsum("...a,...ab->...b", across, by_cosines)
        return slopes

    @cached_property
    def _plate(self) -> PlanePlate | None:
        """Cover glass of the sensor at the wavelength of the rays."""
        design = self.followed.design
        return cover_plate(design.problem.base, design.wavelength_um)

    def _beyond(self, cosines: Array, further: float | None = None) -> Array:
        """Return the lateral displacement of rays between the first plane in air and the plane of the limit.

        It includes the shift by the cover glass of the sensor.
        """
        distance, plate = self._further if further is None else further, self._plate
        shift = 0.0 if plate is None else plate.lateral_shift_mm(cosines)
        return np.asarray(distance * cosines / self._along(cosines) + shift)

    def _along(self, cosines: Array) -> Array:
        """Return direction cosines along the axis, with an additional last axis of length 1."""
        return np.sqrt(np.maximum(1.0 - np.sum(cosines**2, axis=-1), 1e-12))[..., None]
