"""The lens as mounted, from frames of a known object: decenter, tilt, working distance, plane distances.

The misfit of amplitudes depends on the mounting through the lens alone, and its derivatives come from rigid
motions: moving the lens is moving object and sensor the other way, so that with G the generator of a motion

    dA/dp = G_exit A - A G_object.

A first, coarse search compares blurred intensities. Decenter and tilt of one lens do nearly the same to its
light: the search goes along directions in which the misfit is alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_whole_number
from lensdesign.lens.lens import Lens
from wavesim.calibration.calibrated import Calibrated
from wavesim.calibration.response import RealArray, Response, mounting_response
from wavesim.calibration.search import GaussNewton, Minimum
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.scene.bench import Bench
from wavesim.scene.engine import Engine
from wavesim.scene.placement import NOMINAL, Placement
from wavesim.scene.scene import Scene, placed_scene
from wavesim.sensor.measurement import Measurement, noise_misfit
from wavesim.sensor.mounting import (
    DECENTERS,
    RIGID,
    TILTS,
    light_on,
    planes_at,
    validate_parameters,
    values_of,
    with_values,
)

Make = Callable[[Scene], Engine]
Progress = Callable[[str, int, Placement, float], None]

COARSE_BLUR_PIXELS = 8.0
"""Of the coarse search: wider than the fringes at the border of the field stop's shadow."""

COARSE_MOUNTINGS = 8
"""That the coarse search may try; it only has to come near."""

LEAST_GAIN = 3e-3
"""A search by derivatives ends when a step lowers the squared misfit by less than this share."""

DECENTER_REACH, TILT_REACH_DEG, DISTANCE_REACH = 0.1, 5.0, 0.02
"""Farthest that is looked: decenters as a share of the lens's diameter, distances as a share of
the object's."""


def eikonal_tiles(scene: Scene) -> Engine:
    """The engine that calibration takes if none is named: eikonal tiles with an error of 0.1."""
    return engine_for(scene, "eikonal", error=0.1)


def calibrate(
    scene: Scene,
    illumination: Field,
    recorded: Sequence[Measurement],
    *,
    known: Field,
    parameters: Sequence[str] = RIGID,
    scale: float | None = None,
    fill_factor: float = 0.0,
    start: Placement = NOMINAL,
    make: Make = eikonal_tiles,
    most_mountings: int = 80,
    progress: Progress | None = None,
) -> Calibrated:
    """Find how the lens is mounted.

    Parameters
    ----------
    scene
        The nominal lens and grids.
    illumination
        On the nominal object grid, field stop included.
    recorded
        One plane or more, at nominal distances from the exit grid.
    known
        Transmission of the object.
    parameters
        What is unknown, by the names of :func:`wavesim.sensor.mounting.parameter_names`.
    scale, fill_factor
        As of :func:`wavesim.reconstruct`.
    start
        Where the search begins, and what holds for parameters that are not sought.
    make
        Makes the engine of a scene.
    most_mountings
        That are tried in the fine search.
    progress
        Called after each mounting tried with the search's name, its number, the mounting and its misfit.

    Raises
    ------
    InputError
        If a value or a shape is not usable, or no light gets through the lens at the start.
    """
    validate_parameters(parameters, len(recorded))
    validate_whole_number("most_mountings", most_mountings, 1)
    if known.grid != illumination.grid:
        raise InputError(f"known object: its grid {known.grid} is not the illumination's {illumination.grid}")
    seen = _Seen(scene, illumination, recorded, known, scale, fill_factor, make)
    begin, rigid = start, tuple(name for name in parameters if name in RIGID)
    if rigid:
        coarse = _Trail("coarse", seen.shadows, start, rigid, progress)
        begin = coarse.mounting(
            coarse.search(_reach(scene.lens, rigid), min(most_mountings, COARSE_MOUNTINGS)).point
        )
    fine = _Trail("fine", seen.frames, begin, tuple(parameters), progress)
    reach = _reach(scene.lens, parameters)
    found = fine.search(reach, most_mountings)
    at_reach = tuple(n for n, v, r in zip(parameters, found.point, reach, strict=True) if abs(v) > 0.999 * r)
    return Calibrated(
        bench=Bench(fine.mounting(found.point)),
        parameters=tuple(parameters),
        values=tuple(found.point.tolist()),
        deviations=None,
        typical=None,
        misfit_before=seen.frames(start, ()).misfit,
        misfit=found.size,
        trail=tuple(fine.tried),
        at_reach=at_reach,
        stopped_because=found.stopped_because,
        misfit_of_noise=noise_misfit(recorded),
    )


def _reach(lens: Lens, parameters: Sequence[str]) -> Array:
    """How far from the design each parameter is looked for."""
    width = 2.0 * min(s.semi_diameter_mm or np.inf for s in lens.surfaces)
    if not np.isfinite(width):
        width = abs(lens.object_z_mm)
    reach = dict.fromkeys(DECENTERS, DECENTER_REACH * width) | dict.fromkeys(TILTS, TILT_REACH_DEG)
    return np.array([reach.get(name, DISTANCE_REACH * abs(lens.object_z_mm)) for name in parameters])


@dataclass(frozen=True, eq=False)
class _Seen:
    """The frames, and what is known of how they came about; fields as of :func:`calibrate`."""

    scene: Scene
    illumination: Field
    recorded: Sequence[Measurement]
    known: Field
    scale: float | None
    fill_factor: float
    make: Make

    def shadows(self, mounting: Placement, names: Sequence[str]) -> Response:
        """Blurred."""
        return self._response(mounting, names, COARSE_BLUR_PIXELS)

    def frames(self, mounting: Placement, names: Sequence[str]) -> Response:
        """As they are."""
        return self._response(mounting, names, 0.0)

    def _response(self, mounting: Placement, names: Sequence[str], blur_pixels: float) -> Response:
        return mounting_response(
            self._model(mounting),
            np.asarray(self.known.values),
            mounting,
            names,
            blur_pixels=blur_pixels,
            fits_scale=self.scale is None,
        )

    def _model(self, mounting: Placement) -> ForwardModel:
        return ForwardModel(
            self.make(placed_scene(self.scene, mounting)),
            light_on(self.illumination, mounting),
            planes_at(self.recorded, mounting),
            self.scale,
            self.fill_factor,
        )


class _Trail:
    """A search among mountings, and a trail of those tried."""

    def __init__(
        self,
        name: str,
        respond: Callable[[Placement, Sequence[str]], Response],
        start: Placement,
        parameters: tuple[str, ...],
        progress: Progress | None,
    ) -> None:
        self.name, self.respond, self.start = name, respond, start
        self.parameters, self.progress = parameters, progress
        self.tried: list[tuple[tuple[float, ...], float]] = []

    def mounting(self, point: Array) -> Placement:
        return with_values(self.start, self.parameters, list(point))

    def search(self, reach: Array, most: int) -> Minimum:
        """By the responses' own derivatives, which are those of the whole model."""

        def model(point: Array) -> tuple[RealArray, RealArray]:
            response = self.respond(self.mounting(point), self.parameters)
            self._tell(point, response.misfit)
            return response.residual, response.changes

        return GaussNewton(model, values_of(self.start, self.parameters), reach).run(LEAST_GAIN, most)

    def _tell(self, point: Array, misfit: float) -> None:
        self.tried.append((tuple(point.tolist()), misfit))
        if self.progress is not None:
            self.progress(self.name, len(self.tried), self.mounting(point), misfit)
