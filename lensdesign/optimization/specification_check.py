"""Check of a lens against the constraints of a specification, independent of the search.

The search evaluates a lens by the rays of its working set. This check refines the worst rays of the lens as
it is saved, in the same way as `lensdesign check`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lensdesign.analysis.check import ROUNDING, capped_sine, check_design, constraint
from lensdesign.analysis.double_reflections import ghost_paths
from lensdesign.analysis.exit_beam import largest_spread_angle, spread_angle_and_footprints
from lensdesign.analysis.outline import drawn_edge_thicknesses_mm
from lensdesign.analysis.oversampling import oversampling_of
from lensdesign.analysis.report import CheckReport, Constraint
from lensdesign.common.arrays import Array
from lensdesign.common.text import number_with_unit
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import axial_gaps_mm, directions
from lensdesign.lens.temperature import lens_at_temperature, named_at
from lensdesign.optimization.as_built import AsBuiltReport, TrialsOf, read_as_built
from lensdesign.optimization.operands.glass import SEMI_DIAMETER_STEP_MM
from lensdesign.optimization.specification.sections import LOSS_GOAL, Constraints
from lensdesign.optimization.specification.specification import Specification
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.extremes import find_extremes


def check_against(
    lens: Lens, specification: Specification, built: AsBuiltReport | None = None
) -> CheckReport:
    """Check a lens against the constraints of a specification.

    Field, numerical aperture, wavelengths and sensor are those of the specification; surfaces, edges and
    working distance are those of the lens. Constraints on lenses as built are checked by Monte Carlo trials
    and are violated only beyond the statistical error. Spread, footprint, throughput and lenses as built are
    checked at each temperature of the specification, too.

    Parameters
    ----------
    lens
        Lens to check.
    specification
        Specification with the constraints.
    built
        Trials of the lens, with rows at the temperatures last (default: trials are made if needed).

    Returns
    -------
    CheckReport
        The report of :func:`lensdesign.check_design`, with `constraints`, `feasible` and `violations` of the
        specification.

    Raises
    ------
    DesignError
        If no ray passes at one of the wavelengths.
    """
    scene = specification.object.replaced(working_distance_mm=lens.object.working_distance_mm)
    if specification.field_range_mm is not None:
        scene = scene.replaced(field_diameter_mm=lens.object.field_diameter_mm)
    judged = lens.replaced(
        wavelengths_um=specification.wavelengths_um, sensor=specification.sensor, object=scene
    )
    report = check_design(judged)
    constraints = (
        *_light(judged, specification, report),
        _aperture(judged, specification, report),
        *_thicknesses(judged, specification),
        *_lengths(judged, specification),
        *_slopes(judged, specification),
        *_ghosts(judged, specification),
        *_light_in_heat(judged, specification),
        *_as_built(judged, specification, built),
    )
    return replace(
        report,
        constraints=constraints,
        feasible=all(c.met for c in constraints),
        violations=tuple(c.miss for c in constraints if not c.met),
    )


def body_constraints(lens: Lens, specification: Specification) -> tuple[Constraint, ...]:
    """Return the constraints on thicknesses, air gaps and slopes, which need no rays."""
    return (*_thicknesses(lens, specification), *_slopes(lens, specification))


def _light(lens: Lens, specification: Specification, report: CheckReport) -> list[Constraint]:
    """Return the constraints on spread, footprint, throughput and oversampling."""
    spread, footprints = _spread(lens, specification, report), _footprints(lens, specification, report)
    return [*spread, *footprints, _throughput(specification, report), *_oversampling(lens, specification)]


def _light_in_heat(lens: Lens, specification: Specification) -> list[Constraint]:
    """Return the constraints on spread, footprint and throughput at each temperature."""
    return [
        _named_constraint(temperature_c, one)
        for temperature_c, hot in at_temperatures(lens, specification)
        for one in _light(hot, specification, check_design(hot))
    ]


def _named_constraint(temperature_c: float | None, one: Constraint) -> Constraint:
    """Return a constraint with the temperature in its name and message."""
    if temperature_c is None:
        return one
    name = named_at(one.name, temperature_c)
    return replace(one, name=name, miss=one.miss.replace(one.name, name, 1), temperature_c=temperature_c)


def at_temperatures(lens: Lens, specification: Specification) -> list[tuple[float, Lens]]:
    """Return the temperatures of the specification, each with the lens at this temperature.

    Raises
    ------
    MaterialError
        If thermal data of a glass are not known.
    """
    environment = specification.environment
    if environment is None:
        return []
    mount = environment.mount_expansion_per_k
    return [
        (t, lens_at_temperature(lens, t, mount_expansion_per_k=mount)) for t in environment.temperatures_c
    ]


def _spread(lens: Lens, specification: Specification, report: CheckReport) -> list[Constraint]:
    """Return the spread constraints at each wavelength: over the field, along x and y, at field heights."""
    limits, rows = specification.constraints, []
    for found in report.wavelengths:
        at = f"at {found.wavelength_um:g} µm"
        index = lens.sensor_medium_index(found.wavelength_um)
        sine = specification.spread_limit(found.wavelength_um, index)
        if math.isfinite(sine):
            limit = math.degrees(math.asin(sine))
            rows.append(_angle(f"spread angle {at}", found.max_spread_deg, limit))
        if limits.max_spread_xy_deg is not None:
            system = compile_system(lens, found.wavelength_um)
            heights = np.linspace(0.0, lens.half_field_mm, 13)
            metrics = [partial(_along, axis) for axis in (0, 1)]
            widest = find_extremes(lens, system, metrics, heights, symmetric=False, between_heights=True)
            for axis, end, limit in zip("xy", widest, limits.max_spread_xy_deg, strict=True):
                rows.append(_angle(f"spread along {axis} {at}", math.degrees(end.value), limit))
        for own in limits.field_spread:
            angle = largest_spread_angle(lens, found.wavelength_um, [own.field_mm]).spread_deg
            rows.append(
                _angle(f"spread angle {at}, field height {own.field_mm:g} mm", angle, own.max_spread_deg)
            )
    return rows


def _along(axis: int, _position: Array, direction: Array) -> Array:
    """Return the angle to the plane through the axis: the arcsine of a direction cosine."""
    return np.arcsin(np.clip(np.abs(direction[..., axis]), 0.0, 1.0))


def _footprints(lens: Lens, specification: Specification, report: CheckReport) -> list[Constraint]:
    """Return the footprint constraint on each sensor plane at the wavelength with the largest footprint."""
    distances_mm = specification.sensor.plane_distances_mm
    if specification.constraints.max_footprint_radius_mm == "sensor rectangle":
        # The same arguments as in check_design, so that cached results are used.
        planes_mm = (0.0, *lens.sensor.plane_distances_mm)
        found = [spread_angle_and_footprints(lens, w, planes_mm)[1] for w in lens.wavelengths_um]
        tightest = [min(same, key=lambda f: f.margin_mm) for same in zip(*found, strict=True)][1:]
        return [
            _at_least(f"margin of the footprint at {distance:g} mm", f.margin_mm, 0.0, "mm")
            for distance, f in zip(distances_mm, tightest, strict=True)
        ]
    return [
        _at_most(f"footprint radius at {distance:g} mm", radius, limit, "mm")
        for distance, radius, limit in zip(
            distances_mm,
            report.footprint_radius_mm,
            specification.footprint_limits(),
            strict=True,
        )
        if math.isfinite(limit)
    ]


def _throughput(specification: Specification, report: CheckReport) -> Constraint:
    return _at_least("throughput", report.throughput, specification.constraints.min_throughput, "")


def _oversampling(lens: Lens, specification: Specification) -> list[Constraint]:
    """Return the constraint on the oversampling ratio at the wavelength where it is smallest."""
    recording = specification.recording
    if recording is None:
        return []
    planes_mm = lens.sensor.plane_distances_mm[: recording.frames]
    ratio = min(
        oversampling_of(
            lens,
            recording.object,
            support_mm=recording.support_mm,
            plane_distances_mm=planes_mm,
            wavelengths_um=(wavelength,),
        ).ratio
        for wavelength in lens.wavelengths_um
    )
    frames = "1 frame" if recording.frames == 1 else f"{recording.frames} frames"
    name = f"oversampling ratio, {recording.object} object, {frames}"
    return [_at_least(name, ratio, recording.oversampling, "")]


def _aperture(lens: Lens, specification: Specification, report: CheckReport) -> Constraint:
    """Return the constraint on the stop's size if it is fixed, else on the numerical aperture."""
    if specification.optimize.stop == "fixed":
        required = specification.stop_semi_diameter_mm
        return _at_least("semi-diameter of the stop", lens.stop_semi_diameter_mm, required, "mm")
    return next(c for c in report.constraints if c.name.startswith("numerical aperture"))


def _thicknesses(lens: Lens, specification: Specification) -> list[Constraint]:
    """Return the constraints on thicknesses on the axis and at the ground or clear edges."""
    limits, rows = specification.constraints, []
    clear = max(s.semi_diameter_mm or 0.0 for s in lens.surfaces)
    edges = dict(zip(lens.glass_fronts, drawn_edge_thicknesses_mm(lens), strict=True))
    for i, (front, back) in enumerate(zip(lens.surfaces, lens.surfaces[1:], strict=False)):
        glass = not is_gap(front.material)
        axis = front.thickness_mm or 0.0
        if glass:
            least = limits.min_edge_thickness_mm
            rows += [
                _at_least(f"edge thickness behind surface {i + 1}", edges[i], least, "mm"),
                _at_least(
                    f"centre thickness behind surface {i + 1}", axis, limits.min_center_thickness_mm, "mm"
                ),
            ]
        else:
            (at_edge,) = axial_gaps_mm(front.shape, back.shape, axis, np.array([clear])).tolist()
            gap = min(axis, at_edge)
            rows.append(_at_least(f"air gap behind surface {i + 1}", gap, limits.min_air_gap_mm, "mm"))
    return rows


def _lengths(lens: Lens, specification: Specification) -> list[Constraint]:
    limits, rows = specification.constraints, []
    widest = max(s.semi_diameter_mm or 0.0 for s in lens.surfaces)
    # Semi-diameters are rounded up in the saved lens.
    for name, value, most, slack in (
        ("lens thickness", lens.exit_vertex_z_mm, limits.max_lens_thickness_mm, 0.0),
        ("track", lens.track_mm, limits.max_track_mm, 0.0),
        ("largest semi-diameter", widest, limits.max_semi_diameter_mm, SEMI_DIAMETER_STEP_MM),
    ):
        if most is not None:
            rows.append(_at_most(name, value, most + slack, "mm"))
    return rows


def _slopes(lens: Lens, specification: Specification) -> list[Constraint]:
    """Return the constraint on the slope of each surface at its clear edge."""
    rows = []
    for number, surface in enumerate(lens.surfaces, start=1):
        if surface.semi_diameter_mm is None:
            continue
        x, y = (surface.semi_diameter_mm * component for component in directions(surface.shape))
        _, *slopes = surface.shape.sag_and_slopes(x, y)
        steepest = math.degrees(math.atan(float(np.max(np.hypot(*slopes)))))
        limit = specification.constraints.max_edge_slope_deg
        rows.append(_at_most(f"slope at the edge of surface {number}", steepest, limit, "deg"))
    return rows


def _ghosts(lens: Lens, specification: Specification) -> list[Constraint]:
    """Return the constraint on the power of ghosts on the worst plane."""
    most = specification.constraints.max_ghost_fraction
    return [] if most is None else [_at_most("ghost fraction", ghost_paths(lens).total(), most, "")]


def _as_built(lens: Lens, specification: Specification, built: AsBuiltReport | None) -> list[Constraint]:
    limits, tolerances = specification.constraints, specification.tolerances
    given = (limits.min_yield, limits.max_as_built_rms_waves, limits.max_as_built_reconstruction_loss)
    if all(limit is None for limit in given) or tolerances is None:
        return []
    hot = at_temperatures(lens, specification)
    if built is None:
        lenses = [("", lens), *((named_at("", t), one) for t, one in hot)]
        built = read_as_built(tolerances).trials(lenses, tolerances.trials)
    tried = zip([None, *(t for t, _ in hot)], built.rows[-1 - len(hot) :], strict=True)
    return [_named_constraint(t, one) for t, row in tried for one in _as_tried(limits, row, built.places)]


def _as_tried(limits: Constraints, found: TrialsOf, places: Sequence[str]) -> list[Constraint]:
    """Return the constraints on a lens as built by its trials."""
    rows = []
    if limits.min_yield is not None:
        met = found.high >= limits.min_yield
        text = f"yield: {found.good:.3f} ({found.low:.3f} to {found.high:.3f}) of {found.trials} trials"
        miss = f"{text} is less than the {limits.min_yield:g} that the specification requires"
        rows.append(constraint("yield", found.good, ">=", limits.min_yield, "", met, miss))
    if limits.max_as_built_rms_waves is not None:
        most = limits.max_as_built_rms_waves
        for place, rms, error in zip(places, found.rms_waves, found.rms_errors_waves, strict=True):
            name = f"as-built rms at {place}"
            miss = f"{name}: {rms:.4f} +- {2.0 * error:.4f} waves exceeds the limit of {most:g} waves"
            rows.append(constraint(name, rms, "<=", most, "waves", rms - 2.0 * error <= most, miss))
    largest = limits.max_as_built_reconstruction_loss
    for one in () if largest is None else found.losses:
        assert largest is not None
        name = f"{LOSS_GOAL}, {one.merit}"
        miss = f"{name}: {one.mean:.4g} +- {2.0 * one.error:.2g} exceeds the limit of {largest:g}"
        rows.append(
            constraint(name, one.mean, "<=", largest, "", one.mean - 2.0 * one.error <= largest, miss)
        )
    return rows


def _angle(name: str, value_deg: float, limit_deg: float) -> Constraint:
    """Return the constraint on an angle; the message states the excess of its sine, which Eq. 2 limits."""
    load = capped_sine(value_deg) / capped_sine(limit_deg)
    met = load <= 1.0 + ROUNDING and value_deg < 90.0
    miss = (
        f"{name}: {value_deg:.4f}° exceeds the limit of {limit_deg:.4f}°, by "
        f"{100.0 * (load - 1.0):.2g} % in its sine"
    )
    return constraint(name, value_deg, "<=", limit_deg, "deg", met, miss)


def _at_most(name: str, value: float, limit: float, unit: str) -> Constraint:
    met = value <= limit * (1.0 + ROUNDING)
    miss = (
        f"{name}: {number_with_unit(f'{value:.5g}', unit)} exceeds the limit of "
        f"{number_with_unit(f'{limit:.5g}', unit)}, by {number_with_unit(f'{value - limit:.2g}', unit)}"
    )
    return constraint(name, value, "<=", limit, unit, met, miss)


def _at_least(name: str, value: float, limit: float, unit: str) -> Constraint:
    met = bool(value >= limit * (1.0 - ROUNDING) - 1e-9)
    sizes = (number_with_unit(f"{number:.5g}", unit) for number in (value, limit, limit - value))
    miss = "{}: {} is less than the {} that the specification requires, by {}".format(name, *sizes)
    return constraint(name, value, ">=", limit, unit, met, miss)
