"""A lens of a search and its perturbations at one wavelength, with derivatives by complex step.

A complex step through :mod:`tolerancing.prediction.paths` differentiates first-order responses to
perturbations by design variables, along rays through fixed points of the stop. The changes of the lens's
numbers that a perturbation causes vary smoothly with the design and are differentiated by central
differences.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens
from lensdesign.optimization.problem import DesignProblem, Rays
from lensdesign.raytrace.gradients import GradientTrace, Variable
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.prediction.derivatives import sag_errors_on
from tolerancing.prediction.paths import Paths, SagErrors
from tolerancing.prediction.system import Changes, changes_of
from tolerancing.prediction.wavefront_prediction import drawn_amounts
from tolerancing.study.study import Study

STEP, DIFFERENCE_STEP = 1e-30, 1e-4
"""The complex step, and the step of central differences as a fraction of the range of a variable."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """Perturbations and compensators of a study, in the order of all matrices of a search.

    Attributes
    ----------
    study : Study
    factor
        Factor that multiplies the tolerances of a lens.
    """

    study: Study
    factor: Callable[[Lens], float]

    @cached_property
    def parameters(self) -> tuple[PerturbedParameter, ...]:
        """Perturbations, followed by the compensators."""
        return (*self.study.perturbations, *self.study.compensators)

    @cached_property
    def sizes(self) -> Array:
        """Approximate size of each perturbation and compensator."""
        study = self.study
        return np.array([*(p.tolerance for p in study.perturbations), *(c.limit for c in study.compensators)])

    @cached_property
    def limits(self) -> Array:
        """Largest value of each compensator, shape (k,)."""
        return np.array([c.limit for c in self.study.compensators])

    @cached_property
    def amounts(self) -> Array:
        """Amount of each change in each drawn lens, shape (draws, d)."""
        # Number of Sobol draws that estimate the yield in a search.
        search_draws = 2048
        return drawn_amounts(self.study, search_draws)


class DesignPoint:
    """The lens at a point of a search's unit box, at one wavelength.

    Parameters
    ----------
    scatter
    problem, point
        Search problem, and position of the lens in its unit box.
    variables
        Indices of the variables of the derivatives; empty for no derivatives.
    wavelength
        Index of the specification's wavelength.

    Attributes
    ----------
    changes : Changes
        Changes of the perturbations and compensators.
    multiplier : ndarray, shape (d + k,)
        Factor of the response to each change: the factor of the tolerances for perturbations, and -1 for
        compensators, because their path is subtracted.

    Raises
    ------
    DesignError
        If the rays that determine clear heights do not pass.
    """

    def __init__(
        self,
        scatter: Scatter,
        problem: DesignProblem,
        point: Array,
        variables: tuple[Variable, ...],
        wavelength: int,
    ) -> None:
        self.scatter, self.problem, self.point, self.variables = scatter, problem, point, variables
        self.wavelength = wavelength
        self.wavelength_um = problem.base.wavelengths_um[wavelength]
        self.lens = problem.lens_at(point)
        self._rim = _rim_trace(problem, point, bool(variables), wavelength)
        self.changes, self._factor = self._changes_of(self.lens, self._clear(None, 0.0))
        self.multiplier = self._multiplier(self._factor)
        self._ends: dict[int, tuple[Changes, Changes, float, complex]] = {}

    def moved_changes(self, variable: int) -> tuple[Changes, Array]:
        """Return changes and multiplier after a complex step of a variable."""
        high, low, width, factor = self._moved(variable)
        first = self.changes.first + 1j * STEP * (high.first - low.first) / width
        return replace(self.changes, first=first), self._multiplier(factor)

    def sag_errors(self, paths: Paths) -> list[SagErrors]:
        """Return the sag errors of irregularities at rays."""
        return sag_errors_on(paths, self.changes)

    def moved_sag_errors(self, paths: Paths, nominal_paths: Paths, variable: int) -> list[SagErrors]:
        """Return the sag errors after a complex step of a variable, for moved rays and nominal rays."""
        high, low, width, _ = self._moved(variable)
        step = 1j * STEP / width
        found = []
        for own, upper, lower in zip(
            self.sag_errors(paths),
            sag_errors_on(nominal_paths, high),
            sag_errors_on(nominal_paths, low),
            strict=True,
        ):
            found.append(
                replace(
                    own,
                    sag=own.sag + step * (upper.sag - lower.sag),
                    slope_x=own.slope_x + step * (upper.slope_x - lower.slope_x),
                    slope_y=own.slope_y + step * (upper.slope_y - lower.slope_y),
                )
            )
        return found

    def _moved(self, k: int) -> tuple[Changes, Changes, float, complex]:
        """Return the changes at two values of a variable, their distance, and the complex factor."""
        if k not in self._ends:
            axis, step = np.eye(len(self.point))[k], DIFFERENCE_STEP * self.problem.width[k]
            (high, more), (low, less) = (
                self._changes_of(
                    self.problem.lens_at(self.point + sign * DIFFERENCE_STEP * axis),
                    self._clear(k, sign * step),
                )
                for sign in (1.0, -1.0)
            )
            factor = self._factor + 1j * STEP * (more - less) / (2.0 * step)
            self._ends[k] = high, low, 2.0 * step, factor
        return self._ends[k]

    def _multiplier(self, factor: complex) -> Array:
        compensators = len(self.scatter.limits)
        perturbed = self.changes.count - compensators
        return np.concatenate([np.full(perturbed, factor), np.full(compensators, -1.0)])

    def _clear(self, variable: int | None, step: float) -> Array:
        """Return the clear height of each surface (stop: semi-diameter) after a step of a variable."""
        trace, stop = self._rim, self.lens.stop_index
        squares = np.sum(trace.heights**2, axis=-1)
        rays = np.argmax(squares, axis=0)
        surfaces = np.arange(squares.shape[1])
        clear = np.sqrt(squares[rays, surfaces])
        clear[stop] = trace.stop_semi_diameter_mm
        if variable is None:
            return np.asarray(clear)
        by = np.sum(
            trace.heights[rays, surfaces] * trace.heights_by[rays, surfaces, :, variable], axis=-1
        ) / np.maximum(clear, np.finfo(float).tiny)
        by[stop] = trace.stop_semi_diameter_by[variable]
        return np.asarray(clear + step * by)

    def _changes_of(self, lens: Lens, clear_mm: Array) -> tuple[Changes, float]:
        """Return the changes and the tolerance factor of a lens, with all clear heights and radii defined."""
        whole, scatter = sized(lens, clear_mm), self.scatter
        pivot = scatter.study.pivot_z_mm
        changes = changes_of(whole, scatter.parameters, scatter.sizes, pivot, self.wavelength_um, False)
        return changes, scatter.factor(whole)


def rim_heights(problem: DesignProblem, point: Array) -> Array:
    """Return the clear height of each surface of the lens at a point of the unit box, in mm.

    The value of the stop is its semi-diameter.

    Raises
    ------
    DesignError
        If rays from the rim of the field do not all pass.
    """
    trace = _rim_trace(problem, point, False, 0)
    heights = np.max(np.hypot(trace.heights[..., 0], trace.heights[..., 1]), axis=0)
    heights[problem.base.stop_index] = trace.stop_semi_diameter_mm
    return np.asarray(heights)


def _rim_trace(problem: DesignProblem, point: Array, derivatives: bool, wavelength: int) -> GradientTrace:
    """Trace rays from the edge of the field through the rim of the stop."""
    # Rays that determine the clear height of a surface that has none.
    rim_points = 16
    angles = 2.0 * np.pi * np.arange(rim_points) / rim_points
    edge = np.tile([0.0, problem.lens_at(point).half_field_mm], (rim_points, 1))
    rim = Rays(edge, np.column_stack([np.cos(angles), np.sin(angles)]))
    trace = problem.trace(point, rim, derivatives, np.zeros(1), wavelength)
    if not np.all(trace.ok):
        raise DesignError("rays from the rim of the field do not all pass the lens")
    return trace


class TracedRays:
    """Rays of a design to a plane, with their paths after a complex step of each variable.

    Parameters
    ----------
    design
    rays
        Object points and stop points.
    plane_mm
        Distance of the plane from the exit vertex; None is the first sensor plane, which moves with
        temperature.

    Attributes
    ----------
    trace : GradientTrace
    """

    def __init__(self, design: DesignPoint, rays: Rays, plane_mm: float | None) -> None:
        self.design, self.rays = design, rays
        problem, derivatives = design.problem, bool(design.variables)
        planes = None if plane_mm is None else np.array([plane_mm])
        self.trace: GradientTrace = problem.trace(design.point, rays, derivatives, planes, design.wavelength)
        self.ok: NDArray[np.bool_] = self.trace.ok
        self.plane_mm = design.lens.sensor.plane_distances_mm[0] if plane_mm is None else plane_mm
        self._of_sensor = plane_mm is None

    @cached_property
    def nominal_paths(self) -> Paths:
        """Paths through the lens itself."""
        return self._paths(None)

    def moved(self, variable: int) -> Paths:
        """Return the paths after a complex step of a variable."""
        return self._paths(variable)

    def _paths(self, moved: int | None) -> Paths:
        design, trace = self.design, self.trace
        heights, ends = trace.heights, trace.plane_points[:, 0]
        shapes = [surface.shape for surface in design.lens.surfaces]
        vertices: Array = design.lens.vertex_z_mm
        object_z: complex = design.lens.object_z_mm
        plane: complex = self.plane_mm
        if moved is not None:
            heights = heights + 1j * STEP * trace.heights_by[..., moved]
            ends = ends + 1j * STEP * trace.plane_points_by[:, 0, :, moved]
            shapes, vertices, object_z = design.problem.placed(design.point, moved, 1j * STEP)
            if self._of_sensor:
                plane = plane + 1j * STEP * design.problem.planes_by(design.point, moved)[0]
        origins = np.column_stack([self.rays.fields_mm, np.full(len(heights), object_z)])
        arrivals = np.column_stack([ends, np.full(len(heights), vertices[-1] + plane)])
        index = design.problem.compiled.index[design.wavelength]
        return Paths(tuple(shapes), vertices, index, origins, heights, arrivals)


def sized(lens: Lens, clear_mm: Array) -> Lens:
    """Return the lens with clear heights for all surfaces, and with planes slightly curved."""
    surfaces = [
        s
        if s.semi_diameter_mm is not None and number != lens.stop_index
        else s.model_copy(update={"semi_diameter_mm": float(c)})
        for number, (s, c) in enumerate(zip(lens.surfaces, clear_mm, strict=True))
    ]
    return bent(lens.model_copy(update={"surfaces": tuple(surfaces)}))


def bent(lens: Lens) -> Lens:
    """Return the lens with planes replaced by very small curvatures, so that radii can have tolerances."""
    surfaces = []
    # Curvature that replaces a plane, whose radius cannot have a tolerance.
    flattest_per_mm = 1e-7
    for surface in lens.surfaces:
        keys = [k for k in surface.shape_keys if k.startswith("radius") and getattr(surface, k) is None]
        surfaces.append(surface.model_copy(update=dict.fromkeys(keys, 1.0 / flattest_per_mm)))
    return lens.model_copy(update={"surfaces": tuple(surfaces)})
