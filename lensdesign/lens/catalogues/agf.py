"""Zemax glass catalogues (AGF text files): the glasses in them and their dispersion formulas."""

from __future__ import annotations

import codecs
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from lensdesign.common.input_files import CATALOG_BYTES, read_input
from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.thermal import LOWEST_INDEX

Coefficients = Sequence[float]


LINE_F_UM = 0.4861327
LINE_D_UM = 0.5875618
LINE_C_UM = 0.6562725
"""Wavelengths in air of the hydrogen F, helium d and hydrogen C lines, which define the Abbe number."""

ND_NOTED = 2e-4
"""Difference between the stated nd and that of the coefficients, beyond rounding, that causes a note.
In makers' catalogues only placeholders differ by so much."""

ND_REFUSED = 3e-3
"""Difference between the stated nd and that of the coefficients from which a glass is refused.
Neither melt nor temperature explains so much."""

SAME_INDEX = 1e-6
"""Two entries of one name are the same glass if their indices differ by no more than this."""


@dataclass(frozen=True)
class AgfGlass:
    """A glass of an AGF catalogue.

    Parameters
    ----------
    name
        Name as in the NM record.
    formula
        Number of the dispersion formula, a key of `DISPERSION_FORMULAS`.
    coefficients
        Coefficients of the CD record, in its order, as many as the formula has.
    wavelength_range_um
        Shortest and longest wavelength of the fit (LD record).
    comment
        Text of the GC record.
    reference_temperature_c
        Temperature of the index data (last value of the TD record); None if not given.
    schott
        Constants of Schott's formula (first six values of the TD record); None if not given.
    expansion_per_k
        Linear expansion coefficient (first value of the ED record); None if not given.
    density_g_per_cm3
        Density (third value of the ED record); None if not given.
    notes
        Remarks for a user of the glass, for example on a duplicate entry or a slightly different nd.
    fault
        Reason why the glass cannot be used, with file and line; empty for a usable glass. The other glasses
        of the catalogue are not affected.
    """

    name: str
    formula: int
    coefficients: tuple[float, ...]
    wavelength_range_um: tuple[float, float]
    comment: str = ""
    reference_temperature_c: float | None = None
    schott: tuple[float, float, float, float, float, float] | None = None
    expansion_per_k: float | None = None
    density_g_per_cm3: float | None = None
    notes: tuple[str, ...] = ()
    fault: str = ""

    def __call__(self, wavelength_um: float) -> float:
        """Return the index relative to air by the glass's formula; NaN where it has no real value.

        The range is not checked here; `lensdesign.lens.glass.Material.index` checks it.
        """
        try:
            return DISPERSION_FORMULAS[self.formula].index(self.coefficients, wavelength_um)
        except (ValueError, ZeroDivisionError, OverflowError):
            return math.nan


@dataclass(frozen=True)
class DispersionFormula:
    """A dispersion formula: name, number of coefficients, and index n(coefficients, wavelength_um)."""

    name: str
    coefficient_count: int
    index: Callable[[Coefficients, float], float]


def _poles(c: Coefficients, w: float) -> float:
    """Return the sum of K w^2 / (w^2 - L) over the pairs (K, L)."""
    return sum(k * w * w / (w * w - pole) for k, pole in zip(c[::2], c[1::2], strict=True))


def _sellmeier(c: Coefficients, w: float) -> float:
    return math.sqrt(1.0 + _poles(c, w))


def _power_series(*exponents: int) -> Callable[[Coefficients, float], float]:
    def index(c: Coefficients, w: float) -> float:
        return math.sqrt(sum(a * w**p for a, p in zip(c, exponents, strict=True)))

    return index


def _herzberger(c: Coefficients, w: float) -> float:
    pole = 1.0 / (w * w - 0.028)
    return c[0] + c[1] * pole + c[2] * pole**2 + c[3] * w**2 + c[4] * w**4 + c[5] * w**6


def _sellmeier_2(c: Coefficients, w: float) -> float:
    # The second pole has no w^2 in the numerator, and both poles are wavelengths, not their squares.
    return math.sqrt(1.0 + c[0] + c[1] * w * w / (w * w - c[2] ** 2) + c[3] / (w * w - c[4] ** 2))


def _conrady(c: Coefficients, w: float) -> float:
    return c[0] + c[1] / w + c[2] / w**3.5


def _handbook_1(c: Coefficients, w: float) -> float:
    return math.sqrt(c[0] + c[1] / (w * w - c[2]) - c[3] * w * w)


def _handbook_2(c: Coefficients, w: float) -> float:
    return math.sqrt(c[0] + c[1] * w * w / (w * w - c[2]) - c[3] * w * w)


def _sellmeier_4(c: Coefficients, w: float) -> float:
    return math.sqrt(c[0] + _poles(c[1:], w))


DISPERSION_FORMULAS: dict[int, DispersionFormula] = {
    1: DispersionFormula("Schott", 6, _power_series(0, 2, -2, -4, -6, -8)),
    2: DispersionFormula("Sellmeier 1", 6, _sellmeier),
    3: DispersionFormula("Herzberger", 6, _herzberger),
    4: DispersionFormula("Sellmeier 2", 5, _sellmeier_2),
    5: DispersionFormula("Conrady", 3, _conrady),
    6: DispersionFormula("Sellmeier 3", 8, _sellmeier),
    7: DispersionFormula("Handbook of Optics 1", 4, _handbook_1),
    8: DispersionFormula("Handbook of Optics 2", 4, _handbook_2),
    9: DispersionFormula("Sellmeier 4", 5, _sellmeier_4),
    10: DispersionFormula("Extended", 8, _power_series(0, 2, -2, -4, -6, -8, -10, -12)),
    11: DispersionFormula("Sellmeier 5", 10, _sellmeier),
    12: DispersionFormula("Extended 2", 8, _power_series(0, 2, -2, -4, -6, -8, 4, 6)),
    13: DispersionFormula("Extended 3", 9, _power_series(0, 2, 4, -2, -4, -6, -8, -10, -12)),
}
"""The formulas of the AGF format by number, wavelengths in um (Zemax OpticStudio user guide, "The Glass
Dispersion Formulas"). Coefficients are in the order of the CD record."""


def read_agf(path: str | os.PathLike[str]) -> tuple[AgfGlass, ...]:
    """Read a glass catalogue; an unchanged file is read only once.

    Parameters
    ----------
    path
        An AGF file in UTF-8, UTF-16 with a byte order mark, or Latin-1.

    Returns
    -------
    tuple of AgfGlass
        The glasses in the order of the file.

    Raises
    ------
    MaterialError
        If the file cannot be read, is larger than 64 MB, or is not a glass catalogue; the message names
        file and line.
    """
    file = Path(path)
    try:
        status = file.stat()
    except OSError as error:
        raise MaterialError(f"cannot read glass catalogue {file}: {error.strerror or error}") from error
    except ValueError as error:  # a NUL character in the path
        raise MaterialError(f"cannot read glass catalogue {str(file)!r}: {error}") from error
    return _load(file, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=32)
def _load(file: Path, _mtime_ns: int, _size: int) -> tuple[AgfGlass, ...]:
    data = read_input(file, CATALOG_BYTES, MaterialError, "glass catalogue")
    return parse_agf(_decode(data, str(file)), str(file))


def _decode(data: bytes, location: str) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            return data.decode("utf-16")
        except UnicodeDecodeError as error:
            raise MaterialError(
                f"{location}: not valid UTF-16 text, although its byte order mark says so"
            ) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def parse_agf(text: str, location: str) -> tuple[AgfGlass, ...]:
    """Return the glasses of an AGF text.

    These records are read: NM (name, formula, nd, Abbe number), CD (coefficients), LD (wavelength range), GC
    (comment), TD (Schott's formula for the change of index with temperature, and the reference temperature)
    and ED (its first value is the expansion around room temperature, in 1e-6/K, its third one the density in
    g/cm^3). All other records are ignored, since they concern neither index, size nor mass. A line that
    starts with a number continues the CD or TD record before it. Missing coefficients at the end of a CD
    record are zero. Constants of a TD record that are all zero, and an expansion or a density of zero, count
    as not given.

    A duplicate name is one glass with a note if both entries have the same index (within `SAME_INDEX`), and
    otherwise a glass with a `fault`. A glass whose nd contradicts its coefficients by more than `ND_REFUSED`
    has a `fault` too; from `ND_NOTED` on it has a note. Half a unit of the last given decimal of nd counts as
    rounding. An nd of 1 or of less than `LOWEST_INDEX`, or a d line outside the wavelength range, is not
    compared.

    Parameters
    ----------
    text
        Content of the file.
    location
        Name of the text in messages, normally its path.

    Returns
    -------
    tuple of AgfGlass

    Raises
    ------
    MaterialError
        If a record does not parse, a formula is unknown, a glass has no CD or LD record, or the text has no
        glass. The message names the file and the line.
    """
    drafts: list[_Draft] = []
    first_lines: dict[str, str] = {}
    last_record = ""
    continued = ("CD", "TD")
    for number, line in enumerate(text.splitlines(), start=1):
        record, rest = (*line.split(maxsplit=1), "", "")[:2]
        here = f"{location}, line {number}"
        if last_record in continued and _is_number(record):
            drafts[-1].continued += f" {line}"
            continue
        if drafts and drafts[-1].continued:
            drafts[-1].read_continued()
        last_record = record
        if record == "NM":
            if drafts:
                drafts[-1].check_complete(first_lines)
            drafts.append(_start(rest.split(), here))
            first_lines.setdefault(drafts[-1].name.casefold(), drafts[-1].line)
        elif record in _READERS:
            if not drafts:
                raise MaterialError(f"{here}: {record} record before the first NM record")
            if record in continued:
                drafts[-1].continued, drafts[-1].continued_at = f"{record} {rest}", here
            else:
                _READERS[record](drafts[-1], rest, here)
    if not drafts:
        raise MaterialError(f"{location}: no glass found; an AGF catalogue has an NM record for each glass")
    drafts[-1].read_continued()
    drafts[-1].check_complete(first_lines)
    return _without_doubles([(draft, draft.finish()) for draft in drafts])


def _is_number(word: str) -> bool:
    try:
        return word.isascii() and math.isfinite(float(word))
    except ValueError:
        return False


def _without_doubles(entries: Sequence[tuple[_Draft, AgfGlass]]) -> tuple[AgfGlass, ...]:
    """Return one glass for each name: the first entry, with a note or a fault if there are more."""
    found: dict[str, tuple[_Draft, AgfGlass]] = {}
    for draft, glass in entries:
        key = glass.name.casefold()
        if key not in found:
            found[key] = (draft, glass)
            continue
        first_draft, first = found[key]
        difference = _largest_difference(first, glass)
        if difference <= SAME_INDEX:
            thermal = "" if _thermal(first) == _thermal(glass) else "; their thermal data (TD, ED) differ"
            note = (
                f"glass {glass.name} is given twice with the same index ({first_draft.location} and line "
                f"{draft.line}); the first entry is used{thermal}"
            )
            found[key] = (first_draft, replace(first, notes=(*first.notes, note)))
        else:
            fault = (
                f"{draft.location}: glass {glass.name} is already given on line {first_draft.line} with "
                f"another index ({_spread(difference)}); remove or rename one of the two entries"
            )
            found[key] = (first_draft, replace(first, fault=first.fault or fault))
    return tuple(glass for _, glass in found.values())


def _thermal(glass: AgfGlass) -> tuple[object, ...]:
    return (glass.schott, glass.reference_temperature_c, glass.expansion_per_k)


def _largest_difference(one: AgfGlass, other: AgfGlass) -> float:
    """Return the largest index difference over the common wavelengths; inf if there are none."""
    shortest = max(one.wavelength_range_um[0], other.wavelength_range_um[0])
    longest = min(one.wavelength_range_um[1], other.wavelength_range_um[1])
    if shortest > longest:
        return math.inf
    waves = [shortest + (longest - shortest) * i / 16 for i in range(17)]
    pairs = [(one(w), other(w)) for w in waves]
    differences = [abs(a - b) for a, b in pairs if not (math.isnan(a) and math.isnan(b))]
    return max((math.inf if math.isnan(d) else d for d in differences), default=0.0)


def _spread(difference: float) -> str:
    return (
        "their ranges do not overlap" if math.isinf(difference) else f"they differ by up to {difference:.2g}"
    )


@dataclass
class _Draft:
    """A glass while its records are being read."""

    name: str
    formula: int
    location: str
    nd: str = ""
    vd: str = ""
    coefficients: tuple[float, ...] | None = None
    wavelength_range_um: tuple[float, float] | None = None
    comment: str = ""
    reference_temperature_c: float | None = None
    schott: tuple[float, float, float, float, float, float] | None = None
    expansion_per_k: float | None = None
    density_g_per_cm3: float | None = None
    continued: str = ""
    continued_at: str = ""

    @property
    def line(self) -> str:
        """Number of the line of the NM record."""
        return self.location.rpartition("line ")[2]

    def read_continued(self) -> None:
        """Read a record that may extend over several lines."""
        if self.continued:
            record, _, rest = self.continued.partition(" ")
            self.continued = ""
            _READERS[record](self, rest, self.continued_at)

    def check_complete(self, first_lines: dict[str, str]) -> None:
        """Refuse a glass without coefficients or without a range."""
        first = first_lines[self.name.casefold()]
        again = "" if first == self.line else f" is already given on line {first}, and here it"
        if self.coefficients is None:
            raise MaterialError(f"{self.location}: glass {self.name}{again} has no CD record (coefficients)")
        if self.wavelength_range_um is None:
            raise MaterialError(
                f"{self.location}: glass {self.name}{again} has no LD record (wavelength range)"
            )

    def finish(self) -> AgfGlass:
        assert self.coefficients is not None  # check_complete requires both
        assert self.wavelength_range_um is not None
        glass = AgfGlass(
            self.name,
            self.formula,
            self.coefficients,
            self.wavelength_range_um,
            self.comment,
            self.reference_temperature_c,
            self.schott,
            self.expansion_per_k,
            self.density_g_per_cm3,
        )
        return _compared(self, glass)


def _compared(draft: _Draft, glass: AgfGlass) -> AgfGlass:
    """Return the glass, with a note or a fault if its NM record contradicts its coefficients."""
    nd = _stated(draft.nd)
    if nd is None and any(c.isdigit() for c in draft.nd):
        note = (
            f"{draft.location}: the NM record of glass {draft.name} gives nd as {_shown(draft.nd)}, which is "
            "not a number; it was not compared with the coefficients"
        )
        return replace(glass, notes=(*glass.notes, note))
    shortest, longest = glass.wavelength_range_um
    if nd is None or nd < LOWEST_INDEX or nd == 1.0 or not shortest <= LINE_D_UM <= longest:
        return glass
    found = glass(LINE_D_UM)
    difference = abs(found - nd) - _rounding(draft.nd)
    if math.isnan(found) or difference > ND_REFUSED:
        fault = (
            f"{draft.location}: the NM record of glass {draft.name} gives nd = {draft.nd}, and its "
            f"coefficients (CD) give {found:.6g}; allowed is a difference of {ND_REFUSED:g}. Correct the "
            "record that is wrong: the order of the coefficients, the number of the formula, or nd"
        )
        return replace(glass, fault=fault)
    if difference > ND_NOTED:
        note = (
            f"{draft.location}: the NM record of glass {draft.name} gives nd = {draft.nd}, and its "
            f"coefficients give {found:.6g}; the coefficients are used"
        )
        return replace(glass, notes=(*glass.notes, note))
    vd = _stated(draft.vd)
    if vd is None or vd <= 0.0 or not shortest <= LINE_F_UM < LINE_C_UM <= longest:
        return glass
    dispersion = glass(LINE_F_UM) - glass(LINE_C_UM)
    abbe = (found - 1.0) / dispersion if dispersion else math.inf
    if abs(abbe - vd) - _rounding(draft.vd) > 0.02 * vd:
        note = (
            f"{draft.location}: the NM record of glass {draft.name} gives an Abbe number of {draft.vd}, and "
            f"its coefficients give {abbe:.4g}; the coefficients are used"
        )
        return replace(glass, notes=(*glass.notes, note))
    return glass


def _stated(word: str) -> float | None:
    return float(word) if _is_number(word) else None


def _rounding(word: str) -> float:
    """Return half a unit of the last written decimal of a number."""
    mantissa, _, exponent = word.lower().partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    return float(0.5 * 10.0 ** -min(max(decimals, 0), 17))


def _start(words: list[str], location: str) -> _Draft:
    if len(words) < 2:
        given = _shown(" ".join(words))
        raise MaterialError(f"{location}: NM record needs a name and a formula number, got {given}")
    longest = 100
    if len(words[0]) > longest:
        raise MaterialError(f"{location}: a glass name of {len(words[0])} characters; at most {longest}")
    formula = _number(words[1], location, "NM")
    if formula not in DISPERSION_FORMULAS:
        raise MaterialError(
            f"{location}: glass {words[0]} has dispersion formula {_short(words[1])}; "
            f"known are 1 to {max(DISPERSION_FORMULAS)}"
        )
    nd, vd = (*words[3:5], "", "")[:2]
    return _Draft(words[0], int(formula), location, nd, vd)


def _shown(text: str) -> str:
    return repr(_short(text))


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def _number(word: str, location: str, record: str) -> float:
    try:
        value = float(word) if word.isascii() and "_" not in word else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise MaterialError(f"{location}: {record} record has {_shown(word)}; must be a finite number")
    return value


def _read_coefficients(draft: _Draft, rest: str, location: str) -> None:
    values = [_number(word, location, "CD") for word in rest.split()]
    formula = DISPERSION_FORMULAS[draft.formula]
    count = formula.coefficient_count
    if not any(values[:count]):
        raise MaterialError(f"{location}: CD record of glass {draft.name} has no coefficient other than zero")
    if any(values[count:]):
        raise MaterialError(
            f"{location}: CD record of glass {draft.name} has {len(values)} values, and formula "
            f"{draft.formula} ({formula.name}) takes {count}; what follows them must be zero"
        )
    draft.coefficients = (*values[:count], *[0.0] * (count - len(values)))


def _read_range(draft: _Draft, rest: str, location: str) -> None:
    values = [_number(word, location, "LD") for word in rest.split()]
    if len(values) < 2 or not 0.0 < values[0] < values[1]:
        raise MaterialError(
            f"{location}: LD record of glass {draft.name} is {_shown(rest.strip())}; it must give the "
            "shortest and the longest wavelength in µm, 0 < shortest < longest"
        )
    draft.wavelength_range_um = (values[0], values[1])


def _read_comment(draft: _Draft, rest: str, _location: str) -> None:
    draft.comment = rest.strip()


def _read_thermal(draft: _Draft, rest: str, location: str) -> None:
    values = [_number(word, location, "TD") for word in rest.split()]
    if len(values) >= 7:
        draft.reference_temperature_c = values[6]
        if any(values[:5]):
            d0, d1, d2, e0, e1, pole = values[:6]
            draft.schott = (d0, d1, d2, e0, e1, pole)


def _read_extra(draft: _Draft, rest: str, location: str) -> None:
    words = rest.split()
    expansion = _number(words[0], location, "ED") if words else 0.0
    draft.expansion_per_k = 1e-6 * expansion if expansion else None
    density = _number(words[2], location, "ED") if len(words) > 2 else 0.0
    draft.density_g_per_cm3 = density if density > 0.0 else None


_READERS: dict[str, Callable[[_Draft, str, str], None]] = {
    "CD": _read_coefficients,
    "LD": _read_range,
    "GC": _read_comment,
    "TD": _read_thermal,
    "ED": _read_extra,
}
