"""Data shared by merits: the nominal lens, and cached rays and pupils of the current batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from weakref import WeakKeyDictionary

from pydantic import Field

from lensdesign.common.frozen_model import FrozenModel, Positive
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.parameters import PerturbedParameter
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lensdesign.raytrace.bundles import PupilSamples
    from lensdesign.raytrace.compiled import CompiledSystem
    from tolerancing.merits.compensators import Compensator, ModelPupils
    from tolerancing.merits.sensor_rays import Arrival
    from wavesim import PatchReconstructor, PupilSampler, ReconstructionPupil
    from wavesim.pupil.patch_reconstruction import PerturbedPatch

Result = TypeVar("Result")
Points = tuple[tuple[float, float], ...]


class Sampling(FrozenModel):
    """Sampling of rays and pupils for merits.

    Attributes
    ----------
    rings, arms
        Number of rings of rays through the stop, and number of rays on each ring. One additional ring is on
        the edge of the stop.
    pupil_samples
        Samples across the reconstruction pupil.
    plane_distance_mm
        Distance of the comparison plane behind the exit vertex. The path of a perturbed lens is compared with
        that of the nominal lens on this plane, and the sensor tilts about the centre of the plane.

    Examples
    --------
    >>> Sampling(pupil_samples=128).rings
    6
    """

    rings: Annotated[int, Field(ge=1, le=200)] = 6
    arms: Annotated[int, Field(ge=3, le=2000)] = 24
    pupil_samples: Annotated[int, Field(ge=16, le=2048)] = 96
    plane_distance_mm: Positive = 3.0


class Context:
    """The nominal lens with cached results that all merits share.

    Rays and pupils of a batch are cached as long as the batch exists, so that merits of the same field point
    share them. Other results are cached as long as the context exists.

    Parameters
    ----------
    lens
        The nominal lens.
    sampling
        Sampling of rays and pupils.
    compensators
        Parameters of the reconstruction's model that adapt to each trial.
    compensated_points
        Field points and wavelengths (None: the first of the lens) whose pupils together determine the values
        of the compensators.
    pivot_z_mm
        Position on the axis about which the model's lens tilts, from its front vertex.
    noise_seed
        Seed of the sensor noise, used together with the trial's number.

    Examples
    --------
    >>> from lensdesign.files.design import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> context = Context(lens, Sampling(rings=3, arms=8))
    >>> context.wavelength_um(None) == lens.wavelengths_um[0]
    True
    """

    def __init__(
        self,
        lens: Lens,
        sampling: Sampling,
        compensators: tuple[Compensator, ...] = (),
        compensated_points: tuple[tuple[tuple[float, float], float | None], ...] = (),
        pivot_z_mm: float = 0.0,
        noise_seed: int = 0,
    ) -> None:
        self.lens = lens
        self.sampling = sampling
        self.compensators = compensators
        self._compensated_points = compensated_points
        self.noise_seed = noise_seed
        self._pivot_z_mm = pivot_z_mm
        self._cache: dict[Any, Any] = {}
        self._batch_caches: WeakKeyDictionary[PerturbationBatch, dict[Any, Any]] = WeakKeyDictionary()

    def stop_samples(self) -> PupilSamples:
        """Return the sample points on the stop, with weights; the last ring is the edge of the stop."""
        from lensdesign.raytrace.bundles import pupil_rings

        return pupil_rings(self.sampling.rings, self.sampling.arms, edge=True)

    def perturbed(
        self,
        parameters: Sequence[PerturbedParameter],
        values: NDArray[np.float64],
        trial_numbers: Sequence[int] | None = None,
    ) -> PerturbationBatch:
        """Return a batch with the given deltas; all other parameters are nominal.

        Parameters
        ----------
        parameters
            Perturbed parameters.
        values : ndarray, shape (lenses, parameters)
            Deltas in the units of the parameters.
        trial_numbers
            Trials whose random figures the irregularities have; default: trial 0 for all lenses.
        """
        return batch_of(parameters, values, self._pivot_z_mm, self.noise_seed, trial_numbers)

    def extreme_samples(
        self, field_points_mm: Points, wavelength_um: float | None, plane_distances_mm: tuple[float, ...]
    ) -> PupilSamples:
        """Return :meth:`stop_samples` and the extreme rays of the nominal lens, which have no weight."""
        wavelength = self.wavelength_um(wavelength_um)

        def compute() -> PupilSamples:
            from lensdesign.analysis.extreme_rays import with_extreme_rays

            return with_extreme_rays(
                self.lens, field_points_mm, self.stop_samples(), wavelength, plane_distances_mm
            )

        return self.cached(("extreme rays", field_points_mm, wavelength, plane_distances_mm), compute)

    def rays(
        self,
        batch: PerturbationBatch,
        field_points_mm: Points,
        wavelength_um: float | None,
        stop: PupilSamples | None = None,
    ) -> Arrival:
        """Trace rays from field points through the stop to the first sensor plane.

        Parameters
        ----------
        batch
            The trials.
        field_points_mm
            Object points (x, y).
        wavelength_um
            Vacuum wavelength; None: the first of the lens.
        stop
            Samples of the stop; default: :meth:`stop_samples`.

        Returns
        -------
        Arrival
            Rays in the sensor's coordinates, arrays of shape (trials, field points * stop samples, ...),
            ordered by field point.
        """
        wavelength = self.wavelength_um(wavelength_um)

        def compute() -> Arrival:
            from tolerancing.merits.sensor_rays import arriving_rays

            samples = self.stop_samples() if stop is None else stop
            return arriving_rays(self.lens, batch, field_points_mm, samples.points, wavelength)

        # Sample objects are cached, so equal samples have the same identity.
        return self.cached_for(batch, ("rays", field_points_mm, wavelength, id(stop)), compute)

    def states(self, batch: PerturbationBatch, wavelength_um: float | None) -> list[SystemState]:
        """Return the perturbed systems of a batch."""
        wavelength = self.wavelength_um(wavelength_um)
        return self.cached_for(batch, ("states", wavelength), lambda: batch.states(self.lens, wavelength))

    def systems(self, batch: PerturbationBatch, wavelength_um: float | None) -> list[CompiledSystem]:
        """Return the lens of each perturbed system, compiled for the pupils of all object points."""
        wavelength = self.wavelength_um(wavelength_um)

        def compute() -> list[CompiledSystem]:
            from lensdesign.raytrace.compiled import compile_system

            return [
                compile_system(self.lens, wavelength, one.pose, one.surface_perturbations)
                for one in self.states(batch, wavelength)
            ]

        return self.cached_for(batch, ("systems", wavelength), compute)

    def pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        refocused: bool,
        compensated: bool = False,
    ) -> list[ReconstructionPupil]:
        """Return the registered reconstruction pupil of each trial.

        Parameters
        ----------
        batch
            The trials.
        field_mm
            Object point (x, y).
        wavelength_um
            Vacuum wavelength; None: the first of the lens.
        refocused
            Whether focus is removed in addition to the lateral shift.
        compensated
            Whether the path of the adapted model is subtracted, if there are compensators.
        """
        wavelength = self.wavelength_um(wavelength_um)
        compensated = compensated and bool(self.compensators)

        def registered() -> list[ReconstructionPupil]:
            from wavesim import refocus
            from wavesim.pupil import remove_shift

            register = refocus if refocused else remove_shift
            return [register(p).pupil for p in self.raw_pupils(batch, field_mm, wavelength, compensated)]

        key = ("registered", field_mm, wavelength, refocused, compensated)
        return self.cached_for(batch, key, registered)

    def raw_pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        compensated: bool = False,
    ) -> list[ReconstructionPupil]:
        """Return the reconstruction pupil of each trial with its lateral shift and defocus."""
        wavelength = self.wavelength_um(wavelength_um)

        def raw() -> list[ReconstructionPupil]:
            sampler = self.sampler(field_mm, wavelength)
            pairs = zip(self.states(batch, wavelength), self.systems(batch, wavelength), strict=True)
            return [sampler.pupil(state, system) for state, system in pairs]

        pupils = self.cached_for(batch, ("pupils", field_mm, wavelength), raw)
        if not (compensated and self.compensators):
            return pupils
        from tolerancing.merits.compensators import less_model

        model = self._model(field_mm, wavelength)
        values = self.compensator_values(batch)
        return [less_model(pupil, model, own) for pupil, own in zip(pupils, values, strict=True)]

    def patches(
        self,
        batch: PerturbationBatch,
        reconstructor: PatchReconstructor,
        wavelength_um: float | None,
        compensated: bool = False,
    ) -> list[PerturbedPatch]:
        """Propagate a patch through each trial's lens and back through the nominal or the adapted lens."""

        def compute() -> list[PerturbedPatch]:
            return [reconstructor.perturbed(one) for one in self.states(batch, wavelength_um)]

        patches = self.cached_for(batch, ("patches", reconstructor), compute)
        if not (compensated and self.compensators):
            return patches
        from tolerancing.merits.compensators import less_model_patch

        values = self.compensator_values(batch)
        return [
            less_model_patch(patch, reconstructor, self.compensators, own, self._pivot_z_mm)
            for patch, own in zip(patches, values, strict=True)
        ]

    def patch_reconstructor(
        self, field_mm: tuple[float, float], wavelength_um: float | None, patch_um: float, line: bool
    ) -> PatchReconstructor:
        """Return the reconstructor of a patch about one field point, on a meridional line or in the plane."""
        wavelength = self.wavelength_um(wavelength_um)

        def make() -> PatchReconstructor:
            from wavesim import PatchReconstructor

            return PatchReconstructor(
                self.lens, field_mm, wavelength, self.sampling.plane_distance_mm, patch_um, line=line
            )

        return self.cached(("patch", field_mm, wavelength, patch_um, line), make)

    def compensator_values(self, batch: PerturbationBatch) -> NDArray[np.float64]:
        """Return the fitted values of the compensators, shape (trials, compensators)."""

        def compute() -> NDArray[np.float64]:
            import numpy as np

            from tolerancing.merits.compensators import compensate

            models = [self._model(field, self.wavelength_um(w)) for field, w in self._compensated_points]
            pupils = [self.raw_pupils(batch, field, w) for field, w in self._compensated_points]
            return np.array([compensate(own, models) for own in zip(*pupils, strict=True)])

        return self.cached_for(batch, "compensators", compute)

    def cached(self, key: Any, compute: Callable[[], Result]) -> Result:
        """Return a result that does not depend on the batch; it is computed once in a process."""
        if key not in self._cache:
            self._cache[key] = compute()
        result: Result = self._cache[key]
        return result

    def wavelength_um(self, wavelength_um: float | None) -> float:
        """Return a wavelength; None means the first wavelength of the lens."""
        return self.lens.wavelengths_um[0] if wavelength_um is None else wavelength_um

    def sampler(self, field_mm: tuple[float, float], wavelength_um: float) -> PupilSampler:
        """Return the sampler of reconstruction pupils at one field point."""

        def make() -> PupilSampler:
            from wavesim import PupilSampler

            return PupilSampler(
                self.lens,
                field_mm=field_mm,
                wavelength_um=wavelength_um,
                plane_distance_mm=self.sampling.plane_distance_mm,
                samples=self.sampling.pupil_samples,
            )

        return self.cached(("sampler", field_mm, wavelength_um), make)

    def _model(self, field_mm: tuple[float, float], wavelength_um: float) -> ModelPupils:
        from tolerancing.merits.compensators import model_pupils

        return self.cached(
            ("model", field_mm, wavelength_um),
            lambda: model_pupils(self.sampler(field_mm, wavelength_um), self.compensators, self._pivot_z_mm),
        )

    def cached_for(self, batch: PerturbationBatch, key: Any, compute: Callable[[], Result]) -> Result:
        """Return a result of a batch; it is computed once, also for single trials of the batch."""
        cache = self._batch_caches.setdefault(batch, {})
        if key not in cache:
            parent, index = batch.origin or (None, 0)
            whole = self._batch_caches.get(parent, {}).get(key) if parent is not None else None
            cache[key] = [whole[index]] if isinstance(whole, list) else compute()
        result: Result = cache[key]
        return result
