"""Mounting of the lens from frames of a known object: decenter, tilt, working distance, plane distances.

The misfit of amplitudes depends on the mounting only through the lens. Its derivatives follow from rigid
motions, because a motion of the lens is equivalent to the opposite motion of object and sensor. With the
generator G of a motion and the propagation A,

    dA/dp = G_exit A - A G_object.

A first, coarse search compares blurred intensities. Decenter and tilt of a lens have nearly the same effect
on its light; the search therefore uses directions in which the misfit has similar curvature.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_whole_number
from lensdesign.lens.lens import Lens
from wavesim.calibration.calibration_result import Calibrated
from wavesim.calibration.parameters import (
    Decenter,
    LensPose,
    Parameter,
    Unknowns,
    chosen_parameters,
    mounting_parameters,
)
from wavesim.calibration.response import RealArray, Response, mounting_response
from wavesim.calibration.trust_region import GaussNewton, Minimum
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene, placed_light, placed_scene
from wavesim.scene.system_state import AS_DESIGNED, SystemState
from wavesim.sensor.measurement import Measurement, noise_misfit, placed_planes

Make = Callable[[Scene], Engine]
Progress = Callable[[str, int, SystemState, float], None]

DECENTER_RANGE, TILT_RANGE_DEG, DISTANCE_RANGE = 0.1, 5.0, 0.02
"""Range of the search: decenters over the lens's diameter, tilts in deg, distances over that of the
object.
"""


def eikonal_tiles(scene: Scene) -> Engine:
    """Return the default engine of a calibration: eikonal tiles with an error of at most 0.1."""
    return engine_for(scene, "eikonal", error=0.1)


def calibrate(
    scene: Scene,
    illumination: Field,
    recorded: Sequence[Measurement],
    *,
    known: Field,
    parameters: str = "rigid",
    scale: float | None = None,
    fill_factor: float = 0.0,
    start: SystemState = AS_DESIGNED,
    make: Make = eikonal_tiles,
    most_mountings: int = 80,
    progress: Progress | None = None,
) -> Calibrated:
    """Find the mounting of the lens from frames of a known object.

    Parameters
    ----------
    scene
        The nominal lens and grids.
    illumination
        Field on the nominal object grid, with the field stop applied.
    recorded
        Measured amplitudes of one or more planes, at nominal distances from the exit grid.
    known
        Transmission of the object.
    parameters
        Parameters to find, separated by commas: decenter_x_mm, decenter_y_mm, tilt_x_deg, tilt_y_deg (all
        four: rigid), working_distance_mm, plane_distance_1_mm and so on; or all.
    scale, fill_factor
        See :func:`wavesim.reconstruct`.
    start
        Mounting at which the search starts, and values of parameters that are not sought.
    make
        Function that returns the engine of a scene.
    most_mountings
        Largest number of mountings in the fine search.
    progress
        Callback `progress(search, count, mounting, misfit)`, called after each mounting.

    Returns
    -------
    Calibrated
        The mounting, and the misfits of all mountings that were tried.

    Raises
    ------
    InputError
        If a value or a shape is invalid, or no light passes the lens at the start.
    """
    sought = chosen_parameters(parameters, mounting_parameters(scene.lens, len(recorded)))
    validate_whole_number("most_mountings", most_mountings, 1)
    if known.grid != illumination.grid:
        raise InputError(f"known object: its grid {known.grid} is not the illumination's {illumination.grid}")
    problem = _MountingProblem(scene, illumination, recorded, known, scale, fill_factor, make)
    fine_start, rigid = start, tuple(p for p in sought if isinstance(p, LensPose))
    if rigid:
        coarse_search = _MountingSearch("coarse", problem.blurred, start, rigid, progress)
        # Largest number of mountings in the coarse search, which only needs to come near.
        coarse_mountings = 8
        fine_start = coarse_search.mounting(
            coarse_search.search(
                _search_range(scene.lens, rigid), min(most_mountings, coarse_mountings)
            ).point
        )
    fine_search = _MountingSearch("fine", problem.frames, fine_start, sought, progress)
    search_range = _search_range(scene.lens, sought)
    found = fine_search.search(search_range, most_mountings)
    at_reach = tuple(
        p.name for p, v, r in zip(sought, found.point, search_range, strict=True) if abs(v) > 0.999 * r
    )
    return Calibrated(
        state=fine_search.mounting(found.point),
        sought=sought,
        values=tuple(found.point.tolist()),
        deviations=None,
        typical=None,
        misfit_before=problem.frames(start, ()).misfit,
        misfit=found.residual_norm,
        trail=tuple(fine_search.trail),
        at_reach=at_reach,
        stopped_because=found.stopped_because,
        misfit_of_noise=noise_misfit(recorded),
    )


def _search_range(lens: Lens, parameters: Sequence[Parameter]) -> Array:
    """Return the range of the search for each parameter."""
    diameter_mm = 2.0 * min(s.semi_diameter_mm or np.inf for s in lens.surfaces)
    if not np.isfinite(diameter_mm):
        diameter_mm = abs(lens.object_z_mm)
    ranges: dict[type[Parameter], float] = {Decenter: DECENTER_RANGE * diameter_mm, LensPose: TILT_RANGE_DEG}
    return np.array([ranges.get(type(p), DISTANCE_RANGE * abs(lens.object_z_mm)) for p in parameters])


@dataclass(frozen=True, eq=False)
class _MountingProblem:
    """Frames and known object; for the fields see :func:`calibrate`."""

    scene: Scene
    illumination: Field
    recorded: Sequence[Measurement]
    known: Field
    scale: float | None
    fill_factor: float
    make: Make

    def blurred(self, mounting: SystemState, parameters: Sequence[Parameter]) -> Response:
        """Return the response of blurred intensities."""
        # Blur of the coarse search, wider than the fringes at the border of the field stop's shadow.
        coarse_blur_pixels = 8.0
        return self._response(mounting, parameters, coarse_blur_pixels)

    def frames(self, mounting: SystemState, parameters: Sequence[Parameter]) -> Response:
        """Return the response of the frames themselves."""
        return self._response(mounting, parameters, 0.0)

    def _response(
        self, mounting: SystemState, parameters: Sequence[Parameter], blur_pixels: float
    ) -> Response:
        return mounting_response(
            self._model(mounting),
            np.asarray(self.known.values),
            mounting,
            parameters,
            blur_pixels=blur_pixels,
            fits_scale=self.scale is None,
        )

    def _model(self, mounting: SystemState) -> ChannelModel:
        return ChannelModel.of_source(
            self.make(placed_scene(self.scene, mounting)),
            placed_light(self.illumination, mounting),
            placed_planes(self.recorded, mounting),
            self.scale,
            self.fill_factor,
        )


class _MountingSearch:
    """A search among mountings, with a record of all trials."""

    def __init__(
        self,
        name: str,
        respond: Callable[[SystemState, Sequence[Parameter]], Response],
        start: SystemState,
        parameters: tuple[Parameter, ...],
        progress: Progress | None,
    ) -> None:
        self.name, self.respond, self.start = name, respond, start
        self.parameters, self.progress = parameters, progress
        self.trail: list[tuple[tuple[float, ...], float]] = []

    def mounting(self, point: Array) -> SystemState:
        return Unknowns(self.start).changed(self.parameters, list(point)).state

    def search(self, search_range: Array, most_evaluations: int) -> Minimum:
        """Search with the derivatives of the whole model."""

        def model(point: Array) -> tuple[RealArray, RealArray]:
            response = self.respond(self.mounting(point), self.parameters)
            self._record(point, response.misfit)
            return response.residual, response.changes

        # The fine search ends when a step reduces the squared misfit by less than this fraction.
        least_gain = 3e-3
        start = np.array([parameter.value(self.start) for parameter in self.parameters])
        return GaussNewton(model, start, search_range).run(least_gain, most_evaluations)

    def _record(self, point: Array, misfit: float) -> None:
        self.trail.append((tuple(point.tolist()), misfit))
        if self.progress is not None:
            self.progress(self.name, len(self.trail), self.mounting(point), misfit)
