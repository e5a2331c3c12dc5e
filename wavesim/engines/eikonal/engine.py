"""Eikonal tiles: rays carry the phase, Fourier transforms carry the object.

The object is cut into tiles. For a point c + d of a tile with centre c, the optical path to a sensor point s
is that of c minus p(s).d, apart from a small residual. The field of a tile is therefore a spectrum at the
directions p(s), times a exp(i k V). On a plane

    U(s) = lambda^(-1) a exp(i k V - i pi/2) sum_r u_r(s) integral of O(d) v_r(d) exp(-i k p(s).d);

on a line, the powers of lambda and the constant phase are half of these. Amplitude a and path V come from
rays. The method is the leading order in wavelength over the distances to caustics.

Tiles are flat or form a hierarchy. Flat tiles are propagated to the plane one by one: each has its own rays,
its own diffraction at the aperture's edge, and a carrier that is stored between uses. In a hierarchy, tiles
are summed about the carrier of their super-tile on a coarse grid, and super-tiles are summed on the plane.
All tiles share rays, only a few polynomials are stored, and the edge is soft. A hierarchy serves fields of
millimetres; its values are complex64, with phases in float64.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, partial
from hashlib import sha256
from itertools import count
from typing import Any, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, SamplingError, validate_choice, validate_positive
from wavesim.engines.eikonal.cost import flat_cost, hierarchical_cost
from wavesim.engines.eikonal.edge import (
    edge_illumination,
    edge_map,
    edge_terms,
    rim_fraction_per_mm,
    shared_spans,
    soft_edge_term,
    softness,
)
from wavesim.engines.eikonal.executors import Band, Executor, Part, Progress, Sums, ThisComputer
from wavesim.engines.eikonal.flat_tiles import (
    TileOperator,
    add_tiles,
    add_tiles_adjoint,
    precision_for,
    type_of,
)
from wavesim.engines.eikonal.plan import (
    Cut,
    Probe,
    Tile,
    checked_probe,
    chosen_probe,
    cut_hierarchy,
    expansion,
    hierarchy_is_cheaper,
    residual_of,
    shared_tile_width_mm,
)
from wavesim.engines.eikonal.ray_maps import MapsOverObject, Region, maps_over_object, region_of_object
from wavesim.engines.eikonal.residual import Quadratic, Separable, factors_over_object
from wavesim.engines.eikonal.super_tiles import TAPER, TAPER_LOSS, SharedTileData, SuperTile
from wavesim.fields.field import Field
from wavesim.fields.resampling import kernel_for
from wavesim.rays.exit_planes import ExitPlane, exit_plane
from wavesim.rays.maps import RayMap, RayMapError, ray_map
from wavesim.runtime.fourier.nonuniform import Precision, rounding_error
from wavesim.runtime.memory import COMPLEX64
from wavesim.runtime.threads import THREADS, at_once, one_blas_thread
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Tiled
from wavesim.scene.polarization import components_of, is_vector
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene

NARROWEST, NARROWEST_DRAWN = 8, 2
"""Narrowest tile that the choice of an engine tries, and that comparisons show, in object samples."""


class EikonalEngine(Engine):
    """Eikonal tiles, flat or in a hierarchy.

    The engine chooses a hierarchy where the object needs more than 16 tiles along a side, or where flat tiles
    would need more than 20 GB. A line, `plane_z_mm` and `quadratic` need flat tiles. An instance is of class
    :class:`FlatTiles` or :class:`HierarchicalTiles`.

    Parameters
    ----------
    scene : Scene
        Lens, grids and wavelength. In a hierarchy, object samples outside the lens's field count as dark.
    tile_width_mm : float, optional
        Largest side of a tile. Default: by the allowed error, or, in a hierarchy, a width for which four or
        five terms describe the residual.
    error : float
        Relative L2 error of the exit field that tiles may cause, for an object that fills them evenly with
        light of all directions.
    hierarchical : bool, optional
        Whether tiles form a hierarchy. Default: the engine's choice.
    tiles_across : int
        Tiles along each side of a super-tile of a hierarchy.
    quadratic : {"low-rank", "mean"}
        Representation of the path over a flat tile beyond the linear term in d: a short sum of products, or
        its mean over the footprint. With the mean, tiles must be narrower.
    plane_z_mm : float, optional
        z of the plane behind the lens on which flat tiles are summed, where rays must not fold; free space
        lies between it and the exit grid. Default: the exit grid's, or one that is free of folds.

    Raises
    ------
    InputError
        If a setting is not usable, or no ray passes the lens.
    FoldError
        On first use, if rays fold on the given plane, or on all planes; in a hierarchy, on the exit grid's.
    SamplingError
        On first use, if the error of flat tiles of the given width exceeds three times the allowed error. A
        smaller excess causes a SamplingWarning.
    RayMapError
        On first use, if polynomials do not fit the rays of a hierarchy, or its tiles are too wide.
    """

    name = "eikonal"

    least_error = 1e-5
    """Smallest error that can be requested."""

    most_error = 0.05
    """Largest error of tiles that the choice of an engine tries."""

    def __new__(cls, *arguments: Any, **settings: Any) -> Self:
        if cls is EikonalEngine:
            cls = _class_for(*arguments, **settings)  # type: ignore[assignment]
        return super().__new__(cls)

    def __init__(
        self,
        scene: Scene,
        *,
        tile_width_mm: float | None = None,
        error: float = 1e-2,
        hierarchical: bool | None = None,
        tiles_across: int = 4,
        quadratic: Quadratic = "low-rank",
        plane_z_mm: float | None = None,
    ) -> None:
        super().__init__(scene)
        hierarchy = isinstance(self, HierarchicalTiles)
        if hierarchical not in (None, hierarchy):
            raise InputError(f"hierarchical = {hierarchical}: must be {hierarchy} with engine {self.name}")
        if tile_width_mm is not None:
            validate_positive("tile_width_mm", tile_width_mm)
        if not self.least_error <= error <= 1.0:
            least = f"{self.least_error:.0e}".replace("e-0", "e-")
            raise InputError(f"error = {error!r}: must be from {least} to 1")
        if not 1 <= tiles_across <= 100:
            raise InputError(f"tiles_across = {tiles_across!r}: must be from 1 to 100")
        validate_choice("quadratic", quadratic, get_args(Quadratic))
        if plane_z_mm is not None and not math.isfinite(plane_z_mm):
            raise InputError(f"plane_z_mm = {plane_z_mm!r}: must be finite")
        if hierarchy:
            _check_hierarchy_is_possible(scene, quadratic=quadratic, plane_z_mm=plane_z_mm)
        self._asked_width_mm, self._error, self._tiles_across = tile_width_mm, error, tiles_across
        self._quadratic, self._asked_plane_z_mm = quadratic, plane_z_mm

    @classmethod
    def implementations(cls) -> tuple[type[Engine], ...]:
        return (FlatTiles, HierarchicalTiles) if cls is EikonalEngine else (cls,)

    @classmethod
    def _tile_error(cls, error: float) -> float:
        """Return the error that tiles may cause where the whole engine has an error limit."""
        # Fraction of the allowed error that the width of the tiles may cause.
        tile_fraction = 0.5
        return float(np.clip(tile_fraction * error, cls.least_error, cls.most_error))

    @property
    @abstractmethod
    def tiles(self) -> tuple[Tile, ...]:
        """Tiles of the object."""

    @property
    @abstractmethod
    def _plane_z_mm(self) -> float:
        """The z of the plane on which tiles are summed."""

    @abstractmethod
    def _terms(self) -> Iterator[ErrorTerm]:
        """Yield the error terms in any order."""

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return tuple(sorted(self._terms(), key=lambda term: -term.relative_error))

    def edge_illumination(self, light: Light) -> float:
        return edge_illumination(self.scene, self.tiles, self._plane_z_mm, light)


def _class_for(scene: Scene, *, hierarchical: bool | None = None, **settings: Any) -> type[EikonalEngine]:
    """Return the class of an engine's tiles, for the settings of :class:`EikonalEngine`."""
    if hierarchical is None:
        flat = any(settings.get(name) is not None for name in ("quadratic", "plane_z_mm"))
        flat = flat or is_vector(scene.polarization)
        hierarchical = not flat and ("tiles_across" in settings or hierarchy_is_cheaper(scene))
    return HierarchicalTiles if hierarchical else FlatTiles


def _check_hierarchy_is_possible(scene: Scene, *, quadratic: Quadratic, plane_z_mm: float | None) -> None:
    if scene.object_grid.is_line:
        raise InputError("engine hierarchical does not support a line as object; use engine eikonal")
    for name, value, default in (("quadratic", quadratic, "low-rank"), ("plane_z_mm", plane_z_mm, None)):
        if value != default:
            raise InputError(
                f"{name} = {value!r}: has no effect with engine hierarchical; remove it or use engine eikonal"
            )


def _kept_flat(scene: Scene) -> dict[str, Any]:
    """Return the setting that keeps tiles flat, if the engine would choose a hierarchy for a scene."""
    needs_setting = hierarchy_is_cheaper(scene) and not is_vector(scene.polarization)
    return {"hierarchical": False} if needs_setting else {}


class FlatTiles(EikonalEngine):
    """Eikonal tiles that are propagated to the plane one by one; settings are those of `EikonalEngine`.

    They carry the components of light with a polarization. All components share phases and transforms.
    """

    gain = 0.95

    carries_polarization = True

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        """Yield the widest tiles, then narrower ones."""
        own = {"error": cls._tile_error(error), **_kept_flat(scene)}
        yield own
        width = 0.5 * cls(scene, **own).settings()["tile_width_mm"]
        while width > 0.5 * NARROWEST * scene.object_grid.pitch_mm:
            yield {**own, "tile_width_mm": width}
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
        curves["eikonal, narrow tiles"] = [
            {"error": 1e-3, "tile_width_mm": side / 2**n, **_kept_flat(scene)} for n in finer
        ]
        return curves

    @cached_property
    def other_wavelengths(self) -> dict[float, FlatTiles]:
        """Tiles of the same scene for other wavelengths, stored by those who need them again."""
        return {}

    @cached_property
    def plane(self) -> ExitPlane:
        """Plane on which tiles are summed, and the free space behind it."""
        return exit_plane(self.scene, self._asked_plane_z_mm)

    @property
    def _plane_z_mm(self) -> float:
        return self.plane.grid.z_mm

    @property
    def _allowed(self) -> float:
        """Error that the expansion of a tile may cause."""
        expansion_fraction = 0.5
        return expansion_fraction * self._error if self._quadratic == "low-rank" else self._error

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
            if self._asked_width_mm is None:
                return chosen_probe(self.scene, self._allowed, self._quadratic, self._map)
            return checked_probe(self.scene, self._asked_width_mm, self._allowed, self._quadratic, self._map)

    @property
    def tiles(self) -> tuple[Tile, ...]:
        return self.probe.tiles

    @cached_property
    def _maps(self) -> dict[tuple[float, float], RayMap]:
        """Ray maps of tile centres (x, y)."""
        return {}

    @cached_property
    def _draws_edges(self) -> bool:
        """True if ray maps represent the Fresnel diffraction at the rim for the object's centre."""
        middle = self.scene.object_grid.centre_mm
        found = edge_map(self.scene, middle, self._plane_z_mm, self._reach_mm)
        if found is not None:
            self._maps[middle] = found
        return found is not None

    @property
    def _reach_mm(self) -> float:
        """Extent of the object about a tile's centre for which directions must be accurate."""
        return max(self.scene.object_grid.half_widths_mm)

    def _map(self, point_mm: tuple[float, float]) -> RayMap:
        edge = self._draws_edges
        if point_mm not in self._maps:
            self._maps[point_mm] = ray_map(self.scene, point_mm, self._plane_z_mm, self._reach_mm, edge=edge)
        return self._maps[point_mm]

    def _expansions(self) -> list[Separable]:
        allowed = max(self._allowed, self.probe.error(self._quadratic, self._allowed))
        known = dict(zip(self.probe.probed, self.probe.residuals, strict=True))

        def of_tile(index: int, tile: Tile) -> Separable:
            residual = known.get(index) or residual_of(self.scene, tile, self._map)
            return expansion(residual, self._quadratic, allowed)

        return at_once([partial(of_tile, *indexed) for indexed in enumerate(self.tiles)])

    @cached_property
    def _operators(self) -> dict[np.dtype[Any], tuple[TileOperator, ...]]:
        """Operators of all tiles, by the data type of fields."""
        return {}

    def _prepared(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        if dtype not in self._operators:
            with one_blas_thread():
                self._operators[dtype] = self._build_operators(dtype)
        return self._operators[dtype]

    def _build_operators(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        precision, grid = precision_for(dtype, self._error), self.plane.grid
        axes = (grid.y_mm, grid.x_mm)[: len(grid.shape)]
        tiles = self.tiles
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

    def tile_operators(self, dtype: np.dtype[Any]) -> Iterator[tuple[Tile, RayMap, TileOperator]]:
        """Yield each tile, the ray map of its centre, and its operator for fields of a type."""
        for tile, operator in zip(self.tiles, self._prepared(dtype), strict=True):
            yield tile, self._map(tile.centre_mm), operator

    @property
    def components(self) -> int:
        return max(1, len(components_of(self.scene.polarization)))

    def component(self, index: int) -> Engine:
        return OneComponent(self, index) if is_vector(self.scene.polarization) else super().component(index)

    def _forward(self, values: Any) -> Any:
        self._validate_scalar()
        return self._forward_components(values, (None,))[0]

    def _adjoint(self, values: Any) -> Any:
        self._validate_scalar()
        return self._adjoint_components([values], (None,))

    def _forward_components(self, values: Any, components: Sequence[int | None]) -> list[Any]:
        field = _complex_field(values)
        results = [np.zeros(self.plane.grid.shape, type_of(c, field.dtype)) for c in components]
        scaled = field * field.real.dtype.type(self.scene.object_grid.cell)
        add_tiles(self._prepared(field.dtype), scaled, results, components)
        beyond = self.plane.beyond
        if beyond is None:
            return results
        return [beyond.forward(result.astype(complex)).astype(result.dtype) for result in results]

    def _adjoint_components(self, planes: Sequence[Any], components: Sequence[int | None]) -> Any:
        dtype, beyond = _complex_field(planes[0]).dtype, self.plane.beyond
        fields = []
        for values, component in zip(planes, components, strict=True):
            own = np.asarray(values) if beyond is None else beyond.adjoint(np.asarray(values, complex))
            fields.append(np.ascontiguousarray(own, type_of(component, dtype)))
        result = np.zeros(self.scene.object_grid.shape, dtype)
        add_tiles_adjoint(self._prepared(dtype), fields, result, components)
        return result * result.real.dtype.type(self.plane.grid.cell)

    def settings(self) -> dict[str, Any]:
        grid = self.scene.object_grid
        width = max(n * grid.pitch_mm / c for n, c in zip(grid.shape, self.probe.counts, strict=True))
        return {
            "tile_width_mm": width,
            "error": self._error,
            "quadratic": self._quadratic,
            "plane_z_mm": self._plane_z_mm,
        }

    @property
    def _rank(self) -> int:
        """Largest number of terms of a tile's expansion."""
        return self.probe.rank_for(self._allowed) if self._quadratic == "low-rank" else 1

    def _terms(self) -> Iterator[ErrorTerm]:
        rms, largest = self.probe.neglected_waves
        yield ErrorTerm(
            f"path of second and higher order in a tile's offset, beyond {self._rank} term(s) in each of "
            f"{len(self.tiles)} tile(s); beyond their mean it is {rms:.2g} waves rms, {largest:.2g} at most",
            self.probe.error(self._quadratic, self._allowed),
        )
        middle = self.tiles[len(self.tiles) // 2]
        yield _rounding_term(self.tiles)
        yield from edge_terms(self.scene, middle, self._map(middle.centre_mm))

    def cost(self) -> Cost:
        return flat_cost(
            self.scene,
            self.plane,
            self.tiles,
            self._rank,
            self._quadratic == "low-rank",
            self._map,
            self._error,
        )


class OneComponent(Engine):
    """One component of the field of an engine that carries light with a polarization.

    Parameters
    ----------
    whole : FlatTiles
        Engine of all components.
    index : int
        Index of the component.
    """

    name = FlatTiles.name
    carries_polarization = True

    def __init__(self, whole: FlatTiles, index: int) -> None:
        super().__init__(whole.scene)
        if not 0 <= index < whole.components:
            raise InputError(f"component = {index}: must be from 0 to {whole.components - 1}")
        self.whole, self.index = whole, index

    def at_wavelength(self, wavelength_um: float) -> Engine:
        return self.whole.at_wavelength(wavelength_um).component(self.index)

    def _forward(self, values: Any) -> Any:
        return self.whole._forward_components(values, (self.index,))[0]

    def _adjoint(self, values: Any) -> Any:
        return self.whole._adjoint_components([values], (self.index,))

    def cost(self) -> Cost:
        return self.whole.cost()

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return self.whole.error_terms()

    def edge_illumination(self, light: Light) -> float:
        return self.whole.edge_illumination(light)

    def settings(self) -> dict[str, Any]:
        return self.whole.settings()

    def key(self) -> str:
        return sha256(f"{self.whole.key()} component {self.index}".encode()).hexdigest()


def _complex_field(values: Any) -> NDArray[np.complexfloating]:
    field = np.asarray(values)
    return field if field.dtype == np.complex64 else field.astype(np.complex128, copy=False)


class _Prepared(NamedTuple):
    """Data of a hierarchy: width of its tiles, each tile with the position of its super-tile, shared data."""

    width_mm: float
    cut: Cut
    shared: SharedTileData


class HierarchicalTiles(EikonalEngine, Tiled):
    """Eikonal tiles of a plane that are summed in two levels; settings are those of `EikonalEngine`.

    Attributes
    ----------
    elsewhere : Executor or None
        Executor of super-tiles on other computers; None for this computer.
    """

    name = "hierarchical"

    key_name = "two-level"

    # Values are complex64.
    least_error = 1e-4

    # Fraction of the allowed error that the interpolation between grids may cause.
    _interpolation_fraction = 0.1

    elsewhere: Executor | None = None

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        if hierarchy_is_cheaper(scene) and not is_vector(scene.polarization):
            yield {"error": cls._tile_error(error)}

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        if scene.object_grid.is_line:
            return {}
        return {"hierarchical": [{"error": error} for error in (0.3, 0.03, 3e-3)]}

    @cached_property
    def region(self) -> Region:
        """The part of the object plane that is propagated."""
        return region_of_object(self.scene)

    @cached_property
    def _prepared(self) -> _Prepared:
        """Tiles and their shared data; narrower tiles where the first are too wide."""
        width, maps = self._asked_width_mm or shared_tile_width_mm(self.scene), None
        # Number of times that tiles of default width are halved where rays cannot be traced all over them.
        narrowings = 3
        for narrower in range(narrowings, -1, -1):
            cut = cut_hierarchy(self.scene.object_grid, width, self._tiles_across, self.region)
            spans_mm = _common_spans_mm(cut)
            if maps is None:  # narrower tiles need no more accurate maps
                maps = self._field_maps(spans_mm)
            try:
                return _Prepared(width, cut, self._shared_data(maps, spans_mm))
            except RayMapError:
                if self._asked_width_mm is not None or narrower == 0:
                    raise
            width *= 0.5
        raise AssertionError

    def _field_maps(self, spans_mm: Array) -> MapsOverObject:
        # Path error that maps may cause, in waves, as a fraction of the allowed error.
        maps_fraction = 0.01
        tolerance, reach_mm = maps_fraction * self._error, _reach_mm(spans_mm)
        with one_blas_thread():
            return maps_over_object(self.scene, self.region, self._plane_z_mm, reach_mm, tolerance)

    def _shared_data(self, maps: MapsOverObject, spans_mm: Array) -> SharedTileData:
        scene, z_mm, error = self.scene, self._plane_z_mm, self._error
        # Fractions of the allowed error that the expansion and the Fourier transform may cause.
        expansion_fraction, transform_fraction = 0.5, 0.05
        with one_blas_thread():
            factors = factors_over_object(
                scene,
                self.region,
                spans_mm,
                lambda point: ray_map(scene, point, z_mm, _reach_mm(spans_mm)),
                expansion_fraction * error,
            )
        transform_error = float(np.clip(transform_fraction * error, 1e-5, 1e-3))
        interpolation_error = self._interpolation_fraction * error
        return SharedTileData(
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
        reach_mm = shared_tile_width_mm(self.scene)
        with one_blas_thread():
            return edge_map(self.scene, (x, y), self._plane_z_mm, reach_mm) or ray_map(
                self.scene, (x, y), self._plane_z_mm, reach_mm
            )

    @property
    def tiles(self) -> tuple[Tile, ...]:
        return tuple(tile for tile, _ in self._prepared.cut)

    @property
    def _plane_z_mm(self) -> float:
        return self.scene.exit_grid.z_mm

    @cached_property
    def groups(self) -> tuple[SuperTile, ...]:
        """Super-tiles whose light reaches the exit grid."""
        inside: dict[tuple[int, ...], list[Tile]] = {}
        for tile, position in self._prepared.cut:
            inside.setdefault(position, []).append(tile)
        with one_blas_thread():
            groups = (SuperTile(self._prepared.shared, tuple(together)) for together in inside.values())
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
            "tile_width_mm": self._prepared.width_mm,
            "tiles_across": self._tiles_across,
            "error": self._error,
        }

    def _terms(self) -> Iterator[ErrorTerm]:
        shared = self._prepared.shared
        yield ErrorTerm(
            f"path of second and higher order in a tile's offset, beyond {len(shared.factors.tile_nodes)} "
            f"terms in each of {len(self.tiles)} tiles",
            shared.factors.relative_error,
        )
        path, amplitude, direction = shared.maps.errors
        maps = math.hypot(2.0 * math.pi * path, amplitude, 2.0 * math.pi * direction)
        yield ErrorTerm("interpolation between traced rays", maps)
        levels = math.sqrt(2.0) * self._interpolation_fraction * self._error
        yield ErrorTerm("interpolation in two levels", levels)
        yield _rounding_term(self.tiles)
        carrier, distance_mm = self._middle, shared.maps.edge_error_mm
        widest = np.max([group.steps_mm for group in self.groups], axis=0)
        if carrier.edge is not None:
            yield soft_edge_term(carrier, shared.factors.spans_mm, shared.rise_over(widest))
        else:
            yield from edge_terms(self.scene, self.tiles[len(self.tiles) // 2], carrier)
            distance_mm += TAPER * TAPER_LOSS * float(np.max(widest))
        position = math.sqrt(rim_fraction_per_mm(carrier.rim_mm) * distance_mm)
        yield ErrorTerm("position of the aperture's edge", min(1.0, position), at_rim=True)

    def cost(self) -> Cost:
        return hierarchical_cost(self._prepared.shared, self.groups)


def _rounding_term(tiles: Sequence[Tile]) -> ErrorTerm:
    """Return the error of the nonuniform transforms of tiles that is due to single precision."""
    modes = max(part.stop - part.start for tile in tiles for part in tile.part)
    return ErrorTerm(
        f"rounding in single precision, of transforms of up to {modes} samples along an axis",
        rounding_error(modes),
    )


def _common_spans_mm(cut: Cut) -> Array:
    """Return the largest extent of the tiles about their centres, shape (2, 2)."""
    spans = np.array([tile.spans_mm for tile, _ in cut])
    return np.column_stack([spans[:, :, 0].min(axis=0), spans[:, :, 1].max(axis=0)])


def _reach_mm(spans_mm: Array) -> float:
    """Return the largest distance of a tile's points from its centre."""
    return float(np.linalg.norm(np.max(np.abs(spans_mm), axis=1)))
