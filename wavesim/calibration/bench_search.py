"""A search for what a bench is like, among all parameters, which goes on where it was cut off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.calibration.calibrated import Calibrated, traded
from wavesim.calibration.joint.fast_grid import with_fast_shape
from wavesim.calibration.joint.pixels import AllPixels, Pixels
from wavesim.calibration.joint.search import JointSearch, SearchState
from wavesim.calibration.joint.some_pixels import pixels_apart, some_pixels
from wavesim.calibration.parameters import (
    LIGHT_ORDER,
    Parameter,
    Unknowns,
    all_names,
    bench_parameters,
    chosen_parameters,
    with_priors,
)
from wavesim.engines.tiles.engine import EikonalTiles
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.memory import MemoryLimitError, memory_limit
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Engine
from wavesim.scene.placement import Placement
from wavesim.scene.scene import Scene
from wavesim.scene.settings import CalibrationSettings, SettingError
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.light_of_frames import light_of_frames
from wavesim.sensor.measurement import noise_misfit
from wavesim.sensor.patch_of_frames import key_of_frames, patch_of_frames
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import exit_scene, imaging_engine

HELD = 5
"""Arrays as large as all parameters' changes of all pixels that a search holds at its end."""

NOT_TELLING = {
    "patch_mm",
    "field_stop_mm",
    "field_stop_at_mm",
    "field_stop",
    "object_pitch_um",
    "illumination",
    "most_mountings",
}
"""Settings that a trail does not depend on, or that the light has in it already."""


class Seen:
    """Frames, what was set, and the engines that searches take."""

    def __init__(
        self,
        lens: Lens,
        frames: Sequence[Frame],
        settings: CalibrationSettings,
        priors: Mapping[str, float] | None = None,
    ) -> None:
        self.lens, self.settings, self.priors = lens, settings, priors or {}
        self.framed = framed = patch_of_frames(lens, frames, settings)
        self.recorded = tuple(recorded_planes(frames))
        self.scene = exit_scene(lens, framed.patch, framed.sensor, framed.planes_mm[0])
        self.start = Placement(Pose(pivot_z_mm=settings.pivot_z_mm))
        self._behind = light_of_frames(self.scene, framed.frames, framed.light)
        self._made: dict[str, Engine] = {}
        light = framed.light.with_values(framed.light.values.astype(np.complex64))
        told = settings.scale, settings.fill_factor, self.make
        some, apart = None, pixels_apart(framed.patch, self.scene)
        if apart > 1 and settings.engine == EikonalTiles.name:
            every = AllPixels(self.scene, light, self.recorded, *told)
            some = some_pixels(every, framed.frames, apart)
        scene, recorded = with_fast_shape(self.scene, self.recorded)
        self.pixels: Pixels = some or AllPixels(scene, light, recorded, *told)

    def make(self, scene: Scene) -> Engine:
        """The same scene is asked for more than once in a row."""
        key = repr(scene)
        if key not in self._made:
            self._made.clear()
            self._made[key] = imaging_engine(
                scene, self.settings, runs=2 * self.settings.iterations, light=self._behind.on(scene)
            )
        return self._made[key]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters of the light, which an object that is complex itself takes on; none of an amplitude."""
        if self.settings.kind == "amplitude":
            return ()
        sought = {p.name for p in self.parameters()}
        light = self.parameters("all", light_order=LIGHT_ORDER)
        return tuple(p.name for p in light if p.part == "light" and p.name not in sought)

    def parameters(self, text: str | None = None, light_order: int | None = None) -> tuple[Parameter, ...]:
        """Those that are asked for, of all that may be sought."""
        patch, asked = self.framed.patch, text or self.settings.parameters
        side_mm = patch.grid.shape[0] * patch.grid.pitch_mm
        if light_order is None:
            light_order = LIGHT_ORDER if self.settings.kind == "amplitude" else 0
        allowed = bench_parameters(
            self.lens, len(self.framed.planes_mm), side_mm, patch.wavelength_um, light_order=light_order
        )
        try:
            chosen = chosen_parameters(asked, allowed)
        except InputError as error:
            hint = "; beside a complex object no light is sought: {kind} amplitude" * (not light_order)
            raise SettingError(f"{{parameters}} = {asked!r}: {error}{hint}") from None
        return with_priors(chosen, self.priors, all_names(self.lens))


def searched(
    seen: Seen,
    parameters: tuple[Parameter, ...],
    begin: Unknowns,
    kept_in: Path | None,
    tell: Progress,
    known: NDArray[Any] | None = None,
) -> Calibrated:
    """What frames tell of a bench, of an object that is known, or together with it.

    Parameters
    ----------
    seen
        The frames.
    parameters
        What is sought.
    begin
        Where the search begins, and what holds for the rest.
    kept_in
        File that keeps what was tried.
    tell
        Told how far it is.
    known
        Transmission of the object where it is known.

    Raises
    ------
    InputError
        What the model raises where the search begins.
    MemoryLimitError
        If what the parameters do to all pixels takes more memory than is free.
    KeyboardInterrupt
        Saying what is kept.
    """
    settings, light = seen.settings, seen.framed.light
    _refuse_too_large(len(parameters), seen)
    told = settings.model_dump_json(exclude=NOT_TELLING)
    key = key_of_frames(seen.lens, seen.framed.frames, light, told, repr((dict(begin.values), parameters)))
    run = _Run(
        begin,
        tuple(p.name for p in parameters),
        None if kept_in is None else Checkpoint(kept_in, key),
    )
    what = "the frames as designed" if known is None else "the frames without an object"
    tell(what, 0, settings.most_mountings)
    noise = noise_misfit(seen.pixels.recorded)
    search = JointSearch(
        seen.pixels,
        settings.kind,
        parameters,
        settings.iterations,
        settings.most_mountings,
        noise,
        known,
        lambda number, _, misfit: tell(_misfit_told(misfit, noise), number, settings.most_mountings),
        run.keep,
    )
    try:
        with one_blas_thread():
            found = search.run(run.begun())
    except KeyboardInterrupt:
        told = "the same command goes on from there" if run.kept and kept_in else "nothing was written"
        raise KeyboardInterrupt(f"interrupted after {run.kept} mountings; {told}") from None
    return Calibrated(
        bench=found.unknowns.bench,
        parameters=run.names,
        values=tuple(found.estimates.tolist()),
        deviations=tuple(found.deviations.tolist()),
        typical=tuple(p.typical for p in parameters),
        misfit_before=found.trail[0][1],
        misfit=found.misfit,
        trail=tuple((tuple(u.of(run.names).tolist()), misfit) for u, misfit in found.trail),
        at_reach=(),
        stopped_because=found.stopped_because,
        misfit_of_noise=noise,
        covariance=found.covariance,
        traded=traded(run.names, found.covariance),
        nominal=tuple(name for name, is_needed in zip(run.names, found.needed, strict=True) if not is_needed),
        undetermined=seen.undetermined if known is None else (),
        applied=dict(zip(run.names, found.unknowns.of(run.names).tolist(), strict=True)),
    )


def _refuse_too_large(count: int, seen: Seen) -> None:
    """Refuse what memory does not hold: the change of each pixel with each parameter, `HELD` times over."""
    pixels = sum(plane.amplitude.size for plane in seen.pixels.recorded)
    needed, free = HELD * count * pixels * np.dtype(np.float32).itemsize, memory_limit(None)
    if needed > free:
        raise MemoryLimitError(
            f"to seek {count} parameters in {pixels} pixels takes {1e-9 * needed:.3g} GB, and "
            f"{1e-9 * free:.3g} GB are allowed: seek fewer of them (parameters), or in a smaller window of "
            "the frames"
        )


def _misfit_told(misfit: float, noise: float | None) -> str:
    return f"misfit {misfit:.4f}" if noise is None else f"misfit {misfit / noise:.2f} times the noise"


class _Run:
    """What a search has come to, and its file."""

    def __init__(self, start: Unknowns, names: tuple[str, ...], checkpoint: Checkpoint | None) -> None:
        self._start, self.names, self._checkpoint = start, names, checkpoint
        self.kept = 0

    def begun(self) -> SearchState:
        """Where an earlier run was cut off, or the start."""
        kept = None if self._checkpoint is None else self._checkpoint.load()
        if kept is None:
            return SearchState(self._start)
        self.kept = len(kept["misfits"])
        rows = zip(kept["values"].tolist(), kept["misfits"].tolist(), strict=True)
        trail = tuple((self._start.changed(self.names, values), misfit) for values, misfit in rows)
        here = self._start.changed(self.names, kept["here"].tolist())
        return SearchState(here, int(kept["stage"]), float(kept["stretch"]), trail)

    def keep(self, stand: SearchState) -> None:
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
