"""Search for an object with one engine: the solver, and what finds a better object than its first one.

The solver's first object may have the wrong scale, edges in wrong places, be displaced by a sample, or be in
a local minimum. Each of these has its own module with the reasons. They apply to amplitude and phase objects
(the scale to amplitude objects alone). Complex objects and whole fields end at the noise and stay as found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.step_noise import noise_of_step
from wavesim.reconstruction.amplitude_limit import with_own_limit
from wavesim.reconstruction.assessment import (
    LARGEST_MISFIT_RATIO,
    excess_of,
    may_be_stagnated,
    needs_more_iterations,
)
from wavesim.reconstruction.free_edges import with_free_edges
from wavesim.reconstruction.growing_aperture import STAGES, with_growing_aperture
from wavesim.reconstruction.object_solver import Reconstructed, SolverState, reconstruct
from wavesim.reconstruction.position import at_best_position
from wavesim.reconstruction.prior_bias import with_less_bias
from wavesim.reconstruction.problem import ReconstructionProblem
from wavesim.reconstruction.resumable import state_saver
from wavesim.reconstruction.search_rules import ends_at_noise, tv_factor
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.engine import Engine
from wavesim.scene.settings import ReconstructionSettings
from wavesim.sensor.measurement import Measurement, noise_misfit

Start = Field | Literal["amplitude"] | None
"""Start of a search, see :func:`wavesim.reconstruct`."""


@dataclass(frozen=True, eq=False)
class ObjectSearch:
    """Searches of one problem with one engine.

    Attributes
    ----------
    case, settings
        The problem and its settings.
    engine
        Engine of all searches, ready for use.
    on_step
        Called with the name of each step.
    on_iteration
        Called with index and misfit after each iteration.
    """

    case: ReconstructionProblem
    settings: ReconstructionSettings
    engine: Engine
    on_step: Callable[[str], None]
    on_iteration: Callable[[int, float], None]

    def solve(
        self,
        start: Start,
        *,
        checkpoint: Checkpoint | None = None,
        resume: SolverState | None = None,
        bounded: bool = True,
        given: Sequence[Measurement] = (),
        iterations: int | None = None,
        scale: float | None = None,
        factor: float = 1.0,
        iterations_without_tv: int = 0,
    ) -> Reconstructed:
        """Return the object that iterations find, by default from all pixels of the problem.

        Parameters
        ----------
        start, resume, bounded, iterations_without_tv
            See :func:`wavesim.reconstruct`.
        checkpoint
            Where states are saved; default: nowhere.
        given, iterations, scale
            Measured planes, largest number of iterations, and scale, if not those of the problem.
        factor
            Factor of the automatic total variation.
        """
        case, settings = self.case, self.settings
        planes = given or case.given
        return reconstruct(
            self.engine,
            case.light,
            planes,
            kind=settings.kind,
            tv_weight=settings.tv_weight,
            iterations=iterations or settings.most_iterations,
            until_noise=ends_at_noise(settings.kind, self.engine),
            scale=settings.scale if scale is None else scale,
            start=start,
            fill_factor=settings.fill_factor,
            progress=self.on_iteration,
            resume=resume,
            keep=state_saver(checkpoint),
            scratch=case.scratch,
            modes=case.modes,
            bounded=bounded,
            tv_factor=factor * tv_factor(settings.kind, self.engine, planes),
            iterations_without_tv=iterations_without_tv,
        )

    def improved(
        self, found: Reconstructed, start: Start, *, is_first: bool
    ) -> tuple[Reconstructed, Reconstructed]:
        """Return the best object after the solver's first one, and the one that is judged.

        Parameters
        ----------
        found
            The object that the solver has found.
        start
            The start of the first search.
        is_first
            Whether the object is the first one of the problem. One that another engine has found already is
            not searched anew.
        """
        if ends_at_noise(self.settings.kind, self.engine):
            return found, found
        found = self._with_own_limit(found)
        if is_first:
            found = self._with_free_edges(found)
        found, judged = self._with_less_bias(self._placed(found))
        if is_first and may_be_stagnated(self.case, self.settings, judged):
            found, judged = self._out_of_local_minimum(found, judged, start)
        return found, judged

    def _with_own_limit(self, found: Reconstructed, iterations_without_tv: int = 0) -> Reconstructed:
        """Return an amplitude object of unknown scale whose brightest parts are 1.

        Searches that start anew have the stated number of first iterations without total variation.
        """
        if self.settings.kind != "amplitude" or self.settings.scale is not None:
            return found
        self.on_step("brightest parts of the object")
        case = self.case
        model = ChannelModel.of_source(
            self.engine, case.light, case.given, 1.0, self.settings.fill_factor, modes=case.modes
        )
        noise = noise_of_step(model)
        del model

        def solve(
            start: Field | None, scale: float, *, bounded: bool, iterations: int | None = None
        ) -> Reconstructed:
            return self.solve(
                start,
                bounded=bounded,
                iterations=iterations,
                scale=scale,
                iterations_without_tv=iterations_without_tv if start is None else 0,
            )

        return with_own_limit(solve, found, case.light, noise)

    def _with_free_edges(self, found: Reconstructed) -> Reconstructed:
        """Return an object whose edges the total variation does not hold in wrong places."""
        if self.settings.tv_weight == 0.0 or needs_more_iterations(self.settings, found):
            return found

        def search() -> Reconstructed:
            self.on_step("search anew, without total variation at first")
            most = self.settings.most_iterations
            return self._with_own_limit(self.solve(None, iterations_without_tv=most), most)

        return with_free_edges(search, found, noise_misfit(self.case.given))

    def _placed(self, found: Reconstructed) -> Reconstructed:
        """Return an object at the position that the frames prefer; a displaced one has its own limit."""
        self.on_step("position of the object")

        def solve(start: Field, scale: float, *, iterations: int | None = None) -> Reconstructed:
            return self.solve(start, iterations=iterations, scale=self._kept_scale(scale))

        placed = at_best_position(solve, found, self.case.light, noise_misfit(self.case.given))
        return found if placed is found else self._with_own_limit(placed)

    def _with_less_bias(self, found: Reconstructed) -> tuple[Reconstructed, Reconstructed]:
        """Return the object that is shown, and the one that is judged: with less of the total variation."""
        if self.settings.tv_weight != "auto":
            return found, found

        def solve(start: Field, scale: float, factor: float, iterations: int) -> Reconstructed:
            self.on_step(f"for the verdict, with {factor:g} of the total variation")
            return self.solve(start, iterations=iterations, scale=self._kept_scale(scale), factor=factor)

        most = self.settings.most_iterations
        return with_less_bias(solve, found, noise_misfit(self.case.given), most)

    def _kept_scale(self, scale: float) -> float | None:
        """Return the scale of a search that continues; None where a phase object's is fitted further."""
        return None if self.settings.kind == "phase" and self.settings.scale is None else scale

    def _out_of_local_minimum(
        self, found: Reconstructed, judged: Reconstructed, start: Start
    ) -> tuple[Reconstructed, Reconstructed]:
        """Return the best of the object found and those of other searches: without an upper limit of the
        amplitude, and with a growing aperture. The second object is the one that is judged.

        Nothing is searched once an object leaves no more than the noise. The limit of 1 may be too low where
        the scale is fitted to an object that is bright everywhere.
        """
        excess = excess_of(self.case, judged.residual_maps)
        searches = [self._with_growing_aperture]
        if self.settings.scale is None and self.settings.kind == "amplitude":
            searches = [partial(self.solve, start, bounded=False), *searches]
        for search in searches:
            if excess <= 1.0:
                break
            other, other_judged = self._with_less_bias(self._placed(self._with_own_limit(search())))
            # The result of another search is preferred only if its residuals are clearly smaller. The errors
            # of the engine, which the excess contains, are the same in both.
            if other_judged.misfit[-1] < judged.misfit[-1] / LARGEST_MISFIT_RATIO:
                found, judged = other, other_judged
                excess = excess_of(self.case, judged.residual_maps)
        return found, judged

    def _with_growing_aperture(self) -> Reconstructed:
        """Return the object that a growing aperture finds."""

        def solve(given: Sequence[Measurement], start: Field | None, iterations: int) -> Reconstructed:
            return self.solve(start, given=given, iterations=iterations)

        def on_stage(index: int) -> None:
            self.on_step(f"local minimum? growing aperture, stage {index + 1} of {STAGES}")

        return with_growing_aperture(
            solve,
            self.case.given,
            self.case.light,
            iterations=self.settings.most_iterations,
            knows_scale=self.settings.scale is not None,
            on_stage=on_stage,
        )
