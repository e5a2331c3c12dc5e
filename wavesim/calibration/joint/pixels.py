"""Which pixels of the frames a search looks at, and what parameters of a bench do to them."""

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
from wavesim.calibration.joint.perturbed_tiles import (
    Changed,
    PathSlopes,
    SensorPose,
    TurnedTiles,
    by_engines,
    by_rays,
    path_slopes,
)
from wavesim.calibration.parameters import SENSOR_TILTS, Parameter, Unknowns, light_orders
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linearised import ComplexArray, FreeSpaceMeasurement, Linearised, RealArray
from wavesim.scene.bench import Bench, Orders, light_mode
from wavesim.scene.engine import Engine, Grids, Operator
from wavesim.scene.scene import Scene, placed_scene
from wavesim.sensor.frame_sets import frames_by_plane
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.mounting import light_on, planes_at
from wavesim.sensor.pixels.points import points_among, recorded_points
from wavesim.targets.patch import Patch


@dataclass(frozen=True, eq=False)
class RaySlopes:
    """What parameters do to the rays of all tiles.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    planes : sequence of PathSlopes
        Of the tiles that carry light to the exit grid, or to each plane.
    """

    names: tuple[str, ...]
    planes: Sequence[PathSlopes]

    @classmethod
    def of(cls, parameters: Sequence[Parameter], planes: Sequence[PathSlopes]) -> RaySlopes:
        """Of parameters, in their order."""
        return cls(tuple(p.name for p in parameters), planes)

    def plane(self, number: int, parameters: Sequence[Parameter]) -> PathSlopes:
        """Of the tiles to a plane of its number, for some of the parameters."""
        places = [self.names.index(p.name) for p in parameters]
        return [[tile[place] for place in places] for tile in self.planes[number]]


@dataclass(frozen=True, eq=False)
class Pixels(ABC):
    """Frames, and what is known of how they came about.

    Attributes
    ----------
    scene : Scene
        Nominal, to the exit grid.
    illumination : Field
        As it should be, on the object grid.
    recorded : sequence of Recorded
        At nominal distances from the exit grid.
    scale : float or None
        Recorded amplitude for a unit of the model's, where it is known.
    fill_factor : float
        Side of a pixel's photosensitive square as a share of the pitch; 0 is a point.
    make : callable
        Makes the engine of a scene.
    """

    scene: Scene
    illumination: Field
    recorded: Sequence[Measurement]
    scale: float | None
    fill_factor: float
    make: Callable[[Scene], Engine]

    rows: tuple[slice, ...] = ()

    @abstractmethod
    def model(self, unknowns: Unknowns, near: Operator | None = None) -> ForwardModel:
        """Of a bench: with an engine of its own, or with that of another bench, turned."""

    def columns(
        self,
        unknowns: Unknowns,
        linear: Linearised,
        parameters: Sequence[Parameter],
        slopes: RaySlopes | None = None,
    ) -> RealArray:
        """Change of the modelled amplitudes with each parameter, shape (parameters, planes, ny, nx).

        Parameters
        ----------
        unknowns, linear
            The bench, and the model there.
        parameters
            Of which it is asked.
        slopes
            Of rays, as :meth:`ray_slopes` gives them of a bench that is near.
        """
        carried = [p for p in parameters if self._is_carried(p)]
        slopes = slopes or self.ray_slopes(unknowns, linear.model.engine, carried)
        changes = iter(self._changes(unknowns, linear, carried, slopes) if carried else ())
        through: dict[Orders, ComplexArray] = {}
        result = np.empty((len(parameters), *linear.residual.shape), linear.residual.dtype)
        for n, parameter in enumerate(parameters):
            if self._is_carried(parameter):
                result[n] = linear.of_exit(next(changes))
            elif parameter.group == "light":
                # Amplitude and phase of one mode go through the lens alike.
                orders, change = light_orders(parameter.name), self.light_change(unknowns, parameter)
                mode = light_mode(orders, change.shape)
                if orders not in through:
                    through[orders] = linear.exit_of_light(mode)
                share = np.complex64(np.vdot(mode, change) / np.vdot(mode, mode))
                result[n] = linear.of_exit(share * through[orders])
            elif parameter.name.endswith("_background"):
                result[n] = linear.of_background(plane_number(parameter))
            else:
                result[n] = self._of_camera(linear, parameter)
        return result

    @abstractmethod
    def _is_carried(self, parameter: Parameter) -> bool:
        """Whether rays tell what it does."""

    @abstractmethod
    def ray_slopes(
        self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]
    ) -> RaySlopes | None:
        """What parameters do to rays, which hardly changes with the bench; None where rays do not tell."""

    @abstractmethod
    def _changes(
        self,
        unknowns: Unknowns,
        linear: Linearised,
        parameters: Sequence[Parameter],
        slopes: RaySlopes | None,
    ) -> Iterable[ComplexArray]:
        """Changes of the field on the exit grid for a unit of each parameter that rays tell of."""

    @abstractmethod
    def _of_camera(self, linear: Linearised, parameter: Parameter) -> RealArray:
        """Change of the modelled amplitudes with another parameter of the camera."""

    def light_change(self, unknowns: Unknowns, parameter: Parameter) -> NDArray[Any]:
        """Relative change of the illumination for a unit."""
        even = self.illumination.with_values(np.ones(self.illumination.grid.shape, complex))
        now = unknowns.bench.light.on(even).values
        there = moved(unknowns, parameter).bench.light.on(even).values
        return np.asarray((there / now - 1.0) / parameter.small)


class AllPixels(Pixels):
    """Each pixel of each plane, through one field behind the lens and free space from there."""

    def model(self, unknowns: Unknowns, near: Operator | None = None) -> ForwardModel:
        bench, scene = unknowns.bench, placed_scene(self.scene, unknowns.bench.placement)
        return ForwardModel(
            TurnedTiles(near, scene) if isinstance(near, EikonalTiles) else self.make(scene),
            light_on(self.illumination, bench),
            planes_at(self.recorded, bench),
            self.scale,
            self.fill_factor,
        )

    def _is_carried(self, parameter: Parameter) -> bool:
        return parameter.group in ("lens", "mounting")

    def ray_slopes(
        self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]
    ) -> RaySlopes | None:
        if not isinstance(engine, EikonalTiles | TurnedTiles):
            return None
        carried = [p for p in parameters if self._is_carried(p)]
        slopes = path_slopes(engine, self.illumination.values.dtype, self._changed(unknowns, carried))
        return RaySlopes.of(carried, [slopes])

    def _changes(
        self,
        unknowns: Unknowns,
        linear: Linearised,
        parameters: Sequence[Parameter],
        slopes: RaySlopes | None,
    ) -> Iterable[ComplexArray]:
        engine = linear.model.engine
        if slopes is None or not isinstance(engine, EikonalTiles | TurnedTiles):
            return by_engines(engine, linear.lit, self._changed(unknowns, parameters), self.make)
        return by_rays(engine, linear.lit, slopes.plane(0, parameters))

    def _changed(self, unknowns: Unknowns, parameters: Sequence[Parameter]) -> list[Changed]:
        benches = [moved(unknowns, p).bench for p in parameters]
        return [
            Changed(placed_scene(self.scene, bench.placement), p.small)
            for p, bench in zip(parameters, benches, strict=True)
        ]

    def _of_camera(self, linear: Linearised, parameter: Parameter) -> RealArray:
        name, measurement = parameter.name, linear.measurement
        assert isinstance(measurement, FreeSpaceMeasurement)
        if name in SENSOR_TILTS:
            return linear.of_planes(measurement.by_tilt(SENSOR_TILTS.index(name)))
        plane = plane_number(parameter)
        if name.startswith("plane_distance"):
            return linear.of_plane(plane, measurement.by_distance(plane))
        return linear.of_plane(plane, measurement.by_shift(plane, "xy".index(name.split("_")[3])))


def plane_number(parameter: Parameter) -> int:
    """Of the plane that a camera's parameter is of, from 0."""
    return next(int(word) for word in parameter.name.split("_") if word.isdecimal()) - 1


def moved(unknowns: Unknowns, parameter: Parameter) -> Unknowns:
    """The bench with one parameter a small step on."""
    here = unknowns.values.get(parameter.name, 0.0)
    return unknowns.changed([parameter.name], [here + parameter.small])


OF_A_FRINGE = 0.6
"""Distance of the pixels taken, over the period of the finest fringes: of the field's real and imaginary part
they tell three numbers, and of an object that is an amplitude twice as many."""


@dataclass(frozen=True)
class _Grids:
    """Of the object, and of all planes' pixels as rows of one field."""

    object_grid: Grid
    exit_grid: Grid


class TilesToPlanes:
    """Tiles to each plane, as one operator.

    Parameters
    ----------
    planes
        To the pixels of each.
    """

    def __init__(self, planes: Sequence[TurnedTiles]) -> None:
        self.planes = planes
        first = planes[0].scene
        rows, columns = first.exit_grid.shape
        grid = replace(first.exit_grid, shape=(len(planes) * rows, columns))
        self.scene: Grids = _Grids(first.object_grid, grid)

    def forward(self, field: Field) -> Field:
        """From the object to the pixels."""
        seen = [plane.forward(field) for plane in self.planes]
        values = np.concatenate([one.values for one in seen])
        return Field(self.scene.exit_grid, values, field.wavelength_um, seen[0].index)

    def adjoint(self, field: Field) -> Field:
        """And back."""
        parts = np.split(field.values, len(self.planes))
        back = [
            plane.adjoint(Field(plane.scene.exit_grid, part, field.wavelength_um, field.index))
            for plane, part in zip(self.planes, parts, strict=True)
        ]
        total = sum(one.values for one in back[1:]) + back[0].values
        return Field(self.scene.object_grid, total, field.wavelength_um, back[0].index)


class SomePixels(Pixels):
    """Every few pixels of each plane, as points; distances of planes are in their own scenes."""

    def model(self, unknowns: Unknowns, near: Operator | None = None) -> ForwardModel:
        bench = unknowns.bench
        made: Sequence[EikonalTiles]
        if isinstance(near, TilesToPlanes):
            made = [plane.near for plane in near.planes]
        else:
            made = [self._tiles(self._scene(bench, n)) for n in range(len(self.recorded))]
        turned = [TurnedTiles(own, self._scene(bench, n), _seat(bench, n)) for n, own in enumerate(made)]
        # Where planes are is in their scenes and seats.
        planes = [
            replace(plane, distance_mm=0.0, shift_mm=(0.0, 0.0), tilt_deg=(0.0, 0.0))
            for plane in planes_at(self.recorded, bench)
        ]
        operator, light = TilesToPlanes(turned), light_on(self.illumination, bench)
        return ForwardModel(operator, light, planes, self.scale, rows=self.rows)

    def _is_carried(self, parameter: Parameter) -> bool:
        return parameter.group != "light" and not parameter.name.endswith("_background")

    def ray_slopes(self, unknowns: Unknowns, engine: Operator, parameters: Sequence[Parameter]) -> RaySlopes:
        assert isinstance(engine, TilesToPlanes)
        carried = [p for p in parameters if self._is_carried(p)]
        benches, dtype = [moved(unknowns, p).bench for p in carried], self.illumination.values.dtype
        planes = []
        for n, plane in enumerate(engine.planes):
            changed = [
                Changed(self._scene(bench, n), p.small, _seat(bench, n))
                for p, bench in zip(carried, benches, strict=True)
            ]
            planes.append(path_slopes(plane, dtype, changed))
        return RaySlopes.of(carried, planes)

    def _changes(
        self,
        unknowns: Unknowns,
        linear: Linearised,
        parameters: Sequence[Parameter],
        slopes: RaySlopes | None,
    ) -> Iterable[ComplexArray]:
        operator = linear.model.engine
        assert isinstance(operator, TilesToPlanes)
        assert slopes is not None
        planes = [
            by_rays(plane, linear.lit, slopes.plane(n, parameters)) for n, plane in enumerate(operator.planes)
        ]
        return (np.concatenate(parts) for parts in zip(*planes, strict=True))

    def _of_camera(self, linear: Linearised, parameter: Parameter) -> RealArray:
        raise AssertionError(f"{parameter.name}: rays tell of it")

    def comes_straight_to(self, number: int) -> bool:
        """Whether tiles reach a plane of its number without free space."""
        made = self.make(self._scene(Bench(), number))
        return isinstance(made, EikonalTiles) and made.plane.beyond is None

    def _scene(self, bench: Bench, number: int) -> Scene:
        """To a plane of its number, where it should be."""
        nominal = self.scene.exit_grid
        grid = nominal.at(nominal.z_mm + self.recorded[number].distance_mm)
        return placed_scene(replace(self.scene, exit_grid=grid), bench.placement)

    def _tiles(self, scene: Scene) -> EikonalTiles:
        made = self.make(scene)
        assert isinstance(made, EikonalTiles)
        return made


def _seat(bench: Bench, number: int) -> SensorPose:
    placement = bench.placement
    return SensorPose(placement.plane_distance_mm(number), bench.shift_mm(number), placement.sensor_tilt_deg)


def pixels_apart(patch: Patch, scene: Scene) -> int:
    """How many pixels farther the next one may be that is needed; 1 where all are.

    Parameters
    ----------
    patch
        The object.
    scene
        To all pixels.
    """
    finest_mm = 1e-3 * scene.wavelength_um * first_order(scene.lens, scene.wavelength_um).efl_mm
    return max(1, math.floor(OF_A_FRINGE * abs(finest_mm) / patch.field_stop_mm / scene.exit_grid.pitch_mm))


def some_pixels(every: Pixels, frames: Sequence[Frame], apart: int) -> SomePixels | None:
    """Points some pixels apart; None where light does not come straight to a plane, for rays fold there.

    Parameters
    ----------
    every
        All pixels.
    frames
        That hold them.
    apart
        Pixels from one point to the next.
    """
    grid = every.scene.exit_grid
    y_mm, x_mm = (axis[points_among(len(axis), apart)] for axis in (grid.y_mm, grid.x_mm))
    middle = float(x_mm.mean()), float(y_mm.mean())
    points = Grid((len(y_mm), len(x_mm)), apart * grid.pitch_mm, grid.z_mm, middle)
    planes = zip(frames_by_plane(frames), every.recorded, strict=True)
    found = SomePixels(
        replace(every.scene, exit_grid=points),
        every.illumination,
        [recorded_points(plane, one.distance_mm, apart, every.fill_factor) for plane, one in planes],
        every.scale,
        0.0,
        every.make,
        tuple(slice(n * len(y_mm), (n + 1) * len(y_mm)) for n in range(len(every.recorded))),
    )
    straight = (found.comes_straight_to(number) for number in range(len(found.recorded)))
    return found if all(straight) else None


def with_fast_shape(scene: Scene, recorded: Sequence[Measurement]) -> tuple[Scene, tuple[Measurement, ...]]:
    """The same with some more pixels about the middle, of which nothing is known.

    A transform of 438 samples (2, 3 and 73) takes three times as long as one of 440.

    Parameters
    ----------
    scene
        To all pixels.
    recorded
        Planes, with `sigma` if there are to be more pixels: others stay as they are.
    """
    grid = scene.exit_grid
    more = [scipy.fft.next_fast_len(count) - count for count in grid.shape]
    if not any(more) or any(plane.sigma is None for plane in recorded):
        return scene, tuple(recorded)
    sides = [(count // 2, count - count // 2) for count in more]
    y_mm, x_mm = (0.5 * grid.pitch_mm * (after - before) for before, after in sides)
    wider = replace(
        grid,
        shape=tuple(count + added for count, added in zip(grid.shape, more, strict=True)),
        centre_mm=(grid.centre_mm[0] + x_mm, grid.centre_mm[1] + y_mm),
    )
    # Amplitudes that are those beside them, so that a plane's mean, of which backgrounds are shares, stays.
    planes = [
        replace(
            plane,
            amplitude=np.pad(plane.amplitude, sides, mode="edge"),
            sigma=np.pad(np.asarray(plane.sigma), sides, constant_values=np.inf),
        )
        for plane in recorded
    ]
    return replace(scene, exit_grid=wider), tuple(planes)
