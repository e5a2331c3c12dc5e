"""How a lens is mounted, from frames and a design, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.calibration.estimation import RIGID, Calibrated, calibrate
from wavesim.camera.frame_sets import recorded_planes
from wavesim.camera.frames import Frame
from wavesim.camera.mounting import (
    parameter_names,
    refuse_parameters,
    values_of,
    with_values,
)
from wavesim.camera.patch_of_frames import framed_patch, key_of_frames
from wavesim.camera.recording import Progress
from wavesim.camera.windows import exit_scene, imaging_engine
from wavesim.fields.field import Field
from wavesim.objects.patch import read_object
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.engine import Engine
from wavesim.scene.placement import Placement
from wavesim.scene.scene import Scene
from wavesim.scene.settings import CalibrationSettings, SettingError

CHECKPOINT = "checkpoint.npz"
"""File in which a search keeps what it has tried."""

NOT_TELLING = {"patch_mm", "field_stop_mm", "object_pitch_um", "illumination", "most_mountings"}
"""Settings that a trail does not depend on, or that the light has in it already."""


def calibrate_frames(
    lens: Lens,
    frames: Sequence[Frame],
    settings: CalibrationSettings | None = None,
    *,
    known: Field | Path | None = None,
    folder: Path | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Calibrated:
    """Find how the lens is mounted: decenter, tilt, working distance, distances of the planes.

    The mounting is the one with which frames and reconstruction agree best;
    :func:`wavesim.reconstruct_frames` takes it.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        One or more of each plane, as :func:`wavesim.image` or :func:`wavesim.read_frames` gives them.
    settings
        All that may be set; defaults if left out.
    known
        Transmission of the object on the patch's samples, where it is known, or its file or folder.
    folder
        Where what was tried is kept, so that a search which was cut off goes on with the same call.
    progress
        Told what is done, how many mountings are tried, and the most that will be.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError, SamplingError
        If a value is not usable, or no light gets through the lens.
    KeyboardInterrupt
        Saying what is kept.
    """
    settings = (settings or CalibrationSettings()).replaced(**changes)
    framed = framed_patch(lens, frames, settings)
    names = _named(settings.parameters, parameter_names(len(framed.planes_mm)))
    if isinstance(known, Path):
        known = read_object(known, framed.patch)
    told = settings.model_dump_json(exclude=NOT_TELLING)
    values = b"" if known is None else known.values.tobytes()
    key = key_of_frames(lens, framed.frames, framed.light, told, values)
    checkpoint = None if folder is None else Checkpoint(folder / CHECKPOINT, key)
    search = _Search(settings, names, checkpoint, progress)

    def make(scene: Scene) -> Engine:
        return imaging_engine(scene, settings, runs=2 * settings.iterations)

    try:
        return calibrate(
            exit_scene(lens, framed.patch, framed.sensor, framed.planes_mm[0]),
            framed.light,
            recorded_planes(frames),
            parameters=names,
            known=known,
            kind=settings.kind,
            iterations=settings.iterations,
            scale=settings.scale,
            active_width=settings.active_width,
            start=search.start,
            make=make,
            most_mountings=settings.most_mountings,
            tried=search.tried,
            progress=search.show,
        )
    except KeyboardInterrupt:
        told = "the same command goes on from there" if search.trail else "nothing was written"
        raise KeyboardInterrupt(f"interrupted after {len(search.trail)} mountings; {told}") from None


class _Search:
    """Tells how far a search is, and keeps what it has tried."""

    def __init__(
        self,
        settings: CalibrationSettings,
        names: tuple[str, ...],
        checkpoint: Checkpoint | None,
        progress: Progress | None,
    ) -> None:
        self._names, self._checkpoint, self._most = names, checkpoint, settings.most_mountings
        self._progress = progress or (lambda what, done, count: None)
        self.start = Placement(Pose(pivot_z_mm=settings.pivot_z_mm))
        self.trail: list[tuple[Placement, float]] = []
        self.tried = self._kept()
        self._progress("the light without an object", 0, self._most)

    def _kept(self) -> list[tuple[Placement, float]]:
        """Mountings that an earlier run has tried, and their misfits."""
        kept = None if self._checkpoint is None else self._checkpoint.load()
        if kept is None:
            return []
        rows = zip(kept["values"].tolist(), kept["misfits"].tolist(), strict=True)
        return [(with_values(self.start, self._names, values), misfit) for values, misfit in rows]

    def show(self, search: str, number: int, mounting: Placement, misfit: float) -> None:
        self._progress(f"{search} search: misfit {misfit:.4f}", number, self._most)
        if search != "fine":
            return
        self.trail.append((mounting, misfit))
        if self._checkpoint is not None and len(self.trail) > len(self.tried):
            values = [values_of(mounting, self._names) for mounting, _ in self.trail]
            self._checkpoint.keep(values=values, misfits=[size for _, size in self.trail])


def _named(text: str, allowed: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters asked for."""
    groups = {"rigid": RIGID, "all": allowed}
    names = groups.get(text) or tuple(part.strip() for part in text.split(",") if part.strip())
    try:
        refuse_parameters(names, len(allowed) - len(RIGID) - 1)
    except InputError as error:
        raise SettingError(f"{{parameters}} = {text!r}: {error}; or: rigid, all") from None
    return names
