"""A tolerance study as a search for lenses uses it: predictions with exact derivatives, and fresh trials.

First-order path differences are differentiated by design variables by complex step through
:mod:`tolerancing.wavefronts.paths`, along rays that keep their points on the stop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError, TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.as_built import AsBuiltReport, AsBuiltValues, TrialsOf, untraceable
from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.tracing.bundles import pupil_rings
from lensdesign.tracing.gradients import GradientTrace, Variable
from tolerancing.analysis.yields import yield_of
from tolerancing.cost.pricing import cost_of
from tolerancing.cost.table import CostTable, load_costs
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.study.evaluate import context_of, realise
from tolerancing.study.files import check_against, load_study
from tolerancing.study.study import Study
from tolerancing.wavefronts.derivatives import (
    ARMS,
    RINGS,
    FieldDifferentials,
    basis_of,
    figures_on,
    first_by,
    weights_over_stop,
)
from tolerancing.wavefronts.paths import Paths
from tolerancing.wavefronts.prediction import Judged, judged_points, predict, replace_draws
from tolerancing.wavefronts.sheet_scores import StudySheets
from tolerancing.wavefronts.system import Changes, changes_of

SEARCH_DRAWS = 2048
"""By which a search knows its yield."""

SOFTNESS = 0.06
"""Of a limit's square: over so much a lens turns from good to bad where yields are differentiated."""

RIM_POINTS = 16
"""Of rays that tell the clear height of a surface that has none."""

FLATTEST_PER_MM = 1e-7
"""Curvature that stands for a plane, whose radius cannot err."""

STEP, SHARE = 1e-30, 1e-4
"""Of the complex step; and of a variable's range, for differences of what perturbations are."""

SEARCH_SAMPLES = 48
"""Across the pupil, for fresh trials."""


@dataclass(frozen=True, eq=False)
class StudyAsBuilt:
    """A study whose wavefronts a search makes small, or good.

    Attributes
    ----------
    study : Study
    reference : Lens
        The lens that it was written for.
    source : str
        Where it comes from.
    costs : Path or None
        Table of costs; None is that of the toolkit.
    amount : float or None
        What the tolerances of each lens cost, all multiplied alike; None leaves them as they are.
    """

    study: Study
    reference: Lens
    source: str
    costs: Path | None = None
    amount: float | None = None

    def sheets(self) -> StudySheets:
        """What derives and scores the tolerances of a lens's sheets by the study."""
        return StudySheets(self.study, self.source)

    def priced(self, costs: Path | None, cost: float | None) -> StudyAsBuilt:
        """The study with a table of costs; where a cost is given, tolerances are multiplied to cost it."""
        return replace(self, costs=costs, amount=cost)

    @cached_property
    def _table(self) -> CostTable:
        return load_costs(self.costs)

    def cost(self, lens: Lens) -> float:
        """What the tolerances of a lens cost, its elements included.

        Raises
        ------
        InputError
            If the table has no price for one of them.
        """
        return self.amount or cost_of(self.study, _bent(lens), self._table).total

    def factor(self, lens: Lens) -> float:
        """By which the tolerances of a lens are multiplied to cost what is asked for.

        Costs of tolerances are their reciprocals.
        """
        if self.amount is None:
            return 1.0
        elements = len(lens.glass_fronts)
        return (cost_of(self.study, lens, self._table).total - elements) / (self.amount - elements)

    def scaled(self, factor: float) -> StudyAsBuilt:
        """The study with all tolerances multiplied."""
        if factor == 1.0:
            return self
        return replace(self, study=_multiplied(self.study, factor))

    @cached_property
    def judged(self) -> tuple[Judged, ...]:
        """Object points and their limits."""
        return judged_points(self.study)

    @property
    def points_mm(self) -> tuple[tuple[float, float], ...]:
        """Object points that are judged."""
        return tuple(point.field_mm for point in self.judged)

    @cached_property
    def _sizes(self) -> Array:
        return np.array([p.tolerance for p in self.study.perturbations])

    @cached_property
    def _drawn(self) -> PerturbationBatch:
        return realise(replace_draws(self.study, SEARCH_DRAWS), range(SEARCH_DRAWS))

    def check(self, lens: Lens) -> None:
        """Refuse tolerances of what a lens does not have.

        Raises
        ------
        DesignError
        """
        if self.study.compensators:
            raise DesignError(f"{self.source}: compensators: a search knows shift and focus alone")
        check_against(self.study, _bent(lens), self.source)
        if self.amount is not None:
            if self.amount <= (elements := len(lens.glass_fronts)):
                raise DesignError(
                    f"tolerances: cost = {self.amount:g}: must be above {elements}, which the elements "
                    "of the lens cost without any"
                )
            self.factor(_sized(lens, np.ones(len(lens.surfaces))))
        own = {p.wavelength_um for p in self.judged} - {None, *lens.wavelengths_um}
        if own:
            known = ", ".join(f"{w:g}" for w in lens.wavelengths_um)
            raise DesignError(
                f"{self.source}: merits at {', '.join(f'{w:g}' for w in own if w is not None)} um: a search "
                f"knows the wavelengths of its specification alone, {known} um"
            )

    def evaluate(self, problem: DesignProblem, point: Array, derivatives: bool) -> AsBuiltValues:
        """Predict the lens at a point of the unit box, to first order in the perturbations.

        Derivatives are by the variables' own values.
        """
        variables = problem.variables if derivatives else ()
        wavelengths = problem.base.wavelengths_um
        own = np.array([wavelengths.index(p.wavelength_um or wavelengths[0]) for p in self.judged])
        try:
            parts = [_Forms(self, problem, point, variables, w, own == w) for w in np.unique(own)]
        except (TransferLensError, np.linalg.LinAlgError):
            return untraceable(len(self.judged), len(variables))
        if not all(part.ok for part in parts):
            return untraceable(len(self.judged), len(variables))
        order = np.argsort(np.argsort(own, kind="stable"))
        values = np.concatenate([part.values for part in parts])[order]
        values_by = np.concatenate([part.by for part in parts], axis=1)[:, order]
        amounts = parts[0].changes.amounts(self._drawn)
        moments = amounts.T @ amounts / len(amounts)
        squares = np.sum(values * moments, axis=(1, 2))
        if not (np.all(np.isfinite(values_by)) and np.all(squares > 0.0)):
            return untraceable(len(self.judged), len(variables))
        rms = np.sqrt(squares)
        by = np.sum(values_by * moments, axis=(2, 3)).T / (2.0 * rms[:, None])
        limits = np.array([p.limit_waves for p in self.judged]) ** 2
        each = np.einsum("td,pde,te->tp", amounts, values, amounts, optimize=True) / limits
        worst = np.argmax(each, axis=1)
        rows = np.arange(len(worst))
        soft = 1.0 / (1.0 + np.exp(np.clip((1.0 - each[rows, worst]) / SOFTNESS, -500.0, 500.0)))
        slope = soft * (1.0 - soft) / (SOFTNESS * limits[worst] * len(soft))
        # Each draw at the point where it is worst, gathered as one moment matrix a point.
        heavy = np.stack(
            [(amounts[worst == p].T * slope[worst == p]) @ amounts[worst == p] for p in range(len(limits))]
        )
        failing_by = np.einsum("vpde,pde->v", values_by, heavy)
        return AsBuiltValues(rms, by, float(np.mean(soft)), failing_by)

    def trials(self, lenses: Sequence[tuple[str, Lens]], count: int, seed: int = 0) -> AsBuiltReport:
        """Try lenses by so many fresh trials each, drawn by a seed that is not the study's.

        Raises
        ------
        TransferLensError
            If a lens cannot be scored.
        """
        fresh = self.study.model_copy(
            update={
                "seed": self.study.seed + 1 + seed,
                "draws": "random",
                "trials": count,
                "all_merits": tuple(m for m in self.study.merits if m.label in self._labels),
                "sampling": self.study.sampling.replaced(pupil_samples=SEARCH_SAMPLES),
            }
        )
        rows = [_tried(name, lens, _multiplied(fresh, self.factor(_bent(lens)))) for name, lens in lenses]
        places = [(p.field_mm, p.wavelength_um, p.limit_waves) for p in self.judged]
        points, wavelengths, limits = zip(*places, strict=True)
        return AsBuiltReport(points, wavelengths, limits, tuple(rows))

    @cached_property
    def _labels(self) -> set[str]:
        from tolerancing.merits.pupil import RmsWaves, Strehl

        return {m.label for m in self.study.merits if isinstance(m, RmsWaves | Strehl) and m.refocus}


def read_study(path: Path) -> StudyAsBuilt:
    """Read a study for a search."""
    loaded = load_study(path)
    return StudyAsBuilt(loaded.study, loaded.lens, str(path))


def _multiplied(study: Study, factor: float) -> Study:
    """The study with all tolerances multiplied."""
    return study.model_copy(update={"perturbations": tuple(p.scaled(factor) for p in study.perturbations)})


def _tried(name: str, lens: Lens, study: Study) -> TrialsOf:
    context, batch = context_of(lens, study), realise(study, range(study.trials))
    good, squares = np.ones(study.trials, bool), []
    for merit in study.merits:
        for point in merit.points:  # type: ignore[attr-defined]
            pupils = context.pupils(batch, point, merit.wavelength_um, True, True)
            squares.append([np.mean(p.opd_waves[p.valid] ** 2) for p in pupils])
            good &= merit.passed(np.array([merit.score(p) for p in pupils]))  # type: ignore[attr-defined]
    found = yield_of(good)
    assert found is not None  # there are trials
    rms = np.sqrt(np.mean(squares, axis=1))
    errors = np.std(squares, axis=1) / np.sqrt(study.trials) / (2.0 * rms)
    predicted = tuple(p.rms_waves for p in predict(lens, study).points)
    return TrialsOf(
        name,
        study.trials,
        tuple(rms.tolist()),
        tuple(errors.tolist()),
        predicted,
        found.share,
        found.low,
        found.high,
    )


class _Forms:
    """Mean squares as quadratic forms of the drawn amounts, with derivatives.

    One for each of the object points that are judged at a wavelength of the specification.
    """

    def __init__(
        self,
        own: StudyAsBuilt,
        problem: DesignProblem,
        point: Array,
        variables: tuple[Variable, ...],
        wavelength: int,
        judged: NDArray[np.bool_],
    ) -> None:
        self.own, self.problem, self.point = own, problem, point
        self.system = problem.compiled[wavelength]
        self.wavelength_um = problem.base.wavelengths_um[wavelength]
        points = np.array(own.points_mm)[judged]
        self.count = len(points)
        stop = pupil_rings(RINGS, ARMS)
        self.stop, self.lens = stop, problem.lens_at(point)
        rim = 2.0 * np.pi * np.arange(RIM_POINTS) / RIM_POINTS
        fields = np.repeat(points, len(stop.points), axis=0)
        edge = np.tile([0.0, self.lens.half_field_mm], (RIM_POINTS, 1))
        pupil = np.tile(stop.points, (len(points), 1))
        rays = Rays(
            np.concatenate([fields, edge]),
            np.concatenate([pupil, np.column_stack([np.cos(rim), np.sin(rim)])]),
        )
        plane_mm = own.study.sampling.plane_distance_mm
        self.trace = problem.trace(point, rays, bool(variables), np.array([plane_mm]), wavelength)
        self.inner = slice(0, len(fields))
        self.ok = bool(np.all(self.trace.ok))
        if not self.ok:
            return
        self.fields_mm = fields
        self.changes, factor = self._changes(self.lens, self._clear(None, 0.0))
        values = self._forms(None, None)
        self.values = factor**2 * values
        steps = SHARE * problem.width
        self.by = np.empty((len(variables), *self.values.shape))
        for k in range(len(variables)):
            ends = [
                self._changes(problem.lens_at(point + sign * SHARE * axis), self._clear(k, sign * steps[k]))
                for axis in [np.eye(len(point))[k]]
                for sign in (1.0, -1.0)
            ]
            (high, more), (low, less) = ends
            by = self._forms(k, (high, low, 2.0 * steps[k])).imag / STEP
            self.by[k] = factor**2 * by + factor * (more - less) / steps[k] * values

    def _clear(self, variable: int | None, step: float) -> Array:
        """Clear height of each surface, and how it follows a variable."""
        trace, heights = self.trace, self.trace.heights[self.inner.stop :]
        squares = np.sum(heights**2, axis=-1)
        rays = np.argmax(squares, axis=0)
        surfaces = np.arange(squares.shape[1])
        clear = np.sqrt(squares[rays, surfaces])
        if variable is None:
            return np.asarray(clear)
        by = trace.heights_by[self.inner.stop :][rays, surfaces, :, variable]
        return np.asarray(clear + step * np.sum(heights[rays, surfaces] * by, axis=-1) / clear)

    def _changes(self, lens: Lens, clear_mm: Array) -> tuple[Changes, float]:
        """Of a lens whose surfaces all have a clear height and a radius; and by what they are multiplied."""
        own, whole = self.own, _sized(lens, clear_mm)
        study = own.study
        changes = changes_of(
            whole, study.perturbations, own._sizes, study.pivot_z_mm, self.wavelength_um, False
        )
        return changes, own.factor(whole)

    def _forms(self, moved: int | None, ends: tuple[Changes, Changes, float] | None) -> Array:
        """At the lens itself, or a complex step of one variable away."""
        paths = self._paths(self.trace, moved)
        changes, figures = self.changes, figures_on(paths, self.changes)
        if ends is not None:
            high, low, width = ends
            first = changes.first + 1j * STEP * (high.first - low.first) / width
            changes = replace(changes, first=first)
            still = self._paths(self.trace, None)
            for k, pair in enumerate(zip(figures_on(still, high), figures_on(still, low), strict=True)):
                change = 1j * STEP * (pair[0].sag - pair[1].sag) / width
                figures[k] = replace(figures[k], sag=figures[k].sag + change)
        slopes = 1e3 / self.wavelength_um * first_by(paths, changes, figures)
        cosines, n = paths.cosines, len(self.stop.points)
        forms = []
        for k in range(self.count):
            part = slice(k * n, (k + 1) * n)
            field = FieldDifferentials(
                weights_over_stop(cosines[part], self.stop),
                basis_of(cosines[part]),
                slopes[part],
                np.zeros((n, 0)),
            )
            forms.append((field.registered.T * field.weights) @ field.registered)
        return np.stack(forms)

    def _paths(self, trace: GradientTrace, moved: int | None) -> Paths:
        heights, ends = trace.heights[self.inner], trace.plane_points[self.inner, 0]
        shapes = [surface.shape for surface in self.lens.surfaces]
        vertices: Array = self.lens.vertex_z_mm
        object_z: complex = self.lens.object_z_mm
        if moved is not None:
            heights = heights + 1j * STEP * trace.heights_by[self.inner, ..., moved]
            ends = ends + 1j * STEP * trace.plane_points_by[self.inner, 0, :, moved]
            shapes, vertices, object_z = self.problem.placed(self.point, moved, 1j * STEP)
        plane_z = vertices[-1] + self.own.study.sampling.plane_distance_mm
        origins = np.column_stack([self.fields_mm, np.full(len(heights), object_z)])
        arrivals = np.column_stack([ends, np.full(len(heights), plane_z)])
        return Paths(tuple(shapes), vertices, self.system.index[0], origins, heights, arrivals)


def _sized(lens: Lens, clear_mm: Array) -> Lens:
    """The lens with clear heights where it has none, and no planes."""
    surfaces = [
        s if s.semi_diameter_mm is not None else s.model_copy(update={"semi_diameter_mm": float(c)})
        for s, c in zip(lens.surfaces, clear_mm, strict=True)
    ]
    return _bent(lens.model_copy(update={"surfaces": tuple(surfaces)}))


def _bent(lens: Lens) -> Lens:
    """The lens with planes that are bent by next to nothing, so that radii may err by nothing."""
    surfaces = []
    for surface in lens.surfaces:
        keys = [k for k in surface.shape_keys if k.startswith("radius") and getattr(surface, k) is None]
        surfaces.append(surface.model_copy(update=dict.fromkeys(keys, 1.0 / FLATTEST_PER_MM)))
    return lens.model_copy(update={"surfaces": tuple(surfaces)})
