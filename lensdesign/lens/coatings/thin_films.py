"""Amplitude coefficients of a stack of thin films, by the transfer-matrix method.

Coefficients are normalized to flux: the square of their modulus is the transmittance or reflectance. For an
ideal surface they would be 1 and 0. Fields have the time factor exp(-i omega t), so that a longer path has a
larger phase, and an absorbing medium has an index n + i k.

References
----------
H. A. Macleod, "Thin-Film Optical Filters", 5th edition (2018), chapter 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array

ComplexArray = NDArray[np.complex128]


class Coefficients(NamedTuple):
    """Amplitude coefficients of a surface, normalized to flux.

    Attributes
    ----------
    ts, tp : ndarray
        Transmission of light polarized across (s) and along (p) the plane of incidence.
    rs, rp : ndarray
        Reflection. The sign of `rp` is that of the electric field along the surface, so that `rs` and `rp`
        are equal at normal incidence.
    """

    ts: ComplexArray
    tp: ComplexArray
    rs: ComplexArray
    rp: ComplexArray


def film_coefficients(
    n_front: ArrayLike,
    n_behind: ArrayLike,
    film_indices: Sequence[complex],
    film_thicknesses_um: Sequence[ArrayLike],
    cos_incidence: ArrayLike,
    wavelength_um: float,
) -> Coefficients:
    """Return the amplitude coefficients of a stack of films between two transparent media.

    The phase of the transmission is that from the front face of the stack to its rear face; the phase of the
    reflection is that at the front face. Beyond total internal reflection the transmission is 0.

    Parameters
    ----------
    n_front, n_behind
        Real indices of the media in front of the stack and behind it, relative to the same medium as the
        wavelength.
    film_indices
        Complex indices n + i k of the films, in the order in which light meets them; empty for a bare
        surface.
    film_thicknesses_um
        Thicknesses of the films; each may be an array.
    cos_incidence
        Cosine of the angle of incidence, above 0. All arrays are broadcast together.
    wavelength_um
        Vacuum wavelength.

    Examples
    --------
    The transmittance of bare glass of index 1.5 at normal incidence is 0.96:

    >>> coefficients = film_coefficients(1.0, 1.5, (), (), 1.0, 0.55)
    >>> round(float(abs(coefficients.ts) ** 2), 12)
    0.96
    """
    front, behind = np.asarray(n_front, complex), np.asarray(n_behind, complex)
    cosine = np.asarray(cos_incidence, complex)
    transverse2 = front * front * (1.0 - cosine * cosine)

    def longitudinal(index: ComplexArray) -> ComplexArray:
        """Return n cos(angle), of the branch that decays or travels forwards."""
        return np.asarray(np.sqrt(index * index - transverse2 + 0j))

    first, last = front * cosine, longitudinal(behind)
    phases: list[tuple[ComplexArray, ComplexArray, ComplexArray]] = []
    for index, thickness_um in zip(film_indices, film_thicknesses_um, strict=True):
        film = np.asarray(index, complex)
        along = longitudinal(film)
        phases.append((film, along, 2.0 * np.pi / wavelength_um * along * np.asarray(thickness_um)))
    results = []
    for is_p in (False, True):
        # Tilted admittances: n cos(angle) for s, n / cos(angle) = n^2 / (n cos(angle)) for p.
        entrance = front * front / first if is_p else first
        exit_ = behind * behind / last if is_p else last
        b, c, depth = np.ones_like(exit_), exit_, np.zeros(np.shape(exit_))
        for film, along, phase in reversed(phases):
            admittance = film * film / along if is_p else along
            # Without the decay of an absorbing film, which would overflow; it only reduces the transmission.
            decay = np.abs(phase.imag)
            waves = np.exp(1j * phase - decay), np.exp(-1j * phase - decay)
            cos_phase, sin_phase = 0.5 * (waves[0] + waves[1]), -0.5j * (waves[0] - waves[1])
            depth = depth + decay
            b, c = (
                cos_phase * b - 1j * sin_phase / admittance * c,
                cos_phase * c - 1j * admittance * sin_phase * b,
            )
        total = entrance * b + c
        propagates = np.abs(last.imag) < 1e-12 * np.abs(behind)
        kept = np.sqrt(np.abs(entrance.real) * np.where(propagates, np.abs(exit_.real), 0.0))
        results.append((2.0 * kept / total * np.exp(-depth), (entrance * b - c) / total))
    (ts, rs), (tp, rp) = results
    return Coefficients(*(np.asarray(value) for value in (ts, tp, rs, rp)))


def phase_of_layer(
    index: ArrayLike, cosine: ArrayLike, thickness_um: ArrayLike, wavelength_um: float
) -> ComplexArray:
    """Return exp(i k n d cos(angle)), the phase across a layer of thickness d in a transparent medium."""
    path: Array = np.asarray(index) * np.asarray(cosine) * np.asarray(thickness_um)
    return np.asarray(np.exp(2j * np.pi / wavelength_um * path))
