"""Which pixels of the frames a search looks at, and what parameters of a bench do to them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wavesim.calibration.joint.lens_changes import Changed, PathSlopes, by_engines, by_rays, path_slopes
from wavesim.calibration.joint.turned_tiles import TurnedTiles
from wavesim.calibration.parameters import SENSOR_TILTS, Parameter, Unknowns, light_orders
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linear.linearised import Linearised, RealArray
from wavesim.reconstruction.linear.measurement_operator import ComplexArray, FreeSpaceMeasurement
from wavesim.scene.bench import Orders, light_mode
from wavesim.scene.engine import Engine, Operator
from wavesim.scene.scene import Scene, placed_scene
from wavesim.sensor.measurement import Measurement
from wavesim.sensor.mounting import light_on, planes_at


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
            elif parameter.part == "light":
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
        return parameter.part in ("lens", "mounting")

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
        name, sight = parameter.name, linear.sight
        assert isinstance(sight, FreeSpaceMeasurement)
        if name in SENSOR_TILTS:
            return linear.of_planes(sight.by_tilt(SENSOR_TILTS.index(name)))
        plane = plane_number(parameter)
        if name.startswith("plane_distance"):
            return linear.of_plane(plane, sight.by_distance(plane))
        return linear.of_plane(plane, sight.by_shift(plane, "xy".index(name.split("_")[3])))


def plane_number(parameter: Parameter) -> int:
    """Of the plane that a camera's parameter is of, from 0."""
    return next(int(word) for word in parameter.name.split("_") if word.isdecimal()) - 1


def moved(unknowns: Unknowns, parameter: Parameter) -> Unknowns:
    """The bench with one parameter a small step on."""
    here = unknowns.values.get(parameter.name, 0.0)
    return unknowns.changed([parameter.name], [here + parameter.small])
