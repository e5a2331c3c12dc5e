"""Test objects on a grid: bars, a Siemens star, phase pads, a picture from a file; and their band limit.

An object is its complex transmission, one value for each cell of a plane grid: the mean over the cell, so
that an edge across a cell leaves a value between those on its two sides. Rows lie along y, ascending, columns
along x.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Literal

import numpy as np
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
    bar_rectangles,
    disc_coverage,
    half_plane_coverage,
    rectangle,
    rectangle_coverage,
    validate_inside,
    validate_sampling,
    validate_two_dimensional,
)
from wavesim.fields.field import Grid, Orientation
from wavesim.fields.picture_files import COUNT_MODES, PictureFile
from wavesim.fields.plane_waves import fft_frequencies
from wavesim.runtime.arrays import fftn, ifftn
from wavesim.runtime.threads import row_blocks

ComplexArray = NDArray[np.complex128]
Ground = Literal["bright", "dark"]

LUMA_MODES = ("1", "LA", "P", "RGB", "RGBA")
"""Pillow's names for kinds of picture whose luma keeps what they show."""


def on_ground(coverage: Array, ground: Ground) -> ComplexArray:
    """Transmission of opaque shapes on a bright ground, or of clear ones on a dark ground."""
    validate_choice("ground", ground, ("bright", "dark"))
    return np.asarray(coverage if ground == "dark" else 1.0 - coverage, complex)


def line_pairs(
    grid: Grid, line_width_um: float, orientation: Orientation = "x", bars: int = 5, ground: Ground = "dark"
) -> ComplexArray:
    """A square of bars about the grid's centre, as long as they are wide together with their gaps.

    Parameters
    ----------
    grid
        A plane.
    line_width_um
        Of a bar and of a gap; the period is twice that.
    orientation
        Axis along which the bars follow each other.
    bars
        Their number, at least 2.
    ground
        "dark": bright bars on a dark ground; "bright": the other way round.

    Raises
    ------
    InputError
        If a value is not usable, or the bars reach beyond the grid.
    SamplingError
        If the bars are narrower than two samples.
    """
    validate_positive("line_width_um", line_width_um)
    validate_sampling(grid, line_width_um, "bars")
    validate_whole_number("bars", bars, 2)
    width = 1e-3 * line_width_um
    shapes = bar_rectangles(width, bars, orientation, grid.centre_mm, (2 * bars - 1) * width)
    return on_ground(rectangle_coverage(grid, shapes), ground)


def siemens_star(
    grid: Grid, spokes: int, radius_mm: float, inner_radius_mm: float, ground: Ground = "dark"
) -> ComplexArray:
    """Spokes as wide as the gaps between them, in a ring about the grid's centre; the first lies along x.

    Straight edges are integrated exactly over each cell, and so are the rims; where a spoke's edge meets a
    rim, the product of both stands for the cell.

    Parameters
    ----------
    grid
        A plane.
    spokes
        Number of bright spokes, at least 2.
    radius_mm, inner_radius_mm
        Of the ring. At its inner rim, spokes are pi inner_radius / spokes wide.
    ground
        As of :func:`line_pairs`.

    Raises
    ------
    InputError
        If a value is not usable, or the star reaches beyond the grid.
    SamplingError
        If the spokes' inner ends are narrower than two samples.
    """
    validate_two_dimensional(grid)
    validate_whole_number("spokes", spokes, 2)
    validate_positive("inner_radius_mm", inner_radius_mm)
    if not inner_radius_mm < radius_mm < math.inf:
        raise InputError(
            f"radius_mm = {radius_mm!r}: must be finite and above inner_radius_mm = {inner_radius_mm!r}"
        )
    validate_inside(grid, rectangle(grid.centre_mm, 2.0 * radius_mm, 2.0 * radius_mm))
    # The chord is what a straight line across a spoke's end measures.
    validate_sampling(
        grid, 2e3 * inner_radius_mm * math.sin(0.5 * math.pi / spokes), "the spokes' inner ends"
    )
    x = (grid.x_mm - grid.centre_mm[0])[None, :]
    y = (grid.y_mm - grid.centre_mm[1])[:, None]
    star = disc_coverage(grid, radius_mm)
    star -= disc_coverage(grid, inner_radius_mm)
    for rows in row_blocks(len(y)):
        star[rows] *= _spokes(x, y[rows], math.pi / spokes, grid.pitch_mm)
    return on_ground(star, ground)


def _spokes(x: Array, y: Array, step: float, pitch_mm: float) -> Array:
    """Share of each cell that spokes cover, each `step` wide and as far apart."""
    # Of the edges, two to a spoke, the nearest is at half a step from a multiple of the step.
    nearest = np.floor(np.arctan2(y, x) / step)
    edge = (nearest + 0.5) * step
    distance = y * np.cos(edge) - x * np.sin(edge)
    beyond = half_plane_coverage(distance / pitch_mm, np.cos(edge), np.sin(edge))
    return np.where(nearest % 2 == 0, 1.0 - beyond, beyond)


def phase_pads(
    pad_um: float, phase_rad: float, levels: int, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> tuple[tuple[Rectangle, float], ...]:
    """Places and phases (rad) of the pads of :func:`phase_target`."""
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
    """Clear square pads in a row along x, with gaps of their own width, that delay the light in equal steps.

    Parameters
    ----------
    grid
        A plane; the row's middle is its centre.
    pad_um
        Side of a pad.
    phase_rad
        Of the last pad; pad m of `levels` has m / levels of it, the ground has 0.
    levels
        Number of pads.
    profile
        "binary": steps at the pads' borders; "smooth": cos^2 along x and y, with the phase in the pad's
        middle, taken at the samples.

    Raises
    ------
    InputError
        If a value is not usable, or the pads reach beyond the grid.
    SamplingError
        If a pad is narrower than two samples, or the phase of a smooth one changes by more
        than pi from sample to sample.
    """
    validate_choice("profile", profile, ("binary", "smooth"))
    pads = phase_pads(pad_um, phase_rad, levels, grid.centre_mm)
    validate_sampling(grid, pad_um, "phase pads")
    pitch_um = 1e3 * grid.pitch_mm
    if profile == "smooth" and abs(phase_rad) * pitch_um > pad_um:
        # The steepest slope of phase cos^2(pi x / pad) is pi phase / pad.
        raise SamplingError(
            f"phase_rad = {phase_rad:g}: on pads of {pad_um:g} um it changes by more than pi within the "
            f"grid's pitch of {pitch_um:.4g} um; give a pitch below {pad_um / abs(phase_rad):.4g} um"
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
) -> ComplexArray:
    """Transmission from a picture about the grid's centre; its pixels are integrated over the cells.

    The first row lies at the smallest y. Beyond the picture the object is opaque, or clear for a phase.

    Parameters
    ----------
    path
        PNG, TIFF or another format that Pillow reads (:func:`read_grey`).
    grid
        A plane.
    pixel_um
        Side of a pixel on the object.
    quantity
        What grey values stand for, as parts of full scale (255 or 65535).
    phase_rad
        Of full scale, where they stand for a phase.
    finer
        What becomes of pixels finer than the pitch, whose detail is averaged away.

    Raises
    ------
    InputError
        If the file is no such picture, or a value is not usable, or the picture is larger than the grid.
    SamplingError
        If pixels are smaller than the pitch, and are not to be averaged.
    """
    validate_two_dimensional(grid)
    validate_positive("pixel_um", pixel_um)
    validate_choice("quantity", quantity, ("intensity", "amplitude", "phase"))
    validate_choice("finer", finer, ("refuse", "average"))
    if not math.isfinite(phase_rad):
        raise InputError(f"phase_rad = {phase_rad!r}: must be finite")
    grey = read_grey(path)
    pixel = 1e-3 * pixel_um
    rows, columns = grey.shape
    if finer == "refuse" and pixel < grid.pitch_mm * ROUNDING:
        raise SamplingError(
            f"pixel_um = {pixel_um:g}: finer than the grid's pitch of {1e3 * grid.pitch_mm:.4g} um; "
            "give a finer grid, or a picture with larger pixels"
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
    """Side of a picture's pixel on the object in um: as given, or so that the picture fits a field stop.

    Parameters
    ----------
    shape
        Rows and columns.
    stop_mm
        Diameter of the round field stop.
    pixel_um, width_mm
        Side of a pixel, or width of the picture; left out, its corners touch the stop.

    Raises
    ------
    InputError
        If both are given, one is not usable, or the picture is larger than the stop.
    """
    rows, columns = shape
    largest_um = 1e3 * stop_mm / math.hypot(rows, columns)
    if pixel_um is not None and width_mm is not None:
        raise InputError("picture_pixel_um, picture_width_mm: give one of them")
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
            f"{stop_mm:g} mm; give {largest_um / um:.4g} at most, which it is if left out"
        )
    return given * um


def read_grey(path: str | os.PathLike[str]) -> Array:
    """Grey values of a picture as parts of full scale (0: black), of shape (rows, columns).

    One channel of 8 or 16 bits is taken as it is; of colours, palettes and black and white the luma of ITU-R
    BT.601, of 8 bits. The picture is turned upright by the orientation that its file states, and looks as in
    a viewer where white is zero.

    Raises
    ------
    InputError
        If the file cannot be read, or does not hold one picture of such kinds without transparency.
    """
    place = Path(path)
    picture = PictureFile(place, "the picture").only()
    if picture.mode not in (*COUNT_MODES, *LUMA_MODES) or not picture.is_opaque:
        raise InputError(
            f"picture {place}: has mode {picture.mode}; give grey of 8 or 16 bits, or opaque colours of 8"
        )
    values = picture.values
    if values.dtype == np.bool_:
        full_scale = 1
    elif picture.format == "TIFF" and picture.mode.startswith("I;16"):
        full_scale = 2**picture.bits - 1
    else:
        full_scale = int(np.iinfo(values.dtype).max)
    grey = values / full_scale
    return np.asarray(1.0 - grey if picture.white_is_zero else grey, float)


def band_limit(
    values: ComplexArray, grid: Grid, wavelength_um: float, numerical_aperture: float
) -> ComplexArray:
    """What light within a numerical aperture can tell of an object lit along the axis.

    Cycles per mm above numerical_aperture / wavelength are taken out, in a circle, by the discrete Fourier
    transform; the grid is taken to repeat.

    Raises
    ------
    InputError
        If a value is not usable, or `values` are not of the grid's shape.
    SamplingError
        If the grid is too coarse for the aperture.
    """
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("numerical_aperture", numerical_aperture)
    if values.shape != grid.shape:
        raise InputError(f"values have shape {values.shape}: the grid's is {grid.shape}")
    limit = 1e3 * numerical_aperture / wavelength_um
    if grid.pitch_mm * ROUNDING > 0.5 / limit:
        raise SamplingError(
            f"numerical_aperture = {numerical_aperture:g}: at {wavelength_um:g} um it needs a pitch of "
            f"{500.0 / limit:.4g} um or less; the grid's is {1e3 * grid.pitch_mm:.4g} um"
        )
    squared = sum(across**2 for across in fft_frequencies(grid.shape, grid.pitch_mm, np))
    return np.asarray(ifftn(np.where(squared <= limit**2, fftn(values), 0.0)))


def _overlaps(count: int, grid: Grid, pixel_mm: float, pixels: int) -> Array:
    """Part of each cell (row) that each pixel (column) covers, both centred."""
    cells = grid.pitch_mm * (np.arange(count + 1) - 0.5 * count)
    borders = pixel_mm * (np.arange(pixels + 1) - 0.5 * pixels)
    low = np.maximum(cells[:-1, None], borders[None, :-1])
    high = np.minimum(cells[1:, None], borders[None, 1:])
    return np.asarray(np.maximum(high - low, 0.0) / grid.pitch_mm)
