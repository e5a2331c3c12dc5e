"""Scores of drawn lenses as functions of the scales of a study's tolerances, with derivatives.

Wavefront and ray merits follow from the derivatives of the nominal lens's rays to first order
(:mod:`tolerancing.prediction`). Other merits follow from a response surface that is fitted to trials, with
the residuals of that fit as scatter. What the model neglects is corrected by trials of the lens itself
(:mod:`tolerancing.budgets.study_budget`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import RmsWaves, Strehl
from tolerancing.merits.rays import FootprintRadius, LargestSpread
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.arrivals import ArrivalDifferentials, arrival_differentials
from tolerancing.prediction.system import amounts_of, columns_of
from tolerancing.prediction.wavefront_prediction import (
    Judged,
    first_order,
    is_predicted_wavefront,
    replace_draws,
    study_derivatives,
)
from tolerancing.statistics.response import Response, fit_response
from tolerancing.study.evaluate import sample_perturbations
from tolerancing.study.study import Study

DRAWS = 8192
"""Sobol draws by which a budget knows its yield."""

BLOCK = 512
"""Lenses whose rays are held at one time."""

PROBES, PROBE_SCALES, KEPT_RAYS = 512, (0.5, 1.0, 2.0), 3
"""Lenses, and scales of their deviations, that tell which rays can be the extreme one; how many of each."""

RELATIVE_STEP = 1e-4
"""Of scales, for derivatives of response surfaces."""


class _Part(Protocol):
    """The score of one merit by the amounts of each change, shape (n, c)."""

    def scores(self, amounts: Array) -> Array:
        """Shape (n,)."""

    def slopes(self, amounts: Array) -> tuple[Array, Array]:
        """Scores, shape (n,), and their derivatives by the amounts, shape (n, c)."""


@dataclass(frozen=True, eq=False)
class _Wavefront:
    """A wavefront merit, by the quadratic form of its mean square at each field point."""

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
    """A ray merit: the longest of vectors that are linear in the amounts; an angle, if it is a sine."""

    nominal: Array
    by: Array
    is_sine: bool

    def scores(self, amounts: Array) -> Array:
        return self.slopes(amounts, derivatives=False)[0]

    def slopes(self, amounts: Array, derivatives: bool = True) -> tuple[Array, Array]:
        found = [
            self._block(amounts[start : start + BLOCK], derivatives)
            for start in range(0, len(amounts), BLOCK)
        ]
        values, by = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if not self.is_sine:
            return values, by
        cosine = np.sqrt(np.maximum(1.0 - values**2, 1e-12))
        return np.rad2deg(np.arcsin(np.minimum(values, 1.0))), np.rad2deg(by / cosine[:, None])

    def _block(self, amounts: Array, derivatives: bool) -> tuple[Array, Array]:
        vectors = self.vectors(amounts)
        lengths = np.hypot(vectors[..., 0], vectors[..., 1])
        longest, rows = np.argmax(lengths, axis=1), np.arange(len(amounts))
        values = lengths[rows, longest]
        if not derivatives:
            return values, np.zeros_like(amounts)
        along = vectors[rows, longest] / values[:, None]
        return values, np.einsum("na,nac->nc", along, self.by[longest])

    def vectors(self, amounts: Array) -> Array:
        """Shape (n, rays, 2)."""
        moved = amounts @ self.by.reshape(-1, amounts.shape[1]).T
        return self.nominal + moved.reshape(-1, *self.nominal.shape)

    def of_possible_extremes(self, amounts: Array) -> _ExtremeRay:
        """The same of the rays that are among the longest for some lens."""
        vectors = self.vectors(amounts)
        lengths = np.hypot(vectors[..., 0], vectors[..., 1])
        kept = np.unique(np.argsort(lengths, axis=1)[:, -KEPT_RAYS:])
        return replace(self, nominal=self.nominal[kept], by=self.by[kept])


class StudyScoreModel:
    """Scores of a study's merits for scaled tolerances; itself a score model of a tolerance search.

    Parameters
    ----------
    lens, study
        What scatters of which lens, and its merits.
    values, scores
        Trials, shapes (n, perturbations) and (n, merits); needed for merits that are not predicted.

    Raises
    ------
    InputError
        If the trials are too few for a merit that is not predicted.
    """

    def __init__(self, lens: Lens, study: Study, values: Array, scores: Array) -> None:
        self.study = study
        self._centre = np.array(
            [0.0 if p.is_irregularity else p.distribution.centre for p in study.perturbations]
        )
        columns, count = columns_of(study.perturbations)
        self._starts = np.array([own.start for own in columns])
        self._base = np.zeros(count)
        self._base[self._starts] = self._centre
        self.batch = sample_perturbations(replace_draws(study, DRAWS), range(DRAWS))
        self._deviations = amounts_of(self.batch) - self._base
        self._of_change = np.repeat(np.arange(len(columns)), [own.stop - own.start for own in columns])
        probes = [self._base + scale * self._deviations[:PROBES] for scale in PROBE_SCALES]
        self._parts = _parts(lens, study, np.concatenate(probes))
        self.not_predicted = [k for k, part in enumerate(self._parts) if part is None]
        self._response: Response | None = None
        self._residuals = np.zeros((1, len(self.not_predicted)))
        if self.not_predicted:
            self.fit(values, scores)

    def fit(self, values: Array, scores: Array) -> None:
        """Fit the response surfaces of the merits that are not predicted, to trials."""
        own = scores[:, self.not_predicted]
        self._response = fit_response(values, own)
        self._residuals = np.nan_to_num(own - self._response.predict(values))

    def scores(self, scales: Array) -> Array:
        """Scores, shape (draws, merits)."""
        return self._scores(self._amounts(scales), self._values(scales))

    def scores_of(self, batch: PerturbationBatch) -> Array:
        """Scores of any lenses of the study, shape (n, merits)."""
        return self._scores(amounts_of(batch), batch.values)

    def slopes(self, scales: Array) -> tuple[Array, Array]:
        """Scores, shape (draws, merits), and derivatives by the scales, shape (draws, merits, d)."""
        amounts = self._amounts(scales)
        scores = np.empty((len(amounts), len(self._parts)))
        found = np.empty((*scores.shape, len(scales)))
        for k, part in enumerate(self._parts):
            if part is not None:
                scores[:, k], by = part.slopes(amounts)
                found[:, k] = np.add.reduceat(by * self._deviations, self._starts, axis=1)
        if self.not_predicted:
            scores[:, self.not_predicted] = middle = self._responses(self._values(scales))
            for j in range(len(scales)):
                moved = scales.copy()
                moved[j] *= 1.0 + RELATIVE_STEP
                change = self._responses(self._values(moved)) - middle
                found[:, self.not_predicted, j] = change / (RELATIVE_STEP * scales[j])
        return scores, found

    def _amounts(self, scales: Array) -> Array:
        return np.asarray(self._base + scales[self._of_change] * self._deviations)

    def _values(self, scales: Array) -> Array:
        return np.asarray(self._centre + scales * (self.batch.values - self._centre))

    def _scores(self, amounts: Array, values: Array) -> Array:
        scores = np.empty((len(amounts), len(self._parts)))
        for k, part in enumerate(self._parts):
            if part is not None:
                scores[:, k] = part.scores(amounts)
        if self.not_predicted:
            scores[:, self.not_predicted] = self._responses(values)
        return scores

    def _responses(self, values: Array) -> Array:
        """By the response surfaces, each lens with the residual of one trial."""
        assert self._response is not None  # there are merits that are not predicted
        rng = np.random.default_rng(0)
        which: NDArray[np.intp] = rng.integers(len(self._residuals), size=len(values))
        return self._response.predict(values) + self._residuals[which]


def _parts(lens: Lens, study: Study, probes: Array) -> list[_Part | None]:
    """A model of each merit; None where it cannot be predicted."""
    parts: list[_Part | None] = []
    context = Context(lens, study.sampling, pivot_z_mm=study.pivot_z_mm)
    for merit in study.merits:
        if is_predicted_wavefront(merit):
            parts.append(_wavefront(lens, study, merit))
        elif isinstance(merit, LargestSpread | FootprintRadius):
            ray = _extreme_ray(lens, study, merit, context)
            parts.append(ray.of_possible_extremes(probes))
        else:
            parts.append(None)
    return parts


def _wavefront(lens: Lens, study: Study, merit: RmsWaves | Strehl) -> _Wavefront:
    judged = tuple(Judged(point, merit.wavelength_um, 1.0) for point in merit.points)
    known = study_derivatives(lens, study, judged, second=False)
    # Compensators follow the perturbations to first order, as if they had no limits.
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


def _on_plane(known: ArrivalDifferentials, further_mm: float) -> _ExtremeRay:
    """Positions a distance behind the first sensor plane, to first order."""
    across, by = known.direction, known.direction_by
    along = np.sqrt(1.0 - np.sum(across**2, axis=1))[:, None]
    turned = np.einsum("na,nac->nc", across, by)[:, None] * across[..., None] / along[..., None] ** 3
    return _ExtremeRay(
        known.position_mm + further_mm * across / along,
        known.position_by + further_mm * (by / along[..., None] + turned),
        False,
    )
