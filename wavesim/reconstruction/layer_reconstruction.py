"""Reconstruction of an object of several layers from frames, refused where frames do not determine it.

Two bounds decide whether layers are determined:

- The oversampling ratio, measurements for each real unknown, must reach `LEAST_RATIO`. More planes raise it.
- Light of one direction leaves the last layer as one field, with two real numbers for each degree of freedom.
  Layers with more unknowns than these cannot be separated by any number of planes: three layers of
  amplitude, or two complex ones.

Below a bound, only assumptions on the layers, such as few sharp edges, can select one of many solutions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.oversampling import UNKNOWNS_OF_KIND, Oversampling, oversampling_of
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Field
from wavesim.fields.files import write_field
from wavesim.metrics.goodness_of_fit import Finding, GoodnessOfFit, verdict
from wavesim.metrics.result_quality import plane_metrics, truth_metrics
from wavesim.plots.frames import residual_figure, save
from wavesim.plots.objects import layers_figure
from wavesim.plots.pyramid import write_pyramid
from wavesim.reconstruction.assessment import plane_residuals
from wavesim.reconstruction.layered import Layers, find_layers
from wavesim.reconstruction.problem import (
    ReconstructionProblem,
    reconstruction_problem,
    validate_coherent,
    validate_frames,
)
from wavesim.runtime.checkpoint import CheckpointSeries, key_of
from wavesim.runtime.memory import Memory
from wavesim.runtime.result import WritableResult
from wavesim.runtime.result_files import write_csv
from wavesim.scene.engine import Engine, engine_summary
from wavesim.scene.settings import STOP_ORIGINS, ReconstructionSettings, SettingError
from wavesim.scene.system_state import SystemState, state_of
from wavesim.sensor.frame_sets import PlaneFrames, recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import Measurement, intensity_deviation
from wavesim.sensor.recording import Progress
from wavesim.targets.layers import layer_stack, validate_distances
from wavesim.targets.patch import Patch, layer_file, read_object

LEAST_RATIO = 3.0
"""Least oversampling ratio at which layers are determined, measured by `python -m benchmarks.layers`."""

FIELD_NUMBERS = 2
"""Real numbers for each degree of freedom of the light behind the layers: amplitude and phase."""

ITERATIONS = 300
"""Default of the largest number of iterations."""

UNUSED_SETTINGS = (
    "method",
    "start",
    "refocus_mm",
    "usaf",
    "chart_at_mm",
    "hold_out_plane",
    "starts",
    "source_deg",
    "bandwidth_nm",
    "region_mm",
    "field_stop",
    "cluster",
    "verdict",
)
"""Settings that layers cannot use."""


@dataclass(frozen=True, eq=False, repr=False)
class FoundLayers(WritableResult):
    """The layers found from frames, and the quality of the result.

    :func:`wavesim.reconstruct_layers` returns it.

    Attributes
    ----------
    settings : ReconstructionSettings
        Settings of the reconstruction.
    layers_um : tuple of float
        Distances of the layers from the object plane.
    patch : Patch
        Samples of the object plane and the field stop.
    transmissions : tuple of Field
        Transmission of each layer; 0 outside the field stop.
    inside : ndarray of bool, shape (ny, nx)
        Samples within the field stop.
    oversampling : Oversampling
        Measurements for each real unknown.
    planes : tuple of PlaneFrames
        Distance, exposures and saturation of each plane.
    recorded : tuple of Measurement
        Measured amplitudes of the planes.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude, in the unit of the measured amplitude.
    curve : tuple of float
        Misfit of every iteration.
    scale : float
        Measured amplitude per unit of the modelled amplitude.
    stopped_because : {"noise", "converged", "iterations"}
        Reason for the end of the iterations.
    verdict : GoodnessOfFit
        Whether the planes are explained.
    true : tuple of Field
        True layers; empty if they were not given.
    truth : tuple of dict
        Comparison of each layer with the true one; empty without true layers.
    engine : Engine
        Engine from the object plane to the nearest recording plane.
    memory : Memory
        Estimate of the memory.
    predicted_error : float
        Upper bound of the engine's relative L2 error on the nearest plane.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_layers
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "field_stop_mm": 0.024, "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, ("star", "empty"), layers_um=(-20.0, 0.0), exposures=(1.0, 30.0, 1000.0), **patch)
    >>> found = reconstruct_layers(lens, taken.frames, (-20.0, 0.0), kind="amplitude", iterations=2, **patch)
    >>> len(found.transmissions), len(found.planes), found.oversampling.layers
    (2, 2, 2)
    """

    heading, file = "Layers behind frames", "reconstruction.json"

    settings: ReconstructionSettings
    layers_um: tuple[float, ...]
    patch: Patch
    transmissions: tuple[Field, ...]
    inside: NDArray[np.bool_]
    oversampling: Oversampling
    planes: tuple[PlaneFrames, ...]
    recorded: tuple[Measurement, ...]
    residual_maps: tuple[NDArray[np.floating[Any]], ...]
    curve: tuple[float, ...]
    scale: float
    stopped_because: str
    verdict: GoodnessOfFit
    true: tuple[Field, ...]
    truth: tuple[dict[str, float | None], ...]
    engine: Engine
    memory: Memory
    predicted_error: float

    def as_dict(self) -> dict[str, Any]:
        """Return the quality of the result for JSON."""
        return {
            "design": self.engine.scene.lens.title,
            "kind": self.settings.kind,
            "layers": [
                {"distance_um": distance, "truth": self.truth[index] if self.truth else {}}
                for index, distance in enumerate(self.layers_um)
            ],
            "oversampling_ratio": self.oversampling.ratio,
            "required_ratio": LEAST_RATIO,
            "iterations": len(self.curve),
            "misfit": self.curve[-1],
            "scale": self.scale,
            "stopped_because": self.stopped_because,
            "planes": [
                {
                    "plane_distance_mm": frames.distance_mm,
                    "exposures": list(frames.exposures),
                    **plane_metrics(plane.amplitude, plane.sigma, error),
                    "saturated_share": frames.saturated_share,
                }
                for frames, plane, error in zip(self.planes, self.recorded, self.residual_maps, strict=True)
            ],
            "verdict": self.verdict.as_dict(),
            "field_stop_mm": self.patch.field_stop_mm,
            "field_stop_at_mm": list(self.patch.field_stop_at_mm),
            "object_pitch_um": 1e3 * self.patch.grid.pitch_mm,
            "samples": self.patch.grid.shape[0],
            "field_stop_from": self.settings.field_stop_from,
            "engine": engine_summary(self.engine, self.predicted_error),
            "memory": self.memory.as_dict(),
        }

    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        pitch_um = 1e3 * self.patch.grid.pitch_mm
        distances = [plane.distance_mm for plane in self.planes]
        sensor_um = 1e3 * self.engine.scene.exit_grid.pitch_mm
        stop = f"{self.patch.stop_words} ({STOP_ORIGINS[summary['field_stop_from']]})"
        light = f"{self.patch.wavelength_um:g} µm, {stop}"
        title = f"{summary['design']}\n{light}: {summary['kind']} layers, {summary['iterations']} iterations"
        for index, layer in enumerate(self.transmissions, start=1):
            file = layer_file(index)
            write_field(layer, folder / file, centre_x_mm=0.0, centre_y_mm=0.0)
            for name, quantity in (("amplitude", "amplitude"), ("phase", "phase_rad")):
                picture = folder / f"{Path(file).stem}_{name}.tif"
                write_pyramid(layer.values, picture, pitch_um, (quantity,))
        drawn = layers_figure(self.layers_um, self.transmissions, self.inside, title, truth=self.true)
        save(drawn, folder / "reconstruction.png")
        drawn = residual_figure(self.residual_maps, self.recorded, distances, sensor_um, summary["design"])
        save(drawn, folder / "residuals.png")
        rows = [{"iteration": step, "misfit": value} for step, value in enumerate(self.curve, 1)]
        write_csv(rows, folder / "convergence.csv")

    def table(self) -> list[tuple[str, str]]:
        rows = [
            ("layers", ", ".join(f"{one:g} µm" for one in self.layers_um)),
            ("ratio", f"{self.oversampling.ratio:.3g} measurements for each unknown"),
            ("iterations", f"{len(self.curve)}, misfit {self.curve[-1]:.5g}"),
            ("verdict", self.verdict.words),
        ]
        correlations = [one["object_correlation"] for one in self.truth]
        if correlations:
            shown = ("none" if one is None else f"{one:.4g}" for one in correlations)
            rows.append(("correlations", ", ".join(shown)))
        return rows


def reconstruct_layers(
    lens: Lens,
    frames: Sequence[Frame],
    layers_um: Sequence[float],
    settings: ReconstructionSettings | None = None,
    *,
    truth: Sequence[Field] | Path | None = None,
    calibration: SystemState | None = None,
    undetermined: bool = False,
    folder: Path | None = None,
    progress: Progress | None = None,
    on_estimate: Callable[[Memory], None] | None = None,
    **changes: Any,
) -> FoundLayers:
    """Reconstruct an object of several layers that was recorded in frames, and assess the result.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more frames of each plane, from :func:`wavesim.image` or :func:`wavesim.read_frames`.
    layers_um
        Distances of the layers from the object plane, positive towards the lens, ascending.
    settings
        All settings; default: `ReconstructionSettings()`. `kind` is that of every layer.
    truth
        Transmissions of the true layers on the patch's samples, or the folder that `wavesim image` has
        written. The result is compared with them.
    calibration
        State of the system, from :func:`wavesim.calibrate_frames`. Default: as designed.
    undetermined
        Whether to reconstruct layers that frames do not determine. The result is then one of many solutions,
        the one with the smallest total variation, and its verdict says so.
    folder
        Folder of the checkpoints, from which the same call continues an interrupted search,
        and of arrays that do not fit in memory.
    progress
        Callback `progress(stage, completed, total)`.
    on_estimate
        Callback `on_estimate(memory)` with the estimate of the memory, called after all checks.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    FoundLayers
        Transmission of each layer, residuals of each plane, and the verdict.

    Raises
    ------
    InputError, SamplingError, MemoryLimitError
        If an input is invalid, frames do not determine the layers, or the arrays do not fit.

    Examples
    --------
    Two layers, 20 µm apart, from two planes:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_layers
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "field_stop_mm": 0.024, "engine": "eikonal", "error": 0.1}
    >>> layers_um = (-20.0, 0.0)
    >>> taken = image(lens, ("star", "empty"), layers_um=layers_um, exposures=(1.0, 30.0, 1000.0), **patch)
    >>> found = reconstruct_layers(lens, taken.frames, layers_um, kind="amplitude", iterations=4, **patch)
    >>> len(found.transmissions), found.oversampling.ratio > 3.0
    (2, True)
    """
    settings = (settings or ReconstructionSettings()).replaced(**changes)
    distances = tuple(float(one) for one in layers_um)
    _validate_settings(settings)
    validate_distances(distances)
    state = None if calibration is None else state_of(calibration)
    validate_coherent(settings, state, "{layers_um}")
    validate_frames(lens, frames, settings)
    if not frames:
        raise InputError("frames: needs at least one frame")
    ratio = layers_oversampling(lens, frames, settings, len(distances))
    doubt = why_undetermined(ratio)
    if doubt and not undetermined:
        raise SettingError(
            f"{{layers_um}}: {doubt}; {{undetermined_layers}} reconstructs them nevertheless, as one of many "
            "solutions"
        )
    case = reconstruction_problem(lens, frames, settings, None, calibration, folder)
    stack = layer_stack(case.patch, case.light, distances)
    true = _true_layers(truth, case.patch, len(distances))
    if on_estimate is not None:
        on_estimate(case.memory)
    most = settings.iterations or ITERATIONS

    def on_iteration(index: int, misfit: float) -> None:
        if progress is not None:
            progress(f"layers: misfit {misfit:.5f}", index + 1, most)

    found = find_layers(
        case.engine,
        stack,
        case.given,
        kind=settings.kind,
        tv_weight=settings.tv_weight,
        iterations=most,
        fill_factor=settings.fill_factor,
        scale=settings.scale,
        progress=on_iteration,
        checkpoints=CheckpointSeries(folder, key_of(case.key, repr(distances))),
    )
    return FoundLayers(
        settings=settings,
        layers_um=distances,
        patch=case.patch,
        transmissions=found.transmissions,
        inside=case.patch.inside,
        oversampling=ratio,
        planes=case.planes,
        recorded=case.recorded,
        residual_maps=found.residual_maps,
        curve=found.misfit,
        scale=found.scale,
        stopped_because=found.stopped_because,
        verdict=_verdict(case, found, doubt),
        true=true,
        truth=tuple(
            _compared(case, one, other) for one, other in zip(found.transmissions, true, strict=False)
        ),
        engine=case.engine,
        memory=case.memory,
        predicted_error=case.predicted_error,
    )


def layers_oversampling(
    lens: Lens, frames: Sequence[Frame], settings: ReconstructionSettings, layers: int
) -> Oversampling:
    """Return the oversampling ratio of frames of an object of several layers.

    Pixels count only if they have received more light than their noise.

    Parameters
    ----------
    lens
        The lens with its object and sensor.
    frames
        Frames of one or more planes.
    settings
        Kind of every layer, and the field stop, which limits every layer.
    layers
        Number of layers.
    """
    field_mm = lens.object.field_diameter_mm
    by_design = oversampling_of(
        lens,
        settings.kind,
        support_mm=min(settings.field_stop_mm or settings.patch_mm or field_mm, field_mm),
        plane_distances_mm=sorted({frame.settings.plane_distance_mm for frame in frames}),
        wavelengths_um=(frames[0].settings.wavelength_um,),
        layers=layers,
    )
    lit = (
        float(np.count_nonzero(plane.amplitude**2 > intensity_deviation(plane)))
        for plane in recorded_planes(frames)
    )
    return replace(
        by_design,
        measurements_of_planes=tuple(
            min(planned, pixels)
            for planned, pixels in zip(by_design.measurements_of_planes, lit, strict=True)
        ),
    )


def why_undetermined(recording: Oversampling) -> str:
    """Return why a recording does not determine the layers of an object; empty if it does.

    Parameters
    ----------
    recording
        Oversampling ratio of the recording, with the number and the kind of the layers.
    """
    layers, kind = recording.layers, recording.kind
    unknowns = layers * UNKNOWNS_OF_KIND[kind]
    named = f"{layers} {kind} layer{'s' * (layers > 1)}"
    if unknowns > FIELD_NUMBERS:
        return (
            f"{named} have {unknowns} unknowns for each degree of freedom of the light behind them, which "
            f"has {FIELD_NUMBERS} numbers, amplitude and phase: no number of planes determines them"
        )
    if recording.ratio >= LEAST_RATIO:
        return ""
    planes, needed = len(recording.plane_distances_mm), recording.planes_for(LEAST_RATIO)
    return (
        f"{planes} plane{'s give' if planes > 1 else ' gives'} {recording.ratio:.3g} measurements for each "
        f"unknown of {named}, and {LEAST_RATIO:g} are required: record {needed} such planes, add longer "
        "exposures if many pixels are dark, or use a smaller field stop"
    )


def _validate_settings(settings: ReconstructionSettings) -> None:
    """Check that no setting is given that layers cannot use."""
    for name in UNUSED_SETTINGS:
        stated, default = getattr(settings, name), type(settings).model_fields[name].get_default()
        # A source of width 0 is the coherent light that layers assume.
        if stated != default and not (name in ("source_deg", "bandwidth_nm") and stated == 0.0):
            raise SettingError(f"{{{name}}}: cannot be used with {{layers_um}}")


def _true_layers(truth: Sequence[Field] | Path | None, patch: Patch, count: int) -> tuple[Field, ...]:
    """Return the true layers, from a folder if they are not given; none without a truth."""
    if truth is None:
        return ()
    if isinstance(truth, Path):
        return tuple(read_object(truth / layer_file(index), patch) for index in range(1, count + 1))
    if len(truth) != count:
        raise InputError(f"truth: {len(truth)} layers; must be {count}, one for each of layers_um")
    return tuple(truth)


def _verdict(case: ReconstructionProblem, found: Layers, doubt: str) -> GoodnessOfFit:
    findings = [Finding("several objects", doubt)] if doubt else []
    return verdict(
        plane_residuals(case, found.residual_maps, ()),
        curve=found.misfit,
        findings=findings,
        calibrated=case.calibrated,
        rounding=case.rounding,
    )


def _compared(case: ReconstructionProblem, found: Field, true: Field) -> dict[str, float | None]:
    """Return the comparison of a layer with the true one, both as the lens transmits them."""
    inside = case.patch.inside
    light = Field(case.light.grid, inside.astype(np.complex64), case.light.wavelength_um)
    found, true = (light.with_values(one.values * inside) for one in (found, true))
    return truth_metrics(found, true, light, inside, case.engine.scene, case.scratch)
