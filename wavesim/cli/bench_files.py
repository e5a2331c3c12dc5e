"""Further data about a bench: its state, frames without an object, and tolerances of the lens."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wavesim.scene.settings import FrameSetSettings, ReconstructionSettings, SettingError, StopOrigin

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens
    from wavesim.scene.system_state import SystemState
    from wavesim.sensor.frames import Frame

PRIORS = "wavesim.priors"
"""Entry points that read tolerances of a lens; a package above this one provides them."""


class PriorsWarning(UserWarning):
    """A tolerance study perturbs parameters that a calibration cannot estimate."""


def read_bench_state(path: Path | None, lens: Lens) -> SystemState | None:
    """Read the state of a calibration or of any file with a state; None if there is no file."""
    from wavesim.calibration.calibration_result import read_calibration

    return None if path is None else read_calibration(path, lens)


def with_calibrated_stop(
    calibration: Path | None, settings: ReconstructionSettings
) -> tuple[StopOrigin | None, str, ReconstructionSettings]:
    """Return origin, warning and settings of a calibration's field stop, unless the settings state one."""
    if calibration is None or settings.field_stop_from != "patch":
        return None, "", settings
    from wavesim.calibration.calibration_result import field_stop_of

    stop = field_stop_of(calibration)
    if stop is None:
        return None, "", settings
    diameter_mm, centre_mm, warning = stop
    return "calibration", warning, settings.with_stop(diameter_mm, centre_mm)


def read_empty(
    paths: Sequence[Path] | None, of_frames: FrameSetSettings, lens: Lens
) -> tuple[Frame, ...] | None:
    """Read frames without an object, from files and from folders of `wavesim image`."""
    from wavesim.sensor.frame_sets import read_frames

    if not paths:
        return None
    return read_frames(frame_files(paths, "{empty}"), of_frames, lens=lens)


def frame_files(paths: Sequence[Path], named: str) -> list[Path]:
    """Return the files of frames, given by themselves or by folders of `wavesim image`."""
    files: list[Path] = []
    pattern = "frame_*.tif"
    for path in paths:
        inside = sorted(path.glob(pattern)) if path.is_dir() else [path]
        if not inside:
            raise SettingError(f"{named}: {path}: contains no {pattern}")
        files += inside
    return files


def read_priors(path: Path | None, lens: Lens) -> dict[str, float] | None:
    """Read prior standard deviations of a calibration's parameters from a tolerance study."""
    from importlib.metadata import entry_points

    if path is None:
        return None
    readers = tuple(entry_points(group=PRIORS, name="study"))
    if not readers:
        raise SettingError(
            f"{{priors}}: no package that reads tolerance studies is installed (entry point {PRIORS})"
        )
    found = readers[0].load()(path, lens)
    if found.not_sought:
        warnings.warn(
            f"{path}: {', '.join(found.not_sought)}: a calibration cannot estimate these parameters; their "
            "errors remain",
            PriorsWarning,
            stacklevel=2,
        )
    return found.deviations
