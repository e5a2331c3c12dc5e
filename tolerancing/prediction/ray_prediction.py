"""Predictions of ray merits without trials, from the derivatives of the nominal lens's rays.

Each ray follows the perturbations to first order. The outermost ray is determined for each draw, so that
changes of the extreme ray are included. A few draws are traced to verify that the first order is sufficient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.raytrace.bundles import PupilSamples
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context, Points
from tolerancing.merits.rays import FootprintRadius, LargestSpread, RayMerit
from tolerancing.merits.sensor_rays import Arrival
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.sensor_ray_derivatives import ArrivalDifferentials, arrival_differentials
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import drawn_batch
from tolerancing.study.study import Study

BLOCK = 128
"""Number of draws that are computed at one time, and that determine the effect of each perturbation alone."""

ROUNDING = 1e-9
"""Deviations below this fraction of the nominal value are rounding errors."""


@dataclass(frozen=True, eq=False)
class RayPrediction:
    """Prediction of a ray merit, in its unit.

    Attributes
    ----------
    merit : RayMerit
    nominal : float
        Score of the nominal lens.
    mean, deviation : float
        Mean and standard deviation over lenses.
    scores : ndarray, shape (draws,)
        Scores of the drawn lenses.
    alone : ndarray, shape (perturbations,)
        Standard deviation for each perturbation alone.
    error : float
        Root mean square error of the predictions for the traced draws; 0 if none was traced.
    relative_error : float
        The same as a fraction of the deviation of the traced draws.
    """

    merit: RayMerit
    nominal: float
    mean: float
    deviation: float
    scores: Array
    alone: Array
    error: float
    relative_error: float

    @property
    def passed(self) -> NDArray[np.bool_]:
        """True for drawn lenses within the limit, shape (draws,)."""
        return self.merit.passed(self.scores)

    @property
    def good(self) -> float:
        """Fraction of lenses within the limit."""
        return float(np.mean(self.passed))

    @property
    def shares(self) -> Array:
        """Fraction of the sum of squared deviations of each perturbation alone, shape (perturbations,)."""
        squares = self.alone**2
        return np.asarray(squares / max(float(np.sum(squares)), np.finfo(float).tiny))

    @property
    def first_order_suffices(self) -> bool:
        """True if the error of the first order is small."""
        # Root mean square that first order may leave of the traced draws, as a fraction of their deviation.
        largest_fraction = 0.05
        return self.relative_error <= largest_fraction


class FirstOrderRays(Context):
    """Context in which rays follow the perturbations to first order, without clipping."""

    def __init__(self, lens: Lens, study: Study) -> None:
        super().__init__(lens, study.sampling, pivot_z_mm=study.pivot_z_mm)
        self._study = study

    def rays(
        self,
        batch: PerturbationBatch,
        field_points_mm: Points,
        wavelength_um: float | None,
        stop: PupilSamples | None = None,
    ) -> Arrival:
        wavelength, study = self.wavelength_um(wavelength_um), self._study
        samples = self.stop_samples() if stop is None else stop

        def make() -> ArrivalDifferentials:
            return arrival_differentials(
                self.lens,
                study.perturbations,
                np.array([p.tolerance for p in study.perturbations]),
                field_points_mm,
                samples,
                wavelength_um=wavelength,
                pivot_z_mm=study.pivot_z_mm,
            )

        known = self.cached(("arrivals", field_points_mm, wavelength, id(stop)), make)
        return self.cached_for(
            batch,
            ("rays", field_points_mm, wavelength, id(stop)),
            lambda: known.arrival(amounts_of(batch)),
        )

    def narrow(self, batch: PerturbationBatch, distances_mm: tuple[float, ...]) -> None:
        """Keep only the rays that are close to the extreme ray of one of these lenses or of the nominal lens.

        Parameters
        ----------
        batch
            The lenses.
        distances_mm
            Distances of the planes of footprints from the first sensor plane.
        """
        for key, known in self._cache.items():
            if isinstance(known, ArrivalDifferentials):
                self._cache[key] = known.subset(_extreme_rays(known, batch, distances_mm))


def _extreme_rays(
    known: ArrivalDifferentials, batch: PerturbationBatch, distances_mm: tuple[float, ...]
) -> NDArray[np.int64]:
    """Return the indices of rays whose angle or footprint is the largest or close to it."""
    amounts = amounts_of(batch)
    found = known.arrival(np.concatenate([amounts, np.zeros_like(amounts[:1])]))
    across = found.direction[..., :2] / found.direction[..., 2:]
    kept = np.zeros(across.shape[1], bool)
    # A ray is followed for all draws if it comes so close to the extreme of one of the first, or of the
    # nominal lens, in standard deviations of the extreme.
    deviations = 0.5
    for distance in (None, *distances_mm):
        ends = found.direction[..., :2] if distance is None else found.position_mm + distance * across
        sizes = np.hypot(ends[..., 0], ends[..., 1])
        largest = np.max(sizes, axis=1)
        near = largest - deviations * np.std(largest) - ROUNDING * largest
        kept |= np.any(sizes >= near[:, None], axis=0)
    return np.flatnonzero(kept)


def is_predicted_ray_merit(merit: Merit) -> TypeGuard[LargestSpread | FootprintRadius]:
    """Return whether a merit is a ray merit that can be predicted: a spread or a footprint."""
    return isinstance(merit, LargestSpread | FootprintRadius)


def predicted_merits(study: Study) -> tuple[RayMerit, ...]:
    """Return the ray merits of a study that can be predicted."""
    return tuple(merit for merit in study.merits if is_predicted_ray_merit(merit))


def predict_rays(
    lens: Lens, study: Study, batch: PerturbationBatch | None = None, *, checked: bool = True
) -> tuple[RayPrediction, ...]:
    """Predict a study's largest spreads and footprints.

    The second order of single rays is neglected, and so are rays that only the nominal or only the perturbed
    lens clips.

    Parameters
    ----------
    lens
        The study's lens.
    study
        The study with perturbations and merits.
    batch
        The drawn lenses; default: those of :func:`tolerancing.prediction.wavefront_prediction.drawn_batch`.
    checked
        Whether the first draws are traced as well, to measure the error of the first order.

    Returns
    -------
    tuple of RayPrediction
        One for each merit `largest_spread_deg` and `footprint_radius_mm`.

    Raises
    ------
    DesignError
        If no ray passes.
    """
    merits = predicted_merits(study)
    if not merits:
        return ()
    drawn = drawn_batch(study) if batch is None else batch
    context = FirstOrderRays(lens, study)
    blocks = [drawn.subset(slice(start, start + BLOCK)) for start in range(0, len(drawn), BLOCK)]
    planes = lens.sensor.plane_distances_mm
    judged = [m.plane_distance_mm or planes[-1] for m in merits if isinstance(m, FootprintRadius)]
    first = _scores(merits, context, blocks[0])
    context.narrow(blocks[0], tuple(distance - planes[0] for distance in judged))
    scores = np.concatenate([first, *(_scores(merits, context, block) for block in blocks[1:])])
    unperturbed = replace(blocks[0], values=np.zeros_like(blocks[0].values))
    nominal = _scores(merits, context, unperturbed)[0]
    alone = np.stack([np.std(_scores(merits, context, one), axis=0) for one in _one_by_one(blocks[0])])
    errors, relative_error = np.zeros(len(merits)), np.zeros(len(merits))
    if checked:
        # The first 64 draws are traced.
        traced = _scores(merits, Context(lens, study.sampling), drawn.subset(slice(0, 64)))
        errors = np.sqrt(np.mean((scores[: len(traced)] - traced) ** 2, axis=0))
        # A score that no perturbation changes has only rounding errors.
        relative_error = errors / np.maximum(np.std(traced, axis=0), ROUNDING * np.abs(nominal))
    return tuple(
        RayPrediction(
            merit,
            float(nominal[k]),
            float(np.mean(scores[:, k])),
            float(np.std(scores[:, k])),
            scores[:, k],
            alone[:, k],
            float(errors[k]),
            float(relative_error[k]),
        )
        for k, merit in enumerate(merits)
    )


def _scores(merits: tuple[RayMerit, ...], context: Context, batch: PerturbationBatch) -> Array:
    return np.stack([merit.scores(context, batch) for merit in merits], axis=1)


def _one_by_one(batch: PerturbationBatch) -> list[PerturbationBatch]:
    """Return one batch for each perturbation, in which all others are 0."""
    kept = np.eye(batch.values.shape[1])
    return [replace(batch, values=batch.values * own) for own in kept]
