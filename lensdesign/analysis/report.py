"""Result of a check: values at each wavelength, the constraints, and a sentence for every violation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lensdesign.analysis.form_error import FormError
from lensdesign.analysis.outline import DrawnEdge
from lensdesign.common.notebook import html_table
from lensdesign.common.text import finite_or_none


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


@dataclass(frozen=True, repr=False)
class CheckReport:
    """Result of the check of a lens against its constraints.

    Each value is that of the wavelength at which it is worst; `wavelengths` has the values of all.

    Attributes
    ----------
    title
        Title of the design.
    feasible
        Whether every constraint is met.
    violations
        A sentence for each violated constraint, with value, limit and excess.
    constraints
        All constraints.
    sbp_object, sbp_sensor
        Space-bandwidth products (Eq. 1).
    spread_limit_deg, max_spread_deg
        Spread-angle limit, and largest angle over field, stop and wavelengths (Eq. 2); both at the
        wavelength of `worst_ray`.
    spread_heights_mm, spread_per_field_deg
        Field heights, and the largest angle at each of them at the same wavelength.
    worst_ray
        The ray with the angle `max_spread_deg`.
    highest_frequency_lp_per_mm
        Highest frequency that the pixels resolve.
    resolution_um
        wavelength / (2 NA).
    numerical_aperture
        Sine of the angle of the ray from the axis through the rim of the stop.
    plane_distances_mm, footprint_radius_mm
        Distances of the sensor planes, and the radius of the light of the whole field on each.
    sensor_half_side_mm
        Half of the sensor's shorter side.
    spot_heights_mm, rms_spot_diameter_mm, spot_plane_mm
        Field heights and RMS diameters of the spots, and distance of their plane from the exit vertex.
    throughput
        Smallest fraction of the uniformly filled stop that passes from a field point.
    edge_thickness_mm
        Length of the shortest edge cylinder of a glass element; None without glass.
    drawn_edge
        Thinnest edge at the ground diameters of the drawing; None without glass.
    efl_mm, bfl_mm
        Effective and back focal length at the first wavelength; inf for an afocal lens.
    exit_beam_diameter_mm, smallest_exit_beam_diameter_mm
        Beam in the plane of the exit vertex, and the narrowest that the etendue bound allows at the spread
        limit.
    etendue_share
        FOV NA / (exit beam diameter x sine of the spread) at the wavelength of `worst_ray`: the fraction of
        the phase space of its exit beam that the lens uses, at most 1.
    wavelengths, figures
        Results at each wavelength, and form error of each measured surface.

    Examples
    --------
    See :func:`lensdesign.check_design`.
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

    def __repr__(self) -> str:
        met = "every constraint met" if self.feasible else f"not met: {len(self.violations)}"
        return (
            f"<CheckReport {self.title!r}: {met}, spread {self.max_spread_deg:.4f} of "
            f"{self.spread_limit_deg:.4f} deg, resolution {self.resolution_um:.4g} um>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (c.name, f"{'' if c.met else 'not met: '}{c.value:.6g} {c.relation} {c.limit:.6g} {c.unit}")
            for c in self.constraints
        ]
        rows += [
            ("resolution", f"{self.resolution_um:.4g} um"),
            ("effective, back focal length", f"{self.efl_mm:.4f}, {self.bfl_mm:.4f} mm"),
            ("exit beam diameter", f"{self.exit_beam_diameter_mm:.3f} mm"),
        ]
        return html_table(self.title or "Check", rows)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; values that are not finite become None."""
        return _plain(asdict(self))


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return finite_or_none(value)
