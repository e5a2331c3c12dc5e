"""`wavesim reconstruct --free-space`: reconstruct a field from frames without a lens."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wavesim.cli.runs import Run, print_table
from wavesim.scene.settings import FrameSetSettings, FreeSpaceSettings, ReconstructionSettings, SettingError

if TYPE_CHECKING:
    from wavesim.calibration.free_space import FreeSpaceField


def in_free_space(
    frames: list[Path],
    output: Path,
    settings: ReconstructionSettings,
    of_frames: FrameSetSettings,
    free: FreeSpaceSettings,
    of_lenses: Mapping[str, object],
    as_json: bool,
) -> None:
    """Reconstruct the field on z = 0 and write it, with the requested parameters of the planes."""
    from wavesim.calibration.free_space import (
        DEFAULT_FRAME_SETTINGS,
        ITERATIONS,
        reconstruct_free_space,
    )
    from wavesim.sensor.frame_sets import read_frames
    from wavesim.sensor.frames import AssumedWarning

    _refuse_of_lenses(settings, of_lenses)
    run = Run(as_json, resumes=False)
    with run.computing() as on_progress:
        warnings.simplefilter("ignore", AssumedWarning)
        found = reconstruct_free_space(
            read_frames(frames, of_frames, assumed=DEFAULT_FRAME_SETTINGS),
            calibrates=free.calibrate,
            iterations=settings.iterations or ITERATIONS,
            aperture=free.numerical_aperture,
            progress=on_progress,
        )
    more = {
        "frames": [str(path) for path in frames],
        "calibrated": free.calibrate,
        "aperture_stated": free.numerical_aperture is not None,
        "warnings": run.messages,
    }
    summary = found.write(output, more, free.predict_mm or ())
    run.report(summary, partial(_print, found, output=output))


def _refuse_of_lenses(settings: ReconstructionSettings, of_lenses: Mapping[str, object]) -> None:
    """Check that no option is given that needs a lens."""
    named = [name for name, given in of_lenses.items() if given]
    for name, field in type(settings).model_fields.items():
        if name != "iterations" and getattr(settings, name) != field.get_default():
            named.append(name)
    if named:
        raise SettingError(f"{{{named[0]}}}: cannot be used with {{free_space}}, which has no lens")


def _print(found: FreeSpaceField, summary: dict[str, Any], output: Path) -> None:
    rows = []
    for plane in summary["planes"]:
        x, y = plane["shift_um"]
        rows.append(
            (
                f"{plane['plane_distance_mm']:g}",
                f"{plane['found_distance_mm']:.5g}",
                f"{x:.3f}, {y:.3f}",
                f"{plane['gain']:.4f}",
                "none" if plane["correlation"] is None else f"{plane['correlation']:.4f}",
            )
        )
    print(f"free space, numerical aperture {found.stack.aperture:.3g}: {len(found.misfit)} iterations")
    print()
    print_table((), ("plane (mm)", "estimated (mm)", "shift x, y (µm)", "gain", "correlation"), rows)
    print()
    if found.seeks_distances:
        print(
            f"estimated distances: {found.distance_scale:.4f} times the stated ones (standard deviation "
            f"{found.scale_deviation:.2g})"
        )
    else:
        print("distances as stated")
    print(f"misfit {found.misfit[-1]:.4f} (expected from noise alone: {found.stack.noise:.4f})")
    print(
        f"light beyond the numerical aperture of {found.stack.aperture:.3g} is not in the result"
        + ("" if summary["aperture_stated"] else ": noise hides it; state a larger one if it is known")
    )
    print(f"wrote {len(summary['files'])} files to {output}")
