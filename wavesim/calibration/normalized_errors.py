"""Test stated covariances of calibrations against true errors along independent directions.

A normalized error is an error over its stated standard deviation. Parameters of one bench have strongly
correlated errors, and an estimate is a compromise between the frames and the prior. Both spoil the root mean
square of the normalized errors of single parameters. First, correlated errors count one fluctuation many
times. Second, a true value that is nominal agrees with the prior better than the prior claims, because the
stated deviation is right on average over true values that are drawn from the prior.

Let the frames have the precision :math:`F`, and the prior the precision 1, in units of the prior's standard
deviations. The stated covariance is :math:`C = (F + 1)^{-1}`, and the estimate is :math:`m = C F d`, where
:math:`d` is the estimate from the frames alone. Where :math:`C` has the eigenvalue :math:`v`, the frames have
the precision :math:`(1 - v) / v`. So :math:`d = m / (1 - v)`, with the standard deviation
:math:`\\sqrt{v / (1 - v)}`. For a nominal true value the error :math:`m` has the variance :math:`v (1 - v)`,
and not :math:`v`: it is small by construction where the frames contain little information. The normalized
error of :math:`d` has variance 1 for every true value. Directions in which the frames are less precise than
the prior are excluded, because the division by :math:`1 - v` would magnify numerical errors.
"""

from __future__ import annotations

import numpy as np

from lensdesign.common.arrays import Array


def normalized_errors(
    estimates: Array, covariance: Array, prior_deviations: Array, true_values: Array | None = None
) -> Array:
    """Return the normalized errors of an estimate along the independent directions that the data determine.

    Parameters
    ----------
    estimates : ndarray, shape (n,)
        Most probable differences from nominal, given data and prior.
    covariance : ndarray, shape (n, n)
        Stated covariance of the estimates, with the prior included.
    prior_deviations : ndarray, shape (n,)
        Standard deviations of the prior, whose mean is 0.
    true_values : ndarray, shape (n,), optional
        True differences from nominal; default: 0.

    Returns
    -------
    ndarray
        One value for each direction, the best determined first. They are independent, with mean 0 and
        variance 1, where the covariance is right. With k of them the root mean square has a standard
        deviation of about 1 / sqrt(2 k).
    """
    true = np.zeros(len(estimates)) if true_values is None else true_values
    variances, directions = np.linalg.eigh(covariance / np.outer(prior_deviations, prior_deviations))
    # Posterior over prior variance, up to which the frames are more precise than the prior.
    largest_variance = 0.5
    determined = (variances > 0.0) & (variances <= largest_variance)
    variances, directions = variances[determined], directions[:, determined]
    by_data = directions.T @ (estimates / prior_deviations) / (1.0 - variances)
    errors = by_data - directions.T @ (true / prior_deviations)
    return np.asarray(errors / np.sqrt(variances / (1.0 - variances)), float)
