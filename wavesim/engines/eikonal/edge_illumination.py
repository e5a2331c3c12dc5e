"""Light of an object at the aperture's rim, where eikonal tiles have their largest errors.

These errors are proportional to the amplitude at the rim. An object that fills the aperture evenly has the
mean amplitude there; most objects have far less. The spectra are those of single tiles, since each tile has
its own rim: light that the cut between tiles diffracts to the rim causes errors, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.eikonal.flat_tiles import Tile
from wavesim.rays.maps import RIM_ARMS, inside_border, moved
from wavesim.rays.ray_bundles import open_pupil, trace_bundle
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene


def edge_illumination(scene: Scene, tiles: Sequence[Tile], plane_z_mm: float, light: Light) -> float:
    """Return the amplitude of an object's light at the aperture's rim, relative to an evenly filled aperture.

    It is the root of the mean energy in a direction next to the rim, over the mean in all directions that the
    lens transmits. The brighter one of the rim's two sides counts. It is 1 if the lens transmits no light.

    Parameters
    ----------
    scene, tiles
        Lens, and the tiles of its object.
    plane_z_mm
        z of a plane behind the lens that rays reach.
    light
        Light behind the object.
    """
    rims = _Rims(scene, tiles, plane_z_mm)
    found = np.zeros(3)
    for tile in tiles:
        values = light.field.values[tile.part]
        if np.any(values):
            found += _densities(values, tile, rims.of(tile), 1e-3 * scene.wavelength_um)
    *at_rim, transmitted = found
    if transmitted == 0.0:
        return 1.0
    return math.sqrt((1.0 - light.even) * max(at_rim) / transmitted + light.even)


class _Rims:
    """Direction cosines of the rim as a linear function of the object point, from some tiles far apart."""

    def __init__(self, scene: Scene, tiles: Sequence[Tile], plane_z_mm: float) -> None:
        centres = np.array([tile.centre_mm for tile in tiles])
        diagonal = centres @ [[1.0, 1.0], [1.0, -1.0]]
        ends = {*np.argmin(diagonal, axis=0).tolist(), *np.argmax(diagonal, axis=0).tolist(), len(tiles) // 2}
        self._middle = centres[len(tiles) // 2]
        found = [_rim_cosines(scene, tiles[i].centre_mm, plane_z_mm) for i in sorted(ends)]
        terms = self._terms(centres[sorted(ends)])
        flat = np.reshape(found, (len(found), -1))
        self._shape = found[0].shape
        self._slopes = np.linalg.lstsq(terms, flat)[0]

    def _terms(self, points_mm: Array) -> Array:
        return np.column_stack([np.ones(len(points_mm)), points_mm - self._middle])

    def of(self, tile: Tile) -> Array:
        """Return the rim's direction cosines for a tile's centre, shape (arms, d), in the order (y, x)."""
        return np.reshape(self._terms(np.array([tile.centre_mm])) @ self._slopes, self._shape)


def _rim_cosines(scene: Scene, point_mm: tuple[float, float], plane_z_mm: float) -> Array:
    pupil = open_pupil(scene, point_mm, plane_z_mm, RIM_ARMS)
    return trace_bundle(scene, np.asarray(point_mm), pupil.rim, plane_z_mm).cosines


def _densities(values: NDArray, tile: Tile, rim: Array, wavelength_mm: float) -> Array:
    """Return the mean energy in a direction: next to the rim outside and inside, and over the aperture."""
    middle = rim.mean(axis=0)
    radius = float(np.mean(np.linalg.norm(rim - middle, axis=1)))
    # Least number of bins of a spectrum over the aperture's radius.
    bins = 8.0
    least = math.ceil(bins * wavelength_mm / (tile.pitch_mm * radius))
    # A line has only two rim points to average over, and needs a finer spectrum.
    shape = [scipy.fft.next_fast_len(max((3 - values.ndim) * n, least)) for n in values.shape]
    energy = scipy.fft.fftshift(np.abs(scipy.fft.fftn(values, shape)) ** 2)
    axes = [wavelength_mm * scipy.fft.fftshift(scipy.fft.fftfreq(n, tile.pitch_mm)) for n in shape]
    resolved = wavelength_mm / (min(values.shape) * tile.pitch_mm)
    # Width of the rim, relative to the aperture's radius, unless a tile's light resolves directions less
    # finely. It is measured: predictions with this value bound the errors of all objects.
    rim_width = 0.05
    width = max(rim_width * radius, resolved)
    beyond, inside, within = (inside_border(moved(rim, by), axes) for by in (width, 0.0, -width))
    parts = (beyond & ~inside, inside & ~within, inside)
    return np.array([energy[part].mean() if part.any() else 0.0 for part in parts])
