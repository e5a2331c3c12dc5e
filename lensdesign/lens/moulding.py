"""Moulded elements: families of materials, and the limits of moulding with the source of every value.

The table :data:`LIMITS` holds only limits for which a published source was found. No published minimum
thickness was found for cyclic olefins (COC, COP) and for pressed glass, and no radius of a diamond tool.
These limits have no default, and a design states them where they matter. Several sources are guides to
housings and other parts with thin walls, because moulders of optics publish few numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.lens.catalogues.thermal import split_temperature

Process = Literal["injection", "pressed_glass", "none"]
"""How an element is moulded: injection of a plastic, pressing of glass, or not at all."""

Family = Literal["PMMA", "PC", "PS", "cyclic olefin", "other plastic", "glass"]
"""Family of materials with common limits."""

MouldingCheckName = Literal["draft", "gate", "thickness", "thickness_ratio", "slope", "sag", "tool_radius"]
"""Checks that a design can switch off."""

_EXACT_NAMES: dict[str, Family] = {
    "acrylic": "PMMA",
    "pc": "PC",
    "ps": "PS",
    "cop": "cyclic olefin",
    "coc": "cyclic olefin",
    "e48r": "cyclic olefin",
    "480r": "cyclic olefin",
    "f52r": "cyclic olefin",
    "k26r": "cyclic olefin",
    "san": "other plastic",
    "nas": "other plastic",
    "nas-21": "other plastic",
}
"""Families by the whole name of a material, in lower case."""

_NAME_STARTS: dict[str, Family] = {
    "pmma": "PMMA",
    "polycarb": "PC",
    "polystyr": "PS",
    "zeonex": "cyclic olefin",
    "zeonor": "cyclic olefin",
    "topas": "cyclic olefin",
    "apel": "cyclic olefin",
    "arton": "cyclic olefin",
    "optorez": "other plastic",
    "okp": "other plastic",
}
"""Families by the beginning of the name of a material, in lower case."""


def plastic_family(material: str | float | None) -> Family | None:
    """Return the family of a plastic by its name in a design file; None for another material.

    Examples
    --------
    >>> from lensdesign.lens.moulding import plastic_family
    >>> plastic_family("E48R"), plastic_family("PMMA@40C"), plastic_family("N-BK7")
    ('cyclic olefin', 'PMMA', None)
    """
    if not isinstance(material, str):
        return None
    plain = split_temperature(material)[0] if "@" in material else material
    name = plain.rpartition(":")[2].strip().casefold()
    if name in _EXACT_NAMES:
        return _EXACT_NAMES[name]
    return next((family for start, family in _NAME_STARTS.items() if name.startswith(start)), None)


@dataclass(frozen=True)
class LimitSource:
    """A published source of a limit.

    Attributes
    ----------
    title, address
        Title of the page, and its address.
    states
        What the page states, in short.
    """

    title: str
    address: str
    states: str


@dataclass(frozen=True)
class MouldingLimit:
    """A limit of moulding.

    Attributes
    ----------
    value
        The limit, in the unit at the end of its key.
    sources
        Pages that state it. If they differ, the limit is the more cautious value.
    """

    value: float
    sources: tuple[LimitSource, ...]

    @property
    def source(self) -> str:
        """Title of the source whose value is the limit."""
        return self.sources[0].title


_WALLS = "https://plastopialtd.com/wall-thickness"
_PLASTOPIA = "Plastopia, Wall thickness"
_XCENTRIC = "Xcentric Mold & Engineering, Material wall thickness guide"
_XCENTRIC_ADDRESS = "https://www.scribd.com/document/470447347/Material-Wall-Thickness-7-17-19-F"


def _wall(value_mm: float, range_mm: str, range_inches: str) -> MouldingLimit:
    return MouldingLimit(
        value_mm,
        (
            LimitSource(_PLASTOPIA, _WALLS, f"wall thickness {range_mm} mm"),
            LimitSource(_XCENTRIC, _XCENTRIC_ADDRESS, f"wall thickness {range_inches}"),
        ),
    )


_PMMA_WALLS = ("0.635 to 12.7", "0.025 to 0.500 in (0.635 to 12.7 mm)")
_PC_WALLS = ("1.016 to 3.81", "0.040 to 0.150 in (1.016 to 3.81 mm)")
_PS_WALLS = ("0.889 to 3.81", "0.020 in (0.508 mm) and more")

_ASPHERE_LIMITS = "Optimax, Asphere limits"
_ASPHERE_ADDRESS = "http://www.optimaxsi.com/innovation/optical-manufacturing-tolerance-chart/asphere-limits/"

PLASTIC_FAMILIES: tuple[Family, ...] = ("PMMA", "PC", "PS", "cyclic olefin", "other plastic")
ALL_FAMILIES: tuple[Family, ...] = get_args(Family)

LIMITS: dict[str, dict[Family, MouldingLimit]] = {
    "min_draft_deg": dict.fromkeys(
        PLASTIC_FAMILIES,
        MouldingLimit(
            1.0,
            (
                LimitSource(
                    "MFGABC, Plastic part design rules",
                    "https://www.mfgabc.com/guide/plastic-part-design-rules.html",
                    "exterior 1 degree minimum",
                ),
                LimitSource(
                    "Minghao Mould, Draft angle",
                    "http://minghaomould.com/index.asp?m=reference&u=8&id=7",
                    "1/2 degree per side is the extreme minimum, 1 degree is standard practice",
                ),
                LimitSource(
                    "Neway Precision, Rapid molding",
                    "https://newayprecision.com/services/rapid-molding-prototyping",
                    "1 to 3 degrees per side",
                ),
            ),
        ),
    ),
    "min_gate_clearance_mm": dict.fromkeys(
        PLASTIC_FAMILIES,
        MouldingLimit(
            0.5,
            (
                LimitSource(
                    "Apollo Optical Systems, Manufacturing tolerances",
                    "https://www.apollooptical.com/manufacturing-tolerances",
                    "edge clearance from the clear aperture to the outer dimensions: 0.5 mm for commercial, "
                    "0.25 mm for precision injection moulding",
                ),
            ),
        ),
    ),
    "min_gate_width_mm": dict.fromkeys(
        PLASTIC_FAMILIES,
        MouldingLimit(
            1.5,
            (
                LimitSource(
                    "Yixun Mold, Mastering injection mold gate design",
                    "https://www.yixunmold.com/Mastering-Injection-Mold-Gate-Design-From-Edge-Gates-to-"
                    "Pinpoint-Gates-id01682055.html",
                    "width of an edge gate 1.5 to 5 mm",
                ),
            ),
        ),
    ),
    "min_gate_thickness_ratio": dict.fromkeys(
        PLASTIC_FAMILIES,
        MouldingLimit(
            0.5,
            (
                LimitSource(
                    "Tritan troubleshooting guide, Edge gate",
                    "https://diamond-systems.manymanuals-pt.com/electrical-enclosures/tritan/"
                    "troubleshooting-guide-34547/17",
                    "gate thickness 0.5 to 0.80 times the part thickness",
                ),
                LimitSource(
                    "Yixun Mold, Mastering injection mold gate design",
                    "https://www.yixunmold.com/Mastering-Injection-Mold-Gate-Design-From-Edge-Gates-to-"
                    "Pinpoint-Gates-id01682055.html",
                    "thickness of an edge gate 0.5 to 0.8 times the wall",
                ),
            ),
        ),
    ),
    "min_thickness_mm": {
        "PMMA": _wall(0.635, *_PMMA_WALLS),
        "PC": _wall(1.016, *_PC_WALLS),
        "PS": _wall(0.889, *_PS_WALLS),
    },
    "max_thickness_mm": {
        "PMMA": _wall(12.7, *_PMMA_WALLS),
        "PC": _wall(3.81, *_PC_WALLS),
        "PS": MouldingLimit(3.81, (LimitSource(_PLASTOPIA, _WALLS, "wall thickness 0.889 to 3.81 mm"),)),
    },
    "max_thickness_ratio": dict.fromkeys(
        PLASTIC_FAMILIES,
        MouldingLimit(
            2.0,
            (
                LimitSource(
                    "MFGABC, Plastic part design rules",
                    "https://www.mfgabc.com/guide/plastic-part-design-rules.html",
                    "avoid changes of wall thickness above 2:1",
                ),
                LimitSource(
                    "Plastic lecture notes",
                    "http://plasticlecturenotes.blogspot.com/2011/08",
                    "wall thickness should not vary by more than 3:1",
                ),
                LimitSource(
                    "Protolabs, Injection molding wall thickness guidelines",
                    "https://protolabs.com/resources/design-tips/improving-part-design-with-uniform-wall-"
                    "thickness",
                    "walls no less than 40 to 60 % of adjacent walls, which is 2.5:1 to 1.7:1",
                ),
            ),
        ),
    ),
    "max_slope_deg": dict.fromkeys(
        ALL_FAMILIES,
        MouldingLimit(
            60.0,
            (
                LimitSource(
                    _ASPHERE_LIMITS,
                    _ASPHERE_ADDRESS,
                    "included angle at most 120 degrees with lower resolution profilometry, 150 with higher",
                ),
            ),
        ),
    ),
    "max_sag_mm": dict.fromkeys(
        ALL_FAMILIES,
        MouldingLimit(
            25.0,
            (
                LimitSource(
                    _ASPHERE_LIMITS,
                    _ASPHERE_ADDRESS,
                    "sag of at most 25 mm with higher resolution profilometry, 50 with lower",
                ),
            ),
        ),
    ),
}
"""Default limits by key and family of materials. A missing family has no default."""

LIMITS["max_gate_thickness_ratio"] = {
    family: MouldingLimit(0.8, limit.sources) for family, limit in LIMITS["min_gate_thickness_ratio"].items()
}


class Moulding(FrozenModel):
    """Settings of the moulding checks of a design.

    Elements of a known plastic are checked without this table. A limit here replaces that of
    :data:`lensdesign.lens.moulding.LIMITS`.

    Attributes
    ----------
    process
        ``injection``: the elements are injection moulded, also those of a material that is not known as a
        plastic. ``pressed_glass``: elements of another material than a known plastic are moulded glass.
        ``none``: no checks. None (default): only elements of a known plastic are moulded.
    elements
        Numbers, from 1, of the elements that are checked (default: all that are moulded).
    off
        Checks that are switched off: ``draft``, ``gate``, ``thickness``, ``thickness_ratio``, ``slope``,
        ``sag`` or ``tool_radius``.
    tool_radius_mm, tool_included_angle_deg
        Nose radius and included angle of the diamond tool that turns the mould inserts. Steeper slopes than
        half of the angle, and concave radii of an insert below the nose radius, cannot be turned.
    min_draft_deg
        Smallest draft of the edge.
    min_gate_clearance_mm
        Smallest distance of the gate flat from the clear aperture.
    min_gate_width_mm
        Smallest width of the gate.
    min_gate_thickness_ratio, max_gate_thickness_ratio
        Range of the gate's thickness divided by that of the edge, or of the flange if there is one.
    min_thickness_mm, max_thickness_mm
        Range of the thickness at the centre, of the edge and of a flange.
    max_thickness_ratio
        Largest ratio of the thicknesses at the centre and of the edge, the larger over the smaller.
    max_slope_deg
        Largest slope of an optical surface.
    max_sag_mm
        Largest difference in height over an optical surface.

    Examples
    --------
    >>> from lensdesign import Moulding
    >>> limit = Moulding(off=("sag",), min_draft_deg=0.5).limit("min_draft_deg", "PMMA")
    >>> limit.value, limit.source
    (0.5, '[moulding] min_draft_deg')
    """

    process: Process | None = None
    elements: tuple[Annotated[int, Field(ge=1)], ...] | None = None
    off: tuple[MouldingCheckName, ...] = ()
    tool_radius_mm: Positive | None = None
    tool_included_angle_deg: Annotated[Positive, Field(le=180.0)] | None = None
    min_draft_deg: Annotated[float, Field(ge=0.0, le=30.0, allow_inf_nan=False)] | None = None
    min_gate_clearance_mm: Positive | None = None
    min_gate_width_mm: Positive | None = None
    min_gate_thickness_ratio: Positive | None = None
    max_gate_thickness_ratio: Positive | None = None
    min_thickness_mm: Positive | None = None
    max_thickness_mm: Positive | None = None
    max_thickness_ratio: Annotated[float, Field(ge=1.0, allow_inf_nan=False)] | None = None
    max_slope_deg: Annotated[Positive, Field(lt=90.0)] | None = None
    max_sag_mm: Positive | None = None

    @model_validator(mode="after")
    def _ranges(self) -> Moulding:
        for name in ("gate_thickness_ratio", "thickness_mm"):
            least, most = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if least is not None and most is not None and least > most:
                raise ValueError(f"min_{name} = {least:g} must not be greater than max_{name} = {most:g}")
        return self

    def family(self, material: str | float | None, number: int) -> Family | None:
        """Return the family of a moulded element's material; None if the element is not checked.

        Parameters
        ----------
        material
            Material of the element, as in the design file.
        number
            Number of the element, from 1.
        """
        if self.process == "none" or (self.elements is not None and number not in self.elements):
            return None
        others: dict[Process | None, Family] = {"injection": "other plastic", "pressed_glass": "glass"}
        return plastic_family(material) or others.get(self.process)

    def limit(self, key: str, family: Family) -> MouldingLimit | None:
        """Return a limit by its key and the family of the material.

        It is None if neither this table nor a published source has it.
        """
        own = getattr(self, key)
        if own is not None:
            return MouldingLimit(float(own), (LimitSource(f"[moulding] {key}", "", "stated in the design"),))
        return LIMITS[key].get(family)
