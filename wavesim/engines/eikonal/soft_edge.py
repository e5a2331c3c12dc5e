"""Soft edge of the aperture for tiles of a whole field, as the mean of diffraction over a tile.

A tile of usual width is so wide that the fringes of its points differ by a period. The Fresnel integrals F(x)
of :mod:`wavesim.rays.edge_diffraction` have little more than their rise in common. A real rise
3 e^2 - 2 e^3 over the right width approximates them nearly as well, at the cost of a slightly wider
footprint.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.rays.edge_diffraction import fresnel_edge
from wavesim.rays.maps import RayMap

SOFT = 2.7
"""Width of the rise in x that minimizes the difference to F, also in the mean over a tile's points."""

FARTHEST, STEP, NODES = 60.0, 2e-3, 8
"""Largest x and step at which F is sampled, and number of points of a tile across the rim."""


def x_per_square(carrier: RayMap) -> float:
    """Return the mean derivative of x with respect to the squared relative distance to the rim."""
    assert carrier.edge is not None
    return 0.5 * float(np.mean(carrier.edge.rate * carrier.pupil.reach))


def softness(carrier: RayMap) -> float:
    """Return the rise's width in the squared relative distance to the rim; 0 where it is unknown."""
    # Largest width of the rise in the squared relative distance to the rim; rays extend to 1.1.
    softest = 0.15
    return min(SOFT / x_per_square(carrier), softest) if carrier.resolves_edge else 0.0


def soft_edge_error(carrier: RayMap, spans_mm: Array, rise: float) -> float:
    """Return the relative error of the field from one soft edge for all points of a tile, for even light.

    Parameters
    ----------
    carrier
        Ray map of a tile's centre, with its edge.
    spans_mm
        Extent of the tile, shape (2, 2).
    rise
        Width of the edge, in the squared relative distance to the rim.
    """
    edge, rim = carrier.edge, carrier.rim_mm
    assert edge is not None
    assert carrier.stop is not None
    away = rim - rim.mean(axis=0)
    turned = np.roll(away, -1, axis=0)
    parts = 0.5 * np.abs(away[:, 0] * turned[:, 1] - away[:, 1] * turned[:, 0])
    # Relative distance from the rim to the footprint's centre over which x is taken as linear.
    inward_fraction = 0.01
    inwards = carrier.pupil.inwards(carrier.stop.at(rim - inward_fraction * away)[::-1].T)
    # A relative distance s from the rim to the centre is 2 s of a sector's area.
    per_x = 2.0 * inward_fraction / (edge.rate * inwards)
    moved = 0.5 * edge.shift_per_mm * float(np.mean(np.ptp(spans_mm, axis=1)))
    lost = missed(rise * x_per_square(carrier), moved)
    return math.sqrt(min(1.0, lost * float(parts @ per_x / np.sum(parts))))


def missed(width: float, moved: float) -> float:
    """Return the integral over x of the squared difference between a moving F and a soft edge."""
    x = np.arange(-FARTHEST, FARTHEST, STEP)
    e = np.clip(0.5 + x / max(width, STEP), 0.0, 1.0)
    soft = e * e * (3.0 - 2.0 * e)
    points, weights = np.polynomial.legendre.leggauss(NODES)
    each = [np.sum(np.abs(fresnel_edge(x + moved * p) - soft) ** 2) for p in points]
    # Beyond, half of the mean of 1 / (pi x^2) to either side.
    return float(0.5 * STEP * (weights @ each) + 0.5 / (math.pi * FARTHEST))
