"""Private glasses of CODE V's files: indices at given wavelengths, or a dispersion formula with coefficients.

The formulas are those of the CODE V Lens System Setup Reference Manual, "Dispersion formulae", wavelengths in
um. Laurent and Glass Manufacturer Laurent are sums of even powers for n^2, Glass Manufacturer Sellmeier has
B1 C1 B2 C2 ... in n^2 = 1 + sum B w^2 / (w^2 - C), Cauchy has n = A0 + A1 / w^2 + A2 / w^4. Files with other
formulas are refused where a surface has such a glass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lensdesign.errors import InputError
from lensdesign.files.draft import number, shown

SAME_NM = 0.1
"""Wavelengths that differ by no more are one line, written with other digits."""

LARGEST_INDEX = 10.0
"""No transparent medium has more; near a pole of its formula a glass would."""

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
"""By the keyword: name, most coefficients, and n(coefficients, wavelength_um)."""


@dataclass(frozen=True)
class PrivateGlass:
    """A private glass as it stands in the file; read only where a surface has it.

    Attributes
    ----------
    name
        As the file spells it.
    words
        What follows the name.
    wavelengths
        The words of the PWL command before it.
    where
        File and line.
    """

    name: str
    words: tuple[str, ...]
    wavelengths: tuple[str, ...]
    where: str

    def index(self, wavelength_um: float) -> tuple[float, str, str]:
        """Index at a wavelength, a remark on how it was had, and what of it is a loss; both may be empty.

        Raises
        ------
        InputError
            If the glass is given in a way that is not known here, or has no index there.
        """
        if not self.words:
            raise InputError(f"{self.where}: private glass {shown(self.name)} has no index")
        key = self.words[0].upper()
        if key in FORMULAS:
            return self._by_formula(key, wavelength_um)
        if key[:1].isalpha():
            raise InputError(
                f"{self.where}: private glass {shown(self.name)} is given by {shown(key)}, which cannot be "
                "read; "
                f"what can are indices at the wavelengths of PWL, and the formulas {', '.join(FORMULAS)}. "
                "Give its indices instead"
            )
        return self._by_table(1000.0 * wavelength_um)

    def disperses(self, wavelengths_um: Sequence[float]) -> bool:
        """Whether its index differs between these wavelengths, or (of a table) between those of the file."""
        if self.words and self.words[0].upper() in FORMULAS:
            return len({self.index(w)[0] for w in wavelengths_um}) > 1
        return len({number(v, self.where) for v in self.words}) > 1

    def _by_formula(self, key: str, wavelength_um: float) -> tuple[float, str, str]:
        name, count, formula = FORMULAS[key]
        coefficients = [number(v, self.where) for v in self.words[1:]]
        if not 0 < len(coefficients) <= count:
            raise InputError(
                f"{self.where}: private glass {shown(self.name)} has {len(coefficients)} {name} "
                f"coefficients; allowed are 1 to {count}"
            )
        try:
            index = formula(coefficients, wavelength_um)
        except (ValueError, ZeroDivisionError, OverflowError):
            index = math.nan
        if not 1.0 <= index <= LARGEST_INDEX:
            raise InputError(
                f"{self.where}: the {name} coefficients of private glass {shown(self.name)} give an index of "
                f"{index:g} at {wavelength_um:g} um; allowed is 1 to {LARGEST_INDEX:g}"
            )
        return index, f"index {index:.7g} at {wavelength_um:g} um by the {name} formula of {self.name}", ""

    def _by_table(self, wavelength_nm: float) -> tuple[float, str, str]:
        waves = [number(v, self.where) for v in self.wavelengths]
        indices = [number(v, self.where) for v in self.words]
        if len(waves) != len(indices) or not waves:
            raise InputError(
                f"{self.where}: private glass {shown(self.name)} has {len(indices)} indices, and there are "
                f"{len(waves)} wavelengths (PWL)"
            )
        pairs = sorted(zip(waves, indices, strict=True), key=lambda pair: abs(pair[0] - wavelength_nm))
        nearest_nm, nearest = pairs[0]
        if abs(nearest_nm - wavelength_nm) <= SAME_NM or len(set(indices)) == 1 < len(indices):
            return nearest, "", ""
        if not min(waves) < wavelength_nm < max(waves):
            return (
                nearest,
                "",
                f"index of the private glass {self.name} at {wavelength_nm:g} nm; that at {nearest_nm:g} nm "
                "is taken",
            )
        index = _interpolated(pairs[:4], wavelength_nm)
        return index, f"index {index:.7g} of {self.name} at {wavelength_nm:g} nm interpolated", ""


def _interpolated(pairs: Sequence[tuple[float, float]], wavelength_nm: float) -> float:
    """Lagrange's polynomial in 1 / w^2, as Cauchy's formula has it, through a few neighbours."""
    x = [1.0 / w**2 for w, _ in pairs]
    at = 1.0 / wavelength_nm**2
    return sum(
        n * math.prod((at - x[j]) / (x[i] - x[j]) for j in range(len(x)) if j != i)
        for i, (_, n) in enumerate(pairs)
    )
