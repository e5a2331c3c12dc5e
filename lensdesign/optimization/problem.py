"""A specification as goals and constraints over a unit box of variables, with exact gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import check_time
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens, ObjectSpace
from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.registry import class_with
from lensdesign.optimization.as_built import AsBuiltValues, LossValues, read_as_built
from lensdesign.optimization.nlopt_driver import Evaluation
from lensdesign.optimization.operands.ghosts import GhostValues, ghost_values
from lensdesign.optimization.operands.glass import SEMI_DIAMETER_STEP_MM
from lensdesign.optimization.operands.operand import LIMIT_MARGIN, Operand, State
from lensdesign.optimization.operands.requirements import constraint_operands, goal_operands
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import VariableRange
from lensdesign.optimization.specification_check import at_temperatures
from lensdesign.optimization.temperature_derivatives import HeatedLens, TemperatureChange
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.gradients import GradientTrace, Variable, at_wavelengths, gradient_traces


@dataclass(frozen=True)
class Rays:
    """Rays by which a lens is evaluated.

    Attributes
    ----------
    fields_mm : ndarray, shape (n, 2)
        Object point of each ray.
    pupil : ndarray, shape (n, 2)
        Stop point of each ray, relative to the semi-diameter.
    """

    fields_mm: Array
    pupil: Array

    def with_rays(self, other: Rays) -> Rays:
        """Return the union of both sets."""
        both = np.concatenate(
            [np.hstack([self.fields_mm, self.pupil]), np.hstack([other.fields_mm, other.pupil])]
        )
        _, first = np.unique(np.round(both, 9), axis=0, return_index=True)
        kept = both[np.sort(first)]
        return Rays(kept[:, :2], kept[:, 2:])

    def all_round(self) -> Rays:
        """Return these rays and their mirror images at x = 0, in eight azimuths."""
        mirrored = Rays(self.fields_mm * [-1.0, 1.0], self.pupil * [-1.0, 1.0])
        both, result = self.with_rays(mirrored), self
        for azimuth in 0.25 * math.pi * np.arange(8):
            turn = np.array([[math.cos(azimuth), math.sin(azimuth)], [-math.sin(azimuth), math.cos(azimuth)]])
            result = result.with_rays(Rays(both.fields_mm @ turn, both.pupil @ turn))
        return result

    def select(self, indices: NDArray[np.int64]) -> Rays:
        """Return the rays with the given indices."""
        return Rays(self.fields_mm[indices], self.pupil[indices])


def sample_rays(
    half_field_mm: float, fields: int, fan: int, skew: int, heights: tuple[float, ...] = ()
) -> Rays:
    """Return rays from field heights along y: a meridional fan, and skew rays over half of the stop.

    The other half of the stop, and fields at other azimuths, follow from the symmetry of the lens.

    Parameters
    ----------
    half_field_mm
        Largest field height.
    fields, fan
        Number of field heights, and of rays in each fan.
    skew
        Number of azimuths, and of rings, of the skew rays.
    heights
        Additional field heights.
    """
    y = np.union1d(np.linspace(0.0, half_field_mm, fields), heights)
    azimuth = np.pi * np.arange(1, skew + 1) / (skew + 1) - 0.5 * np.pi
    radius = np.arange(1, skew + 1) / skew
    fan_points = np.stack([np.zeros(fan), np.linspace(-1.0, 1.0, fan)], axis=-1)
    skew_points = np.stack(
        [np.outer(radius, np.cos(azimuth)).ravel(), np.outer(radius, np.sin(azimuth)).ravel()], axis=-1
    )
    pupil = np.concatenate([fan_points, skew_points])
    fields_mm = np.column_stack([np.zeros(len(y)), y])
    return Rays(np.repeat(fields_mm, len(pupil), axis=0), np.tile(pupil, (len(y), 1)))


class DesignProblem:
    """Goals and constraints of a specification, evaluated on chosen rays.

    Parameters
    ----------
    specification
        Variables, goal and constraints.
    base
        The lens with the fixed values: that of the specification, possibly with another glass.
    temperature_c
        Temperature of the lens, on the same unit box. With None (the default), the problem is that of the
        lens as designed, and `heated` has the problems at the temperatures of the specification.

    Raises
    ------
    MaterialError
        If the specification has temperatures and thermal data of a glass are not known.
    """

    def __init__(self, specification: Specification, base: Lens, temperature_c: float | None = None) -> None:
        self.specification, self.base = specification, base
        self.ranges: tuple[VariableRange, ...] = tuple(v for v in specification.variables if not v.discrete)
        self.variables: tuple[Variable, ...] = tuple(v.variable() for v in self.ranges)
        limits = np.array([v.limits() for v in self.ranges]).reshape(-1, 2)
        self.lower, self.width = limits[:, 0], limits[:, 1] - limits[:, 0]
        self.rotational = all(surface.shape.ROTATIONAL for surface in base.surfaces)
        self._tolerances = specification.as_built
        self._last: tuple[bytes, Lens] | None = None
        self._as_built: tuple[tuple[bytes, bool], AsBuiltValues] | None = None
        self._losses: tuple[tuple[bytes, bool], LossValues] | None = None
        self._ghosts: tuple[tuple[bytes, bool], GhostValues] | None = None
        self._hot: tuple[tuple[bytes, bool], HeatedLens] | None = None
        self.temperature_change, self.heated = self._temperatures(temperature_c)

    def _temperatures(
        self, temperature_c: float | None
    ) -> tuple[TemperatureChange | None, tuple[DesignProblem, ...]]:
        """Return the temperature of this problem, or the problems at all temperatures."""
        asked = self.specification.environment
        if asked is None:
            return None, ()
        if temperature_c is not None:
            return TemperatureChange(
                self.base, self.variables, temperature_c, asked.mount_expansion_per_k
            ), ()
        others = (DesignProblem(self.specification, self.base, t) for t in asked.temperatures_c)
        return None, tuple(others)

    def sample_rays(self, fields: int, fan: int, skew: int, heights: tuple[float, ...] = ()) -> Rays:
        """Return the rays of :func:`sample_rays`; at all azimuths for a lens without rotational symmetry."""
        rays = sample_rays(self.base.half_field_mm, fields, fan, skew, heights)
        return rays if self.rotational else rays.all_round()

    @cached_property
    def compiled(self) -> CompiledSystem:
        """Compiled base lens at all wavelengths."""
        base = (
            self.base if self.temperature_change is None else self.temperature_change.with_glasses(self.base)
        )
        return at_wavelengths([compile_system(base, w) for w in base.wavelengths_um])

    def to_unit(self, lens: Lens) -> Array:
        """Return the point of the unit box that is nearest to a lens."""
        values = np.array([_value(lens, v) for v in self.variables])
        return np.clip((values - self.lower) / self.width, 0.0, 1.0)

    def lens_at(self, point: Array) -> Lens:
        """Return the lens at a point of the unit box, with semi-diameters as given, not validated."""
        return self._designed(point) if self.temperature_change is None else self._heated(point, False).lens

    def _designed(self, point: Array) -> Lens:
        """Return the lens at a point; the state and the trace at each wavelength need the same one."""
        key, last = point.tobytes(), self._last
        if last is None or last[0] != key:
            last = self._last = key, self._lens_with(self.lower + self.width * point)
        return last[1]

    def _lens_with(self, variables: Array) -> Lens:
        changes: dict[int, dict[str, object]] = {}
        scene = self.base.object
        for variable, value in zip(self.variables, variables, strict=True):
            own = changes.setdefault(variable.surface, {})
            if variable.kind == "working_distance":
                scene = ObjectSpace(**(scene.model_dump() | {"working_distance_mm": float(value)}))
            elif variable.kind == "log_field":
                scene = ObjectSpace(**(scene.model_dump() | {"field_diameter_mm": math.exp(value)}))
            elif variable.kind == "thickness":
                own["thickness_mm"] = float(value)
            else:
                shape = class_with(variable.kind)
                surface = self.base.surfaces[variable.surface]
                values = {key: getattr(surface, key) for key in shape.KEYS} | own
                own |= shape.changed_keys(values, variable.kind, value)
        surfaces = [s.model_copy(update=changes.get(i, {})) for i, s in enumerate(self.base.surfaces)]
        return self.base.model_copy(update={"surfaces": tuple(surfaces), "object": scene})

    def _heated(self, point: Array, derivatives: bool) -> HeatedLens:
        """Return the lens at the temperature, derived from the lens as designed and its rim rays."""
        assert self.temperature_change is not None  # callers check this
        key = point.tobytes(), derivatives
        if self._hot is None or self._hot[0] != key:
            self._hot = key, self.temperature_change.at(self._cold.state(point, self._rim, derivatives))
        return self._hot[1]

    @cached_property
    def _cold(self) -> DesignProblem:
        bare = self.specification.model_copy(update={"environment": None, "tolerances": None})
        return DesignProblem(bare, self.base)

    @cached_property
    def _rim(self) -> Rays:
        return self.sample_rays(3, 3, 4)

    def state(self, point: Array, rays: Rays, derivatives: bool = True) -> State:
        """Trace rays through the lens at a point of the unit box, with or without derivatives.

        The rays are those of the base lens; their object points are scaled to the field of this lens.
        """
        change, lens = self.temperature_change, self.lens_at(point)
        factor = lens.object.field_diameter_mm / self.base.object.field_diameter_mm
        given, rays = rays, replace(rays, fields_mm=factor * rays.fields_mm)
        return State(
            lens,
            self.variables if derivatives else (),
            rays.fields_mm,
            self._traces(point, self.compiled, rays, derivatives),
            None if change is None else change.temperature_c,
            None if change is None else change.expansion_factors,
            tuple(other.state(point, given, derivatives) for other in self.heated),
            partial(self.as_built, point, derivatives),
            partial(self.losses, point, derivatives),
            partial(self.ghosts, point, derivatives),
        )

    def trace(
        self, point: Array, rays: Rays, derivatives: bool, planes_mm: Array | None, wavelength: int
    ) -> GradientTrace:
        """Trace rays at a wavelength (by index) in air to planes at fixed distances.

        With None, the planes are those of the sensor, which move with the temperature. A cover glass of the
        sensor is not passed.
        """
        index = self.compiled.index[wavelength : wavelength + 1]
        base = replace(self.compiled.without_cover_glass(), trials=None, index=index)
        return self._traces(point, base, rays, derivatives, planes_mm)[0]

    def _traces(
        self,
        point: Array,
        base: CompiledSystem,
        rays: Rays,
        derivatives: bool,
        planes_mm: Array | None = None,
    ) -> tuple[GradientTrace, ...]:
        """Trace rays at the wavelengths of a system to some planes, or to those of the sensor."""
        check_time()
        lens, chain_rule = self.lens_at(point), None
        stop = self.base.stop_semi_diameter_mm if self.specification.optimize.stop == "fixed" else None
        variables = self.variables if derivatives else ()
        if self.temperature_change is not None:
            hot = self._heated(point, derivatives)
            stop = hot.stop_semi_diameter_mm
            if derivatives:
                variables = self.temperature_change.own
                chain_rule = (
                    hot.chain_rule if planes_mm is None else hot.chain_rule.with_fixed_planes(len(planes_mm))
                )
        return gradient_traces(
            _shaped(base, lens),
            lens.object_z_mm,
            np.array(lens.sensor.plane_distances_mm) if planes_mm is None else planes_mm,
            lens.stop_index,
            stop,
            lens.object.numerical_aperture,
            rays.fields_mm,
            rays.pupil,
            variables,
            chain_rule,
        )

    def placed(self, point: Array, variable: int, step: complex) -> tuple[list[Shape], Array, complex]:
        """Return shapes, vertices and object z after a step of a variable, complex for derivatives."""
        lens = self.lens_at(point)
        shapes = [surface.shape for surface in lens.surfaces]
        own, by = self.variables, np.eye(len(self.variables))[:, variable]
        if self.temperature_change is not None:
            own, by = self.temperature_change.own, self._heated(point, True).chain_rule.variables[:, variable]
        vertices, object_z = lens.vertex_z_mm.astype(complex), complex(lens.object_z_mm)
        for one, change in zip(own, step * by, strict=True):
            if one.is_shape_term and change:
                shapes[one.surface] = shapes[one.surface].moved(one.kind, change)
            elif one.kind == "thickness":
                vertices += change * (np.arange(len(vertices)) > one.surface)
            elif one.kind == "working_distance":
                object_z -= change
        return shapes, vertices, object_z

    def planes_by(self, point: Array, variable: int) -> Array:
        """Return the derivatives of the sensor distances by a variable, due to the temperature."""
        if self.temperature_change is None:
            return np.zeros(len(self.base.sensor.plane_distances_mm))
        return np.asarray(self._heated(point, True).chain_rule.planes[:, variable])

    def predicted(self, point: Array, lens: Lens | None = None) -> tuple[AsBuiltValues, ...]:
        """Predict the lens as built at a point, as designed and at each temperature.

        The prediction is that of finished lenses, which is of second order, and not that of the search. The
        yield is that of the limits that a search knows if not all limits of the study are predicted.

        Parameters
        ----------
        point
            Point of the unit box.
        lens
            The finished lens of the point (default: finished with a few rays).

        Raises
        ------
        DesignError
            If the specification has no tolerances, or the lens cannot be finished.
        """
        tolerances = self.specification.tolerances
        if tolerances is None:
            raise DesignError("lenses as built need their tolerances: [tolerances] study")
        study = read_as_built(tolerances)
        lens = finished_lens(self, point, self._rim) if lens is None else lens
        heated = (one for _, one in at_temperatures(lens, self.specification))
        found = (study.predict(one) for one in (lens, *heated))
        return tuple(
            AsBuiltValues(
                np.array(one.rms_waves),
                np.zeros((len(one.rms_waves), 0)),
                1.0 - (one.good if np.isfinite(one.good) else one.within_searched),
                np.zeros(0),
            )
            for one in found
        )

    def as_built(self, point: Array, derivatives: bool = True) -> AsBuiltValues | None:
        """Return predictions of the lens as built at a point of the unit box; None if not needed."""
        if self._tolerances is None or not self.specification.asks_yields:
            return None
        key = point.tobytes(), derivatives
        if self._as_built is None or self._as_built[0] != key:
            self._as_built = key, self._tolerances.evaluate(self, point, derivatives)
        return self._as_built[1]

    def losses(self, point: Array, derivatives: bool = True) -> LossValues | None:
        """Return reconstruction losses of the lens at a point of the unit box; None if not needed."""
        if self._tolerances is None or not self.specification.asks_losses:
            return None
        key = point.tobytes(), derivatives
        if self._losses is None or self._losses[0] != key:
            self._losses = key, self._tolerances.losses(self, point, derivatives)
        return self._losses[1]

    def ghosts(self, point: Array, derivatives: bool = True) -> GhostValues | None:
        """Return the power of ghosts of the lens as designed; None if not needed, or at a temperature."""
        if not self.specification.asks_ghosts or self.temperature_change is not None:
            return None
        key = point.tobytes(), derivatives
        if self._ghosts is None or self._ghosts[0] != key:
            self._ghosts = key, ghost_values(self._lens_with_apertures, point, self.width, derivatives)
        return self._ghosts[1]

    def _lens_with_apertures(self, point: Array) -> Lens:
        """Return the lens at a point, not validated, with the apertures that its rays need."""
        state = self._cold.state(point, self._rim, derivatives=False)
        surfaces = list(state.lens.surfaces)
        for i, surface in enumerate(surfaces):
            semi = surface.semi_diameter_mm
            if i == state.lens.stop_index:
                semi = state.traces[0].stop_semi_diameter_mm
            elif semi is None:
                semi = float(np.max(_heights_mm(state, i), initial=0.0)) or None
            surfaces[i] = surface.model_copy(update={"semi_diameter_mm": semi})
        return state.lens.model_copy(update={"surfaces": tuple(surfaces)})

    def rows(
        self, point: Array, rays: Rays, final: bool = False, derivatives: bool = True
    ) -> tuple[list[Operand], list[Operand]]:
        """Return goals and constraints with derivatives by the values of the variables."""
        state = self.state(point, rays, derivatives)
        return goal_operands(self.specification, state), constraint_operands(self.specification, state, final)

    def evaluate(self, point: Array, rays: Rays, final: bool = False) -> Evaluation:
        """Return goals and constraints for nlopt, with derivatives by the variables of the unit box."""
        goals, constraints = self.rows(point, rays, final)
        return Evaluation(
            np.concatenate([r.values for r in goals]),
            np.concatenate([r.by for r in goals]) * self.width,
            np.concatenate([np.empty(0), *(r.values for r in constraints)]),
            np.concatenate([np.empty((0, len(point))), *(r.by for r in constraints)]) * self.width,
        )

    def constraints_as_goals(self, point: Array, rays: Rays, final: bool = False) -> Evaluation:
        """Return the constraints as goals, without constraints; the goals themselves are not evaluated."""
        rows = constraint_operands(self.specification, self.state(point, rays), final)
        none = np.empty((0, len(point)))
        by = np.concatenate([none, *(r.by for r in rows)]) * self.width
        return Evaluation(np.concatenate([np.empty(0), *(r.values for r in rows)]), by, np.empty(0), none)


def finished_lens(problem: DesignProblem, point: Array, rays: Rays) -> Lens:
    """Return the validated lens at a point with all semi-diameters.

    A surface without a semi-diameter gets that of its rays, rounded up. A stop that follows the numerical
    aperture gets the corresponding size.

    Raises
    ------
    DesignError
        If the result is not a valid lens, for example because surfaces cross or no ray passes.
    """
    state = problem.state(point, rays, derivatives=False)
    lens = state.lens
    surfaces = []
    try:
        for i, surface in enumerate(lens.surfaces):
            if i == lens.stop_index:
                semi = state.traces[0].stop_semi_diameter_mm
            elif surface.semi_diameter_mm is not None:
                semi = surface.semi_diameter_mm
            else:
                heights = _heights_mm(state, i)
                if not len(heights):
                    raise DesignError("no ray passes it")
                semi = _rounded_up_mm(float(np.max(heights)) * (1.0 + LIMIT_MARGIN))
            surfaces.append(surface.replaced(semi_diameter_mm=semi))
        return lens.replaced(surfaces=tuple(surfaces))
    except DesignError as error:
        raise DesignError(
            f"no lens was found: the one that violates the constraints least cannot be made ({error}); widen "
            "the bounds, or start elsewhere"
        ) from None


def _heights_mm(state: State, surface: int) -> Array:
    """Return the radial heights of all rays on a surface, scaled to the size of the surface as designed."""
    heights = [
        np.linalg.norm(trace.heights[trace.ok, surface], axis=-1)
        / (1.0 if one.expansion_factors is None else one.expansion_factors[surface])
        for one in state.all
        for trace in one.traces
    ]
    return np.concatenate(heights)


def _rounded_up_mm(semi_mm: float) -> float:
    return round(math.ceil(semi_mm / SEMI_DIAMETER_STEP_MM) * SEMI_DIAMETER_STEP_MM, 9)


def _value(lens: Lens, variable: Variable) -> float:
    surface = lens.surfaces[variable.surface]
    if variable.kind == "working_distance":
        return lens.object.working_distance_mm
    if variable.kind == "log_field":
        return math.log(lens.object.field_diameter_mm)
    if variable.kind == "thickness":
        return surface.thickness_mm or 0.0
    return surface.shape.term(variable.kind)


def _shaped(base: CompiledSystem, lens: Lens) -> CompiledSystem:
    """Return the base system with the shapes and vertices of a lens; indices and apertures stay."""
    vertex = np.zeros_like(base.vertex)
    vertex[0, :, 2] = lens.vertex_z_mm
    return replace(base, vertex=vertex, shapes=tuple(s.shape for s in lens.surfaces))
