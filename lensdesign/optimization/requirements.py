"""The goals and constraints of a specification, as rows of scaled values with derivatives.

Each value is scaled to about 1. A constraint is kept where its value is not above zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import Shape, directions
from lensdesign.optimization.as_built import AsBuiltValues
from lensdesign.optimization.asked.sections import AS_BUILT_GOALS
from lensdesign.optimization.asked.specification import Specification
from lensdesign.optimization.nlopt_driver import UNTRACEABLE
from lensdesign.tracing.gradients import GradientTrace, Variable

LIMIT_MARGIN = 3e-5
"""Limits are kept by this relative margin, so that a denser check of the result finds them kept too."""

KEPT = 2.0 * LIMIT_MARGIN
"""A scaled square that exceeds its narrowed limit by no more than this keeps the limit as given."""

AS_BUILT_SCALE_WAVES = 0.1
"""Root mean square by which as-built goals are scaled."""

SEMI_DIAMETER_STEP_MM = 0.01
"""Semi-diameters that a specification leaves open are rounded up to this."""

CONIC_EDGE_SHARE = 0.95
"""Surfaces stay within this share of the radial height at which their conic ends."""


@dataclass(frozen=True)
class State:
    """A lens of the search with its rays; n rays, v variables.

    Attributes
    ----------
    lens
        The lens, not validated.
    variables
        What the derivatives are by.
    fields_mm : ndarray, shape (n, 2)
        Object point of each ray.
    traces
        One for each wavelength of the lens.
    as_built
        What is predicted of it as built, where goals or constraints ask for that.
    """

    lens: Lens
    variables: tuple[Variable, ...]
    fields_mm: Array
    traces: tuple[GradientTrace, ...]
    as_built: AsBuiltValues | None = None


@dataclass(frozen=True)
class Row:
    """Goals or constraints of one kind.

    Attributes
    ----------
    name
        As reports call it.
    values, by : ndarray, shapes (k,) and (k, v)
        Scaled values and their derivatives.
    rays : ndarray of int or None
        Which ray each value belongs to.
    """

    name: str
    values: Array
    by: Array
    rays: NDArray[np.int64] | None = None


def goal_rows(specification: Specification, state: State) -> list[Row]:
    """What the largest value of is to be made small."""
    goal = specification.optimize.goal
    lens: Lens = specification  # as it was at the start
    if goal in AS_BUILT_GOALS:
        return [_as_built_goal(goal, state)]
    if goal.startswith("smallest spread"):
        widest = _sine(lens, max(lens.wavelengths_um))
        own = goal == "smallest spread"
        return [
            _per_ray(
                _named("spread", w, lens),
                _squares(t.cosines, t.cosines_by),
                (_sine(lens, w) if own else widest) ** 2,
                t,
            )
            for w, t in zip(lens.wavelengths_um, state.traces, strict=True)
        ]
    if goal == "smallest aperture":
        reference = lens.stop_semi_diameter_mm**2
        return [
            _per_ray(_named(f"height on surface {i + 1}", w, lens), _heights(t, i), reference, t)
            for w, t in zip(lens.wavelengths_um, state.traces, strict=True)
            for i in range(len(lens.surfaces))
        ]
    length = state.lens.exit_vertex_z_mm
    by = np.array([float(v.kind == "thickness") for v in state.variables])
    if goal == "shortest track":
        length += state.lens.object.working_distance_mm + lens.sensor.plane_distances_mm[-1]
        by += np.array([float(v.kind == "working_distance") for v in state.variables])
    reference = lens.exit_vertex_z_mm
    return [Row(goal, np.array([length / reference]), by[None] / reference)]


def constraint_rows(specification: Specification, state: State, final: bool = False) -> list[Row]:
    """What must not be above zero.

    Where the spread's limit is what a search makes as small as it can, only the `final` lens is held
    against it.
    """
    rows: list[Row] = []
    lens: Lens = specification
    limited = final or not _limits_its_goal(specification)
    for wavelength, trace in zip(lens.wavelengths_um, state.traces, strict=True):
        rows += _spread_rows(specification, state, wavelength, trace, limited)
        for i, limit in enumerate(specification.footprint_limits()):
            if math.isfinite(limit):
                name = _named(f"footprint on sensor plane {i + 1}", wavelength, lens)
                squares = _squares(trace.plane_points[:, i], trace.plane_points_by[:, i])
                rows.append(_limited(name, squares, limit**2, trace))
        if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
            rows += _rectangle_rows(specification, wavelength, trace)
        rows += _throughput_rows(specification, state, wavelength, trace)
    return rows + _glass_rows(specification, state) + _as_built_rows(specification, state)


def _as_built_goal(goal: str, state: State) -> Row:
    assert state.as_built is not None  # the goal asked for it
    if goal == "yield":
        return _finite(goal, np.array([state.as_built.failing]), state.as_built.failing_by[None])
    scale = AS_BUILT_SCALE_WAVES
    return _finite(goal, state.as_built.rms_waves / scale, state.as_built.rms_by / scale)


def _as_built_rows(specification: Specification, state: State) -> list[Row]:
    """How many lenses may fail, and how large their wavefront errors may be."""
    limits, found, rows = specification.constraints, state.as_built, []
    if found is None:
        return []
    if limits.min_yield is not None:
        excess = found.failing - (1.0 - limits.min_yield)
        rows.append(_finite("yield", np.array([excess]), found.failing_by[None]))
    if limits.max_as_built_rms_waves is not None:
        most = limits.max_as_built_rms_waves
        rows.append(_finite("as-built rms", found.rms_waves / most - 1.0, found.rms_by / most))
    return rows


def _limits_its_goal(specification: Specification) -> bool:
    """Whether the lens of the smallest goal is the one that keeps the spread's limit best, too."""
    goal, limit = specification.optimize.goal, specification.constraints.max_spread_deg
    if len(specification.wavelengths_um) == 1:
        return goal.startswith("smallest spread")
    return goal == ("smallest spread" if limit == "sensor" else "smallest spread angle")


def _spread_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace, limited: bool
) -> list[Row]:
    squares = _squares(trace.cosines, trace.cosines_by)
    limit = specification.spread_limit(wavelength)
    rows = []
    if limited and math.isfinite(limit):
        rows.append(_limited(_named("spread", wavelength, specification), squares, limit**2, trace))
    for axis, most_deg in enumerate(specification.constraints.max_spread_xy_deg or ()):
        at, by = trace.cosines[:, axis], trace.cosines_by[:, axis]
        name = _named(f"spread along {'xy'[axis]}", wavelength, specification)
        square = math.sin(math.radians(most_deg)) ** 2
        rows.append(_limited(name, (at**2, 2.0 * at[:, None] * by), square, trace))
    for own in specification.constraints.field_spread:
        at = np.abs(np.linalg.norm(state.fields_mm, axis=-1) - own.field_mm) < 1e-9
        name = _named(f"spread at field height {own.field_mm:g} mm", wavelength, specification)
        row = _limited(name, squares, math.sin(math.radians(own.max_spread_deg)) ** 2, trace)
        rows.append(Row(name, row.values[at], row.by[at], np.flatnonzero(at)))
    return rows


def _rectangle_rows(specification: Specification, wavelength: float, trace: GradientTrace) -> list[Row]:
    """Light within the sides of the sensor, x and y apart."""
    rows = []
    for i in range(len(specification.sensor.plane_distances_mm)):
        for axis, size in enumerate(specification.sensor.size_mm):
            at, by = trace.plane_points[:, i, axis], trace.plane_points_by[:, i, axis]
            name = _named(f"{'xy'[axis]} of the footprint on sensor plane {i + 1}", wavelength, specification)
            rows.append(_limited(name, (at**2, 2.0 * at[:, None] * by), (0.5 * size) ** 2, trace))
    return rows


def _throughput_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace
) -> list[Row]:
    """Rays within the clear semi-diameters; of the share that may be lost, the worst do not count."""
    lens, share = specification, specification.constraints.min_throughput
    limits = [
        (i, s.semi_diameter_mm)
        for i, s in enumerate(lens.surfaces)
        if s.semi_diameter_mm is not None and i != lens.stop_index
    ]
    if not limits:
        return []
    each = [_limited("", _heights(trace, i), d**2, trace) for i, d in limits]
    worst = np.argmax([r.values for r in each], axis=0)
    rays = np.arange(len(worst))
    values = np.array([r.values for r in each])[worst, rays]
    by = np.array([r.by for r in each])[worst, rays]
    name = _named("throughput", wavelength, lens)
    if share == 1.0:
        return [Row(name, values, by, rays)]
    picked = []
    for field in np.unique(state.fields_mm, axis=0):
        mine = np.flatnonzero(np.all(state.fields_mm == field, axis=1))
        order = mine[np.argsort(values[mine])]
        picked.append(order[math.ceil(share * len(order)) - 1])
    return [Row(name, values[picked], by[picked], np.array(picked))]


def _glass_rows(specification: Specification, state: State) -> list[Row]:
    """Thicknesses, slopes and the edges of conics."""
    lens, limits = state.lens, specification.constraints
    heights = [_clear_height(state, i) for i in range(len(lens.surfaces))]
    edge = max(heights, key=lambda h: h[0])
    rows = []
    for i, surface in enumerate(lens.surfaces):
        for part, end in enumerate(surface.shape.ends()):
            by = _by(state, i, partial(_end_by, surface.shape, part))[0] * edge[0] ** 2
            value = float(end) * edge[0] ** 2 - CONIC_EDGE_SHARE**2
            name = f"edge of the conic of surface {i + 1}"
            rows.append(_finite(name, np.array([value]), (by + 2.0 * float(end) * edge[0] * edge[1])[None]))
        rows.append(_slope_row(state, i, heights[i], limits.max_edge_slope_deg))
        if i + 1 == len(lens.surfaces):
            continue
        glass = surface.material is not None
        least = limits.min_edge_thickness_mm if glass else limits.min_air_gap_mm
        scale = specification.surfaces[i].thickness_mm or 1.0
        at = _ground_height(lens, i, edge)
        rows.append(_gap_row(f"edge thickness behind surface {i + 1}", state, i, at, least, scale))
        least = limits.min_center_thickness_mm if glass else limits.min_air_gap_mm
        gap, by = _thickness(state, i)
        name = f"centre thickness behind surface {i + 1}"
        rows.append(_finite(name, np.array([(least - gap) / scale]), -by[None] / scale))
    return rows


def _thickness(state: State, i: int) -> tuple[float, Array]:
    """Of the space behind a surface on the axis, and its derivatives by all variables."""
    by = np.array([float(v.kind == "thickness" and v.surface == i) for v in state.variables])
    return state.lens.surfaces[i].thickness_mm or 0.0, by


def _ground_height(lens: Lens, i: int, clear: tuple[float, Array]) -> tuple[float, Array]:
    """Radius of the edge cylinder behind a surface: the design file's, or else the largest clear height."""
    if not lens.edges or i not in lens.glass_fronts:
        return clear
    given = lens.edges[lens.glass_fronts.index(i)].semi_diameter_mm
    return clear if given is None else (given, np.zeros_like(clear[1]))


def _slope_row(state: State, i: int, height: tuple[float, Array], limit_deg: float) -> Row:
    """Of the steepest way over the surface, in each direction."""
    shape = state.lens.surfaces[i].shape
    limit = math.tan(math.radians(limit_deg)) ** 2
    ux, uy = directions(shape)
    x, y = height[0] * ux, height[0] * uy
    _, *slopes = shape.sag_and_slopes(x, y)
    xx, xy, yy = shape.second_derivatives(x, y)
    outward = slopes[0] * (xx * ux + xy * uy) + slopes[1] * (xy * ux + yy * uy)
    by = _by(state, i, partial(_slope_square_by, shape, x, y, slopes)) + 2.0 * outward[:, None] * height[1]
    values = (slopes[0] ** 2 + slopes[1] ** 2) / limit - 1.0
    return _finite(f"slope at the edge of surface {i + 1}", values, by / limit)


def _gap_row(name: str, state: State, i: int, height: tuple[float, Array], least: float, scale: float) -> Row:
    """Of the space behind a surface at a radial height, in each direction."""
    front, back = (s.shape for s in state.lens.surfaces[i : i + 2])
    ux, uy = directions(front, back)
    x, y = height[0] * ux, height[0] * uy
    before, behind = (np.array(shape.sag_and_slopes(x, y)) for shape in (front, back))
    thickness, by = _thickness(state, i)
    by = by + _by(state, i + 1, partial(_sag_by, back, x, y)) - _by(state, i, partial(_sag_by, front, x, y))
    outward = (behind - before)[1] * ux + (behind - before)[2] * uy
    gap = thickness + behind[0] - before[0]
    return _finite(name, (least - gap) / scale, -(by + outward[:, None] * height[1]) / scale)


def _sag_by(shape: Shape, x: Array, y: Array, term: str) -> Array:
    return shape.derivatives_by(term, x, y)[0]


def _slope_square_by(shape: Shape, x: Array, y: Array, slopes: Sequence[Array], term: str) -> Array:
    by = shape.derivatives_by(term, x, y)[1:]
    return 2.0 * (slopes[0] * by[0] + slopes[1] * by[1])


def _end_by(shape: Shape, part: int, term: str) -> Array:
    """By complex step, exact to rounding."""
    return np.array([shape.moved(term, 1e-30j).ends()[part].imag / 1e-30])


def _clear_height(state: State, i: int) -> tuple[float, Array]:
    """Clear semi-diameter of a surface: as given, as the stop's, or as its rays need, rounded up.

    Rounding is taken to add a whole step: thickness and slope then hold for whatever it adds.
    """
    stop = state.traces[0]
    if i == state.lens.stop_index:
        return stop.stop_semi_diameter_mm, stop.stop_semi_diameter_by
    given = state.lens.surfaces[i].semi_diameter_mm
    if given is not None:
        return given, np.zeros(len(state.variables))
    best = (0.0, np.zeros(len(state.variables)))
    for trace in state.traces:
        squares, by = _heights(trace, i)
        squares = np.where(trace.ok, squares, 0.0)
        worst = int(np.argmax(squares))
        height = math.sqrt(squares[worst])
        if height and height + SEMI_DIAMETER_STEP_MM > best[0]:
            best = (height + SEMI_DIAMETER_STEP_MM, by[worst] / (2.0 * height))
    return best


def _by(state: State, i: int, derivative: Callable[[str], Array]) -> Array:
    """Derivatives by all variables of what depends on the shape of one surface alone, shape (..., v)."""
    own = {j: derivative(v.kind) for j, v in enumerate(state.variables) if v.of_shape and v.surface == i}
    found = np.zeros((len(next(iter(own.values()), np.zeros(1))), len(state.variables)))
    for j, values in own.items():
        found[:, j] = values
    return found


def _squares(points: Array, by: Array) -> tuple[Array, Array]:
    """x^2 + y^2 and its derivatives."""
    return np.sum(points**2, axis=-1), 2.0 * np.einsum("na,nav->nv", points, by)


def _heights(trace: GradientTrace, i: int) -> tuple[Array, Array]:
    return _squares(trace.heights[:, i], trace.heights_by[:, i])


def _per_ray(name: str, squares: tuple[Array, Array], scale: float, trace: GradientTrace) -> Row:
    values = np.where(trace.ok, squares[0] / scale, UNTRACEABLE)
    by = np.where(trace.ok[:, None], squares[1] / scale, 0.0)
    return Row(name, values, by, np.arange(len(values)))


def _limited(name: str, squares: tuple[Array, Array], limit: float, trace: GradientTrace) -> Row:
    row = _per_ray(name, squares, limit * (1.0 - LIMIT_MARGIN) ** 2, trace)
    return Row(name, row.values - 1.0, row.by, row.rays)


def _finite(name: str, values: Array, by: Array) -> Row:
    ok = np.isfinite(values) & np.all(np.isfinite(by), axis=-1)
    return Row(name, np.where(ok, values, UNTRACEABLE), np.where(ok[:, None], by, 0.0))


def _sine(lens: Lens, wavelength: float) -> float:
    """Sine of the sensor's spread limit: what spreads are scaled by."""
    return min(1.0, wavelength / (2.0 * lens.sensor.pixel_pitch_um))


def _named(name: str, wavelength: float, lens: Lens) -> str:
    return name if len(lens.wavelengths_um) == 1 else f"{name} ({wavelength:g} um)"
