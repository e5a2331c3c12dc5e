"""Result of a check: values at each wavelength, the constraints, and a sentence for every violation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lensdesign.analysis.coatings import CoatingReport
from lensdesign.analysis.form_error import FormError
from lensdesign.analysis.moulding import MouldingCheck
from lensdesign.analysis.outline import DrawnEdge
from lensdesign.analysis.roughness import RoughnessReport
from lensdesign.common.notebook import html_table
from lensdesign.common.text import finite_or_none, number_with_unit, relation_symbol


@dataclass(frozen=True)
class Constraint:
    """A constraint on the lens.

    Attributes
    ----------
    name, unit
        Name of the limited quantity, and unit of both numbers (empty for pure numbers).
    value, relation, limit
        Value, relation and limit, such as 4.81, "<=", 4.77.
    met, miss
        Whether the constraint is met; if not, a sentence with the numbers, else an empty string.
    temperature_c
        Temperature for which it is required, also at the end of the name; None as designed.
    """

    name: str
    value: float
    relation: str
    limit: float
    unit: str
    met: bool
    miss: str
    temperature_c: float | None = None


@dataclass(frozen=True)
class WavelengthCheck:
    """Results at one wavelength; :class:`CheckReport` explains the values."""

    wavelength_um: float
    sbp_object: float
    spread_limit_deg: float
    max_spread_deg: float
    resolution_um: float
    numerical_aperture: float
    footprint_radius_mm: tuple[float, ...]
    rms_spot_diameter_mm: tuple[float, ...]
    throughput: float
    efl_mm: float
    bfl_mm: float
    exit_beam_diameter_mm: float
    smallest_exit_beam_diameter_mm: float
    etendue_share: float


@dataclass(frozen=True)
class WorstRay:
    """The ray with the largest spread angle relative to the limit of its wavelength.

    Attributes
    ----------
    field_mm
        Object point.
    pupil
        Stop point, relative to the semi-diameter.
    wavelength_um
        Vacuum wavelength.
    """

    field_mm: tuple[float, float]
    pupil: tuple[float, float]
    wavelength_um: float


@dataclass(frozen=True)
class OversamplingRatio:
    """Oversampling ratio of the sensor planes for one kind of object that fills the field.

    Attributes
    ----------
    kind
        Kind of the object: "amplitude", "phase" or "complex".
    of_planes
        Measurements of each plane alone for each real unknown of the object.
    all_planes
        Measurements of all planes together for each real unknown.
    """

    kind: str
    of_planes: tuple[float, ...]
    all_planes: float


@dataclass(frozen=True, repr=False)
class CheckReport:
    """Result of the check of a lens against its constraints.

    Each value is given at the wavelength where it is worst; `wavelengths` holds the values at every
    wavelength. Eqs. 1 and 2 are those of the paper that :func:`lensdesign.analysis.check.check_design` cites.

    Attributes
    ----------
    title
        Title of the design.
    feasible
        Whether every constraint is met.
    violations
        A sentence for each violated constraint, with value, limit and excess.
    constraints
        All constraints, met or not, each with its value and limit.
    sbp_object, sbp_sensor
        Space-bandwidth products of the object and of the sensor (Eq. 1).
    oversampling
        Oversampling ratio for each kind of object at the first wavelength
        (:mod:`lensdesign.analysis.oversampling`).
    spread_limit_deg, max_spread_deg
        Largest angle to the axis that the pixels can sample, and largest angle of all rays behind the lens
        (Eq. 2); both in the medium in front of the sensor, at the wavelength of `worst_ray`.
    spread_heights_mm, spread_per_field_deg
        Field heights, and the largest angle of the rays from each of them, at the same wavelength.
    worst_ray
        The ray whose angle is `max_spread_deg`.
    highest_frequency_lp_per_mm
        Highest spatial frequency that the pixels resolve, 1 / (2 pitch).
    resolution_um
        Resolution in the object, wavelength / (2 NA).
    numerical_aperture
        Sine of the angle between the axis and the ray from the axial object point to the rim of the stop.
    plane_distances_mm, footprint_radius_mm
        Distances of the sensor planes from the exit vertex, and radius on each plane of the circle that
        contains the light of the whole field.
    sensor_half_side_mm
        Half of the sensor's shorter side.
    spot_heights_mm, rms_spot_diameter_mm, spot_plane_mm
        Field heights and root mean square diameters of the spots, and distance of their plane from the exit
        vertex.
    throughput
        Fraction of the rays through the stop that leave the lens, at the worst field point (0 to 1).
    edge_thickness_mm
        Length of the shortest edge cylinder of a glass element; None without glass.
    drawn_edge
        Thinnest edge at the ground diameters of the drawing; None without glass.
    efl_mm, bfl_mm
        Effective and back focal length at the first wavelength, in the medium behind the lens; inf for an
        afocal lens.
    exit_beam_diameter_mm, smallest_exit_beam_diameter_mm
        Diameter of the beam in the plane of the exit vertex, and smallest diameter for which etendue allows
        the spread limit.
    etendue_share
        Fraction of the phase space of the exit beam that the light fills, at most 1: field diameter x NA /
        (exit beam diameter x index x sine of the spread), at the wavelength of `worst_ray`.
    wavelengths
        Results at each wavelength.
    figures
        Form error of each measured surface; empty without measured surfaces.
    moulding
        Checks of moulded elements, which `feasible` and `violations` do not include; empty without one.
    roughness
        Light that rough surfaces scatter, at the shortest wavelength; None without a rough surface.
    coatings
        Effects of the coatings on the light, at each wavelength.

    Examples
    --------
    >>> from lensdesign import check_design
    >>> report = check_design("designs/paper_singlet.toml")
    >>> report.feasible, round(report.max_spread_deg, 2), round(report.spread_limit_deg, 2)
    (False, 4.81, 4.77)
    >>> [constraint.name for constraint in report.constraints if not constraint.met]
    ['largest spread angle (Eq. 2)']
    """

    title: str
    feasible: bool
    violations: tuple[str, ...]
    constraints: tuple[Constraint, ...]
    sbp_object: float
    sbp_sensor: float
    spread_limit_deg: float
    max_spread_deg: float
    spread_heights_mm: tuple[float, ...]
    spread_per_field_deg: tuple[float, ...]
    worst_ray: WorstRay
    highest_frequency_lp_per_mm: float
    resolution_um: float
    numerical_aperture: float
    plane_distances_mm: tuple[float, ...]
    footprint_radius_mm: tuple[float, ...]
    sensor_half_side_mm: float
    spot_heights_mm: tuple[float, ...]
    rms_spot_diameter_mm: tuple[float, ...]
    spot_plane_mm: float
    throughput: float
    edge_thickness_mm: float | None
    drawn_edge: DrawnEdge | None
    efl_mm: float
    bfl_mm: float
    exit_beam_diameter_mm: float
    smallest_exit_beam_diameter_mm: float
    etendue_share: float
    wavelengths: tuple[WavelengthCheck, ...]
    figures: tuple[FormError, ...]
    moulding: tuple[MouldingCheck, ...] = ()
    roughness: RoughnessReport | None = None
    coatings: tuple[CoatingReport, ...] = ()
    oversampling: tuple[OversamplingRatio, ...] = ()

    @property
    def darkest(self) -> CoatingReport | None:
        """Effects of the coatings at the wavelength of which the centre of the field transmits least."""
        return min(self.coatings, key=lambda report: report.centre.transmittance, default=None)

    @property
    def mouldable(self) -> bool:
        """Whether no binding limit of moulding is missed; True for a lens without moulded elements."""
        return not any(check.is_missed for check in self.moulding)

    def __repr__(self) -> str:
        missed = len(self.violations) + sum(check.is_missed for check in self.moulding)
        met = f"not met: {missed}" if missed else "every constraint met"
        return (
            f"<CheckReport {self.title!r}: {met}, spread {self.max_spread_deg:.4f} of "
            f"{self.spread_limit_deg:.4f}°, resolution {self.resolution_um:.4g} µm>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (
                c.name,
                ("" if c.met else "not met: ")
                + number_with_unit(f"{c.value:.6g} {relation_symbol(c.relation)} {c.limit:.6g}", c.unit),
            )
            for c in self.constraints
        ]
        rows += [(f"element {c.element}: {c.name}", c.result_text) for c in self.moulding]
        if self.roughness is not None:
            rows.append(("scattered light", f"{100.0 * self.roughness.mean_fraction:.3g} %"))
        if (darkest := self.darkest) is not None and not darkest.is_ideal:
            rows.append(("transmittance on the axis", f"{100.0 * darkest.centre.transmittance:.2f} %"))
        rows += [(f"oversampling, {name}", text) for name, text in self.oversampling_texts()]
        rows += [
            ("resolution", f"{self.resolution_um:.4g} µm"),
            ("effective, back focal length", f"{self.efl_mm:.4f}, {self.bfl_mm:.4f} mm"),
            ("exit beam diameter", f"{self.exit_beam_diameter_mm:.3f} mm"),
        ]
        return html_table(self.title or "Check", rows)

    def oversampling_texts(self) -> tuple[tuple[str, str], ...]:
        """Return names and values of the oversampling ratios: of each plane, and of all of them."""
        return tuple(
            (
                f"{one.kind} object",
                ", ".join(f"{ratio:.2f}" for ratio in one.of_planes)
                + (f"; all planes {one.all_planes:.2f}" if len(one.of_planes) > 1 else ""),
            )
            for one in self.oversampling
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; values that are not finite become None."""
        return _plain(asdict(self) | {"mouldable": self.mouldable})


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return finite_or_none(value)
