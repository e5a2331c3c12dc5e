"""Free space to a slightly tilted plane: a weighted sum of fields on parallel planes.

A tilt by a small angle displaces each point of a plane along nearly the axis, in proportion to its distance
from the axis of rotation. The field on the tilted plane follows from the fields on a few planes that are
shifted along this direction, by Lagrange interpolation in the displacement. Once the phase that all waves
have in common is removed, waves within some degrees of each other differ by a fraction of a radian over it.

Two successive tilts also rotate the plane about its own normal, by half their product. One further plane,
shifted within itself, accounts for this rotation. The approximation is accurate to 1e-3 while the product of
both tilts is below 7 square degrees.

The method is for light within the pixels' band, over the whole grid. For any tilt and any light, use
:mod:`wavesim.fields.tilted_samples`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.field import Grid

ComplexArray = NDArray[np.complexfloating[Any, Any]]

MOST_PLANES = 15


class TiltedPropagator:
    """Free space to a plane that is tilted about the centre of its grid, by a few degrees at most.

    The operator is linear in the field and has an exact adjoint. It omits the phase of the centre of the
    band, so that the field on the tilted plane is correct except for a phase at each point.

    Parameters
    ----------
    grid, wavelength_um, distance_mm, dtype, shift_mm
        As in :class:`wavesim.fields.plane_waves.TransferFunction`.
    tilt_deg : (x, y)
        Right-handed rotation of the second plane about x, then about the rotated y axis.

    Attributes
    ----------
    tilt_deg : (x, y)
        The given tilt.
    propagators : list of TransferFunction
        Propagators to the parallel planes.

    Raises
    ------
    InputError
        If the grid is a line, or the tilt needs more than `MOST_PLANES` planes.
    """

    is_identity = False

    def __init__(
        self,
        grid: Grid,
        wavelength_um: float,
        distance_mm: float,
        dtype: DTypeLike,
        tilt_deg: tuple[float, float],
        shift_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        if grid.is_line:
            raise InputError(f"tilt_deg = {tilt_deg}: must be 0 on a meridional line")
        rotation = rotation_matrix(*np.deg2rad(tilt_deg))
        # Displacement of a point (x, y) of the plane: along the axis it depends only on the coordinate along
        # `uphill`, the direction of steepest rise.
        moved = rotation[:, :2] - np.eye(3)[:, :2]
        uphill = moved[2] / math.hypot(*moved[2])
        level = np.array([-uphill[1], uphill[0]])
        half = np.array(grid.half_widths_mm[::-1])
        self.tilt_deg = tilt_deg
        self._grid, self._dtype = grid, np.dtype(dtype)
        self._uphill, self._level = uphill, level
        along, across = moved @ uphill, moved @ level
        reach, side = float(np.abs(uphill) @ half), float(np.abs(level) @ half)
        middle, differing = band_wavenumbers(grid, wavelength_um)
        phase = reach * (differing * abs(along[2]) + math.pi / grid.pitch_mm * math.hypot(*along[:2]))
        count = _count(phase, tilt_deg)
        self._nodes = reach * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        self._nodes[count // 2] = 0.0
        self._phasors = np.exp(-1j * middle * along[2] * self._nodes)
        displacements = [along * node for node in self._nodes]
        self._side = 0.0
        # Largest displacement, in pitches, by the rotation about the normal that is neglected.
        least_rotation = 1e-3
        if side * math.hypot(*across) > least_rotation * grid.pitch_mm:
            self._side = side
            displacements.append(across * side)
        x_mm, y_mm = shift_mm
        self.propagators = [
            TransferFunction(
                grid, wavelength_um, distance_mm + float(z), dtype, (x_mm + float(x), y_mm + float(y))
            )
            for x, y, z in displacements
        ]

    def weights(self, index: int, rows: slice, row_offset: float = 0.0) -> ComplexArray:
        """Return the weights of one parallel plane on some rows of samples, shape (rows, nx).

        `row_offset` shifts the rows along y, in samples.
        """
        height, width = self._grid.shape
        pitch_mm = self._grid.pitch_mm
        y = pitch_mm * (np.arange(rows.start, rows.stop) + row_offset - 0.5 * (height - 1))[:, None]
        x = pitch_mm * (np.arange(width) - 0.5 * (width - 1))
        sideways = (self._level[0] * x + self._level[1] * y) / self._side if self._side else 0.0
        nodes = self._nodes
        if index == len(nodes):
            return np.asarray(sideways, self._dtype)
        height_mm, own = self._uphill[0] * x + self._uphill[1] * y, nodes[index]
        weight = np.ones(height_mm.shape)
        for other in np.delete(nodes, index):
            weight *= (height_mm - other) / (own - other)
        if index == len(nodes) // 2:
            weight -= sideways
        return np.asarray(weight * self._phasors[index], self._dtype)

    def forward(self, spectrum: ComplexArray) -> ComplexArray:
        """Return the field on the second plane from its spectrum on the first."""
        total = np.zeros_like(spectrum)
        for index, propagator in enumerate(self.propagators):
            total += propagator.forward(spectrum) * self.weights(index, slice(0, len(total)))
        return total

    def adjoint(self, values: ComplexArray) -> ComplexArray:
        """Return the adjoint of :meth:`forward`, for equal weights of a spectrum and the field of it."""
        total = np.zeros_like(values)
        for index, propagator in enumerate(self.propagators):
            total += propagator.adjoint(values * self.weights(index, slice(0, len(total))).conj())
        return total


PlanePropagator = TransferFunction | TiltedPropagator


def propagator_to(
    grid: Grid,
    wavelength_um: float,
    distance_mm: float,
    dtype: DTypeLike,
    shift_mm: tuple[float, float],
    tilt_deg: tuple[float, float],
) -> PlanePropagator:
    """Return the propagator to a parallel plane, or to a tilted one where the tilt is not negligible."""
    rim_mm = math.hypot(*grid.half_widths_mm) * math.hypot(*np.deg2rad(tilt_deg))
    _, differing = band_wavenumbers(grid, wavelength_um)
    # Largest phase difference of waves at the rim, in radians, at which a plane counts as not tilted.
    level_rad = 1e-4
    if rim_mm * differing > level_rad:
        return TiltedPropagator(grid, wavelength_um, distance_mm, dtype, tilt_deg, shift_mm)
    return TransferFunction(grid, wavelength_um, distance_mm, dtype, shift_mm)


def band_wavenumbers(grid: Grid, wavelength_um: float) -> tuple[float, float]:
    """Return kz (1/mm) in the centre of the grid's band, and the largest deviation from it."""
    most = 2e3 * math.pi / wavelength_um
    least = math.sqrt(max(most**2 - 2.0 * (math.pi / grid.pitch_mm) ** 2, 0.0))
    return 0.5 * (most + least), 0.5 * (most - least)


def _count(phase: float, tilt_deg: tuple[float, float]) -> int:
    """Return the number of planes (odd, Chebyshev nodes) for waves that differ by a phase at the rim."""
    # Largest error of the band's steepest wave at the worst point; the whole field is more accurate.
    accuracy = 1e-3
    for count in range(3, MOST_PLANES + 1, 2):
        if phase**count / (math.factorial(count) * 2.0 ** (count - 1)) <= accuracy:
            return count
    raise InputError(
        f"tilt_deg = {tilt_deg}: the phase varies by {phase:.3g} rad at the sensor's edge, too much for "
        "this method; use a smaller tilt or a smaller window of the sensor"
    )
