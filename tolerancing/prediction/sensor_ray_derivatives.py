"""Positions and directions of rays on the sensor, with derivatives by perturbations.

A ray leaves a fixed point of the object and passes a fixed point of the stop. By Fermat's principle its path
to the sensor point at which it arrives is stationary in the points on all surfaces. The implicit function
theorem therefore gives the derivatives of these points and of the sensor point, with the point on the stop
held constant. No perturbed ray is traced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import PupilSamples
from lensdesign.raytrace.plane_plate import cover_plate
from tolerancing.merits.sensor_rays import Arrival
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.derivatives import nominal_paths, sag_errors_on
from tolerancing.prediction.motions import Motions, motions_of
from tolerancing.prediction.system import Changes, changes_of


@dataclass(frozen=True, eq=False)
class ArrivalDifferentials:
    """First derivatives of rays on the first sensor plane, in the sensor's own frame; n rays, d changes.

    Attributes
    ----------
    changes : Changes
        Changes that make up the perturbations.
    position_mm, direction : ndarray, shape (n, 2)
        Positions of the nominal rays from the sensor's centre, and their direction cosines along its sides.
    position_by, direction_by : ndarray, shape (n, 2, d)
        Their derivatives by the changes.
    """

    changes: Changes
    position_mm: Array
    direction: Array
    position_by: Array
    direction_by: Array

    def subset(self, rays: NDArray[np.int64]) -> ArrivalDifferentials:
        """Return a subset of the rays."""
        return ArrivalDifferentials(
            self.changes,
            self.position_mm[rays],
            self.direction[rays],
            self.position_by[rays],
            self.direction_by[rays],
        )

    def arrival(self, amounts: Array) -> Arrival:
        """Return rays of trials to first order, from the amounts of each change, shape (trials, d)."""
        position, across = (
            middle + (amounts @ by.reshape(-1, amounts.shape[1]).T).reshape(-1, *middle.shape)
            for middle, by in ((self.position_mm, self.position_by), (self.direction, self.direction_by))
        )
        along = np.sqrt(1.0 - np.sum(across**2, axis=-1))
        direction = np.concatenate([across, along[..., None]], axis=-1)
        return Arrival(position, direction, np.ones(along.shape, bool))


def arrival_differentials(
    lens: Lens,
    parameters: Sequence[PerturbedParameter],
    sizes: Array,
    fields_mm: Sequence[tuple[float, float]],
    stop: PupilSamples,
    *,
    wavelength_um: float | None = None,
    pivot_z_mm: float = 0.0,
) -> ArrivalDifferentials:
    """Differentiate rays on the first sensor plane by perturbations of a lens.

    Parameters
    ----------
    lens
        The nominal lens.
    parameters
        Perturbed parameters.
    sizes : ndarray, shape (parameters,)
        Approximate sizes of the perturbations, in the units of the parameters.
    fields_mm
        Object points (x, y). The rays are in this order; rays that do not pass the lens are omitted.
    stop
        Points on the stop that the rays pass through, also in the perturbed lens.
    wavelength_um
        Vacuum wavelength; the lens's first by default.
    pivot_z_mm
        Position on the axis about which the whole lens tilts, from its front vertex.

    Raises
    ------
    InputError
        If the lens does not have a perturbed parameter.
    DesignError
        If no ray passes.
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    changes = changes_of(lens, parameters, sizes, pivot_z_mm, wavelength, False)
    first_plane_mm = lens.sensor.plane_distances_mm[0]
    paths = nominal_paths(lens, fields_mm, stop, wavelength, first_plane_mm, whole=False)
    motions = Motions(paths, sag_errors_on(paths, changes))
    position, direction = arrivals_by(motions, lens.stop_index)
    moved = motions_of(changes)
    positions_mm, cosines = paths.sensors_mm[:, :2], paths.directions[:, -1, :2]
    position_by, direction_by = position @ moved, direction @ moved
    plate = cover_plate(lens, wavelength)
    if plate is not None:
        positions_mm = positions_mm + plate.lateral_shift_mm(cosines)
        position_by = position_by + plate.shift_by_cosines(cosines) @ direction_by
    return ArrivalDifferentials(changes, positions_mm, cosines, position_by, direction_by)


def arrivals_by(motions: Motions, stop: int) -> tuple[Array, Array]:
    """Return derivatives of sensor positions and direction cosines by q motions, both of shape (n, 2, q).

    Complex paths and figures give complex derivatives, for complex steps of design variables.

    Parameters
    ----------
    motions
        Motions of the rays.
    stop
        Index of the stop surface, on which the points of the rays are fixed.
    """
    paths = motions.paths
    sensor = slice(-3, -1)  # x and y of the last station
    kept = slice(2 * stop, 2 * stop + 2)
    mixed = paths.along_surfaces(paths.hessian[:, :, sensor])
    # The point on the sensor is an unknown instead of the point on the stop.
    free = paths.surface_hessian.copy()
    free[:, :, kept] = mixed
    moved: Array = -np.asarray(np.linalg.solve(free, motions.mixed_derivatives))
    position = moved[:, kept].copy()
    moved[:, kept] = 0.0
    optical = np.swapaxes(mixed, 1, 2) @ moved
    optical += paths.hessian[:, sensor] @ motions.points
    optical += paths.hessian[:, sensor, sensor] @ position
    turns = slice(6 * len(paths.shapes) + 6, 6 * len(paths.shapes) + 9)
    gradient = paths.gradient[:, -1]
    for c in range(2):
        optical[:, c, turns] += np.cross(np.eye(3)[c], gradient)
    return np.asarray(position), np.asarray(optical / paths.index[-1])
