"""Illumination of an object (plane, Gaussian, spherical, speckle or measured), and the field stop.

An illumination is a :class:`~wavesim.fields.field.Field` in the object plane. The field behind an object is
its product with the transmission of the object.
"""

from __future__ import annotations

import cmath
import math
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.fft

from lensdesign.common.array_files import array_names, read_arrays
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError, validate_choice, validate_positive
from wavesim.fields.coverage import (
    disc_coverage,
    rectangle,
    rectangle_coverage,
    validate_sampling,
    validate_two_dimensional,
)
from wavesim.fields.field import Field, Grid
from wavesim.fields.files import stored_number
from wavesim.fields.plane_waves import fft_frequencies
from wavesim.fields.sampling_checks import report_loss
from wavesim.targets.patterns import ComplexArray

StopShape = Literal["disc", "square"]


def plane_wave(
    grid: Grid, wavelength_um: float, *, tilt_x_deg: float = 0.0, tilt_y_deg: float = 0.0, index: float = 1.0
) -> Field:
    """Return a plane wave of amplitude 1, with phase 0 at the grid's centre.

    Parameters
    ----------
    grid
        Grid of the object plane, or a meridional line.
    wavelength_um
        Vacuum wavelength (um).
    tilt_x_deg, tilt_y_deg
        Angles (deg) between the axis and the projections of the propagation direction on the x-z and y-z
        planes. Their tangents are the slopes of the direction. On a line, `tilt_x_deg` must be 0.
    index
        Refractive index of the medium.

    Returns
    -------
    Field
        Field on the grid.

    Raises
    ------
    InputError
        If a value is out of range.
    SamplingError
        If the pitch exceeds half the period of the tilted wave along x or y.
    """
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("index", index)
    for name, tilt in (("tilt_x_deg", tilt_x_deg), ("tilt_y_deg", tilt_y_deg)):
        if not abs(tilt) < 90.0:
            raise InputError(f"{name} = {tilt!r}: must lie between -90 and 90°")
    if grid.is_line and tilt_x_deg != 0.0:
        raise InputError(f"tilt_x_deg = {tilt_x_deg:g}: a meridional line has no x; give 0")
    slopes = math.tan(math.radians(tilt_x_deg)), math.tan(math.radians(tilt_y_deg))
    length = math.hypot(1.0, *slopes)
    cycles_x, cycles_y = (1e3 * index / wavelength_um * slope / length for slope in slopes)
    steepest = max(abs(cycles_x), abs(cycles_y))
    _check_pitch(grid, steepest, f"tilt_x_deg = {tilt_x_deg:g}, tilt_y_deg = {tilt_y_deg:g}: the wave has")
    down = np.exp(2j * math.pi * cycles_y * (grid.y_mm - grid.centre_mm[1]))
    if grid.is_line:
        return Field(grid, down, wavelength_um, index)
    across = np.exp(2j * math.pi * cycles_x * (grid.x_mm - grid.centre_mm[0]))
    return Field(grid, np.outer(down, across), wavelength_um, index)


def _check_pitch(grid: Grid, cycles_per_mm: float, light: str, at: str = "", remedy: str = "") -> None:
    """Raise a SamplingError if a grid does not sample the highest frequency of light."""
    if cycles_per_mm * grid.pitch_mm >= 0.5:
        raise SamplingError(
            f"{light} {cycles_per_mm:.4g} cycles/mm{at}, too many for a pitch of "
            f"{1e3 * grid.pitch_mm:.4g} µm; use a pitch below {500.0 / cycles_per_mm:.4g} µm{remedy}"
        )


def gaussian_beam(
    grid: Grid, wavelength_um: float, waist_radius_mm: float, beyond_waist_mm: float = 0.0
) -> Field:
    """Return a paraxial Gaussian beam along the axis through the grid's centre, of amplitude 1 in the waist.

    Parameters
    ----------
    grid
        Grid of the object plane, or a meridional line.
    wavelength_um
        Vacuum wavelength (um).
    waist_radius_mm
        Radius (mm) at which the intensity in the waist is 1/e^2 of that on the axis.
    beyond_waist_mm
        Distance of the grid behind the waist (mm); negative where the beam converges. The phase exp(i k z) of
        a plane wave over this distance is omitted.

    Returns
    -------
    Field
        Field on the grid.

    Raises
    ------
    InputError
        If a value is out of range, or the waist is too narrow for a paraxial beam.
    SamplingError
        If the waist is narrower than two samples.
    """
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("waist_radius_mm", waist_radius_mm)
    if not math.isfinite(beyond_waist_mm):
        raise InputError(f"beyond_waist_mm = {beyond_waist_mm!r}: must be finite")
    # Smallest waist radius in wavelengths. The beam then diverges by 9 degrees, the limit of the paraxial
    # formula.
    smallest_waist = 2.0
    smallest = smallest_waist * 1e-3 * wavelength_um
    if waist_radius_mm < smallest:
        raise InputError(
            f"waist_radius_mm = {waist_radius_mm:g}: must be {smallest:.4g} or more for a paraxial beam"
        )
    # Propagation does not change the width of the spectrum, so that the waist determines the sampling.
    validate_sampling(grid, 1e3 * waist_radius_mm, "a Gaussian waist")
    wavenumber = 2e3 * math.pi / wavelength_um
    spread = complex(waist_radius_mm**2, 2.0 * beyond_waist_mm / wavenumber)
    y, x = grid.y_mm - grid.centre_mm[1], grid.x_mm - grid.centre_mm[0]
    down = cmath.sqrt(waist_radius_mm**2 / spread) * np.exp(-(y**2) / spread)
    if grid.is_line:
        return Field(grid, down, wavelength_um)
    across = cmath.sqrt(waist_radius_mm**2 / spread) * np.exp(-(x**2) / spread)
    return Field(grid, np.outer(down, across), wavelength_um)


def point_source(grid: Grid, wavelength_um: float, distance_mm: float, *, index: float = 1.0) -> Field:
    """Return the spherical wave of a point source on the axis through the grid's centre.

    At the grid's centre the amplitude is 1 and the phase 0.

    Parameters
    ----------
    grid
        Grid of the object plane, or a meridional line.
    wavelength_um
        Vacuum wavelength (um).
    distance_mm
        Distance (mm) of the source before the grid. Where it is negative, the light converges to a point
        behind the grid.
    index
        Refractive index of the medium.

    Returns
    -------
    Field
        Field on the grid.

    Raises
    ------
    InputError
        If a value is out of range.
    SamplingError
        If the pitch exceeds half the period of the wave along x or y at the grid's border.

    Examples
    --------
    The wave has the curvature of its distance:

    >>> import numpy as np
    >>> from wavesim import Grid
    >>> from wavesim.targets import point_source
    >>> light = point_source(Grid((65,), 1e-3, 0.0), 0.5, 4.0)
    >>> phase_rad = np.unwrap(np.angle(light.values))
    >>> sag_mm = (phase_rad[-1] - phase_rad[32]) * 0.5e-3 / (2.0 * np.pi)
    >>> round(0.032**2 / (2.0 * sag_mm), 3)
    4.0
    """
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("index", index)
    if not (math.isfinite(distance_mm) and distance_mm != 0.0):
        raise InputError(f"distance_mm = {distance_mm!r}: must be finite, and not 0")
    widest = max(grid.half_widths_mm)
    steepest = 1e3 * index / wavelength_um * widest / math.hypot(widest, distance_mm)
    light = f"distance_mm = {distance_mm:g}: the light of the point source has"
    _check_pitch(grid, steepest, light, " at the border", ", or a greater distance")
    y, x = grid.y_mm - grid.centre_mm[1], grid.x_mm - grid.centre_mm[0]
    squared = y**2 if grid.is_line else y[:, None] ** 2 + x[None, :] ** 2
    from_source_mm = np.sqrt(squared + distance_mm**2)
    # The difference of both lengths, without cancellation.
    path_mm = np.copysign(squared / (from_source_mm + abs(distance_mm)), distance_mm)
    phasor = np.exp(2e3j * math.pi * index / wavelength_um * path_mm)
    return Field(grid, abs(distance_mm) / from_source_mm * phasor, wavelength_um, index)


def speckle(grid: Grid, wavelength_um: float, numerical_aperture: float, seed: int = 0) -> Field:
    """Return fully developed speckle: light of a diffuser that fills a cone of directions evenly.

    Plane waves within the cone have independent normal amplitudes. Their power falls to zero over the outer
    4 % of the numerical aperture. The mean intensity of many seeds is 1. A speckle grain is about the
    wavelength over twice the numerical aperture wide.

    Aperture, wavelength and seed determine the light at each point (x, y) of the object plane. Grids of any
    pitch and extent sample the same light. For another wavelength or aperture, the light of a seed is
    magnified by the ratio of wavelength and aperture, about the axis of the lens.

    Parameters
    ----------
    grid
        Grid of the object plane, or a meridional line.
    wavelength_um
        Vacuum wavelength (um).
    numerical_aperture
        Numerical aperture of the cone.
    seed
        Seed of the amplitudes.

    Returns
    -------
    Field
        Field on the grid.

    Raises
    ------
    InputError
        If a value is out of range.
    SamplingError
        If the pitch exceeds half the period of the steepest waves.

    References
    ----------
    J. W. Goodman, "Speckle Phenomena in Optics" (Roberts, 2007).

    Examples
    --------
    Intensities have a contrast of 1. A finer grid has the same light:

    >>> import numpy as np
    >>> from wavesim import Grid
    >>> from wavesim.targets import speckle
    >>> light = speckle(Grid((401, 401), 5e-4, 0.0), 0.5, 0.3).values
    >>> intensity = np.abs(light) ** 2
    >>> round(float(intensity.mean()), 1), round(float(intensity.std()), 1)
    (1.0, 1.0)
    >>> finer = speckle(Grid((201, 201), 2.5e-4, 0.0), 0.5, 0.3).values
    >>> np.allclose(finer[::2, ::2], light[150:251, 150:251])
    True
    """
    validate_positive("wavelength_um", wavelength_um)
    if not 0.0 < numerical_aperture < 1.0:
        raise InputError(f"numerical_aperture = {numerical_aperture!r}: must lie between 0 and 1")
    steepest = 1e3 * numerical_aperture / wavelength_um
    _check_pitch(grid, steepest, f"numerical_aperture = {numerical_aperture:g}: its waves have up to")
    if steepest * max(grid.shape) * grid.pitch_mm < 0.5:
        raise InputError(
            f"numerical_aperture = {numerical_aperture:g}: its speckle grains are larger than the grid"
        )
    axes = (grid.y_mm,) if grid.is_line else (grid.y_mm, grid.x_mm)
    nodes_per_mm = NODES_PER_PERIOD * steepest
    return Field(grid, _filtered_noise([nodes_per_mm * axis for axis in axes], seed), wavelength_um)


NODES_PER_PERIOD = 4
"""Nodes of the random numbers of speckle per period of the steepest waves."""

FILTER_RADIUS, FILTER_SHAPE = 256, 7.9
"""Radius, in nodes, of the filter that passes the cone, and shape of its Kaiser window. The window damps
waves beyond the cone to 1e-4, and makes the border of the cone 4 % of its radius wide."""

INTERPOLATION_RADIUS, INTERPOLATION_SHAPE = 8, 12.0
"""Radius, in nodes, of the interpolation from nodes to samples, and shape of its Kaiser window. The errors
are below 1e-5."""

NOISE_TILE = 64
"""Nodes along each side of a tile, whose random numbers have a generator of their own."""


def _filtered_noise(positions: Sequence[Array], seed: int) -> ComplexArray:
    """Return filtered complex white noise at positions along one or two axes, in units of the nodes.

    The noise of a node depends only on its index. Filter and interpolation have a finite radius, so that a
    value depends only on its own position.
    """
    import scipy.signal

    # Inclusive indices of the nodes between which the samples are interpolated.
    spans = [
        (math.floor(axis[0]) - INTERPOLATION_RADIUS, math.ceil(axis[-1]) + INTERPOLATION_RADIUS)
        for axis in positions
    ]
    noise = _noise([(first - FILTER_RADIUS, last + FILTER_RADIUS) for first, last in spans], seed)
    values = scipy.signal.oaconvolve(noise, _cone_filter(len(positions)), mode="valid")
    for axis, (first, _), count in zip(positions, spans, noise.shape, strict=True):
        # Each product interpolates the first axis and moves it to the end.
        values = (_interpolation(axis - first, count - 2 * FILTER_RADIUS) @ values).T
    return np.ascontiguousarray(values)


def _noise(spans: Sequence[tuple[int, int]], seed: int) -> ComplexArray:
    """Return complex normal numbers of variance 1 for nodes of inclusive ranges of indices."""
    tiles = [range(first // NOISE_TILE, last // NOISE_TILE + 1) for first, last in spans]
    numbers = np.empty([NOISE_TILE * len(indices) for indices in tiles], complex)
    for place in np.ndindex(*(len(indices) for indices in tiles)):
        # Seeds are not negative: even numbers count tiles from 0 upwards, odd ones from -1 downwards.
        indices = (indices[n] for indices, n in zip(tiles, place, strict=True))
        key = [2 * index if index >= 0 else -2 * index - 1 for index in indices]
        random = np.random.default_rng([seed, *key])
        real, imaginary = math.sqrt(0.5) * random.standard_normal((2,) + (NOISE_TILE,) * len(spans))
        numbers[tuple(slice(NOISE_TILE * n, NOISE_TILE * (n + 1)) for n in place)] = real + 1j * imaginary
    return numbers[
        tuple(
            slice(first - NOISE_TILE * indices[0], last + 1 - NOISE_TILE * indices[0])
            for (first, last), indices in zip(spans, tiles, strict=True)
        )
    ]


@cache
def _cone_filter(dimensions: int) -> Array:
    """Return the filter of a disc of frequencies, or of a line's frequencies, with a squared sum of 1."""
    from scipy.special import j1

    nodes = np.arange(-FILTER_RADIUS, FILTER_RADIUS + 1.0)
    radius = abs(nodes) if dimensions == 1 else np.hypot(nodes[:, None], nodes[None, :])
    # The border of the cone is 4 % wide and ends at the numerical aperture.
    cycles_per_node = 0.98 / NODES_PER_PERIOD
    argument = 2.0 * np.pi * cycles_per_node * np.maximum(radius, 1e-9)
    ideal = (np.sin(argument) if dimensions == 1 else 2.0 * j1(argument)) / argument
    window = np.i0(FILTER_SHAPE * np.sqrt(np.maximum(1.0 - (radius / FILTER_RADIUS) ** 2, 0.0)))
    values = ideal * window * (radius <= FILTER_RADIUS)
    return np.asarray(values / np.linalg.norm(values))


def _interpolation(positions: Array, nodes: int) -> Any:
    """Return the sparse matrix of an interpolation from nodes 0, 1, ... to positions between them."""
    from scipy.sparse import csr_array

    taps = np.arange(1 - INTERPOLATION_RADIUS, INTERPOLATION_RADIUS + 1)
    columns = np.floor(positions).astype(int)[:, None] + taps
    offsets = positions[:, None] - columns
    window = np.i0(
        INTERPOLATION_SHAPE * np.sqrt(np.maximum(1.0 - (offsets / INTERPOLATION_RADIUS) ** 2, 0.0))
    )
    weights = np.sinc(offsets) * window / np.i0(INTERPOLATION_SHAPE)
    starts = len(taps) * np.arange(len(positions) + 1)
    return csr_array((weights.ravel(), columns.ravel(), starts), shape=(len(positions), nodes))


def measured_field(
    path: str | os.PathLike[str],
    grid: Grid,
    wavelength_um: float,
    pitch_um: float | None = None,
) -> Field:
    """Read a complex field from a file, and interpolate it on a grid by cubic splines.

    The centre of the file's samples lies at the grid's centre.

    Parameters
    ----------
    path
        An .npy file with one complex array (rows along y, columns along x), or an .npz file with the array
        `values`, and optionally the numbers `pitch_um` and `wavelength_um`.
    grid
        Grid of the object plane, which the file's samples must cover.
    wavelength_um
        Vacuum wavelength (um). If the file states a wavelength, it must be the same.
    pitch_um
        Pitch of the file's samples (um); required unless the file states it.

    Returns
    -------
    Field
        Field on the grid.

    Raises
    ------
    InputError
        If the file cannot be read, contains no complex field, or covers less than the grid.
    SamplingError
        If more than 1 % of the field's energy has frequencies too high for the grid or the interpolation.

    Warns
    -----
    SamplingWarning
        If more than 0.001 % of the energy has such frequencies.
    """
    validate_two_dimensional(grid)
    validate_positive("wavelength_um", wavelength_um)
    values, stated = _read_field(Path(path))
    pitch = _pitch_um(Path(path), stated, pitch_um)
    if "wavelength_um" in stated and not math.isclose(stated["wavelength_um"], wavelength_um, rel_tol=1e-6):
        raise InputError(
            f"measured field {path}: states wavelength_um = {stated['wavelength_um']:g}; must be "
            f"{wavelength_um:g}"
        )
    rows, columns = values.shape
    if (rows, columns) == grid.shape and math.isclose(1e-3 * pitch, grid.pitch_mm, rel_tol=1e-9):
        return Field(grid, values, wavelength_um)
    source = Grid((rows, columns), 1e-3 * pitch, grid.z_mm, grid.centre_mm)
    for name, have, need in (("x", source.x_mm, grid.x_mm), ("y", source.y_mm, grid.y_mm)):
        if need[-1] - need[0] > (have[-1] - have[0]) * (1.0 + 1e-9):
            raise InputError(
                f"measured field {path}: its samples span {have[-1] - have[0]:.4g} mm along {name}; the "
                f"grid needs {need[-1] - need[0]:.4g} mm; give a smaller grid or a larger measurement"
            )
    _check_frequencies(values, source, grid)
    return Field(grid, _splined(values, source, grid), wavelength_um)


def field_stop(
    grid: Grid,
    shape: StopShape,
    width_mm: float,
    edge_mm: float = 0.0,
    at_mm: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return the transmission of a field stop.

    Parameters
    ----------
    grid
        Grid of the object plane.
    shape
        "disc" or "square".
    width_mm
        Diameter or side (mm). A soft edge has a transmission of one half there.
    edge_mm
        Width (mm) of a soft edge with the profile of a raised cosine; 0 for a hard edge, which is integrated
        exactly over the cells.
    at_mm
        Centre (x, y) of the stop relative to the grid's centre (mm).

    Returns
    -------
    ndarray, shape (ny, nx)
        Transmission of each cell, 0 to 1.

    Raises
    ------
    InputError
        If a value is out of range, or the stop with its edge reaches beyond the grid.
    SamplingError
        If the stop or its soft edge is narrower than two samples.
    """
    validate_two_dimensional(grid)
    validate_positive("width_mm", width_mm)
    validate_choice("field stop shape", shape, ("disc", "square"))
    if not 0.0 <= edge_mm <= width_mm:
        raise InputError(f"edge_mm = {edge_mm!r}: must lie between 0 and width_mm = {width_mm:g}")
    widest = 2.0 * min(grid.half_widths_mm)
    if width_mm + edge_mm > widest * (1.0 + 1e-9):
        raise InputError(
            f"field stop of width_mm = {width_mm:g}, edge_mm = {edge_mm:g}: wider than the "
            f"grid's {widest:.4g} mm"
        )
    middle = grid.centre_mm[0] + at_mm[0], grid.centre_mm[1] + at_mm[1]
    for axis, place, half_width in zip("xy", at_mm, reversed(grid.half_widths_mm), strict=True):
        if not abs(place) + 0.5 * (width_mm + edge_mm) <= half_width * (1.0 + 1e-9):
            raise InputError(
                f"field stop of width_mm = {width_mm:g}, edge_mm = {edge_mm:g} at {at_mm[0]:g}, "
                f"{at_mm[1]:g} mm: reaches beyond the grid's {half_width:.4g} mm along {axis}"
            )
    validate_sampling(grid, 1e3 * width_mm, "a field stop")
    if edge_mm == 0.0:
        if shape == "disc":
            return disc_coverage(grid, 0.5 * width_mm, at_mm)
        return rectangle_coverage(grid, [rectangle(middle, width_mm, width_mm)])
    validate_sampling(grid, 1e3 * edge_mm, "a soft edge")
    x, y = (grid.x_mm - middle[0])[None, :], (grid.y_mm - middle[1])[:, None]
    half = 0.5 * width_mm
    if shape == "disc":
        return _soft(np.hypot(x, y), half, edge_mm)
    return _soft(abs(y), half, edge_mm) * _soft(abs(x), half, edge_mm)


def _soft(distance: Array, half: float, edge: float) -> Array:
    return np.asarray(0.5 - 0.5 * np.sin(np.pi * np.clip((distance - half) / edge, -0.5, 0.5)))


def _read_field(path: Path) -> tuple[ComplexArray, dict[str, float]]:
    """Return the complex array of a file, and the numbers stored with it."""
    held = read_arrays(path, named="the measured field", only=("values", "pitch_um", "wavelength_um"))
    if "values" not in held:
        names = sorted(array_names(path))
        raise InputError(f"measured field {path}: has no array `values`; it contains {names}")
    values = held["values"]
    if values.ndim != 2 or min(values.shape) < 4 or not np.iscomplexobj(values):
        raise InputError(
            f"measured field {path}: has {values.dtype} values of shape {values.shape}; give a complex array "
            "(ny, nx) of at least 4 x 4"
        )
    if not np.all(np.isfinite(values)):
        raise InputError(f"measured field {path}: has values that are not finite")
    named = [key for key in ("pitch_um", "wavelength_um") if key in held]
    return np.asarray(values, complex), {
        key: stored_number(held, key, f"measured field {path}") for key in named
    }


def _pitch_um(path: Path, stated: dict[str, float], given: float | None) -> float:
    pitch = stated.get("pitch_um") if given is None else given
    if pitch is None:
        raise InputError(f"measured field {path}: does not state its pitch; give pitch_um")
    validate_positive("pitch_um", pitch)
    if "pitch_um" in stated and not math.isclose(stated["pitch_um"], pitch, rel_tol=1e-6):
        raise InputError(
            f"measured field {path}: states pitch_um = {stated['pitch_um']:g}, not the given {pitch:g}"
        )
    return pitch


def _check_frequencies(values: ComplexArray, source: Grid, grid: Grid) -> None:
    """Warn of, or refuse, frequencies that the interpolation or the grid would lose."""
    # A window keeps the borders of the measurement from looking like detail.
    window = np.outer(*(np.hanning(n + 2)[1:-1] for n in values.shape))
    power = abs(scipy.fft.fftn(values * window, workers=-1)) ** 2
    total = float(np.sum(power))
    if total == 0.0:
        raise InputError("the measured field is dark: all values are 0")
    cycles = fft_frequencies(source.shape, source.pitch_mm)
    # Fraction of the Nyquist band in which cubic spline interpolation is accurate.
    interpolated_band = 0.5
    limit = min(interpolated_band * 0.5 / source.pitch_mm, 0.5 / grid.pitch_mm)
    fine = (abs(cycles[0]) > limit) | (abs(cycles[1]) > limit)
    report_loss(
        float(np.sum(power[fine])) / total,
        f"lies above {limit:.4g} cycles/mm, too high for interpolation from a pitch of "
        f"{1e3 * source.pitch_mm:.4g} µm to a pitch of {1e3 * grid.pitch_mm:.4g} µm",
        "sample the measurement more finely, or use a smaller pitch or the measurement's own grid",
    )


def _splined(values: ComplexArray, source: Grid, grid: Grid) -> ComplexArray:
    from scipy.interpolate import RectBivariateSpline

    y, x = (
        np.clip(need, have[0], have[-1])
        for need, have in ((grid.y_mm, source.y_mm), (grid.x_mm, source.x_mm))
    )
    real, imaginary = (
        RectBivariateSpline(source.y_mm, source.x_mm, part, kx=3, ky=3)(y, x)
        for part in (values.real, values.imag)
    )
    return np.asarray(real + 1j * imaginary)
