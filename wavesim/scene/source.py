"""The light source: its angular size and bandwidth, represented by a few mutually incoherent modes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lensdesign.errors import InputError

RINGS, ANGLES, COLOURS = 2, 8, 5
"""Nodes of the quadrature over the disc of directions and the band of wavelengths. It is exact for
polynomials of the direction up to degree 7 and of the wavelength up to degree 9."""


class SourceMode(NamedTuple):
    """Light of one direction and wavelength, and its fraction of the energy."""

    weight: float
    tilt_deg: tuple[float, float]
    wavelength_um: float


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
            raise InputError(f"source width_deg = {self.width_deg!r}: must be from 0 to below 90 deg")
        if not 0.0 <= self.bandwidth_nm < math.inf:
            raise InputError(f"source bandwidth_nm = {self.bandwidth_nm!r}: must be finite, and not negative")

    def modes(self, wavelength_um: float, rings: int = RINGS, angles: int = ANGLES) -> list[SourceMode]:
        """Return directions and wavelengths whose intensities add up; their weights sum to 1.

        Parameters
        ----------
        wavelength_um
            Centre of the band.
        rings
            Number of Gauss-Legendre nodes of the squared radius.
        angles
            Number of directions on each ring.

        Raises
        ------
        InputError
            If the band reaches wavelengths of 0 or below.
        """
        half_um = 0.5e-3 * self.bandwidth_nm
        if half_um >= wavelength_um:
            raise InputError(f"source bandwidth_nm = {self.bandwidth_nm:g}: reaches wavelengths below 0")
        colours = [(1.0, wavelength_um)]
        if half_um:
            nodes, weights = np.polynomial.legendre.leggauss(COLOURS)
            colours = [
                (0.5 * weight, wavelength_um + half_um * node)
                for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True)
            ]
        directions = self._directions(rings, angles)
        return [
            SourceMode(weight * part, tilt, colour) for part, colour in colours for weight, tilt in directions
        ]

    def few_modes(self, wavelength_um: float) -> list[SourceMode]:
        """Return seven directions of one wavelength, exact for polynomials of the direction up to degree 5.

        The nodes are the centre and a hexagon: A. H. Stroud, "Approximate calculation of multiple integrals"
        (1971), S2 5-1. A point source has one mode.

        Parameters
        ----------
        wavelength_um
            Wavelength of the light.
        """
        if not self.width_deg:
            return [SourceMode(1.0, (0.0, 0.0), wavelength_um)]
        radius = 0.5 * self.width_deg * math.sqrt(2.0 / 3.0)
        angles = [math.pi * corner / 3.0 for corner in range(6)]
        ring = [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
        return [SourceMode(0.25, (0.0, 0.0), wavelength_um)] + [
            SourceMode(0.125, tilt, wavelength_um) for tilt in ring
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


POINT = Source()
"""Coherent light of one direction and wavelength."""
