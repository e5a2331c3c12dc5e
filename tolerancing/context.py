"""What merits share: the nominal lens, and the rays and pupils of the batch at hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from weakref import WeakKeyDictionary

from pydantic import Field

from lensdesign.system import Lens, Positive, Section
from tolerancing.perturbations import PerturbationBatch

if TYPE_CHECKING:
    from lensdesign.bundles import PupilSamples
    from lensdesign.tracing import RayTrace
    from wavesim import PupilSampler, ReconstructionPupil

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
        Plane behind the exit vertex on which a perturbed lens is compared with the nominal one.
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
    """

    def __init__(self, lens: Lens, sampling: Sampling) -> None:
        self.lens = lens
        self.sampling = sampling
        self._samplers: dict[Any, PupilSampler] = {}
        self._shared: WeakKeyDictionary[PerturbationBatch, dict[Any, Any]] = WeakKeyDictionary()

    def stop_samples(self) -> PupilSamples:
        """Points on the stop through which rays go, with weights; the last ring is the rim."""
        from lensdesign.bundles import pupil_rings

        return pupil_rings(self.sampling.rings, self.sampling.arms, edge=True)

    def rays(
        self, batch: PerturbationBatch, field_points_mm: Points, wavelength_um: float | None
    ) -> RayTrace:
        """Rays from field points through the stop to the first sensor plane.

        Returns
        -------
        RayTrace
            Arrays of shape (trials, field points * stop samples, ...), field point by field point.
        """
        wavelength = self.wavelength_um(wavelength_um)

        def work() -> RayTrace:
            from lensdesign.bundles import launch_compiled
            from lensdesign.compiled import compile_system
            from lensdesign.tracing import trace_compiled

            lens = self.lens
            system = compile_system(lens, wavelength, batch.poses(), batch.surface_perturbations())
            origins, directions = launch_compiled(
                system,
                field_points_mm,
                self.stop_samples().points,
                lens.object_z_mm,
                lens.stop_index,
                lens.stop_semi_diameter_mm,
            )
            return trace_compiled(system, origins, directions, lens.sensor_z_mm[0], threads=1)

        return self._once(batch, ("rays", field_points_mm, wavelength), work)

    def pupils(
        self,
        batch: PerturbationBatch,
        field_mm: tuple[float, float],
        wavelength_um: float | None,
        refocused: bool,
    ) -> list[ReconstructionPupil]:
        """Reconstruction pupil of each trial, registered sideways and, if asked for, refocused."""
        wavelength = self.wavelength_um(wavelength_um)

        def raw() -> list[ReconstructionPupil]:
            sampler = self._sampler(field_mm, wavelength)
            return [
                sampler.pupil(batch.pose(i), batch.surface_perturbations_of(i)) for i in range(len(batch))
            ]

        def registered() -> list[ReconstructionPupil]:
            from wavesim import refocus, remove_shift

            register = refocus if refocused else remove_shift
            pupils = self._once(batch, ("pupils", field_mm, wavelength), raw)
            return [register(pupil).pupil for pupil in pupils]

        return self._once(batch, ("registered", field_mm, wavelength, refocused), registered)

    def wavelength_um(self, wavelength_um: float | None) -> float:
        """A wavelength, or the lens's first one in place of None."""
        return self.lens.wavelengths_um[0] if wavelength_um is None else wavelength_um

    def _sampler(self, field_mm: tuple[float, float], wavelength_um: float) -> PupilSampler:
        key = (field_mm, wavelength_um)
        if key not in self._samplers:
            from wavesim import PupilSampler

            self._samplers[key] = PupilSampler(
                self.lens,
                field_mm=field_mm,
                wavelength_um=wavelength_um,
                plane_distance_mm=self.sampling.plane_distance_mm,
                samples=self.sampling.pupil_samples,
            )
        return self._samplers[key]

    def _once(self, batch: PerturbationBatch, key: Any, work: Callable[[], Result]) -> Result:
        shared = self._shared.setdefault(batch, {})
        if key not in shared:
            shared[key] = work()
        result: Result = shared[key]
        return result
