"""Search of a lens's ghost in residuals, by its interference with the modelled light."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError

Array = NDArray[np.floating[Any]]
ComplexArray = NDArray[np.complexfloating[Any, Any]]


class GhostPlane(NamedTuple):
    """Residuals of one plane, and its ghost; all on pixels, shape (ny, nx).

    Attributes
    ----------
    residual : ndarray
        Recorded minus modelled amplitude.
    sigma : ndarray
        Standard deviation of the residual; infinite in pixels without information.
    amplitude : ndarray
        Modelled amplitude.
    product : ndarray of complex
        Mean over each pixel of the conjugate of the modelled field times the field of a ghost that both
        surfaces reflect completely.
    """

    residual: Array
    sigma: Array
    amplitude: Array
    product: ComplexArray


@dataclass(frozen=True)
class FoundGhost:
    """A ghost that was found in residuals.

    Attributes
    ----------
    amplitude : complex
        Amplitude of the ghost over that of a ghost that both surfaces reflect completely. Its phase depends
        on the coatings and the thickness of the lens.
    standard_deviation : float
        Standard deviation of the real part and of the imaginary part of the amplitude. It follows from the
        noise, or from the residuals where they are larger.
    over_noise : float
        Root mean square residual after removal of the ghost, over that of the noise.
    """

    amplitude: complex
    standard_deviation: float
    over_noise: float

    @property
    def power_fraction(self) -> float:
        """Estimated fraction of the light in the ghost; biased by twice the squared standard deviation."""
        return abs(self.amplitude) ** 2

    @property
    def significance(self) -> float:
        """Amplitude over standard deviation. By chance it exceeds 3 once in 90 times, 5 once in 270,000."""
        return abs(self.amplitude) / self.standard_deviation


def ghost_in_residuals(planes: Sequence[GhostPlane]) -> FoundGhost:
    """Fit the ghost's interference with the modelled light to the residuals of all planes.

    A ghost of amplitude g beside a field F changes the amplitude `|F|` of a pixel by `Re(g conj(F) G) / |F|`
    to first order. Weighted least squares give the two unknown numbers. The result is a lower bound where a
    reconstruction has already absorbed a part of the ghost in its object.

    Parameters
    ----------
    planes
        Residuals of all planes.

    Returns
    -------
    FoundGhost
        Amplitude of the ghost, and its standard deviation.

    Raises
    ------
    InputError
        If shapes differ, or no pixel has information about a ghost.
    """
    normal, right, squares, count = np.zeros((2, 2)), np.zeros(2), 0.0, 0
    for number, plane in enumerate(planes, start=1):
        if len({part.shape for part in plane}) > 1:
            raise InputError(f"plane {number}: residual, sigma, amplitude and product must have one shape")
        is_known = np.isfinite(plane.sigma) & (plane.amplitude > 0.0)
        weight = 1.0 / plane.sigma[is_known]
        factor = weight * plane.product[is_known] / plane.amplitude[is_known]
        columns = np.stack([factor.real, -factor.imag])
        residual = weight * plane.residual[is_known]
        normal += columns @ columns.T
        right += columns @ residual
        squares += float(residual @ residual)
        count += len(residual)
    if count < 3 or not np.linalg.det(normal) > 0.0:
        raise InputError("a ghost cannot be measured: it does not overlap the modelled light of any pixel")
    inverse = np.linalg.inv(normal)
    found = inverse @ right
    left = max(squares - float(found @ right), 0.0)
    over_noise = math.sqrt(left / (count - 2))
    deviation = max(over_noise, 1.0) * math.sqrt(0.5 * float(np.trace(inverse)))
    return FoundGhost(complex(*found), deviation, over_noise)
