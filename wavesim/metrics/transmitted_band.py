"""Part of an object field that a lens transmits, from an engine's forward and adjoint, rays, or an aperture.

Rays determine the directions in which light of an object point passes the lens. The field is divided into
overlapping blocks, with windows whose squares add up to 1. Each block keeps the plane waves whose directions
pass the lens from the centre of the block. For a sharp aperture the result agrees with that of an engine's
forward and adjoint, at a few hundredths of the cost: the correlations differ by less than 1e-4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from wavesim.engines.eikonal.ray_maps import Region
from wavesim.fields.field import Field, Grid
from wavesim.rays.maps import inside_border, solve, total_order_terms
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.runtime.threads import for_blocks
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.targets.patterns import band_limit

ORDER = 4
"""Order of the polynomials in the object point; their error is 1e-6 over the field of the paper's lens."""

ARMS = 72
"""Number of rays along the rim of an object point's light."""

BLOCK_ZONES = 2.0
"""Width of a block over sqrt(wavelength x working distance). Results hardly depend on it."""


@dataclass(frozen=True, eq=False)
class TransmittedDirections:
    """Directions in which light of object points passes a lens.

    Attributes
    ----------
    region : Region
        Disc of the object around the points that were traced.
    coefficients : ndarray, shape (terms, ARMS, 2)
        Coefficients of polynomials in the object point. The polynomials give the direction cosines (y, x)
        along the border, times the refractive index.
    width_mm : float
        Width in mm over which the directions of an object point hold for its neighbours.
    """

    region: Region
    coefficients: Array
    width_mm: float

    def border(self, point_mm: Array) -> Array:
        """Return cosines (y, x) along the border for an object point (y, x) in mm, shape (ARMS, 2)."""
        terms = total_order_terms(self.region.scaled(point_mm[None]), ORDER)[0]
        return np.asarray(np.tensordot(terms, self.coefficients, axes=1))


def transmitted_directions(scene: Scene, about: Grid | None = None) -> TransmittedDirections:
    """Trace the border of the light of some object points.

    Parameters
    ----------
    scene
        The scene with the actual lens.
    about
        Part of the object, a plane. Default: the whole object. Points beyond the lens's field are not traced.

    Returns
    -------
    TransmittedDirections
        Directions that pass the lens.

    Raises
    ------
    InputError
        If the object is a line, or the lens transmits light of too few of the points.
    """
    grid = about or scene.object_grid
    if grid.is_line:
        raise InputError(
            "transmitted band: the object must be a plane; for a line, propagate a field with an engine"
        )
    y, x = grid.centre_mm[1], grid.centre_mm[0]
    radius = min(math.hypot(*grid.half_widths_mm), scene.lens.half_field_mm + math.hypot(y, x))
    region = Region((y, x), np.full(2, radius), True)
    nodes, z_mm, seen, borders = region.nodes(ORDER), scene.exit_grid.z_mm, [], []
    for node in nodes:
        try:
            pupil = open_pupil(scene, (node[1], node[0]), z_mm, ARMS)
        except InputError:  # no light of this point passes the lens
            continue
        seen.append(node)
        borders.append(trace_bundle(scene, node[::-1], pupil.rim, z_mm).cosines)
    terms = total_order_terms(region.scaled(np.array(seen).reshape(-1, 2)), ORDER)
    if len(terms) < terms.shape[1]:
        raise InputError(
            f"transmitted band: light of only {len(seen)} of {len(nodes)} object points passes the lens"
        )
    coefficients = solve(terms, np.reshape(borders, (len(seen), -1))).reshape(-1, ARMS, 2)
    zone_mm = math.sqrt(1e-3 * scene.wavelength_um * abs(scene.object_grid.z_mm))
    return TransmittedDirections(region, coefficients, BLOCK_ZONES * zone_mm)


def transmitted_part(field: Field, by: Engine | TransmittedDirections | float) -> Field:
    """Return the part of an object field that a lens transmits.

    Parameters
    ----------
    field
        Field behind the object: its transmission times the illumination.
    by
        Description of the lens:

        - An engine. Its forward and adjoint include all effects that it models.
        - Directions from :func:`transmitted_directions`. They include stop and vignetting, at a small
          fraction of the cost.
        - A numerical aperture (:func:`~wavesim.targets.patterns.band_limit`).

    Returns
    -------
    Field
        The transmitted part, on the grid of the field.

    Raises
    ------
    InputError, SamplingError
        As the engine or the band limit.
    """
    if isinstance(by, Engine):
        return by.adjoint(by.forward(field))
    if isinstance(by, TransmittedDirections):
        return _by_directions(field, by)
    return field.with_values(band_limit(field.values, field.grid, field.wavelength_um, by))


def _by_directions(field: Field, by: TransmittedDirections) -> Field:
    """Filter a field block by block; the first blocks begin half a block before the field."""
    grid, values = field.grid, field.values
    half = scipy.fft.next_fast_len(max(4, round(0.5 * by.width_mm / grid.pitch_mm)))
    window = np.sin(np.pi * (np.arange(2 * half) + 0.5) / (2 * half)).astype(values.real.dtype)
    cosines = 1e-3 * field.wavelength_um * scipy.fft.fftshift(scipy.fft.fftfreq(2 * half, grid.pitch_mm))
    first_mm = np.array([grid.y_mm[0], grid.x_mm[0]]) + grid.pitch_mm * (half - 0.5)
    result = np.zeros_like(values)

    def across(starts: range, number: int, _: int) -> None:
        row = starts[number]
        rows, own_rows = _cut(row, half, grid.shape[0])
        for column in range(-half, grid.shape[1], half):
            columns, own = _cut(column, half, grid.shape[1])
            part = values[rows, columns]
            if not part.any():
                continue
            weight = window[own_rows, None] * window[own]
            block = np.zeros((2 * half, 2 * half), values.dtype)
            np.multiply(part, weight, out=block[own_rows, own])
            middle = first_mm + grid.pitch_mm * np.array([row, column])
            passed = _filtered(block, inside_border(by.border(middle), (cosines, cosines)))
            result[rows, columns] += passed[own_rows, own] * weight

    starts = range(-half, grid.shape[0], half)
    for some in (starts[::2], starts[1::2]):  # which have no samples in common
        for_blocks(partial(across, some), len(some), 1)
    return field.with_values(result)


def _cut(start: int, half: int, count: int) -> tuple[slice, slice]:
    """Return the samples of a block that lie in a field: among those of the field, and of the block."""
    inside = slice(max(start, 0), min(start + 2 * half, count))
    return inside, slice(inside.start - start, inside.stop - start)


def _filtered(block: NDArray, open_waves: NDArray[np.bool_]) -> NDArray:
    """Return a block with some of its plane waves, in the order of their cosines; overwrites the block."""
    spectrum = scipy.fft.fft2(block, overwrite_x=True)
    spectrum *= scipy.fft.ifftshift(open_waves)
    return np.asarray(scipy.fft.ifft2(spectrum, overwrite_x=True))
