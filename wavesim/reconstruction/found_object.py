"""The object found from frames, with its figures of quality."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.analysis.oversampling import Oversampling
from wavesim.fields.field import Field, Grid
from wavesim.fields.files import write_field
from wavesim.metrics.goodness_of_fit import GoodnessOfFit
from wavesim.metrics.result_quality import chart_metrics, plane_metrics
from wavesim.plots.frames import curves_figure, residual_figure, save
from wavesim.plots.objects import object_figure
from wavesim.plots.pyramid import write_pyramid
from wavesim.reconstruction.oversampling import measured_oversampling
from wavesim.runtime.memory import Memory
from wavesim.runtime.result import WritableResult
from wavesim.runtime.result_files import write_csv
from wavesim.scene.engine import Engine, engine_summary
from wavesim.scene.scene import diffraction_limit_um
from wavesim.scene.settings import STOP_ORIGINS, ReconstructionSettings
from wavesim.sensor.frame_sets import PlaneFrames
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import Patch
from wavesim.targets.region import holds
from wavesim.targets.usaf import UsafElement

Array = NDArray[np.floating[Any]]


class Focus(NamedTuple):
    """The sharpest distance, and the curve of sharpness (SVFG) over all distances."""

    distance_mm: float
    distances_mm: Array
    svfg: Array


@dataclass(frozen=True, eq=False, repr=False)
class FoundObject(WritableResult):
    """The object found from frames, and the quality of the result.

    :func:`wavesim.reconstruct_frames` returns it.

    Attributes
    ----------
    settings : ReconstructionSettings
        Settings of the reconstruction.
    patch : Patch
        Samples of the object and its field stop.
    transmission : Field
        Complex transmission of the object, or of the requested region; 0 where there is no light.
    inside : ndarray of bool, shape (ny, nx)
        Samples of the transmission within the field stop.
    planes : tuple of PlaneFrames
        Distance, exposures and saturation of each plane.
    recorded : tuple of Measurement
        Measured amplitudes of the planes.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude, in the unit of the measured amplitude.
    curve : tuple of float
        Misfit (method object) or correlation A6 (method paper) of every iteration.
    verdict : GoodnessOfFit
        Whether the planes are explained, and possible causes where they are not.
    focus : Focus, optional
        Distance at which the object is sharpest, if it was requested.
    of_method : dict
        Results that only this method has.
    true : Field, optional
        The true object on the same samples, if it was given.
    truth : dict
        Comparison with the true object: correlation, PSNR, SSIM, displacement; empty without a true object.
    charts : tuple
        Elements of the USAF chart in the middle, and of those at other positions.
    diversity : float
        Diversity of the planes (:func:`wavesim.sensor.windows.diversity`).
    engine : Engine
        Engine from the object to the nearest plane.
    memory : Memory
        Estimate of the memory.
    predicted_error : float
        Upper bound of the engine's relative L2 error on the nearest plane. It applies to light with as much
        intensity at the rim of the aperture as the frames show.
    key : str
        Digest of all inputs that decide the result.

    Examples
    --------
    >>> from lensdesign import load_design, scaled
    >>> from wavesim import image, reconstruct_frames
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, "star", planes_mm=(0.03,), **patch)
    >>> found = reconstruct_frames(lens, taken.frames, kind="amplitude", iterations=10, **patch)
    >>> found.verdict.explained, found.transmission.grid == taken.patch.grid
    (True, True)
    >>> found.residual_maps[0].shape == taken.frames[0].counts.shape
    True
    """

    heading, file = "Object behind frames", "reconstruction.json"

    settings: ReconstructionSettings
    patch: Patch
    transmission: Field
    inside: NDArray[np.bool_]
    planes: tuple[PlaneFrames, ...]
    recorded: tuple[Measurement, ...]
    residual_maps: tuple[Array, ...]
    curve: tuple[float, ...]
    verdict: GoodnessOfFit
    focus: Focus | None
    of_method: dict[str, Any]
    true: Field | None
    truth: dict[str, float | None]
    charts: tuple[tuple[UsafElement, ...], ...]
    diversity: float
    engine: Engine
    memory: Memory
    predicted_error: float
    key: str

    @cached_property
    def oversampling(self) -> Oversampling | None:
        """Pixels in the light for each real unknown of the object; None without standard deviations.

        See :func:`wavesim.reconstruction.oversampling.measured_oversampling`.
        """
        if any(plane.sigma is None for plane in self.recorded):
            return None
        return measured_oversampling(
            self.recorded,
            [plane.distance_mm for plane in self.planes],
            kind=self.settings.kind if self.settings.method == "object" else "complex",
            support_mm=self.patch.field_stop_mm,
            numerical_aperture=self.engine.scene.lens.object.numerical_aperture,
            wavelength_um=self.patch.wavelength_um,
        )

    @property
    def scale_is_determined(self) -> bool:
        """False if frames determine the transmission only up to a factor.

        A stated scale determines it, and so does the modulus of 1 of a phase object.
        """
        settings = self.settings
        return settings.scale is not None or (settings.method == "object" and settings.kind == "phase")

    def as_dict(self) -> dict[str, Any]:
        """Return the quality of the result for JSON: planes, focus, true object and charts."""
        settings, pitch_mm = self.settings, self.patch.grid.pitch_mm
        return {
            "design": self.engine.scene.lens.title,
            "method": settings.method,
            "kind": settings.kind if settings.method == "object" else "complex",
            "start": settings.first,
            "iterations": len(self.curve),
            **self.of_method,
            "scale_is_determined": self.scale_is_determined,
            "planes": [
                {
                    "plane_distance_mm": plane_frames.distance_mm,
                    "exposures": list(plane_frames.exposures),
                    **plane_metrics(plane.amplitude, plane.sigma, error),
                    "saturated_share": plane_frames.saturated_share,
                }
                for plane_frames, plane, error in zip(
                    self.planes, self.recorded, self.residual_maps, strict=True
                )
            ],
            "verdict": self.verdict.as_dict(),
            "diversity": self.diversity,
            "oversampling": None
            if self.oversampling is None
            else {
                "ratio": self.oversampling.ratio,
                "unknowns": self.oversampling.unknowns,
                "measurements_of_planes": list(self.oversampling.measurements_of_planes),
            },
            "field_stop_mm": self.patch.field_stop_mm,
            "field_stop_at_mm": list(self.patch.field_stop_at_mm),
            "field_stop_from": settings.field_stop_from,
            "object_pitch_um": 1e3 * pitch_mm,
            "samples": self.patch.grid.shape[0],
            "region_mm": None if settings.region_mm is None else _region(self.transmission.grid),
            "refocus_um": None if self.focus is None else 1e3 * self.focus.distance_mm,
            "truth": self.truth,
            "usaf": self._chart_metrics(),
            "engine": engine_summary(self.engine, self.predicted_error),
            "memory": self.memory.as_dict(),
        }

    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        transmission, pixel_um = self.transmission, 1e3 * self.engine.scene.exit_grid.pitch_mm
        distances = [plane.distance_mm for plane in self.planes]
        what = "CC (A6)" if summary["method"] == "paper" else "misfit"
        stop = f"{self.patch.stop_words} ({STOP_ORIGINS[summary['field_stop_from']]})"
        how = f"method {summary['method']}, {summary['kind']} object, {summary['iterations']} iterations"
        title = f"{summary['design']}\n{self.patch.wavelength_um:g} µm, {stop}: {how}"
        steps = range(1, len(self.curve) + 1)
        curves: dict[str, Any] = {"misfit of amplitudes (relative)": (steps, self.curve, "iteration")}
        # Pictures are drawn by one thread, files packed meanwhile by another.
        with ThreadPoolExecutor(1) as packing:
            packed = packing.submit(_pack, transmission, folder)
            elements = tuple(element for chart in self.charts for element in chart)
            finest = _finest_element(self, summary["usaf"])
            drawn = object_figure(
                transmission, self.inside, title, truth=self.true, elements=elements, profile=finest
            )
            save(drawn, folder / "reconstruction.png")
            drawn = residual_figure(self.residual_maps, self.recorded, distances, pixel_um, summary["design"])
            save(drawn, folder / "residuals.png")
            rows = [{"iteration": step, what: value} for step, value in zip(steps, self.curve, strict=True)]
            write_csv(rows, folder / "convergence.csv")
            if what == "CC (A6)":
                curves = {"1 - CC (A6)": (steps, np.maximum(1.0 - np.asarray(self.curve), 1e-9), "iteration")}
            if self.focus is not None:
                curve = (1e3 * self.focus.distances_mm, self.focus.svfg)
                curves["SVFG"] = (*curve, "distance (µm)")
                rows = [{"distance_um": at, "svfg": value} for at, value in zip(*curve, strict=True)]
                write_csv(rows, folder / "svfg.csv")
            save(curves_figure(curves, title), folder / "curves.png")
            packed.result()

    def _chart_metrics(self) -> dict[str, Any]:
        """Return contrast and finest resolved element of each chart."""
        if not self.charts or self.settings.usaf is None:
            return {}
        coherent_limit_um = diffraction_limit_um(self.engine.scene.lens, self.patch.wavelength_um)
        polarity = self.settings.usaf
        middle, *others = (
            chart_metrics(self.transmission, chart, polarity, coherent_limit_um, self.inside)
            for chart in self.charts
        )
        others_by_point = zip(self.settings.chart_at_mm, others, strict=True)
        return middle | {"beside": [{"at_mm": list(point)} | metrics for point, metrics in others_by_point]}

    def _picture(self) -> NDArray[Any]:
        return self.transmission.values

    def table(self) -> list[tuple[str, str]]:
        settings, (rows, columns) = self.settings, self.transmission.grid.shape
        curve_name = "correlation A6" if settings.method == "paper" else "misfit"
        lines = [
            ("method", f"{settings.method}, engine {self.engine.name}"),
            ("samples", f"{rows} x {columns} of {1e3 * self.transmission.grid.pitch_mm:.4g} µm"),
            ("stop", f"{self.patch.stop_words}, {STOP_ORIGINS[settings.field_stop_from]}"),
            ("iterations", f"{len(self.curve)}, {curve_name} {self.curve[-1]:.5g}"),
        ]
        if self.oversampling is not None:
            lines.append(("oversampling", f"{self.oversampling.ratio:.3g} pixels for each unknown"))
        lines.append(("verdict", self.verdict.words))
        if self.focus is not None:
            lines.append(("sharpest", f"{1e3 * self.focus.distance_mm:.2f} µm behind the object plane"))
        return lines + [(name, f"{value:.4g}") for name, value in self.truth.items() if value is not None]


def _region(shown: Grid) -> list[float]:
    """Return x and y of the center, width and height of the displayed samples, in mm."""
    (half_y, half_x), (x, y) = shown.half_widths_mm, shown.centre_mm
    return [x, y, 2.0 * half_x, 2.0 * half_y]


def _pack(transmission: Field, folder: Path) -> None:
    """Write the reconstructed object."""
    x_mm, y_mm = transmission.grid.centre_mm
    for name, quantity in (("amplitude", "amplitude"), ("phase", "phase_rad")):
        pitch_um = 1e3 * transmission.grid.pitch_mm
        write_pyramid(transmission.values, folder / f"{name}.tif", pitch_um, (quantity,))
    write_field(transmission, folder / "reconstruction.npz", centre_x_mm=x_mm, centre_y_mm=y_mm)


def _finest_element(found: FoundObject, usaf: dict[str, Any]) -> UsafElement | None:
    """Return the finest resolved element of the chart, or else its widest element."""
    if not found.charts:
        return None
    there = [one for one in found.charts[0] if holds(found.transmission.grid, one.outline)]
    finest = usaf.get("smallest_resolved") or {}
    resolved = [one for one in there if one.line_width_um == finest.get("line_width_um")]
    return next(iter([*resolved, *there]), None)
