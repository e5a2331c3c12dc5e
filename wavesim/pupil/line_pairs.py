"""Line pairs through a reconstruction pupil, in coherent light.

The object is a square target of bright bars on a dark ground: `bars` bars of width w with gaps of width w.
The bars have the length (2 bars - 1) w, which is also the width of the target. A plane wave along the axis
illuminates the target, so that its spectrum is centred at p = 0 for each field point. The image is the sum
over the pupil of the bars' exact spectrum, the pupil, and exp(i k p.x). A large bright area has intensity 1.

Coma displaces lines by an amount that depends on their width, without blur. So does defocus at an off-axis
point. Contrast is therefore measured at the displaced lines. Their displacement is the slope of the phase
over the diffraction orders that form the lines (0 and +-1). Even parts of the phase do not displace lines, so
that contrast which they reverse remains visible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, repeat
from operator import mul

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive, validate_whole_number
from wavesim.fields.field import Orientation, axis_of
from wavesim.pupil.pupil import (
    ComplexArray,
    PupilGrid,
    ReconstructionPupil,
    plane_waves,
    validate_pupil_width,
)
from wavesim.targets.bars import bar_and_gap_centres, bar_centres, michelson, resolved_lines


def line_pair_contrast(
    pupil: ReconstructionPupil, line_width_um: float, orientation: Orientation = "x", bars: int = 5
) -> float:
    """Return the contrast of a line pair target in coherent light: (bright - dark) / (bright + dark).

    "bright" is the mean intensity at the centres of the bars, and "dark" that at the centres of the gaps.
    Both are taken on the line across the centre of the target, displaced by
    :func:`line_pair_displacement_um`. Reversed lines (false resolution) have a negative contrast.

    Parameters
    ----------
    pupil
        A registered pupil (:func:`wavesim.refocus` or :func:`wavesim.pupil.remove_shift`).
    line_width_um
        Width of a bar and of a gap in um; the period is twice as large.
    orientation
        Axis along which the bars are repeated, "x" or "y".
    bars
        Number of bars, at least 2.

    Returns
    -------
    float
        Contrast, -1 to 1.

    Raises
    ------
    InputError
        If the width, the orientation or the number of bars is invalid.
    SamplingError
        If the target is wider than the grid's period, or the phase is sampled too coarsely.

    Examples
    --------
    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PupilSampler, line_pair_contrast, refocus
    >>> sampler = PupilSampler(load_design("designs/paper_singlet.toml"), samples=64)
    >>> pupil = refocus(sampler.pupil(Pose(tilt_y_deg=0.1))).pupil
    >>> round(line_pair_contrast(pupil, 0.775), 2), round(line_pair_contrast(pupil, 0.5), 1)
    (0.98, 0.2)
    """
    axis = axis_of(orientation)
    target = _target(pupil.grid, float(line_width_um), axis, bars)
    displacement = line_pair_displacement_um(pupil, line_width_um, orientation, bars)
    moved = plane_waves(pupil.grid.axes[axis], np.array([displacement]), pupil.wavelength_um)[0]
    line = _along(pupil.function, axis) @ target.length_spectrum
    intensity = np.abs(target.kernel @ (moved * line)) ** 2
    return michelson(float(intensity[:bars].mean()), float(intensity[bars:].mean()))


def line_pair_displacement_um(
    pupil: ReconstructionPupil, line_width_um: float, orientation: Orientation = "x", bars: int = 5
) -> float:
    """Return the displacement of the imaged lines of a target, perpendicular to the lines, in um.

    It follows from the least-squares slope of the phase, weighted with the target's power spectrum over its
    orders 0 and +-1.

    Parameters
    ----------
    pupil, line_width_um, orientation, bars
        As in :func:`line_pair_contrast`.

    Raises
    ------
    InputError, SamplingError
        As :func:`line_pair_contrast`.
    """
    axis = axis_of(orientation)
    target = _target(pupil.grid, float(line_width_um), axis, bars)
    cosines, across = pupil.grid.axes[axis], target.length_spectrum**2
    weights = target.order_weights * (_along(pupil.valid_on_grid, axis) @ across)
    phases = target.order_weights * (_along(pupil.waves_on_grid, axis) @ across)
    total = weights.sum()
    if total == 0.0:
        raise InputError(
            f"no light of the first orders of {line_width_um:g} µm lines, lit along the axis, gets through "
            "this pupil: choose a field point nearer to the axis"
        )
    offset = cosines - (weights @ cosines) / total
    spread = weights @ offset**2
    return float(-pupil.wavelength_um * (offset @ phases) / spread) if spread > 0.0 else 0.0


def line_pair_profile(
    pupil: ReconstructionPupil,
    line_width_um: float,
    orientation: Orientation = "x",
    bars: int = 5,
    points: int = 401,
) -> tuple[Array, Array]:
    """Return the intensity along the line across the bars, and two line widths beyond the target.

    Parameters
    ----------
    pupil, line_width_um, orientation, bars
        As in :func:`line_pair_contrast`.
    points
        Number of points.

    Returns
    -------
    coordinates_um, intensity : ndarray, shape (points,)
        Coordinates in um, and intensity relative to that of a large bright area.

    Raises
    ------
    InputError, SamplingError
        As :func:`line_pair_contrast`.
    """
    axis = axis_of(orientation)
    target = _target(pupil.grid, float(line_width_um), axis, bars)
    coordinates = _coordinates(line_width_um, bars, points)
    line = _along(pupil.function, axis) @ target.length_spectrum
    waves = plane_waves(pupil.grid.axes[axis], coordinates, pupil.wavelength_um)
    return coordinates, np.abs(waves @ (target.bar_spectrum * line)) ** 2


def line_pair_image(
    pupil: ReconstructionPupil,
    line_width_um: float,
    orientation: Orientation = "x",
    bars: int = 5,
    points: int = 201,
) -> tuple[Array, Array]:
    """Return the image of the target, and of two line widths beyond it on each side.

    Parameters
    ----------
    pupil, line_width_um, orientation, bars
        As in :func:`line_pair_contrast`.
    points
        Number of points along each side.

    Returns
    -------
    coordinates_um : ndarray, shape (points,)
        Coordinates along x, which are also those along y, in um.
    intensity : ndarray, shape (points, points)
        Intensity relative to that of a large bright area; row: y, column: x.

    Raises
    ------
    InputError, SamplingError
        As :func:`line_pair_contrast`.
    """
    axis = axis_of(orientation)
    target = _target(pupil.grid, float(line_width_um), axis, bars)
    spectra = (target.bar_spectrum, target.length_spectrum)
    coordinates = _coordinates(line_width_um, bars, points)
    across, down = (
        plane_waves(pupil.grid.axes[i], coordinates, pupil.wavelength_um) * spectra[int(i != axis)]
        for i in (0, 1)
    )
    return coordinates, np.abs(down @ pupil.function @ across.T) ** 2


def smallest_resolved_line_width_um(
    pupil: ReconstructionPupil, orientation: Orientation = "x", limit: float = 0.2, bars: int = 5
) -> float:
    """Return the smallest line width, in um, down to which all lines reach a contrast.

    The search starts at four times the coherent cut-off, where the period is 4 wavelength / NA, and reduces
    the width by 2 % in each step. It ends at the first width that fails, since finer lines that reach the
    contrast again are false resolution.

    Parameters
    ----------
    pupil, orientation, bars
        As in :func:`line_pair_contrast`.
    limit
        Contrast that counts as resolved.

    Returns
    -------
    float
        Line width in um; infinite if even the widest line is not resolved.

    Raises
    ------
    InputError, SamplingError
        As :func:`line_pair_contrast`.
    """
    if not 0.0 < limit < 1.0:
        raise InputError(f"limit = {limit:g}: must lie between 0 and 1")
    widest = 2.0 * pupil.wavelength_um / pupil.grid.half_width
    widths = accumulate(repeat(0.98), mul, initial=widest)
    kept = resolved_lines(widths, lambda width: line_pair_contrast(pupil, width, orientation, bars) >= limit)
    return float(kept[-1]) if kept else math.inf


@dataclass(frozen=True, eq=False)
class _Target:
    """Quantities that do not depend on the phase of the pupil.

    Attributes
    ----------
    bar_spectrum, length_spectrum : ndarray, shape (samples,)
        Spectrum of the bars along their axis, and of their length along the other axis, times
        spacing / wavelength.
    kernel : ndarray, shape (2 bars - 1, samples)
        Matrix from the pupil, summed over the other axis, to the field at the centres of bars, then of gaps.
    order_weights : ndarray, shape (samples,)
        Power of the bars over their orders 0 and +-1, and 0 beyond.
    """

    bar_spectrum: Array
    length_spectrum: Array
    kernel: ComplexArray
    order_weights: Array


@lru_cache(maxsize=512)
def _target(grid: PupilGrid, width_um: float, axis: int, bars: int) -> _Target:
    validate_positive("line_width_um", width_um)
    validate_whole_number("bars", bars, 2)
    validate_pupil_width(
        grid, (2 * bars + 3) * width_um, f"a target of {bars} bars of {width_um:g} µm, with its edge,"
    )
    cosines = grid.axes[axis]
    bar_spectrum = _bar_spectrum(grid, width_um, axis, bars, whole=False)
    return _Target(
        bar_spectrum=bar_spectrum,
        length_spectrum=_bar_spectrum(grid, width_um, 1 - axis, bars, whole=True),
        kernel=plane_waves(cosines, bar_and_gap_centres(width_um, bars), grid.wavelength_um) * bar_spectrum,
        order_weights=bar_spectrum**2 * (np.abs(cosines) < 0.75 * grid.wavelength_um / width_um),
    )


def _bar_spectrum(grid: PupilGrid, width_um: float, axis: int, bars: int, *, whole: bool) -> Array:
    """Return the spectrum of the bars, or of their length, along one axis, times spacing / wavelength.

    It is the integral of exp(-i k L x) over bars centred at 0, and real since the target is symmetric.
    """
    frequency = grid.axes[axis] / grid.wavelength_um
    scale = grid.spacing / grid.wavelength_um
    if whole:
        length = (2 * bars - 1) * width_um
        return np.asarray(scale * length * np.sinc(frequency * length))
    comb = np.cos(2.0 * np.pi * np.outer(bar_centres(width_um, bars), frequency)).sum(axis=0)
    return np.asarray(scale * width_um * np.sinc(frequency * width_um) * comb)


def _along(values: NDArray, axis: int) -> NDArray:
    """Return values on the grid with rows along `axis`; a product with a column sums over the other axis."""
    return values if axis == 1 else values.T


def _coordinates(width_um: float, bars: int, points: int) -> Array:
    validate_whole_number("points", points, 2)
    half = (bars + 1.5) * width_um
    return np.linspace(-half, half, points)
