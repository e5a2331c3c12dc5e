"""`wavesim reconstruct --free-space`: reconstruct a field from frames without a lens."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.common.console import print_json
from wavesim.cli.options import print_warnings, warning_messages
from wavesim.cli.runs import print_table, progress, versions
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
    with progress(resumes=False) as on_progress, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", AssumedWarning)
        found = reconstruct_free_space(
            read_frames(frames, of_frames, assumed=DEFAULT_FRAME_SETTINGS),
            calibrates=free.calibrate,
            iterations=settings.iterations or ITERATIONS,
            aperture=free.numerical_aperture,
            progress=on_progress,
        )
    messages = warning_messages(caught)
    print_warnings(messages)
    summary = {
        "frames": [str(path) for path in frames],
        "calibrated": free.calibrate,
        "aperture_stated": free.numerical_aperture is not None,
        **found.as_dict(),
        "predicted_mm": list(free.predict_mm or ()),
        "warnings": messages,
        "versions": versions(),
    }
    summary["files"] = [str(output / name) for name in _write(found, summary, output)]
    if as_json:
        print_json(summary)
    else:
        _print(found, summary, output)


def _refuse_of_lenses(settings: ReconstructionSettings, of_lenses: Mapping[str, object]) -> None:
    """Check that no option is given that needs a lens."""
    named = [name for name, given in of_lenses.items() if given]
    for name, field in type(settings).model_fields.items():
        if name != "iterations" and getattr(settings, name) != field.get_default():
            named.append(name)
    if named:
        raise SettingError(f"{{{named[0]}}}: cannot be used with {{free_space}}, which has no lens")


def _write(found: FreeSpaceField, summary: dict[str, Any], output: Path) -> list[str]:
    """Write all files together, and return their names."""
    import numpy as np

    from wavesim.fields.files import write_arrays, write_field
    from wavesim.plots.frames import save
    from wavesim.plots.objects import object_figure
    from wavesim.plots.pyramid import write_pyramid
    from wavesim.runtime.result_files import new_results, write_csv, write_json

    pitch_um = 1e3 * found.field.grid.pitch_mm
    with new_results(output) as folder:
        write_field(found.field, folder / "reconstruction.npz", centre_x_mm=0.0, centre_y_mm=0.0)
        for name, quantity in (("amplitude", "amplitude"), ("phase", "phase_rad")):
            write_pyramid(found.field.values, folder / f"{name}.tif", pitch_um, (quantity,))
        everywhere = np.ones(found.field.grid.shape, bool)
        save(object_figure(found.field, everywhere, "free space, z = 0"), folder / "reconstruction.png")
        write_csv(
            [{"iteration": n, "misfit": value} for n, value in enumerate(found.misfit, 1)],
            folder / "convergence.csv",
        )
        if summary["predicted_mm"]:
            amplitudes = [found.amplitude(distance) for distance in summary["predicted_mm"]]
            for distance, amplitude in zip(summary["predicted_mm"], amplitudes, strict=True):
                write_pyramid(amplitude, folder / f"predicted_{distance:g}_mm.tif", pitch_um, ("amplitude",))
            write_arrays(
                folder / "predicted.npz",
                amplitude=np.array(amplitudes),
                plane_distance_mm=summary["predicted_mm"],
                pitch_um=pitch_um,
                wavelength_um=found.field.wavelength_um,
            )
        write_json(summary, folder / "calibration.json")
        names = sorted([*(path.name for path in folder.iterdir()), "reconstruction.json"])
        write_json(summary | {"files": names}, folder / "reconstruction.json")
    return names


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
