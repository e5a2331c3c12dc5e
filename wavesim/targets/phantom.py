"""A tissue-like phantom from a seed: nuclei and fibres that absorb and delay light in a weak background."""

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

NUCLEUS_PHASE_RAD, NUCLEUS_ABSORPTION = 1.0, 0.6
"""Phase at the centre of a nucleus, and the exponent of its amplitude absorption."""

FIBRE_WIDTH_UM = 1.5
"""Distance from the centre line of a fibre at which its thickness is 1/e."""
FIBRE_PHASE_RAD, FIBRE_ABSORPTION = 0.6, 0.15

BACKGROUND_WAVES = 64


def tissue_phantom(grid: Grid, seed: int, wavelength_um: float, numerical_aperture: float) -> ComplexArray:
    """Return the transmission of a thin slice of tissue, band-limited to a numerical aperture.

    Nuclei are ellipses with soft edges, and fibres are bent lines. Both have random positions, sizes and
    strengths. The background is a sum of random waves. The slice fills the grid except for clear borders.
    Positions and sizes depend only on the seed and the grid's sides, so grids of the same sides and different
    pitch hold the same tissue. Amplitudes are scaled so that none exceeds 1.

    Parameters
    ----------
    grid
        Grid of the object plane.
    seed
        Seed of the phantom; a whole number from 0.
    wavelength_um, numerical_aperture
        Wavelength, and numerical aperture of the band limit; see
        :func:`wavesim.targets.patterns.band_limit`.

    Returns
    -------
    ndarray of complex64, shape (ny, nx)
        Complex transmission of each cell.

    Raises
    ------
    InputError
        If a value is out of range.
    SamplingError
        If the grid is too coarse for the aperture, or for the fibres.
    """
    validate_two_dimensional(grid)
    validate_positive("wavelength_um", wavelength_um)
    validate_positive("numerical_aperture", numerical_aperture)
    validate_whole_number("seed", seed, 0)
    validate_sampling(grid, FIBRE_WIDTH_UM, "fibres")
    nuclei_seed, fibre_seed, background_seed = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(3)
    )
    tissue = _transmission(grid, _nuclei(grid, nuclei_seed), _fibres(grid, fibre_seed), background_seed)
    limited = band_limit(tissue, grid, wavelength_um, numerical_aperture)
    # Rounding must not lift the brightest above 1.
    limited /= np.float32(max(1.0, (1.0 + 1e-6) * float(np.max(abs(limited)))))
    return limited


def _transmission(
    grid: Grid, nuclei: Thickness, fibres: Thickness, background_seed: np.random.Generator
) -> Any:
    """Combine nuclei, fibres and background in blocks of rows, because a whole field is large."""
    down, across = _background(grid, background_seed)
    edges = [_soft_edge(n) for n in grid.shape]
    values = np.empty(grid.shape, np.complex64)
    rows_at_once = 256
    # Root-mean-square phase of the background.
    background_phase_rad = 0.15
    for first in range(0, grid.shape[0], rows_at_once):
        rows = slice(first, first + rows_at_once)
        background = (down[rows] @ across).real * math.sqrt(2.0 / BACKGROUND_WAVES)
        phase = (
            NUCLEUS_PHASE_RAD * nuclei[rows]
            + FIBRE_PHASE_RAD * fibres[rows]
            + background_phase_rad * background
        )
        absorption = NUCLEUS_ABSORPTION * nuclei[rows] + FIBRE_ABSORPTION * fibres[rows]
        values[rows] = np.exp(np.outer(edges[0][rows], edges[1]) * (1j * phase - absorption))
    return values


def _centred(grid: Grid) -> tuple[Array, Array]:
    return grid.y_mm - grid.centre_mm[1], grid.x_mm - grid.centre_mm[0]


def _soft_edge(count: int) -> Array:
    """Return a raised cosine from 0 at the borders to 1."""
    from_border = 0.5 - abs(np.arange(count) + 0.5 - 0.5 * count) / count
    # Fraction of the grid's side over which the tissue becomes thinner toward each border.
    edge_fraction = 0.08
    return np.asarray(np.sin(0.5 * math.pi * np.minimum(from_border / edge_fraction, 1.0)) ** 2)


def _nuclei(grid: Grid, rng: np.random.Generator) -> Thickness:
    """Return the thickness of the nuclei, a sum of ellipses that fall from 1 to 0 with a soft edge."""
    y, x = _centred(grid)
    half_y, half_x = grid.half_widths_mm
    thickness = np.zeros(grid.shape, np.float32)
    nuclei_per_mm2 = 4000.0
    count = math.ceil(nuclei_per_mm2 * 4.0 * half_y * half_x)
    centres = rng.uniform(-1.0, 1.0, (count, 2)) * (half_y, half_x)
    nucleus_radii_um = (2.5, 5.0)
    radii = 1e-3 * rng.uniform(*nucleus_radii_um, (count, 2))
    angles, strengths = rng.uniform(0.0, math.pi, count), rng.uniform(0.5, 1.0, count)
    for centre, radius, angle, strength in zip(centres, radii, angles, strengths, strict=True):
        # exp(-r^4) is flat inside, and below 1e-7 beyond twice the radius.
        reach = 2.0 * float(np.max(radius))
        rows, columns = (
            slice(*np.searchsorted(axis, (middle - reach, middle + reach)))
            for axis, middle in zip((y, x), centre, strict=True)
        )
        down, across = y[rows, None] - centre[0], x[None, columns] - centre[1]
        along = (across * math.cos(angle) + down * math.sin(angle)) / radius[0]
        aside = (down * math.cos(angle) - across * math.sin(angle)) / radius[1]
        thickness[rows, columns] += strength * np.exp(-((along**2 + aside**2) ** 2))
    return thickness


def _fibres(grid: Grid, rng: np.random.Generator) -> Thickness:
    """Return the thickness of the fibres, bent lines with a Gaussian profile in similar directions."""
    half = max(grid.half_widths_mm)
    # Number of fibres for each mm of the side.
    fibres_per_mm = 60.0
    count = math.ceil(fibres_per_mm * 2.0 * half)
    main = rng.uniform(0.0, math.pi)
    thickness = np.zeros(grid.shape, np.float32)
    for _ in range(count):
        angle = main + rng.normal(0.0, math.radians(15.0))
        offset, strength = half * rng.uniform(-1.4, 1.4), rng.uniform(0.3, 1.0)
        bend, period, start = rng.uniform(2e-3, 6e-3), rng.uniform(0.08, 0.2), rng.uniform(0.0, 2.0 * math.pi)
        near, along, aside = _near_line(grid, angle, offset, bend + 5e-3 * FIBRE_WIDTH_UM)
        wave = bend * np.sin(2.0 * math.pi * along / period + start)
        thickness[near] += strength * np.exp(-(((aside - wave) / (1e-3 * FIBRE_WIDTH_UM)) ** 2))
    return thickness


def _near_line(grid: Grid, angle: float, offset: float, reach: float) -> tuple[Any, Array, Array]:
    """Return samples (rows, columns) near a straight line, and their coordinates along and across it.

    Samples are searched along the axis that the line crosses more steeply, which needs the fewest.
    """
    y, x = _centred(grid)
    cosine, sine = math.cos(angle), math.sin(angle)
    steep = abs(sine) >= abs(cosine)
    across = x if steep else y
    middles = (y * cosine - offset) / sine if steep else (x * sine + offset) / cosine
    half = reach / (abs(sine) if steep else abs(cosine))
    first = np.ceil((middles - half - across[0]) / grid.pitch_mm).astype(int) - 1
    at = first[:, None] + np.arange(math.ceil(2.0 * half / grid.pitch_mm) + 3)
    line, step = np.nonzero((at >= 0) & (at < len(across)))
    at = at[line, step]
    rows, columns = (line, at) if steep else (at, line)
    aside = y[rows] * cosine - x[columns] * sine - offset
    near = abs(aside) < reach
    rows, columns = rows[near], columns[near]
    return (rows, columns), x[columns] * cosine + y[rows] * sine, aside[near]


def _background(grid: Grid, rng: np.random.Generator) -> tuple[ComplexArray, ComplexArray]:
    """Return random plane waves as factors along y, shape (y, wave), and along x, shape (wave, x)."""
    y, x = _centred(grid)
    background_periods_um = (8.0, 60.0)
    shortest, longest = (1e-3 * period for period in background_periods_um)
    cycles = np.exp(rng.uniform(-math.log(longest), -math.log(shortest), BACKGROUND_WAVES))
    angles, starts = rng.uniform(0.0, 2.0 * math.pi, (2, BACKGROUND_WAVES))
    down = np.exp(2j * math.pi * np.outer(y, cycles * np.sin(angles)) + 1j * starts)
    across = np.exp(2j * math.pi * np.outer(cycles * np.cos(angles), x))
    return down, across
