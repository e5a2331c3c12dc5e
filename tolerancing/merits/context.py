"""What merits share: the nominal lens, and the rays and pupils of the batch at hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from weakref import WeakKeyDictionary

from pydantic import Field

from lensdesign.common.section import Positive, Section
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import PerturbationBatch, batch_of
from tolerancing.perturbations.parameters import PerturbedParameter
from wavesim.scene.placement import Placement

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lensdesign.raytrace.bundles import PupilSamples
    from tolerancing.merits.arrival import Arrival
    from tolerancing.merits.compensators import Compensator, ModelPupils
    from wavesim import PatchChain, PupilSampler, ReconstructionPupil
    from wavesim.pupil.patch_return import PerturbedPatch

Result = TypeVar("Result")
Points = tuple[tuple[float, float], ...]


class Sampling(Section):
    """How finely merits are sampled.

    Attributes
    ----------
    rings, arms
        Rays through the stop: rings, and rays on each; one more ring runs along the rim.
    pupil_samples
        Samples across the reconstruction pupil.
    plane_distance_mm
        Plane behind the exit vertex on which a perturbed lens is compared with the nominal one; the sensor
        tilts about its middle.
    """

    rings: Annotated[int, Field(ge=1, le=200)] = 6
    arms: Annotated[int, Field(ge=3, le=2000)] = 24
    pupil_samples: Annotated[int, Field(ge=16, le=2048)] = 96
    plane_distance_mm: Positive = 3.0


class Context:
    """The nominal lens with all that is worked out only once in a process.

    Rays and pupils are kept for as long as their batch lives, so that merits of the same field point
    share them.

    Parameters
    ----------
    lens
        The nominal lens.
    sampling
        How finely merits are sampled.
    compensators
        What the reconstruction's model adapts.
    compensated_points
        Field points and wavelengths whose pupils together tell the compensators their values.
    pivot_z_mm
        Where on the axis the model's lens turns.
    noise_seed
        Of the sensor's noise, with the trial's number.
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
        self._kept: dict[Any, Any] = {}
        self._shared: WeakKeyDictionary[PerturbationBatch, dict[Any, Any]] = WeakKeyDictionary()

    def stop_samples(self) -> PupilSamples:
        """Points on the stop through which rays go, with weights; the last ring is the rim."""
        from lensdesign.raytrace.bundles import pupil_rings

        return pupil_rings(self.sampling.rings, self.sampling.arms, edge=True)

    def perturbed(
        self,
        parameters: Sequence[PerturbedParameter],
        values: NDArray[np.float64],
        numbers: Sequence[int] | None = None,
    ) -> PerturbationBatch:
        """Lenses with given deltas of some parameters, shape (lenses, parameters), all else nominal.

        Shapes of irregularities are those of the trials `numbers`, of trial 0 where left out.
        """
        return batch_of(parameters, values, self._pivot_z_mm, self.noise_seed, numbers)

    def extreme_samples(
        self, field_points_mm: Points, wavelength_um: float | None, plane_distances_mm: tuple[float, ...]
    ) -> PupilSamples:
        """As :meth:`stop_samples`, with the extreme rays of the nominal lens, which have no weight."""
        wavelength = self.wavelength_um(wavelength_um)

        def work() -> PupilSamples:
            from lensdesign.analysis.extreme_rays import with_extreme_rays

            return with_extreme_rays(
                self.lens, field_points_mm, self.stop_samples(), wavelength, plane_distances_mm
            )

        return self.kept(("extreme rays", field_points_mm, wavelength, plane_distances_mm), work)

    def rays(
        self,
        batch: PerturbationBatch,
        field_points_mm: Points,
        wavelength_um: float | None,
        stop: PupilSamples | None = None,
    ) -> Arrival:
        """Rays from field points through the stop to the first sensor plane, as the sensor sees them.

        Parameters
        ----------
        batch
            The trials.
        field_points_mm
            Object points (x, y).
        wavelength_um
            Vacuum wavelength; None is the first of the lens.
        stop
            Samples of the stop; default: :meth:`stop_samples`.

        Returns
        -------
        Arrival
            Arrays of shape (trials, field points * stop samples, ...), field point by field point.
        """
        wavelength = self.wavelength_um(wavelength_um)

        def work() -> Arrival:
            from tolerancing.merits.arrival import arriving_rays

            samples = self.stop_samples() if stop is None else stop
            return arriving_rays(self.lens, batch, field_points_mm, samples.points, wavelength)

        # Samples are made once and kept, so that they are one by being the same object.
        return self.once(batch, ("rays", field_points_mm, wavelength, id(stop)), work)

    def placements(self, batch: PerturbationBatch, wavelength_um: float | None) -> list[Placement]:
        """The perturbed systems of a batch."""
        wavelength = self.wavelength_um(wavelength_um)
        return self.once(batch, ("placements", wavelength), lambda: batch.placements(self.lens, wavelength))

    def pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        refocused: bool,
        compensated: bool = False,
    ) -> list[ReconstructionPupil]:
        """Reconstruction pupil of each trial, registered sideways; refocused and compensated if asked for."""
        wavelength = self.wavelength_um(wavelength_um)
        compensated = compensated and bool(self.compensators)

        def registered() -> list[ReconstructionPupil]:
            from wavesim import refocus
            from wavesim.pupil import remove_shift

            register = refocus if refocused else remove_shift
            return [register(p).pupil for p in self.raw_pupils(batch, field_mm, wavelength, compensated)]

        return self.once(batch, ("registered", field_mm, wavelength, refocused, compensated), registered)

    def raw_pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        compensated: bool = False,
    ) -> list[ReconstructionPupil]:
        """Reconstruction pupil of each trial, where it is and as blurred as it is."""
        wavelength = self.wavelength_um(wavelength_um)

        def raw() -> list[ReconstructionPupil]:
            sampler = self.sampler(field_mm, wavelength)
            return [sampler.pupil(one) for one in self.placements(batch, wavelength)]

        pupils = self.once(batch, ("pupils", field_mm, wavelength), raw)
        if not (compensated and self.compensators):
            return pupils
        from tolerancing.merits.compensators import less_model

        model = self._model(field_mm, wavelength)
        values = self.compensator_values(batch)
        return [less_model(pupil, model, own) for pupil, own in zip(pupils, values, strict=True)]

    def patches(
        self,
        batch: PerturbationBatch,
        chain: PatchChain,
        wavelength_um: float | None,
        compensated: bool = False,
    ) -> list[PerturbedPatch]:
        """A patch carried through each trial's lens and back through the nominal one or the adapted model."""

        def work() -> list[PerturbedPatch]:
            return [chain.perturbed(one) for one in self.placements(batch, wavelength_um)]

        patches = self.once(batch, ("patches", chain), work)
        if not (compensated and self.compensators):
            return patches
        from tolerancing.merits.compensators import less_model_patch

        values = self.compensator_values(batch)
        return [
            less_model_patch(patch, chain, self.compensators, own, self._pivot_z_mm)
            for patch, own in zip(patches, values, strict=True)
        ]

    def patch_chain(
        self, field_mm: tuple[float, float], wavelength_um: float | None, patch_um: float, line: bool
    ) -> PatchChain:
        """The chain for a patch about one field point, on a meridional line or in the plane."""
        wavelength = self.wavelength_um(wavelength_um)

        def make() -> PatchChain:
            from wavesim import PatchChain

            return PatchChain(
                self.lens, field_mm, wavelength, self.sampling.plane_distance_mm, patch_um, line=line
            )

        return self.kept(("patch", field_mm, wavelength, patch_um, line), make)

    def compensator_values(self, batch: PerturbationBatch) -> NDArray[np.float64]:
        """What the compensators take in each trial, shape (trials, compensators)."""

        def work() -> NDArray[np.float64]:
            import numpy as np

            from tolerancing.merits.compensators import compensate

            models = [self._model(field, self.wavelength_um(w)) for field, w in self._compensated_points]
            pupils = [self.raw_pupils(batch, field, w) for field, w in self._compensated_points]
            return np.array([compensate(own, models) for own in zip(*pupils, strict=True)])

        return self.once(batch, "compensators", work)

    def kept(self, key: Any, work: Callable[[], Result]) -> Result:
        """Something that is worked out once in a process, whatever the batch."""
        if key not in self._kept:
            self._kept[key] = work()
        result: Result = self._kept[key]
        return result

    def wavelength_um(self, wavelength_um: float | None) -> float:
        """A wavelength, or the lens's first one in place of None."""
        return self.lens.wavelengths_um[0] if wavelength_um is None else wavelength_um

    def sampler(self, field_mm: tuple[float, float], wavelength_um: float) -> PupilSampler:
        """Pupils of one field point."""

        def make() -> PupilSampler:
            from wavesim import PupilSampler

            return PupilSampler(
                self.lens,
                field_mm=field_mm,
                wavelength_um=wavelength_um,
                plane_distance_mm=self.sampling.plane_distance_mm,
                samples=self.sampling.pupil_samples,
            )

        return self.kept(("sampler", field_mm, wavelength_um), make)

    def _model(self, field_mm: tuple[float, float], wavelength_um: float) -> ModelPupils:
        from tolerancing.merits.compensators import model_pupils

        return self.kept(
            ("model", field_mm, wavelength_um),
            lambda: model_pupils(self.sampler(field_mm, wavelength_um), self.compensators, self._pivot_z_mm),
        )

    def once(self, batch: PerturbationBatch, key: Any, work: Callable[[], Result]) -> Result:
        """Something that is worked out once for a batch, or once for the batch that a trial is from."""
        shared = self._shared.setdefault(batch, {})
        if key not in shared:
            parent, place = batch.origin or (None, 0)
            whole = self._shared.get(parent, {}).get(key) if parent is not None else None
            shared[key] = [whole[place]] if isinstance(whole, list) else work()
        result: Result = shared[key]
        return result
