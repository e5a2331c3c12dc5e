"""Which frames to take: how many planes, where, and which exposures, before any frame is there.

Each plan is tried: an object of the kind is imaged through the lens by a sensor with noise and reconstructed.
What comes back tells what the frames would. Planes are spread evenly; one exposure stands beside a bracket.
Where lens or patch is large, a smaller twin of it stands for it (:class:`Twin`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lensdesign.common.notebook import html_table
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.scaling import scaled
from wavesim.camera.frame_sets import recorded_planes
from wavesim.camera.frames import Frame
from wavesim.camera.imaging import image
from wavesim.camera.recorded import noise_misfit
from wavesim.camera.recording import Progress
from wavesim.camera.windows import TILE_ERROR, diversity, exit_scene, footprint_mm
from wavesim.engines.choosing import engine_for
from wavesim.evaluation.judgement import truth_metrics
from wavesim.fields.field import Field
from wavesim.objects.patch import Patch, lit, object_patch
from wavesim.reconstruction.from_object import reconstruct
from wavesim.runtime.scratch import Scratch
from wavesim.scene.engine import Engine
from wavesim.scene.settings import ITERATIONS, Kind, PatchSettings, PlanSettings

SIDE, SAMPLES = 144, 96
"""Pixels across the light on the farthest plane, and samples of the object, that a twin has at most."""

EXPLAINED = 1.2
"""Misfit over that of the noise, up to which an object explains the frames of a plan."""

DETAIL, PHASE_RAD = 3.0, 1.2
"""Standard deviation, in samples, of what smooths a random object, and the rms of a complex one's phase."""


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
        Of each plane, as multiples of what gives the brightest share.
    correlation : float
        Of the object found and the true one (:func:`wavesim.evaluation.metrics.object_correlation`).
    misfit_over_noise : float
        Of the frames: far above 1, the object that explains them was not found.
    iterations : int
        That were made.
    """

    planes_mm: tuple[float, ...]
    exposures: tuple[float, ...]
    correlation: float
    misfit_over_noise: float
    iterations: int

    @property
    def frames(self) -> int:
        """To be taken."""
        return len(self.planes_mm) * len(self.exposures)

    @property
    def error(self) -> float:
        """Relative error of what the object does to its light, but for a factor: sqrt(1 - correlation^2)."""
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
    """

    settings: PlanSettings
    twin: Twin
    diversity: float
    plans: tuple[Plan, ...]

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
            ("correlation", f"{best.correlation:.4f}{'' if self.enough else ', less than asked for'}"),
        ]


def plan_frames(
    lens: Lens, settings: PlanSettings | None = None, *, progress: Progress | None = None, **changes: Any
) -> Plans:
    """How well an object would come back from one plane or more, of one exposure or several.

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
    near, far = _range(lens, settings)
    patch_mm = lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm
    patch = object_patch(lens, patch_mm, wavelength_um=settings.wavelength_um)
    twin = _twin(lens, patch, settings, far)
    own = lens if twin.scale == 1.0 else scaled(lens, twin.scale)
    small = object_patch(own, twin.patch_mm, wavelength_um=settings.wavelength_um)
    target = _random_object(small, settings)
    brackets = dict.fromkeys([settings.exposures[:1], settings.exposures])
    wanted = [
        (tuple(float(z) for z in np.linspace(near, far, count)), exposures)
        for count in range(1, settings.most_planes + 1)
        for exposures in brackets
    ]
    wanted.sort(key=lambda one: (len(one[0]) * len(one[1]), len(one[0])))
    tell = progress or (lambda what, done, count: None)
    tell("frames of all plans", 0, len(wanted))
    tries = _tries(own, target, settings, twin, sorted({z for planes, _ in wanted for z in planes}))
    plans = []
    for number, (planes, exposures) in enumerate(wanted):
        tell(f"{len(planes)} planes, {len(exposures)} exposures", number, len(wanted))
        plans.append(tries.plan(settings.kind, planes, exposures))
    tell("planned", len(wanted), len(wanted))
    return Plans(settings, twin, diversity(lens, patch, (near, far)), tuple(plans))


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


def _random_object(patch: Patch, settings: PlanSettings) -> Field:
    """Of the kind, and of which every part tells: grains that let little through, or amplitude and phase."""
    random = np.random.default_rng(settings.seed)

    def smooth() -> NDArray[np.float64]:
        values = gaussian_filter(random.standard_normal(patch.grid.shape), DETAIL)
        return np.asarray(values / values.std())

    if settings.kind == "amplitude":
        values = np.where(smooth() > 1.0, 0.1, 1.0).astype(complex)
    else:
        values = (0.3 + 0.7 / (1.0 + np.exp(-2.0 * smooth()))) * np.exp(1j * PHASE_RAD * smooth())
    return Field(patch.grid, values.astype(np.complex64), patch.wavelength_um)


class _Tries(NamedTuple):
    """What all plans share: frames by plane and exposure, and the way back from them."""

    frames: dict[tuple[float, float], Frame]
    engine: Engine
    light: Field
    target: Field
    inside: NDArray[np.bool_]

    def plan(self, kind: Kind, planes_mm: tuple[float, ...], exposures: tuple[float, ...]) -> Plan:
        """From those planes and exposures."""
        recorded = recorded_planes([self.frames[one] for one in product(planes_mm, exposures)])
        found = reconstruct(
            self.engine,
            self.light,
            recorded,
            kind=kind,
            tv_weight="auto",
            iterations=ITERATIONS["object"],
            until_noise=True,
            active_width=1.0,
        )
        noise = noise_misfit(recorded)
        correlation = truth_metrics(
            found.transmission, self.target, self.light, self.inside, self.engine.scene, Scratch()
        )["object_correlation"]
        assert noise is not None
        assert correlation is not None
        return Plan(planes_mm, exposures, correlation, found.misfit[-1] / noise, len(found.misfit))


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
    return _Tries(frames, engine, lit(patch, PatchSettings()), target, patch.inside)
