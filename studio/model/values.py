"""Editable values of a design: their positions in the tables, their texts, and their sliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lensdesign.common.text import round_number_below
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import COEFFICIENTS, length_power
from studio.model.editing import TablePath, Tables, value_at

STEPS = 400
"""Number of steps of a slider on each side of its middle."""

PLANE = "plane"
"""Text of a plane's radius; an empty text also means a plane."""


@dataclass(frozen=True)
class Value:
    """An editable value of a design, as its row shows it.

    Attributes
    ----------
    table_path
        Position of the value in the tables.
    group
        Heading under which it is shown.
    label, unit
        Name and unit.
    text
        Displayed text.
    number
        Position of the slider; None without a slider.
    low, high, step
        Range and step of the slider.
    kind
        ``number``, ``whole`` or ``glass``.
    """

    table_path: TablePath
    group: str
    label: str
    unit: str
    text: str
    number: float | None
    low: float
    high: float
    step: float
    kind: str = "number"

    @property
    def key(self) -> str:
        """Position in the tables as one word."""
        return ".".join(map(str, self.table_path))


def path_of_key(key: str) -> TablePath:
    """Return the position in the tables for a key."""
    return tuple(int(word) if word.isdigit() else word for word in key.split("."))


def values_of(tables: Tables, opened: Tables, lens: Lens) -> tuple[Value, ...]:
    """Return all values of a design.

    Parameters
    ----------
    tables, lens
        The present design.
    opened
        Tables of the design when it was opened. They determine the ranges of sliders, which therefore do not
        change while a slider is dragged.
    """

    def number(
        group: str, table_path: TablePath, label: str, unit: str, span: float = 0.2, least: float = 0.0
    ) -> Value:
        own, first = value_at(tables, table_path), value_at(opened, table_path)
        if not isinstance(own, int | float):
            return Value(table_path, group, label, unit, "" if own is None else str(own), None, 0.0, 0.0, 0.0)
        middle = own if not isinstance(first, int | float) else first
        half = max(span * abs(middle), least)
        step = round_number_below(half / STEPS)
        if not middle - half <= own <= middle + half:
            middle = own
            half = max(span * abs(middle), least)
            step = round_number_below(half / STEPS)
        half = step * STEPS
        return Value(
            table_path, group, label, unit, f"{own:.10g}", float(own), middle - half, middle + half, step
        )

    found = []
    for i, surface in enumerate(lens.surfaces):
        group, at = f"surface {i + 1}", ("surface", i)
        keys = surface.shape_class.KEYS
        for name, label in (("radius_mm", "radius"), ("radius_x_mm", "radius x")):
            if name in keys:
                row = number(group, (*at, name), label, "mm")
                found.append(row if row.text else _plane(row))
        for name, label in (("conic", "conic"), ("conic_x", "conic x")):
            if name in keys:
                row = number(group, (*at, name), label, "", least=0.4)
                found.append(row if row.text else _zero(row))
        reach = surface.semi_diameter_mm or lens.stop_semi_diameter_mm
        if "q_mm" in keys:
            found.append(number(group, (*at, "normalization_radius_mm"), "normalization radius", "mm"))
        for key, terms in COEFFICIENTS.items():
            for k, term in zip(range(len(getattr(surface, key))), terms, strict=False):
                power, label = length_power(term), surface.shape_class.coefficient_label(term)
                unit = "mm" if power == 1 else f"mm^{power}"
                largest_sag_mm = 1e-3 * reach if key == "q_mm" else 0.02
                most = largest_sag_mm * reach ** (power - 1)
                found.append(number(group, (*at, key, k), label, unit, 0.5, most))
        if surface.thickness_mm is not None:
            found.append(number(group, (*at, "thickness_mm"), "thickness", "mm"))
            found.append(_glass(group, (*at, "material"), surface.material))
        found.append(number(group, (*at, "semi_diameter_mm"), "semi-diameter", "mm"))
    found += [
        number("object", ("object", "working_distance_mm"), "working distance", "mm"),
        number("object", ("object", "field_diameter_mm"), "field diameter", "mm"),
        number("object", ("object", "numerical_aperture"), "numerical aperture", ""),
    ]
    found += [
        number("sensor", ("sensor", "plane_distances_mm", k), f"plane H{k + 1}", "mm", 0.5)
        for k in range(len(lens.sensor.plane_distances_mm))
    ]
    found.append(number("sensor", ("sensor", "pixel_pitch_um"), "pixel pitch", "um"))
    for k, axis in enumerate("xy"):
        found.append(_whole("sensor", ("sensor", "pixels", k), f"pixels {axis}", lens.sensor.pixels[k]))
    found += [
        number("light", ("wavelengths_um", k), "wavelength", "um") for k in range(len(lens.wavelengths_um))
    ]
    return tuple(found)


def parsed(kind: str, text: str) -> Any:
    """Convert typed text to the value of a design file; None removes the key.

    Raises
    ------
    InputError
        If the text is not a number although one is required.
    """
    text = text.strip().replace("\N{MINUS SIGN}", "-")
    if not text or text.casefold() in (PLANE, "none", "air"):
        return None
    try:
        return int(text) if kind == "whole" else float(text)
    except ValueError:
        if kind == "glass":
            return text
        raise InputError(f"{text!r}: must be a {'whole ' if kind == 'whole' else ''}number") from None


def glasses_like(text: str, lens: Lens, most: int = 12) -> list[str]:
    """Return glass names that contain a text, those that start with it first; or the most similar one."""
    from lensdesign.lens.glass import list_glasses

    names = list(dict.fromkeys(name for name, _ in list_glasses(lens.glass_catalogs)))
    asked = text.casefold().strip()
    found = sorted(
        (n for n in names if asked in n.casefold()),
        key=lambda n: (not n.casefold().startswith(asked), len(n)),
    )
    hint = did_you_mean(text, names).removeprefix("; did you mean ").removesuffix("?")
    return found[:most] or ([hint] if hint else [])


def _plane(row: Value) -> Value:
    return Value(row.table_path, row.group, row.label, row.unit, PLANE, None, 0.0, 0.0, 0.0)


def _zero(row: Value) -> Value:
    return Value(row.table_path, row.group, row.label, row.unit, "0", 0.0, -0.4, 0.4, 0.001)


def _glass(group: str, table_path: TablePath, material: str | float | None) -> Value:
    text = "air" if material is None else f"{material:g}" if isinstance(material, float) else material
    return Value(table_path, group, "glass", "", text, None, 0.0, 0.0, 0.0, "glass")


def _whole(group: str, table_path: TablePath, label: str, count: int) -> Value:
    return Value(table_path, group, label, "", str(count), None, 0.0, 0.0, 0.0, "whole")
