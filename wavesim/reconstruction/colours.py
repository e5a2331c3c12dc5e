"""Reconstruction from frames of several wavelengths: the object at each of them, or a film that all share.

Frames may be recorded one wavelength after the other, at once on a monochrome sensor, or at once through a
colour filter array. All wavelengths are found together (:mod:`wavesim.forward.channel_model`), by the solver
of one wavelength (:mod:`wavesim.reconstruction.object_solver`). The mosaic of a filter array is used as it
is.

A thickness that all wavelengths share is found in two stages. The first one finds the object at each
wavelength, whose phases determine heights (:mod:`wavesim.reconstruction.heights`). The second one projects
every iterate on films a exp(i k h), with the amplitude a and the height h of each sample.

Standard deviations of heights follow from repeats: the frames are modelled from the result, get other noise,
and are reconstructed again from the same start as the frames. The ratio of the misfit to that of noise, where
it is above 1, multiplies the deviations: residuals that noise does not explain count as more noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.analysis.oversampling import ObjectKind, Oversampling, oversampling_of, real_unknowns
from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Field
from wavesim.fields.files import write_arrays, write_field
from wavesim.forward.channel_model import Channel, ChannelModel, Response
from wavesim.forward.step_noise import noise_of_steps
from wavesim.metrics.goodness_of_fit import LIMIT, PlaneFit, plane_verdicts
from wavesim.metrics.plane_residuals import PlaneResidual
from wavesim.metrics.result_quality import plane_metrics, truth_metrics
from wavesim.plots.frames import save
from wavesim.reconstruction.colour_figures import colours_figure, heights_figure
from wavesim.reconstruction.diagnostics.held_out import HeldOut, hold_out
from wavesim.reconstruction.heights import (
    Heights,
    StepHeight,
    candidate_orders,
    common_phases,
    heights_from_phases,
    wave_numbers,
    wrapped,
)
from wavesim.reconstruction.object_solver import (
    AMPLITUDE_START,
    TV_PER_NOISE,
    ProximalDescent,
    SolverState,
    Stage,
)
from wavesim.reconstruction.prior_bias import LEAST_FACTOR, may_be_biased
from wavesim.reconstruction.problem import key_of_frames, validate_frames
from wavesim.reconstruction.resumable import state_of, state_saver
from wavesim.reconstruction.stop_rule import FAR, STOPPED, Stop
from wavesim.reconstruction.total_variation import prox_tv
from wavesim.runtime.checkpoint import CheckpointSeries
from wavesim.runtime.result import WritableResult
from wavesim.runtime.result_files import write_csv
from wavesim.runtime.scratch import Scratch
from wavesim.scene.scattered_light import Light
from wavesim.scene.settings import ColourSettings, Kind, SettingError
from wavesim.sensor.frame_sets import recorded_planes, validate_same_pitch
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import (
    Measurement,
    intensity_deviation,
    noise_misfit,
    with_intensity,
)
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import check_footprint, exit_scene, imaging_engine
from wavesim.targets.patch import Patch, lit, object_patch, read_coloured_object

Transmissions = NDArray[np.complexfloating[Any, Any]]
Prox = Callable[[NDArray[Any], float], NDArray[Any]]

LEAST_DIFFERENCE = 1e-4
"""Relative difference of two wavelengths, below which they are two statements of the same one."""


class ColourPlane(NamedTuple):
    """A recording plane: the settings of its frames, and the kind of its pixels.

    Attributes
    ----------
    distance_mm : float
        Distance from the exit vertex.
    wavelengths_um : tuple of float
        Wavelengths that were recorded at once.
    is_mosaic : bool
        Whether the responses differ from pixel to pixel.
    """

    distance_mm: float
    wavelengths_um: tuple[float, ...]
    is_mosaic: bool


@dataclass(frozen=True, eq=False, repr=False)
class FoundColours(WritableResult):
    """An object at several wavelengths, found from frames, with its assessment.

    Attributes
    ----------
    settings : ColourSettings
        Settings of the reconstruction.
    patch : Patch
        Samples of the object, and its field stop.
    wavelengths_um : tuple of float
        Wavelengths, increasing.
    transmissions : tuple of Field
        Transmission at each wavelength. Its phase is relative to the ground if heights were sought.
    planes : tuple of ColourPlane
        Recorded planes. A plane of several wavelengths one after the other counts once for each.
    recorded, residual_maps : tuple
        Measured amplitudes, and modelled less measured ones, of each plane.
    misfit : tuple of float
        Relative misfit of each iteration.
    over_noise : float
        Last misfit over the misfit of noise alone.
    fits : tuple of PlaneFit
        Goodness of fit of each plane, on fitted pixels and on pixels that were held out.
    stopped_because : {"noise", "converged", "iterations"}
        Reason for the end of the iterations.
    scale : float
        Measured amplitude per unit of the modelled amplitude.
    oversampling : Oversampling
        Real measurements for each real unknown.
    truth : tuple of dict
        For each wavelength, the comparison with the true object; empty without one.
    heights : Heights or None
        Height of a film with its deviation, for each sample.
    repeats : tuple of ndarray
        Transmissions, shape (wavelengths, ny, nx), that repeats with other noise have found; empty without
        heights.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_colours
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, "star", wavelengths_um=(0.532, 0.635), planes_mm=(0.03, 0.3), **patch)
    >>> found = reconstruct_colours(lens, taken.frames, kind="amplitude", iterations=2, **patch)
    >>> found.wavelengths_um, len(found.transmissions), found.planes[0].is_mosaic
    ((0.532, 0.635), 2, False)
    """

    heading, file = "Object at several wavelengths", "colours.json"

    settings: ColourSettings
    patch: Patch
    wavelengths_um: tuple[float, ...]
    transmissions: tuple[Field, ...]
    planes: tuple[ColourPlane, ...]
    recorded: tuple[Measurement, ...]
    residual_maps: tuple[Array, ...]
    misfit: tuple[float, ...]
    over_noise: float
    fits: tuple[PlaneFit, ...]
    stopped_because: Stop
    scale: float
    oversampling: Oversampling
    truth: tuple[dict[str, float | None], ...] = ()
    heights: Heights | None = None
    repeats: tuple[Transmissions, ...] = field(default=(), repr=False)

    @property
    def _excess(self) -> float:
        """Factor of the deviations by noise: residuals beyond the noise count as more noise."""
        return max(self.over_noise, 1.0)

    @property
    def explained(self) -> bool:
        """True if noise explains the residuals of each plane, by the limit of a single wavelength."""
        return max(fit.over_noise or 0.0 for fit in self.fits) <= LIMIT

    @property
    def predicts_held_out(self) -> bool:
        """True if the residuals on held-out pixels are within the limit of a single wavelength.

        Where they are not, the object may be wrong, although noise explains the residuals on fitted pixels.
        """
        return max(fit.excess for fit in self.fits) <= 1.0

    @property
    def held_out_over_noise(self) -> float:
        """Largest ratio of a plane's residuals to the noise, on pixels that were held out."""
        return max(fit.held_out_over_noise or 0.0 for fit in self.fits)

    def height_between(
        self, region_mm: tuple[float, float, float, float], ground_mm: tuple[float, float, float, float]
    ) -> StepHeight:
        """Return the height of a region above another one, with its standard deviation.

        The phases of a region are those of its mean transmission; their deviations are those of the repeats.

        Parameters
        ----------
        region_mm, ground_mm
            Regions (x, y, width, height) about their centres x, y.

        Raises
        ------
        InputError
            If heights were not sought, or a region does not lie on the samples.
        """
        if self.heights is None or self.settings.film_index is None:
            raise InputError("height_between: needs a reconstruction with film_index")
        masks = [self._region(one) for one in (region_mm, ground_mm)]

        def step(values: Transmissions) -> Array:
            of_region, of_ground = (values[:, mask].sum(axis=1) for mask in masks)
            return np.angle(of_region * of_ground.conj())

        phases = step(np.stack([one.values for one in self.transmissions]))
        differences = np.array([wrapped(step(one) - phases) for one in self.repeats])
        deviations = self._excess * np.sqrt(np.mean(differences**2, axis=0))
        found = heights_from_phases(
            phases[:, None],
            np.maximum(deviations, 1e-9)[:, None],
            self.wavelengths_um,
            self.settings.film_index,
            self.settings.heights_um,
        )
        # Errors of the wavelengths may be correlated: the deviation is that of the repeats' heights.
        numbers = wave_numbers(self.wavelengths_um, self.settings.film_index)
        precision = numbers / np.maximum(deviations, 1e-9) ** 2
        of_repeats = differences @ precision / float(precision @ numbers)
        deviation_um = self._excess * math.sqrt(float(np.mean(of_repeats**2)))
        return StepHeight(float(found.height_um[0]), deviation_um, bool(found.ambiguous[0]))

    def _region(self, region_mm: tuple[float, float, float, float]) -> NDArray[np.bool_]:
        """Return the samples of a region."""
        return _samples_of(self.patch, region_mm, "region_mm")

    def table(self) -> list[tuple[str, str]]:
        rows = [
            ("wavelengths", ", ".join(f"{one:g}" for one in self.wavelengths_um) + " µm"),
            ("planes", str(len(self.planes))),
            ("iterations", f"{len(self.misfit)}{STOPPED[self.stopped_because]}"),
            ("misfit over noise", f"{self.over_noise:.3g}, held out {self.held_out_over_noise:.3g}"),
            ("measurements for each unknown", f"{self.oversampling.ratio:.3g}"),
        ]
        for wavelength, truth in zip(self.wavelengths_um, self.truth, strict=bool(self.truth)):
            correlation = truth["object_correlation"]
            shown = "none" if correlation is None else f"{correlation:.4g}"
            rows.append((f"correlation at {wavelength:g} µm", shown))
        return rows

    def as_dict(self) -> dict[str, Any]:
        """Return the results as plain values for JSON."""
        inside = self.patch.inside
        heights = None
        if self.heights is not None:
            heights = {
                "film_index": self.settings.film_index,
                "median_um": float(np.median(self.heights.height_um[inside])),
                "median_deviation_um": float(np.median(self.heights.deviation_um[inside])),
                "ambiguous_fraction": float(np.mean(self.heights.ambiguous[inside])),
                "repeats": len(self.repeats),
            }
        return {
            "kind": self.settings.kind,
            "wavelengths_um": list(self.wavelengths_um),
            "iterations": len(self.misfit),
            "stopped_because": self.stopped_because,
            "misfit": self.misfit[-1],
            "over_noise": self.over_noise,
            "held_out_over_noise": self.held_out_over_noise,
            "explained": self.explained,
            "predicts_held_out": self.predicts_held_out,
            "scale": self.scale,
            "oversampling_ratio": self.oversampling.ratio,
            "planes": [
                {
                    "plane_distance_mm": plane.distance_mm,
                    "wavelengths_um": list(plane.wavelengths_um),
                    "mosaic": plane.is_mosaic,
                    **plane_metrics(recorded.amplitude, recorded.sigma, error),
                    "over_noise": fit.over_noise,
                    "held_out_over_noise": fit.held_out_over_noise,
                }
                for plane, recorded, error, fit in zip(
                    self.planes, self.recorded, self.residual_maps, self.fits, strict=True
                )
            ],
            "truth": [dict(one) for one in self.truth],
            "heights": heights,
        }

    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        inside = self.patch.inside
        title = f"{summary.get('design', '')}\n{summary['kind']} object, {self.patch.stop_words}".lstrip()
        for one in self.transmissions:
            write_field(one, folder / f"reconstruction_{one.wavelength_um:g}_um.npz")
        save(colours_figure(self.transmissions, inside, title), folder / "reconstruction.png")
        if self.heights is not None:
            write_arrays(
                folder / "heights.npz",
                height_um=self.heights.height_um,
                deviation_um=self.heights.deviation_um,
                ambiguous=self.heights.ambiguous,
                inside=inside,
                pitch_um=1e3 * self.patch.grid.pitch_mm,
            )
            drawn = heights_figure(self.heights, self.transmissions[0], inside, title)
            save(drawn, folder / "heights.png")
        rows = [{"iteration": n, "misfit": value} for n, value in enumerate(self.misfit, start=1)]
        write_csv(rows, folder / "convergence.csv")


def reconstruct_colours(
    lens: Lens,
    frames: Sequence[Frame],
    settings: ColourSettings | None = None,
    *,
    truth: Sequence[Field] | Path | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> FoundColours:
    """Reconstruct an object from frames of several wavelengths, all in one search.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        Frames of one or more planes, from :func:`wavesim.image` or :func:`wavesim.read_colour_frames`. They
        state their wavelengths, and how the pixels respond to those recorded at once.
    settings
        All settings; default: `ColourSettings()`.
    truth
        True transmission at each wavelength, in any order, on the patch's samples; or the folder of
        `wavesim image` with them.
    folder
        Folder of the checkpoints; the same call continues an interrupted run, and finds the same object.
    progress
        Callback `progress(stage, completed, total)`; the total is 0 where it is unknown.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    FoundColours
        Transmission at each wavelength, residuals, and heights of a film if its index was given.

    Raises
    ------
    InputError, SamplingError
        If frames or settings are invalid, or the frames have a single wavelength.

    Examples
    --------
    A star at two wavelengths, from three planes of a monochrome sensor:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_colours
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    >>> light = {"wavelengths_um": (0.532, 0.635), "exposures": (1.0, 30.0)}
    >>> taken = image(lens, "star", planes_mm=(0.03, 0.15, 0.3), **light, **patch)
    >>> found = reconstruct_colours(lens, taken.frames, kind="amplitude", truth=taken.coloured, **patch)
    >>> min(one["object_correlation"] for one in found.truth) > 0.95
    True
    """
    settings = (settings or ColourSettings()).replaced(**changes)
    validate_frames(lens, frames, settings)
    case = _problem(lens, frames, settings)
    true_objects = _true_objects(case, truth)
    checkpoints = CheckpointSeries(folder, _key(lens, frames, case, settings))
    search = _Search(case, settings, progress or (lambda stage, completed, total: None), checkpoints)
    found = search.find(case.recorded)
    state, descent, transmissions = found.state, found.descent, found.transmission.astype(np.complex64)
    heights, repeats = None, tuple[Transmissions, ...]()
    if settings.film_index is not None:
        heights, repeats = _heights(search, found)
    maps = [
        modelled - plane.amplitude
        for modelled, plane in zip(
            descent.model.amplitudes(state.transmission, state.scale), case.recorded, strict=True
        )
    ]
    fields = tuple(
        light.with_values(values) for light, values in zip(case.lights, transmissions, strict=True)
    )
    noise = noise_misfit(case.recorded)
    return FoundColours(
        settings=settings,
        patch=case.patch,
        wavelengths_um=case.wavelengths_um,
        transmissions=fields,
        planes=case.planes,
        recorded=case.recorded,
        residual_maps=tuple(maps),
        misfit=state.misfit,
        over_noise=state.misfit[-1] / noise if noise else math.nan,
        fits=tuple(plane_verdicts(_residuals(case, maps))),
        stopped_because=descent.stop(state) or "iterations",
        scale=float(state.scale or 1.0),
        oversampling=_oversampling(lens, case, settings),
        truth=_compared(case, fields, true_objects),
        heights=heights,
        repeats=repeats,
    )


class _Problem(NamedTuple):
    """Inputs of the search: objects, light, engines and measurements.

    Some pixels of each plane are held out of the measurements (infinite deviation), to test the result.
    """

    patch: Patch
    wavelengths_um: tuple[float, ...]
    lights: tuple[Field, ...]
    engines: tuple[Any, ...]
    planes: tuple[ColourPlane, ...]
    recorded: tuple[Measurement, ...]
    responses: tuple[tuple[Response, ...], ...]
    held_out: tuple[HeldOut, ...]

    def model(self, recorded: Sequence[Measurement], scale: float | None, fill_factor: float) -> ChannelModel:
        """Return the model of measured amplitudes of the planes, with a transmission for each wavelength."""
        channels = [
            Channel(engine, light, [plane[index] for plane in self.responses], index)
            for index, (engine, light) in enumerate(zip(self.engines, self.lights, strict=True))
        ]
        return ChannelModel.of(channels, recorded, scale, fill_factor)


def _problem(lens: Lens, frames: Sequence[Frame], settings: ColourSettings) -> _Problem:
    """Return the problem that frames and settings state, after checks of the frames."""
    if not frames:
        raise InputError("frames: needs at least one frame")
    validate_same_pitch(frames, lens)
    shapes = {frame.counts.shape for frame in frames}
    if len(shapes) > 1:
        sizes = ", ".join(f"{columns} x {rows}" for rows, columns in sorted(shapes))
        raise InputError(f"frames: have {sizes} pixels; must have the same size")
    wavelengths = tuple(sorted({one for frame in frames for one in frame.settings.wavelengths_um}))
    if len(wavelengths) < 2:
        raise InputError(
            f"frames: all are of {wavelengths[0]:g} um; must be of two or more wavelengths (for one "
            "wavelength use `wavesim reconstruct`)"
        )
    for one, other in pairwise(wavelengths):
        if math.isclose(one, other, rel_tol=LEAST_DIFFERENCE):
            raise InputError(
                f"frames: are of {one:.8g} and {other:.8g} um: wavelengths must be equal, or differ by more "
                f"than {100.0 * LEAST_DIFFERENCE:g} %"
            )
    rough = [number for number, surface in enumerate(lens.surfaces, start=1) if surface.roughness is not None]
    if rough:
        raise InputError(
            f"lens: surface {rough[0]} is rough; the light that rough surfaces scatter is not modelled at "
            "several wavelengths: omit the roughness, or use `wavesim reconstruct` at one wavelength"
        )
    if settings.film_index is not None:
        candidate_orders(wavelengths, settings.film_index, settings.heights_um)
    field_mm = lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm
    patch = object_patch(
        lens,
        field_mm,
        settings.field_stop_mm,
        wavelength_um=wavelengths[0],
        object_pitch_um=settings.object_pitch_um,
        field_stop_at_mm=settings.field_stop_at_mm or (0.0, 0.0),
    )
    if settings.ground_mm is not None:
        _samples_of(patch, settings.ground_mm, "{ground_mm}")
    lights = tuple(lit(replace(patch, wavelength_um=one), settings) for one in wavelengths)
    nearest = min(frame.settings.plane_distance_mm for frame in frames)
    rows, columns = frames[0].counts.shape
    sensor = lens.sensor.replaced(pixels=(columns, rows))
    distances = sorted({frame.settings.plane_distance_mm for frame in frames})
    for one in wavelengths:
        check_footprint(lens, replace(patch, wavelength_um=one), sensor, distances, settings.pose)
    scene = exit_scene(lens, patch, sensor, nearest, settings.pose)
    first = imaging_engine(scene, settings, runs=2 * settings.iterations, light=Light(lights[0]))
    planes, recorded, responses = [], [], []
    for group in _groups(frames):
        own, of_group = group[0].settings, recorded_planes(group, with_colours=True)
        seen = own.wavelengths_um
        on_pixels = [np.array(1.0)] if own.colours is None else own.colours.on_pixels((rows, columns))
        near = min(frame.settings.plane_distance_mm for frame in group)
        for plane in of_group:
            is_mosaic = own.colours is not None and not own.colours.is_monochrome
            planes.append(ColourPlane(near + plane.distance_mm, seen, is_mosaic))
            recorded.append(replace(plane, distance_mm=near - nearest + plane.distance_mm))
            by_wavelength = dict(zip(seen, on_pixels, strict=True))
            responses.append(tuple(by_wavelength.get(one, 0.0) for one in wavelengths))
    given, held_out = hold_out(recorded)
    return _Problem(
        patch,
        wavelengths,
        lights,
        tuple(first.at_wavelength(one) for one in wavelengths),
        tuple(planes),
        tuple(given),
        tuple(responses),
        held_out,
    )


def _residuals(case: _Problem, maps: Sequence[Array]) -> list[PlaneResidual]:
    """Return the residuals of each plane, on fitted and on held-out pixels."""
    residuals = []
    for plane, known, error, held in zip(case.planes, case.recorded, maps, case.held_out, strict=True):
        assert known.sigma is not None
        left = known.amplitude, known.sigma, error, held.pixels, held.sigma
        residuals.append(PlaneResidual(plane.distance_mm, *left))
    return residuals


def _groups(frames: Sequence[Frame]) -> Iterator[list[Frame]]:
    """Yield the frames that were recorded with the same light and the same filters."""
    groups: dict[str, list[Frame]] = {}
    for frame in frames:
        own = frame.settings
        colours = "" if own.colours is None else own.colours.model_dump_json()
        groups.setdefault(f"{own.wavelength_um:.12g} {colours}", []).append(frame)
    yield from groups.values()


class _Found(NamedTuple):
    """Last state of all stages of a search, its descent, and transmissions relative to a film's ground."""

    state: SolverState
    descent: ProximalDescent
    transmission: Transmissions


class _Search:
    """Searches of the object at all wavelengths."""

    def __init__(
        self, case: _Problem, settings: ColourSettings, progress: Progress, checkpoints: CheckpointSeries
    ) -> None:
        self.case, self.settings, self.progress, self.checkpoints = case, settings, progress, checkpoints

    def find(self, recorded: Sequence[Measurement], scale: float | None = None, stage: str = "") -> _Found:
        """Return the result of all stages.

        Parameters
        ----------
        recorded, scale, stage
            See :meth:`run`.
        """
        case, settings = self.case, self.settings
        if settings.kind == "amplitude" and settings.scale is None and scale is None:
            state, descent = self.with_fitted_scale()
        else:
            state, descent = self.run(recorded, scale=scale, stage=stage)
        state, descent = self.polished(recorded, state, descent, stage)
        if settings.film_index is None:
            return _Found(state, descent, _complex(state.transmission))
        relative = _about_ground(state.transmission, case.patch, settings)
        if settings.kind == "thickness":
            # Any deviation does, equal ones at all wavelengths: only the heights are used.
            first = heights_from_phases(
                np.angle(relative).astype(float),
                np.full(relative.shape, 0.1),
                case.wavelengths_um,
                settings.film_index,
                settings.heights_um,
            )
            numbers = wave_numbers(case.wavelengths_um, settings.film_index)
            film = FilmProjection(numbers, first.height_um)
            before, known = state.misfit, state.scale
            name = stage or "one thickness for all wavelengths"
            state, descent = self.run(recorded, film(relative), known, film, name)
            state, descent = self.polished(recorded, state, descent, name, film)
            state = replace(state, misfit=(*before, *state.misfit), began=len(before) + state.began)
            relative = _about_ground(state.transmission, case.patch, settings)
        return _Found(state, descent, relative)

    def with_fitted_scale(self) -> tuple[SolverState, ProximalDescent]:
        """Return the last state of an amplitude object whose brightest parts are 1 at one wavelength.

        First iterations without a limit find the scale: the first fit assumes an object that is 1 everywhere.
        """
        # Iterations after which the brightest parts hardly change any more.
        first_iterations = 30
        count = min(first_iterations, self.settings.iterations)
        state, descent = self.run(self.case.recorded, iterations=count, stage="amplitude: finding the scale")
        # Single samples at edges, or with noise, exceed the brightest parts.
        brightest = max(
            float(np.quantile(gaussian_filter(values, 2.0)[lit], 0.99))
            for values, lit in zip(state.transmission, descent.model.lit, strict=True)
        )
        if brightest <= 0.0:
            return state, descent
        scale, start = (state.scale or 1.0) * brightest, state.transmission / brightest
        return self.run(self.case.recorded, _complex(start), scale)

    def polished(
        self,
        recorded: Sequence[Measurement],
        state: SolverState,
        descent: ProximalDescent,
        stage: str = "",
        film: FilmProjection | None = None,
    ) -> tuple[SolverState, ProximalDescent]:
        """Return a better state with less total variation, if a search has left more than the noise.

        The automatic weight grows with the misfit. It may be so large that it causes the misfit itself.
        """
        noise = noise_misfit(recorded)
        if self.settings.tv_weight != "auto" or not noise or state.misfit[-1] <= FAR * noise:
            return state, descent
        own = None if film is None else FilmProjection(film.numbers, film.height_um)
        scale, name = state.scale, stage or "less total variation"
        after, other = self.run(recorded, _complex(state.transmission), scale, own, stage=name, at_noise=True)
        if after.misfit[-1] >= state.misfit[-1]:
            return state, descent
        misfit = (*state.misfit, *after.misfit)
        return replace(after, misfit=misfit, began=len(state.misfit) + after.began), other

    def run(
        self,
        recorded: Sequence[Measurement],
        start: Transmissions | None = None,
        scale: float | None = None,
        film: FilmProjection | None = None,
        stage: str = "",
        iterations: int | None = None,
        at_noise: bool = False,
    ) -> tuple[SolverState, ProximalDescent]:
        """Return the last state of a search, and the descent with its model.

        Parameters
        ----------
        recorded
            Measured amplitudes of the planes.
        start
            Transmissions at the start; default: 1, or those of the settings.
        scale
            Scale that an earlier search has found.
        film
            Projection on films; default: none.
        stage
            Name of the stage in the progress; empty for the first one.
        iterations
            Largest number of iterations; default: that of the settings.
        at_noise
            Whether an automatic total variation has the weight of noise alone, whatever the misfit.
        """
        case, settings = self.case, self.settings
        known = settings.scale or scale
        model = case.model(recorded, known, settings.fill_factor)
        noises = noise_of_steps(model)
        is_automatic = settings.tv_weight == "auto"
        mean = float(noises.mean())
        relative = noises / mean if is_automatic else np.ones(len(noises))

        weight = 0.0 if settings.tv_weight == "auto" else settings.tv_weight
        if is_automatic and at_noise:
            weight = TV_PER_NOISE * mean / model.scale

        def total_variation(point: NDArray[Any], length: float) -> NDArray[Any]:
            return np.stack(
                [prox_tv(values, length * float(one)) for values, one in zip(point, relative, strict=True)]
            )

        def with_film(point: NDArray[Any], length: float) -> NDArray[Any]:
            assert film is not None
            return film(total_variation(point, length))

        def report(index: int, misfit: float) -> None:
            name = stage or f"{settings.kind}: misfit {misfit:.5f}"
            self.progress(name, index + 1, settings.iterations)

        descent = ProximalDescent(
            model,
            weight,
            mean if is_automatic and not at_noise else None,
            noise_misfit(recorded),
            True,
            known is None,
            report,
            None,
            Scratch(),
            4,
            known is not None,
            total_variation if film is None else with_film,
        )
        kind: Kind = "amplitude" if settings.kind == "amplitude" else "complex"
        most = iterations or settings.iterations
        stages = [Stage(kind, most)]
        if settings.start == "amplitude" and start is None and kind == "complex":
            stages.insert(0, Stage("amplitude", min(AMPLITUDE_START, most)))
        dtype = model.real if stages[0].kind == "amplitude" else model.dtype
        if start is None:
            first: NDArray[Any] = np.ones(model.lit.shape, dtype)
        else:
            first = (start.real if dtype == model.real else start).astype(dtype)
        first *= model.lit
        state = SolverState(first, first, 0.0, (), known, 0, 0)
        state, factor = self._descend(descent, state, stages, film), 1.0
        noise = noise_misfit(recorded) if descent.noise_at_scale_1 is not None else None
        while (
            kind == "amplitude"
            and factor > LEAST_FACTOR
            and len(state.misfit) < most
            and may_be_biased(state.misfit[-1], noise)
        ):
            factor *= 0.5
            again = replace(state, ahead=state.transmission, momentum=0.0, began=len(state.misfit))
            state = self._descend(replace(descent, noise_at_scale_1=factor * mean), again, stages, film)
        return state, descent

    def _descend(
        self,
        descent: ProximalDescent,
        state: SolverState,
        stages: Sequence[Stage],
        film: FilmProjection | None,
    ) -> SolverState:
        """Return the state after all stages; an interrupted run continues where it was."""
        checkpoint = self.checkpoints.next()
        if checkpoint is None:
            return descent.run(state, stages)
        saved = checkpoint.load()
        if saved is not None:
            state = state_of(saved, Scratch())
            if film is not None:
                film.height_um = saved["height_um"]
        if saved is None or not saved["ended"]:
            save = state_saver(checkpoint, extra=lambda: _progress_of(film, ended=False))
            state = replace(descent, keep=save).run(state, stages)
            checkpoint.keep(**vars(state), **_progress_of(film, ended=True))
        return state


def _progress_of(film: FilmProjection | None, *, ended: bool) -> dict[str, Any]:
    """Return what a checkpoint holds beside the solver's state."""
    return {"ended": ended} | ({} if film is None else {"height_um": film.height_um})


def _key(lens: Lens, frames: Sequence[Frame], case: _Problem, settings: ColourSettings) -> str:
    """Return the digest of all that decides the result."""
    engines = (engine.key() for engine in case.engines)
    return key_of_frames(lens, frames, case.lights[0], settings.model_dump_json(), *engines)


class FilmProjection:
    """Projection of transmissions on films a exp(i k h), with amplitudes and heights of samples.

    Parameters
    ----------
    numbers
        Phase k per unit of height at each wavelength.
    height_um
        Heights at the start, in whose neighbourhood heights are sought.
    """

    def __init__(self, numbers: Array, height_um: Array) -> None:
        self.numbers, self.height_um = numbers.reshape(-1, 1, 1), height_um

    def __call__(self, values: NDArray[Any]) -> NDArray[Any]:
        relative = values * np.exp(-1j * self.numbers * self.height_um)
        weights = self.numbers * np.abs(relative)
        change = np.sum(weights * np.angle(relative), axis=0)
        size = np.sum(self.numbers * weights, axis=0)
        change = np.divide(change, size, out=np.zeros_like(change), where=size > 0.0)
        self.height_um = self.height_um + change
        amplitude = np.mean((relative * np.exp(-1j * self.numbers * change)).real, axis=0)
        film = np.maximum(amplitude, 0.0) * np.exp(1j * self.numbers * self.height_um)
        return np.asarray(film, values.dtype)


def _heights(search: _Search, found: _Found) -> tuple[Heights, tuple[Transmissions, ...]]:
    """Return heights with their deviations, and the transmissions that repeats with other noise find.

    A repeat begins as the search of the result did, so that errors of slowly converging parts count as well.
    """
    case, settings = search.case, search.settings
    assert settings.film_index is not None
    scale = found.state.scale
    repeats = list[Transmissions]()
    random = np.random.default_rng(settings.seed)
    modelled = found.descent.model.amplitudes(found.state.transmission, scale)
    for index in range(settings.repeats):
        noisy = [
            _noisy(plane, amplitude, random) for plane, amplitude in zip(case.recorded, modelled, strict=True)
        ]
        stage = f"repeat {index + 1} of {settings.repeats} with other noise"
        repeats.append(search.find(noisy, scale, stage).transmission)
    noise, relative = noise_misfit(case.recorded), found.transmission
    excess = max(found.state.misfit[-1] / noise, 1.0) if noise else 1.0
    deviations = excess * _phase_deviations(relative, repeats)
    heights = heights_from_phases(
        np.angle(relative).astype(float),
        deviations,
        case.wavelengths_um,
        settings.film_index,
        settings.heights_um,
    )
    changes = np.array([np.angle(one * relative.conj()) for one in repeats])
    column = wave_numbers(case.wavelengths_um, settings.film_index).reshape(-1, 1, 1)
    precision = column / deviations**2
    of_repeats = np.sum(precision * changes, axis=1) / np.sum(column * precision, axis=0)
    # Errors of the wavelengths may be correlated: the deviations are those of the repeats' heights.
    deviation_um = excess * np.sqrt(_smoothed(np.mean(of_repeats**2, axis=0)))
    return replace(heights, deviation_um=deviation_um), tuple(repeats)


def _about_ground(transmission: NDArray[Any], patch: Patch, settings: ColourSettings) -> Transmissions:
    """Return transmissions with phases relative to the ground."""
    if settings.ground_mm is None:
        ground = common_phases(transmission, patch.inside)
    else:
        ground = np.angle(transmission[:, _samples_of(patch, settings.ground_mm, "{ground_mm}")].sum(axis=1))
    return np.asarray(transmission * np.exp(-1j * ground)[:, None, None], np.complex64)


def _samples_of(patch: Patch, region_mm: tuple[float, float, float, float], named: str) -> NDArray[np.bool_]:
    """Return the samples of a region."""
    x_mm, y_mm, width_mm, height_mm = region_mm
    grid = patch.grid
    mask = (np.abs(grid.x_mm - x_mm)[None, :] < 0.5 * width_mm) & (
        np.abs(grid.y_mm - y_mm)[:, None] < 0.5 * height_mm
    )
    mask &= patch.inside
    if not mask.any():
        text = ",".join(f"{one:g}" for one in region_mm)
        raise SettingError(
            f"{named} = {text}: contains no samples; must lie within the field stop of "
            f"{patch.field_stop_mm:g} mm, and be wider than {1e3 * grid.pitch_mm:.4g} um"
        )
    return np.asarray(mask)


def _complex(values: NDArray[Any]) -> Transmissions:
    return np.asarray(values, np.result_type(values.dtype, np.complex64))


SMOOTHED_SAMPLES = 1.5
"""Standard deviation (samples) of the smoothing of variances, which a few repeats estimate poorly."""


def _smoothed(variance: Array) -> Array:
    return np.maximum(gaussian_filter(variance, SMOOTHED_SAMPLES, mode="nearest"), 1e-18)


def _phase_deviations(found: Transmissions, repeats: Sequence[Transmissions]) -> Array:
    """Return the standard deviation of the phase at each wavelength and sample."""
    squares = np.mean([np.angle(one * found.conj()) ** 2 for one in repeats], axis=0)
    return np.sqrt(np.stack([_smoothed(one) for one in squares.astype(float)]))


def _noisy(plane: Measurement, amplitude: NDArray[Any], random: np.random.Generator) -> Measurement:
    """Return a record of modelled amplitudes with the stated noise of a plane."""
    deviation = intensity_deviation(plane)
    known = np.isfinite(deviation)
    noise = np.where(known, deviation, 0.0) * random.standard_normal(deviation.shape)
    variance = np.where(known, np.maximum(deviation, 1e-30) ** 2, np.inf)
    return with_intensity(plane, amplitude.astype(float) ** 2 + noise, variance)


def _oversampling(lens: Lens, case: _Problem, settings: ColourSettings) -> Oversampling:
    """Return the measurements of all planes for each unknown of the objects at all wavelengths."""
    kind: ObjectKind = "amplitude" if settings.kind == "amplitude" else "complex"
    support = case.patch.field_stop_mm
    of_planes = [
        oversampling_of(
            lens,
            kind,
            support_mm=support,
            plane_distances_mm=(plane.distance_mm,),
            wavelengths_um=plane.wavelengths_um,
            at_once=True,
        )
        for plane in case.planes
    ]
    # Amplitude and thickness of a film are the unknowns of one complex object.
    own = case.wavelengths_um[:1] if settings.kind == "thickness" else case.wavelengths_um
    return Oversampling(
        kind,
        support,
        own,
        layers=1,
        plane_distances_mm=tuple(plane.distance_mm for plane in case.planes),
        measurements_of_planes=tuple(one.measurements for one in of_planes),
        unknowns=real_unknowns(kind, support, lens.object.numerical_aperture, own),
    )


def _true_objects(case: _Problem, truth: Sequence[Field] | Path | None) -> tuple[Field, ...]:
    """Return the true object at each wavelength; empty without one."""
    if truth is None:
        return ()
    if isinstance(truth, Path):
        truth = read_coloured_object(truth, case.patch, case.wavelengths_um)
    by_wavelength, found = {one.wavelength_um: one for one in truth}, list[Field]()
    for wavelength in case.wavelengths_um:
        true = by_wavelength.get(wavelength)
        if true is None or true.grid != case.patch.grid:
            known = ", ".join(f"{one:g}" for one in sorted(by_wavelength))
            raise InputError(
                f"truth: needs the object at {wavelength:g} um on the grid {case.patch.grid}; it has "
                f"{known} um"
            )
        found.append(true)
    return tuple(found)


def _compared(
    case: _Problem, fields: Sequence[Field], true_objects: Sequence[Field]
) -> tuple[dict[str, float | None], ...]:
    """Compare the result with the true object at each wavelength."""
    return tuple(
        truth_metrics(found, true, light, case.patch.inside, engine.scene, Scratch())
        for found, true, light, engine in zip(
            fields, true_objects, case.lights, case.engines, strict=bool(true_objects)
        )
    )
