"""Free space to a plane that is tilted a little: a sum of ways to parallel planes.

A tilt by a small angle takes each point of a plane along one direction, nearly the axis, by as much as the
point is from the line about which the plane turns. The field there follows from those on a few planes that
are moved along that direction, by Lagrange's polynomials of the distance: once the phase that all light has
in common is out, waves within some degrees differ by a part of a radian over it. Two tilts one after the
other turn the plane about its own normal, too, by half their product: one more plane, moved along itself.
That is right to 1e-3 while the product of both tilts is below 7 square degrees.

For light that keeps to the pixels' band, over the whole grid; any tilt, and any light, take
:mod:`wavesim.fields.tilted_samples`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import TransferFunction

ComplexArray = NDArray[np.complexfloating[Any, Any]]

ACCURACY = 1e-3
"""Of the steepest wave of the grid's band, at the worst point: the light as a whole does far better."""
LEVEL = 1e-4
"""Radians by which waves differ at the rim of a plane that is taken for upright."""
MOST_PLANES = 15
LEAST_TURN = 1e-3
"""Of a pitch: how far a turn about the plane's own normal may move a sample without a plane for it."""


class TiltedPropagator:
    """Free space to a plane that is tilted about the middle of its grid, by a few degrees at most.

    Linear in the field, and with an exact adjoint; the phase of the middle of the band is left out, so that
    the field on the tilted plane is known but for a phase at each point.

    Parameters
    ----------
    grid, wavelength_um, distance_mm, dtype, shift_mm
        As of :class:`wavesim.fields.plane_waves.TransferFunction`.
    tilt_deg : (x, y)
        Right-handed rotation of the second plane about x, then about the y axis that turned with it.

    Attributes
    ----------
    tilt_deg : (x, y)
        As given.
    ways : list of PlaneWay
        To the parallel planes.

    Raises
    ------
    InputError
        If the grid is a line, or the tilt takes more than `MOST_PLANES` planes.
    """

    is_none = False

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
            raise InputError(f"tilt_deg = {tilt_deg}: a meridional line has no tilted sensor")
        turned = rotation_matrix(*np.deg2rad(tilt_deg))
        # How far a point (x, y) of the plane goes: all of it along the axis by what it is along `uphill`.
        moved = turned[:, :2] - np.eye(3)[:, :2]
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
        self._turns = np.exp(-1j * middle * along[2] * self._nodes)
        places = [along * node for node in self._nodes]
        self._side = 0.0
        if side * math.hypot(*across) > LEAST_TURN * grid.pitch_mm:
            self._side = side
            places.append(across * side)
        x_mm, y_mm = shift_mm
        self.ways = [
            TransferFunction(
                grid, wavelength_um, distance_mm + float(z), dtype, (x_mm + float(x), y_mm + float(y))
            )
            for x, y, z in places
        ]

    def weights(self, number: int, rows: slice, farther: float = 0.0) -> ComplexArray:
        """Of one of the ways, on some rows of samples, shape (rows, nx).

        `farther`: by how many samples the rows lie farther up.
        """
        height, width = self._grid.shape
        pitch_mm = self._grid.pitch_mm
        y = pitch_mm * (np.arange(rows.start, rows.stop) + farther - 0.5 * (height - 1))[:, None]
        x = pitch_mm * (np.arange(width) - 0.5 * (width - 1))
        sideways = (self._level[0] * x + self._level[1] * y) / self._side if self._side else 0.0
        nodes = self._nodes
        if number == len(nodes):
            return np.asarray(sideways, self._dtype)
        there, own = self._uphill[0] * x + self._uphill[1] * y, nodes[number]
        weight = np.ones(there.shape)
        for other in np.delete(nodes, number):
            weight *= (there - other) / (own - other)
        if number == len(nodes) // 2:
            weight -= sideways
        return np.asarray(weight * self._turns[number], self._dtype)

    def there(self, spectrum: ComplexArray) -> ComplexArray:
        """The field on the second plane, from its spectrum on the first."""
        total = np.zeros_like(spectrum)
        for number, way in enumerate(self.ways):
            total += way.there(spectrum) * self.weights(number, slice(0, len(total)))
        return total

    def back(self, values: ComplexArray) -> ComplexArray:
        """The adjoint of :meth:`there`, where a spectrum counts as much as the field that it makes."""
        total = np.zeros_like(values)
        for number, way in enumerate(self.ways):
            total += way.back(values * self.weights(number, slice(0, len(total))).conj())
        return total


Way = TransferFunction | TiltedPropagator


def propagator_to(
    grid: Grid,
    wavelength_um: float,
    distance_mm: float,
    dtype: DTypeLike,
    shift_mm: tuple[float, float],
    tilt_deg: tuple[float, float],
) -> Way:
    """Free space to a parallel plane, or to one that is tilted, by enough for its rim to see it."""
    rim_mm = math.hypot(*grid.half_widths_mm) * math.hypot(*np.deg2rad(tilt_deg))
    _, differing = band_wavenumbers(grid, wavelength_um)
    if rim_mm * differing > LEVEL:
        return TiltedPropagator(grid, wavelength_um, distance_mm, dtype, tilt_deg, shift_mm)
    return TransferFunction(grid, wavelength_um, distance_mm, dtype, shift_mm)


def band_wavenumbers(grid: Grid, wavelength_um: float) -> tuple[float, float]:
    """kz (1/mm) in the middle of what the grid's samples hold, and how much others differ from it."""
    most = 2e3 * math.pi / wavelength_um
    least = math.sqrt(max(most**2 - 2.0 * (math.pi / grid.pitch_mm) ** 2, 0.0))
    return 0.5 * (most + least), 0.5 * (most - least)


def _count(phase: float, tilt_deg: tuple[float, float]) -> int:
    """Of planes, at Chebyshev's points, from whose middle waves turn by so much; odd, to have one there."""
    for count in range(3, MOST_PLANES + 1, 2):
        if phase**count / (math.factorial(count) * 2.0 ** (count - 1)) <= ACCURACY:
            return count
    raise InputError(
        f"tilt_deg = {tilt_deg}: the sensor's rim is {phase:.3g} rad out of the plane: too much for a sensor "
        "that is nearly upright; tilt it less, or take a smaller window of it"
    )
