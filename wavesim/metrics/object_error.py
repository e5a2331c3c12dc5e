"""Error of an object, from pixels that were held out of its reconstruction.

The square of a held-out residual is on average the variance of the pixel's noise, plus the square of the
error of the modelled amplitude. A lens conserves the energy of a field. An amplitude shows half of the energy
of an error of the field, the part in phase with it. The relative squared error of the object is therefore
twice that of the amplitudes. Errors that the frames do not show are not contained.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from wavesim.fields.field import Field
from wavesim.metrics.plane_residuals import Array, PlaneResidual


def held_out_error(planes: Sequence[PlaneResidual]) -> float | None:
    """Return an upper bound (95 %) of the relative L2 error of the object field; None without such pixels.

    Parameters
    ----------
    planes
        Residuals of each plane.
    """

    def joined(parts: Iterable[Array]) -> Array:
        return np.concatenate([np.asarray(part, float) for part in parts])

    error = joined(plane.error.ravel()[plane.held] for plane in planes)
    amplitude = joined(plane.amplitude.ravel()[plane.held] for plane in planes)
    sigma = joined(plane.held_sigma for plane in planes)
    is_known = np.isfinite(sigma)
    excess = (error**2 - sigma**2)[is_known]
    energy = float(np.sum(amplitude[is_known] ** 2))
    if not energy > 0.0:
        return None
    # One-sided quantile of a normal distribution at 95 %.
    quantile = 1.645
    upper = float(excess.sum()) + quantile * math.sqrt(float(np.sum(excess**2)))
    return math.sqrt(2.0 * max(upper, 0.0) / energy)


def correlation_with_error(error: float, strength: float) -> float:
    """Return the correlation (:func:`wavesim.metrics.contrast.object_correlation`) with the true object.

    Parameters
    ----------
    error
        Relative L2 error of the object field, independent of the object.
    strength
        Fraction of the field's energy that is not a multiple of the illumination (:func:`object_strength`).
    """
    return 1.0 / math.sqrt(1.0 + error**2 / strength) if strength > 0.0 else 0.0


def object_strength(transmission: Field, light: Field) -> float:
    """Return the fraction of an object field's energy that is not a multiple of the illumination."""
    behind, incident = light.values * transmission.values, light.values
    energies = [float(np.vdot(one, one).real) for one in (behind, incident)]
    if not min(energies) > 0.0:
        return 0.0
    return max(1.0 - float(abs(np.vdot(incident, behind)) ** 2) / (energies[0] * energies[1]), 0.0)
