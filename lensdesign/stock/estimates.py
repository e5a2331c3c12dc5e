"""Estimates of stock lenses without rays: which of millions of pairs are worth tracing.

First-order optics gives the working distance that collimates the light, the beam on every surface and on the
sensor, and the spread due to the field. Spherical aberration of third order (Seidel's sum S_I, Welford,
Aberrations of Optical Systems, chapter 8) gives the spread due to the aperture. S_I is a form of fourth
degree in height and slope of the marginal ray in front of a lens, so five coefficients describe each lens,
wherever it stands. Off-axis aberrations and higher orders are ignored: the estimate ranks, and rays decide.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.glass import refractive_index
from lensdesign.lens.surface import Surface
from lensdesign.optimization.specification.specification import Specification
from lensdesign.raytrace.cached_kernels import cached_njit
from lensdesign.stock.arrangement import LEAST_GAP_MM, OrientedLens, StockLens, working_distances_mm

MATRIX, SEIDEL, FRONT_MM, BACK_MM, FRONT_SAG_MM, BACK_SAG_MM = slice(0, 4), slice(4, 9), 9, 10, 11, 12
"""Columns of a lens table: ray matrix A, B, C, D of height and slope between the vertices, in air;
coefficients of S_I by y^4, y^3 u, ..., u^4; clear semi-diameters of first and last surface; their sags there.
"""

AIR = np.array([1.0, 0.0, 0.0, 1.0, *(0.0,) * 5, math.inf, math.inf, 0.0, 0.0])
"""Row of a lens table for no lens at all, which follows a single lens."""


_jit = cached_njit(nogil=True, error_model="numpy")


def lens_table(lenses: Sequence[OrientedLens], wavelength_um: float, catalogs: Sequence[Path]) -> Array:
    """Return first and third order of lenses at a wavelength, shape (n, 13).

    Raises
    ------
    MaterialError
        If an index is not known at the wavelength.
    """
    indices: dict[str | float | None, float] = {None: 1.0}
    rows: list[Array] = []
    previous: tuple[StockLens, Array] | None = None
    for one in lenses:
        if previous is None or previous[0] is not one.lens:
            steps = np.array(
                [_step(surface, wavelength_um, catalogs, indices) for surface in one.lens.surfaces]
            )
            previous = one.lens, steps
        rows.append(_lens_row(_reversed(previous[1]) if one.is_reversed else previous[1]))
    return np.array(rows).reshape(-1, len(AIR))


def _step(
    surface: Surface,
    wavelength_um: float,
    catalogs: Sequence[Path],
    indices: dict[str | float | None, float],
) -> tuple[float, ...]:
    """Return curvature, term of r^4, clear semi-diameter, sag there, thickness and index behind a surface."""
    material, semi = surface.material, surface.semi_diameter_mm or 0.0
    if material is not None and material not in indices:
        indices[material] = refractive_index(material, wavelength_um, catalogs)
    curvature = surface.curvature
    # In the plane y-z, without the departure of a Qbfs.
    fourth = surface.conic * curvature**3 + 8.0 * sum(
        surface.shape.traced.term(name) for name in ("asphere_4", "odd_asphere_4")
    )
    sag = float(surface.shape.sag(0.0, semi))
    thickness = surface.thickness_mm or 0.0
    return curvature, fourth, semi, 0.0 if math.isnan(sag) else sag, thickness, indices[material]


def _reversed(steps: Array) -> Array:
    """Return the surfaces of a lens that is turned around."""
    result = steps[::-1] * np.array([-1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
    result[:-1, 4:], result[-1, 4:] = steps[-2::-1, 4:], (0.0, 1.0)
    return result


@_jit
def _product(first: Array, second: Array) -> Array:
    """Return the coefficients of the product of two forms."""
    found = np.zeros(len(first) + len(second) - 1)
    for i in range(len(first)):
        for j in range(len(second)):
            found[i + j] += first[i] * second[j]
    return found


@_jit
def _lens_row(steps: Array) -> Array:
    """Return a row of the table; heights and slopes are linear forms in those in front of the lens."""
    height, slope, index = np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0
    total = np.zeros(5)
    for k in range(len(steps)):
        curvature, fourth, behind = steps[k, 0], steps[k, 1], steps[k, 5]
        refracted = (index * slope - (behind - index) * curvature * height) / behind
        invariant = index * (slope + curvature * height)
        change = refracted / behind - slope / index
        # S_I = -A^2 y change(u / n), with the fourth power of the height for conics and aspheres.
        total -= _product(_product(invariant, invariant), _product(height, change))
        square = _product(height, height)
        total += (behind - index) * fourth * _product(square, square)
        slope, index = refracted, behind
        if k + 1 < len(steps):
            height = height + steps[k, 4] * slope
    row = np.empty(13)
    row[0:2], row[2:4], row[4:9] = height, slope, total
    row[9], row[10], row[11], row[12] = steps[0, 2], steps[-1, 2], steps[0, 3], steps[-1, 3]
    return row


@dataclass(frozen=True)
class EstimateLimits:
    """Values of a specification that estimates need.

    Attributes
    ----------
    half_field_mm, tangent
        Half of the field's diameter, and tangent of the angle of the numerical aperture.
    near_mm, far_mm
        Smallest and largest working distance.
    spread
        Largest spread as a sine; 1 without a limit.
    least_gap_mm
        Smallest air gap.
    stop_mm
        Semi-diameter of a fixed stop; 0 if the stop follows the numerical aperture.
    planes_mm, footprints_mm
        Distances of the sensor planes, and largest footprint radius on each. A cover glass is replaced by
        its paraxial equivalent: planes that lie nearer by t (1 - 1/n).
    """

    half_field_mm: float
    tangent: float
    near_mm: float
    far_mm: float
    spread: float
    least_gap_mm: float
    stop_mm: float
    planes_mm: tuple[float, ...]
    footprints_mm: tuple[float, ...]

    @classmethod
    def of(cls, specification: Specification) -> EstimateLimits:
        """Return the values of a specification."""
        scene = specification.required_object
        # Behind a stock lens there is air.
        sines = [specification.spread_limit(w, 1.0) for w in specification.wavelengths_um]
        footprints = specification.footprint_limits()
        if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
            footprints = (0.5 * math.hypot(*specification.sensor.size_mm),) * len(footprints)
        return cls(
            0.5 * scene.field_diameter_mm,
            math.tan(math.asin(scene.numerical_aperture)),
            *working_distances_mm(specification),
            min(1.0, *sines),
            specification.constraints.min_air_gap_mm,
            specification.stop_semi_diameter_mm if specification.optimize.stop == "fixed" else 0.0,
            _planes_in_air_mm(specification),
            footprints,
        )

    @property
    def for_kernel(self) -> tuple[Array, Array, Array]:
        """The single numbers in order, the planes, and the footprints."""
        numbers = [v for v in vars(self).values() if not isinstance(v, tuple)]
        return np.array(numbers), np.array(self.planes_mm), np.array(self.footprints_mm)


def _planes_in_air_mm(specification: Specification) -> tuple[float, ...]:
    """Return the distances of planes in air to which paraxial rays arrive as behind the cover glass."""
    sensor, nearer_mm = specification.sensor, 0.0
    if sensor.cover_glass is not None:
        index = specification.cover_glass_index(specification.wavelengths_um[0])
        nearer_mm = sensor.cover_glass.thickness_mm * (1.0 - 1.0 / index)
    return tuple(distance - nearer_mm for distance in sensor.plane_distances_mm)


@_jit
def _rank(
    fronts: Array,
    i: int,
    backs: Array,
    k: int,
    gap: float,
    most: float,
    numbers: Array,
    planes: Array,
    footprints: Array,
) -> Any:
    """Return the estimated rank of front i and back k with a gap between; inf if far above `most`."""
    half_field, tangent_na, near, far, most_spread, _, fixed_stop = numbers
    # The whole lens as a product of matrices: back, gap, front.
    fa, fb, fc, fd = (
        fronts[i, 0] + gap * fronts[i, 2],
        fronts[i, 1] + gap * fronts[i, 3],
        fronts[i, 2],
        fronts[i, 3],
    )
    a, b = backs[k, 0] * fa + backs[k, 1] * fc, backs[k, 0] * fb + backs[k, 1] * fd
    c, d = backs[k, 2] * fa + backs[k, 3] * fc, backs[k, 2] * fb + backs[k, 3] * fd
    if not c < 0.0:  # diverging: no distance collimates the light
        return np.inf
    collimating = min(max(-d / c, near), far)
    # Most pairs are left out here: the field alone, or the beam, is far beyond its limit.
    stop = tangent_na * collimating if fixed_stop == 0.0 else fixed_stop
    tangent = stop / collimating
    hopeless = 1.25
    if (
        abs(d) * half_field > hopeless * most_spread * collimating
        or stop > hopeless * fronts[i, 9]
        or abs(fa * stop + fb * tangent) > hopeless * backs[k, 9]
        or abs(a * stop + b * tangent) > hopeless * backs[k, 10]
    ):
        return np.inf
    best, distance, aberration = np.inf, collimating, 0.0
    # First the distance where light is collimated, then where defocus balances the aberration, then one at
    # which the beam fits.
    for step in range(3):
        stop = tangent_na * distance if fixed_stop == 0.0 else fixed_stop
        tangent, chief = stop / distance, -half_field / distance
        behind = fc * stop + fd * tangent
        seidel = _quartic(fronts, i, stop, tangent) + _quartic(backs, k, fa * stop + fb * tangent, behind)
        leaving, defocus = a * stop + b * tangent, c * stop + d * tangent
        aberration = -seidel / (2.0 * leaving)
        if step == 0:
            # Defocus leaves at least a quarter of the aberration (Chebyshev).
            if (0.25 * abs(aberration) + abs(d * chief)) / most_spread > 1.1 * most:
                return np.inf
            distance = min(max(collimating - 0.75 * aberration / (tangent * c), near), far)
            continue
        pupil = 0.0
        for radius in (0.4, 0.6, 0.8, 1.0):
            pupil = max(pupil, abs(defocus * radius + aberration * radius**3))
        spread = (pupil + abs(d * chief)) / most_spread
        others = max(stop / fronts[i, 9], abs(leaving) / backs[k, 10] + abs(b * chief) / backs[k, 10])
        within = abs(fronts[i, 0] * stop + fronts[i, 1] * tangent) + abs(fronts[i, 1] * chief)
        others = max(others, within / fronts[i, 10])
        others = max(others, (abs(fa * stop + fb * tangent) + abs(fb * chief)) / backs[k, 9])
        for n in range(len(planes)):
            marginal = leaving + planes[n] * (defocus + aberration)
            reach = abs(marginal) + abs((b + planes[n] * d) * chief)
            others = max(others, reach / footprints[n])
        rank = spread + 10.0 * max(0.0, others - 1.0)
        if rank < best:
            best = rank
        if others <= 1.0 or fixed_stop != 0.0:
            break
        distance = max(distance / others, near)
    return best


@_jit
def _quartic(lenses: Array, i: int, y: float, u: float) -> Any:
    """Return S_I of a lens for a ray of this height and slope in front of it."""
    square, product, rest = y * y, y * u, u * u
    total = lenses[i, 4] * square * square + lenses[i, 5] * square * product + lenses[i, 6] * square * rest
    return total + lenses[i, 7] * product * rest + lenses[i, 8] * rest * rest


@_jit
def _ranks(
    fronts: Array, backs: Array, most: float, numbers: Array, planes: Array, footprints: Array
) -> Array:
    """Return the ranks of each front with the back of the same index."""
    found = np.empty(len(backs))
    for k in range(len(backs)):
        i = k if len(fronts) > 1 else 0
        gap = max(max(fronts[i, 12] - backs[k, 11], 0.0) + numbers[5], LEAST_GAP_MM)
        found[k] = _rank(fronts, i, backs, k, gap, most, numbers, planes, footprints)
    return found


def single_ranks(lenses: Array, limits: EstimateLimits) -> Array:
    """Return the estimated spread over its limit, with a penalty on beams that are too wide; less is better.

    Parameters
    ----------
    lenses
        Table of single lenses, shape (n, 13).
    limits
        Values of the specification.
    """
    air, own = AIR[None], np.ascontiguousarray(lenses)
    return np.array([_rank(own, i, air, 0, 0.0, np.inf, *limits.for_kernel) for i in range(len(own))])


def pair_ranks(fronts: Array, backs: Array, limits: EstimateLimits, most: float = math.inf) -> Array:
    """Return the estimates of :func:`single_ranks` for pairs at the smallest distance that their edges allow.

    Parameters
    ----------
    fronts, backs
        Tables of the lenses that light meets first and last, shape (n, 13) or (1, 13), and (n, 13).
    limits
        Values of the specification.
    most
        Rank from which on the estimate may be inf.
    """
    found: Array = _ranks(fronts, backs, most, *limits.for_kernel)
    return found


def best_pairs(fronts: Array, backs: Array, limits: EstimateLimits, count: int) -> tuple[Array, Array, int]:
    """Return the most promising pairs of lenses.

    Only pairs are estimated whose summed power can collimate the light within the working distances.

    Parameters
    ----------
    fronts, backs
        Tables of the lenses that may come first, and last.
    limits
        Values of the specification.
    count
        Largest number of pairs.

    Returns
    -------
    pairs : ndarray of int, shape (n, 2)
        Indices of front and back, the best pair first.
    ranks : ndarray, shape (n,)
        Their estimated ranks.
    estimated : int
        Number of pairs that were estimated.
    """
    order = np.argsort(-backs[:, 2], kind="stable")
    ordered, powers = np.ascontiguousarray(backs[order]), -backs[order, 2]
    # A lens that collimates has about the working distance as focal length, and one that images half the
    # field within the spread has at least their ratio. Separated lenses have another power than their sum.
    weakest, strongest = 0.5 / limits.far_mm, 1.5 * limits.spread / limits.half_field_mm

    def ranks_of(i: int) -> tuple[int, Array]:
        first, last = np.searchsorted(powers, (weakest + fronts[i, 2], strongest + fronts[i, 2]))
        return int(first), pair_ranks(fronts[i : i + 1], ordered[first:last], limits, threshold)

    found, ranks, estimated, threshold = np.empty((0, 2), int), np.empty(0), 0, math.inf
    chunk = 64
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads:  # the kernel runs without Python's lock
        for start in range(0, len(fronts), chunk):
            more = []
            indices = range(start, min(start + chunk, len(fronts)))
            for i, (first, own) in zip(indices, threads.map(ranks_of, indices), strict=True):
                estimated += len(own)
                good = np.flatnonzero(own < threshold)
                more.append((np.column_stack([np.full(len(good), i), order[first + good]]), own[good]))
            found, ranks = _smallest(found, ranks, more, count)
            threshold = float(ranks[-1]) if len(ranks) == count else math.inf
    return found, ranks, estimated


def _smallest(
    pairs: Array, ranks: Array, more: Sequence[tuple[Array, Array]], count: int
) -> tuple[Array, Array]:
    """Return the pairs with the smallest ranks, in order."""
    pairs = np.concatenate([pairs, *(one for one, _ in more)])
    ranks = np.concatenate([ranks, *(one for _, one in more)])
    order = np.argsort(ranks, kind="stable")[:count]
    order = order[np.isfinite(ranks[order])]
    return pairs[order], ranks[order]
