"""The wave propagation method: steps along z through a thick lens, with the surfaces at their true positions.

In every step next to a surface, two spectra are propagated, one in the medium in front of the surface and one
in the medium behind it, as in the method of Brenner and Singer.

In the published method (``interface="staircase"``) both spectra belong to one field, and each sample uses the
result of its own medium. A surface is then a staircase: its phase error is up to half a step times the
difference of both axial wavenumbers, so that the error falls only with the first power of the step. It
remains at about a tenth of the field for any step, since diffraction at the edges of the stairs adds up.

With the position of the surface within the step (``interface="substep"``) there are two fields, and the
method becomes what the published one approximates. The field in front is propagated in its own medium through
the surface, which gives the wave on the surface. The field behind is what the surface radiates, by
Kirchhoff's integral with the local normal and the local Fresnel coefficient. Both are interpolated between
planes (:mod:`wavesim.engines.surfaces.waves`). The error falls with the fourth power of the step, down to the
error of the tangent plane approximation.

Reference: K.-H. Brenner and W. Singer, "Light propagation through microlenses: a new simulation method",
Appl. Opt. 32, 4984 (1993).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from lensdesign.errors import SamplingError, validate_choice, validate_positive
from lensdesign.raytrace.polarization import axial_reflection
from wavesim.engines.surfaces.grids import FRESNEL_ZONES, WorkingGrid, check_grid_size, working_grid
from wavesim.engines.surfaces.samples import SurfaceSamples, other_transmission, sample_surfaces
from wavesim.engines.surfaces.waves import Medium, SurfaceWaves, interpolation_error
from wavesim.engines.wpm.cost import kept_bytes, passage_cost, setup_cost
from wavesim.engines.wpm.staircase import Staircase
from wavesim.fields.propagator import FreeSpacePropagator
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.runtime.memory import COMPLEX128
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]
Interface = Literal["substep", "staircase"]

WARN_PHASE, REFUSE_PHASE = math.pi, 1.5 * math.pi
"""Phase difference after one step above which a run causes a warning or is refused: between the steepest and
the axial wave (substep), or between both media (staircase)."""

TANGENT_PLANE = 1.0
"""Relative error of the tangent plane approximation of a curved surface, times k r."""


class WavePropagation(Engine):
    """Wave propagation method.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    step_um
        Step along z next to surfaces, which trades accuracy for time. Default: by the steepest light, or a
        quarter wave for the staircase.
    interface : {"substep", "staircase"}
        Representation of the surfaces: at their true positions within a step, or as stairs.
    pitch_mm, half_width_mm
        Pitch and half-width of the working grid. Default: by the extent of the light.
    zones
        Margin for light that the aperture's rim diffracts, in direction and on the surfaces, in Fresnel
        zones. The error from the rim falls with the square root of this number.
    force
        Whether to run even above the limits of memory and time.

    Raises
    ------
    InputError
        If a setting is not usable.
    SamplingError
        On first use, if the grid or the staircase cannot represent the field.
    """

    name = "wpm"

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        """Yield a small margin for diffraction, then larger ones."""
        # Fresnel zones that the choice of an engine tries. For a point that fills the stop of a one-quarter
        # twin of the paper's lens, the relative L2 error of the field is 1.7 % with 4 zones, 0.23 % with 80.
        candidate_zones = (FRESNEL_ZONES, 20.0, 80.0)
        for zones in candidate_zones:
            yield {"zones": zones}

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        # Fresnel zones in comparisons, where the reference uses at least twice as many.
        curve_zones = (4.0, 10.0, 20.0, 40.0)
        return {
            "wpm, substep": [{"step_um": step} for step in (2.0, 1.0)] + [{"zones": z} for z in curve_zones],
            "wpm, staircase": [{"step_um": step, "interface": "staircase"} for step in (0.25, 0.1, 0.05)],
        }

    def __init__(
        self,
        scene: Scene,
        *,
        step_um: float | None = None,
        interface: Interface = "substep",
        pitch_mm: float | None = None,
        half_width_mm: float | None = None,
        zones: float = FRESNEL_ZONES,
        force: bool = False,
    ) -> None:
        super().__init__(scene)
        validate_positive("zones", zones)
        validate_choice("interface", interface, ("substep", "staircase"))
        if step_um is not None:
            validate_positive("step_um", step_um)
        self.interface = interface
        self._step_um, self._zones, self._force = step_um, zones, force
        self._grid_settings = (pitch_mm, half_width_mm)

    @cached_property
    def working(self) -> WorkingGrid:
        """Grid, media and extent of the surfaces."""
        return working_grid(self.scene, *self._grid_settings, self._zones)

    def settings(self) -> dict[str, Any]:
        grid = self.working.grid
        return {
            "step_um": 1e3 * min(self._steps_mm),
            "interface": self.interface,
            "pitch_mm": grid.pitch_mm,
            "half_width_mm": grid.half_widths_mm[0],
            "zones": self._zones,
        }

    def cost(self) -> Cost:
        working = self.working
        low, high = working.heights_mm[0][0], min(working.heights_mm[-1][1], self.scene.exit_grid.z_mm)
        seconds, peak = passage_cost(working, self._steps_mm, self.interface)
        setup, setup_peak = setup_cost(working)
        held = kept_bytes(working) + COMPLEX128 * working.grid.size  # with the argument of the propagators
        for transfer in working.transfers(self.scene, low, high):
            seconds += transfer.seconds
            peak = max(peak, held + transfer.peak_bytes)
        return Cost(seconds, setup, max(peak, setup_peak))

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        system, k = self.scene.system, self.scene.wavenumber_per_mm
        curvature = float(np.max(np.abs([shape.curvature for shape in system.shapes])))
        found = [
            ErrorTerm("curvature of surfaces within a wave", TANGENT_PLANE * curvature / k),
            ErrorTerm("transmission other than that of the object's middle", other_transmission(self.scene)),
        ]
        diffracted = math.sqrt(self.working.diffracted)
        found.append(
            ErrorTerm("light that the rim diffracts beyond the grid's band", diffracted, at_rim=True)
        )
        if self.interface == "substep":
            error = interpolation_error(max(self._phases()))
            found.append(ErrorTerm("interpolation between planes", error))
        else:
            # The height of a stair is wrong by up to half a step.
            rms = math.sqrt(sum(phase**2 for phase in self._phases()) / 12.0)
            stairs = 2.0 * math.sin(min(0.5 * rms, 0.5 * math.pi))
            # Relative error of a staircase with short steps: 0.1 for a beam through cylinders, but 0.6 to 1
            # where light of all directions fills a lens.
            edge_error = 0.5
            found.append(ErrorTerm("surfaces as stairs", math.hypot(stairs, edge_error)))
        if self.working.reflected > 0.0:
            found.append(ErrorTerm("light totally reflected", math.sqrt(self.working.reflected)))
        returned = sorted(float(abs(axial_reflection(system, i))) for i in range(system.surfaces))
        if len(returned) > 1 and returned[-2] > 0.0:
            found.append(ErrorTerm("light reflected inside the lens", returned[-1] * returned[-2]))
        return tuple(sorted(found, key=lambda n: -n.relative_error))

    @cached_property
    def _prepared(self) -> tuple[FreeSpacePropagator, Substep | Staircase, FreeSpacePropagator]:
        working = self.working
        self._check_step()
        check_grid_size(self.name, working.grid.size, self.cost(), self._force)
        surfaces = sample_surfaces(self.scene, working.grid, working.reach_mm)
        inner: Substep | Staircase
        if self.interface == "substep":
            inner = Substep(working.media, surfaces, self._steps_mm, self.scene.exit_grid.z_mm)
        else:
            inner = Staircase(working, surfaces, self._steps_mm[0])
        into, out_of = working.transfers(self.scene, inner.start_mm, inner.end_mm)
        return into, inner, out_of

    def _forward(self, values: Any) -> Any:
        into, inner, out_of = self._prepared
        return out_of.forward(inner.forward(into.forward(np.asarray(values, complex))))

    def _adjoint(self, values: Any) -> Any:
        into, inner, out_of = self._prepared
        return into.adjoint(inner.adjoint(out_of.adjoint(np.asarray(values, complex))))

    @cached_property
    def _steps_mm(self) -> list[float]:
        """Step next to a surface in each of the media."""
        media = self.working.media
        if self._step_um is not None:
            return [1e-3 * self._step_um] * len(media)
        if self.interface == "staircase":
            # Default step of the staircase, in wavelengths.
            staircase_waves = 0.25
            return [staircase_waves * 1e-3 * self.scene.wavelength_um] * len(media)
        # Phase difference after one step of the default step; its interpolation error is 1e-4.
        substep_phase = 1.2
        return [substep_phase / medium.phase_across(1.0) for medium in media]

    def _phases(self) -> list[float]:
        """Return the phase difference after a step, on each side of each surface."""
        media, steps = self.working.media, self._steps_mm
        if self.interface == "substep":
            return [medium.phase_across(step) for medium, step in zip(media, steps, strict=True)]
        return [abs(b.largest_kz_per_mm - a.largest_kz_per_mm) * steps[0] for a, b in pairwise(media)]

    def _check_step(self) -> None:
        phase, stairs = max(self._phases()), self.interface == "staircase"
        step_um = 1e3 * max(self._steps_mm)
        apart = "both media" if stairs else "the steepest and the flattest light"
        message = (
            f"step_um = {step_um:.4g}: {apart} differ by {phase:.3g} rad after one step; a step of at most "
            f"{step_um * WARN_PHASE / phase:.4g} µm keeps that below pi"
        )
        if phase > REFUSE_PHASE:
            raise SamplingError(message)
        if stairs:
            message = (
                "interface = staircase: stairs leave an error of 10 % of a narrow beam, and of more than "
                "half of light that fills a lens, for any step; use interface = substep"
            )
        if stairs or phase > WARN_PHASE:
            warnings.warn(message, SamplingWarning, stacklevel=5)


@dataclass(frozen=True, eq=False)
class Substep:
    """Propagation of separate fields in the media, which are joined at the surfaces.

    The operator runs from the lowest point of the first surface to the highest point of the last one, or to
    the exit plane if that comes first.
    """

    media: Sequence[Medium]
    surfaces: Sequence[SurfaceSamples]
    steps_mm: Sequence[float]
    exit_z_mm: float

    @cached_property
    def sides(self) -> list[tuple[SurfaceWaves, SurfaceWaves]]:
        """Waves in front of and behind each surface."""
        waves = []
        for i, samples in enumerate(self.surfaces):
            front, behind = (SurfaceWaves(self.media[m], samples, self.steps_mm[m]) for m in (i, i + 1))
            waves.append((front, behind))
        return waves

    @property
    def start_mm(self) -> float:
        """Position of the first plane."""
        return float(self.surfaces[0].z_mm[0])

    @property
    def end_mm(self) -> float:
        """Position of the last plane."""
        return min(float(self.surfaces[-1].z_mm[-1]), self.exit_z_mm)

    def forward(self, field: ComplexArray) -> ComplexArray:
        """Propagate a field from the first to the last plane; its array is overwritten."""
        spectrum = scipy.fft.fftn(field, norm="ortho", workers=-1, overwrite_x=True)
        del field
        z_mm = self.start_mm
        for before, behind in self.sides:
            spectrum *= before.medium.waves.transfer_function(before.first_z_mm - z_mm)
            values = before.evaluate(spectrum)
            values *= before.samples.transmission
            del spectrum  # frees its memory before the next one is computed
            spectrum = behind.radiate(values)
            z_mm = behind.first_z_mm
        spectrum *= self.media[-1].waves.transfer_function(self.end_mm - z_mm)
        return np.asarray(scipy.fft.ifftn(spectrum, norm="ortho", workers=-1, overwrite_x=True))

    def adjoint(self, field: ComplexArray) -> ComplexArray:
        """Apply the exact adjoint of :meth:`forward`; the field's array is overwritten."""
        spectrum = scipy.fft.fftn(field, norm="ortho", workers=-1, overwrite_x=True)
        del field
        z_mm = self.end_mm
        for before, behind in reversed(self.sides):
            spectrum *= behind.medium.waves.transfer_function(behind.first_z_mm - z_mm)
            values = behind.radiate_adjoint(spectrum)
            values *= before.samples.transmission.conj()
            del spectrum
            spectrum = before.collect(values)
            z_mm = before.first_z_mm
        spectrum *= self.media[0].waves.transfer_function(self.start_mm - z_mm)
        return np.asarray(scipy.fft.ifftn(spectrum, norm="ortho", workers=-1, overwrite_x=True))
