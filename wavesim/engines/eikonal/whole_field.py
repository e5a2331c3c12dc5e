"""Eikonal tiles of a whole field, summed in two levels.

As :mod:`wavesim.engines.eikonal.engine`, for fields of millimetres: tiles are summed about the carrier of
their super-tile on a coarse grid, and super-tiles are summed on the plane. Neighbouring tiles share rays
(:mod:`wavesim.engines.eikonal.ray_maps`), and only a few polynomials of a tile are stored between uses.
All values are complex64; phases are computed in float64.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_positive
from wavesim.engines.eikonal.edge_errors import edge_error, rim_fraction_per_mm
from wavesim.engines.eikonal.edge_illumination import edge_illumination
from wavesim.engines.eikonal.engine import MOST_ERROR, TILE_FRACTION
from wavesim.engines.eikonal.executors import Band, Executor, Part, Progress, Sums, ThisComputer
from wavesim.engines.eikonal.factors import factors_over_object
from wavesim.engines.eikonal.flat_tiles import Tile
from wavesim.engines.eikonal.plan import counts_for, cut
from wavesim.engines.eikonal.ray_maps import MapsOverObject, Region, maps_over_object, region_of_object
from wavesim.engines.eikonal.soft_edge import soft_edge_error, softness
from wavesim.engines.eikonal.super_tiles import (
    TAPER,
    TAPER_LOSS,
    SuperTile,
    WholeFieldSettings,
)
from wavesim.engines.eikonal.whole_field_cost import whole_field_cost
from wavesim.fields.field import Field
from wavesim.fields.resampling import kernel_for
from wavesim.rays.maps import RayMap, RayMapError, ray_map
from wavesim.rays.ray_bundles import FoldError
from wavesim.runtime.fourier.nonuniform import Precision
from wavesim.runtime.memory import COMPLEX64
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Cost, ErrorTerm, Tiled
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

EXPANSION_FRACTION, MAPS_FRACTION, INTERPOLATION_FRACTION, TRANSFORM_FRACTION = 0.5, 0.01, 0.1, 0.05
"""Fraction of the allowed error that each step may cause; that of the maps is in waves."""


LEAST_ERROR = 1e-4
"""Smallest error that can be requested, since values are complex64."""


Cut = tuple[tuple[Tile, tuple[int, ...]], ...]
"""Tiles, each with the position of its super-tile."""


def tile_width_for(scene: Scene) -> float:
    """Return the width in mm of tiles whose residual a few terms describe."""
    zone_mm = math.sqrt(1e-3 * scene.wavelength_um * -scene.object_grid.z_mm)
    # Width over sqrt(wavelength x working distance) / NA for which a few terms describe the residual.
    zones = 0.74
    return zones * zone_mm / scene.lens.object.numerical_aperture


def tiles_along(scene: Scene) -> float:
    """Return the number of such tiles along the object's longer side; 0 on a line, which is not supported."""
    grid = scene.object_grid
    return 0.0 if grid.is_line else max(grid.shape) * grid.pitch_mm / tile_width_for(scene)


class WholeFieldEngine(Tiled):
    """Eikonal tiles summed in two levels, for planes.

    Attributes
    ----------
    elsewhere : Executor or None
        Executor of super-tiles on other computers; None for this computer.

    Parameters
    ----------
    scene : Scene
        Lens, grids and wavelength. Object samples outside the lens's field count as dark.
    tile_width_mm : float, optional
        Largest side of a tile. Default: a width for which four or five terms describe the residual.
    tiles_across : int
        Tiles along each side of a super-tile.
    error : float
        Relative L2 error of the exit field that tiles and interpolation may cause.

    Raises
    ------
    InputError
        If a setting is not usable, or the scene is a line.
    FoldError
        On first use, if rays fold on the exit grid's plane.
    RayMapError
        On first use, if polynomials do not fit the rays, or tiles are too wide.
    """

    name = "hierarchical"

    key_name = "two-level"

    elsewhere: Executor | None = None

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        # Number of tiles along a side of the object above which two levels are worth their set-up.
        many_tiles = 16
        if tiles_along(scene) > many_tiles:
            yield {"error": float(np.clip(TILE_FRACTION * error, LEAST_ERROR, MOST_ERROR))}

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        if scene.object_grid.is_line:
            return {}
        return {"two level": [{"error": error} for error in (0.3, 0.03, 3e-3)]}

    def __init__(
        self,
        scene: Scene,
        *,
        tile_width_mm: float | None = None,
        tiles_across: int = 4,
        error: float = 1e-2,
    ) -> None:
        super().__init__(scene)
        if scene.object_grid.is_line:
            raise InputError("engine hierarchical does not support a line as object; use engine eikonal")
        if tile_width_mm is not None:
            validate_positive("tile_width_mm", tile_width_mm)
        if not 1 <= tiles_across <= 100:
            raise InputError(f"tiles_across = {tiles_across!r}: must be from 1 to 100")
        if not LEAST_ERROR <= error <= 1.0:
            raise InputError(f"error = {error!r}: must be from {LEAST_ERROR:g} to 1")
        self._asked_width_mm, self._tiles_across, self._error = tile_width_mm, tiles_across, error

    @cached_property
    def region(self) -> Region:
        """The part of the object plane that is propagated."""
        return region_of_object(self.scene)

    @cached_property
    def _prepared(self) -> tuple[float, Cut, WholeFieldSettings]:
        """Width of tiles, the tiles, and their common settings; narrower where the first are too wide."""
        width, maps = self._asked_width_mm or tile_width_for(self.scene), None
        # Number of times that tiles of default width are halved where rays cannot be traced all over them.
        narrowings = 3
        for narrower in range(narrowings, -1, -1):
            tiles = self._tiles(width)
            spans_mm = _shared_spans(tiles)
            if maps is None:  # narrower tiles need no more accurate maps
                maps = self._maps(spans_mm)
            try:
                return width, tiles, self._followed(maps, spans_mm)
            except RayMapError:
                if self._asked_width_mm is not None or narrower == 0:
                    raise
            width *= 0.5
        raise AssertionError

    def _tiles(self, width_mm: float) -> Cut:
        """Return the tiles that extend into the field, each with the position of its super-tile."""
        counts = counts_for(self.scene.object_grid, width_mm)
        radius = self.region.half_mm[0]
        found = []
        for number, tile in enumerate(cut(self.scene.object_grid, counts)):
            nearest = [
                max(abs(c) - float(np.max(np.abs(s))), 0.0)
                for c, s in zip(tile.centre_mm[::-1], tile.spans_mm, strict=True)
            ]
            if not self.region.is_disc or math.hypot(*nearest) < radius:
                place = (int(i) // self._tiles_across for i in np.unravel_index(number, counts))
                found.append((tile, tuple(place)))
        return tuple(found)

    def _maps(self, spans_mm: Array) -> MapsOverObject:
        scene, tolerance = self.scene, MAPS_FRACTION * self._error
        with one_blas_thread():
            return maps_over_object(scene, self.region, scene.exit_grid.z_mm, _reach_mm(spans_mm), tolerance)

    def _followed(self, maps: MapsOverObject, spans_mm: Array) -> WholeFieldSettings:
        scene, z_mm, error = self.scene, self.scene.exit_grid.z_mm, self._error
        with one_blas_thread():
            factors = factors_over_object(
                scene,
                self.region,
                spans_mm,
                lambda point: ray_map(scene, point, z_mm, _reach_mm(spans_mm)),
                EXPANSION_FRACTION * error,
            )
        transform_error = float(np.clip(TRANSFORM_FRACTION * error, 1e-5, 1e-3))
        interpolation_error = INTERPOLATION_FRACTION * error
        return WholeFieldSettings(
            scene,
            (scene.exit_grid.y_mm, scene.exit_grid.x_mm),
            maps,
            softness(self._middle),
            factors,
            kernel_for(interpolation_error),
            Precision(np.dtype(np.complex64), transform_error, interpolation_error),
        )

    @cached_property
    def _middle(self) -> RayMap:
        """Ray map of the centre of the region, with the diffraction at its edge where rays determine it."""
        y, x = self.region.centre_mm
        reach_mm = tile_width_for(self.scene)
        with one_blas_thread():
            try:
                return ray_map(self.scene, (x, y), self.scene.exit_grid.z_mm, reach_mm, edge=True)
            except (FoldError, RayMapError):
                return ray_map(self.scene, (x, y), self.scene.exit_grid.z_mm, reach_mm)

    @cached_property
    def groups(self) -> tuple[SuperTile, ...]:
        """Super-tiles whose light reaches the exit grid."""
        _, tiles, settings = self._prepared
        inside: dict[tuple[int, ...], list[Tile]] = {}
        for tile, place in tiles:
            inside.setdefault(place, []).append(tile)
        with one_blas_thread():
            groups = (SuperTile(settings, tuple(together)) for together in inside.values())
            return tuple(group for group in groups if not group.empty)

    @property
    def parts(self) -> int:
        return len(self.groups)

    @property
    def sums_bytes(self) -> int:
        return sum(COMPLEX64 * math.prod(group.shape) for group in self.groups)

    @property
    def _executor(self) -> Executor:
        return self.elsewhere or ThisComputer(self.groups, self.scene.exit_grid.shape)

    def _forward(self, values: Any) -> Any:
        plane = self._executor.plane(self._parts_of(values, range(self.parts)), self._progress_callback())
        return self._per_cell(plane)

    def _per_cell(self, rows: NDArray[np.complex64]) -> NDArray[np.complex64]:
        rows *= np.float32(self.scene.object_grid.cell)
        return rows

    def forward_in_bands(self, field: Field, rows: int, sums: Sums) -> Iterator[Band]:
        self._validate_field(field, self.scene.object_grid, "object")
        missing = [index for index in range(self.parts) if index not in sums]
        progress = self._progress_callback(self.parts - len(missing))
        parts = self._parts_of(field.values, missing)
        for band_rows, band in self._executor.bands(parts, sums, rows, progress):
            yield band_rows, self._per_cell(band)

    def adjoint_on(self, field: Field, indices: Sequence[int]) -> Field:
        self._validate_field(field, self.scene.exit_grid, "exit")
        index = float(self.scene.system.index[0, 0])
        values = self._adjoint(field.values, indices)
        return Field(self.scene.object_grid, values, field.wavelength_um, index)

    def _adjoint(self, values: Any, indices: Sequence[int] | None = None) -> Any:
        result = np.zeros(self.scene.object_grid.shape, np.complex64)
        plane = np.ascontiguousarray(values, np.complex64)
        chosen = range(self.parts) if indices is None else indices
        for index, part in self._executor.parts(plane, chosen, self._progress_callback()):
            samples = self.groups[index].part
            result[samples] += part * self._in_field(samples)
        result *= np.float32(self.scene.exit_grid.cell)
        return result

    def _parts_of(self, values: Any, indices: Iterable[int]) -> Iterator[Part]:
        """Yield the super-tiles' parts of an object field."""
        for index in indices:
            samples = self.groups[index].part
            yield index, np.where(self._in_field(samples), values[samples], 0.0).astype(np.complex64)

    def _in_field(self, samples: tuple[slice, slice]) -> NDArray[np.bool_]:
        """Return the mask of the samples of a part of the object that lie within the field."""
        grid, region = self.scene.object_grid, self.region
        radius2 = grid.y_mm[samples[0]][:, None] ** 2 + grid.x_mm[samples[1]] ** 2
        return np.asarray(radius2 <= (region.half_mm[0] ** 2 if region.is_disc else math.inf))

    def _progress_callback(self, completed: int = 0) -> Progress:
        """Return a callback that counts a completed super-tile and reports the progress."""
        counted = count(completed + 1)

        def progress() -> None:
            if self.progress is not None:
                self.progress(next(counted), self.parts)

        return progress

    def settings(self) -> dict[str, Any]:
        return {
            "tile_width_mm": self._prepared[0],
            "tiles_across": self._tiles_across,
            "error": self._error,
        }

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        _, tiles, settings = self._prepared
        path, amplitude, direction = settings.maps.errors
        maps = math.hypot(2.0 * math.pi * path, amplitude, 2.0 * math.pi * direction)
        terms = (
            ErrorTerm(
                "path of second and higher order in a tile's offset, beyond "
                f"{len(settings.factors.tile_nodes)} terms in each of {len(tiles)} tiles",
                settings.factors.relative_error,
            ),
            ErrorTerm("interpolation between traced rays", maps),
            ErrorTerm("interpolation in two levels", math.sqrt(2.0) * INTERPOLATION_FRACTION * self._error),
            *self._neglected_at_rim(),
        )
        return tuple(sorted(terms, key=lambda term: -term.relative_error))

    def _neglected_at_rim(self) -> Iterator[ErrorTerm]:
        _, tiles, settings = self._prepared
        carrier, placed_mm = self._middle, settings.maps.edge_error_mm
        widest = np.max([group.steps_mm for group in self.groups], axis=0)
        rise = settings.rise_over(widest)
        if carrier.resolves_edge:
            what = f"diffraction at the aperture's edge, soft over {100.0 * rise:.2g} % of the footprint"
            error = soft_edge_error(carrier, settings.factors.spans_mm, rise)
            yield ErrorTerm(f"{what} and equal for all points of a tile", error, at_rim=True)
        else:
            moved, diffracted = edge_error(self.scene, tiles[len(tiles) // 2][0], carrier)
            yield ErrorTerm("movement of the aperture's edge over a tile", moved, at_rim=True)
            yield ErrorTerm(
                "diffraction at the aperture's edge in front of the plane", diffracted, at_rim=True
            )
            placed_mm += TAPER * TAPER_LOSS * float(np.max(widest))
        place = math.sqrt(rim_fraction_per_mm(carrier.rim_mm) * placed_mm)
        yield ErrorTerm("position of the aperture's edge", min(1.0, place), at_rim=True)

    def edge_illumination(self, light: Light) -> float:
        tiles = [tile for tile, _ in self._prepared[1]]
        return edge_illumination(self.scene, tiles, self.scene.exit_grid.z_mm, light)

    def cost(self) -> Cost:
        return whole_field_cost(self.scene, self._prepared[2], self.groups)


def _shared_spans(tiles: Cut) -> Array:
    """Return the largest extent of the tiles about their centres, shape (2, 2)."""
    spans = np.array([tile.spans_mm for tile, _ in tiles])
    return np.column_stack([spans[:, :, 0].min(axis=0), spans[:, :, 1].max(axis=0)])


def _reach_mm(spans_mm: Array) -> float:
    """Return the largest distance of a tile's points from its centre."""
    return float(np.linalg.norm(np.max(np.abs(spans_mm), axis=1)))
