"""The lens as mounted, from the frames alone: decenter, tilt, working distance, plane distances.

For each mounting that is tried, the object is reconstructed in a few iterations; nlopt makes small what is
left of the misfit of amplitudes. At the best object the misfit depends on the mounting through the lens
alone, and its derivatives come from rigid motions: moving the lens is moving object and sensor the other
way, so that with G the generator of a motion

    dA/dp = G_exit A - A G_object.

A first, coarse search compares blurred intensities with those of the light without an object. A known object
(a target) needs no reconstruction.

Decenter and tilt of one lens do nearly the same to its light. The search goes along directions in which the
lens's own share of the misfit is alike, which keeps the small difference in sight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.notebook import html_table
from lensdesign.errors import InputError, refuse_not_whole
from lensdesign.lens.lens import Lens
from wavesim.calibration.response import RealArray, Response, mounting_response
from wavesim.calibration.search import GaussNewton, Minimum, interpolated_minimum
from wavesim.camera.mounting import (
    DECENTERS,
    TILTS,
    light_on,
    planes_at,
    refuse_parameters,
    values_of,
    with_values,
)
from wavesim.camera.recorded import Recorded, weights_of
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.reconstruction.from_object import Kind, reconstruct
from wavesim.reconstruction.recording_model import RecordingModel
from wavesim.scene.engine import Engine
from wavesim.scene.placement import NOMINAL, Placement
from wavesim.scene.scene import Scene, placed_scene

ComplexArray = NDArray[np.complexfloating]
Make = Callable[[Scene], Engine]
Progress = Callable[[str, int, Placement, float], None]

RIGID = (*DECENTERS, *TILTS)

COARSE_BLUR_PIXELS = 8.0
"""Of the coarse search: wider than the fringes at the border of the field stop's shadow."""

COARSE_MOUNTINGS = 8
"""That the coarse search may try; it only has to come near."""

LEAST_GAIN = 3e-3
"""A search by derivatives ends when a step lowers the squared misfit by less than this share."""

SAME_POINT = 1e-6
"""Shares of the reach by which points of two runs may differ by rounding."""

DECENTER_REACH, TILT_REACH_DEG, DISTANCE_REACH = 0.1, 5.0, 0.02
"""Farthest that is looked: decenters as a share of the lens's diameter, distances as a share of
the object's."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A mounting that explains the frames, and how well it does.

    Attributes
    ----------
    mounting : Placement
        The lens as mounted.
    parameters : tuple of str
        Those that were sought.
    misfit_before, misfit : float
        Relative L2 difference of amplitudes at the start and with the mounting found, each with the best
        object.
    trail : tuple of (Placement, float)
        Mountings tried in the fine search, and their misfits.
    at_reach : tuple of str
        Parameters that ended at the border of what was searched.
    stopped_because : str
        What ended the fine search.
    misfit_of_noise : float or None
        What the stated noise alone would leave (:func:`noise_misfit`).
    """

    mounting: Placement
    parameters: tuple[str, ...]
    misfit_before: float
    misfit: float
    trail: tuple[tuple[Placement, float], ...]
    at_reach: tuple[str, ...]
    stopped_because: str
    misfit_of_noise: float | None

    def __repr__(self) -> str:
        return f"Calibrated({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Lens as mounted", self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        values = values_of(self.mounting, self.parameters).tolist()
        noise = "" if self.misfit_of_noise is None else f", noise alone {self.misfit_of_noise:.4g}"
        told = [(name, f"{value:.5g}") for name, value in zip(self.parameters, values, strict=True)]
        told.append(("misfit", f"{self.misfit:.4g}, before {self.misfit_before:.4g}{noise}"))
        told.append(("search", f"{len(self.trail)} mountings, {self.stopped_because}"))
        return told + [("at the border", ", ".join(self.at_reach))] * bool(self.at_reach)


def eikonal_tiles(scene: Scene) -> Engine:
    """The engine that calibration takes if none is named: eikonal tiles with an error of 0.1."""
    return engine_for(scene, "eikonal", error=0.1)


def calibrate(
    scene: Scene,
    illumination: Field,
    recorded: Sequence[Recorded],
    *,
    parameters: Sequence[str] = RIGID,
    known: Field | None = None,
    kind: Kind = "amplitude",
    tv_weight: float = 0.0,
    iterations: int = 8,
    scale: float | None = None,
    active_width: float = 0.0,
    start: Placement = NOMINAL,
    make: Make = eikonal_tiles,
    most_mountings: int = 80,
    tried: Sequence[tuple[Placement, float]] = (),
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
    parameters
        What is unknown, by the names of :func:`wavesim.camera.mounting.parameter_names`.
    known
        Transmission of the object where it is known; left out, it is sought together with the mounting.
    kind, tv_weight, scale, active_width
        As of :func:`wavesim.reconstruct`.
    iterations
        Of each reconstruction.
    start
        Where the search begins, and what holds for parameters that are not sought.
    make
        Makes the engine of a scene.
    most_mountings
        That are tried in the fine search.
    tried
        Trail of an earlier run that was cut off, from its first mounting on: it is not computed again.
    progress
        Called after each mounting tried with the search's name, its number, the mounting and its misfit.

    Raises
    ------
    InputError
        If a value or a shape is not usable, or no light gets through the lens at the start.
    """
    refuse_parameters(parameters, len(recorded))
    refuse_not_whole("most_mountings", most_mountings, 1)
    if known is not None and known.grid != illumination.grid:
        raise InputError(f"known object: its grid {known.grid} is not the illumination's {illumination.grid}")
    seen = _Seen(scene, illumination, recorded, known, kind, tv_weight, iterations, scale, active_width, make)
    begin, rigid = start, tuple(name for name in parameters if name in RIGID)
    if tried:
        begin = tried[0][0]
    elif rigid:
        coarse = _Trail("coarse", seen.shadows, start, rigid, progress)
        begin = coarse.mounting(
            coarse.linear_search(_reach(scene.lens, rigid), min(most_mountings, COARSE_MOUNTINGS)).point
        )
    fine = _Trail("fine", seen.frames, begin, tuple(parameters), progress, tried)
    reach = _reach(scene.lens, parameters)
    search = fine.search if known is None else fine.linear_search
    found = search(reach, most_mountings)
    at_reach = tuple(n for n, v, r in zip(parameters, found.point, reach, strict=True) if abs(v) > 0.999 * r)
    return Calibrated(
        mounting=fine.mounting(found.point),
        parameters=tuple(parameters),
        misfit_before=seen.frames(start, ()).misfit,
        misfit=found.size,
        trail=tuple(fine.tried),
        at_reach=at_reach,
        stopped_because=found.stopped_because,
        misfit_of_noise=noise_misfit(recorded),
    )


def noise_misfit(recorded: Sequence[Recorded]) -> float | None:
    """Misfit that the stated noise alone would leave; None where a plane has no standard deviations."""
    missed = size = 0.0
    for plane, weight in zip(recorded, weights_of(recorded), strict=True):
        if plane.sigma is None or weight is None:
            return None
        known = np.isfinite(plane.sigma)
        missed += float(np.sum(weight[known] * plane.sigma[known] ** 2))
        size += float(np.sum(weight[known] * plane.amplitude[known] ** 2))
    return math.sqrt(missed / size)


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
    recorded: Sequence[Recorded]
    known: Field | None
    kind: Kind
    tv_weight: float
    iterations: int
    scale: float | None
    active_width: float
    make: Make

    def shadows(self, mounting: Placement, names: Sequence[str]) -> Response:
        """Blurred: the light without an object, or with the known one."""
        model = self._model(mounting)
        return mounting_response(
            model,
            self._known(model),
            mounting,
            names,
            blur_pixels=COARSE_BLUR_PIXELS,
            fits_scale=self.scale is None,
        )

    def frames(self, mounting: Placement, names: Sequence[str]) -> Response:
        """As they are: the object that fits the mounting best, or the known one."""
        model = self._model(mounting)
        transmission = self._known(model)
        if self.known is None:
            found = reconstruct(
                model.engine,
                model.illumination,
                model.recorded,
                kind=self.kind,
                tv_weight=self.tv_weight,
                iterations=self.iterations,
                scale=self.scale,
                active_width=self.active_width,
            )
            transmission, model.scale = found.transmission.values, found.scale
        return mounting_response(model, transmission, mounting, names, fits_scale=self.scale is None)

    def _model(self, mounting: Placement) -> RecordingModel:
        return RecordingModel(
            self.make(placed_scene(self.scene, mounting)),
            light_on(self.illumination, mounting),
            planes_at(self.recorded, mounting),
            self.scale,
            self.active_width,
        )

    def _known(self, model: RecordingModel) -> ComplexArray:
        if self.known is not None:
            return np.asarray(self.known.values)
        return model.lit.astype(model.illumination.values.dtype)


class _Trail:
    """A search among mountings, and a trail of those tried."""

    def __init__(
        self,
        name: str,
        respond: Callable[[Placement, Sequence[str]], Response],
        start: Placement,
        parameters: tuple[str, ...],
        progress: Progress | None,
        before: Sequence[tuple[Placement, float]] = (),
    ) -> None:
        self.name, self.respond, self.start = name, respond, start
        self.parameters, self.progress, self.before = parameters, progress, before
        self.tried: list[tuple[Placement, float]] = []

    def mounting(self, point: Array) -> Placement:
        return with_values(self.start, self.parameters, list(point))

    def linear_search(self, reach: Array, most: int) -> Minimum:
        """By the responses' own derivatives, which are those of the whole model."""

        def model(point: Array) -> tuple[RealArray, RealArray]:
            response = self.respond(self.mounting(point), self.parameters)
            self._tell(point, response.misfit)
            return response.residual, response.changes

        return GaussNewton(model, values_of(self.start, self.parameters), reach).run(LEAST_GAIN, most)

    def search(self, reach: Array, most: int) -> Minimum:
        """Without derivatives, but for those at the start that leave the object as it is."""
        start = values_of(self.start, self.parameters)
        first = self.respond(self.start, self.parameters)

        def misfit(point: Array) -> float:
            size = self._told_before(point, reach)
            if size is None and np.array_equal(point, start):
                size = first.misfit
            if size is None:
                size = self.respond(self.mounting(point), ()).misfit
            self._tell(point, size)
            return size

        return interpolated_minimum(misfit, start, reach, first.changes, most)

    def _told_before(self, point: Array, reach: Array) -> float | None:
        """Misfit from an earlier run, whose points are the same but for rounding."""
        if len(self.tried) >= len(self.before):
            return None
        mounting, size = self.before[len(self.tried)]
        away = np.abs(values_of(mounting, self.parameters) - point) / reach
        return size if np.max(away) < SAME_POINT else None

    def _tell(self, point: Array, misfit: float) -> None:
        self.tried.append((self.mounting(point), misfit))
        if self.progress is not None:
            self.progress(self.name, len(self.tried), *self.tried[-1])
