"""The reconstruction pupil: effect of a perturbed lens on a reconstruction through the nominal lens.

A reconstruction propagates the field that the perturbed lens gives on the sensor back through the nominal
lens. Near one object point this multiplies the object's plane-wave spectrum by exp(i k dV(p)). Here p are the
object-side direction cosines, and dV is the difference of the two point characteristics. Inside the stop the
amplitude is uniform, because the adjoint compensates the amplitude of the nominal lens. The Fourier transform
of the pupil over p is the coherent point spread function of the reconstruction.

A point source moved by (x, y, z) has dV = -(L x + M y + N z) with N = sqrt(1 - L^2 - M^2). This defines the
signs of all shifts and refocus distances.
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
    centre : (L, M)
        Direction cosines of the grid's centre.
    spacing : float
        Difference of neighbouring cosines. Samples lie at the centres of their cells.
    inside : ndarray of bool, shape (samples, samples)
        Samples whose rays reach the sensor through the nominal lens; row: M, column: L.
    wavelength_um : float
        Vacuum wavelength in um.
    """

    centre: tuple[float, float]
    spacing: float
    inside: NDArray[np.bool_]
    wavelength_um: float

    @property
    def samples(self) -> int:
        """Number of samples along each axis."""
        return len(self.inside)

    @property
    def half_width(self) -> float:
        """Half of the grid's side in direction cosines; the numerical aperture for a point on the axis."""
        return 0.5 * self.spacing * self.samples

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """L of each column and M of each row, each of shape (samples,)."""
        offset = self.spacing * (np.arange(self.samples) - 0.5 * (self.samples - 1))
        x, y = (np.asarray(middle + offset, float) for middle in self.centre)
        return x, y

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """Flat indices of the n samples inside."""
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

    @cached_property
    def mean_cosines(self) -> Array:
        """Means of L, M and N, shape (3,)."""
        return np.append(self.cosines.mean(axis=0), self.axial_cosine.mean())

    @property
    def window_um(self) -> float:
        """Period in the object plane, in um, with which all results of this grid repeat."""
        return self.wavelength_um / self.spacing

    @cached_property
    def basis(self) -> Array:
        """Terms that registration removes: 1, and L, M, N minus their means; shape (4, n)."""
        rows = np.vstack([self.cosines.T, self.axial_cosine])
        return np.vstack([np.ones(len(self.index)), rows - rows.mean(axis=1, keepdims=True)])

    @cached_property
    def products(self) -> Array:
        """Sums of products of the terms of :attr:`PupilGrid.basis` over all samples, shape (4, 4)."""
        return np.asarray(self.basis @ self.basis.T)


@dataclass(frozen=True, eq=False)
class ReconstructionPupil:
    """Optical path difference between a perturbed and the nominal lens, over the directions at the object.

    :meth:`wavesim.PupilSampler.pupil` computes it. See :mod:`wavesim.pupil.pupil` for its meaning.

    Attributes
    ----------
    grid : PupilGrid
        Grid of direction cosines; shared by all pupils of one sampler.
    opd_mm : ndarray, shape (n,)
        Optical path difference dV in mm at the grid's n samples inside; without meaning where not `valid`.
    valid : ndarray of bool, shape (n,)
        Samples whose rays reach the sensor through both lenses.

    Raises
    ------
    InputError
        If the shapes differ, no sample is valid, or a valid path difference is not finite.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> pupil = sampler.pupil(Pose(tilt_y_deg=0.1))
    >>> pupil.opd_mm.shape == pupil.valid.shape == (len(pupil.cosines),)
    True
    >>> round(pupil.throughput, 2)
    1.0
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
        if not np.all(np.isfinite(self.opd_mm) | ~self.valid):
            raise InputError("opd_mm is not finite at samples that are marked valid")

    @property
    def cosines(self) -> Array:
        """Object-side direction cosines L, M of the samples, shape (n, 2)."""
        return self.grid.cosines

    @property
    def wavelength_um(self) -> float:
        """Vacuum wavelength in um."""
        return self.grid.wavelength_um

    @property
    def throughput(self) -> float:
        """Fraction of the nominal lens's rays that pass the perturbed lens as well."""
        return float(np.mean(self.valid))

    @property
    def products(self) -> Array:
        """Sums of products of the terms of :attr:`PupilGrid.basis` over the valid samples, shape (4, 4)."""
        if np.all(self.valid):
            return self.grid.products
        return np.asarray((self.grid.basis * self.valid) @ self.grid.basis.T)

    @cached_property
    def opd_waves(self) -> Array:
        """Optical path difference minus its mean, in waves, shape (n,); 0 where not valid."""
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
        """1 at the valid samples of the grid and 0 elsewhere, shape (samples, samples)."""
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
                f"the pupil's phase changes by up to {step:.3g} waves between neighbouring samples "
                f"(allowed: 0.5): remove the shift, refocus, or raise samples = {self.grid.samples}"
            )
        return self._on_grid(self.phasor)

    def _on_grid(self, values: NDArray) -> NDArray:
        """Return values of the samples on the grid (row: M, column: L)."""
        field = np.zeros(self.grid.inside.shape, dtype=values.dtype)
        field.ravel()[self.grid.index] = values
        return field

    def _largest_step(self, axis: int) -> float:
        """Return the largest change of phase, in waves, between valid neighbours along an axis."""
        waves, valid = np.moveaxis(self.waves_on_grid, axis, 0), np.moveaxis(self.valid_on_grid, axis, 0)
        return float(np.max(np.abs(waves[1:] - waves[:-1]) * (valid[1:] * valid[:-1])))


@dataclass(frozen=True)
class Refocused:
    """A registered pupil, and the terms that were removed from it.

    Attributes
    ----------
    pupil : ReconstructionPupil
        The pupil without piston and shift, and without defocus where that was removed.
    shift_um : ndarray, shape (2,)
        Displacement (x, y) of the reconstructed object in um.
    refocus_um : float
        Distance in um from the nominal object plane to the plane of best focus, positive towards the lens; 0
        if the focus was not changed.
    piston_um : float
        Optical path difference in um that all rays have in common.
    """

    pupil: ReconstructionPupil
    shift_um: Array
    refocus_um: float
    piston_um: float


def refocus(pupil: ReconstructionPupil) -> Refocused:
    """Remove piston, shift and defocus from a pupil, by least squares over its valid samples.

    A displacement of the object by dz along the axis changes the path by -dz sqrt(1 - L^2 - M^2); no parabola
    is assumed. The root mean square of the result is the smallest possible one, and its Strehl ratio is near
    the highest. The contrast of lines may be higher in another plane (:func:`wavesim.pupil.best_focus`). To
    refocus a reconstructed picture, use :func:`wavesim.refocus_field`.

    Parameters
    ----------
    pupil
        The pupil.

    Returns
    -------
    Refocused
        The registered pupil, and its shift, refocus distance and piston in um.

    Raises
    ------
    InputError
        If too few samples are valid.

    Examples
    --------
    A tilt of the lens displaces the reconstructed object:

    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, refocus
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> registered = refocus(sampler.pupil(Pose(tilt_y_deg=0.1)))
    >>> round(float(registered.shift_um[0]))
    -9
    """
    return _register(pupil, terms=3)


def remove_shift(pupil: ReconstructionPupil) -> Refocused:
    """Remove piston and shift from a pupil, but not its defocus; see :func:`refocus`."""
    return _register(pupil, terms=2)


def _register(pupil: ReconstructionPupil, terms: int) -> Refocused:
    """Fit and remove piston and the first `terms` of L, M and N."""
    grid, valid = pupil.grid, pupil.valid
    count = np.count_nonzero(valid)
    if count <= 2 * terms:
        raise InputError(
            f"only {count} samples of the pupil are valid: cannot register it; raise samples or lower "
            "the perturbation"
        )
    basis, is_whole = grid.basis[: terms + 1], count == valid.size
    opd = pupil.opd_mm if is_whole else np.where(valid, pupil.opd_mm, 0.0)
    try:
        products = pupil.products[: terms + 1, : terms + 1]
        coefficients = np.linalg.solve(products, basis @ opd)
    except np.linalg.LinAlgError:
        raise InputError("the valid samples of the pupil lie on one line: cannot register it") from None
    means = grid.mean_cosines[:terms]
    registered = opd - coefficients @ basis
    move_um = np.asarray(-1e3 * coefficients[1:], float)
    return Refocused(
        pupil=replace(pupil, opd_mm=registered if is_whole else np.where(valid, registered, 0.0)),
        shift_um=move_um[:2],
        refocus_um=float(move_um[2]) if terms == 3 else 0.0,
        piston_um=float(1e3 * coefficients[0] + move_um @ means),
    )


def rms_waves(pupil: ReconstructionPupil) -> float:
    """Return the standard deviation of the optical path difference over the valid samples, in waves.

    It includes shift and defocus, unless the pupil is registered.

    Parameters
    ----------
    pupil
        The pupil, usually registered by :func:`refocus`.

    Returns
    -------
    float
        Standard deviation in waves.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, refocus, rms_waves
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> pupil = sampler.pupil(Pose(tilt_y_deg=0.1))
    >>> round(rms_waves(pupil), 1), round(rms_waves(refocus(pupil).pupil), 2)
    (4.4, 0.16)
    """
    return float(np.sqrt(np.mean(pupil.opd_waves[pupil.valid] ** 2)))


def strehl(pupil: ReconstructionPupil) -> float:
    """Return the Strehl ratio `|mean exp(i k dV)|^2` over the valid samples.

    It is the intensity of the point spread function at the nominal image point, relative to that of a perfect
    pupil. For the ratio at the displaced image point, register the pupil first (:func:`refocus` or
    :func:`remove_shift`).

    Parameters
    ----------
    pupil
        The pupil, usually registered.

    Returns
    -------
    float
        Strehl ratio, 0 to 1.

    Raises
    ------
    SamplingError
        If the phase is sampled too coarsely.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, refocus, strehl
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> round(strehl(refocus(sampler.pupil(Pose(tilt_y_deg=0.1))).pupil), 2)
    0.41
    """
    return float(np.abs(np.sum(pupil.function) / np.count_nonzero(pupil.valid)) ** 2)


def psf(pupil: ReconstructionPupil, half_width_um: float, points: int = 129) -> tuple[Array, Array]:
    """Return the intensity of the coherent point spread function around the nominal image point.

    Parameters
    ----------
    pupil
        The pupil. Without registration (:func:`refocus`) the peak may lie outside the window.
    half_width_um
        Half of the side of the square window in the object plane, in um.
    points
        Number of points along each side.

    Returns
    -------
    coordinates_um : ndarray, shape (points,)
        Coordinates along x, which are also those along y, in um.
    intensity : ndarray, shape (points, points)
        Intensity relative to the peak of a perfect pupil; row: y, column: x.

    Raises
    ------
    SamplingError
        If the window is wider than the grid's period, or the phase is sampled too coarsely.
    InputError
        If `half_width_um` is not above 0, or `points` is below 2.

    Examples
    --------
    The value at the centre of the window is the Strehl ratio:

    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, psf, refocus
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> pupil = refocus(sampler.pupil(Pose(tilt_y_deg=0.1))).pupil
    >>> coordinates_um, intensity = psf(pupil, half_width_um=2.0, points=41)
    >>> intensity.shape, round(float(intensity[20, 20]), 2)
    ((41, 41), 0.41)
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
    """Return the modulation transfer function: the modulus of the pupil's normalised autocorrelation.

    It applies to an incoherent object. The cut-off is 2 NA / wavelength.

    Parameters
    ----------
    pupil
        The pupil, usually registered by :func:`refocus`.
    frequencies_lp_per_mm
        Spatial frequencies in the object plane in line pairs per mm, not negative.
    orientation
        Axis along which the object varies, "x" or "y".

    Returns
    -------
    ndarray
        Modulation in the shape of the frequencies; 1 at frequency 0.

    Raises
    ------
    InputError
        If a frequency is negative or not finite, or the orientation is unknown.
    SamplingError
        If the phase is sampled too coarsely.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, mtf, refocus
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> pupil = refocus(sampler.pupil(Pose(tilt_y_deg=0.1))).pupil
    >>> mtf(pupil, [0.0, 500.0, 1500.0]).round(1).tolist()
    [1.0, 0.3, 0.0]
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
    """Check that a width in the object plane does not exceed the grid's period.

    Raises
    ------
    SamplingError
        If it does; `what` names the object in the message.
    """
    if width_um > grid.window_um:
        needed = int(np.ceil(grid.samples * width_um / grid.window_um))
        raise SamplingError(
            f"{what} is {width_um:.4g} µm wide, but a pupil of {grid.samples} samples repeats after "
            f"{grid.window_um:.4g} µm: raise samples to at least {needed} or make it narrower"
        )


def plane_waves(cosines: Array, coordinates_um: Array, wavelength_um: float) -> ComplexArray:
    """Return exp(i k L x) for coordinates (rows) and cosines (columns)."""
    return np.asarray(np.exp((2j * np.pi / wavelength_um) * np.outer(coordinates_um, cosines)))
