"""Recommend the number, positions and exposure times of the recording planes, before frames are recorded.

Each plan is simulated. Objects of the kind are imaged through the lens by a sensor with noise, and
reconstructed as by :func:`wavesim.reconstruct_frames`. Planes are spread evenly; plans with one exposure are
compared with plans with several. A large lens or patch is replaced by a smaller twin (:class:`Twin`).

The correlation depends on the object. Noise leaves an error of nearly the same size whatever the object is,
and the correlation compares this error with the light that the object changes. A thin phase object changes
little light. Most of its error is smooth phase, which the planes hardly determine: iterations reach the
noise before smooth phase has converged. Each plan is therefore tried with several objects
(:data:`TRIAL_OBJECTS`), and the prediction is the range of their correlations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.notebook import html_table
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Field
from wavesim.metrics.result_quality import truth_metrics
from wavesim.reconstruction.diagnostics.held_out import hold_out
from wavesim.reconstruction.object_solver import reconstruct
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.scene.lengths import validate_lengths
from wavesim.scene.settings import ITERATIONS, Kind, PatchSettings, PlanSettings
from wavesim.sensor.frame_sets import recorded_planes
from wavesim.sensor.frames import Frame
from wavesim.sensor.imaging import image
from wavesim.sensor.measurement import noise_misfit
from wavesim.sensor.recording import Progress
from wavesim.sensor.windows import TILE_ERROR, diversity, exit_scene, footprint_mm
from wavesim.targets.patch import Patch, lit, object_patch

MOST_PIXELS, MOST_SAMPLES = 144, 192
"""Largest number of pixels across the light on the farthest plane, and of object samples along a side, of a
twin.
"""

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
        (:func:`wavesim.metrics.contrast.object_correlation`), of all trial objects.
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
    """

    planes_mm: tuple[float, ...]
    exposures: tuple[float, ...]
    correlation: float
    misfit_over_noise: float
    iterations: int
    by_object: Mapping[str, float] = field(default_factory=dict)
    smooth_fraction: float = math.nan

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


@dataclass(frozen=True)
class Plans:
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
    """

    settings: PlanSettings
    twin: Twin
    diversity: float
    plans: tuple[Plan, ...]
    strengths: Mapping[str, float] = field(default_factory=dict)
    engine_error: float = math.nan

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the predictions, as sentences."""
        chosen, best = self.settings, self.recommended
        objects = "; ".join(
            f"{name} ({TRIAL_OBJECTS[name].description}, changes {strength:.2g} of the light's amplitude)"
            for name, strength in self.strengths.items()
        )
        lines = [
            f"Objects of kind {chosen.kind}: {objects}. A weaker object has a lower correlation.",
            f"Sensor: full well {chosen.full_well_electrons:g} electrons, read noise "
            f"{chosen.read_noise_electrons:g} electrons, {chosen.bits} bits; one draw of the noise. "
            "Where the correlation is below 0.9, another draw may change it by 0.03.",
            "Bench: planes, mounting, light and sensor are exactly as designed; the light is coherent.",
            f"Engine: the same one makes the frames and reconstructs. Its own error (at most "
            f"{self.engine_error:.2g}) is not included.",
            f"Reconstruction: at most {ITERATIONS['object']} iterations, which end at the noise.",
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

    @property
    def enough(self) -> bool:
        """True if a plan reaches the requested correlation."""
        return self.recommended.correlation >= self.settings.correlation

    @property
    def at_noise(self) -> bool:
        """True if the frames of the recommended plan are explained up to their noise."""
        return self.recommended.misfit_over_noise <= EXPLAINED

    @property
    def recommended(self) -> Plan:
        """Plan with the fewest frames that reaches the requested correlation, or the best one if none
        does.
        """
        reaching = [plan for plan in self.plans if plan.correlation >= self.settings.correlation]
        return reaching[0] if reaching else max(self.plans, key=lambda plan: plan.correlation)

    def __repr__(self) -> str:
        return f"Plans({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Frames to take", self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        best = self.recommended
        planes = ", ".join(f"{z:.4g}" for z in best.planes_mm)
        return [
            ("plans", f"{len(self.plans)}, for an object of kind {self.settings.kind}"),
            ("planes", f"{planes} mm, exposures {', '.join(f'{e:g}' for e in best.exposures)}"),
            (
                "correlation",
                f"{best.correlation:.4f} to {best.highest_correlation:.4f}"
                f"{'' if self.enough else ', below the requested correlation'}",
            ),
        ]


def plan_frames(
    lens: Lens, settings: PlanSettings | None = None, *, progress: Progress | None = None, **changes: Any
) -> Plans:
    """Predict the quality of reconstructions from different numbers of planes and exposures.

    Parameters
    ----------
    lens
        The nominal lens.
    settings
        All settings; default: `PlanSettings()`.
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
    twin = _twin(lens, patch, settings, far)
    small_lens = lens if twin.scale == 1.0 else scaled(lens, twin.scale)
    small = object_patch(small_lens, twin.patch_mm, wavelength_um=settings.wavelength_um)
    exposure_sets = dict.fromkeys([settings.exposures[:1], settings.exposures])
    candidates = [
        (tuple(float(z) for z in np.linspace(near, far, count)), exposures)
        for count in range(1, settings.most_planes + 1)
        for exposures in exposure_sets
    ]
    candidates.sort(key=lambda plan: (len(plan[0]) * len(plan[1]), len(plan[0])))
    targets = random_objects(small, settings)
    return predicted_plans(
        small_lens, targets, settings, twin, candidates, diversity(lens, patch, (near, far)), progress
    )


def predicted_plans(
    lens: Lens,
    targets: Mapping[str, Field],
    settings: PlanSettings,
    twin: Twin,
    candidates: Sequence[tuple[tuple[float, ...], tuple[float, ...]]],
    diversity_of_planes: float,
    progress: Progress | None = None,
) -> Plans:
    """Simulate plans on a twin.

    Parameters
    ----------
    lens
        The twin's lens.
    targets
        Trial objects by name.
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
    trials = {name: _trial(lens, target, settings, twin, planes) for name, target in targets.items()}
    plans = []
    for index, (planes_mm, exposures) in enumerate(candidates):
        progress(f"{len(planes_mm)} planes, {len(exposures)} exposures", index, len(candidates))
        outcomes = {
            name: trial.outcome(settings.kind, planes_mm, exposures) for name, trial in trials.items()
        }
        plans.append(_plan(planes_mm, exposures, outcomes))
    progress("planned", len(candidates), len(candidates))
    strengths = {name: _strength(trial.target.values[trial.inside]) for name, trial in trials.items()}
    engine_error = max(trial.engine_error for trial in trials.values())
    return Plans(settings, twin, diversity_of_planes, tuple(plans), strengths, engine_error)


def _plan(
    planes_mm: tuple[float, ...], exposures: tuple[float, ...], outcomes: Mapping[str, _Outcome]
) -> Plan:
    """Return a plan with the figures of its worst object."""
    worst = min(outcomes.values(), key=lambda trial: trial.correlation)
    return Plan(
        planes_mm,
        exposures,
        worst.correlation,
        max(trial.misfit_over_noise for trial in outcomes.values()),
        max(trial.iterations for trial in outcomes.values()),
        {name: trial.correlation for name, trial in outcomes.items()},
        worst.smooth_fraction,
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


def _twin(lens: Lens, patch: Patch, settings: PlanSettings, far_mm: float) -> Twin:
    pixels_across = 1e3 * footprint_mm(lens, patch, far_mm) / lens.sensor.pixel_pitch_um
    scale = min(1.0, MOST_PIXELS / pixels_across)
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


class _Outcome(NamedTuple):
    """Result of one plan for one object."""

    correlation: float
    misfit_over_noise: float
    iterations: int
    smooth_fraction: float


class _Trial(NamedTuple):
    """Frames by plane and exposure, and the engine, which all plans share for one object."""

    frames: dict[tuple[float, float], Frame]
    engine: Engine
    light: Field
    target: Field
    inside: NDArray[np.bool_]
    engine_error: float

    def outcome(self, kind: Kind, planes_mm: tuple[float, ...], exposures: tuple[float, ...]) -> _Outcome:
        """Return the result for planes and exposures."""
        recorded = recorded_planes([self.frames[key] for key in product(planes_mm, exposures)])
        # Pixels are held out as in reconstruct_frames.
        given, _ = hold_out(recorded)
        found = reconstruct(
            self.engine,
            self.light,
            given,
            kind=kind,
            tv_weight="auto",
            iterations=ITERATIONS["object"],
            until_noise=True,
            fill_factor=1.0,
        )
        noise = noise_misfit(given)
        correlation = truth_metrics(
            found.transmission, self.target, self.light, self.inside, self.engine.scene, Scratch()
        )["object_correlation"]
        assert noise is not None
        assert correlation is not None
        smooth = self._smooth_fraction(found.transmission.values, correlation)
        return _Outcome(correlation, found.misfit[-1] / noise, len(found.misfit), smooth)

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


def _trial(
    lens: Lens, target: Field, settings: PlanSettings, twin: Twin, planes_mm: Sequence[float]
) -> _Trial:
    imaged = image(
        lens,
        target,
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
    return _Trial(frames, engine, light, target, patch.inside, imaged.predicted_error)
