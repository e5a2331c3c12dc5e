"""Reconstruction loss of drawn lenses as a function of their deviations, fast enough for an allocation.

The predicted loss of a lens (:mod:`tolerancing.prediction.reconstruction_loss`) takes some 20 ms, and an
allocation needs it for thousands of lenses at each of some hundred points. The loss is a function of the
change of path on each meridian, which is linear in the deviations. Of these changes only a few combinations
matter: those along which the loss has slopes (an active subspace, Constantine 2015). On each meridian, a
quadratic function of these combinations is fitted to lenses whose losses are predicted. It describes
1 / r^2 - 1 for a mean correlation r: the power of the errors of a reconstruction, relative to that of its
object, if they are uncorrelated with the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.prediction.reconstruction_loss import (
    LossPaths,
    calibration_equations,
    loss_model,
    loss_paths,
)
from tolerancing.study.study import Study
from wavesim.pupil.batched_reconstruction import BatchedReconstruction

DIRECTIONS = 6
"""Number of combinations of path changes of a meridian: with 6 to 22, fits to 800 lenses are equally good."""

FITTED_LENSES = 400
"""Lenses to which a meridian is fitted: 14 for each of the 28 coefficients."""


@dataclass(frozen=True, eq=False)
class _Meridian:
    """Quadratic function of a few combinations of the amounts of all changes.

    Attributes
    ----------
    combinations : ndarray, shape (amounts, directions)
    constant, linear, square
        Coefficients of shapes (), (directions,) and (directions, directions).
    """

    combinations: Array
    constant: float
    linear: Array
    square: Array

    def values(self, amounts: Array) -> tuple[Array, Array]:
        """Return 1 / r^2 - 1 of each lens, and its derivatives by the combinations."""
        x = amounts @ self.combinations
        product = x @ self.square
        return self.constant + np.sum((self.linear + product) * x, axis=1), self.linear + 2.0 * product


@dataclass(frozen=True, eq=False)
class LossSurface:
    """Score of a merit `reconstruction_loss` as a function of the amounts of all changes of a lens.

    Attributes
    ----------
    points
        The fitted meridians of each object point; the point with the largest loss counts.
    """

    points: tuple[tuple[_Meridian, ...], ...]

    def scores(self, amounts: Array) -> Array:
        """Return the losses, shape (n,)."""
        totals = [sum(one.values(amounts)[0] for one in meridians) for meridians in self.points]
        return np.asarray(_losses_of(np.array(totals)).max(axis=0))

    def slopes(self, amounts: Array) -> tuple[Array, Array]:
        """Return the losses, shape (n,), and their derivatives by the amounts, shape (n, amounts)."""
        found = [[one.values(amounts) for one in meridians] for meridians in self.points]
        totals = np.array([sum(values for values, _ in own) for own in found])
        losses, by = _losses_of(totals), np.empty_like(amounts)
        worst, rows = np.argmax(losses, axis=0), np.arange(len(amounts))
        for k, (meridians, own) in enumerate(zip(self.points, found, strict=True)):
            lenses = worst == k
            total = totals[k, lenses]
            slope = np.where(total > 0.0, 0.5 * (1.0 + np.maximum(total, 0.0)) ** -1.5, 0.0)
            by[lenses] = slope[:, None] * sum(
                one_by[lenses] @ one.combinations.T for one, (_, one_by) in zip(meridians, own, strict=True)
            )
        return losses[worst, rows], by


def _losses_of(totals: Array) -> Array:
    """Return the losses for sums of 1 / r^2 - 1 over the meridians."""
    return np.asarray(1.0 - (1.0 + np.maximum(totals, 0.0)) ** -0.5)


def fit_loss_surface(lens: Lens, study: Study, merit: ReconstructionLoss, amounts: Array) -> LossSurface:
    """Fit the loss of lenses as built to predicted losses.

    Parameters
    ----------
    lens, study, merit
        The nominal lens, its perturbations and compensators, and the merit. Compensators respond to first
        order, without limits.
    amounts : ndarray, shape (n, amounts)
        Amounts of all changes in lenses that cover the tolerances of interest.

    Raises
    ------
    InputError
        If rays of a line do not pass, or the lens does not have a perturbed parameter.
    """
    model, paths = loss_model(lens, merit), loss_paths(lens, study, merit)
    follow = _followed(paths, model.points)
    return LossSurface(
        tuple(
            tuple(
                _fitted(one, by, amounts, merit.limit) for one, by in zip(reconstructions, own, strict=True)
            )
            for reconstructions, own in zip(model.points, follow, strict=True)
        )
    )


def _followed(paths: LossPaths, points: tuple[tuple[BatchedReconstruction, ...], ...]) -> Array:
    """Return the path change by a unit of each change, with compensators that follow it."""
    if not paths.model.shape[-1]:
        return paths.lens
    found = np.array(paths.lens)
    for k, reconstructions in enumerate(points):
        matrix, across = calibration_equations(reconstructions, paths.lens[k], paths.model[k])
        found[k] -= paths.model[k] @ (np.linalg.pinv(matrix, rcond=1e-9, hermitian=True) @ across)
    return found


def _fitted(one: BatchedReconstruction, by: Array, amounts: Array, limit: float) -> _Meridian:
    """Return the function of a meridian, most accurate where the loss is about as large as its limit."""
    coefficients = amounts @ by.T
    correlations, slopes = one.correlations(coefficients, derivatives=True)
    values = correlations**-2 - 1.0
    weights = 1.0 / (values + (1.0 - limit) ** -2 - 1.0)
    scale = coefficients.std(axis=0) + np.finfo(float).tiny
    gradients = (-2.0 * weights * correlations**-3)[:, None] * slopes * scale
    directions = np.linalg.svd(gradients, full_matrices=False)[2][:DIRECTIONS]
    combinations = by.T @ (directions / scale).T
    x = amounts @ combinations
    first, second = np.triu_indices(x.shape[1])
    terms = np.concatenate([np.ones((len(x), 1)), x, x[:, first] * x[:, second]], axis=1) * weights[:, None]
    sizes = np.sqrt(np.mean(terms**2, axis=0)) + np.finfo(float).tiny
    scaled = terms / sizes
    penalty = 1e-6 * len(x) * np.eye(terms.shape[1])
    found = np.linalg.solve(scaled.T @ scaled + penalty, scaled.T @ (values * weights)) / sizes
    square = np.zeros((x.shape[1],) * 2)
    square[first, second] = found[1 + x.shape[1] :]
    return _Meridian(combinations, float(found[0]), found[1 : 1 + x.shape[1]], 0.5 * (square + square.T))
