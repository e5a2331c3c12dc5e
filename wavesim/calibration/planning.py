"""Which frames to take: how many planes, where, and which exposures, before any frame is there.

Each plan is tried: objects of the kind are imaged through the lens by a sensor with noise and reconstructed
as :func:`wavesim.reconstruct_frames` reconstructs them. Planes are spread evenly; one exposure stands beside
a bracket. Where lens or patch is large, a smaller twin of it stands for it (:class:`Twin`).

The correlation depends on the object. Noise leaves an error of nearly the same size whatever the object is,
and the correlation compares this error with the light that the object changes. A thin phase object changes
little light. Most of its error is smooth phase, which the planes hardly determine: iterations reach the noise
before smooth phase has converged. Each plan is therefore tried with several objects (:data:`TRIAL_OBJECTS`),
and the prediction is the range of their correlations.
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
from wavesim.metrics.judgement import truth_metrics
from wavesim.reconstruction.diagnostics.held_out import hold_out
from wavesim.reconstruction.from_object import reconstruct
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

SIDE, SAMPLES = 144, 192
"""Pixels across the light on the farthest plane, and samples of the object, that a twin has at most."""

EXPLAINED = 1.2
"""Misfit over that of the noise, up to which an object explains the frames of a plan."""

ALIKE = 0.9
"""Fraction of the lens's diversity from which on that of a twin counts as the same."""

SMOOTH_CYCLES = 4.0
"""Errors of fewer cycles than this across the patch count as smooth."""


class _Random(NamedTuple):
    """Random patterns on a patch, of which the samples inside the field stop are the measure."""

    generator: np.random.Generator
    inside: NDArray[np.bool_]

    def smooth(self, detail: float) -> NDArray[np.float64]:
        """Noise of mean 0 and standard deviation 1, smoothed by a Gaussian of so many samples."""
        values = gaussian_filter(self.generator.standard_normal(self.inside.shape), detail)
        own = values[self.inside]
        return np.asarray((values - own.mean()) / own.std())

    def grains(self, detail: float, fraction: float) -> NDArray[np.bool_]:
        """Grains that cover a fraction of the samples."""
        values = self.smooth(detail)
        return np.asarray(values > np.quantile(values[self.inside], 1.0 - fraction))


class TrialObject(NamedTuple):
    """A random object with which plans are tried.

    Attributes
    ----------
    kind : str
        "complex" or "amplitude".
    description : str
        What it is, in words.
    transmission : callable
        Makes its transmission from random patterns.
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
        "complex",
        "smooth phase of 0.2 rad rms",
        lambda random: np.exp(0.2j * random.smooth(6.0)),
    ),
    "steps": TrialObject(
        "complex",
        "phase steps of 1 rad on 5 %",
        lambda random: np.exp(1j * random.grains(4.0, 0.05)),
    ),
}
"""Objects with which plans are tried, by name: those that change much of the light and those that change
little."""


class Twin(NamedTuple):
    """What was simulated in place of lens and patch.

    The patch shrinks by the root of the lens's scale, so that planes tell as much of the phase, but where the
    twin's field or `SAMPLES` leave less. Read noise grows as the patch shrinks: that of all pixels together
    then stands to their light as it does on the lens itself.
    """

    scale: float
    patch_mm: float
    read_noise_electrons: float
    diversity: float


@dataclass(frozen=True)
class Plan:
    """Frames that might be taken, and what they would tell of an object.

    Attributes
    ----------
    planes_mm : tuple of float
        From the exit vertex of the lens itself.
    exposures : tuple of float
        Exposure times of each plane; 1 gives the peak fill of the brightest pixel.
    correlation : float
        Lowest correlation of the object found with the true one
        (:func:`wavesim.metrics.contrast.object_correlation`), of all objects tried.
    misfit_over_noise : float
        Misfit of the frames over that of their noise, of the object that is explained worst: far above 1,
        the object that explains the frames was not found.
    iterations : int
        Iterations of the longest reconstruction.
    by_object : dict
        Correlation of each trial object, by its name.
    smooth_fraction : float
        Fraction of the squared error with less than `SMOOTH_CYCLES` cycles across the patch, of the object of
        the lowest correlation.
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
        """To be taken."""
        return len(self.planes_mm) * len(self.exposures)

    @property
    def highest_correlation(self) -> float:
        """Highest correlation of all objects tried."""
        return max([self.correlation, *self.by_object.values()])

    @property
    def error(self) -> float:
        """Largest relative error of what the object does to its light: sqrt(1 - correlation^2)."""
        return math.sqrt(max(1.0 - self.correlation**2, 0.0))


@dataclass(frozen=True)
class Plans:
    """Plans compared.

    Attributes
    ----------
    settings : PlanSettings
        For which they are.
    twin : Twin
        On which they were tried.
    diversity : float
        What the outermost planes tell of the phase on the lens itself.
    plans : tuple of Plan
        Fewest frames first.
    strengths : dict
        Fraction of the transmitted amplitude that each trial object changes, rms.
    engine_error : float
        Upper bound of the relative error of the engine on the nearest plane. It is not part of the
        prediction, since the same engine makes the frames and reconstructs.
    """

    settings: PlanSettings
    twin: Twin
    diversity: float
    plans: tuple[Plan, ...]
    strengths: Mapping[str, float] = field(default_factory=dict)
    engine_error: float = math.nan

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the predictions take for granted, in sentences."""
        chosen, best = self.settings, self.recommended
        objects = "; ".join(
            f"{name} ({TRIAL_OBJECTS[name].description}, changes {strength:.2g} of the light's amplitude)"
            for name, strength in self.strengths.items()
        )
        lines = [
            f"Objects of kind {chosen.kind}: {objects}. A weaker object correlates less.",
            f"Sensor: full well {chosen.full_well_electrons:g} electrons, read noise "
            f"{chosen.read_noise_electrons:g} electrons, {chosen.bits} bits; one draw of the noise. "
            "Where the correlation is below 0.9, another draw may change it by 0.03.",
            "Bench: planes, mounting, light and sensor are exactly as designed; the light is coherent.",
            f"Engine: the same one makes the frames and reconstructs. Its own error (at most "
            f"{self.engine_error:.2g}) comes on top.",
            f"Reconstruction: at most {ITERATIONS['object']} iterations, which end at the noise.",
        ]
        if self.twin.scale < 1.0:
            lines.append(
                f"Twin: {self.twin.scale:.3g} of the lens, patch of {self.twin.patch_mm:.3g} mm, read noise "
                f"of {self.twin.read_noise_electrons:.3g} electrons. Its planes have a diversity of "
                f"{self.twin.diversity:.3g}, those of the lens {self.diversity:.3g}"
                + (
                    ": objects that change much of the light converge more slowly on the lens."
                    if self.twin.diversity < ALIKE * self.diversity
                    else "."
                )
            )
        if chosen.kind == "complex" and math.isfinite(best.smooth_fraction):
            lines.append(
                f"Smooth phase (less than {SMOOTH_CYCLES:g} cycles across the patch) is hardly determined by "
                f"the planes: it is {100.0 * best.smooth_fraction:.0f} % of the squared error of the worst "
                "object of the recommended plan."
            )
        return tuple(lines)

    @property
    def enough(self) -> bool:
        """Whether a plan reaches the correlation that is asked for."""
        return self.recommended.correlation >= self.settings.correlation

    @property
    def at_noise(self) -> bool:
        """Whether the frames of the recommended plan are explained, so that only their noise is left."""
        return self.recommended.misfit_over_noise <= EXPLAINED

    @property
    def recommended(self) -> Plan:
        """Of the fewest frames that reach the correlation asked for; the best where none does."""
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
                f"{'' if self.enough else ', less than asked for'}",
            ),
        ]


def plan_frames(
    lens: Lens, settings: PlanSettings | None = None, *, progress: Progress | None = None, **changes: Any
) -> Plans:
    """Predict how well objects are reconstructed from one plane or more, of one exposure or several.

    Parameters
    ----------
    lens
        The nominal lens.
    settings
        All that may be set; defaults if left out.
    progress
        Told what is tried, how many plans are done, and of how many.
    **changes
        Settings by name, in place of those of `settings`.

    Raises
    ------
    InputError, SamplingError
        If a value is not usable.
    """
    settings = (settings or PlanSettings()).replaced(**changes)
    validate_lengths(lens, settings)
    near, far = _range(lens, settings)
    patch_mm = lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm
    patch = object_patch(lens, patch_mm, wavelength_um=settings.wavelength_um)
    twin = _twin(lens, patch, settings, far)
    own = lens if twin.scale == 1.0 else scaled(lens, twin.scale)
    small = object_patch(own, twin.patch_mm, wavelength_um=settings.wavelength_um)
    brackets = dict.fromkeys([settings.exposures[:1], settings.exposures])
    wanted = [
        (tuple(float(z) for z in np.linspace(near, far, count)), exposures)
        for count in range(1, settings.most_planes + 1)
        for exposures in brackets
    ]
    wanted.sort(key=lambda one: (len(one[0]) * len(one[1]), len(one[0])))
    targets = random_objects(small, settings)
    return predicted_plans(
        own, targets, settings, twin, wanted, diversity(lens, patch, (near, far)), progress
    )


def predicted_plans(
    lens: Lens,
    targets: Mapping[str, Field],
    settings: PlanSettings,
    twin: Twin,
    wanted: Sequence[tuple[tuple[float, ...], tuple[float, ...]]],
    diversity_of_planes: float,
    progress: Progress | None = None,
) -> Plans:
    """Try some plans on a twin.

    Parameters
    ----------
    lens
        The twin itself.
    targets
        Objects with which plans are tried, by name.
    settings, twin
        As of :class:`Plans`.
    wanted
        Planes (of the lens for which the twin stands) and exposures of each plan.
    diversity_of_planes
        Of the lens for which the twin stands.
    progress
        As of :func:`plan_frames`.
    """
    tell = progress or (lambda what, done, count: None)
    tell("frames of all plans", 0, len(wanted))
    planes = sorted({z for planes, _ in wanted for z in planes})
    tries = {name: _tries(lens, target, settings, twin, planes) for name, target in targets.items()}
    plans = []
    for number, (planes_mm, exposures) in enumerate(wanted):
        tell(f"{len(planes_mm)} planes, {len(exposures)} exposures", number, len(wanted))
        outcomes = {name: one.outcome(settings.kind, planes_mm, exposures) for name, one in tries.items()}
        plans.append(_plan(planes_mm, exposures, outcomes))
    tell("planned", len(wanted), len(wanted))
    strengths = {name: _strength(one.target.values[one.inside]) for name, one in tries.items()}
    engine_error = max(one.engine_error for one in tries.values())
    return Plans(settings, twin, diversity_of_planes, tuple(plans), strengths, engine_error)


def _plan(
    planes_mm: tuple[float, ...], exposures: tuple[float, ...], outcomes: Mapping[str, _Outcome]
) -> Plan:
    """The plan as its worst object has it."""
    worst = min(outcomes.values(), key=lambda one: one.correlation)
    return Plan(
        planes_mm,
        exposures,
        worst.correlation,
        max(one.misfit_over_noise for one in outcomes.values()),
        max(one.iterations for one in outcomes.values()),
        {name: one.correlation for name, one in outcomes.items()},
        worst.smooth_fraction,
    )


def _range(lens: Lens, settings: PlanSettings) -> tuple[float, float]:
    planes = settings.planes_mm or lens.sensor.plane_distances_mm
    if settings.most_planes > 1 and min(planes) == max(planes):
        raise InputError(
            f"planes_mm: the design has one plane, at {planes[0]:g} mm: give the nearest and the farthest"
        )
    return min(planes), max(planes)


def _twin(lens: Lens, patch: Patch, settings: PlanSettings, far_mm: float) -> Twin:
    across = 1e3 * footprint_mm(lens, patch, far_mm) / lens.sensor.pixel_pitch_um
    scale = min(1.0, SIDE / across)
    widest = SAMPLES * patch.grid.pitch_mm
    patch_mm = min(patch.field_stop_mm * math.sqrt(scale), scale * lens.object.field_diameter_mm, widest)
    own = scaled(lens, scale)
    small = object_patch(own, patch_mm, wavelength_um=settings.wavelength_um)
    near, far = (scale * z for z in _range(lens, settings))
    noise = settings.read_noise_electrons * patch.field_stop_mm / patch_mm
    return Twin(scale, patch_mm, noise, diversity(own, small, (near, far)))


def random_objects(patch: Patch, settings: PlanSettings) -> dict[str, Field]:
    """The trial objects of a kind on a patch, by name."""
    random = _Random(np.random.default_rng(settings.seed), patch.inside)
    return {
        name: Field(patch.grid, one.transmission(random).astype(np.complex64), patch.wavelength_um)
        for name, one in TRIAL_OBJECTS.items()
        if one.kind == settings.kind
    }


def _strength(transmission: NDArray[Any]) -> float:
    """Fraction of the transmitted amplitude that is not the mean."""
    power = float(np.mean(np.abs(transmission) ** 2))
    return math.sqrt(max(1.0 - abs(complex(np.mean(transmission, dtype=complex))) ** 2 / power, 0.0))


class _Outcome(NamedTuple):
    """What one plan gave of one object."""

    correlation: float
    misfit_over_noise: float
    iterations: int
    smooth_fraction: float


class _Tries(NamedTuple):
    """What all plans share for one object: frames by plane and exposure, and the engine."""

    frames: dict[tuple[float, float], Frame]
    engine: Engine
    light: Field
    target: Field
    inside: NDArray[np.bool_]
    engine_error: float

    def outcome(self, kind: Kind, planes_mm: tuple[float, ...], exposures: tuple[float, ...]) -> _Outcome:
        """Of those planes and exposures."""
        recorded = recorded_planes([self.frames[one] for one in product(planes_mm, exposures)])
        # As reconstruct_frames does it: without the pixels with which it compares.
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
        """Fraction of the squared error with less than `SMOOTH_CYCLES` cycles across the patch."""
        found, true = (np.where(self.inside, one, 0.0) for one in (found, self.target.values))
        factor = np.vdot(found, true) / np.vdot(found, found)
        cycles = [scipy.fft.fftfreq(count, 1.0 / count) for count in found.shape]
        is_smooth = np.add.outer(cycles[0] ** 2, cycles[1] ** 2) < SMOOTH_CYCLES**2
        smooth = np.sum(np.abs(scipy.fft.fft2(factor * found - true)[is_smooth]) ** 2) / found.size
        changed = _strength(true[self.inside]) ** 2 * float(np.sum(np.abs(true) ** 2))
        error = (1.0 - correlation**2) * changed
        return min(float(smooth) / error, 1.0) if error > 0.0 else 0.0


def _tries(
    lens: Lens, target: Field, settings: PlanSettings, twin: Twin, planes_mm: Sequence[float]
) -> _Tries:
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
    return _Tries(frames, engine, light, target, patch.inside, imaged.predicted_error)
