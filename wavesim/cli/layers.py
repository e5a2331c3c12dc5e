"""`wavesim reconstruct --layers-um`: reconstruct an object of several layers."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lensdesign.common.console import print_json
from lensdesign.common.text import visible
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import read_bench_state, with_calibrated_stop
from wavesim.cli.options import print_warnings, warning_messages
from wavesim.cli.runs import engine_summary, memory_teller, print_table, progress, versions
from wavesim.scene.settings import (
    STOP_ORIGINS,
    FrameSetSettings,
    LayerReconstructionSettings,
    ReconstructionSettings,
)

if TYPE_CHECKING:
    from wavesim.reconstruction.layer_reconstruction import FoundLayers


def in_layers(
    frames: list[Path],
    design: Path,
    output: Path,
    settings: ReconstructionSettings,
    of_frames: FrameSetSettings,
    of_layers: LayerReconstructionSettings,
    *,
    calibration: Path | None,
    truth: Path | None,
    as_json: bool,
) -> None:
    """Reconstruct the layers, write and print them, and exit with 1 if the frames are not explained."""
    from wavesim.metrics.goodness_of_fit import Finding, with_finding
    from wavesim.metrics.next_steps import STOP_CAUSE
    from wavesim.reconstruction.layer_reconstruction import reconstruct_layers
    from wavesim.sensor.frame_sets import read_frames

    lens = load_design(design)
    stop_from, stop_doubt, settings = with_calibrated_stop(calibration, settings)
    with progress(resumes=False) as on_progress, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = reconstruct_layers(
            lens,
            read_frames(frames, of_frames, lens=lens),
            of_layers.layers_um or (),
            settings,
            truth=truth,
            calibration=read_bench_state(calibration, lens),
            undetermined=of_layers.undetermined_layers,
            folder=output,
            progress=on_progress,
            on_estimate=None if as_json else memory_teller(output),
        )
    if stop_doubt:
        found = replace(found, verdict=with_finding(found.verdict, Finding(STOP_CAUSE, stop_doubt)))
    messages = warning_messages(caught)
    print_warnings(messages)
    summary = {
        "design": lens.title or design.stem,
        **found.as_dict(),
        "field_stop_from": stop_from or settings.field_stop_from,
        "warnings": messages,
        "engine": engine_summary(found.engine, found.predicted_error),
        "memory": found.memory.as_dict(),
        "versions": versions(),
    }
    summary["files"] = [str(output / name) for name in _write(found, summary, output)]
    if as_json:
        print_json(summary)
    else:
        _print(summary, output)
    raise typer.Exit(0 if found.verdict.explained else 1)


def _write(found: FoundLayers, summary: dict[str, Any], output: Path) -> list[str]:
    """Write all files together, and return their names."""
    from wavesim.fields.files import write_field
    from wavesim.plots.frames import residual_figure, save
    from wavesim.plots.objects import layers_figure
    from wavesim.plots.pyramid import write_pyramid
    from wavesim.runtime.result_files import new_results, write_csv, write_json
    from wavesim.targets.patch import layer_file

    pitch_um = 1e3 * found.patch.grid.pitch_mm
    distances = [plane.distance_mm for plane in found.planes]
    sensor_um = 1e3 * found.engine.scene.exit_grid.pitch_mm
    stop = f"{found.patch.stop_words} ({STOP_ORIGINS[summary['field_stop_from']]})"
    light = f"{found.patch.wavelength_um:g} µm, {stop}"
    title = f"{summary['design']}\n{light}: {summary['kind']} layers, {summary['iterations']} iterations"
    with new_results(output) as folder:
        for index, layer in enumerate(found.transmissions, start=1):
            file = layer_file(index)
            write_field(layer, folder / file, centre_x_mm=0.0, centre_y_mm=0.0)
            for name, quantity in (("amplitude", "amplitude"), ("phase", "phase_rad")):
                picture = folder / f"{Path(file).stem}_{name}.tif"
                write_pyramid(layer.values, picture, pitch_um, (quantity,))
        drawn = layers_figure(found.layers_um, found.transmissions, found.inside, title, truth=found.true)
        save(drawn, folder / "reconstruction.png")
        drawn = residual_figure(found.residual_maps, found.recorded, distances, sensor_um, summary["design"])
        save(drawn, folder / "residuals.png")
        rows = [{"iteration": step, "misfit": value} for step, value in enumerate(found.curve, 1)]
        write_csv(rows, folder / "convergence.csv")
        names = sorted([*(path.name for path in folder.iterdir()), "reconstruction.json"])
        write_json(summary | {"files": names}, folder / "reconstruction.json")
    return names


def _print(summary: dict[str, Any], output: Path) -> None:
    from wavesim.reconstruction.stop_rule import STOPPED

    layers = summary["layers"]
    print(visible(summary["design"]))
    print(
        f"{len(layers)} {summary['kind']} layers, engine {summary['engine']['name']}: "
        f"{summary['iterations']} iterations{STOPPED[summary['stopped_because']]}"
    )
    print(
        f"{summary['oversampling_ratio']:.3g} measurements for each unknown "
        f"({summary['required_ratio']:g} are required)"
    )
    rows = [
        (
            f"{layer['distance_um']:g}",
            *(
                "unknown" if (value := layer["truth"].get(name)) is None else f"{value:.{digits}f}"
                for name, digits in (("object_correlation", 4), ("ssim", 3))
            ),
        )
        for layer in layers
    ]
    print()
    print_table((), ("layer (µm)", "correlation with the true layer", "SSIM"), rows)
    print()
    print(f"wrote {len(summary['files'])} files to {output}")
    print(f"verdict: {summary['verdict']['words']}")
