"""What a bench is like, from frames and a design, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.calibration.calibrated import Calibrated
from wavesim.calibration.estimation import calibrate
from wavesim.calibration.joint_search import JointSearch, Stand
from wavesim.calibration.parameters import Parameter, Unknowns, bench_parameters, chosen_parameters
from wavesim.camera.frame_sets import recorded_planes
from wavesim.camera.frames import Frame
from wavesim.camera.light_of_frames import light_of_frames
from wavesim.camera.mounting import RIGID, parameter_names, refuse_parameters
from wavesim.camera.patch_of_frames import Framed, framed_patch, key_of_frames
from wavesim.camera.recorded import Recorded, noise_misfit
from wavesim.camera.recording import Progress
from wavesim.camera.windows import exit_scene, imaging_engine
from wavesim.fields.field import Field
from wavesim.objects.patch import read_object
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.scene.bench import Bench
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
    """Find what the bench is like: light, lens, mounting and camera.

    It is the one with which frames and reconstruction agree best; :func:`wavesim.reconstruct_frames` takes
    it. Frames of a known object tell the mounting alone.

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
    seen = _Seen(lens, framed, tuple(recorded_planes(frames)), settings)
    tell = progress or (lambda what, done, count: None)
    if known is not None:
        known = read_object(known, framed.patch) if isinstance(known, Path) else known
        return _mounting_alone(seen, known, tell)
    return _bench_and_object(seen, folder, tell)


class _Seen:
    """The frames, what was set, and the engines that both searches take."""

    def __init__(
        self, lens: Lens, framed: Framed, recorded: tuple[Recorded, ...], settings: CalibrationSettings
    ) -> None:
        self.lens, self.framed, self.recorded, self.settings = lens, framed, recorded, settings
        self.scene = exit_scene(lens, framed.patch, framed.sensor, framed.planes_mm[0])
        self.start = Placement(Pose(pivot_z_mm=settings.pivot_z_mm))
        self._behind = light_of_frames(self.scene, framed.frames, framed.light)
        self._made: dict[str, Engine] = {}

    def make(self, scene: Scene) -> Engine:
        """The same scene is asked for more than once in a row."""
        key = repr(scene)
        if key not in self._made:
            self._made.clear()
            self._made[key] = imaging_engine(
                scene, self.settings, runs=2 * self.settings.iterations, light=self._behind.on(scene)
            )
        return self._made[key]


def _mounting_alone(seen: _Seen, known: Field, tell: Progress) -> Calibrated:
    settings = seen.settings
    return calibrate(
        seen.scene,
        seen.framed.light,
        seen.recorded,
        known=known,
        parameters=_named(settings.parameters, parameter_names(len(seen.framed.planes_mm))),
        scale=settings.scale,
        active_width=settings.active_width,
        start=seen.start,
        make=seen.make,
        most_mountings=settings.most_mountings,
        progress=lambda name, number, _, misfit: tell(
            f"{name} search: misfit {misfit:.4f}", number, settings.most_mountings
        ),
    )


def _bench_and_object(seen: _Seen, folder: Path | None, tell: Progress) -> Calibrated:
    settings, light = seen.settings, seen.framed.light
    told = settings.model_dump_json(exclude=NOT_TELLING)
    key = key_of_frames(seen.lens, seen.framed.frames, light, told)
    parameters = _parameters(seen.lens, seen.framed, settings)
    run = _Run(
        Unknowns(seen.lens, Bench(seen.start)),
        tuple(p.name for p in parameters),
        None if folder is None else Checkpoint(folder / CHECKPOINT, key),
    )
    tell("the frames as designed", 0, settings.most_mountings)
    noise = noise_misfit(seen.recorded)
    search = JointSearch(
        seen.scene,
        light.with_values(light.values.astype(np.complex64)),
        seen.recorded,
        settings.kind,
        settings.scale,
        settings.active_width,
        parameters,
        settings.iterations,
        seen.make,
        settings.most_mountings,
        noise,
        lambda number, _, misfit: tell(_misfit_told(misfit, noise), number, settings.most_mountings),
        run.keep,
    )
    try:
        found = search.run(run.begun())
    except KeyboardInterrupt:
        told = "the same command goes on from there" if run.kept else "nothing was written"
        raise KeyboardInterrupt(f"interrupted after {run.kept} mountings; {told}") from None
    return Calibrated(
        bench=found.unknowns.bench,
        parameters=run.names,
        values=tuple(found.unknowns.of(run.names).tolist()),
        deviations=tuple(found.deviations.tolist()),
        typical=tuple(p.typical for p in parameters),
        misfit_before=found.trail[0][1],
        misfit=found.misfit,
        trail=tuple((tuple(u.of(run.names).tolist()), misfit) for u, misfit in found.trail),
        at_reach=(),
        stopped_because=found.stopped_because,
        misfit_of_noise=noise,
    )


def _misfit_told(misfit: float, noise: float | None) -> str:
    return f"misfit {misfit:.4f}" if noise is None else f"misfit {misfit / noise:.2f} times the noise"


def _parameters(lens: Lens, framed: Framed, settings: CalibrationSettings) -> tuple[Parameter, ...]:
    patch = framed.patch
    side_mm = patch.grid.shape[0] * patch.grid.pitch_mm
    allowed = bench_parameters(
        lens, len(framed.planes_mm), side_mm, patch.wavelength_um, light=settings.kind == "amplitude"
    )
    try:
        return chosen_parameters(settings.parameters, allowed)
    except InputError as error:
        raise SettingError(f"{{parameters}} = {settings.parameters!r}: {error}") from None


class _Run:
    """What a search has come to, and its file."""

    def __init__(self, start: Unknowns, names: tuple[str, ...], checkpoint: Checkpoint | None) -> None:
        self._start, self.names, self._checkpoint = start, names, checkpoint
        self.kept = 0

    def begun(self) -> Stand:
        """Where an earlier run was cut off, or the start."""
        kept = None if self._checkpoint is None else self._checkpoint.load()
        if kept is None:
            return Stand(self._start)
        self.kept = len(kept["misfits"])
        rows = zip(kept["values"].tolist(), kept["misfits"].tolist(), strict=True)
        trail = tuple((self._start.changed(self.names, values), misfit) for values, misfit in rows)
        here = self._start.changed(self.names, kept["here"].tolist())
        return Stand(here, int(kept["stage"]), float(kept["stretch"]), trail)

    def keep(self, stand: Stand) -> None:
        """After each step."""
        self.kept = len(stand.trail)
        if self._checkpoint is None:
            return
        self._checkpoint.keep(
            here=stand.unknowns.of(self.names),
            values=[unknowns.of(self.names) for unknowns, _ in stand.trail],
            misfits=[misfit for _, misfit in stand.trail],
            stage=stand.stage,
            stretch=stand.stretch,
        )


def _named(text: str, allowed: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters asked for."""
    groups = {"rigid": RIGID, "all": allowed}
    names = groups.get(text) or tuple(part.strip() for part in text.split(",") if part.strip())
    try:
        refuse_parameters(names, len(allowed) - len(RIGID) - 1)
    except InputError as error:
        raise SettingError(f"{{parameters}} = {text!r}: {error}; or: rigid, all") from None
    return names
