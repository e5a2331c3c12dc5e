"""Tolerances of a drawing, and the general tolerances of ISO 10110-11."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from lensdesign.analysis.outline import GENERAL_EDGES, EdgeAllowance
from lensdesign.common.frozen_model import FrozenModel, NotNegative, Positive
from lensdesign.errors import InputError
from lensdesign.lens.surface import Surface

MERCURY_LINE_UM = 0.54607
"""Green mercury line, the default wavelength of fringe spacings in ISO 10110-5."""

ShortText = Annotated[str, Field(max_length=200)]


GENERAL_MARK, DERIVED_MARK = "*", "†"
"""Marks of values that are general tolerances, and of values derived from a tolerance study."""


class MarkedTolerances(FrozenModel):
    """Tolerances with marks for values that do not come from the stated source.

    Attributes
    ----------
    general
        Names of values that are general tolerances; the sheet marks them with an asterisk.
    derived
        Names of values that were derived from a tolerance study; the sheet marks them with a dagger.
    """

    general: tuple[str, ...] = ()
    derived: tuple[str, ...] = ()

    def mark(self, name: str) -> str:
        """Return the mark of a value on the sheet; empty if it has none."""
        return GENERAL_MARK if name in self.general else DERIVED_MARK if name in self.derived else ""

    def with_derived(self, **values: Any) -> Self:
        """Return the tolerances with derived values, which are marked."""
        general = tuple(name for name in self.general if name not in values)
        return self.replaced(**values, general=general, derived=(*self.derived, *values))

    def marked_general(self, known: Collection[str]) -> Self:
        """Return the tolerances; values are marked as general unless `known` lists them."""
        names = (name for name in type(self).model_fields if name not in MarkedTolerances.model_fields)
        return self.replaced(general=tuple(n for n in names if n not in known and self._states(n)))

    def _states(self, name: str) -> bool:
        value = getattr(self, name)
        stated = value != type(self).model_fields[name].default
        return name != "source" and stated and not isinstance(value, FrozenModel)


class SlopeTolerance(FrozenModel):
    """Slope tolerance of a conic, an asphere or a biconic (ISO 10110-12).

    Attributes
    ----------
    slope_mrad
        Largest deviation of the slope from the nominal one in mrad.
    length_mm
        Integration length in mm: each slope is that of the line through the heights over this length.
    sampling_mm
        Largest distance of the measured heights in mm.
    """

    slope_mrad: Positive
    length_mm: Positive
    sampling_mm: Positive

    @property
    def lines(self) -> tuple[str, str]:
        """Indication on the sheet, in two lines."""
        return (
            f"slope error ≤ {self.slope_mrad:g} mrad",
            f"integration length {self.length_mm:g}, sampling {self.sampling_mm:g} mm",
        )

    @model_validator(mode="after")
    def _sampled(self) -> Self:
        if self.sampling_mm > self.length_mm:
            raise ValueError(
                f"sampling_mm = {self.sampling_mm:g} must not be greater than length_mm = {self.length_mm:g}"
            )
        return self


FormUnit = Literal["fringes", "nm"]
"""Unit of the surface form tolerances 3/ on a sheet: fringe spacings, or nanometres."""

FORM_IN_NM = {
    "sagitta_nm": "radius_fringes",
    "irregularity_nm": "irregularity_fringes",
    "symmetric_nm": "symmetric_fringes",
    "rms_irregularity_nm": "rms_irregularity_fringes",
}
"""Keys of a file for form tolerances in nanometres, and the values in fringe spacings that they set."""


class SurfaceTolerances(MarkedTolerances):
    """Tolerances of one surface on a drawing; None or an empty text omits an indication.

    Attributes
    ----------
    radius_mm
        Tolerance (±) of the radius of curvature in mm. It replaces `radius_fringes`.
    radius_fringes
        A of 3/A(B/C): sagitta error in fringe spacings.
    irregularity_fringes, symmetric_fringes
        B and C of 3/A(B/C): irregularity, and its rotationally symmetric component, in fringe spacings.
    test_diameter_mm
        Diameter in mm, anywhere on the surface, to which A, B and C apply; None: the clear aperture.
    rms_irregularity_fringes
        D of 3/A(B/C) RMSi < D: root mean square irregularity in fringe spacings.
    centring_arcmin, decenter_mm
        4/: tilt of the surface against the datum axis in arcmin, and lateral displacement of an asphere in
        mm.
    conic
        Tolerance (±) of the conic constant.
    slope
        Slope tolerance of a surface that is neither a plane nor a sphere.
    imperfections
        5/: number and grade, such as ``5x0.25``.
    laser_damage
        6/: laser damage threshold in the notation of ISO 10110-17.
    chamfer_mm
        Smallest and largest width of the protective chamfer in mm.
    coating
        Text beside the symbol of the coating; default: the coating of the design.
    """

    radius_mm: Positive | None = None
    radius_fringes: NotNegative | None = None
    irregularity_fringes: NotNegative | None = None
    symmetric_fringes: NotNegative | None = None
    test_diameter_mm: Positive | None = None
    rms_irregularity_fringes: NotNegative | None = None
    centring_arcmin: NotNegative | None = None
    decenter_mm: NotNegative | None = None
    conic: Positive | None = None
    slope: SlopeTolerance | None = None
    imperfections: ShortText = ""
    laser_damage: ShortText = ""
    chamfer_mm: tuple[NotNegative, NotNegative] | None = None
    coating: ShortText = ""

    def radius_allowed_mm(
        self, surface: Surface, fringe_um: float, radius_mm: float | None = None
    ) -> float | None:
        """Return the tolerance (±) of a radius of a surface in mm; None if it is not specified.

        A fringe spacings over a radial height h are a sagitta of A wavelength / 2 = h^2 dR / (2 R^2).

        Parameters
        ----------
        surface
            The surface.
        fringe_um
            Test wavelength in um.
        radius_mm
            The radius, such as that of the other section of a biconic (default: `radius_mm` of the surface).
        """
        radius_mm = surface.radius_mm if radius_mm is None else radius_mm
        if self.radius_mm is not None or self.radius_fringes is None or radius_mm is None:
            return self.radius_mm
        clear = surface.semi_diameter_mm
        heights = [h for h in (clear, 0.5 * (self.test_diameter_mm or 0.0)) if h]
        if not heights:
            return None
        return 1e-3 * fringe_um * self.radius_fringes * (radius_mm / min(heights)) ** 2

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.radius_mm is not None and self.radius_fringes is not None:
            raise ValueError("radius_mm and radius_fringes given: must be one of them")
        if self.symmetric_fringes is not None and self.irregularity_fringes is None:
            raise ValueError("symmetric_fringes is a part of irregularity_fringes, which is missing")
        if self.chamfer_mm is not None and self.chamfer_mm[0] > self.chamfer_mm[1]:
            raise ValueError("chamfer_mm must be the smallest width, then the largest")
        return self


class DrawingTolerances(MarkedTolerances):
    """Tolerances of one glass element on a drawing.

    In a file, ``left`` and ``right`` may state the form tolerances in nanometres instead of fringe spacings:
    ``sagitta_nm``, ``irregularity_nm``, ``symmetric_nm`` and ``rms_irregularity_nm``. They are converted with
    the wavelength of the sheet, which then shows nanometres.

    Attributes
    ----------
    left, right
        Tolerances of the surface that light meets first, and of the other one.
    thickness_mm, diameter_mm
        Tolerances (±) of the centre thickness and of the ground diameter in mm.
    index, abbe_percent
        Tolerances (±) of the refractive index, and of the Abbe number in percent.
    stress_birefringence, bubbles, inhomogeneity
        0/ in nm/cm, 1/ and 2/ in the notation of ISO 10110-2 to 10110-4.
    fringe_wavelength_um
        Test wavelength in um; a fringe spacing is half of it.
    form_unit
        Unit of the form tolerances on the sheet: ``fringes`` or ``nm``.
    density_g_per_cm3
        Density of the glass, from its data sheet (default: that of the catalogue).
    source
        Source of the values, which the drawing states.
    """

    left: SurfaceTolerances = SurfaceTolerances()
    right: SurfaceTolerances = SurfaceTolerances()
    thickness_mm: Positive | None = None
    diameter_mm: Positive | None = None
    index: Positive | None = None
    abbe_percent: Positive | None = None
    stress_birefringence: ShortText = ""
    bubbles: ShortText = ""
    inhomogeneity: ShortText = ""
    fringe_wavelength_um: Positive = MERCURY_LINE_UM
    form_unit: FormUnit = "fringes"
    density_g_per_cm3: Positive | None = None
    source: ShortText = ""

    @model_validator(mode="before")
    @classmethod
    def _form_in_fringes(cls, values: Any) -> Any:
        """Convert form tolerances in nanometres to fringe spacings."""
        if not isinstance(values, Mapping):
            return values
        fringe_um = values.get("fringe_wavelength_um", MERCURY_LINE_UM)
        sides = {side: values[side] for side in ("left", "right") if isinstance(values.get(side), Mapping)}
        stated = {side: sorted(FORM_IN_NM.keys() & table.keys()) for side, table in sides.items()}
        if not any(stated.values()) or not _is_positive(fringe_um):
            return values
        fringes = [
            f"{side}.{name}" for side, table in sides.items() for name in FORM_IN_NM.values() if name in table
        ]
        if fringes or values.get("form_unit") == "fringes":
            keys = ", ".join(f"{side}.{key}" for side, names in stated.items() for key in names)
            other = ", ".join(fringes) or "form_unit = 'fringes'"
            raise ValueError(f"{keys} and {other}: state all form tolerances of a sheet in one unit")
        converted: dict[str, Any] = {}
        for side, table in sides.items():
            for key in stated[side]:
                if not _is_positive(table[key]):
                    raise ValueError(f"{side}.{key} = {table[key]!r}: must be a finite number above 0")
            own = {FORM_IN_NM[key]: table[key] / (500.0 * fringe_um) for key in stated[side]}
            converted[side] = {key: value for key, value in table.items() if key not in FORM_IN_NM} | own
        return {**values, **converted, "form_unit": "nm"}

    def form_text(self, fringes: float, mark: str = "") -> str:
        """Return a form tolerance in the unit of the sheet; a fringe spacing is half of the wavelength."""
        if self.form_unit == "fringes":
            return f"{fringes:g}{mark}"
        return f"{500.0 * self.fringe_wavelength_um * fringes:.4g}{mark} nm"


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf


def _general(
    edge: EdgeAllowance,
    material: tuple[str, str, str],
    form_fringes: tuple[float, float],
    test_diameter_mm: float | None,
    centring_arcmin: float,
    imperfections: str,
) -> DrawingTolerances:
    surface = SurfaceTolerances(
        radius_fringes=form_fringes[0],
        irregularity_fringes=form_fringes[1],
        test_diameter_mm=test_diameter_mm,
        centring_arcmin=centring_arcmin,
        imperfections=imperfections,
        chamfer_mm=edge.chamfer_mm,
    )
    stress, bubbles, inhomogeneity = material
    return DrawingTolerances(
        left=surface,
        right=surface,
        thickness_mm=edge.thickness_mm,
        diameter_mm=edge.diameter_mm,
        stress_birefringence=stress,
        bubbles=bubbles,
        inhomogeneity=inhomogeneity,
        source="general tolerances of ISO 10110-11:1996, table 1",
    )


_GRADES: tuple[tuple[tuple[str, str, str], tuple[float, float], float | None, float, str], ...] = (
    (("20", "3x0.16", "1;1"), (5.0, 1.0), None, 30.0, "3x0.16"),
    (("20", "5x0.25", "1;1"), (10.0, 2.0), None, 20.0, "5x0.25"),
    (("", "5x0.4", ""), (10.0, 2.0), 30.0, 10.0, "5x0.4"),
    (("", "5x0.63", ""), (10.0, 2.0), 60.0, 10.0, "5x0.63"),
)

GENERAL = {
    size: _general(edge, *grades) for (size, edge), grades in zip(GENERAL_EDGES.items(), _GRADES, strict=True)
}
"""Table 1 of ISO 10110-11:1996 by the upper limit of the part's largest dimension in mm.

Later editions differ.
"""


def general_tolerances(largest_dimension_mm: float) -> DrawingTolerances:
    """Return the tolerances of a part without stated tolerances (ISO 10110-11:1996, table 1).

    Parameters
    ----------
    largest_dimension_mm
        Diameter or thickness of the part in mm, whichever is larger.

    Raises
    ------
    InputError
        If the part is larger than the limit of the table.
    """
    for limit_mm, tolerances in GENERAL.items():
        if largest_dimension_mm <= limit_mm:
            return tolerances
    raise InputError(
        f"the part measures {largest_dimension_mm:.4g} mm; the general tolerances of ISO 10110-11 end at "
        f"{max(GENERAL):g} mm; state the tolerances of the drawing"
    )
