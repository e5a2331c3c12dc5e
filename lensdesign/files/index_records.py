"""Index records of lens files: the index that a file states beside the name of a glass.

A GLAS record of OpticStudio holds the index at the helium d line and the Abbe number beside the name. They
show which data the other program used, so they are compared with the data that the import uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lensdesign.errors import MaterialError
from lensdesign.lens.catalogues.agf import LINE_C_UM, LINE_D_UM, LINE_F_UM
from lensdesign.lens.glass import get_material, glass_summary

INDEX_NOTED = 1e-4
"""Difference of nd between a file's record and the data used from which an import has a note. Editions of one
catalogue differ by less."""

INDEX_REFUSED = 1e-3
"""Difference of nd from which an import needs --lossy: the coarsest tolerance class of ISO 12123 (NP100)."""

_LINE_E_UM = 0.546074  # mercury; some designers enter the indices of this line

_ABBE_NOTED = 0.02  # relative difference of the Abbe number that a note names


@dataclass(frozen=True)
class IndexRecord:
    """Index at the d line and Abbe number that a file states; the latter is None if it states none."""

    nd: float
    vd: float | None = None

    def is_exact_at(self, wavelengths_um: Sequence[float]) -> bool:
        """Return whether nd is the index at all wavelengths: without dispersion, or if all are the d line."""
        same_line_um = 1e-4  # files give the same spectral line with different numbers of digits
        return not self.vd or all(abs(w - LINE_D_UM) <= same_line_um for w in wavelengths_um)

    def index(self, material: str | float, wavelength_um: float, catalogs: Sequence[Path]) -> float | None:
        """Return the index of the record at a wavelength; None if the material's nd is not known.

        The record and the material with its nd and Abbe number are each continued by Cauchy's formula with
        two terms. Their difference is added to the index of the material, so that the error of this formula
        is small. A material that is a number has no dispersion.
        """
        summary = glass_summary(material, catalogs)
        nd, vd = summary["nd"], summary["vd"]
        if nd is None:
            return None
        if self.is_of_e_line(material, catalogs):
            return get_material(material, catalogs).index(wavelength_um)
        difference = self.nd - nd
        is_constant = not isinstance(material, str)
        if self.vd and (vd or is_constant):
            slope = (self.nd - 1.0) / self.vd - ((nd - 1.0) / vd if vd else 0.0)
            span = LINE_F_UM**-2 - LINE_C_UM**-2
            difference += slope * (wavelength_um**-2 - LINE_D_UM**-2) / span
        return float(get_material(material, catalogs).index(wavelength_um) + difference)

    def is_of_e_line(self, material: str | float, catalogs: Sequence[Path]) -> bool:
        """Return whether the record is the index of the material at the e line, not at the d line."""
        found = get_material(material, catalogs)
        shortest, longest = found.wavelength_range_um
        if not shortest <= _LINE_E_UM < LINE_D_UM <= longest:
            return False
        at_d, at_e = (abs(found.index(w) - self.nd) for w in (LINE_D_UM, _LINE_E_UM))
        return at_e <= INDEX_NOTED < at_d


@dataclass(frozen=True)
class IndexDifference:
    """Difference between the data of a glass and a file's record of it.

    Attributes
    ----------
    nd
        Index at the d line by the data minus that of the record; 0 if the record is that of the e line.
    text
        The difference in words: both values of nd, the index at the design wavelength, the Abbe numbers.
    """

    nd: float
    text: str


def index_difference(
    material: str, record: IndexRecord, wavelength_um: float | None, catalogs: Sequence[Path]
) -> IndexDifference | None:
    """Return the difference between the data of a glass and a file's record; None if nd is not known.

    Parameters
    ----------
    material
        Name of the glass in a design file.
    record
        The file's record.
    wavelength_um
        Wavelength of the design, at which the difference is stated too; None if it is not known.
    catalogs
        The user's own catalogue files.
    """
    try:
        summary = glass_summary(material, catalogs)
        found = get_material(material, catalogs)
        nd, vd = summary["nd"], summary["vd"]
        at_wavelength = None
        if wavelength_um is not None and abs(wavelength_um - LINE_D_UM) > 1e-3:
            at_wavelength = record.index(material, wavelength_um, catalogs)
    except MaterialError:  # reported later, when the index is needed
        return None
    if nd is None:
        return None
    if record.is_of_e_line(material, catalogs):
        return IndexDifference(0.0, f"index {record.nd:.6f} at the e line, as the file's index record states")
    text = f"nd {nd:.6f}, by the file's index record {record.nd:.6f} (difference {nd - record.nd:+.6f}"
    if at_wavelength is not None and wavelength_um is not None:
        text += f", about {found.index(wavelength_um) - at_wavelength:+.6f} at {wavelength_um:g} µm"
    text += ")"
    if record.vd and vd and abs(vd - record.vd) > _ABBE_NOTED * record.vd:
        text += f", Abbe number {vd:.4g}, by the record {record.vd:.4g}"
    return IndexDifference(nd - record.nd, text)
