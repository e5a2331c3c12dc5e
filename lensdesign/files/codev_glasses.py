"""Glasses of CODE V files that no catalogue has: glass codes, and private glasses.

A glass code states the index at the d line and the Abbe number: 517642, 516800.641700 (the digits of 1.5168
and 64.17), or 1.5168:64.17. A private glass is given by indices at some wavelengths or by a dispersion
formula. The formulas are those of the CODE V Lens System Setup Reference Manual, "Dispersion formulae". The
wavelength w is in um.

- Laurent (LAU) and Glass Manufacturer Laurent (GML): n^2 is a sum of even powers of w.
- Glass Manufacturer Sellmeier (GMS): n^2 = 1 + sum B w^2 / (w^2 - C), with coefficients B1 C1 B2 C2 ...
- Cauchy (CAU): n = A0 + A1 / w^2 + A2 / w^4.

A surface whose glass has another formula raises an error.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lensdesign.errors import InputError
from lensdesign.files.draft import parse_number, quoted
from lensdesign.files.index_records import IndexRecord
from lensdesign.files.index_tables import LARGEST_INDEX, tabulated_index
from lensdesign.lens.catalogues.thermal import LOWEST_INDEX

Formula = Callable[[Sequence[float], float], float]


def _powers(*exponents: int) -> Formula:
    def index(a: Sequence[float], w: float) -> float:
        return math.sqrt(sum(c * w**p for c, p in zip(a, exponents, strict=False)))

    return index


def _sellmeier(a: Sequence[float], w: float) -> float:
    pairs = zip(a[::2], [*a[1::2], 0.0], strict=False)
    return math.sqrt(1.0 + sum(b * w * w / (w * w - c) for b, c in pairs))


def _cauchy(a: Sequence[float], w: float) -> float:
    return sum(c * w ** (-2 * i) for i, c in enumerate(a))


FORMULAS: dict[str, tuple[str, int, Formula]] = {
    "LAU": ("Laurent", 12, _powers(0, 2, *range(-2, -22, -2))),
    "GML": ("Glass Manufacturer Laurent", 9, _powers(0, 2, -2, -4, -6, -8, 4, -10, -12)),
    "GMS": ("Glass Manufacturer Sellmeier", 12, _sellmeier),
    "CAU": ("Cauchy", 3, _cauchy),
}
"""Dispersion formulas by keyword: name, maximum number of coefficients, n(coefficients, wavelength_um)."""


def coded_glass(token: str, location: str) -> IndexRecord | None:
    """Return what a glass code states (517642, 516800.641700 or 1.5168:64.17); None for the name of a glass.

    An Abbe number of 0 states no dispersion.

    Raises
    ------
    InputError
        If the code has another number of digits, or if its index or Abbe number is not that of a glass.
    """
    index_text, colon, abbe_text = token.partition(":")
    if colon:
        index, abbe = parse_number(index_text, location), parse_number(abbe_text, location)
    elif re.fullmatch(r"[1-9]\d{5}", token, re.ASCII):
        index, abbe = 1.0 + int(token[:3]) / 1000.0, int(token[3:]) / 10.0
    elif code := re.fullmatch(r"([1-9]\d{2,})\.(\d{3,})", token, re.ASCII):
        index, abbe = 1.0 + float(f"0.{code[1]}"), float(f"{code[2][:2]}.{code[2][2:]}")
    elif re.fullmatch(r"[+-]?[\d.]+([eEdD][+-]?\d+)?", token, re.ASCII):
        raise InputError(
            f"{location}: {quoted(token)} is no glass code; write the index at 587.56 nm and the Abbe number "
            "as 517642, 516800.641700, 1.5168:64.17 or 1.5168 64.17"
        )
    else:
        return None
    largest_abbe = 150.0  # no transparent medium exceeds it
    if not (1.0 <= index <= LARGEST_INDEX and 0.0 <= abbe <= largest_abbe):
        raise InputError(
            f"{location}: the glass {quoted(token)} has an index of {index:g} and an Abbe number of "
            f"{abbe:g}; allowed are 1 to {LARGEST_INDEX:g} and 0 to {largest_abbe:g}"
        )
    return IndexRecord(index, abbe or None)


@dataclass(frozen=True)
class PrivateGlass:
    """Text that defines a private glass; it is interpreted only if a surface has this glass.

    Attributes
    ----------
    name
        Name as the file spells it.
    words
        Words that follow the name.
    wavelengths
        Words of the preceding PWL command: wavelengths in nm.
    location
        File and line.
    """

    name: str
    words: tuple[str, ...]
    wavelengths: tuple[str, ...]
    location: str

    def index(self, wavelength_um: float) -> tuple[float, str, str]:
        """Return the index at a wavelength, a remark, and a loss; the last two may be empty.

        Parameters
        ----------
        wavelength_um
            Vacuum wavelength in um.

        Returns
        -------
        index : float
            Refractive index.
        remark : str
            How the index was computed.
        loss : str
            Property of the glass that the import loses.

        Raises
        ------
        InputError
            If the definition has an unsupported form or does not yield an index at the wavelength.
        """
        if not self.words:
            raise InputError(f"{self.location}: private glass {quoted(self.name)} has no index")
        key = self.words[0].upper()
        if key in FORMULAS:
            return self._by_formula(key, wavelength_um)
        if key[:1].isalpha():
            raise InputError(
                f"{self.location}: private glass {quoted(self.name)} is given by {quoted(key)}, which is not "
                "supported; allowed are indices at the wavelengths of PWL, and the formulas "
                f"{', '.join(FORMULAS)}. Give its indices instead"
            )
        return self._by_table(1000.0 * wavelength_um)

    def disperses(self, wavelengths_um: Sequence[float]) -> bool:
        """Return whether a formula's index differs between the wavelengths, or a table's within the file."""
        if self.words and self.words[0].upper() in FORMULAS:
            return len({self.index(w)[0] for w in wavelengths_um}) > 1
        return len({parse_number(v, self.location) for v in self.words}) > 1

    def _by_formula(self, key: str, wavelength_um: float) -> tuple[float, str, str]:
        name, count, formula = FORMULAS[key]
        coefficients = [parse_number(v, self.location) for v in self.words[1:]]
        if not 0 < len(coefficients) <= count:
            raise InputError(
                f"{self.location}: private glass {quoted(self.name)} has {len(coefficients)} {name} "
                f"coefficients; allowed are 1 to {count}"
            )
        try:
            index = formula(coefficients, wavelength_um)
        except (ValueError, ZeroDivisionError, OverflowError):
            index = math.nan
        if not LOWEST_INDEX <= index <= LARGEST_INDEX:  # a formula exceeds it near its pole
            raise InputError(
                f"{self.location}: the {name} coefficients of private glass {quoted(self.name)} give an "
                f"index of {index:g} at {wavelength_um:g} µm; allowed is {LOWEST_INDEX} to {LARGEST_INDEX:g}"
            )
        return index, f"index {index:.7g} at {wavelength_um:g} µm by the {name} formula of {self.name}", ""

    def _by_table(self, wavelength_nm: float) -> tuple[float, str, str]:
        wavelengths_nm = [parse_number(v, self.location) for v in self.wavelengths]
        indices = [parse_number(v, self.location) for v in self.words]
        if len(wavelengths_nm) != len(indices) or not wavelengths_nm:
            raise InputError(
                f"{self.location}: private glass {quoted(self.name)} has {len(indices)} indices, and there "
                f"are {len(wavelengths_nm)} wavelengths (PWL)"
            )
        return tabulated_index(f"the private glass {self.name}", wavelengths_nm, indices, wavelength_nm)
