"""What heat does to a glass: its index by Schott's formula, its size by its expansion; and the index of air.

Catalogues give indices relative to air of 20 C or so and 101,325 Pa. With n_abs = n_rel n_air, Schott's
formula is (Schott, Technical Information TIE-19, Temperature coefficient of the refractive index, 2016)

    n_abs(T) - n_abs(T0) = (n^2 - 1) / (2 n) [D0 t + D1 t^2 + D2 t^3 + (E0 t + E1 t^2) / (w^2 - S L^2)],

t = T - T0, w the wavelength in um, L the constant lambda_TK and S its sign. Plastics have one coefficient of
the absolute index.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from lensdesign.errors import MaterialError

REFERENCE_C = 20.0
"""At which a design holds, and its glasses have the indices of their catalogues."""


COLDEST_C, HOTTEST_C = -100.0, 140.0
"""Between which Schott states the formula (TIE-19)."""

_TEMPERATURE = re.compile(r"(.+)@ *([+-]?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?) *C", re.IGNORECASE)


@dataclass(frozen=True)
class Thermal:
    """What is known of a material's behaviour in heat; None where nothing is.

    Attributes
    ----------
    schott : tuple of six floats
        D0, D1, D2, E0, E1 and lambda_TK of Schott's formula, in 1/K, 1/K^2, 1/K^3, um^2/K, um^2/K^2 and um.
    absolute_per_k
        Change of the absolute index, where it is one number.
    reference_c
        Temperature at which the catalogue's index holds.
    expansion_per_k
        Linear expansion, about room temperature.
    """

    schott: tuple[float, float, float, float, float, float] | None = None
    absolute_per_k: float | None = None
    reference_c: float = REFERENCE_C
    expansion_per_k: float | None = None

    @property
    def knows_index(self) -> bool:
        """Whether it says how the index changes."""
        return self.schott is not None or self.absolute_per_k is not None

    def index_at(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        """Index relative to air of the same temperature.

        Parameters
        ----------
        index
            Of the catalogue, relative to air, which is taken to hold at `REFERENCE_C`.
        wavelength_um
            In air at that temperature: light keeps its frequency.
        temperature_c
            Of glass and air.
        """
        here = self._relative(index, wavelength_um, temperature_c)
        return index + here - self._relative(index, wavelength_um, REFERENCE_C)

    def _relative(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        absolute = index * air_index(wavelength_um, self.reference_c)
        absolute += self.absolute_change(index, wavelength_um, temperature_c)
        return absolute / air_index(wavelength_um, temperature_c)

    def absolute_change(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        """Of the absolute index since the catalogue's temperature."""
        t = temperature_c - self.reference_c
        if self.schott is None:
            assert self.absolute_per_k is not None  # whoever asks looks at knows_index first
            return self.absolute_per_k * t
        d0, d1, d2, e0, e1, pole = self.schott
        bracket = d0 * t + d1 * t**2 + d2 * t**3
        if e0 or e1:
            bracket += (e0 * t + e1 * t**2) / (wavelength_um**2 - pole * abs(pole))
        return (index**2 - 1.0) / (2.0 * index) * bracket


def air_index(wavelength_um: float, temperature_c: float) -> float:
    """Index of dry air at 101,325 Pa (Kohlrausch, Praktische Physik, 1968; TIE-19, equations 7 and 8)."""
    w2 = wavelength_um**2
    at_15_c = (6432.8 + 2949810.0 * w2 / (146.0 * w2 - 1.0) + 25540.0 * w2 / (41.0 * w2 - 1.0)) * 1e-8
    return 1.0 + at_15_c / (1.0 + 3.4785e-3 * (temperature_c - 15.0))


@dataclass(frozen=True)
class Heated:
    """Index of a material at a temperature, relative to air of the same, by wavelength in um."""

    cold: Callable[[float], float]
    thermal: Thermal
    temperature_c: float

    def __call__(self, wavelength_um: float) -> float:
        return self.thermal.index_at(self.cold(wavelength_um), wavelength_um, self.temperature_c)


def at_temperature(material: str, temperature_c: float) -> str:
    """Name of a material at a temperature, as a design file has it: ``N-BK7@50C``."""
    return f"{material}@{temperature_c:.12g}C"


def split_temperature(material: str) -> tuple[str, float]:
    """Name and temperature of a material of which both are given.

    Raises
    ------
    MaterialError
        If that is no temperature, or one for which formulas are not made.
    """
    asked = _TEMPERATURE.fullmatch(material.strip())
    if asked is None:
        raise MaterialError(f"material {material!r}: a temperature is given as in 'N-BK7@50C'")
    temperature_c = float(asked[2])
    if not COLDEST_C <= temperature_c <= HOTTEST_C:
        raise MaterialError(f"material {material!r}: allowed: from {COLDEST_C:g} to {HOTTEST_C:g} C")
    return asked[1].strip(), temperature_c


PLASTICS = {
    ("organic", "poly_methyl_methacrylate", "Beadie"): Thermal(None, -8.5e-5, expansion_per_k=67.4e-6),
    ("organic", "polycarbonate", "Sultanova"): Thermal(None, -13.0e-5, expansion_per_k=68e-6),
    ("organic", "polystyrene", "Sultanova"): Thermal(None, -14.0e-5, expansion_per_k=70e-6),
    ("other", "ZeonexE48R", "Sultanova"): Thermal(None, -8.0e-5, expansion_per_k=65e-6),
}
"""Of plastics, of which the database has none, by its pages. Source: Apollo Optical Systems, *Common Polymers
for Optical Components*, the middle where it gives a range; makers' grades differ by a tenth and more."""
