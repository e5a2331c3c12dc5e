"""The aperture's edge of tiles of a whole field: soft, as diffraction would have it in the mean.

A tile of usual width is so wide that its points' edges differ by a fringe: of the Fresnel integral F(x) of
:mod:`wavesim.rays.edges` little but the rise is common to them. A real rise 3 e^2 - 2 e^3 over the right
width comes nearly as near to it, for the strip by which it widens the footprint.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.rays.edges import fresnel_edge
from wavesim.rays.maps import RayMap

SOFT = 2.7
"""Width of the rise in x: with it the difference to F is least, in the mean over a tile's points too."""

SOFTEST = 0.15
"""Most of the square of the share of the way to the rim that the rise may take: rays are followed to 1.1."""

FARTHEST, STEP, NODES = 60.0, 2e-3, 8
"""x up to which F is looked at, and how densely; points of a tile across the rim."""

INWARDS = 0.01
"""Of the way from the rim to the middle of the footprint, over which x is told to grow evenly."""


def x_per_square(carrier: RayMap) -> float:
    """How much x grows by for the square of the share of the way to the rim, in the mean over it."""
    assert carrier.edge is not None
    return 0.5 * float(np.mean(carrier.edge.rate * carrier.pupil.reach))


def softness(carrier: RayMap) -> float:
    """Of the square of the share of the way to the rim, what the rise takes; 0 where rays do not tell."""
    return min(SOFT / x_per_square(carrier), SOFTEST) if carrier.resolves_edge else 0.0


def soft_edge_error(carrier: RayMap, spans_mm: Array, rise: float) -> float:
    """Relative error of the field from one soft edge for all points of a tile, light taken for even.

    Parameters
    ----------
    carrier
        Of a tile's centre; its edge must be told.
    spans_mm
        From where to where the tile extends, shape (2, 2).
    rise
        Width of the edge, in the square of the share of the way to the rim.
    """
    edge, rim = carrier.edge, carrier.rim_mm
    assert edge is not None
    assert carrier.stop is not None
    away = rim - rim.mean(axis=0)
    turned = np.roll(away, -1, axis=0)
    parts = 0.5 * np.abs(away[:, 0] * turned[:, 1] - away[:, 1] * turned[:, 0])
    inwards = carrier.pupil.inwards(carrier.stop.at(rim - INWARDS * away)[::-1].T)
    # A share s of the way to the middle is 2 s of a sector's area.
    per_x = 2.0 * INWARDS / (edge.rate * inwards)
    moved = 0.5 * edge.shift_per_mm * float(np.mean(np.ptp(spans_mm, axis=1)))
    lost = missed(rise * x_per_square(carrier), moved)
    return math.sqrt(min(1.0, lost * float(parts @ per_x / np.sum(parts))))


def missed(width: float, moved: float) -> float:
    """Integral over x of the squared difference between F, which moves over some x, and a soft edge."""
    x = np.arange(-FARTHEST, FARTHEST, STEP)
    e = np.clip(0.5 + x / max(width, STEP), 0.0, 1.0)
    soft = e * e * (3.0 - 2.0 * e)
    points, weights = np.polynomial.legendre.leggauss(NODES)
    each = [np.sum(np.abs(fresnel_edge(x + moved * p) - soft) ** 2) for p in points]
    # Beyond, half of the mean of 1 / (pi x^2) to either side.
    return float(0.5 * STEP * (weights @ each) + 0.5 / (math.pi * FARTHEST))
