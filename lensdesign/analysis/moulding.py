"""Moulding checks of an element: draft, gate, thicknesses, and the slopes and sags that tools can make.

The limits and their sources are those of :mod:`lensdesign.lens.moulding`. An element is checked with the
outline of its drawing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lensdesign.analysis.outline import drawn_outline
from lensdesign.common.text import number_with_unit, relation_symbol
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.moulding import Family, LimitSource, Moulding, MouldingCheckName, MouldingLimit
from lensdesign.lens.solid import Element, glass_element

TOOL = "geometry of the stated tool"
FLAT = "geometry of the gate flat"
"""Sources of limits that follow from other values of the design."""


@dataclass(frozen=True)
class MouldingCheck:
    """Result of one moulding check.

    Attributes
    ----------
    element
        Number of the element, from 1.
    check
        Name by which the check can be switched off.
    name, unit
        Name of the limited quantity, and unit of both numbers (empty for pure numbers).
    value, relation, limit
        Value, relation and limit, such as 0.5, ">=", 1.0. A value that the design does not state, and a limit
        without a source, are None.
    met
        Whether the value is within the limit; None if this is not known.
    miss
        Sentence on a limit that is not met, or on why it is not known; empty if it is met.
    limit_key
        Key of the limit in the table ``[moulding]``; empty for a limit that follows from other values.
    source, source_address
        Source of the limit and its address; empty without one.
    is_guideline
        Whether the limit is a published guideline. The limits that a design states, and those that follow
        from other values of it, are binding.

    Examples
    --------
    >>> from lensdesign import load_design, moulding_checks
    >>> draft = moulding_checks(load_design("designs/phone_lens.toml"))[0]
    >>> draft.name, draft.value_text, draft.met
    ('draft of the edge', 'not stated ≥ 1°', None)
    """

    element: int
    check: MouldingCheckName
    name: str
    value: float | None
    relation: str
    limit: float | None
    unit: str
    met: bool | None
    miss: str
    limit_key: str
    source: str
    source_address: str
    is_guideline: bool

    @property
    def is_missed(self) -> bool:
        """Whether a binding limit is not met."""
        return self.met is False and not self.is_guideline

    @property
    def result_text(self) -> str:
        """Value, limit and result on one short line."""
        missed = "beyond the guideline" if self.is_guideline else "not met"
        result = {True: "met", False: missed, None: "open"}[self.met]
        return f"{self.value_text}: {result}"

    @property
    def source_text(self) -> str:
        """Source of the limit with its address."""
        return f"{self.source}, {self.source_address}" if self.source_address else self.source

    @property
    def value_text(self) -> str:
        """Value and limit on one short line, such as 0.5° ≥ 1°."""
        value = "not stated" if self.value is None else number_with_unit(f"{self.value:.4g}", self.unit)
        limit = (
            ""
            if self.limit is None
            else f" {relation_symbol(self.relation)} {number_with_unit(f'{self.limit:.4g}', self.unit)}"
        )
        return f"{value}{limit}"


def moulding_checks(lens: Lens) -> tuple[MouldingCheck, ...]:
    """Check the moulded elements of a lens.

    Elements of a known plastic are moulded. The table ``[moulding]`` of the design selects others, switches
    checks off and replaces limits.

    Parameters
    ----------
    lens
        Any lens.

    Returns
    -------
    tuple of MouldingCheck
        Checks of each moulded element, front to back; empty without one.

    Examples
    --------
    >>> from lensdesign import load_design, moulding_checks
    >>> lens = load_design("designs/phone_lens.toml")
    >>> [f"{check.name}: {check.result_text}" for check in moulding_checks(lens) if check.met is False]
    ['centre to edge thickness ratio: 2.831 ≤ 2: beyond the guideline']
    """
    settings = lens.moulding or Moulding()
    families = {
        index: family
        for index, front in enumerate(lens.glass_fronts)
        if (family := settings.family(lens.surfaces[front].material, index + 1)) is not None
    }
    if not families:
        return ()
    try:
        outlined = drawn_outline(lens).lens
    except InputError:  # an element of the lens has no size
        outlined = lens
    return tuple(
        check
        for index, family in families.items()
        for check in _Checks(glass_element(outlined, index), family, settings).all()
        if check.check not in settings.off
    )


@dataclass(frozen=True)
class _Checks:
    """One element with the family of its material and the settings of its checks."""

    element: Element
    family: Family
    settings: Moulding

    def all(self) -> Iterator[MouldingCheck]:
        if self.family != "glass":
            yield self._draft()
            yield from self._gate()
        yield from self._thicknesses()
        yield from self._slopes()
        yield from self._sags()
        yield from self._tool_radii()

    def _draft(self) -> MouldingCheck:
        draft = self.element.edge.draft_deg
        return self._limited(
            "draft", "draft of the edge", None if draft is None else abs(draft), ">=", "min_draft_deg", "deg"
        )

    def _gate(self) -> Iterator[MouldingCheck]:
        gate, element = self.element.edge.gate, self.element
        if gate is None:
            yield self._limited(
                "gate", "gate flat to clear aperture", None, ">=", "min_gate_clearance_mm", "mm"
            )
            return
        clear_mm = [m.surface.semi_diameter_mm for m in (element.front, element.back)]
        known_mm = [semi for semi in clear_mm if semi is not None]
        is_known = len(known_mm) == len(clear_mm)
        clearance = element.outer_mm - gate.flat_depth_mm - max(known_mm) if is_known else None
        yield self._limited(
            "gate", "gate flat to clear aperture", clearance, ">=", "min_gate_clearance_mm", "mm"
        )
        yield self._limited("gate", "width of the gate", gate.width_mm, ">=", "min_gate_width_mm", "mm")
        if gate.width_mm is not None:
            yield self._result(
                "gate",
                "width of the gate, on its flat",
                gate.width_mm,
                "<=",
                _by_geometry(gate.flat_width_mm(element.outer_mm), FLAT),
                "mm",
            )
        flange = element.edge.flange
        wall_mm = element.edge_thickness_mm if flange is None else flange.thickness_mm
        of = "gate over edge thickness" if flange is None else "gate over flange thickness"
        ratio = None if gate.thickness_mm is None or wall_mm <= 0.0 else gate.thickness_mm / wall_mm
        yield self._limited("gate", of, ratio, ">=", "min_gate_thickness_ratio")
        if ratio is not None:
            yield self._limited("gate", of, ratio, "<=", "max_gate_thickness_ratio")

    def _thicknesses(self) -> Iterator[MouldingCheck]:
        center, edge, flange = (
            self.element.center_thickness_mm,
            self.element.edge_thickness_mm,
            self.element.edge.flange,
        )
        walls = [("centre thickness", center), ("edge thickness", edge)]
        if flange is not None:
            walls.append(("flange thickness", flange.thickness_mm))
        for name, value in walls:
            yield self._limited("thickness", name, value, ">=", "min_thickness_mm", "mm")
        thickest = max(walls, key=lambda wall: wall[1])
        if self.settings.limit("max_thickness_mm", self.family) is not None:
            yield self._limited("thickness", *thickest, "<=", "max_thickness_mm", "mm")
        if self.settings.limit("max_thickness_ratio", self.family) is not None:
            least = min(center, edge)
            yield self._limited(
                "thickness_ratio",
                "centre to edge thickness ratio",
                max(center, edge) / least if least > 0.0 else math.inf,
                "<=",
                "max_thickness_ratio",
            )

    def _slopes(self) -> Iterator[MouldingCheck]:
        angle_deg = self.settings.tool_included_angle_deg
        for number, sections in self._surfaces():
            slope = max(_steepest_deg(section) for section in sections)
            name = f"slope of surface {number}"
            yield self._limited("slope", name, slope, "<=", "max_slope_deg", "deg")
            if angle_deg is not None:
                limit = _by_geometry(0.5 * angle_deg, TOOL)
                yield self._result("slope", f"{name}, for the tool", slope, "<=", limit, "deg")

    def _sags(self) -> Iterator[MouldingCheck]:
        for number, sections in self._surfaces():
            heights = np.concatenate([s.points(_PARAMETERS)[:, 1] for s in sections])
            sag = float(np.max(heights) - np.min(heights))
            yield self._limited("sag", f"sag of surface {number}", sag, "<=", "max_sag_mm", "mm")

    def _tool_radii(self) -> Iterator[MouldingCheck]:
        tool_mm = self.settings.tool_radius_mm
        if tool_mm is None:
            return
        # The insert is the counterpart of the surface: it is concave where the element is convex.
        for (number, sections), convex in zip(self._surfaces(), (1.0, -1.0), strict=True):
            curvature = max(_largest_curvature_per_mm(section, convex) for section in sections)
            # Six digits, since the curvature of the sampled meridian is not more exact.
            radius = float(f"{1.0 / curvature:.6g}") if curvature > 0.0 else math.inf
            name = f"smallest concave radius of the insert of surface {number}"
            yield self._result("tool_radius", name, radius, ">=", _by_geometry(tool_mm, TOOL), "mm")

    def _surfaces(self) -> Iterator[tuple[int, list[SurfaceMeridian]]]:
        """Yield number and meridians of the front and of the back surface."""
        fronts, backs = zip(*((s.front, s.back) for s in self.element.sections), strict=True)
        for index, meridians in zip(self.element.surfaces, (fronts, backs), strict=True):
            yield index + 1, list(meridians)

    def _limited(
        self,
        check: MouldingCheckName,
        name: str,
        value: float | None,
        relation: str,
        key: str,
        unit: str = "",
    ) -> MouldingCheck:
        """Return the check of a value against the limit of the settings or the table."""
        return self._result(check, name, value, relation, self.settings.limit(key, self.family), unit, key)

    def _result(
        self,
        check: MouldingCheckName,
        name: str,
        value: float | None,
        relation: str,
        limit: MouldingLimit | None,
        unit: str,
        key: str = "",
    ) -> MouldingCheck:
        element = f"element {self.element.index + 1}: {name}"
        bound = None if limit is None else limit.value
        is_guideline = limit is not None and limit.sources[0].address != ""
        met: bool | None = None
        if value is None:
            miss = f"{element}: the design does not state it"
        elif limit is None:
            miss = f"{element}: no published limit is known for {self.family}; state [moulding] {key}"
        else:
            # A thickness that an optimization has driven to its limit is on it to rounding.
            margin = 1e-9 * abs(limit.value)
            is_least = relation == ">="
            met = value >= limit.value - margin if is_least else value <= limit.value + margin
            side = "less" if is_least else "greater"
            bound_name = "guideline of" if is_guideline else "limit of"
            miss = (
                f"{element}: {number_with_unit(f'{value:.4g}', unit)} is {side} than the {bound_name} "
                f"{number_with_unit(f'{limit.value:.4g}', unit)} ({limit.source})"
            )
        return MouldingCheck(
            element=self.element.index + 1,
            check=check,
            name=name,
            value=value,
            relation=relation,
            limit=bound,
            unit=unit,
            met=met,
            miss="" if met else miss,
            limit_key=key,
            source="" if limit is None else limit.source,
            source_address="" if limit is None else limit.sources[0].address,
            is_guideline=is_guideline,
        )


def _by_geometry(value: float, of: str) -> MouldingLimit:
    return MouldingLimit(value, (LimitSource(of, "", "follows from other values of the design"),))


_PARAMETERS = np.linspace(0.0, 1.0, 2049)
"""Parameters at which a meridian is examined."""


def _steepest_deg(section: SurfaceMeridian) -> float:
    """Return the largest angle of a meridian to the plane across the axis."""
    dr, dz = section.tangents(_PARAMETERS).T
    return math.degrees(float(np.max(np.arctan2(np.abs(dz), dr))))


def _largest_curvature_per_mm(section: SurfaceMeridian, sign: float) -> float:
    """Return the largest curvature of a meridian, positive where `sign` times its sag bends upwards."""
    points, tangents = section.points(_PARAMETERS), section.tangents(_PARAMETERS)
    angles = np.arctan2(tangents[:, 1], tangents[:, 0])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    # The angle over the chord is the curvature up to the square of the angle, 1e-6 for these points.
    return float(np.max(sign * np.diff(angles) / lengths))
