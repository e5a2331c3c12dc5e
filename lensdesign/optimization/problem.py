"""A specification as goals and constraints on a unit box, with exact gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.deadlines import check_time
from lensdesign.errors import DesignError
from lensdesign.lens.lens import Lens, ObjectSpace
from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.registry import class_with
from lensdesign.lens.temperature import lens_at_temperature
from lensdesign.optimization.as_built import AsBuiltValues, LossValues, read_as_built
from lensdesign.optimization.heated import Heat, Heated
from lensdesign.optimization.nlopt_driver import Evaluation
from lensdesign.optimization.operands.glass import SEMI_DIAMETER_STEP_MM
from lensdesign.optimization.operands.operand import LIMIT_MARGIN, Row, State
from lensdesign.optimization.operands.requirements import constraint_operands, goal_operands
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import VariableRange
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from lensdesign.raytrace.gradients import GradientTrace, Variable, gradient_trace


@dataclass(frozen=True)
class Rays:
    """Rays by which a lens is judged: object point, and stop point as a share of its semi-diameter."""

    fields_mm: Array
    pupil: Array

    def with_rays(self, other: Rays) -> Rays:
        """Both sets, each ray once."""
        both = np.concatenate(
            [np.hstack([self.fields_mm, self.pupil]), np.hstack([other.fields_mm, other.pupil])]
        )
        _, first = np.unique(np.round(both, 9), axis=0, return_index=True)
        kept = both[np.sort(first)]
        return Rays(kept[:, :2], kept[:, 2:])

    def all_round(self) -> Rays:
        """These rays with their mirror images at x = 0, in eight azimuths: for what has no symmetry."""
        mirrored = Rays(self.fields_mm * [-1.0, 1.0], self.pupil * [-1.0, 1.0])
        both, result = self.with_rays(mirrored), self
        for azimuth in 0.25 * math.pi * np.arange(8):
            turn = np.array([[math.cos(azimuth), math.sin(azimuth)], [-math.sin(azimuth), math.cos(azimuth)]])
            result = result.with_rays(Rays(both.fields_mm @ turn, both.pupil @ turn))
        return result

    def take(self, which: NDArray[np.int64]) -> Rays:
        """Some of the rays."""
        return Rays(self.fields_mm[which], self.pupil[which])


def sample_rays(
    half_field_mm: float, fields: int, fan: int, skew: int, heights: tuple[float, ...] = ()
) -> Rays:
    """Field heights along y, each with a meridional fan and rays over half of the stop beside it.

    The other half, and fields along other azimuths, are the same by symmetry where the lens has it.

    Parameters
    ----------
    half_field_mm
        Largest field height.
    fields, fan
        Number of field heights, and of rays in each fan.
    skew
        Number of azimuths, and of rings, of the skew rays.
    heights
        More field heights.
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
        What is asked.
    base
        The lens whose fixed values count (the specification's own, perhaps with another glass).
    temperature_c
        The problem of the lens at this temperature alone, on the same unit box. None is that of the lens as
        designed, and with it those of the specification's temperatures, as `heated`.

    Raises
    ------
    MaterialError
        If of a glass it is not known what heat does to it, where temperatures are asked for.
    """

    def __init__(self, specification: Specification, base: Lens, temperature_c: float | None = None) -> None:
        self.specification, self.base = specification, base
        self.ranges: tuple[VariableRange, ...] = tuple(v for v in specification.variables if not v.discrete)
        self.variables: tuple[Variable, ...] = tuple(v.variable() for v in self.ranges)
        limits = np.array([v.limits() for v in self.ranges]).reshape(-1, 2)
        self.lower, self.width = limits[:, 0], limits[:, 1] - limits[:, 0]
        self.rotational = all(surface.shape.ROTATIONAL for surface in base.surfaces)
        self._tolerances = specification.as_built
        self._as_built: tuple[tuple[bytes, bool], AsBuiltValues] | None = None
        self._losses: tuple[tuple[bytes, bool], LossValues] | None = None
        self._hot: tuple[tuple[bytes, bool], Heated] | None = None
        self.heat, self.heated = self._temperatures(temperature_c)

    def _temperatures(self, temperature_c: float | None) -> tuple[Heat | None, tuple[DesignProblem, ...]]:
        """The temperature of this problem, or the problems at those that are asked for."""
        asked = self.specification.environment
        if asked is None:
            return None, ()
        if temperature_c is not None:
            return Heat(self.base, self.variables, temperature_c, asked.mount_expansion_per_k), ()
        others = (DesignProblem(self.specification, self.base, t) for t in asked.temperatures_c)
        return None, tuple(others)

    def sample_rays(self, fields: int, fan: int, skew: int, heights: tuple[float, ...] = ()) -> Rays:
        """As :func:`sample_rays`, all round where a surface is none of revolution."""
        rays = sample_rays(self.base.half_field_mm, fields, fan, skew, heights)
        return rays if self.rotational else rays.all_round()

    @cached_property
    def compiled(self) -> tuple[CompiledSystem, ...]:
        """The fixed values, at each wavelength."""
        base = self.base if self.heat is None else self.heat.with_glasses(self.base)
        return tuple(compile_system(base, w) for w in base.wavelengths_um)

    def to_unit(self, lens: Lens) -> Array:
        """Point of the unit box nearest to a lens."""
        values = np.array([_value(lens, v) for v in self.variables])
        return np.clip((values - self.lower) / self.width, 0.0, 1.0)

    def lens_at(self, point: Array) -> Lens:
        """The lens at a point of the unit box, with semi-diameters as given; not validated."""
        return self._designed(point) if self.heat is None else self._heated(point, False).lens

    def _designed(self, point: Array) -> Lens:
        changes: dict[int, dict[str, object]] = {}
        scene = self.base.object
        for variable, value in zip(self.variables, self.lower + self.width * point, strict=True):
            mine = changes.setdefault(variable.surface, {})
            if variable.kind == "working_distance":
                scene = ObjectSpace(**(scene.model_dump() | {"working_distance_mm": float(value)}))
            elif variable.kind == "thickness":
                mine["thickness_mm"] = float(value)
            else:
                shape = class_with(variable.kind)
                surface = self.base.surfaces[variable.surface]
                values = {key: getattr(surface, key) for key in shape.KEYS} | mine
                mine |= shape.changed_keys(values, variable.kind, value)
        surfaces = [s.model_copy(update=changes.get(i, {})) for i, s in enumerate(self.base.surfaces)]
        return self.base.model_copy(update={"surfaces": tuple(surfaces), "object": scene})

    def _heated(self, point: Array, derivatives: bool) -> Heated:
        """The lens at the temperature, which follows from that as designed, rim rays of the stop and all."""
        assert self.heat is not None  # whoever asks looks
        key = point.tobytes(), derivatives
        if self._hot is None or self._hot[0] != key:
            self._hot = key, self.heat.at(self._cold.state(point, self._rim, derivatives))
        return self._hot[1]

    @cached_property
    def _cold(self) -> DesignProblem:
        bare = self.specification.model_copy(update={"environment": None, "tolerances": None})
        return DesignProblem(bare, self.base)

    @cached_property
    def _rim(self) -> Rays:
        return self.sample_rays(3, 3, 4)

    def state(self, point: Array, rays: Rays, derivatives: bool = True) -> State:
        """Trace rays through the lens at a point of the unit box, with derivatives or none."""
        heat = self.heat
        return State(
            self.lens_at(point),
            self.variables if derivatives else (),
            rays.fields_mm,
            tuple(self._trace(point, base, rays, derivatives) for base in self.compiled),
            self.as_built(point, derivatives),
            None if heat is None else heat.temperature_c,
            None if heat is None else heat.sizes,
            tuple(other.state(point, rays, derivatives) for other in self.heated),
            self.losses(point, derivatives),
        )

    def trace(
        self, point: Array, rays: Rays, derivatives: bool, planes_mm: Array | None, wavelength: int
    ) -> GradientTrace:
        """Trace rays at a wavelength of that number to other planes, which heat does not move.

        None are the sensor's planes, which it does move.
        """
        return self._trace(point, self.compiled[wavelength], rays, derivatives, planes_mm)

    def _trace(
        self,
        point: Array,
        base: CompiledSystem,
        rays: Rays,
        derivatives: bool,
        planes_mm: Array | None = None,
    ) -> GradientTrace:
        """To some planes, or to those of the sensor."""
        check_time()
        lens, chain = self.lens_at(point), None
        stop = self.base.stop_semi_diameter_mm if self.specification.optimize.stop == "fixed" else None
        variables = self.variables if derivatives else ()
        if self.heat is not None:
            hot = self._heated(point, derivatives)
            stop = hot.stop_semi_diameter_mm
            if derivatives:
                variables = self.heat.own
                chain = hot.chain if planes_mm is None else hot.chain.to_still_planes(len(planes_mm))
        return gradient_trace(
            _shaped(base, lens),
            lens.object_z_mm,
            np.array(lens.sensor.plane_distances_mm) if planes_mm is None else planes_mm,
            lens.stop_index,
            stop,
            lens.object.numerical_aperture,
            rays.fields_mm,
            rays.pupil,
            variables,
            chain,
        )

    def placed(self, point: Array, variable: int, step: complex) -> tuple[list[Shape], Array, complex]:
        """Shapes, vertices and the object's z, a step of a variable away, complex for derivatives."""
        lens = self.lens_at(point)
        shapes = [surface.shape for surface in lens.surfaces]
        own, by = self.variables, np.eye(len(self.variables))[:, variable]
        if self.heat is not None:
            own, by = self.heat.own, self._heated(point, True).chain.variables[:, variable]
        vertices, object_z = lens.vertex_z_mm.astype(complex), complex(lens.object_z_mm)
        for one, share in zip(own, step * by, strict=True):
            if one.of_shape and share:
                shapes[one.surface] = shapes[one.surface].moved(one.kind, share)
            elif one.kind == "thickness":
                vertices += share * (np.arange(len(vertices)) > one.surface)
            elif one.kind == "working_distance":
                object_z -= share
        return shapes, vertices, object_z

    def planes_by(self, point: Array, variable: int) -> Array:
        """Derivatives of the sensor planes' distances by a variable: heat moves them with the lens."""
        if self.heat is None:
            return np.zeros(len(self.base.sensor.plane_distances_mm))
        return np.asarray(self._heated(point, True).chain.planes[:, variable])

    def predicted(self, point: Array, lens: Lens | None = None) -> tuple[AsBuiltValues, ...]:
        """What the specification's tolerances make of the lens at a point, whether or not that is asked for.

        As designed, and at each temperature; by the function that predicts finished lenses, which goes to
        second order, and not by the values of the search.

        Parameters
        ----------
        point
            Of the unit box.
        lens
            The finished lens of the point; default: finished by a few rays.

        Raises
        ------
        DesignError
            If the specification names no tolerances, or the lens cannot be finished.
        """
        tolerances = self.specification.tolerances
        if tolerances is None:
            raise DesignError("lenses as built need their tolerances: [tolerances] study")
        study = read_as_built(tolerances)
        lens = finished_lens(self, point, self._rim) if lens is None else lens
        found = (study.predict(one) for one in (lens, *self._at_temperatures(lens)))
        return tuple(
            AsBuiltValues(
                np.array(one.rms_waves), np.zeros((len(one.rms_waves), 0)), 1.0 - one.good, np.zeros(0)
            )
            for one in found
        )

    def _at_temperatures(self, lens: Lens) -> list[Lens]:
        """A finished lens at each temperature that is asked for."""
        asked = self.specification.environment
        if asked is None:
            return []
        mount = asked.mount_expansion_per_k
        return [lens_at_temperature(lens, t, mount_expansion_per_k=mount) for t in asked.temperatures_c]

    def as_built(self, point: Array, derivatives: bool = True) -> AsBuiltValues | None:
        """What is predicted of the lens at a point of the unit box; None where nothing asks for it."""
        if self._tolerances is None or not self.specification.asks_yields:
            return None
        key = point.tobytes(), derivatives
        if self._as_built is None or self._as_built[0] != key:
            self._as_built = key, self._tolerances.evaluate(self, point, derivatives)
        return self._as_built[1]

    def losses(self, point: Array, derivatives: bool = True) -> LossValues | None:
        """Reconstruction losses of the lens at a point of the unit box; None where nothing asks for them."""
        if self._tolerances is None or not self.specification.asks_losses:
            return None
        key = point.tobytes(), derivatives
        if self._losses is None or self._losses[0] != key:
            self._losses = key, self._tolerances.losses(self, point, derivatives)
        return self._losses[1]

    def rows(
        self, point: Array, rays: Rays, final: bool = False, derivatives: bool = True
    ) -> tuple[list[Row], list[Row]]:
        """Goals and constraints by name, with derivatives by the variables' own values."""
        state = self.state(point, rays, derivatives)
        return goal_operands(self.specification, state), constraint_operands(self.specification, state, final)

    def evaluate(self, point: Array, rays: Rays, final: bool = False) -> Evaluation:
        """Goals and constraints for nlopt, with derivatives by the unit variables."""
        goals, constraints = self.rows(point, rays, final)
        return Evaluation(
            np.concatenate([r.values for r in goals]),
            np.concatenate([r.by for r in goals]) * self.width,
            np.concatenate([np.empty(0), *(r.values for r in constraints)]),
            np.concatenate([np.empty((0, len(point))), *(r.by for r in constraints)]) * self.width,
        )


def finished_lens(problem: DesignProblem, point: Array, rays: Rays) -> Lens:
    """The lens at a point with every semi-diameter filled in, validated.

    A surface without one gets what its rays need, rounded up; the stop, where it follows the
    numerical aperture, gets the size that this takes.

    Raises
    ------
    DesignError
        If that is no lens: surfaces cross, say, or no ray passes.
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
    """Radial heights of all rays on a surface, those at other temperatures on it as it is when it is cold."""
    heights = [
        np.linalg.norm(trace.heights[trace.ok, surface], axis=-1)
        / (1.0 if one.sizes is None else one.sizes[surface])
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
    if variable.kind == "thickness":
        return surface.thickness_mm or 0.0
    return surface.shape.term(variable.kind)


def _shaped(base: CompiledSystem, lens: Lens) -> CompiledSystem:
    """The base system with the shape of a lens; indices and apertures stay."""
    vertex = np.zeros_like(base.vertex)
    vertex[0, :, 2] = lens.vertex_z_mm
    return replace(base, vertex=vertex, shapes=tuple(s.shape for s in lens.surfaces))
