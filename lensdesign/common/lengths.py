"""Test for lengths in a wrong unit, used for all files and settings.

A length is questioned if no real design has it and it would be usual after a change of unit. The plausible
range is absolute (wavelengths, pixel pitches) or relative to the lens (:mod:`lensdesign.lens.lengths`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from lensdesign.common.text import number_with_unit
from lensdesign.errors import InputError

UNITS = {"mm": "millimetres", "um": "micrometres"}
"""Names of the units in messages."""


@dataclass(frozen=True)
class PlausibleLength:
    """Plausible and usual range of a length, or of another quantity, in one unit.

    Attributes
    ----------
    lowest, highest
        Plausible range; no real design has a length outside it.
    usual
        Usual range, in which the length must lie after a change of unit to suggest that unit.
    reason
        Objection to a length outside the range, as part of a sentence (default: the range).
    always
        Whether a length outside the range is refused even if no other unit makes it usual.
    ratios
        Ratios of the units that are confused, smaller to larger (default: those of lengths).
    """

    lowest: float
    highest: float
    usual: tuple[float, float]
    reason: str = ""
    always: bool = False
    ratios: tuple[float, ...] | None = None

    def objection(self, value: float, unit: str) -> str | None:
        """Return the objection to a length, with the value that may be meant; None if it is plausible.

        Parameters
        ----------
        value
            The length, of either sign. 0 is plausible.
        unit
            Unit of the length and of this range; ``mm`` or ``um`` if there is no `reason`.
        """
        size = abs(value)
        if size == 0.0 or not math.isfinite(size) or self.lowest <= size <= self.highest:
            return None
        hint = self.hint(value, unit)
        if not hint and not self.always:
            return None
        reason = self.reason or f"must be {self.lowest:g} to {self.highest:g}, in {UNITS[unit]}"
        return f"{reason}{hint}"

    def hint(self, value: float, unit: str) -> str:
        """Return the end of a message with the value that may be meant; empty if no unit fits."""
        size, (low, high) = abs(value), self.usual
        # Ratios of units that are confused. The first two, of millimetres and micrometres, are the only ones
        # tried for lengths with a relative range; the last one is that of angstroms.
        unit_steps = (1e-3, 1e3, 1e-6, 1e6, 1e-4)
        of_units: tuple[float, ...] = unit_steps if self.always else unit_steps[:2]
        steps = of_units if self.ratios is None else self.ratios
        candidates = [step for step in steps if (step < 1.0) == (size > self.highest)]
        meant = next((step * value for step in candidates if low <= step * size <= high), None)
        return "" if meant is None else f"; {number_with_unit(f'{meant:.6g}', unit)} may be meant"

    def at_most(self) -> PlausibleLength:
        """Return the range without a lower end."""
        return replace(self, lowest=0.0)


def in_unit(plausible_mm: PlausibleLength, unit: str) -> PlausibleLength:
    """Return a range in millimetres converted to a unit."""
    if unit == "mm":
        return plausible_mm
    low, high = plausible_mm.usual
    return replace(
        plausible_mm,
        lowest=1e3 * plausible_mm.lowest,
        highest=1e3 * plausible_mm.highest,
        usual=(1e3 * low, 1e3 * high),
    )


PIXEL_PITCH_UM = PlausibleLength(0.1, 1000.0, (0.5, 50.0), always=True)
"""Plausible pixel pitches in um; a value outside is in another unit."""

WAVELENGTH_UM = PlausibleLength(0.05, 50.0, (0.19, 20.0), always=True)
"""Plausible wavelengths in um; a value outside this range is in another unit, or out of reach of lenses."""


def implausible_values(
    what: str, value: object, plausible: PlausibleLength | None, unit: str = "mm"
) -> Iterator[str]:
    """Yield a sentence for each implausible number of a value.

    Parameters
    ----------
    what
        Location and name of the value in messages.
    value
        A length, or nested tuples and lists of lengths.
    plausible
        Plausible range; None if every length is.
    unit
        Unit of the value and of the range.
    """
    for number in _numbers_of(value):
        objection = None if plausible is None else plausible.objection(number, unit)
        if objection is not None:
            yield f"{what} = {number:g}: {objection}"


def validate_length(what: str, value: float | None, unit: str, plausible: PlausibleLength) -> None:
    """Check that a length is plausible; None is accepted.

    Raises
    ------
    InputError
        If the length is not plausible, with the message of :func:`implausible_values`.
    """
    for sentence in implausible_values(what, value, plausible, unit):
        raise InputError(sentence)


def _numbers_of(value: object) -> Iterator[float]:
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from _numbers_of(part)
