"""The light source: its angular size and bandwidth, represented by a few mutually incoherent modes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lensdesign.errors import InputError
from wavesim.fields.field import Field
from wavesim.scene.light_errors import LightErrors

RINGS, ANGLES = 2, 8
"""Nodes of the quadrature over the disc of directions; exact for polynomials up to degree 7."""

LEAST_COLOURS, FEW_COLOURS, SPECKLES_PER_COLOUR = 5, 3, 0.375
"""Least number of wavelengths, that of few modes, and number of speckles for which there is one more.

From one end of the band to the other, the picture of the steepest light shifts by some speckles.
"""


class SourceMode(NamedTuple):
    """Light of one direction and wavelength, and its fraction of the energy.

    For light with a polarization a mode is one component of the field behind the lens.
    """

    weight: float
    tilt_deg: tuple[float, float]
    wavelength_um: float
    component: int | None = None

    def on(self, light: Field) -> Field:
        """Return light of this direction and wavelength, given that of the middle of the source.

        The weight is not applied.
        """
        return replace(LightErrors(self.tilt_deg).on(light), wavelength_um=self.wavelength_um)


class SourceChanges(NamedTuple):
    """Factors of the intensities of modes that give the change of their mean with the source.

    Attributes
    ----------
    by_squared_width : tuple of float
        Factors per squared angular width in deg^2.
    by_squared_bandwidth : tuple of float
        Factors per squared bandwidth in nm^2.
    """

    by_squared_width: tuple[float, ...]
    by_squared_bandwidth: tuple[float, ...]


@dataclass(frozen=True)
class Source:
    """An even disc of directions, and an even band of wavelengths about the light's wavelength.

    Attributes
    ----------
    width_deg : float
        Angular diameter of the source, seen from the object.
    bandwidth_nm : float
        Full width of its spectrum.

    Raises
    ------
    InputError
        If a value is negative or too large.
    """

    width_deg: float = 0.0
    bandwidth_nm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.width_deg < 90.0:
            raise InputError(f"source width_deg = {self.width_deg!r}: must be from 0 to below 90°")
        if not 0.0 <= self.bandwidth_nm < math.inf:
            raise InputError(f"source bandwidth_nm = {self.bandwidth_nm!r}: must be finite, and not negative")

    def lines(self, deviations: Mapping[str, float]) -> list[str]:
        """Return sentences that state the widths, with their standard deviations where these are given.

        Parameters
        ----------
        deviations
            Standard deviations by the name of the width. For a width of 0 it is the largest width that
            is possible.
        """
        rows = [
            ("width_deg", "diameter of the light source", "°"),
            ("bandwidth_nm", "bandwidth of the light", " nm"),
        ]
        lines = []
        for name, what, unit in rows:
            width, deviation = getattr(self, name), deviations.get(name)
            if width:
                text = "" if deviation is None else f" ± {deviation:.2g}{unit}"
                lines.append(f"{what} {width:.3g}{unit}{text}")
            elif deviation is not None:
                lines.append(f"{what} 0{unit}, at most {deviation:.2g}{unit}")
        return lines

    def modes(
        self, wavelength_um: float, rings: int = RINGS, angles: int = ANGLES, *, samples: int = 1
    ) -> list[SourceMode]:
        """Return directions and wavelengths whose intensities add up; their weights sum to 1.

        Parameters
        ----------
        wavelength_um
            Centre of the band.
        rings
            Number of Gauss-Legendre nodes of the squared radius.
        angles
            Number of directions on each ring.
        samples
            Number of samples across the object grid, which determines the number of wavelengths.

        Raises
        ------
        InputError
            If the band reaches wavelengths of 0 or below.
        """
        directions = self._directions(rings, angles)
        return self._modes(directions, LEAST_COLOURS, wavelength_um, samples)

    def few_modes(self, wavelength_um: float, *, samples: int = 1) -> list[SourceMode]:
        """Return at most seven directions, and from three wavelengths on; exact up to degree 5.

        The directions are the centre and a hexagon: A. H. Stroud, "Approximate calculation of multiple
        integrals" (1971), S2 5-1. A coherent source has one mode.

        Parameters
        ----------
        wavelength_um
            Centre of the band.
        samples
            Number of samples across the object grid, which determines the number of wavelengths.

        Raises
        ------
        InputError
            If the band reaches wavelengths of 0 or below.
        """
        directions = [(1.0, (0.0, 0.0))]
        if self.width_deg:
            radius = 0.5 * self.width_deg * math.sqrt(2.0 / 3.0)
            angles = [math.pi * corner / 3.0 for corner in range(6)]
            ring = [(0.125, (radius * math.cos(angle), radius * math.sin(angle))) for angle in angles]
            directions = [(0.25, (0.0, 0.0)), *ring]
        return self._modes(directions, FEW_COLOURS, wavelength_um, samples)

    def few_mode_changes(self, wavelength_um: float, *, samples: int = 1) -> SourceChanges:
        """Return how a sum over the modes of :meth:`few_modes` changes with the source.

        Parameters
        ----------
        wavelength_um, samples
            See :meth:`few_modes`.

        Returns
        -------
        SourceChanges
            Factors of the intensities of the modes, in their order. Their sum is the change of the mean
            intensity; it is 0 for a parameter of the source that is 0.
        """
        directions = 1 if not self.width_deg else 7
        modes = self.few_modes(wavelength_um, samples=samples)
        weights = np.array([mode.weight for mode in modes]).reshape(-1, directions)
        by_width, by_band = np.zeros_like(weights), np.zeros_like(weights)
        if self.width_deg:
            # Mean over the disc of an intensity that is quadratic in the direction.
            band = weights.sum(1)[:, None]
            by_width = band * np.array([-0.75, *6 * (0.125,)]) / self.width_deg**2
        if self.bandwidth_nm:
            # Derivative of the mean of each Legendre polynomial over the band by its squared width.
            colours = len(weights)
            nodes = np.polynomial.legendre.leggauss(colours)[0]
            factors = [0.5 * (2 * j + 1) * (j % 2 == 0 < j) for j in range(colours)]
            series = np.polynomial.legendre.legval(nodes, factors)
            by_band = weights * series[:, None] / self.bandwidth_nm**2
        return SourceChanges(tuple(by_width.ravel().tolist()), tuple(by_band.ravel().tolist()))

    def _modes(
        self,
        directions: list[tuple[float, tuple[float, float]]],
        least_colours: int,
        wavelength_um: float,
        samples: int,
    ) -> list[SourceMode]:
        half_um = 0.5e-3 * self.bandwidth_nm
        if half_um >= wavelength_um:
            raise InputError(f"source bandwidth_nm = {self.bandwidth_nm:g}: reaches wavelengths below 0")
        band = [(1.0, wavelength_um)]
        if half_um:
            # Always an odd number, so that the centre of the band, which has an engine already, is one.
            speckles = 0.5 * samples * self.bandwidth_nm / (1e3 * wavelength_um)
            colours = least_colours + 2 * int(0.5 * speckles / SPECKLES_PER_COLOUR)
            nodes, weights = np.polynomial.legendre.leggauss(colours)
            band = [
                (0.5 * weight, wavelength_um + half_um * node)
                for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True)
            ]
        return [
            SourceMode(weight * part, tilt, colour) for part, colour in band for weight, tilt in directions
        ]

    def _directions(self, rings: int, angles: int) -> list[tuple[float, tuple[float, float]]]:
        if not self.width_deg:
            return [(1.0, (0.0, 0.0))]
        nodes, weights = np.polynomial.legendre.leggauss(rings)
        found = []
        for ring, (node, weight) in enumerate(zip(nodes.tolist(), weights.tolist(), strict=True)):
            radius = 0.5 * self.width_deg * math.sqrt(0.5 * (1.0 + node))
            for step in range(angles):
                angle = 2.0 * math.pi * (step + 0.5 * (ring % 2)) / angles
                found.append((0.5 * weight / angles, (radius * math.cos(angle), radius * math.sin(angle))))
        return found


def with_components(modes: Sequence[SourceMode], components: int) -> list[SourceMode]:
    """Return every mode once for each component of the field behind the lens; their intensities add up."""
    if components == 1:
        return list(modes)
    return [mode._replace(component=index) for mode in modes for index in range(components)]


POINT = Source()
"""Coherent light of one direction and wavelength."""
