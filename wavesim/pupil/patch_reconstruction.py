"""A patch of the object, and its reconstruction through one perturbed lens and the nominal lens."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import finufft  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive, validate_whole_number
from wavesim.fields.field import Orientation, axis_of
from wavesim.pupil.focus import axial_path
from wavesim.pupil.patch_rays import AimedRays, NominalRays
from wavesim.pupil.pupil import ComplexArray, ReconstructionPupil, plane_waves, refocus, remove_shift
from wavesim.targets.bars import bar_coverage

Registration = Literal["none", "shift", "focus"]


@dataclass(frozen=True)
class PatchGrid:
    """Samples of a square patch of the object, or of a line along y, around its centre.

    Attributes
    ----------
    side_um : float
        Side of the patch in um, to the outer borders of its cells.
    wavelength_um : float
        Vacuum wavelength in um.
    line : bool
        Whether the patch is a line along y.
    """

    side_um: float
    wavelength_um: float
    line: bool

    @cached_property
    def coordinates_um(self) -> Array:
        """Coordinates of the samples along each axis, in um: an odd number, at the centres of cells."""
        # Largest pitch in wavelengths: spectra of edges extend beyond all real angles and would alias.
        pitch_waves = 0.2
        count = math.ceil(self.side_um / (pitch_waves * self.wavelength_um)) | 1
        return np.asarray((np.arange(count) - count // 2) * (self.side_um / count))

    @property
    def pitch_um(self) -> float:
        """Distance of neighbouring samples in um."""
        return self.side_um / len(self.coordinates_um)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of values on the patch: (ny,) or (ny, nx)."""
        return (len(self.coordinates_um),) * (1 if self.line else 2)

    def bars(self, line_width_um: float, orientation: Orientation, bars: int) -> ComplexArray:
        """Return bright bars on a dark ground; see :meth:`wavesim.PatchReconstructor.bars`."""
        axis = axis_of(orientation)
        if self.line and axis == 0:
            raise InputError("orientation = 'x': a meridional line has bars along 'y' only")
        validate_whole_number("bars", bars, 2)
        length = (2 * bars - 1) * line_width_um
        if not (math.isfinite(line_width_um) and 0.0 < length <= self.side_um):
            raise InputError(
                f"line_width_um = {line_width_um!r}: {bars} bars and their gaps must be above 0 wide and fit "
                f"into the patch of {self.side_um:g} µm"
            )
        across = bar_coverage(self.coordinates_um, self.pitch_um, line_width_um, bars)
        if self.line:
            return np.asarray(across, complex)
        along = bar_coverage(self.coordinates_um, self.pitch_um, length, 1)
        return np.asarray(np.outer(along, across) if axis == 0 else np.outer(across, along), complex)


@dataclass(frozen=True, eq=False)
class PerturbedPatch:
    """Map from the patch to the field reconstructed through one perturbed lens.

    Attributes
    ----------
    patch : PatchGrid
        Samples of the object.
    rays : NominalRays
        Rays of the nominal lens.
    aimed : AimedRays
        Rays of the perturbed lens to the nominal sensor points.
    pupil : ReconstructionPupil
        V' - V over the nominal direction cosines.
    pixel_mm : float
        Pitch of the sensor's pixels in mm, for the noise.
    """

    patch: PatchGrid
    rays: NominalRays
    aimed: AimedRays
    pupil: ReconstructionPupil
    pixel_mm: float

    def spectrum(self, object_values: ArrayLike) -> ComplexArray:
        """Spectrum of the object in the directions p' of the perturbed rays, in um or um^2, shape (n,).

        Raises
        ------
        InputError
            If the values do not fit the patch, or are not finite.
        """
        patch, values = self.patch, np.asarray(object_values, complex)
        if values.shape != patch.shape or not np.all(np.isfinite(values)):
            raise InputError(
                f"object_values have shape {values.shape}: must be finite numbers of the patch's shape "
                f"{patch.shape}"
            )
        values = values * second_order_phasor(self.rays, patch.coordinates_um, patch.coordinates_um)
        cosines = np.where(self.aimed.valid, self.aimed.cosines, 0.0)
        x, y = 2.0 * np.pi * patch.pitch_um / patch.wavelength_um * cosines
        transform_error = 1e-6
        options = {"eps": transform_error, "isign": -1, "nthreads": 1, "upsampfac": 1.25}
        if patch.line:
            return np.asarray(patch.pitch_um * finufft.nufft1d2(y, values, **options))
        return np.asarray(patch.pitch_um**2 * finufft.nufft2d2(y, x, values, **options))

    def reconstruct(
        self,
        object_values: ArrayLike,
        registration: Registration = "none",
        electrons: float | None = None,
        rng: np.random.Generator | None = None,
    ) -> ReconstructedPatch:
        """Return the reconstruction of an object through the nominal lens.

        Parameters
        ----------
        object_values
            Complex transmission on the patch, of the patch's shape.
        registration
            "shift" removes piston and lateral displacement; "focus" removes defocus as well. Both use a least
            squares fit to the pupil's phase, see :func:`wavesim.refocus`.
        electrons
            Electrons in the brightest pixel, for the patch alone on a dark ground; default: no noise. Each
            sample of the field gets the photon noise of the pixels that it represents: 0.5 per quadrature on
            a pixel's amplitude in square roots of electrons. This is the noise of an ideal retrieval, a lower
            bound for a real one.
        rng
            Random generator of the noise; required with `electrons`.

        Raises
        ------
        InputError
            If a value is not usable.
        SamplingError
            If the phase changes by more than half a wave between neighbouring samples: what comes back is
            displaced or blurred by more than half the window.
        """
        pupil, shift, distance = self._registered(registration)
        light = self.aimed.amplitude * self.spectrum(object_values)
        if electrons is not None:
            light = light + self._noise(light, electrons, rng)
        grid = self.rays.base.grid
        cell = (grid.spacing / grid.wavelength_um) ** len(self.rays.axes)
        field = np.zeros(grid.inside.shape, complex)
        field[grid.inside] = cell * np.abs(self.rays.spread) * self.rays.amplitude * light
        field *= pupil.function
        if registration == "none":
            # The pupil's function has no piston.
            field *= np.exp(2e3j * np.pi / grid.wavelength_um * pupil.opd_mm[pupil.valid].mean())
        return ReconstructedPatch(self.patch, self.rays, self.aimed, pupil, field, shift, distance)

    def _registered(self, registration: Registration) -> tuple[ReconstructionPupil, Array, float]:
        """Return the pupil without displacement and, if requested, defocus; and both distances in um."""
        if registration == "none":
            return self.pupil, np.zeros(2), 0.0
        if registration not in ("shift", "focus"):
            raise InputError(f"registration = {registration!r}: allowed: none, shift, focus")
        # From the displaced object the nominal lens differs slightly from that at the centre.
        moved_mm = 1e-3 * self._fitted(self.pupil, registration)[1][self.rays.axes]
        second_order_mm = 0.5 * (self.rays.path_hessian_deviation_per_mm @ moved_mm) @ moved_mm
        return self._fitted(replace(self.pupil, opd_mm=self.pupil.opd_mm - second_order_mm), registration)

    def _fitted(
        self, pupil: ReconstructionPupil, registration: Registration
    ) -> tuple[ReconstructionPupil, Array, float]:
        if not self.patch.line:
            found = refocus(pupil) if registration == "focus" else remove_shift(pupil)
            return found.pupil, found.shift_um, found.refocus_um
        rows = [0, 2, 3] if registration == "focus" else [0, 2]
        basis, valid = pupil.grid.basis[rows], pupil.valid
        if np.count_nonzero(valid) <= 2 * len(rows):
            raise InputError("too few samples of the line are valid to register it: raise samples")
        opd = np.where(valid, pupil.opd_mm, 0.0)
        coefficients = np.linalg.lstsq(basis[:, valid].T, opd[valid], rcond=None)[0]
        move_um = -1e3 * coefficients[1:]
        left = replace(pupil, opd_mm=np.where(valid, opd - coefficients @ basis, 0.0))
        return left, np.array([0.0, move_um[0]]), float(move_um[1]) if len(move_um) > 1 else 0.0

    def _noise(self, light: ComplexArray, electrons: float, rng: np.random.Generator | None) -> ComplexArray:
        """Return circular complex noise, averaged over the pixels that a sample represents."""
        validate_positive("electrons", electrons)
        if rng is None:
            raise InputError(
                f"electrons = {electrons:g}: noise needs rng, such as numpy.random.default_rng(seed)"
            )
        side_mm = self.rays.base.grid.spacing / self.pixel_mm
        pixels = side_mm ** len(self.rays.axes) * np.abs(self.rays.spread)
        spread = 0.5 * np.max(np.abs(light)) / np.sqrt(electrons * pixels) * self.aimed.valid
        parts = rng.standard_normal((2, len(light)))
        return np.asarray(spread * (parts[0] + 1j * parts[1]))


@dataclass(frozen=True, eq=False)
class ReconstructedPatch:
    """Field that the nominal lens reconstructs.

    Attributes
    ----------
    patch : PatchGrid
        Samples of the object.
    rays, aimed : NominalRays, AimedRays
        Rays of the nominal lens, and of the perturbed lens.
    pupil : ReconstructionPupil
        The pupil, registered if requested.
    spectrum : ndarray, shape (samples, samples)
        Spectrum of the reconstructed field over the nominal direction cosines (row: M, column: L).
    shift_um : ndarray, shape (2,)
        Displacement (x, y) of the object in um that was removed.
    refocus_um : float
        Distance in um that was removed, from the object plane to the plane of best focus; positive towards
        the lens.
    """

    patch: PatchGrid
    rays: NominalRays
    aimed: AimedRays
    pupil: ReconstructionPupil
    spectrum: ComplexArray
    shift_um: Array
    refocus_um: float

    def at(self, x_um: Array, y_um: Array) -> ComplexArray:
        """Return the field on the grid of two axes from the centre, shape (ny, nx); on a line (ny,)."""
        grid = self.rays.base.grid
        down = plane_waves(grid.axes[1], y_um, grid.wavelength_um)
        if self.patch.line:
            field = down @ self.spectrum[:, grid.samples // 2]
        else:
            across = plane_waves(grid.axes[0], x_um, grid.wavelength_um)
            field = down @ (self.spectrum @ across.T)
        second_order = second_order_phasor(self.rays, x_um + self.shift_um[0], y_um + self.shift_um[1])
        return np.asarray(field * second_order.conj())

    def refocused_by(self, distance_um: float) -> ReconstructedPatch:
        """Return the field in a plane farther along the axis, at the same lateral position."""
        slopes, path = self._axial_path
        phase = 2.0 * np.pi * distance_um / self.patch.wavelength_um * path
        spectrum = self.spectrum.copy()
        spectrum.ravel()[self.pupil.grid.index] *= np.exp(1j * phase)
        pupil = replace(self.pupil, opd_mm=self.pupil.opd_mm + 1e-3 * distance_um * path)
        return replace(
            self,
            pupil=pupil,
            spectrum=spectrum,
            shift_um=self.shift_um - distance_um * slopes[1:],
            refocus_um=self.refocus_um + distance_um,
        )

    @cached_property
    def values(self) -> ComplexArray:
        """The field on the patch's grid."""
        return self.at(self.patch.coordinates_um, self.patch.coordinates_um)

    @cached_property
    def _axial_path(self) -> tuple[Array, Array]:
        return axial_path(self.pupil)

    def displacement_um(self, orientation: Orientation, cosine_limit: float) -> float:
        """Return the displacement of the imaged object along an axis, for light below a direction cosine.

        It follows from the least-squares slope of the pupil's phase, weighted with the power of the light, as
        in :func:`wavesim.pupil.line_pair_displacement_um`.

        Raises
        ------
        InputError
            If no such light returns.
        """
        axis, grid = axis_of(orientation), self.rays.base.grid
        within: NDArray[np.bool_] = np.abs(self.aimed.cosines[axis]) < cosine_limit
        power = np.abs(self.spectrum[grid.inside]) ** 2 * (self.pupil.valid & within)
        total, cosines = float(power.sum()), grid.cosines[:, axis]
        if total == 0.0:
            raise InputError(
                f"no light of direction cosines below {cosine_limit:.3g} passes the pupil: choose a "
                "field point nearer to the axis"
            )
        offset = cosines - (power @ cosines) / total
        spread = power @ offset**2
        slope = (power * offset) @ self.pupil.opd_waves / spread if spread > 0.0 else 0.0
        return float(-grid.wavelength_um * slope)


def second_order_phasor(rays: NominalRays, x_um: Array, y_um: Array) -> ComplexArray:
    """Return exp(i k d.H.d / 2) on the grid of two axes, or along y; H is the mean second derivative of V."""
    mean = rays.path_hessian_per_mm.mean(axis=0)
    scale = 1e-3 * np.pi / rays.base.grid.wavelength_um
    if rays.line:
        return np.asarray(np.exp(1j * scale * mean[0, 0] * y_um**2))
    down, across = (np.exp(1j * scale * mean[i, i] * a**2) for i, a in ((1, y_um), (0, x_um)))
    field = np.outer(down, across)
    if abs(mean[0, 1]) * scale * np.max(np.abs(x_um)) * np.max(np.abs(y_um)) > 1e-9:
        field *= np.exp(1j * scale * (mean[0, 1] + mean[1, 0]) * np.outer(y_um, x_um))
    return np.asarray(field)
