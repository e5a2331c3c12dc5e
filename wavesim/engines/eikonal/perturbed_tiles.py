"""Eikonal tiles of a lens or sensor pose that differs slightly from that of given tiles.

By Fermat's principle the path between two points need not be recomputed: to first order, a change of the lens
changes the path from an object point to a sensor point by the path difference along the rays of the changed
lens. The field of a tile is multiplied by the phasor of this change at the tile's center. Away from the
center, the path changes by the change of the direction in which rays leave the object, times the distance
from the center.

The same holds for a sensor that is slightly off the grid of the tiles, and for a slightly different
wavelength, whose paths count in wavelengths of the tiles. This takes a hundredth of the time of new tiles.
Amplitudes, and the path of a tile beyond its first order, stay unchanged.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.eikonal.flat_tiles import TileOperator
from wavesim.engines.eikonal.plan import Tile
from wavesim.fields.field import Field, Grid
from wavesim.rays.maps import RayMap, SmoothMap, fit_map, sample_points
from wavesim.rays.ray_bundles import RayBundle, trace_bundle
from wavesim.runtime.threads import at_once, one_blas_thread
from wavesim.scene.engine import Cost, Engine, ErrorTerm, Operator
from wavesim.scene.scene import Scene
from wavesim.scene.system_state import SensorPose

NOMINAL_SENSOR = SensorPose()


def ray_changes(
    scene: Scene,
    reference: Scene,
    tile: Tile,
    ray_map: RayMap,
    grid: Grid,
    sensor_pose: SensorPose = NOMINAL_SENSOR,
    removed: SmoothMap | None = None,
) -> SmoothMap:
    """Return how the rays of a changed scene differ from those of a tile.

    Parameters
    ----------
    scene
        Scene with the changed lens, with a displaced object, or for another wavelength.
    reference
        Scene of the tile.
    tile, ray_map
        Part of the object, and the original rays of its center.
    grid
        Grid of the plane to which the rays go.
    sensor_pose
        Pose of the sensor relative to that grid.
    removed
        Existing changes, which are subtracted.

    Returns
    -------
    SmoothMap
        On the sensor: increase of the path from the tile's center in mm, and changes of the direction
        cosines along y and x with which rays leave the object. Paths and cosines of another wavelength are
        multiplied by the ratio of wavenumbers.

    Raises
    ------
    InputError
        If no ray arrives.
    """
    with one_blas_thread():
        # Order of the polynomials that fit changes of the path, which are smooth.
        order = 10
        pupil = sample_points(ray_map.traced, order)
        displacement_mm = np.subtract(scene.object_grid.centre_mm, reference.object_grid.centre_mm)
        rays = trace_bundle(scene, tile.centre_mm + displacement_mm, pupil, grid.z_mm)
        if not np.any(rays.ok):
            raise InputError("no ray of the changed lens arrives: the change is too large")
        sensor_points, path_mm = _on_sensor(rays, float(scene.system.index[0, -1]), grid, sensor_pose)
        arriving = sensor_points[rays.ok]
        wavenumbers = reference.wavelength_um / scene.wavelength_um
        changes = wavenumbers * np.concatenate([path_mm[None], rays.cosines.T])[:, rays.ok]
        changes -= ray_map.maps.at(arriving)[[0, 2, 3]]
        if removed is not None:
            changes -= removed.at(arriving)
        return fit_map(arriving, changes, order)


def _on_sensor(rays: RayBundle, index: float, grid: Grid, sensor_pose: SensorPose) -> tuple[Array, Array]:
    """Return where rays meet the sensor, (y, x) in mm about the grid's center, and their paths in mm."""
    if sensor_pose == NOMINAL_SENSOR:
        return rays.sensor_mm, rays.path_mm
    transverse = rays.slopes[:, ::-1] / index
    direction = np.column_stack([transverse, np.sqrt(1.0 - np.sum(transverse**2, axis=1))])
    start = np.pad(rays.sensor_mm[:, ::-1] - grid.centre_mm, ((0, 0), (0, 1)))
    start -= [*sensor_pose.shift_mm, sensor_pose.distance_mm]
    rotation = rotation_matrix(*np.deg2rad(sensor_pose.tilt_deg))
    normal = rotation[:, 2]
    length = -(start @ normal) / (direction @ normal)
    in_sensor_frame = (start + length[:, None] * direction) @ rotation[:, :2] + grid.centre_mm
    return in_sensor_frame[:, ::-1], rays.path_mm + index * length


class PerturbedTiles(FlatTiles):
    """Tiles that differ slightly from those of another engine.

    A calibration makes them; they are not among the engines that can be chosen. Cost and error terms are
    those of the reference. Terms beyond the first order of the change are not included, so that changes must
    be small.

    Parameters
    ----------
    reference
        Engine whose scene has the same grids, except for the position of the object.
    scene
        Scene with the changed lens, or for another wavelength.
    sensor_pose
        Pose of the sensor relative to the grid of the tiles.

    Raises
    ------
    InputError
        If there is free space behind the tiles' plane, and the sensor is off the grid or the wavelength
        another one.
    """

    name = "perturbed-tiles"

    def __init__(self, reference: FlatTiles, scene: Scene, sensor_pose: SensorPose = NOMINAL_SENSOR) -> None:
        super().__init__(scene)
        if sensor_pose != NOMINAL_SENSOR and reference.plane.beyond is not None:
            raise InputError(
                f"sensor displaced by {sensor_pose}: needs tiles that end on the sensor plane; these end "
                "before it"
            )
        if scene.wavelength_um != reference.scene.wavelength_um and reference.plane.beyond is not None:
            raise InputError(
                f"wavelength of {scene.wavelength_um:g} um: needs tiles that end on the exit grid; these end "
                "before it, and continue with the wavelength of their own"
            )
        self.reference, self.sensor_pose, self.plane = reference, sensor_pose, reference.plane

    @property
    def tiles(self) -> tuple[Tile, ...]:
        return self.reference.tiles

    def at_wavelength(self, wavelength_um: float) -> Engine:
        """Return the same perturbation of the reference's tiles for another wavelength.

        The tiles of each wavelength are computed once for a reference.
        """
        if wavelength_um == self.scene.wavelength_um:
            return self
        if wavelength_um not in self.other_wavelengths:
            references = self.reference.other_wavelengths
            if wavelength_um not in references:
                made = self.reference.at_wavelength(wavelength_um)
                assert isinstance(made, FlatTiles)
                references[wavelength_um] = made
            scene = replace(self.scene, wavelength_um=wavelength_um)
            self.other_wavelengths[wavelength_um] = PerturbedTiles(
                references[wavelength_um], scene, self.sensor_pose
            )
        return self.other_wavelengths[wavelength_um]

    def changes(self, tile: Tile, ray_map: RayMap) -> SmoothMap:
        """Return how the rays of a tile differ from those of the reference, see :func:`ray_changes`."""
        return ray_changes(self.scene, self.reference.scene, tile, ray_map, self.plane.grid, self.sensor_pose)

    def tile_operators(self, dtype: np.dtype[Any]) -> Iterator[tuple[Tile, RayMap, TileOperator]]:
        """Yield each tile, its original rays, and its operator for fields of a data type."""
        for (tile, ray_map, _), operator in zip(
            self.reference.tile_operators(dtype), self._prepared(dtype), strict=True
        ):
            yield tile, ray_map, operator

    def _build_operators(self, dtype: np.dtype[Any]) -> tuple[TileOperator, ...]:
        wavenumber = self.reference.scene.wavenumber_per_mm
        # Light of a point spreads over an area that grows with the squared wavelength, or over a length.
        dimensions = len(self.plane.grid.shape)
        factor = (self.scene.wavenumber_per_mm / wavenumber) ** (0.5 * dimensions)
        return tuple(
            operator.perturbed(ray_map, self.changes(tile, ray_map), wavenumber, factor)
            for tile, ray_map, operator in self.reference.tile_operators(dtype)
        )

    def cost(self) -> Cost:
        return self.reference.cost()

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return self.reference.error_terms()

    def settings(self) -> dict[str, Any]:
        return self.reference.settings()


ComplexArray = NDArray[np.complexfloating[Any, Any]]
PathDerivatives = Sequence[Sequence[SmoothMap]]


class PerturbedScene(NamedTuple):
    """A scene with a small change of lens, object or sensor, and the step of the parameter that causes
    it.
    """

    scene: Scene
    step: float
    sensor_pose: SensorPose = NOMINAL_SENSOR


def path_derivatives(
    engine: FlatTiles, dtype: DTypeLike, perturbed: Sequence[PerturbedScene]
) -> PathDerivatives:
    """Return the derivatives of paths and directions of each tile's rays with respect to each parameter.

    Parameters
    ----------
    engine
        Engine of the unchanged scene.
    dtype
        Data type of fields.
    perturbed
        The scene with a small step of each parameter.

    Returns
    -------
    sequence of sequence of SmoothMap
        For each tile, and for each parameter.

    Raises
    ------
    InputError
        If the rays of a changed lens do not arrive.
    """
    grid, derivatives = engine.plane.grid, []
    reference = engine.reference.scene if isinstance(engine, PerturbedTiles) else engine.scene
    for tile, ray_map, _ in engine.tile_operators(np.dtype(dtype)):
        existing = engine.changes(tile, ray_map) if isinstance(engine, PerturbedTiles) else None
        changes = [
            ray_changes(each.scene, reference, tile, ray_map, grid, each.sensor_pose, existing)
            for each in perturbed
        ]
        derivatives.append(
            [
                replace(m, coefficients=m.coefficients / each.step)
                for m, each in zip(changes, perturbed, strict=True)
            ]
        )
    return derivatives


def exit_field_changes_by_rays(
    engine: FlatTiles, lit: Field, derivatives: PathDerivatives
) -> list[ComplexArray]:
    """Return the change of the exit field per unit of each parameter, from path derivatives.

    Parameters
    ----------
    engine
        Engine of the unchanged scene.
    lit
        Field behind the object.
    derivatives
        Path derivatives of the tiles' rays, for this scene or a similar one.
    """
    grid, wavenumber = engine.plane.grid, engine.scene.wavenumber_per_mm
    axes = grid.y_mm, grid.x_mm
    results = [np.zeros(grid.shape, lit.values.dtype) for _ in derivatives[0]]
    for (_, _, moments_at_exit), maps in zip(_tile_moments(engine, lit), derivatives, strict=True):
        moments_at_exit *= moments_at_exit.dtype.type(1j * wavenumber)
        for each, result in zip(maps, results, strict=True):
            path, *cosines = each.along(axes).single().each()
            result += path * moments_at_exit[0]
            for cosine, moment in zip(cosines, moments_at_exit[1:], strict=True):
                result -= cosine * moment
    if engine.plane.beyond is None:
        return results
    return [
        np.asarray(engine.plane.beyond.forward(each.astype(complex)), lit.values.dtype) for each in results
    ]


def exit_field_changes_by_engines(
    engine: Operator, lit: Field, perturbed: Sequence[PerturbedScene], make: Callable[[Scene], Engine]
) -> list[ComplexArray]:
    """Return the changes of :func:`exit_field_changes_by_rays` by finite differences of whole engines.

    `make` returns the engine of a changed scene. A phase that the whole field gains, as behind an object that
    is nearer, may be too large for a difference of fields. It is removed from the difference and counts as
    its own, linear part. Beyond half a wave it is known up to whole waves, which amplitudes do not show.
    """
    now = engine.forward(lit).values
    changes = []
    for each in perturbed:
        after = make(each.scene).forward(_on_scene(lit, each.scene)).values
        phase = float(np.angle(np.vdot(now, after)))
        change = cmath.exp(-1j * phase) * after - (1.0 - 1j * phase) * now
        changes.append((change / each.step).astype(after.dtype))
    return changes


def _tile_moments(engine: FlatTiles, field: Field) -> Iterator[tuple[Tile, RayMap, ComplexArray]]:
    """Yield each tile, its rays, and its fields on the plane where tiles are summed, shape (3, ny, nx).

    The three fields are those of the object, and of the object times y and times x from the tile's center in
    mm.
    """
    scaled = field.values * field.values.real.dtype.type(engine.scene.object_grid.cell)
    for tile, ray_map, operator in engine.tile_operators(scaled.dtype):
        y_mm, x_mm = (offsets.astype(scaled.real.dtype) for offsets in tile.offsets_mm)
        part = scaled[operator.part]
        moments = part, part * y_mm[:, None], part * x_mm
        moments_at_exit = np.zeros((3, *engine.plane.grid.shape), scaled.dtype)
        carried = at_once([partial(operator.transformed, moment) for moment in moments])
        for each, result in zip(carried, moments_at_exit, strict=True):
            operator.add(each, result)
        yield tile, ray_map, moments_at_exit


def _on_scene(lit: Field, scene: Scene) -> Field:
    return Field(scene.object_grid, lit.values, lit.wavelength_um, lit.index)
