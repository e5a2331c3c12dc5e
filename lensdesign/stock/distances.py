"""Working distance and spacing of stock lenses: those with the smallest spread within all other limits.

Rays over field and stop are traced at many distances at once. Loads are ratios of a quantity to its limit.
The search only finds distances; whether they meet the specification is decided by
:func:`lensdesign.optimization.specification_check.check_against`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.optimization.problem import Rays, sample_rays
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification_check import body_constraints
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.rays import trace_compiled
from lensdesign.stock.arrangement import Arrangement, working_distances_mm

PENALTY = 10.0
"""Weight of loads above 1 other than that of the spread; a smaller spread never outweighs them."""

MARGIN = 0.9999
"""Largest load of the sampled rays that counts as met, since the check finds slightly worse rays."""


@dataclass(frozen=True)
class Sampling:
    """Density of a search for distances.

    Attributes
    ----------
    fields, fan, skew
        Rays: arguments of :func:`lensdesign.optimization.problem.sample_rays`.
    working_distances, spacings : (int, int)
        Points in each round, and rounds, of the searches for working distance and spacing.
    """

    fields: int
    fan: int
    skew: int
    working_distances: tuple[int, int]
    spacings: tuple[int, int]


COARSE = Sampling(2, 7, 2, (9, 4), (5, 2))
"""For a ranking of thousands of arrangements."""

FINE = Sampling(4, 13, 4, (9, 7), (7, 4))
"""For the arrangements that are checked."""

_BLOCKED = 1e3
"""Load if rays do not arrive; the fraction of them is added, so that a search leaves the region."""


@dataclass(frozen=True, eq=False)
class FoundDistances:
    """Distances of an arrangement, with loads of sampled rays.

    Attributes
    ----------
    arrangement : Arrangement
        The lenses.
    working_distance_mm, spacing_mm : float
        Distance from the object to the first vertex, and between the lenses.
    spread, others : float
        Largest load of the spread, and of footprints, clear apertures and lengths.
    """

    arrangement: Arrangement
    working_distance_mm: float
    spacing_mm: float
    spread: float
    others: float

    @property
    def rank(self) -> float:
        """Load of the spread with a penalty on the other loads."""
        return self.spread + PENALTY * max(0.0, self.others - 1.0)


def find_distances(
    arrangement: Arrangement,
    specification: Specification,
    glass_catalogs: Sequence[Path] = (),
    sampling: Sampling = FINE,
    margin: float = MARGIN,
) -> FoundDistances:
    """Find the working distance and the spacing with the smallest spread within the other limits.

    The spacing is found by a bounded one-dimensional search, with the best working distance at each spacing.

    Parameters
    ----------
    arrangement
        The lenses.
    specification
        Specification with the limits and the range of the working distance.
    glass_catalogs
        Glass catalogues that are searched first.
    sampling
        Density of rays and distances.
    margin
        Largest load other than that of the spread.

    Raises
    ------
    InputError
        If the lenses break a limit that does not depend on distances, or cannot be mounted.
    """
    traced = _TracedArrangement(arrangement, specification, glass_catalogs, sampling)
    spacings = arrangement.spacings_mm(specification)
    distances = working_distances_mm(specification)

    def rank_at(spacing_mm: Array) -> Array:
        """Return the rank at the best working distance of each spacing, and remember these distances."""

        def rank(log_working: Array) -> Array:
            spread, others = traced.loads(np.exp(log_working), spacing_mm[0])
            return spread + PENALTY * np.maximum(0.0, others / margin - 1.0)

        near, far = (np.full(spacing_mm.shape[1], math.log(end)) for end in distances)
        best, values = smallest_of(rank, near, far, *sampling.working_distances)
        found.update(zip(spacing_mm[0], np.clip(np.exp(best), *distances), strict=True))
        return values[None]

    found: dict[float, float] = {}
    low, high = (np.array([end]) for end in spacings)
    spacing, _ = smallest_of(rank_at, low, high, *sampling.spacings)
    working_mm = found[spacing[0]]
    spread, others = traced.loads(np.array([[working_mm]]), spacing)
    return FoundDistances(
        arrangement, float(working_mm), float(spacing[0]), float(spread[0, 0]), float(others[0, 0])
    )


def smallest_of(
    function: Callable[[Array], Array], low: Array, high: Array, points: int, rounds: int
) -> tuple[Array, Array]:
    """Return where functions of one variable are smallest within bounds, and their values.

    Each round evaluates points at equal distances and continues between the neighbours of the best one.

    Parameters
    ----------
    function
        Called with arguments of shape (n, points), returns as many values.
    low, high
        Bounds of each of the n functions, shape (n,). Equal bounds fix the argument.
    points, rounds
        Number of points in each round, and of rounds.
    """
    count = len(low)
    if np.all(low == high):
        return low, function(low[:, None])[:, 0]
    rows = np.arange(count)
    for _ in range(rounds):
        tried = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, points)
        values = function(tried)
        best = np.argmin(values, axis=1)
        low, high = tried[rows, np.maximum(best - 1, 0)], tried[rows, np.minimum(best + 1, points - 1)]
    return tried[rows, best], values[rows, best]


@dataclass(frozen=True, eq=False)
class _TracedArrangement:
    """Rays through an arrangement at many distances."""

    arrangement: Arrangement
    specification: Specification
    glass_catalogs: Sequence[Path]
    sampling: Sampling

    @cached_property
    def _systems(self) -> tuple[CompiledSystem, ...]:
        """The arrangement at each wavelength, with the smallest spacing."""
        low, _ = self.arrangement.spacings_mm(self.specification)
        lens = self.arrangement.widest_design(self.specification, low, self.glass_catalogs)
        missed = [one.miss for one in body_constraints(lens, self.specification) if not one.met]
        if missed:
            raise InputError(missed[0])
        return tuple(compile_system(lens, wavelength) for wavelength in lens.wavelengths_um)

    @cached_property
    def _rays(self) -> Rays:
        half_field_mm = 0.5 * self.specification.required_object.field_diameter_mm
        rays = sample_rays(half_field_mm, self.sampling.fields, self.sampling.fan, self.sampling.skew)
        return rays if self._systems[0].rotational else rays.all_round()

    @cached_property
    def _clear_mm(self) -> Array:
        semis = [s.semi_diameter_mm or math.inf for part in self.arrangement.parts for s in part.surfaces]
        return np.array(semis)

    @cached_property
    def _footprints_mm(self) -> Array:
        """Largest footprint radius on each sensor plane."""
        specification = self.specification
        if specification.constraints.max_footprint_radius_mm != "sensor rectangle":
            return np.array(specification.footprint_limits())
        rotational = self._systems[0].rotational  # otherwise the sides differ, and the check decides alone
        half_mm = 0.5 * min(specification.sensor.size_mm) if rotational else math.inf
        return np.full(len(specification.sensor.plane_distances_mm), half_mm)

    def loads(self, working_mm: Array, spacing_mm: Array) -> tuple[Array, Array]:
        """Return the load of the spread and the largest other one, shape (spacings, distances) each.

        Parameters
        ----------
        working_mm
            Working distances at each spacing, shape (spacings, distances).
        spacing_mm
            Spacings, shape (spacings,).
        """
        stop = self.arrangement.stop_semi_diameter_mm(self.specification, working_mm)
        spread, others = np.zeros(working_mm.shape), self._length_loads(working_mm, spacing_mm)
        for system, wavelength in zip(self._systems, self.specification.wavelengths_um, strict=True):
            one, other = self._traced_loads(system, wavelength, working_mm, spacing_mm, stop)
            spread, others = np.maximum(spread, one), np.maximum(others, other)
        return spread, others

    def _length_loads(self, working_mm: Array, spacing_mm: Array) -> Array:
        limits = self.specification.constraints
        thickness = self.arrangement.thickness_mm + spacing_mm[:, None] + np.zeros_like(working_mm)
        track = working_mm + thickness + self.specification.sensor.plane_distances_mm[-1]
        loads = np.zeros(working_mm.shape)
        pairs = ((thickness, limits.max_lens_thickness_mm), (track, limits.max_track_mm))
        for length, most in pairs:
            if most is not None:
                loads = np.maximum(loads, length / most)
        return loads

    def _traced_loads(
        self,
        system: CompiledSystem,
        wavelength_um: float,
        working_mm: Array,
        spacing_mm: Array,
        stop_mm: Array,
    ) -> tuple[Array, Array]:
        rays, shape = self._rays, working_mm.shape
        moved = np.repeat(system.vertex, len(spacing_mm), axis=0)
        behind = len(self.arrangement.parts[0].surfaces)
        if behind < system.surfaces:
            moved[:, behind:, 2] += (spacing_mm - (moved[0, behind, 2] - moved[0, behind - 1, 2]))[:, None]
        several = replace(system, trials=len(spacing_mm), vertex=moved)
        stop = np.where(np.isnan(stop_mm), 1e-3, stop_mm)[..., None, None]
        targets = np.empty((*shape, len(rays.pupil), 3))
        targets[..., :2] = stop * rays.pupil
        with np.errstate(invalid="ignore"):
            sag = system.shapes[0].sag(targets[..., 0], targets[..., 1])
        lost = np.isnan(stop_mm) | np.any(np.isnan(sag), axis=-1)
        targets[..., 2] = np.nan_to_num(sag)
        origins = np.empty_like(targets)
        origins[..., :2], origins[..., 2] = rays.fields_mm, -working_mm[..., None]
        directions = targets - origins
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        flat = (len(spacing_mm), -1, 3)
        traced = trace_compiled(
            several, origins.reshape(flat), directions.reshape(flat), clip=False, record_hits=True, threads=1
        )
        assert traced.hits is not None  # record_hits is set
        ok = traced.ok.reshape(*shape, -1)
        missing = 1.0 - np.mean(ok, axis=-1) + lost
        headings = traced.direction.reshape(*shape, -1, 3)
        sine = np.where(ok, np.hypot(headings[..., 0], headings[..., 1]), 0.0).max(axis=-1)
        heights = traced.hits.reshape(*shape, -1, system.surfaces, 3)
        clear = np.where(ok[..., None], np.hypot(heights[..., 0], heights[..., 1]), 0.0).max(axis=-2)
        others = np.max(clear / self._clear_mm, axis=-1)
        ends = traced.position.reshape(*shape, -1, 3)
        exit_z = moved[:, -1, 2][:, None, None]
        with np.errstate(all="ignore"):
            slopes = headings[..., :2] / headings[..., 2:]
            plate = system.cover_glass
            shift = 0.0 if plate is None else plate.lateral_shift_mm(headings[..., :2])
            for plane, limit in zip(
                self.specification.sensor.plane_distances_mm, self._footprints_mm, strict=True
            ):
                steps = (exit_z + plane - ends[..., 2])[..., None]
                reach = np.linalg.norm(ends[..., :2] + steps * slopes + shift, axis=-1)
                others = np.maximum(others, np.where(ok, reach, 0.0).max(axis=-1) / limit)
        others = np.where(missing > 0.0, _BLOCKED * (1.0 + missing), others)
        limit = self.specification.spread_limit(wavelength_um, float(system.index[0, -1]))
        # Without a limit, spreads are compared by their sines.
        return sine / (1.0 if math.isinf(limit) else limit), others
