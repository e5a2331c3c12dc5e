"""Coatings of surfaces at one wavelength, as functions of the angle of incidence."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.common.arrays import Array
from lensdesign.lens.coatings.measured import CoatingTable
from lensdesign.lens.coatings.thin_films import Coefficients, film_coefficients, phase_of_layer


class CompiledCoating(ABC):
    """Amplitude coefficients of a surface at one wavelength.

    Phases are relative to a coating without thickness on the surface of the design, which is the border of
    the glass.
    """

    is_ideal = False

    @abstractmethod
    def coefficients(self, n_front: ArrayLike, n_behind: ArrayLike, cos_incidence: ArrayLike) -> Coefficients:
        """Return the coefficients of light that meets the front of the surface.

        Parameters
        ----------
        n_front, n_behind
            Indices of the media in front of the surface and behind it.
        cos_incidence
            Cosine of the angle of incidence in the medium in front.
        """

    @abstractmethod
    def turned(self) -> CompiledCoating:
        """Return the coating as light sees it that meets the surface from behind."""

    def with_thickness_error(self, relative_error: ArrayLike) -> CompiledCoating:
        """Return the coating with all thicknesses times 1 + error; a coating without films is unchanged."""
        return self


@dataclass(frozen=True)
class IdealCoating(CompiledCoating):
    """A coating that transmits all light and reflects none."""

    is_ideal = True

    def coefficients(self, n_front: ArrayLike, n_behind: ArrayLike, cos_incidence: ArrayLike) -> Coefficients:
        shape = np.broadcast_shapes(*(np.shape(a) for a in (n_front, n_behind, cos_incidence)))
        ones, zeros = np.ones(shape, complex), np.zeros(shape, complex)
        return Coefficients(ones, ones, zeros, zeros)

    def turned(self) -> IdealCoating:
        return self


@dataclass(frozen=True)
class UniformCoating(CompiledCoating):
    """A surface that reflects the same fraction of the light at all angles, and transmits the rest.

    Attributes
    ----------
    reflectance : float
        Reflected fraction of the power, from 0 to 1.
    """

    reflectance: float

    def coefficients(self, n_front: ArrayLike, n_behind: ArrayLike, cos_incidence: ArrayLike) -> Coefficients:
        shape = np.broadcast_shapes(*(np.shape(a) for a in (n_front, n_behind, cos_incidence)))
        passed, returned = (
            np.full(shape, np.sqrt(part), complex) for part in (1.0 - self.reflectance, self.reflectance)
        )
        return Coefficients(passed, passed, returned, returned)

    def turned(self) -> UniformCoating:
        return self


@dataclass(frozen=True, eq=False)
class FilmCoating(CompiledCoating):
    """A stack of films; a bare surface has none.

    Attributes
    ----------
    indices : tuple of complex
        Indices of the films from the front to the back.
    thicknesses_um : tuple of float
        Their thicknesses.
    wavelength_um : float
        Vacuum wavelength.
    lies_behind : bool
        Whether the films lie behind the surface of the design (on the rear face of an element), not in front.
    relative_error : float or ndarray
        Relative error of all thicknesses; an array holds one for each trial, shape (trials, 1).
    """

    indices: tuple[complex, ...]
    thicknesses_um: tuple[float, ...]
    wavelength_um: float
    lies_behind: bool = False
    relative_error: float | Array = 0.0

    def coefficients(self, n_front: ArrayLike, n_behind: ArrayLike, cos_incidence: ArrayLike) -> Coefficients:
        scale = 1.0 + np.asarray(self.relative_error)
        thicknesses = [scale * d for d in self.thicknesses_um]
        found = film_coefficients(
            n_front, n_behind, self.indices, thicknesses, cos_incidence, self.wavelength_um
        )
        if not self.indices:
            return found
        # The films displace one of the media, whose phase over their thickness belongs to the ray's path.
        front, behind = np.asarray(n_front, float), np.asarray(n_behind, float)
        cosine = np.asarray(cos_incidence, float)
        total = scale * sum(self.thicknesses_um)
        if self.lies_behind:
            sine2 = (front / behind) ** 2 * (1.0 - cosine * cosine)
            displaced = phase_of_layer(
                behind, np.sqrt(np.maximum(1.0 - sine2, 0.0)), total, self.wavelength_um
            )
            return Coefficients(found.ts * displaced.conj(), found.tp * displaced.conj(), found.rs, found.rp)
        displaced = phase_of_layer(front, cosine, total, self.wavelength_um).conj()
        return Coefficients(
            found.ts * displaced, found.tp * displaced, found.rs * displaced**2, found.rp * displaced**2
        )

    def turned(self) -> FilmCoating:
        return replace(
            self,
            indices=self.indices[::-1],
            thicknesses_um=self.thicknesses_um[::-1],
            lies_behind=not self.lies_behind,
        )

    def with_thickness_error(self, relative_error: ArrayLike) -> FilmCoating:
        return replace(self, relative_error=np.asarray(relative_error, float))


@dataclass(frozen=True, eq=False)
class TableCoating(CompiledCoating):
    """A coating with measured amplitudes.

    Attributes
    ----------
    table : CoatingTable
        The amplitudes of light that meets the front of the surface.
    wavelength_um : float
        Vacuum wavelength.
    from_behind : bool
        Whether light meets the surface from behind. Transmission is then the same along the same ray
        (reciprocity). The reflectance is that from the front, as it is for a coating without absorption.
    """

    table: CoatingTable
    wavelength_um: float
    from_behind: bool = False

    def coefficients(self, n_front: ArrayLike, n_behind: ArrayLike, cos_incidence: ArrayLike) -> Coefficients:
        cosine = np.asarray(cos_incidence, float)
        if self.from_behind:
            ratio = np.asarray(n_front, float) / np.asarray(n_behind, float)
            cosine = np.sqrt(np.maximum(1.0 - ratio * ratio * (1.0 - cosine * cosine), 0.0))
        return self.table.coefficients(self.wavelength_um, cosine)

    def turned(self) -> TableCoating:
        return replace(self, from_behind=not self.from_behind)
