"""Scores of drawn lenses by merits of pupils and of reconstructions, without tracing the lenses.

Merits of pupils score predicted pupils with their own code. The path difference of a drawn lens is known to
second order on a few rays (:mod:`tolerancing.prediction.derivatives`), and polynomials of the direction
cosines continue it to the samples of a pupil. Losses of reconstructions follow from paths to first order
(:mod:`tolerancing.prediction.reconstruction_loss`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.zernikes import zernike
from lensdesign.raytrace.bundles import pupil_rings
from tolerancing.merits.base import Merit
from tolerancing.merits.context import Context
from tolerancing.merits.pupil import PupilMerit
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.prediction.derivatives import ARMS, RINGS, FieldDifferentials, nominal_paths
from tolerancing.prediction.reconstruction_loss import loss_model, loss_paths
from tolerancing.prediction.system import amounts_of
from tolerancing.prediction.wavefront_prediction import (
    TRACED_DRAWS,
    StudyDerivatives,
    WavefrontLimit,
    study_derivatives,
)
from tolerancing.study.evaluate import pupil_context
from tolerancing.study.scoring import score_batch
from tolerancing.study.study import Study
from wavesim.pupil import PupilGrid, ReconstructionPupil
from wavesim.pupil.focus import axial_path, search_range_um

POLYNOMIALS = 45
"""Number of polynomials that continue a path difference over the pupil: radial orders 0 to 8."""


class PredictedPupils(Context):
    """Context whose pupils follow perturbations and compensators to second order, without vignetting.

    Parameters
    ----------
    lens, study
        The nominal lens, and its study.
    known
        Derivatives of the wavefronts at all points whose pupils are asked for.
    samples
        Samples across a pupil. Predicted path differences are smooth, so that fewer samples suffice than for
        the study.
    """

    def __init__(self, lens: Lens, study: Study, known: StudyDerivatives, samples: int) -> None:
        sampling = study.sampling.model_copy(update={"pupil_samples": samples})
        super().__init__(lens, sampling, study.compensators, (), study.pivot_z_mm, study.seed)
        self._derivatives, self._plane_mm = known, study.sampling.plane_distance_mm
        places = [(own.field_mm, self.wavelength_um(own.wavelength_um)) for own in known.judged]
        self._index = {place: k for k, place in enumerate(places)}

    def raw_pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        compensated: bool = False,
    ) -> list[ReconstructionPupil]:
        wavelength = self.wavelength_um(wavelength_um)

        def predicted() -> list[ReconstructionPupil]:
            known, values = self._derivatives, self.compensator_values(batch)
            together = np.concatenate([amounts_of(batch), values if compensated else 0.0 * values], axis=1)
            grid = self.sampler(field_mm, wavelength).grid
            fit = self.cached(("fit", field_mm, wavelength), lambda: self._fit(grid, field_mm, wavelength))
            field = known.fields[self._index[field_mm, wavelength]]
            opd_mm = 1e-3 * wavelength * (_waves(field, together) @ fit.T)
            valid = np.ones(len(grid.index), bool)
            return [ReconstructionPupil(grid, own, valid) for own in opd_mm]

        return self.cached_for(batch, ("pupils", field_mm, wavelength, compensated), predicted)

    def compensator_values(self, batch: PerturbationBatch) -> Array:
        fitted = self._derivatives.compensation.values
        return self.cached_for(batch, "compensators", lambda: fitted(amounts_of(batch)))

    def _fit(self, grid: PupilGrid, field_mm: tuple[float, float], wavelength_um: float) -> Array:
        """Return the matrix from path differences on the rays to those at the samples of a pupil."""
        stop = pupil_rings(RINGS, ARMS)
        rays = nominal_paths(self.lens, [field_mm], stop, wavelength_um, self._plane_mm).cosines
        on_rays, on_grid = (_polynomials(own[:, :2], grid) for own in (rays, grid.cosines))
        return np.asarray(on_grid @ np.linalg.pinv(on_rays))


def is_scored_by_draw(merit: Merit) -> bool:
    """Return whether a merit scores predicted pupils, or is a predicted loss of a reconstruction."""
    return isinstance(merit, PupilMerit) and merit.used_level == "pupil"


@dataclass(frozen=True, eq=False)
class DrawnScores:
    """Predicted scores of drawn lenses by m merits.

    Attributes
    ----------
    scores : ndarray, shape (draws, m)
        Scores; NaN for a lens without a score.
    errors : ndarray, shape (m,)
        Difference from the scores of traced draws that two thirds of these do not exceed.
    """

    scores: Array
    errors: Array


def scores_by_draw(
    lens: Lens,
    study: Study,
    merits: Sequence[Merit],
    batch: PerturbationBatch,
    proceed: Callable[[], None] = lambda: None,
) -> DrawnScores:
    """Predict the scores of drawn lenses, and measure their error with the first draws, which are traced.

    Parameters
    ----------
    lens, study
        The nominal lens, and its study.
    merits
        Merits of the study for which :func:`is_scored_by_draw` is true.
    batch
        The drawn lenses.
    proceed
        Function that is called between blocks of draws; it may raise an exception.

    Raises
    ------
    DesignError, InputError
        If rays do not pass, or the lens does not have a perturbed parameter.
    """
    context: Context | None = None
    if not all(isinstance(merit, ReconstructionLoss) for merit in merits):
        context = predicted_pupils(lens, study, merits, batch)
    scorers = [_scorer(lens, study, merit, context) for merit in merits]
    # Number of draws that are scored, and whose pupils are held, at one time.
    block = 32
    scores = np.empty((len(batch), len(merits)))
    for start in range(0, len(batch), block):
        part = slice(start, start + block)
        drawn = batch.subset(part)
        for k, score in enumerate(scorers):
            proceed()
            scores[part, k] = score(drawn)
    proceed()
    as_predicted = study
    if context is not None:
        as_predicted = study.model_copy(update={"sampling": context.sampling})
    traced = batch.subset(slice(0, TRACED_DRAWS))
    true, _ = score_batch(merits, pupil_context(lens, as_predicted), traced)
    return DrawnScores(scores, np.array([*map(measured_error, scores[: len(true)].T, true.T)]))


def _scorer(
    lens: Lens, study: Study, merit: Merit, context: Context | None
) -> Callable[[PerturbationBatch], Array]:
    """Return the function that predicts the scores of lenses by a merit."""
    if context is not None and not isinstance(merit, ReconstructionLoss):
        return lambda part: score_batch([merit], context, part)[0][:, 0]
    assert isinstance(merit, ReconstructionLoss)  # all others have predicted pupils
    model, paths = loss_model(lens, merit), loss_paths(lens, study, merit)

    def losses(part: PerturbationBatch) -> Array:
        found, _ = model.losses(model.coefficients(paths, amounts_of(part)))
        return np.asarray(found.max(axis=0))

    return losses


def measured_error(predicted: Array, traced: Array) -> float:
    """Return the difference that two thirds of the traced draws do not exceed; infinite without scores."""
    known = np.isfinite(predicted) & np.isfinite(traced)
    # A lens with a score by one of both only is a wrong prediction.
    wrong = np.isfinite(predicted) != np.isfinite(traced)
    if not np.any(known) or np.mean(wrong) > 0.05:
        return math.inf
    return float(np.quantile(np.abs(predicted - traced)[known], 0.68))


def predicted_pupils(
    lens: Lens, study: Study, merits: Sequence[Merit], batch: PerturbationBatch
) -> PredictedPupils:
    """Return a context whose pupils have enough samples for the drawn lenses in all planes of focus."""
    own = [m for m in merits if isinstance(m, PupilMerit) and not isinstance(m, ReconstructionLoss)]
    judged = [WavefrontLimit(point, merit.wavelength_um, 1.0) for merit in own for point in merit.points]
    known = study_derivatives(lens, study, judged, second=True)
    coarsest, finest, part = 32, study.sampling.pupil_samples, batch.subset(slice(0, 64))
    context, steps = PredictedPupils(lens, study, known, coarsest), [0.0]
    for one in judged:
        pupils = context.pupils(part, one.field_mm, one.wavelength_um, True, True)
        steps += [_largest_step_waves(pupil) for pupil in pupils]
    # Contrasts need a phase that changes by less than half a wave between samples, in 99 % of the lenses.
    needed = float(np.quantile(steps, 0.99)) / 0.4 * coarsest
    return PredictedPupils(lens, study, known, int(np.clip(needed, min(coarsest, finest), finest)))


def _largest_step_waves(pupil: ReconstructionPupil) -> float:
    """Return the largest phase step between samples, in waves, in any plane of the search for the focus."""
    grid = pupil.grid
    focus_waves = search_range_um(grid) / grid.wavelength_um * axial_path(pupil)[1]
    largest = 0.0
    for waves in (pupil.opd_waves + focus_waves, pupil.opd_waves - focus_waves):
        filled = np.full(grid.inside.shape, np.nan)
        filled.ravel()[grid.index] = waves
        largest = max(largest, *(float(np.nanmax(np.abs(np.diff(filled, axis=a)))) for a in (0, 1)))
    return largest


def _polynomials(cosines: Array, grid: PupilGrid) -> Array:
    x, y = ((cosines - np.array(grid.centre)) / grid.half_width).T
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    return np.stack([zernike(index, rho, theta) for index in range(POLYNOMIALS)], axis=1)


def _waves(known: FieldDifferentials, amounts: Array) -> Array:
    """Return path differences in waves with shift and focus, to second order, shape (trials, n)."""
    i, j = np.triu_indices(amounts.shape[1])
    halves = np.where(i == j, 0.5, 1.0)
    return np.asarray(amounts @ known.first.T + (halves * amounts[:, i] * amounts[:, j]) @ known.second.T)
