"""Comparison of designs: their values and properties, and which of them differ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lensdesign.analysis.check import check_design
from lensdesign.analysis.report import CheckReport
from lensdesign.common.text import unit_symbol
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import COEFFICIENTS, length_power
from lensdesign.lens.solid import glass_elements
from lensdesign.raytrace.paths import sized_lens


@dataclass(frozen=True)
class ComparedValue:
    """A value of all designs.

    Attributes
    ----------
    name
        Name and unit.
    values
        Values as text, one for each design; empty for a design without it.
    differs
        Whether the values differ.
    met
        Whether each design meets the constraint; None for values that are not constraints.
    is_of_surface
        Whether the value is one of a surface, such as a radius.
    """

    name: str
    values: tuple[str, ...]
    differs: bool
    met: tuple[bool | None, ...]
    is_of_surface: bool = False


def compare_designs(
    lenses: Sequence[Lens], check: Callable[[Lens], CheckReport] = check_design
) -> tuple[ComparedValue, ...]:
    """Return values and properties of several designs, one line for each.

    Parameters
    ----------
    lenses
        The designs.
    check
        Check whose constraints are compared (default: that of a lens against its sensor).

    Returns
    -------
    tuple of ComparedValue
        Values of the surfaces, lengths, the constraints, and further results of the check. A lens without a
        result has a line "check" with the reason.
    """
    columns = [(_surface_values(lens), _properties(lens, check)) for lens in lenses]
    return tuple(
        _line(name, [column[part].get(name) for column in columns], is_of_surface=part == 0)
        for part in (0, 1)
        for name in dict.fromkeys(name for column in columns for name in column[part])
    )


def _line(
    name: str, found: Sequence[tuple[float | str, bool | None] | None], *, is_of_surface: bool
) -> ComparedValue:
    values = [None if one is None else one[0] for one in found]
    numbers = [v for v in values if isinstance(v, float)]
    if len(numbers) == len(values):
        differs = max(numbers) - min(numbers) > 1e-9 * max(1e-300, *(abs(v) for v in numbers))
    else:
        differs = len(set(values)) > 1
    shown = tuple("" if v is None else f"{v:.7g}" if isinstance(v, float) else v for v in values)
    met = tuple(None if one is None else one[1] for one in found)
    return ComparedValue(name, shown, differs, met, is_of_surface)


_Values = dict[str, tuple[float | str, bool | None]]
"""Values with their names, and whether they meet a constraint."""


def _surface_values(lens: Lens) -> _Values:
    found: _Values = {}
    for i, surface in enumerate(lens.surfaces, start=1):
        given = surface.model_dump(exclude_defaults=True, exclude={"figure", "stop"})
        for key, value in given.items():
            if key in COEFFICIENTS:
                for term, coefficient in zip(COEFFICIENTS[key], value, strict=False):
                    power = length_power(term)
                    name = f"surface {i} {surface.shape_class.coefficient_label(term)}"
                    found[f"{name}, mm{'' if power == 1 else f'^{power}'}"] = (float(coefficient), None)
            else:
                label, _, unit = key.replace("_", " ").rpartition(" mm")
                name = (
                    f"surface {i} {label}, mm"
                    if label and not unit
                    else f"surface {i} {key.replace('_', ' ')}"
                )
                found[name] = (float(value) if isinstance(value, int | float) else str(value), None)
    return found


def _properties(lens: Lens, check: Callable[[Lens], CheckReport]) -> _Values:
    found: _Values = {}
    found["working distance, mm"] = (lens.object.working_distance_mm, None)
    found["field diameter, mm"] = (lens.object.field_diameter_mm, None)
    found["numerical aperture"] = (lens.object.numerical_aperture, None)
    found["thickness, mm"] = (lens.exit_vertex_z_mm, None)
    found["track, mm"] = (lens.track_mm, None)
    try:
        elements = glass_elements(sized_lens(lens))
        report = check(lens)
    except TransferLensError as error:
        return found | {"check": (str(error), False)}
    found["glass volume, mm³"] = (sum(one.volume_mm3 for one in elements), None)
    missed = sum(not one.met for one in report.constraints)
    found["constraints not met"] = (f"{missed} of {len(report.constraints)}", missed == 0)
    found["SBP of the object"] = (report.sbp_object, None)
    for one in report.constraints:
        name = f"{one.name}{f', {unit_symbol(one.unit)}' if one.unit else ''}"
        found[name] = (float(one.value), one.met)
    # The constraints of a specification need not include these two.
    for label, value in {
        "SBP of the sensor": report.sbp_sensor,
        "spread angle, deg": report.max_spread_deg,
    }.items():
        if not any(label.partition(",")[0] in one.name for one in report.constraints):
            found[label] = (value, None)
    for ratio in report.oversampling:
        found[f"oversampling, {ratio.kind} object, all planes"] = (ratio.all_planes, None)
    found["etendue filled, %"] = (100.0 * report.etendue_share, None)
    found["exit beam, mm"] = (report.exit_beam_diameter_mm, None)
    found["effective focal length, mm"] = (report.efl_mm, None)
    return found
