"""A tissue-like object: absorbing and delaying nuclei and fibres in a faintly uneven ground, from a seed."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import validate_positive, validate_whole_number
from wavesim.fields.coverage import validate_sampling, validate_two_dimensional
from wavesim.fields.field import Grid
from wavesim.targets.patterns import ComplexArray, band_limit

Thickness = NDArray[np.float32]

NUCLEUS_RADII_UM = (2.5, 5.0)
NUCLEI_PER_MM2 = 4000.0
NUCLEUS_PHASE_RAD, NUCLEUS_ABSORPTION = 1.0, 0.6
"""Of a nucleus's middle: phase, and the exponent by which the amplitude falls."""

FIBRE_WIDTH_UM = 1.5
"""Distance from a fibre's middle line within which its thickness falls to 1/e."""
FIBRES_PER_MM = 60.0
"""Number of fibres for each mm of the side."""
FIBRE_PHASE_RAD, FIBRE_ABSORPTION = 0.6, 0.15

GROUND_PERIODS_UM = (8.0, 60.0)
GROUND_WAVES = 64
GROUND_PHASE_RAD = 0.15
"""Root mean square."""

ROWS = 256
"""That are put together at one time."""

RIM = 0.08
"""Part of the grid's sides over which the tissue thins out to nothing at each border."""


def tissue_phantom(grid: Grid, seed: int, wavelength_um: float, numerical_aperture: float) -> ComplexArray:
    """Transmission of a thin slice of tissue, band-limited to a numerical aperture.

    Nuclei are ellipses with soft rims, fibres bent lines, both of random place, size and strength; the ground
    is a sum of random waves. The slice fills the grid but for clear borders. Places and sizes come from the
    seed and the grid's sides alone, so that grids of the same sides and different pitch hold the same tissue.
    Amplitudes are scaled so that none exceeds 1. Single precision (complex64).

    Parameters
    ----------
    grid
        A plane.
    seed
        Whole number from 0.
    wavelength_um, numerical_aperture
        As of :func:`wavesim.targets.patterns.band_limit`.

    Raises
    ------
    InputError
        If a value is not usable.
    SamplingError
        If the grid is too coarse for the aperture, or for the fibres.
    """
    validate_two_dimensional(grid)
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("numerical_aperture", numerical_aperture)
    validate_whole_number("seed", seed, 0)
    validate_sampling(grid, FIBRE_WIDTH_UM, "fibres")
    nuclei_seed, fibre_seed, ground_seed = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)
    )
    tissue = _transmission(grid, _nuclei(grid, nuclei_seed), _fibres(grid, fibre_seed), ground_seed)
    limited = band_limit(tissue, grid, wavelength_um, numerical_aperture)
    # Rounding must not lift the brightest above 1.
    limited /= np.float32(max(1.0, (1.0 + 1e-6) * float(np.max(abs(limited)))))
    return limited


def _transmission(grid: Grid, nuclei: Thickness, fibres: Thickness, ground_seed: np.random.Generator) -> Any:
    """Of all parts together, in single precision; rows at a time, for a whole field is large."""
    down, across = _ground(grid, ground_seed)
    rims = [_rim(n) for n in grid.shape]
    values = np.empty(grid.shape, np.complex64)
    for first in range(0, grid.shape[0], ROWS):
        rows = slice(first, first + ROWS)
        ground = (down[rows] @ across).real * math.sqrt(2.0 / GROUND_WAVES)
        phase = NUCLEUS_PHASE_RAD * nuclei[rows] + FIBRE_PHASE_RAD * fibres[rows] + GROUND_PHASE_RAD * ground
        absorption = NUCLEUS_ABSORPTION * nuclei[rows] + FIBRE_ABSORPTION * fibres[rows]
        values[rows] = np.exp(np.outer(rims[0][rows], rims[1]) * (1j * phase - absorption))
    return values


def _centred(grid: Grid) -> tuple[Array, Array]:
    return grid.y_mm - grid.centre_mm[1], grid.x_mm - grid.centre_mm[0]


def _rim(count: int) -> Array:
    """Raised cosine from 0 at the borders to 1."""
    from_border = 0.5 - abs(np.arange(count) + 0.5 - 0.5 * count) / count
    return np.asarray(np.sin(0.5 * math.pi * np.minimum(from_border / RIM, 1.0)) ** 2)


def _nuclei(grid: Grid, rng: np.random.Generator) -> Thickness:
    """Sum of ellipses whose thickness falls from 1 to 0 like that of a ball with a soft rim."""
    y, x = _centred(grid)
    half_y, half_x = grid.half_widths_mm
    thickness = np.zeros(grid.shape, np.float32)
    count = math.ceil(NUCLEI_PER_MM2 * 4.0 * half_y * half_x)
    places = rng.uniform(-1.0, 1.0, (count, 2)) * (half_y, half_x)
    radii = 1e-3 * rng.uniform(*NUCLEUS_RADII_UM, (count, 2))
    turns, strengths = rng.uniform(0.0, math.pi, count), rng.uniform(0.5, 1.0, count)
    for place, radius, turn, strength in zip(places, radii, turns, strengths, strict=True):
        # exp(-r^4) is flat inside, and below 1e-7 beyond twice the radius.
        reach = 2.0 * float(np.max(radius))
        rows, columns = (
            slice(*np.searchsorted(axis, (middle - reach, middle + reach)))
            for axis, middle in zip((y, x), place, strict=True)
        )
        down, across = y[rows, None] - place[0], x[None, columns] - place[1]
        along = (across * math.cos(turn) + down * math.sin(turn)) / radius[0]
        aside = (down * math.cos(turn) - across * math.sin(turn)) / radius[1]
        thickness[rows, columns] += strength * np.exp(-((along**2 + aside**2) ** 2))
    return thickness


def _fibres(grid: Grid, rng: np.random.Generator) -> Thickness:
    """Sum of bent lines with a Gaussian profile, all within some 30 degrees of one direction."""
    half = max(grid.half_widths_mm)
    count = math.ceil(FIBRES_PER_MM * 2.0 * half)
    main = rng.uniform(0.0, math.pi)
    thickness = np.zeros(grid.shape, np.float32)
    for _ in range(count):
        turn = main + rng.normal(0.0, math.radians(15.0))
        offset, strength = half * rng.uniform(-1.4, 1.4), rng.uniform(0.3, 1.0)
        bend, period, start = rng.uniform(2e-3, 6e-3), rng.uniform(0.08, 0.2), rng.uniform(0.0, 2.0 * math.pi)
        near, along, aside = _near_line(grid, turn, offset, bend + 5e-3 * FIBRE_WIDTH_UM)
        wave = bend * np.sin(2.0 * math.pi * along / period + start)
        thickness[near] += strength * np.exp(-(((aside - wave) / (1e-3 * FIBRE_WIDTH_UM)) ** 2))
    return thickness


def _near_line(grid: Grid, turn: float, offset: float, reach: float) -> tuple[Any, Array, Array]:
    """Samples (rows, columns) nearer to a straight line than `reach`; places along it and distances from it.

    The line is crossed along the axis to which it is the steeper, so that few samples are looked at.
    """
    y, x = _centred(grid)
    cosine, sine = math.cos(turn), math.sin(turn)
    steep = abs(sine) >= abs(cosine)
    across = x if steep else y
    middles = (y * cosine - offset) / sine if steep else (x * sine + offset) / cosine
    half = reach / (abs(sine) if steep else abs(cosine))
    first = np.ceil((middles - half - across[0]) / grid.pitch_mm).astype(int) - 1
    at = first[:, None] + np.arange(math.ceil(2.0 * half / grid.pitch_mm) + 3)
    place, step = np.nonzero((at >= 0) & (at < len(across)))
    at = at[place, step]
    rows, columns = (place, at) if steep else (at, place)
    aside = y[rows] * cosine - x[columns] * sine - offset
    near = abs(aside) < reach
    rows, columns = rows[near], columns[near]
    return (rows, columns), x[columns] * cosine + y[rows] * sine, aside[near]


def _ground(grid: Grid, rng: np.random.Generator) -> tuple[ComplexArray, ComplexArray]:
    """Plane waves of random direction, period and phase: their values down (y, wave) and across (wave, x)."""
    y, x = _centred(grid)
    shortest, longest = (1e-3 * period for period in GROUND_PERIODS_UM)
    cycles = np.exp(rng.uniform(-math.log(longest), -math.log(shortest), GROUND_WAVES))
    turns, starts = rng.uniform(0.0, 2.0 * math.pi, (2, GROUND_WAVES))
    down = np.exp(2j * math.pi * np.outer(y, cycles * np.sin(turns)) + 1j * starts)
    across = np.exp(2j * math.pi * np.outer(cycles * np.cos(turns), x))
    return down, across
