"""Some of the pixels, straight from the object: where each detail of the frames covers many of them.

A small patch of the object makes no finer fringes on a plane than lambda f / w, for light of its width w
leaves the lens within w / f. Through a large lens that is many pixels, of which every few are enough, and
tiles carry light straight to them, plane after plane: nothing has to hold the carrier of all light together,
which takes every pixel, and free space between planes is in the rays.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lensdesign.analysis.paraxial import first_order
from wavesim.calibration.joint.lens_changes import Changed, by_rays, path_slopes
from wavesim.calibration.joint.pixels import Pixels, RaySlopes, moved
from wavesim.calibration.joint.ray_changes import SensorPose
from wavesim.calibration.joint.turned_tiles import TurnedTiles
from wavesim.calibration.parameters import Parameter, Unknowns
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.linear.linearised import Linearised, RealArray
from wavesim.reconstruction.linear.measurement_operator import ComplexArray
from wavesim.scene.bench import Bench
from wavesim.scene.engine import Grids, Operator
from wavesim.scene.scene import Scene, placed_scene
from wavesim.sensor.frame_sets import frames_by_plane
from wavesim.sensor.frames import Frame
from wavesim.sensor.mounting import light_on, planes_at
from wavesim.sensor.pixels.points import points_among, recorded_points
from wavesim.targets.patch import Patch

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
        return parameter.part != "light" and not parameter.name.endswith("_background")

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
