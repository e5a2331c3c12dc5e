"""Derivatives of reconstruction pupils by perturbations, from the rays of the nominal lens.

The pupil's path difference dV(p) (:mod:`wavesim.pupil.pupil`) is a change of path between fixed object and
sensor points; :mod:`tolerancing.prediction.paths` differentiates such paths. Means over the pupil use
Gauss-Legendre rings over the stop (Forbes, J. Opt. Soc. Am. A 5, 1943, 1988). Each ray has the weight of its
part of the stop, measured in direction cosines at the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_array

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.lens.zernikes import zernike
from lensdesign.raytrace.bundles import PupilSamples, launch_compiled, pupil_rings
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.rays import trace_compiled
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.motions import pair_weights, second_by_pairs
from tolerancing.prediction.paths import Paths, SagErrors
from tolerancing.prediction.system import Changes, changes_of

RINGS, ARMS = 6, 14
"""Numbers of rings and arms of rays over the stop."""


@dataclass(frozen=True, eq=False)
class FieldDifferentials:
    """Derivatives of the path difference at one object point, for n rays and d changes.

    Attributes
    ----------
    weights : ndarray, shape (n,)
        Weights of means over the pupil; they sum to 1.
    basis : ndarray, shape (4, n)
        Terms that registration and refocusing remove: 1 and the direction cosines.
    first : ndarray, shape (n, d)
        Derivatives of the path difference in waves, by the changes.
    second : ndarray, shape (n, d (d + 1) / 2)
        Second derivatives by pairs of changes (i, j), i <= j, in the order of `numpy.triu_indices`; no
        columns if they were not requested.
    """

    weights: Array
    basis: Array
    first: Array
    second: Array

    @cached_property
    def registered(self) -> Array:
        """First derivatives without piston, shift and focus, shape (n, d)."""
        return self.without_focus(self.first)

    @cached_property
    def registered_second(self) -> Array:
        """Second derivatives without piston, shift and focus, shape (n, pairs)."""
        return self.without_focus(self.second)

    def waves(self, amounts: Array) -> Array:
        """Return path differences of trials without piston, shift and focus, shape (trials, n).

        Parameters
        ----------
        amounts : ndarray, shape (trials, d)
            Amount of each change in each trial.
        """
        found = amounts @ self.registered.T
        if self.second.shape[1]:
            i, j = np.triu_indices(amounts.shape[1])
            halves = np.where(i == j, 0.5, 1.0)
            # Trials whose products of perturbations are held at one time.
            block = 512
            for start in range(0, len(amounts), block):
                part = amounts[start : start + block]
                found[start : start + block] += (halves * part[:, i] * part[:, j]) @ self.registered_second.T
        return np.asarray(found)

    def without_focus(self, waves: Array) -> Array:
        """Return path differences, shape (n, ...), less the piston, shift and refocus that fit them best."""
        basis = self.basis
        heavy = basis * self.weights
        return np.asarray(waves - basis.T @ np.linalg.solve(heavy @ basis.T, heavy @ waves))


@dataclass(frozen=True, eq=False)
class Differentials:
    """Derivatives of a lens's pupils by its perturbations.

    Attributes
    ----------
    changes : Changes
        Changes that make up the perturbations.
    fields : tuple of FieldDifferentials
        One for each object point.
    """

    changes: Changes
    fields: tuple[FieldDifferentials, ...]


def differentials(
    lens: Lens,
    parameters: Sequence[PerturbedParameter],
    sizes: Array,
    fields_mm: Sequence[tuple[float, float]],
    *,
    wavelength_um: float | None = None,
    plane_distance_mm: float = 3.0,
    pivot_z_mm: float = 0.0,
    second: bool = True,
) -> Differentials:
    """Differentiate the reconstruction pupils of a lens by perturbations.

    The change of the rays that pass the perturbed stop is neglected.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters
        Perturbed parameters.
    sizes : ndarray, shape (parameters,)
        Approximate sizes of the perturbations, in the units of the parameters.
    fields_mm
        Object points (x, y).
    wavelength_um
        Vacuum wavelength; the lens's first by default.
    plane_distance_mm
        Distance from the exit vertex to the plane at which paths end.
    pivot_z_mm
        Position on the axis about which the whole lens tilts, from its front vertex.
    second
        Whether second derivatives are computed.

    Raises
    ------
    InputError
        If the lens does not have a perturbed parameter.
    DesignError
        If not all rays pass.
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    changes = changes_of(lens, parameters, sizes, pivot_z_mm, wavelength, second)
    stop = pupil_rings(RINGS, ARMS)
    paths = nominal_paths(lens, fields_mm, stop, wavelength, plane_distance_mm)
    weights = pair_weights(changes) if second else None
    n, waves = len(stop.points), 1e3 / wavelength
    fields = [
        _field(paths.subset(slice(k * n, (k + 1) * n)), changes, stop, waves, weights)
        for k in range(len(fields_mm))
    ]
    return Differentials(changes, tuple(fields))


def _field(
    paths: Paths, changes: Changes, stop: PupilSamples, waves_per_mm: float, weights: csr_array | None
) -> FieldDifferentials:
    sag_errors = sag_errors_on(paths, changes)
    first = waves_per_mm * first_by(paths, changes, sag_errors)
    if weights is None:
        second = np.zeros((len(first), 0))
    else:
        second = second_by_pairs(paths, weights, sag_errors)
        second *= waves_per_mm
    cosines = paths.cosines
    return FieldDifferentials(weights_over_stop(cosines, stop), basis_of(cosines), first, second)


def first_by(paths: Paths, changes: Changes, sag_errors: Sequence[SagErrors]) -> Array:
    """Return the first derivatives of paths in mm by changes, shape (n, d)."""
    found = paths.by_parameters @ changes.first
    for one in sag_errors:
        found[:, one.columns] += paths.by_sag_error(one.surface, one.sag)
    return np.asarray(found)


def sag_errors_on(paths: Paths, changes: Changes) -> list[SagErrors]:
    """Return the sag errors of irregularities at the rays."""
    found = []
    for surface, columns, figure in changes.figures:
        x, y = paths.heights_mm[:, surface, 0], paths.heights_mm[:, surface, 1]
        sag, across, down = (part.T for part in figure.sag_and_slopes(x, y))
        found.append(SagErrors(surface, columns, sag, across, down))
    return found


def nominal_paths(
    lens: Lens,
    fields_mm: Sequence[tuple[float, float]],
    stop: PupilSamples,
    wavelength_um: float,
    plane_distance_mm: float,
    whole: bool = True,
) -> Paths:
    """Trace rays from object points, one after the other, through the stop.

    Paths end in air on a plane, without the cover glass of the sensor. Rays that do not arrive are omitted
    unless `whole` is true.

    Raises
    ------
    DesignError
        If not all of a whole pupil arrive, or none at all.
    """
    system = compile_system(lens, wavelength_um).without_cover_glass()
    plane_z = lens.exit_vertex_z_mm + plane_distance_mm
    origins, directions = launch_compiled(
        system, fields_mm, stop.points, lens.object_z_mm, lens.stop_index, lens.stop_semi_diameter_mm
    )
    rays = trace_compiled(system, origins, directions, plane_z, record_hits=True)
    assert rays.hits is not None  # record_hits is true
    if not np.any(rays.ok):
        raise DesignError("no ray from the object points passes the lens")
    if whole and not np.all(rays.ok):
        lost = np.flatnonzero(~rays.ok)[0] // len(stop.points)
        raise DesignError(
            f"rays from the object point ({fields_mm[lost][0]:g}, {fields_mm[lost][1]:g}) mm do not all pass "
            "the lens: its wavefront has no derivatives there"
        )
    return Paths(
        system.shapes,
        system.vertex[0, :, 2],
        system.index[0],
        origins[rays.ok],
        rays.hits[rays.ok, :, :2],
        rays.position[rays.ok],
    )


def basis_of(cosines: Array) -> Array:
    """Return 1 and the direction cosines without their means, shape (4, n)."""
    rows = cosines.T - np.mean(cosines, axis=0)[:, None]
    return np.concatenate([np.ones_like(rows[:1]), rows])


def weights_over_stop(cosines: Array, stop: PupilSamples) -> Array:
    """Return the weight of each ray: its fraction of the pupil in direction cosines, shape (n,)."""
    across, down = _slopes_over_stop()
    by_x, by_y = across @ cosines[:, :2], down @ cosines[:, :2]
    area = stop.weights * (by_x[:, 0] * by_y[:, 1] - by_x[:, 1] * by_y[:, 0])
    return np.asarray(area / np.sum(area))


@lru_cache(maxsize=1)
def _slopes_over_stop() -> tuple[Array, Array]:
    """Return matrices from values at the points of the rings to derivatives along x and y of the stop."""
    points = pupil_rings(RINGS, ARMS).points
    offsets = [np.zeros(2), *(step * axis for axis in np.eye(2) for step in (1e-4, -1e-4))]
    center, right, left, upper, lower = (_polynomials(points + offset) for offset in offsets)
    fit = np.linalg.pinv(center)
    return (right - left) / 2e-4 @ fit, (upper - lower) / 2e-4 @ fit


def _polynomials(points: Array) -> Array:
    rho, theta = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    # Direction cosines are followed over the stop by Zernike polynomials to the sixth radial order.
    polynomials = 28
    return np.stack([zernike(index, rho, theta) for index in range(polynomials)], axis=1)
