"""The reconstruction pupil: what a perturbed lens does to a reconstruction through the nominal one.

A reconstruction carries the field that the perturbed lens leaves on the sensor back through the nominal
lens. Near one object point it thereby multiplies the object's plane-wave spectrum by exp(i k dV(p)),
with p the object-side direction cosines and dV the difference of the two point characteristics. Inside
the stop the amplitude is uniform, because the adjoint undoes the nominal lens's own amplitude. The
Fourier transform of the pupil over p is the reconstruction's coherent point spread.

A point source moved by (x, y, z) has dV = -(L x + M y + N z), N = sqrt(1 - L^2 - M^2); this fixes the
signs of every shift and refocus here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError
from wavesim.fields.field import Orientation, axis_of
from wavesim.fields.plane_waves import phasor_of

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class PupilGrid:
    """Square grid of object-side direction cosines over the stop, as seen from one object point.

    Attributes
    ----------
    centre : tuple of float
        Direction cosines (L, M) of the grid's centre.
    spacing : float
        Between neighbouring cosines; samples sit at the middle of their cells.
    inside : ndarray of bool, shape (samples, samples)
        Which samples the nominal lens carries to the sensor; row: M, column: L.
    wavelength_um : float
        Vacuum wavelength.
    """

    centre: tuple[float, float]
    spacing: float
    inside: NDArray[np.bool_]
    wavelength_um: float

    @property
    def samples(self) -> int:
        """Samples along each axis."""
        return len(self.inside)

    @property
    def half_width(self) -> float:
        """Half the side of the grid, in direction cosines: the numerical aperture, on the axis."""
        return 0.5 * self.spacing * self.samples

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """L of each column and M of each row."""
        offset = self.spacing * (np.arange(self.samples) - 0.5 * (self.samples - 1))
        x, y = (np.asarray(middle + offset, float) for middle in self.centre)
        return x, y

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """Flat positions of the n samples inside."""
        return np.flatnonzero(self.inside)

    @cached_property
    def cosines(self) -> Array:
        """Direction cosines L, M of the samples inside, shape (n, 2)."""
        x, y = self.axes
        row, column = np.divmod(self.index, self.samples)
        return np.column_stack([x[column], y[row]])

    @cached_property
    def axial_cosine(self) -> Array:
        """Direction cosine N of the samples inside, shape (n,)."""
        return np.asarray(np.sqrt(1.0 - np.sum(self.cosines**2, axis=1)))

    @property
    def window_um(self) -> float:
        """Period in the object plane after which everything computed on this grid repeats."""
        return self.wavelength_um / self.spacing

    @cached_property
    def basis(self) -> Array:
        """Return the terms that registration removes: 1, and L, M, N minus their means; shape (4, n)."""
        rows = np.vstack([self.cosines.T, self.axial_cosine])
        return np.vstack([np.ones(len(self.index)), rows - rows.mean(axis=1, keepdims=True)])


@dataclass(frozen=True, eq=False)
class ReconstructionPupil:
    """Optical path difference over the grid of object-side direction cosines.

    Attributes
    ----------
    grid : PupilGrid
        Where the samples sit; shared by all pupils of one sampler.
    opd_mm : ndarray, shape (n,)
        dV at each of the grid's n samples inside; meaningless where not `valid`.
    valid : ndarray of bool, shape (n,)
        Samples whose ray arrives through the nominal and through the perturbed lens.
    """

    grid: PupilGrid
    opd_mm: Array
    valid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        count = len(self.grid.index)
        if np.shape(self.opd_mm) != (count,) or np.shape(self.valid) != (count,):
            raise InputError(
                f"opd_mm and valid have shapes {np.shape(self.opd_mm)} and {np.shape(self.valid)}: "
                f"must be ({count},), one for each sample inside the grid"
            )
        if not np.any(self.valid):
            raise InputError("no ray of the pupil arrives through both the nominal and the perturbed lens")
        if not np.all(np.isfinite(self.opd_mm[self.valid])):
            raise InputError("opd_mm is not finite at samples that are marked valid")

    @property
    def cosines(self) -> Array:
        """Object-side direction cosines L, M of the samples, shape (n, 2)."""
        return self.grid.cosines

    @property
    def wavelength_um(self) -> float:
        """Vacuum wavelength."""
        return self.grid.wavelength_um

    @property
    def throughput(self) -> float:
        """Share of the nominal samples that the perturbed lens carries too."""
        return float(np.mean(self.valid))

    @cached_property
    def opd_waves(self) -> Array:
        """Optical path difference in waves less its mean, shape (n,); 0 where not valid."""
        waves = self.opd_mm * (1e3 / self.wavelength_um)
        if np.all(self.valid):
            return np.asarray(waves - waves.mean())
        return np.where(self.valid, waves - waves[self.valid].mean(), 0.0)

    @cached_property
    def phasor(self) -> ComplexArray:
        """exp(i k dV) at the samples, shape (n,); 0 where not valid."""
        values: ComplexArray = phasor_of(2.0 * np.pi * self.opd_waves)
        values[~self.valid] = 0.0
        return values

    @cached_property
    def waves_on_grid(self) -> Array:
        """`opd_waves` on the grid, shape (samples, samples); 0 where there is no valid sample."""
        return self._on_grid(self.opd_waves)

    @cached_property
    def valid_on_grid(self) -> Array:
        """1 where the grid holds a valid sample and 0 elsewhere, shape (samples, samples)."""
        return self._on_grid(self.valid.astype(float))

    @cached_property
    def function(self) -> ComplexArray:
        """The pupil on its grid, exp(i k dV) inside and 0 outside, shape (samples, samples).

        Raises
        ------
        SamplingError
            If dV changes by more than half a wave between neighbouring samples.
        """
        step = max(self._largest_step(axis) for axis in (0, 1))
        if step > 0.5:
            raise SamplingError(
                f"the pupil's phase changes by up to {step:.3g} waves between neighbouring samples; at most "
                f"0.5 can be held: remove the shift, refocus, or raise samples = {self.grid.samples}"
            )
        return self._on_grid(self.phasor)

    def _on_grid(self, values: NDArray) -> NDArray:
        """Values of the samples laid out on the grid (row: M, column: L)."""
        field = np.zeros(self.grid.inside.shape, dtype=values.dtype)
        field.ravel()[self.grid.index] = values
        return field

    def _largest_step(self, axis: int) -> float:
        """Largest change of phase, in waves, between valid neighbours along an axis."""
        waves, valid = np.moveaxis(self.waves_on_grid, axis, 0), np.moveaxis(self.valid_on_grid, axis, 0)
        return float(np.max(np.abs(waves[1:] - waves[:-1]) * (valid[1:] * valid[:-1])))


@dataclass(frozen=True)
class Refocused:
    """A registered pupil, and what had to be taken out of it.

    Attributes
    ----------
    pupil : ReconstructionPupil
        The pupil without piston, shift and, if asked for, defocus.
    shift_um : ndarray, shape (2,)
        By how much (x, y) the reconstruction shows the object displaced.
    refocus_um : float
        By how much the plane of best focus lies from the nominal object plane, positive towards the lens;
        0 where the focus was left alone.
    piston_um : float
        Optical path difference common to all rays.
    """

    pupil: ReconstructionPupil
    shift_um: Array
    refocus_um: float
    piston_um: float


def refocus(pupil: ReconstructionPupil) -> Refocused:
    """Bring a pupil to the object plane and place in which its phase is flattest.

    Piston, shift and defocus leave by least squares over the valid samples. Defocus is exact: moving the
    object along the axis by dz changes the path by -dz sqrt(1 - L^2 - M^2), not by its parabola. That is the
    plane of the smallest root mean square, and near that of the highest Strehl ratio; contrast may be best
    beside it (:func:`wavesim.pupil.best_focus`). Eqs. 5 and 6 instead seek the plane in which a
    reconstructed picture is sharpest (:func:`wavesim.reconstruction.refocus_field`).

    Raises
    ------
    InputError
        If too few samples are valid.
    """
    return _register(pupil, terms=3)


def remove_shift(pupil: ReconstructionPupil) -> Refocused:
    """Take piston and shift out of a pupil and leave its focus alone; see :func:`refocus`."""
    return _register(pupil, terms=2)


def _register(pupil: ReconstructionPupil, terms: int) -> Refocused:
    """Fit piston and the first `terms` of L, M and N, and take them out."""
    grid, valid = pupil.grid, pupil.valid
    count = np.count_nonzero(valid)
    if count <= 2 * terms:
        raise InputError(
            f"only {count} samples of the pupil are valid: cannot register it; raise samples or lower "
            "the perturbation"
        )
    basis = grid.basis[: terms + 1]
    opd = np.where(valid, pupil.opd_mm, 0.0)
    try:
        coefficients = np.linalg.solve((basis * valid) @ basis.T, basis @ opd)
    except np.linalg.LinAlgError:
        raise InputError("the valid samples of the pupil lie on one line: cannot register it") from None
    means = np.append(grid.cosines.mean(axis=0), grid.axial_cosine.mean())[:terms]
    move_um = np.asarray(-1e3 * coefficients[1:], float)
    return Refocused(
        pupil=replace(pupil, opd_mm=np.where(valid, opd - coefficients @ basis, 0.0)),
        shift_um=move_um[:2],
        refocus_um=float(move_um[2]) if terms == 3 else 0.0,
        piston_um=float(1e3 * coefficients[0] + move_um @ means),
    )


def rms_waves(pupil: ReconstructionPupil) -> float:
    """Standard deviation of the optical path difference over the valid samples, in waves.

    Only piston is left out; register the pupil first to leave out shift and defocus.
    """
    return float(np.sqrt(np.mean(pupil.opd_waves[pupil.valid] ** 2)))


def strehl(pupil: ReconstructionPupil) -> float:
    """Strehl ratio |mean exp(i k dV)|^2 over the valid samples.

    This is the intensity at the nominal place; register the pupil first (:func:`refocus` or
    :func:`remove_shift`) for the ratio at the image's own place.

    Raises
    ------
    SamplingError
        If the phase is sampled too coarsely.
    """
    return float(np.abs(np.sum(pupil.function) / np.count_nonzero(pupil.valid)) ** 2)


def psf(pupil: ReconstructionPupil, half_width_um: float, points: int = 129) -> tuple[Array, Array]:
    """Intensity of the coherent point spread about the nominal place.

    Parameters
    ----------
    pupil
        A registered pupil, or the spread may lie outside the window.
    half_width_um
        Half the side of the square window in the object plane.
    points
        Number of points along each side.

    Returns
    -------
    coordinates_um : ndarray, shape (points,)
        Along x and along y.
    intensity : ndarray, shape (points, points)
        1 at the peak of a perfect pupil; row: y, column: x.

    Raises
    ------
    SamplingError
        If the window is wider than the grid's period, or the phase is sampled too coarsely.
    InputError
        If `half_width_um` or `points` is no size.
    """
    if not (np.isfinite(half_width_um) and half_width_um > 0.0) or points < 2:
        raise InputError(
            f"half_width_um = {half_width_um:g}, points = {points}: must be above 0, and at least 2"
        )
    validate_pupil_width(pupil.grid, 2.0 * half_width_um, "the point spread's window")
    coordinates = np.linspace(-half_width_um, half_width_um, points)
    across, down = (plane_waves(axis, coordinates, pupil.wavelength_um) for axis in pupil.grid.axes)
    field = down @ pupil.function @ across.T
    return coordinates, np.abs(field / np.count_nonzero(pupil.valid)) ** 2


def mtf(
    pupil: ReconstructionPupil, frequencies_lp_per_mm: ArrayLike, orientation: Orientation = "x"
) -> Array:
    """Modulation transfer of the intensity point spread: the pupil's normalised autocorrelation.

    What an incoherent object would see; its cut-off is 2 NA / wavelength.

    Parameters
    ----------
    frequencies_lp_per_mm
        Spatial frequencies in the object plane, not negative.
    orientation
        Axis along which the object varies.

    Returns
    -------
    ndarray
        Modulus, 1 at frequency 0, in the shape of the frequencies.

    Raises
    ------
    InputError
        If a frequency is negative or not finite, or the orientation is unknown.
    SamplingError
        If the phase is sampled too coarsely.
    """
    frequencies = np.asarray(frequencies_lp_per_mm, float)
    if not np.all(np.isfinite(frequencies)) or np.any(frequencies < 0.0):
        raise InputError(f"frequencies_lp_per_mm = {frequencies.tolist()}: must be finite and not negative")
    field = pupil.function if axis_of(orientation) == 0 else pupil.function.T
    samples = pupil.grid.samples
    spectrum = np.abs(np.fft.fft(field, 2 * samples, axis=1)) ** 2
    correlation = np.append(np.fft.ifft(spectrum.sum(axis=0))[:samples], 0.0)
    # A pupil of square cells has an autocorrelation that is linear between whole lags.
    lag = frequencies * 1e-3 * pupil.wavelength_um / pupil.grid.spacing
    at = [np.interp(lag, np.arange(samples + 1), part) for part in (correlation.real, correlation.imag)]
    return np.asarray(np.hypot(*at) / correlation[0].real)


def validate_pupil_width(grid: PupilGrid, width_um: float, what: str) -> None:
    """SamplingError if something in the object plane is wider than the grid's period."""
    if width_um > grid.window_um:
        needed = int(np.ceil(grid.samples * width_um / grid.window_um))
        raise SamplingError(
            f"{what} is {width_um:.4g} um wide, but a pupil of {grid.samples} samples repeats after "
            f"{grid.window_um:.4g} um: raise samples to at least {needed} or take it narrower"
        )


def plane_waves(cosines: Array, coordinates_um: Array, wavelength_um: float) -> ComplexArray:
    """exp(i k L x) for coordinates (rows) and cosines (columns)."""
    return np.asarray(np.exp((2j * np.pi / wavelength_um) * np.outer(coordinates_um, cosines)))
