"""The object that was found behind frames, and how good it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.notebook import html_picture, html_table
from wavesim.fields.field import Field, Grid
from wavesim.metrics.goodness_of_fit import GoodnessOfFit
from wavesim.metrics.judgement import chart_metrics, plane_metrics
from wavesim.runtime.memory import Memory
from wavesim.scene.engine import Engine
from wavesim.scene.settings import STOP_ORIGINS, ReconstructionSettings
from wavesim.sensor.frame_sets import PlaneFrames
from wavesim.sensor.measurement import Measurement
from wavesim.targets.patch import Patch
from wavesim.targets.usaf import UsafElement

Array = NDArray[np.floating[Any]]


class Focus(NamedTuple):
    """The sharpest distance, and the curve that told."""

    distance_mm: float
    distances_mm: Array
    svfg: Array


@dataclass(frozen=True, eq=False)
class FoundObject:
    """The object behind frames, and how good it is.

    Attributes
    ----------
    settings : ReconstructionSettings
        With which it was found.
    patch : Patch
        The object's samples and its field stop.
    transmission : Field
        Of the object, or of the region asked for; 0 where there is no light.
    inside : ndarray of bool
        Its samples within the field stop.
    planes : tuple of PlaneFrames
        What the frames of each plane say.
    recorded : tuple of Recorded
        Amplitudes as the planes recorded them.
    residual_maps : tuple of ndarray
        For each plane, amplitude of the result less the recorded one.
    curve : tuple of float
        For every iteration the misfit (object) or the correlation A6 (paper).
    verdict : Verdict
        Whether the planes are explained, and what may differ where they are not.
    focus : Focus, optional
        Where the object is sharpest, if that was asked for.
    of_method : dict
        Figures of one method alone.
    true : Field, optional
        The true object on the same samples, if it was given.
    truth : dict
        Figures against the true object; empty without it.
    charts : tuple
        Elements of the USAF chart in the middle, and of those beside it.
    diversity : float
        What the planes tell of the phase (:func:`wavesim.sensor.windows.diversity`).
    engine : Engine
        From the object to the nearest plane.
    memory : Memory
        What was said to be taken.
    predicted_error : float
        Upper bound of the engine's relative L2 error on that plane, for light with as much at the aperture's
        rim as the frames show there.
    """

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

    def figures(self) -> dict[str, Any]:
        """All figures, ready for JSON: of the planes, the focus, the true object and the charts."""
        chosen, pitch_mm = self.settings, self.patch.grid.pitch_mm
        return {
            "method": chosen.method,
            "kind": chosen.kind if chosen.method == "object" else "complex",
            "start": chosen.first,
            "iterations": len(self.curve),
            **self.of_method,
            "planes": [
                {
                    "plane_distance_mm": told.distance_mm,
                    "exposures": list(told.exposures),
                    **plane_metrics(plane.amplitude, plane.sigma, error),
                    "saturated_share": told.saturated_share,
                }
                for told, plane, error in zip(self.planes, self.recorded, self.residual_maps, strict=True)
            ],
            "verdict": self.verdict.as_dict(),
            "diversity": self.diversity,
            "field_stop_mm": self.patch.field_stop_mm,
            "field_stop_at_mm": list(self.patch.field_stop_at_mm),
            "field_stop_from": chosen.field_stop_from,
            "object_pitch_um": 1e3 * pitch_mm,
            "samples": self.patch.grid.shape[0],
            "region_mm": None if chosen.region_mm is None else _region(self.transmission.grid),
            "refocus_um": None if self.focus is None else 1e3 * self.focus.distance_mm,
            "truth": self.truth,
            "usaf": self._of_charts(),
        }

    def _of_charts(self) -> dict[str, Any]:
        """Contrast of each element of the chart and the finest resolved; the same of those beside it."""
        if not self.charts or self.settings.usaf is None:
            return {}
        passed_um = 0.5 * self.patch.wavelength_um / self.engine.scene.lens.object.numerical_aperture
        ground = self.settings.usaf
        middle, *others = (
            chart_metrics(self.transmission, chart, ground, passed_um, self.inside) for chart in self.charts
        )
        beside = zip(self.settings.chart_at_mm, others, strict=True)
        return middle | {"beside": [{"at_mm": list(point)} | figures for point, figures in beside]}

    def __repr__(self) -> str:
        return f"FoundObject({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Object behind frames", self._rows(), html_picture(self.transmission.values))

    def _rows(self) -> list[tuple[str, str]]:
        chosen, (rows, columns) = self.settings, self.transmission.grid.shape
        ended = "correlation A6" if chosen.method == "paper" else "misfit"
        told = [
            ("method", f"{chosen.method}, engine {self.engine.name}"),
            ("samples", f"{rows} x {columns} of {1e3 * self.transmission.grid.pitch_mm:.4g} um"),
            ("field stop", f"{self.patch.stop_words}, {STOP_ORIGINS[chosen.field_stop_from]}"),
            ("iterations", f"{len(self.curve)}, {ended} {self.curve[-1]:.5g}"),
        ]
        told.append(("verdict", self.verdict.words))
        if self.focus is not None:
            told.append(("sharpest", f"{1e3 * self.focus.distance_mm:.2f} um behind the object plane"))
        return told + [(name, f"{value:.4g}") for name, value in self.truth.items() if value is not None]


def _region(shown: Grid) -> list[float]:
    """x and y of the centre, width and height, of the samples that are shown."""
    (half_y, half_x), (x, y) = shown.half_widths_mm, shown.centre_mm
    return [x, y, 2.0 * half_x, 2.0 * half_y]
