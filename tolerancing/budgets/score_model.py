"""Scores of drawn lenses as functions of the scales of a study's tolerances, with derivatives.

Wavefront and ray merits follow to first order from the derivatives of the nominal lens's rays
(:mod:`tolerancing.prediction`), and losses of reconstructions from :mod:`tolerancing.budgets.loss_surface`.
Other merits follow from a response surface fitted to trials. The residuals of the fit are its scatter: they
are of higher order in the deviations, and shrink with the deviations on which the merit depends. Trials of
the lens itself correct the errors of the model (:mod:`tolerancing.budgets.study_budget`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.budgets.loss_surface import FITTED_LENSES, fit_loss_surface
from tolerancing.merits.base import Merit, all_passed
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import RmsWaves, Strehl
from tolerancing.merits.rays import FootprintRadius, LargestSpread
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.sensor_ray_derivatives import ArrivalDifferentials, arrival_differentials
from tolerancing.prediction.system import amounts_of, columns_of
from tolerancing.prediction.wavefront_prediction import (
    WavefrontLimit,
    drawn_batch,
    first_order,
    is_predicted_wavefront,
    study_derivatives,
)
from tolerancing.statistics.response import Response, fit_response
from tolerancing.study.study import Study

PROBES, PROBE_SCALES, EXTREME_RAYS = 512, (0.5, 1.0, 2.0), 3
"""Number of probe lenses, scales of their deviations, and number of longest rays retained for each probe."""


@dataclass(frozen=True)
class _Region:
    """Factors of the deviations of lenses to which losses are fitted.

    The common factor is between `low` and `high`. Each tolerance has another one, whose logarithm has the
    standard deviation `own_spread`.
    """

    low: float
    high: float
    own_spread: float


AROUND_STUDY, AROUND_BUDGET = _Region(0.25, 1.2, 0.5), _Region(0.7, 1.4, 0.2)
"""Regions about the tolerances of the study, and about those that a search has found."""

POOR_FIT, SELDOM = 0.5, 0.01
"""A response surface that explains less of the variance of new trials is poor; merits that fewer
trials miss, among those that keep all predicted limits, need none that is better."""


class _MeritModel(Protocol):
    """Score of one merit as a function of the amounts of each change, shape (n, c)."""

    def scores(self, amounts: Array) -> Array:
        """Return the scores, shape (n,)."""

    def slopes(self, amounts: Array) -> tuple[Array, Array]:
        """Return the scores, shape (n,), and their derivatives by the amounts, shape (n, c)."""


@dataclass(frozen=True, eq=False)
class _Wavefront:
    """Model of a wavefront merit: the quadratic form of its mean square at each field point."""

    forms: tuple[Array, ...]
    is_strehl: bool

    def scores(self, amounts: Array) -> Array:
        return self.slopes(amounts, derivatives=False)[0]

    def slopes(self, amounts: Array, derivatives: bool = True) -> tuple[Array, Array]:
        products = [amounts @ form for form in self.forms]
        squares = np.stack([np.sum(product * amounts, axis=1) for product in products])
        worst = np.argmax(squares, axis=0)
        square = np.maximum(squares[worst, np.arange(len(amounts))], np.finfo(float).tiny)
        by = np.zeros_like(amounts)
        for index, product in enumerate(products if derivatives else ()):
            own = worst == index
            by[own] = 2.0 * product[own]
        if self.is_strehl:
            strehl = np.exp(-((2.0 * np.pi) ** 2) * square)
            return strehl, -((2.0 * np.pi) ** 2) * strehl[:, None] * by
        rms = np.sqrt(square)
        return rms, by / (2.0 * rms[:, None])


@dataclass(frozen=True, eq=False)
class _ExtremeRay:
    """Model of a ray merit: the longest of vectors that are linear in the amounts (sines or positions)."""

    nominal: Array
    by: Array
    is_sine: bool

    def scores(self, amounts: Array) -> Array:
        return self.slopes(amounts, derivatives=False)[0]

    def slopes(self, amounts: Array, derivatives: bool = True) -> tuple[Array, Array]:
        # Number of lenses whose rays are computed at one time, which limits memory.
        block = 512
        found = [
            self._block(amounts[start : start + block], derivatives)
            for start in range(0, len(amounts), block)
        ]
        values, by = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if not self.is_sine:
            return values, by
        cosine = np.sqrt(np.maximum(1.0 - values**2, 1e-12))
        return np.rad2deg(np.arcsin(np.minimum(values, 1.0))), np.rad2deg(by / cosine[:, None])

    def _block(self, amounts: Array, derivatives: bool) -> tuple[Array, Array]:
        vectors = self.vectors(amounts)
        squares = vectors[..., 0] ** 2 + vectors[..., 1] ** 2
        longest, rows = np.argmax(squares, axis=1), np.arange(len(amounts))
        values = np.sqrt(squares[rows, longest])
        if not derivatives:
            return values, np.zeros_like(amounts)
        along = vectors[rows, longest] / values[:, None]
        return values, np.einsum("na,nac->nc", along, self.by[longest])

    def vectors(self, amounts: Array) -> Array:
        """Return the vectors of all rays, shape (n, rays, 2)."""
        change = amounts @ self.by.reshape(-1, amounts.shape[1]).T
        return self.nominal + change.reshape(-1, *self.nominal.shape)

    def of_possible_extremes(self, amounts: Array) -> _ExtremeRay:
        """Return the model restricted to rays that are among the longest of some lens."""
        vectors = self.vectors(amounts)
        lengths = np.hypot(vectors[..., 0], vectors[..., 1])
        retained = np.unique(np.argsort(lengths, axis=1)[:, -EXTREME_RAYS:])
        return replace(self, nominal=self.nominal[retained], by=self.by[retained])


class StudyScoreModel:
    """Scores of a study's merits for scaled tolerances; implements the ScoreModel of a tolerance search.

    Parameters
    ----------
    lens
        The nominal lens.
    study
        The study with perturbations and merits.
    values, scores
        Trials, shapes (n, perturbations) and (n, merits). They are needed for merits that are not predicted.

    Raises
    ------
    InputError
        If there are too few trials for a merit that is not predicted.
    """

    def __init__(self, lens: Lens, study: Study, values: Array, scores: Array) -> None:
        self.study, self._lens = study, lens
        self._centre = np.array(
            [0.0 if p.is_irregularity else p.distribution.centre for p in study.perturbations]
        )
        columns, count = columns_of(study.perturbations)
        self._starts = np.array([own.start for own in columns])
        self._base = np.zeros(count)
        self._base[self._starts] = self._centre
        self.batch = drawn_batch(study)
        self._deviations = amounts_of(self.batch) - self._base
        self._of_change = np.repeat(np.arange(len(columns)), [own.stop - own.start for own in columns])
        probes = [self._base + scale * self._deviations[:PROBES] for scale in PROBE_SCALES]
        fitted = self._fitted_amounts(np.ones(len(columns)), AROUND_STUDY)
        self._merit_models = _merit_models(lens, study, np.concatenate(probes), fitted)
        self.not_predicted = [k for k, own in enumerate(self._merit_models) if own is None]
        self._response: Response | None = None
        self._residuals = np.zeros((1, len(self.not_predicted)))
        self._sizes = np.ones((1, len(self.not_predicted)))
        self._is_omitted = np.zeros(len(self.not_predicted), bool)
        if self.not_predicted:
            self.fit(values, scores)
            # A search without them comes to tolerances at which they may matter less, and be smoother.
            self._is_omitted = self._is_poor(scores)

    def with_draws(self, count: int) -> StudyScoreModel:
        """Return the model with its first drawn lenses only."""
        few = copy(self)
        few.batch, few._deviations = self.batch.subset(slice(0, count)), self._deviations[:count]
        return few

    def fit(self, values: Array, scores: Array) -> None:
        """Fit the response surfaces of the merits that are not predicted to trials.

        Raises
        ------
        InputError
            If there are too few trials.
        """
        own = scores[:, self.not_predicted]
        try:
            self._response = fit_response(values, own)
        except InputError as error:
            names = ", ".join(merit.label for merit in self._responding)
            raise InputError(
                f"{len(values)} trials are too few for a model of {names}: {error}; run more trials into the "
                "store (tolerancing run --trials)"
            ) from None
        self._residuals = np.nan_to_num(own - self._response.predict(values))
        self._sizes = self._response.sizes(values)[0]

    @property
    def _responding(self) -> tuple[Merit, ...]:
        return tuple(self.study.merits[k] for k in self.not_predicted)

    def check_fit(self, scores: Array) -> None:
        """Refuse a model that is poor for a merit that decides whether the lenses of trials are good.

        Raises
        ------
        InputError
            If there is such a merit.
        """
        assert self._response is not None  # there are merits that are not predicted
        is_poor, explained = self._is_poor(scores), self._response.cross_validated_r_squared
        for merit, poor, r_squared in zip(self._responding, is_poor, explained, strict=True):
            if poor:
                raise InputError(
                    f"merit {merit.label!r}: the model fitted to {len(self._residuals)} trials explains "
                    f"{max(r_squared, 0.0):.0%} of its variance (needed: {POOR_FIT:.0%}), "
                    "so tolerances found by it would not be the cheapest; run more trials into the "
                    "store (tolerancing run --trials), or begin from a study whose tolerances are closer to "
                    "the yield"
                )
        self._is_omitted &= explained < POOR_FIT

    def _is_poor(self, scores: Array) -> NDArray[np.bool_]:
        """Return for each merit whether its response surface is poor although the merit decides about lenses.

        Lenses that miss a predicted limit as well do not need it.
        """
        assert self._response is not None  # there are merits that are not predicted
        predicted = [k for k in range(len(self.study.merits)) if k not in self.not_predicted]
        kept = all_passed([self.study.merits[k] for k in predicted], scores[:, predicted])
        missed = [
            np.mean(kept & ~merit.passed(scores[:, k]))
            for k, merit in zip(self.not_predicted, self._responding, strict=True)
        ]
        return (np.array(missed) > SELDOM) & (self._response.cross_validated_r_squared < POOR_FIT)

    def refine(self, scales: Array) -> bool:
        """Fit losses of reconstructions again, to lenses near some scales; return whether there are any."""
        amounts, is_fitted = self._fitted_amounts(scales, AROUND_BUDGET), False
        for k, merit in enumerate(self.study.merits):
            if isinstance(merit, ReconstructionLoss):
                self._merit_models[k] = fit_loss_surface(self._lens, self.study, merit, amounts)
                is_fitted = True
        return is_fitted

    def _fitted_amounts(self, scales: Array, region: _Region) -> Array:
        """Return lenses to which losses are fitted, with deviations of about these scales."""
        count, tolerances = min(FITTED_LENSES, len(self._deviations)), len(self._starts)
        rng = np.random.default_rng(0)
        common = rng.uniform(np.log(region.low), np.log(region.high), (count, 1))
        factors = scales * np.exp(common + region.own_spread * rng.standard_normal((count, tolerances)))
        return np.asarray(self._base + factors[:, self._of_change] * self._deviations[:count])

    def scores(self, scales: Array) -> Array:
        """Return the scores, shape (draws, merits)."""
        return self._scores(self._amounts(scales), self._values(scales))

    def scores_of(self, batch: PerturbationBatch) -> Array:
        """Return the scores of arbitrary lenses of the study, shape (n, merits)."""
        return self._scores(amounts_of(batch), batch.values)

    def slopes(self, scales: Array) -> tuple[Array, Array]:
        """Return scores, shape (draws, merits), and derivatives by the scales, shape (draws, merits, d)."""
        amounts = self._amounts(scales)
        scores = np.empty((len(amounts), len(self._merit_models)))
        slopes = np.empty((*scores.shape, len(scales)))
        for k, model in enumerate(self._merit_models):
            if model is not None:
                scores[:, k], by = model.slopes(amounts)
                slopes[:, k] = np.add.reduceat(by * self._deviations, self._starts, axis=1)
        if self.not_predicted:
            scores[:, self.not_predicted], by = self._responses(self._values(scales))
            slopes[:, self.not_predicted] = by * (self.batch.values - self._centre)[:, None]
        return scores, slopes

    def _amounts(self, scales: Array) -> Array:
        return np.asarray(self._base + scales[self._of_change] * self._deviations)

    def _values(self, scales: Array) -> Array:
        return np.asarray(self._centre + scales * (self.batch.values - self._centre))

    def _scores(self, amounts: Array, values: Array) -> Array:
        scores = np.empty((len(amounts), len(self._merit_models)))
        for k, model in enumerate(self._merit_models):
            if model is not None:
                scores[:, k] = model.scores(amounts)
        if self.not_predicted:
            scores[:, self.not_predicted] = self._responses(values)[0]
        return scores

    def _responses(self, values: Array) -> tuple[Array, Array]:
        """Return scores by the response surfaces and derivatives by the deviations, (n, m) and (n, m, d).

        Each lens has the residual of one random trial, times the square of its deviations relative to those
        of the trial, but at most once. All lenses keep the limit of an omitted merit.
        """
        assert self._response is not None  # there are merits that are not predicted
        rng = np.random.default_rng(0)
        which: NDArray[np.intp] = rng.integers(len(self._residuals), size=len(values))
        sizes, by = self._response.sizes(values)
        trial_sizes, residuals = np.maximum(self._sizes[which], 1e-30), self._residuals[which]
        shrink = np.minimum(sizes / trial_sizes, 1.0)
        steepness = np.where(shrink < 1.0, residuals / trial_sizes, 0.0)
        slopes = self._response.slopes(values) + steepness[..., None] * by
        scores = self._response.predict(values) + shrink * residuals
        for k in np.flatnonzero(self._is_omitted):
            merit = self._responding[k]
            # Far on the good side of the limit.
            scores[:, k], slopes[:, k] = (1e6 if merit.at_least is not None else -1e6), 0.0
        return scores, slopes


def _merit_models(lens: Lens, study: Study, probes: Array, fitted_amounts: Array) -> list[_MeritModel | None]:
    """Return a model of each merit; None for merits that cannot be predicted."""
    models: list[_MeritModel | None] = []
    context = Context(lens, study.sampling, pivot_z_mm=study.pivot_z_mm)
    for merit in study.merits:
        if is_predicted_wavefront(merit):
            models.append(_wavefront(lens, study, merit))
        elif isinstance(merit, LargestSpread | FootprintRadius):
            ray = _extreme_ray(lens, study, merit, context)
            models.append(ray.of_possible_extremes(probes))
        elif isinstance(merit, ReconstructionLoss):
            models.append(fit_loss_surface(lens, study, merit, fitted_amounts))
        else:
            models.append(None)
    return models


def _wavefront(lens: Lens, study: Study, merit: RmsWaves | Strehl) -> _Wavefront:
    judged = tuple(WavefrontLimit(point, merit.wavelength_um, 1.0) for point in merit.points)
    known = study_derivatives(lens, study, judged, second=False)
    # Compensators respond to perturbations to first order, without limits.
    follow = known.compensation.following(known.changes.count)
    forms = tuple(follow.T @ first_order(field) @ follow for field in known.fields)
    return _Wavefront(forms, isinstance(merit, Strehl))


def _extreme_ray(
    lens: Lens, study: Study, merit: LargestSpread | FootprintRadius, context: Context
) -> _ExtremeRay:
    plane_mm = None
    if isinstance(merit, FootprintRadius):
        plane_mm = merit.plane_distance_mm or lens.sensor.plane_distances_mm[-1]
    known = arrival_differentials(
        lens,
        study.perturbations,
        np.array([p.tolerance for p in study.perturbations]),
        merit.extreme_points(context),
        merit.stop_samples(context, plane_mm),
        wavelength_um=context.wavelength_um(merit.wavelength_um),
        pivot_z_mm=study.pivot_z_mm,
    )
    if plane_mm is None:
        return _ExtremeRay(known.direction, known.direction_by, True)
    return _on_plane(known, plane_mm - lens.sensor.plane_distances_mm[0])


def _on_plane(known: ArrivalDifferentials, distance_mm: float) -> _ExtremeRay:
    """Return the model of positions at a distance behind the first sensor plane, to first order."""
    across, by = known.direction, known.direction_by
    along = np.sqrt(1.0 - np.sum(across**2, axis=1))[:, None]
    rotation = np.einsum("na,nac->nc", across, by)[:, None] * across[..., None] / along[..., None] ** 3
    return _ExtremeRay(
        known.position_mm + distance_mm * across / along,
        known.position_by + distance_mm * (by / along[..., None] + rotation),
        False,
    )
