"""A calibration from frames: its statement, and the resumable search among all parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from wavesim.calibration.calibration_result import Calibrated, correlated_parameters
from wavesim.calibration.joint.pixels import (
    CalibrationPixels,
    DensePixels,
    SparsePixels,
    padded_to_fast_shape,
    pixel_spacing,
    sparse_pixels,
)
from wavesim.calibration.joint.search import JointSearch, SearchState, StagePoint, StoredFit
from wavesim.calibration.parameters import (
    LIGHT_ORDER,
    Nonlinearity,
    Parameter,
    Unknowns,
    Vibration,
    bench_parameters,
    chosen_parameters,
    field_stop_parameters,
    parameters_by_name,
    with_priors,
)
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.registry import AUTO
from wavesim.reconstruction.problem import key_of_frames, light_of_frames, patch_of_frames
from wavesim.reconstruction.source_search import modes_on, stated_source
from wavesim.runtime.checkpoint import Checkpoint
from wavesim.runtime.memory import COMPLEX64, FLOAT32, MemoryLimitError, memory_limit
from wavesim.runtime.threads import one_blas_thread
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import CalibrationSettings, SettingError
from wavesim.scene.source import POINT
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.measurement import noise_misfit
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import exit_scene, imaging_engine

IGNORED_SETTINGS = {
    "patch_mm",
    "field_stop_mm",
    "field_stop_at_mm",
    "field_stop",
    "object_pitch_um",
    "illumination",
    "source_distance_mm",
    "speckle_na",
    "speckle_seed",
    "most_mountings",
    "source_deg",
    "bandwidth_nm",
    "verdict",
    "deviations",
}
"""Settings that do not affect a search, or that affect it only through the light or its source."""


class CalibrationProblem:
    """Frames, settings, and the engines of a calibration.

    Parameters
    ----------
    lens
        The nominal lens.
    frames
        Frames of one or more planes.
    settings
        Settings of the calibration. Engine "auto" means eikonal tiles here.
    priors
        Expected standard deviations by parameter, where they differ from the usual ones.
    seeks_stop
        Whether the position of the field stop is sought, too.

    Attributes
    ----------
    pixels : CalibrationPixels
        Pixels that the search uses.
    scene : Scene
        Nominal scene to the pixels of the nearest plane.
    recorded : tuple of Measurement
        Measured planes.
    start : SystemState
        Nominal mounting, and the stated source of the light.
    """

    def __init__(
        self,
        lens: Lens,
        frames: Sequence[Frame],
        settings: CalibrationSettings,
        priors: Mapping[str, float] | None = None,
        seeks_stop: bool = False,
    ) -> None:
        if settings.engine == AUTO:  # only its rays have derivatives that cost little
            settings = settings.replaced(engine=FlatTiles.name)
        self.lens, self.settings, self.priors = lens, settings, priors or {}
        self.seeks_stop = seeks_stop
        self.framed = framed = patch_of_frames(lens, frames, settings)
        self.recorded = tuple(recorded_planes(frames, with_fractions=True))
        self.scene = exit_scene(lens, framed.patch, framed.sensor, framed.planes_mm[0])
        source = stated_source(settings)
        self.start = SystemState(Pose(pivot_z_mm=settings.pivot_z_mm), source=source)
        self._light = light_of_frames(self.scene, framed.frames, framed.light)
        self._engines: dict[str, Engine] = {}
        light = framed.light.with_values(framed.light.values.astype(np.complex64))
        pixel_settings = settings.scale, settings.fill_factor, self.make
        sparse, spacing = None, pixel_spacing(framed.patch, self.scene)
        if spacing > 1 and settings.engine == FlatTiles.name and source == POINT:
            dense = DensePixels(self.scene, light, self.recorded, *pixel_settings)
            sparse = sparse_pixels(dense, framed.frames, spacing)
        scene, recorded = padded_to_fast_shape(self.scene, self.recorded)
        self.pixels: CalibrationPixels = sparse or DensePixels(scene, light, recorded, *pixel_settings)

    def make(self, scene: Scene) -> Engine:
        """Return the engine of a scene; the last one is stored, because scenes are often requested twice in
        a row.
        """
        key = repr(scene)
        if key not in self._engines:
            self._engines.clear()
            self._engines[key] = imaging_engine(
                scene, self.settings, runs=2 * self.settings.iterations, light=self._light.on(scene)
            )
        return self._engines[key]

    @property
    def absorbed(self) -> tuple[Parameter, ...]:
        """Parameters of the light that a complex object can imitate; none for an amplitude object."""
        if self.settings.kind == "amplitude":
            return ()
        sought, light = self.parameters(), self.parameters("all", light_order=LIGHT_ORDER)
        return tuple(p for p in light if p.group == "light" and p not in sought)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the parameters of the light that a complex object can imitate."""
        return tuple(p.name for p in self.absorbed)

    def parameters(self, text: str | None = None, light_order: int | None = None) -> tuple[Parameter, ...]:
        """Return the requested parameters with their priors.

        Parameters
        ----------
        text
            Names or groups; default: those of the settings.
        light_order
            Highest sum of orders of the light's modes; default: by the kind of object.

        Raises
        ------
        SettingError
            If a name is unknown, or not possible with this kind of object.
        """
        patch, requested = self.framed.patch, text or self.settings.parameters
        side_mm = patch.grid.shape[0] * patch.grid.pitch_mm
        if light_order is None:
            light_order = LIGHT_ORDER if self.settings.kind == "amplitude" else 0
        allowed = bench_parameters(
            self.lens, len(self.framed.planes_mm), side_mm, patch.wavelength_um, light_order=light_order
        )
        if isinstance(self.pixels, SparsePixels):  # points that are not blurred, fitted to many pixels each
            allowed = tuple(p for p in allowed if not isinstance(p, Vibration | Nonlinearity))
        try:
            chosen = chosen_parameters(requested, allowed)
        except InputError as error:
            hint = (
                f"; the light of a {self.settings.kind} object is not calibrated: use {{kind}} amplitude"
                * (not light_order)
            )
            raise SettingError(f"{{parameters}} = {requested!r}: {error}{hint}") from None
        if self.seeks_stop:
            chosen += field_stop_parameters(side_mm)
        return with_priors(chosen, self.priors, parameters_by_name(self.lens))


def search_bench(
    problem: CalibrationProblem,
    parameters: tuple[Parameter, ...],
    start: Unknowns,
    checkpoint_path: Path | None,
    progress: Progress,
    known: NDArray[Any] | None = None,
    absorbed: tuple[Parameter, ...] | None = None,
    what: str = "bench",
) -> Calibrated:
    """Search for the parameters of a bench, with a known object or together with the object.

    Parameters
    ----------
    problem
        Statement of the calibration.
    parameters
        Parameters that are sought.
    start
        Start of the search, with values of all other parameters.
    checkpoint_path
        File of the search's state; None disables it.
    progress
        Callback `progress(stage, completed, total)`.
    known
        Transmission of the object where it is known.
    absorbed
        Parameters of the light that are not sought, with their standard deviations, which a complex object
        takes over; default: those of the problem, with the expected ones.
    what
        What is sought, in messages of progress.

    Raises
    ------
    InputError
        If the model raises it at the start of the search.
    MemoryLimitError
        If the derivatives of all pixels need more memory than is available.
    KeyboardInterrupt
        If the search is interrupted; the message says what was saved.
    """
    settings, light = problem.settings, problem.framed.light
    if absorbed is None:
        absorbed = problem.absorbed if known is None else ()
    _check_memory(len(parameters), len(modes_on(light, start.fixed.source)), problem, known is None)
    settings_json = settings.model_dump_json(exclude=IGNORED_SETTINGS)
    values = {parameter.name: value for parameter, value in start.values.items()}
    search_text = f"({values!r}, {[(p.name, p.group, p.typical, p.usual) for p in parameters]!r})"
    if start.fixed.source != POINT:
        search_text += repr(start.fixed.source)
    key = key_of_frames(problem.lens, problem.framed.frames, light, settings_json, search_text)
    run = _SearchRecord(
        start,
        parameters,
        None if checkpoint_path is None else Checkpoint(checkpoint_path, key),
    )
    progress(f"{what}: as designed", 0, _expected_benches(0, settings.most_mountings))
    noise = noise_misfit(problem.pixels.recorded)

    def on_bench(number: int, _: Unknowns, misfit: float) -> None:
        expected = _expected_benches(number, settings.most_mountings)
        progress(f"{what}: {_misfit_text(misfit, noise)}", number, expected)

    search = JointSearch(
        problem.pixels,
        settings.kind,
        parameters,
        settings.iterations,
        settings.most_mountings,
        noise,
        known,
        on_bench,
        run.save,
        lambda stage, completed, total: progress(f"{what}: {stage}", completed, total),
        absorbed,
        has_deviations=settings.deviations,
    )
    try:
        with one_blas_thread():
            found = search.run(run.initial_state())
    except KeyboardInterrupt:
        outcome = (
            "run the same command again to continue"
            if run.saved and checkpoint_path
            else "nothing was written"
        )
        raise KeyboardInterrupt(f"interrupted after {run.saved} mountings; {outcome}") from None
    names = [parameter.name for parameter in parameters]
    return Calibrated(
        state=found.unknowns.state,
        sought=parameters,
        values=tuple(found.estimates.tolist()),
        deviations=None if found.deviations is None else tuple(found.deviations.tolist()),
        typical=tuple(p.typical for p in parameters),
        misfit_before=found.trail[0][1],
        misfit=found.misfit,
        trail=tuple((tuple(u.of(parameters).tolist()), misfit) for u, misfit in found.trail),
        stopped_because=found.stopped_because,
        misfit_of_noise=noise,
        covariance=found.covariance,
        correlated_with=({} if found.covariance is None else correlated_parameters(names, found.covariance)),
        nominal=tuple(name for name, is_needed in zip(names, found.needed, strict=True) if not is_needed),
        undetermined=problem.undetermined if known is None else (),
        applied=dict(zip(names, found.unknowns.of(parameters).tolist(), strict=True)),
        object_uncertainty=found.object_uncertainty,
    )


def _check_memory(count: int, modes: int, problem: CalibrationProblem, object_is_free: bool) -> None:
    """Check that the derivatives of all pixels, and the fields of all modes of the light, fit in memory."""
    pixels = sum(plane.amplitude.size for plane in problem.pixels.recorded)
    # Arrays of the size of all pixels per parameter that exist at the end of a search, and those of each
    # further mode: its rows and samples on the planes, six complex arrays.
    arrays_per_parameter, arrays_per_mode = 6, 12
    if modes > 1:  # the sums over the modes
        arrays_per_parameter += 1
    # Changes of the object per parameter that exist while it is eliminated.
    changes_per_parameter = 4 if object_is_free else 0
    sample_bytes = FLOAT32 if problem.settings.kind == "amplitude" else COMPLEX64
    arrays = arrays_per_parameter * count + arrays_per_mode * (modes - 1)
    needed_bytes = FLOAT32 * arrays * pixels
    needed_bytes += sample_bytes * changes_per_parameter * count * problem.framed.patch.grid.size
    free_bytes = memory_limit(None)
    if needed_bytes > free_bytes:
        in_modes = f" in light of {modes} modes" if modes > 1 else ""
        raise MemoryLimitError(
            f"a search for {count} parameters in {pixels} pixels{in_modes} needs {1e-9 * needed_bytes:.3g} "
            f"GB, and {1e-9 * free_bytes:.3g} GB are allowed: seek fewer parameters, or use a smaller "
            "window of the frames"
        )


def _expected_benches(tried: int, most: int) -> int:
    """Return how many benches a search will probably have tried at its end; most try 4 to 14."""
    usual, fewest_more = 12, 2
    return min(max(usual, tried + fewest_more), most)


def _misfit_text(misfit: float, noise: float | None) -> str:
    return f"misfit {misfit:.4f}" if noise is None else f"misfit {misfit / noise:.2f} times the noise"


class _SearchRecord:
    """The state of a search, and its checkpoint."""

    def __init__(
        self, start: Unknowns, parameters: tuple[Parameter, ...], checkpoint: Checkpoint | None
    ) -> None:
        self._start, self._parameters, self._checkpoint = start, parameters, checkpoint
        self.saved = 0

    def initial_state(self) -> SearchState:
        """Return the state of an interrupted search, or the start."""
        saved = None if self._checkpoint is None else self._checkpoint.load()
        if saved is None:
            return SearchState(self._start)
        self.saved = len(saved["misfits"])
        rows = zip(saved["values"].tolist(), saved["misfits"].tolist(), strict=True)
        trail = tuple((self._start.changed(self._parameters, values), misfit) for values, misfit in rows)
        current, slopes = (self._fit(saved, name) for name in ("current", "slopes"))
        point = StagePoint(
            self._start.changed(self._parameters, saved["reference"].tolist()),
            current,
            slopes,
            tuple(saved["sought"].tolist()),
            bool(saved["is_repeated"]),
            str(saved["ended_because"]),
        )
        return SearchState(
            current.unknowns,
            int(saved["stage"]),
            float(saved["stretch"]),
            trail,
            int(saved["iterations"]),
            float(saved["scale_without_limit"]),
            point,
        )

    def _fit(self, saved: Mapping[str, Any], name: str) -> StoredFit:
        """Return the current bench with its object, or that of the derivatives."""
        return StoredFit(
            self._start.changed(self._parameters, saved[f"{name}_values"].tolist()),
            saved[f"{name}_transmission"],
            tuple(saved[f"{name}_curve"].tolist()),
            float(saved[f"{name}_upper_bound"]),
            float(saved[f"{name}_scale"]),
        )

    def save(self, state: SearchState) -> None:
        """Save the state after a step."""
        self.saved = len(state.trail)
        if self._checkpoint is None or state.point is None:
            return
        point, fits = state.point, dict[str, Any]()
        for name, fit in (("current", point.current), ("slopes", point.slopes)):
            fits |= {f"{name}_values": fit.unknowns.of(self._parameters)}
            fits |= {f"{name}_{part}": value for part, value in fit._asdict().items() if part != "unknowns"}
        self._checkpoint.keep(
            reference=point.reference.of(self._parameters),
            sought=point.sought,
            is_repeated=point.is_repeated,
            ended_because=point.ended_because,
            **fits,
            values=[unknowns.of(self._parameters) for unknowns, _ in state.trail],
            misfits=[misfit for _, misfit in state.trail],
            stage=state.stage,
            stretch=state.stretch,
            iterations=state.iterations,
            scale_without_limit=state.scale_without_limit,
        )
