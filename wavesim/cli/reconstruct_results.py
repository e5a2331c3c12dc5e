"""What a reconstruction is worth, and its files: figures, amplitude and phase, residuals, curves."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np

from lensdesign.errors import InputError
from wavesim.evaluation.metrics import as_passed, bar_contrast, object_correlation, smallest_resolved_element
from wavesim.evaluation.similarity import psnr_db, ssim
from wavesim.fields.field import Field
from wavesim.objects.illumination import measured_field
from wavesim.objects.patch import Patch
from wavesim.objects.region import around, cut_field, holds, part_of
from wavesim.pictures.field_files import new_results, read_centre_um, write_field, write_json, write_tiff
from wavesim.pictures.frames import curves_figure, object_figure, residual_figure, save
from wavesim.runtime.threads import row_blocks
from wavesim.scene.engine import Engine

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
        If it cannot be read, covers less than the patch, or is that of a region beside the middle.
    """
    place = path / OBJECT_FILE if path.is_dir() else path
    if is_zipfile(place) and (centre_um := read_centre_um(place)) != (0.0, 0.0):
        x_mm, y_mm = (1e-3 * c for c in centre_um)
        raise InputError(f"{place}: is a region about {x_mm:.4g}, {y_mm:.4g} mm; give a field about the axis")
    return measured_field(place, patch.grid, patch.wavelength_um)


def truth_figures(case: Any, transmission: Field, engine: Engine) -> dict[str, float | None]:
    """Correlation, PSNR and SSIM with the true object, both as the lens passes them.

    The correlation is that of object fields from which the illumination has been taken out; for PSNR and SSIM
    of the amplitudes the result is multiplied by the complex factor that fits best.

    Parameters
    ----------
    case
        Of the run.
    transmission
        What was found, on the part that is shown.
    engine
        From that part.
    """
    light, inside, scratch = cut_field(case.light, case.shown), case.inside, case.scratch
    part = part_of(case.shown, case.light.grid)

    def passed(values: Any) -> Field:
        own = light.with_values((light.values * values).astype(np.complex64))
        there = as_passed(own, engine)
        return there.with_values(scratch.held(there.values, "a field that the lens passes"))

    found, true = passed(transmission.values), passed(case.truth.values[part])
    figures = {"object_correlation": object_correlation(found, true, passed(np.float32(1.0)), inside)}
    energy = _product(found.values, found.values, inside).real
    factor = _product(found.values, true.values, inside) / energy if energy > 0.0 else 0.0
    pair = _moduli(found.values, abs(factor)), _moduli(true.values)
    del found, true
    brightest = float(pair[1].max(where=inside, initial=0.0))
    figures |= {
        "psnr_db": psnr_db(*pair, full_scale=brightest, support=inside),
        "ssim": ssim(*pair, full_scale=brightest, support=inside),
    }
    return {name: value if math.isfinite(value) else None for name, value in figures.items()}


def _product(a: Any, b: Any, inside: Any) -> complex:
    """Inner product within the field stop, without copies of whole fields."""
    blocks = row_blocks(len(inside))
    return complex(sum(complex(np.vdot(a[rows][inside[rows]], b[rows][inside[rows]])) for rows in blocks))


def _moduli(values: Any, factor: float = 1.0) -> Any:
    """Moduli in single precision."""
    result = np.empty(values.shape, np.float32)
    for rows in row_blocks(len(values)):
        result[rows] = factor * np.abs(values[rows])
    return result


def bar_figures(case: Any, transmission: Field, options: Any) -> dict[str, Any]:
    """Contrast of every element of the USAF chart and the finest resolved; the same of charts beside it."""
    if not case.charts:
        return {}
    middle, *others = (chart_figures(case, transmission, chart, options.usaf) for chart in case.charts)
    beside = zip(options.chart_at_mm, others, strict=True)
    return middle | {"beside": [{"at_mm": list(point)} | figures for point, figures in beside]}


def chart_figures(case: Any, transmission: Field, elements: Any, ground: Any) -> dict[str, Any]:
    """Contrast of every element of one chart that lies in the part shown, and the finest that is resolved."""
    contrasts = [
        _contrast(transmission, one, ground) for one in elements if holds(transmission.grid, one.outline)
    ]
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
            for one in sorted(contrasts, key=lambda one: -one.element.line_width_um)
        ],
    }


def _contrast(transmission: Field, element: Any, ground: Any) -> Any:
    """Of one element, from the samples about it alone."""
    own = cut_field(transmission, around(element.outline, transmission.grid))
    return bar_contrast(own.values, own.grid, element, ground)


def summary_of(case: Any, outcome: Any, options: Any) -> dict[str, Any]:
    """All figures of a reconstruction, ready for JSON."""
    planes = []
    for told, plane, error in zip(case.planes, case.recorded, outcome.residual_maps, strict=True):
        planes.append(
            {
                "plane_distance_mm": told.distance_mm,
                "exposures": list(told.exposures),
                **_plane_figures(plane, error),
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
        "region_mm": None if options.region_mm is None else _region(case.shown),
        "refocus_um": None if refocusing is None else 1e3 * refocusing.distance_mm,
        "truth": outcome.truth,
        "usaf": bar_figures(case, outcome.transmission, options),
    }


def _region(shown: Any) -> list[float]:
    """x and y of the centre, width and height, of the samples that are shown."""
    (half_y, half_x), (x, y) = shown.half_widths_mm, shown.centre_mm
    return [x, y, 2.0 * half_x, 2.0 * half_y]


def _plane_figures(plane: Any, error: Any) -> dict[str, float | None]:
    """Residual, what the stated noise alone would leave of it, and the correlation of amplitudes (A6).

    Over the pixels that are known, in blocks of rows.
    """
    count, sums, noise = 0, np.zeros(2), 0.0
    products = np.zeros((2, 2))
    missed = 0.0
    for rows in row_blocks(len(error)):
        known = slice(None) if plane.sigma is None else np.isfinite(plane.sigma[rows])
        recorded = np.ravel(plane.amplitude[rows][known]).astype(float)
        left = np.ravel(error[rows][known]).astype(float)
        pair = np.stack([recorded + left, recorded])
        count += recorded.size
        sums += pair.sum(axis=1)
        products += pair @ pair.T
        missed += float(left @ left)
        if plane.sigma is not None:
            noise += float(np.sum(plane.sigma[rows][known].astype(float) ** 2))
    size = products[1, 1]
    about_means = products - np.outer(sums, sums) / count
    spread = math.sqrt(max(about_means[0, 0] * about_means[1, 1], 0.0))
    return {
        "residual": math.sqrt(missed / size),
        "noise": None if plane.sigma is None else math.sqrt(noise / size),
        "correlation": float(about_means[0, 1]) / spread if spread > 0.0 else 0.0,
    }


def write_results(case: Any, outcome: Any, summary: dict[str, Any], output: Path) -> list[str]:
    """Write all files together, and return their names."""
    found, pitch_um = outcome.transmission, 1e3 * case.patch.grid.pitch_mm
    distances = [plane.distance_mm for plane in case.planes]
    amplitudes = [plane.amplitude for plane in case.recorded]
    pixel_um, (x_mm, y_mm) = case.sensor.pixel_pitch_um, case.shown.centre_mm
    what = "CC (A6)" if summary["method"] == "paper" else "misfit"
    how = f"method {summary['method']}, {summary['kind']} object, {summary['iterations']} iterations"
    title = f"{summary['design']}\n{how}"
    steps = range(1, len(outcome.curve) + 1)
    curves = {what: (steps, outcome.curve, "iteration")}
    with new_results(output) as folder:
        write_tiff(folder / "amplitude.tif", found.values, pitch_um, quantity="amplitude")
        write_tiff(folder / "phase.tif", found.values, pitch_um, quantity="phase_rad")
        write_field(folder / "reconstruction.npz", found, centre_x_mm=x_mm, centre_y_mm=y_mm)
        save(object_figure(found, case.inside, title), folder / "reconstruction.png")
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
