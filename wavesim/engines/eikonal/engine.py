"""Eikonal tiles: rays carry the phase, Fourier transforms carry the object.

The object is cut into tiles. For a point c + d of a tile with centre c, the optical path to a sensor point s
is that of c minus p(s).d, apart from a small residual. The field of a tile is therefore a spectrum at the
directions p(s), times a exp(i k V). On a plane

    U(s) = lambda^(-1) a exp(i k V - i pi/2) sum_r u_r(s) integral of O(d) v_r(d) exp(-i k p(s).d);

on a line, the powers of lambda and the constant phase are half of these. Amplitude a and path V come from
rays. The method is the leading order in wavelength over the distances to caustics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property, partial
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError, SamplingError, validate_choice, validate_positive
from wavesim.engines.eikonal.cost import tiles_cost
from wavesim.engines.eikonal.edge_errors import drawn_error, edge_error, shared_spans
from wavesim.engines.eikonal.edge_illumination import edge_illumination
from wavesim.engines.eikonal.flat_tiles import (
    Tile,
    TileOperator,
    add_tiles,
    add_tiles_adjoint,
    at_once,
    precision_for,
)
from wavesim.engines.eikonal.plan import Probe, checked_probe, chosen_probe, expansion, residual_of
from wavesim.engines.eikonal.residual import Quadratic, Separable
from wavesim.rays.exit_planes import ExitPlane, exit_plane
from wavesim.rays.maps import RayMap, RayMapError, ray_map
from wavesim.rays.ray_bundles import FoldError
from wavesim.runtime.fourier.nonuniform import Precision
from wavesim.runtime.threads import THREADS, one_blas_thread
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

TILE_FRACTION, LEAST_ERROR, MOST_ERROR = 0.5, 1e-5, 0.05
"""Fraction of the allowed error that the width of the tiles may cause, with a lower and an upper limit."""

NARROWEST, NARROWEST_DRAWN = 8, 2
"""Narrowest tile that the choice of an engine tries, and that comparisons show, in object samples."""


class EikonalTiles(Engine):
    """Eikonal tiles.

    Parameters
    ----------
    scene : Scene
        Lens, grids and wavelength.
    tile_width_mm : float, optional
        Largest side of a tile. Default: by the allowed error.
    error : float
        Relative L2 error of the exit field that tiles may cause, for an object that fills them evenly with
        light of all directions.
    quadratic : {"low-rank", "mean"}
        Representation of the path over a tile beyond the linear term in d: a short sum of products, or its
        mean over the footprint. With the mean, tiles must be narrower.
    plane_z_mm : float, optional
        z of the plane behind the lens on which tiles are summed, where rays must not fold; free space lies
        between it and the exit grid. Default: the exit grid's, or one that is free of folds.

    Raises
    ------
    InputError
        If a setting is not usable, or no ray passes the lens.
    FoldError
        On first use, if rays fold on the given plane, or on all planes.
    SamplingError
        On first use, if the error of tiles of the given width exceeds three times the allowed error. A
        smaller excess causes a SamplingWarning.
    """

    name = "eikonal"
    gain = 0.95

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        """Yield the widest tiles, then narrower ones."""
        expansion_error = float(np.clip(TILE_FRACTION * error, LEAST_ERROR, MOST_ERROR))
        yield {"error": expansion_error}
        width = 0.5 * cls(scene, error=expansion_error).settings()["tile_width_mm"]
        while width > 0.5 * NARROWEST * scene.object_grid.pitch_mm:
            yield {"error": expansion_error, "tile_width_mm": width}
            width *= 0.5

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        curves: dict[str, list[dict[str, Any]]] = {
            f"eikonal, {kind}": [
                {"error": error, "quadratic": kind} for error in (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)
            ]
            for kind in ("low-rank", "mean")
        }
        grid = scene.object_grid
        finer = range(
            2, math.floor(math.log2(max(grid.shape) / NARROWEST_DRAWN)) + 1, 2 if grid.is_line else 1
        )
        side = (1.0 + 1e-9) * max(grid.shape) * grid.pitch_mm
        curves["eikonal, narrow tiles"] = [{"error": 1e-3, "tile_width_mm": side / 2**n} for n in finer]
        return curves

    def __init__(
        self,
        scene: Scene,
        *,
        tile_width_mm: float | None = None,
        error: float = 1e-2,
        quadratic: Quadratic = "low-rank",
        plane_z_mm: float | None = None,
    ) -> None:
        super().__init__(scene)
        if tile_width_mm is not None:
            validate_positive("tile_width_mm", tile_width_mm)
        if not LEAST_ERROR <= error <= 1.0:
            raise InputError(f"error = {error!r}: must be from 1e-5 to 1")
        validate_choice("quadratic", quadratic, get_args(Quadratic))
        if plane_z_mm is not None and not math.isfinite(plane_z_mm):
            raise InputError(f"plane_z_mm = {plane_z_mm!r}: must be finite")
        self._tile_width_mm, self._error, self._quadratic = tile_width_mm, error, quadratic
        self._plane_z_mm = plane_z_mm
        # Fraction of the allowed error that the expansion of a tile may cause.
        expansion_fraction = 0.5
        self._allowed = expansion_fraction * error if quadratic == "low-rank" else error
        self._maps: dict[tuple[float, float], RayMap] = {}
        self._operators: dict[np.dtype[Any], tuple[TileOperator, ...]] = {}

    @cached_property
    def plane(self) -> ExitPlane:
        """Plane on which tiles are summed, and the free space behind it."""
        return exit_plane(self.scene, self._plane_z_mm)

    @cached_property
    def probe(self) -> Probe:
        """Cut of the object into tiles, and the residuals of some of them.

        If rays outside the rim can be traced for the object's centre but not for its corners, edges stay
        sharp.
        """
        try:
            return self._probed()
        except SamplingError as problem:
            if not (self._draws_edges and isinstance(problem.__cause__, RayMapError)):
                raise
        self._draws_edges = False
        self._maps.clear()
        return self._probed()

    def _probed(self) -> Probe:
        with one_blas_thread():
            if self._tile_width_mm is None:
                return chosen_probe(self.scene, self._allowed, self._quadratic, self._map)
            return checked_probe(self.scene, self._tile_width_mm, self._allowed, self._quadratic, self._map)

    @cached_property
    def _draws_edges(self) -> bool:
        """True if ray maps represent the Fresnel diffraction at the rim for the object's centre.

        They do not where rays outside the rim are too irregular, such as for a figure that is measured up to
        it.
        """
        middle = self.scene.object_grid.centre_mm
        try:
            found = self._traced_map(middle, True)
        except (FoldError, RayMapError):
            return False
        if found.resolves_edge:
            self._maps[middle] = found
        return found.resolves_edge

    def _map(self, point_mm: tuple[float, float]) -> RayMap:
        edge = self._draws_edges
        if point_mm not in self._maps:
            self._maps[point_mm] = self._traced_map(point_mm, edge)
        return self._maps[point_mm]

    def _traced_map(self, point_mm: tuple[float, float], edge: bool) -> RayMap:
        reach_mm = max(self.scene.object_grid.half_widths_mm)
        return ray_map(self.scene, point_mm, self.plane.grid.z_mm, reach_mm, edge=edge)

    def _expansions(self) -> list[Separable]:
        allowed = max(self._allowed, self.probe.error(self._quadratic, self._allowed))
        known = dict(zip(self.probe.probed, self.probe.residuals, strict=True))

        def of_tile(index: int, tile: Tile) -> Separable:
            residual = known.get(index) or residual_of(self.scene, tile, self._map)
            return expansion(residual, self._quadratic, allowed)

        return at_once([partial(of_tile, *indexed) for indexed in enumerate(self.probe.tiles)])

    def _prepared(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        if dtype not in self._operators:
            with one_blas_thread():
                self._operators[dtype] = self._tile_operators(precision_for(dtype, self._error))
        return self._operators[dtype]

    def _tile_operators(self, precision: Precision) -> tuple[TileOperator, ...]:
        grid = self.plane.grid
        axes = (grid.y_mm, grid.x_mm)[: len(grid.shape)]
        tiles = self.probe.tiles
        expansions = self._expansions()
        carriers = [self._map(tile.centre_mm) for tile in tiles]
        if self._draws_edges:
            spans = [carrier.row_spans(axes) for carrier in carriers]
        else:
            spans = shared_spans(self.scene, tiles, carriers, axes)
        threads = max(1, THREADS // len(tiles))

        def operator_of(index: int) -> TileOperator:
            own = tiles[index], carriers[index], expansions[index], axes, spans[index]
            return TileOperator(self.scene, *own, precision, threads)

        return tuple(at_once([partial(operator_of, index) for index in range(len(tiles))]))

    def _forward(self, values: Any) -> Any:
        field = _complex_field(values)
        result = np.zeros(self.plane.grid.shape, field.dtype)
        scaled = field * field.real.dtype.type(self.scene.object_grid.cell)
        add_tiles(self._prepared(field.dtype), scaled, result)
        if self.plane.beyond is None:
            return result
        return self.plane.beyond.forward(result.astype(complex)).astype(field.dtype)

    def tile_operators(self, dtype: np.dtype[Any]) -> Iterator[tuple[Tile, RayMap, TileOperator]]:
        """Yield each tile, the ray map of its centre, and its operator for fields of a type."""
        for tile, operator in zip(self.probe.tiles, self._prepared(dtype), strict=True):
            yield tile, self._map(tile.centre_mm), operator

    def _adjoint(self, values: Any) -> Any:
        field = np.ascontiguousarray(_complex_field(values))
        dtype = field.dtype
        if self.plane.beyond is not None:
            field = self.plane.beyond.adjoint(field.astype(complex)).astype(dtype)
        result = np.zeros(self.scene.object_grid.shape, dtype)
        add_tiles_adjoint(self._prepared(dtype), field, result)
        return result * result.real.dtype.type(self.plane.grid.cell)

    def settings(self) -> dict[str, Any]:
        grid = self.scene.object_grid
        width = max(n * grid.pitch_mm / c for n, c in zip(grid.shape, self.probe.counts, strict=True))
        return {
            "tile_width_mm": width,
            "error": self._error,
            "quadratic": self._quadratic,
            "plane_z_mm": self.plane.grid.z_mm,
        }

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        rms, largest = self.probe.neglected_waves
        count, rank = len(self.probe.tiles), 1
        expansion_error = self.probe.error(self._quadratic, self._allowed)
        if self._quadratic == "low-rank":
            rank = self.probe.rank_for(self._allowed)
        description = (
            f"path of second and higher order in a tile's offset, beyond {rank} term(s) in each of {count} "
            f"tile(s); beyond their mean it is {rms:.2g} waves rms, {largest:.2g} at most"
        )
        middle = self.probe.tiles[len(self.probe.tiles) // 2]
        carrier = self._map(middle.centre_mm)
        moved, sharp = edge_error(self.scene, middle, carrier)
        drawn = drawn_error(self.scene, middle, carrier, sharp)
        terms = (
            ErrorTerm(description, expansion_error),
            ErrorTerm("movement of the aperture's edge over a tile", moved, at_rim=True),
            ErrorTerm("diffraction at the aperture's edge, beyond Fresnel's", drawn, at_rim=True),
        )
        return tuple(sorted(terms, key=lambda term: -term.relative_error))

    def edge_illumination(self, light: Light) -> float:
        return edge_illumination(self.scene, self.probe.tiles, self.plane.grid.z_mm, light)

    def cost(self) -> Cost:
        rank = self.probe.rank_for(self._allowed) if self._quadratic == "low-rank" else 1
        return tiles_cost(
            self.scene,
            self.plane,
            self.probe.tiles,
            rank,
            self._quadratic == "low-rank",
            self._map,
            self._error,
        )


def _complex_field(values: Any) -> NDArray[np.complexfloating]:
    field = np.asarray(values)
    return field if field.dtype == np.complex64 else field.astype(np.complex128, copy=False)
