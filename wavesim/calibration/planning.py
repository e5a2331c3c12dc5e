"""Recommend the number, positions and exposure times of the recording planes, before frames are recorded.

Each plan is simulated. Objects of the kind are imaged through the lens by a sensor with noise, and
reconstructed as by :func:`wavesim.reconstruct_frames`. Planes are spread evenly; plans with one exposure are
compared with plans with several. A large lens or patch is replaced by a smaller twin (:class:`Twin`).

The correlation depends on the object. Noise leaves an error of nearly the same size whatever the object is,
and the correlation compares this error with the light that the object changes. A thin phase object changes
little light. Most of its error is smooth phase, which the planes hardly determine: iterations reach the
noise before smooth phase has converged. Each plan is therefore tried with several objects
(:data:`TRIAL_OBJECTS`), and the prediction is the range of their correlations.

Where the user describes the object by an example, the prediction is a single value. The example is tried like
the other objects, on a larger twin and with two draws of the noise. A twin whose patch is smaller images the
middle of the example, in which details have their own size. The middle may change more or less of the light
than the whole example, and the error is scaled by the ratio of both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.metrics.result_quality import truth_metrics
from wavesim.metrics.similarity import LEAST_SAMPLES
from wavesim.reconstruction.diagnostics.held_out import hold_out
from wavesim.reconstruction.growing_aperture import with_growing_aperture
from wavesim.reconstruction.information import Information, WhitenedJacobian, information_of
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.reconstruction.oversampling import measured_oversampling
from wavesim.runtime.result import Result
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import ITERATIONS, Kind, PatchSettings, PlanSettings, SettingError
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image
from wavesim.sensor.measurement import Measurement, noise_misfit
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import TILE_ERROR, diversity, exit_scene, footprint_mm
from wavesim.targets.patch import Patch, lit, make_target, object_patch

MOST_PIXELS, MOST_SAMPLES = 144, 192
"""Largest number of pixels across the light on the farthest plane, and of object samples along a side, of a
twin.
"""

MOST_EXAMPLE_PIXELS = 220
"""Largest number of pixels across the light for the described object: a larger twin images more of it."""

EXAMPLE = "described"
"""Name of the user's example among the objects of a plan."""

EXAMPLE_SAMPLES = 1024
"""Largest number of samples along a side of an example."""

DRAWS = 2
"""Draws of the noise with which an example is tried."""

EXPLAINED = 1.2
"""Misfit over that of the noise up to which an object explains the frames of a plan."""

SMOOTH_CYCLES = 4.0
"""Errors with fewer cycles than this across the patch count as smooth."""


class _Random(NamedTuple):
    """Random patterns on a patch, normalized by the samples inside the field stop."""

    generator: np.random.Generator
    inside: NDArray[np.bool_]

    def smooth(self, detail: float) -> NDArray[np.float64]:
        """Return noise of mean 0 and standard deviation 1, smoothed by a Gaussian of `detail` samples."""
        values = gaussian_filter(self.generator.standard_normal(self.inside.shape), detail)
        inside_values = values[self.inside]
        return np.asarray((values - inside_values.mean()) / inside_values.std())

    def grains(self, detail: float, fraction: float) -> NDArray[np.bool_]:
        """Return grains that cover a fraction of the samples."""
        values = self.smooth(detail)
        return np.asarray(values > np.quantile(values[self.inside], 1.0 - fraction))


class TrialObject(NamedTuple):
    """A random object with which plans are tried.

    Attributes
    ----------
    kind : str
        "complex", "amplitude" or "phase". Phase objects also try plans for complex objects.
    description : str
        Description for the user.
    transmission : callable
        Returns the transmission from random patterns.
    """

    kind: Kind
    description: str
    transmission: Callable[[_Random], NDArray[Any]]


def _dense(random: _Random) -> NDArray[Any]:
    modulus = 0.3 + 0.7 / (1.0 + np.exp(-2.0 * random.smooth(3.0)))
    return np.asarray(modulus * np.exp(1.2j * random.smooth(3.0)))


TRIAL_OBJECTS = {
    "grains": TrialObject(
        "amplitude",
        "dark grains on 16 % of the patch",
        lambda random: np.where(random.grains(3.0, 0.16), 0.1, 1.0),
    ),
    "fine grains": TrialObject(
        "amplitude",
        "dark grains as fine as the samples on 30 %",
        lambda random: np.where(random.grains(1.0, 0.3), 0.1, 1.0),
    ),
    "few grains": TrialObject(
        "amplitude",
        "dark grains on 3 %",
        lambda random: np.where(random.grains(3.0, 0.03), 0.1, 1.0),
    ),
    "dense": TrialObject("complex", "absorption, and phase of 1.2 rad rms", _dense),
    "thin": TrialObject(
        "phase",
        "smooth phase of 0.2 rad rms",
        lambda random: np.exp(0.2j * random.smooth(6.0)),
    ),
    "steps": TrialObject(
        "phase",
        "phase steps of 1 rad on 5 %",
        lambda random: np.exp(1j * random.grains(4.0, 0.05)),
    ),
}
"""Objects with which plans are tried, by name. Some change much of the light, others change little."""


class Twin(NamedTuple):
    """Smaller lens and patch that are simulated in place of the real ones.

    The patch shrinks with the square root of the lens's scale, so that the planes keep their diversity,
    unless the twin's field or `MOST_SAMPLES` are too small. Read noise grows as the patch shrinks, so that
    its total over all pixels has the same ratio to the light.

    Attributes
    ----------
    scale : float
        Size of the twin over that of the lens.
    patch_mm : float
        Side of the twin's patch in mm.
    read_noise_electrons : float
        Read noise of the twin in electrons.
    diversity : float
        Diversity of the twin's planes.
    """

    scale: float
    patch_mm: float
    read_noise_electrons: float
    diversity: float


@dataclass(frozen=True)
class Plan:
    """Frames that might be taken, and the predicted quality of a reconstruction.

    Attributes
    ----------
    planes_mm : tuple of float
        Distances of the planes from the exit vertex of the lens in mm.
    exposures : tuple of float
        Exposure times of each plane; 1 gives the peak fill of the brightest pixel.
    correlation : float
        Lowest correlation between the reconstructed and the true object
        (:func:`wavesim.metrics.contrast.object_correlation`), of all trial objects, without the described
        one.
    misfit_over_noise : float
        Misfit of the frames over that of their noise, for the object that is explained worst. A value far
        above 1 means that the object was not found.
    iterations : int
        Iterations of the longest reconstruction.
    by_object : dict
        Correlation of each trial object by name.
    smooth_fraction : float
        Fraction of the squared error with less than `SMOOTH_CYCLES` cycles across the patch, for the object
        with the lowest correlation.
    predicted : float
        Predicted correlation of the described object; NaN without a description.
    misfit_of_example : float
        Misfit over that of the noise for the described object.
    ratio : float
        Oversampling ratio: pixels in the light for each real unknown of the object, on the twin's frames of
        the object for which the ratio is lowest
        (:func:`wavesim.reconstruction.oversampling.measured_oversampling`).
    information : Information or None
        Information about the described object, or else about the first trial object, against the noise
        (:mod:`wavesim.reconstruction.information`).
    """

    planes_mm: tuple[float, ...]
    exposures: tuple[float, ...]
    correlation: float
    misfit_over_noise: float
    iterations: int
    by_object: Mapping[str, float] = field(default_factory=dict)
    smooth_fraction: float = math.nan
    predicted: float = math.nan
    misfit_of_example: float = math.nan
    ratio: float = math.nan
    information: Information | None = None

    @property
    def expected(self) -> float:
        """Predicted correlation of the described object, or else the lowest one of all trial objects."""
        return self.predicted if math.isfinite(self.predicted) else self.correlation

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.planes_mm) * len(self.exposures)

    @property
    def highest_correlation(self) -> float:
        """Highest correlation of all trial objects."""
        return max([self.correlation, *self.by_object.values()])

    @property
    def error(self) -> float:
        """Largest relative error of the light that the object changes: sqrt(1 - correlation^2)."""
        return math.sqrt(max(1.0 - self.correlation**2, 0.0))


@dataclass(frozen=True, repr=False)
class Plans(Result):
    """Comparison of plans.

    Attributes
    ----------
    settings : PlanSettings
        Settings of the comparison.
    twin : Twin
        Twin that was simulated.
    diversity : float
        Diversity of the outermost planes of the lens itself.
    plans : tuple of Plan
        Plans, sorted by their number of frames.
    strengths : dict
        For each trial object, the rms fraction of the transmitted amplitude that it changes.
    engine_error : float
        Upper bound of the engine's relative error on the nearest plane. It is not part of the prediction,
        since the same engine makes the frames and reconstructs.
    example : str
        Name of the described object; empty without a description.
    example_strength : float
        Rms fraction of the amplitude that the whole described object changes; NaN without a description.
    example_twin : Twin or None
        Twin that was simulated for the described object; None without a description.
    """

    heading = "Frames to take"

    settings: PlanSettings
    twin: Twin
    diversity: float
    plans: tuple[Plan, ...]
    strengths: Mapping[str, float] = field(default_factory=dict)
    engine_error: float = math.nan
    example: str = ""
    example_strength: float = math.nan
    example_twin: Twin | None = None

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the predictions, as sentences."""
        chosen, best = self.settings, self.recommended
        objects = "; ".join(
            f"{name} ({TRIAL_OBJECTS[name].description}, changes {strength:.2g} of the light's amplitude)"
            for name, strength in self.strengths.items()
            if name in TRIAL_OBJECTS
        )
        of = "the described object" if self.example else f"object {next(iter(self.strengths))!r}"
        lines = [
            f"Objects of kind {chosen.kind}: {objects}. A weaker object has a lower correlation.",
            *self._about_example(),
            f"Sensor: full well {chosen.full_well_electrons:g} electrons, read noise "
            f"{chosen.read_noise_electrons:g} electrons, {chosen.bits} bits; one draw of the noise. "
            "Where the correlation is below 0.9, another draw may change it by 0.03.",
            "Bench: planes, mounting, light and sensor are exactly as designed; the light is coherent.",
            f"Engine: the same one makes the frames and reconstructs. Its own error (at most "
            f"{self.engine_error:.2g}) is not included.",
            f"Reconstruction: at most {ITERATIONS['object']} iterations, which end at the noise.",
            "Pixels for each unknown: those with more light than noise, on the twin's frames of the object "
            f"with the fewest. Determined: fraction of the unknowns of {of} that noise leaves determined "
            "near the true object, without other knowledge of it.",
        ]
        if self.twin.scale < 1.0:
            # Fraction of the lens's diversity above which that of a twin counts as the same.
            same_diversity = 0.9
            lines.append(
                f"Twin: {self.twin.scale:.3g} of the lens, patch of {self.twin.patch_mm:.3g} mm, read noise "
                f"of {self.twin.read_noise_electrons:.3g} electrons. Its planes have a diversity of "
                f"{self.twin.diversity:.3g}, those of the lens {self.diversity:.3g}"
                + (
                    ": objects that change much of the light converge more slowly on the lens."
                    if self.twin.diversity < same_diversity * self.diversity
                    else "."
                )
            )
        if chosen.kind != "amplitude" and math.isfinite(best.smooth_fraction):
            lines.append(
                f"Smooth phase (less than {SMOOTH_CYCLES:g} cycles across the patch) is hardly determined by "
                f"the planes: it is {100.0 * best.smooth_fraction:.0f} % of the squared error of the worst "
                "object of the recommended plan."
            )
        return tuple(lines)

    def _about_example(self) -> tuple[str, ...]:
        """Return a sentence about the described object, if there is one."""
        if not self.example:
            return ()
        tried, whole, twin = self.strengths[EXAMPLE], self.example_strength, self.example_twin
        size = "" if twin is None or self.twin.scale == 1.0 else f" ({twin.scale:.3g} of the lens)"
        return (
            f"Described object: {self.example}, changes {whole:.2g} of the light's amplitude; its twin{size} "
            f"images a part that changes {tried:.2g}. {DRAWS} draws of the noise.",
        )

    @property
    def enough(self) -> bool:
        """True if a plan reaches the requested correlation."""
        return self.recommended.expected >= self.settings.correlation

    @property
    def at_noise(self) -> bool:
        """True if the frames of the recommended plan are explained up to their noise."""
        best = self.recommended
        return (best.misfit_of_example if self.example else best.misfit_over_noise) <= EXPLAINED

    @property
    def recommended(self) -> Plan:
        """Plan with the fewest frames that reaches the requested correlation, or the best one if none does.

        The described object decides, or else the trial object with the lowest correlation.
        """
        reaching = [plan for plan in self.plans if plan.expected >= self.settings.correlation]
        return reaching[0] if reaching else max(self.plans, key=lambda plan: plan.expected)

    def table(self) -> list[tuple[str, str]]:
        best = self.recommended
        planes = ", ".join(f"{z:.4g}" for z in best.planes_mm)
        expected = f"{best.correlation:.4f} to {best.highest_correlation:.4f}"
        if self.example:
            expected = f"{best.predicted:.4f} for {self.example}"
        return [
            ("plans", f"{len(self.plans)}, for an object of kind {self.settings.kind}"),
            ("planes", f"{planes} mm, exposures {', '.join(f'{e:g}' for e in best.exposures)}"),
            (
                "correlation",
                f"{expected}{'' if self.enough else ', below the requested correlation'}",
            ),
        ]


def plan_frames(
    lens: Lens,
    settings: PlanSettings | None = None,
    *,
    example: str | Field | None = None,
    candidates: Sequence[tuple[tuple[float, ...], tuple[float, ...]]] = (),
    progress: Progress | None = None,
    **changes: Any,
) -> Plans:
    """Predict the quality of reconstructions from different numbers of planes and exposures.

    Parameters
    ----------
    lens
        The nominal lens.
    settings
        All settings; default: `PlanSettings()`.
    example
        An example of the objects that will be imaged: the name of a built-in object or the path of a picture,
        as :func:`wavesim.image` accepts them, or a transmission with the samples of the patch. Each plan then
        has a predicted correlation of its own for it.
    candidates
        Planes in mm and exposures of each plan. Default: one plane to `most_planes`, evenly spaced, with the
        first of `exposures` and with all of them.
    progress
        Callback `progress(stage, completed, total)` with the number of plans.
    **changes
        Settings by name, which replace those of `settings`.

    Returns
    -------
    Plans
        All plans, and the recommended one.

    Raises
    ------
    InputError, SamplingError
        If a value is invalid.
    """
    settings = (settings or PlanSettings()).replaced(**changes)
    validate_lengths(lens, settings)
    near, far = _range(lens, settings)
    patch_mm = lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm
    patch = object_patch(lens, patch_mm, wavelength_um=settings.wavelength_um)
    small = _small_bench(lens, patch, settings, far)
    exposure_sets = dict.fromkeys([settings.exposures[:1], settings.exposures])
    candidates = list(candidates) or [
        (tuple(float(z) for z in np.linspace(near, far, count)), exposures)
        for count in range(1, settings.most_planes + 1)
        for exposures in exposure_sets
    ]
    candidates.sort(key=lambda plan: (len(plan[0]) * len(plan[1]), len(plan[0])))
    targets = {name: (small, target) for name, target in random_objects(small.patch, settings).items()}
    whole = None if example is None else _example(lens, patch, example, settings)
    strength = math.nan
    if whole is not None:
        larger = _small_bench(lens, patch, settings, far, MOST_EXAMPLE_PIXELS)
        targets[EXAMPLE] = larger, _middle(whole, larger.patch)
        stop_mm = min(patch.field_stop_mm, min(whole.grid.shape) * whole.grid.pitch_mm)
        strength = _strength(whole.values[replace(patch, grid=whole.grid, field_stop_mm=stop_mm).inside])
        if strength == 0.0:
            raise InputError("example: changes no light; the correlation of such an object is not defined")
    plans = _predicted_plans(
        targets, settings, small.twin, candidates, diversity(lens, patch, (near, far)), progress
    )
    if whole is None:
        return plans
    return replace(
        plans,
        plans=tuple(_of_strength(plan, plans.strengths[EXAMPLE] / strength) for plan in plans.plans),
        example=example if isinstance(example, str) else "the given transmission",
        example_strength=strength,
        example_twin=targets[EXAMPLE][0].twin,
    )


def _example(lens: Lens, patch: Patch, example: str | Field, settings: PlanSettings) -> Field:
    """Return the transmission of an example on a patch of the lens, of `EXAMPLE_SAMPLES` at most."""
    if isinstance(example, Field):
        if example.grid.shape != patch.grid.shape or not math.isclose(
            example.grid.pitch_mm, patch.grid.pitch_mm, rel_tol=1e-6
        ):
            raise InputError(f"example: its grid {example.grid} is not the patch's {patch.grid}")
        return example
    widest_mm = EXAMPLE_SAMPLES * patch.grid.pitch_mm
    if patch.field_stop_mm > widest_mm:
        patch = object_patch(lens, widest_mm, wavelength_um=settings.wavelength_um)
    aperture = lens.object.numerical_aperture
    return make_target(patch, example, numerical_aperture=aperture, seed=settings.seed).transmission


def _middle(field: Field, patch: Patch) -> Field:
    """Return the middle samples of a field on the grid of a patch with the same pitch."""
    (rows, columns), (height, width) = field.grid.shape, patch.grid.shape
    top, left = (rows - height) // 2, (columns - width) // 2
    return Field(
        patch.grid, field.values[top : top + height, left : left + width].copy(), patch.wavelength_um
    )


def _of_strength(plan: Plan, factor: float) -> Plan:
    """Return a plan whose error of the described object is multiplied by a factor.

    An error by noise is of equal size for a weaker object, and its fraction of the changed light is larger.
    An object that is not found keeps its correlation.
    """
    if plan.misfit_of_example > EXPLAINED:
        return plan
    error = min(factor * math.sqrt(max(1.0 - plan.predicted**2, 0.0)), 1.0)
    return replace(plan, predicted=math.sqrt(1.0 - error**2))


def _predicted_plans(
    targets: Mapping[str, tuple[_SmallBench, Field]],
    settings: PlanSettings,
    twin: Twin,
    candidates: Sequence[tuple[tuple[float, ...], tuple[float, ...]]],
    diversity_of_planes: float,
    progress: Progress | None = None,
) -> Plans:
    """Simulate plans on twins.

    Parameters
    ----------
    targets
        Trial objects by name, each with its bench; the described object has the name `EXAMPLE`.
    settings, twin
        See :class:`Plans`.
    candidates
        Planes in mm (of the original lens) and exposures of each plan.
    diversity_of_planes
        Diversity of the original lens's planes.
    progress
        See :func:`plan_frames`.
    """
    progress = progress or (lambda what, done, count: None)
    progress("frames of all plans", 0, len(candidates))
    planes = sorted({z for planes, _ in candidates for z in planes})
    trials = {
        name: [
            trial_of(bench.lens, target, settings.replaced(seed=settings.seed + draw), bench.twin, planes)
            for draw in range(DRAWS if name == EXAMPLE else 1)
        ]
        for name, (bench, target) in targets.items()
    }
    plans = []
    for index, (planes_mm, exposures) in enumerate(candidates):
        progress(f"{len(planes_mm)} planes, {len(exposures)} exposures", index, len(candidates))
        plans.append(_plan(planes_mm, exposures, trials, settings.kind))
    progress("planned", len(candidates), len(candidates))
    strengths = {name: _strength(draws[0].target.values[draws[0].inside]) for name, draws in trials.items()}
    engine_error = max(trial.engine_error for draws in trials.values() for trial in draws)
    return Plans(settings, twin, diversity_of_planes, tuple(plans), strengths, engine_error)


def _plan(
    planes_mm: tuple[float, ...],
    exposures: tuple[float, ...],
    trials: Mapping[str, Sequence[Trial]],
    kind: Kind,
) -> Plan:
    """Return a plan with the figures of its worst object, and those of the described object."""
    recorded = {name: [one.recorded(planes_mm, exposures) for one in draws] for name, draws in trials.items()}
    outcomes = {
        name: draws[0].outcome(kind, recorded[name][0]) for name, draws in trials.items() if name != EXAMPLE
    }
    worst = min(outcomes.values(), key=lambda trial: trial.correlation)
    described = [
        trial.outcome(kind, planes, thorough=True)
        for trial, planes in zip(trials.get(EXAMPLE, ()), recorded.get(EXAMPLE, ()), strict=True)
    ]
    linearised = EXAMPLE if described else next(iter(trials))
    first = {name: draws[0] for name, draws in trials.items()}
    return Plan(
        planes_mm,
        exposures,
        worst.correlation,
        max(trial.misfit_over_noise for trial in outcomes.values()),
        max(trial.iterations for trial in [*outcomes.values(), *described]),
        {name: trial.correlation for name, trial in outcomes.items()},
        worst.smooth_fraction,
        predicted=float(np.mean([trial.correlation for trial in described])) if described else math.nan,
        misfit_of_example=max([trial.misfit_over_noise for trial in described], default=math.nan),
        ratio=min(first[name].ratio(kind, planes_mm, recorded[name][0]) for name in first),
        information=first[linearised].information(kind, recorded[linearised][0]),
    )


def _range(lens: Lens, settings: PlanSettings) -> tuple[float, float]:
    planes = settings.planes_mm or lens.sensor.plane_distances_mm
    if settings.most_planes > 1 and min(planes) == max(planes):
        raise InputError(
            f"planes_mm: the design has one plane, at {planes[0]:g} mm: "
            "give the nearest and the farthest distance"
        )
    lens.sensor.cover_glass_at(min(planes))
    return min(planes), max(planes)


class _SmallBench(NamedTuple):
    """A twin, its lens, and its patch."""

    twin: Twin
    lens: Lens
    patch: Patch


def _small_bench(
    lens: Lens, patch: Patch, settings: PlanSettings, far_mm: float, most_pixels: int = MOST_PIXELS
) -> _SmallBench:
    """Return a twin whose light covers at most a number of pixels across on the farthest plane."""
    twin = _twin(lens, patch, settings, far_mm, most_pixels)
    small_lens = lens if twin.scale == 1.0 else scaled(lens, twin.scale)
    small = object_patch(small_lens, twin.patch_mm, wavelength_um=settings.wavelength_um)
    samples = min(small.grid.shape)
    if samples < LEAST_SAMPLES:
        nearer = "" if twin.scale == 1.0 else ", or nearer planes ({planes_mm})"
        raise SettingError(
            f"{{patch_mm}} = {patch.field_stop_mm:g}: gives {samples} x {samples} samples in the simulation, "
            f"and a prediction needs {LEAST_SAMPLES} x {LEAST_SAMPLES}; use a larger patch{nearer}"
        )
    return _SmallBench(twin, small_lens, small)


def _twin(
    lens: Lens, patch: Patch, settings: PlanSettings, far_mm: float, most_pixels: int = MOST_PIXELS
) -> Twin:
    pixels_across = 1e3 * footprint_mm(lens, patch, far_mm) / lens.sensor.pixel_pitch_um
    scale = min(1.0, most_pixels / pixels_across)
    widest_mm = MOST_SAMPLES * patch.grid.pitch_mm
    patch_mm = min(patch.field_stop_mm * math.sqrt(scale), scale * lens.object.field_diameter_mm, widest_mm)
    small_lens = scaled(lens, scale)
    small = object_patch(small_lens, patch_mm, wavelength_um=settings.wavelength_um)
    near, far = (scale * z for z in _range(lens, settings))
    noise = settings.read_noise_electrons * patch.field_stop_mm / patch_mm
    return Twin(scale, patch_mm, noise, diversity(small_lens, small, (near, far)))


def random_objects(patch: Patch, settings: PlanSettings) -> dict[str, Field]:
    """Return the trial objects of a kind on a patch, by name."""
    random = _Random(np.random.default_rng(settings.seed), patch.inside)
    return {
        name: Field(patch.grid, trial.transmission(random).astype(np.complex64), patch.wavelength_um)
        for name, trial in TRIAL_OBJECTS.items()
        if settings.kind == trial.kind or (settings.kind, trial.kind) == ("complex", "phase")
    }


def _strength(transmission: NDArray[Any]) -> float:
    """Return the fraction of the transmitted amplitude that differs from the mean."""
    power = float(np.mean(np.abs(transmission) ** 2))
    return math.sqrt(max(1.0 - abs(complex(np.mean(transmission, dtype=complex))) ** 2 / power, 0.0))


class Outcome(NamedTuple):
    """Result of one plan for one object."""

    correlation: float
    misfit_over_noise: float
    iterations: int
    smooth_fraction: float


class Trial(NamedTuple):
    """Frames by plane and exposure, and the engine, which all plans share for one object."""

    frames: dict[tuple[float, float], Frame]
    engine: Engine
    light: Field
    target: Field
    inside: NDArray[np.bool_]
    engine_error: float

    def recorded(self, planes_mm: tuple[float, ...], exposures: tuple[float, ...]) -> list[Measurement]:
        """Return the measurements on planes with exposures.

        Raises
        ------
        SettingError
            If they contain no light.
        """
        recorded = recorded_planes([self.frames[key] for key in product(planes_mm, exposures)])
        if all(
            not np.any(plane.amplitude[np.isfinite(plane.sigma)])
            for plane in recorded
            if plane.sigma is not None
        ):
            raise SettingError(
                "{full_well_electrons}, {read_noise_electrons}, {bits}: the frames of this sensor contain no "
                "light beyond their noise; state a larger full well, less noise or more bits"
            )
        return recorded

    def outcome(self, kind: Kind, recorded: Sequence[Measurement], thorough: bool = False) -> Outcome:
        """Return the result from measurements; a thorough search leaves local minima."""
        # Pixels are held out as in reconstruct_frames.
        given, _ = hold_out(recorded)
        noise = noise_misfit(given)
        assert noise is not None
        found = self._found(kind, given)
        is_stagnated = found.misfit[-1] > EXPLAINED * noise and found.stopped_because != "iterations"
        if thorough and kind == "amplitude" and is_stagnated:
            others = (
                partial(self._found, kind, given, bounded=False),
                lambda: with_growing_aperture(partial(self._of_stage, kind), given, self.light),
            )
            for search in others:
                other = search()
                if other.misfit[-1] < found.misfit[-1]:
                    found = other
                if found.misfit[-1] <= EXPLAINED * noise:
                    break
        correlation = truth_metrics(
            found.transmission, self.target, self.light, self.inside, self.engine.scene, Scratch()
        )["object_correlation"]
        assert correlation is not None
        smooth = self._smooth_fraction(found.transmission.values, correlation)
        return Outcome(correlation, found.misfit[-1] / noise, len(found.misfit), smooth)

    def ratio(self, kind: Kind, planes_mm: Sequence[float], recorded: Sequence[Measurement]) -> float:
        """Return the oversampling ratio of measurements."""
        scene, grid = self.engine.scene, self.target.grid
        side_mm = grid.pitch_mm * 2.0 * math.sqrt(np.count_nonzero(self.inside) / math.pi)
        return measured_oversampling(
            recorded,
            planes_mm,
            kind=kind,
            support_mm=side_mm,
            numerical_aperture=scene.lens.object.numerical_aperture,
            wavelength_um=scene.wavelength_um,
        ).ratio

    def information(self, kind: Kind, recorded: Sequence[Measurement]) -> Information:
        """Return the information of measurements about the object."""
        return information_of(
            WhitenedJacobian(self.engine, self.light, recorded, self.target, kind, self.inside)
        )

    def _found(self, kind: Kind, given: Sequence[Measurement], **options: Any) -> Reconstructed:
        """Return the object that iterations find."""
        return reconstruct(
            self.engine,
            self.light,
            given,
            kind=kind,
            tv_weight="auto",
            until_noise=True,
            fill_factor=1.0,
            **{"iterations": ITERATIONS["object"]} | options,
        )

    def _of_stage(
        self, kind: Kind, given: Sequence[Measurement], start: Field | None, iterations: int
    ) -> Reconstructed:
        """Return the object of a stage of a growing aperture."""
        return self._found(kind, given, start=start, iterations=iterations)

    def _smooth_fraction(self, found: NDArray[Any], correlation: float) -> float:
        """Return the fraction of the squared error below `SMOOTH_CYCLES` cycles across the patch."""
        found, true = (np.where(self.inside, one, 0.0) for one in (found, self.target.values))
        factor = np.vdot(found, true) / np.vdot(found, found)
        cycles = [scipy.fft.fftfreq(count, 1.0 / count) for count in found.shape]
        is_smooth = np.add.outer(cycles[0] ** 2, cycles[1] ** 2) < SMOOTH_CYCLES**2
        smooth = np.sum(np.abs(scipy.fft.fft2(factor * found - true)[is_smooth]) ** 2) / found.size
        changed = _strength(true[self.inside]) ** 2 * float(np.sum(np.abs(true) ** 2))
        error = (1.0 - correlation**2) * changed
        return min(float(smooth) / error, 1.0) if error > 0.0 else 0.0


def trial_of(
    lens: Lens, target: Field, settings: PlanSettings, twin: Twin, planes_mm: Sequence[float]
) -> Trial:
    """Return the frames of an object on all planes (in mm, of the original lens), and the engine.

    Parameters
    ----------
    lens, target, settings, twin
        Lens of the twin, object on its patch, and settings of the plans.
    planes_mm
        All planes.
    """
    imaged = image(
        lens,
        target,
        field_stop_mm=twin.patch_mm,
        planes_mm=tuple(twin.scale * z for z in planes_mm),
        exposures=settings.exposures,
        engine="eikonal",
        full_well_electrons=settings.full_well_electrons,
        read_noise_electrons=twin.read_noise_electrons,
        bits=settings.bits,
        seed=settings.seed,
    )
    patch = imaged.patch
    scene = exit_scene(lens, patch, imaged.sensor, twin.scale * min(planes_mm))
    engine = engine_for(scene, "eikonal", error=TILE_ERROR)
    frames = dict(zip(product(planes_mm, settings.exposures), imaged.frames, strict=True))
    light = lit(patch, PatchSettings())
    return Trial(frames, engine, light, target, patch.inside, imaged.predicted_error)
