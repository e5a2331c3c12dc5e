"""Whether residuals hold a lens's ghost: its interference with the modelled light."""

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
    """Measured data of one plane, on pixels.

    `residual` is the recorded amplitude less the modelled one, `sigma` its standard deviation (infinite in
    pixels that tell nothing), `amplitude` the modelled one; `product` is the mean over each pixel of the
    conjugate of the modelled field times the field of a ghost that both surfaces reflect whole.
    """

    residual: Array
    sigma: Array
    amplitude: Array
    product: ComplexArray


@dataclass(frozen=True)
class FoundGhost:
    """A ghost as residuals tell it.

    Attributes
    ----------
    amplitude : complex
        Of the ghost, over that of one which both surfaces reflect whole: the share's root, with a phase that
        coatings and the lens's thickness turn.
    standard_deviation : float
        Of its real and its imaginary part, from the noise, or from the residuals where they are larger.
    over_noise : float
        Root mean square residual, the ghost taken out, over that of the noise.
    """

    amplitude: complex
    standard_deviation: float
    over_noise: float

    @property
    def share(self) -> float:
        """Estimated fraction of the light in the ghost; biased by twice the squared standard deviation."""
        return abs(self.amplitude) ** 2

    @property
    def significance(self) -> float:
        """Size over standard deviation: by chance above 3 once in 90 times, above 5 in 270,000."""
        return abs(self.amplitude) / self.standard_deviation


def ghost_in_residuals(planes: Sequence[GhostPlane]) -> FoundGhost:
    """Project residuals of all planes on the ghost's interference with the modelled light.

    A ghost of amplitude g beside a field F changes the amplitude |F| on a pixel by Re(g conj(F) G) / |F| to
    first order: two unknown numbers, found by weighted least squares. What a reconstruction has taken up of
    the ghost into its object is not in the residuals any more: the size found is a lower bound there.

    Raises
    ------
    InputError
        If shapes differ, or no pixel tells of a ghost.
    """
    normal, right, squares, count = np.zeros((2, 2)), np.zeros(2), 0.0, 0
    for number, plane in enumerate(planes, start=1):
        if len({part.shape for part in plane}) > 1:
            raise InputError(f"plane {number}: residual, sigma, amplitude and product must have one shape")
        told = np.isfinite(plane.sigma) & (plane.amplitude > 0.0)
        weight = 1.0 / plane.sigma[told]
        factor = weight * plane.product[told] / plane.amplitude[told]
        columns = np.stack([factor.real, -factor.imag])
        residual = weight * plane.residual[told]
        normal += columns @ columns.T
        right += columns @ residual
        squares += float(residual @ residual)
        count += len(residual)
    if count < 3 or not np.linalg.det(normal) > 0.0:
        raise InputError("no pixel with light tells of a ghost: it falls beside the modelled light")
    inverse = np.linalg.inv(normal)
    found = inverse @ right
    left = max(squares - float(found @ right), 0.0)
    over_noise = math.sqrt(left / (count - 2))
    deviation = max(over_noise, 1.0) * math.sqrt(0.5 * float(np.trace(inverse)))
    return FoundGhost(complex(*found), deviation, over_noise)
