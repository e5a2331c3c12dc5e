"""Annular slices: the paper's method of propagation through a thick lens, with phase compensation.

Planes perpendicular to the axis cut every surface into slices. For each slice, the field is propagated to the
slice's plane in the medium in front, masked to the slice (Eqs. 3, C1, C2, C5), multiplied by the phase that
light gains up to the surface and from there to the next plane in the medium behind (Eqs. 4, C3, C6), and
propagated in that medium to one virtual plane, where all slices are summed (Eqs. C4, C7).

The paper propagates backwards, from the sensor: Eqs. C1 to C4 are those of the exit surface, Eqs. C5 to C7
those of the entrance surface. Here one function is used for every surface; it is also its own adjoint. The
paper's symbols have the following names in the code.

=========================  ==================================================================================
Symbol                     Code
=========================  ==================================================================================
z_p, z_q                   `planes_mm`: the cutting planes
g_1, g_2                   `z`: the height of the surface at a sample
Pupil_p, Pupil_q           `SlicedSurface.indices`: the slice of each sample (`slice_of`)
P_z                        `_Steps`, the factors of plane waves, between two Fourier transforms
u_p1, u_q1                 `wave` in `_Slice.pass_columns`, before it is multiplied by the factors
u_p2, u_q2                 `kept` in `_Slice.pass_columns`
u_virtual, u_en            `total` in `through_surface`
=========================  ==================================================================================

Vertical compensation, as printed, assumes light parallel to the axis. Over the height of a slice its phase
error grows with the obliquity in both media. The error decreases as the slices become thinner.

Oblique compensation uses the angles of the rays from the object's centre, and one plane in the middle of each
slice instead of its two borders, so that the error has no first order in the height. With few slices the
error decreases with the square of their number. What remains is diffraction at the borders, where the light
of neighbouring slices overlaps or leaves a gap; it decreases with the number of slices once they are thin.

Each surface has its own window and pitch. NumPy fields are propagated in the given precision.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError, validate_choice
from wavesim.engines.slices.compensation import (
    COMPENSATIONS,
    Compensation,
    Oblique,
    border_light,
    centre_rays,
)
from wavesim.engines.slices.cost import slices_cost
from wavesim.engines.slices.planes import Spacing, cutting_planes
from wavesim.engines.slices.samples import IlluminatedArea, sliced
from wavesim.engines.slices.steps import SurfaceTransfer
from wavesim.engines.slices.windows import Waves, arriving, surface_grids
from wavesim.engines.surfaces.grids import LightExtent, check_grid_size, light_extent
from wavesim.engines.surfaces.samples import other_transmission
from wavesim.engines.surfaces.waves import Medium
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene

ComplexArray = NDArray[np.complex128]
CompensationKind = Literal["vertical", "oblique"]
Precision = Literal["double", "single"]


class AnnularSlices(Engine):
    """Propagation through slices between cutting planes.

    Parameters
    ----------
    scene
        Lens, grids and wavelength.
    slices : int
        Number of slices of each surface; with unequal spacing, the average over the surfaces.
    compensation : {"vertical", "oblique"}
        Phase compensation within a slice.
    spacing : {"equal", "paper", "equal-phase"}
        Spacing of the planes; see :func:`wavesim.engines.slices.planes.cutting_planes`.
    pitch_mm, half_width_mm
        Pitch and half-width of the grids within the lens. Default: by the extent of the light on each
        surface.
    force : bool
        Whether to run even above the limits of memory and time.
    precision : {"double", "single"}
        Precision of fields and factors: complex128 or, in half the memory, complex64. Phases are computed in
        double precision.

    Raises
    ------
    InputError
        If a setting is not usable.
    """

    name = "slices"

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        return ({"slices": count, "compensation": "oblique"} for count in (10, 30, 100, 300, 1000))

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        counts = {"oblique": (3, 10, 30, 100, 300, 1000), "vertical": (10, 30, 100, 300, 1000, 3000)}
        return {
            f"slices, {kind}": [{"slices": count, "compensation": kind} for count in counts[kind]]
            for kind in counts
        }

    def __init__(
        self,
        scene: Scene,
        slices: int = 30,
        compensation: CompensationKind = "vertical",
        spacing: Spacing = "equal",
        pitch_mm: float | None = None,
        half_width_mm: float | None = None,
        force: bool = False,
        precision: Precision = "double",
    ) -> None:
        super().__init__(scene)
        whole = isinstance(slices, int | np.integer) and not isinstance(slices, bool)
        most_slices = 50_000
        if not whole or not 1 <= slices <= most_slices:
            raise InputError(f"slices = {slices!r}: must be a whole number from 1 to {most_slices}")
        validate_choice("compensation", compensation, tuple(COMPENSATIONS))
        validate_choice("spacing", spacing, ("equal", "paper", "equal-phase"))
        validate_choice("precision", precision, ("double", "single"))
        self.precision = precision
        self.slices, self.compensation, self.spacing = int(slices), compensation, spacing
        self.force = bool(force)
        self._grid_settings = (pitch_mm, half_width_mm)

    @cached_property
    def light(self) -> LightExtent:
        """Extent of the light and of the surfaces."""
        return light_extent(self.scene)

    @cached_property
    def sides(self) -> tuple[tuple[Waves, Waves], ...]:
        """Plane waves in front of each surface and behind it, in the window of the surface."""
        scene, bands = self.scene, self.light.bands_per_mm
        return tuple(
            (
                Waves(Medium(grid, scene.wavelength_um, float(scene.system.index[0, i]), bands[i])),
                Waves(Medium(grid, scene.wavelength_um, float(scene.system.index[0, i + 1]), bands[i + 1])),
            )
            for i, grid in enumerate(surface_grids(scene, self.light, *self._grid_settings))
        )

    def settings(self) -> dict[str, Any]:
        grids = [front.grid for front, _ in self.sides]
        return {
            "slices": self.slices,
            "compensation": self.compensation,
            "spacing": self.spacing,
            "precision": self.precision,
            "pitch_mm": min(grid.pitch_mm for grid in grids),
            "half_width_mm": max(grid.half_widths_mm[0] for grid in grids),
        }

    def _compensations(self, fan: bool) -> tuple[Compensation, ...]:
        """Return the compensation at every surface, from a meridional fan or a bundle of rays."""
        rays = centre_rays(self.scene, self.scene.object_grid.centre_mm, fan)
        return tuple(COMPENSATIONS[self.compensation](ray) for ray in rays)

    @cached_property
    def _fan(self) -> tuple[Compensation, ...]:
        return self._compensations(fan=True)

    def _planes(self, heights_mm: Sequence[tuple[float, float]]) -> list[Array]:
        fan = self._fan if self.spacing != "equal" else ()
        return cutting_planes(self.scene, fan, heights_mm, self.slices, self.spacing)

    @cached_property
    def _prepared(self) -> SurfaceTransfer:
        self._validate_transmission()
        check_grid_size(self.name, max(front.grid.size for front, _ in self.sides), self.cost(), self.force)
        self._warn()
        scene = self.scene
        compensations = self._compensations(fan=False)
        reached = [
            IlluminatedArea(scene, i, front.grid, reach)
            for i, ((front, _), reach) in enumerate(zip(self.sides, self.light.reach_mm, strict=True))
        ]
        planes = self._planes([part.span_mm() for part in reached])
        surfaces = [
            sliced(part, compensation, cut, self._dtype)
            for part, compensation, cut in zip(reached, compensations, planes, strict=True)
        ]
        return SurfaceTransfer(
            scene.object_grid,
            scene.exit_grid,
            self.sides,
            surfaces,
            arriving(scene, self.light),
            scene.system.cover_glass,
        )

    @property
    def _dtype(self) -> np.dtype[Any]:
        """Precision of the fields, and of the stored factors."""
        return np.dtype(np.complex64 if self.precision == "single" else np.complex128)

    def _forward(self, values: Any) -> Any:
        return self._prepared.forward(np.asarray(values, self._dtype))

    def _adjoint(self, values: Any) -> Any:
        return self._prepared.adjoint(np.asarray(values, self._dtype))

    @cached_property
    def _nominal_planes(self) -> list[Array]:
        """Cutting planes by the extent of the light, before the surfaces are sampled."""
        return self._planes(self.light.heights_mm)

    @cached_property
    def _phases(self) -> list[Array]:
        """Phase errors of the compensation for the rays of a meridional fan on every surface."""
        k, planes = self.scene.wavenumber_per_mm, self._nominal_planes
        return [surface.phase_error(cut, k) for surface, cut in zip(self._fan, planes, strict=True)]

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        found = [
            ErrorTerm(f"{self.compensation} compensation within slices", _misfit(self._phases)),
            ErrorTerm("borders of slices", self._border_error()),
            ErrorTerm("transmission other than that of the object's middle", other_transmission(self.scene)),
            ErrorTerm(
                "light that the rim diffracts beyond the grid's band",
                math.sqrt(self.light.diffracted),
                at_rim=True,
            ),
        ]
        oblique = [surface for surface in self._fan if isinstance(surface, Oblique)]
        if oblique:
            error = self._other_angles(oblique)
            found.append(ErrorTerm("angles of light from beside the object's middle", error))
        return tuple(sorted(found, key=lambda n: -n.relative_error))

    def _border_error(self) -> float:
        fractions = [
            border_light(surface.ray, cut, behind.medium)
            for surface, cut, (_, behind) in zip(self._fan, self._nominal_planes, self.sides, strict=True)
        ]
        return math.sqrt(sum(float(np.mean(fraction)) for fraction in fractions))

    def _other_angles(self, compensations: Sequence[Oblique]) -> float:
        """Return the relative error for points at the rms distance along y of a filled object grid."""
        grid, k = self.scene.object_grid, self.scene.wavenumber_per_mm
        (x, y), worst = grid.centre_mm, 0.0
        for side in (-1.0, 1.0):
            away = side * grid.half_widths_mm[0] / math.sqrt(3.0)
            try:
                others = centre_rays(self.scene, (x, y + away), fan=True)
            except InputError:
                continue
            phases = [
                k * own.other_angles(other, cut)
                for own, other, cut in zip(compensations, others, self._nominal_planes, strict=True)
            ]
            worst = max(worst, _misfit(phases))
        return worst

    def _validate_transmission(self) -> None:
        if self.light.reflected > 0.0:
            raise InputError(
                f"engine slices: total reflection of {self.light.reflected:.3g} of the rays from the "
                "object's middle and rim, which slices cannot represent: stop the lens down, or use a "
                "smaller object or engine wpm"
            )

    def _warn(self) -> None:
        error = _misfit(self._phases)
        # Estimated relative error of the exit field above which too few slices cause a warning.
        warn_error = 0.2
        if error < warn_error:
            return
        waves = max(float(np.max(np.abs(phase))) for phase in self._phases) / (2.0 * math.pi)
        warnings.warn(
            f"slices = {self.slices}: the phase error of {self.compensation} compensation is up to "
            f"{waves:.3g} waves in a slice, and the relative error of the exit field about {error:.2g}: use "
            "more slices" + ("" if self.compensation == "oblique" else ", or oblique compensation"),
            SamplingWarning,
            stacklevel=6,
        )

    def cost(self) -> Cost:
        unit, equal_steps = self._dtype.itemsize, self.spacing == "equal"
        return slices_cost(self.scene, self.sides, self.light, self.slices, unit, equal_steps)


def _misfit(phases: Sequence[Array]) -> float:
    """Return the relative error of a field whose rays have these phase errors at the surfaces."""
    return math.sqrt(float(np.mean(np.abs(np.exp(1j * np.sum(phases, axis=0)) - 1.0) ** 2)))
