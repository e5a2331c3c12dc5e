"""Test objects on a grid: a Siemens star, phase pads, pictures from files, and their band limit.

An object is given by its complex transmission with one value for each cell of a plane grid, the mean over the
cell. A cell that an edge crosses therefore has a value between those on its two sides. Rows lie along y,
ascending, and columns along x.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import (
    InputError,
    SamplingError,
    validate_choice,
    validate_positive,
    validate_whole_number,
)
from wavesim.fields.coverage import (
    ROUNDING,
    Rectangle,
    disc_coverage,
    half_plane_coverage,
    rectangle,
    rectangle_coverage,
    validate_inside,
    validate_sampling,
    validate_two_dimensional,
)
from wavesim.fields.field import Grid
from wavesim.fields.picture_files import PictureFile
from wavesim.fields.plane_waves import fft_frequencies
from wavesim.runtime.threads import row_blocks
from wavesim.targets.bars import bar_rectangles

ComplexArray = NDArray[np.complex128]
Polarity = Literal["bright", "dark"]


def with_polarity(coverage: Array, polarity: Polarity) -> ComplexArray:
    """Return the transmission of opaque shapes on a bright field, or of clear shapes on a dark field.

    Parameters
    ----------
    coverage
        Covered fraction of each cell, 0 to 1.
    polarity
        "bright" for opaque shapes on a bright field, "dark" for clear shapes on a dark field.
    """
    validate_choice("polarity", polarity, ("bright", "dark"))
    return np.asarray(coverage if polarity == "dark" else 1.0 - coverage, complex)


def siemens_star(
    grid: Grid, spokes: int, radius_mm: float, inner_radius_mm: float, polarity: Polarity = "dark"
) -> ComplexArray:
    """Return a ring of spokes at the grid's centre. Spokes are as wide as the gaps; the first lies along x.

    Straight edges and circles are integrated exactly over each cell. In a cell where a spoke's edge meets a
    circle, the product of both coverages is used.

    Parameters
    ----------
    grid
        Grid of the object plane.
    spokes
        Number of spokes, at least 2.
    radius_mm, inner_radius_mm
        Outer and inner radius of the ring. At the inner radius, spokes are pi inner_radius / spokes wide.
    polarity
        "dark" for clear spokes on a dark field, "bright" for opaque spokes on a bright field.

    Returns
    -------
    ndarray, shape (ny, nx)
        Complex transmission of each cell.

    Raises
    ------
    InputError
        If a value is out of range, or the star reaches beyond the grid.
    SamplingError
        If the inner ends of the spokes are narrower than two samples.
    """
    validate_two_dimensional(grid)
    validate_whole_number("spokes", spokes, 2)
    validate_positive("inner_radius_mm", inner_radius_mm)
    if not inner_radius_mm < radius_mm < math.inf:
        raise InputError(
            f"radius_mm = {radius_mm!r}: must be finite and above inner_radius_mm = {inner_radius_mm!r}"
        )
    validate_inside(grid, rectangle(grid.centre_mm, 2.0 * radius_mm, 2.0 * radius_mm))
    # The width of a spoke's inner end is the chord across it.
    validate_sampling(
        grid, 2e3 * inner_radius_mm * math.sin(0.5 * math.pi / spokes), "the spokes' inner ends"
    )
    x = (grid.x_mm - grid.centre_mm[0])[None, :]
    y = (grid.y_mm - grid.centre_mm[1])[:, None]
    star = disc_coverage(grid, radius_mm)
    star -= disc_coverage(grid, inner_radius_mm)
    for rows in row_blocks(len(y)):
        star[rows] *= _spokes(x, y[rows], math.pi / spokes, grid.pitch_mm)
    return with_polarity(star, polarity)


def _spokes(x: Array, y: Array, step: float, pitch_mm: float) -> Array:
    """Return the covered fraction of each cell for spokes of angular width `step` and equal gaps (rad)."""
    # Each spoke has two edges. The nearest one is half a step from a multiple of the step.
    nearest = np.floor(np.arctan2(y, x) / step)
    edge = (nearest + 0.5) * step
    distance = y * np.cos(edge) - x * np.sin(edge)
    beyond = half_plane_coverage(distance / pitch_mm, np.cos(edge), np.sin(edge))
    return np.where(nearest % 2 == 0, 1.0 - beyond, beyond)


def phase_pads(
    pad_um: float, phase_rad: float, levels: int, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> tuple[tuple[Rectangle, float], ...]:
    """Return rectangles and phases (rad) of the pads of :func:`phase_target`."""
    validate_positive("pad_um", pad_um)
    if not math.isfinite(phase_rad):
        raise InputError(f"phase_rad = {phase_rad!r}: must be finite")
    validate_whole_number("levels", levels, 1)
    bars = bar_rectangles(1e-3 * pad_um, levels, "x", centre_mm, 1e-3 * pad_um)
    return tuple((bar, phase_rad * (level + 1) / levels) for level, bar in enumerate(bars))


def phase_target(
    grid: Grid,
    pad_um: float,
    phase_rad: float,
    levels: int = 4,
    profile: Literal["binary", "smooth"] = "binary",
) -> ComplexArray:
    """Return clear square pads in a row along x that delay the light in equal steps.

    Gaps are as wide as the pads.

    Parameters
    ----------
    grid
        Grid of the object plane; the row is centred on it.
    pad_um
        Side of a pad (um).
    phase_rad
        Phase of the last pad (rad). Pad m of `levels` has m / levels of it, and the field around has 0.
    levels
        Number of pads.
    profile
        "binary" for steps at the borders of the pads. "smooth" for a profile cos^2 along x and y, which has
        the phase at the centre of the pad and is sampled at the cell centres.

    Returns
    -------
    ndarray, shape (ny, nx)
        Complex transmission of each cell.

    Raises
    ------
    InputError
        If a value is out of range, or the pads reach beyond the grid.
    SamplingError
        If a pad is narrower than two samples, or the phase of a smooth pad changes by more than pi between
        samples.
    """
    validate_choice("profile", profile, ("binary", "smooth"))
    pads = phase_pads(pad_um, phase_rad, levels, grid.centre_mm)
    validate_sampling(grid, pad_um, "phase pads")
    pitch_um = 1e3 * grid.pitch_mm
    if profile == "smooth" and abs(phase_rad) * pitch_um > pad_um:
        # The steepest slope of phase cos^2(pi x / pad) is pi phase / pad.
        raise SamplingError(
            f"phase_rad = {phase_rad:g}: on pads of {pad_um:g} µm it changes by more than pi within the "
            f"grid's pitch of {pitch_um:.4g} µm; give a pitch below {pad_um / abs(phase_rad):.4g} µm"
        )
    transmission = np.ones(grid.shape, complex)
    for pad, phase in pads:
        coverage = rectangle_coverage(grid, [pad])
        if profile == "binary":
            transmission += np.expm1(1j * phase) * coverage
        else:
            x = (grid.x_mm - 0.5 * (pad.left_mm + pad.right_mm))[None, :]
            y = (grid.y_mm - 0.5 * (pad.low_mm + pad.high_mm))[:, None]
            side = 1e-3 * pad_um
            inside = (abs(x) < 0.5 * side) & (abs(y) < 0.5 * side)
            bump = (np.cos(np.pi * x / side) * np.cos(np.pi * y / side)) ** 2
            transmission *= np.exp(1j * phase * np.where(inside, bump, 0.0))
    return transmission


def picture_target(
    path: str | os.PathLike[str],
    grid: Grid,
    pixel_um: float,
    quantity: Literal["intensity", "amplitude", "phase"] = "intensity",
    phase_rad: float = math.pi,
    finer: Literal["refuse", "average"] = "refuse",
    channel: int | None = None,
) -> ComplexArray:
    """Return the transmission of a picture at the grid's centre, with its pixels integrated over the cells.

    The first row lies at the smallest y. Outside of the picture the object is opaque, or clear for a phase.

    Parameters
    ----------
    path
        Path of a PNG, TIFF or other file that Pillow reads; see :func:`read_grey`.
    grid
        Grid of the object plane.
    pixel_um
        Side of a pixel on the object (um).
    quantity
        Quantity that the grey values represent, as fractions of full scale (255 or 65535).
    phase_rad
        Phase of full scale (rad), for ``quantity="phase"``.
    finer
        Treatment of pixels that are finer than the pitch: "refuse" raises an error, "average" loses detail.
    channel
        Index of a channel of a colour picture (red, green, blue); default: its luma.

    Returns
    -------
    ndarray, shape (ny, nx)
        Complex transmission of each cell.

    Raises
    ------
    InputError
        If the file is no such picture, a value is out of range, or the picture is larger than the grid.
    SamplingError
        If pixels are smaller than the pitch and `finer` is "refuse".
    """
    validate_two_dimensional(grid)
    validate_positive("pixel_um", pixel_um)
    validate_choice("quantity", quantity, ("intensity", "amplitude", "phase"))
    validate_choice("finer", finer, ("refuse", "average"))
    if not math.isfinite(phase_rad):
        raise InputError(f"phase_rad = {phase_rad!r}: must be finite")
    grey = read_grey(path, channel)
    pixel = 1e-3 * pixel_um
    rows, columns = grey.shape
    if finer == "refuse" and pixel < grid.pitch_mm * ROUNDING:
        raise SamplingError(
            f"pixel_um = {pixel_um:g}: finer than the grid's pitch of {1e3 * grid.pitch_mm:.4g} µm; "
            "use larger pixels or a smaller pitch"
        )
    validate_inside(grid, rectangle(grid.centre_mm, columns * pixel, rows * pixel))
    if quantity == "phase":
        shown = np.expm1(1j * phase_rad * grey)
    else:
        shown = (np.sqrt(grey) if quantity == "intensity" else grey).astype(complex)
    down, across = (_overlaps(count, grid, pixel, n) for count, n in zip(grid.shape, grey.shape, strict=True))
    return np.asarray(down @ shown @ across.T + (quantity == "phase"))


def picture_pixel(
    shape: tuple[int, int], stop_mm: float, pixel_um: float | None = None, width_mm: float | None = None
) -> float:
    """Return the side of a picture's pixel on the object (um), so that the picture fits a field stop.

    Parameters
    ----------
    shape
        Number of rows and columns.
    stop_mm
        Diameter of the round field stop.
    pixel_um, width_mm
        Side of a pixel, or width of the picture. Default: the corners of the picture touch the stop.

    Raises
    ------
    InputError
        If both are given, one is not positive, or the picture is larger than the stop.
    """
    rows, columns = shape
    largest_um = 1e3 * stop_mm / math.hypot(rows, columns)
    if pixel_um is not None and width_mm is not None:
        raise InputError("picture_pixel_um, picture_width_mm: give only one of them")
    if width_mm is not None:
        name, given, um = "picture_width_mm", width_mm, 1e3 / columns
    elif pixel_um is not None:
        name, given, um = "picture_pixel_um", pixel_um, 1.0
    else:
        return largest_um
    validate_positive(name, given)
    if given * um > largest_um * (1.0 + 1e-9):
        raise InputError(
            f"{name} = {given:g}: the picture's {columns} x {rows} pixels reach beyond the field stop of "
            f"{stop_mm:g} mm; give at most {largest_um / um:.4g}, which is the default"
        )
    return given * um


def read_grey(path: str | os.PathLike[str], channel: int | None = None) -> Array:
    """Return grey values of a picture as fractions of full scale (0 is black), shape (rows, columns).

    A single channel of 8 or 16 bits is used unchanged. Colours and palettes are converted to luma (ITU-R
    BT.601). The picture is rotated by the orientation in its file, and inverted if the file states that white
    is zero.

    Parameters
    ----------
    path
        The file.
    channel
        Index of a channel (red, green, blue) that is read instead of the luma of colours.

    Raises
    ------
    InputError
        If the file cannot be read, or does not hold a single opaque picture of these kinds.
    """
    file = Path(path)
    picture = PictureFile(file, "the picture").single_picture(channel)
    is_black_and_white = picture.values.dtype == np.bool_
    if not (picture.has_counts or is_black_and_white) or not picture.is_opaque:
        raise InputError(f"picture {file}: {picture}; must be grey or opaque colours, of at most 16 bits")
    grey = picture.values / picture.full_scale
    return np.asarray(1.0 - grey if picture.white_is_zero else grey, float)


def band_limit(
    values: ComplexArray, grid: Grid, wavelength_um: float, numerical_aperture: float
) -> ComplexArray:
    """Return an object, lit along the axis, band-limited to a numerical aperture.

    Spatial frequencies outside the circle of radius numerical_aperture / wavelength are removed by a discrete
    Fourier transform, which treats the grid as periodic (Goodman, Introduction to Fourier Optics, chapter 6).

    Parameters
    ----------
    values : ndarray, shape (ny, nx)
        Complex transmission.
    grid
        Grid of the object plane.
    wavelength_um, numerical_aperture
        Wavelength (um) and numerical aperture of the band limit.

    Returns
    -------
    ndarray, shape (ny, nx)
        Band-limited transmission.

    Raises
    ------
    InputError
        If a value is out of range, or `values` does not have the grid's shape.
    SamplingError
        If the grid is too coarse for the aperture.
    """
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("numerical_aperture", numerical_aperture)
    if values.shape != grid.shape:
        raise InputError(f"values have shape {values.shape}: must have the grid's shape, {grid.shape}")
    limit = 1e3 * numerical_aperture / wavelength_um
    if grid.pitch_mm * ROUNDING > 0.5 / limit:
        raise SamplingError(
            f"numerical_aperture = {numerical_aperture:g}: requires a pitch of {500.0 / limit:.4g} µm or "
            f"less at {wavelength_um:g} µm; the grid's pitch is {1e3 * grid.pitch_mm:.4g} µm"
        )
    squared = sum(across**2 for across in fft_frequencies(grid.shape, grid.pitch_mm))
    return np.asarray(
        scipy.fft.ifftn(np.where(squared <= limit**2, scipy.fft.fftn(values, workers=-1), 0.0), workers=-1)
    )


def _overlaps(count: int, grid: Grid, pixel_mm: float, pixels: int) -> Array:
    """Return the fraction of each cell (row) that each pixel (column) covers; both are centred."""
    cells = grid.pitch_mm * (np.arange(count + 1) - 0.5 * count)
    borders = pixel_mm * (np.arange(pixels + 1) - 0.5 * pixels)
    low = np.maximum(cells[:-1, None], borders[None, :-1])
    high = np.minimum(cells[1:, None], borders[None, 1:])
    return np.asarray(np.maximum(high - low, 0.0) / grid.pitch_mm)
