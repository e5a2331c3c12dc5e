"""Mean reconstruction losses of the lenses of a search, with derivatives.

Frames have speckle: the phases of thousands of waves determine which pixels are dark, so that the mean losses
of two almost equal lenses differ by 10 to 30 %. A search therefore uses the linearised reconstructions of the
study's own lens (the loss model) for all lenses. Only the changes of path are those of each lens, and these
are smooth. Derivatives of the path changes by design variables are central differences. Derivatives of the
losses by the path changes are computed by adjoint differentiation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError, InputError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import LossValues
from lensdesign.optimization.problem import DesignProblem
from tolerancing.merits.reconstruction_loss import ReconstructionLoss
from tolerancing.prediction.goals.design import DIFFERENCE_STEP, bent, rim_heights, sized
from tolerancing.prediction.reconstruction_loss import LossModel, loss_model, loss_paths
from tolerancing.prediction.wavefront_prediction import drawn_amounts
from tolerancing.study.evaluate import prepare_merits
from tolerancing.study.study import Study


@dataclass(frozen=True, eq=False)
class SearchedLosses:
    """The merits `reconstruction_loss` of a study, as a search uses them.

    Attributes
    ----------
    study : Study
    reference : Lens
        The study's own lens, whose loss models serve all lenses of the search.
    factor
        Factor that multiplies the tolerances of a lens.
    source : str
        Name of the study file.
    """

    study: Study
    reference: Lens
    factor: Callable[[Lens], float]
    source: str

    @cached_property
    def merits(self) -> tuple[ReconstructionLoss, ...]:
        """The merits."""
        return tuple(merit for merit in self.study.merits if isinstance(merit, ReconstructionLoss))

    def check(self, lens: Lens) -> None:
        """Check that the loss models of the study's lens are valid for lenses of a search.

        Raises
        ------
        DesignError
        """
        prepare_merits(self.study)
        try:
            for merit in self.merits:
                merit.check(lens)
            self._models_and_scale(lens)
        except (InputError, ValueError) as error:
            raise DesignError(
                f"{self.source}: a search for a small reconstruction loss needs the study's own lens with "
                f"the object, sensor and wavelengths of the specification, which is not possible: {error}"
            ) from None

    def _models_and_scale(self, lens: Lens) -> tuple[tuple[LossModel, ...], float]:
        """Return the cached loss model of each merit, and the largest mean loss of the study's own lens.

        The models hold for lenses with the object, sensor and wavelengths of `lens`.
        """
        scene = lens.object.replaced(working_distance_mm=self.reference.object.working_distance_mm)
        key = scene, lens.sensor, lens.wavelengths_um
        if key not in self._known:
            other = self.reference.replaced(
                object=scene, sensor=lens.sensor, wavelengths_um=lens.wavelengths_um
            )
            # Pixels for each sample of the object. Mean losses are 3 to 16 % larger than with those of the
            # merit, tiny ones up to 60 %; lenses are ranked alike.
            search_pixels = 2.0
            models = tuple(loss_model(other, merit, search_pixels) for merit in self.merits)
            means = []
            for merit, model in zip(self.merits, models, strict=True):
                paths = loss_paths(bent(other), self.study, merit)
                losses, _ = model.losses(model.coefficients(paths, self._amounts))
                means.append(float(np.mean(losses.max(axis=0))))
            self._known[key] = models, max(*means, float(np.finfo(float).tiny))
        return self._known[key]

    @cached_property
    def _known(self) -> dict[object, tuple[tuple[LossModel, ...], float]]:
        return {}

    @cached_property
    def _amounts(self) -> Array:
        # Lenses, drawn by a Sobol sequence, over which a search takes the mean.
        search_draws = 32
        return drawn_amounts(self.study, search_draws)

    def values(self, problem: DesignProblem, point: Array, derivatives: bool) -> LossValues:
        """Return the mean losses of the lens at a point of the unit box.

        Raises
        ------
        TransferLensError
            If the lens cannot be traced.
        """
        models, scale = self._models_and_scale(problem.specification.lens)
        count = len(problem.variables) if derivatives else 0
        losses, by = np.empty(len(models)), np.zeros((len(models), count))
        for m, (merit, own) in enumerate(zip(self.merits, models, strict=True)):

            def coefficients(point: Array, merit: ReconstructionLoss = merit, own: LossModel = own) -> Array:
                lens = sized(problem.lens_at(point), rim_heights(problem, point))
                amounts = self.factor(lens) * self._amounts
                return own.coefficients(loss_paths(lens, self.study, merit), amounts)

            each, slopes = own.losses(coefficients(point), derivatives)
            worst = np.argmax(each, axis=0)
            lenses = np.arange(each.shape[1])
            losses[m] = np.mean(each[worst, lenses])
            for k in range(count):
                step = DIFFERENCE_STEP * np.eye(len(point))[k]
                change = coefficients(point + step) - coefficients(point - step)
                each_by = np.sum(slopes * change, axis=(1, 3))[worst, lenses]
                by[m, k] = np.mean(each_by) / (2.0 * DIFFERENCE_STEP * problem.width[k])
        return LossValues(losses, by, scale)
