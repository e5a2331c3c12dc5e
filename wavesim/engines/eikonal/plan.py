"""The cut of an object into tiles: their width, by the allowed error, and whether they form a hierarchy.

Flat tiles are propagated to the plane one by one. Each has its own rays and residual, so that the widest
tiles that meet the error limit follow from the residuals of some of them. Tiles of a hierarchy share rays and
residual, and a few terms must describe all of them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import SamplingError
from wavesim.engines.eikonal.ray_maps import Region
from wavesim.engines.eikonal.residual import MAX_RANK, Quadratic, Residual, Separable, tile_residual
from wavesim.fields.field import Grid
from wavesim.fields.resampling import OVERSAMPLING
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.rays.maps import RayMap, RayMapError
from wavesim.runtime.memory import COMPLEX128
from wavesim.runtime.threads import at_once
from wavesim.scene.scene import Scene

TARGET_RANK, TARGET_RANK_OF_MANY, MANY = 5, 8, 16
"""Number of terms above which narrower tiles are cheaper, for few and for many tiles, and the number of tiles
from which they are many. Each tile needs its own rays and maps. Transforms process eight terms in two
vectors."""

Mapper = Callable[[tuple[float, float]], RayMap]


@dataclass(frozen=True)
class Tile:
    """A part of the object grid.

    Attributes
    ----------
    part : tuple of slice
        Samples of the object grid.
    centre_mm : (x, y)
        Sample whose rays carry the tile.
    offsets_mm : tuple of ndarray
        Offsets of the samples from the centre, y (and x).
    pitch_mm : float
        Pitch of the object grid.
    """

    part: tuple[slice, ...]
    centre_mm: tuple[float, float]
    offsets_mm: tuple[Array, ...]
    pitch_mm: float

    @property
    def spans_mm(self) -> Array:
        """Extent of the tile about its centre, shape (d, 2)."""
        half = 0.5 * self.pitch_mm
        return np.array([[o[0] - half, o[-1] + half] for o in self.offsets_mm])

    @property
    def width_mm(self) -> float:
        """Distance from its first sample to its last along the longer side."""
        return float(max(o[-1] - o[0] for o in self.offsets_mm))


def cut(grid: Grid, counts: tuple[int, ...]) -> tuple[Tile, ...]:
    """Cut a grid into tiles, `counts` along y (and x), as equal as the samples allow."""
    axes = (grid.y_mm, grid.x_mm)[: len(grid.shape)]
    cuts = [np.linspace(0, n, c + 1).round().astype(int) for n, c in zip(grid.shape, counts, strict=True)]
    tiles = []
    for position in product(*(range(c) for c in counts)):
        part = tuple(slice(int(c[i]), int(c[i + 1])) for c, i in zip(cuts, position, strict=True))
        inside = [axis[s] for axis, s in zip(axes, part, strict=True)]
        middle = [float(axis[len(axis) // 2]) for axis in inside]
        centre = (0.0 if grid.is_line else middle[1], middle[0])
        offsets = tuple(axis - m for axis, m in zip(inside, middle, strict=True))
        tiles.append(Tile(part, centre, offsets, grid.pitch_mm))
    return tuple(tiles)


def counts_for(grid: Grid, width_mm: float) -> tuple[int, ...]:
    """Return the number of tiles along each side that are at most as wide as given."""
    return tuple(min(n, max(1, math.ceil(n * grid.pitch_mm / width_mm - 1e-9))) for n in grid.shape)


def shared_tile_width_mm(scene: Scene) -> float:
    """Return the width of the tiles of a hierarchy, for which a few terms describe the residual."""
    zone_mm = math.sqrt(1e-3 * scene.wavelength_um * -scene.object_grid.z_mm)
    # Width over sqrt(wavelength x working distance) / NA for which a few terms describe the residual.
    zones = 0.74
    return zones * zone_mm / scene.lens.object.numerical_aperture


def hierarchy_is_cheaper(scene: Scene) -> bool:
    """Return whether a hierarchy needs less time or memory than flat tiles, by their estimated number.

    A hierarchy is for planes only.
    """
    grid, width_mm = scene.object_grid, shared_tile_width_mm(scene)
    if grid.is_line:
        return False
    # Number of tiles along the longer side of the object from which the hierarchy is worth its set-up.
    many_tiles = 16
    # Largest memory of the carriers that flat tiles keep, in complex128 on a round footprint.
    most_bytes = 20e9
    count, lit = math.prod(counts_for(grid, width_mm)), 0.25 * math.pi * scene.exit_grid.size
    return max(grid.shape) * grid.pitch_mm > many_tiles * width_mm or COMPLEX128 * count * lit > most_bytes


def coarse_step_mm(band_per_mm: Array) -> Array:
    """Return the spacing of samples of a field without its carrier, for the largest angular frequency of its
    light."""
    # Margin for the slowly varying factors besides the Fourier kernel.
    band_margin = 1.1
    return np.asarray(math.pi / (OVERSAMPLING * band_margin * band_per_mm))


Cut = tuple[tuple[Tile, tuple[int, ...]], ...]
"""Tiles, each with the position of its super-tile."""


def cut_hierarchy(grid: Grid, width_mm: float, tiles_across: int, region: Region) -> Cut:
    """Return the tiles that extend into a region of the object, each with the position of its super-tile."""
    counts = counts_for(grid, width_mm)
    found = []
    for index, tile in enumerate(cut(grid, counts)):
        nearest = [
            max(abs(c) - float(np.max(np.abs(s))), 0.0)
            for c, s in zip(tile.centre_mm[::-1], tile.spans_mm, strict=True)
        ]
        if not region.is_disc or math.hypot(*nearest) < region.half_mm[0]:
            position = (int(i) // tiles_across for i in np.unravel_index(index, counts))
            found.append((tile, tuple(position)))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Probe:
    """A cut of the object into tiles, and the residuals of some of them.

    Attributes
    ----------
    counts : tuple of int
        Number of tiles along each side of the object.
    tiles : tuple of Tile
        All tiles.
    probed : tuple of int
        Indices of the probed tiles: the middle one and those in the corners.
    residuals : tuple of Residual
        Residuals of the probed tiles.
    """

    counts: tuple[int, ...]
    tiles: tuple[Tile, ...]
    probed: tuple[int, ...]
    residuals: tuple[Residual, ...]

    @cached_property
    def mean_error(self) -> float:
        """Largest relative error if the residual is replaced by its mean."""
        return max(r.mean_error() for r in self.residuals)

    def rank_for(self, error: float) -> int:
        """Return the largest number of terms that a tile needs for an error."""
        return max(r.rank_for(error) for r in self.residuals)

    def target_rank(self, error: float) -> int:
        """Return the number of terms above which narrower tiles are cheaper."""
        narrower = len(self.tiles) * self.rank_for(error) / TARGET_RANK
        return TARGET_RANK if narrower <= MANY else TARGET_RANK_OF_MANY

    def error(self, quadratic: Quadratic, allowed: float) -> float:
        """Return the largest relative error of the expansion."""
        if quadratic == "mean":
            return self.mean_error
        return max(r.error_of(min(r.rank_for(allowed), MAX_RANK)) for r in self.residuals)

    @property
    def neglected_waves(self) -> tuple[float, float]:
        """Path beyond the mean in the worst tile, in waves: rms over the footprint, and largest."""
        waves = np.array([r.neglected_waves for r in self.residuals])
        return float(waves[:, 0].max()), float(waves[:, 1].max())


def probe(scene: Scene, counts: tuple[int, ...], mapper: Mapper) -> Probe:
    """Compute the residuals of the middle tile and of the corner tiles of a cut.

    Raises
    ------
    RayMapError
        If tiles are too wide for rays to be aimed from their borders.
    """
    tiles = cut(scene.object_grid, counts)
    corners = set(product(*((0, c - 1) for c in counts))) | {tuple(c // 2 for c in counts)}
    probed = tuple(int(np.ravel_multi_index(position, counts)) for position in sorted(corners))
    residuals = at_once([partial(residual_of, scene, tiles[index], mapper) for index in probed])
    return Probe(counts, tiles, probed, tuple(residuals))


def residual_of(scene: Scene, tile: Tile, mapper: Mapper) -> Residual:
    """Return the residual of one tile beyond its Fourier transform."""
    return tile_residual(scene, tile.centre_mm, tile.spans_mm, mapper(tile.centre_mm))


def chosen_probe(scene: Scene, error: float, quadratic: Quadratic, mapper: Mapper) -> Probe:
    """Return the cut into the widest tiles that meet an error limit.

    Raises
    ------
    SamplingError
        If even tiles of one sample exceed it. The cause is a RayMapError where their rays cannot be traced.
    """
    grid = scene.object_grid
    side = max(grid.shape) * grid.pitch_mm
    parts, problem = 1.0, None
    while True:
        counts = counts_for(grid, side / parts)
        try:
            found = probe(scene, counts, mapper)
        except RayMapError as error_of_map:
            grow, problem = 2.0, error_of_map
        else:
            problem = None
            if quadratic == "mean":
                grow = math.sqrt(found.mean_error / error)
            else:
                grow = math.sqrt(found.rank_for(error) / found.target_rank(error))
            if grow <= 1.0:
                return found
        if all(c == n for c, n in zip(counts, grid.shape, strict=True)):
            why = "" if problem is None else f": {problem}"
            message = f"error = {error:g}: even tiles of one object sample exceed it{why}"
            raise SamplingError(message) from problem
        parts = max(math.ceil(parts * min(1.02 * grow, 4.0)), parts + 1.0)


def checked_probe(scene: Scene, width_mm: float, error: float, quadratic: Quadratic, mapper: Mapper) -> Probe:
    """Return the cut into tiles of a given width.

    Raises
    ------
    SamplingError
        If their error exceeds three times the allowed error.
    """
    try:
        found = probe(scene, counts_for(scene.object_grid, width_mm), mapper)
    except RayMapError as problem:
        raise SamplingError(f"tile_width_mm = {width_mm:g}: {problem}") from problem
    tile_error = found.error(quadratic, error)
    if tile_error > error:
        message = (
            f"tile_width_mm = {width_mm:g}: leaves a relative error of {tile_error:.2g} "
            f"(allowed: {error:.2g}); make tiles narrower, or allow a larger error"
        )
        # Largest error of a given tile width, as a multiple of the allowed error.
        largest_multiple = 3.0
        if tile_error > largest_multiple * error:
            raise SamplingError(message)
        warnings.warn(message, SamplingWarning, stacklevel=2)
    return found


def expansion(residual: Residual, quadratic: Quadratic, error: float) -> Separable:
    """Return the expansion of one tile's residual."""
    return residual.mean_term() if quadratic == "mean" else residual.low_rank(error)
