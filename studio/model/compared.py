"""Comparison of designs: their values and properties, and which of them differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lensdesign.analysis.check import check_design
from lensdesign.errors import TransferLensError
from lensdesign.lens.lens import Lens


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
    """

    name: str
    values: tuple[str, ...]
    differs: bool
    met: tuple[bool | None, ...]


def compared(lenses: Sequence[Lens]) -> tuple[ComparedValue, ...]:
    """Return values and properties of several designs, one line for each."""
    columns = [_values(lens) for lens in lenses]
    names = list(dict.fromkeys(name for column in columns for name in column))
    return tuple(_line(name, [column.get(name) for column in columns]) for name in names)


def _line(name: str, found: Sequence[tuple[float | str, bool | None] | None]) -> ComparedValue:
    values = [None if one is None else one[0] for one in found]
    numbers = [v for v in values if isinstance(v, float)]
    if len(numbers) == len(values):
        differs = max(numbers) - min(numbers) > 1e-9 * max(1e-300, *(abs(v) for v in numbers))
    else:
        differs = len(set(values)) > 1
    shown = tuple("" if v is None else f"{v:.7g}" if isinstance(v, float) else v for v in values)
    return ComparedValue(name, shown, differs, tuple(None if one is None else one[1] for one in found))


def _values(lens: Lens) -> dict[str, tuple[float | str, bool | None]]:
    found: dict[str, tuple[float | str, bool | None]] = {}
    for i, surface in enumerate(lens.surfaces, start=1):
        given = surface.model_dump(exclude_defaults=True, exclude={"figure", "stop"})
        for key, value in given.items():
            if key == "asphere":
                found |= {
                    f"surface {i} r^{2 * k + 4}, mm^-{2 * k + 3}": (float(v), None)
                    for k, v in enumerate(value)
                }
            else:
                label, _, unit = key.replace("_", " ").rpartition(" mm")
                name = (
                    f"surface {i} {label}, mm"
                    if label and not unit
                    else f"surface {i} {key.replace('_', ' ')}"
                )
                found[name] = (float(value) if isinstance(value, int | float) else str(value), None)
    found["working distance, mm"] = (lens.object.working_distance_mm, None)
    found["field diameter, mm"] = (lens.object.field_diameter_mm, None)
    found["numerical aperture"] = (lens.object.numerical_aperture, None)
    found["thickness, mm"] = (lens.exit_vertex_z_mm, None)
    found["track, mm"] = (lens.track_mm, None)
    try:
        report = check_design(lens)
    except TransferLensError as error:
        return found | {"check": (str(error), False)}
    for one in report.constraints:
        name = f"{one.name}{f', {one.unit}' if one.unit else ''}"
        found[name] = (float(one.value), one.met)
    found["etendue filled, %"] = (100.0 * report.etendue_share, None)
    found["exit beam, mm"] = (report.exit_beam_diameter_mm, None)
    found["effective focal length, mm"] = (report.efl_mm, None)
    return found
