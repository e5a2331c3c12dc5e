"""Refractive index of a glass that a lens file defines by indices at some wavelengths."""

from __future__ import annotations

import math
from collections.abc import Sequence

LARGEST_INDEX = 10.0
"""Largest index that a lens file may state. No transparent medium exceeds it, and an Abbe number does."""


def tabulated_index(
    name: str, wavelengths_nm: Sequence[float], indices: Sequence[float], wavelength_nm: float
) -> tuple[float, str, str]:
    """Return the index at a wavelength, a remark, and a loss; the last two may be empty.

    Parameters
    ----------
    name
        The glass in words, for the remark and the loss.
    wavelengths_nm, indices
        Wavelengths in nm and the index at each of them.
    wavelength_nm
        Vacuum wavelength in nm.

    Returns
    -------
    index : float
        The index of the table; between two wavelengths of the table it is interpolated.
    remark : str
        That the index was interpolated.
    loss : str
        That the wavelength lies outside the table. The index is then that of the nearest wavelength.
    """
    pairs = sorted(zip(wavelengths_nm, indices, strict=True), key=lambda pair: abs(pair[0] - wavelength_nm))
    nearest_nm, nearest = pairs[0]
    same_line_nm = 0.1  # files give the same spectral line with different numbers of digits
    if abs(nearest_nm - wavelength_nm) <= same_line_nm or len(set(indices)) == 1 < len(indices):
        return nearest, "", ""
    if not min(wavelengths_nm) < wavelength_nm < max(wavelengths_nm):
        return nearest, "", f"index of {name} at {wavelength_nm:g} nm; that at {nearest_nm:g} nm is used"
    index = _interpolated(pairs[:4], wavelength_nm)
    return index, f"index {index:.7g} of {name} at {wavelength_nm:g} nm interpolated", ""


def _interpolated(pairs: Sequence[tuple[float, float]], wavelength_nm: float) -> float:
    """Interpolate the index by Lagrange's polynomial in 1 / w^2 (compare Cauchy's formula)."""
    x = [1.0 / w**2 for w, _ in pairs]
    at = 1.0 / wavelength_nm**2
    return sum(
        n * math.prod((at - x[j]) / (x[i] - x[j]) for j in range(len(x)) if j != i)
        for i, (_, n) in enumerate(pairs)
    )
