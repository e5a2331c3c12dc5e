"""Zernike polynomials in the OSA/ANSI order (ANSI Z80.28, ISO 24157).

Polynomial j has radial order n and azimuthal frequency m with j = (n (n + 2) + m) / 2::

    Z(rho, theta) = N R(rho) cos(m theta)     for m >= 0,
    Z(rho, theta) = N R(rho) sin(|m| theta)   for m < 0,

with x = rho cos(theta) and y = rho sin(theta). N = sqrt(n + 1) for m = 0, else sqrt(2 (n + 1)), so that each
polynomial has a root mean square of 1 over the unit disc. Piston is 0, the tilts along y and x are 1 and 2,
defocus is 4, the comas along y and x are 7 and 8, primary spherical aberration is 12.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.errors import InputError

HIGHEST_ORDER = 15
"""Largest radial order; finer structure is better represented by a grid."""

HIGHEST_INDEX = (HIGHEST_ORDER + 1) * (HIGHEST_ORDER + 2) // 2 - 1
"""Largest OSA/ANSI index."""


def zernike_orders(index: int) -> tuple[int, int]:
    """Return radial order n and azimuthal frequency m of the polynomial with an OSA/ANSI index.

    Raises
    ------
    InputError
        If the index is not a whole number from 0 to `HIGHEST_INDEX`.

    Examples
    --------
    >>> zernike_orders(12)
    (4, 0)
    """
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index <= HIGHEST_INDEX:
        raise InputError(
            f"Zernike index {index!r}: must be a whole number from 0 to {HIGHEST_INDEX} (OSA/ANSI order)"
        )
    n = (math.isqrt(8 * int(index) + 1) - 1) // 2
    return n, 2 * int(index) - n * (n + 2)


def zernike(index: int, rho: ArrayLike, theta: ArrayLike) -> NDArray[Any]:
    """Return a Zernike polynomial with a root mean square of 1 over the unit disc.

    Parameters
    ----------
    index
        OSA/ANSI index.
    rho, theta
        Radius relative to that of the disc, and angle from x towards y in radians; broadcast together.

    Returns
    -------
    ndarray
        Values of the polynomial, dimensionless.

    Raises
    ------
    InputError
        If there is no such index.

    Examples
    --------
    >>> round(float(zernike(4, 1.0, 0.0)), 4)
    1.7321
    """
    n, m = zernike_orders(index)
    norm = math.sqrt((n + 1) * (1 if m == 0 else 2))
    angle = np.asarray(theta) * abs(m)
    return np.asarray(
        norm * _radial(n, abs(m), np.asarray(rho)) * (np.cos(angle) if m >= 0 else np.sin(angle))
    )


def _radial(n: int, m: int, rho: NDArray[Any]) -> NDArray[Any]:
    """Return the radial polynomial by Horner's rule in rho^2."""
    square, result = rho * rho, np.zeros_like(rho)
    for k in range((n - m) // 2 + 1):
        factor = math.comb(n - k, k) * math.comb(n - 2 * k, (n - m) // 2 - k)
        result = result * square + (-1) ** k * factor
    return np.asarray(result * rho**m)
