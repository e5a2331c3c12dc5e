"""Lengths of a study that seem to be given in another unit: widths, steps, patches, planes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pydantic import BaseModel

from lensdesign.common.lengths import (
    UNITS,
    WAVELENGTH_UM,
    PlausibleLength,
    implausible_length,
    in_unit,
    numbers_of,
)
from lensdesign.lens.lengths import LensLengths
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.study import Study

BEYOND_TOLERANCES = 2.0
"""How far sweeps may go, as a multiple of the largest tolerance."""

SETTINGS = {"region": "patch"}
"""Names of lengths in merits that a simulation knows under another name."""


def doubted_study_lengths(study: Study, lens: Lens) -> Iterator[str]:
    """Sentences that question lengths of a study, by the size of its lens.

    A width far below what can be measured is questioned where a thousand times as much is a usual tolerance.
    """
    size = LensLengths.of(lens)
    for number, one in enumerate(study.perturbations, start=1):
        where = f"perturbation {number}: {one.column}"
        plausible = _of_parameter(one, size, lens)
        widths = {name: getattr(one.distribution, name) for name in one.distribution.widths}
        for name, value in widths.items():
            yield from _said(f"{where}, {name}", value, one.unit, plausible)
        yield from _steps(f"{where}, mean", [one.distribution.mean], one, plausible)
        yield from _steps(f"{where}, values", getattr(one.distribution, "values", ()), one, plausible)
        if not widths and not hasattr(one.distribution, "values"):
            yield from _steps(f"{where}, largest deviation", [one.distribution.largest], one, plausible)
        if isinstance(one.seat, float):
            yield from _said(f"{where}, seat", one.seat, "mm", size.plausible_mm("pivot_z"))
    for number, adapted in enumerate(study.compensators, start=1):
        where = f"compensator {number}: {adapted.column}, limit"
        yield from _steps(where, [adapted.limit], adapted, _of_step(adapted, size, lens))
    for number, sweep in enumerate(study.sweeps, start=1):
        plausible = _of_step(sweep, size, lens)
        yield from _series(f"sweep {number}: {sweep.column}, values", sweep.values, sweep, plausible)
    for number, grid in enumerate(study.grids, start=1):
        for axis in (grid.x, grid.y):
            plausible = _of_step(axis, size, lens)
            yield from _series(f"grid {number}: {axis.column}, values", axis.values, axis, plausible)
    yield from _said("pivot_z_mm", study.pivot_z_mm, "mm", size.plausible_mm("pivot_z"))
    yield from _settings("sampling", study.sampling, lens)
    for kind, tables in (
        ("merit", study.all_merits),
        ("sweep", study.sweeps),
        ("grid", study.grids),
        ("slice_count", study.slice_counts),
    ):
        for number, table in enumerate(tables, start=1):
            yield from _settings(f"{kind} {number}", table, lens)


def _of_parameter(one: PerturbedParameter, size: LensLengths, lens: Lens) -> PlausibleLength | None:
    """What a deviation may be, in the parameter's unit; None where it is no length."""
    if one.parameter == "wavelength_um":
        wavelength = 1e3 * size.wavelength_mm
        reason = f"must be at most half of the wavelength of {wavelength:g} um"
        return PlausibleLength(0.0, 0.5 * wavelength, (0.0, 0.5 * wavelength), reason)
    return size.of_parameter_mm(lens, one.target.split()[0], one.parameter, one.surface, one.plane)


def _of_step(one: PerturbedParameter, size: LensLengths, lens: Lens) -> PlausibleLength | None:
    """What a step of a sweep or a limit of a compensator may be: more than any tolerance."""
    plausible = _of_parameter(one, size, lens)
    if plausible is None:
        return None
    most = BEYOND_TOLERANCES * plausible.highest
    reason = f"must be at most {most:.3g} {one.unit}, far beyond any tolerance"
    return replace(plausible, highest=most, reason=reason)


def _steps(
    where: str, values: Iterable[float], one: PerturbedParameter, plausible: PlausibleLength | None
) -> Iterator[str]:
    """Doubts of values that may be as small as one likes."""
    for value in values:
        yield from _said(where, value, one.unit, None if plausible is None else plausible.at_most())


def _series(
    where: str, values: Sequence[float], one: PerturbedParameter, plausible: PlausibleLength | None
) -> Iterator[str]:
    """Doubts of the steps of a sweep: of too long ones, and of the longest if that is too short."""
    most = max(values, key=abs)
    yield from _said(where, most, one.unit, plausible)
    yield from _steps(where, [value for value in values if value != most], one, plausible)


def _said(what: str, value: float, unit: str, plausible: PlausibleLength | None) -> Iterator[str]:
    sentence = None if plausible is None else implausible_length(what, value, unit, plausible)
    if sentence is not None:
        yield sentence


def _settings(where: str, table: BaseModel, lens: Lens) -> Iterator[str]:
    """Doubts of lengths of a merit, a sampling or a series that are named as settings of a simulation."""
    wavelength = getattr(table, "wavelength_um", None)
    if wavelength is not None:
        yield from _said(f"{where}, wavelength_um", wavelength, "um", WAVELENGTH_UM)
    size = LensLengths.of(lens, wavelength)
    for name in type(table).model_fields:
        quantity, _, unit = name.rpartition("_")
        plausible = size.plausible_mm(SETTINGS.get(quantity, quantity)) if unit in UNITS else None
        if plausible is None:
            continue
        for value in numbers_of(getattr(table, name)):
            yield from _said(f"{where}, {name}", value, unit, in_unit(plausible, unit))
