"""What a reconstruction is worth, and its files: figures, amplitude and phase, residuals, curves."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wavesim.field_files import new_results, write_field, write_json, write_tiff
from wavesim.fields import Field
from wavesim.illumination import measured_field
from wavesim.imaging import Patch
from wavesim.imaging_plots import curves_figure, object_figure, residual_figure, save
from wavesim.metrics import (
    as_passed,
    element_contrasts,
    object_correlation,
    smallest_resolved_element,
)
from wavesim.picture_similarity import psnr_db, ssim
from wavesim.retrieval import amplitude_correlation

OBJECT_FILE = "object.npz"


def read_truth(path: Path, patch: Patch) -> Field:
    """The transmission of the true object on a patch.

    Parameters
    ----------
    path
        File (.npz) with `values` and `pitch_um`, or the folder that `wavesim image` wrote it to.
    patch
        Where it is wanted.

    Raises
    ------
    InputError
        If it cannot be read, or covers less than the patch.
    """
    place = path / OBJECT_FILE if path.is_dir() else path
    return measured_field(place, patch.grid, patch.wavelength_um)


def truth_figures(case: Any, transmission: Field) -> dict[str, float | None]:
    """Correlation, PSNR and SSIM with the true object, both as the lens passes them.

    The correlation is that of object fields from which the illumination has been taken out; for PSNR and SSIM
    of the amplitudes the result is multiplied by the complex factor that fits best.
    """
    if case.truth is None:
        return {}
    light, inside = case.light, case.patch.inside

    def passed(values: Any) -> Field:
        return as_passed(light.with_values((light.values * values).astype(np.complex64)), case.engine)

    found, true, known = passed(transmission.values), passed(case.truth.values), passed(np.float32(1.0))
    energy = float(np.vdot(found.values[inside], found.values[inside]).real)
    factor = np.vdot(found.values[inside], true.values[inside]) / energy if energy > 0.0 else 0.0
    brightest = float(np.abs(true.values[inside]).max())
    pair = np.abs(factor * found.values), np.abs(true.values)
    figures = {
        "object_correlation": object_correlation(found, true, known, inside),
        "psnr_db": psnr_db(*pair, full_scale=brightest, support=inside),
        "ssim": ssim(*pair, full_scale=brightest, support=inside),
    }
    return {name: value if math.isfinite(value) else None for name, value in figures.items()}


def bar_figures(case: Any, transmission: Field, options: Any) -> dict[str, Any]:
    """Contrast of every element of the USAF chart and the finest resolved; the same of charts beside it."""
    if not case.charts:
        return {}
    middle, *others = (chart_figures(case, transmission, chart, options.usaf) for chart in case.charts)
    beside = zip(options.chart_at_mm, others, strict=True)
    return middle | {"beside": [{"at_mm": list(point)} | figures for point, figures in beside]}


def chart_figures(case: Any, transmission: Field, elements: Any, ground: Any) -> dict[str, Any]:
    """Contrast of every element of one chart, and the finest that is resolved."""
    contrasts = element_contrasts(transmission.values, case.patch.grid, elements, ground)
    finest = smallest_resolved_element(contrasts)
    return {
        "smallest_resolved": None
        if finest is None
        else {
            "group": finest.group,
            "element": finest.element,
            "line_width_um": finest.line_width_um,
        },
        "elements": [
            {
                "group": one.element.group,
                "element": one.element.element,
                "line_width_um": one.element.line_width_um,
                "contrast_x": _plain(one.x.contrast),
                "contrast_y": _plain(one.y.contrast),
                "resolved": one.resolved(),
            }
            for one in contrasts
        ],
    }


def summary_of(case: Any, outcome: Any, options: Any) -> dict[str, Any]:
    """All figures of a reconstruction, ready for JSON."""
    planes = []
    for told, plane, error in zip(case.planes, case.recorded, outcome.residual_maps, strict=True):
        known = np.ones(error.shape, bool) if plane.known is None else plane.known
        planes.append(
            {
                "plane_distance_mm": told.distance_mm,
                "exposures": list(told.exposures),
                "residual": float(np.linalg.norm(error[known]) / np.linalg.norm(plane.amplitude[known])),
                "noise": _noise(plane, known),
                "correlation": amplitude_correlation(
                    (plane.amplitude + error)[known], plane.amplitude[known]
                ),
                "saturated_share": told.saturated_share,
            }
        )
    refocusing = outcome.refocusing
    return {
        "design": case.lens.title or Path(options.design).stem,
        "method": options.method,
        "kind": options.kind if options.method == "object" else "complex",
        "start": options.start,
        "iterations": len(outcome.curve),
        **outcome.said,
        "planes": planes,
        "diversity": case.diversity,
        "field_stop_mm": case.patch.field_stop_mm,
        "object_pitch_um": 1e3 * case.patch.grid.pitch_mm,
        "samples": case.patch.grid.shape[0],
        "refocus_um": None if refocusing is None else 1e3 * refocusing.distance_mm,
        "truth": truth_figures(case, outcome.transmission),
        "usaf": bar_figures(case, outcome.transmission, options),
    }


def _noise(plane: Any, known: Any) -> float | None:
    """Residual that the stated noise alone would leave."""
    if plane.sigma is None:
        return None
    return float(np.linalg.norm(plane.sigma[known]) / np.linalg.norm(plane.amplitude[known]))


def write_results(case: Any, outcome: Any, summary: dict[str, Any], output: Path) -> list[str]:
    """Write all files together, and return their names."""
    found, pitch_um = outcome.transmission, 1e3 * case.patch.grid.pitch_mm
    distances = [plane.distance_mm for plane in case.planes]
    amplitudes = [plane.amplitude for plane in case.recorded]
    pixel_um = case.sensor.pixel_pitch_um
    what = "CC (A6)" if summary["method"] == "paper" else "misfit"
    how = f"method {summary['method']}, {summary['kind']} object, {summary['iterations']} iterations"
    title = f"{summary['design']}\n{how}"
    steps = range(1, len(outcome.curve) + 1)
    curves = {what: (steps, outcome.curve, "iteration")}
    with new_results(output) as folder:
        write_tiff(folder / "amplitude.tif", np.abs(found.values), pitch_um, quantity="amplitude")
        write_tiff(folder / "phase.tif", np.angle(found.values), pitch_um, quantity="phase_rad")
        write_field(folder / "reconstruction.npz", found)
        save(object_figure(found, case.patch.inside, title), folder / "reconstruction.png")
        save(
            residual_figure(outcome.residual_maps, amplitudes, distances, pixel_um), folder / "residuals.png"
        )
        _write_csv(folder / "convergence.csv", ("iteration", what), zip(steps, outcome.curve, strict=True))
        if what == "CC (A6)":
            curves = {"1 - CC (A6)": (steps, np.maximum(1.0 - np.asarray(outcome.curve), 1e-9), "iteration")}
        if outcome.refocusing is not None:
            curve = (1e3 * outcome.refocusing.distances_mm, outcome.refocusing.svfg)
            curves["SVFG"] = (*curve, "distance (um)")
            _write_csv(folder / "svfg.csv", ("distance_um", "svfg"), zip(*curve, strict=True))
        save(curves_figure(curves, title), folder / "curves.png")
        names = sorted([*(path.name for path in folder.iterdir()), "reconstruction.json"])
        write_json(folder / "reconstruction.json", summary | {"files": names})
    return names


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(
            [float(value) if isinstance(value, np.floating) else value for value in row] for row in rows
        )


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
