"""Into how many tiles an object has to be cut, for the error allowed."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np

from lensdesign.errors import SamplingError
from wavesim.engines.tiles.operator import Tile, at_once
from wavesim.engines.tiles.residual import MAX_RANK, Quadratic, Residual, Separable, tile_residual
from wavesim.fields.field import Grid
from wavesim.fields.guards import SamplingWarning
from wavesim.rays.maps import RayMap, RayMapError
from wavesim.scene.scene import Scene

RANK_SOUGHT, RANK_OF_MANY, MANY = 5, 8, 16
"""Terms that a tile may take before narrower tiles are cheaper; and where these would be more than so many,
each with rays of its own to be traced and fitted. Transforms carry eight terms in two vectors."""

REFUSED = 3.0
"""Times the error allowed, beyond which a tile width asked for is refused."""

Mapper = Callable[[tuple[float, float]], RayMap]


def cut(grid: Grid, counts: tuple[int, ...]) -> tuple[Tile, ...]:
    """Tiles of a grid, `counts` along y (and x), as even as samples allow."""
    axes = (grid.y_mm, grid.x_mm)[: len(grid.shape)]
    cuts = [np.linspace(0, n, c + 1).round().astype(int) for n, c in zip(grid.shape, counts, strict=True)]
    tiles = []
    for place in product(*(range(c) for c in counts)):
        part = tuple(slice(int(c[i]), int(c[i + 1])) for c, i in zip(cuts, place, strict=True))
        inside = [axis[s] for axis, s in zip(axes, part, strict=True)]
        middle = [float(axis[len(axis) // 2]) for axis in inside]
        centre = (0.0 if grid.is_line else middle[1], middle[0])
        offsets = tuple(axis - m for axis, m in zip(inside, middle, strict=True))
        tiles.append(Tile(part, centre, offsets, grid.pitch_mm))
    return tuple(tiles)


def counts_for(grid: Grid, width_mm: float) -> tuple[int, ...]:
    """Tiles along each side that are no wider than asked for."""
    return tuple(min(n, max(1, math.ceil(n * grid.pitch_mm / width_mm - 1e-9))) for n in grid.shape)


@dataclass(frozen=True, eq=False)
class Probe:
    """Some tiles of a cut, and what they leave out.

    Attributes
    ----------
    counts : tuple of int
        Tiles along each side of the object.
    tiles : tuple of Tile
        All of them.
    looked_at : tuple of int
        Which of them: the middle tile and those in the corners.
    residuals : tuple of Residual
        Of those.
    """

    counts: tuple[int, ...]
    tiles: tuple[Tile, ...]
    looked_at: tuple[int, ...]
    residuals: tuple[Residual, ...]

    @cached_property
    def mean_error(self) -> float:
        """Largest relative error if one mean stands for the residual."""
        return max(r.mean_error() for r in self.residuals)

    def rank_for(self, error: float) -> int:
        """Most terms that a tile takes for an error."""
        return max(r.rank_for(error) for r in self.residuals)

    def rank_sought(self, error: float) -> int:
        """Terms beyond which narrower tiles are cheaper."""
        narrower = len(self.tiles) * self.rank_for(error) / RANK_SOUGHT
        return RANK_SOUGHT if narrower <= MANY else RANK_OF_MANY

    def error(self, quadratic: Quadratic, allowed: float) -> float:
        """Largest relative error that is left."""
        if quadratic == "mean":
            return self.mean_error
        return max(r.left_by(min(r.rank_for(allowed), MAX_RANK)) for r in self.residuals)

    @property
    def neglected_waves(self) -> tuple[float, float]:
        """Path that a mean leaves out in the worst tile: rms over the footprint, and largest."""
        waves = np.array([r.neglected_waves for r in self.residuals])
        return float(waves[:, 0].max()), float(waves[:, 1].max())


def probe(scene: Scene, counts: tuple[int, ...], mapper: Mapper) -> Probe:
    """Look at the middle tile and at the corner tiles of a cut.

    Raises
    ------
    RayMapError
        If tiles are too wide for rays to be aimed from their borders.
    """
    tiles = cut(scene.object_grid, counts)
    corners = set(product(*((0, c - 1) for c in counts))) | {tuple(c // 2 for c in counts)}
    chosen = tuple(int(np.ravel_multi_index(place, counts)) for place in sorted(corners))
    residuals = at_once([partial(residual_of, scene, tiles[number], mapper) for number in chosen])
    return Probe(counts, tiles, chosen, tuple(residuals))


def residual_of(scene: Scene, tile: Tile, mapper: Mapper) -> Residual:
    """What the Fourier transform leaves out of one tile."""
    return tile_residual(scene, tile.centre_mm, tile.spans_mm, mapper(tile.centre_mm))


def chosen_probe(scene: Scene, error: float, quadratic: Quadratic, mapper: Mapper) -> Probe:
    """The widest tiles that keep to an error.

    Raises
    ------
    SamplingError
        If not even tiles of one sample do; caused by a RayMapError where these cannot be followed.
    """
    grid = scene.object_grid
    side = max(grid.shape) * grid.pitch_mm
    parts, problem = 1.0, None
    while True:
        counts = counts_for(grid, side / parts)
        try:
            found = probe(scene, counts, mapper)
        except RayMapError as met:
            grow, problem = 2.0, met
        else:
            problem = None
            if quadratic == "mean":
                grow = math.sqrt(found.mean_error / error)
            else:
                grow = math.sqrt(found.rank_for(error) / found.rank_sought(error))
            if grow <= 1.0:
                return found
        if all(c == n for c, n in zip(counts, grid.shape, strict=True)):
            why = "" if problem is None else f": {problem}"
            message = f"error = {error:g}: not even tiles of one object sample keep to it{why}"
            raise SamplingError(message) from problem
        parts = max(math.ceil(parts * min(1.02 * grow, 4.0)), parts + 1.0)


def checked_probe(scene: Scene, width_mm: float, error: float, quadratic: Quadratic, mapper: Mapper) -> Probe:
    """Tiles of a width asked for.

    Raises
    ------
    SamplingError
        If they leave more than three times the error allowed.
    """
    try:
        found = probe(scene, counts_for(scene.object_grid, width_mm), mapper)
    except RayMapError as problem:
        raise SamplingError(f"tile_width_mm = {width_mm:g}: {problem}") from problem
    left = found.error(quadratic, error)
    if left > error:
        message = (
            f"tile_width_mm = {width_mm:g}: leaves a relative error of {left:.2g}, {error:.2g} is allowed; "
            "make tiles narrower, or allow more"
        )
        if left > REFUSED * error:
            raise SamplingError(message)
        warnings.warn(message, SamplingWarning, stacklevel=2)
    return found


def expansion(residual: Residual, quadratic: Quadratic, error: float) -> Separable:
    """Terms of one tile."""
    return residual.mean_term() if quadratic == "mean" else residual.low_rank(error)
