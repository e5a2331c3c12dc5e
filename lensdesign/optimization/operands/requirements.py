"""Operands of a specification: its goals and constraints as scaled values with derivatives.

Each value is scaled to about 1. A constraint is met if its value is not above zero.
"""

from __future__ import annotations

import math

import numpy as np

from lensdesign.analysis.oversampling import INTENSITY_DEGREES, UNKNOWNS_OF_KIND, measurements_in_light
from lensdesign.analysis.space_bandwidth import sbp_object, sensor_spread_sine
from lensdesign.common.arrays import Array
from lensdesign.lens.lens import Lens
from lensdesign.lens.temperature import named_at
from lensdesign.optimization.nlopt_driver import UNTRACEABLE
from lensdesign.optimization.operands.ghosts import GHOST_MARGIN
from lensdesign.optimization.operands.glass import glass_operands, lens_thickness, track
from lensdesign.optimization.operands.operand import (
    LIMIT_MARGIN,
    Operand,
    State,
    finite_operand,
    heights_of,
    squares_of,
)
from lensdesign.optimization.specification.sections import AS_BUILT_GOALS, GHOST_GOAL, LARGEST, LOSS_GOAL
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import LENGTHS
from lensdesign.raytrace.gradients import GradientTrace


def goal_operands(specification: Specification, state: State) -> list[Operand]:
    """Return the goals, the largest value of which is minimized."""
    goal = specification.optimize.goal
    lens: Lens = specification  # the start lens, a fixed reference for scaling
    if goal in AS_BUILT_GOALS:
        return [_as_built_goal(goal, one) for one in state.all]
    if goal == GHOST_GOAL:
        ghosts = state.predict_ghosts()
        assert ghosts is not None  # the goal requires them
        scale = 0.01  # power of ghosts by which the goal is scaled
        return [finite_operand(goal, ghosts.fractions / scale, ghosts.fractions_by / scale)]
    if goal.startswith("smallest spread"):
        widest = sensor_spread_sine(lens, max(lens.wavelengths_um))
        own = goal == "smallest spread"
        return [
            _per_ray(
                _named("spread", w, one),
                squares_of(t.cosines, t.cosines_by),
                (sensor_spread_sine(one.lens, w) if own else widest) ** 2,
                t,
            )
            for one in state.all
            for w, t in zip(lens.wavelengths_um, one.traces, strict=True)
        ]
    if goal == "smallest aperture":
        reference = lens.stop_semi_diameter_mm**2
        return [
            _per_ray(_named(f"height on surface {i + 1}", w, state), heights_of(t, i), reference, t)
            for w, t in zip(lens.wavelengths_um, state.traces, strict=True)
            for i in range(len(lens.surfaces))
        ]
    if goal in LARGEST:
        reference, length = (getattr(x.object, LARGEST[goal]) for x in (specification, state.lens))
        kind = LENGTHS[LARGEST[goal]]
        log_by = np.array([float(v.kind == kind) for v in state.variables])
        if kind != "log_field":
            log_by /= length
        # The reciprocal is positive, as the search requires of goals.
        smallness = reference / length
        return [Operand(goal, np.array([smallness]), -smallness * log_by[None])]
    length, by = track(state) if goal == "shortest track" else lens_thickness(state)
    reference = lens.exit_vertex_z_mm
    return [Operand(goal, np.array([length / reference]), by[None] / reference)]


def constraint_operands(specification: Specification, state: State, final: bool = False) -> list[Operand]:
    """Return the constraints, which must not be above zero.

    If the goal minimizes the limited spread itself, the spread limit applies to the `final` lens only.
    """
    built = [row for one in state.all for row in _as_built_rows(specification, one)]
    own = glass_operands(specification, state) + _ghost_rows(specification, state)
    return ray_constraint_operands(specification, state, final) + own + built


def ray_constraint_operands(specification: Specification, state: State, final: bool = False) -> list[Operand]:
    """Return the constraints on single rays, which are the first of :func:`constraint_operands`."""
    limited = final or not _limits_its_goal(specification)
    rows = [row for one in state.all for row in _light_rows(specification, one, limited)]
    most = specification.constraints.max_semi_diameter_mm
    for wavelength, trace in zip(specification.wavelengths_um, state.traces, strict=True):
        for i in range(len(specification.surfaces)) if most is not None else ():
            name = _named(f"semi-diameter of surface {i + 1}", wavelength, state)
            rows.append(_limited(name, heights_of(trace, i), float(most or 0.0) ** 2, trace))
    return rows


def _light_rows(specification: Specification, state: State, limited: bool) -> list[Operand]:
    """Return the constraints on spread, footprint, throughput and oversampling at each wavelength."""
    rows: list[Operand] = []
    for wavelength, trace in zip(specification.wavelengths_um, state.traces, strict=True):
        rows += _spread_rows(specification, state, wavelength, trace, limited)
        for i, limit in enumerate(specification.footprint_limits()):
            if math.isfinite(limit):
                name = _named(f"footprint on sensor plane {i + 1}", wavelength, state)
                squares = squares_of(trace.plane_points[:, i], trace.plane_points_by[:, i])
                rows.append(_limited(name, squares, limit**2, trace))
        if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
            rows += _rectangle_rows(specification, state, wavelength, trace)
        rows += _throughput_rows(specification, state, wavelength, trace)
        rows += _oversampling_rows(specification, state, wavelength, trace)
    return rows


def _as_built_goal(goal: str, state: State) -> Operand:
    name = named_at(goal, state.temperature_c)
    if goal == LOSS_GOAL:
        losses = state.predict_losses()
        assert losses is not None  # the goal requires it
        return finite_operand(name, losses.losses / losses.scale, losses.losses_by / losses.scale)
    found = state.predict_as_built()
    assert found is not None  # the goal requires it
    if goal == "yield":
        return finite_operand(name, np.array([found.failing]), found.failing_by[None])
    # Root mean square wavefront error by which as-built goals are scaled.
    scale = 0.1
    return finite_operand(name, found.rms_waves / scale, found.rms_by / scale)


def _as_built_rows(specification: Specification, state: State) -> list[Operand]:
    """Return the constraints on yield, wavefront errors and losses of lenses as built."""
    limits, rows = specification.constraints, _loss_rows(specification, state)
    if limits.min_yield is None and limits.max_as_built_rms_waves is None:
        return rows
    found = state.predict_as_built()
    if found is None:
        return rows
    if limits.min_yield is not None:
        excess = found.failing - (1.0 - limits.min_yield)
        rows.append(
            finite_operand(named_at("yield", state.temperature_c), np.array([excess]), found.failing_by[None])
        )
    if limits.max_as_built_rms_waves is not None:
        most = limits.max_as_built_rms_waves
        name = named_at("as-built rms", state.temperature_c)
        rows.append(finite_operand(name, found.rms_waves / most - 1.0, found.rms_by / most))
    return rows


def _loss_rows(specification: Specification, state: State) -> list[Operand]:
    most = specification.constraints.max_as_built_reconstruction_loss
    found = None if most is None else state.predict_losses()
    if most is None or found is None:
        return []
    name = named_at(LOSS_GOAL, state.temperature_c)
    return [finite_operand(name, found.losses / most - 1.0, found.losses_by / most)]


def _ghost_rows(specification: Specification, state: State) -> list[Operand]:
    """Return the constraint on the power of ghosts, for each sensor plane."""
    most = specification.constraints.max_ghost_fraction
    found = None if most is None else state.predict_ghosts()
    if most is None or found is None:
        return []
    tightened = most * (1.0 - GHOST_MARGIN)
    return [
        finite_operand(
            f"ghost fraction on sensor plane {i + 1}",
            np.array([fraction / tightened - 1.0]),
            by[None] / tightened,
        )
        for i, (fraction, by) in enumerate(zip(found.fractions, found.fractions_by, strict=True))
    ]


def _limits_its_goal(specification: Specification) -> bool:
    """Return whether the lens with the smallest goal also has the smallest excess over the spread limit."""
    goal, limit = specification.optimize.goal, specification.constraints.max_spread_deg
    if len(specification.wavelengths_um) == 1:
        return goal.startswith("smallest spread")
    return goal == ("smallest spread" if limit == "sensor" else "smallest spread angle")


def _spread_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace, limited: bool
) -> list[Operand]:
    squares = squares_of(trace.cosines, trace.cosines_by)
    limit = specification.spread_limit(wavelength, state.lens.sensor_medium_index(wavelength))
    rows = []
    if limited and math.isfinite(limit):
        rows.append(_limited(_named("spread", wavelength, state), squares, limit**2, trace))
    for axis, most_deg in enumerate(specification.constraints.max_spread_xy_deg or ()):
        at, by = trace.cosines[:, axis], trace.cosines_by[:, axis]
        name = _named(f"spread along {'xy'[axis]}", wavelength, state)
        square = math.sin(math.radians(most_deg)) ** 2
        rows.append(_limited(name, (at**2, 2.0 * at[:, None] * by), square, trace))
    for own in specification.constraints.field_spread:
        at = np.abs(np.linalg.norm(state.fields_mm, axis=-1) - own.field_mm) < 1e-9
        name = _named(f"spread at field height {own.field_mm:g} mm", wavelength, state)
        row = _limited(name, squares, math.sin(math.radians(own.max_spread_deg)) ** 2, trace)
        rows.append(Operand(name, row.values[at], row.by[at], np.flatnonzero(at)))
    return rows


def _rectangle_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace
) -> list[Operand]:
    """Return the constraints that light stays within the sides of the sensor, separately in x and y."""
    rows = []
    for i in range(len(specification.sensor.plane_distances_mm)):
        for axis, size in enumerate(specification.sensor.size_mm):
            at, by = trace.plane_points[:, i, axis], trace.plane_points_by[:, i, axis]
            name = _named(f"{'xy'[axis]} of the footprint on sensor plane {i + 1}", wavelength, state)
            rows.append(_limited(name, (at**2, 2.0 * at[:, None] * by), (0.5 * size) ** 2, trace))
    return rows


def _throughput_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace
) -> list[Operand]:
    """Return the constraint that enough rays pass the clear semi-diameters; the worst others are ignored."""
    lens, fraction = state.lens, specification.constraints.min_throughput
    limits = [
        (i, s.semi_diameter_mm)
        for i, s in enumerate(lens.surfaces)
        if s.semi_diameter_mm is not None and i != lens.stop_index
    ]
    if not limits:
        return []
    each = [_limited("", heights_of(trace, i), d**2, trace) for i, d in limits]
    worst = np.argmax([r.values for r in each], axis=0)
    rays = np.arange(len(worst))
    values = np.array([r.values for r in each])[worst, rays]
    by = np.array([r.by for r in each])[worst, rays]
    name = _named("throughput", wavelength, state)
    if fraction == 1.0:
        return [Operand(name, values, by, rays)]
    picked = []
    for field in np.unique(state.fields_mm, axis=0):
        own = np.flatnonzero(np.all(state.fields_mm == field, axis=1))
        order = own[np.argsort(values[own])]
        picked.append(order[math.ceil(fraction * len(order)) - 1])
    return [Operand(name, values[picked], by[picked], np.array(picked))]


def _oversampling_rows(
    specification: Specification, state: State, wavelength: float, trace: GradientTrace
) -> list[Operand]:
    """Return the constraint on the oversampling ratio of the recording.

    The light on a plane reaches as far as the outermost ray of the support. Rays between those of the set
    may reach farther, so the ratio of the lens is at least the one that is limited here.
    """
    recording = specification.recording
    if recording is None:
        return []
    scene, sensor = state.lens.object, specification.sensor
    support = scene.field_diameter_mm if recording.support_mm is None else recording.support_mm
    inside = np.linalg.norm(state.fields_mm, axis=-1) <= 0.5 * support * (1.0 + 1e-9)
    degrees = sbp_object(support, scene.numerical_aperture, wavelength)
    unknowns = degrees * UNKNOWNS_OF_KIND[recording.object]
    log_size_by = np.array(
        [float(v.kind == "log_field" and recording.support_mm is None) for v in state.variables]
    )
    name = _named("oversampling ratio", wavelength, state)
    if not (trace.ok & inside).any():
        return [finite_operand(name, np.array([np.inf]), np.zeros((1, len(state.variables))))]
    ratio, ratio_by = 0.0, np.zeros(len(state.variables))
    for plane in range(recording.frames):
        squares, squares_by = squares_of(trace.plane_points[:, plane], trace.plane_points_by[:, plane])
        outermost = int(np.argmax(np.where(trace.ok & inside, squares, -1.0)))
        light = 2.0 * math.sqrt(squares[outermost])
        counted = measurements_in_light(light, sensor.size_mm, sensor.pixel_pitch_um, degrees)
        ratio += counted / unknowns
        if counted < INTENSITY_DEGREES * degrees:
            # pixels over unknowns: proportional to the square of the light over that of the size
            ratio_by -= 2.0 * counted / unknowns * log_size_by
            if light < min(sensor.size_mm):
                ratio_by += counted / unknowns * squares_by[outermost] / squares[outermost]
    required = recording.oversampling
    return [finite_operand(name, np.array([1.0 - ratio / required]), -ratio_by[None] / required)]


def _per_ray(name: str, squares: tuple[Array, Array], scale: float, trace: GradientTrace) -> Operand:
    values, by = squares[0] / scale, squares[1] / scale
    if not trace.ok.all():
        values = np.where(trace.ok, values, UNTRACEABLE)
        by = np.where(trace.ok[:, None], by, 0.0)
    return Operand(name, values, by, np.arange(len(values)))


def _limited(name: str, squares: tuple[Array, Array], limit: float, trace: GradientTrace) -> Operand:
    row = _per_ray(name, squares, limit * (1.0 - LIMIT_MARGIN) ** 2, trace)
    return Operand(name, row.values - 1.0, row.by, row.rays)


def _named(name: str, wavelength: float, state: State) -> str:
    lone = len(state.lens.wavelengths_um) == 1
    return named_at(name if lone else f"{name} ({wavelength:g} µm)", state.temperature_c)
