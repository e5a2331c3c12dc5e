"""Check of a lens against Eqs. 1 and 2, its sensor, its numerical aperture and its edges, as one report."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lensdesign.analysis.coatings import coating_report
from lensdesign.analysis.exit_beam import (
    Footprint,
    SpreadAngle,
    Throughput,
    observation_distance_mm,
    rms_spot_diameter,
    spread_angle_and_footprints,
)
from lensdesign.analysis.form_error import form_errors
from lensdesign.analysis.moulding import moulding_checks
from lensdesign.analysis.outline import thinnest_drawn_edge
from lensdesign.analysis.oversampling import oversampling_of_kinds
from lensdesign.analysis.paraxial import first_order
from lensdesign.analysis.report import CheckReport, Constraint, OversamplingRatio, WavelengthCheck, WorstRay
from lensdesign.analysis.roughness import roughness_report
from lensdesign.analysis.space_bandwidth import Matching, match, smallest_exit_beam_diameter_mm
from lensdesign.common.given import FilePath, object_of
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import glass_element
from lensdesign.raytrace.bundles import launch

ROUNDING = 1e-6
"""Relative amount by which spread or footprint may exceed a limit; an optimum is on the limit to rounding."""


@dataclass(frozen=True)
class _Traced:
    """Results of one wavelength."""

    matching: Matching
    spread: SpreadAngle
    footprints: tuple[Footprint, ...]
    passes: Throughput
    row: WavelengthCheck

    @property
    def load(self) -> float:
        """Sine of the spread divided by the sine of its limit; Eq. 2 requires 1 or less."""
        return capped_sine(self.spread.spread_deg) / capped_sine(self.matching.spread_limit_deg)


def check_design(lens: Lens | FilePath, *, refined: bool = True) -> CheckReport:
    """Check whether a lens transfers its object to its sensor, at all its wavelengths.

    The constraints are the space-bandwidth product of the sensor (Eq. 1 of the paper), the spread angle
    behind the lens (Eq. 2), light beyond the sensor, vignetting, the numerical aperture, and the edges of the
    glass. Moulded elements are checked in addition (:func:`lensdesign.analysis.moulding.moulding_checks`).

    Parameters
    ----------
    lens
        A lens, or the path of its design file.
    refined
        Whether a search refines the worst rays of a dense sampling. Without it, spread and footprints are up
        to a thousandth too small, but the check takes a tenth of the time.

    Returns
    -------
    CheckReport
        All computed quantities, the constraints, and a sentence for each violation.

    Raises
    ------
    DesignError
        If the file does not contain a valid lens, or no ray passes at one of its wavelengths.
    MaterialError
        If the index of a glass is not known at one of its wavelengths.

    References
    ----------
    "Computational diffraction-limited imaging with a non-imaging spatial information transfer lens" (Chinese
    Laser Press, 2024), Eqs. 1 and 2.

    Examples
    --------
    >>> from lensdesign import check_design
    >>> report = check_design("designs/feasible_singlet.toml", refined=False)
    >>> report.feasible, round(report.efl_mm, 2)
    (True, 18.67)
    """
    lens = object_of(lens, Lens, load_design, "lens")
    traced = [_trace(lens, w, refined) for w in lens.wavelengths_um]
    rows = tuple(t.row for t in traced)
    worst = max(traced, key=lambda t: t.load)
    edge = edge_thickness_mm(lens)
    constraints = (
        _sensor_sbp(traced),
        _spread_within_limit(worst),
        *_light_on_sensor(traced),
        _nothing_clipped(traced),
        _aperture_reached(lens, traced),
        *_edge_of_glass(edge),
    )
    return CheckReport(
        title=lens.title,
        feasible=all(c.met for c in constraints),
        violations=tuple(c.miss for c in constraints if not c.met),
        constraints=constraints,
        sbp_object=max(r.sbp_object for r in rows),
        sbp_sensor=worst.matching.sbp_sensor,
        spread_limit_deg=worst.matching.spread_limit_deg,
        max_spread_deg=worst.spread.spread_deg,
        spread_heights_mm=worst.spread.field_heights_mm,
        spread_per_field_deg=worst.spread.per_field_deg,
        worst_ray=WorstRay(worst.spread.field_mm, worst.spread.pupil, worst.matching.wavelength_um),
        highest_frequency_lp_per_mm=worst.matching.highest_frequency_lp_per_mm,
        resolution_um=max(r.resolution_um for r in rows),
        numerical_aperture=min(r.numerical_aperture for r in rows),
        plane_distances_mm=lens.sensor.plane_distances_mm,
        footprint_radius_mm=tuple(np.max([r.footprint_radius_mm for r in rows], axis=0).tolist()),
        sensor_half_side_mm=0.5 * min(lens.sensor.size_mm),
        spot_heights_mm=_spot_heights(lens),
        rms_spot_diameter_mm=tuple(np.max([r.rms_spot_diameter_mm for r in rows], axis=0).tolist()),
        spot_plane_mm=observation_distance_mm(lens),
        throughput=min(r.throughput for r in rows),
        edge_thickness_mm=edge,
        drawn_edge=thinnest_drawn_edge(lens),
        efl_mm=rows[0].efl_mm,
        bfl_mm=rows[0].bfl_mm,
        exit_beam_diameter_mm=max(r.exit_beam_diameter_mm for r in rows),
        smallest_exit_beam_diameter_mm=max(r.smallest_exit_beam_diameter_mm for r in rows),
        etendue_share=worst.row.etendue_share,
        wavelengths=rows,
        figures=form_errors(lens),
        moulding=moulding_checks(lens),
        roughness=roughness_report(lens),
        coatings=tuple(coating_report(lens, wavelength) for wavelength in lens.wavelengths_um),
        oversampling=tuple(
            OversamplingRatio(one.kind, one.ratio_of_planes, one.ratio)
            for one in oversampling_of_kinds(lens, rows[0].wavelength_um, rows[0].footprint_radius_mm)
        ),
    )


def edge_thickness_mm(lens: Lens) -> float | None:
    """Return the smallest length of the edge cylinder of any glass element; None without glass.

    The length is that of :class:`lensdesign.lens.solid.Element`, without bevels.
    """
    elements = (glass_element(lens, index) for index in range(len(lens.glass_fronts)))
    return min((e.edge_thickness_mm for e in elements), default=None)


def _trace(lens: Lens, wavelength_um: float, refined: bool) -> _Traced:
    matching = match(lens, wavelength_um)
    planes_mm = (0.0, *lens.sensor.plane_distances_mm)
    spread, (at_exit, *footprints), passes = spread_angle_and_footprints(
        lens, wavelength_um, planes_mm, refined
    )
    plane_mm = observation_distance_mm(lens)
    spots = [rms_spot_diameter(lens, wavelength_um, h, plane_mm) for h in _spot_heights(lens)]
    paraxial = first_order(lens, wavelength_um)
    _, rim = launch(lens, [0.0, 0.0], [0.0, 1.0], wavelength_um)
    beam = 2.0 * at_exit.radius_mm
    narrowest = smallest_exit_beam_diameter_mm(
        lens.object.field_diameter_mm,
        lens.object.numerical_aperture,
        capped_sine(spread.spread_deg),
        lens.sensor_medium_index(wavelength_um),
    )
    row = WavelengthCheck(
        wavelength_um=wavelength_um,
        sbp_object=matching.sbp_object,
        spread_limit_deg=matching.spread_limit_deg,
        max_spread_deg=spread.spread_deg,
        resolution_um=matching.resolution_um,
        numerical_aperture=float(np.hypot(rim[0, 0], rim[0, 1])),
        footprint_radius_mm=tuple(f.radius_mm for f in footprints),
        rms_spot_diameter_mm=tuple(s.rms_diameter_mm for s in spots),
        throughput=passes.throughput,
        efl_mm=paraxial.efl_mm,
        bfl_mm=paraxial.bfl_mm,
        exit_beam_diameter_mm=beam,
        smallest_exit_beam_diameter_mm=matching.smallest_exit_beam_diameter_mm,
        etendue_share=narrowest / beam,
    )
    return _Traced(matching, spread, tuple(footprints), passes, row)


def constraint(
    name: str, value: float, relation: str, limit: float, unit: str, met: bool, miss: str
) -> Constraint:
    """Return a constraint; its message on a violation is dropped if it is met."""
    return Constraint(name, value, relation, limit, unit, met, "" if met else miss)


def _sensor_sbp(traced: list[_Traced]) -> Constraint:
    m = max((t.matching for t in traced), key=lambda m: m.sbp_object)
    return constraint(
        "SBP of the sensor (Eq. 1)",
        m.sbp_sensor,
        ">=",
        m.sbp_object,
        "",
        m.sbp_ratio >= 1.0,
        f"Eq. 1: the sensor's space-bandwidth product of {m.sbp_sensor:.4g} is less than the object's "
        f"{m.sbp_object:.4g} at {m.wavelength_um:g} µm, by {_percent(1.0 - m.sbp_ratio)}",
    )


def _spread_within_limit(worst: _Traced) -> Constraint:
    spread, limit = worst.spread, worst.matching.spread_limit_deg
    height = math.hypot(*spread.field_mm)
    return constraint(
        "largest spread angle (Eq. 2)",
        spread.spread_deg,
        "<=",
        limit,
        "deg",
        worst.load <= 1.0 + ROUNDING and spread.spread_deg < 90.0,
        f"Eq. 2: the largest spread angle of {spread.spread_deg:.4f}° exceeds the limit of "
        f"{limit:.4f}° at {worst.matching.wavelength_um:g} µm, by {_percent(worst.load - 1.0)} in its "
        f"sine (field height {height:.4g} mm, stop point {spread.pupil[0]:.3f}, {spread.pupil[1]:.3f})",
    )


def _light_on_sensor(traced: list[_Traced]) -> list[Constraint]:
    """Return one constraint for each sensor plane."""
    widest = [
        max(footprints, key=lambda f: f.radius_mm)
        for footprints in zip(*(t.footprints for t in traced), strict=True)
    ]
    return [
        constraint(
            f"footprint radius at {f.plane_distance_mm:g} mm",
            _reach_mm(f),
            "<=",
            f.sensor_half_side_mm,
            "mm",
            _reach_mm(f) <= f.sensor_half_side_mm * (1.0 + ROUNDING),
            f"footprint: {f.plane_distance_mm:g} mm behind the exit vertex, light reaches "
            f"{_reach_mm(f):.4f} mm from the axis, beyond the sensor's half side of "
            f"{f.sensor_half_side_mm:.4f} mm by {-f.margin_mm:.4f} mm",
        )
        for f in widest
    ]


def _nothing_clipped(traced: list[_Traced]) -> Constraint:
    darkest = min(traced, key=lambda t: t.passes.throughput)
    fraction = darkest.passes.throughput
    height = darkest.passes.field_heights_mm[darkest.passes.per_field.index(fraction)]
    return constraint(
        "throughput",
        fraction,
        ">=",
        1.0,
        "",
        fraction >= 1.0,
        f"throughput: only {100.0 * fraction:.4g} % of the rays from the field height {height:.4g} mm that "
        f"pass the stop pass the lens at {darkest.matching.wavelength_um:g} µm; must be 100 %",
    )


def _aperture_reached(lens: Lens, traced: list[_Traced]) -> Constraint:
    value, required = min(t.row.numerical_aperture for t in traced), lens.object.numerical_aperture
    # Relative amount by which the NA of the stop may be below that of the file; stops have only a few digits.
    na_tolerance = 1e-3
    return constraint(
        "numerical aperture (within 0.1 %)",
        value,
        ">=",
        required,
        "",
        value >= required * (1.0 - na_tolerance),
        f"numerical aperture: the stop accepts {value:.5f} from the axis, less than the design's "
        f"{required:g} by {_percent(1.0 - value / required)}",
    )


def _edge_of_glass(edge: float | None) -> list[Constraint]:
    """Return the constraint on the edge thickness; no constraint for a lens without glass."""
    if edge is None:
        return []
    return [
        constraint(
            "edge thickness",
            edge,
            ">",
            0.0,
            "mm",
            edge > 0.0,
            f"edge thickness: {edge:.4f} mm is the length of the edge cylinder; must be greater than 0",
        )
    ]


def _spot_heights(lens: Lens) -> tuple[float, ...]:
    return 0.0, 0.5 * lens.half_field_mm, lens.half_field_mm


def capped_sine(angle_deg: float) -> float:
    """Return the sine of an angle, and 1 beyond 90 degrees, so that a backward ray is never rated better."""
    return math.sin(math.radians(min(angle_deg, 90.0)))


def _percent(fraction: float) -> str:
    """Return a fraction as text in percent with one decimal, or with one digit if it is below 0.1 %."""
    return f"{100.0 * fraction:.1f} %" if fraction >= 1e-3 else f"{100.0 * fraction:.1g} %"


def _reach_mm(found: Footprint) -> float:
    """Return the footprint radius, or half the sensor's shorter side minus the smaller of both margins."""
    radial_margin = found.sensor_half_side_mm - found.radius_mm
    return (
        found.radius_mm if found.margin_mm == radial_margin else found.sensor_half_side_mm - found.margin_mm
    )
