"""Frames from benches that differ from the design: the object before and after they are calibrated.

A folder holds frames, the true object (`object.npz`, or `truth.npz` with `transmission` and `inside`, the
field stop) and `set.json`, which names frames, patch, kind of object and errors. The design as the lab
believes it, `nominal.toml` or a file of the name of the folder, lies beside it. Without folders the set in
`tests/golden/bench` is taken. All settings are the defaults of the commands.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import Row, print_table
from lensdesign import load_design
from wavesim import calibrate_frames, read_frames, reconstruct_frames
from wavesim.fields.field import Field
from wavesim.scene.settings import ReconstructionSettings
from wavesim.targets.patch import Patch, lit_patch, read_object

GOLDEN = Path(__file__).resolve().parents[1] / "tests" / "golden" / "bench" / "everything"


def main() -> None:
    """Measure and print."""
    for folder in [Path(name) for name in sys.argv[1:]] or [GOLDEN]:
        print_table(f"{folder.name}: before and after its calibration", _rows(folder))


def _rows(folder: Path) -> list[Row]:
    about = json.loads((folder / "set.json").read_text())
    lens = load_design(design_of(folder))
    frames = read_frames([folder / name for name in about["files"]], lens=lens)
    kind = about.get("kind", "amplitude")
    settings = ReconstructionSettings(kind=kind, patch_mm=about["patch_mm"])
    true = true_object(folder, lit_patch(lens, settings)[0])
    before = reconstruct_frames(lens, frames, settings, truth=true)
    wall, cpu = time.perf_counter(), time.process_time()
    found = calibrate_frames(lens, frames, kind=kind, patch_mm=about["patch_mm"], verdict="none")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    if found.field_stop_from == "frames":
        settings = settings.with_stop(*found.field_stop)
    after = reconstruct_frames(lens, frames, settings, truth=true, calibration=found.state)
    for name, value, deviation in zip(found.parameters, found.values, found.deviations or (), strict=True):
        print(f"{name} = {value:.4g} +- {deviation:.2g}")
    noise = found.misfit_of_noise or np.nan
    return [
        Row("correlation as designed", before.truth["object_correlation"] or 0.0),
        Row("correlation calibrated", after.truth["object_correlation"] or 0.0, at_least=0.985),
        Row("misfit over noise, search", found.misfit / noise, at_most=1.15),
        Row("misfit over noise, reconstruction", after.verdict.over_noise),
        Row("benches tried", len(found.trail)),
        Row("calibration", wall, "s", at_most=180.0),
        Row("calibration, processor time", cpu, "s"),
    ]


def design_of(folder: Path) -> Path:
    """Return the file of the design that a lab believes it has."""
    own = folder.with_suffix(".toml")
    return own if own.exists() else folder.parent / "nominal.toml"


def true_object(folder: Path, patch: Patch) -> Field:
    """Return the object of the frames in a folder."""
    path = folder / "truth.npz"
    if not path.exists():
        return read_object(folder, patch)
    with np.load(path) as stored:
        values = stored["transmission"] * stored["inside"]
    return Field(patch.grid, values.astype(complex), patch.wavelength_um)


if __name__ == "__main__":
    main()
