"""Tolerances of a drawing, and the general tolerances of ISO 10110-11."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from lensdesign.analysis.outline import GENERAL_EDGES, EdgeAllowance
from lensdesign.common.frozen_model import Finite, FrozenModel, Positive
from lensdesign.errors import InputError
from lensdesign.lens.surface import Surface

MERCURY_LINE_UM = 0.54607
"""Green mercury line, the default wavelength of fringe spacings in ISO 10110-5."""

NotNegative = Annotated[Finite, Field(ge=0.0, le=1e9)]
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
    imperfections
        5/: number and grade, such as ``5x0.25``.
    laser_damage
        6/: laser damage threshold in the notation of ISO 10110-17.
    chamfer_mm
        Smallest and largest width of the protective chamfer in mm.
    coating
        Text beside the symbol of the coating.
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
    imperfections: ShortText = ""
    laser_damage: ShortText = ""
    chamfer_mm: tuple[NotNegative, NotNegative] | None = None
    coating: ShortText = ""

    def radius_allowed_mm(self, surface: Surface, fringe_um: float) -> float | None:
        """Return the tolerance (±) of a surface's radius in mm; None if it is not specified.

        A fringe spacings over a radial height h are a sagitta of A wavelength / 2 = h^2 dR / (2 R^2).
        """
        if self.radius_mm is not None or self.radius_fringes is None or surface.radius_mm is None:
            return self.radius_mm
        clear = surface.semi_diameter_mm
        heights = [h for h in (clear, 0.5 * (self.test_diameter_mm or 0.0)) if h]
        if not heights:
            return None
        return 1e-3 * fringe_um * self.radius_fringes * (surface.radius_mm / min(heights)) ** 2

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
        Wavelength in um; a fringe spacing is half of it.
    density_g_per_cm3
        Density of the glass, from its data sheet. Without it the drawing states no mass.
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
    density_g_per_cm3: Positive | None = None
    source: ShortText = ""


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
