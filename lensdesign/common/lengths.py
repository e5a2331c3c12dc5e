"""Lengths that are given in another unit than they should be: the one test of all files and settings.

A length is questioned where no real design has it, and where it would be usual after a change of unit. What
is plausible is an absolute range (wavelengths, pixel pitches), or a range relative to the lens
(:mod:`lensdesign.lens.lengths`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

from lensdesign.errors import InputError

UNIT_STEPS = (1e-3, 1e3, 1e-6, 1e6, 1e-4)
"""Ratios of the units in which lengths are given by mistake: the first two are those of millimetres and
micrometres, which alone explain a length that is judged by others; the last one is that of angstroms."""

UNITS = {"mm": "millimetres", "um": "micrometres"}


@dataclass(frozen=True)
class PlausibleLength:
    """What a length may be, and what it usually is, in one unit.

    Attributes
    ----------
    lowest, highest
        No real design has a length outside this range.
    usual
        Range in which a length lies after a change of unit, if another unit was meant.
    reason
        What is wrong with a length outside the range, as a part of a sentence; made of the range if empty.
    always
        Whether a length outside the range is refused even where no other unit makes it usual.
    """

    lowest: float
    highest: float
    usual: tuple[float, float]
    reason: str = ""
    always: bool = False

    def doubt(self, value: float, unit: str) -> str | None:
        """The reason to question a length, with the value that may be meant; None where it is plausible.

        Parameters
        ----------
        value
            The length; of a signed one, either sign is judged alike. 0 is plausible.
        unit
            ``mm`` or ``um``, the unit of the length and of this range.
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
        """The value that may be meant, as the end of a message on a length outside the range; or nothing."""
        size, (low, high) = abs(value), self.usual
        steps = UNIT_STEPS if self.always else UNIT_STEPS[:2]
        right_way = [step for step in steps if (step < 1.0) == (size > self.highest)]
        meant = next((step * value for step in right_way if low <= step * size <= high), None)
        return "" if meant is None else f"; {meant:g} {unit} may be meant"

    def at_most(self) -> PlausibleLength:
        """The same without a lower end, for lengths that may be as small as one likes."""
        return replace(self, lowest=0.0)


def in_unit(plausible_mm: PlausibleLength, unit: str) -> PlausibleLength:
    """A range of millimetres in a unit."""
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
"""Pixel pitches beyond these are given in another unit than micrometres."""

WAVELENGTH_UM = PlausibleLength(0.05, 50.0, (0.19, 20.0), always=True)
"""Wavelengths beyond these are given in another unit than micrometres, or are those of no lens."""


def doubted_length(what: str, value: float, unit: str, plausible: PlausibleLength) -> str | None:
    """A sentence that questions a length; None where it is plausible.

    Parameters
    ----------
    what
        Where the length stands, and its name.
    value, unit, plausible
        As of :meth:`PlausibleLength.doubt`.
    """
    doubt = plausible.doubt(value, unit)
    return None if doubt is None else f"{what} = {value:g}: {doubt}"


def validate_length(what: str, value: float | None, unit: str, plausible: PlausibleLength) -> None:
    """Refuse a length that is not plausible; None passes.

    Raises
    ------
    InputError
        As :func:`doubted_length` says.
    """
    sentence = None if value is None else doubted_length(what, value, unit, plausible)
    if sentence is not None:
        raise InputError(sentence)


def numbers_of(value: object) -> Iterator[float]:
    """The numbers of a setting, however deep its tuples; none of what is no number."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from numbers_of(part)
