"""Thermal data of a material: change of index by Schott's formula, linear expansion, and the index of air.

Catalogues give indices relative to air at about 20 C and 101,325 Pa. With n_abs = n_rel n_air, Schott's
formula is (Schott, Technical Information TIE-19, Temperature coefficient of the refractive index, 2016)

    n_abs(T) - n_abs(T0) = (n^2 - 1) / (2 n) [D0 t + D1 t^2 + D2 t^3 + (E0 t + E1 t^2) / (w^2 - S L^2)],

where t = T - T0, w is the wavelength in um, L the constant lambda_TK and S its sign. Plastics have a single
coefficient, that of the absolute index.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from lensdesign.errors import MaterialError

REFERENCE_C = 20.0
"""Temperature of a design, at which its glasses have the indices of their catalogues."""

COLDEST_C, HOTTEST_C = -100.0, 140.0
"""Range of temperatures for which Schott's formula is valid (TIE-19)."""

LOWEST_INDEX = 0.9992
"""Least index of a medium relative to air: a vacuum has 0.99973 in visible light, and 0.9995 at -100 C."""

_TEMPERATURE = re.compile(r"(.+)@ *([+-]?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?) *C", re.IGNORECASE)


@dataclass(frozen=True)
class Thermal:
    """Thermal data of a material; None where they are not known.

    Attributes
    ----------
    schott : tuple of six floats
        D0, D1, D2, E0, E1 and lambda_TK of Schott's formula, in 1/K, 1/K^2, 1/K^3, um^2/K, um^2/K^2 and um.
    absolute_per_k
        Change of the absolute index in 1/K, where it is a single coefficient.
    reference_c
        Temperature of the catalogue's index.
    expansion_per_k
        Linear expansion coefficient around room temperature.
    """

    schott: tuple[float, float, float, float, float, float] | None = None
    absolute_per_k: float | None = None
    reference_c: float = REFERENCE_C
    expansion_per_k: float | None = None

    @property
    def knows_index(self) -> bool:
        """True if the change of the index with temperature is known."""
        return self.schott is not None or self.absolute_per_k is not None

    def index_at(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        """Return the index relative to air of the same temperature.

        Parameters
        ----------
        index
            Index of the catalogue, relative to air, which is used as the index at `REFERENCE_C`.
        wavelength_um
            Wavelength in air at `REFERENCE_C`. The frequency of the light does not change with temperature.
        temperature_c
            Temperature of glass and air.
        """
        heated = self._relative(index, wavelength_um, temperature_c)
        return index + heated - self._relative(index, wavelength_um, REFERENCE_C)

    def _relative(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        absolute = index * air_index(wavelength_um, self.reference_c)
        absolute += self.absolute_change(index, wavelength_um, temperature_c)
        return absolute / air_index(wavelength_um, temperature_c)

    def absolute_change(self, index: float, wavelength_um: float, temperature_c: float) -> float:
        """Return the change of the absolute index from the catalogue's temperature to another."""
        t = temperature_c - self.reference_c
        if self.schott is None:
            assert self.absolute_per_k is not None  # callers check knows_index first
            return self.absolute_per_k * t
        d0, d1, d2, e0, e1, pole = self.schott
        bracket = d0 * t + d1 * t**2 + d2 * t**3
        if e0 or e1:
            bracket += (e0 * t + e1 * t**2) / (wavelength_um**2 - pole * abs(pole))
        return (index**2 - 1.0) / (2.0 * index) * bracket


def air_index(wavelength_um: float, temperature_c: float) -> float:
    """Return the index of dry air at 101,325 Pa (Kohlrausch, Praktische Physik, 1968; TIE-19, Eqs. 7, 8)."""
    w2 = wavelength_um**2
    at_15_c = (6432.8 + 2949810.0 * w2 / (146.0 * w2 - 1.0) + 25540.0 * w2 / (41.0 * w2 - 1.0)) * 1e-8
    return 1.0 + at_15_c / (1.0 + 3.4785e-3 * (temperature_c - 15.0))


@dataclass(frozen=True)
class HeatedDispersion:
    """Index of a material at a temperature, relative to air of that temperature, by wavelength in um."""

    cold: Callable[[float], float]
    thermal: Thermal
    temperature_c: float

    def __call__(self, wavelength_um: float) -> float:
        return self.thermal.index_at(self.cold(wavelength_um), wavelength_um, self.temperature_c)


def at_temperature(material: str, temperature_c: float) -> str:
    """Return the name of a material at a temperature, as in a design file: ``N-BK7@50C``."""
    return f"{material}@{temperature_c:.12g}C"


def split_temperature(material: str) -> tuple[str, float]:
    """Split a name such as ``N-BK7@50C`` into the name and the temperature in degrees Celsius.

    Raises
    ------
    MaterialError
        If the temperature is not written in this form, or lies outside the range of Schott's formula.
    """

    match = _TEMPERATURE.fullmatch(material.strip())
    if match is None:
        raise MaterialError(f"material {material!r}: a temperature must be given as in 'N-BK7@50C'")
    temperature_c = float(match[2])
    if not COLDEST_C <= temperature_c <= HOTTEST_C:
        raise MaterialError(
            f"material {material!r}: the temperature must be from {COLDEST_C:g} to {HOTTEST_C:g} C"
        )
    return match[1].strip(), temperature_c


PLASTICS = {
    ("organic", "poly_methyl_methacrylate", "Beadie"): Thermal(None, -8.5e-5, expansion_per_k=67.4e-6),
    ("organic", "polycarbonate", "Sultanova"): Thermal(None, -13.0e-5, expansion_per_k=68e-6),
    ("organic", "polystyrene", "Sultanova"): Thermal(None, -14.0e-5, expansion_per_k=70e-6),
    ("other", "ZeonexE48R", "Sultanova"): Thermal(None, -8.0e-5, expansion_per_k=65e-6),
}
"""Thermal data of plastics by page of the database, which has none. Source: Apollo Optical Systems, *Common
Polymers for Optical Components*, the middle of a given range. Grades of makers differ by 10 % and more."""
