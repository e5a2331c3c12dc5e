"""Checks for values of a study that seem to be given in another unit: widths, steps, patches, planes.

Lengths are compared with those of the lens. Other deviations (index, percent, fringes, angles, conic
constants, aspheric terms) have limits far beyond any tolerance.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pydantic import BaseModel

from lensdesign.common.lengths import (
    UNITS,
    WAVELENGTH_UM,
    PlausibleLength,
    implausible_values,
    in_unit,
)
from lensdesign.common.text import number_with_unit
from lensdesign.lens.lengths import LensLengths
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.study import Study

PERCENT, THOUSANDTH = 1e-2, 1e-3
"""Ratios of a fraction, and of an error in units of the third decimal, to a number."""

ARC_MINUTE, ARC_SECOND = 1.0 / 60.0, 1.0 / 3600.0
"""Ratios of angles to degrees."""

NANOMETRE_IN_WAVES = 1.0 / 632.8
"""Waves of irregularity are those of 632.8 nm."""

_LIMITS: dict[str, tuple[float, float, tuple[float, ...], str]] = {
    "index": (
        0.05,
        0.01,
        (PERCENT, THOUSANDTH),
        "deviations of the index itself, not percent; a common tolerance is 0.0005",
    ),
    "radius_percent": (50.0, 10.0, (), "percent of the radius"),
    "abbe_percent": (20.0, 5.0, (), "percent of the Abbe number"),
    "coating_thickness_percent": (50.0, 10.0, (), "percent of the thickness"),
    "radius_fringes": (1000.0, 100.0, (), "fringes of 632.8 nm over the clear diameter"),
    "irregularity_waves": (50.0, 5.0, (NANOMETRE_IN_WAVES,), "waves of 632.8 nm"),
    "roughness_rms_nm": (1000.0, 50.0, (THOUSANDTH,), "nanometres"),
    "angle_deg": (20.0, 5.0, (ARC_MINUTE, ARC_SECOND), "degrees"),
    "temperature_c": (300.0, 100.0, (), "kelvins"),
}
"""Largest deviation, largest usual deviation, ratios of confused units, and unit in words, by kind."""


def implausible_study_lengths(study: Study, lens: Lens) -> Iterator[str]:
    """Yield a message for each implausible value of a study, such as a length for the size of its lens.

    A width far below measurable values is reported if a thousand times as much is a usual tolerance.
    """
    size = LensLengths.of(lens)
    for number, one in enumerate(study.perturbations, start=1):
        location = f"perturbation {number}: {one.column}"
        plausible = _plausible_deviation(one, size, lens)
        widths = {name: getattr(one.distribution, name) for name in one.distribution.widths}
        for name, value in widths.items():
            yield from implausible_values(f"{location}, {name}", value, plausible, one.unit)
        yield from _steps(f"{location}, mean", [one.distribution.mean], one, plausible)
        yield from _steps(f"{location}, values", getattr(one.distribution, "values", ()), one, plausible)
        if not widths and not hasattr(one.distribution, "values"):
            yield from _steps(f"{location}, largest deviation", [one.distribution.largest], one, plausible)
        if isinstance(one.seat, float):
            yield from implausible_values(f"{location}, seat", one.seat, size.plausible_mm("pivot_z"))
    for number, adapted in enumerate(study.compensators, start=1):
        location = f"compensator {number}: {adapted.column}, limit"
        yield from _steps(location, [adapted.limit], adapted, _plausible_step(adapted, size, lens))
    for number, sweep in enumerate(study.sweeps, start=1):
        plausible = _plausible_step(sweep, size, lens)
        yield from _series(f"sweep {number}: {sweep.column}, values", sweep.values, sweep, plausible)
    for number, grid in enumerate(study.grids, start=1):
        for axis in (grid.x, grid.y):
            plausible = _plausible_step(axis, size, lens)
            yield from _series(f"grid {number}: {axis.column}, values", axis.values, axis, plausible)
    yield from implausible_values("pivot_z_mm", study.pivot_z_mm, size.plausible_mm("pivot_z"))
    yield from _settings("sampling", study.sampling, lens)
    for kind, tables in (
        ("merit", study.all_merits),
        ("sweep", study.sweeps),
        ("grid", study.grids),
        ("slice_count", study.slice_counts),
    ):
        for number, table in enumerate(tables, start=1):
            yield from _settings(f"{kind} {number}", table, lens)


def _plausible_deviation(one: PerturbedParameter, size: LensLengths, lens: Lens) -> PlausibleLength | None:
    """Return the plausible range of a deviation, in the parameter's unit; None if there is none."""
    if one.parameter == "wavelength_um":
        wavelength = 1e3 * size.wavelength_mm
        reason = f"must be at most half of the wavelength of {wavelength:g} µm"
        return PlausibleLength(0.0, 0.5 * wavelength, (0.0, 0.5 * wavelength), reason)
    length = size.of_parameter_mm(lens, one.target.split()[0], one.parameter, one.surface, one.plane)
    return _plausible_number(one, size, lens) if length is None else length


def _plausible_number(one: PerturbedParameter, size: LensLengths, lens: Lens) -> PlausibleLength | None:
    """Return the plausible range of a deviation that is not a length; None for settings."""
    kind = one.parameter
    if kind.startswith(("tilt", "roll")):
        kind = "angle_deg"
    elif kind.startswith("radius_x"):
        kind = kind.replace("radius_x", "radius")
    elif one.is_irregularity:
        kind = "irregularity_waves"
    if kind in _LIMITS:
        highest, usual, ratios, words = _LIMITS[kind]
        reason = f"must be at most {highest:g} ({words})"
        return PlausibleLength(0.0, highest, (0.0, usual), reason, always=True, ratios=ratios)
    if one.surface is None or one.surface >= len(lens.surfaces):
        return None
    surface = lens.surfaces[one.surface]
    height = surface.semi_diameter_mm or 0.5 * size.clear_diameter_mm
    asphere = re.fullmatch(r"(?:odd_)?asphere_(\d+)", kind)
    if asphere is not None:
        # A deviation that changes the sag at the clear edge by a tenth of the height.
        highest = 0.1 * height ** (1 - int(asphere[1]))
    elif kind.startswith("conic"):
        radius = abs(getattr(surface, kind.replace("conic", "radius") + "_mm", None) or 0.0)
        highest = max(1.0, abs(getattr(surface, kind, None) or 0.0), 0.8 * (radius / height) ** 3)
    else:
        return None
    reason = f"must be at most {highest:.3g}; the sag at the clear edge then changes by a tenth of its height"
    return PlausibleLength(
        0.0, highest, (0.0, 0.1 * highest), reason, always=True, ratios=(PERCENT, THOUSANDTH)
    )


def _plausible_step(one: PerturbedParameter, size: LensLengths, lens: Lens) -> PlausibleLength | None:
    """Return the plausible range of a step of a sweep or a limit of a compensator: twice any tolerance."""
    plausible = _plausible_deviation(one, size, lens)
    if plausible is None:
        return None
    most = 2.0 * plausible.highest
    words = f" ({_LIMITS[one.parameter][3]})" if one.parameter in _LIMITS else ""
    reason = f"must be at most {number_with_unit(f'{most:.3g}', one.unit)}{words}, far beyond any tolerance"
    return replace(plausible, highest=most, reason=reason)


def _steps(
    location: str, values: Iterable[float], one: PerturbedParameter, plausible: PlausibleLength | None
) -> Iterator[str]:
    """Yield messages for values that are too large; small values are allowed."""
    limits = None if plausible is None else plausible.at_most()
    yield from implausible_values(location, tuple(values), limits, one.unit)


def _series(
    location: str, values: Sequence[float], one: PerturbedParameter, plausible: PlausibleLength | None
) -> Iterator[str]:
    """Yield messages for steps of a sweep that are too large, and for the largest step if it is too small."""
    most = max(values, key=abs)
    yield from implausible_values(location, most, plausible, one.unit)
    yield from _steps(location, [value for value in values if value != most], one, plausible)


def _settings(location: str, table: BaseModel, lens: Lens) -> Iterator[str]:
    """Yield messages for lengths of a merit, a sampling or a series that are settings of a simulation."""
    wavelength = getattr(table, "wavelength_um", None)
    if wavelength is not None:
        yield from implausible_values(f"{location}, wavelength_um", wavelength, WAVELENGTH_UM, "um")
    size = LensLengths.of(lens, wavelength)
    for name in type(table).model_fields:
        quantity, _, unit = name.rpartition("_")
        quantity = "patch" if quantity == "region" else quantity
        plausible = size.plausible_mm(quantity) if unit in UNITS else None
        if plausible is None:
            continue
        limits = in_unit(plausible, unit)
        yield from implausible_values(f"{location}, {name}", getattr(table, name), limits, unit)
