"""The source of the light: how wide and how coloured it is, as a few modes that do not interfere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lensdesign.errors import InputError

RINGS, ANGLES, COLOURS = 2, 8, 5
"""Directions on a disc, and wavelengths, by which light is added up: polynomials of the direction are right
up to the degree 7, of the wavelength up to 9."""


class SourceMode(NamedTuple):
    """Light of one direction and wavelength, and its share of the energy."""

    share: float
    tilt_deg: tuple[float, float]
    wavelength_um: float


@dataclass(frozen=True)
class Source:
    """An even disc of directions, and an even band of wavelengths about that of the light.

    Attributes
    ----------
    width_deg : float
        Diameter of the source, as the object sees it.
    bandwidth_nm : float
        Of its light, from end to end.

    Raises
    ------
    InputError
        If one is negative or too large.
    """

    width_deg: float = 0.0
    bandwidth_nm: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.width_deg < 90.0:
            raise InputError(f"source width_deg = {self.width_deg!r}: must be from 0 to below 90 deg")
        if not 0.0 <= self.bandwidth_nm < math.inf:
            raise InputError(f"source bandwidth_nm = {self.bandwidth_nm!r}: must be finite, and not negative")

    def modes(self, wavelength_um: float, rings: int = RINGS, angles: int = ANGLES) -> list[SourceMode]:
        """Directions and wavelengths whose intensities add up, with shares whose sum is 1.

        Parameters
        ----------
        wavelength_um
            In the middle of the band.
        rings, angles
            Gauss-Legendre nodes of the squared radius, and directions on each of them.

        Raises
        ------
        InputError
            If the band reaches down to 0.
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
            SourceMode(share * part, tilt, colour) for part, colour in colours for share, tilt in directions
        ]

    def few_modes(self, wavelength_um: float) -> list[SourceMode]:
        """Seven directions of one wavelength, right for polynomials of the direction up to the degree 5.

        The middle and a hexagon: A. H. Stroud, "Approximate calculation of multiple integrals" (1971),
        S2 5-1. A point source is one mode.

        Parameters
        ----------
        wavelength_um
            Of the light.
        """
        if not self.width_deg:
            return [SourceMode(1.0, (0.0, 0.0), wavelength_um)]
        radius = 0.5 * self.width_deg * math.sqrt(2.0 / 3.0)
        angles = [math.pi * place / 3.0 for place in range(6)]
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
            for place in range(angles):
                angle = 2.0 * math.pi * (place + 0.5 * (ring % 2)) / angles
                found.append((0.5 * weight / angles, (radius * math.cos(angle), radius * math.sin(angle))))
        return found


POINT = Source()
"""Coherent light."""
