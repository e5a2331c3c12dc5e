"""Covariance of the estimates of a joint calibration; its diagonal holds the squared standard deviations.

The object is unknown, too. Block conjugate gradients eliminate it from the effects of the parameters. With
the remaining effects D, the residuals' variances V and the prior's precision P, the estimates are
(D D' + P)^-1 D r for residuals r. Their covariance is

    (D D' + P)^-1 (D V D' + P S P) (D D' + P)^-1,

with the prior's variances S. It holds for any weights of the pixels (a sandwich estimator). Clipped noise of
dark pixels can imitate a background, which adds to the variance of backgrounds.

References
----------
H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test for
heteroskedasticity", Econometrica 48, 817 (1980).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign.common.arrays import Array
from wavesim.calibration.joint.gauss_newton_step import GaussNewtonStep
from wavesim.calibration.parameters import Background, Parameter
from wavesim.forward.linear_model import RealArray
from wavesim.metrics.goodness_of_fit import MODEL_ERROR
from wavesim.sensor.measurement import DARK, Measurement

INDEPENDENT_ERRORS = 60
"""Number of independent errors of engine and pixels. Unlike noise, they are equal in many pixels, and average
out less.
"""


def residual_variance(misfit: float, pixels: int) -> float:
    """Return the variance of the residuals that scales the prior of the estimates.

    Parameters
    ----------
    misfit
        Relative root mean square residual of the amplitudes.
    pixels
        Number of valid pixels.
    """
    return misfit**2 / pixels + MODEL_ERROR**2 / INDEPENDENT_ERRORS


def covariance_of_estimates(
    equations: GaussNewtonStep,
    parameters: Sequence[Parameter],
    recorded: Sequence[Measurement],
    effects: RealArray,
) -> Array:
    """Return the covariance of the estimates, with the prior included.

    Parameters
    ----------
    equations
        Undamped normal equations at the estimates.
    parameters
        Parameters of the equations.
    recorded
        Measured amplitudes of each plane.
    effects : ndarray, shape (parameters, pixels)
        Effects of the parameters, with the object eliminated where it is estimated, too
        (:meth:`GaussNewtonStep.eliminated`).

    Returns
    -------
    ndarray, shape (parameters, parameters)
        Covariance in the units of the parameters.
    """
    prior, curvature = np.diag(equations.prior_precision), np.asarray(effects @ effects.T, float)
    inverse = np.linalg.inv(curvature + prior)
    linear = equations.linear
    of_noise, of_pixels = (linear.residual_variances(error) for error in (0.0, MODEL_ERROR))
    if of_noise is None or of_pixels is None:  # the residuals are the only evidence of the noise
        return np.asarray(inverse * equations.variance)
    # Residuals beyond the noise are errors of the model.
    excess = max(linear.misfit**2 - float(np.sum(of_noise, dtype=float)), 0.0)
    independent = np.asarray((effects * of_pixels.ravel()) @ effects.T, float)
    # The precision of the prior is its variance's inverse, times the variance of a residual.
    scatter = independent + excess / INDEPENDENT_ERRORS * curvature + equations.variance * prior
    background = background_of_clipping(parameters, recorded)
    return np.asarray(inverse @ scatter @ inverse + np.diag(background**2))


def background_of_clipping(parameters: Sequence[Parameter], recorded: Sequence[Measurement]) -> Array:
    """Return, for each parameter, the background that clipped noise of dark pixels may imitate.

    It is 0 for parameters that are not backgrounds.
    """
    found = np.zeros(len(parameters))
    # Square of the mean root of a dark pixel's noisy intensity, clipped at 0, over its standard deviation.
    # Clipped noise looks like a background of this size.
    clipped_noise = 0.17
    for index, parameter in enumerate(parameters):
        if not isinstance(parameter, Background):
            continue
        plane = recorded[parameter.plane]
        if plane.sigma is not None:
            dark = np.min(plane.sigma[plane.amplitude == plane.amplitude.min()])
            mean = float(np.mean(plane.amplitude.astype(float) ** 2))
            found[index] = clipped_noise * 4.0 * DARK * float(dark) ** 2 / mean
    return found
