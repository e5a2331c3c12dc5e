"""`wavesim reconstruct --layers-um`: reconstruct an object of several layers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from lensdesign.common.text import visible
from lensdesign.files.design import load_design
from wavesim.cli.bench_files import read_bench_state, with_calibrated_stop
from wavesim.cli.runs import Run, print_table
from wavesim.scene.settings import FrameSetSettings, LayerReconstructionSettings, ReconstructionSettings


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
    from wavesim.runtime.checkpoint import drop_series
    from wavesim.sensor.frame_sets import read_frames

    lens = load_design(design)
    stop_from, stop_doubt, settings = with_calibrated_stop(calibration, settings)
    run = Run(as_json, folder=output)
    with run.computing() as on_progress:
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
            on_estimate=run.tells_memory(output),
        )
    if stop_doubt:
        found = replace(found, verdict=with_finding(found.verdict, Finding(STOP_CAUSE, stop_doubt)))
    more = {
        "design": lens.title or design.stem,
        "field_stop_from": stop_from or settings.field_stop_from,
        "warnings": run.messages,
    }
    summary = found.write(output, more)
    drop_series(output)
    run.report(summary, partial(_print, output=output), found.verdict.explained)


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
