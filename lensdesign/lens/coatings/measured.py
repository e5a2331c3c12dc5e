"""Measured amplitudes of a coating over wavelength and angle of incidence."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.coatings.thin_films import Coefficients


@dataclass(frozen=True, eq=False)
class CoatingTable:
    """Measured amplitudes over wavelength and angle of incidence.

    Attributes
    ----------
    path : Path
        The file.
    wavelengths_um : ndarray, shape (w,)
        Increasing wavelengths.
    incidences_deg : ndarray, shape (a,)
        Increasing angles of incidence, from 0.
    amplitudes, phases_rad : ndarray, shape (2 or 4, w, a)
        Of ts and tp, and of rs and rp where the table has them.
    """

    path: Path
    wavelengths_um: Array
    incidences_deg: Array
    amplitudes: Array
    phases_rad: Array

    @property
    def digest(self) -> str:
        """Digest of all values, which is equal for equal tables in different files."""
        arrays = self.wavelengths_um, self.incidences_deg, self.amplitudes, self.phases_rad
        return sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()

    @property
    def has_reflection(self) -> bool:
        """True if the table states the amplitudes of reflected light."""
        return len(self.amplitudes) > 2

    def coefficients(self, wavelength_um: float, cos_incidence: ArrayLike) -> Coefficients:
        """Return the amplitude coefficients, interpolated in wavelength and angle.

        Where the table has no reflection, all light that is not transmitted counts as reflected, with the
        phase 0.

        Raises
        ------
        InputError
            If the wavelength or an angle is outside the table.
        """
        from scipy.interpolate import CubicSpline

        known = self.wavelengths_um
        if not known[0] <= wavelength_um <= known[-1]:
            raise InputError(
                f"{self.path}: no values at {wavelength_um:g} µm; the wavelength must be from {known[0]:g} "
                f"to {known[-1]:g} µm"
            )
        cosine = np.clip(np.asarray(cos_incidence, float), 0.0, 1.0)
        largest = np.degrees(np.arccos(np.nanmin(cosine))) if cosine.size else 0.0
        if largest > self.incidences_deg[-1] + 1e-9:
            raise InputError(
                f"{self.path}: ends at an angle of incidence of {self.incidences_deg[-1]:g} deg, but rays "
                f"need values up to {largest:.4g} deg: measure or compute the coating to larger angles"
            )
        squares = np.sin(np.radians(self.incidences_deg)) ** 2  # coefficients are smooth in the square
        values = [
            np.array([np.interp(wavelength_um, known, column) for column in one.T])
            for one in (*self.amplitudes, *self.phases_rad)
        ]
        spline = CubicSpline(squares, np.stack(values, axis=-1)) if len(squares) > 1 else None
        at = np.stack(values, axis=-1)[0] if spline is None else spline(1.0 - cosine * cosine)
        at = np.moveaxis(np.broadcast_to(at, (*cosine.shape, len(values))), -1, 0)
        half = len(values) // 2
        found = np.clip(at[:half], 0.0, 1.0) * np.exp(1j * at[half:])
        if self.has_reflection:
            return Coefficients(*found)
        rs, rp = np.sqrt(np.clip(1.0 - np.abs(found) ** 2, 0.0, 1.0)) + 0j
        return Coefficients(found[0], found[1], rs, rp)
