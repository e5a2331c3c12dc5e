"""Pixels of the frames that a calibration uses, and their derivatives with respect to parameters of a bench.

Usually all pixels are used, and planes are reached from one exit field through free space
(:class:`DensePixels`). A small patch of the object makes no finer fringes on a plane than lambda f / w,
because light from its width w leaves the lens within an angle w / f. Through a large lens such a fringe
covers many pixels, so that a subset is sufficient (:class:`SparsePixels`). Tiles then propagate light
directly to these pixels on each plane. No grid needs to sample the common carrier of all light, and free
space between the planes is part of the rays.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.analysis.paraxial import first_order
from wavesim.calibration.parameters import LightPhase, Parameter, SensorPosition, Unknowns
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.eikonal.perturbed_tiles import (
    PathDerivatives,
    PerturbedScene,
    PerturbedTiles,
    exit_field_changes_by_engines,
    exit_field_changes_by_rays,
    path_derivatives,
)
from wavesim.fields.field import Field, Grid
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import ComplexArray, LinearModel, RealArray
from wavesim.forward.stacked_channels import ChannelsMeasurement
from wavesim.reconstruction.source_search import modes_on
from wavesim.scene.engine import Engine, GridPair, Grids, Operator
from wavesim.scene.light_errors import Orders, light_mode
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import frames_by_plane
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement, placed_planes
from wavesim.sensor.pixels.points import points_among, recorded_points
from wavesim.targets.patch import Patch

TileParts = Sequence[tuple[slice, ...]]


def _tile_parts(engine: Operator) -> list[TileParts]:
    """Return the samples of the object in each tile, for each plane that tiles reach."""
    engines = engine.planes if isinstance(engine, TilesToPlanes) else [engine]
    return [[tile.part for tile in one.tiles] for one in engines if isinstance(one, FlatTiles)]


@dataclass(frozen=True, eq=False)
class RayDerivatives:
    """Derivatives of the rays of all tiles with respect to parameters.

    Attributes
    ----------
    parameters : tuple of Parameter
        The parameters.
    planes : sequence of PathDerivatives
        Path derivatives of the tiles to the exit grid, or to each plane.
    parts : sequence
        For each of `planes`, the samples of the object in each tile.
    """

    parameters: tuple[Parameter, ...]
    planes: Sequence[PathDerivatives]
    parts: Sequence[TileParts]

    @classmethod
    def of(
        cls, parameters: Sequence[Parameter], planes: Sequence[PathDerivatives], engine: Operator
    ) -> RayDerivatives:
        """Return the derivatives of an engine's tiles for parameters, in their order."""
        return cls(tuple(parameters), planes, _tile_parts(engine))

    def apply_to(self, engine: Operator) -> bool:
        """Return whether an engine has the tiles of these derivatives.

        The engine of a similar bench may divide the object into other tiles.
        """
        return self.parts == _tile_parts(engine)

    def plane(self, plane_index: int, parameters: Sequence[Parameter]) -> PathDerivatives:
        """Return the path derivatives to a plane for some of the parameters."""
        indices = [self.parameters.index(parameter) for parameter in parameters]
        return [[tile[index] for index in indices] for tile in self.planes[plane_index]]


@dataclass(frozen=True, eq=False)
class CalibrationPixels(ABC):
    """Frames, and what is known of their bench.

    Attributes
    ----------
    scene : Scene
        Nominal scene, to the exit grid.
    illumination : Field
        Nominal illumination on the object grid.
    recorded : sequence of Measurement
        Measured planes at nominal distances from the exit grid.
    scale : float or None
        Measured amplitude per unit of the modelled amplitude, where it is known.
    fill_factor : float
        Linear fill factor of a pixel; 0 is a point.
    make : callable
        Returns the engine of a scene.
    rows : tuple of slice
        Rows of the exit grid that belong to each plane; empty if planes are reached through free space.
    """

    scene: Scene
    illumination: Field
    recorded: Sequence[Measurement]
    scale: float | None
    fill_factor: float
    make: Callable[[Scene], Engine]

    rows: tuple[slice, ...] = ()

    @abstractmethod
    def model(self, unknowns: Unknowns, reference: Operator | None = None) -> ChannelModel:
        """Return the forward model of a bench, with an engine of its own or perturbed from that of another
        bench.
        """

    def columns(
        self,
        unknowns: Unknowns,
        linear: LinearModel,
        parameters: Sequence[Parameter],
        derivatives: RayDerivatives | None = None,
    ) -> RealArray:
        """Return the change of the modelled amplitudes per unit of each parameter, shape (parameters,
        planes, ny, nx).

        Parameters
        ----------
        unknowns, linear
            The bench, and the linear model about it.
        parameters
            Parameters of the columns.
        derivatives
            Ray derivatives of a similar bench, from :meth:`ray_derivatives`. They are computed again if
            omitted, or if this bench has other tiles.
        """
        carried = [p for p in parameters if self._acts_on_rays(p)]
        if derivatives is None or not derivatives.apply_to(linear.model.engine):
            derivatives = self.ray_derivatives(unknowns, linear.model.engine, carried)
        ray_columns = iter(self._ray_columns(unknowns, linear, carried, derivatives) if carried else ())
        mode_fields: dict[Orders, ComplexArray] = {}
        result = np.empty((len(parameters), *linear.residual.shape), linear.residual.dtype)
        for n, parameter in enumerate(parameters):
            if self._acts_on_rays(parameter):
                result[n] = next(ray_columns)
            elif isinstance(parameter, LightPhase):
                # Amplitude and phase of one mode have the same shape, so that one propagation serves both.
                orders, change = parameter.orders, self.light_change(unknowns, parameter)
                mode = light_mode(orders, change.shape)
                if orders not in mode_fields:
                    mode_fields[orders] = linear.exit_field_change_of_light(mode)
                mode_factor = np.complex64(np.vdot(mode, change) / np.vdot(mode, mode))
                result[n] = linear.jacobian_times_exit_field(mode_factor * mode_fields[orders])
            else:
                result[n] = parameter.column(linear)
        return result

    @abstractmethod
    def _acts_on_rays(self, parameter: Parameter) -> bool:
        """Return whether a parameter acts on the rays."""

    @abstractmethod
    def ray_derivatives(
        self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]
    ) -> RayDerivatives | None:
        """Return the derivatives of rays, which hardly change with the bench; None if the engine has no
        rays.
        """

    @abstractmethod
    def _ray_columns(
        self,
        unknowns: Unknowns,
        linear: LinearModel,
        parameters: Sequence[Parameter],
        derivatives: RayDerivatives | None,
    ) -> Iterable[RealArray]:
        """Return changes of the modelled amplitudes per unit of each parameter that acts on the rays."""

    def light_change(self, unknowns: Unknowns, parameter: Parameter) -> NDArray[Any]:
        """Return the relative change of the illumination per unit of a parameter."""
        even = self.illumination.with_values(np.ones(self.illumination.grid.shape, complex))
        light = unknowns.state.light.on(even).values
        stepped_light = stepped(unknowns, parameter).state.light.on(even).values
        return np.asarray((stepped_light / light - 1.0) / parameter.small)


class DensePixels(CalibrationPixels):
    """Pixels of each plane, reached from one exit field through free space."""

    def model(self, unknowns: Unknowns, reference: Operator | None = None) -> ChannelModel:
        state = unknowns.state
        scene, light = placed_scene(self.scene, state), placed_light(self.illumination, state)
        return ChannelModel.of_source(
            PerturbedTiles(reference, scene) if type(reference) is FlatTiles else self.make(scene),
            light,
            placed_planes(self.recorded, state),
            self.scale,
            self.fill_factor,
            modes=modes_on(light, state.source),
        )

    def _acts_on_rays(self, parameter: Parameter) -> bool:
        return parameter.group in ("lens", "mounting")

    def ray_derivatives(
        self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]
    ) -> RayDerivatives | None:
        if not isinstance(engine, FlatTiles):
            return None
        carried = [p for p in parameters if self._acts_on_rays(p)]
        derivatives = path_derivatives(
            engine, self.illumination.values.dtype, self._perturbed_scenes(unknowns, carried)
        )
        return RayDerivatives.of(carried, [derivatives], engine)

    def _ray_columns(
        self,
        unknowns: Unknowns,
        linear: LinearModel,
        parameters: Sequence[Parameter],
        derivatives: RayDerivatives | None,
    ) -> Iterable[RealArray]:
        def changes(engine: Operator, lit: Field) -> list[ComplexArray]:
            if derivatives is None or not (isinstance(engine, FlatTiles) and derivatives.apply_to(engine)):
                perturbed = [
                    scene._replace(scene=replace(scene.scene, wavelength_um=lit.wavelength_um))
                    for scene in self._perturbed_scenes(unknowns, parameters)
                ]
                return exit_field_changes_by_engines(engine, lit, perturbed, self.make)
            return exit_field_changes_by_rays(engine, lit, derivatives.plane(0, parameters))

        model, measurement = linear.model, linear.measurement
        if len(model.channels) == 1:
            return map(linear.jacobian_times_exit_field, changes(model.engine, linear.lit))
        assert isinstance(measurement, ChannelsMeasurement)
        # Fields of one channel at a time, because those of all channels and parameters need much memory.
        totals = np.zeros((len(parameters), *linear.residual.shape), linear.residual.dtype)
        for index, channel in enumerate(model.channels):
            # Paths of rays change alike for all wavelengths of a band.
            of_channel = changes(channel.engine, channel.on(linear.lit))
            for total, change in zip(totals, of_channel, strict=True):
                total += measurement.products_of_channel(index, change)
        return map(linear.amplitude_changes, totals)

    def _perturbed_scenes(self, unknowns: Unknowns, parameters: Sequence[Parameter]) -> list[PerturbedScene]:
        states = [stepped(unknowns, p).state for p in parameters]
        return [
            PerturbedScene(placed_scene(self.scene, state), p.small)
            for p, state in zip(parameters, states, strict=True)
        ]


def stepped(unknowns: Unknowns, parameter: Parameter) -> Unknowns:
    """Return the bench with a small step of one parameter."""
    here = unknowns.values.get(parameter, 0.0)
    return unknowns.changed([parameter], [here + parameter.small])


class TilesToPlanes:
    """Tiles to each plane, combined to one operator; the pixels of all planes are rows of one field.

    Parameters
    ----------
    planes
        Tiles to the pixels of each plane.
    """

    def __init__(self, planes: Sequence[PerturbedTiles]) -> None:
        self.planes = planes
        first = planes[0].scene
        rows, columns = first.exit_grid.shape
        grid = replace(first.exit_grid, shape=(len(planes) * rows, columns))
        self.scene: Grids = GridPair(first.object_grid, grid)

    def forward(self, field: Field) -> Field:
        """Propagate a field from the object to the pixels of all planes."""
        on_planes = [plane.forward(field) for plane in self.planes]
        values = np.concatenate([one.values for one in on_planes])
        return Field(self.scene.exit_grid, values, field.wavelength_um, on_planes[0].index)

    def adjoint(self, field: Field) -> Field:
        """Apply the adjoint of :meth:`forward`, from the pixels of all planes to the object."""
        parts = np.split(field.values, len(self.planes))
        on_object = [
            plane.adjoint(Field(plane.scene.exit_grid, part, field.wavelength_um, field.index))
            for plane, part in zip(self.planes, parts, strict=True)
        ]
        total = sum(one.values for one in on_object[1:]) + on_object[0].values
        return Field(self.scene.object_grid, total, field.wavelength_um, on_object[0].index)


class SparsePixels(CalibrationPixels):
    """A regular subset of each plane's pixels as points; the distances of planes are in their own scenes."""

    def model(self, unknowns: Unknowns, reference: Operator | None = None) -> ChannelModel:
        state = unknowns.state
        tiles: Sequence[FlatTiles]
        if isinstance(reference, TilesToPlanes):
            tiles = [plane.reference for plane in reference.planes]
        else:
            tiles = [self._tiles(self._scene(state, n)) for n in range(len(self.recorded))]
        perturbed = [
            PerturbedTiles(own, self._scene(state, n), state.sensor_pose(n)) for n, own in enumerate(tiles)
        ]
        # The positions of the planes are part of their scenes and sensor poses. Points are not blurred.
        planes = [
            replace(plane, distance_mm=0.0, shift_mm=(0.0, 0.0), tilt_deg=(0.0, 0.0), blur_mm=0.0)
            for plane in placed_planes(self.recorded, state)
        ]
        operator, light = TilesToPlanes(perturbed), placed_light(self.illumination, state)
        return ChannelModel.of_source(operator, light, planes, self.scale, rows=self.rows)

    def _acts_on_rays(self, parameter: Parameter) -> bool:
        return parameter.group in ("lens", "mounting") or isinstance(parameter, SensorPosition)

    def ray_derivatives(
        self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]
    ) -> RayDerivatives:
        assert isinstance(engine, TilesToPlanes)
        carried = [p for p in parameters if self._acts_on_rays(p)]
        states, dtype = [stepped(unknowns, p).state for p in carried], self.illumination.values.dtype
        planes = []
        for n, plane in enumerate(engine.planes):
            changed = [
                PerturbedScene(self._scene(state, n), p.small, state.sensor_pose(n))
                for p, state in zip(carried, states, strict=True)
            ]
            planes.append(path_derivatives(plane, dtype, changed))
        return RayDerivatives.of(carried, planes, engine)

    def _ray_columns(
        self,
        unknowns: Unknowns,
        linear: LinearModel,
        parameters: Sequence[Parameter],
        derivatives: RayDerivatives | None,
    ) -> Iterable[RealArray]:
        operator = linear.model.engine
        assert isinstance(operator, TilesToPlanes)
        assert derivatives is not None
        planes = [
            exit_field_changes_by_rays(plane, linear.lit, derivatives.plane(n, parameters))
            for n, plane in enumerate(operator.planes)
        ]
        changes = (np.concatenate(parts) for parts in zip(*planes, strict=True))
        return map(linear.jacobian_times_exit_field, changes)

    def reaches_directly(self, plane_index: int) -> bool:
        """Return whether tiles reach a plane without free space."""
        tiles = self.make(self._scene(SystemState(), plane_index))
        return isinstance(tiles, FlatTiles) and tiles.plane.beyond is None

    def _scene(self, state: SystemState, plane_index: int) -> Scene:
        """Return the scene to a plane at its nominal distance."""
        nominal = self.scene.exit_grid
        grid = nominal.at(nominal.z_mm + self.recorded[plane_index].distance_mm)
        return placed_scene(replace(self.scene, exit_grid=grid), state)

    def _tiles(self, scene: Scene) -> FlatTiles:
        tiles = self.make(scene)
        assert isinstance(tiles, FlatTiles)
        return tiles


def pixel_spacing(patch: Patch, scene: Scene) -> int:
    """Return the spacing of the pixels that are needed, in pixels; 1 if all are needed.

    Parameters
    ----------
    patch
        The object.
    scene
        Scene to all pixels.
    """
    power_per_mm = abs(first_order(scene.lens, scene.wavelength_um).power_per_mm)
    if not power_per_mm:
        return 1
    finest_mm = 1e-3 * scene.wavelength_um / power_per_mm / patch.field_stop_mm
    # Spacing of the pixels over the period of the finest fringes. Each pixel then gives enough numbers for
    # the real and imaginary part of the field.
    fringe_fraction = 0.6
    return max(1, math.floor(fringe_fraction * finest_mm / scene.exit_grid.pitch_mm))


def sparse_pixels(
    all_pixels: CalibrationPixels, frames: Sequence[Frame], spacing: int
) -> SparsePixels | None:
    """Return a regular subset of the pixels, or None if rays to a plane cross, so that tiles do not reach
    it.

    Parameters
    ----------
    all_pixels
        All pixels.
    frames
        Frames with these pixels.
    spacing
        Spacing in pixels.
    """
    grid = all_pixels.scene.exit_grid
    y_mm, x_mm = (axis[points_among(len(axis), spacing)] for axis in (grid.y_mm, grid.x_mm))
    middle = float(x_mm.mean()), float(y_mm.mean())
    points = Grid((len(y_mm), len(x_mm)), spacing * grid.pitch_mm, grid.z_mm, middle)
    planes = zip(frames_by_plane(frames), all_pixels.recorded, strict=True)
    found = SparsePixels(
        replace(all_pixels.scene, exit_grid=points),
        all_pixels.illumination,
        [recorded_points(plane, one.distance_mm, spacing, all_pixels.fill_factor) for plane, one in planes],
        all_pixels.scale,
        0.0,
        all_pixels.make,
        tuple(slice(n * len(y_mm), (n + 1) * len(y_mm)) for n in range(len(all_pixels.recorded))),
    )
    straight = (found.reaches_directly(plane_index) for plane_index in range(len(found.recorded)))
    return found if all(straight) else None


def padded_to_fast_shape(
    scene: Scene, recorded: Sequence[Measurement]
) -> tuple[Scene, tuple[Measurement, ...]]:
    """Return the scene and planes with some more, unknown pixels around, for fast Fourier transforms.

    A transform of 438 samples (2, 3 and 73) takes three times as long as one of 440.

    Parameters
    ----------
    scene
        Scene to all pixels.
    recorded
        Measured planes; without `sigma` they stay unchanged.
    """
    grid = scene.exit_grid
    padding = [scipy.fft.next_fast_len(count) - count for count in grid.shape]
    if not any(padding) or any(plane.sigma is None for plane in recorded):
        return scene, tuple(recorded)
    margins = [(count // 2, count - count // 2) for count in padding]
    y_mm, x_mm = (0.5 * grid.pitch_mm * (after - before) for before, after in margins)
    wider = replace(
        grid,
        shape=tuple(count + added for count, added in zip(grid.shape, padding, strict=True)),
        centre_mm=(grid.centre_mm[0] + x_mm, grid.centre_mm[1] + y_mm),
    )
    # Padded amplitudes repeat the border, so that the plane's mean (reference of backgrounds) stays.
    planes = [
        replace(
            plane,
            amplitude=np.pad(plane.amplitude, margins, mode="edge"),
            fraction_per_intensity=(
                None
                if plane.fraction_per_intensity is None
                else np.pad(plane.fraction_per_intensity, margins)
            ),
            sigma=np.pad(np.asarray(plane.sigma), margins, constant_values=np.inf),
        )
        for plane in recorded
    ]
    return replace(scene, exit_grid=wider), tuple(planes)
